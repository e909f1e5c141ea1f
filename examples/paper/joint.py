"""Sections 2 to 4: mesh, friction law (Figs. 2 to 4), proper modes (Table 1, Fig. 5)."""

from dataclasses import replace
from functools import cache
from math import inf, pi, tan

import numpy as np
from paper import pseudo_static
from paper.cases import CASES, STIFFNESS, friction, loop_area, peak, run
from paper.page import percent

from skfem_joint.minimise.law import force as friction_force
from skfem_joint.reduction.pod import proper_decomposition
from skfem_joint.reduction.scaled import reference as package
from skfem_joint.results.history import hysteresis_loop

REFERENCE, WEAK = CASES["reference"], CASES["weak"]
LESSER = replace(REFERENCE, force=0.7 * REFERENCE.force)
#: Slow enough for inertia and viscous damping to vanish, and the paper's own low frequency, Hz.
SLOW = 5.0
BETAS = (1e5, 1e6, 1e7, inf)
#: Modes of Table 1.
COUNT = 5


def reference_run(frequency, beta, case=REFERENCE, steps=200, **options):
    """Full model of the reference joint over four cycles."""
    time = {"cycles": 4, "steps_per_cycle": steps}
    return run(replace(case, frequency=frequency), beta=beta, time=time, **options).run


def _name(beta):
    return "Coulomb" if beta == inf else f"β = {beta:.0e} s/m".replace("e+0", "e")


def fig2(item, quick):

    def peak_of(elements, kind):
        return peak(reference_run(1000.0, 1e5, elements=int(elements), normal_force=kind))

    fewer, more = (5, 10, 100, 400), (5, 7, 10, 15, 20, 30, 50, 70, 100, 150, 200, 400)
    meshes = np.array(fewer if quick else more)
    peaks = {k: np.array([peak_of(n, k) for n in meshes]) for k in ("equal", "consistent")}
    fine = peak_of(800, "consistent")
    change = {kind: 100.0 * (values / fine - 1.0) for kind, values in peaks.items()}
    # Equal forces put half an element's friction too much beside the load.
    lumping = 100.0 * ((1.0 - REFERENCE.limit / meshes / (2.0 * REFERENCE.force)) ** 2 - 1.0)
    at, coarse = (int(np.flatnonzero(meshes == n)[0]) for n in (100, 10))
    equal, consistent = (values[at] for values in change.values())
    to_finest, by_formula = percent(peaks["equal"][at], peaks["equal"][-1]), lumping[at]
    explained, better = 100.0 * (1.0 - consistent / equal), abs(consistent) < abs(equal)
    near = abs(to_finest) < 1.0, abs(equal) < 1.0
    finest, finest_error = meshes[-1], change["equal"][-1]
    at_ten = [values[coarse] for values in change.values()]
    item.say(**locals())
    item.curves["fig2a"] = {"elements": meshes.astype(np.float64)}
    item.curves["fig2a"] |= {f"peak_{kind}_m": values for kind, values in peaks.items()}
    item.curves["fig2a"] |= {f"change_{kind}_percent": values for kind, values in change.items()}
    item.curves["fig2a"]["change_by_lumping_percent"] = lumping
    _hysteresis(item)


def _hysteresis(item):
    """Fig. 2(b): loops of two loads against the pseudo-static ones, and their printed area."""
    stated, steps = item.printed["loop_energy"], 400
    slow = {case: reference_run(SLOW, inf, case, steps) for case in (REFERENCE, LESSER)}
    fast = reference_run(REFERENCE.frequency, 1e5)
    for case, full in slow.items():
        share, areas = case.force / case.limit, (case.static_loop_area, loop_area(full))
        offs, from_static = [percent(area, stated) for area in areas], percent(areas[1], areas[0])
        same = abs(offs[0]) < 0.1
        item.say("fig2.loop", **locals())
        u, f = hysteresis_loop(full, "free_end", rows_per_cycle=steps)
        u_static, _ = case.static(pseudo_static.loop, np.linspace(0.0, 2.0 * pi, steps + 1))
        curve = {"force_N": f, "displacement_5Hz_m": u, "displacement_pseudo_static_m": u_static}
        item.curves[f"fig2b_{case.force / 1e3:.1f}kN"] = curve
    u, f = hysteresis_loop(fast, "free_end", rows_per_cycle=200)
    item.curves["fig2b_1000Hz"] = {"force_N": f, "displacement_m": u}
    area, viscous, off = loop_area(fast), fast.cycles.viscous[-1], percent(loop_area(fast), stated)
    same = abs(off) < 0.5
    # The force whose closed-form loop has the printed area.
    implied = (1.5 * stated * STIFFNESS * REFERENCE.tau) ** (1.0 / 3.0)
    share, runs = implied / REFERENCE.limit, (slow[REFERENCE], reference_run(SLOW, 1e5), fast)
    from_static = [percent(loop_area(run), REFERENCE.static_loop_area) for run in runs]
    item.say("fig2.loops", **locals(), reference=REFERENCE, lesser=LESSER)


def fig3(item, quick):
    highest = [np.abs(reference_run(f, 1e5).point_v).max() for f in (SLOW, REFERENCE.frequency)]
    speeds = np.linspace(-1e-4, 1e-4, 801)
    item.curves["fig3"] = {"velocity_m_per_s": speeds}
    for beta in (1e4, *BETAS):
        velocity = tan(0.5 * pi * 0.9) / beta
        shares = [100.0 * velocity / value for value in highest]
        if beta < inf:
            item.say("fig3.velocity", **locals(), name=_name(beta))
        column = f"force_over_limit_beta_{beta:.0e}".replace("e+0", "e")
        item.curves["fig3"][column] = friction_force(speeds, beta)
    item.say(highest=highest)


