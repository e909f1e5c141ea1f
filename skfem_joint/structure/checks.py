"""What only the mesh can tell of a structure: mistakes to refuse, and doubts to say."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations, islice, product
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from skfem_joint.arrays import FloatArray, IntArray
from skfem_joint.errors import closest, listed
from skfem_joint.mesh import NamedMesh
from skfem_joint.mesh.cells import spot
from skfem_joint.modes import ratio_problems
from skfem_joint.structure.patch import NORMAL_FORCES, SMALL, Joint, Patch
from skfem_joint.structure.pressure import Bolts, PressureTable
from skfem_joint.values import BETA, FINITE, NOT_NEGATIVE, POISSON, POSITIVE, problems

if TYPE_CHECKING:
    from skfem_joint.structure import AnyStructure
    from skfem_joint.structure.load import Load
    from skfem_joint.structure.structure import Structure
    from skfem_joint.system import System

_QUANTITIES = ("force", "traction", "pressure")
#: Unknown names of observed points that are told by themselves.
_MOST_TOLD = 20
_KINDS = ("region", "boundary", "point")
# Sizes across a mesh of each dimension, and what may be pressed in it.
_SECTION = {1: ("width", "thickness"), 2: ("thickness",), 3: ()}
_PRESSED = {1: ("region",), 2: ("region", "boundary"), 3: ("boundary",)}
# A body so many times longer than thick was probably drawn in other units; so was one as short.
_LONGEST, _SHORTEST = 2000.0, 0.1
# Least and most that is usual of a property, its unit, and what steel has; the same of others.
_USUAL = {"E": (1e6, 2e12, "Pa", "2e11"), "density": (5.0, 3e4, "kg/m3", "7850")}
_PRESSURES, _MOST_FRICTION, _SIZES = (1e3, 1e10), 2.0, (1e-3, 100.0)
# Fewest elements that carry a wave.
_PER_WAVELENGTH = 6
# Elements that reach from side to side are told from this share of all on; sides are opposite whose
# normals have this cosine or more with a direction and its opposite.
_SPANNING, _OPPOSITE = 0.05, 0.85
# Change of an area or mass by straight edges that asks for smaller elements.
_STRAIGHTENED = 0.01
# A bolt's ring on fewer contact points is poorly resolved; share of it that is told as not whole.
_FEWEST_POINTS, _WHOLE_RING = 12, 0.99


def problems_of(structure: Structure) -> list[str]:
    """Mistakes in values, names and joints, as far as they can be told without the nodes."""
    found = [*_values(structure), *_overrides(structure)]
    for key in ("fixed", "fixed_x", "fixed_y", "fixed_z"):
        names = getattr(structure, key)
        for name in names:
            found += wrong_name(structure.mesh, name, _KINDS, f"support.{key}")
        if names and key[-1] in "xyz"[structure.dim :]:
            found.append(f"support.{key}: this mesh has no {key[-1]} direction")
    return [*found, *joint_problems(structure.mesh, structure.joints)]


def _one_of(where: str, value: str, allowed: Sequence[str]) -> Iterator[str]:
    if value not in allowed:
        yield f"{where}: found {value!r}, must be one of {', '.join(allowed)}"


def _values(structure: Structure) -> Iterator[str]:
    needed = _SECTION[structure.dim]
    what = {1: "a bar", 2: "a plate", 3: "a solid"}[structure.dim]
    for name in ("width", "thickness"):
        value = getattr(structure, name)
        if value is None and name in needed:
            yield f"section.{name}: missing, {what} needs it, in m"
        elif value is not None and name not in needed:
            yield f"section.{name}: found {value}, but {what} has none; leave it out"
        elif value is not None:
            yield from problems(f"section.{name}", value, POSITIVE)
    material = structure.material
    yield from problems("material.E", material.E, POSITIVE)
    yield from problems("material.density", material.density, POSITIVE)
    if structure.dim > 1 and material.poisson is None:
        yield f"material.poisson: missing, {what} needs Poisson's ratio"
    if material.poisson is not None:
        yield from problems("material.poisson", material.poisson, POISSON)
    yield from _one_of("plane", structure.plane, ("stress", "strain"))
    yield from _one_of("mass", structure.mass, ("consistent", "lumped"))
    if structure.mass == "lumped" and structure.mesh.order > 1:
        yield (
            "material.mass_matrix: found 'lumped' beside elements of second order, whose row sums "
            "are zero or negative at some nodes; use 'consistent'"
        )
    yield from problems("damping.stiffness", structure.stiffness_damping, NOT_NEGATIVE)
    yield from problems("damping.mass", structure.mass_damping, NOT_NEGATIVE)
    if structure.damping_ratio is not None:
        factors = {"stiffness": structure.stiffness_damping, "mass": structure.mass_damping}
        yield from ratio_problems(structure.damping_ratio, factors)


def _overrides(structure: Structure) -> Iterator[str]:
    known = ("E", "density", "poisson", *_SECTION[structure.dim])
    regions = structure.mesh.regions
    for region, values in structure.regions.items():
        where = f"regions.{region}"
        yield from wrong_name(structure.mesh, region, ("region",), where)
        for name, value in values.items():
            yield from _one_of(f"{where}: property", name, known)
            kind = POISSON if name == "poisson" else POSITIVE
            yield from problems(f"{where}.{name}", value, kind)
    for (one, first), (two, second) in combinations(structure.regions.items(), 2):
        both = sorted(set(first) & set(second))
        if both and _share(regions.get(one, ()), regions.get(two, ())):
            yield (
                f"regions.{two}: found {' and '.join(both)}, which region {one!r} also sets; the "
                "two regions share elements, so only one may"
            )


def _share(one: ArrayLike, two: ArrayLike) -> bool:
    return np.intersect1d(one, two).size > 0


def wrong_name(mesh: NamedMesh, name: str, kinds: Sequence[str], where: str) -> list[str]:
    """What is wrong with a name that must be of one of the kinds, if anything is."""
    tables: dict[str, Mapping[str, Any]] = {
        "region": mesh.regions, "boundary": mesh.boundaries, "point": mesh.points
    }  # fmt: skip
    found = [kind for kind in tables if name in tables[kind]]
    if set(found) & set(kinds):
        return []
    if not any(tables.values()):
        return [
            f"{where}: found {name!r}, but nothing in the mesh has a name: name Physical Groups, "
            f"in Gmsh such as Physical Curve({name!r}) = {{1}}, Physical Surface, Physical Volume "
            "or Physical Point; save the mesh again"
        ]
    has = "; ".join(f"{kind}: {listed(tables[kind])}" for kind in kinds)
    wrong = f"which is a {found[0]}" if found else "no such name in the mesh"
    hint = "" if found else closest(name, [n for kind in kinds for n in tables[kind]])
    return [
        f"{where}: found {name!r}, {wrong}; a {' or '.join(kinds)} is needed; the mesh has {has}"
        f"{hint}"
    ]


def joint_value_problems(joint: Joint) -> Iterator[str]:
    """What is wrong with the numbers and words of a joint."""
    yield from problems(f"{joint.label}: friction", joint.friction, NOT_NEGATIVE)
    yield from problems(f"{joint.label}: beta", joint.beta, BETA)
    yield from _one_of(f"{joint.label}: normal_force", joint.normal_force, NORMAL_FORCES)
    if not isinstance(joint.pressure, PressureTable | Bolts | str):  # words are told by patches
        yield from problems(f"{joint.label}: pressure", joint.pressure, NOT_NEGATIVE)


def joint_problems(mesh: NamedMesh, joints: Sequence[Joint]) -> Iterator[str]:
    """What is wrong with joints, as far as it can be told without their nodes."""
    outer = mesh.mesh.boundary_facets()
    taken: dict[str, list[Joint]] = {"region": [], "boundary": []}
    for joint in joints:
        where = joint.label
        yield from joint_value_problems(joint)
        kind = "region" if joint.on in mesh.regions else "boundary"
        wrong = wrong_name(mesh, joint.on, _PRESSED[mesh.dim], f"{where}.on")
        if not wrong and joint.against is not None:
            wrong = wrong_name(mesh, joint.against, (kind,), f"{where}.against")
        if wrong:
            yield from wrong
            continue
        table = mesh.regions if kind == "region" else mesh.boundaries
        parts = [table[name] for name in (joint.on, joint.against) if name is not None]
        if kind == "boundary" and not all(np.isin(part, outer).all() for part in parts):
            yield f"{where}: it runs inside a body; a joint must be on its border"
        elements = [part if kind == "region" else mesh.mesh.f2t[0, part] for part in parts]
        if len(parts) == 2 and _share(*(mesh.body[some] for some in elements)):
            yield (
                f"{where}: {joint.on!r} and {joint.against!r} belong to the same body; a joint "
                "presses two bodies on each other, meshed apart from each other"
            )
        others = sorted({repr(one.on) for one in taken[kind] if _share(table[one.on], parts[0])})
        if others:
            yield f"{where} overlaps joint {', '.join(others)}; joints must not overlap"
        for one in taken[kind] if kind == "boundary" else ():  # a face touches one other thing
            crossed = (one.on, joint.against), (one.against, joint.on)
            if any(a and b and _share(table[a], table[b]) for a, b in crossed):
                yield (
                    f"{where}: it lies on a part of {one.label}, by this or another name; "
                    "a face touches one thing: leave one of the joints out, or split the face"
                )
        taken[kind].append(joint)
        if isinstance(joint.pressure, PressureTable):
            corners = mesh.mesh.t if kind == "region" else mesh.mesh.facets
            yield from _table_covers(mesh, joint.pressure, corners[:, parts[0]].ravel(), where)


def _table_covers(
    mesh: NamedMesh, table: PressureTable, vertices: IntArray, where: str
) -> Iterator[str]:
    """Whether a table of pressures reaches over the whole joint with the given vertices."""
    if table.axis is not None and len(table.axis) != mesh.dim:
        yield f"{where}: pressure.axis: found {table.axis}, must be {mesh.dim} numbers"
        return
    s = table.along(mesh.mesh.p[:, vertices].T)
    first, last = table.positions[0], table.positions[-1]
    tolerance = 1e-9 * mesh.size
    if first > s.min() + tolerance or last < s.max() - tolerance:
        yield (
            f"{where}: pressure.positions: found {first:g} to {last:g} m, must cover the "
            f"joint, which reaches from {s.min():g} to {s.max():g} m along the axis"
        )


def problems_of_places(
    structure: Structure, loads: Sequence[Load], points: Sequence[str] | None
) -> list[str]:
    """Mistakes in the names of loads and observed points, and in the loads' directions."""
    dim = structure.dim
    wrong = (p for on in points or () for p in wrong_name(structure.mesh, on, _KINDS, "points"))
    found = [*islice(wrong, _MOST_TOLD)]
    for load in loads:
        found += _one_of(f"{load.label}: quantity", load.quantity, _QUANTITIES)
        if load.base is not None or load.on is None:
            found += _base_problems(load, dim)
            continue
        by_area = load.quantity != "force"
        where = f"{load.label}: quantity = {load.quantity!r}" if by_area else load.label
        kinds = ("boundary",) if by_area else _KINDS
        found += wrong_name(structure.mesh, load.on, kinds, where)
        if load.quantity == "pressure":
            found += _pressure_problems(structure.mesh, load)
            continue
        vector = np.ravel(() if load.direction is None else load.direction)
        if load.direction is None and dim > 1:
            found.append(
                f"{load.label}: direction: missing, must be given as {dim} numbers, "
                f"e.g. {[1.0, *[0.0] * (dim - 1)]}"
            )
        elif load.direction is not None and not (
            vector.shape == (dim,) and all(x in FINITE for x in vector) and np.any(vector)
        ):
            found.append(
                f"{load.label}: direction: found {list(load.direction)}, must be {dim} "
                "finite numbers, not all zero"
            )
    return found


