"""Step problems on chains: each tier finds the minimiser, passes follow slip fronts."""

from typing import Any

import numpy as np
import pytest
from scipy import sparse

from skfem_joint.linalg.kernels import Bands
from skfem_joint.minimise import law, minty_newton
from skfem_joint.minimise.front_elimination import (
    Chain,
    FrontElimination,
    build_chain,
    chain_workspace,
    eliminate_fronts,
)
from skfem_joint.minimise.problem import ContactPoints

LAWS = [1e2, 1e5, 1e9, np.inf]


def tridiagonal(diagonal: Any, off: Any) -> Any:
    return np.diag(diagonal) + np.diag(off, 1) + np.diag(off, -1)


def problem(n: int, beta: float, seed: int, stiffness: float = 50.0) -> tuple[Any, ...]:
    """Random step problem: H a stiff chain, g a mixture of forces above and below the limits."""
    rng = np.random.default_rng(seed)
    springs = rng.uniform(0.5, 2.0, n + 1) * stiffness
    H0 = rng.uniform(0.5, 2.0, n) + springs[:-1] + springs[1:]
    H1 = -springs[1:-1]
    w = rng.uniform(0.5, 1.5, n) * (rng.random(n) < 0.8)
    g = 3.0 * rng.normal(size=n)
    return H0, H1, w, np.full(n, beta), g


def chain_of(H0: Any, H1: Any, w: Any, beta: Any) -> Chain:
    return build_chain(Bands(H0, H1), w, beta)


def solve(method: str, H0: Any, H1: Any, w: Any, beta: Any, g: Any) -> tuple[bool, Any, Any]:
    """Solution by one tier alone: converged, v and sigma."""
    n = g.size
    chain = chain_of(H0, H1, w, beta)
    padded, s = np.zeros(chain.H0.size), np.zeros(chain.H0.size)
    padded[:n] = g
    work, trial = np.zeros((6, n)), np.zeros((3, n))
    if method == "newton":
        converged = minty_newton._newton(chain, 0, padded, s, work, 200, 1e-12)[1]
    elif method == "descend":
        converged = minty_newton._descend(chain, padded, s, work, trial, 1e-12)[1]
    else:
        converged = minty_newton._nested(chain, padded, s, work, 1e-12)[1]
    return bool(converged), work[0].copy(), work[1].copy()


# Newton alone may stall from a cold start on a long chain: that is what the other two are for.
@pytest.mark.parametrize(
    ("method", "n"),
    [("newton", 2), ("newton", 60), *((m, n) for m in ("nested", "descend") for n in (2, 60, 130))],
)
@pytest.mark.parametrize("beta", LAWS)
def test_every_tier_converges_to_the_minimiser_of_the_step(method, beta, n):
    for seed in range(5):
        H0, H1, w, betas, g = problem(n, beta, seed)
        converged, v, sigma = solve(method, H0, H1, w, betas, g)
        assert converged
        residual = tridiagonal(H0, H1) @ v + w * sigma - g
        assert np.abs(residual).max() <= 1e-11 * max(1.0, np.abs(g).max())
        pressed = w > 0.0
        assert np.all(np.abs(sigma) <= 1.0)
        if np.isinf(beta):
            slips = pressed & (v != 0.0)
            np.testing.assert_array_equal(sigma[slips], np.sign(v[slips]))
        else:
            expected = law.force(v[pressed], beta)
            np.testing.assert_allclose(sigma[pressed], expected, rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("stiffness", [50.0, 1e3, 1e5])
def test_flips_of_coulomb_points_end(stiffness):
    # Flipping all points at once cycles in about one in twelve; one at a time must come to an end.
    for n in (40, 60, 130):
        for seed in range(100):
            H0, H1, w, beta, g = problem(n, np.inf, seed, stiffness)
            converged, v, sigma = solve("newton", H0, H1, w, beta, g)
            assert converged, (n, seed)
            slips = (w > 0.0) & (v != 0.0)
            np.testing.assert_array_equal(sigma[slips], np.sign(v[slips]))


def passes(H0: Any, H1: Any, w: Any, g: Any, middle: int) -> tuple[int, bool, Any, Any, Any]:
    """Solution by passes alone: number, converged, v, sigma and s."""
    n = g.size
    chain = chain_of(H0, H1, w, np.full(n, np.inf))
    space = chain_workspace(n)
    space.middle[0] = middle
    count, converged = eliminate_fronts(chain, space, g, chain.hold, 1e-12)
    inside = space.new_parameter - chain.kappa * space.velocity
    return int(count), bool(converged), space.velocity, space.force, inside


@pytest.mark.parametrize("ends", ["left", "right", "left and right"])
@pytest.mark.parametrize("n", [1, 2, 3, 40, 131, 1000])
def test_a_few_passes_find_slip_that_spreads_from_the_ends(n, ends):
    for seed in range(20):
        H0, H1, w, _, g = problem(n, np.inf, seed, stiffness=1e3)
        w = np.maximum(w, 0.5)
        g = 0.1 * g * w
        g[0] -= 0.3 * w.sum() * ("left" in ends)
        g[-1] += 0.3 * w.sum() * ("right" in ends)
        count, converged, v, sigma, inside = passes(H0, H1, w, g, n // 2)
        assert converged
        assert count <= 6
        residual = tridiagonal(H0, H1) @ v + w * sigma - g
        assert np.abs(residual).max() <= 1e-11 * np.abs(g).max()
        assert np.all(np.abs(sigma) <= 1.0)
        np.testing.assert_array_equal(sigma[v != 0.0], np.sign(v[v != 0.0]))
        np.testing.assert_allclose(inside, sigma, rtol=0.0, atol=1e-12 * (1 + np.abs(v).max()))
        if n > 3:
            assert 0 < np.count_nonzero(v) < n


@pytest.mark.parametrize("beta", LAWS)
@pytest.mark.parametrize("n", [2, 60, 130])
def test_the_method_finds_the_minimiser_whatever_its_start(n, beta):
    """The objective there is below that of its neighbours, too."""
    rng = np.random.default_rng(4)
    for seed in range(5):
        H0, H1, w, betas, g = problem(n, beta, seed)
        A = sparse.csr_array(tridiagonal(H0, H1))
        rows = sparse.csr_array(sparse.eye_array(n))
        made = FrontElimination(A, ContactPoints(rows, np.ones(n, int), w, betas))
        rest = made.minimise(g, None, 1e-12)
        far = made.minimise(g, 1e3 * rng.normal(size=n), 1e-12)
        softer = made.minimise(g, None, 1e-12, np.full(n, 3e3))
        assert rest.converged
        assert far.converged
        assert np.abs(A @ rest.v + w * rest.sigma - g).max() <= 1e-11 * np.abs(g).max()
        np.testing.assert_allclose(far.v, rest.v, atol=1e-9 * np.abs(rest.v).max())
        assert softer.converged
        np.testing.assert_allclose(
            softer.sigma[w > 0.0], law.force(softer.v[w > 0.0], 3e3), rtol=1e-9, atol=1e-12
        )
        least = made.objective(rest.v, g)
        for _ in range(10):
            near = rest.v + (1e-3 + 1e-2 * np.abs(rest.v).max()) * rng.normal(size=n)
            assert made.objective(near, g) > least
