"""One bolted lap in the formats of many programs: the same model, or a refusal with its reason.

Gmsh writes its own files, MED by the library of Salome, and bulk data.
"""

import re
from collections.abc import Callable, Iterator
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from inp_files import WAYS, Writer, deck_of
from mesh_files import boundary_sizes, region_sizes

import skfem_joint as sj
from skfem_joint.body.named_parts import named_parts
from skfem_joint.scene import Scene, scene_from

#: Names of the lap, and where its faces are: axis, and place in mm.
VOLUMES = ("lower", "upper")
FACES = {
    **{"low_lap": ("lower", 2, 5.0), "up_lap": ("upper", 2, 5.0), "left": ("lower", 0, 0.0)},
    **{"right": ("upper", 0, 75.0), "nut": ("lower", 2, 0.0), "head": ("upper", 2, 10.0)},
}
#: Sizes of all parts, m3 and m2.
SIZES = {"lower": 5e-6, "upper": 5e-6, "low_lap": 5e-4, "up_lap": 5e-4, "left": 1e-4}
SIZES |= {"right": 1e-4, "nut": 5e-4, "head": 5e-4}


def build(gmsh: Any, hexahedra: bool = False) -> None:
    """Two plates of 50 x 20 x 5 mm, lapped over 25 mm, as the current model of Gmsh."""
    model, occ = gmsh.model, gmsh.model.occ
    gmsh.clear()
    for name, start, low in (("lower", 0.0, 0.0), ("upper", 25.0, 5.0)):
        halves = [occ.addBox(start + 25.0 * k, 0.0, low, 25.0, 20.0, 5.0) for k in range(2)]
        parts, _ = occ.fragment([(3, halves[0])], [(3, halves[1])])
        occ.synchronize()
        model.addPhysicalGroup(3, [tag for _, tag in parts], name=name)
    for name, (owner, axis, place) in FACES.items():
        found = set()
        for volume in model.getEntitiesForPhysicalGroup(3, 1 + VOLUMES.index(owner)):
            for _, tag in model.getBoundary([(3, volume)], oriented=False):
                centre = occ.getCenterOfMass(2, tag)
                if abs(centre[axis] - place) < 1e-6 and (axis == 0 or 25.0 < centre[0] < 50.0):
                    found.add(tag)
        model.addPhysicalGroup(2, sorted(found), name=name)
    corner = gmsh.model.getEntitiesInBoundingBox(74.9, 19.9, 9.9, 75.1, 20.1, 10.1, 0)
    model.addPhysicalGroup(0, [corner[0][1]], name="corner")
    for _, tag in model.getEntities(1):  # short decimals, which all formats hold
        box = np.reshape(model.getBoundingBox(1, tag), (2, 3))
        length = np.ptp(box, axis=0).max()
        model.mesh.setTransfiniteCurve(tag, 1 + {25: 4, 20: 2, 5: 1}[round(length)])
    for dimension, tag in model.getEntities(2) + model.getEntities(3):
        make = model.mesh.setTransfiniteSurface, model.mesh.setTransfiniteVolume
        make[dimension - 2](tag)
        if hexahedra:
            model.mesh.setRecombine(dimension, tag)
    model.mesh.generate(3)
    model.mesh.setOrder(2)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("laps")


@pytest.fixture(scope="module")
def gmsh() -> Iterator[Any]:
    library = pytest.importorskip("gmsh")
    library.initialize()
    library.option.setNumber("General.Terminal", 0)
    yield library
    library.finalize()


def written(gmsh: Any, path: Path, **options: float) -> Path:
    """File of the current model, written with options of Gmsh's meshes."""
    before = {name: gmsh.option.getNumber(f"Mesh.{name}") for name in options}
    for name, value in options.items():
        gmsh.option.setNumber(f"Mesh.{name}", value)
    gmsh.write(str(path))
    for name, value in before.items():
        gmsh.option.setNumber(f"Mesh.{name}", value)
    return path


@pytest.fixture(scope="module")
def lap(gmsh: Any, folder: Path) -> Path:
    """The lap in Gmsh's format 4.1, ASCII."""
    build(gmsh)
    return written(gmsh, folder / "lap.msh", MshFileVersion=4.1)


def of_gmsh(name: str, **options: float) -> Callable[[Any, Path, Path], Path]:
    def write(gmsh: Any, lap: Path, folder: Path) -> Path:
        gmsh.clear()
        gmsh.open(str(lap))
        return written(gmsh, folder / name, **options)

    return write


def in_parts(
    name: str, version: float, binary: int, topology: int, ghosts: int, groups: int
) -> Any:
    """The lap in three parts, with or without entities and groups between them, and ghost cells."""

    def write(gmsh: Any, lap: Path, folder: Path) -> Path:
        settings = {"Topology": topology, "GhostCells": ghosts, "Physicals": groups}
        for setting, value in settings.items():
            gmsh.option.setNumber(f"Mesh.PartitionCreate{setting}", value)
        gmsh.clear()  # Gmsh loses groups when it takes parts together
        gmsh.open(str(lap))
        gmsh.model.mesh.partition(3)
        return written(gmsh, folder / name, MshFileVersion=version, Binary=binary)

    return write


def of_abaqus(gmsh: Any, lap: Path, folder: Path) -> Path:
    deck = deck_of(sj.load_meshes(lap), "C3D10")
    return Writer(deck, WAYS["plain"]).written(folder)


