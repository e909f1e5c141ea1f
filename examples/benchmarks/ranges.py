"""One reduced model for a range of slip, frequency and friction, at points drawn at random.

    python examples/benchmarks/ranges.py                      a bar, a plate, a bracket, a solid,
                                                              and two laps whose contact opens
    python examples/benchmarks/ranges.py plate bracket        some of them
    python examples/benchmarks/ranges.py plate --points 60 --seed 1
    python examples/benchmarks/ranges.py --quick              a bar, six points

The range: 0.1 to 0.9 of what makes the first joint slip as a whole, 0.1 to 1.3 of the first
natural frequency with joints stuck, and friction of each joint times 0.5 to 2. Points are drawn
evenly, those factors evenly in their logarithms. A point runs from rest, three periods of 100
steps, and is compared with the condensed model (the full one of a bar), with exact Coulomb friction
and the same steps; at two points that is compared with the full model. Errors are in percent.
Off-line times are of the processor, without compilation; a reduction for one point has as many
joint modes, and follows a path through time.
"""

import argparse
import sys
from pathlib import Path

sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

from benchmarks import cpu_seconds, head, plates, row, shapes, solids

# isort: split

import numpy as np

import skfem_joint as sj

CYCLES, STEPS = 3, 100
ASKED = {"displacement_rms": 0.01, "friction_energy": 0.03}
SLIP, FREQUENCY, FACTORS = (0.1, 0.9), (0.1, 1.3), (0.5, 2.0)


def bar(fineness=10):
    """A bar with two joints, pulled at its end; elements in a tenth of a metre over 4."""
    parts = ("inner", 0.1, 4), ("between", 0.2, 2), ("outer", 0.1, 4), ("arm", 0.3, 3)
    strips = [(name, length, fineness * count) for name, length, count in parts]
    joints = [
        sj.Joint(on, pressure, friction=0.5) for on, pressure in (("inner", 8e6), ("outer", 4e6))
    ]
    structure = sj.Structure(
        sj.build_bar(strips, {"fixed": 0.0, "end": 0.7}), sj.Material(E=200e9, density=8000.0),
        width=0.05, thickness=0.01, fixed=["fixed"], joints=joints, stiffness_damping=2e-6,
    )  # fmt: skip
    return structure.system([sj.Load("end", sj.Harmonic(1e4, 500.0))])


def plate():
    """The plate with two bolts of ``plates.py``, 19,880 unknowns, under Coulomb's law."""
    system = plates.system_of(*plates.SIZES[1][0], True)
    return system.with_contact(beta=np.full(system.contact.w.size, np.inf))


def lapped(solid=False, fine=6):
    """Two plates that lap under two bolts; their contact opens.

    ``fine`` is the number of elements of each bolt's 10 mm along the lap; its middle has twice as
    many.
    """
    strips = [("1", 0.01, fine), ("middle", 0.02, 2 * fine), ("2", 0.01, fine)]
    arm, parts = [("arm", 0.1, 5)], []
    for name, x, y, regions, places, end, bolt in (
        ("lower ", 0.0, 0.0, arm + strips, ("left", "top"), "bottom", "nut"),
        ("upper ", 0.1, 0.01, strips + arm, ("right", "bottom"), "top", "head"),
    ):
        sides = dict(
            zip(("fixed", "face") if y == 0.0 else ("end", "contact"), places, strict=True)
        )
        sides |= {f"{bolt}_{k}": (end, f"{name}{k}") for k in "12"}
        named = [(name + region, *sizes) for region, *sizes in regions]
        if solid:
            box = sj.build_box(named, (0.01, 0.02), (2, 3), origin=(x, y, 0.0), boundaries=sides)
            parts.append(box)
        else:
            parts.append(sj.build_plate(named, 0.01, 2, origin=(x, y), boundaries=sides))
    joint = sj.Joint("contact", "preload", 0.6, against="face", contact="unilateral")
    return sj.Structure(
        sj.merged(parts),
        sj.Material(E=200e9, density=7800.0, poisson=0.3),
        fixed=["fixed"],
        joints=[joint],
        bolts=[sj.Clamp(3e3, "head_1", "nut_1"), sj.Clamp(4e3, "head_2", "nut_2")],
        damping_ratio=0.01,
        incompatible=False,  # plain elements, with which the published tables were measured
        **({} if solid else {"thickness": 0.02}),
    )


def bent(solid=False):
    """Load that bends them."""
    return [sj.Load("end", sj.Harmonic(100.0, 500.0), (0.0, 1.0, 0.0)[: 3 if solid else 2])]


STRUCTURES = {
    "bar": bar,
    "plate": plate,
    "bracket": lambda: shapes.pulled_bracket(0.5).system(),
    "solid": lambda: solids.plates(*solids.SIZES[""]).system(),
    "lap that opens": lambda: lapped().system(bent()),
    "solid lap that opens": lambda: lapped(True, 3).system(bent(True)),
}


