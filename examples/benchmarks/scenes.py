"""Scenes drawn at random, by class: structure, joints, loads, damping, steps and reduction.

Each scene is drawn from its class, a seed and its number alone, so that it can be drawn again
without the others. Loads are scaled by what makes a joint slip as a whole, with what they set in
motion, from micro-slip to gross slip.
"""

import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import skfem
from scipy import sparse
from skfem.helpers import dot
from skfem.models import elasticity, poisson

import skfem_joint as sj
from benchmarks.shapes import (
    COULOMB,
    STEEL,
    Rectangle,
    bolted,
    plate,
    share_of_slip,
    structure_tables,
)
from skfem_joint.ground.errors import ConvergenceError, InputError
from skfem_joint.mesh.named import NamedMesh, named
from skfem_joint.runs.integrate import integrate_plan
from skfem_joint.runs.resolution import check_jumps
from skfem_joint.scene import Scene, scene_from
from skfem_joint.study.models import plan_of

Tables = dict[str, Any]


@dataclass(frozen=True)
class Parts:
    """Structure of a scene, and where loads may act on it.

    Attributes
    ----------
    tables : dict
        Tables that describe the structure.
    mesh : NamedMesh or None
    places : sequence of dict
        Keys ``on``, ``direction`` or ``base`` of loads; the first is that of the only load.
    observed : sequence of str
        Points whose motion is judged; all if there are none.
    cheap : bool
        Whether steps cost so little that many are taken.
    """

    tables: Tables
    mesh: NamedMesh | None
    places: Sequence[Tables]
    observed: Sequence[str] = ()
    cheap: bool = False


@dataclass(frozen=True)
class Drawn:
    """A scene that was drawn: its class, seed and number, and the kind of its load."""

    kind: str
    seed: int
    number: int
    load: str
    share: float
    scene: Scene = field(repr=False)


# %% Values of joints, damping and the scheme


def _law(rng):
    """Law of a joint: Coulomb's, or arctan's of any steepness."""
    if rng.random() < 0.35:
        return dict(COULOMB)
    return {"law": "arctan", "beta": float(10 ** rng.uniform(2.0, 9.0))}


def _pressed(rng, on, pressure, **others):
    return {"on": on, "pressure": pressure, "friction": _between(rng, 0.2, 0.8)} | others


def _between(rng, low, high):
    return round(float(rng.uniform(low, high)), 4)


def _pressure(rng, start, length):
    """Uniform pressure, Pa, or linear between three positions along x."""
    mean = float(10 ** rng.uniform(6.3, 7.3))
    if rng.random() < 0.65:
        return mean
    values = (mean * rng.uniform(0.2, 1.8, 3)).tolist()
    return {"positions": (start + length * np.array([0.0, 0.5, 1.0])).tolist(), "values": values}


def _angle(rng):
    turn = rng.choice([0.0, 0.5 * np.pi, rng.uniform(0.0, 2.0 * np.pi)])
    return [float(np.cos(turn)), float(np.sin(turn))]


def _damping(rng):
    kind = rng.choice(["none", "ratio", "stiffness", "mass", "both"], p=(0.1, 0.35, 0.25, 0.1, 0.2))
    stiffness = {"stiffness": float(10 ** rng.uniform(-7.0, -5.0))}
    mass = {"mass": float(10 ** rng.uniform(0.5, 2.5))}
    ratio = {"ratio": float(10 ** rng.uniform(-3.3, -1.3))}
    return {
        "none": {},
        "ratio": ratio,
        "stiffness": stiffness,
        "mass": mass,
        "both": stiffness | mass,
    }[str(kind)]


def _rho(rng):
    """Spectral radius at high frequency."""
    return float(rng.choice([1.0, round(rng.uniform(0.5, 0.95), 2), 0.0], p=(0.6, 0.25, 0.15)))


def _share(rng, kind):
    """Share of what makes a joint slip as a whole: micro-slip, partial slip, gross slip."""
    ranges = (0.05, 0.3), (0.3, 0.9), (0.9, 1.0), (1.0, 1.5)
    if kind == "laps-opening":
        return _between(rng, 0.1, 0.9)
    if kind == "plates-bolted" and rng.random() < 0.5:  # where most of the points slip
        return _between(rng, 0.6, 0.95)
    return _between(rng, *ranges[rng.choice(4, p=(0.2, 0.57, 0.08, 0.15))])


# %% Structures by class


