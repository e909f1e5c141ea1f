"""Residuals of harmonic balance: analytic derivatives of each kind of contact."""

import numpy as np
import pytest
from scipy import sparse

import skfem_joint as sj
from skfem_joint.harmonic.balance import Balance
from skfem_joint.harmonic.series import FourierSeries


def random_system(directions, q, seed):
    """Dense system of six unknowns with contact points of ``directions`` and q pressure points."""
    rng, n, m = np.random.default_rng(seed), 6, len(directions)
    K, M = (
        A @ A.T + shift * np.eye(n)
        for A, shift in zip(rng.normal(size=(2, n, n)), (n, 2), strict=True)
    )
    others = {}
    if q:
        force = np.where(np.arange(q) % 3 == 0, 0.0, rng.uniform(0.1, 1.0, q))
        gap = np.where(force == 0.0, rng.uniform(0.0, 0.5, q), 0.0)
        N, stiffness = rng.normal(size=(q, n)), np.full(q, 3.0)
        others["normal"] = sj.NormalPart(N, gap, force, stiffness, np.ones(q))
        gain = rng.uniform(0.1, 1.0, (m, q)) * (rng.random((m, q)) < 0.7)
        others["gain"] = sparse.csr_array(gain)
    given = np.where(rng.random(m) < 0.5, 0.0, 0.2) if q else rng.uniform(0.1, 0.5, m)
    B = rng.normal(size=(sum(directions), n))
    contact = sj.Contact(B, given, np.inf, np.array(directions), np.full(m, 5.0), **others)
    return sj.System(M, 0.1 * K, K, contact)


@pytest.mark.parametrize("harmonics", [1, 4])
@pytest.mark.parametrize(
    ("directions", "q", "odd"),
    [
        ((1,), 0, True),
        ((1, 1, 1), 0, False),
        ((2, 2), 0, True),
        ((1, 2, 2), 0, False),
        ((1, 2), 4, False),
        ((2, 1, 2), 3, False),
    ],
)
def test_derivatives_are_those_of_the_residual(directions, q, odd, harmonics):
    system = random_system(directions, q, 3)
    series = FourierSeries(harmonics, 64, odd)
    balance = Balance.of(system, series, 1.5, 3.0)
    motion = 0.6 * np.random.default_rng(1).normal(size=(series.size, 6))
    there = balance.residual(motion, 1.3, 0.05)
    assert balance.sampled(motion, False).moves.any()

    def values(x, omega=1.3, zeta=0.05):
        return balance.residual(x.reshape(motion.shape), omega, zeta, tangents=False).values.ravel()

    flat, h = motion.ravel(), 1e-6
    columns = [(values(flat + h * e) - values(flat - h * e)) / (2 * h) for e in np.eye(flat.size)]
    analytic = there.derivative.reshape(flat.size, -1)
    assert analytic == pytest.approx(np.array(columns).T, abs=1e-7 * np.abs(analytic).max())
    by_omega = (values(flat, 1.3 + h) - values(flat, 1.3 - h)) / (2 * h)
    by_zeta = (values(flat, 1.3, 0.05 + h) - values(flat, 1.3, 0.05 - h)) / (2 * h)
    assert there.by_omega.ravel() == pytest.approx(by_omega, abs=1e-6)
    assert there.by_zeta.ravel() == pytest.approx(by_zeta, abs=1e-6)


def test_odd_series_and_whole_ones_have_the_same_residual():
    """Of a motion of odd harmonics under constant limits; the whole one has no even harmonics."""
    system = random_system((1, 2), 0, 5)
    odd, whole = FourierSeries(5, 256, True), FourierSeries(5, 256, False)
    motion = np.random.default_rng(2).normal(size=(odd.size, 6))
    one = Balance.of(system, odd, 1.5, 3.0).residual(motion, 1.1, 0.02)
    other = Balance.of(system, whole, 1.5, 3.0).residual(whole.of(motion, odd), 1.1, 0.02)
    assert other.values == pytest.approx(whole.of(one.values, odd), abs=1e-10)


@pytest.mark.parametrize("odd", [True, False])
def test_a_vector_of_friction_repeats_itself(odd):
    """It comes to its cycle in many periods where a point hardly slips, as in a loop of its own."""
    contact = sj.Contact(np.eye(2), [1.0], np.inf, np.array([2]), np.ones(1))
    system = sj.System(np.eye(2), None, np.eye(2), contact)
    series = FourierSeries(3, 128, odd)
    balance = Balance.of(system, series, 1.0, 3.0)
    u = np.zeros((series.size, 2))
    u[series.first : series.first + 2] = [[1.3, 0.2], [0.1, 0.5]]
    whole = FourierSeries(3, 128, False)
    motion, force, before = whole.basis @ whole.of(u, series), np.zeros(2), np.zeros(2)
    for _ in range(300):
        cycle = []
        for now in motion:
            force = force + now - before
            force, before = force / max(1.0, np.linalg.norm(force)), now
            cycle.append(force)
    found = balance.sampled(balance.inner(u), False).friction
    count = found.shape[1]
    assert found == pytest.approx(np.array(cycle).T[:, :count], abs=1e-6)
