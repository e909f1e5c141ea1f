"""Whether a time step is short enough for what a load does, before anything is integrated.

A step that is too long gives a smooth, energetically sound, wrong answer: sampled too seldom a
harmonic load is another load, a pulse may fall between two steps, and a load that jumps sets off a
vibration that the steps cannot follow. All three can be told in advance.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from scipy import linalg, sparse
from scipy.sparse.linalg import splu

from skfem_joint.arrays import FloatArray
from skfem_joint.errors import ConvergenceError, InputError, refuse
from skfem_joint.loads import Amplitude
from skfem_joint.system import System

#: Steps that a period of the load needs. At 8 the displacement may be off by more than a fifth.
PER_PERIOD = 8
#: Steps in the rise time of a pulse, or in the duration of a rectangle.
PER_RISE = 2
#: Steps in a period of the free vibration that a jump of the load sets off.
PER_VIBRATION = 10
#: Share of the variation of a plain function of time that may be missed between the steps: a
#: harmonic with PER_PERIOD steps in its period misses so much. Fewest and most times at which that
#: is seen; halvings of the step that are tried.
MISSED, LEAST_TIMES, MOST_TIMES, HALVINGS = 0.06, 256, 4096, 12
#: Jumps that such a function may have, and times in a step at which one is looked for.
MOST_JUMPS, INSIDE = 4, 257
#: Fraction of the golden ratio.
GOLDEN = 0.5 * (5.0**0.5 - 1.0)
#: Times at which a load whose largest force is not known is sampled.
SAMPLES = 1001


def check_resolution(system: System, step: float, n_steps: int, steady: bool = False) -> None:
    """See that the step follows each load and what it sets off, as far as that can be known.

    Pulses shorter than PER_RISE steps are allowed where the vibration of the loaded unknowns
    themselves is resolved: the driver ends steps at the pulse's corners, so that its momentum is
    right, and nothing is fast enough to need more. Smooth pulses, whose corners do not show their
    shape, are not. A plain function of time is compared between the steps with the straight lines
    through its values at them, which are all that the run sees of it; of its jumps only one at the
    start is seen, which does not matter where vibration is to be ``steady``.

    Raises
    ------
    InputError
        Naming the load, what is too fast, and the step that would do.
    """
    problems = [
        f"{where}: a step of {step:.4g} s {why}; use a step of at most {most:.4g} s{else_}"
        for where, most, why, else_ in _bounds(system, step * n_steps, not steady)
        if step > most * (1.0 + 1e-9)
    ]
    refuse([*problems, *_unresolved(system, step, n_steps)])


def _unresolved(system: System, step: float, n_steps: int) -> Iterator[str]:
    """Sentences about loads of which no frequency is known, and which the step does not follow."""
    for load in system.loads:
        if load.amplitude.highest_frequency is not None or not np.any(load.vector):
            continue
        missed = _missed(load.amplitude, step, n_steps)
        if missed <= MISSED:
            continue
        shorter: float | None = None
        for parts in (2**k for k in range(1, 1 + HALVINGS)):
            if _missed(load.amplitude, step / parts, n_steps * parts) <= MISSED:
                shorter = step / parts
                break
        cure = (
            f"no step down to {step / 2**HALVINGS:.3g} s does: does it jump often, or is it noise? "
            "Give it as a Table of its values"
            if shorter is None
            else f"use a step of at most {shorter:.4g} s"
        )
        yield (
            f"load{f' on {load.on!r}' if load.on else ''}: a step of {step:.4g} s does not follow "
            f"this function of time: between the steps it is off the straight lines through its "
            f"values at them by {100.0 * missed:.3g} % of what it varies by (root mean square), "
            f"must be at most {100.0 * MISSED:.2g} %, as of a harmonic with {PER_PERIOD} steps in "
            f"its period; {cure}"
        )


def _missed(amplitude: Amplitude, step: float, n_steps: int) -> float:
    """Root mean square of what straight lines through the steps miss, over that of the variation.

    Taken at times that fill the run evenly, and all places between two steps: a multiple of the
    golden ratio's fraction never comes back to the same one, so that nothing can repeat with them.
    Steps in which the function jumps are left out, a few of them.
    """
    count = min(max(LEAST_TIMES, 4 * n_steps), MOST_TIMES)
    i = np.arange(count)
    at = n_steps * (i + i * GOLDEN % 1.0) / count
    first = np.minimum(np.floor(at), n_steps - 1)
    before, after, force = (amplitude(step * t) for t in (first, first + 1.0, at))
    missed, varies = force - before - (at - first) * (after - before), float(np.std(force))
    for _ in range(MOST_JUMPS):  # a step with a jump has the mean of both sides, as it should
        worst = first[np.abs(missed).argmax()]
        inside = amplitude(step * (worst + np.linspace(0.0, 1.0, INSIDE)))
        if np.abs(np.diff(inside)).max() <= 0.5 * np.ptp(inside):
            break
        missed[first == worst] = 0.0
    return float(np.sqrt(np.mean(missed**2))) / varies if varies > 0.0 else 0.0


def longest_step(system: System, duration: float) -> float:
    """Longest step, s, that :func:`check_resolution` takes for a run of ``duration``, s."""
    return min((most for _, most, _, _ in _bounds(system, duration)), default=np.inf)


def _bounds(
    system: System, duration: float, jumps: bool = True
) -> Iterator[tuple[str, float, str, str]]:
    """Load, longest step for it (s), what a longer one does wrong, and what else to try."""
    for load in system.loads:
        amplitude = load.amplitude
        peak = _peak(amplitude, duration)
        if peak == 0.0 or not np.any(load.vector):
            continue
        where = f"load on {load.on!r}" if load.on else "load"
        frequency = amplitude.highest_frequency
        if frequency is not None and amplitude.period is not None:
            why = f"is longer than 1/{PER_PERIOD} of its fastest period"
            yield where, 1.0 / frequency / PER_PERIOD, why, ""
        elif frequency is not None:
            rise = 0.5 / frequency
            most = rise / PER_RISE
            if not _round_pulse(amplitude, peak):
                most = max(most, _period(system, load.vector) / PER_VIBRATION)
            yield where, most, f"is too long for a pulse that rises in {rise:.4g} s", ""
        if jumps and (
            abs(float(amplitude(0.0))) > 1e-6 * peak
            or any(0.0 <= t < duration * (1.0 - 1e-9) for t in amplitude.jumps)
        ):
            period = _period(system, _static_shape(system, peak * load.vector))
            why = f"does not follow the vibration of period {period:.4g} s that its jump sets off"
            yield where, period / PER_VIBRATION, why, ", or let the load rise in a ramp"


def _peak(amplitude: Amplitude, duration: float) -> float:
    """Largest force, N: sampled where it is not known."""
    if amplitude.peak_value is not None:
        return amplitude.peak_value
    return float(np.abs(amplitude(np.linspace(0.0, duration, SAMPLES))).max())


def _round_pulse(amplitude: Amplitude, peak: float) -> bool:
    """Whether a pulse is not made of straight lines between its corners."""
    corners = sorted(amplitude.corners)
    for a, b in pairwise(corners):
        inside = np.array([np.nextafter(a, b), 0.5 * (a + b), np.nextafter(b, a)])
        first, middle, last = amplitude(inside)
        if abs(middle - 0.5 * (first + last)) > 1e-6 * peak:
            return True
    return not corners


def _period(system: System, u: FloatArray) -> float:
    """Period of a free vibration in the shape ``u`` by Rayleigh's quotient, s.

    The load's own vector is the shape of the loaded unknowns with all others held: the fastest that
    the load can set off. Zero: nothing moves.
    """
    frequency = system.frequency_of(u)
    return 2.0 * np.pi / frequency if frequency > 0.0 else np.inf


def _static_shape(system: System, f: FloatArray) -> FloatArray:
    """Displacement under forces ``f`` (N), m, with joints that hold what they can.

    A load below the friction limit moves a part of the joint only, which vibrates the faster the
    smaller it is. In dense systems points share their unknowns: there friction is left out.
    """
    if not system.is_dense and system.contact_points:
        from skfem_joint.stepping.quasi_static import QuasiStatic

        try:
            found: FloatArray = QuasiStatic(system, 1e-6).follow(f[np.newaxis], held=np.inf)[0]
        except (ConvergenceError, InputError):
            pass  # points share their unknowns, or hold each other
        else:
            # Where all sticks nothing moves under Coulomb; a regularised law lets it creep.
            if np.any(found) or np.isinf(system.beta[system.w > 0.0]).all():
                return found
    try:
        if not isinstance(system.K, np.ndarray):
            return np.asarray(splu(sparse.csc_array(system.K)).solve(f))
        with warnings.catch_warnings():
            warnings.simplefilter("error", linalg.LinAlgWarning)  # singular but for round-off
            return np.asarray(linalg.solve(system.K, f, assume_a="sym"))
    except (linalg.LinAlgError, linalg.LinAlgWarning, RuntimeError):
        return np.zeros_like(f)  # nothing holds it: it does not vibrate but moves away
