"""A model for a range in backbones, ring-downs and responses: how far it serves, and its errors.

Modes of such a model hold what its loads excite, with the contact stuck and slipping, up to the
highest frequency and slip of its range. A mode of the structure beyond that, or a higher level, is
refused. Errors are the distance from the larger model that it carries, times the factor that was
found where the model was made.

How much slips in steady vibration is judged by that vibration itself: the load that makes a joint
slip as a whole within some cycles from rest is another one.

The error of a run is found without the full model: the difference to the run of the larger model,
which has half as many joint modes more and more friction points, times its factor, is that of the
basis, friction points and law. At points that the model was not trained with, where the full system
was at hand, the residual of a run in the full equation showed which modes the larger models miss.
The error of the time step is found by half of it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from skfem_joint.accuracy.estimate import Estimate, added, named, sizes, verification_run
from skfem_joint.ground.errors import InputError, refuse
from skfem_joint.reduction.ranges.points import (
    check_short_of_gross_slip,
    check_within,
    least_energy,
    point_of,
)
from skfem_joint.results.history import difference, extrapolation, results
from skfem_joint.stepping.plan import Plan
from skfem_joint.stepping.recording import Run
from skfem_joint.system.served import Point, Served
from skfem_joint.system.system import System

#: Levels may pass the highest slip of a range by this, relative, which is round-off.
_NEAR = 1e-9


def check_modes(
    serves: Served, modes: Iterable[int], frequencies: Mapping[int, float], up_to: float
) -> None:
    """Refuse modes and levels outside a range.

    Parameters
    ----------
    serves : Served
    modes : iterable of int
        Numbers of modes, from 1.
    frequencies : mapping
        Their frequencies with the contact stuck, Hz.
    up_to : float
        The highest level, as a share of that at which the first joint slips as a whole.

    Raises
    ------
    InputError
    """
    (_, highest), (_, most) = serves.range.frequency, serves.range.slip
    refuse(
        f"backbone: mode {k} has {frequencies[k]:.6g} Hz with the contact stuck, above the range "
        f"of the reduced model, up to {highest:.6g} Hz; make one for a wider range, or give the "
        "full system"
        for k in modes
        if frequencies[k] > highest * (1.0 + _NEAR)
    )
    if up_to > most * (1.0 + _NEAR):
        raise InputError(
            f"backbone: found up_to {up_to:g}, above the slip of the range of the reduced model, "
            f"up to {most:g} of what makes the first joint slip as a whole; lower it or the levels "
            "given, or make a model for a wider range"
        )


def ringing(system: System, frequency: float) -> System:
    """Model for a range, with the law that resolves the least slip at a frequency (Hz)."""
    point = Point(frequency, slip=Served.by(system).range.slip[0])
    return point_of(system, point)


def largest_apart(curve: Any, other: Any, factors: Mapping[str, float]) -> dict[str, float]:
    """Largest distances of values of two curves, times factors, by the names of the values.

    They are relative to the largest value of ``other``. The curves are of any classes that have
    these values; the shorter one's length counts.
    """
    errors = {}
    for name, factor in factors.items():
        values, reference = getattr(curve, name), getattr(other, name)
        count = min(values.size, reference.size)
        size = float(np.abs(reference[:count]).max(initial=0.0))
        apart = float(np.abs(values[:count] - reference[:count]).max(initial=0.0))
        errors[name] = factor * apart / size if size > 0.0 else 0.0
    return errors


def distances(serves: Served, curve: Any, larger: Any) -> dict[str, float]:
    """Estimated errors of a curve's frequency and damping, by their names.

    Parameters
    ----------
    serves : Served
    curve, larger : Backbone or RingDown
        Of the model and of its larger one, at the same levels or in the same cycles.
    """
    apart = largest_apart(curve, larger, {"frequency": 1.0, "damping_ratio": 1.0})
    return {name: serves.error(name, e) for name, e in apart.items()}


def alone(system: System) -> System:
    """The larger model of a model for a range, of the whole range."""
    larger: System = Served.by(system).larger
    return replace(larger, serves=None)


def steady_in_range(system: System, frequency: float, level: float) -> System:
    """Model for a range at one frequency (Hz) and level, whose share of slip is not known.

    InputError if the frequency is outside the range.
    """
    point = Point(frequency, level)
    check_within(system, point)
    return point_of(system, point)


def of_range(run: Run, plan: Plan, progress: Callable[..., None] | None = None) -> Estimate:
    """Errors of a run of a point of a range.

    Parameters
    ----------
    run : Run
        Of a system from `skfem_joint.at`, from rest.
    plan : Plan
        Its plan.
    progress : callable, optional
        As `integrate` takes it, called in both runs that this takes.

    Raises
    ------
    InputError
        If the system is no point of a range.
    ConvergenceError
        If a joint slips as a whole in the run, or a step of a verification run does not converge.
    KeyboardInterrupt
        If a verification run is interrupted.
    """
    serves = Served.by(run.system)
    if serves.point is None:
        raise InputError("estimate: found a run of no point of a range; take one by sj.at")
    check_short_of_gross_slip(run)
    better = (serves.larger, plan), (run.system, plan.finer(2))
    runs = (verification_run(*one, progress=progress) for one in better)
    larger, halved = (difference(results(one), results(run)) for one in runs)
    friction = float(run.cycles.friction[-1])
    times = max(1.0, least_energy(run) / friction) if friction > 0.0 else 1.0
    basis = {k: None if e is None else serves.error(k, e, times) for k, e in larger.items()}
    step = named(extrapolation(4.0) * sizes(halved))
    return Estimate({"basis": basis, "time_step": step, "total": added(basis, step)})
