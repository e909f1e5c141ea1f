"""Bodies of every dimension for the tests of structures, in SI units."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import skfem

import skfem_joint as sj
from skfem_joint.mesh import NamedMesh, build_bar, build_plate, merged, named

E, DENSITY, NU, MU = 200e9, 8000.0, 0.3, 0.7
WIDTH, THICKNESS = 0.05, 0.01
EA = E * WIDTH * THICKNESS
STEEL = sj.Material(E, DENSITY, NU)
#: Shape and order of the elements.
ELEMENTS = [("line", 1), ("tri", 1), ("tri", 2), ("quad", 1), ("quad", 2),
            ("tet", 1), ("tet", 2), ("hex", 1), ("hex", 2)]  # fmt: skip
#: The same of meshes with hexahedra and prisms, and with quadrilaterals and triangles.
MIXED = [("mixed box", 1), ("mixed box", 2), ("mixed plate", 1), ("mixed plate", 2)]
PLANE = [kind for kind in ELEMENTS if kind[0] in ("tri", "quad")]
SOLID = [kind for kind in ELEMENTS if kind[0] in ("tet", "hex")]
_MESHES = {"line": skfem.MeshLine, "tri": skfem.MeshTri, "quad": skfem.MeshQuad,
           "tet": skfem.MeshTet, "hex": skfem.MeshHex}  # fmt: skip


def block(shape: str, order: int = 1, n: int = 3, size: tuple[float, ...] = (1, 1, 1)) -> NamedMesh:
    """Box from the origin: ``left`` to ``right`` along x, ``base`` to ``top`` along the last axis.

    ``joint`` is the half towards x = 0, ``rest`` the other one, ``corner`` the far corner.
    """
    if shape.startswith("mixed"):  # of a size of its own
        from mixed_meshes import mixed_box, mixed_plate  # of another folder of tests

        solid = shape == "mixed box"
        body, low, high = (mixed_box, "front", "back") if solid else (mixed_plate, "bottom", "top")
        body = body(1, order)
        sides = {"base": body.boundaries[low], "top": body.boundaries[high]}
        return replace(body, mesh=body.mesh.with_boundaries(sides))
    dim = {"line": 1, "tri": 2, "quad": 2, "tet": 3, "hex": 3}[shape]
    axes = [np.linspace(0.0, length, 2 * n + 1 if k == 0 else n + 1) for k, length in
            enumerate(size[:dim])]  # fmt: skip
    mesh = _MESHES[shape](axes[0]) if dim == 1 else _MESHES[shape].init_tensor(*axes)
    half, last, end = size[0] / 2, dim - 1, 1e-9 * size[0]
    mesh = mesh.with_subdomains({"joint": lambda x: x[0] < half, "rest": lambda x: x[0] > half})
    borders = {"left": lambda x: x[0] < end, "right": lambda x: x[0] > size[0] - end}
    if dim > 1:
        borders |= {
            "base": lambda x: x[last] < end,
            "top": lambda x: x[last] > size[last] - end,
            "pressed": lambda x: (x[last] < end) & (x[0] < half),
        }
    mesh = mesh.with_boundaries(borders)
    corner = int(np.argmax(mesh.p.sum(axis=0)))
    points = {"corner": corner} if dim > 1 else None
    return named(mesh, points=points, order=order)


def mapped(body: NamedMesh, function: Callable[[np.ndarray], np.ndarray]) -> NamedMesh:
    """The same body with its vertices (dim, n) moved."""
    mesh = replace(body.mesh, doflocs=function(body.mesh.p))
    coordinates = np.zeros((mesh.p.shape[1], 3))
    coordinates[:, : mesh.dim()] = mesh.p.T
    return replace(body, mesh=mesh, coordinates=coordinates)


def distorted(body: NamedMesh, part: float = 0.15) -> NamedMesh:
    """The same body with the vertices inside its regions moved by a part of the element's size."""
    mesh = body.mesh
    shift = part * mesh.param() / 2 * np.random.default_rng(1).uniform(-1, 1, mesh.p.shape)
    regions = [np.unique(mesh.t[:, elements]) for elements in body.regions.values()]
    used = np.bincount(np.concatenate(regions), minlength=mesh.p.shape[1])
    shift[:, mesh.boundary_nodes()] = 0.0
    shift[:, used > 1] = 0.0
    return mapped(body, lambda p: p + shift)


