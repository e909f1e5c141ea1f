"""Cost of the reduced model (section 7.5, Fig. 22), and its error against the number of modes."""

from dataclasses import replace

import numpy as np
from benchmarks.explicit import runge_kutta, stable_step
from paper import cases, structure
from paper.cases import CASES, DEFAULT, MOVED, OWN, PLAIN, aim_rows, energy_error, run
from paper.page import printed
from scipy import linalg
from scipy.optimize import bisect

from skfem_joint import Contact, ConvergenceError, RampAndHold, Save, integrate

CASE = CASES["reference"]
MODES, CYCLES, STEPS = 15, 3, 200
NO_ROWS = {"check": False, "save": Save(points=False)}


def _reference(reduction):
    return cases.run(CASE, reduction, time={"cycles": CYCLES, "steps_per_cycle": STEPS})


def systems(modes=5):
    """Full reference system and its projection on its own first displacement modes."""
    V = _reference(MOVED | OWN | {"modes": MODES}).basis.V
    full = cases.scene(CASE).system()
    return {"full": full, "reduced": full.project(V[:, :modes])}


def without_friction(system, damped):
    """Linear part of a system, with or without C, under a step load."""
    step_load = RampAndHold(CASE.force, 1e-12)
    loads = tuple(replace(load, amplitude=step_load) for load in system.loads)
    C = system.C if damped else 0.0 * system.C
    return replace(system, contact=Contact.none(system.n), C=C, loads=loads)


def largest_frequency(system):
    """Largest natural frequency of K and M, rad/s."""
    K, M = (A if system.is_dense else A.toarray() for A in (system.K, system.M))
    return np.sqrt(linalg.eigh(K, M, eigvals_only=True)[-1])


def measured_step(system, near, n_steps):
    """Largest stable Runge-Kutta step (s) of a linear system, by bisection about ``near``.

    A run is unstable if a named point exceeds a thousand times its static displacement.
    """
    limit = 1e3 * CASE.force * CASE.length / cases.STIFFNESS

    def is_stable(logarithm):
        try:
            run = runge_kutta(system, step=np.exp(logarithm), n_steps=n_steps, check=False)
        except ConvergenceError:
            return -1.0
        return 1.0 if run.peak.max() <= limit else -1.0

    return np.exp(bisect(is_stable, np.log(near / 3.0), np.log(3.0 * near), xtol=2e-3))


def chatter(system, step):
    """Error of the slip velocities after a Runge-Kutta run with friction and this step, percent.

    Against an implicit run, relative to the largest slip velocity; steps beyond the stable one.
    """
    n_steps = min(2000, int(0.2 / CASE.frequency / step))
    run = runge_kutta(system, step=step, n_steps=n_steps, **NO_ROWS)
    exact = integrate(system, step=step * n_steps / STEPS, n_steps=STEPS, save=Save(points=False))
    slip = system.contact.B @ exact.final[1]
    return 100.0 * np.abs(system.contact.B @ run.final[1] - slip).max() / np.abs(slip).max()


def operations_full(n):
    """Operations for the accelerations of a full model with ``n`` unknowns, section 7.5."""
    return 38 * n - 24


def operations_reduced(n, j):
    """Operations with ``j`` modes: expansion and compression, then the accelerations."""
    return (4 * n * j - n - j) + (j * j - j)


