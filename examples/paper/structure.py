"""Jointed structure: harmonic load (section 7.3, Fig. 19), impulse (section 7.4, Figs. 20, 21)."""

from dataclasses import replace
from math import inf, pi
from typing import NamedTuple

import numpy as np
from paper import cases
from paper.cases import CASES, DEFAULT, MOVED, PLAIN, PULSES, difference, run
from paper.page import limit_of, percent, printed, words
from scipy.ndimage import uniform_filter1d
from scipy.optimize import curve_fit
from scipy.signal import find_peaks

from skfem_joint import run_scene
from skfem_joint.system.modes import eigenmodes

CASE = CASES["structure"]
TIME = {"cycles": 12, "steps_per_cycle": 200}
#: Rows of a history that count as steady and as transient.
PARTS = {"steady state": slice(-201, None), "transient": slice(None, 800)}
POINTS = {"free_end": "free end", "junction": "junction"}
OURS, THEIRS = CHOICES = ("ours", "the paper's plain choice")
FRICTION_LAWS = {1e5: "beta 1e5 s/m", 1e7: "beta 1e7 s/m", inf: "Coulomb"}
#: Pulses and stiffness damping (s) whose decay is fitted; the first is the paper's, assumed.
DECAYS = (("triangle", 1e-5), ("ramp_and_hold", 1e-5), ("triangle", 1e-6), ("triangle", 0.0))


def resonances(length, count):
    """First natural frequencies of a plate held at one end, by finite elements, Hz."""
    system = cases.scene(replace(CASES["reference"], length=length)).system()
    return eigenmodes(system.K, system.M, count)[0]


def harmonic(beta, choice="", modes=5, **options):
    """Full model at 500 Hz, or its reduced model by a choice.

    A reduced model has no set-valued friction: beta 1e7 s/m stands for Coulomb in the plain choice.
    """
    choices = {OURS: DEFAULT, THEIRS: PLAIN | {"beta": min(beta, 1e7)}}
    reduction = choices[choice] | {"modes": modes} if choice else None
    return run(CASE, reduction, beta=beta, **({"time": TIME} | options))


def pulsed(shape):
    """Load and time of section 7.4."""
    load = cases.pulse(CASE, shape, printed("section7.4")["rise_time"])
    return {"load": load, "time": {"duration": 6e-3, "step": 2e-6}}


def impulse(shape, choice="", damping=1e-5):
    """Full model under a pulse of section 7.4, or its reduced model by a choice."""
    reduction = {OURS: DEFAULT, THEIRS: MOVED}.get(choice)
    return run(CASE, reduction, damping=damping, **pulsed(shape))


#: Two-parameter envelopes over dimensionless time, from a first amplitude of about one.
LAWS = {
    "linear": lambda t, a, r: a * (1.0 - r * t),
    "exponential": lambda t, a, r: a * np.exp(-r * t),
    "hyperbolic": lambda t, a, r: a / (1.0 + r * t),
}


class Envelope(NamedTuple):
    """Half swings of a history: middle (s), half the swing and its mean (m) of each."""

    time: np.ndarray
    amplitude: np.ndarray
    mean: np.ndarray

    @property
    def decrement(self):
        """Logarithmic decrement per cycle at each swing but the last."""
        return -2.0 * np.diff(np.log(self.amplitude))

    @property
    def frequency(self):
        """Frequency of the last swings, Hz."""
        return 0.5 / np.diff(self.time[-6:]).mean()

    def fits(self):
        """Least-squares fit of each law and its rms misfit, percent of the first amplitude."""
        t, a = (self.time - self.time[0]) / np.ptp(self.time), self.amplitude / self.amplitude[0]
        fits = {name: law(t, *curve_fit(law, t, a, p0=(1.0, 1.0))[0]) for name, law in LAWS.items()}
        misfits = {name: 100.0 * np.sqrt(np.mean((fit - a) ** 2)) for name, fit in fits.items()}
        return {name: (fit * self.amplitude[0], misfits[name]) for name, fit in fits.items()}


