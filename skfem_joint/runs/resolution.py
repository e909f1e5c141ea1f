"""Whether a time step is short enough for what a load does, before anything is integrated.

A step that is too long gives a smooth, energetically sound, wrong answer: sampled too seldom a
harmonic load is another load, a pulse may fall between two steps, and a load that jumps sets off a
vibration that the steps cannot follow. `check_resolution` compares the step with the loads' own
times, which takes no solve. `check_jumps` compares it with the vibration that a jump sets off,
whose shape is a quasi-static state.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator
from functools import cache, partial
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from scipy import linalg, sparse
from scipy.sparse.linalg import splu

from skfem_joint.ground.arrays import FloatArray
from skfem_joint.ground.errors import ConvergenceError, InputError, refuse
from skfem_joint.ground.loads import Amplitude, Table
from skfem_joint.stepping.load_steps import ends_steps
from skfem_joint.stepping.plan import Plan
from skfem_joint.system.system import AppliedLoad, System

#: Steps that a period of the load needs. At 8 the displacement may be off by more than a fifth.
PER_PERIOD = 8


# Steps in a period of the free vibration that a jump of the load sets off.
_PER_VIBRATION = 10
# Share of the variation of a plain function of time that may be missed between the steps: a
# harmonic with `PER_PERIOD` steps in its period misses so much.
_MISSED = 0.06
# Halvings of the step that are tried to find one that would do.
_HALVINGS = 12


class Bound(NamedTuple):
    """Longest step for a load.

    Attributes
    ----------
    load : str
        The load, in words.
    step : float
        Longest step, s.
    why : str
        What a longer one does wrong.
    cure : str
        What else to try.
    """

    load: str
    step: float
    why: str
    cure: str = ""


def check_resolution(system: System, plan: Plan) -> None:
    """See that the step of a plan follows each load; nothing is solved for that.

    Pulses shorter than two steps are allowed where the vibration of the
    loaded unknowns themselves is resolved: the driver ends steps at the pulse's corners, so that
    its momentum is right, and nothing is fast enough to need more. Smooth pulses, whose corners do
    not show their shape, are not. A plain function of time, and a table with more kinks than the
    driver ends steps at, is compared between the steps with the straight lines through its values
    at them, which are all that the run sees of it.

    Raises
    ------
    InputError
        Naming the load, what is too fast, and the step that would do.
    """
    bounds = _load_bounds(system, plan.duration, vibrates=not plan.quasi_static)
    refuse([*_too_long(plan.step, bounds), *_unresolved(system, plan)])


def check_jumps(system: System, plan: Plan) -> None:
    """See that the step of a plan follows the free vibration that jumps of the loads set off.

    The vibration has the shape of the displacement under the load at rest, with joints that hold
    what they can: a quasi-static state is solved for each load that jumps. It does not matter where
    the plan ends with steady vibration, or leaves inertia out. Of jumps of plain functions of time
    only one at the start is seen.

    Raises
    ------
    InputError
        Naming the load, the period of the vibration, and the step that would do.
    """
    if plan.until != "steady" and not plan.quasi_static:
        refuse(_too_long(plan.step, _jump_bounds(system, plan.duration)))


def unfit_times(system: System, plan: Plan) -> Iterator[str]:
    """Sentences about loads, such as tables, whose times do not fit those of the run.

    They say what is left out, both spans, and the likely cause: times in another unit than s.
    """
    end = plan.duration
    for load in system.loads:
        amplitude = load.amplitude
        first, last = amplitude.span
        ends = amplitude((first, last)) if isinstance(amplitude.shape, Table) else (0.0, 0.0)
        early, late = first < 0.0, last > end * (1.0 + 1e-9)
        brief = last < 2e-3 * end  # as of a table in other units of time
        if first >= end or last <= 0.0:
            what = "nothing of it acts in this run"
        elif np.isfinite(last - first) and (early or late):
            used = (min(last, end) - max(first, 0.0)) / (last - first)
            where = " and ".join(
                ["starts after its first"] * early + ["ends before its last"] * late
            )
            what = f"the run {where} time, and only {100.0 * used:.3g} % of its time counts"
        elif ends[0] != 0.0 and first > 0.0:
            what = "its force jumps from zero at its first time, which is not that of the run"
        elif isinstance(amplitude.shape, Table) and (brief or (ends[1] != 0.0 and last < end)):
            how, rest = "at once " * bool(ends[1]), 100.0 * (1.0 - last / end)
            what = f"it is {how}zero after its last time, in {rest:.3g} % of the run"
        else:
            continue
        yield (
            f"The {_name(load)} has times from {first:.6g} to {last:.6g} s, the run from 0 to "
            f"{end:.6g} s: {what}. Both are taken to be in s: is either in another unit, as ms?"
        )


def longest_step(system: System, duration: float, vibrates: bool = True) -> float:
    """Longest step, s, that both checks take for a run of ``duration``, s.

    ``vibrates`` is whether inertia acts, so that jumps set off vibration.
    """
    bounds = [*_load_bounds(system, duration, vibrates)]
    bounds += _jump_bounds(system, duration) if vibrates else []
    return min((bound.step for bound in bounds), default=np.inf)


def _too_long(step: float, bounds: Iterable[Bound]) -> Iterator[str]:
    """Sentences about the bounds that a step does not keep."""
    for bound in bounds:
        if step > bound.step * (1.0 + 1e-9):
            yield (
                f"{bound.load}: a step of {step:.4g} s {bound.why}; use a step of at most "
                f"{bound.step:.4g} s{bound.cure}"
            )


def _load_bounds(system: System, duration: float, vibrates: bool = True) -> Iterator[Bound]:
    """Longest steps by the periods and rise times of the loads."""
    closed = cache(partial(_as_closed, system))
    for number, load, peak in _acting(system, duration):
        amplitude, name = load.amplitude, _name(load)
        frequency = amplitude.highest_frequency
        if frequency is None:
            continue
        if amplitude.oscillates:
            why = f"is longer than 1/{PER_PERIOD} of its fastest period"
            yield Bound(name, 1.0 / frequency / PER_PERIOD, why)
            continue
        rise = 0.5 / frequency
        most = rise / 2  # as many steps in it, or in the duration of a rectangle
        if vibrates and not _is_round(amplitude, peak):
            shape = closed().loads[number].vector
            most = max(most, _period(closed(), shape) / _PER_VIBRATION)
        yield Bound(name, most, f"is too long for a pulse that rises in {rise:.4g} s")


def _jump_bounds(system: System, duration: float) -> Iterator[Bound]:
    """Longest steps by the free vibration that the loads' jumps set off."""
    closed = cache(partial(_as_closed, system))
    for number, load, peak in _acting(system, duration):
        amplitude, end = load.amplitude, duration * (1.0 - 1e-9)
        jumps = any(0.0 <= t < end for t in amplitude.jumps)
        if jumps or abs(float(amplitude(0.0))) > 1e-6 * peak:
            shape = _static_shape(closed(), peak * closed().loads[number].vector)
            period = _period(closed(), shape)
            why = f"does not follow the vibration of period {period:.4g} s that its jump sets off"
            most = period / _PER_VIBRATION
            yield Bound(_name(load), most, why, ", or let the load rise in a ramp")


