"""Slip vectors: the law, its tangent, and dense steps with points that slip in two directions."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from skfem_joint import friction, kernels_dense
from skfem_joint.integrate import integrate
from skfem_joint.loads import Harmonic
from skfem_joint.recording import Run, Save
from skfem_joint.schemes import average_acceleration, generalized_alpha
from skfem_joint.system import AppliedLoad, System

EPS = float(np.finfo(float).eps)
BETAS = np.array([1e2, 1e5, 1e7])


def turn(angle: float) -> np.ndarray:
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def slips(count: int = 50) -> np.ndarray:
    generator = np.random.default_rng(3)
    return generator.standard_normal((count, 2)) * 10.0 ** generator.uniform(-9, 1, (count, 1))


# The law


@pytest.mark.parametrize("beta", [*BETAS, np.inf])
def test_force_has_the_slip_s_direction_and_the_scalar_law_s_size(beta: float) -> None:
    y = slips()
    two = np.full(len(y), 2)
    f = friction.force_vectors(y.ravel(), beta, two).reshape(-1, 2)
    size = np.hypot(*y.T)
    np.testing.assert_allclose(np.hypot(*f.T), friction.force(size, beta), rtol=8 * EPS)
    np.testing.assert_allclose(f[:, 0] * y[:, 1], f[:, 1] * y[:, 0], rtol=8 * EPS)
    assert np.all(np.einsum("pd,pd->p", f, y) > 0.0)
    assert np.array_equal(friction.force_vectors(np.zeros(4), beta, two[:2]), np.zeros(4))


def test_points_of_both_kinds_keep_their_order() -> None:
    directions = np.array([1, 2, 1, 2, 2])
    slip = np.random.default_rng(0).standard_normal((3, 8))
    beta = np.array([10.0, 1.0, np.inf, 1e3, 7.0])
    f = friction.force_vectors(slip, beta, directions)
    assert np.array_equal(f[:, 0], friction.force(slip[:, 0], 10.0))
    assert np.array_equal(f[:, 3], np.sign(slip[:, 3]))
    expected = friction.force_vectors(slip[:, 4:6], beta[3], np.array([2]))
    np.testing.assert_allclose(f[:, 4:6], expected, rtol=2 * EPS)
    np.testing.assert_allclose(
        friction.norms(slip, directions)[:, 4], np.hypot(slip[:, 6], slip[:, 7]), rtol=4 * EPS
    )


@pytest.mark.parametrize("beta", BETAS)
def test_tangent_is_slope_along_and_force_over_norm_across(beta: float) -> None:
    y = slips()
    block = friction.tangent_blocks(y, beta)
    size = np.hypot(*y.T)[:, None]
    normal = np.stack([-y[:, 1], y[:, 0]], axis=1)
    along, across = friction.slope(size, beta), friction.force(size, beta) / size
    scale = 1e-14 * size * across
    assert np.all(np.abs(np.einsum("pij,pj->pi", block, y) - along * y) <= scale)
    assert np.all(np.abs(np.einsum("pij,pj->pi", block, normal) - across * normal) <= scale)
    assert np.array_equal(block, np.swapaxes(block, 1, 2))
    at_rest = friction.tangent_blocks(np.zeros(2), beta)
    assert np.array_equal(at_rest, 2.0 / np.pi * beta * np.eye(2))


def test_tangent_is_the_derivative_of_the_force() -> None:
    # Complex steps have no cancellation: the derivative comes out to round-off.
    y, step = slips(), 1e-30
    for d in (0, 1):
        z = y.astype(complex)
        z[:, d] += 1j * step
        size = np.sqrt(z[:, :1] ** 2 + z[:, 1:] ** 2)
        f = 2.0 / np.pi * np.arctan(1e3 * size) * z / size
        block = friction.tangent_blocks(y, 1e3)
        error = np.abs(f.imag / step - block[:, :, d]).max(axis=1)
        assert np.all(error <= 1e-13 * block[:, [0, 1], [0, 1]].max(axis=1))


# One step


def problem(pairs: int, singles: int, n: int, seed: int = 0, beta: float = 1e5) -> Any:
    """Step matrix, contact, right-hand side; the points with one direction come in between."""
    generator = np.random.default_rng(seed)
    A = generator.standard_normal((n, n))
    directions = generator.permutation(np.repeat([2, 1], [pairs, singles]))
    first = np.concatenate([[0], np.cumsum(directions)])
    B = generator.standard_normal((first[-1], n))
    w = generator.uniform(0.1, 2.0, pairs + singles)
    H, g = A @ A.T + n * np.eye(n), 10.0 * generator.standard_normal(n)
    return H, B, directions, first, w, np.full(w.size, beta), g


def solve(H: Any, B: Any, first: Any, w: Any, beta: Any, g: Any) -> tuple[Any, ...]:
    contact = kernels_dense.contact_of(B, first, w, beta)
    n, rows, m = len(g), len(B), len(w)
    q, slip, sigma = np.zeros(n), np.zeros(rows), np.zeros(rows)
    room = kernels_dense.make_room(n, rows, m)
    result = kernels_dense.solve_step(H, contact, g, q, slip, sigma, 1e-12, room)
    force = np.empty(rows)
    force[contact.row] = sigma
    return q, force, result


@pytest.mark.parametrize("beta", [1.0, 1e3, 1e5])
@pytest.mark.parametrize(("pairs", "singles", "n"), [(1, 0, 2), (20, 0, 6), (7, 9, 5), (0, 9, 4)])
def test_step_meets_its_equation(pairs: int, singles: int, n: int, beta: float) -> None:
    H, B, directions, first, w, betas, g = problem(pairs, singles, n, beta=beta)
    q, force, (iterations, _, converged, _) = solve(H, B, first, w, betas, g)
    assert converged
    assert iterations < 40
    expected = friction.force_vectors(B @ q, betas, directions)
    residual = H @ q + B.T @ (np.repeat(w, directions) * expected) - g
    assert np.abs(residual).max() < 1e-9 * np.abs(g).max()
    np.testing.assert_allclose(force, expected, atol=1e-9)


def test_newton_converges_quadratically() -> None:
    # A wrong tangent would take tens of iterations from rest; the law is soft here.
    H, B, _, first, w, beta, g = problem(20, 5, 6, beta=1.0)
    iterations, evaluations = solve(H, B, first, w, beta, g)[2][:2]
    assert iterations <= 6
    assert evaluations == iterations + 1


def test_solution_has_the_least_objective() -> None:
    H, B, directions, first, w, beta, g = problem(12, 6, 5, seed=2)
    q = solve(H, B, first, w, beta, g)[0]

    def objective(x: np.ndarray) -> float:
        size = friction.norms(B @ x, directions)
        return float(0.5 * x @ H @ x - g @ x + w @ friction.potential(size, beta))

    generator = np.random.default_rng(5)
    for size in 10.0 ** np.arange(-6.0, 1.0):
        assert objective(q + size * generator.standard_normal(5)) > objective(q)


# Runs


def system(pairs: int = 6, singles: int = 0, n: int = 4, **changes: Any) -> System:
    generator = np.random.default_rng(7)
    A = generator.standard_normal((n, n))
    directions = generator.permutation(np.repeat([2, 1], [pairs, singles])).astype(np.int64)
    values: dict[str, Any] = {
        "M": np.eye(n),
        "C": 0.02 * (A @ A.T + n * np.eye(n)),
        "K": 4.0 * (A @ A.T + n * np.eye(n)),
        "B": generator.standard_normal((int(directions.sum()), n)),
        "w": generator.uniform(0.05, 0.3, pairs + singles),
        "beta": np.full(pairs + singles, 1e3),
        "loads": tuple(
            AppliedLoad(generator.standard_normal(n), Harmonic(4.0, f, f), f"{f}") for f in (0.3, 1)
        ),
        "P": np.eye(n),
        "points": tuple("abcdefgh"[:n]),
        "directions": directions,
    }
    return System(**{**values, **changes})


def run_of(s: System, steps: int = 200, **options: Any) -> Run:
    return integrate(s, step=0.02, n_steps=steps, save=Save(fields=True), **options)


@pytest.mark.parametrize("singles", [0, 5])
def test_turned_slip_rows_change_nothing(singles: int) -> None:
    s = system(singles=singles)
    B = s.B.copy()
    for i, angle in zip(s.first_row[:-1][s.directions == 2], range(1, 99), strict=False):
        B[i : i + 2] = turn(float(angle)) @ B[i : i + 2]
    one, other = run_of(s), run_of(replace(s, B=B))
    np.testing.assert_allclose(other.point_u, one.point_u, rtol=0, atol=1e-12 * one.peak.max())
    np.testing.assert_allclose(other.friction_work, one.friction_work, rtol=1e-10)
    np.testing.assert_allclose(other.slip_peak, one.slip_peak, rtol=1e-10)


def test_motion_along_one_direction_obeys_the_scalar_law() -> None:
    s = system(pairs=0, singles=6)
    pairs = np.zeros((12, 4))
    pairs[0::2], pairs[1::2] = 0.6 * s.B, -0.8 * s.B
    vectors = replace(s, B=pairs, directions=np.full(6, 2))
    one, other = run_of(s), run_of(vectors)
    np.testing.assert_allclose(other.point_u, one.point_u, rtol=0, atol=1e-12 * one.peak.max())
    np.testing.assert_allclose(other.friction_work, one.friction_work, rtol=1e-10)
    np.testing.assert_allclose(other.slip_peak, one.slip_peak, rtol=1e-10)
    np.testing.assert_allclose(other.sigma[:, 0::2], 0.6 * one.sigma, rtol=0, atol=1e-9)


def test_order_of_the_points_does_not_matter() -> None:
    s = system(singles=5)
    order = np.random.default_rng(1).permutation(s.w.size)
    rows = np.concatenate([np.arange(s.first_row[p], s.first_row[p + 1]) for p in order])
    shuffled = replace(s, B=s.B[rows], w=s.w[order], directions=s.directions[order])
    one, other = run_of(s), run_of(shuffled)
    np.testing.assert_allclose(other.point_u, one.point_u, rtol=0, atol=1e-12 * one.peak.max())
    np.testing.assert_allclose(other.friction_work, one.friction_work[order], rtol=1e-9)
    np.testing.assert_allclose(other.slip_peak, one.slip_peak[order], rtol=1e-9)
    np.testing.assert_allclose(other.sigma, one.sigma[:, rows], rtol=0, atol=1e-9)


@pytest.mark.parametrize("scheme", [average_acceleration(), generalized_alpha(0.6)])
def test_energy_and_works_of_each_point_add_up(scheme: Any) -> None:
    s = system(singles=5)
    run = run_of(s, scheme=scheme, tolerance=1e-13)
    assert run.energy_residual < 1e-12
    du = np.diff(run.u @ s.B.T, axis=0)
    mean = 0.5 * (run.sigma[1:] + run.sigma[:-1])
    work = np.add.reduceat(mean * du, s.first_row[:-1], axis=1) * s.w
    np.testing.assert_allclose(run.friction_work, work.sum(axis=0), rtol=1e-9)
    np.testing.assert_allclose(run.friction_work_rows[1:], np.cumsum(work, axis=0), atol=1e-9)
    np.testing.assert_allclose(
        run.slip_peak, friction.norms(run.u @ s.B.T, s.directions).max(axis=0), rtol=1e-12
    )
    assert np.all(work > -1e-12)


def test_steady_circular_sliding_is_exact() -> None:
    # A mass on isotropic springs, driven by a turning force, circles with radius r. The trapezoidal
    # rule turns it at the rate W = 2/h tan(w h/2): (K - W^2 M) r + i (C W r + w sigma(W r)) = F.
    M, C, K, w, beta, r = 2.0, 0.7, 30.0, 5.0, 40.0, 0.1
    frequency, steps = 1.5, 60
    h = 1.0 / frequency / steps
    rate = 2.0 / h * np.tan(np.pi / steps)
    normalised = float(friction.force(rate * r, beta))
    F = (K - rate**2 * M) * r + 1j * (C * rate * r + w * normalised)
    phase = float(np.angle(F))
    loads = tuple(
        AppliedLoad(e, Harmonic(abs(F), frequency, phase + shift))
        for e, shift in zip(np.eye(2), (np.pi / 2.0, 0.0), strict=True)
    )
    one = np.eye(2)
    s = System(
        M=M * one,
        C=C * one,
        K=K * one,
        B=one,
        w=np.array([w]),
        beta=np.array([beta]),
        loads=loads,
        P=one,
        points=("x", "y"),
        directions=np.array([2]),
    )
    run = integrate(
        s,
        step=h,
        n_steps=3 * steps,
        scheme=average_acceleration(),
        cycle_steps=steps,
        initial=(np.array([r, 0.0]), np.array([0.0, rate * r])),
    )
    np.testing.assert_allclose(np.hypot(*run.point_u.T), r, rtol=1e-9)
    chord = steps * np.sin(2.0 * np.pi / steps)  # 2 pi for small steps: 2 pi r mu N a cycle
    np.testing.assert_allclose(run.cycles.friction, chord * r * w * normalised, rtol=1e-9)
    assert run.slip_peak[0] == pytest.approx(r, rel=1e-9)
