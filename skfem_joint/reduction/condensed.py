"""Condensed models: the contact unknowns are kept, all else is reduced as by Craig and Bampton.

The basis has constraint modes, in each of which one slip that carries friction is moved by one and
all else follows statically, and fixed-interface modes, natural modes with all these slips zero: R.
R. Craig and M. C. C. Bampton, AIAA J. 6 (1968). Static responses to the loads with the slips zero
stand beside them.

Friction acts as in the full model, point by point and with its law, Coulomb's too. The static
response is exact. The error is the dynamics of the fixed-interface modes that are left out.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from scipy import sparse

from skfem_joint.ground.arrays import FloatArray, IntArray, Matrix, as_dense
from skfem_joint.ground.errors import InputError, refuse
from skfem_joint.ground.values import COUNT, POSITIVE, WHOLE, check, check_kind, check_some
from skfem_joint.linalg import shifts
from skfem_joint.linalg.factors import factorised
from skfem_joint.linalg.parts import Parts, parts_problems
from skfem_joint.reduction.basis import Basis, Origin, SlipHistory
from skfem_joint.reduction.condensed_points import with_points
from skfem_joint.reduction.friction_points import NO_FRICTION, shared_points
from skfem_joint.reduction.interface_modes import RestrictedMotion, up_to
from skfem_joint.reduction.pod import ProperModes, orthonormal
from skfem_joint.reduction.substructures import Substructures, condensed_by_parts
from skfem_joint.stepping.arrangement import slips_are_unknowns
from skfem_joint.system.system import System
from skfem_joint.system.unknowns import selection


def condense(
    system: System,
    interface_modes: str | int = "auto",
    *,
    frequency: float | None = None,
    contact_points: str | int = "all",
    parts: Parts | None = None,
) -> System:
    """Condensed model: contact unknowns kept, all else by the method of Craig and Bampton.

    It has the contact points that carry friction, each with its own slips as unknowns, so that it
    runs with any law, Coulomb's too. Its matrices are dense: it pays off where contact is small, a
    few hundred to a few thousand unknowns.

    Parameters
    ----------
    system : System
        With its loads, as runs to come have them.
    interface_modes : "auto" or int
        Number of fixed-interface modes, the lowest ones; "auto": up to three times the loads'
        highest frequency, at least eight. Static responses to the loads stand beside them.
    frequency : float, optional
        Takes the place of the loads' highest frequency, Hz: of the modes of a `backbone`, or of a
        `response`.
    contact_points : "all" or int
        Most contact points. Fewer than there are merge points that move alike with loose joints,
        see `skfem_joint.reduction.condensed_points`: steps cost less, and `estimate` states what
        that causes. Contact that opens keeps all of its points.
    parts : Parts, optional
        Where a factor of the whole structure, or its constraint modes, take too much memory: it
        falls into parts, which are factorised one by one. The model is the same but for round-off.
        Its ``expand`` takes a solution with each part, for all displacements given at once, and
        its errors cannot be stated by `estimate`.

    Returns
    -------
    System
        Its ``expand`` gives the displacement of the full structure. Its ``notes`` say how many
        points were merged.

    Raises
    ------
    InputError
        If no point carries friction and none opens, slip rows depend on each other, the loads'
        highest frequency is needed and not known, points of contact that opens would be merged,
        or parts are none or too many, or stand beside points to be merged.
    """
    check_kind("system", system, System)
    check("interface_modes", interface_modes, WHOLE, "auto")
    check("contact_points", contact_points, COUNT, "all")
    check_some(POSITIVE, frequency=frequency)
    if system.contact.count == 0 and not system.contact.opens:
        raise InputError(NO_FRICTION.replace("reduced", "condensed"))
    refuse(parts_problems(parts))
    if parts is not None:
        if contact_points != "all":
            raise InputError(
                f"contact_points: found {contact_points} beside parts; points are merged by modes "
                "of the whole structure, which parts are to avoid. Leave out one of the two"
            )
        return _by_parts(system, interface_modes, frequency, parts)
    some, notes = with_points(system, contact_points), system.notes
    basis = _basis(some, interface_modes, frequency)
    if some is not system:
        notes = (
            *notes,
            f"{system.contact.count} contact points are merged into {some.contact.count} in the "
            "condensed model; its estimated error by points says what that causes.",
        )
        basis = replace(basis, history=_no_history(system, basis.V))
    small = _projected(some, basis.V)
    return replace(small, notes=notes, origin=Origin(system, basis))


def reference_model(system: System, modes: int = 0) -> System:
    """Condensed model by which others are judged, with more fixed-interface modes than they have.

    It has 24, or twice as many as the ``modes`` of the one that is judged.
    """
    return condense(system, max(24, 2 * modes))


def _basis(system: System, interface_modes: str | int, highest: float | None) -> Basis:
    """Constraint modes, in the order of the slip rows, then fixed-interface modes and responses.

    The basis is not orthonormal: its first coordinates are the slips. Its history is empty.
    """
    inner, forward = _with_slips(system)
    kept = kept_unknowns(inner)
    rest = np.setdiff1d(np.arange(inner.n), kept)
    V = np.zeros((inner.n, kept.size))
    V[kept, np.arange(kept.size)] = 1.0
    if rest.size:
        K, M = (sparse.csr_array(A)[rest] for A in (inner.K, inner.M))
        M_rest = M[:, rest]
        K_rest = K[:, rest] + shifts.LEAST * inner.mean_square_frequency * M_rest
        solve, coupling = factorised(sparse.csc_array(K_rest)), sparse.csc_array(K[:, kept])
        block = 64  # constraint modes that are solved for at once
        for k in range(0, kept.size, block):
            V[rest, k : k + block] = -solve(coupling[:, k : k + block].toarray())
        F = sparse.eye_array(inner.n, format="csc")[:, rest]
        highest = _highest(system) if highest is None else highest
        shapes = _fixed_interface(RestrictedMotion(F, K_rest, M_rest), interface_modes, highest)
        shapes = _with_responses(shapes, inner.load_vectors()[rest], solve, M_rest)
        V = np.hstack([V, F @ shapes])
    V = V if forward is None else np.asarray(forward @ V)
    return Basis(V, 0, ProperModes(V[:, :0], np.zeros(0)), _no_history(system, V))


def _no_history(system: System, V: FloatArray) -> SlipHistory:
    """History of a basis that is made of no run."""
    return SlipHistory(
        velocities=np.zeros((0, V.shape[1])),
        displacements=np.zeros((0, V.shape[1])),
        slip_velocity=0.0,
        slip_peak=np.zeros(system.contact.w.size),
        active=np.flatnonzero(system.contact.rubs),
    )


def _by_parts(
    system: System, interface_modes: str | int, highest: float | None, parts: Parts
) -> System:
    """The same model, without a factor of the whole structure and without constraint modes."""
    inner, _ = _with_slips(system)
    inside = Substructures(inner, kept_unknowns(inner), parts)
    highest = _highest(system) if highest is None else highest
    shapes = _fixed_interface(inside, interface_modes, highest)
    shapes = _with_responses(shapes, inner.load_vectors(), inside.solve, inside.mass)
    return condensed_by_parts(inside, shapes)


def _with_responses(shapes: FloatArray, forces: FloatArray, solve: Any, M: Matrix) -> FloatArray:
    """Fixed-interface modes (n, j), and beside them static responses to forces (n, loads)."""
    forces = forces[:, forces.any(axis=0)]
    if not forces.size:
        return shapes
    # What the modes follow of a load is taken off first: some may have no stiffness.
    forces = forces - M @ (shapes @ (shapes.T @ forces))
    return orthonormal(np.hstack([shapes, solve(forces)]), M)


def _highest(system: System) -> float | None:
    """Highest frequency of the loads, Hz; None if it is not known for all loads."""
    known = [load.amplitude.highest_frequency for load in system.loads]
    return max((f for f in known if f is not None), default=0.0) if None not in known else None


def _fixed_interface(
    restricted: RestrictedMotion | Substructures, count: str | int, highest: float | None
) -> FloatArray:
    """Fixed-interface modes, as many as are asked for or as a frequency (Hz) needs, (n, k)."""
    if not isinstance(count, str):
        return restricted.lowest(count)[1] if count else np.zeros((restricted.rows, 0))
    if highest is None:
        raise InputError(
            "condense: the highest frequency of the loads is not known; say how many "
            "interface_modes the condensed model is to have"
        )
    return up_to(restricted, highest)


def _projected(system: System, V: FloatArray) -> System:
    """Projection on a condensed basis ``V`` (n, j)."""
    small, (inner, _) = carrying(system).project(V), _with_slips(system)
    kept = kept_unknowns(inner)
    own = selection(np.arange(kept.size), small.n)
    N = sparse.csr_array(sparse.csr_array(inner.contact.normal.N)[:, kept] @ own)
    # Slip rows pick unknowns, before they did so but for round-off.
    slips = selection(np.abs(as_dense(small.contact.B)).argmax(axis=1), small.n)
    return small.with_contact(B=slips, normal=replace(inner.contact.normal, N=N))


def interface_modes_in(system: System, V: FloatArray) -> int:
    """Number of fixed-interface modes in a condensed basis ``V`` (n, j) of a system."""
    return int(V.shape[1] - kept_unknowns(_with_slips(system)[0]).size)


def kept_unknowns(system: System) -> IntArray:
    """Unknowns of contact: the slips in the order of their rows, then others that approach.

    Sliders on springs may share a slip, and elastic contact may approach by one.
    """
    rows = sparse.csr_array(system.contact.B).indices
    slips = rows[np.sort(np.unique(rows, return_index=True)[1])]
    approaches = sparse.csr_array(system.contact.normal.N).indices
    return np.concatenate([slips, np.setdiff1d(approaches, slips)]).astype(np.intp)


def _with_slips(system: System) -> tuple[System, Matrix | None]:
    """System of the points that carry friction, with slips as unknowns, and the map from these."""
    inner = carrying(system)
    if slips_are_unknowns(inner):
        return inner, None
    inner, new = inner.with_slips_as_unknowns()
    return inner, new.forward


def carrying(system: System) -> System:
    """System with only those contact points that carry friction, now or when they are pressed."""
    given = system.contact.given
    points = np.flatnonzero(system.contact.rubs)
    return shared_points(system, selection(points, given.size), given[points])
