"""Outcomes of the cases: a page, a table of all of them (CSV), and a picture of the schemes."""

import csv
import re
from collections import Counter
from math import inf

from skfem_joint.ground.files import replacing
from skfem_joint.output.plots import new_figure, save_figure
from skfem_joint.study.error_time import markdown_table
from stability.cases import BETAS, PLATE_RADII, RADII
from stability.judge import REFUSED, RIGHT, WRONG

OUTCOMES = (RIGHT, REFUSED, WRONG)
#: Names of the page, of the table of all cases, and of the picture.
PAGE, CASES, PICTURE = "stability.md", "stability.csv", "stability.png"
#: Schemes and models of bars and of plates, with a panel each in the picture.
SCHEMES = [*(f"rho = {rho:g}" for rho in RADII), "explicit Runge-Kutta", "reduced", "hyper-reduced"]
SCHEMES += [f"plates, rho = {rho:g}" for rho in PLATE_RADII]


def bottom_line(verdicts, seconds):
    """Counts of the outcomes in a sentence."""
    counts = Counter(verdict.outcome for verdict in verdicts)
    parts = ", ".join(f"{counts[outcome]} {outcome}" for outcome in OUTCOMES)
    return f"{len(verdicts)} cases: {parts}, in {seconds:.0f} s."


def summary(verdicts):
    """Table of outcomes and largest errors by axis."""
    head = ["axis", *OUTCOMES, "error", "over allowed", "energy left over", "fallbacks", "halved"]
    rows = []
    for axis in dict.fromkeys(verdict.case.axis for verdict in verdicts):
        group = [verdict for verdict in verdicts if verdict.case.axis == axis]
        counts = Counter(verdict.outcome for verdict in group)
        judged = [v for v in group if v.error is not None]
        figures = ((v.error, v.error / (v.error_bound or 1.0), v.energy or 0.0) for v in judged)
        worst = map(max, zip(*figures, strict=True)) if judged else [None] * 3
        sums = sum(v.fallbacks for v in group), sum(v.halved for v in group)
        rows.append([axis, *(counts[outcome] for outcome in OUTCOMES), *worst, *sums])
    return markdown_table(head, rows)


def _iterations(verdicts):
    """Newton iterations a step by beta and scheme at 100 steps per period: mean, most."""
    texts = {
        (v.case.beta, v.case.scheme): f"{v.iterations:.1f}, at most {v.largest_iterations}"
        for v in verdicts
        if v.case.axis in ("scheme", "plate scheme") and v.case.steps == 100 and v.outcome == RIGHT
    }
    schemes = [name for name in SCHEMES if name in {key[1] for key in texts}]
    rows = [["beta", *schemes]]
    for beta in BETAS:
        cells = [texts.get((beta, name), "") for name in schemes]
        if any(cells):
            rows.append(["Coulomb" if beta == inf else f"{beta:.0e}", *cells])
    return rows


def _refusals(verdicts):
    """Refusals grouped by their message without its numbers: count, axes, an example."""
    groups = {}
    for verdict in verdicts:
        if verdict.outcome == REFUSED:
            groups.setdefault(re.sub(r"\d[\d.e+-]*", "#", verdict.reason), []).append(verdict)
    rows = [["cases", "axes", "message, for one of them"]]
    for group in sorted(groups.values(), key=len, reverse=True):
        axes = ", ".join(dict.fromkeys(verdict.case.axis for verdict in group))
        rows.append([str(len(group)), axes, group[0].reason])
    return rows