def section7_5(item, quick):
    both = systems()
    frequencies = [largest_frequency(system) for system in both.values()]
    item.compare("step_factor", frequencies[0] / frequencies[1])
    parts = {
        "K and M alone": {name: without_friction(system, False) for name, system in both.items()},
        "with C": {name: without_friction(system, True) for name, system in both.items()},
        "with C and friction, beta 1e5 s/m": both,
    }
    computed, measured, n = {}, {}, 500 if quick else 1500
    for part, pair in parts.items():
        computed[part] = {name: stable_step(system) for name, system in pair.items()}
    for part in [*parts][:2]:
        near = computed[part].items()
        measured[part] = {name: measured_step(parts[part][name], step, n) for name, step in near}
    for how, steps_by_part in {"computed": computed, "measured": measured}.items():
        for part, steps in steps_by_part.items():
            factor, what = steps["reduced"] / steps["full"], f"{part}, {how}"
            item.say("section7.5.step", part=part, how=how, steps=steps)
            what = f"factor of the stable step, {what}"
            item.compare("step_factor", None, factor, what=what, form=".3g")
    n, counts = both["full"].n, np.arange(1, MODES + 1)
    item.compare("operations_full_100", operations_full(n))
    item.compare("operations_reduced_5", None, operations_reduced(n, 5))
    saving = counts[operations_reduced(n, counts) < operations_full(n)]
    item.compare("break_even_modes", None, int(saving[-1]))
    steps = computed["with C"]
    chattering = {name: chatter(system, 0.5 * steps[name]) for name, system in both.items()}
    item.say("section7.5.chatter", chattering=chattering)
    _add_times(item, quick, computed, chattering)


def _implicit(system, repeats):
    """Wall time (s) and Newton iterations a step, best of ``repeats``."""
    n = CYCLES * STEPS
    runs = [integrate(system, step=1.0 / CASE.frequency / STEPS, n_steps=n) for _ in range(repeats)]
    return min(run.wall_s for run in runs) / n, runs[0].counters.newton_iterations / n


def _explicit(system, repeats):
    """Wall time of a Runge-Kutta step, s, best of ``repeats``; too short for the step to matter."""
    runs = (runge_kutta(system, step=1e-10, n_steps=200, **NO_ROWS) for _ in range(repeats))
    return min(run.wall_s for run in runs) / 200


def _add_times(item, quick, computed, chattering):
    repeats, counts = (1, np.array([1, 5, 9, 15])) if quick else (3, np.arange(1, MODES + 1))
    full = systems()["full"]
    (full_time, full_iterations), full_explicit = _implicit(full, repeats), _explicit(full, repeats)
    few = [_reference(DEFAULT | {"modes": int(j)}).run.system for j in counts]
    projected = [systems(int(j))["reduced"] for j in counts]
    every = np.array([_implicit(system, repeats) for system in projected])
    gauss = np.array([_implicit(system, repeats) for system in few])
    explicit = np.array([_explicit(system, repeats) for system in projected])
    five = int(np.flatnonzero(counts == 5)[0])
    points, micro = few[five].contact.w.size, (every[five, 0], gauss[five, 0], explicit[five])
    item.say("section7.5.times", **locals())
    for label, times in (("all nodes", every[:, 0]), ("Gauss points", gauss[:, 0])):
        most, last = max(counts[times < full_time], default=0), counts[-1]
        saves = f"{most} of {last}" if most else "none"
        same = most == item.printed["break_even_modes"]
        item.say("section7.5.saving", label=label, saves=saves, same=same)
    n, j = full.n, counts.astype(float)
    item.curves["section7.5_cost"] = {
        "modes": j,
        "operations, reduced": operations_reduced(n, j),
        "operations, full": np.full(j.size, float(operations_full(n))),
        "implicit step, all nodes (s)": every[:, 0],
        "implicit step, Gauss points (s)": gauss[:, 0],
        "implicit step, full (s)": np.full(j.size, full_time),
        "Newton iterations a step, all nodes": every[:, 1],
        "Newton iterations a step, Gauss points": gauss[:, 1],
        "Runge-Kutta step, all nodes (s)": explicit,
        "Runge-Kutta step, full (s)": np.full(j.size, full_explicit),
    }
    _, damped, stiff = computed.values()
    factors = [steps["reduced"] / steps["full"] for steps in (damped, stiff)]
    iterations, ends = (every[five, 1], gauss[five, 1]), (explicit.min(), explicit.max())
    item.say(**locals())


