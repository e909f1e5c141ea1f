"""Command line ``skfem-joint`` and its commands; exit status 0, 2, 3 or 130."""

from __future__ import annotations

import argparse
import io
import logging
import os
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor
from contextlib import AbstractContextManager, closing, contextmanager, redirect_stdout, suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from skfem_joint import __version__
from skfem_joint.errors import ConvergenceError, InputError, JointError
from skfem_joint.files import needed
from skfem_joint.processes import SAFE_PATH
from skfem_joint.progress import Progress, progress_bar
from skfem_joint.terminal import plain_streams, unfiltered

if TYPE_CHECKING:
    from concurrent.futures import Executor

    from skfem_joint.analysis.models import Study
    from skfem_joint.analysis.rows import Rows

_log = logging.getLogger(__name__)

_BROKEN = "a worker's process ended before its run; it may need more memory than there is"
INTERRUPTED = 130
BROKEN_PIPE = 141


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line; returns the exit status."""
    with plain_streams():
        try:
            return _main(arguments)
        except OSError:  # the error stream, on which the reason was to be told, is broken too
            _drop_output()
            return BROKEN_PIPE


def _main(arguments: Sequence[str] | None) -> int:
    parser = _parser()
    options = parser.parse_args(arguments)
    options.given = sys.argv[1:] if arguments is None else arguments
    try:
        if options.print_completion:
            print(needed("shtab", "completion").complete(parser, options.print_completion))
            return 0
        if options.command is None:
            parser.print_help()
            return 0
        with _words(options), _stoppable():
            status: int = options.command(options)
        sys.stdout.flush()
        return status
    except JointError as error:
        print(f"skfem-joint: {error}", file=sys.stderr)
        return error.exit_status
    except BrokenPipeError:  # the reader of the output has left: `| head`
        _drop_output()
        return BROKEN_PIPE
    except BrokenExecutor as error:
        print(f"skfem-joint: {_BROKEN} ({error})", file=sys.stderr)
        return ConvergenceError.exit_status
    except OSError as error:  # a full disk, below the output or where compiled code is kept
        _drop_output()
        print(f"skfem-joint: the system refuses a file: {error}", file=sys.stderr)
        return InputError.exit_status
    except KeyboardInterrupt:
        print("skfem-joint: interrupted", file=sys.stderr)
        return INTERRUPTED


@contextmanager
def _stoppable() -> Iterator[None]:
    """Let SIGTERM end a command as an interrupt does: what is finished is kept, locks are freed."""
    if threading.current_thread() is not threading.main_thread():  # which alone takes signals
        yield
        return
    before = signal.signal(signal.SIGTERM, signal.default_int_handler)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before or signal.SIG_DFL)


def _drop_output() -> None:
    """Let what is still to be printed go nowhere."""
    nowhere = os.open(os.devnull, os.O_WRONLY)
    with suppress(OSError):  # a stream without a file
        os.dup2(nowhere, sys.stdout.fileno())
    os.close(nowhere)


@contextmanager
def _words(options: argparse.Namespace) -> Iterator[None]:
    """Say what the package logs on the error stream, as much as is asked for."""
    log, handler = logging.getLogger("skfem_joint"), logging.StreamHandler(sys.stderr)
    style = "{relativeCreated:8.0f} ms  {message}" if options.verbose else "{message}"
    handler.setFormatter(logging.Formatter(style, style="{"))
    log.addHandler(handler)
    log.setLevel("INFO" if options.verbose else "ERROR" if options.quiet else "WARNING")
    try:
        with redirect_stdout(io.StringIO() if options.quiet else sys.stdout):
            yield
    finally:
        log.removeHandler(handler)


def _progress(options: argparse.Namespace) -> AbstractContextManager[Progress]:
    return progress_bar(options.quiet, options.verbose)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="skfem-joint",
        description="Dynamics of bolted joints with micro-slip friction, full and reduced.",
        epilog="Exit status: 0 success, 2 bad input, 3 a run did not converge, 130 interrupted.",
    )
    parser.add_argument("--version", action="version", version=__version__)
    parser.add_argument(
        "--print-completion",
        choices=("bash", "zsh", "tcsh"),
        help="completion of a shell, to be sourced by it",
    )
    parser.set_defaults(command=None)
    commands = parser.add_subparsers(title="commands", metavar="COMMAND")

    said, given, written, shared = (argparse.ArgumentParser(add_help=False) for _ in range(4))
    for place, default in ((parser, False), (said, argparse.SUPPRESS)):  # of it and of a command
        more = place.add_mutually_exclusive_group()
        how: dict[str, Any] = {"action": "store_true", "default": default}
        more.add_argument("-v", "--verbose", help="tell what is done, when", **how)
        more.add_argument("-q", "--quiet", help="tell nothing but errors", **how)
    shared.add_argument(
        "--executor", choices=("processes", "dask", "mpi"), default="processes", help="what runs it"
    )
    shared.add_argument(
        "--workers",
        type=int,
        metavar="N",
        help="processes (default: all cores; of others than sweep one)",
    )
    shared.add_argument(
        "--address", help="of the scheduler of a dask cluster (default: a local one)"
    )
    scene = given.add_argument("scene", type=Path, metavar="SCENE.toml")
    files = {"bash": "_shtab_compgen_files", "zsh": "_files", "tcsh": "f"}
    scene.complete = files  # type: ignore[attr-defined]
    written.add_argument("--out", type=Path, required=True, metavar="DIR", help="results' folder")
    made = {}
    for name, command, parents, text in (
        ("run", _run, (given, written, shared), "integrate the models of a scene and report"),
        ("check", _check, (given,), "validate a scene without running it"),
        ("keys", _keys, (), "every key of a scene: unit, default, what is allowed, meaning"),
        ("backbone", _backbone, (given, written), "frequency and damping of modes over amplitude"),
        ("response", _response, (given, written, shared), "steady vibration over frequency"),
        ("error-time", _error_time, (given, written), "error against run time of many models"),
        ("sweep", _sweep, (given, written, shared), "run the scenes of a [sweep] or go on"),
    ):
        made[name] = commands.add_parser(name, parents=[said, *parents], help=text)
        made[name].set_defaults(command=command, name=name)
    made["keys"].add_argument("table", nargs="?", default="", metavar="TABLE", help="such as load")
    made["error-time"].add_argument(
        "--repeats", type=int, default=3, metavar="N", help="timed rounds (default 3)"
    )
    made["error-time"].add_argument("--quick", action="store_true", help="few points, one round")
    _add_run_options(made["run"])
    return parser


def _add_run_options(run: argparse.ArgumentParser) -> None:
    run.add_argument(
        "--certify",
        action="store_true",
        help="estimate the errors of mesh and beta too, of a reduced model by a short full run; "
        "the executor runs what that takes",
    )
    run.add_argument(
        "--checkpoint-every",
        type=int,
        metavar="STEPS",
        help="save the run after every so many steps, where a cycle or half a second has passed "
        "since the last look, until its results are written",
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


def _keys(options: argparse.Namespace) -> int:
    from skfem_joint.scene import keys

    tables = keys.reference(options.table)
    if sys.stdout.isatty():
        from rich.console import Console

        keys.show(tables, Console(file=unfiltered(sys.stdout)))
    else:
        print(keys.markdown(tables), end="")
    return 0


def _check(options: argparse.Namespace) -> int:
    from skfem_joint.analysis import memory
    from skfem_joint.analysis.asked import plan_of
    from skfem_joint.analysis.description import describe
    from skfem_joint.scene import load_scene, load_sweep
    from skfem_joint.stepping.resolution import check_jumps, check_resolution
    from skfem_joint.structure import doubts

    scene = load_scene(options.scene)
    system = scene.system()
    if not scene.accuracy.asked:  # which shortens the step
        check_resolution(system, plan_of(scene))
        check_jumps(system, plan_of(scene))
    # All of it is checked before it is called valid.
    swept = None if scene.sweep is None else load_sweep(options.scene)
    found = describe(scene)
    notes = *doubts(scene.structure(), system), *found.doubts
    need = sum(memory.needed(scene).values())
    print(
        f"{options.scene}: valid. {system.n} unknowns, {system.contact_points} contact points, "
        f"{scene.n_steps} steps of {scene.time_step:.6g} s, models: {', '.join(scene.models.run)}."
    )
    print("\n".join(found.facts))
    for note in dict.fromkeys(notes):
        print(f"Note: {note}")
    if swept is not None:
        print(f"The sweep has {len(swept.scenes)} scenes, each valid.")
    print(f"A run needs about {memory.size(need)} beside the program.")
    return 0


def _run(options: argparse.Namespace) -> int:
    from skfem_joint import output
    from skfem_joint.analysis import memory
    from skfem_joint.analysis.study import run_scene
    from skfem_joint.output import report
    from skfem_joint.scene import load_scene
    from skfem_joint.stepping.checkpoint import Checkpoints

    scene, out = load_scene(options.scene), options.out
    chosen = options.executor, options.workers, options.address
    if chosen != ("processes", None, None) and not options.certify:
        raise InputError("--executor, --workers, --address: are for --certify, which is not there")
    limit = options.memory_limit
    memory.check(scene, memory.default_limit() if limit is None else limit * memory.GIB)
    checkpoints = None
    if options.checkpoint_every is not None or options.resume:
        checkpoints = Checkpoints(out, options.checkpoint_every, options.resume)
        if options.resume and not checkpoints.files():
            _log.warning("No checkpoint in %s: the run starts anew.", out)
    # Results before words: nothing is printed until all files are written.
    with output.prepare(scene, out) as notes, _progress(options) as progress:
        study = run_scene(scene, progress, checkpoints)
        if options.certify and not study.ended:
            with _executor(options) as executor:
                study = _certify(study, progress, executor)
        study = study.noting(*notes)
        files = output.write(study, out, progress)
        if checkpoints is not None and not study.ended:
            checkpoints.remove(study.models)
    if scene.title:
        print(f"{scene.title}\n")
    print("\n".join(study.description.facts), end="\n\n")
    content = report.summary(study)
    for table in (report.summary_table(content), report.estimate_table(content)):
        print(table, end="\n\n")
    _told(study.warnings, out, files)
    if study.failure is not None:
        raise study.failure.error
    if study.interrupted:
        saved = checkpoints is not None and checkpoints.files()
        print("Go on with --resume." if saved else "A run with --checkpoint-every can be resumed.")
        return INTERRUPTED
    return 0


@contextmanager
def _executor(options: argparse.Namespace) -> Iterator[Executor | None]:
    """Executor that the options ask for; none for one process, which is this one."""
    from skfem_joint.analysis.sweep import executors

    with executors(options.executor, options.workers, options.address) as make:
        if options.executor == "processes" and options.workers in (None, 1):
            yield None
        else:
            executor = make()
            try:
                yield executor
            except BaseException:  # what still runs is not waited for
                executor.shutdown(wait=False, cancel_futures=True)
                raise
            executor.shutdown()


def _certify(study: Study, progress: Progress, executor: Executor | None) -> Study:
    """Estimate more errors of each model; what ends it early does not cost the results."""
    from skfem_joint.analysis.certificate import certify
    from skfem_joint.analysis.models import Failure

    name = ""
    try:
        for name in study.models:
            study = study.holding(certify(study, name, progress, executor))
    except (JointError, BrokenExecutor) as error:
        told = error if isinstance(error, JointError) else ConvergenceError(f"{_BROKEN} ({error})")
        study = replace(study, failure=Failure(name, told))
        return study.noting(f"The errors could not all be estimated: {told}")
    except KeyboardInterrupt:
        note = "The run was interrupted while errors were estimated."
        return study.noting(note, interrupted=True)
    return study


def _error_time(options: argparse.Namespace) -> int:
    from skfem_joint.analysis import error_time as comparison
    from skfem_joint.output import folder
    from skfem_joint.scene import load_scene

    scene = load_scene(options.scene)
    if not comparison.threads_pinned(os.environ):
        # Read when numpy starts, so that it takes another process.
        again = [sys.executable, SAFE_PATH, "-m", "skfem_joint", *options.given]
        pinned = os.environ | dict.fromkeys(comparison.THREADS, "1")
        return _status_of(again, pinned)
    with folder.kept(options.out) as notes, _rows(options, comparison.ROWS) as rows:
        with _progress(options) as progress:
            how = {"repeats": options.repeats, "quick": options.quick}
            found = comparison.error_time(scene, **how, progress=progress, rows=rows)
        files = folder.write_error_time(options.out, found, notes)
    for level in comparison.SETTINGS.levels:
        print(comparison.advice(found.points, level), end="\n\n")
    return _told(notes, options.out, files)


def _status_of(command: Sequence[str], environment: Mapping[str, str]) -> int:
    """Exit status of a process that is told to end, once, when this one is."""
    # In a group of its own, lest a terminal tell it too.
    with subprocess.Popen(command, env=environment, process_group=0) as process:
        while process.returncode is None:
            try:
                process.wait()
            except KeyboardInterrupt:
                process.terminate()
    status = process.returncode
    return status if status >= 0 else 128 - status


@contextmanager
def _rows(options: argparse.Namespace, kinds: Sequence[type]) -> Iterator[Rows]:
    """Rows of finished work of a command in its folder, removed when its results are written.

    If the block ends early it is said how many are kept. They are used by the same command alone.
    """
    from skfem_joint.analysis.rows import Rows

    rows = Rows(options.out / f"{options.name}_rows.jsonl", kinds)
    if rows.known:
        _log.warning("%s: %d finished rows are taken up where they fit.", rows.path, rows.known)
    try:
        yield rows
    except BaseException as error:
        if kept := Rows(rows.path).known:  # the last one may have been written in that moment
            print(
                f"{kept} of {max(rows.asked, kept)} rows, as far as they are known, are finished "
                f"and kept in {rows.path}."
            )
        if isinstance(error, KeyboardInterrupt):
            print("The same command goes on.")
        raise
    rows.remove()
    for note in rows.notes():
        print(f"Note: {note}")


def _backbone(options: argparse.Namespace) -> int:
    from skfem_joint.analysis.scene_backbone import BACKBONE_ROWS, scene_backbone
    from skfem_joint.output import damping
    from skfem_joint.output.folder import kept
    from skfem_joint.scene import load_scene

    scene = load_scene(options.scene)
    with kept(options.out) as notes, _rows(options, BACKBONE_ROWS) as rows:
        with _progress(options) as progress:
            found = scene_backbone(scene, progress, rows)
        found = replace(found, warnings=(*found.warnings, *notes))
        files = damping.write_backbone(options.out, found)
    for model in found.models:
        for curve in model.curves:
            f, ratio, state = curve.frequency, 100.0 * curve.damping_ratio, curve.state
            print(
                f"{model.name} model, mode {curve.mode}: {f[0]:.6g} to {f[-1]:.6g} Hz (stuck "
                f"{curve.stuck_frequency:.6g} Hz), damping {ratio[0]:.3g} to {ratio[-1]:.3g} %, "
                f"{state[0]} to {state[-1]} slip."
            )
        if model.name != "full":
            worst = {k: 100.0 * max(e[k] for e in model.errors) for k in model.errors[0]}
            print(
                f"It errs by {worst['frequency']:.2g} % in frequency and by "
                f"{worst['damping_ratio']:.2g} % in damping at most."
            )
    return _told(found.warnings, options.out, files)


def _response(options: argparse.Namespace) -> int:
    from skfem_joint.analysis.scene_response import RESPONSE_ROWS, scene_response
    from skfem_joint.output import damping
    from skfem_joint.output.folder import kept
    from skfem_joint.scene import load_scene

    scene = load_scene(options.scene)
    with kept(options.out) as notes, _rows(options, RESPONSE_ROWS) as rows:
        with _progress(options) as progress, _executor(options) as executor:
            found = scene_response(scene, executor, progress, rows)
        found = replace(found, warnings=(*found.warnings, *notes))
        files = damping.write_response(options.out, found)
    for model in found.models:
        for curve in model.curves:
            frequency, amplitude = curve.peak
            print(
                f"{model.name} model, level {curve.level:g}: peak {1e3 * amplitude:.5g} mm at "
                f"{frequency:.6g} Hz, {len(curve.points)} frequencies."
            )
    return _told(found.warnings, options.out, files)


def _told(warnings: Sequence[str], out: Path, files: Sequence[Path]) -> int:
    """Print what to beware of and where the results are."""
    for warning in dict.fromkeys(warnings):
        print(f"Note: {warning}")
    print(f"Written to {out}: {', '.join(file.name for file in files)}")
    return 0


def _sweep(options: argparse.Namespace) -> int:
    from skfem_joint.analysis import sweep as analysis
    from skfem_joint.output import folder, sweeps
    from skfem_joint.scene import load_sweep

    swept, out, rows, interrupted = load_sweep(options.scene), options.out, [], False
    with folder.kept(out, swept.scenes[0].output.plots) as notes:
        pass  # what goes on from its rows takes the folder itself
    chosen = analysis.executors(options.executor, options.workers, options.address)
    with _progress(options) as progress, chosen as executor:
        journal = out / sweeps.JOURNAL
        try:
            with closing(analysis.sweep(swept.scenes, executor, journal)) as found:
                for row in found:
                    rows.append(row)
                    progress("scenes", len(rows), len(swept.scenes))
        except KeyboardInterrupt:
            interrupted = True
    files = sweeps.write(swept, rows, out)
    failed = [row for row in rows if row.failure]
    for row in failed:
        print(f"Scene {row.number}, {swept.named(row.number)}: {row.failure}\n")
    print(f"{len(rows)} of {len(swept.scenes)} scenes have ended, {len(failed)} of them failed.")
    doubts = sweeps.doubtful(rows)
    if any(doubts.values()):
        print(
            f"{doubts['scenes_with_warnings']} have warnings, {doubts['scenes_not_steady']} are "
            f"not steady: see the columns of {sweeps.TABLE}."
        )
    _told(notes, out, files)
    if interrupted:
        print("The same command goes on.")
        return INTERRUPTED
    return ConvergenceError.exit_status if failed else 0


if __name__ == "__main__":
    sys.exit(main())
