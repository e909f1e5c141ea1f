"""Explicit integration as in the paper: order, stable step, agreement with the implicit scheme."""

import numpy as np
import pytest
from benchmarks.explicit import runge_kutta, stable_step
from bodies import DENSITY, E
from stepping_systems import LapJoint, dense_system, oscillator, reference_plate

import skfem_joint as sj


def test_stable_step_of_an_undamped_oscillator_is_the_textbook_s():
    system = oscillator(sj.Harmonic(1.0, 1.0), frequency=3.0, damping_ratio=0.0)
    # The region of the method holds the imaginary axis up to 2 sqrt(2).
    assert stable_step(system) == pytest.approx(2 * np.sqrt(2) / (6 * np.pi), rel=1e-6)


def test_bounds_for_large_systems_are_safe_and_near():
    """Where not all eigenvalues are computed, beside closed forms of a uniform bar."""
    n, length = 600, 0.25
    highest = 2.0 * np.sqrt(E / DENSITY) * n / length * np.cos(np.pi / 4.0 / n)  # rad/s
    damping, real_axis = 1e-5, 2.785293563
    rate = 0.5 * damping * highest**2 * (1.0 + np.sqrt(1.0 - (2.0 / damping / highest) ** 2))
    friction = LapJoint(elements=n, beta=1e7, options={"mass": "lumped"}).system
    slope = (friction.contact.w * 2.0 / np.pi * 1e7 / friction.M.diagonal()).max()
    bars = [
        LapJoint(elements=n, friction=0.0, options={"mass": "lumped", "stiffness_damping": b})
        for b in (1e-12, damping)
    ]
    for system, exact in (
        (bars[0].system, 2.0 * np.sqrt(2.0) / highest),
        (bars[1].system, real_axis / rate),
        (friction, real_axis / slope),
    ):
        assert 0.9 * exact < stable_step(system) <= exact * (1.0 + 1e-9)


@pytest.mark.parametrize("kind", ["chain", "plate", "dense"])
def test_explicit_and_implicit_schemes_agree(kind):
    system, duration, share = {
        "chain": (LapJoint(elements=10, beta=10.0).system, 4e-4, 0.9),
        "plate": (reference_plate(10.0, (4, 2)), 1e-4, 0.9),
        "dense": (dense_system(singles=4).with_contact(beta=np.full(10, 10.0)), 4.0, 0.05),
    }[kind]
    steps = int(np.ceil(duration / (share * stable_step(system))))
    save = sj.Save(fields=True)
    run = runge_kutta(system, step=duration / steps, n_steps=steps, cycle_steps=steps, save=save)
    assert run.friction_work.sum() > 0.0
    finer = sj.integrate(
        system, step=duration / steps / 8, n_steps=8 * steps, cycle_steps=8 * steps,
        save=sj.Save(every=8, fields=True),
    )  # fmt: skip
    peak = finer.peak.max()
    np.testing.assert_allclose(run.point_u, finer.point_u, rtol=0.0, atol=2e-5 * peak)
    np.testing.assert_allclose(run.u, finer.u, rtol=0.0, atol=2e-5 * np.abs(finer.u).max())
    assert run.cycles.friction == pytest.approx(finer.cycles.friction, rel=5e-4)
    assert run.input_work == pytest.approx(finer.input_work, rel=6e-4)
    assert run.energy_residual < 1e-14


def test_coulomb_has_no_stable_step():
    with pytest.raises(sj.InputError, match="no stable step"):
        stable_step(LapJoint(elements=10, beta=np.inf).system)
    stable_step(LapJoint(elements=10, beta=np.inf, friction=0.0).system)
