"""A reduced basis, the history that it was made from, and the reduced system on it.

The displacement of the full model is u = V q. `Basis` has V and what projection needs. Its
`SlipHistory` says how the joints slipped in the run or path that V was made from; friction points
and the steepness of the reduced law of friction are chosen by that.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from skfem_joint.ground.arrays import BoolArray, FloatArray, IntArray
from skfem_joint.ground.errors import InputError
from skfem_joint.linalg.schur import Uncondensed
from skfem_joint.reduction.friction_points import few_points, merged_points, shared_points
from skfem_joint.reduction.pod import ProperModes, orthonormal, thinned
from skfem_joint.system.system import System

#: Joint modes if their number is "auto": of a path or run; of the states of a damping curve, or
#: beside a response, where levels and frequencies are many; of each zone of the paper's.
JOINT_MODES, MANY_MODES, SCALED_MODES = 12, 24, 5
#: Most times of a run that its modes, and the friction points, are made from.
MOST_TIMES = 300
#: Merged contact points for each vector of the basis: later numbers are tried while the first loses
#: too much. With contact that opens steps cost more for each point.
MERGED_PER_MODE, MERGED_IF_OPEN = (3, 6, 12), (3, 4, 5, 6, 12)
#: Share of the largest slip velocity below which modes of a run do not resolve velocities.
RESOLVED = 1e-4
#: Slip velocity that stands for that of a joint which sticks throughout, m/s.
STUCK_VELOCITY = 1e-3


@dataclass(frozen=True)
class Options:
    """What a reduced model is made of: names and values of a scene's table `reduction`.

    Attributes
    ----------
    reference : {"static", "self", "paper"}
        What the joint modes come from: the static slip path, a run of the full model, or the
        paper's reference joint.
    modes : "auto" or int
        Number of joint modes; with "paper" of each active zone.
    interface_modes : "auto" or int
        Number of fixed-interface modes; "auto" chooses by their share in the response with
        "static", by the loads' highest frequency with "paper", and takes none with "self".
    snapshots, inner_product : str
        As in `skfem_joint.reduction.pod`; without effect with "static".
    active_length : "auto", "estimate", float or mapping
        With "paper": measured in a probe run, estimated by Eqs. (17)-(20), or a length (m) for all
        joints or by name.
    friction_points : "auto", "all" or int
    beta : "auto" or float
        Steepness of the reduced law of friction, s/m.
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
        """Number of joint modes: of each zone with the paper's modes, else in all."""
        if isinstance(self.modes, str):
            return SCALED_MODES if self.reference == "paper" else JOINT_MODES
        return self.modes

    @property
    def idle(self) -> list[str]:
        """Sentences about options that were given and change nothing."""
        wanted = {"active_length": ("paper",)} | dict.fromkeys(
            ("snapshots", "inner_product"), ("self", "paper")
        )
        return [
            f"reduction.{name} has no effect but beside reference = "
            f"{' or '.join(map(repr, references))}."
            for name, references in wanted.items()
            if getattr(self, name) != getattr(Options, name) and self.reference not in references
        ]

    @property
    def friction(self) -> dict[str, Any]:
        """Friction points and steepness, as `reduced_on` takes them."""
        return {"friction_points": self.friction_points, "beta": self.beta}

    @property
    def product(self) -> str:
        """Name of the inner product."""
        automatic = "euclidean" if self.reference == "paper" else "energy"
        return automatic if self.inner_product == "auto" else self.inner_product


@dataclass(frozen=True)
class SlipHistory:
    """How the joints slipped in the run or path that a basis was made from.

    Attributes
    ----------
    velocities, displacements : ndarray, shape (times, j)
        Velocities of the coordinates q, and these themselves, by which contact points are merged.
    slip_velocity : float
        Largest slip velocity, m/s.
    slip_peak : ndarray, shape (m,)
        Largest slip of each contact point, m.
    active : ndarray of int
        Contact points with friction that can slip in the basis.
    missed : float
        Share of the displacements that the basis cannot follow, in the norm of strain energy.
    resolved : float
        Share of the largest slip velocity down to which the modes resolve velocities.
    """

    velocities: FloatArray
    displacements: FloatArray
    slip_velocity: float
    slip_peak: FloatArray
    active: IntArray
    missed: float = 0.0
    resolved: float = RESOLVED


