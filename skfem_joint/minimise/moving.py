"""Newton's method on the points that move, where many others rest.

Points that stick by Coulomb friction have no velocity, and rigid pressure points that press have
that of their bound. As long as they do so, all others obey the problem of their own rows and
columns of the dense matrix A:

    A_mm v_m + (forces of contact) = g_m - A_mr v_r    with the velocities v_r of those that rest.

So Newton's method works on few unknowns. All rows of those that move are read once at the start of
a step, for the residual there, and after each solution, to see whether the points that rest may do
so. Those that may not move from then on, and the problem is solved again. Therefore it is first
solved roughly. The solution does not depend on which points were tried at rest, but for what the
tolerance leaves.

Points close to their limit are taken for moving, so that a front of slip that advances seldom
reaches one that rests. Of contact that opens, points that are apart move, and so do pressure points
that press a friction point which moves. Where possible the points that are apart are eliminated
from those that move (:mod:`skfem_joint.minimise.touching`): from all points that would take
seconds, and the part that moves changes less in a step. The part of the step before serves as long
as it has all that move.

Constant contact of a solid with 2,969 points (5,938 unknowns), CPU ms a step, without products of
the step itself: 182 where all points are worked on and 51 here while up to a fifth of them slip,
530 and 360 where a third does. Contact that opens, 3,003 points of which 2,300 press and 690 slip:
a step took 0.3 s, and 3 to 7 s where points lifted off or closed; it takes 0.6 to 1.7 s.
"""

# mypy: allow-untyped-calls

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skfem_joint.ground.arrays import BoolArray, FloatArray, check_like
from skfem_joint.linalg.kernels import times
from skfem_joint.linalg.schur import FEWEST_MOVING
from skfem_joint.minimise.contact_loops import Pressing
from skfem_joint.minimise.contact_newton import _Forces
from skfem_joint.minimise.parts import PartOfContact
from skfem_joint.minimise.problem import ContactPoints, Minimum, Pressed
from skfem_joint.minimise.touching import TouchingNewton

#: Fewest unknowns of which those that move are separated.
FEWEST = FEWEST_MOVING
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
#: Work that is counted, see `Minimum`.
COUNTED = "newton_iterations", "friction_evaluations", "linear_solves", "factorizations"


class MovingNewton(TouchingNewton):
    """`ContactNewton` that works on those points alone that move, see the module.

    Attributes
    ----------
    part : _Moving or None
        Of the last solution; where contact opens it serves further ones, which depend on it.
    """

    def __init__(self, H: Any, points: ContactPoints) -> None:
        super().__init__(H, points)
        self.part: _Moving | None = None

    def minimise_beside(
        self,
        g: FloatArray,
        start: FloatArray | None,
        tolerance: float,
        beta: FloatArray | None,
        force: float,
        offset: FloatArray | None = None,
        pressed: Pressed | None = None,
    ) -> Minimum:
        """See `ContactNewton`."""
        others = tolerance, beta, force, offset, pressed
        if not self.dense or g.size < FEWEST:
            return super().minimise_beside(g, start, *others)
        contact = self.contact_of(beta, offset, pressed)
        scale, acts = self._scale(g, contact, force)
        if start is None:
            start = self._start(g, contact, force)
        v, forces = start.copy() if acts else np.zeros_like(start), _Forces(contact, g.size)
        _press(v, contact.pressing)
        r, counts = self._balanced(v, g, forces), Counter(dict.fromkeys(COUNTED, 0))
        if forces.residual <= tolerance * scale:
            return self._minimum(v, forces, True, dict(counts))
        enough, rounds = max(tolerance, ROUGHLY), 0
        while 0 < np.count_nonzero(moves := self._moves(forces, CLOSE)) <= MOST * g.size:
            part = self.part if rounds or self.opens else None
            if part is None or self._moves(forces, 1.0)[part.others].any():
                if part is not None and rounds:
                    moves[part.unknowns] = True
                part = _Moving(self, moves)
            elif not rounds:
                if part.unknowns.size > SPARE * np.count_nonzero(moves):
                    part = _Moving(self, moves)
            elif enough == tolerance:
                break
            else:
                enough = tolerance
            if rounds == 0:
                part.problem.forget()  # what it keeps is not saved
            self.part, rounds = part, rounds + 1
            k = part.unknowns
            right = r[k] + times(part.problem.H, v[k])
            share = scale / max(float(np.abs(right).max(initial=0.0)), scale)
            found = part.solved(right, v, share * enough, beta, scale, offset, pressed)
            self.factorizations += found.counts["factorizations"]
            counts.update(found.counts)
            v[k] = found.v
            r = self._balanced(v, g, forces)
            if forces.residual <= tolerance * scale:
                return self._minimum(v, forces, True, dict(counts))
            if not found.converged:
                break
        found = super().minimise_beside(g, v, *others)
        counts.update(found.counts)
        return replace(found, counts=dict(counts))

    def _balanced(self, v: FloatArray, g: FloatArray, forces: _Forces) -> FloatArray:
        """Residual without contact, and ``forces`` at ``v``."""
        r = g - times(self.H, v)
        if self.opens:
            forces.renew(v, r)
        forces.balance(v, r)
        return r

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
        moves = np.zeros(self.diagonal.size, dtype=np.bool_)
        if not self.opens or self.part is None:
            return super().saved()
        moves[self.part.unknowns] = True
        return super().saved() | {"moves": moves}

    def check(self, saved: dict[str, NDArray[Any]]) -> None:
        """See `StepProblem`."""
        of_part = {name: x for name, x in saved.items() if name == "moves"}
        if of_part:
            check_like(of_part, {"moves": self.limited}, "step problem")
        super().check({name: x for name, x in saved.items() if name != "moves"})

    def restore(self, saved: dict[str, NDArray[Any]]) -> None:
        """See `StepProblem`."""
        super().restore({name: x for name, x in saved.items() if name != "moves"})
        self.part = _Moving(self, saved["moves"]) if "moves" in saved else None


def _press(v: FloatArray, pressing: Pressing) -> None:
    """Set approaches of rigid points that are at their bounds, or close to them, to these.

    Points that press there rest; others are found to pull, and move.
    """
    place, bound, stiffness = pressing
    close = v[place] >= bound - AT_BOUND * np.abs(v[place]).max(initial=0.0)
    closed = close & np.isinf(stiffness)
    v[place[closed]] = bound[closed]


class _Moving(PartOfContact):
    """The part of a problem that moves, and its ``problem``; points that are apart are in it."""

    def __init__(self, whole: MovingNewton, moves: BoolArray) -> None:
        super().__init__(whole.points, moves)
        k = self.unknowns
        self.problem = TouchingNewton(whole.H[np.ix_(k, k)], self.points)

    def solved(
        self,
        right: FloatArray,
        v: FloatArray,
        tolerance: float,
        beta: FloatArray | None,
        force: float,
        offset: FloatArray | None,
        pressed: Pressed | None,
    ) -> Minimum:
        """Minimum of the part for its ``right`` side; all else as in `minimise_of`."""
        some = None
        if pressed is not None and pressed.touching is not None:
            some = pressed.touching.among(self.pressures)
        found = self.minimise_of(
            self.problem, right, v, tolerance, beta, force, offset, pressed, some
        )
        if pressed is not None and some is not None:
            pressed.touching.take_over(self.pressures, some)
        return found