IMPULSE = "structure, impulse"
#: Systems that are reduced, by their names in rows.
SYSTEMS = {name: f"Case {name}" for name in ("I", "IV", "V", "VI", "VII")}
SYSTEMS |= {"structure": "structure, harmonic", IMPULSE: IMPULSE}
SWEPT = ("I", "VI", "VII", "structure")
CHOICES = ("ours", "the paper's plain choice", "own modes")
#: Keys that are changed in the plain choice, each alone.
CHANGES = {
    "nothing": {},
    "velocity snapshots as well": {"snapshots": "both"},
    "mass inner product": {"inner_product": "mass"},
    "active length from a probe run": {"active_length": "auto"},
    "friction at Gauss points": {"friction_points": "auto"},
    "beta that the modes resolve": {"beta": "auto"},
    "six interface modes": {"interface_modes": 6},
}
#: Measures of the error (percent), and the project's aim that each is judged by.
MEASURES = {
    "peak": (lambda errors: 100.0 * errors.peak_displacement, "displacement"),
    "free end at any time": (lambda errors: 100.0 * errors.by_point["free_end"][1], "displacement"),
    "any point at any time": (lambda errors: 100.0 * errors.displacement_max, "displacement"),
    "friction energy": (energy_error, "friction_energy"),
}


def errors(system, choice, modes=5, **changes):
    """Errors of a system's reduced model with one of `CHOICES`, and with keys of it changed."""
    # In these the estimate by Eq. (17) does not settle, or does not apply.
    plain = MOVED if system in ("IV", "V", "VII", IMPULSE) else PLAIN
    reduction = dict(zip(CHOICES, (DEFAULT, plain, DEFAULT | OWN), strict=True))[choice]
    reduction = reduction | {"modes": modes} | changes
    if system == IMPULSE:
        return run(structure.CASE, reduction, **structure.pulsed("triangle")).errors
    options = {"time": structure.TIME} if system == "structure" else {}
    return run(CASES[system], reduction, **options).errors


def _enough(counts, values, aim):
    """Fewest modes from which on the error stays within the aim."""
    missed = np.flatnonzero(np.abs(values) > aim)
    enough = counts[missed[-1] + 1 :] if missed.size else counts
    return str(enough[0]) if enough else f"more than {counts[-1]}"


def modes(item, quick):
    aim, counts = printed("aim"), [5, 9] if quick else list(range(1, 16))
    item.marks |= {name.removesuffix("_percent"): value for name, value in aim.items()}
    for system, name in SYSTEMS.items():
        aim_rows(item, name, errors(system, "ours"))
    for system, name in SYSTEMS.items():
        for choice in CHOICES[1:]:
            values = [of(errors(system, choice)) for of, _ in MEASURES.values()]
            item.say("modes.five", name=name, choice=choice, values=values)
    changed = ("structure",) if quick else ("I", "VI", "structure")
    names = [SYSTEMS[system] for system in changed]
    for change, keys in CHANGES.items():
        energies = [energy_error(errors(system, CHOICES[1], **keys)) for system in changed]
        item.say("modes.changed", change=change, names=names, energies=energies)
    for system in SWEPT:
        curves = []
        for choice in CHOICES:
            swept = [errors(system, choice, count) for count in counts]
            curves.append({"modes": np.array(counts, float)})
            for measure, (of, _) in MEASURES.items():
                curves[-1][f"{measure} (%)"] = np.array([of(each) for each in swept])
            plain = choice.replace(" ", "_").replace("'", "")
            item.curves[f"modes_{system}_{plain}"] = curves[-1]
        for measure in ("peak", "free end at any time", "friction energy"):
            limit, name = item.marks[MEASURES[measure][1]], SYSTEMS[system]
            needed = [_enough(counts, curve[f"{measure} (%)"], limit) for curve in curves]
            item.say("modes.needed", **locals(), choices=CHOICES)
    met = {}
    for measure, (of, judge) in MEASURES.items():
        values = {name: of(errors(system, "ours")) for system, name in SYSTEMS.items()}
        within = [name for name, value in values.items() if abs(value) <= item.marks[judge]]
        met[measure] = within or ["none"]
    ours, plain, own = (energy_error(errors("VI", choice)) for choice in CHOICES)
    item.say(**locals())
