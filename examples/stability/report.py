"""What became of the cases: a page with a table of all of them, and a picture of the schemes."""

import re
from collections import Counter
from collections.abc import Sequence
from math import inf
from pathlib import Path
from typing import Any

from skfem_joint.analysis.error_time import markdown_table
from skfem_joint.files import replacing
from skfem_joint.output.plots import new_figure, save_figure
from stability.cases import BETAS, MANY, PLATE_RADII, RADII
from stability.judge import REFUSED, RIGHT, WRONG, Verdict

OUTCOMES = (RIGHT, REFUSED, WRONG)
#: Name of the page and of the picture.
PAGE, PICTURE = "stability.md", "stability.png"
_EXPLANATION = (
    "*Right* means: the energy audit closes, friction takes energy at every point and nothing is "
    "stored that was not put in, the friction force keeps to its law and its limit and acts "
    "against the slip (vectors of both at each point of a plate), points that stick under Coulomb "
    "have a velocity of exactly zero, the states obey the equation of motion (summed anew, for "
    "harmonic loads), a symmetric load makes a symmetric loop in steady state, and the "
    "displacement is as close as the step allows to a closed form or to the same run at a quarter "
    "of the step. In other units, turned in its plane, or, for plates without contraction across, "
    "computed as a bar, it must be the same. *Refused* means an error that says why and what to "
    "do. Anything else is *wrong in silence*."
)
_LIMITS = (
    "Three kinds of steps that are too long are not refused yet, and not in the matrix: halve the "
    "step and compare. Under the arctan law, a load that jumps to a few percent of the friction "
    "limit moves little more than the joint creeps, and what vibrates is not told from what "
    "creeps. At eight to nine steps a period, the fewest that are "
    "accepted, the displacement may be off by more than a fifth. A body that friction alone "
    "holds, and that breaks loose for a few steps only, needs more of them in that time."
)
#: Schemes and models of bars and of plates that have panels of their own in the picture, and
#: the axes of their cases.
_BARS = [*(f"rho = {rho:g}" for rho in RADII), "explicit Runge-Kutta", "reduced", "hyper-reduced"]
_PLATES = [f"plates, rho = {rho:g}" for rho in PLATE_RADII]
_MAPS = ("scheme", "explicit", "reduced", "hyper-reduced", "plate scheme")


def bottom_line(verdicts: Sequence[Verdict], seconds: float) -> str:
    """Counts in one sentence."""
    counts = Counter(verdict.outcome for verdict in verdicts)
    found = ", ".join(f"{counts[outcome]} {outcome}" for outcome in OUTCOMES)
    return f"{len(verdicts)} cases: {found}, in {seconds:.0f} s."


def summary(verdicts: Sequence[Verdict]) -> str:
    """Table by axis."""
    head = ["axis", *OUTCOMES, "error", "over allowed", "energy left over", "fallbacks", "halved"]
    rows = []
    for axis in dict.fromkeys(verdict.case.axis for verdict in verdicts):
        group = [verdict for verdict in verdicts if verdict.case.axis == axis]
        judged = [v for v in group if v.error is not None]
        counts = Counter(verdict.outcome for verdict in group)
        worst = [
            max((v.error or 0.0 for v in judged), default=None),
            max(((v.error or 0.0) / (v.error_bound or 1.0) for v in judged), default=None),
            max((v.energy or 0.0 for v in judged), default=None),
        ]
        sums = sum(v.nested + v.descents for v in group), sum(v.halved for v in group)
        rows.append([axis, *(counts[outcome] for outcome in OUTCOMES), *worst, *sums])
    return markdown_table(head, rows)


def _iterations(verdicts: Sequence[Verdict]) -> list[list[str]]:
    """Newton iterations a step by beta and scheme at 100 steps per period: mean, most."""
    found = {
        (v.case.beta, v.case.scheme): f"{v.iterations:.1f}, at most {v.largest_iterations}"
        for v in verdicts
        if v.case.axis in ("scheme", "plate scheme") and v.case.steps == 100 and v.outcome == RIGHT
    }
    schemes = [name for name in (*_BARS, *_PLATES) if name in {key[1] for key in found}]
    rows = [["beta", *schemes]]
    for beta in BETAS:
        cells = [found.get((beta, name), "") for name in schemes]
        if any(cells):
            rows.append(["Coulomb" if beta == inf else f"{beta:.0e}", *cells])
    return rows


def _refusals(verdicts: Sequence[Verdict]) -> list[list[str]]:
    """Refusals by message, numbers aside: how many, on which axes, one in full."""
    groups: dict[str, list[Verdict]] = {}
    for verdict in verdicts:
        if verdict.outcome == REFUSED:
            groups.setdefault(re.sub(r"\d[\d.e+-]*", "#", verdict.reason), []).append(verdict)
    rows = [["cases", "axes", "message, for one of them"]]
    for group in sorted(groups.values(), key=len, reverse=True):
        axes = ", ".join(dict.fromkeys(verdict.case.axis for verdict in group))
        rows.append([str(len(group)), axes, group[0].reason])
    return rows


