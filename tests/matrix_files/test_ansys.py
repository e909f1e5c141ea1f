"""ANSYS ``.full``: the file that ansys-mapdl-reader ships, a beam of 963 equations."""

import shutil
from pathlib import Path

import numpy as np
import pytest
from scipy import linalg

from skfem_joint.ground.errors import InputError
from skfem_joint.matrix_files.reading import read_matrix

HELD = 63


@pytest.fixture
def shipped() -> Path:
    examples = pytest.importorskip("ansys.mapdl.reader.examples", exc_type=ImportError)
    return Path(examples.fullfile)


def test_a_full_file_has_stiffness_and_mass_by_node_and_direction(tmp_path, shipped):
    shutil.copy(shipped, tmp_path / "beam")  # the content tells
    K, M = (read_matrix(tmp_path, "beam", letter) for letter in "KM")
    n = 963 - HELD
    assert K.matrix.shape == M.matrix.shape == (n, n)
    assert np.array_equal(K.labels, M.labels)
    assert np.unique(K.labels[:, 1]).tolist() == [1, 2, 3]
    assert abs(K.matrix - K.matrix.T).max() == 0.0
    assert f"{HELD} unknowns that ANSYS holds are left out: 1.x" in K.notes[0]
    assert linalg.eigvalsh(M.matrix.toarray(), subset_by_index=[0, 0]) > 0.0
    # A rigid motion costs no force but at the neighbours of held nodes.
    forces = np.abs(K.matrix @ (K.labels[:, 1] == 1).astype(float))
    assert np.count_nonzero(forces > 1e-9 * K.matrix.diagonal().max()) < n // 3


def test_a_full_file_without_its_reader_names_the_extra(tmp_path, shipped, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    (tmp_path / "ansys.py").write_text("raise ImportError\n")
    with pytest.raises(InputError, match=r"pip install 'skfem-joint\[ansys\]'"):
        read_matrix(shipped.parent, shipped.name, "K")


def test_no_damping_is_read_from_a_full_file(shipped):
    with pytest.raises(InputError, match="holds no damping matrix"):
        read_matrix(shipped.parent, shipped.name, "C")
