"""What is read back from a ParaView series is what was written, and both bodies feel one force."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import pyvista
from bodies import STEEL
from numpy.typing import NDArray
from pictured import BOXES, PLATES, TIMES, bar, bars, blocks, box, lap, plate, random_frames, side
from scipy.spatial import cKDTree

import skfem_joint as sj
from skfem_joint.joint.manifold import manifold_of
from skfem_joint.joint.pressure import nodal_pressure
from skfem_joint.mesh import named
from skfem_joint.output.fields import CELL_ARRAYS, POINT_ARRAYS, Frames, frames_of
from skfem_joint.output.series import GAP, blocks_of, write_load, write_series

Build = Callable[[], sj.Structure]
DIRECTIONS = [(1, 0, 0), (3, 4, 0), (-1, 2, 2), (0, 0, 1)]
SINGLE: list[Build] = [
    *(lambda d=d: bar(d) for d in DIRECTIONS),
    *(lambda kind=kind: plate(*kind) for kind in PLATES),
    *(lambda kind=kind: box(*kind) for kind in BOXES),
]  # fmt: skip
PAIRS: list[Build] = [
    bars,
    *(lambda kind=kind: lap(*kind) for kind in PLATES),
    *(lambda kind=kind: side(*kind) for kind in PLATES),
    *(lambda kind=kind: blocks(*kind) for kind in BOXES),
]


def test_a_preload_shows_its_gap_on_both_faces_and_its_displacement(tmp_path):
    """Pressed at its ends a body lifts in the middle: gap where there is no pressure."""
    given = side()
    mesh, (joint,) = given.mesh.mesh, given.joints
    x = mesh.p[0, mesh.facets].mean(axis=0)
    upper, lower = (given.mesh.boundaries[name] for name in ("upper_top", "lower_bottom"))
    ends = 0.5 * (x[upper].min() + x[upper].max()) + np.array([-1, 1]) * 0.5 * np.ptp(x[upper])
    groups = {
        f"{name}_{k}": np.array([some[np.abs(x[some] - end).argmin()]])
        for name, some in (("head", upper), ("nut", lower))
        for k, end in enumerate(ends)
    }
    meshed = named(mesh.with_boundaries(groups), order=given.mesh.order)
    bolts = [sj.Clamp(1e4, f"head_{k}", f"nut_{k}") for k in (0, 1)]
    joints = [replace(joint, pressure="preload")]
    structure = replace(given, mesh=meshed, joints=joints, bolts=bolts)
    write_series(tmp_path / "fields.pvd", random_frames(structure))
    for block in read(tmp_path / "fields.pvd", 1):
        gap, pressure = block["gap"], block["pressure"]
        touches = pressure > 0.0
        assert gap.max() > 1e-8
        # On the other face there are means over the nodes of the pressed one.
        assert int(block["body"][0]) == 0 or np.abs(gap[touches]).max() < 1e-6 * gap.max()
        node = node_of(block, structure)
        assert structure.preload is not None
        moved = structure.preload.displacement[node]
        assert block["preload_displacement"][:, :2] == pytest.approx(moved, rel=1e-6)


def read(path: Path, frame: int, faces: bool = False) -> list[Any]:
    """Blocks of bodies, or those of faces."""
    reader = pyvista.PVDReader(path)
    reader.set_active_time_value(reader.time_values[frame])
    blocks = reader.read()[0]
    return [one for one in blocks if (one.get_cell(0).dimension < 3) == faces]


def node_of(block: Any, structure: sj.Structure) -> NDArray[np.intp]:
    """Node of the block's body whose section each point of the block lies in."""
    body = int(block["body"][0])
    nodes = np.flatnonzero(structure.body.body_of_node == body)
    offset = np.asarray(block.points)[:, None] - structure.positions[nodes]
    distance = np.linalg.norm(offset @ structure.body.axes.T, axis=2)
    assert distance.min(axis=1).max() < 1e-12
    return np.asarray(nodes[distance.argmin(axis=1)])


def contents(frames: Frames) -> list[Any]:
    """Blocks of the first frame without files."""
    arrays = frames.arrays(frames.fields[0], 0)
    return [block.fill(arrays) for block in blocks_of(frames.structure)]


