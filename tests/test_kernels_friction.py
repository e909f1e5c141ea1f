"""Compiled friction laws: the same functions as the plain ones, to round-off."""

from __future__ import annotations

from math import inf, pi
from typing import Any

import numpy as np
import pytest

from skfem_joint import friction
from skfem_joint import kernels_friction as kernels
from skfem_joint.friction import ARCTAN, COULOMB, FREE

EPS = float(np.finfo(float).eps)
KAPPAS = [1e-2, 1.0, 1e3, 1e6]
BETAS = [1e2, 1e5, 1e9]
PARAMETERS = np.concatenate(
    [
        -np.geomspace(1e-12, 50.0, 60),
        [0.0],
        np.geomspace(1e-12, 50.0, 60),
        1.0 + np.linspace(-1e-3, 1e-3, 41),
        [-1.0, 1.0, np.nextafter(1.0, 0.0), np.nextafter(1.0, 2.0), -np.nextafter(1.0, 2.0)],
    ]
)


@kernels.compiled
def arctangents(z: Any, result: Any) -> None:
    for i in range(z.size):
        result[i] = kernels.arctangent(z[i])


def arctangent(z: Any) -> Any:
    result = np.empty_like(z)
    arctangents(z, result)
    return result


def graph(kind: Any, kappa: float, inverse_beta: Any, s: Any) -> Any:
    """Rows v, sigma, dv, dsigma for points of the given kinds."""
    kind = np.asarray(kind, dtype=np.int8)
    regular = kind == ARCTAN
    mixed = 0 if np.all(regular) else 1 if np.any(regular) else 2
    rows = np.full((4, s.size), np.nan)
    kernels.graph(kind, mixed, kappa, inverse_beta, s, *rows)
    return rows


def plain_graph(kind: Any, kappa: float, inverse_beta: Any, s: Any) -> Any:
    def point(k: int, inverse: float, parameter: float) -> tuple[float, ...]:
        if k == FREE:
            return parameter / kappa, 0.0, 1.0 / kappa, 0.0
        return friction.graph_point(parameter, kappa, inf if k == COULOMB else 1.0 / inverse)

    return np.array([point(*p) for p in zip(kind, inverse_beta, s.tolist(), strict=True)]).T


def agree(rows: Any, expected: Any) -> None:
    for row, plain in zip(rows, expected, strict=True):
        np.testing.assert_allclose(row, plain, rtol=32 * EPS, atol=0.0)


# Arctangent


def test_arctangent_is_right_to_four_parts_in_ten_to_the_sixteen() -> None:
    z = np.concatenate(
        [
            np.geomspace(1e-12, 1e12, 200_001),
            *(np.tan(k * pi / 8.0) * (1.0 + EPS * np.arange(-50, 51)) for k in (1, 2, 3)),
            np.linspace(0.3, 3.0, 50_001),
        ]
    )
    exact = np.arctan(z)
    assert np.abs(arctangent(z) / exact - 1.0).max() < 4e-16


def test_arctangent_at_the_ends_is_exact() -> None:
    np.testing.assert_array_equal(
        arctangent(np.array([0.0, 1e-300, 1e-30, 1e30, 1e300, inf])),
        [0.0, 1e-300, 1e-30, pi / 2, pi / 2, pi / 2],
    )


def test_arctangents_of_reciprocals_add_up_to_a_right_angle() -> None:
    z = np.geomspace(1e-6, 1e6, 10_001)
    total = arctangent(z) + arctangent(1.0 / z)
    np.testing.assert_allclose(total, pi / 2, rtol=4 * EPS, atol=0.0)


def test_arctangent_of_what_is_not_a_number_is_not_a_number() -> None:
    assert np.isnan(arctangent(np.array([np.nan])))[0]


# Graph


@pytest.mark.parametrize("kappa", KAPPAS)
@pytest.mark.parametrize("beta", BETAS)
def test_graph_of_arctan_points_is_the_plain_graph(kappa: float, beta: float) -> None:
    kind = np.full(PARAMETERS.size, ARCTAN)
    inverse_beta = np.full(PARAMETERS.size, 1.0 / beta)
    agree(
        graph(kind, kappa, inverse_beta, PARAMETERS),
        plain_graph(kind, kappa, inverse_beta, PARAMETERS),
    )


@pytest.mark.parametrize("kappa", KAPPAS)
@pytest.mark.parametrize("point", [COULOMB, FREE])
def test_graph_of_coulomb_and_free_points_is_the_plain_graph(kappa: float, point: int) -> None:
    kind = np.full(PARAMETERS.size, point)
    ones = np.ones(PARAMETERS.size)
    agree(graph(kind, kappa, ones, PARAMETERS), plain_graph(kind, kappa, ones, PARAMETERS))


@pytest.mark.parametrize("kappa", KAPPAS)
@pytest.mark.parametrize("kinds", [(0, 1), (0, 2), (1, 2), (0, 1, 2)])
def test_graph_of_mixed_points_is_the_plain_graph_of_each(
    kappa: float, kinds: tuple[int, ...]
) -> None:
    rng = np.random.default_rng(0)
    for beta in BETAS:
        kind = rng.choice(kinds, PARAMETERS.size)
        inverse_beta = np.where(kind == ARCTAN, 1.0 / (beta * rng.uniform(0.5, 2.0, kind.size)), 1)
        agree(
            graph(kind, kappa, inverse_beta, PARAMETERS),
            plain_graph(kind, kappa, inverse_beta, PARAMETERS),
        )


def test_graph_of_a_parameter_that_is_not_a_number_is_not_a_number() -> None:
    for point in (ARCTAN, COULOMB, FREE):
        v = graph([point], 1e3, np.array([1e-5]), np.array([np.nan]))[0]
        assert np.isnan(v[0]), point


# Resolvent and force


@pytest.mark.parametrize("kappa", KAPPAS)
@pytest.mark.parametrize("beta", [*BETAS, inf])
def test_scalar_resolvent_is_the_plain_resolvent(kappa: float, beta: float) -> None:
    v, sigma = np.array([kernels.scalar_resolvent(x, kappa, beta) for x in PARAMETERS]).T
    expected = friction.resolvent(PARAMETERS, kappa, beta)
    np.testing.assert_allclose(v, expected, rtol=32 * EPS, atol=0.0)
    balance = kappa * v + sigma - PARAMETERS
    assert np.all(np.abs(balance) <= 4 * EPS * np.abs(PARAMETERS))
    if np.isinf(beta):
        np.testing.assert_array_equal(sigma[v != 0.0], np.sign(v[v != 0.0]))
        assert np.all(np.abs(sigma) <= 1.0)
    else:
        np.testing.assert_allclose(sigma, friction.force(v, beta), rtol=8 * EPS, atol=0.0)


def test_forces_are_the_plain_forces() -> None:
    rng = np.random.default_rng(0)
    slip = rng.normal(size=10_000) * 10.0 ** rng.uniform(-15.0, 3.0, 10_000)
    slip[:3] = 0.0, 1e300, -1e300
    beta = 10.0 ** rng.uniform(0.0, 7.0, slip.size)
    sigma = np.full(slip.size, np.nan)
    kernels.forces(beta, slip, sigma)
    np.testing.assert_allclose(sigma, friction.force(slip, beta), rtol=4 * EPS, atol=0.0)
    assert np.all(np.abs(sigma) <= 1.0)