def _bars(rng, folder):
    """Bar of one to three joints of different laws, with plain parts between."""
    regions, points, joints, x = [], {"fixed": 0.0}, [], 0.0
    count = int(rng.integers(1, 4))
    for k in range(count):  # joints of different laws share no node
        beside = k + 1 < count or rng.random() < 0.7
        for name in (f"joint_{k}", f"plain_{k}")[: 1 + beside]:
            length = _between(rng, 0.05, 0.25)
            regions.append((name, length, int(rng.integers(8, 26))))
            if name.startswith("joint"):
                equal = {"normal_force": "equal"} if rng.random() < 0.2 else {}
                pressure = _pressure(rng, x, length)
                joints.append(_pressed(rng, name, pressure, **_law(rng), **equal))
            x = round(x + length, 6)
            points[f"end_{name}"] = x
    tables = {
        "material": {"E": 200e9, "density": 8000.0} | _lumped(rng),
        "section": {"thickness": 0.01, "width": 0.05},
        "support": {"fixed": ["fixed"]},
        "joint": joints,
    }
    places = [{"on": name} for name in list(points)[:0:-1]]
    if rng.random() < 0.3:
        rng.shuffle(places)
    return Parts(tables, sj.build_bar(regions, points), places, cheap=True)


def _lumped(rng):
    return {"mass_matrix": "lumped"} if rng.random() < 0.3 else {}


def _plates(rng, folder):
    """Plate in plan, pressed on a rigid base over a part of its length; held at one end or not."""
    parts, width = rng.uniform(0.08, 0.2, 2).round(3), _between(rng, 0.03, 0.06)
    counts = rng.integers(5, 10, 2)
    strips = [
        ("joint", float(parts[0]), int(counts[0])),
        ("plain", float(parts[1]), int(counts[1])),
    ]
    kind = str(rng.choice(["quadrilateral", "triangle"]))
    mesh = sj.build_plate(strips, width, int(rng.integers(2, 4)), kind=kind)
    joint = _pressed(rng, "joint", _pressure(rng, 0.0, parts[0]), **_law(rng))
    fixed = ["left"] if rng.random() < 0.6 else []
    tables = structure_tables([joint], fixed, 0.01)
    tables["section"]["plane"] = str(rng.choice(["stress", "strain"]))
    tables["material"] |= _lumped(rng)
    along = [1.0, 0.0] if rng.random() < 0.5 else _angle(rng)
    places = [{"on": "right", "direction": along}, {"on": "plain", "direction": _angle(rng)}]
    return Parts(tables, mesh, places, ["right"])


def _plates_side(rng, folder):
    """Plate from the side, pressed on a rigid base along a part of its lower edge."""
    parts, height = rng.uniform(0.06, 0.15, 2).round(3), _between(rng, 0.008, 0.025)
    strips = [
        ("foot", float(parts[0]), int(rng.integers(10, 25))),
        ("plain", float(parts[1]), int(rng.integers(6, 16))),
    ]
    sides = {"contact": ("bottom", "foot"), "left": "left", "right": "right", "top": "top"}
    kind = str(rng.choice(["quadrilateral", "triangle"]))
    order = int(rng.choice([1, 2], p=(0.7, 0.3)))
    count = int(rng.integers(2, 5)) if order == 1 else 2
    mesh = sj.build_plate(strips, height, count, kind=kind, order=order, boundaries=sides)
    joint = _pressed(rng, "contact", _pressure(rng, 0.0, parts[0]), **_law(rng))
    tables = structure_tables([joint], ["left"] if rng.random() < 0.4 else [], 0.04)
    places = [{"on": "right", "direction": [1.0, 0.0]}]
    places.append({"on": "top", "direction": [1.0, float(rng.choice([0.0, -0.1]))]})
    if rng.random() < 0.3:
        places.reverse()
    return Parts(tables, mesh, places, ["right"])


