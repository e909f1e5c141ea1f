"""Implicit time integration of any system: the driver around the steppers.

The driver lays the steps out so that jumps and kinks of the loads fall on step ends, advances in
chunks (progress, Ctrl-C), does a step that does not converge in halves, and raises
:class:`ConvergenceError` when that does not help either.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from skfem_joint.errors import ConvergenceError, InputError
from skfem_joint.recording import Recorder, Run, Save
from skfem_joint.schemes import Scheme, generalized_alpha
from skfem_joint.steppers import ChainStepper, Stepper, choose
from skfem_joint.system import System

FloatArray = NDArray[np.float64]

#: Largest force residual of a step, relative to its largest force.
TOLERANCE = 1e-11
#: A step that does not converge is halved at most this often.
HALVINGS = 8
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

    Returns
    -------
    Run

    Raises
    ------
    ConvergenceError
        If a step does not converge, even in 256 parts.
    InputError
        If the step or the number of steps is not positive, or no stepper fits the system.
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
    recorder = Recorder(system, save or Save(), n_steps, step)
    stepper = choose(system, scheme or generalized_alpha(), u, v, tolerance, recorder)
    layout = _layout(system, step, n_steps)
    start_energy = system.stored_energy(u, v)
    begin = time.perf_counter()
    at_start = system.load_amplitudes(np.array([0.0]))
    stepper.restart(at_start[:, 0])
    stepper.advance(step, at_start, 0, False)  # no step: prepares and compiles
    preparation = time.perf_counter() - begin
    recorder.observe(u)
    recorder.store(0, u, v, stepper.normalised_friction())
    chunk = max(1, min(20_000, 2_000_000 // system.n))
    elapsed = 0.0
    done = 0
    interrupted = False
    try:
        while done < n_steps:
            end = min(done + chunk, n_steps)
            if cycle_steps is not None:
                end = min(end, (done // cycle_steps + 1) * cycle_steps)
            begin = time.perf_counter()
            _advance(system, stepper, recorder, layout, done, end)
            elapsed += time.perf_counter() - begin
            done = end
            if cycle_steps is not None and done % cycle_steps == 0:
                recorder.end_cycle()
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
        largest_iterations=int(counts[4]),
        descents=int(counts[2]),
        **{tiers: int(counts[1])},
    )


class _Layout:
    """Where the steps are cut: by step index, the times inside it; and where loads jump."""

    def __init__(self, step: float) -> None:
        self.step = step
        self.cuts: dict[int, list[float]] = {}
        self.jumps: dict[float, float] = {}  # end of a step or part: the jump's own time


def _layout(system: System, step: float, n_steps: int) -> _Layout:
    layout = _Layout(step)
    for load in system.loads:
        corners = [t for t in load.amplitude.corners if 0.0 < t < n_steps * step]
        for t in corners:
            before, after = np.asarray(load.amplitude(np.array([np.nextafter(t, 0.0), t])))
            jump = abs(after - before) > 1e-9 * max(abs(after), abs(before))
            if not jump and len(corners) > MOST_KINKS:
                continue
            k = round(t / step)
            on_grid = abs(t - k * step) <= 1e-9 * step
            if jump:
                layout.jumps[k * step if on_grid else t] = t
                if on_grid:
                    layout.cuts.setdefault(k - 1, [])  # a step that ends at a jump stands alone
            if not on_grid:
                cuts = layout.cuts.setdefault(int(t // step), [])
                if t not in cuts:
                    cuts.append(t)
    return layout


def _advance(
    system: System, stepper: Stepper, recorder: Recorder, layout: _Layout, first: int, end: int
) -> None:
    """Advance from step ``first`` to step ``end``."""
    h = layout.step
    while first < end:
        cut = min((k for k in layout.cuts if first <= k < end), default=end)
        if cut > first:
            amplitudes = system.load_amplitudes(h * np.arange(first, cut + 1, dtype=np.float64))
            amplitudes[:, 0] = _after(system, h * first, layout)
            amplitudes[:, -1] = _before(system, h * cut, layout)
            first += stepper.advance(h, amplitudes, first, True)
            if first < cut:
                _halved(system, stepper, recorder, layout, first, h * first, h * (first + 1), 1)
                first += 1
            continue
        times = [h * first, *sorted(layout.cuts[first]), h * (first + 1)]
        for i, (a, b) in enumerate(pairwise(times)):
            last = i == len(times) - 2
            _part(system, stepper, recorder, layout, first, a, b, last, 0)
        first += 1


def _before(system: System, t: float, layout: _Layout) -> FloatArray:
    """Load amplitudes at the end of a step: the limit from before where a load jumps."""
    if t in layout.jumps:
        t = float(np.nextafter(layout.jumps[t], 0.0))
    return system.load_amplitudes(np.array([t]))[:, 0]


def _after(system: System, t: float, layout: _Layout) -> FloatArray:
    """Load amplitudes at the start of a step: the limit from after where a load jumps."""
    return system.load_amplitudes(np.array([layout.jumps.get(t, t)]))[:, 0]


def _part(
    system: System,
    stepper: Stepper,
    recorder: Recorder,
    layout: _Layout,
    index: int,
    a: float,
    b: float,
    last: bool,
    depth: int,
) -> None:
    """One step from ``a`` to ``b`` inside step ``index``, in halves if it does not converge."""
    amplitudes = np.stack([_after(system, a, layout), _before(system, b, layout)], axis=1)
    whole = abs((b - a) / layout.step - 1.0) < 1e-9
    if stepper.advance(layout.step if whole else b - a, amplitudes, index, last) == 0:
        _halved(system, stepper, recorder, layout, index, a, b, depth + 1, last)
    if b in layout.jumps:
        stepper.restart(_after(system, b, layout))


def _halved(
    system: System,
    stepper: Stepper,
    recorder: Recorder,
    layout: _Layout,
    index: int,
    a: float,
    b: float,
    depth: int,
    last: bool = True,
) -> None:
    if depth > HALVINGS:
        raise ConvergenceError(
            f"step {index} at t = {a:.6g} s did not converge, even with a step of {b - a:.3g} s: "
            f"force residual {stepper.failure.residual:.3g} N, largest at unknown "
            f"{stepper.failure.unknown}. Nothing was returned. Try more steps per cycle, a "
            "smaller beta, or rho_infinity below 1."
        )
    recorder.halved_steps += depth == 1
    middle = 0.5 * (a + b)
    _part(system, stepper, recorder, layout, index, a, middle, False, depth)
    _part(system, stepper, recorder, layout, index, middle, b, last, depth)
