"""Steady vibration: the periodic state of a run under loads that repeat, without its transient.

With constant normal forces friction is monotone: two runs under the same loads never move apart in
the norm of energy, so that the map from the state at the start of a period to that at its end is
non-expansive, and with damping the periodic velocity is unique. For steps of the trapezoidal rule
this holds exactly for the advanced state (:mod:`skfem_joint.steady.advanced`), in which the
search works. For other schemes it works with all that a step starts from: displacement, velocity
and the scheme's accelerations. Forces of springs in series with friction are part of the state.

Newton's method for the fixed point (shooting) takes the derivative of the map from the tangents of
its steps. It is used where the state is small enough for a dense matrix of it, and the steps are
equal and of the trapezoidal rule. A factor serves for several iterations while it still reduces
the change. Light damping then costs no more periods than heavy damping: measured on a lapped solid
of 34 unknowns at a damping ratio of 2e-3, 3 to 8 half periods a frequency, also at resonance, where
mixing took up to 120.

Anderson's acceleration (D. G. Anderson, J. ACM 12, 1965; H. F. Walker and P. Ni, SIAM J. Numer.
Anal. 49, 2011) is used elsewhere, and where Newton's method does not come closer: the next start is
a linear combination of the last states at ends of periods, or of what a smaller model makes of them
(:mod:`skfem_joint.steady.correction`). It has a safeguard. The change of a
state is what a period adds to it; if the change of a combination is more than twice the least
change so far, the search goes back to the plain end state that belongs to the least change, and
plain iteration never makes the change grow. No step restarts the scheme.

Loads that change their sign every half period, as harmonic ones do, have a steady vibration that
does so as well, for friction is odd. There the map is half a period and a change of sign: as
non-expansive, half as long, and of all steady vibrations of Coulomb points, which differ by where
these come to rest, it gives the one without an offset. Points that stick all the time leave the
derivative of the map over a whole period singular; there the least Newton step is taken.

A body that friction alone holds vibrates in the same way wherever it lies: neither the forces nor
the energy depend on its rigid displacement, so that neither the norm of energy nor the equation of
steady vibration determines it. The rigid displacement is therefore taken out of the state before
each period, and what a period adds to it is the drift. Under loads that change their sign every
half period there is no drift, and the rigid displacement is chosen so that its mean is zero; under
other loads the body lies at the start of the period where it lay at the start of the search. A body
that drifts for ever has a steady velocity, but no steady displacement. Where it really lies depends
on how the vibration began: only a run from the beginning shows that.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from dataclasses import dataclass, field
from typing import NamedTuple, Protocol, TypeAlias

import numpy as np

from skfem_joint.ground.arrays import FloatArray, Matrix
from skfem_joint.ground.errors import ConvergenceError
from skfem_joint.ground.loads import common_period
from skfem_joint.system.modes import is_singular, rigid_motions
from skfem_joint.system.normal import NormalPart
from skfem_joint.system.rigid import rigid_of
from skfem_joint.system.system import System

#: Largest change of the state over a period, relative to the largest state in the period, in the
#: norm of energy.
CHANGE = 1e-6
#: Change, relative like `CHANGE`, that is round-off: no state changes less.
EXACT = 1e-13
#: Largest distance from the fixed point, as Newton's method sees it, relative like `CHANGE`.
DISTANCE = 1e-5
#: Most periods of the search.
PERIODS = 2000
#: States that are mixed.
MEMORY = 12
#: States that are mixed where the map is taken for linear: twice the modes that light damping
#: leaves. (Where points slip so many are too many: a bar took 172 periods instead of 53.)
LINEAR_MEMORY = 80
# Relative singular values of the products of changes that are round-off.
_ROUND_OFF = 1e-13


def settles(left: float, gained: float, energy: float, work: float) -> bool:
    """Whether a change over a period, relative, is small, and the energy that it gains, J.

    ``energy`` is the largest energy in the period and ``work`` what was put in, J.
    """
    # Where less work is put in over a period nothing is seen to decay.
    decays = work > 1e-9 * energy
    # The change of the energy bounds how far a slowly decaying part still is from its end.
    return left <= CHANGE and not (decays and abs(gained) > 2e-4 * work)


@dataclass(frozen=True)
class EnergyNorm:
    """Root of twice an energy of states, rows of numbers that begin with displacement and velocity.

    Attributes
    ----------
    K, M : ndarray or sparse array, shape (n, n)
        Stiffness and mass.
    flexibility : ndarray, shape (s,)
        Of springs in series with friction, m/N, whose forces follow displacement and velocity.
    """

    K: Matrix
    M: Matrix
    flexibility: FloatArray = field(default_factory=lambda: np.zeros(0))

    @property
    def size(self) -> int:
        """How many numbers of a state it sees."""
        return 2 * int(self.M.shape[0]) + self.flexibility.size

    def weighted(self, x: FloatArray) -> FloatArray:
        """Displacements, velocities and forces of springs times K, M and the flexibility."""
        n = self.M.shape[0]
        forces = self.flexibility * x[2 * n : self.size]
        return np.concatenate([self.K @ x[:n], self.M @ x[n : 2 * n], forces])

    def squared(self, x: FloatArray) -> float:
        """Twice the energy of a state, J."""
        return float(x[: self.size] @ self.weighted(x))

    def __call__(self, x: FloatArray) -> float:
        """Norm of a state."""
        return float(np.sqrt(max(self.squared(x), 0.0)))


@dataclass
class Anderson:
    """Mixes states of a map ``x -> g(x)`` towards its fixed point, in the norm of energy.

    A state is one row of numbers that begins with displacements and velocities.

    Attributes
    ----------
    norm : EnergyNorm
    states : list of ndarray
        The last states g(x).
    changes : list of ndarray, shape (2 n + s,)
        Displacements, velocities and forces of springs of g(x) - x.
    weighted : list of ndarray, shape (2 n + s,)
        The same times K, M and the flexibility.
    """

    norm: EnergyNorm
    states: list[FloatArray] = field(default_factory=list)
    changes: list[FloatArray] = field(default_factory=list)
    weighted: list[FloatArray] = field(default_factory=list)

    def add(self, state: FloatArray, change: FloatArray, memory: int = MEMORY) -> float:
        """Add g(x) and what it changes of x; the root of twice the energy of that.

        Beside it ``memory`` states are kept.
        """
        self.states.append(state)
        self.changes.append(change[: self.norm.size])
        self.weighted.append(self.norm.weighted(change))
        for kept in (self.states, self.changes, self.weighted):
            del kept[: -memory - 1]
        return float(np.sqrt(max(float(self.changes[-1] @ self.weighted[-1]), 0.0)))

    def mixed(self) -> FloatArray:
        """Mixture of the g(x) whose change would be least were the map linear between them."""
        last, count = self.changes[-1], len(self.changes) - 1
        if count == 0:
            return self.states[-1]
        apart = last - np.array(self.changes[:-1])
        heavy = self.weighted[-1] - np.array(self.weighted[:-1])
        squares = np.einsum("ij,ij->i", apart, heavy)
        differs = squares > _ROUND_OFF**2 * float(last @ self.weighted[-1])
        scale = np.zeros(count)  # states whose change is that of the last one add nothing
        scale[differs] = 1.0 / np.sqrt(squares[differs])
        gram = (apart @ heavy.T) * np.outer(scale, scale)
        share = scale * np.linalg.lstsq(gram, scale * (heavy @ last), rcond=_ROUND_OFF)[0]
        return np.append(share, 1.0 - share.sum()) @ np.array(self.states)


def turns_over(amplitudes: FloatArray) -> bool:
    """Whether loads (loads, steps + 1), N, of a period are in its second half minus the first."""
    half = amplitudes.shape[1] // 2
    if amplitudes.shape[1] % 2 == 0:
        return False
    left = np.abs(amplitudes[:, half:] + amplitudes[:, : half + 1]).max(initial=0.0)
    return bool(left <= 1e-10 * np.abs(amplitudes).max(initial=0.0))


def odd_loads(system: System) -> bool:
    """Whether the harmonic loads of a system change their sign every half period.

    Then the steady vibration that the search finds is the only one, wherever it starts. With
    contact that opens, which is one-sided, this is never so.
    """
    if system.contact.opens:
        return False
    amplitudes = [load.amplitude for load in system.loads]
    half = 0.5 * (common_period(amplitudes) or 0.0)
    parts = [part.frequency * half for amplitude in amplitudes for part in amplitude.harmonics]
    return all(round(2.0 * turns) % 2 == 1 for turns in parts)


def unstrained(system: System) -> FloatArray:
    """Motions (n, k) of unit mass that strain nothing: of bodies that no support holds.

    They do not move what contact that opens holds either.
    """
    motions = rigid_of(system)
    if motions is None and not is_singular(system.K):
        motions = np.zeros((system.n, 0))
    most = 12  # of two bodies in space
    while motions is None:
        found = rigid_motions(system.K, system.M, most)
        motions = found if found.shape[1] < most or most >= system.n else None
        most *= 2
    return (
        motions if not system.contact.opens else _without_approach(motions, system.contact.normal)
    )


def _without_approach(motions: FloatArray, contact: NormalPart) -> FloatArray:
    """Those combinations of orthonormal motions (n, k) in which no faces approach each other."""
    approach = np.asarray(contact.N @ motions)
    if not motions.shape[1]:
        return motions
    _, sizes, rows = np.linalg.svd(approach, full_matrices=True)
    # A smaller approach over the largest displacement is none.
    rank = int(np.count_nonzero(sizes > 1e-6 * np.abs(motions).max()))
    return np.asarray(motions @ rows[rank:].T)


@dataclass(frozen=True)
class Place:
    """Rigid displacement of states, along motions that strain nothing.

    Attributes
    ----------
    motions, momenta : ndarray, shape (n, k)
        Motions of unit mass, and the mass times them.
    """

    motions: FloatArray
    momenta: FloatArray

    @staticmethod
    def of(system: System) -> Place:
        """Of bodies that no support holds."""
        motions = unstrained(system)
        return Place(motions, np.asarray(system.M @ motions))

    def part(self, u: FloatArray) -> FloatArray:
        """Rigid part of a displacement, (n,), m."""
        return np.asarray(self.motions @ (self.momenta.T @ u))

    def without(self, x: FloatArray) -> FloatArray:
        """State without rigid displacement."""
        x, n = x.copy(), len(self.motions)
        x[:n] -= self.part(x[:n])
        return x


class Passage(NamedTuple):
    """A way through the map.

    Attributes
    ----------
    end : ndarray, shape (k,)
        State at the end.
    energy : float
        Largest energy on the way, J.
    work, friction : float
        Energy put in, and work of friction, J.
    """

    end: FloatArray
    energy: float
    work: float
    friction: float


#: A search yields states for passages to start from, is sent these, and returns its result.
Search: TypeAlias = Generator[FloatArray, Passage, FloatArray]


class Derivative(Protocol):
    """Derivative J of the map where it was gone through last."""

    def step(self, change: FloatArray, held: float) -> FloatArray:
        """Solution (k,) of ``((1 + held) I - J) step = change``: Newton's step if held is zero."""


