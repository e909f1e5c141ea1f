"""Joints as users describe them, and checks that need no nodes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from skfem_joint.body.checks import both_faces, one_of, overlap, wrong_name
from skfem_joint.ground.arrays import IntArray
from skfem_joint.ground.values import BETA, NOT_NEGATIVE, STIFFNESS, problems
from skfem_joint.joint.gaps import Gap, is_surface, surfaces
from skfem_joint.joint.pressure import Bolts, Pressure, PressureTable
from skfem_joint.mesh import NamedMesh

#: Value of ``Joint.pressure`` where clamping bolts press the joint.
PRELOAD = "preload"


@dataclass(frozen=True)
class Joint:
    """A part of a body pressed on a rigid base or on another body.

    Contact points are the nodes that the pressure reaches; elsewhere there is no contact.

    Attributes
    ----------
    on : str
        Region (friction over an area, or along a bar) or boundary that is pressed.
    pressure : float, PressureTable, Bolts or "preload"
        Pa; with "preload" the clamping bolts of the structure determine the pressure.
    friction : float
        Coefficient of friction.
    against : str, optional
        Region or boundary of another body; a rigid base if not given.
    beta : float
        Steepness of the arctan law, s/m; ``inf``, the default, is Coulomb's law.
    normal_force : {"consistent", "equal"}
        Nodal forces are integrals of pressure times hat function, which converge with the square
        of the element size; or, as in the paper, the total force divided equally among the nodes
        that can slip, which converge with the element size.
    contact : {"constant", "unilateral"}
        Whether the normal force stays as it is at rest and the contact closed; or follows the
        motion, and the contact opens and closes wherever the faces meet. The latter needs a
        boundary, in two dimensions or three; without a ``pressure`` (0) it is not pressed at rest.
    gap : float, callable, Scan, NodeField, or sequence of the latter three
        Distance by which the faces are apart at rest, m, beside that of the mesh; of several their
        sum. A callable gets places (k, dim), m, and returns the gaps there, (k,). It needs contact
        that opens, or ``pressure = "preload"``.
    gap_scale : float
        Factor on the gap, from 0 on.
    remove_plane : bool
        Whether the plane that fits a gap best over the face is taken out of it; the faces then
        touch at the contact point where they are nearest to each other.
    normal_stiffness : float
        Of contact that opens, Pa/m; rigid if ``inf``.
    axis : tuple of float, optional
        Direction along which the paper's scaled modes are stretched over the active length
        (``reference = "paper"``); in one dimension the bar itself.
    tangential_stiffness : float
        Of the surfaces against slip, in series with friction, Pa/m; ``inf``, the default, is none:
        surfaces are as stiff as the mesh makes them.
    """

    on: str
    pressure: Pressure | str
    friction: float
    against: str | None = None
    beta: float = np.inf
    normal_force: str = "consistent"
    axis: tuple[float, ...] | None = None
    tangential_stiffness: float = np.inf
    contact: str = "constant"
    gap: Gap = 0.0
    normal_stiffness: float = np.inf
    gap_scale: float = 1.0
    remove_plane: bool = False

    @property
    def opens(self) -> bool:
        """Whether contact opens and closes."""
        return self.contact == "unilateral"

    @property
    def has_gap(self) -> bool:
        """Whether a gap is given, beside that of the mesh."""
        return bool(surfaces(self.gap)) or self.gap != 0.0

    @property
    def pressed_by_bolts(self) -> bool:
        """Whether the static solution under clamping bolts, if there are any, says its pressure."""
        without = isinstance(self.pressure, int | float) and self.pressure == 0.0
        return self.pressure == PRELOAD or (self.opens and without)

    @property
    def name(self) -> str:
        """Name of the joint: the name of the pressed part."""
        return self.on

    @property
    def label(self) -> str:
        """The joint in a message."""
        return f"joint {self.on!r}"


def joint_value_problems(joint: Joint) -> Iterator[str]:
    """What is wrong with the numbers and words of a joint."""
    yield from problems(f"{joint.label}: friction", joint.friction, NOT_NEGATIVE)
    yield from problems(f"{joint.label}: beta", joint.beta, BETA)
    stiffness = f"{joint.label}: tangential_stiffness", joint.tangential_stiffness
    yield from problems(*stiffness, STIFFNESS)
    yield from one_of(f"{joint.label}: normal_force", joint.normal_force, ("consistent", "equal"))
    yield from one_of(f"{joint.label}: contact", joint.contact, ("constant", "unilateral"))
    yield from _gap_problems(joint)
    yield from problems(f"{joint.label}: normal_stiffness", joint.normal_stiffness, BETA)
    if joint.opens and joint.normal_force != "consistent":
        yield (
            f"{joint.label}: normal_force: found {joint.normal_force!r} beside contact = "
            "'unilateral', must be 'consistent'"
        )
    if not joint.opens and np.isfinite(joint.normal_stiffness):
        yield (
            f"{joint.label}: found normal_stiffness, which needs contact = 'unilateral': give it, "
            "or leave this out"
        )
    pressure = joint.pressure
    if isinstance(pressure, str) and pressure != PRELOAD:
        yield f"{joint.label}: pressure: found {pressure!r}, must be in Pa, or {PRELOAD!r}"
    elif not isinstance(pressure, PressureTable | Bolts | str):
        yield from problems(f"{joint.label}: pressure", pressure, NOT_NEGATIVE)


def _gap_problems(joint: Joint) -> Iterator[str]:
    """What is wrong with the gap of a joint."""
    several = isinstance(joint.gap, Sequence) and not isinstance(joint.gap, str)
    parts = surfaces(joint.gap) if several else (joint.gap,)
    if not all(map(is_surface, parts)):
        if several or isinstance(joint.gap, str):
            yield (
                f"{joint.label}: gap: found {joint.gap!r}, must be a number in m, a function of "
                "places, a Scan (read_scan reads its file), a NodeField, or a list of these"
            )
            return
        yield from problems(f"{joint.label}: gap", joint.gap, NOT_NEGATIVE)
        if joint.remove_plane:
            yield (
                f"{joint.label}: remove_plane: found true beside a gap that is a number, which has "
                "no plane; leave it out"
            )
    yield from problems(f"{joint.label}: gap_scale", joint.gap_scale, NOT_NEGATIVE)
    if joint.has_gap and not joint.opens and joint.pressure != PRELOAD:
        yield (
            f"{joint.label}: found a gap, which needs contact = 'unilateral', or pressure = "
            f"{PRELOAD!r}, by which bolts close it: give one of them, or leave the gap out"
        )


def joint_problems(mesh: NamedMesh, joints: Sequence[Joint]) -> Iterator[str]:
    """What is wrong with joints on a mesh, without regard to their nodes."""
    outer = mesh.mesh.boundary_facets()
    allowed = {1: ("region",), 2: ("region", "boundary"), 3: ("boundary",)}[mesh.dim]
    earlier: dict[str, list[Joint]] = {"region": [], "boundary": []}
    for joint in joints:
        where = joint.label
        yield from joint_value_problems(joint)
        kind = "region" if joint.on in mesh.regions else "boundary"
        wrong = wrong_name(mesh, joint.on, allowed, f"{where}.on")
        if not wrong and joint.against is not None:
            wrong = wrong_name(mesh, joint.against, (kind,), f"{where}.against")
        if wrong:
            yield from wrong
            continue
        table = mesh.regions if kind == "region" else mesh.boundaries
        names = [name for name in (joint.on, joint.against) if name is not None]
        parts = [table[name] for name in names]
        if joint.opens and (kind == "region" or mesh.dim == 1):
            yield (
                f"{where}: contact = 'unilateral' needs a boundary, in two dimensions or three; "
                "what lies on its base over a region stays on it"
            )
        if kind == "boundary" and not all(np.isin(part, outer).all() for part in parts):
            yield f"{where}: it runs inside a body; a joint must be on its border"
        both = [p for name in dict.fromkeys(names) for p in both_faces(mesh, name, where)]
        yield from both
        elements = [part if kind == "region" else mesh.mesh.f2t[0, part] for part in parts]
        if len(parts) == 2 and not both and overlap(*(mesh.body[e] for e in elements)):
            yield (
                f"{where}: {joint.on!r} and {joint.against!r} belong to the same body; a joint "
                "presses two bodies on each other, meshed apart from each other"
            )
        others = sorted({repr(j.on) for j in earlier[kind] if overlap(table[j.on], parts[0])})
        if others:
            yield f"{where} overlaps joint {', '.join(others)}; joints must not overlap"
        if kind == "boundary":
            yield from _touching_twice(mesh, joint, earlier[kind])
        earlier[kind].append(joint)
        if isinstance(joint.pressure, PressureTable):
            corners = mesh.mesh.t if kind == "region" else mesh.mesh.facets
            yield from _table_covers(mesh, joint.pressure, corners[:, parts[0]].ravel(), where)


def _touching_twice(mesh: NamedMesh, joint: Joint, earlier: Sequence[Joint]) -> Iterator[str]:
    """Refuse a face that two joints use: a face can touch only a single body or base."""
    table = mesh.boundaries
    for other in earlier:
        crossed = (other.on, joint.against), (other.against, joint.on)
        if any(a and b and overlap(table[a], table[b]) for a, b in crossed):
            yield (
                f"{joint.label}: it lies on a part of {other.label}, by this or another name; "
                "a face touches one thing: leave one of the joints out, or split the face"
            )


def _table_covers(
    mesh: NamedMesh, table: PressureTable, vertices: IntArray, where: str
) -> Iterator[str]:
    """Refuse a table of pressures that does not reach over the whole joint with these vertices."""
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
