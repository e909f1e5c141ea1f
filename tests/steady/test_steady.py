"""Steady vibration: the fixed point of a period; SI units."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from bodies import pressed, structure
from scipy.linalg import eigh
from stepping_systems import arm, struts

import skfem_joint as sj
from skfem_joint.runs.integrate import integrate_plan
from skfem_joint.runs.steady_run import Shooting
from skfem_joint.steady import steady
from skfem_joint.steady.correction import Correction
from skfem_joint.stepping.driver import Driver
from skfem_joint.vibration.response import steady_plan


def bar(frequency: float, share: float, elements: int = 50, beta: float = np.inf) -> sj.System:
    """Bar with a joint, loaded by a share of its friction limit; 0.1 % damping at 2.5 kHz."""
    joint = sj.Joint("joint", 50e6, 0.7 if share else 0.0, beta=beta)
    damping = 2e-3 / 2500.0 / 2 / np.pi
    system = arm(
        sj.Harmonic(1.0, frequency), joint, (elements, elements), stiffness_damping=damping
    )
    force = share * float(system.contact.w.sum()) if share else 1.0
    load = replace(system.loads[0], amplitude=sj.Harmonic(force, frequency, 0.3))
    return replace(system, loads=(load,))


def on_base() -> sj.System:
    mesh = sj.build_plate([("joint", 0.1, 3), ("free", 0.1, 3)], 0.05, 2)
    made = structure(mesh, [pressed(pressure=5e6, friction=0.5)], stiffness_damping=1e-6)
    return made.system([sj.Load("right", sj.Harmonic(4e3, 3000.0), (1.0, 0.2))], [])


def loose(*parts: sj.Harmonic, share: float = 2.0) -> sj.System:
    """Bar that friction alone holds, under harmonics in shares of so much of its limit."""
    mesh = sj.build_bar([("joint", 0.1, 4), ("arm", 0.2, 4)], {"end": 0.3})
    joint = pressed(beta=np.inf)
    made = struts(mesh, [joint], fixed=(), free=True, stiffness_damping=0.0, damping_ratio=5e-3)
    system = made.system([sj.Load("end", sj.Harmonic(1.0, 1500.0))], [])
    scale = share * float(system.contact.w.sum())
    load = sj.MultiHarmonic(tuple(replace(a, amplitude=scale * a.amplitude) for a in parts))
    return replace(system, loads=(replace(system.loads[0], amplitude=load),))


def dense(system: sj.System) -> sj.System:
    _, V = np.linalg.eigh(system.K.toarray())
    return system.project(V[:, :30])


def shooting(system: sj.System, steps: int, periods: int) -> tuple[Any, Any]:
    """Search for a steady vibration, and its coordinates after some periods from rest."""
    plan, rest = steady_plan(system, steps), np.zeros(system.n)
    through = Shooting(Driver(system, plan, (rest, rest), 1e-13), lambda: None)
    through.patience = 0
    x = through.coordinates(through.driver.stepper.now)
    for _ in range(periods):
        x = through(x).end
    return through, x


def amplitude(run: sj.Run) -> float:
    """Of the last period, of 100 steps."""
    u = run.point_u[-101:]
    return 0.5 * float(np.ptp(u[:, np.ptp(u, axis=0).argmax()]))


@pytest.mark.parametrize("rho", [1.0, 0.6])
def test_linear_vibration_is_that_of_the_complex_stiffness(rho):
    system, h = bar(2490.0, 0.0), 1.0 / 2490.0 / 200
    scheme = sj.generalized_alpha(rho)
    run = sj.integrate(system, until="steady", steps_per_cycle=200, scheme=scheme)
    # Average acceleration turns i omega into i (2 / h) tan(omega h / 2).
    omega = 2.0 / h * np.tan(np.pi / 200)
    K, C, M = (A.toarray() for A in (system.K, system.C, system.M))
    u = np.linalg.solve(K + 1j * omega * C - omega**2 * M, system.loads[0].vector)
    exact = (system.P @ u) * np.exp(1j * (0.3 + 2.0 * np.pi * np.arange(201) / 200))[:, np.newaxis]
    limit = 2e-5 if rho == 1.0 else 2e-3
    assert np.abs(run.point_u - exact.imag).max() < limit * np.abs(u).max()
    assert run.steady.periods <= 60  # plainly thousands


@pytest.mark.parametrize(
    "make",
    [
        lambda: bar(2225.0, 0.03),
        lambda: bar(2025.0, 0.1),
        lambda: bar(1790.0, 0.3),
        lambda: dense(bar(2025.0, 0.1, beta=1e4)),
        on_base,
    ],
    ids=["little slip", "resonance", "gross slip", "dense", "slip vectors"],
)
def test_steady_vibration_is_where_long_time_integration_leads(make):
    system = make()
    run = sj.integrate(system, until="steady", steps_per_cycle=100)
    cycles = 60 if system.n < 60 else 600  # small ones are damped more
    integrated = sj.integrate(system, cycles=cycles, steps_per_cycle=100)
    assert amplitude(run) == pytest.approx(amplitude(integrated), rel=5e-4)
    assert run.cycles.friction[-1] == pytest.approx(integrated.cycles.friction[-1], rel=5e-4)
    assert run.steady.periods < (10 if system.is_dense else 60)
    # All of the work of the loads is lost in the period.
    lost = run.friction_work.sum() + run.viscous_work + run.scheme_work
    assert run.input_work.sum() == pytest.approx(lost, rel=3e-4)
    assert run.energy_residual < 1e-10


def test_halves_of_a_period_are_mirror_images_where_those_of_the_load_are():
    system = bar(600.0, 0.3)
    odd = (sj.Harmonic(1e5, 600.0, 0.3), sj.Harmonic(5e4, 1800.0))
    for parts, mirrored in ((odd, True), ((*odd, sj.Harmonic(2e4, 1200.0)), False)):
        load = replace(system.loads[0], amplitude=sj.MultiHarmonic(parts))
        run = sj.integrate(
            replace(system, loads=(load,)),
            until="steady",
            steps_per_cycle=200,
            save=sj.Save(fields=True),
        )
        largest = np.abs(run.u).max()
        assert np.abs(run.u[-1] - run.u[0]).max() < 1e-4 * largest
        left = np.abs(run.u[100:] + run.u[:101]).max() / largest
        assert left < 1e-4 if mirrored else left > 1e-2


def test_the_period_of_several_harmonics_is_the_common_one():
    system = bar(500.0, 0.2)
    both = sj.MultiHarmonic((sj.Harmonic(3e4, 500.0), sj.Harmonic(3e4, 750.0)))
    system = replace(system, loads=(replace(system.loads[0], amplitude=both),))
    run = sj.integrate(system, until="steady", steps_per_cycle=400)
    assert run.times[-1] == pytest.approx(1.0 / 250.0)
    assert run.point_u[-1] == pytest.approx(run.point_u[0], rel=1e-5)


@pytest.mark.parametrize("steps", [50, 52, 60, 100])
@pytest.mark.parametrize("share", [0.7, 2.0, 6.0])
def test_a_body_that_friction_alone_holds_vibrates_as_after_long_time_integration(steps, share):
    system = loose(sj.Harmonic(1.0, 1500.0, 0.3), share=share)
    run = sj.integrate(system, until="steady", steps_per_cycle=steps)
    u = sj.integrate(system, cycles=1000, steps_per_cycle=steps).point_u[-steps - 1 :, 0]
    amplitude = run.amplitude_of("end")
    assert amplitude == pytest.approx(0.5 * np.ptp(u), rel=1e-3)
    # A long integration keeps the offset of its start; the steady vibration has none.
    assert abs(run.offset_of("end")) < 1e-4 * amplitude
    assert run.peak_of("end") == pytest.approx(amplitude, rel=1e-4)
    assert run.steady.unstrained == 1
    assert not run.steady.drift.any()


def test_the_search_does_not_depend_on_where_a_loose_body_lies():
    both = sj.Harmonic(1.0, 1500.0), sj.Harmonic(0.5, 3000.0, 1.0)
    for system, moved in ((loose(both[0]), 0.0), (loose(*both), 1.0)):
        shift = np.full(system.n, 1.0)  # of all nodes, m: a thousand amplitudes
        assert np.abs(system.K @ shift).max() < 1e-12 * abs(system.K).max()
        how = {"until": "steady", "steps_per_cycle": 80}
        run = sj.integrate(system, **how)
        other = sj.integrate(system, initial=(shift, 0.0 * shift), **how)
        assert other.amplitude_of("end") == pytest.approx(run.amplitude_of("end"), rel=1e-4)
        apart = other.offset_of("end") - run.offset_of("end")
        assert apart == pytest.approx(moved, abs=1e-4 * run.amplitude_of("end"))


def test_a_body_that_drifts_for_ever_has_a_steady_velocity():
    system = loose(sj.Harmonic(1.0, 1500.0), sj.Harmonic(0.5, 3000.0, 1.0))
    run = sj.integrate(system, until="steady", steps_per_cycle=80)
    integrated = sj.integrate(system, cycles=1000, steps_per_cycle=80)
    u = integrated.point_u[-81:, 0]
    assert run.steady.drift[0] == pytest.approx(u[-1] - u[0], rel=1e-3)
    assert abs(run.steady.drift[0]) > 0.05 * run.amplitude_of("end")
    vibration = u - np.linspace(0.0, u[-1] - u[0], 81)
    assert run.amplitude_of("end") == pytest.approx(0.5 * np.ptp(vibration), rel=1e-3)


def test_amplitude_and_offset_are_of_every_step_whatever_is_stored():
    system = loose(sj.Harmonic(1.0, 1500.0, 0.3))
    whole, thin, none = (
        sj.integrate(system, until="steady", steps_per_cycle=60, save=save)
        for save in (sj.Save(), sj.Save(every=7), sj.Save(points=False))
    )
    u = whole.point("end")
    assert whole.amplitude_of("end") == 0.5 * np.ptp(u)
    assert whole.offset_of("end") == 0.5 * (u.max() + u.min())
    for other in (thin, none):
        assert other.amplitude_of("end") == whole.amplitude_of("end")
        assert other.offset_of("end") == whole.offset_of("end")
    with pytest.raises(sj.InputError, match="steady"):
        sj.integrate(system, cycles=1, steps_per_cycle=60).amplitude_of("end")


def test_linear_vibration_with_light_damping_takes_few_periods():
    frequency, ratio = 1500.0, 1e-4
    system = arm(None, None, (10, 10), damping_ratio=ratio)
    parts = sj.Harmonic(1.0, frequency), sj.Harmonic(0.5, 2.0 * frequency)
    load = sj.AppliedLoad(system.P.toarray()[-1], sj.MultiHarmonic(parts), "end")
    run = sj.integrate(replace(system, loads=(load,)), until="steady", steps_per_cycle=60)
    assert run.friction_energy["joint"] == 0.0
    assert run.steady.periods <= 40  # with twelve states 160, plainly tens of thousands


def test_what_has_no_steady_vibration_is_refused(tmp_path):
    saved = sj.Checkpoints(tmp_path, 1, False).of("full", "")
    system = bar(500.0, 0.0)
    with pytest.raises(sj.InputError, match="neither friction nor damping"):
        sj.integrate(replace(system, C=None), until="steady", steps_per_cycle=100)
    pulse = replace(system, loads=(replace(system.loads[0], amplitude=sj.HalfSine(1.0, 1e-3)),))
    with pytest.raises(sj.InputError, match="loads that repeat"):
        sj.integrate(pulse, until="steady", step=1e-5, n_steps=100)
    late = sj.HalfSine(1.0, 1e-3, start=0.1), sj.Versine(1.0, 1e-3, start=0.1)
    for other in (sj.Triangle(1.0, 5e-4), *late, lambda t: 9.0 * t):
        loads = (*system.loads, sj.AppliedLoad(system.loads[0].vector, other, "base"))
        with pytest.raises(sj.InputError, match=r"that on 'base' does not after 0\.002 s"):
            sj.integrate(replace(system, loads=loads), until="steady", steps_per_cycle=100)
    with pytest.raises(sj.InputError, match="no checkpoints"):
        sj.integrate(system, until="steady", steps_per_cycle=100, checkpoint=saved)


def test_vibration_that_friction_does_not_reach_is_no_fixed_point(monkeypatch):
    monkeypatch.setattr(steady, "PERIODS", 10)
    stuck = replace(bar(2000.0, 1e-9), C=None)
    with pytest.raises(sj.ConvergenceError, match=r"no steady vibration.* give more of it"):
        sj.integrate(stuck, until="steady", steps_per_cycle=100)


@pytest.mark.parametrize("beta", [np.inf, 1e4])
@pytest.mark.parametrize("kind", ["chain", "contact", "dense"])
def test_the_transition_is_the_derivative_of_a_period(kind, beta):
    system = bar(1790.0, 0.3, 10, beta=beta) if kind != "contact" else on_base()
    if kind == "contact":
        system = system.with_contact(beta=np.full_like(system.contact.beta, beta))
    if kind == "dense":
        _, V = np.linalg.eigh(system.K.toarray())
        system = system.project(V[:, :12]).with_contact(beta=np.full_like(system.contact.beta, 1e4))
    through, x = shooting(system, 100, 4)
    assert through.driver.to.kind == kind
    through(x)
    derivative = through.derivative()
    assert derivative is not None
    matrix, part = derivative.transition, derivative.transition.restricted(x)
    random, k = np.random.default_rng(0), part.size // 2
    scale = np.repeat([np.abs(part[:k]).max(), np.abs(part[k:]).max()], k)
    for _ in range(3):
        d = 1e-8 * random.normal(size=2 * k) * scale
        ends = [matrix.restricted(through(matrix.extended(x, part + e)).end) for e in (d, -d)]
        change = 0.5 * (ends[0] - ends[1])
        expected = -matrix.matrix @ d  # half a period, its sign changed
        assert np.abs(change - expected).max() < 1e-4 * np.abs(change).max()


def test_held_steps_shrink_to_the_change_over_what_holds_them():
    # Those of points that stick all the time as well: else the search never nears where it began.
    system = bar(2000.0, 0.05, 10)
    through, x = shooting(system, 100, 1)
    change, derivative = through(x).end - x, through.derivative()
    assert derivative is not None
    assert derivative.transition.moving.size < system.n  # some stick
    held = 1e6
    np.testing.assert_allclose(
        held * derivative.step(change, held), change, atol=1e-4 * np.abs(change).max()
    )


def test_a_correction_by_the_system_itself_is_newtons_step():
    system = dense(bar(2025.0, 0.1, beta=1e4))
    through, begin = shooting(system, 200, 2)
    x, driver, plan = through(begin).end, through.driver, through.driver.plan
    derivative, v = through.derivative(), driver.recorder.stored.v[1 : plan.n_steps // 2 + 1]
    one = np.eye(system.n)
    correction = Correction.of(system, plan, driver.warp * v, one, one)
    assert derivative is not None
    assert correction is not None
    through.correction = correction
    newton = derivative.step(x - begin, 0.0)
    np.testing.assert_allclose(
        through.corrected(x - begin), newton, atol=1e-9 * np.abs(newton).max()
    )


def test_at_resonance_without_damping_there_is_no_correction():
    system = dense(bar(2490.0, 0.1, beta=1e4))
    system = replace(system, C=np.zeros_like(system.C))
    first = np.sqrt(eigh(system.K, system.M, eigvals_only=True)[0]) / (2.0 * np.pi)
    one = np.eye(system.n)
    for frequency, none in ((0.9 * first, False), (first, True)):
        load = replace(system.loads[0], amplitude=sj.Harmonic(1.0, frequency))
        loaded = replace(system, loads=(load,))
        plan = steady_plan(loaded, 200)
        slipping = np.full((plan.n_steps // 2, system.n), 1e12)
        assert (Correction.of(loaded, plan, slipping, one, one) is None) is none


def test_warped_steps_have_true_velocities_and_energies():
    system = bar(2490.0, 0.0)
    run = integrate_plan(system, steady_plan(system, 40))
    omega = 2.0 * np.pi * 2490.0
    assert np.ptp(run.point_v) == pytest.approx(omega * np.ptp(run.point_u), rel=1e-6)
    assert run.energy_residual < 1e-9


@pytest.mark.parametrize(("elements", "share"), [(4, 1e-9), (4, 1e-6), (50, 1e-6)])
def test_without_damping_a_change_at_round_off_is_steady(elements, share):
    """All points stick: nothing is lost, and the work of a period is round-off, too."""
    system = bar(500.0, share, elements)
    force = share * float(system.contact.w.sum())
    load = replace(system.loads[0], amplitude=sj.Harmonic(force, 500.0))
    system = replace(system, C=0.0 * system.C, loads=(load,))
    run = sj.integrate(system, until="steady", steps_per_cycle=100)
    assert run.steady is not None
    assert run.steady.periods < 50
    # The trapezoidal rule has the amplitude of this frequency, exactly.
    omega = 2.0 * 500.0 * 100 * np.tan(np.pi / 100)
    free = np.setdiff1d(np.arange(system.n), system.contact.B.indices)
    stiffness = (system.K - omega**2 * system.M).toarray()[np.ix_(free, free)]
    u = np.linalg.solve(stiffness, force * system.load_vectors()[free, 0])
    exact = np.abs(system.P.toarray()[:, free] @ u)
    largest = int(exact.argmax())
    assert run.peak[largest] == pytest.approx(exact[largest], rel=1e-5)


def test_steps_that_are_held_ever_more_stay_finite():
    """Their derivative is of no help: the change that they start from is the least there is."""

    class Useless:
        def step(self, change, held):
            return change / (1.0 + held)

    newton, x = steady.Newton(np.linalg.norm), np.ones(3)
    for count in range(3000):
        with np.errstate(all="raise"):
            x = newton.next(x, np.ones(3) * (10.0 if count else 1.0), Useless)
    assert np.isfinite(x).all()
