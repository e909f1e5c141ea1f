"""Implicit time integration of any system: the driver around the steppers.

The driver lays the steps out so that jumps and kinks of the loads fall on step ends, advances in
chunks (progress, Ctrl-C), does a step that does not converge in halves, and raises
:class:`ConvergenceError` when that does not help either. Where chunks end changes no bit of the
result.
"""

from __future__ import annotations

import logging
import math
import time
from bisect import bisect_left
from collections.abc import Callable, Mapping
from dataclasses import replace
from itertools import pairwise
from typing import Any, Literal

import numpy as np

from skfem_joint.arrays import FloatArray, as_real
from skfem_joint.errors import ConvergenceError, InputError
from skfem_joint.loads import common_period
from skfem_joint.stepping.arrangement import arranged, choose
from skfem_joint.stepping.checkpoint import Arrays, Checkpoint, fingerprint
from skfem_joint.stepping.plan import Plan
from skfem_joint.stepping.recording import Recorder, Run, Save, Steady
from skfem_joint.stepping.resolution import check_resolution
from skfem_joint.stepping.schemes import Scheme, State, generalized_alpha
from skfem_joint.stepping.steady import CHANGE, copied, periodic_state, turns_over
from skfem_joint.stepping.stopwatch import Stopwatch
from skfem_joint.system import System
from skfem_joint.values import COUNT, POSITIVE, between, check, check_some

_log = logging.getLogger(__name__)

#: Largest force residual of a step, relative to its largest force.
TOLERANCE = 1e-11
#: Range of those that may be asked for: a looser one lets loads pass as converged that do nothing.
LOOSEST = between(0.0, 1e-3, ", relative to the largest force of a step")
#: A step that does not converge is halved at most this often.
HALVINGS = 8
#: A chunk, between two chances to save and show progress, ends when so much time (s) has passed.
CHUNK_S = 0.5
#: It is handed to the stepper in calls that take about this long (s), between which Ctrl-C is seen;
#: the next one is at most so many times longer.
CALL_S = 0.1
GROWTH = 4
#: Steps for which the loads are evaluated together, always the same ones.
BLOCK = 16_384
#: Kinks of a load are met exactly only if there are fewer than this; jumps always.
MOST_KINKS = 64


def integrate(
    system: System,
    *,
    step: float | None = None,
    n_steps: int | None = None,
    duration: float | None = None,
    cycles: int | None = None,
    steps_per_cycle: int | None = None,
    scheme: Scheme | None = None,
    save: Save | None = None,
    cycle_steps: int | None = None,
    until: Literal["end", "steady"] = "end",
    initial: tuple[FloatArray, FloatArray] | None = None,
    tolerance: float = TOLERANCE,
    progress: Callable[..., None] | None = None,
    checkpoint: Checkpoint | None = None,
) -> Run:
    """Integrate a system over equal steps: ``n_steps`` or a ``duration`` of them, or ``cycles``.

    Parameters
    ----------
    system : System
    step, n_steps, duration
        Time step, s, and how many of them, or s; the last step ends at it or just beyond it.
    cycles, steps_per_cycle : int
        Cycles of the loads' common period, and steps in each.
    scheme : Scheme, optional
        Average acceleration if not given.
    save : Save, optional
        What to store; the named points at every step if not given. Peaks and works are of all.
    cycle_steps : int, optional
        Steps of one cycle: works and peaks are also noted cycle by cycle. As ``steps_per_cycle``
        says, if that is given.
    until : {"end", "steady"}
        ``"steady"`` gives the one period at which vibration under loads that repeat has become
        steady, see :mod:`skfem_joint.stepping.steady`; its amplitudes and offsets are in
        `Run.steady`.
    initial : tuple of ndarray, shape (n,), optional
        Displacement (m) and velocity (m/s) at the start; at rest if not given.
    tolerance : float
        Largest force residual of a step relative to its largest force, at most 1e-3.
    progress : callable, optional
        Called with (steps done, steps in all); until "steady" with (periods done, 0, a note).
    checkpoint : Checkpoint, optional
        Where to save the run and to take it up again; neither changes a bit of the result.

    Returns
    -------
    Run
        After an interrupt that of the steps finished, with ``interrupted`` set.

    Raises
    ------
    ConvergenceError
        If a step does not converge, even in 256 parts, or no steady vibration is found.
    InputError
        If a number is out of range, the steps are not given in one of the three ways, or are too
        long for a load, no stepper fits the system, or the checkpoint cannot be written or is not
        one of this run.
    """
    check_some(POSITIVE, step=step, duration=duration)
    counts = {"n_steps": n_steps, "cycles": cycles, "steps_per_cycle": steps_per_cycle}
    check_some(COUNT, cycle_steps=cycle_steps, **counts)
    if cycles is not None or steps_per_cycle is not None:
        others = (step, n_steps, duration, cycle_steps)
        cycles = 1 if cycles is None and until == "steady" else cycles
        step, n_steps = _by_cycles(system, cycles, steps_per_cycle, others)
        cycle_steps = steps_per_cycle
    step, n_steps = _steps(step, n_steps, duration)
    plan = Plan(step, n_steps, scheme or generalized_alpha(), save or Save(), cycle_steps, until)
    return integrate_plan(
        system,
        plan,
        initial=initial,
        tolerance=tolerance,
        progress=progress,
        checkpoint=checkpoint,
    )


