"""One maker of models: what a scene runs is what Python users make, with the same notes."""

import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from joint_scenes import bar_scene, plate, plate_scene
from scipy.linalg import subspace_angles

import skfem_joint as sj
from skfem_joint.study.description import description_of
from skfem_joint.study.models import model_of
from skfem_joint.study.scene_backbone import scene_backbone
from skfem_joint.study.scene_response import scene_response


def same(one: sj.System, other: sj.System) -> bool:
    """Whether two models have the same unknowns, contact and notes, but for round-off."""
    V, W = (model.origin.basis.V for model in (one, other))
    return bool(
        V.shape == W.shape
        and np.sin(subspace_angles(V, W)).max() < 1e-9
        and one.contact.w == pytest.approx(other.contact.w, rel=1e-9)
        and one.contact.beta == pytest.approx(other.contact.beta, rel=1e-9)
        and one.notes == other.notes
    )


def bar(*run: str, **changes: Any) -> sj.Scene:
    return bar_scene(*run, reduction={"reference": "static"}, **changes)


def pulse() -> sj.Scene:
    load = {"on": "free_end", "kind": "half_sine", "peak": 5e4, "rise_time": 5e-4}
    time = {"duration": 4e-3, "step": 1e-5}
    return bar("reduced", load=[load], time=time)


def damped() -> sj.Scene:
    """Steps that damp the highest frequencies."""
    scene = pulse()
    return scene.changed(time={"rho_infinity": 0.3})


@pytest.mark.parametrize("make", [bar, pulse, damped, plate_scene])
def test_the_reduced_model_of_a_scene_is_that_of_sj_reduce(make):
    scene = make()
    time: dict[str, Any] = {"duration": scene.n_steps * scene.time_step, "step": scene.time_step}
    time["scheme"] = sj.generalized_alpha(scene.time.rho_infinity)
    assert same(model_of("reduced", scene), sj.reduce(scene.system(), **time))


def test_the_condensed_model_of_a_scene_is_that_of_sj_condense():
    scene = bar_scene()
    assert same(model_of("condensed", scene), sj.condense(scene.system()))


def test_models_of_backbones_and_responses_are_made_in_python_as_by_the_commands():
    scene = bar(
        "full",
        "reduced",
        backbone={"modes": [1], "levels": 4},
        response={"frequencies": {"from": 1500.0, "to": 1900.0, "points": 3}, "levels": [0.5]},
        accuracy={"estimate": False},
    )
    system = scene.system()
    (curve,) = sj.backbone(system, levels=4)
    small = sj.reduce(system, curve=curve)
    (own,) = sj.backbone(small, levels=4, slips_at=curve.slips_at)
    of_scene = scene_backbone(scene).models[1]
    assert own.frequency == pytest.approx(of_scene.curves[0].frequency, rel=1e-12)
    assert own.frequency == pytest.approx(curve.frequency, rel=1e-4)
    assert own.friction_damping == pytest.approx(curve.friction_damping, rel=1e-2)
    assert sj.ring_down(small, own, 10).frequency.size > 0
    answer = scene_response(scene)
    asked = np.isin(answer.linear_frequencies, answer.frequencies)
    resonance = float(answer.frequencies[answer.stuck[asked].max(axis=1).argmax()])
    small = sj.reduce(system, frequency=resonance, level=0.5)
    (found,) = sj.response(small, answer.frequencies, [0.5], estimated=False)
    full, reduced = (model.curves[0] for model in answer.models)
    assert found.peak == pytest.approx(reduced.peak, rel=1e-9)
    assert found.peak == pytest.approx(full.peak, rel=0.01)


def test_a_model_serves_what_it_was_made_for():
    system = bar_scene().system()
    (curve,) = sj.backbone(system, levels=2)
    loads = "its loads as they are"
    for small, refused, why in (
        (sj.reduce(system, 4), ("response", "backbone", "ring_down"), loads),
        (sj.reduce(system, 4, frequency=500.0), ("backbone", "ring_down"), "response about 500"),
        (sj.reduce(system, 4, curve=curve), ("response",), "mode 1 up to level"),
    ):
        calls = {
            "response": lambda model: sj.response(model, [400.0, 500.0]),
            "backbone": sj.backbone,
            "ring_down": lambda model: sj.ring_down(model, curve, 4),
        }
        for name in refused:
            with pytest.raises(
                sj.InputError, match=f"{name}: found a reduced model made for {why}"
            ):
                calls[name](small)
    with pytest.raises(sj.InputError, match="exclude each other"):
        sj.reduce(system, 4, frequency=500.0, curve=curve)


