"""Reduced bases: reference modes scaled to active lengths, carried into a structure.

A joint's end where force enters is the mouth of an *active zone*. Over each zone the reference
modes are stretched to the zone's active length, zero in the grey length. The linear regions follow
by their static response to the motion of the mouths (rigidly, where nothing else holds them), and
get their static response to each load (attachment modes) and their fixed-interface modes, as in the
method of Craig and Bampton (AIAA J. 6, 1968).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import eigsh, splu

from skfem_joint.active_length import THRESHOLD, Estimate, estimate, measured
from skfem_joint.errors import InputError
from skfem_joint.pod import ProperModes, orthonormal, proper_modes
from skfem_joint.structure import Joint, Structure
from skfem_joint.system import System

FloatArray = NDArray[np.float64]

#: What the snapshots of a proper orthogonal decomposition hold.
SNAPSHOTS = ("both", "displacement", "rates")


@dataclass(frozen=True)
class ReferenceModes:
    """Proper orthogonal modes of a reference joint on a unit active length.

    Attributes
    ----------
    xi : ndarray, shape (k,)
        Increasing, 0 at the interface of grey and active length, 1 at the loaded end.
    modes : ndarray, shape (k, r)
        Values there.
    proper : ProperModes
        The decomposition they come from.
    active_length : float
        Active length of the reference joint, m.
    """

    xi: FloatArray
    modes: FloatArray
    proper: ProperModes
    active_length: float

    def at(self, xi: FloatArray, count: int) -> FloatArray:
        """First ``count`` modes at the positions ``xi``, zero for xi <= 0, by cubic splines."""
        from scipy.interpolate import CubicSpline

        if not 1 <= count <= self.modes.shape[1]:
            raise InputError(f"modes: found {count}, must be from 1 to {self.modes.shape[1]}")
        values = CubicSpline(self.xi, self.modes[:, :count])(np.clip(xi, 0.0, 1.0))
        return np.where(xi[:, np.newaxis] > 0.0, values, 0.0)


def snapshot_matrix(u: FloatArray, v: FloatArray, kind: str) -> FloatArray:
    """Snapshots of displacement (the paper's), of displacement and velocity, or of rates.

    Friction acts on velocities: modes that also span them err less in energy. Both histories
    are divided by their norms, so that units do not matter. ``rates`` are velocity and acceleration
    (differences of velocities), with each instant weighed by the root of its norm alone: where
    slip starts anew, velocities are small and friction changes most. Five modes leave 4.1 % of the
    reference system's friction energy with ``both`` and 0.8 % with ``rates``; 4.8 and 3.0 % of the
    structure's under harmonic load, 2.2 and -0.1 % in Case VI; but 1.4 and 2.7 % in Case I, whose
    peak errs by 1.3 % instead of 0.4 %.
    """
    if kind == "displacement":
        return u
    if kind == "both":
        return np.vstack([u / np.linalg.norm(u), v / np.linalg.norm(v)])
    if kind == "rates":
        return np.vstack([_evened(v), _evened(np.diff(v, axis=0))])
    raise InputError(f"snapshots: found {kind!r}, must be one of {', '.join(SNAPSHOTS)}")


def _evened(x: FloatArray) -> FloatArray:
    """Rows over the square roots of their norms, so that slow instants count for more; no units."""
    size = np.linalg.norm(x, axis=1)
    return np.asarray(x / np.sqrt(np.maximum(size, 1e-9 * size.max()) * size.max())[:, np.newaxis])


def reference_modes(
    distance: FloatArray,
    u: FloatArray,
    v: FloatArray,
    peak: FloatArray,
    *,
    snapshots: str = "both",
    mass: FloatArray | None = None,
    threshold: float = THRESHOLD,
) -> ReferenceModes:
    """Modes of a reference joint's history, normalised to its active length.

    Parameters
    ----------
    distance : ndarray, shape (m,)
        Distance of the joint's nodes from the loaded end, in the order of the columns of ``u``, m.
    u, v : ndarray, shape (times, m)
        Displacement and velocity history.
    peak : ndarray, shape (m,)
        Largest displacement of each node, m.
    """
    order = np.argsort(distance)
    length = measured(distance[order], peak[order], threshold)
    proper = proper_modes(snapshot_matrix(u, v, snapshots), mass)
    ascending = order[::-1]
    xi = 1.0 - distance[ascending] / length
    modes = proper.modes[ascending]
    # One more point beyond the grey end, where the support holds: zero.
    xi = np.concatenate([[2.0 * xi[0] - xi[1]], xi])
    modes = np.vstack([np.zeros(modes.shape[1]), modes])
    return ReferenceModes(xi, modes, proper, length)


@dataclass(frozen=True)
class Zone:
    """End of a joint where force enters.

    Attributes
    ----------
    joint : Joint
    nodes : ndarray of int
        Nodes of the joint's stretch from the mouth inwards.
    distance : ndarray
        Their distance from the mouth, m.
    tau : float
        Friction limit per length, averaged over the stretch, N/m.
    """

    joint: Joint
    nodes: NDArray[np.intp]
    distance: FloatArray
    tau: float

    @property
    def length(self) -> float:
        """Length of the joint's stretch, m: the most that can be active."""
        return float(self.distance[-1])

    @property
    def name(self) -> str:
        """Name of the joint."""
        return self.joint.region


def active_zones(structure: Structure, system: System) -> list[Zone]:
    """Find the ends of joints where force enters.

    Raises
    ------
    InputError
        Where scaled modes cannot follow: a load inside a joint, or joints that touch.
    """
    x = structure.position
    vectors = np.abs(structure.expand(system.load_vectors().T)).sum(axis=0)
    loaded = set(np.flatnonzero(vectors).tolist())
    fixed = set(structure.fixed_nodes.tolist())
    owner = np.full(structure.bar.mesh.t.shape[1], -1)
    for k, joint in enumerate(structure.joints):
        owner[structure.bar.regions[joint.region]] = k
    edges = np.flatnonzero(np.diff(np.concatenate([[-2], owner, [-2]])))
    zones: list[Zone] = []
    for first, last in pairwise(edges):  # stretches of elements
        if owner[first] < 0:
            continue
        joint = structure.joints[owner[first]]
        nodes = np.arange(first, last + 1)
        if loaded & set(nodes[1:-1].tolist()):
            raise InputError(
                f"joint {joint.region!r}: a load acts inside it; scaled reference modes hold for "
                'loads at a joint\'s end or on a linear region. Use reference = "self".'
            )
        middle = 0.5 * (x[first:last] + x[first + 1 : last + 1])
        per_length = np.interp(
            middle,
            x[structure.bar.mesh.t[:, structure.bar.regions[joint.region]]].mean(axis=0),
            structure.friction_per_length(joint),
        )
        tau = float(np.average(per_length, weights=np.diff(x[first : last + 1])))
        for inward, mouth, beyond in ((nodes, nodes[0], first - 1), (nodes[::-1], nodes[-1], last)):
            if int(mouth) in fixed:
                continue
            has_neighbour = 0 <= beyond < owner.size
            if has_neighbour and owner[beyond] >= 0:
                raise InputError(
                    f"joint {joint.region!r} touches another joint; scaled reference modes need "
                    'a linear region between them. Use reference = "self".'
                )
            if has_neighbour or int(mouth) in loaded:
                zones.append(Zone(joint, inward, np.abs(x[inward] - x[mouth]), tau))
    return zones


def _linear_unknowns(structure: Structure) -> NDArray[np.intp]:
    """Unknowns outside all joints."""
    inside = np.zeros(structure.n_nodes, dtype=bool)
    for joint in structure.joints:
        inside[structure.bar.region_nodes(joint.region)] = True
    return np.flatnonzero(~inside[structure.free])


def estimate_active_length(
    structure: Structure, system: System, zone: Zone, amplitudes: Sequence[float], frequency: float
) -> Estimate:
    """Active length of a zone from the linear analysis of the structure, section 6.1.

    The static force at the zone's mouth, with all joints stuck, gives the static length; the
    first natural frequency of what moves with the active part gives A_a.

    Parameters
    ----------
    amplitudes : sequence of float
        Amplitude of each of the system's loads, N (superposed: sum over the harmonics).
    frequency : float
        Excitation frequency, Hz.
    """
    K = sparse.csr_array(system.K)
    M = sparse.csr_array(system.M)
    unknown = np.full(structure.n_nodes, -1)
    unknown[structure.free] = np.arange(structure.free.size)
    mouth = unknown[zone.nodes[0]]
    linear = _linear_unknowns(structure)
    force = sum(
        abs(a) * np.abs(load.vector) for a, load in zip(amplitudes, system.loads, strict=True)
    )
    at_mouth = float(np.asarray(force)[mouth])
    if linear.size:
        u = splu(sparse.csc_array(K[linear][:, linear])).solve(np.asarray(force)[linear])
        at_mouth += abs(float((K[[mouth]][:, linear] @ u)[0]))
    static = at_mouth / zone.tau

    @cache
    def frequency_up_to(node: int) -> float:
        """Natural frequency of what moves when the zone moves up to one of its nodes."""
        moving = unknown[zone.nodes[:node]]
        moving = np.union1d(np.append(moving[moving >= 0], mouth), linear)
        return _first_frequency(K, M, moving)

    def frequency_of(length: float) -> float:
        """Natural frequency, interpolated between the nodes on both sides of the length."""
        last = zone.nodes.size - 1
        node = min(int(np.searchsorted(zone.distance, length)) - 1, last)
        a, b = zone.distance[node], zone.distance[min(node + 1, last)]
        fa, fb = frequency_up_to(node), frequency_up_to(min(node + 1, last))
        if b == a or length >= b:
            # Beyond the joint the moving length is capped only by the formula.
            return fb * (b / length if linear.size == 0 else 1.0)
        share = (length - a) / (b - a)
        return float((1.0 - share) * fa + share * fb)

    return estimate(static, frequency, frequency_of)


def _first_frequency(K: sparse.csr_array, M: sparse.csr_array, moving: NDArray[np.intp]) -> float:
    Kr, Mr = K[moving][:, moving], M[moving][:, moving]
    if moving.size < 20:
        from scipy.linalg import eigh

        value = eigh(Kr.toarray(), Mr.toarray(), eigvals_only=True)[0]
    else:
        value = eigsh(
            sparse.csc_array(Kr),
            k=1,
            M=sparse.csc_array(Mr),
            sigma=0.0,
            return_eigenvectors=False,
            v0=np.ones(moving.size),
        )[0]
    return float(np.sqrt(value) / (2.0 * np.pi))


def structure_basis(
    structure: Structure,
    system: System,
    reference: ReferenceModes,
    zones: Sequence[Zone],
    lengths: Sequence[float],
    *,
    modes: int = 5,
    interface_modes: int = 2,
) -> FloatArray:
    """Reduced basis of a structure with joints.

    Parameters
    ----------
    zones : sequence of Zone
    lengths : sequence of float
        Active length of each zone, m.
    modes : int
        Reference modes of each zone.
    interface_modes : int
        Fixed-interface modes of the linear regions.

    Returns
    -------
    ndarray, shape (n, j)
        Mass-orthonormal; directions that depend on others are dropped.
    """
    n = system.n
    unknown = np.full(structure.n_nodes, -1)
    unknown[structure.free] = np.arange(structure.free.size)
    linear = _linear_unknowns(structure)
    columns = []
    for zone, length in zip(zones, lengths, strict=True):
        if not 0.0 < length <= zone.length * (1.0 + 1e-12):
            raise InputError(
                f"active length of joint {zone.name!r}: found {length:.6g} m, must be above 0 "
                f"and at most the joint's {zone.length:.6g} m"
            )
        block = np.zeros((n, modes))
        rows = unknown[zone.nodes]
        inside = rows >= 0
        block[rows[inside]] = reference.at(1.0 - zone.distance[inside] / length, modes)
        columns.append(block)
    V = np.hstack(columns)
    if linear.size:
        K = sparse.csr_array(system.K)
        K_linear = sparse.csc_array(K[linear][:, linear])
        factor = splu(K_linear)
        V[linear] = factor.solve(-(K[linear] @ V))
        extra = [
            factor.solve(load.vector[linear])
            for load in system.loads
            if np.any(load.vector[linear])
        ]
        if interface_modes > 0:
            extra.extend(fixed_interface_modes(system, linear, interface_modes)[1].T)
        if extra:
            block = np.zeros((n, len(extra)))
            block[linear] = np.stack(extra, axis=1)
            V = np.hstack([V, block])
    return orthonormal(V, system.M)


def fixed_interface_modes(
    system: System, linear: NDArray[np.intp], count: int
) -> tuple[FloatArray, FloatArray]:
    """Frequencies (Hz) and modes of the linear regions with the joints held."""
    K = sparse.csc_array(sparse.csr_array(system.K)[linear][:, linear])
    M = sparse.csc_array(sparse.csr_array(system.M)[linear][:, linear])
    count = min(count, linear.size)
    if count >= linear.size - 1:
        from scipy.linalg import eigh

        values, vectors = eigh(K.toarray(), M.toarray(), subset_by_index=[0, count - 1])
    else:
        values, vectors = eigsh(K, k=count, M=M, sigma=0.0, v0=np.ones(linear.size))
    return np.sqrt(np.maximum(values, 0.0)) / (2.0 * np.pi), vectors


def interface_modes_needed(
    structure: Structure, system: System, highest_frequency: float | None, factor: float = 2.0
) -> int:
    """Fixed-interface modes below ``factor`` times the loads' highest frequency; at least two."""
    linear = _linear_unknowns(structure)
    if linear.size == 0:
        return 0
    most = min(linear.size, 40)
    frequencies, _ = fixed_interface_modes(system, linear, most)
    if highest_frequency is None:
        return min(4, most)
    return min(max(2, int(np.count_nonzero(frequencies <= factor * highest_frequency))), most)
