"""Speed of plates: full, reduced, and refactoring at each iteration; prints one table a case.

    python examples/plate_benchmark.py            both cases at 4,000 and 20,000 unknowns
    python examples/plate_benchmark.py --quick    4,000 unknowns alone

A plate of 500 mm and 10 mm thickness is pulled at 500 Hz by half of its friction limit. In one
case it is 250 mm wide and two bolts press it on a rigid base: few points are in contact, under
their heads. In the other it is 50 mm wide and its first 200 mm are pressed evenly: 40 % of all
points are in contact. BLAS threads are pinned, models run in turn, medians are reported.

The rival is Newton's method with an exact search along its direction, which factorises the tangent
at each iteration with the same ordering and library, from the same extrapolated start.
"""

import os

for variable in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[variable] = "1"

import statistics
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from skfem_joint import contact_solver, steppers_contact
from skfem_joint.bolts import Bolt, Bolts
from skfem_joint.history import compare
from skfem_joint.integrate import integrate
from skfem_joint.loads import Harmonic
from skfem_joint.plate import PlateJoint, assemble_plate, build_plate_structure
from skfem_joint.plate_mesh import build_plate
from skfem_joint.plate_reduction import own_basis, with_friction_points
from skfem_joint.recording import Run, Save
from skfem_joint.results import RESOLVED_SHARE
from skfem_joint.system import System

FREQUENCY, STEPS, CYCLES = 500.0, 200, 2
BOLT_FORCE, PRESSURE, FRICTION, BETA = 20e3, 8e6, 0.7, 1e5
#: Elements along and across, and width, m, by unknowns and whether bolts press.
SIZES = {
    (4_000, True): (63, 31, 0.25),
    (4_000, False): (198, 9, 0.05),
    (20_000, True): (142, 69, 0.25),
    (20_000, False): (432, 22, 0.05),
}
REPEATS = 3


def system_of(size: tuple[int, int, float], bolted: bool) -> System:
    along, across, width = size
    pressed = round(0.4 * along)
    plate = build_plate([("joint", 0.2, pressed), ("linear", 0.3, along - pressed)], width, across)
    bolts = tuple(Bolt((x, 0.5 * width), BOLT_FORCE, 0.009, 0.0055) for x in (0.05, 0.15))
    joint = PlateJoint(
        "joint", "region", None, Bolts(bolts, reach=0.01) if bolted else PRESSURE, FRICTION, BETA
    )
    structure = build_plate_structure(
        plate, E=200e9, poisson=0.3, density=8000.0, thickness=0.01,
        supports=[("left", "xy")], joints=[joint], stiffness_damping=1e-5,
    )  # fmt: skip
    limit = FRICTION * (2 * BOLT_FORCE if bolted else PRESSURE * 0.2 * width)
    return assemble_plate(structure, [("right", (1.0, 0.0), Harmonic(0.5 * limit, FREQUENCY))], [])


def run(system: System, steps: int = CYCLES * STEPS, fields: bool = False) -> Run:
    return integrate(
        system,
        step=1.0 / FREQUENCY / STEPS,
        n_steps=steps,
        save=Save(fields=fields),
        cycle_steps=STEPS,
    )


@contextmanager
def refactoring() -> Iterator[None]:
    """Newton's method that factorises at each iteration, nothing condensed, nothing relaxed."""
    kept = contact_solver.PATIENCE, contact_solver.SWEEPS, steppers_contact.CONDENSED
    contact_solver.PATIENCE, contact_solver.SWEEPS, steppers_contact.CONDENSED = 0, 0, 0
    try:
        yield
    finally:
        contact_solver.PATIENCE, contact_solver.SWEEPS, steppers_contact.CONDENSED = kept


def reduced_systems(system: System, choices: list[tuple[int, int]]) -> dict[str, tuple]:
    """Reduced systems by name, with the time that each took to make."""
    begin = time.perf_counter()
    training = run(system, fields=True)
    trained = time.perf_counter() - begin
    made = {}
    for modes, points in choices:
        begin = time.perf_counter()
        basis = own_basis(system, training, modes)
        reduced = with_friction_points(system, basis, points)
        reduced = reduced.with_beta(min(BETA, 1.0 / (RESOLVED_SHARE * basis.slip_velocity)))
        offline = trained + time.perf_counter() - begin
        made[f"reduced, {modes} modes, {reduced.w.size} points"] = reduced, offline
    return made


def report(size: tuple[int, int, float], bolted: bool) -> None:
    system = system_of(size, bolted)
    kind = "two bolts" if bolted else "pressed evenly"
    print(
        f"\n{kind}: {system.n} unknowns, {system.contact_points} contact points, {STEPS} steps a "
        f"period, {CYCLES} periods, arctan law, beta = {BETA:g} s/m"
    )
    rivals = {}
    with refactoring():
        few = run(system, steps=60)
        rivals["refactoring each iteration"] = few.wall_s / 60
    models = {"full": (system, 0.0)} | reduced_systems(system, [(5, 20), (10, 40), (14, 60)])
    runs: dict[str, list[Run]] = {name: [] for name in models}
    for _ in range(REPEATS):
        for name, (model, _) in models.items():
            if name != "full" or not runs[name]:
                runs[name].append(run(model))
    full = runs["full"][0]
    base = full.wall_s / full.counters.steps
    first = run(system, steps=60)
    print(
        "model                                ms a step  times faster    iterations  off-line, s"
        "  displacement, %  friction energy, %"
    )
    for name, per_step in rivals.items():
        ratio = per_step / (first.wall_s / 60)
        print(
            f"{name:35s}  {1e3 * per_step:9.3f}  1/{ratio:<11.1f}"
            f"  {few.counters.newton_iterations / 60:12.1f}  {few.preparation_s:11.2f}"
        )
    for name, done in runs.items():
        per_step = statistics.median(one.wall_s for one in done) / done[0].counters.steps
        errors = "" if name == "full" else _errors(full, done[0])
        offline = models[name][1] + done[0].preparation_s
        print(
            f"{name:35s}  {1e3 * per_step:9.3f}  {base / per_step:<13.1f}"
            f"  {done[0].counters.newton_iterations / done[0].counters.steps:12.1f}"
            f"  {offline:11.2f}{errors}"
        )


def _errors(full: Run, reduced: Run) -> str:
    found = compare(full, reduced)
    energy = reduced.cycles.friction[-1] / full.cycles.friction[-1] - 1.0
    return f"  {100 * found.displacement_max:15.2f}  {100 * energy:+18.2f}"


def main() -> None:
    for (unknowns, bolted), size in SIZES.items():
        if unknowns == 4_000 or "--quick" not in sys.argv:
            report(size, bolted)
    print(f"\nnumpy {np.__version__}, one BLAS thread")


if __name__ == "__main__":
    main()
