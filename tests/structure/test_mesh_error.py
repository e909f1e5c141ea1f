"""The stated error of first frequencies by a mesh of first order, beside what is true."""

from copy import deepcopy
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from bodies import SIDE, E, block, mapped, pressed, side, structure, turned

import skfem_joint as sj
from skfem_joint.structure.mesh_error import Straight, mesh_error
from skfem_joint.structure.parameters import with_values

LENGTH, HEIGHT, DEEP = 0.3, 0.01, 0.03
#: Quadrilaterals and hexahedra whose errors are large.
PLAIN: dict[str, Any] = {"incompatible": False}


def beam(kind: str, *elements: int) -> sj.NamedMesh:
    """Beam of 300 x 10 mm, of a solid 30 mm wide."""
    along, *others = elements
    if kind in ("triangle", "quadrilateral"):
        return sj.build_plate([("all", LENGTH, along)], HEIGHT, *others, kind=kind)
    across, layers = others
    return sj.build_box([("all", LENGTH, along)], (DEEP, HEIGHT), (across, layers), kind=kind)


def of_second_order(some: sj.Structure, joints: str = "loose") -> np.ndarray:
    """First frequencies, Hz, with elements of second order on the same mesh."""
    better = replace(some, mesh=replace(some.mesh, order=2), order=2)
    return sj.natural_modes(better.system(), 12, joints=joints).straining.frequencies


BEAMS = [
    ("tetrahedron", 30, 3, 1),
    ("tetrahedron", 15, 3, 2),
    ("hexahedron", 30, 3, 1),
    ("hexahedron", 15, 3, 2),
    ("triangle", 30, 1),
    ("triangle", 60, 2),
    ("quadrilateral", 30, 1),
    ("quadrilateral", 60, 2),
]


@pytest.mark.parametrize("beam_of", BEAMS, ids=str)
def test_the_stated_error_of_a_cantilever_is_the_true_one(beam_of):
    some = structure(beam(*beam_of), **PLAIN)
    error = some.mesh_error
    assert error is not None
    present = sj.natural_modes(some.system(), 6).frequencies
    np.testing.assert_allclose(error.frequencies, present, rtol=1e-6)
    true = present / of_second_order(some)[:6] - 1.0
    counts = true > 0.02
    assert counts.any()
    ratio = error.shares[counts] / true[counts]
    assert ratio.min() > 0.85
    assert ratio.max() < 1.01
    assert np.abs(error.shares - true)[~counts].max(initial=0.0) < 3e-3
    assert error.largest == error.shares.max() > 0.05
    assert error is some.loose_mesh_error
    assert error.joints == "loose"  # there is no other


@pytest.mark.parametrize("tilt", [0.15, 0.3])
@pytest.mark.parametrize("beam_of", [("hexahedron", 30, 3, 1), ("quadrilateral", 30, 1)], ids=str)
def test_the_stated_error_tells_where_incompatible_modes_lose_their_effect(beam_of, tilt):
    """On trapezoids; the upright edges lean to and fro by a part of an element's length."""

    def leaning(p: np.ndarray) -> np.ndarray:
        number = np.rint(p[0] * 30 / LENGTH)
        inside = (p[0] > 1e-9) & (p[0] < LENGTH - 1e-9)
        shift = tilt * LENGTH / 30 * (-1.0) ** number * (2.0 * p[-1] / HEIGHT - 1.0)
        return np.vstack([p[0] + inside * shift, p[1:]])

    some = structure(mapped(beam(*beam_of), leaning))
    error = some.mesh_error
    true = error.frequencies / of_second_order(some)[:6] - 1.0
    counts = true > 0.02
    assert counts.sum() > 2
    ratio = error.shares[counts] / true[counts]
    assert ratio.min() > 0.7
    assert ratio.max() < 1.5


def test_a_fine_mesh_of_a_stocky_body_errs_by_less_than_a_third_of_a_per_cent():
    some = structure(sj.build_plate([("all", 0.1, 40)], 0.1, 40))
    assert 0.0 < some.mesh_error.largest < 3e-3
    assert not any("too stiff" in text for text in some.system().notes)


def test_each_step_lowers_the_frequencies_towards_those_of_second_order():
    """As Rayleigh's quotients in a space that elements of second order have too."""
    some = structure(beam("triangle", 30, 1))
    system, held = some.unloaded, [Straight("left", (0, 1))]
    found = [mesh_error(some.body, system, held, steps=steps).better for steps in range(8)]
    exact = of_second_order(some)[:6]
    np.testing.assert_allclose(found[0], some.mesh_error.frequencies, rtol=1e-6)
    assert np.all(np.diff(found, axis=0) <= 1e-12 * exact)
    assert np.all(found[-1] >= (1.0 - 1e-9) * exact)
    assert np.all(found[-1] < 1.005 * exact)