def integrate_plan(
    system: System,
    plan: Plan,
    *,
    initial: tuple[FloatArray, FloatArray] | None = None,
    tolerance: float = TOLERANCE,
    progress: Callable[..., None] | None = None,
    checkpoint: Checkpoint | None = None,
) -> Run:
    """Integrate a system as a plan says; what `integrate` does with its arguments checked.

    Arguments, result and errors are those of `integrate`.
    """
    check("tolerance", tolerance, LOOSEST)
    start = _start(system, initial)
    steady = plan.until == "steady"
    if steady:
        _check_steady(system, plan, checkpoint)
    check_resolution(system, plan.step, plan.n_steps, steady)
    identity = fingerprint(system, plan, *start, tolerance) if checkpoint else ""
    saved = checkpoint.load(identity) if checkpoint else None
    driver = _Driver(system, plan, start, float(tolerance))
    if saved is not None and checkpoint is not None:
        driver.check(checkpoint, saved[0], saved[1])
        driver.take_up(*saved)
    if steady:
        return driver.steady(progress)
    interrupted = _run(driver, progress, checkpoint, identity)
    return driver.finish(system.stored_energy(*start), interrupted)


def _by_cycles(
    system: System, cycles: int | None, steps_per_cycle: int | None, others: tuple[Any, ...]
) -> tuple[float, int]:
    """Step and number of steps of a run in cycles."""
    if cycles is None or steps_per_cycle is None or others != (None,) * len(others):
        raise InputError(
            "cycles: must come with steps_per_cycle, and without step, n_steps, duration and "
            "cycle_steps"
        )
    period = common_period(load.amplitude for load in system.loads)
    if period is None:
        raise InputError(
            "cycles: the loads have no common period that is known (only harmonics of commensurate "
            "frequencies have); give step and n_steps, or duration and step"
        )
    return period / steps_per_cycle, cycles * steps_per_cycle


def _steps(step: float | None, n_steps: int | None, duration: float | None) -> tuple[float, int]:
    """Step and number of steps."""
    if step is None or (n_steps is None) == (duration is None):
        raise InputError(
            "integrate: needs step and n_steps, or duration and step, or cycles and steps_per_cycle"
        )
    if duration is not None:
        n_steps = max(1, math.ceil(min(duration / step, 1e18) * (1.0 - 1e-9)))
    return float(step), int(n_steps or 1)


