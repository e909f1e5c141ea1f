"""Friction limits that follow normal forces, where contact opens and closes.

The limit of a friction point is what is given plus a function of x, the gain times the forces of
the pressure points around it, and never below 0:

    w = max(0, given + gain p).

Newton's method has the change of the limits in its tangent (`skfem_joint.minimise.contact_newton`).
Where that iteration stalls, limits are kept until the convex problem for them is solved, and then
renewed, see `Renewal`.
"""

# mypy: allow-untyped-calls

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from scipy import linalg

from skfem_joint.ground.arrays import FloatArray

#: Limits that are kept in mind to find the next ones.
HISTORY = 8
#: Share of the change of limits that is taken where larger ones swing.
DAMPED = 0.5


class Hinges(NamedTuple):
    """How the friction of each point follows x, the gain times the forces of rigid points.

    Functions with a kink, as max(0, x - lower) has at ``lower``, are called hinges. The limit is
    w = given + first x + max(0, x - lower) + beyond max(0, x - upper), all (m,), and the friction
    w sigma + min(4 w, cap) bias, with the bias of each slip row, (rows,).
    """

    first: Any
    lower: Any
    upper: Any
    beyond: Any
    cap: Any
    bias: Any


class Renewal:
    """Friction limits that become those of their own normal forces, by Anderson's acceleration.

    The map of limits to the limits of the normal forces under them has a fixed point for any
    friction, but contracts only where friction is not far above 1.
    """

    def __init__(self) -> None:
        self.limits: list[FloatArray] = []
        self.changes: list[FloatArray] = []
        self.least, self.since, self.share = np.inf, 0, 1.0

    def next(self, limits: FloatArray, image: FloatArray) -> FloatArray:
        """Limits to try next, (m,), N, from ``limits`` and those of the forces under them."""
        change = image - limits
        size = float(np.linalg.norm(change))
        self.since += 1
        if size <= 0.5 * self.least:
            self.least, self.since = size, min(self.since, 0)
        if self.since >= 0 and (size > 10.0 * self.least or self.since > HISTORY):
            self.limits, self.changes, self.since = [], [], -HISTORY
            self.share *= DAMPED
        if self.since < 0:  # small steps converge where large ones swing
            return limits + self.share * change
        self.limits, self.changes = [*self.limits, limits], [*self.changes, change]
        del self.limits[:-HISTORY], self.changes[:-HISTORY]
        step = change.copy()
        if len(self.changes) > 1:
            of_changes, of_limits = np.diff(self.changes, axis=0).T, np.diff(self.limits, axis=0).T
            shares = linalg.lstsq(of_changes, change, cond=1e-10)[0]
            step -= (of_limits + of_changes) @ shares
        return np.maximum(limits + step, 0.0)
