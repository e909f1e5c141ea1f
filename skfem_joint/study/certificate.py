"""Errors by the mesh and against the full model; reference solutions.

Every result has estimated errors (`skfem_joint.accuracy.estimate`). `certify` adds those for which
other models have to be run:

mesh
    Elements halved twice, full model only. The observed order p (kept between 1/2 and 2, friction
    is not smooth) extrapolates the difference of the first two runs to the error of the first. In
    two and three dimensions elements are halved once, and the error is taken to be 1.5 times what
    this changes, as in every estimate (`skfem_joint.accuracy.halved_mesh`): another halving would
    cost sixteen times the first and more.
full run
    A reduced model without the full one beside it: two cycles of both. (Where the full one was run
    beside it, every estimate has the distance of the whole runs.)

`make_reference` computes the solution with which reports compare all other runs of a scene: the
full model on the scene's own mesh and with its own law of friction, integrated in small steps and
extrapolated to step zero. Its own errors by time step, mesh and law are estimated as above.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import partial
from itertools import pairwise
from math import log2
from typing import Any

from skfem_joint.accuracy.estimate import Estimate, Parts, added, verification_run
from skfem_joint.accuracy.halved_mesh import BEYOND
from skfem_joint.accuracy.ladder import Rung, Series, errors_of
from skfem_joint.ground.errors import InputError
from skfem_joint.ground.progress import Progress, Tally, silent
from skfem_joint.ground.rows import Rows
from skfem_joint.results.history import QUANTITIES, Results, difference, extrapolation, results
from skfem_joint.runs.resolution import longest_step
from skfem_joint.scene import Scene
from skfem_joint.stepping.plan import Plan
from skfem_joint.stepping.recording import Run, Save
from skfem_joint.stepping.schemes import generalized_alpha
from skfem_joint.study.models import finer_mesh, origin_of, plan_of
from skfem_joint.study.results import Model, Study
from skfem_joint.system.system import System

#: Intervals at whose ends runs are compared with a reference: of a cycle, or of a run without
#: cycles.
PER_CYCLE = 25
#: Orders of convergence that an extrapolation may use: friction is not smooth.
LEAST, MOST = 0.5, 2.0
#: Changes by halving a step or a size, with these orders. What a single change by halved elements
#: leaves makes `BEYOND` times the change.
HALVED = Series(0.5**MOST, 0.5**LEAST, 1.0 - 1.0 / BEYOND)


@dataclass(frozen=True)
class Source:
    """Estimated relative errors from one source.

    Attributes
    ----------
    source : str
        Its name.
    errors : mapping of str to float or None
        Errors by quantity.
    order : float, optional
        Observed order of convergence of the displacement history; None where nothing was halved
        twice. Outside of what `kept` leaves only the size of the extrapolated error can be
        trusted.
    """

    source: str
    errors: Parts
    order: float | None = None


def kept(order: float | None) -> float:
    """Order of convergence kept within what an extrapolation may use; the highest if not known."""
    return MOST if order is None else min(max(order, LEAST), MOST)


def halved(source: str, runs: Sequence[Results]) -> Source:
    """Errors of the first of two or three runs, each with half the step or size of the one before.

    Of two runs, the error is taken to be `BEYOND` times their difference.
    """
    rungs = [Rung.of(source, *pair, HALVED) for pair in pairwise(runs)]
    first, last = (float(rungs[k].change[0]) for k in (0, -1))
    order = log2(first / last) if len(rungs) > 1 and first > 0.0 < last else None
    return Source(source, errors_of(runs[0], rungs)[source], order)


def full_results(scene: Scene) -> Results:
    """Results of a scene's full model."""
    return _results(plan_of(scene), scene.system())


def _results(plan: Plan, system: System) -> Results:
    return results(verification_run(system, plan))


def _kept_results(rows: Rows, scene: Scene) -> Results:
    """Results of a scene's full model, which are a row."""
    return rows.row(rows.mark("full results", origin_of(scene)), partial(full_results, scene))


def mesh_and_law(
    scene: Scene,
    base: Results,
    progress: Progress = silent,
    executor: Executor | None = None,
    rows: Rows | None = None,
    *,
    law: bool = True,
) -> tuple[list[Source], Results]:
    """Errors of a full model from its mesh and its law, and its results on the finest mesh.

    Matrices have no mesh that could be refined. Without an executor each run is one of the rows.
    With ``law = False`` the law is left out.
    """
    steep = law and any(joint.law == "arctan" for joint in scene.joint)
    # How often elements are halved, by the dimension of the mesh.
    halvings = {1: 2, 2: 1, 3: 1}[scene.named_mesh.dim] if scene.matrices is None else 0
    scenes, runs = [scene], [base]
    for _ in range(halvings):
        scenes.append(finer_mesh(scenes[-1]))
    if steep:
        scenes.append(scene.changed(joint={"law": "coulomb"}))
    tally = Tally(partial(progress, "certifying the full model"), len(scenes) - 1)
    tally.add(0)
    one_by_one = map(partial(_kept_results, rows or Rows()), scenes[1:])
    for other in executor.map(full_results, scenes[1:]) if executor else one_by_one:
        runs.append(other)
        tally.add()
    sources = [halved("mesh", runs[: halvings + 1])] if halvings else []
    if steep:
        sources.append(Source("law", difference(base, runs[-1])))
    return sources, runs[halvings]


