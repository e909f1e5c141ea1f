"""What modes that vibrate together do to each other in joints that slip.

A mode alone has the frequency and damping of its backbone. Beside another one it meets joints that
slip already: its damping and flexibility grow. A joint follows the sum of what the modes' inertia
pulls it with. By Masing's rule it is a row of plays (Prandtl's and Ishlinskii's model, driven by
the force): play number i of the half width r_i follows the level alpha of the force,
p_i = max(alpha - r_i, min(alpha + r_i, p_i before)), and the modal displacement by slip is
sum mu_i p_i. The factors mu_i are such that its loops have the work of the curve,
D(alpha) = sum 4 mu_i r_i (alpha - r_i).

Levels of other modes are brought to those of the mode by the work of the joint: both pull it alike
where both would lose as much in it. Where they slip in other places or across, the overlap of their
slips counts, the cosine between them. Parts of the displacement in phase with the mode and a
quarter of a period behind it are means over samples of the other modes' amplitudes and phases.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import nnls

from skfem_joint.ground.arrays import FloatArray
from skfem_joint.ground.errors import ConvergenceError
from skfem_joint.ground.power_density import Density
from skfem_joint.vibration.modal_amplitudes import (
    Beside,
    ModalAmplitudes,
    ModeCurve,
    modal_amplitudes,
)

#: Samples of the other modes' amplitudes and phases, and seed of the generator.
SAMPLES, SEED = 16, 1
#: Amplitudes of a mode at which it is looked at, over their root mean square.
NODES = np.array([0.05, 0.2, 0.5, 0.8, 1.1, 1.5, 2.0, 2.6, 3.3, 4.5])
#: Times in the shortest period, and longest periods that count; one more before them is left out.
TIMES, PERIODS = 20, 3
#: Levels of work at which two curves are compared.
COMPARED = 9
#: Relative change of the modes' root mean squares at which they have settled, and most rounds.
SETTLED, MOST = 2e-3, 40
#: Rounds after which changes are halved: two states may take each other's place for ever.
AT_ONCE = 4


@dataclass(frozen=True)
class Plays:
    """A joint as a mode meets it, see the module's docstring.

    Attributes
    ----------
    half_width : ndarray, shape (plays,)
        In levels of the mode, m/s² kg^1/2.
    factor : ndarray, shape (plays,)
        Modal displacement over level, s².
    """

    half_width: FloatArray
    factor: FloatArray

    @classmethod
    def of(cls, level: FloatArray, work: FloatArray) -> Plays:
        """Of a joint with a work in cycles, (levels,), J; factors are not negative."""
        slips = work > 0.0
        if not slips.any():
            return cls(np.zeros(0), np.zeros(0))
        r = np.append(0.5 * level[0], level[:-1])
        loops = 4.0 * r * np.maximum(level[:, np.newaxis] - r, 0.0)
        factor = nnls(loops[slips] / work[slips, np.newaxis], np.ones(np.count_nonzero(slips)))[0]
        return cls(r[factor > 0.0], factor[factor > 0.0])

    def follow(self, level: FloatArray) -> FloatArray:
        """Modal displacement by slip at each time of a level, (rows, times), from rest."""
        play = np.zeros((level.shape[0], self.factor.size))
        slipped = np.empty(level.shape)
        for k, now in enumerate(level.T[:, :, np.newaxis]):
            play = np.maximum(now - self.half_width, np.minimum(now + self.half_width, play))
            slipped[:, k] = play @ self.factor
        return slipped


def joined_modes(
    curves: Sequence[ModeCurve], forces: Sequence[Density], overlap: FloatArray
) -> list[ModalAmplitudes]:
    """Stationary vibration of modes under their modal forces, N²/kg/Hz.

    Parameters
    ----------
    curves, forces : sequence
        One each for a mode.
    overlap : ndarray, shape (joints, modes, modes)
        Of the slips of two modes in a joint, from 0 to 1.

    Raises
    ------
    ConvergenceError
        If the modes do not settle beside each other.
    """
    pairs = list(zip(curves, forces, strict=True))
    found = [modal_amplitudes(*pair) for pair in pairs]
    if len(curves) == 1:
        return found
    joints = _Joints(curves, overlap)
    beside: list[Beside] = []
    for tried in range(MOST):
        before = np.array([mode.rms for mode in found])
        last, beside = beside, [joints.beside(number, found) for number in range(len(pairs))]
        if tried > AT_ONCE:
            beside = [old.halfway(new) for old, new in zip(last, beside, strict=True)]
        found = [modal_amplitudes(*pair, each) for pair, each in zip(pairs, beside, strict=True)]
        after = np.array([mode.rms for mode in found])
        if np.abs(after / before - 1.0).max() <= SETTLED:
            return found
    raise ConvergenceError(
        f"random_response: the modes did not settle beside each other in {MOST} rounds; their root "
        f"mean squares still change by {np.abs(after / before - 1.0).max():.2g}, relative"
    )


class _Joints:
    """Joints that modes share; arguments as of `joined_modes`."""

    def __init__(self, curves: Sequence[ModeCurve], overlap: FloatArray) -> None:
        curves = [curve.from_lower() for curve in curves]
        works = [curve.work for curve in curves]
        joints = range(works[0].shape[1])
        self.plays = [
            [Plays.of(curve.level, work[:, j]) for j in joints]
            for curve, work in zip(curves, works, strict=True)
        ]
        #: Of the second mode in a joint, in levels of the first one.
        self.pull = overlap.copy()
        for j, k, other in np.ndindex(overlap.shape):
            pair = [(curves[i].level, works[i][:, j]) for i in (k, other)]
            self.pull[j, k, other] *= _alike(*pair)
        count = len(curves)
        generator = np.random.default_rng(SEED)
        ranks = [generator.permutation(SAMPLES) for _ in range(count**2)]
        self.quantile = (np.reshape(ranks, (count, count, SAMPLES)) + 0.5) / SAMPLES
        self.phase = 2.0 * np.pi * generator.random((count, count, SAMPLES))

    def beside(self, number: int, modes: Sequence[ModalAmplitudes]) -> Beside:
        """What the others change of a mode."""
        mode = modes[number]
        rates = [other.frequency for other in modes]
        period = 1.0 / min(rates)
        count = int(np.ceil((PERIODS + 1) * period * max(rates) * TIMES))
        t = np.linspace(0.0, (PERIODS + 1) * period, count, endpoint=False)
        window = np.where(t > period, 1.0 - np.cos(2.0 * np.pi * (t / period - 1.0) / PERIODS), 0.0)
        amplitude = NODES * mode.rms
        omega = np.interp(amplitude, mode.amplitude, mode.omega)
        level = omega**2 * amplitude
        own = level[:, np.newaxis] * np.cos(omega[:, np.newaxis] * t)
        behind = np.exp(1j * omega[:, np.newaxis] * t) * (2.0 * window / window.sum())
        change = []
        for j, plays in enumerate(self.plays[number]):
            others = np.zeros((SAMPLES, count))
            for k, other in enumerate(modes):
                if k != number:
                    others += self.pull[j, number, k] * self._sample(number, k, other, t)
            beside = (own[:, np.newaxis] + others).reshape(-1, count)
            slipped = plays.follow(beside).reshape(-1, SAMPLES, count).mean(axis=1)
            change.append(((slipped - plays.follow(own)) * behind).sum(axis=1))
        parts = np.array(change).T
        friction = parts.imag / (2.0 * amplitude)[:, np.newaxis]
        return Beside(amplitude, friction, parts.real.sum(axis=1) / level)

    def _sample(self, number: int, k: int, mode: ModalAmplitudes, t: FloatArray) -> FloatArray:
        """Levels of another mode at times, (samples, times)."""
        below = np.cumsum(mode.density)
        amplitude = np.interp(self.quantile[number, k], below / below[-1], mode.amplitude)
        omega = np.interp(amplitude, mode.amplitude, mode.omega)
        angle = np.outer(omega, t) + self.phase[number, k][:, np.newaxis]
        return np.asarray((omega**2 * amplitude)[:, np.newaxis] * np.cos(angle))


def _alike(one: tuple[FloatArray, FloatArray], other: tuple[FloatArray, FloatArray]) -> float:
    """Level of one mode over that of another one at which a joint loses as much, the median.

    Both have levels and works; 0 if one of them never slips.
    """
    curves = [(level[work > 0.0], work[work > 0.0]) for level, work in (one, other)]
    if not all(work.size for _, work in curves):
        return 0.0
    low, high = (f(g(work) for _, work in curves) for f, g in ((max, np.min), (min, np.max)))
    at = np.log(np.geomspace(low, high, COMPARED))
    levels = [np.interp(at, np.log(work), np.log(level)) for level, work in curves]
    return float(np.exp(np.median(levels[0] - levels[1])))
