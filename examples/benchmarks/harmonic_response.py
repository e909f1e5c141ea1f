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
from scipy import linalg, sparse

import skfem_joint as sj
from benchmarks import EXAMPLES, head, row
from skfem_joint.ground.progress import Tally, silent
from skfem_joint.harmonic.points import state_of
from skfem_joint.harmonic.response import STICKING
from skfem_joint.harmonic.search import Search

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


def searched(system, frequencies, levels, sticking=STICKING):
    """Settled points of each level, and what finds them: pairs of results and states."""
    search = Search.of(system, np.asarray(frequencies), sticking, Tally(silent, 0))
    found = {}
    for level in levels:
        items, why = search.branches(level)
        most, found[level] = 0.0, []
        for item in items:
            if isinstance(item, sj.SteadyPoint):
                found[level].append((item, None))
                continue
            settled = search.settled(item, level, most)
            most = max(most, settled.point.friction_energy)
            balance = search.forced[settled.rung].balance
            state = state_of(balance, settled.place.q, settled.place.omega)
            found[level].append((settled.point, state))
        for reason in why:
            print(f"level {level:g}: {reason}")
    return search.system, found


def print_plates(quick):
    """Largest amplitude and two others of each level beside time steps."""
    begin = time.process_time()
    system, found = searched(plates(), np.linspace(*BAND, 3 if quick else 7), LEVELS[: 4 - 3 * quick])
    spent = time.process_time() - begin
    count = sum(len(points) for points in found.values())
    marched = sum(state is None for points in found.values() for _, state in points)
    print(f"{count} points, {marched} of them marched to, {spent / count:.2f} s a point\n")
    head(
        *("load, N", "Hz", "amplitude, mm", "friction, mJ", "amplitude by 800 steps, off by %"),
        *("friction, off by %", "error of 400 steps, %", "s by steps"),
    )
    for level, points in found.items():
        known = [k for k, (_, state) in enumerate(points) if state is not None]
        reach = np.array([points[k][0].amplitude[0] for k in known])
        for share in (1.0, 0.5) if not quick else (1.0,):
            point, state = points[known[int(np.abs(reach - share * reach.max()).argmin())]]
            begin = time.process_time()
            at = system, point.frequency, level, state
            fine, coarse = (followed(*at, steps) for steps in ((40, 20) if quick else (800, 400)))
            off = [100.0 * (a / b - 1.0) for a, b in zip(
                (point.amplitude[0], point.friction_energy), fine, strict=True)]  # fmt: skip
            row(
                f"{level:g}", f"{point.frequency:.3f}", f"{1e3 * fine[0]:.4f}",
                f"{1e3 * fine[1]:.4f}", f"{off[0]:+.3f}", f"{off[1]:+.2f}",
                f"{100.0 * (coarse[1] / fine[1] - 1.0):+.2f}", f"{time.process_time() - begin:.0f}",
            )  # fmt: skip


def print_springs(quick):
    """Friction energy at 84 Hz and 40 N by springs, steps and laws."""
    small = plates()
    head("friction", "harmonic balance, mJ", *(f"{n} steps" for n in (200, 400, 800)))
    state = None
    for factor in (30.0,) if quick else (3.0, 30.0, 300.0):
        system, found = searched(small, (84.0, 84.5), (40.0,), factor)
        point, state = found[40.0][0]
        energies = [
            followed(system, 84.0, 40.0, state, steps)[1]
            for steps in ((20,) if quick else (200, 400, 800))
        ]
        row(f"springs of {factor:g}", *(f"{1e3 * e:.2f}" for e in (point.friction_energy, *energies)))
    energies = [
        followed(small, 84.0, 40.0, state, steps)[1] for steps in ((20,) if quick else (200, 400, 800))
    ]
    row(f"arctan, beta {small.contact.beta.max():.2g} s/m", "", *(f"{1e3 * e:.2f}" for e in energies))


def drawn(seed):
    """Random small system with contact that opens: bodies of modes on points that rub."""
    rng = np.random.default_rng(seed)
    n, m = int(rng.integers(4, 13)), int(rng.integers(2, 13))
    shapes = linalg.qr(rng.standard_normal((n, n)))[0]
    omega = 2.0 * np.pi * 100.0 * np.cumsum(rng.uniform(0.6, 2.5, n))
    K = shapes * omega**2 @ shapes.T
    ratio = 10.0 ** rng.uniform(-3.0, -1.7)
    C = shapes * (2.0 * ratio * omega) @ shapes.T
    N, B = rng.standard_normal((2, m, n)) / np.sqrt(n)
    stiffness = float(np.median(omega)) ** 2 * 10.0 ** rng.uniform(0.0, 1.5) * np.ones(m)
    force = np.where(rng.random(m) < 0.8, rng.uniform(0.2, 2.0, m), 0.0)
    gap = np.where(force > 0.0, 0.0, rng.uniform(0.0, 1.0, m) / stiffness)
    normal = sj.NormalPart(N, gap, force, stiffness, np.ones(m))
    gain = sparse.csr_array(rng.uniform(0.2, 0.6) * np.eye(m))
    contact = sj.Contact(B, np.zeros(m), np.inf, normal=normal, gain=gain)
    vector = rng.standard_normal(n)
    loads = (sj.AppliedLoad(vector, sj.Harmonic(1.0, 100.0), "load"),)
    return sj.System(np.eye(n), C, K, contact, loads, vector[np.newaxis], ("point",))


def print_random(quick):
    """Points found without marching, of random systems at loads up to full slip."""
    head("seed", "unknowns", "points", "marched", "turns", "unstable", "s a point", "worst apart, %", "why")
    found = marched = 0
    for seed in range(3 if quick else 40):
        system, begin = drawn(seed), time.process_time()
        stuck = np.sqrt(linalg.eigh(
            system.closed().K, system.M, eigvals_only=True, subset_by_index=(0, 0)))[0]  # fmt: skip
        band = np.linspace(0.7, 1.15, 8) * stuck / (2.0 * np.pi)
        static = float(system.loads[0].vector @ linalg.solve(system.K, system.loads[0].vector))
        limit = float(system.contact.w.sum()) / np.abs(system.contact.B @ linalg.solve(
            system.K, system.loads[0].vector)).sum() / float(np.median(np.diag(system.K)))  # fmt: skip
        del static
        curves = sj.harmonic_response(system, band, limit * np.array([0.03, 0.3, 3.0]), confirm=quick)
        spent = time.process_time() - begin
        points = [point for curve in curves for point in curve.points]
        by_steps = sum(point.periods > 0 for point in points)
        found, marched = found + len(points), marched + by_steps
        apart = [max(x) for curve in curves for x in curve.confirmed.values()]
        row(
            seed, system.n, len(points), by_steps, sum(len(curve.turns) for curve in curves),
            sum(point.stable is False for point in points), f"{spent / len(points):.2f}",
            f"{100.0 * max(apart, default=np.nan):.2g}",
            "; ".join(reason for curve in curves for reason in curve.why),
        )  # fmt: skip
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
