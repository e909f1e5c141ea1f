"""Preload: the pressure that clamping bolts give to joints, from a static contact solve.

Clamp forces act as equal and opposite loads. Contact is frictionless and unilateral: with the
pressure p and the gap g = g0 - n . (u - u_other) of each pressed face,

    minimise 1/2 u K u - f u    with    g >= 0,    then    p >= 0,    p g = 0.

The pressure is spanned by the linear hats of the sub-cells between the displacement nodes, and the
gap is closed in the mean over each hat (mortar method; Wohlmuth, Acta Numerica 20, 2011). Its
forces are consistent with the elements, so that an even pressure stays even in those of second
order too, whose nodal forces would have other signs. On faces that do not match, both bodies are
evaluated at the same points of integration: forces and moments balance to round-off. Which nodes
touch is found by a primal-dual active set (Hintermueller, Ito, Kunisch, SIAM J. Optim. 13, 2002).
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
from scipy import linalg, sparse

from skfem_joint.arrays import BoolArray, FloatArray, IntArray, Matrix
from skfem_joint.errors import ConvergenceError, InputError
from skfem_joint.linalg.schur import Uncondensed, condensed
from skfem_joint.structure.checks import (
    body_label,
    body_motions,
    left_loose,
    positive,
    wrong_name,
)
from skfem_joint.structure.contact import along
from skfem_joint.structure.nodes import feet, interpolation, values_in
from skfem_joint.structure.patch import PRELOAD, Joint, Pressed, manifold_of, unit_vectors
from skfem_joint.structure.pressure import hat_simplices, measure
from skfem_joint.unknowns import Contact, selection, stacked

if TYPE_CHECKING:
    from skfem_joint.structure.structure import Structure

#: Cosine with the normal from which another face counts as opposite; parts of the size that are 0.
_OPPOSITE, _NO_GAP = 0.7, 1e-9
#: Stiffness of closed contact over that of the elements, which multipliers then make exact, and
#: share of the mass that keeps bodies in place while too few nodes touch.
_STIFF, _SHIFT = 1e5, 1e-10
#: Most unknowns that the stiffness is condensed to, and their contact made dense (0.2 GB).
_CONDENSED = 5000
#: Active sets that are tried; corrections of one solution, and what of the load may be left.
_SETS, _CORRECTIONS, _LEFT = 100, 20, 1e-9
#: Share of the clamp forces that may push bodies where friction alone holds them: that of meshes
#: whose surfaces are not quite opposite.
_OFF = 0.01
#: Pressures and penetrations below these parts of the largest are round-off.
_ROUND_OFF = 1e-8


@dataclass(frozen=True)
class Clamp:
    """A bolt that presses joints with ``pressure = "preload"``.

    The force acts evenly on two surfaces, along the line between their middles. Either those
    under head and nut, which it presses; or, of a bolt that is meshed itself, both faces of a cut
    through its shank, which it pulls together and which do not move against each other afterwards.

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
        """Key and name of each surface that it acts on."""
        if self.shank is not None:
            return tuple(("shank", name) for name in self.shank)
        return tuple((k, v) for k in ("head", "nut") if (v := getattr(self, k)) is not None)


@dataclass(frozen=True)
class Preload:
    """What clamp forces do to a structure at rest."""

    displacement: FloatArray  #: (N, dim), m; rigid motions that nothing determines are left out
    force: FloatArray  #: (N, dim), clamp forces, N
    joints: tuple[Pressed | None, ...]  #: of each joint; None where its pressure is given
    active_sets: int  #: sets of touching nodes that were tried
    seconds: float  #: time that it took, s


