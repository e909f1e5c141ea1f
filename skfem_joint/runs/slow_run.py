"""Quasi-static runs: displacement, friction and slip as the loads change slowly, level by level.

Inertia and damping are left out. A run has the steps of a plan, of which each is a level of the
loads, cut where the loads jump or kink as the steps of `integrate` are. A level that does not
converge is reached in parts. One that has no solution, because friction does not hold the loads,
ends the run with a `ConvergenceError` that carries what was reached.

How a level is solved is in :mod:`skfem_joint.slow.quasi_static`.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import Any, NoReturn

import numpy as np

from skfem_joint.ground.arrays import FloatArray
from skfem_joint.ground.errors import ConvergenceError, InputError
from skfem_joint.slow.levels import Level, NoLevelError
from skfem_joint.slow.quasi_static import QuasiStatic, in_parts
from skfem_joint.stepping.load_steps import LoadSteps
from skfem_joint.stepping.loops import LoopRecorder
from skfem_joint.stepping.plan import Plan
from skfem_joint.stepping.recording import Final, Recorder, Run
from skfem_joint.stepping.schemes import State
from skfem_joint.stepping.stopwatch import Stopwatch
from skfem_joint.system.system import System

#: Progress is reported this often, s.
REPORTED_S = 0.2


def rate_independent(system: System) -> System:
    """System as slow motion sees it: without damping, under Coulomb's law.

    Without inertia the friction of an arctan law would not depend on how fast the loads change but
    creep for as long as they last: its ``beta`` counts as infinite, which a note says.
    """
    finite = bool(np.isfinite(system.contact.beta[system.contact.rubs]).any())
    if not finite and not np.any(system.C if system.is_dense else system.C.data):
        return system
    notes = system.notes
    if finite:
        notes = (
            *notes,
            f"beta = {system.contact.beta[system.contact.rubs].min():.3g} s/m counts as infinite: "
            "without inertia friction does not depend on velocity, and the law is Coulomb's.",
        )
    origin = system.origin
    if origin is not None:  # so that errors can still be estimated
        origin = replace(origin, system=rate_independent(origin.system))
    system = system.with_beta(np.inf)
    return replace(system, C=0.0 * system.K, notes=notes, origin=origin)


def slow_run(
    system: System,
    plan: Plan,
    *,
    tolerance: float,
    progress: Callable[..., None] | None = None,
) -> Run:
    """Follow a system through the levels of a plan, without inertia and damping.

    Parameters
    ----------
    system : System
    plan : Plan
    tolerance : float
        Largest force residual of a level relative to its largest force.
    progress : callable, optional
        Called with (levels done, levels in all).

    Returns
    -------
    Run
        After an interrupt (Ctrl-C) that of the levels finished, with ``interrupted`` set.

    Raises
    ------
    ConvergenceError
        If a level does not exist, or is not found; its ``run`` has all levels before.
    InputError
        If slip rows of a large sparse system depend on each other.
    """
    if system.serves is not None:  # its modes are those of vibration
        raise InputError(
            "quasi_static: found a reduced model for a range of frequencies, must be a full, "
            "condensed or reduced model without one"
        )
    watch = Stopwatch()
    system = rate_independent(system)
    driver = _SlowDriver(system, plan, QuasiStatic(system, tolerance, frictionless=True))
    driver.preparation, driver.compilation = watch.read()
    return driver.run(progress)


class _SlowDriver:
    """Goes from level to level and records them.

    Attributes
    ----------
    level : Level
        The last one that was found.
    amplitudes : ndarray, shape (loads,)
        Of its loads, N.
    done : int
        Steps that are done.
    started : bool
        Whether the loads that act from the start on are reached.
    preparation, compilation : float
        Time before the first level, and of compilation in it, s.
    """

    def __init__(self, given: System, plan: Plan, solver: QuasiStatic) -> None:
        self.given, self.plan, self.solver, self.done = given, plan, solver, 0
        self.system = solver.to.system
        self.loads = LoadSteps(self.system, plan.step, plan.n_steps)
        self.recorder = Recorder(
            self.system,
            plan.save,
            plan.n_steps,
            plan.step,
            creeps=False,
            by_cycle=plan.cycle_steps is not None,
        )
        self.loops = LoopRecorder(self.system)
        self.vectors = self.system.load_vectors()
        self.limits = self.system.contact.on_rows(self.system.contact.w)
        self.level, self.amplitudes = solver.rest(), np.zeros(len(self.system.loads))
        self.rate = np.zeros(self.system.n)
        self.started = False
        self.preparation = self.compilation = 0.0

    def run(self, progress: Callable[..., None] | None) -> Run:
        """All levels; see `slow_run`."""
        watch, shown, cycle = Stopwatch(), 0.0, self.plan.cycle_steps
        mark, interrupted = self._mark(), False
        try:
            self._start()
            self.started = True
            while self.done < self.plan.n_steps:
                mark = self._mark()
                self._step(self.done)
                self.done += 1
                self._store(self.done)
                if cycle is not None and self.done % cycle == 0:
                    self.recorder.end_cycle()
                now = time.perf_counter()
                if progress is not None and (now > shown or self.done == self.plan.n_steps):
                    shown = now + REPORTED_S
                    progress(self.done, self.plan.n_steps)
        except KeyboardInterrupt:
            self._back_to(mark)
            interrupted = True
        except NoLevelError as error:
            self._back_to(mark)
            self._end(error, self._finished(watch, True))
        return self._finished(watch, interrupted)

    def _start(self) -> None:
        """Loads that act from the start on are raised to it."""
        first = self.loads.at(0.0)[:, 0]
        if np.any(first):
            self._raise(first, 1.0)
        self._store(0)

    def _raise(self, amplitudes: FloatArray, h: float) -> None:
        """Level under amplitudes that the loads jump to, by levels as for a quarter of a cycle.

        Works are those of mean forces of increments: in one, what slips would take half of it.
        """
        steps = self.plan.cycle_steps or self.plan.n_steps
        before = self.amplitudes
        for share in np.linspace(0.0, 1.0, 1 + max(steps // 4, 2))[1:]:
            self._to(amplitudes if share == 1.0 else before + share * (amplitudes - before), h)

    def _step(self, step: int) -> None:
        """Go to the end of a step, by way of all jumps and kinks of the loads in it."""
        h = self.plan.step
        ends = [h * step, h * (step + 1)]
        if step in self.loads.cuts:
            ends = self.loads.parts(step)
        self.rate, before = np.zeros(self.system.n), self.level.u
        for a, b in pairwise(ends):
            after, last = self.loads.at(a, b).T
            if a in self.loads.jumps:
                self._raise(after, h)
            self._to(last, h)
        self.rate = (self.level.u - before) / h

    def _to(self, amplitudes: FloatArray, h: float) -> None:
        """Level under amplitudes (loads,), N, in parts if need be."""

        def next_level(last: Level, some: FloatArray) -> Level:
            return self.solver.next(last, self.vectors @ some)

        whole = True
        for some, level in in_parts(next_level, self.level, self.amplitudes, amplitudes):
            self.recorder.halved_steps += whole and some is not amplitudes
            whole = False
            self._add(some, level, h)

    def _add(self, amplitudes: FloatArray, level: Level, h: float) -> None:
        """Record the way to a level under amplitudes (loads,), N, which is the last one then."""
        both = self.amplitudes, amplitudes
        old, new = self._state(self.level), self._state(level)
        forces = None if level.limits is None else (self.level.friction, level.friction)
        self.recorder.add_step(
            h, both, old, new, trapezoidal=True, forces=forces, limits=level.limits
        )
        if self.level.normal is not None and level.normal is not None:  # what closing takes
            part = self.system.contact.normal
            moved = np.asarray(part.N @ (level.u - self.level.u))
            self.recorder.impact_work += part.work_left(self.level.normal, level.normal, moved)
        self.level, self.amplitudes = level, amplitudes

    def _state(self, level: Level) -> State:
        """State of a level, as the recorder takes it."""
        still = np.zeros(self.system.n)
        limits = self.limits if level.limits is None else self.system.contact.on_rows(level.limits)
        sigma = np.divide(level.friction, limits, out=np.zeros_like(limits), where=limits > 0.0)
        return State(level.u, self.rate, still, still, sigma)

    def _store(self, step: int) -> None:
        """Store what is due after so many steps."""
        level = self.level
        self.recorder.store(step, self._state(level), level.limits)
        if level.normal is not None:
            self.recorder.store_normal(step, level.normal)
        self.loops.add(
            self.amplitudes, level.u, level.friction, level.slip, self.recorder.friction_work
        )

    def _mark(self) -> tuple[Any, ...]:
        """All that the next step may change."""
        state = self.level, self.amplitudes, self.rate, self.done
        return *state, len(self.loops.rows), self.recorder.mark()

    def _back_to(self, mark: tuple[Any, ...]) -> None:
        """Take back a step that did not end."""
        self.level, self.amplitudes, self.rate, self.done, rows, recorded = mark
        del self.loops.rows[rows:]
        self.recorder.restore(recorded)
        if not self.loops.rows:  # not even the loads of the start were reached
            self._store(0)

    def _end(self, error: NoLevelError, run: Run) -> NoReturn:
        """Raise the error that ends a run, with what was reached."""
        h, step = self.plan.step, self.done
        shown = ", ".join(
            f"{name} {amplitude:.6g} N"
            for name, amplitude in zip(
                (load.on or "load" for load in self.system.loads), self.amplitudes, strict=True
            )
        )
        why = str(error) if error.beyond else f"it was not found, {error}"
        tried = h * (step + 1) if self.started else 0.0
        raise ConvergenceError(
            f"quasi-static run: there is no level at t = {tried:.6g} s: {why}. The last level is "
            f"that of t = {h * step:.6g} s, under {shown or 'no load'}; all {step} levels up to it "
            "are kept",
            error.unknown,
            run,
        ) from error

    def _finished(self, watch: Stopwatch, interrupted: bool) -> Run:
        """Run of the levels done, in the unknowns of the system that was given."""
        (elapsed, compiled), to = watch.read(), self.solver.to
        still = np.zeros(self.system.n)
        run = self.recorder.finish(
            0.0,
            self.level.u,
            still,
            self._state(self.level).sigma,
            self.level.limits,
            steps=self.done,
            wall_s=elapsed,
            preparation_s=self.preparation,
            compilation_s=self.compilation + compiled,
            interrupted=interrupted,
            counts=self.solver.counts,
            loops=self.loops.finish(self.plan.step, self.plan.cycle_steps),
            plan=self.plan,
        )
        final = Final(*map(to.outer, run.final))
        u, v = to.outer(run.u), to.outer(run.v)
        return replace(run, system=self.given, u=u, v=v, final=final)
