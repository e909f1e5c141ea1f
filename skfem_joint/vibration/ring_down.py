"""Free vibration of a mode: its frequency and damping, measured cycle by cycle.

A ring-down has all that quasi-static modal analysis (:mod:`skfem_joint.vibration.backbone`) leaves
out: inertia of the other modes, which friction excites, and the system's own law of friction.

A release sets off stiff modes of the joint, whose periods are far below a step. The trapezoidal
rule changes the sign of their velocity in every step for ever, which shakes the joint and changes
its friction: a lap joint with a damping ratio of 0.242 % had 0.215, 0.226 and 0.253 % with 200, 800
and 3,200 steps in a period. A scheme that damps what its steps do not follow has 0.242 % with all.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from scipy import sparse
from scipy.signal import butter, find_peaks, sosfiltfilt

from skfem_joint.accuracy.range_modes import alone, distances, largest_apart, ringing
from skfem_joint.ground.arrays import FloatArray, IntArray
from skfem_joint.ground.errors import ConvergenceError, InputError
from skfem_joint.ground.plain_values import Tabular
from skfem_joint.ground.values import at_least, check, check_kind
from skfem_joint.reduction.stuck import check_curve
from skfem_joint.results.history import extrapolation
from skfem_joint.results.peaks import parabola_vertex
from skfem_joint.runs.integrate import integrate_plan
from skfem_joint.stepping.plan import Plan
from skfem_joint.stepping.recording import Run, Save
from skfem_joint.stepping.schemes import Scheme, generalized_alpha
from skfem_joint.system.served import Served
from skfem_joint.system.system import System
from skfem_joint.vibration.backbone import Backbone, backbone

#: Cycles at the end of a ring-down that are left out, where the filter has no samples to come.
LEFT_OUT = 2
#: Spectral radius of the scheme. It adds 5e-6 to the damping ratio with 200 steps in a period.
RHO_INFINITY = 0.9
#: Differences of a ring-down from a curve, relative to the largest value, that do not count.
DIFFERS = {"frequency": 2e-3, "damping_ratio": 0.02}
#: Share of the energy lost that impacts may take before it is said.
IMPACTS = 0.01
#: Share of the energy below which what a mode exchanges with others may be all that is seen of it.
LEAST_SHARE = 0.1
#: The share of the cycles, but so many at least, that is followed again with half the step.
AGAIN, FEWEST_AGAIN = 0.25, 3 * LEFT_OUT


@dataclass(frozen=True)
class RingDown(Tabular):
    """Free vibration of a mode, cycle by cycle.

    Attributes
    ----------
    time : ndarray, shape (cycles,)
        Time of the peak that each cycle begins with, s.
    amplitude : ndarray, shape (cycles,)
        Modal amplitude, mean over the cycle, m kg^1/2.
    frequency : ndarray, shape (cycles,)
        Natural frequency without damping, Hz.
    damping_ratio : ndarray, shape (cycles,)
        By the logarithmic decrement.
    energy : ndarray, shape (periods + 1,)
        Energy of the whole structure at whole periods of the stuck mode, J.
    friction_work : ndarray, shape (periods + 1, joints)
        Energy dissipated in each joint up to then, J.
    step_error : dict of str to float
        Estimated relative errors of ``frequency`` and ``damping_ratio`` from the time step: largest
        differences to the first cycles with half of it, times 4/3.
    impact_work : float
        Energy that impacts have taken by the end, J, with contact that opens.
    estimated : dict of str to float
        Estimated errors of the same two by the modes of a reduced model for a range that was
        released in its mode; empty for others.
    notes : tuple of str
        What to beware of: cycles in which other modes have nearly all the energy, or give some; a
        curve of other friction limits, gaps or damping than the system's.
    """

    time: FloatArray
    amplitude: FloatArray
    frequency: FloatArray
    damping_ratio: FloatArray
    energy: FloatArray
    friction_work: FloatArray
    step_error: dict[str, float]
    impact_work: float = 0.0
    estimated: dict[str, float] = field(default_factory=dict)
    notes: tuple[str, ...] = ()

    @property
    def table(self) -> dict[str, FloatArray]:
        """Columns with a row for each cycle, as ``ring_down.csv``."""
        return {
            "time_s": self.time,
            "modal_amplitude": self.amplitude,
            "frequency_Hz": self.frequency,
            "damping_ratio": self.damping_ratio,
        }

    def beside(self, curve: Backbone) -> Backbone:
        """The curve of the mode, which says where this ring-down differs from it.

        Each cycle is compared with the curve at its amplitude. Both differ where they are further
        apart than the errors that both state and `DIFFERS`, all relative to the largest value; the
        level next to the cycle is marked in ``curve.differs``. Warnings name the largest
        difference, and what impacts took.
        """
        inside = (self.amplitude >= curve.amplitude[0]) & (self.amplitude <= curve.amplitude[-1])
        at = np.log(self.amplitude[inside])
        levels, differs, notes = np.log(curve.amplitude), np.zeros(curve.level.size, bool), []
        masing = {"damping_ratio": curve.masing_error or 0.0} | dict(curve.estimated)
        for name in ("frequency", "damping_ratio"):
            ours = np.interp(at, levels, getattr(curve, name))
            theirs = getattr(self, name)[inside]
            stated = masing.get(name, 0.0) + self.step_error.get(name, 0.0)
            stated += self.estimated.get(name, 0.0) + DIFFERS[name]
            apart = np.abs(theirs - ours)
            far = apart > stated * np.abs(theirs).max(initial=0.0)
            if not far.any():
                continue
            nearest = np.abs(at[far, np.newaxis] - levels).argmin(axis=1)
            differs[nearest] = True
            worst = int(apart.argmax())
            notes.append(_compared(curve.mode, name, ours[worst], theirs[worst], stated))
        lost = float(self.energy[0] - self.energy[-1])
        if self.impact_work > IMPACTS * lost > 0.0:
            notes.append(
                f"Mode {curve.mode}: impacts took {100.0 * self.impact_work / lost:.2g} % of the "
                "energy that the ring-down lost; the curve, of slow cycles, has none."
            )
        return replace(curve, differs=differs, notes=(*curve.notes, *notes))


def _compared(mode: int, name: str, ours: float, theirs: float, stated: float) -> str:
    """Sentence about a curve and a ring-down that differ most so, beyond their stated errors."""
    unit, size = ("Hz", 1.0) if name == "frequency" else ("%", 100.0)
    return (
        f"Mode {mode}: the ring-down differs from the curve by more than the errors that both "
        f"state ({100.0 * stated:.2g} %): at the same amplitude its {name.replace('_', ' ')} is "
        f"{size * theirs:.4g} {unit} where the curve has {size * ours:.4g} {unit}. The curve takes "
        "for granted Coulomb's law, and that the mode keeps its shape and moves slowly; the "
        "ring-down does not."
    )


def ring_down(
    system: System,
    curve: Any,  # a `Backbone`, or a `NonlinearMode`, whose folder comes after this one
    cycles: int,
    steps_per_cycle: int = 200,
    scheme: Scheme | None = None,
    start: Run | tuple[FloatArray, ...] | None = None,
    progress: Callable[..., None] | None = None,
) -> RingDown:
    """Free vibration of a mode from the highest level of its curve, or from any other state.

    The mode is seen by its modal displacement, ``q = phi^T M u``, which other linear modes do not
    move. What lies above twice the mode's frequency is filtered out, forwards and backwards so
    that peaks stay where they are. A cycle's amplitude is half of peak to peak, which does not
    contain the position at which the joints come to rest.

    Parameters
    ----------
    system : System
        That the curve belongs to. Its own law acts, its loads do not. Where contact opens friction
        limits follow its normal forces, and the energy is that above the state at rest.
    curve : Backbone or NonlinearMode
        Of the mode; for a model for a range a `Backbone`.
    cycles : int
        Periods of the stuck mode to follow, at least 4. Results have some four rows fewer: the
        filter does not see the first half cycle and the last two whole, what begins within them is
        left out, and a row needs the peak after its own cycle.
    steps_per_cycle : int
        Steps in each of them.
    scheme : Scheme, optional
        Generalised-alpha with a spectral radius of 0.9 if not given. With the trapezoidal rule the
        damping may depend on the step.
    start : Run or tuple of ndarray, shape (n,), optional
        State to begin with as `integrate` takes it, such as a run whose pulse has ended; from
        the curve's highest level, with the friction there, if not given: at rest, or for a mode
        into gross slip with the velocity of its motion where the first harmonic turns round.
    progress : callable, optional
        As `integrate` takes it.

    Returns
    -------
    RingDown

    Raises
    ------
    InputError
        If too few cycles are asked for, the curve is one of another system, or the system is a
        reduced model made for something else, or for a range and the curve none of `backbone`.
    ConvergenceError
        If a step does not converge, or no cycle is left to measure.
    """
    check_kind("system", system, System)
    system.check_any_load("ring_down")
    check("ring_down: cycles", cycles, at_least(2 * LEFT_OUT))
    check("ring_down: steps_per_cycle", steps_per_cycle, at_least(2))
    others = check_curve("ring_down", system, curve, getattr(curve, "traits", ()))
    if system.serves is not None:  # which then are two, the model and its larger one
        if not isinstance(curve, Backbone):
            raise InputError(
                "ring_down: a reduced model for a range takes a curve of `backbone`; a mode into "
                "gross slip belongs to the model that it was computed of"
            )
        steps = cycles, steps_per_cycle, scheme
        return _in_range(system, system.serves, curve, steps, start, progress)
    modal = sparse.csr_array((system.M @ curve.shape)[np.newaxis])
    unloaded = replace(system, loads=(), P=modal, points=("modal",))
    plan = Plan(
        step=1.0 / curve.stuck_frequency / steps_per_cycle,
        n_steps=cycles * steps_per_cycle,
        scheme=scheme or generalized_alpha(RHO_INFINITY),
        save=Save(fields=True, fields_every=steps_per_cycle),
        cycle_steps=steps_per_cycle,
    )
    initial = curve.release if start is None else start
    run = integrate_plan(unloaded, plan, initial=initial, progress=progress).finished()
    decay = _decay(run.point("modal"), plan)
    some = plan.first(min(cycles, max(FEWEST_AGAIN, int(AGAIN * cycles))))
    again = replace(some.finer(2), save=Save())
    finer = integrate_plan(unloaded, again, initial=initial, progress=progress).finished()
    ours = _decay(run.point("modal")[: some.n_steps + 1], some)
    states = zip(run.u, run.v, run.sigma, run.limits, strict=True)
    energy = np.array([system.stored_energy(*state) for state in states])
    second_order = dict.fromkeys(("frequency", "damping_ratio"), extrapolation(2.0**2))
    return RingDown(
        *decay,
        energy=energy,
        friction_work=run.joint_work[::steps_per_cycle],
        step_error=largest_apart(ours, _decay(finer.point("modal"), again), second_order),
        impact_work=run.impact_work,
        notes=(
            *_doubts(curve.mode, decay, energy, steps_per_cycle * plan.step),
            *_notes_of_others(curve.mode, others),
        ),
    )


def _doubts(mode: int, decay: _Decay, energy: FloatArray, period: float) -> tuple[str, ...]:
    """Sentences about cycles in which a mode has little of the energy (J), or does not decay."""
    own = 0.5 * (2.0 * np.pi * decay.frequency * decay.amplitude) ** 2
    whole = np.interp(decay.time, period * np.arange(energy.size), energy)
    share = np.divide(own, whole, out=np.ones_like(own), where=whole > 0.0)
    weak, grows = share < LEAST_SHARE, decay.damping_ratio <= 0.0
    if not (weak | grows).any():
        return ()
    least = f"{100.0 * share.min():.2g} % of the energy in some of them"
    return (
        f"mode {mode} is weak beside others, or takes energy from them, in "
        f"{np.count_nonzero(weak | grows)} of {share.size} cycles (it has {least}, and its damping "
        f"ratio is {decay.damping_ratio.min():.3g} to {decay.damping_ratio.max():.3g}): what it "
        "may exchange with them is not its own damping. Release the mode itself.",
    )


def _notes_of_others(mode: int, others: list[str]) -> Iterator[str]:
    """Sentence about a curve of a system with ``others`` of its values, if there are some."""
    if others:
        yield (
            f"the curve of mode {mode} is one of other {' and '.join(others)} than the system's: "
            "it does not begin at a level of the system, and both do not compare. Compute it by "
            "sj.backbone(system, ...)."
        )


def _in_range(
    system: System,
    serves: Served,
    curve: Backbone,
    steps: tuple[int, int, Scheme | None],
    start: Run | tuple[FloatArray, ...] | None,
    progress: Callable[..., None] | None,
) -> RingDown:
    """Free vibration of a model for a range, with its distance from that of its larger model.

    The larger one is released at the same level, in its own displacement there.
    """
    model = ringing(system, curve.stuck_frequency)
    rung = ring_down(replace(model, serves=None, made_for=""), curve, *steps, start, progress)
    if start is not None:
        return rung
    share = float(curve.level[-1] / curve.slips_at)
    (other,) = backbone(alone(system), (curve.mode,), 1, share, curve.slips_at)
    return replace(rung, estimated=distances(serves, rung, ring_down(alone(model), other, *steps)))


class _Decay(NamedTuple):
    """Time, amplitude, frequency and damping ratio by cycle, as `RingDown` has them."""

    time: FloatArray
    amplitude: FloatArray
    frequency: FloatArray
    damping_ratio: FloatArray


def _decay(q: FloatArray, plan: Plan) -> _Decay:
    """Decay of a modal displacement at each step of a plan.

    ConvergenceError if no cycle remains to measure.
    """
    steps_per_cycle = plan.cycle_steps or plan.n_steps
    low = butter(4, 2.0 / steps_per_cycle, fs=1.0, output="sos")
    time, half = _peaks(sosfiltfilt(low, q), steps_per_cycle, plan.step)
    decrement = np.log(half[:-1] / half[1:])
    angle = np.hypot(2.0 * np.pi, decrement)  # of the undamped mode in a cycle
    # Each cycle is timed over itself and the next: from its first peak to that after next.
    lasting = 0.5 * (time[2:] - time[:-2])[: decrement.size]
    return _Decay(
        time=time[: decrement.size],
        amplitude=np.sqrt(half[:-1] * half[1:]),
        frequency=angle / (2.0 * np.pi * lasting),
        damping_ratio=decrement / angle,
    )


def _peaks(q: FloatArray, steps_per_cycle: int, step: float) -> tuple[FloatArray, FloatArray]:
    """Times of the upper peaks (s), and half of peak to peak about each, one fewer.

    Half of peak to peak is taken between the mean of two upper peaks and the lower one between
    them. The first half cycle, which the filter does not see whole, and the last cycles are left
    out. ConvergenceError if no cycle remains.
    """
    q = q * np.sign(q[np.abs(q).argmax()])  # a mode has no sign of its own
    upper, lower = (find_peaks(sign * q, distance=steps_per_cycle // 2)[0] for sign in (1.0, -1.0))
    upper = upper[upper >= steps_per_cycle // 2]
    lower = lower[np.searchsorted(lower, upper[0]) if upper.size else 0 :]
    count = min(upper.size - 1, lower.size) - LEFT_OUT
    if count < 1:
        raise ConvergenceError("ring_down: no cycle is left to measure; ask for more")
    rows, top = _vertices(q, upper)
    bottom = _vertices(q, lower)[1]
    middle = 0.5 * (top[:-1] + top[1:])
    return rows * step, 0.5 * (middle[: count + 1] - bottom[: count + 1])


def _vertices(q: FloatArray, rows: IntArray) -> tuple[FloatArray, FloatArray]:
    """Places (rows) and values of extremes between samples, by those beside the extreme ones."""
    near = rows + np.array([[-1], [0], [1]])
    return parabola_vertex(near.astype(float), q[near])
