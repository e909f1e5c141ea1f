"""Reduced bases of structures: modes of its static slip path, of its own run, or scaled ones.

Beside modes of the static path (:mod:`skfem_joint.reduction.static_path`) stand static responses to
the loads, fixed-interface modes with a share in the response that the others cannot follow, and
rigid motions where friction alone holds a body and does not hold it.

Scaled modes are those of the paper's reference joint, stretched over each active zone along the
axis of its joint, zero in the grey length. They prescribe the slip along the axis; the slip across
it, and all that is not in contact, follows statically with the least strain energy (rigidly, where
nothing else holds it). As friction resists the slip across, as many modes that breathe across stand
beside them: without them friction energy errs by 22 % in a joint of two plates, with them by 0.2 %.
Static responses to the loads and fixed-interface modes complete them, as in the method of Craig and
Bampton (AIAA J. 6, 1968). All this holds for pulling along the axis: the joint does not bend in it.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import sparse

from skfem_joint.arrays import BoolArray, FloatArray, IntArray, slip_norms
from skfem_joint.errors import InputError
from skfem_joint.linalg.factors import factorised
from skfem_joint.linalg.schur import Uncondensed
from skfem_joint.modes import eigenmodes
from skfem_joint.reduction.active_length import THRESHOLD
from skfem_joint.reduction.pod import (
    ProperModes,
    orthonormal,
    proper_decomposition,
    proper_modes,
    stride_of,
    thinned,
)
from skfem_joint.reduction.reference import ReferenceModes, paper_reference
from skfem_joint.reduction.static_path import (
    BLIND,
    StaticPath,
    energy,
    interface_modes,
    slip_path,
)
from skfem_joint.reduction.zones import (
    Zone,
    active_zones,
    axis_of,
    motions_without_slip,
    mouths,
    probed,
    zone_lengths,
)
from skfem_joint.stepping.integrate import integrate_plan
from skfem_joint.stepping.plan import Plan
from skfem_joint.stepping.recording import Run, Save
from skfem_joint.structure import AnyStructure, Structure
from skfem_joint.system import System
from skfem_joint.unknowns import congruent

if TYPE_CHECKING:
    from skfem_joint.stepping.quasi_static import QuasiStatic

#: Cycles of a run that modes come from.
TRAINING_CYCLES = 3
#: Share of a run that the modes made with it may miss without a word, and at all.
DOUBTFUL_BASIS, WRONG_BASIS = 0.1, 0.5
# Fixed-interface modes to choose from; share in the response, relative to the largest, with which
# they count; times of a run that a decomposition takes.
_MOST_INTERFACE_MODES, _LEAST_SHARE, _MOST_TIMES = 40, 1e-4, 300
#: Interface modes beside modes of the static path: share in the response, and most beside few.
_SHARE, _MOST = 1e-2, 2
#: Share of the largest slip velocity that modes of the static path resolve, and of the largest
#: singular value below which they are what is left of its tolerance.
_RESOLVED, _TOLD = 1e-5, 1e-7


@dataclass(frozen=True)
class Options:
    """What a reduced model is made of: names and values of a scene's table `reduction`.

    ``active_length`` is "auto" (measured in a probe), "estimate", or a length (m) for all
    joints or by name; the others are "auto" or what they say.
    """

    reference: str = "static"
    modes: str | int = "auto"
    interface_modes: str | int = "auto"
    snapshots: str = "both"
    inner_product: str = "auto"
    active_length: str | float | Mapping[str, float] = "auto"
    friction_points: str | int = "auto"
    beta: str | float = "auto"

    @property
    def mode_count(self) -> int:
        """Number of joint modes: of each zone with the paper's modes, else of the run."""
        automatic = 5 if self.reference == "paper" else 12
        return automatic if isinstance(self.modes, str) else self.modes

    @property
    def friction(self) -> dict[str, Any]:
        """Friction points and steepness, as `reduced_system` takes them."""
        return {"friction_points": self.friction_points, "beta": self.beta}

    @property
    def product(self) -> str:
        """Name of the inner product."""
        automatic = "euclidean" if self.reference == "paper" else "energy"
        return automatic if self.inner_product == "auto" else self.inner_product


