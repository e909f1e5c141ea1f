"""Reduced bases of plates: proper orthogonal modes of their own run, or scaled reference modes.

Modes of the plate's own run are orthogonal in the inner product of energy, by default: with that of
mass the first modes go to what swings most, which is seldom the joint. At ten modes the friction
energy of an axially pulled plate errs by 1.8 % with the one and 2.7 % with the other, at fourteen
by 0.7 % and 2.1 %. Fixed-interface modes beside them bought nothing: what the linear part does in
the run is in its proper orthogonal modes already.

Scaled modes are those of a reference strut, stretched along the axis of a joint to its active
length. They prescribe the slip along the axis; the slip across it, and all that is not in contact,
follows statically with the least strain energy, so that Poisson's ratio does not stiffen the plate.
As friction resists the slip across, as many modes that breathe across stand beside them: without
them friction energy errs by 22 % in a joint of two plates, with them by 0.2 %. All this holds for
pulling along the axis: there is no bending of the joint in it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import splu

from skfem_joint.active_length import THRESHOLD
from skfem_joint.errors import InputError
from skfem_joint.hyper_reduction import with_merged_points
from skfem_joint.pod import ProperModes, orthonormal
from skfem_joint.recording import Run
from skfem_joint.reduction import ReferenceModes, fixed_interface_modes, snapshot_matrix
from skfem_joint.system import System

if TYPE_CHECKING:
    from skfem_joint.plate import Patch, PlateStructure

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

#: Inner products that proper orthogonal modes of a plate may be orthogonal in.
INNER_PRODUCTS = ("energy", "mass", "euclidean")
#: Fixed-interface modes to choose from.
MOST_INTERFACE_MODES = 30
#: Times of a run that a decomposition takes at most.
MOST_TIMES = 300


@dataclass(frozen=True)
class PlateBasis:
    """Basis of a reduced plate.

    Attributes
    ----------
    V : ndarray, shape (n, j)
        Mass-orthonormal; ``system.project(basis.V)`` is the reduced system with all points.
    slip_velocity : float
        Largest slip velocity of the run that the basis comes from, m/s.
    velocities : ndarray, shape (times, j)
        Velocities of the basis coordinates in that run: what the friction points are made for.
    active : ndarray of int
        Contact points with friction that move in the basis: all that are pressed, or those within
        the active length.
    proper : ProperModes
        Decomposition that the modes come from.
    active_length : dict
        Of each joint with a named axis, m; empty for modes of the plate's own run.
    missed : float
        Share of that run's displacement that the basis cannot follow, in the norm of strain energy.
    """

    V: FloatArray
    slip_velocity: float
    velocities: FloatArray
    active: IntArray
    proper: ProperModes
    active_length: Mapping[str, float]
    missed: float


def own_basis(
    system: System,
    training: Run,
    modes: int,
    *,
    snapshots: str = "both",
    inner_product: str = "energy",
    interface_modes: int = 0,
) -> PlateBasis:
    """Proper orthogonal modes of the plate's own run.

    Parameters
    ----------
    training : Run
        Run of the system with stored fields; it takes at most 300 of their times.
    modes : int
    snapshots : {"both", "displacement", "rates"}
        See :func:`skfem_joint.reduction.snapshot_matrix`.
    inner_product : {"energy", "mass", "euclidean"}
        ``energy`` is that of strain energy, with the share of mass that keeps it definite.
    interface_modes : int
        Fixed-interface modes of all that is not in contact, beside the others.

    Raises
    ------
    InputError
        If nothing moves in the run, or its snapshots make fewer modes than asked for.
    """
    u, v = (x[:: max(1, -(-len(x) // MOST_TIMES))] for x in (training.u, training.v))
    if not (np.any(u) and np.any(v)):
        raise InputError(
            "reduction: nothing moves in the run that the modes are to come from, or it holds no "
            "fields (Save(fields=True))"
        )
    proper = _proper_modes(system, u, v, snapshots, inner_product)
    if not 1 <= modes <= proper.modes.shape[1]:
        raise InputError(
            f"reduction.modes: found {modes}, must be from 1 to {proper.modes.shape[1]}, which "
            "the snapshots of the run can make"
        )
    V = proper.modes[:, :modes]
    if interface_modes > 0:
        free = np.setdiff1d(np.arange(system.n), _picked(system))
        if free.size:
            block = np.zeros((system.n, min(interface_modes, free.size)))
            block[free] = fixed_interface_modes(system, free, interface_modes)[1]
            V = np.hstack([V, block])
    return _basis(system, V, training, np.flatnonzero(system.w > 0.0), proper, {})


def _proper_modes(
    system: System, u: FloatArray, v: FloatArray, snapshots: str, inner_product: str
) -> ProperModes:
    """Decomposition by an orthogonal factorization, so that no matrix of size (n, n) is filled."""
    if inner_product == "energy":
        # The mean square frequency of the motion weighs the mass, which keeps rigid motions apart.
        square = np.vdot(v, (system.M @ v.T).T) / np.vdot(u, (system.M @ u.T).T)
        G = sparse.csr_array(system.K + 1e-3 * square * system.M)
    elif inner_product == "mass":
        G = sparse.csr_array(system.M)
    elif inner_product == "euclidean":
        G = sparse.eye_array(system.n, format="csr")
    else:
        raise InputError(
            f"inner_product: found {inner_product!r}, must be one of {', '.join(INNER_PRODUCTS)}"
        )
    if snapshots == "both":
        u, v = (x / np.sqrt(np.vdot(x, (G @ x.T).T)) for x in (u, v))
        X = np.vstack([u, v])
    else:
        X = snapshot_matrix(u, v, snapshots)
    Q, R = np.linalg.qr(X.T)
    factor = np.linalg.cholesky(Q.T @ (G @ Q))
    left, values, _ = np.linalg.svd(factor.T @ R)
    keep = values > 1e-12 * values[0]
    return ProperModes(Q @ np.linalg.solve(factor.T, left[:, keep]), values[keep])


def scaled_basis(
    structure: PlateStructure,
    system: System,
    reference: ReferenceModes,
    axes: Mapping[str, FloatArray],
    probe: Run,
    *,
    modes: int = 5,
    interface_modes: int = 2,
    lengths: Mapping[str, float] | None = None,
) -> PlateBasis:
    """Reference modes scaled along the axis of each joint, carried into the plates.

    Parameters
    ----------
    structure : PlateStructure
    system : System
        What :func:`skfem_joint.plate.assemble_plate` made of it.
    reference : ReferenceModes
        Modes of a strut on a unit active length.
    axes : mapping of str to ndarray, shape (2,)
        Axis of each joint by name, either way round.
    probe : Run
        Run of ``system.with_beta(np.inf)`` with stored fields: exact Coulomb friction shows how far
        each joint slips.
    modes : int
        Reference modes of each active end of a joint.
    interface_modes : int
        Fixed-interface modes of what is not prescribed.
    lengths : mapping of str to float, optional
        Active lengths (m) by joint name, instead of those that the probe shows.

    Raises
    ------
    InputError
        If a joint has no axis or nothing slips, or for an active length longer than its joint.
    """
    missing = [p.joint.name for p in structure.patches if p.joint.name not in axes]
    if missing:
        raise InputError(
            f"joint {', '.join(map(repr, missing))}: no axis is named; scaled reference modes need "
            'one, e.g. axis = [1.0, 0.0]. Or use reference = "self".'
        )
    moving = max((float(probe.slip_peak[p.points].max()) for p in structure.patches), default=0.0)
    rotation, axial = _axial_unknowns(structure, system, axes)
    pulled: list[FloatArray] = []
    breathing: list[FloatArray] = []
    active = np.zeros(system.w.size, dtype=bool)
    active_length: dict[str, float] = {}
    for patch in structure.patches:
        axis = np.asarray(axes[patch.joint.name], dtype=float)
        axis = axis / np.linalg.norm(axis)
        position = structure.nodes[patch.nodes]
        across = position @ np.array([-axis[1], axis[0]])
        across = across - 0.5 * (across.max() + across.min())
        share = np.ones(patch.points.size)  # of a motion along the axis in the slip of an edge
        if patch.directions.shape[1] == 1:
            share = patch.directions[:, 0] @ axis
        asked = None if lengths is None else lengths.get(patch.joint.name)
        for distance, length in _ends(patch, position @ axis, probe.slip_peak, asked, moving):
            values = reference.at(1.0 - distance / length, modes)
            columns = axial[patch.points]
            pulled.append(_on(columns[:, 0], values * share[:, np.newaxis], system.n))
            breathing.append(_on(columns[:, 1], values * across[:, np.newaxis], system.n))
            active[patch.points[distance < length]] = True
            active_length[patch.joint.name] = active_length.get(patch.joint.name, 0.0) + length
    if not pulled:
        raise InputError(
            "reduction: nothing slips in any joint, so that no active length can be found; "
            'use reference = "self"'
        )
    free = np.ones(system.n, dtype=bool)
    free[axial[axial[:, 0] >= 0, 0]] = False
    free[axial[~active & (axial[:, 1] >= 0), 1]] = False
    K = sparse.csr_array(rotation.T @ system.K @ rotation)
    V = _following(K, np.hstack(pulled), free)
    rest = _rest_modes(system, rotation, K, V, free, interface_modes)
    free[axial[axial[:, 1] >= 0, 1]] = False
    V = np.hstack([V, _following(K, np.hstack(breathing), free), rest])
    V = np.asarray(rotation @ V)
    points = np.flatnonzero(active & (system.w > 0.0))
    return _basis(system, V, probe, points, reference.proper, active_length)


def with_friction_points(system: System, basis: PlateBasis, count: int) -> System:
    """Reduced system with at most ``count`` friction points in place of ``basis.active``.

    Their limits are positive and have the same sum; see
    :func:`skfem_joint.hyper_reduction.with_merged_points`. Three for each mode serve well.

    Parameters
    ----------
    system : System
        The full one.
    """
    reduced = system.project(basis.V)
    return with_merged_points(reduced, basis.velocities, basis.active, count)[0]


def active_area_fraction(
    structure: PlateStructure, system: System, slip_peak: FloatArray, period: float
) -> dict[str, float]:
    """Share of each joint's contact area that slips, by joint name.

    See :func:`slips` for ``slip_peak`` (m) and ``period`` (s). Held nodes do not slip.
    """
    active = slips(structure, system, slip_peak, period)
    fractions = {}
    for patch in structure.patches:
        area = float(patch.area.sum()) + patch.held_area
        slipping = patch.area[active[patch.points]].sum()
        fractions[patch.joint.name] = float(slipping / area) if area > 0.0 else 0.0
    return fractions


def slips(
    structure: PlateStructure, system: System, slip_peak: FloatArray, period: float
) -> NDArray[np.bool_]:
    """Contact points that slip rather than creep, shape (m,).

    Their largest slip, ``slip_peak`` (m), exceeds a thousandth of the largest in their joint, and
    also what the arctan law lets a point creep at half of its limit, 1 / beta, for a ``period`` (s)
    of the load.
    """
    active = np.zeros(system.w.size, dtype=np.bool_)
    for patch in structure.patches:
        points = patch.points[system.w[patch.points] > 0.0]
        least = np.maximum(
            THRESHOLD * slip_peak[points].max(initial=0.0), period / system.beta[points]
        )
        active[points] = slip_peak[points] > least
    return active


def _basis(
    system: System,
    V: FloatArray,
    run: Run,
    active: IntArray,
    proper: ProperModes,
    active_length: Mapping[str, float],
) -> PlateBasis:
    V = orthonormal(V, system.M)
    slip = system.slip_norm((system.B @ run.v.T).T)
    return PlateBasis(
        V=V,
        slip_velocity=float(slip.max(initial=0.0)),
        velocities=np.asarray(run.v @ (system.M @ V)),
        active=active,
        proper=proper,
        active_length=active_length,
        missed=_missed(system, V, run.u[:: max(1, -(-len(run.u) // MOST_TIMES))]),
    )


def _missed(system: System, V: FloatArray, u: FloatArray) -> float:
    """Norm of strain energy of what is left of displacements beside their projection, relative."""
    left = u - (u @ (system.M @ V)) @ V.T
    energies = [float(np.vdot(x, (system.K @ x.T).T)) for x in (left, u)]
    return float(np.sqrt(energies[0] / energies[1])) if energies[1] > 0.0 else 0.0


def _picked(system: System) -> NDArray[np.intp]:
    """Unknown that each row of the slip operator picks."""
    return np.asarray(sparse.csr_array(system.B).indices, dtype=np.intp)


def _axial_unknowns(
    structure: PlateStructure, system: System, axes: Mapping[str, FloatArray]
) -> tuple[sparse.csr_array, NDArray[np.intp]]:
    """Unknowns turned so that slip runs along and across the axis of its joint.

    Returns
    -------
    rotation : sparse array, shape (n, n)
        Orthogonal: the unknowns from the turned ones.
    axial : ndarray of int, shape (m, 2)
        Turned unknown of each contact point along and across the axis, -1 if it has none.
    """
    picked, first = _picked(system), system.first_row
    axial = np.full((system.w.size, 2), -1, dtype=np.intp)
    turned: list[tuple[NDArray[np.intp], NDArray[np.intp], FloatArray]] = []
    for patch in structure.patches:
        a = np.asarray(axes[patch.joint.name], dtype=float)
        frame = np.array([[a[0], a[1]], [-a[1], a[0]]]) / np.linalg.norm(a)
        pair = system.directions[patch.points] == 2
        single = patch.points[~pair]
        along = np.abs(patch.directions[~pair, 0] @ frame[0]) > THRESHOLD
        axial[single, np.where(along, 0, 1)] = picked[first[single]]
        if not np.any(pair):
            continue
        points = patch.points[pair]
        rows = first[points]
        both = np.stack([picked[rows], picked[rows + 1]], axis=1)
        axial[points] = both
        # Turned unknown c is frame[c] . (sum of direction d times unknown d).
        blocks = np.einsum("pdx,cx->pdc", patch.directions[pair], frame)
        shape = blocks.shape
        turned.append(
            (
                np.broadcast_to(both[:, :, np.newaxis], shape).ravel(),
                np.broadcast_to(both[:, np.newaxis, :], shape).ravel(),
                blocks.ravel(),
            )
        )
    done = [rows for rows, _, _ in turned]
    rest = np.setdiff1d(np.arange(system.n), np.concatenate([*done, picked[:0]]))
    turned.append((rest, rest, np.ones(rest.size)))
    row, column, value = (np.concatenate(parts) for parts in zip(*turned, strict=True))
    return sparse.csr_array((value, (row, column)), shape=(system.n, system.n)), axial


def _on(columns: NDArray[np.intp], values: FloatArray, n: int) -> FloatArray:
    """Vectors of the turned unknowns with the values of contact points, (n, modes)."""
    block = np.zeros((n, values.shape[1]))
    block[columns[columns >= 0]] = values[columns >= 0]
    return block


def _ends(
    patch: Patch,
    along: FloatArray,
    slip_peak: FloatArray,
    asked: float | None,
    moving: float,
) -> list[tuple[FloatArray, float]]:
    """Distance of a patch's points from each end that slips, and the active length there, m.

    The stretch that sticks is the longest one along the axis without a point that slips.
    """
    low, high = float(along.min()), float(along.max())
    name, extent = patch.joint.name, high - low
    if asked is not None and not 0.0 < asked <= extent * (1.0 + 1e-9):
        raise InputError(
            f"active length of joint {name!r}: found {asked:.6g} m, must be above 0 and at most "
            f"the joint's {extent:.6g} m along its axis"
        )
    peak = slip_peak[patch.points]
    slips = peak > THRESHOLD * max(float(peak.max()), THRESHOLD * moving)
    if not np.any(slips):
        return []
    inside = np.concatenate([[low], np.sort(along[slips]), [high]])
    gap = int(np.argmax(np.diff(inside)))
    sticks = np.sort(along[~slips])
    between = sticks[(sticks > inside[gap]) & (sticks < inside[gap + 1])]
    ends = []
    if between.size == 0:  # all of it slips: one zone, from the end that slips most
        from_low = peak[np.argmin(along)] >= peak[np.argmax(along)]
        ends.append((along - low if from_low else high - along, extent))
    else:
        if inside[gap] > low:
            ends.append((along - low, float(between[0] - low)))
        if inside[gap + 1] < high:
            ends.append((high - along, float(high - between[-1])))
    return [(distance, length if asked is None else asked) for distance, length in ends]


def _following(K: sparse.csr_array, V: FloatArray, free: NDArray[np.bool_]) -> FloatArray:
    """Let the free unknowns follow the others with the least strain energy."""
    inner = np.flatnonzero(free)
    if inner.size:
        V[inner] = splu(sparse.csc_array(K[inner][:, inner])).solve(-(K[inner] @ V))
    return V


def _rest_modes(
    system: System,
    rotation: sparse.csr_array,
    K: sparse.csr_array,
    V: FloatArray,
    free: NDArray[np.bool_],
    interface_modes: int,
) -> FloatArray:
    """Static response of the free unknowns to the loads, and their fixed-interface modes.

    As in the method of Craig and Bampton (AIAA J. 6, 1968). The lowest modes of a plate are bending
    modes, which a pull does not excite: those are taken that share most in the static response to
    the loads or in the inertia of the prescribed motion ``V``.
    """
    inner = np.flatnonzero(free)
    linear = np.setdiff1d(np.arange(system.n), _picked(system))
    rest: list[FloatArray] = []
    if linear.size:
        K_inner = sparse.csc_array(K[inner][:, inner])
        factor = splu(K_inner)
        vectors = (np.asarray(rotation.T @ load.vector) for load in system.loads)
        rest += [
            factor.solve(f[inner])
            for f in vectors
            if np.abs(f[inner]).max() > 1e-9 * np.abs(f).max()
        ]
    if linear.size and interface_modes > 0:
        M = sparse.csr_array(rotation.T @ system.M @ rotation)
        most = min(inner.size, max(MOST_INTERFACE_MODES, interface_modes))
        frequency, shapes = fixed_interface_modes(replace(system, M=M, K=K), inner, most)
        inertia = shapes.T @ (M[inner] @ V) / np.sqrt(np.einsum("ij,ij->j", V, M @ V))
        share = (inertia**2).sum(axis=1)
        for static in rest:
            part = (shapes.T @ (K_inner @ static) / frequency) ** 2
            share += part / part.sum()
        chosen = np.sort(np.argsort(-share, kind="stable")[:interface_modes])
        rest += list(shapes[:, chosen].T)
    block = np.zeros((system.n, len(rest)))
    if rest:
        block[inner] = np.stack(rest, axis=1)
    return block
