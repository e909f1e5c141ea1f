"""The command fit: values found again, its files, the scene that it writes, and what it refuses."""

import json
import tomllib

import numpy as np
import pandas as pd
import pytest
from pictured import matrices_scene
from scene_texts import GOOD, with_changes, written

import skfem_joint as sj
from skfem_joint import __version__, cli
from skfem_joint.output.fits import curves_figure, residuals_figure
from skfem_joint.output.record import LIST
from skfem_joint.scene.rewriting import rewritten
from skfem_joint.structure.parameters import value_of

FILES = {
    "fit.json", "fit.png", "values.csv", "residuals.csv", "curve.csv", "residuals.png",
    "fitted.toml", "summary.json",
}  # fmt: skip
SCENE = with_changes(
    GOOD,
    ("friction = 0.7", "friction = 0.5 # a guess"),
    ("[time]", "[damping]\nratio = 0.002\n[time]"),
    ('["full", "reduced"]', '["full"]'),
)
FREE = ("joint[0].friction=0.1..1.0", "damping.ratio = 1e-4 .. 1e-2")
HEAD = "# relative_frequency_deviation: 1e-4\n# relative_damping_deviation: 3 %\n"


@pytest.fixture(scope="module")
def rows(tmp_path_factory):
    """Samples at friction 0.7 and ratio 0.0025."""
    path = written(tmp_path_factory.mktemp("true"), text=SCENE)
    true = sj.load_scene(path).changed({"joint[0].friction": 0.7, "damping.ratio": 0.0025})
    return rows_of(true, levels=8, up_to=0.5)


def rows_of(scene, **options):
    """Amplitude of the free end (mm), frequency and damping (%) on a scene's backbone."""
    system = scene.system()
    (curve,) = sj.backbone(system, **options)
    moved = curve.displacement[:, system.points.index("free_end")]
    return np.column_stack([1e3 * moved, curve.frequency, 100.0 * curve.damping_ratio])


def data(folder, rows, head="# point: free_end\n", name="measured.csv"):
    text = "".join(f"{x:.8g}, {f:.10g}, {z:.8g}\n" for x, f, z in rows)
    path = folder / name
    path.write_text(f"{HEAD}{head}amplitude (mm), frequency (Hz), damping (%)\n{text}")
    return path


def arguments(scene, files, out, *more, free=FREE):
    given = [text for file in files for text in ("--data", str(file))]
    given += [text for key in free for text in ("--free", key)]
    return ["fit", str(scene), *given, "--out", str(out), *more]


def fitted_in(out):
    return json.loads((out / "fit.json").read_text(encoding="utf-8"))


