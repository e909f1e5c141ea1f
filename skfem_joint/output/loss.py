"""Loss factors, and the parts of joints and bolts, as tables, summaries and sentences have them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from skfem_joint.ground.arrays import FloatArray
from skfem_joint.ground.files import safe_names
from skfem_joint.ground.plain_values import spread
from skfem_joint.output.plots import prefixed_unit
from skfem_joint.results.loss import Losses, known, losses
from skfem_joint.results.normal_force import NormalChange
from skfem_joint.results.places import JointPlaces, PlaceResults
from skfem_joint.study.results import Model
from skfem_joint.study.scene_backbone import AtAmplitudes
from skfem_joint.vibration.amplitudes import UNITS
from skfem_joint.vibration.backbone import Backbone
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


def place_columns(results: PlaceResults) -> dict[str, Any]:
    """Columns of results of each joint and bolt; none where there is a single joint."""
    columns, names = dict[str, Any](), safe_names(results.names)
    for column, values in results.columns.items() if len(names) > 1 else ():
        columns |= spread(column, values, names)
    return columns


def asked_columns(at: AtAmplitudes) -> dict[str, Any]:
    """First columns over amplitudes that are asked for: point, quantity, value, its unit."""
    asked = at.asked
    quantity, unit = asked.quantity.removesuffix("_g"), UNITS[asked.quantity]
    return {"point": asked.point, "quantity": quantity, "value": asked.values, "unit": unit}


def error_columns(at: AtAmplitudes) -> dict[str, FloatArray]:
    """Columns of stated relative errors of the loss factor and of the friction loss.

    By source and in all; nan where a source is not known, or does not apply.
    """
    errors = dict.fromkeys(("mesh", "cycles", "model"), np.full(at.total.shape, np.nan))
    errors |= at.errors | {"total": at.total}
    return {
        f"{of}_error_{source}": error[number]
        for number, of in enumerate(("loss_factor", "friction_loss"))
        for source, error in errors.items()
    }


def content(losses: Losses, by_place: PlaceResults, k: int) -> dict[str, Any]:
    """Content of a summary about the cycle number ``k``: energies, joints and bolts."""
    entries = [*by_place.entries(k)]
    bolts = {name: values for name, is_bolt, values in entries if is_bolt}
    joints = {name: values for name, is_bolt, values in entries if not is_bolt}
    return {**known(losses.row(k)), "joints": joints, **({"bolts": bolts} if bolts else {})}


def not_counted(at: AtAmplitudes, k: int, normal: NormalChange | None) -> str:
    """What the stated error of the loss factor number ``k`` leaves out, and how much it may be.

    ``normal`` is the change of the normal force at the highest level, where contact is closed.
    """
    missing = [
        f"the error by {_SOURCES[source]}, which is not known"
        for source in ("mesh", "cycles")
        if not _is_known(at, source)
    ]
    if at.curve.losses.viscous[k] > 0.0:
        missing.append("that of the damping coefficient, which is given")
    if modes := at.curve.at_levels(np.array([k])).excites:
        missing.append(
            f"friction excites {', '.join(modes)} the frequency, by which the friction part may be "
            "twice as large or more"
        )
    if normal is not None and normal.doubts():
        missing.append(
            f"normal forces are kept, though the vibration may change them by "
            f"{100.0 * normal.mean:.2g} % on average"
        )
    return "; ".join(missing)


def _is_known(at: AtAmplitudes, source: str) -> bool:
    """Whether the error by a source is known at all amplitudes."""
    return source in at.errors and bool(np.isfinite(at.errors[source][0]).all())


def amplitude_content(
    at: AtAmplitudes, places: JointPlaces, normal: NormalChange | None
) -> list[dict[str, Any]]:
    """Content of a summary about each amplitude that was asked for."""
    c = at.curve
    by_place = places.of_curve(c.friction_work, c.slip)
    return [
        {
            **asked_columns(at),
            "value": float(at.asked.values[k]),
            "frequency_Hz": float(c.frequency[k]),
            "damping_ratio": float(c.damping_ratio[k]),
            "state": c.state[k],
            **known({name: float(errors[k]) for name, errors in error_columns(at).items()}),
            "not_counted": not_counted(at, k, normal),
            **content(c.losses, by_place, k),
        }
        for k in range(c.level.size)
    ]


def split(losses: Mapping[str, float], given: str = "given") -> str:
    """Loss factor and its parts in words, from a row of losses; ``given`` says by what damping."""
    names = {"friction": "friction", "damping": f"damping ({given})", "impacts": "impacts"}
    lost = {text: losses.get(f"lost_by_{name}_J") or 0.0 for name, text in names.items()}
    whole, total = losses["loss_factor"], sum(lost.values())
    parts = [f"{whole * x / total:.3g} by {name}" for name, x in lost.items() if x]
    return " = ".join([f"loss factor {whole:.3g}", *([" + ".join(parts)] if parts else [])])


def level_lines(
    model: str, curve: Backbone, at: AtAmplitudes, places: JointPlaces
) -> Iterator[str]:
    """Line about which amplitudes a curve has, and from which on each bolt slips as a whole."""
    point = places.system.points.index(at.asked.point)
    lost, slips = curve.losses.lost, places.of_curve(curve.friction_work, curve.slip)
    values = at.asked.along(curve.displacement[:, point], curve.frequency, lost)
    share = curve.level / curve.slips_at
    yield (
        f"{model} model, mode {curve.mode}: the levels {share[0]:.3g} to {share[-1]:.3g} of the "
        f"curve are a {at.asked.text(values[0], values[-1])}; at level 1 the first joint slips as "
        "a whole. Amplitudes asked for are computed, below the first level too."
    )
    for name, shares in zip(slips.names, slips.slipping_share.T, strict=True):
        if at.merged:
            return
        if (whole := np.flatnonzero(shares >= WHOLE)).size:
            k = int(whole[0])
            begins = at.asked.text(values[k - 1] if k else 0.0, values[k])
            yield f"  {name} begins to slip as a whole at a {begins}."
        else:
            part = f"{100.0 * shares[-1]:.2g} % of its friction limit"
            yield f"  {name} does not slip as a whole at any of them; at the last {part} slips."


def amplitude_lines(
    model: str, at: AtAmplitudes, places: JointPlaces, normal: NormalChange | None, given: str
) -> Iterator[str]:
    """Lines about a mode at the amplitudes that were asked for; ``given`` as for `split`."""
    c, asked = at.curve, at.asked
    by_place = places.of_curve(c.friction_work, c.slip)
    for k, value in enumerate(asked.values.tolist()):
        losses = c.losses.row(k)
        yield (
            f"{model} model, mode {c.mode}, {asked.text(value)}: {split(losses, given)}"
            f"{_error(at, k)}, Q {losses['quality_factor']:.3g}, {c.frequency[k]:.5g} Hz."
        )
        if missing := not_counted(at, k, normal):
            yield f"  Not counted: {missing}."
        yield f"  A cycle {_loses(losses)}"
        entries = [*by_place.entries(k)]
        bolts = {name: values for name, is_bolt, values in entries if is_bolt}
        if at.merged:
            yield _rough(at.merged, places.system.contact.w.size)
        yield from _place_lines(bolts or {name: values for name, _, values in entries})


def run_lines(content: Mapping[str, Any]) -> Iterator[str]:
    """Lines about the last cycle of each model of a summary of runs; none without cycles."""
    models = content["models"]
    most = max((model["contact_points"] for model in models.values()), default=0)
    for name, model in models.items():
        if model.get("loss_factor") is None:
            continue
        error = model["loss_factor_error_total"]
        own = model["estimated_error"]["friction_energy_per_cycle"]["total"]
        lacks = " without mesh" * bool(model["estimated_total_without_mesh"])
        stated = "" if error is None else f", numerical error{lacks} ± {100.0 * error:.2g} %"
        if stated and own is not None:
            stated += f" (of the friction energy ± {100.0 * own:.2g} %)"
        yield f"{name} model, last cycle: {split(model)}{stated}. It {_loses(model)}"
        if model["contact_points"] < most:
            yield _rough(model["contact_points"], most)
        yield from _place_lines(model.get("bolts") or model["joints"], " over the run")


def _loses(losses: Mapping[str, float]) -> str:
    """End of a sentence about the energies of a cycle, from a row of losses."""
    return (
        f"loses {losses['lost_by_friction_J']:.3g} J by friction and "
        f"{losses['lost_by_damping_J']:.3g} J by damping; its largest strain energy is "
        f"{losses['largest_strain_energy_J']:.3g} J."
    )


def _rough(points: int, of: int) -> str:
    """Line about what merged friction points do not resolve."""
    return (
        f"  {points} friction points stand for {of}, which does not resolve what slips where: "
        "parts of bolts and joints are rough. Those of the full model hold."
    )


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


def _error(at: AtAmplitudes, k: int) -> str:
    """What is known of the error of a loss factor and of its part by friction, with its sources."""
    known = [_SOURCES[source] for source in at.errors if _is_known(at, source)]
    if not known:
        return ""
    lacks = ["mesh"] if not _is_known(at, "mesh") else []
    lacks += ["higher modes"] if at.curve.at_levels(np.array([k])).excites else []
    without = f" without {' and '.join(lacks)}" if lacks else ""
    total, friction, own = *at.total[:, k], ""
    if np.isfinite(friction) and at.curve.losses.friction[k] > 0.0:
        own = f" (of the friction part ± {100.0 * friction:.2g} %)"
    error = f"± {100.0 * total:.2g} %{own} by {' and '.join(known)}"
    return f", numerical error{without} {error}"


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
            f"{normal:.3g} % of the normal force of all joints."
        )
