"""Impacts: energy that contact that opens leaves, the force at a wall, bodies thrown on a base."""

from itertools import pairwise

import numpy as np
import pytest
import skfem
from benchmarks.contact import BAR, PASSAGE, WALL_FORCE, hit

import skfem_joint as sj
from skfem_joint.mesh import named
from skfem_joint.stepping.schemes import generalized_alpha


@pytest.mark.parametrize("rho", [1.0, 0.8])
def test_bar_of_lumped_mass_hits_a_wall_as_waves_say(rho):
    run, energy = hit(100, rho, lumped=True)
    assert energy.max() < 1.0 + 1e-12
    if rho == 1.0:  # else what a scheme dissipates is not monotone in this energy
        assert np.all(np.diff(energy) < 1e-12)
    assert 0.99 < energy[-1] < 1.0
    force, t = run.normal_force[:, 0] / WALL_FORCE, run.field_times / PASSAGE
    assert force.min() >= 0.0
    assert t[np.flatnonzero(force)[-1]] == pytest.approx(2.0, abs=0.02)
    during = (t > 0.2) & (t < 1.8)
    np.testing.assert_allclose(force[during], 1.0, atol=0.005)
    assert np.all(force[t > 2.1] == 0.0)
    # momentum: the impulse of the wall turns the bar around
    mass = BAR["density"] * BAR["area"] * BAR["length"]
    assert force.sum() * WALL_FORCE * PASSAGE / 400 == pytest.approx(
        2.0 * mass * BAR["speed"], rel=0.01
    )
    assert run.energy_residual < 1e-10
    assert np.all(run.u[:, -1] <= BAR["speed"] * PASSAGE / 400)


def test_energy_that_an_impact_takes_is_that_of_the_last_mass():
    # It stops at once: half of its kinetic energy is lost, a share that falls with the mesh.
    for elements in (25, 50):
        run, energy = hit(elements, 1.0, lumped=True, steps=200)
        lost = 0.5 / elements
        assert run.impact_work / run.stored_energy[0] == pytest.approx(lost, rel=0.05)
        assert 1.0 - energy[-1] == pytest.approx(lost, rel=0.05)


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
        scheme=generalized_alpha(float(rng.choice([1.0, 0.8, 0.0]))), save=sj.Save(fields=True),
    )  # fmt: skip
    contact = system.opening
    assert (run.normal_force > 0.0).any()
    assert run.normal_force.min() >= 0.0
    energy = np.array([system.stored_energy(u, v) for u, v in zip(run.u, run.v, strict=True)])
    for k, (before, after) in enumerate(pairwise(run.u)):
        work = -run.normal_force[k + 1] @ (contact.N @ (after - before))
        assert work < 1e-12 * energy[0]
    assert energy.max() < energy[0] * (1.0 + 1e-10)
    assert run.energy_residual < 1e-9
    assert -contact.gaps(run.u).min() < 1e-4