def _two_bodies(rng, folder):
    """Two bodies that overlap: bars, plates in plan, or plates from the side."""
    kind = str(rng.choice(["bars", "plan", "side"]))
    arms, lap = rng.uniform(0.08, 0.25, 2).round(3).tolist(), _between(rng, 0.06, 0.15)
    joint = _pressed(rng, "upper_lap", _pressure(rng, arms[0], lap), **_law(rng))
    joint |= {"against": "lower_lap"}
    counts = rng.integers(10, 21, 4).tolist()
    upper = [("upper_arm", arms[0], counts[0]), ("upper_lap", lap, counts[1])]
    lower = [("lower_lap", lap, counts[2]), ("lower_arm", arms[1], counts[3])]
    if kind == "bars":
        first = sj.build_bar(upper, {"held": 0.0, "upper_end": arms[0] + lap})
        second = sj.build_bar(lower, {"lower_end": lap + arms[1]}, origin=(arms[0], 0.0, 0.0))
        tables = {
            "material": {"E": 200e9, "density": 8000.0},
            "section": {"thickness": 0.01, "width": 0.05},
            "support": {"fixed": ["held"]},
            "joint": [joint],
        }
        places = [{"on": "lower_end"}, {"on": "upper_end"}]
        return Parts(tables, sj.merged([first, second]), places, ["lower_end"], cheap=True)
    size, rows = _between(rng, 0.03, 0.05), (int(rng.integers(3, 5)), int(rng.integers(3, 5)))
    if kind == "side":
        size, thickness = _between(rng, 0.008, 0.015), 0.04
        joint |= FACES
        mesh = _lapped_from_the_side(upper, lower, size)
    else:
        thickness = 0.01
        if rng.random() < 0.4:
            at = [(arms[0] + part * lap, 0.5 * size) for part in (0.3, 0.7)]
            force, radius = float(rng.uniform(5e3, 2e4)), _between(rng, 0.008, 0.012)
            joint |= {"pressure": bolted(at, force, radius, 0.006)}
        first = sj.build_plate(upper, size, rows[0], boundaries={"held": "left"})
        pulled, origin = {"pulled": "right"}, (arms[0], 0.0)
        second = sj.build_plate(lower, size, rows[1], origin=origin, boundaries=pulled)
        mesh = sj.merged([first, second])
    tables = structure_tables([joint], ["held"], thickness)
    along = [1.0, 0.0] if kind == "side" or rng.random() < 0.6 else _angle(rng)
    places = [{"on": "pulled", "direction": along}, {"on": "lower_lap", "direction": [1.0, 0.0]}]
    return Parts(tables, mesh, places, ["pulled"])


#: Faces of two lapped bodies.
FACES = {"on": "upper_face", "against": "lower_face"}


def _lapped_from_the_side(upper, lower, size, **others):
    """Two plates from the side: the upper one held on the left, the lower one pulled on the right.

    They are strips (name, length, elements) of height ``size``, m.
    """
    sides = {"held": "left", "upper_face": ("bottom", "upper_lap")}
    first = sj.build_plate(upper, size, 2, origin=(0.0, size), boundaries=sides, **others)
    sides = {"pulled": "right", "lower_face": ("top", "lower_lap")}
    second = sj.build_plate(lower, size, 2, origin=(upper[0][1], 0.0), boundaries=sides, **others)
    return sj.merged([first, second])


def _solids(rng, folder):
    """Solids of bricks or tetrahedra, lapped under preloaded bolts or pressed on a rigid base."""
    kind = str(rng.choice(["hexahedron", "tetrahedron"]))
    width, thick = _between(rng, 0.03, 0.05), _between(rng, 0.008, 0.015)
    across, layers = int(rng.integers(4, 7)), 1
    if rng.random() < 0.35:
        foot, arm = rng.uniform(0.06, 0.12, 2).round(3).tolist()
        strips = [("foot", foot, int(rng.integers(8, 14))), ("arm", arm, int(rng.integers(4, 8)))]
        sides = {"contact": ("front", "foot"), "left": "left", "right": "right"}
        mesh = sj.build_box(strips, (width, thick), (across, 2), kind=kind, boundaries=sides)
        joint = _pressed(rng, "contact", _pressure(rng, 0.0, foot), **_law(rng))
        tables = structure_tables([joint], ["left"] if rng.random() < 0.4 else [])
        observed = "right"
    else:
        tables, mesh = _lapped_solids(rng, kind, (width, thick), (across, layers))
        observed = "pulled"
    tables.pop("section")
    across_too = [1.0, _between(rng, -0.3, 0.3), _between(rng, -0.1, 0.1)]
    direction = [1.0, 0.0, 0.0] if rng.random() < 0.6 else across_too
    return Parts(tables, mesh, [{"on": observed, "direction": direction}], [observed])


def _lapped_solids(rng, kind, size, counts):
    """Tables and mesh of two solids, lapped under one or two bolts whose force presses them.

    ``size`` (m) and ``counts`` of elements are those of width and thickness.
    """
    (width, thick), (across, layers) = size, counts
    lap, arms = _between(rng, 0.06, 0.1), rng.uniform(0.06, 0.12, 2).round(3).tolist()
    along = int(rng.integers(8, 14))
    bolts = [(arms[0] + part * lap, 0.5 * width) for part in ((0.5,), (0.3, 0.7))[rng.integers(2)]]
    radius = 0.3 * min(width, lap)
    parts = []
    for body, clamped, start, low in (
        ("upper", "head", 0.0, thick),
        ("lower", "nut", arms[0], 0.0),
    ):
        lengths = (arms[0], lap) if body == "upper" else (lap, arms[1])
        tail = [f"{body}_arm", f"{body}_lap"]
        names = tail if body == "upper" else tail[::-1]
        divided = [along if "lap" in name else int(rng.integers(4, 7)) for name in names]
        strips = list(zip(names, lengths, divided, strict=True))
        box = sj.build_box(
            strips, (width, thick), (across, layers), origin=(start, 0.0, low), kind=kind,
            boundaries={},
        )  # fmt: skip
        parts.append(_with_faces(box, body, clamped, bolts, radius, (low, low + thick)))
    joints = [_pressed(rng, "upper_face", "preload", **_law(rng)) | {"against": "lower_face"}]
    force = float(rng.uniform(5e3, 2e4))
    tables = structure_tables(joints, ["held"])
    tables["bolt"] = [
        {"head": f"head_{k}", "nut": f"nut_{k}", "force": force} for k in range(len(bolts))
    ]
    return tables, sj.merged(parts)


