"""Command line ``skfem-joint``: what each command calls, in order; exit status 0, 2, 3 or 130.

`main` reads the arguments and turns errors into a message and an exit status. Each command is one
function: it loads a scene, computes, writes the results and prints what is worth knowing of them.
"""

from __future__ import annotations

import argparse
import io
import logging
import os
import shlex
import signal
import subprocess
import sys
import threading
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor
from contextlib import (
    AbstractContextManager,
    closing,
    contextmanager,
    nullcontext,
    redirect_stdout,
    suppress,
)
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from skfem_joint import __version__
from skfem_joint.ground.errors import ConvergenceError, InputError, JointError, refuse
from skfem_joint.ground.files import read_text
from skfem_joint.ground.processes import SAFE_PATH
from skfem_joint.ground.progress import Progress, announced, progress_bar
from skfem_joint.ground.terminal import plain_streams, unfiltered

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from skfem_joint.fitting.measured import MeasuredCurve
    from skfem_joint.ground.rows import Rows
    from skfem_joint.scene import Scene
    from skfem_joint.study.results import Study

_log = logging.getLogger(__name__)

#: Exit status of an interrupted command, as of a shell for SIGINT.
INTERRUPTED = 130
#: Exit status where nobody reads the output, as of a shell for SIGPIPE.
BROKEN_PIPE = 141


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit status."""
    with plain_streams():
        try:
            try:
                return _status(arguments)
            except JointError as error:
                print(f"skfem-joint: {error}", file=sys.stderr)
                return error.exit_status
            except BrokenPipeError:  # the reader of the output has left, as of `| head`
                _drop_output()
                return BROKEN_PIPE
            except BrokenExecutor as error:
                print(f"skfem-joint: {_broken(error)}", file=sys.stderr)
                return ConvergenceError.exit_status
            except OSError as error:  # a full disk, of the output or of the compiled code
                _drop_output()
                print(f"skfem-joint: the system refuses a file: {error}", file=sys.stderr)
                return InputError.exit_status
            except KeyboardInterrupt:
                print("skfem-joint: interrupted", file=sys.stderr)
                return INTERRUPTED
        except OSError:  # the message could not be printed: the error stream is broken too
            _drop_output()
            return BROKEN_PIPE


def _status(arguments: Sequence[str] | None) -> int:
    """Exit status of the command that the arguments name."""
    commands = parser()
    options = commands.parse_args(arguments)
    options.given = sys.argv[1:] if arguments is None else arguments
    if options.command is None:
        commands.print_help()
        return 0
    with _messages(options), _stoppable():
        status: int = options.command(options)
    sys.stdout.flush()
    return status


def parser() -> argparse.ArgumentParser:
    """Parser of the arguments; ``options.command`` is the function of the command."""
    whole = argparse.ArgumentParser(
        prog="skfem-joint",
        description="Dynamics of bolted joints with micro-slip friction, full and reduced.",
        epilog="Exit status: 0 success, 2 bad input, 3 a run did not converge, 130 interrupted.",
    )
    whole.add_argument("--version", action="version", version=__version__)
    whole.set_defaults(command=None)
    _add_verbosity(whole, False)
    commands = whole.add_subparsers(title="commands", metavar="COMMAND")
    # Options that several commands share.
    scene, out, workers = (argparse.ArgumentParser(add_help=False) for _ in range(3))
    scene.add_argument("scene", type=Path, metavar="SCENE.toml", help="file of the scene")
    out.add_argument("--out", type=Path, required=True, metavar="DIR", help="folder of the results")
    out.add_argument(
        "--overwrite", action="store_true",
        help="write into DIR even if it has files of other origin, or results that were changed: "
        "those of the same names are replaced, no others removed",
    )  # fmt: skip
    workers.add_argument(
        "--workers", type=int, metavar="N",
        help="number of processes (default: all cores for a sweep, else 1)",
    )  # fmt: skip

    def add(name: str, command: Any, text: str, *parents: Any) -> argparse.ArgumentParser:
        meaning = f"{text[:1].upper()}{text[1:]}."
        made = commands.add_parser(name, parents=parents, help=text, description=meaning)
        made.set_defaults(command=command, name=name)
        _add_verbosity(made, argparse.SUPPRESS)
        return made

    run = add("run", _run, "integrate the models of a scene and report", scene, out, workers)
    _add_run_options(run)
    add("check", _check, "validate a scene without running it", scene)
    example = add("example", _example, "list the shipped scenes, or write one with its mesh")
    example.add_argument("scene", nargs="?", metavar="NAME", help="scene to write (default: list)")
    example.add_argument(
        "--out", type=Path, metavar="DIR", help="folder it is written to (default: ./NAME)"
    )
    preview = add("preview", _preview, "draw the structure of a scene before it is run", scene)
    preview.add_argument(
        "--out", type=Path, metavar="FILE.png",
        help="picture (default: name of the scene in the current folder)",
    )  # fmt: skip
    preview.add_argument(
        "--overwrite", action="store_true", help="replace the picture if it is there already"
    )
    keys = add("keys", _keys, "list every key of a scene: unit, default, allowed values, meaning")
    keys.add_argument(
        "table", nargs="?", default="", metavar="TABLE",
        help="table such as load or joint.pressure (default: all)",
    )  # fmt: skip
    add("backbone", _backbone, "frequency and damping of modes over amplitude", scene, out)
    add(
        "nonlinear-modes", _nonlinear_modes,
        "frequency and damping of modes over amplitude, into gross slip", scene, out,
    )  # fmt: skip
    add("response", _response, "steady vibration over frequency", scene, out, workers)
    add("random", _random, "response to a load by its power spectral density", scene, out)
    fitted = add("fit", _fit, "fit values of a scene to measured frequency and damping", scene, out)
    _add_fit_options(fitted)
    page = add(
        "report",
        _report,
        "one page of HTML about results of run, backbone, nonlinear-modes, response or random",
    )
    page.add_argument("results", type=Path, metavar="DIR", help="folder of the results")
    timed = add("error-time", _error_time, "error against run time of many models", scene, out)
    timed.add_argument(
        "--repeats", type=int, default=3, metavar="N", help="timed rounds (default 3)"
    )
    timed.add_argument("--quick", action="store_true", help="few points, one round")
    add("sweep", _sweep, "run the scenes of a [sweep], or go on with them", scene, out, workers)
    return whole


def _add_verbosity(parser: argparse.ArgumentParser, default: Any) -> None:
    """Add ``-v`` and ``-q``, which stand before or after the name of a command."""
    group = parser.add_mutually_exclusive_group()
    for short, name, text in (
        ("-v", "--verbose", "print what is done, and when"),
        ("-q", "--quiet", "print nothing but errors"),
    ):
        group.add_argument(short, name, action="store_true", default=default, help=text)


def _add_run_options(run: argparse.ArgumentParser) -> None:
    run.add_argument(
        "--models",
        metavar="NAME,NAME",
        help="run these models, of full, condensed and reduced, in place of the scene's models.run",
    )
    run.add_argument(
        "--certify",
        action="store_true",
        help="also estimate the error of the mesh, and check a reduced model by a short full "
        "run, in the processes of --workers",
    )
    run.add_argument(
        "--checkpoint-every",
        type=int,
        metavar="STEPS",
        help="save the run after every STEPS steps, when the time loop next pauses (after a cycle "
        "or half a second), until its results are written",
    )
    run.add_argument(
        "--resume",
        action="store_true",
        help="go on from the checkpoints in DIR, if there are any; results are the same to the bit",
    )


def _add_fit_options(fitted: argparse.ArgumentParser) -> None:
    fitted.add_argument(
        "--data", type=Path, action="append", required=True, metavar="FILE.csv",
        help="measured frequency and damping over amplitude, or a free vibration over time, with "
        "lines '# key: value' of what they are of; may be given several times",
    )  # fmt: skip
    fitted.add_argument(
        "--free", action="append", required=True, metavar="KEY=LOW..HIGH",
        help="key of the scene that is fitted within these bounds, as in "
        "'joint[0].friction=0.1..1.0' or 'bolt[*].force=8e3..16e3'; may be given several times",
    )  # fmt: skip
    fitted.add_argument(
        "--profile", action="store_true",
        help="also the interval of each value by its profile likelihood: some nine more fits each",
    )  # fmt: skip


def _run(options: argparse.Namespace) -> int:
    """Run the models of a scene, print a summary, estimate errors, write the results."""
    from skfem_joint import output
    from skfem_joint.output import report
    from skfem_joint.stepping.checkpoint import Checkpoints
    from skfem_joint.study.study import estimated, run_models

    scene, out, checkpoints = _scene_of_models(options), options.out, None
    if options.checkpoint_every is not None or options.resume:
        checkpoints = Checkpoints(out, options.checkpoint_every, options.resume)
        if options.resume and not checkpoints.files():
            _log.warning("No checkpoint in %s: the run starts anew.", out)
    with output.prepare(scene, out, options.overwrite) as notes:
        with _progress(options) as progress:
            study = run_models(scene, progress, checkpoints, out)
        lost = _printed(report.results_text(study))
        with _progress(options) as progress:
            study = estimated(study, progress)
            if options.certify and not study.ended:
                with _executor(options) as executor:
                    study = _certify(study, progress, executor)
            study = study.noting(*notes)
            # All files are written before what may fail is printed.
            files = output.write(study, out, progress)
            if checkpoints is not None and not study.ended:
                checkpoints.remove(study.models)
    if lost is not None:
        raise lost
    print(report.estimates_text(study), end="\n\n")
    _print_notes(study.notes, out, files)
    if study.failure is not None:
        raise study.failure.error
    if study.interrupted:
        saved = checkpoints is not None and checkpoints.files()
        if _is_saved(scene):
            print(
                "Go on with --resume." if saved else "A run with --checkpoint-every can be resumed."
            )
        return INTERRUPTED
    return 0


def _printed(text: str) -> OSError | None:
    """Print a text at once; returns why that failed, which must not cost what is still to come."""
    try:
        print(text, end="\n\n", flush=True)
    except OSError as error:
        return error
    return None


def _scene_of_models(options: argparse.Namespace) -> Scene:
    """Scene with the models of ``--models``, if it is there; InputError names it where it errs."""

    def chosen(scene: Scene) -> Scene:
        _check_run_options(options, scene)
        if options.models is None:
            return scene
        try:
            return scene.changed(models={"run": options.models.split(",")})
        except InputError as error:
            wrong = (text.removeprefix("changed") for text in error.problems)
            raise InputError([f"--models{text}" for text in wrong]) from error

    return chosen(_loaded(options, chosen))


def _loaded(options: argparse.Namespace, ready: Callable[[Scene], object] | None = None) -> Scene:
    """Scene of a command; ``ready`` refuses what it cannot take, before bolts are tightened."""
    from skfem_joint.scene import load_scene

    with _progress(options) as progress:
        return load_scene(options.scene, progress, ready)


def _vibrating(options: argparse.Namespace) -> Scene:
    """Scene of a command about vibration."""
    return _loaded(options, lambda scene: scene.check_vibrates(options.name))


def _checks() -> dict[str, Callable[[Scene], object]]:
    """What refuses a table of vibration that does not fit its scene, by the name of the table."""
    from skfem_joint.study.scene_backbone import backbone_table, nonlinear_table, random_table
    from skfem_joint.study.scene_response import response_table

    return {
        "backbone": backbone_table,
        "nonlinear_modes": nonlinear_table,
        "random": random_table,
        "response": response_table,
    }


def _asking(options: argparse.Namespace) -> Scene:
    """Scene of a command about vibration with the table of its name, which fits the structure."""
    from skfem_joint.output.universal import check_uff
    from skfem_joint.scene.tables import SERVED_BY

    table = options.name.replace("-", "_")

    def ready(scene: Scene) -> None:
        scene.check_vibrates(options.name)
        scene.asked(table)

    scene = _loaded(options, ready)
    with _progress(options) as progress, announced(progress, "making the structure"):
        _checks()[table](scene)  # before earlier results are removed
    if options.name in SERVED_BY["output.uff"]:
        check_uff(scene)
    return scene


def _answered(
    options: argparse.Namespace,
    compute: Callable[..., Any],
    write: Callable[[Path, Any], list[Path]],
    lines: Callable[[Any], Iterable[str]],
    kinds: Sequence[type] = (),
    scene: Scene | None = None,
) -> int:
    """Compute, write and print the results of a command; returns the exit status.

    ``compute`` is given the scene, that of the command's table if there is none yet, ``progress``,
    and ``rows`` of these ``kinds``, if there are any. Results have ``notes``, to which those about
    folder and scene are added.
    """
    scene = scene or _asking(options)
    kept_rows = _rows(options, kinds) if kinds else nullcontext()
    with _kept(options, scene) as notes, kept_rows as rows:
        with _progress(options) as progress:
            found = compute(scene, progress=progress, **({"rows": rows} if kinds else {}))
        found = replace(found, notes=(*found.notes, *notes))
        files = write(options.out, found)
    print("\n".join(lines(found)))
    _print_notes(found.notes, options.out, files)
    return ConvergenceError.exit_status if getattr(found, "failures", ()) else 0


def _is_saved(scene: Scene) -> bool:
    """Whether runs of a scene may have checkpoints."""
    return not scene.time.quasi_static and scene.time.until is None


def _check_run_options(options: argparse.Namespace, scene: Scene) -> None:
    """InputError for options that do not fit each other or the scene, and missing libraries."""
    from skfem_joint.output.folder import check_libraries

    if options.workers is not None and not options.certify:
        raise InputError("--workers: is for --certify, which is not there")
    if not _is_saved(scene) and (options.resume or options.checkpoint_every is not None):
        key = "quasi_static = true" if scene.time.quasi_static else "until = 'steady'"
        raise InputError(
            f"--checkpoint-every, --resume: a run with time.{key} has no checkpoints; leave them "
            "out"
        )
    check_libraries(scene)


def _certify(study: Study, progress: Progress, executor: Executor | None) -> Study:
    """Estimate more errors of each model; what ends this early does not cost the results."""
    from skfem_joint.study.certificate import certify
    from skfem_joint.study.results import Failure

    name = ""
    try:
        for name in study.models:
            study = study.holding(certify(study, name, progress, executor))
    except (JointError, BrokenExecutor) as error:
        cause = error if isinstance(error, JointError) else ConvergenceError(_broken(error))
        study = replace(study, failure=Failure(name, cause))
        return study.noting(f"The errors could not all be estimated: {cause}")
    except KeyboardInterrupt:
        note = "The run was interrupted while errors were estimated."
        return study.noting(note, interrupted=True)
    return study


def _check(options: argparse.Namespace) -> int:
    """Validate a scene and its sweep, and print what a run would be."""
    from skfem_joint.body.named_parts import named_parts
    from skfem_joint.runs.resolution import check_jumps, check_resolution
    from skfem_joint.runs.steady_run import check_steady
    from skfem_joint.scene.reading import load_with_sweep
    from skfem_joint.study.against_opening import against_opening
    from skfem_joint.study.description import description_of
    from skfem_joint.study.models import plan_of, with_friction

    # Everything is checked before the scene is called valid.
    with _progress(options) as progress:
        scene, swept, sweep_notes = load_with_sweep(options.scene, progress)
    system, (scene, left_out) = scene.system(), with_friction(scene)
    if not scene.accuracy.is_given:  # the accuracy would choose the step
        check_resolution(system, plan_of(scene))
        check_jumps(system, plan_of(scene))
    for table, check in _checks().items():
        if table in scene.model_fields_set:
            check(scene)
    if plan_of(scene).until == "steady":
        check_steady(system, plan_of(scene))
    print(
        f"{options.scene}: valid. {system.n} unknowns, {system.contact.count} contact points, "
        f"{scene.n_steps} steps of {scene.time_step:.6g} s, models: {', '.join(scene.models.run)}.",
        flush=True,
    )
    description = description_of(scene)
    body = scene.structure().body
    names = [] if body is None else named_parts(body)
    print("\n".join([*description.facts, *names]), flush=True)
    notes = [*scene.left_out, *left_out, *system.notes, *description.doubts, *sweep_notes]
    for note in dict.fromkeys(notes):
        print(f"Note: {note}", flush=True)
    # This may take seconds.
    slow_cycle = against_opening(scene, description.values.get("normal_force_change"))
    if slow_cycle is not None:
        print(f"Note: {slow_cycle}")
    if swept is not None:
        print(f"The sweep has {len(swept.scenes)} scenes, each valid.")
    return 0


def _example(options: argparse.Namespace) -> int:
    """Write a shipped scene with its mesh and print what to run; without a name, list them all."""
    from skfem_joint.scene.shipped import QUESTIONS, write_shipped

    if options.scene is None:
        if options.out is not None:
            raise InputError("--out: needs the NAME of a scene; without it they are listed")
        width = max(map(len, QUESTIONS))
        for name, question in QUESTIONS.items():
            print(f"{name:{width}}  {question}")
        print("\nskfem-joint example NAME writes one with its mesh into a folder of that name.")
        return 0
    files = write_shipped(options.scene, options.out or Path(options.scene))
    scene, folder = files[0], files[0].parent
    name = "sweep" if "sweep" in tomllib.loads(read_text(scene)) else "run"
    command = shlex.join(["skfem-joint", name, str(scene), "--out", str(folder / "out")])
    print(f"{QUESTIONS[options.scene]} To see it, run\n\n    {command}\n")
    return _print_notes((), folder, files)


def _preview(options: argparse.Namespace) -> int:
    """Draw mesh, names, supports, loads, joints and bolts of a scene, and say what was drawn."""
    from skfem_joint.output.drawing.preview import preview_of
    from skfem_joint.output.drawing.preview_picture import check_target, write_preview

    out = options.out or Path(f"{options.scene.stem}.png")
    check_target(out, overwrite=options.overwrite)  # before bolts are tightened
    preview = preview_of(_loaded(options))
    write_preview(out, preview)
    for kind in ("joint", "support", "load", "bolt"):
        if names := dict.fromkeys(mark.name for mark in preview.of_kind(kind)):
            print(f"{kind}: {', '.join(names)}")
    for note in preview.notes:
        print(f"Note: {note}")
    print(f"Written to {out}")
    return 0


def _keys(options: argparse.Namespace) -> int:
    """Print the keys that a scene may have."""
    from skfem_joint.scene import keys

    tables = keys.reference(options.table)
    if sys.stdout.isatty():
        from rich.console import Console

        keys.show(tables, Console(file=unfiltered(sys.stdout)))
    else:
        print(keys.markdown(tables), end="")
    return 0


def _backbone(options: argparse.Namespace) -> int:
    """Compute frequency and damping of modes over their amplitude, write and print them."""
    from skfem_joint.output import damping
    from skfem_joint.study.scene_backbone import scene_backbone

    compute = partial(scene_backbone, folder=options.out)
    return _answered(options, compute, damping.write_backbone, damping.backbone_lines)


def _nonlinear_modes(options: argparse.Namespace) -> int:
    """Compute modes into gross slip, write and print them."""
    from skfem_joint.output.nonlinear_modes import nonlinear_lines, write_nonlinear_modes
    from skfem_joint.study.scene_backbone import scene_nonlinear_modes

    return _answered(options, scene_nonlinear_modes, write_nonlinear_modes, nonlinear_lines)


def _response(options: argparse.Namespace) -> int:
    """Compute steady vibration over frequency, write it and print its peaks."""
    from skfem_joint.output import damping
    from skfem_joint.study.scene_response import RESPONSE_ROWS, scene_response

    def compute(scene: Scene, **how: Any) -> Any:
        with _executor(options) as executor:
            return scene_response(scene, executor, workers=options.workers, **how)

    written = damping.write_response, damping.response_lines
    return _answered(options, compute, *written, RESPONSE_ROWS)


def _random(options: argparse.Namespace) -> int:
    """Compute the response to a random load, write and print it."""
    from skfem_joint.output import damping
    from skfem_joint.study.scene_backbone import scene_random

    return _answered(options, scene_random, damping.write_random, damping.random_lines)


def _fit(options: argparse.Namespace) -> int:
    """Fit values of a scene to measured curves, write and print them."""
    from skfem_joint.fitting.fit import FitProblem, solved
    from skfem_joint.output import fits

    fits.check_apart(options.out, [options.scene, *options.data])
    free, data = _free(options.free), _measured(options)
    scene, text = _vibrating(options), read_text(options.scene)
    if scene.matrices is not None:
        raise InputError(
            f"{options.scene}: matrices: found a structure that is given by matrices, must be one "
            "with a mesh, whose values a fit can vary"
        )
    with _progress(options) as progress, announced(progress, "making the structure"):
        problem = FitProblem(scene, data, free)  # before earlier results are removed
    with _kept(options, scene) as notes:
        with _progress(options) as progress:
            found = solved(problem, progress)
            with announced(progress, "curves of the best values"):
                curves = found.curves()
            names = found.values if options.profile else ()
            profiles = [found.profile(name, progress=progress) for name in names]
        files, warnings = fits.write_fit(options.out, found, curves, text, notes, profiles)
    print("\n".join(fits.fit_lines(found) + fits.profile_lines(profiles)))
    return _print_notes(warnings, options.out, files)


def _free(given: Sequence[str]) -> dict[str, tuple[float, float]]:
    """Bounds by the keys of ``--free``; InputError with all that are wrong."""
    free: dict[str, tuple[float, float]] = {}
    problems = []
    for text in given:
        key, _, bounds = (part.strip() for part in text.rpartition("="))
        low, _, high = (part.strip() for part in bounds.partition(".."))
        try:
            pair = float(low), float(high)
        except ValueError:
            pair = None
        if not key or pair is None or high.startswith("."):
            problems.append(
                f"--free: found {text!r}, must be KEY=LOW..HIGH, as in 'joint[0].friction=0.1..1.0'"
            )
        elif key in free:
            problems.append(f"--free: found {key!r} twice, must be once")
        else:
            free[key] = pair
    refuse(problems)
    return free


def _measured(options: argparse.Namespace) -> list[MeasuredCurve]:
    """Curves of the files of ``--data``; InputError with all that is wrong in them."""
    from skfem_joint.fitting.measured import measured_curve

    curves, problems = [], []
    for path in options.data:
        try:
            curves.append(measured_curve(path))
        except InputError as error:
            problems += error.problems
    refuse(dict.fromkeys(problems))
    names = [curve.name for curve in curves]
    if len(set(names)) < len(names):  # of files in several folders
        names = [str(path) for path in options.data]
        refuse(f"--data: found {x} twice, must be once" for x in names if names.count(x) > 1)
    return [replace(curve, name=name) for curve, name in zip(curves, names, strict=True)]


def _report(options: argparse.Namespace) -> int:
    """Write a page about the results in a folder."""
    from skfem_joint.output.page import write_report

    print(f"Written to {write_report(options.results)}")
    return 0


def _error_time(options: argparse.Namespace) -> int:
    """Measure error against run time of many models, write it and print which to take."""
    from skfem_joint.output import folder
    from skfem_joint.study import error_time as comparison

    scene = _vibrating(options)
    if not comparison.threads_pinned(os.environ):
        # numpy reads the number of threads when it starts: another process is needed.
        again = [sys.executable, SAFE_PATH, "-m", "skfem_joint", *options.given]
        pinned = os.environ | dict.fromkeys(comparison.THREADS, "1")
        return _status_of(again, pinned)
    comparison.check_options(scene, options.repeats)  # before earlier results are removed
    compute = partial(comparison.error_time, repeats=options.repeats, quick=options.quick)

    def lines(measured: comparison.Report) -> Iterator[str]:
        return (f"{comparison.advice(measured.points, k)}\n" for k in comparison.LEVELS)

    return _answered(options, compute, folder.write_error_time, lines, comparison.ROWS, scene)


def _sweep(options: argparse.Namespace) -> int:
    """Run the scenes of a sweep that are not finished, write all rows and print the failures."""
    from skfem_joint.ground.rows import Rows
    from skfem_joint.output import sweeps
    from skfem_joint.scene import load_sweep
    from skfem_joint.study import sweep as analysis

    with _progress(options) as progress:
        swept = load_sweep(options.scene, progress)
    out, rows, interrupted = options.out, [], False
    with _kept(options, swept.scenes[0], swept.scenes[0].output.plots) as notes:
        kept = Rows(out / sweeps.JOURNAL)
        _announce(kept)
        with _progress(options) as progress, analysis.executors(options.workers) as make:
            try:
                with closing(analysis.rows(swept.scenes, make, kept, progress)) as finished:
                    for row in finished:
                        rows.append(row)
                        progress("scenes", len(rows), len(swept.scenes))
            except KeyboardInterrupt:
                interrupted = True
                seen = {row.number for row in rows}  # a row may have been kept at that moment
                now = analysis.kept_rows(swept.scenes, Rows(kept.path))
                rows += [row for row in now if row.number not in seen]
        files = sweeps.write(swept, rows, out, drawn=not interrupted)
    print("\n".join(sweeps.lines(swept, rows)))
    _print_notes([*kept.notes(), *notes], out, files)
    if interrupted:
        print("The same command goes on.")
        return INTERRUPTED
    return ConvergenceError.exit_status if any(row.failure for row in rows) else 0


# What the commands share


@contextmanager
def _messages(options: argparse.Namespace) -> Iterator[None]:
    """Print what the package logs on the error stream; with ``--quiet`` nothing but errors."""
    log, handler = logging.getLogger("skfem_joint"), logging.StreamHandler(sys.stderr)
    level = log.level
    style = "{relativeCreated:8.0f} ms  {message}" if options.verbose else "{message}"
    handler.setFormatter(logging.Formatter(style, style="{"))
    log.addHandler(handler)
    log.setLevel("INFO" if options.verbose else "ERROR" if options.quiet else "WARNING")
    try:
        with redirect_stdout(io.StringIO() if options.quiet else sys.stdout):
            yield
    finally:
        log.removeHandler(handler)
        log.setLevel(level)


@contextmanager
def _stoppable() -> Iterator[None]:
    """Let SIGTERM end a command as an interrupt does: finished work is kept, locks are freed."""
    if threading.current_thread() is not threading.main_thread():  # only that one takes signals
        yield
        return
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before or signal.SIG_DFL)


def _drop_output() -> None:
    """Discard what is still to be printed."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    with suppress(OSError):  # a stream without a file
        os.dup2(nowhere, sys.stdout.fileno())
    os.close(nowhere)


