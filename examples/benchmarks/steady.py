"""Cost of steady vibration: damping curves, responses, and a published beam.

    python examples/benchmarks/steady.py [PART ...] [--quick]

Parts are backbones, responses, light, published, sundials and balances, all if none is named.

Damping curves of 20 levels of a bar with 100 contact points and a plate with 3,979; a response of
that bar at 3, 10 and 30 % of its friction limit through its resonance, with 200 steps a period,
beside plain iteration of its periods and plain marching; its steady states beside the arctan law
marched by SUNDIALS, and beside a harmonic balance (extra ``bench``); and the cantilever with a
Coulomb element of the second example of NLstep (M. Krack and J. Gross, University of Stuttgart; see
doi:10.1016/j.compstruc.2021.106698), on matrices of one's own. Light damping of bars and condensed
bolted plates stands beside shorter steps, and an oscillator beside Den Hartog's. Times are
of one thread, those of a frequency its processor's.
"""

import argparse
import importlib.util
import itertools
import statistics
import sys
import time
from dataclasses import replace
from pathlib import Path
from unittest.mock import patch

sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

from benchmarks import NOT_INSTALLED, head, row

# isort: split

import numpy as np
from paper import cases
from scipy.linalg import eigh
from skfem import Basis, BilinearForm, ElementLineHermite, MeshLine

import skfem_joint as sj
from benchmarks.first_order import FirstOrder, slip_work
from benchmarks.integrators import Form, Task, solve
from benchmarks.plates import system_of
from skfem_joint.runs import steady_run
from skfem_joint.steady import steady
from skfem_joint.vibration import response

RESONANCE, STEPS = 2500.0, 200  # Hz, per period
#: Share of the friction limit, frequency (Hz), periods that SUNDIALS marches: at the peaks and
#: beside them. At the last the third harmonic meets the second mode, which asks for shorter steps.
CASES = ((0.03, 2270.0, 10), (0.1, 2050.0, 10), (0.1, 2100.0, 10), (0.3, 2000.0, 10),
         (0.3, 1790.0, 20))  # fmt: skip
#: Steepness (s/m) of the law for SUNDIALS, and samples in a period.
STEEP, SAMPLES = 1e7, 400
#: Force (N), peak of the tip (mm) and its frequency (rad/s) of the beam, with its 16 unknowns.
BEAM = ((50.0, 0.0737, 241.0), (100.0, 0.0761, 221.0), (200.0, 0.0886, 207.8),
        (400.0, 0.2021, 157.0))  # fmt: skip


def bar(frequency=RESONANCE, share=0.1, beta=np.inf, elements=100):
    """Bar with ``elements`` in its joint, loaded by a share of the joint's friction limit."""
    case = replace(cases.CASES["structure"], length=0.2, frequency=frequency)
    held = 0.5 / elements  # of the joint, beside the support, cannot slip
    case = replace(case, force=share * case.limit * (1.0 - held))
    damping = 2.0 * 0.001 / (2.0 * np.pi * RESONANCE)  # 0.1 % of the critical one
    ways = {"normal_force": "consistent", "elements": elements, "damping": damping}
    return cases.scene(case, beta=beta, **ways).system()


def beam():
    """Steel cantilever of 2 m with a friction element of 1.5 kN at 0.75 m, driven at its tip."""
    length, height, width, E, density = 2.0, 0.1, 0.3, 185e9, 7830.0
    EI, mass = E * width * height**3 / 12.0, density * width * height
    basis = Basis(MeshLine(np.linspace(0.0, length, 9)), ElementLineHermite())
    K = BilinearForm(lambda u, v, _: EI * u.hess[0, 0] * v.hess[0, 0]).assemble(basis)
    M = BilinearForm(lambda u, v, _: mass * u * v).assemble(basis)
    wall, joint, tip = basis.nodal_dofs[:, 0], basis.nodal_dofs[0, 3], basis.nodal_dofs[0, -1]
    free = np.setdiff1d(np.arange(basis.N), [*wall, joint])
    stuck = eigh(K[free][:, free].toarray(), M[free][:, free].toarray(), eigvals_only=True)[0]
    return sj.System.from_matrices(
        M,
        K,
        fixed=wall,
        contact=sj.point_friction(np.bincount([joint], minlength=basis.N), 1500.0, beta=np.inf),
        loads={"tip": (tip, sj.Harmonic(1.0, 30.0))},
        mass_damping=2.0 * 0.05 * float(np.sqrt(stuck)),
    )