def certify(
    study: Study, name: str, progress: Progress = silent, executor: Executor | None = None
) -> Model:
    """Estimate more errors of one of a study's models; the model with all of its errors.

    Parameters
    ----------
    study : Study
    name : str
        "full" or "reduced".
    progress : callable, optional
        Called with (label, runs done, runs in all).
    executor : Executor, optional
        Runs them side by side.

    Raises
    ------
    InputError
        For a model that the study has not run.
    ConvergenceError
        If a run does not converge.
    """
    if name not in study.models:
        raise InputError(f"certify: the scene does not run the {name} model")
    model = study.models[name]
    known = model.estimate or Estimate({})
    if name == "full":
        base = results(model.run)
        sources = mesh_and_law(study.scene, base, progress, executor, law=False)[0]
        # Where that of the time step is not known, neither is the total.
        every = [known.parts.get("time_step", dict.fromkeys(QUANTITIES))]
        for error in sources:
            known = known.having(error.source, error.errors)
            every.append(error.errors)
        known = known.having("total", added(*every))
    elif "full" not in study.models:
        known = known.beside(_short(study, model, executor))
    return replace(model, estimate=known)


def _short(study: Study, model: Model, executor: Executor | None) -> Parts:
    """Difference of a reduced model from the full one in its first cycles, or its first fifth."""
    plan = plan_of(study.scene)
    # Cycles of a short full run.
    plan = plan.first(plan.n_steps // 5 if plan.cycle_steps is None else 2)
    systems = study.system, model.run.system
    return difference(*(executor.map if executor else map)(partial(_results, plan), systems))


@dataclass(frozen=True)
class Grid:
    """Times at which runs are compared with a reference: ends of intervals of a whole run.

    Attributes
    ----------
    duration : float
        Duration of all runs, s.
    cycles : int, optional
        Number of cycles; None without a common period of the loads.
    rho : float
        Spectral radius of the scheme at infinite frequency.
    """

    duration: float
    cycles: int | None
    rho: float

    @property
    def intervals(self) -> int:
        """Number of intervals."""
        return 100 if self.cycles is None else PER_CYCLE * self.cycles

    def integrate(self, system: System, parts: int, fields: int = 0) -> Run:
        """Run of ``parts`` steps an interval, all unknowns stored ``fields`` times in each.

        An interrupt is raised as KeyboardInterrupt: half a run is of no use.
        """
        n_steps = parts * self.intervals
        plan = Plan(
            self.duration / n_steps,
            n_steps,
            generalized_alpha(self.rho),
            Save(every=parts),
            None if self.cycles is None else parts * PER_CYCLE,
        )
        return verification_run(system, plan, fields_every=fields and max(1, parts // fields))


@dataclass(frozen=True)
class Reference:
    """Solution of a scene's full model extrapolated to step zero, and its estimated errors.

    Attributes
    ----------
    system : System
    grid : Grid
    parts : int
        Steps an interval of the finest run.
    order : float
        Order of convergence with which the results are extrapolated.
    results : Results
    fine_mesh : Results
        Results on the finest mesh of the certificate.
    estimates : list of Source
        Errors by time step, mesh and law, of a run with a quarter of the steps.
    """

    system: System
    grid: Grid
    parts: int
    order: float
    results: Results
    fine_mesh: Results
    estimates: list[Source]


def make_reference(
    scene: Scene,
    quick: bool = False,
    bound: float = 60.0,
    progress: Progress = silent,
    rows: Rows | None = None,
) -> Reference:
    """Reference of a scene with its certificate; its longest run takes about ``bound`` s or less.

    Its runs, and how many steps a measured run time allows, are ``rows``, if there are any.
    ConvergenceError if a run does not converge.
    """
    system, time = scene.system(), scene.time
    grid = Grid(scene.n_steps * scene.time_step, time.cycles, time.rho_infinity)
    # Most steps in an interval of a reference's finest run.
    rows, most = rows or Rows(), 256 if quick else 2048
    mark = rows.mark("parts of an interval", origin_of(scene), most, bound)
    parts = rows.row(mark, partial(_finest_parts, system, grid, most, bound))
    steps: dict[str, Any] = {"steps_per_cycle": parts // 4 * PER_CYCLE}
    if time.cycles is None:
        steps = {"step": grid.duration / (parts // 4 * grid.intervals)}
    coarse = scene.changed(
        time=steps, output={"every": parts // 4, "history": True}, models={"run": ("full",)}
    )
    base = _kept_results(rows, coarse)
    middle, finest = (_kept_results(rows, coarse.finer(factor)) for factor in (2, 4))
    in_time = halved("time step", [base, middle, finest])
    others, fine_mesh = mesh_and_law(coarse, base, progress, rows=rows)
    order = kept(in_time.order)
    truth = finest.plus(extrapolation(2.0**order) - 1.0, finest, middle)
    if scene.matrices is not None:  # of which there is no finer mesh
        fine_mesh = truth
    return Reference(system, grid, parts, order, truth, fine_mesh, [in_time, *others])


def _finest_parts(system: System, grid: Grid, most: int, bound: float) -> int:
    """Steps of an interval of a reference's finest run: ``most``, or what ``bound`` s allow."""
    # Fewest steps in an interval of a reference's finest run.
    parts, longest = 16, longest_step(system, grid.duration)
    while grid.duration > longest * (parts // 4) * grid.intervals:
        parts *= 2
    seconds_a_part = grid.integrate(system, parts // 2).wall_s / (parts // 2)
    while parts < most and 2 * parts * seconds_a_part <= bound:
        parts *= 2
    return parts
