"""Scenes to results: full and reduced models of every dimension, active parts, warnings."""

import json
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from joint_scenes import (
    ELEMENTS,
    LENGTH,
    MU,
    WIDTH,
    bar_scene,
    harmonic,
    joint,
    lap_joint,
    plate,
    plate_scene,
    two_plates,
)

import skfem_joint as sj
from skfem_joint.output.report import summary
from skfem_joint.results.contact_history import contact_history, displacements
from skfem_joint.results.history import Errors, difference, results
from skfem_joint.runs.integrate import integrate_plan
from skfem_joint.stepping.energy import AT_LIMIT
from skfem_joint.study.accuracy import Choice
from skfem_joint.study.models import save_of
from skfem_joint.study.study import make_model
from skfem_joint.study.summary import violated

GROSS, LARGE = (
    "slips: gross slip",
    "taken to be small",
)
MULTI_HARMONIC = {
    "on": "free_end",
    "kind": "multi_harmonic",
    "components": [
        {"amplitude": 60e3, "frequency": 300.0},
        {"amplitude": 20e3, "frequency": 900.0, "phase": 0.5},
    ],
}


UNESTIMATED: dict[str, Any] = {"accuracy": {"estimate": False}}


def run_bar(*run: str, **changes: Any) -> sj.Study:
    return sj.run_scene(bar_scene(*run, **UNESTIMATED, **changes))


def paper(**options: Any) -> dict[str, Any]:
    return {"reference": "paper"} | options


@pytest.fixture(scope="module")
def structure_study():
    return run_bar(output={"vtk": True, "frames": 50})


@pytest.fixture(scope="module")
def plates_study():
    output, reduction = {"vtk": True, "frames": 10}, {"modes": 10}
    return sj.run_scene(two_plates(output=output, reduction=reduction, **UNESTIMATED))


def errors_of(results: sj.Study) -> Errors:
    return results.models["reduced"].errors


def check_errors(results: sj.Study, peak: float, energy: float = 0.05, rms: float = 0.03) -> None:
    errors = errors_of(results)
    assert abs(errors.peak_displacement or np.inf) <= peak
    assert abs(errors.friction_energy_per_cycle or np.inf) <= energy
    assert errors.displacement_rms <= rms


def test_reduced_models_of_bars_and_plates_follow_the_full_ones(structure_study, plates_study):
    check_errors(structure_study, 2e-3)
    assert errors_of(structure_study).by_point["free_end"][0] <= 2e-3
    check_errors(plates_study, 5e-4, 0.005, 1e-3)
    said = " ".join(structure_study.notes)
    assert not any(words in said for words in ("slip as a whole", "steady", GROSS, LARGE))


@pytest.mark.parametrize("what", ["structure_study", "plates_study"])
def test_energy_balances_close_and_joints_add_up(what, request):
    results: sj.Study = request.getfixturevalue(what)
    for model in results.models.values():
        assert model.run.energy_residual < 1e-9
        friction = model.run.friction_work.sum()
        assert 0.0 < friction < model.run.input_work.sum()
        by_joint = model.run.friction_energy
        assert sum(by_joint.values()) == pytest.approx(friction, rel=1e-12)
        run = model.run
        assert run.joint_work[-1].tolist() == pytest.approx(list(by_joint.values()), rel=1e-12)
        ends = run.joint_work[:: results.scene.cycle_steps].sum(axis=1)[1:]
        assert ends == pytest.approx(run.cycles.friction.cumsum(), rel=1e-12)
        assert run.cycles.by_joint.sum(axis=1) == pytest.approx(run.cycles.friction, rel=1e-12)
        farthest = [run.slip_peak[points].max() for points in run.system.contact.joint_points]
        assert run.joint_slip.max(axis=0) == pytest.approx(farthest, rel=1e-12)
        frames = np.searchsorted(run.times, run.field_times * (1.0 - 1e-9))
        contact = run.system.contact
        reached = contact.slip_norm(run.sigma) >= AT_LIMIT
        share = (reached * contact.w) @ contact.J.T / (contact.J @ contact.w)
        assert run.joint_slipping[frames] == pytest.approx(share, abs=1e-12)
        assert 0.0 < share.max() < 1.0
        work = contact_history(results.structure, run).work
        assert work.shape[1] == results.system.contact.w.size
        joints = work @ results.system.contact.J.T
        assert np.all(np.diff(joints, axis=0) >= -1e-9 * friction)
        assert joints[-1].tolist() == pytest.approx(list(by_joint.values()), rel=1e-9)


