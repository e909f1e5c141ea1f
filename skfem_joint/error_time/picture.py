"""Work-precision plot."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from skfem_joint.error_time.measure import Point
from skfem_joint.error_time.points import COARSE, COULOMB, EXPLICIT, FULL, GAUSS, POD, STEEPNESS
from skfem_joint.error_time.table import front, rms
from skfem_joint.files import replacing
from skfem_joint.paper.figures import figure, finish

#: Marker of each family: filled for the full models, open for the reduced, crosses for the rest.
MARKERS: dict[str, dict[str, Any]] = {
    FULL: {"marker": "o", "color": "#000000"},
    COULOMB: {"marker": "D", "color": "#9c1c0c"},
    STEEPNESS: {"marker": "s", "color": "#9a9a9a"},
    COARSE: {"marker": "^", "color": "#1f5fa8"},
    POD: {"marker": "v", "color": "#2e8033", "markerfacecolor": "none"},
    GAUSS: {"marker": "P", "color": "#8f62b5", "markerfacecolor": "none"},
    EXPLICIT: {"marker": "x", "color": "#000000"},
}
READY_MARKERS = ("*", "h", "+", "1", "2", "3", "4")


def _style(family: str, others: list[str]) -> dict[str, Any]:
    if family in MARKERS:
        return MARKERS[family]
    marker = READY_MARKERS[others.index(family) % len(READY_MARKERS)]
    return {"marker": marker, "color": "#5a5a5a", "markersize": 9}


def _energy(point: Point) -> float | None:
    return None if point.distance is None else abs(point.distance.friction_energy)


def draw(points: Sequence[Point], path: Path, title: str) -> None:
    """Displacement and friction-energy error against wall time, with the fronts.

    Raises
    ------
    InputError
        If matplotlib is missing or the file cannot be written.
    """
    drawing, axes = figure(columns=2, width=6.5, height=5.5)
    families = list(dict.fromkeys(p.what.family for p in points if p.counts))
    others = [f for f in families if f not in MARKERS]
    panels = ((rms, "displacement, rms"), (_energy, "friction energy per cycle"))
    for panel, (error, name) in zip(axes, panels, strict=True):
        panel.set_xscale("log")
        panel.set_yscale("log")
        for family in families:
            data = [
                (p.wall_s, value)
                for p in points
                if p.counts and p.what.family == family and (value := error(p))
            ]
            if data:
                style: dict[str, Any] = {"linestyle": "none", "markersize": 6, "alpha": 0.85}
                panel.plot(*zip(*data, strict=True), label=family, **style | _style(family, others))
        ahead = [(p.wall_s, value) for p in front(points, error) if (value := error(p))]
        if ahead:
            style = {"where": "post", "color": "#000000", "linewidth": 1.0, "zorder": 0}
            panel.step(*zip(*ahead, strict=True), label="front", **style)
        finish(panel, "run time (s)", f"relative error: {name}", legend=False)
    axes[0].set_title(title, loc="left", fontsize=11)
    handles, labels = axes[0].get_legend_handles_labels()
    drawing.legend(handles, labels, loc="outside lower center", ncols=5, fontsize=9)
    with replacing(path) as temporary:
        drawing.savefig(temporary, format="png", dpi=150)
