"""What a step of two bolted solid plates costs: full, condensed, reduced; and their damping curve.

    python examples/benchmarks/solids.py            about 30,000 unknowns, 620 contact points
    python examples/benchmarks/solids.py --large    100,000: what they take is said beforehand
    python examples/benchmarks/solids.py --quick    2,000

The scene is ``examples/solid_lap_joint.toml`` on bricks of second order: a lap joint of two plates
under two bolts, pulled by half of its friction limit, of which 40 mm are wide and 100 mm overlap.
Three periods of 200 steps from rest, with exact Coulomb friction in the full and in the condensed
model. BLAS threads are pinned. Errors, in percent, are against the full model, as measured and as
stated without it; off-line is all before the first step.
"""

from __future__ import annotations

import os
import sys
import time
from pathlib import Path

os.environ.update(
    dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
)
sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

from resource import RUSAGE_SELF, getrusage

from benchmarks.reduction import EXAMPLES, Found, Task, measure
from skfem_joint import backbone, build_box, condense, integrate, load_scene, merged
from skfem_joint.analysis import memory
from skfem_joint.analysis.history import compare
from skfem_joint.scene import Scene

WIDTH, STEPS, CYCLES, LEVELS = 0.04, 200, 3, 20
#: Elements along the overlap and the rest of each plate, across, and through its thickness.
SIZES = {"": (42, 2, 10, 1), "--large": (36, 8, 10, 4), "--quick": (12, 2, 3, 1)}
#: Modes, and friction points, of the reduced model.
MODES, POINTS = 30, 40


def plates(lap: int, rest: int, across: int, deep: int) -> Scene:
    """Scene of the two plates; the upper one is the first."""
    strips = ("upper_rest", 0.1, rest), ("upper_lap", 0.1, lap)
    others = ("lower_lap", 0.1, lap), ("lower_rest", 0.1, rest)
    size, count = (WIDTH, 0.01), (across, deep)
    upper = {"upper_end": "left", "upper_contact": ("front", "upper_lap")}
    lower = {"lower_end": "right", "lower_contact": ("back", "lower_lap")}
    mesh = merged(
        [
            build_box(strips, size, count, origin=(0.0, 0.0, 0.01), order=2, boundaries=upper),
            build_box(others, size, count, origin=(0.1, 0.0, 0.0), order=2, boundaries=lower),
        ]
    )
    scene = load_scene(EXAMPLES / "solid_lap_joint.toml")
    rings = scene.joint[0].pressure
    bolts = [b.model_copy(update={"at": (b.at[0], 0.5 * WIDTH, b.at[2])}) for b in rings.bolts]
    return scene.changed(
        mesh=mesh,
        joint={"pressure": rings.model_copy(update={"bolts": bolts})},
        time={"steps_per_cycle": STEPS, "cycles": CYCLES},
    )
