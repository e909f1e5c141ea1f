"""Schur complements and solutions part by part, for matrices whose whole factor takes much memory.

The unknowns fall apart into inner ones p of each part, and a skeleton s that holds the parts apart,
see :mod:`skfem_joint.linalg.partition`. With the kept unknowns in the skeleton

    S = A_ss - sum_p A_sp A_pp^-1 A_ps

is a sparse matrix of the skeleton, condensed to the kept unknowns as any other. This is static
condensation by substructures (R. R. Craig and M. C. C. Bampton, AIAA J. 6, 1968), and exact. The
columns of A_pp^-1 A_ps, the constraint modes of a part, are not made: S comes from a factor, and
products with them from solutions. Factors are not kept either: each pass through the parts makes
them again, one part at a time, and so is as large as the largest part needs.

A pass is a task for each part, which any executor runs.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future
from dataclasses import dataclass
from itertools import starmap
from typing import Any, TypeVar

import numpy as np
from scipy import sparse

from skfem_joint.ground.arrays import FloatArray, IntArray, as_dense
from skfem_joint.ground.errors import InputError
from skfem_joint.ground.values import COUNT, check
from skfem_joint.linalg.factors import factorised
from skfem_joint.linalg.partition import partition
from skfem_joint.linalg.schur import SchurComplement, Uncondensed

_Result = TypeVar("_Result")
#: Right sides that are solved for together.
BLOCK = 64


@dataclass(frozen=True)
class Parts:
    """In how many parts large matrices are factorised, and where.

    Attributes
    ----------
    count : int
        Parts of about the same size; bodies that only a joint couples are parts of their own, so
        that there may be more.
    executor : Executor, optional
        Any of the kind of `concurrent.futures`: a pool of `processes`, ``client.get_executor()`` of
        ``dask.distributed``. One part after another here if not given. A task gets the matrices
        of its part.

    Raises
    ------
    InputError
        If the number is below 1, or the executor is none.
    """

    count: int
    executor: Executor | None = None

    def __post_init__(self) -> None:
        check("parts: count", self.count, COUNT)
        if self.executor is not None and not hasattr(self.executor, "submit"):
            raise InputError(
                f"parts: executor: found {type(self.executor).__name__}, must have a method "
                "submit, as those of concurrent.futures, or client.get_executor() of Dask"
            )

    def each(
        self, task: Callable[..., _Result], arguments: Iterable[tuple[Any, ...]]
    ) -> Iterator[_Result]:
        """Results of a task, in the order of its arguments; few of these exist at a time."""
        if self.executor is None:
            yield from starmap(task, arguments)
            return
        most = getattr(self.executor, "_max_workers", self.count)
        running: deque[Future[_Result]] = deque()
        try:
            for one in arguments:
                if len(running) == most:
                    yield running.popleft().result()
                running.append(self.executor.submit(task, *one))
            while running:
                yield running.popleft().result()
        finally:
            for future in running:
                future.cancel()


def parts_problems(parts: object) -> list[str]:
    """What is wrong with what should be `Parts`, or None."""
    if parts is None or isinstance(parts, Parts):
        return []
    return [f"parts: found {parts!r}, must be an sj.Parts, such as sj.Parts(4)"]


class PartwiseComplement(Uncondensed):
    """`SchurComplement` of a large sparse matrix, part by part.

    Parameters
    ----------
    A : sparse array, shape (n, n)
        Symmetric positive definite.
    kept : ndarray of int, shape (k,)
        Kept unknowns in increasing order.
    parts : Parts

    Attributes
    ----------
    kept : ndarray of int, shape (k,)
    complement : ndarray or csr_array, shape (k, k)
        S.
    separators : ndarray of int
        Unknowns of the skeleton that are not kept.

    Raises
    ------
    InputError
        If no unknown is left inside a part.
    """

    def __init__(self, A: Any, kept: IntArray, parts: Parts) -> None:
        super().__init__(sparse.csr_array(A))
        self.parts, self.split = parts, partition(A, kept, parts.count)
        if not self.split.inner:
            raise InputError(
                f"parts: count: found {parts.count} for {A.shape[0]} unknowns, of which "
                f"{kept.size} are kept and none is left inside a part; give fewer parts, or none"
            )
        self.kept = kept
        skeleton = self.split.skeleton
        self.separators = np.setdiff1d(skeleton, kept)
        self._skeleton = SchurComplement(self._condensed(), np.searchsorted(skeleton, kept))
        self.complement = self._skeleton.complement

    def _condensed(self) -> sparse.csr_array:
        """The matrix of the skeleton."""
        skeleton = self.split.skeleton
        S = self.A[skeleton][:, skeleton]
        for border, added in zip(
            self.split.border, self.parts.each(_complement, self.matrices(self.A)), strict=True
        ):
            place = np.searchsorted(skeleton, border)
            rows, columns = np.repeat(place, place.size), np.tile(place, place.size)
            S = S + sparse.csr_array((added.ravel(), (rows, columns)), shape=S.shape)
        return sparse.csr_array(S)

    @property
    def of_separators(self) -> sparse.csr_array:
        """The matrix of the skeleton for its unknowns that are not kept."""
        place = np.searchsorted(self.split.skeleton, self.separators)
        return sparse.csr_array(self._skeleton.A[place][:, place])

    def on_skeleton(self, x: FloatArray) -> FloatArray:
        """Values of the skeleton, (s, m), that follow those of the kept unknowns, (k, m)."""
        return self._skeleton.extend(x, np.zeros((self.separators.size, x.shape[1])))

    def matrices(self, *matrices: Any) -> Iterator[tuple[Any, ...]]:
        """Of each part the blocks of matrices of all unknowns, inner and by its border, in turn."""
        for inner, border in zip(self.split.inner, self.split.border, strict=True):
            rows = (A[inner] for A in matrices)
            yield tuple(block for A in rows for block in (A[:, inner], A[:, border]))

    def restrict(self, g: FloatArray) -> tuple[FloatArray, FloatArray]:
        """See `Uncondensed`; the interior has values of all unknowns, (n,) or (n, m)."""
        held, right = np.zeros(g.shape), np.array(g)
        blocks = zip(self.matrices(self.A), self.split.inner, strict=True)
        each = self.parts.each(_held, ((*A, g[inner]) for A, inner in blocks))
        for inner, border, (x, taken) in zip(
            self.split.inner, self.split.border, each, strict=True
        ):
            held[inner] = x
            right[border] -= taken
        kept, of_separators = self._skeleton.restrict(right[self.split.skeleton])
        held[self.separators] = of_separators
        return kept, held

    def extend(self, x: FloatArray, interior: FloatArray) -> FloatArray:
        """See `Uncondensed`."""
        u = np.array(interior)
        u[self.split.skeleton] = self._skeleton.extend(x, interior[self.separators])
        return self._followed(u)

    def _followed(self, u: FloatArray) -> FloatArray:
        """What the skeleton's values in u, (n,) or (n, m), move inside is added there."""
        blocks = zip(self.matrices(self.A), self.split.border, strict=True)
        each = self.parts.each(_following, ((*A, u[border]) for A, border in blocks))
        for inner, x in zip(self.split.inner, each, strict=True):
            u[inner] += x
        return u

    def solve_held(self, g: FloatArray) -> FloatArray:
        """Displacements (n,) or (n, m) under forces of this shape with the kept unknowns held."""
        of_kept, interior = self.restrict(g)
        return self.extend(0.0 * of_kept, interior)


