"""Points that rest are left out of Newton's method: the solution does not depend on which."""

import numpy as np
import pytest
from scipy import sparse

from skfem_joint.minimise import condensed_newton as module
from skfem_joint.minimise import contact_newton
from skfem_joint.minimise.condensed_newton import MovingNewton
from skfem_joint.minimise.contact_newton import ContactNewton
from skfem_joint.minimise.problem import ContactPoints, Pressed, PressurePoints

pytestmark = pytest.mark.usefixtures("few_may_move")
M = 60


def _points(directions: int, opens: bool) -> ContactPoints:
    """Coulomb points; where contact opens, each is pressed by three pressure points."""
    slips = directions * M
    n = slips + (M if opens else 0)
    rows = sparse.eye_array(n, format="csr")
    normal = None
    if opens:
        gain = 0.4 * (np.eye(M) + 0.3 * np.eye(M, k=1) + 0.3 * np.eye(M, k=-1))
        stiffness = np.where(np.arange(M) % 4 == 0, 50.0, np.inf)
        normal = PressurePoints(rows[slips:], gain, stiffness)
    laws = np.full(M, directions), np.linspace(1.0, 4.0, M), np.full(M, np.inf)
    return ContactPoints(rows[:slips], *laws, normal=normal)


def _matrix(n: int) -> np.ndarray:
    """Stiffness that couples all unknowns, the nearest ones most."""
    i = np.arange(n)
    return np.exp(-np.abs(i[:, None] - i) / 8.0) + 0.1 * np.eye(n)


@pytest.mark.parametrize("opens", [False, True], ids=["constant", "opening"])
@pytest.mark.parametrize("directions", [1, 2])
def test_the_solution_is_that_of_all_points(directions, opens):
    points = _points(directions, opens)
    n = points.B.shape[1]
    H = _matrix(n)
    rested = 0
    for seed in range(8):
        rng = np.random.default_rng([seed, directions, opens])
        g = np.cumsum(rng.normal(size=n)) * 0.4
        pressed = None
        if opens:
            g[directions * M :] = rng.uniform(0.0, 40.0, M)
            bound = rng.choice([0.0, 0.3], M, p=[0.8, 0.2])
            pressed = Pressed(bound, np.zeros(M))
        arguments = g, None, 1e-12, None, None, pressed
        expected = ContactNewton(H, points).minimise(*arguments)
        found = MovingNewton(H, points).minimise(*arguments)
        assert expected.converged
        assert found.converged
        rested += np.count_nonzero(found.v == 0.0)
        for name in ("v", "p", "w", "sigma"):
            np.testing.assert_allclose(
                getattr(found, name), getattr(expected, name), atol=1e-9, err_msg=name
            )
    assert rested > n  # of 8 n


def test_all_rows_are_read_once_more_than_problems_are_solved(monkeypatch):
    points = _points(2, opens=False)
    H = _matrix(2 * M)
    whole, parts = [], []
    times, minimise = module.times, ContactNewton.minimise

    def counted(A, x):
        whole.extend([A] if A is H else [])
        return times(A, x)

    def noted(problem, *arguments):
        parts.append(len(problem.H))
        return minimise(problem, *arguments)

    for place in (module, contact_newton):
        monkeypatch.setattr(place, "times", counted)
    monkeypatch.setattr(ContactNewton, "minimise", noted)
    g = np.zeros(2 * M)
    g[20:40] = 3.0
    found = MovingNewton(H, points).minimise(g, None, 1e-12)
    assert found.converged
    assert np.count_nonzero(found.v) <= max(parts) <= module.MOST * len(H)
    assert len(whole) == len(parts) + 1


def test_where_most_points_move_all_are_worked_on():
    points = _points(1, opens=False)
    H, g = _matrix(M), np.full(M, 100.0)
    expected = ContactNewton(H, points).minimise(g, None, 1e-12)
    found = MovingNewton(H, points).minimise(g, None, 1e-12)
    assert np.array_equal(found.v, expected.v)
    assert found.counts == expected.counts
