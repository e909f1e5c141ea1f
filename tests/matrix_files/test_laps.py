"""One lap as many programs write its matrices: frequencies and resultants are the same.

CalculiX 2.20 has written the matrices of ``calculix/lap.inp``, and its own natural frequencies.
"""

import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matrix_writers import abaqus_rows, coordinates, dmig, substructure
from scipy import linalg, sparse
from scipy.io import mmwrite

import skfem_joint as sj
from skfem_joint.matrix_files.reading import read_matrix
from skfem_joint.scene import Scene, scene_from
from skfem_joint.study.description import description_of

HERE = Path(__file__).parent / "calculix"
#: Natural frequencies of the two blocks by CalculiX (Hz), in pairs.
BY_CALCULIX = (3134.085, 5346.937, 7826.439)
PAIRS = ((11, 101), (12, 102), (15, 105), (16, 106))
LAP = "".join(f"{upper},{lower},0,0,1,100\n" for lower, upper in PAIRS)  # mm2
Write = Callable[[Path, Any, Any, np.ndarray], dict[str, Any]]


def stored() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """K and M in N/mm and t, and nodes and directions, read without the package."""
    matrices = []
    for ending in ("sti", "mas"):
        i, j, value = np.loadtxt(HERE / f"lap.{ending}").T
        half = np.zeros((72, 72))
        half[i.astype(int) - 1, j.astype(int) - 1] = value
        matrices.append(half + np.triu(half, 1).T)
    named = (HERE / "lap.dof").read_text().split()
    return *matrices, np.array([[int(x) for x in name.split(".")] for name in named])


def scene(folder: Path, tables: dict[str, Any], **joint: Any) -> Scene:
    contact = folder / "lap.csv"
    if not contact.exists():
        contact.write_text(LAP)
    matrices = {"contact": {"lap": "lap.csv"}, "points": {"tip": "104.z"}, "units": "mm t s"}
    matrices["points"] = {"tip": "103.z"}
    load = {"on": "tip", "kind": "harmonic", "amplitude": 10.0, "frequency": 500.0}
    return scene_from(
        {
            "matrices": matrices | tables,
            "joint": [{"on": "lap", "pressure": 5e6, "friction": 0.3} | joint],
            "load": [load],
            "time": {"cycles": 1, "steps_per_cycle": 50},
            "models": {"run": ["full"]},
        },
        None,
        folder / "scene.toml",
    )


def of_calculix(folder: Path, K: Any, M: Any, labels: np.ndarray) -> dict[str, Any]:
    for ending in ("sti", "mas", "dof"):
        shutil.copy(HERE / f"lap.{ending}", folder)
    return {"K": "lap.sti", "M": "lap.mas", "unknowns": "lap.dof"}


def rows_of_abaqus(half: str) -> Write:
    def write(folder: Path, K: Any, M: Any, labels: np.ndarray) -> dict[str, Any]:
        abaqus_rows(folder / "lap_STIF1.mtx", K, labels, half)
        abaqus_rows(folder / "lap_MASS1.mtx", M, labels, half)
        return {"K": "lap_STIF1.mtx", "M": "lap_MASS1.mtx"}

    return write


def coordinates_of_abaqus(folder: Path, K: Any, M: Any, labels: np.ndarray) -> dict[str, Any]:
    coordinates(folder / "K.mtx", K)
    coordinates(folder / "M.mtx", M)
    np.savetxt(folder / "names.csv", labels, fmt="%d", delimiter=", ")
    return {"K": "K.mtx", "M": "M.mtx", "unknowns": "names.csv"}


def substructure_of_abaqus(folder: Path, K: Any, M: Any, labels: np.ndarray) -> dict[str, Any]:
    substructure(folder / "lap.mtx", {"STIFFNESS": K, "MASS": M}, labels)
    return {"K": "lap.mtx", "M": "lap.mtx"}


def punch(free: bool) -> Write:
    def write(folder: Path, K: Any, M: Any, labels: np.ndarray) -> dict[str, Any]:
        dmig(folder / "lap.pch", {"KAAX": K, "MAAX": M}, labels, free)
        return {"K": "lap.pch:KAAX", "M": "lap.pch:MAAX"}

    return write


def op4(binary: bool, form: str, **options: Any) -> Write:
    def write(folder: Path, K: Any, M: Any, labels: np.ndarray) -> dict[str, Any]:
        library = pytest.importorskip("pyyeti.nastran.op4")
        matrices = {"KAA": K, "MAA": M}
        if form != "dense":
            matrices = {name: sparse.coo_matrix(A) for name, A in matrices.items()}
        library.write(str(folder / "lap.op4"), matrices, binary=binary, sparse=form, **options)
        np.savetxt(folder / "names.csv", labels, fmt="%d", delimiter=", ")
        return {"K": "lap.op4:KAA", "M": "lap.op4:maa", "unknowns": "names.csv"}

    return write


def market(folder: Path, K: Any, M: Any, labels: np.ndarray) -> dict[str, Any]:
    """MatrixMarket by another ending: the content tells."""
    mmwrite(folder / "K.mtx", sparse.coo_array(K), precision=17)
    sparse.save_npz(folder / "M.npz", sparse.csr_array(M))
    (folder / "K.mtx").rename(folder / "K.stiffness")
    (folder / "M.npz").rename(folder / "M")
    np.savetxt(folder / "names.csv", labels, fmt="%d", delimiter=", ")
    return {"K": "K.stiffness", "M": "M", "unknowns": "names.csv"}


