"""Results of today in bits, numbers, counters and times, to be compared with those of later code.

    python examples/benchmarks/frozen.py --out FILE.json         computes and keeps all
    python examples/benchmarks/frozen.py --against FILE.json     computes and compares with a file
    python examples/benchmarks/frozen.py "bar, full" "bar, steady" --against FILE.json   some alone

All kinds of models, of contact and of analyses are here once, with mode numbers and settings given
explicitly. Of each result there are a few numbers in full precision, a SHA-256 of the bits of its
arrays, its counters, and its time: of runs µs a step, of others s; the median of three repetitions,
of up to fifty where they are short, and the least of them, which other programs on the machine
disturb less. It takes two minutes on one core; with ``--without-times`` each result is computed
once, in half a minute. Differences are relative to the largest number of a name. The status is 1
where one is above its tolerance, 1e-9 for full and condensed models and 1e-6 for most others.

The package that is measured is the one that Python imports: with ``PYTHONPATH`` set to another
checkout the same script measures that one. ``examples/benchmarks/frozen.json`` has numbers, bits
and counters; bits and counters are those of the machine on which it was made. It is renewed, only
where a change of the numbers is meant and explained, by

    python examples/benchmarks/frozen.py --without-times --out examples/benchmarks/frozen.json

``--shake`` computes all with Young's moduli that are larger by 1e-13. What then changes
by much more depends on round-off, and has a tolerance of its own below, with the reason.
"""

import os
import sys
from pathlib import Path

os.environ |= dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

import argparse
import hashlib
import json
import time
from dataclasses import asdict
from functools import cache, singledispatch
from typing import Any, NamedTuple

import numpy as np
import skfem
from skfem.helpers import dot
from skfem.models.elasticity import lame_parameters, linear_elasticity

import skfem_joint as sj
from benchmarks import head, row

#: Numbers, bits and counters as they were.
FROZEN = Path(__file__).with_name("frozen.json")
#: By which factor Young's moduli differ from what stands below.
SHAKEN = 1.0
#: Largest relative differences of full and condensed models, and of others.
EXACT, OTHER = 1e-9, 1e-6
#: The same of reduced models with contact that opens. Their modes come from a static path on which
#: round-off decides about the weakest of them: shaken, energies move by up to 4e-6. (Reduced models
#: of bodies that contact alone holds, or that are pulled and bent at once, move by percents: such
#: ones are not kept.)
ROUND_OFF = 1e-4
#: Least and largest number of repetitions, and time, s, that short ones are repeated for.
LEAST, MOST, ENOUGH = 3, 50, 0.5

# Models. Bars, plates and solids are small, and damped in proportion to their stiffness.

DAMPED = {"stiffness_damping": 1e-6}
#: Quadrilaterals and hexahedra are plain: the numbers are older than incompatible modes.
PLAIN = DAMPED | {"incompatible": False}
EVERY_STEP = {"scheme": sj.generalized_alpha(1.0), "tolerance": 1e-11}
DAMPING_SCHEME = EVERY_STEP | {"scheme": sj.generalized_alpha(0.7)}


def steel():
    return sj.Material(E=200e9 * SHAKEN, density=8000.0, poisson=0.3)


@cache
def bar(load=None, friction=0.7, **joint):
    """Bar on a base over a sixth of its length; a chain of unknowns."""
    mesh = sj.build_bar([("joint", 0.1, 40), ("free", 0.5, 40)], {"held": 0.0, "end": 0.6})
    structure = sj.Structure(
        mesh, steel(), fixed=["held"], width=0.05, thickness=0.01, **DAMPED,
        joints=[sj.Joint("joint", pressure=50e6, friction=friction, **joint)],
    )  # fmt: skip
    return structure, structure.system([sj.Load("end", load or sj.Harmonic(60e3, 500.0))])


@cache
def plan(**joint):
    """Plate in plan that lies on a base, so that its points slip in two directions."""
    mesh = sj.build_plate([("joint", 0.06, 6), ("free", 0.12, 8)], 0.04, 4)
    structure = sj.Structure(
        mesh, steel(), fixed=["left"], thickness=0.01, **PLAIN,
        joints=[sj.Joint("joint", pressure=50e6, friction=0.7, **joint)],
    )  # fmt: skip
    load = sj.Load("right", sj.Harmonic(30e3, 400.0), direction=(1.0, 0.1))
    return structure, structure.system([load], points=["right"])


