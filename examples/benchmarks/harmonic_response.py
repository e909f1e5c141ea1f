"""Responses by harmonic balance beside time steps: two bolted plates, a fold, random systems.

    python examples/benchmarks/harmonic_response.py [PART ...] [--quick]

Parts are plates, springs and random, all if none is named. The plates are those of
``solid_lap_joint.toml`` with a free lower end, bent by a force there, with contact that opens: a
reduced model of 33 unknowns, up to full slip. *plates* compares its responses at four levels with
time steps of 800 in a period, which have the same springs of sticking and start on the motion that
harmonic balance found; those with 400 steps show the error of the step. *springs* shows at one
frequency what the springs, the step and the law of friction do to the friction energy. *random*
draws reduced systems with contact that opens and counts the points that harmonic balance finds
without marching. Times are of one thread's processor.
"""

import os

os.environ |= dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")

import argparse
import sys
import time
from dataclasses import replace
from functools import cache
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np

import skfem_joint as sj
from benchmarks import EXAMPLES, head, row
from skfem_joint.ground.progress import Tally, silent
from skfem_joint.harmonic.points import state_of
from skfem_joint.harmonic.response import STICKING
from skfem_joint.harmonic.search import Search
from skfem_joint.vibration.response import steady_point

#: Loads of the plates, N: from micro-slip to full slip; and frequencies, Hz.
LEVELS, BAND = (2.0, 8.0, 20.0, 40.0), (84.0, 89.0)
#: Periods that time steps follow from the motion of harmonic balance; the last half is used.
PERIODS = 40


@cache
def plates():
    """Reduced model of two bolted plates in bending, under 1 N."""
    structure = sj.load_scene(EXAMPLES / "solid_lap_joint.toml").structure()
    joints = [replace(joint, contact="unilateral") for joint in structure.joints]
    structure = replace(structure, joints=joints, fixed_y=[], fixed_z=[])
    load = sj.Load("lower_end", sj.Harmonic(1.0, 84.0), (0.0, 0.0, 1.0))
    system = structure.system([load])
    (curve,) = sj.backbone(system, modes=[1])
    return replace(sj.reduce(system, curve=curve), made_for="", origin=None)