def _as_closed(system: System) -> System:
    """System whose contact stays as it is at rest, where its unknowns tell which those are.

    That takes as long as hundreds of steps of a large condensed system: where nothing is too fast
    or jumps it is not needed.
    """
    return system.closed() if sparse.issparse(system.contact.normal.N) else system


def _acting(system: System, duration: float) -> Iterator[tuple[int, AppliedLoad, float]]:
    """Loads that do something: number, load, and largest force, N, sampled where not known."""
    for number, load in enumerate(system.loads):
        peak = load.amplitude.peak_value
        if peak is None:
            # Its largest force is not known.
            times = np.linspace(0.0, duration, 1001)
            peak = float(np.abs(load.amplitude(times)).max())
        if peak != 0.0 and np.any(load.vector):
            yield number, load, peak


def _name(load: AppliedLoad) -> str:
    return f"load on {load.on!r}" if load.on else "load"


def _unresolved(system: System, plan: Plan) -> Iterator[str]:
    """Sentences about loads of which no frequency is known, and which the step does not follow.

    Tables with more kinks than steps are ended at are among them.
    """
    step, n_steps = plan.step, plan.n_steps
    for load in system.loads:
        known = load.amplitude.highest_frequency is not None
        if (known and ends_steps(load.amplitude, plan.duration)) or not np.any(load.vector):
            continue
        missed = _missed(load.amplitude, step, n_steps)
        if missed <= _MISSED:
            continue
        cure = (
            f"no step down to {step / 2**_HALVINGS:.3g} s does: does it jump often, or is "
            "it noise? Give it as a Table of its values"
        )
        for parts in (2**k for k in range(1, 1 + _HALVINGS)):
            if _missed(load.amplitude, step / parts, n_steps * parts) <= _MISSED:
                cure = f"use a step of at most {step / parts:.4g} s"
                break
        yield (
            f"{_name(load)}: a step of {step:.4g} s does not follow "
            f"this function of time: between the steps it is off the straight lines through its "
            f"values at them by {100.0 * missed:.3g} % of what it varies by (root mean square), "
            f"must be at most {100.0 * _MISSED:.2g} %, as of a harmonic with {PER_PERIOD} "
            f"steps in its period; {cure}"
        )


