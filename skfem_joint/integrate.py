"""Implicit time integration of any system: the driver around the steppers.

The driver lays the steps out so that jumps and kinks of the loads fall on step ends, advances in
chunks (progress, Ctrl-C), does a step that does not converge in halves, and raises
:class:`ConvergenceError` when that does not help either.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from skfem_joint.checkpoint import Checkpoint, fingerprint
from skfem_joint.errors import ConvergenceError, InputError
from skfem_joint.recording import Recorder, Run, Save
from skfem_joint.resolution import check_resolution
from skfem_joint.schemes import Scheme, generalized_alpha
from skfem_joint.steppers import ChainStepper, choose
from skfem_joint.steppers_shared import Stepper
from skfem_joint.system import System

FloatArray = NDArray[np.float64]

#: Largest force residual of a step, relative to its largest force.
TOLERANCE = 1e-11
#: A step that does not converge is halved at most this often.
HALVINGS = 8
#: Steps between two chances to stop, save, and show progress; fewer for large systems.
MOST_STEPS_IN_A_CHUNK = 20_000
#: Kinks of a load are met exactly only if there are fewer than this; jumps always.
MOST_KINKS = 64


def integrate(
    system: System,
    *,
    step: float,
    n_steps: int,
    scheme: Scheme | None = None,
    save: Save | None = None,
    cycle_steps: int | None = None,
    initial: tuple[FloatArray, FloatArray] | None = None,
    tolerance: float = TOLERANCE,
    progress: Callable[[int, int], None] | None = None,
    checkpoint: Checkpoint | None = None,
) -> Run:
    """Integrate a system over ``n_steps`` equal steps.

    Parameters
    ----------
    system : System
    step : float
        Time step, s.
    n_steps : int
    scheme : Scheme, optional
        Average acceleration if not given.
    save : Save, optional
        What to store; the named points at every step if not given. Peaks and works are
        accumulated over every step in any case.
    cycle_steps : int, optional
        Steps of one cycle: works and peaks are also noted cycle by cycle.
    initial : tuple of ndarray, shape (n,), optional
        Displacement (m) and velocity (m/s) at the start; at rest if not given.
    tolerance : float
        Largest force residual of a step relative to its largest force.
    progress : callable, optional
        Called with (steps done, steps in all).
    checkpoint : Checkpoint, optional
        Where to save the run as it goes on, and to take it up again. Neither changes a bit of the
        result but the times that it took.

    Returns
    -------
    Run

    Raises
    ------
    ConvergenceError
        If a step does not converge, even in 256 parts.
    InputError
        If the step or the number of steps is not positive, no stepper fits the system, or the
        checkpoint cannot be written or is not one of this run.
    """
    if not (step > 0.0 and np.isfinite(step)):
        raise InputError(f"step: found {step}, must be > 0")
    if n_steps < 1:
        raise InputError(f"n_steps: found {n_steps}, must be >= 1")
    if cycle_steps is not None and cycle_steps < 1:
        raise InputError(f"cycle_steps: found {cycle_steps}, must be >= 1")
    if initial is None:
        u, v = np.zeros(system.n), np.zeros(system.n)
    else:
        u, v = (np.array(x, dtype=float) for x in initial)
        if not (np.all(np.isfinite(u)) and np.all(np.isfinite(v))):
            raise InputError("initial: must be finite")
        if u.shape != (system.n,) or v.shape != (system.n,):
            raise InputError(f"initial: shapes must be ({system.n},)")
    check_resolution(system, step, n_steps)
    save, scheme = save or Save(), scheme or generalized_alpha()
    saved, identity = None, ""
    if checkpoint is not None:
        identity = fingerprint(system, step, n_steps, scheme, save, cycle_steps, u, v, tolerance)
        saved = checkpoint.load(identity)
    recorder = Recorder(system, save, n_steps, step)
    stepper = choose(system, scheme, u, v, tolerance, recorder)
    driver = _Driver(system, stepper, recorder, step)
    driver.lay_out(n_steps)
    start_energy = 0.0 if initial is None else system.stored_energy(u, v)
    begin = time.perf_counter()
    at_start = system.load_amplitudes(np.array([0.0]))
    stepper.restart(at_start[:, 0])
    stepper.advance(step, at_start, 0, False)  # no step: prepares and compiles
    preparation = time.perf_counter() - begin
    elapsed = 0.0
    done = 0
    if saved is None:
        if initial is not None:
            recorder.observe(u)
        recorder.store(0, u, v, stepper.normalised_friction())
    else:
        parts, done, elapsed = saved
        recorder.restore(parts["recorder"])
        stepper.restore(parts["stepper"])
    last_saved = done
    # Checkpoints are written between chunks, never shorten one: steps are the same with them.
    chunk = max(1, min(MOST_STEPS_IN_A_CHUNK, 2_000_000 // system.n))
    interrupted = False
    try:
        while done < n_steps:
            end = min(done + chunk, n_steps)
            if cycle_steps is not None:
                end = min(end, (done // cycle_steps + 1) * cycle_steps)
            begin = time.perf_counter()
            driver.advance(done, end)
            elapsed += time.perf_counter() - begin
            done = end
            if cycle_steps is not None and done % cycle_steps == 0:
                recorder.end_cycle()
            if checkpoint is not None and checkpoint.due(done, last_saved, n_steps):
                parts = {"recorder": recorder.saved(), "stepper": stepper.saved()}
                checkpoint.save(parts, identity, done, elapsed)
                last_saved = done
            if progress is not None:
                progress(done, n_steps)
    except KeyboardInterrupt:
        interrupted = True
    u, v = stepper.state()
    counts = recorder.counters
    tiers = "nested_solves" if isinstance(stepper, ChainStepper) else "line_searches"
    return recorder.finish(
        start_energy,
        u,
        v,
        elapsed,
        preparation,
        done,
        interrupted,
        newton_iterations=int(counts[0]),
        friction_evaluations=int(counts[3]),
        linear_solves=int(counts[6]),
        largest_iterations=int(counts[4]),
        descents=int(counts[2]),
        **{tiers: int(counts[1])},
    )


@dataclass
class _Driver:
    """Advances a stepper along a run whose steps are cut where loads jump or kink.

    Attributes
    ----------
    cuts : dict
        By step index: the times at which the step is cut (none if it only has to stand alone).
    jumps : dict
        By end of a step or part: the time of the load's jump there.
    """

    system: System
    stepper: Stepper
    recorder: Recorder
    h: float
    cuts: dict[int, list[float]] = field(default_factory=dict)
    jumps: dict[float, float] = field(default_factory=dict)

    def lay_out(self, n_steps: int) -> None:
        """Find where the steps have to be cut."""
        h = self.h
        self.cuts.setdefault(0, [])  # the first step, and each after a jump, stand alone
        for load in self.system.loads:
            corners = [t for t in load.amplitude.corners if 0.0 < t < n_steps * h]
            for t in corners:
                before, after = np.asarray(load.amplitude(np.array([np.nextafter(t, 0.0), t])))
                jump = abs(after - before) > 1e-9 * max(abs(after), abs(before))
                if not jump and len(corners) > MOST_KINKS:
                    continue
                k = round(t / h)
                on_grid = abs(t - k * h) <= 1e-9 * h
                if jump:
                    self.jumps[k * h if on_grid else t] = t
                    if on_grid:
                        self.cuts.setdefault(k - 1, [])  # a step that ends at a jump stands alone
                        self.cuts.setdefault(k, [])
                if not on_grid:
                    cuts = self.cuts.setdefault(int(t // h), [])
                    if t not in cuts:
                        cuts.append(t)

    def advance(self, first: int, end: int) -> None:
        """Advance from step ``first`` to step ``end``."""
        h = self.h
        while first < end:
            cut = min((k for k in self.cuts if first <= k < end), default=end)
            if cut > first:
                amplitudes = self._amplitudes(h * np.arange(first, cut + 1, dtype=np.float64))
                first += self.stepper.advance(h, amplitudes, first, True)
                if first < cut:
                    self._halves(first, h * first, h * (first + 1), True, 1)
                    first += 1
                continue
            ends = [h * first, *sorted(self.cuts[first]), h * (first + 1)]
            for a, b in pairwise(ends):
                self._part(first, a, b, b == ends[-1], 0)
            first += 1

    def _amplitudes(self, times: FloatArray) -> FloatArray:
        """Load amplitudes: at the first and last time the limit from inside where a load jumps."""
        amplitudes = self.system.load_amplitudes(times)
        if times[0] in self.jumps:
            amplitudes[:, 0] = self._after(times[0])
        if times[-1] in self.jumps:
            amplitudes[:, -1] = self._before(times[-1])
        return amplitudes

    def _before(self, t: float) -> FloatArray:
        """Load amplitudes at the end of a step: the limit from before where a load jumps."""
        if t in self.jumps:
            t = float(np.nextafter(self.jumps[t], 0.0))
        return self.system.load_amplitudes(np.array([t]))[:, 0]

    def _after(self, t: float) -> FloatArray:
        """Load amplitudes at the start of a step: the limit from after where a load jumps."""
        return self.system.load_amplitudes(np.array([self.jumps.get(t, t)]))[:, 0]

    def _part(self, index: int, a: float, b: float, last: bool, depth: int) -> None:
        """One step from ``a`` to ``b`` inside step ``index``, in halves if it does not converge.

        ``last`` tells whether step ``index`` ends with it, so that rows may be stored.
        """
        amplitudes = self._amplitudes(np.array([a, b]))
        whole = abs((b - a) / self.h - 1.0) < 1e-9
        if self.stepper.advance(self.h if whole else b - a, amplitudes, index, last) == 0:
            self._halves(index, a, b, last, depth + 1)
        if b in self.jumps:
            self.stepper.restart(self._after(b))

    def _halves(self, index: int, a: float, b: float, last: bool, depth: int) -> None:
        if depth > HALVINGS:
            failure = self.stepper.failure
            raise ConvergenceError(
                f"step {index} at t = {a:.6g} s did not converge, even with a step of "
                f"{b - a:.3g} s: force residual {failure.residual:.3g} N, largest at unknown "
                f"{failure.unknown}. Nothing was returned. Try more steps per cycle, a smaller "
                "beta, or rho_infinity below 1.",
                failure.unknown,
            )
        self.recorder.halved_steps += depth == 1
        middle = 0.5 * (a + b)
        self._part(index, a, middle, False, depth)
        self._part(index, middle, b, last, depth)
