"""What a preview shows of a scene: joints, supports, loads, bolts and further named parts."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from skfem_joint.arrays import FloatArray, IntArray
from skfem_joint.errors import InputError
from skfem_joint.output.plots import prefixed_unit
from skfem_joint.scene import Scene
from skfem_joint.structure import Load, Structure
from skfem_joint.structure.patch import Patch
from skfem_joint.structure.pressure import Bolts

#: Places of no other kind that a label is written for, at most.
_MOST_PARTS = 12


@dataclass(frozen=True)
class Mark:
    """Something that the picture shows and names.

    Attributes
    ----------
    kind : {"joint", "support", "load", "bolt", "part"}
    name : str
        Name in the mesh; of a bolt its number in the scene, such as ``"bolt[0]"``.
    text : str
        Lines of its label.
    at : ndarray, shape (dim,)
        Place that the label points at, m.
    nodes : ndarray of int
        Displacement nodes of its place.
    cells : ndarray of int, shape (c, corners)
        Lines or surfaces that are coloured, by node numbers; none for points.
    direction : ndarray, shape (dim,), optional
        Unit vector of a load.
    pressure : ndarray, shape (c, corners), optional
        Of a joint, at the corners of its cells, Pa.
    line : ndarray, shape (2, dim), optional
        Axis of a bolt between its surfaces, m.
    rings : tuple of float
        Radii of head and hole of a bolt, m.
    """

    kind: str
    name: str
    text: str
    at: FloatArray
    nodes: IntArray
    cells: IntArray = field(default_factory=lambda: np.zeros((0, 2), np.intp))
    direction: FloatArray | None = None
    pressure: FloatArray | None = None
    line: FloatArray | None = None
    rings: tuple[float, ...] = ()


@dataclass(frozen=True)
class Preview:
    """What a preview shows of a scene.

    Attributes
    ----------
    title : str
        Heading of the picture.
    structure : Structure
    marks : tuple of Mark
        Joints, supports, loads, bolts and further named parts.
    notes : tuple of str
        Sentences about what the picture leaves out.
    """

    title: str
    structure: Structure
    marks: tuple[Mark, ...]
    notes: tuple[str, ...] = ()

    def of_kind(self, kind: str) -> tuple[Mark, ...]:
        """Marks of a kind, in the order of the scene."""
        return tuple(mark for mark in self.marks if mark.kind == kind)


def preview_of(scene: Scene) -> Preview:
    """Collect what a preview shows of a scene.

    Raises
    ------
    InputError
        If the scene is given by matrices, which have no geometry, or its structure is refused.
    """
    if scene.matrices is not None:
        raise InputError(
            f"{scene.path}: a scene of [matrices] has no geometry, so that there is nothing to "
            "draw; `skfem-joint check` says what it contains"
        )
    structure = scene.structure().meshed("a preview needs a mesh")
    scene.system()  # refuses loads and points that do not fit
    marks = [
        *(joint_mark(structure, patch) for patch in structure.patches),
        *_support_marks(structure),
        *_load_marks(scene, structure),
        *_clamp_marks(structure),
        *_bolt_marks(structure),
    ]
    parts, notes = _part_marks(structure, marks)
    return Preview(scene.title or scene.path.stem, structure, (*marks, *parts), notes)


def _surface(structure: Structure, name: str) -> IntArray:
    """Cells to colour of a region or boundary; none of a point and of a solid's region."""
    body, mesh = structure.body, structure.mesh
    if name in mesh.boundaries:
        return body.facet_cells(mesh.boundaries[name])[0]
    if name in mesh.regions and structure.dim < 3:
        return np.asarray(body.cells[np.isin(body.cell_element, mesh.regions[name])], dtype=np.intp)
    return np.zeros((0, 2), np.intp)


def _middle(structure: Structure, nodes: IntArray) -> FloatArray:
    """Middle of some nodes, moved to the nearest of them, m."""
    places = structure.nodes[nodes]
    middle = 0.5 * (places.min(axis=0) + places.max(axis=0))
    return np.asarray(places[np.argmin(np.linalg.norm(places - middle, axis=1))])


def _marked(structure: Structure, kind: str, name: str, text: str, **more: Any) -> Mark:
    """Mark of a named place."""
    nodes = structure.body.nodes_of(name)
    more = {"cells": _surface(structure, name)} | more
    return Mark(kind, name, text, _middle(structure, nodes), nodes, **more)


def _range(low: float, high: float, unit: str) -> str:
    """Range of values with a unit, or one value."""
    prefixed, size = prefixed_unit(unit, [np.array([high])])
    if high - low <= 1e-9 * abs(high):
        return f"{high / size:.4g} {prefixed}"
    return f"{low / size:.3g} to {high / size:.3g} {prefixed}"


def joint_mark(structure: Structure, patch: Patch) -> Mark:
    """Mark of a joint with the pressure at the corners of its cells."""
    joint, nodal = patch.joint, np.zeros(structure.n_nodes)
    if isinstance(joint.pressure, Bolts | str):
        nodal[patch.nodes] = patch.normal_force / patch.area
        if patch.held_area:
            nodal[patch.held_nodes] = patch.held_force / patch.held_area
        pressure = nodal[patch.cells]
    elif callable(joint.pressure):
        pressure = joint.pressure(structure.nodes[patch.cells])
    else:
        pressure = np.full(patch.cells.shape, float(joint.pressure))
    against = "on a rigid base" if joint.against is None else f"against {joint.against}"
    amount = _range(float(pressure.min()), float(pressure.max()), "Pa")
    text = f"joint {joint.name}\n{against}\n{amount}, friction {joint.friction:g}"
    nodes = np.unique(patch.cells)
    return Mark("joint", joint.name, text, _middle(structure, nodes), nodes, patch.cells,
                pressure=pressure)  # fmt: skip


