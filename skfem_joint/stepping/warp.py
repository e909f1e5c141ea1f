"""Prewarping: the trapezoidal rule made exact at the frequency that drives a vibration.

The trapezoidal rule with step h turns a vibration of frequency omega as if it were one of

    omega' = (2 / h) tan(omega h / 2) ,

for i omega becomes i omega' in the equation of a harmonic, (K + i omega C - omega^2 M) u = f. With

    kappa = omega / omega',        M -> kappa^2 M,    C -> kappa C,    beta -> kappa beta,

the two agree: the response of a linear model of any size at omega is exact, and the step problem is
as convex as before. What is left is the error of other harmonics. (The bilinear transform of
digital filters is prewarped in the same way: A. V. Oppenheim and R. W. Schafer, Discrete-Time
Signal Processing, 1989, section 7.1.2.)

The steps change the displacement by ``u1 - u0 = (h / 2) (v0 + v1)``: their velocities are the true
ones over kappa, which is why the law's steepness is taken times kappa. Kinetic energy, and the
works of damping and of friction, are then the true ones, but for the error of the works' own
trapezoidal sums, (omega h)^2 / 6 of themselves.
"""

from __future__ import annotations

import math
from dataclasses import replace

from skfem_joint.system.system import System


def warp_factor(omega: float, h: float) -> float:
    """Factor kappa at a frequency omega (rad/s) for steps of ``h`` seconds; 1 for zero."""
    half = 0.5 * omega * h
    return half / math.tan(half) if half > 0.0 else 1.0


def warped(system: System, kappa: float) -> System:
    """System whose steps are exact where kappa was made for; the system itself if it is 1."""
    if kappa == 1.0:
        return system
    system = system.with_contact(beta=kappa * system.contact.beta)
    return replace(system, M=kappa**2 * system.M, C=kappa * system.C)
