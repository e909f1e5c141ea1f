"""Nonlinear modes into gross slip, beside published figures, quasi-static curves and ring-downs.

    python examples/benchmarks/nonlinear_modes.py beam       the public benchmark, seconds
    python examples/benchmarks/nonlinear_modes.py bar        joints: bar, lap or brake_reuss, some
                                                             minutes each
    python examples/benchmarks/nonlinear_modes.py estimates  stated errors of random systems beside
                                                             true ones, some minutes

The virtual friction-damped beam is a public benchmark: an Euler-Bernoulli beam of 0.71 m x 60 mm x
50 mm, clamped and free, of 15 nodes, with a Jenkins element at node 6, reduced to 3 modes with that
node fixed, and 1 % of viscous damping of the stuck modes. The others are a bar with a tip mass, the
shipped lap of solids with contact that opens, bent by its free end, and the Brake-Reuss beam with
constant contact, all reduced.

The decrement of a ring-down is another damping ratio where a joint is soft. It is compared with
that by which the loss of a steady cycle takes away the energy that the mode has as it turns round.
The frequency of a slow curve is that of the force at its peak; compared is that of the first
harmonic of the force, as steady vibration has it.
"""

import sys
from dataclasses import replace
from pathlib import Path

sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

from benchmarks import cpu_seconds, head, row

# isort: split

import numpy as np
from scipy import linalg
from scipy.interpolate import PchipInterpolator

import skfem_joint as sj
from benchmarks.brake_reuss import beam
from benchmarks.structures import bent_lap, tip_bar
from skfem_joint.ground.arrays import as_dense
from skfem_joint.ground.errors import ConvergenceError
from skfem_joint.ground.progress import Tally, silent
from skfem_joint.harmonic.balance import MOST, Balance
from skfem_joint.harmonic.levels import Levels, relative, resolved
from skfem_joint.harmonic.mode_equations import ModeEquations
from skfem_joint.harmonic.modes import FACTORS, FLOOR
from skfem_joint.harmonic.series import FourierSeries
from skfem_joint.study.backbone_peaks import first_harmonic

#: First harmonic of the beam's tip (m), frequency (Hz) and damping ratio (%), as published.
TIP = 1e-6 * np.array([6.34, 10.05, 15.76, 24.77, 39.06, 61.76, 97.73, 154.8, 388.6])
FREQUENCY = (80.368, 80.143, 76.055, 72.414, 70.364, 69.258, 68.624, 68.290, 68.041)
DAMPING = (1.000, 1.929, 5.773, 6.465, 5.461, 4.269, 3.312, 2.601, 1.779)


def friction_beam(spring=1e7, limit=15.0):
    """System of the virtual beam."""
    nodes, node, length, width, height = 15, 6, 0.71, 0.06, 0.05
    bending, mass = 141.225e9 * width * height**3 / 12.0, 7850.0 * width * height
    h, n = length / (nodes - 1), 2 * nodes
    K, M = np.zeros((n, n)), np.zeros((n, n))
    ends, turn = [12.0, 6 * h, -12.0, 6 * h], [6 * h, 4 * h * h, -6 * h, 2 * h * h]
    k = np.array([ends, turn, [-x for x in ends], [6 * h, 2 * h * h, -6 * h, 4 * h * h]])
    m = np.array(
        [
            [156.0, 22 * h, 54.0, -13 * h],
            [22 * h, 4 * h * h, 13 * h, -3 * h * h],
            [54.0, 13 * h, 156.0, -22 * h],
            [-13 * h, -3 * h * h, -22 * h, 4 * h * h],
        ]
    )
    for e in range(nodes - 1):
        own = slice(2 * e, 2 * e + 4)
        K[own, own] += bending / h**3 * k
        M[own, own] += mass * h / 420.0 * m
    K, M = K[2:, 2:], M[2:, 2:]
    held = 2 * (node - 2)
    free = np.delete(np.arange(n - 2), held)
    inner = K[np.ix_(free, free)]
    fixed = linalg.eigh(inner, M[np.ix_(free, free)], subset_by_index=(0, 2))[1]
    T = np.zeros((n - 2, 4))
    T[held, 0], T[free, 1:], T[free, 0] = 1.0, fixed, -np.linalg.solve(inner, K[free, held])
    K, M, B = T.T @ K @ T, T.T @ M @ T, T[held : held + 1]
    squares, shapes = linalg.eigh(K + spring * B.T @ B, M)
    C = M @ shapes @ np.diag(0.02 * np.sqrt(squares)) @ shapes.T @ M
    contact = sj.Contact(B, [limit], np.inf, stiffness=np.array([spring]))
    return sj.System(M, C, K, contact, P=T[-2:-1], points=("tip",))


#: By name: title, full model and number of its mode, and cycles of a ring-down from the highest
#: amplitude.
JOINTS = {
    "bar": ("bar with a tip mass", lambda: tip_bar(100, 90, 4), 1, 60),
    "lap": ("lap that opens", lambda: bent_lap(40.0, 84.0), 1, 120),
    "brake_reuss": (
        "Brake-Reuss beam", lambda: beam("constant").system(points=["upper_end"]), 7, 50,
    ),
}  # fmt: skip


