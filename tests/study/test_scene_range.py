"""Scenes of a range: one model for all of them, made once, whose points say what they are."""

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from joint_scenes import bar_scene, harmonic, joint
from scene_texts import csv_rows

import skfem_joint as sj
from skfem_joint.output.damping import write_response
from skfem_joint.study.scene_range import of_scene, point_of, range_model, served_scene
from skfem_joint.study.scene_response import RESPONSE_ROWS, scene_response

RANGE = {"slip": [0.2, 0.8], "frequency": [1000.0, 2500.0], "joint[0].friction": [0.4, 1.0]}
PEAK = "reduced.peak_displacement_m.free_end"
ENERGY = "reduced.friction_energy_per_cycle_J"


def scene(
    friction: float = 0.6, amplitude: float = 150e3, frequency: float = 1500.0, **changes: Any
) -> sj.Scene:
    """Bar that lies on a joint of forty elements."""
    values = {
        "joint": [joint(friction=friction, law="coulomb")],
        "load": [harmonic(amplitude=amplitude, frequency=frequency)],
        "time": {"cycles": 2, "steps_per_cycle": 50},
        "damping": {"ratio": 0.02},
        "reduction": {"range": RANGE, "modes": 8},
    }
    return bar_scene("reduced", bar="short_lap_joint", **values | changes)


