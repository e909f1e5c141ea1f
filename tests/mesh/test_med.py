"""MED files are read with their groups, or refused with the reason."""

import contextlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from inp_files import TYPES, deck_of, mesh_of
from mesh_files import PRISM_15, boundary_sizes, read_in_a_process_of_its_own, region_sizes, saved

import skfem_joint as sj

h5py: Any = pytest.importorskip("h5py")
meshlane: Any = pytest.importorskip("meshlane")

STEP = "ENS_MAA/mesh/-0000000000000000001-0000000000000000001"
#: Two tetrahedra of 1/6 m3 and a triangle of 1/2 m2 on the first.
PLACES = [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 1.0, 1.0]]
CELLS = [
    ("tetra", [[0, 1, 2, 3]]),
    ("triangle", [[0, 1, 2]]),
    ("vertex", [[4]]),
    ("line", [[0, 1]]),
]


def write(folder: Path, sets: dict[str, list[Any]], nodes: dict[str, list[int]]) -> Path:
    """File of two tetrahedra; sets have the members of each kind of cells."""
    cells = [("tetra", [[0, 1, 2, 3], [1, 2, 3, 4]]), *CELLS[1:]]
    mesh = meshlane.Mesh(
        np.array(PLACES),
        [(kind, np.array(rows)) for kind, rows in cells],
        cell_sets={name: [np.array(own, int) for own in blocks] for name, blocks in sets.items()},
        point_sets={name: np.array(own) for name, own in nodes.items()},
    )
    meshlane.write(folder / "mesh.med", mesh)
    return folder / "mesh.med"


def test_groups_of_all_kinds_are_regions_sides_and_points(tmp_path):
    sets = {"all": [[0, 1], [], [], []], "one": [[1], [], [], []], "é face": [[], [0], [], []]}
    sets |= {"end": [[], [], [0], []], "edge": [[], [], [], [0]]}
    nodes = {"face": [0, 1, 2], "place": [3], "no side": [0, 4], "body": [0, 1, 2, 3]}
    mesh = sj.load_meshes(write(tmp_path, sets, nodes))
    volumes = {"all": 1 / 6 + 1 / 3, "one": 1 / 3}
    assert region_sizes(mesh) == pytest.approx(volumes, rel=1e-12)
    assert boundary_sizes(mesh) == pytest.approx({"é face": 0.5, "face": 0.5}, rel=1e-12)
    assert {name: mesh.coordinates[k].tolist() for name, k in mesh.points.items()} == {
        "end": PLACES[4],
        "place": PLACES[3],
    }
    said = " ".join(mesh.notes)
    assert "group 'no side' whose nodes do not make up whole sides of elements: left out" in said
    assert "group 'body' with all nodes of an element" in said
    assert "group 'edge' of lines in a solid is left out" in said


def test_cells_of_a_lower_dimension_beside_the_elements_are_left_out_with_a_note(tmp_path):
    cells = [("tetra", [[0, 1, 2, 3]]), ("triangle", [[0, 1, 2], [1, 2, 4]]), ("line", [[0, 1]])]
    mesh = meshlane.Mesh(np.array(PLACES), [(kind, np.array(rows)) for kind, rows in cells])
    meshlane.write(tmp_path / "mesh.med", mesh)
    (note,) = sj.load_meshes(tmp_path / "mesh.med").notes
    assert "1 cells of type triangle have nodes that no tetrahedron has: they are left out" in note


def test_a_name_of_several_kinds_gets_its_kinds(tmp_path):
    sets = {"part": [[0, 1], [0], [], []], "face": [[], [0], [], []], "end": [[0], [], [], []]}
    mesh = sj.load_meshes(write(tmp_path, sets, {"face": [0, 1, 2], "tip": [4]}))
    assert {*mesh.regions} == {"part (volumes)", "end"}
    assert {*mesh.boundaries} == {"part (faces)", "face (faces)", "face (nodes)"}
    assert {*mesh.points} == {"tip"}


def test_a_name_that_comes_about_twice_is_refused(tmp_path):
    sets = {"part": [[0, 1], [0], [], []], "part (faces)": [[], [0], [], []]}
    with pytest.raises(
        sj.InputError, match=r"come about twice: 'part \(faces\)'; give each its own"
    ):
        sj.load_meshes(write(tmp_path, sets, {}))


