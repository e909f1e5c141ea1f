"""Balance of harmonics of a system: residual and derivatives of a periodic motion.

With u = Phi q, Phi the modes with stuck and closed contact, Phi^T M Phi = 1, and harmonics
q = q_0 + sum of c_k cos(k w t) + s_k sin(k w t), the residuals of harmonic k are

    (W^2 - k^2 w^2) c_k + k w (C - 2 zeta w) s_k + F_k - f_k,
    (W^2 - k^2 w^2) s_k - k w (C - 2 zeta w) c_k + G_k - g_k,

where W are the natural frequencies of Phi, F and G what contact does beyond its linear part, f and
g the loads. The term in zeta is the force 2 zeta w M du/dt of the extended periodic motion concept
(M. Krack, Comput. Struct. 154, 2015), which keeps a damped mode in steady motion.

Residuals over max(W_j, w), and unknowns times that, are alike in size: modes of the contact reach
megahertz, and the plain norm of residuals stalls Newton's iteration.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import hypot
from typing import NamedTuple

import numpy as np
from scipy import linalg

from skfem_joint.ground.arrays import FloatArray, as_dense
from skfem_joint.ground.errors import InputError
from skfem_joint.harmonic.contact_forces import ContactForces, Sampled
from skfem_joint.harmonic.series import FourierSeries
from skfem_joint.reduction.stuck import Stuck
from skfem_joint.system.system import System

#: Most unknowns of a balance, coefficients times unknowns of the system: an iteration with their
#: dense derivative takes a quarter of a second.
MOST = 1300
#: Most of a balance that judges another one: an iteration takes some two seconds.
LARGEST = 2700
#: Stuck modes among which the one of reference is.
MODES = 30
#: Share of the square of a stuck frequency that springs of sticking are found to take off first,
#: well above round-off, and corrections of these springs, each by what the one before takes.
SOFTENED, SCALINGS = 5e-3, 12
#: Frequency, over that of reference, of soft springs on mean motions that only friction holds.
SOFT = 0.1
#: Squares of frequencies below this share of that of reference are those of free motions.
FREE = 1e-6
#: Ways at contact below this share of the largest slip are round-off.
ALONG = 1e-6


class MotionResidual(NamedTuple):
    """Residual of a motion, in the unknowns q.

    Attributes
    ----------
    values : ndarray, shape (nh, n)
    derivative : ndarray, shape (nh, n, nh, n), or None
        By the coefficients of q.
    by_omega, by_zeta : ndarray, shape (nh, n)
    """

    values: FloatArray
    derivative: FloatArray | None
    by_omega: FloatArray
    by_zeta: FloatArray


@dataclass(frozen=True)
class Balance:
    """Balance of harmonics of one system.

    Attributes
    ----------
    system : System
        Its own contact with the springs of ``factor``.
    series : FourierSeries
    Phi : ndarray, shape (n, n)
        Modes with stuck and closed contact, of unit mass.
    frequencies : ndarray, shape (n,)
        Of these, rad/s.
    C : ndarray, shape (n, n)
        Damping of q.
    soft : ndarray, shape (n, n)
        Of soft springs on the mean of q; zero where all motions are held.
    contact : ContactForces
    reference : float
        rad/s.
    walks : bool
        Whether motions that nothing holds go on by the same way in each period, in place of the
        soft springs. Their mean in q is that way then, and friction without a mean force tells it.
    """

    system: System
    series: FourierSeries
    Phi: FloatArray
    frequencies: FloatArray
    C: FloatArray
    soft: FloatArray
    contact: ContactForces
    reference: float
    walks: bool = False

    @classmethod
    def of(cls, system: System, series: FourierSeries, reference: float, factor: float) -> Balance:
        """Balance of a system near an angular frequency of ``reference``, rad/s.

        ``factor`` is that of the springs of rigid sticking, see `springs_of_sticking`.

        Raises
        ------
        InputError
            If the system is too large, or contact that opens is rigid.
        """
        check_size(system, series)
        contact = system.contact
        if contact.normal.rigid.any():
            raise InputError(
                "harmonic balance: found rigid contact that opens, must be elastic: give a model "
                "of sj.reduce, in which it is"
            )
        M, C, K = (as_dense(A) for A in (system.M, system.C, system.K))
        springs = springs_of_sticking(system, reference, factor)
        B = as_dense(contact.B)
        k = contact.on_rows(np.where(contact.w > 0.0, springs, 0.0))
        closed = K + as_dense(contact.normal.springs)
        stuck = closed + (B.T * k) @ B
        squares, Phi = linalg.eigh(0.5 * (stuck + stuck.T), M)
        # What nothing holds once all slips. Contact pressed at rest holds its mean place where it
        # opens, too, by its mean normal force, of which a soft spring would take a part.
        _, shapes = linalg.eigh(closed, M, subset_by_value=(-np.inf, FREE * reference**2))
        momenta = Phi.T @ (M @ shapes)
        return cls(
            system=replace(system, contact=replace(contact, stiffness=springs)),
            series=series,
            Phi=Phi,
            frequencies=np.sqrt(np.maximum(squares, 0.0)),
            C=Phi.T @ C @ Phi,
            soft=(SOFT * reference) ** 2 * momenta @ momenta.T,
            contact=ContactForces.of(contact, springs, Phi),
            reference=reference,
        )

    def refined(self, series: FourierSeries) -> Balance:
        """Same balance of another series, of any size."""
        return replace(self, series=series)

    def size(self, series: FourierSeries) -> int:
        """Unknowns of a balance of another series."""
        return series.size * self.system.n

    @property
    def scale(self) -> FloatArray:
        """Frequencies, (n,), that residuals are over and unknowns times, rad/s."""
        return np.maximum(self.frequencies, self.reference)

    def rows(self, size: float) -> FloatArray:
        """What makes residuals (nh n,) of motions with the norm ``size`` by the mass of size 1."""
        return np.tile(1.0 / (self.scale * size * self.reference), self.series.size)

    def metric(self, size: float) -> FloatArray:
        """Weights (nh n,) of squares of changes over ``size``, by the mass, without the mean."""
        weights = np.full((self.series.size, self.frequencies.size), size**-2)
        weights[: self.series.first] = 0.0
        return weights.ravel()

    def inner(self, u: FloatArray) -> FloatArray:
        """Coefficients (nh, n) of q, from those of the unknowns of the system."""
        return np.asarray(u @ as_dense(self.system.M) @ self.Phi)

    def outer(self, q: FloatArray) -> FloatArray:
        """Coefficients (nh, n) of the unknowns of the system, m."""
        return np.asarray(q @ self.Phi.T)

    @property
    def free(self) -> FloatArray:
        """Projector (n, n) on the motions that soft springs hold."""
        return self.soft / (SOFT * self.reference) ** 2

    def parted(self, q: FloatArray) -> tuple[FloatArray, FloatArray | None]:
        """Periodic part (nh, n) of a motion, and its way in a period, (n,), if it walks."""
        if not self.walks:
            return q, None
        still, way = q.copy(), self.free @ q[0]
        still[0] -= way
        return still, way

    def walked(self, q: FloatArray) -> float:
        """Largest way of a degree of freedom in a period, m."""
        way = self.parted(q)[1]
        return 0.0 if way is None else self._reach(way)

    def goes_on(self, q: FloatArray) -> bool:
        """Whether a motion that walks may go on: points on its way slip, none comes closer."""
        way, contact = self.parted(q)[1], self.contact
        if way is None:
            return False
        slips = int(contact.points.first_row[-1])
        along, closer = np.split(np.abs(contact.rows @ way), [slips])
        least = ALONG * along.max(initial=0.0)
        holds = np.repeat(~self.sampled(q, False).moves, contact.directions)
        return not ((along > least) & holds).any() and not (closer > least).any()

    def _reach(self, a: FloatArray) -> float:
        """Largest change of a degree of freedom of the structure where q changes by ``a``, (n,)."""
        return float(np.abs(self.system.expand(self.outer(a))).max())

    def sampled(self, q: FloatArray, tangents: bool) -> Sampled:
        """Contact in the motion with coefficients ``q``, (nh, n)."""
        still, way = self.parted(q)
        return self.contact.sampled(self.series, still, tangents, way)

    def residual(
        self,
        q: FloatArray,
        omega: float,
        zeta: float = 0.0,
        force: FloatArray | None = None,
        tangents: bool = True,
    ) -> MotionResidual:
        """Residual of a motion.

        Parameters
        ----------
        q : ndarray, shape (nh, n)
        omega : float
            Angular frequency, rad/s.
        zeta : float
            Of the force that keeps a damped mode in motion.
        force : ndarray, shape (nh, n), optional
            Coefficients of the loads on q, ``Phi.T`` times those on the unknowns.
        tangents : bool
            Whether the derivative by q is wanted.
        """
        series, n = self.series, q.shape[1]
        still, way = self.parted(q)
        sampled = self.contact.sampled(series, still, tangents, way)
        order = series.coefficient_orders[:, np.newaxis]
        rate, stiff = series.rate(q), self.frequencies**2 - (order * omega) ** 2
        damped = rate @ self.C
        values = stiff * still + sampled.force
        values += omega * damped - 2.0 * zeta * omega**2 * rate
        if force is not None:
            values -= force
        by_omega = -2.0 * omega * order**2 * q + damped - 4.0 * zeta * omega * rate
        if way is not None:
            by_omega[0] += self.C @ way / (2.0 * np.pi)
            values[0] += omega * (self.C @ way) / (2.0 * np.pi)
        elif not series.odd:
            values[0] += self.soft @ q[0]
        derivative = sampled.derivative
        if derivative is not None:
            every, own = np.arange(series.size)[:, np.newaxis], np.arange(n)
            derivative, by_way = derivative[:, :, : series.size], derivative[:, :, series.size :]
            derivative[every, own, every, own] += stiff
            damping = omega * self.C - 2.0 * zeta * omega**2 * np.eye(n)
            by_order = series.orders[:, np.newaxis, np.newaxis] * damping
            cosines = np.arange(series.first, series.size, 2)
            derivative[cosines, :, cosines + 1] += by_order
            derivative[cosines + 1, :, cosines] -= by_order
            if way is not None:
                derivative = derivative.copy()
                derivative[:, :, 0] += (by_way[:, :, 0] - derivative[:, :, 0]) @ self.free
                derivative[0, :, 0] += omega * (self.C @ self.free) / (2.0 * np.pi)
            elif not series.odd:
                derivative[0, :, 0] += self.soft
        return MotionResidual(values, derivative, by_omega, -2.0 * omega**2 * rate)

    def held_softly(self, q: FloatArray) -> float:
        """Force of the soft springs over the sum of friction limits at rest.

        Where there are none it is over the normal forces at rest, or else over the inertia. Forces
        are those on the degree of freedom that moves most whose power is that of all.
        """
        if self.series.odd or self.walks or not self.soft.any():
            return 0.0
        contact = self.system.contact
        wholes = contact.w.sum(), contact.normal.force.sum(), self.inertia(q)
        return self._force(self.soft @ q[0]) / float(next((x for x in wholes if x > 0.0), np.inf))

    def inertia(self, q: FloatArray) -> float:
        """Force, N, of the first harmonic of a motion at the frequency of reference."""
        first = self.series.first
        return hypot(*(self._force(self.reference**2 * x) for x in q[first : first + 2]))

    def _force(self, a: FloatArray) -> float:
        """Force, N, of accelerations ``a`` of q, whatever the unknowns of the system are."""
        return float(a @ a) / self._reach(a) if a.any() else 0.0


def check_size(system: System, series: FourierSeries) -> None:
    """Refuse a balance that is too large."""
    size = series.size * system.n
    if size > MOST:
        raise InputError(
            f"harmonic balance: found {system.n} unknowns, with {series.size} coefficients of each "
            f"{size} in all, must be at most {MOST}: their derivative is a dense matrix. Give a "
            "reduced model, such as sj.reduce(system, curve=...), or fewer harmonics"
        )


def stuck_modes(system: System, count: int) -> tuple[FloatArray, FloatArray]:
    """Lowest modes with stuck and closed contact: rad/s, and shapes (n, modes) of unit mass."""
    frequencies, shapes = Stuck(system.closed()).modes(count)
    return 2.0 * np.pi * frequencies, shapes


def springs_of_sticking(system: System, reference: float, factor: float) -> FloatArray:
    """Springs in series with the friction of all points, (m,), N/m: their own, or stiff ones.

    Those of points without a spring are in proportion to the stiffness that the structure itself
    opposes to their slip, b (K + r^2 M)^-1 b^T inverted, r the frequency of ``reference``. They
    lower the square of the frequency of the stuck mode there by some one over ``factor``.
    """
    contact = system.contact
    own_springs = np.where(contact.rubs, contact.stiffness, 1.0)
    rigid = contact.rubs & np.isinf(own_springs)
    if not rigid.any():
        return np.asarray(own_springs)
    B, M = as_dense(contact.B), as_dense(system.M)
    closed = as_dense(system.closed().stuck_stiffness)
    soft = linalg.cho_solve(linalg.cho_factor(closed + reference**2 * M), B.T)
    flexibility = contact.by_point((B * soft.T).sum(axis=1)) / contact.directions
    # Rows of points that the modes do not move are round-off, which no spring shall resist.
    least = max(1e-16 * flexibility[rigid].max(), 1e-300)
    springs = np.where(rigid, 1.0 / np.maximum(flexibility, least), 0.0)
    frequencies, shapes = stuck_modes(system, MODES)
    mode = int(np.abs(frequencies - reference).argmin())
    acting = contact.on_rows(np.where(contact.w > 0.0, springs, 0.0))
    loose = as_dense(system.closed().K)
    scale = 1.0
    for _ in range(SCALINGS):
        squares, found = linalg.eigh(loose + (B.T * (scale * acting)) @ B, M)
        own = int(np.abs(found.T @ (M @ shapes[:, mode])).argmax())
        softer = 1.0 - squares[own] / frequencies[mode] ** 2
        scale *= float(np.clip(softer / SOFTENED, 0.1, 10.0))
    return np.where(rigid, factor * SOFTENED * scale * springs, own_springs)
