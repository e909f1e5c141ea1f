"""Modes of a structure's own run."""

from dataclasses import replace

import numpy as np
import pytest
from reduced_joints import STEPS, case, errors, fig_18, full, three_periods
from scipy.linalg import subspace_angles

import skfem_joint as sj
from skfem_joint.reduction.basis import Basis, Options, reduced_system
from skfem_joint.reduction.sources import make_basis, own_basis
from skfem_joint.stepping.plan import Plan
from skfem_joint.stepping.recording import Run


def reduced(system: sj.System, basis: Basis, step: float, points: str | int) -> Run:
    few = reduced_system(system, basis, friction_points=points)
    return three_periods(few, step)


@pytest.mark.parametrize("snapshots", ["both", "displacement"])
@pytest.mark.parametrize("inner_product", ["energy", "mass", "euclidean"])
def test_own_modes_are_the_best_of_their_number(inner_product, snapshots):
    _, system, _ = case("lap")
    run = full("lap")
    basis = own_basis(system, run, 8, snapshots=snapshots, inner_product=inner_product)
    np.testing.assert_allclose(basis.V.T @ (system.M @ basis.V), np.eye(8), atol=1e-10)
    np.testing.assert_allclose(basis.history.velocities, run.v @ (system.M @ basis.V), rtol=1e-12)
    modes, values = basis.proper.modes, basis.proper.singular_values
    assert np.all(np.diff(values) <= 0.0)
    if inner_product == "energy":
        return
    G = system.M.toarray() if inner_product == "mass" else np.eye(system.n)
    some = modes[:, :30]
    np.testing.assert_allclose(some.T @ G @ some, np.eye(30), atol=1e-9)
    parts = [run.u[::2]] if snapshots == "displacement" else [run.u[::2], run.v[::2]]
    X = np.vstack([x / np.sqrt(np.sum(x @ G * x)) for x in parts])
    values = values / np.sqrt(np.sum(values**2)) * np.sqrt(len(parts))
    left = X - X @ G @ modes[:, :8] @ modes[:, :8].T  # what eight modes leave out
    assert np.sum(left @ G * left) == pytest.approx(np.sum(values[8:] ** 2), rel=1e-6)


@pytest.mark.parametrize("poisson", [0.0, 0.3])
def test_own_modes_reproduce_the_reference_plate(poisson):
    _, system, step = case("lap", poisson)
    basis = own_basis(system, full("lap", poisson), 12)
    every = reduced(system, basis, step, "all")
    history, energy = errors(every, full("lap", poisson))
    assert history < 0.01
    assert abs(energy) < 0.02
    history, energy = errors(reduced(system, basis, step, 36), every)
    assert history < 0.003
    assert abs(energy) < 0.005


def test_fixed_interface_modes_do_not_slip():
    _, system, _ = case("strip")
    plain = own_basis(system, full("strip"), 6)
    more = own_basis(system, full("strip"), 6, interface_modes=2)
    assert more.V.shape[1] == 8
    assert np.sin(subspace_angles(more.V, plain.V)).max() < 1e-12  # holds the others
    assert np.linalg.matrix_rank(system.contact.B @ more.V, tol=1e-9 * np.abs(more.V).max()) == 6


def test_modes_need_a_run_that_moves_and_holds_enough_snapshots():
    _, system, step = case("strip")
    save = sj.Save(fields=True)
    still = sj.integrate(replace(system, loads=()), step=step, n_steps=10, save=save)
    with pytest.raises(sj.InputError, match="nothing moves"):
        own_basis(system, still, 4)
    with pytest.raises(sj.InputError, match=r"reduction\.modes: found 0, must be from 1"):
        own_basis(system, full("strip"), 0)
    with pytest.raises(sj.InputError, match=r"reduction\.modes: found 999"):
        own_basis(system, full("strip"), 999)
    for option, wrong in {"inner_product": "power", "snapshots": "velocity"}.items():
        with pytest.raises(sj.InputError, match=f"{option}: found '{wrong}'"):
            own_basis(system, full("strip"), 4, **{option: wrong})


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


def test_a_run_of_ones_own_gives_the_modes():
    structure, _ = fig_18()
    system = structure.system([sj.Load("end", sj.HalfSine(5e4, 5e-4))])
    with pytest.raises(sj.InputError, match="no common period"):
        sj.reduce(system)
    assert sj.reduce(system, 8, duration=2e-3).n >= 8 + 1
    run = sj.integrate(system, step=5e-6, n_steps=400, save=sj.Save(fields=True))
    small = sj.reduce(system, 20, run=run, friction_points="all", beta=1e5)
    again = sj.integrate(small, step=5e-6, n_steps=400)
    at = system.points.index("end")
    difference = np.abs(again.point_u[:, at] - run.point_u[:, at]).max() / run.peak[at]
    assert small.contact.w.size == system.contact.w.size
    assert difference < 2e-4