def clamp_problems(structure: Structure) -> Iterator[str]:
    """What is wrong with clamping bolts, and with joints that they press."""
    mesh, bolts = structure.mesh, structure.bolts
    pressed = [joint for joint in structure.joints if joint.pressure == PRELOAD]
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
        yield from positive(f"{where}.force", bolt.force)
        if (bolt.head is None) == (bolt.shank is None) or (bolt.shank and bolt.nut is not None):
            yield (
                f"{where}: must have head (and nut, unless it is screwed into the rigid base), or "
                "shank alone"
            )
            continue
        problems = []
        for key, name in bolt.surfaces:
            problems += wrong_name(mesh, name, ("boundary",), f"{where}.{key}")
        yield from problems or (_off_path(structure, bolt, where, pressed) if pressed else ())


def _off_path(
    structure: Structure, bolt: Clamp, where: str, joints: Sequence[Joint]
) -> Iterator[str]:
    """Whether a clamp force does not go through a joint that is pressed by it."""
    mesh = structure.mesh

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


def preload(structure: Structure) -> Preload:
    """Pressures of the joints that clamping bolts press, by a static frictionless contact solve.

    A gap between the faces at the beginning is that of the mesh, along the shortest way from the
    pressed face to the other one, as far as elements are long; nodes that find nothing there are
    never in contact. Joints whose pressure is given stay closed. Body motions that neither supports
    nor contact determine do not matter, as clamp forces are in equilibrium by themselves.

    Raises
    ------
    InputError
        If a clamp force pulls, pushes a body away, or leaves a joint without contact.
    ConvergenceError
        If the touching nodes are not found.
    """
    begin, (_, K) = time.perf_counter(), structure.matrices()
    clamps = (_clamping(structure, b, f"bolt[{i}]") for i, b in enumerate(structure.bolts))
    force = np.sum([*clamps], axis=0)
    every = ((i, _Face.of(structure, joint)) for i, joint in enumerate(structure.joints))
    faces = {i: face for i, face in every if face is not None}
    G = stacked([face.rows for face in faces.values()], force.size)
    area, gap, tied = (
        np.concatenate([getattr(face, name) for face in faces.values()])
        for name in ("area", "gap", "tied")
    )
    free, left_out = _moving(structure, G, area, force)
    u = np.zeros(force.size)
    solver = _Solver(K[free][:, free], G[:, free], area, gap, tied, force.ravel()[free])
    u[free], p, count = solver.solve()
    u -= left_out @ linalg.lstsq(left_out, u)[0]
    left = (gap - G @ u) / area
    touching = p > _ROUND_OFF * p.max(initial=0.0)
    ends = np.cumsum([face.nodes.size for face in faces.values()])[:-1]
    parts = zip(faces.items(), *(np.split(x, ends) for x in (p, left, touching)), strict=True)
    found: list[Pressed | None] = [None] * len(structure.joints)
    for (i, face), *values in parts:
        if not face.tied.any():
            found[i] = face.pressed(structure, *values)
    return Preload(u.reshape(force.shape), force, tuple(found), count, time.perf_counter() - begin)


def _clamping(structure: Structure, bolt: Clamp, where: str) -> FloatArray:
    """Forces (N, dim) of a bolt, N: opposite on both surfaces, along the line of their middles."""
    shares = [structure.even_shares(name) for _, name in bolt.surfaces]
    middles = [share @ structure.nodes for share in shares]
    outwards = []
    for _, name in bolt.surfaces:
        part = structure.facet_basis(structure.mesh.boundaries[name])
        outwards.append(np.einsum("dfq,fq->d", part.normals, part.dx) / part.dx.sum())
    pulls = 1.0 if bolt.shank else -1.0
    line = middles[1] - middles[0] if len(middles) == 2 else -outwards[0]
    if np.linalg.norm(line) < 1e-6 * structure.size and bolt.shank:
        line = outwards[0]
    size = float(np.linalg.norm(line))
    e = line / size if size else line
    for sign, (key, name), normal in zip((1.0, -1.0), bolt.surfaces, outwards, strict=False):
        if sign * pulls * (normal @ e) < _OPPOSITE:
            what = "pull the faces of the cut together" if bolt.shank else "press"
            raise InputError(
                f"{where}.{key}: a force along the line between the middles of its surfaces, "
                f"({', '.join(f'{x:.4g}' for x in e)}), does not {what} at {name!r}, whose "
                f"outward normal is ({', '.join(f'{x:.4g}' for x in normal)}); are the surfaces "
                "those of one bolt, and flat?"
            )
    signed = sum(sign * share for sign, share in zip((1.0, -1.0), shares, strict=False))
    return np.asarray(bolt.force * np.outer(signed, e))


