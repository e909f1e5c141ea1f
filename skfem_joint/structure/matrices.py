"""A structure that is given by its matrices, as another finite-element program exports them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy import sparse

from skfem_joint.arrays import FloatArray, IntArray, Matrix
from skfem_joint.errors import InputError
from skfem_joint.structure.contact import along
from skfem_joint.structure.patch import SMALL, Joint, Patch, slip_directions, unit_vectors
from skfem_joint.structure.structure import Load
from skfem_joint.system import AppliedLoad, System
from skfem_joint.unknowns import Contact, stacked

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
        _ = self._unloaded  # refuses what is wrong

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
    def _made(self) -> list[tuple[Patch, sparse.csr_array]]:
        """Patch of each joint, and the rows that vanish because its contact stays closed."""
        made: list[tuple[Patch, sparse.csr_array]] = []
        problems: list[str] = []
        for joint in self.joints:
            if joint.on not in self.contacts:
                names = ", ".join(map(repr, sorted(self.contacts))) or "none"
                problems.append(f"{joint.label}: no contact has this name; contacts: {names}")
            elif found := [*_wrong_rows(self.contacts[joint.on], self.n_nodes, self.first)]:
                problems += [f"contact.{joint.on}: {problem}" for problem in found]
            else:
                made.append(self._patch(joint, sum(patch.points.size for patch, _ in made)))
        if problems:
            raise InputError(problems)
        return made

    def _patch(self, joint: Joint, start: int) -> tuple[Patch, sparse.csr_array]:
        rows = self.contacts[joint.on]
        force = np.asarray(joint.pressure, dtype=float) * rows[:, -1]
        pressed = np.flatnonzero(force > 0.0)
        normal, area = unit_vectors(rows[pressed, 6:9]), rows[pressed, -1]
        there = self._there(rows[pressed])
        directions = slip_directions(normal, ~there.any(axis=1))
        slips = np.any(directions[:, 0] != 0.0, axis=1)
        closed = along(np.arange(pressed.size), normal, pressed.size) @ self._relative(
            pressed, joint
        )
        patch = Patch(
            joint=joint,
            nodes=pressed[slips],
            points=start + np.arange(np.count_nonzero(slips)),
            normal_force=force[pressed[slips]],
            area=area[slips],
            directions=directions[slips],
            normal=normal[slips],
            cells=np.zeros((0, 2), dtype=np.intp),
            other=None,
            held_nodes=np.zeros(0, dtype=np.intp),
            held_normal=None,
            held_force=float(force[pressed[~slips]].sum()),
            held_area=float(area[~slips].sum()),
            bolt_shares=(),
        )
        return patch, closed[np.flatnonzero(np.sqrt(closed.multiply(closed).sum(axis=1)) > SMALL)]

    def _there(self, rows: FloatArray) -> Any:
        """Whether both nodes of pairs have degrees of freedom that move, (k, 2, 3)."""
        dofs = rows[:, :6].reshape(-1, 2, 3)
        return (dofs >= 0.0) & ~np.isin(dofs, self.fixed)

    def _relative(self, pairs: IntArray, joint: Joint) -> sparse.csr_array:
        """Displacement of the first nodes of pairs less that of the second, (3 k, N)."""
        rows = self.contacts[joint.on][pairs]
        pair, side, component = np.nonzero(self._there(rows))
        dofs = rows[:, :6].reshape(-1, 2, 3)[pair, side, component].astype(np.intp)
        entries = 1.0 - 2.0 * side, (3 * pair + component, dofs)
        return sparse.csr_array(sparse.coo_array(entries, shape=(3 * pairs.size, self.n_nodes)))

    @cached_property
    def contact(self) -> Contact | None:
        """Slip rows of all joints; None without."""
        if not self._made:
            return None
        slips, limits, betas, counts = [], [], [], []
        for patch, _ in self._made:
            acting = np.any(patch.directions != 0.0, axis=2)
            point, which = np.nonzero(acting)
            relative = self._relative(patch.nodes, patch.joint)
            slips.append(along(point, patch.directions[point, which], patch.nodes.size) @ relative)
            limits.append(patch.joint.friction * patch.normal_force)
            betas.append(np.full(patch.nodes.size, patch.joint.beta))
            counts.append(np.count_nonzero(acting, axis=1))
        return Contact(
            B=stacked(slips, self.n_nodes),
            w=np.concatenate(limits),
            beta=np.concatenate(betas),
            directions=np.concatenate(counts).astype(np.int64),
            held=stacked([closed for _, closed in self._made], self.n_nodes),
        )

    @cached_property
    def _unloaded(self) -> System:
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
        base, problems = self._unloaded, [*self._wrong_loads(loads)]
        observed = list(self.points) if points is None else list(points)
        problems += [
            self._unknown(f"points: {name!r}") for name in observed if name not in self.points
        ]
        if problems:
            raise InputError(problems)
        names = dict.fromkeys([*(str(load.on) for load in loads), *observed])
        rows = {name: np.asarray(base.T.T @ self.points[name]) for name in names}
        for name in rows:
            if not rows[name].any():
                problems.append(f"points: {name!r} is supported and does not move")
        if problems:
            raise InputError(problems)
        points_of = [patch.points for patch in self.patches]
        numbers = np.concatenate([np.zeros(0, np.intp), *points_of])
        owner = np.repeat(np.arange(len(points_of)), [some.size for some in points_of])
        system = replace(
            base,
            loads=tuple(AppliedLoad(rows[str(x.on)], x.amplitude, str(x.on)) for x in loads),
            P=stacked([row[np.newaxis] for row in rows.values()], base.n),
            points=tuple(rows),
            J=sparse.csr_array(
                (np.ones(numbers.size), (owner, numbers)), shape=(len(points_of), base.w.size)
            ),
            joints=tuple(joint.name for joint in self.joints),
        )
        ratio = self.damping_ratio
        return system if ratio is None else system.with_damping_ratio(ratio)

    def _wrong_loads(self, loads: Sequence[Load]) -> Iterator[str]:
        for load in loads:
            if load.on is None:
                yield (
                    f"{load.label}: matrices do not tell which way their degrees of freedom point; "
                    "give the vector M r of the base's unit motion r as a point, and load that"
                )
            elif load.on not in self.points:
                yield self._unknown(load.label)
            elif load.direction is not None:
                yield f"{load.label}: direction: found beside [matrices], which tell; leave it out"

    def _unknown(self, what: str) -> str:
        names = ", ".join(map(repr, sorted(self.points))) or "none"
        return f"{what}: no point has this name; points: {names}"

    def unusual(self, system: System) -> list[str]:
        """Nothing can be told of values whose units are not known."""
        return []

    def place(self, unknown: int) -> str:
        """Where an unknown is: the degree of freedom that it moves most."""
        dof = int(np.abs(self._unloaded.T[:, [unknown]].toarray()).argmax())
        return f"of degree of freedom {dof + self.first}"


def _wrong_rows(rows: FloatArray, n: int, first: int) -> Iterator[str]:
    """What is wrong with the rows of a contact of ``n`` degrees of freedom, which count from 0."""
    if rows.ndim != 2 or rows.shape[1] != COLUMNS:
        yield (
            f"found shape {rows.shape}, must have {COLUMNS} columns: x, y, z degrees of freedom of "
            "the first node, of the second, normal x, y, z, area"
        )
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
