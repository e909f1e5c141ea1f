"""Bolts that press a joint: uniform pressure on the ring to which a bolt's head spreads its force.

Integrals over a ring are differences of integrals over discs, which are exact on triangles of any
size: the border of a disc's share of a triangle is made of straight pieces and arcs around the
centre, whose contributions to area and first moments are those of triangles and sectors.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from skfem_joint.errors import InputError

FloatArray = NDArray[np.float64]

#: A bolt with a smaller share of its ring on the contact region is a mistake.
_LEAST_SHARE = 0.5
# Integrals below this part of the largest one are round-off of the differences.
_ROUND_OFF = 1e-12


@dataclass(frozen=True)
class Bolt:
    """One bolt.

    Attributes
    ----------
    at : tuple of float
        Position of its axis, m.
    force : float
        Clamping force, N.
    head_radius, hole_radius : float
        Radius of head or washer, and of the hole, m.
    spreading_angle : float
        Angle between the bolt's axis and the cone of pressure under its head, degrees.
    """

    at: tuple[float, float]
    force: float
    head_radius: float
    hole_radius: float = 0.0
    spreading_angle: float = 30.0

    def __post_init__(self) -> None:
        problems = []
        if len(self.at) != 2 or not all(map(math.isfinite, self.at)):
            problems.append(f"bolt.at: found {self.at}, must be two finite numbers")
        where = f"bolt at {tuple(self.at)}"
        if not (self.force >= 0.0 and math.isfinite(self.force)):
            problems.append(f"{where}: force: found {self.force}, must be >= 0")
        if not (self.hole_radius >= 0.0 and math.isfinite(self.hole_radius)):
            problems.append(f"{where}: hole_radius: found {self.hole_radius}, must be >= 0")
        if not (self.head_radius > self.hole_radius and math.isfinite(self.head_radius)):
            problems.append(
                f"{where}: head_radius: found {self.head_radius}, must be > hole_radius, "
                f"{self.hole_radius}"
            )
        if not 0.0 <= self.spreading_angle < 90.0:
            problems.append(
                f"{where}: spreading_angle: found {self.spreading_angle}, must be in [0, 90), in "
                "degrees"
            )
        if problems:
            raise InputError(problems)


@dataclass(frozen=True)
class Bolts:
    """Bolts that press one joint.

    Attributes
    ----------
    bolts : tuple of Bolt
    reach : float
        Depth over which the cone of pressure spreads from the head to the contact, m.
    """

    bolts: tuple[Bolt, ...]
    reach: float = 0.0

    def __post_init__(self) -> None:
        problems = []
        if not self.bolts:
            problems.append("bolts: found none, must be at least one")
        if not (self.reach >= 0.0 and math.isfinite(self.reach)):
            problems.append(f"bolts.reach: found {self.reach}, must be >= 0")
        if problems:
            raise InputError(problems)

    def outer_radius(self, bolt: Bolt) -> float:
        """Outer radius of the ring pressed by a bolt, m."""
        return bolt.head_radius + self.reach * math.tan(math.radians(bolt.spreading_angle))


def disc_moments(triangles: FloatArray, centre: FloatArray, radius: float) -> FloatArray:
    """Area and first moments, about ``centre``, of the part of each triangle inside a disc.

    Parameters
    ----------
    triangles : ndarray, shape (n, 3, 2)
        Corners in either sense of rotation, m.
    centre : ndarray, shape (2,)
    radius : float

    Returns
    -------
    ndarray, shape (n, 3)
        Integrals of 1, x and y (m2, m3, m3).
    """
    start = triangles - centre
    along = np.roll(start, -1, axis=1) - start
    squared = np.sum(along**2, axis=-1)
    middle = -np.sum(start * along, axis=-1) / squared
    half = middle**2 - (np.sum(start**2, axis=-1) - radius**2) / squared
    root = np.sqrt(np.maximum(half, 0.0))
    enters = np.where(half > 0.0, np.clip(middle - root, 0.0, 1.0), 0.0)
    leaves = np.where(half > 0.0, np.clip(middle + root, 0.0, 1.0), 0.0)
    border = [
        start + t[..., None] * along for t in (0.0 * enters, enters, leaves, 1.0 + 0 * leaves)
    ]
    parts = (
        _sectors(border[0], border[1], radius)
        + _fans(border[1], border[2])
        + _sectors(border[2], border[3], radius)
    )
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
    turned = b / np.maximum(np.linalg.norm(b, axis=-1), smallest)[..., None]
    turned = turned - a / np.maximum(np.linalg.norm(a, axis=-1), smallest)[..., None]
    cubed = radius**3 / 3.0
    return np.stack(
        [0.5 * radius**2 * angle, cubed * turned[..., 1], -cubed * turned[..., 0]], axis=-1
    )


def ring_integrals(
    triangles: FloatArray, centre: FloatArray, inner: float, outer: float
) -> FloatArray:
    """Integrals over a ring of the linear hat functions of triangles.

    Parameters
    ----------
    triangles : ndarray, shape (n, 3, 2)
        m.
    centre : ndarray, shape (2,)
    inner, outer : float
        Radii, m.

    Returns
    -------
    ndarray, shape (n, 3)
        Integral of each corner's hat function over the triangle's part in the ring, m2.
    """
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


def bolt_forces(bolts: Bolts, triangles: FloatArray, where: str) -> tuple[FloatArray, FloatArray]:
    """Forces of bolts on the linear hat functions of triangles that cover the contact.

    Parameters
    ----------
    bolts : Bolts
    triangles : ndarray, shape (n, 3, 2)
        m.
    where : str
        Name of the joint, for messages.

    Returns
    -------
    forces : ndarray, shape (n, 3)
        N; those of each bolt sum to its force, whatever the triangles.
    shares : ndarray, shape (bolts,)
        Part of each bolt's ring that lies on the triangles.

    Raises
    ------
    InputError
        For a bolt with less than half its ring on the triangles.
    """
    forces = np.zeros(triangles.shape[:2])
    shares = np.zeros(len(bolts.bolts))
    problems = []
    for number, bolt in enumerate(bolts.bolts):
        outer = bolts.outer_radius(bolt)
        ring = ring_integrals(triangles, np.asarray(bolt.at, float), bolt.hole_radius, outer)
        pressed = float(ring.sum())
        share = pressed / (np.pi * (outer**2 - bolt.hole_radius**2))
        shares[number] = share
        if share < _LEAST_SHARE:
            problems.append(
                f"{where}: of the ring pressed by the bolt at {tuple(bolt.at)}, between the radii "
                f"{bolt.hole_radius:g} and {outer:g} m, {100 * share:.3g} % lies on the contact, "
                f"must be at least {100 * _LEAST_SHARE:g} %; move the bolt, or check its radii, "
                "its spreading_angle and reach"
            )
        else:
            forces += bolt.force / pressed * ring
    if problems:
        raise InputError(problems)
    return forces, shares