@cache
def lap(bent=True, **joint):
    """Two plates from the side that lap, pulled and maybe ``bent``: contact of two bodies."""
    upper = {"upper_end": "left", "tip": "right", "upper_face": ("bottom", "upper_lap")}
    lower = {"lower_end": "right", "lower_face": ("top", "lower_lap")}
    strips = [("upper_rest", 0.06, 4), ("upper_lap", 0.06, 10)]
    others = [("lower_lap", 0.06, 10), ("lower_rest", 0.06, 4)]
    above = sj.build_plate(strips, 0.01, 2, origin=(0.0, 0.01), boundaries=upper)
    below = sj.build_plate(others, 0.01, 2, origin=(0.06, 0.0), boundaries=lower)
    structure = sj.Structure(
        sj.merged([above, below]), steel(), thickness=0.03, **PLAIN,
        fixed=["lower_end"], fixed_y=["upper_end"],
        joints=[sj.Joint("upper_face", 30e6, 0.5, against="lower_face", **joint)],
    )  # fmt: skip
    loads = [
        sj.Load("upper_rest", sj.Harmonic(12e3, 400.0), direction=(-1.0, 0.0)),
        sj.Load("tip", sj.Harmonic(4e3, 400.0, 1.0), direction=(0.0, 1.0)),
    ]
    return structure, structure.system(loads[: 1 + bent], points=["upper_rest", "tip"])


@cache
def block(lift=0.15, made=lambda peak: sj.Harmonic(peak, 2000.0), **joint):
    """Block from the side on a base, lifted and pushed at its left side so that it opens there."""
    sides = {"base": "bottom", "left": "left", "right": "right", "top": "top"}
    mesh = sj.build_plate([("block", 0.08, 12)], 0.03, 4, boundaries=sides)
    values = {"contact": "unilateral"} | joint
    structure = sj.Structure(
        mesh, steel(), thickness=0.1, fixed_x=["right"], **PLAIN,
        joints=[sj.Joint("base", 50e6, 0.5, **values)],
    )  # fmt: skip
    pressed = 50e6 * 0.08 * 0.1
    loads = [
        sj.Load("left", made(lift * pressed), direction=(0.0, 1.0)),
        sj.Load("left", made(0.4 * pressed), direction=(1.0, 0.0)),
    ]
    return structure, structure.system(loads, points=["left", "top"])


@cache
def solid(held=False, **joint):
    """Two solid plates of bricks under a bolt; the upper one is ``held`` or lies on."""
    strips = ("a", 0.03, 3), ("head", 0.02, 2), ("b", 0.05, 3)
    upper = {"face": "front", "loaded": "left", "end": "right", "head": ("back", "upper_head")}
    lower = {"other": "back", "held": "right", "nut": ("front", "lower_head")}
    size, count = (0.03, 0.01), (3, 1)
    above, below = (
        sj.build_box([(f"{name}_{x}", *s) for x, *s in strips], size, count, **given)
        for name, given in (
            ("upper", {"origin": (0.0, 0.0, 0.01), "boundaries": upper}),
            ("lower", {"origin": (0.0, 0.0, 0.0), "boundaries": lower}),
        )
    )
    structure = sj.Structure(
        sj.merged([above, below]), steel(), fixed=["held", "end"][: 1 + held], **PLAIN,
        joints=[sj.Joint("face", "preload", 0.5, against="other", **joint)],
        bolts=[sj.Clamp(20e3, head="head", nut="nut")],
    )  # fmt: skip
    load = sj.Load("loaded", sj.Harmonic(3e3 * (1 + 3 * held), 500.0), direction=(1.0, 0.2, 0.1))
    return structure, structure.system([load], points=["loaded"])


def chain(contact, amplitude=150.0):
    """Three masses on springs in a row, with friction between the last one and the base."""
    k, m = 1e6 * SHAKEN, 1.0
    K = k * np.array([[2.0, -1.0, 0.0], [-1.0, 2.0, -1.0], [0.0, -1.0, 1.0]])
    return sj.System.from_matrices(
        m * np.eye(3), K, contact=contact, stiffness_damping=1e-5,
        loads={"last": (2, sj.Harmonic(amplitude, 40.0))}, points={"first": 0},
    )  # fmt: skip


