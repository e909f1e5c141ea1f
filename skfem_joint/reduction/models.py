"""The maker of reduced models: what they are made for, which modes they have, and their contact.

A reduced model is made in two steps. A *basis* holds the modes, see
:mod:`skfem_joint.reduction.sources`: of a static slip path under the loads of a run to come, of a
run of its own, or of the states of a damping curve. `reduced_on` then projects the system on it,
merges friction points, and limits the steepness of the law of friction to what the modes resolve.
`reduce`, scenes and estimates go this way, with the same numbers of modes, notes and refusals.
(Condensed models are made in :mod:`skfem_joint.reduction.condensed`, those for a range in
:mod:`skfem_joint.reduction.ranges`.)
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from skfem_joint.ground.errors import InputError
from skfem_joint.ground.loads import common_period
from skfem_joint.ground.values import (
    BETA,
    COUNT,
    POSITIVE,
    WHOLE,
    check,
    check_kind,
    check_some,
)
from skfem_joint.reduction import sources
from skfem_joint.reduction.basis import STUCK_VELOCITY, Basis, Options, Origin
from skfem_joint.reduction.elastic_contact import check_reference, elastic
from skfem_joint.reduction.excitation import repeats
from skfem_joint.reduction.friction_points import NO_FRICTION
from skfem_joint.reduction.ranges.model import reduced_for_range
from skfem_joint.reduction.ranges.points import loaded_at
from skfem_joint.reduction.static_path import slip_path
from skfem_joint.reduction.stuck import check_curve
from skfem_joint.runs.resolution import longest_step
from skfem_joint.runs.slow_run import rate_independent
from skfem_joint.slow.quasi_static import QuasiStatic
from skfem_joint.stepping.plan import Plan
from skfem_joint.stepping.recording import Run
from skfem_joint.stepping.schemes import Scheme, generalized_alpha
from skfem_joint.system.served import Range
from skfem_joint.system.system import System

#: Periods of a run whose length is not said: until the vibration is steady.
TO_STEADY = 100


def reduce(
    system: System,
    modes: str | int = "auto",
    *,
    interface_modes: str | int = "auto",
    duration: float | None = None,
    step: float | None = None,
    scheme: Scheme | None = None,
    run: Run | None = None,
    frequency: float | None = None,
    level: float = 1.0,
    curve: Any = None,
    friction_points: str | int = "auto",
    beta: str | float = "auto",
    range: Mapping[str, Any] | Range | None = None,
    accuracy: float = 0.01,
    quasi_static: bool = False,
) -> System:
    """Reduced model on modes of a system's static slip path, or of a run or curve of its own.

    Parameters
    ----------
    system : System
        With loads, as runs to come have them.
    modes : "auto" or int
        Joint modes; static responses to the loads stand beside them. "auto": 12, of a ``curve`` 24,
        with ``range`` as many as the accuracy takes.
    interface_modes : "auto" or int
        Fixed-interface modes beside them. "auto": those with a share in the response on the
        static path, none with ``run``. Beside the modes of a ``curve`` stand those of the stuck
        structure up to so many beyond its own, if "auto" two.
    duration : float, optional
        Of the run to come, s. If it is not given, loads that repeat are taken to last until the
        vibration is steady; others need it.
    step : float, optional
        Time step of that run, s; if it is not given, one that tells how the loads change.
    scheme : Scheme, optional
        Integration scheme of that run; average acceleration if not given.
    run : Run, optional
        Own run with stored fields, ``save=Save(fields=True)``, to take modes of instead.
    frequency, level : float, optional
        For `response`: frequency of the loads, Hz, and their highest level. The modes are those of
        the steady vibration there; best is the frequency at which the structure moves most.
    curve : Backbone, optional
        For `backbone` and `ring_down`: the system's own curve, of whose states the modes are made.
        The model serves this mode up to the highest level of the curve.
    friction_points : "auto", "all" or int
        Most friction points; "auto" is as many as it takes. Points that slip, and are pressed,
        alike are merged.
    beta : "auto" or float
        Steepness of the law of friction, s/m. "auto" is that of the system, but no steeper than
        the modes resolve.
    range : mapping, optional
        Range of loads and limits that the model is to serve: ``slip`` and ``frequency``, pairs of
        the lowest and the highest share and frequency (Hz), and ``limits``, pairs of factors on the
        friction limits of joints by name. See `skfem_joint.system.served.Range`. It takes harmonic
        loads, and ``modes`` and ``accuracy`` beside it. Its joints slip as a whole at levels up to
        a few per cent above those of the full model, as its motions are fewer.
    accuracy : float
        With ``range``: largest error of displacement histories, relative; three times that of
        energies.
    quasi_static : bool
        Whether the run to come is one of `quasi_static`, without inertia and damping.

    Contact that opens becomes elastic where it was rigid, so that few unknowns suffice, see
    `skfem_joint.reduction.elastic_contact`. Its pressure points are merged with the friction points
    that they limit.

    Returns
    -------
    System
        Its ``expand`` gives the displacement of the full structure, its ``notes`` say what to
        beware of. It is good for what it was made for: `response`, `backbone` and `ring_down`
        refuse others, and higher levels. With ``range`` it serves all of that; `at` takes the model
        of a point.

    Raises
    ------
    InputError
        If a number is out of range, the loads have no common period and no duration is given,
        nothing moves, no point carries friction, the modes miss more than half of the motion that
        they are made of, a run or curve is one of another system, or arguments are given that
        exclude each other.
    """
    check_kind("system", system, System)
    check("modes", modes, COUNT, "auto")
    if level != 1.0 and frequency is None:
        raise InputError(
            f"reduce: level: found {level} without frequency, for whose response it is; give both"
        )
    if range is not None:
        automatic = interface_modes, friction_points, beta
        others = duration, step, scheme, run, frequency, curve
        if quasi_static or {*automatic} != {"auto"} or any(x is not None for x in others):
            raise InputError(
                "reduce: with range, interface_modes, friction_points, beta, duration, step, "
                "scheme, run, frequency and curve are found for the whole range, which is one of "
                "vibration; leave them out, and quasi_static too"
            )
        return reduced_for_range(system, range, accuracy=accuracy, modes=modes)
    if accuracy != 0.01:
        raise InputError(
            f"reduce: accuracy: found {accuracy} without range, whose modes it chooses; give "
            "modes in its place"
        )
    sources_given = {"run": run, "frequency": frequency, "curve": curve}
    given = [name for name, x in sources_given.items() if x is not None]
    if len(given) > 1:
        raise InputError("reduce: run, frequency and curve exclude each other; give one of them")
    idle = {"step": step, "scheme": scheme} if given else {}
    if given and run is None:
        idle |= {"duration": duration, "quasi_static": quasi_static or None}
    if found := [name for name, x in idle.items() if x is not None]:
        raise InputError(
            f"reduce: found {' and '.join(found)} beside {given[0]}, from which the modes are "
            "made; leave out either of them"
        )
    if run is not None:
        check_kind("run", run, Run)
    check("interface_modes", interface_modes, WHOLE, "auto")
    check("friction_points", friction_points, COUNT, "auto", "all")
    check("beta", beta, BETA, "auto")
    check_some(POSITIVE, duration=duration, step=step, frequency=frequency, level=level)
    options = Options(
        modes=modes, interface_modes=interface_modes, friction_points=friction_points, beta=beta
    )
    if curve is not None:
        return reduced_for_mode(system, curve, options)
    if frequency is not None:
        return reduced_for_response(system, frequency, level, options)
    times = duration, step, scheme
    return reduced(system, options, *times, quasi_static=quasi_static, run=run)


def reduced(
    system: System,
    options: Options | None = None,
    duration: float | None = None,
    step: float | None = None,
    scheme: Scheme | None = None,
    *,
    quasi_static: bool = False,
    run: Run | None = None,
    path: QuasiStatic | None = None,
    enriched: bool = False,
) -> System:
    """Reduced model of a system for a run to come, by options; see `reduce`.

    Parameters
    ----------
    system : System
    options : Options, optional
    duration, step, scheme, quasi_static, run
        As for `reduce`.
    path : QuasiStatic, optional
        A quasi-static path of the system, whose factors are used.
    enriched : bool
        Whether the basis gets more vectors before it is used: then it is not refused if it misses
        too much.

    Raises
    ------
    InputError
        As `reduce`.
    KeyboardInterrupt
        If a run is interrupted.
    """
    options = options or Options()
    friction = options.friction
    if quasi_static:  # whose law does not depend on velocity
        system, friction["beta"] = rate_independent(system), np.inf
    if run is None:
        plan = run_to_come(system, duration, step, scheme, quasi_static=quasi_static)
        flexible, modes = elastic(system), options.mode_count
        slipped = slip_path(flexible, plan, modes, path)
        basis = sources.static_basis(flexible, slipped, modes, options.interface_modes)
    else:
        if not run.system.has_matrices_of(system, "M", "K", "B"):
            raise InputError(
                "reduce: the run does not belong to the system: found another mass, stiffness or "
                "slips, must be one of sj.integrate(system, ..., save=sj.Save(fields=True))"
            )
        check_reference(system, "self")
        basis = sources.own_basis(system, run, options)
    basis = basis.judged(options, enriched)
    if not repeats(system, duration):
        basis = basis.for_decay()
    return replace(reduced_on(system, basis, **friction), made_for=_loading(system))


def reduced_for_response(
    system: System, frequency: float, level: float, options: Options | None = None
) -> System:
    """Reduced model for the steady vibration about a frequency (Hz), up to a level of the loads."""
    small = reduced(loaded_at(system, frequency, level), options)
    made_for = f"response about {frequency:.6g} Hz up to level {level:g}"
    origin = replace(small.origin, system=system, analyses=("response",), highest=level)
    loads = system.project(origin.basis.V).loads
    return replace(small, loads=loads, made_for=made_for, origin=origin)


def reduced_for_mode(system: System, curve: Any, options: Options) -> System:
    """Reduced model for a mode, of states of the system's own damping curve."""
    check_curve("reduce", system, curve, ["damping"])  # the states do not depend on it
    basis = sources.mode_basis(system, curve, options).for_decay()
    small = reduced_on(system, basis, **options.friction)
    made_for = f"mode {curve.mode} up to level {curve.level[-1]:.6g}"
    of_curve = {"highest": float(curve.level[-1]), "slips_at": curve.slips_at}
    origin = replace(
        small.origin, analyses=("backbone", "ring_down", "nonlinear_modes"), **of_curve
    )
    return replace(small, made_for=made_for, origin=origin)


