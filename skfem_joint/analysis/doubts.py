"""What to beware of in results, as whole sentences."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np

from skfem_joint.analysis.accuracy import excess
from skfem_joint.analysis.estimate import Estimate
from skfem_joint.analysis.history import peaks, steady_state
from skfem_joint.reduction.active_length import gross_slip

if TYPE_CHECKING:
    from skfem_joint.analysis.study import Model, Study

#: Displacements beyond this share of a structure's size are not small.
LARGE = 0.1
#: An energy balance open by more than this share of the energy in play is told.
OPEN = 1e-8
#: Estimated errors above this are told.
DOUBTFUL = 0.05
#: Joints that creep by more than this share of their slip are told: half of the limit makes them
#: creep by 1 / beta a second. A law is recommended that lets them creep by the second share.
CREEP, STEEP = 0.05, 0.01


def violated(study: Study, model: Model) -> list[str]:
    """What to beware of in a model's run, what assumptions it violates, and how far it may err."""
    run = model.run
    found = []
    if model.name != "reduced" and model.name == next(iter(study.models)):
        found += gross_slip(study.structure, model.slip_peak, study.period)
        found += _creeping(study, model)
    largest = max(run.peak.max(initial=0.0), run.slip_peak.max(initial=0.0))
    size = study.structure.size
    if largest > LARGE * size:
        found.append(
            f"The {model.name} model moves by {largest:.3g} m, more than a tenth of the "
            f"structure's {size:.3g} m: displacements are taken to be small, so that the results "
            "hold no longer. Are loads, stiffness and supports right?"
        )
    state = steady_state(run)
    if state is not None and not state.reached:
        found.append(
            f"The {model.name} model has not reached a steady state: the last cycle differs by "
            f"{100 * state.energy_change:.2g} % in energy and {100 * state.peak_change:.2g} % in "
            "peaks from the one before. Energies and peaks per cycle are those of the last cycle."
        )
    if np.any(peaks(run) > 0.0) and run.energy_residual > OPEN:
        found.append(
            f"The energy balance of the {model.name} model is open by {run.energy_residual:.2g} of "
            "the energy in play."
        )
    if model.estimate is not None:
        found += _errs(study, model, model.estimate)
    return found


def _creeping(study: Study, model: Model) -> Iterator[str]:
    """Sentences about joints whose law lets them creep where they should stick."""
    for patch in study.structure.patches:
        slip = float(model.slip_peak[patch.points].max(initial=0.0))
        beta, name = patch.joint.beta, patch.joint.name
        if slip > 0.0 and study.period / beta > CREEP * slip:
            yield (
                f"The law of joint '{name}' creeps: with beta = {beta:.3g} s/m half of its "
                f"friction limit lets it slip {study.period / beta:.3g} m in a period or run of "
                f"{study.period:.3g} s, and it slips {slip:.3g} m at most. A beta of "
                f"{study.period / (STEEP * slip):.2g} s/m would hold it nearly as Coulomb's law "
                "does, which law = 'coulomb' takes."
            )


def _errs(study: Study, model: Model, found: Estimate) -> Iterator[str]:
    """Sentence about estimated errors that are large, or larger than was asked for."""
    accuracy = study.scene.accuracy
    total = {name: e for name, e in found.parts["total"].items() if e is not None}
    worst = max(total, key=lambda name: total[name], default="")
    if not worst or not (total[worst] > DOUBTFUL or excess(accuracy, found) > 1.0):
        return
    sources = {
        s: found.of(s, worst) or 0.0 for s in ("basis", "law", "points", "mesh", "time_step")
    }
    source = max(sources, key=lambda one: sources[one])
    cures = {
        "law": "set reduction.beta higher" if model.name == "reduced" else "choose a steeper beta",
        "points": "set reduction.friction_points higher, or 'all'",
        "mesh": "use smaller elements",
        "time_step": "use a shorter time step",
        "basis": _basis(found),
    }
    yield (
        f"The {worst.replace('_', ' ')} of the {model.name} model errs by an estimated "
        f"{100 * total[worst]:.2g} %, most of it ({100 * sources[source]:.2g} %) from "
        f"{'its' if source != 'mesh' else 'the'} {source.replace('_', ' ')}: {cures[source]}; or "
        "say in [accuracy] what is needed."
    )


def _basis(found: Estimate) -> str:
    """What to do about a basis that lacks something."""
    if found.lacks is not None and found.lacks.slips:
        return (
            "it lacks slip of the joint; use more modes, a longer active_length, or "
            "reference = 'self'"
        )
    return "it lacks motion out of contact; use more interface_modes"
