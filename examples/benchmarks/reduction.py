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
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

os.environ.update(
    dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
)
sys.path[:0] = [str(Path(__file__).resolve().parents[1]), str(Path(__file__).resolve().parent)]

import numpy as np

import skfem_joint as sj
from skfem_joint.analysis import estimate
from skfem_joint.analysis.estimate import Estimate
from skfem_joint.analysis.history import Errors, compare
from skfem_joint.reduction.basis import Basis, static_basis
from skfem_joint.reduction.friction_points import reduced_system
from skfem_joint.reduction.static_path import slip_path
from skfem_joint.stepping.recording import Run
from skfem_joint.stepping.schemes import generalized_alpha

EXAMPLES = Path(__file__).resolve().parents[1]
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


@dataclass(frozen=True)
class Task:
    """A structure, how it is run, and what is asked of its reduced model, in percent."""

    name: str
    make: Callable[[], tuple[sj.System, dict[str, Any]]]
    modes: int = 12
    interface_modes: str | int = "auto"
    unknowns: int = 1000
    history: float = np.inf
    peak: float = np.inf
    friction: float = np.inf
    large: bool = False


@dataclass(frozen=True)
class Found:
    """What was measured."""

    basis: Basis
    work: Mapping[str, int]
    full: Run
    reduced: Run
    errors: Errors
    offline_s: float
    estimate: Estimate
    estimate_s: float

    @property
    def friction(self) -> float:
        """Signed error of the friction energy, percent."""
        per_cycle = self.errors.friction_energy_per_cycle
        return 100.0 * float(self.errors.friction_energy if per_cycle is None else per_cycle or 0.0)

    def line(self, task: Task) -> str:
        """Row of the table."""
        asked = (task.unknowns, task.history, task.peak, task.friction)
        e, n = self.errors, self.basis.V.shape[1]
        errors = e.displacement_rms, abs(e.peak_displacement or 0.0)
        measured = (n, *(100.0 * error for error in errors), abs(self.friction))
        cells = [
            f"{value:.2f} ({limit:g})" if np.isfinite(limit) else f"{value:.2f}"
            for value, limit in zip(measured, asked, strict=True)
        ]
        missed = any(value > limit for value, limit in zip(measured, asked, strict=True))
        cells[0] = f"{n} ({task.unknowns})" if task.unknowns < 1000 else f"{n}"
        cells += [f"{self.offline_s:.2f}", f"{1e3 * self.reduced.wall_s / self.steps:.3f}"]
        cells += [f"{self.full.wall_s:.2f}", *(f"{self.times_faster(k):.2g}" for k in (2, 12))]
        more = self.estimate_s
        cells += [f"{more:.2f}", *(f"{self.times_faster(k, more):.2g}" for k in (2, 12))]
        stated = (self.estimate.of("total", q) for q in ("displacement_rms", "friction_energy"))
        cells += ["-" if error is None else f"{100.0 * error:.2f}" for error in stated]
        name = f"{task.name} (missed)" if missed else task.name
        work = ", ".join(str(count) for count in self.work.values())
        return f"| {' | '.join([name, *cells, work])} |"

    @property
    def steps(self) -> int:
        """Steps of the run."""
        return self.full.counters.steps

    def times_faster(self, periods: int, more_s: float = 0.0) -> float:
        """How many times faster so many periods are than in full, off-line time included."""
        share = periods / self.full.cycles.friction.size if self.full.cycles.friction.size else 1.0
        return share * self.full.wall_s / (self.offline_s + more_s + share * self.reduced.wall_s)


def scene(file: str, **changes: Any) -> tuple[sj.System, dict[str, Any]]:
    """Shipped example."""
    return timed(sj.load_scene(EXAMPLES / file).changed(**changes))


def timed(its: Any) -> tuple[sj.System, dict[str, Any]]:
    """System of a scene and how it is run."""
    steps = {"step": its.time_step, "n_steps": its.n_steps, "cycle_steps": its.cycle_steps}
    return its.system(), steps


def paper(name: str, pulse: str = "") -> tuple[sj.System, dict[str, Any]]:
    """System of the paper by name, under its harmonic load or a pulse."""
    from paper import cases

    case = cases.CASES[name]
    load = cases.pulse(case, pulse, 2.5e-5) if pulse else None
    return timed(cases.scene(case, load=load, time=IMPULSE if pulse else None))


def harmonics(
    *parts: tuple[float, float, float], length: float = 0.3, arm: float = 0.4
) -> tuple[sj.System, dict[str, Any]]:
    """Bar with a joint under harmonics: shares of the friction limit, frequencies, phases."""
    mesh = sj.build_bar(
        [("joint", length, 100), ("arm", arm, 100)], {"left": 0.0, "end": length + arm}
    )
    joint = sj.Joint("joint", 50e6, 0.7, normal_force="equal")
    structure = sj.Structure(
        mesh, STEEL, width=0.05, thickness=0.01, fixed=["left"], joints=[joint],
        stiffness_damping=1e-5,
    )  # fmt: skip
    limit = LIMIT * length / 0.3
    load = sj.MultiHarmonic(
        tuple(sj.Harmonic(share * limit, f, phase) for share, f, phase in parts)
    )
    period = load.period or 0.0
    steps = {"step": period / 400, "n_steps": 1600, "cycle_steps": 400}
    return structure.system([sj.Load("end", load)]), steps


