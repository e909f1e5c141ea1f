"""Gauss rules for friction points along a line."""

from functools import cache

import numpy as np
import pytest
from reduced_joints import fig_18

import skfem_joint as sj
from skfem_joint.reduction.basis import Options
from skfem_joint.reduction.models import reduced_on
from skfem_joint.reduction.scaled.basis import ScaledBasis, paper_basis
from skfem_joint.reduction.scaled.gauss import gauss_points, gauss_rule
from skfem_joint.stepping.plan import Plan

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


@cache
def on_a_line() -> tuple[sj.System, ScaledBasis, np.ndarray, np.ndarray]:
    """Structure of Fig. 18 on five joint modes; its active points and their positions."""
    structure, system = fig_18()
    options = Options(reference="paper", active_length=ACTIVE)
    basis = paper_basis(structure, system, options, Plan(1e-5, 400, cycle_steps=200))
    ((points, position),) = basis.lines
    return system.project(basis.V), basis, points, position


def harmonic_run(system: sj.System) -> sj.Run:
    return sj.integrate(system, step=1e-5, n_steps=400, cycle_steps=200)


def test_gauss_points_keep_the_friction_limit_of_the_active_length():
    system, _, points, position = on_a_line()
    for count in (1, 4, 12):
        few = gauss_points(system, [(points, position)], count)
        contact, B = few.contact, few.contact.B
        assert contact.count == count
        assert contact.w.sum() == pytest.approx(system.contact.w[points].sum(), rel=1e-12)
        assert np.array_equal(contact.beta, np.full(count, 1e5))
        np.testing.assert_allclose(contact.shares.sum(axis=1), 1.0, rtol=1e-14)
        np.testing.assert_allclose(
            contact.shares @ system.contact.B, B, atol=1e-13 * np.abs(B).max()
        )


def test_all_points_as_gauss_points_give_the_model_of_all_nodes():
    system, _, points, position = on_a_line()
    nodes = harmonic_run(system)
    gauss = harmonic_run(gauss_points(system, [(points, position)], points.size))
    assert np.allclose(gauss.point_u, nodes.point_u, rtol=0.0, atol=1e-10 * nodes.peak.max())
    assert gauss.cycles.friction == pytest.approx(nodes.cycles.friction, rel=1e-10)


def test_a_reduced_system_has_gauss_points_of_each_line():
    line, basis = fig_18()[1], on_a_line()[1]
    assert reduced_on(line, basis).contact.w.size == 4 * 5  # Gauss: of each stretch
    assert reduced_on(line, basis, friction_points=7).contact.w.size == 7
    with pytest.raises(sj.InputError, match="found 0, must be"):
        reduced_on(line, basis, friction_points=0)
