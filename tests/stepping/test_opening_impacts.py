"""Impacts: energy that contact that opens leaves, the force at a wall, bodies thrown on a base."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import skfem
from benchmarks.contact import BAR, PASSAGE, WALL_FORCE, hit
from scipy import optimize, sparse

import skfem_joint as sj
from skfem_joint.mesh import named


@pytest.mark.parametrize("rho", [1.0, 0.8])
@pytest.mark.parametrize("elements", [25, 100])
def test_bar_of_lumped_mass_hits_a_wall_as_waves_say(elements, rho):
    run, energy = hit(elements, rho, lumped=True)
    assert energy.max() < 1.0 + 1e-12
    if rho == 1.0:  # else what a scheme dissipates is not monotone in this energy
        assert np.all(np.diff(energy) < 1e-12)
        # The last mass stops at once: half of its energy is lost, a share that falls with the mesh.
        assert run.impact_work / run.stored_energy[0] == pytest.approx(0.5 / elements, rel=0.05)
        assert 1.0 - energy[-1] == pytest.approx(0.5 / elements, rel=0.05)
    force, t = run.normal_force[:, 0] / WALL_FORCE, run.field_times / PASSAGE
    assert force.min() >= 0.0
    assert run.energy_residual < 1e-10
    assert np.all(run.u[:, -1] <= BAR["speed"] * PASSAGE / 400)
    if elements == 100:
        assert t[np.flatnonzero(force)[-1]] == pytest.approx(2.0, abs=0.02)
        during = (t > 0.2) & (t < 1.8)
        np.testing.assert_allclose(force[during], 1.0, atol=0.005)
        assert np.all(force[t > 2.1] == 0.0)
        # momentum: the impulse of the wall turns the bar around
        mass = BAR["density"] * BAR["area"] * BAR["length"]
        assert force.sum() * WALL_FORCE * PASSAGE / 400 == pytest.approx(
            2.0 * mass * BAR["speed"], rel=0.01
        )


def test_bar_of_consistent_mass_keeps_the_energy_but_its_force_oscillates():
    # The oscillation is the dispersion of its own elements, not of the contact: it vanishes with
    # lumped mass, and nearly so at steps as long as a wave takes through an element.
    run, energy = hit(100, 1.0, lumped=False)
    assert np.all(np.diff(energy) < 1e-12)
    assert energy[-1] > 0.99
    force, t = run.normal_force[:, 0] / WALL_FORCE, run.field_times / PASSAGE
    assert t[np.flatnonzero(force)[-1]] == pytest.approx(2.0, abs=0.02)
    during = (t > 0.2) & (t < 1.8)
    assert 0.1 < np.abs(force[during] - 1.0).max() < 0.5
    assert force[during].mean() == pytest.approx(1.0, abs=0.01)


def _thrown(rng, order):
    """Random small plate with friction on a base, thrown on it; unloaded."""
    mesh = skfem.MeshQuad.init_tensor(np.linspace(0.0, 0.08, 5), np.linspace(0.0, 0.04, 3))
    mesh = mesh.with_boundaries({"base": lambda x: x[1] == 0.0, "side": lambda x: x[0] == 0.0})
    plate = sj.Structure(
        named(mesh, order=order),
        sj.Material(E=1e9, density=2000.0, poisson=0.3),
        thickness=0.01,
        free=True,
        mass=rng.choice(["lumped", "consistent"]) if order == 1 else "consistent",
        joints=[
            sj.Joint(
                "base", 0.0, float(rng.uniform(0.0, 1.2)), contact="unilateral",
                gap=float(rng.choice([0.0, 1e-5])), beta=float(rng.choice([np.inf, 30.0])),
            )
        ],
    )  # fmt: skip
    x, y = plate.nodes.T - np.array([[0.04], [0.02]])
    spin = rng.uniform(-10.0, 10.0)
    return plate, np.stack([rng.uniform(-1.0, 1.0) - spin * y, -1.0 + spin * x], axis=1)


MORE = [pytest.param(seed, marks=pytest.mark.slow) for seed in range(4, 30)]


@pytest.mark.parametrize("seed", [*range(4), *MORE])
def test_normal_forces_of_random_impacts_never_do_work(seed):
    rng = np.random.default_rng(seed)
    plate, v = _thrown(rng, order=1 + seed % 2)
    system = plate.system([])
    T = system.expand(np.eye(system.n)).reshape(system.n, -1).T
    start = np.zeros(system.n), np.linalg.lstsq(T, v.ravel())[0]
    run = sj.integrate(
        system, step=float(rng.choice([2e-6, 1e-5])), n_steps=200, initial=start,
        scheme=sj.generalized_alpha(float(rng.choice([1.0, 0.8, 0.0]))), save=sj.Save(fields=True),
    )  # fmt: skip
    contact = system.contact.normal
    assert (run.normal_force > 0.0).any()
    assert run.normal_force.min() >= 0.0
    energy = np.array([system.stored_energy(u, v) for u, v in zip(run.u, run.v, strict=True)])
    for k, (before, after) in enumerate(pairwise(run.u)):
        work = -run.normal_force[k + 1] @ (contact.N @ (after - before))
        assert work < 1e-12 * energy[0]
    assert energy.max() < energy[0] * (1.0 + 1e-10)
    assert run.energy_residual < 1e-9
    assert -contact.gaps(run.u).min() < 1e-4


def _point(friction, speed, *, gap=1e-4, pressed=0.0, loads=(), **law):
    """Mass of 1 kg beside a rigid wall that it slides along: unknowns along, towards the wall."""
    contact = sj.NormalPart(
        N=sparse.csr_array([[0.0, 1.0]]), gap=np.array([gap]), force=np.array([pressed]),
        stiffness=np.array([np.inf]), area=np.ones(1),
    )  # fmt: skip
    one, zero = sparse.csr_array(np.eye(2)), sparse.csr_array((2, 2))
    rubs = sj.Contact(
        sparse.csr_array([[1.0, 0.0]]), [0.0], law.get("beta", np.inf), normal=contact,
        stiffness=np.array([law.get("spring", np.inf)]), gain=sparse.csr_array([[friction]]),
    )  # fmt: skip
    points = "along", "across"
    system = sj.System(one, zero, zero, rubs, loads=loads, P=one, points=points)
    return system, (np.zeros(2), np.array([speed, 1.0 if gap else 0.0]))


def _after_impact(step, rho, *point, **law):
    system, start = _point(*point, **law)
    return sj.integrate(
        system, step=step, n_steps=int(3e-4 / step), initial=start, scheme=sj.generalized_alpha(rho)
    )


@pytest.mark.parametrize("rho", [1.0, 0.5])
@pytest.mark.parametrize("step", [3.1e-5, 1e-5, 1e-6])
@pytest.mark.parametrize(("friction", "speed"), [(0.3, 1.0), (0.3, 0.1), (2.0, 1.0)])
def test_an_oblique_impact_takes_the_share_of_momentum_that_coulomb_says(
    friction, speed, step, rho
):
    """Impulses 1 across, friction along: what is left is max(0, speed - friction)."""
    run = _after_impact(step, rho, friction, speed)
    left = max(0.0, speed - friction)
    assert run.final[1] == pytest.approx([left, 0.0], abs=1e-12)
    if rho == 1.0:  # schemes that dissipate take a part of the energy as their own
        assert run.friction_work.sum() == pytest.approx(0.5 * (speed**2 - left**2), rel=1e-12)
        assert run.impact_work == pytest.approx(0.5, rel=1e-12)
    assert run.energy_residual < 1e-12


@pytest.mark.parametrize("rho", [1.0, 0.5])
def test_the_arctangent_law_acts_in_an_impact_at_the_velocity_after_it(rho):
    for speed, beta in ((1.0, 2.0), (0.1, 20.0)):

        def lost(v, speed=speed, beta=beta):
            return v - speed + 0.3 * 2.0 / np.pi * np.arctan(beta * v)

        for step in (3.1e-5, 3.7e-6):
            run = _after_impact(step, rho, 0.3, speed, beta=beta)
            assert run.final[1][0] == pytest.approx(optimize.brentq(lost, 0.0, speed), abs=1e-9)


def test_a_spring_in_series_takes_up_no_impulse_unless_it_is_stiffer_than_steps_can_follow():
    stiff = _after_impact(1e-5, 1.0, 0.3, 1.0, spring=1e12)
    assert stiff.final[1][0] == pytest.approx(0.7, abs=1e-6)
    lost = []
    for step in (4e-6, 2e-6, 1e-6):
        run = _after_impact(step, 1.0, 0.3, 1.0, spring=1e8)
        lost.append(1.0 - run.final[1][0])
        assert run.energy_residual < 1e-11
    np.testing.assert_allclose(np.divide(lost[:-1], lost[1:]), 4.0, rtol=0.01)


@pytest.mark.parametrize("rho", [1.0, 0.5])
def test_friction_under_a_smooth_normal_force_is_of_second_order(rho):
    """Mass that slides under 100 - 60 cos(w t) N: its velocity in closed form."""
    friction, w, end = 0.3, 200.0, 0.02
    press = sj.AppliedLoad(np.array([0.0, 1.0]), sj.Harmonic(-60.0, w / (2.0 * np.pi), 0.5 * np.pi))
    system, start = _point(friction, 5.0, gap=0.0, pressed=100.0, loads=[press])
    known = 5.0 - friction * (100.0 * end - 60.0 * np.sin(w * end) / w)
    errors = []
    for n in (200, 400, 800):
        run = sj.integrate(
            system, step=end / n, n_steps=n, initial=start, scheme=sj.generalized_alpha(rho)
        )
        errors.append(abs(run.final[1][0] - known))
    np.testing.assert_allclose(np.log2(np.divide(errors[:-1], errors[1:])), 2.0, atol=0.1)


def test_energy_that_steps_add_where_they_cannot_follow_elastic_contact_is_said(caplog):
    """A mass of 1 kg meets a spring of 1e10 N/m: they touch for 31 us."""
    said = {}
    for step in (1e-5, 2.5e-7):
        system, start = _point(0.3, 1.0)
        elastic = replace(system.contact.normal, stiffness=np.array([1e10]))
        caplog.clear()
        run = sj.integrate(
            system.with_contact(normal=elastic), step=step, n_steps=int(3e-4 / step), initial=start
        )
        said[step] = run.notes
        warned = [record.message for record in caplog.records if record.levelname == "WARNING"]
        assert tuple(warned) == run.notes
    assert "by its time steps" in said[1e-5][0]
    assert said[2.5e-7] == ()
    assert run.final[1] == pytest.approx([0.4, -1.0], abs=2e-3)
