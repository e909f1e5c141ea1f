"""Units, names of unknowns, halves, boundary conditions and modes of other programs' matrices."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matrix_writers import abaqus_rows, dmig, substructure
from scipy import linalg, sparse
from test_laps import LAP, PAIRS, scene, stored, stuck

import skfem_joint as sj
from skfem_joint.matrix_files.reading import read_matrix
from skfem_joint.matrix_files.units import SYSTEMS, in_si
from skfem_joint.study.description import description_of


def written(folder: Path, text: str, name: str = "K.mtx") -> str:
    (folder / name).write_text(text)
    return name


# Units


@pytest.mark.parametrize("units", SYSTEMS)
def test_a_beam_in_any_units_has_the_same_frequencies_and_stiffness_in_si(units):
    """A cantilever of one element: deflection and rotation of its end."""
    E, inertia, length, mass = 210e9, 2e-9, 0.3, 1.7  # Pa, m4, m, kg

    def matrices(E, inertia, L, m):
        k = E * inertia / L**3
        K = k * np.array([[12.0, -6.0 * L], [-6.0 * L, 4.0 * L**2]])
        M = m / 420.0 * np.array([[156.0, -22.0 * L], [-22.0 * L, 4.0 * L**2]])
        return {"K": sparse.csr_array(K), "M": sparse.csr_array(M)}

    metre, kilogram, second = SYSTEMS[units]
    pascal = kilogram / metre / second**2
    given = matrices(E / pascal, inertia / metre**4, length / metre, mass / kilogram)
    labels = np.array([[7, 3], [7, 5]])
    converted = in_si(given, labels, units)
    for letter, expected in matrices(E, inertia, length, mass).items():
        assert converted[letter].toarray() == pytest.approx(expected.toarray(), rel=1e-12)
    damping = in_si({"C": given["K"]}, labels, units)["C"]
    assert damping.toarray() == pytest.approx(converted["K"].toarray() * second, rel=1e-12)


def test_the_mass_along_each_axis_is_told_in_kg(tmp_path):
    """By which wrong units are seen: frequencies alone do not show them."""
    K, M, labels = stored()
    dmig(tmp_path / "lap.pch", {"KAAX": K, "MAAX": M}, labels)
    told = scene(tmp_path, {"K": "lap.pch:KAAX", "M": "lap.pch:MAAX"}).structure().overview()
    for number, axis in enumerate("xyz", 1):
        along = labels[:, 1] == number
        assert f"{1e3 * M[np.ix_(along, along)].sum():.4g} kg along {axis}" in told


def test_unknown_units_are_refused(tmp_path):
    with pytest.raises(sj.InputError, match=r"matrices\.units: .*'mm t s'"):
        scene(tmp_path, {"K": "K", "M": "M", "units": "mm g s"})


# Halves, and what is not symmetric

HALF = "1,1, 1,1, 2.\n1,1, 1,2, -1.\n1,2, 1,2, 3.\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (HALF + "1,2, 1,1, -1.5\n", r"not symmetric: -1 for 1.x and 1.y, -1.5 the other way round"),
        (HALF + "1,2, 1,2, 3.\n", "lines 3 and 4: both give the entry of 1.y and 1.y"),
        (HALF + "1,7, 1,2, 3.\n", "line 4: found degree of freedom 7 of node 1, must be 1 to 6"),
        (HALF + "1,2, 1,2, 3,\n", "line 4: found '1,2, 1,2, 3,'|both give"),
        (HALF + "1,3, 1,3 1e999\n", "line 4: found a number too large"),
        (HALF + "1,3, 1,3, nan\n", "line 4: found '1,3, 1,3, nan', must be row node"),
        (HALF + "1,3, 1,3, 1,5\n", "line 4: found '1,3, 1,3, 1,5', must be row node"),
        (HALF + "1,3, 1,3, 1.5", "the last line does not end"),
        ("1 1 2.0\n3 3 1.0\n", "has no entry of row 2, must have some of each of 3"),
        ("1 1 2.0\n-1 -1 1.0\n", "line 2: found row or column -1"),
        ("1 2 3 4\n", "is of no known format, or damaged; known are"),
        ("\0\1\2", "is of no known format"),
        ("", "the last line does not end"),
    ],
)
def test_what_is_wrong_in_rows_is_named_with_its_line(tmp_path, text, message):
    with pytest.raises(sj.InputError, match=message) as caught:
        read_matrix(tmp_path, written(tmp_path, text), "K")
    assert str(caught.value).startswith(str(tmp_path / "K.mtx"))


def test_fortran_s_exponents_and_comments_are_read(tmp_path):
    text = "** of a program\n1,1, 1,1, 2.5D+03\n\n 1 1  1 2 -.5-101\r\n1,2,1,2,+1.d0,\n"
    given = read_matrix(tmp_path, written(tmp_path, text), "K")
    assert given.matrix.toarray().tolist() == [[2500.0, -0.5e-101], [-0.5e-101, 1.0]]
    assert given.labels.tolist() == [[1, 1], [1, 2]]


@pytest.mark.parametrize("first", [0, 1])
def test_rows_count_from_0_or_1(tmp_path, first):
    text = f"{first} {first} 2.0\n{first + 1} {first} -1.0\n{first + 1} {first + 1} 3.0\n"
    given = read_matrix(tmp_path, written(tmp_path, text), "K")
    assert given.matrix.toarray().tolist() == [[2.0, -1.0], [-1.0, 3.0]]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("NODES= 24", "NODES= 23"), "found NODES=23, but 24 nodes are listed"),
        (("*MATRIX, TYPE=MASS", "*MATRIX, TYPE=STIFFNESS"), "found two \\*MATRIX of one TYPE"),
        (("*MATRIX, TYPE=MASS", "*DLOAD"), "found \\*DLOAD, must be"),
        (
            ("TYPE=STIFFNESS", "TYPE=MASSES"),
            r"has no \*MATRIX, TYPE=STIFFNESS; it has MASSES, MASS",
        ),
        (("LINEAR", "LINEAR, UNSYMM"), "found UNSYMM"),
        (("2, 1, 2, 3", "99, 1, 2, 3"), "must be the position of a node, 1 to"),
        (("e+0", "x+0"), "must be numbers"),
    ],
)
def test_what_is_wrong_in_a_substructure_is_named(tmp_path, change, message):
    K, M, labels = stored()
    substructure(tmp_path / "K.mtx", {"STIFFNESS": K, "MASS": M}, labels)
    text = (tmp_path / "K.mtx").read_text()
    assert change[0] in text
    written(tmp_path, text.replace(change[0], change[1], 1))
    with pytest.raises(sj.InputError, match=message):
        read_matrix(tmp_path, "K.mtx", "K")


# Names of unknowns, in matrices and in the tables of a scene


def rows_of_lap(folder: Path, **tables: Any) -> dict[str, Any]:
    K, M, labels = stored()
    abaqus_rows(folder / "K.mtx", K, labels)
    abaqus_rows(folder / "M.mtx", M, labels)
    return {"K": "K.mtx", "M": "M.mtx"} | tables


@pytest.mark.parametrize(
    ("tables", "message"),
    [
        ({"first": 1}, "first: found 1, but the files name their unknowns"),
        ({"points": {"tip": 3}}, r"matrices\.points\.tip: found 3, .* as '3.x'"),
        ({"points": {"tip": "103"}}, r"points\.tip: found '103', must have a direction"),
        (
            {"points": {"tip": "1.x"}},
            "points.tip: found node 1, direction 1, of which the matrices",
        ),
        ({"fixed": [1]}, "fixed: the matrices have no unknown of node 1"),
        ({"fixed": "odd.csv"}, "fixed: .*the matrices have no unknown of node 2.5"),
        ({"fixed": "wide.csv"}, r"fixed: .*found shape \(1, 3\), must be nodes, in a second col"),
        ({"points": {"tip": "odd.csv"}}, r"points.tip: .*found shape \(1, 1\), must be rows of n"),
        ({"fixed": ["103.rx"]}, "fixed: found node 103, direction 4, of which"),
        ({"fixed": ["wall"]}, "fixed.* found 'wall', must be a node"),
        ({"contact": {"lap": "old.csv"}}, "contact.lap: .*must have 6 columns, since"),
        ({"contact": {"lap": "held.csv"}}, "contact.lap: .*no unknown of node 13; leave"),
        ({"contact": {"lap": "half.csv"}}, "contact.lap: .*pair 1, found 11.5, 101, must be num"),
        ({"M": "small.mtx"}, "M: lacks unknowns that K has: 2.x, 2.y"),
        ({"M": "more.mtx"}, "M: has unknowns that K has not: 999.x"),
        ({"M": "M.npz"}, r"M: .npz does not name its unknowns, but K \(the text of Abaqus"),
        ({"unknowns": "names"}, "unknowns: found beside K, whose file names its unknowns"),
    ],
)
def test_what_is_wrong_with_names_is_named(tmp_path, tables, message):
    _, M, labels = stored()
    written(tmp_path, "0,,,1,,,0,0,1,1\n", "old.csv")
    written(tmp_path, "11,13,0,0,1,1\n", "held.csv")
    written(tmp_path, "11.5,101,0,0,1,1\n", "half.csv")
    written(tmp_path, "2.5\n", "odd.csv")
    written(tmp_path, "2,3,103\n", "wide.csv")
    written(tmp_path, "1.1\n", "names")
    abaqus_rows(tmp_path / "small.mtx", M[3:, 3:], labels[3:])
    more = linalg.block_diag(M, [[1.0]])
    abaqus_rows(tmp_path / "more.mtx", more, np.vstack([labels, [999, 1]]))
    sparse.save_npz(tmp_path / "M.npz", sparse.csr_array(M))
    with pytest.raises(sj.InputError, match=message):
        scene(tmp_path, rows_of_lap(tmp_path, **tables)).structure()


def test_nodes_directions_and_tables_of_them_hold_and_load_what_they_say(tmp_path):
    written(tmp_path, "103, 3, 0.25\n107, 3, 0.75\n", "pull.csv")
    written(tmp_path, "2\n3\n", "nodes.csv")
    written(tmp_path, "2, 1\n2, 2\n2, 3\n3, 1\n3, 2\n3, 3\n", "directions.csv")
    models = []
    for fixed in ([2, "3.x", "3.2", "3.z"], "nodes.csv", "directions.csv"):
        tables = {"fixed": fixed, "points": {"tip": "pull.csv", "end": "103.2"}}
        models.append(scene(tmp_path, rows_of_lap(tmp_path, **tables)).structure())
    expected = [k for k, label in enumerate(models[0].labels.tolist()) if label[0] in (2, 3)]
    assert all(model.fixed.tolist() == expected for model in models)
    weights = dict(zip(map(tuple, models[0].labels.tolist()), models[0].points["tip"], strict=True))
    assert {place: x for place, x in weights.items() if x} == {(103, 3): 0.25, (107, 3): 0.75}
    assert models[0].spot(int(models[0].points["end"].argmax())) == "unknown 103.y"


def test_names_need_files_that_have_them(tmp_path):
    K, M, _ = stored()
    np.savez(tmp_path / "lap.npz", K=K, M=M)
    tables = {"K": "lap.npz:K", "M": "lap.npz:M", "contact": {}}
    with pytest.raises(sj.InputError, match=r"found '103\.z', but the files do not name"):
        scene(tmp_path, tables)
    written(tmp_path, "1.1\n" * 2, "names")
    with pytest.raises(sj.InputError, match=r"unknowns: .*found 1.x more than once"):
        scene(tmp_path, tables | {"unknowns": "names"})
    written(tmp_path, "1.1\n1.2\n", "names")
    with pytest.raises(sj.InputError, match="found 2 lines, must be one for each of the 72 rows"):
        scene(tmp_path, tables | {"unknowns": "names"})


def test_a_pair_with_no_second_node_is_pressed_on_a_rigid_base(tmp_path):
    written(tmp_path, LAP.replace(",11,", ",,").replace(",12,", ",,"), "lap.csv")
    (patch,) = scene(tmp_path, rows_of_lap(tmp_path)).structure().patches
    (rows,) = scene(tmp_path, rows_of_lap(tmp_path)).structure().contacts.values()
    assert np.isnan(rows[:, 3:6]).all(axis=1).tolist() == [True, True, False, False]
    assert patch.normal_force == pytest.approx(np.full(4, 500.0))


# Boundary conditions


def test_boundary_conditions_of_abaqus_hold_their_unknowns(tmp_path):
    """1e36 on the diagonal of K: the frequencies are those of the held structure."""
    K, M, labels = stored()
    node = np.flatnonzero(labels[:, 0] == 103)
    penalised = K.copy()
    penalised[node, node] = 1e36
    abaqus_rows(tmp_path / "K.mtx", penalised, labels)
    abaqus_rows(tmp_path / "M.mtx", M, labels)
    tables = {"K": "K.mtx", "M": "M.mtx", "points": {"tip": "107.z"}}
    held = scene(tmp_path, tables)
    others = scene(tmp_path, rows_of_lap(tmp_path, points={"tip": "107.z"}, fixed=[103]))
    a, b = (sj.natural_modes(x.system(), 6).frequencies for x in (held, others))
    assert a == pytest.approx(b, rel=1e-9)
    (note,) = [note for note in held.system().notes if "1e36" in note]
    assert "3 unknowns have 1e36 on the diagonal of K" in note
    assert "103.x, 103.y, 103.z" in note


# Internal unknowns


def with_internal(stiffness: float) -> tuple[np.ndarray, np.ndarray]:
    """K of the lap with four internal unknowns q, of energy stiffness/2 |q - B u|^2 with any B."""
    K, _, labels = stored()
    B = np.random.default_rng(3).normal(size=(4, 72))
    internal = np.array([[-1, 1], [-1, 2], [-2, 1], [-3, 1]])
    corner = stiffness * np.diag([1.0, 2.0, 3.0, 4.0])
    corner[0, 1] = corner[1, 0] = 0.5 * stiffness
    whole = np.block([[K + B.T @ corner @ B, -B.T @ corner], [-corner @ B, corner]])
    return whole, np.vstack([labels, internal])


def test_internal_unknowns_without_mass_are_eliminated_exactly(tmp_path):
    K, M, labels = stored()
    whole, names = with_internal(3e4)
    abaqus_rows(tmp_path / "K.mtx", whole, names, "other")
    abaqus_rows(tmp_path / "M.mtx", M, labels)
    model = scene(tmp_path, {"K": "K.mtx", "M": "M.mtx"}).structure()
    order = [labels.tolist().index(label) for label in model.labels.tolist()]
    assert model.K.toarray() == pytest.approx(1e3 * K[order][:, order], abs=1e-9 * 1e3 * K.max())
    assert "4 internal unknowns of the other program have no mass" in model.remarks[0]
    assert "-3.x, -2.x, -1.x, -1.y" in model.remarks[0]


def test_internal_unknowns_that_cannot_be_eliminated_are_refused(tmp_path):
    _, M, labels = stored()
    whole, names = with_internal(3e4)
    whole[-1] = whole[:, -1] = 0.0
    whole[0, -1] = whole[-1, 0] = 1.0
    abaqus_rows(tmp_path / "K.mtx", whole, names)
    abaqus_rows(tmp_path / "M.mtx", M, labels)
    with pytest.raises(
        sj.InputError, match=r"M: lacks internal unknowns of K \(-3.x, -2.x.*singular"
    ):
        scene(tmp_path, {"K": "K.mtx", "M": "M.mtx"})


# Fixed-interface modes


def condensed(modes: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """K, M, names and fixed-interface frequencies (Hz) of a superelement of the lap."""
    K, M, labels = stored()
    kept = np.flatnonzero(np.isin(labels[:, 0], [*np.ravel(PAIRS), 103]))
    rest = np.setdiff1d(np.arange(72), kept)
    squares, shapes = linalg.eigh(K[np.ix_(rest, rest)], M[np.ix_(rest, rest)])
    T = np.zeros((72, kept.size + modes))
    T[kept, : kept.size] = np.eye(kept.size)
    T[rest, : kept.size] = -np.linalg.solve(K[np.ix_(rest, rest)], K[np.ix_(rest, kept)])
    T[rest, kept.size :] = shapes[:, :modes]
    scalar = np.stack([5001 + np.arange(modes), np.zeros(modes, dtype=int)], axis=1)
    own = np.sqrt(squares[:modes]) / (2.0 * np.pi)
    return T.T @ K @ T, T.T @ M @ T, np.vstack([labels[kept], scalar]), own


def superelement(folder: Path, form: str, modes: int) -> dict[str, Any]:
    K, M, labels, _ = condensed(modes)
    if form == "Abaqus":
        substructure(folder / "lap.mtx", {"STIFFNESS": K, "MASS": M}, labels, modes)
        return {"K": "lap.mtx", "M": "lap.mtx"}
    dmig(folder / "lap.pch", {"KAAX": K, "MAAX": M}, labels, free=True)
    return {"K": "lap.pch:KAAX", "M": "lap.pch:MAAX"}


@pytest.mark.parametrize("form", ["Abaqus", "Nastran"])
def test_modes_of_a_superelement_are_used_as_they_are(tmp_path, form):
    """With all of them nothing is lost; with few, frequencies come from above."""
    exact = stuck(*stored())[:3]
    whole = description_of(scene(tmp_path, superelement(tmp_path, form, 72 - 27)))
    assert whole.values["frequencies_stuck_Hz"] == pytest.approx(exact, rel=1e-6)
    few = description_of(scene(tmp_path, superelement(tmp_path, form, 6)))
    frequencies = np.array(few.values["frequencies_stuck_Hz"])
    assert np.all(frequencies > exact * (1.0 - 1e-9))
    assert frequencies == pytest.approx(exact, rel=0.02)
    first, last = condensed(6)[3][[0, -1]]
    assert "6 unknowns are fixed-interface modes of the other program" in few.facts[0]
    assert f"of {first:.5g} to {last:.5g} Hz" in few.facts[0]
    assert f"serve up to some {2.0 / 3.0 * last:.4g} Hz" in few.facts[0]


def test_a_load_beyond_the_modes_is_noted(tmp_path):
    tables = superelement(tmp_path, "Nastran", 2)
    last = condensed(2)[3][-1]
    for frequency, noted in ((0.6 * last, False), (0.7 * last, True)):
        system = scene(tmp_path, tables).changed(load={"frequency": float(frequency)}).system()
        assert any("beyond the" in note for note in system.notes) == noted


def test_unknowns_that_k_couples_with_nodes_are_no_fixed_interface_modes(tmp_path):
    K, M, labels, _ = condensed(4)
    K[0, -1] = K[-1, 0] = 0.01 * np.sqrt(K[0, 0] * K[-1, -1])
    dmig(tmp_path / "lap.pch", {"KAAX": K, "MAAX": M}, labels, free=True)
    lap = scene(tmp_path, {"K": "lap.pch:KAAX", "M": "lap.pch:MAAX"})
    assert "4 unknowns have no node, and K couples them" in lap.structure().overview()


def test_a_column_of_dmig_that_is_missing_is_noted(tmp_path):
    K, M, labels = stored()
    dmig(tmp_path / "lap.pch", {"KAAX": K, "MAAX": M}, labels)
    text = (tmp_path / "lap.pch").read_text().replace(f"{72:8}\n", f"{75:8}\n")
    written(tmp_path, text, "lap.pch")
    given = read_matrix(tmp_path, "lap.pch:kaax", "K")
    assert given.notes == (
        "KAAX has 72 unknowns with entries, and its header says 75: the others are zero, or the "
        "file is cut.",
    )
