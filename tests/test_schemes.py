"""Implicit schemes: order two, and the numerical dissipation that was asked for."""

from __future__ import annotations

import numpy as np
import pytest
from bars import LapJoint, order_of, oscillator

from skfem_joint.errors import InputError
from skfem_joint.integrate import integrate
from skfem_joint.loads import Harmonic
from skfem_joint.recording import Save
from skfem_joint.schemes import Scheme, average_acceleration, generalized_alpha, hht

SCHEMES = {
    "rho 0": generalized_alpha(0.0),
    "rho 0.5": generalized_alpha(0.5),
    "rho 0.8": generalized_alpha(0.8),
    "rho 1": generalized_alpha(1.0),
    "average acceleration": average_acceleration(),
    "hht 0.1": hht(0.1),
    "hht 1/3": hht(1.0 / 3.0),
}
named_schemes = pytest.mark.parametrize("scheme", SCHEMES.values(), ids=SCHEMES)


def amplification(scheme: Scheme, omega: float) -> np.ndarray:
    """Matrix that takes (u, v, a) of a free oscillator of unit mass through a step of h = 1."""
    c = scheme.coefficients(1.0)
    k = omega**2
    columns = []
    for u, v, a in np.eye(3):
        predictor = u + c.u_v * v + c.u_a * a
        right = -k * predictor + c.c_M * v + c.y_a * a + c.y_d * (-k * u)
        v_new = right / (c.c_M + c.c_K * k)
        columns.append([predictor + c.c_K * v_new, v_new, c.a_v * (v_new - v) + c.a_a * a])
    return np.array(columns).T


def spectral_radius(scheme: Scheme, omega: float) -> float:
    return float(np.abs(np.linalg.eigvals(amplification(scheme, omega))).max())


@pytest.mark.parametrize("rho", [0.0, 0.2, 0.5, 0.8, 0.95, 1.0])
def test_spectral_radius_at_infinite_frequency_is_rho_infinity(rho: float) -> None:
    # The eigenvalue is triple in the limit and approached with the power -2/3 of the frequency.
    assert spectral_radius(generalized_alpha(rho), 1e6) == pytest.approx(rho, abs=2e-4)


@pytest.mark.parametrize("alpha", [0.05, 0.2, 1.0 / 3.0])
def test_spectral_radius_of_hht_at_infinite_frequency(alpha: float) -> None:
    # Chung and Hulbert (1993), section 3.3: alpha = (1 - rho) / (1 + rho).
    expected = (1.0 - alpha) / (1.0 + alpha)
    assert spectral_radius(hht(alpha), 1e6) == pytest.approx(expected, abs=2e-4)


@named_schemes
@pytest.mark.parametrize("omega", np.geomspace(1e-2, 1e4, 25))
def test_schemes_are_unconditionally_stable(scheme: Scheme, omega: float) -> None:
    assert spectral_radius(scheme, omega) <= 1.0 + 1e-7


@named_schemes
def test_written_for_the_velocity_a_step_fulfils_the_equations_of_the_method(
    scheme: Scheme,
) -> None:
    h, k, f = 0.3, 7.0, 2.0
    u0, v0, a0, d0 = 0.2, -0.4, 1.5, f - k * 0.2
    c = scheme.coefficients(h)
    predictor = u0 + c.u_v * v0 + c.u_a * a0
    v1 = (f - k * predictor + c.c_M * v0 + c.y_a * a0 + c.y_d * d0) / (c.c_M + c.c_K * k)
    u1 = predictor + c.c_K * v1
    a1 = c.a_v * (v1 - v0) + c.a_a * a0
    d1 = c.d_a * a1 + c.d_a0 * a0 + c.d_d0 * d0
    am, af, gamma, beta = scheme.alpha_m, scheme.alpha_f, scheme.gamma, scheme.beta
    assert d1 == pytest.approx(f - k * u1, rel=1e-13)
    assert (1 - am) * a1 + am * a0 == pytest.approx((1 - af) * d1 + af * d0, rel=1e-13)
    assert u1 == pytest.approx(u0 + h * v0 + h**2 * ((0.5 - beta) * a0 + beta * a1), rel=1e-13)
    assert v1 == pytest.approx(v0 + h * ((1 - gamma) * a0 + gamma * a1), rel=1e-13)


def driven(times: np.ndarray, frequency: float, damping_ratio: float, drive: float) -> np.ndarray:
    """Exact displacement of a unit mass, from rest under sin(2 pi drive t)."""
    omega, forcing = 2 * np.pi * frequency, 2 * np.pi * drive
    poles = np.roots([1.0, 2 * damping_ratio * omega, omega**2])
    particular = 1.0 / (omega**2 - forcing**2 + 2j * damping_ratio * omega * forcing)
    # Two free terms that cancel displacement and velocity of the particular solution at t = 0.
    start = -np.array([particular.imag, (1j * forcing * particular).imag])
    free = np.linalg.solve(np.array([[1.0, 1.0], poles]), start)
    return np.imag(particular * np.exp(1j * forcing * times)) + np.real(
        np.exp(np.outer(times, poles)) @ free
    )


@named_schemes
def test_schemes_are_of_second_order_on_a_smooth_linear_problem(scheme: Scheme) -> None:
    system = oscillator(Harmonic(1.0, 0.6), frequency=1.0, damping_ratio=0.05)
    steps, errors = [], []
    for count in (200, 400, 800, 1600):
        run = integrate(system, step=4.0 / count, n_steps=count, scheme=scheme)
        exact = driven(run.times, 1.0, 0.05, 0.6)
        steps.append(4.0 / count)
        errors.append(np.abs(run.point("mass") - exact).max())
    assert 1.9 <= order_of(errors, steps) <= 2.1


@named_schemes
@pytest.mark.parametrize("quantity", ["point_u", "point_v"])
def test_schemes_are_of_second_order_with_smooth_friction(scheme: Scheme, quantity: str) -> None:
    # Law and response are smooth: beta times the velocities is of the order of one.
    system = LapJoint(elements=4, beta=1.0, force=30e3, frequency=1000.0).system
    duration = 1e-3

    def end(count: int, with_scheme: Scheme) -> float:
        save = Save(every=count)
        run = integrate(system, step=duration / count, n_steps=count, scheme=with_scheme, save=save)
        return float(getattr(run, quantity)[-1, 0])

    exact = end(12_800, average_acceleration())
    counts = [400, 800, 1600]
    errors = [abs(end(count, scheme) - exact) for count in counts]
    assert 1.9 <= order_of(errors, [duration / count for count in counts]) <= 2.1


def test_special_cases_coincide() -> None:
    # hht without dissipation is the average acceleration method, as is rho = 1.
    assert hht(0.0) == average_acceleration()
    system = oscillator(Harmonic(1.0, 0.6))
    runs = [
        integrate(system, step=0.05, n_steps=100, scheme=scheme).point("mass")
        for scheme in (generalized_alpha(1.0), average_acceleration())
    ]
    np.testing.assert_allclose(runs[0], runs[1], rtol=1e-10, atol=1e-13)


@pytest.mark.parametrize("rho", [-0.1, 1.1, np.nan])
def test_rho_outside_its_range_is_refused(rho: float) -> None:
    with pytest.raises(InputError, match="must be from 0 to 1"):
        generalized_alpha(rho)


@pytest.mark.parametrize("alpha", [-0.1, 0.4, np.nan])
def test_hht_alpha_outside_its_range_is_refused(alpha: float) -> None:
    with pytest.raises(InputError, match="must be from 0 to 1/3"):
        hht(alpha)
