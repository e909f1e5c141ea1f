"""Partition of the unknowns of a sparse matrix into parts that only a thin skeleton couples.

The graph of the matrix is walked through from one of its ends, so that what is reached at the same
time is a cross section of a slender body. Even pieces of that order are the parts. Of the unknowns
on both sides of a cut the fewest that meet all couplings across it go to the skeleton: a smallest
vertex cover of a bipartite graph, which a largest matching gives (D. Koenig, Mat. Fiz. Lapok 38,
1931).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import (
    breadth_first_order,
    connected_components,
    maximum_bipartite_matching,
)

from skfem_joint.ground.arrays import BoolArray, IntArray


@dataclass(frozen=True)
class Partition:
    """Parts of the unknowns of a matrix, and the skeleton that holds them apart.

    Attributes
    ----------
    skeleton : ndarray of int
        Unknowns that are in no part, in increasing order.
    inner : tuple of ndarray of int
        Unknowns of each part, which are coupled with none of another one.
    border : tuple of ndarray of int
        Unknowns of the skeleton that each part is coupled with.
    """

    skeleton: IntArray
    inner: tuple[IntArray, ...]
    border: tuple[IntArray, ...]


def partition(A: Any, kept: IntArray, count: int) -> Partition:
    """Partition of the unknowns of a symmetric sparse matrix into about ``count`` even parts.

    Parameters
    ----------
    A : sparse array, shape (n, n)
    kept : ndarray of int
        Unknowns that belong to the skeleton in any case.
    count : int
        Bodies that are apart without the kept unknowns are in parts of their own, so that there may
        be more parts; small ones share one.
    """
    n = A.shape[0]
    rest = np.setdiff1d(np.arange(n), kept)
    if not rest.size:
        return Partition(rest, (), ())
    graph = sparse.csr_array(A)[rest][:, rest]
    part = _pieces(graph, count)
    part[_covers(graph, part)] = -1
    numbers = np.unique(part[part >= 0])
    inner = tuple(rest[part == number] for number in numbers)
    skeleton = np.union1d(kept, rest[part < 0]).astype(np.intp)
    held = np.zeros(n, dtype=bool)
    held[skeleton] = True
    met = (np.unique(sparse.csr_array(A)[own].indices) for own in inner)
    border = tuple(near[held[near]].astype(np.intp) for near in met)
    return Partition(skeleton, inner, border)


def _pieces(graph: Any, count: int) -> IntArray:
    """Number of the piece of each unknown, (n,)."""
    n = graph.shape[0]
    # A symmetric pattern: what is reached one way is reached the other way.
    bodies, body = connected_components(graph, directed=True, connection="strong")
    size = np.bincount(body, minlength=bodies)
    piece, made = np.zeros(n, dtype=np.intp), 1
    small = 2 * size * count < n
    for number in np.flatnonzero(~small):
        end = int(np.argmax(body == number))
        for _ in range(2):  # from any unknown to one end, and from there to the other
            order = breadth_first_order(graph, end, return_predecessors=False)
            end = int(order[-1])
        own = max(1, round(count * order.size / n))
        piece[order] = made + np.arange(order.size) * own // order.size
        made += own
    return piece


def _covers(graph: Any, piece: IntArray) -> BoolArray:
    """Unknowns, (n,), of which one at least meets each coupling between two pieces."""
    covers = np.zeros(piece.size, dtype=bool)
    for number in np.unique(piece)[:-1]:
        low = np.flatnonzero((piece == number) & ~covers)
        across = graph[low]
        beyond = (piece > number)[across.indices]
        rows = np.repeat(np.arange(low.size), np.diff(across.indptr))[beyond]
        high, columns = np.unique(across.indices[beyond], return_inverse=True)
        low, rows = low[np.unique(rows)], np.unique(rows, return_inverse=True)[1]
        if rows.size:
            shape = low.size, high.size
            links = sparse.csr_array((np.ones(rows.size), (rows, columns)), shape=shape)
            first, second = _smallest_cover(links)
            covers[low[first]] = True
            covers[high[second]] = True
    return covers


def _smallest_cover(links: sparse.csr_array) -> tuple[BoolArray, BoolArray]:
    """Fewest rows and columns that together hold all entries of a matrix."""
    rows, columns = links.shape
    match = maximum_bipartite_matching(links, perm_type="column")  # column of each row, or -1
    matched = np.flatnonzero(match >= 0)
    ones = np.ones(matched.size)
    back = sparse.csr_array((ones, (match[matched], matched)), shape=(columns, rows))
    # From a root to the rows without a partner, by any link to columns, by pairs back to rows.
    alone = np.flatnonzero(match < 0)
    root = sparse.csr_array((np.ones(alone.size), (0 * alone, alone)), shape=(1, rows))
    steps = sparse.block_array([[None, links, None], [back, None, None], [root, None, [[0.0]]]])
    reached = np.zeros(rows + columns + 1, dtype=bool)
    reached[breadth_first_order(sparse.csr_array(steps), rows + columns)[0]] = True
    return ~reached[:rows], reached[rows:-1]
