"""Reduced bases of structures: modes of the structure's own run, or scaled reference modes.

Modes of the own run are orthogonal in the inner product of energy, by default: with that of mass
the first go to what swings most, which is seldom the joint. At ten modes the friction energy of an
axially pulled plate errs by 1.8 % with the one and 2.7 % with the other, at fourteen by 0.7 % and
2.1 %. Fixed-interface modes beside them bought nothing there.

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
from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from skfem_joint.arrays import BoolArray, FloatArray, IntArray
from skfem_joint.errors import InputError
from skfem_joint.friction import norms
from skfem_joint.reduction.active_length import THRESHOLD
from skfem_joint.reduction.pod import (
    ProperModes,
    inner_matrix,
    orthonormal,
    proper_modes,
    snapshot_matrix,
)
from skfem_joint.reduction.reference import ReferenceModes, paper_reference
from skfem_joint.reduction.zones import (
    Zone,
    ZoneLength,
    active_zones,
    axis_of,
    natural_modes,
    picked,
    zone_lengths,
)
from skfem_joint.stepping.integrate import integrate
from skfem_joint.stepping.recording import Run, Save
from skfem_joint.stepping.resolution import longest_step
from skfem_joint.stepping.schemes import Scheme
from skfem_joint.structure import Structure
from skfem_joint.system import System

#: Cycles of a run that modes come from; cycles and least steps a cycle of a probe, and steps in the
#: shortest period of the loads that it takes.
TRAINING_CYCLES, PROBE_CYCLES, PROBE_STEPS, PROBE_STEPS_PER_PERIOD = 3, 4, 100, 20
#: Share of a run that the modes made with it may miss without a word, and at all.
DOUBTFUL_BASIS, WRONG_BASIS = 0.1, 0.5
# Fixed-interface modes to choose from; share in the response, relative to the largest, with which
# they count; times of a run that a decomposition takes; numbers of a field that a probe stores.
_MOST_INTERFACE_MODES, _LEAST_SHARE, _MOST_TIMES, _MOST_NUMBERS = 40, 1e-4, 300, 20_000_000


@dataclass(frozen=True)
class Options:
    """What a reduced model is made of: names and values of a scene's table `reduction`.

    ``active_length`` is "auto" (measured in a probe), "estimate", or a length (m) for all joints or
    by name; the others are "auto" or what they say.
    """

    reference: str = "self"
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
    def product(self) -> str:
        """Name of the inner product."""
        automatic = "euclidean" if self.reference == "paper" else "energy"
        return automatic if self.inner_product == "auto" else self.inner_product


@dataclass(frozen=True)
class Basis:
    """Basis of a reduced structure, and what the run that it comes from tells about it."""

    V: FloatArray  #: (n, j), mass-orthonormal; ``system.project(V)`` has all contact points
    modes: int  #: joint modes: of each zone, or of the own run
    proper: ProperModes  #: decomposition that they come from
    slip_velocity: float  #: largest in the run, m/s
    velocities: FloatArray  #: (times, j), of the coordinates in the run: friction points fit them
    slip_peak: FloatArray  #: (m,), largest slip of each contact point in the run, m
    active: IntArray  #: contact points with friction that move in the basis
    missed: float  #: share of the run that it cannot follow, in the norm of strain energy
    reference: ReferenceModes | None = None  #: what scaled modes come from
    zones: tuple[ZoneLength, ...] = ()  #: active lengths of scaled modes
    #: Points and positions (m) of each active zone, where they lie along a line.
    stretches: tuple[tuple[IntArray, FloatArray], ...] | None = None
    group: IntArray | None = None  #: (m,), joint of each contact point, if known

    @property
    def active_length(self) -> dict[str, float]:
        """Active length by joint, summed over its zones, m."""
        lengths = dict.fromkeys((zone.joint for zone in self.zones), 0.0)
        for zone in self.zones:
            lengths[zone.joint] += zone.length
        return lengths


def make_basis(
    structure: Structure,
    system: System,
    options: Options,
    *,
    step: float,
    n_steps: int,
    cycle_steps: int | None = None,
    scheme: Scheme | None = None,
    warn: list[str],
) -> Basis:
    """Basis of a structure as its options say; does the run that it needs.

    Steps and scheme are those of the run to come, as `integrate` takes them. Sentences about what
    to beware of are appended to ``warn``.

    Raises
    ------
    InputError
        If nothing moves, the modes cannot follow the run they are made with, or do not fit.
    KeyboardInterrupt
        If a run is interrupted: half of one makes neither modes nor an active length.
    """
    snapshots, product = options.snapshots, options.product
    if options.reference == "self":
        steps = n_steps if cycle_steps is None else min(n_steps, TRAINING_CYCLES * cycle_steps)
        save = Save(fields=True, points=False)
        run = finished(integrate(system, step=step, n_steps=steps, scheme=scheme, save=save))
        interface = 0 if isinstance(options.interface_modes, str) else options.interface_modes
        basis = own_basis(
            system,
            run,
            options.mode_count,
            snapshots=snapshots,
            inner_product=product,
            interface_modes=interface,
        )
        if options.active_length != "auto":
            warn.append("reduction.active_length has no effect beside reference = 'self'.")
    elif options.reference == "paper":
        reference = paper_reference(snapshots=snapshots, inner_product=product)
        zones = active_zones(structure, system)
        probe = probed(system, zones, step, n_steps, cycle_steps)
        lengths = zone_lengths(system, zones, options.active_length, probe.slip_peak, warn)
        basis = scaled_basis(
            structure,
            system,
            reference,
            zones,
            lengths,
            probe,
            modes=options.mode_count,
            interface_modes=options.interface_modes,
        )
    else:
        raise InputError(
            f"reduction.reference: found {options.reference!r}, must be 'self' or 'paper'"
        )
    own = "" if options.reference == "self" else "; or take reference = 'self'"
    missed = (
        f"The {basis.V.shape[1]} vectors of the reduced model cannot follow "
        f"{100 * min(basis.missed, 1.0):.2g} % of the full model's displacement (norm of strain "
        f"energy); use more modes{own}."
    )
    if basis.missed > WRONG_BASIS:
        raise InputError(missed)
    if basis.missed > DOUBTFUL_BASIS:
        warn.append(missed)
    group = np.zeros(system.w.size, dtype=np.intp)
    for number, patch in enumerate(structure.patches):
        group[patch.points] = number
    return replace(basis, group=group)


def finished(run: Run) -> Run:
    """Pass on a whole run."""
    if run.interrupted:
        raise KeyboardInterrupt
    return run


def own_basis(
    system: System,
    run: Run,
    modes: int,
    *,
    snapshots: str = "both",
    inner_product: str = "energy",
    interface_modes: int = 0,
) -> Basis:
    """Proper orthogonal modes of a system's own run.

    Parameters
    ----------
    run : Run
        With stored fields, of which it takes at most 300 times.
    snapshots, inner_product
        See :mod:`skfem_joint.reduction.pod`.
    interface_modes : int
        Fixed-interface modes of all that is not in contact, beside the others.

    Raises
    ------
    InputError
        If nothing moves in the run, or its snapshots make fewer modes than asked for.
    """
    u, v = (x[:: max(1, -(-len(x) // _MOST_TIMES))] for x in (run.u, run.v))
    if not (np.any(u) and np.any(v)):
        raise InputError(
            "reduction: nothing moves in the run that the modes are to come from, or it holds no "
            "fields (Save(fields=True)); give a load that acts in it, or run 'full' alone"
        )
    inner = inner_matrix(system, inner_product, u, v)
    proper = proper_modes(snapshot_matrix(u, v, snapshots, inner), inner)
    if not 1 <= modes <= proper.modes.shape[1]:
        raise InputError(
            f"reduction.modes: found {modes}, must be from 1 to {proper.modes.shape[1]}, which "
            "the snapshots of the run can make"
        )
    V, F = proper.modes[:, :modes], _out_of_contact(system)
    if interface_modes > 0 and F.shape[1]:
        V = np.hstack([V, F @ natural_modes(*_within(system, F), interface_modes)[1]])
    velocity = float(system.slip_norm((system.B @ run.v.T).T).max(initial=0.0))
    return _basis(system, V, run, modes, proper, velocity, system.w > 0.0)


def probed(
    system: System, zones: Sequence[Zone], step: float, n_steps: int, cycle_steps: int | None
) -> Run:
    """Quick run of the full model with exact Coulomb friction, which costs least.

    Its points are the slips at the mouths. The slip beyond the active length is exactly zero, so
    that the length measured hardly depends on the threshold. Where a run is counted in cycles it
    takes a few of them, in steps that the fastest harmonic and jumps of the loads allow.
    """
    rows = np.isin(np.repeat(np.arange(system.w.size), system.directions), _mouths(zones))
    coulomb = replace(
        system.with_beta(np.inf),
        P=sparse.csr_array(system.B)[np.flatnonzero(rows)],
        points=tuple(f"slip {row}" for row in np.flatnonzero(rows)),
    )
    if cycle_steps is not None:
        period, cycles = step * cycle_steps, min(n_steps // cycle_steps, PROBE_CYCLES)
        highest = max((load.amplitude.highest_frequency or 0.0) for load in system.loads)
        least = max(PROBE_STEPS_PER_PERIOD * highest * period, PROBE_STEPS)
        least = max(least, period / longest_step(coulomb, cycles * period))
        steps = min(cycle_steps, int(np.ceil(least * (1.0 - 1e-9))))
        step, n_steps = period / steps, cycles * steps
    save = Save(fields=True, fields_every=max(1, -(-n_steps * system.n // _MOST_NUMBERS)))
    return finished(integrate(coulomb, step=step, n_steps=n_steps, save=save))


def _mouths(zones: Sequence[Zone]) -> IntArray:
    return np.unique(np.concatenate([zone.mouth for zone in zones]))


def scaled_basis(
    structure: Structure,
    system: System,
    reference: ReferenceModes,
    zones: Sequence[Zone],
    lengths: Sequence[ZoneLength],
    probe: Run,
    *,
    modes: int = 5,
    interface_modes: str | int = "auto",
) -> Basis:
    """Reference modes scaled along each zone, carried into the structure.

    Parameters
    ----------
    zones, lengths, probe
        Ends of joints where force enters, their active lengths, and what :func:`probed` gives.
    modes : int
        Reference modes of each zone.
    interface_modes : "auto" or int
        The lowest modes of what is not prescribed that take part in the response; "auto": as many
        as lie below twice the loads' highest frequency, at least two; four for loads without.
    """
    along, across, sideways = _slip_vectors(structure, system)
    active = np.zeros(system.w.size, dtype=bool)
    pulled, breathing, stretches = [], [], []
    for zone, found in zip(zones, lengths, strict=True):
        free = zone.points >= 0
        points, distance, x = zone.points[free], zone.distance[free], structure.nodes[zone.nodes]
        values = reference.at(1.0 - distance / found.length, modes)
        middle = 0.5 * (x.max(axis=0) + x.min(axis=0))
        offset = ((x[free] - middle) * sideways[points]).sum(axis=1)
        pulled.append(along[:, points] @ values)
        breathing.append(across[:, points] @ (values * offset[:, np.newaxis]))
        inside = distance < found.length
        active[points[inside]] = True
        stretches.append((points[inside], distance[inside]))
    F = _out_of_contact(system)
    turning = across[:, active & (np.diff(across.indptr) > 0)]
    wide = sparse.csc_array(sparse.hstack([F, turning]))
    parts = [_following(system, wide, np.hstack(pulled))]
    parts.append(_following(system, F, np.hstack(breathing)))
    if F.shape[1]:
        parts += _rest_modes(system, wide, parts[0], interface_modes)
    slips = norms(probe.point_v, system.directions[_mouths(zones)])
    velocity = float(slips.max(initial=0.0))
    V, carrying = np.hstack(parts), active & (system.w > 0.0)
    basis = _basis(system, V, probe, modes, reference.proper, velocity, carrying)
    lines = all(zone.is_line for zone in zones) and np.all(system.directions[active] == 1)
    ordered = tuple(stretches) if lines else None
    return replace(basis, reference=reference, zones=tuple(lengths), stretches=ordered)


def _slip_vectors(
    structure: Structure, system: System
) -> tuple[sparse.csc_array, sparse.csc_array, FloatArray]:
    """Unknowns (n, m) of a unit slip of each contact point along and across its joint's axis.

    Along: times the share of the axis in the point's slip directions. The directions (m, dim) of
    the slip across come third; zero for points that slip along the axis alone.
    """
    m, first = system.w.size, system.first_row
    directions = np.zeros((int(first[-1]), structure.dim))
    along, across = np.zeros(len(directions)), np.zeros(len(directions))
    for patch in structure.patches:
        for which in range(patch.directions.shape[1]):
            has = system.directions[patch.points] > which
            rows = first[patch.points[has]] + which
            directions[rows] = patch.directions[has, which]
            along[rows] = directions[rows] @ axis_of(structure, patch.joint)
    size = np.sqrt(system.by_point(along**2))
    lone = first[:-1][(system.directions == 1) & (size <= THRESHOLD)]
    along[lone], across[lone] = 0.0, 1.0
    pair = system.directions == 2
    one, some = first[:-1][pair], size[pair] > 0.0
    across[one] = -along[one + 1] / np.where(some, size[pair], 1.0)
    across[one + 1] = np.where(some, along[one] / np.where(some, size[pair], 1.0), 1.0)
    place = np.arange(len(directions)), np.repeat(np.arange(m), system.directions)
    A, C = (sparse.csr_array((x, place), shape=(len(directions), m)) for x in (along, across))
    C.eliminate_zeros()
    B = sparse.csr_array(system.B)
    return sparse.csc_array(B.T @ A), sparse.csc_array(B.T @ C), C.T @ directions


def _out_of_contact(system: System) -> sparse.csc_array:
    """Unit vectors of the unknowns that no slip row picks, in columns."""
    free = np.setdiff1d(np.arange(system.n), picked(system))
    return sparse.eye_array(system.n, format="csc")[:, free]


def _within(system: System, F: sparse.csc_array) -> tuple[sparse.csc_array, sparse.csc_array]:
    """Stiffness and mass of motions in the columns of F."""
    K, M = (sparse.csc_array(F.T @ sparse.csr_array(A) @ F) for A in (system.K, system.M))
    return K, M


def _following(system: System, F: sparse.csc_array, V: FloatArray) -> FloatArray:
    """Let the columns of F follow prescribed motions with the least strain energy."""
    if F.shape[1] == 0:
        return V
    return np.asarray(V - F @ splu(_within(system, F)[0]).solve(F.T @ (system.K @ V)))


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
    found = [F @ splu(K).solve(forces)] if forces.size else []
    if asked == 0:
        return found
    count = 0 if isinstance(asked, str) else asked
    frequency, shapes = natural_modes(K, M, min(K.shape[0], max(_MOST_INTERFACE_MODES, count)))
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
    run: Run,
    modes: int,
    proper: ProperModes,
    slip_velocity: float,
    active: BoolArray,
) -> Basis:
    """Basis with what the run that it comes from tells about it."""
    V = orthonormal(V, system.M)
    velocities = np.asarray(run.v @ (system.M @ V))
    u = run.u[:: max(1, -(-len(run.u) // _MOST_TIMES))]
    left = u - (u @ (system.M @ V)) @ V.T
    energies = [float(np.vdot(x, (system.K @ x.T).T)) for x in (left, u)]
    missed = float(np.sqrt(energies[0] / energies[1])) if energies[1] > 0.0 else 0.0
    points = np.flatnonzero(active)
    return Basis(V, modes, proper, slip_velocity, velocities, run.slip_peak, points, missed)
