"""Steady vibration with contact that opens: closed forms, long runs, and what is not found."""

import numpy as np
import pytest
from opening_blocks import block, loads, opening_system, oscillator
from scipy.linalg import expm
from scipy.optimize import fsolve

import skfem_joint as sj
from skfem_joint.runs.steady_run import Shooting
from skfem_joint.stepping.driver import Driver
from skfem_joint.vibration.response import at_frequency, steady_plan

OMEGA = 2.0 * np.pi


def _exact(frequency, damping, contact, start):
    """Amplitude of the oscillator with two stiffnesses, from the exact flows between touches.

    In contact and apart it is linear. The unknowns are time and velocity of the touch, and the time
    in contact: the displacement is zero at both ends, and the velocity is again that of the touch.
    """
    turns, whole = OMEGA * frequency, 1.0 / frequency

    def flow(stiffness, t, x):  # displacement, velocity, and the load with its derivative
        A = np.array(
            [[0, 1, 0, 0], [-stiffness, -2 * damping * OMEGA, 1, 0], [0, 0, 0, turns],
             [0, 0, -turns, 0]]
        )  # fmt: skip
        return expm(A * t) @ x

    soft, stiff = OMEGA**2, (1.0 + contact) * OMEGA**2

    def touch(p):
        return np.array([0.0, p[1], np.sin(turns * p[0]), np.cos(turns * p[0])])

    def left(p):
        end = flow(stiff, p[2], touch(p))
        again = flow(soft, whole - p[2], end)
        return [end[0], again[0], again[1] - p[1]]

    p, _, found, _ = fsolve(left, start, xtol=1e-13, full_output=True)
    assert found == 1
    assert p[1] > 0.0
    end = flow(stiff, p[2], touch(p))
    high = max(flow(stiff, t, touch(p))[0] for t in np.linspace(0.0, p[2], 801))
    low = min(flow(soft, t, end)[0] for t in np.linspace(0.0, whole - p[2], 801))
    return 0.5 * (high - low)


def test_an_oscillator_of_two_stiffnesses_vibrates_as_its_exact_flows_say():
    frequency, damping, contact = 0.8, 0.05, 4.0
    errors = []
    for steps in (40, 160):
        run = sj.integrate(
            oscillator(frequency, damping, contact), until="steady", steps_per_cycle=steps
        )
        u, v, t = run.point_u[:, 0], run.point_v[:, 0], run.times
        touch = np.flatnonzero((u[:-1] < 0.0) & (u[1:] >= 0.0))[0]
        leave = np.flatnonzero((u[:-1] >= 0.0) & (u[1:] < 0.0))[0]
        start = t[touch], v[touch], (t[leave] - t[touch]) % (1.0 / frequency)
        exact = _exact(frequency, damping, contact, start)
        errors.append(abs(run.amplitude_of("mass") / exact - 1.0))
        assert run.energy_residual < 1e-10
    assert errors[1] < 1.5e-3
    order = np.log2(errors[0] / errors[1]) / 2.0
    assert 1.7 < order < 2.3


def test_steady_vibration_that_steps_alone_keep_up_raises():
    """Twelve steps a period of a blow give it three times what the load does."""
    with pytest.raises(sj.ConvergenceError, match=r"the time steps added .* shorter step"):
        sj.integrate(oscillator(0.7, 0.03, 10.0), until="steady", steps_per_cycle=12)


def test_contact_that_stays_pressed_is_a_spring():
    """With the frequency of the trapezoidal rule it is linear theory, (2 / h) tan(omega h / 2)."""
    steps, frequency, damping, contact = 40, 0.8, 0.05, 4.0
    system = oscillator(frequency, damping, contact, pressed=2.0)
    run = sj.integrate(system, until="steady", steps_per_cycle=steps, save=sj.Save(fields=True))
    assert run.normal_force.min() > 0.0
    omega = 2.0 * frequency * steps * np.tan(np.pi / steps)
    dynamic = 5.0 * OMEGA**2 - omega**2 + 2j * damping * OMEGA * omega
    u = run.point_u[:-1, 0]
    assert abs(2.0 * np.fft.fft(u)[1] / steps) == pytest.approx(1.0 / abs(dynamic), rel=2e-5)


def _lifted(up=197e3, across=150e3):
    return block().system(loads(up=up, across=across))


