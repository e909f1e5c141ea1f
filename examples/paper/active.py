"""Section 6: active length under harmonic and impulsive loads (Figs. 6, 7 and 10, Table 2)."""

from dataclasses import replace
from functools import cache
from math import inf, nan, pi

import numpy as np
from paper import cases
from paper.cases import CASES, PULSES, THRESHOLDS, active_percents
from paper.page import percent, printed
from paper.structure import resonances
from scipy.optimize import minimize_scalar

from skfem_joint.reduction.scaled.estimated_length import (
    DAMPING_RATIO,
    amplification,
    estimate,
)

HARMONIC = ("I", "II", "III")
LEVELS = (0.5, 0.6, 0.7)


def natural_frequency(length):
    """First natural frequency of a bar held at one end, Hz."""
    return cases.SPEED / (4.0 * length)


def iterated(case, frequency, most=60, tolerance=1e-4):
    """Active length of a case by Eqs. (17) to (20)."""
    return estimate(case.static_length, frequency, natural_frequency, most, tolerance)


def iteration_limits():
    """Frequencies over the static length's resonance at which the iteration of A_a fails.

    With r the ratio at a fixed point, an error of an iterate grows by d ln A_a / d ln r
    = 2 r^2 (1 - 2 zeta^2 - r^2) A_a^2 in the next one. It grows for 1 at the first limit, where
    the fixed point vanishes and the iteration jumps to a larger one, and for -1 at the second,
    r = 1, where A_a = 1 / (2 zeta): beyond it the iteration swings about resonance.
    """
    a = 2.0 - 4.0 * DAMPING_RATIO**2
    ratio = np.sqrt((a - np.sqrt(a * a - 3.0)) / 3.0)
    return ratio / amplification(ratio), 2.0 * DAMPING_RATIO


def fig6(item, quick):
    case = CASES["I"]
    length, static = case.static_length, case.static_resonance
    iteration = iterated(case, case.frequency)
    elements = cases.estimate_of(case)
    second, element_second = (result.factors[0] * length for result in (iteration, elements))
    item.compare("first", iteration.factors[0], elements.factors[0])
    item.compare("second_frequency", natural_frequency(second))
    stated, count = item.printed["second_length_mm"], item.printed["iterations"]
    same, off = abs(second - stated) <= 0.5e-4, percent(second, stated)
    item.say("fig6.second", **locals())
    item.compare("converged", iteration.factor, elements.factor)
    at_print = iterated(case, case.frequency, count).factor
    item.compare("converged", at_print, what=f"A_a after {count} iterations")
    counts = [len(iterated(case, case.frequency, 60, e).factors) for e in (1e-3, 1e-4, 1e-5)]
    between, (jump, edge) = counts[0] <= count <= counts[-1], iteration_limits()
    before, after = (iterated(case, x * jump * static, 4000).factor for x in (0.999, 1.001))
    frequencies, damping = (jump * static, edge * static), DAMPING_RATIO
    longer, static_ratio = printed("table4")["active_length_stated"], case.frequency / static
    longer_factor = longer / length
    item.say(**locals())
    item.marks |= {"jump": jump, "edge": edge}
    factors = np.array([1.0, *iteration.factors])
    item.curves["fig6"] = {"iteration": np.arange(0.0, factors.size), "factor": factors}
    shares = np.linspace(0.02, 1.2, 20 if quick else 237)
    settled = [iterated(case, share * static, 600) for share in shares]
    ends = [result.factors[-1 if result.converged else -8 :] for result in settled]
    item.curves["fig6_sweep"] = {
        "frequency_over_static_resonance": shares,
        "least_of_last_iterates": np.array([min(end) for end in ends]),
        "largest_of_last_iterates": np.array([max(end) for end in ends]),
    }
    curve = item.curves["fig6_iterates"] = {"iteration": np.arange(31.0)}
    for share in (0.4, 0.42, 0.43, 0.5):
        values = [1.0, *iterated(case, share * static, 30).factors]
        curve[f"at {share * static:.0f} Hz"] = np.pad(values, (0, 31 - len(values)), "edge")


@cache
def full_active(key, frequency, beta=1e5, damping=1e-5, elements=100):
    """Active length of the full model over six cycles of 100 steps, percent of the joint.

    Over the whole run for both thresholds, and in the last cycle alone for the first.
    """
    case, time = replace(CASES[key], frequency=frequency), {"cycles": 6, "steps_per_cycle": 100}
    options = {"beta": beta, "damping": damping, "elements": elements}
    _, u, _ = cases.fields(case, time=time, frames=600, **options)
    settled = active_percents(0.5 * np.ptp(u[-101:], axis=0))[0]
    return *active_percents(np.abs(u).max(axis=0)), settled


def _estimated(key, frequency):
    """Estimate by Eqs. (17) to (20), percent of the joint; NaN where it does not converge."""
    iteration = iterated(CASES[key], frequency)
    return 100.0 * iteration.length / CASES[key].length if iteration.converged else nan