FORMATS = {
    **{f"Gmsh {version}, {'binary' if binary else 'text'}":
       of_gmsh(f"a{version}{binary}.msh", MshFileVersion=version, Binary=binary)
       for version in (2.2, 4.1) for binary in (0, 1)},
    "Gmsh 4.1, all elements": of_gmsh("all.msh", MshFileVersion=4.1, SaveAll=1),
    "Abaqus": of_abaqus,
    "MED by Gmsh": of_gmsh("gmsh.med"),
    **{f"bulk data by Gmsh, {form}":
       of_gmsh(f"gmsh{k}.bdf", BdfFieldFormat=k, SaveElementTagType=2)
       for k, form in enumerate(("free", "short", "long"))},
}  # fmt: skip
PARTS = {
    f"Gmsh {version}, {'binary' if binary else 'text'}, in parts, {settings}":
    in_parts(f"parts{version}{binary}{settings}.msh", version, binary, *settings)
    for version, binary, settings in product((2.2, 4.1), (0, 1), product((0, 1), repeat=3))
}  # fmt: skip


def names_in(path: Path) -> dict[str, str]:
    """What the names of the lap are in a file."""
    if path.suffix == ".bdf":
        names = [f"PSOLID_{k}" for k in (1, 2)] + [f"PSHELL_{k}" for k in range(3, 9)]
        return dict(zip([*VOLUMES, *FACES], names, strict=True))
    return {name: name for name in SIZES}


def scene(path: Path) -> Scene:
    """The lap with a bolt, held at both ends and pulled under its head."""
    of = names_in(path)
    return scene_from(
        {
            "material": {"E": 200e9, "density": 7850.0, "poisson": 0.3},
            "support": {"fixed": [of["left"], of["right"]]},
            "joint": [{"on": of["up_lap"], "against": of["low_lap"],
                       "pressure": "preload", "friction": 0.3}],
            "bolt": [{"head": of["head"], "nut": of["nut"], "force": 5e3}],
            "load": [{"on": of["head"], "direction": [1.0, 0.0, 0.0], "kind": "harmonic",
                      "amplitude": 100.0, "frequency": 100.0}],
            "time": {"cycles": 1},
        },
        sj.load_meshes(path, 1e-3),
        path.with_suffix(".toml"),
    )  # fmt: skip


def check_sizes(mesh: sj.NamedMesh, path: Path) -> None:
    """All names are there, with their areas and volumes."""
    found, of = region_sizes(mesh) | boundary_sizes(mesh), names_in(path)
    assert found.keys() == set(of.values())
    for name, size in SIZES.items():
        assert found[of[name]] == pytest.approx(size, rel=1e-9)
    assert len(mesh.points) == (path.suffix != ".bdf")


def quantities(path: Path) -> tuple[np.ndarray, np.ndarray, set[tuple[str, str]]]:
    """Frequencies, resultants of the preload, and what `check` says of the names."""
    lap = scene(path)
    structure, system = lap.structure(), lap.system()
    of = {value: name for name, value in names_in(path).items()}
    parts = re.findall(r"(\w+) (\(\d+ \w+, [^)]*\))", " ".join(named_parts(structure.body)))
    listed = {(of[name], text) for name, text in parts}
    modes = [
        sj.natural_modes(system, 4, joints=joints).frequencies for joints in ("loose", "stuck")
    ]
    normal = sum(patch.normal_force.sum() for patch in structure.patches)
    limits = system.contact.w.sum()
    return np.concatenate(modes), np.array([normal, limits]), listed


@pytest.mark.parametrize("write", FORMATS.values(), ids=FORMATS)
def test_one_lap_is_the_same_in_all_formats(gmsh, lap, folder, write):
    path = write(gmsh, lap, folder)
    check_sizes(sj.load_meshes(path, 1e-3), path)
    frequencies, resultants, listed = quantities(path)
    right = quantities(lap)
    assert frequencies == pytest.approx(right[0], rel=1e-6)
    assert resultants == pytest.approx(right[1], rel=1e-9)
    assert listed == right[2]


@pytest.mark.parametrize("write", PARTS.values(), ids=PARTS)
def test_a_partitioned_lap_is_the_whole_one(gmsh, lap, folder, write):
    """With and without entities and groups between parts, and ghost cells."""
    path = write(gmsh, lap, folder)
    check_sizes(sj.load_meshes(path, 1e-3), path)


@pytest.mark.parametrize("name", ["mix8_lower", "mix20_lower"])
def test_prisms_beside_hexahedra_are_the_same_in_all_formats(gmsh, tmp_path, name):
    source = Path(__file__).parents[1] / "scene" / "gmsh" / f"{name}.msh"
    right = sj.load_meshes(source)
    gmsh.clear()
    gmsh.open(str(source))
    for ending in ("med", "bdf"):
        path = tmp_path / f"mesh.{ending}"
        found = sj.load_meshes(written(gmsh, path, SaveElementTagType=2, BdfFieldFormat=2))
        assert (found.kind, found.order) == (right.kind, right.order)
        for sizes_of in (region_sizes, boundary_sizes):
            sizes = sizes_of(found)
            if ending == "med":
                assert sizes == pytest.approx(sizes_of(right), rel=1e-9)
            assert sorted(sizes.values()) == pytest.approx(sorted(sizes_of(right).values()))
