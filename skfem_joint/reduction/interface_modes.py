"""Fixed-interface modes: natural vibration while no contact point slips, and which of them count.

They stand beside the modes of a joint's slip and beside static responses, as in the method of R. R.
Craig and M. C. C. Bampton, AIAA J. 6 (1968). Every reduced model takes them from here; models
differ in the rule by which they are chosen:

`driven`
    by the largest strain energy that each reaches when the loads drive it (static path);
`beside`
    of those, the ones whose motion other modes do not follow already (static path);
`participating`
    by their part in the static response and in the inertia of given motions (scaled modes);
`up_to`
    all up to a frequency (condensed models).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from scipy import sparse
from scipy.linalg import null_space

from skfem_joint.ground.arrays import FloatArray, Matrix
from skfem_joint.linalg import shifts
from skfem_joint.linalg.factors import factorised
from skfem_joint.linalg.shifts import shifted
from skfem_joint.reduction.excitation import CYCLES, Excitation
from skfem_joint.reduction.pod import orthonormal
from skfem_joint.reduction.substructures import Substructures
from skfem_joint.stepping.arrangement import picks_unknowns
from skfem_joint.system.modal_response import modal_response
from skfem_joint.system.modes import eigenmodes, is_singular, lowest_modes
from skfem_joint.system.rigid import rigid_of
from skfem_joint.system.system import System
from skfem_joint.system.unknowns import congruent

if TYPE_CHECKING:
    from skfem_joint.slow.quasi_static import QuasiStatic


#: Share in the response, relative to the static one, from which on a driven mode counts in the
#: preliminary model of the static path.
LEAST_DRIVEN = 0.004
#: Most driven modes of the preliminary model.
MOST_DRIVEN = 20
#: Relative accuracy of driven modes; that of their frequencies is its square.
TOLERANCE = 1e-06
#: Share in the response, relative to the static one, beyond what other modes follow.
LEAST_BESIDE = 0.01
#: With "auto" the max(FEW_BESIDE, joint modes // MODES_FOR_ONE) modes with the largest shares may
#: stand beside the joint modes of the static path; `beside` drops some of them.
FEW_BESIDE, MODES_FOR_ONE = 2, 6
#: Lowest modes of which `participating` chooses.
CANDIDATES = 40
#: Least share of a candidate, over the largest: the lowest modes of a plate bend it, which a pull
#: does not excite.
LEAST_PARTICIPATING = 0.0001
#: `participating` takes modes up to this many times the loads' highest frequency.
TIMES_FASTEST = 2.0
#: Fewest modes that it takes, and their number if no load has a known frequency.
LEAST_COUNT, UNKNOWN_COUNT = 2, 4
#: Condensed models have the modes up to this many times the loads' highest frequency. 1.5 to 2 is
#: usual for linear structures; friction adds odd harmonics, of which the third counts.
TIMES_HIGHEST = 3.0
#: Fewest modes of a condensed model.
LEAST_UP_TO = 8


def motions_without_slip(system: System, carrying: bool = False) -> sparse.csc_array:
    """Basis F (n, k) of the motions in which no contact point slips.

    Its columns are unit vectors if each slip row picks one unknown, else they are orthonormal.

    Parameters
    ----------
    system : System
    carrying : bool
        Whether only points that carry friction may not slip; the others then move freely, as do
        points whose friction has springs in series: these belong to the stiffness of what sticks,
        `System.stuck_stiffness`.
    """
    B = sparse.csr_array(system.contact.B)
    if carrying:
        held = (system.contact.w > 0.0) & ~system.contact.sprung
        B = B[np.flatnonzero(system.contact.on_rows(held))]
    if picks_unknowns(B):
        free = np.setdiff1d(np.arange(system.n), B.indices)
        return sparse.eye_array(system.n, format="csc")[:, free]
    return sparse.csc_array(null_space(B.toarray(), rcond=1e-9))


@dataclass(frozen=True)
class RestrictedMotion:
    """A structure whose motion is restricted to the columns of a matrix F.

    Attributes
    ----------
    F : sparse array, shape (n, k)
        Motions that are left, such as those without slip.
    K, M : sparse array, shape (k, k)
        Their stiffness and mass.
    strains : bool
        Whether each of them is known to strain something.
    """

    F: Matrix
    K: Matrix
    M: Matrix
    strains: bool = False

    @staticmethod
    def of(system: System, F: Matrix | None = None) -> RestrictedMotion:
        """System restricted to the columns of F; without F to motions in which no point slips."""
        F = motions_without_slip(system) if F is None else F
        K, M = (sparse.csc_array(congruent(A, F)) for A in (system.K, system.M))
        known = rigid_of(system)
        return RestrictedMotion(F, K, M, known is not None and not known.size)

    @property
    def rows(self) -> int:
        """Number of rows of the modes."""
        return int(self.K.shape[0])

    def guessed(self, limit: float) -> int:
        """Number of modes up to a frequency (Hz), and one more, as far as it is known: none."""
        del limit
        return 0

    @cached_property
    def solver(self) -> Callable[[FloatArray], FloatArray]:
        """Solver of K x = f; rigid motions are held a little."""
        K = self.K
        if not self.strains and is_singular(K):
            K = shifted(K, self.M, shifts.LEAST)
        return cast("Callable[[FloatArray], FloatArray]", factorised(K))

    def lowest(
        self,
        count: int,
        solve: Callable[[FloatArray], FloatArray] | None = None,
        tolerance: float = 0.0,
    ) -> tuple[FloatArray, FloatArray]:
        """Lowest natural frequencies (Hz), and modes (k, count) in the columns of F.

        There are fewer if F has fewer columns, and frequencies are zero of rigid motions. See
        `eigenmodes` for ``solve`` and ``tolerance``.
        """
        count = min(count, self.K.shape[0])
        if solve is None:
            return lowest_modes(self.K, self.M, count, tolerance)
        return eigenmodes(self.K, self.M, count, solve, tolerance)


def driven(
    system: System,
    response: FloatArray,
    loads: Excitation,
    most: int = MOST_DRIVEN,
    path: QuasiStatic | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Fixed-interface modes by their shares in the response, the largest share first.

    Each mode is an oscillator that the inertia of the static response drives. Its share is the
    square root of its largest strain energy over that of the static response. The candidates are
    the ``most`` / 2 lowest modes; they become two or four times as many while modes beyond them may
    count. Contact that opens stays closed where it is pressed at rest.

    Parameters
    ----------
    system : System
    response : ndarray, shape (n, loads)
        Static response to the peak of each load, m.
    loads : Excitation
    most : int
        Most modes.
    path : QuasiStatic, optional
        A quasi-static path of the system, which may have the factor for these modes.

    Returns
    -------
    shapes : ndarray, shape (n, k)
    share : ndarray, shape (k,)
    """
    if system.contact.opens:
        T = system.contact.normal.closed_motions()
        shapes, share = driven(system.closed(), T.T @ response, loads, most)
        return np.asarray(T @ shapes), share
    F = motions_without_slip(system)
    if F.shape[1] == 0 or most == 0:
        return np.zeros((system.n, 0)), np.zeros(0)
    restricted, C = RestrictedMotion.of(system, F), sparse.csc_array(congruent(system.C, F))
    solve = None if path is None else path.stuck(F)
    inertia, strain = system.M @ response, np.sqrt(np.sum(response * (system.K @ response)))
    for count in (max(1, most // 2), most, 2 * most):
        frequency, shapes = restricted.lowest(count, solve, TOLERANCE)
        omega = np.maximum(2.0 * np.pi * frequency, np.finfo(float).tiny)
        participation = shapes.T @ (F.T @ inertia)
        left = np.sqrt(max(np.sum(response * inertia) - np.sum(participation**2), 0.0))
        # Modes above the last one move by about the acceleration of their drive over omega^2. That
        # has to be negligible; the factor 2 is a margin.
        if 2.0 * left * loads.fastest**2 <= LEAST_DRIVEN * strain * omega[-1]:
            break
    stop = loads.plan.duration
    stop = stop if loads.period is None else min(stop, CYCLES * loads.period)
    drive = participation @ loads(np.arange(0.0, stop * (1.0 + 1e-9), loads.plan.step))
    damping = np.einsum("ij,ij->j", shapes, C @ shapes)
    # What a mode moves beside the static response is minus the acceleration of an oscillator under
    # the force `drive`; times omega that is the square root of twice its strain energy.
    acceleration = modal_response(omega, damping, drive, loads.plan.step, "acceleration")
    share = omega * np.abs(acceleration).max(axis=1)
    order = np.argsort(-share, kind="stable")[:most]
    return F @ shapes[:, order], share[order] / strain if strain > 0.0 else 0.0 * share[order]


def beside(system: System, V: FloatArray, shapes: FloatArray, share: FloatArray) -> FloatArray:
    """Those of driven modes that count beyond what the columns of V (n, j) follow of them.

    The share (k,) of each mode in the response is reduced to the part of its strain energy that is
    not in the span of V.
    """
    W = orthonormal(V, system.M)
    left = shapes - W @ (W.T @ (system.M @ shapes))
    # Of rigid motions both energies are round-off of either sign.
    size, whole = (
        np.sqrt(np.maximum(np.einsum("ij,ij->j", x, system.K @ x), 0.0)) for x in (left, shapes)
    )
    return shapes[:, share * size > LEAST_BESIDE * whole]


def participating(
    system: System,
    restricted: RestrictedMotion,
    V: FloatArray,
    forces: FloatArray,
    count: str | int,
) -> FloatArray:
    """Fixed-interface modes (n, k) that take part in the response, the lowest ones.

    Parameters
    ----------
    system : System
    restricted : RestrictedMotion
    V : ndarray, shape (n, j)
        Prescribed motions, whose inertia drives the modes.
    forces : ndarray, shape (columns of F, loads)
        Loads in the columns of F, N.
    count : "auto" or int
        Number of modes; "auto": all below twice the loads' highest frequency, at least two, and
        four if no load has a known frequency.
    """
    if count == 0:
        return np.zeros((system.n, 0))
    most = max(CANDIDATES, 0 if isinstance(count, str) else count)
    frequency, shapes = restricted.lowest(most)
    size = np.sqrt(np.einsum("ij,ij->j", V, system.M @ V))
    inertia = shapes.T @ (restricted.F.T @ (system.M @ V)) / np.where(size > 0.0, size, 1.0)
    moves_freely = frequency == 0.0
    static = (shapes.T @ forces / np.where(moves_freely, np.inf, frequency)[:, np.newaxis]) ** 2
    whole = static.sum(axis=0)
    share = (inertia**2).sum(axis=1) + (static / np.where(whole > 0.0, whole, 1.0)).sum(axis=1)
    counting = np.flatnonzero(moves_freely | (share > LEAST_PARTICIPATING * share.max(initial=0.0)))
    if isinstance(count, str):
        fastest = [f for load in system.loads if (f := load.amplitude.highest_frequency)]
        below = frequency[counting] <= TIMES_FASTEST * max(fastest, default=0.0)
        count = max(LEAST_COUNT, int(np.count_nonzero(below)))
        count = count if fastest else UNKNOWN_COUNT
    return np.asarray(restricted.F @ shapes[:, counting[:count]])


def up_to(
    restricted: RestrictedMotion | Substructures,
    highest: float,
    least: int = LEAST_UP_TO,
    first: int = LEAST_UP_TO,
    solving: tuple[Any, ...] = (),
) -> FloatArray:
    """Fixed-interface modes up to three times a frequency (Hz), at least some of them, (k, j).

    ``first`` is how many are computed at first, ``solving`` what their method takes beside.
    """
    n, limit = restricted.rows, TIMES_HIGHEST * highest
    count = max(first, restricted.guessed(limit))
    while True:
        frequency, shapes = restricted.lowest(count, *solving)
        if count >= n or frequency[-1] > limit:
            return shapes[:, : max(least, int(np.count_nonzero(frequency <= limit)))]
        count *= 2
