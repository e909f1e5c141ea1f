"""What became of the cases: a page, a table of all of them, and a picture of the schemes."""

from __future__ import annotations

import csv
import importlib.util
import re
from collections import Counter
from collections.abc import Iterable, Sequence
from math import inf
from pathlib import Path
from typing import Any

from skfem_joint.errors import InputError
from skfem_joint.files import replacing
from skfem_joint.paper.figures import figure
from skfem_joint.stability import plate_cases
from skfem_joint.stability.bar_cases import BETAS, MANY, RADII
from skfem_joint.stability.judge import REFUSED, RIGHT, WRONG, Verdict

OUTCOMES = (RIGHT, REFUSED, WRONG)
#: Name of the page, of the table of all cases and of the picture.
PAGE, TABLE, PICTURE = "stability.md", "stability.csv", "stability.png"
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
#: Axes that have panels of their own in the picture.
_MAPS = ("scheme", "explicit", "reduced", "hyper-reduced", "plate scheme")


def bottom_line(verdicts: Sequence[Verdict], seconds: float | None = None) -> str:
    """Counts in one sentence."""
    counts = Counter(verdict.outcome for verdict in verdicts)
    took = "" if seconds is None else f", in {seconds:.0f} s"
    return (
        f"{len(verdicts)} cases: {counts[RIGHT]} right, {counts[REFUSED]} refused, "
        f"{counts[WRONG]} wrong in silence{took}."
    )


def summary(verdicts: Sequence[Verdict]) -> list[list[str]]:
    """Table by axis, its head first."""
    head = ["axis", *OUTCOMES, "error", "over allowed", "energy left over", "fallbacks", "halved"]
    rows = [head]
    for axis in dict.fromkeys(verdict.case.axis for verdict in verdicts):
        group = [verdict for verdict in verdicts if verdict.case.axis == axis]
        judged = [verdict for verdict in group if verdict.error is not None]
        counts = Counter(verdict.outcome for verdict in group)
        rows.append(
            [
                axis,
                *(str(counts[outcome]) for outcome in OUTCOMES),
                _worst(verdict.error for verdict in judged),
                _worst((v.error or 0.0) / (v.error_bound or 1.0) for v in judged),
                _worst(verdict.energy for verdict in judged),
                str(sum(verdict.nested + verdict.descents for verdict in group)),
                str(sum(verdict.halved for verdict in group)),
            ]
        )
    return rows


def _worst(values: Iterable[float | None]) -> str:
    return _cell(max((value for value in values if value is not None), default=None))


def _cell(value: float | None) -> str:
    return "" if value is None else f"{value:.1e}"


def text_table(verdicts: Sequence[Verdict]) -> str:
    """Table by axis for the terminal, and each case that is wrong."""
    rows = summary(verdicts)
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]
    lines = ["  ".join(c.ljust(w) for c, w in zip(row, widths, strict=True)) for row in rows]
    lines.insert(1, "-" * len(lines[0]))
    lines += [
        f"{WRONG}: {verdict.case.axis}, {verdict.case.value}: {verdict.reason}"
        for verdict in verdicts
        if verdict.outcome == WRONG
    ]
    return "\n".join(line.rstrip() for line in lines)


def _markdown(rows: Sequence[Sequence[str]]) -> str:
    lines = [rows[0], ["---"] * len(rows[0]), *rows[1:]]
    return "\n".join(
        "| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines
    )


def iterations(verdicts: Sequence[Verdict]) -> list[list[str]]:
    """Newton iterations a step by beta and scheme at 100 steps per period: mean, most."""
    found = {
        (v.case.beta, v.case.scheme): f"{v.iterations:.1f}, at most {v.largest_iterations}"
        for v in verdicts
        if v.case.axis in ("scheme", "plate scheme") and v.case.steps == 100 and v.outcome == RIGHT
    }
    schemes = [name for name in (*_names(), *_plate_names()) if name in {key[1] for key in found}]
    rows = [["beta", *schemes]]
    for beta in BETAS:
        cells = [found.get((beta, name), "") for name in schemes]
        if any(cells):
            rows.append(["Coulomb" if beta == inf else f"{beta:.0e}", *cells])
    return rows


