"""Derivatives of damping curves, and fits to synthetic measurements: errors, coverage and cost.

    python examples/benchmarks/fits.py gradients    derivatives beside central differences, and time
    python examples/benchmarks/fits.py coverage     400 fits to noisy curves: 95 % intervals
    python examples/benchmarks/fits.py solid        fits of three values of bolted solid plates
    ... --quick                                     smaller, and fewer draws

Gradients: derivatives of amplitude, frequency and damping ratio, at 8 levels up to 0.6 of gross
slip, of a bar on a rigid base and of two plates under two bolts, in side view and solid, all with
springs in series with friction. Errors are largest differences from central differences of curves
whose levels converge to 1e-10, over the largest derivative of the curve, or over a thousandth of
the value over the parameter if that is larger. Only levels count at which the same points slip at
both ends. Times are of the processor, median of five alternating runs at the usual tolerance; the
derivatives of the structure's matrices are part of them, and with new values the structure and its
preload, as in a step of a fit.

Coverage: curves of the bar at 12 amplitudes with normal noise, of 2 % of the damping and of 2 % of
the whole shift of the frequency.

Solid: a lap joint of bricks of second order, ``examples/solid_lap_joint.toml`` made finer as in
``solids.py``; with contact that opens, two solid plates as for gradients.
"""

import sys
import time
from pathlib import Path

sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

from benchmarks import head, row

# isort: split

import numpy as np

import skfem_joint as sj
from benchmarks.solids import plates as bolted_solids
from skfem_joint.fitting.fit_model import FitModel
from skfem_joint.structure.parameters import value_of, with_values
from skfem_joint.structure.sensitivities import sensitivities
from skfem_joint.vibration import backbone as curves

STEEL = sj.Material(E=200e9, density=7850.0, poisson=0.3)
FRICTION, SPRING = "joint[0].friction", "joint[0].tangential_stiffness"
PRESSURE, RATIO, MODULUS = "joint[0].pressure", "damping.ratio", "material.E"
#: Relative step of central differences, tolerance of levels, and derivative over the value below
#: which errors are over that.
STEP, EXACT, SMALL = 1e-4, 1e-10, 1e-3
#: Deviations of damping and frequency, over the value and over the whole shift.
NOISE = 0.02


# %% Structures


def bar(points=80, held=False):
    """Bar of which 0.2 m are pressed on a rigid base, with its loads; maybe held at that end."""
    mesh = sj.build_bar([("joint", 0.2, points), ("free", 0.3, 12)], {"start": 0.0, "end": 0.5})
    joint = sj.Joint("joint", 8e6, 0.3, tangential_stiffness=6e11)
    sizes = {"width": 0.05, "thickness": 0.01}
    fixed = ["start"] if held else []
    given = sj.Structure(mesh, STEEL, **sizes, fixed=fixed, joints=[joint], damping_ratio=1e-3)
    return given, [sj.Load("end", sj.Harmonic(1.0, 500.0))]


def plates(dim, contact, finer=1):
    """Two plates over each other under two bolts, with their loads."""
    strips = ("a", 0.03, 3), ("1", 0.02, 2), ("b", 0.05, 5), ("2", 0.02, 2), ("c", 0.03, 3)
    sizes = {"thickness": 0.03} if dim == 2 else {}
    sizes["incompatible"] = False  # plain elements, with which the published tables were measured

    def one(prefix, y, sides):
        named = [(prefix + name, length, finer * count) for name, length, count in strips]
        if dim == 2:
            return sj.build_plate(named, 0.01, 2 * finer, origin=(0.0, y), boundaries=sides)
        depth = (0.01, 0.03), (finer, 3)
        return sj.build_box(named, *depth, origin=(0.0, y, 0.0), boundaries=sides)

    above = {"contact": "bottom", "right": "right"} | {f"head_{k}": ("top", f"u{k}") for k in "12"}
    below = {"face": "top", "left": "left"} | {f"nut_{k}": ("bottom", f"l{k}") for k in "12"}
    mesh = sj.merged([one("u", 0.01, above), one("l", 0.0, below)])
    stiff = {"tangential_stiffness": 3e12}
    if contact == "unilateral":
        stiff["normal_stiffness"] = 5e12
    joint = sj.Joint("contact", "preload", 0.3, against="face", contact=contact, **stiff)
    bolts = [sj.Clamp(force, f"head_{k}", f"nut_{k}") for force, k in ((9e3, "1"), (7e3, "2"))]
    given = sj.Structure(
        mesh, STEEL, **sizes, fixed=["left"], joints=[joint], bolts=bolts, damping_ratio=0.01
    )
    return given, [sj.Load("right", sj.Harmonic(1.0, 300.0), (0.0, 1.0, 0.0)[:dim])]


# %% Derivatives


def states(curve):
    """What slips, is at its limit and opens, at each level."""
    parts = [curve.slip > 1e-9 * curve.slip.max()]
    if curve.friction is not None:
        parts.append(np.abs(curve.friction) > 1.0 - 1e-6)
    if curve.opened is not None:
        parts.append(curve.opened[:, np.newaxis])
    return np.hstack(parts)


