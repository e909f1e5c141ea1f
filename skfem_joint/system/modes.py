"""Natural modes of given matrices, and Rayleigh damping from a ratio of the critical damping."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.linalg import eigh
from scipy.sparse.linalg import LinearOperator, eigsh

from skfem_joint.ground.arrays import BoolArray, FloatArray, IntArray, Matrix
from skfem_joint.ground.errors import InputError
from skfem_joint.ground.loads import Amplitude
from skfem_joint.ground.values import Kind, problems
from skfem_joint.linalg import shifts
from skfem_joint.linalg.factors import factorised, with_pivots
from skfem_joint.linalg.shifts import mean_square_frequency

#: Lowest modes that are computed where the first three that strain are wanted: a body that floats
#: has up to six rigid motions.
SEARCHED = 12
#: Squares of frequencies below this share of the smallest shift are round-off: motions are rigid.
ROUND_OFF = 0.02
#: Strain energy of motions of unit size, over that of single unknowns, above which all strain, and
#: by how many steps of inverse iteration with a shift of 1e-9 that is known to nine digits. Fine
#: slender beams have a dozen motions below the first one.
SOFT = ((1e-6, 3), (5e-9, 12))
#: Pivots of a stiffness below this share of the largest are zero.
ZERO = 1e-11
#: Work of motions, over the bound of its round-off, above which it is real. That of trusses, chains
#: and beams that float is below 0.6, and below 6.5 where entries have 15 digits.
CLEAR = 7.0
#: The same where K is filled by condensation: work of rigid motions is up to 50 times the bound.
FILLED = 100.0
#: Strain energy over that of a motion that nearly is rigid: twenty times the frequency. Slender
#: beams have less between their modes.
APART = 400.0
#: Share of other motions in one that strains nothing, by round-off of solvers.
MIXED = 1e-10


def eigenmodes(
    K: Matrix,
    M: Matrix,
    count: int,
    solve: Callable[[FloatArray], FloatArray] | None = None,
    tolerance: float = 0.0,
) -> tuple[FloatArray, FloatArray]:
    """Lowest natural frequencies (Hz) and mass-orthonormal modes of sparse matrices.

    Parameters
    ----------
    K, M : sparse array, shape (n, n)
        Stiffness and mass, positive definite both.
    count : int
        Number of modes; fewer where the matrices are smaller.
    solve : callable, optional
        Solver of K x = b, if it exists already.
    tolerance : float
        Relative accuracy of the modes; round-off if it is zero.

    Returns
    -------
    frequencies : ndarray, shape (k,)
    modes : ndarray, shape (n, k)
    """
    n = K.shape[0]
    if n < 20 or count >= n - 1:
        values, modes = eigh(K.toarray(), M.toarray(), subset_by_index=[0, min(count, n) - 1])
    else:
        K, M = sparse.csr_array(K), sparse.csr_array(M)
        inverse = LinearOperator((n, n), matvec=solve or factorised(K), dtype=float)
        # A start with the same value everywhere would miss modes of equal bodies.
        start = np.random.default_rng(1).normal(size=n)
        values, modes = eigsh(K, k=count, M=M, sigma=0.0, v0=start, OPinv=inverse, tol=tolerance)
    return np.sqrt(np.maximum(values, 0.0)) / (2.0 * np.pi), modes


def straining_modes(
    K: Matrix, M: Matrix, held: IntArray, count: int = SEARCHED
) -> tuple[FloatArray, FloatArray]:
    """Frequencies (Hz), (k,), and modes, (n, k), of those of the lowest modes that strain the body.

    The unknowns ``held`` do not move. Rigid motions among the ``count`` lowest modes are left out.
    If all unknowns are held there are no modes.
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
    """Rigid motions (n, k) of unit mass, no more than ``most`` of them."""
    frequency, modes = lowest_modes(sparse.csr_array(K), sparse.csr_array(M), most)
    return modes[:, frequency == 0.0]


