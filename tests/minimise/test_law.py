"""The law of friction: force, slope, potential, slip vectors, resolvent, graph and its inverse."""

import math
from itertools import pairwise
from math import inf, pi, sqrt
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad

from skfem_joint.ground.compiling import compiled
from skfem_joint.minimise import law
from skfem_joint.minimise.law import COULOMB, FREE, REGULAR

EPS = float(np.finfo(float).eps)
BETAS = [1e2, 1e5, 1e9, 1e12]
KAPPAS = [1e-6, 1e-2, 1.0, 1e3, 1e8]
PARAMETERS = np.concatenate(
    [
        -np.geomspace(1e-12, 50.0, 60),
        [0.0],
        np.geomspace(1e-12, 50.0, 60),
        1.0 + np.linspace(-1e-3, 1e-3, 41),
        [-1.0, np.nextafter(1.0, 0.0), np.nextafter(1.0, 2.0), -np.nextafter(1.0, 2.0)],
    ]
)


def test_arctan_law_is_equation_2():
    # At beta v = 1, sqrt(3) and 1 / sqrt(3) the arctangent is pi / 4, pi / 3 and pi / 6.
    beta = 1e5
    v = np.array([1.0, sqrt(3.0), 1.0 / sqrt(3.0)]) / beta
    np.testing.assert_allclose(law.force(v, beta), [1 / 2, 2 / 3, 1 / 3], rtol=4 * EPS)


@pytest.mark.parametrize("beta", BETAS)
@pytest.mark.parametrize("soft", [0.0, 2.0])
@pytest.mark.parametrize(("a", "b"), [(0.0, 1.0), (-3.0, 5.0), (0.1, 40.0), (-200.0, 1.0)])
def test_force_and_slope_are_derivatives_of_the_potential_and_of_the_force(a, b, soft, beta):
    """Alone and with a spring in series."""
    laws = law.potential, law.force, law.force_slope
    for function, derivative in pairwise(laws):
        integral, _ = quad(
            lambda z, law=derivative: float(law(z / beta, beta, soft / beta)),
            a, b, epsrel=1e-13, limit=200,
        )  # fmt: skip
        difference = function(b / beta, beta, soft / beta) - function(a / beta, beta, soft / beta)
        assert difference == pytest.approx(integral / beta, rel=1e-11)


@pytest.mark.parametrize("beta", [*BETAS, inf])
def test_potential_is_even_and_convex_and_no_larger_than_coulombs(beta):
    v = np.linspace(-10.0, 10.0, 401)
    psi = law.potential(v, beta)
    np.testing.assert_array_equal(psi, law.potential(-v, beta))
    assert np.all(np.diff(psi, 2) >= -8 * EPS * psi.max())
    assert law.potential(0.0, beta) == 0.0
    assert np.all(psi <= np.abs(v))


@pytest.mark.parametrize("beta", [*BETAS, inf])
def test_force_is_odd_monotone_and_bounded(beta):
    v = np.concatenate([-np.geomspace(10, 1e-15, 400), [0.0], np.geomspace(1e-15, 10, 400)])
    force = law.force(v, beta)
    np.testing.assert_array_equal(force, -law.force(-v, beta))
    assert np.all(np.diff(force) >= 0.0)
    assert np.all(np.abs(force) <= 1.0)
    assert np.all(law.force_slope(v, beta) >= 0.0)


def test_coulomb_is_the_limit_of_steeper_and_steeper_laws():
    v = np.array([-3.0, -1e-2, 1e-2, 0.7])
    for beta in (1e6, 1e9, 1e12):
        np.testing.assert_allclose(law.force(v, beta), law.force(v, inf), atol=100.0 / beta)
        np.testing.assert_allclose(law.potential(v, beta), np.abs(v), atol=30.0 / beta)
        found = np.array([law.resolvent(x, 2.0, beta) for x in v.tolist()])
        exact = np.array([law.resolvent(x, 2.0, inf) for x in v.tolist()])
        np.testing.assert_allclose(found, exact, atol=100.0 / beta)
    assert law.force(0.0, inf) == 0.0
    assert law.force_slope(np.array([0.0, 1.0]), inf).tolist() == [inf, 0.0]


def test_stiffness_across_a_slip_is_force_over_speed_and_the_slope_at_rest():
    for beta in BETAS:
        for speed in (1e-9, 1e-3, 2.0):
            across = law.along_and_across(np.array(speed), beta)[1]
            assert across == pytest.approx(float(law.force(speed, beta)) / speed)
        assert law.along_and_across(np.array(0.0), beta)[1] == law.force_slope(0.0, beta)
    assert law.along_and_across(np.array(0.5), inf)[1] == 2.0


def slips(count: int = 50) -> np.ndarray:
    generator = np.random.default_rng(3)
    return generator.standard_normal((count, 2)) * 10.0 ** generator.uniform(-9, 1, (count, 1))


@pytest.mark.parametrize("beta", [*BETAS, inf])
def test_force_has_the_slip_s_direction_and_the_scalar_law_s_size(beta):
    y = slips()
    two = np.full(len(y), 2)
    f = law.force_vectors(y.ravel(), beta, two).reshape(-1, 2)
    size = np.hypot(*y.T)
    np.testing.assert_allclose(np.hypot(*f.T), law.force(size, beta), rtol=8 * EPS)
    np.testing.assert_allclose(f[:, 0] * y[:, 1], f[:, 1] * y[:, 0], rtol=8 * EPS)
    assert np.all(np.einsum("pd,pd->p", f, y) > 0.0)
    assert np.array_equal(law.force_vectors(np.zeros(4), beta, two[:2]), np.zeros(4))


