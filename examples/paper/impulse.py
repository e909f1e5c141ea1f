"""Impulse on the joint, section 7.2: Figs. 15, 16 and 17."""

from functools import cache
from typing import NamedTuple

import numpy as np
from paper import cases
from paper.cases import CASES, DEFAULT, MOVED, OWN, PLAIN, PULSES, difference, run
from paper.page import limit_of, printed

from skfem_joint.reduction.pod import ProperModes, proper_decomposition

CASE = CASES["VII"]
DURATION, STEP = 2e-3, 1e-6
DAMPINGS = (1e-5, 1e-6, 1e-7)
#: Reduced models of Fig. 17 by the paper's numbers: name, and keys that the choices change by.
MODELS = {
    "ii": ("5 modes of the impulse", OWN),
    "iii": ("11 modes of the impulse", OWN | {"modes": 11}),
    "iv": ("5 modes of the harmonic run", {}),
}
#: Choices with their pulses; ours with the full model's beta.
CHOICES = (
    ("plain", PULSES[0], MOVED),
    ("default", PULSES[0], DEFAULT),
    ("plain, ramp_and_hold", PULSES[-1], MOVED),
)
STEEP = DEFAULT | {"beta": PLAIN["beta"]}


def _pulse(shape, **options):
    """Options of one pulse: the text calls it an impulse, captions of Figs. 16 and 17 a step."""
    load = cases.pulse(CASE, shape, printed("fig15")["rise_time"])
    return {"load": load, "time": {"duration": DURATION, "step": STEP}} | options


def _run(shape, reduction=None, **options):
    return run(CASE, reduction, **_pulse(shape, **options))


class _Full(NamedTuple):
    """Full model under a pulse: active length for thresholds 1e-3 and 1e-4, percent of the joint.

    ``first`` holds the first proper value over 0.2, 0.5 and 2 ms, percent.
    """

    position: np.ndarray
    proper: ProperModes
    active: list[float]
    first: list[float]


@cache
def _full(shape=PULSES[0], damping=DAMPINGS[0]):
    x, u, _ = cases.fields(CASE, damping=damping, **_pulse(shape, frames=round(DURATION / STEP)))
    parts = (u[: round(end / STEP) + 1] for end in (2e-4, 5e-4, DURATION))
    first = [proper_decomposition(part).proper_values[0] for part in parts]
    active = cases.active_percents(np.abs(u).max(axis=0))
    return _Full(x, proper_decomposition(u), active, first)


def fig15(item, quick):
    full, decomposed = _run(PULSES[0]), _full()
    item.compare("active_percent", decomposed.active[0])
    item.compare("first_proper_value", decomposed.first[-1])
    of_five, stated = decomposed.proper.cumulative[4], item.printed["cumulative_of_five"]
    item.say("fig15.sum", of_five=of_five, near=of_five > limit_of(stated))
    u, f = full.run.point("free_end"), full.run.amplitudes[:, 0]
    curve = {"time_s": full.run.times, "force_N": f, "i_full_m": u}
    for key, (label, changes) in MODELS.items():
        same_law = _run(PULSES[0], STEEP | changes).errors.displacement_max
        for choice, shape, options in CHOICES:
            most = _run(shape, options | changes).errors.displacement_max
            near = 100.0 * most < limit_of(item.printed["error_percent"])
            why = f"with the full model's beta it errs by {100 * same_law:.2f} %"
            fields = {"near": near, "why": why if choice == "default" else "more modes are needed"}
            item.say("fig15.error", key=key, label=label, choice=choice, most=most, **fields)
    for choice, shape, options in CHOICES[:2]:
        for key, (_, changes) in MODELS.items():
            reduced = _run(shape, options | changes).run
            curve[f"{key}_{choice}_m"] = reduced.point("free_end")
            curve[f"error_{key}_{choice}_percent"] = difference(full.run, reduced)
    item.curves["fig15_fig17"] = curve
    errors = [_run(PULSES[0], choice).errors for choice in (DEFAULT, STEEP, MOVED)]
    cases.aim_rows(item, "impulse on the joint", errors[0])
    fine = _run(PULSES[0], time={"duration": DURATION, "step": STEP / 4.0}).run.point("free_end")
    step_error = np.abs(u - fine[::4]).max() / np.abs(u).max()
    probe = _run(PULSES[0], MOVED).active_length["joint"] / CASE.length
    item.say(**locals())
    shapes = decomposed.proper.modes[:, :5] * np.sign(decomposed.proper.modes[-1, :5])
    columns = {f"mode_{k + 1}": shapes[:, k] for k in range(5)}
    item.curves["fig16"] = {"position_m": decomposed.position} | columns
    active = {"ours": decomposed.active[0], "published": item.printed["active_percent"]}
    item.marks |= {f"grey_{k}": CASE.length * (1.0 - x / 100.0) for k, x in active.items()}
    item.curves["fig15_pulses"] = cases.pulses(CASE, item.printed["rise_time"], 1e-4)
    _sensitivity(item, PULSES[:: 3 if quick else 1])


def _sensitivity(item, shapes):
    """Active length and first proper value by shape of the pulse and damping."""
    lines = []
    for shape in shapes:
        runs = [_full(shape, damping) for damping in DAMPINGS]
        curve = item.curves[f"fig15_sensitivity_{shape}"] = {
            "damping_s": np.array(DAMPINGS),
            "active_length_percent": np.array([full.active[0] for full in runs]),
            "active_length_lower_percent": np.array([full.active[1] for full in runs]),
            "first_proper_value_percent": np.array([full.first[-1] for full in runs]),
            "cumulative_of_five_percent": np.array([full.proper.cumulative[4] for full in runs]),
        }
        for k, end in enumerate(("0.2", "0.5", "2")):
            values = np.array([full.first[k] for full in runs])
            curve[f"first_proper_value_of_{end}_ms_percent"] = values
        rows = zip(*list(curve.values())[1:4], strict=True)
        line = ", ".join(f"{a:.0f} ({lower:.0f}) and {value:.1f} %" for a, lower, value in rows)
        lines.append(f"{shape.replace('_', ' ')}: {line}")
    item.say("fig15.sensitivity", text="; ".join(lines), dampings=DAMPINGS)
