"""What is read back from a series of plates is what was written, and both bodies feel one force."""

from __future__ import annotations

import os
import sys
import time
import xml.etree.ElementTree as ET
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import pyvista
from numpy.typing import NDArray

from skfem_joint.errors import InputError
from skfem_joint.plate import PlateJoint, PlateStructure, build_plate_structure
from skfem_joint.plate_mesh import build_plate, merged
from skfem_joint.plate_vtk import (
    GAP,
    LoadHistory,
    PlateField,
    plate_blocks,
    write_load,
    write_series,
)

TIMES = np.array([0.0, 1e-5, 0.1 + 0.2])
STEEL = {"E": 200e9, "poisson": 0.3, "density": 8000.0}
KINDS = [("quadrilateral", 1), ("quadrilateral", 2), ("triangle", 1), ("triangle", 2)]


@cache
def single(kind: str = "quadrilateral", order: int = 1) -> PlateStructure:
    """Joint of 0.1 m on a rigid base and a thicker free strip of 0.2 m."""
    plate = build_plate([("joint", 0.1, 4), ("linear", 0.2, 4)], 0.05, 2, kind=kind, order=order)
    return build_plate_structure(
        plate, **STEEL, thickness=0.01, supports=[("left", "xy")],
        joints=[PlateJoint("joint", "region", None, 50e6, 0.7)],
        regions={"linear": {"thickness": 0.02}},
    )  # fmt: skip


@cache
def lap(kind: str = "quadrilateral", order: int = 1) -> PlateStructure:
    """Two plates of other meshes that overlap on 0.1 m, seen from above."""
    lower = build_plate(
        [("base", 0.2, 6), ("lower_joint", 0.1, 4)], 0.05, 2, prefix="lower_", kind=kind,
        order=order,
    )  # fmt: skip
    upper = build_plate(
        [("joint", 0.1, 5), ("arm", 0.2, 6)], 0.05, 3, origin=(0.2, 0.0), prefix="upper_",
        kind=kind, order=order,
    )  # fmt: skip
    return build_plate_structure(
        merged([lower, upper]), **STEEL, thickness=0.01, supports=[("lower_left", "xy")],
        joints=[PlateJoint("joint", "region", "lower_joint", 50e6, 0.7)],
        regions={"base": {"thickness": 0.016}},
    )  # fmt: skip


@cache
def side(kind: str = "quadrilateral", order: int = 1) -> PlateStructure:
    """Two bars on each other seen from their side, friction along the edge between them."""
    lower = build_plate([("below", 0.3, 6)], 0.02, 2, prefix="lower_", kind=kind, order=order)
    upper = build_plate(
        [("above", 0.2, 5)], 0.02, 2, origin=(0.05, 0.02), prefix="upper_", kind=kind, order=order
    )
    return build_plate_structure(
        merged([lower, upper]), **STEEL, thickness=0.03, supports=[("lower_left", "xy")],
        joints=[PlateJoint("upper_bottom", "boundary", "lower_top", 50e6, 0.7)],
    )  # fmt: skip


def field(
    structure: PlateStructure, name: str = "full", frames: int = 3, seed: int = 0
) -> PlateField:
    """Random history whose contact values live on the pressed nodes."""
    draw = np.random.default_rng(seed)
    n = structure.nodes.shape[0]
    pressed = np.zeros(n, dtype=bool)
    for patch in structure.patches:
        pressed[patch.nodes] = True
    return PlateField(
        name,
        1e-4 * draw.normal(size=(frames, n, 2)),
        draw.normal(size=(frames, n, 2)),
        35e6 * draw.normal(size=(frames, n, 2)) * pressed[:, None],
        np.where(pressed, draw.integers(0, 2, (frames, n)), -1).astype(np.int8),
        draw.uniform(size=(frames, n)) * pressed,
    )


def pressure(structure: PlateStructure) -> NDArray[np.float64]:
    p = np.zeros(structure.nodes.shape[0])
    for patch in structure.patches:
        p[patch.nodes] = 50e6
    return p


