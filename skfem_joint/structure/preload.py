"""Preload: the pressure that clamping bolts give to joints, from a static contact problem.

Clamp forces act as equal and opposite loads. Contact is frictionless and unilateral: with the
pressure p and the gap g = g0 - n . (u - u_other) of each pressed face, the displacement is

    argmin 1/2 u K u - f u    with    g >= 0,    and then    p >= 0,    p g = 0.

The pressure is a sum of the linear hats of the sub-cells between the displacement nodes, and the
gap is closed in the mean over each hat (mortar method; Wohlmuth, Acta Numerica 20, 2011). Its
forces are consistent with the elements: an even pressure stays even, also in elements of second
order, whose nodal forces would have other signs. On faces whose meshes do not match, both bodies
are evaluated at the same quadrature points, so that forces and moments balance to round-off. A
primal-dual active set method finds the nodes that touch (Hintermueller, Ito, Kunisch, SIAM J.
Optim. 13, 2002).
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy import linalg, sparse

from skfem_joint.arrays import BoolArray, FloatArray, IntArray, Matrix
from skfem_joint.errors import ConvergenceError, InputError
from skfem_joint.linalg.schur import Uncondensed, condensed
from skfem_joint.mesh import NamedMesh
from skfem_joint.slips import SlipRows, rows_along, unit_vectors
from skfem_joint.structure.body import Body
from skfem_joint.structure.checks import wrong_name
from skfem_joint.structure.joints import PRELOAD, Joint
from skfem_joint.structure.nodes import feet, interpolation, values_in
from skfem_joint.structure.patch import Pressed, manifold_of
from skfem_joint.structure.pressure import hat_simplices, measure
from skfem_joint.structure.rigid import body_label, body_motions, combinations_left_free
from skfem_joint.unknowns import selection, stacked
from skfem_joint.values import POSITIVE, problems


@dataclass(frozen=True)
class PreloadSettings:
    """Numbers of the contact solve.

    Attributes
    ----------
    opposite : float
        Cosine with the normal from which on another face counts as opposite.
    no_gap : float
        Distances below this part of the structure's size are zero.
    stiffness : float
        Stiffness of closed contact over that of the elements. It speeds up the iteration for the
        multipliers, which make contact exactly rigid.
    shift : float
        Part of the stiffness' diagonal that is added to its factors, so that they exist while too
        few nodes touch to hold every body.
    largest_schur : int
        Unknowns up to which the stiffness is condensed to those in contact; their Schur complement
        is dense (0.2 GB at 5000).
    active_sets : int
        Sets of touching nodes that are tried.
    corrections : int
        Iterative corrections of one solution.
    tolerance : float
        Share of the clamp forces that may be left out of balance.
    loose_push : float
        Share of the clamp forces that may push bodies where friction alone holds them. Meshes
        whose surfaces are not quite opposite need some.
    round_off : float
        Pressures and penetrations below this part of the largest are zero.
    """

    opposite: float = 0.7
    no_gap: float = 1e-9
    stiffness: float = 1e5
    shift: float = 1e-10
    largest_schur: int = 5000
    active_sets: int = 100
    corrections: int = 20
    tolerance: float = 1e-9
    loose_push: float = 0.01
    round_off: float = 1e-8


SETTINGS = PreloadSettings()


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


@dataclass(frozen=True)
class Preload:
    """Static solution of a structure under its clamp forces.

    Attributes
    ----------
    displacement : ndarray, shape (N, dim)
        m; without the rigid motions that neither supports nor contact determine.
    force : ndarray, shape (N, dim)
        Clamp forces, N.
    joints : tuple of Pressed or None
        Normal forces of each joint; None where its pressure is given.
    active_sets : int
        Sets of touching nodes that were tried.
    seconds : float
        Duration of the computation, s.
    """

    displacement: FloatArray
    force: FloatArray
    joints: tuple[Pressed | None, ...]
    active_sets: int
    seconds: float

    def sentences(self, joints: Sequence[Joint], bolts: Sequence[Clamp]) -> Iterator[str]:
        """What a description says about the preload of these joints by these bolts."""
        moved = float(np.linalg.norm(self.displacement, axis=1).max())
        yield (
            f"Preload by {len(bolts)} bolts, at rest and without friction: contact found in "
            f"{self.active_sets} steps and {self.seconds:.3g} s, largest displacement "
            f"{moved:.4g} m."
        )
        for joint, pressed in zip(joints, self.joints, strict=True):
            if pressed is not None:
                touches, area = pressed.force > 0.0, float(pressed.area.sum())
                touching = float(pressed.area[touches].sum())
                peak = float((pressed.force[touches] / pressed.area[touches]).max())
                yield (
                    f"Joint {joint.name} is pressed by {pressed.force.sum():.6g} N: "
                    f"{touching:.4g} of {area:.4g} m2 touch, {100.0 * touching / area:.3g} %; "
                    f"peak pressure {peak:.4g} Pa, mean of what touches "
                    f"{pressed.force.sum() / touching:.4g} Pa, largest gap "
                    f"{pressed.gap.max():.3g} m."
                )


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
        wrong = []
        for key, name in bolt.surfaces:
            wrong += wrong_name(mesh, name, ("boundary",), f"{where}.{key}")
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


def preload(
    body: Body, held: BoolArray, joints: Sequence[Joint], bolts: Sequence[Clamp]
) -> Preload:
    """Pressures of the joints that clamping bolts press, by a static frictionless contact problem.

    The initial gap between the faces is that of the mesh, along the shortest way from the pressed
    face to the other one, and at most as long as elements are; nodes that find nothing there never
    touch. Joints whose pressure is given stay closed. Rigid motions that neither supports nor
    contact determine do not matter, because clamp forces are in equilibrium by themselves.

    Parameters
    ----------
    body : Body
    held : ndarray of bool, shape (N, dim)
        Displacements that supports hold.
    joints : sequence of Joint
    bolts : sequence of Clamp

    Raises
    ------
    InputError
        If a clamp force pulls, pushes a body away, or leaves a joint without contact.
    ConvergenceError
        If the touching nodes are not found.
    """
    begin, (_, K) = time.perf_counter(), body.matrices()
    clamps = (_clamping(body, bolt, f"bolt[{i}]") for i, bolt in enumerate(bolts))
    force = np.sum([*clamps], axis=0)
    every = ((i, _Face.of(body, joint)) for i, joint in enumerate(joints))
    faces = {i: face for i, face in every if face is not None}
    G = stacked([face.rows for face in faces.values()], force.size)
    area, gap, tied = (
        np.concatenate([getattr(face, name) for face in faces.values()])
        for name in ("area", "gap", "tied")
    )
    free, left_out = _moving(body, held, G, area, force)
    u = np.zeros(force.size)
    solver = _Solver(K[free][:, free], G[:, free], area, gap, tied, force.ravel()[free])
    u[free], p, count = solver.solve()
    u -= left_out @ linalg.lstsq(left_out, u)[0]
    left = (gap - G @ u) / area
    touching = p > SETTINGS.round_off * p.max(initial=0.0)
    ends = np.cumsum([face.nodes.size for face in faces.values()])[:-1]
    parts = zip(faces.items(), *(np.split(x, ends) for x in (p, left, touching)), strict=True)
    pressed: list[Pressed | None] = [None] * len(joints)
    for (i, face), *values in parts:
        if not face.tied.any():
            pressed[i] = face.pressed(body.n_nodes, *values)
    seconds = time.perf_counter() - begin
    return Preload(u.reshape(force.shape), force, tuple(pressed), count, seconds)


def _clamping(body: Body, bolt: Clamp, where: str) -> FloatArray:
    """Forces (N, dim) of a bolt, N: opposite on both surfaces, along the line of their middles."""
    shares = [body.even_shares(name) for _, name in bolt.surfaces]
    middles = [share @ body.nodes for share in shares]
    outwards = []
    for _, name in bolt.surfaces:
        part = body.facet_basis(body.mesh.boundaries[name])
        outwards.append(np.einsum("dfq,fq->d", part.normals, part.dx) / part.dx.sum())
    pulls = 1.0 if bolt.shank else -1.0
    line = middles[1] - middles[0] if len(middles) == 2 else -outwards[0]
    if np.linalg.norm(line) < 1e-6 * body.size and bolt.shank:
        line = outwards[0]
    size = float(np.linalg.norm(line))
    e = line / size if size else line
    for sign, (key, name), normal in zip((1.0, -1.0), bolt.surfaces, outwards, strict=False):
        if sign * pulls * (normal @ e) < SETTINGS.opposite:
            what = "pull the faces of the cut together" if bolt.shank else "press"
            raise InputError(
                f"{where}.{key}: a force along the line between the middles of its surfaces, "
                f"({', '.join(f'{x:.4g}' for x in e)}), does not {what} at {name!r}, whose "
                f"outward normal is ({', '.join(f'{x:.4g}' for x in normal)}); are the surfaces "
                "those of one bolt, and flat?"
            )
    signed = sum(sign * share for sign, share in zip((1.0, -1.0), shares, strict=False))
    return np.asarray(bolt.force * np.outer(signed, e))


def cuts(body: Body, held: BoolArray, bolts: Sequence[Clamp]) -> SlipRows:
    """Rows that hold both faces of each cut shank on each other, after they were pulled together.

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
        rows = rows + replace(none, held=apart_by[moves], pivots=pivots[moves])
    return rows


