"""What the package's own readers of mesh files hand over."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import meshio


@dataclass(frozen=True)
class FileMesh:
    """Mesh of a file as meshio would give it, and what the file says beside it.

    Attributes
    ----------
    bodies : list of meshio.Mesh
        Each bar, or all that is not bars, with cell sets as blocks and members by name.
    notes : list of str
        What is passed over, left out, or computed otherwise than its type says.
    plane : str
        State across a plate, "stress" or "strain"; "" of bars, of solids, and where the file does
        not say it.
    """

    bodies: list[meshio.Mesh]
    notes: list[str] = field(default_factory=list)
    plane: str = ""
