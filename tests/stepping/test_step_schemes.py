"""Implicit schemes: order two, and the numerical dissipation that was asked for."""

import numpy as np
import pytest
from stepping_systems import LapJoint, order_of, oscillator

import skfem_joint as sj
from skfem_joint.stepping.schemes import Coefficients, Scheme, backward_euler, generalized_alpha

SCHEMES = {
    "rho 0": generalized_alpha(0.0),
    "rho 0.5": generalized_alpha(0.5),
    "rho 0.8": generalized_alpha(0.8),
    "rho 1": generalized_alpha(1.0),
}
named_schemes = pytest.mark.parametrize("scheme", SCHEMES.values(), ids=SCHEMES)


def stepped(c: Coefficients, k: float, f: float, start: np.ndarray) -> np.ndarray:
    """Displacement, velocity, auxiliary and true acceleration of a unit mass after a step."""
    u0, v0, a0, d0 = start
    predictor = u0 + c.u_v * v0 + c.u_a * a0
    right = f - k * predictor + c.c_M * v0 + c.y_a * a0 + c.y_d * d0
    v1 = right / (c.c_M + c.c_K * k)
    a1 = c.a_v * (v1 - v0) + c.a_a * a0
    return np.array([predictor + c.c_K * v1, v1, a1, c.d_a * a1 + c.d_a0 * a0 + c.d_d0 * d0])


def spectral_radius(scheme: Scheme, omega: float) -> float:
    """Of the matrix that takes (u, v, a) of a free oscillator through a step of h = 1."""
    c, k = scheme.coefficients(1.0), omega**2
    columns = [stepped(c, k, 0.0, np.append(x, -k * x[0]))[:3] for x in np.eye(3)]
    return float(np.abs(np.linalg.eigvals(np.array(columns).T)).max())


@pytest.mark.parametrize("rho", [0.0, 0.2, 0.5, 0.8, 0.95, 1.0])
def test_spectral_radius_at_infinite_frequency_is_rho_infinity(rho):
    # The eigenvalue is triple in the limit and approached with the power -2/3 of the frequency.
    assert spectral_radius(generalized_alpha(rho), 1e6) == pytest.approx(rho, abs=2e-4)


@named_schemes
def test_schemes_are_unconditionally_stable(scheme):
    assert max(spectral_radius(scheme, omega) for omega in np.geomspace(1e-2, 1e4, 25)) <= 1 + 1e-7


@named_schemes
def test_written_for_the_velocity_a_step_fulfils_the_equations_of_the_method(scheme):
    h, k, f = 0.3, 7.0, 2.0
    start = np.array([0.2, -0.4, 1.5, f - k * 0.2])
    u0, v0, a0, d0 = start
    u1, v1, a1, d1 = stepped(scheme.coefficients(h), k, f, start)
    am, af, gamma, beta = scheme.alpha_m, scheme.alpha_f, scheme.gamma, scheme.beta
    assert d1 == pytest.approx(f - k * u1, rel=1e-13)
    assert (1 - am) * a1 + am * a0 == pytest.approx((1 - af) * d1 + af * d0, rel=1e-13)
    assert u1 == pytest.approx(u0 + h * v0 + h**2 * ((0.5 - beta) * a0 + beta * a1), rel=1e-13)
    assert v1 == pytest.approx(v0 + h * ((1 - gamma) * a0 + gamma * a1), rel=1e-13)


def test_a_backward_euler_step_forgets_the_acceleration_of_its_start():
    h, k, f = 0.3, 7.0, 2.0
    one, other = (stepped(backward_euler(h), k, f, np.array([0.2, -0.4, a, d])) for a, d in
                  ((0.0, 0.0), (1e3, -5e2)))  # fmt: skip
    np.testing.assert_array_equal(one, other)
    u1, v1, _, d1 = one
    assert (u1, v1) == pytest.approx((0.2 + h * v1, -0.4 + h * d1), rel=1e-13)
    assert d1 == pytest.approx(f - k * u1, rel=1e-13)


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
def test_schemes_are_of_second_order_on_a_smooth_linear_problem(scheme):
    system = oscillator(sj.Harmonic(1.0, 0.6), frequency=1.0, damping_ratio=0.05)
    counts = [200, 400, 800, 1600]
    errors = []
    for count in counts:
        run = sj.integrate(system, step=4.0 / count, n_steps=count, scheme=scheme)
        errors.append(np.abs(run.point("mass") - driven(run.times, 1.0, 0.05, 0.6)).max())
    assert 1.9 <= order_of(errors, [4.0 / count for count in counts]) <= 2.1


@named_schemes
@pytest.mark.parametrize("quantity", ["point_u", "point_v"])
def test_schemes_are_of_second_order_with_smooth_friction(scheme, quantity):
    # Law and response are smooth: beta times the velocities is of the order of one.
    system = LapJoint(elements=4, beta=1.0, force=30e3, frequency=1000.0).system
    duration = 1e-3

    def end(count, with_scheme):
        save = sj.Save(every=count)
        run = sj.integrate(
            system, step=duration / count, n_steps=count, scheme=with_scheme, save=save
        )
        return float(getattr(run, quantity)[-1, 0])

    exact = end(12_800, generalized_alpha())
    counts = [400, 800, 1600]
    errors = [abs(end(count, scheme) - exact) for count in counts]
    assert 1.9 <= order_of(errors, [duration / count for count in counts]) <= 2.1


@pytest.mark.parametrize("rho", [-0.1, 1.1, np.nan])
def test_parameters_outside_their_range_are_refused(rho):
    with pytest.raises(sj.InputError, match=r"must be from 0 to 1"):
        generalized_alpha(rho)


@pytest.mark.parametrize("rho", [0.0, 0.5, 0.8, 1.0])
def test_frequency_shift_is_that_of_the_free_vibration(rho):
    """Against the angle of the slow eigenvalue of a step of an undamped oscillator, omega h = a."""
    scheme = generalized_alpha(rho)
    am, af, gamma, beta = scheme.alpha_m, scheme.alpha_f, scheme.gamma, scheme.beta
    for angle in (0.02, 0.01):
        # (1 - af) d1 = (1 - am) a1 + am a0 - af d0 with d = -angle^2 u, in units of the step.
        new = np.array([[1.0, 0.0, -beta], [0.0, 1.0, -gamma], [(1 - af) * angle**2, 0.0, 1 - am]])
        old = np.array([[1.0, 1.0, 0.5 - beta], [0.0, 1.0, 1.0 - gamma], [-af * angle**2, 0, -am]])
        turned = np.angle(np.linalg.eigvals(np.linalg.solve(new, old)))
        slow = turned[np.argmin(np.abs(turned - angle))]
        assert 1.0 - slow / angle == pytest.approx(scheme.frequency_shift(angle), rel=1e-2)
    assert generalized_alpha(1.0).frequency_shift(0.1) == pytest.approx(0.01 / 12.0)


def test_the_name_of_a_scheme_is_none():
    one = [[1.0]]
    system = sj.System.from_matrices(one, one, loads={"mass": (0, sj.Harmonic(1.0, 1.0))})
    with pytest.raises(sj.InputError, match=r"scheme: found 'newmark', must be a Scheme"):
        sj.integrate(system, cycles=1, steps_per_cycle=20, scheme="newmark")
