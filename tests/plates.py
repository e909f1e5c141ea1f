"""Plates for the tests, in SI units."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from bars import DENSITY, MU, THICKNESS, E

from skfem_joint.plate import PlateJoint, PlateStructure, build_plate_structure
from skfem_joint.plate_mesh import PlateMesh, build_plate, merged

ELEMENTS: list[tuple[Any, int]] = [
    ("triangle", 1),
    ("triangle", 2),
    ("quadrilateral", 1),
    ("quadrilateral", 2),
]


def mapped(plate: PlateMesh, function: Callable[[np.ndarray], np.ndarray]) -> PlateMesh:
    """The same plate with its vertices (2, n) moved."""
    return replace(plate, mesh=replace(plate.mesh, doflocs=function(plate.mesh.p)))


def distorted(plate: PlateMesh, part: float = 0.2, seed: int = 1) -> PlateMesh:
    """The same plate with the vertices inside its regions moved by a part of the element's size."""
    mesh = plate.mesh
    shift = part * mesh.param() / 2 * np.random.default_rng(seed).uniform(-1, 1, mesh.p.shape)
    regions = [np.unique(mesh.t[:, elements]) for elements in plate.regions.values()]
    used = np.bincount(np.concatenate(regions), minlength=mesh.p.shape[1])
    shift[:, mesh.boundary_nodes()] = 0.0
    shift[:, used > 1] = 0.0
    return mapped(plate, lambda p: p + shift)


def turned(plate: PlateMesh, angle: float) -> PlateMesh:
    """The same plate turned about the origin (degrees)."""
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    return mapped(plate, lambda p: np.array([[c, -s], [s, c]]) @ p)


def plate_structure(
    plate: PlateMesh,
    joints: Sequence[PlateJoint] = (),
    supports: Sequence[tuple[str, str]] = (("left", "xy"),),
    **changes: Any,
) -> PlateStructure:
    """Structure of the paper's material, held at ``left``."""
    values = {"E": E, "poisson": 0.3, "density": DENSITY, "thickness": THICKNESS} | changes
    return build_plate_structure(plate, supports=supports, joints=joints, **values)


def pressed(name: str = "joint", **changes: Any) -> PlateJoint:
    """Joint on a region, on a rigid base."""
    values = {"kind": "region", "against": None, "pressure": 8e6, "friction": MU} | changes
    return PlateJoint(name, **values)


def lap_plates(
    elements: tuple[int, int] = (4, 4),
    order: int = 1,
    kind: Any = "quadrilateral",
    across: tuple[int, int] = (2, 2),
) -> PlateMesh:
    """Two plates of length 0.3 and width 0.05 over each other on 0.1, seen from above."""
    lower = build_plate(
        [("lower_rest", 0.2, 4), ("lower_joint", 0.1, elements[0])], 0.05, across[0],
        kind=kind, order=order, prefix="lower_", points={"lower_corner": (0.3, 0.05)},
    )  # fmt: skip
    upper = build_plate(
        [("upper_joint", 0.1, elements[1]), ("upper_rest", 0.2, 4)], 0.05, across[1],
        origin=(0.2, 0.0), kind=kind, order=order, prefix="upper_",
    )  # fmt: skip
    return merged([lower, upper])


def side_plates(elements: tuple[int, int] = (4, 4), order: int = 1) -> PlateMesh:
    """The same two plates seen from the side, the lower surface of one on the other's upper."""
    lower = build_plate(
        [("lower_rest", 0.2, 4), ("lower_joint", 0.1, elements[0])], 0.01, 2, order=order,
        boundaries={"lower_left": "left", "face": ("top", "lower_joint"), "base": "bottom"},
    )  # fmt: skip
    upper = build_plate(
        [("upper_joint", 0.1, elements[1]), ("upper_rest", 0.2, 4)], 0.01, 1, order=order,
        origin=(0.2, 0.01),
        boundaries={"upper_right": "right", "contact": ("bottom", "upper_joint")},
    )  # fmt: skip
    return merged([lower, upper])
