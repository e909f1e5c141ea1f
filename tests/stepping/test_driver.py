"""The driver around the steppers: spans, rows, chunks, jumps, interruptions, failing steps."""

import math
import re
import subprocess
import sys
import time
import tracemalloc
from dataclasses import replace
from math import inf, pi
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bodies import DENSITY, E
from stepping_systems import (
    STEPPERS,
    LapJoint,
    dense_system,
    differing,
    of_stepper,
    order_of,
    oscillator,
)

import skfem_joint as sj
from skfem_joint.ground.loads import Amplitude, Scaled
from skfem_joint.runs.resolution import check_jumps, check_resolution, longest_step
from skfem_joint.stepping import driver
from skfem_joint.stepping.plan import Plan

REFERENCE = LapJoint()
SMALL = LapJoint(elements=5).system
every_stepper = pytest.mark.parametrize("kind", STEPPERS)


def test_all_ways_to_give_the_steps_are_one():
    both = sj.Harmonic(2e4, 1000.0), sj.Harmonic(1e4, 1500.0)  # common period: 2 ms
    system = LapJoint(elements=5, load=sj.MultiHarmonic(both)).system
    plain = sj.integrate(system, step=1e-5, n_steps=400, cycle_steps=200)
    cycles = sj.integrate(system, cycles=2, steps_per_cycle=200)
    np.testing.assert_allclose(cycles.times, plain.times, rtol=1e-12)
    np.testing.assert_allclose(cycles.point_u, plain.point_u, atol=1e-10 * plain.peak[0])
    np.testing.assert_allclose(cycles.cycles.friction, plain.cycles.friction, rtol=1e-9)
    duration = sj.integrate(system, step=1e-5, duration=400e-5, cycle_steps=200)
    assert differing(plain, duration) == []
    aperiodic = replace(system, loads=(replace(system.loads[0], amplitude=np.sin),))
    with pytest.raises(sj.InputError, match="no common period"):
        sj.integrate(aperiodic, cycles=2, steps_per_cycle=100)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({}, "step and n_steps"),
        ({"step": 1e-5, "n_steps": 10, "duration": 1e-4}, "step and n_steps"),
        ({"cycles": 3}, "steps_per_cycle"),
        ({"steps_per_cycle": 100}, "cycles"),
        ({"cycles": 3, "steps_per_cycle": 100, "step": 1e-5}, "without step"),
        ({"cycles": 3, "steps_per_cycle": 100, "cycle_steps": 10}, "cycle_steps"),
        ({"step": 1e-5, "n_steps": 10, "initial": (np.zeros(3), np.zeros(5))}, "initial"),
        ({"step": 1e-5, "n_steps": 10, "initial": (np.full(5, np.nan), np.zeros(5))}, "initial"),
        ({"step": 1e-5, "n_steps": 10, "initial": 0.0}, "initial: must be a run, or two arrays"),
        ({"step": 1e-5, "duration": 1e300}, r"n_steps: found 1e\+18, must be at most 2\^53"),
        ({"step": 1e-5, "n_steps": 2**53}, "save: 9007199254740993 rows of points"),
        ({"step": 1e-5, "n_steps": 10, "until": "stedy"}, "until: found 'stedy'"),
    ],
)
def test_arguments_that_do_not_fit_are_refused(arguments, message):
    with pytest.raises(sj.InputError, match=message):
        sj.integrate(SMALL, **arguments)


