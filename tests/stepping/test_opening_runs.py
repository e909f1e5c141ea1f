"""Runs with contact that opens: taken up again, interrupted, saved; stuck and closed systems."""

from dataclasses import replace

import numpy as np
import pytest
from opening_blocks import block, loads, opening_system
from stepping_systems import differing

import skfem_joint as sj
from skfem_joint.ground.errors import InputError
from skfem_joint.stepping.checkpoint import Checkpoint

TIMING = {
    "cycles": 4,
    "steps_per_cycle": 30,
    "save": sj.Save(every=3, fields=True, fields_every=7, slips=True),
}


class KilledError(Exception):
    """Ends a run as a kill would."""


SPRUNG = {"tangential_stiffness": 2e13}


@pytest.mark.parametrize(("model", "joint"), [("full", {}), ("condensed", {}), ("full", SPRUNG)])
def test_a_run_taken_up_again_is_the_same_to_the_bit(model, joint, tmp_path):
    system = block(**joint).system(loads(up=230e3))
    system = system if model == "full" else sj.condense(system)
    whole = sj.integrate(system, **TIMING)
    assert whole.opened.any()

    def kill(done, total):
        if done >= 70:
            raise KilledError

    path = tmp_path / "run.npz"
    with pytest.raises(KilledError):
        sj.integrate(system, **TIMING, progress=kill, checkpoint=Checkpoint(path, "a", every=20))
    starts = []
    run = sj.integrate(
        system, **TIMING, progress=lambda done, total: starts.append(done),
        checkpoint=Checkpoint(path, "a", resume=True),
    )  # fmt: skip
    assert min(starts) > 60
    assert not differing(run, whole)
    for name in ("normal_force", "normal_force_peak", "normal_force_least", "limits"):
        assert np.array_equal(getattr(run, name), getattr(whole, name))
    assert run.impact_work == whole.impact_work


@pytest.mark.parametrize("run", [sj.integrate, sj.quasi_static])
def test_an_interrupted_run_has_its_first_steps(run):
    def stop(done, total):
        if done > 1:
            raise KeyboardInterrupt

    system = opening_system()
    whole = run(system, cycles=2, steps_per_cycle=60)
    part = run(system, cycles=2, steps_per_cycle=60, progress=stop)
    assert part.interrupted
    rows = part.times.size
    assert 1 < rows <= whole.times.size
    assert np.array_equal(part.point_u, whole.point_u[:rows])
    assert part.energy_residual < 1e-9


@pytest.mark.parametrize("order", [1, 2])
def test_a_loaded_system_integrates_to_the_same_bits(order, tmp_path):
    system = opening_system(order=order)
    for model in (system, sj.condense(system)):
        again = sj.load(sj.save(model, tmp_path / "model.npz"))
        assert again.contact.opens
        for name in ("gap", "force", "stiffness", "area"):
            assert np.array_equal(
                getattr(again.contact.normal, name), getattr(model.contact.normal, name)
            )
        a, b = (sj.integrate(s, cycles=1, steps_per_cycle=60) for s in (model, again))
        assert np.array_equal(a.point_u, b.point_u)
        assert a.impact_work == b.impact_work


@pytest.mark.parametrize(
    ("name", "change", "problem"),
    [
        ("area", lambda x: -x, "area: must be finite and positive"),
        ("force", lambda x: x[:-1], "normal: force: found shape"),
        ("gap", lambda x: x + np.nan, "normal: gap: must be"),
        ("stiffness", lambda x: 1.0 + 0.0 * x[:, None], "normal: stiffness: found shape"),
        ("gain", lambda x: -x, "gain: must be finite and not negative"),
    ],
)
def test_damaged_contact_is_refused_in_files_and_by_the_system(name, change, problem, tmp_path):
    model = sj.condense(opening_system())
    path = sj.save(model, tmp_path / "model.npz")
    normal, of_gain = model.contact.normal, name == "gain"
    value = getattr(model.contact if of_gain else normal, name)
    value = change(value if of_gain else np.where(np.isinf(value), 1.0, value))
    changes = {name: value} if of_gain else {"normal": replace(normal, **{name: value})}
    with pytest.raises(InputError, match=problem):
        model.with_contact(**changes)
    member = "contact/gain/data" if of_gain else f"contact/normal/{name}"
    with np.load(path) as file:
        arrays = dict(file)
    arrays[member] = value.data if name == "gain" else value
    np.savez(path, **arrays)
    with pytest.raises(InputError, match="not what was saved"):
        sj.load(path)
    del arrays[member]
    np.savez(path, **arrays)
    with pytest.raises(InputError, match="not what was saved"):
        sj.load(path)


