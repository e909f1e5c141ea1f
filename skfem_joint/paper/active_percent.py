"""Active length as a share of the joint, as the paper's figures give it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from skfem_joint.active_length import measured

FloatArray = NDArray[np.float64]

#: Shares of the free end's peak above which a node counts as active: this package's, and less.
THRESHOLDS = (1e-3, 1e-4)


def active_percent(peak: FloatArray, threshold: float) -> float:
    """Active share of a joint with peaks at its free nodes from the fixed end on, percent."""
    distance = np.linspace(0.0, 100.0, peak.size, endpoint=False)
    # The nodes are one element apart, from the loaded end to one element before the fixed end.
    return measured(distance, peak[::-1], threshold)
