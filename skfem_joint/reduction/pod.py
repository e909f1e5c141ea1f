"""Proper orthogonal decomposition (POD) of snapshots, Eq. (3), and orthonormal bases.

The proper orthogonal modes of snapshots x_1, ..., x_s in the inner product of a matrix G are the
columns of the V with Vᵀ G V = I that minimises, for each number r of columns,

    Σ_t |x_t − V Vᵀ G x_t|²_G,    |x|²_G = xᵀ G x.

That sum is σ²_(r+1) + ... + σ²_s: the squares of the singular values that are left out. So the
smallest r with Σ_(k>r) σ²_k <= ε² Σ_k σ²_k represents the snapshots to the relative error ε.

This module does not choose r. The number of modes is given (``modes``; by default
`skfem_joint.reduction.basis.JOINT_MODES`), less those of the static path whose
singular values are below 1e-7 of the largest. It is judged afterwards by the share of the
displacements that the whole basis cannot follow, `SlipHistory.missed`: above a tenth `Basis.judged`
adds a note, above one half it refuses the basis. The proper values in percent of Table 1 are shown
only: they are sums of σ, not of σ², so that 99 % of them is not the criterion above.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from scipy.linalg import LinAlgError, solve_triangular, svd

from skfem_joint.ground.arrays import FloatArray, Matrix
from skfem_joint.ground.errors import ConvergenceError, InputError
from skfem_joint.ground.values import COUNT, check
from skfem_joint.linalg import shifts
from skfem_joint.stepping.recording import Run
from skfem_joint.system.system import System

#: What the snapshots of a decomposition can hold.
SNAPSHOTS = ("both", "displacement", "rates")
#: Inner products in which modes can be orthonormal.
INNER_PRODUCTS = ("energy", "mass", "euclidean")


def thinned(history: FloatArray, most: int) -> FloatArray:
    """At most ``most`` evenly spaced rows of a history (times, ...)."""
    return history[:: stride_of(len(history), most)]


def stride_of(count: int, most: int) -> int:
    """Smallest stride that takes at most ``most`` of ``count`` rows."""
    return max(1, -(-count // most))


@dataclass(frozen=True)
class ProperModes:
    """Proper orthogonal modes and values.

    Attributes
    ----------
    modes : ndarray, shape (n, r)
        Orthonormal in the inner product of the decomposition.
    singular_values : ndarray, shape (r,)
        Decreasing; see the criterion in `skfem_joint.reduction.pod`.
    """

    modes: FloatArray
    singular_values: FloatArray

    @property
    def proper_values(self) -> FloatArray:
        """Singular values in percent of their sum, as in Table 1."""
        return np.asarray(100.0 * self.singular_values / self.singular_values.sum())

    @property
    def cumulative(self) -> FloatArray:
        """Cumulative sums of the proper values, percent."""
        return np.asarray(np.cumsum(self.proper_values))


def proper_modes(
    run: Run, *, snapshots: str = "both", inner_product: str = "energy", every: int = 1
) -> ProperModes:
    """Proper orthogonal modes and values of the fields that a run stored, Eq. (3).

    The modes minimise the sum of the squared errors of the snapshots for each number of modes; see
    `skfem_joint.reduction.pod` for the criterion. ``run.system.project(proper.modes[:, :r])`` is
    the model reduced to the first r of them.

    Parameters
    ----------
    run : Run
        Run with stored fields, ``save=Save(fields=True)``.
    snapshots : {"both", "displacement", "rates"}
        What is decomposed. ``"displacement"`` is the paper's choice. ``"both"`` takes displacement
        and velocity, each divided by its norm: friction acts on velocities, so that such modes err
        less in energy. ``"rates"`` takes velocity and acceleration, in which slow instants have
        more weight.
    inner_product : {"energy", "mass", "euclidean"}
        Inner product in which the modes are orthonormal, Vᵀ G V = I: G is K plus a small multiple
        of M, or M, or the unit matrix, which is the paper's choice. See `inner_matrix`.
    every : int
        Use every so many of the stored times.

    Returns
    -------
    ProperModes
        At most as many modes as snapshots and as unknowns; modes of round-off are left out.

    Raises
    ------
    InputError
        If a word is unknown, the run stored no fields, nothing moves in it, or ``every`` is no
        whole number above zero.
    """
    check("every", every, COUNT)
    u, v = run.u[::every], run.v[::every]
    if not (np.any(u) and np.any(v)):
        raise InputError(
            "reduction: nothing moves in the run that the modes are to come from, or it holds no "
            "fields (Save(fields=True)); give a load that acts in it, or run 'full' alone"
        )
    inner = inner_matrix(run.system, inner_product, u, v)
    return proper_decomposition(snapshot_matrix(u, v, snapshots, inner), inner)


def proper_decomposition(snapshots: FloatArray, inner: Matrix | None = None) -> ProperModes:
    """Proper orthogonal decomposition of snapshots.

    With the thin factorisation Xᵀ = Q R of the snapshots X and the Cholesky factor LᵀL of Qᵀ G Q
    the modes are Q L⁻¹ U, with U and σ from the singular value decomposition of L R. No matrix of
    shape (n, n) is filled.

    Parameters
    ----------
    snapshots : ndarray, shape (times, n)
    inner : matrix, shape (n, n), optional
        Symmetric positive definite matrix G of the inner product; the unit matrix if not given.

    Raises
    ------
    InputError
        If the snapshots are not finite, nothing moves in them, or G is not positive definite.
    ConvergenceError
        If the singular value decomposition does not converge.
    """
    if snapshots.ndim != 2 or not np.all(np.isfinite(snapshots)):
        raise InputError("snapshots: must be a matrix (times, n) of finite numbers")
    scale = float(np.abs(snapshots).max(initial=0.0))
    if scale == 0.0:
        raise InputError("snapshots: all zero, nothing moves; is the load too small or absent?")
    Q, R = np.linalg.qr(snapshots.T / scale)
    upper = np.eye(len(R))
    if inner is not None:
        gram = Q.T @ (inner @ Q)
        try:
            upper = np.linalg.cholesky(0.5 * (gram + gram.T)).T
        except LinAlgError as error:
            raise InputError(
                "inner: the inner product of the snapshots must be symmetric and positive definite"
            ) from error
    left, values = _left_singular(upper @ R)
    keep = values > 1e-14 * values[0]  # what is below is round-off
    return ProperModes(Q @ solve_triangular(upper, left[:, keep]), scale * values[keep])


def _left_singular(A: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Left singular vectors and singular values, by the slower driver where the fast one fails."""
    for driver in ("gesdd", "gesvd"):
        with suppress(LinAlgError):
            left, values, _ = svd(A, full_matrices=False, lapack_driver=driver)
            return left, values
    raise ConvergenceError(
        "the singular value decomposition of the snapshots did not converge; take modes of another "
        "run, or of fewer times"
    )


