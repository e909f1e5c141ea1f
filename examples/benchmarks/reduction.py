"""Reduced models without a full run: what was asked of them and what is measured.

    python examples/benchmarks/reduction.py           all, the large plates take minutes
    python examples/benchmarks/reduction.py --quick   without the plates of 20,000 unknowns

Each row is a structure reduced to modes of its static slip path with the defaults, but for the
number of modes where one is given, beside its full model: unknowns, history (root mean square of
the named point that differs most), peak and friction energy (of the last cycle where there are
cycles) in percent. How many times faster two and twelve periods are includes the off-line time, the
second time that of the estimated errors too, which stand beside it.
"""

import sys
import time
import tomllib
from dataclasses import replace
from pathlib import Path

sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

from benchmarks import EXAMPLES, head, row

# isort: split

import numpy as np
from paper import cases

import skfem_joint as sj
from benchmarks.plates import CYCLES, FREQUENCY, STEPS, system_of
from skfem_joint.accuracy import rungs
from skfem_joint.reduction.models import reduced_on
from skfem_joint.reduction.sources import static_basis
from skfem_joint.reduction.static_path import slip_path
from skfem_joint.results.history import compare
from skfem_joint.stepping.plan import Plan


def timed(its):
    """System of a scene, and its steps as arguments of `integrate`."""
    steps = {"step": its.time_step, "n_steps": its.n_steps, "cycle_steps": its.cycle_steps}
    return its.system(), steps


def scene(name):
    return timed(sj.load_scene(EXAMPLES / f"{name}.toml"))


def paper(name, pulse=""):
    """System of the paper by name, under its harmonic load or a pulse."""
    case = cases.CASES[name]
    load = cases.pulse(case, pulse, 2.5e-5) if pulse else None
    time = {"duration": 2e-3, "step": 1e-6} if pulse else None
    return timed(cases.scene(case, load=load, time=time))


def harmonics(length, arm, *parts):
    """Bar with a joint under harmonics: shares of the friction limit, frequencies, phases."""
    case = replace(cases.CASES["structure"], length=length, linear=arm)
    names = "amplitude", "frequency", "phase"
    waves = [dict(zip(names, (part[0] * case.limit, *part[1:]), strict=True)) for part in parts]
    load = {"kind": "multi_harmonic", "components": waves}
    its = cases.scene(case, load=load, time={"cycles": 4, "steps_per_cycle": 400})
    return timed(its.changed(output={"points": ["free_end"]}))


def plate(*size):
    """Plate of the benchmark of steps, two periods."""
    steps = {"step": 1.0 / FREQUENCY / STEPS, "n_steps": CYCLES * STEPS, "cycle_steps": STEPS}
    return system_of(*size), steps


def bending():
    """Plate seen from the side, pressed on a base along its lower edge, pulled: it bends."""
    border = {"left": "left", "right": "right", "joint": ("bottom", "foot")}
    structure = sj.Structure(
        sj.build_plate([("foot", 0.1, 40), ("arm", 0.3, 60)], 0.05, 8, boundaries=border),
        sj.Material(E=200e9, density=8000.0, poisson=0.3),
        thickness=0.01,
        incompatible=False,  # plain elements, with which the published tables were measured
        fixed=["left"],
        joints=[sj.Joint("joint", 100e6, 0.5, beta=1e5)],
        stiffness_damping=1e-5,
    )
    system = structure.system([sj.Load("right", sj.Harmonic(20e3, 500.0), (1.0, 0.0))], [])
    return system, {"step": 2e-5, "n_steps": 400, "cycle_steps": 100}


#: Functions that make structures, by the names in ``reduction.toml``.
MAKERS = {maker.__name__: maker for maker in (scene, paper, harmonics, plate, bending)}


def measure(task):
    """Run the full model and the reduced one; returns the cells of a row."""
    system, how = MAKERS[task["make"]](*task["of"])
    modes, interface_modes = task.get("modes", 12), task.get("interface_modes", "auto")
    full = sj.integrate(system, **how)
    begin = time.perf_counter()
    plan = Plan(**how)
    path = slip_path(system, plan, modes=modes)
    basis = static_basis(system, path, modes, interface_modes)
    small = reduced_on(system, basis if how["cycle_steps"] else basis.for_decay())
    offline = time.perf_counter() - begin
    reduced = sj.integrate(small, **how)
    offline += reduced.preparation_s
    begin = time.perf_counter()
    estimated = rungs.of_reduced(reduced, plan)
    more = time.perf_counter() - begin

    errors, cycles, n = compare(full, reduced), full.cycles.friction.size, basis.V.shape[1]
    friction = errors.friction_energy_per_cycle if cycles else errors.friction_energy
    shares = errors.displacement_rms, errors.peak_displacement or 0.0, friction or 0.0
    measured = [n, *(100.0 * abs(share) for share in shares)]
    asked = [task.get("unknowns", 1000)]
    asked += [task.get(name, np.inf) for name in ("history", "peak", "friction")]
    missed = any(value > limit for value, limit in zip(measured, asked, strict=True))
    cells = [task["name"] + (" (missed)" if missed else "")]
    cells.append(f"{n} ({asked[0]})" if "unknowns" in task else n)
    for value, limit in zip(measured[1:], asked[1:], strict=True):
        cells.append(f"{value:.2f} ({limit:g})" if np.isfinite(limit) else f"{value:.2f}")

    def times_faster(added):
        """Speed-up over two and twelve periods, off-line time and ``added`` time included."""
        for share in (periods / cycles if cycles else 1.0 for periods in (2, 12)):
            spent = offline + added + share * reduced.wall_s
            yield f"{share * full.wall_s / spent:.2g}"

    cells += [f"{offline:.2f}", f"{1e3 * reduced.wall_s / full.counters.steps:.3f}"]
    cells += [f"{full.wall_s:.2f}", *times_faster(0.0), f"{more:.2f}", *times_faster(more)]
    stated = (
        estimated.of("total", quantity) for quantity in ("displacement_rms", "friction_energy")
    )
    cells += ["-" if error is None else f"{100.0 * error:.2f}" for error in stated]
    return *cells, ", ".join(map(str, path.work.values()))


def main(arguments):
    """Print the table; other arguments than --quick are parts of the names of rows."""
    names = [name for name in arguments if not name.startswith("-")] or [""]
    measure({"name": "what loads the code", "make": "plate", "of": [20, 3, 0.05, False]})
    print("Measured, and (asked) where something was.\n")
    # The last column counts quasi-static states, factorisations and preliminary steps.
    head(
        *("", "unknowns", "history, %", "peak, %", "friction, %", "off-line, s", "ms a step"),
        *("full, s", "times faster, 2 periods", "12 periods", "estimate, s", "2", "12"),
        *("stated history, %", "friction, %", "states, factors, steps"),
    )
    tasks = tomllib.loads((Path(__file__).parent / "reduction.toml").read_text("utf-8"))["task"]
    for task in tasks:
        large = task.get("large") and "--quick" in arguments
        if any(name in task["name"] for name in names) and not large:
            row(*measure(task))


if __name__ == "__main__":
    main(sys.argv[1:])
