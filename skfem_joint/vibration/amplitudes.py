"""Amplitudes of a named point at which the curve of a mode is asked for.

A curve is computed at levels of the inertia that loads the structure. Displacement, velocity and
acceleration of a point follow from a level: they are the point's displacement X times powers of the
frequency. The force is that of a harmonic load at the point, along the displacement that is
observed, which keeps the mode vibrating at its resonance: there it is in phase with the velocity,
so that its work in a cycle, pi F X, is what the cycle loses.

The level of a given amplitude is found by interpolation between levels that are known, on
logarithmic axes, and the curve is computed there; that is repeated until the amplitude is the one
that is asked for. With constant friction limits a slow path has short increments if it goes by way
of all levels that were searched first: they belong to each of these curves.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike

from skfem_joint.ground.arrays import FloatArray, as_real
from skfem_joint.ground.errors import InputError
from skfem_joint.ground.power_density import GRAVITY
from skfem_joint.ground.values import rising

#: Largest change of a level from one try to the next before there are levels on both sides of a
#: value, as a logarithm.
STEP = 1.0
#: Unit of each quantity in words.
UNITS = {
    "displacement": "m",
    "velocity": "m/s",
    "acceleration": "m/s²",
    "acceleration_g": "g",
    "force": "N",
}


@dataclass(frozen=True)
class Amplitudes:
    """Rising amplitudes of one quantity at a named point, half of peak to peak.

    Exactly one of the quantities is given, as a number or a list.

    Attributes
    ----------
    point : str
        One of ``system.points``: the name of a load, or in two dimensions and three such as
        ``"tip.x"``.
    displacement : array_like, optional
        m.
    velocity : array_like, optional
        m/s.
    acceleration : array_like, optional
        m/s².
    acceleration_g : array_like, optional
        In multiples of the acceleration of gravity, 9.80665 m/s².
    force : array_like, optional
        Of a harmonic load at the point that keeps the mode vibrating at its resonance, N.

    Raises
    ------
    InputError
        If not exactly one quantity is given, or its values are not positive or do not rise.
    """

    point: str
    displacement: ArrayLike | None = None
    velocity: ArrayLike | None = None
    acceleration: ArrayLike | None = None
    acceleration_g: ArrayLike | None = None
    force: ArrayLike | None = None

    def __post_init__(self) -> None:
        given = [name for name in UNITS if getattr(self, name) is not None]
        if len(given) != 1:
            raise InputError(
                f"amplitudes: found {' and '.join(given) or 'none'}, must be exactly one of "
                f"{', '.join(UNITS)}"
            )
        rising(f"amplitudes: {self.quantity}", self.values)

    @property
    def quantity(self) -> str:
        """Name of the quantity that is given."""
        return next(f.name for f in fields(self)[1:] if getattr(self, f.name) is not None)

    @property
    def values(self) -> FloatArray:
        """Values of the quantity, (levels,)."""
        given = getattr(self, self.quantity)
        return np.atleast_1d(as_real(given, f"amplitudes: {self.quantity}"))

    def text(self, *values: float) -> str:
        """A value in words, or a range from one to another."""
        unit, quantity = UNITS[self.quantity], self.quantity.removesuffix("_g")
        shown = " to ".join(f"{value:.4g}" for value in values)
        return f"{quantity} of {shown} {unit} at {self.point}"

    def number(self, points: tuple[str, ...]) -> int:
        """Number of the point among those of a system; InputError if it is none of them."""
        if self.point not in points:
            raise InputError(
                f"amplitudes: point: found {self.point!r}, must be one of "
                f"{', '.join(points) or 'none'}; a load names another place or direction"
            )
        return points.index(self.point)

    def along(
        self, displacement: FloatArray, frequency: FloatArray, lost: FloatArray
    ) -> FloatArray:
        """Values of the quantity at some levels.

        Parameters
        ----------
        displacement : ndarray, shape (levels,)
            Of the point, m.
        frequency : ndarray, shape (levels,)
            Of the mode, Hz.
        lost : ndarray, shape (levels,)
            Energy lost in a cycle, J.
        """
        if self.quantity == "force":
            moves = displacement > 0.0
            force = np.divide(lost, np.pi * displacement, out=np.zeros_like(lost), where=moves)
            return np.asarray(force)
        power = {"displacement": 0, "velocity": 1}.get(self.quantity, 2)
        unit = GRAVITY if self.quantity == "acceleration_g" else 1.0
        return np.asarray(displacement * (2.0 * np.pi * frequency) ** power / unit)


def level_of(value: FloatArray, level: FloatArray, known: FloatArray) -> FloatArray:
    """Levels at which a quantity has some values, from its values ``known`` at a rising ``level``.

    On logarithmic axes; below the lowest level the line through the two lowest goes on. Where the
    quantity does not rise from one level to the next the highest of the levels counts.
    """
    some = known > 0.0
    x, y = np.log(known[some]), np.log(level[some])
    rising = np.append(x[:-1] < np.minimum.accumulate(x[::-1])[::-1][1:], True)
    x, y = x[rising], y[rising]
    target = np.log(value)
    found = np.interp(target, x, y)
    if x.size > 1:
        slope = (y[1] - y[0]) / (x[1] - x[0])
        found = np.where(target < x[0], y[0] + slope * (target - x[0]), found)
    return np.asarray(np.exp(found))


class LevelSearch:
    """Search for the levels at which a quantity has some values.

    Levels are first those of a curve that is known (`level_of`), and then corrected by its slope
    until they lie on both sides of a value; from then on they are on the line between the nearest
    two, on logarithmic axes.

    Parameters
    ----------
    asked : ndarray, shape (values,)
        Values of the quantity.
    level, known : ndarray, shape (levels,)
        Of a curve: levels, and values of the quantity.

    Attributes
    ----------
    tried : ndarray, shape (values,)
        Levels to try next.
    """

    def __init__(self, asked: FloatArray, level: FloatArray, known: FloatArray) -> None:
        self.asked, self._curve = asked, (level, known)
        self.tried = self._expected = level_of(asked, level, known)
        self._found: list[tuple[FloatArray, FloatArray]] = []

    def correct(self, reached: FloatArray) -> None:
        """Next levels, after values (values,) at those tried last."""
        self._found.append((self.tried, reached))
        change = self._expected / level_of(np.maximum(reached, 1e-300), *self._curve)
        # Beyond the value, so that it lies between two levels.
        beyond = self.tried * np.exp(np.clip(1.2 * np.log(change), -STEP, STEP))
        levels, values = (np.array(tries).T for tries in zip(*self._found, strict=True))
        every = zip(levels, values, self.asked, beyond, strict=True)
        self.tried = np.array([_between(*one) for one in every])


def _between(level: FloatArray, value: FloatArray, asked: float, otherwise: float) -> float:
    """Level of a value between those tried; ``otherwise`` if they are on one side of it alone."""
    low, high = value < asked, value >= asked
    if not (low.any() and high.any()):
        return otherwise
    a, b = level[low].max(), level[high].min()
    u, v = value[low][level[low].argmax()], value[high][level[high].argmin()]
    share = 0.5 if u <= 0.0 else float(np.log(asked / u) / np.log(v / u))
    return float(a * (b / a) ** np.clip(share, 0.02, 0.98))
