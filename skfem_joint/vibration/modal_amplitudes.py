r"""How often a mode vibrates at which amplitude under a random load.

A lightly damped mode under a broad-band load vibrates at its own frequency, with an amplitude a
that changes slowly. Averaged over a cycle (R. L. Stratonovich, Topics in the Theory of Random
Noise, 1963; J. B. Roberts and P. D. Spanos, Int. J. Non-Linear Mech. 21, 1986) its action, which is
proportional to y = omega(a) a^2, diffuses, and its stationary density is

    p(a) da = c exp(-Psi) dy,        dPsi/dy = 1 / (2 omega(a) s(a)^2),

where s(a)^2 is the variance of the linear oscillator that has the frequency and damping ratio of
the mode at the amplitude a: s^2 = G / (8 zeta omega^3) under a constant density G of the modal
force. So omega and zeta may be any functions of the amplitude. Where they are constant it is
Rayleigh's density with the exact variance, whatever the density of the load. Statistical
linearisation, which takes Rayleigh's density of an equivalent linear mode, has no large amplitudes
made rarer by damping that grows with them.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.integrate import cumulative_simpson, simpson
from scipy.interpolate import PchipInterpolator

from skfem_joint.ground.arrays import FloatArray
from skfem_joint.ground.errors import ConvergenceError, InputError
from skfem_joint.ground.power_density import Density

#: Intervals of the amplitude, an even number.
INTERVALS = 200
#: Share of the largest amplitude below which the damping at this share counts: a mode without any
#: damping at rest would have a peak of no width there, where it hardly ever is.
LEAST = 0.01
#: Range of Psi at the largest amplitude: larger ones have a probability below 1e-12.
RARE = 28.0, 50.0
#: Most tries to find that amplitude.
TRIES = 60
#: Amplitudes below the lowest of a curve, over it, at which what joints do follows from the curve.
LOWER = 0.5 ** np.arange(6, 0, -1)
#: Amplitudes whose transfer functions are held at once.
AT_ONCE = 25


def at_amplitudes(
    amplitude: FloatArray, known: FloatArray, values: FloatArray, at_rest: FloatArray
) -> FloatArray:
    """Values (k, ...) at amplitudes (k,) from those (levels, ...) at known ones, and at rest.

    Above the highest known amplitude they stay.
    """
    rows = np.concatenate([np.asarray(at_rest)[np.newaxis], values])
    within = np.minimum(amplitude, known[-1])
    return np.asarray(PchipInterpolator(np.append(0.0, known), rows)(within))


@dataclass(frozen=True)
class ModeCurve:
    """Frequency and damping of a mode at rising amplitudes, by joint.

    Below the lowest amplitude it goes to the stuck mode at rest. Above the highest one values stay.

    Attributes
    ----------
    mode : int
        Number of the mode, from 1.
    stuck : float
        Angular frequency with the contact stuck, rad/s.
    viscous : float
        Modal damping by C, 1/s.
    amplitude, omega : ndarray, shape (levels,)
        m kg^1/2, rad/s.
    friction : ndarray, shape (levels, joints)
        Damping ratio by friction in each joint.
    """

    mode: int
    stuck: float
    viscous: float
    amplitude: FloatArray
    omega: FloatArray
    friction: FloatArray

    @property
    def level(self) -> FloatArray:
        """Levels of the inertia that loads the structure, (levels,), m/s² kg^1/2."""
        return np.asarray(self.omega**2 * self.amplitude)

    @property
    def work(self) -> FloatArray:
        """Work of friction in a cycle, (levels, joints), J."""
        return 2.0 * np.pi * (self.level * self.amplitude)[:, np.newaxis] * self.friction

    def at(self, amplitude: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Frequencies (k,), rad/s, and damping ratios (k, joints) at amplitudes (k,)."""
        known, none = self.amplitude, np.zeros(self.friction.shape[1])
        omega = at_amplitudes(amplitude, known, self.omega, np.array(self.stuck))
        return omega, at_amplitudes(amplitude, known, self.friction, none)

    def from_lower(self) -> ModeCurve:
        """Curve with levels below its lowest one, as `at` has them."""
        amplitude = np.append(self.amplitude[0] * LOWER, self.amplitude)
        omega, friction = self.at(amplitude)
        return replace(self, amplitude=amplitude, omega=omega, friction=friction)

    def every_second(self) -> ModeCurve:
        """Curve of every second level, the highest included."""
        names = "amplitude", "omega", "friction"
        return replace(self, **{name: getattr(self, name)[::-2][::-1] for name in names})


