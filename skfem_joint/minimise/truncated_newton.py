"""Truncated nonsmooth Newton method, for problems in which each slip is an unknown.

The matrix is large and sparse, or dense after condensation to the contact. The method (Graeser and
Kornhuber, J. Comput. Math. 27, 2009; Graeser and Sander, IMA J. Numer. Anal. 39, 2019)
repeats two parts until the forces balance:

1. contact points are relaxed in turn, each with its law solved exactly;
2. a Newton step on all points but those that stick by Coulomb friction, with an exact line search.
   If the search stops short, points whose slip would reverse are set to rest and the step is
   recomputed for the others, if that lowers the objective further: a single such point would block
   all others.

Each part lowers the objective, so that the iteration converges from any start for any beta.
Newton's systems are solved by conjugate gradients. The preconditioner is the factor of an earlier
tangent where the law acts as it did then, and the diagonal where it does not; that factor serves
for several iterations.

Measured for each time step, on a plate in contact over 40 % of its surface (half of the friction
limit, 200 steps a period, beta = 1e5, 3,960 unknowns; ``examples/benchmarks/plates.py``):

========== ====================================== ============ ====== =======
sweeps     factor                                 Newton steps solves factors
========== ====================================== ============ ====== =======
none       new for each Newton step                        6.8    9.2     7.2
four       new for each Newton step                        2.9    4.9     2.9
four       kept up to 6 solves and few changes             3.7   12.7     0.5
four       kept up to 10 solves                            4.2     33     0.1
========== ====================================== ============ ====== =======

The third row is used (`NewtonSettings.patience` and ``changed``): a factor costs as much as ten
solves where the matrix is a narrow band, and as thirty elsewhere.
"""

# mypy: allow-untyped-calls

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from skfem_joint.arrays import BoolArray, FloatArray, check_like
from skfem_joint.linalg.compressed import compressed_rows
from skfem_joint.linalg.factors import BlockFactors
from skfem_joint.linalg.kernels import Full, subtract_product, times
from skfem_joint.minimise.law import potential
from skfem_joint.minimise.point_loops import (
    PointLine,
    Points,
    add_blocks,
    friction_round_off,
    search_along,
    subtract_friction,
    sweep_over,
    tangent_blocks,
)
from skfem_joint.minimise.problem import ContactPoints, Minimum, Pressed


class NewtonSettings(NamedTuple):
    """Numbers of the truncated Newton method.

    Attributes
    ----------
    iterations : int
        Most iterations.
    sweeps : int
        Sweeps of relaxation in each iteration; measured in the module's docstring.
    most_solves : int
        Most solves for a Newton step.
    patience : int
        A new factor is made if a Newton step takes more solves than this.
    forcing : float
        Newton's systems are solved until their residual is this share of the right side.
    changed : int
        If the diagonal of so many unknowns has halved or doubled the kept factor is not tried: of
        178 trials with more, 3 took no more than four solves.
    small : int
        For up to so many moving unknowns of a dense system a new factor costs less than iterations.
    round_off : float
        Accepted residual in units of the forces that are added up.
    nothing : float
        Forces, N, that count as none: products of smaller ones underflow.
    softer, roughly : float
        If no start is given, it is the minimiser for a law of this share of the steepness, to this
        tolerance: a plate with 20,000 unknowns under a load's peak then takes 7 iterations, not 14.
    """

    iterations: int = 100
    sweeps: int = 4
    most_solves: int = 60
    patience: int = 6
    forcing: float = 0.05
    changed: int = 32
    small: int = 512
    round_off: float = 16 * float(np.finfo(np.float64).eps)
    nothing: float = 1e-140
    softer: float = 1e-2
    roughly: float = 0.1


SETTINGS = NewtonSettings()


