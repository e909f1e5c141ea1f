"""Types of arrays, functions for matrices that may be dense or sparse, and a search of numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import LinearOperator

from skfem_joint.ground.errors import InputError

FloatArray: TypeAlias = NDArray[np.float64]
IntArray: TypeAlias = NDArray[np.intp]
BoolArray: TypeAlias = NDArray[np.bool_]
#: An ndarray or a sparse array of scipy, shape (n, n) or (m, n).
Matrix: TypeAlias = Any


def as_real(value: Any, what: str) -> Matrix:
    """Array or sparse array of doubles, from numbers of any real type.

    Parameters
    ----------
    value : array_like, sparse array or LinearOperator
        A sparse array stays sparse, in its own format, and an operator of scipy an operator.
    what : str
        Name of the value in the message.

    Raises
    ------
    InputError
        If values are complex, because the imaginary part would be lost, or no numbers.
    """
    if isinstance(value, LinearOperator):
        return value
    given = value if sparse.issparse(value) else np.asarray(value)
    if given.dtype.kind == "c":
        raise InputError(
            f"{what}: found {given.dtype} values, must be real: motion is computed over time. Give "
            f"the real part if the imaginary one is zero; of a stiffness K (1 + i eta) give K, and "
            "eta K / omega as part of C, which has the same loss at the angular frequency omega; "
            "the phase of a load goes into its force over time"
        )
    if given.dtype.kind not in "iuf":
        raise InputError(f"{what}: found {given.dtype} values, must be real numbers")
    return given.astype(float, copy=False)


def make_real(owner: object, names: Sequence[str], where: str = "") -> None:
    """Make arrays of a frozen object doubles by `as_real`, as far as they are given."""
    for name in names:
        if (value := getattr(owner, name)) is not None:
            object.__setattr__(owner, name, as_real(value, f"{where}{name}"))


def wrong_shapes(arrays: Mapping[str, tuple[Any, tuple[Any, ...]]]) -> list[str]:
    """Sentences about arrays, by name, whose shape is not the one that stands beside them."""
    return [
        f"{name}: found shape {array.shape}, must be {right}"
        for name, (array, right) in arrays.items()
        if array.shape != right
    ]


def as_dense(A: Matrix) -> FloatArray:
    """Contiguous array of doubles from a matrix or from lists of numbers."""
    return np.ascontiguousarray(A.toarray() if sparse.issparse(A) else A, dtype=float)


def dense_rows(given: Any) -> Any:
    """What is given; a sparse array as a dense one, of a single row or column as a vector."""
    if not sparse.issparse(given):
        return given
    dense = given.toarray()
    return dense.ravel() if 1 in dense.shape else dense


def evenly(count: int, most: int) -> IntArray:
    """Numbers of at most so many of ``count`` items, evenly spread with both ends."""
    return np.unique(np.linspace(0, count - 1, most).round().astype(np.intp))


def slip_norms(slip: FloatArray, directions: NDArray[np.int64]) -> FloatArray:
    """Norms of slip vectors.

    Parameters
    ----------
    slip : ndarray, shape (..., rows)
        Slip of each row; the rows of a point follow each other.
    directions : ndarray of int, shape (m,)
        Rows of each point, 1 or 2.

    Returns
    -------
    ndarray, shape (..., m)
    """
    rows = np.asarray(slip, dtype=np.float64)
    if directions.size == rows.shape[-1]:
        return np.abs(rows)
    first = np.cumsum(directions) - directions
    return np.asarray(np.sqrt(np.add.reduceat(rows * rows, first, axis=-1)))


def check_like(
    saved: Mapping[str, NDArray[Any]], planned: Mapping[str, NDArray[Any]], what: str
) -> None:
    """Check saved arrays against those of a run: names, shapes, types, finite values.

    Raises
    ------
    ValueError
        If they differ; it names the first array that does.
    """
    if saved.keys() != planned.keys():
        names = ", ".join(sorted(saved.keys() ^ planned.keys())[:5])
        raise ValueError(f"{what} holds other arrays than the run, such as {names:.100}")
    for name, right in planned.items():
        array = saved[name]
        if (array.shape, array.dtype) != (right.shape, right.dtype):
            raise ValueError(
                f"{what}/{name} is of shape {array.shape} and type {array.dtype}, must be "
                f"{right.shape} and {right.dtype}"
            )
        if array.dtype.kind == "f" and not np.isfinite(array).all():
            raise ValueError(f"{what}/{name} is not finite")


class Numbering:
    """Places of numbers in a list that starts at ``offset`` in a longer one."""

    def __init__(self, numbers: IntArray, offset: int = 0) -> None:
        self.order = np.argsort(numbers, kind="stable")
        self.sorted, self.offset = numbers[self.order], offset

    def places(self, numbers: IntArray) -> IntArray:
        """Place of each number, -1 where it is not in the list."""
        if not self.sorted.size:
            return np.full(numbers.shape, -1, dtype=np.intp)
        near = np.searchsorted(self.sorted, numbers).clip(max=self.sorted.size - 1)
        return np.where(self.sorted[near] == numbers, self.order[near] + self.offset, -1)

    def between(self, first: int, last: int, step: int = 1) -> IntArray:
        """Places of those from first to last in steps."""
        ends = np.searchsorted(self.sorted, [first, last + 1])
        inside = slice(*ends)
        chosen = (self.sorted[inside] - first) % step == 0
        return np.asarray(self.order[inside][chosen] + self.offset)

    def repeated(self) -> tuple[IntArray, IntArray]:
        """Places in the list of numbers that stand in it again, and of their first ones."""
        again = np.flatnonzero(np.diff(self.sorted) == 0)
        return self.order[again + 1], self.order[again]