@pytest.mark.parametrize("build", SINGLE)
def test_values_and_times_read_back_equal_those_written(tmp_path, build):
    made = build()
    frames = random_frames(made, ("full", "reduced"))
    write_series(tmp_path / "a.pvd", frames)
    assert pyvista.PVDReader(tmp_path / "a.pvd").time_values == TIMES.tolist()
    for k, t in enumerate(TIMES):
        for block, source in zip(read(tmp_path / "a.pvd", k), frames.fields, strict=True):
            node = node_of(block, made)
            assert set(node) == set(range(made.n_nodes))
            for name in ("displacement", "velocity", "slip", "friction_traction"):
                found = block.point_data[name]
                assert found.shape == (block.n_points, 3)
                expected = getattr(source, name)[k, node] @ made.body.axes
                np.testing.assert_allclose(found, expected, atol=1e-14 * np.abs(expected).max())
            for name in ("slip_state", "friction_work_density"):
                np.testing.assert_array_equal(block[name], getattr(source, name)[k, node])
            np.testing.assert_array_equal(block["pressure"], frames.pressure[node])
            assert block.field_data["TimeValue"] == [t]
            units = dict(line.split(": ", 1) for line in block.field_data["units"])
            assert set(block.point_data) == set(POINT_ARRAYS)
            assert set(block.cell_data) - set(CELL_ARRAYS) <= {"region", "body", "thickness"}
            assert {**POINT_ARRAYS, **CELL_ARRAYS}.items() <= units.items()


@pytest.mark.parametrize("build", SINGLE)
def test_the_stress_of_a_uniform_strain_is_hookes(build):
    """Stretched along its first axis and free across it, and sheared where it can be."""
    made = build()
    for plane in ("stress", "strain")[: 1 + (made.dim == 2)]:
        check_hooke(replace(made, plane=plane), plane)


def check_hooke(made, plane):
    """Stress of a uniform strain, in a plane for plates."""
    E, nu, stretch, shear = 200e9, 0.3, 1e-4, 2e-5
    free = nu / (1.0 - nu) if (made.dim, plane) == (2, "strain") else nu
    frames = random_frames(made)
    x, u = made.nodes, np.zeros((made.n_nodes, made.dim))
    u[:, 0] = stretch * x[:, 0]
    for k in range(1, made.dim):
        u[:, k] = -free * stretch * x[:, k]
    if made.dim > 1:
        u[:, 0] += shear * x[:, 1]
    frames.fields[0].displacement[0] = u
    (block,) = contents(frames)
    strip = plane == "strain" and made.dim == 2
    pull = E * stretch / (1.0 - nu**2 if strip else 1.0)
    side = E / (2.0 * (1.0 + nu)) * shear if made.dim > 1 else 0.0
    local = np.array([[pull, side, 0.0], [side, 0.0, 0.0], [0.0, 0.0, nu * pull * strip]])
    axes = np.vstack([made.body.axes, np.eye(3)[made.dim :]])
    if made.dim == 1:
        axes[1:] = 0.0
    xx, yy, zz, xy, yz, xz = block["stress"].T
    found = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    expected = (axes.T @ local @ axes)[..., None] * np.ones(xx.size)
    np.testing.assert_allclose(found, expected, atol=1e-9 * pull)
    squares = pull**2 * (1.0 - nu + nu**2 if strip else 1.0) + 3.0 * side**2
    np.testing.assert_allclose(block["von_mises"], np.sqrt(squares), rtol=1e-9)


