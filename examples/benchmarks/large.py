"""Time of a large model up to its first curve, in factors and solutions of its stiffness.

    python examples/benchmarks/large.py                   44,121 and 95,915 unknowns
    python examples/benchmarks/large.py --quick           20,513
    python examples/benchmarks/large.py --largest         239,139 too, with PARDISO

A Brake-Reuss beam of bricks of second order that floats, with contact that stays closed: matrices,
preload by three bolts, ten modes with joints stuck, and the curve of its first bending mode over
eight levels. Each size has a process of its own. Times are CPU seconds on one thread. One factor
and one solution are of the whole stiffness, with a shift. Compilation is done before.
"""

import json
import subprocess
import sys
import time
from collections import Counter
from importlib.util import find_spec
from pathlib import Path

sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

from benchmarks import head, row

# isort: split

from resource import RUSAGE_SELF, getrusage

import numpy as np
from make_meshes import brake_reuss

import skfem_joint as sj
from benchmarks.brake_reuss import beam
from skfem_joint.linalg import factors, schur
from skfem_joint.linalg.shifts import shifted

#: Elements on each quarter of a bolt, along each free part, and heights of layers above the face.
SIZES = {
    "small": (2, (8,), ()),
    "44k": (4, (8,), ()),
    "96k": (6, (8,), (0.004,)),
    "250k": (10, (12,), (0.003, 0.006)),
}
LEVELS, MODES = 8, 10
LIBRARY = "PARDISO" if find_spec("pypardiso") else "SuperLU"
HEAD = ("unknowns", "library", "matrices, s", "preload, s", "modes, s", "curve, s")
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


def beam_of(size):
    across, along, layers = SIZES[size]
    return beam("constant", brake_reuss(across, along, layers=layers))


def curve_of(system):
    (curve,) = sj.backbone(system, modes=[7], levels=LEVELS)
    return curve


def one(size):
    """Way to the first curve of a size: seconds, factors and solutions of each part."""
    curve_of(beam_of("small").system())  # compiles
    structure, found = beam_of(size), {}
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
    ends = curve.frequency[[0, -1]].tolist()
    print(json.dumps(found | {"n": system.n, "peak": peak, "ends": ends}))


def cells(run):
    """Row of the table."""
    parts = "preload", "modes", "curve"
    whole, made, solved = (sum(run[part][k] for part in parts) for k in range(3))
    yield from (run["n"], LIBRARY, f"{run['matrices'][0] + run['system'][0]:.1f}")
    yield from (f"{run[part][0]:.1f}" for part in parts)
    yield from (f"{run['factor'][0]:.2f}", f"{run['solution'][0]:.3f}")
    yield from (f"{whole / run['factor'][0]:.1f}", made, f"{solved:.0f}", f"{run['peak']:.2f}")
    yield " and ".join(f"{x:.4f}" for x in run["ends"])


def main(arguments):
    if "--one" in arguments:
        one(arguments[-1])
        return
    sizes = ["small"] if "--quick" in arguments else ["44k", "96k"]
    sizes += ["250k"] * ("--largest" in arguments)
    head(*HEAD)
    for size in sizes:
        command = [sys.executable, __file__, "--one", size]
        done = subprocess.run(command, stdout=subprocess.PIPE, check=True)
        row(*cells(json.loads(done.stdout.splitlines()[-1])))


if __name__ == "__main__":
    main(sys.argv[1:])
