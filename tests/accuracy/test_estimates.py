"""Results know their errors: what is stated is what a run that has hardly any shows."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from benchmarks.estimates import judged
from joint_scenes import bar_scene, harmonic, lap_joint, plate, plate_scene
from reduced_joints import fig_18
from scipy import linalg

import skfem_joint as sj
from skfem_joint.accuracy.estimate import verification_run
from skfem_joint.reduction.missing_modes import Residual, stride
from skfem_joint.results.history import QUANTITIES, difference, results
from skfem_joint.study import accuracy
from skfem_joint.study.models import plan_of


def pulse(**changes: Any) -> dict[str, Any]:
    shape = {"on": "free_end", "kind": "triangle", "peak": 87.5e3, "rise_time": 4e-5}
    return shape | changes


@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"load": [harmonic(frequency=0.1)]},  # the law creeps everywhere
        {"load": [harmonic(frequency=2500.0)]},  # gross slip
        {
            "load": [harmonic(amplitude=2e4), pulse(start=0.012)],  # after the probe's four cycles
            "time": {"duration": 0.02, "step": 4e-6},
        },
        {"reduction": {"reference": "paper", "active_length": 0.03}},
    ],
    ids=["harmonic", "creep", "gross slip", "late load", "wrong active length"],
)
def test_errors_of_a_basis_are_stated_without_a_full_run(changes):
    one = judged(bar_scene("reduced", **({"time": {"cycles": 4}} | changes)))
    for name in ("displacement_rms", "friction_energy"):
        stated, true = one.stated[name], one.true[name]
        assert true > 0.01
        assert 0.5 * true < stated < 2.0 * true


def test_residual_of_a_whole_basis_vanishes_and_that_of_a_part_is_orthogonal_to_it():
    scene = lap_joint(bar="short_lap_joint", beta=1e4, time={"cycles": 1, "steps_per_cycle": 50})
    system, plan = scene.system(), plan_of(scene)
    whole = linalg.eigh(system.K.toarray(), system.M.toarray())[1]
    residual = Residual(system)
    for V, lacking in ((whole, False), (whole[:, :10], True)):
        run = verification_run(system.project(V), plan, fields_every=stride(50, 50))
        left = residual.forces(V, run)
        scale = np.abs(system.load_vectors() @ system.load_amplitudes(run.field_times)).max()
        assert np.abs(V.T @ left).max() < 1e-8 * scale * np.abs(V).max()
        assert (np.abs(left).max() > 1e-3 * scale) == lacking
        lacks = residual.missing_modes(V, run, 4, V[:, :0])
        assert lacks.shape == (system.n, 4 * lacking)
        assert np.abs(V.T @ (system.M @ lacks)).max(initial=0.0) < 1e-9


def test_the_error_of_few_unknowns_does_not_depend_on_the_basis():
    """Of 13 unknowns the basis spans most: what is left of known motions is all but round-off."""
    mesh = sj.build_bar([("joint", 0.101, 13)], {"fixed": 0.0, "free_end": 0.101})
    shape = {"kind": "triangle", "peak": 8.8e3, "rise_time": 1.35e-5, "start": 1.3e-4}
    tables = {
        "joint": [{"on": "joint", "pressure": 1.1e7, "friction": 0.7, "law": "coulomb"}],
        "damping": {"stiffness": 2e-6},
        "load": [{"on": "free_end"} | shape],
        "time": {"duration": 2.8e-4, "step": 9.6e-7},
        "reduction": {"reference": "paper", "modes": 12, "friction_points": "all"},
    }
    one = judged(bar_scene("reduced", bar=mesh, **tables))
    assert not one.refused
    assert None not in one.stated.values()


def test_missing_modes_reduce_the_error_of_a_basis_to_a_fraction():
    scene = bar_scene("reduced")
    system, plan = scene.system(), plan_of(scene)
    V = sj.reduce(system, 4, interface_modes=0).origin.basis.V
    full, residual = results(verification_run(system, plan)), Residual(system)
    fields = stride(plan.n_steps, 200)
    errors = []
    for _ in range(3):
        run = verification_run(system.project(V), plan, fields_every=fields)
        errors.append(difference(full, results(run))["displacement_rms"] or 0.0)
        V = np.hstack([V, residual.missing_modes(V, run, 8, V[:, :0])])
    assert errors[1] < 0.4 * errors[0]
    assert errors[2] < 0.5 * errors[1]


def test_the_error_of_merged_points_is_stated():
    """Of 1,100 points, more than a condensed model takes and than stay unmerged in an estimate."""
    made, _ = fig_18()
    mesh = sj.build_bar([("joint", 0.1, 1100), ("linear", 0.5, 50)], {"start": 0.0, "end": 0.6})
    system = replace(made, mesh=mesh).system([sj.Load("end", sj.Harmonic(87.5e3, 500.0))])
    few = sj.reduce(system, friction_points=20)
    every = sj.reduce(system, friction_points="all", beta=few.contact.steepest)
    run, whole = (sj.integrate(one, cycles=3, steps_per_cycle=100) for one in (few, every))
    true, stated = difference(results(whole), results(run)), sj.estimate(run).parts["points"]
    for name in QUANTITIES:
        assert 0.5 * true[name] - 1e-4 < stated[name] < 2.0 * true[name] + 5e-3
    assert max(stated.values()) > 1e-4


@pytest.mark.parametrize(("frequency", "cycles"), [(500.0, 4), (2200.0, 12)])
def test_verification_runs_end_where_the_reduced_run_has_settled(frequency, cycles):
    damping = 1e-5 if cycles == 4 else 1e-7
    made = replace(fig_18()[0], stiffness_damping=damping)
    system = made.system([sj.Load("end", sj.Harmonic(87.5e3, frequency))]).with_beta(np.inf)
    taken: list[int] = []
    run = sj.integrate(sj.reduce(system), cycles=12, steps_per_cycle=100)
    sj.estimate(run, progress=lambda done, steps, *_: done == steps and taken.append(steps))
    assert taken[-2:] == [200 * cycles, 400 * cycles]  # half and a quarter of the step
    assert set(taken[:-2]) == {100 * cycles}  # the run itself is not made again


def test_an_error_beyond_five_percent_is_reported_with_its_source_and_cure():
    few = {"reference": "paper", "active_length": 0.03}
    (told,) = [w for w in sj.run_scene(bar_scene("reduced", reduction=few)).notes if "errs by" in w]
    assert "friction energy of the reduced model" in told
    assert "from its basis: it lacks slip of the joint" in told


def test_an_accuracy_that_is_asked_for_is_met():
    asked = {"displacement": 0.005, "energy": 0.01}
    time = {"cycles": 2, "steps_per_cycle": 60}
    scene = plate_scene(mesh=plate(6), time=time, accuracy=asked, reduction={"modes": 4})
    study = sj.run_scene(scene)
    truth = results(verification_run(study.system, plan_of(study.scene).finer(8)))
    for model in study.models.values():
        off = difference(truth, results(model.run))
        for name, error in off.items():
            assert error <= 1.5 * asked["energy" if "energy" in name else "displacement"]
    chosen = [w for w in study.notes if w.startswith("For the accuracy asked for")]
    assert len(chosen) == 2


@pytest.mark.parametrize(
    ("time", "load", "asked", "step"),
    [
        ({"cycles": 4, "steps_per_cycle": 25}, harmonic(), {"energy": 0.003}, 2e-5),
        ({"duration": 6e-3, "step": 1e-3}, pulse(rise_time=4e-4), {"displacement": 0.05}, 2e-4),
    ],
)
def test_a_step_too_long_is_shortened_where_an_accuracy_is_asked_for(time, load, asked, step):
    study = sj.run_scene(bar_scene("full", load=[load], time=time, accuracy=asked))
    total = study.models["full"].estimate.parts["total"]
    assert study.scene.time_step <= step
    for name, error in total.items():
        assert error <= asked.get("energy" if "energy" in name else "displacement", np.inf)


def test_an_accuracy_out_of_reach_is_refused(monkeypatch):
    monkeypatch.setattr(accuracy, "ROUNDS", 1)
    with pytest.raises(sj.ConvergenceError, match="still errs by an estimated") as caught:
        sj.run_scene(bar_scene("reduced", accuracy={"energy": 1e-6}))
    assert caught.value.exit_status == 3
