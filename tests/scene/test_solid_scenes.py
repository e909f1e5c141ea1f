"""Scenes of solids from files that Gmsh 4.15 wrote; and what is wrong with others.

The files ``gmsh/KIND_lower.msh`` (100 x 20 x 10 mm) and ``KIND_upper.msh`` (60 x 20 x 10 mm, on the
lower one from x = 40 mm on) hold a block each, with its volume, sides and corner named; hexahedra
lie in format 4.1 and 2.2. Their faces do not match. Those of the kinds mix8, mix20 and mix27 have
hexahedra in the first 40 mm and prisms in the rest, with 8, 20 and 27 or 6, 15 and 18 nodes; the
joint presses hexahedra and prisms on prisms.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import pyvista
from scene_texts import problems_of_file

import skfem_joint as sj
from skfem_joint.output import write
from skfem_joint.results.contact_history import displacements

FILES = Path(__file__).parent / "gmsh"
KINDS = ("tet4", "tet10", "hex8", "hex20", "hex27", "mix8", "mix20", "mix27")
SCENE = """\
[mesh]
file = ["{folder}/{kind}_lower.msh", "{folder}/{kind}_upper.msh"]
[material]
E = 200e9
density = 8000.0
poisson = 0.3
[material.regions.upper]
E = 70e9
density = 2700.0
[support]
fixed_x = ["lower left"]
fixed_y = ["lower front"]
fixed_z = ["lower below"]
[[joint]]
on = "upper below"
against = "lower above"
pressure = 10e6
friction = 0.3
law = "coulomb"
[damping]
stiffness = 1e-6
"""
LOADS = {
    "right": ('quantity = "traction"\ndirection = [1.0, 0.2, 0.0]', 10e6),
    "back": ('quantity = "pressure"', 1e6),
    "corner": ("direction = [0.0, 0.0, 1.0]", 10.0),
    "above": ("direction = [1.0, 0.0, 0.0]", 500.0),
}
HARMONIC = 'kind = "harmonic"\nfrequency = 500.0'
SCENE += "".join(
    f'[[load]]\non = "upper {on}"\n{how}\n{HARMONIC}\namplitude = {size}\n'
    for on, (how, size) in LOADS.items()
)
SCENE += """\
[time]
cycles = 1
steps_per_cycle = 60
[models]
run = ["full", "reduced"]
[reduction]
modes = 6
[accuracy]
estimate = false
[output]
vtk = true
frames = 4
"""


@pytest.mark.parametrize("kind", KINDS)
def test_a_scene_of_files_by_gmsh_runs_with_its_sizes_forces_and_balances(tmp_path, kind):
    path = tmp_path / "scene.toml"
    path.write_text(SCENE.format(folder=FILES.as_posix(), kind=kind))
    study = sj.run_scene(sj.load_scene(path))
    mass = 0.02 * 0.01 * (0.1 * 8000.0 + 0.06 * 2700.0)
    assert study.description.values["mass_kg"] == pytest.approx(mass, rel=1e-12)
    (patch,) = study.structure.patches
    assert patch.clamping_force == pytest.approx(10e6 * 0.06 * 0.02, rel=1e-12)
    peaks = np.abs(study.system.load_amplitudes(np.linspace(0.0, 2e-3, 61))).max(axis=1)
    expected = [10e6 * 0.02 * 0.01, 1e6 * 0.06 * 0.01, 10.0, 500.0]  # N
    np.testing.assert_allclose(peaks, expected, rtol=1e-12)
    for model in study.models.values():
        assert model.run.energy_residual < 1e-10
        assert model.run.friction_work.sum() > 0.1 * np.abs(model.run.input_work).sum()
        displacement = displacements(study.structure, model.run)[0]
        assert displacement.shape == (5, study.structure.n_nodes, 3)
    assert 0.0 < study.models["full"].active_area_fraction["upper below"] <= 1.0
    assert study.models["full"].active_length == {}
    index = next(file for file in write(study, tmp_path) if file.suffix == ".pvd")
    names = ["lower", "upper", "contact upper below", "contact lower above"]
    blocks = [f"{model}: {name}" for model in ("full", "reduced") for name in names]
    assert pyvista.PVDReader(index).read()[0].keys() == blocks
    stiff = [sentence for sentence in study.notes if "The mesh is too stiff" in sentence]
    assert len(stiff) == (kind == "hex8")


@pytest.mark.parametrize("kinds", [("tet4", "tet10"), ("mix8", "mix20"), ("mix8", "mix27")])
def test_what_locks_at_first_order_is_computed_as_of_second_order_on_the_same_mesh(tmp_path, kinds):
    runs, path = {}, tmp_path / "scene.toml"
    for kind in kinds:
        path.write_text(SCENE.format(folder=FILES.as_posix(), kind=kind))
        system = sj.load_scene(path).system()
        runs[kind] = sj.integrate(system, cycles=1, steps_per_cycle=60)
    raised, given = runs.values()
    np.testing.assert_allclose(raised.peak, given.peak, rtol=1e-7)
    assert raised.friction_energy == pytest.approx(given.friction_energy, rel=1e-7)


TWICE = '[[joint]]\non = "lower above"\npressure = 1e6\nfriction = 0.3\n[damping]'
#: The lower and the upper file, what takes the place of the damping, and the message.
WRONG = {
    "inverted tetrahedra": ("tet10_pushed", "tet10_upper", "[damping]", "an element is inverted"),
    "hexahedra on tetrahedra": ("tet4_lower", "hex8_upper", "[damping]", "that go together"),
    "two orders": ("hex20_lower", "hex8_upper", "[damping]", "of the same order"),
    "one face on two things": (
        *("hex8_lower", "hex8_upper", TWICE),
        "joint 'lower above': it lies on a part of joint 'upper",
    ),
}


@pytest.mark.parametrize(("lower", "upper", "tables", "message"), WRONG.values(), ids=WRONG)
def test_what_is_wrong_with_files_of_solids_is_a_sentence(tmp_path, lower, upper, tables, message):
    files = {file.stem: file.read_text() for file in FILES.iterdir()}
    head, nodes = files["tet10_lower"].split("$Nodes")  # a corner is pushed through elements
    files["tet10_pushed"] = f"{head}$Nodes" + nodes.replace("\n0.1 0 0.01\n", "\n0 .03 .02\n")
    for name in (lower, upper):
        (tmp_path / f"{name}.msh").write_text(files[name])
    scene = SCENE.format(folder=".", kind="hex8").replace("[damping]", tables)
    path = tmp_path / "scene.toml"
    path.write_text(scene.replace("hex8_lower", lower).replace("hex8_upper", upper))
    assert any(message in problem for problem in problems_of_file(path))
