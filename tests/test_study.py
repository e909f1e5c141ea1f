"""Scenes from file to results: full and reduced models, active lengths, warnings."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from skfem_joint import output, study
from skfem_joint import reference as reference_module
from skfem_joint import results as results_module
from skfem_joint.errors import ConvergenceError, InputError
from skfem_joint.history import Errors
from skfem_joint.meshing import build_bar, write_mesh
from skfem_joint.scene import load_scene
from skfem_joint.study import Study, run_scene

ROOT = Path(__file__).parent.parent
GROSS = "the paper's assumption of no gross slip is violated"

Regions = list[tuple[str, float, int]]
Run = Callable[..., Study]

#: Regions and points of bars beside those of ``meshes/``; all are held at ``fixed``.
BARS: dict[str, tuple[Regions, dict[str, float]]] = {
    "two_joints": (
        [("left", 0.1, 50), ("middle", 0.4, 40), ("right", 0.1, 50)],
        {"fixed": 0.0, "centre": 0.3, "end": 0.6},
    ),
    "inner_joint": (
        [("a", 0.2, 20), ("joint", 0.2, 100), ("b", 0.2, 20)],
        {"fixed": 0.0, "mouth": 0.2, "free_end": 0.6},
    ),
    "coarse": (
        [("joint", 0.1, 4), ("linear", 0.5, 10)],
        {"fixed": 0.0, "junction": 0.1, "free_end": 0.6},
    ),
}


def harmonic(on: str = "free_end", amplitude: float = 87.5e3, frequency: float = 500.0) -> str:
    return (
        f'[[load]]\non = "{on}"\nkind = "harmonic"\namplitude = {amplitude}\n'
        f"frequency = {frequency}\n"
    )


MULTI_HARMONIC = """\
[[load]]
on = "free_end"
kind = "multi_harmonic"
components = [
    { amplitude = 60e3, frequency = 300.0 },
    { amplitude = 20e3, frequency = 900.0, phase = 0.5 },
]
"""


def scene_text(
    mesh: Path,
    *,
    joints: tuple[str, ...] = ("joint",),
    loads: str | None = None,
    pressure: float = 50e6,
    time: str = "cycles = 12",
    models: tuple[str, ...] = ("full", "reduced"),
    reduction: str = "",
    output: str = "",
) -> str:
    contact = "".join(
        f'[[joint]]\nregion = "{name}"\npressure = {pressure}\nfriction = 0.7\n'
        'normal_force = "equal"\n'
        for name in joints
    )
    return (
        f'[mesh]\nfile = "{mesh.as_posix()}"\n'
        "[material]\nE = 200e9\ndensity = 8000.0\n"
        "[section]\nwidth = 0.05\nthickness = 0.01\n"
        '[support]\nfixed = ["fixed"]\n'
        f"{contact}[damping]\nstiffness = 1e-5\n{harmonic() if loads is None else loads}"
        f"[time]\n{time}\n[models]\nrun = {list(models)}\n"
        f"[reduction]\n{reduction}\n[output]\n{output}\n"
    )


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Run:
    """Run a scene of the structure of Fig. 18, or of another bar, with what is different."""
    folder = tmp_path_factory.mktemp("scenes")

    def run_changed(bar: str = "structure", **changes: Any) -> Study:
        mesh = ROOT / "meshes" / f"{bar}.msh"
        if bar in BARS:
            mesh = folder / f"{bar}.msh"
            write_mesh(build_bar(*BARS[bar]), mesh)
        path = folder / "scene.toml"
        path.write_text(scene_text(mesh, **changes), encoding="utf-8")
        return run_scene(load_scene(path))

    return run_changed


@pytest.fixture(scope="module")
def structure_study(run: Run) -> Study:
    return run()


def errors_of(results: Study) -> Errors:
    errors = results.models["reduced"].errors
    assert errors is not None
    return errors


def test_case_i_full_and_reduced() -> None:
    results = run_scene(load_scene(ROOT / "examples" / "lap_joint_case_I.toml"))
    full = results.models["full"].run
    assert full.cycles.peak[-1] == pytest.approx([7.14e-4], rel=3e-3)
    assert full.cycles.input[-1, 0] == pytest.approx(681.0, rel=3e-3)
    assert results.models["reduced"].run.system.n == 5
    errors = errors_of(results)
    assert abs(errors.peak_displacement) <= 0.01
    assert errors.loop_energy_per_cycle is not None
    assert abs(errors.loop_energy_per_cycle) <= 0.012
    assert errors.displacement_rms <= 0.015
    assert results.models["reduced"].active_length["joint"] == pytest.approx(0.306, abs=0.005)


def test_reference_example_runs_as_it_is() -> None:
    results = run_scene(load_scene(ROOT / "examples" / "lap_joint_reference.toml"))
    assert list(results.models) == ["full"]
    assert results.models["full"].active_length["joint"] > 0.22


def test_structure_full_and_reduced(structure_study: Study) -> None:
    assert structure_study.models["reduced"].run.system.n == 8
    assert structure_study.models["reduced"].run.system.contact_points == 20
    errors = errors_of(structure_study)
    assert abs(errors.peak_displacement) <= 2e-3
    assert errors.friction_energy_per_cycle is not None
    assert abs(errors.friction_energy_per_cycle) <= 0.05
    assert errors.by_point["free_end"][0] <= 2e-3
    (zone,) = structure_study.models["reduced"].zones
    assert zone.source == "probe"
    assert zone.estimate is not None
    assert zone.length == pytest.approx(zone.estimate.length, rel=0.02)
    assert not any("slip as a whole" in warning for warning in structure_study.warnings)
    assert not any("steady" in warning for warning in structure_study.warnings)


def test_energy_balances_close(structure_study: Study) -> None:
    for model in structure_study.models.values():
        assert model.run.energy_residual < 1e-11
        friction = model.run.friction_work.sum()
        assert 0.0 < friction < model.run.input_work.sum()


def test_full_model_matches_the_paper_with_a_steep_law(run: Run, tmp_path: Path) -> None:
    text = scene_text(ROOT / "meshes" / "structure.msh", models=("full",))
    path = tmp_path / "steep.toml"
    path.write_text(text.replace("friction = 0.7\n", "friction = 0.7\nbeta = 1e7\n"))
    results = run_scene(load_scene(path))
    assert results.models["full"].run.cycles.friction[-1] == pytest.approx(3.09, rel=0.01)


def test_friction_at_every_node_is_as_good(run: Run) -> None:
    results = run(reduction='friction_points = "all"')
    assert results.models["reduced"].run.system.contact_points == 100
    errors = errors_of(results)
    assert abs(errors.peak_displacement) <= 2e-3
    assert errors.friction_energy_per_cycle is not None
    assert abs(errors.friction_energy_per_cycle) <= 0.05


def test_more_modes_err_less(run: Run, structure_study: Study) -> None:
    five, fifteen = errors_of(structure_study), errors_of(run(reduction="modes = 15"))
    assert fifteen.friction_energy_per_cycle is not None
    assert five.friction_energy_per_cycle is not None
    assert abs(fifteen.friction_energy_per_cycle) < 0.015
    assert abs(fifteen.friction_energy_per_cycle) < 0.4 * abs(five.friction_energy_per_cycle)
    assert abs(fifteen.peak_displacement) < 0.4 * abs(five.peak_displacement)
    assert fifteen.displacement_rms < 0.4 * five.displacement_rms


def test_modes_of_the_scene_itself(run: Run) -> None:
    results = run(reduction='reference = "self"\nmodes = 15')
    errors = errors_of(results)
    assert errors.friction_energy_per_cycle is not None
    assert abs(errors.friction_energy_per_cycle) < 0.02
    assert abs(errors.peak_displacement) < 1e-3
    assert results.models["reduced"].zones == ()
    assert results.models["reduced"].reference is None


def test_full_rank_basis_is_the_full_model(run: Run) -> None:
    results = run(
        "coarse",
        time="cycles = 3",
        reduction='reference = "self"\nmodes = 14\nfriction_points = "all"\nbeta = 1e5',
    )
    assert results.models["reduced"].run.system.n == results.system.n == 14
    errors = errors_of(results)
    assert errors.displacement_max < 1e-7
    assert abs(errors.friction_energy) < 1e-7


def test_more_modes_than_unknowns_are_refused(run: Run) -> None:
    with pytest.raises(InputError, match=r"reduction\.modes: found 15, must be <= 14"):
        run("coarse", time="cycles = 3", reduction='reference = "self"\nmodes = 15')


def test_full_model_alone_needs_no_reference_and_no_decomposition(
    run: Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*args: object, **options: object) -> None:
        raise AssertionError("a scene with the full model alone must not come here")

    monkeypatch.setattr(np.linalg, "svd", refuse)
    monkeypatch.setattr(study, "paper_reference", refuse)
    monkeypatch.setattr(reference_module, "integrate", refuse)
    monkeypatch.setattr(study, "integrate", refuse)
    calls = []
    real = results_module.integrate
    monkeypatch.setattr(
        results_module, "integrate", lambda *args, **kw: (calls.append(1), real(*args, **kw))[1]
    )
    results = run(models=("full",), time="cycles = 2")
    assert list(results.models) == ["full"]
    assert len(calls) == 1


def test_reduced_model_alone_is_not_compared(run: Run, structure_study: Study) -> None:
    results = run(models=("reduced",))
    model = results.models["reduced"]
    assert list(results.models) == ["reduced"]
    assert model.errors is None
    assert model.run.peak == pytest.approx(structure_study.models["reduced"].run.peak, rel=1e-12)


def test_active_length_given_as_a_number_or_by_joint(run: Run) -> None:
    for given in ("0.052", "{ joint = 0.052 }"):
        results = run(reduction=f"active_length = {given}", models=("reduced",))
        (zone,) = results.models["reduced"].zones
        assert (zone.length, zone.source) == (0.052, "given")
        assert results.models["reduced"].active_length == {"joint": 0.052}


def test_active_length_estimated(run: Run) -> None:
    results = run(reduction='active_length = "estimate"')
    (zone,) = results.models["reduced"].zones
    assert zone.source == "estimate"
    assert zone.length == pytest.approx(1.045 * 0.05, rel=1e-3)
    assert abs(errors_of(results).peak_displacement) <= 5e-3


def test_estimate_needs_harmonic_loads(run: Run) -> None:
    impulse = '[[load]]\non = "free_end"\nkind = "triangle"\npeak = 1e4\nrise_time = 4e-5\n'
    with pytest.raises(InputError, match="'estimate' needs harmonic loads"):
        run(
            loads=impulse,
            time="duration = 1e-4\nstep = 2e-6",
            reduction='active_length = "estimate"',
        )


def test_estimate_longer_than_the_joint_is_capped_with_a_warning(run: Run) -> None:
    results = run(
        loads=harmonic(amplitude=0.99 * 175e3, frequency=1000.0),
        reduction='active_length = "estimate"',
        time="cycles = 4",
    )
    (zone,) = results.models["reduced"].zones
    assert zone.length == pytest.approx(0.1, rel=1e-12)
    (warning,) = [w for w in results.warnings if "capped" in w]
    assert "0.1235 m, more than the joint has for it: capped at 0.1 m" in warning


def test_estimate_that_does_not_settle_warns(run: Run) -> None:
    results = run(
        "lap_joint_500mm",
        loads=harmonic(amplitude=437.5e3, frequency=3000.0),
        models=("reduced",),
        reduction='active_length = "estimate"',
        time="cycles = 2",
    )
    assert any("did not settle" in warning for warning in results.warnings)


@pytest.mark.parametrize(
    ("bar", "limit", "pressure"), [("structure", 175e3, 50e6), ("lap_joint_250mm", 70e3, 8e6)]
)
def test_gross_slip_warns(bar: str, limit: float, pressure: float, run: Run) -> None:
    def warnings_at(share: float) -> list[str]:
        results = run(
            bar,
            loads=harmonic(amplitude=share * limit, frequency=100.0),
            pressure=pressure,
            models=("full",),
            time="cycles = 2",
        )
        return [warning for warning in results.warnings if GROSS in warning]

    assert not warnings_at(0.8)
    (warning,) = warnings_at(1.2)
    assert warning.startswith("Every point of joint 'joint' slips")


def test_gross_slip_between_two_mouths_warns_and_keeps_the_friction_limit(run: Run) -> None:
    # Pulled the same way at both ends of the joint, 1.4 times its limit in all.
    results = run(
        "inner_joint",
        loads=harmonic("mouth", 250e3, 300.0) + harmonic("free_end", 250e3, 300.0),
        time="cycles = 3",
    )
    assert any(GROSS in warning for warning in results.warnings)
    limits = [model.run.system.w.sum() for model in results.models.values()]
    assert limits[1] <= limits[0] * (1.0 + 1e-12)


def test_steady_state_not_reached_warns(run: Run) -> None:
    results = run(time="cycles = 2")
    assert len(re.findall("has not reached a steady state", " ".join(results.warnings))) == 2


def test_multi_harmonic_load(run: Run) -> None:
    results = run(loads=MULTI_HARMONIC, time="cycles = 6")
    full = results.models["full"].run
    assert full.times[-1] == pytest.approx(6 / 300.0, rel=1e-12)
    errors = errors_of(results)
    assert abs(errors.peak_displacement) <= 5e-3
    assert errors.friction_energy_per_cycle is not None
    assert abs(errors.friction_energy_per_cycle) <= 0.05
    assert errors.displacement_rms <= 0.03


def test_multi_harmonic_estimate_superposes_amplitudes(run: Run) -> None:
    results = run(
        loads=MULTI_HARMONIC,
        models=("reduced",),
        time="cycles = 1",
        reduction='active_length = "estimate"',
    )
    (zone,) = results.models["reduced"].zones
    assert zone.length > 80e3 / 1.75e6  # the static length of both amplitudes together


def test_two_joints_each_have_their_active_length(run: Run) -> None:
    results = run(
        "two_joints", joints=("left", "right"), loads=harmonic("centre", 150e3), time="cycles = 6"
    )
    model = results.models["reduced"]
    assert [zone.joint for zone in model.zones] == ["left", "right"]
    lengths = model.active_length
    assert lengths["left"] == pytest.approx(
        lengths["right"], rel=0.02
    )  # symmetric but for the fixed node
    assert lengths["left"] == pytest.approx(0.5 * 150e3 / 1.75e6, rel=0.1)
    errors = errors_of(results)
    assert abs(errors.peak_displacement) <= 5e-3
    assert errors.friction_energy_per_cycle is not None
    assert abs(errors.friction_energy_per_cycle) <= 0.05
    assert errors.displacement_rms <= 0.03  # the far end of a joint, at rest, does not count


def test_inner_joint_pulled_at_one_end(run: Run) -> None:
    results = run(
        "inner_joint", loads=harmonic(frequency=300.0), time="cycles = 6", output="every = 10"
    )
    errors = errors_of(results)
    assert abs(errors.peak_displacement) <= 5e-3
    assert errors.friction_energy_per_cycle is not None
    assert abs(errors.friction_energy_per_cycle) <= 0.05
    assert errors.displacement_rms <= 0.03
    # Force enters at one end only: nothing moves at the other.
    assert results.models["reduced"].active_length["joint"] == pytest.approx(0.05, rel=0.1)


def test_inner_joint_pulled_at_both_ends(run: Run) -> None:
    results = run(
        "inner_joint",
        loads=harmonic("mouth", 80e3, 300.0) + harmonic("free_end", 87.5e3, 300.0),
        time="cycles = 6",
    )
    errors = errors_of(results)
    assert abs(errors.peak_displacement) <= 5e-3
    assert errors.friction_energy_per_cycle is not None
    assert abs(errors.friction_energy_per_cycle) <= 0.05


def test_load_spread_along_the_linear_region(run: Run) -> None:
    results = run(loads=harmonic("linear"))
    errors = errors_of(results)
    assert abs(errors.peak_displacement) <= 5e-3
    assert errors.friction_energy_per_cycle is not None
    assert abs(errors.friction_energy_per_cycle) <= 0.05


def test_load_inside_a_joint_is_left_to_its_own_modes(run: Run) -> None:
    with pytest.raises(InputError, match='Use reference = "self"'):
        run(loads=harmonic("joint"), time="cycles = 1")


@pytest.mark.parametrize("bar", ["structure", "coarse"])
def test_load_that_moves_less_than_an_element_of_the_joint(bar: str, run: Run) -> None:
    # 0.3 mm of slip, while elements are 1 mm or 25 mm long.
    results = run(bar, loads=harmonic(amplitude=500.0), time="cycles = 3")
    reduced = results.models["reduced"].run
    assert np.all(np.isfinite(reduced.point_u))
    assert abs(errors_of(results).peak_displacement) <= 0.01


def test_no_load_at_all_is_refused_by_the_reduction(run: Run) -> None:
    with pytest.raises(InputError, match=r"nothing moves|no force"):
        run(loads=harmonic(amplitude=0.0), time="cycles = 2")


def test_joint_without_friction_is_refused_by_the_reduction(run: Run) -> None:
    with pytest.raises(InputError, match="'reduced' needs friction in a joint"):
        run(pressure=0.0, time="cycles = 1")
    assert run(pressure=0.0, time="cycles = 1", models=("full",)).system.contact_points == 0


def test_impulse_stays_below_the_errors_of_the_paper() -> None:
    results = run_scene(load_scene(ROOT / "examples" / "structure_impulse.toml"))
    errors = errors_of(results)
    assert errors.friction_energy_per_cycle is None
    assert errors.by_point["free_end"][1] <= 0.023  # section 7.4
    assert errors.by_point["junction"][1] <= 0.015
    assert abs(errors.friction_energy) <= 0.03
    assert results.models["full"].run.cycles.friction.size == 0


def test_points_are_stored_as_asked(run: Run, structure_study: Study) -> None:
    results = run(output="every = 10", time="cycles = 2")
    for name, model in results.models.items():
        stored = model.run
        assert stored.times.size == 41
        every = structure_study.models[name].run
        assert stored.times == pytest.approx(every.times[:401:10], rel=1e-12)
        assert np.allclose(stored.point_u, every.point_u[:401:10], rtol=0.0, atol=1e-12)


def test_nothing_is_stored_that_nobody_asked_for(run: Run) -> None:
    results = run(output="history = false", models=("full",), time="cycles = 2")
    stored = results.models["full"].run
    assert stored.point_u.size == stored.u.size == stored.sigma.size == 0
    assert stored.peak.max() > 0.0
    fields = run(output="vtk = true\nframes = 50", models=("full",), time="cycles = 2")
    assert fields.models["full"].run.u.shape == (51, 200)


def test_fields_of_the_reduced_model_are_those_of_the_mesh(run: Run) -> None:
    results = run(output="vtk = true\nframes = 50", time="cycles = 2")
    full, reduced = (results.models[name].fields() for name in ("full", "reduced"))
    assert full[0].shape == reduced[0].shape == (51, 200)
    assert np.abs(full[0] - reduced[0]).max() < 0.01 * np.abs(full[0]).max()
    P = results.system.P
    assert np.allclose(
        P @ reduced[0].T, results.models["reduced"].run.point_u[::8].T, rtol=0.0, atol=1e-15
    )


def test_reduced_beta_follows_the_slip_velocity_and_is_told(run: Run) -> None:
    told = run(models=("reduced",), time="cycles = 2")
    assert any("uses beta = " in warning for warning in told.warnings)
    assert np.all(told.models["reduced"].run.system.beta < 1e5)
    asked = run(models=("reduced",), time="cycles = 2", reduction="beta = 2e4")
    assert np.all(asked.models["reduced"].run.system.beta == 2e4)
    assert not any("uses beta" in warning for warning in asked.warnings)


SUMMARY_KEYS = {
    "dofs", "contact_points", "modes", "steps", "newton_iterations", "wall_s", "offline_s",
    "peak_displacement_m", "friction_energy_per_cycle_J", "loop_energy_per_cycle_J",
    "active_length_m", "energy_balance_residual",
}  # fmt: skip
ERROR_KEYS = {
    "displacement_rms", "displacement_max", "peak_displacement", "friction_energy_per_cycle",
    "loop_energy_per_cycle",
}  # fmt: skip


def test_summary_of_a_study(structure_study: Study) -> None:
    summary = output.summary(structure_study)
    assert set(summary) >= {"models", "warnings"}
    assert set(summary["models"]) == {"full", "reduced"}
    for model in summary["models"].values():
        assert set(model) >= SUMMARY_KEYS
        assert set(model["peak_displacement_m"]) == {"junction", "free_end"}
    assert "error" not in summary["models"]["full"]
    assert set(summary["models"]["reduced"]["error"]) >= ERROR_KEYS
    assert summary["models"]["full"]["modes"] is None
    assert summary["models"]["full"]["dofs"] == 200
    assert summary["models"]["reduced"]["modes"] == summary["models"]["reduced"]["dofs"] == 8
    assert all(sentence[0].isupper() for sentence in summary["warnings"])


class StopAt:
    """Progress that interrupts a model at its n-th call, as Ctrl-C does."""

    def __init__(self, label: str, call: int) -> None:
        self.label, self.left = label, call

    def __call__(self, label: str, done: int, total: int) -> None:
        self.left -= label == self.label
        if self.left == 0:
            raise KeyboardInterrupt


def loaded(tmp_path: Path, **changes: Any) -> Any:
    path = tmp_path / "scene.toml"
    path.write_text(scene_text(ROOT / "meshes" / "structure.msh", **changes), encoding="utf-8")
    return load_scene(path)


def test_interrupted_study_holds_what_was_done(tmp_path: Path) -> None:
    results = run_scene(loaded(tmp_path, time="cycles = 6"), StopAt("full model", 2))
    assert results.interrupted
    assert list(results.models) == ["full"]
    stopped = results.models["full"].run
    assert stopped.interrupted
    assert stopped.counters.steps == 400
    assert stopped.times.size == 401
    assert stopped.cycles.friction.size == 2
    assert "interrupted in the full model at t = 0.004 s" in results.warnings[-1]


def test_study_interrupted_in_its_second_model_keeps_the_first(tmp_path: Path) -> None:
    results = run_scene(loaded(tmp_path, time="cycles = 6"), StopAt("reduced model", 2))
    assert results.interrupted
    assert [model.run.counters.steps for model in results.models.values()] == [1200, 400]
    assert results.models["reduced"].errors is None


def test_interrupted_study_that_stored_nothing_says_when(tmp_path: Path) -> None:
    scene = loaded(tmp_path, time="cycles = 6", models=("full",), output="history = false")
    results = run_scene(scene, StopAt("full model", 2))
    assert results.interrupted
    assert "t = 0.004 s" in results.warnings[-1]


@pytest.mark.parametrize("module", ["reference", "study"])
def test_interruption_on_the_way_to_the_reduced_model_is_not_swallowed(
    module: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Ctrl-C during the reference run or the probe run: no reduced model from half a run.
    place: Any = {"reference": reference_module, "study": study}[module]
    real = place.integrate

    def stopped_without_progress(*args: Any, **options: Any) -> Any:
        found = real(*args, **options)
        return found if options.get("progress") else replace(found, interrupted=True)

    reference_module.paper_reference.cache_clear()
    monkeypatch.setattr(place, "integrate", stopped_without_progress)
    results = run_scene(loaded(tmp_path, time="cycles = 2"))
    assert results.interrupted
    assert list(results.models) == ["full"]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"reduction": 'reference = "self"', "loads": harmonic(amplitude=0.0)}, "nothing moves"),
        (
            {
                "reduction": 'reference = "self"',
                "loads": '[[load]]\non = "free_end"\nkind = "triangle"\npeak = 1e3\n'
                "rise_time = 1e-3\nstart = 1.0\n",
                "time": "duration = 1e-3\nstep = 1e-5",
            },
            "nothing moves",
        ),
        ({"reduction": "modes = 1000000000"}, "reduction.modes: found 1000000000, must be <= 100"),
    ],
)
def test_reductions_that_have_nothing_to_go_by_are_refused(
    run: Run, changes: dict[str, Any], words: str
) -> None:
    with pytest.raises(InputError, match=re.escape(words)):
        run("coarse", **changes)


def test_a_run_that_does_not_converge_names_the_node_and_where_it_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refuse(*_: Any, **__: Any) -> Any:
        raise ConvergenceError("step 7 at t = 1e-5 s did not converge.", 99)

    monkeypatch.setattr(results_module, "integrate", refuse)
    with pytest.raises(ConvergenceError, match=r"step 7 .* node 100, 0\.1 m along the bar"):
        run_scene(loaded(tmp_path, time="cycles = 2"))
