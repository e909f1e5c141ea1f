"""Fig. 2(b) of the paper: hysteresis against the pseudo-static curve, and its area."""

from __future__ import annotations

from math import inf, pi

import numpy as np

from skfem_joint import pseudo_static
from skfem_joint.history import hysteresis_loop
from skfem_joint.paper.figures import STYLES, figure, finish
from skfem_joint.paper.items import Item, Row, percent, published
from skfem_joint.paper.reference_runs import (
    REFERENCE,
    SLOW,
    STIFFNESS,
    TAU,
    loop_area,
    run_reference,
)
from skfem_joint.paper.workspace import Workspace


def hysteresis(item: Item, workspace: Workspace) -> None:
    """Fig. 2(b): rows, notes, curves and picture of the hysteresis loops."""
    energy = published()["fig2"]["loop_energy"]
    full_force = REFERENCE.force
    # The force whose closed-form loop has the printed area.
    implied = (1.5 * energy * STIFFNESS * TAU) ** (1.0 / 3.0)
    lesser_force = 0.7 * full_force
    steps = 400
    slow = {f: run_reference(f, SLOW, inf, steps=steps) for f in (full_force, lesser_force)}
    static = {f: pseudo_static.loop_energy(f, STIFFNESS, TAU) for f in slow}
    fast = run_reference(full_force, REFERENCE.frequency, 1e5)
    for force, run in slow.items():
        matches = abs(percent(static[force], energy)) < 0.1
        verdict = (
            "agrees within 0.1 %, but this is not the reference load"
            if matches
            else f"cannot be right: at this load the closed form gives {static[force]:.4g} J"
        )
        where = f"{force / 1e3:.4g} kN ({100.0 * force / REFERENCE.limit:.0f} % of the limit)"
        item.rows += [
            Row(
                f"loop area at {where}, pseudo-static, J",
                energy,
                static[force],
                difference=f"{percent(static[force], energy):+.2g} %",
                verdict=verdict,
                form=".5g",
            ),
            Row(
                f"loop area at {where}, run at {SLOW:g} Hz, Coulomb, J",
                energy,
                loop_area(run),
                difference=f"{percent(loop_area(run), energy):+.2g} %",
                verdict=f"{percent(loop_area(run), static[force]):+.2f} % from the closed form",
                form=".5g",
            ),
        ]
    item.rows.append(
        Row(
            "loop area at 63 kN, 1000 Hz (the reference run), J",
            energy,
            loop_area(fast),
            difference=f"{percent(loop_area(fast), energy):+.2g} %",
            verdict="agrees within 0.5 %"
            if abs(percent(loop_area(fast), energy)) < 0.5
            else "cannot be right: the printed area belongs to a smaller load",
            form=".5g",
        )
    )
    viscous = float(fast.cycles.viscous[-1])
    item.notes += [
        f"The printed area of the loops of Fig. 2(b), {energy} J, is not that of the reference "
        f"load. The closed form 2F³/(3EAτ) gives {static[full_force]:.4f} J at 63 kN and the "
        f"printed value at {implied / 1e3:.2f} kN, that is {100 * implied / REFERENCE.limit:.1f} % "
        f"of the friction limit: 63 per cent, it seems, where 63 kN was meant "
        f"({static[lesser_force]:.4f} J at {lesser_force / 1e3:.1f} kN).",
        f"The run agrees with the closed form only when it is slow: at {SLOW:g} Hz under Coulomb "
        "friction its loop at 63 kN differs by "
        f"{percent(loop_area(slow[full_force]), static[full_force]):+.2f} %, with β = 1e5 by "
        f"{percent(loop_area(run_reference(full_force, SLOW, 1e5)), static[full_force]):+.0f} "
        "% (see Fig. 4), and at the reference system's 1000 Hz by "
        f"{percent(loop_area(fast), static[full_force]):+.0f} %, because inertia lengthens the "
        f"active part and {viscous:.2f} J of it is viscous.",
    ]
    phase = np.linspace(0.0, 2.0 * pi, steps + 1)
    for force, run in slow.items():
        u, f = hysteresis_loop(run, "free_end", rows_per_cycle=steps)
        u_static = pseudo_static.loop(force, STIFFNESS, TAU, phase)[0]
        item.curves[f"fig2b_{force / 1e3:.1f}kN"] = {
            "force_N": f,
            "displacement_5Hz_m": u,
            "displacement_pseudo_static_m": u_static,
        }
    u, f = hysteresis_loop(fast, "free_end", rows_per_cycle=200)
    item.curves["fig2b_1000Hz"] = {"force_N": f, "displacement_m": u}
    if workspace.draws():
        drawing, axes = figure()
        axes.plot(1e6 * u, f / 1e3, **STYLES[5], label=f"63 kN at 1000 Hz: {loop_area(fast):.2f} J")
        for k, (force, run) in enumerate(slow.items()):
            u_static, f_static = pseudo_static.loop(force, STIFFNESS, TAU, phase)
            u, f = hysteresis_loop(run, "free_end", rows_per_cycle=steps)
            axes.plot(
                1e6 * u_static,
                f_static / 1e3,
                **STYLES[k],
                label=f"pseudo-static, {force / 1e3:.1f} kN: {static[force]:.2f} J",
            )
            axes.plot(
                1e6 * u[::16],
                f[::16] / 1e3,
                linestyle="none",
                marker="os"[k],
                markersize=4,
                markerfacecolor="none",
                color=STYLES[k]["color"],
                label=f"run at {SLOW:g} Hz: {loop_area(run):.2f} J",
            )
        axes.set_xlim(right=165.0)
        finish(
            axes,
            "displacement of the free end (µm)",
            "force (kN)",
            f"Fig. 2(b): hysteresis (printed area {energy} J)",
        )
        axes.legend(loc="lower right", fontsize=8, handlelength=3.2)
        workspace.save(item, "fig2b", drawing)