class PeriodMap(Protocol):
    """The map of a period, or of half of one with a change of sign.

    Attributes
    ----------
    parts : int
        2 where it goes through half a period and changes the sign, else 1.
    patience : int or None
        Passages before Newton's method is tried; None where it is not.
    contact : NormalPart
        Of the system that is stepped.
    norm : EnergyNorm
        Of its states.
    """

    parts: int
    patience: int | None
    contact: NormalPart

    @property
    def norm(self) -> EnergyNorm:
        """See above."""

    def derivative(self) -> Derivative | None:
        """Derivative where it went through last; None if there is none."""

    def corrected(self, change: FloatArray) -> FloatArray | None:
        """Change (k,) as a smaller model corrects it; None without one."""


class Base(NamedTuple):
    """State that a Newton step starts from, what the map changes of it, and the derivative there.

    ``size`` is the norm of the change.
    """

    x: FloatArray
    change: FloatArray
    size: float
    derivative: Derivative


@dataclass
class Newton:
    """Newton's method for the fixed point of a map, held back where it leads astray.

    Full steps are taken first, whatever becomes of the change. If they do not come closer, the
    search goes back to the least change and takes proximal steps: each is Newton's for the state z
    with ``z - g(z) + held (z - x) = 0``, which is unique and near x, and whose change is no larger
    than that of x (R. T. Rockafellar, SIAM J. Control Optim. 14, 1976). It is an implicit step of
    1 / held passages along the transient. ``held`` falls as long as the steps are as good as
    predicted, and rises where they are not.

    Attributes
    ----------
    norm : callable
        Size of a state.
    held : float
        How far steps are held back; zero for full ones.
    tried : int
        Full steps since the least change.
    base : Base, optional
        Where steps start: of full ones that of the least change.
    """

    norm: Callable[[FloatArray], float]
    held: float = 0.0
    tried: int = 0
    base: Base | None = None

    def next(
        self, x: FloatArray, change: FloatArray, derivative: Callable[[], Derivative | None]
    ) -> FloatArray | None:
        """State to try after ``x``, whose change is known; None if there is no derivative."""
        size, base = self.norm(change), self.base
        left = self.norm(self.held * (x - base.x) - change) if self.held and base else 0.0
        if base is not None and self.held and not left <= base.size:
            # Steps that are held back most no longer move a state.
            self.held = min(self.held * 4.0, 1e12)
            return base.x + base.derivative.step(base.change, self.held)
        new = derivative()
        if new is None:
            return None
        if self.held:
            # After a step that is as good as predicted the next is held back less.
            if base is not None and left <= 0.3 * base.size:
                self.held *= 0.2
            self.base = base = Base(x, change, size, new)
        else:
            if base is None or size < base.size:
                self.base, self.tried = Base(x, change, size, new), 0
                base = self.base
            self.tried += 1
            # So many steps in turn may fail to become shorter. Where points begin to slip or to
            # stick the change grows up to fivefold on the way: of 90 frequencies of a lapped solid
            # all converged so, in at most 10 steps, and one did not in 100 with steps that were
            # shortened until the change fell.
            if self.tried <= 8:
                return x + new.step(change, 0.0)
            self.held = 0.1  # at first where full steps fail
        return base.x + base.derivative.step(base.change, self.held)


