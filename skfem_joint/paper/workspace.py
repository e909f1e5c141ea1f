"""Where an item's pictures go, and how much work it may do."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from skfem_joint.files import replacing
from skfem_joint.paper.items import Item

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class Workspace:
    """Folder and effort of a reproduction.

    Attributes
    ----------
    folder : Path or None
        Where pictures, curves and ParaView files go; None to compute the rows alone.
    quick : bool
        Coarser sweeps where a full one is long (for tests); the rows with published numbers are
        the same functions with fewer points around them.
    """

    folder: Path | None = None
    quick: bool = False

    def draws(self) -> bool:
        """Whether pictures are wanted."""
        return self.folder is not None

    def save(self, item: Item, name: str, figure: Figure) -> None:
        """Write a figure as ``name``.png and note it in the item."""
        if self.folder is None:
            return
        path = Path("pictures") / f"{name}.png"
        (self.folder / "pictures").mkdir(parents=True, exist_ok=True)
        from matplotlib.backends.backend_agg import FigureCanvasAgg

        with replacing(self.folder / path) as temporary:
            FigureCanvasAgg(figure).print_figure(temporary, format="png", dpi=110)
        item.pictures.append(path)