def _with_faces(box, body, clamped, bolts, radius, levels):
    """A plate with its end, its face of contact, and what each bolt clamps."""
    upper = body == "upper"
    mesh, (face, back) = box.mesh, levels if upper else levels[::-1]
    end = mesh.p[0].min() if upper else mesh.p[0].max()
    lapped = mesh.p[0, np.unique(mesh.t[:, box.regions[f"{body}_lap"]])]
    low, high = lapped.min() - 1e-9, lapped.max() + 1e-9
    faces = {
        "held" if upper else "pulled": lambda x: np.abs(x[0] - end) < 1e-9,
        f"{body}_face": lambda x: (np.abs(x[2] - face) < 1e-9) & (x[0] > low) & (x[0] < high),
    }
    for k, at in enumerate(bolts):
        faces[f"{clamped}_{k}"] = lambda x, at=at: (
            (np.abs(x[2] - back) < 1e-9) & (np.hypot(x[0] - at[0], x[1] - at[1]) < radius)
        )
    return named(mesh.with_boundaries(faces))


def _base(rng, folder):
    """Structures that their supports shake."""
    made = (_bars, _plates, _plates_side, _two_bodies)[rng.integers(4)](rng, folder)
    tables = dict(made.tables)
    if not tables["support"]:
        tables["support"] = {"fixed": ["left"]}
    axes = ["x"] if made.mesh.dim == 1 or rng.random() < 0.6 else ["y"]
    if {"contact", "upper_face"} & {joint["on"] for joint in tables["joint"]}:
        axes = ["x"]  # along the contact
    places = [{"base": axes[0]}, *made.places]
    return Parts(tables, made.mesh, places, made.observed, made.cheap)