def backbones(quick):
    head("structure", "contact points", "20 levels, s", "by Masing's rule off by")
    plate = (24, 12, 0.25) if quick else (432, 22, 0.05)
    for name, system in (("bar", bar()), ("plate", system_of(*plate, False))):
        for _ in range(2):  # the second one is warm
            begin = time.perf_counter()
            (curve,) = sj.backbone(system)
            spent = time.perf_counter() - begin
        error = "-" if curve.masing_error is None else f"{100 * curve.masing_error:.2g} %"
        row(name, system.contact.count, f"{spent:.3g}", error)


def periods(systems, memory):
    """Periods until steady states from rest, with ``memory`` mixed states; 0: plain iteration."""
    halves = steady_run.turns_over if memory else lambda loads: False
    most = (steady_run.MOST_OF_CHAIN, steady_run.MOST) if memory else (0, 0)
    with (
        patch.multiple(steady, MEMORY=memory, LINEAR_MEMORY=steady.LINEAR_MEMORY if memory else 0),
        patch.multiple(steady_run, turns_over=halves, MOST_OF_CHAIN=most[0], MOST=most[1]),
    ):
        runs = [sj.integrate(s, until="steady", steps_per_cycle=STEPS) for s in systems]
    return sum(run.steady.periods for run in runs)


def swing(run, steps=STEPS):
    """Peak-to-peak displacement of the end in the last period, of ``steps`` steps, m."""
    return np.ptp(run.point("free_end")[-steps - 1 :])


def responses(quick):
    """Print the time of a frequency, periods beside plain iteration, and results of marching."""
    system, frequencies = bar(share=1.0), np.linspace(1700.0, 2600.0, 7 if quick else 31)
    sj.integrate(system, until="steady", steps_per_cycle=STEPS)  # compiles
    times, used = [], 0
    for level in (0.03, 0.1, 0.3):
        state = None
        for frequency in frequencies.tolist():
            begin = time.process_time()
            point = response.steady_point(system, frequency, level, STEPS, state)
            times.append(time.process_time() - begin)
            state, used = point.state, used + point.periods
    cases = [bar(f, s) for s in (0.03, 0.1, 0.3) for f in frequencies.tolist()]
    mixed, plain = periods(cases, steady.MEMORY), periods(cases, 0)
    print(f"\nResponse, {len(times)} frequencies: median {1e3 * statistics.median(times):.0f} ms "
          f"of processor a frequency, {used} periods in all; each from rest {mixed}, by plain "
          f"iteration to the same change {plain}: {plain / used:.1f} times as many.\n")  # fmt: skip
    for share, frequency, _ in CASES:
        case = bar(frequency, share)
        run = sj.integrate(case, until="steady", steps_per_cycle=STEPS)
        marched = sj.integrate(case, cycles=300 if quick else 3000, steps_per_cycle=STEPS)
        apart = swing(run) / swing(marched) - 1.0
        energy = run.cycles.friction[-1] / marched.cycles.friction[-1] - 1.0
        print(
            f"- {100 * share:g} % at {frequency:g} Hz: marched {marched.counters.steps // STEPS} "
            f"periods, amplitude {100 * apart:+.2g} %, friction energy {100 * energy:+.2g} %."
        )


def lightly_damped(system, ratio):
    """System with Coulomb friction and stiffness damping; its first stuck frequency, Hz."""
    first = float(sj.natural_modes(system, 1, joints="stuck").frequencies[0])
    damping = 2.0 * ratio / (2.0 * np.pi * first)
    return replace(system, C=damping * system.K).with_beta(np.inf), first


