"""Small shifts of a stiffness by the mass, which make it definite where bodies can move freely.

    K + share omega^2 M,    omega^2 = tr K / tr M

A structure that friction alone holds has a singular stiffness. The shift gives its rigid motions a
frequency far below all others, so that K has a factor. There are two shares: the larger share
where a factor only has to exist, the smaller share where results must not show the shift.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from skfem_joint.arrays import Matrix


@dataclass(frozen=True)
class ShiftSettings:
    """Shares of the mean square frequency.

    Attributes
    ----------
    safe : float
        For factors that only have to exist: checks of definiteness, inner products, residual modes,
        static shapes. It is far above round-off.
    least : float
        For results: natural frequencies, quasi-static slips, constraint modes. Just large enough
        for a factor of a singular stiffness.
    """

    safe: float = 1e-9
    least: float = 1e-12


SETTINGS = ShiftSettings()


def mean_square_frequency(K: Matrix, M: Matrix) -> float:
    """Trace of the stiffness over trace of the mass, 1/s2; 0 for a mass without a positive trace.

    Diagonal entries of K count by their magnitudes, because K may still prove to be indefinite.
    """
    mass = float(M.diagonal().sum())
    return float(np.abs(K.diagonal()).sum()) / mass if mass > 0.0 else 0.0


def shifted(K: Matrix, M: Matrix) -> Matrix:
    """Stiffness with the larger shift, for factors that only have to exist."""
    return K + SETTINGS.safe * mean_square_frequency(K, M) * M
