"""Steppers: each advances one system by equal implicit steps, as its matrices allow.

Here is what all of them share, and those whose steps are done in Python: for linear systems (no
friction is loaded or evaluated), and for large sparse systems with contact points. The compiled
ones are in :mod:`skfem_joint.stepping.chain` and :mod:`skfem_joint.stepping.dense`.

Of a sparse system only the contact is nonlinear. Where it is small, everything else is condensed
once for each step size (exactly: a Schur complement of the step matrix), and the iteration runs on
the contact alone; where contact is nearly everywhere it runs on all unknowns.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse

from skfem_joint import friction
from skfem_joint.arrays import FloatArray, IntArray, as_compressed
from skfem_joint.factors import condensed, factorised
from skfem_joint.stepping.recording import Recorder, compressed
from skfem_joint.stepping.schemes import (
    Coefficients,
    Scheme,
    Start,
    State,
    end_of_step,
    prediction,
)
from skfem_joint.system import System

if TYPE_CHECKING:
    from skfem_joint.stepping.contact_problem import ContactProblem, Solution

Saved = Mapping[str, NDArray[Any]]

#: Stride of rows that are never stored.
NEVER = 2**62
#: Largest contact, in unknowns, that is condensed, and the most that its square may be for each
#: unknown of the system: beyond it dense products cost more than sparse ones.
CONDENSED, CONDENSED_SQUARE = 1200, 50


@dataclass
class Failure:
    """Why the last step did not converge: its largest force residual, N, and where it is."""

    residual: float = 0.0
    unknown: int = 0


class Stepper(ABC):
    """What the driver needs of a stepper, and what all of them do alike.

    Attributes
    ----------
    now : State
        ``sigma`` may have an order of its own, see :meth:`state`.
    counts : dict
        Work done so far, by those names of :class:`skfem_joint.stepping.recording.Counters` that
        the stepper counts.
    prepared : dict
        What each step size needs, by its coefficients.
    first_call, most_at_once : int
        Steps that surely take less than a second, and the most that are to be done in one call.
    """

    COUNTS: ClassVar[tuple[str, ...]] = ()
    first_call, most_at_once = 1, 1

    def __init__(
        self,
        system: System,
        scheme: Scheme,
        u: FloatArray,
        v: FloatArray,
        tolerance: float,
        recorder: Recorder,
    ) -> None:
        self.system, self.tolerance, self.recorder = system, tolerance, recorder
        self.start = Start(scheme)
        self.failure = Failure()
        self.counts = dict.fromkeys((*self.COUNTS, "factorizations"), 0)
        self.prepared: dict[Coefficients, Any] = {}
        zero = np.zeros((2, system.n))
        sigma = np.zeros(system.B.shape[0])
        self.now = State(np.array(u), np.array(v), zero[0], zero[1], sigma)

    @abstractmethod
    def make(self, c: Coefficients) -> Any:
        """What a step with these coefficients needs, such as the factor of its matrix.

        Counts a factorization if it does one.
        """

    @abstractmethod
    def advance(self, h: float, amplitudes: FloatArray, first_step: int, store: bool) -> int:
        """Do ``amplitudes.shape[1] - 1`` steps of ``h``; return how many converged.

        ``first_step`` is the index of the first one in the run; ``store`` tells whether rows may
        be stored (not inside a step that is done in parts).
        """

    @abstractmethod
    def restart(self, amplitudes: FloatArray) -> bool:
        """Make the acceleration consistent with the loads now (start, or after a jump).

        Points at rest stick under Coulomb as long as they can. False: not found.
        """

    def prepare(self, h: float) -> None:
        """Do all that the first step of ``h`` would have to do beside itself: compile, factorise.

        After :meth:`restart`.
        """
        self.matrices(self.start.coefficients(h))

    def matrices(self, c: Coefficients) -> Any:
        """What :meth:`make` gives, made once."""
        if c not in self.prepared:
            self.prepared[c] = self.make(c)
        return self.prepared[c]

    def started(self, acceleration: FloatArray, sigma: FloatArray) -> None:
        """Go on from an acceleration and friction that are consistent with the loads."""
        a, d = acceleration.copy(), acceleration.copy()
        self.now = self.now._replace(a=a, d=d, sigma=sigma)
        self.start.after_jump(self.system, acceleration)

    def elastic(self, amplitudes: FloatArray) -> FloatArray:
        """Forces now but for friction and inertia, N."""
        s = self.system
        right = self.recorder.vectors @ amplitudes - s.C @ self.now.v - s.K @ self.now.u
        return np.asarray(right)

    def state(self) -> State:
        """State now, with friction by slip row of the system."""
        return self.now

    def saved(self) -> dict[str, NDArray[Any]]:
        """All that steps depend on, between two calls of :meth:`advance`, for a checkpoint."""
        return {
            "state": np.array(self.now[:4]),
            "sigma": np.array(self.now.sigma),
            "start": np.array(self.start.frequency),
            "steps": np.array(list(self.prepared), dtype=float),
            "counts": np.array(list(self.counts.values())),
        }

    def restore(self, saved: Saved) -> None:
        """Take up what :meth:`saved` gave, whatever was done before."""
        self.now = State._make([*map(np.array, saved["state"]), np.array(saved["sigma"])])
        self.start.frequency = float(saved["start"])
        for row in saved["steps"].tolist():
            self.matrices(Coefficients._make([*row[:-1], bool(row[-1])]))
        self.counts = dict(zip(self.counts, saved["counts"].tolist(), strict=True))


#: Steppers whose loop is compiled.
_READY: set[type[Stepper]] = set()


class CompiledStepper(Stepper):
    """Steps of which a compiled loop does many at a time, in place.

    A subclass sets what :func:`skfem_joint.stepping.march.march` takes: ``dynamics`` (mass,
    damping and stiffness), ``memory``, ``room``, the friction ``limits`` of its slip rows, and the
    ``places`` of the system's among them; its problem is what it makes.
    """

    most_at_once = 20_000
    dynamics: tuple[Any, Any, Any]
    memory: Any
    room: Any
    limits: FloatArray
    places: Any

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.loads = compressed(self.recorder.vectors.T)
        self.observed = compressed(self.system.P)

    def prepare(self, h: float) -> None:
        """Compile the loop, once in a process, and prepare a step of ``h``."""
        self.problem(self.start.coefficients(h))
        joints, w = compressed(self.system.J * (self.system.w > 0.0)), self.system.w
        parts = joints.value * w[joints.column]
        row = np.repeat(np.arange(joints.start.size - 1), np.diff(joints.start))
        shares = parts / np.bincount(row, parts, joints.start.size - 1)[row]
        self.joints = joints.start, self.places.point[joints.column], joints.value, shares
        if type(self) not in _READY:
            self.advance(h, np.zeros((len(self.system.loads), 1)), 0, False)
            _READY.add(type(self))

    def advance(self, h: float, amplitudes: FloatArray, first_step: int, store: bool) -> int:
        """Do the steps in the compiled loop."""
        from skfem_joint.stepping.march import COUNTS, march

        c, r = self.start.coefficients(h), self.recorder
        problem = self.problem(c)
        counted = np.array([self.counts.get(name, 0) for name in COUNTS])
        steps, rows, field_rows, residual, unknown = march(
            amplitudes.shape[1] - 1,
            first_step,
            r.save.strides if store else (NEVER, NEVER),
            c,
            self.dynamics,
            problem,
            self.memory,
            self.limits,
            tuple(self.places),
            self.tolerance,
            tuple(self.loads),
            np.ascontiguousarray(amplitudes),
            tuple(self.observed),
            self.joints,
            tuple(self.now),
            tuple(self.room),
            r.sums(),
            tuple(r.free_rows()),
            counted,
        )
        r.rows += rows
        r.field_rows += field_rows
        found = dict(zip(COUNTS, counted.tolist(), strict=True))
        self.counts |= {name: found[name] for name in self.COUNTS}
        self.failure = Failure(residual, unknown)
        self.start.done(steps)
        return int(steps)

    def problem(self, c: Coefficients) -> Any:
        """Problem of the next step."""
        return self.matrices(c)


class PlainStepper(Stepper):
    """Steps done one by one in Python."""

    @abstractmethod
    def solve(self, matrices: Any, right: FloatArray) -> tuple[FloatArray, FloatArray] | None:
        """Velocity and friction at a step's end; None, and the failure noted: not found."""

    def advance(self, h: float, amplitudes: FloatArray, first_step: int, store: bool) -> int:
        """Do the steps."""
        s, c, recorder = self.system, self.start.coefficients(h), self.recorder
        matrices = self.matrices(c)
        n_steps = int(amplitudes.shape[1]) - 1
        done = 0
        for k in range(n_steps):
            before = self.now
            force = recorder.vectors @ amplitudes[:, k + 1]
            predictor, right = prediction(s, c, force, before)
            found = self.solve(matrices, right)
            if found is None:
                break
            self.now = end_of_step(c, predictor, *found, before)
            ends = amplitudes[:, k], amplitudes[:, k + 1]
            recorder.add_step(h, ends, before, self.now, c.trapezoidal)
            done += 1
            if store:
                recorder.store(first_step + done, self.now)
        self.start.done(done)
        return done