@cache
def given_rows():
    """Slips that share unknowns, in one and two directions, under both laws, one with a spring."""
    rubs = sj.point_friction([0.0, 0.0, 1.0], 60.0, name="coulomb")
    rubs += sj.point_friction([1.0, -1.0, 0.0], 30.0, beta=1e3, name="arctan")
    rubs += sj.point_friction([1.0, 1.0, 0.0], 20.0, stiffness=3e5, name="spring")
    return chain(rubs)


@cache
def iwan(amplitude=150.0):
    """Whole joint by Iwan's model."""
    values = {"F_S": 100.0, "K_T": 1e6, "chi": -0.5, "beta": 0.2}
    return chain(sj.iwan([0.0, 0.0, 1.0], sliders=30, least=0.25, **values), amplitude)


@cache
def own_basis():
    """Block of matrices that scikit-fem assembled, with contact that opens."""
    mesh = skfem.MeshQuad.init_tensor(np.linspace(0, 0.08, 9), np.linspace(0, 0.03, 4))
    mesh = mesh.with_boundaries({"base": lambda x: x[1] == 0.0, "right": lambda x: x[0] == 0.08})
    basis = skfem.Basis(mesh, skfem.ElementVector(skfem.ElementQuad1()))
    K = 0.1 * linear_elasticity(*lame_parameters(200e9 * SHAKEN, 0.3)).assemble(basis)
    M = skfem.BilinearForm(lambda u, v, _: 800.0 * dot(u, v)).assemble(basis)
    fixed = basis.get_dofs("right").all(["u^1"])
    contact = sj.contact(
        basis, "base", pressure=50e6, friction=0.5, thickness=0.1, fixed=fixed, contact="unilateral"
    )
    along, up = basis.nodal_dofs[:, np.argmin(mesh.p[0] - mesh.p[1])]
    loads = {"up": (up, sj.Harmonic(40e3, 1500.0)), "along": (along, sj.Harmonic(80e3, 1500.0))}
    return sj.System.from_matrices(
        M, K, fixed=fixed, contact=contact, loads=loads, stiffness_damping=1e-6
    )


def full(make, **values):
    return make(**values)[1]


@cache
def condensed(make, **values):
    return sj.condense(full(make, **values), interface_modes=8)


@cache
def reduced(make, points, **values):
    """Reduced model for three periods of its load."""
    system = full(make, **values)
    length = 3.0 / max(load.amplitude.highest_frequency for load in system.loads)
    how = {"interface_modes": 8, "friction_points": points, "beta": 100.0}
    return sj.reduce(system, modes=12, duration=length, **how)


@cache
def on_own_run(make, **values):
    """Reduced model on modes of a run of its own."""
    system = full(make, **values)
    trained = run(system, 1, save=sj.Save(fields=True))
    return sj.reduce(
        system, run=trained, modes=6, interface_modes=4, friction_points="all", beta=100.0
    )


@cache
def for_range():
    values = {"slip": (0.2, 0.8), "frequency": (400.0, 2600.0), "limits": {"joint": (0.5, 2.0)}}
    return sj.reduce(full(bar), range=values, modes=8, accuracy=0.05)


def in_range():
    return sj.at(for_range(), frequency=500.0, level=1.0, limits={"joint": 1.2})


# Analyses


def run(system, cycles=3, steps=100, **how):
    return sj.integrate(system, cycles=cycles, steps_per_cycle=steps, **(EVERY_STEP | how))


def pulse(system, step, **how):
    return sj.integrate(system, step=step, n_steps=300, **(EVERY_STEP | how))


def steady(system, steps=80):
    return sj.integrate(system, until="steady", steps_per_cycle=steps, **EVERY_STEP)


def slow(system, cycles=2, steps=40):
    return sj.quasi_static(system, cycles=cycles, steps_per_cycle=steps, tolerance=1e-11)


def continued(system):
    first = run(system, cycles=1)
    return run(system, cycles=1, initial=first, scheme=sj.generalized_alpha(0.9))


def curve(system, levels=6, **how):
    (found,) = sj.backbone(system, modes=[1], levels=levels, up_to=0.6, **how)
    return found


