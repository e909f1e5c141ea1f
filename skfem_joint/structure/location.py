"""Where points of one body lie in another, and the other's values there."""

from __future__ import annotations

from itertools import chain

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from skfem_joint.arrays import FloatArray, IntArray
from skfem_joint.structure.nodes import Nodes

# A contact node may lie outside the other body by this part of the size of the element beside it:
# curved borders of two meshes differ by as much. The interpolation then extrapolates.
_GAP = 0.1
# Nodes of two bodies closer than this part of the whole size are one place.
_MATCH = 1e-9
# Changes below this are the last ones, as the next would be of the size of their squares.
_NEWTON_STEPS, _LAST_CHANGE = 30, 1e-9
# Segments or triangles that cover a cell of so many corners, whatever their order.
_PARTS = {2: [[0, 1]], 3: [[0, 1, 2]], 4: [[0, 1, 2], [0, 1, 3], [0, 2, 3], [1, 2, 3]]}


def interpolation(
    grid: Nodes, name: str, points: FloatArray
) -> tuple[sparse.csr_array, FloatArray]:
    """Values (k, N) at points (k, dim) from those of the body whose region or boundary they are on.

    Rows sum to 1 and reproduce linear fields; a point on a node takes the value of that node. Also
    the distance (k,), m, of points too far outside, whose rows are empty; 0 for the others.
    """
    element, gap, _ = _elements_at(grid, name, points)
    return values_in(grid, element, points, gap)


def values_in(
    grid: Nodes, element: IntArray, points: FloatArray, gap: FloatArray
) -> tuple[sparse.csr_array, FloatArray]:
    """The same where the element (k,) and the gap of each point are known."""
    local = np.zeros_like(points)
    local[gap == 0.0] = local_coordinates(grid, element[gap == 0.0], points[gap == 0.0])
    gap[np.isnan(local).any(axis=1)] = np.inf
    local[gap > 0.0] = 0.0
    count = len(grid.of_element)
    weights = np.stack([grid.element.lbasis(local.T, i)[0] for i in range(count)], axis=1)
    near = grid.of_element[:, element].T
    size = float(np.ptp(grid.nodes, axis=0).max())
    same = np.linalg.norm(grid.nodes[near] - points[:, None], axis=-1) < _MATCH * size
    matched = same.any(axis=1)
    weights[matched] = same[matched]
    weights[np.abs(weights) < 1e-12] = 0.0
    weights /= weights.sum(axis=1, keepdims=True)
    weights[gap > 0.0] = 0.0
    rows = np.repeat(np.arange(len(points)), count)
    shape = (len(points), grid.n_nodes)
    matrix = sparse.csr_array((weights.ravel(), (rows, near.ravel())), shape=shape)
    matrix.eliminate_zeros()
    return matrix, gap


def feet(grid: Nodes, name: str, points: FloatArray, reach: float) -> tuple[IntArray, FloatArray]:
    """Points (k, dim) of a region or boundary nearest to some, NaN where none is within reach.

    First the elements (k,) that they are in.
    """
    element, _, found = _elements_at(grid, name, points)
    far = np.isnan(found).any(axis=1)
    if far.any():
        element[far], _, found[far] = _elements_at(grid, name, points[far], reach)
    return element, found