def _moving(
    body: Body, held: BoolArray, G: Matrix, area: FloatArray, force: FloatArray
) -> tuple[BoolArray, FloatArray]:
    """Displacements (dim N,) to be solved for, and motions (dim N, k) that nothing determines.

    Not solved for are those that supports hold, and one more for each rigid motion that supports
    and closed contact leave: a statically determinate support, on which loads in equilibrium give
    no reaction.
    """
    motions = body_motions(body)
    flat = motions.reshape(force.size, -1)
    loose = combinations_left_free([motions[held], (G @ flat) / area[:, np.newaxis]])
    free = ~held.ravel()
    modes = flat @ loose
    if loose.shape[1]:
        push = force.ravel() @ modes
        if np.abs(push).max() > SETTINGS.loose_push * np.abs(force).sum() * np.abs(modes).max():
            moved = np.abs(modes @ push).reshape(body.n_nodes, -1).max(axis=1)
            pushed = body_label(body.mesh, int(body.body_of_node[moved.argmax()]))
            raise InputError(
                f"bolt: the clamp forces push {pushed} where neither a "
                "support nor contact holds it; head and nut must press straight across a joint"
            )
        modes[~free] = 0.0
        free[linalg.qr(modes.T, mode="r", pivoting=True)[1][: loose.shape[1]]] = False
    return free, modes


