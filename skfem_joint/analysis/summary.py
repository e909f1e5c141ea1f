"""What a model's results are in numbers."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING, Any

import numpy as np

from skfem_joint.analysis.estimate import SOURCES, Estimate
from skfem_joint.analysis.history import QUANTITIES, peaks, steady_state
from skfem_joint.arrays import FloatArray
from skfem_joint.structure import Bolts, Patch

if TYPE_CHECKING:
    from skfem_joint.analysis.study import Model, Study
    from skfem_joint.stepping.recording import Run


def model_summary(study: Study, model: Model) -> dict[str, Any]:
    """Entry of one model in ``summary.json``; SI units, see the key names."""
    run = model.run
    cycles = run.cycles
    has_cycles = cycles.friction.size > 0
    state = steady_state(run)
    content: dict[str, Any] = {
        "dofs": run.system.n,
        "contact_points": run.system.contact_points,
        "modes": model.modes,
        "steps": run.counters.steps,
        "newton_iterations": run.counters.newton_iterations,
        "largest_iterations_of_a_step": run.counters.largest_iterations,
        "friction_evaluations": run.counters.friction_evaluations,
        "halved_steps": run.counters.halved_steps,
        "wall_s": run.wall_s,
        "offline_s": model.offline_s,
        "peak_displacement_m": _by_point(run, peaks(run)),
        "peak_displacement_whole_run_m": _by_point(run, run.peak),
        "friction_energy_per_cycle_J": float(cycles.friction[-1]) if has_cycles else None,
        "loop_energy_per_cycle_J": float(cycles.input[-1].sum()) if has_cycles else None,
        "friction_energy_J": run.friction_energy,
        "input_work_J": float(run.input_work.sum()),
        "viscous_work_J": run.viscous_work,
        "scheme_work_J": run.scheme_work,
        "active_length_m": model.active_length,
        "active_area_fraction": model.active_area_fraction,
        "joints": _joints(study, model),
        "energy_balance_residual": run.energy_residual,
        "steady_state_reached": state.reached if state is not None else run.steady and True,
        "periods": run.steady and run.steady.periods,
        "interrupted": run.interrupted,
        "estimate_s": model.estimate_s,
        "estimated_error": _estimated(model.estimate, "_per_cycle" if has_cycles else ""),
    }
    if model.errors is not None:
        error = asdict(model.errors)
        by_point = error.pop("by_point")
        error["displacement_rms_by_point"] = {name: one for name, (one, _) in by_point.items()}
        error["displacement_max_by_point"] = {name: one for name, (_, one) in by_point.items()}
        content["error"] = error
    return content


def _joints(study: Study, model: Model) -> dict[str, dict[str, Any]]:
    """What each joint does. The slip of a reduced model is that of its friction points."""
    run = model.run
    per_cycle: list[Any] = run.cycles.by_joint[-1:].ravel().tolist()
    per_cycle = per_cycle or [None] * len(run.system.joints)
    found: dict[str, dict[str, Any]] = {}
    work = run.friction_work if model.shares is None else model.shares.T @ run.friction_work
    for k, patch in enumerate(study.structure.patches):
        name, own = patch.joint.name, run.system.J[[k]].toarray()[0] > 0.0
        found[name] = {
            "friction_energy_J": run.friction_energy[name],
            "friction_energy_per_cycle_J": per_cycle[k],
            "largest_slip_m": float(run.slip_peak[own].max(initial=0.0)),
            "slipping_fraction": model.slipping_fraction.get(name),
            "active_length_m": model.active_length.get(name),
            "active_area_fraction": model.active_area_fraction.get(name),
        }
        if isinstance(patch.joint.pressure, Bolts):
            part = study.system.J[[k]].toarray()[0] * work
            by_bolt = _by_bolt(study, patch, patch.joint.pressure, part[patch.points])
            found[name]["friction_energy_by_bolt_J"] = by_bolt
    return found


def _by_bolt(study: Study, patch: Patch, bolts: Bolts, work: FloatArray) -> list[float]:
    """Work (J) of the contact points of a joint, summed for the bolt that each is nearest to."""
    nodes = study.structure.nodes[patch.nodes]
    at = np.array([bolt.at[: nodes.shape[1]] for bolt in bolts.bolts])
    nearest = np.linalg.norm(nodes[:, np.newaxis] - at, axis=2).argmin(axis=1)
    return list(np.bincount(nearest, work, len(at)))


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
