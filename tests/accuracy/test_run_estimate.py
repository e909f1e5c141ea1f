"""Errors of runs as `estimate` takes them: distance from Coulomb's law, models changed by hand."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from bodies import MU, structure
from joint_scenes import bar_scene, harmonic
from reduced_joints import fig_18
from scipy.sparse import csr_array

import skfem_joint as sj
from skfem_joint.accuracy.against_coulomb import _apart
from skfem_joint.output.report import estimate_table, summary
from skfem_joint.results.history import QUANTITIES, difference, results

STEPS = {"cycles": 5, "steps_per_cycle": 80}
Case = tuple[sj.System, dict[str, Any]]


def fig_18_of(beta: float, load: Any, **times: Any) -> Case:
    made, _ = fig_18()
    joints = [replace(joint, beta=beta) for joint in made.joints]
    return replace(made, joints=joints).system([sj.Load("end", load)]), times


def slow_plate(steps: int) -> Case:
    """A plate that creeps: pulled at 20 Hz."""
    mesh = sj.build_plate([("joint", 0.25, 16)], 0.05, 2)
    made = structure(mesh, [sj.Joint("joint", 8e6, MU, beta=1e5)], stiffness_damping=1e-5)
    load = sj.Load("right", sj.Harmonic(40e3, 20.0), (1.0, 0.0))
    return made.system([load]), {"cycles": 2, "steps_per_cycle": steps}


CASES: dict[str, Callable[[], Case]] = {
    "bar": lambda: fig_18_of(1e4, sj.Harmonic(87.5e3, 500.0), cycles=4, steps_per_cycle=100),
    "slow bar": lambda: fig_18_of(1e5, sj.Harmonic(87.5e3, 0.1), cycles=2, steps_per_cycle=100),
    "pulse": lambda: fig_18_of(1e3, sj.Triangle(87.5e3, 4e-5), duration=2e-3, step=4e-6),
    "plate": lambda: slow_plate(60),
    "large plate": lambda: slow_plate(460),
}


EXACT, NEAR = (0.97, 1.03), (0.5, 2.0)


@pytest.mark.parametrize(
    ("name", "model", "allowed"),
    [
        ("bar", "full", EXACT),
        ("bar", "reduced", NEAR),
        ("slow bar", "full", EXACT),
        ("slow bar", "condensed", NEAR),
        ("pulse", "full", EXACT),
        ("pulse", "reduced", NEAR),
        ("plate", "condensed", NEAR),
        ("large plate", "full", (0.8, 1.25)),
    ],
)
def test_the_distance_from_coulombs_law_is_that_of_full_runs(name, model, allowed):
    """A large full model is compared by a reduced one."""
    system, times = CASES[name]()
    coulomb, own = (sj.integrate(one, **times) for one in (system.with_beta(np.inf), system))
    true, run = difference(results(coulomb), results(own)), own
    if model == "condensed":
        run = sj.integrate(sj.condense(system), **times)
    elif model == "reduced":
        run = sj.integrate(sj.reduce(system, duration=times.get("duration")), **times)
    stated = sj.estimate(run)
    assert max(error or 0.0 for error in true.values()) > 0.02
    low, high = allowed
    for quantity in QUANTITIES:
        if (true[quantity] or 0.0) > 0.01:
            found = stated.of("coulomb", quantity)
            assert low <= found / true[quantity] <= high, (quantity, found, true[quantity])
            assert name != "large plate" or found != true[quantity]


@pytest.mark.parametrize("model", ["full", "condensed", "reduced"])
def test_what_a_scene_writes_does_not_change_what_it_knows_of_its_errors(model):
    tables = {"bar": "coarse", "time": {"cycles": 1, "steps_per_cycle": 40}, "reduction": {}}
    silent, shown = (
        sj.run_scene(bar_scene(model, output={"history": known, "plots": False}, **tables))
        for known in (False, True)
    )
    found = silent.models[model].estimate
    assert found.parts == shown.models[model].estimate.parts
    assert found.of("total", "displacement_rms") > 0.0


def test_it_is_no_part_of_the_total_and_is_said_where_it_is_large():
    slow = {"load": [harmonic(frequency=0.1)], "time": {"cycles": 2, "steps_per_cycle": 100}}
    study = sj.run_scene(bar_scene("full", "reduced", reduction={}, **slow))
    for model in study.models.values():
        total = model.estimate.of("total", "friction_energy")
        assert total < 0.01 < 0.5 < model.estimate.of("coulomb", "friction_energy")
    (said,) = [warning for warning in study.notes if "creeps" in warning]
    assert "beta = 1e+05" in said
    assert "Leave beta out" in said
    assert "full model, against Coulomb's law" in str(estimate_table(summary(study)))


def test_results_of_coulombs_law_are_compared_with_nothing_and_of_a_steep_one_with_little():
    system, times = CASES["bar"]()
    steep, coulomb = (
        sj.estimate(sj.integrate(system.with_beta(beta), **times)) for beta in (1e8, np.inf)
    )
    assert "coulomb" not in coulomb.parts
    assert 0.0 < steep.of("coulomb", "friction_energy") < 0.01


def test_energy_where_coulombs_law_loses_none_is_all_apart():
    system, times = CASES["bar"]()
    own = results(sj.integrate(system, **times))
    none = replace(own, friction_energy=0.0, loop_energy=0.0)
    parts = _apart(none, own)
    assert (parts["friction_energy"], parts["loop_energy"]) == (1.0, 1.0)
    assert parts["peak_displacement"] == 0.0


def bar(*betas: float) -> sj.System:
    """Bar pressed on a base in one joint or two, of one law each."""
    segments = [("joint", 0.2, 10), ("arm", 0.2, 10), ("second", 0.1, 5), ("tip", 0.2, 10)]
    joints = [
        sj.Joint(name, pressure=pressure, friction=0.6, beta=beta)
        for name, pressure, beta in zip(("joint", "second"), (8e6, 4e6), betas, strict=False)
    ]
    mesh = sj.build_bar(segments, {"fixed": 0.0, "free_end": 0.7})
    made = structure(mesh, joints, ["fixed"], stiffness_damping=1e-5)
    return made.system([sj.Load("free_end", sj.Harmonic(20e3, 300.0))])


def test_a_condensed_model_states_the_error_of_a_softer_law():
    system = bar(np.inf)
    softer = sj.integrate(sj.condense(system).with_beta(1e3), **STEPS)
    true = sj.compare(sj.integrate(system, **STEPS), softer).friction_energy_per_cycle
    errors = sj.estimate(softer)
    assert true > 0.3
    for source in ("law", "total"):
        assert 0.5 < errors.of(source, "friction_energy") / true < 3.0


@pytest.mark.parametrize("make", [lambda system: system, sj.condense, sj.reduce])
def test_joints_of_different_laws_are_compared_with_coulombs(make):
    system = bar(1e2, np.inf)
    errors = sj.estimate(sj.integrate(make(system), **STEPS))
    true = sj.compare(
        sj.integrate(system.with_beta(np.inf), **STEPS), sj.integrate(system, **STEPS)
    ).friction_energy_per_cycle
    assert errors.of("coulomb", "friction_energy") == pytest.approx(true, rel=0.2)


def test_a_reduced_model_makes_no_law_steeper():
    system = bar(10.0, np.inf)
    reduced = sj.reduce(system, friction_points="all", beta=1e4)
    assert set(reduced.contact.beta) == {10.0, 1e4}


def test_laws_are_compared_until_the_cycles_of_both_are_alike():
    """A lightly damped bar builds up for longer under Coulomb's law than under the own one."""
    made = bar(1e2)
    lightly = replace(made, C=1e-2 * made.C)
    frequency = sj.natural_modes(lightly, 1).frequencies[0]
    load = replace(lightly.loads[0], amplitude=sj.Harmonic(3e3, frequency))
    system = replace(lightly, loads=(load,))
    laws = (system, system.with_beta(np.inf))
    run, coulomb = (sj.integrate(law, cycles=40, steps_per_cycle=60) for law in laws)
    true = run.cycles.friction[-1] / coulomb.cycles.friction[-1] - 1.0
    assert true > 1.0
    assert sj.estimate(run).of("coulomb", "friction_energy") == pytest.approx(true, rel=0.02)


