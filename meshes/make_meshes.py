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
  one on the lower one over 0.1 m, with two bolt holes of 9 mm through both and rings of 16 mm
  under heads and nuts;
- ``brake_reuss``: the Brake-Reuss beam, of second-order hexahedra: two half beams of 25.4 mm x
  25.4 mm, 0.72 m long together, lapped over 0.12 m, with three 5/16 bolts; each half carries half
  of each bolt (shank, washer, head), whose shanks are cut in the plane of the joint;
- ``thin_beam``: the same of half the thickness, 12.7 mm, with the point ``sensor`` 76.2 mm from
  its end, for the measured curves in ``examples/measured``.

All sizes are in metres.
"""

import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import skfem

from skfem_joint.mesh import build_bar, build_plate, merged, named, write_mesh

WIDTH = 0.05


def lap_joint(length):
    """Lap joint of 100 equal elements; length in m."""
    return build_bar([("joint", length, 100)], {"fixed": 0.0, "free_end": length})


def structure():
    """Structure of Fig. 18(b): joint of 0.1 m, linear region of 0.5 m."""
    points = {"fixed": 0.0, "junction": 0.1, "free_end": 0.6}
    return build_bar([("joint", 0.1, 100), ("linear", 0.5, 100)], points)


def plate_reference():
    """Reference system of section 2.1 as a plate on a rigid base."""
    sides = {"fixed": "left", "free_end": "right", "bottom": "bottom", "top": "top"}
    return build_plate([("joint", 0.25, 100)], WIDTH, 10, boundaries=sides)


def plate_bolts():
    """Plate with two bolt holes in its joint, its blocks joined where their vertices meet."""
    across, hole_radius = 8, 0.0055
    bolts = {"hole_1": 0.05, "hole_2": 0.15}
    y = np.linspace(0.0, WIDTH, across + 1)
    parts = (0.0, 0.025, 4), (0.075, 0.125, 8), (0.175, 0.2, 4), (0.2, 0.5, 30)
    lines = [np.linspace(start, stop, count + 1) for start, stop, count in parts]
    grids = [np.array(np.meshgrid(x, y, indexing="ij")) for x in lines]
    # Layers from each hole to the square of the plate's width.
    share = np.concatenate([[0.0], np.cumsum(1.4 ** np.arange(7))])
    share = (share / share[-1])[:, None, None]
    hole, square = _circle(across, hole_radius), _square(across, 0.5 * WIDTH)
    grids += _rings([(1.0 - s) * hole + s * square for s in share], bolts.values())

    positions, triangles, count = [], [], 0
    for grid in grids:
        node = count + np.arange(grid[0].size).reshape(grid[0].shape)
        a, b, c, d = node[:-1, :-1], node[1:, :-1], node[1:, 1:], node[:-1, 1:]
        even = np.indices(a.shape).sum(axis=0) % 2 == 0
        triangles.append(np.where(even, [a, b, c], [a, b, d]).reshape(3, -1))
        triangles.append(np.where(even, [a, c, d], [b, c, d]).reshape(3, -1))
        positions.append(grid.reshape(2, -1))
        count += grid[0].size
    p, t = _joined(positions, triangles)
    t = t[:, np.argsort(p[0, t].mean(axis=0), kind="stable")]

    joint = p[0, t].max(axis=0) <= 0.2
    mesh = skfem.MeshTri1(p, np.ascontiguousarray(t), sort_t=False)
    boundaries = {"fixed": lambda x: x[0] == 0.0, "free_end": lambda x: x[0] == 0.5}
    for name, x in bolts.items():
        boundaries[name] = lambda at, x=x: np.hypot(at[0] - x, at[1] - 0.5 * WIDTH) < hole_radius
    regions = {"joint": np.flatnonzero(joint), "linear": np.flatnonzero(~joint)}
    return named(mesh.with_boundaries(boundaries).with_subdomains(regions), order=2)


def two_plates(side=False):
    """Fig. 18(a) in plan view, or from the side: elements of 5 mm above and 4 mm below then."""
    size, arms, laps = (WIDTH, 8), (50, 50), (40, 40)
    upper, lower = {"upper_end": "left"}, {"lower_end": "right"}
    if side:
        size, arms, laps = (0.01, 4), (100, 125), (40, 50)
        upper["upper_contact"] = "bottom", "upper_joint"
        lower["lower_contact"] = "top", "lower_joint"
    strips = [("upper_linear", 0.5, arms[0]), ("upper_joint", 0.2, laps[0])]
    others = [("lower_joint", 0.2, laps[1]), ("lower_linear", 0.5, arms[1])]
    above = build_plate(strips, *size, origin=(0.0, 0.01 * side), boundaries=upper)
    return merged([above, build_plate(others, *size, origin=(0.5, 0.0), boundaries=lower)])


def solid_lap_joint(across=4, inner=(0.0045, 0.006), outer=(0.014,)):
    """Two solid plates lapped and bolted, one element thick; their faces match.

    ``across`` elements lie on each quarter of a bolt, and circles of nodes, m, within the washer
    and outside of it.
    """
    thick, washer, bolts = 0.01, 0.008, (0.125, 0.175)
    curves = [_circle(across, r) for r in (*inner, washer, *outer)]
    rings = _rings([*curves, _square(across, 0.5 * WIDTH)], bolts)

    def plate(name, clamped, end, low):
        """One plate; its end stands at ``end``, its overlap between 0.1 m and 0.2 m."""
        tail = np.linspace(min(end, 0.2), max(end, 0.1), 6), np.linspace(0.0, WIDTH, across + 1)
        grids = [np.array(np.meshgrid(*tail, indexing="ij")), *rings]
        p, t = _stacked([(grid, np.array([low, low + thick])) for grid in grids])
        face, back = low + thick * (name == "lower"), low + thick * (name == "upper")
        boundaries = {
            f"{name}_end": lambda x: x[0] == end,
            f"{name}_contact": lambda x: (x[2] == face) & (x[0] > 0.1) & (x[0] < 0.2),
        }
        for number, at in enumerate(bolts, 1):
            boundaries[f"{clamped}_{number}"] = lambda x, at=at: (
                (x[2] == back) & (np.hypot(x[0] - at, x[1] - 0.5 * WIDTH) < washer)
            )
        return _solid(name, p, t, boundaries)

    return merged([plate("upper", "head", 0.0, thick), plate("lower", "nut", 0.3, 0.0)])


INCH = 0.0254
BOLTS = (-0.03, 0.0, 0.03)


def brake_reuss(
    across=2, along=(8,), thickness=INCH, sensor=None, rings=(), layers=(), ends=1, digits=9
):
    """Brake-Reuss beam; ``across`` elements on each quarter of a bolt, ``along`` a full part.

    Sizes of the beam, washers, bolts: the model of the tutorial of Abaqus4Joints (N. Balaji). Heads
    and nuts are round, as large as their hexagons; what sticks out of the nuts is left out. The
    polygons that stand for circles have the circles' areas: octagons inscribed in the shanks would
    have 81 % of the second moment of area.

    A ``sensor`` (m from the end) is a point of the upper half beam's outer face, and ``along`` then
    has the elements before and behind it. ``rings`` are radii (m) of more circles around the
    washers, ``layers`` heights (m) of elements above its faces, and ``ends`` those on each end
    of the lap. Six ``digits``, positions to the micrometre, make the file a fifth smaller.
    """
    half, angle = 0.5 * INCH, 0.5 * np.pi / across  # between corners
    radii = np.array([0.15625 * INCH, 0.00425, 0.00667, 0.34375 * INCH, *rings])
    shank, hole, head, washer, *others = np.sqrt(angle / np.sin(angle)) * radii
    deep = 0.5 * thickness
    face = np.array([0.0, *layers, deep])
    above = np.array([deep, deep + 0.0625 * INCH, deep + (0.0625 + 0.203125) * INCH])
    whole = np.concatenate([face, above[1:]])
    side = np.linspace(-1.0, 1.0, across + 1)
    y = half * side
    tips = (np.linspace(*where, ends + 1) for where in ((-0.06, -0.045), (0.045, 0.06)))
    parts = [(np.meshgrid(x, y, indexing="ij"), face) for x in tips]
    stops = [0.06, 0.36] if sensor is None else [0.06, 0.36 - sensor, 0.36]
    for (start, stop), count in zip(pairwise(stops), along, strict=True):
        beam = np.linspace(start, stop, count + 1)
        parts.append((np.meshgrid(beam, y, indexing="ij"), np.array([-deep, *face])))
    core = np.meshgrid(0.5 * shank * side, 0.5 * shank * side, indexing="ij")
    curves = [_square(across, 0.5 * shank), *(_circle(across, r) for r in (shank, hole, head))]
    curves += [_circle(across, r) for r in (washer, *others)] + [_square(across, 0.015, half)]
    heights = [whole, above[1:], whole, whole[:-1], *[face] * (1 + len(others))]
    for x in BOLTS:
        parts.append((core + np.array([[[x]], [[0.0]]]), whole))
        for pair, z in zip(pairwise(curves), heights, strict=True):
            parts += [(ring, z) for ring in _rings(pair, [x], 0.0)]
    p, t = _stacked([(np.asarray(grid), z) for grid, z in parts], digits)

    def part(name, turn):
        """One half; the other one is turned about y."""
        boundaries = {
            f"{name}_end": lambda x: np.isclose(abs(x[0]), 0.36),
            f"{name}_face": lambda x: (
                np.isclose(x[2], 0.0, atol=1e-9)
                & np.all([np.hypot(x[0] - at, x[1]) > hole for at in BOLTS], axis=0)
            ),
        }
        for number, at in enumerate(BOLTS, 1):
            boundaries[f"{name}_cut_{number}"] = lambda x, at=at: (
                np.isclose(x[2], 0.0, atol=1e-9) & (np.hypot(x[0] - at, x[1]) < shank)
            )
        points = {}
        if sensor is not None and name == "upper":
            away = p - np.array([[0.36 - sensor], [0.0], [deep]])
            points["sensor"] = int(np.argmin(np.square(away).sum(axis=0)))
        return _solid(name, p * [[turn], [1.0], [turn]], t, boundaries, points)

    return merged([part("upper", 1.0), part("lower", -1.0)])


def thin_beam():
    """Thin Brake-Reuss beam, bent across its lap, with the sensor of the measured curves.

    Its faces touch up to some 12 mm from the bolts' axes, and slip begins at that edge. Circles of
    nodes 0.3 mm apart resolve it, with sixteen elements around and a layer of 0.9 mm.
    """
    rings = 0.0098, 0.0106, 0.0109, 0.0112, 0.0115, 0.0118, 0.0121
    sizes = {"thickness": 0.5 * INCH, "sensor": 3 * INCH, "digits": 6}
    return brake_reuss(4, (4, 2), rings=rings, layers=(0.0009,), **sizes)


def _solid(name, p, t, boundaries, points=None):
    """Second-order hexahedra, all one region of that name."""
    mesh = skfem.MeshHex1(p, t, sort_t=False).with_boundaries(boundaries)
    return named(mesh.with_subdomains({name: np.arange(t.shape[1])}), order=2, points=points)


def _rings(curves, bolts, y=0.5 * WIDTH):
    """Grids (2, curves, around) between closed curves, around each bolt at (x, y)."""
    rings = np.stack([*curves], axis=1)
    rings = np.concatenate([rings, rings[..., :1]], axis=2)
    return [rings + np.array([[[x]], [[y]]]) for x in bolts]


def _square(across, x, y=None):
    """Positions (2, 4 across) around a rectangle of half sizes x and y."""
    side, one = np.linspace(-1.0, 1.0, across + 1)[:-1], np.ones(across)
    square = np.hstack([[side, -one], [one, side], [-side, one], [-one, -side]])
    return square * [[x], [x if y is None else y]]


def _circle(across, radius):
    """Positions (2, 4 across) around a circle."""
    angle = np.linspace(-0.75, 1.25, 4 * across + 1)[:-1] * np.pi
    return radius * np.stack([np.cos(angle), np.sin(angle)])


def _stacked(parts, digits=9):
    """Vertices (3, n) and hexahedra (8, m) of plane grids (2, i, j) drawn through heights."""
    positions, cells, count = [], [], 0
    for grid, heights in parts:
        n = grid[0].size
        node = np.arange(n).reshape(grid[0].shape)
        corners = [node[1:, 1:], node[1:, :-1], node[:-1, 1:], node[:-1, :-1]]
        flat = count + np.reshape(corners, (4, -1))
        for layer in range(len(heights) - 1):
            pairs = [flat[i] + n * (layer + up) for i in range(4) for up in (1, 0)]
            cells.append(np.stack(pairs)[[0, 1, 2, 4, 3, 5, 6, 7]])
        positions += [np.vstack([grid.reshape(2, -1), np.full(n, z)]) for z in heights]
        count += n * len(heights)
    return _joined(positions, cells, digits)


def _joined(positions, cells, digits=9):
    """Vertices, each once, and cells of them."""
    p, number = np.unique(np.round(np.hstack(positions), digits), axis=1, return_inverse=True)
    return p, np.ascontiguousarray(number.ravel()[np.hstack(cells)])


#: By file name.
MESHES = {
    "lap_joint_250mm": lambda: lap_joint(0.25),
    "lap_joint_500mm": lambda: lap_joint(0.5),
    "structure": structure,
    "plate_reference": plate_reference,
    "plate_bolts": plate_bolts,
    "two_plates": two_plates,
    "two_plates_side": lambda: two_plates(side=True),
    "solid_lap_joint": solid_lap_joint,
    "brake_reuss": brake_reuss,
    "thin_beam": thin_beam,
}


def main(folder):
    """Write all mesh files into a folder."""
    for name, make in MESHES.items():
        write_mesh(make(), folder / f"{name}.msh")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).parent)
