"""Random vibration by backbones beside marching under sampled noise: a bar with a tip mass.

    python examples/benchmarks/noise.py            some ten minutes
    python examples/benchmarks/noise.py plate      a plate under two bolts, some minutes
    python examples/benchmarks/noise.py --quick    one level, a short time

The force on the tip has a flat density over the first mode alone, or over three modes. The full
model is marched, whose step costs a few microseconds, and at one level the reduced model. The force
on the plate's end acts along and across it, over its first two modes, which bend; a reduced model
of it is marched, of which the backbones are too. Errors of what is marched are standard deviations
by sixteen blocks of the time.
"""

import sys
import time
from dataclasses import replace
from pathlib import Path

sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

from benchmarks import EXAMPLES, head, row

# isort: split

import numpy as np

import skfem_joint as sj
from benchmarks.structures import tip_bar

#: Blocks of the time marched, and the part before them that is left out.
BLOCKS, LEFT_OUT = 16, 0.02
#: Modes, frequencies of the density (Hz), steps in a period of the highest mode, seconds, and
#: densities (N²/Hz).
CASES = {
    "one mode": ((1,), (300.0, 3000.0), 60, 40.0, (1e2, 1e4, 1e5, 5e5)),
    "three modes": ((1, 2, 3), (300.0, 13000.0), 30, 20.0, (1e3, 1e4, 1e5, 5e5)),
}
#: Density at which the reduced model is marched, and for how long, s.
REDUCED, SHORTER = 1e5, 5.0
#: Levels of the backbones: number, and the highest over that of slip as a whole.
LEVELS, UP_TO = 30, 4.0


class Noise(sj.Amplitude):
    """Sum of harmonics with random phases under a flat density."""

    def __init__(self, band, density, duration, seed):
        self.highest = band[1]
        count = int(2 ** np.ceil(np.log2(32.0 * duration * band[1])))  # so many in a period: 16
        step = duration / count
        frequency = np.fft.rfftfreq(count, step)
        inside = (frequency >= band[0]) & (frequency <= band[1])
        phase = np.exp(2j * np.pi * np.random.default_rng(seed).random(frequency.size))
        size = np.sqrt(0.5 * density * frequency[1]) * inside
        self.times, self.forces = step * np.arange(count), count * np.fft.irfft(size * phase, count)

    def _force(self, t):
        return np.interp(t, self.times, self.forces)

    @property
    def highest_frequency(self):
        """Of the density, Hz."""
        return self.highest

    @property
    def peak_value(self):
        """Largest force, N."""
        return float(np.abs(self.forces).max())


def marched(system, noise, step, duration):
    """Blocks of mean squares (m²) and of work an hour (J), largest displacement, and seconds."""
    loaded = replace(system, loads=(replace(system.loads[0], amplitude=noise),))
    block = int(duration / step) // BLOCKS
    begin = time.process_time()
    run = sj.integrate(
        loaded,
        step=step,
        n_steps=BLOCKS * block,
        cycle_steps=block,
        scheme=sj.generalized_alpha(0.9),
    )
    seconds = time.process_time() - begin
    u = run.point("free_end")
    squares = [part @ part / part.size for part in np.array_split(u[int(LEFT_OUT * u.size) :], 16)]
    works = 3600.0 * run.cycles.by_joint[1:].sum(axis=1) / (block * step)
    return np.array(squares), works, float(np.abs(u).max()), seconds


def mean(blocks):
    """Mean of blocks, and its standard deviation relative to it."""
    return float(blocks.mean()), float(blocks.std(ddof=1) / np.sqrt(blocks.size) / blocks.mean())


def apart(found, reference, error):
    """Text of a value beside a reference with its error, in per cent."""
    return f"{100.0 * (found / reference - 1.0):+.1f} ± {100.0 * error:.1f} %"


def heading():
    """Print the head of the comparison."""
    head(
        "density over",
        "N²/Hz",
        "damping of mode 1",
        "rms over slip as a whole",
        "rms marched, µm",
        "by backbones",
        "by the first mode alone",
        "work marched, kJ/h",
        "by backbones",
        "by the first mode alone",
        "largest marched, rms",
        "expected",
    )


