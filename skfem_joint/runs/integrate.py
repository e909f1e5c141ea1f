"""Implicit time integration of any system.

`integrate` turns its arguments into a plan and checks them. `integrate_plan` passes the plan on to
the checks of its steps (:mod:`skfem_joint.runs.resolution`) and to the driver
(:mod:`skfem_joint.stepping.driver`), which lays the steps out so that jumps and kinks of the loads
fall on their ends, advances in chunks (progress, Ctrl-C), does a step that does not converge in
halves, and raises :class:`ConvergenceError` when that does not help either.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any, Literal

import numpy as np

from skfem_joint.ground.arrays import FloatArray, as_real
from skfem_joint.ground.errors import ConvergenceError, InputError
from skfem_joint.ground.loads import common_period
from skfem_joint.ground.plain_values import fingerprint
from skfem_joint.ground.values import COUNT, POSITIVE, between, check, check_kind, check_some
from skfem_joint.runs.resolution import check_jumps, check_resolution, unfit_times
from skfem_joint.runs.run_notes import checked, notes_of_run, wrong_energy
from skfem_joint.runs.slow_run import slow_run
from skfem_joint.runs.steady_run import steady_run
from skfem_joint.stepping.checkpoint import Checkpoint
from skfem_joint.stepping.driver import Driver
from skfem_joint.stepping.plan import Plan, check_until
from skfem_joint.stepping.recording import Ending, Final, Run, Save
from skfem_joint.stepping.schemes import Scheme, generalized_alpha
from skfem_joint.system.system import CHANGED, System

_log = logging.getLogger(__name__)

#: Largest force residual of a step, relative to its largest force.
TOLERANCE = 1e-11
#: What does not go together with cycles.
BY_CYCLES = (
    "cycles: must come with steps_per_cycle, and without step, n_steps, duration and cycle_steps"
)
# A looser tolerance lets loads that do nothing pass as converged.
_TOLERANCES = between(0.0, 1e-3, ", relative to the largest force of a step")


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
    initial: Run | tuple[FloatArray, ...] | None = None,
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
        Steps of a cycle, for works and peaks by cycle; ``steps_per_cycle`` if that is given.
    until : {"end", "steady"}
        ``"steady"`` gives the one period at which vibration under loads that repeat has become
        steady, see :mod:`skfem_joint.steady.steady` and, with contact that opens,
        :mod:`skfem_joint.steady.marching`; its amplitudes and offsets are in `Run.steady`.
    initial : Run or tuple of ndarray, shape (n,), optional
        A run to go on from, or displacement (m) and velocity (m/s) at the start; at rest if not
        given. A run goes on with its whole state: where matrices, scheme and loads are those of its
        end, as if it had not ended; else as after a jump of the loads. Times, and so loads, count
        from its end. Its unknowns must be those of this system, see `System.T`. From a displacement
        and a velocity alone springs in series with friction start without force. A third array,
        (rows of B,), is the friction over its limit, which these springs then have. With contact
        that opens a fourth one, (m,), N, are these limits, which follow the normal forces.
    tolerance : float
        Largest force residual of a step relative to its largest force, at most 1e-3.
    progress : callable, optional
        Called with (steps done, steps in all); until "steady" with (periods done, 0, a note).
    checkpoint : Checkpoint, optional
        Where to save the run and to take it up again; neither changes a bit of the result.

    Returns
    -------
    Run
        After an interrupt (Ctrl-C) that of the steps finished, with ``interrupted`` set.

    Raises
    ------
    ConvergenceError
        If a step does not converge, even in 256 parts, or no steady vibration is found; if steps
        add more energy than loads, start and contact have, as too long ones of elastic contact do.
    InputError
        If a number is out of range, the steps are not given in one of the three ways, are too long
        for a load, or store more than memory holds; if no stepper fits the system, nothing can
        become steady, the unknowns of a run to go on from are others, or the checkpoint cannot be
        written or is not one of this run.
    KeyboardInterrupt
        After an interrupt of a run until "steady": a search that has not ended has no result.
    """
    check_some(COUNT, cycle_steps=cycle_steps)
    check_until(until)
    if cycles is None and steps_per_cycle is not None and until == "steady":
        cycles = 1
    if cycles is not None and cycle_steps is not None:
        raise InputError(BY_CYCLES)
    h, count = _steps(system, step, n_steps, duration, cycles, steps_per_cycle)
    cycle_steps = cycle_steps or steps_per_cycle
    plan = Plan(h, count, scheme or generalized_alpha(), save or Save(), cycle_steps, until)
    _warn_of_times(system, plan)
    run = integrate_plan(
        system,
        plan,
        initial=initial,
        tolerance=tolerance,
        progress=progress,
        checkpoint=checkpoint,
    )
    for sentence in wrong_energy(run):
        _log.warning(sentence)
    return _of_model(run, system)


