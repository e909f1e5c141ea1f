"""Gaps of joints at rest: numbers, functions of the place, and measured topography.

A gap is a number, or a sum of surfaces, each of which says at any place of the face how far the
faces are apart there. Gaps of heights, and those whose best-fit plane is taken out, are known up to
a constant alone, which is that with which the faces touch, at the contact point where they are
nearest to each other.

The mesh knows of a gap what it has in common with the hats of the pressure points, its projection
on them in the mean square: contact takes means over hats, :mod:`skfem_joint.joint.pressure_space`.
`Resolution` says how much that is.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from scipy import linalg, sparse

from skfem_joint.ground.arrays import FloatArray, as_real
from skfem_joint.ground.errors import InputError
from skfem_joint.joint.scans import NodeField, Scan

#: What a joint takes as its gap beside a number: a function of the places (k, dim) gives gaps (k,).
Surface: TypeAlias = Callable[[FloatArray], FloatArray] | Scan | NodeField
Gap: TypeAlias = float | Surface | Sequence[Surface]


def surfaces(gap: Gap) -> tuple[Surface, ...]:
    """Surfaces whose sum is a gap; none for a number."""
    if isinstance(gap, Scan | NodeField) or callable(gap):
        return (gap,)
    return tuple(gap) if isinstance(gap, Sequence) else ()


def is_surface(given: object) -> bool:
    """Whether something is a surface."""
    return isinstance(given, Scan | NodeField) or callable(given)


def gaps_at(parts: Sequence[Surface], x: FloatArray, normal: FloatArray, where: str) -> FloatArray:
    """Sum of surfaces at points of a face, (k,), m, but for a constant if it has heights.

    Parameters
    ----------
    parts : sequence of surfaces
    x, normal : ndarray, shape (k, dim)
        Points, m, and the face's normals there.
    where : str
        What a message calls the joint.
    """
    total = np.zeros(len(x))
    for part in parts:
        if isinstance(part, Scan | NodeField):
            try:
                total += part.at(x, normal)
            except InputError as error:
                raise InputError([f"{where}: gap: {line}" for line in error.problems]) from error
            continue
        values = np.asarray(as_real(part(x), f"{where}: gap"))
        if values.shape != (len(x),) or not np.isfinite(values).all():
            raise InputError(
                f"{where}: gap: the function gave values of shape {values.shape} for places of "
                f"shape {x.shape}, must be {(len(x),)} and finite"
            )
        total += values
    return total


def is_relative(parts: Sequence[Surface]) -> bool:
    """Whether the sum of surfaces is known up to a constant alone: one of heights is."""
    return any(isinstance(part, Scan | NodeField) and part.kind == "height" for part in parts)


def without_plane(
    values: FloatArray, x: FloatArray, normal: FloatArray, weight: FloatArray
) -> FloatArray:
    """Values at points (k,) less the plane that fits them best, by weights (k,)."""
    along = linalg.null_space((weight @ normal)[np.newaxis])
    centre = weight @ x / weight.sum()
    plane = np.column_stack([np.ones(len(x)), (x - centre) @ along / np.ptp(x, axis=0).max()])
    root = np.sqrt(weight)
    fitted = linalg.lstsq(plane * root[:, np.newaxis], values * root)[0]
    return np.asarray(values - plane @ fitted)


@dataclass(frozen=True)
class Resolution:
    """How much of a gap the contact points of a mesh resolve.

    It is known at the points of quadrature, three in the length of a sub-cell: of what is finer
    the rest is a sample, which the hats fit in part, so that it is said too small by up to a third.

    Attributes
    ----------
    whole, resolved, rest : float
        Root mean squares over the face, m, without the mean: of the gap, of what of it the mesh has
        (its best fit by the hats of the contact points), and of what is left.
    largest : float
        Largest gap, m.
    length : float
        Largest extent of the face, m.
    """

    whole: float
    resolved: float
    rest: float
    largest: float
    length: float

    @property
    def lost(self) -> float:
        """Share of the root mean square that the mesh does not have."""
        return self.rest / self.whole if self.whole > 0.0 else 0.0

    @staticmethod
    def of(
        values: FloatArray, x: FloatArray, hats: sparse.csr_array, weight: FloatArray
    ) -> Resolution:
        """Resolution of a gap at quadrature points.

        Parameters
        ----------
        values : ndarray, shape (k,)
            m.
        x : ndarray, shape (k, dim)
            m.
        hats : sparse array, shape (nodes, k)
            Values of the hats of the contact points.
        weight : ndarray, shape (k,)
            Weights of quadrature, m2.
        """
        deviation = values - weight @ values / weight.sum()
        tests = sparse.csr_array(hats @ sparse.diags_array(weight))
        mass = sparse.csr_array(tests @ hats.T)
        inverse = sparse.diags_array(1.0 / mass.diagonal())
        # Conjugate gradients also end where a hat has fewer points than it needs.
        fit, _ = sparse.linalg.cg(mass, tests @ deviation, rtol=1e-10, M=inverse)
        between = hats.T @ fit
        whole, resolved, rest = (
            float(np.sqrt(weight @ part**2 / weight.sum()))
            for part in (deviation, between, deviation - between)
        )
        return Resolution(
            whole, resolved, rest, float(values.max()), float(np.ptp(x, axis=0).max())
        )
