"""Time of a step against the number of elements, to a million, and the long structure.

    python examples/benchmarks/growth.py            a minute or two
    python examples/benchmarks/growth.py --quick    to a thousand elements

BLAS threads are pinned, runs of different models are interleaved, and medians are reported.
"""

import os
import resource
import sys
from pathlib import Path
from statistics import median

os.environ.update(
    dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
)

import numpy as np

import skfem_joint as sj
from skfem_joint.reduction.reference import FORCE, FREQUENCY, lap_joint
from skfem_joint.stepping.recording import Run

STEPS = 100  # per period
#: Elements, steps and repeats.
SIZES = ((100, 300, 15), (1_000, 300, 5), (10_000, 100, 3), (100_000, 40, 1), (1_000_000, 10, 1))


def time_per_step(elements: int, n_steps: int, repeats: int) -> None:
    """Print a line for each law: full model of the paper's lap joint, nothing stored."""
    loads = [sj.Load("free_end", sj.Harmonic(FORCE, FREQUENCY))]
    betas = {"arctan": 1e5, "Coulomb": np.inf}
    systems = {
        law: lap_joint(elements=elements, beta=beta).system(loads, [])
        for law, beta in betas.items()
    }
    step, save = 1.0 / FREQUENCY / STEPS, sj.Save(points=False)
    runs: dict[str, list[Run]] = {law: [] for law in systems}
    for _ in range(repeats):
        for law, system in systems.items():
            runs[law].append(sj.integrate(system, step=step, n_steps=n_steps, save=save))
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    for law, done in runs.items():
        seconds = median(run.wall_s for run in done) / n_steps
        print(
            f"{elements:8d}  {law:7s}  {1e6 * seconds:9.1f}  {1e9 * seconds / elements:21.0f}"
            f"  {done[0].counters.newton_iterations / n_steps:17.1f}  {memory:15.0f}"
        )


def long_structure(elements: int, repeats: int) -> None:
    """Structure of Fig. 18, so many elements in the joint and beyond; the paper's five modes."""
    scene = sj.load_scene(Path(__file__).parents[1] / "structure_harmonic.toml")
    points = {"fixed": 0.0, "junction": 0.1, "free_end": 0.6}
    bar = sj.build_bar([("joint", 0.1, elements), ("linear", 0.5, elements)], points)
    models = {"run": ("full", "reduced")}
    reduction = {"reference": "paper", "modes": 5}
    long = scene.changed(mesh=bar, time={"cycles": 6}, models=models, reduction=reduction)
    done = [sj.run_scene(long).models for _ in range(repeats)]
    full, small = (median(found[name].run.wall_s for found in done) for name in models["run"])
    reduced = done[0]["reduced"]
    errors = reduced.errors
    assert errors is not None
    peak, energy = errors.peak_displacement or 0.0, errors.friction_energy_per_cycle or 0.0
    print(
        f"\nStructure of Fig. 18 with {2 * elements} elements, 6 cycles: full {1e3 * full:.0f} ms, "
        f"reduced to {reduced.run.system.n} unknowns {1e3 * small:.1f} ms: {full / small:.0f} "
        f"times faster; error of the free end {100 * errors.by_point['free_end'][0]:.2g} %, of its "
        f"peak {100 * peak:+.2g} %, of friction energy {100 * energy:+.2g} %; off-line "
        f"{1e3 * reduced.offline_s:.0f} ms"
    )


def main(arguments: list[str]) -> int:
    """Print both."""
    quick = "--quick" in arguments
    print(f"numpy {np.__version__}, one BLAS thread; full model, {STEPS} steps a period\n")
    print("elements  law      us a step  ns a step and element  iterations a step  peak memory, MB")
    for size in SIZES[: 2 if quick else None]:
        time_per_step(*size)
    long_structure(*((100, 1) if quick else (1000, 3)))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