@pytest.mark.parametrize("kind", ["triangle", "quadrilateral"])
def test_rigid_motions_of_a_free_structure_are_left_out(kind):
    some = structure(beam(kind, 30, 1), fixed=(), free=True, **PLAIN)
    error = some.mesh_error
    true = error.frequencies / of_second_order(some)[:6] - 1.0
    assert error.frequencies.min() > 100.0
    np.testing.assert_allclose(error.shares, true, rtol=0.1, atol=2e-3)


@pytest.mark.parametrize(
    "changes", [{}, {"contact": "unilateral"}, {"tangential_stiffness": 1e11}], ids=str
)
def test_joints_stuck_and_loose_have_errors_of_their_own(changes):
    """Middles of edges in joints stay between the vertices, so that loose joints are below."""
    some = structure(side((6, 6)), [replace(SIDE, **changes)], ["lower_left"], **PLAIN)
    errors = some.mesh_error, some.loose_mesh_error
    assert [error.joints for error in errors] == ["stuck", "loose"]
    for error, least in zip(errors, (0.7, 0.6), strict=True):
        present = sj.natural_modes(some.system(), 12, joints=error.joints).straining.frequencies
        true = present[:3] / of_second_order(some, error.joints)[:3] - 1.0
        np.testing.assert_allclose(error.frequencies[:3], present[:3], rtol=1e-6)
        assert true.min() > 0.05
        ratio = error.shares[:3] / true
        assert least < ratio.min()
        assert ratio.max() < 1.05


def test_a_structure_that_is_joint_throughout_has_the_error_of_loose_joints():
    some = structure(block("quad", n=6), [pressed("joint"), pressed("rest")], fixed=(), **PLAIN)
    error = some.mesh_error
    assert error.joints == "loose"
    assert error.largest > 0.01


def test_the_error_is_taken_over_where_it_is_the_same():
    """Whatever rubs, and factors of all stiffness or mass, which change all frequencies alike."""
    some = structure(side((6, 6)), [SIDE], ["lower_left"], **PLAIN)
    known = some.mesh_error
    assert with_values(some, {"joint[0].friction": 0.3}).mesh_error is known
    assert with_values(some, {"joint[0].pressure": 1e6}).mesh_error is known
    stiffer = with_values(some, {"material.E": 4.0 * E}).mesh_error
    np.testing.assert_allclose(stiffer.frequencies, 2.0 * known.frequencies, rtol=1e-12)
    np.testing.assert_allclose(stiffer.shares, known.shares, rtol=1e-9)
    sprung = with_values(some, {"joint[0].tangential_stiffness": 1e10}).mesh_error
    assert np.all(sprung.frequencies < known.frequencies)


def test_a_lumped_mass_does_not_hide_the_error_of_the_stiffness():
    """Lumped masses lower frequencies, by as much as the elements raise them here."""
    body = beam("triangle", 30, 1)
    lumped, consistent = (structure(body, mass=mass) for mass in ("lumped", "consistent"))
    shares = lumped.mesh_error.shares
    np.testing.assert_allclose(shares, consistent.mesh_error.shares, rtol=1e-6)


def test_a_structure_that_is_held_throughout_errs_by_nothing():
    some = structure(block("quad"), fixed=("joint", "rest"))
    assert some.mesh_error.largest == 0.0
    assert not any("stiff" in note for note in some.system().notes)


def test_bars_and_elements_of_second_order_are_not_compared():
    bar = sj.build_bar([("all", 1.0, 10)], {"end": 0.0})
    steel = structure(bar, fixed=["end"])
    assert steel.mesh_error is None
    assert structure(beam("triangle", 4, 1), order=2).mesh_error is None


CURES = {
    "tri": "elements of second order: leave mesh.order out, or let it be 2",
    "tet": "elements of second order: leave mesh.order out, or let it be 2",
    "quad": "Leave out mesh.incompatible = false",
    "hex": "Leave out mesh.incompatible = false",
}


@pytest.mark.parametrize("shape", CURES)
def test_a_mesh_that_is_too_stiff_is_said_with_its_cure(shape):
    some = structure(turned(block(shape, 1, 1, (0.4, 0.05, 0.02)), 20.0), **PLAIN)
    (sentence,) = [text for text in some.system().notes if "The mesh is too stiff" in text]
    most = float(100.0 * some.mesh_error.largest)
    assert most > 3.0
    assert f"{most:.2g} % too high" in sentence
    assert CURES[shape] in sentence


def test_a_mesh_that_is_too_large_is_said_to_err_by_an_unknown_amount(monkeypatch):
    monkeypatch.setattr("skfem_joint.structure.mesh_error.physical_memory", lambda: 1e5)
    some = structure(beam("quadrilateral", 30, 1), **PLAIN)
    assert some.mesh_error is None
    assert sum("How much too stiff" in text for text in some.system().notes) == 1


def test_a_copy_of_a_mesh_as_processes_get_it_has_its_error():
    mesh = beam("quadrilateral", 15, 1)
    assert mesh.parts  # known, and copied with the mesh
    here, there = (structure(each) for each in (mesh, deepcopy(mesh)))
    assert there.mesh_error.largest == here.mesh_error.largest > 0.0
