"""The elastic body of every dimension against theorems of elasticity."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import skfem
from bodies import (
    ELEMENTS,
    MIXED,
    PLANE,
    SOLID,
    STEEL,
    THICKNESS,
    WIDTH,
    E,
    block,
    distorted,
    mapped,
    pressed,
    structure,
)
from scipy import sparse
from scipy.linalg import eigh

import skfem_joint as sj
from skfem_joint.body.nodes import Nodes

DENSITY, NU = STEEL.density, STEEL.poisson


def any_body(shape: str, order: int) -> sj.NamedMesh:
    """A body of no particular shape."""
    body = distorted(block(shape, order, 2, (0.4, 0.3, 0.2)))
    if body.mesh.dim() == 1:
        return body

    def bent(p: np.ndarray) -> np.ndarray:
        q = p.copy()
        q[0] += 0.2 * p[1]
        q[1] += 0.5 * p[0] * p[1]
        return q

    return mapped(body, bent)


def moments(body: sj.NamedMesh) -> np.ndarray:
    """Integrals of the products of 1 and the places x, y, z, (1 + dim, 1 + dim)."""
    basis = skfem.Basis(body.mesh, Nodes(body).element, intorder=5)
    x = np.array([np.ones_like(basis.dx), *np.asarray(basis.global_coordinates())])
    return np.einsum("ieq,jeq,eq->ij", x, x, basis.dx)


def at_rest_inside(some: sj.Structure, u: np.ndarray) -> np.ndarray:
    """Displacements, (N dim,), with those of the border and no force on inner nodes."""
    border = np.zeros((some.n_nodes, some.dim), dtype=bool)
    border[some.body.basis.get_dofs(some.mesh.mesh.boundary_facets()).flatten()] = True
    inner, outer = np.flatnonzero(~border.ravel()), np.flatnonzero(border.ravel())
    K, found = some.matrices()[1], u.copy()
    force = K[inner][:, outer] @ u[outer]
    found[inner] = sparse.linalg.spsolve(K[inner][:, inner].tocsc(), -force)
    return found


@pytest.mark.parametrize(
    ("shape", "order", "plane"),
    [(*kind, "stress") for kind in ELEMENTS + MIXED] + [(*kind, "strain") for kind in PLANE],
)
def test_patch_test_constant_strain_is_reproduced_and_mass_and_moments_are_those_of_the_body(
    shape, order, plane
):
    """Displacements linear in space: turns strain nothing, and push nothing inside."""
    some = structure(any_body(shape, order), plane=plane)
    M, K = some.matrices()
    d = some.dim
    gradient = 1e-3 * np.random.default_rng(3).normal(size=(d, d))
    u = (some.nodes @ gradient.T).ravel()
    strain = 0.5 * (gradient + gradient.T)
    mu = E / (2 * (1 + NU))
    lame = E * NU / ((1 + NU) * (1 - 2 * NU))
    if d == 2 and plane == "stress":
        lame = E * NU / (1 - NU**2)
    density = 0.5 * lame * np.trace(strain) ** 2 + mu * np.sum(strain**2)
    if d == 1:
        density = 0.5 * E * strain[0, 0] ** 2
    across = {1: WIDTH * THICKNESS, 2: THICKNESS, 3: 1.0}[d]
    exact = across * moments(some.mesh)
    volume = exact[0, 0]
    energy = density * volume
    assert 0.5 * u @ (K @ u) == pytest.approx(energy, rel=1e-11)
    np.testing.assert_allclose(at_rest_inside(some, u), u, rtol=0, atol=1e-11 * np.abs(u).max())
    shifts, mass = np.tile(np.eye(d), some.n_nodes), DENSITY * volume
    np.testing.assert_allclose(shifts @ (M @ shifts.T), mass * np.eye(d), atol=1e-12 * mass)
    if (shape, order) == ("mixed box", 1):  # whose quadrature is not exact for distorted prisms
        return
    along = np.array([np.ones(some.n_nodes), *some.nodes.T])
    found = along @ M[::d, ::d] @ along.T
    np.testing.assert_allclose(found, DENSITY * exact, atol=1e-12 * DENSITY * np.abs(exact).max())


def gradient_of_harmonic(x: np.ndarray) -> np.ndarray:
    """Gradient (..., d) of a harmonic potential: in equilibrium for any constants."""
    if x.shape[-1] == 2:
        return np.stack([np.exp(x[..., 0]) * np.cos(x[..., 1]),
                         -np.exp(x[..., 0]) * np.sin(x[..., 1])], axis=-1)  # fmt: skip
    a = np.exp(np.sqrt(2.0) * x[..., 0])
    y, z = x[..., 1], x[..., 2]
    return np.stack([np.sqrt(2.0) * a * np.cos(y) * np.cos(z), -a * np.sin(y) * np.cos(z),
                     -a * np.cos(y) * np.sin(z)], axis=-1)  # fmt: skip


@pytest.mark.parametrize(("shape", "order"), PLANE + SOLID)
def test_displacement_converges_at_the_order_of_the_element(shape, order):
    errors, counts = [], (2, 4) if (shape, order) == ("hex", 2) else (3, 6)
    for n in counts:
        some = structure(mapped(block(shape, order, n), skewed))
        solution = at_rest_inside(some, gradient_of_harmonic(some.nodes).ravel())
        basis = some.body.basis
        exact = gradient_of_harmonic(np.moveaxis(np.asarray(basis.global_coordinates()), 0, -1))
        squared = sum(
            np.sum((np.asarray(basis.interpolate(solution[c :: some.dim])) - exact[..., c]) ** 2
                   * basis.dx)
            for c in range(some.dim)
        )  # fmt: skip
        errors.append(np.sqrt(squared))
    observed = np.log(errors[0] / errors[1]) / np.log(counts[1] / counts[0])
    assert observed == pytest.approx(order + 1, abs=0.25)


def skewed(p: np.ndarray) -> np.ndarray:
    return np.vstack([p[:1] + 0.2 * p[:1] * p[1:2], p[1:]])


def bar(elements: int, length: float = 0.25, **changes: Any) -> sj.Structure:
    body = sj.build_bar([("joint", length, elements)], {"fixed": 0.0, "free_end": length})
    return structure(body, **{"fixed": ["fixed"], **changes})


@pytest.mark.parametrize("mass", ["consistent", "lumped"])
def test_bar_frequencies_converge_at_second_order_to_the_closed_form(mass):
    exact = 5000.0 / (4 * 0.25) * (2 * np.arange(1, 5) - 1)
    errors = []
    for n in (20, 40, 80):
        system = bar(n, mass=mass).system()
        squares = eigh(system.K.toarray(), system.M.toarray(), eigvals_only=True)[:4]
        errors.append(np.sqrt(squares) / (2 * np.pi) / exact - 1.0)
    # A consistent mass bounds the frequencies from above (Rayleigh), a lumped one here from below.
    assert np.all(np.array(errors) < 0.0 if mass == "lumped" else np.array(errors) > 0.0)
    np.testing.assert_allclose(np.log2(errors[1] / errors[2]), 2.0, atol=0.03)


@pytest.mark.parametrize(("shape", "order"), PLANE + SOLID)
def test_an_even_pressure_all_round_compresses_evenly_and_is_in_balance(shape, order):
    """On a distorted body: Hooke's law, and the force of a traction is traction times area."""
    body, p = any_body(shape, order), 3e6
    mesh = body.mesh.with_boundaries({"skin": body.mesh.boundary_facets()})
    some = structure(replace(body, mesh=mesh), fixed=(), free=True)
    pull = (3.0, *[0.0] * (some.dim - 1))
    loads = [sj.Load("skin", sj.Harmonic(p, 1.0), quantity="pressure"),
             sj.Load("left", sj.Harmonic(p, 1.0), pull, quantity="traction"),
             sj.Load("left", sj.Harmonic(1.0, 1.0), pull)]  # fmt: skip
    system = some.system(loads, [])
    pressure, traction, force = (
        load.amplitude.harmonics[0].amplitude * load.vector for load in system.loads
    )
    # Plane stress, or all three directions.
    strain = -p * (1.0 - NU if some.dim == 2 else 1.0 - 2.0 * NU) / E
    np.testing.assert_allclose(
        system.K @ (strain * some.nodes).ravel(), pressure, atol=1e-10 * np.abs(pressure).max()
    )
    area = 0.3 * np.sqrt(1.04) * (THICKNESS if some.dim == 2 else 0.2)  # a slanted plane
    np.testing.assert_allclose(traction, p * area * force, atol=1e-12 * p * area)
    assert any("pressure on skin acts on" in note for note in system.notes)


