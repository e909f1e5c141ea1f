"""What a step costs, and how long it may be: section 7.5, Fig. 22."""

from __future__ import annotations

import numpy as np

from skfem_joint import explicit
from skfem_joint.integrate import integrate
from skfem_joint.paper import figures
from skfem_joint.paper.items import Item, Row, against, published
from skfem_joint.paper.stable_steps import (
    CASE,
    CYCLES,
    GROWTH,
    MODES,
    STEPS,
    chatter,
    largest_frequency,
    measured_step,
    reference,
    systems,
    without_friction,
)
from skfem_joint.paper.workspace import Workspace
from skfem_joint.recording import Save
from skfem_joint.system import System


def operations_full(n: int) -> int:
    """Operations for the accelerations of a full model with ``n`` unknowns, section 7.5."""
    return 38 * n - 24


def operations_reduced(n: int, j: int) -> int:
    """The same with ``j`` modes: expansion and compression, then the accelerations."""
    return (4 * n * j - n - j) + (j * j - j)


def section7_5(workspace: Workspace) -> Item:
    """Stable steps, operation counts and measured times per step: Fig. 22."""
    printed = published()["section7.5"]
    item = Item("section7.5", "Section 7.5, Fig. 22: what the reduction saves")
    both = systems()
    factor = largest_frequency(both["full"]) / largest_frequency(both["reduced"])
    item.rows.append(
        against(
            "largest undamped frequency of K and M, full over reduced",
            printed["step_factor"],
            factor,
            within=0.5,
        )
    )
    steps = {
        "K and M alone": {n: without_friction(s, False) for n, s in both.items()},
        "with C": {n: without_friction(s, True) for n, s in both.items()},
        "with C and friction, beta 1e5 s/m": both,
    }
    computed = {
        part: {name: explicit.stable_step(system) for name, system in pair.items()}
        for part, pair in steps.items()
    }
    n_steps = 500 if workspace.quick else 1500
    measured = {
        part: {
            name: measured_step(system, found / 3.0, 3.0 * found, n_steps)
            for (name, system), found in zip(
                steps[part].items(), computed[part].values(), strict=True
            )
        }
        for part in ("K and M alone", "with C")
    }
    for how, found in (("computed", computed), ("measured", measured)):
        for part, pair in found.items():
            item.rows.append(
                Row(
                    f"largest stable Runge-Kutta step, {part}, {how}, s",
                    None,
                    pair["full"],
                    pair["reduced"],
                    form=".3g",
                )
            )
            item.rows.append(
                against(
                    f"its factor, {part}, {how}",
                    printed["step_factor"],
                    None,
                    reduced=pair["reduced"] / pair["full"],
                    within=0.5,
                    otherwise="differs: the printed factor holds without C and friction only",
                    form=".3g",
                )
            )
    counts = np.arange(1, MODES + 1)
    n = both["full"].n
    paying = [int(j) for j in counts if operations_reduced(n, int(j)) < operations_full(n)]
    item.rows += [
        against(
            "operations per rate vector, full, n = 100",
            printed["operations_full_100"],
            operations_full(n),
            within=50,
        ),
        against(
            "operations per rate vector, 5 modes",
            printed["operations_reduced_5"],
            None,
            reduced=operations_reduced(n, 5),
            within=50,
        ),
        against(
            "most modes that save operations",
            printed["break_even_modes"],
            None,
            reduced=paying[-1],
            within=0,
        ),
    ]
    chattering = {
        name: chatter(system, 0.5 * computed["with C"][name]) for name, system in both.items()
    }
    item.rows.append(
        Row(
            "error of slip velocities with half the stable step without friction, %",
            None,
            chattering["full"],
            chattering["reduced"],
            form=".2g",
        )
    )
    _add_times(item, workspace, computed, chattering)
    return item


def _implicit(system: System, repeats: int) -> tuple[float, float]:
    """Wall time (s) and Newton iterations a step, best of ``repeats``."""
    n_steps = CYCLES * STEPS
    runs = [
        integrate(system, step=1.0 / CASE.frequency / STEPS, n_steps=n_steps)
        for _ in range(repeats)
    ]
    return min(run.wall_s for run in runs) / n_steps, runs[0].counters.newton_iterations / n_steps


def _explicit(system: System, repeats: int, n_steps: int = 200) -> float:
    """Wall time of a Runge-Kutta step, s, best of ``repeats``; too short for the step to matter."""
    return (
        min(
            explicit.runge_kutta(
                system, step=1e-10, n_steps=n_steps, check=False, save=Save(points=False)
            ).wall_s
            for _ in range(repeats)
        )
        / n_steps
    )


