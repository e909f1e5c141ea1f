"""A matrix as a file of another program holds it."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from scipy import sparse

from skfem_joint.ground.arrays import IntArray


@dataclass(frozen=True)
class GivenMatrix:
    """A square matrix of a file, symmetric if the file's format does not say otherwise.

    Attributes
    ----------
    matrix : csr_array, shape (n, n)
    form : str
        The format, in words.
    labels : ndarray of int, shape (n, 2), optional
        Node and direction of each unknown; None if the file does not tell.
    held : ndarray of int
        Unknowns that the other program holds, and whose stiffness was a stand-in for that.
    notes : tuple of str
        What was left out, in sentences without the name of the file.
    """

    matrix: sparse.csr_array
    form: str
    labels: IntArray | None = None
    held: IntArray = field(default_factory=lambda: np.zeros(0, dtype=np.intp))
    notes: tuple[str, ...] = ()
