"""Error against run time, with ready-made integrators and the paper's method beside our models.

    python examples/benchmarks/ready_made.py SCENE.toml --out DIR [--bound S] [--quick]

For scenes of bars; SUNDIALS takes part if scikit-sundae is installed (extra ``bench``).
"""

import argparse
import importlib.util
import sys
import time
from dataclasses import replace
from functools import partial
from pathlib import Path

sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

from benchmarks import NOT_INSTALLED

# isort: split

import numpy as np

from benchmarks.explicit import runge_kutta, stable_step
from benchmarks.first_order import FirstOrder, lumped, slip_work
from benchmarks.integrators import FORMS, QUICK_FORMS, Task, solve
from skfem_joint.output.folder import kept, write_error_time
from skfem_joint.results.history import Results, results
from skfem_joint.scene import load_scene
from skfem_joint.stepping.recording import Save
from skfem_joint.study import error_time as et
from skfem_joint.study.certificate import PER_CYCLE
from skfem_joint.study.error_time import RMS, TIME_ERROR, Job, Outcome

#: Samples of an interval from which energies of ready-made integrators are summed.
SAMPLES = 8
#: Absolute tolerances relative to the largest displacement and velocity, over the relative one.
ABSOLUTE = 1e-2
READY_MADE, EXPLICIT, MESH = "ready-made", "Runge-Kutta", "full, coarser mesh"
#: Whether there is SUNDIALS.
SUNDIALS = importlib.util.find_spec("sksundae") is not None
#: Elements of coarse meshes.
COARSE = (10, 20, 50, 100)


def sampled(reference, u, v):
    """Results from samples of all unknowns, shape (samples, n), by the trapezoidal rule."""
    cycles, system = reference.grid.cycles, reference.system
    first = 0 if cycles is None else (cycles - 1) * PER_CYCLE * SAMPLES
    point_u, u, v = (system.P @ u.T).T, u[first:], v[first:]
    load = system.load_amplitudes(sample_times(reference)[first:])
    way = system.load_vectors().T @ np.diff(u, axis=0).T
    work = float(np.sum(0.5 * (load[:, 1:] + load[:, :-1]) * way))
    peak, lost = float(np.abs(point_u[first:]).max(initial=0.0)), slip_work(system, u, v)
    return Results(system.points, point_u[::SAMPLES], peak, lost, work, np.array([lost]))


def sample_times(reference):
    grid = reference.grid
    return np.linspace(0.0, grid.duration, SAMPLES * grid.intervals + 1)


def has_arctan_law(system):
    """Whether no point has set-valued Coulomb friction."""
    return np.all(np.isfinite(system.contact.beta[system.contact.w > 0.0]))


def ready_made_jobs(reference, bound, forms=FORMS, installed=SUNDIALS):
    """Jobs of all integrators at all tolerances; none under set-valued Coulomb friction.

    Those of SUNDIALS only say so where it is not ``installed``.
    """
    if not has_arctan_law(reference.system):
        return
    models = [FirstOrder(reference.system), FirstOrder(lumped(reference.system))]
    light = reference.grid.integrate(models[1].system, min(et.OWN, reference.parts))
    own = [reference.results, results(light)]
    finest = reference.grid.integrate(reference.system, reference.parts, fields=SAMPLES)
    truth, times = sampled(reference, finest.u, finest.v), sample_times(reference)
    largest = np.tile([np.abs(finest.u).max(), np.abs(finest.v).max()], reference.system.n)
    begin = time.perf_counter()
    models[0].residual()(0.0, *np.zeros((3, models[0].size)))  # compiles
    offline = time.perf_counter() - begin
    for form in forms:
        tries = {}
        for tolerance in form.tolerances:
            absolute = ABSOLUTE * tolerance * largest
            rest = np.zeros_like(absolute)
            task = Task(form, models[form.is_lumped], times, tolerance, absolute, bound, rest)
            run = partial(_attempt, task, reference, tries)
            if form.name in ("IDA", "CVODE") and not installed:
                run = partial(Outcome, None, status=NOT_INSTALLED)
            what = {"mass": "lumped" if form.is_lumped else "consistent", "tolerance": tolerance}
            yield Job(f"{READY_MADE} {form.name}", what, run, offline, own[form.is_lumped], truth)


def _attempt(task, reference, tries):
    """Run of an integrator, unless too many others of its form did not finish."""
    failures = list(tries.values()).count(False)
    if failures >= task.form.unfinished and not tries.get(task.tolerance):
        return Outcome(None, status="not tried: others of this solver were beyond the bound")
    solution = solve(task)
    tries[task.tolerance] = not isinstance(solution, str)
    if isinstance(solution, str):
        return Outcome(None, status=solution)
    samples = sampled(reference, solution.y[:, ::2], solution.y[:, 1::2])
    return Outcome(samples, solution.wall_s, solution.work)


def explicit_jobs(reference, longest=5.0):
    """Job of the paper's classical Runge-Kutta method at 95 % of its stable step.

    A run that would take more than ``longest`` (s) is extrapolated.
    """
    grid, system = reference.grid, reference.system
    if not has_arctan_law(system):
        return
    begin = time.perf_counter()
    parts = int(np.ceil(grid.duration / (0.95 * stable_step(system)) / grid.intervals))
    offline = time.perf_counter() - begin
    what = {"step (s)": grid.duration / (parts * grid.intervals)}
    yield Job(EXPLICIT, what, partial(_explicit, reference, parts, longest), offline)