@every_stepper
def test_rows_are_stored_at_the_asked_strides(kind):
    system = of_stepper(kind)
    every = sj.integrate(system, step=1e-5, n_steps=60, save=sj.Save(fields=True))
    save = sj.Save(every=5, fields=True, fields_every=20)
    some = sj.integrate(system, step=1e-5, n_steps=60, save=save)
    np.testing.assert_allclose(some.times, every.times[::5], rtol=1e-14)
    np.testing.assert_array_equal(some.point_u, every.point_u[::5])
    np.testing.assert_array_equal(some.point_v, every.point_v[::5])
    for name in ("u", "v", "sigma", "friction_work_rows"):
        np.testing.assert_array_equal(getattr(some, name), getattr(every, name)[::20])
    np.testing.assert_array_equal(some.peak, every.peak)
    scale = np.abs(every.u).max()
    np.testing.assert_allclose((system.P @ every.u.T).T, every.point_u, atol=1e-12 * scale)
    np.testing.assert_allclose(np.abs(every.point_u).max(axis=0), every.peak, rtol=1e-12)
    slips = (
        system.contact.slip_norm((system.contact.B @ every.u.T).T)
        if system.contact.w.size
        else np.zeros((1, 0))
    )
    np.testing.assert_allclose(every.slip_peak, slips.max(axis=0), atol=1e-12 * scale)
    np.testing.assert_array_equal(every.final[0], every.u[-1])
    np.testing.assert_array_equal(every.friction_work_rows[-1], every.friction_work)


@every_stepper
@pytest.mark.parametrize("jumps", [False, True])
def test_where_chunks_end_changes_no_bit(kind, jumps):
    # Jumps off the grid of steps: parts of steps, each with a matrix of its own.
    system = of_stepper(kind, sj.Rectangle(40e3, 1.37e-4, 0.613e-4) if jumps else None)
    options: dict[str, Any] = {"step": 5e-6, "n_steps": 60, "save": sj.Save(every=4, fields=True),
                               "scheme": sj.generalized_alpha(0.8)}  # fmt: skip
    whole = sj.integrate(system, **options)
    for cycle_steps in (1, 7):
        run = sj.integrate(system, **options, cycle_steps=cycle_steps)
        assert run.cycles.friction.size == 60 // cycle_steps
        assert differing(whole, replace(run, plan=whole.plan, cycles=whole.cycles)) == []


class Slow(Amplitude):
    """Load with a kink in each of the first steps of 10 µs, where it takes 0.15 s."""

    corners = tuple(1e-5 * (k + 0.5) for k in range(8))
    peak_value = 1e3

    def _force(self, t: Any) -> Any:
        time.sleep(0.075 if np.size(t) == 2 else 0.0)
        return 1e3 * np.minimum(t / 1e-5, 1.0)


def test_slow_steps_are_shown_as_they_are_done():
    """Whatever else the machine does: so many of them take half a second at least."""
    seen = [0]
    sj.integrate(
        of_stepper("chain", Slow()), step=1e-5, n_steps=8,
        progress=lambda done, total: seen.append(done),
    )  # fmt: skip
    assert np.diff(seen).max() <= math.ceil(driver.CHUNK_S / 0.15)


@pytest.mark.parametrize("friction", [0.0, 0.7])
def test_memory_of_a_run_that_stores_nothing_does_not_grow_with_its_steps(friction):
    system = LapJoint(elements=4, friction=friction).system
    # The driver hands out at most 20,000 steps at a time; from there on nothing may grow.
    counts = (50_000, 200_000) if friction else (40, 200)
    used = []
    for count in (counts[0], *counts):
        tracemalloc.start()
        run = sj.integrate(system, step=1e-5, n_steps=count, save=sj.Save(points=False))
        used.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        assert run.times.size == run.point_u.size == run.u.size == run.amplitudes.size == 0
        assert run.peak[0] > 0.0
    assert used[2] < used[1] + 100_000


class Kinked(Amplitude):
    """Load with a kink inside the step 33, at which a Ctrl-C may come."""

    corners = (33.4 * 5e-6,)
    peak_value = 40e3

    def __init__(self, interrupts: bool) -> None:
        self.interrupts = interrupts

    def _force(self, t: Any) -> Any:
        if self.interrupts and np.size(t) == 2 and t[0] == self.corners[0]:
            raise KeyboardInterrupt
        return 40e3 * np.sin(3e4 * np.minimum(t, self.corners[0]))