def published():
    """The virtual beam beside its published figures."""
    system = friction_beam()
    sj.nonlinear_modes(system, amplitudes=TIP[:2], confirm=False)  # compiles
    (mode,), seconds = cpu_seconds(sj.nonlinear_modes, system, amplitudes=TIP, confirm=False)
    head("tip, um", "Hz", "published", "apart", "damping, %", "published", "apart", "stated")
    values = mode.frequency, FREQUENCY, 100.0 * mode.damping_ratio, DAMPING
    stated = 100.0 * mode.error("damping_ratio")
    for a, f, f0, d, d0, error in zip(1e6 * TIP, *values, stated, strict=True):
        row(
            f"{a:.4g}", f"{f:.3f}", f"{f0:.3f}", f"{100 * (f / f0 - 1):+.3f} %",
            f"{d:.3f}", f"{d0:.3f}", f"{100 * (d / d0 - 1):+.2f} %", f"{error:.2g} %",
        )  # fmt: skip
    series = mode.series
    print(
        f"\nThe curve takes {seconds:.2g} s, compiled, with {series.highest} harmonics and "
        f"{series.samples} samples.\n"
    )


def largest(apart, rows):
    """Largest of relative differences at some levels, %."""
    found = 100.0 * np.abs(apart[rows])
    return f"{np.nanmax(found):.2g} %" if np.isfinite(found).any() else ""


def beside(x, xs, ys):
    """Values at x of a curve over xs, on a logarithmic axis; nan outside."""
    order = np.argsort(xs)
    return PchipInterpolator(np.log(xs[order]), ys[order], extrapolate=False)(np.log(x))


def compared(joint):
    """A row for a structure: its mode beside the slow curve, a ring-down, and time steps."""
    title, made, number, cycles = JOINTS[joint]
    full = made()
    (curve,) = sj.backbone(full, modes=[number], levels=77, up_to=0.9)
    model = sj.reduce(full, curve=curve)
    point = int(curve.displacement[-1].argmax())
    reach = curve.displacement[:, point]
    amplitudes = np.concatenate(
        [np.geomspace(reach[8], reach[-1], 8), reach[-1] * np.geomspace(1.2, 5.0, 6)]
    )
    (mode,), seconds = cpu_seconds(
        sj.nonlinear_modes, model, modes=[number], amplitudes=amplitudes, at=model.points[point]
    )
    start = mode.motion(-1)[0]
    down = sj.ring_down(model, mode, cycles, 400, start=(start, 0.0 * start))
    seen, decrement = mode.displaced, mode.decrement
    apart = {}
    slow = {"frequency": first_harmonic(curve) * curve.frequency}
    slow["damping_ratio"] = curve.damping_ratio
    for name, own in (("frequency", mode.frequency), ("damping_ratio", decrement)):
        apart[name] = (
            beside(amplitudes, reach, slow[name]) / getattr(mode, name) - 1.0,
            beside(seen, down.amplitude, getattr(down, name)) / own - 1.0,
        )
    micro, peak = amplitudes <= 0.25 * reach[-1], int(mode.damping_ratio.argmax())
    near = np.abs(np.arange(amplitudes.size) - peak) <= 1
    cells = [title, model.n, model.contact.count, amplitudes.size, f"{seconds:.0f}"]
    cells += [f"{mode.series.highest}, {mode.series.samples}"]
    for rows, which in ((micro, 0), (~near, 1), (near, 1)):
        cells += [f"{largest(apart[name][which], rows)}" for name in apart]
    marched = (largest(getattr(mode.marched, name), slice(None)) for name in apart)
    stated = (f"{100 * mode.error(name).max():.2g} %" for name in apart)
    row(*cells, ", ".join(marched), ", ".join(stated))


def beam_of(rng):
    """Virtual beam with another spring and damping, in its first or second mode."""
    system = friction_beam(10.0 ** rng.uniform(6.3, 8.3))
    damped = replace(system, C=10.0 ** rng.uniform(-1.3, 0.0) * system.C)
    return damped, int(rng.integers(1, 3)), 6e-6, 4e-4


def chain_of(rng):
    """Masses on springs, the last one heavy, up to three of them on friction."""
    n, m = int(rng.integers(4, 9)), int(rng.integers(1, 4))
    k = 10.0 ** rng.uniform(-0.3, 0.3, n + 1)
    k[m] *= 3.0
    K = np.diag(k[:-1] + k[1:]) - np.diag(k[1:-1], 1) - np.diag(k[1:-1], -1)
    K[-1, -1] = k[-2]
    M = np.diag(10.0 ** rng.uniform(-0.3, 0.3, n))
    M[-1, -1] = 10.0 ** rng.uniform(1.0, 2.0)
    springs = 10.0 ** rng.uniform(0.0, 1.0, m)
    contact = sj.Contact(np.eye(n)[:m], rng.uniform(0.3, 1.0, m), np.inf, stiffness=springs)
    damping = 10.0 ** rng.uniform(-2.5, -1.5) * K
    return sj.System(M, damping, K, contact, P=np.eye(n)[-1:], points=("end",)), 1, 1.0, 10.0