def run(system, cycles=CYCLES):
    return sj.integrate(system, cycles=cycles, steps_per_cycle=STEPS)


def percent(values):
    return " / ".join(f"{100.0 * value:.2f}" for value in values)


def first_frequency(system):
    return float(sj.natural_modes(system, 1, joints="stuck").frequencies[0])


def drawn(system, first, count, seed):
    """Frequencies, shares of slip and factors of points; ``first`` natural frequency."""
    rng = np.random.default_rng(seed)
    for _ in range(count):
        joints, (low, high) = system.contact.joints, FACTORS
        factors = low * (high / low) ** rng.uniform(size=len(joints))
        limits = dict(zip(joints, map(float, factors), strict=True))
        yield first * rng.uniform(*FREQUENCY), rng.uniform(*SLIP), limits


def errors_of(truth, run):
    """Errors of a run's history and of its friction energy."""
    errors = sj.compare(truth, run)
    return errors.displacement_rms, abs(errors.friction_energy_per_cycle)


def gross(truth):
    """Whether a joint slips as a whole in a run of an exact model."""
    return truth.system.contact.least_share(truth.slip_peak <= 1e-3 * truth.slip_peak.max()) < 0.01


def report(name, system, count, seed):
    first = first_frequency(system)
    fastest = FREQUENCY[1] * first
    served = {
        "slip": SLIP,
        "frequency": (FREQUENCY[0] * first, fastest),
        "limits": dict.fromkeys(system.contact.joints, FACTORS),
    }
    small, made = cpu_seconds(sj.reduce, system, range=served)
    joint_modes = small.n - len(system.loads)
    middle = sj.at(small, frequency=0.7 * first, slip=0.5).serves.point
    alone = sj.at(system, frequency=0.7 * first, level=middle.level)
    _, single = cpu_seconds(sj.reduce, alone, joint_modes)
    exact = system if name == "bar" else sj.condense(sj.at(system, frequency=fastest, level=1.0))
    cost, apart = [], []
    for frequency, slip, limits in drawn(system, first, 2, seed + 1000):
        point = sj.at(small, frequency=frequency, slip=slip, limits=limits)
        given = {"frequency": frequency, "level": point.serves.point.level, "limits": limits}
        full, ours = run(sj.at(system, **given)), run(point)
        other = full if name == "bar" else run(sj.at(exact, **given))
        cost.append((full.wall_s, ours.wall_s))
        apart.append(errors_of(full, other))
    true, stated, refused, whole = [], [], 0, 0
    for frequency, slip, limits in drawn(system, first, count, seed):
        try:
            point = sj.at(small, frequency=frequency, slip=slip, limits=limits)
            ours = run(point)
            known = sj.estimate(ours).parts["total"]
        except (sj.InputError, sj.ConvergenceError) as error:
            print(f"- refused: {error}")
            refused += 1
            continue
        level = point.serves.point.level
        truth = run(sj.at(exact, frequency=frequency, level=level, limits=limits))
        true.append(errors_of(truth, ours))
        stated.append([known[quantity] for quantity in ASKED])
        whole += gross(truth)
    true, stated = np.array(true), np.array(stated)
    good = np.all(true <= list(ASKED.values()), axis=1)
    half = np.mean(stated >= 0.5 * true, axis=0)
    counting = np.where(true > 3e-3, stated >= 0.5 * true, True).mean()
    full_ms, our_ms = 1e3 / (CYCLES * STEPS) * np.array(cost).mean(axis=0)
    row(
        *(name, system.n, small.n, small.contact.count, f"{made:.0f}", f"{made / single:.1f}"),
        *(f"{full_ms:.2f}", f"{our_ms:.3f}", f"{full_ms / our_ms:.0f}", f"{good.mean() * 100:.0f}"),
        *(percent(np.quantile(errors, [0.5, 0.9, 1.0])) for errors in true.T),
        *(percent(half), f"{100 * counting:.1f}", refused, whole, percent(np.max(apart, axis=0))),
    )


def main(arguments):
    parser = argparse.ArgumentParser()
    parser.add_argument("structures", nargs="*", default=[])
    parser.add_argument("--points", type=int, default=60)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--quick", action="store_true")
    given = parser.parse_args(arguments)
    names = given.structures or (["bar"] if given.quick else list(STRUCTURES))
    head(
        *("structure", "unknowns", "reduced", "friction points", "made, s", "reductions for one"),
        *("full step, ms", "reduced step, ms", "times faster", "within 1 and 3 %, % of points"),
        *("history: half / 0.9 / all of points", "friction energy", "stated at least half, %"),
        *("of those above 0.3 %", "refused", "slip as a whole", "condensed from full, largest"),
    )
    sj.reduce(bar(2), 4, range={"slip": SLIP, "frequency": (100.0, 900.0)})  # compiles
    for name in names:
        report(name, STRUCTURES[name](), 6 if given.quick else given.points, given.seed)


if __name__ == "__main__":
    main(sys.argv[1:])