@every_stepper
def test_an_interruption_anywhere_leaves_the_steps_that_were_finished(kind):
    """In the middle of a chunk, where rows, works and counters have gone on already."""
    options = {"step": 5e-6, "save": sj.Save(every=2, fields=True), "cycle_steps": 10}
    run = sj.integrate(of_stepper(kind, Kinked(True)), n_steps=60, **options)
    assert run.interrupted
    assert run.counters.steps == 30
    whole = sj.integrate(of_stepper(kind, Kinked(False)), n_steps=30, **options)
    assert not whole.interrupted
    # Its plan is the one that was asked for.
    assert differing(replace(run, interrupted=False, plan=whole.plan), whole) == []


class Unsteady(Amplitude):
    """Load from the second step of 10 µs on; it may be no number where many are asked for."""

    def __init__(self, many: float) -> None:
        self.many = many

    def _force(self, t: Any) -> Any:
        force = 63e3 * np.sin(6e3 * np.maximum(t - 1e-5, 0.0))
        return force if np.size(t) < 3 else force * self.many


@every_stepper
def test_steps_that_do_not_converge_are_halved(kind):
    """Steps for which loads are evaluated together fail, and their halves do not."""
    save = sj.Save(every=2)
    loads = Unsteady(1.0), Unsteady(np.nan)
    whole, failing = (of_stepper(kind, load) for load in loads)
    fine = sj.integrate(whole, step=0.5e-5, n_steps=80, save=save, cycle_steps=40)
    halved = sj.integrate(failing, step=1e-5, n_steps=40, cycle_steps=20)
    assert halved.counters.halved_steps == 39  # the first one is done alone
    assert halved.counters.steps == 40
    assert halved.times.size == 41
    np.testing.assert_allclose(halved.point_u, fine.point_u, atol=1e-9 * fine.peak[0])
    np.testing.assert_allclose(halved.input_work, fine.input_work, rtol=1e-8)
    np.testing.assert_allclose(halved.cycles.friction, fine.cycles.friction, rtol=1e-7)
    assert halved.energy_residual < 1e-10


class Broken(Amplitude):
    """Load that is not a number from a time on."""

    def _force(self, t: Any) -> Any:
        return np.where(t < 1.55e-4, 1e3 * np.minimum(t / 1e-5, 1.0), np.nan)


@every_stepper
def test_a_step_that_never_converges_is_an_error_that_says_where(kind):
    said = (
        r"step 15 at t = 0\.00015.* a step of 3.91e-08 s: force residual .* N, largest at unknown"
    )
    with pytest.raises(sj.ConvergenceError, match=said) as caught:
        sj.integrate(of_stepper(kind, Broken()), step=1e-5, n_steps=40)
    assert caught.value.exit_status == 3


@every_stepper
def test_a_tolerance_below_round_off_still_ends(kind):
    # Convergence is judged against the round-off of the residual, so zero asks for no more.
    system = of_stepper(kind)
    loose = sj.integrate(system, step=1e-5, n_steps=60)
    tight = sj.integrate(system, step=1e-5, n_steps=60, tolerance=0.0)
    np.testing.assert_allclose(tight.point_u, loose.point_u, atol=1e-8 * loose.peak[0])


def under_rectangle(times: np.ndarray, load: sj.Rectangle) -> np.ndarray:
    """Exact displacement of the test oscillator (1 Hz, damping ratio 0.05) from rest."""
    omega, zeta = 2 * np.pi, 0.05
    damped = omega * np.sqrt(1 - zeta**2)

    def step_response(t: np.ndarray) -> np.ndarray:
        t = np.maximum(t, 0.0)
        swing = np.cos(damped * t) + zeta * omega / damped * np.sin(damped * t)
        return (1 - np.exp(-zeta * omega * t) * swing) / omega**2

    since = times - load.start
    return load.peak * (step_response(since) - step_response(since - load.duration))