@pytest.mark.parametrize(
    "kind", [kind for kinds in TYPES.values() for kind in kinds if kind != "B32"]
)
def test_elements_of_every_kind_have_their_sizes(tmp_path, kind):
    wanted = mesh_of(next(what for what, kinds in TYPES.items() if kind in kinds), kind)
    deck = deck_of(wanted, kind)
    name = {"line": "line", "triangle": "triangle", "quadrilateral": "quad"}.get(wanted.kind)
    name = name or {"tetrahedron": "tetra", "hexahedron": "hexahedron"}[wanted.kind]
    nodes = deck.elements.shape[1]
    plain = nodes == {"line": 2, "triangle": 3, "quad": 4, "tetra": 4, "hexahedron": 8}[name]
    sets = {name: [own] for name, own in deck.regions.items()}
    raw = meshlane.Mesh(deck.xyz, [(name if plain else f"{name}{nodes}", deck.elements)],
                        cell_sets=sets)  # fmt: skip
    meshlane.write(tmp_path / "mesh.med", raw)
    mesh = sj.load_meshes(tmp_path / "mesh.med")
    assert (mesh.kind, mesh.order, mesh.notes) == (wanted.kind, wanted.order, ())
    assert region_sizes(mesh) == pytest.approx(region_sizes(wanted), rel=1e-12)


def test_prisms_of_fifteen_nodes_are_of_second_order(tmp_path):
    mesh = meshlane.Mesh(PRISM_15, [("wedge15", np.arange(15)[None])], cell_sets={"all": [[0]]})
    meshlane.write(tmp_path / "mesh.med", mesh)
    found = sj.load_meshes(tmp_path / "mesh.med")
    assert (found.kind, found.order, found.notes) == ("prism", 2, ())
    assert region_sizes(found) == pytest.approx({"all": 0.5})


@pytest.mark.parametrize("dim", [2, 3])
def test_gmsh_quadrilaterals_and_hexahedra_with_middle_nodes(tmp_path, dim):
    gmsh: Any = pytest.importorskip("gmsh")
    gmsh.initialize()
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.model.occ.addRectangle(0, 0, 0, 0.3, 0.2, 1)
        gmsh.model.occ.extrude([(2, 1)], 0, 0, 0.1, [2], recombine=True)
        gmsh.model.occ.synchronize()
        gmsh.model.addPhysicalGroup(dim, [1], name="body")
        gmsh.model.addPhysicalGroup(dim - 1, [1], name="side")
        gmsh.option.setNumber("Mesh.RecombineAll", 1)
        gmsh.option.setNumber("Mesh.MeshSizeMax", 0.1)
        for entity in gmsh.model.getEntities(1):
            gmsh.model.mesh.setTransfiniteCurve(entity[1], 3)
        for entity in gmsh.model.getEntities(2):
            gmsh.model.mesh.setTransfiniteSurface(entity[1])
        gmsh.model.mesh.generate(dim)
        gmsh.model.mesh.setOrder(2)
        for ending in ("med", "msh"):
            gmsh.write(str(tmp_path / f"mesh.{ending}"))
    finally:
        gmsh.finalize()
    med, msh = (sj.load_meshes(tmp_path / f"mesh.{ending}") for ending in ("med", "msh"))
    assert (med.kind, med.order, med.notes) == (msh.kind, 2, ())
    assert region_sizes(med) == pytest.approx({"body": 0.06 * (0.1 if dim == 3 else 1.0)})
    assert boundary_sizes(med) == pytest.approx(boundary_sizes(msh), rel=1e-12)


def changed(folder: Path, change: Callable[[Any], None]) -> sj.NamedMesh:
    path = write(folder, {"all": [[0, 1], [], [], []], "face": [[], [0], [], []]}, {})
    with h5py.File(path, "r+") as file:
        change(file)
    return sj.load_meshes(path)


