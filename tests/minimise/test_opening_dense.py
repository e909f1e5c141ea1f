"""Steps of reduced models with contact that opens: the problem of slips in other unknowns."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import linalg, sparse

from skfem_joint.ground.errors import InputError
from skfem_joint.minimise import law
from skfem_joint.minimise.dense_loop import minimise_dense
from skfem_joint.minimise.problem import ContactPoints, Pressed, PressurePoints
from skfem_joint.stepping.arrangement import step_problem

Q = 8


def _random(rng, directions, friction, beta=30.0):
    """Random problem whose slips and approaches are unknowns, with elastic contact."""
    n = (directions + 1) * Q + 4
    R = rng.normal(size=(n, n))
    rows = np.eye(n)
    slips = directions * Q
    points = ContactPoints(
        sparse.csr_array(rows[:slips]), np.full(Q, directions), np.ones(Q), np.full(Q, beta)
    )
    gain = friction * (0.6 * np.eye(Q) + 0.2 * np.eye(Q, k=1) + 0.2 * np.eye(Q, k=-1))
    given = np.where(np.arange(Q) < 2, 1.0, -0.1)
    problem = R @ R.T + 0.1 * n * np.eye(n), points, rows[slips : slips + Q], gain
    return problem, 10.0 ** rng.uniform(0.0, 4.0, Q), rng.uniform(-30.0, 30.0, n), given


def _projected(H, points, T):
    """Problem of the unknowns q of u = T q."""
    normal = replace(points.normal, N=points.normal.N @ T)
    return step_problem(T.T @ H @ T, replace(points, B=points.B @ T, normal=normal), "dense")


@pytest.mark.parametrize("directions", [1, 2])
@pytest.mark.parametrize(
    ("friction", "beta", "springs"),
    [(0.3, 30.0, False), (1.0, 30.0, False), (0.6, 30.0, True), (0.6, np.inf, True)],
)
def test_it_is_the_problem_of_slips_in_other_unknowns(friction, beta, springs, directions):
    opened = pressed = stuck = slipped = 0
    for seed in range(6):
        rng = np.random.default_rng([seed, 5])
        (H, points, N, gain), k, g, given = _random(rng, directions, friction, beta)
        points = replace(points, normal=PressurePoints(N, gain, k))
        how = {"pressed": Pressed(rng.choice([0.0, 0.1, -0.1], Q), given)}
        if springs:
            points = replace(points, flexible=10.0 ** rng.uniform(-3.0, 0.0, Q))
            how["offset"] = rng.normal(size=directions * Q)
        known = step_problem(H, points, "contact").minimise(g, **how)
        T = rng.normal(size=H.shape)  # u = T q
        found = _projected(H, points, T).minimise(T.T @ g, **how)
        assert known.converged
        assert found.converged
        np.testing.assert_allclose(T @ found.v, known.v, atol=1e-8)
        np.testing.assert_allclose(found.p, known.p, atol=1e-6)
        np.testing.assert_allclose(found.w, known.w, atol=1e-6)
        force = found.sigma * points.on_rows(found.w)
        np.testing.assert_allclose(force, known.sigma * points.on_rows(known.w), atol=1e-6)
        opened, pressed = opened + np.sum(found.p == 0.0), pressed + np.sum(found.p > 0.0)
        size = np.linalg.norm(found.sigma.reshape(Q, directions), axis=1)[found.w > 0.0]
        stuck, slipped = stuck + np.sum(size < 0.999), slipped + np.sum(size > 0.8)
    assert min(opened, pressed, stuck, slipped) > 0


def test_the_tangent_has_the_change_of_limits_of_points_on_springs():
    """Newton's iteration converges in a few steps; without it, in tens."""
    rng = np.random.default_rng(5)
    (H, points, N, gain), k, g, given = _random(rng, 2, 1.0, 300.0)
    points = replace(points, normal=PressurePoints(N, gain, k), flexible=np.full(Q, 0.01))
    problem, pressed = _projected(H, points, rng.normal(size=H.shape)), Pressed(np.zeros(Q), given)
    g = rng.normal(size=g.size)
    near = problem.minimise(g, offset=np.zeros(2 * Q), pressed=pressed).v
    found = problem.minimise(1.001 * g, near, offset=np.zeros(2 * Q), pressed=pressed)
    assert found.converged
    assert found.counts["newton_iterations"] <= 4


