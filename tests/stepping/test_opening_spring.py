"""A mass on an elastic normal contact, whose motion is known in closed form."""

import numpy as np
import pytest
from scipy import sparse

import skfem_joint as sj

MASS, STIFFNESS, GAP, SPEED = 2.0, 8e4, 1e-3, 0.5
#: Angular frequency in contact, rad/s, and time from the start to the first touch, s.
OMEGA, TOUCH = np.sqrt(STIFFNESS / MASS), GAP / SPEED


def _system(loads=(), held=0.0, gap=GAP, force=0.0):
    """Mass that an elastic base stops at the gap; a spring may hold it."""
    contact = sj.NormalPart(
        sparse.csr_array(np.eye(1)), np.array([gap]), np.array([force]),
        np.array([STIFFNESS]), np.ones(1),
    )  # fmt: skip
    M, K = sparse.csr_array([[MASS]]), sparse.csr_array([[held]])
    B, none = sparse.csr_array((0, 1)), np.zeros(0)
    applied = [sj.AppliedLoad(np.ones(1), load, "mass") for load in loads]
    P = sparse.csr_array(np.eye(1))
    return sj.System(
        M, None, K, sj.Contact(B, none, none, normal=contact), loads=applied, P=P, points=("mass",)
    )


def test_mass_bounces_off_a_spring_as_a_half_sine():
    errors, end = [], 2.0 * TOUCH + np.pi / OMEGA  # there, in contact and back
    start = np.zeros(1), np.array([SPEED])
    for steps in (500, 1000):
        run = sj.integrate(
            _system(), step=end / steps, n_steps=steps, initial=start, save=sj.Save(fields=True)
        )
        t = run.field_times - TOUCH
        depth = SPEED / OMEGA
        touches = (t > 0.0) & (t < np.pi / OMEGA)
        u = np.where(touches, GAP + depth * np.sin(OMEGA * t), GAP + SPEED * t)
        back = t >= np.pi / OMEGA
        u[back] = GAP - SPEED * (t[back] - np.pi / OMEGA)
        errors.append(np.abs(run.u[:, 0] - u).max() / depth)
        force = STIFFNESS * np.maximum(run.u[:, 0] - GAP, 0.0)
        np.testing.assert_allclose(run.normal_force[:, 0], force, atol=1e-9 * force.max())
        assert run.normal_force_peak[0] == pytest.approx(STIFFNESS * depth, rel=1e-3)
    assert errors[1] < 2e-4
    assert errors[1] < 0.35 * errors[0]


@pytest.mark.parametrize("force", [0.0, 30.0])
def test_slow_force_on_a_spring_of_contact_is_shared_by_stiffness(force):
    # A holding spring and one of contact side by side: beyond the gap both carry, and contact that
    # is pressed at rest carries until its force has gone.
    held, gap = 2e4, 0.0 if force else GAP
    table = sj.Table([0.0, 1.0, 3.0], [0.0, 100.0, -200.0])
    system = _system([table], held, gap, force)
    run = sj.quasi_static(system, step=0.1, n_steps=30, save=sj.Save(fields=True))
    load, end = table(run.field_times), gap - force / STIFFNESS  # where contact ends
    touched = (load + STIFFNESS * gap) / (held + STIFFNESS)
    known = np.where(touched > end, touched, (load + force) / held)
    np.testing.assert_allclose(run.u[:, 0], known, rtol=1e-9, atol=1e-15)
    p = np.maximum(STIFFNESS * (known - end), 0.0)
    np.testing.assert_allclose(run.normal_force[:, 0], p, atol=1e-7)
    assert (p == 0.0).any()
    assert run.energy_residual < 1e-9