FEW: dict[str, Any] = {"time": {"cycles": 6}}
LITTLE: dict[str, Any] = {"load": [harmonic(amplitude=500.0)], "time": {"cycles": 3}}
ENDS = [harmonic("loaded_end", 80e3, 300.0), harmonic("free_end", 87.5e3, 300.0)]
INNER: dict[str, Any] = FEW | {"bar": "inner_joint"}
#: Scenes of bars and the largest errors of their reduced models: peak, friction energy, history.
SOUND: dict[str, tuple[dict[str, Any], tuple[float, ...]]] = {
    "friction at every node": ({"reduction": paper(friction_points="all")}, (2e-3,)),
    "load spread along a region": ({"load": [harmonic("linear")]}, (4e-3,)),
    "several harmonics": (FEW | {"load": [MULTI_HARMONIC]}, (1e-3,)),
    "joint pulled at both ends": (INNER | {"load": ENDS}, (1e-3,)),
    "joint pulled at one end": (INNER | {"load": ENDS[1:], "output": {"every": 10}}, (1e-3,)),
    # 0.3 mm of slip, while elements are 1 mm or 25 mm long.
    "little slip": (LITTLE, (1e-3,)),
    "little slip on few elements": (LITTLE | {"bar": "coarse"}, (1e-6, 1e-6, 1e-4)),
}


@pytest.mark.parametrize(("changes", "allowed"), SOUND.values(), ids=SOUND)
def test_reduced_models_follow_the_full_ones_under_other_loads_and_reductions(changes, allowed):
    check_errors(run_bar(**changes), *allowed)


def test_two_joints_each_have_their_active_length_and_energy():
    joints, load = [joint("left"), joint("right")], [harmonic("centre", 150e3)]
    results = run_bar(**FEW, bar="two_joints", joint=joints, load=load)
    # The far end of a joint, at rest, does not count.
    check_errors(results, 1e-3)
    length = results.models["reduced"].active_length
    # Symmetric but for the fixed node.
    assert length["left"] == pytest.approx(length["right"], rel=0.02)
    assert length["left"] == pytest.approx(0.5 * 150e3 / 1.75e6, rel=0.1)
    for one in results.models.values():
        energy = one.run.friction_energy
        assert energy["left"] == pytest.approx(energy["right"], rel=0.03)


@pytest.mark.parametrize(
    ("limit", "pressure", "bar"), [(175e3, 50e6, "structure"), (70e3, 8e6, "lap_joint")]
)
@pytest.mark.parametrize("frequency", [100.0, 0.1])
def test_gross_slip_of_a_bar_warns_at_every_frequency(limit, pressure, bar, frequency):
    joints = [joint(pressure=pressure, law="coulomb")]
    for share in (0.8, 1.2):
        load = [harmonic(amplitude=share * limit, frequency=frequency)]
        results = run_bar("full", bar=bar, load=load, joint=joints, time={"cycles": 2})
        said = any(one.startswith("Nearly every point of joint 'joint'") for one in results.notes)
        assert said == (share > 1.0)


def test_gross_slip_of_a_plate_warns_at_every_frequency():
    """Of a plate that friction alone holds in x."""

    def said(amplitude, frequency=1000.0):
        load = [harmonic("right", amplitude, frequency) | {"direction": [1.0, 0.0]}]
        tables = {"support": {"fixed_y": ["joint"]}} | UNESTIMATED
        return " ".join(sj.run_scene(plate_scene("full", mesh=plate(5), load=load, **tables)).notes)

    force = 1.2 * MU * 8e6 * WIDTH * LENGTH
    assert GROSS in said(force)
    assert LARGE not in said(force)
    assert GROSS in said(force, 0.01)
    assert "a tenth of the structure's 0.25 m" in said(force, 0.01)
    assert GROSS not in said(20e3)


def test_notes_of_the_mesh_and_keys_without_effect_are_reported():
    note = "Edges were made straight."
    results = sj.run_scene(
        plate_scene(
            mesh=replace(plate(4), notes=(note,)),
            time={"cycles": 1, "steps_per_cycle": 40},
            reduction={"active_length": 0.1, "modes": 4},
            **UNESTIMATED,
        )
    )
    assert note in results.notes
    assert any("reduction.active_length has no effect" in one for one in results.notes)


