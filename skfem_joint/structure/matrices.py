"""A structure that is given by its matrices, as another finite-element program exports them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property, reduce
from operator import add
from typing import Any

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components

from skfem_joint.arrays import FloatArray, IntArray, Matrix
from skfem_joint.errors import InputError, listed, refuse
from skfem_joint.mesh.named import name_problems
from skfem_joint.modes import rigid_motions
from skfem_joint.structure.checks import joint_value_problems
from skfem_joint.structure.contact import Reactions, along, reactions
from skfem_joint.structure.load import Load, loaded
from skfem_joint.structure.patch import (
    SMALL,
    Joint,
    Patch,
    slip_directions,
    unit_vectors,
)
from skfem_joint.system import AppliedLoad, System
from skfem_joint.unknowns import Contact

#: Slip of a pair over what a rigid motion moves the pairs by, from which on it is told.
ALIKE = 1e-3
#: Columns of a contact: degrees of freedom of both nodes of a pair, normal, area.
COLUMNS = 10


@dataclass(frozen=True)
class MatrixModel:
    """Matrices with joints between pairs of nodes; for analyses what a `Structure` is to them.

    Positions are not known, so that there are no fields, and no active lengths.

    Attributes
    ----------
    M, K, C : ndarray or sparse array, shape (N, N)
        As `System.from_matrices` takes them; ``C`` may be None.
    contacts : mapping of str to ndarray, shape (k, 10)
        Pairs of nodes by the name of the contact, a row each: x, y and z degrees of freedom of the
        first node, of the second, normal (x, y, z; its length does not count) and area, m2.
        Degrees of freedom that are not there are negative or NaN; of the second node all three, if
        the first is pressed on a rigid base. Contact stays closed: the nodes of a pair move alike
        along the normal, their slip is the first's displacement less the second's across it.
    points : mapping of str to ndarray, shape (N,)
        What is loaded or observed, by name.
    fixed : ndarray of int
        Degrees of freedom that are supported.
    joints : sequence of Joint
        On contacts; pressures are numbers (Pa).
    stiffness_damping, mass_damping, damping_ratio
        As those of a `Structure`, where ``C`` is None.
    first : int
        Number of the first degree of freedom in messages; here they count from 0.

    Raises
    ------
    InputError
        For what `System.from_matrices` refuses, joints on no contact, and rows of contacts that are
        none.
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

    #: Extent (m) and positions of the nodes: not known.
    size = math.inf
    nodes = positions = np.zeros((0, 3))
    dim = 3

    def __post_init__(self) -> None:
        for named in (self.contacts, self.points):
            refuse(name_problems(matrices=named))
        _ = self.unloaded  # refuses what is wrong

    @property
    def n_nodes(self) -> int:
        """Number of degrees of freedom, each by itself."""
        return int(self.K.shape[0])

    @property
    def n_entries(self) -> int:
        """Number of entries that the matrices are made from."""
        return int(sparse.csr_array(self.K).nnz)

    @property
    def identity(self) -> list[Any]:
        """What tells it from others."""
        return [self.M, self.K, self.C, self.fixed, self.contacts, self.points]

    @property
    def free_points(self) -> tuple[str, ...]:
        """Names of all that can be observed."""
        return tuple(self.points)

    @cached_property
    def patches(self) -> tuple[Patch, ...]:
        """Pairs of each joint that can slip; those without pressure are no contact."""
        return tuple(patch for patch, _ in self._made)

    @cached_property
    def contact(self) -> Contact | None:
        """Slip rows of all joints; None without."""
        return reduce(add, [rows for _, rows in self._made]) if self._made else None

    @cached_property
    def _made(self) -> list[tuple[Patch, Contact]]:
        """Patch of each joint, and its rows."""
        made: list[tuple[Patch, Contact]] = []
        problems: list[str] = []
        taken: set[int] = set()
        for joint in self.joints:
            if wrong := [*joint_value_problems(joint), *_on_surfaces(joint)]:
                problems += wrong
            elif joint.on not in self.contacts:
                names = listed(self.contacts)
                problems.append(f"{joint.label}: no contact has this name; contacts: {names}")
            elif found := [*_wrong_rows(self.contacts[joint.on], self.n_nodes, self.first)]:
                problems += [f"contact.{joint.on}: {problem}" for problem in found]
            else:
                start = sum(patch.points.size for patch, _ in made)
                made.append(self._pressed(joint, start, taken))
        refuse(problems)
        return made

    def _pressed(self, joint: Joint, start: int, taken: set[int]) -> tuple[Patch, Contact]:
        """Patch and rows of a joint; degrees of freedom that they determine are then ``taken``."""
        rows = self.contacts[joint.on]
        force = np.asarray(joint.pressure, dtype=float) * rows[:, -1]
        pressed = np.flatnonzero(force > 0.0)
        rows, force, k = rows[pressed], force[pressed], pressed.size
        normal, area = unit_vectors(rows[:, 6:9]), rows[:, -1]
        dofs = rows[:, :6].reshape(-1, 2, 3)
        moves = (dofs >= 0.0) & ~np.isin(dofs, self.fixed)
        pair, side, component = np.nonzero(moves)
        entries = 1.0 - 2.0 * side, (3 * pair + component, dofs[moves].astype(np.intp))
        # Displacement of the first nodes less that of the second.
        relative = sparse.csr_array(sparse.coo_array(entries, shape=(3 * k, self.n_nodes)))
        there = np.asarray(moves.any(axis=1))
        directions = slip_directions(normal, ~there)
        acting = np.any(directions != 0.0, axis=2)
        point, which = np.nonzero(acting)
        slips = acting.any(axis=1)
        closed = np.linalg.norm(normal * there, axis=1) > SMALL
        counts = closed.astype(int), acting.sum(axis=1)
        held, free = self._pivots(joint, pressed, np.where(moves, dofs, -1), counts, taken)
        contact = Contact(
            B=along(point, directions[point, which], k) @ relative,
            w=joint.friction * force[slips],
            beta=np.full(np.count_nonzero(slips), joint.beta),
            directions=np.count_nonzero(acting[slips], axis=1).astype(np.int64),
            held=along(np.flatnonzero(closed), normal[closed], k) @ relative,
            pivots=np.array(held + free, dtype=np.intp),
            clamped=force[closed],
        )
        patch = Patch(
            joint=joint,
            nodes=pressed[slips],
            points=start + np.arange(np.count_nonzero(slips)),
            normal_force=force[slips],
            area=area[slips],
            directions=directions[slips],
            normal=normal[slips],
            held_force=float(force[~slips].sum()),
            held_area=float(area[~slips].sum()),
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
        """Degrees of freedom that closed contact and slips of pairs determine: of the first nodes.

        Those of the second ones where the first's are not there (-1) or are taken by other pairs.
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

    @cached_property
    def unloaded(self) -> System:
        """System without loads, observed points and joints' names."""
        return System.from_matrices(
            self.M,
            self.K,
            self.C,
            fixed=self.fixed,
            contact=self.contact,
            stiffness_damping=self.stiffness_damping,
            mass_damping=self.mass_damping,
        )

    def system(self, loads: Sequence[Load] = (), points: Sequence[str] | None = None) -> System:
        """System of equations; observed are all loads, and ``points``, of all that there are.

        Raises
        ------
        InputError
            For unknown names, loads with a direction or a base, and what a support holds.
        """
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
        return loaded(self, applied, rows)

    def reactions(self, loads: Sequence[Load]) -> Reactions | None:
        """Change of the normal forces; None where no contact is closed."""
        if self.contact is None or not self.contact.normal_force.any():
            return None
        F = np.stack([self.points[str(load.on)] for load in loads], axis=1)
        return reactions(self.contact, self.fixed, (self.M, self.K), self.unloaded.T, F)

    def pressed_at(self, dof: int) -> str:
        """Joint of a degree of freedom that closed contact determines."""
        names = [j.name for j in self.joints if np.any(self.contacts[j.on][:, :6] == dof)]
        return f"joint {names[0]} at {self.spot(dof)}"

    def _wrong_loads(self, loads: Sequence[Load]) -> Iterator[str]:
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
        return f"{what}: no point has this name; points: {listed(self.points)}"

    def unusual(self, system: System) -> list[str]:
        """Sentence about pairs that slip as the whole moves rigidly, where nothing in K holds it.

        Nothing can be told of values whose units are not known.
        """
        rows = [(joint.on, self.contacts[joint.on]) for joint in self.joints]
        dofs = np.vstack([np.zeros((0, 6)), *(some[:, :6] for _, some in rows)]).reshape(-1, 2, 3)
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
        # As little as so many motions can slip, over how far they move the pairs.
        least = np.linalg.svd(slips.reshape(-1, loose.shape[1]))[2][-whole:].T
        moved = np.abs(at @ least).max(axis=(0, 1, 2))
        share = np.linalg.norm(slips @ least, axis=1) / np.where(moved > 0.0, moved, 1.0)
        worst = int(share.max(axis=1).argmax())
        if share[worst].max() <= ALIKE:
            return []
        names = [f"pair {k + 1} of contact.{name}" for name, some in rows for k in range(len(some))]
        return [
            "Matrices: K lets the structure move rigidly, which should move both nodes of a pair "
            f"alike, but {names[worst]} slips by up to {100.0 * share[worst].max():.3g} % of the "
            "motion: do its nodes lie in one place, and are the degrees of freedom of both in the "
            "order x, y, z and in the same directions?"
        ]

    def spot(self, dof: int) -> str:
        """A degree of freedom in a message."""
        return f"degree of freedom {dof + self.first}"


def _on_surfaces(joint: Joint) -> Iterator[str]:
    """What a joint has that pairs of nodes have not."""
    for name, usual in (("against", None), ("axis", None), ("normal_force", "consistent")):
        if getattr(joint, name) != usual:
            yield f"{joint.label}: {name}: found beside matrices, whose contacts tell; leave it out"
    if not isinstance(joint.pressure, int | float):
        what = repr(joint.pressure) if isinstance(joint.pressure, str) else "a table"
        yield (
            f"{joint.label}: pressure: found {what}, must be a number in Pa beside matrices; what "
            "differs from pair to pair goes into the areas"
        )


def _wrong_rows(rows: FloatArray, n: int, first: int) -> Iterator[str]:
    """What is wrong with the rows of a contact of ``n`` degrees of freedom, which count from 0."""
    if rows.ndim != 2 or rows.shape[1] != COLUMNS:
        yield (
            f"found shape {rows.shape}, must have {COLUMNS} columns: x, y, z degrees of freedom of "
            "the first node, of the second, normal x, y, z, area"
        )
        return
    if rows.dtype.kind not in "iuf":
        yield f"found {rows.dtype} values, must be real numbers"
        return
    dofs, absent = rows[:, :6], ~(rows[:, :6] >= 0.0)
    ordered = np.sort(np.where(absent, -1.0 - np.arange(6), dofs), axis=1)
    last = f"must be a whole number from {first} to {n - 1 + first}, or nothing"
    normal, area = rows[:, 6:9], rows[:, 9:]
    wrong: dict[str, Any] = {
        f"a degree of freedom {last}": ~absent & ((dofs >= n) | (dofs != np.floor(dofs))),
        "each degree of freedom must stand in it once": np.diff(ordered, axis=1) == 0.0,
        "the first node must have a degree of freedom": absent[:, :3].all(axis=1, keepdims=True),
        "the normal must be three finite numbers, not all 0": ~np.isfinite(normal)
        | ~normal.any(axis=1, keepdims=True),
        "the area must be a finite number >= 0": ~((area >= 0.0) & np.isfinite(area)),
    }
    for what, where in wrong.items():
        if where.any():
            row = int(np.argmax(where.any(axis=1)))
            given = rows[row] + first * (np.arange(COLUMNS) < 6)
            shown = ", ".join("" if np.isnan(x) else f"{x:g}" for x in given)
            yield f"pair {row + 1}, found {shown}: {what}"
