"""Points of a work-precision diagram: what was run, what it cost and how far off it was."""

from __future__ import annotations

import statistics
import tracemalloc
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from skfem_joint.error_time.reference import (
    Distance,
    Progress,
    Reference,
    Results,
    displacement_rms,
    distance,
)
from skfem_joint.errors import ConvergenceError

FloatArray = NDArray[np.float64]

FINISHED = "finished"


@dataclass(frozen=True)
class What:
    """What a point is.

    Attributes
    ----------
    family : str
        Points of one curve.
    model : str
    scheme : str
    elements : int
    modes : int or None
    friction_points : int
    beta : float
        s/m; ``inf`` is Coulomb.
    step : float or None
        Time step, s; None where the integrator chooses.
    tolerance : float or None
        Relative tolerance of an integrator that chooses its steps.
    """

    family: str
    model: str
    scheme: str
    elements: int
    modes: int | None
    friction_points: int
    beta: float
    step: float | None = None
    tolerance: float | None = None


@dataclass(frozen=True)
class Outcome:
    """One run of a job.

    Attributes
    ----------
    results : Results or None
        None where the run did not finish.
    wall_s : float or None
        Run time, s.
    steps, iterations, evaluations : int or None
        Steps, linear solves, and evaluations of the friction law on all contact points.
    status : str
        `FINISHED`, or why not.
    offline_s : float
        Preparation inside the run, not in ``wall_s``, s.
    """

    results: Results | None
    wall_s: float | None
    steps: int | None = None
    iterations: int | None = None
    evaluations: int | None = None
    status: str = FINISHED
    offline_s: float = 0.0


@dataclass(frozen=True)
class Job:
    """Something to measure.

    Attributes
    ----------
    what : What
    run : callable
        Does it once.
    offline_s : float
        Time spent before, s.
    own : ndarray or None
        Histories of the same discrete model without time-step error, m.
    sampled : bool
        Whether energies come from samples, as those of ready-made integrators do.
    piece : callable, optional
        A short piece of the run, to measure memory; the whole run if not given.
    """

    what: What
    run: Callable[[], Outcome]
    offline_s: float = 0.0
    own: FloatArray | None = None
    sampled: bool = False
    piece: Callable[[], object] | None = None


@dataclass(frozen=True)
class Point:
    """A measured job.

    Attributes
    ----------
    what : What
    status : str
    wall_s : float or None
        Median of the repeats, s.
    offline_s : float
    distance : Distance or None
        From the reference.
    time_error : float or None
        Displacement, rms, from the same discrete model without time-step error.
    to_fine_mesh : float or None
        Displacement, rms, from a fine mesh with consistent friction forces.
    memory : int or None
        Peak of what Python and numpy allocated, bytes.
    steps, iterations, evaluations : int or None
    repeats : int
        Runs that the median is of.
    """

    what: What
    status: str
    wall_s: float | None
    offline_s: float
    distance: Distance | None = None
    time_error: float | None = None
    to_fine_mesh: float | None = None
    memory: int | None = None
    steps: int | None = None
    iterations: int | None = None
    evaluations: int | None = None
    repeats: int = 1

    @property
    def counts(self) -> bool:
        """Whether it was run to its end, so that time and error belong together."""
        return self.status == FINISHED and self.wall_s is not None and self.distance is not None


@dataclass
class _Taken:
    job: Job
    first: Outcome
    walls: list[float] = field(default_factory=list)
    memory: int | None = None


def _once(job: Job) -> Outcome:
    try:
        return job.run()
    except ConvergenceError as error:
        return Outcome(None, None, status=f"did not converge: {error}")


def _peak(job: Job) -> int:
    tracemalloc.start()
    try:
        (job.piece or job.run)()
        return tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def measure(
    jobs: Sequence[Job],
    reference: Reference,
    *,
    repeats: int,
    longest: float,
    progress: Progress | None = None,
) -> list[Point]:
    """Run jobs and compare them with the reference.

    Every job is run once, which warms it up and gives its results. Then all those shorter than
    ``longest`` are run in ``repeats`` rounds, each round in the opposite order of the one before;
    the time is the median of the rounds. Longer ones keep the time of their only run.

    Parameters
    ----------
    longest : float
        s.
    """
    taken = []
    for k, job in enumerate(jobs):
        if progress is not None:
            progress("first runs", k, len(jobs))
        one = _Taken(job, _once(job))
        if one.first.results is not None and (job.piece or _short(one, longest)):
            one.memory = _peak(job)
        taken.append(one)
    order = [one for one in taken if _short(one, longest)]
    for k in range(repeats):
        if progress is not None:
            progress("timed rounds", k, repeats)
        for one in order if k % 2 == 0 else order[::-1]:
            wall = one.job.run().wall_s
            if wall is not None:
                one.walls.append(wall)
    if progress is not None:
        progress("first runs", len(jobs), len(jobs))
        progress("timed rounds", repeats, repeats)
    return [_point(one, reference) for one in taken]


def _short(one: _Taken, longest: float) -> bool:
    wall = one.first.wall_s
    return one.first.results is not None and wall is not None and wall < longest


def _point(one: _Taken, reference: Reference) -> Point:
    job, first = one.job, one.first
    found = first.results
    truth = reference.sampled if job.sampled else reference.results
    return Point(
        what=job.what,
        status=first.status,
        wall_s=statistics.median(one.walls) if one.walls else first.wall_s,
        offline_s=job.offline_s + first.offline_s,
        distance=None if found is None else distance(truth, found),
        time_error=None
        if found is None or job.own is None
        else displacement_rms(job.own, found.point_u),
        to_fine_mesh=None
        if found is None
        else displacement_rms(reference.fine_mesh, found.point_u),
        memory=one.memory,
        steps=first.steps,
        iterations=first.iterations,
        evaluations=first.evaluations,
        repeats=max(len(one.walls), 1),
    )
