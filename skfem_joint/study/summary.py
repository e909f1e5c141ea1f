"""Results of a model in numbers, and warnings about them in whole sentences."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from skfem_joint.accuracy.estimate import SOURCES, Estimate
from skfem_joint.results.history import QUANTITIES
from skfem_joint.results.loss import known, losses
from skfem_joint.results.places import JointPlaces, of_all, places_of
from skfem_joint.results.stress import (
    FEWEST_TIMES,
    cycle_period,
    stress_history,
    stress_notes,
    within,
)
from skfem_joint.runs.last_cycle import beyond_round_off, energies, peaks, steady_state
from skfem_joint.stepping.loops import Loops
from skfem_joint.stepping.recording import Run
from skfem_joint.study.accuracy import excess
from skfem_joint.study.results import Model, Study

#: Estimated error of a result above which there is a warning.
_DOUBTFUL = 0.05


def model_summary(study: Study, model: Model) -> dict[str, Any]:
    """Entry of one model in ``summary.json``; SI units, see the key names."""
    run = model.run
    cycles = run.cycles
    has_cycles = cycles.friction.size > 0
    state = steady_state(run)
    places = places_of(study.structure, study.system)
    by_place = places.of_run(run, model.slider_peak(study.system), study.period)
    content: dict[str, Any] = {
        "dofs": run.system.n,
        "contact_points": run.system.contact.count,
        "modes": model.modes,
        "steps": run.counters.steps,
        "newton_iterations": run.counters.newton_iterations,
        "largest_iterations_of_a_step": run.counters.largest_iterations,
        "friction_evaluations": run.counters.friction_evaluations,
        "halved_steps": run.counters.halved_steps,
        "wall_s": run.wall_s,
        "offline_s": model.offline_s,
        "compilation_s": model.compilation_s,
        "peak_displacement_m": _by_point(run, peaks(run)),
        "peak_displacement_whole_run_m": _by_point(run, run.peak),
        "amplitude_m": run.steady and _by_point(run, run.steady.amplitude),
        "offset_m": run.steady and _by_point(run, run.steady.offset),
        "drift_per_period_m": run.steady and _by_point(run, run.steady.drift),
        "friction_energy_per_cycle_J": energies(run)[0] if has_cycles else None,
        "loop_energy_per_cycle_J": energies(run)[1] if has_cycles else None,
        **(known(losses(run).row()) if has_cycles else {}),
        **({"loss_factor_error_total": model.loss_error} if has_cycles else {}),
        "friction_energy_J": _friction_energy(run),
        "input_work_J": float(beyond_round_off(run, run.input_work.sum())),
        "viscous_work_J": float(beyond_round_off(run, run.viscous_work)),
        "scheme_work_J": float(beyond_round_off(run, run.scheme_work)),
        **(_opening(run) if run.system.contact.opens else {}),
        "active_length_m": model.active_length,
        "active_area_fraction": model.active_area_fraction,
        "stress": _stresses(study, model),
        "joints": _joints(study, model, places),
        "bolts": {},
        "loads": _loads(run),
        "energy_balance_residual": run.energy_residual,
        "steady_state_reached": state.reached if state is not None else run.steady and True,
        "periods": run.steady and run.steady.periods,
        "interrupted": run.interrupted,
        "estimate_s": model.estimate_s,
        "estimated_error": _estimated(model.estimate, "_per_cycle" if has_cycles else ""),
        "estimated_total_without_mesh": _lacks_mesh(study, model),
    }
    for name, is_bolt, values in by_place.entries():
        table = content["bolts" if is_bolt else "joints"]
        table[name] = values | table.get(name, {})
    for name in ("bolts", "loads", "stress"):
        if not content[name]:
            del content[name]
    if model.errors is not None:
        error = asdict(model.errors)
        by_point = error.pop("by_point")
        error["displacement_rms_by_point"] = {name: rms for name, (rms, _) in by_point.items()}
        error["displacement_max_by_point"] = {name: most for name, (_, most) in by_point.items()}
        content["error"] = error
    return content


def _opening(run: Run) -> dict[str, float]:
    """Results of contact that opens."""
    contact = run.system.contact.normal
    return {
        "impact_energy_J": run.impact_work,
        "largest_normal_force_N": float(contact.at_all(run.normal_force_peak).max()),
        "opened_fraction": float(np.mean(contact.at_all(run.opened) > 0.0)),
    }


def _joints(study: Study, model: Model, places: JointPlaces) -> dict[str, dict[str, Any]]:
    """Results of each joint. The slip of a reduced model is that of its friction points."""
    run = model.run
    per_cycle: list[Any] = beyond_round_off(run, run.cycles.by_joint[-1:]).ravel().tolist()
    energy = _friction_energy(run)
    per_cycle = per_cycle or [None] * len(run.system.contact.joints)
    by_name: dict[str, dict[str, Any]] = {}
    by_bolt = beyond_round_off(run, places.share @ of_all(run.system, run.friction_work))
    for k, patch in enumerate(study.structure.patches):
        name, own = patch.joint.name, run.system.contact.J[[k]].toarray()[0] > 0.0
        errors = {} if model.estimate is None else model.estimate.by_joint
        beside_all, beside_own = errors.get(name, (None, None))
        by_name[name] = {
            "friction_energy_J": energy[name],
            "friction_energy_per_cycle_J": per_cycle[k],
            "largest_slip_m": float(run.slip_peak[own].max(initial=0.0)),
            "slipping_fraction": model.slipping_fraction.get(name),
            "active_length_m": model.active_length.get(name),
            "active_area_fraction": model.active_area_fraction.get(name),
            "friction_energy_error": beside_all,
            "friction_energy_error_of_own": beside_own,
        }
        if run.loops is not None:
            by_name[name] |= _joint_loop(run.loops, k)
        if np.isfinite(patch.joint.tangential_stiffness):
            springs = patch.stiffness[np.isfinite(patch.stiffness)]
            by_name[name]["tangential_stiffness_N_per_m"] = float(springs.sum())
        if bolts := [b for b in range(places.joints, len(places.names)) if places.owner[b] == k]:
            by_name[name]["friction_energy_by_bolt_J"] = by_bolt[bolts].tolist()
    return by_name


def _stresses(study: Study, model: Model) -> dict[str, dict[str, dict[str, float | None]]]:
    """Where stresses of a run are largest in the regions asked for; see `StressCycle.largest`."""
    run, by_region = model.run, {}
    for region in study.scene.output.stress:
        history = stress_history(study.structure.meshed("stress needs a mesh"), run, region)
        if within(history.times, cycle_period(run)) is None:
            continue
        cycle = history.cycle(cycle_period(run))
        by_region[region] = {name: known(row) for name, row in cycle.largest()}
    return by_region


def _friction_energy(run: Run) -> dict[str, float]:
    """Energy that friction dissipates in each joint over the run, J, but for round-off."""
    lost = beyond_round_off(run, [*run.friction_energy.values()]).tolist()
    return dict(zip(run.friction_energy, lost, strict=True))


def _joint_loop(loops: Loops, joint: int) -> dict[str, float | None]:
    """Results of a joint's loop, in the last cycle or the whole run; see `Loops`."""
    return known(
        {
            "largest_force_N": float(np.abs(loops.force[:, joint]).max()),
            "secant_stiffness_N_per_m": float(loops.secant_stiffness[joint]),
            "loop_area_J": float(loops.area[joint]),
        }
    )


