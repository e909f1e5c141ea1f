"""Linearisations of step problems: central differences of their solutions."""

from collections.abc import Callable
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


def pressure_points(kind: str, rng: np.random.Generator) -> tuple[PressurePoints, Any]:
    """Elastic points and, where approaches are unknowns, a rigid one; and their bounds."""
    gain = sparse.csr_array(rng.uniform(0.2, 0.6, (4, 3)))
    if kind == "dense":
        rows, stiffness = rng.normal(size=(3, N)), np.array([4.0, 5.0, 2.0])
        return PressurePoints(rows, gain, stiffness), np.array([-3.0, -3.0, 9.0])
    rows, stiffness = selection(np.arange(6, 9), N), np.array([np.inf, 5.0, 2.0])
    return PressurePoints(rows, gain, stiffness), np.array([-0.1, -0.2, 5.0])


@pytest.mark.parametrize(
    ("kind", "beta", "sprung", "presses"),
    [
        *((kind, 3.0, sprung, False) for kind in ("chain", "contact", "dense")
          for sprung in (False, True)),
        *((kind, np.inf, sprung, False) for kind in ("chain", "contact")
          for sprung in (False, True)),
        ("contact", 3.0, True, True),
        ("dense", 3.0, True, True),
    ],
)  # fmt: skip
def test_solutions_change_as_their_linearisation_says(kind, beta, sprung, presses):
    """Where points press, limits follow their forces."""
    rng = np.random.default_rng(3 if presses else 1)
    H, points, bound = matrix(kind, rng), points_of(kind, rng, beta, sprung), np.zeros(0)
    if presses:
        normal, bound = pressure_points(kind, rng)
        points = replace(points, normal=normal)
    problem = step_problem(H, points, kind)
    rows, q = problem.points.B.shape[0], bound.size
    g, dg = 2.0 * rng.normal(size=(2, N))
    g[rows : rows + q] += 2.0
    o, do = np.where(problem.points.on_rows(problem.points.has_spring),
                     0.3 * rng.normal(size=(2, rows)), 0.0)  # fmt: skip
    given, d_given, d_bound = np.full(4, 0.3), rng.normal(size=4), rng.normal(size=q)

    def solution(step: float) -> Any:
        how: dict[str, Any] = {"offset": o + step * do} if sprung else {}
        if presses:
            how["pressed"] = Pressed(bound + step * d_bound, given + step * d_given)
        found = problem.minimise(g + step * dg, None, 1e-13, **how)
        assert found.converged
        return found

    at_rest, above, below = (solution(step) for step in (0.0, STEP, -STEP))

    def change(of: Callable[[Any], Any]) -> np.ndarray:
        return np.asarray(of(above) - of(below)) / (2.0 * STEP)

    linear = problem.linearisation()
    slip = np.asarray(problem.points.B @ at_rest.v) - o
    limits = (at_rest.w[np.newaxis], at_rest.p[np.newaxis]) if presses else ()
    (at,) = linear.at(slip[np.newaxis], *limits)
    right, beside = linear.restrict(dg[:, np.newaxis])
    more = (d_given[:, np.newaxis], d_bound[:, np.newaxis]) if presses else ()
    z, normal = linear.solve(at, Changes(right, do[:, np.newaxis], *more))
    np.testing.assert_allclose(linear.extend(z, beside)[:, 0], change(lambda x: x.v), atol=1e-7)
    if presses:
        assert 0 < np.count_nonzero(at_rest.p) < q
        np.testing.assert_allclose(normal[:, 0], change(lambda x: x.p), atol=1e-7)
        d_limits = d_given + points.normal.gain @ normal[:, 0]
        np.testing.assert_allclose(d_limits, change(lambda x: x.w), atol=1e-7)
        return
    if np.isinf(beta) and not sprung:
        assert 0 < at.sticks.size < rows
    known = change(lambda x: problem.points.on_rows(problem.points.w) * x.sigma)
    d_friction = linear.friction(at, linear.B @ z - do[:, np.newaxis])[:, 0]
    moves = np.setdiff1d(np.arange(rows), at.sticks)
    np.testing.assert_allclose(d_friction[moves], known[moves], atol=1e-7)


def test_coulomb_friction_on_slips_that_depend_on_each_other_is_refused():
    rng = np.random.default_rng(0)
    problem = step_problem(matrix("dense", rng), points_of("dense", rng, np.inf, False), "dense")
    with pytest.raises(InputError, match="give the points springs"):
        problem.linearisation()