def cuts(structure: Structure) -> Contact:
    """Rows that hold both faces of each cut shank on each other, after they were pulled together.

    Raises
    ------
    InputError
        If the faces of a cut do not lie on each other.
    """
    dim, n = structure.dim, structure.n_nodes
    found = none = Contact.none(dim * n)
    for number, bolt in enumerate(structure.bolts):
        if bolt.shank is None:
            continue
        one, two = bolt.shank
        nodes = structure.nodes_of(one)
        values, apart = interpolation(structure, two, structure.nodes[nodes])
        if apart.any():
            raise InputError(
                f"bolt[{number}].shank: {np.count_nonzero(apart)} of {nodes.size} nodes of {one!r} "
                f"do not lie on {two!r}, the farthest by {apart.max():.3g} m; both must be the "
                "faces of one cut"
            )
        moves = np.flatnonzero(~structure.held[nodes].ravel())
        rows = sparse.kron(selection(nodes, n) - values, sparse.eye_array(dim), "csr")
        pivots = (dim * nodes[:, np.newaxis] + np.arange(dim)).ravel()
        found = found + replace(none, held=rows[moves], pivots=pivots[moves])
    return found


def _moving(
    structure: Structure, G: Matrix, area: FloatArray, force: FloatArray
) -> tuple[BoolArray, FloatArray]:
    """Displacements (dim N,) to be solved for, and motions (dim N, k) that nothing determines.

    Supports hold the others, and as many more as rigid motions are left by supports and closed
    contact: a statically determinate support, which a load in equilibrium gives no reaction.
    """
    motions = body_motions(structure)
    flat = motions.reshape(force.size, -1)
    loose = left_loose([motions[structure.held], (G @ flat) / area[:, np.newaxis]])
    free = ~structure.held.ravel()
    modes = flat @ loose
    if loose.shape[1]:
        push = force.ravel() @ modes
        if np.abs(push).max() > _OFF * np.abs(force).sum() * np.abs(modes).max():
            turned = np.abs(modes @ push).reshape(structure.n_nodes, -1).max(axis=1)
            body = int(structure.body[turned.argmax()])
            raise InputError(
                f"bolt: the clamp forces push {body_label(structure.mesh, body)} where neither a "
                "support nor contact holds it; head and nut must press straight across a joint"
            )
        modes[~free] = 0.0
        free[linalg.qr(modes.T, mode="r", pivoting=True)[1][: loose.shape[1]]] = False
    return free, modes


