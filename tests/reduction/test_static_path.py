"""Modes of the static slip path: what they leave of the full model, what they take; SI units."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bodies import SIDE, pressed, side, structure
from reduced_joints import bar, case, case_i, errors, fig_18, full, three_periods

import skfem_joint as sj
from skfem_joint.reduction.friction_points import friction_lost, merged_points
from skfem_joint.reduction.sources import static_basis
from skfem_joint.reduction.static_path import slip_path
from skfem_joint.stepping.plan import Plan

EXAMPLES = Path(__file__).parents[2] / "examples"
LIMIT = 175e3  # of Fig. 18, N


def error(system: sj.System, few: sj.System) -> tuple[float, float, float]:
    """Errors of peak, history and friction energy over four periods of 200 steps."""
    exact, found = (sj.integrate(one, cycles=4, steps_per_cycle=200) for one in (system, few))
    rms = np.linalg.norm(found.point_u - exact.point_u, axis=0)
    history = rms.max() / np.linalg.norm(exact.point_u, axis=0).max()
    peak = np.abs(found.cycles.peak[-1] / exact.cycles.peak[-1] - 1.0).max()
    return peak, history, abs(found.cycles.friction[-1] / exact.cycles.friction[-1] - 1.0)


def harmonics() -> tuple[sj.Structure, sj.System]:
    """Structure of Fig. 18 under two harmonics, which make minor loops."""
    parts = (sj.Harmonic(0.3 * LIMIT, 300.0), sj.Harmonic(0.2 * LIMIT, 1500.0, 0.7))
    regions = [("joint", 0.1, 100), ("linear", 0.5, 100)]
    return bar(regions, ["joint"], [("end", sj.MultiHarmonic(parts))])


@pytest.mark.parametrize(
    ("make", "modes", "unknowns", "allowed"),
    [
        (fig_18, 12, 15, (0.003, 0.001, 0.007)),
        (lambda: case_i(1000.0), 12, 15, (0.003, np.inf, 0.01)),
        (lambda: case_i(2000.0), 12, 15, (0.003, np.inf, 0.01)),  # near resonance
        (harmonics, 16, 20, (np.inf, np.inf, 0.015)),
    ],
)
def test_bars_are_followed_with_few_unknowns(make, modes, unknowns, allowed):
    system = make()[1]
    small = sj.reduce(system, modes)
    V = small.origin.basis.V
    assert small.n <= unknowns
    np.testing.assert_allclose(V.T @ (system.M @ V), np.eye(small.n), atol=1e-9)
    assert np.all(np.array(error(system, small)) < allowed)


def test_a_law_that_creeps_everywhere_is_followed():
    _, system = fig_18(frequency=1.0)
    assert max(error(system, sj.reduce(system, 12, friction_points="all"))) < 0.002


def test_small_slow_slip_is_followed_as_large_slip():
    def missed(factor: float) -> float:
        regions = [("joint", 0.1, 20), ("linear", 0.5, 20)]
        loads = [("end", sj.Harmonic(factor * 87.5e3, 500.0))]
        made, _ = bar(regions, ["joint"], loads, beta=np.inf)
        pressed = replace(made.joints[0], pressure=factor * 50e6)
        system = replace(made, joints=[pressed]).system([sj.Load(*loads[0])])
        return float(sj.reduce(system, 12).origin.basis.history.missed)

    assert missed(1e-7) == pytest.approx(missed(1.0), rel=1e-3)


def test_no_step_of_the_full_model_is_taken():
    path = slip_path(fig_18()[1], Plan(1e-5, 800))
    offline = path.work
    assert set(offline) == {"quasi-static states", "factorizations", "preliminary steps"}
    assert offline["quasi-static states"] == 1 + 6 + 13  # response, first and second path
    assert offline["factorizations"] <= 2.5 * offline["quasi-static states"]
    assert offline["preliminary steps"] == 400
    assert path.run.system.n < 30


def test_a_pulse_with_sixteen_unknowns():
    structure, _ = fig_18()
    system = structure.system([sj.Load("end", sj.Triangle(87.5e3, 4e-5, 1e-3))])  # it sets in late
    few = sj.reduce(system, 15, interface_modes=0, duration=4e-3)
    assert few.n == 16
    exact, found = (sj.integrate(one, step=2e-6, n_steps=2000) for one in (system, few))
    difference = np.linalg.norm(found.point_u - exact.point_u, axis=0)
    assert difference.max() < 0.005 * np.linalg.norm(exact.point_u, axis=0).max()
    assert found.friction_work.sum() == pytest.approx(exact.friction_work.sum(), rel=1e-3)


@pytest.mark.parametrize("name", ["edge", "two"])
def test_plates_that_bend_or_lie_on_each_other(name):
    _, system, step = case(name)
    history, friction = errors(three_periods(sj.reduce(system), step), full(name))
    assert history < 1e-3
    assert abs(friction) < 5e-3


def test_few_points_lose_little_friction_power_and_never_gain():
    system = fig_18()[1]
    basis = sj.reduce(system, 12).origin.basis
    every = system.project(basis.V)
    lost = []
    for count in (10, 20, 40, 80):
        few = merged_points(every, basis.history.velocities, basis.history.active, count)
        lost.append(friction_lost(every, few, basis.history.velocities))
        assert few.contact.w.sum() == pytest.approx(system.contact.w.sum(), rel=1e-12)
    assert all(-1e-12 < one < 0.01 for one in lost)
    assert lost[-1] < 0.1 * lost[0]


def test_what_cannot_be_followed_is_refused():
    structure, _ = fig_18()
    still = structure.system([sj.Load("end", sj.Harmonic(0.0, 500.0))])
    with pytest.raises(sj.InputError, match="no load acts"):
        sj.reduce(still)


def test_a_dense_system_has_the_modes_of_the_sparse_one():
    regions = [("joint", 0.1, 20), ("linear", 0.5, 20)]
    _, system = bar(regions, ["joint"], [("end", sj.Harmonic(87.5e3, 500.0))])
    dense = system.project(np.eye(system.n))
    bases = [sj.reduce(one, 8).origin.basis.V for one in (system, dense)]
    spans = np.linalg.svd(bases[0].T @ (system.M @ bases[1]), compute_uv=False)
    assert spans == pytest.approx(1.0, abs=2e-8)


def test_a_body_that_slides_on_a_path_may_move_rigidly_in_the_basis():
    # The load bends two bolted plates beside their resonance: all points slip on a path, though no
    # load is scaled back. A response by a model without these motions peaked 25 % too low.
    system = sj.load_scene(EXAMPLES / "solid_lap_joint.toml").system()
    loaded = sj.at(system, frequency=360.3448, level=1.0)
    path = slip_path(loaded, Plan(1.0 / 360.3448 / 100, 3200, cycle_steps=100), 28)
    basis = static_basis(loaded, path, 28)
    loose = sj.natural_modes(loaded, 3)
    assert loose.rigid_motions == 2
    for x in loose.modes[:, :2].T:  # of modal mass 1
        left = x - basis.V @ (basis.V.T @ (loaded.M @ x))
        assert left @ (loaded.M @ left) < 1e-9
    assert basis.history.missed < 0.03


def test_bodies_that_are_apart_at_rest_are_reduced_without_modes_that_strain_nothing():
    """Energies of their rigid motions are round-off, below zero, too, and warned of roots."""
    apart = replace(SIDE, pressure=0.0, contact="unilateral", gap=1e-6)
    base = pressed("base", pressure=2e6, contact="unilateral")
    made = structure(side(), [apart, base], ["lower_left"], free=True, damping_ratio=0.01)
    pull = sj.Load("upper_right", sj.Harmonic(10.0, 300.0), direction=(0.3, 1.0))
    small = sj.reduce(made.system([pull]), 4, duration=0.01)
    K, M = small.K, small.M
    assert np.linalg.eigvalsh(K).min() > -1e-9 * np.linalg.eigvalsh(K).max()
    assert np.linalg.matrix_rank(M) == small.n
