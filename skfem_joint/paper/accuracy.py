"""Error of the reduced model against its number of modes, and where the error comes from."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np

from skfem_joint.history import Errors, compare
from skfem_joint.paper import figures
from skfem_joint.paper.aims import aim_rows
from skfem_joint.paper.cases import CASES, PLAIN, study
from skfem_joint.paper.items import FloatArray, Item, Row, published
from skfem_joint.paper.workspace import Workspace
from skfem_joint.recording import Run

IMPULSE = "structure, impulse"
SWEPT = ("I", "VI", "VII", "structure")
#: Systems in which the choices are changed one at a time.
CHANGED = ("I", "VI", "structure")
SYSTEMS = ("I", "IV", "V", "VI", "VII", "structure", IMPULSE)
#: Where the estimate by Eq. (17) does not settle, or does not apply.
UNSETTLED = ("IV", "V", "VII", IMPULSE)
CHOICES = ("ours", "the paper's plain choice", "own modes")
#: What differs from the plain choice, one at a time.
CHANGES: dict[str, dict[str, Any]] = {
    "velocity snapshots as well": {"snapshots": "both"},
    "mass inner product": {"inner_product": "mass"},
    "active length from a probe run": {"active_length": "auto"},
    "friction at Gauss points": {"friction_points": "auto"},
    "beta that the modes resolve": {"beta": "auto"},
    "six interface modes": {"interface_modes": 6},
}
MOST = 15


def name_of(system: str) -> str:
    """Name of a system in a row."""
    return {"structure": "structure, harmonic", IMPULSE: IMPULSE}.get(system, f"Case {system}")


def _options(system: str) -> dict[str, Any]:
    if system == IMPULSE:
        rise = published()["section7.4"]["rise_time"]
        return {
            "load": {"kind": "triangle", "peak": CASES["structure"].force, "rise_time": rise},
            "time": {"duration": 6e-3, "step": 2e-6},
        }
    return {"time": {"cycles": 12 if system == "structure" else 8, "steps_per_cycle": 200}}


@cache
def _full(system: str) -> Run:
    case = CASES["structure" if system == IMPULSE else system]
    return study(case, **_options(system)).models["full"].run


def _plain(system: str) -> dict[str, Any]:
    return PLAIN | ({"active_length": "auto"} if system in UNSETTLED else {})


def _errors(system: str, reduction: dict[str, Any]) -> Errors:
    case = CASES["structure" if system == IMPULSE else system]
    made = study(case, run=("reduced",), reduction=reduction, **_options(system))
    return compare(_full(system), made.models["reduced"].run)


@cache
def errors(system: str, choice: str, modes: int = 5) -> Errors:
    """Errors of a system's reduced model with one of `CHOICES`."""
    reduction = {
        "ours": {},
        "the paper's plain choice": _plain(system),
        "own modes": {"reference": "self"},
    }[choice]
    return _errors(system, reduction | {"modes": modes})


def energy_error(found: Errors) -> float:
    """Signed error of the friction energy, per cycle where there are cycles, percent."""
    per_cycle = found.friction_energy_per_cycle
    return 100.0 * (found.friction_energy if per_cycle is None else per_cycle)


MEASURES: dict[str, Callable[[Errors], float]] = {
    "peak": lambda found: 100.0 * found.peak_displacement,
    "free end at any time": lambda found: 100.0 * found.by_point["free_end"][1],
    "any point at any time": lambda found: 100.0 * found.displacement_max,
    "friction energy": energy_error,
}


def _counts(workspace: Workspace) -> list[int]:
    return [5, 9] if workspace.quick else list(range(1, MOST + 1))


def _enough(counts: list[int], values: FloatArray, aim: float) -> str:
    """Fewest modes from which on the error stays within the aim."""
    missed = np.flatnonzero(np.abs(values) > aim)
    last = -1 if missed.size == 0 else int(missed[-1])
    return str(counts[last + 1]) if last + 1 < len(counts) else f"more than {counts[-1]}"


def modes(workspace: Workspace) -> Item:
    """Peak, history and friction energy against the number of modes."""
    item = Item("modes", "Accuracy: error against the number of proper orthogonal modes")
    aim = published()["aim"]
    for system in SYSTEMS:
        item.rows += aim_rows(name_of(system), errors(system, "ours"))
    item.rows += _five_modes_rows(CHANGED[-1:] if workspace.quick else CHANGED)
    counts = _counts(workspace)
    swept: dict[tuple[str, str], dict[str, FloatArray]] = {}
    for system in SWEPT:
        for choice in CHOICES:
            found = [errors(system, choice, j) for j in counts]
            swept[system, choice] = {
                name: np.array([measure(one) for one in found])
                for name, measure in MEASURES.items()
            }
            item.curves[f"modes_{system}_{choice.replace(' ', '_').replace(chr(39), '')}"] = {
                "modes": np.array(counts, float),
                **{f"{name} (%)": values for name, values in swept[system, choice].items()},
            }
    for system in SWEPT:
        for measure, limit in (
            ("peak", aim["displacement_percent"]),
            ("free end at any time", aim["displacement_percent"]),
            ("friction energy", aim["friction_energy_percent"]),
        ):
            needed = [_enough(counts, swept[system, c][measure], limit) for c in CHOICES]
            item.rows.append(
                Row(
                    f"{name_of(system)}: modes for {measure} within {limit:g} % "
                    f"({'; '.join(CHOICES)})",
                    None,
                    reduced="; ".join(needed),
                )
            )
    item.notes += _notes()
    if workspace.draws():
        _draw(workspace, item, counts, swept)
    return item