@dataclass(frozen=True)
class _Face:
    """The pressed face of a joint: what may touch the other body, or the base."""

    joint: Joint
    nodes: IntArray  # (m,), displacement nodes that lie over the other face
    rows: sparse.csr_array  # (m, dim N), integrals of hats times motion towards the other body
    area: FloatArray  # (m,), m2, of each hat as far as it lies over the other face
    gap: FloatArray  # (m,), m3, integrals of hats times the gap at the beginning
    other: sparse.csr_array | None  # (m, N), values of the other body opposite to the nodes

    @property
    def tied(self) -> BoolArray:
        """Whether it stays closed, as its pressure is given, (m,)."""
        return np.full(self.nodes.size, self.joint.pressure != PRELOAD)

    @staticmethod
    def of(structure: Structure, joint: Joint) -> _Face | None:
        """Face of a joint; None where cells lie on their base, across which nothing moves."""
        p, dim = structure.properties, structure.dim
        where = joint.label
        cells, beside, depth, normals = manifold_of(
            structure, joint.on, p["width"], p["thickness"], where
        )
        if normals is None:
            return None
        corners, gather, parent = hat_simplices(structure.nodes, cells)
        places, weights = _quadrature(corners.shape[1])
        x = np.einsum("qc,ncd->nqd", places, corners).reshape(-1, dim)
        points, count = np.arange(len(x)).reshape(len(corners), -1), corners.shape[1]
        corner = np.arange(corners.shape[0] * count).reshape(len(corners), 1, count)
        rows, columns, values = np.broadcast_arrays(corner, points[..., np.newaxis], places)
        entries = values.ravel(), (rows.ravel(), columns.ravel())
        hats = gather @ sparse.csr_array(entries, shape=(corner.size, len(x)))
        n, gap, values_there = _opposite(structure, joint, x, unit_vectors(hats.T @ normals))
        weight = np.outer(measure(corners) * depth[parent], weights).ravel()
        hats = sparse.csr_array(hats @ sparse.diags_array(np.where(np.isnan(gap), 0.0, weight)))
        own = np.unique(cells)
        _, beyond, other = _opposite(structure, joint, structure.nodes[own], normals[own])
        area = np.asarray(hats.sum(axis=1)).ravel()[own]
        over = ~np.isnan(beyond) & (area > 0.0)
        if not over.any():
            raise InputError(
                f"{where}: no node of it lies over {joint.against!r}, or as near as elements are "
                "long; are these the faces that touch?"
            )
        nodes, hats = own[over], hats[own[over]]
        own_element = np.repeat(beside[parent], points.shape[1])
        relative = values_in(structure, own_element, x, np.zeros(len(x)))[0]
        if values_there is not None:
            relative = relative - values_there
        motion = along(np.arange(len(x)), n, len(x)) @ sparse.kron(relative, sparse.eye_array(dim))
        other = None if other is None else sparse.csr_array(other[over])
        gap = hats @ np.nan_to_num(gap)
        return _Face(joint, nodes, sparse.csr_array(hats @ motion), area[over], gap, other)

    def pressed(
        self, structure: Structure, pressure: FloatArray, gap: FloatArray, touches: BoolArray
    ) -> Pressed:
        """What the joint gets, from values at the nodes."""
        if not touches.any():
            raise InputError(
                f"{self.joint.label}: the preload leaves no contact, it opens everywhere; do the "
                "bolts press elsewhere?"
            )
        at = selection(self.nodes, structure.n_nodes).T
        force = np.where(touches, pressure * self.area, 0.0)
        other = None if self.other is None else sparse.csr_array(at @ self.other)
        return Pressed(at @ force, at @ self.area, at @ gap, other)


def _quadrature(corners: int) -> tuple[FloatArray, FloatArray]:
    """Places (points, corners) in a segment or triangle, and weights that sum to 1.

    Exact for hats times the shapes of a quadrilateral of second order.
    """
    from skfem.quadrature import get_quadrature
    from skfem.refdom import RefLine, RefTri

    x, weights = get_quadrature(RefLine if corners == 2 else RefTri, 5)
    return np.vstack([1.0 - x.sum(axis=0), x]).T, weights / weights.sum()


def _opposite(
    structure: Structure, joint: Joint, x: FloatArray, normal: FloatArray
) -> tuple[FloatArray, FloatArray, sparse.csr_array | None]:
    """Direction (k, dim) to the other face, gap (k,), m, and values (k, N) of the other body there.

    The gap is NaN where nothing is opposite.
    """
    if joint.against is None:
        return normal, np.zeros(len(x)), None
    facets = structure.mesh.boundaries[joint.on]
    ends = structure.mesh.mesh.p[:, structure.mesh.mesh.facets[:, facets]]
    element, foot = feet(structure, joint.against, x, float(np.ptp(ends, axis=1).max()))
    way = foot - x
    distance = np.linalg.norm(way, axis=1)
    signed = np.einsum("kd,kd->k", way, normal)
    apart = distance > _NO_GAP * structure.size
    opposite = np.abs(signed) > _OPPOSITE * distance
    n = np.where((apart & opposite)[:, np.newaxis], np.sign(signed)[:, None] * unit_vectors(way),
                 normal)  # fmt: skip
    gap = np.where(apart, np.where(opposite, np.sign(signed) * distance, np.nan), 0.0)
    none = np.isnan(distance)
    gap[none] = np.nan
    return n, gap, values_in(structure, element, foot, np.where(none, np.inf, 0.0))[0]


