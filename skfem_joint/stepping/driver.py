"""The driver: it advances a stepper along a run, in chunks, and halves steps that fail.

The result is the same to the bit wherever chunks end.
"""

from __future__ import annotations

import logging
import math
import time
from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import pairwise
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from skfem_joint.ground.arrays import FloatArray
from skfem_joint.ground.errors import ConvergenceError, InputError
from skfem_joint.minimise.problem import ContactPoints, StepProblem
from skfem_joint.stepping.arrangement import arranged
from skfem_joint.stepping.checkpoint import Arrays, Checkpoint
from skfem_joint.stepping.load_steps import LoadSteps
from skfem_joint.stepping.plan import Plan
from skfem_joint.stepping.recording import Ending, Final, Recorder, Run
from skfem_joint.stepping.schemes import Coefficients, State
from skfem_joint.stepping.stepper import FailedStep, Saved, Stepper
from skfem_joint.stepping.stopwatch import Stopwatch
from skfem_joint.stepping.warp import warped
from skfem_joint.system.system import System

_log = logging.getLogger(__name__)


#: A step that does not converge is halved at most this often.
HALVINGS = 8
#: A chunk, between two chances to save and to show progress, ends after so much time, s.
CHUNK_S = 0.5
#: A chunk is handed to the stepper in calls that take about this long, s; Ctrl-C is seen between
#: two of them.
CALL_S = 0.1


#: Loads go on where they change by no more than this share of the largest force.
CONTINUED = 1e-9


