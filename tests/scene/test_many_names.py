"""Very many names and very long ones are refused in a sentence, or read in reasonable time.

Before these bounds the cases here took hours or ended in a traceback.
"""

from pathlib import Path

import numpy as np
import pytest
from mesh_files import msh22
from scene_texts import written

import skfem_joint as sj

MOST_NAMES, LONGEST_NAME = 10_000, 127


def bar_of(count: int, folder: Path, longest: str = "") -> Path:
    """Mesh file of a bar each of whose elements is a group of its own."""
    nodes = [(0.001 * i, 0.0, 0.0) for i in range(count + 1)]
    cells = [(1, i, (i, i + 1)) for i in range(1, count + 1)]
    names = "".join(f'1 {i} "g{i}{longest}"\n' for i in range(1, count + 1))
    path = folder / "bar.msh"
    path.write_text(msh22(nodes, cells, names), encoding="utf-8")
    return path


def test_a_mesh_of_as_many_groups_as_are_allowed_keeps_each(tmp_path):
    mesh = sj.load_meshes([bar_of(MOST_NAMES, tmp_path)])
    assert len(mesh.regions) == MOST_NAMES
    assert all(mesh.regions[f"g{i + 1}"].tolist() == [i] for i in range(MOST_NAMES))


def test_a_mesh_of_200_000_groups_is_refused(tmp_path):
    with pytest.raises(sj.InputError, match=rf"200000 named groups, must be at most {MOST_NAMES}"):
        sj.load_meshes([bar_of(200_000, tmp_path)])


@pytest.mark.parametrize("names", [("end",), tuple(f"{i:x}" for i in range(50_000))])
def test_a_list_of_very_many_names_is_refused(tmp_path, names):
    count = 140_000 if len(names) == 1 else len(names)
    points = ", ".join(f'"{name}"' for name in (count // len(names)) * names)
    path = written(tmp_path, ("every = 1", f"points = [{points}]"))
    message = rf"output\.points: found {count} names, must be at most 1000"
    with pytest.raises(sj.InputError, match=message):
        sj.load_scene(path)


@pytest.mark.parametrize("more", [0, 1, 100_000])
def test_names_are_no_longer_than_those_of_gmsh(tmp_path, more):
    """Archives of results cannot hold names of 65,536 characters."""
    name = (LONGEST_NAME + more) * "x"
    path = bar_of(1, tmp_path, longest=name[2:])
    if not more:
        assert [*sj.load_meshes([path]).regions] == ["g1" + name[2:]]
        return
    message = rf"found {len(name)} characters, must be at most {LONGEST_NAME}"
    with pytest.raises(sj.InputError, match=message) as caught:
        sj.load_meshes([path])
    assert len(str(caught.value)) < 1000
    with pytest.raises(sj.InputError, match=message):
        sj.MatrixModel(np.eye(2), np.eye(2), points={name: np.eye(2)[0]})
    with pytest.raises(sj.InputError, match=message):
        sj.MatrixModel(np.eye(2), np.eye(2), contacts={name: np.zeros((0, 10))})
