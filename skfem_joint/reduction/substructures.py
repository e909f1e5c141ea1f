"""Condensed models of large structures by substructures (R. R. Craig and M. C. C. Bampton, 1968).

The contact unknowns k are kept, as in :mod:`skfem_joint.reduction.condensed`, whose model this is:
constraint modes and fixed-interface modes of the whole structure. But its factor is not made, and
its constraint modes Psi are not stored, which for a thousand contact unknowns of a solid of a
million take 8 GB. The structure falls into parts, see :mod:`skfem_joint.linalg.parts`:

- the stiffness of the constraint modes is the Schur complement, assembled from those of the parts;
- products Psi^T y = y_k - K_kr K_rr^-1 y_r, of which the mass consists, come from solutions, part
  by part. Of the motions of a part's border that the constraint modes impose only independent ones
  are solved for: far from the joint a few dozen, rigid motions first;
- fixed-interface modes begin with the method of Craig and Bampton for the parts: the lowest modes
  of each with its border held, and the lowest static modes of the borders. They are then iterated
  upon with exact solutions, until they are those of the whole structure.

So the model differs by round-off alone from one that is made with a factor of the whole.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from scipy import linalg, sparse
from scipy.sparse.linalg import LinearOperator

from skfem_joint.ground.arrays import FloatArray, IntArray, Matrix, as_dense
from skfem_joint.ground.errors import ConvergenceError
from skfem_joint.linalg import shifts
from skfem_joint.linalg.factors import factorised
from skfem_joint.linalg.parts import BLOCK, Parts, PartwiseComplement, in_blocks
from skfem_joint.reduction.pod import orthonormal
from skfem_joint.system.modes import eigenmodes
from skfem_joint.system.system import System
from skfem_joint.system.unknowns import selection

#: Singular values of a border's motions below this share of the largest are round-off.
DEPENDENT = 1e-14
#: Modes are iterated upon until the solution that its inertia gives differs from each by this share
#: of it, or round-off keeps it above, but below the second share. The error of the modes is of this
#: order, that of their frequencies of its square.
TOLERANCE, ROUND_OFF = 1e-10, 1e-7
#: Modes of the borders, and modes of all parts, in which the modes of the whole begin.
GUESSED = 32
#: Most solutions for the modes.
MOST = 12
#: Modes that are iterated upon beyond those that are wanted, which converge faster with them.
BEYOND = 8


@dataclass(frozen=True)
class Substructures:
    """Stiffness and mass of a system with its contact unknowns kept, part by part.

    Attributes
    ----------
    system : System
        Whose slips are unknowns.
    kept : ndarray of int, shape (k,)
        In any order.
    parts : Parts
    """

    system: System
    kept: IntArray
    parts: Parts
    _known: dict[int, tuple[FloatArray, FloatArray]] = field(
        init=False, repr=False, compare=False, default_factory=dict
    )

    @cached_property
    def shift(self) -> float:
        """Multiple of the mass that is added to the stiffness, 1/s2: structures may float."""
        return shifts.LEAST * self.system.mean_square_frequency

    @cached_property
    def mass(self) -> sparse.csr_array:
        """M, (n, n)."""
        return sparse.csr_array(self.system.M)

    @cached_property
    def schur(self) -> PartwiseComplement:
        """The shifted stiffness on the kept unknowns."""
        K = sparse.csr_array(self.system.K) + self.shift * self.mass
        return PartwiseComplement(K, np.sort(self.kept), self.parts)

    @property
    def rows(self) -> int:
        """Number of rows of the modes."""
        return self.system.n

    def guessed(self, limit: float) -> int:
        """Number of modes up to a frequency (Hz), and one more, by those of the parts."""
        squares, _ = self._start(GUESSED)
        return 1 + int(np.count_nonzero(squares <= (2.0 * np.pi * limit) ** 2))

    def lowest(self, count: int) -> tuple[FloatArray, FloatArray]:
        """Lowest frequencies, Hz, and modes (n, count) of unit mass, zero at the kept unknowns.

        Raises
        ------
        ConvergenceError
            If the modes are not found.
        """
        count = min(count, self.system.n - self.kept.size)
        rigid = min(count, self.rigid.shape[1])
        frequency = np.full(rigid, np.sqrt(self.shift) / (2.0 * np.pi))
        if rigid == count:
            return frequency, self.rigid[:, :count]
        _, X = self._start(max(GUESSED, count + BEYOND))
        X = self._without_rigid(X[:, rigid : count + BEYOND])
        others, modes = _iterated(self.solve, self.mass, X, count - rigid)
        return np.append(frequency, others), np.hstack([self.rigid, modes])

    def solve(self, g: FloatArray) -> FloatArray:
        """Displacements (n, m) under forces, with the kept unknowns held, without rigid motions."""
        balanced = g - self.mass @ (self.rigid @ (self.rigid.T @ g))
        return self._without_rigid(self.schur.solve_held(balanced))

    def _without_rigid(self, u: FloatArray) -> FloatArray:
        """Displacements, (n, m), less their rigid motions."""
        return np.asarray(u - self.rigid @ (self.rigid.T @ (self.mass @ u)))

    @cached_property
    def rigid(self) -> FloatArray:
        """Rigid motions with the kept held, (n, r), of unit mass.

        They are taken from all that is solved for. The shift alone holds them, so that they grow by
        twelve orders, and their round-off would cover the rest.
        """
        squares, X = self._start(GUESSED)
        X = X[:, squares < 2.0 * self.shift]
        return orthonormal(self.schur.solve_held(self.mass @ X), self.mass) if X.size else X

    def rigid_in(self, shapes: FloatArray) -> FloatArray:
        """The rigid motions, (n, r), if there are so many shapes that these are among them."""
        R = self.rigid
        return R if shapes.shape[1] >= R.shape[1] else R[:, :0]

    def _start(self, wanted: int) -> tuple[FloatArray, FloatArray]:
        """Squares, 1/s2, and modes (n, j) by the method of Craig and Bampton for the parts.

        There are ``wanted`` modes of borders and as many of parts, if there are so many unknowns.
        The highest of them are rough.
        """
        if wanted not in self._known:
            self._known[wanted] = self._by_modes_of_parts(wanted)
        return self._known[wanted]

    def _by_modes_of_parts(self, wanted: int) -> tuple[FloatArray, FloatArray]:
        """See `_start`."""
        schur, split = self.schur, self.schur.split
        u = np.zeros((self.system.n, 0))
        if schur.separators.size:
            among = schur.separators
            K = schur.of_separators
            M = sparse.csr_array(self.mass[among][:, among])
            of_borders = eigenmodes(K, M, min(wanted, among.size))[1]
            u = np.zeros((self.system.n, of_borders.shape[1]))
            u[among] = of_borders
        each = max(4, 2 * wanted // len(split.inner))
        each = min(each, *(inner.size for inner in split.inner))
        blocks = zip(schur.matrices(schur.A, self.mass), split.border, strict=True)
        found = self.parts.each(_moved, ((*block, u[border], each) for block, border in blocks))
        frequencies, own = list[FloatArray](), list[FloatArray]()
        for inner, (following, frequency, shapes) in zip(split.inner, found, strict=True):
            u[inner] = following
            frequencies.append(frequency)
            own.append(shapes)
        # The lowest modes of all parts, each of which moves in its part alone.
        order = np.argsort(np.concatenate(frequencies))[:wanted]
        part, number = np.divmod(order, each)
        modes = np.zeros((self.system.n, order.size))
        for column, (k, j) in enumerate(zip(part, number, strict=True)):
            modes[split.inner[k], column] = own[k][:, j]
        V = orthonormal(np.hstack([u, modes]), self.mass)
        squares, shares = linalg.eigh(V.T @ (self.schur.A @ V))
        return squares, np.asarray(V @ shares)

    def projected(
        self, right: FloatArray, *matrices: Any
    ) -> tuple[FloatArray, tuple[FloatArray, ...]]:
        """Products of the constraint modes, each with one of the kept unknowns moved by one.

        Parameters
        ----------
        right : ndarray, shape (n, m)
        *matrices : sparse array, shape (n, n)

        Returns
        -------
        of_right : ndarray, shape (k, m)
            Psi^T right, in the order of ``kept``.
        of_matrices : tuple of ndarray, shape (k, k)
            Psi^T A Psi.
        """
        schur, split = self.schur, self.schur.split
        skeleton = split.skeleton
        one = np.zeros((self.kept.size, self.kept.size))
        one[np.searchsorted(schur.kept, self.kept), np.arange(self.kept.size)] = 1.0
        W = schur.on_skeleton(one)
        of_right = W.T @ right[skeleton]
        sums = [W.T @ (A[skeleton][:, skeleton] @ W) for A in matrices]
        bases = [_independent(W[np.searchsorted(skeleton, border)]) for border in split.border]
        blocks = zip(schur.matrices(schur.A, *matrices), bases, split.inner, strict=True)
        each = self.parts.each(
            _products, ((Q, right[inner], *block) for block, (Q, _), inner in blocks)
        )
        for (_, R), (with_right, *products) in zip(bases, each, strict=True):
            of_right += R.T @ with_right
            for whole, part in zip(sums, products, strict=True):
                whole += R.T @ part @ R
        return of_right, tuple(0.5 * (A + A.T) for A in sums)


def condensed_by_parts(inside: Substructures, shapes: FloatArray) -> System:
    """Condensed model on the constraint modes and on interior shapes.

    Parameters
    ----------
    inside : Substructures
    shapes : ndarray, shape (n, j)
        Zero at the kept unknowns: fixed-interface modes and static responses to loads.
    """
    system, kept, n_kept, Phi = inside.system, inside.kept, inside.kept.size, shapes
    R = inside.rigid_in(shapes)
    inside._known.clear()  # as large as many modes
    matrices = [A for A in (inside.mass, sparse.csr_array(system.C)) if A.nnz]
    loads, points = system.load_vectors(), as_dense(system.P).T
    right = np.hstack([*(A @ Phi for A in matrices), loads, points, inside.mass @ R])
    of_right, products = inside.projected(right, *matrices)
    ends = [*[Phi.shape[1]] * len(matrices), loads.shape[1], points.shape[1]]
    *coupling, of_loads, of_points, turned = np.split(of_right, np.cumsum(ends), axis=1)
    # Constraint modes without rigid motions, which they have by round-off.
    G = np.eye(n_kept + Phi.shape[1])
    G[n_kept:, :n_kept] = -(Phi.T @ (inside.mass @ R)) @ turned.T
    small = [
        np.block([[kk, kj], [kj.T, Phi.T @ (A @ Phi)]])
        for A, kk, kj in zip(matrices, products, coupling, strict=True)
    ]
    K = -inside.shift * small[0]
    order = np.searchsorted(inside.schur.kept, kept)
    K[:n_kept, :n_kept] += as_dense(inside.schur.complement)[np.ix_(order, order)]
    K[n_kept:, n_kept:] += Phi.T @ (inside.schur.A @ Phi)
    M, K, *others = (_symmetric(G.T @ A @ G) for A in (small[0], K, *small[1:]))
    vectors = np.vstack([of_loads, Phi.T @ loads]).T @ G
    rows = np.vstack([of_points, Phi.T @ points]).T @ G
    own = selection(np.arange(n_kept), M.shape[0])
    contact = system.contact
    slips, approaches = (sparse.csr_array(A)[:, kept] @ own for A in (contact.B, contact.normal.N))
    return replace(
        system,
        M=M,
        C=others[0] if others else np.zeros_like(M),
        K=K,
        contact=replace(contact, B=slips, normal=replace(contact.normal, N=approaches)),
        loads=tuple(
            replace(load, vector=vector) for load, vector in zip(system.loads, vectors, strict=True)
        ),
        P=rows,
        T=Recovery(inside, shapes),
        origin=None,
        loose=None,
    )


class Recovery(LinearOperator):  # type: ignore[misc]
    """Displacement of all degrees of freedom, (N,), from the unknowns of a model made by parts.

    A product is a pass through the parts: constraint modes are recovered by solutions, all columns
    at once. It holds the matrices of the full system.
    """

    def __init__(self, inside: Substructures, shapes: FloatArray) -> None:
        self.inside, self.shapes = inside, shapes
        n = inside.system.n if inside.system.T is None else inside.system.T.shape[0]
        super().__init__(np.dtype(float), (n, inside.kept.size + shapes.shape[1]))

    def _matmat(self, q: FloatArray) -> FloatArray:
        inside = self.inside
        schur, count = inside.schur, inside.kept.size
        kept = np.zeros((count, q.shape[1]))
        kept[np.searchsorted(schur.kept, inside.kept)] = q[:count]
        u = schur.extend(kept, np.zeros((inside.system.n, q.shape[1])))
        R = inside.rigid_in(self.shapes)
        u -= R @ (R.T @ (inside.mass @ u))
        u += self.shapes @ q[count:]
        T = inside.system.T
        return u if T is None else np.asarray(T @ u)


def _symmetric(A: FloatArray) -> FloatArray:
    return np.asarray(0.5 * (A + A.T))


def _iterated(
    solve: Callable[[FloatArray], FloatArray], M: Matrix, X: FloatArray, count: int
) -> tuple[FloatArray, FloatArray]:
    """Lowest frequencies, Hz, and modes (n, count) of unit mass, from a guess X of more of them.

    The Rayleigh-Ritz method for K^-1 M on a basis that grows by the residuals: a Krylov space of
    the block X, so that few solutions are needed, each for all modes that are not found yet.
    """
    Q = X
    Z = solve(M @ Q)
    last = np.inf
    for _ in range(MOST):
        inertia = M @ Z
        values, shares = linalg.eigh(_symmetric(Q.T @ inertia))
        values, shares = values[::-1][: X.shape[1]], shares[:, ::-1][:, : X.shape[1]]
        modes = Q @ shares
        left = Z @ shares - modes * values
        error = np.sqrt(np.maximum((left * (M @ left)).sum(axis=0), 0.0)) / values
        worst = float(error[:count].max())
        if worst <= TOLERANCE or (worst <= ROUND_OFF and worst > 0.5 * last):
            return 1.0 / (2.0 * np.pi * np.sqrt(values[:count])), modes[:, :count]
        last = worst
        new = left[:, error > TOLERANCE]
        for _ in range(2):  # twice is enough against round-off
            new = orthonormal(new - Q @ (Q.T @ (M @ new)), M)
        Q, Z = np.hstack([Q, new]), np.hstack([Z, solve(M @ new)])
    raise ConvergenceError(
        f"fixed-interface modes by parts: after {MOST} solutions the error of one is "
        f"{last:.2g}; ask for fewer modes, or for fewer parts"
    )


def _independent(W: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Orthonormal columns Q and rows R with W = Q R, as few as W's rank is."""
    Q, R, order = linalg.qr(W, mode="economic", pivoting=True)
    size = np.abs(R.diagonal())
    rank = int(np.count_nonzero(size > DEPENDENT * size.max(initial=0.0)))
    rows = np.empty((rank, W.shape[1]))
    rows[:, order] = R[:rank]
    return Q[:, :rank], rows


