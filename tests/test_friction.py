"""The friction law: a convex potential, its gradient, and the parametrisations of its graph."""

from __future__ import annotations

from math import inf, pi, sqrt

import numpy as np
import pytest
from scipy.integrate import quad

from skfem_joint import friction

EPS = np.finfo(float).eps
BETAS = [1e2, 1e4, 1e5, 1e7, 1e9, 1e12]
PARAMETERS = np.concatenate(
    [
        -np.geomspace(1e-12, 50.0, 60),
        [0.0],
        np.geomspace(1e-12, 50.0, 60),
        1.0 + np.linspace(-1e-3, 1e-3, 41),
        [-1.0, np.nextafter(1.0, 0.0), np.nextafter(1.0, 2.0)],
    ]
)


def test_arctan_law_is_equation_2() -> None:
    # At beta v = 1, sqrt(3) and 1 / sqrt(3) the arctangent is pi / 4, pi / 3 and pi / 6.
    beta = 1e5
    v = np.array([1.0, sqrt(3.0), 1.0 / sqrt(3.0)]) / beta
    np.testing.assert_allclose(friction.force(v, beta), [1 / 2, 2 / 3, 1 / 3], rtol=4 * EPS)


@pytest.mark.parametrize("beta", BETAS)
@pytest.mark.parametrize(("a", "b"), [(0.0, 1.0), (-3.0, 5.0), (0.1, 40.0), (-200.0, 1.0)])
def test_force_is_the_derivative_of_the_potential(beta: float, a: float, b: float) -> None:
    integral, _ = quad(
        lambda z: float(friction.force(z / beta, beta)), a, b, epsabs=0.0, epsrel=1e-13, limit=200
    )
    difference = friction.potential(b / beta, beta) - friction.potential(a / beta, beta)
    largest = max(friction.potential(a / beta, beta), friction.potential(b / beta, beta))
    assert difference == pytest.approx(integral / beta, rel=1e-11, abs=1e-13 * largest)


@pytest.mark.parametrize("beta", BETAS)
@pytest.mark.parametrize(("a", "b"), [(0.0, 1.0), (-3.0, 5.0), (0.1, 40.0), (-200.0, 1.0)])
def test_slope_is_the_derivative_of_the_force(beta: float, a: float, b: float) -> None:
    integral, _ = quad(
        lambda z: float(friction.slope(z / beta, beta)), a, b, epsrel=1e-13, limit=200
    )
    difference = friction.force(b / beta, beta) - friction.force(a / beta, beta)
    assert difference == pytest.approx(integral / beta, rel=1e-11)


def test_coulomb_potential_force_and_slope() -> None:
    v = np.array([-2.0, -1e-300, 0.0, 1e-300, 3.0])
    np.testing.assert_array_equal(friction.potential(v, inf), np.abs(v))
    np.testing.assert_array_equal(friction.force(v, inf), [-1.0, -1.0, 0.0, 1.0, 1.0])
    np.testing.assert_array_equal(friction.slope(v, inf), [0.0, 0.0, inf, 0.0, 0.0])


@pytest.mark.parametrize("beta", [*BETAS, inf])
def test_force_is_odd_monotone_and_bounded_and_the_potential_even_and_convex(beta: float) -> None:
    v = np.sort(
        np.concatenate([-np.geomspace(1e-15, 10, 400), [0.0], np.geomspace(1e-15, 10, 400)])
    )
    force, potential = friction.force(v, beta), friction.potential(v, beta)
    np.testing.assert_array_equal(force, -friction.force(-v, beta))
    np.testing.assert_array_equal(potential, friction.potential(-v, beta))
    assert np.all(np.diff(force) >= 0.0)
    assert np.all(np.abs(force) <= 1.0)
    assert np.all(friction.slope(v, beta) >= 0.0)
    assert friction.potential(0.0, beta) == 0.0
    # A function is convex if it lies above all of its tangents: psi(y) >= psi(x) + sigma(x) (y-x).
    tangents = potential[:, None] + force[:, None] * (v[None, :] - v[:, None])
    assert np.all(potential[None, :] >= tangents - 1e-14 * (1.0 + np.abs(v)[None, :]))


def test_laws_of_different_points_broadcast() -> None:
    v, beta = np.array([1e-5, 1e-5, 0.0]), np.array([1e5, inf, inf])
    np.testing.assert_allclose(friction.force(v, beta), [0.5, 1.0, 0.0], rtol=4 * EPS)
    resolved = friction.resolvent(np.array([1.5, 1.5, 0.5]), 2.0, beta)
    np.testing.assert_array_equal(resolved[1:], [0.25, 0.0])