def _elements_at(
    grid: Nodes, name: str, points: FloatArray, reach: float = 0.0
) -> tuple[IntArray, FloatArray, FloatArray]:
    """Element nearest to each point, the first of those it lies in, gap as above, nearest point.

    Elements are looked for within ``reach`` (m) beside what gaps allow.
    """
    mesh = grid.mesh.mesh
    if name in grid.mesh.regions:
        element = grid.mesh.regions[name]
        cells = mesh.t[:, element]
    else:
        facets = grid.mesh.boundaries[name]
        element, cells = mesh.f2t[0, facets], mesh.facets[:, facets]
    corners = mesh.p.T[cells.T]
    middle = corners.mean(axis=1)
    radius = np.linalg.norm(corners - middle[:, None], axis=-1).max(axis=1)
    found = cKDTree(points).query_ball_point(middle, reach + (1.0 + 2.0 * _GAP) * radius)
    cell = np.repeat(np.arange(len(corners)), [len(some) for some in found])
    near = np.fromiter(chain.from_iterable(found), np.intp)
    some = corners[cell]
    parts = _PARTS[corners.shape[1]]
    foot = _nearest([_foot(some[:, part], points[near]) for part in parts], points[near])
    distance = np.linalg.norm(foot - points[near], axis=1)
    size = np.linalg.norm(some - np.roll(some, 1, axis=1), axis=-1).max(axis=1)
    order = np.lexsort((element[cell], np.where(distance < 1e-9 * size, 0.0, distance), near))
    first, index = np.unique(near[order], return_index=True)
    best = order[index]
    chosen = np.full(len(points), element[0], dtype=np.intp)
    chosen[first] = element[cell[best]]
    gap = cKDTree(corners.reshape(-1, points.shape[1])).query(points)[0]
    gap[first] = np.where(distance[best] > _GAP * size[best], distance[best], 0.0)
    feet = np.full(points.shape, np.nan)
    feet[first] = foot[best]
    return chosen, gap, feet


def _nearest(candidates: list[FloatArray], points: FloatArray) -> FloatArray:
    """The one of several points that is nearest to each of some, (k, dim)."""
    every = np.array(candidates)
    best = np.linalg.norm(every - points, axis=-1).argmin(axis=0)
    return np.asarray(every[best, np.arange(len(points))])


def _foot(corners: FloatArray, points: FloatArray) -> FloatArray:
    """Points of segments or triangles (k, 2 or 3, dim) nearest to some, (k, dim)."""
    start, sides = corners[:, 0], corners[:, 1:] - corners[:, :1]
    gram = np.einsum("kid,kjd->kij", sides, sides)
    right = np.einsum("kid,kd->ki", sides, points - start)
    share = np.linalg.solve(gram, right[..., None])[..., 0]
    if corners.shape[1] == 2:
        share = np.clip(share, 0.0, 1.0)
    foot = start + np.einsum("ki,kid->kd", share, sides)
    if corners.shape[1] == 2:
        return np.asarray(foot)
    border = _nearest([_foot(corners[:, [i - 1, i]], points) for i in range(3)], points)
    above = (share >= 0.0).all(axis=1) & (share.sum(axis=1) <= 1.0)
    return np.where(above[:, np.newaxis], foot, border)


def local_coordinates(grid: Nodes, elements: IntArray, points: FloatArray) -> FloatArray:
    """Reference coordinates of points (k, dim), one in or beside each of some elements (k,).

    scikit-fem's own inverse of bent mappings keeps to the element and raises where one point of
    all lies outside; here points may lie a little outside, and those far off have none: NaN.
    """
    if elements.size == 0:
        return np.zeros_like(points)
    mesh = grid.mesh.mesh
    mapping, x = mesh.mapping(), points.T[:, :, None]
    if grid.is_simplex:
        return np.asarray(mapping.invF(x, tind=elements)[..., 0].T)
    corners = mesh.p[:, mesh.t[:, elements]]
    size = np.abs(corners - corners[:, :1]).max(axis=(0, 1))
    X = np.full(x.shape, 0.5)
    for _ in range(_NEWTON_STEPS):
        residual = x - mapping.F(X, tind=elements)
        jacobian = np.moveaxis(mapping.DF(X, tind=elements)[..., 0], -1, 0)
        usable = np.abs(np.linalg.det(jacobian)) > 1e-12 * size ** len(X)
        jacobian[~usable] = np.eye(len(X))
        change = np.linalg.solve(jacobian, np.moveaxis(residual, 1, 0))
        last, X = X, np.clip(X + np.moveaxis(change, 0, 1), -2.0, 3.0)
        if np.abs(X - last).max() < _LAST_CHANGE:
            break
    local = np.array(X[..., 0].T)
    residual = (x - mapping.F(X, tind=elements))[..., 0].T
    local[np.abs(residual).max(axis=1) > 1e-10 * size] = np.nan
    return local