@pytest.mark.parametrize("scheme", [sj.generalized_alpha(0.5), sj.generalized_alpha(1.0)])
@pytest.mark.parametrize("table", [False, True])
@pytest.mark.parametrize(
    ("start", "duration"),
    [
        (0.0, 0.5),  # sets in at once
        (0.25, 0.5),  # at step ends, which are these numbers exactly
        (0.3, 0.6),  # at step ends up to round-off of 'number times step'
        (0.3123, 0.537),  # inside steps
        (0.30001, 0.6),  # inside a step, close to its end
        (0.3123, 1e-4),  # both inside one step
    ],
)
def test_loads_that_jump_keep_second_order(start, duration, scheme, table):
    exact_load = sj.Rectangle(1.0, duration, start)
    load = sj.Table([start, start + duration], [1.0, 1.0]) if table else exact_load
    counts = (100, 200, 400)
    errors = []
    for count in counts:
        run = sj.integrate(oscillator(load), step=2.0 / count, n_steps=count, scheme=scheme)
        exact = under_rectangle(run.times, exact_load)
        errors.append(np.abs(run.point("mass") - exact).max())
        assert run.energy_residual < 1e-10
    assert order_of(errors, [2.0 / count for count in counts]) > 1.8


def test_kinks_inside_steps_keep_second_order_and_the_stored_times():
    joint = replace(REFERENCE, load=sj.Triangle(63e3, 1.234e-4))

    def tip(parts):
        save = sj.Save(every=parts)
        run = sj.integrate(joint.system, step=1e-5 / parts, n_steps=60 * parts, save=save)
        np.testing.assert_allclose(run.times, 1e-5 * np.arange(61), rtol=1e-12)
        return run.point("free_end")

    exact = tip(32)
    errors = [float(np.abs(tip(parts) - exact).max()) for parts in (1, 2, 4)]
    assert order_of(errors, [1.0, 0.5, 0.25]) > 1.7


def test_coulomb_points_at_rest_start_to_slip_only_as_far_as_the_load_reaches():
    # A load that is there at the start: the accelerations obey the law that velocities will.
    joint = LapJoint(elements=50, beta=inf, load=sj.Rectangle(63e3, 1.0))
    run = sj.integrate(joint.system, step=1e-6, n_steps=10, save=sj.Save(fields=True))
    sigma = run.sigma[0]
    assert sigma[-1] == 1.0
    assert np.all(np.abs(sigma) <= 1.0)
    assert np.abs(sigma[0]) < 1e-6
    assert run.energy_residual < 1e-10
    quiet = replace(joint, load=sj.Rectangle(0.5 * joint.tau * joint.length / 50, 1.0))
    still = sj.integrate(quiet.system, step=1e-6, n_steps=10, save=sj.Save(fields=True))
    assert np.all(still.u == 0.0)
    assert still.sigma[-1, -1] == pytest.approx(0.5, rel=1e-12)


@pytest.mark.parametrize(
    ("load", "step", "most"),
    [
        (sj.Harmonic(1e3, 1000.0), 1e-3, 0.000125),
        (sj.Triangle(1e3, 1e-7, 1e-4), 1e-5, None),
        (sj.HalfSine(1e3, 1e-7, 1e-4), 1e-5, 5e-08),
        (sj.Harmonic(1e3, 0.1, pi / 2), 0.1, None),
        (sj.Rectangle(1e3, 1.0, 0.0), 0.1, None),
    ],
)
def test_a_step_that_is_too_long_is_refused_with_the_one_that_does(load, step, most):
    system = LapJoint(load=load, elements=20).system
    longest = longest_step(system, 100 * step)
    assert longest < step
    assert most is None or longest == pytest.approx(most, rel=1e-9)
    with pytest.raises(sj.InputError, match=f"step of at most {longest:.4g} s"):
        sj.integrate(system, step=step, n_steps=100)
    plan = Plan(longest, int(100 * step / longest))
    check_resolution(system, plan)
    check_jumps(system, plan)