def _pressure_problems(mesh: NamedMesh, load: Load) -> Iterator[str]:
    """What is wrong with a pressure as a load."""
    if load.direction is not None:
        yield (
            f"{load.label}: direction: found {list(load.direction)} beside quantity = 'pressure', "
            "which acts against the normal; leave it out, or choose quantity = 'traction'"
        )
    inside = np.setdiff1d(mesh.boundaries.get(str(load.on), ()), mesh.mesh.boundary_facets())
    if inside.size:
        yield f"{load.label}: it runs inside a body; a pressure must be on its border"


def _base_problems(load: Load, dim: int) -> Iterator[str]:
    """What is wrong with a load on no place, or on a base."""
    if (load.on is None) == (load.base is None):
        yield (
            f"{load.label}: found on = {load.on!r} and base = {load.base!r}, must be one of the "
            "two: the place of a force, or the axis along which the supports are accelerated"
        )
    elif load.direction is not None:
        yield f"{load.label}: direction: found {load.direction} beside base; leave it out"
    elif load.quantity != "force":
        yield f"{load.label}: quantity: found {load.quantity!r} beside base; leave it out"
    else:
        yield from _one_of(f"{load.label}: base", str(load.base), "xyz"[:dim])


def body_motions(structure: Structure) -> FloatArray:
    """Rigid motions of each body, (N, dim, motions): translations, then turns."""
    d, bodies = structure.dim, int(structure.mesh.body.max()) + 1
    turns = list(combinations(range(d), 2))
    each = d + len(turns)
    position = structure.nodes - structure.nodes.mean(axis=0)
    position /= np.abs(position).max()
    motions = np.zeros((structure.n_nodes, d, each * bodies))
    node, first = np.arange(structure.n_nodes), each * structure.body
    for c in range(d):
        motions[node, c, first + c] = 1.0
    for k, (i, j) in enumerate(turns):
        motions[node, i, first + d + k] = -position[:, j]
        motions[node, j, first + d + k] = position[:, i]
    return motions


