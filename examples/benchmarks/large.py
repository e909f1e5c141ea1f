"""Time of a large model up to its first curve, in factors and solutions of its stiffness.

    python examples/benchmarks/large.py                   44,121 and 95,915 unknowns
    python examples/benchmarks/large.py --quick           20,513
    python examples/benchmarks/large.py --largest         239,139 too, with PARDISO
    python examples/benchmarks/large.py --beside FOLDER   another checkout of the package as well

A Brake-Reuss beam of bricks of second order that floats, with contact that stays closed: matrices,
preload by three bolts, ten modes with joints stuck, and the curve of its first bending mode over
eight levels. Each size and checkout has processes of its own; with two checkouts three each, in
turn, and medians are shown. Times are CPU seconds on one thread. One factor and one solution are
of the whole stiffness, with a shift. Compilation is done before, on a small beam.
"""

import json
import os
import subprocess
import sys
import time
from collections import Counter
from importlib.util import find_spec
from pathlib import Path

os.environ |= dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "examples"), str(ROOT / "meshes")]

from resource import RUSAGE_SELF, getrusage
from statistics import median

import numpy as np
from make_meshes import brake_reuss

import skfem_joint as sj
from benchmarks import head, row
from benchmarks.brake_reuss import FORCE, FRICTION
from skfem_joint.linalg import factors, schur
from skfem_joint.linalg.shifts import shifted

#: Elements on each quarter of a bolt, along each free part, and heights of layers above the face.
SIZES = {
    "small": (2, (8,), ()),
    "44k": (4, (8,), ()),
    "96k": (6, (8,), (0.004,)),
    "250k": (10, (12,), (0.003, 0.006)),
}
LEVELS, MODES, REPEATS = 8, 10, 3
LIBRARY = "PARDISO" if find_spec("pypardiso") else "SuperLU"
HEAD = ("unknowns", "library", "", "matrices, s", "preload, s", "modes, s", "curve, s")
HEAD += ("one factor, s", "one solution, s", "whole way in factors", "factors", "solutions")
HEAD += ("peak, GB", "first and last Hz")


class Solver:
    """A solver whose solutions are counted; `linalg.schur` finds its factor as of the solver."""

    def __init__(self, solve, counts):
        self.solve, self.counts = solve, counts
        self.__self__ = getattr(solve, "__self__", None)

    def __call__(self, right):
        self.counts["solutions"] += 1 if right.ndim == 1 else right.shape[1]
        return self.solve(right)


def counted(least):
    """Counts of factors and solutions of at least so many unknowns from now on."""
    counts = Counter()

    def factor(make, place):
        def made(*given):
            found = make(*given)
            counts["factors"] += found is not None and given[place].shape[0] >= least
            return found

        return made

    def half(solve):
        def solved(self, right):
            counts["solutions"] += 0.5 * (1 if right.ndim == 1 else right.shape[1])
            return solve(self, right)

        return solved

    any_pattern = factors._of_any_pattern

    def solver(A):
        solve = any_pattern(A)
        return Solver(solve, counts) if A.shape[0] >= least else solve

    factors._of_any_pattern = solver
    factors._if_pardiso = factor(factors._if_pardiso, 1)
    factors.symmetric_lu = schur.symmetric_lu = factor(factors.symmetric_lu, 0)
    if hasattr(factors, "PartialFactor"):  # of a condensed model: halves of solutions
        for name in ("forward", "backward"):
            setattr(factors.PartialFactor, name, half(getattr(factors.PartialFactor, name)))
    return counts


def beam(size):
    across, along, layers = SIZES[size]
    joint = sj.Joint("upper_face", "preload", FRICTION, against="lower_face")
    return sj.Structure(
        brake_reuss(across, along, layers=layers),
        sj.Material(E=200e9, density=7800.0, poisson=0.29),
        joints=[joint],
        bolts=[sj.Clamp(FORCE, shank=(f"upper_cut_{i}", f"lower_cut_{i}")) for i in (1, 2, 3)],
        free=True,
    )


def curve_of(system):
    (curve,) = sj.backbone(system, modes=[7], levels=LEVELS)
    return curve


def one(size):
    """Way to the first curve of a size: seconds, factors and solutions of each part."""
    curve_of(beam("small").system())  # compiles
    structure, found = beam(size), {}
    counts = counted(structure.n_dofs // 2)

    def part(name, make):
        counts.clear()
        begin = time.process_time()
        made = make()
        found[name] = [time.process_time() - begin, counts["factors"], counts["solutions"]]
        return made

    part("matrices", structure.matrices)
    part("preload", lambda: structure.preload)
    system = part("system", lambda: structure.system(points=["upper_end"]))
    part("modes", lambda: sj.natural_modes(system, MODES, joints="stuck"))
    curve = part("curve", lambda: curve_of(system))
    peak = getrusage(RUSAGE_SELF).ru_maxrss / 2**20
    A = shifted(system.K, system.M)
    solve = part("factor", lambda: factors.factorised(A))
    right = np.ones(system.n)
    part("solution", lambda: [solve(right) for _ in range(10)])
    found["solution"][0] /= 10.0
    ends = [*curve.frequency[[0, -1]], *curve.damping_ratio[[0, -1]]]
    print(json.dumps(found | {"n": system.n, "peak": peak, "ends": ends}))


def measured(size, folder, repeats):
    """Medians of some processes in a checkout."""
    paths = os.pathsep.join(filter(None, (str(folder), os.environ.get("PYTHONPATH"))))
    command = [sys.executable, __file__, "--one", size]
    runs = []
    for _ in range(repeats if size != "250k" else 1):
        done = subprocess.run(
            command, env=os.environ | {"PYTHONPATH": paths}, stdout=subprocess.PIPE, check=True
        )
        runs.append(json.loads(done.stdout.splitlines()[-1]))
    middle = dict(runs[0])
    for name, value in runs[0].items():
        if isinstance(value, list) and name != "ends":
            middle[name] = [median(run[name][0] for run in runs), *value[1:]]
    return middle


def cells(run, name):
    """Row of a table of some medians."""
    parts = "preload", "modes", "curve"
    whole, made, solved = (sum(run[part][k] for part in parts) for k in range(3))
    yield from (run["n"], LIBRARY, name, f"{run['matrices'][0] + run['system'][0]:.1f}")
    yield from (f"{run[part][0]:.1f}" for part in parts)
    yield from (f"{run['factor'][0]:.2f}", f"{run['solution'][0]:.3f}")
    yield from (f"{whole / run['factor'][0]:.1f}", made, f"{solved:.0f}", f"{run['peak']:.2f}")
    yield " and ".join(f"{x:.4f}" for x in run["ends"][:2])


def main(arguments):
    if "--one" in arguments:
        one(arguments[-1])
        return
    sizes = ["small"] if "--quick" in arguments else ["44k", "96k"]
    sizes += ["250k"] * ("--largest" in arguments)
    folders, repeats = {"now": ROOT}, 1
    if "--beside" in arguments:
        folders = {"before": arguments[arguments.index("--beside") + 1]} | folders
        repeats = REPEATS
    head(*HEAD)
    for size in sizes:
        for name, folder in folders.items():
            row(*cells(measured(size, folder, repeats), name))


if __name__ == "__main__":
    main(sys.argv[1:])