class Differentiated(NamedTuple):
    curve: sj.Backbone
    rates: sj.BackboneSensitivity


def differentiated(made, keys, levels=4):
    structure, system = made
    found = curve(system, levels=levels, keep_path=True)
    by = sj.sensitivities(structure, keys, system)
    return Differentiated(found, sj.backbone_sensitivity(found, by))


def ring(system, cycles=8):
    return sj.ring_down(
        system, curve(system), cycles, steps_per_cycle=80, scheme=sj.generalized_alpha(0.9)
    )


def response(system, frequencies, steps=80):
    (found,) = sj.response(
        system, np.array(frequencies), (1.0,), steps_per_cycle=steps, refined=False, estimated=False
    )
    return found


def fitted():
    """Friction and stiffness of the bar's joint, fitted to a curve of others with an even error."""
    (truth,) = sj.backbone(full(bar, friction=0.9, tangential_stiffness=6e11), levels=8, up_to=0.6)
    wave = np.cos(2.0 * np.arange(8))
    deviations = np.full(8, 0.02 * np.ptp(truth.frequency)), 0.02 * truth.damping_ratio
    measured = {
        "amplitude": truth.displacement[:, 0],
        "frequency": truth.frequency + deviations[0] * wave,
        "damping": truth.damping_ratio + deviations[1] * wave[::-1],
        "frequency_deviation": deviations[0],
        "damping_deviation": deviations[1],
    }
    data = sj.measured_curve(measured, name="curve", unit="m", point="end")
    free = {"joint[0].friction": (0.1, 2.0), "joint[0].tangential_stiffness": (3e10, 3e12)}
    structure, system = bar(tangential_stiffness=3e11)
    return sj.fit(structure, data, free, loads=[sj.Load("end", system.loads[0].amplitude)])


# What is kept of a result


class Content(NamedTuple):
    """Numbers and counters of a result by name, its arrays, and its time: µs a step, or none."""

    numbers: dict[str, Any]
    counters: dict[str, Any]
    arrays: tuple[np.ndarray, ...]
    time: float | None = None


@singledispatch
def content(result):
    raise TypeError(f"nothing is known of results of {type(result)}")


@content.register(sj.Run)
def _(result):
    u, v = (result.system.expand(x) for x in result.final)
    numbers = {
        "peak": result.peak,
        "energies": [
            *result.input_work, result.viscous_work, result.scheme_work, result.impact_work,
            *result.stored_energy,
        ],
        "friction by joint": list(result.friction_energy.values()),
        "displacement": np.linalg.norm(u),
        "velocity": np.linalg.norm(v),
        "friction": np.linalg.norm(result.final_sigma),
        "slip": np.linalg.norm(result.slip_peak),
        "slider": np.linalg.norm(result.slider_peak),
        "normal": [result.normal_force_peak.sum(), result.normal_force_least.sum()],
    }  # fmt: skip
    counters = asdict(result.counters) | {"opened": int(result.opened.sum())}
    if result.steady is not None:
        numbers |= {"amplitude": result.steady.amplitude}
        counters |= {"periods": result.steady.periods}
    arrays = (
        *(result.point_u, result.point_v, result.joint_work, result.amplitudes, result.peak),
        *(result.friction_work, result.slip_peak, result.slider_peak, result.final_sigma, u, v),
        *(result.normal_force_peak, result.normal_force_least, result.final_limits),
    )
    return Content(numbers, counters, arrays, 1e6 * result.wall_s / result.counters.steps)


@content.register(sj.Backbone)
def _(result):
    return of_curve(result)


@content.register(Differentiated)
def _(result):
    return of_curve(*result)