def _moved(
    K: Any, coupling: Any, M: Any, coupled_mass: Any, border: FloatArray, count: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """What follows motions of a part's border, and its lowest modes with the border held."""
    del coupled_mass
    solve = factorised(K)
    following = -in_blocks(solve, coupling @ border)
    return following, *eigenmodes(K, M, count, solve, 1e-3)


def _products(
    Q: FloatArray, right: FloatArray, K: Any, coupling: Any, *blocks: Any
) -> tuple[FloatArray, ...]:
    """What a part adds to products of the motions that follow those Q of its border.

    Of each matrix given by its ``blocks``, inner and by the border, without those of the border
    itself; before them the products with ``right``, (inner, m).
    """
    solve, rank = factorised(K), Q.shape[1]
    with_right = np.empty((rank, right.shape[1]))
    products = [np.empty((rank, rank)) for _ in blocks[::2]]
    for k in range(0, rank, BLOCK):
        some = slice(k, k + BLOCK)
        follows = -solve(np.ascontiguousarray(coupling @ Q[:, some]))
        with_right[some] = follows.T @ right
        for product, A, coupled in zip(products, blocks[::2], blocks[1::2], strict=True):
            inertia = A @ follows + coupled @ Q[:, some]
            on_border = coupled.T @ follows - coupling.T @ solve(np.ascontiguousarray(inertia))
            product[:, some] = Q.T @ on_border
    return with_right, *products
