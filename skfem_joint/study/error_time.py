"""Error against run time of a scene's models, for many time steps, laws and numbers of modes.

All runs are compared with a reference solution (`skfem_joint.study.certificate`) at the ends of
equal intervals of the run; a "part" is a step within an interval.
"""

from __future__ import annotations

import os
import platform
import statistics
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cache, partial
from math import inf, isinf
from typing import Any

import numpy as np

from skfem_joint.ground.errors import InputError, JointError, refuse
from skfem_joint.ground.progress import Progress, silent
from skfem_joint.ground.rows import Rows
from skfem_joint.reduction.models import reduced_on
from skfem_joint.results.history import QUANTITIES, Results, difference, results
from skfem_joint.scene import Scene
from skfem_joint.study.certificate import Reference, make_reference
from skfem_joint.study.models import model_of, options_of, origin_of
from skfem_joint.system.system import System

#: Steps in an interval of the finest run of each model, against which the error of its time step
#: is measured.
OWN = 256
#: Errors of the displacement history for which the report recommends the fastest model.
LEVELS: tuple[float, ...] = (1e-2, 1e-3, 1e-4)


#: Families of models, which are the curves of the report.
FULL, STEEPNESS, COULOMB = "full", "full, another beta", "full, Coulomb"
REDUCED, FEW_POINTS = "reduced, all nodes", "reduced, few points"
FINISHED = "finished"
#: Columns of errors beside those of the certificate.
RMS, TIME_ERROR, TO_FINE_MESH = QUANTITIES[0], "time-step error", "to fine mesh"
#: Files of a report.
FILES = ("error-time.md", "error-time.csv", "error-time.png", "total-time.png")
#: Variables that set the threads of the usual BLAS libraries.
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
#: Runs of a report: steps in an interval for full and for reduced models (at most a quarter of the
#: reference's), other values of beta over the scene's, and numbers of modes. `QUICK` is the same
#: for a quick report.
RANGE: dict[str, tuple[Any, ...]] = {
    "parts": (1, 2, 4, 8, 16, 32, 64),
    "reduced_parts": (1, 2, 4, 8),
    "factors": (0.01, 0.1, 10.0, 100.0),
    "modes": (1, 2, 3, 5, 7, 9, 12, 15),
}
QUICK = {"parts": (1, 4, 16), "reduced_parts": (2, 4), "factors": (10.0,), "modes": (2, 5)}
_NOTES = (
    "Errors are relative; those of peak and energies are of the last cycle (the whole run without "
    "cycles). Errors of other laws, meshes and reduced models contain what the law, the mesh and "
    "the modes leave out; `time-step error` is against the same model at tiny steps, `to fine "
    "mesh` against the finest mesh of the certificate. Run time is the median of the runs counted, "
    "in rounds of opposite order; off-line time holds everything before the first step."
)


@dataclass(frozen=True)
class Outcome:
    """One run of a job.

    Attributes
    ----------
    results : Results, optional
        None if the run did not reach its end.
    wall_s, offline_s : float
        Run time, and time before its first step, s.
    work : mapping of str to int
        Counters of its work.
    status : str
        `FINISHED`, or why it did not reach its end.
    """

    results: Results | None
    wall_s: float = inf
    work: Mapping[str, int] = field(default_factory=dict)
    status: str = FINISHED
    offline_s: float = 0.0


@dataclass(frozen=True)
class Job:
    """Run that is to be measured.

    Attributes
    ----------
    family : str
        Name of its curve.
    what : mapping of str
        Description of the run, by name: modes, friction points, step (s) and so on.
    run : callable
        Executes the run once.
    offline_s : float
        Preparation before the run, s.
    own : Results, optional
        Results of the same discrete model without time-step error.
    truth : Results, optional
        Results to compare with instead of the reference's.
    """

    family: str
    what: Mapping[str, Any]
    run: Callable[[], Outcome]
    offline_s: float = 0.0
    own: Results | None = None
    truth: Results | None = None