@dataclass(frozen=True)
class Basis:
    """Basis of a reduced structure, and what the course that it comes from tells about it."""

    V: FloatArray  #: (n, j), mass-orthonormal; ``system.project(V)`` has all contact points
    modes: int  #: joint modes: of each zone, or of the path or run
    proper: ProperModes  #: decomposition that they come from
    slip_velocity: float  #: largest in the course, m/s
    velocities: FloatArray  #: (times, j), of the coordinates: friction points fit them
    slip_peak: FloatArray  #: (m,), largest slip of each contact point in the course, m
    active: IntArray  #: contact points with friction that move in the basis
    missed: float  #: share of the course that it cannot follow, in the norm of strain energy
    resolved: float = 1e-4  #: share of the largest slip velocity that the modes resolve
    stiffness: Uncondensed | None = None  #: of the system, condensed, if that is there
    reference: ReferenceModes | None = None  #: what scaled modes come from
    active_length: Mapping[str, float] = field(default_factory=dict)  #: of scaled modes, by joint
    #: Points and positions (m) of each active zone, where they lie along a line.
    stretches: tuple[tuple[IntArray, FloatArray], ...] | None = None
    notes: tuple[str, ...] = ()  #: sentences that users should read about how it was made

    @property
    def followed(self) -> FloatArray:
        """Motions of the course that the modes come from (n, s), where it is the system's own."""
        proper = self.proper
        own = proper.modes * proper.singular_values
        return own if self.reference is None else np.zeros((len(self.V), 0))


def make_basis(
    structure: AnyStructure,
    system: System,
    options: Options,
    plan: Plan,
    *,
    enriched: bool = False,
    path: QuasiStatic | None = None,
) -> Basis:
    """Basis of a structure as its options say; does the run that it needs.

    ``plan`` is that of the run to come; a quasi-static ``path`` of the system may have factors for
    the static one. The basis' ``notes`` say what to beware of. A basis that misses too much raises
    InputError, unless it is to be ``enriched`` before it is used: then its notes say so. InputError
    if nothing moves, or the modes do not fit; KeyboardInterrupt if a run is interrupted.
    """
    notes: list[str] = []
    modes, interface = options.mode_count, options.interface_modes
    decomposed = {"snapshots": options.snapshots, "inner_product": options.product}
    if options.reference == "self":
        training = plan if plan.cycle_steps is None else plan.first(TRAINING_CYCLES)
        training = replace(training, save=Save(fields=True, points=False), cycle_steps=None)
        run = integrate_plan(system, training).finished()
        basis = own_basis(system, run, modes, interface_modes=interface, **decomposed)
    elif options.reference == "static":
        found = slip_path(system, plan, modes, path)
        if found.blind > BLIND:
            notes.append(
                f"The slip went on growing while the modes were made: {100 * found.blind:.2g} % of "
                "what slips at last stuck in the round before. Use more modes and see whether the "
                "result stays, or take reference = 'self'."
            )
        basis = static_basis(system, found, modes, interface)
    elif options.reference == "paper":
        meshed = structure.meshed(
            "reduction.reference: found 'paper', whose modes are laid along a mesh; take 'static' "
            "or 'self' instead"
        )
        zones = active_zones(meshed, system)
        probe = probed(system, zones, plan)
        lengths, about = zone_lengths(system, zones, options.active_length, probe.slip_peak)
        notes += about
        made = paper_reference(**decomposed), zones, lengths, probe
        basis = scaled_basis(meshed, system, *made, modes=modes, interface_modes=interface)
    else:
        raise InputError(
            f"reduction.reference: found {options.reference!r}, must be 'static', 'self' or 'paper'"
        )
    if options.active_length != "auto" and options.reference != "paper":
        notes.append("reduction.active_length has no effect but beside reference = 'paper'.")
    own = "; or take reference = 'static'" if options.reference == "paper" else ""
    missed = (
        f"The {basis.V.shape[1]} vectors of the reduced model cannot follow "
        f"{100 * min(basis.missed, 1.0):.2g} % of the full model's displacement (norm of strain "
        f"energy); use more modes{own}."
    )
    if basis.missed > WRONG_BASIS and not enriched:
        raise InputError(missed)
    if basis.missed > DOUBTFUL_BASIS:
        notes.append(missed)
    return replace(basis, notes=tuple(notes))


