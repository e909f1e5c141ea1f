"""Pictures of damping curves."""

from typing import Any

import numpy as np
import pytest
from joint_scenes import harmonic, plate_scene
from scene_texts import csv_rows

import skfem_joint as sj
from skfem_joint.output.damping import backbone_figure, backbone_lines, write_backbone
from skfem_joint.output.drawing.shapes import shapes_figure
from skfem_joint.study.scene_backbone import scene_backbone


def cantilever(**backbone: Any) -> sj.Scene:
    """Plate on a base near its held end, pulled along it; its first mode bends it across."""
    return plate_scene(
        "full",
        mesh=sj.build_plate([("joint", 0.1, 10), ("rest", 0.3, 10)], 0.05, 4),
        material={"E": 200e9, "density": 8000.0, "poisson": 0.3},
        joint=[{"on": "joint", "pressure": 8e6, "friction": 0.7, "law": "coulomb"}],
        load=[harmonic("right", 1e3, 500.0) | {"direction": [1.0, 0.0]}],
        damping={},
        backbone={"modes": [1], "levels": 5, "up_to": 0.5} | backbone,
    )


def test_a_mode_across_the_load_is_drawn_over_where_it_moves_most(tmp_path):
    scene = cantilever()
    found = scene_backbone(scene)
    (curve,) = found.models[0].curves
    assert curve.displacement.max() < 1e-9 * curve.amplitude.max()  # the loaded end, along the load
    moved = np.linalg.norm(scene.structure().expand(curve.states[-1]), axis=1)
    figure = backbone_figure(found.models, found.largest)
    for panel in figure.axes:
        x = np.asarray(panel.get_lines()[0].get_xdata())
        assert panel.get_xlabel() == "amplitude where the mode\nmoves most, µm"
        assert np.all(np.diff(x) > 0.0)
        assert x == pytest.approx(1e6 * found.largest[0] * curve.amplitude, rel=1e-12)
        assert x[-1] == pytest.approx(1e6 * moved.max(), rel=0.1)  # but for a change of its shape
    assert {path.name for path in write_backbone(tmp_path, found)} == {
        "backbone.csv", "backbone.png", "shapes.png", "summary.json"
    }  # fmt: skip
    figure.draw_without_rendering()
    for panel in figure.axes:  # nothing is cut at the edges
        box = panel.xaxis.label.get_window_extent()
        assert 0.0 < box.x0 < box.x1 < figure.bbox.width
    without = backbone_figure(found.models)
    assert without.axes[0].get_xlabel() == "modal amplitude, m·√kg"
    np.testing.assert_array_equal(without.axes[0].get_lines()[0].get_xdata(), curve.amplitude)


def test_what_not_to_rely_on_is_said_in_table_print_and_picture(tmp_path):
    """A ring-down beside a curve into gross slip, which has the shape of stuck joints."""
    scene = cantilever(up_to=1.3, ring_down=12)
    found = scene_backbone(scene)
    (curve,) = found.models[0].curves
    write_backbone(tmp_path, found)
    rows = csv_rows(tmp_path / "backbone.csv")
    assert [row["doubt"] for row in rows] == list(curve.doubts)
    assert rows[-1]["doubt"].startswith("whole slip")
    assert curve.differs.any()
    shape, line, *_ = backbone_lines(found)
    assert shape.startswith("Mode 1 with the joints stuck: ")
    assert " Hz, moves along y (" in shape
    assert "Not to be relied on: 1 of 5 levels: whole slip;" in line
    assert any("slips as a whole" in text for text in found.notes)
    assert any("the ring-down differs" in text for text in found.notes)
    panels = backbone_figure(found.models).axes
    assert {panel.get_xlabel() for panel in panels} == {"modal amplitude, m·√kg"}
    labels = panels[0].get_legend_handles_labels()[1]
    assert {"gross slip: not to be relied on", "ring-down differs"} <= set(labels)


@pytest.mark.parametrize("kind", ["tetrahedron", "hexahedron", "prism"])
def test_a_shape_of_solids_has_all_faces_with_their_displacement_over_the_largest(kind):
    """A box of which one end moves and the other does not."""
    mesh = sj.build_box([("a", 0.1, 4)], (0.02, 0.02), (2, 2), kind=kind)
    box = sj.Structure(mesh, sj.Material(E=200e9, density=8e3, poisson=0.3), free=True)
    panel, _ = shapes_figure(box, [box.nodes[:, :1] * np.array([0.0, 0.0, 3.0])], ["mode"]).axes
    faces = panel.collections[1]
    drawn = mesh.mesh.facets[:, mesh.mesh.boundary_facets()]
    right = mesh.mesh.p[0, drawn].mean(axis=0) / 0.1
    np.testing.assert_allclose(np.sort(faces.get_array()), np.sort(right))
    assert len(faces.get_paths()) == drawn.shape[1]