@pytest.mark.parametrize("changed", ["C", "K"])
@pytest.mark.parametrize("make", [sj.condense, sj.reduce])
def test_a_model_whose_matrices_were_changed_is_refused(make, changed):
    small = make(bar(1e3))
    other = replace(small, **{changed: 1.5 * getattr(small, changed)})
    run = sj.integrate(other, **STEPS)
    with pytest.raises(sj.InputError, match="matrices"):
        sj.estimate(run)


def test_points_that_share_an_unknown_are_compared_with_a_steep_law():
    # No set-valued law can be followed there, so that a steep one stands for it.
    pull = sj.AppliedLoad(np.ones(1), sj.Harmonic(3.0, 0.5), "mass")

    def stated(w, of):
        one, rows = of(np.ones((1, 1))), of(np.ones((len(w), 1)))
        given = one, 0.1 * one, 40.0 * one, sj.Contact(rows, w, 20.0), (pull,), one, ("mass",)
        run = sj.integrate(sj.System(*given), cycles=3, steps_per_cycle=100)
        return sj.estimate(run).of("coulomb", "friction_energy")

    two = stated([0.5, 1.0], csr_array)
    assert two == pytest.approx(stated([0.5, 1.0], np.array), rel=1e-6)
    assert two == pytest.approx(stated([1.5], csr_array), rel=0.05)


def test_a_dense_model_of_contact_apart_at_rest_is_compared_with_a_steep_law():
    # Nothing is pressed before it is closed: no friction limit at rest says what carries friction.
    eye = np.eye(2)
    apart = sj.NormalPart(eye[1:], np.array([0.01]), np.zeros(1), np.array([1e3]), np.ones(1))
    contact = sj.Contact(eye[:1], [0.0], 20.0, normal=apart, gain=csr_array([[0.3]]))
    push = sj.AppliedLoad(np.array([1.0, 2.0]), sj.Harmonic(2.0, 0.5), "mass")
    matrices = eye, 0.1 * eye, 20.0 * eye
    system = sj.System(*matrices, contact, loads=(push,), P=eye, points=("x", "y"))
    run = sj.integrate(system, cycles=3, steps_per_cycle=100)
    assert run.friction_work[0] > 0.0
    stated = sj.estimate(run).of("coulomb", "friction_energy")
    steep = sj.integrate(system.with_beta(2e4), cycles=3, steps_per_cycle=100)
    true = sj.compare(steep, run).friction_energy_per_cycle
    assert stated == pytest.approx(abs(true), rel=1e-6)