@dataclass(frozen=True)
class _Face:
    """The pressed face of a joint, which may touch the other body or the base.

    Attributes
    ----------
    joint : Joint
    nodes : ndarray of int, shape (m,)
        Displacement nodes that lie over the other face.
    rows : sparse array, shape (m, dim N)
        Integrals of hats times motion towards the other body, m2.
    area : ndarray, shape (m,)
        Integral of each hat over the part that lies over the other face, m2.
    gap : ndarray, shape (m,)
        Integrals of hats times the initial gap, m3.
    other : sparse array, shape (m, N), or None
        Displacement of the other body opposite to the nodes.
    """

    joint: Joint
    nodes: IntArray
    rows: sparse.csr_array
    area: FloatArray
    gap: FloatArray
    other: sparse.csr_array | None

    @property
    def tied(self) -> BoolArray:
        """Whether contact stays closed because its pressure is given, (m,)."""
        return np.full(self.nodes.size, self.joint.pressure != PRELOAD)

    @staticmethod
    def of(body: Body, joint: Joint) -> _Face | None:
        """Face of a joint; None where cells lie on their base, across which nothing moves."""
        p, dim = body.properties, body.dim
        where = joint.label
        cells, beside, depth, normals = manifold_of(
            body, joint.on, p["width"], p["thickness"], where
        )
        if normals is None:
            return None
        corners, gather, parent = hat_simplices(body.nodes, cells)
        places, weights = _quadrature(corners.shape[1])
        x = np.einsum("qc,ncd->nqd", places, corners).reshape(-1, dim)
        points, count = np.arange(len(x)).reshape(len(corners), -1), corners.shape[1]
        corner = np.arange(corners.shape[0] * count).reshape(len(corners), 1, count)
        rows, columns, values = np.broadcast_arrays(corner, points[..., np.newaxis], places)
        entries = values.ravel(), (rows.ravel(), columns.ravel())
        hats = gather @ sparse.csr_array(entries, shape=(corner.size, len(x)))
        n, gap, values_there = _opposite(body, joint, x, unit_vectors(hats.T @ normals))
        weight = np.outer(measure(corners) * depth[parent], weights).ravel()
        hats = sparse.csr_array(hats @ sparse.diags_array(np.where(np.isnan(gap), 0.0, weight)))
        own = np.unique(cells)
        _, beyond, other = _opposite(body, joint, body.nodes[own], normals[own])
        area = np.asarray(hats.sum(axis=1)).ravel()[own]
        over = ~np.isnan(beyond) & (area > 0.0)
        if not over.any():
            raise InputError(
                f"{where}: no node of it lies over {joint.against!r}, or as near as elements are "
                "long; are these the faces that touch?"
            )
        nodes, hats = own[over], hats[own[over]]
        own_element = np.repeat(beside[parent], points.shape[1])
        relative = values_in(body, own_element, x, np.zeros(len(x)))[0]
        if values_there is not None:
            relative = relative - values_there
        normal = rows_along(np.arange(len(x)), n, len(x))
        motion = normal @ sparse.kron(relative, sparse.eye_array(dim))
        other = None if other is None else sparse.csr_array(other[over])
        gap = hats @ np.nan_to_num(gap)
        return _Face(joint, nodes, sparse.csr_array(hats @ motion), area[over], gap, other)

    def pressed(
        self, n_nodes: int, pressure: FloatArray, gap: FloatArray, touches: BoolArray
    ) -> Pressed:
        """Normal forces of the joint at all nodes, from values at the nodes of the face."""
        if not touches.any():
            raise InputError(
                f"{self.joint.label}: the preload leaves no contact, it opens everywhere; do the "
                "bolts press elsewhere?"
            )
        at = selection(self.nodes, n_nodes).T
        force = np.where(touches, pressure * self.area, 0.0)
        other = None if self.other is None else sparse.csr_array(at @ self.other)
        return Pressed(at @ force, at @ self.area, at @ gap, other)