def plate(along: int, across: int, width: float, bolted: bool) -> tuple[sj.System, dict[str, Any]]:
    """Plate of the benchmark of steps, two periods."""
    from plates import CYCLES, FREQUENCY, STEPS, system_of

    steps = {"step": 1.0 / FREQUENCY / STEPS, "n_steps": CYCLES * STEPS, "cycle_steps": STEPS}
    return system_of(along, across, width, bolted), steps


def bending() -> tuple[sj.System, dict[str, Any]]:
    """Plate seen from the side, pressed on a base along its lower edge, pulled: it bends."""
    border = {"left": "left", "right": "right", "joint": ("bottom", "foot")}
    mesh = sj.build_plate([("foot", 0.1, 40), ("arm", 0.3, 60)], 0.05, 8, boundaries=border)
    structure = sj.Structure(
        mesh, STEEL, thickness=0.01, fixed=["left"], joints=[sj.Joint("joint", 100e6, 0.5)],
        stiffness_damping=1e-5,
    )  # fmt: skip
    system = structure.system([sj.Load("right", sj.Harmonic(20e3, 500.0), (1.0, 0.0))], [])
    return system, {"step": 2e-5, "n_steps": 400, "cycle_steps": 100}


def tasks() -> Iterator[Task]:
    """All that is asked."""
    harmonic = "structure_harmonic.toml"
    yield Task("Fig. 18, harmonic", lambda: scene(harmonic), unknowns=15, history=0.3, friction=0.7)
    close = {"unknowns": 16, "peak": 0.3, "friction": 1.0}
    for name in ("I", "II", "III", "IV", "V", "VI", "VII", "reference"):
        yield Task(f"Case {name}", partial(paper, name), **close)
    yield Task("structure, harmonic", lambda: scene(harmonic), **close)
    impulse = "structure_impulse.toml"
    pulse_16 = {"modes": 15, "interface_modes": 0, **close, "history": 3.0}
    yield Task("structure, impulse", lambda: scene(impulse), **pulse_16)
    more = {"modes": 32, "interface_modes": 3, "unknowns": 36, "history": 1.0}
    yield Task("structure, impulse, more modes", lambda: scene(impulse), **more)
    for pulse in ("triangle", "ramp_and_hold"):
        make = partial(paper, "I", pulse)
        yield Task(f"joint, {pulse}", make, unknowns=16, history=3.0, friction=1.0)
    minor = {"modes": 16, "unknowns": 20, "friction": 1.5}
    yield Task("two harmonics, 1 : 5", lambda: harmonics((0.3, 300, 0), (0.2, 1500, 0.7)), **minor)
    yield Task(
        "two harmonics, 1 : 3", lambda: harmonics((0.25, 400, 0), (0.25, 1200, 0.3)), **minor
    )
    three = (0.2, 200, 0), (0.2, 600, 0.3), (0.1, 1000, 2.0)
    yield Task("three harmonics", lambda: harmonics(*three, length=0.1, arm=0.5), **minor)
    plates = {"history": 0.5, "friction": 2.0}
    yield Task("two plates, Fig. 18(a)", lambda: scene("two_plates.toml"), 14, **plates)
    yield Task("plate from the side, bending", bending, **plates)
    yield Task("plate, 3,960, pressed evenly", lambda: plate(198, 9, 0.05, False), **plates)
    yield Task("plate, 4,032, two bolts", lambda: plate(63, 31, 0.25, True), **plates)
    fine = {"history": 0.2, "friction": 1.0, "large": True}
    yield Task("plate, 19,872, pressed evenly", lambda: plate(432, 22, 0.05, False), **fine)
    yield Task("plate, 19,880, two bolts", lambda: plate(142, 69, 0.25, True), **plates, large=True)


def measure(task: Task) -> Found:
    """Run the full model and the reduced one."""
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
    took = time.perf_counter() - begin
    return Found(basis, path.work, full, reduced, compare(full, reduced), offline, found, took)


def main(arguments: list[str]) -> int:
    """Print the table; other arguments than --quick are parts of the names of rows."""
    names = [one for one in arguments if not one.startswith("-")]
    print(f"numpy {np.__version__}, one BLAS thread; measured, and (asked) where something was\n")
    print(f"| {' | '.join(HEADER)} |\n{'| --- ' * len(HEADER)}|", flush=True)
    for task in tasks():
        if (task.large and "--quick" in arguments) or not (
            not names or any(name in task.name for name in names)
        ):
            continue
        print(measure(task).line(task), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
