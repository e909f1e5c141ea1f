"""Structures of every dimension and histories on them, for the tests of what is written."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skfem_joint.mesh import build_bar, build_box, build_plate, merged
from skfem_joint.output.fields import Field, Frames
from skfem_joint.structure import Joint, Material, Structure

STEEL = Material(200e9, 8000.0, 0.3)
TIMES = np.array([0.0, 1e-5, 0.1 + 0.2])
PRESSURE = 50e6

#: Kinds of elements by dimension, with the order of the displacement.
PLATES = [("quadrilateral", 1), ("quadrilateral", 2), ("triangle", 1), ("triangle", 2)]
BOXES = [("hexahedron", 1), ("hexahedron", 2), ("tetrahedron", 1), ("tetrahedron", 2)]


@cache
def bar(direction: tuple[float, float, float] = (1.0, 0.0, 0.0)) -> Structure:
    """Joint of 4 elements and a narrower region of 3, inclined, away from the origin."""
    made = build_bar([("joint", 0.1, 4), ("linear", 0.5, 3)], {"fixed": 0.0, "free_end": 0.6})
    along = np.array(direction) / np.linalg.norm(direction)
    place = np.array([0.3, -0.2, 0.1]) + made.mesh.p[0][:, None] * along
    return Structure(
        replace(made, coordinates=place), STEEL, width=0.05, thickness=0.01, fixed=["fixed"],
        joints=[Joint("joint", PRESSURE, 0.7)], regions={"linear": {"width": 0.03}},
    )  # fmt: skip


@cache
def plate(kind: Any = "quadrilateral", order: int = 1) -> Structure:
    """Joint of 0.1 m on a rigid base and a thicker free strip of 0.2 m, seen from above."""
    strips = [("joint", 0.1, 4), ("linear", 0.2, 4)]
    return Structure(
        build_plate(strips, 0.05, 2, kind=kind, order=order), STEEL, thickness=0.01,
        fixed=["left"], joints=[Joint("joint", PRESSURE, 0.7)],
        regions={"linear": {"thickness": 0.02}},
    )  # fmt: skip


@cache
def box(kind: Any = "hexahedron", order: int = 1) -> Structure:
    """Solid of 0.2 x 0.05 x 0.02 m on a base."""
    made = build_box(
        [("foot", 0.1, 3), ("arm", 0.1, 2)], (0.05, 0.02), (2, 2), kind=kind, order=order
    )
    return Structure(made, STEEL, fixed=["right"], joints=[Joint("front", PRESSURE, 0.7)])


@cache
def bars() -> Structure:
    """Two bars of other meshes that overlap on 0.1 m; the upper one is the region 'Stoß'."""
    lower = build_bar([("base", 0.2, 6), ("lower_joint", 0.1, 4)], {"wall": 0.0})
    upper = build_bar([("joint", 0.1, 5), ("arm", 0.2, 6)], {"tip": 0.3}, origin=(0.2, 0.0, 0.0))
    both = merged([lower, upper])
    whole = both.mesh.with_subdomains({"Stoß": np.flatnonzero(both.body == 1)})
    return lapped(replace(both, mesh=whole), width=0.05, fixed=["wall"])


@cache
def lap(kind: str = "quadrilateral", order: int = 1) -> Structure:
    """Two plates of other meshes that overlap on 0.1 m, seen from above."""
    options: Any = {"kind": kind, "order": order}
    lower = build_plate(
        [("base", 0.2, 6), ("lower_joint", 0.1, 4)], 0.05, 2, prefix="lower_", **options
    )
    upper = build_plate(
        [("joint", 0.1, 5), ("arm", 0.2, 6)], 0.05, 3, origin=(0.2, 0.0), prefix="upper_", **options
    )
    return lapped(merged([lower, upper]), fixed=["lower_left"])


def lapped(mesh: Any, **options: Any) -> Structure:
    joints = [Joint("joint", PRESSURE, 0.7, against="lower_joint")]
    regions = {"base": {"thickness": 0.016}}
    return Structure(mesh, STEEL, thickness=0.01, joints=joints, regions=regions, **options)


@cache
def side(kind: str = "quadrilateral", order: int = 1) -> Structure:
    """Two plates on each other seen from their side, friction along the edge between them."""
    options: Any = {"kind": kind, "order": order}
    lower = build_plate([("below", 0.3, 6)], 0.02, 2, prefix="lower_", **options)
    upper = build_plate(
        [("above", 0.2, 5)], 0.02, 2, origin=(0.05, 0.02), prefix="upper_", **options
    )
    joints = [Joint("upper_bottom", PRESSURE, 0.7, against="lower_top")]
    return Structure(
        merged([lower, upper]), STEEL, thickness=0.03, fixed=["lower_left"], joints=joints
    )


@cache
def blocks(kind: str = "hexahedron", order: int = 1) -> Structure:
    """Two solids of other meshes on each other."""
    options: Any = {"kind": kind, "order": order}
    lower = build_box([("below", 0.2, 4)], (0.05, 0.02), (2, 1), prefix="lower_", **options)
    upper = build_box(
        [("above", 0.1, 3)], (0.05, 0.02), (3, 1), origin=(0.05, 0.0, 0.02), prefix="upper_",
        **options,
    )  # fmt: skip
    joints = [Joint("upper_front", PRESSURE, 0.7, against="lower_back")]
    return Structure(merged([lower, upper]), STEEL, fixed=["lower_left"], joints=joints)


def random_field(structure: Structure, name: str, frames: int = 3, seed: int = 0) -> Field:
    """Random history whose contact values live on the pressed nodes."""
    draw = np.random.default_rng(seed)
    n, dim = structure.nodes.shape
    pressed = np.zeros(n, dtype=bool)
    for patch in structure.patches:
        pressed[patch.nodes] = True
    return Field(
        name,
        1e-4 * draw.normal(size=(frames, n, dim)),
        draw.normal(size=(frames, n, dim)),
        1e-5 * draw.normal(size=(frames, n, dim)) * pressed[:, None],
        35e6 * draw.normal(size=(frames, n, dim)) * pressed[:, None],
        np.where(pressed, draw.integers(0, 2, (frames, n)), -1).astype(np.int8),
        draw.uniform(size=(frames, n)) * pressed,
    )


def random_frames(
    structure: Structure, names: tuple[str, ...] = ("full",), times: NDArray[np.float64] = TIMES
) -> Frames:
    """Random histories of models."""
    fields = [random_field(structure, name, times.size, k) for k, name in enumerate(names)]
    return Frames(structure, times, fields)


def pulled(structure: Structure, names: tuple[str, ...] = ("full",)) -> Frames:
    """Stretched along x and waved across it; slips from the ends inwards as it is pulled."""
    times, load_times = np.linspace(0.0, 4e-3, 9), np.linspace(0.0, 4e-3, 200)
    x = structure.nodes[:, 0]
    amplitude = np.sin(2 * np.pi * 250 * times)[:, None]
    u = np.zeros((times.size, *structure.nodes.shape))
    u[..., 0] = amplitude * 1e-4 * x
    if structure.dim > 1:
        u[..., 1] = amplitude * 2e-5 * np.sin(9.0 * x) * structure.nodes[:, 1]
    nodes = structure.patches[0].nodes
    state = np.full(u.shape[:2], -1, dtype=np.int8)
    middle = np.abs(x[nodes] - x[nodes].mean())
    state[:, nodes] = middle > 0.5 * np.ptp(x[nodes]) * (1.0 - 0.8 * np.abs(amplitude))
    traction, work = np.zeros_like(u), np.zeros(u.shape[:2])
    traction[:, nodes, 0] = -35e6 * np.sign(amplitude)
    work[:, nodes] = np.cumsum(state[:, nodes] == 1, axis=0) * 7.0
    slip = np.where(state[..., None] >= 0, u, 0.0)
    fields = [Field(name, u, 2 * np.pi * 250 * u, slip, traction, state, work) for name in names]
    force = {"end": 60e3 * np.sin(2 * np.pi * 250 * load_times)}
    return Frames(structure, times, fields, load_times, force)
