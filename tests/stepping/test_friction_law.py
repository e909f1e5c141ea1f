"""The friction law: force, slope, slip vectors, graph, and the compiled functions of them."""

import math
from math import inf, pi, sqrt
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad

from skfem_joint import friction
from skfem_joint.friction import ARCTAN, COULOMB, FREE
from skfem_joint.stepping import compiled

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
    np.testing.assert_allclose(friction.force(v, beta), [1 / 2, 2 / 3, 1 / 3], rtol=4 * EPS)


@pytest.mark.parametrize("beta", BETAS)
@pytest.mark.parametrize(("a", "b"), [(0.0, 1.0), (-3.0, 5.0), (0.1, 40.0), (-200.0, 1.0)])
def test_slope_is_the_derivative_of_the_force(beta, a, b):
    integral, _ = quad(
        lambda z: float(friction.slope(z / beta, beta)), a, b, epsrel=1e-13, limit=200
    )
    difference = friction.force(b / beta, beta) - friction.force(a / beta, beta)
    assert difference == pytest.approx(integral / beta, rel=1e-11)


@pytest.mark.parametrize("beta", [*BETAS, inf])
def test_force_is_odd_monotone_and_bounded(beta):
    v = np.sort(
        np.concatenate([-np.geomspace(1e-15, 10, 400), [0.0], np.geomspace(1e-15, 10, 400)])
    )
    force = friction.force(v, beta)
    np.testing.assert_array_equal(force, -friction.force(-v, beta))
    assert np.all(np.diff(force) >= 0.0)
    assert np.all(np.abs(force) <= 1.0)
    assert np.all(friction.slope(v, beta) >= 0.0)


def slips(count: int = 50) -> np.ndarray:
    generator = np.random.default_rng(3)
    return generator.standard_normal((count, 2)) * 10.0 ** generator.uniform(-9, 1, (count, 1))


@pytest.mark.parametrize("beta", [*BETAS, inf])
def test_force_has_the_slip_s_direction_and_the_scalar_law_s_size(beta):
    y = slips()
    two = np.full(len(y), 2)
    f = friction.force_vectors(y.ravel(), beta, two).reshape(-1, 2)
    size = np.hypot(*y.T)
    np.testing.assert_allclose(np.hypot(*f.T), friction.force(size, beta), rtol=8 * EPS)
    np.testing.assert_allclose(f[:, 0] * y[:, 1], f[:, 1] * y[:, 0], rtol=8 * EPS)
    assert np.all(np.einsum("pd,pd->p", f, y) > 0.0)
    assert np.array_equal(friction.force_vectors(np.zeros(4), beta, two[:2]), np.zeros(4))


@compiled.compiled
def arctangents(z: Any, result: Any) -> None:
    for i in range(z.size):
        result[i] = compiled.arctangent(z[i])


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
    compiled.forces(beta, slip, sigma)
    np.testing.assert_allclose(sigma, friction.force(slip, beta), rtol=4 * EPS, atol=0.0)
    assert np.all(np.abs(sigma) <= 1.0)


def resolved(kappa: float, beta: float) -> Any:
    """Velocity and force at all parameters by the compiled resolvent."""
    return np.array([compiled.resolvent(s, kappa, beta) for s in PARAMETERS.tolist()]).T


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
        np.testing.assert_allclose(sigma, friction.force(v, beta), rtol=8 * EPS, atol=0.0)


def graph(kind: Any, kappa: float, beta: Any, s: Any) -> Any:
    """Rows v, sigma, dv, dsigma for points of the given kinds."""
    kind = np.asarray(kind, dtype=np.int8)
    regular = kind == ARCTAN
    mixed = 0 if np.all(regular) else 1 if np.any(regular) else 2
    rows = np.full((4, s.size), np.nan)
    compiled.graph(kind, mixed, kappa, 1.0 / np.where(regular, beta, 1.0), s, *rows)
    return rows


@pytest.mark.parametrize("kappa", KAPPAS)
@pytest.mark.parametrize("kinds", [(0,), (1,), (2,), (0, 1), (0, 2), (1, 2), (0, 1, 2)])
def test_points_of_the_graph_lie_on_the_law_with_bounded_slopes(kappa, kinds):
    rng = np.random.default_rng(0)
    for steep in BETAS:
        kind = rng.choice(kinds, PARAMETERS.size).astype(np.int8)
        beta = steep * rng.uniform(0.5, 2.0, kind.size)
        rows = graph(kind, kappa, beta, PARAMETERS)
        inside = np.clip(PARAMETERS, -1.0, 1.0)
        sticks = np.abs(PARAMETERS) <= 1.0
        for point in kinds:
            here = kind == point
            s, b = PARAMETERS[here], beta[here]
            v, sigma, dv, dsigma = rows[:, here]
            if point == FREE:
                expected = [s / kappa, 0.0 * s, 1.0 / kappa + 0.0 * s, 0.0 * s]
            elif point == COULOMB:
                stick = sticks[here]
                expected = [(s - inside[here]) / kappa, inside[here], ~stick / kappa, 1.0 * stick]
            else:
                # s = kappa v + z / (z + 1), z = beta v, so dv/ds = 1 / (kappa + beta / (z + 1)^2).
                z = b * np.abs(v)
                np.testing.assert_allclose(kappa * np.abs(v) + z / (z + 1.0), np.abs(s), rtol=1e-12)
                slope = 1.0 / (kappa + b / (z + 1.0) ** 2)
                force = friction.force(v, b)
                expected = [v, force, slope, slope * friction.slope(v, b)]
                assert np.all((dv > 0.0) & (dv <= (1.0 + 1e-12) / kappa))
                assert np.all(dsigma <= 4.0 / pi * (1.0 + 1e-12))
                assert np.all(v * s >= 0.0)
            for found, right in zip((v, sigma, dv, dsigma), expected, strict=True):
                np.testing.assert_allclose(found, right, rtol=1e-11, atol=0.0)
            again = np.full(s.size, np.nan)
            compiled.parameters(kind[here], kappa, 1.0 / b, v, sigma, again)
            np.testing.assert_allclose(again, s, rtol=1e-12, atol=0.0)
