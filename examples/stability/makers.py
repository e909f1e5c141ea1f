"""Structures and systems of cases, of bars and of plates alike, in the units of each case."""

from dataclasses import replace
from typing import Any

import numpy as np

import skfem_joint as sj
from skfem_joint.arrays import FloatArray
from skfem_joint.mesh import NamedMesh, named
from stability.problem import DENSITY, DIRECTIONS, ONE, TWO, UNITS, Case, E


def structure_of(case: Case) -> sj.Structure:
    """Structure of a case: held at the left, loaded at the right."""
    metre, kilogram, second = (1.0 / unit for unit in UNITS[case.units])
    pascal, length = kilogram / metre / second**2, case.length * metre
    modulus, density = E * case.stiffness * pascal, DENSITY * case.density * kilogram / metre**3
    lower = {"E": modulus * case.stiffness_ratio, "density": density * case.density_ratio}
    mesh = (_plates if case.is_plate else _bar)(case, length)
    section: dict[str, Any] = {"plane": case.plane} if case.is_plate else {"width": 0.2 * length}
    return sj.Structure(
        mesh,
        sj.Material(modulus, density, case.poisson if case.is_plate else None),
        thickness=0.04 * length,
        **section,
        fixed=["left"] if case.held else [],
        joints=_joints(case, length, pascal, second / metre),
        stiffness_damping=case.damping * second,
        regions={name: lower for name in mesh.regions if name.startswith("lower")},
    )


def _joints(case: Case, length: float, pascal: float, beta: float) -> list[sj.Joint]:
    high = case.pressure * pascal
    pressure: float | sj.PressureTable = high
    if case.pressed == "halves":
        middle, low = 0.5 * length, 1e-6 * high
        pressure = sj.PressureTable(
            (0.0, middle, middle * (1.0 + 1e-9), length), (low, low, high, high)
        )
    on = "face" if case.bodies in ("edge", "side by side") else "joint"
    against = f"lower_{on}" if case.bodies in TWO else None
    joint = sj.Joint(on, pressure, case.friction, against=against, beta=case.beta * beta)
    if case.second_friction is None:
        return [joint]
    return [joint, replace(joint, on="second_joint", friction=case.second_friction)]


def _bar(case: Case, length: float) -> NamedMesh:
    """Bar whose elements grow geometrically towards the support, and its half there."""
    (n,) = case.elements
    if case.grading == case.stiffness_ratio == case.density_ratio == 1.0:
        return sj.build_bar([("joint", length, n)], {"left": 0.0, "right": length})
    sizes = np.geomspace(case.grading, 1.0, n)
    sizes *= length / sizes.sum()
    parts = [("joint", float(size), 1) for size in sizes]
    bar = sj.build_bar(parts, {"left": 0.0, "right": float(sizes.sum())})
    half = bar.mesh.with_subdomains({"lower_half": np.arange(n // 2)})
    return replace(bar, mesh=half)


def _plates(case: Case, length: float) -> NamedMesh:
    """Rectangle, or two that overlap on half of their length."""
    along, across = case.elements
    width = length / along / case.aspect * across
    half, rest = along // 2, along - along // 2
    kind: dict[str, Any] = {"kind": case.kind, "order": case.order}
    if case.bodies in ONE:
        strips = [("joint", length, along)]
        if case.second_friction is not None:
            strips = [("second_joint", 0.5 * length, half), ("joint", 0.5 * length, rest)]
        elif case.part < 1.0:
            pressed = max(1, round(case.part * along))
            reach = pressed * length / along
            strips = [("joint", reach, pressed), ("free", length - reach, along - pressed)]
        sides: Any = {"left": "left", "right": "right", "face": "bottom"}
        plate = sj.build_plate(strips, width, across, boundaries=sides, **kind)
    else:
        edge, more = case.bodies == "side by side", int(case.bodies != "lap")
        lower = sj.build_plate(
            [("lower_rest", 0.5 * length, rest), ("lower_joint", 0.5 * length, half)],
            width,
            across,
            boundaries={"left": "left", "lower_face": ("top", "lower_joint")},
            **kind,
        )
        upper = sj.build_plate(
            [("joint", 0.5 * length, half + more), ("rest", 0.5 * length, rest)],
            width,
            across + more,
            origin=(0.5 * length, width if edge else 0.0),
            boundaries={"right": "right", "face": ("bottom", "joint")},
            **kind,
        )
        plate = sj.merged([lower, upper])
    if case.turned == 0.0:
        return plate
    turned = replace(plate.mesh, doflocs=_turn(case) @ plate.mesh.p)
    return named(turned, order=case.order)


def _turn(case: Case) -> FloatArray:
    c, s = np.cos(np.radians(case.turned)), np.sin(np.radians(case.turned))
    return np.array([[c, -s], [s, c]])


def system_of(case: Case) -> sj.System:
    """System of a case; it observes the right end.

    A bar's is one displacement. A plate's are three: along the load, then along and across the
    plate before it is turned.
    """
    structure = structure_of(case)
    direction = tuple(_turn(case) @ DIRECTIONS[case.direction]) if case.is_plate else None
    system = structure.system([sj.Load("right", amplitude_of(case, 1.0), direction)], ["right"])
    w = system.w.copy()
    if case.pressed == "one node":
        w[np.arange(w.size) != w.size // 2] = 0.0
    elif case.pressed == "alternating":
        w[1::2] *= 1e-6
    length, mass, time = UNITS[case.units]
    peak = case.share * float(w.sum())
    if case.force is not None:
        peak = case.force * time**2 / length / mass
    load = replace(system.loads[0], amplitude=amplitude_of(case, peak))
    P = np.asarray(system.P.toarray())
    if case.turned != 0.0:
        P[1:] = _turn(case).T @ P[1:]
    return replace(system, w=w, loads=(load,), P=P)


def amplitude_of(case: Case, peak: float) -> Any:
    """Load of a case over time, by its largest force."""
    time = UNITS[case.units][2]
    if case.load == "harmonic":
        return sj.Harmonic(peak, case.frequency * time, case.phase)
    rise = case.step * case.duration if case.duration else 0.5 / case.frequency
    rise, start = rise / time, 2.3 * case.step / time
    if case.load == "rectangle":
        return sj.Rectangle(peak, 2.0 * rise, start)
    kinds: dict[str, Any] = {
        "triangle": sj.Triangle,
        "half sine": sj.HalfSine,
        "versine": sj.Versine,
        "ramp": sj.RampAndHold,
    }
    return kinds[case.load](peak, rise, start)