def own_basis(
    system: System,
    run: Run,
    modes: int,
    *,
    snapshots: str = "both",
    inner_product: str = "energy",
    interface_modes: str | int = "auto",
) -> Basis:
    """Proper orthogonal modes of a system's own run with stored fields, of at most 300 times.

    ``snapshots`` and ``inner_product`` are as in `skfem_joint.reduction.pod`; ``interface_modes``
    are fixed-interface modes beside them, "auto": none. InputError if nothing moves in the run, or
    its snapshots make fewer modes than asked for.
    """
    every = stride_of(len(run.u), _MOST_TIMES)
    proper = proper_modes(run, snapshots=snapshots, inner_product=inner_product, every=every)
    if not 1 <= modes <= proper.modes.shape[1]:
        raise InputError(
            f"reduction.modes: found {modes}, must be from 1 to {proper.modes.shape[1]}, which "
            "the snapshots of the run can make"
        )
    V, F = proper.modes[:, :modes], motions_without_slip(system)
    if not isinstance(interface_modes, str) and interface_modes > 0 and F.shape[1]:
        V = np.hstack([V, F @ eigenmodes(*_within(system, F), interface_modes)[1]])
    velocity = float(system.slip_norm((system.B @ run.v.T).T).max(initial=0.0))
    course = run.u, run.v, run.slip_peak, velocity
    return _basis(system, V, modes, proper, system.w > 0.0, *course)


