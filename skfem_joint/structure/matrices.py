"""A structure given by matrices that another finite-element program has exported."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, ClassVar, NoReturn

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from skfem_joint.ground.arrays import FloatArray, IntArray, Matrix
from skfem_joint.ground.errors import InputError, listed, refuse
from skfem_joint.ground.values import several
from skfem_joint.joint.gaps import surfaces
from skfem_joint.joint.joints import Joint, joint_value_problems
from skfem_joint.joint.manifold import SMALL, slip_directions
from skfem_joint.joint.patch import Patch, point_stiffness
from skfem_joint.matrix_files.labels import is_scalar, label_text
from skfem_joint.matrix_files.modes import about_modes, fixed_interface_frequencies, highest_served
from skfem_joint.mesh.named import name_problems
from skfem_joint.structure.doubts import doubted
from skfem_joint.structure.load import Load, under_loads
from skfem_joint.structure.reactions import Reactions, reactions
from skfem_joint.system.modes import rigid_motions
from skfem_joint.system.normal import NormalPart
from skfem_joint.system.slips import NormalRows, SlipRows, rows_along, unit_vectors
from skfem_joint.system.system import AppliedLoad, System
from skfem_joint.system.unknowns import selection

#: Columns of a contact: degrees of freedom of both nodes of a pair, normal, area, and gap if given.
COLUMNS = 11


@dataclass(frozen=True)
class MatrixModel:
    """Matrices with joints between pairs of nodes.

    Analyses use it like a `Structure`, see `AnyStructure`. The positions of the nodes are unknown,
    so that fields, pictures and active lengths are not available.

    Attributes
    ----------
    M, K, C : ndarray or sparse array, shape (N, N)
        As `System.from_matrices` takes them; ``C`` may be None.
    contacts : mapping of str to ndarray, shape (k, 10) or (k, 11)
        Pairs of nodes by the name of the contact, in rows of x, y and z degrees of freedom of the
        first node, the same of the second, normal (x, y, z, of any length), area, m2, and gap, m,
        if there are gaps. Absent degrees of freedom are negative or NaN; so are all three of the
        second node if the first is pressed on a rigid base. Slip is the displacement of the first
        node relative to the second across the normal. Where contact stays closed both move together
        along it; where it opens the normal points from the first node to the second, or into the
        base, and the nodes approach each other by their relative displacement along it.
    points : mapping of str to ndarray, shape (N,)
        Rows on the degrees of freedom that can be loaded or observed, by name.
    fixed : ndarray of int
        Degrees of freedom that are supported.
    joints : sequence of Joint
        On contacts; pressures are numbers (Pa).
    stiffness_damping, mass_damping, damping_ratio
        As those of a `Structure`, where ``C`` is None.
    first : int
        Number of the first degree of freedom in messages; in all arrays it is 0.
    labels : ndarray of int, shape (N, 2), optional
        Node and direction of each degree of freedom, 1 to 6, or 0 for the amplitude of a mode.
    remarks : sequence of str
        Sentences about the files that the matrices come from.
    contact : SlipRows
        Slip rows of all joints, made from the values above.
    patches : tuple of Patch
        Contact points of each joint.
    unloaded : System
        System without loads, observed points and names of joints.

    Raises
    ------
    InputError
        For what `System.from_matrices` refuses, joints on unknown contacts, and wrong rows of
        contacts.
    """

    M: Matrix
    K: Matrix
    C: Matrix = None
    contacts: Mapping[str, FloatArray] = field(default_factory=dict)
    points: Mapping[str, FloatArray] = field(default_factory=dict)
    fixed: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.intp))
    joints: Sequence[Joint] = ()
    stiffness_damping: float = 0.0
    mass_damping: float = 0.0
    damping_ratio: float | None = None
    first: int = 0
    labels: IntArray | None = None
    remarks: Sequence[str] = ()

    contact: SlipRows = field(init=False, repr=False, compare=False)
    patches: tuple[Patch, ...] = field(init=False, repr=False, compare=False)
    unloaded: System = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        for named in (self.contacts, self.points):
            refuse(name_problems(matrices=named))
        pairs = self._contact_pairs()
        contact = sum((own for _, own in pairs), start=SlipRows.none(self.n_dofs))
        unloaded = System.from_matrices(
            self.M,
            self.K,
            self.C,
            fixed=self.fixed,
            contact=contact,
            stiffness_damping=self.stiffness_damping,
            mass_damping=self.mass_damping,
        )
        object.__setattr__(self, "contact", contact)
        object.__setattr__(self, "patches", tuple(patch for patch, _ in pairs))
        object.__setattr__(self, "unloaded", unloaded)

    #: Whether the structure is said to move freely: of matrices that is not said.
    free: ClassVar[bool] = False
    #: The positions of the nodes are unknown, and so are the elements.
    body: ClassVar[None] = None
    mesh_error: ClassVar[None] = None
    loose_mesh_error: ClassVar[None] = None

    def meshed(self, purpose: str) -> NoReturn:
        """Refuse, because geometry is needed for the purpose.

        Raises
        ------
        InputError
            Always.
        """
        raise InputError(f"{purpose}: matrices do not tell where their nodes are")

    @property
    def n_dofs(self) -> int:
        """Number of degrees of freedom, supported ones included."""
        return int(self.K.shape[0])

    @property
    def identity(self) -> list[Any]:
        """Arrays and names that distinguish these matrices from others."""
        return [self.M, self.K, self.C, self.fixed, self.contacts, self.points]

    @property
    def free_points(self) -> tuple[str, ...]:
        """Names of the points that can be observed."""
        return tuple(self.points)

    def _masses(self) -> str:
        """Words on the mass that moves along each axis; it tells whether units are right."""
        if self.labels is None:
            return ""
        M, told = sparse.csr_array(self.M), []
        of_nodes = ~is_scalar(self.labels)
        for number, axis in enumerate("xyz", 1):
            along = np.flatnonzero(of_nodes & (self.labels[:, 1] == number))
            if along.size:
                told.append(f"{M[along][:, along].sum():.4g} kg along {axis}")
        return f", which have a mass of {', '.join(told)}" if told else ""

    def overview(self) -> str:
        """Sentences about what the structure is made of."""
        paired = [rows[:, :6].ravel() for rows in self.contacts.values() if rows.ndim == 2]
        used = np.concatenate([np.asarray(self.fixed, dtype=float), *paired])
        used = used[used >= 0.0] + self.first
        last = self.n_dofs - 1 + self.first
        more = ""
        if self.labels is not None:
            nodes = np.unique(self.labels[~is_scalar(self.labels), 0])
            modes = about_modes(self._modes, self.labels)
            more = f" They name {nodes.size} nodes{self._masses()}. {modes}".rstrip()
        elif used.size:
            more = (
                f" Supports and contacts name numbers from {used.min():.0f} to {used.max():.0f} of "
                f"{self.first} to {last}."
            )
        return (
            f"Matrices of {self.n_dofs} degrees of freedom, {self.fixed.size} of them fixed; "
            f"without positions there are no fields, pictures and active lengths.{more}"
        )

    @cached_property
    def _modes(self) -> FloatArray | None:
        """Frequencies of fixed-interface modes among the degrees of freedom, Hz."""
        return fixed_interface_frequencies(
            sparse.csr_array(self.K), sparse.csr_array(self.M), self.labels
        )

    def _beyond_modes(self, loads: Sequence[Load]) -> Iterator[str]:
        """Sentences about loads whose frequency the modes of the other program do not reach."""
        highest = highest_served(self._modes)
        for load in loads:
            frequency = load.amplitude.highest_frequency or 0.0
            if frequency > highest:
                yield (
                    f"The load on '{load.on}' has {frequency:.5g} Hz, beyond the "
                    f"{highest:.4g} Hz up to which the fixed-interface modes of the matrices "
                    "serve: let the other program keep more modes."
                )

    def at_rest(self) -> list[str]:
        """No sentences: matrices have no clamping bolts, and their bodies are not known."""
        return []

    def _contact_pairs(self) -> list[tuple[Patch, SlipRows]]:
        """Contact points of each joint, and their slip rows; pairs without pressure are left out.

        Raises
        ------
        InputError
            For joints on unknown contacts, and wrong rows of contacts.
        """
        pairs: list[tuple[Patch, SlipRows]] = []
        problems: list[str] = []
        taken: set[int] = set()
        for joint in self.joints:
            if wrong := [*joint_value_problems(joint), *_on_surfaces(joint)]:
                problems += wrong
            elif joint.on not in self.contacts:
                names = listed(self.contacts)
                problems.append(f"{joint.label}: no contact has this name; contacts: {names}")
            elif wrong := [*_wrong_rows(joint, self.contacts[joint.on], self.n_dofs, self.first)]:
                problems += [f"contact.{joint.on}: {problem}" for problem in wrong]
            else:
                start = sum(patch.points.size for patch, _ in pairs)
                pairs.append(self._pressed(joint, start, taken))
        refuse(problems)
        return pairs

    def _pressed(self, joint: Joint, start: int, taken: set[int]) -> tuple[Patch, SlipRows]:
        """Contact points of a joint, numbered from ``start``, and their slip rows.

        Degrees of freedom that the rows determine are added to ``taken``.
        """
        rows = self.contacts[joint.on]
        gap = joint.gap_scale * (np.asarray(joint.gap, dtype=float) + _gaps(rows))
        force = np.where(gap > 0.0, 0.0, np.asarray(joint.pressure, dtype=float) * rows[:, 9])
        pressed = np.flatnonzero(rows[:, 9] > 0.0 if joint.opens else force > 0.0)
        rows, force, gap, k = rows[pressed], force[pressed], gap[pressed], pressed.size
        normal, area = unit_vectors(rows[:, 6:9]), rows[:, 9]
        dofs = rows[:, :6].reshape(-1, 2, 3)
        moves = (dofs >= 0.0) & ~np.isin(dofs, self.fixed)
        pair, side, component = np.nonzero(moves)
        entries = 1.0 - 2.0 * side, (3 * pair + component, dofs[moves].astype(np.intp))
        # Displacement of the first nodes less that of the second.
        relative = sparse.csr_array(sparse.coo_array(entries, shape=(3 * k, self.n_dofs)))
        there = np.asarray(moves.any(axis=1))
        directions = slip_directions(normal, ~there)
        acting = np.any(directions != 0.0, axis=2)
        point, which = np.nonzero(acting)
        slips = acting.any(axis=1)
        across = np.flatnonzero(np.linalg.norm(normal * there, axis=1) > SMALL)
        if joint.opens and not across.size:
            raise InputError(
                f"contact.{joint.on}: no pair with an area has a degree of freedom along its "
                f"normal that is free, which contact = 'unilateral' of {joint.label} needs; give "
                "such, or leave that out"
            )
        approaches = sparse.csr_array(rows_along(across, normal[across], k) @ relative)
        contact = SlipRows(
            B=rows_along(point, directions[point, which], k) @ relative,
            w=joint.friction * force[slips],
            beta=np.full(np.count_nonzero(slips), joint.beta),
            directions=np.count_nonzero(acting[slips], axis=1).astype(np.int64),
            closed=approaches[:0] if joint.opens else approaches,
            stiffness=point_stiffness(joint, area[slips]),
        )
        if joint.opens:
            stiffness = joint.normal_stiffness * area
            part = NormalPart(sparse.eye_array(k, format="csr"), gap, force, stiffness, area)
            gain = joint.friction * selection(np.flatnonzero(slips), k)
            normal_rows = NormalRows.of_points(approaches, part.among(across), gain[:, across])
            contact = replace(contact, normal=normal_rows)
        else:
            counts = np.isin(np.arange(k), across).astype(int), acting.sum(axis=1)
            held, free = self._pivots(joint, pressed, np.where(moves, dofs, -1), counts, taken)
            pivots = np.array(held + free, dtype=np.intp)
            contact = replace(contact, pivots=pivots, clamped=force[across])
        patch = Patch(
            joint=joint,
            nodes=pressed[slips],
            points=start + np.arange(np.count_nonzero(slips)),
            normal_force=force[slips],
            area=area[slips],
            directions=directions[slips],
            normal=normal[slips],
            held_forces=force[~slips],
            held_areas=area[~slips],
        )
        return patch, contact

    @staticmethod
    def _pivots(
        joint: Joint,
        pressed: IntArray,
        moving: FloatArray,
        counts: tuple[IntArray, IntArray],
        taken: set[int],
    ) -> tuple[list[int], list[int]]:
        """Degrees of freedom that closed contact and slips of pairs determine.

        They belong to the first node of a pair. Where it has none (-1), or another pair has taken
        it, that of the second node is used. ``counts`` are the numbers of closed and of slip
        directions of each pair, ``moving`` (pairs, 2, 3) the free degrees of freedom.
        """
        held: list[int] = []
        free: list[int] = []
        for pair, dofs, count, slips in zip(pressed, moving.astype(int), *counts, strict=True):
            own: list[int] = []
            for both in dofs.T.tolist():
                own += [dof for dof in both if dof >= 0 and dof not in taken][:1]
            if len(own) < count + slips:
                raise InputError(
                    f"contact.{joint.on}: pair {pair + 1}: other pairs of its nodes determine its "
                    "slip already; leave it out"
                )
            taken.update(own)
            held += own[:count]
            free += own[count : count + slips]
        return held, free

    def system(
        self,
        loads: Sequence[Load] = (),
        points: Sequence[str] | None = None,
        *,
        quasi_static: bool = False,
    ) -> System:
        """Sparse system of equations under loads.

        Displacements at all loads are observed, and those of ``points``: all points, if not given.

        Raises
        ------
        InputError
            For unknown names, loads with a direction or a base, and points that a support holds.
        """
        loads = several("loads", loads, Load)
        problems = [*self._wrong_loads(loads)]
        observed = list(self.points) if points is None else list(points)
        problems += [
            self._unknown(f"points: {name!r}") for name in observed if name not in self.points
        ]
        refuse(problems)
        names = dict.fromkeys([*(str(load.on) for load in loads), *observed])
        rows = {name: np.asarray(self.unloaded.T.T @ self.points[name]) for name in names}
        refuse(
            f"points: {name!r} is supported, or zero, and does not move"
            for name, row in rows.items()
            if not row.any()
        )
        applied = [AppliedLoad(rows[str(x.on)], x.amplitude, str(x.on)) for x in loads]
        system = under_loads(self.unloaded, self.patches, applied, rows, self.damping_ratio)
        doubts = [*self.remarks, *self._beyond_modes(loads), *self.unusual]
        return doubted(system, doubts, self.patches, quasi_static=quasi_static)

    def reactions(self, loads: Sequence[Load]) -> Reactions | None:
        """Change of the normal forces by vibration; None where no contact is closed."""
        if not self.contact.clamped.any():
            return None
        F = np.stack([self.points[str(load.on)] for load in loads], axis=1)
        return reactions(self.contact, self.fixed, (self.M, self.K), self.unloaded.T, F)

    def pressed_at(self, dof: int) -> str:
        """Joint of a degree of freedom that closed contact determines, in a message."""
        names = [j.name for j in self.joints if np.any(self.contacts[j.on][:, :6] == dof)]
        return f"joint {names[0]} at {self.spot(dof)}"

    def _wrong_loads(self, loads: Sequence[Load]) -> Iterator[str]:
        """What is wrong with places, directions and quantities of loads."""
        for load in loads:
            if load.on is None:
                yield (
                    f"{load.label}: matrices do not tell which way their degrees of freedom point; "
                    "give the vector M r of the base's unit motion r as a point, and load that"
                )
            elif load.on not in self.points:
                yield self._unknown(load.label)
            elif load.quantity != "force":
                yield (
                    f"{load.label}: quantity: found {load.quantity!r}, must be 'force': matrices "
                    "have no faces"
                )
            elif load.direction is not None:
                yield f"{load.label}: direction: found beside [matrices], which tell; leave it out"

    def _unknown(self, what: str) -> str:
        """Message about a name that no point has."""
        return f"{what}: no point has this name; points: {listed(self.points)}"

    @cached_property
    def unusual(self) -> list[str]:
        """Sentence about pairs that slip where K lets the structure move rigidly.

        A rigid motion should move both nodes of a pair together; a slip of more than 1e-3 of the
        motion is reported. Values are not judged, because their units are not known.
        """
        rows = [(joint.on, self.contacts[joint.on]) for joint in self.joints]
        dofs = np.vstack([np.zeros((0, 6)), *(pairs[:, :6] for _, pairs in rows)]).reshape(-1, 2, 3)
        there = np.asarray(dofs >= 0.0)
        two_sided = np.asarray(there[:, 1].any(axis=1))
        axes = np.count_nonzero(there[two_sided].any(axis=1).any(axis=0))
        if not axes:
            return []
        bodies, whole = connected_components(self.K)[0], axes * (axes + 1) // 2
        loose = rigid_motions(self.K, self.M, 6 * bodies)
        if loose.shape[1] < bodies * whole:
            return []
        at = np.where(there[..., np.newaxis], loose[np.where(there, dofs, 0).astype(np.intp)], 0.0)
        slips = (at[:, 0] - at[:, 1]) * two_sided[:, np.newaxis, np.newaxis]
        # The motions with least slip are checked, as many as the whole has rigid motions.
        least = np.linalg.svd(slips.reshape(-1, loose.shape[1]))[2][-whole:].T
        moved = np.abs(at @ least).max(axis=(0, 1, 2))
        share = np.linalg.norm(slips @ least, axis=1) / np.where(moved > 0.0, moved, 1.0)
        worst = int(share.max(axis=1).argmax())
        if share[worst].max() <= 1e-3:
            return []
        names = [
            f"pair {k + 1} of contact.{name}" for name, pairs in rows for k in range(len(pairs))
        ]
        return [
            "Matrices: K lets the structure move rigidly, which should move both nodes of a pair "
            f"alike, but {names[worst]} slips by up to {100.0 * share[worst].max():.3g} % of the "
            "motion: do its nodes lie in one place, and are the degrees of freedom of both in the "
            "order x, y, z and in the same directions?"
        ]

    def spot(self, dof: int) -> str:
        """A degree of freedom in a message."""
        if self.labels is not None:
            return f"unknown {label_text(self.labels[dof])}"
        return f"degree of freedom {dof + self.first}"


def _on_surfaces(joint: Joint) -> Iterator[str]:
    """Refuse keys that a joint between pairs of nodes cannot have."""
    for name, usual in (("against", None), ("axis", None), ("normal_force", "consistent")):
        if getattr(joint, name) != usual:
            yield f"{joint.label}: {name}: found beside matrices, whose contacts tell; leave it out"
    if surfaces(joint.gap):
        yield (
            f"{joint.label}: gap: found a field beside matrices, whose nodes have no places; must "
            f"be a number in m, or stand in column {COLUMNS} of the contact"
        )
    if not isinstance(joint.pressure, int | float):
        what = repr(joint.pressure) if isinstance(joint.pressure, str) else "a table"
        yield (
            f"{joint.label}: pressure: found {what}, must be a number in Pa beside matrices; what "
            "differs from pair to pair goes into the areas"
        )
    elif joint.pressure > 0.0 and not surfaces(joint.gap) and joint.has_gap:
        yield (
            f"{joint.label}: found a pressure beside gap = {joint.gap} m: nodes that are apart "
            "carry no pressure; leave one of them out, or give single pairs gaps, in column "
            f"{COLUMNS} of the contact"
        )


def _gaps(rows: FloatArray) -> FloatArray:
    """Gap of each pair of a contact, (k,), m; zero where none is given."""
    return np.asarray(np.nan_to_num(rows[:, 10:]).sum(axis=1))


def _wrong_rows(joint: Joint, rows: FloatArray, n: int, first: int) -> Iterator[str]:
    """What is wrong with a contact of ``n`` degrees of freedom, which count from 0, for a joint."""
    if rows.ndim != 2 or rows.shape[1] not in (COLUMNS - 1, COLUMNS):
        yield (
            f"found shape {rows.shape}, must have {COLUMNS - 1} columns: x, y, z degrees of "
            "freedom of the first node, of the second, normal x, y, z, area; and one more where "
            "pairs have gaps"
        )
        return
    if rows.dtype.kind not in "iuf":
        yield f"found {rows.dtype} values, must be real numbers"
        return
    dofs, absent = rows[:, :6], ~(rows[:, :6] >= 0.0)
    ordered = np.sort(np.where(absent, -1.0 - np.arange(6), dofs), axis=1)
    last = f"must be a whole number from {first} to {n - 1 + first}, or nothing"
    normal, area, gap = rows[:, 6:9], rows[:, 9:10], rows[:, 10:]
    wrong: dict[str, Any] = {
        f"a degree of freedom {last}": ~absent & ((dofs >= n) | (dofs != np.floor(dofs))),
        "each degree of freedom must stand in it once": np.diff(ordered, axis=1) == 0.0,
        "the first node must have a degree of freedom": absent[:, :3].all(axis=1, keepdims=True),
        "the normal must be three finite numbers, not all 0": ~np.isfinite(normal)
        | ~normal.any(axis=1, keepdims=True),
        "the area must be a finite number >= 0": ~((area >= 0.0) & np.isfinite(area)),
        "the gap must be a finite number >= 0, or nothing": (gap < 0.0) | np.isinf(gap),
    }
    if not joint.opens:
        wrong["a gap needs contact = 'unilateral' in its joint; leave it out"] = gap > 0.0
    for what, where in wrong.items():
        if where.any():
            row = int(np.argmax(where.any(axis=1)))
            given = rows[row] + first * (np.arange(rows.shape[1]) < 6)
            shown = ", ".join("" if np.isnan(x) else f"{x:g}" for x in given)
            yield f"pair {row + 1}, found {shown}: {what}"
            return