VALUES = [(0.6, 150e3, 1500.0), (0.8, 250e3, 1200.0), (0.5, 100e3, 2200.0)]
INSIDE = [scene(*values) for values in VALUES]
OUTSIDE = scene(0.6, 150e3, 2600.0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("range")


@pytest.fixture(scope="module")
def rows(folder):
    """Rows of a sweep of scenes inside and outside of the range."""
    return swept([*INSIDE, OUTSIDE], folder)


def swept(scenes: list[sj.Scene], folder: Path) -> list[sj.Row]:
    with ThreadPoolExecutor(1) as executor:
        found = sj.sweep(scenes, executor, folder / "rows.jsonl")
        return sorted(found, key=lambda row: row.number)


@pytest.fixture(scope="module")
def model(rows, folder):
    return range_model(served_scene(INSIDE[0]), folder)


def test_a_sweep_makes_one_model_and_keeps_it_in_its_folder(rows, folder):
    assert not any(row.failure for row in rows)
    assert [path.name for path in folder.glob("range_*.npz")] == [
        served_scene(other).file(folder).name for other in INSIDE[:1]
    ]
    assert len({served_scene(other).mark for other in [*INSIDE, OUTSIDE]}) == 1


def test_rows_are_points_of_the_model_and_state_their_errors(rows, model):
    for row, (friction, amplitude, frequency) in zip(rows, VALUES, strict=False):
        # By hand: the middle of friction is sqrt(0.4 * 1.0), the loads of the model are 1 N.
        limits = {"joint": friction / np.sqrt(0.4)}
        point = sj.at(model, frequency=frequency, level=amplitude, limits=limits)
        run = sj.integrate(point, cycles=2, steps_per_cycle=50)
        assert row.results[PEAK] == pytest.approx(run.cycles.peak[-1].max(), rel=1e-9)
        assert row.results[ENERGY] == pytest.approx(run.cycles.friction[-1], rel=1e-6)
        stated = row.results["reduced.estimated_error.friction_energy_per_cycle.total"]
        assert stated == pytest.approx(sj.estimate(run).of("total", "friction_energy"), rel=1e-3)
        assert not [text for text in row.notes if "does not serve" in text]
        # Eight modes were given, which are few.
        (note,) = [text for text in row.notes if "range" in text]
        assert note.startswith("The reduced model for the range was made for an accuracy of 1.00%")


def test_a_scene_outside_has_a_model_of_its_own_and_says_so(rows):
    (warning,) = [text for text in rows[-1].notes if "range" in text]
    assert "found frequency 2600 Hz, outside the range" in warning
    own = sj.run_scene(OUTSIDE.changed(reduction={"range": None})).models["reduced"].run
    assert rows[-1].results[PEAK] == pytest.approx(own.cycles.peak[-1].max(), rel=1e-9)


def test_a_sweep_taken_up_again_loads_the_model(rows, folder):
    file = served_scene(INSIDE[0]).file(folder)
    range_model.cache_clear()
    made, new = file.stat().st_mtime_ns, scene(0.7, 160e3, 2000.0)
    again = swept([*INSIDE, new], folder)
    assert file.stat().st_mtime_ns == made
    assert [row.results for row in again[:3]] == [row.results for row in rows[:3]]
    assert again[3].results["reduced.dofs"] == again[0].results["reduced.dofs"]
    assert not again[3].failure


def test_gross_slip_is_refused_and_has_a_model_of_its_own(folder, model):
    study = sj.run_scene(scene(amplitude=450e3), folder=folder, described=False)
    assert any("does not serve this scene" in text for text in study.notes)
    assert study.models["reduced"].run.system.serves is None


def test_an_accuracy_that_the_range_does_not_meet_gives_a_model_of_its_own(folder, tmp_path):
    asked = scene(accuracy={"displacement": 1e-4})
    assert served_scene(asked).mark != served_scene(INSIDE[0]).mark  # made for that accuracy
    rough = range_model(served_scene(INSIDE[0]), folder)
    sj.save(rough, served_scene(asked).file(tmp_path))
    study = sj.run_scene(asked, folder=tmp_path)
    assert any("errs by an estimated" in text for text in study.notes)
    assert study.models["reduced"].run.system.serves is None


def test_a_point_of_a_range_has_no_error_by_the_mesh(model):
    point = sj.at(model, frequency=1500.0, level=150e3)
    run = sj.integrate(point, cycles=1, steps_per_cycle=50)
    with pytest.raises(sj.InputError, match="finer: found a run of a point of a range"):
        sj.estimate(run, finer=INSIDE[0].system())


def test_the_model_as_if_made_of_a_scene_is_the_same(model):
    """Its level 1 and factor 1 are the scene's: a theorem of scaling."""
    for inside in INSIDE:
        whole, point = of_scene(inside, model), point_of(inside, model)
        same = sj.at(whole, frequency=1.0 / inside.cycle_period, level=1.0)
        assert same.contact.w == pytest.approx(point.contact.w, rel=1e-12)
        assert same.contact.beta == pytest.approx(point.contact.beta, rel=1e-12)
        time = inside.cycle_period * np.array([0.1, 0.3, 0.8])
        assert same.load_amplitudes(time) == pytest.approx(point.load_amplitudes(time), rel=1e-9)


def test_a_response_by_one_model_is_as_far_from_the_full_one_as_it_says(model):
    whole, frequencies = of_scene(INSIDE[0], model), np.array([1200.0, 2200.0])
    options: dict[str, Any] = {"steps_per_cycle": 50, "refined": False}
    (found,) = sj.response(whole, frequencies, **options)
    (full,) = sj.response(INSIDE[0].system(), frequencies, estimated=False, **options)
    error = np.abs(found.column("amplitude") / full.column("amplitude") - 1.0).ravel()
    assert (error < 2.0 * found.column("model_error") + 1e-3).all()


def test_the_table_of_a_response_has_the_errors_of_its_model(model, tmp_path):
    frequencies = {"from": 1300.0, "to": 2000.0, "points": 2}
    asked = scene(response={"frequencies": frequencies})
    sj.save(model, served_scene(asked).file(tmp_path))
    response = scene_response(asked, rows=sj.Rows(tmp_path / "rows.jsonl", RESPONSE_ROWS))
    write_response(tmp_path, response)
    written = [float(row["model_error"]) for row in csv_rows(tmp_path / "response.csv")]
    assert len(written) >= 2
    assert written == pytest.approx(response.models[0].curves[0].column("model_error"), rel=1e-6)


def test_a_response_says_where_a_joint_slips_as_a_whole_and_what_is_outside(model):
    whole = of_scene(INSIDE[0], model)
    (curve,) = sj.response(whole, np.array([1500.0]), [1.0], refined=False, steps_per_cycle=50)
    assert curve.points[0].failure is None
    with pytest.raises(sj.ConvergenceError, match="a joint slips as a whole"):
        sj.response(whole, np.array([1500.0]), [10.0], refined=False, steps_per_cycle=50)
    both = sj.response(whole, np.array([1500.0]), [10.0, 1.0], refined=False, steps_per_cycle=50)
    assert [curve.found for curve in both] == [False, True]  # the first costs no other level
    assert both[0].gross == pytest.approx([1500.0])
    assert both[1].peak == pytest.approx(curve.peak)
    with pytest.raises(sj.InputError, match="found frequency 2600 Hz, outside the range"):
        sj.response(whole, np.array([1500.0, 2600.0]))
    with pytest.raises(sj.InputError, match="made for one point of its range"):
        sj.response(sj.at(whole, frequency=1500.0, level=1.0), np.array([1500.0]))