def of_curve(result, by=None):
    ends = slice(None, None, max(1, result.level.size - 1))
    names = "level", "amplitude", "frequency", "friction_damping", "viscous_damping", "share"
    columns = {name: getattr(result, name) for name in names}
    numbers = {name: values[ends] for name, values in columns.items()}
    numbers |= {
        "stuck frequency": result.stuck_frequency,
        "slips at": result.slips_at,
        "displacement": np.linalg.norm(result.displacement, axis=1)[ends],
        "slip": np.linalg.norm(result.slip, axis=1)[ends],
    }
    arrays = (*columns.values(), result.displacement, result.slip)
    if by is not None:
        # The last column is that by the level.
        rates = {
            f"{name} by parameters": getattr(by, name)[-1]
            for name in ("amplitude", "frequency", "friction_damping", "viscous_damping")
        }
        numbers |= {
            f"{name} {k}": x for name, rate in rates.items() for k, x in enumerate(rate.tolist())
        }
        arrays += (by.amplitude, by.frequency, by.friction_damping, by.displacement)
    if result.opened is not None:
        numbers |= {"offset": result.offset[ends], "opened": result.opened[ends]}
        arrays += (result.offset, result.opened)
    return Content(numbers, {"levels": result.level.size, "state": list(result.state)}, arrays)


@content.register(sj.RingDown)
def _(result):
    ends = slice(None, None, max(1, result.time.size - 1))
    names = "time", "amplitude", "frequency", "damping_ratio"
    columns = {name: getattr(result, name) for name in names}
    numbers = {name: values[ends] for name, values in columns.items()}
    numbers |= {
        "energy": result.energy[[0, -1]],
        "friction by joint": result.friction_work[-1],
        "impacts": result.impact_work,
    }
    arrays = (*columns.values(), result.energy, result.friction_work)
    return Content(numbers, {"cycles": result.time.size}, arrays)


@content.register(sj.Curve)
def _(result):
    names = "amplitude", "offset", "friction_energy", "input_energy", "slip", "share"
    columns = {name: result.column(name) for name in names}
    numbers = {name: columns[name] for name in names if name not in ("offset", "slip")}
    numbers |= {"slip": np.linalg.norm(columns["slip"], axis=1)}
    counters = {"periods": result.column("periods").tolist()}
    return Content(numbers, counters, tuple(columns.values()))


@content.register(sj.Fit)
def _(result):
    numbers = {
        **result.values,
        "deviations": list(result.deviations.values()),
        "squares": result.sum_of_squares,
    }
    counters = {"evaluations": result.evaluations, "computed": result.computed}
    return Content(numbers, counters, (result.vector, result.covariance))


@content.register(sj.NaturalModes)
def _(result):
    return Content({"frequencies": result.frequencies}, {}, (result.frequencies,))


@content.register(sj.Structure)
def _(result):
    """Preload of a bolted structure."""
    (pressed,), moved = result.preload.joints, result.preload.displacement
    numbers = {
        "forces": [pressed.force.sum(), pressed.force.max()],
        "gap": np.linalg.norm(pressed.gap),
        "displacement": np.linalg.norm(moved),
    }
    counters = {"active sets": result.preload.active_sets}
    counters |= {"touching": int(np.count_nonzero(pressed.force))}
    return Content(numbers, counters, (pressed.force, pressed.gap, moved))


# Results


SPRUNG = {"tangential_stiffness": 5e12}
OPENS = {"contact": "unilateral"}
ELASTIC = OPENS | {"normal_stiffness": 1e14}
SOFT = OPENS | {"normal_stiffness": 1e13}
ARCTAN = {"beta": 100.0}
IMPULSE = sj.Versine(80e3, 2e-4)

