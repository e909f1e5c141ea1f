"""Responses by harmonic balance beside time steps: two bolted plates, a fold, random systems.

    python examples/benchmarks/harmonic_response.py [PART ...] [--systems N] [--quick]

Parts are plates, fold and random, all if none is named. The plates are those of
``solid_lap_joint.toml`` with a free lower end, bent by a force there, with contact that opens: a
reduced model of 33 unknowns, up to full slip. *plates* compares its responses at four levels, with
at most 39 and 79 harmonics, with time steps, extrapolated from 800 and 1,600 in a period, which
have the same springs of sticking, start on the motion that harmonic balance found and forget it.
*fold* passes the turning points of an oscillator with a gap, beside time steps up and down.
*random* draws reduced systems with contact that opens and counts the points that harmonic balance
finds without marching. Times are of one thread's processor.
"""

import argparse
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

from benchmarks import cpu_seconds, head, row

# isort: split

import numpy as np

import skfem_joint as sj
from benchmarks.structures import STEEL, bent_lap
from skfem_joint.ground.progress import Tally, silent
from skfem_joint.harmonic.points import state_of
from skfem_joint.harmonic.response import STICKING
from skfem_joint.harmonic.search import Search
from skfem_joint.reduction.ranges.points import loaded_at
from skfem_joint.runs.integrate import integrate_plan
from skfem_joint.vibration.response import steady_plan, steady_point

#: Loads of the plates, N: from micro-slip to full slip; and frequencies, Hz.
LEVELS, BAND = (2.0, 8.0, 20.0, 40.0), (84.0, 89.0)
#: Periods that time steps follow from the motion of harmonic balance; the last third is used.
PERIODS = 160


@cache
def plates():
    """Reduced model of two bolted plates in bending, under 1 N."""
    system = bent_lap(1.0, 84.0)
    (curve,) = sj.backbone(system, modes=[1])
    return replace(sj.reduce(system, curve=curve), made_for="", origin=None)