def _loads(run: Run) -> dict[str, dict[str, float | None]]:
    """Results of the loads' loops of a quasi-static run, in the last cycle or the whole run."""
    loops = run.loops
    if loops is None:
        return {}
    works = run.cycles.input[-1] if len(run.cycles.input) else run.input_work
    stiffnesses = loops.load_secant_stiffness.tolist()
    rows = zip(run.system.loads, works.tolist(), stiffnesses, strict=True)
    return {
        load.on or f"load_{k}": known(
            {"loop_energy_J": work, "secant_stiffness_N_per_m": stiffness}
        )
        for k, (load, work, stiffness) in enumerate(rows)
    }


def _by_point(run: Run, values: Any) -> dict[str, float]:
    return {name: float(value) for name, value in zip(run.system.points, values, strict=True)}


def _estimated(estimate: Estimate | None, energies: str) -> dict[str, dict[str, float | None]]:
    """Estimated errors by quantity and source; None where nothing was estimated."""
    return {
        quantity + (energies if "energy" in quantity else ""): {
            source: None if estimate is None else estimate.of(source, quantity)
            for source in SOURCES
        }
        for quantity in QUANTITIES
    }


def _lacks_mesh(study: Study, model: Model) -> bool | None:
    """Whether estimated totals leave the error by the mesh out; None where there is neither."""
    if model.estimate is None or study.structure.body is None:
        return None
    return model.estimate.lacks_mesh


