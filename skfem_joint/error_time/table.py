"""The work-precision table, its front, and what follows from it in plain sentences."""

from __future__ import annotations

import csv
import io
from collections.abc import Callable, Iterable, Sequence
from math import exp, isinf, log
from typing import Any

from skfem_joint.error_time.measure import Point
from skfem_joint.error_time.points import COARSE, COULOMB, FULL, GAUSS, POD, STEEPNESS
from skfem_joint.error_time.ready_made import READY_MADE
from skfem_joint.error_time.reference import Distance, Reference

#: Errors of the displacement history that the report advises on.
LEVELS = (1e-2, 1e-3, 1e-4)
#: What the reduced model is asked for: displacement and energy errors, and modes.
REDUCED_DISPLACEMENT, REDUCED_ENERGY, REDUCED_MODES = 1e-2, 2e-2, 5
#: Run times closer than this ratio are the same.
WORTHWHILE = 1.2

Pick = Callable[[Point], Any]
Key = Callable[[Point], float | None]


def _distance(name: str) -> Pick:
    return lambda p: None if p.distance is None else getattr(p.distance, name)


def rms(point: Point) -> float | None:
    """Error of the displacement history against the reference."""
    return None if point.distance is None else point.distance.rms


def time_error(point: Point) -> float | None:
    """Error of the displacement history against the same discrete model at tiny steps."""
    return point.time_error


#: Header and content of each column; plain SI units, relative errors.
COLUMNS: dict[str, Pick] = {
    "family": lambda p: p.what.family,
    "model": lambda p: p.what.model,
    "scheme": lambda p: p.what.scheme,
    "elements": lambda p: p.what.elements,
    "modes": lambda p: p.what.modes,
    "friction points": lambda p: p.what.friction_points,
    "beta (s/m)": lambda p: "Coulomb" if isinf(p.what.beta) else p.what.beta,
    "step (s)": lambda p: p.what.step,
    "tolerance": lambda p: p.what.tolerance,
    "displacement rms": _distance("rms"),
    "displacement max": _distance("largest"),
    "peak": _distance("peak"),
    "friction energy": _distance("friction_energy"),
    "loop energy": _distance("loop_energy"),
    "time-step error": lambda p: p.time_error,
    "to fine mesh": lambda p: p.to_fine_mesh,
    "wall time (s)": lambda p: p.wall_s,
    "off-line (s)": lambda p: p.offline_s,
    "steps": lambda p: p.steps,
    "iterations": lambda p: p.iterations,
    "evaluations": lambda p: p.evaluations,
    "memory (kB)": lambda p: None if p.memory is None else p.memory / 1000.0,
    "runs": lambda p: p.repeats,
    "status": lambda p: p.status,
}


def front(points: Iterable[Point], key: Key = rms) -> list[Point]:
    """Points that no other is both faster and more accurate than, fastest first."""
    chosen: list[Point] = []
    least = float("inf")
    candidates = [(p.wall_s, key(p), k, p) for k, p in enumerate(points) if p.counts]
    known = [c for c in candidates if c[1] is not None]
    for _, error, _, point in sorted(known, key=lambda c: (c[0], c[1], c[2])):
        if error is not None and error < least:
            chosen.append(point)
            least = error
    return chosen


def time_at(points: Iterable[Point], level: float, key: Key = rms) -> float | None:
    """Run time for an error, interpolated on the logarithms along the front, s.

    None where no point is that accurate; the fastest point's time where even it is.
    """
    curve = [(p.wall_s or 0.0, key(p) or 0.0) for p in front(points, key)]
    if not curve or curve[-1][1] > level:
        return None
    after = next(k for k, (_, error) in enumerate(curve) if error <= level)
    wall, error = curve[after]
    if after == 0 or error <= 0.0:
        return wall
    slower_wall, larger = curve[after - 1]
    share = log(larger / level) / log(larger / error)
    return exp(log(slower_wall) + share * log(wall / slower_wall))


def _of(points: Sequence[Point], *families: str) -> list[Point]:
    return [p for p in points if p.what.family in families]


def _ready_made(points: Sequence[Point]) -> list[Point]:
    return [p for p in points if p.what.family.startswith(READY_MADE)]


def fastest(points: Iterable[Point], good: Callable[[Point], bool]) -> Point | None:
    """Fastest of the points that were run to their end and are good enough."""
    fit = [p for p in points if p.counts and good(p)]
    return min(fit, key=lambda p: p.wall_s or 0.0, default=None)


def seconds(value: float | None) -> str:
    """Time for reading."""
    if value is None:
        return "–"
    return f"{1e3 * value:.3g} ms" if value < 1.0 else f"{value:.3g} s"


