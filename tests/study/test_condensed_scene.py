"""Condensed models of scenes beside full and reduced ones; SI units."""

from typing import Any

import numpy as np
import pytest
from joint_scenes import MU, WIDTH, harmonic, plate_scene

import skfem_joint as sj
from skfem_joint.results.contact_history import contact_history
from skfem_joint.study.scene_backbone import scene_backbone
from skfem_joint.study.scene_response import scene_response
from skfem_joint.study.summary import model_summary

ALL = ("reduced", "condensed", "full")


def condensed(*run: str, **changes: Any) -> sj.Scene:
    """A plate pulled with half of what friction holds, that slips along and across."""
    mesh = sj.build_plate([("joint", 0.1, 6), ("free", 0.2, 6)], WIDTH, 2)
    values: dict[str, Any] = {
        "material": {"E": 200e9, "density": 8000.0, "poisson": 0.3},
        "joint": [{"on": "joint", "pressure": 8e6, "friction": MU}],
        "load": [harmonic("right", 14e3, 1000.0) | {"direction": [1.0, 0.1]}],
        "time": {"cycles": 2, "steps_per_cycle": 100},
    }
    return plate_scene(*run, mesh=mesh, **(values | changes))


def test_it_stands_between_full_and_reduced_in_all_results():
    output = {"vtk": True, "frames": 20}
    study = sj.run_scene(condensed(*ALL, output=output))
    full, model, reduced = study.models.values()
    assert [*study.models] == ["full", "condensed", "reduced"]
    assert reduced.run.system.n < model.run.system.n < full.run.system.n
    assert model.run.system.contact.count == full.run.system.contact.count
    assert model.errors.displacement_max < min(1e-5, reduced.errors.displacement_max)
    found, true = (model_summary(study, m)["joints"]["joint"] for m in (model, full))
    for name, value in true.items():
        if name.startswith("friction_energy_error"):  # a full model's is not stated
            continue
        assert found[name] == (value and pytest.approx(value, rel=1e-5)), name
    assert model.estimate.of("law", "friction_energy") == 0.0
    own, right = (contact_history(study.structure, m.run) for m in (model, full))
    assert np.abs(own.slip - right.slip).max() < 1e-2 * np.abs(right.slip).max()
    assert np.abs(own.friction - right.friction).max() < 1e-2
    assert np.abs(own.work - right.work).max() < 1e-5 * right.work.max()


def test_backbone_and_response_agree_with_the_full_model():
    tables = {
        "backbone": {"modes": [1], "levels": 5},
        "response": {"frequencies": {"from": 400.0, "to": 800.0, "points": 2}, "levels": [7e3]},
        "accuracy": {"estimate": False},
    }
    scene = condensed("condensed", "full", **tables)
    _, model = scene_backbone(scene).models
    assert model.name == "condensed"
    assert max(model.errors[0].values()) < 1e-10
    full, other = (m.curves[0] for m in scene_response(scene).models)
    assert other.column("amplitude") == pytest.approx(full.column("amplitude"), rel=1e-5)
    energy = full.column("friction_energy")
    assert other.column("friction_energy") == pytest.approx(energy, rel=1e-5)