def followed(system, frequency, level, start, steps, periods=PERIODS):
    """Amplitude (m) and friction energy (J) by time steps from a state, means of the last half."""
    loads = [
        replace(x, amplitude=sj.Harmonic(level * x.amplitude.amplitude, frequency))
        for x in system.loads
    ]
    run = sj.integrate(
        replace(system, loads=tuple(loads)), cycles=periods, steps_per_cycle=steps, initial=start,
        scheme=sj.generalized_alpha(1.0),
    )  # fmt: skip
    later = range(periods // 2, periods)
    reach = [np.ptp(run.point_u[k * steps : (k + 1) * steps + 1, 0]) for k in later]
    return 0.5 * float(np.mean(reach)), float(np.mean(run.cycles.friction[-len(later) :]))


def settled(search, level, shares):
    """Points of a level at shares of its largest amplitude: results, states, and seconds."""
    begin = time.process_time()
    places = [item for item in search.branches(level)[0] if not isinstance(item, sj.SteadyPoint)]
    each, begin = (time.process_time() - begin) / len(places), time.process_time()
    reach = np.array([np.linalg.norm(place.q) for place in places])
    found = []
    for share in shares:
        one = search.settled(places[int(np.abs(reach - share * reach.max()).argmin())], level, 0.0)
        balance = search.forced[one.rung].balance
        state = state_of(balance, one.place.q, one.place.omega)
        now = time.process_time()
        found.append((one.point, state, each, now - begin))
        begin = now
    return found


def print_plates(quick):
    """Largest amplitude and half of it at each level beside time steps."""
    system = plates()
    search = Search.of(system, np.linspace(*BAND, 3 if quick else 7), STICKING, Tally(silent, 0))
    head(
        *("load, N", "Hz", "amplitude, mm", "friction, mJ", "gross slip", "amplitude, off by %"),
        *("friction, off by %", "400 steps, off by %", "s a point of the branch"),
        *("s with all harmonics", "s by 800 steps"),
    )
    for level in LEVELS[: 4 - 3 * quick]:
        for point, state, *spent in settled(search, level, (1.0, 0.5)[: 2 - quick]):
            at, begin = (search.system, point.frequency, level, state), time.process_time()
            fine = followed(*at, 40 if quick else 800)
            by_steps = time.process_time() - begin
            coarse = followed(*at, 20 if quick else 400)
            row(
                f"{level:g}", f"{point.frequency:.3f}", f"{1e3 * fine[0]:.4f}",
                f"{1e3 * fine[1]:.4f}", point.gross,
                f"{100.0 * (point.amplitude[0] / fine[0] - 1.0):+.3f}",
                f"{100.0 * (point.friction_energy / fine[1] - 1.0):+.2f}",
                f"{100.0 * (coarse[1] / fine[1] - 1.0):+.2f}",
                *(f"{x:.2f}" for x in (*spent, by_steps)),
            )  # fmt: skip
            sys.stdout.flush()


def print_springs(quick):
    """Friction energy at 84 Hz and 40 N by springs, steps and laws."""
    small = plates()
    head("friction", "harmonic balance, mJ", *(f"{n} steps" for n in (200, 400, 800)))
    state = None
    for factor in (3000.0,) if quick else (300.0, 3000.0, 30000.0):
        search = Search.of(small, np.array([84.0, 84.5]), factor, Tally(silent, 0))
        ((point, state, *_),) = settled(search, 40.0, (0.0,))
        energies = [
            followed(search.system, 84.0, 40.0, state, steps)[1]
            for steps in ((20,) if quick else (200, 400, 800))
        ]
        row(
            f"springs of {factor:g}",
            *(f"{1e3 * e:.2f}" for e in (point.friction_energy, *energies)),
        )
    energies = [
        followed(small, 84.0, 40.0, state, steps)[1]
        for steps in ((20,) if quick else (200, 400, 800))
    ]
    row(
        f"arctan, beta {small.contact.beta.max():.2g} s/m",
        "",
        *(f"{1e3 * e:.2f}" for e in energies),
    )


def drawn(seed):
    """Reduced model of a random block that is lifted and pushed at one side, and its frequency."""
    rng = np.random.default_rng(seed)
    length, height = rng.uniform(0.06, 0.12), rng.uniform(0.02, 0.05)
    sides = {"base": "bottom", "left": "left", "right": "right"}
    mesh = sj.build_plate(
        [("block", length, int(rng.integers(8, 13)))], height, 3, boundaries=sides
    )
    pressure = 10.0 ** rng.uniform(6.5, 8.0)
    structure = sj.Structure(
        mesh, sj.Material(E=200e9, density=8000.0, poisson=0.3), thickness=0.1, fixed_x=["right"],
        joints=[sj.Joint("base", pressure, rng.uniform(0.2, 0.8), contact="unilateral")],
        stiffness_damping=10.0 ** rng.uniform(-7.0, -6.0),
    )  # fmt: skip
    pressed, frequency = pressure * length * 0.1, rng.uniform(1e3, 8e3)
    loads = [
        sj.Load("left", sj.Harmonic(share * pressed, frequency), direction=way)
        for share, way in (
            (rng.uniform(0.02, 0.15), (0.0, 1.0)),
            (rng.uniform(0.1, 0.5), (1.0, 0.0)),
        )
    ]
    system = structure.system(loads, points=["left"])
    return sj.reduce(system, modes=8, frequency=frequency, level=1.0), frequency


def print_random(quick):
    """Points of random reduced models found without marching, beside the search in time."""
    head(
        *("seed", "unknowns", "points", "marched", "turns", "unstable", "s a point", "why"),
        *("search in time, s", "amplitude apart, %", "friction apart, %"),
    )
    found = marched = 0
    for seed in range(2 if quick else 40):
        system, frequency = drawn(seed)
        band, begin = frequency * np.linspace(0.9, 1.1, 5), time.process_time()
        curves = sj.harmonic_response(system, band, (0.5, 1.0), confirm=False)
        spent, begin = time.process_time() - begin, time.process_time()
        points = [point for curve in curves for point in curve.points]
        other = steady_point(system, frequency, 1.0, 200)
        searched_in = time.process_time() - begin
        f = curves[1].column("frequency")
        ours = curves[1].points[int(np.abs(f - frequency).argmin())]
        apart = [
            100.0 * abs(a / b - 1.0)
            for a, b in (
                (ours.amplitude.max(), other.amplitude.max()),
                (ours.friction_energy, other.friction_energy),
            )
        ]
        by_steps = sum(point.periods > 0 or point.failure is not None for point in points)
        found, marched = found + len(points), marched + by_steps
        row(
            seed, system.n, len(points), by_steps, sum(len(curve.turns) for curve in curves),
            sum(point.stable is False for point in points), f"{spent / len(points):.2f}",
            "; ".join(reason for curve in curves for reason in curve.why),
            f"{searched_in:.2f}" + "!" * (other.failure is not None), *(f"{x:.2g}" for x in apart),
        )  # fmt: skip
        sys.stdout.flush()
    print(f"\n{found} points, {100.0 * (1.0 - marched / found):.1f} % without marching")


PARTS = {"plates": print_plates, "springs": print_springs, "random": print_random}


def main(arguments):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="few points and steps")
    parser.add_argument("parts", nargs="*", metavar="PART", help=", ".join(PARTS))
    options = parser.parse_args(arguments)
    for part in options.parts or PARTS:
        PARTS[part](options.quick)
        print()


if __name__ == "__main__":
    main(sys.argv[1:])