#: How each result is computed, by the largest relative difference that counts as none.
COMPUTED = {
    EXACT: {
        "bar, full": lambda: run(full(bar)),
        "bar, arctan law": lambda: run(full(bar, **ARCTAN)),
        "bar, rho 0.7": lambda: run(full(bar), **DAMPING_SCHEME),
        "bar, impulse": lambda: pulse(full(bar, load=IMPULSE), 5e-6),
        "bar, springs": lambda: run(full(bar, **SPRUNG)),
        "bar, springs, rho 0.7": lambda: run(full(bar, **SPRUNG), **DAMPING_SCHEME),
        "bar, condensed": lambda: run(condensed(bar)),
        "bar, quasi-static": lambda: slow(full(bar)),
        "bar, springs, quasi-static": lambda: slow(full(bar, **SPRUNG)),
        "bar, natural modes": lambda: sj.natural_modes(full(bar), 6, joints="stuck"),
        "plan, full": lambda: run(full(plan)),
        "plan, arctan law": lambda: run(full(plan, **ARCTAN)),
        "plan, springs": lambda: run(full(plan, **SPRUNG)),
        "plan, condensed": lambda: run(condensed(plan)),
        "plan, condensed, springs": lambda: run(condensed(plan, **SPRUNG)),
        "lap, full": lambda: run(full(lap)),
        "lap, condensed": lambda: run(condensed(lap)),
        "lap, opens": lambda: run(full(lap, **OPENS)),
        "lap, opens, condensed": lambda: run(condensed(lap, **OPENS)),
        "lap, opens, springs, continued": lambda: continued(full(lap, **ELASTIC, **SPRUNG)),
        "block, opens": lambda: run(full(block)),
        "block, opens, arctan law": lambda: run(full(block, **ARCTAN)),
        "block, opens, impulse, rho 0.7": lambda: pulse(
            full(block, lift=0.4, made=lambda peak: sj.Versine(peak, 5e-5)), 2e-6, **DAMPING_SCHEME
        ),
        "block, opens, condensed": lambda: run(condensed(block)),
        "block, opens, springs": lambda: run(full(block, **SPRUNG)),
        "block, elastic": lambda: run(full(block, **ELASTIC)),
        "block, elastic, condensed": lambda: run(condensed(block, **ELASTIC)),
        "block, elastic, springs": lambda: run(full(block, **ELASTIC, **SPRUNG)),
        "block, opens, quasi-static": lambda: slow(full(block)),
        "block, elastic, springs, quasi-static": lambda: slow(full(block, **ELASTIC, **SPRUNG)),
        "solid, preload": lambda: solid.__wrapped__()[0],
        "solid, full": lambda: run(full(solid), 2),
        "solid, condensed": lambda: run(condensed(solid), 2),
        "solid, opens": lambda: run(full(solid, **OPENS), 2),
        "solid, opens, condensed": lambda: run(condensed(solid, **OPENS), 2),
        "matrices, rows of all kinds": lambda: run(given_rows(), 4),
        "matrices, Iwan": lambda: run(iwan(), 4),
        "matrices, Iwan, quasi-static": lambda: slow(iwan(60.0)),
        "matrices, basis of scikit-fem, opens": lambda: run(own_basis()),
    },
    OTHER: {
        "bar, reduced": lambda: run(reduced(bar, 8)),
        "bar, range": lambda: run(in_range()),
        "bar, steady": lambda: steady(full(bar)),
        "bar, springs, steady": lambda: steady(full(bar, **SPRUNG)),
        "bar, backbone": lambda: curve(full(bar)),
        "bar, range, backbone": lambda: curve(for_range(), levels=3),
        "bar, springs, derivatives": lambda: differentiated(
            bar(**SPRUNG), ["joint[0].friction", "joint[0].tangential_stiffness", "material.E"]
        ),
        "bar, ring-down": lambda: ring(full(bar)),
        "bar, response": lambda: response(full(bar), [1300.0, 1700.0, 2900.0]),
        "bar, fit": fitted,
        "plan, reduced": lambda: run(reduced(plan, 8)),
        "plan, reduced by a run": lambda: run(on_own_run(plan)),
        "plan, steady": lambda: steady(full(plan)),
        "plan, backbone": lambda: curve(full(plan)),
        "lap, reduced": lambda: run(reduced(lap, 8, bent=False)),
        "block, opens, steady": lambda: steady(full(block)),
        "block, elastic, response": lambda: response(
            condensed(block, **ELASTIC), [2000.0, 2500.0], 40
        ),
        "solid, reduced": lambda: run(reduced(solid, 8, held=True), 2),
        "solid, opens, backbone": lambda: curve(full(solid, **OPENS), levels=3),
        "solid, opens, derivatives": lambda: differentiated(
            solid(**ELASTIC, **SPRUNG),
            ["joint[0].friction", "bolt[*].force", "joint[0].normal_stiffness"],
            3,
        ),
        "solid, opens, ring-down": lambda: ring(condensed(solid, **OPENS), 6),
        "matrices, Iwan, backbone": lambda: curve(iwan()),
    },
    ROUND_OFF: {
        "block, elastic, reduced": lambda: run(reduced(block, "all", **ELASTIC)),
        "solid, elastic, reduced": lambda: run(
            reduced(solid, "all", held=True, **SOFT), 2, **DAMPING_SCHEME
        ),
    },
}
RESULTS = {name: make for made in COMPUTED.values() for name, make in made.items()}
TOLERANCES = {name: largest for largest, made in COMPUTED.items() for name in made}