def read(path: Path, frame: int) -> list[Any]:
    reader = pyvista.PVDReader(path)
    reader.set_active_time_value(reader.time_values[frame])
    return list(reader.read())


def other_area(structure: PlateStructure) -> NDArray[np.float64]:
    """Nodal contact area of the body that is not pressed."""
    patch = structure.patches[0]
    weights = np.maximum(patch.other.toarray(), 0.0)
    return np.asarray(patch.area @ (weights / weights.sum(axis=1, keepdims=True)))


def node_of(block: Any, structure: PlateStructure, label: str) -> NDArray[np.intp]:
    """Node of the block's body that each point of the block stands over."""
    body = {"lower": 0, "upper": 1}[label]
    nodes = np.unique(structure.cells[structure.plate.body[structure.cell_element] == body])
    offset = np.asarray(block.points)[:, None, :2] - structure.nodes[nodes]
    distance = np.linalg.norm(offset, axis=2)
    assert distance.min(axis=1).max() < 1e-12
    return np.asarray(nodes[distance.argmin(axis=1)])


@pytest.mark.parametrize(("kind", "order"), KINDS)
@pytest.mark.parametrize("shape", ["swept", "flat"])
def test_values_and_times_read_back_equal_those_written(
    tmp_path: Path, kind: str, order: int, shape: str
) -> None:
    made = single(kind, order)
    written = [field(made), field(made, "reduced", seed=1)]
    write_series(tmp_path / "a.pvd", made, TIMES, written, pressure(made), shape=shape)
    assert pyvista.PVDReader(tmp_path / "a.pvd").time_values == TIMES.tolist()
    for k, t in enumerate(TIMES):
        for block, source in zip(read(tmp_path / "a.pvd", k), written, strict=True):
            node = node_of(block, made, "lower")
            assert set(node) == set(range(made.nodes.shape[0]))
            for name, values in (
                ("displacement", source.displacement),
                ("velocity", source.velocity),
                ("friction_traction", source.traction),
            ):
                found = block.point_data[name]
                assert found.shape == (block.n_points, 3)
                np.testing.assert_array_equal(found[:, :2], values[k, node])
                np.testing.assert_array_equal(found[:, 2], 0.0)
            np.testing.assert_array_equal(block["slip_state"], source.slip_state[k, node])
            np.testing.assert_array_equal(block["pressure"], pressure(made)[node])
            np.testing.assert_array_equal(
                block["friction_work_density"], source.friction_work[k, node]
            )
            assert block.field_data["TimeValue"] == [t]
            assert any(line.startswith("pressure: Pa") for line in block.field_data["units"])


@pytest.mark.parametrize(("kind", "order"), KINDS)
def test_a_swept_plate_has_its_volume_and_its_regions(kind: str, order: int) -> None:
    made = single(kind, order)
    (block,) = plate_blocks(made)
    assert block.label == ""
    volume = block.grid.compute_cell_sizes()["Volume"]
    assert np.all(volume > 0.0)  # corners turn the right way
    names = list(block.grid.field_data["region_names"])
    region = np.array(names)[block.grid.cell_data["region"]]
    assert volume[region == "joint"].sum() == pytest.approx(0.1 * 0.05 * 0.01)
    assert volume[region == "linear"].sum() == pytest.approx(0.2 * 0.05 * 0.02)
    np.testing.assert_array_equal(
        block.grid.cell_data["thickness"], np.where(region == "joint", 0.01, 0.02)
    )


def test_cells_that_turn_the_other_way_are_turned() -> None:
    made = single("triangle")
    x, y = made.nodes[made.cells].transpose(2, 0, 1)
    area = (x[:, 1] - x[:, 0]) * (y[:, 2] - y[:, 0]) - (x[:, 2] - x[:, 0]) * (y[:, 1] - y[:, 0])
    (block,) = plate_blocks(made, "flat")
    normals = block.grid.extract_surface(algorithm="dataset_surface").face_normals
    assert np.all(normals[:, 2] > 0.0)
    assert area.size == block.grid.n_cells


