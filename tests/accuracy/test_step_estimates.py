"""The stated error of a full model's step: closed forms, and models in place of large ones."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from joint_scenes import bar_scene, harmonic, plate, plate_scene, steps_taken
from random_contact import random_contact
from stepping_systems import oscillator

import skfem_joint as sj
from skfem_joint.accuracy import estimate, rungs
from skfem_joint.accuracy.estimate import verification_run
from skfem_joint.accuracy.ladder import HALVED, STEP, Ladder
from skfem_joint.accuracy.rungs import of_full
from skfem_joint.ground.loads import Harmonic, MultiHarmonic
from skfem_joint.results.history import QUANTITIES, difference, results
from skfem_joint.stepping.plan import Plan
from skfem_joint.stepping.recording import Run
from skfem_joint.study.scene_plan import plan_of
from skfem_joint.study.study import run_scene
from skfem_joint.system.contacts import Contact
from skfem_joint.system.system import AppliedLoad, System


def driven(system: System, frequency: float, steps: int) -> float:
    """Stated error of the history of steady vibration."""
    plan = Plan(1.0 / frequency / steps, steps, cycle_steps=steps, until="steady")
    run = verification_run(system, plan)
    return of_full(system, run, plan).of("total", "displacement_rms") or 0.0


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
    stated = driven(oscillator(Harmonic(1.0, frequency)), frequency, steps)
    assert stated == pytest.approx(abs(found / exact - 1.0), rel=0.15)


def test_a_higher_mode_that_twice_the_step_misses_is_stated():
    """The fifth harmonic meets a second mode, from whose resonance each step is off."""
    natural, ratios, base, steps = np.array([1.0, 2.5]), np.array([0.05, 0.01]), 0.5, 60
    parts = {1: 1.0, 5: 0.2}
    loads = MultiHarmonic([Harmonic(a, k * base) for k, a in parts.items()])
    own = 2.0 * np.pi * natural
    system = System(
        M=np.eye(2),
        C=np.diag(2.0 * ratios * own),
        K=np.diag(own**2),
        contact=Contact.none(2),
        loads=(AppliedLoad(np.ones(2), loads, "both"),),
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


def by_finer_steps(run: Run, *finer: Run) -> sj.Estimate:
    """Errors of a run from those with half of its step, a quarter and so on."""
    way = Ladder(run)
    for better in finer:
        way.add(STEP, better, HALVED)
    return way.estimate()


def off(run: Run, error: float) -> Run:
    """Run whose results are all too large by a relative error."""
    cycles = replace(run.cycles, friction=run.cycles.friction * (1.0 + error))
    cycles = replace(cycles, input=run.cycles.input * (1.0 + error))
    cycles = replace(cycles, peak=run.cycles.peak * (1.0 + error))
    return replace(run, point_u=run.point_u * (1.0 + error), cycles=cycles)


@pytest.mark.parametrize("order", [1.0, 1.5, 2.0])
def test_errors_that_fall_with_an_order_between_one_and_two_are_stated_exactly(order):
    scene = bar_scene("full", bar="coarse", time={"cycles": 2, "steps_per_cycle": 20})
    run, error = verification_run(scene.system(), plan_of(scene)), 1e-4
    steps = [off(run, error * 0.5 ** (k * order)) for k in range(3)]
    stated = by_finer_steps(*steps).parts["total"]
    for name in QUANTITIES:
        assert stated[name] == pytest.approx(error, rel=1e-3)


def test_a_rest_of_no_common_sign_is_added_by_squares():
    scene = bar_scene("full", bar="coarse", time={"cycles": 2, "steps_per_cycle": 20})
    run = verification_run(scene.system(), plan_of(scene))
    # Changes of 1 and -2: a distance of 1, and a rest of 2 by the largest ratio of a half.
    turning = by_finer_steps(*(off(run, error) for error in (2e-4, 3e-4, 1e-4))).parts["total"]
    rising = by_finer_steps(*(off(run, error) for error in (0.0, 1e-4, 3e-4))).parts["total"]
    for name in QUANTITIES:
        assert turning[name] == pytest.approx(np.hypot(1e-4, 2e-4), rel=1e-3)
        assert rising[name] == pytest.approx(3e-4 + 2e-4, rel=1e-3)


def test_where_changes_grow_an_eighth_of_the_step_counts():
    # A mass bounces on a stop, eight steps in each touch: half of the step changes little at first.
    scene = random_contact(34)
    system, scheme = scene.system(), sj.generalized_alpha(scene.rho)

    def run(parts):
        plan = {"step": scene.step / parts, "n_steps": scene.n_steps * parts}
        return sj.integrate(system, **plan, scheme=scheme, save=sj.Save(every=parts))

    first, truth = run(1), results(run(64))
    true = difference(truth, results(first))["loop_energy"]
    finer = [run(2), run(4), run(8)]
    three, four = (
        by_finer_steps(first, *finer[:count]).of("total", "loop_energy") for count in (2, 3)
    )
    assert three < 0.5 * true
    assert four > 0.5 * true
    assert sj.estimate(first).of("total", "loop_energy") == pytest.approx(four, rel=1e-6)


def test_a_small_model_is_run_with_half_and_quarter_steps(monkeypatch):
    taken = steps_taken(monkeypatch, estimate)
    run_scene(bar_scene("full", time={"cycles": 2}))
    assert taken[:2] == [800, 1600]


@pytest.mark.parametrize("steps", [8, 25, 50])
def test_the_error_of_the_time_step_of_a_resonant_joint_is_stated(steps):
    resonant = {"load": [harmonic(frequency=2200.0)], "damping": {"stiffness": 1e-7}}
    scene = bar_scene("full", time={"cycles": 40, "steps_per_cycle": steps}, **resonant)
    plan, system = plan_of(scene), scene.system()
    run = verification_run(system, plan)
    stated = of_full(system, run, plan).of("total", "displacement_rms") or 0.0
    truth = results(verification_run(system, plan.finer(16)))
    true = difference(truth, results(run))["displacement_rms"] or 0.0
    assert true > 0.04
    assert 0.5 * true < stated < 2.0 * true


@pytest.fixture
def large(monkeypatch):
    """A plate that counts as large, its run, and the unknowns and steps of all runs after it."""
    scene = plate_scene("full", mesh=plate(10), time={"cycles": 3, "steps_per_cycle": 40})
    system, plan = scene.system(), plan_of(scene)
    run, taken = verification_run(system, plan), []
    real = estimate.integrate_plan

    def counted(one: System, two: Plan, **options: Any) -> Run:
        taken.append((one.n, two.n_steps))
        return real(one, two, **options)

    monkeypatch.setattr(estimate, "integrate_plan", counted)
    monkeypatch.setattr(rungs, "SMALL", 0.0)
    return system, plan, run, taken


def test_a_reduced_model_takes_the_steps_of_a_large_one(large):
    system, plan, run, taken = large
    stated = of_full(system, run, plan).parts["total"]
    assert all(n < system.n for n, _ in taken)
    assert [steps for _, steps in taken] == [120, 240, 480]
    finer = (verification_run(system, plan.finer(k)) for k in (2, 4))
    own = by_finer_steps(run, *finer).parts["total"]
    for name in QUANTITIES:
        assert stated[name] == pytest.approx(own[name], rel=0.3, abs=1e-4)


@pytest.mark.parametrize("why", ["too poor", "no friction"])
def test_a_large_model_without_a_good_reduced_one_is_run_with_half_the_step(
    large, why, monkeypatch
):
    system, plan, run, taken = large
    if why == "too poor":
        monkeypatch.setattr(rungs, "TRUSTED", 0.0)
        monkeypatch.setattr(rungs, "NEGLIGIBLE", 0.0)
    else:
        system = replace(system, contact=Contact.none(system.n))
        run = verification_run(system, plan)
        taken.clear()
    stated = of_full(system, run, plan).parts["total"]
    assert taken[-1] == (system.n, 240)
    half = results(verification_run(system, plan.finer(2)))
    true = difference(half, results(run))["displacement_rms"] or 0.0
    assert stated["displacement_rms"] == pytest.approx(4.0 / 3.0 * true)