def _quadrature(corners: int) -> tuple[FloatArray, FloatArray]:
    """Quadrature points in a segment or triangle, and weights that sum to 1.

    The points (points, corners) are given by their hats. The rule is exact for products of hats
    and shape functions of a quadrilateral of second order.
    """
    from skfem.quadrature import get_quadrature
    from skfem.refdom import RefLine, RefTri

    x, weights = get_quadrature(RefLine if corners == 2 else RefTri, 5)
    return np.vstack([1.0 - x.sum(axis=0), x]).T, weights / weights.sum()


def _opposite(
    body: Body, joint: Joint, x: FloatArray, normal: FloatArray
) -> tuple[FloatArray, FloatArray, sparse.csr_array | None]:
    """What lies opposite to points ``x`` (k, dim) of a pressed face with a ``normal`` (k, dim).

    Returns the direction (k, dim) to the other face, the gap (k,), m, which is NaN where nothing is
    opposite, and the displacement (k, N) of the other body there from that of its nodes.
    """
    if joint.against is None:
        return normal, np.zeros(len(x)), None
    mesh = body.mesh.mesh
    ends = mesh.p[:, mesh.facets[:, body.mesh.boundaries[joint.on]]]
    element, foot = feet(body, joint.against, x, float(np.ptp(ends, axis=1).max()))
    way = foot - x
    distance = np.linalg.norm(way, axis=1)
    signed = np.einsum("kd,kd->k", way, normal)
    apart = distance > SETTINGS.no_gap * body.size
    opposite = np.abs(signed) > SETTINGS.opposite * distance
    n = np.where((apart & opposite)[:, np.newaxis], np.sign(signed)[:, None] * unit_vectors(way),
                 normal)  # fmt: skip
    gap = np.where(apart, np.where(opposite, np.sign(signed) * distance, np.nan), 0.0)
    none = np.isnan(distance)
    gap[none] = np.nan
    return n, gap, values_in(body, element, foot, np.where(none, np.inf, 0.0))[0]