def loose_bodies(structure: Structure, friction: bool = True) -> list[str]:
    """Bodies left with a rigid motion by supports, closed contact and ``friction``, in words."""
    motions = body_motions(structure)
    rows = [motions[structure.held]]
    for patch in structure.patches:
        relative = np.moveaxis(patch.relative(np.moveaxis(motions, 2, 0)), 0, -1)
        if patch.normal is not None:
            rows.append(np.einsum("kc,kcm->km", patch.normal, relative))
        if friction and patch.joint.friction > 0.0:
            held = np.einsum("kdc,kcm->kdm", patch.directions, relative)
            rows.append(held.reshape(-1, motions.shape[2]))
    rows.append(structure.cuts.held @ motions.reshape(-1, motions.shape[2]))
    loose = np.abs(left_loose(rows))
    moving = loose.reshape(structure.mesh.body.max() + 1, -1).max(axis=1, initial=0.0) > 1e-6
    return [body_label(structure.mesh, body) for body in np.flatnonzero(moving).tolist()]


def left_loose(rows: Sequence[FloatArray]) -> FloatArray:
    """Combinations (motions, k) of motions on which all rows (.., motions) vanish."""
    gram = sum(row.T @ row for row in rows) / max(1, sum(len(row) for row in rows))
    squares, vectors = np.linalg.eigh(gram)
    return np.asarray(vectors[:, squares < SMALL**2 + 1e-13 * squares.max(initial=0.0)])