def page(verdicts, seconds):
    plates = sum(verdict.case.is_plate for verdict in verdicts)
    wrong = [[v.case.axis, v.case.value, v.reason] for v in verdicts if v.outcome == WRONG]
    tables = {
        "Newton iterations a step, at 100 steps per period": _iterations(verdicts),
        "Wrong in silence": [["axis", "case", "why"], *wrong],
        "Refusals": _refusals(verdicts),
    }
    parts = [
        f"## {title}\n\n{markdown_table(rows[0], rows[1:])}"
        for title, rows in tables.items()
        if len(rows) > 1
    ]
    steady = Counter(verdict.steady for verdict in verdicts)
    counts = (
        f"{len(verdicts) - plates} cases are bars, {plates} plates. Of the harmonic runs, "
        f"{steady['reached']} reached a steady state within their few periods and "
        f"{steady['not reached']} did not: those are not judged by symmetry."
    )
    head = ["# Stiff and extreme cases", f"**{bottom_line(verdicts, seconds)}**", counts]
    return "\n\n".join([*head, "## By axis", summary(verdicts), *parts]) + "\n"


def cases(verdicts):
    """Header and rows of all cases; None where nothing was judged."""
    yield (
        *("axis", "case", "outcome", "error", "allowed", "against", "energy left over"),
        *("steady state", "iterations a step", "fallbacks", "halved", "reason"),
    )
    for v in verdicts:
        work = [f"{v.iterations:.1f}", v.fallbacks, v.halved]
        yield (
            *(v.case.axis, v.case.value, v.outcome, v.error, v.error_bound, v.against),
            *(v.energy, v.steady, *([None] * 3 if v.error is None else work), v.reason),
        )


def write(folder, verdicts, seconds):
    """Write the page, the table of all cases and the picture; returns their paths."""
    with replacing(folder / PAGE) as temporary:
        temporary.write_text(page(verdicts, seconds), encoding="utf-8")
    with (
        replacing(folder / CASES) as temporary,
        temporary.open("w", encoding="utf-8", newline="") as file,
    ):
        csv.writer(file).writerows(cases(verdicts))
    picture = save_figure(folder / PICTURE, draw(verdicts))
    return [folder / PAGE, folder / CASES, picture]


def draw(verdicts):
    """Figure: right, refused or wrong over beta and steps per period, scheme by scheme."""
    from matplotlib.colors import LogNorm

    drawing, norm = new_figure(13.0, 9.0), LogNorm(1e-7, 0.2)
    panels, drawn = drawing.subplots(3, 4, sharex=True, sharey=True), {}
    axes = ("scheme", "explicit", "reduced", "hyper-reduced", "plate scheme")
    maps = [v for v in verdicts if v.case.axis in axes]
    names = [
        "C" if beta == inf else f"{beta:.0e}".replace("+0", "").replace("+", "") for beta in BETAS
    ]
    ticks = [n * (k % 2 != len(BETAS) % 2) for k, n in enumerate(names)]
    for panel, name in zip(panels.flat, SCHEMES, strict=False):
        for outcome, marker, size in zip(OUTCOMES, "oxs", (40, 30, 50), strict=True):
            group = [v for v in maps if v.case.scheme == name and v.outcome == outcome]
            style = {"c": "red" if outcome == WRONG else "black"}
            if outcome == RIGHT:
                errors = [max(v.error or 0.0, 1e-9) for v in group]
                style = {"c": errors, "norm": norm, "cmap": "cividis", "edgecolors": "black"}
            at = [BETAS.index(v.case.beta) for v in group], [v.case.steps for v in group]
            drawn[outcome] = panel.scatter(*at, marker=marker, s=size, label=outcome, **style)
        panel.set_title(name, loc="left", fontsize=11)
        panel.set(yscale="log", xlim=(-0.6, len(BETAS) - 0.4), ylim=(5, 120_000))
        panel.set_xticks(range(len(BETAS)), ticks)
        panel.grid(alpha=0.25)
    for panel in panels.flat[len(SCHEMES) :]:
        panel.set_axis_off()
    for panel in panels[-2]:  # above those that are left out
        panel.tick_params(labelbottom=True)
    drawing.supxlabel("beta, s/m (C: Coulomb)")
    drawing.supylabel("steps per period")
    handles = panels[0, 0].get_legend_handles_labels()
    drawing.legend(*handles, loc="outside upper right", ncols=3, fontsize=10)
    label = "error of the displacement over its largest value"
    drawing.colorbar(drawn[RIGHT], ax=panels, location="right", shrink=0.6, label=label)
    return drawing