def _of_model(run: Run, system: System) -> Run:
    """Run, with a note if its reduced model was changed after it was made."""
    if not system.made_for or system.origin is None or system.origin.made(system):
        return run
    return replace(run, notes=(*run.notes, f"The error of the run is not known: {CHANGED}."))


def integrate_plan(
    system: System,
    plan: Plan,
    *,
    initial: Run | tuple[FloatArray, ...] | None = None,
    tolerance: float = TOLERANCE,
    progress: Callable[..., None] | None = None,
    checkpoint: Checkpoint | None = None,
    judged: bool = True,
) -> Run:
    """Integrate a system as a plan says; the other arguments, result and errors as `integrate`.

    ``judged`` is whether energy that steps add is an error: it is none where only shapes are used.
    """
    check("tolerance", tolerance, _TOLERANCES)
    # The loads and the law of a whole range are those of no point of it.
    if system.serves is not None and system.serves.point is None:
        raise InputError(
            f"integrate: found a reduced model for the whole range ({system.serves}), must be a "
            "point of it: sj.at(model, frequency=..., slip=...) or, in place of slip, level=..."
        )
    start, ending = _start(system, plan, initial)
    if plan.quasi_static:
        if initial is not None:
            raise InputError("initial: a quasi-static run starts from rest; leave it out")
        if checkpoint is not None:
            raise InputError("checkpoint: a quasi-static run has none; leave it out")
        return _quasi_static(system, plan, tolerance, progress)
    moved = start if any(np.any(x) for x in start[:3]) else None
    if plan.until == "steady":
        if checkpoint is not None:
            raise InputError(
                "until: a search for what is 'steady' has no checkpoints; leave them out"
            )
        run = steady_run(system, plan, start, float(tolerance), progress, ending=ending)
        return _noted(run, plan, moved)
    check_resolution(system, plan)
    check_jumps(system, plan)
    identity = fingerprint(system, plan, *start, ending, tolerance) if checkpoint else ""
    saved = checkpoint.load(identity) if checkpoint else None
    driver = Driver(system, plan, start, float(tolerance), ending)
    if saved is not None and checkpoint is not None:
        driver.check(checkpoint, saved[0], saved[1])
        driver.take_up(*saved)
    interrupted = driver.run(progress, checkpoint, identity)
    run = driver.finish(system.stored_energy(*start), interrupted)
    return _noted(checked(run) if judged else run, plan, moved)


def _noted(run: Run, plan: Plan, start: tuple[FloatArray, ...] | None = None) -> Run:
    """Run with its plan, what it started from and what to beware of."""
    run = replace(run, plan=plan, start=start)
    return replace(run, notes=tuple(dict.fromkeys(notes_of_run(run, plan))))