def hardly_straining(
    K: Matrix, solve: Callable[[FloatArray], FloatArray], size: FloatArray
) -> tuple[FloatArray, int] | None:
    """Motions (n, r) of which all that strain nothing are combinations; None where that is unsure.

    Beside them the number of the first that strain far less than all others, with rigid ones.

    They are found by inverse iteration with a factor that exists already, and of most structures
    by one vector, which tells that there are none.

    Parameters
    ----------
    K : sparse array, shape (n, n)
        Stiffness with ones on its diagonal.
    solve : callable
        Solver of it and a share of the unit matrix, far below `SOFT`.
    size : ndarray, shape (n,)
        Displacement of each unknown for a one.
    """
    random = np.random.default_rng(0)
    for most, (least, steps) in zip((1, SEARCHED, SEARCHED), (SOFT[0], *SOFT), strict=True):
        X = random.normal(size=(K.shape[0], min(most, K.shape[0])))
        for _ in range(steps):
            X = np.linalg.qr(solve(X))[0]
        strain, turn = eigh(X.T @ (K @ X))
        if strain[-1] > least:
            soft = np.flatnonzero(strain <= least)
            apart = soft[strain[soft + 1] > APART * strain[soft]]
            few = int(apart[-1]) + 1 if apart.size else 0
            return np.asarray(size[:, np.newaxis] * (X @ turn[:, soft])), few
    return None


def strain_nothing(K: Matrix, R: FloatArray) -> BoolArray:
    """Whether motions, the columns of R, strain nothing but round-off: (r,)."""
    work = np.einsum("ij,ij->j", R, K @ R)
    # A pivot is the least work of a motion that moves its unknown by one.
    pivot = ZERO * K.diagonal().max() * np.abs(R).max(axis=0) ** 2
    return np.asarray(work <= np.minimum(pivot, least_work(K, R)))  # or it is that of weak springs


def notes_of_weak_springs(K: Matrix, M: Matrix, R: FloatArray) -> Iterator[str]:
    """Notes of motions, the columns of R, of which it is not sure whether they are rigid.

    They strain far less than all others, and more than round-off.
    """
    if not R.size:
        return
    squares, turn = eigh(R.T @ (K @ R), R.T @ (M @ R))
    frequencies = np.sqrt(np.maximum(squares, 0.0)) / (2.0 * np.pi)
    R = R @ turn
    rigid = strain_nothing(K, R)
    if (held := frequencies[~rigid]).size:
        yield (
            f"With joints loose the structure nearly floats: {held.size} of its natural "
            f"frequencies, of {held.min():.4g} to {held.max():.4g} Hz, are far below all others. "
            "Do weak springs hold it, or has its stiffness too few digits in a file? Then it "
            "floats, and displacements at rest mean nothing."
        )
    real = squares > np.maximum(round_off(K, R), mixing(K, R))
    if (taken := frequencies[rigid & real]).size:
        yield (
            f"With joints loose {taken.size} motions of up to {taken.max():.4g} Hz are taken for "
            "rigid, as their work is about the round-off of the stiffness: springs that are so "
            "weak do not count."
        )


def notes_of_shift(K: Matrix, M: Matrix, R: FloatArray, rows: Matrix) -> Iterator[str]:
    """Note where the shift of a structure that floats shows in others of the motions R, (n, r).

    Where the contact's ``rows``, (m, n), see all motions that strain nothing, springs at the
    contact take the place of the shift, and only the round-off of the stiffness shows.
    """
    if not R.size:
        return
    squares, turn = eigh(R.T @ (K @ R), R.T @ (M @ R))
    R = R @ turn
    rigid = strain_nothing(K, R)
    shift = shifts.LEAST * mean_square_frequency(K, M)
    if np.linalg.matrix_rank(rows @ (R / np.abs(R).max(axis=0))[:, rigid], 1e-6) == rigid.sum():
        shift *= ROUND_OFF
    if rigid.any() and (shown := squares[~rigid & (squares < shift)]).size:
        least = float(np.sqrt(shown.min())) / (2.0 * np.pi)
        yield (
            f"A part of the structure floats beside a soft one, of {least:.4g} Hz with joints "
            "loose, less than what quasi-static runs add to the stiffness, or its round-off, gives "
            "the one that floats: displacements of the soft part may be far off. Compute the parts "
            "by themselves, or support the one that floats."
        )


def is_singular(K: Matrix) -> bool:
    """Whether a positive semidefinite matrix is singular, by its smallest pivot.

    A matrix without rows, as of a structure of which every node is in contact, is not.
    """
    if K.shape[0] == 0:
        return False
    try:
        each, _ = with_pivots(K)
    except RuntimeError:  # exactly singular
        return True
    return bool(np.min(each) <= ZERO * np.max(each))


