"""Nastran's bulk data are read for what they say, or refused with line and word."""

from pathlib import Path

import numpy as np
import pytest
from inp_files import deck_of, mesh_of
from mesh_files import (
    NASTRAN_15,
    PRISM_15,
    boundary_sizes,
    read_in_a_process_of_its_own,
    region_sizes,
    saved,
)

import skfem_joint as sj

#: Two cubes of 1 m in a row, with a shell on the face that they share with nothing else.
PLACES = [(x, y, z) for z in range(2) for y in range(2) for x in range(3)]
GRID = [f"GRID,{k},,{x}.,{y}.,{z}." for k, (x, y, z) in enumerate(PLACES, 1)]
CUBES = ["CHEXA,1,3,1,2,5,4,7,8,+", "+,11,10", "CHEXA,2,4,2,3,6,5,8,9,+", "+,12,11"]
SHELL = ["CQUAD4,3,7,1,4,10,7"]
#: Numbers of the nodes of C3D20R in the order of CHEXA.
MIDDLE = [*range(12), *range(16, 20), *range(12, 16)]


def read(folder: Path, *parts: list[str], head: str = "SOL 103\nCEND\nBEGIN BULK") -> sj.NamedMesh:
    text = "\n".join([head, *(line for part in parts for line in part), "ENDDATA", ""])
    return sj.load_meshes(saved(folder, text, "mesh.bdf"))


def test_properties_are_names_of_solids_and_of_their_faces(tmp_path):
    loose = ["$ a comment", "PSOLID,3,1", "PSHELL,7,1,0.1", "PARAM,POST,-1", "EIGRL,1,,,10"]
    loose += ["MAT1,1,2.1+11,,0.3,7850.", "spc1,1,123,1,4,7,10"]
    loose += ["CORD2R,1,,0.,0.,0.,0.,0.,1.", "+,1.,0.,0."]
    mesh = read(tmp_path, loose, GRID, CUBES, SHELL)
    assert region_sizes(mesh) == pytest.approx({"PSOLID_3": 1.0, "PSOLID_4": 1.0}, rel=1e-12)
    assert boundary_sizes(mesh) == pytest.approx({"PSHELL_7": 1.0}, rel=1e-12)
    passed, shells = mesh.notes
    for what in ("[material] says (MAT1)", "(PSOLID, PSHELL)", "say (SPC1)", "(PARAM, EIGRL, CO"):
        assert what in passed
    assert "CQUAD4 on solids name their faces, and have no stiffness" in shells


def test_an_entry_is_the_same_in_short_long_and_free_fields(tmp_path):
    free = read(tmp_path, GRID, CUBES)
    short = [f"grid    {k:<8}        {x:<8.1f}{y:<8.1f}{z:<8.1f}"
             for k, (x, y, z) in enumerate(PLACES, 1)]  # fmt: skip
    rows = [("CHEXA", 1, 3, 1, 2, 5, 4, 7, 8), ("", 11, 10)]
    rows += [("CHEXA", 2, 4, 2, 3, 6, 5, 8, 9, "+A"), ("+A", 12, 11)]
    short += ["".join(f"{cell:<8}" for cell in row) for row in rows]
    long = list[str]()
    for k, (x, y, z) in enumerate(PLACES, 1):
        long += [f"GRID*   {k:<16}{'':<16}{x:<16.3f}{f'{y}.0-0':<16}", f"*       {z:<16.3f}"]
    wide = []
    for cells in ((1, 3, 1, 2, 5, 4, 7, 8, 11, 10), (2, 4, 2, 3, 6, 5, 8, 9, 12, 11)):
        rows = ["".join(f"{cell:<16}" for cell in cells[k : k + 4]) for k in (0, 4, 8)]
        wide += [f"CHEXA*  {rows[0]}", f"*       {rows[1]}", f"*       {rows[2]}"]
    for lines in (short, long + wide):
        mesh = read(tmp_path, lines)
        assert region_sizes(mesh) == pytest.approx(region_sizes(free), rel=1e-12)
        np.testing.assert_array_equal(mesh.mesh.p, free.mesh.p)