def _quasi_static(
    system: System, plan: Plan, tolerance: float, progress: Callable[..., None] | None
) -> Run:
    """Run without inertia and damping."""
    check_resolution(system, plan)
    try:
        run = _noted(slow_run(system, plan, tolerance=tolerance, progress=progress), plan)
        return _of_model(run, system)
    except ConvergenceError as error:
        if error.run is not None:
            error.run = _of_model(_noted(error.run, plan), system)
        raise


def quasi_static(
    system: System,
    *,
    step: float | None = None,
    n_steps: int | None = None,
    duration: float | None = None,
    cycles: int | None = None,
    steps_per_cycle: int | None = None,
    save: Save | None = None,
    tolerance: float = TOLERANCE,
    progress: Callable[..., None] | None = None,
) -> Run:
    """Follow a system as its loads change slowly: without inertia and damping, level by level.

    Each step is a level of the loads. Friction does not depend on velocity then: its law is
    Coulomb's, whatever the steepness of the system, which `Run.system` notes. Points that stick
    rest exactly in full and condensed models.

    Parameters
    ----------
    system : System
        Of any dimension; full, or by `condense` or `reduce`.
    step, n_steps, duration
        Time step of the loads, s, and how many of them, or s.
    cycles, steps_per_cycle : int
        Cycles of the loads' common period, and levels in each.
    save : Save, optional
        What to store; the named points at every level if not given.
    tolerance : float
        Largest force residual of a level relative to its largest force, at most 1e-3.
    progress : callable, optional
        Called with (levels done, levels in all).

    Returns
    -------
    Run
        Its ``loops`` have force over displacement of each load, and over slip of each joint.
        Times are those of the loads. After an interrupt (Ctrl-C) it is that of the levels
        finished, with ``interrupted`` set.

    Raises
    ------
    ConvergenceError
        If the loads are more than friction and supports hold, or a level is not found. Its ``run``
        has all levels before.
    InputError
        If a number is out of range, the steps are not given in one of the three ways, are too long
        for a load, or store more than memory holds; for reduced models for a range.
    """
    h, count = _steps(system, step, n_steps, duration, cycles, steps_per_cycle)
    plan = Plan(h, count, save=save or Save(), cycle_steps=steps_per_cycle, quasi_static=True)
    _warn_of_times(system, plan)
    return integrate_plan(system, plan, tolerance=tolerance, progress=progress)


def _warn_of_times(system: System, plan: Plan) -> None:
    """Log sentences about loads whose times do not fit those of the run."""
    for sentence in unfit_times(system, plan):
        _log.warning(sentence)


def _steps(
    system: System,
    step: float | None,
    n_steps: int | None,
    duration: float | None,
    cycles: int | None,
    steps_per_cycle: int | None,
) -> tuple[float, int]:
    """Step and number of steps, given in one of three ways."""
    check_kind("system", system, System)
    check_some(POSITIVE, step=step, duration=duration)
    check_some(COUNT, n_steps=n_steps, cycles=cycles, steps_per_cycle=steps_per_cycle)
    if cycles is not None or steps_per_cycle is not None:
        in_steps = (step, n_steps, duration) != (None, None, None)
        if cycles is None or steps_per_cycle is None or in_steps:
            raise InputError(BY_CYCLES)
        period = common_period(load.amplitude for load in system.loads)
        if period is None:
            raise InputError(
                "cycles, until: the loads have no common period that is known (only harmonics of "
                "commensurate frequencies have); give step and n_steps, or duration and step"
            )
        return period / steps_per_cycle, cycles * steps_per_cycle
    if step is None or (n_steps is None) == (duration is None):
        raise InputError(
            "integrate: needs step and n_steps, or duration and step, or cycles and steps_per_cycle"
        )
    if duration is not None:
        n_steps = max(1, math.ceil(min(duration / step, 1e18) * (1.0 - 1e-9)))
    return float(step), int(n_steps or 1)