def test_reduce_refuses_what_its_modes_do_not_depend_on():
    system = bar_scene().system()
    (curve,) = sj.backbone(system, levels=2)
    for idle, beside in (
        ({"level": 2.0}, "without frequency"),
        ({"level": 2.0, "curve": curve}, "without frequency"),
        ({"accuracy": 1e-3}, "without range"),
        ({"quasi_static": True, "curve": curve}, "quasi_static beside curve"),
        ({"duration": 0.1, "step": 1e-5, "frequency": 500.0}, "step and duration beside frequency"),
    ):
        with pytest.raises(sj.InputError, match=beside):
            sj.reduce(system, 4, **idle)


def test_a_model_serves_no_level_above_those_it_was_made_for(tmp_path):
    """With the default levels a model of a curve has those of the curve."""
    system = bar_scene().system()
    (curve,) = sj.backbone(system, levels=3, up_to=0.5)
    small = sj.reduce(system, curve=curve)
    (own,) = sj.backbone(small, levels=3, up_to=0.5)
    assert own.level == pytest.approx(curve.level, rel=1e-12)
    with pytest.raises(sj.InputError, match=r"found level .* the highest of the reduced model"):
        sj.backbone(small)
    small = sj.reduce(system, 4, frequency=500.0, level=0.5)
    with pytest.raises(sj.InputError, match=r"found level 0\.6, must be at most 0\.5"):
        sj.response(small, [400.0, 500.0], [0.1, 0.6])
    loaded = sj.load(sj.save(small, tmp_path / "small.npz"))
    with pytest.raises(sj.InputError, match=r"as one of a file .* make it again by sj\.reduce"):
        sj.response(loaded, [400.0, 500.0], [0.1])


def test_a_reference_that_only_runs_have_is_said_elsewhere():
    asked = {"frequencies": {"from": 1500.0, "to": 1900.0, "points": 2}, "levels": [0.1]}
    scene = bar_scene("full", "reduced", backbone={"levels": 2}, response=asked)
    for notes in (scene_backbone(scene).notes, scene_response(scene).notes):
        assert any("reduction.reference = 'paper' is for 'run' alone" in note for note in notes)


def test_what_a_run_and_its_system_should_tell_is_told_in_python_too():
    """A scene's warnings are the notes of its system, its models and their runs, and no more."""
    scene = bar("full", "reduced", time={"cycles": 2}, accuracy={"estimate": False})
    study = sj.run_scene(scene)
    system = scene.system()
    run = sj.integrate(system, cycles=2, steps_per_cycle=scene.time.steps_per_cycle)
    reduced = study.models["reduced"].run
    assert any("has not reached a steady state" in note for note in run.notes)
    assert "note: The run has not reached" in repr(run)
    told = [*system.notes, *run.notes, *reduced.system.notes, *reduced.notes]
    for warning in study.notes:
        assert re.sub("^The (full|reduced) model has", "The run has", warning) in told


def test_doubtful_values_are_notes_of_the_system():
    mesh = sj.build_plate([("joint", 0.1, 4), ("arm", 0.3, 8)], 0.05, 2)
    light = sj.Material(E=2e11, density=0.8, poisson=0.3)
    made = sj.Structure(mesh, light, thickness=0.01, fixed=["left"], joints=[])
    load = sj.Load("right", sj.Harmonic(1e3, 5e6), (1.0, 0.0))
    fast, slow = made.system([load]).notes, made.system([load], quasi_static=True).notes
    assert any("material.density is 0.8" in note for note in fast)
    assert any("nothing slips, the structure is linear" in note for note in fast)
    assert any("slowest wave" in note for note in {*fast} - {*slow})


def test_python_describes_what_check_describes():
    scene = plate_scene(mesh=plate(4))
    expected = description_of(scene)
    time = scene.n_steps * scene.time_step
    found = sj.describe(scene.structure(), scene.loads(), time)
    assert found.facts[:4] == expected.facts[:4]
    for name in ("mass_kg", "load_over_limit", "wave_speed_m_per_s"):
        assert found.values[name] == pytest.approx(expected.values[name], rel=1e-6)
    assert [*found.values] == [*expected.values]
    load = replace(scene.loads()[0], amplitude=sj.HalfSine(1e3, 1e-3))
    with pytest.raises(sj.InputError, match="give the duration"):
        sj.describe(scene.structure(), [load])


def test_smaller_models_of_merged_points_ring_down_beside_the_full_one():
    models = {"run": ["full", "condensed", "reduced"], "contact_points": 30}
    table, points = {"levels": 4, "ring_down": 8}, {"friction_points": 20}
    time = {"cycles": 2, "steps_per_cycle": 50}
    scene = bar_scene(models=models, backbone=table, reduction=points, time=time)
    found = scene_backbone(scene).models
    assert [model.systems[0].contact.w.size for model in found] == [100, 30, 20]
    full, *others = (model.ring_downs[0].frequency for model in found)
    for frequency in others:
        np.testing.assert_allclose(frequency, full, rtol=1e-3)