@cache
def _longest(key):
    """Frequency at which the full model's active length is longest, over the static resonance."""
    static = CASES[key].static_resonance
    options = {"bounds": (0.3, 1.2), "method": "bounded", "options": {"xatol": 0.01}}
    return float(minimize_scalar(lambda x: -full_active(key, x * static)[0], **options).x)


def _halves(key):
    """50 % of the resonance (Hz): r = 0.5 in Eq. (17), or half of the frequency of longest slip."""
    static = CASES[key].static_resonance
    return {"Eq. (17)": 0.5 * static / amplification(0.5), "longest": 0.5 * _longest(key) * static}


def _error_rows(item, key, meaning, frequency):
    stated, estimated = printed("fig7")[f"error_percent_case_{key}"], _estimated(key, frequency)
    for length, threshold in zip(full_active(key, frequency), THRESHOLDS, strict=False):
        error, element = percent(estimated, length), 100.0 / length  # one of a hundred
        near, better = abs(abs(error) - stated) <= element, abs(error) < stated
        item.say("table2.error", **locals(), above=f"{threshold:.0e}")


def table2(item, quick):
    longer, less = [], []
    for key, letter in zip(HARMONIC, "abc", strict=True):
        static = CASES[key].static_resonance
        item.compare(f"resonance_case_{key}", resonances(CASES[key].static_length, 1)[0])
        for meaning, frequency in _halves(key).items():
            _error_rows(item, key, meaning, frequency)
        frequencies = (static * np.linspace(0.05, 1.2, 8 if quick else 24)).tolist()
        first, second, settled = np.transpose([full_active(key, f) for f in frequencies])
        item.curves[f"fig7{letter}"] = {
            "frequency_Hz": np.array(frequencies),
            "full_1e-3_percent": first,
            "full_1e-4_percent": second,
            "full_settled_1e-3_percent": settled,
            "estimate_percent": np.array([_estimated(key, f) for f in frequencies]),
        }
        longer += [*(second - first)]
        less += [*(first - settled)]
        item.marks |= {f"half_{key}": _halves(key)["Eq. (17)"], f"static_{key}": static}
    half = {key: _halves(key)["Eq. (17)"] for key in HARMONIC}

    def errors(which=0, keys=HARMONIC, **options):
        lengths = (full_active(key, half[key], **options)[which] for key in keys)
        return [percent(_estimated(k, half[k]), x) for k, x in zip(keys, lengths, strict=True)]

    coulomb, plain, lower, damped = errors(beta=inf), errors(), errors(1), errors(damping=1e-6)
    longest = [_longest(key) for key in HARMONIC]
    loss = [2e-5 * pi * half[key] for key in HARMONIC]
    finer, ends, settled = errors(0, ("III",), elements=400), (min(longer), max(longer)), max(less)
    item.say(**locals())


@cache
def pulse_active(level, frequency, shape="triangle", damping=1e-5):
    """Active length of Case I under a pulse, percent of the joint, for each threshold.

    ``frequency`` is the highest one in the pulse by the paper's rule, 1 / (2 rise time).
    """
    case, rise = replace(CASES["I"], force=level * CASES["I"].limit), 0.5 / frequency
    time = {"duration": 2.0 * rise + 1e-3, "step": rise / 25.0}
    load = cases.pulse(case, shape, rise)
    _, u, _ = cases.fields(case, load=load, time=time, damping=damping, frames=10**6)
    return active_percents(np.abs(u).max(axis=0))


def fig10(item, quick):
    fewer = (1000, 4500, 12000)
    more = (500, 1000, 2000, 3000, 4000, 4500, 5000, 6000, 8000, 10000, 12000, 15000)
    frequencies = np.array(fewer if quick else more, dtype=float)
    active = {a: np.array([pulse_active(a, float(f)) for f in frequencies]) for a in LEVELS}
    low, (high, lower) = pulse_active(0.5, 4500.0)[0], pulse_active(0.7, 4500.0)
    scaled = low * 0.7 / 0.5  # by the ratio of the peaks (section 6.2)
    item.compare("active_50_percent_4500_hz_percent", low)
    item.compare("scaled_to_70_percent", scaled)
    item.compare("actual_70_percent", high)
    stated, rule = item.printed["error_percent"], percent(scaled, high)
    holds = abs(rule) < stated
    errors = [percent(a / 0.5 * active[0.5][:, 0], active[a][:, 0]) for a in LEVELS[1:]]
    ranges = [f"{error.min():+.1f} to {error.max():+.1f}" for error in errors]
    for k, threshold in enumerate(("1e-3", "1e-4")):
        columns = {f"active_{100 * a:.0f}_percent_load_percent": v[:, k] for a, v in active.items()}
        item.curves[f"fig10_{threshold}"] = {"highest_frequency_Hz": frequencies} | columns
    lines = []
    for shape in PULSES:
        line = f"| {shape.replace('_', ' ')} |"
        for damping in (1e-5, 1e-6):
            at50, at70 = (pulse_active(level, 4500.0, shape, damping)[0] for level in (0.5, 0.7))
            line += f" {at50:.0f} %, {at70:.0f} %, {percent(at50 * 0.7 / 0.5, at70):+.1f} % |"
        lines.append(line)
    table = "\n".join(lines)
    item.say(**locals())
