"""Newton's method for contact on fewer unknowns: those of the contact, and of them what moves.

Contact acts on slips and approaches alone. `CondensedNewton` eliminates all other unknowns once and
works on a smaller matrix A, which is mostly dense, for any number of right sides; slips and mean
approaches are its unknowns (:mod:`skfem_joint.minimise.mean_approaches`).

`MovingNewton` works on few of these. Points that stick by Coulomb friction have no velocity, and
rigid pressure points that press have that of their bound. As long as they do so, all others obey
the problem of their own rows and columns:

    A_mm v_m + (forces of contact) = g_m - A_mr v_r    with the velocities v_r of those that rest.

So Newton's method works on few unknowns. All rows of those that move are read once at the start of
a step, for the residual there, and after each solution, to see whether the points that rest may do
so. Those that may not move from then on, and the problem is solved again. Therefore it is first
solved roughly. The solution does not depend on which points were tried at rest, but for what the
tolerance leaves.

Points close to their limit are taken for moving, so that a front of slip that advances seldom
reaches one that rests. Of contact that opens, points that are apart move, and so do pressure points
that press a friction point which moves. But where many points are apart
(:mod:`skfem_joint.minimise.touching`) their unknowns e, whose equations are linear, are eliminated:

    A_mm - A_me A_ee^-1 A_em    in place of A_mm,

from step to step by the changes of e and m alone (:mod:`skfem_joint.linalg.eliminated`): anew that
would take a second. The part of the step before serves as long as it has all that move.

Constant contact of a solid with 2,969 points (5,938 unknowns), CPU ms a step, without products of
the step itself: 182 where all points are worked on and 51 here while up to a fifth of them slip,
530 and 360 where a third does. Contact that opens, 3,003 points of which 2,300 press and 690 slip:
a step took 0.3 s, and 3 to 7 s where points lifted off or closed; it took 0.6 to 1.7 s with the
points that are apart eliminated anew in each step, and takes 0.3 to 0.7 s, more than half of
which is for the factors of the unsymmetric tangent of the points that slip or have just lifted off.
"""

# mypy: allow-untyped-calls

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from copy import copy
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from skfem_joint.ground.arrays import BoolArray, FloatArray, IntArray, as_dense, check_like
from skfem_joint.linalg.eliminated import Eliminated
from skfem_joint.linalg.kernels import times
from skfem_joint.linalg.schur import FEWEST_MOVING, AllKept, SchurComplement
from skfem_joint.minimise.contact_loops import Pressing
from skfem_joint.minimise.contact_newton import ContactNewton, _Forces
from skfem_joint.minimise.limits import Hinges
from skfem_joint.minimise.linearisation import Linearisation
from skfem_joint.minimise.mean_approaches import MeanApproaches
from skfem_joint.minimise.problem import (
    ContactPoints,
    Minimum,
    Pressed,
    PressurePoints,
    StepProblem,
)

#: Largest share of unknowns that move for which it pays.
MOST = 0.6
#: Share of its limit from which on the friction of a point at rest may soon reach it.
CLOSE = 0.6
#: Distance of an approach from its bound, over the largest approach, at which a point may press.
AT_BOUND = 1e-2
#: Unknowns that a part may have, over those it needs, where it serves further solutions.
SPARE = 1.3
#: Residual, relative to the largest force, at which points that rest are looked at first.
ROUGHLY = 1e-2
#: Solutions to the tolerance, each of which corrects for round-off of the eliminated points.
MOST_CORRECTIONS = 3
#: Work that is counted, see `Minimum`.
COUNTED = "newton_iterations", "friction_evaluations", "linear_solves", "factorizations"


