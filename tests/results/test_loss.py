"""Loss factors and energies of cycles against closed forms, and the parts of joints and bolts."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from bodies import pressed, structure
from clamped_plates import BOLTS, bolted, lapped, loads
from scipy import sparse
from stepping_systems import FIELDS, STEPPERS, arm, of_stepper, oscillator

import skfem_joint as sj

#: Stiffness in parallel, of the elastic sliders (N/m), and their friction limits (N).
K0, SPRINGS, LIMITS = 5e5, np.array([3e5, 2e5, 4e5]), np.array([1.0, 3.0, 15.0])
MASS = 2.0


def slider_system(load: Any = None, C: float = 0.0) -> sj.System:
    """Mass on a spring beside elastic sliders, whose loops are known."""
    sliders = [
        sj.point_friction([1.0], limit, stiffness=spring)
        for limit, spring in zip(LIMITS.tolist(), SPRINGS.tolist(), strict=True)
    ]
    loads = {} if load is None else {"mass": ([1.0], load)}
    return sj.System.from_matrices(
        [[MASS]],
        [[K0]],
        C=[[C]],
        contact=sum(sliders[1:], start=sliders[0]),
        loads=loads,
        points={"mass": [1.0]},
    )


def slider_forces(x: Any) -> np.ndarray:
    """Force at the first slip, of each slider, N."""
    return np.minimum(np.multiply.outer(x, SPRINGS), LIMITS)


def slider_losses(x: Any) -> np.ndarray:
    """Energy that each slider loses in a cycle between the slips +-x, J."""
    slid = np.maximum(np.expand_dims(x, -1) - LIMITS / SPRINGS, 0.0)
    return np.asarray(4.0 * LIMITS * slid)


def slider_strain(x: Any) -> np.ndarray:
    """Strain energy at the slip x, J."""
    springs = slider_forces(x) ** 2 / (2.0 * SPRINGS)
    return np.asarray(0.5 * K0 * np.asarray(x) ** 2 + springs.sum(axis=-1))


def test_a_linear_oscillator_has_twice_its_damping_ratio_times_its_frequency_ratio():
    ratio = 1.7
    system = oscillator(sj.Harmonic(3.0, ratio), frequency=1.0, damping_ratio=0.02)
    run = sj.integrate(system, until="steady", steps_per_cycle=5000, save=sj.Save(points=False))
    found = sj.losses(run)
    assert found.loss_factor == pytest.approx(2.0 * 0.02 * ratio, rel=2e-6)
    assert found.viscous_ratio == 0.5 * found.loss_factor
    assert found.quality == 1.0 / found.loss_factor
    assert found.friction == 0.0
    assert found.impacts is None
    assert found.by_joint.shape == (0,)


def test_slow_cycles_of_elastic_sliders_have_the_energies_of_their_loops():
    """Of two that slide and one that does not."""
    slip = 3e-5
    force = K0 * slip + slider_forces(slip).sum()
    system = slider_system(sj.Harmonic(force, 1.0))
    run = sj.quasi_static(system, cycles=2, steps_per_cycle=4000)
    found, lost, strain = sj.losses(run), slider_losses(slip), slider_strain(slip)
    # A step in which a slider begins to slip has the mean of its force, which errs by its square.
    np.testing.assert_allclose(run.cycles.by_point, lost, rtol=1e-6, atol=1e-15)
    assert found.by_joint.sum() == found.friction == pytest.approx(lost.sum(), rel=1e-6)
    assert found.strain == pytest.approx(strain, rel=1e-9)
    assert found.loss_factor == pytest.approx(lost.sum() / (2.0 * np.pi * strain), rel=1e-6)


def test_a_backbone_of_elastic_sliders_has_the_energies_of_their_loops():
    slip = np.array([4e-6, 1e-5, 3e-5])
    force = K0 * slip + slider_forces(slip).sum(axis=-1)
    (curve,) = sj.backbone(slider_system(C=3.0), levels=force / np.sqrt(MASS))
    found = curve.losses
    np.testing.assert_allclose(curve.displacement[:, 0], slip, rtol=1e-9)
    lost = slider_losses(slip)
    np.testing.assert_allclose(curve.friction_work, lost, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(found.by_joint[:, 0], lost.sum(axis=1), rtol=1e-9)
    np.testing.assert_allclose(found.strain, slider_strain(slip), rtol=1e-9)
    omega = 2.0 * np.pi * curve.frequency
    np.testing.assert_allclose(found.viscous, np.pi * 3.0 * omega * slip**2, rtol=1e-9)
    np.testing.assert_allclose(
        found.loss_factor, (found.friction + found.viscous) / (2.0 * np.pi * found.strain)
    )


def test_an_iwan_model_has_the_loss_factor_of_segalmans_power_law():
    F_S, K_T, chi, beta = 1000.0, 1e7, -0.4, 0.3
    contact = sj.iwan([1.0], F_S, K_T, chi, beta, sliders=400)
    system = sj.System.from_matrices([[1.0]], [[K0]], contact=contact, points={"mass": [1.0]})
    most = F_S * (1.0 + beta) / (K_T * (beta + (chi + 1.0) / (chi + 2.0)))
    slip = most * np.array([0.3, 0.6, 0.9])
    R = F_S * (chi + 1.0) / (most ** (chi + 2.0) * (beta + (chi + 1.0) / (chi + 2.0)))
    force = K_T * slip - R * slip ** (chi + 2.0) / ((chi + 1.0) * (chi + 2.0))
    lost = 4.0 * R * slip ** (chi + 3.0) / ((chi + 2.0) * (chi + 3.0))
    # Half of k x^2 of the sliders that stick, R phi^chi dphi of stiffness each, beyond x, and half
    # of k phi^2 of those that slip.
    stored = R * slip ** (chi + 3.0) / (2.0 * (chi + 3.0)) + 0.5 * slip**2 * (
        K_T - R * slip ** (chi + 1.0) / (chi + 1.0)
    )
    (curve,) = sj.backbone(system, levels=K0 * slip + force)
    strain = 0.5 * K0 * slip**2 + stored
    np.testing.assert_allclose(curve.losses.friction, lost, rtol=5e-5)
    np.testing.assert_allclose(curve.losses.strain, strain, rtol=5e-5)


def test_on_a_path_that_doubles_the_strain_energy_is_short_by_an_eighth_of_the_loop():
    """A bar under uniform pressure: eta = 2 zeta / (1 - pi zeta / 2), by the balance of energy."""
    (curve,) = sj.backbone(arm(), levels=6, up_to=0.8)
    found, whole = curve.losses, 0.5 * curve.level * curve.amplitude
    np.testing.assert_allclose(found.strain, whole - found.friction / 8.0, rtol=1e-6)
    zeta = curve.friction_damping
    np.testing.assert_allclose(
        found.loss_factor, 2.0 * zeta / (1.0 - 0.5 * np.pi * zeta), rtol=1e-6
    )


@pytest.mark.parametrize("kind", STEPPERS)
def test_the_largest_strain_energy_of_a_cycle_is_that_of_its_states(kind):
    system = of_stepper(kind)
    run = sj.integrate(system, step=1e-5, n_steps=80, save=FIELDS, cycle_steps=40)
    strain = np.array([system.strain_energy(u) for u in run.u])
    expected = [strain[:41].max(), strain[41:].max()]
    np.testing.assert_allclose(run.cycles.strain, expected, rtol=1e-9)
    work = run.friction_work_rows
    np.testing.assert_allclose(run.cycles.by_point, work[-1] - work[40], atol=1e-12 * work.max())
    assert sj.losses(run).friction == pytest.approx(run.cycles.by_joint[-1].sum())


@pytest.mark.parametrize("model", ["full", "condensed", "reduced"])
@pytest.mark.parametrize("stiffness", [np.inf, 3e12])
def test_that_of_contact_that_opens_and_of_springs_is_in_it(model, stiffness):
    joint = {"contact": "unilateral", "tangential_stiffness": stiffness}
    system = bolted(joint=joint, stiffness_damping=1e-6).system(
        [replace(load, amplitude=sj.Harmonic(2e3, 300.0)) for load in loads("right", 2)]
    )
    system = {"full": lambda s: s, "condensed": sj.condense, "reduced": sj.reduce}[model](system)
    run = sj.integrate(system, cycles=2, steps_per_cycle=40, save=FIELDS)
    strain = np.array(
        [system.strain_energy(*x) for x in zip(run.u, run.sigma, run.limits, strict=True)]
    )
    expected = [strain[:41].max(), strain[41:].max()]
    np.testing.assert_allclose(run.cycles.strain, expected, rtol=1e-6)
    assert run.cycles.impact.sum() == pytest.approx(run.impact_work, abs=1e-12)
    assert sj.losses(run).impacts == pytest.approx(run.cycles.impact[-1])


def test_marching_has_the_losses_of_slow_cycles_at_its_amplitude():
    """Of a single unknown, whose shape is one: friction does not depend on how fast it slips."""
    amplitude, viscous = 8.0, 4.0
    (stuck,) = sj.backbone(slider_system(C=viscous), levels=[1.0])
    system = slider_system(sj.Harmonic(amplitude, 0.93 * stuck.stuck_frequency), C=viscous)
    run = sj.integrate(system, until="steady", steps_per_cycle=1000)
    found, slip = sj.losses(run), run.amplitude_of("mass")
    (curve,) = sj.backbone(
        slider_system(C=viscous),
        levels=[(K0 * slip + slider_forces(slip).sum()) / np.sqrt(MASS)],
    )
    assert curve.state == ("partial",)
    assert found.friction == pytest.approx(curve.losses.friction[0], rel=1e-4)
    assert found.strain == pytest.approx(curve.losses.strain[0], rel=1e-4)
    np.testing.assert_allclose(run.cycles.by_point, curve.friction_work[0], rtol=1e-4, atol=1e-12)
    frequency = 0.93 * stuck.stuck_frequency / curve.frequency[0]
    # But for what harmonics of friction add to the velocity.
    assert found.viscous == pytest.approx(frequency * curve.losses.viscous[0], rel=5e-3)


def test_a_run_without_cycles_has_no_loss_factor():
    run = sj.integrate(oscillator(sj.HalfSine(1.0, 0.1)), step=0.01, n_steps=10)
    with pytest.raises(sj.InputError, match="no complete cycle"):
        sj.losses(run)


def rings() -> dict[str, sj.Bolts]:
    """Bolts of a plate, each as the only one of its joint."""
    bolts = {
        name: sj.Bolt((x, 0.025), force, 0.009, 0.0055)
        for name, x, force in (("far", 0.05, 30e3), ("near", 0.15, 15e3))
    }
    return {name: sj.Bolts((bolt,), reach=0.01) for name, bolt in bolts.items()}


def plate(joints: list[sj.Joint], parts: list[tuple[str, float, int]]) -> sj.Structure:
    return structure(sj.build_plate([*parts, ("free", 0.1, 5)], 0.05, 5), joints,
                     stiffness_damping=1e-5)  # fmt: skip


@pytest.mark.parametrize("model", ["full", "condensed"])
def test_bolts_of_one_joint_are_what_a_joint_for_each_of_them_is(model):
    apart = plate(
        [pressed(on=name, pressure=ring) for name, ring in rings().items()],
        [("far", 0.1, 10), ("near", 0.1, 10)],
    )
    both = tuple(bolt for ring in rings().values() for bolt in ring.bolts)
    together = plate([pressed(pressure=sj.Bolts(both, reach=0.01))], [("joint", 0.2, 20)])
    results = []
    for one in (apart, together):
        system = one.system([sj.Load("right", sj.Harmonic(18e3, 500.0), (1.0, 0.1))])
        model_of = system if model == "full" else sj.condense(system)
        run = sj.integrate(model_of, cycles=2, steps_per_cycle=60)
        places = sj.places_of(one, system)
        results.append((places, places.of_run(run, run.slider_peak, 2e-3)))
    (_, of_joints), (places, of_bolts) = results
    assert of_joints.names == ("far", "near", "far_bolt_1", "near_bolt_1")
    assert of_bolts.names == ("joint", "joint_bolt_1", "joint_bolt_2")
    assert places.owner == (0, 0, 0)
    for name in ("loss_share", "slipping_share", "largest_slip", "normal_force", "normal_share"):
        ours, theirs = getattr(of_bolts, name), getattr(of_joints, name)
        np.testing.assert_allclose(ours[1:], theirs[:2], rtol=1e-6, err_msg=name)
        np.testing.assert_allclose(ours[1:], theirs[2:], rtol=1e-6, err_msg=name)
    assert of_bolts.loss_share[0] == pytest.approx(1.0)
    assert of_bolts.loss_share[1:].sum() == pytest.approx(1.0)
    np.testing.assert_allclose(of_bolts.normal_force[1:], [30e3, 15e3])
    assert of_bolts.loss_share[2] > 0.9  # the near one slips, the far one all but sticks


def test_rings_that_overlap_divide_their_points_by_the_forces_on_them():
    pair = tuple(sj.Bolt((x, 0.025), 20e3, 0.02, 0.0055) for x in (0.09, 0.11))
    one = plate([pressed(pressure=sj.Bolts(pair, reach=0.01))], [("joint", 0.2, 20)])
    places = sj.places_of(one, one.system())
    share = places.share.toarray()[1:]
    np.testing.assert_allclose(share.sum(axis=0), 1.0)
    assert np.any((share > 0.2) & (share < 0.8))
    np.testing.assert_allclose(places.normal_force[1:], [20e3, 20e3], rtol=1e-9)


@pytest.mark.parametrize("contact", ["constant", "unilateral"])
@pytest.mark.parametrize("solid", [False, True])
def test_clamps_divide_a_joint_by_their_axes_whether_it_opens_or_not(solid, contact):
    one = bolted(solid, joint={"contact": contact})
    system = one.system(loads("right", one.dim))
    places = sj.places_of(one, system)
    assert places.names == ("contact", "bolt_1", "bolt_2")
    assert places.owner == (0, -1, -1)
    first, second = places.share.toarray()[1:].astype(bool)
    x = np.zeros(system.contact.w.size)
    x[one.patches[0].points] = one.nodes[one.patches[0].nodes, 0]
    # The bolts stand in the middles of their strips, at 0.04 and 0.11 m.
    np.testing.assert_array_equal(
        first[np.abs(x - 0.075) > 1e-6], (x < 0.075)[np.abs(x - 0.075) > 1e-6]
    )
    assert np.all(first ^ second)
    np.testing.assert_allclose(places.normal_force[1:], [b.force for b in BOLTS], rtol=0.15)
    assert places.normal_force[1:].sum() == pytest.approx(places.normal_force[0])


def test_which_bolt_of_a_joint_that_opens_slips():
    one = lapped(contact="unilateral")
    system = one.system([sj.Load("end", sj.Harmonic(1.0, 100.0), (0.0, 0.0, 1.0))], ["end"])
    (curve,) = sj.backbone(system, levels=4, up_to=0.9)
    places = sj.places_of(one, system)
    slid = system.contact.slid(curve.friction_work)
    found = places.of(curve.friction_work, curve.slip, system.slipping(slid))
    rubs = curve.losses.friction > 0.0
    assert rubs[-2:].all()
    np.testing.assert_allclose(found.loss_share[rubs, 1:].sum(axis=1), 1.0)
    assert np.isnan(found.loss_share[~rubs]).all()
    np.testing.assert_allclose(curve.friction_work.sum(axis=1), curve.losses.friction)
    np.testing.assert_allclose(curve.losses.joint_shares[rubs, 0], 1.0)
    assert found.slipping_share.min() >= 0.0
    assert found.slipping_share.max() <= 1.0


def test_losses_of_joints_add_up_in_steady_vibration_at_each_frequency():
    system = slider_system(sj.Harmonic(10.0, 100.0), C=5.0)
    frequencies = np.array([98.0, 100.0, 104.0])
    (curve,) = sj.response(system, frequencies, refined=False, estimated=False)
    found = curve.losses
    np.testing.assert_allclose(found.by_joint.sum(axis=1), found.friction)
    np.testing.assert_allclose(found.joint_shares.sum(axis=1), 1.0)
    np.testing.assert_allclose(found.lost, curve.column("input_energy"), rtol=1e-3)


def test_a_joint_whose_gap_is_open_at_rest_slips_as_its_points_do():
    """It has no limit at rest, on which its work would be a way."""
    gap = sj.point_contact([1.0, 0.0, 0.0], [0.0, 1.0, 0.0], friction=0.3, gap=1e-3, stiffness=1e6)
    contact = gap + sj.point_friction([0.0, 0.0, 1.0], 1.0, name="pressed")
    system = sj.System.from_matrices(np.eye(3), 1e4 * np.eye(3), contact=contact)
    J = system.contact.J
    names = tuple(system.contact.joints)
    places = sj.JointPlaces(names, 2, (0, 1), sparse.csr_array(J), J @ system.contact.w, system)
    slip, work = np.array([[1e-2, 5e-3]]), np.array([[1e-9, 2e-2]])
    np.testing.assert_allclose(places.of_curve(work, slip).slipping_share, 1.0)
    np.testing.assert_allclose(places.of_curve(0.0 * work, slip).slipping_share, 0.0)