@dataclass(frozen=True)
class Basis:
    """Basis of a reduced model, u = V q.

    Attributes
    ----------
    V : ndarray, shape (n, j)
        Basis vectors; ``system.project(V)`` is the reduced system with all contact points. They are
        orthonormal in mass, except those of condensed models.
    modes : int
        Number of joint modes: of the path or run, or of each zone.
    proper : ProperModes
        Decomposition that the joint modes come from.
    history : SlipHistory
        Slips of the run or path that it was made from.
    stiffness : Uncondensed, optional
        Stiffness of the full system with its Schur complement, if that exists already.
    notes : tuple of str
        Sentences for users about how it was made.
    active_length : mapping of str to float
        Active length of each joint, m, that the modes are scaled to; none if they are not.
    modes_of_unit_length : tuple of (ndarray, shape (k,), and ProperModes), optional
        Positions on a unit active length and modes there, if these were scaled.
    """

    V: FloatArray
    modes: int
    proper: ProperModes
    history: SlipHistory
    stiffness: Uncondensed | None = None
    notes: tuple[str, ...] = ()
    active_length: Mapping[str, float] = field(default_factory=dict)
    modes_of_unit_length: tuple[FloatArray, ProperModes] | None = None

    def __getstate__(self) -> dict[str, Any]:
        """What goes to other processes: all but the stiffness, whose factors cannot."""
        return {**self.__dict__, "stiffness": None}

    @property
    def followed(self) -> FloatArray:
        """Motions of the full system that the joint modes come from, (n, s), scaled."""
        return self.proper.modes * self.proper.singular_values

    def fewer_points(self, unmerged: System, count: int | None) -> System:
        """Reduced system with as few friction points as lose little, or at most ``count``.

        ``unmerged`` is the projection on V with all contact points. Its ``notes`` say so if fewer
        than ``count`` points are left, because no more of them slip apart from each other.
        """
        history, opens = self.history, unmerged.contact.opens
        if count is None:
            each = MERGED_IF_OPEN if opens else MERGED_PER_MODE
            numbers = [number * unmerged.n for number in each]
        else:
            numbers = [count]
        known = history.active, numbers, history.velocities, history.displacements
        merged = few_points(unmerged, *known)
        points = merged.contact.normal.gap.size if opens else merged.contact.w.size
        if count is None or points >= count:
            return merged
        note = (
            f"The reduced model has {points} friction points instead of {count}: no "
            "more of the joints' points slip apart from each other."
        )
        return replace(merged, notes=(*merged.notes, note))

    def merging(self, system: System, many: int, count: int) -> Callable[[System], System]:
        """What merges points of models of a system that slip alike in the run of this basis.

        It takes models with all points, and leaves them as they are if these are no more than
        ``many``; else it leaves ``count`` points.
        """
        if system.contact.count <= many:
            return lambda small: small
        narrow, carrying = system.project(self.V), np.flatnonzero(system.contact.w)
        merged = merged_points(narrow, self.history.velocities, carrying, count).contact
        return lambda small: shared_points(small, merged.shares, merged.w)

    def enriched(self, system: System, V: FloatArray, velocities: FloatArray) -> Basis:
        """Basis of more vectors V (n, k), with the velocities (times, k) of a run on them.

        All points of the joints may slip in it.
        """
        history = replace(
            self.history,
            velocities=velocities,
            displacements=np.zeros((0, V.shape[1])),
            active=np.flatnonzero(system.contact.w > 0.0),
        )
        return replace(self, V=V, history=history)

    def for_decay(self) -> Basis:
        """The basis for a run that does not repeat itself, whose law of friction is steeper.

        The structure comes to rest at its end, where a less steep law lets the joint creep.
        """
        return replace(self, history=replace(self.history, resolved=self.history.resolved / 100.0))

    def judged(self, options: Options, enriched: bool) -> Basis:
        """The basis with a note about what it misses, if that is more than a tenth.

        A basis that misses half of its history raises InputError, unless it is to be ``enriched``
        before it is used: then its notes say so.
        """
        missed = self.history.missed
        instead = "; or take reference = 'static'" if options.reference == "paper" else ""
        sentence = (
            f"The {self.V.shape[1]} vectors of the reduced model cannot follow "
            f"{100 * min(missed, 1.0):.2g} % of the displacement in the run that they are judged "
            f"by (norm of strain energy); use more modes{instead}."
        )
        if missed > 0.5 and not enriched:
            raise InputError(sentence)
        notes = [*self.notes, *options.idle]
        return replace(self, notes=(*notes, sentence) if missed > 0.1 else tuple(notes))


