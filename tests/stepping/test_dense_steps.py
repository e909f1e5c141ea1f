"""Dense steps with points that slip in one direction and in two."""

from typing import Any

import numpy as np
import pytest
from stepping_systems import LapJoint, dense_system

import skfem_joint as sj
from skfem_joint.ground.arrays import slip_norms
from skfem_joint.minimise import law
from skfem_joint.minimise.primal_dual_newton import PrimalDualNewton
from skfem_joint.minimise.problem import ContactPoints

STEP = 0.02  # s


def turn(angle: float) -> np.ndarray:
    return np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])


def run_of(s: sj.System, steps: int = 200, **options: Any) -> sj.Run:
    return sj.integrate(s, step=STEP, n_steps=steps, save=sj.Save(fields=True), **options)


@pytest.mark.parametrize(("beta", "iterations"), [(1.0, 1.1), (1e3, 1.5), (1e5, 1.8)])
@pytest.mark.parametrize(("pairs", "singles"), [(1, 0), (20, 0), (6, 9), (0, 9)])
def test_steps_meet_the_trapezoidal_rule_and_the_law_in_a_few_iterations(
    pairs, singles, beta, iterations
):
    """A wrong tangent of the friction would take tens of iterations."""
    s = dense_system(singles, pairs).with_beta(beta)
    run = run_of(s, tolerance=1e-13)
    expected = [
        law.force_vectors(slip, s.contact.beta, s.contact.directions)
        for slip in run.v @ s.contact.B.T
    ]
    np.testing.assert_allclose(run.sigma, expected, atol=1e-9)
    forces = (run.sigma * s.contact.on_rows(s.contact.w)) @ s.contact.B + run.v @ s.C + run.u @ s.K
    left = s.load_amplitudes(run.field_times).T @ s.load_vectors().T - forces
    change = np.diff(run.v, axis=0) @ s.M / STEP
    np.testing.assert_allclose(change, 0.5 * (left[1:] + left[:-1]), atol=1e-10)
    np.testing.assert_allclose(
        np.diff(run.u, axis=0), 0.5 * STEP * (run.v[1:] + run.v[:-1]), atol=1e-14
    )
    assert run.counters.newton_iterations <= iterations * run.counters.steps


@pytest.mark.parametrize("singles", [0, 3])
def test_points_without_friction_have_no_force(singles):
    s = dense_system(singles)
    free = np.arange(s.contact.w.size) % 2 == 0
    run = run_of(s.with_contact(given=np.where(free, 0.0, s.contact.w)))
    by_row = np.repeat(free, s.contact.directions)
    assert not run.sigma[:, by_row].any()
    assert run.sigma[-1, ~by_row].all()


@pytest.mark.parametrize("unknown", [0, 2])
@pytest.mark.parametrize("bad", [np.inf, np.nan])
def test_what_is_not_finite_is_never_accepted_and_its_unknown_is_named(unknown, bad):
    s = dense_system()
    force = np.ones(s.n)
    force[unknown] = bad
    minimum = PrimalDualNewton(s.M, ContactPoints.of(s)).minimise(force, np.zeros(s.n))
    assert not minimum.converged
    assert minimum.where == unknown


def test_points_out_of_the_steep_part_of_a_law_are_found_back():
    """The law's slope alone takes 13 iterations a step, and 75 evaluations of friction."""
    small = sj.reduce(LapJoint().system, modes=12).with_beta(1e7)
    counters = sj.integrate(small, step=5e-6, n_steps=400).counters
    assert counters.newton_iterations <= 9 * counters.steps
    assert counters.friction_evaluations <= 40 * counters.steps


def assert_same(one: sj.Run, other: sj.Run) -> None:
    np.testing.assert_allclose(other.point_u, one.point_u, rtol=0, atol=1e-12 * one.peak.max())
    np.testing.assert_allclose(other.friction_work, one.friction_work, rtol=1e-9)
    np.testing.assert_allclose(other.slip_peak, one.slip_peak, rtol=1e-9)


@pytest.mark.parametrize("singles", [0, 5])
def test_turned_slip_rows_change_nothing(singles):
    s = dense_system(singles=singles)
    B = s.contact.B.copy()
    for i, angle in zip(
        s.contact.first_row[:-1][s.contact.directions == 2], range(1, 99), strict=False
    ):
        B[i : i + 2] = turn(float(angle)) @ B[i : i + 2]
    assert_same(run_of(s), run_of(s.with_contact(B=B)))


@pytest.mark.parametrize("scheme", [sj.generalized_alpha(1.0), sj.generalized_alpha(0.6)])
def test_energy_and_works_of_each_point_add_up(scheme):
    s = dense_system(singles=5)
    run = run_of(s, scheme=scheme, tolerance=1e-13)
    assert run.energy_residual < 1e-12
    du = np.diff(run.u @ s.contact.B.T, axis=0)
    mean = 0.5 * (run.sigma[1:] + run.sigma[:-1])
    work = np.add.reduceat(mean * du, s.contact.first_row[:-1], axis=1) * s.contact.w
    np.testing.assert_allclose(run.friction_work, work.sum(axis=0), rtol=1e-9)
    np.testing.assert_allclose(run.friction_work_rows[1:], np.cumsum(work, axis=0), atol=1e-9)
    np.testing.assert_allclose(
        run.slip_peak,
        slip_norms(run.u @ s.contact.B.T, s.contact.directions).max(axis=0),
        rtol=1e-12,
    )
    assert np.all(work > -1e-12)


def test_steady_circular_sliding_is_exact():
    # A mass on isotropic springs, driven by a turning force, circles with radius r. The trapezoidal
    # rule turns it at the rate W = 2/h tan(w h/2): (K - W^2 M) r + i (C W r + w sigma(W r)) = F.
    M, C, K, w, beta, r = 2.0, 0.7, 30.0, 5.0, 40.0, 0.1
    frequency, steps = 1.5, 60
    h = 1.0 / frequency / steps
    rate = 2.0 / h * np.tan(np.pi / steps)
    normalised = float(law.force(rate * r, beta))
    F = (K - rate**2 * M) * r + 1j * (C * rate * r + w * normalised)
    phase, one = float(np.angle(F)), np.eye(2)
    loads = tuple(
        sj.AppliedLoad(e, sj.Harmonic(abs(F), frequency, phase + shift))
        for e, shift in zip(one, (np.pi / 2.0, 0.0), strict=True)
    )
    s = sj.System(
        M * one,
        C * one,
        K * one,
        sj.Contact(one, [w], beta, directions=np.array([2])),
        loads=loads,
        P=one,
        points=("x", "y"),
    )
    start = (np.array([r, 0.0]), np.array([0.0, rate * r]))
    run = sj.integrate(s, cycles=3, steps_per_cycle=steps, initial=start)
    np.testing.assert_allclose(np.hypot(*run.point_u.T), r, rtol=1e-9)
    chord = steps * np.sin(2.0 * np.pi / steps)  # 2 pi for small steps: 2 pi r mu N a cycle
    np.testing.assert_allclose(run.cycles.friction, chord * r * w * normalised, rtol=1e-9)
    assert run.slip_peak[0] == pytest.approx(r, rel=1e-9)