def periodic_state(
    start: FloatArray, through: PeriodMap, place: Place, changes: list[float]
) -> Search:
    """Find a state at the start of a period that ends as it began, from ``start``.

    The last passage that is asked for ends in it. States are rows of numbers that begin with
    displacements and velocities, (n,) each. ``changes`` takes the change over each passage, see
    `CHANGE`.

    Returns
    -------
    ndarray, shape (n,)
        Rigid displacement that this passage added, m.

    Raises
    ------
    ConvergenceError
        If the search does not converge.
    """
    n, norm, mixing = len(place.motions), through.norm, Anderson(through.norm)
    x = plain = place.without(start)
    least = before = left = np.inf
    newton = Newton(norm)
    known: Derivative | None = None

    def derivative() -> Derivative | None:
        """Derivative of the last passage, or an earlier one that still serves."""
        nonlocal known
        if known is None:
            known = through.derivative()
        return known

    for count in range(through.parts * PERIODS):
        end, energy, work, friction = yield x
        after = place.without(end)
        # The map is taken for linear where friction does so little of the work.
        memory = LINEAR_MEMORY if friction <= 1e-3 * work else MEMORY
        if (step := through.corrected(after - x)) is None:
            size = mixing.add(after, after - x, memory)
        else:
            step, size = place.without(step), norm(after - x)
            mixing.add(x + step, step, memory)
        scale = np.sqrt(2.0 * energy)
        left = size / scale if scale > 0.0 else 0.0
        changes.append(left)
        gained = 0.5 * (norm.squared(after) - norm.squared(x))
        settled = settles(left, gained, energy, work)
        following = through.patience is not None and count >= through.patience
        # A factor is used again where the last iteration reduced the change so far.
        if not (settled or (newton.held == 0.0 and size <= 0.1 * before)):
            known = None
        before = size
        if settled:
            last = mixing.mixed() - x
            if following and (factor := derivative()) is not None:
                last = factor.step(after - x, 0.0)
            if left <= EXACT or norm(last) <= DISTANCE * scale:
                return np.asarray(end[:n] - after[:n])
        if following and (step := newton.next(x, after - x, derivative)) is not None:
            x = place.without(step)
            continue
        # With 1 in place of 2 a bar that slips as a whole took 570 periods instead of 73.
        if size > 2.0 * least and x is not plain:
            x = plain
            continue
        if size <= least:
            least, plain = size, after
        x = mixing.mixed()
    raise ConvergenceError(
        f"no steady vibration was found in {PERIODS} periods: the state still changes by "
        f"{left:.2g} of its size over the last. Is there damping that every motion feels? Light "
        "damping forgets slowly: give more of it, such as [damping] ratio = 1e-3 or above, or try "
        "rho_infinity below 1; or give cycles in place of until = 'steady' and follow the "
        "transient, which at a ratio z of damping falls to a thousandth in about 1 / z of its own "
        "periods"
    )


def note_of(gone: float, changes: list[float]) -> str:
    """Note for whoever watches the search: periods gone through, and the change over the last."""
    note = f"{gone:.1f} periods"
    if changes:
        note += f", change {changes[-1]:.1e} (steady: {CHANGE:.0e})"
    return note