@pytest.mark.parametrize("order", [1, 2])
def test_the_closed_system_is_that_of_constant_contact(order):
    """Where all of a base is pressed both have the same motions, and so the same frequencies."""
    opens = opening_system(order=order).closed()
    constant = block(order=order, contact="constant").system(loads())
    assert not opens.contact.opens
    assert opens.n == constant.n
    for joints in ("loose", "stuck"):
        a, b = (sj.natural_modes(s, 4, joints=joints).frequencies for s in (opens, constant))
        assert a == pytest.approx(b, rel=1e-9)
    assert opens.contact.w.sum() == pytest.approx(constant.contact.w.sum())


def test_natural_modes_do_not_move_what_is_pressed():
    system = opening_system()
    modes = sj.natural_modes(system, 3, joints="stuck").modes
    assert np.all(system.contact.normal.N @ modes == 0.0)
    assert np.all(system.contact.B @ modes == 0.0)
    assert np.diag(modes.T @ (system.M @ modes)) == pytest.approx(np.ones(3))


def test_damping_ratios_take_contact_as_closed():
    opens, constant = (
        sj.Structure(
            s.mesh, s.material, thickness=s.thickness, fixed_x=s.fixed_x, joints=s.joints,
            damping_ratio=0.01, mass="lumped",
        ).system(loads())
        for s in (block(), block(contact="constant"))
    )  # fmt: skip
    assert opens.notes == constant.notes


def test_slipping_shares_follow_the_present_limits():
    """All of what is pressed slips in gross slip, however little that is."""
    run = sj.integrate(opening_system(), **TIMING)
    shares = run.joint_slipping[:, 0]
    assert np.all((shares >= 0.0) & (shares <= 1.0 + 1e-12))
    assert shares.max() == pytest.approx(1.0)


def test_joints_without_pressure_at_rest_have_loops_and_slips():
    system = block(pressure=0.0, gap=1e-6).system(loads(up=-100e3, across=20e3))
    run = sj.integrate(system, cycles=1, steps_per_cycle=100, save=sj.Save(slips=True))
    assert run.normal_force_peak.max() > 0.0
    assert run.friction_work.sum() > 0.0
    assert run.joint_slip.max() > 0.0
    assert run.energy_residual < 1e-12


@pytest.mark.parametrize("across", [{}, {"normal_stiffness": 1e14}])
def test_springs_beside_contact_that_opens_are_alike_in_full_and_condensed_models(across):
    full = block(elements=5, **SPRUNG, **across).system(loads())
    condensed = sj.condense(full, 12)
    runs = [sj.quasi_static(system, cycles=2, steps_per_cycle=40) for system in (full, condensed)]
    assert runs[0].cycles.friction[-1] == pytest.approx(runs[1].cycles.friction[-1], rel=1e-6)
    assert runs[0].slider_peak == pytest.approx(
        runs[1].slider_peak @ condensed.contact.shares, rel=1e-6
    )
    hammered = block(elements=5, **SPRUNG, **across).system(loads(up=230e3))
    run = sj.integrate(hammered, cycles=2, steps_per_cycle=100)
    assert run.opened.any()
    assert run.energy_residual < 1e-9


@pytest.mark.parametrize("beta", [np.inf, 100.0])
@pytest.mark.parametrize("solve", [sj.quasi_static, sj.integrate])
def test_springs_are_alike_in_a_reduced_model_with_a_full_basis(solve, beta):
    joint = SPRUNG | {"beta": beta, "normal_stiffness": 1e14}
    full = block(elements=4, **joint).system(loads(up=190e3))
    basis = np.linalg.qr(np.random.default_rng(3).normal(size=(full.n, full.n)))[0]
    runs = [solve(s, cycles=2, steps_per_cycle=60) for s in (full, full.project(basis))]
    whole, small = runs
    assert small.normal_force_least.min() < 0.2 * small.normal_force_peak.max()
    assert small.energy_residual < 1e-8
    assert small.friction_work == pytest.approx(whole.friction_work, rel=1e-6)
    for name in ("peak", "slip_peak", "slider_peak", "normal_force_peak"):
        value = getattr(whole, name)
        assert getattr(small, name) == pytest.approx(value, abs=1e-7 * value.max()), name


def test_stiffer_springs_tend_to_the_friction_of_rigid_surfaces():
    """The difference of the work falls as the flexibility does."""
    rigid, *springs = (
        sj.quasi_static(block(**joint).system(loads()), cycles=2, steps_per_cycle=40)
        for joint in ({}, {"tangential_stiffness": 1e15}, {"tangential_stiffness": 1e16})
    )
    works = [run.cycles.friction[-1] for run in springs]
    apart = [abs(work / rigid.cycles.friction[-1] - 1.0) for work in works]
    assert apart[1] < 0.2 * apart[0] < 0.02
