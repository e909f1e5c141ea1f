"""Make the mesh files of this folder: ``python meshes/make_meshes.py [FOLDER]``.

Bars, along x, held at ``fixed``: the lap joints have 100 elements and are in contact along their
whole length; the structure of Fig. 18(b) is a 0.1 m joint of 1 mm elements followed by 0.5 m
without contact, of 5 mm elements.

Plates, in plan view unless it says side, with x along their length:

- ``plate_reference``: the lap joint of 0.25 m x 0.05 m, all of it the joint, of quadrilaterals;
- ``plate_bolts``: 0.5 m x 0.05 m of second-order triangles; the joint is its first 0.2 m, with
  bolt holes of 11 mm on the axis at 0.05 m and 0.15 m;
- ``two_plates``: the two plates of Fig. 18(a), 0.7 m x 0.05 m, overlapping by 0.2 m, where their
  elements match; they share no nodes;
- ``two_plates_side``: the same seen from the side, 10 mm thick each, upper on lower; their
  elements do not match along the contact.

Solids, with x along their length and z upwards:

- ``solid_lap_joint``: two plates of 0.2 m x 0.05 m x 10 mm, of second-order hexahedra, the upper
  one on the lower one over 0.1 m, with two bolt holes of 9 mm through both.

All sizes are in metres.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import skfem

from skfem_joint.mesh import NamedMesh, build_bar, build_plate, merged, named, write_mesh

WIDTH = 0.05


def lap_joint(length: float) -> NamedMesh:
    """Lap joint of 100 equal elements; length in m."""
    return build_bar([("joint", length, 100)], {"fixed": 0.0, "free_end": length})


def structure() -> NamedMesh:
    """Structure of Fig. 18(b): joint of 0.1 m, linear region of 0.5 m."""
    return build_bar(
        [("joint", 0.1, 100), ("linear", 0.5, 100)],
        {"fixed": 0.0, "junction": 0.1, "free_end": 0.6},
    )


def plate_reference() -> NamedMesh:
    """Reference system of section 2.1 as a plate on a rigid base."""
    return build_plate(
        [("joint", 0.25, 100)],
        WIDTH,
        10,
        boundaries={"fixed": "left", "free_end": "right", "bottom": "bottom", "top": "top"},
    )


def plate_bolts() -> NamedMesh:
    """Plate with two bolt holes in its joint, its blocks joined where their vertices meet."""
    across, hole_radius = 8, 0.0055
    bolts = {"hole_1": 0.05, "hole_2": 0.15}
    y = np.linspace(0.0, WIDTH, across + 1)
    grids = [
        np.meshgrid(np.linspace(start, stop, count + 1), y, indexing="ij")
        for start, stop, count in [
            *((0.0, 0.025, 4), (0.075, 0.125, 8), (0.175, 0.2, 4), (0.2, 0.5, 30))
        ]
    ]
    rings = rings_around_hole(hole_radius, across, 7)
    centres = [np.array([x, 0.5 * WIDTH])[:, np.newaxis, np.newaxis] for x in bolts.values()]
    grids += [rings + centre for centre in centres]

    positions, triangles, count = [], [], 0
    for grid in map(np.asarray, grids):
        node = count + np.arange(grid[0].size).reshape(grid[0].shape)
        a, b, c, d = node[:-1, :-1], node[1:, :-1], node[1:, 1:], node[:-1, 1:]
        even = np.indices(a.shape).sum(axis=0) % 2 == 0
        triangles.append(np.where(even, [a, b, c], [a, b, d]).reshape(3, -1))
        triangles.append(np.where(even, [a, c, d], [b, c, d]).reshape(3, -1))
        positions.append(grid.reshape(2, -1))
        count += grid[0].size
    p, number = np.unique(np.round(np.hstack(positions), 9), axis=1, return_inverse=True)
    t = number.ravel()[np.hstack(triangles)]
    t = t[:, np.argsort(p[0, t].mean(axis=0), kind="stable")]

    joint = p[0, t].max(axis=0) <= 0.2
    mesh = skfem.MeshTri1(p, np.ascontiguousarray(t), sort_t=False)
    boundaries = {"fixed": lambda x: x[0] == 0.0, "free_end": lambda x: x[0] == 0.5}
    for name, x in bolts.items():
        boundaries[name] = lambda at, x=x: np.hypot(at[0] - x, at[1] - 0.5 * WIDTH) < hole_radius
    regions = {"joint": np.flatnonzero(joint), "linear": np.flatnonzero(~joint)}
    return named(mesh.with_boundaries(boundaries).with_subdomains(regions), order=2)


def rings_around_hole(radius: float, across: int, layers: int) -> np.ndarray:
    """Vertices (2, layers + 1, around) from a circle to the square of the plate's width, closed."""
    side = np.linspace(-1.0, 1.0, across + 1)[:-1]
    one = np.ones(across)
    square = 0.5 * WIDTH * np.hstack([[side, -one], [one, side], [-side, one], [-one, -side]])
    angle = np.linspace(-0.75, 1.25, 4 * across + 1)[:-1] * np.pi
    circle = radius * np.stack([np.cos(angle), np.sin(angle)])
    share = np.concatenate([[0.0], np.cumsum(1.4 ** np.arange(layers))])
    share = (share / share[-1])[:, np.newaxis, np.newaxis]
    rings = np.moveaxis((1.0 - share) * circle + share * square, 1, 0)
    return np.concatenate([rings, rings[..., :1]], axis=2)