def test_limits_are_renewed_where_those_that_follow_do_not_lead_on():
    """With friction of 4 there need not be a solution: where none is found, that is said."""
    renewed = unsolved = 0
    for seed in range(20):
        rng = np.random.default_rng([seed, 9])
        (H, points, N, gain), k, g, given = _random(rng, 1, 4.0, 1e4)
        problem = step_problem(H, replace(points, normal=PressurePoints(N, gain, k)), "dense")
        found = problem.minimise(g, pressed=Pressed(np.zeros(Q), given))
        if not found.converged:
            unsolved += 1
            continue
        p = k * np.maximum(N @ found.v, 0.0)
        slip = points.B @ found.v
        force = np.maximum(given + gain @ p, 0.0) * law.force(slip, 1e4)
        left = g - H @ found.v - points.B.T @ force - N.T @ p
        np.testing.assert_allclose(left, 0.0, atol=1e-8 * np.abs(g).max())
        renewed += found.counts.get("renewed_limits", 0)
    assert renewed
    assert unsolved <= 1


def test_the_compiled_loop_starts_from_the_minimum_that_kept_limits_lead_to():
    rescued, tolerance = 0, 1e-11
    for seed in range(20):
        rng = np.random.default_rng([seed, 9])
        (H, points, N, gain), k, g, given = _random(rng, 1, 4.0, 1e4)
        problem = step_problem(H, replace(points, normal=PressurePoints(N, gain, k)), "dense")
        problem.press(points.beta, None, Pressed(np.zeros(Q), given))
        step = problem.kernel, problem.workspace, g, np.zeros(g.size), tolerance
        if minimise_dense(*step).converged or not problem.rescue(*step[2:]):
            continue
        again = minimise_dense(*step)
        assert again.converged
        assert again.newton_iterations <= 1
        rescued += 1
    assert rescued


@pytest.mark.parametrize("beta", [1e2, 1e5])
def test_forces_balance_with_more_points_than_unknowns(beta):
    for seed in range(6):
        rng = np.random.default_rng([seed, 6])
        (H, points, N, gain), k, g, given = _random(rng, 2, 0.6, beta)
        T = linalg.qr(rng.normal(size=(len(H), 7)), mode="economic")[0]
        points = replace(points, normal=PressurePoints(N, gain, k))
        dense = _projected(H, points, T)
        bound = rng.choice([0.0, 0.1, -0.1], Q)
        pressed = Pressed(bound, given)
        found = dense.minimise(T.T @ g, pressed=pressed)
        assert found.converged
        p = k * np.maximum(N @ (T @ found.v) - bound, 0.0)
        w = np.maximum(given + gain @ p, 0.0)
        slip = (dense.points.B @ found.v).reshape(Q, 2)
        speed = np.linalg.norm(slip, axis=1, keepdims=True)
        friction = w[:, None] * law.force(speed, beta) * slip / speed
        left = T.T @ g - dense.H @ found.v - dense.points.B.T @ friction.ravel() - T.T @ (N.T @ p)
        np.testing.assert_allclose(left, 0.0, atol=1e-8 * np.abs(g).max())
        for _ in range(2):
            again = dense.minimise(T.T @ g, rng.normal(size=7), pressed=pressed)
            np.testing.assert_allclose(again.v, found.v, atol=1e-8)


def test_rigid_points_and_set_valued_friction_are_refused():
    rng = np.random.default_rng(1)
    (H, points, N, gain), k, g, given = _random(rng, 1, 0.5, np.inf)
    rigid = PressurePoints(N, gain, np.full(Q, np.inf))
    with pytest.raises(InputError, match="must have a finite stiffness"):
        step_problem(H, replace(points, normal=rigid), "dense")
    problem = step_problem(H, replace(points, normal=PressurePoints(N, gain, k)), "dense")
    with pytest.raises(InputError, match="set-valued Coulomb friction"):
        problem.minimise(g, pressed=Pressed(np.zeros(Q), given))
