"""Reduced models of structures with joints.

`static_path` finds how the joints slip without a full run, `pod` decomposes snapshots of that or of
a run, `basis` makes modes of them, or scales those of the paper's `reference` joint over the active
`zones` (`active_length`); `friction_points` gives a reduced system as few points of friction as it
can make use of; `condensed` keeps all of the contact, and reduces the rest.
"""

from __future__ import annotations

from dataclasses import replace

from skfem_joint.errors import InputError
from skfem_joint.loads import common_period
from skfem_joint.reduction.basis import TRAINING_CYCLES, own_basis, static_basis
from skfem_joint.reduction.condensed import condense as condense
from skfem_joint.reduction.friction_points import reduced_system
from skfem_joint.reduction.static_path import slip_path
from skfem_joint.stepping.plan import Plan
from skfem_joint.stepping.recording import Run
from skfem_joint.stepping.resolution import longest_step
from skfem_joint.system import System
from skfem_joint.values import BETA, COUNT, POSITIVE, WHOLE, check, check_some

#: Steps of a run to come: in a period of its loads, or in all.
_STEPS, _MOST_STEPS = 200, 2000


def reduce(
    system: System,
    modes: int = 12,
    *,
    interface_modes: str | int = "auto",
    duration: float | None = None,
    run: Run | None = None,
    friction_points: str | int = "auto",
    beta: str | float = "auto",
) -> System:
    """Reduced model on modes of a system's static slip path, or of a run of its own.

    Parameters
    ----------
    system : System
        With loads, as runs to come have them.
    modes : int
        Joint modes; static responses to the loads stand beside them.
    interface_modes : "auto" or int
        Fixed-interface modes beside them; "auto": those with a share in the response.
    duration : float, optional
        Of the run to come, s; needed for loads that do not repeat.
    run : Run, optional
        Own run with stored fields, ``save=Save(fields=True)``, to take modes of instead.
    friction_points : "auto", "all" or int
        Most friction points; "auto" is as many as it takes. Points that slip alike are merged.
    beta : "auto" or float
        Scaling constant of Eq. (2), s/m; no steeper than the modes resolve.

    Returns
    -------
    System
        Its ``expand`` gives the displacement of all that the full one has. It is good for its loads
        as they are: `response`, `backbone` and `ring_down`, which load it otherwise, refuse it.

    Raises
    ------
    InputError
        If a number is out of range, the loads have no common period and no duration is given,
        nothing moves, or no point carries friction.
    """
    check("modes", modes, COUNT)
    check("interface_modes", interface_modes, WHOLE, "auto")
    check("friction_points", friction_points, COUNT, "auto", "all")
    check("beta", beta, BETA, "auto")
    check_some(POSITIVE, duration=duration)
    if run is not None:
        count = 0 if isinstance(interface_modes, str) else interface_modes
        basis = own_basis(system, run, modes, interface_modes=count)
    else:
        period = common_period(load.amplitude for load in system.loads)
        whole = duration if period is None else TRAINING_CYCLES * period
        if whole is None:
            raise InputError(
                "reduce: the loads have no common period that is known; give the duration (s) of "
                "the run to come"
            )
        step = whole / _MOST_STEPS if period is None else period / _STEPS
        step = min(step, longest_step(system, whole))
        path = slip_path(system, Plan(step, round(whole / step)), modes)
        basis = static_basis(system, path, modes, interface_modes)
    small = reduced_system(system, basis, friction_points=friction_points, beta=beta)
    return replace(small, made_for=_loading(system))


def _loading(system: System) -> str:
    """Loads of a system in words."""
    highest = [load.amplitude.highest_frequency for load in system.loads]
    known = sorted({f"{frequency:.6g} Hz" for frequency in highest if frequency is not None})
    return "its loads as they are" + (f" ({', '.join(known)})" if known else "")
