"""Steady vibration: the periodic state of a run under loads that repeat, without its transient.

With constant normal forces friction is monotone: two runs under the same loads never move apart
(in the norm of energy), so that the map from the state at the start of a period to that at its end
is non-expansive, and with damping the periodic velocity is unique. Its fixed point is found by
Anderson's acceleration (D. G. Anderson, J. ACM 12, 1965; H. F. Walker and P. Ni, SIAM J. Numer.
Anal. 49, 2011): the next start is a linear combination of the last states at ends of periods. It
has a safeguard. The change of a state is what a period adds to it; if the change of a combination
is more than twice the least change so far, the search goes back to the plain end state that belongs
to the least change, and plain iteration never makes the change grow. All that a step starts from is
combined with the same coefficients, and no step restarts the scheme: displacement, velocity, and
the scheme's accelerations, which do not follow from the first two where points stick.

Loads that change their sign every half period, as harmonic ones do, have a steady vibration that
does so as well, for friction is odd. There the map is half a period and a change of sign: as
non-expansive, half as long, and of all steady vibrations of Coulomb points, which differ by where
these come to rest, it gives the one without an offset.

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

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from skfem_joint.arrays import FloatArray
from skfem_joint.errors import ConvergenceError
from skfem_joint.modes import is_singular, rigid_motions
from skfem_joint.stepping.schemes import State
from skfem_joint.system import System


@dataclass(frozen=True)
class SteadySettings:
    """Numbers of the search for steady vibration.

    Attributes
    ----------
    change : float
        Largest change of the state over a period, relative to the largest state in the period, in
        the norm of energy.
    energy : float
        Largest change of the energy over a period, over the work put in: it bounds how far a slowly
        decaying part still is from its end.
    periods : int
        Most periods.
    memory : int
        States that are mixed.
    linear : float
        Work of friction over the work put in below which the map is taken for linear.
    linear_memory : int
        States that are mixed then: twice the modes that light damping leaves. (Where points slip so
        many are too many: a bar took 172 periods instead of 53.)
    round_off : float
        Relative singular values of the products of changes that are round-off.
    growth : float
        Largest change over the least one yet that a mixture may have: with 1 a bar that slips as a
        whole took 570 periods instead of 73.
    odd : float
        Share of the largest force by which halves of a period may differ and count as mirror
        images.
    """

    change: float = 1e-6
    energy: float = 2e-4
    periods: int = 2000
    memory: int = 12
    linear: float = 1e-3
    linear_memory: int = 80
    round_off: float = 1e-13
    growth: float = 2.0
    odd: float = 1e-10


SETTINGS = SteadySettings()


@dataclass
class Anderson:
    """Mixes states of a map ``x -> g(x)`` towards its fixed point, in the norm of energy.

    A state is one row of numbers that begins with displacements and velocities.

    Attributes
    ----------
    system : System
    states : list of ndarray
        The last states g(x).
    changes : list of ndarray, shape (2 n,)
        Displacements and velocities of g(x) - x.
    weighted : list of ndarray, shape (2 n,)
        The same times K and M.
    """

    system: System
    states: list[FloatArray] = field(default_factory=list)
    changes: list[FloatArray] = field(default_factory=list)
    weighted: list[FloatArray] = field(default_factory=list)

    def add(self, state: FloatArray, change: FloatArray, memory: int = SETTINGS.memory) -> float:
        """Add g(x) and what it changes of x; the root of twice the energy of that.

        Beside it ``memory`` states are kept.
        """
        n = self.system.n
        self.states.append(state)
        self.changes.append(change[: 2 * n])
        parts = self.system.K @ change[:n], self.system.M @ change[n : 2 * n]
        self.weighted.append(np.concatenate(parts))
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
        differs = squares > SETTINGS.round_off**2 * float(last @ self.weighted[-1])
        scale = np.zeros(count)  # states whose change is that of the last one add nothing
        scale[differs] = 1.0 / np.sqrt(squares[differs])
        gram = (apart @ heavy.T) * np.outer(scale, scale)
        share = scale * np.linalg.lstsq(gram, scale * (heavy @ last), rcond=SETTINGS.round_off)[0]
        return np.append(share, 1.0 - share.sum()) @ np.array(self.states)


def turns_over(amplitudes: FloatArray) -> bool:
    """Whether loads (loads, steps + 1), N, of a period are in its second half minus the first."""
    half = amplitudes.shape[1] // 2
    if amplitudes.shape[1] % 2 == 0:
        return False
    left = np.abs(amplitudes[:, half:] + amplitudes[:, : half + 1]).max(initial=0.0)
    return bool(left <= SETTINGS.odd * np.abs(amplitudes).max(initial=0.0))


def unstrained(system: System) -> FloatArray:
    """Motions (n, k) of unit mass that strain nothing: of bodies that no support holds."""
    if not is_singular(system.K):
        return np.zeros((system.n, 0))
    most = 12  # of two bodies in space
    motions = rigid_motions(system.K, system.M, most)
    while motions.shape[1] == most < system.n:
        most *= 2
        motions = rigid_motions(system.K, system.M, most)
    return motions


class Periodic(NamedTuple):
    """State at the start of a period that ends as it began, but for a rigid displacement.

    Attributes
    ----------
    state : State
    drift : ndarray, shape (n,)
        Rigid displacement in a period, m.
    unstrained : int
        Number of motions that strain nothing.
    """

    state: State
    drift: FloatArray
    unstrained: int


def periodic_state(
    system: System,
    start: State,
    period: Callable[[State], tuple[State, float, float, float]],
    changes: list[float],
    parts: int = 1,
) -> Periodic:
    """Find a state at the start of a period that ends as it began, from ``start``.

    From the state at the start of a period ``period`` gives that at its end, the largest energy (J)
    in it, the energy put in and the work of friction (J). ``changes`` takes the change over each,
    see `SteadySettings.change`. ``parts`` is 2 where ``period`` goes through half of one and
    changes the state's sign then.

    Raises
    ------
    ConvergenceError
        If the search does not converge.
    """
    ends = np.cumsum([part.size for part in start])[:-1]
    mixing, motions = Anderson(system), unstrained(system)
    momenta = system.M @ motions

    def rigid(u: FloatArray) -> FloatArray:
        return np.asarray(motions @ (momenta.T @ u))

    began = rigid(start.u)
    x = plain = np.concatenate(start._replace(u=start.u - began))
    least, left = np.inf, np.inf
    for _ in range(parts * SETTINGS.periods):
        before = State(*np.split(x, ends))
        state, energy, work, friction = period(copied(before))
        memory = SETTINGS.linear_memory if friction <= SETTINGS.linear * work else SETTINGS.memory
        moved = rigid(state.u)
        state = state._replace(u=state.u - moved)
        after = np.concatenate(state)
        gained = system.stored_energy(*state[:2]) - system.stored_energy(*before[:2])
        size, scale = mixing.add(after, after - x, memory), np.sqrt(2.0 * energy)
        left = size / scale if scale > 0.0 else 0.0
        changes.append(left)
        if left <= SETTINGS.change and abs(gained) <= SETTINGS.energy * work:
            if parts == 2:  # half a period, its sign changed: back where it began from there
                began, moved = 0.5 * moved, np.zeros_like(moved)
            return Periodic(state._replace(u=state.u + began), moved, motions.shape[1])
        if size > SETTINGS.growth * least and x is not plain:
            x = plain
            continue
        if size <= least:
            least, plain = size, after
        x = mixing.mixed()
    raise ConvergenceError(
        f"no steady vibration was found in {SETTINGS.periods} periods: the state still changes by "
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
        note += f", change {changes[-1]:.1e} (steady: {SETTINGS.change:.0e})"
    return note


def copied(state: State) -> State:
    """State that later steps, which may work in place, do not change."""
    return State(*(np.array(part) for part in state))