def differences(given, loads, key, levels):
    """Levels of the same states at both ends, all levels, and the largest error by a key."""
    system, value = given.system(loads), value_of(given, key)
    (found,) = sj.backbone(system, levels=levels, keep_path=True)
    rates = sj.backbone_sensitivity(found, sensitivities(given, [key], system))
    changed = (with_values(given, {key: value * (1.0 + h)}) for h in (STEP, -STEP))
    ends = [sj.backbone(one.system(loads), levels=levels)[0] for one in changed]
    same, errors = (states(ends[0]) == states(ends[1])).all(axis=1), []
    for name in ("amplitude", "frequency", "damping_ratio"):
        rate = getattr(rates, name)[:, 0]
        known = (getattr(ends[0], name) - getattr(ends[1], name)) / (2.0 * STEP * value)
        size = max(np.abs(known).max(), SMALL * getattr(found, name).max() / value)
        errors.append(np.abs(rate - known)[same].max(initial=0.0) / size)
    return same.sum(), same.size, max(errors)


def seconds(work):
    begin = time.process_time()
    work()
    return time.process_time() - begin


def times(given, loads, keys, levels, repeats=5):
    """Time of a curve, s, of one with derivatives over it, and the same of new values.

    New values need a structure and its preload before the curve, as in a step of a fit.
    """

    def curve(system, of=None):
        (found,) = sj.backbone(system, levels=levels, keep_path=of is not None)
        if of is not None:
            sj.backbone_sensitivity(found, sensitivities(of, keys, system))

    def anew(differentiated):
        new = with_values(given, {key: value_of(given, key) * (1.0 + 1e-9) for key in keys})
        curve(new.system(loads), new if differentiated else None)

    def medians(*ways):
        return np.median([[seconds(way) for way in ways] for _ in range(repeats)], axis=0)

    system = given.system(loads)  # the last one, whose damping's frequencies are known
    alone, both = medians(lambda: curve(system), lambda: curve(system, given))
    first, second = medians(lambda: anew(False), lambda: anew(True))
    return alone, both / alone, second / first


def gradients(quick):
    print("Derivatives of damping curves beside central differences\n")
    head(
        *("structure", "unknowns", "contact points", "contact", "derivative by"),
        *("levels with the same points slipping", "largest error", "curve, s"),
        *("time with derivatives over that", "the same of new values"),
    )
    of_bar = FRICTION, PRESSURE, SPRING, MODULUS, RATIO
    of_plates = FRICTION, "bolt[0].force", SPRING, MODULUS, RATIO
    of_open = *of_plates, "joint[0].normal_stiffness"
    finer = (1, 1, 1) if quick else (4, 3, 2)
    cases = [
        ("bar", bar(20 if quick else 80, held=True), "constant", of_bar),
        ("plates", plates(2, "constant", finer[0]), "constant", of_plates),
        ("solid plates", plates(3, "constant", finer[1]), "constant", of_plates),
        ("plates", plates(2, "unilateral", finer[2]), "unilateral", of_open),
        ("solid plates", plates(3, "unilateral"), "unilateral", of_open),
    ]
    usual = curves.TOLERANCE
    for name, (given, loads), contact, keys in cases:
        system = given.system(loads)
        (curve,) = sj.backbone(system, levels=3 if quick else 8, up_to=0.6)
        for key in (*keys, None):
            what, found = "all of these", ("", "", "")
            if key is not None:
                curves.TOLERANCE = EXACT
                found = differences(given, loads, key, curve.level)
                curves.TOLERANCE, what = usual, key
            wanted = keys if key is None else [key]
            alone, *ratios = times(given, loads, wanted, curve.level, 1 if quick else 5)
            same = "" if key is None else f"{found[0]} of {found[1]}"
            error = "" if key is None else f"{found[2]:.0e}"
            row(
                *(name, system.n, system.contact.count, contact, what),
                *(same, error, f"{alone:.3f}", *(f"{ratio:.2f}" for ratio in ratios)),
            )


# %% Coverage


def measured(frequency, damping, amplitude, shift, **how):
    """Curve with the deviations of the noise."""
    columns = {"amplitude (m)": amplitude, "frequency": frequency, "damping": damping}
    columns["frequency_deviation"] = np.full(amplitude.size, NOISE * shift)
    columns["damping_deviation"] = NOISE * damping
    return sj.measured_curve(columns, **how)


def exact_curve(given, loads, amplitude, **how):
    """Frequency and damping of a structure at some amplitudes of a point."""
    like = measured(np.full(amplitude.size, 1e3), np.full(amplitude.size, 0.01), amplitude, 1.0,
                    **how)  # fmt: skip
    (found,) = FitModel(given, (FRICTION,), loads).predict(
        [value_of(given, FRICTION)], [like], [like.displacement]
    )
    return found.frequency, found.damping