@pytest.mark.parametrize("build", SINGLE)
def test_a_body_has_the_volume_of_its_sections_and_knows_its_regions(build):
    made = build()
    (block,) = blocks_of(made)
    assert block.label == ""
    volume = block.grid.compute_cell_sizes(length=False, area=False)["Volume"]
    assert np.all(volume > 0.0)  # corners turn the right way
    regions = list(made.mesh.regions)
    assert list(block.grid.field_data["region_names"]) == regions
    element = np.array(made.body.cell_element)[block.cells]
    for number, name in enumerate(regions):
        inside = block.grid.cell_data["region"] == number
        assert set(element[inside]) == set(made.mesh.regions[name])
        mesh = made.mesh.mesh
        size = np.abs(mesh.mapping().detDF(np.array([[0.25]] * made.dim)))[:, 0]
        size /= {2: 1, 3: 2, 4: 1 if made.dim == 2 else 6, 8: 1}[mesh.t.shape[0]]
        expected = (size * made.body.across)[made.mesh.regions[name]].sum()
        assert volume[inside].sum() == pytest.approx(expected, rel=1e-9)
    if made.dim < 3:
        thickness = made.body.properties["thickness"]
        np.testing.assert_array_equal(block.grid.cell_data["thickness"], thickness[element])
    if made.dim == 1 and made.body.axes[0, 0] == 1.0:  # wide in y and thick in z
        low, high = np.array(block.grid.bounds).reshape(3, 2).T
        np.testing.assert_allclose(high - low, [0.6, 0.05, 0.01], rtol=1e-9)


@pytest.mark.parametrize("build", PAIRS)
def test_both_bodies_feel_the_same_friction_force(tmp_path, build):
    """The integral over each body's own face, also where that is larger than the pressed one."""
    made = build()
    frames = random_frames(made)
    write_series(tmp_path / "a.pvd", frames)
    patch, area = made.patches[0], np.zeros((2, made.n_nodes))
    for row, on in zip(area, (patch.joint.against, patch.joint.on), strict=True):
        own = manifold_of(made.body, replace(patch.joint, on=on, against=None))
        row[:] = nodal_pressure(made.nodes, own.cells, own.depth, 1.0, "")[0]
    source = frames.fields[0]
    for k in range(TIMES.size):
        force = []
        for block, share in zip(read(tmp_path / "a.pvd", k), area, strict=True):
            node, first = np.unique(node_of(block, made), return_index=True)
            force.append(share[node] @ block["friction_traction"][first])
            pressed = share[node] @ block["pressure"][first]
            assert pressed == pytest.approx(patch.normal_force.sum(), rel=1e-12)
            work = share[node] @ block["friction_work_density"][first]
            expected = patch.area @ source.friction_work_density[k, patch.nodes]
            assert work == pytest.approx(expected, rel=1e-12)
        expected = made.body.in_space(patch.area @ source.friction_traction[k, patch.nodes])
        np.testing.assert_allclose(force[1], expected, rtol=1e-11, atol=1e-6)
        np.testing.assert_allclose(force[0], -force[1], rtol=1e-11, atol=1e-6)


@pytest.mark.parametrize("kind", BOXES)
def test_faces_that_touch_are_blocks_by_name_with_the_values_of_their_bodies(tmp_path, kind):
    made = blocks(*kind)
    frames = random_frames(made)
    write_series(tmp_path / "a.pvd", frames)
    bodies, faces = read(tmp_path / "a.pvd", 1)[::-1], read(tmp_path / "a.pvd", 1, faces=True)
    names = pyvista.PVDReader(tmp_path / "a.pvd").read()[0].keys()
    assert names[2:] == ["full: contact upper_front", "full: contact lower_back"]
    for body, face, area in zip(bodies, faces, (0.1 * 0.05, 0.2 * 0.05), strict=True):
        assert face.compute_cell_sizes()["Area"].sum() == pytest.approx(area, rel=1e-12)
        distance, at = cKDTree(body.points).query(face.points)
        assert distance.max() < 1e-12
        for name in POINT_ARRAYS:
            np.testing.assert_array_equal(face.point_data[name], body.point_data[name][at])
        # Each cell has the values of the one behind it.
        inwards = np.array([0.0, 0.0, 1e-5 if face is faces[0] else -1e-5])
        behind = body.find_containing_cell(face.cell_centers().points + inwards)
        for name in CELL_ARRAYS:
            np.testing.assert_array_equal(face.cell_data[name], body.cell_data[name][behind])


def test_bodies_on_each_other_are_moved_apart_and_those_beside_each_other_are_not():
    for made, labels in ((lap(), ("body 1", "body 2")), (bars(), ("body 1", "Stoß"))):
        lower, upper = blocks_of(made)
        assert (lower.label, upper.label) == labels
        assert lower.grid.bounds[4:] == pytest.approx((-0.008, 0.008))
        base = 0.008 + 0.016 * GAP
        assert upper.grid.bounds[4:] == pytest.approx((base, base + 0.01))
    below, above = blocks_of(side())
    assert (below.label, above.label) == ("below", "above")
    assert below.grid.bounds[4:] == above.grid.bounds[4:] == pytest.approx((-0.015, 0.015))
    below, above = blocks_of(blocks())
    assert (below.grid.bounds[5], above.grid.bounds[4]) == pytest.approx((0.02, 0.02))


