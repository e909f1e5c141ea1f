"""Modes under forces that are straight between steps, against the exact solution."""

import numpy as np
import pytest

from skfem_joint.system.modal_response import modal_response


@pytest.mark.parametrize("step", [0.01, 0.3])
def test_a_rising_force_is_followed_exactly_with_any_step(step):
    """Without damping f = t gives x = (t - sin(w t) / w) / w^2, and x'' = sin(w t) / w."""
    omega, t = np.array([1.0, 7.0]), step * np.arange(100)
    w, force = omega[:, np.newaxis], np.tile(t, (2, 1))
    x = modal_response(omega, np.zeros(2), force, step)
    np.testing.assert_allclose(x, (t - np.sin(w * t) / w) / w**2, atol=1e-9)
    a = modal_response(omega, np.zeros(2), force, step, "acceleration")
    np.testing.assert_allclose(a, np.sin(w * t) / w, atol=1e-9)


def test_a_damped_mode_obeys_its_equation_of_motion_and_comes_to_rest_at_the_static_response():
    omega, damping, step = np.array([5.0]), np.array([1.0]), 1e-3
    force = np.minimum(step * np.arange(30_000.0), 1.0)[np.newaxis]
    x = modal_response(omega, damping, force, step)[0]
    a = modal_response(omega, damping, force, step, "acceleration")[0]
    v = np.gradient(x, step)
    inside = slice(2, 900)  # before the kink of the force
    np.testing.assert_allclose((a + v + 25.0 * x)[inside], force[0, inside], atol=1e-6)
    assert x[-1] == pytest.approx(1.0 / 25.0, rel=1e-5)