class CondensedNewton(StepProblem):
    """`MovingNewton` on the Schur complement of the unknowns in contact, see `StepProblem`.

    Parameters
    ----------
    H, points
        See `StepProblem`.
    beside : ndarray of int
        More unknowns that are kept.

    Attributes
    ----------
    schur : SchurComplement
        Of H, on the unknowns of points with friction and of pressure points.
    contact : MovingNewton
        The problem of these unknowns, or of slips and mean approaches.

    Raises
    ------
    InputError
        If approaches of pressure points depend on each other.
    """

    def __init__(self, H: Any, points: ContactPoints, beside: Sequence[int] = ()) -> None:
        self.H, self.points = H, points
        acts = points.w > 0.0 if points.normal is None else np.ones(points.w.size, dtype=bool)
        self._limited = np.flatnonzero(points.on_rows(acts))
        self._points = np.flatnonzero(acts)
        kept, self.means = np.unique(points.unknowns[self._limited]), None
        if points.normal is not None:
            kept = np.union1d(kept, sparse.csr_array(points.normal.N).indices)
        kept = np.union1d(kept, np.array(beside, dtype=kept.dtype))
        self.schur = SchurComplement(H, kept)
        self.matrix = self.schur.complement
        if points.normal is not None:
            self.means = MeanApproaches.of(as_dense(self.matrix), self._acting())
            self.matrix = as_dense(self.matrix) if self.means is None else self.means.matrix
        self.contact = self._contact()

    def _acting(self) -> ContactPoints:
        """Points with friction, and pressure points, in the unknowns of the complement."""
        return _some_of(self.points, self._points, self._limited, self.schur.kept, slice(None))

    def _contact(self) -> MovingNewton:
        acting = self._acting()
        return MovingNewton(
            self.matrix, acting if self.means is None else self.means.points_of(acting)
        )

    def with_limits(self, points: ContactPoints) -> CondensedNewton:
        """Problem with other friction limits, zero where they were zero, and the same factors."""
        other = copy(self)
        other.points = points
        other.contact = other._contact()
        return other

    def of_kept(self) -> CondensedNewton:
        """The same problem, with the same factors, of the kept unknowns as all there are."""
        other = copy(self)
        other.points, other.H = self.points.in_unknowns(self.schur.kept), self.schur.complement
        other.schur = AllKept(self.schur.complement)
        return other

    @property
    def factorizations(self) -> int:
        """Matrices factorised so far, that of the interior included."""
        return self.contact.factorizations + 1

    def linearisation(self, beta: FloatArray | None = None) -> Linearisation:
        """See `LinearisedProblem`; of the unknowns of the contact."""
        points = self.points.in_unknowns(self.schur.kept)
        if self.points.normal is not None:  # all points are those of the contact
            points = self.contact.points
        return Linearisation(self.contact.H, points.with_beta(beta), self)

    def compile(self) -> None:
        """See `StepProblem`."""
        self.contact.compile()

    def restrict(self, g: FloatArray) -> tuple[FloatArray, Any]:
        """Right side of the contact, (k,) or (k, m), and what `extend` needs beside it."""
        right, interior = self.schur.restrict(g)
        if self.means is None:
            return right, (None, interior)
        right, beside = self.means.restrict(right)
        return right, (beside, interior)

    def extend(self, z: FloatArray, beside: Any) -> FloatArray:
        """All unknowns, (n,) or (n, m), from those of the contact."""
        of_means, interior = beside
        return self.schur.extend(
            z if self.means is None else self.means.extend(z, of_means), interior
        )

    def start_of(self, v: FloatArray) -> FloatArray:
        """Unknowns of the contact, (k,), of all."""
        return v[self.schur.kept] if self.means is None else self.means.start_of(v[self.schur.kept])

    def minimise(
        self,
        g: FloatArray,
        start: FloatArray | None = None,
        tolerance: float = 1e-11,
        beta: FloatArray | None = None,
        offset: FloatArray | None = None,
        pressed: Pressed | None = None,
    ) -> Minimum:
        """See `StepProblem`."""
        force = float(np.abs(g).max())
        right, beside = self.restrict(g)
        law = None if beta is None else beta[self._points]
        slips = None if offset is None else offset[self._limited]
        z = None if start is None else self.start_of(start)
        inner = self.contact.minimise(right, z, tolerance, law, slips, pressed, force)
        v, friction = self.extend(inner.v, beside), np.zeros(self.points.B.shape[0])
        friction[self._limited] = inner.sigma
        where = inner.where
        if self.means is not None:
            where = self.means.unknown(where)
        return replace(
            inner,
            v=v,
            sigma=friction,
            converged=inner.converged and bool(np.all(np.isfinite(v))),
            counts=inner.counts | {"linear_solves": inner.counts["linear_solves"] + 2},
            where=int(self.schur.kept[where]),
            w=self.points.w if pressed is None else inner.w,
        )

    def saved(self) -> dict[str, NDArray[Any]]:
        """See `StepProblem`."""
        return self.contact.saved()

    def check(self, saved: dict[str, NDArray[Any]]) -> None:
        """See `StepProblem`."""
        self.contact.check(saved)

    def restore(self, saved: dict[str, NDArray[Any]]) -> None:
        """See `StepProblem`."""
        self.contact.restore(saved)