def two_plates() -> NamedMesh:
    """Fig. 18(a) in plan view."""
    upper = build_plate(
        [("upper_linear", 0.5, 50), ("upper_joint", 0.2, 40)],
        WIDTH,
        8,
        boundaries={"upper_end": "left"},
    )
    lower = build_plate(
        [("lower_joint", 0.2, 40), ("lower_linear", 0.5, 50)],
        WIDTH,
        8,
        origin=(0.5, 0.0),
        boundaries={"lower_end": "right"},
    )
    return merged([upper, lower])


def two_plates_side() -> NamedMesh:
    """Fig. 18(a) from the side; elements along the contact of 5 mm above and 4 mm below."""
    upper = build_plate(
        [("upper_linear", 0.5, 100), ("upper_joint", 0.2, 40)],
        0.01,
        4,
        origin=(0.0, 0.01),
        boundaries={"upper_end": "left", "upper_contact": ("bottom", "upper_joint")},
    )
    lower = build_plate(
        [("lower_joint", 0.2, 50), ("lower_linear", 0.5, 125)],
        0.01,
        4,
        origin=(0.5, 0.0),
        boundaries={"lower_end": "right", "lower_contact": ("top", "lower_joint")},
    )
    return merged([upper, lower])


def solid_lap_joint() -> NamedMesh:
    """Two solid plates lapped and bolted, one element thick; their faces match."""
    thick, rings = 0.01, rings_around_hole(0.0045, 4, 3)

    def plate(name: str, end: float, low: float) -> NamedMesh:
        """One plate; its end stands at ``end``, its overlap between 0.1 m and 0.2 m."""
        tail = np.linspace(min(end, 0.2), max(end, 0.1), 6), np.linspace(0.0, WIDTH, 5)
        grids = [np.array(np.meshgrid(*tail, indexing="ij"))]
        grids += [rings + np.array([x, 0.5 * WIDTH])[:, None, None] for x in (0.125, 0.175)]
        positions, cells, count = [], [], 0
        for grid in grids:
            node = count + np.arange(grid[0].size).reshape(grid[0].shape)
            corners = node[1:, 1:], node[1:, :-1], node[:-1, 1:], node[:-1, :-1]
            cells.append(np.reshape(corners, (4, -1)))
            positions.append(grid.reshape(2, -1))
            count += grid[0].size
        p, number = np.unique(np.round(np.hstack(positions), 9), axis=1, return_inverse=True)
        n, flat = p.shape[1], number.ravel()[np.hstack(cells)]
        t = np.vstack([np.stack([flat[i] + n, flat[i]]) for i in range(4)])[
            [0, 1, 2, 4, 3, 5, 6, 7]
        ]
        p = np.hstack([np.vstack([p, np.full(n, z)]) for z in (low, low + thick)])
        face = low + thick * (name == "lower")
        boundaries = {
            f"{name}_end": lambda x: x[0] == end,
            f"{name}_contact": lambda x: (x[2] == face) & (x[0] > 0.1) & (x[0] < 0.2),
        }
        regions = {name: np.arange(t.shape[1])}
        mesh = skfem.MeshHex1(p, np.ascontiguousarray(t), sort_t=False)
        return named(mesh.with_boundaries(boundaries).with_subdomains(regions), order=2)

    return merged([plate("upper", 0.0, thick), plate("lower", 0.3, 0.0)])


def main(folder: Path) -> None:
    """Write all mesh files into a folder."""
    write_mesh(lap_joint(0.25), folder / "lap_joint_250mm.msh")
    write_mesh(lap_joint(0.5), folder / "lap_joint_500mm.msh")
    write_mesh(structure(), folder / "structure.msh")
    write_mesh(plate_reference(), folder / "plate_reference.msh")
    write_mesh(plate_bolts(), folder / "plate_bolts.msh")
    write_mesh(two_plates(), folder / "two_plates.msh")
    write_mesh(two_plates_side(), folder / "two_plates_side.msh")
    write_mesh(solid_lap_joint(), folder / "solid_lap_joint.msh")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
