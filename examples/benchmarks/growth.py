"""Time of a step against the number of elements, to a million, and the long structure.

    python examples/benchmarks/growth.py            a minute or two
    python examples/benchmarks/growth.py --quick    to a thousand elements

BLAS threads are pinned, runs of different models are interleaved, and medians are reported.
"""

import resource
import sys
from pathlib import Path
from statistics import median

sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

from benchmarks import EXAMPLES, head, row

# isort: split

import numpy as np

import skfem_joint as sj
from skfem_joint.reduction.scaled.reference import FORCE, FREQUENCY, lap_joint

STEPS = 100  # per period
#: Elements, steps and repeats.
SIZES = ((100, 300, 15), (1_000, 300, 5), (10_000, 100, 3), (100_000, 40, 1), (1_000_000, 10, 1))


def time_per_step(elements, n_steps, repeats):
    """Print the time of a step of the paper's lap joint for each law; the runs store nothing."""
    loads = [sj.Load("free_end", sj.Harmonic(FORCE, FREQUENCY))]
    how = {"step": 1.0 / FREQUENCY / STEPS, "n_steps": n_steps, "save": sj.Save(points=False)}
    laws = {"arctan": 1e5, "Coulomb": np.inf}
    # The structure, which takes twice the memory of its system, ends with this line.
    system = lap_joint(elements=elements).system(loads, [])
    systems = [system.with_beta(beta) for beta in laws.values()]
    # Runs end as well: of each its time and its Newton iterations are kept.
    costs = {law: [] for law in laws}
    for _ in range(repeats):
        for system, done in zip(systems, costs.values(), strict=True):
            done.append(cost_of(system, how))
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1e3
    for law, done in costs.items():
        seconds = median(wall_s for wall_s, _ in done) / n_steps
        cells = f"{1e6 * seconds:.1f}", f"{1e9 * seconds / elements:.0f}"
        row(elements, law, *cells, f"{done[0][1] / n_steps:.1f}", f"{memory:.0f}")


def cost_of(system, how):
    """Wall time of a run, s, and its Newton iterations."""
    run = sj.integrate(system, **how)
    return run.wall_s, run.counters.newton_iterations


def long_structure(elements, repeats):
    """Print the speed of five modes for Fig. 18 with ``elements`` in the joint and beyond it."""
    scene = sj.load_scene(EXAMPLES / "structure_harmonic.toml")
    points = {"fixed": 0.0, "junction": 0.1, "free_end": 0.6}
    bar = sj.build_bar([("joint", 0.1, elements), ("linear", 0.5, elements)], points)
    asked = {"models": {"run": ("full", "reduced")}, "time": {"cycles": 6}}
    paper = {"reference": "paper", "modes": 5}
    long = scene.changed(mesh=bar, reduction=paper, **asked)
    done = [sj.run_scene(long).models for _ in range(repeats)]
    full, small = (median(models[name].run.wall_s for models in done) for name in done[0])
    reduced, errors = done[0]["reduced"], done[0]["reduced"].errors
    peak, energy = errors.peak_displacement, errors.friction_energy_per_cycle
    print(
        f"\nStructure of Fig. 18 with {2 * elements} elements, 6 cycles: full {1e3 * full:.0f} ms, "
        f"reduced to {reduced.run.system.n} unknowns {1e3 * small:.1f} ms: {full / small:.0f} "
        f"times faster; error of the free end {100 * errors.by_point['free_end'][0]:.2g} %, of its "
        f"peak {100 * peak:+.2g} %, of friction energy {100 * energy:+.2g} %; off-line "
        f"{1e3 * reduced.offline_s:.0f} ms"
    )


def main(arguments):
    quick = "--quick" in arguments
    print(f"Full model, {STEPS} steps a period.\n")
    head(
        *("elements", "law", "µs a step", "ns a step and element", "iterations a step"),
        "peak memory, MB",
    )
    for size in SIZES[: 2 if quick else None]:
        time_per_step(*size)
    long_structure(*((100, 1) if quick else (1000, 3)))


if __name__ == "__main__":
    main(sys.argv[1:])
