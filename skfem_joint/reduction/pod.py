"""Proper orthogonal decomposition of a history, Eq. (3)."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from scipy.linalg import LinAlgError, solve_triangular, svd

from skfem_joint.arrays import FloatArray, Matrix
from skfem_joint.errors import ConvergenceError, InputError
from skfem_joint.linalg import shifts
from skfem_joint.stepping.recording import Run
from skfem_joint.system import System
from skfem_joint.values import COUNT, check

#: What the snapshots of a decomposition hold.
SNAPSHOTS = ("both", "displacement", "rates")
#: Inner products that modes may be orthogonal in.
INNER_PRODUCTS = ("energy", "mass", "euclidean")
# Singular values below this share of the largest are round-off; those of directions that depend on
# others, not below the square root of it.
_ROUND_OFF, _DEPENDENT = 1e-14, 3e-7


def thinned(history: FloatArray, most: int) -> FloatArray:
    """Evenly spread rows of a history, (times, ...), no more than ``most``."""
    return history[:: stride_of(len(history), most)]


def stride_of(count: int, most: int) -> int:
    """Stride with which no more than ``most`` of so many rows are taken."""
    return max(1, -(-count // most))


@dataclass(frozen=True)
class ProperModes:
    """Proper orthogonal modes and values.

    Attributes
    ----------
    modes : ndarray, shape (n, r)
        Orthonormal in the inner product that they were made with.
    singular_values : ndarray, shape (r,)
        Decreasing.
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

    ``run.system.project(proper.modes[:, :r])`` is the model reduced to the first r of them.

    Parameters
    ----------
    run : Run
        With stored fields, ``save=Save(fields=True)``.
    snapshots : {"both", "displacement", "rates"}
        What is decomposed. ``"displacement"`` is the paper's. ``"both"`` are displacement and
        velocity, each divided by its norm: friction acts on velocities, so that such modes err less
        in energy. ``"rates"`` are velocity and acceleration, slow instants weighed up.
    inner_product : {"energy", "mass", "euclidean"}
        What the modes are orthonormal in: V^T G V = I with G = K and a small share of M, G = M, or
        the unit matrix, which is the paper's. See `inner_matrix`.
    every : int
        Every so many of the stored times are taken.

    Returns
    -------
    ProperModes
        At most as many modes as snapshots and as unknowns; those that are round-off are left out.

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
    """Proper orthogonal decomposition of snapshots (times, n); no (n, n) matrix is filled.

    V^T G V = I with the symmetric positive definite matrix G of the ``inner`` product, (n, n),
    Euclidean if not given.

    InputError if the snapshots are not finite, nothing moves in them, or G is not positive.
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
    keep = values > _ROUND_OFF * values[0]
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
    """Matrix of an inner product by name, for displacements and velocities (times, n) of a run.

    ``energy`` is that of strain energy with a share of the mass, which keeps rigid motions apart:
    the mean square frequency of the run weighs it, but not less than round-off of the stiffness
    asks for, however slowly a body slides as a whole.
    """
    if name not in INNER_PRODUCTS:
        names = ", ".join(INNER_PRODUCTS)
        raise InputError(f"inner_product: found {name!r}, must be one of {names}")
    if name == "euclidean":
        return None
    if name == "mass":
        return system.M
    square = np.vdot(v, (system.M @ v.T).T) / np.vdot(u, (system.M @ u.T).T)
    least = shifts.SETTINGS.least * system.mean_square_frequency
    return system.K + max(1e-3 * square, least) * system.M


def snapshot_matrix(
    u: FloatArray, v: FloatArray, kind: str, inner: Matrix | None = None
) -> FloatArray:
    """Snapshots of displacement (the paper's), of displacement and velocity, or of rates.

    Friction acts on velocities: modes that also span them err less in energy. With ``both``, each
    history is divided by its norm (in the inner product), so that units do not matter. ``rates``
    are velocity and acceleration (differences of velocities), each instant weighed by the root of
    its norm alone: where slip starts anew, velocities are small and friction changes most.

    ``u`` and ``v`` are displacement (m) and velocity (m/s), (times, n) each.
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
    """Rows over the square roots of their norms, so that slow instants count for more; no units."""
    size = np.linalg.norm(x, axis=1)
    return np.asarray(x / np.sqrt(np.maximum(size, 1e-9 * size.max()) * size.max())[:, np.newaxis])


def orthonormal(V: FloatArray, M: Matrix) -> FloatArray:
    """Basis of the span of ``V`` with V^T M V = I; directions that depend on others are dropped.

    Columns of ``V`` (n, j) may have any scale.
    """
    MV = M @ V
    scale = np.sqrt((V * MV).sum(axis=0))
    moves = scale > 0.0
    if not moves.any():  # nothing spans nothing
        return V[:, moves]
    V = V[:, moves] / scale[moves]
    gram = V.T @ (MV[:, moves] / scale[moves])
    values, vectors = np.linalg.eigh(gram)
    keep = values > _DEPENDENT**2 * values[-1]
    if np.all(keep):
        # Gram-Schmidt keeps the order and the look of the modes.
        return np.asarray(solve_triangular(np.linalg.cholesky(gram), V.T, lower=True).T)
    return np.asarray(V @ (vectors[:, keep] / np.sqrt(values[keep])))
