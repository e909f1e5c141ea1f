"""Speed of the models; prints the tables that the README quotes (about eight minutes).

    python examples/benchmark.py            everything
    python examples/benchmark.py --steps    time per step alone (a minute)

BLAS threads are pinned, runs of different models are interleaved, and medians are reported. The
comparison with ready-made solvers needs the extra ``bench``.
"""

import os

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[variable] = "1"

import resource
import statistics
import sys
from pathlib import Path

import numpy as np

from skfem_joint.error_time import report, table
from skfem_joint.integrate import integrate
from skfem_joint.loads import Harmonic
from skfem_joint.paper.cases import CASES, study
from skfem_joint.recording import Run, Save
from skfem_joint.reference import FORCE, FREQUENCY, lap_joint
from skfem_joint.scene import load_scene
from skfem_joint.structure import assemble
from skfem_joint.system import System

STEPS = 100  # per period


def reference_system(elements: int, beta: float) -> System:
    structure = lap_joint(elements=elements, beta=beta)
    return assemble(structure, [("free_end", Harmonic(FORCE, FREQUENCY))])


def run(system: System, n_steps: int) -> Run:
    step = 1.0 / FREQUENCY / STEPS
    return integrate(system, step=step, n_steps=n_steps, save=Save(points=False))


def time_per_step() -> None:
    """Full model from 100 to 1,000,000 elements."""
    print(f"Full model of the reference system, {STEPS} steps a period, nothing stored\n")
    print("elements  law      us a step  ns a step and element  iterations a step  peak memory, MB")
    for elements, n_steps, repeats in (
        (100, 300, 15),
        (1_000, 300, 5),
        (10_000, 100, 3),
        (100_000, 40, 1),
        (1_000_000, 10, 1),
    ):
        systems = {
            "arctan": reference_system(elements, 1e5),
            "Coulomb": reference_system(elements, np.inf),
        }
        runs: dict[str, list[Run]] = {law: [] for law in systems}
        for _ in range(repeats):
            for law, system in systems.items():
                runs[law].append(run(system, n_steps))
        memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
        for law, done in runs.items():
            time = statistics.median(one.wall_s for one in done) / n_steps
            iterations = done[0].counters.newton_iterations / n_steps
            print(
                f"{elements:8d}  {law:7s}  {1e6 * time:9.1f}  {1e9 * time / elements:21.0f}"
                f"  {iterations:17.1f}  {memory:15.0f}"
            )


def long_structure() -> None:
    """Structure of Fig. 18 with 1,000 elements in the joint and 1,000 beyond it."""
    done = [
        study(CASES["structure"], elements=1000, run=("full", "reduced"), time={"cycles": 6})
        for _ in range(3)
    ]
    walls = {
        name: statistics.median(one.models[name].run.wall_s for one in done)
        for name in ("full", "reduced")
    }
    reduced = done[0].models["reduced"]
    assert reduced.errors is not None
    history, _ = reduced.errors.by_point["free_end"]
    print("\nStructure of Fig. 18 with 2,000 elements, 6 cycles of 200 steps")
    print(
        f"full {1e3 * walls['full']:.0f} ms, reduced to {reduced.run.system.n} unknowns "
        f"{1e3 * walls['reduced']:.1f} ms: {walls['full'] / walls['reduced']:.0f} times faster; "
        f"error of the free end {100 * history:.2g} %, of its peak "
        f"{100 * reduced.errors.peak_displacement:+.2g} %, of friction energy "
        f"{100 * (reduced.errors.friction_energy_per_cycle or 0.0):+.2g} %; "
        f"off-line {1e3 * reduced.offline_s:.0f} ms"
    )


def against_others() -> None:
    """Ratios to ready-made solvers and between our own models, at equal error."""
    scene = load_scene(Path(__file__).parent / "lap_joint_reference.toml")
    found = report.error_time(scene, bound=60.0, repeats=3)
    print("\nReference system, three periods: ratios at equal error\n")
    print(table.ratio_table(found.points))
    for level in table.LEVELS:
        print(table.advice(found.points, level))


if __name__ == "__main__":
    print(f"{report.machine()}\n")
    time_per_step()
    long_structure()
    if "--steps" not in sys.argv:
        against_others()
