"""The step problem: the strictly convex minimisation that every implicit step is.

    minimise over v:   1/2 v H v - g v + sum_p w_p psi(|(B v)_p|)

H is symmetric positive definite, B v are the slips of the contact points, w the friction limits and
psi the potential of the law (:mod:`skfem_joint.minimise.law`). Time steps have the step matrix for
H and the velocity for v. Restarts, which find the acceleration at the start of a run and after a
jump of a load, have the mass and the acceleration, and only points at rest slip. Quasi-static
increments have the stiffness and the increment of displacement.

`StepProblem` is what its solvers have in common, `CompiledStepProblem` those that the compiled loop
over time steps calls; :func:`skfem_joint.stepping.arrangement.step_problem` chooses the method.

A spring in series with the friction of a point changes its psi (to the Moreau envelope, which is
convex too), and its slip counts from the offset at which the spring would be without force:

    psi_soft(|(B v)_p - offset_p|),

with the point's compliance ``soft`` = w ``flexible``, see :mod:`skfem_joint.minimise.law`. In a
step the slip moves by a known part plus c B v, with c = c_K of the scheme, or 1 where the unknown
is the increment of displacement. With the spring's stiffness k and force q before,

    flexible = 1 / (k c),    offset = -(known + q / k) / c,

the force of the point is that of its law at the end of the step: q + k (known + c B v - z) with the
slip z of the slider, whose rate is z over the step's length. (The slider is stepped by the implicit
Euler method. With the trapezoidal rule its velocity would ring for ever after each reversal.)

Contact that opens adds a convex term of the approach N v at each pressure point,

    phi_c(N_c v):   0 up to a bound,  beyond it inf (rigid) or stiffness / 2 (N_c v - bound)^2,

whose slope is the normal force p >= 0. The friction limits then follow it, w = max(0, given + gain
p), which is no part of the minimisation: the solution is a fixed point of w -> p -> w.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING, Any, ClassVar, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from skfem_joint.ground.arrays import (
    BoolArray,
    FloatArray,
    IntArray,
    Matrix,
    check_like,
    slip_norms,
)
from skfem_joint.linalg.factors import factorised
from skfem_joint.system.system import System

if TYPE_CHECKING:
    from skfem_joint.minimise.limits import Hinges

#: Accepted residual in units of the forces that are added up.
ROUND_OFF = 16 * float(np.finfo(np.float64).eps)


@dataclass(frozen=True)
class Minimum:
    """Result of a minimisation.

    Attributes
    ----------
    v : ndarray, shape (n,)
        Minimiser: velocity (m/s), acceleration or increment of displacement.
    sigma : ndarray, shape (rows,)
        Normalised friction force of each row of B.
    converged : bool
        Whether the force residual is within the tolerance, or within its round-off. Never true
        where anything is not finite.
    counts : dict
        Work done, by names of :class:`skfem_joint.stepping.recording.Counters`.
    residual : float
        Largest force residual, N.
    where : int
        Unknown at which it is.
    p : ndarray, shape (q,)
        Normal force of each pressure point, N; none where no contact opens.
    w : ndarray, shape (m,)
        Friction limits, N: those of the normal forces ``p`` where contact opens.
    """

    v: FloatArray
    sigma: FloatArray
    converged: bool
    counts: dict[str, int] = field(default_factory=dict)
    residual: float = 0.0
    where: int = 0
    p: FloatArray = field(default_factory=lambda: np.zeros(0))
    w: FloatArray = field(default_factory=lambda: np.zeros(0))

    @staticmethod
    def of(
        outcome: StepOutcome, v: FloatArray, sigma: FloatArray, points: ContactPoints
    ) -> Minimum:
        """Of a compiled minimisation with constant friction limits."""
        converged, *work, residual, where = outcome
        counts = dict(zip(StepOutcome._fields[1:-2], map(int, work), strict=True))
        converged, residual = bool(converged), float(residual)
        return Minimum(v.copy(), sigma, converged, counts, residual, int(where), w=points.w)


@dataclass(frozen=True)
class PressurePoints:
    """Pressure points of a step problem with contact that opens.

    Attributes
    ----------
    N : ndarray or sparse array, shape (q, n)
        Mean approach of the faces at each pressure point from the unknowns.
    gain : ndarray or sparse array, shape (m, q)
        Friction limit of each contact point by the force of each pressure point.
    stiffness : ndarray, shape (q,)
        Of each pressure point, in N over the unit of v times that of N; ``inf`` is rigid.
    """

    N: Matrix
    gain: Matrix
    stiffness: FloatArray


class Pressed(NamedTuple):
    """What a minimisation is given where contact opens.

    Attributes
    ----------
    bound : ndarray, shape (q,)
        Largest approach of each pressure point, in the unit of v; ``inf`` where there is none.
    given : ndarray, shape (m,)
        Friction limits without normal forces, N; they may be negative.
    gain : float or ndarray, shape (q,)
        Factors of the normal forces: w = max(0, given + (matrix ``gain``) (factors p)).
    hinges : Hinges, optional
        How friction follows the forces of rigid points; as above if not given.
    touching : skfem_joint.minimise.touching.Touching, optional
        Pressure points that touch: others are eliminated. It follows what is found to touch.
    """

    bound: FloatArray
    given: FloatArray
    gain: FloatArray | float = 1.0
    hinges: Hinges | None = None
    touching: Any = None


@dataclass(frozen=True)
class ContactPoints:
    """Contact points of a step problem.

    Attributes
    ----------
    B : ndarray or sparse array, shape (rows, n)
        Slips from the unknowns; the rows of a point follow each other.
    directions : ndarray of int, shape (m,)
        Rows of each point, 1 or 2.
    w : ndarray, shape (m,)
        Friction limits, N; points with limit zero have no friction. They are those of each
        minimisation where contact opens.
    beta : ndarray, shape (m,)
        Steepness of the law, s/m; ``inf`` is Coulomb.
    flexible : ndarray, shape (m,), optional
        Slip that the spring in series takes under a unit force, in the unit of v over N, zero for
        none; no springs if not given.
    normal : PressurePoints, optional
        Of contact that opens; normal forces are constant if not given.
    """

    B: Matrix
    directions: NDArray[np.int64]
    w: FloatArray
    beta: FloatArray
    flexible: FloatArray | None = None
    normal: PressurePoints | None = None

    @staticmethod
    def of(system: System, moved: float = 1.0, lasts: float | None = None) -> ContactPoints:
        """Contact points of a system.

        Parameters
        ----------
        system : System
        moved : float
            Slip in a step for each unit of the unknown's: c_K, s, of velocities, and 1 of
            increments.
        lasts : float, optional
            Length of the step, s, for points with springs, whose law is that of the slider's slip
            over it; not needed where the values of beta are given to each minimisation.
        """
        contact, normal = system.contact, None
        if contact.opens:
            part = contact.normal
            normal = PressurePoints(part.N, contact.gain, part.stiffness * moved)
        points = ContactPoints(
            contact.B, contact.directions, contact.w, contact.beta, normal=normal
        )
        if not contact.has_springs:
            return points
        sprung, flexible = contact.sprung, np.zeros(contact.w.size)
        beta = np.array(contact.beta)
        flexible[sprung] = 1.0 / (contact.stiffness[sprung] * moved)
        if lasts is not None:
            beta[sprung] *= moved / lasts
        return replace(points, beta=beta, flexible=flexible)

    @property
    def soft(self) -> FloatArray:
        """Compliance of the springs in series by normalised friction, (m,), in the unit of v."""
        return np.zeros(self.w.size) if self.flexible is None else self.w * self.flexible

    @property
    def has_spring(self) -> BoolArray:
        """Whether each point, (m,), has a spring in series."""
        none = np.zeros(self.w.size, dtype=np.bool_)
        return none if self.flexible is None else np.asarray(self.flexible > 0.0)

    def on_rows(self, values: NDArray[Any]) -> NDArray[Any]:
        """Repeat the values of each point, (m, ...), for each of its rows."""
        return np.repeat(values, self.directions, axis=0)

    @property
    def first_row(self) -> NDArray[np.int64]:
        """Row of ``B`` at which each point starts, and the number of rows, (m + 1,)."""
        return np.concatenate([[0], np.cumsum(self.directions)])

    @cached_property
    def unknowns(self) -> IntArray:
        """Unknown that each row picks, (rows,); for problems whose slips are unknowns."""
        return np.asarray(sparse.csr_array(self.B).indices, dtype=np.intp)

    @property
    def limited(self) -> IntArray:
        """Unknowns that friction acts on, increasing; for problems whose slips are unknowns."""
        return np.unique(self.unknowns[self.on_rows(self.w) > 0.0])

    @cached_property
    def _coulomb(self) -> BoolArray:
        return np.asarray((self.w > 0.0) & np.isinf(self.beta) & ~self.has_spring)

    def at_rest(self, slip: FloatArray) -> BoolArray:
        """Whether each point, (m,), may stick: Coulomb friction and zero ``slip``, (rows,).

        Points with springs move as long as these do.
        """
        if not self._coulomb.any():
            return self._coulomb
        resting: BoolArray = slip_norms(slip, self.directions) == 0.0
        return self._coulomb & resting

    def potential(
        self, v: FloatArray, beta: FloatArray | None = None, offset: FloatArray | None = None
    ) -> float:
        """Potential of friction, sum w psi(|B v - offset|), W, with the values of beta given."""
        from skfem_joint.minimise.law import potential  # loads the compiler

        slip = self.B @ v - (0.0 if offset is None else offset)
        size = slip_norms(slip, self.directions)
        return float(self.w @ potential(size, self.beta if beta is None else beta, self.soft))

    def with_beta(self, beta: FloatArray | None) -> ContactPoints:
        """Same points with other values of beta, (m,); with their own if None."""
        return self if beta is None else replace(self, beta=np.asarray(beta, dtype=float))

    def without_friction_but(self, points: BoolArray) -> ContactPoints:
        """Same points where only some have a friction limit."""
        return replace(self, w=np.where(points, self.w, 0.0))

    def in_unknowns(self, kept: IntArray) -> ContactPoints:
        """Same points in some of the unknowns; slips of the others must have no friction."""
        return replace(self, B=self.B[:, kept])


class StepProblem(ABC):
    """A matrix H with contact points, to be minimised for many right sides.

    Attributes
    ----------
    H : ndarray or sparse array, shape (n, n)
    points : ContactPoints
    """

    H: Any
    points: ContactPoints

    @property
    @abstractmethod
    def factorizations(self) -> int:
        """Matrices prepared and factorised so far."""

    @abstractmethod
    def minimise(
        self,
        g: FloatArray,
        start: FloatArray | None = None,
        tolerance: float = 1e-11,
        beta: FloatArray | None = None,
        offset: FloatArray | None = None,
        pressed: Pressed | None = None,
    ) -> Minimum:
        """Minimise for the right side ``g``, (n,), N.

        Parameters
        ----------
        start : ndarray, shape (n,), optional
            Where to start; the method chooses if not given. The minimiser does not depend on it.
        tolerance : float
            Largest force residual relative to the largest force.
        beta : ndarray, shape (m,), optional
            Values of beta in place of those of the points.
        offset : ndarray, shape (rows,), optional
            Slips from which those of points with springs count, m/s; zero if not given.
        pressed : Pressed, optional
            Bounds and limits of contact that opens; needed by points that have pressure points.
        """

    def objective(
        self,
        v: FloatArray,
        g: FloatArray,
        beta: FloatArray | None = None,
        offset: FloatArray | None = None,
    ) -> float:
        """Value at ``v`` of what is minimised, W, where no contact opens."""
        own = float(v @ (0.5 * (self.H @ v) - g))
        return own + self.points.potential(v, beta, offset)

    def saved(self) -> dict[str, NDArray[Any]]:
        """Values that later minimisations depend on beside their arguments, for a checkpoint."""
        return {}

    def check(self, saved: dict[str, NDArray[Any]]) -> None:
        """Check arrays for what `saved` returns; ValueError names the first that is wrong."""
        check_like(saved, self.saved(), "step problem")

    def restore(self, saved: dict[str, NDArray[Any]]) -> None:  # noqa: B027 - few keep any
        """Continue with the values that `saved` returned."""

    def compile(self) -> None:  # noqa: B027 - nothing of a linear problem
        """Compile all functions that `minimise` calls, without minimising."""


class LinearProblem(StepProblem):
    """Step problem without friction: a linear system, factorised once."""

    factorizations = 1

    def __init__(self, H: Any, points: ContactPoints) -> None:
        self.H, self.points = H, points
        self._solve = factorised(H)

    def minimise(
        self,
        g: FloatArray,
        start: FloatArray | None = None,
        tolerance: float = 1e-11,
        beta: FloatArray | None = None,
        offset: FloatArray | None = None,
        pressed: Pressed | None = None,
    ) -> Minimum:
        """See `StepProblem`."""
        v = np.asarray(self._solve(g))
        finite = np.isfinite(v)
        sigma = np.zeros(self.points.B.shape[0])
        if finite.all():
            return Minimum(v, sigma, True)
        return Minimum(v, sigma, False, {}, float("nan"), int(np.flatnonzero(~finite)[0]))


# Problems that are minimised inside the compiled loop over time steps


class Places(NamedTuple):
    """Places of a system's slip rows and contact points among those of a compiled problem.

    Attributes
    ----------
    row : ndarray of int, shape (rows,)
    point : ndarray of int, shape (m,)
    """

    row: IntArray
    point: IntArray


def row_order(directions: NDArray[np.int64]) -> tuple[IntArray, IntArray]:
    """Order of slip rows and points in which loops along points need no branches.

    The first rows of all points come before the second rows. Points with two rows come first.
    ``directions``, (m,), is 1 or 2 for each point. Returns the row at each place, (rows,), and the
    point at each place, (m,).
    """
    first = np.cumsum(directions) - directions
    pair = directions == 2
    points = np.concatenate([np.flatnonzero(pair), np.flatnonzero(~pair)])
    return np.concatenate([first[points], first[pair] + 1]), points


class StepOutcome(NamedTuple):
    """Work and residual of a compiled minimisation.

    Attributes
    ----------
    converged : bool
    newton_iterations, nested_solves, descents, line_searches, friction_evaluations : int
        Work done, see :class:`skfem_joint.stepping.recording.Counters`.
    residual : float
        Largest force residual, N.
    unknown : int
        Unknown at which it is.
    """

    converged: bool
    newton_iterations: int
    nested_solves: int
    descents: int
    line_searches: int
    friction_evaluations: int
    residual: float
    unknown: int


def minimise_step(
    problem: Any, workspace: Any, right: FloatArray, v: FloatArray, tolerance: float
) -> StepOutcome:
    """Minimise from the velocity ``v`` of the step before; returns an `StepOutcome`.

    numba replaces a call by the implementation for the kind of ``problem``:
    `front_elimination.Chain` or `dense_loop.Dense` (see
    :func:`skfem_joint.ground.compiling.compiled_for`).

    ``workspace.offset`` has the slips from which those of rows with springs count. The velocity and
    the friction are left in ``workspace.velocity`` and ``workspace.force``. What
    the workspace keeps of earlier steps, such as velocities to extrapolate from, changes only if
    the minimisation converged. Guesses that speed up the next step and do not bear on its result
    beyond the tolerance may change in any case: where fronts of slip met, or the friction that is
    predicted, which is forgotten after a failure.
    """
    raise NotImplementedError


def slips(problem: Any, x: FloatArray, out: FloatArray) -> FloatArray:
    """Slip of all rows from displacements ``x``: written to ``out``, or ``x`` itself."""
    raise NotImplementedError


class CompiledStepProblem(StepProblem):
    """Step problem whose minimisation runs inside the compiled loop over steps.

    Attributes
    ----------
    kernel : named tuple
        First argument of `minimise_step` and `slips`.
    workspace : named tuple
        Second argument of `minimise_step`, shared by all matrices of a run.
    limits : ndarray, shape (rows of the kernel,)
        Friction limit of each slip row of the kernel, N.
    places : Places
        Of the system's rows and points among those of the kernel.
    steps_per_second : int
        Number of steps that take less than a second on any computer.
    remembered : tuple of str
        Arrays of the workspace that later steps depend on.
    """

    kernel: Any
    workspace: Any
    limits: FloatArray
    places: Places
    steps_per_second: int
    remembered: ClassVar[tuple[str, ...]]

    @abstractmethod
    def with_matrix(self, H: Any, points: ContactPoints | None = None) -> CompiledStepProblem:
        """Problem with another matrix, and perhaps other laws of the same contact points.

        Values kept from earlier steps are shared.
        """

    @abstractmethod
    def restart(self, v: FloatArray, sigma: FloatArray) -> None:
        """Forget earlier steps: go on from a velocity and friction in the kernel's order."""

    def resume(self, v: FloatArray, sigma: FloatArray) -> None:
        """Prepare for steps from a velocity and friction after steps with another matrix."""

    def rescue(self, g: FloatArray, v: FloatArray, tolerance: float) -> dict[str, int]:
        """Minimise for a right side for which `minimise_step` has just failed, by other means.

        Returns the work, and `minimise_step` then starts from the minimum; nothing where there is
        no other way, or it fails too.
        """
        return {}

    def saved(self) -> dict[str, NDArray[Any]]:
        """See `StepProblem`."""
        return {name: np.array(getattr(self.workspace, name)) for name in self.remembered}

    def restore(self, saved: dict[str, NDArray[Any]]) -> None:
        """See `StepProblem`."""
        for name in self.remembered:
            getattr(self.workspace, name)[:] = saved[name]
