"""Pressure on a contact, and the nodal normal forces that it gives.

`skfem_joint.joint.contact.contact_rows` multiplies these forces by the coefficient of friction:
that gives the friction limits.

Normal forces are integrals of the pressure times the linear hat functions of the sub-cells between
the displacement nodes, times the depth of the contact across them (width of a strut, thickness at
an edge). They are positive for every element, where second-order shape functions would give zero or
negative forces. A quadrilateral is split into four triangles around the mean of its corners: all
integrals run over segments or triangles. They are exact, also where a table has a kink in a cell.

A bolt presses uniformly on the ring to which its head spreads its force. Integrals over a ring are
differences of integrals over discs. The part of a triangle inside a disc is bounded by straight
pieces and by arcs around the centre, which contribute triangles and sectors.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from scipy import sparse

from skfem_joint.ground.arrays import FloatArray, IntArray
from skfem_joint.ground.errors import InputError, refuse
from skfem_joint.ground.values import (
    FINITE,
    NOT_NEGATIVE,
    POSITIVE,
    Kind,
    check,
    check_columns,
    check_each,
    problems,
)


@dataclass(frozen=True)
class PressureTable:
    """Pressure that varies linearly between positions along an axis.

    Attributes
    ----------
    positions : tuple of float
        Increasing positions x . axis, m; along the bar in one dimension.
    values : tuple of float
        Pressures there, Pa; constant beyond the ends.
    axis : tuple of float, optional
        Direction of the axis, of any length. The first coordinate if not given.
    """

    positions: tuple[float, ...]
    values: tuple[float, ...]
    axis: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        check_each("pressure.positions", self.positions, FINITE)
        check_each("pressure.values", self.values, NOT_NEGATIVE)
        columns = np.asarray(self.positions), np.asarray(self.values)
        check_columns("pressure.", "positions", "values", *columns)
        if self.axis is not None:
            check_each("pressure.axis", self.axis, FINITE)
        if not np.any((1.0,) if self.axis is None else self.axis):
            raise InputError(f"pressure.axis: found {self.axis}, must be finite, not all zero")

    def along(self, x: FloatArray) -> FloatArray:
        """Position along the axis (m) of the points ``x`` (..., dim)."""
        axis = np.eye(x.shape[-1])[0] if self.axis is None else np.asarray(self.axis, dtype=float)
        return np.asarray(x @ (axis / np.linalg.norm(axis)))

    def __call__(self, x: FloatArray) -> FloatArray:
        """Pressure (Pa) at the points ``x`` (..., dim)."""
        return np.interp(self.along(x), self.positions, self.values)


@dataclass(frozen=True)
class Bolt:
    """A bolt that presses a joint on a ring around its axis.

    Attributes
    ----------
    at : tuple of float
        Position of its axis in the coordinates of the mesh, m; on a bar, the position along the
        bar, and across its width from the middle.
    force : float
        Clamping force, N.
    head_radius, hole_radius : float
        Radius of head or washer, and of the hole, m.
    spreading_angle : float
        Angle between the bolt's axis and the cone of pressure under its head, degrees.
    """

    at: tuple[float, ...]
    force: float
    head_radius: float
    hole_radius: float = 0.0
    spreading_angle: float = 30.0

    def __post_init__(self) -> None:
        if (
            np.ndim(self.at) != 1
            or len(self.at) not in (2, 3)
            or not all(place in FINITE for place in self.at)
        ):
            raise InputError(f"bolt.at: found {self.at}, must be two or three finite numbers")
        hole, where = self.hole_radius, f"bolt at {tuple(self.at)}"
        wider = Kind(f"> hole_radius, {hole}", lambda x: float(hole) < x < math.inf)
        kinds = {
            "force": NOT_NEGATIVE,
            "hole_radius": NOT_NEGATIVE,
            "head_radius": wider if hole in NOT_NEGATIVE else POSITIVE,
            "spreading_angle": Kind("in [0, 90), in degrees", lambda x: 0.0 <= x < 90.0),
        }
        refuse(
            problem
            for name, kind in kinds.items()
            for problem in problems(f"{where}: {name}", getattr(self, name), kind)
        )


@dataclass(frozen=True)
class Bolts:
    """Bolts that press a joint.

    Attributes
    ----------
    bolts : tuple of Bolt
    reach : float
        Depth over which the cone of pressure spreads, from the head to the contact, m.
    """

    bolts: tuple[Bolt, ...]
    reach: float = 0.0

    def __post_init__(self) -> None:
        if not self.bolts:
            raise InputError("bolts: found none, must be at least one")
        check("bolts.reach", self.reach, NOT_NEGATIVE)

    def outer_radius(self, bolt: Bolt) -> float:
        """Outer radius of the ring pressed by a bolt, m."""
        return bolt.head_radius + self.reach * math.tan(math.radians(bolt.spreading_angle))


Pressure: TypeAlias = float | PressureTable | Bolts


def nodal_pressure(
    nodes: FloatArray, cells: IntArray, depth: FloatArray, pressure: Pressure, where: str
) -> tuple[FloatArray, FloatArray, tuple[float, ...]]:
    """Nodal normal forces and areas of a contact.

    Parameters
    ----------
    nodes : ndarray, shape (N, dim)
        Positions, m.
    cells : ndarray of int, shape (c, 2, 3 or 4)
        Linear sub-cells on the nodes.
    depth : ndarray, shape (c,)
        Extent of the contact across the sub-cells, m; 1 for areas.
    pressure : float, PressureTable or Bolts
    where : str
        What a message calls the joint.

    Returns
    -------
    force : ndarray, shape (N,)
        N; they sum to the integral of the pressure, or to the bolts' force.
    area : ndarray, shape (N,)
        m2.
    shares : tuple of float
        Part of each bolt's ring that lies on the contact.
    """
    corners, gather, parent = hat_simplices(nodes, cells)
    deep = depth[parent, np.newaxis]
    area = gather @ (deep * pressure_integrals(corners, 1.0)).ravel()
    shares: tuple[float, ...] = ()
    if isinstance(pressure, Bolts):
        integrals, shares = _bolted(pressure, corners, deep, where)
    else:
        integrals = deep * pressure_integrals(corners, pressure)
    force = gather @ integrals.ravel()
    # Where a pressure ends at the edge of a cell, nodes beyond it must not come into contact.
    return np.where(force > 1e-12 * force.max(initial=0.0), force, 0.0), area, shares


def hat_simplices(
    nodes: FloatArray, cells: IntArray
) -> tuple[FloatArray, sparse.csr_array, IntArray]:
    """Segments or triangles on which the hat functions of linear sub-cells are linear.

    Returns
    -------
    corners : ndarray, shape (n, 2 or 3, dim)
        m.
    gather : sparse array, shape (N, 2 n or 3 n)
        Sums integrals of the simplices' own hats to integrals of the nodes' hats.
    parent : ndarray of int, shape (n,)
        Sub-cell of each simplex.
    """
    n, count = cells.shape
    first = 3 * np.arange(cells.size)
    if count < 4:
        corners, parent = nodes[cells], np.arange(n)
        rows, columns, values = cells.ravel(), np.arange(cells.size), np.ones(cells.size)
    else:
        after = np.roll(cells, -1, axis=1)
        middle = np.repeat(nodes[cells].mean(axis=1)[:, None], 4, axis=1)
        corners = np.stack([nodes[cells], nodes[after], middle], axis=2)
        corners, parent = corners.reshape(-1, 3, nodes.shape[1]), np.repeat(np.arange(n), 4)
        rows = np.concatenate([cells.ravel(), after.ravel(), np.repeat(cells, 4, axis=0).ravel()])
        columns = np.concatenate([first, first + 1, np.repeat(first + 2, 4)])
        values = np.concatenate([np.ones(2 * cells.size), np.full(4 * cells.size, 0.25)])
    shape = (len(nodes), corners.shape[0] * corners.shape[1])
    gather = sparse.csr_array((values, (rows, columns)), shape=shape)
    has_area = np.ones(len(corners), dtype=np.bool_)
    if count == 4:  # of a triangle given as a quadrilateral one of the four has none
        has_area = (cells != after).ravel()
    if has_area.all():
        return corners, gather, parent
    return corners[has_area], gather[:, np.repeat(has_area, 3)], parent[has_area]


def pressure_integrals(corners: FloatArray, pressure: float | PressureTable) -> FloatArray:
    """Exact integrals of pressure times hat function over segments or triangles.

    A table is written as its first value plus ramps that set in at its kinks.

    Parameters
    ----------
    corners : ndarray, shape (n, 2 or 3, dim)
        m.
    pressure : float or PressureTable
        Pa.

    Returns
    -------
    ndarray, shape (n, 2 or 3)
        N/m on segments, N on triangles.
    """
    size, count = measure(corners)[:, np.newaxis], corners.shape[1]
    if not isinstance(pressure, PressureTable):
        return np.repeat(pressure * size / count, count, axis=1)
    position = pressure.along(corners)
    slopes = np.diff(pressure.values) / np.diff(pressure.positions)
    means = np.full(position.shape, pressure.values[0] / count)
    for kink, change in zip(pressure.positions, np.diff([0.0, *slopes, 0.0]), strict=True):
        means += change * _ramp(position - kink)
    return np.asarray(size * means)


def _ramp(f: FloatArray) -> FloatArray:
    """Means over simplices of max(0, f) times each hat; f (n, 2 or 3) are values at the corners.

    If a single corner is positive, max(0, f) is a multiple of a hat on the part of the simplex at
    that corner. If more are positive, max(0, f) = f + max(0, -f).
    """
    n, count = f.shape
    more = np.count_nonzero(f > 0.0, axis=1, keepdims=True) > 1
    whole = np.where(more, f.sum(axis=1, keepdims=True) + f, 0.0)
    g = np.where(more, -f, f)
    rows, lone = np.arange(n), g.argmax(axis=1)
    top = np.maximum(g[rows, lone], 0.0)[:, np.newaxis]
    reach = top / np.where(top > g, top - g, 1.0)  # share of the edges to the others
    reach[rows, lone] = 1.0
    hats = reach.copy()
    hats[rows, lone] = count + 2.0 - reach.sum(axis=1)
    part = reach.prod(axis=1, keepdims=True) * top * hats
    return np.asarray((whole + part) / (count * (count + 1)))


def measure(corners: FloatArray) -> FloatArray:
    """Length of segments (m) or area of triangles (m2), in space of any dimension."""
    sides = corners[:, 1:] - corners[:, :1]
    if corners.shape[1] == 2:
        return np.asarray(np.linalg.norm(sides[:, 0], axis=-1))
    if corners.shape[2] == 2:
        return np.asarray(0.5 * np.abs(np.linalg.det(sides)))
    return np.asarray(0.5 * np.linalg.norm(np.cross(sides[:, 0], sides[:, 1]), axis=-1))


def _bolted(
    bolts: Bolts, corners: FloatArray, depth: FloatArray, where: str
) -> tuple[FloatArray, tuple[float, ...]]:
    """Forces (n, 2 or 3) of bolts on the hats of segments or triangles, and shares of their rings.

    A segment of a bar becomes a strip of its width: two triangles whose corners belong to its ends.
    """
    n, count, dim = corners.shape
    wrong = [bolt.at for bolt in bolts.bolts if len(bolt.at) != max(dim, 2)]
    if wrong:
        raise InputError(f"{where}: bolt.at: found {wrong[0]}, must be {max(dim, 2)} numbers")
    if count == 2 and dim > 1:
        raise InputError(
            f"{where}: bolts press areas; an edge needs a pressure in Pa, constant or as positions "
            "and values"
        )
    centres = np.array([bolt.at for bolt in bolts.bolts], dtype=float)
    if count == 3:
        plane = np.eye(2) if dim == 2 else _frame(corners)
        return bolt_forces(bolts, corners @ plane.T, centres @ plane.T, where)
    end = np.array([[0, 1, 1], [0, 1, 0]])  # of the segment, for each corner of both triangles
    side = np.array([[-0.5, -0.5, 0.5], [-0.5, 0.5, 0.5]])
    strips = np.stack([corners[:, end, 0], depth[:, None] * side], axis=-1)
    forces, shares = bolt_forces(bolts, strips.reshape(-1, 3, 2), centres, where)
    forces = forces.reshape(n, -1)
    return np.stack([forces[:, end.ravel() == i].sum(axis=1) for i in (0, 1)], axis=1), shares


def _frame(corners: FloatArray) -> FloatArray:
    """Two orthogonal unit vectors (2, 3) in the common plane of triangles in space."""
    sides = corners[:, 1:] - corners[:, :1]
    # Normals may have either sign: only the axis counts.
    normals = np.cross(sides[:, 0], sides[:, 1])
    return np.asarray(np.linalg.eigh(normals.T @ normals)[1][:, :2].T)


def disc_moments(triangles: FloatArray, centre: FloatArray, radius: float) -> FloatArray:
    """Integrals of 1, x and y over the parts of triangles inside a disc, shape (n, 3).

    x and y are measured from ``centre``. Triangles (n, 3, 2) may turn either way.
    """
    start = triangles - centre
    along = np.roll(start, -1, axis=1) - start
    squared = np.sum(along**2, axis=-1)
    middle = -np.sum(start * along, axis=-1) / squared
    half = middle**2 - (np.sum(start**2, axis=-1) - radius**2) / squared
    root = np.sqrt(np.maximum(half, 0.0))
    enters = np.where(half > 0.0, np.clip(middle - root, 0.0, 1.0), 0.0)
    leaves = np.where(half > 0.0, np.clip(middle + root, 0.0, 1.0), 0.0)
    first, last = (start + t[..., None] * along for t in (enters, leaves))
    parts = _sectors(start, first, radius) + _fans(first, last)
    parts += _sectors(last, start + along, radius)
    turn = np.sign(_cross(along[:, 0], along[:, 1]))
    return np.asarray(turn[:, None] * parts.sum(axis=1))


def _cross(a: FloatArray, b: FloatArray) -> FloatArray:
    """Cross product of vectors in the plane."""
    return np.asarray(a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0])


def _fans(a: FloatArray, b: FloatArray) -> FloatArray:
    """Area and moments of the triangles between the origin and the segments from a to b."""
    area = 0.5 * _cross(a, b)
    return np.concatenate([area[..., None], area[..., None] * (a + b) / 3.0], axis=-1)


def _sectors(a: FloatArray, b: FloatArray, radius: float) -> FloatArray:
    """Area and moments of the sectors of a disc at the origin between the directions of a and b."""
    angle = np.arctan2(_cross(a, b), np.sum(a * b, axis=-1))
    smallest = np.finfo(float).tiny
    ends = (c / np.maximum(np.linalg.norm(c, axis=-1), smallest)[..., None] for c in (b, a))
    turned = np.subtract(*ends)
    cubed = radius**3 / 3.0
    return np.stack(
        [0.5 * radius**2 * angle, cubed * turned[..., 1], -cubed * turned[..., 0]], axis=-1
    )


def ring_integrals(
    triangles: FloatArray, centre: FloatArray, inner: float, outer: float
) -> FloatArray:
    """Integrals of each corner's hat over the part of a triangle inside a ring, (n, 3), m2."""
    distance = np.linalg.norm(triangles - centre, axis=-1)
    size = np.linalg.norm(triangles - np.roll(triangles, -1, axis=1), axis=-1).max(axis=1)
    near = (distance.min(axis=1) <= outer + size) & (distance.max(axis=1) >= inner)
    corners = triangles[near]
    moments = disc_moments(corners, centre, outer) - disc_moments(corners, centre, inner)
    # hat_k(x) = cross(b - x, c - x) / cross(b - a, c - a), with b and c the corners after k.
    second, third = np.roll(corners, -1, axis=1), np.roll(corners, -2, axis=1)
    double_area = _cross(second - corners, third - corners)
    at_centre = _cross(second - centre, third - centre)
    slope = np.stack([second[..., 1] - third[..., 1], third[..., 0] - second[..., 0]], axis=-1)
    hats = at_centre * moments[:, :1] + np.einsum("nkc,nc->nk", slope, moments[:, 1:])
    integrals = np.zeros(triangles.shape[:2])
    integrals[near] = hats / double_area
    # Smaller ones are the round-off of the differences.
    integrals[integrals < 1e-12 * integrals.max(initial=0.0)] = 0.0
    return integrals