@dataclass(frozen=True)
class _Solver:
    """Minimum of ``1/2 u K u - f u`` with ``G u <= gap``, or ``= gap`` where tied."""

    K: Matrix
    G: Matrix
    area: FloatArray
    gap: FloatArray
    tied: BoolArray
    force: FloatArray

    @cached_property
    def penalty(self) -> FloatArray:
        """Stiffness of closed contact, Pa/m3."""
        size = abs(self.G)
        mean = np.asarray(size @ self.K.diagonal()) / np.asarray(size.sum(axis=1)).ravel()
        return np.asarray(_STIFF * mean / self.area**2)

    @cached_property
    def _open(self) -> Uncondensed:
        """The stiffness with contact open, which moves few unknowns where it is closed."""
        K = sparse.csr_array(self.K + _SHIFT * sparse.diags_array(self.K.diagonal()))
        return condensed(K, np.unique(self.G.indices), _CONDENSED)

    def solve(self) -> tuple[FloatArray, FloatArray, int]:
        """Displacement (m), pressure (Pa), and how many sets of touching nodes were tried."""
        active = np.ones(self.area.size, dtype=bool)
        u, p = np.zeros(self.force.size), np.zeros(self.area.size)
        seen: set[bytes] = set()
        for count in range(1, _SETS + 1):
            u, p, left = self._with_closed(active, u, np.where(active, p, 0.0))
            opening = self.gap - self.G @ u
            moved = self.area * max(np.abs(u).max(), np.abs(self.gap / self.area).max())
            pulls = active & ~self.tied & (p < -_ROUND_OFF * np.abs(p).max())
            enters = ~active & (opening < -_ROUND_OFF * moved)
            wrong = np.flatnonzero(pulls | enters)
            if not wrong.size and left < _LEFT:
                return u, np.maximum(p, 0.0), count
            if not wrong.size:
                raise ConvergenceError(
                    f"preload: a share of {left:.2g} of the clamp forces is left out of balance; "
                    "do supports and contact hold every body?"
                )
            # A set that comes again is left by one node at a time (Murty, Opsearch 11, 1974).
            flipped = wrong[-1:] if active.tobytes() in seen else wrong
            seen.add(active.tobytes())
            active[flipped] ^= True
        raise ConvergenceError(
            f"preload: the nodes that touch were not found in {_SETS} tries; {wrong.size} of "
            f"{self.area.size} still change; refine the mesh of the pressed faces, or see whether "
            "bodies are held"
        )

    def _with_closed(
        self, active: BoolArray, u: FloatArray, p: FloatArray
    ) -> tuple[FloatArray, FloatArray, float]:
        """Displacement and pressure where some contact is closed, and share of forces that is left.

        The residual is corrected by the factor of an augmented Lagrangian.
        """
        G, penalty, gap = self.G[active], self.penalty[active], self.gap[active]
        solve = self._open.solver(G.T @ sparse.diags_array(penalty) @ G)
        p, last = p[active], np.inf
        for _ in range(_CORRECTIONS):
            r, apart = self.force - self.K @ u - G.T @ p, gap - G @ u
            left = float(np.abs(r).max() / np.abs(self.force).max())
            if apart.size and u.any():
                left += float(np.abs(apart / self.area[active]).max() / np.abs(u).max())
            if left > 0.5 * last and left < _LEFT:
                break
            last = min(last, left)
            du = solve(r + G.T @ (penalty * apart))
            u, p = u + du, p + penalty * (G @ du - apart)
        whole = np.zeros(active.size)
        whole[active] = p
        return u, whole, left
