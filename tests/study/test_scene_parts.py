"""Scenes whose structure is factorised in parts: results are those of the whole; SI units."""

import numpy as np
import pytest
from joint_scenes import two_plates

import skfem_joint as sj
from skfem_joint.results.contact_history import contact_history
from skfem_joint.study.description import description_of
from skfem_joint.study.scene_backbone import scene_backbone
from skfem_joint.study.scene_response import scene_response

TABLES = {
    "backbone": {"modes": [1, 2], "levels": 2},
    "response": {"frequencies": {"from": 400.0, "to": 800.0, "points": 2}, "levels": [7e3]},
    "output": {"vtk": True, "frames": 10},
}


def scene(**models):
    return two_plates("condensed", **TABLES).changed(models=models)


@pytest.fixture(scope="module")
def parts():
    return scene(parts=3)


def test_a_run_in_parts_is_that_of_the_whole(parts):
    study = sj.run_scene(parts)
    own, whole = study.models["condensed"], sj.run_scene(scene()).models["condensed"]
    assert own.run.system.n == whole.run.system.n
    assert own.run.peak == pytest.approx(whole.run.peak, rel=1e-8)
    assert own.run.friction_work == pytest.approx(whole.run.friction_work, rel=1e-6)
    assert own.active_length == whole.active_length
    ours, right = (contact_history(study.structure, each.run) for each in (own, whole))
    assert ours.slip == pytest.approx(right.slip, abs=1e-8 * np.abs(right.slip).max())
    assert ours.friction == pytest.approx(right.friction, abs=1e-8)


def test_what_takes_a_factor_of_the_whole_is_left_out_with_a_note(parts):
    study = sj.run_scene(parts)
    assert study.models["condensed"].estimate is None
    assert any("not estimated" in note and "by parts" in note for note in study.notes)
    (stiff,) = (note for note in study.notes if "How much too stiff" in note)
    assert "it is not computed of a structure in parts." in stiff
    # Few modes of the condensed model make its frequencies a little higher.
    own, whole = (description_of(each).values for each in (parts, scene()))
    for joints in ("stuck", "loose"):
        frequencies = own[f"frequencies_{joints}_Hz"]
        assert frequencies[:3] == pytest.approx(whole[f"frequencies_{joints}_Hz"][:3], rel=1e-3)
    assert own["load_over_limit"] == pytest.approx(whole["load_over_limit"], rel=3e-3)
    assert "mesh" in whole
    assert "mesh" not in own


def test_a_command_that_has_no_parts_says_so(parts):
    assert not parts.passed_over("run")
    (note,) = parts.passed_over("fit")
    assert "fit takes no account of models.parts." in note


def test_curves_and_responses_in_parts_are_those_of_the_whole(parts):
    own, whole = (scene_backbone(each).models[0].curves for each in (parts, scene()))
    for a, b in zip(own, whole, strict=True):
        assert a.frequency == pytest.approx(b.frequency, rel=1e-5)
        assert a.slip.shape == b.slip.shape
    ours = scene_response(parts)
    (a,), (b,) = (each.models[0].curves for each in (ours, scene_response(scene())))
    assert a.column("amplitude") == pytest.approx(b.column("amplitude"), rel=1e-6)
    assert any("Errors of models by parts" in note for note in ours.notes)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"models": {"run": ["full", "condensed"]}}, "models.run: found .* must be .'condensed'."),
        ({"models": {"contact_points": 4}}, "models.contact_points: found beside models.parts"),
        ({"output": {"uff": True}}, "output.uff: found true beside models.parts"),
        ({"accuracy": {"energy": 0.1}}, "accuracy: found largest errors beside models.parts"),
    ],
)
def test_tables_that_need_the_whole_are_refused(parts, changes, message):
    with pytest.raises(sj.InputError, match=message):
        parts.changed(**changes)