@pytest.mark.parametrize("load", [sj.HalfSine(1.0, 1e-3, 0.5), sj.Versine(1.0, 1e-3, 0.5)])
def test_round_pulses_between_two_steps_are_never_missed(load):
    with pytest.raises(sj.InputError, match="too long for a pulse"):
        sj.integrate(oscillator(load), step=0.01, n_steps=100)


def test_a_table_of_many_times_is_followed_whatever_it_acts_on():
    """20 Hz of a cosine at 2 ms on 1 Hz: samples 50 ms apart were a constant load, 20 times it."""
    t = np.arange(0.0, 4.0, 2e-3)
    system = oscillator(sj.Table(t, np.cos(40.0 * np.pi * t)))
    with pytest.raises(sj.InputError, match="does not follow this function of time"):
        sj.integrate(system, step=0.05, n_steps=79)
    sj.integrate(system, step=2e-3, n_steps=100)  # sees every value
    run = sj.integrate(system, step=1e-3, n_steps=3998)
    exact = sj.integrate(oscillator(sj.Harmonic(1.0, 20.0, 0.5 * pi)), step=1e-3, n_steps=3998)
    assert run.peak == pytest.approx(exact.peak, rel=0.01)  # 25 samples in a period


@pytest.mark.parametrize("share", [0.1, 0.5, 0.9])
def test_a_jump_below_the_friction_limit_sets_off_the_part_that_slips(share):
    """Static slip tau x^2 / (2 EA) over the active length a: 2 pi sqrt(3/20) a / c by Rayleigh."""
    joint = LapJoint(elements=200, beta=inf)
    load = sj.Rectangle(share * float(joint.system.contact.w.sum()), 1.0)
    system = replace(joint, load=load).system
    period = 2.0 * pi * np.sqrt(3.0 / 20.0) * share * joint.length / np.sqrt(E / DENSITY)
    check_jumps(system, Plan(0.095 * period, 10))
    with pytest.raises(sj.InputError, match="jump"):
        check_jumps(system, Plan(0.105 * period, 10))


def test_a_jump_on_what_is_singular_but_for_round_off_sets_off_no_vibration():
    jump = sj.AppliedLoad(np.ones(4), sj.Rectangle(1.0, 1.0), "all")
    turn = np.linalg.qr(np.random.default_rng(3).normal(size=(4, 4)))[0]
    K = 1e6 * turn[:, 1:] @ turn[:, 1:].T + 1e-12 * np.eye(4)
    check_jumps(dense_system(K=0.5 * (K + K.T), loads=(jump,)), Plan(0.5, 10))


INTERRUPTED = """
import signal, sys
import numpy as np
import skfem_joint as sj
from skfem_joint.scene import load_scene

def interrupt(*_):
    raise KeyboardInterrupt

system = load_scene(sys.argv[1]).system()
sj.integrate(system, cycles=1, steps_per_cycle=200)
signal.signal(signal.SIGALRM, interrupt)
rng = np.random.default_rng(3)
counted = 0
for _ in range(120):
    try:
        signal.setitimer(signal.ITIMER_REAL, rng.uniform(5e-3, 5e-2))
        counted += sj.integrate(system, cycles=4000, steps_per_cycle=200).interrupted
    except KeyboardInterrupt:
        pass  # before the first step
    signal.setitimer(signal.ITIMER_REAL, 0.0)
print(counted)
"""


@pytest.mark.slow
def test_an_interrupt_at_any_instant_ends_a_run_and_not_the_process():
    """A signal that comes while compiled code runs is raised once it is back in Python."""
    scene = Path(__file__).parents[2] / "examples" / "structure_harmonic.toml"
    ran = subprocess.run(
        [sys.executable, "-c", INTERRUPTED, str(scene)], capture_output=True, text=True, timeout=120
    )
    assert ran.returncode == 0, ran.stderr
    assert int(ran.stdout) > 60


