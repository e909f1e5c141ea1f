"""What histories say: loops, stick and slip, steady state, distance between runs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from bars import LapJoint
from scipy import sparse

from skfem_joint.errors import InputError
from skfem_joint.history import compare, hysteresis_loop, peaks, slip_state, steady_state
from skfem_joint.integrate import integrate
from skfem_joint.recording import Run, Save


def harmonic_run(joint: LapJoint, cycles: int = 3, steps: int = 200, every: int = 1) -> Run:
    return integrate(
        joint.system,
        step=1 / joint.frequency / steps,
        n_steps=cycles * steps,
        cycle_steps=steps,
        save=Save(every=every, fields=True),
    )


@pytest.fixture(scope="module")
def run() -> Run:
    return harmonic_run(LapJoint())


@pytest.fixture(scope="module")
def coulomb() -> Run:
    return harmonic_run(LapJoint(beta=np.inf))


def test_a_run_is_at_no_distance_from_itself(run: Run) -> None:
    errors = compare(run, run)
    assert errors.displacement_rms == 0.0
    assert errors.displacement_max == 0.0
    assert errors.by_point == {"free_end": (0.0, 0.0)}
    assert errors.peak_displacement == 0.0
    assert errors.friction_energy_per_cycle == 0.0
    assert errors.loop_energy_per_cycle == 0.0
    assert errors.friction_energy == 0.0


def test_errors_are_relative_to_the_reference_and_signed() -> None:
    # Linear: half the force halves the displacement and quarters the energy.
    one, half = (
        harmonic_run(LapJoint(elements=10, friction=0.0, force=f), cycles=1) for f in (2e4, 1e4)
    )
    errors = compare(one, half)
    assert errors.displacement_rms == pytest.approx(0.5, rel=1e-10)
    assert errors.displacement_max == pytest.approx(0.5, rel=1e-10)
    assert errors.peak_displacement == pytest.approx(-0.5, rel=1e-10)
    assert errors.loop_energy_per_cycle == pytest.approx(-0.75, rel=1e-10)
    assert errors.friction_energy_per_cycle == 0.0
    assert compare(half, one).loop_energy_per_cycle == pytest.approx(3.0, rel=1e-10)


def test_energies_per_cycle_are_not_compared_without_cycles() -> None:
    joint = LapJoint(elements=10)
    one = integrate(joint.system, step=1e-5, n_steps=50)
    errors = compare(one, one)
    assert errors.friction_energy_per_cycle is None
    assert errors.loop_energy_per_cycle is None
    assert peaks(one) == pytest.approx(one.peak)


def test_runs_of_other_times_or_points_are_not_compared(run: Run) -> None:
    coarser = harmonic_run(LapJoint(), every=2)
    with pytest.raises(InputError, match="same times and named points"):
        compare(run, coarser)
    other_step = harmonic_run(LapJoint(frequency=500.0))  # as many rows, at other times
    with pytest.raises(InputError, match="same times and named points"):
        compare(run, other_step)


def test_a_point_that_hardly_moves_does_not_decide_the_error(run: Run) -> None:
    # A point beyond the active length: its motion is round-off, and so is its error.
    def with_stuck_point(noise: float) -> Run:
        still = noise * np.sin(np.arange(run.times.size))[:, np.newaxis]
        P = sparse.vstack([run.system.P, run.system.P])
        system = replace(run.system, P=P, points=("free_end", "stuck"))
        return replace(
            run,
            system=system,
            point_u=np.hstack([run.point_u, still]),
            cycles=replace(run.cycles, peak=np.hstack([run.cycles.peak, 0.0 * run.cycles.peak])),
        )

    errors = compare(with_stuck_point(1e-25), with_stuck_point(-2e-22))
    assert errors.displacement_rms < 1e-9
    assert errors.displacement_max < 1e-9


def test_area_of_the_stored_loop_is_the_work_put_in(run: Run) -> None:
    u, f = hysteresis_loop(run, "free_end", rows_per_cycle=200)
    assert u.shape == f.shape == (201,)
    assert np.trapezoid(f, u) == pytest.approx(run.cycles.input[-1, 0], rel=1e-10)


def test_area_of_a_loop_stored_sparsely_errs_by_the_quadrature() -> None:
    sparse = harmonic_run(LapJoint(), every=5)
    u, f = hysteresis_loop(sparse, "free_end", rows_per_cycle=40)
    area = np.trapezoid(f, u)
    # A polygon of 40 corners inscribed in a convex loop: smaller, to second order.
    assert 0.98 * sparse.cycles.input[-1, 0] < area < sparse.cycles.input[-1, 0]


def test_steady_loop_closes(run: Run) -> None:
    u, f = hysteresis_loop(run, "free_end", rows_per_cycle=200)
    assert u[-1] == pytest.approx(u[0], abs=1e-3 * np.abs(u).max())
    assert f[-1] == pytest.approx(f[0], abs=1e-9 * np.abs(f).max())


def test_whole_history_as_a_loop(run: Run) -> None:
    u, f = hysteresis_loop(run, "free_end")
    assert np.array_equal(u, run.point("free_end"))
    assert f == pytest.approx(63e3 * np.sin(2e3 * np.pi * run.times), abs=1e-6)


def test_a_loop_needs_one_stored_cycle(run: Run) -> None:
    with pytest.raises(InputError, match="less than one cycle"):
        hysteresis_loop(run, "free_end", rows_per_cycle=601)


def test_coulomb_points_slip_at_the_limit_and_stick_at_rest(coulomb: Run) -> None:
    velocity = (coulomb.system.B @ coulomb.v.T).T
    state = slip_state(velocity, coulomb.system.beta)
    slipping = state == 1
    assert 0.2 < slipping.mean() < 0.8
    assert np.all(np.abs(coulomb.sigma[slipping]) == 1.0)
    assert np.all(np.abs(coulomb.sigma[~slipping]) < 1.0)
    assert np.all(velocity[~slipping] == 0.0)
    assert np.all(velocity[slipping] * coulomb.sigma[slipping] > 0.0)


def test_arctan_points_slip_from_a_share_of_their_own_speed_on() -> None:
    velocity = np.array([[1.0, -0.2, 0.009, 5e-4], [0.04, 0.011, -0.2, 5e-4]])
    assert slip_state(velocity, np.full(4, 1e5)).tolist() == [[1, 1, 0, 0], [0, 1, 1, 0]]
    still = np.array([[0.0, -1e-12]])
    assert slip_state(still, np.full(2, np.inf)).tolist() == [[0, 1]]


def test_points_near_the_clamp_stick_and_those_near_the_load_slip(run: Run) -> None:
    ever = slip_state((run.system.B @ run.v.T).T, run.system.beta).any(axis=0)
    assert not ever[0]
    assert ever[-1]


def test_steady_state_is_reached_in_the_third_cycle_not_in_the_second() -> None:
    two, three = (steady_state(harmonic_run(LapJoint(), cycles=n)) for n in (2, 3))
    assert two is not None
    assert three is not None
    assert not two.reached
    assert three.reached
    assert three.energy_change < two.energy_change
    assert three.peak_change < two.peak_change


def test_one_cycle_says_nothing_of_a_steady_state() -> None:
    assert steady_state(harmonic_run(LapJoint(elements=10), cycles=1)) is None


def test_a_system_at_rest_is_steady() -> None:
    state = steady_state(harmonic_run(LapJoint(elements=10, force=0.0), cycles=2))
    assert state is not None
    assert state.reached
    assert state.energy_change == state.peak_change == 0.0


def test_peaks_are_those_of_the_last_cycle(run: Run) -> None:
    last = np.abs(run.point("free_end")[401:]).max()
    assert peaks(run) == pytest.approx([last], rel=1e-12)
    assert run.peak[0] == pytest.approx(np.abs(run.point("free_end")).max(), rel=1e-12)