def inner_matrix(system: System, name: str, u: FloatArray, v: FloatArray) -> Matrix | None:
    """Matrix of an inner product by its name; None stands for the unit matrix.

    "energy" is K + s M. The share s of the mass keeps rigid motions apart from each other: it is a
    thousandth of the mean square frequency of the run, Σ vᵀMv / Σ uᵀMu. However slowly a body
    slides as a whole, s is at least what the round-off of K asks for.

    Parameters
    ----------
    system : System
    name : {"energy", "mass", "euclidean"}
    u, v : ndarray, shape (times, n)
        Displacements (m) and velocities (m/s) of the run.
    """
    if name not in INNER_PRODUCTS:
        names = ", ".join(INNER_PRODUCTS)
        raise InputError(f"inner_product: found {name!r}, must be one of {names}")
    if name == "euclidean":
        return None
    if name == "mass":
        return system.M
    square = np.vdot(v, (system.M @ v.T).T) / np.vdot(u, (system.M @ u.T).T)
    least = shifts.LEAST * system.mean_square_frequency
    return system.K + max(1e-3 * square, least) * system.M


def snapshot_matrix(
    u: FloatArray, v: FloatArray, kind: str, inner: Matrix | None = None
) -> FloatArray:
    """Snapshots (s, n) of a run for the decomposition.

    Parameters
    ----------
    u, v : ndarray, shape (times, n)
        Displacements (m) and velocities (m/s).
    kind : {"displacement", "both", "rates"}
        "displacement" takes u alone. "both" takes u and v, each divided by its norm in the inner
        product, so that units do not matter. "rates" takes v and the differences of v between
        stored times. Each row of these is divided by the square root of its norm: where slip starts
        anew velocities are small, and friction changes most.
    inner : matrix, shape (n, n), optional
        The inner product, for the norms of "both".
    """
    if kind == "displacement":
        return u
    if kind == "both":
        squares = [float(np.vdot(x, x if inner is None else (inner @ x.T).T)) for x in (u, v)]
        return np.vstack([u / np.sqrt(squares[0]), v / np.sqrt(squares[1])])
    if kind == "rates":
        return np.vstack([_evened(v), _evened(np.diff(v, axis=0))])
    raise InputError(f"snapshots: found {kind!r}, must be one of {', '.join(SNAPSHOTS)}")