def test_steady_vibration_is_separated_from_an_offset_that_depends_on_its_past():
    upper = {"on": "upper_joint", "against": "joint", "pressure": 1e6, "friction": MU}
    loads = [
        harmonic("upper_right", 7e3, 1500.0) | {"direction": [1.0, 0.0]},
        harmonic("upper_right", 4e3, 3000.0) | {"direction": [1.0, 0.0], "phase": 1.0},
    ]
    for count, says in ((1, "its offset depends on how that began"), (2, "model drifts")):
        scene = two_plates(
            "full",
            joint=[upper | {"law": "coulomb"}],
            load=loads[:count],
            time={"until": "steady", "steps_per_cycle": 60},
            damping={"ratio": 2e-2},
            output={"points": ["upper_right"]},
            **UNESTIMATED,
        )
        results = sj.run_scene(scene)
        assert sum(says in one for one in results.notes) == 1
        model = summary(results)["models"]["full"]
        for values in (model["amplitude_m"], model["offset_m"], model["drift_per_period_m"]):
            assert "upper_right" in values
        half = 0.5 * np.ptp(results.models["full"].run.point("upper_right"))
        if count == 1:
            assert model["amplitude_m"]["upper_right"] == pytest.approx(half, rel=1e-9)
            assert abs(model["offset_m"]["upper_right"]) < 1e-3 * half
    assert summary(run_bar("full"))["models"]["full"]["amplitude_m"] is None


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"load": [harmonic(amplitude=0.0)]}, r"nothing moves|no force|loads are zero"),
        ({"load": [harmonic(amplitude=0.0)], "reduction": {"reference": "self"}}, "nothing moves"),
        ({"reduction": paper(modes=10**6)}, r"reduction\.modes: found 1000000, must be"),
    ],
)
def test_reductions_that_have_nothing_to_go_by_are_refused_after_the_full_model(changes, words):
    results = run_bar(bar="coarse", **({"time": {"cycles": 1}} | changes))
    assert list(results.models) == ["full"]
    assert results.failure.model == "reduced"
    with pytest.raises(sj.InputError, match=words):
        results.finished()
    assert any(one.startswith("There is no reduced model: ") for one in results.notes)


def test_a_joint_without_friction_does_not_slip_as_a_whole():
    study = run_bar("full", bar="coarse", joint=[joint(friction=0.0)], time={"cycles": 1})
    assert any("carries no friction" in note for note in study.notes)
    assert not any(GROSS in note for note in study.notes)


LOOSE_BOLTS = {"bolts": [{"at": [0.1, 0.025], "force": 0.0, "head_radius": 0.01}]}


@pytest.mark.parametrize("name", ["nope", "upper_right"])
def test_stress_of_what_is_no_region_is_refused_before_the_run(name):
    scene = two_plates("full").changed(output={"stress": [name]})
    with pytest.raises(sj.InputError, match=f"output.stress: found '{name}'.* a region is needed"):
        scene.system()


@pytest.mark.parametrize("pressure", [0.0, LOOSE_BOLTS])
def test_without_pressure_the_full_model_alone_is_computed(pressure):
    free = {"on": "joint", "friction": MU, "pressure": pressure}
    tables = {"joint": [free], "time": {"cycles": 1}}
    scene = plate_scene("full", "condensed", "reduced", **tables)
    study = sj.run_scene(scene)
    (model,) = json.loads(json.dumps(summary(study)))["models"].values()
    assert study.failure is None
    notes = "\n".join(study.notes)
    assert "models.run: 'condensed' and 'reduced' left out" in notes
    assert ("has a force of 0 N: it presses nothing" in notes) == (pressure == LOOSE_BOLTS)
    assert "refine" not in notes
    bare = sj.run_scene(plate_scene("full", joint=[], time={"cycles": 1})).runs["full"]
    assert np.array_equal(study.runs["full"].point_u, bare.point_u)
    assert model["joints"]["joint"].get("friction_energy_by_bolt_J", [0.0]) == [0.0]
    with pytest.raises(sj.InputError, match="needs friction in a joint"):
        sj.run_scene(plate_scene("reduced", **tables))


@pytest.mark.parametrize("what", ["structure_study", "plates_study"])
def test_fields_of_the_reduced_model_are_those_of_the_mesh(what, request):
    results: sj.Study = request.getfixturevalue(what)
    made = results.structure
    full, reduced = (displacements(made, results.runs[name]) for name in ("full", "reduced"))
    assert full[0].shape == reduced[0].shape
    assert full[0].shape[1:] == made.nodes.shape
    assert np.abs(full[0] - reduced[0]).max() < 0.02 * np.abs(full[0]).max()
    # Slips are the relative displacements of the nodes in contact, in their directions.
    for model in results.models.values():
        displacement = displacements(made, model.run)[0]
        found = contact_history(made, model.run)
        for patch in made.patches:
            relative = patch.relative(displacement)
            rows = results.system.contact.first_row[patch.points]
            along = np.einsum("fkx,kx->fk", relative, patch.directions[:, 0])
            np.testing.assert_allclose(found.slip[:, rows], along, atol=1e-12 * np.abs(along).max())
        assert np.abs(found.friction).max() <= 1.0 + 1e-12