def page(verdicts: Sequence[Verdict], seconds: float) -> str:
    """The page in Markdown."""
    plates = sum(verdict.case.is_plate for verdict in verdicts)
    steady = Counter(verdict.steady for verdict in verdicts)
    wrong = [[v.case.axis, v.case.value, v.reason] for v in verdicts if v.outcome == WRONG]
    tables = {
        "Newton iterations a step, at 100 steps per period": _iterations(verdicts),
        "Wrong in silence": [["axis", "case", "why"], *wrong],
        "Refusals": _refusals(verdicts),
    }
    parts = [
        "# Stiff and extreme cases",
        "Written by `python examples/stability/run.py --out DIR`.",
        f"**{bottom_line(verdicts, seconds)}**",
        _EXPLANATION,
        f"{len(verdicts) - plates} cases are bars, {plates} plates. "
        "Errors are relative to the largest displacement; *over allowed* is the largest share of "
        "its bound that a case used up. *Fallbacks* are steps that the fast iteration left to the "
        "nested one or to descent, *halved* are steps done in parts; all of them converged. "
        f"Of the harmonic runs, {steady['reached']} reached a steady state within their few "
        f"periods and {steady['not reached']} did not: those are not judged by symmetry.",
        f"![Where each scheme holds and where it refuses]({PICTURE})",
        "## By axis",
        summary(verdicts),
    ]
    for title, rows in tables.items():
        parts += [f"## {title}", markdown_table(rows[0], rows[1:])] if len(rows) > 1 else []
    head = ["axis", "case", "outcome", "error", "allowed", "against", "energy left over"]
    head += ["steady state", "iterations a step", "fallbacks", "halved"]
    rows = [_row(verdict) for verdict in verdicts]
    parts += ["## Where the matrix ends", _LIMITS, "## All cases", markdown_table(head, rows)]
    return "\n\n".join(parts) + "\n"


def _row(v: Verdict) -> list[Any]:
    work = [f"{v.iterations:.1f}", v.nested + v.descents, v.halved]
    return [
        *(v.case.axis, v.case.value, v.outcome, v.error, v.error_bound, v.against),
        *(v.energy, v.steady, *(["", "", ""] if v.error is None else work)),
    ]


def write(folder: Path, verdicts: Sequence[Verdict], seconds: float) -> list[Path]:
    """Write the page and the picture; returns their paths."""
    with replacing(folder / PAGE) as temporary:
        temporary.write_text(page(verdicts, seconds), encoding="utf-8")
    return [folder / PAGE, save_figure(folder / PICTURE, draw(verdicts))]


def draw(verdicts: Sequence[Verdict]) -> Any:
    """Figure: right, refused or wrong over beta and steps per period, scheme by scheme."""
    from matplotlib.colors import LogNorm

    drawing, norm = new_figure(20.0, 7.5), LogNorm(1e-7, 0.2)
    axes = drawing.subplots(2, 5)
    maps = [v for v in verdicts if v.case.axis in _MAPS]
    for panel, name in zip(axes.ravel(), _BARS + _PLATES, strict=True):
        shades = _map(panel, name, [v for v in maps if v.case.scheme == name], norm)
    handles = axes[0, 0].get_legend_handles_labels()
    drawing.legend(*handles, loc="outside upper right", ncols=3, fontsize=10)
    label = "error of the displacement over its largest value"
    drawing.colorbar(shades, ax=axes, location="right", shrink=0.6, label=label)
    return drawing


def _map(panel: Any, name: str, shown: Sequence[Verdict], norm: Any) -> Any:
    """Outcomes of one scheme over beta and steps per period; returns the shades of the errors."""
    drawn = []
    for outcome, marker, size in zip(OUTCOMES, "oxs", (60, 40, 70), strict=True):
        found = [v for v in shown if v.outcome == outcome]
        style: dict[str, Any] = {"c": "red" if outcome == WRONG else "black"}
        if outcome == RIGHT:
            errors = [max(v.error or 0.0, 1e-9) for v in found]
            style = {"c": errors, "norm": norm, "cmap": "cividis", "edgecolors": "black"}
        at = [BETAS.index(v.case.beta) for v in found], [v.case.steps for v in found]
        drawn.append(panel.scatter(*at, marker=marker, s=size, label=outcome, **style))
    panel.set_title(name, loc="left", fontsize=11)
    panel.set(yscale="log", xlim=(-0.6, len(BETAS) - 0.4), ylim=(5, 2 * MANY))
    panel.set(xlabel="beta, s/m (C: Coulomb)", ylabel="steps per period")
    names = ["C" if beta == inf else f"{beta:.0e}".replace("+0", "") for beta in BETAS]
    panel.set_xticks(
        range(len(BETAS)), [n * (k % 2 != len(BETAS) % 2) for k, n in enumerate(names)]
    )
    panel.grid(alpha=0.25)
    return drawn[0]
