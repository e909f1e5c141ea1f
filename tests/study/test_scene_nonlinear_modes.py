"""Nonlinear modes of a scene are those of Python, beside its slow curves, and are written."""

import json
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest
from joint_scenes import bar_scene, joint, scene_file
from scene_texts import csv_rows

import skfem_joint as sj
from skfem_joint.cli import main
from skfem_joint.output.nonlinear_modes import nonlinear_lines, write_nonlinear_modes
from skfem_joint.study.scene_backbone import nonlinear_table, scene_nonlinear_modes

LEVELS = [2.2e-4, 3.2e-4, 4.5e-4]


#: Lengths and numbers of elements of joint, bar and tip, and density of the tip.
HEAVY_TIP = ("joint", 0.1, 2), ("linear", 0.48, 3), ("tip", 0.02, 1), 320e3
UNIFORM = ("joint", 0.1, 6), ("linear", 0.48, 12), ("tip", 0.02, 1), 8e3


def bar(parts: Sequence[Any] = HEAVY_TIP, **table: object) -> sj.Scene:
    """Bar on springs in series with the friction of a few elements."""
    *strips, density = parts
    regions = {"regions": {"tip": {"density": density}}}
    return bar_scene(
        "full",
        bar=sj.build_bar(strips, {"fixed": 0.0, "free_end": 0.6}),
        material={"E": 200e9, "density": 8000.0} | regions,
        joint=[joint(law="coulomb", normal_force="consistent", tangential_stiffness=1e13)],
        damping={"ratio": 0.002},
        time={"cycles": 1, "steps_per_cycle": 100},
        reduction={"reference": "static"},
        backbone={"levels": 8, "up_to": 0.9},
        nonlinear_modes={"amplitudes": LEVELS, "at": "free_end", "confirm": False} | table,
    )


def test_a_scene_has_the_modes_of_python():
    scene = bar().changed(backbone={"ring_down": 12})
    found = scene_nonlinear_modes(scene)
    (slow,) = sj.backbone(scene.system(), levels=8, up_to=0.9)
    model = sj.reduce(scene.system(), curve=slow)
    (mode,) = sj.nonlinear_modes(model, amplitudes=LEVELS, at="free_end", confirm=False)
    for name in ("frequency", "damping_ratio", "harmonics"):
        np.testing.assert_array_equal(getattr(found.curves[1], name), getattr(mode, name))
    assert mode.friction_damping[-1] > mode.viscous_damping[-1]
    assert found.curves[1].friction_work.sum(axis=1) == pytest.approx(mode.losses.friction)
    assert set(mode.notes) <= set(found.notes)
    down = sj.ring_down(model, mode, 12, 100)  # begins on the motion of the highest level
    np.testing.assert_array_equal(found.model.ring_downs[0].amplitude, down.amplitude)


def test_a_small_full_model_and_a_range_of_amplitudes_are_served():
    table = {"amplitudes": {"from": 1e-5, "to": 4e-5, "points": 3}, "model": "full"}
    found = scene_nonlinear_modes(bar(**table))
    assert nonlinear_table(found.scene).levels == pytest.approx([1e-5, 2e-5, 4e-5])
    curve = found.curves[1]
    assert curve.displacement[:, 0] == pytest.approx([1e-5, 2e-5, 4e-5])
    assert curve.harmonics.shape[2] == found.scene.system().n
    assert curve.frequency == pytest.approx(curve.stuck_frequency, rel=1e-7)  # it sticks


def test_table_picture_and_page_have_the_curves_beside(tmp_path):
    found = scene_nonlinear_modes(bar(confirm=True, amplitudes=[4e-5, *LEVELS]))
    files = {path.name for path in write_nonlinear_modes(tmp_path, found)}
    assert files == {"nonlinear_modes.csv", "nonlinear_modes.png", "summary.json"}
    assert (tmp_path / "nonlinear_modes.png").stat().st_size > 10_000
    rows = csv_rows(tmp_path / "nonlinear_modes.csv")
    curve = found.curves[1]
    for name in ("damping_ratio", "quasi_static_damping_ratio"):  # the same where all stick
        assert float(rows[0][name]) == pytest.approx(curve.viscous_damping[0], rel=1e-6)
    judged = [k for k, row in enumerate(rows) if row["time_steps_frequency_Hz"]]
    assert judged == curve.marched.levels.tolist()
    (told,) = json.loads((tmp_path / "summary.json").read_text())["models"]["reduced"]["modes"]
    assert told["estimated_error"]["harmonics"]["frequency"] == curve.estimated["frequency"]
    assert told["harmonics"] == curve.series.highest
    page = sj.write_report(tmp_path).read_text(encoding="utf-8")
    assert "Modes over the amplitude of their first harmonic" in page
    assert nonlinear_lines(found)[1] in page


def test_a_mode_that_ends_early_is_written_with_the_reason_and_status_3(tmp_path, capsys):
    """A uniform bar, asked for an amplitude that is more steps away than a branch may have."""
    file = scene_file(tmp_path, bar(UNIFORM, amplitudes=[1e-4, 1e19], confirm=True))
    out = tmp_path / "out"
    assert main(["check", str(file)]) == 0
    assert (
        main(["nonlinear-modes", str(file), "--out", str(out)]) == sj.ConvergenceError.exit_status
    )
    assert (
        "Note: nonlinear_modes: mode 1 is not found at 1 of 2 amplitudes" in capsys.readouterr().out
    )
    (row,) = csv_rows(out / "nonlinear_modes.csv")
    assert float(row["amplitude_m"]) == pytest.approx(1e-4)
    text = file.read_text(encoding="utf-8")
    file.write_text(text[: text.index("[nonlinear_modes]")], encoding="utf-8")
    assert main(["nonlinear-modes", str(file), "--out", str(out)]) == sj.InputError.exit_status
    assert "nonlinear_modes: missing" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("table", "words"),
    [
        ({"amplitudes": [2e-4, 1e-4]}, "nonlinear_modes.amplitudes"),
        ({"amplitudes": {"from": 2.0, "to": 1.0}}, "nonlinear_modes.amplitudes.to"),
        ({"model": "small"}, "nonlinear_modes.model"),
        ({"modes": [0]}, r"nonlinear_modes.modes\[0\]"),
    ],
)
def test_wrong_input_is_refused_by_its_key(table, words):
    with pytest.raises(sj.InputError, match=words):
        scene_nonlinear_modes(bar(**table))