def test_reduced_beta_follows_the_slip_velocity_and_is_reported():
    told = run_bar("reduced", time={"cycles": 2})
    assert any("uses beta = " in warning for warning in told.notes)
    assert np.all(told.models["reduced"].run.system.contact.beta < 1e5)
    asked = run_bar("reduced", time={"cycles": 2}, reduction=paper(beta=2e4))
    assert np.all(asked.models["reduced"].run.system.contact.beta == 2e4)
    assert not any("uses beta" in warning for warning in asked.notes)


@pytest.mark.parametrize("law", [{}, {"law": "coulomb"}], ids=["arctan", "coulomb"])
def test_plate_without_poisson_effect_is_the_bar(law):
    contact = {"on": "joint", "pressure": 8e6, "friction": MU} | law
    results = sj.run_scene(plate_scene(joint=[contact], **UNESTIMATED))
    strut = run_bar(
        "full",
        bar=sj.build_bar([("joint", LENGTH, ELEMENTS)], {"fixed": 0.0, "right": LENGTH}),
        joint=[contact],
        load=[harmonic("right", 63e3, 1000.0)],
        time={"cycles": 3, "steps_per_cycle": 100},
    )
    full, bar = results.models["full"], strut.models["full"]
    assert full.run.friction_work.sum() == pytest.approx(bar.run.friction_work.sum(), rel=1e-9)
    off = full.run.point_u[:, 0] - bar.run.point_u[:, 0]
    assert np.abs(off).max() < 1e-10 * bar.run.peak[0]
    assert bar.active_length["joint"] / LENGTH == pytest.approx(
        full.active_area_fraction["joint"], abs=1.5 / ELEMENTS
    )
    assert bar.active_area_fraction["joint"] == pytest.approx(
        full.active_area_fraction["joint"], rel=1e-9
    )
    assert full.active_length == {}
    assert results.models["reduced"].modes == 12 + 1
    check_errors(results, 2e-3, 0.01, 0.005)


def test_modes_of_the_paper_laid_along_the_axis_of_a_joint():
    contact = {"on": "joint", "pressure": 8e6, "friction": MU, "beta": 1e5, "axis": [-1.0, 0.0]}
    load = [harmonic("right", 30e3, 1000.0) | {"direction": [1.0, 0.0]}]
    active = []
    for length in ({}, {"active_length": 0.15}, {"active_length": {"joint": 0.15}}):
        tables = {"reduction": paper(modes=5, **length)} | UNESTIMATED
        results = sj.run_scene(plate_scene(joint=[contact], load=load, **tables))
        check_errors(results, 0.02)
        active.append(results.models["reduced"].active_length["joint"])
    assert active[1:] == [0.15, 0.15]
    # 30 kN over the friction limit per length, 0.7 * 8 MPa * 0.05 m, is 0.107 m.
    expected = 30e3 / (MU * 8e6 * WIDTH)
    assert active[0] == pytest.approx(expected, rel=0.02)
    # The full model's, of the last run, is measured along the same axis.
    assert results.models["full"].active_length["joint"] == pytest.approx(expected, rel=0.03)


class StopAt:
    """Progress that interrupts a model at its n-th call, as Ctrl-C does."""

    def __init__(self, label: str, call: int) -> None:
        self.label, self.left = label, call

    def __call__(self, label: str, done: int, total: int) -> None:
        self.left -= label == self.label
        if self.left == 0:
            raise KeyboardInterrupt


@pytest.mark.parametrize("model", ["full", "reduced"])
def test_an_interrupted_study_holds_what_was_done(model):
    scene = bar_scene(bar="coarse", time={"cycles": 60}, reduction={"reference": "static"})
    results = sj.run_scene(scene, StopAt(f"{model} model", 2))
    assert results.interrupted
    *whole, last = results.models.values()
    assert [one.run.counters.steps for one in whole] == [scene.n_steps] * (model == "reduced")
    assert last.run.interrupted
    assert last.errors is None
    done = last.run.counters.steps
    assert 0 < done < scene.n_steps
    assert last.run.times.size == done + 1
    assert last.run.cycles.friction.size == done // 200
    assert f"{model} model at t = {done * scene.time_step:.6g} s" in results.notes[-1]