def test_values_are_found_and_all_files_written(tmp_path, rows, capsys):
    scene = written(tmp_path, text=SCENE)
    (tmp_path / "deep").mkdir()
    out = tmp_path / "deep" / "out"
    file = data(tmp_path, rows, "# point: free_end\n# highest: 0.2\n")
    assert cli.main(arguments(scene, [file], out)) == 0
    shown = capsys.readouterr().out
    assert "± deviation" in shown
    assert "95 % interval" in shown
    assert "curves were computed in" in shown
    assert {path.name for path in out.iterdir()} == {*FILES, LIST}

    found = fitted_in(out)
    assert found["version"] == __version__
    assert found["values"]["joint[0].friction"] == pytest.approx(0.7, rel=1e-3)
    assert found["values"]["damping.ratio"] == pytest.approx(0.0025, rel=2e-3)
    assert found["covariance"]["names"] == ["joint[0].friction", "damping.ratio"]
    deviations = np.sqrt(np.diag(found["covariance"]["matrix"]))
    assert deviations == pytest.approx([*found["deviations"].values()])
    assert (found["widened"], found["undetermined"]) == (1.0, [])

    values = pd.read_csv(out / "values.csv", index_col="name")
    assert [*values.index] == found["covariance"]["names"]
    assert ((values.lowest < values.best) & (values.best < values.highest)).all()
    intervals = np.array([*found["intervals"].values()])
    np.testing.assert_allclose(values[["lowest", "highest"]], intervals, rtol=1e-9)
    assert [*values.loc["joint[0].friction", ["lower_bound", "upper_bound"]]] == [0.1, 1.0]

    residuals = pd.read_csv(out / "residuals.csv")
    fitted = rows[:, 0] <= 0.2
    assert [*residuals.fitted] == fitted.tolist()
    assert 0 < fitted.sum() < fitted.size
    np.testing.assert_allclose(residuals.amplitude, 1e-3 * rows[:, 0], rtol=1e-6)
    assert ({*residuals.unit}, {*residuals.data}) == ({"m"}, {"measured.csv"})
    total = (residuals[["frequency_residual", "damping_residual"]][fitted] ** 2).to_numpy().sum()
    # Levels of the curve differ where compared samples count too.
    assert total == pytest.approx(found["sum_of_squares"], abs=0.02)

    curve = pd.read_csv(out / "curve.csv")
    assert len(curve) == 40
    ends = [*curve.amplitude.iloc[[0, -1]]]
    assert ends == pytest.approx((1e-3 * rows[0, 0], 1e-3 * rows[-1, 0]))
    for y, own in ((curve.frequency_Hz, rows[:, 1]), (curve.damping_ratio, 0.01 * rows[:, 2])):
        assert np.interp(1e-3 * rows[:, 0], curve.amplitude, y) == pytest.approx(own, rel=0.02)
    assert (curve.frequency_band_Hz > 0.0).all()

    text = (out / "fitted.toml").read_text(encoding="utf-8")
    assert "# a guess" in text
    lines = zip(scene.read_text().splitlines(), text.splitlines(), strict=True)
    changed = [old.split(" =")[0] for old, new in lines if old != new]
    assert changed == ["friction", "ratio"]
    structure = sj.load_scene(out / "fitted.toml").structure()
    assert {key: value_of(structure, key) for key in found["values"]} == found["values"]

    # The same command replaces its own files and keeps others.
    (out / "mine.txt").write_text("mine")
    assert cli.main(arguments(scene, [file], out)) == 0
    assert "which stay unless results replace them: mine.txt" in capsys.readouterr().out
    assert {path.name for path in out.iterdir()} == {*FILES, LIST, "mine.txt"}
    (out / "fitted.toml").write_text("mine too")
    assert cli.main(arguments(scene, [file], out)) == 2
    assert (out / "fitted.toml").read_text() == "mine too"


def test_offsets_are_drawn(tmp_path, rows):
    scene = written(tmp_path, text=SCENE)
    higher = np.add(rows, [0.0, 3.0, 0.0])
    head = "# point: free_end\n# offset: frequency\n"
    (tmp_path / "other").mkdir()  # files of the same name are told apart by their folders
    files = [data(tmp_path, rows, head), data(tmp_path / "other", higher, head)]
    out = tmp_path / "out"
    assert cli.main(arguments(scene, files, out, "-q")) == 0
    found = fitted_in(out)
    first, second = (f"offset of {path}: frequency" for path in files)
    assert found["offsets"] == pytest.approx({first: 0.0, second: 3.0}, abs=0.2)
    assert found["undetermined"] == []
    curve = pd.read_csv(out / "curve.csv")
    assert curve.frequency_Hz[curve.data == str(files[1])].iloc[0] == pytest.approx(
        higher[0, 1], abs=0.2
    )


def test_pictures_show_samples_curves_and_bands(tmp_path, rows):
    scene = sj.load_scene(written(tmp_path, text=SCENE))
    moved, frequency, damping = rows.T * np.array([[1.0], [1.0], [0.01]])
    arrays = {"amplitude (mm)": moved, "frequency": frequency, "damping": damping}
    omega = 2.0 * np.pi * frequency
    accelerations = {**arrays, "amplitude (m/s2)": 1e-3 * moved * omega**2}
    del accelerations["amplitude (mm)"]
    every = [
        sj.measured_curve(arrays, name="a", point="free_end", highest=0.15),
        sj.measured_curve(arrays, name="b", point="free_end", offset=["frequency"]),
        sj.measured_curve(accelerations, name="c", point="free_end"),
    ]
    found = sj.fit(scene, every, {"joint[0].friction": (0.1, 1.0)})
    figure = curves_figure(found, found.curves())
    labels = [panel.get_xlabel() for panel in figure.axes]
    assert labels[0] == "displacement amplitude of free_end, µm"
    assert labels[2] == "acceleration amplitude of free_end, m/s²"
    (legend,) = figure.legends
    names = [text.get_text() for text in legend.get_texts()]
    assert {"a", "a, not fitted", "b", "c", "model", "model of a", "its 95 % band"} <= {*names}
    assert len(set(names)) == len(names)
    assert all(panel.get_xscale() == "log" for panel in figure.axes)
    residuals_figure(found).draw_without_rendering()
    assert found.scene.joint[0].friction == found.values["joint[0].friction"]


