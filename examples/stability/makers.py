"""Structures and systems of cases, of bars and of plates alike, in the units of each case."""

from dataclasses import replace

import numpy as np

import skfem_joint as sj
from skfem_joint.mesh import named
from stability.cases import DENSITY, DIRECTIONS, ONE, TWO, UNITS, E

#: Loads by name, but for the harmonic one and the rectangle.
PULSES = {"triangle": sj.Triangle, "half sine": sj.HalfSine}
PULSES |= {"versine": sj.Versine, "ramp": sj.RampAndHold}


def structure_of(case):
    """Structure of a case: held at the left, loaded at the right."""
    metre, kilogram, second = (1.0 / unit for unit in UNITS[case.units])
    pascal, length = kilogram / metre / second**2, case.length * metre
    modulus, density = E * case.stiffness * pascal, DENSITY * case.density * kilogram / metre**3
    lower = {"E": modulus * case.stiffness_ratio, "density": density * case.density_ratio}
    mesh = (_plates if case.is_plate else _bar)(case, length)
    section = {"plane": case.plane} if case.is_plate else {"width": 0.2 * length}
    pressure = high = case.pressure * pascal
    if case.pressed == "halves":
        middle, low = 0.5 * length, 1e-6 * high
        at = 0.0, middle, middle * (1.0 + 1e-9), length
        pressure = sj.PressureTable(at, (low, low, high, high))
    on = "face" if case.bodies in ("edge", "side by side") else "joint"
    against, beta = f"lower_{on}" if case.bodies in TWO else None, case.beta * second / metre
    joints = [sj.Joint(on, pressure, case.friction, against=against, beta=beta)]
    if case.second_friction is not None:
        joints.append(replace(joints[0], on="second_joint", friction=case.second_friction))
    return sj.Structure(
        mesh,
        sj.Material(modulus, density, case.poisson if case.is_plate else None),
        thickness=0.04 * length,
        **section,
        fixed=["left"] if case.held else [],
        joints=joints,
        stiffness_damping=case.damping * second,
        regions={name: lower for name in mesh.regions if name.startswith("lower")},
    )


def _bar(case, length):
    """Bar whose elements grow geometrically towards the support; that half is a region."""
    (n,) = case.elements
    if case.grading == case.stiffness_ratio == case.density_ratio == 1.0:
        return sj.build_bar([("joint", length, n)], {"left": 0.0, "right": length})
    sizes = np.geomspace(case.grading, 1.0, n)
    sizes *= length / sizes.sum()
    parts = [("joint", size, 1) for size in sizes.tolist()]
    bar = sj.build_bar(parts, {"left": 0.0, "right": float(sizes.sum())})
    return replace(bar, mesh=bar.mesh.with_subdomains({"lower_half": np.arange(n // 2)}))


def _plates(case, length):
    """A plate, or two plates that overlap on half of their length."""
    along, across = case.elements
    width, middle = length / along / case.aspect * across, 0.5 * length
    half, rest = along // 2, along - along // 2
    kind = {"kind": case.kind, "order": case.order}
    if case.bodies in ONE:
        strips = [("joint", length, along)]
        if case.second_friction is not None:
            strips = [("second_joint", middle, half), ("joint", middle, rest)]
        elif case.part < 1.0:
            pressed = max(1, round(case.part * along))
            reach = pressed * length / along
            strips = [("joint", reach, pressed), ("free", length - reach, along - pressed)]
        sides = {"left": "left", "right": "right", "face": "bottom"}
        plate = sj.build_plate(strips, width, across, boundaries=sides, **kind)
    else:
        more, start = int(case.bodies != "lap"), (middle, width * (case.bodies == "side by side"))
        strips = [("lower_rest", middle, rest), ("lower_joint", middle, half)]
        sides = {"left": "left", "lower_face": ("top", "lower_joint")}
        lower = sj.build_plate(strips, width, across, boundaries=sides, **kind)
        strips = [("joint", middle, half + more), ("rest", middle, rest)]
        sides = {"right": "right", "face": ("bottom", "joint")}
        upper = sj.build_plate(strips, width, across + more, origin=start, boundaries=sides, **kind)
        plate = sj.merged([lower, upper])
    if case.turned == 0.0:
        return plate
    return named(replace(plate.mesh, doflocs=_turn(case) @ plate.mesh.p), order=case.order)


def _turn(case):
    c, s = np.cos(np.radians(case.turned)), np.sin(np.radians(case.turned))
    return np.array([[c, -s], [s, c]])


def system_of(case):
    """System of a case with displacements of the right end as its points.

    A bar has one point. A plate has three: along the load, then along and across the plate before
    it is turned.
    """
    structure = structure_of(case)
    direction = tuple(_turn(case) @ DIRECTIONS[case.direction]) if case.is_plate else None
    system = structure.system([sj.Load("right", amplitude_of(case, 1.0), direction)], ["right"])
    w = system.contact.w.copy()
    if case.pressed == "one node":
        w[np.arange(w.size) != w.size // 2] = 0.0
    elif case.pressed == "alternating":
        w[1::2] *= 1e-6
    length, mass, time = UNITS[case.units]
    peak = case.share * w.sum() if case.force is None else case.force * time**2 / length / mass
    load = replace(system.loads[0], amplitude=amplitude_of(case, float(peak)))
    P = system.P.toarray()
    if case.turned != 0.0:
        P[1:] = _turn(case).T @ P[1:]
    return replace(system.with_contact(given=w), loads=(load,), P=P)


def amplitude_of(case, peak):
    """Load of a case over time with the largest force ``peak``."""
    time = UNITS[case.units][2]
    if case.load == "harmonic":
        return sj.Harmonic(peak, case.frequency * time, case.phase)
    rise = case.step * case.duration if case.duration else 0.5 / case.frequency
    rise, start = rise / time, 2.3 * case.step / time
    if case.load == "rectangle":
        return sj.Rectangle(peak, 2.0 * rise, start)
    return PULSES[case.load](peak, rise, start)