@pytest.mark.parametrize("build", [bars, lap, bar, plate])
@pytest.mark.parametrize("state", [0, 1])
def test_cells_say_where_bodies_touch_and_whether_they_slip(build, state):
    """At a supported end too; where nothing presses, neither body is in contact."""
    made, frames = build(), random_frames(build())
    patch = made.patches[0]
    along = made.nodes[patch.nodes, 0]
    free = along > (0.25 if build in (bars, lap) else np.inf)
    frames.fields[0].slip_state[:, patch.nodes] = np.where(free, -1, state)
    for block in contents(frames):
        names = np.array(list(block.field_data["region_names"]))[block.cell_data["region"]]
        found, middle = block.cell_data["contact_state"], block.cell_centers().points[:, 0]
        joint = np.char.endswith(names, "joint")
        assert set(found[~joint]) == {-1}
        assert set(found[joint & (middle > 0.275)]) <= {-1} or build is bar
        assert set(found[joint & ((middle < 0.24) | (build is bar))]) == {state}


@pytest.mark.parametrize(("made", "rows"), [(side(), (4, 5)), (blocks(), (4, 9))])
def test_facets_that_touch_show_as_the_row_of_cells_behind_them(made, rows):
    frames = random_frames(made)
    frames.fields[0].slip_state[:, made.patches[0].nodes] = 1
    for block, count in zip(contents(frames), rows, strict=True):
        found = block.cell_data["contact_state"]
        assert np.count_nonzero(found == 1) == count
        assert np.count_nonzero(found == -1) == found.size - count