WRITERS = {
    "CalculiX": of_calculix,
    **{
        f"Abaqus rows, {half}": rows_of_abaqus(half)
        for half in ("whole", "lower", "upper", "other")
    },
    "Abaqus coordinates": coordinates_of_abaqus,
    "Abaqus substructure": substructure_of_abaqus,
    "DMIG": punch(free=False),
    "DMIG, free": punch(free=True),
    **{
        f"OUTPUT4, {'binary' if binary else 'text'}, {form}": op4(binary, form)
        for binary in (True, False)
        for form in ("dense", "bigmat", "nonbigmat")
    },
    "OUTPUT4, big-endian": op4(True, "bigmat", endian=">"),
    "MatrixMarket and npz": market,
}


@pytest.mark.parametrize("write", WRITERS.values(), ids=WRITERS)
def test_one_lap_is_the_same_in_all_formats(tmp_path, write):
    K, M, labels = stored()
    lap = scene(tmp_path, write(tmp_path, K, M, labels))
    model = lap.structure()
    # In SI units, in the order of the files of CalculiX.
    order = [labels.tolist().index(label) for label in model.labels.tolist()]
    assert model.K.toarray() == pytest.approx(1e3 * K[order][:, order], rel=2e-9, abs=1e-5)
    along = np.equal(model.labels[:, 1], 3).astype(float)
    assert along @ model.M @ along == pytest.approx(1e3 * M[2::3, 2::3].sum(), rel=1e-9)
    (patch,) = model.patches
    assert patch.normal_force.sum() == pytest.approx(5e6 * 4e-4, rel=1e-9)
    assert lap.system().contact.w.sum() == pytest.approx(0.3 * 5e6 * 4e-4, rel=1e-9)
    values = description_of(lap).values
    assert values["frequencies_stuck_Hz"] == pytest.approx(stuck(K, M, labels)[:3], rel=1e-6)
    loose = sj.natural_modes(lap.system(), 3).frequencies
    assert loose == pytest.approx(without_slip(K, M, labels, (3,))[:3], rel=1e-6)


def stuck(K: np.ndarray, M: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """Natural frequencies with both nodes of each pair moving as one, Hz."""
    return without_slip(K, M, labels, (1, 2, 3))


def without_slip(K: Any, M: Any, labels: np.ndarray, directions: tuple[int, ...]) -> np.ndarray:
    number = {tuple(label): k for k, label in enumerate(labels.tolist())}
    T = np.eye(72)
    for lower, upper in PAIRS:
        for direction in directions:
            T[number[upper, direction], number[lower, direction]] = 1.0
    gone = [number[upper, x] for _, upper in PAIRS for x in directions]
    T = np.delete(T, gone, axis=1)
    return np.sqrt(linalg.eigvalsh(T.T @ K @ T, T.T @ M @ T)) / (2.0 * np.pi)


def test_the_blocks_have_calculix_s_own_frequencies(tmp_path):
    """Without the contact, which holds what CalculiX leaves free."""
    lap = scene(tmp_path, of_calculix(tmp_path, *stored()))
    model = lap.structure()
    squares = linalg.eigvalsh(model.K.toarray(), model.M.toarray())
    own = np.sqrt(squares[:6]) / (2.0 * np.pi)
    assert own == pytest.approx(np.repeat(BY_CALCULIX, 2), rel=1e-6)


@pytest.mark.skipif(shutil.which("ccx") is None, reason="CalculiX is not installed")
def test_calculix_writes_the_files_of_this_test(tmp_path):
    shutil.copy(HERE / "lap.inp", tmp_path)
    subprocess.run(["ccx", "lap"], cwd=tmp_path, capture_output=True, check=True)
    for ending in ("sti", "mas", "dof"):
        theirs, kept = (np.loadtxt(folder / f"lap.{ending}") for folder in (tmp_path, HERE))
        assert theirs == pytest.approx(kept, rel=1e-9, abs=1e-9 * np.abs(kept).max())


@pytest.mark.skipif(shutil.which("ccx") is None, reason="CalculiX is not installed")
def test_substructures_of_calculix_are_read(tmp_path):
    """Numbers are those of the lower half in the file, in the order of the retained unknowns."""
    text = (HERE / "lap.inp").read_text()
    step = (
        "*SUBSTRUCTURE GENERATE\n*RETAINED NODAL DOFS\n11, 1, 3\n12, 1, 3\n15, 1, 3\n"
        "*SUBSTRUCTURE MATRIX OUTPUT, STIFFNESS=YES, OUTPUT FILE=USER DEFINED, FILE NAME=small\n"
    )
    head = text[: text.index("*FREQUENCY")]
    (tmp_path / "sub.inp").write_text(head + step + "*END STEP\n")
    subprocess.run(["ccx", "sub"], cwd=tmp_path, capture_output=True, check=True)
    small = read_matrix(tmp_path, "small.mtx", "K")
    assert small.labels.tolist() == [[node, x] for node in (11, 12, 15) for x in (1, 2, 3)]
    numbers = (tmp_path / "small.mtx").read_text().partition("STIFFNESS")[2].replace(",", " ")
    half = np.zeros((9, 9))
    half[np.tril_indices(9)] = [float(x) for x in numbers.split()]
    assert small.matrix.toarray() == pytest.approx(half + np.tril(half, -1).T, rel=1e-15)
