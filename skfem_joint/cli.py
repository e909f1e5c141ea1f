"""Command line ``skfem-joint``. Exit status 0, 2 (bad input) or 3 (no convergence)."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from skfem_joint import __version__
from skfem_joint.errors import JointError
from skfem_joint.study import Progress

INTERRUPTED = 130


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    options = _parser().parse_args(arguments)
    try:
        status: int = options.command(options)
        return status
    except JointError as error:
        print(f"skfem-joint: {error}", file=sys.stderr)
        return error.exit_status
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
    return parser


def _check(options: argparse.Namespace) -> int:
    from skfem_joint.scene import load_scene
    from skfem_joint.structure import assemble
    from skfem_joint.study import structure_of

    scene = load_scene(options.scene)
    structure = structure_of(scene)
    loads = [(item.on, item.to_load()) for item in scene.load]
    system = assemble(structure, loads, scene.output_points)
    limit = float(system.w.sum())
    print(
        f"{options.scene}: valid. {system.n} unknowns, {system.contact_points} contact points, "
        f"{scene.n_steps} steps of {scene.time_step:.6g} s, models: {', '.join(scene.models.run)}."
    )
    for on, load in loads:
        if limit > 0.0:
            print(f"Load on {on}: {100.0 * load.peak_value / limit:.3g} % of the friction limit.")
    return 0


def _run(options: argparse.Namespace) -> int:
    from skfem_joint import output, report
    from skfem_joint.certificate import certify
    from skfem_joint.scene import load_scene
    from skfem_joint.study import run_scene

    scene = load_scene(options.scene)
    output.prepare(scene, options.out)
    certificate = {}
    with _progress() as progress:
        study = run_scene(scene, progress)
        if options.certify and not study.interrupted:
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
    files = output.write(study, options.out, certificate)
    print(f"\nWritten to {options.out}: {', '.join(file.name for file in files)}")
    return INTERRUPTED if study.interrupted else 0


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


@contextmanager
def _progress() -> Iterator[Progress | None]:
    """Progress bar on the error stream; nothing when that is not a terminal."""
    if not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import Progress as Bar

    with Bar(console=Console(stderr=True), transient=True) as bar:
        tasks: dict[str, object] = {}

        def progress(label: str, done: int, total: int) -> None:
            if label not in tasks:
                tasks[label] = bar.add_task(label, total=total)
            bar.update(tasks[label], completed=done)  # type: ignore[arg-type]

        yield progress


if __name__ == "__main__":
    sys.exit(main())
