"""The paper's systems and their runs: reference system, Cases I to VII, the jointed structure."""

from dataclasses import dataclass, replace
from functools import cache
from math import inf

import numpy as np
from paper import pseudo_static
from paper.page import printed

import skfem_joint as sj
from skfem_joint.reduction.active_length import THRESHOLD, measured
from skfem_joint.reduction.basis import Options
from skfem_joint.reduction.models import reduced_on
from skfem_joint.reduction.pod import orthonormal, proper_decomposition, snapshot_matrix
from skfem_joint.reduction.scaled.basis import ScaledBasis
from skfem_joint.reduction.scaled.estimated_length import estimate_active_length
from skfem_joint.reduction.scaled.zones import active_zones
from skfem_joint.reduction.sources import own_basis
from skfem_joint.results.contact_history import displacements
from skfem_joint.results.history import compare
from skfem_joint.runs.integrate import integrate_plan
from skfem_joint.scene import scene_from
from skfem_joint.stepping.plan import Plan
from skfem_joint.study.models import model_of, options_of
from skfem_joint.study.results import Model

#: Young's modulus and density are not printed: Table 3 and the resonances give them.
E, DENSITY, WIDTH, THICKNESS = 200e9, 8000.0, 0.05, 0.01
#: Axial stiffness, N, and speed of longitudinal waves, m/s.
STIFFNESS, SPEED = E * WIDTH * THICKNESS, float(np.sqrt(E / DENSITY))
#: Shares of the free end's peak above which a node counts as active: this package's, and less.
THRESHOLDS = THRESHOLD, 1e-4
PULSES = "triangle", "half_sine", "versine", "ramp_and_hold"
#: Ours: scaled modes of the paper's reference system, velocity snapshots beside displacement,
#: active length from a probe run, friction at Gauss points, beta that the modes resolve.
DEFAULT = {"reference": "paper", "modes": 5, "snapshots": "both", "inner_product": "euclidean"}
#: The paper's own choices; these with a measured active length; keys for own modes.
PLAIN = DEFAULT | {"snapshots": "displacement", "friction_points": "all", "beta": 1e5}
PLAIN |= {"active_length": "estimate"}
MOVED = PLAIN | {"active_length": "auto"}
OWN = {"reference": "self", "interface_modes": 0}


@dataclass(frozen=True)
class Case:
    """One system under one load: joint length (m), pressure (Pa), friction, force (N), Hz.

    ``linear`` is the length of the linear region beyond the joint, m.
    """

    length: float
    pressure: float
    friction: float
    force: float
    frequency: float
    linear: float = 0.0

    @property
    def tau(self):
        """Friction limit per length, N/m."""
        return self.friction * self.pressure * WIDTH

    @property
    def limit(self):
        """Friction limit, N."""
        return self.tau * self.length

    @property
    def static_length(self):
        """Active length without inertia, m."""
        return pseudo_static.slip_length(self.force, self.tau)

    @property
    def static_resonance(self):
        """First natural frequency of the static length, Hz."""
        return SPEED / (4.0 * self.static_length)

    def static(self, closed_form, *phase):
        """Value of a function of `pseudo_static` for this case."""
        return closed_form(self.force, STIFFNESS, self.tau, *phase)

    @property
    def static_loop_area(self):
        """Area of the hysteresis loop without inertia, J."""
        return self.static(pseudo_static.loop_energy)


CASES = {
    "reference": Case(0.25, 8e6, 0.7, 63e3, 1000.0),
    "weak": Case(0.25, 8e6, 0.7, 28e3, 100.0),
    "I": Case(0.5, 50e6, 0.7, 437.5e3, 2000.0),
    "II": Case(0.25, 50e6, 0.1, 31.25e3, 4000.0),
    "III": Case(0.5, 50e6, 0.1, 37.5e3, 4000.0),
    # A normal force of 100 kN is stated nowhere; it makes the 35 kN half of the limit.
    "IV": Case(0.25, 100e3 / WIDTH / 0.25, 0.7, 35e3, 10_000.0),
    "V": Case(0.3, 100e3 / WIDTH / 0.3, 0.7, 35e3, 8000.0),
    "VI": Case(0.4, 100e3 / WIDTH / 0.4, 0.7, 35e3, 60.0),
    "VII": Case(0.5, 100e3 / WIDTH / 0.5, 0.7, 35e3, 5000.0),
    "structure": Case(0.1, 50e6, 0.7, 87.5e3, 500.0, linear=0.5),
}


@cache
def _bar(length, linear, elements):
    """Bar with ``elements`` elements in the joint, and as many in a linear region beyond it."""
    parts = [("joint", length, elements), ("linear", linear, elements)][: 2 if linear else 1]
    points = {"fixed": 0.0} | ({"junction": length} if linear else {})
    return sj.build_bar(parts, points | {"free_end": length + linear})


def scene(
    case, reduction=None, *, load=None, time=None, models=("full",), beta=1e5,
    normal_force="equal", elements=100, damping=1e-5, frames=0,
):  # fmt: skip
    """Scene of a case; by default harmonic, 8 cycles of 200 steps.

    ``reduction``, ``load`` and ``time`` are keys of these tables; ``beta`` (s/m) is infinite for
    Coulomb's law; ``damping`` (s) makes C = damping K; ``frames`` are fields to keep, at most.
    """
    harmonic = {"kind": "harmonic", "amplitude": case.force, "frequency": case.frequency}
    joint = {"on": "joint", "pressure": case.pressure, "friction": case.friction}
    joint |= {"law": "coulomb"} if beta == inf else {"beta": beta}
    return scene_from(
        {
            "mesh": {"file": "built in memory"},
            "material": {"E": E, "density": DENSITY},
            "section": {"width": WIDTH, "thickness": THICKNESS},
            "support": {"fixed": ["fixed"]},
            "joint": [joint | {"normal_force": normal_force}],
            "damping": {"stiffness": damping},
            "load": [{"on": "free_end"} | (load or harmonic)],
            "time": time or {"cycles": 8, "steps_per_cycle": 200},
            "models": {"run": list(models)},
            "reduction": reduction or {},
            "output": {"vtk": True, "frames": frames} if frames else {},
        },
        _bar(case.length, case.linear, elements),
    )


