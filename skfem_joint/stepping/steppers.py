"""Steppers: each advances one system by equal implicit steps, as its matrices allow.

Here is what all of them share, and those whose steps are done in Python: for linear systems (no
friction is loaded or evaluated), and for large sparse systems with contact points. The compiled
ones are in :mod:`skfem_joint.stepping.chain` and :mod:`skfem_joint.stepping.dense`.

Where the contact of a sparse system is small, everything else is condensed once for each step size
(exactly: a Schur complement of the step matrix), and the iteration runs on the contact alone.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import pairwise
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse

from skfem_joint import friction
from skfem_joint.arrays import BoolArray, FloatArray, IntArray
from skfem_joint.linalg.compressed import as_compressed, compressed_rows
from skfem_joint.linalg.factors import factorised
from skfem_joint.linalg.schur import SchurComplement, condensing_pays
from skfem_joint.stepping.recording import Recorder
from skfem_joint.stepping.schemes import FOLLOWED, Coefficients, Scheme, State, backward_euler
from skfem_joint.system import System

if TYPE_CHECKING:
    from skfem_joint.stepping.contact_problem import ContactProblem, Solution

Saved = Mapping[str, NDArray[Any]]
#: Velocity or acceleration, and normalised friction by slip row.
Motion = tuple[FloatArray, FloatArray]

#: Stride of rows that are never stored.
NEVER = 2**62


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
    frequency : float
        Of the vibration, rad/s, that the last jump of the acceleration sets off; 0 after a step.
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
        self.system, self.scheme = system, scheme
        self.tolerance, self.recorder = tolerance, recorder
        self.frequency = 0.0
        self.failure = Failure()
        self.counts = dict.fromkeys((*self.COUNTS, "factorizations"), 0)
        self.prepared: dict[Coefficients, Any] = {}
        rest = *np.zeros((2, system.n)), np.zeros(system.B.shape[0])
        self.now = State(np.array(u), np.array(v), *rest)

    @abstractmethod
    def make(self, c: Coefficients) -> Any:
        """What a step needs, such as the factor of its matrix, which it counts."""

    @abstractmethod
    def advance(self, h: float, amplitudes: FloatArray, first_step: int, store: bool) -> int:
        """Do ``amplitudes.shape[1] - 1`` steps of ``h``; return how many converged.

        ``first_step`` is the index of the first one in the run; ``store`` tells whether rows may
        be stored (not inside a step that is done in parts).
        """

    def sticking(self, right: FloatArray, at_rest: BoolArray) -> Motion | None:
        """Acceleration under forces (N), which at points at rest obeys their velocity's law.

        None, and the failure noted: not found.
        """
        raise NotImplementedError

    def restart(self, amplitudes: FloatArray) -> bool:
        """Make the acceleration consistent with the loads now (start, or after a jump).

        Points at rest stick under Coulomb as long as they can. False: not found.
        """
        s, (u, v) = self.system, self.now[:2]
        slip, limits = s.B @ v, s.on_rows(s.w)
        sigma = np.where(limits > 0.0, friction.force_vectors(slip, s.beta, s.directions), 0.0)
        at_rest = (s.w > 0.0) & np.isinf(s.beta) & (s.slip_norm(slip) == 0.0)
        right = self.recorder.vectors @ amplitudes - s.C @ v - s.K @ u - s.B.T @ (limits * sigma)
        acceleration = np.zeros(s.n)
        if at_rest.any() and right.any():
            found = self.sticking(right, at_rest)
            if found is None:
                return False
            acceleration = found[0]
            sigma += found[1]
        elif s.is_dense or right.any():
            acceleration = factorised(s.M)(right)
        self.started(acceleration, sigma)
        return True

    def started(self, acceleration: FloatArray, sigma: FloatArray) -> None:
        """Go on from an acceleration and friction, by slip row, consistent with the loads."""
        self.now = self.now._replace(a=acceleration.copy(), d=acceleration.copy(), sigma=sigma)
        self.frequency = self.system.frequency_of(acceleration)

    def prepare(self, h: float) -> None:
        """Do all that the first step of ``h`` would have to do beside itself: compile, factorise.

        After :meth:`restart`.
        """
        self.matrices(self.coefficients(h))

    def matrices(self, c: Coefficients) -> Any:
        """What :meth:`make` gives, made once."""
        if c not in self.prepared:
            self.prepared[c] = self.make(c)
        return self.prepared[c]

    def coefficients(self, h: float) -> Coefficients:
        """Coefficients of the next step of ``h`` seconds.

        Schemes that dissipate overshoot after a jump of the acceleration, the more the longer the
        step is beside the periods that it sets off: they carry on the acceleration of the start.
        One implicit Euler step does not use it, and one step of first order leaves the run of
        second order (Rannacher, Numer. Math. 43, 1984). The trapezoidal rule needs no such help,
        and would lose its energy.
        """
        c = self.scheme.coefficients(h)
        return backward_euler(h) if self.frequency * h > FOLLOWED and not c.trapezoidal else c

    def state(self) -> State:
        """State now, with friction by slip row of the system."""
        return self.now

    def saved(self) -> dict[str, NDArray[Any]]:
        """All that steps depend on, between two calls of :meth:`advance`, for a checkpoint."""
        return {
            "state": np.array(self.now[:4]),
            "sigma": np.array(self.now.sigma),
            "frequency": np.array(self.frequency),
            "steps": np.array(list(self.prepared), dtype=float),
            "counts": np.array(list(self.counts.values())),
        }

    def restore(self, saved: Saved) -> None:
        """Take up what :meth:`saved` gave, whatever was done before."""
        self.now = State._make([*map(np.array, saved["state"]), np.array(saved["sigma"])])
        self.frequency = float(saved["frequency"])
        for row in saved["steps"].tolist():
            self.matrices(Coefficients._make([*row[:-1], bool(row[-1])]))
        self.counts = dict(zip(self.counts, saved["counts"].tolist(), strict=True))


class CompiledStepper(Stepper):
    """Steps of which a compiled loop does many at a time, in place.

    A subclass sets what :func:`skfem_joint.stepping.march.march` takes: ``dynamics`` (mass,
    damping and stiffness), ``memory`` (of which steps depend on what is ``REMEMBERED``), ``room``,
    the friction ``limits`` of its slip rows, and the ``places`` of the system's among them; its
    problem is what it makes.
    """

    COUNTS = (
        *("newton_iterations", "nested_solves", "descents", "line_searches"),
        *("friction_evaluations", "largest_iterations"),
    )
    REMEMBERED: ClassVar[tuple[str, ...]]
    most_at_once = 20_000
    dynamics: tuple[Any, Any, Any]
    memory: Any
    room: Any
    limits: FloatArray
    places: Any

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.loads = compressed_rows(self.recorder.vectors.T)
        self.observed = compressed_rows(self.system.P)

    @cached_property
    def joints(self) -> tuple[Any, ...]:
        """Points of each joint that rub, with their parts in its work, and in its friction."""
        s = self.system
        joints = compressed_rows(s.J * (s.w > 0.0))
        shares = joints.value * s.w[joints.column]
        shares /= np.repeat(s.J @ s.w, np.diff(joints.start))
        return joints.start, self.places.point[joints.column], joints.value, shares

    def started(self, acceleration: FloatArray, sigma: FloatArray) -> None:
        """Go on with the friction in the order of the problem."""
        own = np.zeros(self.limits.size)
        own[self.places.row] = sigma
        super().started(acceleration, own)

    def state(self) -> State:
        """State now, with friction by slip row of the system."""
        return self.now._replace(sigma=self.now.sigma[self.places.row])

    def prepare(self, h: float) -> None:
        """Compile the loop, and prepare a step of ``h``, by doing none."""
        self.advance(h, np.zeros((len(self.system.loads), 1)), 0, False)

    def advance(self, h: float, amplitudes: FloatArray, first_step: int, store: bool) -> int:
        """Do the steps in the compiled loop."""
        from skfem_joint.stepping.march import march

        c, r = self.coefficients(h), self.recorder
        problem = self.problem(c)
        counted = np.array([self.counts[name] for name in self.COUNTS])
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
        self.counts |= dict(zip(self.COUNTS, counted.tolist(), strict=True))
        self.failure = Failure(residual, unknown)
        if steps > 0:
            self.frequency = 0.0
        return int(steps)

    def problem(self, c: Coefficients) -> Any:
        """Problem of the next step."""
        return self.matrices(c)

    def saved(self) -> dict[str, NDArray[Any]]:
        """State and memory."""
        return super().saved() | {n: np.array(getattr(self.memory, n)) for n in self.REMEMBERED}

    def restore(self, saved: Saved) -> None:
        """Take up a saved state and memory."""
        super().restore(saved)
        for name in self.REMEMBERED:
            getattr(self.memory, name)[:] = saved[name]


class PlainStepper(Stepper):
    """Steps done one by one in Python."""

    @abstractmethod
    def solve(self, matrices: Any, right: FloatArray) -> Motion | None:
        """Velocity and friction at a step's end; None, and the failure noted: not found."""

    def advance(self, h: float, amplitudes: FloatArray, first_step: int, store: bool) -> int:
        """Do the steps."""
        s, c, recorder = self.system, self.coefficients(h), self.recorder
        matrices, done = self.matrices(c), 0
        for ends in pairwise(amplitudes.T):
            before = u, v, a, d, _ = self.now
            predictor = u + c.u_v * v + c.u_a * a
            right = recorder.vectors @ ends[1] - s.K @ predictor
            right += s.M @ (c.c_M * v + c.y_a * a + c.y_d * d)
            found = self.solve(matrices, right)
            if found is None:
                break
            velocity, sigma = found
            a = c.a_v * (velocity - v) + c.a_a * a
            d = c.d_a * a + c.d_a0 * before.a + c.d_d0 * d
            self.now = State(predictor + c.c_K * velocity, velocity, a, d, sigma)
            recorder.add_step(h, ends, before, self.now, c.trapezoidal)
            done += 1
            self.frequency = 0.0
            if store:
                recorder.store(first_step + done, self.now)
        return done