def named(point: Point) -> str:
    """Short name of what a point is."""
    what = point.what
    parts = [what.family]
    if what.family == COARSE:
        parts.append(f"{what.elements} elements")
    if what.modes is not None:
        parts.append(f"{what.modes} modes, {what.friction_points} friction points")
    if what.family in (STEEPNESS, POD, GAUSS):
        parts.append(f"β {what.beta:.3g} s/m")
    if what.step is not None:
        parts.append(f"step {what.step:.3g} s")
    if what.tolerance is not None:
        parts.append(f"{what.scheme}, {what.model}, tolerance {what.tolerance:g}")
    return ", ".join(parts)


def advice(points: Sequence[Point], level: float) -> str:
    """Say which model to use for an error of the displacement, and whether a reduction pays."""

    def good(p: Point) -> bool:
        error = rms(p)
        return error is not None and error <= level

    full = fastest(_of(points, FULL, STEEPNESS, COULOMB, COARSE), good)
    reduced = fastest(_of(points, POD, GAUSS), good)
    made = fastest(_ready_made(points), good)
    start = f"Displacement error {level:.0e}: "
    best = min(
        (p for p in (full, reduced, made) if p is not None),
        key=lambda p: p.wall_s or 0.0,
        default=None,
    )
    if best is None:
        return start + "no model of this report reaches it."
    ratio = 0.0
    if full is not None and reduced is not None:
        ratio = (full.wall_s or 0.0) / (reduced.wall_s or 1.0)
        if best is reduced and ratio < WORTHWHILE:
            best = full
    text = f"{start}use {named(best)} ({seconds(best.wall_s)}, error {rms(best):.1e}). "
    if reduced is None:
        least = min((rms(p) or 0.0 for p in _of(points, POD, GAUSS) if p.counts), default=None)
        if least is None:
            return text + "No reduced model was run."
        return text + (
            f"A reduction does not pay: no reduced model reaches it, the best has {least:.1e}."
        )
    if full is None:
        return text + "Only reduced models reach it."
    if ratio < WORTHWHILE:
        return text + (
            f"A reduction does not pay: the fastest reduced model that reaches it "
            f"({named(reduced)}) takes {seconds(reduced.wall_s)}, the fastest full one "
            f"({named(full)}) {seconds(full.wall_s)}."
        )
    saved = (full.wall_s or 0.0) - (reduced.wall_s or 0.0)
    return text + (
        f"A reduction pays {ratio:.2g} times in run time against the fastest full model "
        f"({named(full)}, {seconds(full.wall_s)}), and its {seconds(reduced.offline_s)} off-line "
        f"come back after {max(1, round(reduced.offline_s / saved))} runs."
    )


def advice_on_mesh(points: Sequence[Point], reference: Reference) -> str:
    """Say what the same errors mean against a fine mesh."""
    mesh = next((e for e in reference.estimates if e.source == "mesh"), None)
    text = ""
    if mesh is not None:
        text = (
            f"The scene's own mesh is off by {mesh.errors['displacement_rms']:.1e} (certificate): "
            "errors of the displacement below that are of the algebra, not of the joint. "
        )
    found = []
    for level in LEVELS[:2]:

        def good(p: Point, level: float = level) -> bool:
            return p.to_fine_mesh is not None and p.to_fine_mesh <= level

        best = fastest(points, good)
        found.append(
            f"no model is within {level:.0e}"
            if best is None
            else f"fastest within {level:.0e} is {named(best)} ({seconds(best.wall_s)})"
        )
    return (
        text
        + "Against a mesh of quarter elements with consistent friction forces, the "
        + "; the ".join(found)
        + "."
    )


def ratios(points: Sequence[Point]) -> list[tuple[str, str, str, str, str]]:
    """Rows of the table of speed ratios: what, ours, theirs, ratio, asked for."""
    rows = []

    def add(what: str, ours: float | None, theirs: float | None, asked: str) -> None:
        ratio = "–" if ours is None or theirs is None else f"{theirs / ours:.3g}"
        rows.append((what, seconds(ours), seconds(theirs), ratio, asked))

    families = sorted({p.what.family for p in _ready_made(points)})
    theirs = {}
    for level in LEVELS:
        times = [
            t for f in families if (t := time_at(_of(points, f), level, time_error)) is not None
        ]
        theirs[level] = min(times, default=None)
        ours = time_at(_of(points, FULL), level)
        add(f"full, arctan / ready-made, error {level:.0e}", ours, theirs[level], "30")
    for level in LEVELS:
        ours = time_at(_of(points, COULOMB), level)
        add(f"full, Coulomb / ready-made, error {level:.0e}", ours, theirs[level], "300")
    for level in LEVELS:
        ours = time_at(_of(points, COULOMB), level, time_error)
        what = f"the same, Coulomb's own time-step error {level:.0e}"
        add(what, ours, theirs[level], "300")

    def close(displacement: str) -> Callable[[Point], bool]:
        def good(p: Point) -> bool:
            d = p.distance
            return (
                d is not None
                and abs(getattr(d, displacement)) <= REDUCED_DISPLACEMENT
                and abs(d.friction_energy) <= REDUCED_ENERGY
                and abs(d.loop_energy) <= REDUCED_ENERGY
            )

        return good

    five = [p for p in _of(points, POD, GAUSS) if p.what.modes == REDUCED_MODES]
    for displacement, word in (("rms", "history"), ("peak", "peak")):
        reduced = fastest(five, close(displacement))
        wall = None if reduced is None else reduced.wall_s
        for family, asked in ((FULL, "3"), (COULOMB, "1")):
            full = fastest(_of(points, family), close(displacement))
            add(
                f"{REDUCED_MODES} POMs / {family}, {word} within 1 %, energies within 2 %",
                wall,
                None if full is None else full.wall_s,
                asked,
            )
    return rows


