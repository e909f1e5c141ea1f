"""Proper orthogonal decomposition: the best basis for its snapshots, and Table 1 of the paper."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from reduced_joints import SPEED, full
from scipy import linalg, sparse

import skfem_joint as sj
from skfem_joint.reduction import pod
from skfem_joint.reduction.pod import (
    inner_matrix,
    orthonormal,
    proper_decomposition,
    snapshot_matrix,
)

RNG = np.random.default_rng(0)


def snapshots(times: int, n: int) -> np.ndarray:
    return RNG.normal(size=(times, n)) * np.geomspace(1.0, 1e-4, n)


def spd(n: int, rng: np.random.Generator = RNG) -> np.ndarray:
    A = rng.normal(size=(n, n))
    return A @ A.T + n * np.eye(n)


@pytest.mark.parametrize("times", [5, 40])
@pytest.mark.parametrize("product", ["euclidean", "dense", "sparse"])
def test_projection_error_is_the_sum_of_the_discarded_squares(product, times):
    A, M = snapshots(times, 12), spd(12)
    given = {"euclidean": None, "dense": M, "sparse": sparse.csr_array(M)}[product]
    G = np.eye(12) if given is None else M
    modes = proper_decomposition(A, given)
    count = min(times, 12)
    np.testing.assert_allclose(modes.modes.T @ G @ modes.modes, np.eye(count), atol=1e-12)
    for r in (1, 3, 5):
        V = modes.modes[:, :r]
        left = A - A @ G @ V @ V.T
        expected = np.sum(modes.singular_values[r:] ** 2)
        total = 1e-13 * np.einsum("ti,ij,tj->", A, G, A)
        assert np.einsum("ti,ij,tj->", left, G, left) == pytest.approx(expected, 1e-8, total)


def test_scale_of_the_snapshots_is_that_of_the_singular_values_alone():
    A = snapshots(30, 6)
    plain, small = proper_decomposition(A), proper_decomposition(1e-160 * A)
    np.testing.assert_allclose(small.singular_values, 1e-160 * plain.singular_values, rtol=1e-10)
    np.testing.assert_allclose(np.abs(small.modes), np.abs(plain.modes), atol=1e-10)


@pytest.mark.parametrize(
    "bad", [np.zeros((4, 3)), np.ones(3), np.full((2, 2), np.nan), np.full((2, 2), np.inf)]
)
def test_snapshots_that_hold_nothing_are_refused(bad):
    with pytest.raises(sj.InputError, match="snapshots"):
        proper_decomposition(bad)


def test_a_product_that_is_not_positive_is_refused():
    with pytest.raises(sj.InputError, match="positive definite"):
        proper_decomposition(snapshots(9, 4), np.diag([1.0, 1.0, -1.0, 1.0]))


def test_decomposition_falls_back_on_the_slower_driver(monkeypatch):
    A, tried = snapshots(20, 5), []

    def svd(A, lapack_driver, **options):
        tried.append(lapack_driver)
        if lapack_driver in failing:
            raise linalg.LinAlgError
        return linalg.svd(A, lapack_driver=lapack_driver, **options)

    expected = proper_decomposition(A)
    monkeypatch.setattr(pod, "svd", svd)
    failing = ["gesdd"]
    found = proper_decomposition(A)
    assert tried == ["gesdd", "gesvd"]
    np.testing.assert_allclose(found.singular_values, expected.singular_values, rtol=1e-12)
    failing = ["gesdd", "gesvd"]
    with pytest.raises(sj.ConvergenceError, match="did not converge"):
        proper_decomposition(A)


def sliding() -> tuple[sj.System, np.ndarray, np.ndarray]:
    """Bar that nothing holds, carried 300 km while it is strained by micrometres, at 0.01 Hz."""
    n, h, EA = 400, 1.0 / 400, 200e9 * 5e-4
    K = sparse.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(n, n)).tolil()
    K[0, 0] = K[-1, -1] = 1.0
    M = EA / SPEED**2 * h * sparse.eye_array(n)
    system = sj.System(M, None, EA / h * sparse.csr_array(K))
    t, x = np.linspace(0.0, 300.0, 200)[:, None], np.linspace(0.0, 1.0, n)
    rate = 2.0 * np.pi * 0.01
    u = 3e5 * np.sin(rate * t) + 1e-6 * np.sin(3.0 * rate * t) * np.cos(np.pi * x)
    v = 3e5 * rate * np.cos(rate * t) + 3e-6 * rate * np.cos(3.0 * rate * t) * np.cos(np.pi * x)
    return system, u, v


@pytest.mark.parametrize("product", ["energy", "mass", "euclidean"])
def test_slow_gross_slip_has_modes(product):
    """Round-off of the strain energy of rigid motion outweighs its kinetic energy there."""
    system, u, v = sliding()
    G = inner_matrix(system, product, u, v)
    modes = proper_decomposition(snapshot_matrix(u, v, "both", G), G).modes
    rigid = modes[:, 0] / modes[0, 0]
    np.testing.assert_allclose(rigid, 1.0, atol=1e-6)


def test_snapshots_of_rates_have_no_units_and_weigh_instants_by_roots():
    v = np.random.default_rng(1).normal(size=(30, 4)) * np.geomspace(1.0, 1e-3, 30)[:, np.newaxis]
    rates = snapshot_matrix(v, v, "rates")
    assert rates.shape == (59, 4)
    np.testing.assert_allclose(snapshot_matrix(v, 7.0 * v, "rates"), rates, rtol=1e-12)
    size = np.linalg.norm(v, axis=1)
    expected = np.sqrt(size / size.max())
    np.testing.assert_allclose(np.linalg.norm(rates[:30], axis=1), expected, rtol=1e-12)


def span_distance(V: np.ndarray, W: np.ndarray) -> float:
    """Sine of the largest angle by which ``W`` leaves the span of ``V``."""
    Q, R = np.linalg.qr(V)[0], np.linalg.qr(W)[0]
    return float(np.linalg.norm(R - Q @ (Q.T @ R), 2))


def test_orthonormal_basis_keeps_span_order_and_sign():
    V, M = RNG.normal(size=(9, 4)) * [1.0, 1e-9, 1e6, 3.0], spd(9)
    Q = orthonormal(V, M)
    np.testing.assert_allclose(Q.T @ M @ Q, np.eye(4), atol=1e-12)
    assert span_distance(V / np.linalg.norm(V, axis=0), Q) < 1e-10
    # Gram-Schmidt: every column depends on those before it, and points the way of its own.
    coefficients = Q.T @ M @ V
    below = np.tril(coefficients / np.abs(coefficients).max(axis=0), -1)
    np.testing.assert_allclose(below, 0.0, atol=1e-12)
    assert np.all(np.diag(coefficients) > 0.0)


DEPENDENT: dict[str, Callable[[np.ndarray], np.ndarray]] = {
    "duplicate": lambda V: V[:, 0],
    "combination": lambda V: V @ [0.3, -1.2, 0.7],
    "nearly": lambda V: V[:, 0] + 1e-12 * RNG.normal(size=V.shape[0]),
    "zero": lambda V: np.zeros(V.shape[0]),
}


@pytest.mark.parametrize("kind", DEPENDENT)
@pytest.mark.parametrize("seed", range(5))
def test_directions_that_depend_on_others_are_dropped(kind, seed):
    rng = np.random.default_rng(seed)
    V, M = rng.normal(size=(9, 3)), spd(9, rng)
    Q = orthonormal(np.column_stack([V, DEPENDENT[kind](V)]), M)
    assert Q.shape == (9, 3)
    np.testing.assert_allclose(Q.T @ M @ Q, np.eye(3), atol=1e-10)
    assert span_distance(V, Q) < 1e-9


@pytest.mark.parametrize("kind", ["both", "displacement", "rates"])
@pytest.mark.parametrize("inner", ["energy", "mass", "euclidean"])
def test_modes_of_a_run_are_orthonormal_and_reproduce_its_snapshots(kind, inner):
    whole = full("strip")
    run = replace(whole, u=whole.u[::4], v=whole.v[::4])
    proper = sj.proper_modes(run, snapshots=kind, inner_product=inner)
    V, n = proper.modes, run.system.n
    G = inner_matrix(run.system, inner, run.u, run.v)
    G = np.eye(n) if G is None else G
    np.testing.assert_allclose(V.T @ (G @ V), np.eye(V.shape[1]), atol=1e-8)
    assert proper.cumulative[-1] == pytest.approx(100.0)
    for x in [run.v] if kind == "rates" else [run.u, run.v] if kind == "both" else [run.u]:
        again = (x @ (G @ V)) @ V.T
        assert np.abs(again - x).max() < 1e-6 * np.abs(x).max()
    every = sj.proper_modes(whole, snapshots=kind, inner_product=inner, every=4)
    np.testing.assert_array_equal(every.modes, V)


def test_modes_of_a_run_without_fields_or_of_unknown_words_are_refused():
    run = full("strip")
    with pytest.raises(sj.InputError, match=r"Save\(fields=True\)"):
        sj.proper_modes(replace(run, u=run.u[:0], v=run.v[:0]))
    with pytest.raises(sj.InputError, match="inner_product: found 'x'"):
        sj.proper_modes(run, inner_product="x")
    with pytest.raises(sj.InputError, match="snapshots: found 'x'"):
        sj.proper_modes(run, snapshots="x")