@pytest.mark.parametrize("kappa", [1e-6, 1e-2, 1.0, 1e3, 1e8])
@pytest.mark.parametrize("beta", BETAS)
def test_resolvent_solves_its_equation_to_round_off(beta: float, kappa: float) -> None:
    v = friction.resolvent(PARAMETERS, kappa, beta)
    residual = kappa * v + friction.force(v, beta) - PARAMETERS
    assert np.all(np.abs(residual) <= 8 * EPS * np.maximum(np.abs(PARAMETERS), EPS))


@pytest.mark.parametrize("kappa", [1e-6, 1.0, 1e8])
def test_resolvent_of_coulomb_sticks_below_the_limit_and_slips_at_it(kappa: float) -> None:
    v = friction.resolvent(PARAMETERS, kappa, inf)
    sticks = np.abs(PARAMETERS) <= 1.0
    assert np.all(v[sticks] == 0.0)
    slips = ~sticks
    residual = kappa * v[slips] + np.sign(v[slips]) - PARAMETERS[slips]
    assert np.all(np.abs(residual) <= 4 * EPS * np.abs(PARAMETERS[slips]))


@pytest.mark.parametrize("beta", BETAS)
def test_resolvent_of_arctan_tends_to_that_of_coulomb(beta: float) -> None:
    # 1 - sigma(v) <= 2 / (pi beta v), hence kappa d^2 <= 2 / (pi beta) for the distance d; the
    # bound is met at s = 1 up to the next term of the arctangent.
    kappa = 3.0
    distance = friction.resolvent(PARAMETERS, kappa, beta) - friction.resolvent(
        PARAMETERS, kappa, inf
    )
    bound = sqrt(2.0 / (pi * kappa * beta))
    assert np.all(np.abs(distance) <= bound * (1.0 + 1e-9))
    assert friction.resolvent(1.0, kappa, beta) == pytest.approx(bound, rel=0.1)


@pytest.mark.parametrize("kappa", [1e-4, 1.0, 1e4])
@pytest.mark.parametrize("beta", BETAS)
def test_graph_point_lies_on_the_graph_of_the_law(beta: float, kappa: float) -> None:
    for s in PARAMETERS:
        v, sigma, dv, dsigma = friction.graph_point(float(s), kappa, beta)
        assert sigma == pytest.approx(float(friction.force(v, beta)), rel=4 * EPS)
        assert dsigma == pytest.approx(float(friction.slope(v, beta)) * dv, rel=16 * EPS)
        assert dv > 0.0
        # Bounded however steep the law: by the scale, and by (1 + z)^2 / (1 + z^2) <= 2.
        assert dv <= (1.0 + 1e-12) / kappa
        assert dsigma <= 4.0 / pi * (1.0 + 1e-12)


@pytest.mark.parametrize("kappa", [1e-4, 1.0, 1e4])
@pytest.mark.parametrize("beta", BETAS)
def test_slopes_of_graph_point_are_those_of_the_rational_resolvent(
    beta: float, kappa: float
) -> None:
    # s = kappa v + z / (z + 1), z = beta v, so dv/ds = 1 / (kappa + beta / (z + 1)^2).
    for s in PARAMETERS:
        v, _, dv, _ = friction.graph_point(float(s), kappa, beta)
        z = beta * abs(v)
        assert dv == pytest.approx(1.0 / (kappa + beta / (z + 1.0) ** 2), rel=1e-12)


def test_graph_point_of_coulomb_is_the_resolvent() -> None:
    kappa = 3.0
    for s in PARAMETERS:
        v, sigma, dv, dsigma = friction.graph_point(float(s), kappa, inf)
        assert v == pytest.approx(float(friction.resolvent(s, kappa, inf)), rel=4 * EPS)
        assert sigma == np.clip(s, -1.0, 1.0)
        assert (dv, dsigma) == ((0.0, 1.0) if abs(s) <= 1.0 else (1.0 / kappa, 0.0))


@pytest.mark.parametrize("kappa", [1e-4, 1.0, 1e4])
@pytest.mark.parametrize("beta", [*BETAS, inf])
def test_parameter_is_the_inverse_of_graph_point(beta: float, kappa: float) -> None:
    for s in PARAMETERS:
        v, sigma, _, _ = friction.graph_point(float(s), kappa, beta)
        assert float(friction.parameter(v, sigma, kappa, beta)) == pytest.approx(s, rel=8 * EPS)
