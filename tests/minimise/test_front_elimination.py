"""Step problems on chains: each tier finds the minimiser, passes follow slip fronts."""

from typing import Any, NamedTuple

import numpy as np
import pytest
from scipy import sparse

from skfem_joint.linalg.kernels import Bands
from skfem_joint.minimise import law, minty_newton
from skfem_joint.minimise.front_elimination import FrontElimination, build_chain
from skfem_joint.minimise.problem import ContactPoints

LAWS = [1e2, 1e5, 1e9, np.inf]


class Problem(NamedTuple):
    """Diagonals of H, limits, steepness and load."""

    H0: Any
    H1: Any
    w: Any
    beta: Any
    g: Any

    @property
    def A(self) -> Any:
        return sparse.diags_array([self.H1, self.H0, self.H1], offsets=[-1, 0, 1], format="csr")

    @property
    def method(self) -> FrontElimination:
        n = self.g.size
        rows = sparse.csr_array(sparse.eye_array(n))
        return FrontElimination(self.A, ContactPoints(rows, np.ones(n, int), self.w, self.beta))

    def assert_solved(self, converged: bool, v: Any, sigma: Any) -> None:
        """Forces balance, and friction is on the graph of the law."""
        assert converged
        residual = self.A @ v + self.w * sigma - self.g
        assert np.abs(residual).max() <= 1e-11 * max(1.0, np.abs(self.g).max())
        assert np.all(np.abs(sigma) <= 1.0)
        pressed = self.w > 0.0
        slips = pressed & (v != 0.0)
        if np.isinf(self.beta[0]):
            np.testing.assert_array_equal(sigma[slips], np.sign(v[slips]))
        else:
            expected = law.force(v[pressed], self.beta[0])
            np.testing.assert_allclose(sigma[pressed], expected, rtol=1e-12, atol=1e-15)


def problem(n: int, beta: float, seed: int, stiffness: float = 50.0) -> Problem:
    """Random step problem: H a stiff chain, g a mixture of forces above and below the limits."""
    rng = np.random.default_rng(seed)
    springs = rng.uniform(0.5, 2.0, n + 1) * stiffness
    H0 = rng.uniform(0.5, 2.0, n) + springs[:-1] + springs[1:]
    w = rng.uniform(0.5, 1.5, n) * (rng.random(n) < 0.8)
    return Problem(H0, -springs[1:-1], w, np.full(n, beta), 3.0 * rng.normal(size=n))


def solved_by(method: str, given: Problem) -> tuple[bool, Any, Any]:
    """Solution by one tier alone: converged, v and sigma."""
    n = given.g.size
    chain = build_chain(Bands(given.H0, given.H1), given.w, given.beta)
    padded, s = np.zeros(chain.H0.size), np.zeros(chain.H0.size)
    padded[:n] = given.g
    work, trial = np.zeros((6, n)), np.zeros((3, n))
    if method == "newton":
        converged = minty_newton._newton(chain, 0, padded, s, work, 200, 1e-12)[1]
    elif method == "descend":
        converged = minty_newton._descend(chain, padded, s, work, trial, 1e-12)[1]
    else:
        converged = minty_newton._nested(chain, padded, s, work, 1e-12)[1]
    return bool(converged), work[0], work[1]


# Newton alone may stall from a cold start on a long chain: that is what the other two are for.
@pytest.mark.parametrize(
    ("method", "n"),
    [("newton", 2), ("newton", 60), *((m, n) for m in ("nested", "descend") for n in (2, 60, 130))],
)
@pytest.mark.parametrize("beta", LAWS)
def test_every_tier_converges_to_the_minimiser_of_the_step(method, beta, n):
    for seed in range(5):
        given = problem(n, beta, seed)
        given.assert_solved(*solved_by(method, given))


@pytest.mark.parametrize("stiffness", [50.0, 1e3, 1e5])
def test_flips_of_coulomb_points_end(stiffness):
    # Flipping all points at once cycles in about one in twelve; one at a time must come to an end.
    for n in (40, 60, 130):
        for seed in range(100):
            given = problem(n, np.inf, seed, stiffness)
            converged, v, sigma = solved_by("newton", given)
            assert converged, (n, seed)
            slips = (given.w > 0.0) & (v != 0.0)
            np.testing.assert_array_equal(sigma[slips], np.sign(v[slips]))


@pytest.mark.parametrize("ends", ["left", "right", "left and right"])
@pytest.mark.parametrize("n", [1, 2, 3, 40, 131, 1000])
def test_a_few_passes_find_slip_that_spreads_from_the_ends(n, ends):
    for seed in range(20):
        given = problem(n, np.inf, seed, stiffness=1e3)
        w = np.maximum(given.w, 0.5)
        g = 0.1 * given.g * w
        g[0] -= 0.3 * w.sum() * ("left" in ends)
        g[-1] += 0.3 * w.sum() * ("right" in ends)
        given = given._replace(w=w, g=g)
        found = given.method.minimise(g, None, 1e-12)
        given.assert_solved(found.converged, found.v, found.sigma)
        assert found.counts["newton_iterations"] <= 6
        if n > 3:
            assert 0 < np.count_nonzero(found.v) < n


@pytest.mark.parametrize("beta", LAWS)
@pytest.mark.parametrize("n", [2, 60, 130])
def test_the_method_finds_the_minimiser_whatever_its_start(n, beta):
    """The objective there is below that of its neighbours, too."""
    rng = np.random.default_rng(4)
    for seed in range(5):
        given = problem(n, beta, seed)
        made, g, w = given.method, given.g, given.w
        rest = made.minimise(g, None, 1e-12)
        far = made.minimise(g, 1e3 * rng.normal(size=n), 1e-12)
        given.assert_solved(rest.converged, rest.v, rest.sigma)
        assert far.converged
        np.testing.assert_allclose(far.v, rest.v, atol=1e-9 * np.abs(rest.v).max())
        softer = made.minimise(g, None, 1e-12, np.full(n, 3e3))
        assert softer.converged
        np.testing.assert_allclose(
            softer.sigma[w > 0.0], law.force(softer.v[w > 0.0], 3e3), rtol=1e-9, atol=1e-12
        )
        least = made.objective(rest.v, g)
        for _ in range(10):
            near = rest.v + (1e-3 + 1e-2 * np.abs(rest.v).max()) * rng.normal(size=n)
            assert made.objective(near, g) > least