def static_basis(
    system: System, path: StaticPath, modes: int, interface: str | int = "auto"
) -> Basis:
    """Proper orthogonal modes of a static path, in the norm of strain energy.

    Fewer ``modes`` where the path makes no more. Of fixed-interface modes those with the largest
    share in the response; "auto": beyond what the others follow more than a hundredth, at most one
    for six modes, or two.
    """
    proper = proper_decomposition(path.snapshots, energy(system))
    told = proper.singular_values > _TOLD * proper.singular_values[0]
    modes = min(modes, int(np.count_nonzero(told)))
    V = np.hstack([proper.modes[:, :modes], path.response, path.rigid])
    count = max(_MOST, modes // 6) if isinstance(interface, str) else interface
    shapes, share = path.interface[:, :count], path.share[:count]
    if count > share.size:
        shapes, share = interface_modes(system, path.response, path.loads, 2 * count)
        shapes, share = shapes[:, :count], share[:count]
    if isinstance(interface, str) and share.size:
        W = orthonormal(V, system.M)
        left = shapes - W @ (W.T @ (system.M @ shapes))
        size, whole = (np.einsum("ij,ij->j", x, system.K @ x) for x in (left, shapes))
        shapes = shapes[:, share * np.sqrt(size / whole) > _SHARE]
    V = np.hstack([V, shapes])
    run = path.run
    u = np.linalg.qr(run.u, mode="r") @ path.V.T  # few states of the same energies, added up
    slip = path.slip_peak  # sharper than the run's
    if path.rigid.size:
        slip = system.slip_norm(run.u @ (system.B @ path.V).T).max(axis=0)
    few = run.system
    velocity = float(few.slip_norm(run.v @ np.asarray(few.B).T).max(initial=0.0))
    basis = _basis(system, V, modes, proper, system.w > 0.0, u, path.V.T, slip, velocity)
    velocities = thinned(run.v, _MOST_TIMES) @ basis.velocities
    return replace(basis, velocities=velocities, stiffness=path.stiffness, resolved=_RESOLVED)


def stuck_basis(
    system: System, stuck: FloatArray, u: FloatArray, v: FloatArray, modes: int, frequency: float
) -> Basis:
    """Modes (n, k) with the contact stuck, and proper orthogonal ones of what slips beside them.

    ``u`` are states, ``v`` increments (levels, n), m; each counts as much as the others, however
    far it slips. What is merged slips alike in them, at most at a ``frequency`` (Hz).
    """
    slips = np.vstack([u, v])
    slips = slips - (slips @ (system.M @ stuck)) @ stuck.T
    size = np.sqrt(np.maximum(np.einsum("ij,ij->i", slips, (system.K @ slips.T).T), 0.0))
    slips = slips[size > _TOLD * size.max()] / size[size > _TOLD * size.max(), np.newaxis]
    proper = proper_decomposition(slips, energy(system))
    V = np.hstack([stuck, proper.modes[:, :modes]])
    slip_peak = system.slip_norm((system.B @ u.T).T).max(axis=0)
    velocity = 2.0 * np.pi * frequency * float(slip_peak.max())
    return _basis(system, V, modes, proper, system.w > 0.0, u, slips, slip_peak, velocity)


def scaled_basis(
    structure: Structure,
    system: System,
    reference: ReferenceModes,
    zones: Sequence[Zone],
    lengths: Sequence[float],
    probe: Run,
    *,
    modes: int = 5,
    interface_modes: str | int = "auto",
) -> Basis:
    """Reference modes scaled along each zone, so many for each, carried into the structure.

    ``probe`` is the run that the lengths of the zones are measured in. ``interface_modes`` are the
    lowest modes of what is not prescribed that take part in the response; "auto": as many as lie
    below twice the loads' highest frequency, at least two; four for loads without.
    """
    along, across, sideways = _slip_vectors(structure, system)
    active = np.zeros(system.w.size, dtype=bool)
    pulled, breathing, stretches = [], [], []
    whole: dict[str, float] = {}
    for zone, length in zip(zones, lengths, strict=True):
        whole[zone.name] = whole.get(zone.name, 0.0) + length
        free = zone.points >= 0
        points, distance, x = zone.points[free], zone.distance[free], structure.nodes[zone.nodes]
        values = reference.at(1.0 - distance / length, modes)
        middle = 0.5 * (x.max(axis=0) + x.min(axis=0))
        offset = ((x[free] - middle) * sideways[points]).sum(axis=1)
        pulled.append(along[:, points] @ values)
        breathing.append(across[:, points] @ (values * offset[:, np.newaxis]))
        inside = distance < length
        active[points[inside]] = True
        stretches.append((points[inside], distance[inside]))
    F = motions_without_slip(system)
    turning = across[:, active & (np.diff(across.indptr) > 0)]
    wide = sparse.csc_array(sparse.hstack([F, turning]))
    parts = [_following(system, wide, np.hstack(pulled))]
    parts.append(_following(system, F, np.hstack(breathing)))
    if F.shape[1]:
        parts += _rest_modes(system, wide, parts[0], interface_modes)
    slips = slip_norms(probe.point_v, system.directions[mouths(zones)])
    course = probe.u, probe.v, probe.slip_peak, float(slips.max(initial=0.0))
    carrying = active & (system.w > 0.0)
    basis = _basis(system, np.hstack(parts), modes, reference.proper, carrying, *course)
    lines = all(zone.is_line for zone in zones) and np.all(system.directions[active] == 1)
    ordered = tuple(stretches) if lines else None
    return replace(basis, reference=reference, active_length=whole, stretches=ordered)


def _slip_vectors(
    structure: Structure, system: System
) -> tuple[sparse.csc_array, sparse.csc_array, FloatArray]:
    """Unknowns (n, m) of a unit slip of each contact point along and across its joint's axis.

    Along: times the share of the axis in the point's slip directions. The directions (m, dim) of
    the slip across come third; zero for points that slip along the axis alone.
    """
    m = system.w.size
    directions, axis = np.zeros((m, 2, structure.dim)), np.zeros((m, structure.dim))
    for patch in structure.patches:
        directions[patch.points, : patch.directions.shape[1]] = patch.directions
        axis[patch.points] = axis_of(structure.body, patch.joint)
    along, across = np.einsum("mkd,md->mk", directions, axis), np.zeros((m, 2))
    size = np.linalg.norm(along, axis=1)[:, np.newaxis]
    lone = (system.directions == 1) & (size[:, 0] <= THRESHOLD)
    along[lone], across[lone] = 0.0, [1.0, 0.0]
    pair = system.directions == 2
    turned = along[:, ::-1] * [-1.0, 1.0] / np.where(size > 0.0, size, 1.0)
    across[pair] = np.where(size > 0.0, turned, [0.0, 1.0])[pair]
    has = system.directions[:, np.newaxis] > [0, 1]
    place = np.arange(np.count_nonzero(has)), np.repeat(np.arange(m), system.directions)
    A, C = (sparse.csr_array((x[has], place), shape=(len(place[0]), m)) for x in (along, across))
    C.eliminate_zeros()
    B = sparse.csr_array(system.B)
    sideways = np.einsum("mk,mkd->md", across, directions)
    return sparse.csc_array(B.T @ A), sparse.csc_array(B.T @ C), sideways


def _within(system: System, F: sparse.csc_array) -> tuple[sparse.csc_array, sparse.csc_array]:
    """Stiffness and mass of motions in the columns of F."""
    K, M = (sparse.csc_array(congruent(A, F)) for A in (system.K, system.M))
    return K, M


def _following(system: System, F: sparse.csc_array, V: FloatArray) -> FloatArray:
    """Let the columns of F follow prescribed motions with the least strain energy."""
    if F.shape[1] == 0:
        return V
    return np.asarray(V - F @ factorised(_within(system, F)[0])(F.T @ (system.K @ V)))


def _rest_modes(
    system: System, F: sparse.csc_array, V: FloatArray, asked: str | int
) -> list[FloatArray]:
    """Static responses to the loads within F, and fixed-interface modes of it.

    Those modes count that share in the static response to the loads or in the inertia of the
    prescribed motions V: the lowest modes of a plate bend it, which a pull does not excite.
    """
    K, M = _within(system, F)
    loads = system.load_vectors()
    forces = F.T @ loads
    forces = forces[:, np.abs(forces).max(axis=0) > 1e-9 * np.abs(loads).max(axis=0)]
    found = [F @ factorised(K)(forces)] if forces.size else []
    if asked == 0:
        return found
    count = 0 if isinstance(asked, str) else asked
    frequency, shapes = eigenmodes(K, M, min(K.shape[0], max(_MOST_INTERFACE_MODES, count)))
    size = np.sqrt(np.einsum("ij,ij->j", V, system.M @ V))
    inertia = shapes.T @ (F.T @ (system.M @ V)) / np.where(size > 0.0, size, 1.0)
    static = (shapes.T @ forces / frequency[:, np.newaxis]) ** 2
    share = (inertia**2).sum(axis=1) + (static / static.sum(axis=0)).sum(axis=1)
    counting = np.flatnonzero(share > _LEAST_SHARE * share.max())
    if isinstance(asked, str):
        fastest = [f for load in system.loads if (f := load.amplitude.highest_frequency)]
        below = frequency[counting] <= 2.0 * max(fastest, default=0.0)
        count = max(2, int(np.count_nonzero(below))) if fastest else 4
    return [*found, F @ shapes[:, counting[:count]]]


def _basis(
    system: System,
    V: FloatArray,
    modes: int,
    proper: ProperModes,
    active: BoolArray,
    u: FloatArray,
    v: FloatArray,
    slip_peak: FloatArray,
    slip_velocity: float,
) -> Basis:
    """Basis with what displacement and velocity (times, n) of its course tell about it."""
    V = orthonormal(orthonormal(V, system.M), system.M)  # once leaves what is nearly dependent
    velocities = np.asarray(v @ (system.M @ V))
    u = thinned(u, _MOST_TIMES)
    left = u - (u @ (system.M @ V)) @ V.T
    energies = [float(np.vdot(x, (system.K @ x.T).T)) for x in (left, u)]
    missed = float(np.sqrt(energies[0] / energies[1])) if energies[1] > 0.0 else 0.0
    points = np.flatnonzero(active)
    return Basis(V, modes, proper, slip_velocity, velocities, slip_peak, points, missed)
