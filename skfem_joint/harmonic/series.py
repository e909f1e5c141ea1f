"""Fourier series of periodic motions, and their samples over a period."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from skfem_joint.ground.arrays import FloatArray, IntArray

#: Most samples in a period that a finer series has.
FINEST = 4096


@dataclass(frozen=True)
class FourierSeries:
    """Harmonics of a periodic motion: a mean, then a cosine and a sine of each.

    Where all harmonics are odd the second half of a period is the first one with the other sign:
    samples are those of half a period, and there is no mean.

    Attributes
    ----------
    highest : int
        Highest harmonic.
    samples : int
        Samples in a period, even.
    odd : bool
        Whether there are odd harmonics alone.
    """

    highest: int
    samples: int
    odd: bool

    @cached_property
    def orders(self) -> IntArray:
        """Number of the harmonic of each cosine with its sine."""
        return np.arange(1, self.highest + 1, 2 if self.odd else 1)

    @property
    def size(self) -> int:
        """Number of coefficients of a motion, nh."""
        return 2 * self.orders.size + self.first

    @property
    def first(self) -> int:
        """Place of the first cosine, after the mean, if there is one."""
        return 0 if self.odd else 1

    @cached_property
    def coefficient_orders(self) -> IntArray:
        """Number of the harmonic of each coefficient, (nh,)."""
        return np.concatenate([np.zeros(self.first, np.intp), np.repeat(self.orders, 2)])

    @property
    def doubled(self) -> FourierSeries:
        """Twice the harmonics and one more, with twice the samples, up to `FINEST`."""
        return FourierSeries(2 * self.highest + 1, min(2 * self.samples, FINEST), self.odd)

    @cached_property
    def basis(self) -> FloatArray:
        """Value of each function at each sample, (samples of the arc, nh)."""
        count = self.samples // 2 if self.odd else self.samples
        angle = 2.0 * np.pi / self.samples * np.arange(count)[:, np.newaxis] * self.orders
        waves = np.stack([np.cos(angle), np.sin(angle)], axis=-1).reshape(count, -1)
        return np.hstack([np.ones((count, self.first)), waves])

    @cached_property
    def projection(self) -> FloatArray:
        """Weight of each sample in each coefficient, (samples of the arc, nh)."""
        weights = np.where(self.coefficient_orders == 0, 1.0, 2.0)
        return np.asarray(self.basis * weights / self.basis.shape[0])

    @cached_property
    def products(self) -> FloatArray:
        """Products of weights and values at each sample, (samples of the arc, nh nh)."""
        pairs = self.projection[:, :, np.newaxis] * self.basis[:, np.newaxis]
        return pairs.reshape(self.basis.shape[0], -1)

    def of(self, coefficients: FloatArray, other: FourierSeries) -> FloatArray:
        """Coefficients (nh, ...) of this series from those of another one; zeros are added."""
        own = np.zeros((self.size, *coefficients.shape[1:]))
        shared = [k for k in other.orders.tolist() if k in set(self.orders.tolist())]
        if not (self.odd or other.odd):
            own[0] = coefficients[0]
        for k in shared:
            here, there = (s.first + 2 * int(np.searchsorted(s.orders, k)) for s in (self, other))
            own[here : here + 2] = coefficients[there : there + 2]
        return own

    def rate(self, coefficients: FloatArray) -> FloatArray:
        """Coefficients (nh, ...) of the derivative by the angle."""
        rate = np.zeros_like(coefficients)
        orders = self.orders.reshape(-1, *[1] * (coefficients.ndim - 1))
        cosines, sines = slice(self.first, None, 2), slice(self.first + 1, None, 2)
        rate[cosines] = orders * coefficients[sines]
        rate[sines] = -orders * coefficients[cosines]
        return rate

    def work(self, force: FloatArray, motion: FloatArray) -> FloatArray:
        """Work of forces on motions in a period, from coefficients (nh, ...), of the rest."""
        both = (force * self.rate(motion))[self.first :]
        return np.asarray(np.pi * both.sum(axis=0))
