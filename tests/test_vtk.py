"""What is read back from a ParaView series is what was written, however the writing ended."""

from __future__ import annotations

import os
import sys
import time
import xml.etree.ElementTree as ET
from pathlib import Path

import numpy as np
import pytest
import pyvista
from numpy.typing import NDArray

from skfem_joint.contact import PressureTable
from skfem_joint.errors import InputError
from skfem_joint.meshing import BarMesh, build_bar
from skfem_joint.structure import Joint, Structure, build_structure
from skfem_joint.vtk import Field, write_series

PRESSURE = 50e6
TIMES = np.array([0.0, 1e-5, 0.1 + 0.2])


def structure(direction: tuple[float, float, float] = (1.0, 0.0, 0.0)) -> Structure:
    """Joint of 4 elements and a narrower linear region of 3, inclined, away from the origin."""
    bar = build_bar([("joint", 0.1, 4), ("linear", 0.5, 3)], {"fixed": 0.0, "free_end": 0.6})
    along = np.array(direction) / np.linalg.norm(direction)
    coordinates = np.array([0.3, -0.2, 0.1]) + bar.mesh.p[0][:, None] * along
    placed = BarMesh(bar.mesh, coordinates, bar.regions, bar.points, "")
    return build_structure(
        placed, E=200e9, density=8000.0, width=0.05, thickness=0.01, fixed=["fixed"],
        joints=[Joint("joint", PRESSURE, 0.7)], regions={"linear": {"width": 0.03}},
    )  # fmt: skip


def field(name: str, frames: int, nodes: int, seed: int = 0) -> Field:
    draw = np.random.default_rng(seed)
    u, v, force = draw.normal(size=(3, frames, nodes)) * np.array([1e-4, 1.0, 1e3])[:, None, None]
    return Field(name, u, v, force, draw.integers(-1, 2, (frames, nodes)).astype(np.int8))


def node_of(points: NDArray[np.float64], bar: BarMesh) -> NDArray[np.intp]:
    """Node whose section a point lies in, by its place along the bar."""
    origin, along = bar.coordinates[0], bar.coordinates[-1] - bar.coordinates[0]
    place = (points - origin) @ along / np.linalg.norm(along)
    distance = np.abs(place[:, None] - bar.mesh.p[0])
    assert distance.min(axis=1).max() < 1e-12
    return np.asarray(distance.argmin(axis=1))


@pytest.mark.parametrize("shape", ["swept", "line"])
@pytest.mark.parametrize("direction", [(1, 0, 0), (3, 4, 0), (-1, 2, 2), (0, 0, 1)])
def test_values_times_and_blocks_read_back_equal_those_written(
    tmp_path: Path, shape: str, direction: tuple[float, float, float]
) -> None:
    bar = structure(direction)
    written = [field("full", 3, bar.n_nodes), field("reduced", 3, bar.n_nodes, seed=1)]
    write_series(tmp_path / "run.pvd", bar, TIMES, written, shape=shape)

    reader = pyvista.PVDReader(tmp_path / "run.pvd")
    assert reader.time_values == TIMES.tolist()
    names = [(d.time, d.part, Path(d.path).as_posix()) for d in reader.datasets]
    assert names == [
        (t, part, f"run/{block}_000{k}.vtu")
        for k, t in enumerate(TIMES)
        for part, block in enumerate(["full", "reduced"])
    ]
    axis = np.array(direction) / np.linalg.norm(direction)
    for k, t in enumerate(TIMES):
        reader.set_active_time_value(t)
        blocks = reader.read()
        assert len(blocks) == 2
        for block, source in zip(blocks, written, strict=True):
            node = node_of(block.points, bar.bar)
            assert set(node) == set(range(bar.n_nodes))
            for name in ("displacement", "velocity", "friction_force"):
                vectors = block.point_data[name]
                assert vectors.shape == (block.n_points, 3)
                scalars = getattr(source, name)[k, node]
                np.testing.assert_allclose(vectors @ axis, scalars, rtol=1e-14)
                np.testing.assert_allclose(
                    vectors, scalars[:, None] * axis, rtol=0.0, atol=1e-14 * abs(scalars).max()
                )
            np.testing.assert_array_equal(
                block.point_data["slip_state"], source.slip_state[k, node]
            )
            assert block.field_data["TimeValue"] == [t]