@pytest.mark.parametrize(
    ("kind", "word", "order"),
    [("C3D20R", "CHEXA", MIDDLE), ("C3D10", "CTETRA", range(10)), ("C3D8I", "CHEXA", range(8))],
)
def test_nodes_of_second_order_are_where_nastran_has_them(tmp_path, kind, word, order):
    wanted = mesh_of("solids", kind)
    deck = deck_of(wanted, kind)
    mesh = read(tmp_path, written(deck.xyz, word, (deck.elements + 1)[:, list(order)]))
    assert (mesh.kind, mesh.order, mesh.notes) == (wanted.kind, wanted.order, ())
    assert region_sizes(mesh)["PSOLID_1"] == pytest.approx(sum(region_sizes(wanted).values()))
    prism = read(tmp_path, written(PRISM_15[NASTRAN_15], "CPENTA", np.arange(1, 16)[None]))
    assert (prism.kind, prism.order, prism.notes) == ("prism", 2, ())
    assert region_sizes(prism) == pytest.approx({"PSOLID_1": 0.5})


def written(places: np.ndarray, word: str, elements: np.ndarray) -> list[str]:
    """Nodes and elements of property 1, eight fields in a line."""
    lines = [f"GRID,{k},,{x:.12f},{y:.12f},{z:.12f}" for k, (x, y, z) in enumerate(places, 1)]
    for number, nodes in enumerate(elements, 1):
        cells = [str(number), "1", *map(str, nodes)]
        rows = [",".join(cells[at : at + 8]) for at in range(0, len(cells), 8)]
        lines += [f"{word},{rows[0]}", *(f"+,{row}" for row in rows[1:])]
    return lines


def test_bars_and_shells_alone_are_bars_and_plates_with_a_note(tmp_path):
    bar = read(tmp_path, GRID[:3], ["CBAR,1,1,1,2,0.,1.,0.", "CBEAM,2,2,2,3,0.,1.,0."])
    assert bar.kind == "line"
    assert region_sizes(bar) == pytest.approx({"PBAR_1": 1.0, "PBEAM_2": 1.0})
    assert "CBAR, CBEAM are computed as bars, which carry no bending" in bar.notes[0]
    plate = read(tmp_path, GRID[:6], ["CQUAD4,1,1,1,2,5,4", "CQUADR,2,1,2,3,6,5"])
    assert plate.kind == "quadrilateral"
    assert region_sizes(plate) == pytest.approx({"PSHELL_1": 2.0})
    assert "loaded in their plane" in plate.notes[0]


REFUSED = {
    "RBE2,9,1,123,2,3": "line 20: RBE2: it joins or stiffens",
    "RBE3,9,,1,123,1.,123,2,3": "line 20: RBE3: it joins",
    "MPC,1,1,1,1.,2,1,-1.": "line 20: MPC: it joins",
    "CELAS2,9,1.+3,1,1,2,1": "line 20: CELAS2: it adds springs",
    "CBUSH,9,1,1,2": "line 20: CBUSH: it adds springs",
    "CONM2,9,1,,1.": "line 20: CONM2: it adds springs",
    "DMIG,K2,0,6,2": "line 20: DMIG: it adds springs, masses or matrices",
    "CBAR,9,1,1,2,0.,1.,0.": "line 20: CBAR: bars beside solids",
    "CPYRAM,9,3,1,2,5,4,7": "line 20: CPYRAM: pyramids",
    "CTRIAX6,9,3,1,2,5,4,7": "line 20: CTRIAX6: bodies of revolution",
    "GRDSET,,1": "line 20: GRDSET: it gives nodes",
    "INCLUDE 'other.bdf'": "line 20: INCLUDE: included files",
    "SPOINT,99": "line 20: SPOINT: points without a place",
    "CTETRUS,9,3,1,2,5,7": "line 20: CTETRUS: an entry that is not known",
    "GRID,99,7,0.,0.,0.": "line 20: GRID: 99 is in coordinate system 7",
    "GRID,99,,1e30,0.,0.": r"line 20: GRID: coordinates must be below 1e\+20",
    "GRID,99,,1.x,0.,0.": "line 20: GRID: found '1.x', must be a number",
    "GRID,,,1.,0.,0.": "line 20: GRID: has no number",
    "GRID,1,,5.,0.,0.": "line 20: GRID: 1 stands twice",
    "GRID*   99              0               0.              0.              ":
        "line 20: GRID: 99 has no third coordinate",
    "CTETRA,1,3,1,2,4,7": "line 20: element 1 stands twice",
    "CTETRA,9,3,1,2,4,99": "line 20: node 99 of element 9 is not in the file",
    "CTETRA,9,3,1,2,4,7,5": "line 20: CTETRA: 9 must have a property and 4 or 10 nodes",
    "CTETRA,9,,1,2,4,7": "line 20: CTETRA: 9 must have a property",
    "CTETRA,9,3,1,2,4,7.5": "line 20: CTETRA: found '7.5', must be a whole number",
    "CHEXA,9,4,2,3,6,5,8,9,+\n+,12,11": "element 9 has the corners of element 2, which would count",
    "GRID,99,,\t1.": "line 20: found 'GRID,99,,.t1.', must be fields",
    "CTETRA,9,3,1,2,4,7 $ four": "line 20: found 'CTETRA,9,3,1,2,4,7 . four', must be fields",
    " CTETRA,9,3,2,5,4,7": "line 20: found ' CTETRA,9,3,2,5,4,7', must begin in the first column",
    "MAT1,1,2.+11\n RBE2,9,1,123,2,3": "line 21: found ' RBE2,9.*must begin in the first column",
    "CQUAD4,9,7,1,4,10,7,,,+A\n+B,1.": "line 21: found .* goes on by the name 'B' below .* 'A'",
    "BEGIN SUPER=1": "it has several BEGIN BULK",
}  # fmt: skip


