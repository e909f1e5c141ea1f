"""Wall time of a sweep of 5 x 5 scenes with two workers and with one, their start included.

    python examples/benchmarks/sweep.py            three minutes on two idle cores
    python examples/benchmarks/sweep.py --quick    short scenes: mostly the start
    python examples/benchmarks/sweep.py --range    one reduced model against one for each scene
    python examples/benchmarks/sweep.py --range plate_bolts     the same of one structure
    python examples/benchmarks/sweep.py --range --quick         the same for 20 points

BLAS runs on one thread. Both are run in turn, and medians are reported.

With ``--range`` 100 points of plates under Coulomb's law, of load, frequency and friction, are run
in one process by one model for their range, and each tenth of them by a reduced model of its own,
both with estimated errors. The time of the latter is multiplied by ten. Times are of the processor;
those of making the model and of the points are listed apart.
"""

import os
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory

os.environ |= dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")

import numpy as np

from skfem_joint.scene import load_scene, load_sweep
from skfem_joint.study.scene_range import range_model, served_scene
from skfem_joint.study.sweep import processes, sweep

EXAMPLES = Path(__file__).parents[1]
#: Range of the points of the plates.
RANGE = {"slip": [0.1, 0.9], "frequency": [200.0, 900.0], "joint[0].friction": [0.4, 1.2]}
#: Scenes of the plates, with the normal force of their joint, N.
PLATES = {"plate_reference": 100e3, "plate_bolts": 40e3}
#: Each so manieth point has a reduced model of its own too.
EACH = 10


def seconds(scenes, workers):
    """Wall time of a sweep; all of its scenes must have run."""
    begin = time.perf_counter()
    rows = list(sweep(scenes, partial(processes, workers)))
    spent = time.perf_counter() - begin
    if sorted(row.number for row in rows if not row.failure) != list(range(len(scenes))):
        raise SystemExit(f"scenes are missing or have failed: {rows}")
    return spent


def points(name, count):
    """Scenes of a plate, of load, frequency and friction drawn at random."""
    draw = np.random.default_rng(29)
    plate = load_scene(EXAMPLES / f"{name}.toml").changed(models={"run": ["reduced"]})
    plate = plate.changed(
        {"joint[0].law": "coulomb", "joint[0].beta": None},
        reduction={"range": RANGE, "modes": None},
        output={"plots": False, "vtk": False},
    )
    for _ in range(count):
        friction = draw.uniform(0.4, 1.2)
        yield plate.changed(
            {
                "joint[0].friction": friction,
                "load[0].amplitude": draw.uniform(0.25, 0.6) * friction * PLATES[name],
                "load[0].frequency": draw.uniform(200.0, 900.0),
            }
        )


def one_model(plate, count):
    """Processor time of a sweep by one model for its range, against a model for each scene."""
    scenes = list(points(plate, count))
    own = [scene.changed(reduction={"range": None}) for scene in scenes[::EACH]]
    spent, rows = [], []
    with ThreadPoolExecutor(1) as executor, TemporaryDirectory() as folder:
        list(sweep(own[:1], executor))  # compiles
        begin = time.process_time()
        range_model(served_scene(scenes[0]), Path(folder))
        made = time.process_time() - begin
        for name, chosen in (("one", scenes), ("own", own)):
            journal = Path(folder) / f"{name}.jsonl"
            begin = time.process_time()
            rows.append(sorted(sweep(chosen, executor, journal), key=lambda row: row.number))
            spent.append(time.process_time() - begin)
    failed = [row.failure for each in rows for row in each if row.failure]
    if failed:
        raise SystemExit(f"scenes have failed: {failed}")
    outside = sum(any("does not serve" in text for text in row.notes) for row in rows[0])
    name = "reduced.estimated_error.friction_energy_per_cycle.total"
    errors = [median(row.results[name] for row in each) for each in rows]
    whole = made + spent[0]
    print(
        f"{plate}: {count} points by one model for their range: {whole:.0f} s ({made:.0f} s to "
        f"make it, {spent[0]:.0f} s the points with their errors), "
        f"{outside} of them outside of it with a model of their own; friction energy errs by an "
        f"estimated {100 * errors[0]:.2g} % (median)"
    )
    print(
        f"{len(own)} of them by models of their own: {spent[1]:.0f} s, {100 * errors[1]:.2g} %; "
        f"all would take {EACH * spent[1]:.0f} s, {EACH * spent[1] / whole:.1f} times as long\n"
    )


def main(arguments):
    if "--range" in arguments:
        for plate in [name for name in PLATES if name in arguments] or PLATES:
            one_model(plate, 20 if "--quick" in arguments else 100)
        return
    cycles, rounds = (3, 1) if "--quick" in arguments else (1000, 2)
    swept = load_sweep(EXAMPLES / "lap_joint_sweep.toml")
    scenes = [scene.changed(time={"cycles": cycles}) for scene in swept.scenes]
    times = {1: [], 2: []}
    for k in range(rounds):
        for workers in (1, 2) if k % 2 == 0 else (2, 1):
            times[workers].append(seconds(scenes, workers))
    single, double = median(times[1]), median(times[2])
    ratio = median(b / a for a, b in zip(*times.values(), strict=True))
    both = f"{single:.1f} s with one worker, {double:.1f} s with two"
    print(f"{len(scenes)} scenes: {both}: {ratio:.2f}")


if __name__ == "__main__":
    main(sys.argv[1:])