@dataclass(frozen=True)
class Beside:
    """What other modes that vibrate too change of a mode, at rising amplitudes.

    Attributes
    ----------
    amplitude : ndarray, shape (k,)
        m kg^1/2.
    friction : ndarray, shape (k, joints)
        Change of the damping ratio by friction.
    flexibility : ndarray, shape (k,)
        Change of 1 / omega^2, s².
    """

    amplitude: FloatArray
    friction: FloatArray
    flexibility: FloatArray

    def halfway(self, other: Beside) -> Beside:
        """Mean of both."""
        pairs = zip(vars(self).values(), vars(other).values(), strict=True)
        return Beside(*(0.5 * (own + others) for own, others in pairs))

    def of(self, curve: ModeCurve, amplitude: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Frequencies (k,), rad/s, and damping ratios (k, joints) of a mode at amplitudes (k,)."""
        omega, friction = curve.at(amplitude)
        if not self.amplitude.size:
            return omega, friction
        more = [np.interp(amplitude, self.amplitude, column) for column in self.friction.T]
        flexibility = np.interp(amplitude, self.amplitude, self.flexibility)
        omega = 1.0 / np.sqrt(1.0 / omega**2 + flexibility)
        return omega, np.maximum(friction + np.array(more).T, 0.0)


#: A mode that vibrates alone.
ALONE = Beside(np.zeros(0), np.zeros((0, 0)), np.zeros(0))


@dataclass(frozen=True)
class ModalAmplitudes:
    """Stationary vibration of a mode under a random load.

    Attributes
    ----------
    mode : int
        Number of the mode, from 1.
    amplitude : ndarray, shape (k,)
        Evenly spaced from zero, m kg^1/2.
    density : ndarray, shape (k,)
        Probability density of the amplitude, 1/(m kg^1/2).
    omega, viscous_damping : ndarray, shape (k,)
        Angular frequency, rad/s, and damping ratio by C at each amplitude.
    friction_damping : ndarray, shape (k, joints)
        Damping ratio by friction in each joint.
    variance : ndarray, shape (k,)
        Of the linear mode with these, m² kg.
    beyond : float
        Share of the mean square at amplitudes above the highest of the curve.
    """

    mode: int
    amplitude: FloatArray
    density: FloatArray
    omega: FloatArray
    viscous_damping: FloatArray
    friction_damping: FloatArray
    variance: FloatArray
    beyond: float

    def mean(self, values: FloatArray) -> FloatArray:
        """Mean of values at the amplitudes, (k, ...)."""
        weighted = (self.density * values.T).T
        return np.asarray(simpson(weighted, x=self.amplitude, axis=0))

    @property
    def rms(self) -> float:
        """Root mean square of the modal displacement, m kg^1/2."""
        return float(np.sqrt(self.mean(0.5 * self.amplitude**2)))

    @property
    def frequency(self) -> float:
        """Mean number of cycles in a second, Hz."""
        return float(self.mean(self.omega) / (2.0 * np.pi))

    @property
    def damping_ratio(self) -> float:
        """Damping ratio of the linear mode that loses as much at the same mean square velocity."""
        square = float(self.mean((self.omega * self.amplitude) ** 2))
        loss = float(self.mean(self.power(self.damping)))
        return loss / (2.0 * np.pi * self.frequency * square)

    @property
    def damping(self) -> FloatArray:
        """Damping ratio of friction in all joints, and C, at each amplitude, (k,)."""
        return np.asarray(self.friction_damping.sum(axis=1) + self.viscous_damping)

    def power(self, damping: FloatArray) -> FloatArray:
        """Power that damping ratios take at the amplitudes, (k, ...), W."""
        return np.asarray((self.omega**3 * self.amplitude**2 * damping.T).T)

    def peak(self, duration: float) -> float:
        """Expected largest modal displacement in a duration, s; m kg^1/2.

        Cycles with amplitudes above a level come at random, in their mean number.
        """
        a, rate = self.amplitude, self.density * self.omega / (2.0 * np.pi)
        below = cumulative_simpson(rate, x=a, initial=0.0)
        return float(simpson(-np.expm1(-duration * np.maximum(below[-1] - below, 0.0)), x=a))

    def weights(self) -> FloatArray:
        """Shares of the linear modes at the amplitudes in the density of the response, (k,).

        They add up to 1, because d(exp(-Psi) y) has no integral.
        """
        rule = simpson(np.eye(self.amplitude.size), x=self.amplitude, axis=1)
        return np.asarray(rule * self.density * 0.5 * self.amplitude**2 / self.variance)


def modal_amplitudes(curve: ModeCurve, force: Density, beside: Beside = ALONE) -> ModalAmplitudes:
    """Stationary vibration of a mode under a modal force, N²/kg/Hz.

    ConvergenceError if no amplitude is found that is rarely exceeded.
    """
    top, low, high = float(curve.amplitude[-1]), 0.0, np.inf
    for _ in range(TRIES):
        a = np.linspace(0.0, top, INTERVALS + 1)
        omega, friction = beside.of(curve, np.maximum(a, LEAST * top))
        viscous = 0.5 * curve.viscous / omega
        variance = linear_variance(omega, friction.sum(axis=1) + viscous, force)
        slope = np.gradient(omega * a**2, a, edge_order=2)
        psi = cumulative_simpson(slope / (2.0 * omega * variance), x=a, initial=0.0)
        if RARE[0] <= psi[-1] <= RARE[1]:
            break
        # It rises with the amplitude, but not evenly: once enclosed it is found by halving.
        low, high = (top, high) if psi[-1] < RARE[0] else (low, top)
        top *= float(np.clip(np.sqrt(np.mean(RARE) / psi[-1]), 0.1, 10.0))
        if low > 0.0 and np.isfinite(high):
            top = float(np.sqrt(low * high))
    else:
        raise ConvergenceError(
            f"random_response: mode {curve.mode}: no amplitude was found that its vibration rarely "
            "exceeds; is the mode damped at all?"
        )
    density = np.maximum(slope, 0.0) * np.exp(-psi)
    density /= simpson(density, x=a)
    square = density * a**2
    above = np.where(a > curve.amplitude[-1], square, 0.0)
    beyond = float(simpson(above, x=a) / simpson(square, x=a))
    return ModalAmplitudes(curve.mode, a, density, omega, viscous, friction, variance, beyond)


def linear_variance(omega: FloatArray, damping: FloatArray, force: Density) -> FloatArray:
    """Variances of linear modes, (k,), m² kg, under a modal force, N²/kg/Hz.

    InputError if nothing damps them.
    """
    frequency, weight = force.quadrature([peak_of(omega, damping)])
    power, squares = weight * force(frequency), (2.0 * np.pi * frequency) ** 2
    variance = np.zeros(omega.size)
    for k in range(0, omega.size, AT_ONCE):
        some = slice(k, k + AT_ONCE)
        w, z = omega[some, np.newaxis], damping[some, np.newaxis]
        below = (w**2 - squares) ** 2 + (2.0 * z * w) ** 2 * squares
        variance[some] = (power / below).sum(axis=1)
    return variance


def peak_of(omega: FloatArray, damping: FloatArray) -> tuple[float, float, float]:
    """Lowest and highest frequency of linear modes, and their least half width, Hz.

    InputError if nothing damps them.
    """
    if not damping.min() > 0.0:
        raise InputError(
            "random_response: nothing damps a mode at amplitudes at which no joint slips, so that "
            "its vibration has no bound; give the structure a damping, such as stiffness_damping"
        )
    frequency = omega / (2.0 * np.pi)
    return float(frequency.min()), float(frequency.max()), float((damping * frequency).min())