def measured(name, timed=True):
    """What is kept of a result, as JSON has it; computed once where it is not ``timed``."""
    times, begin = [], time.perf_counter()
    while True:
        start = time.perf_counter()
        found = content(RESULTS[name]())
        end = time.perf_counter()
        times.append(end - start if found.time is None else found.time)
        few = len(times) < LEAST or (end - begin < ENOUGH and len(times) < MOST)
        if not (timed and few):
            break
    digest = hashlib.sha256()
    for x in found.arrays:
        # Adding zero gives all zeros one sign.
        digest.update(np.ascontiguousarray(np.asarray(x, dtype=float) + 0.0).tobytes())
    numbers = {key: np.ravel(x).tolist() for key, x in found.numbers.items()}
    kept = {
        "numbers": {key: x[0] if len(x) == 1 else x for key, x in numbers.items() if any(x)},
        "counters": {key: x for key, x in found.counters.items() if x},
        "bits": digest.hexdigest(),
    }
    if timed:
        unit = "s" if found.time is None else "µs a step"
        kept |= {"time": float(np.median(times)), "least": min(times), "unit": unit}
    return kept


def difference(one, other):
    """Largest difference of numbers, relative to the largest of each name, and that name."""
    largest = 0.0, ""
    for name in sorted(one.keys() | other.keys()):
        a, b = (np.atleast_1d(x.get(name, 0.0)) for x in (one, other))
        size = np.abs(a).max()
        apart = np.abs(b - a).max() / size if size > 0.0 and b.size in (1, a.size) else np.inf
        largest = max(largest, (float(apart), name))
    return largest


def changed_counters(one, other):
    """Counters that differ, as "name before > after"."""
    names = [name for name in (one | other) if one.get(name, 0) != other.get(name, 0)]
    return [f"{name} {one.get(name, 0)} > {other.get(name, 0)}" for name in names]


def compare(name, before, now):
    """Print a row on a result; whether its numbers agree."""
    apart, where = difference(before["numbers"], now["numbers"])
    agrees = apart <= TOLERANCES[name]
    same = before["bits"] == now["bits"]
    cells = ["equal" if same else "differ", f"{apart:.1e} {where}" if apart else "0"]
    cells += ["" if agrees else f"above {TOLERANCES[name]:.0e}"]
    cells += ["; ".join(changed_counters(before["counters"], now["counters"])) or "unchanged"]
    cells += [f"{now['time']:.4g} {now['unit']}" if "time" in now else ""]
    known = "time" in before and "time" in now
    cells += [f"{now[kind] / before[kind]:.3f}" if known else "" for kind in ("time", "least")]
    row(name, *cells)
    return agrees


def main(arguments):
    first, *_ = __doc__.splitlines()
    parser = argparse.ArgumentParser(description=first)
    parser.add_argument("names", nargs="*", help="results; all if none is given")
    parser.add_argument("--out", type=Path, help="file to write")
    parser.add_argument("--against", type=Path, help="file to compare with")
    parser.add_argument("--without-times", action="store_true", help="compute each result once")
    parser.add_argument("--shake", action="store_true", help="with moduli larger by 1e-13")
    given = parser.parse_args(arguments)
    if unknown := set(given.names) - RESULTS.keys():
        parser.error(f"found {sorted(unknown)}, must be of {', '.join(RESULTS)}")
    before = {} if given.against is None else json.loads(given.against.read_text(encoding="utf-8"))
    global SHAKEN
    SHAKEN = 1.0 + 1e-13 * given.shake
    print(f"Package of {Path(sj.__file__).parent}\n")
    ratios = "time over the one before", "of the least times"
    head("result", "bits", "largest relative difference", "", "counters", "time", *ratios)
    every, agree = {}, True
    for name in given.names or RESULTS:
        every[name] = now = measured(name, not given.without_times)
        agree &= compare(name, before.get(name, now), now)
    if given.out is not None:
        lines = (
            f"{json.dumps(k)}:{json.dumps(x, separators=(',', ':'))}" for k, x in every.items()
        )
        given.out.write_text("{\n" + ",\n".join(lines) + "\n}\n", encoding="utf-8")
    return 0 if agree else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