@dataclass(frozen=True)
class Measured:
    """A measured job: its first run, its errors, the median of ``repeats`` run times (s)."""

    job: Job
    outcome: Outcome
    errors: Mapping[str, float | None]
    wall_s: float
    repeats: int = 1

    @property
    def counts(self) -> bool:
        """Whether it was run to its end, so that time and error belong together."""
        return self.outcome.status == FINISHED and bool(self.errors)

    @property
    def offline_s(self) -> float:
        """All time before the first step, s."""
        return self.job.offline_s + self.outcome.offline_s

    def seconds(self, total: bool) -> float:
        """Run time, s; in ``total`` with all before the first step."""
        return self.wall_s + total * self.offline_s

    def error(self, name: str = RMS) -> float:
        """Error by its name; infinite where it is not known."""
        value = self.errors.get(name)
        return inf if value is None else value

    def __str__(self) -> str:
        shown = ("mesh", "modes", "friction points", "beta (s/m)", "step (s)", "tolerance")
        what = [f"{key} {_cell(self.job.what[key])}" for key in shown if self.job.what.get(key)]
        return f"{self.job.family} ({', '.join(what)}; {_seconds(self.wall_s)})"


#: What rows of finished work hold, of `error_time`.
ROWS = (Outcome, Results)


def measure(
    jobs: Iterable[Job],
    reference: Reference,
    *,
    repeats: int,
    progress: Progress = silent,
    rows: Rows | None = None,
    of: str = "",
) -> list[Measured]:
    """Run jobs once, which warms them up, and compare their results with the reference.

    Those shorter than two seconds are run again in ``repeats`` rounds,
    each in the opposite order of the round before; their time is the median of these. Each run is
    one of the ``rows``, if there are any, with the time that it took; ``of`` is a digest of what
    the jobs come from.
    """
    jobs, points, rows = list(jobs), [], rows or Rows()
    marks = [rows.mark(of, k, job.family, job.what) for k, job in enumerate(jobs)]
    for k, job in enumerate(jobs):
        progress("first runs", k, len(jobs))
        first = rows.row(marks[k], partial(_first, job))
        errors: dict[str, float | None] = {}
        if first.results is not None:
            errors = difference(job.truth or reference.results, first.results)
            own = None if job.own is None else difference(job.own, first.results)[RMS]
            errors[TIME_ERROR] = own
            errors[TO_FINE_MESH] = difference(reference.fine_mesh, first.results)[RMS]
        points.append(Measured(job, first, errors, first.wall_s))
    # Longer runs are not repeated, s.
    short = [k for k, p in enumerate(points) if p.counts and p.wall_s <= 2.0]
    walls: dict[int, list[float]] = {k: [] for k in short}
    for done in range(repeats):
        progress("timed rounds", done, repeats)
        for k in short if done % 2 == 0 else short[::-1]:
            mark = rows.mark(marks[k], "round", done)
            walls[k].append(rows.row(mark, partial(_timed, jobs[k])))
    for k in short:
        points[k] = replace(points[k], wall_s=statistics.median(walls[k]), repeats=repeats)
    return points


def _first(job: Job) -> Outcome:
    try:
        return job.run()
    except JointError as error:  # does not converge, or the step is too long for the load
        return Outcome(None, status=str(error))


def _timed(job: Job) -> float:
    return job.run().wall_s


def full_jobs(
    reference: Reference, wanted: Mapping[str, tuple[Any, ...]], rows: Rows
) -> Iterator[Job]:
    """Full models: the scene's law, and others."""
    system, parts = reference.system, wanted["parts"]
    own = COULOMB if isinf(system.contact.beta.max()) else FULL
    made = _details(system)
    yield from _jobs(reference, parts, own, lambda: system, made, own=reference.results)
    if own == FULL:
        for factor in wanted["factors"]:
            other = system.with_contact(beta=factor * system.contact.beta)
            yield from other_jobs(reference, parts, STEEPNESS, other, {}, rows)
        yield from other_jobs(reference, parts, COULOMB, system.with_beta(np.inf), {}, rows)