def _evened(x: FloatArray) -> FloatArray:
    """Rows over the square roots of their norms and of the largest norm; without unit."""
    size = np.linalg.norm(x, axis=1)
    return np.asarray(x / np.sqrt(np.maximum(size, 1e-9 * size.max()) * size.max())[:, np.newaxis])


def orthonormal(V: FloatArray, M: Matrix) -> FloatArray:
    """Basis of the span of ``V`` (n, j) with Vᵀ M V = I; dependent directions are dropped.

    Columns of ``V`` may have any scale. If none depends on the others, this is the method of Gram
    and Schmidt: each column of the result lies in the span of the same and earlier columns of V.
    """
    MV = M @ V
    scale = np.sqrt((V * MV).sum(axis=0))
    moves = scale > 0.0
    if not moves.any():  # nothing spans nothing
        return V[:, moves]
    V = V[:, moves] / scale[moves]
    gram = V.T @ (MV[:, moves] / scale[moves])
    values, vectors = np.linalg.eigh(gram)
    dependent = 3e-7**2  # eigenvalues are squares: above the round-off of the Gram matrix
    keep = values > dependent * values[-1]
    if np.all(keep):
        return np.asarray(solve_triangular(np.linalg.cholesky(gram), V.T, lower=True).T)
    return np.asarray(V @ (vectors[:, keep] / np.sqrt(values[keep])))


def modes_beyond(
    V: FloatArray, X: FloatArray, M: Matrix, stiffness: Matrix, negligible: float, most: int
) -> FloatArray:
    """Proper modes of what motions have beyond the span of a basis, the most important first.

    Parameters
    ----------
    V : ndarray, shape (n, j)
        Basis, orthonormal in mass.
    X : ndarray, shape (n, s)
        Motions.
    M, stiffness : matrix, shape (n, n)
        The modes are proper in the norm of the second, and orthonormal in the first.
    negligible : float
        Singular values below this share of the norm of all motions are left out.
    most : int
        Most modes.

    Returns
    -------
    ndarray, shape (n, k)
        Orthonormal in mass, and to V.
    """
    whole = float(np.vdot(X, stiffness @ X))
    for _ in range(2):  # twice, because of round-off
        X = X - V @ (V.T @ (M @ X))
    sizes, turn = np.linalg.eigh(X.T @ (stiffness @ X))
    counting = np.flatnonzero(sizes > negligible**2 * whole)[::-1]
    first = counting[: min(most, V.shape[0] - V.shape[1])]
    new = orthonormal(X @ turn[:, first], M)
    inside = ((V.T @ (M @ new)) ** 2).sum(axis=0)
    # A mode with more of its mass in the span of the basis is round-off.
    return new[:, inside < 1.0 - 1e-6]