def best_of_five(points: Sequence[Point]) -> str:
    """Say how near the models of five modes come to what they are asked for."""
    five = [
        (p, p.distance)
        for p in _of(points, POD, GAUSS)
        if p.what.modes == REDUCED_MODES and p.distance is not None
    ]
    if not five:
        return ""

    def excess(pair: tuple[Point, Distance]) -> float:
        d = pair[1]
        energy = max(abs(d.friction_energy), abs(d.loop_energy))
        return max(d.rms / REDUCED_DISPLACEMENT, energy / REDUCED_ENERGY)

    best, d = min(five, key=excess)
    return (
        f"Of the models of {REDUCED_MODES} modes, {named(best)} comes nearest to 1 % displacement "
        f"and 2 % energy: history {100 * d.rms:.2f} %, peak {100 * d.peak:+.2f} %, friction energy "
        f"{100 * d.friction_energy:+.2f} %, loop energy {100 * d.loop_energy:+.2f} %."
    )


def _cell(value: Any) -> str:
    if value is None:
        return "–"
    return f"{value:.3g}" if isinstance(value, float) else str(value)


def _grid(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = ["| " + " | ".join(header) + " |", "| " + " | ".join("---" for _ in header) + " |"]
    lines += ["| " + " | ".join(cell.replace("|", "/") for cell in row) + " |" for row in rows]
    return "\n".join(lines)


def markdown_table(points: Sequence[Point]) -> str:
    """All points; those on the front are marked."""
    ahead = {id(p) for p in front(points)}
    rows = [
        ["**front**" if id(p) in ahead else "", *(_cell(pick(p)) for pick in COLUMNS.values())]
        for p in points
    ]
    return _grid(["", *COLUMNS], rows)


def csv_table(points: Sequence[Point]) -> str:
    """All points with full precision; the first column is 1 on the front."""
    ahead = {id(p) for p in front(points)}
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["front", *COLUMNS])
    for p in points:
        writer.writerow([int(id(p) in ahead), *(pick(p) for pick in COLUMNS.values())])
    return text.getvalue()


def ratio_table(points: Sequence[Point]) -> str:
    """Speed ratios in one run."""
    header = ("ours / theirs", "ours", "theirs", "times faster", "asked for")
    return _grid(header, ratios(points))


def reference_text(reference: Reference) -> str:
    """How well the reference is known."""
    names = {
        "displacement_rms": "displacement rms",
        "peak_displacement": "peak",
        "friction_energy": "friction energy",
        "loop_energy": "loop energy",
    }
    sources = {
        "time step": f"time step ({reference.parts * reference.grid.intervals} steps)",
        "mesh": "mesh (halved twice, the scene's lumping)",
        "beta": "regularisation (against Coulomb)",
    }
    rows = [
        [
            sources.get(e.source, e.source),
            *(f"{e.errors[key]:.1e}" for key in names),
            "–" if e.order is None else f"{e.order:.2f}",
        ]
        for e in reference.estimates
    ]
    steps = reference.parts * reference.grid.intervals
    return (
        f"Errors are measured against the *discrete truth*: the scene's own mesh and friction law, "
        f"{steps} and {2 * steps} steps extrapolated with order {reference.order:.2f}, which moves "
        f"the histories of the finer run by {reference.extrapolation:.1e}. Errors of other laws, "
        "meshes and reduced models therefore contain regularisation, mesh and truncation errors; "
        "the column `time-step error` is against the same model at tiny steps, the column `to fine "
        "mesh` against quarter elements with consistent friction forces. Estimated relative errors "
        "of the reference, each source alone:\n\n"
        + _grid(["source", *names.values(), "order"], rows)
    )
