"""Contact of plates: pressure, nodal normal forces, tangents, and interpolation in another body.

Normal forces are integrals of the pressure times the linear hat functions of the sub-cells between
the displacement nodes. Those are positive for every element, where second-order shape functions
give zero or negative forces. A quadrilateral sub-cell counts as four triangles around the mean of
its corners, so that all integrals run over triangles and are exact.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.spatial import cKDTree

from skfem_joint.bolts import Bolts, bolt_forces
from skfem_joint.contact import PressureTable
from skfem_joint.errors import InputError

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.intp]

# A contact node may lie outside the other body by this part of the size of the element beside it:
# curved borders of two meshes differ by as much. The interpolation then extrapolates.
_GAP = 0.1
# Nodes of two bodies closer than this part of the whole size are one place.
_MATCH = 1e-9
_NEWTON_STEPS = 30


@dataclass(frozen=True)
class AxialPressure:
    """Pressure that varies linearly between positions along an axis.

    Attributes
    ----------
    positions : tuple of float
        Increasing positions x . axis, m.
    values : tuple of float
        Pressures there, Pa; constant beyond the ends.
    axis : tuple of float
        Direction of the axis; its length does not count.
    """

    positions: tuple[float, ...]
    values: tuple[float, ...]
    axis: tuple[float, float] = (1.0, 0.0)

    def __post_init__(self) -> None:
        PressureTable(self.positions, self.values)
        axis = np.asarray(self.axis, dtype=float)
        if axis.shape != (2,) or not np.all(np.isfinite(axis)) or not np.any(axis):
            raise InputError(
                f"pressure.axis: found {self.axis}, must be two finite numbers, not both zero"
            )

    def along(self, x: FloatArray) -> FloatArray:
        """Position along the axis (m) of the points ``x`` (..., 2)."""
        axis = np.asarray(self.axis, dtype=float)
        return np.asarray(x @ (axis / np.linalg.norm(axis)))

    def __call__(self, x: FloatArray) -> FloatArray:
        """Pressure (Pa) at the points ``x`` (..., 2)."""
        return np.interp(self.along(x), self.positions, self.values)


Pressure: TypeAlias = float | AxialPressure | Bolts


def pressure_integrals(corners: FloatArray, pressure: float | AxialPressure) -> FloatArray:
    """Integrals of pressure times hat function over segments or triangles, exactly.

    Parameters
    ----------
    corners : ndarray, shape (n, 2 or 3, 2)
        m.
    pressure : float or AxialPressure
        Pa. Where it has a kink, segments and triangles are cut.

    Returns
    -------
    ndarray, shape (n, 2 or 3)
        N/m on segments, N on triangles.
    """
    size = _measure(corners)
    count = corners.shape[1]
    if not isinstance(pressure, AxialPressure):
        return np.repeat(pressure * size[:, None] / count, count, axis=1)
    position = pressure.along(corners)
    pieces = np.repeat(np.eye(count)[None], len(corners), axis=0)
    parent = np.arange(len(corners))
    for kink in pressure.positions:
        pieces, parent = _cut(pieces, parent, position, kink)
    values = np.interp(
        np.einsum("nij,nj->ni", pieces, position[parent]), pressure.positions, pressure.values
    )
    # Products of two linear functions on a simplex.
    products = values.sum(axis=1)[:, None] * pieces.sum(axis=1)
    products += np.einsum("ni,nik->nk", values, pieces)
    share = np.abs(np.linalg.det(pieces)) * size[parent] / (count * (count + 1))
    result = np.zeros((len(corners), count))
    np.add.at(result, parent, share[:, None] * products)
    return result


def _measure(corners: FloatArray) -> FloatArray:
    """Length of segments, area of triangles."""
    sides = corners[:, 1:] - corners[:, :1]
    if corners.shape[1] == 2:
        return np.asarray(np.linalg.norm(sides[:, 0], axis=-1))
    return np.asarray(0.5 * np.abs(np.linalg.det(sides)))


def _cut(
    pieces: FloatArray, parent: IntArray, position: FloatArray, level: float
) -> tuple[FloatArray, IntArray]:
    """Cut simplices where a linear function, given at their parents' corners, has a value.

    ``pieces`` holds the corners of each simplex in the barycentric coordinates of its parent.
    """
    values = np.einsum("nij,nj->ni", pieces, position[parent])
    crossed = (values.min(axis=1) < level) & (level < values.max(axis=1))
    order = np.argsort(values[crossed], axis=1)
    values = np.take_along_axis(values[crossed], order, axis=1)
    corner = np.moveaxis(np.take_along_axis(pieces[crossed], order[..., None], axis=1), 1, 0)

    def between(i: int, j: int) -> FloatArray:
        gap = values[:, j] - values[:, i]
        t = ((level - values[:, i]) / np.where(gap > 0.0, gap, 1.0))[:, None]
        return np.asarray((1.0 - t) * corner[i] + t * corner[j])

    if pieces.shape[1] == 2:
        middle = between(0, 1)
        new = [[corner[0], middle], [middle, corner[1]]]
    else:
        long = between(0, 2)
        low = (level <= values[:, 1])[:, None]
        short = np.where(low, between(0, 1), between(1, 2))
        new = [
            [corner[0], np.where(low, short, corner[1]), long],
            [np.where(low, short, corner[1]), np.where(low, corner[1], short), long],
            [np.where(low, corner[1], short), corner[2], long],
        ]
    stacked = np.concatenate([np.stack(piece, axis=1) for piece in new])
    return (
        np.concatenate([pieces[~crossed], stacked]),
        np.concatenate([parent[~crossed], np.tile(parent[crossed], len(new))]),
    )


def hat_triangles(nodes: FloatArray, cells: IntArray) -> tuple[FloatArray, sparse.csr_array]:
    """Triangles on which the hat functions of linear cells are linear.

    Parameters
    ----------
    nodes : ndarray, shape (N, 2)
        m.
    cells : ndarray, shape (n, 3 or 4)

    Returns
    -------
    corners : ndarray, shape (triangles, 3, 2)
        m.
    gather : sparse array, shape (N, 3 * triangles)
        Sum of the integrals of the triangles' own hat functions to those of the nodes.
    """
    count = cells.shape[1]
    if count == 3:
        corners = nodes[cells]
        rows, columns = cells.ravel(), np.arange(cells.size)
        values = np.ones(cells.size)
    else:
        after = np.roll(cells, -1, axis=1)
        middle = np.repeat(nodes[cells].mean(axis=1)[:, None], 4, axis=1)
        corners = np.stack([nodes[cells], nodes[after], middle], axis=2).reshape(-1, 3, 2)
        first = 3 * np.arange(cells.size)
        rows = np.concatenate([cells.ravel(), after.ravel(), np.repeat(cells, 4, axis=0).ravel()])
        columns = np.concatenate([first, first + 1, np.repeat(first + 2, 4)])
        values = np.concatenate([np.ones(2 * cells.size), np.full(4 * cells.size, 0.25)])
    shape = (len(nodes), 3 * len(corners))
    return corners, sparse.csr_array((values, (rows, columns)), shape=shape)


@dataclass(frozen=True)
class NodalPressure:
    """Nodal shares of a joint's pressure and area.

    Attributes
    ----------
    force : ndarray, shape (N,)
        N; the sum is the integral of the pressure, or the bolts' force.
    area : ndarray, shape (N,)
        m2.
    bolt_shares : tuple of float
        Part of each bolt's ring that lies on the joint.
    """

    force: FloatArray
    area: FloatArray
    bolt_shares: tuple[float, ...] = ()


def region_pressure(
    nodes: FloatArray, cells: IntArray, pressure: Pressure, where: str
) -> NodalPressure:
    """Nodal normal forces on the linear cells of a region (``where``: its name for messages)."""
    corners, gather = hat_triangles(nodes, cells)
    shares: tuple[float, ...] = ()
    if isinstance(pressure, Bolts):
        integrals, of_bolts = bolt_forces(pressure, corners, where)
        shares = tuple(map(float, of_bolts))
    else:
        integrals = pressure_integrals(corners, pressure)
    area = gather @ pressure_integrals(corners, 1.0).ravel()
    return NodalPressure(_without_round_off(gather @ integrals.ravel()), area, shares)


def edge_pressure(
    nodes: FloatArray, edges: IntArray, thickness: FloatArray, pressure: float | AxialPressure
) -> NodalPressure:
    """Nodal normal forces on the two-node edges (n, 2) of a boundary of given thickness (m)."""

    def gathered(values: float | AxialPressure) -> FloatArray:
        integrals = thickness[:, None] * pressure_integrals(nodes[edges], values)
        return np.bincount(edges.ravel(), integrals.ravel(), len(nodes)).astype(float)

    return NodalPressure(_without_round_off(gathered(pressure)), gathered(1.0))


def _without_round_off(force: FloatArray) -> FloatArray:
    # Where a pressure ends at the edge of a cell, nodes beyond it must not come into contact.
    return np.where(force > 1e-12 * force.max(initial=0.0), force, 0.0)


def edge_tangents(
    nodes: FloatArray, edges: IntArray, largest_turn: float, where: str
) -> FloatArray:
    """Unit tangents at the nodes of two-node edges, the mean of the edges that meet there.

    Parameters
    ----------
    nodes : ndarray, shape (N, 2)
        m.
    edges : ndarray of int, shape (n, 2)
        All running the same way along the border.
    largest_turn : float
        Largest angle between two edges at a node, degrees.
    where : str
        Name of the boundary, for messages.

    Returns
    -------
    ndarray, shape (N, 2)
        Zero at nodes off the edges. They point along x, or along y where the border as a whole does
        not run along x.

    Raises
    ------
    InputError
        Where the border turns by more.
    """
    along = nodes[edges[:, 1]] - nodes[edges[:, 0]]
    unit = along / np.linalg.norm(along, axis=1)[:, None]
    total = np.zeros((len(nodes), 2))
    of_units = np.zeros((len(nodes), 2))
    for end in (0, 1):
        np.add.at(total, edges[:, end], along)
        np.add.at(of_units, edges[:, end], unit)
    count = np.bincount(edges.ravel(), minlength=len(nodes))
    # Two unit vectors at the angle a have a sum of length 2 cos(a / 2).
    turn = np.zeros(len(nodes))
    two = count == 2
    turn[two] = 2 * np.degrees(np.arccos(np.clip(np.linalg.norm(of_units[two], axis=1) / 2, 0, 1)))
    if np.any(count > 2):
        place = nodes[np.argmax(count)]
        raise InputError(f"{where}: more than two of its edges meet at {_at(place)}")
    worst = int(np.argmax(turn))
    if turn[worst] > largest_turn:
        raise InputError(
            f"{where}: it turns by {turn[worst]:.3g} degrees at {_at(nodes[worst])}, must be at "
            f"most {largest_turn:g}, else no tangent is defined there; give each straight part a "
            "boundary and a joint of its own, a node apart"
        )
    on = count > 0
    tangents = np.zeros((len(nodes), 2))
    tangents[on] = total[on] / np.linalg.norm(total[on], axis=1)[:, None]
    overall = along.sum(axis=0)
    length = np.linalg.norm(along, axis=1).sum()
    leading = overall[0] if abs(overall[0]) > 1e-9 * length else overall[1]
    return -tangents if leading < -1e-9 * length else tangents


def _at(place: FloatArray) -> str:
    return f"({place[0]:.6g}, {place[1]:.6g})"


@dataclass(frozen=True)
class Located:
    """Elements of a mesh in which points lie.

    Attributes
    ----------
    element : ndarray of int, shape (k,)
        -1 if there is none near.
    local : ndarray, shape (k, 2)
        Coordinates in the reference element.
    distance : ndarray, shape (k,)
        Distance from the element, 0 inside, m.
    allowed : ndarray, shape (k,)
        Distance up to which a point counts as in contact, m.
    """

    element: IntArray
    local: FloatArray
    distance: FloatArray
    allowed: FloatArray


def locate(mesh: Any, elements: IntArray, points: FloatArray) -> Located:
    """Find the element, among some of a mesh, in or next to which each point lies."""
    corners = np.moveaxis(mesh.p[:, mesh.t[:, elements]], 0, -1).swapaxes(0, 1)
    near, which = _candidates(corners, points)
    local = local_coordinates(corners[which], points[near])
    clamped = np.clip(local, 0.0, 1.0)
    if corners.shape[1] == 3:
        beyond = np.maximum(clamped.sum(axis=1) - 1.0, 0.0)[:, None]
        clamped = np.clip(clamped - 0.5 * beyond, 0.0, 1.0)
    position = np.einsum("kn,knc->kc", _linear_shapes(clamped, corners.shape[1])[0], corners[which])
    distance = np.linalg.norm(position - points[near], axis=1)
    distance[~np.isfinite(local).all(axis=1)] = np.inf
    return _nearest(points, near, elements[which], local, distance, corners, corners[which])


def locate_on_edges(mesh: Any, facets: IntArray, points: FloatArray) -> Located:
    """Find the element beside the facet, among some of a mesh, on which each point lies."""
    ends = np.moveaxis(mesh.p[:, mesh.facets[:, facets]], 0, -1).swapaxes(0, 1)
    near, which = _candidates(ends, points)
    start, along = ends[which, 0], ends[which, 1] - ends[which, 0]
    t = np.sum((points[near] - start) * along, axis=1) / np.sum(along**2, axis=1)
    foot = start + np.clip(t, 0.0, 1.0)[:, None] * along
    distance = np.linalg.norm(foot - points[near], axis=1)
    element = mesh.f2t[0, facets[which]].astype(np.intp)
    corners = np.moveaxis(mesh.p[:, mesh.t[:, element]], 0, -1).swapaxes(0, 1)
    local = local_coordinates(corners, points[near])
    return _nearest(points, near, element, local, distance, ends, ends[which])


def _candidates(corners: FloatArray, points: FloatArray) -> tuple[IntArray, IntArray]:
    """Pairs of a point and a cell (n, corners, 2) that may contain it."""
    middle = corners.mean(axis=1)
    radius = np.linalg.norm(corners - middle[:, None], axis=-1).max(axis=1)
    found = cKDTree(points).query_ball_point(middle, (1.0 + 2.0 * _GAP) * radius)
    count = np.array([len(some) for some in found], dtype=np.intp)
    near = np.concatenate([np.asarray(some, dtype=np.intp) for some in found])
    return near, np.repeat(np.arange(len(corners)), count)


def _nearest(
    points: FloatArray,
    near: IntArray,
    element: IntArray,
    local: FloatArray,
    distance: FloatArray,
    cells: FloatArray,
    cell_of_pair: FloatArray,
) -> Located:
    """Keep the nearest of the candidates of each point; of inside ones the first element."""
    size = np.linalg.norm(cell_of_pair - np.roll(cell_of_pair, 1, axis=1), axis=-1).max(axis=1)
    order = np.lexsort((element, np.where(distance < 1e-9 * size, 0.0, distance), near))
    first, index = np.unique(near[order], return_index=True)
    best = order[index]
    k = len(points)
    result = Located(np.full(k, -1), np.zeros((k, 2)), np.zeros(k), np.zeros(k))
    result.element[first] = element[best]
    result.local[first] = local[best]
    result.distance[first] = distance[best]
    result.allowed[first] = _GAP * size[best]
    lost = result.element < 0
    if np.any(lost):
        result.distance[lost] = cKDTree(cells.reshape(-1, 2)).query(points[lost])[0]
    return result


def _linear_shapes(local: FloatArray, corners: int) -> tuple[FloatArray, FloatArray]:
    """Shape functions (k, corners) and their derivatives (k, corners, 2) of a straight element."""
    x, y = local.T
    one = np.ones_like(x)
    if corners == 3:
        slopes = np.array([[-1.0, -1.0], [1.0, 0.0], [0.0, 1.0]])
        return np.stack([1 - x - y, x, y], axis=1), np.repeat(slopes[None], len(x), axis=0)
    values = np.stack([(1 - x) * (1 - y), x * (1 - y), x * y, (1 - x) * y], axis=1)
    along_x = np.stack([y - one, one - y, y, -y], axis=1)
    along_y = np.stack([x - one, -x, x, one - x], axis=1)
    return values, np.stack([along_x, along_y], axis=-1)


def local_coordinates(corners: FloatArray, points: FloatArray) -> FloatArray:
    """Reference coordinates of points in straight triangles or quadrilaterals.

    Parameters
    ----------
    corners : ndarray, shape (k, 3 or 4, 2)
        m.
    points : ndarray, shape (k, 2)
        One for each element, m.

    Returns
    -------
    ndarray, shape (k, 2)
        NaN where a quadrilateral far from the point has none.
    """
    count = corners.shape[1]
    local = np.full(points.shape, 1.0 / 3.0 if count == 3 else 0.5)
    size = np.abs(corners - corners[:, :1]).max(axis=(1, 2))
    for _ in range(1 if count == 3 else _NEWTON_STEPS):
        values, slopes = _linear_shapes(local, count)
        residual = points - np.einsum("kn,knc->kc", values, corners)
        if count == 4 and np.all(np.abs(residual).max(axis=1) < 1e-15 * size):
            break
        jacobian = np.einsum("knd,knc->kcd", slopes, corners)
        determinant = np.linalg.det(jacobian)
        usable = np.abs(determinant) > 1e-12 * size**2
        jacobian[~usable] = np.eye(2)
        local = local + np.linalg.solve(jacobian, residual[..., None])[..., 0]
        local = np.clip(local, -2.0, 3.0)
    residual = points - np.einsum("kn,knc->kc", _linear_shapes(local, count)[0], corners)
    local[np.abs(residual).max(axis=1) > 1e-10 * size] = np.nan
    return local


def interpolation(
    mesh: Any,
    element: Any,
    element_nodes: IntArray,
    nodes: FloatArray,
    points: FloatArray,
    located: Located,
) -> sparse.csr_array:
    """Matrix that gives the values of a body's displacement at points from its nodes.

    Parameters
    ----------
    mesh : skfem.Mesh
    element : skfem.Element
        Scalar element of the displacement.
    element_nodes : ndarray of int, shape (nodes of an element, elements)
    nodes : ndarray, shape (N, 2)
    points : ndarray, shape (k, 2)
    located : Located
        Where the points lie.

    Returns
    -------
    sparse array, shape (k, N)
        Rows sum to 1 and reproduce linear fields; a point on a node takes the value of that node.
    """
    local = located.local.T
    weights = np.stack([element.lbasis(local, i)[0] for i in range(len(element_nodes))], axis=1)
    near = element_nodes[:, located.element].T
    size = float(np.ptp(mesh.p, axis=1).max())
    same = np.linalg.norm(nodes[near] - points[:, None], axis=-1) < _MATCH * size
    matched = same.any(axis=1)
    weights[matched] = same[matched]
    weights[np.abs(weights) < 1e-12] = 0.0
    weights /= weights.sum(axis=1, keepdims=True)
    rows = np.repeat(np.arange(len(points)), len(element_nodes))
    matrix = sparse.csr_array(
        (weights.ravel(), (rows, near.ravel())), shape=(len(points), len(nodes))
    )
    matrix.eliminate_zeros()
    return matrix