def test_models_and_bodies_of_any_name_have_blocks_and_files_of_their_own(tmp_path):
    """Alike but for signs, for capitals, and beyond what file systems take of a name."""
    models = ("full", 'reduced: "5" <modes> & µ/2', "plate A", "plate/A", "Plate_a")
    models += ("上" * 200, "上" * 201)
    frames = random_frames(bars(), models)
    files = write_series(tmp_path / "a.pvd", frames)
    assert files[0] == tmp_path / "a.pvd"
    assert len({file.name.casefold() for file in files}) == len(files)
    assert len(files) == 1 + TIMES.size * (1 + 2 * len(models))
    assert {p for p in tmp_path.rglob("*") if p.is_file()} == set(files)
    assert not any(set(file.name) & set(':"<>&/ ') for file in files)
    reader = pyvista.PVDReader(tmp_path / "a.pvd")
    reader.set_active_time_value(TIMES[1])
    shown = reader.read()[0]
    assert shown.keys() == [f"{model}: {body}" for model in models for body in ("body 1", "Stoß")]
    assert "Stoß" in list(shown[0].field_data["region_names"])
    for k, block in enumerate(shown):
        assert block["body"][0] == k % 2
        expected = frames.fields[k // 2].displacement[1, node_of(block, frames.structure), 0]
        np.testing.assert_allclose(block["displacement"][:, 0], expected, rtol=1e-12)


@pytest.mark.parametrize("done", [0, 2, 6, 8])
def test_a_file_that_cannot_be_written_leaves_an_index_of_the_frames_that_all_models_have(
    tmp_path, done
):
    frames = random_frames(bar(), ("full", "reduced"))
    _, *files = write_series(tmp_path / "a.pvd", frames)  # must not be mixed with the new one
    blocks_first = [files[3 * k + j] for k in range(TIMES.size) for j in (1, 2, 0)]
    blocks_first[done].unlink()
    blocks_first[done].mkdir()
    with pytest.raises(sj.InputError, match=f"{blocks_first[done].name}: cannot be written"):
        write_series(tmp_path / "a.pvd", frames)
    assert not list(tmp_path.rglob(".*"))
    if done < 3:
        assert not (tmp_path / "a.pvd").exists()
        return
    reader = pyvista.PVDReader(tmp_path / "a.pvd")
    assert reader.time_values == TIMES[: done // 3].tolist()
    assert all(block.n_points > 0 for block in reader.read()[0])


def test_the_load_beside_the_series_reads_back(tmp_path):
    times = np.linspace(0.0, 1e-3, 5)
    forces = {"free, end": 1e3 * times, "tip": np.sqrt(times)}
    frames = replace(random_frames(bar()), load_times=times, forces=forces)
    path = tmp_path / "fields_load.csv"
    write_load(path, frames)
    assert path.read_text().splitlines()[0] == '"time, s","force on free, end, N","force on tip, N"'
    rows = np.loadtxt(path, delimiter=",", skiprows=1)
    np.testing.assert_array_equal(rows, np.column_stack([times, 1e3 * times, np.sqrt(times)]))


@pytest.mark.parametrize(
    ("name", "words"),
    [
        *((name, r"must be '\.pvd'") for name in ("thesis.npz", "fields", "fields.vtu")),
        ("thesis.npz/a.pvd", "cannot be written"),
    ],
)
def test_a_path_that_no_index_can_have_is_refused_and_left_as_it_is(name, words, tmp_path):
    file = tmp_path / name.partition("/")[0]
    file.write_text("of the user")
    with pytest.raises(sj.InputError, match=words):
        write_series(tmp_path / name, random_frames(bar()))
    assert [path.read_text() for path in tmp_path.iterdir()] == ["of the user"]


@pytest.mark.parametrize("order", [1, 2])
def test_an_even_pressure_is_even_where_supports_hold_the_joint_too(order):
    mesh = sj.build_plate([("joint", 0.04, 4), ("arm", 0.02, 2)], 0.02, 2, order=order)
    joint = sj.Joint("joint", 10e6, 0.3)
    made = sj.Structure(mesh, STEEL, thickness=0.01, fixed=["left"], joints=[joint])
    run = sj.integrate(
        made.system([sj.Load("right", sj.Harmonic(2000.0, 100.0), (1.0, 0.0))]),
        cycles=1, steps_per_cycle=40, save=sj.Save(fields=True),
    )  # fmt: skip
    frames, inside = frames_of(made, {"full": run}), made.nodes[:, 0] <= 0.04 + 1e-9
    assert frames.pressure == pytest.approx(np.where(inside, 10e6, 0.0), rel=1e-9)
    np.testing.assert_array_equal(frames.fields[0].slip_state >= 0, [inside] * 41)
    assert not frames.fields[0].slip_state[:, made.nodes[:, 0] == 0.0].any()  # held: they stick


@pytest.mark.parametrize("order", [1, 2])
def test_on_an_edge_where_joints_meet_forces_are_over_the_area_of_both(order):
    """Nodes of the edge are one contact point each: pressures are the mean, slips not twice."""
    mesh = sj.build_plate([("a", 0.04, 4), ("b", 0.02, 2), ("arm", 0.02, 2)], 0.02, 2, order=order)
    joints = [sj.Joint("a", 10e6, 0.3), sj.Joint("b", 2e6, 0.3)]
    made = sj.Structure(mesh, STEEL, thickness=0.01, fixed=["left"], joints=joints)
    system = made.system([sj.Load("right", sj.Harmonic(2000.0, 100.0), (1.0, 0.0))])
    run = sj.integrate(system, cycles=1, steps_per_cycle=40, save=sj.Save(fields=True))
    frames = frames_of(made, {"full": run})
    (field,), (a, b) = frames.fields, made.patches
    edge = np.intersect1d(a.nodes, b.nodes)
    area = np.zeros(len(made.nodes))
    for patch in (a, b):
        area[patch.nodes] += patch.area
    assert frames.pressure[edge] == pytest.approx(np.full(edge.size, 6e6))  # of 10 and 2 MPa
    assert frames.pressure @ area == pytest.approx(a.normal_force.sum() + b.normal_force.sum())
    assert field.slip[10, edge] == pytest.approx(field.displacement[10, edge])  # on a rigid base
    assert field.friction_work_density[-1] @ area == pytest.approx(run.friction_work.sum())
    assert (field.friction_work_density[-1, edge] > 0.0).all()
