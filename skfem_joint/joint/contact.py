"""Slip rows of contact, and friction limits from normal forces.

A contact point's friction limit is ``w += friction * normal_force``, summed over the joints that
share the point; `skfem_joint.joint.pressure` integrates the pressure to normal forces. The rows
are made for structures (`contact_rows`), for matrices assembled on any basis of scikit-fem
(`contact`), and for slips and approaches that users give (`point_friction`, `point_contact`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from typing import Any

import numpy as np
from scipy import sparse

from skfem_joint.body.nodes import Nodes
from skfem_joint.ground.arrays import BoolArray, as_real, dense_rows
from skfem_joint.ground.errors import InputError, refuse
from skfem_joint.ground.values import BETA, NOT_NEGATIVE, POSITIVE, STIFFNESS, check, problems
from skfem_joint.joint.doubts import doubtful_gaps, faces_apart
from skfem_joint.joint.joints import PRELOAD, Joint, joint_problems
from skfem_joint.joint.manifold import SMALL
from skfem_joint.joint.patch import Patch, make_patch
from skfem_joint.joint.pressure_space import pressure_space
from skfem_joint.mesh import named
from skfem_joint.mesh.cells import cell_of
from skfem_joint.system.normal import NormalPart
from skfem_joint.system.slips import NormalRows, SlipRows, rows_along
from skfem_joint.system.unknowns import dof_numbers, selection, stacked


def contact_rows(patches: Sequence[Patch], held: BoolArray) -> SlipRows:
    """Slip rows of all patches on the degrees of freedom ``dim * node + component``.

    A point that several joints share has the sum of their friction limits. ``held`` (N, dim) are
    the displacements that supports hold.
    """
    count, dim = held.shape
    m = max((int(patch.points.max(initial=-1)) for patch in patches), default=-1) + 1
    w, clamped, beta, stiffness = np.zeros(m), np.zeros(m), np.ones(m), np.zeros(m)
    node = np.zeros(m, dtype=np.intp)
    directions, normal = np.zeros((m, dim, dim)), np.zeros((m, dim))
    R = sparse.csr_array((m, count))
    entered = np.zeros(m, dtype=bool)
    outwards, R_held = np.zeros((count, dim)), sparse.csr_array((count, count))
    for patch in patches:
        w[patch.points] += patch.joint.friction * patch.normal_force
        clamped[patch.points] += patch.normal_force
        beta[patch.points] = patch.joint.beta
        stiffness[patch.points] += patch.stiffness
        node[patch.points] = patch.nodes
        directions[patch.points, : patch.directions.shape[1]] = patch.directions
        # Approaches of contact that opens are unknowns, see below.
        if patch.normal is not None and not patch.joint.opens:
            normal[patch.points] = patch.normal
            outwards[patch.held_nodes] = patch.held_normal
            if patch.held_other is not None:
                R_held = R_held + selection(patch.held_nodes, count).T @ patch.held_other
        if patch.other is not None:
            new = ~entered[patch.points]
            R = R + selection(patch.points[new], m).T @ patch.other[new]
        entered[patch.points] = True
    slips = np.count_nonzero(np.any(directions != 0.0, axis=2), axis=1)
    point, which = np.nonzero(np.arange(dim) < slips[:, None])
    dofs = dim * node[:, None] + np.argsort(held[node], axis=1, kind="stable")  # free first
    relative = sparse.kron(selection(node, count) - R, sparse.eye_array(dim))
    # Contact that stays closed holds the direction in which a free node does not slip.
    free = np.count_nonzero(~held[node], axis=1)
    closed = np.flatnonzero((free > slips) & normal.any(axis=1))
    # It also holds nodes of a pressed border that supports keep from slipping, in free directions.
    own = sparse.eye_array(count)
    outwards[node] = 0.0
    outwards[held] = 0.0
    still = np.flatnonzero(np.linalg.norm(outwards, axis=1) > SMALL)
    H = [
        rows_along(closed, np.where(held[node[closed]], 0.0, normal[closed]), m) @ relative,
        rows_along(still, outwards[still], count)
        @ sparse.kron(own - R_held, sparse.eye_array(dim)),
    ]
    lone = dim * still + np.argmax(np.abs(outwards[still]), axis=1)
    return SlipRows(
        B=rows_along(point, directions[point, which], m) @ relative,
        w=w,
        beta=beta,
        directions=slips.astype(np.int64),
        closed=stacked(H, dim * count),
        pivots=np.concatenate([dofs[closed, slips[closed]], lone, dofs[point, which]]),
        clamped=np.concatenate([clamped[closed], np.zeros(still.size)]),
        stiffness=np.where(stiffness > 0.0, stiffness, np.inf),
        normal=_approaches(patches, held, m),
    )


def _approaches(patches: Sequence[Patch], held: BoolArray, m: int) -> NormalRows:
    """Approaches of the nodes of joints that open, and their pressure points.

    ``held`` (N, dim) are the displacements that supports hold, ``m`` the number of contact points.
    """
    count, dim = held.shape
    faces = [patch.opening for patch in patches]
    nodes = np.concatenate([np.zeros(0, np.intp), *(face.nodes[face.moves] for face in faces)])
    if not nodes.size:  # all the following would be empty, and takes a millisecond
        return NormalRows.none(dim * count, m)
    normals = np.vstack([face.normals[face.moves] for face in faces])
    normals = np.where(held[nodes], 0.0, normals)
    others = stacked([face.other[np.flatnonzero(face.moves)] for face in faces], count)
    relative = sparse.kron(selection(nodes, count) - others, sparse.eye_array(dim))
    # What a support holds of a slanted normal is no part of the approach.
    size = np.where(held[nodes].any(axis=1), np.linalg.norm(normals, axis=1), 1.0)
    along = rows_along(np.arange(nodes.size), normals, nodes.size)
    slips = np.zeros(count, dtype=np.intp)
    for patch in patches:
        slips[patch.nodes] = np.count_nonzero(np.any(patch.directions != 0.0, axis=2), axis=1)
    free_first = np.argsort(held[nodes], axis=1, kind="stable")
    return NormalRows(
        D=sparse.csr_array(sparse.diags_array(size) @ along @ relative),
        pivots=dim * nodes + free_first[np.arange(nodes.size), slips[nodes]],
        part=NormalPart.joined([face.moving for face in faces]),
        gain=friction_gain(patches, [patch.joint.friction for patch in patches], m),
    )


def friction_gain(patches: Sequence[Patch], friction: Sequence[float], m: int) -> sparse.csr_array:
    """Limits of ``m`` contact points by the forces of all pressure points that move, (m, q).

    ``friction`` has a coefficient of friction for each joint.
    """
    each, points, columns, q = [np.zeros(0)], [np.zeros(0, np.intp)], [np.zeros(0, np.intp)], 0
    for patch, coefficient in zip(patches, friction, strict=True):
        own = patch.opening.nodes[patch.opening.moves]
        _, at, column = np.intersect1d(patch.nodes, own, return_indices=True)
        each.append(np.full(at.size, coefficient))
        points.append(patch.points[at])
        columns.append(q + column)
        q += own.size
    at_all = np.concatenate(points), np.concatenate(columns)
    return sparse.csr_array((np.concatenate(each), at_all), shape=(m, q))


def contact(
    basis: Any,
    on: str,
    *,
    width: float = 1.0,
    thickness: float = 1.0,
    fixed: Any = (),
    name: str | None = None,
    **joint: Any,
) -> SlipRows:
    """Friction on a named part of a mesh, for matrices assembled on any displacement basis.

    Parameters
    ----------
    basis : skfem.Basis
        Of `ElementVector` of first or second order, or of a line element.
    on : str
        Subdomain or boundary of the basis' mesh.
    width, thickness : float
        Extent of the contact across lines and edges, m.
    fixed : array_like of int, optional
        Supported degrees of freedom. Needed only with ``normal_force = "equal"`` where the contact
        touches a support.
    name : str, optional
        Joint under which results state its friction energy, ``on`` if not given. In a sum of
        contacts each name is a joint of its own.
    **joint
        What a `Joint` takes: ``pressure``, ``friction``, ``against``, ``beta``, ``normal_force``,
        ``tangential_stiffness``, and ``contact="unilateral"`` for contact that opens and closes,
        with ``gap``, ``gap_scale``, ``remove_plane`` and ``normal_stiffness``. Only there the
        pressure may be left out.

    Returns
    -------
    SlipRows
        For :meth:`skfem_joint.System.from_matrices`. Without ``contact="unilateral"`` facets cannot
        move along their normal: contact stays closed.

    Raises
    ------
    InputError
        For elements without nodal tangents (use `point_friction`), and for whatever is refused in
        a joint of a `Structure`.
    """
    scalar = type(getattr(basis.elem, "elem", basis.elem))
    known_elements = cell_of(basis.mesh)[0].elements
    if scalar not in known_elements:
        raise InputError(
            f"contact: no slip direction is known for {type(basis.elem).__name__}; use "
            "ElementVector of a first- or second-order element, a linear line element, or "
            "point_friction(row, limit) for slip rows of your own"
        )
    allowed = [field.name for field in fields(Joint) if field.name not in ("on", "axis")]
    refuse(
        f"contact: unexpected argument {key!r}, must be one of {', '.join(allowed)}"
        for key in joint
        if key not in allowed
    )
    pressed = Joint(on, **{"pressure": 0.0, "friction": np.nan} | joint)
    if "pressure" not in joint and not pressed.opens:
        raise InputError(
            "contact: pressure: missing; only with contact='unilateral' it may be left out"
        )
    if pressed.pressure == PRELOAD:
        raise InputError(
            f"contact: pressure: found {PRELOAD!r}, must be in Pa; bolts need a Structure"
        )
    dim, order = basis.mesh.dim(), 1 + known_elements.index(scalar)
    section = {"width": width if dim == 1 else None, "thickness": thickness if dim == 2 else None}
    grid = Nodes(named(basis.mesh, order=order), **section)
    if any(part.kind is not grid.cell for part in grid.mesh.parts):
        raise InputError(
            f"contact: the mesh has {grid.mesh.kind} elements, whose nodes scikit-fem numbers "
            "otherwise: give the mesh to sj.Structure, which assembles them"
        )
    wrong = [*joint_problems(grid.mesh, [pressed])]
    for key, extent in (("width", width), ("thickness", thickness)):
        wrong += problems(f"contact: {key}", extent, POSITIVE)
    refuse(wrong)
    table = np.zeros((grid.n_nodes, dim), dtype=np.intp)
    for i, row in enumerate(np.asarray(basis.dofs.element_dofs)):
        table[grid.of_element[i // dim], i % dim] = row
    held = np.isin(table, dof_numbers(fixed, basis.N))
    space = pressure_space(grid, pressed) if pressed.opens else None
    patch = make_patch(grid, pressed, held, np.full(grid.n_nodes, -1), None, space)
    rows, order_of = contact_rows([patch], held), selection(table.ravel(), basis.N)
    return replace(
        rows,
        B=rows.B @ order_of,
        closed=rows.closed @ order_of,
        pivots=table.ravel()[rows.pivots],
        clamped=None,
        names=(_joint_name("contact", on if name is None else name),) * rows.w.size,
        normal=replace(
            rows.normal, D=rows.normal.D @ order_of, pivots=table.ravel()[rows.normal.pivots]
        ),
        notes=(
            *faces_apart(grid, [patch]),
            *(() if space is None else doubtful_gaps([pressed], {0: space})),
        ),
    )


def _joint_name(where: str, name: Any) -> str:
    """Name of a joint, which must be a text that is not empty."""
    if not isinstance(name, str) or not name.strip():
        raise InputError(f"{where}: found name {name!r}, must be a text that is not empty")
    return name


def point_friction(
    row: Any,
    limit: float,
    beta: float = np.inf,
    *,
    stiffness: float = np.inf,
    name: str = "contact",
) -> SlipRows:
    """Friction of a point whose slip is a given row times the displacements.

    Parameters
    ----------
    row : array_like or sparse array, shape (N,) or (2, N)
        Slip from the degrees of freedom, in one direction or two: a beam's transverse slip, the
        motion of one body against another.
    limit : float
        Friction limit, N.
    beta : float
        Steepness of the arctan law, s/m; ``inf`` is Coulomb.
    stiffness : float
        Of a spring in series with the friction, N/m; ``inf`` is none. With Coulomb's law this is an
        elastic slider, or Jenkins element.
    name : str
        Joint under which results state its friction energy. In a sum of contacts each name is a
        joint of its own.

    Returns
    -------
    SlipRows
        For :meth:`skfem_joint.System.from_matrices`; ``a + b`` puts several together.

    Raises
    ------
    InputError
        For rows of another shape, rows that are zero or not finite, a negative limit, and a beta
        or stiffness that is not positive.
    """
    return _point_rows("point_friction", "row", row, limit, beta, stiffness, name)


def _point_rows(
    where: str, argument: str, row: Any, limit: float, beta: float, stiffness: float, name: str
) -> SlipRows:
    """Rows of `point_friction`, whose messages begin with a function and its argument."""
    rows = np.atleast_2d(as_real(dense_rows(row), f"{where}: {argument}"))
    if rows.ndim != 2 or len(rows) > 2 or not np.isfinite(rows).all() or not rows.any(axis=1).all():
        raise InputError(
            f"{where}: found rows of shape {np.shape(row)}, must be (N,) or (2, N), finite "
            "and not zero"
        )
    check(f"{where}: limit", limit, NOT_NEGATIVE)
    check(f"{where}: beta", beta, BETA)
    check(f"{where}: stiffness", stiffness, STIFFNESS)
    return SlipRows(
        sparse.csr_array(rows),
        np.array([float(limit)]),
        np.array([float(beta)]),
        np.array([len(rows)], dtype=np.int64),
        sparse.csr_array((0, rows.shape[1])),
        names=(_joint_name(where, name),),
        stiffness=np.array([float(stiffness)]),
    )


def point_contact(
    slip: Any,
    approach: Any,
    *,
    friction: float,
    force: float = 0.0,
    gap: float = 0.0,
    normal_stiffness: float = np.inf,
    beta: float = np.inf,
    stiffness: float = np.inf,
    name: str = "contact",
) -> SlipRows:
    """Contact of a point that opens and closes, on given rows of the displacements.

    The normal force p follows the approach d of the faces: p >= 0 while d = gap where contact is
    rigid, and p = max(0, force + normal_stiffness (d - gap)) where it is elastic. The friction
    limit is ``friction`` p. With a ``stiffness`` and Coulomb's law this is an elastic slider, or
    Jenkins element, under a normal force that varies.

    Parameters
    ----------
    slip : array_like, shape (N,) or (2, N), or None
        Slip from the degrees of freedom, in one direction or two, as for `point_friction`; None for
        a stop without friction.
    approach : array_like, shape (N,)
        Approach of the faces from the degrees of freedom: positive towards each other. The forces
        at the degrees of freedom are minus this row times the change of p.
    friction : float
        Coefficient of friction.
    force : float
        Normal force at rest, N.
    gap : float
        Distance of the faces at rest, m; of a point without a ``force``.
    normal_stiffness : float
        Of the contact across the faces, N/m; ``inf`` is rigid. An elastic point may slip and
        approach by the same degree of freedom, if friction has a spring or a finite beta.
    beta, stiffness, name
        As for `point_friction`.

    Returns
    -------
    SlipRows
        For :meth:`skfem_joint.System.from_matrices`; ``a + b`` puts several together.

    Raises
    ------
    InputError
        For rows of another shape, rows that are zero or not finite, a negative friction, force or
        gap, a force beside a gap, and a beta or stiffness that is not positive.
    """
    where = "point_contact"
    row = np.asarray(as_real(dense_rows(approach), f"{where}: approach"))
    if row.ndim != 1 or not np.isfinite(row).all() or not row.any():
        raise InputError(
            f"{where}: approach: found a row of shape {np.shape(approach)}, must be (N,), finite "
            "and not zero"
        )
    check(f"{where}: friction", friction, NOT_NEGATIVE)
    check(f"{where}: force", force, NOT_NEGATIVE)
    check(f"{where}: gap", gap, NOT_NEGATIVE)
    check(f"{where}: normal_stiffness", normal_stiffness, STIFFNESS)
    if force > 0.0 and gap > 0.0:
        raise InputError(
            f"{where}: found force = {force:g} N beside gap = {gap:g} m: faces that are apart "
            "carry no force; leave one of them out"
        )
    if slip is None and friction > 0.0:
        raise InputError(
            f"{where}: friction: found {friction:g} without a slip; give its row, or friction = 0"
        )
    rows = SlipRows.none(row.size)
    if slip is not None:
        rows = _point_rows(where, "slip", slip, friction * force, beta, stiffness, name)
    values = (np.array([float(x)]) for x in (gap, force, normal_stiffness, 1.0))
    part = NormalPart(sparse.csr_array([[1.0]]), *values)
    gain = sparse.csr_array(np.full((rows.w.size, 1), float(friction)))
    D = sparse.csr_array(row[np.newaxis])
    return replace(rows, pivots=None, normal=NormalRows.of_points(D, part, gain))
