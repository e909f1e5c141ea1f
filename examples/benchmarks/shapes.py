"""Plates of several shapes, bolted on a rigid base and on each other.

A plate is a union of rectangles. Its mesh is a grid whose lines pass through all corners of them;
triangles, and vertices that are moved a little, make it less regular.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import skfem

import skfem_joint as sj
from skfem_joint.mesh.named import NamedMesh, named
from skfem_joint.scene import Scene, scene_from
from skfem_joint.study.description import description_of

#: Left, bottom, right and top of a rectangle, m.
Rectangle = tuple[float, float, float, float]
STEEL = {"E": 200e9, "density": 7850.0, "poisson": 0.3}
COULOMB = {"law": "coulomb"}


@dataclass(frozen=True)
class Plates:
    """Plates with bolts.

    Attributes
    ----------
    mesh : NamedMesh
    tables : mapping
        Tables of a scene that describe the structure: mesh, material, section, support, joint.
    pulled : str
        Boundary that loads act on.
    along : tuple of float
        Direction from the first joint to that boundary.
    """

    mesh: NamedMesh
    tables: Mapping[str, Any]
    pulled: str
    along: tuple[float, float]


def plate(
    rectangles: Sequence[Rectangle],
    size: float,
    regions: Mapping[str, Rectangle],
    boundaries: Mapping[str, Rectangle],
    *,
    triangles: bool = False,
    moved: float = 0.0,
    rng: np.random.Generator | None = None,
) -> NamedMesh:
    """Mesh of a union of rectangles.

    Parameters
    ----------
    rectangles : sequence of (left, bottom, right, top)
        In m; those that touch are one plate.
    size : float
        Largest side of an element, m.
    regions, boundaries : mapping of str to (left, bottom, right, top)
        Elements and edges in rectangles, by name; those of a boundary have no width.
    triangles : bool
        Triangles in place of quadrilaterals.
    moved : float
        Largest distance by which inner vertices are moved, relative to ``size``. Those on edges of
        regions stay.
    rng : numpy.random.Generator, optional
        Draws how they are moved.
    """
    lines = []
    for axis in (0, 1):
        boxes = (*rectangles, *regions.values(), *boundaries.values())
        corners = np.unique(np.round([box[axis + side] for box in boxes for side in (0, 2)], 9))
        counts = np.maximum(np.ceil(np.diff(corners) / size - 1e-6), 1).astype(int)
        parts = [
            np.linspace(*ends, n, endpoint=False)
            for *ends, n in zip(corners, corners[1:], counts, strict=False)
        ]
        lines.append(np.append(np.concatenate(parts), corners[-1]))
    grid = skfem.MeshQuad.init_tensor(*lines)
    middles = grid.p[:, grid.t].mean(axis=1)
    mesh = grid.restrict(np.flatnonzero(np.any([_inside(middles, r) for r in rectangles], axis=0)))
    if triangles:
        mesh = mesh.to_meshtri()
    mesh = mesh.with_subdomains({k: lambda x, r=r: _inside(x, r) for k, r in regions.items()})
    mesh = mesh.with_boundaries({k: lambda x, r=r: _inside(x, r) for k, r in boundaries.items()})
    if moved and rng is not None:
        edges = {x for r in (*rectangles, *regions.values()) for x in np.round((r[0], r[2]), 9)}
        rows = {y for r in (*rectangles, *regions.values()) for y in np.round((r[1], r[3]), 9)}
        free = ~np.isin(np.round(mesh.p[0], 9), [*edges]) & ~np.isin(
            np.round(mesh.p[1], 9), [*rows]
        )
        shifts = moved * size * rng.uniform(-0.5, 0.5, mesh.p.shape)
        mesh = type(mesh)(mesh.p + shifts * free, mesh.t, mesh.boundaries, mesh.subdomains)
    return named(mesh)


def _inside(x, rectangle):
    """Which of the points (2, n) lie in a rectangle, with its edges."""
    left, bottom, right, top = rectangle
    near = 1e-9
    across = (x[0] >= left - near) & (x[0] <= right + near)
    return across & (x[1] >= bottom - near) & (x[1] <= top + near)


def bolted(
    places: Sequence[Sequence[float]], force: float, radius: float, reach: float
) -> dict[str, Any]:
    """Pressure of bolts at some places, each with the same ``force`` (N) and head (m)."""
    bolt = {"force": force, "head_radius": radius, "hole_radius": 0.5 * radius}
    return {"reach": reach, "bolts": [{"at": [float(x) for x in at], **bolt} for at in places]}


def bracket(
    size: float = 5e-3, force: float = 10e3, friction: float = 0.3, law: Mapping[str, Any] = COULOMB
) -> Plates:
    """L-shaped bracket: its foot is bolted on a rigid base, and a plate is lapped on its arm.

    Two bolts hold the foot and two the plate; friction alone holds both. With the default size of
    elements it has about 1,900 unknowns and 190 contact points. Pulled across at 100 Hz by 88 % of
    the load that makes it slip, errors of reduced models fall slowly with their modes.
    """
    foot, arm = (0.0, 0.0, 0.15, 0.05), (0.0, 0.0, 0.05, 0.16)
    lap, strip = (0.0, 0.08, 0.05, 0.16), (0.0, 0.08, 0.05, 0.25)
    lower = plate([foot, arm], size, {"foot": (0.05, 0.0, 0.15, 0.05), "arm": lap}, {})
    edge = {"pulled": (0.0, 0.25, 0.05, 0.25)}
    upper = plate([strip], size, {"strip": lap}, edge)
    held = bolted([(0.075, 0.025), (0.125, 0.025)], force, 0.01, 0.006)
    lapped = bolted([(0.025, 0.1), (0.025, 0.14)], force, 0.01, 0.006)
    joints = [
        {"on": "foot", "pressure": held, "friction": friction, **law},
        {"on": "strip", "against": "arm", "pressure": lapped, "friction": friction, **law},
    ]
    return Plates(sj.merged([lower, upper]), structure_tables(joints), "pulled", (0.0, 1.0))


def structure_tables(
    joints: Sequence[Mapping[str, Any]], fixed: Sequence[str] = (), thickness: float = 0.008
) -> dict[str, Any]:
    """Tables of a steel structure with joints, held at the boundaries ``fixed``."""
    return {
        # Plain elements, with which the published tables were measured.
        "mesh": {"file": "made by shapes.py", "incompatible": False},
        "material": dict(STEEL),
        "section": {"thickness": thickness},
        "support": {"fixed": list(fixed)} if fixed else {},
        "joint": list(joints),
    }


def pulled_bracket(
    share: float = 0.88, cycles: int = 4, steps_per_cycle: int = 100, **others: Any
) -> Scene:
    """Scene of the bracket, pulled across at 100 Hz by a share of what makes it slip as a whole.

    ``others`` are tables of the scene beside those of the structure and the load.
    """
    made = bracket()
    pull = {"on": made.pulled, "direction": [1.0, 0.0], "kind": "harmonic"}
    tables = dict(made.tables) | {
        "damping": {"stiffness": 1e-6},
        "load": [pull | {"amplitude": 1.0, "frequency": 100.0}],
        "time": {"cycles": cycles, "steps_per_cycle": steps_per_cycle},
        "output": {"points": [made.pulled]},
    }
    tables["load"][0]["amplitude"] = share / share_of_slip(scene_from(tables, made.mesh))
    return scene_from(tables | others, made.mesh)


def share_of_slip(scene: Scene) -> float:
    """Share of what makes a joint slip as a whole that the loads of a scene come to.

    With what they set in motion, as ``skfem-joint check`` says it.
    """
    return float(description_of(scene).values["load_over_limit"])