def block_of(rng):
    """Four masses, one of which slides on a spring, another on a stop that opens."""
    n, one = 4, np.ones(1)
    A = rng.normal(size=(n, n))
    K, M = np.diag(10.0 ** rng.uniform(0.0, 1.0, n)) + 0.15 * A @ A.T, np.eye(n)
    M[0, 0] = 8.0
    P, N = np.eye(n)[:1], np.eye(n)[1:2]
    normal = sj.NormalPart(N, 0.0 * one, one, rng.uniform(1.0, 8.0) * one, one)
    gain, spring = rng.uniform(0.2, 0.8, (1, 1)), rng.uniform(1.0, 8.0, 1)
    B = P - np.eye(n)[2:3]
    contact = sj.Contact(B, [0.0], np.inf, stiffness=spring, normal=normal, gain=gain)
    return sj.System(M, 0.01 * K, K, contact, P=P, points=("mass",)), 1, 0.15, 3.0


#: Random systems: how each is drawn, with its mode and lowest and highest amplitude.
DRAWN = {"virtual beam": beam_of, "chain": chain_of, "contact that opens": block_of}


def finer(system, mode):
    """Frequency (Hz) and damping ratio with eight times the mode's harmonics and 4,096 samples.

    They are four times as many where eight times are too many, and 63 at least.
    Levels that are not found so are nan. All friction has springs of its own.
    """
    point, first = system.points.index(mode.point), mode.series
    looked_at = as_dense(system.P)[point]
    moved, stuck = float(looked_at @ mode.shape), 2.0 * np.pi * mode.stuck_frequency
    coarse = Balance.of(system, FourierSeries(1, 16, first.odd), stuck, FACTORS[-1])
    fine = FourierSeries(max(63, 8 * first.highest + 7), 4096, first.odd)
    if coarse.size(fine) > MOST:
        fine = FourierSeries(max(63, 4 * first.highest + 3), 4096, first.odd)
    first, fine = (
        ModeEquations(
            replace(coarse, series=series), mode.mode, mode.shape, np.sign(moved) * looked_at,
            1.0 / abs(moved), point,
        )
        for series in (first, fine)
    )  # fmt: skip
    values = 2.0 * np.pi * mode.frequency, mode.damping_ratio, np.ones(mode.frequency.size, int)
    levels = Levels(first, mode.displacement[:, point], mode.harmonics, *values)
    levels, found = resolved(levels, fine, Tally(silent, 0))
    return [np.where(found, x, np.nan) for x in (levels.omega / (2.0 * np.pi), levels.zeta)]


def estimates(first=200, count=8):
    """Largest stated errors of curves of random systems over the largest true ones."""
    head(
        "systems", "curves", "levels", "not stated", "quantity", "true errors",
        "above the least stated", "stated at 0.5 to 3 times the truth", "least, largest",
        "others: stated at most",
    )  # fmt: skip
    for title, draw in DRAWN.items():
        found = {name: [] for name in FLOOR}
        levels = unknown = 0
        for seed in range(first, first + count):
            system, number, low, high = draw(np.random.default_rng(seed))
            amplitudes = np.geomspace(low, high, 8)
            try:
                (mode,) = sj.nonlinear_modes(system, [number], amplitudes=amplitudes, confirm=False)
            except ConvergenceError as error:
                mode = error.run
            if mode is None:
                continue
            true = finer(system, mode)
            stated = np.isfinite(mode.error("frequency"))
            known = np.isfinite(true[0]) & stated
            unknown += int(np.count_nonzero(~stated))
            if not known.any():
                continue
            levels += int(known.sum())
            for name, value in zip(found, true, strict=True):
                own = getattr(mode, name)
                apart = relative((own - value)[known], own[known])
                found[name].append((apart.max(), mode.error(name)[known].max()))
        for name, pairs in found.items():
            apart, stated = np.array(pairs).T
            large = apart > FLOOR[name]
            ratio = stated[large] / apart[large]
            good = np.count_nonzero((ratio >= 0.5) & (ratio <= 3.0))
            row(
                title, len(pairs), levels, unknown, name.replace("_", " "),
                f"{100 * apart.min():.2g} to {100 * apart.max():.2g} %", large.sum(),
                good, f"{ratio.min():.2g}, {ratio.max():.2g}" if large.any() else "",
                "" if large.all() else f"{100 * stated[~large].max():.2g} %",
            )  # fmt: skip


def main(arguments):
    if not arguments or "beam" in arguments:
        published()
    if "estimates" in arguments:
        estimates(*map(int, arguments[1:]))
    asked = [name for name in JOINTS if name in arguments]
    if not asked:
        return
    head(
        "structure", "unknowns", "points", "levels", "CPU s", "harmonics, samples",
        "slow: Hz", "damping", "ring-down: Hz", "damping", "at the peak: Hz", "damping",
        "time steps: Hz, damping", "stated: Hz, damping",
    )  # fmt: skip
    for joint in asked:
        compared(joint)


if __name__ == "__main__":
    main(sys.argv[1:])