def reduced_on(
    system: System,
    basis: Basis,
    *,
    friction_points: str | int = "auto",
    beta: str | float = "auto",
) -> System:
    """Reduced system on a basis, with its own friction points and steepness of the law.

    Parameters
    ----------
    system : System
    basis : Basis
    friction_points : "auto", "all" or int
        Most friction points; with the paper's modes along lines, of each active zone.
    beta : "auto" or float
        Largest steepness of the laws of friction, s/m; a joint whose own law is less steep keeps
        it. "auto" is what the modes resolve of velocities.

    Returns
    -------
    System
        Its ``notes`` are those of the system, of the basis, and what to beware of in the reduction;
        the ``shares`` of its contact say which points of ``system`` each of its own stands for;
        ``origin`` has the system and the basis.

    Raises
    ------
    InputError
        If no point carries friction, or less than one friction point is asked for.
    """
    if system.contact.count == 0:
        raise InputError(NO_FRICTION)
    flexible = elastic(system)
    small = flexible.project(basis.V)
    count = None if isinstance(friction_points, str) else friction_points
    if count is not None and count < 1:
        raise InputError(f"reduction.friction_points: found {count}, must be >= 1")
    if friction_points != "all":
        small = basis.fewer_points(small, count)
    notes = (*system.notes, *basis.notes, *small.notes[len(system.notes) :])
    if isinstance(beta, str):
        velocity = basis.history.slip_velocity or STUCK_VELOCITY
        share = basis.history.resolved
        beta = 1.0 / (share * velocity)
        steeper = system.contact.beta[~system.contact.sprung] > beta
        if np.any(steeper) and not np.all(small.contact.sprung):
            note = (
                f"The reduced model uses beta = {beta:.3g} s/m, in a smooth law of friction, an "
                "arctangent of beta times the slip velocity: its modes do not resolve velocities "
                f"below {share:g} of the largest ({velocity:.3g} m/s), where a steeper law would "
                "differ. Set reduction.beta to choose."
            )
            notes = (*notes, note)
    return replace(small.no_steeper(beta), notes=notes, origin=Origin(system, basis))