def light(quick):
    """Print amplitudes of lightly damped structures in which points slip beside 400 steps a period.

    Two condensed plates under bolts and two bars below the first resonance, 100 steps a period.
    """
    bars = {f"bar, {n} elements": bar(elements=n) for n in ((20,) if quick else (20, 100))}
    sizes = ((24, 12, 0.25),) if quick else ((24, 12, 0.25), (63, 31, 0.25))
    plates = {f"bolted plate, {x} by {y}": sj.condense(system_of(x, y, width, True))
              for x, y, width in sizes}  # fmt: skip
    print()
    head("slipping", "damping ratio", "share of limits that slips", "from 400 steps", "stated")
    for (name, given), ratio in itertools.product((bars | plates).items(), (1e-4, 1e-5)):
        system, first = lightly_damped(given, ratio)
        level = 0.02 * float(system.contact.w.sum()) / abs(system.loads[0].amplitude.peak_value)
        point, finer, finest = (
            response.steady_point(system, 0.99 * first, level, steps) for steps in (100, 200, 400)
        )
        failure = point.failure or finer.failure or finest.failure
        at = int(np.argmax(point.amplitude))
        own, half, quarter = (p.amplitude[at] for p in (point, finer, finest))
        shown = failure or f"{100 * (own / quarter - 1):+.2g} %"
        row(
            name,
            f"{ratio:g}",
            f"{point.share:.2g}",
            shown,
            f"{400 / 3 * abs(own / half - 1):.2g} %",
        )
    hartog()


def hartog():
    """Print amplitudes of an oscillator with Coulomb friction beside J. P. Den Hartog's.

    Trans. ASME 53, 1931, APM-53-9: no damping but friction, and motion without stops.
    """
    print()
    steps = STEPS, 4 * STEPS
    off = (f"off Den Hartog's, {n} steps" for n in steps)
    head("oscillator: frequency over its own", "friction over load", *off)
    for turns, friction in ((0.8, 0.2), (0.95, 0.5), (1.2, 0.4), (1.05, 0.7)):
        system = sj.System.from_matrices(
            np.eye(1),
            (2.0 * np.pi) ** 2 * np.eye(1),
            contact=sj.point_friction(np.ones(1), friction, beta=np.inf),
            loads={"mass": (np.ones(1), sj.Harmonic(1.0, 1.0))},
        )
        V, at = 1.0 / (1.0 - turns**2), np.pi / turns
        U = np.sin(at) / (turns * (1.0 + np.cos(at)))
        exact = np.sqrt(V**2 - (friction * U) ** 2) / (2.0 * np.pi) ** 2
        points = [response.steady_point(system, turns, 1.0, n) for n in steps]
        shown = (p.failure or f"{100 * (p.amplitude[0] / exact - 1):+.2g} %" for p in points)
        row(turns, friction, *shown)


def marched(system, start, cycles):
    """Half of peak to peak (m) of the end and friction energy (J) of each period, by SUNDIALS.

    IDA of the second order, tolerances far below the width of the law's step: looser ones and
    higher orders take many times as long. Shape (2, cycles).
    """
    model, period = FirstOrder(system), 1.0 / system.loads[0].amplitude.frequency
    times = np.linspace(0.0, cycles * period, cycles * SAMPLES + 1)
    absolute = np.tile([1e-5, 1e-2], system.n) / STEEP
    y = np.column_stack(start).ravel()
    solution = solve(Task(Form("IDA", ()), model, times, 1e-6, absolute, np.inf, y, order=2))
    if isinstance(solution, str):
        raise sj.ConvergenceError(f"SUNDIALS {solution}")
    u, v = solution.y[:, ::2], solution.y[:, 1::2]
    rows = [slice(k * SAMPLES, (k + 1) * SAMPLES + 1) for k in range(cycles)]
    end = u @ system.loads[0].vector
    return np.transpose([(0.5 * np.ptp(end[k]), slip_work(system, u[k], v[k])) for k in rows])


