"""Smooth borders of contact and of slip on a mesh, for pictures: fields whose contour is 0.5.

What touches and what slips is known at nodes. Drawn by whole cells it looks like a gear wheel. The
functions here make fields of nodes of it that are linear in each cell.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse

from skfem_joint.ground.arrays import BoolArray, FloatArray, IntArray


def of_cells(corners: IntArray, starts: IntArray, n: int) -> sparse.csr_array:
    """Matrix of sums over the nodes of each cell, shape (cells, n).

    The nodes of cell ``k`` are ``corners[starts[k]:starts[k + 1]]``.
    """
    shape = len(starts) - 1, n
    return sparse.csr_array((np.ones(len(corners)), corners, starts), shape=shape)


def touching(cells: sparse.csr_array, pressure: FloatArray) -> FloatArray:
    """Field whose contour 0.5 is the border of contact, from the pressure of nodes, shape (n,).

    At a node it is the pressure over the mean of what is pressed in its cells, at most 1. A node
    whose own area is half pressed has half of the pressure beside it, so that the contour follows
    a bolt's ring through the cells.
    """
    pressed = pressure > 0.0
    mean = _means(cells, pressure, pressed)
    share = np.divide(pressure, mean, out=np.zeros(pressure.size), where=mean > 0.0)
    return np.asarray(np.minimum(share, 1.0))


def spread(cells: sparse.csr_array, values: FloatArray, known: BoolArray) -> FloatArray:
    """Values of nodes; where they are not known, means of those known in the same cells."""
    return np.asarray(np.where(known, values, _means(cells, values, known)))


def smoothed(cells: sparse.csr_array, values: FloatArray, known: BoolArray) -> FloatArray:
    """Values of nodes, each the mean of its own and of those known in the same cells."""
    return np.asarray(0.5 * (spread(cells, values, known) + _means(cells, values, known)))


def _means(cells: sparse.csr_array, values: FloatArray, known: BoolArray) -> FloatArray:
    """Means at nodes of the means of cells of known values; 0 where no cell knows any."""
    count = cells @ known.astype(float)
    inside = np.divide(cells @ np.where(known, values, 0.0), count, where=count > 0.0,
                       out=np.zeros(count.size))  # fmt: skip
    knows = cells.T @ (count > 0.0).astype(float)
    means = np.divide(cells.T @ inside, knows, out=np.zeros(knows.size), where=knows > 0.0)
    return np.asarray(means)