def envelope(run, point, period):
    """Swings of a point's history from one extreme to the next.

    Taking half swings instead of peaks leaves out the displacement that friction locks in.
    Extremes are found on a history smoothed over a quarter of the period, so that ripples on a
    flat crest do not count, and read from the history itself.
    """
    u = run.point(point)
    steps = period / (run.times[1] - run.times[0])
    smooth, near = uniform_filter1d(u, int(steps / 4)), int(steps / 8)
    kept = []
    extremes = [(int(r), sign) for sign in (1, -1) for r in find_peaks(sign * smooth)[0]]
    for row, sign in sorted(extremes):
        if not kept or sign != kept[-1][1]:
            kept.append((row, sign))
    x = np.array([sign * (sign * u[max(0, r - near) : r + near + 1]).max() for r, sign in kept])
    t = run.times[[row for row, _ in kept]]
    return Envelope(0.5 * (t[1:] + t[:-1]), 0.5 * np.abs(np.diff(x)), 0.5 * (x[1:] + x[:-1]))


def friction_share(run):
    """Friction's share of the dissipated energy, percent."""
    friction = run.friction_work.sum()
    return 100.0 * friction / (friction + run.viscous_work)


def _histories(item, full, plain, ours):
    """Curves of both points: displacements, and differences in percent of the full one's peak."""
    histories, differences = {"time (s)": full.times}, {"time (s)": full.times}
    if item.key == "section7.4":
        histories["force (N)"] = full.amplitudes[:, 0]
    for point, name in POINTS.items():
        histories[f"{name}, full (m)"] = full.point(point)
        for choice, reduced in (("plain choice", plain), ("ours", ours)):
            histories[f"{name}, reduced, {choice} (m)"] = reduced.point(point)
            differences[f"{name}, {choice} (%)"] = difference(full, reduced, point)
    item.curves |= {f"{item.key}_histories": histories, f"{item.key}_differences": differences}


def section7_3(item, quick):
    full = {beta: harmonic(beta) for beta in FRICTION_LAWS}
    reduced = {(of, beta): harmonic(beta, of) for of in CHOICES for beta in FRICTION_LAWS}
    ours, plain = (reduced[choice, 1e5] for choice in CHOICES)
    guess = cases.estimate_of(CASE)
    item.compare("first_resonance", resonances(CASE.linear + CASE.static_length, 1)[0])
    item.say("section7.3.first", factor=guess.factors[0])
    item.compare("amplification", None, guess.factor)
    scaled = 1e3 * item.printed["amplification"] * CASE.static_length
    why = f"differs: the printed factor times 50 mm is {scaled:.3g} mm, rounded up in print"
    item.compare("active_length", None, guess.length, otherwise=why)
    for beta, law in FRICTION_LAWS.items():
        what = f"active length of the full model, {law}, m"
        item.compare("active_length", full[beta].active_length["joint"], what=what)
    tried = (50, 100) if quick else (25, 50, 100, 200)
    kinds = [{"elements": n, "normal_force": k} for n in tried for k in ("equal", "consistent")]
    energies = [cases.friction(harmonic(inf, **kind).run) for kind in kinds]
    ends = min(energies), max(energies)
    _energy_rows(item, full, reduced, ends)
    needed, worst = _modes_for_junction(full[1e5].run, quick), 0.0
    for point, name in POINTS.items():
        for part, rows in PARTS.items():
            key = "_junction_transient" if (point, part) == ("junction", "transient") else ""
            says = item.printed[f"error{key}_percent"]
            for choice in CHOICES:
                errors = np.abs(difference(full[1e5].run, reduced[choice, 1e5].run, point))
                worst, most = errors.max(), errors[rows].max()
                off, where = most - limit_of(says), f"{name}, {part}, {choice}"
                item.say("section7.3.difference", **locals(), near=off < 0.0)
    finest, probed = tried[-1], ours.active_length["joint"]
    fine = cases.friction(harmonic(inf, time=TIME | {"steps_per_cycle": 800}).run)
    added = percent(cases.friction(full[1e5].run), cases.friction(full[inf].run))
    implied = percent(*(item.printed[f"friction_energy_{k}"] for k in ("reduced", "full")))
    peaks = [np.abs(full[1e5].run.point(point)).max() for point in POINTS]
    ratio, of_free_end = peaks[0] / peaks[1], worst * peaks[1] / peaks[0]
    rms, walls = plain.errors.by_point["junction"][0], (ours.run.wall_s, plain.run.wall_s)
    offs = [percent(cases.friction(m.run), cases.friction(full[1e5].run)) for m in (ours, plain)]
    item.say(**locals())
    _histories(item, full[1e5].run, plain.run, ours.run)
    both = cases.scene(CASE, DEFAULT, time=TIME, models=("full", "reduced"), frames=240)
    item.series["structure_harmonic"] = lambda: run_scene(both)


