"""Equations of a forced periodic motion, at a level of the loads or at a frequency.

Unknowns are the coefficients of q and the parameter: the angular frequency, or the level. A branch
over frequency is followed by its arc length in the metric

    ds^2 = (d omega / grid)^2 + |dq|^2 / (0.2 |q|)^2,

with the norm of q by the mass, without its mean: offsets, which hardly change anything else, and
modes of the contact, at megahertz, would dominate others. (In the metric of all unknowns it stalls
where offsets grow, in that of the first harmonic where slip ends.)
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from skfem_joint.ground.arrays import FloatArray
from skfem_joint.ground.errors import ConvergenceError
from skfem_joint.ground.loads import harmonic_factors
from skfem_joint.harmonic.balance import Balance
from skfem_joint.harmonic.newton import CHANGE, BranchPoint, by_parameter, eased
from skfem_joint.harmonic.series import FourierSeries
from skfem_joint.system.system import System

#: Share of the frequency in a step of length 1 below which a branch is about to turn.
STEEP = 0.05


@dataclass(frozen=True)
class Forced:
    """Forced motion of a system, whose parameter is the angular frequency.

    Attributes
    ----------
    balance : Balance
    load : ndarray, shape (nh, n)
        Coefficients of the loads on q.
    grid : float
        Mean distance of the angular frequencies asked for, rad/s.
    level : float
        Of the loads.
    """

    balance: Balance
    load: FloatArray
    grid: float
    level: float = 1.0

    @classmethod
    def of(cls, balance: Balance, system: System, grid: float) -> Forced:
        """From harmonic loads."""
        return cls(balance, load_of(system, balance.series) @ balance.Phi, grid)

    def refined(self, series: FourierSeries) -> Forced:
        """Same equations of another series, which has the harmonics of the loads."""
        load = series.of(self.load, self.balance.series)
        return replace(self, balance=self.balance.refined(series), load=load)

    def walking(self, walks: bool) -> Forced:
        """Same equations, in which bodies walk that nothing holds, or do not."""
        return replace(self, balance=replace(self.balance, walks=walks))

    @property
    def unique(self) -> bool:
        """Whether there is one vibration at each frequency: with constant contact."""
        return not self.balance.system.contact.opens

    @property
    def force(self) -> FloatArray:
        """Coefficients (nh, n) of the loads on q at the level."""
        return self.level * self.load

    def at(self, level: float) -> Forced:
        """Same at another level."""
        return replace(self, level=level)

    def __call__(self, x: FloatArray, tangents: bool) -> tuple[FloatArray, FloatArray]:
        """See `Equations`."""
        q = x[:-1].reshape(self.load.shape)
        found = self.balance.residual(q, float(x[-1]), force=self.force, tangents=tangents)
        return found.values.ravel(), _joined(found.derivative, found.by_omega)

    def rows(self, x: FloatArray) -> FloatArray:
        """See `Equations`."""
        return self.balance.rows(float(np.linalg.norm(x[:-1])) or 1.0)

    def metric(self, x: FloatArray) -> FloatArray:
        """See `Equations`."""
        of_motion = self.balance.metric(CHANGE * float(np.linalg.norm(x[:-1])))
        return np.append(of_motion, self.grid**-2)


@dataclass(frozen=True)
class Raised:
    """Forced motion at an angular frequency, rad/s, whose parameter is the level of the loads.

    Attributes
    ----------
    forced : Forced
    omega : float
    size : float
        Norm of the motion by the mass that counts as a change of 1.
    """

    forced: Forced
    omega: float
    size: float = 1.0

    @property
    def unique(self) -> bool:
        """See `Equations`."""
        return self.forced.unique

    def __call__(self, x: FloatArray, tangents: bool) -> tuple[FloatArray, FloatArray]:
        """See `Equations`."""
        load = self.forced.load
        q, force = x[:-1].reshape(load.shape), float(x[-1]) * load
        found = self.forced.balance.residual(q, self.omega, force=force, tangents=tangents)
        return found.values.ravel(), _joined(found.derivative, -load)

    def rows(self, x: FloatArray) -> FloatArray:
        """See `Equations`."""
        return self.forced.balance.rows(self.size)

    def metric(self, x: FloatArray) -> FloatArray:
        """See `Equations`."""
        return np.append(self.forced.balance.metric(self.size), 0.0)


def _joined(derivative: FloatArray | None, by_last: FloatArray) -> FloatArray:
    """Derivative by a motion and the last unknown; empty if it is not known."""
    if derivative is None:
        return np.zeros((0, 0))
    return np.column_stack([derivative.reshape(by_last.size, by_last.size), by_last.ravel()])


def load_of(system: System, series: FourierSeries) -> FloatArray:
    """Coefficients (nh, n) of the loads of a system, N."""
    force, vectors = np.zeros((series.size, system.n)), system.load_vectors()
    for order, factors in harmonic_factors([load.amplitude for load in system.loads]).items():
        a = series.first + 2 * int(np.searchsorted(series.orders, order))
        force[a], force[a + 1] = vectors @ factors.real, -(vectors @ factors.imag)
    return force


def corrected(forced: Forced, place: BranchPoint) -> BranchPoint:
    """Point of other equations near a place, of its frequency unless the branch turns about there.

    ConvergenceError if there is none.
    """
    weights = forced.metric(place.x)
    steep = STEEP * forced.grid * np.sqrt(place.along @ (weights * place.along))
    if place.asked or forced.unique or abs(place.along[-1]) > steep:
        try:
            point = eased(forced, place.x, by_parameter(place.x.size))
            return place._replace(q=point.x[:-1].reshape(place.q.shape))
        except ConvergenceError:  # beyond the turning point of a coarser series
            if forced.unique:
                raise
    point = eased(forced, place.x, weights * place.along)
    q, rest = point.x[:-1].reshape(place.q.shape), point.x[-1:]
    return place._replace(q=q, rest=rest, asked=False)