INLINE = """\
joint = [{ on = "a", pressure = 50e6, friction = 0.5, gap = "a.csv" },
  { on = "b", pressure = { bolts = [
  { at = [0.1, 0.0], force = 1e3 }, # first
  { at = [0.2, 0.0], force = 1e3 },
] }, gap = { file = "b.csv", margin = 1e-3 } },
  { on = "c", gap = ["c.csv", { file = "d.csv" }] }, { on = "d", gap = 1e-6 }, { on = "e" }]
material.E = 2e11 # steel
mesh = { file = ["one.msh", "../two.msh"], scale = 1e-3 }
bolt = [{force = 1_000}, {force = 2e3}]
[sweep]
"mesh.file" = ["three.msh"]
"material.E" = [1, 2]
"joint[0].gap" = ["a.csv", "f.csv"]
"joint[3].gap" = [1e-6, 2e-6]
[[load]]
kind = "table"
file = "force.csv"
[material.regions.cover]
E = 3e11
"""
TABLES = """\
[[joint]]
friction = 0.5 # first
[[bolt]]
force = 8e3   # N

[mesh]
file = '/meshes/one.msh'
[[bolt]]
force = 9e3
"""


def test_texts_keep_all_but_the_values(tmp_path):
    values = {
        "joint[0].friction": 0.1,
        "joint[1].friction": 0.2,
        "joint[0].gap_scale": 2.0,
        "joint[1].pressure.bolts[1].force": 77.0,
        "material.E": 1e11,
        "material.regions.cover.E": 1.5e11,
        "bolt[0].force": 1234.5678901234567,
        "damping.mass": 3.0,
    }
    out = tmp_path / "a" / "out"
    text = rewritten(INLINE, values, tmp_path, out)
    assert "# first" in text
    assert "# steel" in text
    read, given = tomllib.loads(text), tomllib.loads(INLINE)
    first, second, third, *_ = given["joint"]
    first |= {"friction": 0.1, "gap": "../../a.csv", "gap_scale": 2.0}
    second |= {"friction": 0.2, "gap": {"file": "../../b.csv", "margin": 1e-3}}
    second["pressure"]["bolts"][1]["force"] = 77.0
    third["gap"] = ["../../c.csv", {"file": "../../d.csv"}]
    given["sweep"]["joint[0].gap"] = ["../../a.csv", "../../f.csv"]
    given["material"] = {"E": 1e11, "regions": {"cover": {"E": 1.5e11}}}
    given["bolt"][0]["force"] = 1234.5678901234567
    given["damping"] = {"mass": 3.0}
    given["mesh"]["file"] = ["../../one.msh", "../../../two.msh"]
    given["load"][0]["file"] = "../../force.csv"
    given["sweep"]["mesh.file"] = ["../../three.msh"]
    assert read == given

    text = rewritten(TABLES, {"bolt[0].force": 1.0, "bolt[1].force": 2.0}, tmp_path, out)
    assert "# N" in text
    assert tomllib.loads(text) == {
        "joint": [{"friction": 0.5}],
        "bolt": [{"force": 1.0}, {"force": 2.0}],
        "mesh": {"file": "/meshes/one.msh"},
    }


BOLTS = """pressure = { bolts = [
  { at = [0.03, 0.0], force = 20e3, head_radius = 0.01, spreading_angle = 45.0 },  # held
  { at = [0.07, 0.0], force = 20e3, head_radius = 0.01, spreading_angle = 45.0 },
], reach = 0.02 }"""