def _check_steady(system: System, plan: Plan, checkpoint: Checkpoint | None) -> None:
    """Refuse what has no steady vibration, or none that is a period long."""
    period = common_period(load.amplitude for load in system.loads)
    if period is None or abs(plan.duration / period - 1.0) > 1e-9:
        raise InputError(
            "until: 'steady' needs loads that repeat, and a run of one of their common periods: "
            "give steps_per_cycle"
        )
    if checkpoint is not None:
        raise InputError("until: a search for what is 'steady' has no checkpoints; leave them out")
    damped = abs(system.C).max() > 0.0 or not plan.scheme.coefficients(1.0)[-1]
    if not (damped or system.contact_points):
        raise InputError(
            "until: nothing is 'steady' with neither friction nor damping; give damping, such as "
            "[damping] ratio = 0.002 in a scene"
        )


def _start(
    system: System, initial: tuple[FloatArray, FloatArray] | None
) -> tuple[FloatArray, FloatArray]:
    """Displacement and velocity at the start, checked."""
    if initial is None:
        return np.zeros(system.n), np.zeros(system.n)
    u, v = (np.array(as_real(x, "initial")) for x in initial)
    if not (np.all(np.isfinite(u)) and np.all(np.isfinite(v))):
        raise InputError("initial: must be finite")
    if u.shape != (system.n,) or v.shape != (system.n,):
        raise InputError(f"initial: shapes must be ({system.n},)")
    return u, v


