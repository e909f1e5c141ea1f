"""Bolts that press a joint: uniform pressure on the ring to which a bolt's head spreads its force.

Integrals over a ring are differences of integrals over discs, which are exact on triangles of any
size: the border of a disc's share of a triangle is made of straight pieces and arcs around the
centre, whose contributions to area and first moments are those of triangles and sectors.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from skfem_joint.arrays import FloatArray
from skfem_joint.errors import InputError

# A bolt with a smaller share of its ring on the contact is a mistake; integrals below that part of
# the largest one are round-off of the differences.
_LEAST_SHARE, _ROUND_OFF = 0.5, 1e-12


@dataclass(frozen=True)
class Bolt:
    """One bolt.

    Attributes
    ----------
    at : tuple of float
        Position of its axis in the coordinates of the mesh, m; on a bar, along it and across its
        width, from the middle.
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
        if len(self.at) not in (2, 3) or not all(map(math.isfinite, self.at)):
            raise InputError(f"bolt.at: found {self.at}, must be two or three finite numbers")
        hole = self.hole_radius
        problems = [
            f"bolt at {tuple(self.at)}: {name}: found {getattr(self, name)}, must be {rule}"
            for name, right, rule in (
                ("force", 0.0 <= self.force < math.inf, ">= 0"),
                ("hole_radius", 0.0 <= hole < math.inf, ">= 0"),
                ("head_radius", hole < self.head_radius < math.inf, f"> hole_radius, {hole}"),
                ("spreading_angle", 0.0 <= self.spreading_angle < 90.0, "in [0, 90), in degrees"),
            )
            if not right
        ]
        if problems:
            raise InputError(problems)


@dataclass(frozen=True)
class Bolts:
    """Bolts that press one joint.

    ``reach`` is the depth over which the cone of pressure spreads from head to contact, m.
    """

    bolts: tuple[Bolt, ...]
    reach: float = 0.0

    def __post_init__(self) -> None:
        if not self.bolts:
            raise InputError("bolts: found none, must be at least one")
        if not 0.0 <= self.reach < math.inf:
            raise InputError(f"bolts.reach: found {self.reach}, must be >= 0")

    def outer_radius(self, bolt: Bolt) -> float:
        """Outer radius of the ring pressed by a bolt, m."""
        return bolt.head_radius + self.reach * math.tan(math.radians(bolt.spreading_angle))


def disc_moments(triangles: FloatArray, centre: FloatArray, radius: float) -> FloatArray:
    """Integrals of 1, x and y about ``centre``, (n, 3), over parts of triangles inside a disc.

    Triangles (n, 3, 2) may have either sense of rotation.
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
    """Integrals (n, 3), m2, of each corner's linear hat over a triangle's part in a ring."""
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
    integrals[integrals < _ROUND_OFF * integrals.max(initial=0.0)] = 0.0
    return integrals


def bolt_forces(
    bolts: Bolts, triangles: FloatArray, centres: FloatArray, where: str
) -> tuple[FloatArray, tuple[float, ...]]:
    """Forces (n, 3), N, of bolts on the linear hats of triangles (n, 3, 2) that cover the contact.

    Those of each bolt sum to its force, whatever the triangles. Also the part of each bolt's ring
    that lies on them. ``centres`` (bolts, 2) are the bolts' axes in the plane of the triangles, m.
    """
    forces = np.zeros(triangles.shape[:2])
    shares, problems = [], []
    for bolt, centre in zip(bolts.bolts, centres, strict=True):
        outer = bolts.outer_radius(bolt)
        ring = ring_integrals(triangles, centre, bolt.hole_radius, outer)
        pressed = float(ring.sum())
        shares.append(pressed / (np.pi * (outer**2 - bolt.hole_radius**2)))
        if shares[-1] >= _LEAST_SHARE:
            forces += bolt.force / pressed * ring
            continue
        problems.append(
            f"{where}: of the ring pressed by the bolt at {tuple(bolt.at)}, between the radii "
            f"{bolt.hole_radius:g} and {outer:g} m, {100 * shares[-1]:.3g} % lies on the contact, "
            f"must be at least {100 * _LEAST_SHARE:g} %; move the bolt, or check its radii, its "
            "spreading_angle and reach"
        )
    if problems:
        raise InputError(problems)
    return forces, tuple(shares)