@pytest.mark.parametrize("line", REFUSED)
def test_what_is_not_read_is_refused_with_line_and_word(tmp_path, line):
    with pytest.raises(sj.InputError, match=rf"mesh\.bdf: .*{REFUSED[line]}"):
        read(tmp_path, GRID, CUBES, [line])


def test_what_a_scene_says_itself_is_passed_over_with_a_note(tmp_path):
    words = [
        "QVOL",
        "BCTABL1",
        "RANDPS",
        "TABDMP1",
        "DRESP1",
        "NLSTEP",
        "MATT1",
        "PCOMPG",
        "PLOAD4",
    ]
    note = read(tmp_path, GRID, CUBES, [f"{word},1,any thing" for word in words]).notes[0]
    assert all(word in note for word in words)
    tabs = ["PCOMP\t1", "\t1\t.1\t0.\tYES", "TABDMP1,1", " 0.,.1,9.,.1"]  # not read, nor their form
    assert read(tmp_path, GRID, CUBES, tabs).n_elements == 2
    held = [f"{GRID[0]},,1246", *GRID[1:6]]
    notes = read(tmp_path, held, ["CQUAD4,1,1,1,2,5,4,,0.5", "CQUAD4,2,1,2,3,6,5"]).notes
    assert "say (fixed directions of GRID)" in notes[0]
    assert "say (thickness, offset and angle of CQUAD4)" in notes[0]


def test_a_file_that_is_cut_or_empty_is_refused(tmp_path):
    text = "\n".join([*GRID, *CUBES, ""])
    with pytest.raises(sj.InputError, match=r"mesh\.dat: it has no ENDDATA: the file is cut"):
        sj.load_meshes(saved(tmp_path, text, "mesh.dat"))
    assert sj.load_meshes(saved(tmp_path, text + "ENDDATA\n", "mesh.NAS")).n_elements == 2
    with pytest.raises(sj.InputError, match="it holds no elements"):
        read(tmp_path, GRID)


def test_prisms_of_second_order_are_the_first_thing_that_a_process_reads(tmp_path):
    """The library of mesh files lacks their dimension."""
    places = PRISM_15[NASTRAN_15]
    lines = [f"GRID,{k},,{x},{y},{z}" for k, (x, y, z) in enumerate(places.tolist(), 1)]
    cells = ["1", "3", *map(str, range(1, 16))]
    rows = [",".join(cells[at : at + 8]) for at in range(0, len(cells), 8)]
    lines += [f"CPENTA,{rows[0]}", *(f"+,{row}" for row in rows[1:])]
    file = saved(tmp_path, "\n".join(["BEGIN BULK", *lines, "ENDDATA", ""]), "mesh.bdf")
    assert read_in_a_process_of_its_own(file).strip() == "prism 2 {'PSOLID_3': 1}"
