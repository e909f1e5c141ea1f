"""A reference for other runs of a scene: the discrete truth, and how well it is known.

It is the scene's own mesh and friction law, integrated by the full model at small steps and
extrapolated in the step. Its certificate tells how far that is from the exact solution in time, on
a fine mesh, and under Coulomb friction, each separately.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

from skfem_joint.analysis.certificate import Source, full_results, halved, kept, looks
from skfem_joint.analysis.history import QUANTITIES, Results
from skfem_joint.errors import InputError
from skfem_joint.stepping.integrate import integrate
from skfem_joint.stepping.recording import Run, Save
from skfem_joint.stepping.resolution import longest_step
from skfem_joint.stepping.schemes import generalized_alpha
from skfem_joint.system import System

if TYPE_CHECKING:
    from skfem_joint.progress import Progress
    from skfem_joint.scene import Scene

#: Intervals at whose ends runs are compared with a reference: of a cycle, or of a run without any.
PER_CYCLE, PER_RUN = 25, 100
#: Steps of an interval of a reference's finest run: no more, in a quick report, and no fewer.
FINEST, FINEST_QUICK, COARSEST = 2048, 256, 16


@dataclass(frozen=True)
class Grid:
    """Times at which runs are compared with a reference: ends of intervals of a whole run.

    ``duration`` (s) is that of all runs, ``cycles`` are None without a common period of the loads,
    ``rho`` is the spectral radius of the scheme at infinite frequency.
    """

    duration: float
    cycles: int | None
    rho: float

    @property
    def intervals(self) -> int:
        """Number of intervals."""
        return PER_RUN if self.cycles is None else PER_CYCLE * self.cycles

    def integrate(self, system: System, parts: int, fields: int = 0) -> Run:
        """Run of ``parts`` steps an interval, all unknowns stored ``fields`` times in each.

        Half a run, which is worth nothing here, is a KeyboardInterrupt.
        """
        n_steps = parts * self.intervals
        run = integrate(
            system,
            step=self.duration / n_steps,
            n_steps=n_steps,
            scheme=generalized_alpha(self.rho),
            save=Save(every=parts, fields=fields > 0, fields_every=max(1, parts // max(fields, 1))),
            cycle_steps=None if self.cycles is None else parts * PER_CYCLE,
        )
        return run.finished()


@dataclass(frozen=True)
class Reference:
    """The discrete truth of a scene's full model, and its certificate.

    ``results`` are those of ``parts`` steps an interval, extrapolated with ``order``; ``estimates``
    are of a quarter of the steps; ``fine_mesh`` is on the finest mesh of the certificate.
    """

    system: System
    grid: Grid
    parts: int
    order: float
    results: Results
    fine_mesh: Results
    estimates: list[Source]


def make_reference(
    scene: Scene, quick: bool = False, bound: float = 60.0, progress: Progress | None = None
) -> Reference:
    """Reference of a scene with its certificate; its longest run takes about ``bound`` s or less.

    Raises
    ------
    InputError
        If the scene has no friction: there is nothing to choose between.
    ConvergenceError
        If a run does not converge.
    """
    system, time = scene.system(), scene.time
    if system.contact_points == 0:
        raise InputError(
            "error-time: nothing slips in this scene, every model is the same linear one; "
            "give it a joint with friction and pressure"
        )
    grid = Grid(scene.n_steps * scene.time_step, time.cycles, time.rho_infinity)
    parts, most = COARSEST, FINEST_QUICK if quick else FINEST
    longest = longest_step(system, grid.duration)
    while grid.duration > longest * (parts // 4) * grid.intervals:
        parts *= 2
    seconds_a_part = grid.integrate(system, parts // 2).wall_s / (parts // 2)
    while parts < most and 2 * parts * seconds_a_part <= bound:
        parts *= 2
    steps: dict[str, Any] = {"steps_per_cycle": parts // 4 * PER_CYCLE}
    if time.cycles is None:
        steps = {"step": grid.duration / (parts // 4 * grid.intervals)}
    coarse = scene.changed(
        time=steps, output={"every": parts // 4, "history": True}, models={"run": ("full",)}
    )
    base = full_results(coarse)
    middle, finest = (full_results(coarse.finer(factor)) for factor in (2, 4))
    in_time = halved("time step", [base, middle, finest])
    others, fine_mesh = looks(coarse, base, progress)
    order = kept(in_time.order)

    def extrapolate(name: str) -> Any:
        fine = getattr(finest, name)
        return fine + (fine - getattr(middle, name)) / (2.0**order - 1.0)

    names = ("point_u", *QUANTITIES[1:])
    truth = replace(finest, **{name: extrapolate(name) for name in names})
    if scene.matrices is not None:  # of which there is no finer mesh
        fine_mesh = truth
    return Reference(system, grid, parts, order, truth, fine_mesh, [in_time, *others])
