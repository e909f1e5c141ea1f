"""What a picture of a structure before it is run shows: joints, supports, loads, bolts and names.

`preview_of` collects it from a scene as marks;
:mod:`skfem_joint.output.drawing.preview_picture` draws it.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from skfem_joint.ground.arrays import FloatArray, IntArray
from skfem_joint.ground.errors import InputError
from skfem_joint.joint.pressure import Bolts
from skfem_joint.output.plots import prefixed_unit
from skfem_joint.scene import Scene
from skfem_joint.structure.load import Load
from skfem_joint.structure.structure import Structure

#: Places of no other kind that a label is written for, at most.
_MOST_PARTS = 12
_NO_NODES, _NO_CELLS = np.zeros(0, np.intp), np.zeros((0, 2), np.intp)


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
        Displacement nodes of its place, the nearest to ``at`` first.
    cells : ndarray of int, shape (c, corners)
        Lines or surfaces that are coloured, by node numbers; none for points.
    direction : ndarray, shape (dim,), optional
        Unit vector of a load.
    pressure : ndarray, shape (c, corners), optional
        Of a joint, at the corners of its cells, Pa.
    lines : tuple of ndarray, each of shape (k, dim)
        Axis of a bolt, or the circles of its head and hole, m.
    """

    kind: str
    name: str
    text: str
    at: FloatArray
    nodes: IntArray
    cells: IntArray
    direction: FloatArray | None = None
    pressure: FloatArray | None = None
    lines: tuple[FloatArray, ...] = ()


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
    marks = [*joint_marks(structure), *_support_marks(structure), *_load_marks(scene, structure),
             *_bolt_marks(structure)]  # fmt: skip
    mesh, taken = structure.mesh, {mark.name for mark in marks}
    taken |= {name for bolt in structure.bolts for _, name in bolt.surfaces}
    kinds: dict[str, Iterable[str]]
    kinds = {"region": mesh.regions, "boundary": mesh.boundaries, "point": mesh.points}
    names = [(kind, name) for kind, table in kinds.items() for name in table if name not in taken]
    for kind, name in names[:_MOST_PARTS]:
        nodes = structure.body.nodes_of(name)
        marks.append(_mark(structure, "part", name, f"{kind} {name}", nodes, _NO_CELLS))
    left = len(names) - _MOST_PARTS
    notes = (f"{left} further named parts are not labelled.",) if left > 0 else ()
    return Preview(scene.title or scene.path.stem, structure, tuple(marks), notes)


def _mark(
    structure: Structure, kind: str, name: str, text: str, nodes: IntArray, cells: IntArray,
    **more: Any,
) -> Mark:  # fmt: skip
    """Mark whose label points at the one of its nodes that is nearest to their middle."""
    places = structure.nodes[nodes]
    middle = 0.5 * (places.min(axis=0) + places.max(axis=0))
    nodes = nodes[np.argsort(np.linalg.norm(places - middle, axis=1), kind="stable")]
    return Mark(kind, name, text, structure.nodes[nodes[0]], nodes, cells, **more)


def _surface(structure: Structure, name: str) -> IntArray:
    """Cells to colour of a region or boundary; none of a point and of a solid's region."""
    body, mesh = structure.body, structure.mesh
    if name in mesh.boundaries:
        return body.facet_cells(mesh.boundaries[name])[0]
    if name in mesh.regions and structure.dim < 3:
        return np.asarray(body.cells[np.isin(body.cell_element, mesh.regions[name])], dtype=np.intp)
    return _NO_CELLS


def _range(low: float, high: float, unit: str) -> str:
    """Range of values with a unit, or one value."""
    prefixed, size = prefixed_unit(unit, [np.array([high])])
    if high - low <= 1e-9 * abs(high):
        return f"{high / size:.4g} {prefixed}"
    return f"{low / size:.3g} to {high / size:.3g} {prefixed}"


def joint_marks(structure: Structure) -> Iterator[Mark]:
    """Mark of each joint with the pressure at the corners of its cells."""
    for patch in structure.patches:
        joint, nodal = patch.joint, np.zeros(structure.n_nodes)
        if isinstance(joint.pressure, Bolts | str):
            nodal[patch.nodes] = patch.normal_force / patch.area
            nodal[patch.held_nodes] = patch.held_forces / patch.held_areas
            pressure = nodal[patch.cells]
        elif callable(joint.pressure):
            pressure = joint.pressure(structure.nodes[patch.cells])
        else:
            pressure = np.full(patch.cells.shape, float(joint.pressure))
        against = "on a rigid base" if joint.against is None else f"against {joint.against}"
        amount = _range(float(pressure.min()), float(pressure.max()), "Pa")
        text = f"joint {joint.name}\n{against}\n{amount}, friction {joint.friction:g}"
        yield _mark(structure, "joint", joint.name, text, np.unique(patch.cells), patch.cells,
                    pressure=pressure)  # fmt: skip


