"""Power spectral densities of random loads: tables over frequency, from arrays and files."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from skfem_joint.ground.arrays import FloatArray, as_real
from skfem_joint.ground.errors import InputError
from skfem_joint.ground.text_tables import read_pairs
from skfem_joint.ground.values import check_columns

#: Standard acceleration of gravity, m/s².
GRAVITY = 9.80665
#: Units of the columns of a file, by the names that the columns may have. Densities are in units of
#: the loads, see `PowerDensity.of`.
_HERTZ = {"Hz": 1.0, "kHz": 1e3}
_OVER_HERTZ = {"N2/Hz": 1.0, "Pa2/Hz": 1.0, "(m/s2)2/Hz": 1.0, "m2/s4/Hz": 1.0, "g2/Hz": 1.0}
_FREQUENCIES = {"frequency": _HERTZ, "f": _HERTZ}
_DENSITIES = {"density": _OVER_HERTZ, "psd": _OVER_HERTZ, "asd": _OVER_HERTZ}
#: Points of Gauss's rule in each interval, and the largest ratio of the ends of an interval. With
#: a pole of the response half an interval away from it the rule errs by 1e-7.
GAUSS, LARGEST_RATIO = 10, 1.25


@dataclass(frozen=True, eq=False)
class PowerDensity:
    """Power spectral density of one side, by straight lines on logarithmic axes.

    It is zero outside of its frequencies.

    Attributes
    ----------
    frequencies : ndarray, shape (k,)
        Rising, above zero, Hz; at least two.
    values : ndarray, shape (k,)
        Positive: N²/Hz of a force, (m/s²)²/Hz of the acceleration of a base.
    stated : str, optional
        Unit in the header of its file.
    """

    frequencies: FloatArray
    values: FloatArray
    stated: str | None = None

    def __post_init__(self) -> None:
        for name in ("frequencies", "values"):
            object.__setattr__(self, name, np.asarray(as_real(getattr(self, name), f"psd: {name}")))
        check_columns("psd: ", "frequencies", "values", self.frequencies, self.values, 0.0)

    @classmethod
    def of(cls, psd: PowerDensity | ArrayLike | str | Path, unit: str = "SI") -> PowerDensity:
        """From a file or an array with two columns; InputError if it has others.

        The unit is ``"SI"`` or ``"g2/Hz"``: what a file states must agree, values stay in it.
        """
        if isinstance(psd, PowerDensity):
            return psd
        if isinstance(psd, str | Path):
            frequencies, values, stated = read_pairs(psd, _FREQUENCIES, _DENSITIES)
            if stated is not None and (stated == "g2/Hz") != (unit == "g2/Hz"):
                raise InputError(
                    f"{psd}: the header states {stated}, but the unit is {unit!r}; make them agree"
                )
            try:
                return cls(frequencies, values, stated)
            except InputError as error:
                raise InputError(f"{psd}: {error}") from error
        table = np.asarray(as_real(psd, "psd"))
        if table.ndim != 2 or table.shape[1] != 2:
            raise InputError(
                f"psd: found shape {table.shape}, must be two columns: frequency in Hz and density"
            )
        return cls(*table.T)

    def scaled(self, factor: float) -> PowerDensity:
        """Density times a factor."""
        return PowerDensity(self.frequencies, factor * self.values)

    def __call__(self, frequency: FloatArray) -> FloatArray:
        """Density at frequencies, Hz."""
        f, at = np.log(self.frequencies), np.log(frequency)
        inside = (at >= f[0]) & (at <= f[-1])
        return np.where(inside, np.exp(np.interp(at, f, np.log(self.values))), 0.0)

    def quadrature(self, peaks: list[tuple[float, float, float]]) -> tuple[FloatArray, FloatArray]:
        """Frequencies, (k,), Hz, and weights, Hz, of integrals of responses over the density.

        Parameters
        ----------
        peaks : list of tuple
            Of each mode the lowest and highest natural frequency, Hz, and its least half width, Hz.
        """
        return _quadrature(self.frequencies, peaks)


@dataclass(frozen=True, eq=False)
class AddedDensities:
    """Sum of densities, of loads without correlation."""

    parts: tuple[PowerDensity, ...]

    def __call__(self, frequency: FloatArray) -> FloatArray:
        """Density at frequencies, Hz."""
        return np.asarray(np.sum([part(frequency) for part in self.parts], axis=0))

    def quadrature(self, peaks: list[tuple[float, float, float]]) -> tuple[FloatArray, FloatArray]:
        """As of `PowerDensity`, from the lowest frequency of all to the highest."""
        return _quadrature(np.concatenate([part.frequencies for part in self.parts]), peaks)


#: Density of a load, or of several.
Density = PowerDensity | AddedDensities


def _quadrature(
    given: FloatArray, peaks: list[tuple[float, float, float]]
) -> tuple[FloatArray, FloatArray]:
    """As `PowerDensity.quadrature`; at the frequencies ``given``, Hz, a density bends or jumps."""
    low, high = given.min(), given.max()
    count = int(np.ceil(np.log(high / low) / np.log(LARGEST_RATIO)))
    edges = [given, np.geomspace(low, high, count + 1)]
    for first, last, width in peaks:
        # Intervals as wide as the peak across it, and twice the one before beyond it.
        beyond = width * 2.0 ** np.arange(int(np.log2(high / width)) + 1)
        across = np.linspace(first, last, 2 + int((last - first) / (2.0 * width)))
        edges += [first - beyond, across, last + beyond]
    every = np.unique(np.concatenate(edges))
    every = every[(every >= low) & (every <= high)]
    every = every[np.append(True, np.diff(every) > 1e-12 * high)]
    x, w = np.polynomial.legendre.leggauss(GAUSS)
    half = 0.5 * np.diff(every)[:, np.newaxis]
    return (every[:-1, np.newaxis] + half * (1.0 + x)).ravel(), (half * w).ravel()
