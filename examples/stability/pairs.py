"""Steady vibration of pairs of plates beside marching from rest; friction alone holds one plate.

    python examples/stability/pairs.py [--count 48] [--seed 0]

Two plates in plan view overlap. One is held at its far end, the other is pulled at its far end by a
harmonic load, along the plates or at an angle. Force, frequency, damping ratio, coefficient of
friction and lengths are drawn; steps are 50, 52, 60, 100 a period in turn. The friction is
Coulomb's, so that the loaded plate stays where its transient leaves it. Half of the peak-to-peak
displacement of its end must be that of marching from rest within 0.1 %. Offsets are printed beside
each other: they depend on how the vibration began. The exit status is 1 where an amplitude is
further off, a search fails, or marching does not settle. (One core: about twenty minutes for most
pairs, as long again for a pair that settles slowly.)
"""

import argparse
import sys
from pathlib import Path
from typing import NamedTuple

sys.path.insert(0, str(Path(__file__).parents[1]))

from benchmarks import head, row  # pins BLAS to one thread

# isort: split

import numpy as np

import skfem_joint as sj

WIDTH, LAP, PRESSURE = 0.04, 0.1, 8e6  # m, m, Pa
STEPS = (50, 52, 60, 100)
#: Largest relative difference of the amplitudes, with what marching may still change by; and the
#: relative change at which marching ends.
ALLOWED, SETTLED = 1e-3, 1e-4


class Pair(NamedTuple):
    """One pair of plates and its load."""

    steps: int
    share: float  # of the friction limit, the load's force
    frequency: float  # Hz
    ratio: float  # of the critical damping
    friction: float
    arm: float  # length beside the joint of each plate, m
    angle: float  # of the load to the plates, rad

    def system(self):
        """System whose first point is the loaded end along the load."""
        long = max(2, round(self.arm / 0.03))
        lower = sj.build_plate(
            [("lower_arm", self.arm, long), ("lower_lap", LAP, 4)], WIDTH, 2, prefix="lower_"
        )
        upper = sj.build_plate(
            [("upper_lap", LAP, 4), ("upper_arm", self.arm, long)], WIDTH, 2, prefix="upper_",
            origin=(self.arm, 0.0),
        )  # fmt: skip
        joint = sj.Joint("upper_lap", PRESSURE, self.friction, against="lower_lap", beta=np.inf)
        structure = sj.Structure(
            sj.merged([lower, upper]),
            sj.Material(E=210e9, density=7800.0, poisson=0.3),
            joints=[joint],
            thickness=0.01,
            fixed=["lower_left"],
            damping_ratio=self.ratio,
        )
        force = self.share * self.friction * PRESSURE * LAP * WIDTH
        direction = float(np.cos(self.angle)), float(np.sin(self.angle))
        load = sj.Load("upper_right", sj.Harmonic(force, self.frequency), direction)
        return structure.system([load])


def draw(count, seed=0):
    """Draw ``count`` pairs."""
    generator = np.random.default_rng(seed)
    for k in range(count):
        yield Pair(
            steps=STEPS[k % len(STEPS)],
            share=float(np.exp(generator.uniform(*np.log([0.3, 6.0])))),
            frequency=float(np.exp(generator.uniform(*np.log([300.0, 3000.0])))),
            ratio=float(np.exp(generator.uniform(*np.log([2e-3, 2e-2])))),
            friction=float(generator.uniform(0.2, 0.8)),
            arm=float(generator.uniform(0.08, 0.3)),
            angle=float(generator.choice([0.0, 0.0, 0.4])),
        )


class Marched(NamedTuple):
    """Vibration that marching from rest leads to."""

    amplitude: float  # half of peak to peak, m
    offset: float  # mean of both peaks, m
    periods: int
    changing: float  # by how much the amplitude may still change, relative


def marched(system, steps):
    """March from rest until the amplitude has settled, for 100 periods at first and 6400 at most.

    So many may be needed: between two steps friction does not see a body's mean velocity, which may
    die away by the damping of its mass alone.
    """
    periods = 100
    while True:
        run = sj.integrate(system, cycles=periods, steps_per_cycle=steps)
        quarters = [run.point_u[k * periods // 4 * steps :][: steps + 1, 0] for k in (2, 3)]
        quarters.append(run.point_u[-steps - 1 :, 0])
        sizes = [0.5 * np.ptp(u) for u in quarters]
        before, last = np.abs(np.diff(sizes))
        rest = last  # of a geometric series, or nothing but round-off
        if last > 1e-6 * sizes[-1]:
            rest = last * max(1.0, last / (before - last)) if last < before else np.inf
        changing = float(rest / sizes[-1])
        if changing <= SETTLED or periods >= 6400:
            middle = 0.5 * (quarters[-1].max() + quarters[-1].min())
            return Marched(float(sizes[-1]), float(middle), periods, changing)
        periods *= 2


def main(arguments, allowed=ALLOWED):
    """Compare pairs; returns 1 if any amplitude is not that of marching."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=48)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args(arguments)
    head(
        *("steps", "share", "Hz", "ratio", "friction", "arm, mm", "angle", "periods", "marched"),
        *("amplitude, um", "apart, %", "offset, um", "of marching", ""),
    )
    good, largest = 0, 0.0
    for pair in draw(options.count, options.seed):
        system = pair.system()
        try:
            vibration = sj.integrate(system, until="steady", steps_per_cycle=pair.steps).vibration
            other = marched(system, pair.steps)
        except sj.ConvergenceError as error:
            print(f"{pair}: {error}", flush=True)
            continue
        apart = vibration.amplitude[0] / other.amplitude - 1.0
        holds = abs(apart) + other.changing <= allowed
        good, largest = good + holds, max(largest, abs(apart))
        judgement = "UNSETTLED" if other.changing > SETTLED else "WRONG"
        row(
            *(pair.steps, f"{pair.share:.3g}", f"{pair.frequency:.0f}", f"{pair.ratio:.2g}"),
            *(f"{pair.friction:.2f}", f"{1e3 * pair.arm:.0f}", f"{pair.angle:.1f}"),
            *(vibration.periods, other.periods, f"{1e6 * vibration.amplitude[0]:.4f}"),
            *(f"{100 * apart:+.4f}", f"{1e6 * vibration.offset[0]:.4f}"),
            *(f"{1e6 * other.offset:.2f}", "" if holds else judgement),
        )
    print(f"{good} of {options.count} amplitudes are those of marching within {100 * allowed:g} %, "
          f"the largest difference is {100 * largest:.2g} %.")  # fmt: skip
    return int(good < options.count)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