def _signed(values: list[float]) -> str:
    return "; ".join(f"{value:+.2f}" for value in values)


def _five_modes_rows(changed: tuple[str, ...]) -> list[Row]:
    """Choices beside each other, and the plain choice with one thing changed at a time."""
    rows = [
        Row(
            f"{name_of(system)}, five modes, {choice}: peak; any time; friction energy, %",
            None,
            reduced=_signed(
                [
                    MEASURES[name](errors(system, choice))
                    for name in ("peak", "any point at any time", "friction energy")
                ]
            ),
        )
        for system in SYSTEMS
        for choice in CHOICES[1:]
    ]
    changes: dict[str, dict[str, Any]] = {"nothing": {}, **CHANGES}
    for change, keys in changes.items():
        found = [_errors(system, _plain(system) | keys) for system in changed]
        rows.append(
            Row(
                f"plain choice, five modes, changed: {change}; friction energy of "
                f"{', '.join(name_of(s) for s in changed)}, %",
                None,
                reduced=_signed([energy_error(one) for one in found]),
            )
        )
    return rows


def _notes() -> list[str]:
    aim = published()["aim"]
    five = {(s, c): errors(s, c) for s in SYSTEMS for c in CHOICES}
    met = {
        name: [name_of(s) for s in SYSTEMS if abs(MEASURES[measure](five[s, "ours"])) <= aim[key]]
        for name, measure, key in (
            ("peak", "peak", "displacement_percent"),
            ("any time", "any point at any time", "displacement_percent"),
            ("energy", "friction energy", "friction_energy_percent"),
        )
    }
    listed = {name: ", ".join(found) or "none" for name, found in met.items()}
    own, scaled = (energy_error(five["VI", c]) for c in ("own modes", "ours"))
    plain = energy_error(five["VI", "the paper's plain choice"])
    return [
        "The aims are this project's, not the paper's: with five modes at most "
        f"{aim['displacement_percent']:g} % in displacement and "
        f'{aim["friction_energy_percent"]:g} % in friction energy. "Displacement" is judged by '
        "the peak of the point that moves most; the largest difference at any time and at any "
        "named point, relative to that point's peak, is stricter and stands beside it. Ours, five "
        f"modes, meets the aim for the peak in: {listed['peak']}; for friction energy in: "
        f"{listed['energy']}; at any time in: {listed['any time']}. The rest is missed and left "
        "so; the table says how many modes it takes.",
        "Ours is this package's default reduction (velocity snapshots beside displacement, active "
        "length from a probe run, friction at Gauss points, beta that the modes resolve). The "
        "plain choice is displacement snapshots, friction at all nodes, beta 1e5 s/m and Eq. (17), "
        "or the probe run in Cases IV, V and VII, where Eq. (17) does not settle, and under the "
        "impulse, where it does not hold. Own modes are proper orthogonal modes of the system's "
        "own full run, otherwise as ours: what is left with them is not the scaling of reference "
        "modes but what so few modes can hold at all. For the structure they span joint and linear "
        "region together, without load and interface modes, which is why they do worse.",
        f"Where the error comes from: in Case VI five own modes leave {own:+.1f} % in friction "
        f"energy, the plain choice {plain:+.1f} % and ours {scaled:+.1f} %. Own modes are no lower "
        "bound: they are optimal for the snapshots and not for friction work. Case VI and the "
        "structure under harmonic load are quasi-static: the slip front is a kink that travels "
        "along the joint and comes to rest at every reversal, and modes converge slowly on it. "
        "Near resonance (Case VII) the response is smooth and a few modes hold it. The inner "
        "product and more interface modes than the default two change next to nothing.",
        "Histories and energies are relative to the full model with the same 100 elements, equal "
        "nodal forces and beta 1e5 s/m; 200 steps a cycle, 8 cycles (structure: 12); impulse: "
        "triangle, energy over the whole run.",
    ]


def _draw(
    workspace: Workspace,
    item: Item,
    counts: list[int],
    swept: dict[tuple[str, str], dict[str, FloatArray]],
) -> None:
    aim = published()["aim"]
    panels = {
        "peak": aim["displacement_percent"],
        "free end at any time": aim["displacement_percent"],
        "friction energy": aim["friction_energy_percent"],
    }
    drawing, axes = figures.figure(columns=len(SWEPT), rows=len(panels), width=3.4, height=2.6)
    for column, system in enumerate(SWEPT):
        for row, (measure, limit) in enumerate(panels.items()):
            axis = axes[row, column]
            for (choice, style), marker in zip(
                zip(CHOICES, figures.STYLES, strict=False), "os^", strict=True
            ):
                values = np.maximum(np.abs(swept[system, choice][measure]), 1e-2)
                axis.semilogy(counts, values, label=choice, marker=marker, markersize=3.5, **style)
            axis.axhline(limit, color="#555555", linewidth=0.8, label="aim (this project's)")
            axis.axvline(5, color="#bbbbbb", linewidth=0.8)
            axis.set_ylim(1e-2, 2e2)
            figures.finish(
                axis,
                "proper orthogonal modes",
                f"{measure} (%)",
                name_of(system) if row == 0 else "",
                legend=False,
            )
    handles, labels = axes[0, 0].get_legend_handles_labels()
    drawing.legend(handles, labels, loc="outside upper center", ncols=4, handlelength=3.2)
    workspace.save(item, "modes", drawing)
