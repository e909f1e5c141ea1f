"""Pictures of a structure before it is run: what they contain, their files, and refusals."""

from contextlib import chdir
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bodies import two_bars
from drawing import draws
from pictured import matrices_scene
from scene_texts import written

from skfem_joint import cli
from skfem_joint.output.drawing.preview import Preview, joint_marks, preview_of
from skfem_joint.output.drawing.preview_picture import preview_figure, write_preview
from skfem_joint.scene import load_scene

EXAMPLES = Path(__file__).parents[2] / "examples"
PNG = b"\x89PNG\r\n\x1a\n"


SCENES = ["structure_harmonic", "plate_bolts", "two_plates",
          pytest.param("solid_lap_joint", marks=draws)]  # fmt: skip


def texts_of(figure):
    """Texts of a figure, its labels among them."""
    return [text.get_text() for panel in (figure, *figure.axes) for text in panel.texts]


def changed(folder: Path, name: str, *changes: tuple[str, str]) -> Path:
    """File of an example with some of its text exchanged."""
    text = (EXAMPLES / f"{name}.toml").read_text(encoding="utf-8")
    return written(folder, *changes, text=text)


@pytest.fixture(scope="module")
def previews():
    """Previews of examples by name, each made once."""
    made = {}

    def of(name):
        if name not in made:
            made[name] = preview_of(load_scene(EXAMPLES / f"{name}.toml"))
        return made[name]

    return of


@pytest.mark.parametrize("name", SCENES)
def test_each_joint_support_load_and_bolt_is_drawn_and_labelled(name, previews):
    preview, scene = previews(name), load_scene(EXAMPLES / f"{name}.toml")
    structure, support = preview.structure, scene.support
    held = {*support.fixed, *support.fixed_x, *support.fixed_y, *support.fixed_z}
    assert [mark.name for mark in preview.of_kind("joint")] == [j.on for j in scene.joint]
    assert {mark.name for mark in preview.of_kind("support")} == held
    assert [mark.name for mark in preview.of_kind("load")] == [load.on for load in scene.load]
    in_joints = [bolt for joint in structure.joints
                 for bolt in getattr(joint.pressure, "bolts", ())]  # fmt: skip
    assert len(preview.of_kind("bolt")) == len(scene.bolt) + len(in_joints)
    for mark in preview.marks:
        assert np.all(mark.at >= structure.nodes.min(axis=0) - 1e-9)
        assert np.all(mark.at <= structure.nodes.max(axis=0) + 1e-9)
    figure = preview_figure(preview)
    assert preview.title in texts_of(figure)
    assert all(mark.text in texts_of(figure) for mark in preview.marks)
    assert any("Arrows show loads in their positive direction." in t for t in texts_of(figure))
    titles = [f"{axes.get_xlabel()} {axes.get_title()}" for axes in figure.axes]
    assert any("pressure on the joints, MPa" in title for title in titles)
    assert any(title.startswith(("x, mm", "position along the bar, mm")) for title in titles)


def test_what_labels_say(previews):
    def texts(name):
        return {mark.name: mark.text for mark in previews(name).marks}

    bar, plate, solid = map(texts, ("structure_harmonic", "plate_bolts", "solid_lap_joint"))
    assert bar["joint"] == "joint joint\non a rigid base\n50 MPa, friction 0.7"
    assert bar["free_end"] == "load free_end\npeak 87.5 kN\nharmonic 500 Hz"
    assert bar["junction"] == "point junction"
    assert plate["joint"].startswith("joint joint\non a rigid base\n0 to ")
    assert plate["joint.bolts[1]"] == "bolt 2 of joint\nforce 20 kN"
    assert solid["bolt[0]"] == "bolt 1\nhead_1 to nut_1\nclamp force 20 kN"
    supports = [mark.text for mark in previews("solid_lap_joint").of_kind("support")]
    assert supports == ["support lower_end\nheld in y, z",
                        "support upper_end\nheld in all directions"]  # fmt: skip


def test_pressures_of_a_joint_are_those_of_its_contact_points(previews):
    preview = previews("solid_lap_joint")
    (patch,), (mark,) = preview.structure.patches, preview.of_kind("joint")
    assert mark.pressure.shape == mark.cells.shape
    assert mark.pressure.max() == pytest.approx((patch.normal_force / patch.area).max())
    (even,) = previews("structure_harmonic").of_kind("joint")
    assert np.all(even.pressure == 50e6)


ON, ALONG = 'on = "free_end"\n', "direction = [1.0, 0.0]"


@pytest.mark.parametrize(
    ("old", "new", "expected", "says"),
    [
        (ALONG, 'quantity = "pressure"', (-1.0, 0.0), "pressure peak 14 kPa"),
        (
            ALONG,
            'quantity = "traction"\ndirection = [0.0, 2.0]',
            (0.0, 1.0),
            "traction peak 14 kPa",
        ),
        (ALONG, "direction = [-1.0, 0.0]", (-1.0, 0.0), "\npeak 14 kN"),
        (ON + ALONG, 'base = "y"', (0.0, 1.0), "load base along y\npeak 1.4e+04 m/s2"),
    ],
)
def test_arrows_run_along_loads(old, new, expected, says, tmp_path):
    preview = preview_of(load_scene(changed(tmp_path, "plate_bolts", (old, new))))
    (load,) = preview.of_kind("load")
    np.testing.assert_allclose(load.direction, expected, atol=1e-12)
    assert says in load.text
    if "base" in new:  # on its supports
        assert load.at[0] == pytest.approx(0.0)
    preview_figure(preview)


