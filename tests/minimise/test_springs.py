"""The law of a point with a spring in series, and the methods that take it."""

from typing import Any

import numpy as np
import pytest
from scipy import sparse
from scipy.optimize import brentq, minimize

from skfem_joint.minimise import law
from skfem_joint.minimise.problem import ContactPoints
from skfem_joint.stepping.arrangement import step_problem
from skfem_joint.system.unknowns import selection

BETAS = [1.0, 1e2, 1e6, np.inf]
SPEEDS = np.concatenate([-np.geomspace(1e3, 1e-6, 30), [0.0], np.geomspace(1e-6, 1e3, 30)])


@pytest.mark.parametrize("beta", BETAS)
@pytest.mark.parametrize("soft", [1e-4, 1.0, 50.0])
def test_spring_and_slider_share_the_slip_and_have_the_same_force(beta, soft):
    sigma = law.force(SPEEDS, beta, soft)
    slider = SPEEDS - soft * sigma
    assert np.all(np.diff(sigma) >= 0.0)
    assert np.abs(sigma).max() <= 1.0
    if np.isinf(beta):
        np.testing.assert_allclose(sigma, np.clip(SPEEDS / soft, -1.0, 1.0), rtol=1e-14)
        return
    exact = [
        brentq(lambda z, v=v: z + soft * float(law.force(z, beta)) - v, -1e4, 1e4, xtol=1e-15)
        for v in SPEEDS
    ]
    np.testing.assert_allclose(slider, exact, atol=1e-11 * (1.0 + np.abs(SPEEDS)).max())
    np.testing.assert_allclose(sigma, law.force(slider, beta), atol=3e-10 * max(beta * soft, 1.0))


@pytest.mark.parametrize("beta", BETAS)
def test_the_potential_is_the_moreau_envelope(beta):
    soft = 0.2
    for v in (-3.0, -0.1, 0.02, 0.5):
        z = v - soft * np.linspace(-1.0, 1.0, 400_001)  # of all forces of the spring
        values = law.potential(z, beta) + (v - z) ** 2 / (2.0 * soft)
        envelope = float(law.potential(v, beta, soft))
        assert np.all(values >= envelope - 1e-15)
        assert values.min() == pytest.approx(envelope, abs=1e-6 * soft)


@pytest.mark.parametrize("beta", BETAS)
def test_the_resolvent_solves_its_equation(beta):
    for soft in (0.0, 1e-3, 2.0):
        for k in (1e-2, 1.0, 30.0):
            for x in (-7.0, -0.3, 0.6, 20.0):
                v, force = law.sprung_resolvent(x, k, beta, soft)
                assert k * v + force == pytest.approx(x, rel=1e-12)


def chain_of(seed: int, beta: float) -> tuple[Any, ContactPoints, Any, Any]:
    """Chain of points with springs, with none, and without friction, its load and its offset."""
    random = np.random.default_rng(seed)
    n = 60
    off = -random.uniform(0.5, 1.0, n - 1)
    H = sparse.csr_array(sparse.diags_array([off, np.full(n, 2.2), off], offsets=[-1, 0, 1]))
    w, soft = random.uniform(0.1, 2.0, n), random.uniform(0.01, 3.0, n)
    w[::7] = 0.0
    soft[::5] = 0.0
    soft[w == 0.0] = 0.0
    flexible = np.divide(soft, w, out=np.zeros(n), where=w > 0.0)
    B = selection(np.arange(n), n)
    points = ContactPoints(B, np.ones(n, int), w, np.full(n, beta), flexible)
    return H, points, 3.0 * random.normal(size=n), np.where(soft > 0.0, random.normal(size=n), 0.0)


@pytest.mark.parametrize("beta", [1.0, 1e3, np.inf])
@pytest.mark.parametrize("seed", range(3))
def test_all_methods_find_the_minimiser_that_a_general_one_finds(seed, beta):
    H, points, g, offset = chain_of(seed, beta)
    found = []
    for kind, matrix in (("chain", H), ("contact", H), ("contact", H.toarray())):
        problem = step_problem(matrix, points, kind, condense=False)
        for start in (None, np.random.default_rng(seed).normal(size=g.size)):
            minimum = problem.minimise(g, start, 1e-12, offset=offset)
            assert minimum.converged
            found.append(minimum.v)
    if np.isfinite(beta):
        dense = step_problem(H.toarray(), points, "dense").minimise(g, None, 1e-12, offset=offset)
        assert dense.converged
        found.append(dense.v)
    for v in found[1:]:
        np.testing.assert_allclose(v, found[0], atol=1e-9)
    problem = step_problem(H, points, "contact", condense=False)
    best = problem.objective(found[0], g, offset=offset)
    for nearby in np.random.default_rng(1).normal(size=(50, g.size)):
        assert problem.objective(found[0] + 1e-3 * nearby, g, offset=offset) > best


@pytest.mark.parametrize("beta", [5.0, np.inf])
def test_points_with_two_directions_and_groups_agree_with_a_general_method(beta):
    random = np.random.default_rng(3)
    n, m = 8, 6
    Q = random.normal(size=(n, n))
    H = Q @ Q.T + np.eye(n)
    first = np.array([0, 0, 0, 2, 4, 4])  # points that share their unknowns, and one alone
    unknowns = np.column_stack([first, first + 1]).ravel()
    w, soft = random.uniform(0.5, 2.0, m), random.uniform(0.1, 1.0, m)
    B = selection(unknowns, n)
    points = ContactPoints(B, np.full(m, 2), w, np.full(m, beta), soft / w)
    g, offset = 4.0 * random.normal(size=n), random.normal(size=2 * m)
    B = points.B.toarray()

    def value(v: Any) -> float:
        slip = np.linalg.norm((B @ v - offset).reshape(m, 2), axis=1)
        return float(v @ (0.5 * (H @ v) - g) + w @ law.potential(slip, points.beta, soft))

    general = minimize(value, np.zeros(n), method="BFGS", options={"gtol": 1e-9}).x
    for kind, matrix in (("contact", H), ("contact", sparse.csr_array(H)), ("dense", H)):
        problem = step_problem(matrix, points, kind, condense=False)
        minimum = problem.minimise(g, None, 1e-12, offset=offset)
        assert minimum.converged
        np.testing.assert_allclose(minimum.v, general, atol=1e-5)
        assert problem.objective(minimum.v, g, offset=offset) <= value(general) + 1e-12
        force = B.T @ (np.repeat(w, 2) * minimum.sigma)
        np.testing.assert_allclose(H @ minimum.v + force, g, atol=1e-10)
