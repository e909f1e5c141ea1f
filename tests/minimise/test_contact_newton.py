"""The truncated Newton method: its minimiser balances all forces, from any start."""

from typing import Any

import numpy as np
import pytest
from scipy import sparse

from skfem_joint.minimise import law
from skfem_joint.minimise.contact_newton import ContactNewton
from skfem_joint.minimise.problem import ContactPoints
from skfem_joint.system.unknowns import selection

LAWS = [1e3, 1e5, 1e9, np.inf]


def problem_of(A: Any, first: Any, second: Any, w: Any, beta: Any) -> ContactNewton:
    """Step problem of points with these unknowns; the second is -1 where there is but one."""
    unknowns = np.column_stack([first, second]).ravel()
    unknowns = unknowns[unknowns >= 0]
    B = selection(unknowns, A.shape[0])
    return ContactNewton(A, ContactPoints(B, 1 + (np.array(second) >= 0), w, beta))


def by_unknown(made: ContactNewton, sigma: Any) -> Any:
    """Friction of each unknown from that of each slip row."""
    return made.points.B.T @ sigma


def problem(
    beta: float, dense: bool, seed: int = 0, condition: float = 1e4
) -> tuple[ContactNewton, np.ndarray, Any]:
    """Random problem of points with one, two and no directions of slip, some without friction."""
    random = np.random.default_rng(seed)
    n = 40
    Q = np.linalg.qr(random.normal(size=(n, n)))[0]
    A = (Q * np.geomspace(1.0, condition, n)) @ Q.T
    A = 0.5 * (A + A.T)
    order = random.permutation(n)
    first, second = np.sort(order[:20]), np.full(20, -1)
    second[:12] = order[20:32]
    w = random.uniform(0.0, 30.0, 20)
    w[::7] = 0.0
    made = problem_of(A if dense else sparse.csr_array(A), first, second, w, np.full(20, beta))
    g = random.normal(size=n) * 30.0
    return made, g, (A, first, second, w)


@pytest.mark.parametrize("beta", LAWS)
@pytest.mark.parametrize("dense", [True, False])
@pytest.mark.parametrize("seed", range(5))
def test_the_solution_balances_all_forces_on_the_graph_of_the_law(beta, dense, seed):
    made, g, (A, first, second, w) = problem(beta, dense, seed)
    found = made.minimise(g, np.zeros_like(g), 1e-11)
    assert found.converged
    force, friction = np.zeros_like(g), by_unknown(made, found.sigma)
    for p, (i, j) in enumerate(zip(first, second, strict=True)):
        rows = [i] if j < 0 else [i, j]
        speed, size = np.linalg.norm(found.v[rows]), np.linalg.norm(friction[rows])
        if w[p] == 0.0:
            assert size == 0.0
            continue
        force[rows] = w[p] * friction[rows]
        if np.isinf(beta):
            assert size <= 1.0 + 1e-12
            assert speed == 0.0 or size == pytest.approx(1.0, rel=1e-12)
        else:
            assert size == pytest.approx(float(law.force(speed, beta)), rel=1e-9)
        if speed > 0.0:
            np.testing.assert_allclose(
                friction[rows] * speed, found.v[rows] * size, atol=1e-12 * speed
            )
    assert np.abs(A @ found.v + force - g).max() <= 1.1e-11 * np.abs(g).max()


@pytest.mark.parametrize("beta", LAWS)
def test_the_solution_depends_on_neither_start_nor_what_was_solved_before(beta):
    made, g, _ = problem(beta, dense=False)
    zero = np.zeros_like(g)
    fresh = made.minimise(g, zero, 1e-12).v
    far = 1e3 * np.random.default_rng(1).normal(size=g.size)
    np.testing.assert_allclose(
        made.minimise(g, far, 1e-12).v, fresh, atol=1e-8 * np.abs(fresh).max()
    )
    for other in np.random.default_rng(2).normal(size=(5, g.size)):
        made.minimise(300.0 * other, zero, 1e-12)
    again = made.minimise(g, zero, 1e-12).v
    np.testing.assert_allclose(again, fresh, atol=1e-9 * np.abs(fresh).max())