def bolt_forces(
    bolts: Bolts, triangles: FloatArray, centres: FloatArray, where: str
) -> tuple[FloatArray, tuple[float, ...]]:
    """Forces of bolts on the hats of triangles that cover the contact, and shares of their rings.

    Parameters
    ----------
    bolts : Bolts
    triangles : ndarray, shape (n, 3, 2)
        m.
    centres : ndarray, shape (bolts, 2)
        Axes of the bolts in the plane of the triangles, m.
    where : str
        What a message calls the joint.

    Returns
    -------
    forces : ndarray, shape (n, 3)
        N; those of each bolt sum to its force.
    shares : tuple of float
        Part of each bolt's ring that lies on the triangles.

    Raises
    ------
    InputError
        If less than half of a ring lies on the contact.
    """
    least_share = 0.5
    forces = np.zeros(triangles.shape[:2])
    shares, problems = [], []
    for bolt, centre in zip(bolts.bolts, centres, strict=True):
        outer = bolts.outer_radius(bolt)
        ring = ring_integrals(triangles, centre, bolt.hole_radius, outer)
        pressed = float(ring.sum())
        shares.append(pressed / (np.pi * (outer**2 - bolt.hole_radius**2)))
        if shares[-1] >= least_share:
            forces += bolt.force / pressed * ring
            continue
        problems.append(
            f"{where}: of the ring pressed by the bolt at {tuple(bolt.at)}, between the radii "
            f"{bolt.hole_radius:g} and {outer:g} m, {100 * shares[-1]:.3g} % lies on the contact, "
            f"must be at least {100 * least_share:g} %; move the bolt, or check its radii, its "
            "spreading_angle and reach"
        )
    refuse(problems)
    return forces, tuple(shares)
