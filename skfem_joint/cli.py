"""Command line ``skfem-joint``. Exit status 0, 2 (bad input) or 3 (no convergence)."""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from skfem_joint import __version__
from skfem_joint.errors import InputError, JointError
from skfem_joint.study import Progress

if TYPE_CHECKING:
    from skfem_joint.scene import PlateScene
    from skfem_joint.system import System

INTERRUPTED = 130
BROKEN_PIPE = 141


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    options = _parser().parse_args(arguments)
    try:
        status: int = options.command(options)
        return status
    except JointError as error:
        print(f"skfem-joint: {error}", file=sys.stderr)
        return error.exit_status
    except BrokenPipeError:  # the reader of the output has left: `| head`
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return BROKEN_PIPE
    except OSError as error:  # a disk that is full where a library keeps its compiled code
        print(f"skfem-joint: the system refuses a file: {error}", file=sys.stderr)
        return InputError.exit_status
    except KeyboardInterrupt:
        print("skfem-joint: interrupted", file=sys.stderr)
        return INTERRUPTED


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="skfem-joint",
        description="Dynamics of bolted joints with micro-slip friction, full and reduced.",
        epilog="Exit status: 0 success, 2 bad input, 3 a run did not converge, 130 interrupted.",
    )
    parser.add_argument("--version", action="version", version=__version__)
    commands = parser.add_subparsers(title="commands", required=True, metavar="COMMAND")

    run = commands.add_parser("run", help="integrate the models of a scene and report")
    run.add_argument("scene", type=Path, metavar="SCENE.toml")
    run.add_argument(
        "--out", type=Path, required=True, metavar="DIR", help="folder for the results"
    )
    run.add_argument(
        "--certify",
        action="store_true",
        help="estimate the errors of time step, mesh, beta and number of modes (more runs)",
    )
    run.add_argument(
        "--checkpoint-every",
        type=int,
        metavar="STEPS",
        help="save the run about every so many steps (whole cycles or chunks of a second or so), "
        "until its results are written",
    )
    run.add_argument(
        "--resume",
        action="store_true",
        help="go on from the checkpoints in DIR, if there are any: same results to the bit",
    )
    run.add_argument(
        "--memory-limit",
        type=float,
        metavar="GIB",
        help="refuse a run that would need more (default: 80 %% of the memory available)",
    )
    run.set_defaults(command=_run)

    check = commands.add_parser("check", help="validate a scene without running it")
    check.add_argument("scene", type=Path, metavar="SCENE.toml")
    check.set_defaults(command=_check)

    reproduce = commands.add_parser(
        "reproduce", help="the paper's tables and figures beside their published values"
    )
    reproduce.add_argument(
        "items", nargs="*", metavar="ITEM", help="e.g. table3 fig19; everything if none is named"
    )
    reproduce.add_argument(
        "--out",
        type=Path,
        required=True,
        metavar="DIR",
        help="folder for the page, its pictures and the curves",
    )
    reproduce.set_defaults(command=_reproduce)

    stability = commands.add_parser(
        "stability", help="stiff and extreme cases: each is right, or refused with a reason"
    )
    stability.add_argument(
        "--out",
        type=Path,
        required=True,
        metavar="DIR",
        help="folder for the page, the table of all cases and the picture",
    )
    stability.add_argument("--quick", action="store_true", help="a few cases of each kind only")
    stability.set_defaults(command=_stability)

    error_time = commands.add_parser(
        "error-time", help="error against run time of many models and integrators on one scene"
    )
    error_time.add_argument("scene", type=Path, metavar="SCENE.toml")
    error_time.add_argument(
        "--out", type=Path, required=True, metavar="DIR", help="folder for table and picture"
    )
    error_time.add_argument(
        "--bound",
        type=float,
        default=60.0,
        metavar="SECONDS",
        help="longest run of a ready-made integrator (default 60)",
    )
    error_time.add_argument(
        "--repeats", type=int, default=3, metavar="N", help="timed rounds (default 3)"
    )
    error_time.add_argument(
        "--quick", action="store_true", help="few points, ready-made integrators for a second"
    )
    error_time.set_defaults(command=_error_time)
    return parser


def _check(options: argparse.Namespace) -> int:
    from skfem_joint import memory
    from skfem_joint.resolution import check_resolution
    from skfem_joint.scene import PlateScene, load_scene
    from skfem_joint.study import full_system

    scene = load_scene(options.scene)
    system = full_system(scene)
    check_resolution(system, scene.time_step, scene.n_steps)
    limit = float(system.w.sum())
    print(
        f"{options.scene}: valid. {system.n} unknowns, {system.contact_points} contact points, "
        f"{scene.n_steps} steps of {scene.time_step:.6g} s, models: {', '.join(scene.models.run)}."
    )
    if isinstance(scene, PlateScene):
        _describe(scene, system)
    for item in scene.load:
        if limit > 0.0:
            share = 100.0 * item.to_load().peak_value / limit
            print(f"Load on {item.on}: {share:.3g} % of the friction limit.")
    print(f"A run needs about {memory.size(memory.needed(scene).total)} beside the program.")
    return 0


def _describe(scene: PlateScene, system: System) -> None:
    """Say what plates and joints a scene has, and what looks wrong with them."""
    from skfem_joint.plate_doubts import doubts
    from skfem_joint.plate_study import plate_structure_of

    plate = scene.plate
    bodies = int(plate.body.max()) + 1
    print(
        f"{bodies} {'body' if bodies == 1 else 'bodies'}, {plate.mesh.t.shape[1]} elements of "
        f"order {plate.order}."
    )
    structure = plate_structure_of(scene)
    for doubt in [*plate.notes, *doubts(structure, system)]:
        print(f"Note: {doubt}")
    for patch in structure.patches:
        against = f" against {patch.joint.against}" if patch.joint.against else ""
        print(
            f"Joint {patch.joint.name}{against}: {patch.points.size} contact points, clamp force "
            f"{patch.clamping_force:.6g} N, friction limit of the points that can slip "
            f"{patch.joint.friction * patch.normal_force.sum():.6g} N."
        )
    for note in plate.notes:
        print(f"Note: {note}")