def _support_marks(structure: Structure) -> Iterator[Mark]:
    """Mark of each supported place with the directions that are held."""
    axes = "xyz"[: structure.dim]
    held: dict[str, str] = {}
    for key, names in zip("xyz", (structure.fixed_x, structure.fixed_y, structure.fixed_z),
                          strict=True):  # fmt: skip
        held |= {name: held.get(name, "") + key for name in names}
    held |= dict.fromkeys(structure.fixed, axes)
    for name, directions in held.items():
        how = (
            "held in all directions"
            if len(directions) == structure.dim
            else f"held in {', '.join(directions)}"
        )
        yield _marked(structure, "support", name, f"support {name}\n{how}")


def _load_marks(scene: Scene, structure: Structure) -> Iterator[Mark]:
    """Mark of each load with its peak and its shape in time."""
    for table, load in zip(scene.load, scene.loads(), strict=True):
        peak = load.amplitude.peak_value
        if peak is None:  # it is sampled over the run
            times = np.linspace(0.0, scene.n_steps * scene.time_step, 2001)
            peak = float(np.abs(load.amplitude(times)).max())
        unit = "m/s2" if load.base is not None else "N" if load.quantity == "force" else "Pa"
        amount = f"{peak:.4g} m/s2" if unit == "m/s2" else _range(peak, peak, unit)
        parts = load.amplitude.harmonics
        often = f" {parts[0].frequency:g} Hz" if len(parts) == 1 else ""
        shape = f"{table.kind.replace('_', ' ')}{often}"
        where = f"base along {load.base}" if load.on is None else load.on
        what = "" if load.quantity == "force" else f"{load.quantity} "
        text = f"load {where}\n{what}peak {amount}\n{shape}"
        direction = _direction(structure, load)
        if load.on is not None:
            yield _marked(structure, "load", load.on, text, direction=direction)
            continue
        nodes = np.flatnonzero(structure.held.any(axis=1))
        nodes = nodes if nodes.size else np.arange(structure.n_nodes)
        place = _middle(structure, nodes)
        yield Mark("load", f"mass_{load.base}", text, place, nodes, direction=direction)


def _direction(structure: Structure, load: Load) -> FloatArray:
    """Unit vector of a load; of a pressure against the mean normal, or that of its first facet."""
    if load.quantity != "pressure":
        return load.unit(structure.dim)
    part = structure.body.facet_basis(structure.mesh.boundaries[str(load.on)])
    mean = -np.einsum("dfq,fq->d", np.asarray(part.normals), part.dx) / part.dx.sum()
    if np.linalg.norm(mean) < 1e-6:  # it acts all around
        mean = -np.asarray(part.normals)[:, 0, 0]
    return np.asarray(mean / np.linalg.norm(mean))


def _clamp_marks(structure: Structure) -> Iterator[Mark]:
    """Mark of each clamping bolt: its surfaces and the line between them."""
    for number, bolt in enumerate(structure.bolts):
        names = [name for _, name in bolt.surfaces]
        cells = np.vstack([_surface(structure, name) for name in names])
        middles = np.array([structure.body.even_shares(n) @ structure.nodes for n in names])
        where = " to ".join(names) if len(names) > 1 else f"{names[0]} to the rigid base"
        kind = "cut " if bolt.shank else ""
        text = (
            f"bolt {number + 1}\n{kind}{where}\nclamp force {_range(bolt.force, bolt.force, 'N')}"
        )
        yield Mark("bolt", f"bolt[{number}]", text, middles[0], np.unique(cells), cells,
                   line=middles if len(middles) > 1 else None)  # fmt: skip


def _bolt_marks(structure: Structure) -> Iterator[Mark]:
    """Mark of each bolt of a joint's pressure: its place, and the rings of head and hole."""
    for joint in structure.joints:
        if not isinstance(joint.pressure, Bolts):
            continue
        for number, bolt in enumerate(joint.pressure.bolts):
            at = np.asarray(bolt.at, dtype=float)[: structure.dim]
            text = f"bolt {number + 1} of {joint.name}\nforce {_range(bolt.force, bolt.force, 'N')}"
            name, rings = f"{joint.name}.bolts[{number}]", (bolt.head_radius, bolt.hole_radius)
            yield Mark("bolt", name, text, at, np.zeros(0, np.intp), rings=rings)


def _part_marks(structure: Structure, marks: Sequence[Mark]) -> tuple[list[Mark], tuple[str, ...]]:
    """Marks of the named places that no other mark names, and a note on those left out."""
    mesh, taken = structure.mesh, {mark.name for mark in marks}
    taken |= {name for bolt in structure.bolts for _, name in bolt.surfaces}
    kinds: dict[str, Iterable[str]] = {
        "region": mesh.regions,
        "boundary": mesh.boundaries,
        "point": mesh.points,
    }
    names = [(kind, name) for kind, table in kinds.items() for name in table if name not in taken]
    shown = [_marked(structure, "part", name, f"{kind} {name}", cells=np.zeros((0, 2), np.intp))
             for kind, name in names[:_MOST_PARTS]]  # fmt: skip
    left = len(names) - len(shown)
    return shown, (f"{left} further named parts are not labelled.",) if left else ()
