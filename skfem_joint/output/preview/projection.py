"""Coordinates of a preview's drawing, in mm: a bar along its axis, a plate, or a solid in space."""

from __future__ import annotations

import numpy as np

from skfem_joint.arrays import FloatArray, IntArray
from skfem_joint.output.preview.marks import Mark
from skfem_joint.output.series import stack_heights
from skfem_joint.structure import Structure

#: Height over length of a plate below which its height is enlarged.
_SLENDER = 0.03


class Projection:
    """Coordinates in the drawing, mm, of nodes, points and directions of a structure.

    Attributes
    ----------
    eye : ndarray, shape (3,)
        Unit vector from the structure to who looks at it.
    axes : ndarray, shape (2, 3)
        Directions in space along which the drawing's coordinates rise.
    enlarged : int
        How much larger y is drawn than x, for slender plates seen from the side.
    heights : ndarray, shape (bodies,)
        Heights at which bars are drawn, m.
    thickness : float
        Largest thickness of bars, m; 0 for plates and solids.
    """

    def __init__(self, structure: Structure) -> None:
        self.structure, self.dim = structure, structure.dim
        eye = np.array([0.45, -0.75, 0.55]) if self.dim == 3 else np.array([0.0, 0.0, 1.0])
        self.eye = eye / np.linalg.norm(eye)
        across = np.cross([0.0, 0.0, 1.0], self.eye) if self.dim == 3 else np.array([1.0, 0.0, 0.0])
        across = across / np.linalg.norm(across)
        self.axes = np.array([across, np.cross(self.eye, across)])
        wide, tall = np.ptp(structure.nodes, axis=0) if self.dim == 2 else (1.0, 1.0)
        self.enlarged = 1
        if tall < _SLENDER * wide:
            fits = [k for k in (2, 5, 10, 20, 50, 100) if k * tall <= 3.0 * _SLENDER * wide]
            self.enlarged = max(fits)
        self.heights, self.thickness = np.zeros(1), 0.0
        if self.dim == 1:
            self.heights = stack_heights(structure)
            self.thickness = float(structure.body.properties["thickness"].max())

    def points(self, x: FloatArray, height: float = 0.0) -> FloatArray:
        """Points (..., dim), m; those of a bar at a height."""
        if self.dim == 1:
            return np.asarray(1e3 * np.concatenate([x, np.full_like(x, height)], axis=-1))
        return np.asarray(1e3 * (x @ self.axes[:, : self.dim].T)) * (1.0, self.enlarged)

    def nodes(self, numbers: IntArray, side: float = 0.0) -> FloatArray:
        """Nodes; of a bar at the height of its body, ``side`` thicknesses of the bar above it."""
        out = self.points(self.structure.nodes[numbers])
        if self.dim == 1:
            body = self.structure.body.body_of_node[numbers]
            out[..., 1] = 1e3 * (self.heights[body] + side * self.thickness)
        return out

    def all_nodes(self) -> FloatArray:
        """All nodes, shape (n_nodes, 2)."""
        return self.nodes(np.arange(self.structure.n_nodes))

    def direction(self, vector: FloatArray) -> FloatArray:
        """Direction in the drawing, of a length of at most 1."""
        return np.asarray(self.points(vector) / 1e3) / (1.0, self.enlarged)

    def place(self, mark: Mark) -> FloatArray:
        """Place of a mark's label."""
        if self.dim == 1 and mark.nodes.size:
            near = np.argmin(np.abs(self.structure.nodes[mark.nodes, 0] - mark.at[0]))
            side = -0.5 if mark.kind == "joint" else 0.0
            return np.asarray(self.nodes(mark.nodes[[near]], side)[0])
        return self.points(mark.at)

    def arrow(self, mark: Mark, length: float) -> tuple[FloatArray, FloatArray]:
        """Start and end of a load's arrow; it ends at the body where it pushes on it."""
        at, along = self.place(mark), self.direction(np.asarray(mark.direction))
        nodes = self.all_nodes()
        outwards = at - 0.5 * (nodes.min(axis=0) + nodes.max(axis=0))
        step = length * along
        return (at - step, at) if along @ outwards < -1e-9 * length else (at, at + step)


def border(cells: IntArray) -> IntArray:
    """Edges that belong to one cell alone, by node numbers, shape (edges, 2)."""
    if cells.shape[1] == 2:
        return cells
    edges = np.sort(np.stack([cells, np.roll(cells, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1)
    unique, count = np.unique(edges, axis=0, return_counts=True)
    return np.asarray(unique[count == 1], dtype=np.intp)
