"""Advanced states, which steps of the trapezoidal rule depend on alone.

A step of the trapezoidal rule depends on displacement u, velocity v and acceleration d through two
vectors alone, the *advanced state*

    p = u + (h/2) v,        r = v + (h/2) d,

of displacement and velocity half a step ahead by Euler's method. Where friction has springs in
series, of stiffness k and under the forces q, it depends on the *advanced forces*, too,

    e = q + k (h/2) B v,

those half a step ahead if all sliders stuck.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skfem_joint.ground.arrays import FloatArray, IntArray
from skfem_joint.stepping.schemes import State
from skfem_joint.system.system import System


def advanced(state: State, h: float) -> FloatArray:
    """Advanced state (2 n,), p (m) and r (m/s), of a state before a step of ``h`` seconds."""
    return np.concatenate([state.u + 0.5 * h * state.v, state.v + 0.5 * h * state.d])


def state_of(x: FloatArray, sigma: FloatArray, h: float) -> State:
    """A state of an advanced state (2 n,): that without acceleration. ``sigma`` is its friction."""
    p, r = np.split(x, 2)
    none = np.zeros_like(p)
    return State(p - 0.5 * h * r, r.copy(), none, none.copy(), sigma.copy())


@dataclass(frozen=True)
class Springs:
    """Springs in series with friction, by slip row.

    Attributes
    ----------
    system : System
    rows : ndarray of int, shape (s,)
        Slip rows that have them.
    stiffness : ndarray, shape (s,)
        Of each, N/m.
    half : float
        Half a step, s.
    """

    system: System
    rows: IntArray
    stiffness: FloatArray
    half: float

    @property
    def by_step(self) -> FloatArray:
        """Force that half a step takes up for each unit of slip velocity, (s,), N s/m."""
        return self.half * self.stiffness

    @staticmethod
    def of(system: System, h: float) -> Springs:
        """Springs of a system for steps of ``h`` seconds."""
        rows = np.flatnonzero(system.contact.on_rows(system.contact.sprung))
        stiffness = system.contact.on_rows(system.contact.stiffness)[rows]
        return Springs(system, rows, stiffness, 0.5 * h)

    def advanced(self, v: FloatArray, friction: FloatArray) -> FloatArray:
        """Advanced forces (..., s), N, at velocities (..., n) and friction (..., rows), N."""
        if not self.rows.size:
            return np.zeros((*v.shape[:-1], 0))
        return np.asarray(friction[..., self.rows] + self._taken(v))

    def friction(self, e: FloatArray, v: FloatArray) -> FloatArray:
        """Friction (s,), N, at a velocity (n,) under advanced forces ``e``."""
        return np.asarray(e - self._taken(v))

    def _taken(self, v: FloatArray) -> FloatArray:
        """What springs take up in half a step, (..., s), N, if all sliders stick."""
        slip = np.asarray((self.system.contact.B @ v.T).T)
        return np.asarray(self.by_step * slip[..., self.rows])