@dataclass(frozen=True)
class Origin:
    """What a reduced or condensed model was made of: its `System.origin`.

    Attributes
    ----------
    system : System
        The full system.
    basis : Basis
    analyses : tuple of str
        Those beside its own runs that a reduced model was made for.
    highest : float
        Highest level that it was made for in these: a factor on its loads, or of a curve.
    slips_at : float, optional
        Of the curve that it was made of, see `Backbone`.
    """

    system: System
    basis: Basis
    analyses: tuple[str, ...] = ()
    highest: float = np.inf
    slips_at: float | None = None

    def made(self, system: System, loaded: bool = True) -> bool:
        """Whether a model still has the matrices and limits that it got, and if asked the loads."""
        full, V = self.system, self.basis.V
        probe = np.cos(np.arange(V.shape[1]))
        ours, theirs = (each.loads if loaded else () for each in (full, system))
        return (
            V.shape[1] == system.n
            and len(ours) == len(theirs)
            and bool(np.isclose(full.contact.w.sum(), system.contact.w.sum(), rtol=1e-9))
            and all(
                a.amplitude == b.amplitude and np.allclose(V.T @ a.vector, b.vector)
                for a, b in zip(ours, theirs, strict=True)
            )
            and all(
                _alike(V.T @ (whole @ (V @ probe)), own @ probe)
                for whole, own in ((full.M, system.M), (full.C, system.C), (full.K, system.K))
            )
        )


def _alike(a: FloatArray, b: FloatArray) -> bool:
    """Whether two vectors differ by round-off of a projection."""
    return bool(np.linalg.norm(a - b) <= 1e-6 * np.linalg.norm(a))


def basis_of(
    system: System,
    V: FloatArray,
    modes: int,
    proper: ProperModes,
    *,
    u: FloatArray,
    v: FloatArray,
    slip_peak: FloatArray,
    slip_velocity: float,
    active: BoolArray | None = None,
) -> Basis:
    """Basis of the span of some vectors, orthonormal in mass, with the history of a motion.

    Parameters
    ----------
    system : System
    V : ndarray, shape (n, k)
        Vectors, of which some may depend on others.
    modes, proper
        See `Basis`.
    u, v : ndarray, shape (times, n)
        Displacements of the motion, m, and velocities at the same or other times, m/s.
    slip_peak, slip_velocity
        See `SlipHistory`.
    active : ndarray of bool, shape (m,), optional
        Contact points that may slip in the basis; all with friction if not given.
    """
    V = orthonormal(orthonormal(V, system.M), system.M)  # once leaves what is nearly dependent
    velocities = np.asarray(v @ (system.M @ V))
    u = thinned(u, MOST_TIMES)
    followed = np.asarray(u @ (system.M @ V))
    left = u - followed @ V.T
    energies = [float(np.vdot(x, (system.K @ x.T).T)) for x in (left, u)]
    missed = float(np.sqrt(energies[0] / energies[1])) if energies[1] > 0.0 else 0.0
    points = np.flatnonzero(system.contact.rubs if active is None else active)
    history = SlipHistory(velocities, followed, slip_velocity, slip_peak, points, missed)
    return Basis(V, modes, proper, history)
