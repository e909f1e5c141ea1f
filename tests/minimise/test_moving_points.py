"""Points that rest are left out of Newton's method; runs show that nothing changes by that."""

import numpy as np
import pytest
from scipy import sparse

from skfem_joint.minimise import condensed_newton as module
from skfem_joint.minimise import contact_newton
from skfem_joint.minimise.condensed_newton import MovingNewton
from skfem_joint.minimise.contact_newton import ContactNewton
from skfem_joint.minimise.problem import ContactPoints

pytestmark = pytest.mark.usefixtures("few_may_move")
M = 60


def _points(directions: int) -> ContactPoints:
    """Coulomb points."""
    rows = sparse.eye_array(directions * M, format="csr")
    laws = np.full(M, directions), np.linspace(1.0, 4.0, M), np.full(M, np.inf)
    return ContactPoints(rows, *laws)


def _matrix(n: int) -> np.ndarray:
    """Stiffness that couples all unknowns, the nearest ones most."""
    i = np.arange(n)
    return np.exp(-np.abs(i[:, None] - i) / 8.0) + 0.1 * np.eye(n)


def test_all_rows_are_read_once_more_than_problems_are_solved(monkeypatch):
    points = _points(2)
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
    points = _points(1)
    H, g = _matrix(M), np.full(M, 100.0)
    expected = ContactNewton(H, points).minimise(g, None, 1e-12)
    found = MovingNewton(H, points).minimise(g, None, 1e-12)
    assert np.array_equal(found.v, expected.v)
    assert found.counts == expected.counts
