"""What the readers of mesh files hand over."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

from skfem_joint.ground.arrays import FloatArray, IntArray

_FLAT = {"vertex": 0, "line": 1, "triangle": 2, "quad": 2}


class Block(NamedTuple):
    """Cells of a type.

    Attributes
    ----------
    type : str
        As meshio calls it: vertex, line, triangle, quad, tetra, hexahedron or wedge, behind it the
        number of nodes where it is not that of the corners.
    nodes : ndarray of int, shape (n, nodes)
        Numbers of the nodes, from 0 on, in the order of VTK.
    """

    type: str
    nodes: IntArray

    @property
    def shape(self) -> str:
        """Type without the number of nodes."""
        return self.type.rstrip("0123456789")

    @property
    def dim(self) -> int:
        """Dimension of the cells."""
        return _FLAT.get(self.shape, 3)


@dataclass
class RawMesh:
    """Cells and named groups of a file, or of a bar in it.

    Attributes
    ----------
    places : ndarray, shape (n, 1 to 3)
        Positions of the nodes, in the unit of the file.
    blocks : list of Block
    cell_sets : dict of str to dict of int to ndarray of int
        Cells of each group: numbers within a block, by number of the block.
    node_sets : dict of str to ndarray of int
        Nodes of each group of nodes.
    """

    places: FloatArray
    blocks: list[Block]
    cell_sets: dict[str, dict[int, IntArray]] = field(default_factory=dict)
    node_sets: dict[str, IntArray] = field(default_factory=dict)

    @property
    def top(self) -> int:
        """Largest dimension of the cells; 0 if there are none."""
        return max((block.dim for block in self.blocks if len(block.nodes)), default=0)


@dataclass(frozen=True)
class FileMesh:
    """Mesh of a file and what the file says beside it.

    Attributes
    ----------
    bodies : list of RawMesh
        Each bar, or all that is not bars.
    notes : list of str
        What is passed over, left out, or computed otherwise than its type says.
    plane : str
        State across a plate, "stress" or "strain"; "" of bars, of solids, and where the file does
        not say it.
    """

    bodies: list[RawMesh]
    notes: list[str] = field(default_factory=list)
    plane: str = ""