class LinearStepper(PlainStepper):
    """Steps of a system without friction: one factorization, one solve a step."""

    def make(self, c: Coefficients) -> Any:
        """Factor of the step matrix."""
        s = self.system
        self.counts["factorizations"] += 1
        return factorised(c.c_M * s.M + s.C + c.c_K * s.K)

    def solve(self, matrices: Any, right: FloatArray) -> Motion | None:
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
    def of(system: System, among: BoolArray | None = None) -> Points:
        """Those of a system whose slip rows each pick an unknown of their own, or some of them."""
        which = system.w > 0.0 if among is None else among
        unknown = np.append(sparse.csr_array(system.B).indices, -1).astype(np.int64)
        first = system.first_row[:-1][which]
        second = np.where(system.directions[which] == 2, first + 1, -1)
        return Points(unknown[first], unknown[second], system.w[which], system.beta[which])

    def unknowns(self) -> IntArray:
        """All unknowns in contact, sorted."""
        return np.unique(np.concatenate([self.first, self.second[self.second >= 0]]))

    def problem(self, A: Any) -> ContactProblem:
        """Contact problem of a matrix at these points."""
        from skfem_joint.stepping.contact_problem import ContactProblem

        return ContactProblem(A, self.first, self.second, self.w, self.beta)

    def best_problem(self, A: Any) -> ContactProblem | Condensed:
        """The same, condensed to the contact where that is cheaper."""
        return Condensed(A, self) if condensing_pays(A, self.unknowns()) else self.problem(A)

    def numbered(self, unknowns: IntArray) -> Points:
        """Same points where the given unknowns are all that there are."""
        second = np.where(self.second >= 0, np.searchsorted(unknowns, self.second), -1)
        return Points(np.searchsorted(unknowns, self.first), second, self.w, self.beta)


