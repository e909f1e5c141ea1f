"""Matrices from elsewhere as a scene: the same as the mesh that they come from."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from joint_scenes import harmonic, lap_joint, plate_scene
from scipy import sparse
from scipy.io import mmwrite, savemat

import skfem_joint as sj
from skfem_joint.cli import main
from skfem_joint.scene import Scene, scene_from
from skfem_joint.study.description import description_of


def npz(folder: Path, name: str, A: Any) -> str:
    sparse.save_npz(folder / f"{name}.npz", sparse.csr_array(A))
    return f"{name}.npz"


def mtx(folder: Path, name: str, A: Any) -> str:
    mmwrite(folder / f"{name}.mtx", A, precision=17)
    return f"{name}.mtx"


def mat(folder: Path, name: str, A: Any) -> str:
    path = folder / f"{name}.mat"
    savemat(path, {name: sparse.csc_matrix(A), "other": np.eye(2)})
    return f"{name}.mat:{name}"


Store = Callable[[Path, str, Any], str]


def pairs_of(structure: sj.Structure) -> dict[str, Any]:
    """Contacts of a structure whose nodes match, as another program would list them."""
    dim, pairs = structure.dim, {}
    for patch in structure.patches:
        rows = np.full((patch.nodes.size, 10), np.nan)
        rows[:, :dim] = dim * patch.nodes[:, None] + np.arange(dim)
        if patch.other is not None:
            other = np.asarray(patch.other.argmax(axis=1)).ravel()
            rows[:, 3 : 3 + dim] = dim * other[:, None] + np.arange(dim)
        rows[:, 6:9] = [0.0, 0.0, 1.0]
        if patch.normal is not None:
            rows[:, 6 : 6 + dim] = patch.normal
        rows[:, 9] = patch.normal_force / patch.joint.pressure
        pairs[patch.joint.name] = rows
    return pairs


def exported(folder: Path, scene: Scene, store: Store, points: dict[str, Any]) -> dict[str, Any]:
    """Tables of a scene as matrices in files of a folder, without its mesh."""
    structure = scene.structure()
    M, K = structure.matrices()
    contact = {}
    for name, rows in pairs_of(structure).items():
        header = "x1, y1, z1, x2, y2, z2, nx, ny, nz, area"
        lines = [",".join("" if np.isnan(x) else f"{x:.17g}" for x in row) for row in rows]
        (folder / f"{name}.csv").write_text("\n".join([header, *lines]))
        contact[name] = f"{name}.csv"
    tables = scene.model_dump(exclude_unset=True)
    kept = {k: v for k, v in tables.items() if k not in ("mesh", "material", "section", "support")}
    joints = [{k: v for k, v in joint.items() if k in _OF_JOINT} for joint in tables["joint"]]
    loads = [{k: v for k, v in load.items() if k != "direction"} for load in tables["load"]]
    matrices = {
        "K": store(folder, "K", K),
        "M": store(folder, "M", M),
        "contact": contact,
        "fixed": np.flatnonzero(structure.held).tolist(),
        "points": points,
    }
    return kept | {"joint": joints, "load": loads, "matrices": matrices}


_OF_JOINT = ("on", "pressure", "friction", "law", "beta")


def bar_export(folder: Path, store: Store = npz, *run: str, **changes: Any) -> Any:
    scene = lap_joint(*run, **({"bar": "short_lap_joint"} | changes))
    end = scene.named_mesh.points["free_end"]
    return scene, exported(folder, scene, store, {"free_end": end})


def matrix_scene(folder: Path, tables: dict[str, Any]) -> Scene:
    return scene_from(tables, None, folder / "scene.toml")


@pytest.mark.parametrize("store", [npz, mtx, mat])
def test_bar_as_matrices_moves_and_dissipates_as_its_mesh(tmp_path, store):
    models = ("full", "condensed", "reduced") if store is npz else ("full",)
    scene, tables = bar_export(tmp_path, store, *models, reduction={})
    by_mesh, by_matrices = sj.run_scene(scene), sj.run_scene(matrix_scene(tmp_path, tables))
    for name in models:
        a, b = by_mesh.models[name].run, by_matrices.models[name].run
        assert b.point_u == pytest.approx(a.point_u, rel=0, abs=1e-10 * a.peak.max())
        assert b.friction_energy == pytest.approx(a.friction_energy, rel=1e-10)
    assert by_matrices.models["full"].slipping_fraction


def plate_on_base() -> Scene:
    return plate_scene("full", joint=[JOINT], time=SHORT)


def plate_on_plate() -> Scene:
    """Two plates whose nodes match where they overlap."""
    joint = JOINT | {"on": "upper_joint", "against": "joint"}
    lower = sj.build_plate([("linear", 0.1, 3), ("joint", 0.1, 4)], 0.05, 2)
    strips = [("upper_joint", 0.1, 4), ("upper_linear", 0.1, 3)]
    upper = sj.build_plate(strips, 0.05, 2, origin=(0.1, 0.0), prefix="upper_")
    load = harmonic("upper_right", 14e3, 1000.0) | {"direction": [1.0, 0.0]}
    mesh = sj.merged([lower, upper])
    return plate_scene("full", mesh=mesh, joint=[joint], load=[load], time=SHORT)


def solid_on_base() -> Scene:
    """A block pressed with its lower face, which is held from leaving the base."""
    mesh = sj.build_box([("inside", 0.1, 4)], (0.02, 0.02), (1, 1))
    load = harmonic("right", 3e3, 1000.0) | {"direction": [1.0, 0.2, 0.0]}
    material = {"E": 200e9, "density": 8000.0, "poisson": 0.3}
    tables = {"section": {}, "material": material, "load": [load], "time": SHORT}
    return plate_scene("full", mesh=mesh, joint=[JOINT | {"on": "bottom"}], **tables)


JOINT = {"on": "joint", "pressure": 8e6, "friction": 0.7, "law": "coulomb"}
SHORT = {"cycles": 1, "steps_per_cycle": 50}


@pytest.mark.parametrize("make", [plate_on_base, plate_on_plate, solid_on_base])
def test_pairs_with_two_slips_move_as_their_mesh(tmp_path, make):
    scene = make()
    structure, (load,) = scene.structure(), scene.loads()
    push = np.outer(structure.body.even_shares(str(load.on)), load.unit(structure.dim)).ravel()
    np.savez(tmp_path / "push.npz", push=push)
    tables = exported(tmp_path, scene, npz, {str(load.on): "push.npz:push"})
    given = matrix_scene(tmp_path, tables)
    a, b = (sj.integrate(one.system(), cycles=1, steps_per_cycle=50) for one in (scene, given))
    assert b.system.contact.directions.tolist() == a.system.contact.directions.tolist()
    assert max(a.friction_energy.values()) > 0.0
    assert b.point_u[:, 0] == pytest.approx(a.point_u[:, 0], rel=0, abs=1e-10 * a.peak.max())
    assert b.friction_energy == pytest.approx(a.friction_energy, rel=1e-10)


@pytest.mark.parametrize("seed", range(8))
def test_a_unit_motion_of_one_side_is_a_unit_slip(seed):
    """Along any tangent, with the sign of the first side; both sides alike do not slip."""
    random = np.random.default_rng(seed)
    normal = random.normal(size=(3, 3))
    tangent = np.cross(normal, random.normal(size=(3, 3)))
    tangent /= np.linalg.norm(tangent, axis=1)[:, None]
    dofs = random.permutation(18).reshape(3, 6)
    pairs = {"lap": np.hstack([dofs, normal, np.ones((3, 1))])}
    unit = sparse.eye_array(18)
    model = sj.MatrixModel(unit, unit, contacts=pairs, joints=[sj.Joint("lap", 1e6, 0.3)])
    u = np.zeros((18, 2))
    u[dofs[:, :3], 0] = u[dofs[:, :3], 1] = u[dofs[:, 3:], 1] = tangent
    slip = np.asarray(model.contact.B @ u).reshape(3, 2, 2)
    (patch,) = model.patches
    assert np.einsum("kdc,kd->kc", patch.directions, slip[..., 0]) == pytest.approx(tangent)
    assert slip[..., 1] == pytest.approx(0.0, abs=1e-12)
    assert model.contact.closed @ u == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(
    ("how", "said"),
    [
        ({"pressure": "preload"}, "pressure: found 'preload', must be a number in Pa"),
        ({"pressure": sj.PressureTable((0, 1), (1, 1))}, "pressure: found a table, must be a num"),
        ({"pressure": -1.0}, "pressure: found -1.0, must be >= 0"),
        ({"against": "base"}, "against: found beside matrices"),
        ({"normal_force": "equal"}, "normal_force: found beside matrices"),
    ],
)
def test_joints_of_pairs_have_what_pairs_can_take(how, said):
    unit, pairs = sparse.eye_array(6), np.array([[*range(6), 0.0, 0.0, 1.0, 1.0]])
    joint = replace(sj.Joint("lap", 1e6, 0.3), **how)
    with pytest.raises(sj.InputError, match=f"joint 'lap': {said}"):
        sj.MatrixModel(unit, unit, contacts={"lap": pairs}, joints=[joint])


def test_rigid_motions_are_counted_and_a_floating_structure_is_reported(tmp_path):
    _, tables = bar_export(tmp_path)
    tables["matrices"]["fixed"] = []
    tables["joint"][0]["friction"] = 0.0
    scene = matrix_scene(tmp_path, tables)
    description = description_of(scene)
    for motions in ("rigid_motions_loose", "rigid_motions_stuck"):
        assert description.values[motions] == 1
    assert any("the structure floats" in doubt for doubt in description.doubts)


def scene_file(folder: Path, tables: dict[str, Any]) -> Path:
    def text(value: Any) -> str:
        if isinstance(value, dict):
            return "{" + ", ".join(f"{json.dumps(k)} = {text(v)}" for k, v in value.items()) + "}"
        if isinstance(value, list | tuple):
            return "[" + ", ".join(map(text, value)) + "]"
        return json.dumps(value)

    path = folder / "scene.toml"
    path.write_text("\n".join(f"{k} = {text(v)}" for k, v in tables.items()))
    return path


@pytest.mark.parametrize(
    "command", ["check", "run", "response", "backbone", "error-time", "sweep", "resume"]
)
def test_every_command_takes_matrices(tmp_path, command):
    changes = {"reduction": {}, "time": SHORT, "bar": "coarse", "accuracy": {"estimate": False}}
    _, tables = bar_export(tmp_path, npz, "full", "reduced", **changes)
    tables["output"] = {"plots": command == "run"}
    extra: dict[str, Any] = {
        "response": {"frequencies": {"from": 900.0, "to": 1000.0, "points": 2}},
        "backbone": {"modes": [1], "levels": 3},
        "sweep": {"joint[0].friction": [0.5, 0.7]},
    }
    tables |= {command: extra[command]} if command in extra else {}
    path, out = scene_file(tmp_path, tables), tmp_path / "out"
    options = {"error-time": ["--quick"], "sweep": ["--workers", "1"]}
    options["resume"] = ["--checkpoint-every", "10"]
    arguments = [] if command == "check" else ["--out", str(out), *options.get(command, [])]
    assert main([command.replace("resume", "run"), str(path), *arguments]) == 0
    if command == "run":
        assert {"summary.json", "history.npz", "histories.png"} <= {p.name for p in out.iterdir()}


GOOD_PAIR = "0,,,1,,,0,0,1,1e-4"


@pytest.mark.parametrize(
    ("keys", "contact", "message"),
    [
        ({"K": "none.npz"}, GOOD_PAIR, r"matrices\.K: .*none\.npz: cannot be read"),
        ({"K": "K.txt"}, GOOD_PAIR, r"matrices\.K: .*K\.txt: is of no known format.*Abaqus"),
        ({"K": "two.mat"}, GOOD_PAIR, r"matrices\.K: .*two\.mat: name one.*a, b"),
        ({"K": "two.mat:c"}, GOOD_PAIR, r"two\.mat: found no 'c'.*a, b"),
        ({"K": "flat.mtx"}, GOOD_PAIR, r"matrices\.K: flat\.mtx: found shape \(2, 3\)"),
        ({"M": "small.mtx"}, GOOD_PAIR, r"matrices\.K: K\.mtx: found shape \(3, 3\)"),
        ({"K": "skew.mtx"}, GOOD_PAIR, r"matrices\.K: skew\.mtx: is not symmetric"),
        ({"K": "negative.mtx"}, GOOD_PAIR, r"matrices\.K: negative\.mtx: is indefinite"),
        ({"M": "negative.mtx"}, GOOD_PAIR, r"matrices\.M: negative\.mtx: is not positive"),
        ({"fixed": [3]}, GOOD_PAIR, r"matrices\.fixed: found 3, must be .* from 0 to 2"),
        ({"points": {"tip": 3}}, GOOD_PAIR, r"matrices\.points\.tip: found 3"),
        ({"points": {"tip": "flat.mtx"}}, GOOD_PAIR, r"points\.tip: flat\.mtx: found shape"),
        ({"points": {"end": 2}}, GOOD_PAIR, r"load on 'tip': no point has this name.*'end'"),
        ({"fixed": [2]}, GOOD_PAIR, r"points: 'tip' is supported"),
        ({"contact": {"other": "lap.csv"}}, GOOD_PAIR, r"joint 'lap': no contact.*'other'"),
        ({}, "0,,,3,,,0,0,1,1", r"matrices\.contact\.lap: lap\.csv: pair 1.*0 to 2"),
        ({"first": 1}, "4,,,1,,,0,0,1,1", r"pair 1, found 4, .*1 to 3"),
        ({}, "0,,,0,,,0,0,1,1", r"pair 1.*must stand in it once"),
        ({}, ",,,1,,,0,0,1,1", r"pair 1.*first node must have"),
        ({}, "0,,,1,,,0,0,0,1", r"pair 1.*normal"),
        ({}, "0,,,1,,,0,0,1,-1", r"pair 1.*area"),
        ({}, "0,,,1,,,0,0,1", r"found shape \(1, 9\), must have 10"),
        ({}, GOOD_PAIR + "\nx" + GOOD_PAIR, r"lap\.csv: is damaged.*line 2"),
        ({}, GOOD_PAIR + "\n" + GOOD_PAIR, "slips depend on each other"),
        ({}, "\n".join(3 * [GOOD_PAIR]), "pair 3: other pairs of its nodes determine"),
    ],
)
def test_what_is_wrong_with_matrices_is_reported_by_key_and_file(tmp_path, keys, contact, message):
    K = np.diag([2.0, 2.0, 1.0]) - np.eye(3, k=1) - np.eye(3, k=-1)
    files = {"K": K, "M": np.eye(3), "flat": np.ones((2, 3)), "small": np.eye(2)}
    files |= {"skew": K + np.eye(3, k=1), "negative": -K}
    for name, A in files.items():
        mmwrite(tmp_path / f"{name}.mtx", A)
    savemat(tmp_path / "two.mat", {"a": K, "b": K})
    (tmp_path / "K.txt").write_text("no matrix\n")
    (tmp_path / "lap.csv").write_text(contact)
    matrices = {"K": "K.mtx", "M": "M.mtx", "contact": {"lap": "lap.csv"}, "points": {"tip": 2}}
    tables = {
        "matrices": matrices | keys,
        "joint": [{"on": "lap", "pressure": 1e6, "friction": 0.3}],
        "load": [harmonic("tip", 1.0, 1.0)],
        "time": {"cycles": 1},
    }
    with pytest.raises(sj.InputError, match=message):
        matrix_scene(tmp_path, tables)


REDUCED = {"models": {"run": ["reduced"]}}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"material": {"E": 1.0, "density": 1.0}}, r"material: found beside \[matrices\]"),
        ({"support": {"fixed": ["a"]}}, r"support: found beside \[matrices\]"),
        ({"output": {"vtk": True}}, r"output\.vtk: found true beside \[matrices\]"),
        ({"matrices": None}, "mesh: missing.*\n.*material: missing"),
        ({"reduction": {"reference": "paper"}} | REDUCED, "reduction.reference: found 'paper'"),
    ],
)
def test_tables_of_a_mesh_are_refused_beside_matrices(tmp_path, changes, message):
    tables = bar_export(tmp_path)[1] | changes
    tables = {name: table for name, table in tables.items() if table is not None}
    with pytest.raises(sj.InputError, match=message):
        matrix_scene(tmp_path, tables)


NAMES = ("upper", "lower")
Change = Callable[[np.ndarray], None]


def two_bodies(dim: int, change: Change = lambda _: None) -> sj.MatrixModel:
    """Two equal bodies on each other without supports, and the pairs of their nodes, changed."""
    how: dict[str, Any] = {"free": True, "joints": [sj.Joint("upper", 1e6, 0.3, "lower")]}
    if dim == 2:
        made = [sj.build_plate([(name, 0.1, 4)], 0.05, 2, prefix=f"{name} ") for name in NAMES]
        how["thickness"] = 0.01
    else:
        made = [
            sj.build_box([(f"{name} body", 0.1, 4)], (0.05, 0.01), (2, 1), origin=(0.0, 0.0, z),
                      boundaries={name: side}, prefix=f"{name} ")
            for name, z, side in (("upper", 0.01, "front"), ("lower", 0.0, "back"))
        ]  # fmt: skip
    structure = sj.Structure(sj.merged(made), sj.Material(2e11, 8e3, 0.3), **how)
    M, K = structure.matrices()
    contacts = pairs_of(structure)
    change(contacts["upper"])
    return sj.MatrixModel(M, K, contacts=contacts, joints=[sj.Joint("upper", 1e6, 0.3)])


def on_a_rigid_base(rows: np.ndarray) -> None:
    rows[:, 3:6] = np.nan


def swapped(rows: np.ndarray) -> None:
    rows[4, [3, 4]] = rows[4, [4, 3]]


def elsewhere(rows: np.ndarray) -> None:
    rows[[4, 5], 3:6] = rows[[5, 4], 3:6]


@pytest.mark.parametrize("dim", [2, 3])
def test_pairs_that_lie_on_each_other_raise_no_doubt(dim):
    """Nor do those on a rigid base, and of bodies that are held already: nothing tells there."""
    some = two_bodies(dim)
    spring = sparse.coo_array(([some.K.diagonal().max()], ([0], [0])), shape=some.K.shape)
    for model in (some, two_bodies(dim, on_a_rigid_base), replace(some, K=some.K + spring)):
        assert model.unusual == []


@pytest.mark.parametrize("dim", [2, 3])
@pytest.mark.parametrize("change", [swapped, elsewhere])
def test_a_pair_that_slips_as_all_moves_rigidly_is_reported(dim, change):
    some = two_bodies(dim, change)
    (doubt,) = some.unusual
    assert "pair 5 of contact.upper slips" in doubt or "pair 6 of contact.upper slips" in doubt


@pytest.mark.parametrize("table", ["points", "contact"])
def test_names_of_matrices_are_as_those_of_meshes(table, tmp_path):
    _, tables = bar_export(tmp_path)
    tables["matrices"][table] = {"tip\x1b[31m": 0 if table == "points" else "joint.csv"}
    with pytest.raises(sj.InputError) as caught:
        matrix_scene(tmp_path, tables)
    (line,) = [line for line in caught.value.problems if "control characters" in line]
    assert f"matrices.{table}." in line
    assert line.isprintable()


def test_a_chain_whose_damper_opens_runs_as_in_python(tmp_path):
    """Two masses along x, the second one pressed on a base along y with an elastic slider."""
    K = np.array([[8e4, -4e4, 0.0], [-4e4, 4e4, 0.0], [0.0, 0.0, 2e5]])
    M, C = np.diag([1.0, 1.0, 0.5]), 3e-4 * K + np.diag([0.0, 0.0, 60.0])
    np.savez(tmp_path / "chain.npz", K=K, M=M, C=C)
    (tmp_path / "damper.csv").write_text("2,3,,,,,0,1,0,1e-4,\n")
    names = {name: f"chain.npz:{name}" for name in "KMC"}
    points = {"pull": 1, "end": 2, "lift": 3}
    joint = {"on": "damper", "contact": "unilateral", "pressure": 3e6, "friction": 0.3}
    stiffness = {"normal_stiffness": 2e9, "tangential_stiffness": 2e9}
    tables = {
        "matrices": names | {"contact": {"damper": "damper.csv"}, "points": points, "first": 1},
        "joint": [joint | stiffness],
        "load": [harmonic("pull", 150.0, 15.0), harmonic("lift", 800.0, 30.0)],
        "time": {"cycles": 2, "steps_per_cycle": 100},
        "models": {"run": ["full", "condensed"]},
        "accuracy": {"estimate": False},
    }
    damper = sj.point_contact(
        [0.0, 1.0, 0.0],
        [0.0, 0.0, 1.0],
        friction=0.3,
        force=300.0,
        normal_stiffness=2e5,
        stiffness=2e5,
        name="damper",
    )
    pull, lift = (0, sj.Harmonic(150.0, 15.0)), (2, sj.Harmonic(800.0, 30.0))
    system = sj.System.from_matrices(
        M, K, C, contact=damper, loads={"pull": pull, "lift": lift}, points={"end": 1}
    )
    known = sj.integrate(system, cycles=2, steps_per_cycle=100)
    scene = matrix_scene(tmp_path, tables)
    assert known.opened.all()
    for run in sj.run_scene(scene).runs.values():
        assert run.peak_of("end") == pytest.approx(known.peak_of("end"), rel=1e-9)
        assert run.friction_energy["damper"] == pytest.approx(known.friction_energy["damper"])
    facts = " ".join(description_of(scene).facts)
    assert "Contact that opens (damper)" in facts
    assert "friction limit of the points that can slip 90 N" in facts