def _run(options: argparse.Namespace) -> int:
    from skfem_joint import memory, output, report
    from skfem_joint.certificate import certify
    from skfem_joint.checkpoint import Checkpoints
    from skfem_joint.scene import load_scene
    from skfem_joint.study import run_scene

    scene = load_scene(options.scene)
    limit = options.memory_limit
    memory.check(scene, memory.default_limit() if limit is None else limit * memory.GIB)
    checkpoints = None
    if options.checkpoint_every is not None or options.resume:
        checkpoints = Checkpoints(options.out, options.checkpoint_every, options.resume)
        if options.resume and not checkpoints.files():
            print(f"No checkpoint in {options.out}: the run starts anew.", file=sys.stderr)
    output.prepare(scene, options.out)
    certificate = {}
    failure = None
    with _progress() as progress:
        try:
            study = run_scene(scene, progress, checkpoints)
        except JointError as error:
            if error.results is None:
                raise
            failure, study = error, error.results
        if options.certify and not study.interrupted and failure is None:
            certificate = {
                model: {one.source: one.errors for one in certify(scene, model, progress)}
                for model in study.models
            }
    if scene.title:
        print(f"{scene.title}\n")
    print(report.table(output.summary(study)))
    if certificate:
        print("\n" + report.certificate_table(certificate))
    for warning in study.warnings:
        print(f"\nNote: {warning}")
    if sys.stderr.isatty() and (scene.output.plots or scene.output.vtk):
        print("\nDrawing pictures and writing files ...", file=sys.stderr)
    files = output.write(study, options.out, certificate)
    whole = not study.interrupted and failure is None
    if checkpoints is not None and whole:
        checkpoints.remove()
    print(f"\nWritten to {options.out}: {', '.join(file.name for file in files)}")
    if study.interrupted:
        saved = checkpoints is not None and checkpoints.files()
        print("Go on with --resume." if saved else "A run with --checkpoint-every can be resumed.")
        return INTERRUPTED
    if failure is not None:
        raise failure
    return 0


def _reproduce(options: argparse.Namespace) -> int:
    from skfem_joint import output
    from skfem_joint.paper import page
    from skfem_joint.paper.workspace import Workspace
    from skfem_joint.reproduce import chosen, reproduce

    chosen(options.items)
    output.prepare_folder(options.out)
    with _progress() as progress:
        reproduce(
            options.items,
            Workspace(options.out),
            progress,
            lambda item: print(page.text_table(item), end="\n\n"),
        )
    print(f"Written to {options.out}: reproduction.md, pictures/, curves/")
    return 0


def _error_time(options: argparse.Namespace) -> int:
    from skfem_joint import output
    from skfem_joint.error_time import report, table
    from skfem_joint.scene import PlateScene, load_scene

    scene = load_scene(options.scene)
    if isinstance(scene, PlateScene):
        raise InputError(
            f"{options.scene}: error-time compares models of struts; this scene has plates. Use "
            "run --certify for the errors of its time step and mesh"
        )
    if not report.threads_pinned(os.environ):
        # Read when numpy starts, so that it takes another process.
        again = [sys.executable, "-m", "skfem_joint", "error-time", str(options.scene)]
        again += ["--out", str(options.out), "--bound", str(options.bound)]
        again += ["--repeats", str(options.repeats), *(["--quick"] if options.quick else [])]
        pinned = os.environ | dict.fromkeys(report.THREADS, "1")
        return subprocess.run(again, env=pinned, check=False).returncode
    output.prepare_folder(options.out)
    with _progress() as progress:
        found = report.error_time(
            scene,
            bound=options.bound,
            repeats=options.repeats,
            quick=options.quick,
            progress=progress,
        )
    for level in table.LEVELS:
        print(table.advice(found.points, level), end="\n\n")
    print(table.ratio_table(found.points))
    files = found.write(options.out)
    print(f"\nWritten to {options.out}: {', '.join(file.name for file in files)}")
    return 0


def _stability(options: argparse.Namespace) -> int:
    import time

    from skfem_joint import output
    from skfem_joint.stability import cases, judge, report

    report.prepare()
    output.prepare_folder(options.out)
    begin = time.perf_counter()
    with _progress() as progress:
        chosen = cases.quick_matrix() if options.quick else cases.matrix()
        verdicts = judge.judge_all(chosen, progress=progress)
    seconds = time.perf_counter() - begin
    files = report.write(options.out, verdicts, seconds)
    print(report.text_table(verdicts))
    print(f"\n{report.bottom_line(verdicts, seconds)}")
    print(f"Written to {options.out}: {', '.join(file.name for file in files)}")
    return 1 if any(verdict.outcome == judge.WRONG for verdict in verdicts) else 0


@contextmanager
def _progress() -> Iterator[Progress | None]:
    """Progress bar on the error stream; nothing when that is not a terminal."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import Progress as Bar
    from rich.progress import TaskID

    with Bar(console=Console(stderr=True), transient=True) as bar:
        tasks: dict[str, TaskID] = {}

        def progress(label: str, done: int, total: int) -> None:
            if label not in tasks:
                tasks[label] = bar.add_task(label, total=total)
            bar.update(tasks[label], completed=done)

        yield progress


if __name__ == "__main__":
    sys.exit(main())