def _support_marks(structure: Structure) -> Iterator[Mark]:
    """Mark of each supported place with the directions that are held."""
    held: dict[str, str] = {}
    for axis, names in zip("xyz", (structure.fixed_x, structure.fixed_y, structure.fixed_z),
                           strict=True):  # fmt: skip
        held |= {name: held.get(name, "") + axis for name in names}
    held |= dict.fromkeys(structure.fixed, "xyz"[: structure.dim])
    for name, axes in held.items():
        how = "all directions" if len(axes) == structure.dim else ", ".join(axes)
        yield _mark(structure, "support", name, f"support {name}\nheld in {how}",
                    structure.body.nodes_of(name), _surface(structure, name))  # fmt: skip


def _load_marks(scene: Scene, structure: Structure) -> Iterator[Mark]:
    """Mark of each load with its peak and its shape in time."""
    for table, load in zip(scene.load, scene.loads(), strict=True):
        peak = load.amplitude.peak_value or 0.0  # all shapes of scenes know it
        amount = _range(peak, peak, "N" if load.quantity == "force" else "Pa")
        what = "" if load.quantity == "force" else f"{load.quantity} "
        parts = load.amplitude.harmonics
        often = f" {parts[0].frequency:g} Hz" if len(parts) == 1 else ""
        shape = f"{table.kind.replace('_', ' ')}{often}"
        if load.on is None:
            name, where, amount = f"mass_{load.base}", f"base along {load.base}", f"{peak:.4g} m/s2"
            held, cells = np.flatnonzero(structure.held.any(axis=1)), _NO_CELLS
            nodes = held if held.size else np.arange(structure.n_nodes)
        else:
            name = where = load.on
            nodes, cells = structure.body.nodes_of(name), _surface(structure, name)
        text = f"load {where}\n{what}peak {amount}\n{shape}"
        yield _mark(structure, "load", name, text, nodes, cells,
                    direction=_direction(structure, load))  # fmt: skip


def _direction(structure: Structure, load: Load) -> FloatArray:
    """Unit vector of a load; of a pressure against the mean normal, or that of its first facet."""
    if load.quantity != "pressure":
        return load.unit(structure.dim)
    part = structure.body.facet_basis(structure.mesh.boundaries[str(load.on)])
    mean = -np.einsum("dfq,fq->d", np.asarray(part.normals), part.dx) / part.dx.sum()
    if np.linalg.norm(mean) < 1e-6:  # it acts all around
        mean = -np.asarray(part.normals)[:, 0, 0]
    return np.asarray(mean / np.linalg.norm(mean))


def _bolt_marks(structure: Structure) -> Iterator[Mark]:
    """Mark of each clamping bolt with its axis, and of each of a joint's pressure with circles."""
    for number, clamp in enumerate(structure.bolts):
        names = [name for _, name in clamp.surfaces]
        cells = np.vstack([_surface(structure, name) for name in names])
        axis = np.array([structure.body.even_shares(name) @ structure.nodes for name in names])
        where = " to ".join(names) if len(names) > 1 else f"{names[0]} to the rigid base"
        text = (f"bolt {number + 1}\n{'cut ' if clamp.shank else ''}{where}\n"
                f"clamp force {_range(clamp.force, clamp.force, 'N')}")  # fmt: skip
        yield Mark("bolt", f"bolt[{number}]", text, axis[0], np.unique(cells), cells, lines=(axis,))
    turn = np.linspace(0.0, 2.0 * np.pi, 73)
    circle = np.stack([np.cos(turn), np.sin(turn)], axis=1)
    for joint in structure.joints:
        bolts = joint.pressure.bolts if isinstance(joint.pressure, Bolts) else ()
        for number, bolt in enumerate(bolts):
            at = np.asarray(bolt.at, dtype=float)[: structure.dim]
            text = f"bolt {number + 1} of {joint.name}\nforce {_range(bolt.force, bolt.force, 'N')}"
            rings = [radius * circle for radius in (bolt.head_radius, bolt.hole_radius)]
            lines = tuple(at + np.pad(ring, ((0, 0), (0, structure.dim - 2))) for ring in rings
                          if structure.dim > 1)  # fmt: skip
            yield Mark("bolt", f"{joint.name}.bolts[{number}]", text, at, _NO_NODES, _NO_CELLS,
                       lines=lines)  # fmt: skip
