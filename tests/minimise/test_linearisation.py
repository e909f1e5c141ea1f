"""Linearisations of step problems: central differences of their solutions."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy import sparse

from skfem_joint.ground.errors import InputError
from skfem_joint.minimise.linearisation import Changes
from skfem_joint.minimise.problem import ContactPoints, Pressed, PressurePoints
from skfem_joint.stepping.arrangement import step_problem
from skfem_joint.system.unknowns import selection

N, STEP = 12, 1e-6


def matrix(kind: str, rng: np.random.Generator) -> Any:
    if kind == "chain":
        off = -rng.uniform(0.5, 1.0, N - 1)
        return sparse.diags_array([off, np.full(N, 3.0), off], offsets=[-1, 0, 1], format="csr")
    A = rng.normal(size=(N, N))
    H = A @ A.T / N + np.eye(N)
    return H if kind == "dense" else sparse.csr_array(H)


def points_of(kind: str, rng: np.random.Generator, beta: float, sprung: bool) -> ContactPoints:
    """Of one and two directions, or on a chain of one; slips are unknowns, or depend on them."""
    directions = np.ones(4, dtype=np.int64) if kind == "chain" else np.array([1, 2, 2, 1])
    rows = int(directions.sum())
    B = selection(np.arange(rows), N) if kind != "dense" else rng.normal(size=(rows, N))
    flexible = np.array([0.0, 0.3, 0.0, 0.6]) if sprung else None
    return ContactPoints(B, directions, rng.uniform(0.5, 1.0, 4), np.full(4, beta), flexible)


@pytest.mark.parametrize("sprung", [False, True], ids=["", "springs"])
@pytest.mark.parametrize(
    ("kind", "beta"),
    [("chain", np.inf), ("chain", 3.0), ("contact", np.inf), ("contact", 3.0), ("dense", 3.0)],
)
def test_solutions_change_as_their_linearisation_says(kind, beta, sprung):
    rng = np.random.default_rng(1)
    problem = step_problem(matrix(kind, rng), points_of(kind, rng, beta, sprung), kind)
    points, rows = problem.points, problem.points.B.shape[0]
    g, dg = 2.0 * rng.normal(size=(2, N))
    on_springs = points.on_rows(points.has_spring)
    o, do = np.where(on_springs, 0.3 * rng.normal(size=(2, rows)), 0.0)
    w = points.on_rows(points.w)

    def solution(step: float) -> tuple[np.ndarray, np.ndarray]:
        offset = o + step * do if sprung else None
        found = problem.minimise(g + step * dg, tolerance=1e-13, offset=offset)
        assert found.converged
        return found.v, w * found.sigma

    v, _ = solution(0.0)
    slip = np.asarray(points.B @ v) - o
    linear = problem.linearisation()
    (at,) = linear.at(slip[np.newaxis])
    if np.isinf(beta) and not sprung:
        assert 0 < at.sticks.size < rows
    right, beside = linear.restrict(dg[:, np.newaxis])
    z, _ = linear.solve(at, Changes(right, do[:, np.newaxis]))
    dv = linear.extend(z, beside)[:, 0]
    (above, more), (below, less) = solution(STEP), solution(-STEP)
    np.testing.assert_allclose(dv, (above - below) / (2.0 * STEP), atol=1e-7)
    known = (more - less) / (2.0 * STEP)
    d_friction = linear.friction(at, linear.B @ z - do[:, np.newaxis])[:, 0]
    moves = np.setdiff1d(np.arange(rows), at.sticks)
    np.testing.assert_allclose(d_friction[moves], known[moves], atol=1e-7)


@pytest.mark.parametrize("kind", ["contact", "dense"])
def test_normal_forces_change_as_the_linearisation_says(kind):
    """Limits follow them, of elastic points and, where approaches are unknowns, of rigid ones."""
    rng = np.random.default_rng(3)
    points, rows, q = points_of(kind, rng, 3.0, True), 6, 3
    N_of = selection(np.arange(rows, rows + q), N)
    stiffness, bound = np.array([np.inf, 5.0, 2.0]), np.array([-0.1, -0.2, 5.0])
    if kind == "dense":
        N_of, stiffness = rng.normal(size=(q, N)), np.array([4.0, 5.0, 2.0])
        bound = np.array([-3.0, -3.0, 9.0])
    gain = sparse.csr_array(rng.uniform(0.2, 0.6, (4, q)))
    points = replace(points, normal=PressurePoints(N_of, gain, stiffness))
    problem = step_problem(matrix(kind, rng), points, kind)
    o = np.where(points.on_rows(points.has_spring), 0.2 * rng.normal(size=rows), 0.0)
    g, given = 2.0 * rng.normal(size=N), np.full(4, 0.3)
    g[rows : rows + q] += 2.0
    dg, d_bound, d_given = rng.normal(size=N), rng.normal(size=q), rng.normal(size=4)

    def solution(step: float) -> tuple[np.ndarray, ...]:
        pressed = Pressed(bound + step * d_bound, given + step * d_given)
        found = problem.minimise(g + step * dg, None, 1e-13, offset=o, pressed=pressed)
        assert found.converged
        return found.v, found.p, found.w

    v, p, w = solution(0.0)
    assert 0 < np.count_nonzero(p) < q
    linear = problem.linearisation()
    slip = np.asarray(points.B @ v) - o
    (at,) = linear.at(slip[np.newaxis], w[np.newaxis], p[np.newaxis])
    right, beside = linear.restrict(dg[:, np.newaxis])
    change = Changes(right, np.zeros((rows, 1)), d_given[:, np.newaxis], d_bound[:, np.newaxis])
    z, normal = linear.solve(at, change)
    dv = linear.extend(z, beside)[:, 0]
    ends = solution(STEP), solution(-STEP)
    of_v, of_p, of_w = ((a - b) / (2.0 * STEP) for a, b in zip(*ends, strict=True))
    np.testing.assert_allclose(dv, of_v, atol=1e-7)
    np.testing.assert_allclose(normal[:, 0], of_p, atol=1e-7)
    np.testing.assert_allclose(d_given + gain @ normal[:, 0], of_w, atol=1e-7)


def test_coulomb_friction_on_slips_that_depend_on_each_other_is_refused():
    rng = np.random.default_rng(0)
    problem = step_problem(matrix("dense", rng), points_of("dense", rng, np.inf, False), "dense")
    with pytest.raises(InputError, match="give the points springs"):
        problem.linearisation()