def turned(body: NamedMesh, angle: float) -> NamedMesh:
    """The same body turned about the z axis (degrees)."""
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    turn = np.eye(body.mesh.dim())
    turn[:2, :2] = [[c, -s], [s, c]]
    return mapped(body, lambda p: turn @ p)


def section(body: NamedMesh) -> dict[str, float]:
    """Width and thickness as the dimension needs them."""
    sizes = {"thickness": THICKNESS, "width": WIDTH}
    return dict(list(sizes.items())[: 3 - body.mesh.dim()])


def structure(
    body: NamedMesh, joints: Any = (), fixed: Any = ("left",), **changes: Any
) -> sj.Structure:
    """Structure of steel, computed with the order that its mesh has."""
    values = {"material": STEEL, "order": body.order, "fixed": fixed, "joints": joints}
    values |= {**section(body), **changes}
    return sj.Structure(body, **values)


def pressed(on: str = "joint", **changes: Any) -> sj.Joint:
    """Joint with the paper's pressure and friction."""
    return sj.Joint(on, **{"pressure": 8e6, "friction": MU, **changes})


def lap(elements: tuple[int, int] = (5, 3), order: int = 1, kind: Any = "quadrilateral",
        across: tuple[int, int] = (2, 2)) -> NamedMesh:  # fmt: skip
    """Two plates in plan over each other on 0.1 m."""
    lower = build_plate(
        [("lower_rest", 0.2, 4), ("lower_joint", 0.1, elements[0])], WIDTH, across[0],
        kind=kind, order=order, prefix="lower_",
    )  # fmt: skip
    upper = build_plate(
        [("upper_joint", 0.1, elements[1]), ("upper_rest", 0.05, 2)], WIDTH, across[1],
        kind=kind, order=order, prefix="upper_", origin=(0.2, 0.0),
    )  # fmt: skip
    return merged([lower, upper])


def side(elements: tuple[int, int] = (4, 4), order: int = 1) -> NamedMesh:
    """Two plates from the side, the upper one's edge on the lower one's face on 0.1 m."""
    lower = build_plate(
        [("lower_rest", 0.2, 4), ("lower_joint", 0.1, elements[0])], 0.01, 1, order=order,
        boundaries={"lower_left": "left", "base": "bottom", "face": ("top", "lower_joint")},
    )  # fmt: skip
    upper = build_plate(
        [("upper_joint", 0.1, elements[1]), ("upper_rest", 0.2, 4)], 0.01, 1, order=order,
        origin=(0.2, 0.01),
        boundaries={"upper_right": "right", "contact": ("bottom", "upper_joint")},
    )  # fmt: skip
    return merged([lower, upper])


LAP = pressed("upper_joint", against="lower_joint")
SIDE = pressed("contact", against="face")


def two_bars(above: int = 20, below: int = 20, *, beta: float = 1e5, arm: int = 20,
             **changes: Any) -> sj.Structure:  # fmt: skip
    """Fig. 18(a): two bars of 0.7 m over each other on 0.2 m, the lower one held at its end."""
    upper = build_bar(
        [("upper_arm", 0.5, arm), ("upper_joint", 0.2, above)], {"upper_end": 0.0, "upper_in": 0.5}
    )
    lower = build_bar(
        [("lower_joint", 0.2, below), ("lower_arm", 0.5, arm)], {"lower_in": 0.2, "lower_end": 0.7},
        origin=(0.5, 0.0, 0.01),
    )  # fmt: skip
    joint = pressed("upper_joint", against="lower_joint", pressure=50e6, beta=beta)
    return structure(merged([upper, lower]), [joint], ["lower_end"], **changes)
