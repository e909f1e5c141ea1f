"""Structures of every dimension and histories on them, for the tests of what is written."""

from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from bodies import structure
from scipy import io, sparse

import skfem_joint as sj
from skfem_joint.output.fields import Field, Frames

TIMES = np.array([0.0, 1e-5, 0.1 + 0.2])
JOINT = sj.Joint("joint", 50e6, 0.7)

#: Kinds of elements by dimension, with the order of the displacement.
PLATES = [("quadrilateral", 1), ("quadrilateral", 2), ("triangle", 1), ("triangle", 2)]
BOXES = [("hexahedron", 1), ("hexahedron", 2), ("tetrahedron", 1), ("tetrahedron", 2)]


@cache
def bar(direction: tuple[float, float, float] = (1.0, 0.0, 0.0)) -> sj.Structure:
    """Joint of 4 elements and a narrower region of 3, inclined, away from the origin."""
    made = sj.build_bar([("joint", 0.1, 4), ("linear", 0.5, 3)], {"fixed": 0.0, "free_end": 0.6})
    along = np.array(direction) / np.linalg.norm(direction)
    place = np.array([0.3, -0.2, 0.1]) + made.mesh.p[0][:, None] * along
    narrow = {"linear": {"width": 0.03}}
    return structure(replace(made, coordinates=place), [JOINT], ["fixed"], regions=narrow)


@cache
def plate(kind: Any = "quadrilateral", order: int = 1) -> sj.Structure:
    """Joint of 0.1 m on a rigid base and a thicker free strip of 0.2 m, seen from above."""
    strips = [("joint", 0.1, 4), ("linear", 0.2, 4)]
    made = sj.build_plate(strips, 0.05, 2, kind=kind, order=order)
    return structure(made, [JOINT], regions={"linear": {"thickness": 0.02}})


@cache
def box(kind: Any = "hexahedron", order: int = 1) -> sj.Structure:
    """Solid of 0.2 x 0.05 x 0.02 m on a base."""
    made = sj.build_box(
        [("foot", 0.1, 3), ("arm", 0.1, 2)], (0.05, 0.02), (2, 2), kind=kind, order=order
    )
    return structure(made, [replace(JOINT, on="front")], ["right"])


@cache
def bars() -> sj.Structure:
    """Two bars of other meshes that overlap on 0.1 m; the upper one is the region 'Stoß'."""
    lower = sj.build_bar([("base", 0.2, 6), ("lower_joint", 0.1, 4)], {"wall": 0.0})
    upper = sj.build_bar([("joint", 0.1, 5), ("arm", 0.2, 6)], {"tip": 0.3}, origin=(0.2, 0.0, 0.0))
    both = sj.merged([lower, upper])
    whole = both.mesh.with_subdomains({"Stoß": np.flatnonzero(both.body == 1)})
    return lapped(replace(both, mesh=whole), "wall")


@cache
def lap(kind: str = "quadrilateral", order: int = 1) -> sj.Structure:
    """Two plates of other meshes that overlap on 0.1 m, seen from above."""
    options: Any = {"kind": kind, "order": order}
    lower = sj.build_plate(
        [("base", 0.2, 6), ("lower_joint", 0.1, 4)], 0.05, 2, prefix="lower_", **options
    )
    upper = sj.build_plate(
        [("joint", 0.1, 5), ("arm", 0.2, 6)], 0.05, 3, origin=(0.2, 0.0), prefix="upper_", **options
    )
    return lapped(sj.merged([lower, upper]), "lower_left")


def lapped(mesh: Any, fixed: str) -> sj.Structure:
    joint, thick = replace(JOINT, against="lower_joint"), {"base": {"thickness": 0.016}}
    return structure(mesh, [joint], [fixed], regions=thick)