@pytest.mark.parametrize(
    ("model", "steps", "opens"),
    [
        (_lifted, 80, True),
        (lambda: sj.reduce(opening_system(), duration=3.0 / 2000.0), 60, False),
        (lambda: sj.condense(_lifted()).with_beta(100.0), 40, True),
    ],
    ids=["full", "reduced", "condensed"],
)
def test_a_block_that_lifts_off_is_steady_where_a_long_run_leads(model, steps, opens):
    """Its base opens, or nearly so; where points come to rest is that of the first periods."""
    system = model()
    run = sj.integrate(system, until="steady", steps_per_cycle=steps)
    long = sj.integrate(system, cycles=45, steps_per_cycle=steps)
    assert run.opened.any() == opens
    assert (run.normal_force_least < 0.15 * system.contact.normal.force).any()
    u = long.point_u[-steps:]
    amplitude = 0.5 * np.ptp(u, axis=0)
    assert run.steady.amplitude == pytest.approx(amplitude, rel=1e-5)
    middle = 0.5 * (u.max(axis=0) + u.min(axis=0))
    assert np.abs(run.steady.offset - middle).max() < 1e-4 * amplitude.max()
    assert run.cycles.friction[-1] == pytest.approx(long.cycles.friction[-1], rel=2e-4)
    lost = run.friction_work.sum() + run.viscous_work + run.scheme_work + run.impact_work
    assert run.input_work.sum() == pytest.approx(lost, rel=3e-4)
    assert run.energy_residual < 1e-9
    (note,) = run.steady.notes
    assert "depend on how the vibration began" in note


def test_no_point_lies_deeper_than_steps_leave_it():
    """Mixtures of states do not press rigid faces into each other."""
    system = sj.condense(block().system(loads(up=150e3, across=50e3)))
    run = sj.integrate(system, until="steady", steps_per_cycle=60, save=sj.Save(fields=True))
    marched = sj.integrate(system, cycles=12, steps_per_cycle=60, save=sj.Save(fields=True))
    deepest = -system.contact.normal.gaps(marched.u).min()
    largest = np.abs(marched.u).max()
    assert -system.contact.normal.gaps(run.u).min() < deepest + 1e-9 * largest


def test_a_vibration_of_two_periods_is_named():
    system = oscillator(2.8, 0.03, 4.0)
    with pytest.raises(sj.ConvergenceError, match="repeats after 2 periods"):
        sj.integrate(system, until="steady", steps_per_cycle=40)
    # It is so: the mass is where it was two periods ago, but not one.
    u = sj.integrate(system, cycles=120, steps_per_cycle=40).point_u[1:, 0].reshape(120, 40)
    size = np.abs(u[-1]).max()
    assert np.abs(u[-1] - u[-3]).max() < 1e-4 * size
    assert np.abs(u[-1] - u[-2]).max() > 0.1 * size


def test_a_body_on_its_base_alone_has_no_rigid_motion_that_lifts_it():
    """Sliding strains nothing, lifting off does what contact prevents."""
    system = block().system(loads(across=20e3, up=100e3))
    assert sj.integrate(system, until="steady", steps_per_cycle=40).steady.unstrained == 0


def _small(up, springs=np.inf, modes=6, duration=None):
    full = block(elements=4, tangential_stiffness=springs).system(loads(up=up))
    return sj.reduce(full, modes=modes, duration=duration)


@pytest.mark.parametrize(
    ("springs", "modes", "duration"),
    [
        (np.inf, 6, None),
        (5e12, 5, 3.0 / 2000.0),
        (5e12, 8, 3.0 / 2000.0),
        (5e12, 8, None),
    ],
)
def test_a_period_of_a_reduced_model_has_the_derivative_of_its_differences(
    springs, modes, duration
):
    """With contact that opens and closes, and friction limits that follow its forces.

    The forces of springs in series are then shares of limits that are not those at rest. They are
    none where a limit is zero at the start of the period: of a point that is open then, and that
    may close in the first step or later.
    """
    system = _small(220e3, springs, modes, duration)
    rest = np.zeros(system.n)
    through = Shooting(Driver(system, steady_plan(system, 60), (rest, rest), 1e-13), lambda: None)
    x = through.coordinates(through.driver.stepper.now)
    for _ in range(3):
        x = through(x).end
    through(x)
    transition = through.derivative().transition
    least = through.driver.recorder.normal_force_least
    assert (least == 0.0).any()
    assert transition.moving.size == system.n
    # So small that no point closes or opens by it, and well above what steps leave.
    rng, size = np.random.default_rng(0), 3e-8 * np.abs(x[: system.n]).max()
    for _ in range(3):
        small = transition.extended(
            x, size * rng.normal(size=2 * system.n + transition.springs.size)
        )
        ends = through(x + small).end, through(x - small).end
        differences = transition.restricted(ends[0] - ends[1]) / 2.0
        linear = transition.matrix @ transition.restricted(small)
        assert np.linalg.norm(linear - differences) < 1e-4 * np.linalg.norm(differences)


def test_points_that_creep_do_not_keep_a_reduced_model_from_becoming_steady():
    """At a third of its load they creep for thousands of periods; Newton's method does not wait."""
    system = at_frequency(_small(150e3), 2000.0, 0.3)
    run = sj.integrate(system, until="steady", steps_per_cycle=40)
    assert run.steady.periods < 60
    u, v = run.final
    later = sj.integrate(system, cycles=3, steps_per_cycle=40, initial=(u, v)).point_u[-41:]
    assert np.abs(later - run.point_u).max() < 2e-5 * np.abs(run.point_u).max()