@pytest.mark.parametrize(
    ("load", "follows"),
    [
        (lambda t: np.sin(2.0 * np.pi * 20e3 * t), False),  # zero at the end of every step
        (lambda t: math.sin(2.0 * np.pi * 40e3 * t), False),
        (lambda t: 1.0 + 0.01 * np.cos(2.0 * np.pi * 20e3 * t), False),
        (lambda t: np.sin(2.0 * np.pi * 19e3 * t) * (t > 2e-3), False),
        (lambda t: np.sin(2.0 * np.pi * 3e3 * t), False),
        (lambda t: np.sin(2.0 * np.pi * 2.4e3 * t), True),
        (lambda t: 0.0 * t + 0.3, True),
        (lambda t: 1e3 * t, True),
        (lambda t: 1.0 if t > 1.234e-3 else 0.0, True),
    ],
)
def test_a_function_of_time_that_the_step_does_not_follow_is_refused(load, follows):
    """50 us a step: 8 steps in a period are 2.5 kHz, and 20 kHz repeat with each step."""
    system, plan = LapJoint(elements=5).system, Plan(5e-5, 100)
    system = replace(system, loads=(sj.AppliedLoad(np.eye(system.n)[-1], load, "tip"),))
    if follows:
        check_resolution(system, plan)
        return
    with pytest.raises(sj.InputError, match="load on 'tip': a step of 5e-05 s does not") as caught:
        check_resolution(system, plan)
    shorter = float(re.search("a step of at most (.*) s", str(caught.value))[1])
    check_resolution(system, Plan(shorter, math.ceil(5e-3 / shorter)))


@pytest.mark.parametrize(
    ("load", "says"),
    [
        # The run goes from 0 to 5 ms.
        (sj.Table([10.0, 10.001], [1.0, 0.0]), "10 to 10.001 s, .* nothing of it acts"),
        (sj.Table([-2.0, -1.0], [1.0, 1.0]), "-2 to -1 s, .* nothing of it acts"),
        (sj.Table([0.0, 2.5, 5.0], [0.0, 1.0, 0.0]), r"ends before its last time, and only 0\.1 %"),
        (sj.Table([-5e-3, 5e-3], [0.0, 1.0]), "starts after its first time, and only 50 %"),
        (sj.Table([1e-3, 2e-3], [1.0, 0.0]), "jumps from zero at its first time"),
        (sj.Table([0.0, 2.5e-3], [0.0, 1.0]), "zero after its last time, in 50 % of the run"),
        (sj.Table([0.0, 5e-6, 9e-6], [0.0, 1.0, 0.0]), r"is zero after its last time, in 99\.8 %"),
        (Scaled(sj.Table([10.0, 11.0], [0.0, 1.0]), -3.0), "nothing of it acts"),
        (sj.HalfSine(1.0, 1e-3, start=6e-3), "0.006 to 0.008 s, .* nothing of it acts"),
        (sj.Table([0.0, 2.5e-3, 5e-3], [0.0, 1.0, 0.0]), None),
        (sj.Table([1e-3, 2e-3, 3e-3], [0.0, 1.0, 0.0]), None),
        (sj.HalfSine(1.0, 1e-3), None),
        (sj.Harmonic(1.0, 100.0), None),
    ],
)
def test_times_of_a_load_that_do_not_fit_the_run_are_said(load, says, caplog):
    system = LapJoint(elements=5).system
    system = replace(system, loads=(sj.AppliedLoad(np.eye(system.n)[-1], load, "tip"),))
    for run in (sj.integrate, sj.quasi_static):
        caplog.clear()
        with caplog.at_level("WARNING"):
            run(system, duration=5e-3, step=2e-6)
        notes = [r.getMessage() for r in caplog.records]
        assert len(notes) == (says is not None)
        if says is not None:
            assert notes[0].startswith("The load on 'tip' has times from ")
            assert re.search(f"{says}.* in another unit", notes[0])
