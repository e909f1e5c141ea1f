"""Natural modes, and damping that is given by the ratio of the critical one at two frequencies."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping

import numpy as np
from scipy import sparse
from scipy.linalg import eigh
from scipy.sparse.linalg import LinearOperator, eigsh

from skfem_joint.arrays import FloatArray, IntArray, Matrix
from skfem_joint.errors import InputError
from skfem_joint.linalg.factors import factorised, pivots
from skfem_joint.loads import Amplitude
from skfem_joint.values import Kind, problems

#: Modes that are looked at for three that strain, and the share of the mean square frequency that
#: those have at least.
LOOKED_AT, _RIGID = 12, 1e-12
#: Ratios of damping that are allowed.
RATIO = Kind("above 0 and below 1", lambda x: 0.0 < x < 1.0)
#: Pivots below this share of the largest are zero.
_SINGULAR = 1e-11
#: Frequencies that differ by less than this share are the same.
_SAME = 0.1


def eigenmodes(
    K: Matrix,
    M: Matrix,
    count: int,
    solve: Callable[[FloatArray], FloatArray] | None = None,
    tolerance: float = 0.0,
) -> tuple[FloatArray, FloatArray]:
    """Lowest natural frequencies (Hz) and mass-orthonormal modes of sparse matrices.

    ``solve`` is a solver of K x = b, if there is one already. The ``tolerance`` is that of modes,
    relative; round-off if it is zero.
    """
    n = K.shape[0]
    if n < 20 or count >= n - 1:
        values, modes = eigh(K.toarray(), M.toarray(), subset_by_index=[0, min(count, n) - 1])
    else:
        K, M = sparse.csc_array(K), sparse.csc_array(M)
        inverse = LinearOperator((n, n), matvec=solve or factorised(K), dtype=float)
        start = np.random.default_rng(1).normal(size=n)  # an even one misses modes of equal bodies
        values, modes = eigsh(K, k=count, M=M, sigma=0.0, v0=start, OPinv=inverse, tol=tolerance)
    return np.sqrt(np.maximum(values, 0.0)) / (2.0 * np.pi), modes


def straining_modes(
    K: Matrix, M: Matrix, held: IntArray, count: int = LOOKED_AT
) -> tuple[FloatArray, FloatArray]:
    """Of the ``count`` lowest modes those that are no rigid motions: frequencies (Hz), (n, k).

    The unknowns ``held`` do not move; none is left where they are all.
    """
    free = np.setdiff1d(np.arange(K.shape[0]), held)
    if not free.size:
        return np.zeros(0), np.zeros((K.shape[0], 0))
    K, M = (sparse.csr_array(A)[free][:, free] for A in (K, M))
    frequency, modes = lowest_modes(K, M, count)
    strains = frequency > 0.0
    shapes = np.zeros((held.size + free.size, int(strains.sum())))
    shapes[free] = modes[:, strains]
    return frequency[strains], shapes


def rigid_motions(K: Matrix, M: Matrix, most: int) -> FloatArray:
    """Motions (n, k) that strain nothing, at ``most`` so many of them, of unit mass."""
    frequency, modes = lowest_modes(sparse.csr_array(K), sparse.csr_array(M), most)
    return modes[:, frequency == 0.0]


def is_singular(K: Matrix) -> bool:
    """Whether a positive semidefinite matrix is singular, by its smallest pivot."""
    try:
        found = pivots(K)
    except RuntimeError:  # exactly singular
        return True
    return bool(np.min(found) <= _SINGULAR * np.max(found))


def lowest_modes(K: Matrix, M: Matrix, count: int) -> tuple[FloatArray, FloatArray]:
    """Lowest natural frequencies (Hz), zero of rigid motions, and mass-orthonormal modes.

    Unlike `eigenmodes` it takes a singular stiffness: a small share of the mass is added to it, and
    taken off the squares of the frequencies again.
    """
    small = _RIGID * float(K.diagonal().sum() / M.diagonal().sum())
    frequency, modes = eigenmodes(K + small * M, M, count)
    shifted = (2.0 * np.pi * frequency) ** 2
    squares = np.where(shifted > 2.0 * small, shifted - small, 0.0)
    return np.sqrt(squares) / (2.0 * np.pi), modes


def ratio_problems(ratio: float, others: Mapping[str, object]) -> Iterator[str]:
    """What is wrong with a damping ratio beside other ways to give damping, by their names."""
    yield from problems("damping.ratio", ratio, RATIO)
    if given := [name for name, value in others.items() if value]:
        yield (
            f"damping.ratio: found beside {' and '.join(given)}, must be given alone: it makes "
            "the damping matrix by itself"
        )


def rayleigh(
    K: Matrix, M: Matrix, stuck: IntArray, loads: Iterable[Amplitude], ratio: float
) -> tuple[float, float, str]:
    """Factors of M (1/s) and of K (s) of a damping with the ratio, and a sentence that says so.

    It is exact at the first natural frequency with the unknowns ``stuck`` held (none, where that
    leaves nothing), and at the highest frequency of the harmonic ``loads``, or at the third natural
    frequency where there is none or it is about the first.

    Raises
    ------
    InputError
        If nothing vibrates.
    """
    joints = "stuck" if stuck.size < K.shape[0] else "loose"
    own = straining_modes(K, M, stuck if joints == "stuck" else stuck[:0])[0]
    if not own.size:
        raise InputError(
            "damping.ratio: nothing vibrates by itself, so that a ratio means nothing; give the "
            "damping's factors of the mass and of the stiffness matrix"
        )
    harmonics = [one.frequency for amplitude in loads for one in amplitude.harmonics]
    first, second = own[0], max(harmonics, default=own[0])
    which = "the loads' highest"
    if abs(second - first) <= _SAME * first:
        second, which = own[:3][-1], "a natural one"
    omega = 2.0 * np.pi * np.array([first, second])
    mass, stiffness = 2.0 * ratio * np.array([omega.prod(), 1.0]) / omega.sum()
    least = np.sqrt(omega.prod())
    beyond = 3.0 * omega.max()
    at = {w: 0.5 * (mass / w + stiffness * w) for w in (least, beyond)}
    return (
        float(mass),
        float(stiffness),
        f"Damping of ratio {ratio:.4g} is C = a M + b K with a = {mass:.4g} 1/s and b = "
        f"{stiffness:.4g} s: exact at {first:.5g} Hz, the first natural frequency with joints "
        f"{joints}, and at {second:.5g} Hz, {which}; {at[least]:.3g} at "
        f"{least / (2.0 * np.pi):.5g} Hz between them, where it is least, and {at[beyond]:.3g} at "
        f"{beyond / (2.0 * np.pi):.5g} Hz.",
    )