@pytest.mark.parametrize("direction", [(1, 0, 0), (3, 4, 0), (-1, 2, 2), (0, 0, 1)])
def test_a_swept_bar_has_the_volume_of_its_sections(
    tmp_path: Path, direction: tuple[float, float, float]
) -> None:
    bar = structure(direction)
    files = write_series(tmp_path / "a.pvd", bar, TIMES[:1], [field("full", 1, bar.n_nodes)])
    grid = pyvista.read(files[1])
    sizes = grid.compute_cell_sizes(length=False, area=False).cell_data["Volume"]
    # Positive volumes: the corners turn the right way.
    np.testing.assert_allclose(sizes, np.diff(bar.position) * bar.width * bar.thickness, rtol=1e-9)


def test_a_plate_along_x_is_wide_in_y_and_thick_in_z(tmp_path: Path) -> None:
    bar = structure()
    files = write_series(tmp_path / "a.pvd", bar, TIMES[:1], [field("full", 1, bar.n_nodes)])
    box = np.array(pyvista.read(files[1]).bounds).reshape(3, 2)
    np.testing.assert_allclose(box[:, 1] - box[:, 0], [0.6, 0.05, 0.01], rtol=1e-9)


def test_elements_know_their_region_and_clamping_pressure(tmp_path: Path) -> None:
    bar = structure()
    files = write_series(tmp_path / "a.pvd", bar, TIMES[:1], [field("full", 1, bar.n_nodes)])
    grid = pyvista.read(files[1])
    names = list(grid.field_data["region_names"])
    assert [names[i] for i in grid.cell_data["region"]] == ["joint"] * 4 + ["linear"] * 3
    np.testing.assert_array_equal(grid.cell_data["clamping_pressure"], [PRESSURE] * 4 + [0.0] * 3)


def test_clamping_pressure_from_a_table_is_that_in_the_middle_of_the_elements(
    tmp_path: Path,
) -> None:
    bar = build_bar([("joint", 1.0, 4)], {"fixed": 0.0})
    joint = Joint("joint", PressureTable((0.0, 1.0), (0.0, 8e6)), 0.7)
    made = build_structure(
        bar, E=1e9, density=1.0, width=0.1, thickness=0.1, fixed=["fixed"], joints=[joint]
    )
    files = write_series(tmp_path / "a.pvd", made, TIMES[:1], [field("full", 1, 5)], shape="line")
    pressure = pyvista.read(files[1]).cell_data["clamping_pressure"]
    np.testing.assert_allclose(pressure, [1e6, 3e6, 5e6, 7e6])


def test_names_keep_their_colons_in_the_index_and_lose_them_in_file_names(tmp_path: Path) -> None:
    bar = structure()
    name = 'reduced: "5" <modes> & µ/2'
    files = write_series(tmp_path / "a.pvd", bar, TIMES, [field(name, 3, bar.n_nodes)])
    assert {file.parent for file in files[1:]} == {tmp_path / "a"}
    assert not any(set(file.name) & set(':"<>&/ ') for file in files)
    root = pyvista.PVDReader(tmp_path / "a.pvd")
    assert root.read()[0].n_points > 0
    found = {d.get("name") for d in ET.parse(tmp_path / "a.pvd").iter("DataSet")}
    assert found == {name}


def test_every_file_written_is_listed_and_no_other_is_left(tmp_path: Path) -> None:
    bar = structure()
    models = [field("full", 3, bar.n_nodes), field("reduced", 3, bar.n_nodes)]
    files = write_series(tmp_path / "new" / "deep" / "a.pvd", bar, TIMES, models)
    assert files[0] == tmp_path / "new" / "deep" / "a.pvd"
    assert len(files) == 1 + 2 * 3
    assert {p for p in tmp_path.rglob("*") if p.is_file()} == set(files)


