"""The stated error of a full model's step: closed forms, runs with far smaller steps."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from bodies import MU, structure
from random_contact import random_contact
from reduced_joints import fig_18
from stepping_systems import oscillator

import skfem_joint as sj
from skfem_joint.accuracy.ladder import HALVED, STEP, Rung, errors_of
from skfem_joint.results.history import QUANTITIES, difference, results


def driven(system: sj.System, frequency: float, steps: int) -> float:
    """Stated error of the history of steady vibration."""
    period = {"step": 1.0 / frequency / steps, "n_steps": steps, "cycle_steps": steps}
    run = sj.integrate(system, **period, until="steady")
    return sj.estimate(run).of("total", "displacement_rms") or 0.0


def stated(run: sj.Run) -> tuple[dict[str, float | None], list[int]]:
    """Total error of a run, and the steps of each run that showed it."""
    taken = []

    def told(done: int, steps: int, *_: str) -> None:
        if done == steps:
            taken.append(steps)

    return sj.estimate(run, progress=told).parts["total"], taken


def receptance(frequency: float, natural: float, ratio: float, step: float = 0.0) -> complex:
    """Displacement of unit mass by unit force, exact or by the trapezoidal rule with a step.

    The rule replaces i omega by 2 i / step tan(omega step / 2).
    """
    own, omega = 2.0 * np.pi * natural, 2.0 * np.pi * frequency
    s = 1j * (2.0 / step * np.tan(0.5 * omega * step) if step else omega)
    return complex(1.0 / (own**2 + 2.0 * ratio * own * s + s**2))


@pytest.mark.parametrize("frequency", [0.4, 0.9, 1.0, 1.3])
@pytest.mark.parametrize("steps", [20, 60])
def test_the_error_of_a_driven_oscillator_is_that_of_the_trapezoidal_rule(frequency, steps):
    exact, found = (receptance(frequency, 1.0, 0.05, h) for h in (0.0, 1.0 / frequency / steps))
    stated = driven(oscillator(sj.Harmonic(1.0, frequency)), frequency, steps)
    assert stated == pytest.approx(abs(found / exact - 1.0), rel=0.15)


def test_a_higher_mode_that_twice_the_step_misses_is_stated():
    """The fifth harmonic meets a second mode, from whose resonance each step is off."""
    natural, ratios, base, steps = np.array([1.0, 2.5]), np.array([0.05, 0.01]), 0.5, 60
    parts = {1: 1.0, 5: 0.2}
    loads = sj.MultiHarmonic([sj.Harmonic(a, k * base) for k, a in parts.items()])
    own = 2.0 * np.pi * natural
    system = sj.System(
        M=np.eye(2),
        C=np.diag(2.0 * ratios * own),
        K=np.diag(own**2),
        contact=sj.Contact.none(2),
        loads=(sj.AppliedLoad(np.ones(2), loads, "both"),),
        P=np.ones((1, 2)),
        points=("both",),
    )

    def response(step: float) -> np.ndarray:
        amplitudes = zip(natural, ratios, strict=True)
        modes = list(amplitudes)
        return np.array(
            [a * sum(receptance(k * base, *m, step) for m in modes) for k, a in parts.items()]
        )

    def distance(one: np.ndarray, other: np.ndarray) -> float:
        return float(np.linalg.norm(one - other) / np.linalg.norm(other))

    h, exact = 1.0 / base / steps, response(0.0)
    true = distance(response(h), exact)
    assert distance(response(2.0 * h), response(h)) / 3.0 < 0.4 * true
    assert 0.8 * true < driven(system, base, steps) < 1.5 * true


def test_where_changes_grow_an_eighth_of_the_step_counts():
    # A mass bounces on a stop, eight steps in each touch: half and a quarter of the step change
    # little, by which less than half of the error would be stated.
    scene = random_contact(34)
    system, scheme = scene.system(), sj.generalized_alpha(scene.rho)

    def run(parts):
        plan = {"step": scene.step / parts, "n_steps": scene.n_steps * parts}
        return sj.integrate(system, **plan, scheme=scheme, save=sj.Save(every=parts))

    first = run(1)
    true = difference(results(run(32)), results(first))["loop_energy"]
    found, taken = stated(first)
    assert taken == [factor * scene.n_steps for factor in (2, 4, 8)]
    assert 0.5 * true < found["loop_energy"] < 2.0 * true


@pytest.mark.parametrize("steps", [8, 25, 50])
def test_the_error_of_the_time_step_of_a_resonant_joint_is_stated(steps):
    """A small model is run with half and quarter steps."""
    made, _ = fig_18()
    system = replace(made, stiffness_damping=1e-7).system(
        [sj.Load("end", sj.Harmonic(87.5e3, 2200.0))]
    )
    run = sj.integrate(system, cycles=40, steps_per_cycle=steps)
    found, taken = stated(run)
    truth = sj.integrate(system, cycles=40, steps_per_cycle=16 * steps, save=sj.Save(every=16))
    true = difference(results(truth), results(run))["displacement_rms"] or 0.0
    assert true > 0.04
    assert 0.5 * true < found["displacement_rms"] < 2.0 * true
    assert taken[:2] == [2 * 40 * steps, 4 * 40 * steps]


N = 32 * 64  # steps


def large(load: sj.Amplitude, damping: float = 1e-5) -> sj.System:
    """A plate of so many unknowns that its steps are halved by a reduced model."""
    mesh = sj.build_plate([("joint", 0.25, 16)], 0.05, 2)
    made = structure(mesh, [sj.Joint("joint", 8e6, MU)], stiffness_damping=damping)
    return made.system([sj.Load("right", load, (1.0, 0.0))])


@pytest.mark.slow
def test_a_reduced_model_takes_the_steps_of_a_large_one():
    """It states what the large one would by its own half and quarter steps."""
    system = large(sj.Harmonic(63e3, 1000.0))
    runs = [
        sj.integrate(system, cycles=32, steps_per_cycle=64 * k, save=sj.Save(every=k))
        for k in (1, 2, 4)
    ]
    found, taken = stated(runs[0])
    assert taken == [N, 2 * N, 4 * N]
    way = [Rung.of(STEP, *both, HALVED) for both in pairwise(map(results, runs))]
    own = errors_of(results(runs[0]), way)["total"]
    for name in QUANTITIES:
        assert found[name] == pytest.approx(own[name], rel=0.3, abs=1e-4)


@pytest.mark.parametrize("why", ["too poor", "no friction"])
def test_a_large_model_without_a_good_reduced_one_is_run_with_half_the_step(why):
    """Of a blow so short that it sets off all modes, or of no slips at all."""
    system = large(sj.Triangle(63e3, 4e-6), damping=1e-8)
    if why == "no friction":
        system = replace(system, contact=sj.Contact.none(system.n))
    run = sj.integrate(system, step=5e-7, n_steps=N)
    found, taken = stated(run)
    assert taken == [*([N, 2 * N, 4 * N] if why == "too poor" else []), 2 * N]
    half = sj.integrate(system, step=2.5e-7, n_steps=2 * N, save=sj.Save(every=2))
    true = difference(results(half), results(run))["displacement_rms"] or 0.0
    assert found["displacement_rms"] == pytest.approx(4.0 / 3.0 * true)
