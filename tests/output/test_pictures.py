"""Pictures of joints show what they are given, and no missing library ends the program silently."""

import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest
from bodies import structure
from drawing import draws
from numpy.typing import NDArray
from pictured import BOXES, JOINT, bar, bars, blocks, box, lap, pulled, side

import skfem_joint as sj
from skfem_joint.output.drawing import pictures
from skfem_joint.output.series import faces_of, write_series

INCLINED = (3.0, 4.0, 0.0)
VARIABLE = "VTK_DEFAULT_OPENGL_WINDOW"


def share_of(pixels: NDArray[np.float64], colour: str) -> float:
    """Share of a picture's pixels that have about a colour, lit or in shade."""
    wanted = np.array(matplotlib.colors.to_rgb(colour))
    close = np.linalg.norm(pixels[..., :3] - wanted, axis=-1) < 0.12
    return float(close.mean())


@draws
@pytest.mark.parametrize("build", [lap, bars, blocks])
def test_a_still_shows_stick_slip_and_no_contact(tmp_path, build):
    made = build()
    frames = pulled(made, ("full", "reduced"))
    nodes = made.patches[0].nodes
    for field in frames.fields:  # half of the joint slips
        field.slip_state[:, nodes] = made.nodes[nodes, 0] > made.nodes[nodes, 0].mean()
    pictures.still(tmp_path / "a.png", frames)
    pixels = matplotlib.image.imread(tmp_path / "a.png")
    for colour in pictures.STATES.values():
        assert share_of(pixels, colour) > 0.005
    for field in frames.fields:
        field.slip_state[:, nodes] = 0
    pictures.still(tmp_path / "b.png", frames)
    stuck = matplotlib.image.imread(tmp_path / "b.png")
    # Only the legend's patch is left of "slip".
    bar_pixels = share_of(stuck, pictures.STATES["slip"]) * stuck[..., 0].size
    assert bar_pixels < 0.24 / 3 * stuck.shape[1] * 60
    assert sorted(p.name for p in tmp_path.iterdir()) == ["a.png", "b.png"]


