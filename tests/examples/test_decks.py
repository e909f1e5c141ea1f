"""A deck of CalculiX goes through all commands as it is, and has CalculiX's frequencies."""

import re
import shutil
from pathlib import Path

import numpy as np
import pytest
from benchmarks import decks
from benchmarks.contact import tetrahedra
from make_meshes import solid_lap_joint

import skfem_joint as sj
from skfem_joint import cli

EXAMPLES = Path(__file__).parents[2] / "examples"
COARSE = {"across": 2, "inner": (0.006,), "outer": ()}


def plates(kind):
    bricks = solid_lap_joint(**COARSE)
    return tetrahedra(bricks) if kind == "C3D10" else bricks


@pytest.mark.parametrize("kind", decks.KINDS)
def test_two_instances_are_the_plates_of_the_flat_deck(tmp_path, kind):
    """Matrices, areas and names are the same, and those of the mesh that was written."""
    mesh = plates(kind)
    read = []
    for name, lines in (("flat", decks.flat(mesh, kind)), ("two", decks.in_instances(mesh, kind))):
        path = tmp_path / f"{name}.inp"
        path.write_text("\n".join([*lines, ""]), encoding="utf-8")
        read.append(sj.Structure(sj.load_meshes(path), decks.STEEL, free=True))
    wanted = sj.Structure(mesh, decks.STEEL, free=True, order=1 if kind == "C3D8I" else 2)
    for structure in read:
        assert structure.mesh.boundaries.keys() == wanted.mesh.boundaries.keys()
        for name in wanted.mesh.boundaries:
            areas = [s.body.facet_basis(s.mesh.boundaries[name]).dx.sum()
                     for s in (structure, wanted)]  # fmt: skip
            assert areas[0] == pytest.approx(areas[1], rel=1e-9)
        ours, theirs = (np.sort(s.matrices()[1].diagonal()) for s in (structure, wanted))
        np.testing.assert_allclose(ours, theirs, rtol=1e-9)


@pytest.mark.skipif(shutil.which("ccx") is None, reason="CalculiX is not installed")
def test_tied_contact_has_the_frequencies_of_calculix(tmp_path):
    """Within 1e-4; what is left is CalculiX's mass, which it integrates at four points."""
    lines = decks.flat(plates("C3D10"), "C3D10")
    _, ours = decks.by_this_package(lines, tmp_path)
    _, apart = decks.by_this_package(decks.in_instances(plates("C3D10"), "C3D10"), tmp_path)
    np.testing.assert_allclose(ours, decks.by_calculix(lines, tmp_path), rtol=1e-4)
    np.testing.assert_allclose(apart, ours, rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["C3D10", "C3D20R"])
@pytest.mark.parametrize("written", [decks.flat, decks.in_instances])
def test_a_bolted_deck_goes_through_all_commands_as_it_is(tmp_path, capsys, kind, written):
    deck, scene = tmp_path / "plates.inp", tmp_path / "plates.toml"
    deck.write_text("\n".join([*written(plates(kind), kind), ""]), encoding="utf-8")
    before = deck.read_bytes()
    text = (EXAMPLES / "solid_lap_joint.toml").read_text(encoding="utf-8")
    text = text.replace("../meshes/solid_lap_joint.msh", "plates.inp")
    text = text.replace("cycles = 3", "cycles = 1").replace("levels = 12", "levels = 3")
    text = re.sub(r'run = \["full", "reduced"\]', 'run = ["reduced"]', text)
    scene.write_text(text, encoding="utf-8")
    assert cli.main(["check", str(scene)]) == 0
    said = capsys.readouterr().out
    assert "plates.inp: passed over are materials, which [material] says (*MATERIAL, " in said
    assert "contact and friction, which [[joint]] says (*SURFACE INTERACTION, " in said
    assert ("computed with 27 nodes" in said) == (kind == "C3D20R")
    names = next(line for line in said.splitlines() if line.startswith("Boundaries: "))
    assert "upper_end (" in names
    assert re.search(r"upper_contact \(\d+ sides, 0\.00\d+ m2\)", names)
    assert cli.main(["preview", str(scene), "--out", str(tmp_path / "plates.png")]) == 0
    assert cli.main(["run", str(scene), "--out", str(tmp_path / "run")]) == 0
    assert cli.main(["backbone", str(scene), "--out", str(tmp_path / "backbone")]) == 0
    assert deck.read_bytes() == before