@pytest.mark.parametrize(("kind", "order"), KINDS)
@pytest.mark.parametrize("build", [lap, side])
def test_both_bodies_feel_the_same_friction_force(
    tmp_path: Path, build: Any, kind: str, order: int
) -> None:
    made = build(kind, order)
    source = field(made)
    write_series(tmp_path / "a.pvd", made, TIMES, [source], pressure(made), shape="flat")
    patch, area = made.patches[0], np.zeros(made.nodes.shape[0])
    area[patch.nodes] = patch.area
    for k in range(TIMES.size):
        lower, upper = read(tmp_path / "a.pvd", k)
        force = {}
        for label, block, share in (
            ("lower", lower, other_area(made)),
            ("upper", upper, area),
        ):
            node = node_of(block, made, label)
            _, first = np.unique(node, return_index=True)
            assert share[node[first]].sum() == pytest.approx(patch.area.sum(), rel=1e-12)
            traction = block["friction_traction"][first]
            force[label] = share[node[first]] @ traction
            pressed = share[node[first]] @ block["pressure"][first]
            assert pressed == pytest.approx(50e6 * patch.area.sum(), rel=1e-12)
            work = share[node[first]] @ block["friction_work_density"][first]
            expected = patch.area @ source.friction_work[k, patch.nodes]
            assert work == pytest.approx(expected, rel=1e-12)
        expected = patch.area @ source.traction[k, patch.nodes]
        np.testing.assert_allclose(force["upper"][:2], expected, rtol=1e-12)
        np.testing.assert_allclose(force["lower"], -force["upper"], rtol=1e-11)


def test_plates_on_each_other_are_stacked_with_a_gap_and_bars_in_side_view_are_not() -> None:
    lower, upper = plate_blocks(lap())
    assert (lower.label, upper.label) == ("body 1", "body 2")
    assert lower.grid.bounds[4:] == pytest.approx((0.0, 0.016))
    base = 0.016 * (1.0 + GAP)
    assert upper.grid.bounds[4:] == pytest.approx((base, base + 0.01))
    below, above = plate_blocks(side())
    assert (below.label, above.label) == ("below", "above")
    assert below.grid.bounds[4:] == above.grid.bounds[4:] == pytest.approx((0.0, 0.03))


def test_cells_say_where_both_bodies_touch_and_whether_they_slip() -> None:
    made = lap()
    source = field(made)
    patch = made.patches[0]
    for state in (0, 1):
        source.slip_state[:, patch.nodes] = state
        lower, upper = values_of(made, source)
        for block, region, away in ((lower, "lower_joint", "base"), (upper, "joint", "arm")):
            names = np.array(list(block.field_data["region_names"]))[block.cell_data["region"]]
            found = block.cell_data["contact_state"]
            assert set(found[names == region]) == {state}
            assert set(found[names == away]) == {-1}
    made = side()
    source = field(made)
    source.slip_state[:, made.patches[0].nodes] = 1
    below, above = values_of(made, source)
    assert np.count_nonzero(above.cell_data["contact_state"] == 1) == 5  # the row along the edge
    assert np.count_nonzero(below.cell_data["contact_state"] == 1) == 4  # under the upper bar
    assert set(below.cell_data["contact_state"]) == {-1, 1}


def test_where_nothing_presses_neither_body_is_in_contact() -> None:
    made = lap()
    source, patch = field(made), lap().patches[0]
    free = made.nodes[patch.nodes, 0] > 0.25
    source.slip_state[:, patch.nodes] = np.where(free, -1, 1)
    for block in values_of(made, source):
        middle = np.asarray(block.cell_centers().points)[:, 0]
        found = block.cell_data["contact_state"]
        assert set(found[(middle > 0.275) | (middle < 0.2)]) == {-1}
        assert set(found[(middle > 0.2) & (middle < 0.24)]) == {1}


def test_a_supported_edge_of_a_joint_is_still_in_contact() -> None:
    made = single()
    assert made.patches[0].held_nodes.size == 3
    source = field(made)
    source.slip_state[:, made.patches[0].nodes] = 0
    (block,) = values_of(made, source)
    np.testing.assert_array_equal(block.cell_data["contact_state"] == 0, block["region"] == 0)