def test_bars_on_each_other_are_drawn_apart():
    structure = two_bars()
    marks = tuple(joint_marks(structure))
    figure = preview_figure(Preview("two bars", structure, marks))
    bars = figure.axes[0].collections[0].get_paths()
    assert len({path.vertices[:, 1].min() for path in bars}) == 2
    assert any("The thickness of bars is not to scale." in text for text in texts_of(figure))
    assert marks[0].text.split("\n")[1] == "against lower_joint"


def test_slender_plates_from_the_side_are_enlarged_and_the_axis_stays_true(tmp_path):
    path = changed(
        tmp_path, "two_plates",
        ("two_plates.msh", "two_plates_side.msh"),
        ('on = "upper_joint"\nagainst = "lower_joint"',
         'on = "upper_contact"\nagainst = "lower_contact"'),
        ('fixed = ["upper_end"]', 'fixed = ["upper_end"]\nfixed_y = ["lower_end"]'),
    )  # fmt: skip
    preview = preview_of(load_scene(path))
    (joint,) = preview.of_kind("joint")
    assert joint.cells.shape[1] == 2
    assert len(preview.of_kind("support")) == 2
    figure = preview_figure(preview)
    assert any(
        "Lengths along y are drawn larger than along x." in text for text in texts_of(figure)
    )
    figure.canvas.draw()
    ticks = [label.get_text() for label in figure.axes[0].get_yticklabels()]
    assert {"0", "10"} <= set(ticks)


@draws
@pytest.mark.parametrize("quantity", ["pressure", "force along the view", "base"])
def test_loads_on_solids(quantity, tmp_path):
    changes = {
        "pressure": ("direction = [1.0, 0.0, 0.0]", 'quantity = "pressure"'),
        "force along the view": ("[1.0, 0.0, 0.0]", "[0.45, -0.75, 0.55]"),
        "base": ('on = "lower_end"\ndirection = [1.0, 0.0, 0.0]', 'base = "z"'),
    }
    given = ('pressure = "preload"', "pressure = 1e6")
    path = changed(tmp_path, "solid_lap_joint", changes[quantity], given)
    text = path.read_text(encoding="utf-8")
    start, end = text.index("[[bolt]]"), text.index("[damping]")
    path.write_text(text[:start] + text[end:], encoding="utf-8")
    preview = preview_of(load_scene(path))
    assert not preview.of_kind("bolt")
    assert len(preview.of_kind("load")) == 1
    assert len(preview_figure(preview).axes) == 2  # solids, the colours


def test_the_command_writes_a_picture_beside_nothing_else(tmp_path, capsys):
    """By default in the folder where it is called."""
    with chdir(tmp_path):
        assert cli.main(["preview", str(EXAMPLES / "structure_harmonic.toml")]) == 0
    said = capsys.readouterr().out
    assert [file.name for file in tmp_path.iterdir()] == ["structure_harmonic.png"]
    assert (tmp_path / "structure_harmonic.png").read_bytes().startswith(PNG)
    assert "Written to structure_harmonic.png" in said
    assert "joint: " in said


def test_an_existing_file_is_replaced_only_on_request(tmp_path, capsys):
    scene, out = str(EXAMPLES / "structure_harmonic.toml"), tmp_path / "own.png"
    out.write_text("mine", encoding="utf-8")
    assert cli.main(["preview", scene, "--out", str(out)]) == 2
    assert "--overwrite" in capsys.readouterr().err
    assert out.read_text(encoding="utf-8") == "mine"
    assert cli.main(["preview", scene, "--out", str(out), "--overwrite"]) == 0
    assert out.read_bytes().startswith(PNG)


@pytest.mark.parametrize("out", ["picture.pdf", "picture", "missing/picture.png"])
def test_names_that_no_picture_can_have(out, tmp_path, capsys):
    scene = str(EXAMPLES / "structure_harmonic.toml")
    assert cli.main(["preview", scene, "--out", str(tmp_path / out)]) == 2
    assert "picture" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_a_scene_of_matrices_has_nothing_to_draw(tmp_path, capsys):
    scene, out = matrices_scene(tmp_path), tmp_path / "scene.png"
    assert cli.main(["preview", str(scene), "--out", str(out)]) == 2
    assert "nothing to draw" in capsys.readouterr().err
    assert not out.exists()


def test_names_are_no_formulas(tmp_path, previews):
    preview = replace(previews("structure_harmonic"), title="costs $5 and $6_")
    path = write_preview(tmp_path / "own.png", preview)
    assert path.read_bytes().startswith(PNG)
