"""Scenes with measured gaps: files, tables and lists of them, and what is refused where."""

from typing import Any

import numpy as np
import pytest

import skfem_joint as sj
from skfem_joint.mesh import build_plate, write_mesh
from skfem_joint.scene import Scene, scene_from

TABLES: dict[str, Any] = {
    "material": {"E": 200e9, "density": 8000.0, "poisson": 0.3},
    "section": {"thickness": 0.01},
    "support": {"fixed": ["wall"]},
    "joint": [{"on": "under", "friction": 0.3, "contact": "unilateral"}],
    "load": [{"on": "over", "kind": "harmonic", "amplitude": 10.0, "frequency": 100.0,
              "direction": [0.0, 1.0]}],
    "time": {"cycles": 1},
}  # fmt: skip


@pytest.fixture
def scene(tmp_path: Any) -> Any:
    """Scene of a plate from the side over its base, made with keys of its joint."""
    (tmp_path / "scan.csv").write_text(
        "x (mm),height (um)\n0,0\n50,-4\n100,-12\n", encoding="utf-8"
    )
    (tmp_path / "other.csv").write_text("x,gap\n-0.1,1e-6\n0.0,1e-6\n", encoding="utf-8")
    names = {"under": "bottom", "over": "top", "wall": "left"}

    def made(**joint: Any) -> Scene:
        mesh = build_plate([("plate", 0.1, 10)], 0.01, 1, boundaries=names)
        tables = {**TABLES, "joint": [{**TABLES["joint"][0], **joint}]}
        return scene_from(tables, mesh, tmp_path / "scene.toml")

    return made


def gap_of(scene: Scene) -> Any:
    """Gap at rest over the places of its nodes."""
    structure = scene.structure()
    nodes = structure.spaces[0].nodes
    known = structure.patches[0].opening.gap
    return known[np.argsort(structure.nodes[nodes, 0])]


def test_a_file_beside_the_scene_is_its_gap(scene):
    gap = gap_of(scene(gap="scan.csv"))
    x = np.linspace(0.0, 0.1, 11)
    known = np.interp(x, [0.0, 0.05, 0.1], [0.0, 4e-6, 12e-6])
    # Means over hats, of which those at the ends lie inside; the faces touch at the first.
    assert gap[0] == 0.0
    assert np.diff(gap[1:5]) == pytest.approx(np.diff(known[1:5]), rel=1e-9)
    assert gap[-2] - gap[1] == pytest.approx(known[-2] - known[1], rel=0.1)


def test_tables_lists_scales_and_planes(scene):
    single = gap_of(scene(gap="scan.csv"))
    assert gap_of(scene(gap={"file": "scan.csv"})) == pytest.approx(single, rel=1e-15)
    assert gap_of(scene(gap=["scan.csv"])) == pytest.approx(single, rel=1e-15)
    assert gap_of(scene(gap="scan.csv", gap_scale=2.5)) == pytest.approx(2.5 * single, rel=1e-12)
    turned = {"file": "other.csv", "axes": [[-1.0, 0.0]]}
    assert gap_of(scene(gap=turned)) == pytest.approx(1e-6, rel=1e-9)
    # A constant beside heights, which are known up to a constant alone, is nothing.
    both = gap_of(scene(gap=["scan.csv", {"file": "other.csv", "origin": [0.1, 0.0]}]))
    assert both == pytest.approx(single, abs=1e-18)
    flat = gap_of(scene(gap="scan.csv", remove_plane=True))
    assert flat.min() == 0.0
    assert flat.max() < 0.2 * single.max()


def test_the_scale_of_a_gap_is_a_key_that_can_be_changed(scene):
    given = scene(gap="scan.csv")
    changed = given.changed({"joint[0].gap_scale": 2.0})
    assert gap_of(changed) == pytest.approx(2.0 * gap_of(given), rel=1e-12)


def test_what_the_mesh_has_of_the_gap_is_said(scene):
    structure = scene(gap="scan.csv").structure()
    (line,) = [line for line in structure.at_rest() if "Gap of joint 'under'" in line]
    assert "up to 1.1" in line
    assert "e-05 m" in line
    assert not any("miss" in note for note in scene(gap="scan.csv").system().notes)


@pytest.mark.parametrize(
    ("joint", "words"),
    [
        ({"gap": "none.csv"}, ["joint[0].gap", "none.csv: cannot be read"]),
        ({"gap": -1.0}, ["joint[0].gap", "found -1"]),
        ({"gap": {}}, ["joint[0].gap.file", "missing"]),
        ({"gap": {"file": "scan.csv", "margn": 1.0}}, ["joint[0].gap.margn", "margin"]),
        ({"gap": {"file": "scan.csv", "axes": [[0.0, 0.0]]}}, ["joint[0].gap.axes", "zeros"]),
        ({"gap": ["scan.csv", "none.csv"]}, ["joint[0].gap[1]", "none.csv: cannot be read"]),
        ({"gap": "wrong.csv"}, ["wrong.csv: line 3", "found 'b'"]),
        ({"gap": "scan.csv", "contact": "constant", "pressure": 1e6},
         ["joint[0].gap", "needs contact = 'unilateral', or pressure = 'preload'"]),
    ],
)  # fmt: skip
def test_what_is_wrong_names_key_and_file(scene, tmp_path, joint, words):
    (tmp_path / "wrong.csv").write_text("x,gap\n0,1\n1,b\n", encoding="utf-8")
    with pytest.raises(sj.InputError) as refused:
        scene(**joint)
    said = str(refused.value)
    for word in words:
        assert word in said


def test_a_field_of_nodes_of_the_mesh_file_is_a_gap(scene, tmp_path):
    mesh = scene().named_mesh
    path = tmp_path / "plate.msh"
    write_mesh(mesh, path)
    rows = "\n".join(f"{k} {1e-6 + 1e-5 * x!r}" for k, x in enumerate(mesh.mesh.p[0].tolist(), 1))
    count = mesh.mesh.p.shape[1]
    field = f'$NodeData\n1\n"bow"\n1\n0\n3\n0\n1\n{count}\n{rows}\n$EndNodeData\n'
    path.write_text(path.read_text(encoding="utf-8") + field, encoding="utf-8")
    given = {"file": "plate.msh", "field": "bow", "on": "under"}
    gap = gap_of(scene(gap=given))
    assert gap[1:-1] == pytest.approx(1e-6 + 1e-7 * np.arange(1, 10), rel=1e-9)
    assert gap_of(scene(gap=[given, "scan.csv"])).min() == 0.0
    for wrong, words in (
        ({"field": "no"}, "must be one; the file has bow"),
        ({"kind": "x"}, "kind"),
    ):
        with pytest.raises(sj.InputError, match=words):
            scene(gap={**given, **wrong})


def test_a_scan_in_a_forgotten_unit_is_refused_with_its_joint(scene, tmp_path):
    """4 and 12 that were meant in micrometres are metres, on a face of 0.1 m."""
    (tmp_path / "scan.csv").write_text("x (mm),height\n0,0\n50,-4\n100,-12\n", encoding="utf-8")
    with pytest.raises(
        sj.InputError, match=r"joint 'under'.*m on a face of 0\.\d+ m.*another unit"
    ):
        scene(gap="scan.csv").structure()
