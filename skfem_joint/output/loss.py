"""Loss factors, and the parts of joints and bolts, as tables, summaries and sentences have them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from skfem_joint.ground.arrays import FloatArray
from skfem_joint.ground.files import safe_names
from skfem_joint.output.plots import prefixed_unit
from skfem_joint.results.loss import Losses, known, losses
from skfem_joint.results.normal_force import NormalChange
from skfem_joint.results.places import JointPlaces, PlaceResults
from skfem_joint.study.results import Model
from skfem_joint.study.scene_backbone import AtAmplitudes
from skfem_joint.vibration.amplitudes import UNITS
from skfem_joint.vibration.response_curve import Curve

#: Share of the friction limit of a place whose points slip from which it slips as a whole.
WHOLE = 0.99
#: Sources of the errors of a loss factor in words.
_SOURCES = {"mesh": "the mesh", "cycles": "load increments", "model": "the smaller model"}
#: Share of a friction limit below which nothing is said to slip.
NOTHING = 5e-4


def of_response(places: JointPlaces, curve: Curve) -> PlaceResults:
    """Results of joints and bolts at the frequencies of a response."""
    unknown = np.full(places.system.contact.w.size, np.nan)
    works = [unknown if p.friction_work is None else p.friction_work for p in curve.points]
    slip = np.array([p.slip for p in curve.points])
    return places.of_curve(np.array(works), slip, 1.0 / curve.column("frequency"))


def place_cells(results: PlaceResults, row: int) -> dict[str, float]:
    """Cells of a row with results of each joint and bolt; none where there is a single joint."""
    if len(results.names) < 2:
        return {}
    names = safe_names(results.names)
    return {
        column.format(name): value
        for column, values in results.columns.items()
        for name, value in zip(names, values[row].tolist(), strict=True)
    }


def asked_cells(at: AtAmplitudes, k: int) -> dict[str, Any]:
    """First cells of a row of the amplitude number ``k``: point, quantity, value, its unit."""
    asked = at.asked
    return {
        "point": asked.point,
        "quantity": asked.quantity.removesuffix("_g"),
        "value": float(asked.values[k]),
        "unit": UNITS[asked.quantity],
    }


def error_cells(at: AtAmplitudes, k: int) -> dict[str, float]:
    """Stated relative errors of the loss factor at an amplitude, by source and in all.

    nan where a source is not known, or does not apply.
    """
    errors = {name: _known(at, name) for name in ("mesh", "cycles", "model")} | {"total": at.total}
    return {f"loss_factor_error_{name}": float(error[k]) for name, error in errors.items()}


def content(losses: Losses, by_place: PlaceResults, k: int) -> dict[str, Any]:
    """Content of a summary about the cycle number ``k``: energies, joints and bolts."""
    entries = [*by_place.entries(k)]
    bolts = {name: values for name, is_bolt, values in entries if is_bolt}
    joints = {name: values for name, is_bolt, values in entries if not is_bolt}
    return {**known(losses.row(k)), "joints": joints, **({"bolts": bolts} if bolts else {})}


def not_counted(at: AtAmplitudes, normal: NormalChange | None) -> str:
    """What the stated error of a loss factor leaves out, and how much it may be, in words.

    ``normal`` is the change of the normal force at the highest level, where contact is closed.
    """
    missing = [
        f"the error by {_SOURCES[source]}, which is not known"
        for source in ("mesh", "cycles")
        if not np.isfinite(_known(at, source)).all()
    ]
    if modes := at.curve.excites:
        missing.append(
            f"friction excites {', '.join(modes)} the frequency, by which the loss factor may be "
            "twice as large or more"
        )
    if normal is not None and normal.doubts():
        missing.append(
            f"normal forces are kept, though the vibration may change them by "
            f"{100.0 * normal.mean:.2g} % on average"
        )
    return "; ".join(missing)


def _known(at: AtAmplitudes, source: str) -> FloatArray:
    """Stated error by a source, (levels,); nan where it is not known."""
    return at.errors.get(source, np.full(at.total.size, np.nan))


def amplitude_content(
    at: AtAmplitudes, places: JointPlaces, normal: NormalChange | None
) -> list[dict[str, Any]]:
    """Content of a summary about each amplitude that was asked for."""
    c = at.curve
    by_place = places.of_curve(c.friction_work, c.slip)
    return [
        {
            **asked_cells(at, k),
            "frequency_Hz": float(c.frequency[k]),
            "damping_ratio": float(c.damping_ratio[k]),
            "state": c.state[k],
            **known(error_cells(at, k)),
            "not_counted": not_counted(at, normal),
            **content(c.losses, by_place, k),
        }
        for k in range(c.level.size)
    ]


def amplitude_lines(
    model: str, at: AtAmplitudes, places: JointPlaces, normal: NormalChange | None
) -> Iterator[str]:
    """Lines about a mode at the amplitudes that were asked for."""
    c, asked = at.curve, at.asked
    by_place = places.of_curve(c.friction_work, c.slip)
    for k, value in enumerate(asked.values.tolist()):
        losses = c.losses.row(k)
        yield (
            f"{model} model, mode {c.mode}, {asked.text(value)}: loss factor "
            f"{losses['loss_factor']:.3g}{_error(at, k, normal)}, equivalent viscous ratio "
            f"{100.0 * losses['equivalent_viscous_ratio']:.3g} %, Q "
            f"{losses['quality_factor']:.3g}, {c.frequency[k]:.5g} Hz."
        )
        yield (
            f"  A cycle loses {losses['lost_by_friction_J']:.3g} J by friction and "
            f"{losses['lost_by_damping_J']:.3g} J by damping; its largest strain energy is "
            f"{losses['largest_strain_energy_J']:.3g} J."
        )
        entries = [*by_place.entries(k)]
        bolts = {name: values for name, is_bolt, values in entries if is_bolt}
        yield from _place_lines(bolts or {name: values for name, _, values in entries})


def run_lines(content: Mapping[str, Any]) -> Iterator[str]:
    """Lines about the last cycle of each model of a summary of runs; none without cycles."""
    for name, model in content["models"].items():
        if model.get("loss_factor") is None:
            continue
        error = model["loss_factor_error_total"]
        stated = "" if error is None else f" ± {100.0 * error:.2g} %"
        if stated and model["estimated_total_without_mesh"]:
            stated += " (not counted: the error by the mesh, which is not known)"
        yield (
            f"{name} model, last cycle: loss factor {model['loss_factor']:.4g}{stated}. It loses "
            f"{model['lost_by_friction_J']:.3g} J by friction and "
            f"{model['lost_by_damping_J']:.3g} J by damping; its largest strain energy is "
            f"{model['largest_strain_energy_J']:.3g} J."
        )
        yield from _place_lines(model.get("bolts") or model["joints"], " over the run")


def loss_label(model: Model, on_mesh: bool) -> str:
    """Loss factor of a run's last cycle with its stated error, and the energies it is made of.

    ``on_mesh``: whether its structure has elements, whose error may not be known.
    """
    found, error = losses(model.run), model.loss_error
    if not np.isfinite(found.loss_factor):
        return ""
    lost = {"friction": found.friction, "damping": found.viscous, "impacts": found.impacts}
    parts = [(name, float(x)) for name, x in lost.items() if x is not None and x != 0.0]
    shown = " + ".join(f"{joule(x)} {name}" for name, x in parts) or "0 J"
    stated = "" if error is None else f" ± {100.0 * error:.2g} %"
    if stated and on_mesh and model.estimate is not None and model.estimate.lacks_mesh:
        stated += " without mesh"
    return (
        f"loss factor {float(found.loss_factor):#.3g}{stated}\n"
        f"({shown}) / (2π · {joule(float(found.strain))})"
    )


def joule(energy: float) -> str:
    """Energy to three digits with the prefix that suits it."""
    unit, size = prefixed_unit("J", [np.array([energy])])
    return f"{energy / size:.3g} {unit}"


def _error(at: AtAmplitudes, k: int, normal: NormalChange | None) -> str:
    """What is known of the error of a loss factor, with its sources, and what is not counted."""
    known = [source for source, error in at.errors.items() if np.isfinite(error[k])]
    by = " and ".join(_SOURCES[source] for source in known)
    stated = f" ± {100.0 * at.total[k]:.2g} % by {by}" if known else ""
    missing = not_counted(at, normal)
    return f"{stated}{f' (not counted: {missing})' if missing else ''}"


def _place_lines(places: Mapping[str, Mapping[str, Any]], when: str = "") -> Iterator[str]:
    """Line about each bolt or joint; ``when`` says when its largest slip is."""
    for name, values in places.items():
        slips, share = values["slipping_share"], values["loss_share"]
        loses = "" if share is None else f"{100.0 * share:.3g} % of the friction loss, "
        if slips is None:
            how = "nothing presses it at rest, so that the share that slips is not known"
        elif slips <= NOTHING:
            how = "it sticks"
        elif slips >= WHOLE:
            how = "it slips as a whole"
        else:
            how = f"{100.0 * slips:.2g} % of its friction limit slips"
        normal = 100.0 * (values["normal_force_share"] or 0.0)
        yield (
            f"  {name}: {loses}{how}, slip up to {values['largest_slip_m']:.3g} m{when}, "
            f"{normal:.3g} % of the normal force."
        )
