"""Reduced models without a full run: what was asked of them and what is measured.

    python examples/benchmarks/reduction.py           all, the large plates take minutes
    python examples/benchmarks/reduction.py --quick   without the plates of 20,000 unknowns

Each row is a structure reduced to modes of its static slip path with the defaults, but for the
number of modes where one is given, beside its full model: unknowns, history (root mean square of
the named point that differs most), peak and friction energy (of the last cycle where there are
cycles) in percent. How many times faster two and twelve periods are includes the off-line time, the
second time that of the estimated errors too, which stand beside it.
"""

import os
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import NamedTuple

os.environ |= dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np
from paper import cases

import skfem_joint as sj
from benchmarks import EXAMPLES, head, row
from benchmarks.plates import CYCLES, FREQUENCY, STEPS, system_of
from skfem_joint.analysis import estimate
from skfem_joint.analysis.history import compare
from skfem_joint.reduction.basis import static_basis
from skfem_joint.reduction.friction_points import reduced_system
from skfem_joint.reduction.static_path import slip_path
from skfem_joint.stepping.schemes import generalized_alpha

STEEL = sj.Material(E=200e9, density=8000.0, poisson=0.3)
#: Columns of the table; the last are quasi-static states, factorisations and preliminary steps.
HEADER = (
    *("", "unknowns", "history, %", "peak, %", "friction, %", "off-line, s", "ms a step"),
    *("full, s", "times faster, 2 periods", "12 periods", "estimate, s", "2", "12"),
    *("stated history, %", "friction, %", "states, factors, steps"),
)
#: 100 elements of 0.3 m of joint with 50 MPa, 0.4 m of bar: friction limit, N.
LIMIT = 0.7 * 50e6 * 0.05 * 0.3
IMPULSE = {"duration": 2e-3, "step": 1e-6}


class Task(NamedTuple):
    """A structure, how it is run, and what is asked of its reduced model, in percent."""

    name: str
    make: Callable
    modes: int = 12
    interface_modes: str | int = "auto"
    unknowns: int = 1000
    history: float = np.inf
    peak: float = np.inf
    friction: float = np.inf
    large: bool = False


def timed(its):
    """System of a scene and how it is run."""
    steps = {"step": its.time_step, "n_steps": its.n_steps, "cycle_steps": its.cycle_steps}
    return its.system(), steps


def scene(name):
    return timed(sj.load_scene(EXAMPLES / f"{name}.toml"))


def paper(name, pulse=""):
    """System of the paper by name, under its harmonic load or a pulse."""
    case = cases.CASES[name]
    load = cases.pulse(case, pulse, 2.5e-5) if pulse else None
    return timed(cases.scene(case, load=load, time=IMPULSE if pulse else None))


def harmonics(*parts, length=0.3, arm=0.4):
    """Bar with a joint under harmonics: shares of the friction limit, frequencies, phases."""
    points = {"left": 0.0, "end": length + arm}
    structure = sj.Structure(
        sj.build_bar([("joint", length, 100), ("arm", arm, 100)], points),
        STEEL,
        width=0.05,
        thickness=0.01,
        fixed=["left"],
        joints=[sj.Joint("joint", 50e6, 0.7, normal_force="equal")],
        stiffness_damping=1e-5,
    )
    limit = LIMIT * length / 0.3
    waves = tuple(sj.Harmonic(share * limit, f, phase) for share, f, phase in parts)
    load = sj.MultiHarmonic(waves)
    steps = {"step": load.period / 400, "n_steps": 1600, "cycle_steps": 400}
    return structure.system([sj.Load("end", load)]), steps


def plate(*size):
    """Plate of the benchmark of steps, two periods."""
    steps = {"step": 1.0 / FREQUENCY / STEPS, "n_steps": CYCLES * STEPS, "cycle_steps": STEPS}
    return system_of(*size), steps


def bending():
    """Plate seen from the side, pressed on a base along its lower edge, pulled: it bends."""
    border = {"left": "left", "right": "right", "joint": ("bottom", "foot")}
    structure = sj.Structure(
        sj.build_plate([("foot", 0.1, 40), ("arm", 0.3, 60)], 0.05, 8, boundaries=border),
        STEEL,
        thickness=0.01,
        fixed=["left"],
        joints=[sj.Joint("joint", 100e6, 0.5)],
        stiffness_damping=1e-5,
    )
    system = structure.system([sj.Load("right", sj.Harmonic(20e3, 500.0), (1.0, 0.0))], [])
    return system, {"step": 2e-5, "n_steps": 400, "cycle_steps": 100}


