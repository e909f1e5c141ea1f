"""Bolted plates and lapped bars for the tests of derivatives, in SI units."""

from dataclasses import replace
from typing import Any

from bodies import STEEL, two_bars

import skfem_joint as sj

HEIGHT, DEEP = 0.01, 0.03
JOINT = sj.Joint("contact", "preload", 0.3, against="face")
STIFF = {"tangential_stiffness": 3e12}
BOLTS = [sj.Clamp(9e3, "head_1", "nut_1"), sj.Clamp(7e3, "head_2", "nut_2")]


def plates(solid: bool, order: int = 1) -> sj.NamedMesh:
    """Two plates over each other along x, of unlike elements, with places for two bolts on each."""

    def one(prefix: str, y: float, n: int, sides: dict[str, Any]) -> sj.NamedMesh:
        strips = [("a", 0.03, 3), ("1", 0.02, 2), ("b", 0.05, n), ("2", 0.02, 2), ("c", 0.03, 3)]
        named = [(prefix + name, length, count) for name, length, count in strips]
        how: dict[str, Any] = {"boundaries": sides, "order": order}
        if solid:
            return sj.build_box(named, (HEIGHT, DEEP), (1, 3), origin=(0.0, y, 0.0), **how)
        return sj.build_plate(named, HEIGHT, 2, origin=(0.0, y), **how)

    upper = {"contact": "bottom", "right": "right"} | {f"head_{k}": ("top", f"u{k}") for k in "12"}
    lower = {"face": "top", "left": "left"} | {f"nut_{k}": ("bottom", f"l{k}") for k in "12"}
    return sj.merged([one("u", HEIGHT, 5, upper), one("l", 0.0, 4, lower)])


def bolted(solid: bool = False, order: int = 1, joint: Any = None, **changes: Any) -> sj.Structure:
    sizes = {} if solid else {"thickness": DEEP}
    values = {"fixed": ["left"], "joints": [replace(JOINT, **(joint or {}))], "bolts": BOLTS}
    return sj.Structure(plates(solid, order), STEEL, **sizes, **values | changes)


def loads(on: str, dim: int, frequency: float | None = 300.0) -> list[sj.Load]:
    amplitude = sj.Triangle(1.0, 1e-3) if frequency is None else sj.Harmonic(1.0, frequency)
    return [sj.Load(on, amplitude, (*[0.0] * (dim - 1), 1.0))]


BAR = {"stiffness_damping": 2e-6, "mass_damping": 3.0, "regions": {"upper_arm": {"E": 70e9}}}


def bar(joint: Any = None, **changes: Any) -> sj.Structure:
    given = two_bars(4, 4, arm=5, **BAR | changes)
    return replace(given, joints=[replace(given.joints[0], **(joint or {}))])


def lapped(**joint: Any) -> sj.Structure:
    """Two boxes that lap, with a bolt at each end of the lap, bent."""
    parts, lap = [], [("1", 0.01, 1), ("middle", 0.02, 2), ("2", 0.01, 1)]
    for x, y, name, strips, sides in (
        (0.0, 0.0, "lower ", [("arm", 0.04, 4), *lap], {"fixed": "left", "face": "top"}),
        (0.04, 0.01, "upper ", [*lap, ("arm", 0.04, 4)], {"end": "right", "contact": "bottom"}),
    ):
        side, bolt = ("bottom", "nut") if y == 0.0 else ("top", "head")
        bolts = {f"{bolt}_{k}": (side, f"{name}{k}") for k in "12"}
        named = [(name + strip, length, count) for strip, length, count in strips]
        sizes = (0.01, 0.02), (1, 2)
        parts.append(sj.build_box(named, *sizes, origin=(x, y, 0.0), boundaries=sides | bolts))
    bolts = [sj.Clamp(3e3, "head_1", "nut_1"), sj.Clamp(4e3, "head_2", "nut_2")]
    joints = [sj.Joint("contact", "preload", 0.5, against="face", **joint)]
    steel = sj.Material(200e9, 7800.0, 0.3)
    return sj.Structure(
        sj.merged(parts), steel, fixed=["fixed"], joints=joints, bolts=bolts, damping_ratio=2e-3
    )
