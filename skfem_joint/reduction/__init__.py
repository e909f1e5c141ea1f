"""Reduced models of structures with joints.

From data to model: `excitation` (loads of the run to come), `static_path` (how the joints slip,
without a run of the full model), `elastic_contact` (the same with contact that opens), `pod`
(proper orthogonal decomposition of snapshots), `interface_modes` (vibration without slip),
`joint_slides` (joints that slip as a whole), `sources` (a basis of these), `basis` (the basis, and
the reduced system on it), `friction_points` (fewer contact points), `missing_modes` (what a
reduced run shows that its basis is missing). `condensed` keeps all of the contact and reduces the
rest; `active_length` measures where joints slip. Models for a range are in `ranges`, the paper's
scaled modes in `scaled`.

From the keys of a scene to modes: `scene.tables.ReductionTable` reads the table ``[reduction]``,
`study.scene_plan.options_of` copies it to `reduction.basis.Options`, and its `basis_of_scene`
calls `make_reduced`, which chooses by the reference. What becomes of the key ``interface_modes``:

- "static": `sources.make_basis` -> `static_path.slip_path` (finds modes by
  `interface_modes.driven`) -> `sources.static_basis` (takes the number asked for, or if "auto" at
  most max(2, modes // 6) of those that `interface_modes.beside` keeps);
- "self": `sources.make_basis` -> `sources.own_basis` (the lowest modes; none if "auto");
- "paper": `scaled.basis.paper_basis` -> `interface_modes.participating`.

All end in `basis.Basis`. `reduce` below goes the first two ways without a scene.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from skfem_joint.ground.errors import InputError
from skfem_joint.ground.loads import common_period
from skfem_joint.ground.values import BETA, COUNT, POSITIVE, WHOLE, check, check_some
from skfem_joint.reduction.basis import SETTINGS, Basis, Origin, reduced_system
from skfem_joint.reduction.condensed import condense as condense
from skfem_joint.reduction.elastic_contact import check_reference, elastic
from skfem_joint.reduction.excitation import SHORT_RUNS
from skfem_joint.reduction.ranges.model import reduced_for_range
from skfem_joint.reduction.ranges.points import at as at
from skfem_joint.reduction.sources import own_basis, static_basis
from skfem_joint.reduction.static_path import slip_path
from skfem_joint.runs.resolution import longest_step
from skfem_joint.runs.slow_run import rate_independent
from skfem_joint.stepping.plan import Plan
from skfem_joint.stepping.recording import Run
from skfem_joint.system.served import Range
from skfem_joint.system.system import System


def reduce(
    system: System,
    modes: str | int = "auto",
    *,
    interface_modes: str | int = "auto",
    duration: float | None = None,
    run: Run | None = None,
    friction_points: str | int = "auto",
    beta: str | float = "auto",
    range: Mapping[str, Any] | Range | None = None,
    accuracy: float = 0.01,
    quasi_static: bool = False,
) -> System:
    """Reduced model on modes of a system's static slip path, or of a run of its own.

    Parameters
    ----------
    system : System
        With loads, as runs to come have them.
    modes : "auto" or int
        Joint modes; static responses to the loads stand beside them. "auto": 12, or with ``range``
        as many as the accuracy takes.
    interface_modes : "auto" or int
        Fixed-interface modes beside them. "auto": those with a share in the response on the
        static path, none with ``run``.
    duration : float, optional
        Of the run to come, s; needed for loads that do not repeat.
    run : Run, optional
        Own run with stored fields, ``save=Save(fields=True)``, to take modes of instead.
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
        loads, and ``modes`` and ``accuracy`` beside it.
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
        Its ``expand`` gives the displacement of the full structure. It is good for its loads
        as they are: `response`, `backbone` and `ring_down`, which load it otherwise, refuse it.
        With ``range`` it serves all of that; `at` takes the model of a point.

    Raises
    ------
    InputError
        If a number is out of range, the loads have no common period and no duration is given,
        nothing moves, or no point carries friction.
    """
    check("modes", modes, COUNT, "auto")
    if range is not None:
        others = (interface_modes, friction_points, beta, duration, run, quasi_static)
        if others != ("auto", "auto", "auto", None, None, False):
            raise InputError(
                "reduce: with range, interface_modes, friction_points, beta, duration and run are "
                "found for the whole range, which is one of vibration; leave them out, "
                "and quasi_static too"
            )
        return reduced_for_range(system, range, accuracy=accuracy, modes=modes)
    check("interface_modes", interface_modes, WHOLE, "auto")
    check("friction_points", friction_points, COUNT, "auto", "all")
    check("beta", beta, BETA, "auto")
    check_some(POSITIVE, duration=duration)
    count = SETTINGS.joint_modes if isinstance(modes, str) else modes
    if quasi_static:
        system, beta = rate_independent(system), np.inf
    if run is None:
        basis = _of_static_path(elastic(system), count, interface_modes, duration, quasi_static)
    else:
        check_reference(system, "self")
        beside = 0 if isinstance(interface_modes, str) else interface_modes
        basis = own_basis(system, run, count, interface_modes=beside)
    small = reduced_system(system, basis, friction_points=friction_points, beta=beta)
    origin = Origin(system, replace(basis, stiffness=None))  # whose factors are large
    return replace(small, made_for=_loading(system), origin=origin)


def _of_static_path(
    system: System,
    modes: int,
    interface_modes: str | int,
    duration: float | None,
    quasi_static: bool,
) -> Basis:
    """Basis of a system's static slip path; InputError for loads whose run has no known length."""
    period = common_period(load.amplitude for load in system.loads)
    whole = duration if period is None else SHORT_RUNS.training_cycles * period
    if whole is None:
        raise InputError(
            "reduce: the loads have no common period that is known; give the duration (s) of "
            "the run to come"
        )
    step = whole / 2000 if period is None else period / 200  # enough to tell inertia
    step = min(step, longest_step(system, whole, vibrates=not quasi_static))
    path = slip_path(system, Plan(step, round(whole / step), quasi_static=quasi_static), modes)
    return static_basis(system, path, modes, interface_modes)


def _loading(system: System) -> str:
    """Description of the loads of a system in a few words."""
    highest = [load.amplitude.highest_frequency for load in system.loads]
    known = sorted({f"{frequency:.6g} Hz" for frequency in highest if frequency is not None})
    return "its loads as they are" + (f" ({', '.join(known)})" if known else "")