def tasks():
    harmonic, impulse = partial(scene, "structure_harmonic"), partial(scene, "structure_impulse")
    close = {"unknowns": 16, "peak": 0.3, "friction": 1.0}
    pulse_16 = {"modes": 15, "interface_modes": 0, **close, "history": 3.0}
    more = {"modes": 32, "interface_modes": 3, "unknowns": 36, "history": 1.0}
    pulses = {"unknowns": 16, "history": 3.0, "friction": 1.0}
    minor = {"modes": 16, "unknowns": 20, "friction": 1.5}
    three = (0.2, 200, 0), (0.2, 600, 0.3), (0.1, 1000, 2.0)
    flat = {"history": 0.5, "friction": 2.0, "large": False}
    big, fine = flat | {"large": True}, {"history": 0.2, "friction": 1.0, "large": True}
    names = ("I", "II", "III", "IV", "V", "VI", "VII", "reference")
    return [
        Task("Fig. 18, harmonic", harmonic, unknowns=15, history=0.3, friction=0.7),
        *(Task(f"Case {name}", partial(paper, name), **close) for name in names),
        Task("structure, harmonic", harmonic, **close),
        Task("structure, impulse", impulse, **pulse_16),
        Task("structure, impulse, more modes", impulse, **more),
        Task("joint, triangle", partial(paper, "I", "triangle"), **pulses),
        Task("joint, ramp_and_hold", partial(paper, "I", "ramp_and_hold"), **pulses),
        Task("two harmonics, 1 : 5", lambda: harmonics((0.3, 300, 0), (0.2, 1500, 0.7)), **minor),
        Task("two harmonics, 1 : 3", lambda: harmonics((0.25, 400, 0), (0.25, 1200, 0.3)), **minor),
        Task("three harmonics", lambda: harmonics(*three, length=0.1, arm=0.5), **minor),
        Task("two plates, Fig. 18(a)", partial(scene, "two_plates"), 14, **flat),
        Task("plate from the side, bending", bending, **flat),
        Task("plate, 3,960, pressed evenly", lambda: plate(198, 9, 0.05, False), **flat),
        Task("plate, 4,032, two bolts", lambda: plate(63, 31, 0.25, True), **flat),
        Task("plate, 19,872, pressed evenly", lambda: plate(432, 22, 0.05, False), **fine),
        Task("plate, 19,880, two bolts", lambda: plate(142, 69, 0.25, True), **big),
    ]


def measure(task):
    """Run the full model and the reduced one; cells of the table."""
    system, how = task.make()
    full = sj.integrate(system, **how)
    begin = time.perf_counter()
    path = slip_path(system, how["step"], how["n_steps"], modes=task.modes)
    basis = static_basis(system, path, task.modes, task.interface_modes)
    periodic = how["cycle_steps"] is not None
    small, _ = reduced_system(system, basis, periodic=periodic, warn=[])
    offline = time.perf_counter() - begin
    reduced = sj.integrate(small, **how)
    offline += reduced.preparation_s
    begin = time.perf_counter()
    steps = {**how, "scheme": generalized_alpha(1.0), "save": sj.Save()}
    found = estimate.of_reduced(system, basis, small, steps, reduced)
    more = time.perf_counter() - begin

    errors, cycles, n = compare(full, reduced), full.cycles.friction.size, basis.V.shape[1]
    friction = errors.friction_energy_per_cycle if cycles else errors.friction_energy
    shares = errors.displacement_rms, errors.peak_displacement or 0.0, friction or 0.0
    measured = [n, *(100.0 * abs(share) for share in shares)]
    asked = task.unknowns, task.history, task.peak, task.friction
    missed = any(value > limit for value, limit in zip(measured, asked, strict=True))
    cells = [f"{task.name} (missed)" if missed else task.name]
    cells.append(f"{n} ({task.unknowns})" if task.unknowns < 1000 else n)
    for value, limit in zip(measured[1:], asked[1:], strict=True):
        cells.append(f"{value:.2f} ({limit:g})" if np.isfinite(limit) else f"{value:.2f}")

    def times_faster(added):
        """Two and twelve periods, off-line time included."""
        for share in (periods / cycles if cycles else 1.0 for periods in (2, 12)):
            spent = offline + added + share * reduced.wall_s
            yield f"{share * full.wall_s / spent:.2g}"

    cells += [f"{offline:.2f}", f"{1e3 * reduced.wall_s / full.counters.steps:.3f}"]
    cells += [f"{full.wall_s:.2f}", *times_faster(0.0), f"{more:.2f}", *times_faster(more)]
    stated = (found.of("total", quantity) for quantity in ("displacement_rms", "friction_energy"))
    cells += ["-" if error is None else f"{100.0 * error:.2f}" for error in stated]
    return *cells, ", ".join(map(str, path.work.values()))


def main(arguments):
    """Print the table; other arguments than --quick are parts of the names of rows."""
    names = [one for one in arguments if not one.startswith("-")] or [""]
    print(f"numpy {np.__version__}, one BLAS thread; measured, and (asked) where something was\n")
    head(*HEADER)
    for task in tasks():
        if any(name in task.name for name in names) and not (task.large and "--quick" in arguments):
            row(*measure(task))


if __name__ == "__main__":
    main(sys.argv[1:])