def _names() -> list[str]:
    return [f"rho = {rho:g}" for rho in RADII]


def _plate_names() -> list[str]:
    return [f"plates, rho = {rho:g}" for rho in plate_cases.RADII]


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


def page(verdicts: Sequence[Verdict], seconds: float, picture: str = PICTURE) -> str:
    """The page in Markdown.

    Parameters
    ----------
    picture : str
        File name of the picture beside the page; none if empty.
    """
    plates = sum(map(_plate, verdicts))
    steady = Counter(verdict.steady for verdict in verdicts if verdict.steady)
    parts = [
        "# Stiff and extreme cases",
        "Written by `skfem-joint stability --out DIR`.",
        f"**{bottom_line(verdicts, seconds)}**",
        _EXPLANATION,
        f"{len(verdicts) - plates} cases are bars, {plates} plates. "
        "Errors are relative to the largest displacement; *over allowed* is the largest share of "
        "its bound that a case used up. *Fallbacks* are steps that the fast iteration left to the "
        "nested one or to descent, *halved* are steps done in parts; all of them converged. "
        f"Of the harmonic runs, {steady['reached']} reached a steady state within their few "
        f"periods and {steady['not reached']} did not: those are not judged by symmetry.",
    ]
    if picture:
        parts.append(f"![Where each scheme holds and where it refuses]({picture})")
    parts += ["## By axis", _markdown(summary(verdicts))]
    if len(table := iterations(verdicts)) > 1:
        parts += ["## Newton iterations a step, at 100 steps per period", _markdown(table)]
    wrong = [verdict for verdict in verdicts if verdict.outcome == WRONG]
    if wrong:
        rows = [["axis", "case", "why"], *([v.case.axis, v.case.value, v.reason] for v in wrong)]
        parts += ["## Wrong in silence", _markdown(rows)]
    if len(table := _refusals(verdicts)) > 1:
        parts += ["## Refusals", _markdown(table)]
    parts += ["## Where the matrix ends", _LIMITS]
    head = ["axis", "case", "outcome", "error", "allowed", "against", "energy left over"]
    rows = [[*head, "steady state", "iterations a step", "fallbacks", "halved"]]
    rows += [
        [
            v.case.axis,
            v.case.value,
            v.outcome,
            _cell(v.error),
            _cell(v.error_bound),
            v.against,
            _cell(v.energy),
            v.steady,
            "" if v.error is None else f"{v.iterations:.1f}",
            "" if v.error is None else str(v.nested + v.descents),
            "" if v.error is None else str(v.halved),
        ]
        for v in verdicts
    ]
    parts += ["## All cases", _markdown(rows)]
    return "\n\n".join(parts) + "\n"


def prepare() -> None:
    """See that the picture can be made, before anything is computed.

    Raises
    ------
    InputError
        If matplotlib is missing.
    """
    if importlib.util.find_spec("matplotlib") is None:
        raise InputError("stability: needs matplotlib; pip install 'skfem-joint[plot]'")


def write(folder: Path, verdicts: Sequence[Verdict], seconds: float) -> list[Path]:
    """Write the page, the table of all cases and the picture; returns their paths."""
    paths = [folder / name for name in (PAGE, TABLE, PICTURE)]
    with replacing(paths[0]) as temporary:
        temporary.write_text(page(verdicts, seconds), encoding="utf-8")
    with replacing(paths[1]) as temporary, temporary.open("w", newline="") as stream:
        fields = [name for name in Verdict.__dataclass_fields__ if name != "case"]
        writer = csv.writer(stream)
        writer.writerow(["axis", "case", *fields])
        for v in verdicts:
            writer.writerow([v.case.axis, v.case.value, *(getattr(v, name) for name in fields)])
    with replacing(paths[2]) as temporary:
        draw(verdicts).savefig(temporary, dpi=110, format="png")
    return paths