def compared(title, system, curves, noise, psd, step, duration):
    """Print the row of a density; seconds of the response and of marching."""
    begin = time.process_time()
    found = sj.random_response(system, curves, psd, duration=duration)
    ours = time.process_time() - begin
    alone = sj.random_response(system, curves[:1], psd)
    squares, works, largest, seconds = marched(system, noise, step, duration)
    square, error = mean(squares)
    rms, error, (work, of_work) = np.sqrt(square), 0.5 * error, mean(works)
    own, done, first = found.displacement_rms[0], found.joint_work.sum(), curves[0]
    whole = abs(np.interp(first.slips_at, first.level, first.displacement[:, 0]))
    row(
        title,
        f"{psd[0][1]:g}",
        f"{100.0 * found.modes[0].damping_ratio:.2f} %",
        f"{rms / whole:.3f}",
        f"{1e6 * rms:.1f}",
        apart(own, rms, error),
        apart(alone.displacement_rms[0], rms, error),
        f"{1e-3 * work:.3g}",
        apart(done, work, of_work),
        apart(alone.joint_work.sum(), work, of_work),
        f"{largest / rms:.2f}",
        f"{found.displacement_peak[0] / own:.2f}",
    )
    return ours, seconds


def plate(quick):
    """Compare a plate under two bolts."""
    scene = sj.load_scene(EXAMPLES / "plate_bolts.toml").changed(
        damping={"ratio": 0.003}, load={"direction": [0.6, 0.8]}
    )
    system, band, duration = scene.system(), (100.0, 2500.0), 0.1 if quick else 5.0
    step = 1.0 / 1934.0 / 40.0  # in a period of the second mode
    noise = Noise(band, 1e3, 0.2, seed=3)
    loaded = replace(system, loads=(replace(system.loads[0], amplitude=noise),))
    # It serves any load of these modes and levels.
    small = replace(sj.reduce(loaded, modes=36, duration=0.1, step=step), made_for="")
    curves = sj.backbone(small, modes=(1, 2), levels=40, up_to=1.5)
    heading()
    for density in (30.0,) if quick else (30.0, 300.0):
        noise = Noise(band, density, duration, seed=3)
        psd = [[band[0], density], [band[1], density]]
        compared("two modes of a plate", small, curves, noise, psd, step, duration)


def main(arguments):
    quick = "--quick" in arguments
    if "plate" in arguments:
        plate(quick)
        return
    system, costs = tip_bar(40, 40, 2), []
    heading()
    for title, (modes, band, per_period, duration, densities) in CASES.items():
        duration = 2.0 if quick else duration
        begin = time.process_time()
        curves = sj.backbone(system, modes=modes, levels=LEVELS, up_to=UP_TO)
        of_curves = time.process_time() - begin
        step = 1.0 / curves[-1].stuck_frequency / per_period
        for density in densities[2:3] if quick else densities:
            psd = [[band[0], density], [band[1], density]]
            noise = Noise(band, density, duration, seed=2)
            ours, seconds = compared(title, system, curves, noise, psd, step, duration)
            ours += of_curves
            steps = duration / step
            costs.append((title, density, "full", system.n, steps, seconds, ours, 0.0, 0.0))
            if density == REDUCED:
                time_of = 0.2 if quick else min(SHORTER, duration)
                loaded = replace(system, loads=(replace(system.loads[0], amplitude=noise),))
                small = sj.reduce(loaded, modes=24, duration=0.05, step=step)
                squares, _, _, short = marched(small, noise, step, time_of)
                same, _, _, _ = marched(system, noise, step, time_of)
                off = np.sqrt(squares.mean() / same.mean()) - 1.0
                costs.append(
                    (title, density, "reduced", small.n, time_of / step, short, ours, off, time_of)
                )
    print()
    head(
        "density over",
        "N²/Hz",
        "model",
        "unknowns",
        "steps",
        "marching, s",
        "curves and response, s",
        "ratio",
        "ratio for as long as the full model",
        "rms off the full model's",
    )
    for title, density, model, unknowns, steps, seconds, ours, off, time_of in costs:
        longest = CASES[title][3] / time_of if time_of else 1.0
        row(
            title,
            f"{density:g}",
            model,
            unknowns,
            f"{steps:.3g}",
            f"{seconds:.3g}",
            f"{ours:.2f}",
            f"{seconds / ours:.0f}",
            f"{seconds * longest / ours:.0f}",
            f"{100.0 * off:+.2f} %" if model == "reduced" else "-",
        )


if __name__ == "__main__":
    main(sys.argv[1:])