def _add_times(
    item: Item,
    workspace: Workspace,
    computed: dict[str, dict[str, float]],
    chattering: dict[str, float],
) -> None:
    repeats = 1 if workspace.quick else 3
    counts = np.array([1, 5, 9, 15] if workspace.quick else range(1, MODES + 1))
    full = systems()["full"]
    n = full.n
    full_time, full_iterations = _implicit(full, repeats)
    full_explicit = _explicit(full, repeats)
    every = np.array([_implicit(systems(j)["reduced"], repeats) for j in counts])
    gauss = np.array(
        [_implicit(reference(int(j), False).models["reduced"].run.system, repeats) for j in counts]
    )
    explicitly = np.array([_explicit(systems(j)["reduced"], repeats) for j in counts])
    five = int(np.flatnonzero(counts == 5)[0])
    points = reference(5, False).models["reduced"].run.system.w.size
    item.rows += [
        Row(
            "measured time per implicit step, 5 modes, friction at all nodes, µs",
            None,
            1e6 * full_time,
            1e6 * every[five, 0],
            form=".3g",
        ),
        Row(
            f"measured time per implicit step, 5 modes, friction at {points} Gauss points, µs",
            None,
            1e6 * full_time,
            1e6 * gauss[five, 0],
            form=".3g",
        ),
        Row(
            "measured time per Runge-Kutta step, 5 modes, friction at all nodes, µs",
            None,
            1e6 * full_explicit,
            1e6 * explicitly[five],
            form=".3g",
        ),
    ]
    cheaper = {
        "friction at all nodes": counts[every[:, 0] < full_time],
        "friction at Gauss points": counts[gauss[:, 0] < full_time],
    }
    break_even = published()["section7.5"]["break_even_modes"]
    for label, found in cheaper.items():
        most = int(found[-1]) if found.size else 0
        item.rows.append(
            Row(
                f"most modes that save time per implicit step, {label}",
                break_even,
                reduced=f"{most} of {counts[-1]}" if most else "none",
                verdict="agrees"
                if most == break_even
                else "differs: time is not the operations that the paper counts",
            )
        )
    item.curves["section7.5_cost"] = {
        "modes": counts.astype(float),
        "operations, reduced": np.array([operations_reduced(n, int(j)) for j in counts], float),
        "operations, full": np.full(counts.size, float(operations_full(n))),
        "implicit step, all nodes (s)": every[:, 0],
        "implicit step, Gauss points (s)": gauss[:, 0],
        "implicit step, full (s)": np.full(counts.size, full_time),
        "Newton iterations a step, all nodes": every[:, 1],
        "Newton iterations a step, Gauss points": gauss[:, 1],
        "Runge-Kutta step, all nodes (s)": explicitly,
        "Runge-Kutta step, full (s)": np.full(counts.size, full_explicit),
    }
    stiff, damped = computed["with C and friction, beta 1e5 s/m"], computed["with C"]
    item.notes += [
        "The step factor is that of the reference system (63 kN, 1000 Hz) and five of its own "
        "displacement modes, three periods from rest. Stable steps are those of the classical "
        "Runge-Kutta method on Eqs. (10)-(16); computed: every eigenvalue in its stability region; "
        f"measured: runs without friction under a step load, bisected to 0.2 %, a run being "
        f"unstable when it exceeds {GROWTH:g} times the static displacement.",
        "The printed factor is the ratio of undamped frequencies. With the paper's own "
        "C = 1e-5 s · K the highest modes are overdamped, their eigenvalues go with the square of "
        f"the frequency, and the factor is {damped['reduced'] / damped['full']:.0f}. Friction with "
        "beta = 1e5 s/m undoes most of it: its slope over the mass of a node is what limits the "
        f"step, {stiff['full']:.2g} s for the full model and {stiff['reduced']:.2g} s for the "
        f"reduced one, a factor of {stiff['reduced'] / stiff['full']:.1f}. These are bounds near "
        "stick. Beyond them a run does not grow without bound, since the friction force saturates; "
        "it chatters: with half the stable step without friction the slip velocities are wrong by "
        f"{chattering['full']:.1f} % (full) and {chattering['reduced']:.1f} % (reduced) of "
        "the largest. So steps as long as the linear system allows do run, at that price.",
        "The operation counts leave out the arctangents, as many for both models when friction is "
        "evaluated at all nodes, and an implicit step's Newton iterations "
        f"({full_iterations:.1f} a step for the full model, {every[five, 1]:.1f} with five modes "
        f"at all nodes, {gauss[five, 1]:.1f} at Gauss points with this package's beta). Measured "
        f"here, best of {repeats}: implicit steps are compiled and take a step of "
        f"{1.0 / CASE.frequency / STEPS:.1g} s; the Runge-Kutta loop is Python calling NumPy and "
        f"SciPy, and its {1e6 * explicitly.min():.0f} to {1e6 * explicitly.max():.0f} µs for "
        f"{counts[0]} to {counts[-1]} modes are mostly the calls'. Times vary between machines "
        "and runs.",
    ]
    if workspace.draws():
        _draw(workspace, item)


def _draw(workspace: Workspace, item: Item) -> None:
    curves = item.curves["section7.5_cost"]
    j = curves["modes"]
    drawing, axes = figures.figure(columns=3, width=4.4, height=3.8)
    panels: list[tuple[str, str, float, dict[str, str]]] = [
        (
            "(a) operations, section 7.5",
            "operations per rate vector",
            1.0,
            {"operations, full": "full", "operations, reduced": "reduced"},
        ),
        (
            "(b) measured, implicit",
            "time per step (µs)",
            1e6,
            {
                "implicit step, full (s)": "full",
                "implicit step, all nodes (s)": "reduced, all nodes",
                "implicit step, Gauss points (s)": "reduced, Gauss points",
            },
        ),
        (
            "(c) measured, Runge-Kutta",
            "time per step (µs)",
            1e6,
            {
                "Runge-Kutta step, full (s)": "full",
                "Runge-Kutta step, all nodes (s)": "reduced, all nodes",
            },
        ),
    ]
    for axis, (title, label, scale, shown) in zip(axes, panels, strict=True):
        for (column, name), style in zip(shown.items(), figures.STYLES, strict=False):
            axis.plot(j, scale * curves[column], label=name, **style)
        if scale == 1.0:
            axis.axvline(
                published()["section7.5"]["break_even_modes"],
                color="#555555",
                linewidth=0.8,
                label="published break-even",
            )
        axis.set_ylim(bottom=0.0, top=1.3 * axis.get_ylim()[1])
        figures.finish(axis, "proper orthogonal modes", label, title, legend=False)
        axis.legend(fontsize=9, handlelength=3.2, loc="upper left")
    workspace.save(item, "fig22", drawing)
