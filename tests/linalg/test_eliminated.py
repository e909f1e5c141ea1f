"""Unknowns are eliminated and taken back in turn: complements and solutions are those of A."""

import numpy as np
import pytest

from skfem_joint.linalg.eliminated import Eliminated

N = 300


def _matrix() -> np.ndarray:
    R = np.random.default_rng(1).normal(size=(N, N))
    return R @ R.T + N * np.eye(N)


def _changed(of: Eliminated, seed: int, times: int) -> tuple[np.ndarray, np.ndarray]:
    """Eliminated unknowns, and some others, after changes by few and now and then by many."""
    rng = np.random.default_rng(seed)
    out = rng.random(N) < 0.4
    for change in range(times):
        if change % 8 == 7:
            out = rng.random(N) < 0.4
        flipped = rng.choice(N, 3, replace=False)
        out[flipped] = ~out[flipped]
        kept = np.flatnonzero(~out & (rng.random(N) < 0.5))
        of.let(out.copy(), kept)
    return np.flatnonzero(out), kept


@pytest.mark.parametrize("times", [1, 2, 5, 8, 40])
def test_after_any_changes_all_is_as_by_a_factor(times):
    A = _matrix()
    of = Eliminated(A)
    e, k = _changed(of, times, times)
    rng = np.random.default_rng(0)
    r, x = rng.normal(size=N), rng.normal(size=k.size)
    held = np.linalg.solve(A[np.ix_(e, e)], r[e])
    coupling = np.linalg.solve(A[np.ix_(e, e)], A[np.ix_(e, k)])
    S = A[np.ix_(k, k)] - A[np.ix_(k, e)] @ coupling
    np.testing.assert_allclose(of.complement(k), S, atol=1e-12 * N)
    right, moved = of.restrict(r, k)
    np.testing.assert_allclose(right, r[k] - A[np.ix_(k, e)] @ held, atol=1e-12)
    np.testing.assert_allclose(moved, held, atol=1e-12)
    np.testing.assert_allclose(of.follow(x, k), -coupling @ x, atol=1e-12)


def test_few_changes_factorise_nothing_but_their_own_block(monkeypatch):
    from scipy import linalg

    of, sizes, factor = Eliminated(_matrix()), [], linalg.cholesky
    monkeypatch.setattr(
        linalg, "cholesky", lambda A, **how: (sizes.append(len(A)), factor(A, **how))[1]
    )
    out = np.arange(N) < 30
    of.let(out.copy(), np.arange(40, 50))
    out[[3, 32]] = False, True
    of.let(out.copy(), np.arange(40, 55))
    assert sizes == [30, 1, 1]


def test_what_is_saved_makes_it_again_to_the_bit():
    A = _matrix()
    of, again = Eliminated(A), Eliminated(A)
    _, kept = _changed(of, 3, 6)
    saved = of.saved()
    again.check(saved)
    again.restore(saved)
    assert np.array_equal(again.complement(kept), of.complement(kept))
    r = np.random.default_rng(0).normal(size=N)
    assert np.array_equal(again.restrict(r, kept)[1], of.restrict(r, kept)[1])
    twice = saved | {"changes": saved["changes"][[0, 0]], "changed": saved["changed"][:0]}
    twice["changed"] = np.tile(saved["changed"][: saved["changes"][0, 1]], 2)
    for wrong in (twice, saved | {"changed": saved["changed"][:-1]}, {}):
        with pytest.raises(ValueError, match="eliminated"):
            again.check(wrong)
