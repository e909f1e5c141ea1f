"""Fewer friction points: Gauss rules along a line, and points that slip alike merged."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from reduced_joints import case, fig_18, full, three_periods

import skfem_joint as sj
from skfem_joint.reduction.basis import Basis, Options, make_basis, own_basis
from skfem_joint.reduction.friction_points import (
    gauss_points,
    gauss_rule,
    merged_points,
    partition,
    reduced_system,
)
from skfem_joint.stepping.recording import Run

ACTIVE = 0.0526  # m, of the structure of Fig. 18 at 87.5 kN


def measure(points: int = 60) -> tuple[np.ndarray, np.ndarray]:
    generator = np.random.default_rng(0)
    return np.sort(generator.uniform(0.0, 0.3, points)), generator.uniform(0.1, 2.0, points)


@pytest.mark.parametrize("count", [1, 2, 5, 12, 30, 60])
def test_rule_is_positive_and_exact_to_degree_2p_minus_1(count):
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


@pytest.mark.parametrize("count", [0, -1, 61])
def test_a_rule_of_too_many_or_no_points_is_refused(count):
    with pytest.raises(sj.InputError, match="must be from 1 to 60"):
        gauss_rule(*measure(), count)


@cache
def on_a_line() -> tuple[sj.System, Basis, np.ndarray, np.ndarray]:
    """Structure of Fig. 18 on five joint modes; its active points and their positions."""
    structure, system = fig_18()
    options = Options(reference="paper", active_length=ACTIVE)
    basis = make_basis(structure, system, options, step=1e-5, n_steps=400, cycle_steps=200, warn=[])
    ((points, position),) = basis.stretches
    return system.project(basis.V), basis, points, position


def harmonic_run(system: sj.System) -> Run:
    return sj.integrate(system, step=1e-5, n_steps=400, cycle_steps=200)


def test_gauss_points_keep_the_friction_limit_of_the_active_length():
    system, _, points, position = on_a_line()
    for count in (1, 4, 12):
        few = gauss_points(system, [(points, position)], count)
        assert few.contact_points == count
        assert few.w.sum() == pytest.approx(system.w[points].sum(), rel=1e-12)
        assert np.array_equal(few.beta, np.full(count, 1e5))
        np.testing.assert_allclose(few.shares.sum(axis=1), 1.0, rtol=1e-14)
        np.testing.assert_allclose(few.shares @ system.B, few.B, atol=1e-13 * np.abs(few.B).max())


def test_all_points_as_gauss_points_give_the_model_of_all_nodes():
    system, _, points, position = on_a_line()
    nodes = harmonic_run(system)
    gauss = harmonic_run(gauss_points(system, [(points, position)], points.size))
    assert np.allclose(gauss.point_u, nodes.point_u, rtol=0.0, atol=1e-10 * nodes.peak.max())
    assert gauss.cycles.friction == pytest.approx(nodes.cycles.friction, rel=1e-10)


def example() -> tuple[sj.System, Basis]:
    system = case("lap")[1]
    return system, own_basis(system, full("lap"), 8)


def merged(system: sj.System, basis: Basis, count: int) -> tuple[sj.System, np.ndarray]:
    """Merged points, and the one that stands for each old point."""
    few = merged_points(system, basis.velocities, basis.active, count)
    owner = np.full(system.w.size, -1)
    owner[few.shares.indices] = np.repeat(np.arange(few.w.size), np.diff(few.shares.indptr))
    np.testing.assert_allclose(few.shares.sum(axis=1), np.ones(few.w.size), rtol=1e-12)
    return few, owner


@pytest.mark.parametrize("count", [1, 7, 40])
def test_merged_points_carry_the_same_total_and_are_means(count):
    system, basis = example()
    reduced = system.project(basis.V)
    few, owner = merged(reduced, basis, count)
    assert 0.8 * count <= few.w.size <= count
    assert np.all(few.w > 0.0)
    assert few.w.sum() == pytest.approx(system.w[basis.active].sum(), rel=1e-12)
    assert np.array_equal(np.flatnonzero(owner >= 0), basis.active)
    rows = reduced.B.reshape(-1, 2, reduced.n)
    for k in range(few.w.size):
        mine = owner == k
        assert few.w[k] == pytest.approx(system.w[mine].sum(), rel=1e-12)
        mean = np.average(rows[mine], axis=0, weights=system.w[mine])
        np.testing.assert_allclose(few.B[2 * k : 2 * k + 2], mean, atol=1e-12)


def test_as_many_points_as_slip_leave_the_model_as_it_is():
    _, system, step = case("strip")
    basis = own_basis(system, full("strip"), 5)
    reduced = system.project(basis.V)
    same, owner = merged(reduced, basis, system.w.size)
    assert np.array_equal(np.sort(owner), np.arange(system.w.size))
    one, other = three_periods(reduced, step), three_periods(same, step)
    np.testing.assert_allclose(other.point_u, one.point_u, atol=1e-9 * one.peak[0])
    np.testing.assert_allclose(other.friction_work[owner], one.friction_work, rtol=1e-6)


def test_points_of_other_laws_or_joints_are_not_merged():
    system, basis = example()
    odd = np.arange(system.w.size) % 2
    reduced = replace(system.project(basis.V), beta=np.where(odd, 1e5, 1e3))
    few, owner = merged(reduced, basis, 12)
    assert np.array_equal(few.beta[owner[basis.active]], reduced.beta[basis.active])
    assert set(few.beta) == {1e3, 1e5}
    two = replace(system.project(basis.V), J=np.stack([odd, 1.0 - odd]), joints=("odd", "even"))
    J = merged_points(two, basis.velocities, basis.active, 12).J
    np.testing.assert_allclose(J, np.round(J), atol=1e-12)
    np.testing.assert_allclose(J.sum(axis=0), 1.0, rtol=1e-12)


def test_partition_finds_what_is_apart():
    generator = np.random.default_rng(0)
    truth = generator.integers(0, 5, 200)
    x = 10.0 * np.eye(5)[truth] + 0.1 * generator.standard_normal((200, 5))
    label = partition(x, generator.uniform(0.1, 1.0, 200), 5)
    assert np.unique(np.stack([truth, label]), axis=1).shape[1] == 5
    assert sorted(partition(x[:3], np.ones(3), 3)) == [0, 1, 2]
    assert np.array_equal(partition(np.zeros((4, 2)), np.ones(4), 3), np.zeros(4))


def test_a_reduced_system_has_the_points_and_the_beta_that_its_modes_resolve():
    system, basis = example()
    warn: list[str] = []
    reduced = reduced_system(system, basis, warn=warn)
    assert reduced.n == 8
    assert 20 <= reduced.w.size <= 24  # three a mode
    assert reduced.shares.shape == (reduced.w.size, system.w.size)
    np.testing.assert_allclose(reduced.beta, 1.0 / (1e-4 * basis.slip_velocity), rtol=1e-12)
    assert len(warn) == 1
    assert "reduced model uses beta" in warn[0]
    decay = reduced_system(system, basis, periodic=False, warn=[])
    np.testing.assert_allclose(decay.beta, 1e5, rtol=1e-12)
    chosen = reduced_system(system, basis, friction_points="all", beta=77.0, warn=warn)
    assert np.all(chosen.beta == 77.0)
    assert chosen.w.size == system.w.size
    assert len(warn) == 1
    line, basis = fig_18()[1], on_a_line()[1]
    assert reduced_system(line, basis, warn=[]).w.size == 4 * 5  # Gauss: of each stretch
    assert reduced_system(line, basis, friction_points=7, warn=[]).w.size == 7


def test_fewer_points_than_asked_for_are_reported():
    _, system, _ = case("strip")
    basis = own_basis(system, full("strip"), 5)
    warn: list[str] = []
    reduced_system(system, basis, friction_points=10_000, beta=1e4, warn=warn)
    assert len(warn) == 1
    assert "instead of 10000" in warn[0]


def test_systems_without_friction_or_points_are_refused():
    system, basis = example()
    with pytest.raises(sj.InputError, match="needs friction in a joint"):
        reduced_system(replace(system, w=0.0 * system.w), basis, warn=[])
    with pytest.raises(sj.InputError, match="found 0, must be >= 1"):
        reduced_system(system, basis, friction_points=0, warn=[])
    with pytest.raises(sj.InputError, match="found 0, must be"):
        reduced_system(fig_18()[1], on_a_line()[1], friction_points=0, warn=[])