@pytest.mark.parametrize(("shape", "order"), ELEMENTS)
def test_regions_have_their_own_properties(shape, order):
    body = block(shape, order, 2, (0.4, 0.3, 0.2))
    dim = body.mesh.dim()
    own = {"E": E / 2, "density": 100.0}
    if dim < 3:
        own["thickness"] = 2 * THICKNESS
    some = structure(body, material=sj.Material(E, DENSITY, 0.0), regions={"rest": own})
    M, K = some.matrices()
    unit = np.eye(dim)[0]
    ones, stretch = np.tile(unit, some.n_nodes), np.outer(some.nodes[:, 0], unit).ravel()
    area = {1: WIDTH * THICKNESS, 2: 0.3 * THICKNESS, 3: 0.3 * 0.2}[dim]
    more = 2.0 if dim < 3 else 1.0
    assert ones @ (M @ ones) == pytest.approx(area * 0.2 * (DENSITY + more * 100.0), rel=1e-12)
    stiffness = E * area * 0.2 * (1.0 + more / 2)
    assert stretch @ (K @ stretch) == pytest.approx(stiffness, rel=1e-12)


def test_an_inclined_bar_has_the_same_system_and_its_vectors_lie_along_it():
    straight = bar(20, joints=[pressed()])
    along = np.array([0.6, 0.64, 0.48])
    body = straight.mesh
    coordinates = np.outer(body.mesh.p[0], along) + np.array([1.0, -2.0, 0.5])
    inclined = replace(straight, mesh=replace(body, coordinates=coordinates))
    one, two = straight.system(), inclined.system()
    for name in ("M", "K"):
        assert abs(getattr(one, name) - getattr(two, name)).max() == 0.0
    assert np.array_equal(one.contact.w, two.contact.w)
    np.testing.assert_allclose(inclined.body.in_space(np.array([[2.0]])), [2.0 * along], rtol=1e-12)
    np.testing.assert_array_equal(inclined.positions, coordinates)


