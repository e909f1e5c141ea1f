"""Scenes of plates from file to results, through the command line."""

from __future__ import annotations

import json
import tracemalloc
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from skfem_joint import cli, memory, output, results
from skfem_joint.certificate import certify
from skfem_joint.errors import ConvergenceError
from skfem_joint.meshing import build_bar, write_mesh
from skfem_joint.plate_file import write_plate
from skfem_joint.plate_mesh import PlateMesh, build_plate, merged
from skfem_joint.plate_output import plate_field
from skfem_joint.plate_study import PlateStudy
from skfem_joint.scene import PlateScene, load_scene, scene_from
from skfem_joint.study import full_system, run_scene

WIDTH, THICKNESS, LENGTH = 0.05, 0.01, 0.25
ELEMENTS = 25


def tables(**changes: Any) -> dict[str, Any]:
    """Tables of the reference system as a plate; ``reduction = {...}`` and so on change them."""
    base: dict[str, Any] = {
        "mesh": {"file": "plate.msh"},
        "material": {"E": 200e9, "density": 8000.0, "poisson": 0.0},
        "section": {"thickness": THICKNESS},
        "support": {"fixed": ["left"]},
        "joint": [{"region": "joint", "pressure": 8e6, "friction": 0.7}],
        "damping": {"stiffness": 1e-5},
        "load": [{"on": "right", "kind": "harmonic", "amplitude": 63e3, "frequency": 1000.0}],
        "time": {"cycles": 3, "steps_per_cycle": 100},
        "models": {"run": ["full", "reduced"]},
    }
    return base | changes


def reference(elements: int = ELEMENTS, **options: Any) -> PlateMesh:
    return build_plate([("joint", LENGTH, elements)], WIDTH, 2, **options)


def toml(content: dict[str, Any]) -> str:
    def value(one: Any) -> str:
        if isinstance(one, dict):
            return "{ " + ", ".join(f"{key} = {value(part)}" for key, part in one.items()) + " }"
        return "[" + ", ".join(map(value, one)) + "]" if isinstance(one, list) else json.dumps(one)

    lines = []
    for name, table in content.items():
        for one in table if isinstance(table, list) else [table]:
            lines.append(f"[[{name}]]" if isinstance(table, list) else f"[{name}]")
            lines += [f"{key} = {value(part)}" for key, part in one.items()]
    return "\n".join(lines)


@pytest.fixture
def scene_file(tmp_path: Path) -> Callable[..., Path]:
    def write(mesh: PlateMesh | None = None, **changes: Any) -> Path:
        write_plate(mesh or reference(), tmp_path / "plate.msh")
        path = tmp_path / "scene.toml"
        path.write_text(toml(tables(**changes)), encoding="utf-8")
        return path

    return write


def run(mesh: PlateMesh, **changes: Any) -> PlateStudy:
    return run_scene(scene_from(tables(**changes), mesh))


def strut_summary(folder: Path, law: dict[str, Any]) -> dict[str, Any]:
    """Full model of the same joint as a strut with the same elements."""
    write_mesh(
        build_bar([("joint", LENGTH, ELEMENTS)], {"fixed": 0.0, "right": LENGTH}),
        folder / "bar.msh",
    )
    content = tables(
        mesh={"file": "bar.msh"},
        material={"E": 200e9, "density": 8000.0},
        section={"width": WIDTH, "thickness": THICKNESS},
        support={"fixed": ["fixed"]},
        joint=[tables()["joint"][0] | law],
        models={"run": ["full"]},
    )
    path = folder / "strut.toml"
    path.write_text(toml(content), encoding="utf-8")
    assert cli.main(["run", str(path), "--out", str(folder / "strut")]) == 0
    summary: dict[str, Any] = json.loads((folder / "strut" / "summary.json").read_text())
    return summary["models"]["full"]


