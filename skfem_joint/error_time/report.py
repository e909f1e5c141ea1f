"""The whole report of error against run time: ``error-time.md``, ``.csv`` and ``.png``."""

from __future__ import annotations

import importlib.metadata
import os
import platform
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from skfem_joint.error_time import table
from skfem_joint.error_time.measure import Point, measure
from skfem_joint.error_time.picture import draw
from skfem_joint.error_time.points import (
    QUICK,
    Range,
    explicit_jobs,
    full_jobs,
    reduced_jobs,
)
from skfem_joint.error_time.ready_made import (
    ABSOLUTE,
    FORMS,
    QUICK_FORMS,
    Form,
    ready_made_jobs,
)
from skfem_joint.error_time.reference import Progress, Reference, make_reference
from skfem_joint.errors import InputError
from skfem_joint.files import replacing
from skfem_joint.scene import Scene

#: Variables that set the threads of the usual BLAS libraries.
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
#: Runs longer than this are not repeated, s.
LONGEST_REPEATED = 2.0
#: Longest run of a ready-made integrator in a quick report, s.
QUICK_BOUND = 1.0


@dataclass(frozen=True)
class Report:
    """All of a report.

    Attributes
    ----------
    title : str
    reference : Reference
    points : list of Point
    bound : float
        Longest run of a ready-made integrator, s.
    """

    title: str
    reference: Reference
    points: list[Point]
    bound: float

    def markdown(self) -> str:
        """Text of the report."""
        points = self.points
        lines = [
            f"# Error against run time: {self.title or 'a scene'}",
            machine(),
            "## How well the reference is known",
            table.reference_text(self.reference),
            "## Which model to use",
            *(f"- {table.advice(points, level)}" for level in table.LEVELS),
            f"- {table.advice_on_mesh(points, self.reference)}",
            "## Speed ratios of this run",
            table.ratio_table(points),
            "Times at an error are interpolated along each family's front. Ready-made integrators "
            "are taken at the time-step error of their own system. " + table.best_of_five(points),
            "## All points",
            "![error against run time](error-time.png)",
            table.markdown_table(points),
            self._notes(),
        ]
        text = "\n\n".join(line for line in lines if line) + "\n"
        return text.replace("\n\n- ", "\n- ").replace("use\n- ", "use\n\n- ")

    def _notes(self) -> str:
        missing = (
            ""
            if any(p.what.family.startswith("ready-made") for p in self.points)
            else " No ready-made integrator can take set-valued Coulomb friction."
        )
        return (
            "Errors are relative; those of peak and energies are of the last cycle (the whole run "
            "without cycles). Wall time is the median of the runs counted, in rounds of opposite "
            f"order; runs beyond {LONGEST_REPEATED:g} s are not repeated. Off-line time "
            "holds everything before the first step: probe and reference runs, decomposition, "
            "projection, factorization, compilation. `extrapolated`: the time of a short piece "
            "times the number of steps, no error. Ready-made integrators get interleaved unknowns, "
            "analytic Jacobians, compiled callbacks and absolute tolerances of "
            f"{ABSOLUTE:g} times the relative one times the largest displacement and velocity; "
            f"their bound is {self.bound:g} s. Banded and sparse Jacobians of explicit "
            "rates need a lumped mass, the full ones have the consistent one; IDA's residual form "
            "is banded with the consistent mass. Their energies are trapezoidal sums of samples, "
            "compared with the reference's by the same rule; their iterations are Jacobians (LU "
            "factorizations of BDF and Radau). Memory is what Python and numpy allocated, for "
            "ready-made and explicit ones in a short piece of the run." + missing
        )

    def write(self, folder: Path) -> list[Path]:
        """Write the report into a folder that exists.

        Raises
        ------
        InputError
            If matplotlib is missing or a file cannot be written.
        """
        files = [folder / f"error-time.{suffix}" for suffix in ("md", "csv", "png")]
        for file, text in zip(files, (self.markdown(), table.csv_table(self.points)), strict=False):
            with replacing(file) as temporary:
                temporary.write_text(text, encoding="utf-8")
        draw(self.points, files[2], self.title)
        return files


def machine() -> str:
    """Name the machine and the versions."""
    info = Path("/proc/cpuinfo")
    processor = platform.processor() or platform.machine()
    if info.exists():
        for line in info.read_text(encoding="utf-8", errors="replace").splitlines():
            if line.startswith("model name"):
                processor = line.split(":", 1)[1].strip()
                break
    versions = []
    for name in ("numpy", "scipy", "numba", "scikit-sundae", "skfem-joint"):
        try:
            versions.append(f"{name} {importlib.metadata.version(name)}")
        except importlib.metadata.PackageNotFoundError:
            versions.append(f"{name} not installed")
    threads = "1" if threads_pinned(os.environ) else "not pinned: times are not to be trusted"
    return (
        f"{processor}, {os.cpu_count()} cores, {platform.system()}, Python "
        f"{platform.python_version()}, {', '.join(versions)}. BLAS threads: {threads}."
    )


def threads_pinned(environment: Mapping[str, str]) -> bool:
    """Whether the environment keeps BLAS to one thread."""
    return all(environment.get(name) == "1" for name in THREADS)


def error_time(
    scene: Scene,
    *,
    bound: float = 60.0,
    repeats: int = 3,
    quick: bool = False,
    wanted: Range | None = None,
    forms: tuple[Form, ...] | None = None,
    progress: Progress | None = None,
) -> Report:
    """Run a scene with many models and integrators.

    Parameters
    ----------
    bound : float
        Longest run of a ready-made integrator, s.
    repeats : int
        Timed rounds.
    quick : bool
        Few points, one round, ready-made integrators for a second at most.
    wanted, forms : optional
        Our models and the ready-made integrators, instead of the usual ones.

    Raises
    ------
    ConvergenceError
        If the reference does not converge.
    InputError
        For options that are not positive, or a scene without friction.
    """
    problems = []
    if not bound > 0.0:
        problems.append(f"--bound: found {bound:g}, must be > 0")
    if repeats < 1:
        problems.append(f"--repeats: found {repeats}, must be >= 1")
    if problems:
        raise InputError(problems)
    if quick:
        bound, repeats = min(bound, QUICK_BOUND), 1
    wanted = wanted or (QUICK if quick else Range())
    forms = (QUICK_FORMS if quick else FORMS) if forms is None else forms
    reference = make_reference(scene, quick, progress)
    jobs = [
        *full_jobs(scene, reference, wanted),
        *reduced_jobs(scene, reference, wanted),
        *explicit_jobs(scene, reference, wanted),
        *ready_made_jobs(scene, reference, bound, forms),
    ]
    points = measure(jobs, reference, repeats=repeats, longest=LONGEST_REPEATED, progress=progress)
    return Report(scene.title, reference, points, bound)