def _complement(A: Any, coupling: Any) -> FloatArray:
    """What the inner unknowns of a part add to the matrix of its border, -A_sp A_pp^-1 A_ps."""
    inner, border = coupling.shape
    if not border:
        return np.zeros((0, 0))
    size = float(A.diagonal().mean())  # of the border's own matrix, which is no part of it
    corner = size * sparse.eye_array(border)
    whole = sparse.csr_array(sparse.block_array([[A, coupling], [coupling.T, corner]]))
    kept = np.arange(inner, inner + border)
    S = as_dense(SchurComplement(whole, kept).complement) - size * np.eye(border)
    return np.asarray(0.5 * (S + S.T))


def _held(A: Any, coupling: Any, g: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Response of a part whose border is held, and the forces on the border that it takes over."""
    x = in_blocks(factorised(A), g)
    return x, coupling.T @ x


def _following(A: Any, coupling: Any, border: FloatArray) -> FloatArray:
    """Displacement of the inner unknowns of a part that follows that of its border."""
    return -in_blocks(factorised(A), coupling @ border)


def in_blocks(solve: Callable[[FloatArray], FloatArray], right: FloatArray) -> FloatArray:
    """Solutions for right sides (n,) or (n, m), some at a time; zero where all are zero."""
    if right.ndim == 1:
        return solve(right)
    x = np.empty(right.shape)
    for k in range(0, right.shape[1], BLOCK):
        x[:, k : k + BLOCK] = solve(np.ascontiguousarray(right[:, k : k + BLOCK]))
    return x