@pytest.mark.parametrize("law", [{}, {"law": "coulomb"}], ids=["arctan", "coulomb"])
def test_plate_without_poisson_effect_is_the_strut(
    law: dict[str, Any],
    scene_file: Callable[..., Path],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    strut = strut_summary(tmp_path, law)
    path = scene_file(
        joint=[tables()["joint"][0] | law],
        reduction={"modes": 12},
        output={"history": True, "points": ["right"]},
    )
    capsys.readouterr()
    assert cli.main(["run", str(path), "--out", str(tmp_path / "out")]) == 0
    shown = capsys.readouterr()
    assert shown.err == ""
    assert "active part of joint, %" in shown.out
    models = json.loads((tmp_path / "out" / "summary.json").read_text())["models"]
    full, reduced = models["full"], models["reduced"]
    for key in ("friction_energy_per_cycle_J", "loop_energy_per_cycle_J", "friction_energy_J"):
        assert full[key] == pytest.approx(strut[key], rel=1e-6)
    peak = full["peak_displacement_m"]
    assert set(peak) == {"right", "right.x", "right.y"}
    assert peak["right"] == pytest.approx(strut["peak_displacement_m"]["right"], rel=1e-6)
    assert peak["right.x"] == pytest.approx(peak["right"], rel=1e-12)
    assert peak["right.y"] < 1e-9 * peak["right"]
    # The active length of the strut, to a node or so.
    assert full["active_area_fraction"]["joint"] == pytest.approx(
        strut["active_length_m"]["joint"] / LENGTH, abs=1.5 / ELEMENTS
    )
    assert full["active_length_m"] == {}
    assert reduced["dofs"] == 12
    assert abs(reduced["error"]["peak_displacement"]) < 0.01
    assert abs(reduced["error"]["friction_energy_per_cycle"]) < 0.02
    assert set(reduced) - {"error"} == set(strut)
    with np.load(tmp_path / "out" / "history.npz", allow_pickle=False) as history:
        assert history["full_right.x_displacement"].shape == (301,)
        assert history["load_0_right"].max() == pytest.approx(63e3)


def two_plates(gap: float = 0.0) -> PlateMesh:
    """Two plates of 0.2 m that overlap by 0.1 m, or that lie apart."""
    lower = build_plate([("linear", 0.1, 3), ("joint", 0.1, 4)], WIDTH, 2)
    upper = build_plate(
        [("upper_joint", 0.1, 5), ("upper_linear", 0.1, 3)],
        WIDTH,
        2,
        origin=(0.1 + gap, 0.0),
        prefix="upper_",
    )
    return merged([lower, upper])


TWO: dict[str, Any] = {
    "joint": [{"region": "upper_joint", "against": "joint", "pressure": 8e6, "friction": 0.7}],
    "load": [{"on": "upper_right", "kind": "harmonic", "amplitude": 14e3, "frequency": 1000.0}],
    "material": {"E": 200e9, "density": 8000.0, "poisson": 0.3},
    "models": {"run": ["full"]},
}


def test_check_says_what_the_scene_is(
    scene_file: Callable[..., Path], capsys: pytest.CaptureFixture[str]
) -> None:
    path = scene_file(two_plates(), **TWO)
    assert cli.main(["check", str(path)]) == 0
    shown = capsys.readouterr().out.splitlines()
    # 24 and 27 nodes, 3 of them held; friction 0.7 * 8 MPa * 0.1 m * 0.05 m.
    assert shown[0] == (
        f"{path}: valid. 96 unknowns, 18 contact points, 300 steps of 1e-05 s, models: full."
    )
    assert shown[1:4] == [
        "2 bodies, 30 elements of order 1.",
        "Joint upper_joint against joint: 18 contact points, clamp force 40000 N, friction limit "
        "of the points that can slip 28000 N.",
        "Load on upper_right: 50 % of the friction limit.",
    ]
    assert shown[4].startswith("A run needs about ")


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (
            {
                "joint": [
                    {"boundary": "right", "against": "joint", "pressure": 1.0, "friction": 1.0}
                ]
            },
            "joint[0].against: found 'joint', which is a region; a boundary is needed, as 'right' "
            "is one",
        ),
        (
            {"joint": [{"region": "top", "pressure": 1.0, "friction": 1.0}]},
            "joint[0].region: found 'top', which is a boundary; a region is needed",
        ),
        ({"joint": []}, "the body with the regions 'upper_joint', 'upper_linear' is left"),
        ({"support": {"fixed_y": ["bottom"]}}, "is left unsupported"),
    ],
    ids=["region for boundary", "boundary for region", "body without joint", "free in x"],
)
@pytest.mark.parametrize("command", ["check", "run"])
def test_bad_scene_ends_with_2(
    command: str,
    changes: dict[str, Any],
    words: str,
    scene_file: Callable[..., Path],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    path = scene_file(two_plates(), **(TWO | changes))
    out = ["--out", str(tmp_path / "out")] if command == "run" else []
    assert cli.main([command, str(path), *out]) == 2
    shown = capsys.readouterr()
    assert words in shown.err
    assert "Traceback" not in shown.err
    assert shown.out == ""


def test_plates_that_do_not_overlap_end_with_2(
    scene_file: Callable[..., Path], capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["check", str(scene_file(two_plates(gap=0.3), **TWO))]) == 2
    shown = capsys.readouterr().err
    assert "upper_joint" in shown
    assert "'joint'" in shown


def test_inverted_element_ends_with_2(
    scene_file: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = scene_file(two_plates(), **TWO)
    mesh = tmp_path / "plate.msh"
    lines = mesh.read_text(encoding="utf-8").splitlines()
    start = lines.index("$Elements")
    # The first line of an element with four corners: exchange the last two.
    row = next(k for k in range(start + 2, len(lines)) if len(lines[k].split()) == 5)
    number, a, b, c, d = lines[row].split()
    lines[row] = " ".join([number, a, b, d, c])
    mesh.write_text("\n".join(lines) + "\n", encoding="utf-8")
    assert cli.main(["check", str(path)]) == 2
    assert "mesh.file: " in capsys.readouterr().err


def test_two_plates_end_to_end_with_fields(
    scene_file: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = scene_file(two_plates(), **TWO, output={"vtk": True, "frames": 6})
    out = tmp_path / "out"
    assert cli.main(["run", str(path), "--out", str(out)]) == 0
    assert "Traceback" not in capsys.readouterr().err
    assert len(list((out / "fields").glob("*.vtu"))) == 2 * 7
    assert (out / "fields.pvd").exists()
    assert (out / "fields_load.csv").read_text().startswith('"time, s"')
    full = json.loads((out / "summary.json").read_text())["models"]["full"]
    assert full["energy_balance_residual"] < 1e-9
    assert 0.0 < full["active_area_fraction"]["upper_joint"] <= 1.0


@pytest.fixture(scope="module")
def study() -> PlateStudy:
    return run(
        two_plates(),
        **(TWO | {"models": {"run": ["full", "reduced"]}}),
        output={"vtk": True, "frames": 10},
        reduction={"modes": 10},
    )


@pytest.mark.parametrize("name", ["full", "reduced"])
def test_fields_keep_the_law_and_the_friction_energy(study: PlateStudy, name: str) -> None:
    model = study.models[name]
    field = plate_field(study, model)
    (patch,) = study.structure.patches
    off = np.setdiff1d(np.arange(study.structure.n_nodes), patch.nodes)
    assert not field.traction[:, off].any()
    assert (field.slip_state[:, off] == -1).all()
    assert (field.slip_state[:, patch.nodes] >= 0).all()
    largest = np.linalg.norm(field.traction[:, patch.nodes], axis=-1)
    assert largest.max() <= 0.7 * 8e6 * (1.0 + 1e-12)
    assert largest.max() > 0.5 * 0.7 * 8e6
    work = field.friction_work[:, patch.nodes] @ patch.area
    assert work[-1] == pytest.approx(model.run.friction_work.sum(), rel=1e-9)
    assert np.all(np.diff(work) >= -1e-9 * work[-1])
    # Friction acts against the slip.
    slip = patch.relative(field.velocity)
    assert np.sum(field.traction[:, patch.nodes] * slip, axis=-1).max() <= 1e-9 * largest.max()


def test_reduced_plates_follow_the_full_ones(study: PlateStudy) -> None:
    errors = study.models["reduced"].errors
    assert errors is not None
    assert abs(errors.peak_displacement) < 0.02
    assert errors.displacement_rms < 0.02


def test_step_that_does_not_converge_names_the_place(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = scene_from(tables(models={"run": ["full"]}), reference(4))
    system = full_system(scene)
    unknown = int(np.flatnonzero(system.loads[0].vector)[0])  # at the loaded edge, its lower end

    def fail(*args: object, **options: object) -> None:
        raise ConvergenceError("step 7 did not converge.", unknown)

    monkeypatch.setattr(results, "integrate", fail)
    with pytest.raises(ConvergenceError, match=r"of node 12, at \(0\.25, 0\) m\.$") as caught:
        run_scene(scene)
    assert caught.value.exit_status == 3


def test_a_run_taken_up_again_is_the_same(
    scene_file: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = scene_file(two_plates(), **TWO)
    assert cli.main(["run", str(path), "--out", str(tmp_path / "whole")]) == 0
    real = results.integrate

    class KilledError(Exception):
        pass

    def killed(*args: Any, **options: Any) -> Any:
        def progress(done: int, total: int) -> None:
            if done == 200:
                raise KilledError

        return real(*args, **(options | {"progress": progress}))

    monkeypatch.setattr(results, "integrate", killed)
    out = tmp_path / "out"
    arguments = ["run", str(path), "--out", str(out), "--checkpoint-every", "100"]
    with pytest.raises(KilledError):
        cli.main(arguments)
    assert (out / "checkpoint_full.npz").exists()
    monkeypatch.setattr(results, "integrate", real)
    assert cli.main([*arguments, "--resume"]) == 0
    with (
        np.load(tmp_path / "whole" / "history.npz") as whole,
        np.load(out / "history.npz") as resumed,
    ):
        assert set(whole) == set(resumed)
        for name in whole:
            np.testing.assert_array_equal(resumed[name], whole[name])


def test_certified_errors_of_a_plate_shrink_with_its_elements() -> None:
    time = {"cycles": 2, "steps_per_cycle": 40}
    found = []
    for elements in (4, 8):
        scene = scene_from(tables(time=time, models={"run": ["full"]}), reference(elements))
        estimates = {one.source: one.errors for one in certify(scene, "full")}
        assert set(estimates) == {"time step", "mesh", "beta"}
        found.append(estimates["mesh"]["friction_energy"])
    assert found[0] > 1.5 * found[1] > 0.0


def test_error_time_is_for_struts(
    scene_file: Callable[..., Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = scene_file()
    assert cli.main(["error-time", str(path), "--out", str(tmp_path / "out")]) == 2
    assert "compares models of struts; this scene has plates" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_a_joint_that_slips_as_a_whole_is_told() -> None:
    load = tables()["load"][0] | {"amplitude": 1.2 * 0.7 * 8e6 * WIDTH * LENGTH}
    results = run(
        reference(5, boundaries={"left": "left", "right": "right"}),
        load=[load],
        support={"fixed_y": ["joint"], "fixed_x": []},
        models={"run": ["full"]},
    )
    assert any("Every point of joint 'joint' slips" in one for one in results.warnings)
    load = tables()["load"][0] | {"amplitude": 20e3}
    sticking = run(reference(5), load=[load], models={"run": ["full"]})
    assert not any("Every point" in one for one in sticking.warnings)


def test_notes_of_the_mesh_are_warnings() -> None:
    note = "Edges were made straight."
    mesh = replace(reference(4), notes=(note,))
    assert note in run(mesh, models={"run": ["full"]}).warnings


@pytest.fixture(scope="module")
def loaded(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Compile, and load what draws and writes, which takes memory of its own."""
    small = {"time": {"cycles": 1, "steps_per_cycle": 50}, "output": {"vtk": True, "frames": 2}}
    output.write(
        run(reference(10), reduction={"modes": 2}, **small), tmp_path_factory.mktemp("out")
    )


@pytest.mark.usefixtures("loaded")
@pytest.mark.parametrize(
    ("elements", "changes"),
    [
        (
            2,
            {
                "time": {"cycles": 8, "steps_per_cycle": 100},
                "output": {"points": ["right", "top", "bottom"] + [f"at {k}" for k in range(9)]},
            },
        ),
        (
            20,
            {
                "time": {"cycles": 1, "steps_per_cycle": 150},
                "output": {"vtk": True, "frames": 150, "history": False},
            },
        ),
        (
            20,
            {
                "models": {"run": ["full", "reduced"]},
                "time": {"cycles": 1, "steps_per_cycle": 150},
                "output": {"history": False},
            },
        ),
        (200, {"time": {"cycles": 1, "steps_per_cycle": 10}, "output": {"history": False}}),
    ],
    ids=["points", "fields", "training", "unknowns"],
)
def test_memory_needed_bounds_what_a_run_takes(
    elements: int, changes: dict[str, Any], tmp_path: Path
) -> None:
    def scene(elements: int) -> PlateScene:
        corners = {f"at {k}": (LENGTH, WIDTH * (k % 3) / 2) for k in range(9)}
        mesh = reference(elements, points=corners)
        base: dict[str, Any] = {"models": {"run": ["full"]}, "reduction": {"modes": 8}}
        return scene_from(tables(**(base | changes)), mesh)

    tracemalloc.start()
    try:
        output.write(run_scene(scene(elements)), tmp_path)
        peak = tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()
    assert peak <= memory.needed(scene(elements)).total <= 4 * peak


def test_scene_file_and_scene_in_memory_are_the_same(scene_file: Callable[..., Path]) -> None:
    path = scene_file(two_plates(), **TWO)
    from_file = full_system(load_scene(path))
    in_memory = full_system(scene_from(tables(**TWO), two_plates()))
    assert abs(from_file.K - in_memory.K).max() < 1e-9 * abs(in_memory.K).max()
    assert from_file.w == pytest.approx(in_memory.w, rel=1e-12)


def test_modes_of_the_paper_laid_along_the_axis_of_a_joint() -> None:
    joint = tables()["joint"][0] | {"axis": [-1.0, 0.0]}
    load = tables()["load"][0] | {"amplitude": 30e3}
    active = []
    for length in ({}, {"active_length": 0.15}, {"active_length": {"joint": 0.15}}):
        results = run(
            reference(),
            joint=[joint],
            load=[load],
            reduction={"reference": "paper", "modes": 5} | length,
        )
        model = results.models["reduced"]
        assert model.errors is not None
        assert abs(model.errors.peak_displacement) < 0.05
        active.append(model.active_length["joint"])
    assert active[1:] == [0.15, 0.15]
    # 30 kN over the friction limit per length, 0.7 * 8 MPa * 0.05 m, is 0.107 m.
    assert active[0] == pytest.approx(30e3 / (0.7 * 8e6 * WIDTH), rel=0.3)


def test_an_interrupted_run_leaves_what_was_done(
    scene_file: Callable[..., Path],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    calls: list[str] = []

    def progress(label: str, done: int, total: int) -> None:
        calls.append(label)
        if len(calls) == 2:
            raise KeyboardInterrupt

    monkeypatch.setattr(cli, "_progress", lambda: nullcontext(progress))
    path = scene_file(two_plates(), **TWO, output={"vtk": True, "frames": 6})
    out = tmp_path / "out"
    assert cli.main(["run", str(path), "--out", str(out)]) == 130
    assert "interrupted in the full model at t = 0.002 s" in capsys.readouterr().out
    assert json.loads((out / "summary.json").read_text())["models"]["full"]["interrupted"] is True
    assert len(list((out / "fields").glob("*.vtu"))) == 2 * 5
