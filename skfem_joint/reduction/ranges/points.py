"""Points of a range: the system of one frequency, level and set of friction limits.

Coulomb's law is approached by one so steep that slip velocities are resolved down to 2e-7 of the
median of the largest ones in the training paths: slow points of the range creep far less than the
largest velocity tells. (On plates and solids friction energies came out 0.2 to 0.5 % closer than
with 1e-5, for up to 1.4 times the cost.) It is less steep by the geometric mean of the factors on
all joints' limits, and by that on the preload: a factor common to the loads and all limits, or to
the loads and the preload where contact opens, then rescales the solution exactly.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import replace

import numpy as np

from skfem_joint.ground.errors import ConvergenceError, GrossSlipError, InputError, first_of, refuse
from skfem_joint.ground.loads import Harmonic, MultiHarmonic, common_period
from skfem_joint.ground.values import POSITIVE, check, check_some
from skfem_joint.runs.integrate import integrate_plan
from skfem_joint.runs.resolution import longest_step
from skfem_joint.stepping.plan import Plan
from skfem_joint.stepping.recording import Run, Save
from skfem_joint.system.served import Point, Served
from skfem_joint.system.slips import WHOLE_SHARE
from skfem_joint.system.system import System

# Relative distance from a range that is round-off.
_TOLERANCE = 1e-9


def at(
    system: System,
    *,
    frequency: float,
    slip: float | None = None,
    level: float | None = None,
    limits: Mapping[str, float] | None = None,
    preload: float = 1.0,
) -> System:
    """Model of one point of the range that a reduced model serves.

    Parameters
    ----------
    system : System
        Reduced model for a range, `reduce` with ``range``. Any other system, such as the full one,
        is changed in the same way; it has no range, and ``level`` must be given.
    frequency : float
        Frequency of the loads' common period, Hz.
    slip : float, optional
        Share of the load that makes the first joint slip as a whole, at that frequency and with
        those limits, within four cycles from rest.
    level : float, optional
        Factor on the loads, in place of ``slip``. Nothing is run to find how much slips there: the
        point's own run shows it, and `estimate` refuses one in which a joint slips as a whole.
    limits : mapping of str to float, optional
        Factor on the friction limits of joints by name; 1 where not given. Where joints share
        contact points it acts on the joint's share of them. Where contact opens it is one on the
        coefficient of friction: limits follow the normal forces with it.
    preload : float
        Factor on all that presses the joints at rest: normal forces, gaps and friction limits.

    Returns
    -------
    System
        To be run by `integrate`; its ``serves.point`` states frequency, level, limits and slip.

    Raises
    ------
    InputError
        If the point is outside the range, a name is unknown, or a load is not harmonic.
    ConvergenceError
        If ``slip`` is given, and no load is found at which a joint slips as a whole.
    """
    check("frequency", frequency, POSITIVE)
    check("preload", preload, POSITIVE)
    check_some(POSITIVE, slip=slip, level=level)
    if (slip is None) == (level is None):
        raise InputError("at: needs slip or level, and not both")
    limits = dict(limits or {})
    check_joints(system, limits, "limits")
    check_some(POSITIVE, **{f"limits.{name}": value for name, value in limits.items()})
    point = Point(frequency, level or 1.0, limits, slip, preload)
    if system.serves is None:  # any system is loaded, but only a model for a range knows shares
        if level is None:
            raise InputError(
                "at: found slip without a range; give level, or a reduced model for a range, "
                "sj.reduce(system, range=...)"
            )
        return placed(system, point)
    if system.serves.point is not None:
        raise InputError("at: found a point of a range, must be the model of the whole range")
    check_within(system, point)
    if slip is not None:
        _check_slip(system.serves, slip)
        point = replace(point, level=slip * gross_slip_level(system, point))
    return point_of(system, point)


def check_joints(system: System, names: Iterable[str], where: str) -> None:
    """InputError for names that are no joints of a system; ``where`` they stand."""
    joints = system.contact.joints
    refuse(
        f"{where}: found joint {name!r}, must be one of {first_of(joints)}"
        for name in names
        if name not in joints
    )


def point_of(system: System, point: Point) -> System:
    """Model of a point, without a check, of the model for a range."""
    serves = Served.by(system)
    law = serves.law / (point.mean_factor(system.contact.joints) * point.preload)

    def there(model: System, law: float) -> System:
        return placed(model, point).no_steeper(law)

    # The larger model's law is steeper than that of the model.
    larger = replace(there(serves.larger, 5.0 * law), serves=None)
    return replace(
        there(system, law),
        made_for="one point of its range",
        serves=replace(serves, larger=larger, point=point),
    )


def placed(system: System, point: Point) -> System:
    """System with its loads, friction limits and preload at a point."""
    loaded = loaded_at(system, point.frequency, point.level)
    contact = loaded.contact.with_factors(point.factors(loaded.contact.joints))
    return replace(loaded, contact=contact.pressed(point.preload))


def loaded_at(system: System, frequency: float, level: float) -> System:
    """System with its harmonic loads at another frequency (Hz) and level.

    The frequency is that of their common period. InputError as `period_of`.
    """
    faster, loads = frequency * period_of(system), []
    for load in system.loads:
        parts = load.amplitude.harmonics
        changed = (Harmonic(level * a.amplitude, faster * a.frequency, a.phase) for a in parts)
        loads.append(replace(load, amplitude=MultiHarmonic(tuple(changed))))
    origin = system.origin
    if origin is not None:  # so that errors can still be estimated
        origin = replace(origin, system=loaded_at(origin.system, frequency, level))
    return replace(system, loads=tuple(loads), origin=origin)


def period_of(system: System) -> float:
    """Common period of harmonic loads, s; InputError for others."""
    period = common_period(load.amplitude for load in system.loads)
    if period is None or not all(load.amplitude.harmonics for load in system.loads):
        raise InputError(
            "loads: must be harmonic, with a common period, to have another frequency; give "
            "harmonic loads, or run the system under its own"
        )
    return period


def check_within(system: System, point: Point) -> None:
    """InputError if the frequency or limits of a point are outside the range of a model.

    A factor common to the loads and to all limits only rescales: limits are inside if they are so
    but for such a factor. Where contact opens that takes the preload along, which is a factor of
    its own: limits must be inside as they are.
    """
    serves, joints, frequency = Served.by(system), system.contact.joints, point.frequency
    low, high = serves.range.frequency
    near = _TOLERANCE
    if not low * (1.0 - near) <= frequency <= high * (1.0 + near):
        raise InputError(
            f"at: found frequency {frequency:g} Hz, outside the range of the reduced model, "
            f"{low:g} to {high:g} Hz; make one for a wider range, or run the full system there"
        )
    factors, box = point.factors(joints), serves.range.of_joints(joints)
    least = max((f / pair[1] for f, pair in zip(factors, box, strict=True)), default=1.0)
    most = min((f / pair[0] for f, pair in zip(factors, box, strict=True)), default=1.0)
    even = "even with a common factor; "
    if system.contact.opens:
        least, most, even = max(least, 1.0), min(most, 1.0), ""
    if least > most * (1.0 + near):
        found = dict(zip(joints, (float(f"{f:.6g}") for f in factors), strict=True))
        raise InputError(
            f"at: found limits {found}, outside the range of the reduced model ({serves}), "
            f"{even}make one for a wider range, or run the full system there"
        )


def _check_slip(serves: Served, share: float) -> None:
    (low, high), near = serves.range.slip, _TOLERANCE
    if low * (1.0 - near) <= share <= high * (1.0 + near):
        return
    whole = "a joint slips as a whole there; " if share >= 1.0 else ""
    raise InputError(
        f"at: found slip {share:.3g}, outside the range of the reduced model, {low:g} to {high:g} "
        f"of what makes the first joint slip as a whole; {whole}make one for a wider range, or run "
        "the full system there"
    )


def sticking(run: Run) -> float:
    """Least share of a joint's friction limit whose points stick throughout a reduced run.

    A point sticks too that slips no further than its law creeps in a period at half of its limit.
    """
    system = run.system
    slip = run.slider_peak
    period = period_of(system)
    # In reduced models points that stick move a little, up to a hundredth of the largest slip. With
    # a hundredth the level was 8 % low to 3 % high beside condensed models, where it was a
    # thousandth; with a thousandth here it was half of it.
    still = slip <= np.maximum(1e-2 * slip.max(initial=0.0), period / system.contact.beta)
    return system.contact.least_share(still)


def check_short_of_gross_slip(run: Run) -> None:
    """GrossSlipError if a joint slips as a whole in a run of a model for a range.

    In a period of steady vibration slip that remains from before does not count.
    """
    system = run.system
    if run.steady is None:
        whole = sticking(run) <= 1.0 - WHOLE_SHARE
    else:
        slip = system.contact.slid(run.friction_work)
        whole = system.slips_as_a_whole(slip, period_of(system))
    if whole:
        raise GrossSlipError(
            "a joint slips as a whole, which the reduced model for the range does not serve; lower "
            "the level, or give the full system"
        )


def gross_slip_level(system: System, point: Point) -> float:
    """Factor on the loads at which the first joint slips as a whole, within four cycles from rest.

    ``system`` is the reduced model of the whole range; the level of the point does not count.
    ConvergenceError if none is found.
    """
    level = searched_level(system, replace(point, preload=1.0))[0]
    if level is None:
        raise ConvergenceError(
            "range: no load was found at which a joint slips as a whole at "
            f"{point.frequency:g} Hz; the modes of the reduced model may not let it: give level in "
            "place of slip, or make a model for a wider range"
        )
    return level * point.preload


def searched_level(system: System, point: Point) -> tuple[float | None, float]:
    """That level, or None if none is found, and the guess that the search began with."""
    serves, joints = Served.by(system), system.contact.joints
    mean, factors = point.mean_factor(joints), point.factors(joints)
    f, of_joints, levels = serves.known[:, 0], serves.known[:, 1:-1], serves.known[:, -1]
    means = np.exp(np.log(of_joints).mean(axis=1)) if factors.size else np.ones_like(f)
    apart = (np.log(of_joints / means[:, np.newaxis]) - np.log(factors / mean)) ** 2
    far = (10.0 * (f - point.frequency) / serves.range.frequency[1]) ** 2
    weight = 1.0 / (apart.sum(axis=1) + far + 1e-3) ** 2
    guess = mean * float(np.exp(weight @ np.log(levels / means) / weight.sum()))
    low, high, level, slip = 0.0, np.inf, guess, serves.range.slip[1]
    for _ in range(16):  # trials
        model = point_of(system, replace(point, level=level, slip=slip))
        period = period_of(model)
        steps = max(50, int(np.ceil(period / longest_step(model, period) - 1e-9)))
        if sticking(from_rest(model, 4, steps)) <= 1.0 - WHOLE_SHARE:
            high = level
        else:
            low = level
        if high <= low * (1.0 + 2.0 * 0.03):
            return 0.5 * (low + high), guess  # to 3 %
        if low > 0.0 and np.isfinite(high):
            level = float(np.sqrt(low * high))
        else:
            level *= 1.3 if low > 0.0 else 1.0 / 1.3
    return None, guess


def from_rest(model: System, cycles: int, steps: int, fields_every: int = 0) -> Run:
    """Run of some cycles of the loads' common period, in so many steps each, from rest.

    What is doubtful in it is not told: nobody asked for this run.
    """
    period = period_of(model)
    save = Save(fields=fields_every > 0, fields_every=max(fields_every, 1))
    plan = Plan(period / steps, cycles * steps, save=save, cycle_steps=steps)
    return integrate_plan(model, plan, judged=False).finished()


def least_energy(run: Run) -> float:
    """Friction energy of a cycle, J, that errors are relative to where it is less than this.

    Where hardly anything slips, elastic contact in place of a rigid one moves as much as slips.
    """
    return 1e-3 * run.in_play if run.system.contact.opens else 0.0