def other_jobs(
    reference: Reference,
    parts: Sequence[int],
    family: str,
    system: System,
    what: Mapping[str, Any],
    rows: Rows | None = None,
) -> Iterator[Job]:
    """Another full model at several steps an interval, with a reference of its own."""
    grid, finest, rows = reference.grid, min(OWN, reference.parts), rows or Rows()
    mark = rows.mark("own reference", system, grid, finest)
    own = rows.row(mark, lambda: results(grid.integrate(system, finest)))
    details = {**what, **_details(system)}
    return _jobs(reference, parts, family, lambda: system, details, own=own)


def reduced_jobs(
    scene: Scene, reference: Reference, wanted: Mapping[str, tuple[Any, ...]], rows: Rows
) -> Iterator[Job]:
    """Reduced models: friction at all nodes, and at few points, else with the scene's options.

    They are made when a run needs them first.
    """
    given = options_of(scene)
    # With contact that opens all friction points are kept.
    families = {REDUCED: "all"} | ({} if scene.opens else {FEW_POINTS: "auto"})

    @cache
    def models(modes: int) -> dict[str, tuple[System, float]]:
        """By family: the model, and how long it took to make, s."""
        begin, made = time.perf_counter(), {}
        every = model_of("reduced", scene, replace(given, modes=modes, friction_points="all"))
        offline = time.perf_counter() - begin
        for family, points in families.items():
            begin, small = time.perf_counter(), every
            if points != "all":
                how: dict[str, Any] = {"friction_points": points, "beta": given.beta}
                small = reduced_on(reference.system, every.origin.basis, **how)
            made[family] = small, offline + time.perf_counter() - begin
        return made

    def model_of_family(modes: int, family: str) -> System:
        return models(modes)[family][0]

    def facts(modes: int) -> dict[str, Any]:
        """By family: what its models are, and how long they took to make, s; or why none is."""
        try:
            return {k: (_details(model), spent) for k, (model, spent) in models(modes).items()}
        except InputError as error:  # more modes than the mesh has, for one
            return {"failure": str(error)}

    for modes in wanted["modes"]:
        found = rows.row(rows.mark("reduction", origin_of(scene), modes), partial(facts, modes))
        if "failure" in found:
            yield Job(REDUCED, {"modes": modes}, partial(Outcome, None, status=found["failure"]))
            continue
        for family, (what, spent) in found.items():
            made = {"modes": what["unknowns"], **what}
            make, parts = partial(model_of_family, modes, family), wanted["reduced_parts"]
            yield from _jobs(reference, parts, family, make, made, offline_s=spent)


def _details(system: System) -> dict[str, Any]:
    """What a report says of a model."""
    return {
        "unknowns": system.n,
        "friction points": system.contact.count,
        "beta (s/m)": float(system.contact.beta.max()),
    }


def _jobs(
    reference: Reference,
    parts: Sequence[int],
    family: str,
    make: Callable[[], System],
    what: Mapping[str, Any],
    **more: Any,
) -> Iterator[Job]:
    """Runs of one model, made when the first of them is run, at several steps an interval."""
    for count in parts:
        if 4 * count <= reference.parts:
            step = reference.grid.duration / (count * reference.grid.intervals)
            run = partial(_run, make, reference, count)
            yield Job(family, {**what, "step (s)": step}, run, **more)


def _run(make: Callable[[], System], reference: Reference, parts: int) -> Outcome:
    system, begin = make(), time.perf_counter()
    run = reference.grid.integrate(system, parts)
    wall = time.perf_counter() - begin - run.preparation_s - run.compilation_s
    names = ("steps", "newton_iterations", "friction_evaluations")
    work = {name.replace("_", " "): getattr(run.counters, name) for name in names}
    return Outcome(results(run), wall, work, offline_s=run.preparation_s)


