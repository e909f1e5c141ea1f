"""Cost of a step, and of ``check``, of bolted solids with 100 to 3,000 contact points.

    python examples/benchmarks/contact_points.py            all sizes
    python examples/benchmarks/contact_points.py --quick    100 and 300
    python examples/benchmarks/contact_points.py steps --out DIR [--to POINTS]

Two plates of bricks of second order as in ``solids.py``, lapped under two bolts that press most of
the lap, with exact Coulomb friction; finer and finer meshes. Each is checked, as by ``skfem-joint
check``, and then its full model is run from rest, to nine tenths of the load's peak. It is stepped
on its contact unknowns where that costs less; up to 800 points it is stepped in the other way too.
BLAS threads are pinned. What is compiled is compiled before.

``steps`` measures processor time of steps alone, with constant contact and with contact that opens,
on bricks of first order, of which more have contact. At the last of 12 steps about a fifth of the
points slips. It draws both over the number of points.
"""

import argparse
import sys
import time
from pathlib import Path
from unittest.mock import patch

sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

from benchmarks import head, row

# isort: split

import matplotlib as mpl
import numpy as np

import skfem_joint as sj
from benchmarks.solids import plates
from skfem_joint.linalg import schur
from skfem_joint.minimise.problem import ContactPoints
from skfem_joint.stepping.arrangement import arranged
from skfem_joint.stepping.driver import PythonStepper
from skfem_joint.study.description import description_of

#: Elements along the overlap and along the rest of each plate, across, and through its thickness.
SIZES = ((10, 2, 2, 1), (18, 2, 4, 1), (28, 2, 6, 1), (28, 2, 7, 1), (38, 2, 12, 1), (52, 2, 18, 1))
QUICK = SIZES[:2]
REACH, PERIOD, STEPS, SPARSE = 0.025, 100, 18, 800
#: The same by the number of points that they give with elements of first order.
FIRST_ORDER = {
    104: (12, 3, 7, 1),
    300: (24, 3, 11, 1),
    595: (34, 4, 16, 1),
    1200: (49, 5, 23, 1),
    2016: (62, 6, 31, 1),
    3003: (76, 8, 38, 1),
    5049: (98, 10, 50, 1),
}
#: Most points of each contact.
MOST = {"constant": 5049, "unilateral": 3003}
#: Runs of each size, whose least time counts for each step; large ones run once.
REPEATS, ONCE = 3, 1200


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


def steps_of(contact, points):
    """Unknowns, processor time of each of some steps, s, shares of points that slip and press."""
    elements, least = FIRST_ORDER[points], np.inf
    system = plates(elements, 1, PERIOD, REACH, 1, contact, 4.5e3).system()
    advance, times = PythonStepper.advance, []

    def timed(*arguments):
        begin = time.process_time()
        done = advance(*arguments)
        times.append(time.process_time() - begin)
        return done

    for _ in range(1 if points > ONCE else REPEATS):
        times.clear()
        with (
            patch.object(PythonStepper, "advance", timed),
            patch.object(PythonStepper, "most_at_once", 1),
        ):
            run = sj.integrate(
                system, step=1.0 / 200.0 / PERIOD, n_steps=12, cycle_steps=PERIOD,
                save=sj.Save(fields=True),
            )  # fmt: skip
        least = np.minimum(least, times)
    slip = system.contact.slip_norm(system.contact.B @ run.v[-1])
    pressed = (system.contact.w if contact == "constant" else run.limits[-1]) > 0.0
    slipping = slip[pressed] > 0.0
    return system.n, least, float(slipping.mean()), np.count_nonzero(pressed) / points


def steps(arguments):
    """Table and picture of the time of steps over the number of points."""
    options = argparse.ArgumentParser(description=steps.__doc__)
    options.add_argument("--out", type=Path, required=True)
    options.add_argument("--to", type=int, default=max(FIRST_ORDER))
    given = options.parse_args(arguments)
    given.out.mkdir(parents=True, exist_ok=True)
    head(
        *("contact", "points", "unknowns", "slipping of pressed, %", "pressed, %"),
        *("CPU ms a step", "largest"),
    )
    measured = {}
    for contact, most in MOST.items():
        run(plates((4, 1, 2, 1), 1, PERIOD, REACH, 1, contact).system())
        for points in [size for size in FIRST_ORDER if size <= min(most, given.to)]:
            n, times, slipping, pressed = steps_of(contact, points)
            measured.setdefault(contact, {})[points] = 1e3 * times.mean()
            cells = [f"{100.0 * slipping:.0f}", f"{100.0 * pressed:.0f}"]
            cells += [f"{1e3 * value:.3g}" for value in (times.mean(), times.max())]
            row("opens" if contact == "unilateral" else contact, points, n, *cells)
    draw(measured, given.out / "contact_points.png")


def draw(measured, file):
    """Draw mean times of steps over the number of points."""
    mpl.use("Agg")
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(figsize=(7.0, 4.5), layout="constrained")
    names = {"constant": "constant contact", "unilateral": "contact that opens"}
    for contact, means in measured.items():
        axes.loglog([*means], [*means.values()], "o-", label=names[contact])
    axes.set(xlabel="contact points", ylabel="processor time of a step, ms")
    axes.grid(visible=True, which="both", alpha=0.3)
    axes.legend()
    figure.savefig(file, dpi=150)
    plt.close(figure)


def main(arguments):
    if arguments[:1] == ["steps"]:
        steps(arguments[1:])
        return
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