def values_of(made: PlateStructure, source: PlateField) -> list[Any]:
    """Blocks of the first frame without files."""
    from skfem_joint.plate_vtk import Contact, filled

    values = Contact(made).values(source, 0, pressure(made))
    return [filled(block, values) for block in plate_blocks(made)]


def test_blocks_are_named_by_model_and_body(tmp_path: Path) -> None:
    made = side()
    models = [field(made, "full"), field(made, "reduced: 5")]
    files = write_series(tmp_path / "a.pvd", made, TIMES, models, pressure(made))
    names = [d.get("name") for d in ET.parse(tmp_path / "a.pvd").iter("DataSet")]
    assert names == 3 * ["full: below", "full: above", "reduced: 5: below", "reduced: 5: above"]
    assert {p for p in tmp_path.rglob("*") if p.is_file()} == set(files)
    assert not any(":" in file.name for file in files)
    assert [block["body"][0] for block in read(tmp_path / "a.pvd", 1)] == [0, 1, 0, 1]


def test_an_interruption_leaves_an_index_of_whole_frames(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = lap()
    replace, calls = os.replace, []

    def interrupted(source: Path, target: Path) -> None:
        calls.append(target)
        if len(calls) == 6:
            raise KeyboardInterrupt
        replace(source, target)

    monkeypatch.setattr("skfem_joint.files.os.replace", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_series(tmp_path / "a.pvd", made, TIMES, [field(made)], pressure(made))
    assert pyvista.PVDReader(tmp_path / "a.pvd").time_values == TIMES[:2].tolist()
    assert not list(tmp_path.rglob(".*"))


def test_all_mistakes_are_reported_at_once_and_nothing_is_written(tmp_path: Path) -> None:
    made = lap()
    models = [field(made, frames=2), field(single(), "other")]
    with pytest.raises(InputError) as caught:
        write_series(tmp_path / "a.vtk", made, TIMES[::-1], models, np.ones(3), shape="round")
    text = "\n".join(caught.value.problems)
    for part in (".pvd", "'round'", "increasing", "pressure", "full.velocity", "other.slip_state"):
        assert part in text
    assert len(caught.value.problems) == 4 + 2 * 5
    assert not list(tmp_path.iterdir())


def test_without_pyvista_the_message_names_the_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = single()
    monkeypatch.setitem(sys.modules, "pyvista", None)
    with pytest.raises(InputError, match=r"pip install 'skfem-joint\[vtk\]'"):
        write_series(tmp_path / "a.pvd", made, TIMES, [field(made)], pressure(made))
    assert not list(tmp_path.iterdir())


def test_the_load_beside_the_series_reads_back(tmp_path: Path) -> None:
    times = np.linspace(0.0, 1e-3, 5)
    load = LoadHistory(times, {"free, end": 1e3 * times, "tip": np.sqrt(times)})
    path = write_load(tmp_path / "fields.pvd", load)
    assert path == tmp_path / "fields_load.csv"
    assert path.read_text().splitlines()[0] == '"time, s","force on free, end, N","force on tip, N"'
    rows = np.loadtxt(path, delimiter=",", skiprows=1)
    np.testing.assert_array_equal(rows, np.column_stack([times, 1e3 * times, np.sqrt(times)]))
    with pytest.raises(InputError, match="'tip'"):
        write_load(tmp_path / "fields.pvd", LoadHistory(times, {"tip": times[:2]}))


def test_fifty_frames_of_five_thousand_nodes_take_less_than_five_seconds(tmp_path: Path) -> None:
    plate = build_plate([("joint", 0.1, 50), ("linear", 0.2, 50)], 0.05, 50)
    made = build_plate_structure(
        plate, **STEEL, thickness=0.01, supports=[("left", "xy")],
        joints=[PlateJoint("joint", "region", None, 50e6, 0.7)],
    )  # fmt: skip
    source = field(made, frames=50)
    start = time.process_time()
    write_series(tmp_path / "a.pvd", made, 1e-5 * np.arange(50), [source], pressure(made))
    assert time.process_time() - start < 5.0
