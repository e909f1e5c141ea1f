"""Solids against what they must agree with: plates, beams, even pressures."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from bodies import (
    ELEMENTS,
    MIXED,
    MU,
    PLANE,
    SOLID,
    STEEL,
    block,
    distorted,
    mapped,
    pressed,
    structure,
)
from scipy.sparse.linalg import eigsh

import skfem_joint as sj

KINDS: Any = ["hexahedron", "tetrahedron"]
NO_CONTRACTION = replace(STEEL, poisson=0.0)


def slanted(body: sj.NamedMesh, lean: float = 0.3) -> sj.NamedMesh:
    """The same body distorted inside and within its flat sides, which lean over."""

    def moved(p: np.ndarray) -> np.ndarray:
        q, size = p.copy(), np.ptp(p, axis=1)
        for i in range(len(p)):
            waves = [np.sin(np.pi * p[k] / size[k] * (2 if k == i else 1)) for k in range(len(p))]
            beside = [0.5 + 0.5 * wave for k, wave in enumerate(waves) if k != i]
            q[i] += 0.06 * size[i] * waves[i] * np.prod(beside, axis=0)
        q[0] += lean * p[-1]
        return q

    return mapped(distorted(body), moved)


@pytest.mark.parametrize(("shape", "order"), ELEMENTS + MIXED)
def test_only_rigid_motions_strain_nothing(shape, order):
    """No element has a motion of its own that its quadrature does not feel."""
    some = structure(slanted(block(shape, order, 1, (0.4, 0.3, 0.2))), fixed=(), free=True)
    values = np.linalg.eigvalsh(some.matrices()[1].toarray())
    rigid = some.dim * (some.dim + 1) // 2
    assert np.abs(values[:rigid]).max() < 1e-13 * values[-1]
    assert values[rigid] > (1e-8 if shape.startswith("mixed") else 1e-4) * values[-1]  # slender


@pytest.mark.parametrize(("shape", "order"), PLANE + SOLID + MIXED)
def test_an_even_pressure_goes_through_closed_contact_evenly(shape, order):
    """Weakly: a linear motion meets nodal forces with the work that it meets the pressure with.

    Quadratic shape functions would give the vertices of a ten-node tetrahedron no force at all.
    """
    p, body = 3e6, slanted(block(shape, order, 3, (0.4, 0.3, 0.2)), 0.0)
    some = structure(body, [pressed("base", pressure=p)], fixed=(), material=NO_CONTRACTION)
    (patch,) = some.patches
    part = some.body.facet_basis(body.boundaries["base"])
    linear = np.array([np.ones_like(part.dx), *np.asarray(part.global_coordinates())])
    exact = p * np.einsum("ifq,fq->i", linear, part.dx) * some.body.across[0]
    at_nodes = np.vstack([np.ones(patch.nodes.size), some.nodes[patch.nodes].T])
    np.testing.assert_allclose(at_nodes @ patch.normal_force, exact, rtol=1e-12, atol=1e-9)
    assert patch.normal_force.min() > 0.0
    # The same pressure on the other side strains all of the body alike.
    system = some.system([sj.Load("top", sj.Harmonic(p, 1.0), quantity="pressure")], [])
    u = np.zeros_like(some.nodes)
    u[:, -1] = -p / STEEL.E * some.nodes[:, -1]
    (load,) = system.loads
    force = load.amplitude.harmonics[0].amplitude * load.vector
    found = system.K @ (some.change_of_unknowns.inverse @ u.ravel())
    np.testing.assert_allclose(found, force, rtol=0, atol=1e-10 * np.abs(force).max())


@pytest.mark.parametrize(
    ("kind", "elements"),
    [("triangle", 16), ("quadrilateral", 10), ("tetrahedron", 12), ("hexahedron", 10)],
)
def test_slender_cantilevers_have_the_frequencies_of_beam_theory(kind, elements):
    """Euler and Bernoulli's, of second order, distorted, one element across: within 0.5 %."""
    if kind in KINDS:
        body = sj.build_box([("beam", 1.0, elements)], (0.02, 0.03), (1, 1), kind=kind, order=2)
        depths = np.array([0.02, 0.03])
    else:
        body = sj.build_plate([("beam", 1.0, elements)], 0.02, 1, kind=kind, order=2)
        depths = np.array([0.02])
    body = mapped(
        body,
        lambda p: np.vstack(
            [p[0] + 0.02 * np.sin(np.pi * p[0]) * np.sin(40 * p[0] + 90 * p[1]), p[1:]]
        ),
    )
    system = structure(body, material=NO_CONTRACTION).system()
    squares = eigsh(system.K, depths.size, system.M, sigma=0.0, return_eigenvectors=False)
    beam = 1.8751041**2 * depths * np.sqrt(STEEL.E / STEEL.density / 12.0)
    np.testing.assert_allclose(np.sort(np.sqrt(squares)), beam, rtol=5e-3)


LENGTH, WIDE, THIN, PRESSURE = 0.25, 0.01, 1e-3, 0.8e6
#: Nearly what the joint can hold.
PULL = sj.Harmonic(0.9 * MU * PRESSURE * LENGTH * WIDE, 1000.0)
FLAT: Any = {"hexahedron": "quadrilateral", "tetrahedron": "triangle"}


def same_period(plate: sj.Structure, solid: sj.Structure, *directions: tuple[float, ...]) -> None:
    """Fail unless both move and lose alike, within 0.5 %, in the first period of a pull."""
    runs = []
    for some, direction in zip((plate, solid), directions, strict=True):
        some = replace(some, stiffness_damping=1e-5)
        system = some.system([sj.Load("right", PULL, direction)], [])
        runs.append(sj.integrate(system, cycles=1, steps_per_cycle=40))
    errors = sj.compare(*runs)
    assert runs[0].friction_work.sum() > 0.05 * np.abs(runs[0].input_work).sum()
    assert errors.displacement_max < 5e-3
    assert abs(errors.friction_energy or 1.0) < 5e-3


@pytest.mark.parametrize("kind", KINDS)
def test_a_thin_solid_on_its_face_is_the_plate_in_plan(kind):
    """Plane stress; pulled askew, it slips in two directions."""
    plate = sj.build_plate([("joint", LENGTH, 12)], WIDE, 2, kind=FLAT[kind], order=2)
    box = sj.build_box([("all", LENGTH, 12)], (WIDE, THIN), (2, 1), kind=kind, order=2)
    in_plan = structure(plate, [pressed(pressure=PRESSURE)], thickness=THIN)
    solid = structure(box, [pressed("front", pressure=PRESSURE)])
    same_period(in_plan, solid, (1.0, 0.1), (1.0, 0.1, 0.0))


@pytest.mark.parametrize("kind", KINDS)
def test_a_solid_held_across_its_width_is_the_plate_from_the_side(kind):
    """Plane strain, ten times as thick, on its edge."""
    plate = sj.build_plate([("all", LENGTH, 20)], 10 * THIN, 2, kind=FLAT[kind], order=2)
    box = sj.build_box([("all", LENGTH, 20)], (WIDE, 10 * THIN), (1, 2), kind=kind, order=2)
    on_edge = [pressed("bottom", pressure=PRESSURE)]
    from_the_side = structure(plate, on_edge, thickness=WIDE, plane="strain")
    solid = structure(box, [pressed("front", pressure=PRESSURE)], fixed_y=["bottom", "top"])
    same_period(from_the_side, solid, (1.0, 0.05), (1.0, 0.0, 0.05))