def test_loads_on_regions_and_points_and_names_of_rows():
    some = structure(block("tri", 2))
    directions = ("rest", 0.0, -3.0), ("corner", 3.0, 4.0), ("rest", 1.0, 0.0), ("rest", 0.0, -1.0)
    force = sj.Harmonic(1.0, 1.0)
    system = some.system([sj.Load(on, force, along) for on, *along in directions])
    assert system.points == ("rest", "corner", "rest.2", "corner.x", "corner.y")
    assert [load.on for load in system.loads] == ["rest", "corner", "rest.2", "rest"]
    # The row of a load is what it works on.
    works = system.P.toarray()[:3] @ system.load_vectors()
    np.testing.assert_allclose(works, system.load_vectors()[:, :3].T @ system.load_vectors())
    shares = some.body.even_shares("rest")
    assert shares.sum() == pytest.approx(1.0, rel=1e-14)
    np.testing.assert_allclose(shares @ some.nodes, [0.75, 0.5], rtol=1e-12)


def test_a_bar_that_is_pushed_has_the_displacement_that_the_push_works_on_and_its_points():
    bar = structure(block("line"), width=WIDTH)
    system = bar.system([sj.Load("rest", sj.Harmonic(1.0, 1.0), (-1.0,))], ["rest"])
    assert system.points == ("rest", "rest.2")
    (push,) = system.load_vectors().T
    np.testing.assert_array_equal(system.P.toarray(), [push, -push])