def _explicit(reference, parts, longest):
    """Explicit run if it is short enough, else its time extrapolated from its first 400 steps."""
    grid, n_steps = reference.grid, parts * reference.grid.intervals
    run = partial(runge_kutta, reference.system, step=grid.duration / n_steps, check=False)
    piece = min(400, n_steps)
    begin = time.perf_counter()
    run(n_steps=piece, save=Save(points=False))
    wall = (time.perf_counter() - begin) * n_steps / piece
    if wall > longest:
        return Outcome(None, wall, {"steps": n_steps}, status="extrapolated")
    cycle = None if grid.cycles is None else parts * PER_CYCLE
    begin = time.perf_counter()
    result = run(n_steps=n_steps, save=Save(every=parts), cycle_steps=cycle)
    return Outcome(results(result), time.perf_counter() - begin, {"steps": n_steps})


def coarsened(bar, elements):
    """Bar of about ``elements`` elements on vertices of a finer one; keeps regions and points."""
    s = bar.mesh.p[0]
    ends = [
        [*owned[np.diff(owned, prepend=-2) != 1], *(owned[np.diff(owned, append=-2) != 1] + 1)]
        for owned in bar.regions.values()
    ]
    even = np.abs(s[:, np.newaxis] - np.linspace(s[0], s[-1], elements + 1)).argmin(axis=0)
    kept = np.unique(np.concatenate([even, *ends, [*bar.points.values()]])).astype(int)
    regions = {
        name: np.flatnonzero(np.isin(kept[:-1], owned)) for name, owned in bar.regions.items()
    }
    return replace(
        bar,
        mesh=type(bar.mesh).init_tensor(s[kept]).with_subdomains(regions),
        points={name: int(np.searchsorted(kept, vertex)) for name, vertex in bar.points.items()},
        coordinates=bar.coordinates[kept],
        body=bar.body[kept[:-1]],
    )


def time_at(points, level, error=RMS):
    """Run time for an error, interpolated on the logarithms along the front, s.

    None where no point is that accurate; the fastest point's time where even it is.
    """
    curve = [(p.error(error), p.wall_s) for p in et.front(points, error)]
    if not curve or curve[-1][0] > level:
        return None
    errors, walls = np.log(np.maximum(curve[::-1], 1e-300)).T
    return float(np.exp(np.interp(np.log(level), errors, walls)))


def ratios(points):
    """Rows of the table of speed ratios: what, ours (s), theirs (s), times faster."""
    rows, curves = [], {}
    for point in points:
        curves.setdefault(point.job.family, []).append(point)
    made = [curve for name, curve in curves.items() if name.startswith(READY_MADE)]
    for family, error, words in (
        (et.FULL, RMS, "full, arctan / ready-made, error"),
        (et.COULOMB, RMS, "full, Coulomb / ready-made, error"),
        (et.COULOMB, TIME_ERROR, "the same, Coulomb's own time-step error"),
    ):
        for level in et.LEVELS:
            ours = time_at(curves.get(family, []), level, error)
            times = [time for curve in made if (time := time_at(curve, level, TIME_ERROR))]
            theirs = min(times, default=None)
            ratio = theirs / ours if ours and theirs else None
            rows.append((f"{words} {level:.0e}", ours, theirs, ratio))
    return rows


def section(points, bound):
    """Section of the page on the competitors, in Markdown."""
    return (
        "## Speed ratios of this run\n\n"
        + et.markdown_table(["ours / theirs", "ours", "theirs", "times faster"], ratios(points))
        + "\n\nTimes (s) at an error are interpolated along each family's front. Ready-made "
        "integrators are taken at the time-step error of their own system; none can take "
        "set-valued Coulomb friction. They get interleaved unknowns, analytic Jacobians, compiled "
        f"callbacks and absolute tolerances of {ABSOLUTE:g} times the relative one times the "
        f"largest displacement and velocity; their bound is {bound:g} s. Banded Jacobians of rates "
        "need a lumped mass; IDA's residual form has the consistent one. Their energies are "
        "trapezoidal sums of samples, compared with the reference's by the same rule. "
        "`extrapolated`: the time of a short piece times the number of steps, no error."
    )


def main(arguments=None):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("scene", type=Path)
    parser.add_argument("--out", type=Path, required=True, help="folder for the report")
    parser.add_argument("--bound", type=float, default=60.0, help="longest run of one of them, s")
    parser.add_argument("--quick", action="store_true", help="few points, one round")
    parser.add_argument("--overwrite", action="store_true", help="replace files of other origin")
    options = parser.parse_args(arguments)
    scene, quick = load_scene(options.scene), options.quick
    bound = min(options.bound, 1.0) if quick else options.bound
    made = partial(ready_made_jobs, bound=bound, forms=QUICK_FORMS if quick else FORMS)
    parts = (et.QUICK if quick else et.RANGE)["parts"]
    counts = [n for n in COARSE[:: 3 if quick else 1] if n < scene.named_mesh.n_elements]

    def others(reference):
        for n in counts:
            bar, points = coarsened(scene.named_mesh, n), {"points": scene.output_points}
            coarse, mesh = scene.changed(mesh=bar, output=points), {"mesh": f"{n} elements"}
            yield from et.other_jobs(reference, parts, MESH, coarse.system(), mesh)
        yield from explicit_jobs(reference)
        yield from made(reference)

    with kept(options.out, overwrite=options.overwrite):
        report = et.error_time(scene, bound=options.bound, quick=quick, more=others)
        report = replace(report, sections=(section(report.points, bound),))
        files = write_error_time(options.out, report)
    advice = (et.advice(report.points, level) for level in et.LEVELS)
    print(*advice, *report.sections, sep="\n\n")
    print(f"\nWritten to {options.out}: {', '.join(file.name for file in files)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
