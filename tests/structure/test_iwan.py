"""Segalman's four-parameter Iwan model by sliders: closed forms, the defining integral, limits."""

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from scipy.integrate import quad

import skfem_joint as sj
from skfem_joint.slow.quasi_static import QuasiStatic

F_S, K_T = 4e3, 1.5e7
CASES = [(0.0, 0.0), (-0.3, 0.1), (-0.5, 1.0), (-0.8, 0.0), (-0.95, 5.0)]


class Closed:
    """Segalman's closed forms."""

    def __init__(self, chi: float, beta: float) -> None:
        self.chi = chi
        self.phi_max = F_S * (1.0 + beta) / (K_T * (beta + (chi + 1.0) / (chi + 2.0)))
        scale = F_S / (beta + (chi + 1.0) / (chi + 2.0))
        self.R = scale * (chi + 1.0) / self.phi_max ** (chi + 2.0)
        self.S = scale * beta / self.phi_max

    def force(self, x: Any) -> Any:
        c = self.chi
        return K_T * x - self.R * x ** (c + 2.0) / ((c + 1.0) * (c + 2.0))

    def loss(self, x: Any) -> Any:
        c = self.chi
        return 4.0 * self.R * x ** (c + 3.0) / ((c + 2.0) * (c + 3.0))

    def after(self, turns: Any, x: float) -> float:
        """Force at x after reversals at ``turns``, by the integral over all sliders."""

        def stretch(phi: float) -> float:
            q, before = 0.0, 0.0
            for to in (*turns, x):
                q, before = min(max(q + to - before, -phi), phi), to
            return q

        ends = sorted({abs(a - b) / 2 for a in (*turns, x) for b in (*turns, x)} | {abs(turns[0])})
        inside = [end for end in ends if 0.0 < end < self.phi_max]
        total = self.S * stretch(self.phi_max)
        for a, b in zip([0.0, *inside], [*inside, self.phi_max], strict=True):
            weight = (self.chi, 0.0) if a == 0.0 else None  # the density is singular at zero
            if weight is None:
                part = quad(lambda p: p**self.chi * stretch(p), a, b, epsrel=1e-10)[0]
            else:
                part = quad(stretch, a, b, weight="alg", wvar=weight, epsrel=1e-10)[0]
            total += self.R * part
        return total


def forces(contact: sj.SlipRows, slip: Any) -> Any:
    """Force of a joint along a history of slip, N."""
    held = 1e12
    system = sj.System.from_matrices([[1.0]], [[held]], contact=contact)
    path = QuasiStatic(system, 1e-14)
    u = path.follow(held * np.asarray(slip)[:, None], limit_share=np.inf)[:, 0]
    return u, path.frictions.sum(axis=1)


def slow_cycles(contact: sj.SlipRows, x: Any) -> tuple[Any, Any]:
    """Force (N) at the turns of slow cycles with amplitudes x (m), and their losses (J)."""
    x = np.asarray(x)[:, np.newaxis]
    force = np.minimum(contact.stiffness * x, contact.w).sum(axis=1)
    return force, 4.0 * np.maximum(x - contact.w / contact.stiffness, 0.0) @ contact.w


@pytest.mark.parametrize(("chi", "beta"), CASES)
def test_force_and_loss_of_a_cycle_are_the_closed_forms(chi, beta):
    contact, closed = sj.iwan([1.0], F_S, K_T, chi, beta), Closed(chi, beta)
    assert contact.w.size <= 100
    assert contact.w.sum() == pytest.approx(F_S, rel=1e-12)
    assert contact.stiffness.sum() == pytest.approx(K_T, rel=1e-12)
    assert (contact.w > 0.0).all()
    assert (contact.stiffness > 0.0).all()
    x = closed.phi_max * np.linspace(0.25, 1.0, 500)
    force, loss = slow_cycles(contact, x)
    np.testing.assert_allclose(force, closed.force(x), rtol=1e-4)
    np.testing.assert_allclose(loss, closed.loss(x), rtol=1e-4)
    x = closed.phi_max * np.linspace(0.0, 0.25, 500)
    np.testing.assert_allclose(slow_cycles(contact, x)[0], closed.force(x), atol=1e-4 * F_S)