def _missed(amplitude: Amplitude, step: float, n_steps: int) -> float:
    """Root mean square of what straight lines through the steps miss, over that of the variation.

    It is evaluated at times that fill the run evenly, and all places between two steps: a multiple
    of the golden ratio's fraction never comes back to the same one, so that nothing can repeat with
    them. Steps in which the function jumps are left out, a few of them.
    """
    least, most = 256, 4096  # times at which it is evaluated
    count = min(max(least, 4 * n_steps), most)
    i, golden = np.arange(count), 0.5 * (5.0**0.5 - 1.0)
    at = n_steps * (i + i * golden % 1.0) / count
    first = np.minimum(np.floor(at), n_steps - 1)
    before, after, force = (amplitude(step * t) for t in (first, first + 1.0, at))
    missed, varies = force - before - (at - first) * (after - before), float(np.std(force))
    for _ in range(4):  # jumps that it may have
        # A step with a jump has the mean of both sides, as it should.
        worst = first[np.abs(missed).argmax()]
        inside = amplitude(step * (worst + np.linspace(0.0, 1.0, 257)))
        if np.abs(np.diff(inside)).max() <= 0.5 * np.ptp(inside):
            break
        missed[first == worst] = 0.0
    return float(np.sqrt(np.mean(missed**2))) / varies if varies > 0.0 else 0.0


def _is_round(amplitude: Amplitude, peak: float) -> bool:
    """Whether a pulse is not made of straight lines between its corners."""
    corners = sorted(amplitude.corners)
    for a, b in pairwise(corners):
        inside = np.array([np.nextafter(a, b), 0.5 * (a + b), np.nextafter(b, a)])
        first, middle, last = amplitude(inside)
        if abs(middle - 0.5 * (first + last)) > 1e-6 * peak:
            return True
    return not corners


def _period(system: System, u: FloatArray) -> float:
    """Period of a free vibration in the shape ``u`` by Rayleigh's quotient, s; ``inf`` for none.

    The load's own vector is the shape of the loaded unknowns with all others held: the fastest that
    the load can set off.
    """
    frequency = system.frequency_of(u)
    return 2.0 * np.pi / frequency if frequency > 0.0 else np.inf


def _static_shape(system: System, f: FloatArray) -> FloatArray:
    """Displacement under forces ``f`` (N), m, with joints that hold what they can.

    A load below the friction limit moves a part of the joint only, which vibrates the faster the
    smaller it is. In dense systems points share their unknowns: there friction is left out.
    """
    if not system.is_dense and system.contact.count:
        from skfem_joint.slow.quasi_static import QuasiStatic

        try:
            u: FloatArray = QuasiStatic(system, 1e-6).follow(f[np.newaxis], limit_share=np.inf)[0]
        except (ConvergenceError, InputError):
            pass  # points share their unknowns, or hold each other
        else:
            # Where all sticks nothing moves under Coulomb; a regularised law lets it creep.
            if np.any(u) or np.isinf(system.contact.beta[system.contact.w > 0.0]).all():
                return u
    try:
        if not isinstance(system.K, np.ndarray):
            return np.asarray(splu(sparse.csc_array(system.K)).solve(f))
        with warnings.catch_warnings():
            warnings.simplefilter("error", linalg.LinAlgWarning)  # singular but for round-off
            return np.asarray(linalg.solve(system.K, f, assume_a="sym"))
    except (linalg.LinAlgError, linalg.LinAlgWarning, RuntimeError):
        return np.zeros_like(f)  # nothing holds it: it does not vibrate but moves away