def _changes(runs):
    """Change of the peak and largest change in the last cycle from β 1e7 to 1e5, percent."""
    u, sharp = (runs[beta].point("free_end")[-201:] for beta in (1e5, 1e7))
    largest = 100.0 * np.abs(u - sharp).max() / np.abs(sharp).max()
    return percent(peak(runs[1e5]), peak(runs[1e7])), largest


def fig4(item, quick):
    for frequency, letter in ((SLOW, "a"), (REFERENCE.frequency, "b")):
        runs = {beta: reference_run(frequency, beta) for beta in BETAS}
        of_peak, largest = _changes(runs)
        if letter == "a":
            item.compare("change_at_5_hz_percent", of_peak)
            what = "5 Hz, β 1e7 → 1e5: largest change in a cycle, % of the peak"
            item.compare("change_at_5_hz_percent", largest, what=what)
        else:
            item.say("fig4.fast", **locals(), near=(abs(of_peak) < 1.0, largest < 1.0))
        curve = item.curves[f"fig4{letter}"] = {"time_over_period": np.linspace(0.0, 1.0, 201)}
        for beta, full in runs.items():
            name = _name(beta)
            changes = [percent(of(full), of(runs[inf])) for of in (peak, loop_area, friction)]
            if beta < inf:
                item.say("fig4.changes", **locals())
            curve[f"displacement_{name}_m".replace(" ", "")] = full.point("free_end")[-201:]
    weak = _changes({beta: reference_run(SLOW, beta, WEAK) for beta in (1e5, 1e7)})
    item.say(weak=weak, force=REFERENCE.force, lesser=WEAK.force)


@cache
def _modes(case=REFERENCE, cycles=3, steps=200, snapshots="displacement", **law):
    """Modes of a case that has the reference joint's geometry."""
    joint, times = package.lap_joint(**law), {"cycles": cycles, "steps_per_cycle": steps}
    run = package.run_lap_joint(joint, case.force, case.frequency, **times)
    return package.modes_of_lap_joint(joint, run, snapshots=snapshots)


def _upright(modes, xi):
    """First modes at positions of the unit active length, positive at the free end."""
    values = modes.at(xi, COUNT)
    return values * np.sign(values[-1])


def table1(item, quick):
    reference, weak = _modes(), _modes(WEAK, steps=100)
    exact = _modes(beta=inf), _modes(WEAK, steps=100, beta=inf)
    proper, settled = reference.proper, package.run_lap_joint(package.lap_joint(), cycles=6)
    for name, key, computed in (
        ("proper value", "proper_values", proper.proper_values),
        ("cumulative sum", "cumulative", proper.cumulative),  # sums of rounded values
    ):
        for k, value in enumerate(item.printed[key]):
            within = 0.005 * (k + 2 if key == "cumulative" else 1)
            what = {"value": value, "what": f"{name} {k + 1}, %", "within": within}
            item.compare("proper_value", computed[k], **what)
    xi = np.linspace(0.0, 1.0, 201)
    curves, sharp = ([_upright(modes, xi) for modes in pair] for pair in ((reference, weak), exact))
    rule = np.sqrt(WEAK.force / REFERENCE.force)
    # Roots of the ratios of active lengths.
    pairs = (reference, weak), exact
    lengths = [np.sqrt(slow.active_length / fast.active_length) for fast, slow in pairs]
    for k, ratio in enumerate(curves[0][-1] / curves[1][-1]):
        off = percent(ratio, rule)
        item.say("table1.amplitude", **locals(), mode=k + 1, near=abs(off) < 1.0)
    mean = np.sqrt((curves[0] ** 2).mean(axis=0) / (curves[1] ** 2).mean(axis=0))
    ends, offs = (mean.min(), mean.max()), [percent(end, rule) for end in (mean.min(), mean.max())]
    by_rule, by_lengths = (np.abs(mean / value - 1.0).max() for value in (rule, lengths[0]))
    item.say("table1.mean", **locals(), near=by_rule < by_lengths)
    for law, (strong, other) in {"β 1e5": curves, "Coulomb": sharp}.items():
        norms = (strong**2).sum(axis=0) * (other**2).sum(axis=0)
        likeness = (strong * other).sum(axis=0) ** 2 / norms
        item.say("table1.likeness", law=law, likeness=likeness, near=likeness.min() > 0.98)
    item.curves["table1"] = {
        "mode": np.arange(1.0, 16.0),
        "proper_value_percent": proper.proper_values[:15],
        "cumulative_percent": proper.cumulative[:15],
    }
    for letter, values in zip("ab", curves, strict=True):
        columns = {f"mode_{k + 1}": values[:, k] for k in range(COUNT)}
        item.curves[f"fig5{letter}"] = {"active_length_share": xi} | columns
    first = [_modes(cycles=cycles).proper.proper_values[0] for cycles in (1, 2, 4, 6)]
    first.append(proper_decomposition(settled.u[-201:]).proper_values[0])
    others = [_modes(normal_force="consistent"), exact[0], _modes(steps=100)]
    both = _modes(snapshots="both").proper
    ratios = sharp[0][-1] / sharp[1][-1]
    item.say(**locals())