def test_families_that_are_not_written_are_those_without_a_group(tmp_path):
    def change(file: Any) -> None:
        del file[f"{STEP}/MAI/TE4/FAM"]
        del file[f"{STEP}/MAI/SE2"]

    mesh = changed(tmp_path, change)
    assert not mesh.regions
    assert {*mesh.boundaries} == {"face"}
    assert "groups without members are left out: 'all'" in mesh.notes[0]


def test_results_beside_a_mesh_do_not_matter(tmp_path):
    mesh = changed(tmp_path, lambda file: file.create_group("CHA/force/1/NOE.HE8"))
    assert {*mesh.regions} == {"all"}


def put(name: str, place: int, value: float) -> Callable[[Any], None]:
    def change(file: Any) -> None:
        values = file[name][()]
        values[place] = value
        file[name][...] = values

    return change


def attribute(name: str, key: str, value: int) -> Callable[[Any], None]:
    return lambda file: file[name].attrs.__setitem__(key, value)


REFUSED = {
    "two meshes": (lambda file: file.copy("ENS_MAA/mesh", "ENS_MAA/other"), "holds 2 meshes"),
    "two steps": (lambda file: file.copy(STEP, "ENS_MAA/mesh/next"), "the first with 2 steps"),
    "a grid": (attribute("ENS_MAA/mesh", "TYP", 1), "a grid of rows and columns"),
    "polar": (attribute("ENS_MAA/mesh", "REP", 1), "coordinates that are not Cartesian"),
    "old": (attribute("INFOS_GENERALES", "MAJ", 2), "MED version 2, must be 3 or 4"),
    "pyramid": (lambda file: file.move(f"{STEP}/MAI/SE2", f"{STEP}/MAI/PY5"), "pyramids of MED"),
    "node 0": (put(f"{STEP}/MAI/TE4/NOD", 0, 0), "TE4 refer to nodes that are not in the file"),
    "node 6": (put(f"{STEP}/MAI/TR3/NOD", 0, 6), "TR3 refer to nodes that are not in the file"),
    "twice": (put(f"{STEP}/MAI/TE4/NOD", slice(None), [1, 1, 2, 2, 3, 3, 4, 4]), "count twice"),
    "no family": (put(f"{STEP}/MAI/TE4/FAM", 0, -99), "family -99 is not in the file"),
    "count": (attribute(f"{STEP}/MAI/TE4/NOD", "NBR", 3), "8 numbers, must have 3 times 4"),
    "not finite": (put(f"{STEP}/NOE/COO", 0, np.nan), "nan"),
}  # fmt: skip


@pytest.mark.parametrize("what", REFUSED)
def test_what_is_no_plain_mesh_is_refused(tmp_path, what):
    change, reason = REFUSED[what]
    with pytest.raises(sj.InputError, match=rf"mesh\.med: .*{reason}"):
        changed(tmp_path, change)


def test_a_file_that_is_no_med_file_is_refused(tmp_path):
    with pytest.raises(sj.InputError, match="it is no MED file, which begins as HDF5"):
        sj.load_meshes(saved(tmp_path, "DEBUT();\n", "mesh.med"))


def test_without_h5py_the_extra_is_named(tmp_path, monkeypatch):
    path = write(tmp_path, {"all": [[0, 1], [], [], []]}, {})
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    (tmp_path / "h5py.py").write_text("raise ImportError\n")
    with pytest.raises(sj.InputError, match=r"needs h5py: pip install 'skfem-joint\[salome\]'"):
        sj.load_meshes(path)


def test_code_in_the_current_folder_is_not_run(tmp_path):
    """By the process that reads the file."""
    path = write(tmp_path, {"all": [[0, 1], [], [], []]}, {})
    (tmp_path / "numpy.py").write_text("raise SystemExit(1)\n")
    with contextlib.chdir(tmp_path):
        assert sj.load_meshes(path).n_elements == 2


def test_prisms_of_second_order_are_the_first_thing_that_a_process_reads(tmp_path):
    mesh = meshlane.Mesh(PRISM_15, [("wedge15", np.arange(15)[None])], cell_sets={"all": [[0]]})
    meshlane.write(tmp_path / "mesh.med", mesh)
    found = read_in_a_process_of_its_own(tmp_path / "mesh.med")
    assert found.strip() == "prism 2 {'all': 1}"