def body_label(mesh: NamedMesh, body: int) -> str:
    """A body in words, after its regions if it has any."""
    own = [
        repr(name)
        for name, elements in sorted(mesh.regions.items())
        if len(elements) and np.all(mesh.body[elements] == body)
    ]
    if own:
        return f"the body with the region{'s' if len(own) > 1 else ''} {', '.join(own)}"
    middle = mesh.mesh.p[:, mesh.mesh.t[:, mesh.body == body]].mean(axis=(1, 2))
    return f"the body around {spot(middle)}"


def doubts(structure: AnyStructure, system: System) -> list[str]:
    """Sentences about values, size, loads and joints: what is allowed but looks like a slip."""
    found = [*system.notes, *structure.unusual(system)]
    if not structure.patches:
        found.append("There is no joint: nothing slips, the structure is linear.")
    for patch in structure.patches:
        joint = patch.joint
        if not np.any(system.w[patch.points] > 0.0):
            found.append(
                f"Joint '{joint.name}' carries no friction: its pressure or friction is 0."
            )
        if isinstance(joint.pressure, Bolts):
            found += _bolt_doubts(structure, patch, joint.pressure)
        force, area = patch.clamping_force, float(patch.area.sum()) + patch.held_area
        if force > 0.0 and not _PRESSURES[0] <= force / area <= _PRESSURES[1]:
            found.append(
                f"Joint '{joint.name}' is pressed by {force / area:.4g} Pa; bolts press by "
                "1e6 to 1e9 Pa: is it in Pa?"
            )
        if joint.friction > _MOST_FRICTION:
            found.append(
                f"Joint '{joint.name}' has a coefficient of friction of "
                f"{joint.friction:.4g}; dry metals have 0.1 to 1: is it in percent?"
            )
    return found


