"""A smaller model's correction of the change that a period adds to a larger model's state.

The search for steady vibration looks for a state x with g(x) = x, g being the map of half a period
and a change of sign. If a reduced model of the same structure vibrates nearly alike, the derivative
J of its own map tells how far the motions that it has are from their end: with W, which takes
states of the larger model to those of the reduced one, and V, which takes these back,

    r + V ((1 - J)^-1 - 1) W r,        r = g(x) - x,

is Newton's step in these motions and plain iteration in all others. Mixing
(:mod:`skfem_joint.steady.steady`) works with it in place of r; where r is zero, so is this. It is
the coarse correction of a method of two levels (W. L. Briggs, V. E. Henson, S. F. McCormick, A
Multigrid Tutorial, SIAM 2000, chapter 3). On a lapped solid of 777 unknowns, of which 400 to 700
move, searches took 7 to 20 periods in place of 12 to 32.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skfem_joint.ground.arrays import FloatArray
from skfem_joint.steady.transition import transition
from skfem_joint.stepping.arrangement import Arranged, arranged
from skfem_joint.stepping.plan import Plan
from skfem_joint.stepping.warp import warped
from skfem_joint.system.system import System

#: Largest condition number of 1 + J: beyond it a motion is at resonance without damping and slip.
LARGEST_CONDITION = 1e12


@dataclass(frozen=True)
class Correction:
    """Newton's step of a reduced model, less its change.

    Attributes
    ----------
    down : ndarray, shape (k, n)
        The reduced model's displacement of a larger one's.
    up : ndarray, shape (n, k)
        The larger model's displacement of a reduced one's.
    matrix : ndarray, shape (2 k, 2 k)
        (1 - J)^-1 - 1 in advanced states p and r / omega, see `skfem_joint.steady.advanced`.
    omega : float
        Frequency, rad/s.
    """

    down: FloatArray
    up: FloatArray
    matrix: FloatArray
    omega: float

    @staticmethod
    def of(
        system: System, plan: Plan, velocities: FloatArray, down: FloatArray, up: FloatArray
    ) -> Correction | None:
        """Correction by a reduced system; None if its steps are not dense or 1 + J is singular.

        None with springs in series with friction, too, of whose forces it knows nothing.

        Parameters
        ----------
        system : System
        plan : Plan
            Of a period.
        velocities : ndarray, shape (steps, k)
            At the ends of the steps of half a period, m/s.
        down, up : ndarray
            See `Correction`.
        """
        to, omega = arranged(system), 2.0 * np.pi / plan.duration
        if to.kind != "dense" or to.maps or system.contact.has_springs:
            return None
        stepped = warped(to.system, plan.warp)
        J = transition(stepped, to.kind, plan.step, velocities / plan.warp, omega)
        if J.moving.size < system.n:
            return None
        one = np.eye(2 * system.n)
        if np.linalg.cond(one + J.matrix) > LARGEST_CONDITION:
            return None
        return Correction(down, up, np.linalg.inv(one + J.matrix) - one, omega)

    def added(self, change: FloatArray, to: Arranged) -> FloatArray:
        """What is added to a change (2 n,) of an advanced state in stepping unknowns."""
        p, r = np.split(change, 2)
        parts = self.down @ to.outer(p), self.down @ to.outer(r) / self.omega
        p, r = np.split(self.matrix @ np.concatenate(parts), 2)
        return np.concatenate([to.inner(self.up @ p), self.omega * to.inner(self.up @ r)])