@pytest.mark.parametrize("side", ["left", "bottom", "back"])
def test_the_face_of_a_joint_is_shown_as_large_as_it_is(side):
    """At a right angle, wherever it is on the solid, and not mirrored."""
    mesh = sj.build_box([("all", 0.1, 2)], (0.05, 0.02), (2, 2))
    frames = pulled(structure(mesh, [replace(JOINT, on=side)], ["right"]))
    (block,) = faces_of(frames.structure)
    bodies, face = pictures.views_of(frames, factor=0.0)
    assert (bodies.label, face.label) == ("", block.label)
    np.testing.assert_allclose(face.axes @ face.axes.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(face.axes) == pytest.approx(1.0, rel=1e-12)
    seen = np.ptp(np.asarray(block.grid.points) @ face.axes.T, axis=0)
    assert seen[2] < 1e-12
    assert sorted(seen) == pytest.approx(sorted(np.ptp(block.grid.points, axis=0)), abs=1e-12)
    np.testing.assert_allclose(face.high - face.low, seen[:2], atol=1e-12)


@pytest.mark.parametrize(("kind", "order"), BOXES)
def test_the_outline_of_an_even_face_is_its_border(kind, order):
    """Whichever way its facets are numbered; no fragments of element edges inside."""
    for build in (box, blocks):
        made = build(kind, order)
        for block in faces_of(made):
            surface = block.grid.extract_surface(algorithm="dataset_surface")
            faces = surface.regular_faces.copy()
            faces[::2] = faces[::2, ::-1]
            surface.regular_faces = faces
            border = surface.extract_feature_edges(
                feature_edges=False, manifold_edges=False, non_manifold_edges=False
            )
            drawn = pictures.outline(surface)
            assert border.n_cells > 0
            assert drawn.n_cells == border.n_cells
            assert np.isin(drawn["vtkOriginalPointIds"], border["vtkOriginalPointIds"]).all()


def test_the_frame_that_is_drawn_says_why_it_was_taken():
    frames = pulled(lap())
    state, nodes = frames.fields[0].slip_state, lap().patches[0].nodes
    state[:, nodes] = 0
    assert pictures.frame_to_show(frames) == (2, "largest displacement")
    state[0, nodes] = 1  # before the run has settled
    state[7, nodes[: nodes.size // 2 + 1]] = 1
    assert pictures.frame_to_show(frames) == (7, "slip is fastest")
    state[6] = state[7]
    for first in (6, 7):
        frames.fields[0].slip[first:, nodes] += 1e-3
    assert pictures.frame_to_show(frames) == (6, "slip is fastest")
    state[6:8, nodes[1:]] = 0  # after a pulse
    assert pictures.frame_to_show(frames) == (0, "slip is fastest")
    state[:, nodes] = 0
    frames.fields[0].displacement[:] = 0.0
    assert pictures.frame_to_show(frames) == (0, "nothing moves")


@draws
def test_a_gif_has_the_frames_asked_for(tmp_path):
    from PIL import Image

    path = tmp_path / "a.gif"
    pictures.animation(path, pulled(side()), most=5)
    with Image.open(path) as picture:
        assert picture.n_frames == 5
        first = np.asarray(picture.convert("RGB"), dtype=float)
        picture.seek(1)
        second = np.asarray(picture.convert("RGB"), dtype=float)
    assert np.abs(first - second).max() > 50.0
    assert list(tmp_path.iterdir()) == [path]


@draws
@pytest.mark.parametrize("build", [lap, lambda: bar(INCLINED)])
def test_bodies_and_the_mark_on_the_load_move_with_the_frame(build):
    frames = pulled(build())
    with pictures._picture(frames) as picture:
        drawn = [each for panel in picture.panels for each in panel.blocks]
        before = max(block.grid.bounds[1] for block in (each.block for each in drawn))
        ((mark, _),) = picture.marks
        for frame in (3, 2):
            picture.show(frame)
            assert mark.get_xdata() == pytest.approx([1e3 * frames.times[frame]])
            expected = 60.0 * np.sin(2 * np.pi * 250 * frames.times[frame])
            assert mark.get_ydata() == pytest.approx([expected], abs=0.05)
        right = max(each.surface.bounds[1] for each in drawn)
    moved = frames.structure.body.in_space(frames.fields[0].displacement[2])[:, 0].max()
    assert right == pytest.approx(before + pictures.warp_factor(frames) * moved)


@pytest.mark.parametrize("largest", [1e-9, 3.3e-5, 4e-5, 1.0])
@pytest.mark.parametrize("build", [lap, lambda: bar((0.0, 0.0, 1.0))])
def test_the_largest_displacement_is_drawn_as_a_fiftieth_to_a_twentieth_of_the_length(
    build, largest
):
    frames = pulled(build())
    u = frames.fields[0].displacement
    u *= largest / np.abs(u).max()
    factor, length = pictures.warp_factor(frames), np.ptp(build().positions, axis=0).max()
    assert 0.4 * 0.05 * length <= factor * largest * (1 + 1e-12) <= 0.05 * length * (1 + 1e-9)
    assert f"{factor:.0e}"[0] in "125"
    u *= 0.0  # nothing moves
    assert pictures.warp_factor(frames) == 1.0


@pytest.mark.parametrize(
    ("library", "draw", "extra"),
    [
        ("pyvista", pictures.still, "vtk"),
        ("matplotlib", pictures.animation, "plot"),
        ("pyvista", write_series, "vtk"),
    ],
)
def test_a_missing_library_is_an_input_error(library, draw, extra, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, library, None)
    with pytest.raises(sj.InputError, match=rf"pip install 'skfem-joint\[{extra}\]'"):
        draw(tmp_path / "a.pvd", pulled(lap()))
    assert not list(tmp_path.iterdir())


#: Stands for VTK in the process that tries a kind of window: all but one end it.
GL = """
import os, signal
from unittest.mock import MagicMock as vtkRenderWindow, MagicMock as vtkRenderer
window = os.environ.get("VTK_DEFAULT_OPENGL_WINDOW", "own choice")
with open(os.environ["TRIED"], "a") as tried:
    print(window, file=tried)
if window != os.environ["WORKS"]:
    os.kill(os.getpid(), signal.SIGSEGV)
"""
DRAW = """
import os
from skfem_joint.output.drawing.offscreen import offscreen
for _ in range(2):
    with offscreen():
        print(os.environ.get("VTK_DEFAULT_OPENGL_WINDOW"))
    print(os.environ.get("VTK_DEFAULT_OPENGL_WINDOW"))
"""
OS_MESA, EGL = "vtkOSOpenGLRenderWindow", "vtkEGLRenderWindow"


@pytest.mark.parametrize(
    ("works", "chosen", "tried", "said"),
    [
        (EGL, {}, [OS_MESA, EGL], [EGL, "None"] * 2),  # found once, then known
        pytest.param("mine", {VARIABLE: "mine"}, ["mine"], ["mine"] * 4, marks=pytest.mark.slow),
        (EGL, {VARIABLE: "broken"}, ["broken"], "'broken' does not work"),
        ("none", {}, [OS_MESA, EGL, "own choice"], "apt-get install libosmesa6"),
    ],
)
def test_the_first_window_that_does_not_end_its_process_is_taken_but_the_users_choice_is_kept(
    tmp_path, works, chosen, tried, said
):
    files = {"vtkRenderingCore": GL, "vtkRenderingOpenGL2": "", "__init__": ""}
    (tmp_path / "vtkmodules").mkdir()
    for name, text in files.items():
        (tmp_path / "vtkmodules" / f"{name}.py").write_text(text)
    given = {key: value for key, value in os.environ.items() if key not in ("DISPLAY", VARIABLE)}
    given |= {"TRIED": str(tmp_path / "tried"), "WORKS": works, **chosen}
    given["PYTHONPATH"] = os.pathsep.join([str(tmp_path), str(Path(sj.__file__).parents[1])])
    ended = subprocess.run(
        [sys.executable, "-c", DRAW], env=given, capture_output=True, text=True, check=False
    )
    assert (tmp_path / "tried").read_text().split("\n")[:-1] == tried
    if isinstance(said, list):
        assert ended.stdout.split() == said
    else:
        assert "InputError: pictures: VTK cannot draw here" in ended.stderr
        assert said in ended.stderr