class LinearStepper(PlainStepper):
    """Steps of a system without friction: one factorization, one solve a step."""

    def make(self, c: Coefficients) -> Any:
        """Factor of the step matrix."""
        s = self.system
        self.counts["factorizations"] += 1
        return factorised(c.c_M * s.M + s.C + c.c_K * s.K)

    def restart(self, amplitudes: FloatArray) -> bool:
        """Acceleration from the equation of motion."""
        self.started(factorised(self.system.M)(self.elastic(amplitudes)), self.now.sigma)
        return True

    def solve(self, matrices: Any, right: FloatArray) -> tuple[FloatArray, FloatArray] | None:
        """Velocity at a step's end."""
        v = np.asarray(matrices(right))
        if not np.all(np.isfinite(v)):
            self.failure = Failure(float("nan"), int(np.flatnonzero(~np.isfinite(v))[0]))
            return None
        return v, self.now.sigma


@dataclass(frozen=True)
class Points:
    """Contact points that carry friction, by unknown; ``second`` is -1 where it is not there."""

    first: IntArray
    second: IntArray
    w: FloatArray
    beta: FloatArray

    @staticmethod
    def of(system: System) -> Points:
        """Those of a system whose slip rows each pick an unknown of their own."""
        points = Points(*contact_unknowns(system), system.w, system.beta)
        return points.chosen(system.w > 0.0)

    def unknowns(self) -> IntArray:
        """All unknowns in contact, sorted."""
        return np.unique(np.concatenate([self.first, self.second[self.second >= 0]]))

    def chosen(self, which: NDArray[Any]) -> Points:
        """Some of the points."""
        return Points(self.first[which], self.second[which], self.w[which], self.beta[which])

    def problem(self, A: Any) -> ContactProblem:
        """Contact problem of a matrix at these points."""
        from skfem_joint.stepping.contact_problem import ContactProblem

        return ContactProblem(A, self.first, self.second, self.w, self.beta)

    def best_problem(self, A: Any) -> ContactProblem | Condensed:
        """The same, condensed to the contact where that is cheaper."""
        n, contact = A.shape[0], self.unknowns().size
        dense = isinstance(A, np.ndarray)
        most = n - 1 if dense else min(CONDENSED, np.sqrt(CONDENSED_SQUARE * n))
        return Condensed(A, self) if contact <= most else self.problem(A)

    def numbered(self, unknowns: IntArray) -> Points:
        """Same points where the given unknowns are all that there are."""
        second = np.where(self.second >= 0, np.searchsorted(unknowns, self.second), -1)
        return Points(np.searchsorted(unknowns, self.first), second, self.w, self.beta)