class TruncatedNewton:
    """The truncated nonsmooth Newton method, see the module and `StepProblem`.

    Parameters
    ----------
    H : csr_array or ndarray, shape (n, n)
        Symmetric positive definite.
    points : ContactPoints
        Each row of ``B`` picks an unknown of its own; points with springs may share them.

    Attributes
    ----------
    first, second : ndarray of int, shape (groups,)
        Unknowns of each point with friction, or group of points that share them; ``second`` is -1
        where they slip in a single direction.
    laws : Points
        The points with friction, sorted by groups.
    kept : tuple of ndarray, or None
        Tangents, and the unknowns that stuck, of the factor that is kept; further solutions depend
        on them.
    """

    def __init__(self, H: Any, points: ContactPoints) -> None:
        n = H.shape[0]
        self.H, self.points, self.dense = H, points, isinstance(H, np.ndarray)
        self.rows = Full(H) if self.dense else compressed_rows(H)
        self.kept: tuple[FloatArray, BoolArray] | None = None
        self.factor: Callable[[FloatArray], FloatArray] | None = None
        self.factorizations = 0
        unknowns = np.append(points.unknowns, -1).astype(np.int64)
        first = unknowns[points.first_row[:-1]]
        second = np.where(points.directions == 2, unknowns[points.first_row[:-1] + 1], -1)
        order = np.argsort(first, kind="stable")
        self._order = order = order[points.w[order] > 0.0]
        self.first, start = np.unique(first[order], return_index=True)
        self.second = second[order][start]
        w, soft = (np.array(x, dtype=float)[order] for x in (points.w, points.soft))
        self.w, self.beta = w, self.ordered_beta(points.beta)
        start, none = np.append(start, order.size).astype(np.int64), np.zeros(order.size)
        self.laws = Points(self.first, self.second, start, w, self.beta, soft, none, none)
        # Rows of these points, and which points have a second one.
        self._rows = points.first_row[:-1][order]
        self._pairs = np.flatnonzero(second[order] >= 0)
        self.both = self.second >= 0
        self.pairs = i, j = self.first[self.both], self.second[self.both]
        self.diagonal = diagonal = H.diagonal()
        self.added = np.zeros(n)
        self.stiff = diagonal[self.first]
        mean, half = 0.5 * (diagonal[i] + diagonal[j]), 0.5 * (diagonal[i] - diagonal[j])
        self.stiff[self.both] = mean + np.hypot(half, np.asarray(H[i, j]).ravel())
        rigid = soft[start[:-1]] == 0.0
        self.limited = np.zeros(n, dtype=bool)  # unknowns that friction without springs acts on
        self.limited[self.first[rigid]] = self.limited[self.second[rigid & self.both]] = True
        self.factors = BlockFactors(H, self.first, self.second)

    def ordered_beta(self, beta: FloatArray) -> FloatArray:
        """Steepness of the points with friction, in the order of ``first``, from that of all."""
        return np.array(beta, dtype=float)[self._order]

    def with_matrix(self, H: Any) -> TruncatedNewton:
        """See `StepProblem`."""
        return TruncatedNewton(H, self.points)

    def compile(self) -> None:
        """See `StepProblem`."""
        none, nothing, block = self.first[:0], self.w[:0], np.zeros((0, 3))
        laws = Points(none, none, np.zeros(1, dtype=np.int64), *5 * [nothing])
        x, y = np.zeros((2, self.H.shape[0]))
        subtract_product(self.rows, x, y)
        sweep_over(self.rows, laws, nothing, x, y, False)
        subtract_friction(laws, x, y, np.zeros((0, 2)), np.zeros(x.size, dtype=np.bool_))
        tangent_blocks(laws, nothing, x, block)
        search_along(PointLine(laws, x, y), 0.0, 1.0)
        friction_round_off(laws, x)
        add_blocks(none, none, block, x, y)
        potential(nothing, nothing)

    def minimise(
        self,
        g: FloatArray,
        start: FloatArray | None = None,
        tolerance: float = 1e-11,
        beta: FloatArray | None = None,
        offset: FloatArray | None = None,
        pressed: Pressed | None = None,
    ) -> Minimum:
        """See `StepProblem`."""
        return self.minimise_beside(g, start, tolerance, beta, 0.0, offset)

    def minimise_beside(
        self,
        g: FloatArray,
        start: FloatArray | None,
        tolerance: float,
        beta: FloatArray | None,
        force: float,
        offset: FloatArray | None = None,
        pressed: Pressed | None = None,
    ) -> Minimum:
        """`minimise` where the tolerance also refers to a ``force`` (N) on condensed unknowns."""
        laws = self.laws_of(beta, offset)
        if start is None:
            start = self._start(g, laws, force)
        return self._minimise(g, start, tolerance, laws, force)

    def laws_of(self, beta: FloatArray | None, offset: FloatArray | None) -> Points:
        """Points with friction with the ``beta``, (m,), and ``offset``, (rows,), of a call."""
        laws = self.laws
        if beta is not None:
            laws = laws._replace(beta=self.ordered_beta(beta))
        if offset is not None and np.any(laws.soft):
            y = np.zeros(laws.w.size)
            y[self._pairs] = offset[self._rows[self._pairs] + 1]
            laws = laws._replace(x=np.array(offset[self._rows]), y=y)
        return laws

    def _start(self, g: FloatArray, laws: Points, force: float) -> FloatArray:
        """Rough minimiser for a softer law; rest if that is better, or under Coulomb friction."""
        rest = np.zeros_like(g)
        if np.isinf(laws.beta).any():
            return rest
        soft = laws._replace(beta=SETTINGS.softer * laws.beta)
        v = self._minimise(g, rest, SETTINGS.roughly, soft, force).v
        least = self._objective(rest, g, laws) if np.any(laws.soft) else 0.0
        return v if self._objective(v, g, laws) < least else rest

    def _minimise(
        self, g: FloatArray, start: FloatArray, tolerance: float, laws: Points, force: float
    ) -> Minimum:
        scale = max(float(np.abs(g).max()), force)
        sprung = bool(np.any(laws.x) or np.any(laws.y))  # springs act where no other force does
        v = start.copy() if scale > SETTINGS.nothing or sprung else np.zeros_like(start)
        if sprung:
            scale = max(scale, self._spring_force(laws))
        friction = np.zeros((laws.w.size, 2))
        sticking = np.zeros(v.size, dtype=np.bool_)
        factorizations, evaluations, solves = self.factorizations, 0, 0
        residual, where, converged = np.inf, 0, False
        r = g - times(self.H, v)
        for iteration in range(SETTINGS.iterations):
            for sweep in range(SETTINGS.sweeps):
                backward = bool((sweep + iteration) % 2)
                sweep_over(self.rows, laws, self.stiff, r, v, backward)
            r = g - times(self.H, v)
            left = r.copy()
            residual, where = subtract_friction(laws, v, r, friction, sticking)
            evaluations += SETTINGS.sweeps + 1
            if not np.isfinite(residual):
                break
            converged = residual <= max(tolerance * scale, SETTINGS.nothing) or (
                residual <= 1e-6 * scale and residual <= self._round_off(v, g, laws)
            )
            if converged:
                break
            d, along, length, more, trials = self._newton_step(v, left, r, sticking, laws)
            solves, evaluations = solves + more, evaluations + trials
            if length < 1.0 and (reverses := self._reverses(v, d)).any():
                stopped, more, trials = self._stopped(v, reverses, g, laws)
                solves, evaluations = solves + more, evaluations + trials + 2
                if self._objective(v + stopped, g, laws) < self._objective(v + length * d, g, laws):
                    length, d, along = 1.0, stopped, times(self.H, stopped)
            v += length * d
            r = left - length * along
        counts = {
            "newton_iterations": iteration,
            "friction_evaluations": evaluations,
            "linear_solves": solves,
            "factorizations": self.factorizations - factorizations,
        }
        by_row = np.zeros(self.points.B.shape[0])
        by_row[self._rows] = friction[:, 0]
        by_row[self._rows[self._pairs] + 1] = friction[self._pairs, 1]
        return Minimum(
            v, by_row, bool(converged), counts, float(residual), int(where), w=self.points.w
        )

    def objective(
        self,
        v: FloatArray,
        g: FloatArray,
        beta: FloatArray | None = None,
        offset: FloatArray | None = None,
    ) -> float:
        """See `StepProblem`."""
        return self._objective(v, g, self.laws_of(beta, offset))

    def _objective(self, v: FloatArray, g: FloatArray, laws: Points) -> float:
        return float(v @ (0.5 * times(self.H, v) - g)) + self.friction_potential(v, laws)

    def friction_potential(self, v: FloatArray, laws: Points) -> float:
        """Sum w psi(|v_p|) of the points with friction, see `laws_of`."""
        first, second = v[self.first], np.where(self.second < 0, 0.0, v[self.second])
        if not np.any(laws.soft):
            return float(laws.w @ potential(np.hypot(first, second), laws.beta))
        count = np.diff(laws.start)
        slip = np.hypot(np.repeat(first, count) - laws.x, np.repeat(second, count) - laws.y)
        return float(laws.w @ potential(slip, laws.beta, laws.soft))

    def _spring_force(self, laws: Points) -> float:
        """Largest force of springs on an unknown at rest, N: a scale where no load acts."""
        v, r = np.zeros((2, self.diagonal.size))
        sticking = np.zeros(v.size, dtype=np.bool_)
        return float(subtract_friction(laws, v, r, np.zeros((laws.w.size, 2)), sticking)[0])

    def _newton_step(
        self, v: FloatArray, left: FloatArray, r: FloatArray, sticking: BoolArray, laws: Points
    ) -> tuple[FloatArray, FloatArray, float, int, int]:
        """Newton's direction d from ``v``, H d, and its length; solves and evaluations.

        ``left`` is g - H v, ``r`` the same less friction; unknowns marked in ``sticking`` rest.
        """
        tangents = np.zeros((self.first.size, 3))
        tangent_blocks(laws, self.stiff, v, tangents)
        r[sticking] = 0.0
        d, solves = self._newton_direction(r, tangents, sticking)
        along = times(self.H, d)
        line = PointLine(laws, v, d)
        length, evaluations = search_along(line, -float(d @ left), float(d @ along))
        return d, along, length, solves, evaluations

    def _reverses(self, v: FloatArray, d: FloatArray) -> BoolArray:
        """Unknowns of points whose slip would reverse along ``d``."""
        i, j = self.pairs
        turning = v * (v + d)
        turning[i] = turning[j] = turning[i] + turning[j]
        return np.asarray(self.limited & (turning < 0.0))

    def _stopped(
        self, v: FloatArray, reverses: BoolArray, g: FloatArray, laws: Points
    ) -> tuple[FloatArray, int, int]:
        """Step that sets slips which would reverse to rest, and is Newton's for the others.

        Also returns solves and evaluations.
        """
        stop = np.where(reverses, -v, 0.0)
        r = g - times(self.H, v + stop)
        left, sticking = r.copy(), np.zeros_like(reverses)
        subtract_friction(laws, v + stop, r, np.zeros((laws.w.size, 2)), sticking)
        resting = sticking | reverses
        d, _, length, solves, trials = self._newton_step(v + stop, left, r, resting, laws)
        return stop + length * d, solves, trials

    @cached_property
    def sizes(self) -> Any:
        """Magnitudes of the entries of H, as large as H: few steps need them."""
        return abs(self.H)

    def _round_off(self, v: FloatArray, g: FloatArray, laws: Points) -> float:
        size = float(times(self.sizes, np.abs(v)).max()) + float(np.abs(g).max())
        size += float(friction_round_off(laws, v))
        return SETTINGS.round_off * size

    def _newton_direction(
        self, r: FloatArray, tangents: FloatArray, sticking: BoolArray
    ) -> tuple[FloatArray, int]:
        """Solve (H + tangent) d = r on the unknowns that do not stick; also returns the solves.

        The kept factor is that of an earlier tangent: conjugate gradients correct for what has
        changed, until that takes longer than a new factor.
        """
        if not np.any(r):  # only sticking points are out of balance: relaxation will release them
            return np.zeros_like(r), 0
        if self.dense and (free := np.flatnonzero(~sticking)).size <= SETTINGS.small:
            self.factorizations += 1
            d = np.zeros_like(r)
            d[free] = self.factors.factorised(tangents, sticking)(r)[free]
            return d, 1
        solves = 0
        if self.factor is not None:
            d, solves, solved = self._conjugate_gradients(
                self.factor, r, tangents, sticking, SETTINGS.patience
            )
            if solved:
                return d, solves
        solve = self.keep(tangents, sticking)
        d, more, _ = self._conjugate_gradients(solve, r, tangents, sticking, SETTINGS.most_solves)
        return d, solves + more

    def keep(self, tangents: FloatArray, sticking: BoolArray) -> Callable[[FloatArray], FloatArray]:
        """Factorise H + tangent on the unknowns that do not stick, and keep that factor."""
        self.factorizations += 1
        self.kept = tangents.copy(), sticking.copy()
        self.factor = self.factors.factorised(tangents, sticking)
        self.added = np.where(sticking, np.inf, self._diagonal(tangents))
        return self.factor

    def _diagonal(self, tangents: FloatArray) -> FloatArray:
        """Diagonal of the points' blocks, by unknown."""
        diagonal = np.zeros(self.diagonal.size)
        diagonal[self.first], diagonal[self.pairs[1]] = tangents[:, 0], tangents[self.both, 2]
        return diagonal

    def _conjugate_gradients(
        self,
        solve: Callable[[FloatArray], FloatArray],
        r: FloatArray,
        tangents: FloatArray,
        sticking: BoolArray,
        most: int,
    ) -> tuple[FloatArray, int, bool]:
        """Direction, solves with the kept factor ``solve``, and whether they were enough."""
        now = self.diagonal + self._diagonal(tangents)
        then = self.diagonal + self.added
        # The factor where the tangent is as it was then, the diagonal where it is not.
        share = np.minimum(1.0, then / now)
        rest = (1.0 - np.minimum(share, now / then)) / now
        share[np.isinf(then)] = 0.0
        changed = np.where(sticking, np.isfinite(then), rest * now > 0.5)
        if np.count_nonzero(changed) >= SETTINGS.changed:
            return r, 0, False
        share[sticking] = rest[sticking] = 0.0

        d, p, before = np.zeros_like(r), np.zeros_like(r), np.inf
        left, enough = r.copy(), SETTINGS.forcing * np.linalg.norm(r)
        for solves in range(1, most + 1):
            z = share * solve(share * left) + rest * left
            product = float(left @ z)
            p = z + product / before * p
            before = product
            image = times(self.H, p)
            add_blocks(self.first, self.second, tangents, p, image)
            image[sticking] = 0.0
            step = product / float(p @ image)
            d += step * p
            left -= step * image
            if np.linalg.norm(left) <= enough:
                return d, solves, True
        return d, most, False

    def saved(self) -> dict[str, NDArray[Any]]:
        """See `StepProblem`."""
        names = "tangents", "sticking"
        return {} if self.kept is None else dict(zip(names, self.kept, strict=True))

    def check(self, saved: dict[str, NDArray[Any]]) -> None:
        """See `StepProblem`."""
        if not saved:
            return
        n, m = self.diagonal.size, self.first.size
        planned = {"tangents": np.zeros((m, 3)), "sticking": np.zeros(n, dtype=np.bool_)}
        check_like(saved, planned, "step problem")

    def restore(self, saved: dict[str, NDArray[Any]]) -> None:
        """See `StepProblem`; factorises again."""
        if saved:
            self.keep(saved["tangents"], saved["sticking"])