class MovingNewton(ContactNewton):
    """`ContactNewton` that works on those points alone that move, see the module.

    Attributes
    ----------
    part : _Moving or None
        Of the last solution; where contact opens it serves further ones, which depend on it.
    eliminated : Eliminated
        The matrix without points that are apart.
    """

    def __init__(self, H: Any, points: ContactPoints) -> None:
        super().__init__(H, points)
        self.part: _Moving | None = None
        self.eliminated = Eliminated(H)
        self._apart: tuple[BoolArray, BoolArray] | None = None  # for the points that touch

    def minimise(
        self,
        g: FloatArray,
        start: FloatArray | None = None,
        tolerance: float = 1e-11,
        beta: FloatArray | None = None,
        offset: FloatArray | None = None,
        pressed: Pressed | None = None,
        force: float = 0.0,
    ) -> Minimum:
        """See `ContactNewton`."""
        others = tolerance, beta, offset, pressed, force
        few, touching = g.size < FEWEST_MOVING, None if pressed is None else pressed.touching
        if not self.dense or (few and (touching is None or not touching.some_apart)):
            return super().minimise(g, start, *others)
        contact = self.contact_of(beta, offset, pressed)
        scale, acts = self._scale(g, contact, force)
        if start is None:
            start = self._start(g, contact, force)
        v, forces = start.copy() if acts else np.zeros_like(start), _Forces(contact, g.size)
        _press(v, contact.pressing)
        r, counts = self._balanced(v, g, forces), Counter(dict.fromkeys(COUNTED, 0))
        if forces.residual <= tolerance * scale:
            return self._minimum(v, forces, True, dict(counts))
        # Of few unknowns all those move that are not eliminated.
        enough, rounds, fine = tolerance if few else max(tolerance, ROUGHLY), 0, 0
        while True:
            apart = self._of_points_apart(pressed)
            moves = ~apart if few else self._moves(forces, CLOSE) & ~apart
            if not (few or 0 < np.count_nonzero(moves) <= MOST * g.size):
                break
            must = moves if few else self._moves(forces, 1.0) & ~apart
            part = self.part if rounds or self.opens else None
            if part is None or must[part.others].any() or not np.array_equal(part.apart, apart):
                if part is not None and rounds:
                    moves[part.unknowns] = ~apart[part.unknowns]
                part = _Moving(self, moves, apart)
            elif not rounds:
                if part.unknowns.size > SPARE * np.count_nonzero(moves):
                    part = _Moving(self, moves, apart)
            elif enough == tolerance:
                fine += 1
                if fine == MOST_CORRECTIONS:
                    break
            else:
                enough = tolerance
            if rounds == 0:
                part.problem.forget()  # what it keeps is not saved
            self.part, rounds = part, rounds + 1
            found = part.advanced(v, r, scale, enough, beta, offset, pressed)
            self.factorizations += found.counts["factorizations"]
            counts.update(found.counts)
            closes = touching is not None and touching.closes(
                v[contact.pressing.place], contact.pressing.bound
            )
            r = self._balanced(v, g, forces)
            if forces.residual <= tolerance * scale and not closes:
                return self._minimum(v, forces, True, dict(counts))
            if not found.converged:
                break
        found = super().minimise(g, v, *others)
        counts.update(found.counts)
        return replace(found, counts=dict(counts))

    def _of_points_apart(self, pressed: Pressed | None) -> BoolArray:
        """Unknowns, (n,), of points that are eliminated.

        Friction points stay if one of their pressure points does, or none presses them, and if they
        share an unknown with such. None is eliminated while one of them has a limit of its own.
        """
        points, none = self.points, np.zeros(self.diagonal.size, dtype=np.bool_)
        touching = None if pressed is None else pressed.touching
        if pressed is None or points.normal is None or not (touching and touching.some_apart):
            return none
        if self._apart is None or not np.array_equal(self._apart[0], touching.kept):
            gain, rows = sparse.csr_array(points.normal.gain), points.unknowns
            touched = np.diff(gain[:, np.flatnonzero(touching.kept)].indptr) > 0
            rubs = points.on_rows(touched | (np.diff(gain.indptr) == 0))
            apart = ~none
            apart[rows[rubs]] = False
            apart[sparse.csr_array(points.normal.N).indices[touching.kept]] = False
            self._apart = touching.kept.copy(), apart
        apart = self._apart[1]
        return (
            none
            if np.any(pressed.given[apart[self.points.unknowns[self.points.first_row[:-1]]]] > 0.0)
            else apart
        )

    def _moves(self, forces: _Forces, share: float) -> BoolArray:
        """Unknowns, (n,), of points that do not rest with less than a share of their limit.

        Those of pressure points are among them that press such a friction point.
        """
        points = forces.contact.points
        of_points = np.diff(points.start)
        moves = ~forces.held
        close = np.hypot(*forces.friction.T) >= share
        moves[np.repeat(points.first, of_points)[close]] = True
        both = points.second >= 0
        first, second = points.first[both], points.second[both]
        moves[first] = moves[second] = moves[first] | moves[second]
        if self.opens:
            limits = forces.contact.limits
            moving = np.repeat(moves[points.first], of_points)
            pressing = limits.column[np.repeat(moving, np.diff(limits.start))]
            moves[forces.contact.pressing.place[pressing]] = True
        return moves

    def saved(self) -> dict[str, NDArray[Any]]:
        """See `StepProblem`."""
        if not self.opens or self.part is None:
            return super().saved()
        moves = np.zeros(self.diagonal.size, dtype=np.bool_)
        moves[self.part.unknowns] = True
        own = {"moves": moves, "apart": self.part.apart.copy()}
        return super().saved() | own | self.eliminated.saved()

    def check(self, saved: dict[str, NDArray[Any]]) -> None:
        """See `StepProblem`."""
        parts = [{name: saved[name] for name in names if name in saved} for names in _OF_PART]
        if any(parts):
            check_like(parts[0], dict.fromkeys(_OF_PART[0], self.limited), "step problem")
            self.eliminated.check(parts[1])
        super().check(_of_whole(saved))

    def restore(self, saved: dict[str, NDArray[Any]]) -> None:
        """See `StepProblem`."""
        super().restore(_of_whole(saved))
        self.part = None
        if "moves" in saved:
            self.eliminated.restore(saved)
            self.part = _Moving(self, saved["moves"], saved["apart"])


