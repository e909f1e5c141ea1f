"""Implicit integration of the paper's joints: published numbers, closed forms and invariants."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bodies import EA
from paper import pseudo_static
from stepping_systems import LapJoint, order_of, run_of, struts

import skfem_joint as sj

MESHES = Path(__file__).parents[2] / "meshes"
REFERENCE = LapJoint()
SCHEMES = [sj.generalized_alpha(rho) for rho in (0.0, 0.5, 0.8, 1.0)]


def test_structure_of_figure_18_has_the_friction_energy_of_section_7_3():
    joint = sj.Joint("joint", 50e6, 0.7, beta=1e7, normal_force="equal")
    structure = struts(sj.load_meshes([MESHES / "structure.msh"]), [joint])
    system = structure.system([sj.Load("free_end", sj.Harmonic(87.5e3, 500.0))])
    run = sj.integrate(system, cycles=12, steps_per_cycle=200)
    assert run.cycles.friction[-1] == pytest.approx(3.09, abs=0.005)


@pytest.mark.parametrize("kind", ["equal", "consistent"])
def test_slow_coulomb_joint_has_the_pseudo_static_loop(kind):
    joint = LapJoint(beta=np.inf, frequency=1.0, normal_force=kind)
    run = sj.integrate(joint.system, cycles=2, steps_per_cycle=400)
    loop = pseudo_static.loop_energy(joint.force, EA, joint.tau)
    assert run.cycles.input[-1, 0] == pytest.approx(loop, rel=5e-3)
    assert run.cycles.friction[-1] == pytest.approx(loop, rel=5e-3)
    peak = pseudo_static.peak_displacement(joint.force, EA, joint.tau)
    # One element in a hundred is what the paper's equal forces are off.
    assert run.cycles.peak[-1, 0] == pytest.approx(peak, rel=1.2e-2 if kind == "equal" else 1e-3)


def test_arctan_tends_to_coulomb_as_beta_grows():
    betas = 10.0 ** np.arange(3, 12)
    coulomb, *runs = (run_of(replace(REFERENCE, beta=b).system, 300) for b in (np.inf, *betas))
    errors = [np.abs(run.point_u - coulomb.point_u).max() / coulomb.peak[0] for run in runs]
    assert np.all(np.diff(errors) < 0.0)
    # The distance of the laws themselves falls with the root of 1 / beta.
    assert order_of(errors, 1.0 / betas) > 0.5
    assert errors[-1] < 1e-6


@pytest.mark.parametrize("scheme", SCHEMES)
def test_energy_balance_closes_from_a_moving_start(scheme):
    system = LapJoint(elements=12).system
    rng = np.random.default_rng(0)
    start = (1e-5 * rng.normal(size=12), rng.normal(size=12))
    for model in (
        system,
        system.project(np.eye(12)),
        system.with_contact(given=0 * system.contact.w),
    ):
        run = run_of(model, 100, scheme=scheme, initial=start)
        assert run.energy_residual < 1e-10
        assert run.stored_energy[0] == pytest.approx(system.stored_energy(*start), rel=1e-12)


def test_pushing_is_pulling_with_the_sign_changed():
    pull, push = (run_of(replace(REFERENCE, force=sign * 63e3).system, 300) for sign in (1.0, -1.0))
    np.testing.assert_array_equal(push.point_u, -pull.point_u)
    np.testing.assert_array_equal(push.friction_work, pull.friction_work)


@pytest.mark.parametrize("basis", ["unit", "orthogonal", "scaled", "gaussian"])
def test_a_full_rank_basis_is_the_full_model(basis):
    system = LapJoint(elements=50).system
    gaussian = np.random.default_rng(0).normal(size=(system.n, system.n))
    V = {
        "unit": np.eye(system.n),
        "orthogonal": np.linalg.qr(gaussian)[0],
        "scaled": np.linalg.qr(gaussian)[0] * np.geomspace(1e-3, 1e3, system.n),
        "gaussian": gaussian,
    }[basis]
    full = run_of(system, 200, cycle_steps=100)
    reduced = run_of(system.project(V), 200, cycle_steps=100)
    np.testing.assert_allclose(reduced.point_u, full.point_u, rtol=0.0, atol=1e-8 * full.peak[0])
    np.testing.assert_allclose(reduced.cycles.friction, full.cycles.friction, rtol=1e-7)
    np.testing.assert_allclose(reduced.friction_work, full.friction_work, rtol=1e-5, atol=1e-9)
    np.testing.assert_allclose(V @ reduced.final[0], full.final[0], atol=1e-8 * full.peak[0])


def test_points_without_pressure_need_no_law_in_a_reduced_system():
    # A joint without friction may be Coulomb: it is never evaluated.
    system = LapJoint(elements=10, beta=1e3).system
    half = np.arange(10) < 5
    mixed = system.with_contact(
        given=np.where(half, 0.0, system.contact.w),
        beta=np.where(half, np.inf, system.contact.beta),
    )
    full, reduced = run_of(mixed, 50), run_of(mixed.project(np.eye(10)), 50)
    np.testing.assert_allclose(reduced.point_u, full.point_u, atol=1e-9 * full.peak[0])


def test_coulomb_in_a_reduced_system_is_refused_with_advice():
    system = LapJoint(elements=10, beta=np.inf).system.project(np.eye(10)[:, :3])
    with pytest.raises(sj.InputError, match="with_beta"):
        run_of(system, 1)
    assert run_of(system.with_beta(1e3), 1).counters.steps == 1


@pytest.mark.parametrize(("held", "less"), [([], 0.95), (["left"], 0.9)])
@pytest.mark.parametrize("model", ["full", "condensed", "reduced"])
def test_every_model_says_that_a_joint_slips_as_a_whole_above_its_friction_limit(model, held, less):
    """A slow force on a plate that is pressed on a base, held by friction alone or at an end."""
    sides = {"left": "left", "tip": "right"}
    mesh = sj.build_plate([("foot", 0.1, 8), ("arm", 0.08, 6)], 0.04, 3, boundaries=sides)
    joint = sj.Joint("foot", pressure=8e6, friction=0.4)
    steel = sj.Material(E=210e9, density=7800.0, poisson=0.3)
    structure = sj.Structure(mesh, steel, thickness=0.01, fixed=held, joints=[joint])
    for share, gross in ((less, False), (1.05, True)):
        force = sj.Harmonic(share * 0.4 * 8e6 * 0.1 * 0.04, 50.0)
        full = structure.system(loads=[sj.Load("tip", force, direction=(1.0, 0.0))])
        small = {"full": lambda s: s, "condensed": sj.condense, "reduced": sj.reduce}[model](full)
        notes = sj.integrate(small, cycles=2, steps_per_cycle=100).notes
        assert gross == any("'foot' slips: gross slip" in note for note in notes)
