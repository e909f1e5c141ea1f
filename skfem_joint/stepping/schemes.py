"""Implicit one-step schemes: generalised-alpha and its special cases, velocity as the unknown.

The equation of motion holds exactly at every step's end; the weighting of the generalised-alpha
method acts on an auxiliary acceleration a (Bruels and Arnold, J. Comput. Nonlinear Dynam. 3, 2008):

    (1 - alpha_m) a1 + alpha_m a0 = (1 - alpha_f) d1 + alpha_f d0,        d = acceleration
    u1 = u0 + h v0 + h^2 ((1/2 - beta) a0 + beta a1)
    v1 = v0 + h ((1 - gamma) a0 + gamma a1)

With rho_infinity = 1 this is the average acceleration (trapezoidal) method.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from skfem_joint.ground.arrays import FloatArray
from skfem_joint.ground.values import between, check

#: Largest phase angle, rad, of a jump's vibration in a step that the scheme resolves by itself.
FOLLOWED = 0.3


class Coefficients(NamedTuple):
    """One step of size ``h`` written for the unknown velocity v1.

    ``(c_M M + C + c_K K) v1 + friction = f1 - K (u0 + u_v v0 + u_a a0) + M (c_M v0 + y_a a0
    + y_d d0)``, then ``u1 = u0 + u_v v0 + u_a a0 + c_K v1``, ``a1 = a_v (v1 - v0) + a_a a0`` and
    ``d1 = d_a a1 + d_a0 a0 + d_d0 d0``. ``trapezoidal`` is whether the scheme itself dissipates
    nothing.
    """

    h: float
    c_M: float
    c_K: float
    u_v: float
    u_a: float
    y_a: float
    y_d: float
    a_v: float
    a_a: float
    d_a: float
    d_a0: float
    d_d0: float
    trapezoidal: bool


@dataclass(frozen=True)
class Scheme:
    """Parameters of a generalised-alpha scheme (Chung and Hulbert, J. Appl. Mech. 60, 1993).

    `generalized_alpha` gives those of second order.

    Attributes
    ----------
    alpha_m, alpha_f : float
        Weights of the start of a step in its acceleration and in its forces.
    gamma, beta : float
        Newmark's parameters of velocity and of displacement.
    """

    alpha_m: float
    alpha_f: float
    gamma: float
    beta: float

    def frequency_shift(self, angle: float) -> float:
        """Relative amount by which it lowers the frequency of a vibration, to second order.

        ``angle`` is that by which the vibration turns in a step, omega h, rad. The trapezoidal rule
        gives angle^2 / 12.
        """
        skew = self.gamma - 0.5
        return 0.5 * (self.beta - skew**2 - skew * self.alpha_m - 1.0 / 12.0) * angle**2

    def coefficients(self, h: float) -> Coefficients:
        """Coefficients of one step of ``h`` seconds."""
        am, af, gamma, beta = self.alpha_m, self.alpha_f, self.gamma, self.beta
        return Coefficients(
            h=h,
            c_M=(1.0 - am) / ((1.0 - af) * gamma * h),
            c_K=h * beta / gamma,
            u_v=h * (1.0 - beta / gamma),
            u_a=h * h * (0.5 - beta / gamma),
            y_a=((1.0 - am) * (1.0 - gamma) / gamma - am) / (1.0 - af),
            y_d=af / (1.0 - af),
            a_v=1.0 / (h * gamma),
            a_a=-(1.0 - gamma) / gamma,
            d_a=(1.0 - am) / (1.0 - af),
            d_a0=am / (1.0 - af),
            d_d0=-af / (1.0 - af),
            trapezoidal=(am == af and gamma == 0.5 and beta == 0.25),
        )


def backward_euler(h: float) -> Coefficients:
    """One implicit Euler step of ``h`` seconds: it uses no acceleration of the step's start."""
    return Coefficients(
        h=h, c_M=1.0 / h, c_K=h, u_v=0.0, u_a=0.0, y_a=0.0, y_d=0.0, a_v=1.0 / h, a_a=0.0,
        d_a=1.0, d_a0=0.0, d_d0=0.0, trapezoidal=False,
    )  # fmt: skip


def generalized_alpha(rho_infinity: float = 1.0) -> Scheme:
    """Second-order scheme with spectral radius ``rho_infinity`` at infinite frequency.

    Parameters
    ----------
    rho_infinity : float
        From 0 (highest frequencies vanish in one step) to 1 (average acceleration, no numerical
        dissipation).

    Returns
    -------
    Scheme

    Raises
    ------
    InputError
        If ``rho_infinity`` is outside [0, 1].
    """
    check("rho_infinity", rho_infinity, between(0.0, 1.0))
    alpha_m = (2.0 * rho_infinity - 1.0) / (rho_infinity + 1.0)
    alpha_f = rho_infinity / (rho_infinity + 1.0)
    gamma = 0.5 - alpha_m + alpha_f
    return Scheme(alpha_m, alpha_f, gamma, 0.25 * (1.0 - alpha_m + alpha_f) ** 2)


class State(NamedTuple):
    """State of a run between two steps.

    Attributes
    ----------
    u, v : ndarray, shape (n,)
        Displacement, m, and velocity, m/s.
    a : ndarray, shape (n,)
        Auxiliary acceleration of the scheme, m/s2.
    d : ndarray, shape (n,)
        Acceleration, m/s2.
    sigma : ndarray, shape (rows,)
        Friction over its limit of each slip row, in the stepper's order.
    """

    u: FloatArray
    v: FloatArray
    a: FloatArray
    d: FloatArray
    sigma: FloatArray