def front(points: Iterable[Measured], error: str = RMS, total: bool = False) -> list[Measured]:
    """Points that no other is both faster and more accurate than, fastest first."""
    chosen: list[Measured] = []
    for point in sorted(points, key=lambda p: (p.seconds(total), p.error(error))):
        if point.counts and point.error(error) < (chosen[-1].error(error) if chosen else inf):
            chosen.append(point)
    return chosen


def fastest(points: Iterable[Measured], level: float) -> Measured | None:
    """Fastest of the points whose displacement errs by no more than ``level``."""
    fit = (p for p in points if p.counts and p.error() <= level)
    return min(fit, key=lambda p: p.wall_s, default=None)


def advice(points: Sequence[Measured], level: float) -> str:
    """Say which model to use for an error of the displacement, and whether a reduction pays."""
    small = [p for p in points if p.job.family in (REDUCED, FEW_POINTS)]
    others = [p for p in points if p.job.family not in (REDUCED, FEW_POINTS)]
    full, reduced = fastest(others, level), fastest(small, level)
    start = f"Displacement error {level:.0e}: "
    if full is None:
        if reduced is None:
            return start + "no model of this report reaches it."
        return f"{start}use {reduced}. Only reduced models reach it."
    saved = 0.0 if reduced is None else full.wall_s - reduced.wall_s
    # Run times closer than this share are the same.
    if reduced is not None and saved > 0.2 * reduced.wall_s:
        runs = max(1, round(reduced.offline_s / saved))
        return (
            f"{start}use {reduced}. A reduction pays {full.wall_s / reduced.wall_s:.2g} times in "
            f"run time against the fastest other model, {full}; its "
            f"{_seconds(reduced.offline_s)} off-line come back after {runs} run{'s' * (runs > 1)}."
        )
    least = min((p.error() for p in small if p.counts), default=None)
    if least is None:
        return f"{start}use {full}. No reduced model was run."
    why = f"none reaches it, the best has {least:.1e}"
    if reduced is not None:
        why = f"the fastest that reaches it is {reduced}"
    return f"{start}use {full}. A reduction does not pay: {why}."


def _seconds(value: float) -> str:
    return f"{1e3 * value:.3g} ms" if value < 1.0 else f"{value:.3g} s"


def _cell(value: Any) -> str:
    return "–" if value is None else f"{value:.3g}" if isinstance(value, float) else str(value)