def _run(
    driver: _Driver,
    progress: Callable[[int, int], None] | None,
    checkpoint: Checkpoint | None,
    identity: str,
) -> bool:
    """Advance to the end, chunk by chunk; whether that was interrupted."""
    recorder, stepper = driver.recorder, driver.stepper
    n_steps, cycle_steps = driver.n_steps, driver.plan.cycle_steps
    last_saved, mark = driver.done, driver.mark()
    try:
        while driver.done < n_steps:
            end = n_steps
            if cycle_steps is not None:
                end = min(end, (driver.done // cycle_steps + 1) * cycle_steps)
            begin = time.perf_counter()
            driver.advance(end, CHUNK_S)
            driver.elapsed += time.perf_counter() - begin
            if cycle_steps is not None and driver.done % cycle_steps == 0:
                recorder.end_cycle()
            mark, done = driver.mark(), driver.done
            if checkpoint is not None and checkpoint.due(done, last_saved, n_steps):
                parts = {"recorder": recorder.saved(), "stepper": stepper.saved()}
                checkpoint.save(parts, identity, done, driver.elapsed)
                last_saved = done
            if progress is not None:
                progress(done, n_steps)
    except KeyboardInterrupt:
        driver.take_up(*mark)
        return True
    return False


class _Driver:
    """Advances a stepper along a run whose steps are cut where loads jump or kink.

    Made, it is at the start, with its first row stored. ``preparation`` and ``compilation`` are
    the times that took, s.
    """

    def __init__(
        self,
        given: System,
        plan: Plan,
        start: tuple[FloatArray, FloatArray],
        tolerance: float,
    ) -> None:
        step, n_steps = plan.step, plan.n_steps
        self.given, self.plan, self.to = given, plan, arranged(given)
        self.system, self.h, self.n_steps, self.done = self.to.system, step, n_steps, 0
        # By end of a step or part: the times of the loads' first and last jump there.
        self.jumps: dict[float, tuple[float, float]] = {}
        # Number and load amplitudes of the block of steps that was evaluated last.
        self.block: tuple[int, FloatArray] = (-1, np.zeros((0, 0)))
        # By step: the times at which it is cut, none if it only has to stand alone.
        self.cuts: dict[int, list[float]] = {0: []}  # the first step, and each after a jump, alone
        for load in self.system.loads:
            jumps = set(load.amplitude.jumps)
            last = (n_steps + 1e-9) * step  # the latest time that counts as the end
            corners = [t for t in load.amplitude.corners if 0.0 <= t <= last]
            for t in corners:
                if t in jumps or len(corners) <= MOST_KINKS:
                    self._lay(t, t in jumps)
        self.order = sorted(self.cuts)
        self.recorder = Recorder(self.system, plan.save, n_steps, step)
        u, v = map(self.to.inner, start)
        self.stepper = choose(self.to, plan.scheme, u, v, tolerance, self.recorder)
        # Steps in the next call of the stepper.
        self.at_once = min(self.stepper.first_call, self.stepper.most_at_once)
        watch = Stopwatch()
        self.restart(0.0)
        self.stepper.prepare(step)
        (self.preparation, self.compilation), self.elapsed = watch.read(), 0.0
        self.recorder.store(0, self.stepper.state())
        self.recorder.observe(self.stepper.state().u)

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

    def finish(self, energy: float, interrupted: bool = False) -> Run:
        """Run of the steps done, in the unknowns of the system that was given."""
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
            steps=self.done,
            wall_s=self.elapsed,
            preparation_s=self.preparation,
            compilation_s=self.compilation,
            interrupted=interrupted,
            counts=self.stepper.counts,
        )
        final = to.outer(run.final[0]), to.outer(run.final[1])
        return replace(run, system=self.given, u=to.outer(run.u), v=to.outer(run.v), final=final)

    def steady(self, progress: Callable[..., None] | None) -> Run:
        """Run of the period at which vibration has become steady."""
        save, nothing, begin = self.plan.save, Save(points=False), time.perf_counter()
        loads = self.system.load_amplitudes(self.h * np.arange(self.n_steps + 1.0))
        odd = turns_over(loads)
        parts = 2 if odd else 1  # of a period
        changes: list[float] = []

        def period(start: State, save: Save | None = None) -> tuple[State, float, float, float]:
            """Go through one period, or half of one whose other half is its mirror image."""
            self.done, energy, stepper = 0, 0.0, self.stepper
            steps = self.n_steps // 2 if odd and save is None else self.n_steps
            save = nothing if save is None else save
            self.recorder = stepper.recorder = Recorder(self.system, save, self.n_steps, self.h)
            stepper.now = start
            self.recorder.store(0, stepper.state())
            self.recorder.observe(start.u)
            for end in sorted({max(1, k * steps // 4) for k in (1, 2, 3, 4)}):
                while self.done < end:
                    self.advance(end, CHUNK_S)
                    if progress is not None:
                        gone = len(changes) / parts + self.done / self.n_steps
                        note = f"{gone:.1f} periods"
                        if changes:
                            note += f", change {changes[-1]:.1e} (steady: {CHANGE:.0e})"
                        progress(int(gone), 0, note)
                energy = max(energy, self.system.stored_energy(*stepper.now[:2]))
            if steps < self.n_steps:
                stepper.now = State(*(-part for part in stepper.now))
            work = float(np.abs(self.recorder.input_work).sum())
            return stepper.now, energy, work, float(self.recorder.friction_work.sum())

        steady = periodic_state(self.system, self.stepper.now, period, changes, parts)
        start, periods = copied(steady.state), -(-len(changes) // parts)
        period(copied(start), Save())
        drift = self.system.P @ steady.drift
        ahead = np.linspace(0.0, 1.0, self.n_steps + 1)[:, np.newaxis] * drift
        vibration = self.recorder.stored.point_u - ahead
        high, low = vibration.max(axis=0), vibration.min(axis=0)
        if save != Save():
            period(copied(start), save)
            periods += 1
        if self.plan.cycle_steps is not None:
            self.recorder.end_cycle()
        self.elapsed = time.perf_counter() - begin
        energy = self.system.stored_energy(*start[:2])
        run = self.finish(energy)
        counters = replace(run.counters, steps=(periods + 1) * self.n_steps)
        found = Steady(
            periods=periods,
            change=changes[-1],
            amplitude=0.5 * (high - low),
            offset=0.5 * (high + low),
            drift=drift,
            unstrained=steady.unstrained,
        )
        return replace(run, steady=found, counters=counters)

    def _lay(self, t: float, jump: bool) -> None:
        """Cut the step in which a load jumps or kinks."""
        h = self.h
        k = round(t / h)
        on_grid = abs(t - k * h) <= 1e-9 * h
        if jump:
            at = k * h if on_grid else t
            first, last = self.jumps.get(at, (t, t))
            self.jumps[at] = min(first, t), max(last, t)
            if on_grid and 0 < k < self.n_steps:
                self.cuts.setdefault(k - 1, [])  # a step that ends at a jump stands alone
                self.cuts.setdefault(k, [])
        if not on_grid:
            cuts = self.cuts.setdefault(int(t // h), [])
            if t not in cuts:
                cuts.append(t)

    def mark(self) -> tuple[dict[str, Arrays], int, float]:
        """All that the next chunk may change."""
        parts: dict[str, Arrays] = {"recorder": self.recorder.mark()}
        parts["stepper"] = self.stepper.saved()
        return parts, self.done, self.elapsed

    def restart(self, t: float) -> None:
        """Make the acceleration consistent with the loads just after ``t``."""
        if not self.stepper.restart(self._amplitudes(np.array([t]))[:, 0]):
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
            place = bisect_left(self.order, first)
            cut = min(self.order[place], end) if place < len(self.order) else end
            if cut == first:
                ends = [h * first, *sorted(self.cuts[first]), h * (first + 1)]
                for a, b in pairwise(ends):
                    self._part(first, a, b, b == ends[-1], 0)
                self.done += 1
            else:
                cut = min(cut, first + self.at_once, (first // BLOCK + 1) * BLOCK)
                self.done += self.stepper.advance(h, self._block(first, cut), first, True)
                if self.done < cut:
                    self._halves(self.done, h * self.done, h * (self.done + 1), True, 1)
                    self.done += 1
            now = time.perf_counter()
            fitting = CALL_S * (self.done - first) / max(now - begin, 1e-9)
            most = min(GROWTH * self.at_once, self.stepper.most_at_once)
            self.at_once = max(1, min(int(fitting), most))

    def _block(self, first: int, end: int) -> FloatArray:
        """Load amplitudes at the ends of the steps from ``first`` to ``end``, within one block."""
        number = first // BLOCK
        begin = number * BLOCK
        if self.block[0] != number:
            last = min(begin + BLOCK, self.n_steps)
            times = self.h * np.arange(begin, last + 1, dtype=np.float64)
            self.block = number, self.system.load_amplitudes(times)
        amplitudes = self.block[1][:, first - begin : end - begin + 1].copy()
        return self._limits(amplitudes, self.h * first, self.h * end)

    def _amplitudes(self, times: FloatArray) -> FloatArray:
        """Load amplitudes at the start and the end of a step, or at its start alone."""
        return self._limits(self.system.load_amplitudes(times), times[0], times[-1])

    def _limits(self, amplitudes: FloatArray, first: float, last: float) -> FloatArray:
        """Put in the limits from inside where loads jump at the first and the last time."""
        if last in self.jumps and last > first:
            before = np.nextafter(self.jumps[last][0], -np.inf)
            amplitudes[:, -1] = self.system.load_amplitudes(np.array([before]))[:, 0]
        if first in self.jumps:
            after = np.nextafter(self.jumps[first][1], np.inf)
            amplitudes[:, 0] = self.system.load_amplitudes(np.array([after]))[:, 0]
        return amplitudes

    def _part(self, index: int, a: float, b: float, last: bool, depth: int) -> None:
        """One step from ``a`` to ``b`` inside step ``index``, in halves if it does not converge.

        ``last`` tells whether step ``index`` ends with it, so that rows may be stored.
        """
        amplitudes = self._amplitudes(np.array([a, b]))
        whole = abs((b - a) / self.h - 1.0) < 1e-9
        if self.stepper.advance(self.h if whole else b - a, amplitudes, index, last) == 0:
            self._halves(index, a, b, last, depth + 1)
        if b in self.jumps and b < self.h * self.n_steps:
            self.restart(b)

    def _halves(self, index: int, a: float, b: float, last: bool, depth: int) -> None:
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
