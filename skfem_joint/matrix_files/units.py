"""Systems of units in which other programs compute, and the way from them to SI."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy import sparse

from skfem_joint.ground.arrays import IntArray

#: Length (m), mass (kg) and time (s) of one unit, by the name of the system.
SYSTEMS: Mapping[str, tuple[float, float, float]] = {
    "m kg s": (1.0, 1.0, 1.0),
    "mm t s": (1e-3, 1e3, 1.0),
    "mm kg ms": (1e-3, 1.0, 1e-3),
    "mm kg s": (1e-3, 1.0, 1.0),
    "in lbf s": (0.0254, 4.4482216152605 / 0.0254, 1.0),
}
#: Power of the unit of time by which each matrix is divided.
_TIMES = {"K": 2, "C": 1, "M": 0}


def in_si(
    matrices: Mapping[str, sparse.csr_array], labels: IntArray | None, units: str
) -> dict[str, sparse.csr_array]:
    """Matrices, by the letters K, M and C, in N/m, kg and N s/m.

    Rotations stay in radians, so that their stiffness becomes N m; the unknowns of modes keep
    their scale. Unknowns without names count as displacements.
    """
    length, mass, time = SYSTEMS[units]
    scale = None
    if labels is not None:
        moves = (labels[:, 1] >= 1) & (labels[:, 1] <= 3) & (labels[:, 0] > 0)
        scale = sparse.diags_array(np.where(moves, 1.0, length))
    converted = {}
    for letter, A in matrices.items():
        factor = mass / time ** _TIMES[letter]
        scaled = A if scale is None or length == 1.0 else sparse.csr_array(scale @ A @ scale)
        converted[letter] = A if units == "m kg s" else sparse.csr_array(factor * scaled)
    return converted