@dataclass(frozen=True)
class _Solver:
    """Minimum of ``1/2 u K u - f u`` with ``G u <= gap``, or ``G u = gap`` where tied.

    Attributes
    ----------
    K : sparse array, shape (n, n)
    G : sparse array, shape (m, n)
    area, gap : ndarray, shape (m,)
        As those of `_Face`.
    tied : ndarray of bool, shape (m,)
    force : ndarray, shape (n,)
    """

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
        return np.asarray(SETTINGS.stiffness * mean / self.area**2)

    @cached_property
    def _open(self) -> Uncondensed:
        """Stiffness with contact open, condensed to the unknowns that closed contact changes."""
        K = sparse.csr_array(self.K + SETTINGS.shift * sparse.diags_array(self.K.diagonal()))
        return condensed(K, np.unique(self.G.indices), SETTINGS.largest_schur)

    def solve(self) -> tuple[FloatArray, FloatArray, int]:
        """Displacement (m), pressure (Pa), and the number of sets of touching nodes tried."""
        active = np.ones(self.area.size, dtype=bool)
        u, p = np.zeros(self.force.size), np.zeros(self.area.size)
        seen: set[bytes] = set()
        for count in range(1, SETTINGS.active_sets + 1):
            u, p, left = self._with_closed(active, u, np.where(active, p, 0.0))
            opening = self.gap - self.G @ u
            moved = self.area * max(np.abs(u).max(), np.abs(self.gap / self.area).max())
            pulls = active & ~self.tied & (p < -SETTINGS.round_off * np.abs(p).max())
            enters = ~active & (opening < -SETTINGS.round_off * moved)
            wrong = np.flatnonzero(pulls | enters)
            if not wrong.size and left < SETTINGS.tolerance:
                return u, np.maximum(p, 0.0), count
            if not wrong.size:
                raise ConvergenceError(
                    f"preload: a share of {left:.2g} of the clamp forces is left out of balance; "
                    "do supports and contact hold every body?"
                )
            # If a set comes again, change one node at a time (Murty, Opsearch 11, 1974).
            flipped = wrong[-1:] if active.tobytes() in seen else wrong
            seen.add(active.tobytes())
            active[flipped] ^= True
        raise ConvergenceError(
            f"preload: the nodes that touch were not found in {SETTINGS.active_sets} tries; "
            f"{wrong.size} of {self.area.size} still change; refine the mesh of the pressed faces, "
            "or see whether bodies are held"
        )

    def _with_closed(
        self, active: BoolArray, u: FloatArray, p: FloatArray
    ) -> tuple[FloatArray, FloatArray, float]:
        """Displacement and pressure for a given set of closed contact, by an augmented Lagrangian.

        The residual is corrected with one factor until it stops falling. Third comes the share of
        the clamp forces that is left out of balance.
        """
        G, penalty, gap = self.G[active], self.penalty[active], self.gap[active]
        solve = self._open.solver(G.T @ sparse.diags_array(penalty) @ G)
        p, last = p[active], np.inf
        for _ in range(SETTINGS.corrections):
            r, apart = self.force - self.K @ u - G.T @ p, gap - G @ u
            left = float(np.abs(r).max() / np.abs(self.force).max())
            if apart.size and u.any():
                left += float(np.abs(apart / self.area[active]).max() / np.abs(u).max())
            if left > 0.5 * last and left < SETTINGS.tolerance:
                break
            last = min(last, left)
            du = solve(r + G.T @ (penalty * apart))
            u, p = u + du, p + penalty * (G @ du - apart)
        whole = np.zeros(active.size)
        whole[active] = p
        return u, whole, left
