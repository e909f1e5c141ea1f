"""Cost of a step, and of ``check``, of bolted solids with 100 to 3,000 contact points.

    python examples/benchmarks/contact_points.py            all sizes
    python examples/benchmarks/contact_points.py --quick    100 and 300

Two plates of bricks of second order as in ``solids.py``, lapped under two bolts that press most of
the lap, with exact Coulomb friction; finer and finer meshes. Each is checked, as by ``skfem-joint
check``, and then its full model is run from rest, to nine tenths of the load's peak. It is stepped
on its contact unknowns where that costs less; up to 800 points it is stepped in the other way too.
BLAS threads are pinned. What is compiled is compiled before.
"""

import os
import sys
import time
from pathlib import Path
from unittest.mock import patch

os.environ |= dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

import skfem_joint as sj
from benchmarks import head, row
from benchmarks.solids import plates
from skfem_joint.linalg import schur
from skfem_joint.minimise.problem import ContactPoints
from skfem_joint.stepping.arrangement import arranged
from skfem_joint.study.description import description_of

#: Elements along the overlap and along the rest of each plate, across, and through its thickness.
SIZES = ((10, 2, 2, 1), (18, 2, 4, 1), (28, 2, 6, 1), (28, 2, 7, 1), (38, 2, 12, 1), (52, 2, 18, 1))
QUICK = SIZES[:2]
REACH, PERIOD, STEPS, SPARSE = 0.025, 100, 18, 800


def run(system):
    """Run of some steps, s a step, and s before them."""
    done = sj.integrate(system, step=1.0 / 200.0 / PERIOD, n_steps=STEPS, cycle_steps=PERIOD)
    return done.wall_s / done.counters.steps, done.preparation_s


def report(elements):
    begin = time.perf_counter()
    scene = plates(elements, 1, PERIOD, REACH)
    system = scene.system()
    made = time.perf_counter() - begin
    begin = time.perf_counter()
    description_of(scene)
    checked = time.perf_counter() - begin
    to = arranged(system).system
    kept = ContactPoints.of(to).limited
    pays = schur.condensing_pays(to.K, kept)
    step, before = run(system)
    other = ""
    if pays and system.contact.count <= SPARSE:
        with patch.object(schur, "MEMORY_SHARE", 0.0):
            other = f"{1e3 * run(system)[0]:.0f}"
    row(
        *(system.n, system.contact.count, kept.size, "yes" if pays else "no"),
        *(f"{made:.1f}", f"{checked:.1f}", f"{before:.2f}", f"{1e3 * step:.1f}", other),
    )


def main(arguments):
    tiny = plates((4, 1, 2, 1), 1, PERIOD, REACH)
    description_of(tiny)
    run(tiny.system())
    head(
        *("unknowns", "contact points", "contact unknowns", "condensed", "assembly, s", "check, s"),
        *("preparation, s", "ms a step", "ms a step, not condensed"),
    )
    for elements in QUICK if "--quick" in arguments else SIZES:
        report(elements)


if __name__ == "__main__":
    main(sys.argv[1:])
