"""Points that are apart are eliminated: what a step's solution is does not depend on which."""

import numpy as np
import pytest
from scipy import sparse

from skfem_joint.minimise import touching as module
from skfem_joint.minimise.problem import ContactPoints, Pressed, PressurePoints
from skfem_joint.minimise.touching import Touching
from skfem_joint.stepping.arrangement import step_problem

Q = 90


def _problem(rng, directions, beta):
    """Random problem whose friction points are pressed by three pressure points each."""
    n = (directions + 1) * Q + 6
    R = rng.normal(size=(n, n))
    rows = sparse.eye_array(n, format="csr")
    slips = directions * Q
    gain = 0.5 * (np.eye(Q) + 0.3 * np.eye(Q, k=1) + 0.3 * np.eye(Q, k=-1))
    gain[:3] = 0.0  # joints of constant force
    stiffness = np.where(rng.random(Q) < 0.3, 50.0, np.inf)
    H = R @ R.T + n * np.eye(n)
    normal = PressurePoints(rows[slips : slips + Q], gain, stiffness)
    laws = np.full(Q, directions), np.ones(Q), np.full(Q, beta)
    problem = step_problem(H, ContactPoints(rows[:slips], *laws, normal=normal), "contact")
    bound = np.where(rng.random(Q) < 0.7, rng.uniform(0.0, 0.5, Q), 0.0)
    given = np.where(np.arange(Q) < 3, 2.0, 0.0)
    return problem, rng.uniform(-100.0, 100.0, n), bound, given


@pytest.mark.parametrize("worked_on", ["those that move", "all"])
@pytest.mark.parametrize("directions", [1, 2])
@pytest.mark.parametrize("beta", [np.inf, 30.0], ids=["coulomb", "arctan"])
def test_the_solution_does_not_depend_on_the_points_that_are_eliminated(
    directions, beta, worked_on, request
):
    if worked_on != "all":
        request.getfixturevalue("few_may_move")
    taken_back = eliminated = 0
    for seed in range(6):
        rng = np.random.default_rng([seed, 11])
        problem, g, bound, given = _problem(rng, directions, beta)
        whole = problem.minimise(g, pressed=Pressed(bound, given))
        assert whole.converged
        assert 0 < np.count_nonzero(whole.p) < Q - module.FEWEST
        for kept in (whole.p > 0.0, rng.random(Q) < 0.3):
            touching = Touching(kept)
            part = problem.minimise(g, pressed=Pressed(bound, given, touching=touching))
            assert part.converged
            taken_back += np.count_nonzero(touching.kept & ~kept)
            if touching.some_apart:  # else nothing was eliminated at last
                assert not np.any(part.p[~touching.kept])
                eliminated += 1
            for name in ("v", "p", "w", "sigma"):
                np.testing.assert_allclose(
                    getattr(part, name), getattr(whole, name), atol=1e-9, err_msg=name
                )
    assert taken_back  # else no wrong set was tried
    assert eliminated


def test_points_long_apart_are_dropped_together_and_come_back():
    touching = Touching(np.ones(Q, dtype=bool))
    p = np.where(np.arange(Q) < 20, 1.0, 0.0)
    for _ in range(module.APART - 1):
        touching.follow(p)
        assert touching.kept.all()
    touching.follow(p)
    assert np.array_equal(touching.kept, p > 0.0)
    approach, bound = np.zeros(Q), np.ones(Q)
    approach[[30, 31]] = 1.1, 0.5  # the second would close in two steps
    assert not touching.closes(0.9 * approach, bound)
    assert touching.closes(approach, bound)
    assert np.array_equal(np.flatnonzero(touching.kept[20:]), [10, 11])
