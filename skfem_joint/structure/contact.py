"""Slip rows of contact, and friction limits from normal forces.

A contact point's friction limit is ``w += friction * normal_force``, summed over the joints that
share the point; `skfem_joint.structure.pressure` integrates the pressure to normal forces. The rows
are made for structures (`contact_rows`), for matrices assembled on any basis of scikit-fem
(`contact`), and for slips and approaches that users give (`point_friction`, `point_contact`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from scipy import sparse

from skfem_joint.arrays import BoolArray, as_real
from skfem_joint.errors import InputError, refuse
from skfem_joint.mesh import named
from skfem_joint.mesh.cells import cell_of
from skfem_joint.normal import NormalPart
from skfem_joint.slips import NormalRows, SlipRows, rows_along
from skfem_joint.structure.doubts import faces_apart
from skfem_joint.structure.joints import Joint, joint_problems
from skfem_joint.structure.nodes import Nodes
from skfem_joint.structure.opening import opening_face, opening_rows
from skfem_joint.structure.patch import SMALL, Patch, make_patch
from skfem_joint.structure.pressure import Pressure
from skfem_joint.unknowns import dof_numbers, selection, stacked
from skfem_joint.values import BETA, NOT_NEGATIVE, POSITIVE, STIFFNESS, check, problems

#: Arguments of `contact` for contact that opens and closes.
OPENING = ("contact", "gap", "normal_stiffness")


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
    entered, opens = np.zeros((2, m), dtype=bool)
    outwards, R_held = np.zeros((count, dim)), sparse.csr_array((count, count))
    for patch in patches:
        w[patch.points] += patch.joint.friction * patch.normal_force
        clamped[patch.points] += patch.normal_force
        beta[patch.points] = patch.joint.beta
        stiffness[patch.points] += patch.stiffness
        node[patch.points] = patch.nodes
        directions[patch.points, : patch.directions.shape[1]] = patch.directions
        if patch.opening is not None:
            opens[patch.points] = True
        elif patch.normal is not None:
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
    closed = np.flatnonzero((np.count_nonzero(~held[node], axis=1) > slips) & ~opens)
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
        normal=opening_rows(patches, held, m),
    )


def contact(
    basis: Any,
    on: str,
    *,
    pressure: Pressure | None = None,
    friction: float,
    beta: float = np.inf,
    against: str | None = None,
    width: float = 1.0,
    thickness: float = 1.0,
    normal_force: str = "consistent",
    fixed: Any = (),
    name: str | None = None,
    tangential_stiffness: float = np.inf,
    **opening: Any,
) -> SlipRows:
    """Friction on a named part of a mesh, for matrices assembled on any displacement basis.

    Parameters
    ----------
    basis : skfem.Basis
        Of `ElementVector` of first or second order, or of a line element.
    on, pressure, friction, beta, against, normal_force, tangential_stiffness
        As those of a `Joint`, regions being subdomains of the basis' mesh. The pressure may be left
        out where contact opens.
    width, thickness : float
        Extent of the contact across lines and edges, m.
    fixed : array_like of int, optional
        Supported degrees of freedom. Needed only with ``normal_force = "equal"`` where the contact
        touches a support.
    name : str, optional
        Joint under which results state its friction energy, ``on`` if not given. In a sum of
        contacts each name is a joint of its own.
    **opening
        ``contact="unilateral"`` for contact that opens and closes, and with it ``gap`` (m) and
        ``normal_stiffness`` (Pa/m), as those of a `Joint`.

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
    grid = Nodes(named(basis.mesh, order=1 + known_elements.index(scalar)))
    refuse(
        f"contact: unexpected argument {key!r}, must be one of {', '.join(OPENING)}"
        for key in opening
        if key not in OPENING
    )
    opens = opening.get("contact") == "unilateral"
    if pressure is None and not opens:
        raise InputError(
            "contact: pressure: missing; only with contact='unilateral' it may be left out"
        )
    opening["tangential_stiffness"] = tangential_stiffness
    joint = Joint(on, pressure or 0.0, friction, against, beta, normal_force, **opening)
    wrong = [*joint_problems(grid.mesh, [joint])]
    for key, extent in (("width", width), ("thickness", thickness)):
        wrong += problems(f"contact: {key}", extent, POSITIVE)
    refuse(wrong)
    dim = grid.mesh.dim
    table = np.zeros((grid.n_nodes, dim), dtype=np.intp)
    for i, row in enumerate(np.asarray(basis.dofs.element_dofs)):
        table[grid.of_element[i // dim], i % dim] = row
    held = np.isin(table, dof_numbers(fixed, basis.N))
    widths, depths = (np.full(grid.mesh.n_elements, float(x)) for x in (width, thickness))
    own = opening_face(grid, joint, held, widths, depths) if opens else (None, None)
    patch = make_patch(grid, joint, held, widths, depths, np.full(grid.n_nodes, -1), *own)
    rows = contact_rows([patch], held)
    order = selection(table.ravel(), basis.N)
    pivots = table.ravel()[rows.pivots]
    names = (_joint_name("contact", on if name is None else name),) * rows.w.size
    normal = rows.normal
    if normal is not None:
        normal = replace(normal, D=normal.D @ order, pivots=table.ravel()[normal.pivots])
    return replace(
        rows,
        B=rows.B @ order,
        closed=rows.closed @ order,
        pivots=pivots,
        clamped=None,
        names=names,
        normal=normal,
        notes=tuple(faces_apart(grid, [patch])),
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
    row : array_like, shape (N,) or (2, N)
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
    rows = np.atleast_2d(as_real(row, "point_friction: row"))
    if rows.ndim != 2 or len(rows) > 2 or not np.isfinite(rows).all() or not rows.any(axis=1).all():
        raise InputError(
            f"point_friction: found rows of shape {np.shape(row)}, must be (N,) or (2, N), finite "
            "and not zero"
        )
    check("point_friction: limit", limit, NOT_NEGATIVE)
    check("point_friction: beta", beta, BETA)
    check("point_friction: stiffness", stiffness, STIFFNESS)
    return SlipRows(
        sparse.csr_array(rows),
        np.array([float(limit)]),
        np.array([float(beta)]),
        np.array([len(rows)], dtype=np.int64),
        sparse.csr_array((0, rows.shape[1])),
        names=(_joint_name("point_friction", name),),
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
    row = np.asarray(as_real(approach, f"{where}: approach"))
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
        rows = point_friction(slip, friction * force, beta, stiffness=stiffness, name=name)
    values = (np.array([float(x)]) for x in (gap, force, normal_stiffness, 1.0))
    part = NormalPart(sparse.csr_array([[1.0]]), *values)
    gain = sparse.csr_array(np.full((rows.w.size, 1), float(friction)))
    D = sparse.csr_array(row[np.newaxis])
    return replace(rows, pivots=None, normal=NormalRows.of_points(D, part, gain))