def unusual(structure: Structure) -> Iterator[str]:
    """Sentences about values that no structure has in SI units."""
    for name, (least, most, unit, steel) in _USUAL.items():
        values = structure.properties[name]
        if not least <= values.min() <= values.max() <= most:
            worst = values.min() if values.min() < least else values.max()
            yield f"material.{name} is {worst:.4g} {unit}; steel has {steel}: is it in {unit}?"
    size = float(np.ptp(structure.nodes, axis=0).max())
    across = {name: getattr(structure, name) for name in _SECTION[structure.dim]}
    across = {name: structure.properties[name].min() for name, value in across.items() if value}
    ratios = [size / extent for extent in across.values()]
    if not _SIZES[0] <= size <= _SIZES[1] or not all(_SHORTEST < r < _LONGEST for r in ratios):
        words = {"width": "wide", "thickness": "thick"}
        also = "".join(f", {extent:.4g} m {words[name]}" for name, extent in across.items())
        yield (
            f"The structure is {size:.4g} m long{also}: is the mesh in metres? mesh.scale = 1e-3 "
            "reads one in millimetres; sections are in metres too."
        )


def straightened(structure: Structure, system: System) -> Iterator[str]:
    """Sentences about areas and mass that change because curved edges are made straight."""
    mesh, change = structure.mesh, structure.mesh.straightened
    if change is None:
        return
    straight = structure.basis.dx.sum(axis=1)
    by_size = structure.properties["density"] * structure.across
    mass = float(by_size @ straight)
    changes = {"the mass": mass / (mass + float(by_size @ change.lost)) - 1.0}
    uses = [("joint", name) for j in structure.joints for name in (j.on, j.against)]
    uses += [(key, name) for bolt in structure.bolts for key, name in bolt.surfaces]
    for load in system.loads:  # ".2" is a second direction
        known = load.on in mesh.boundaries or load.on in mesh.regions
        uses.append(("load", load.on if known else load.on.rpartition(".")[0]))
    roles: dict[str, list[str]] = {}
    for role, name in uses:
        if name in mesh.boundaries or name in mesh.regions:
            roles.setdefault(str(name), []).append(role)
    sizes = ("length", "area", "volume")
    for name, given in roles.items():
        where = f"of {name!r} ({', '.join(dict.fromkeys(given))})"
        if name in mesh.boundaries:
            changes[f"the {sizes[mesh.dim - 2]} {where}"] = change.boundaries[name]
        else:
            own = mesh.regions[name]
            size = float(straight[own].sum())
            ratio = size / (size + float(change.lost[own].sum()))
            changes[f"the {sizes[mesh.dim - 1]} {where}"] = ratio - 1.0
    by_how_much = ", ".join(
        f"{what} by {100.0 * x:.2g} %" for what, x in changes.items() if abs(x) > 1e-9
    )
    yield f"Edges that were curved are straight here, which changes {by_how_much or 'no size'}."
    much = [what for what, x in changes.items() if abs(x) > _STRAIGHTENED]
    if much:
        yield (
            f"Straight edges in place of curved ones change {', '.join(much)} by more than "
            f"{100.0 * _STRAIGHTENED:g} %: use smaller elements there (in Gmsh "
            "Mesh.MeshSizeFromCurvature = 36, elements a turn)."
        )


