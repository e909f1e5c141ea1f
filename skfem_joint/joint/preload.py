"""Preload: the pressure that clamping bolts give to joints, from a static contact problem.

Clamp forces act as equal and opposite loads. Contact is frictionless and unilateral: with the
pressure p and the gap g = g0 - n . (u - u_other) of each pressed face, the displacement is

    argmin 1/2 u K u - f u    with    g >= 0,    and then    p >= 0,    p g = 0.

Pressures are those of :mod:`skfem_joint.joint.pressure_space`: an unknown at each corner of the
element faces, for displacements of first and of second order, with gaps closed in the mean around
each corner. The corners that touch are determined by an active set method,
:mod:`skfem_joint.joint.active_set`.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy import linalg, sparse

from skfem_joint.body.body import Body
from skfem_joint.body.checks import body_label
from skfem_joint.ground.arrays import BoolArray, FloatArray, IntArray, Matrix
from skfem_joint.ground.errors import InputError
from skfem_joint.ground.progress import Progress, silent
from skfem_joint.joint import active_set
from skfem_joint.joint.active_set import UnilateralContact
from skfem_joint.joint.clamps import Clamp
from skfem_joint.joint.joints import PRELOAD, Joint
from skfem_joint.joint.opening import NodalForces
from skfem_joint.joint.pressure_space import PressureSpace
from skfem_joint.joint.rigid import body_motions, combinations_left_free
from skfem_joint.linalg.parts import Parts
from skfem_joint.system.unknowns import selection, stacked


@dataclass(frozen=True)
class TouchingFaces:
    """Faces and bolts of the static problem, and what of the faces is closed in its solution.

    Attributes
    ----------
    spaces : mapping of int to PressureSpace
        By the number of the joint.
    free : ndarray of bool, shape (dim N,)
        Displacements that were solved for.
    closed : ndarray of bool, shape (k,)
        Whether the gap at each node of the faces is closed, those of all joints in turn.
    clamps : sparse array, shape (dim N, bolts)
        Forces of each bolt on the nodes for a clamp force of 1 N.
    """

    spaces: Mapping[int, PressureSpace]
    free: BoolArray
    closed: BoolArray
    clamps: Matrix

    @property
    def ends(self) -> IntArray:
        """Where the nodes of each face but the last end among those of all."""
        return np.cumsum([space.nodes.size for space in self.spaces.values()])[:-1]


@dataclass(frozen=True)
class Preload:
    """Static solution of a structure under its clamp forces.

    Attributes
    ----------
    displacement : ndarray, shape (N, dim)
        m; without the rigid motions that neither supports nor contact determine.
    force : ndarray, shape (N, dim)
        Clamp forces, N.
    joints : tuple of NodalForces or None
        Normal forces of each joint; None where its pressure is given.
    active_sets : int
        Sets of touching nodes that were tried.
    seconds : float
        Duration of the computation, s.
    faces : TouchingFaces
    contact : UnilateralContact, optional
        What was solved, with its factor; of small structures, see `active_set.KEPT`.
    """

    displacement: FloatArray
    force: FloatArray
    joints: tuple[NodalForces | None, ...]
    active_sets: int
    seconds: float
    faces: TouchingFaces = field(repr=False)
    contact: UnilateralContact | None = field(repr=False)

    def sentences(self, joints: Sequence[Joint], bolts: Sequence[Clamp]) -> Iterator[str]:
        """What a description says about the preload of these joints by these bolts."""
        moved = float(np.linalg.norm(self.displacement, axis=1).max())
        plural = "s" if len(bolts) > 1 else ""
        yield (
            f"Preload by {len(bolts)} bolt{plural}, at rest and without friction: contact found in "
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


def preload(
    body: Body,
    held: BoolArray,
    joints: Sequence[Joint],
    bolts: Sequence[Clamp],
    clamps: Matrix,
    spaces: Mapping[int, PressureSpace],
    like: TouchingFaces | None = None,
    progress: Progress = silent,
    parts: Parts | None = None,
) -> Preload:
    """Pressures of the joints that clamping bolts press, by a static frictionless contact problem.

    The initial gap between the faces is that of the mesh, along the shortest way from the pressed
    face to the other, and that of the joint. Nodes without an opposite face within the length of an
    element never touch. Joints whose pressure is given stay closed. Rigid motions that neither
    supports nor contact determine do not matter, because clamp forces are in equilibrium by
    themselves.

    Parameters
    ----------
    body : Body
    held : ndarray of bool, shape (N, dim)
        Displacements that supports hold.
    joints : sequence of Joint
    bolts : sequence of Clamp
    clamps : sparse array, shape (dim N, bolts)
        Forces of each bolt for a clamp force of 1 N.
    spaces : mapping of int to PressureSpace
        Pressures of the joints, by their numbers.
    like : TouchingFaces, optional
        The same faces and bolts, of other forces or moduli: what touched then is tried first.
    progress : callable, optional
        Called with the number of sets of touching nodes that were tried, 0, and a note.
    parts : Parts, optional
        In which the stiffness is factorised one by one, where its whole factor is too large.

    Raises
    ------
    InputError
        If a clamp force pulls, pushes a body away, or leaves a joint without contact.
    ConvergenceError
        If the search for the touching nodes does not end.
    """
    begin, (_, K) = time.perf_counter(), body.matrices()
    faces = dict(spaces)
    force = np.reshape(clamps @ [bolt.force for bolt in bolts], (body.n_nodes, body.dim))
    N, area = _all_rows(faces, force.size)
    gap = np.concatenate([f.gap + joints[i].gap_scale * f.given for i, f in faces.items()])
    counts = [face.nodes.size for face in faces.values()]
    tied = np.repeat([not joints[i].pressed_by_bolts for i in faces], counts)
    free, left_out = _moving(body, held, N, force)
    u = np.zeros(force.size)
    G = sparse.csr_array(sparse.diags_array(area) @ N)
    contact = UnilateralContact(
        K[free][:, free], G[:, free], area, area * gap, tied, force.ravel()[free]
    )
    first = None if like is None else like.closed
    u[free], p, closed, count = contact.solve(first, progress, parts)
    u -= left_out @ linalg.lstsq(left_out, u)[0]
    borne = np.where(p > active_set.ROUND_OFF * p.max(initial=0.0), area * p, 0.0)
    touching = TouchingFaces(faces, free, closed, clamps)
    of_faces = (np.split(x, touching.ends) for x in (borne, gap - N @ u))
    pressed: list[NodalForces | None] = [None] * len(joints)
    for (i, face), *values in zip(faces.items(), *of_faces, strict=True):
        if joints[i].pressed_by_bolts:
            pressed[i] = _pressed(joints[i], face, body.n_nodes, *values)
    seconds = time.perf_counter() - begin
    known = contact if force.size <= active_set.KEPT else None
    return Preload(u.reshape(force.shape), force, tuple(pressed), count, seconds, touching, known)


def preload_rates(
    body: Body, held: Preload, force_rates: FloatArray, gap_rates: FloatArray
) -> dict[int, tuple[FloatArray, FloatArray]]:
    """Derivatives of contact forces and gaps while the same nodes touch.

    Closed gaps stay closed, open ones without pressure: with K u' + N^T F' = f' and N u' = g' where
    closed, the derivatives of forces and gaps at the nodes are F' and g' - N u'.

    Parameters
    ----------
    body : Body
    held : Preload
        Of this body.
    force_rates : ndarray, shape (dim N, k)
        Derivatives f' of the forces on the nodes by k parameters. A change of the stiffness counts
        as -K' u.
    gap_rates : ndarray, shape (q, k)
        Derivatives g' of the initial gaps of all faces in turn.

    Returns
    -------
    dict
        By the number of the joint: derivatives (q, k) of the forces, N, and gaps, m, at the nodes
        of its `PressureSpace`.

    Raises
    ------
    ConvergenceError
        If forces are left out of balance.
    """
    faces = held.faces
    N, area = _all_rows(faces.spaces, len(force_rates))
    free, contact = faces.free, held.contact
    if contact is None:
        G, K = sparse.csr_array(sparse.diags_array(area) @ N), body.matrices()[1]
        none, no_force = np.zeros(area.size), np.zeros(np.count_nonzero(free))
        contact = UnilateralContact(K[free][:, free], G[:, free], area, none, none > 0.0, no_force)
    u = np.zeros(force_rates.shape)
    u[free], p = contact.rates(faces.closed, force_rates[free], area[:, np.newaxis] * gap_rates)
    parts = (np.split(x, faces.ends) for x in (area[:, np.newaxis] * p, gap_rates - N @ u))
    return dict(zip(faces.spaces, zip(*parts, strict=True), strict=True))


def _all_rows(spaces: Mapping[int, PressureSpace], n: int) -> tuple[sparse.csr_array, FloatArray]:
    """Mean motions N, (k, n), and areas, (k,), of the nodes of all faces."""
    parts = spaces.values()
    return stacked([face.N for face in parts], n), np.concatenate([face.area for face in parts])


def _moving(
    body: Body, held: BoolArray, N: Matrix, force: FloatArray
) -> tuple[BoolArray, FloatArray]:
    """Displacements (dim N,) to be solved for, and motions (dim N, k) that nothing determines.

    Displacements that supports hold are not solved for, and neither is an additional displacement
    for each rigid motion that supports and closed contact leave. That is a statically determinate
    support, on which loads in equilibrium give no reaction.
    """
    motions = body_motions(body)
    flat = motions.reshape(force.size, -1)
    loose = combinations_left_free([motions[held], N @ flat])
    free = ~held.ravel()
    modes = flat @ loose
    if loose.shape[1]:
        push = force.ravel() @ modes
        # Clamp forces may push such bodies a little: surfaces are seldom quite opposite.
        if np.abs(push).max() > 0.01 * np.abs(force).sum() * np.abs(modes).max():
            moved = np.abs(modes @ push).reshape(body.n_nodes, -1).max(axis=1)
            pushed = body_label(body.mesh, int(body.body_of_node[moved.argmax()]))
            raise InputError(
                f"bolt: the clamp forces push {pushed} where neither a "
                "support nor contact holds it; head and nut must press straight across a joint"
            )
        modes[~free] = 0.0
        free[linalg.qr(modes.T, mode="r", pivoting=True)[1][: loose.shape[1]]] = False
    return free, modes


def _pressed(
    joint: Joint, face: PressureSpace, n_nodes: int, force: FloatArray, gap: FloatArray
) -> NodalForces:
    """Normal forces of a joint at all nodes, from forces and gaps (k,) of the nodes of its face."""
    if joint.pressure == PRELOAD and not force.any():
        raise InputError(
            f"{joint.label}: the preload leaves no contact, it opens everywhere; do the bolts "
            "press elsewhere?"
        )
    at = selection(face.nodes, n_nodes).T
    means = face.means(force)
    nodal = at @ (means @ force), at @ face.area, at @ gap, sparse.csr_array(at @ face.other)
    return NodalForces(*nodal, force, gap, means)