class Interrupting:
    """A quasi-static path that interrupts where it is followed, as Ctrl-C does."""

    def __getattr__(self, name: str) -> Any:
        raise KeyboardInterrupt


def test_interruption_while_the_modes_are_made_is_not_swallowed():
    full = sj.run_scene(bar_scene("full", time={"cycles": 2}, reduction={"reference": "static"}))
    how = Choice(full.scene, path=Interrupting()), integrate_plan
    results = make_model("reduced", full, *how)
    assert results.interrupted
    assert list(results.models) == ["full"]
    with pytest.raises(KeyboardInterrupt):
        results.finished()
    with pytest.raises(KeyboardInterrupt):
        make_model("reduced", replace(full, models={}), *how)


@pytest.mark.parametrize(
    ("scene", "words"),
    [
        (bar_scene("full"), r"step 7 .* node 200, at \(0\.6\) m\.$"),
        (plate_scene("full", mesh=plate(4)), r"step 7 .* node 12, at \(0\.25, 0\) m\.$"),
    ],
    ids=["bar", "plate"],
)
def test_step_that_does_not_converge_names_the_place(scene, words):
    unknown = int(np.flatnonzero(scene.system().loads[0].vector)[0])

    def fail(*_, **__):
        raise sj.ConvergenceError("step 7 at t = 1e-5 s did not converge.", unknown)

    study = sj.Study(scene, scene.structure(), scene.system())
    with pytest.raises(sj.ConvergenceError, match=words) as caught:
        make_model("full", study, Choice(scene), fail)
    assert caught.value.exit_status == 3


def test_frames_of_a_long_run_go_through_all_phases_of_the_load():
    time, output = {"cycles": 300, "steps_per_cycle": 40}, {"plots": True, "frames": 100}
    stride = save_of(bar_scene(time=time, output=output)).strides[1]
    assert 300 * 40 // 100 < stride <= 300 * 40 // 100 + 40
    assert {stride * k % 40 for k in range(20)} == set(range(0, 40, 2))


def test_the_larger_of_the_stated_and_the_measured_error_counts():
    coarse: dict[str, Any] = {"modes": 1, "interface_modes": 0, "friction_points": 3}
    scene = lap_joint(
        "full", "reduced", bar="short_lap_joint", reduction={"reference": "static"} | coarse
    )
    study = sj.run_scene(scene)
    full, model = (study.models[name] for name in ("full", "reduced"))
    found, apart = model.estimate, difference(*(results(study.models[k].run) for k in study.models))
    assert found.parts["full_run"] == apart
    assert any(found.unmeasured[name] < apart[name] for name in apart)
    (said,) = [text for text in study.notes if "full one that was run beside it" in text]
    for name, measured in apart.items():
        larger = max(measured, found.unmeasured[name])
        assert found.on_its_mesh[name] == pytest.approx(larger, rel=1e-12)
        told = f"its {name.replace('_', ' ')} by {100 * measured:.3g} %" in said
        assert told == (measured > found.unmeasured[name])
    assert full.estimate.unmeasured is None
    asked = replace(study, scene=scene.changed(accuracy={"displacement": 0.06, "energy": 0.07}))
    (said,) = [text for text in violated(asked, model) if "run beside it" in text]
    limits = {"displacement_rms": 0.06, "peak_displacement": 0.06}
    over = {name for name in apart if apart[name] > limits.get(name, 0.07)}
    assert 1 <= len(over) == said.count("% asked for") <= 4


def test_merged_contact_points_all_slip_as_their_point_does():
    """Each was taken to slip by its share: 40 % of the joint were active, 60 in the full model."""
    bar = sj.build_bar([("joint", 0.25, 24)], {"fixed": 0.0, "free_end": 0.25})
    scene = bar_scene(
        bar=bar,
        joint=[joint(pressure=8e6, beta=1e3)],
        load=[harmonic(amplitude=43e3, frequency=1000.0)],
        time={"cycles": 2, "steps_per_cycle": 50},
        models={"run": ["full", "condensed"], "contact_points": 6},
        accuracy={"estimate": False},
    )
    full, small = sj.run_scene(scene).models.values()
    assert small.active_area_fraction["joint"] == pytest.approx(
        full.active_area_fraction["joint"], abs=0.1
    )