def lowest_modes(
    K: Matrix, M: Matrix, count: int, tolerance: float = 0.0
) -> tuple[FloatArray, FloatArray]:
    """Lowest natural frequencies (Hz), zero of rigid motions, and mass-orthonormal modes.

    The stiffness may be singular, unlike that of `eigenmodes`: a small multiple of the mass is
    added to it, and subtracted from the squares of the frequencies again.
    """
    shift = shifts.LEAST * mean_square_frequency(K, M)
    frequency, modes = eigenmodes(K + shift * M, M, count, tolerance=tolerance)
    if tolerance:  # modes that are not exact strain where rigid ones do not
        return unshifted(frequency, shift), modes
    return without_shift(frequency, modes, K, M, shift)


def without_shift(
    frequency: FloatArray, modes: FloatArray, K: Matrix, M: Matrix, shift: float
) -> tuple[FloatArray, FloatArray]:
    """Natural frequencies, Hz, and modes of K from those of K + shift M; zero of rigid motions.

    Frequencies below that of the shift are computed again, by the Rayleigh-Ritz method in their
    modes: what is subtracted has more round-off than the stiffness itself, which may be that of
    weak springs.
    """
    unknown = FILLED * round_off(K, modes).max() if is_filled(K) else 0.0
    low = (2.0 * np.pi * frequency) ** 2 < 2.0 * shift + unknown
    frequency = unshifted(frequency, shift)
    if low.any():
        X = modes[:, low]
        squares, turn = eigh(X.T @ (K @ X), X.T @ (M @ X))
        X = X @ turn
        rigid = squares <= np.maximum(np.minimum(ROUND_OFF * shift, least_work(K, X)), unknown)
        frequency[low] = np.sqrt(np.where(rigid, 0.0, squares)) / (2.0 * np.pi)
        modes = modes.copy()
        modes[:, low] = X
    return frequency, modes


def is_filled(K: Matrix) -> bool:
    """Whether more than a quarter of a stiffness is filled, as after condensation."""
    return bool(K.shape[0] ** 2 < 4 * sparse.csr_array(K).nnz)


def least_work(K: Matrix, X: FloatArray) -> FloatArray:
    """Work x^T K x of each column of X that is more than round-off of the entries of K, (r,).

    It is infinite, for not known, where K is filled, as after condensation: its entries have the
    round-off of larger ones.
    """
    if is_filled(K):
        return np.full(X.shape[1], np.inf)
    return np.maximum(CLEAR * round_off(K, X), mixing(K, X))


def mixing(K: Matrix, X: FloatArray) -> FloatArray:
    """Work of other motions that solvers leave in each column of X, (r,)."""
    return np.asarray(K.diagonal().max() * (MIXED * np.abs(X).max(axis=0)) ** 2)


def round_off(K: Matrix, X: FloatArray) -> FloatArray:
    """Bound of the round-off of the work x^T K x of each column of X, by entries of K: (r,)."""
    size = np.abs(X)
    return np.asarray(np.finfo(float).eps * np.einsum("ij,ij->j", size, abs(K) @ size))


def unshifted(frequency: FloatArray, shift: float) -> FloatArray:
    """Natural frequencies, Hz, from those of the stiffness K + shift M; zero of rigid motions.

    These are those whose squares differ from the shift by its round-off, some thousandths of it;
    modes of slender structures may be little above it.
    """
    squares = (2.0 * np.pi * frequency) ** 2
    squares = np.where(squares > (1.0 + ROUND_OFF) * shift, squares - shift, 0.0)
    return np.sqrt(squares) / (2.0 * np.pi)


def ratio_problems(ratio: float, others: Mapping[str, object]) -> Iterator[str]:
    """What is wrong with a damping ratio; ``others`` are other ways to give damping, by name."""
    allowed = Kind("above 0 and below 1", lambda x: 0.0 < x < 1.0)
    yield from problems("damping.ratio", ratio, allowed)
    if given := [name for name, value in others.items() if value]:
        yield (
            f"damping.ratio: found beside {' and '.join(given)}, must be given alone: it makes "
            "the damping matrix by itself"
        )


