"""Gauss quadrature of the friction limits, and reduced models that use it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bars import Harmonic, bar_structure

from skfem_joint.errors import InputError
from skfem_joint.hyper_reduction import gauss_rule, with_friction_points
from skfem_joint.integrate import integrate
from skfem_joint.meshing import build_bar
from skfem_joint.recording import Run
from skfem_joint.reduction import active_zones, structure_basis
from skfem_joint.reference import paper_reference
from skfem_joint.structure import Joint, assemble
from skfem_joint.system import System

ACTIVE = 0.0526  # m, of the structure of Fig. 18 at 87.5 kN


def measure(points: int = 60) -> tuple[np.ndarray, np.ndarray]:
    generator = np.random.default_rng(0)
    return np.sort(generator.uniform(0.0, 0.3, points)), generator.uniform(0.1, 2.0, points)


@pytest.mark.parametrize("count", [1, 2, 5, 12, 30, 60])
def test_rule_is_positive_and_exact_to_degree_2p_minus_1(count: int) -> None:
    position, weight = measure()
    x, w = gauss_rule(position, weight, count)
    assert np.all(w > 0.0)
    assert np.all(np.diff(x) > 0.0)
    assert position[0] <= x[0]
    assert x[-1] <= position[-1]
    assert w.sum() == pytest.approx(weight.sum(), rel=1e-13)
    for degree in range(2 * count):  # of polynomials bounded by one on the stretch
        polynomial = np.polynomial.Chebyshev.basis(degree, domain=[0.0, 0.3])
        exact = weight @ polynomial(position)
        assert w @ polynomial(x) == pytest.approx(exact, abs=1e-11 * weight.sum())


def test_rule_of_degree_2p_is_not_exact() -> None:
    position, weight = measure()
    x, w = gauss_rule(position, weight, 3)
    nodal = np.polynomial.Polynomial.fromroots(x) ** 2  # zero at the points, positive elsewhere
    assert w @ nodal(x) < 1e-10 * (weight @ nodal(position))


def test_many_equal_nodes_give_gauss_legendre() -> None:
    legendre, weights = np.polynomial.legendre.leggauss(6)
    errors = []
    for m in (100, 1000):  # midpoints: the sum is the integral to second order
        x, w = gauss_rule((np.arange(m) + 0.5) / m * 2.0 - 1.0, np.full(m, 2.0 / m), 6)
        errors.append(max(np.abs(x - legendre).max(), np.abs(w - weights).max()))
    assert errors[1] < 1e-5
    assert errors[0] / errors[1] == pytest.approx(100.0, rel=0.02)


@pytest.mark.parametrize("kind", ["random", "equal"])
def test_as_many_points_as_nodes_are_the_nodes(kind: str) -> None:
    position, weight = measure(53)
    if kind == "equal":
        position, weight = np.linspace(0.0, 0.3, 53), np.ones(53)
    x, w = gauss_rule(position, weight, 53)
    assert np.allclose(x, position, rtol=0.0, atol=1e-13)
    assert np.allclose(w, weight, rtol=1e-9)


def test_one_node_is_its_own_rule() -> None:
    x, w = gauss_rule(np.array([0.07]), np.array([3.0]), 1)
    assert x[0] == pytest.approx(0.07, rel=1e-14)
    assert w[0] == pytest.approx(3.0, rel=1e-14)


@pytest.mark.parametrize("count", [0, -1, 61])
def test_a_rule_of_too_many_or_no_points_is_refused(count: int) -> None:
    with pytest.raises(InputError, match="must be from 1 to 60"):
        gauss_rule(*measure(), count)


@pytest.fixture(scope="module")
def reduced() -> tuple[System, np.ndarray, np.ndarray]:
    """Structure of Fig. 18 on five joint modes; position of its rows, rows of the active length."""
    bar = build_bar(
        [("joint", 0.1, 100), ("linear", 0.5, 100)],
        {"fixed": 0.0, "junction": 0.1, "free_end": 0.6},
    )
    structure = bar_structure(bar, [Joint("joint", 50e6, 0.7, 1e5, "equal")])
    system = assemble(structure, [("free_end", Harmonic(87.5e3, 500.0))])
    V = structure_basis(
        structure, system, paper_reference(), active_zones(structure, system), [ACTIVE]
    )
    position = structure.position[structure.free[system.B.indices]]
    return system.project(V), position, np.flatnonzero(position > 0.1 - ACTIVE)


def harmonic_run(system: System) -> Run:
    return integrate(system, step=1e-5, n_steps=400, cycle_steps=200)


def test_points_keep_the_friction_limit_of_the_active_length(
    reduced: tuple[System, np.ndarray, np.ndarray],
) -> None:
    system, position, rows = reduced
    for count in (1, 4, 12):
        few = with_friction_points(system, position, [rows], count)
        assert few.contact_points == count
        assert few.w.sum() == pytest.approx(system.w[rows].sum(), rel=1e-12)
        assert few.n == system.n
        assert np.array_equal(few.beta, np.full(count, 1e5))


def test_slip_is_interpolated_linearly(reduced: tuple[System, np.ndarray, np.ndarray]) -> None:
    system, position, rows = reduced
    few = with_friction_points(system, position, [rows], 7)
    at, _ = gauss_rule(position[rows], system.w[rows], 7)
    for k in range(system.n):
        assert np.allclose(few.B[:, k], np.interp(at, position, system.B[:, k]), rtol=1e-12)


def test_all_rows_as_points_give_the_model_of_all_nodes(
    reduced: tuple[System, np.ndarray, np.ndarray],
) -> None:
    system, position, rows = reduced
    nodes = harmonic_run(system)
    points = harmonic_run(with_friction_points(system, position, [rows], rows.size))
    assert np.allclose(points.point_u, nodes.point_u, rtol=0.0, atol=1e-10 * nodes.peak.max())
    assert points.cycles.friction == pytest.approx(nodes.cycles.friction, rel=1e-10)


def test_twelve_points_are_close_to_all_nodes(
    reduced: tuple[System, np.ndarray, np.ndarray],
) -> None:
    system, position, rows = reduced
    nodes = harmonic_run(system)
    points = harmonic_run(with_friction_points(system, position, [rows], 12))
    assert points.cycles.friction[-1] == pytest.approx(nodes.cycles.friction[-1], rel=5e-3)
    assert points.peak == pytest.approx(nodes.peak, rel=5e-3)


def test_two_stretches_get_their_own_points(
    reduced: tuple[System, np.ndarray, np.ndarray],
) -> None:
    system, position, rows = reduced
    first, second = rows[:20], rows[20:]
    both = with_friction_points(system, position, [first, second], 4)
    assert both.contact_points == 8
    assert both.w[:4].sum() == pytest.approx(system.w[first].sum(), rel=1e-12)
    assert both.w[4:].sum() == pytest.approx(system.w[second].sum(), rel=1e-12)


def test_a_stretch_of_one_row_is_that_row(
    reduced: tuple[System, np.ndarray, np.ndarray],
) -> None:
    system, position, rows = reduced
    one = with_friction_points(system, position, [rows[-1:]], 12)
    assert np.array_equal(one.w, system.w[rows[-1:]])
    assert np.allclose(one.B, system.B[rows[-1:]], rtol=1e-14)


def test_points_with_two_directions_are_no_points_of_a_bar(
    reduced: tuple[System, np.ndarray, np.ndarray],
) -> None:
    system, position, _ = reduced
    half = np.arange(position.size // 2)
    pairs = replace(
        system, w=system.w[half], beta=system.beta[half], directions=np.full(half.size, 2)
    )
    with pytest.raises(InputError, match="slip in one direction"):
        with_friction_points(pairs, position[::2], [half], 4)