def notes_of(model: System) -> tuple[str, ...]:
    """Notes that a model has beside those of the full system that it was made of."""
    return model.notes if model.origin is None else model.notes[len(model.origin.system.notes) :]


def run_to_come(
    system: System,
    duration: float | None = None,
    step: float | None = None,
    scheme: Scheme | None = None,
    *,
    quasi_static: bool = False,
) -> Plan:
    """Steps of a run to come, fine enough to tell inertia.

    InputError for loads whose run has no known length.
    """
    period = common_period(load.amplitude for load in system.loads)
    if duration is None and period is not None and repeats(system):
        duration = TO_STEADY * period
    if duration is None:
        raise InputError(
            "reduce: the loads have no common period that is known; give the duration (s) of "
            "the run to come"
        )
    if step is None:
        step = duration / 2000 if period is None else min(period / 200, duration)
        step = min(step, longest_step(system, duration, vibrates=not quasi_static))
    count, scheme = max(1, round(duration / step)), scheme or generalized_alpha()
    return Plan(step, count, scheme, quasi_static=quasi_static)


def _loading(system: System) -> str:
    """Description of the loads of a system in a few words."""
    highest = [load.amplitude.highest_frequency for load in system.loads]
    known = sorted({f"{frequency:.6g} Hz" for frequency in highest if frequency is not None})
    return "its loads as they are" + (f" ({', '.join(known)})" if known else "")
