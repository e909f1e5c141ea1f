"""Peaks of a response lie on the backbone where vibration is that of one mode, and only there."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from joint_scenes import bar_scene, joint
from scene_texts import csv_rows
from scipy.integrate import quad

import skfem_joint as sj
from skfem_joint.output.damping import response_lines, write_response
from skfem_joint.study.backbone_peaks import backbone_errors, backbone_peaks
from skfem_joint.study.scene_backbone import given_backbones
from skfem_joint.study.scene_response import scene_response


def test_the_error_of_a_backbone_is_that_of_its_first_harmonic():
    """Exact for q = alpha / k + c alpha^2, the bar of uniform friction, by Masing's rule."""
    k, c, damping = 4.0, 1e-2, 0.01
    level = np.geomspace(0.5, 40.0, 40)
    q = level / k + c * level**2
    known = {"stuck_frequency": np.sqrt(k) / 2.0 / np.pi, "damping_ratio": np.full(40, damping)}
    found = backbone_errors(SimpleNamespace(amplitude=q, level=level, **known))

    def path(x: float) -> float:
        return 0.5 / c * (np.sqrt(k**-2 + 4.0 * c * x) - 1.0 / k)

    for i in (10, 25, 39):
        a, top = q[i], level[i]
        force = quad(
            lambda t, a=a, top=top: np.cos(t) * (top - 2.0 * path(0.5 * a * (1.0 - np.cos(t)))),
            *(0.0, np.pi),
        )[0]
        first = np.sqrt(2.0 / np.pi * force / top)
        assert found[i] == pytest.approx(2.0 * (abs(first - 1.0) + damping**2), rel=0.05)
    assert found[39] > 5.0 * found[10] > 0.0


def bar(tip: bool, low: float, high: float) -> sj.Scene:
    """Bar of 0.6 m on a base over 0.1 m, maybe with a heavy tip."""
    strips = [("joint", 0.1, 30), ("linear", 0.48, 16), ("tip", 0.02, 1)]
    regions = {"regions": {"tip": {"density": 320e3}}} if tip else {}
    return bar_scene(
        "full",
        bar=sj.build_bar(strips, {"fixed": 0.0, "free_end": 0.6}),
        material={"E": 200e9, "density": 8000.0} | regions,
        joint=[joint(law="coulomb", normal_force="consistent")],
        damping={"ratio": 0.002},
        time={"cycles": 1, "steps_per_cycle": 100},
        response={"frequencies": {"from": low, "to": high, "points": 6}, "levels": [0.03]},
        backbone={"levels": 8, "up_to": 0.9},
        accuracy={"estimate": False},
    )


@pytest.mark.parametrize(("tip", "low", "high"), [(True, 1100.0, 1150.0), (False, 2350.0, 2450.0)])
def test_peaks_lie_on_the_backbone_unless_friction_excites_higher_modes(tip, low, high, tmp_path):
    """Modes at 1 : 4.7 : 8.9 with the tip, and at 1 : 3 : 5 without."""
    scene = bar(tip, low, high)
    response = scene_response(scene)
    (peak,) = backbone_peaks(response)
    assert peak.mode == 1
    assert np.isnan(peak.amplitude_error)  # it was not estimated
    assert 0.0 < peak.error < 5e-3
    assert (abs(peak.apart) <= peak.error) == tip
    if not tip:
        assert peak.apart == pytest.approx(-0.0115, rel=0.1)
    lines = response_lines(response)
    assert ("within the" in lines[1]) == tip
    assert any("higher frequencies near odd multiples" in line for line in lines) != tip
    files = {path.name for path in write_response(tmp_path, response)}
    assert {"peaks.csv", "backbone_response.png"} <= files
    assert (tmp_path / "backbone_response.png").stat().st_size > 10_000


def test_a_scene_without_the_table_has_no_backbone():
    assert given_backbones(bar_scene("full")) == []


def test_a_response_without_friction_is_not_refused_for_a_backbone_beside_it():
    tables = {
        "joint": [joint(pressure=0.0)],
        "backbone": {"levels": 4},
        "response": {"frequencies": {"from": 500.0, "to": 600.0, "points": 3}, "levels": [1.0]},
    }
    scene = bar_scene("full", "reduced", bar="coarse", **tables)
    assert given_backbones(scene) == []
    response = scene_response(scene)
    (model,) = response.models
    assert any(note.startswith("backbone: there is no curve") for note in response.notes)
    assert any("'reduced' left out" in note for note in response.notes)
    # It is linear: amplitudes are those of the limit with loose joints.
    (curve,) = model.curves
    amplitude = np.array([point.amplitude for point in curve.points])
    loose = response.loose[np.isin(response.linear_frequencies, response.frequencies)]
    np.testing.assert_allclose(amplitude, loose, rtol=5e-3)


def test_an_end_of_the_frequencies_is_no_peak_and_what_is_not_known_is_left_out(tmp_path):
    scene = bar(True, 900.0, 1000.0)
    response = scene_response(scene)
    (peak,) = backbone_peaks(response)
    assert peak.at_end
    lines = response_lines(response)
    assert "widen response.frequencies" in lines[1]
    assert len(lines) == 2
    write_response(tmp_path, response)
    assert (tmp_path / "backbone_response.png").stat().st_size > 10_000
    # A frequency without a steady vibration has a row, too.
    (model,) = response.models
    (curve,) = model.curves
    lost = replace(curve.points[0], slip=np.full_like(curve.points[0].slip, np.nan))
    curve = replace(curve, points=(lost, *curve.points[1:]))
    models = (replace(model, curves=(curve,)),)
    write_response(tmp_path, replace(response, models=models, backbones=[]))
    rows = csv_rows(tmp_path / "response.csv")
    lost, *others = (row["active_length_joint_m"] for row in rows)
    assert lost == ""
    assert all(0.0 <= float(length) < 0.1 for length in others)