@pytest.mark.parametrize("beta", LAWS)
@pytest.mark.parametrize("dense", [True, False])
@pytest.mark.parametrize("size", [0.0, 1e-200])
def test_without_force_all_comes_to_rest_wherever_it_starts(beta, dense, size):
    made, g, _ = problem(beta, dense)
    far = 1e3 * np.random.default_rng(1).normal(size=g.size)
    found = made.minimise(size * g, far, 1e-11)
    assert found.converged
    assert np.abs(found.v).max() <= size * np.abs(g).max()


@pytest.mark.parametrize("beta", [1e5, np.inf])
@pytest.mark.parametrize("dense", [True, False])
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_what_is_not_finite_is_never_accepted(beta, dense, bad):
    """The bodies do not touch: in the others all is as it should be."""
    A: Any = np.diag([1.0, 2.0, 3.0, 4.0])
    points = np.array([0, 2]), np.array([1, -1]), np.full(2, 5.0), np.full(2, beta)
    made = problem_of(A if dense else sparse.csr_array(A), *points)
    for unknown in range(4):
        wrong = np.ones(4)
        wrong[unknown] = bad
        assert not made.minimise(wrong, np.zeros(4), 1e-11).converged
        assert not made.minimise(np.ones(4), np.where(wrong == 1.0, 0.0, np.nan), 1e-11).converged


@pytest.mark.parametrize("dense", [True, False])
def test_sweeps_that_leave_all_points_at_rest_are_not_the_end(dense):
    """Found by search: all points are held, one of them with more than its friction."""
    A = np.array([[1.0, 0.40783138], [0.40783138, 1.0]])
    w, g = np.array([1.95682578, 0.82512249]), np.array([-3.72516003, -1.19008965])
    points = np.array([0, 1]), np.array([-1, -1]), w, np.full(2, np.inf)
    made = problem_of(A if dense else sparse.csr_array(A), *points)
    found = made.minimise(g, np.array([15.26763545, -46.54703781]), 1e-11)
    assert found.converged
    assert np.any(found.v != 0.0)
    np.testing.assert_allclose(A @ found.v + w * found.sigma, g, atol=1e-10)


def test_points_that_turn_do_not_block_the_others():
    """Light points on heavy unknowns: of the first 3,000 draws 8 once took more than 99 steps."""
    random = np.random.default_rng(0)
    for _ in range(700):
        m = int(random.integers(1, 4))
        A = np.diag(np.repeat([10.0 ** random.uniform(-7, -3), 1.0], [2 * m, 2]))
        P = random.normal(size=(2, 2 * m)) * 10.0 ** random.uniform(-2, 0)
        A[: 2 * m, : 2 * m] += P.T @ P
        A[2 * m :, : 2 * m], A[: 2 * m, 2 * m :] = P, P.T
        w, g = 10.0 ** random.uniform(-1, 1, m), 10.0 * random.normal(size=2 * m + 2)
        first = np.arange(0, 2 * m, 2)
        made = problem_of(A, first, first + 1, w, np.full(m, np.inf))
        found = made.minimise(g, np.zeros(g.size), 1e-11)
        assert found.converged
        assert found.counts["newton_iterations"] < 40


@pytest.mark.parametrize("directions", [1, 2])
def test_velocities_below_the_smallest_normal_number_keep_the_law(directions):
    """Motion dies out by 1000 a point: far from the load its inverse overflows."""
    n = 240
    diagonals = [np.full(n - 1, -1.0), np.full(n, 1e3), np.full(n - 1, -1.0)]
    A = sparse.csr_array(sparse.diags_array(diagonals, offsets=[-1, 0, 1]))
    first = np.arange(0, n, directions)
    second = first + 1 if directions == 2 else np.full(n, -1)
    made = problem_of(A, first, second, np.full(first.size, 1e-3), np.full(first.size, 1e5))
    g = np.zeros(n)
    g[-1] = 10.0
    for start in (np.zeros(n), -1e-2 * 1e3 ** -np.arange(n - 1.0, -1.0, -1.0)):
        found = made.minimise(g, start, 1e-11)
        assert found.converged
    assert np.any((found.v != 0.0) & (np.abs(found.v) < np.finfo(float).tiny))