@compiled
def arctangents(z: Any, result: Any) -> None:
    for i in range(z.size):
        result[i] = law.arctangent(z[i])


def arctangent(z: Any) -> Any:
    result = np.empty_like(z)
    arctangents(z, result)
    return result


def test_arctangent_is_right_to_four_parts_in_ten_to_the_sixteen():
    z = np.concatenate(
        [
            np.geomspace(1e-12, 1e12, 200_001),
            *(np.tan(k * pi / 8.0) * (1.0 + EPS * np.arange(-50, 51)) for k in (1, 2, 3)),
            np.linspace(0.3, 3.0, 50_001),
        ]
    )
    right = np.array([math.atan(x) for x in z.tolist()])  # numpy's own differs between versions
    assert np.abs(arctangent(z) / right - 1.0).max() < 4e-16
    total = arctangent(z) + arctangent(1.0 / z)
    np.testing.assert_allclose(total, pi / 2, rtol=4 * EPS, atol=0.0)


def test_compiled_forces_are_the_plain_ones():
    rng = np.random.default_rng(0)
    slip = rng.normal(size=10_000) * 10.0 ** rng.uniform(-15.0, 3.0, 10_000)
    slip[:3] = 0.0, 1e300, -1e300
    beta = 10.0 ** rng.uniform(0.0, 7.0, slip.size)
    sigma = np.full(slip.size, np.nan)
    law.forces(beta, slip, sigma)
    np.testing.assert_allclose(sigma, law.force(slip, beta), rtol=4 * EPS, atol=0.0)
    assert np.all(np.abs(sigma) <= 1.0)


def resolved(kappa: float, beta: float) -> Any:
    """Velocity and force at all parameters by the compiled resolvent."""
    return np.array([law.resolvent(s, kappa, beta) for s in PARAMETERS.tolist()]).T


@pytest.mark.parametrize("kappa", KAPPAS)
@pytest.mark.parametrize("beta", [*BETAS, inf])
def test_resolvent_solves_its_equation_to_round_off(beta, kappa):
    """It solves ``kappa v + sigma = s`` with v and sigma on the graph of the law."""
    v, sigma = resolved(kappa, beta)
    residual = kappa * v + sigma - PARAMETERS
    assert np.all(np.abs(residual) <= 8 * EPS * np.maximum(np.abs(PARAMETERS), EPS))
    if np.isinf(beta):
        np.testing.assert_array_equal(v == 0.0, np.abs(PARAMETERS) <= 1.0)
        np.testing.assert_array_equal(sigma[v != 0.0], np.sign(v[v != 0.0]))
        assert np.all(np.abs(sigma) <= 1.0)
    else:
        np.testing.assert_allclose(sigma, law.force(v, beta), rtol=8 * EPS, atol=0.0)


@pytest.mark.parametrize("kappa", KAPPAS)
@pytest.mark.parametrize("kind", [REGULAR, COULOMB, FREE])
def test_points_of_the_graph_lie_on_the_law_and_know_their_parameter(kind, kappa):
    """Their slopes show in the iterations that the tests of chains count."""
    kinds, mixed = np.full(PARAMETERS.size, kind, dtype=np.int8), 0 if kind == REGULAR else 2
    for beta in BETAS:
        inverse = np.full(PARAMETERS.size, 1.0 / beta)
        v, sigma, dv, dsigma, again = np.full((5, PARAMETERS.size), np.nan)
        law.graph(kinds, mixed, kappa, inverse, PARAMETERS, v, sigma, dv, dsigma)
        laws = {REGULAR: law.force(v, beta), COULOMB: np.clip(PARAMETERS, -1, 1), FREE: 0.0 * v}
        np.testing.assert_allclose(sigma, laws[kind], rtol=1e-11, atol=0.0)
        law.graph_parameters(kinds, kappa, inverse, v, sigma, again)
        np.testing.assert_allclose(again, PARAMETERS, rtol=1e-12, atol=0.0)


@compiled
def _tangent_at(w, x, y, beta, soft, stiffest, out):
    law.add_tangent(w, x, y, True, beta, soft, stiffest, out)


@pytest.mark.parametrize("soft", [0.0, 0.3])
@pytest.mark.parametrize("beta", [2.0, inf])
def test_tangent_of_a_slip_vector_has_its_directions_and_is_no_stiffer_than_asked_for(beta, soft):
    """Problems with contact that opens have the test of its values."""
    w = 1.7
    for slip in ([0.9, -0.4], [-0.2, -0.7], [3.0, 0.1]):
        entries, capped = np.zeros((2, 3))
        _tangent_at(w, *slip, beta, soft, inf, entries)
        along, across = (w * float(x) for x in law.along_and_across(np.hypot(*slip), beta, soft))
        e = np.array(slip) / np.hypot(*slip)
        expected = law.slip_tangent(along - across, across, *e, *e)
        np.testing.assert_allclose(entries, expected, rtol=1e-14)
        _tangent_at(w, *slip, beta, soft, 0.1, capped)
        stiffest = np.linalg.eigvalsh([[capped[0], capped[1]], [capped[1], capped[2]]])[1]
        if np.isinf(beta):
            assert stiffest == pytest.approx(0.1)
    if np.isinf(beta) and soft == 0.0:
        at_rest = np.zeros(3)
        _tangent_at(w, 0.0, 0.0, beta, soft, inf, at_rest)
        assert not at_rest.any()
