"""Wall time of a sweep of 5 x 5 scenes with two workers and with one, their start included.

    python examples/benchmarks/sweep.py            three minutes on two idle cores
    python examples/benchmarks/sweep.py --quick    short scenes: mostly the start

BLAS runs on one thread. Both are run in turn, and medians are reported.
"""

import sys
import time
from functools import partial
from pathlib import Path
from statistics import median

sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

from benchmarks import EXAMPLES
from skfem_joint.scene import load_sweep
from skfem_joint.study.sweep import processes, sweep


def seconds(scenes, workers):
    """Wall time of a sweep; all of its scenes must have run."""
    begin = time.perf_counter()
    rows = list(sweep(scenes, partial(processes, workers)))
    spent = time.perf_counter() - begin
    if sorted(row.number for row in rows if not row.failure) != list(range(len(scenes))):
        raise SystemExit(f"scenes are missing or have failed: {rows}")
    return spent


def main(arguments):
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