class Condensed:
    """Contact problem of a matrix that is condensed to its contact unknowns."""

    def __init__(self, A: Any, points: Points) -> None:
        self.A, self.contact = A, points.unknowns()
        self.rest, self.factor, S = condensed(A, self.contact)
        self.A_rc = as_compressed(A[self.rest][:, self.contact])
        self.A_cr = as_compressed(self.A_rc.T)
        self.problem = points.numbered(self.contact).problem(S)

    @property
    def factorizations(self) -> int:
        """Matrices factorised so far."""
        return self.problem.factorizations

    def without_friction(self) -> Callable[[FloatArray], FloatArray]:
        """Solver of A v = g, (n,) or (n, k)."""
        contact = linalg.lu_factor(self.problem.A)

        return lambda g: self.outward(linalg.lu_solve(contact, self.inward(g)), g)

    def inward(self, g: FloatArray) -> FloatArray:
        """Forces on the contact alone, (c,) or (c, k), from those on all unknowns."""
        return np.asarray(g[self.contact] - self.A_cr @ self.factor(g[self.rest]))

    def outward(self, v: FloatArray, g: FloatArray) -> FloatArray:
        """All unknowns, (n,) or (n, k), from those of the contact under forces on all."""
        every = np.empty_like(g)
        every[self.contact] = v
        every[self.rest] = self.factor(g[self.rest] - self.A_rc @ v)
        return every

    def objective(self, v: FloatArray, g: FloatArray) -> float:
        """As `ContactProblem.objective`, on all unknowns."""
        return float(v @ (0.5 * (self.A @ v) - g)) + self.problem.lost(v[self.contact])

    def solve(self, g: FloatArray, start: FloatArray, tolerance: float) -> Solution:
        """As `ContactProblem.solve`, on all unknowns."""
        found = self.problem.solve(
            self.inward(g), start[self.contact], tolerance, force=float(np.abs(g).max())
        )
        v, sigma = self.outward(found.v, g), np.zeros_like(g)
        sigma[self.contact] = found.sigma
        return replace(
            found,
            v=v,
            sigma=sigma,
            converged=found.converged and bool(np.all(np.isfinite(v))),
            counts=found.counts | {"linear_solves": found.counts["linear_solves"] + 2},
            where=int(self.contact[found.where]),
        )


