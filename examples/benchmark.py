"""Time per step of the full and reduced models; prints the table that the README quotes.

    python examples/benchmark.py

BLAS threads are pinned, runs of different models are interleaved, and medians are reported.
"""

import os

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[variable] = "1"

import platform
import statistics
from pathlib import Path

import numpy as np

from skfem_joint.integrate import integrate
from skfem_joint.loads import Harmonic
from skfem_joint.recording import Run, Save
from skfem_joint.reference import FORCE, FREQUENCY, lap_joint
from skfem_joint.structure import assemble
from skfem_joint.system import System

STEPS = 100  # per period


def reference_system(elements: int, beta: float) -> System:
    structure = lap_joint(elements=elements, beta=beta)
    return assemble(structure, [("free_end", Harmonic(FORCE, FREQUENCY))])


def run(system: System, n_steps: int) -> Run:
    step = 1.0 / FREQUENCY / STEPS
    return integrate(system, step=step, n_steps=n_steps, save=Save(points=False))


def processor() -> str:
    """Name of the processor."""
    info = Path("/proc/cpuinfo")
    if info.exists():
        for line in info.read_text().splitlines():
            if line.startswith("model name"):
                return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()


def main() -> None:
    print(f"{processor()}, Python {platform.python_version()}, one BLAS thread")
    print(f"reference system, {STEPS} steps a period, average acceleration\n")
    print("elements  law       us a step  ns a step and element  iterations a step")
    for elements in (100, 1_000, 10_000, 100_000):
        n_steps, repeats = (
            (300, 15) if elements <= 1_000 else (100, 3) if elements < 1e5 else (40, 1)
        )
        systems = {
            "arctan": reference_system(elements, 1e5),
            "Coulomb": reference_system(elements, np.inf),
        }
        runs: dict[str, list[Run]] = {law: [] for law in systems}
        for _ in range(repeats):
            for law, system in systems.items():
                runs[law].append(run(system, n_steps))
        for law, done in runs.items():
            time = statistics.median(r.wall_s for r in done) / n_steps
            iterations = done[0].counters.newton_iterations / n_steps
            print(
                f"{elements:8d}  {law:8s}  {1e6 * time:9.1f}  {1e9 * time / elements:21.0f}"
                f"  {iterations:17.1f}"
            )


if __name__ == "__main__":
    main()