def pulse(case, shape, rise_time):
    """Table of an impulsive load with the case's force as its peak."""
    return {"kind": shape, "peak": case.force, "rise_time": rise_time}


def pulses(case, rise_time, end):
    t, shapes = np.linspace(0.0, end, 501), (sj.Triangle, sj.HalfSine, sj.Versine, sj.RampAndHold)
    kinds = zip(PULSES, shapes, strict=True)
    return {"time_s": t} | {f"{name}_N": kind(case.force, rise_time)(t) for name, kind in kinds}


def _own(its):
    """Modes of the scene's own run, and the stretch that slips in it, for Gauss points.

    The package takes fewer times of that run and merges points that slip alike.
    """
    options, system, patch = options_of(its), its.system(), its.structure().patches[0]
    steps = its.n_steps if its.cycle_steps is None else min(its.n_steps, 3 * its.cycle_steps)
    save, modes = sj.Save(fields=True, points=False), options.mode_count
    training = sj.integrate(system, step=its.time_step, n_steps=steps, save=save)
    snapshots = snapshot_matrix(training.u, training.v, options.snapshots)
    V = orthonormal(proper_decomposition(snapshots).modes[:, :modes], system.M)
    peak, x = training.slip_peak[patch.points], its.structure().nodes[patch.nodes, 0]
    moving = peak > THRESHOLD * peak.max()
    basis = own_basis(system, training, Options(modes=modes, inner_product="euclidean"))
    lines = ((patch.points[moving], x[moving]),)
    return ScaledBasis(V, modes, basis.proper, basis.history, lines=lines)


def _reduced(its):
    """Reduced model of a scene, however few modes it has."""
    options, system = options_of(its), its.system()
    plan = Plan(its.time_step, its.n_steps, cycle_steps=its.cycle_steps)
    if options.reference == "self":
        basis = _own(its) if its.periodic else _own(its).for_decay()
        small = reduced_on(system, basis, **options.friction)
    else:
        small = model_of("reduced", its, enriched=True)
    length = small.origin.basis.active_length
    return Model("reduced", integrate_plan(small, plan), 0.0, length)


_MODELS = {}


def run(case, reduction=None, **options):
    """Full model of a case, or its reduced model with errors against the full one.

    Each is run once. Options as for `scene`.
    """
    key = repr((case, reduction, sorted(options.items())))
    if key not in _MODELS:
        its = scene(case, reduction, **options).changed(accuracy={"estimate": False})
        if reduction is None:
            _MODELS[key] = sj.run_scene(its).models["full"]
        else:
            made = _reduced(its)
            _MODELS[key] = replace(made, errors=compare(run(case, **options).run, made.run))
    return _MODELS[key]


def estimate_of(case):
    """Active length by Eqs. (17) to (20) of a case under its harmonic load, from its elements."""
    its = scene(case)
    return estimate_active_length(its.system(), active_zones(its.structure(), its.system())[0])


def peak(run):
    """Largest displacement of the free end in the last cycle, m."""
    return run.cycles.peak[-1, run.system.points.index("free_end")]


def loop_area(run):
    """Work of the load in the last cycle, J."""
    return run.cycles.input[-1].sum()


def friction(run):
    """Friction energy of the last cycle, J."""
    return run.cycles.friction[-1]


def fields(case, **options):
    """Positions (m) of a full model's nodes off the fixed end; their displacement and velocity."""
    structure, model = scene(case, **options).structure(), run(case, **options)
    x = structure.nodes[:, 0]
    order = np.argsort(x)[1:]
    return x[order], *(both[:, order, 0] for both in displacements(structure, model.run))


def active_percents(peak):
    """Active share of a joint for each threshold, percent, by the peaks of equidistant nodes."""
    distance = np.linspace(0.0, 100.0, peak.size, endpoint=False)
    return [measured(distance, peak[::-1], threshold) for threshold in THRESHOLDS]


def difference(full, reduced, point="free_end"):
    """Reduced minus full over time, percent of the full model's peak."""
    u = full.point(point)
    return 100.0 * (reduced.point(point) - u) / np.abs(u).max()


def energy_error(errors):
    """Signed error of the friction energy, per cycle where there are cycles, percent."""
    per_cycle = errors.friction_energy_per_cycle
    return 100.0 * (errors.friction_energy if per_cycle is None else per_cycle)


def aims_met(errors):
    """Whether the errors of peak displacement and of friction energy are within the aims."""
    aim, peak = printed("aim"), 100.0 * abs(errors.peak_displacement)
    energy = abs(energy_error(errors)) <= aim["friction_energy_percent"]
    return peak <= aim["displacement_percent"], energy


def aim_rows(item, name, errors):
    """Add rows of this project's aims for the default reduction with five modes."""
    aim, energy = printed("aim"), energy_error(errors)
    item.say("aims", name=name, errors=errors, aim=aim, energy=energy, met=aims_met(errors))


def modes_for_aims(case, **options):
    """Fewest modes of the default reduction that meet both aims; None beyond 15."""
    models = (run(case, DEFAULT | {"modes": count}, **options) for count in range(1, 16))
    within = (count for count, model in enumerate(models, 1) if all(aims_met(model.errors)))
    return next(within, None)