class ContactStepper(PlainStepper):
    """Steps of a system whose slip rows each pick an unknown of their own."""

    COUNTS = ("newton_iterations", "largest_iterations", "friction_evaluations", "linear_solves")

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        s = self.system
        self.unknown = np.asarray(sparse.csr_array(s.B).indices, dtype=np.int64)
        self.points = Points.of(s)
        self.w_rows = s.on_rows(s.w)
        self.v_before = self.now.v

    def _law(self) -> FloatArray:
        """Normalised friction at the velocity now, by slip row; 0 for Coulomb points at rest."""
        s = self.system
        sigma = friction.force_vectors(self.now.v[self.unknown], s.beta, s.directions)
        return np.where(self.w_rows > 0.0, sigma, 0.0)

    def restart(self, amplitudes: FloatArray) -> bool:
        """Consistent acceleration: points at rest stick under Coulomb as long as they can."""
        s, p = self.system, self.points
        right = self.elastic(amplitudes)
        sigma = self._law()
        right[self.unknown] -= self.w_rows * sigma
        speed = s.slip_norm(self.now.v[self.unknown])[s.w > 0.0]
        at_rest = np.isinf(p.beta) & (speed == 0.0)
        acceleration = np.zeros_like(right)
        if np.any(right) and np.any(at_rest):
            # The acceleration of points at rest obeys the law that their velocity will.
            held = p.chosen(at_rest).problem(as_compressed(s.M))
            found = held.solve(right, np.zeros_like(right), self.tolerance)
            if not found.converged:
                self.failure = Failure(found.residual, found.where)
                return False
            acceleration = found.v
            sigma = sigma + found.sigma[self.unknown]
        elif np.any(right):
            acceleration = factorised(s.M)(right)
        self.v_before = self.now.v
        self.started(acceleration, sigma)
        return True

    def prepare(self, h: float) -> None:
        """Condense or factorise a step of ``h``, and compile what steps and restarts need."""
        super().prepare(h)
        for problem in self._problems():
            problem.compile()
        if np.any(np.isinf(self.points.beta)):
            self.points.problem(as_compressed(self.system.M)).compile()

    def make(self, c: Coefficients) -> Any:
        """Step matrix as a contact problem, condensed where that is cheaper."""
        s = self.system
        H = as_compressed(c.c_M * s.M + s.C + c.c_K * s.K)
        problem = self.points.best_problem(H)
        self.counts["factorizations"] += isinstance(problem, Condensed)
        return problem

    def _problems(self) -> list[ContactProblem]:
        return [getattr(matrices, "problem", matrices) for matrices in self.prepared.values()]

    def solve(self, matrices: Any, right: FloatArray) -> tuple[FloatArray, FloatArray] | None:
        """Velocity and friction at a step's end, from those of the steps before."""
        # On the line through the last two velocities, at rest where it was.
        v = 2.0 * self.now.v - self.v_before
        at_rest = self.system.slip_norm(self.now.v[self.unknown]) == 0.0
        v[self.unknown[self.system.on_rows(at_rest)]] = 0.0
        found = matrices.solve(right, v, self.tolerance)
        for name, count in found.counts.items():
            self.counts[name] += count
        most = max(self.counts["largest_iterations"], found.counts["newton_iterations"])
        self.counts["largest_iterations"] = most
        if not found.converged:
            self.failure = Failure(found.residual, found.where)
            return None
        self.v_before = self.now.v
        return found.v, found.sigma[self.unknown]

    def saved(self) -> dict[str, NDArray[Any]]:
        """State, the velocity before it, and the tangents whose factors are kept."""
        kept: dict[str, NDArray[Any]] = {"before": np.array(self.v_before)}
        for k, problem in enumerate(self._problems()):
            if problem.kept is not None:
                kept[f"tangents_{k}"], kept[f"held_{k}"] = problem.kept
        return super().saved() | kept

    def restore(self, saved: Saved) -> None:
        """Take up a saved state and factorise the tangents again."""
        super().restore(saved)
        self.v_before = np.array(saved["before"])
        for k, problem in enumerate(self._problems()):
            if f"tangents_{k}" in saved:
                problem.keep(saved[f"tangents_{k}"], saved[f"held_{k}"])


def contact_unknowns(system: System) -> tuple[IntArray, IntArray]:
    """Unknowns that each contact point slips by, -1 for a second direction that it has not.

    For systems whose slip rows each pick an unknown of their own.
    """
    unknown = np.asarray(sparse.csr_array(system.B).indices, dtype=np.int64)
    row = system.first_row[:-1]
    second = np.full(row.size, -1)
    two = system.directions == 2
    second[two] = unknown[row[two] + 1]
    return unknown[row], second