def violated(study: Study, model: Model) -> list[str]:
    """Warnings about a model's run: assumptions that it violates, and how far it may err."""
    run = model.run
    warnings = []
    largest = max(run.peak.max(initial=0.0), run.slip_peak.max(initial=0.0))
    size = np.inf if study.structure.body is None else study.structure.body.size
    # Displacement over a structure's size: the equations hold for small displacements.
    if largest > 0.1 * size:
        warnings.append(
            f"The {model.name} model moves by {largest:.3g} m, more than a tenth of the "
            f"structure's {size:.3g} m: displacements are taken to be small, so that the results "
            "hold no longer. Are loads, stiffness and supports right?"
        )
    warnings += _creeping(study, model)
    named = f"The {model.name} model "
    warnings += [re.sub("^The run ", named, note) for note in run.notes]
    warnings += _stress_notes(study, model)
    if model.estimate is not None:
        warnings += _differs(study, model, model.estimate)
        warnings += _errs(study, model, model.estimate)
    return warnings


def _stress_notes(study: Study, model: Model) -> Iterator[str]:
    """Sentences about stresses that were asked for and are not known."""
    times = model.run.field_times
    if not study.scene.output.stress:
        return
    yield from stress_notes(study.structure.meshed("stress needs a mesh"))
    if within(times, cycle_period(model.run)) is None:
        yield (
            f"output.stress: the {model.name} model stored {times.size} times, too few for a range "
            f"of stress: {FEWEST_TIMES} of a cycle are needed; integrate with more steps, or raise "
            "output.frames."
        )


def _differs(study: Study, model: Model, errors: Estimate) -> Iterator[str]:
    """Sentence about the distance from the full model beside it, if it is larger than expected.

    The expected one is what was estimated, and what is asked for.
    """
    accuracy = study.scene.accuracy
    beyond, misses = [], False
    for name, apart in errors.parts.get("full_run", {}).items():
        stated = None if errors.unmeasured is None else errors.unmeasured.get(name)
        asked = accuracy.energy if "energy" in name else accuracy.displacement
        limits = {"estimated": stated, "asked for": asked}
        # A distance from the full model up to this is never reported.
        passed = [
            f"the {100 * limit:.3g} % {what}"
            for what, limit in limits.items()
            if apart is not None
            and limit is not None
            and apart > max(limit, 1e-3 if what == "estimated" else 0.0)
        ]
        misses = misses or any(what.endswith("asked for") for what in passed)
        if passed:
            shown = f"{name.replace('_', ' ')} by {100 * (apart or 0.0):.3g} %"
            beyond.append(f"its {shown}, more than {' and '.join(passed)}")
    if beyond:
        yield (
            f"The {model.name} model differs from the full one that was run beside it: "
            f"{'; '.join(beyond)}. The larger error counts as its total"
            f"{': it does not meet the accuracy asked for' * misses}. Use the full model's "
            "results, or more modes and friction points."
        )