#: What is saved of the part that moves, and of the points that are eliminated.
_OF_PART = ("moves", "apart"), ("changes", "changed", "since")


def _of_whole(saved: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """What is saved beside `_OF_PART`."""
    return {name: x for name, x in saved.items() if name not in sum(_OF_PART, ())}


def _press(v: FloatArray, pressing: Pressing) -> None:
    """Set approaches of rigid points that are at their bounds, or close to them, to these.

    Points that press there rest; others are found to pull, and move.
    """
    place, bound, stiffness = pressing
    close = v[place] >= bound - AT_BOUND * np.abs(v[place]).max(initial=0.0)
    closed = close & np.isinf(stiffness)
    v[place[closed]] = bound[closed]


def _some_of(
    points: ContactPoints, frictions: IntArray, rows: IntArray, kept: IntArray, presses: Any
) -> ContactPoints:
    """Some friction points, with their slip rows, and pressure points in the unknowns ``kept``."""
    normal = points.normal
    if normal is not None:
        gain = sparse.csr_array(sparse.csr_array(normal.gain)[frictions][:, presses])
        N = sparse.csr_array(sparse.csr_array(normal.N)[presses][:, kept])
        normal = PressurePoints(N, gain, normal.stiffness[presses])
    flexible = None if points.flexible is None else points.flexible[frictions]
    laws = points.directions[frictions], points.w[frictions], points.beta[frictions]
    return ContactPoints(points.B[rows][:, kept], *laws, flexible, normal)


class _Moving:
    """The part of a problem that moves, and its ``problem``, without points that are ``apart``.

    Attributes
    ----------
    unknowns, others : ndarray of int
        Unknowns in the part, and all others; of each point all are, or none.
    """

    def __init__(self, whole: MovingNewton, moves: BoolArray, apart: BoolArray) -> None:
        points, self.apart, k = whole.points, apart, np.flatnonzero(moves)
        self.unknowns, self.others = k, np.flatnonzero(~moves)
        self._frictions = np.flatnonzero(moves[points.unknowns[points.first_row[:-1]]])
        self._rows, self._presses = np.flatnonzero(moves[points.unknowns]), k[:0]
        if points.normal is not None:
            self._presses = np.flatnonzero(moves[sparse.csr_array(points.normal.N).indices])
        self._out, self._eliminated = np.flatnonzero(apart), whole.eliminated
        if self._out.size:
            self._eliminated.let(apart, k)
            matrix = self._eliminated.complement(k)
        else:
            matrix = whole.H[np.ix_(k, k)]
        some = _some_of(points, self._frictions, self._rows, k, self._presses)
        self.problem = ContactNewton(matrix, some)

    def advanced(
        self,
        v: FloatArray,
        r: FloatArray,
        scale: float,
        tolerance: float,
        beta: FloatArray | None,
        offset: FloatArray | None,
        pressed: Pressed | None,
    ) -> Minimum:
        """Minimum of the part, from ``v`` with the residual ``r`` without contact.

        The velocities ``v`` of the part and of points that are apart are set to it. The tolerance
        refers to ``scale``, N. Other arguments are those of all points.
        """
        k, before = self.unknowns, v[self.unknowns]
        right, moved = r[k], np.zeros(0)
        if self._out.size:
            right, moved = self._eliminated.restrict(r, k)
        right = right + times(self.problem.H, before)
        share = scale / max(float(np.abs(right).max(initial=0.0)), scale)
        found = self.problem.minimise(
            right,
            before,
            share * tolerance,
            None if beta is None else beta[self._frictions],
            None if offset is None else offset[self._rows],
            None if pressed is None else self._pressed(pressed),
            scale,
        )
        v[k] = found.v
        if self._out.size:
            v[self._out] += moved + self._eliminated.follow(found.v - before, k)
        return found

    def _pressed(self, pressed: Pressed) -> Pressed:
        """What the part's points are given where contact opens."""
        c, f = self._presses, self._frictions
        hinges, gain = pressed.hinges, np.asarray(pressed.gain, dtype=float)
        if hinges is not None:
            *of_points, bias = hinges
            hinges = Hinges._make([*(x[f] for x in of_points), bias[self._rows]])
        gain = gain[c] if gain.ndim else gain
        return Pressed(pressed.bound[c], pressed.given[f], gain, hinges)