def _matrices(rng, folder):
    """Matrices in files: chains of masses, and plates and solids assembled by scikit-fem alone."""
    kind = str(rng.choice(["chain", "plate", "solid"]))
    if kind == "chain":
        n = int(rng.integers(8, 30))
        k, m = 10 ** rng.uniform(6.0, 8.0), rng.uniform(0.2, 2.0, n)
        springs = k * rng.uniform(0.5, 2.0, n + 1)
        springs[-1] *= rng.random() < 0.3
        K = sparse.diags_array([-springs[1:-1], springs[:-1] + springs[1:], -springs[1:-1]],
                               offsets=[-1, 0, 1])  # fmt: skip
        M, weights = sparse.diags_array(m), n - 1
        rows = [[i, "", "", "", "", "", 0, 0, 1, 1e-3] for i in np.sort(
            rng.choice(n, int(rng.integers(2, max(3, n // 2))), replace=False)
        )]  # fmt: skip
        fixed, observed = [], weights
    else:
        K, M, rows, fixed, observed = _assembled(rng, solid=kind == "solid")
    tables: Tables = {
        "joint": [_pressed(rng, "foot", float(10 ** rng.uniform(6.3, 7.3)), **_law(rng))]
    }
    files = {"K": K, "M": M}
    if rng.random() < 0.4:
        files["C"] = 10 ** rng.uniform(-6.5, -5.0) * K + 10 ** rng.uniform(0.0, 2.0) * M
        tables["damping"] = {}
    for name, matrix in files.items():
        sparse.save_npz(folder / f"{name}.npz", sparse.csr_array(matrix))
    lines = [",".join(map(str, row)) for row in rows]
    (folder / "foot.csv").write_text("\n".join(lines) + "\n", encoding="utf-8")
    point: str | int = observed if isinstance(observed, int) else "end.csv"
    if point == "end.csv":
        np.savetxt(folder / "end.csv", observed)
    tables["matrices"] = {name: f"{name}.npz" for name in files}
    tables["matrices"] |= {
        "contact": {"foot": "foot.csv"},
        "points": {"end": point},
        "fixed": fixed,
    }
    return Parts(tables, None, [{"on": "end"}], ["end"], cheap=kind == "chain")


@skfem.BilinearForm
def _mass(u, v, _):
    return dot(u, v)


def _assembled(rng, solid):
    """Stiffness, mass, pairs, held degrees of freedom and weights of the free end of a block.

    A plate in plan, or a solid on its lower face; either is pressed over half of its length.
    """
    size = [_between(rng, 0.15, 0.35), _between(rng, 0.03, 0.06), 0.01][: 2 + solid]
    counts = [int(rng.integers(10, 18)), int(rng.integers(3, 5)), 2][: 2 + solid]
    shape, cell = (
        (skfem.MeshHex, skfem.ElementHex1) if solid else (skfem.MeshQuad, skfem.ElementQuad1)
    )
    mesh = shape.init_tensor(
        *(np.linspace(0.0, a, n + 1) for a, n in zip(size, counts, strict=True))
    )
    basis = skfem.Basis(mesh, skfem.ElementVector(cell()))
    lame = list(elasticity.lame_parameters(STEEL["E"], STEEL["poisson"]))
    if not solid:  # plane stress
        lame[0] *= 2.0 * lame[1] / (lame[0] + 2.0 * lame[1])
    depth = 1.0 if solid else 0.01
    K = depth * elasticity.linear_elasticity(*lame).assemble(basis)
    M = depth * STEEL["density"] * _mass.assemble(basis)
    scalar = basis.with_element(cell())
    pressed = (mesh.p[0] <= 0.5 * size[0] + 1e-9) & ((mesh.p[2] < 1e-9) if solid else True)
    if solid:
        face = mesh.facets_satisfying(lambda x: x[2] < 1e-9, boundaries_only=True)
        scalar = skfem.FacetBasis(mesh, cell(), facets=face)
    area = poisson.unit_load.assemble(scalar)
    dofs = basis.nodal_dofs  # (dim, vertices)
    rows = [
        [*dofs[:, node], *([] if solid else [""]), "", "", "", 0, 0, 1, area[node]]
        for node in np.flatnonzero(pressed)
    ]
    ends = [np.flatnonzero(np.abs(mesh.p[0] - x) < 1e-9) for x in (0.0, size[0])]
    fixed = dofs[:, ends[0]].ravel().tolist() if rng.random() < 0.5 else []
    end = np.zeros(K.shape[0])
    end[dofs[0, ends[1]]] = 1.0 / ends[1].size
    return K, M, rows, [int(dof) for dof in fixed], end


def _plates_bolted(rng, folder):
    """Plates of random shape with random bolts under Coulomb's law: L, T, lap and flange."""
    kind = str(rng.choice(["L", "T", "lap", "flange"]))
    wide, thick = _between(rng, 0.035, 0.055), _between(rng, 0.004, 0.01)
    size, force = _between(rng, 0.009, 0.0115), float(rng.uniform(4e3, 2e4))
    mu, radius = _between(rng, 0.15, 0.6), _between(rng, 0.008, 0.011)
    lap, beyond = _between(rng, 0.05, 0.09), _between(rng, 0.04, 0.1)
    foot, fixed = _between(rng, 0.06, 0.12), []
    how: Tables = {"triangles": bool(rng.random() < 0.4), "moved": 0.3, "rng": rng}
    pressed, joints, tip = [], [], _between(rng, 0.0, 0.05)
    outline: list[Rectangle] = []
    if kind == "L":
        outline = [(0.0, 0.0, wide + foot, wide), (0.0, 0.0, wide, wide + tip + lap)]
        pressed, arm = [(wide, 0.0, wide + foot, wide)], (0.0, wide + tip, wide, wide + tip + lap)
    elif kind == "T":
        outline = [(-foot, 0.0, wide + foot, wide), (0.0, 0.0, wide, wide + tip + lap)]
        pressed = [(-foot, 0.0, 0.0, wide), (wide, 0.0, wide + foot, wide)]
        arm = (0.0, wide + tip, wide, wide + tip + lap)
    elif kind == "lap":
        outline, arm = [(0.0, 0.0, wide, foot + lap)], (0.0, foot, wide, foot + lap)
        fixed = ["held"]
    else:
        outline = [(0.0, 0.0, 2.0 * foot, wide), (0.5 * foot, 0.0, 1.5 * foot, wide + beyond)]
        pressed, arm = [(0.0, 0.0, 2.0 * foot, wide)], None
    for k, box in enumerate(pressed):
        count = int(rng.integers(1, 3)) if kind == "T" else int(rng.integers(2, 4))
        held = bolted(_row(rng, box, count, 0), force * float(rng.uniform(0.7, 1.3)), radius, thick)
        joints.append({"on": f"foot_{k}", "pressure": held, "friction": mu} | COULOMB)
    top = max(box[3] for box in outline)
    edges = {"held": (0.0, 0.0, wide, 0.0)} if fixed else {}
    regions = {f"foot_{k}": box for k, box in enumerate(pressed)}
    if arm is None:
        edges["pulled"] = (0.5 * foot, top, 1.5 * foot, top)
        mesh = plate(outline, size, regions, edges, **how)
    else:
        at = _row(rng, arm, int(rng.integers(2, 4)), 1)
        joint = {"on": "strip", "against": "arm", "pressure": bolted(at, force, radius, thick)}
        joints.append(joint | {"friction": mu} | COULOMB)
        strip = (arm[0], arm[1], arm[2], arm[3] + beyond)
        pull = {"pulled": (strip[0], strip[3], strip[2], strip[3])}
        lower = plate(outline, size, regions | {"arm": arm}, edges, **how)
        mesh = sj.merged([lower, plate([strip], 1.1 * size, {"strip": arm}, pull, **how)])
    tables = structure_tables(joints, fixed, thick)
    return Parts(tables, mesh, [{"on": "pulled", "direction": _angle(rng)}], ["pulled"])


def _row(rng, box, count, axis):
    """Places of some bolts along the x (0) or y axis (1) of a rectangle, not quite even."""
    middle = [0.5 * (box[0] + box[2]), 0.5 * (box[1] + box[3])]
    length = box[2 + axis] - box[axis]
    shares = (np.arange(count) + 0.5 + rng.uniform(-0.12, 0.12, count)) / count
    places = [list(middle) for _ in shares]
    for place, share in zip(places, shares, strict=True):
        place[axis] = float(box[axis] + share * length)
    return places


def _laps_opening(rng, folder):
    """Lapped plates from the side or solids, bent and pulled, whose contact opens and closes."""
    if rng.random() < 0.6:
        arms, lap = rng.uniform(0.06, 0.15, 2).round(3).tolist(), _between(rng, 0.05, 0.1)
        counts = rng.integers((6, 12, 12, 6), (13, 25, 25, 13)).tolist()
        upper = [("upper_arm", arms[0], counts[0]), ("upper_lap", lap, counts[1])]
        lower = [("lower_lap", lap, counts[2]), ("lower_arm", arms[1], counts[3])]
        order, kind = (
            int(rng.choice([1, 2], p=(0.7, 0.3))),
            rng.choice(["quadrilateral", "triangle"]),
        )
        mesh = _lapped_from_the_side(
            upper, lower, _between(rng, 0.008, 0.02), kind=str(kind), order=order
        )
        joint = _pressed(rng, "upper_face", _pressure(rng, arms[0], lap), **_law(rng)) | FACES
        tables, turn = structure_tables([joint], ["held"], 0.04), rng.uniform(0.0, 2.0 * np.pi)
        if order == 1:
            tables["material"] |= _lumped(rng)
        ways = [[1.0, 0.0], [0.0, 1.0], [float(np.cos(turn)), float(np.sin(turn))]]
    else:
        size = _between(rng, 0.03, 0.05), _between(rng, 0.008, 0.015)
        kind = str(rng.choice(["hexahedron", "tetrahedron"]))
        tables, mesh = _lapped_solids(rng, kind, size, (int(rng.integers(3, 5)), 1))
        tables.pop("section")
        (joint,), turn = tables["joint"], rng.uniform(0.0, 2.0 * np.pi)
        ways = [[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [float(np.cos(turn)), 0.0, float(np.sin(turn))]]
    joint["contact"] = "unilateral"
    if rng.random() < 0.25:
        joint["normal_stiffness"] = float(10 ** rng.uniform(13.0, 14.5))
    way = ways[rng.integers(3)]
    places = [{"on": "pulled", "direction": way}, {"on": "lower_lap", "direction": way}]
    return Parts(tables, mesh, places, ["pulled"])


#: What draws the structures of each class.
CLASSES: Mapping[str, Callable[[np.random.Generator, Path], Parts]] = {
    "bars": _bars,
    "plates": _plates,
    "plates-side": _plates_side,
    "two-bodies": _two_bodies,
    "solids": _solids,
    "base": _base,
    "matrices": _matrices,
    "plates-bolted": _plates_bolted,
    "laps-opening": _laps_opening,
}

# %% Loads and steps

#: Kinds of load, and the steps in the shortest period or rise time of each.
HARMONIC = ("harmonic", "two loads", "several harmonics", "ratio of no whole number")
HARMONIC += ("first resonance", "second resonance", "third of the first", "fifth of the first")
PULSES = ("versine", "rectangle", "ramp", "table", "late triangle", "half sine")
LOADS = HARMONIC + PULSES


def _harmonic(rng, kind, first, second, cheap):
    """Amplitudes, frequencies and phases of each load, and the table of time."""
    low = float(np.exp(rng.uniform(np.log(0.08), np.log(0.7)))) * first
    steps = int(rng.choice([30, 40, 60, 80, 100, 150, 200][: 7 if cheap else 5]))
    cycles = int(rng.integers(3, 7)) if cheap else int(rng.integers(2, 5))
    phase = partial(rng.uniform, 0.0, 2.0 * np.pi)
    loads = [[(1.0, low, 0.0)]]
    if kind == "two loads":
        ratio = int(rng.integers(2, 5))
        loads = [[(1.0, low, 0.0)], [(_between(rng, 0.2, 0.6), ratio * low, phase())]]
        steps, cycles = steps * ratio // 2, max(2, cycles - 1)
    elif kind == "several harmonics":
        orders = [1, int(rng.integers(2, 4)), int(rng.integers(4, 6))]
        loads = [[(_between(rng, 0.3, 1.0) / n**0.5, n * low, phase()) for n in orders]]
        steps, cycles = steps * orders[-1] // 2, max(2, cycles - 1)
    elif kind == "ratio of no whole number":
        p, q = [(2, 3), (3, 4), (3, 5), (4, 5)][rng.integers(4)]
        loads = [[(0.7, p * low / q, phase()), (_between(rng, 0.3, 0.6), low, phase())]]
        steps, cycles = steps * q, 2
    elif kind == "first resonance":
        loads = [[(1.0, float(rng.uniform(0.85, 1.15)) * first, 0.0)]]
        cycles += 2
    elif kind == "second resonance":
        loads = [[(1.0, float(rng.uniform(0.9, 1.1)) * second, 0.0)]]
        cycles += 2
    elif kind in ("third of the first", "fifth of the first"):
        loads = [[(1.0, first / (3.0 if kind.startswith("third") else 5.0), 0.0)]]
    return loads, {"cycles": cycles, "steps_per_cycle": steps}


def _pulse(rng, kind, first, cheap, folder):
    """Load of unit peak that does not repeat, and the table of time."""
    natural = 1.0 / first
    rise = float(np.exp(rng.uniform(np.log(0.1), np.log(2.0)))) * natural
    start = float(rng.uniform(1.0, 3.0)) * natural if kind == "late triangle" else 0.0
    step = min(rise / rng.integers(6, 25), natural / rng.integers(15, 60))
    after = float(rng.uniform(2.0, 6.0) if cheap else rng.uniform(1.0, 3.0)) * natural
    length = start + 2.0 * rise + after
    shape = {"late triangle": "triangle", "ramp": "ramp_and_hold", "half sine": "half_sine"}
    load: Tables = {"kind": shape.get(kind, kind), "peak": 1.0}
    if kind == "rectangle":
        load["duration"] = 2.0 * rise
    elif kind == "table":
        times = np.concatenate(
            [[0.0], np.sort(rng.uniform(0.1, 0.9, int(rng.integers(3, 8)))), [1.0]]
        )
        forces = np.concatenate([[0.0], rng.uniform(-1.0, 1.0, times.size - 2), [0.0]])
        forces /= np.abs(forces).max()
        load = {"kind": "table", "file": "load.csv"}
        rows = np.stack([length * times, forces], axis=1)
        apart = min(b - a for a, b in pairwise(rows[:, 0]))
        step = min(step, max(apart, length / 300.0))
        np.savetxt(folder / "load.csv", rows, delimiter=",", fmt="%.17g")
    else:
        load |= {"rise_time": rise, "start": start}
    most = 1000 if cheap else 250
    step = max(float(step), length / most)
    return load, {"duration": float(step * np.ceil(length / step)), "step": float(step)}


def _loaded(rng, kind, parts, frequencies, folder):
    """Tables of loads of unit size, and of time."""
    first, second = frequencies
    if kind in PULSES:
        load, times = _pulse(rng, kind, first, parts.cheap, folder)
        return [dict(parts.places[0]) | load], times
    loads, times = _harmonic(rng, kind, first, second, parts.cheap)
    tables = []
    for k, components in enumerate(loads):
        on = dict(parts.places[k % len(parts.places)])
        keys = [dict(zip(("amplitude", "frequency", "phase"), c, strict=True)) for c in components]
        if len(keys) == 1:
            tables.append(on | {"kind": "harmonic"} | keys[0])
        else:
            tables.append(on | {"kind": "multi_harmonic", "components": keys})
        if "base" in on:  # forces beside accelerations
            break
    return tables, times


def _scaled(tables, factor, folder):
    """Loads times a factor."""
    scaled = []
    for load in tables:
        load = dict(load)
        for name in ("amplitude", "peak"):
            if name in load:
                load[name] *= factor
        if "components" in load:
            load["components"] = [
                part | {"amplitude": factor * part["amplitude"]} for part in load["components"]
            ]
        if load["kind"] == "table":
            rows = np.loadtxt(folder / "load.csv", delimiter=",")
            rows[:, 1] *= factor
            np.savetxt(folder / "load.csv", rows, delimiter=",", fmt="%.17g")
        scaled.append(load)
    return scaled


def _reduction(rng, kind):
    """Options of a reduced model, most as they are by default."""
    table: Tables = {"modes": "auto"}
    if rng.random() < 0.6:
        table["modes"] = int(rng.integers(4, 25))
    if rng.random() < 0.15:
        table["interface_modes"] = int(rng.integers(1, 5))
    if rng.random() < 0.2:
        table["friction_points"] = "all"
    if kind == "laps-opening":  # modes of the static path are what they have
        return {key: table[key] for key in ("modes", "interface_modes") if key in table}
    if kind != "plates-bolted" and rng.random() < 0.1:
        table["reference"] = "self"
    elif kind == "bars" and rng.random() < 0.1:
        table |= {"reference": "paper", "modes": int(rng.integers(4, 13))}
    return table


def _finer(times):
    """Table of time with twice as many steps."""
    if "step" in times:
        return times | {"step": 0.5 * times["step"]}
    return times | {"steps_per_cycle": 2 * times["steps_per_cycle"]}


def _follows(scene: Scene) -> bool:
    """Whether steps follow the vibration that jumps of the loads set off."""
    try:
        check_jumps(scene.system(), plan_of(scene))
    except InputError:
        return False
    return True


#: Largest slip of a joint that has not slipped as a whole, m, and factor on loads that make it so.
HELD, LESS = 2e-4, 0.7


def _holds(scene: Scene) -> bool:
    """Whether a joint whose contact opens holds its bodies together in a run of the scene.

    Bending tears a joint off that closed contact would hold.
    """
    try:
        run = integrate_plan(sj.condense(scene.system()), plan_of(scene).storing(fields_every=0))
    except ConvergenceError:
        return False
    return bool(run.slip_peak.max() <= HELD)


def draw(kind: str, seed: int, number: int, folder: Path) -> Drawn:
    """Draw one scene of a class; files that it needs are written into ``folder``.

    Of as many scenes as there are kinds of load each has another one.

    Raises
    ------
    JointError
        If the load that makes a joint slip is not found.
    """
    own, (turn, place) = zlib.crc32(kind.encode()), divmod(number, len(LOADS))
    rng = np.random.default_rng([own, seed, number])
    load = LOADS[np.random.default_rng([own, seed, turn, 1]).permutation(len(LOADS))[place]]
    parts = CLASSES[kind](rng, folder)
    share, others = _share(rng, kind), {"damping": _damping(rng)} | parts.tables
    rho, reduction = _rho(rng), _reduction(rng, kind)
    if parts.mesh is not None:  # of plain elements, with which the published tables were measured
        others |= {"mesh": {"file": "drawn", "incompatible": False}}
    if parts.observed:
        others["output"] = {"points": list(parts.observed)}

    def scene(loads, times):
        tables = others | {"load": loads, "time": times | {"rho_infinity": rho}}
        return scene_from(tables | {"reduction": reduction}, parts.mesh, folder / "scene.toml")

    unit = {"kind": "harmonic", "amplitude": 1.0, "frequency": 1.0}
    plain = scene([dict(parts.places[0]) | unit], {"cycles": 1}).system()
    for joints in ("stuck", "loose"):  # a bar in contact throughout has no stuck modes
        found = sj.natural_modes(plain, 8, joints=joints).straining.frequencies
        if found.size > 1:
            break
    loads, times = _loaded(rng, load, parts, found[:2].tolist(), folder)
    if kind == "plates-bolted" and rng.random() < 0.7:  # where the basis errs more than the step
        times = _finer(times)
    if kind in ("plates-bolted", "solids") and rng.random() < 0.2:  # so large that half steps are
        times = _finer(times)  # too dear for an estimate
    factor = share / share_of_slip(scene(loads, times))
    loads = _scaled(loads, factor, folder)
    made = scene(loads, times)
    for _ in range(5):
        if _follows(made):
            break
        made = scene(loads, times := _finer(times))
    while kind == "laps-opening" and not _holds(made):
        share, loads = LESS * share, _scaled(loads, LESS, folder)
        made = scene(loads, times)
    return Drawn(kind, seed, number, load, share, made)