def coverage(quick):
    given, loads = bar(20 if quick else 80)
    draws, amplitude = 4 if quick else 400, np.geomspace(1.2e-5, 4e-5, 12)
    keys = FRICTION, SPRING, RATIO
    truth = {key: value_of(given, key) for key in keys}
    free = {key: (0.25 * value, 4.0 * value) for key, value in truth.items()}
    factors = zip(truth.items(), (1.2, 0.8, 1.3), strict=True)
    start = with_values(given, {key: factor * value for (key, value), factor in factors})
    frequency, damping = exact_curve(given, loads, amplitude, point="end")
    shift, random = float(np.ptp(frequency)), np.random.default_rng(1)
    inside, shares, squares, computed = [], [], [], []

    def draw():
        noisy = frequency + NOISE * shift * random.normal(size=12)
        return measured(noisy, damping * (1.0 + NOISE * random.normal(size=12)), amplitude, shift,
                        point="end")  # fmt: skip

    for _ in range(draws):
        found = sj.fit(start, draw(), free, loads)
        intervals = [found.interval(key) for key in keys]
        inside.append([a <= truth[key] <= b for key, (a, b) in zip(keys, intervals, strict=True)])
        own = [found.values[key] / value - 1.0 for key, value in truth.items()]
        shares.append([*own, *(found.deviations[key] / found.values[key] for key in keys)])
        squares.append(found.sum_of_squares / found.degrees)
        computed.append(found.computed)
    print(f"Intervals of {draws} fits of three values of a bar to 12 noisy samples\n")
    head("value", "truth in the 95 % interval, %", "mean error, %", "spread of the values, %",
         "mean stated deviation, %")  # fmt: skip
    for k, key in enumerate(keys):
        off, stated = np.array(shares)[:, k], np.array(shares)[:, len(keys) + k]
        figures = np.mean(inside, axis=0)[k], off.mean(), off.std(), stated.mean()
        row(key, *(f"{100.0 * x:.2f}" for x in figures))
    print(
        f"\n- sum of squares over degrees of freedom: {np.mean(squares):.3f} in the mean"
        f"\n- curves for a fit: {np.mean(computed):.1f} in the mean, at most {max(computed)}"
    )
    bounds = {FRICTION: free[FRICTION], PRESSURE: (2e6, 3.2e7), RATIO: free[RATIO]}
    some, named = max(draws // 20, 1), 0
    for _ in range(some):
        found = sj.fit(with_values(start, {SPRING: truth[SPRING]}), draw(), bounds, loads)
        named += any(FRICTION in said and PRESSURE in said for said in found.undetermined)
    print(
        f"- friction and pressure free at once: named as not determined in {named} of {some} fits"
        f'\n- what is said: "{found.undetermined[0]}"'
    )


# %% A solid


def fitted(name, given, loads, keys, point, contact):
    """Fit to exact samples of a structure from other values; print a row."""
    system = given.system(loads)
    (curve,) = sj.backbone(system, levels=8, up_to=0.6)
    place = system.points.index(point)
    amplitude = curve.displacement[2:, place]
    truth = {key: value_of(given, key) for key in keys}
    random = np.random.default_rng(1)
    frequency, damping = curve.frequency[2:], curve.damping_ratio[2:]
    shift = float(np.ptp(frequency))
    noisy = frequency + NOISE * shift * random.normal(size=frequency.size)
    rough = damping * (1.0 + NOISE * random.normal(size=damping.size))
    data = measured(noisy, rough, amplitude, shift, point=point)
    start = with_values(given, {k: f * v for (k, v), f in zip(truth.items(), (1.3, 0.7, 1.5),
                                                              strict=True)})  # fmt: skip
    free = {key: (0.2 * value, 5.0 * value) for key, value in truth.items()}
    begin = time.process_time()
    found = sj.fit(start, data, free, loads)
    cpu = time.process_time() - begin
    off = (
        f"{100.0 * (found.values[key] / value - 1.0):+.2f} ± "
        f"{100.0 * found.deviations[key] / value:.2f}"
        for key, value in truth.items()
    )
    row(
        *(name, contact, system.n, system.contact.count, found.evaluations, found.computed),
        *(f"{found.seconds:.0f}", f"{cpu:.0f}", *off),
    )


def solid(quick):
    keys = FRICTION, SPRING, RATIO
    print("Fits of three values of solid plates to six noisy samples\n")
    head(
        *("structure", "contact", "unknowns", "contact points", "evaluations", "curves", "s"),
        *("s of the processor", *(f"{key}: error, %" for key in keys)),
    )
    elements = (12, 2, 3, 1) if quick else (34, 2, 8, 1)
    scene = bolted_solids(elements, 1, 100).changed(joint={"tangential_stiffness": 1e13})
    given, loads = scene.structure().meshed("fit"), scene.loads()
    points = given.system(loads).points
    fitted("lap joint", given, loads, keys, points[0], "constant")
    given, loads = plates(3, "unilateral")
    points = [name for name in given.system(loads).points if name.startswith("right")]
    fitted("plates under bolts", given, loads, keys, points[0], "unilateral")


TABLES = {"gradients": gradients, "coverage": coverage, "solid": solid}


def main(arguments):
    names = [name for name in arguments if name in TABLES] or list(TABLES)
    for name in names:
        TABLES[name]("--quick" in arguments)


if __name__ == "__main__":
    main(sys.argv[1:])