def test_one_value_of_several_bolts_goes_into_each(tmp_path):
    scene = written(tmp_path, ("pressure = 50e6", BOLTS), text=SCENE)
    key = "joint[0].pressure.bolts[*].force"
    true = sj.load_scene(scene).changed({key.replace("*", str(k)): 24e3 for k in range(2)})
    file = data(tmp_path, rows_of(true, levels=5, up_to=0.3))
    out = tmp_path / "out"
    assert cli.main(arguments(scene, [file], out, free=[f"{key}=5e3..50e3"])) == 0
    found = fitted_in(out)["values"]
    assert found == {key: pytest.approx(24e3, rel=2e-3)}
    assert value_of(sj.load_scene(out / "fitted.toml").structure(), key) == found[key]
    text = (out / "fitted.toml").read_text(encoding="utf-8")
    assert text.count(str(found[key])) == 2
    assert "# held" in text


KEY = "joint[0].friction"


@pytest.mark.parametrize(
    ("free", "words"),
    [
        *(
            ([text], "must be KEY=LOW..HIGH")
            for text in (KEY, f"{KEY}=0.1", f"{KEY}=a..b", "=1..2")
        ),
        ([f"{KEY}=0..1"] * 2, f"--free: found '{KEY}' twice"),
        ([f"{KEY}=0.1..1", "joint[*].friction=0.1..1"], "varies the same number"),
    ],
)
def test_wrong_free_values_end_with_a_sentence(tmp_path, rows, free, words, capsys):
    scene, file = written(tmp_path, text=SCENE), data(tmp_path, rows)
    assert_refused(scene, [file], words, capsys, free=free)


def assert_refused(scene, files, words, capsys, **free):
    out = scene.parent / "out"
    assert cli.main(arguments(scene, files, out, **free)) == 2
    assert words in capsys.readouterr().err
    assert not out.exists()


def test_data_and_scenes_that_no_fit_can_have_end_with_a_sentence(tmp_path, rows, capsys):
    scene, file = written(tmp_path, text=SCENE), data(tmp_path, rows)
    heads = "# point: free_end\n# unit: mile\n", "# mode: 0\n"
    mile, zero = (data(tmp_path, rows, head, name=f"{k}.csv") for k, head in enumerate(heads))
    for words in ("unit: found 'mile'", "mode: found '0'"):  # all that is wrong is said at once
        assert_refused(scene, [mile, zero], words, capsys)
    assert_refused(scene, [file, file], f"--data: found {file} twice, must be once", capsys)
    slow = written(tmp_path, ("cycles = 3", "cycles = 3\nquasi_static = true"), text=SCENE)
    assert_refused(slow, [file], "fit computes vibration", capsys)
    assert_refused(matrices_scene(tmp_path), [file], "must be one with a mesh", capsys)


def test_what_is_read_is_not_replaced(tmp_path, rows, capsys):
    scene = written(tmp_path, text=SCENE).rename(tmp_path / "fitted.toml")
    before = scene.read_text()
    assert cli.main(arguments(scene, [data(tmp_path, rows, name="curve.csv")], tmp_path)) == 2
    error = capsys.readouterr().err
    assert "fitted.toml: is read, and a file of the results would replace it" in error
    assert "curve.csv: is read" in error
    assert scene.read_text() == before


def test_offsets_of_all_data_are_determined_as_well_as_noise_allows(tmp_path, rows):
    scene = sj.load_scene(written(tmp_path, text=SCENE))
    frequency = 1.0001 * rows[:, 1] + 3.0
    arrays = {"amplitude (mm)": rows[:, 0], "frequency": frequency}
    given = {"point": "free_end", "offset": "frequency", "relative_frequency_deviation": 1e-4}
    found = sj.fit(scene, sj.measured_curve(arrays, **given), {"joint[0].friction": (0.1, 1.0)})
    assert found.undetermined == ()
    # One offset alone would be known to the deviation of a sample over the root of their number.
    alone = 1e-4 * frequency.mean() / np.sqrt(frequency.size)
    assert alone < found.deviations[found.problem.names[1]] < 4.0 * alone


def test_profiles_are_written_beside_the_other_files(tmp_path, rows, capsys):
    scene, out = written(tmp_path, text=SCENE), tmp_path / "out"
    given = arguments(scene, [data(tmp_path, rows)], out, "--profile", free=FREE[:1])
    assert cli.main(given) == 0
    assert "95 % interval by profile" in capsys.readouterr().out
    found = pd.read_csv(out / "profiles.csv")
    assert {*found.name} == {KEY}
    assert found.excess_of_squares.min() == 0.0 < 3.84 < found.excess_of_squares.max()