@dataclass(frozen=True)
class RayleighFit:
    """The two frequencies at which Rayleigh damping C = a M + b K has a given ratio.

    Attributes
    ----------
    omega : ndarray, shape (2,)
        rad/s.
    modes : tuple of (ndarray, shape (n,), or None)
        Mode of unit mass of each frequency that is natural; None of a load's.
    joints : {"stuck", "loose"}
        How the joints were for the natural frequencies.
    """

    omega: FloatArray
    modes: tuple[FloatArray | None, FloatArray | None]
    joints: str

    def factors(self, ratio: float) -> tuple[float, float]:
        """Factors a of M, 1/s, and b of K, s."""
        mass, stiffness = 2.0 * ratio * np.array([self.omega.prod(), 1.0]) / self.omega.sum()
        return float(mass), float(stiffness)

    def note(self, ratio: float) -> str:
        """Sentence about the frequencies and the damping between and beyond them."""
        mass, stiffness = self.factors(ratio)
        which = "the loads' highest" if self.modes[1] is None else "a natural one"
        first, second = self.omega / (2.0 * np.pi)
        least, beyond = np.sqrt(self.omega.prod()), 3.0 * self.omega.max()
        at = {w: 0.5 * (mass / w + stiffness * w) for w in (least, beyond)}
        return (
            f"Damping of ratio {ratio:.4g} is C = a M + b K with a = {mass:.4g} 1/s and b = "
            f"{stiffness:.4g} s: exact at {first:.5g} Hz, the first natural frequency with joints "
            f"{self.joints}, and at {second:.5g} Hz, {which}; {at[least]:.3g} at "
            f"{least / (2.0 * np.pi):.5g} Hz between them, where it is least, and "
            f"{at[beyond]:.3g} at {beyond / (2.0 * np.pi):.5g} Hz."
        )

    def factor_rates(
        self, ratio: float, square_rate: Callable[[FloatArray], float]
    ) -> tuple[float, float]:
        """Derivatives of `factors` by what changes the stiffness.

        ``square_rate`` gives the derivative of a natural frequency's square, 1/s2, from its mode:
        the derivative of the stiffness between the mode and itself.
        """
        first, second = self.omega
        rates = [
            0.0 if mode is None else square_rate(mode) / (2.0 * omega)
            for mode, omega in zip(self.modes, self.omega, strict=True)
        ]
        scale = 2.0 * ratio / self.omega.sum() ** 2
        mass = scale * (second**2 * rates[0] + first**2 * rates[1])
        return float(mass), float(-scale * (rates[0] + rates[1]))


def rayleigh_fit(K: Matrix, M: Matrix, stuck: IntArray, loads: Iterable[Amplitude]) -> RayleighFit:
    """Frequencies of Rayleigh damping by its ratio.

    The first is the lowest natural frequency with the unknowns ``stuck`` held (or with none held,
    if all unknowns are stuck). The second is the highest frequency of the harmonic ``loads``; it is
    the third natural frequency if no load is harmonic, or if that frequency is about the first.

    Raises
    ------
    InputError
        If nothing vibrates.
    """
    joints = "stuck" if stuck.size < K.shape[0] else "loose"
    own, shapes = straining_modes(K, M, stuck if joints == "stuck" else stuck[:0])
    if not own.size:
        raise InputError(
            "damping.ratio: nothing vibrates by itself, so that a ratio means nothing; give the "
            "damping's factors of the mass and of the stiffness matrix"
        )
    harmonics = [h.frequency for amplitude in loads for h in amplitude.harmonics]
    first, second, mode = own[0], max(harmonics, default=own[0]), None
    # Frequencies that differ by less than this share are the same.
    if abs(second - first) <= 0.1 * first:
        last = min(3, own.size) - 1
        second, mode = own[last], shapes[:, last]
    return RayleighFit(2.0 * np.pi * np.array([first, second]), (shapes[:, 0], mode), joints)


class KnownFit:
    """`rayleigh_fit` that keeps its last result, for systems that differ in friction alone.

    Modes of a solid of 73,000 unknowns take half a minute, to see that nothing changed far less
    than a second. It keeps the matrices of the last system, which must not be changed in place.
    """

    def __init__(self) -> None:
        self._of: list[NDArray[Any]] = []
        self._fit: RayleighFit | None = None

    def __call__(
        self, K: Matrix, M: Matrix, stuck: IntArray, loads: Iterable[Amplitude]
    ) -> RayleighFit:
        """Frequencies of Rayleigh damping, see `rayleigh_fit`."""
        loads = [*loads]
        frequencies = np.array([h.frequency for load in loads for h in load.harmonics])
        matrices = (sparse.csr_array(A) for A in (K, M))
        parts = [x for A in matrices for x in (A.data, A.indices, A.indptr)]
        of, before = [*parts, stuck, frequencies], self._of
        if self._fit is None or not all(map(np.array_equal, of, before)):
            self._fit, self._of = rayleigh_fit(K, M, stuck, loads), of
        return self._fit