class Driver:
    """Advances a stepper along a run whose steps are cut where loads jump or kink.

    A new driver is at the start, with its first row stored.

    Parameters
    ----------
    given : System
    plan : Plan
    start : tuple of ndarray, shape (n,)
        Displacement (m) and velocity (m/s), and perhaps friction over its limit (rows,), with which
        springs in series start, and with contact that opens these limits (m,), N.
    tolerance : float
        Largest force residual of a step relative to its largest force.
    ending : Ending, optional
        Of a run with the same matrices and scheme, which ended in ``start``. Where the loads are
        those of its end the stepper goes on as if there had been no end; else they jump.

    Attributes
    ----------
    done : int
        Steps that are done.
    preparation, compilation, elapsed : float
        Time before the first step, time of compilation in it, and time of the steps, s.
    """

    def __init__(
        self,
        given: System,
        plan: Plan,
        start: tuple[FloatArray, ...],
        tolerance: float,
        ending: Ending | None = None,
    ) -> None:
        self.given, self.plan = given, plan
        # Velocities in the equations that are stepped are the true ones over `warp`.
        self.warp, self.to = plan.warp, arranged(given)
        self.to = replace(self.to, system=warped(self.to.system, self.warp))
        self.system, self.h, self.n_steps, self.done = self.to.system, plan.step, plan.n_steps, 0
        self.loads = LoadSteps(self.system, self.h, self.n_steps)
        by_cycle = plan.cycle_steps is not None and plan.until != "steady"
        self.recorder = Recorder(self.system, plan.save, self.n_steps, self.h, by_cycle=by_cycle)
        u, v = self.to.inner(start[0]), self.to.inner(start[1]) / self.warp
        kind: type[Stepper] = PythonStepper
        if self.to.kind in ("chain", "dense"):
            from skfem_joint.stepping.time_loop import CompiledStepper  # loads the compiler

            kind = CompiledStepper
        others = self.system, plan.scheme, u, v, tolerance, self.recorder
        self.stepper = kind(self.to.kind, *others)
        # Steps in the next call of the stepper.
        self.at_once = min(self.stepper.first_call, self.stepper.most_at_once)
        if len(start) > 2:
            self.stepper.now = self.stepper.now._replace(sigma=self.stepper.placed(start[2]))
        if len(start) > 3:
            self.stepper.forces.limits = np.array(start[3])
        watch = Stopwatch()
        if ending is not None and self._continues(ending):
            self.stepper.restore(dict(ending.state))
        else:
            self.restart(0.0)
        self.stepper.prepare(self.h)
        (self.preparation, self.compilation), self.elapsed = watch.read(), 0.0
        self.begin(self.recorder)

    def _continues(self, ending: Ending) -> bool:
        """Whether the loads at the start are those at an end, beside the forces there."""
        system, (u, _, _, d) = self.system, dict(ending.state)["state"]
        force = self.recorder.vectors @ self.loads.at(0.0)[:, 0]
        forces = force, ending.force, system.K @ u, system.M @ d
        largest = max(float(np.abs(f).max(initial=0.0)) for f in forces)
        return float(np.abs(force - ending.force).max(initial=0.0)) <= CONTINUED * largest

    def _ending(self) -> Ending:
        """State now, as a further run goes on from it."""
        last = max(self.done - 1, 0)
        amplitudes = self.loads.at(self.h * last, self.h * self.done)[:, -1]
        return Ending(tuple(self.stepper.ending().items()), self.recorder.vectors @ amplitudes)

    def begin(self, recorder: Recorder) -> None:
        """Record from the state now on, whose row is stored."""
        self.recorder = self.stepper.recorder = recorder
        state = self.stepper.state()
        forces = self.stepper.forces
        recorder.store(0, state, forces.limits)
        forces.store(recorder, 0)
        recorder.observe(state, forces.limits)

    def run(
        self,
        progress: Callable[..., None] | None,
        checkpoint: Checkpoint | None,
        identity: str,
    ) -> bool:
        """Advance to the end, chunk by chunk; whether that was interrupted.

        ``identity`` is the fingerprint of the run in its ``checkpoint``.
        """
        n_steps, cycle_steps = self.n_steps, self.plan.cycle_steps
        last_saved = self.done
        mark: tuple[dict[str, Arrays], int, float] | None = self.mark()
        try:
            while self.done < n_steps:
                end = n_steps
                if cycle_steps is not None:
                    end = min(end, (self.done // cycle_steps + 1) * cycle_steps)
                begin = time.perf_counter()
                self.advance(end, CHUNK_S)
                self.elapsed += time.perf_counter() - begin
                if cycle_steps is not None and self.done % cycle_steps == 0:
                    self.recorder.end_cycle()
                mark = None  # two would take much memory, and nothing is half done here
                mark, done = self.mark(), self.done
                if checkpoint is not None and checkpoint.due(done, last_saved, n_steps):
                    parts = {"recorder": self.recorder.saved(), "stepper": self.stepper.saved()}
                    checkpoint.save(parts, identity, done, self.elapsed)
                    last_saved = done
                if progress is not None:
                    progress(done, n_steps)
        except KeyboardInterrupt:
            if mark is not None:
                self.take_up(*mark)
            return True
        return False

    def check(self, checkpoint: Checkpoint, parts: Mapping[str, Arrays], done: int) -> None:
        """See that a checkpoint is one of this run after ``done`` steps; InputError if not."""
        try:
            if done > self.n_steps:
                raise ValueError(f"found {done} steps done, must be at most {self.n_steps}")
            if parts.keys() != {"recorder", "stepper"}:
                raise ValueError("it holds other parts than a run")
            cycle_steps = self.plan.cycle_steps
            cycles = 0 if cycle_steps is None else done // cycle_steps
            self.recorder.check(parts["recorder"], done, cycles)
            self.stepper.check(parts["stepper"])
        except ValueError as error:
            raise checkpoint.unreadable(str(error)) from error

    def take_up(self, parts: Mapping[str, Arrays], done: int, elapsed: float) -> None:
        """Go on from a checkpoint, or from a `mark`, wherever a chunk has stopped."""
        self.done, self.elapsed = done, elapsed
        self.recorder.restore(parts["recorder"])
        self.stepper.restore(parts["stepper"])

    def mark(self) -> tuple[dict[str, Arrays], int, float]:
        """All that the next chunk may change."""
        parts: dict[str, Arrays] = {"recorder": self.recorder.mark()}
        parts["stepper"] = self.stepper.saved()
        return parts, self.done, self.elapsed

    def finish(self, energy: float, interrupted: bool = False) -> Run:
        """Run of the steps done, in the unknowns of the system that was given.

        ``energy`` is the energy stored at the start, J.
        """
        state, to = self.stepper.state(), self.to
        said = "%d of %d steps in %.3g s, after %.3g s of preparation; %s."
        counts = ", ".join(
            f"{n} {name.replace('_', ' ')}" for name, n in self.stepper.counts.items()
        )
        _log.info(said, self.done, self.n_steps, self.elapsed, self.preparation, counts)
        run = self.recorder.finish(
            energy,
            state.u,
            state.v,
            state.sigma,
            self.stepper.forces.limits,
            steps=self.done,
            wall_s=self.elapsed,
            preparation_s=self.preparation,
            compilation_s=self.compilation,
            interrupted=interrupted,
            counts=self.stepper.counts,
            ending=self._ending(),
        )
        final = Final(to.outer(run.final[0]), self.warp * to.outer(run.final[1]))
        v, point_v = self.warp * to.outer(run.v), self.warp * run.point_v
        u = to.outer(run.u)
        return replace(run, system=self.given, u=u, v=v, point_v=point_v, final=final)

    def restart(self, t: float) -> None:
        """Make the acceleration consistent with the loads just after ``t``."""
        if not self.stepper.restart(self.loads.at(t)[:, 0]):
            unknown = self.to.outer_number(self.stepper.failure.unknown)
            raise InputError(
                f"no consistent acceleration found at t = {t:.6g} s near unknown {unknown}; let "
                "the load rise in a ramp"
            )

    def advance(self, end: int, seconds: float = math.inf) -> None:
        """Advance to the end of step ``end - 1``, or until so much time has passed."""
        h, now = self.h, time.perf_counter()
        stop = now + seconds
        while self.done < end and now < stop:
            first, begin = self.done, now
            cut = self.loads.next_cut(first)
            if cut == first:
                ends = self.loads.parts(first)
                for a, b in pairwise(ends):
                    self._part(first, a, b, b == ends[-1], 0)
                self.done += 1
            else:
                last = min(end, first + self.at_once, self.loads.end_of_block(first))
                last = last if cut is None else min(last, cut)
                amplitudes = self.loads.of_steps(first, last)
                self.done += self.stepper.advance(h, amplitudes, first, True)
                if self.done < last:
                    self._halves(self.done, h * self.done, h * (self.done + 1), True, 1)
                    self.done += 1
            now = time.perf_counter()
            fitting = CALL_S * (self.done - first) / max(now - begin, 1e-9)
            # Four times those of the last call at most.
            most = min(4 * self.at_once, self.stepper.most_at_once)
            self.at_once = max(1, min(int(fitting), most))

    def _part(self, index: int, a: float, b: float, last: bool, depth: int) -> None:
        """One step from ``a`` to ``b`` inside step ``index``, in halves if it does not converge.

        ``last`` is whether step ``index`` ends with it, so that rows may be stored.
        """
        whole = abs((b - a) / self.h - 1.0) < 1e-9
        amplitudes = self.loads.at(a, b)
        if self.stepper.advance(self.h if whole else b - a, amplitudes, index, last) == 0:
            self._halves(index, a, b, last, depth + 1)
        if b in self.loads.jumps and b < self.h * self.n_steps:
            self.restart(b)

    def _halves(self, index: int, a: float, b: float, last: bool, depth: int) -> None:
        """The same in two parts, of which each may be halved again."""
        if depth > HALVINGS:
            failure = self.stepper.failure
            unknown = self.to.outer_number(failure.unknown)
            raise ConvergenceError(
                f"step {index} at t = {a:.6g} s did not converge, even with a step of "
                f"{b - a:.3g} s: force residual {failure.residual:.3g} N, largest at unknown "
                f"{unknown}. Nothing was returned. Try more steps per cycle, a smaller "
                "beta, or rho_infinity below 1.",
                unknown,
            )
        self.recorder.halved_steps += depth == 1
        middle = 0.5 * (a + b)
        self._part(index, a, middle, False, depth)
        self._part(index, middle, b, last, depth)


class PythonStepper(Stepper):
    """Steps done one by one in Python: of systems whose slips are unknowns, and of linear ones."""

    COUNTS: ClassVar[tuple[str, ...]] = (
        *("newton_iterations", "largest_iterations", "friction_evaluations", "linear_solves"),
        "renewed_limits",
    )

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        self.v_before = self.now.v

    def new_problem(self, c: Coefficients) -> StepProblem:
        """See `Stepper`."""
        s = self.system
        points = ContactPoints.of(s, c.c_K, c.h)
        return self.made(c.c_M * s.M + s.C + c.c_K * s.K, points)

    def prepare(self, h: float) -> None:
        """See `Stepper`."""
        if self.forces.limits is None:
            super().prepare(h)
        self.problem(self.coefficients(h)).compile()

    def started(self, acceleration: FloatArray, sigma: FloatArray) -> None:
        """Go on from the velocity now: earlier ones are forgotten."""
        super().started(acceleration, sigma)
        self.v_before = self.now.v

    def advance(self, h: float, amplitudes: FloatArray, first_step: int, store: bool) -> int:
        """Do the steps."""
        s, c, recorder = self.system, self.coefficients(h), self.recorder
        problem, forces, done = self.problem(c), self.forces, 0
        for ends in pairwise(amplitudes.T):
            before = u, v, a, d, sigma = self.now
            predictor = u + c.u_v * v + c.u_a * a
            right = recorder.vectors @ ends[1] - s.K @ predictor
            right += s.M @ (c.c_M * v + c.y_a * a + c.y_d * d)
            of_contact, pressed = forces.before(c, u, predictor)
            right += of_contact
            offset, start = None, self._extrapolated()
            if s.contact.has_springs:
                limits = s.contact.w if forces.limits is None else forces.limits
                known, force = c.u_v * v + c.u_a * a, s.contact.on_rows(limits) * sigma
                offset = s.contact.spring_offset(known, force, c.c_K)
            minimum = problem.minimise(right, start, self.tolerance, offset=offset, pressed=pressed)
            self._count(minimum.counts)
            if not minimum.converged:
                self.failure = FailedStep(minimum.residual, minimum.where)
                break
            forces.after(c, minimum)
            v_new, self.v_before = minimum.v, v
            a = c.a_v * (v_new - v) + c.a_a * a
            d = c.d_a * a + c.d_a0 * before.a + c.d_d0 * d
            self.now = State(predictor + c.c_K * v_new, v_new, a, d, minimum.sigma)
            works = forces.works(recorder, before, self.now)
            recorder.add_step(h, ends, before, self.now, c.trapezoidal, **works)
            done += 1
            self.frequency = 0.0
            if store:
                recorder.store(first_step + done, self.now, forces.limits)
                forces.store(recorder, first_step + done)
        return done

    def _extrapolated(self) -> FloatArray | None:
        """Start of a step: extrapolated velocity, in which points at rest stay at rest."""
        if self.kind == "linear":
            return None
        v, unknowns = 2.0 * self.now.v - self.v_before, self.points.unknowns
        v[unknowns[self.points.on_rows(self.points.at_rest(self.now.v[unknowns]))]] = 0.0
        return v

    def _count(self, counts: Mapping[str, int]) -> None:
        for name, count in counts.items():
            self.counts[name] += count
        iterations = counts.get("newton_iterations", 0)
        self.counts["largest_iterations"] = max(self.counts["largest_iterations"], iterations)

    def go_on(self, now: State, beside: FloatArray) -> None:
        """See `Stepper`."""
        super().go_on(now, beside)
        if beside.size:
            self.v_before = now.v

    def _own(self) -> dict[str, NDArray[Any]]:
        """State, and the velocity before it."""
        return super()._own() | {"before": np.array(self.v_before)}

    def restore(self, saved: Saved) -> None:
        """Take up a saved state."""
        super().restore(saved)
        self.v_before = np.array(saved["before"])