def _start(
    system: System, plan: Plan, initial: Run | tuple[FloatArray, ...] | None
) -> tuple[tuple[FloatArray, ...], Ending | None]:
    """State at the start, and what goes on of the run that it is the end of, if it is one.

    Displacement, velocity and, if given, friction and its limits, checked.
    """
    if not isinstance(initial, Run):
        _check_whole(system, plan, initial)
        return _given(system, initial), None
    start = _given(system, initial.end)
    _check_unknowns(initial, system)
    before = initial.plan
    alike = before is not None and (before.scheme, before.warp) == (plan.scheme, plan.warp)
    same = alike and system.has_matrices_of(initial.system, "M", "C", "K", "contact")
    return start, initial.ending if same else None


def _check_unknowns(run: Run, system: System) -> None:
    """Refuse the state of a run whose unknowns stand for other displacements than the system's."""
    one, other = run.system, system
    if one is other or one.T is None or other.T is None:
        return
    alike = one.T.shape == other.T.shape and all(
        np.allclose(other.expand(x), before, rtol=0.0, atol=1e-6 * np.abs(before).max())
        for x, before in ((x, one.expand(x)) for x in run.final)
    )
    if not alike:
        raise InputError(
            "initial: found a run of a model whose unknowns stand for other displacements, as "
            "those of each reduced model do; go on with the same model"
        )


def _check_whole(system: System, plan: Plan, initial: Any) -> None:
    """Refuse displacement and velocity at the end of a run where more belongs to its state.

    A search for steady vibration may start from anything.
    """
    opens = system.contact.opens
    lacking = isinstance(initial, Final) and (opens or system.contact.has_springs)
    if lacking and plan.until != "steady":
        of_what = "contact that opens" if opens else "springs in series with friction"
        raise InputError(
            "initial: found the displacement and velocity at the end of a run alone, run.final, "
            f"where forces of {of_what} belong to the state; give the run itself, initial=run"
        )


def _given(system: System, initial: tuple[FloatArray, ...] | None) -> tuple[FloatArray, ...]:
    """Displacement, velocity and, if given, friction and its limits at the start, checked."""
    if initial is None:
        return np.zeros(system.n), np.zeros(system.n)
    try:
        displacement, velocity, *friction = initial
        if len(friction) > 2:
            raise ValueError
    except (TypeError, ValueError) as error:
        raise InputError(
            "initial: must be a run, or two arrays, the displacement and the velocity at the "
            "start, or three with the friction over its limit of each slip row, or four with the "
            "limits where contact opens"
        ) from error
    start = tuple(np.array(as_real(x, "initial")) for x in (displacement, velocity, *friction))
    if not all(np.all(np.isfinite(x)) for x in start):
        raise InputError("initial: must be finite")
    if any(x.shape != (system.n,) for x in start[:2]):
        raise InputError(f"initial: shapes must be ({system.n},)")
    if friction:
        found, rows = start[2].shape, system.contact.B.shape[0]
        if found != (rows,):
            raise InputError(f"initial: found shape {found} of friction, must be ({rows},)")
        if np.any(system.contact.slip_norm(start[2]) > 1.0 + 1e-9):
            raise InputError("initial: friction must not be above its limit, that is above 1")
    _check_limits(system, start)
    return start


def _check_limits(system: System, start: tuple[FloatArray, ...]) -> None:
    """Refuse friction at the start whose limits are not those that it is over."""
    opens = system.contact.opens
    if len(start) == 3 and opens and system.contact.has_springs:
        raise InputError(
            "initial: found friction without its limits, which follow the normal forces where "
            "contact opens; give them (m,), N, as a fourth array, or the run itself, initial=run"
        )
    if len(start) < 4:
        return
    if not opens:
        raise InputError(
            "initial: found friction limits beside constant contact, whose limits are those of "
            "the system; leave the fourth array out"
        )
    if start[3].shape != system.contact.w.shape or np.any(start[3] < 0.0):
        raise InputError(
            f"initial: found friction limits of shape {start[3].shape}, must be "
            f"{system.contact.w.shape} and not negative"
        )