@pytest.mark.parametrize("done", [0, 1, 4, 5])
def test_an_interruption_leaves_an_index_of_the_frames_that_all_models_have(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, done: int
) -> None:
    bar = structure()
    models = [field("full", 3, bar.n_nodes), field("reduced", 3, bar.n_nodes)]
    write_series(tmp_path / "a.pvd", bar, TIMES, models)  # must not be mixed with the new one
    replace, calls = os.replace, []

    def interrupted(source: Path, target: Path) -> None:
        calls.append(target)
        if len(calls) == done + 1:
            raise KeyboardInterrupt
        replace(source, target)

    monkeypatch.setattr("skfem_joint.files.os.replace", interrupted)
    with pytest.raises(KeyboardInterrupt):
        write_series(tmp_path / "a.pvd", bar, TIMES, models)
    assert not list(tmp_path.rglob(".*"))
    if done < 2:
        assert not (tmp_path / "a.pvd").exists()
        return
    reader = pyvista.PVDReader(tmp_path / "a.pvd")
    assert reader.time_values == TIMES[: done // 2].tolist()
    assert all(block.n_points > 0 for block in reader.read())


def test_a_reader_never_sees_half_a_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    bar = structure()
    whole: list[str] = []
    replace = os.replace

    def watched(source: Path, target: Path) -> None:
        assert not Path(target).exists()
        assert Path(source).parent == Path(target).parent
        replace(source, target)
        whole.append(Path(target).name)

    monkeypatch.setattr("skfem_joint.files.os.replace", watched)
    files = write_series(tmp_path / "a.pvd", bar, TIMES, [field("full", 3, bar.n_nodes)])
    assert whole == [file.name for file in [*files[1:], files[0]]]


def test_all_mistakes_are_reported_at_once_and_nothing_is_written(tmp_path: Path) -> None:
    bar = structure()
    models = [field("a:b", 2, bar.n_nodes), field("A_b", 3, bar.n_nodes + 1)]
    with pytest.raises(InputError) as caught:
        write_series(tmp_path / "a.vtk", bar, TIMES[::-1], models, shape="round")
    text = "\n".join(caught.value.problems)
    for part in (".pvd", "'round'", "increasing", "same name", "a:b.velocity", "A_b.slip_state"):
        assert part in text
    assert len(caught.value.problems) == 4 + 2 * 4
    assert not list(tmp_path.iterdir())


def test_a_place_that_cannot_be_written_is_an_input_error(tmp_path: Path) -> None:
    bar = structure()
    model = field("full", 3, bar.n_nodes)
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot be written"):
        write_series(tmp_path / "file" / "a.pvd", bar, TIMES, [model])
    (tmp_path / "a" / "full_0001.vtu").mkdir(parents=True)  # in the way of the second frame
    with pytest.raises(InputError, match=r"full_0001\.vtu: cannot be written"):
        write_series(tmp_path / "a.pvd", bar, TIMES, [model])
    assert not list(tmp_path.rglob(".*"))


def test_without_pyvista_the_message_names_the_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    bar = structure()
    monkeypatch.setitem(sys.modules, "pyvista", None)
    with pytest.raises(InputError, match=r"pip install 'skfem-joint\[vtk\]'"):
        write_series(tmp_path / "a.pvd", bar, TIMES, [field("full", 3, bar.n_nodes)])
    assert not list(tmp_path.iterdir())


def test_two_models_of_200_nodes_and_200_frames_take_less_than_three_seconds(
    tmp_path: Path,
) -> None:
    bar = build_bar([("joint", 0.6, 199)], {"fixed": 0.0})
    made = build_structure(bar, E=1e9, density=1.0, width=0.1, thickness=0.1, fixed=["fixed"])
    models = [field("full", 200, 200), field("reduced", 200, 200)]
    start = time.process_time()
    write_series(tmp_path / "a.pvd", made, 1e-5 * np.arange(200), models)
    assert time.process_time() - start < 3.0
