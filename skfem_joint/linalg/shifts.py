"""Small shifts of a stiffness by the mass, which make it definite where bodies can move freely.

    K + share omega^2 M,    omega^2 = tr K / tr M

A structure that friction alone holds has a singular stiffness. The shift gives its rigid motions a
frequency far below all others, so that K has a factor. There are two shares: the larger share
where a factor only has to exist, the smaller share where results must not show the shift.
"""

from __future__ import annotations

from skfem_joint.ground.arrays import Matrix

#: For factors that only have to exist: checks of definiteness, inner products, residual modes,
#: static shapes. It is far above round-off.
SAFE = 1e-09
#: For results: natural frequencies, quasi-static slips, constraint modes. Just large enough for a
#: factor of a singular stiffness.
LEAST = 1e-12


def mean_square_frequency(K: Matrix, M: Matrix) -> float:
    """Trace of the stiffness over trace of the mass, 1/s2.

    It is 1 where one of them is zero, as of masses that friction alone holds: any shift serves.
    """
    stiffness, mass = float(K.diagonal().sum()), float(M.diagonal().sum())
    return stiffness / mass if stiffness > 0.0 and mass > 0.0 else 1.0


def shifted(K: Matrix, M: Matrix, share: float = SAFE) -> Matrix:
    """Stiffness with a shift: the larger one, for factors that only have to exist, if not given."""
    return K + share * mean_square_frequency(K, M) * M