@cache
def side(kind: str = "quadrilateral", order: int = 1) -> sj.Structure:
    """Two plates on each other seen from their side, friction along the edge between them."""
    options: Any = {"kind": kind, "order": order}
    lower = sj.build_plate([("below", 0.3, 6)], 0.02, 2, prefix="lower_", **options)
    upper = sj.build_plate(
        [("above", 0.2, 5)], 0.02, 2, origin=(0.05, 0.02), prefix="upper_", **options
    )
    joint = replace(JOINT, on="upper_bottom", against="lower_top")
    return structure(sj.merged([lower, upper]), [joint], ["lower_left"], thickness=0.03)


@cache
def blocks(kind: str = "hexahedron", order: int = 1) -> sj.Structure:
    """Two solids of other meshes on each other."""
    options: Any = {"kind": kind, "order": order}
    lower = sj.build_box([("below", 0.2, 4)], (0.05, 0.02), (2, 1), prefix="lower_", **options)
    upper = sj.build_box(
        [("above", 0.1, 3)], (0.05, 0.02), (3, 1), origin=(0.05, 0.0, 0.02), prefix="upper_",
        **options,
    )  # fmt: skip
    joint = replace(JOINT, on="upper_front", against="lower_back")
    return structure(sj.merged([lower, upper]), [joint], ["lower_left"])


def random_field(made: sj.Structure, name: str, seed: int) -> Field:
    """Random history whose contact values live on the pressed nodes."""
    draw, frames = np.random.default_rng(seed), TIMES.size
    n, dim = made.nodes.shape
    pressed = np.zeros(n, dtype=bool)
    for patch in made.patches:
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


def random_frames(made: sj.Structure, names: tuple[str, ...] = ("full",)) -> Frames:
    """Random histories of models."""
    return Frames(made, TIMES, [random_field(made, name, k) for k, name in enumerate(names)])


def pulled(made: sj.Structure, names: tuple[str, ...] = ("full",)) -> Frames:
    """Stretched along x and waved across it; slips from the ends inwards as it is pulled."""
    times, load_times = np.linspace(0.0, 4e-3, 9), np.linspace(0.0, 4e-3, 200)
    x = made.nodes[:, 0]
    amplitude = np.sin(2 * np.pi * 250 * times)[:, None]
    u = np.zeros((times.size, *made.nodes.shape))
    u[..., 0] = amplitude * 1e-4 * x
    if made.dim > 1:
        u[..., 1] = amplitude * 2e-5 * np.sin(9.0 * x) * made.nodes[:, 1]
    nodes = made.patches[0].nodes
    state = np.full(u.shape[:2], -1, dtype=np.int8)
    middle = np.abs(x[nodes] - x[nodes].mean())
    state[:, nodes] = middle > 0.5 * np.ptp(x[nodes]) * (1.0 - 0.8 * np.abs(amplitude))
    traction, work = np.zeros_like(u), np.zeros(u.shape[:2])
    traction[:, nodes, 0] = -35e6 * np.sign(amplitude)
    work[:, nodes] = np.cumsum(state[:, nodes] == 1, axis=0) * 7.0
    slip = np.where(state[..., None] >= 0, u, 0.0)
    fields = [Field(name, u, 2 * np.pi * 250 * u, slip, traction, state, work) for name in names]
    force = {"end": 60e3 * np.sin(2 * np.pi * 250 * load_times)}
    return Frames(made, times, fields, load_times, force)


def matrices_scene(folder: Path) -> Path:
    """Scene of matrices alone, which has no structure to draw or to fit."""
    for name in "MK":
        io.mmwrite(folder / f"{name}.mtx", sparse.eye_array(2))
    path = folder / "scene.toml"
    path.write_text(
        '[matrices]\nM = "M.mtx"\nK = "K.mtx"\npoints = {a = 0, b = 1}\n'
        '[[load]]\non = "a"\nkind = "harmonic"\namplitude = 1.0\nfrequency = 0.1\n'
        '[time]\ncycles = 1\n[models]\nrun = ["full"]\n',
        encoding="utf-8",
    )
    return path