def sundials(quick):
    """Print steady states of Coulomb friction beside the arctan law marched from the finer one."""
    cases, fine, elements = (CASES[:1], 2 * STEPS, 20) if quick else (CASES, 1600, 100)
    off = 0.02  # of the state that another run starts from
    print()
    first = f"{STEPS} steps: amplitude, friction energy apart"
    others = f"{fine} steps: the same", "both drifted by", "a start 2 % off keeps"
    head("share, frequency", "SUNDIALS", first, *others)
    for share, frequency, periods in cases:
        case, cycles = bar(frequency, share, elements=elements), 2 if quick else periods
        coarse, run = (sj.integrate(case, until="steady", steps_per_cycle=n) for n in (STEPS, fine))
        start = tuple((1.0 - off) * part for part in coarse.final)
        other = sj.integrate(case, cycles=cycles, steps_per_cycle=STEPS, initial=start)
        kept = abs(swing(other) / swing(coarse) - 1.0)
        begin = time.perf_counter()
        theirs = marched(bar(frequency, share, STEEP, elements), run.final, cycles)
        wall = time.perf_counter() - begin
        apart = [
            (0.5 * swing(vibration, fine), vibration.cycles.friction[-1]) / theirs[:, -1] - 1.0
            for vibration in (coarse, run)
        ]
        columns = [*apart, theirs[:, -1] / theirs[:, 0] - 1.0]
        texts = ["{:+.2g}, {:+.2g} %".format(*100.0 * pair) for pair in columns]
        name, cost = f"{100 * share:g} %, {frequency:g} Hz", f"{cycles} periods, {wall:.0f} s"
        row(name, cost, *texts, f"{100 * kept / off:.2g} %")


def first_harmonic(run):
    """Amplitude (m) of the first harmonic at the end, from a run of one period."""
    u = run.point("free_end")[1:]
    return float(2.0 / u.size * abs(np.fft.rfft(u)[1]))


def balances(quick):
    """Print processor times of harmonic balance and of ours, at one frequency and for one law."""
    from benchmarks.balance import balanced

    share, frequency, _ = CASES[1]
    case = bar(frequency, share, beta=10.0, elements=10 if quick else 100)
    balanced(case, [1])  # compiles
    for _ in range(2):  # the second one is warm
        begin = time.process_time()
        run = sj.integrate(case, until="steady", steps_per_cycle=STEPS)
        own = time.process_time() - begin
    ours = first_harmonic(run)
    print()
    head("odd harmonics to", "pyHarm, s", "ours, s", "first harmonic of ours apart")
    for last in (1, 3) if quick else (1, 3, 5, 7, 9):
        begin = time.process_time()
        theirs = balanced(case, list(range(1, last + 1, 2)))
        spent = time.process_time() - begin
        apart = 100.0 * (ours / theirs - 1.0)
        row(last, f"{spent:.2g}", f"{own:.2g}", f"{apart:+.2g} %")


def published(quick):
    """Peaks of the beam's response beside the published ones.

    Thirteen times the frequency of the highest peak meets the beam's second mode. Its frequency in
    time steps is 1.5 % too low with 200 steps a period, and 0.4 % with the 400 that are taken.
    """
    system = beam()
    print()
    head("force, N", "peak, mm", "published", "at, rad/s", "published")
    for force, peak, omega in BEAM[1:3] if quick else BEAM:
        around = (omega + np.linspace(-9.0, 9.0, 4 if quick else 7)) / (2.0 * np.pi)
        (curve,) = sj.response(system, around, (force,), steps_per_cycle=400)
        at, size = curve.peak
        row(f"{force:g}", f"{1e3 * size:.4f}", peak, f"{2.0 * np.pi * at:.1f}", omega)


def main(arguments):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="small structures and few frequencies")
    everything = backbones, responses, light, published, sundials, balances
    parts = {part.__name__: part for part in everything}
    parser.add_argument("parts", nargs="*", metavar="PART", help=", ".join(parts))
    options = parser.parse_args(arguments)
    if unknown := set(options.parts) - set(parts):
        parser.error(f"no part is called {', '.join(sorted(unknown))}")
    needed = {sundials: "sksundae", balances: "pyHarm"}
    for part in [parts[name] for name in options.parts or parts]:
        if part in needed and importlib.util.find_spec(needed[part]) is None:
            print(f"\n{needed[part]}: {NOT_INSTALLED}")
        else:
            part(options.quick)


if __name__ == "__main__":
    main(sys.argv[1:])