@pytest.mark.parametrize("chi", [0.0, -0.5, -0.9])
def test_at_low_amplitudes_the_loss_rises_with_the_power_three_plus_chi(chi):
    x = Closed(chi, 0.5).phi_max * np.geomspace(2e-3, 0.2, 60)
    _, loss = slow_cycles(sj.iwan([1.0], F_S, K_T, chi, 0.5, least=1e-3), x)
    slope = np.polyfit(np.log(x), np.log(loss), 1)[0]
    assert slope == pytest.approx(3.0 + chi, abs=2e-3)


def test_forces_along_a_history_are_those_of_the_integral_and_of_masing():
    chi, beta = -0.5, 0.3
    closed = Closed(chi, beta)
    turns = closed.phi_max * np.array([0.8, -0.6, 0.3])
    slip = np.concatenate([[0.0], *(np.linspace(a, b, 9)[1:] for a, b in pairwise([0.0, *turns]))])
    u, force = forces(sj.iwan([1.0], F_S, K_T, chi, beta), slip)
    for k in range(1, slip.size):
        gone = [t for t, end in zip(turns, (8, 16, 24), strict=True) if end < k] or [u[k]]
        assert force[k] == pytest.approx(closed.after(gone, u[k]), abs=1e-3 * F_S)
    top = force[8]
    masing = top - 2.0 * np.interp(0.5 * (u[8] - u[9:17]), u[:9], force[:9])
    halves = [top - 2.0 * closed.force(0.5 * (u[8] - x)) for x in u[9:17]]
    np.testing.assert_allclose(force[9:17], halves, atol=3e-4 * F_S)
    np.testing.assert_allclose(masing, halves, atol=0.02 * F_S)  # straight between nine points


def test_sliders_of_two_directions_are_isotropic():
    straight = sj.iwan([1.0], F_S, K_T, -0.5, 0.3, sliders=40)
    both = sj.iwan(np.eye(2), F_S, K_T, -0.5, 0.3, sliders=40)
    slip = 1e-3 * np.sin(np.linspace(0.0, 7.0, 30))
    _, force = forces(straight, slip)
    system = sj.System.from_matrices(np.eye(2), 1e12 * np.eye(2), contact=both)
    turned = np.outer(slip, [0.6, 0.8])
    path = QuasiStatic(system, 1e-14)
    path.follow(1e12 * turned, limit_share=np.inf)
    vector = path.frictions.reshape(30, -1, 2).sum(axis=1)
    np.testing.assert_allclose(vector, np.outer(force, [0.6, 0.8]), atol=1e-6 * F_S)


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"F_S": 0.0}, "F_S"),
        ({"K_T": -1.0}, "K_T"),
        ({"chi": -1.0}, "chi: found -1"),
        ({"chi": 0.1}, "at most 0"),
        ({"beta": -0.1}, "beta"),
        ({"sliders": 3}, "sliders"),
        ({"least": 1.0}, "least"),
    ],
)
def test_wrong_numbers_are_refused_by_name(wrong, words):
    values = {"F_S": F_S, "K_T": K_T, "chi": -0.5, "beta": 0.1} | wrong
    with pytest.raises(sj.InputError, match=words):
        sj.iwan([1.0], **values)


@pytest.mark.parametrize(
    ("chi", "near", "far", "first"),
    [(0.0, 0.26, 1.10, 0.036), (-0.3, 0.09, 1.35, 0.015), (-0.5, 0.05, 1.68, 0.0055),
     (-0.8, 0.02, 3.35, 0.0006)],
)  # fmt: skip
def test_below_the_least_amplitude_energies_err_as_the_docstring_states(chi, near, far, first):
    """Figures of `iwan` with 100 sliders: near it, far below it, and below the first slider."""
    closed, contact = Closed(chi, 0.0), sj.iwan([1.0], F_S, K_T, chi, 0.0)

    def errors(low: float, high: float) -> Any:
        x = 0.25 * closed.phi_max * np.geomspace(low, high, 3000)
        return slow_cycles(contact, x)[1] / closed.loss(x) - 1.0

    assert 0.5 * near < np.abs(errors(0.1, 1.0)).max() <= near
    assert 0.95 * far < errors(0.5 * first, 0.1).max() <= far
    assert np.all(errors(0.1 * first, 0.9 * first) == -1.0)