def _progress(options: argparse.Namespace) -> AbstractContextManager[Progress]:
    """Progress on the error stream, as the options ask for it."""
    return progress_bar(options.quiet, options.verbose)


@contextmanager
def _kept(options: argparse.Namespace, scene: Scene, drawn: bool = True) -> Iterator[list[str]]:
    """Folder of the results, reserved for a command; gives notes about it and the scene's keys."""
    from skfem_joint.output.folder import kept

    with kept(options.out, drawn, options.overwrite) as notes:
        yield [*notes, *scene.passed_over(options.name)]


@contextmanager
def _executor(options: argparse.Namespace) -> Iterator[Executor | None]:
    """Processes that the options ask for; None if this one is to do the work alone."""
    from skfem_joint.study.sweep import executors

    with executors(options.workers) as make:
        executor = None if options.workers in (None, 1) else make()
        yield executor
        if executor is not None:  # else, after an error, nobody waits for what still runs
            executor.shutdown()


@contextmanager
def _rows(options: argparse.Namespace, kinds: Sequence[type]) -> Iterator[Rows]:
    """Rows of finished work of a command in its folder, removed when its results are written.

    If the block ends early, the number of finished rows is printed: the same command uses them.
    """
    from skfem_joint.ground.rows import Rows

    rows = Rows(options.out / f"{options.name}_rows.jsonl", kinds)
    _announce(rows)
    try:
        yield rows
    except BaseException as error:
        if kept := Rows(rows.path).known:  # the last row may have been written at that moment
            print(f"{kept} rows are finished and kept in {rows.path}.")
        if isinstance(error, KeyboardInterrupt):
            print("The same command goes on.")
        raise
    rows.remove()
    for note in rows.notes():
        print(f"Note: {note}")


def _announce(rows: Rows) -> None:
    """Say that an earlier command has finished rows, before the command goes on from them."""
    if rows.known:
        _log.warning("%s: %d finished rows are taken up where they fit.", rows.path, rows.known)


def _print_notes(warnings: Sequence[str], out: Path, files: Sequence[Path]) -> int:
    """Print each warning once, and where the results are; returns the status of success."""
    for warning in dict.fromkeys(warnings):
        print(f"Note: {warning}")
    print(f"Written to {out}: {', '.join(file.name for file in files)}")
    return 0


def _status_of(command: Sequence[str], environment: Mapping[str, str]) -> int:
    """Exit status of a process that ends when this one is interrupted."""
    # In a process group of its own, so that a terminal does not interrupt it a second time.
    with subprocess.Popen(command, env=environment, process_group=0) as process:
        while process.returncode is None:
            try:
                process.wait()
            except KeyboardInterrupt:
                process.terminate()
    status = process.returncode
    return status if status >= 0 else 128 - status


def _broken(error: BrokenExecutor) -> str:
    return (
        f"a worker's process ended before its run; it may need more memory than there is ({error})"
    )


if __name__ == "__main__":
    sys.exit(main())