def draw(verdicts: Sequence[Verdict]) -> Any:
    """Figure: right, refused or wrong over beta and steps per period, scheme by scheme.

    Bars in the upper two rows, plates in the last one; their other axes stand at the end of each.
    """
    from matplotlib.colors import LogNorm

    drawing, axes = figure(4, 3, width=4.2, height=3.5)
    panels = axes.ravel()
    names = [*_names(), "explicit Runge-Kutta", "reduced", "hyper-reduced"]
    maps = [v for v in verdicts if v.case.axis in _MAPS]
    norm = LogNorm(1e-7, 0.2)
    for panel, name in zip(panels[[*range(7), 8, 9, 10]], names + _plate_names(), strict=True):
        shown = [v for v in maps if v.case.scheme == name]
        shades = _map(panel, name, shown, norm)
    _counts(panels[7], "other cases of bars", [v for v in verdicts if not _plate(v)])
    _counts(panels[11], "other cases of plates", [v for v in verdicts if _plate(v)])
    handles, labels = panels[0].get_legend_handles_labels()
    drawing.legend(handles, labels, loc="outside upper right", ncols=3, fontsize=10)
    bar = drawing.colorbar(shades, ax=axes, location="right", shrink=0.6)
    bar.set_label("error of the displacement over its largest value")
    return drawing


def _plate(verdict: Verdict) -> bool:
    return isinstance(verdict.case, plate_cases.PlateCase)


def _map(panel: Any, name: str, shown: Sequence[Verdict], norm: Any) -> Any:
    """Outcomes of one scheme over beta and steps per period; returns the shades of the errors."""
    right, refused, wrong = ([v for v in shown if v.outcome == o] for o in OUTCOMES)
    shades = panel.scatter(
        *_places(right),
        c=[max(v.error or 0.0, 1e-9) for v in right],
        norm=norm,
        cmap="cividis",
        s=60,
        edgecolors="black",
        linewidths=0.6,
        label=RIGHT,
    )
    panel.scatter(*_places(refused), marker="x", c="black", s=40, label=REFUSED)
    panel.scatter(*_places(wrong), marker="s", c="red", s=70, label=WRONG)
    panel.set_title(name, loc="left", fontsize=11)
    panel.set_yscale("log")
    panel.set_xlim(-0.6, len(BETAS) - 0.4)
    panel.set_ylim(5, 2 * MANY)
    ticks = range(0, len(BETAS), 2)
    labels = [f"1e{k + 2}" for k in ticks]
    panel.set_xticks([*ticks, len(BETAS) - 1], [*labels, "C"])
    panel.set_xlabel("beta, s/m (C: Coulomb)")
    panel.set_ylabel("steps per period")
    panel.grid(alpha=0.25)
    return shades


def _places(verdicts: Sequence[Verdict]) -> tuple[list[int], list[int]]:
    return [BETAS.index(v.case.beta) for v in verdicts], [v.case.steps for v in verdicts]


def _counts(panel: Any, title: str, verdicts: Sequence[Verdict]) -> None:
    """Cases of the axes without a panel of their own by outcome, as bars."""
    others = [v for v in verdicts if v.case.axis not in _MAPS]
    names = list(dict.fromkeys(v.case.axis for v in others))[::-1]
    labels = [name.removeprefix("plate ") for name in names]
    left = [0] * len(names)
    colours = {RIGHT: "#6f8fb0", REFUSED: "white", WRONG: "red"}
    for outcome in OUTCOMES:
        counts = Counter(v.case.axis for v in others if v.outcome == outcome)
        widths = [counts[name] for name in names]
        style = {"color": colours[outcome], "edgecolor": "black", "linewidth": 0.5}
        panel.barh(labels, widths, left=left, hatch="xxx" if outcome == REFUSED else "", **style)
        left = [a + b for a, b in zip(left, widths, strict=True)]
    panel.xaxis.get_major_locator().set_params(integer=True)
    panel.tick_params(axis="y", labelsize=8)
    panel.set_title(title, loc="left", fontsize=11)
    panel.set_xlabel("cases")
