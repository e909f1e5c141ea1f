"""Modes of a structure's own run."""

from dataclasses import replace

import numpy as np
import pytest
from reduced_joints import STEPS, case, errors, fig_18, full, three_periods
from scipy.linalg import subspace_angles

import skfem_joint as sj
from skfem_joint.reduction.basis import Options
from skfem_joint.reduction.sources import make_basis, own_basis
from skfem_joint.stepping.plan import Plan


@pytest.mark.parametrize("poisson", [0.0, 0.3])
def test_own_modes_reproduce_the_reference_plate(poisson):
    _, system, step = case("lap", poisson)
    run = full("lap", poisson)
    small, few = (sj.reduce(system, 12, run=run, friction_points=k) for k in ("all", 36))
    V, M = small.origin.basis.V, system.M
    np.testing.assert_allclose(V.T @ (M @ V), np.eye(12), atol=1e-10)
    velocities = small.origin.basis.history.velocities
    np.testing.assert_allclose(velocities, run.v @ (M @ V), rtol=1e-12)
    every = three_periods(small, step)
    history, energy = errors(every, run)
    assert history < 0.01
    assert abs(energy) < 0.02
    history, energy = errors(three_periods(few, step), every)
    assert history < 0.003
    assert abs(energy) < 0.005


def test_fixed_interface_modes_do_not_slip():
    _, system, _ = case("strip")
    plain, more = (
        sj.reduce(system, 6, run=full("strip"), interface_modes=count).origin.basis.V
        for count in (0, 2)
    )
    assert more.shape[1] == 8
    assert np.sin(subspace_angles(more, plain)).max() < 1e-12  # holds the others
    assert np.linalg.matrix_rank(system.contact.B @ more, tol=1e-9 * np.abs(more).max()) == 6


def test_modes_need_a_run_that_moves_and_holds_enough_snapshots():
    _, system, step = case("strip")
    save = sj.Save(fields=True)
    still = sj.integrate(replace(system, loads=()), step=step, n_steps=10, save=save)
    for run, modes, words in (
        (still, 4, "nothing moves"),
        (full("strip"), 999, r"reduction\.modes: found 999, must be from 1"),
    ):
        with pytest.raises(sj.InputError, match=words):
            sj.reduce(system, modes, run=run)


def test_own_modes_of_a_structure_come_from_its_first_three_cycles():
    _, system, step = case("strip")
    options = Options(reference="self", modes=6, interface_modes=2, active_length=0.05)
    plan = Plan(step, 5 * STEPS, cycle_steps=STEPS)
    basis = make_basis(system, options, plan)
    expected = own_basis(system, full("strip"), 6, interface_modes=2)
    assert np.sin(subspace_angles(basis.V, expected.V)).max() < 1e-12
    assert (basis.modes, basis.active_length, basis.modes_of_unit_length) == (6, {}, None)
    note = "reduction.active_length has no effect but beside reference = 'paper'."
    assert basis.notes == (note,)
    with pytest.raises(sj.InputError, match="must be 'static', 'self' or 'paper'"):
        make_basis(system, Options(reference="other"), plan)


def test_a_basis_that_cannot_follow_its_run_is_refused_or_doubted():
    structure, _, step = case("strip")
    plan = Plan(step, 3 * STEPS, cycle_steps=STEPS)
    bent = structure.system([sj.Load("right", sj.Harmonic(2e3, 500.0), (0.0, 1.0))], [])
    two, one = (Options(reference="self", modes=count) for count in (2, 1))
    basis = make_basis(bent, two, plan)
    assert 0.1 < basis.history.missed < 0.5
    assert "cannot follow" in basis.notes[0]
    with pytest.raises(sj.InputError, match="cannot follow"):
        make_basis(bent, one, plan)
    basis = make_basis(bent, one, plan, enriched=True)
    assert basis.history.missed > 0.5
    assert basis.notes[-1].startswith("The 1 vectors of the reduced model cannot follow")


def test_loads_that_do_not_repeat_need_a_duration():
    structure, _ = fig_18()
    system = structure.system([sj.Load("end", sj.HalfSine(5e4, 5e-4))])
    with pytest.raises(sj.InputError, match="no common period"):
        sj.reduce(system)
    assert sj.reduce(system, 8, duration=2e-3).n >= 8 + 1