def _energy_rows(item, full, reduced, ends):
    """Rows of the friction energies; mesh and lumping leave it between the ``ends``, J."""
    (why,) = words("section7.3.why", ends=ends)
    for beta, law in FRICTION_LAWS.items():
        what, ours = f"friction energy per cycle, full, {law}, J", cases.friction(full[beta].run)
        item.compare("friction_energy_full", ours, otherwise=why, what=what)
    for (choice, beta), model in reduced.items():
        what = f"friction energy per cycle, reduced, {FRICTION_LAWS[beta]}, {choice}, J"
        item.compare("friction_energy_reduced", None, cases.friction(model.run), what=what)
    stated = item.printed["friction_energy_error_percent"]
    for (choice, beta), model in reduced.items():
        error = percent(cases.friction(model.run), cases.friction(full[beta].run))
        what, off, better = f"{FRICTION_LAWS[beta]}, {choice}", error - stated, abs(error) < stated
        item.say("section7.3.energy", **locals())
    values = [item.printed[f"friction_energy_{key}"] for key in ("reduced", "full")]
    error, off = percent(*values), percent(*values) - stated
    item.say("section7.3.printed", **locals(), near=abs(off) <= 0.5)


def _modes_for_junction(full, quick):
    """Fewest modes of the plain choice with less than 1 % at the junction in steady state."""
    limit = limit_of(printed("section7.3")["error_percent"])
    for modes in range(5, 16, 2 if quick else 1):
        errors = difference(full, harmonic(1e5, THEIRS, modes).run, "junction")
        if np.abs(errors[PARTS["steady state"]]).max() < limit:
            return modes
    return 16


def section7_4(item, quick):
    first, _, third = resonances(CASE.linear + CASE.static_length, 3)
    item.compare("third_resonance", third)

    def most(shape, choice, damping=1e-5):
        runs = impulse(shape, "", damping).run, impulse(shape, choice, damping).run
        return [np.abs(difference(*runs, point)).max() for point in POINTS]

    for k, (point, name) in enumerate(POINTS.items()):
        for choice in CHOICES:
            value, stated = most("triangle", choice)[k], item.printed[f"error_percent_{point}"]
            fields = {"value": value, "off": value - stated, "better": value < stated}
            item.say("section7.4.difference", name=name, choice=choice, stated=stated, **fields)
    for shape, damping in [(shape, 1e-5) for shape in PULSES[1:]] + [("triangle", 1e-6)]:
        for choice in CHOICES:
            changed = shape.replace("_", " ") if shape != "triangle" else f"C = {damping:g} s · K"
            item.say("section7.4.others", **locals(), values=most(shape, choice, damping))
    text = []
    for shape in PULSES:
        active, full = impulse(shape).active_length["joint"] / CASE.length, impulse(shape).run
        energy, share = full.friction_work.sum(), friction_share(full)
        shown = shape.replace("_", " ")
        text += words("section7.4.pulse", **locals())
    item.say(text="; ".join(text))
    item.curves["fig20"] = cases.pulses(CASE, item.printed["rise_time"], 1.6e-4)
    _envelopes(item, 1.0 / first)
    _histories(item, *(impulse("triangle", choice).run for choice in ("", THEIRS, OURS)))


def _envelopes(item, period):
    """Add rows, notes and curves of the free end's decay; ``period`` of the first resonance, s."""
    runs = [impulse(shape, "", damping).run for shape, damping in DECAYS]
    swings = [envelope(run, "free_end", period) for run in runs]
    shares, misfits = [friction_share(run) for run in runs], []
    for k, ((shape, damping), swing) in enumerate(zip(DECAYS, swings, strict=True)):
        fits, share, shown = swing.fits(), shares[k], shape.replace("_", " ")
        misfits.append({law: misfit for law, (_, misfit) in fits.items()})
        best, values, laws = min(misfits[k], key=misfits[k].get), [*misfits[k].values()], [*fits]
        curved = best != "linear", f"{shown}, C = {damping:g} s · K"
        item.say("decay.envelope", **locals())
        curve = {"time (s)": swing.time, "amplitude (m)": swing.amplitude, "mean (m)": swing.mean}
        curve |= {f"{law} fit (m)": fit for law, (fit, _) in fits.items()}
        item.curves[f"section7.4_envelope_{k + 1}"] = curve
    paper, held, _, bare = swings
    decrements = [swing.decrement[k] for swing in (bare, paper, held) for k in (0, -1)]
    viscous = 2.0 * pi**2 * DECAYS[0][1] * paper.frequency
    ends = paper.mean[-1], paper.amplitude[-1]
    item.say("decay", **locals())
