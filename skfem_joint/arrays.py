"""Names of the arrays' types, once for the whole package."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

FloatArray: TypeAlias = NDArray[np.float64]
IntArray: TypeAlias = NDArray[np.intp]
BoolArray: TypeAlias = NDArray[np.bool_]
#: ndarray or scipy sparse array, shape (n, n) or (m, n).
Matrix: TypeAlias = Any