def _creeping(study: Study, model: Model) -> Iterator[str]:
    """Sentences about a law that lets joints creep where Coulomb's law holds them.

    By the distance from Coulomb's law where it is estimated, else by what they creep in a period.
    """
    if model.name != next(iter(study.models)):
        return
    apart = {} if model.estimate is None else model.estimate.parts.get("coulomb", {})
    if apart:
        far = {name: e for name, e in apart.items() if e is not None and e > _DOUBTFUL}
        if far:
            worst = max(far, key=lambda name: far[name])
            percent = float(f"{100 * far[worst]:.2g}")
            beta = min(patch.joint.beta for patch in study.structure.patches)
            yield (
                f"The law creeps: with beta = {beta:.3g} s/m the {worst.replace('_', ' ')} of the "
                f"{model.name} model is an estimated {percent:g} % off that of Coulomb's law. "
                "Leave beta out if that law is meant; if this beta is meant, that is no error, "
                "and no part of the total."
            )
        return
    if model.name == "reduced":  # of which only merged points' slips are known
        return
    for patch in study.structure.patches:
        slip = float(model.slip_peak[patch.points].max(initial=0.0))
        beta, name = patch.joint.beta, patch.joint.name
        # Slip of a joint by creep in a period at half of its friction limit, period / beta, over
        # its largest slip.
        if slip > 0.0 and study.period / beta > 0.05 * slip:
            # The same share for the steepness that the warning recommends.
            yield (
                f"The law of joint '{name}' creeps: with beta = {beta:.3g} s/m half of its "
                f"friction limit lets it slip {study.period / beta:.3g} m in a period or run of "
                f"{study.period:.3g} s, and it slips {slip:.3g} m at most. A beta of "
                f"{study.period / (0.01 * slip):.2g} s/m would hold it nearly as Coulomb's "
                "law does, which is the law where beta is left out."
            )


def _errs(study: Study, model: Model, errors: Estimate) -> Iterator[str]:
    """Sentence about estimated errors that are large, or larger than was asked for."""
    accuracy = study.scene.accuracy
    total = {
        name: e
        for name, e in errors.parts["total"].items()
        # A distance from the full model has a sentence of its own, and no sources.
        if e is not None and e != errors.of("full_run", name)
    }
    state = steady_state(model.run)
    if state is not None and not (state.reached or accuracy.is_given):
        # The work of such a cycle is also what is stored in it: it may have any sign, and be next
        # to nothing beside its own error.
        total.pop("loop_energy", None)
    worst = max(total, key=lambda name: total[name], default="")
    own = replace(errors, parts={**errors.parts, "total": dict(total)})
    if not worst or not (total[worst] > _DOUBTFUL or excess(accuracy, own) > 1.0):
        return
    sources = {
        s: errors.of(s, worst) or 0.0 for s in ("basis", "law", "points", "mesh", "time_step")
    }
    source = max(sources, key=lambda name: sources[name])
    cures = {
        "law": "set reduction.beta higher",
        "points": "set reduction.friction_points higher, or 'all'",
        "mesh": "use smaller elements",
        "time_step": "use a shorter time step",
        "basis": _basis(model, errors),
    }
    yield (
        f"The {worst.replace('_', ' ')} of the {model.name} model errs by an estimated "
        f"{100 * total[worst]:.2g} %, most of it ({100 * sources[source]:.2g} %) from "
        f"{'its' if source != 'mesh' else 'the'} {source.replace('_', ' ')}"
        f"{' (that of the mesh is not counted)' * bool(_lacks_mesh(study, model))}: "
        f"{cures[source]}; or say in [accuracy] what is needed."
        f"{' Such a result is of no use.' * (total[worst] > 1.0)}"
    )


def _basis(model: Model, errors: Estimate) -> str:
    """Cure for a basis that misses modes."""
    if model.run.system.contact.opens:
        if model.name == "reduced":
            return "use more modes, or run the condensed model"
        return "run the full model, or sj.condense with more interface_modes"
    if errors.missing is not None and errors.missing.slips:
        return (
            "it lacks slip of the joint; use more modes, a longer active_length, or "
            "reference = 'self'"
        )
    return "it lacks motion out of contact; use more interface_modes"