class Condensed(SchurComplement):
    """Contact problem of a matrix that is condensed to its contact unknowns."""

    def __init__(self, A: Any, points: Points) -> None:
        super().__init__(A, points.unknowns())
        self.A, self.problem = A, points.numbered(self.kept).problem(self.complement)

    @property
    def factorizations(self) -> int:
        """Matrices factorised so far."""
        return self.problem.factorizations

    def solver_of_kept(self, added: Any = None) -> Callable[[FloatArray], FloatArray]:
        """Solver for the contact without friction, with a matrix added, (n, n)."""
        if self.problem.dense and added is None:  # nearly singular: Cholesky's method refuses it
            return partial(linalg.lu_solve, linalg.lu_factor(self.problem.A))
        return super().solver_of_kept(added)

    def objective(self, v: FloatArray, g: FloatArray) -> float:
        """As `ContactProblem.objective`, on all unknowns."""
        return float(v @ (0.5 * (self.A @ v) - g)) + self.problem.lost(v[self.kept])

    def solve(self, g: FloatArray, start: FloatArray, tolerance: float) -> Solution:
        """As `ContactProblem.solve`, on all unknowns."""
        force, (right, still) = float(np.abs(g).max()), self.restrict(g)
        found = self.problem.solve(right, start[self.kept], tolerance, force)
        v, sigma = self.extend(found.v, still), np.zeros_like(g)
        sigma[self.kept] = found.sigma
        return replace(
            found,
            v=v,
            sigma=sigma,
            converged=found.converged and bool(np.all(np.isfinite(v))),
            counts=found.counts | {"linear_solves": found.counts["linear_solves"] + 2},
            where=int(self.kept[found.where]),
        )


class ContactStepper(PlainStepper):
    """Steps of a system whose slip rows each pick an unknown of their own."""

    COUNTS = ("newton_iterations", "largest_iterations", "friction_evaluations", "linear_solves")

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.unknown = sparse.csr_array(self.system.B).indices
        self.points = Points.of(self.system)
        self.v_before = self.now.v

    def sticking(self, right: FloatArray, at_rest: BoolArray) -> Motion | None:
        """Acceleration and friction of points at rest."""
        held = Points.of(self.system, at_rest).problem(as_compressed(self.system.M))
        found = held.solve(right, np.zeros_like(right), self.tolerance)
        if not found.converged:
            self.failure = Failure(found.residual, found.where)
        return (found.v, found.sigma[self.unknown]) if found.converged else None

    def started(self, acceleration: FloatArray, sigma: FloatArray) -> None:
        """Go on from the velocity now."""
        super().started(acceleration, sigma)
        self.v_before = self.now.v

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

    def solve(self, matrices: Any, right: FloatArray) -> Motion | None:
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