def followed(system, frequency, level, start, steps, periods=PERIODS):
    """Amplitude (m) and friction energy (J) by time steps from a state, means of the last third."""
    loaded = loaded_at(system, frequency, level)
    plan = replace(steady_plan(loaded, steps), until="end", n_steps=periods * steps)
    run = integrate_plan(loaded, plan, initial=start)
    later = range(2 * periods // 3, periods)
    reach = [np.ptp(run.point_u[k * steps : (k + 1) * steps + 1, 0]) for k in later]
    return 0.5 * float(np.mean(reach)), float(np.mean(run.cycles.friction[-len(later) :]))


def settled(search, level, shares, finer=()):
    """Points of a level at shares of its largest amplitude: results, states, and seconds.

    Each is found with the search, then with each ``finer`` one.
    """
    branches, spent = cpu_seconds(search.branches, level)
    places = [item for item in branches[0] if not isinstance(item, sj.SteadyPoint)]
    each = spent / len(places)
    reach = np.array([np.linalg.norm(place.q[1:]) for place in places])
    for share in shares:
        place = places[int(np.abs(reach - share * reach.max()).argmin())]
        for one in (search, *finer):
            found, spent = cpu_seconds(one.settled, place, level, 0.0)
            state = state_of(found.forced.balance, found.place.q, found.place.omega)
            yield found, state, each, spent


def print_plates(quick, _systems):
    """Largest amplitude and half of it at each level beside time steps."""
    system, band = plates(), np.linspace(*BAND, 3 if quick else 7)
    search, *finer = (
        Search.of(system, band, STICKING, Tally(silent, 0), harmonics)
        for harmonics in ((39,) if quick else (39, 79))
    )
    head(
        *("load, N", "Hz", "amplitude, mm", "friction, mJ", "walks", "harmonics"),
        *("amplitude: off by %", "stated", "friction: off by %", "stated"),
        *("s a point of the branch", "s with all harmonics", "s by steps"),
    )
    for level in LEVELS[: 4 - 3 * quick]:
        for number, (one, state, *spent) in enumerate(
            settled(search, level, (1.0, 0.5)[: 2 - quick], finer)
        ):
            point = one.point
            if number % (1 + len(finer)) == 0:
                load = search.system, point.frequency, level, state
                (coarse, first), (fine, second) = (
                    cpu_seconds(followed, *load, n, 6 if quick else PERIODS)
                    for n in ((20, 40) if quick else (800, 1600))
                )
                steps = (4.0 * np.array(fine) - coarse) / 3.0
                by_steps = first + second
            else:
                by_steps = 0.0
            row(
                f"{level:g}", f"{point.frequency:.3f}", f"{1e3 * steps[0]:.4f}",
                f"{1e3 * steps[1]:.4f}", "yes" if one.forced.balance.walks else "no",
                one.forced.balance.series.highest,
                f"{100.0 * (point.amplitude[0] / steps[0] - 1.0):+.3f}",
                f"{100.0 * one.errors[0]:.3f}",
                f"{100.0 * (point.friction_energy / steps[1] - 1.0):+.2f}",
                f"{100.0 * one.errors[1]:.2f}",
                *(f"{x:.2f}" for x in (*spent, by_steps)),
            )  # fmt: skip


def oscillator():
    """Mass of 1 kg on 1 N/m, damped by 2 %, that meets a spring of 3 N/m at a gap of 1 m."""
    one = np.ones(1)
    normal = sj.NormalPart(np.eye(1), one, 0.0 * one, 3.0 * one, one)
    contact = sj.Contact(np.eye(1), [0.0], np.inf, normal=normal, gain=np.zeros((1, 1)))
    load = sj.AppliedLoad(one, sj.Harmonic(0.1, 0.1), "mass")
    return sj.System(np.eye(1), 0.04 * np.eye(1), np.eye(1), contact, (load,), np.eye(1), ("mass",))


def print_fold(quick, _systems):
    """Branches of an oscillator with a gap beside time steps from one frequency to the next."""
    system, frequencies = oscillator(), np.linspace(0.16, 0.2, 3 if quick else 9)
    (curve,) = sj.harmonic_response(system, frequencies, confirm=False)
    swept = []
    for way in (frequencies, frequencies[::-1]):
        state, reach = None, {}
        for frequency in way:
            point = steady_point(system, frequency, 1.0, 400, state)
            state, reach[frequency] = point.state, point.amplitude.max()
        swept.append(reach)
    head("Hz", "stable, m", "unstable, m", "steps, rising, m", "steps, falling, m")
    for frequency in frequencies:
        points = [p for p in curve.points if abs(p.frequency / frequency - 1.0) < 1e-9]
        reaches = [sorted(p.amplitude[0] for p in points if p.stable is x) for x in (True, False)]
        shown = [", ".join(f"{x:.4f}" for x in reach) for reach in reaches]
        row(f"{frequency:.3f}", *shown, *(f"{reach[frequency]:.4f}" for reach in swept))
    print(f"\nThe branch turns at {' and '.join(f'{f:.4f}' for f in curve.turns)} Hz.")


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
        mesh, STEEL, thickness=0.1, fixed_x=["right"],
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


def print_random(quick, systems):
    """Points of random reduced models found without marching, beside the search in time."""
    head(
        *("seed", "unknowns", "points", "marched", "turns", "unstable", "s a point", "why"),
        *("search in time, s", "amplitude apart, %", "friction apart, %"),
    )
    found = marched = 0
    costs, apart_all, reasons = [], [], []
    for seed in range(2 if quick else systems):
        system, frequency = drawn(seed)
        band = frequency * np.linspace(0.9, 1.1, 5)
        curves, spent = cpu_seconds(sj.harmonic_response, system, band, (0.5, 1.0), confirm=False)
        points = [point for curve in curves for point in curve.points]
        other, searched_in = cpu_seconds(steady_point, system, frequency, 1.0, 200)
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
        costs.append((spent / len(points), searched_in))
        apart_all.append(apart)
        reasons += [reason for curve in curves for reason in curve.why]
        row(
            seed, system.n, len(points), by_steps, sum(len(curve.turns) for curve in curves),
            sum(point.stable is False for point in points), f"{spent / len(points):.2f}",
            "; ".join(reason for curve in curves for reason in curve.why),
            f"{searched_in:.2f}" + "!" * (other.failure is not None), *(f"{x:.2g}" for x in apart),
        )  # fmt: skip
    (each, searched_in), off = np.median(costs, axis=0), np.array(apart_all)
    middle, most = np.nanmedian(off, axis=0), np.nanmax(off, axis=0)
    print(
        f"\nOf {found} points of {len(costs)} systems {100.0 * (1.0 - marched / found):.1f} % were "
        f"found without marching, at a median of {each:.2f} s each; the search in time takes "
        f"{searched_in:.2f} s and finds nothing in {np.isnan(off[:, 0]).sum()} systems. "
        f"Amplitudes are {middle[0]:.2g} % apart, {most[0]:.2g} % at most, friction energies "
        f"{middle[1]:.2g} % and {most[1]:.3g} %. What was lost: {'; '.join(reasons) or 'nothing'}."
    )


PARTS = {"plates": print_plates, "fold": print_fold, "random": print_random}


def main(arguments):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="few points and steps")
    parser.add_argument("--systems", type=int, default=40, help="random ones (default 40)")
    parser.add_argument("parts", nargs="*", metavar="PART", help=", ".join(PARTS))
    options = parser.parse_args(arguments)
    for part in options.parts or PARTS:
        PARTS[part](options.quick, options.systems)
        print()


if __name__ == "__main__":
    main(sys.argv[1:])
