"""Slip, friction and work of a run at all contact points of its structure, at its stored times.

Models have different contact points: a full model has all of them, a condensed one those that carry
friction, and each point of a reduced one stands for several. In each model the displacement of all
nodes is ``T`` times the unknowns, and the slip of every contact point follows from that. The matrix
``shares`` of a model's system says for which contact points of the structure each of its own
stands.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import LinearOperator, aslinearoperator

from skfem_joint.ground.arrays import FloatArray, IntArray, Matrix
from skfem_joint.ground.errors import InputError
from skfem_joint.joint.patch import shares_of
from skfem_joint.reduction.elastic_contact import elastic
from skfem_joint.reduction.substructures import Recovery
from skfem_joint.results.history import GREY, GREY_REDUCED, States, slip_state
from skfem_joint.stepping.arrangement import picks_unknowns
from skfem_joint.stepping.energy import AT_LIMIT
from skfem_joint.stepping.recording import Run
from skfem_joint.structure.structure import Structure
from skfem_joint.system.normal import NormalPart
from skfem_joint.system.system import System


@dataclass(frozen=True)
class ContactHistory:
    """Contact of a run on all m contact points of its structure.

    Rows of slip are those of ``structure.unloaded.B``, one or two for each contact point.

    Attributes
    ----------
    system : System
        Friction limits, law and joints of all contact points; see `contact_system`.
    slip : ndarray, shape (frames, rows)
        Slip of the pressed body against what it is pressed on, m.
    friction : ndarray, shape (frames, rows)
        Friction over its limit, along the slip.
    state : ndarray of int8, shape (frames, m)
        1 where a point slips, 0 where it sticks.
    work : ndarray, shape (frames, m)
        Energy dissipated by each point since the start, J.
    """

    system: System
    slip: FloatArray
    friction: FloatArray
    state: States
    work: FloatArray


def contact_history(structure: Structure, run: Run) -> ContactHistory:
    """Contact of a run with stored fields on all contact points of its structure.

    Runs of full and condensed models hold the friction and the work of each point; points that a
    condensed model has merged share theirs in proportion to their limits, and stick and slip
    together. Those of a reduced model hold them for merged points only. For such a run the law, of
    finite steepness, is evaluated at the velocities of all contact points, and the work of each
    joint is distributed among its points in proportion to friction times slip between the stored
    times.

    Raises
    ------
    InputError
        If the run stored no fields, or its system was not made from this structure.
    """
    from skfem_joint.runs.friction_along import friction_along  # loads the compiler

    check_fields(run)
    system, rows = contact_system(structure, run), _slip_rows(structure, run)
    slip, rate = (np.asarray((rows @ x.T).T) for x in (run.u, run.v))
    parts = _Parts.of(run.system)
    if parts is not None:
        friction = np.zeros_like(slip)
        rows, own = parts.rows(system, run.system)
        friction[:, rows] = run.sigma[:, own]
        work = np.zeros((len(slip), system.contact.w.size))
        work[:, parts.points] = parts.share * run.friction_work_rows[:, parts.owner]
        if parts.merged:
            rate[:, rows] = (run.system.contact.B @ run.v.T).T[:, own]
    else:
        repeats = run.steady is not None
        friction = friction_along(system, slip, rate, run.field_times, repeats)
        limits = limits_of(system, normal_forces(structure, run))
        work = _spread(run, system, system.contact.slider_slip(slip, friction), friction, limits)
    grey = GREY if picks_unknowns(run.system.contact.B) else GREY_REDUCED
    state = slip_state(system.contact.slip_norm(rate), system.contact.beta, grey)
    if system.contact.has_springs:
        slides = system.contact.slip_norm(friction) >= AT_LIMIT
        state = np.where(system.contact.sprung, slides, state).astype(np.int8)
    return ContactHistory(system, slip, friction, state, work)


def check_fields(run: Run) -> None:
    """Refuse a run that stored no fields; InputError."""
    if not run.field_times.size:
        raise InputError("the runs stored no fields: integrate with Save(fields=True)")


def contact_system(structure: Structure, run: Run) -> System:
    """System of a structure without loads, with friction limits and law of a run.

    If points of the run stand for several points of the structure, these have their own friction
    limits, and their own law, but no steeper than that of the run.

    Raises
    ------
    InputError
        If the system of the run was not made from this structure.
    """
    _unknowns(structure, run)
    base, own = structure.unloaded, run.system
    names = tuple(joint.name for joint in structure.joints)
    m, shares = base.contact.w.size, own.contact.shares
    points = own.contact.w.size if shares is None else shares.shape[1]
    if own.contact.joints != names or points != m:
        raise InputError(
            f"run: its system has the joints {', '.join(own.contact.joints) or 'none'} with "
            f"{points} contact points, the structure {', '.join(names) or 'none'} with {m}; give "
            "the structure that its system was made from"
        )
    parts = _Parts.of(own)
    if parts is None:
        given, beta = base.contact.given, base.no_steeper(own.contact.steepest).contact.beta
    else:
        given, beta = np.zeros(m), base.contact.beta.copy()
        given[parts.points] = parts.share * own.contact.given[parts.owner]
        beta[parts.points] = own.contact.beta[parts.owner]
    J = shares_of(structure.patches, base.contact.w)
    return base.with_contact(given=given, beta=beta, J=J, joints=names)


def slip_peaks_of(structure: Structure, run: Run) -> tuple[FloatArray, FloatArray]:
    """Largest slips of all contact points of a structure in a run and of their sliders, (m,), m.

    Each is the largest of all steps in runs of full and condensed models; points that are merged in
    these have that of the merged one. For a reduced model, whose points stand for several, it is
    the largest of the stored fields.

    Raises
    ------
    InputError
        If such a model stored no fields, or its system was not made from this structure.
    """
    system, parts = contact_system(structure, run), _Parts.of(run.system)
    if parts is not None:
        peak, sliding = np.zeros((2, system.contact.w.size))
        peak[parts.points] = run.slip_peak[parts.owner]
        sliding[parts.points] = run.slider_peak[parts.owner]
        return peak, sliding
    check_fields(run)
    slip = np.asarray((_slip_rows(structure, run) @ run.u.T).T)
    peak = np.asarray(system.contact.slip_norm(slip).max(axis=0, initial=0.0))
    return peak, system.contact.slider_peak(peak)


def normal_forces(structure: Structure, run: Run) -> FloatArray:
    """Normal forces of all pressure points of a structure at the stored fields, (frames, q), N.

    Where points of a reduced model stand for several, they are those of elastic contact at the
    displacements of the run. There are none where the run stored none.
    """
    opening = run.system.contact.normal
    if opening.shares is None or not run.normal_force.size:
        return run.normal_force
    return _opening_of(structure).elastic_forces(run.u @ _unknowns(structure, run).T)


def gaps_of(structure: Structure, run: Run) -> FloatArray:
    """Gaps of all pressure points at the stored fields, (frames, q), m; zero where closed."""
    opening, u = run.system.contact.normal, run.u
    if opening.shares is not None:
        opening, u = _opening_of(structure), u @ _unknowns(structure, run).T
    return np.maximum(opening.gaps(u), 0.0)


def _opening_of(structure: Structure) -> NormalPart:
    """Contact that opens of a structure, elastic as in reduced models."""
    return elastic(structure.unloaded).contact.normal


def limits_of(system: System, forces: FloatArray) -> FloatArray:
    """Friction limits, (frames, m) or (1, m), N, under the ``forces`` (frames, q), N, of a run."""
    contact = system.contact
    return np.asarray(contact.limits(forces.T).T if forces.size else contact.w[np.newaxis])


def displacements(structure: Structure, run: Run) -> tuple[FloatArray, FloatArray]:
    """Stored displacement (m) and velocity (m/s) of all nodes, (frames, N, dim).

    InputError if the system of the run was not made from this structure.
    """
    _unknowns(structure, run)
    u, v = (structure.unpacked(run.system.expand(x)) for x in (run.u, run.v))
    return u, v


def _slip_rows(structure: Structure, run: Run) -> Matrix:
    """Slip of all contact points from the unknowns of a run, (rows, n)."""
    V, B = _unknowns(structure, run), structure.unloaded.contact.B
    return aslinearoperator(B) @ V if isinstance(V, LinearOperator) else B @ V


def _unknowns(structure: Structure, run: Run) -> Matrix:
    """Unknowns of the full system from those of a run, (n of the full one, n).

    InputError if the run's displacements are not those of the structure, supports and closed
    contact included.
    """
    T, inverse = run.system.T, structure.change_of_unknowns.inverse
    holds = "nothing but its unknowns" if T is None else f"{T.shape[0]} displacements"
    if T is not None and T.shape[0] == inverse.shape[1]:
        by_parts = isinstance(T, Recovery)
        whole = T.inside.system.T if by_parts else T
        V = inverse @ whole
        # Displacements against supports and closed contact are round-off.
        if abs(structure.T @ V - whole).max() <= 1e-9 * abs(whole).max():
            return aslinearoperator(inverse) @ T if by_parts else V
        holds += " that do not obey its supports and contact"
    raise InputError(
        f"run: its system has {holds}, the structure {inverse.shape[1]} displacements; give the "
        "structure that its system was made from"
    )


@dataclass(frozen=True)
class _Parts:
    """Points of a structure that the contact points of a full or condensed model are made of.

    Attributes
    ----------
    points : ndarray of int, shape (k,)
        Points of the structure.
    owner : ndarray of int, shape (k,)
        Contact point of the model that each of them is, or is a part of.
    share : ndarray, shape (k,)
        Share of each in its owner's friction limit.
    """

    points: IntArray
    owner: IntArray
    share: FloatArray

    @classmethod
    def of(cls, system: System) -> _Parts | None:
        """Parts of a system's contact points; None for merged points of a reduced model."""
        contact = system.contact
        if contact.shares is None:
            every = np.arange(contact.w.size)
            return cls(every, every, np.ones(every.size))
        shares = sparse.csr_array(contact.shares)
        count = np.diff(shares.indptr)
        if np.any(count != 1) and not picks_unknowns(contact.B):
            return None
        return cls(
            shares.indices.astype(np.intp), np.repeat(np.arange(count.size), count), shares.data
        )

    @property
    def merged(self) -> bool:
        """Whether a contact point of the model has several parts."""
        return self.owner.size > np.unique(self.owner).size

    def rows(self, system: System, model: System) -> tuple[IntArray, IntArray]:
        """Slip rows of the parts in a ``system`` of all points, and of their owners in a model."""
        count = system.contact.directions[self.points]
        within = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
        first = system.contact.first_row[self.points], model.contact.first_row[self.owner]
        rows, own = (np.repeat(each, count) + within for each in first)
        return rows, own


def _spread(
    run: Run, system: System, slip: FloatArray, friction: FloatArray, limits: FloatArray
) -> FloatArray:
    """Work in each joint, spread over points by their friction and slip, (frames, m), J.

    ``limits``, (frames, m) or (1, m), N, are those of the points.
    """
    parts = 0.5 * (friction[1:] + friction[:-1]) * np.diff(slip, axis=0)
    parts *= np.repeat(limits[-len(parts) :], system.contact.directions, axis=1)
    spread = np.zeros((len(slip), system.contact.w.size))
    np.cumsum(np.maximum(system.contact.by_point(parts), 0.0), axis=0, out=spread[1:])
    total, known = spread @ system.contact.J.T, run.friction_work_rows @ run.system.contact.J.T
    scale = np.divide(known, total, out=np.zeros_like(total), where=total > 0.0)
    return np.asarray(spread * (scale @ system.contact.J))