def per_wavelength(structure: Structure, frequency: float) -> tuple[float, float]:
    """Speed (m/s) of the slowest bulk wave, and the fewest elements in its length at a frequency.

    An element of second order counts as two.
    """
    stretching, shear = structure.lame()
    speed = np.sqrt((shear if shear.any() else stretching) / structure.properties["density"])
    size = np.ptp(structure.mesh.mesh.p[:, structure.mesh.mesh.t], axis=1).max(axis=0)
    return float(speed.min()), float((structure.mesh.order * speed / (frequency * size)).min())


def waves(structure: Structure, system: System) -> Iterator[str]:
    """Sentence about elements that do not carry the waves of the loads."""
    frequency = max((load.amplitude.highest_frequency or 0.0 for load in system.loads), default=0.0)
    fewest = per_wavelength(structure, frequency)[1] if frequency > 0.0 else np.inf
    if fewest < _PER_WAVELENGTH:
        yield (
            f"There are {fewest:.2g} elements in the length of the slowest wave at {frequency:.5g} "
            f"Hz, the highest frequency of the loads; {_PER_WAVELENGTH} are the least: refine the "
            "mesh, or check frequency, rise_time, E and density."
        )


def locking(structure: Structure) -> Iterator[str]:
    """Sentence about elements of first order that bend too stiffly."""
    if structure.dim == 1 or structure.mesh.order > 1:
        return
    mesh = structure.mesh.mesh
    part = structure.facet_basis(mesh.boundary_facets())
    # In opposite order they are their opposites.
    directions = np.array([*product((-1.0, 0.0, 1.0), repeat=structure.dim)])
    directions /= np.maximum(np.linalg.norm(directions, axis=1), 1.0)[:, np.newaxis]
    along = part.normals[..., 0].T @ directions.T
    most = np.full((mesh.p.shape[1], len(directions)), -1.0)
    for corner in mesh.facets[:, part.find]:
        np.maximum.at(most, corner, along)
    reached = most[mesh.t].max(axis=0) > _OPPOSITE
    share = (reached & reached[:, ::-1]).any(axis=1).mean()
    if share > _SPANNING:
        each = f"{structure.cell.name}s of first order".replace("hedrons", "hedra")
        yield (
            f"{100.0 * share:.3g} % of the elements reach from one side to the other: single "
            f"{each} are too stiff in bending (they lock); take second order, or at least two "
            "elements through the thickness, better four."
        )


def _bolt_doubts(structure: AnyStructure, patch: Patch, bolts: Bolts) -> Iterator[str]:
    for bolt, share in zip(bolts.bolts, patch.bolt_shares, strict=True):
        where = f"The bolt at {spot(np.array(bolt.at))} in joint '{patch.joint.name}'"
        if share < _WHOLE_RING:
            yield f"{where} has {100 * share:.3g} % of its ring on the joint, and its whole force."
        centre = np.asarray(bolt.at[: structure.dim])
        distance = np.linalg.norm(structure.nodes[patch.nodes] - centre, axis=1)
        points = int(np.count_nonzero(distance <= bolts.outer_radius(bolt)))
        if points < _FEWEST_POINTS:
            yield f"{where} presses only {points} nodes within its ring: refine the mesh around it."