def markdown_table(header: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """Table in Markdown."""
    lines = [list(header), ["---"] * len(header), *([_cell(x) for x in row] for row in rows)]
    return "\n".join("| " + " | ".join(x.replace("|", "/") for x in line) + " |" for line in lines)


@dataclass(frozen=True)
class Report:
    """All of a report; ``sections`` are Markdown between advice and table of all points.

    ``notes`` say what to beware of; they stand in the summary.
    """

    title: str
    reference: Reference
    points: list[Measured]
    sections: tuple[str, ...] = ()
    notes: tuple[str, ...] = ()

    def table(self) -> tuple[list[str], list[list[Any]]]:
        """Header and rows of all points, in SI units; ``front`` is 1 on the front."""
        ahead = {id(p) for p in front(self.points)}
        rows = []
        for p in self.points:
            row = {"front": int(id(p) in ahead), "family": p.job.family, **p.job.what, **p.errors}
            row |= {"run time (s)": p.wall_s, "off-line (s)": p.offline_s, **p.outcome.work}
            rows.append(row | {"runs": p.repeats, "status": p.outcome.status})
        columns = list(dict.fromkeys(name for row in sorted(rows, key=len)[::-1] for name in row))
        return columns, [[row.get(name) for name in columns] for row in rows]

    def certificate(self) -> str:
        """How well the reference is known."""
        reference = self.reference
        steps = reference.parts * reference.grid.intervals
        header = ["source", *(name.replace("_", " ") for name in QUANTITIES), "order"]
        rows = [
            [e.source, *(e.errors[k] for k in QUANTITIES), e.order] for e in reference.estimates
        ]
        return (
            "Errors are measured against the *discrete truth*: the scene's own mesh and friction "
            f"law, {steps // 2} and {steps} steps extrapolated with order {reference.order:.2f}. "
            f"Estimated relative errors of a run of {steps // 4} steps, each source alone:\n\n"
        ) + markdown_table(header, rows)

    def markdown(self) -> str:
        """Text of the report."""
        parts = [
            f"# Error against run time: {self.title or 'a scene'}",
            machine(),
            "## How well the reference is known",
            self.certificate(),
            "## Which model to use",
            "\n".join(f"- {advice(self.points, level)}" for level in LEVELS),
            *self.sections,
            "## All points",
            "![error against run time](error-time.png)",
            "![error against run time and off-line time](total-time.png)",
            markdown_table(*self.table()),
            _NOTES,
        ]
        return "\n\n".join(parts) + "\n"


def machine() -> str:
    """Name the machine, and whether its times are to be trusted."""
    threads = "1" if threads_pinned(os.environ) else "not pinned: times are not to be trusted"
    return (
        f"{platform.processor() or platform.machine()}, {os.cpu_count()} cores, Python "
        f"{platform.python_version()}, numpy {np.__version__}. BLAS threads: {threads}."
    )


def threads_pinned(environment: Mapping[str, str]) -> bool:
    """Whether the environment keeps BLAS to one thread."""
    return all(environment.get(name) == "1" for name in THREADS)


def check_options(scene: Scene, repeats: int, bound: float = 60.0) -> None:
    """Check the options of `error_time`, and that the scene's models can be compared.

    InputError if an option is not positive, the scene runs until it is steady, or it has no
    friction or no load, so that its models would be alike.
    """
    given = {"--bound": bound, "--repeats": repeats}
    problems = [f"{k}: found {x:g}, must be > 0" for k, x in given.items() if not x > 0]
    if scene.time.until is not None:
        problems.append("time.until: error-time compares runs of equal length; give cycles")
    refuse(problems)
    system = scene.system()
    if system.contact.count == 0:
        raise InputError(
            "error-time: nothing slips in this scene, every model is the same linear one; "
            "give it a joint with friction and pressure"
        )
    if all(load.amplitude.peak_value == 0.0 for load in system.loads):
        raise InputError("error-time: no load acts, nothing errs; give one an amplitude above 0")


def error_time(
    scene: Scene,
    *,
    bound: float = 60.0,
    repeats: int = 3,
    quick: bool = False,
    wanted: Mapping[str, tuple[Any, ...]] | None = None,
    more: Callable[[Reference], Iterable[Job]] = lambda _: (),
    progress: Progress = silent,
    rows: Rows | None = None,
) -> Report:
    """Run a scene of any dimension with many models, and with ``more`` jobs from the reference.

    The longest run of the reference takes about ``bound`` s. There are ``repeats`` timed rounds,
    one in a ``quick`` report of few points; ``wanted`` replaces some of `RANGE` or `QUICK`.
    ``rows``, which may hold `ROWS`, keeps what is finished and is gone on from, times included
    where the machine is the same.
    Raises InputError as `check_options`, and ConvergenceError as `make_reference`.
    """
    check_options(scene, repeats, bound)
    what = (QUICK if quick else RANGE) | dict(wanted or {})
    rows = rows or Rows()
    reference = make_reference(scene, quick, bound, progress, rows)
    full, reduced = full_jobs(reference, what, rows), reduced_jobs(scene, reference, what, rows)
    jobs = [*full, *reduced, *more(reference)]
    of = rows.mark("run", origin_of(scene), reference.parts, what, machine())  # times are its own
    rounds = 1 if quick else repeats
    points = measure(jobs, reference, repeats=rounds, progress=progress, rows=rows, of=of)
    return Report(scene.title, reference, points)
