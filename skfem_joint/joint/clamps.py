"""Clamping bolts: their description, the forces that they exert, and checks of both."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy import sparse

from skfem_joint.body.body import Body
from skfem_joint.body.checks import body_label, both_faces, wrong_name
from skfem_joint.body.nodes import interpolation
from skfem_joint.ground.arrays import BoolArray, FloatArray
from skfem_joint.ground.errors import InputError
from skfem_joint.ground.values import POSITIVE, problems
from skfem_joint.joint.joints import PRELOAD, Joint
from skfem_joint.mesh import NamedMesh
from skfem_joint.system.slips import SlipRows
from skfem_joint.system.unknowns import selection

#: Least cosine between directions that count as parallel: of a clamp force and the normals of its
#: surfaces, and of the normal of a face and the way to the opposite face.
PARALLEL = 0.7


@dataclass(frozen=True)
class Clamp:
    """A bolt that presses joints with ``pressure = "preload"``.

    The force is spread evenly over two surfaces and acts along the line between their middles. The
    surfaces are those under head and nut, which the bolt presses. Of a bolt that is meshed itself
    they are both faces of a cut through its shank, which the force pulls together; afterwards they
    do not move against each other.

    Attributes
    ----------
    force : float
        Clamp force, N.
    head, nut : str, optional
        Boundaries. Without a nut the bolt is screwed into the rigid base.
    shank : tuple of str, optional
        Both boundaries of the cut.
    """

    force: float
    head: str | None = None
    nut: str | None = None
    shank: tuple[str, str] | None = None

    @property
    def surfaces(self) -> tuple[tuple[str, str], ...]:
        """Key and name of each surface on which the force acts."""
        if self.shank is not None:
            return tuple(("shank", name) for name in self.shank)
        return tuple((k, v) for k in ("head", "nut") if (v := getattr(self, k)) is not None)


def clamp_problems(
    mesh: NamedMesh, joints: Sequence[Joint], bolts: Sequence[Clamp]
) -> Iterator[str]:
    """What is wrong with clamping bolts, and with the joints that they press."""
    pressed = [joint for joint in joints if joint.pressure == PRELOAD]
    for joint in pressed:
        if not bolts:
            yield f"{joint.label}: pressure: found {PRELOAD!r}, but no bolt presses it"
        if joint.on in mesh.regions:
            yield f"{joint.label}: pressure: found {PRELOAD!r}; it needs a boundary, not a region"
        if joint.normal_force != "consistent":
            yield f"{joint.label}: normal_force: found 'equal' beside {PRELOAD!r}; leave it out"
    if bolts and not pressed:
        yield f"bolt: found {len(bolts)}, but no joint with pressure = {PRELOAD!r}; give one"
    for number, bolt in enumerate(bolts):
        where = f"bolt[{number}]"
        yield from problems(f"{where}.force", bolt.force, POSITIVE)
        if (bolt.head is None) == (bolt.shank is None) or (bolt.shank and bolt.nut is not None):
            yield (
                f"{where}: must have head (and nut, unless it is screwed into the rigid base), or "
                "shank alone"
            )
            continue
        wrong: list[str] = []
        for key, name in bolt.surfaces:
            missing = wrong_name(mesh, name, ("boundary",), f"{where}.{key}")
            wrong += missing or both_faces(mesh, name, f"{where}.{key}")
        yield from wrong or (_off_path(mesh, bolt, where, pressed) if pressed else ())


def _off_path(mesh: NamedMesh, bolt: Clamp, where: str, joints: Sequence[Joint]) -> Iterator[str]:
    """Refuse a clamp force whose path does not go through a joint that it presses."""

    def body(name: str | None) -> int:  # -1: the rigid base
        return -1 if name is None else int(mesh.body[mesh.mesh.f2t[0, mesh.boundaries[name][0]]])

    bounds = mesh.boundaries
    links = [(body(j.on), body(j.against)) for j in joints
             if j.on in bounds and (j.against is None or j.against in bounds)]  # fmt: skip
    start, end = (*(body(name) for _, name in bolt.surfaces), -1)[:2]
    reached = {start}
    for _ in links:
        reached |= {b for link in links if reached & set(link) for b in link}
    if start == end or end not in reached:
        ends = [body_label(mesh, i) if i >= 0 else "the rigid base" for i in (start, end)]
        names = ", ".join(repr(joint.on) for joint in joints)
        how = " and ".join(f"{key} {name!r}" for key, name in bolt.surfaces)
        yield (
            f"{where}: its force, between {how}, does not go through a joint with pressure = "
            f"{PRELOAD!r} ({names}): it acts from {ends[0]} on {ends[1]}; must be surfaces of the "
            "bodies that these joints connect"
        )


class ClampLine(NamedTuple):
    """The line along which a bolt pulls.

    Attributes
    ----------
    shares : list of ndarray, shape (N,)
        Share of each node in the force on each of its surfaces.
    outwards : list of ndarray, shape (dim,)
        Mean outward normal of each surface.
    middle : ndarray, shape (dim,)
        Middle of the first surface, m.
    along : ndarray, shape (dim,)
        Unit vector along the line; zero where both middles are one point.
    """

    shares: list[FloatArray]
    outwards: list[FloatArray]
    middle: FloatArray
    along: FloatArray


def clamp_line(body: Body, bolt: Clamp) -> ClampLine:
    """Line of a bolt: through the middles of its surfaces, or along the normal of a single one."""
    shares = [body.even_shares(name) for _, name in bolt.surfaces]
    middles = [share @ body.nodes for share in shares]
    outwards = []
    for _, name in bolt.surfaces:
        part = body.facet_basis(body.mesh.boundaries[name])
        outwards.append(np.einsum("dfq,fq->d", part.normals, part.dx) / part.dx.sum())
    line = middles[1] - middles[0] if len(middles) == 2 else -outwards[0]
    if np.linalg.norm(line) < 1e-6 * body.size and bolt.shank:
        line = outwards[0]
    size = float(np.linalg.norm(line))
    return ClampLine(shares, outwards, middles[0], line / size if size else line)


def clamp_forces(body: Body, bolt: Clamp, where: str) -> FloatArray:
    """Forces (N, dim) of a bolt, N: opposite on both surfaces, along the line of their middles."""
    shares, outwards, _, e = clamp_line(body, bolt)
    pulls = 1.0 if bolt.shank else -1.0
    for sign, (key, name), normal in zip((1.0, -1.0), bolt.surfaces, outwards, strict=False):
        if sign * pulls * (normal @ e) < PARALLEL:
            what = "pull the faces of the cut together" if bolt.shank else "press"
            raise InputError(
                f"{where}.{key}: a force along the line between the middles of its surfaces, "
                f"({', '.join(f'{x:.4g}' for x in e)}), does not {what} at {name!r}, whose "
                f"outward normal is ({', '.join(f'{x:.4g}' for x in normal)}); are the surfaces "
                "those of one bolt, and flat?"
            )
    signed = sum(sign * share for sign, share in zip((1.0, -1.0), shares, strict=False))
    return np.asarray(bolt.force * np.outer(signed, e))


def unit_clamps(body: Body, bolts: Sequence[Clamp]) -> sparse.csr_array:
    """Forces of each bolt on the nodes for a clamp force of 1 N, (dim N, bolts)."""
    units = (
        clamp_forces(body, replace(bolt, force=1.0), f"bolt[{i}]").ravel()
        for i, bolt in enumerate(bolts)
    )
    return sparse.csr_array(np.stack([*units], axis=1))


def cuts(body: Body, held: BoolArray, bolts: Sequence[Clamp]) -> SlipRows:
    """Rows that join the two faces of each cut shank, for the vibration after tightening.

    ``held`` (N, dim) are the displacements that supports hold.

    Raises
    ------
    InputError
        If the faces of a cut do not lie on each other.
    """
    dim, n = body.dim, body.n_nodes
    rows = none = SlipRows.none(dim * n)
    for number, bolt in enumerate(bolts):
        if bolt.shank is None:
            continue
        first, second = bolt.shank
        nodes = body.nodes_of(first)
        values, apart = interpolation(body, second, body.nodes[nodes])
        if apart.any():
            raise InputError(
                f"bolt[{number}].shank: {np.count_nonzero(apart)} of {nodes.size} nodes of "
                f"{first!r} do not lie on {second!r}, the farthest by {apart.max():.3g} m; "
                "both must be the faces of one cut"
            )
        moves = np.flatnonzero(~held[nodes].ravel())
        apart_by = sparse.kron(selection(nodes, n) - values, sparse.eye_array(dim), "csr")
        pivots = (dim * nodes[:, np.newaxis] + np.arange(dim)).ravel()
        rows += replace(none, closed=apart_by[moves], pivots=pivots[moves], clamped=None)
    return rows
