"""Cost of a step of a plate: full, condensed, reduced, and refactoring at each iteration.

    python examples/benchmarks/plates.py            both cases at 4,000 and 20,000 unknowns
    python examples/benchmarks/plates.py --quick    both at 600

A plate of 500 mm and 10 mm thickness is pulled at 500 Hz by half of its friction limit. In one
case it is 250 mm wide and two bolts press it on a rigid base: few points are in contact, under
their heads. In the other it is 50 mm wide and its first 200 mm are pressed evenly: 40 % of all
points are in contact. BLAS threads are pinned, medians are reported.

The rival is Newton's method with an exact search along its direction, which factorises the tangent
at each iteration with the same ordering and library, from the same extrapolated start.
"""

import sys
import time
from functools import partial
from pathlib import Path
from statistics import median
from unittest.mock import patch

sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

from benchmarks import head, row

# isort: split

import numpy as np

import skfem_joint as sj
from skfem_joint.linalg import schur
from skfem_joint.minimise import contact_newton
from skfem_joint.results.history import compare

FREQUENCY, STEPS, CYCLES = 500.0, 200, 2
BOLT_FORCE, PRESSURE, FRICTION = 20e3, 8e6, 0.7
#: Elements along and across, and width (m), with bolts and pressed evenly.
SIZES = (((63, 31, 0.25), (198, 9, 0.05)), ((142, 69, 0.25), (432, 22, 0.05)))
QUICK = (((24, 12, 0.25), (60, 4, 0.05)),)


def system_of(along, across, width, bolted):
    pressed = round(0.4 * along)
    strips = [("joint", 0.2, pressed), ("linear", 0.3, along - pressed)]
    bolts = tuple(sj.Bolt((x, 0.5 * width), BOLT_FORCE, 0.009, 0.0055) for x in (0.05, 0.15))
    pressure = sj.Bolts(bolts, reach=0.01) if bolted else PRESSURE
    structure = sj.Structure(
        sj.build_plate(strips, width, across),
        sj.Material(E=200e9, density=8000.0, poisson=0.3),
        thickness=0.01,
        incompatible=False,  # plain elements, with which the published tables were measured
        fixed=["left"],
        joints=[sj.Joint("joint", pressure, FRICTION, beta=1e5)],
        stiffness_damping=1e-5,
    )
    limit = FRICTION * (2 * BOLT_FORCE if bolted else PRESSURE * 0.2 * width)
    return structure.system([sj.Load("right", sj.Harmonic(0.5 * limit, FREQUENCY), (1.0, 0.0))], [])


def run(system, n_steps=CYCLES * STEPS):
    return sj.integrate(system, step=1.0 / FREQUENCY / STEPS, n_steps=n_steps, cycle_steps=STEPS)


def line(name, base, runs, offline=0.0, errors=("", "")):
    """Print runs of a model beside one that takes ``base`` seconds a step."""
    counters, seconds = runs[0].counters, median(run.wall_s for run in runs)
    step, offline = seconds / counters.steps, offline + runs[0].preparation_s
    iterations = counters.newton_iterations / counters.steps
    row(
        name,
        f"{1e3 * step:.3f}",
        f"{base / step:.2f}",
        f"{iterations:.1f}",
        f"{offline:.2f}",
        *errors,
    )


def report(along, across, width, bolted):
    system = system_of(along, across, width, bolted)
    print(
        f"\n{'Two bolts' if bolted else 'Pressed evenly'}: {system.n} unknowns, "
        f"{system.contact.count} contact points, {STEPS} steps a period, {CYCLES} periods, arctan "
        "law, beta = 1e5 s/m.\n"
    )
    head(
        *("model", "ms a step", "times faster", "iterations a step", "off-line, s"),
        *("displacement, %", "friction energy, %"),
    )
    first = run(system, n_steps=60)
    with (
        patch.multiple(contact_newton, PATIENCE=0, SWEEPS=0),
        patch.multiple(schur, MEMORY_SHARE=0.0, FEWEST_SPARSE=np.inf),
    ):
        line("refactoring each iteration", first.wall_s / 60, [run(system, n_steps=60)])
    full = run(system)
    base = full.wall_s / full.counters.steps
    line("full", base, [full])
    models = [partial(sj.reduce, modes=modes) for modes in (6, 12, 18)]
    for make in [sj.condense, *models] if bolted else models:  # few points, or too many to condense
        begin = time.perf_counter()
        small = make(system)
        offline = time.perf_counter() - begin
        runs = [run(small) for _ in range(3)]
        off = 100 * compare(full, runs[0]).displacement_max
        energy = 100 * (runs[0].cycles.friction[-1] / full.cycles.friction[-1] - 1.0)
        kind = "condensed" if make is sj.condense else "reduced"
        name = f"{kind}, {small.n} unknowns, {small.contact.w.size} points"
        line(name, base, runs, offline, (f"{off:.3f}", f"{energy:+.3f}"))


def main(arguments):
    for pair in QUICK if "--quick" in arguments else SIZES:
        for size, bolted in zip(pair, (True, False), strict=True):
            report(*size, bolted)


if __name__ == "__main__":
    main(sys.argv[1:])
