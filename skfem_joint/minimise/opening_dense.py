"""Step problems with contact that opens in few unknowns, as those of reduced models.

    minimise over v:   1/2 v H v - g v + sum w psi(|B v|) + sum k / 2 max(N v - bound, 0)^2

A reduced model has more friction points and pressure points than unknowns, so that they can neither
all stick nor all rest on their bounds: friction has a law of finite steepness, and contact a finite
stiffness k. Its forces p = k max(N v - bound, 0) give the friction limits w = max(0, given + gain
p).

Newton's method runs on the unknowns themselves. Its tangent of the law of friction is that of
:mod:`skfem_joint.minimise.primal_dual_newton`, and it has the change of the limits by that of the
normal forces, which makes it unsymmetric. Where that iteration stalls, limits are kept until the
convex problem for them is solved, with a search along each direction, and then renewed, as in
:mod:`skfem_joint.minimise.opening_newton`. What does not balance with the limits of its own normal
forces is not returned as converged.
"""

# mypy: allow-untyped-calls

from __future__ import annotations

from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np
from scipy import linalg, sparse

from skfem_joint.arrays import FloatArray, as_dense, slip_norms
from skfem_joint.errors import InputError
from skfem_joint.minimise import law
from skfem_joint.minimise.limits import Renewal
from skfem_joint.minimise.opening_loops import Gain, Rows, rows_of_tangent
from skfem_joint.minimise.problem import ContactPoints, Minimum, Pressed

if TYPE_CHECKING:
    from skfem_joint.minimise.problem import PressurePoints


class DenseOpeningSettings(NamedTuple):
    """Numbers of the method.

    Attributes
    ----------
    iterations : int
        Most iterations.
    shorter : float
        Factor by which a step is shortened that does not lead on.
    halvings : int
        Most times that it is.
    grows : float
        A coupled step leads on if the residual grows by no more than this factor. Residuals of few
        unknowns grow on the way: where each had to fall, steps of 67 unknowns took 16.4 iterations
        in place of 12.9.
    patience : int
        Iterations in which the residual must halve; otherwise limits are kept for a while.
    inner : float
        The convex problem is solved to this share of the residual that its limits leave.
    again : float
        Limits follow normal forces in each iteration again when those kept have brought the
        residual to this share of what it was.
    round_off : float
        Accepted residual in units of the forces that are added up.
    """

    iterations: int = 200
    shorter: float = 0.4
    halvings: int = 8
    grows: float = 4.0
    patience: int = 8
    inner: float = 0.1
    again: float = 1e-2
    round_off: float = 64 * float(np.finfo(np.float64).eps)


SETTINGS = DenseOpeningSettings()


class _State(NamedTuple):
    """Forces at some unknowns v, for some friction limits.

    Attributes
    ----------
    v : ndarray, shape (n,)
    over : ndarray, shape (q,)
        How far each pressure point is beyond its bound.
    p : ndarray, shape (q,)
        Normal forces, N.
    w : ndarray, shape (m,)
        Friction limits that belong to them, N.
    slip : ndarray, shape (rows,)
    sigma : ndarray, shape (rows,)
        Friction over its limit.
    elastic : ndarray, shape (n,)
        All forces but friction, N.
    """

    v: FloatArray
    over: FloatArray
    p: FloatArray
    w: FloatArray
    slip: FloatArray
    sigma: FloatArray
    elastic: FloatArray


class OpeningDense:
    """Step problem of a reduced model with contact that opens, see the module.

    Parameters
    ----------
    H : ndarray, shape (n, n)
        Symmetric positive definite.
    points : ContactPoints
        Any slip rows, and pressure points with a stiffness.

    Raises
    ------
    InputError
        If a pressure point is rigid.
    """

    def __init__(self, H: Any, points: ContactPoints) -> None:
        N, gain, stiffness = vars(cast("PressurePoints", points.normal)).values()
        if np.isinf(stiffness).any():
            raise InputError(
                "contact that opens: found a rigid pressure point in a reduced or dense model, "
                "whose unknowns are no slips and approaches, must have a finite stiffness at each "
                "of them; sj.reduce gives it one"
            )
        self.H, self.points = as_dense(H), points
        self.B, self.N = np.ascontiguousarray(as_dense(points.B)), np.ascontiguousarray(as_dense(N))
        self.gain, self.stiffness = sparse.csr_array(gain), stiffness
        self.first, directions = points.first_row[:-1], points.directions
        point = np.repeat(np.arange(directions.size), directions)
        # The other row of each row's point; of points with one row, that row itself.
        other = 2 * np.repeat(self.first, directions) + 1 - np.arange(point.size)
        self.paired = np.repeat(directions == 2, directions)
        other = np.where(self.paired, other, np.arange(other.size))
        self.rows = Rows(self.B, point, other, self.N, np.array(stiffness, dtype=float))
        self.left, self.right = np.empty((2, len(self.B) + len(self.N), len(self.H)))
        self.factorizations = 1

    def minimise(
        self,
        g: FloatArray,
        start: FloatArray | None = None,
        tolerance: float = 1e-11,
        beta: FloatArray | None = None,
        offset: FloatArray | None = None,
        pressed: Pressed | None = None,
    ) -> Minimum:
        """See `StepProblem`; hinges and points that touch are of no use to few unknowns."""
        bound, given, gain, *_ = cast("Pressed", pressed)
        law_of = self.points.beta if beta is None else np.asarray(beta, dtype=float)
        factors = np.broadcast_to(np.asarray(gain, dtype=float), bound.shape)
        search = _Search(self, g, bound, given, factors, law_of)
        search.run(np.zeros(g.size) if start is None else start, tolerance)
        s = search.state
        converged = search.converged and bool(np.isfinite(s.v).all())
        where = int(np.abs(search.left).argmax())
        return Minimum(s.v, s.sigma, converged, search.counts, search.residual, where, s.p, s.w)


class _Search:
    """The iteration for one right side, see the module."""

    def __init__(
        self,
        problem: OpeningDense,
        g: FloatArray,
        bound: FloatArray,
        given: FloatArray,
        factors: FloatArray,
        beta: FloatArray,
    ) -> None:
        self.problem, self.g, self.bound, self.given = problem, g, bound, given
        self.gain = sparse.csr_array(problem.gain @ sparse.diags_array(factors))
        rubs = (given > 0.0) | (np.diff(self.gain.indptr) > 0)
        if np.isinf(beta[rubs]).any():
            raise InputError(
                "contact that opens: set-valued Coulomb friction (beta = inf) needs one unknown "
                "for each slip, which a reduced model has not; use System.no_steeper"
            )
        self.beta = np.where(np.isfinite(beta), beta, 0.0)
        G = self.gain
        self.change = Gain(G.indptr, G.indices, G.data)
        self.no_change = Gain(np.zeros_like(G.indptr), G.indices, G.data)
        self.on_rows = problem.points.on_rows
        self.counts = {
            "newton_iterations": 0,
            "friction_evaluations": 0,
            "linear_solves": 0,
            "factorizations": 0,
            "renewed_limits": 0,
        }
        self.predicted: FloatArray | None = None
        self.converged, self.residual = False, np.inf

    def run(self, start: FloatArray, tolerance: float) -> None:
        """Iterate from ``start`` until forces balance to the tolerance times the largest force."""
        self.state = s = self._at(start)
        renewal: Renewal | None = None  # while limits are kept
        kept, best, since, inner = s.w, np.inf, 0, 0.0
        mark = np.inf
        for _ in range(SETTINGS.iterations):
            self.left = self._residual(s, s.w)
            self.residual = float(np.abs(self.left).max())
            if not np.isfinite(self.residual):
                return
            if self._is_small(s, tolerance):
                self.converged = True
                return
            if renewal is None:
                if self.residual <= 0.5 * best:
                    best, since = self.residual, 0
                since += 1
                tried = None if since > SETTINGS.patience else self._coupled(s)
                if tried is not None:
                    s = self.state = tried
                    continue
                renewal, mark, kept = Renewal(), self.residual, s.w
                inner = SETTINGS.inner * self.residual
            left = self._residual(s, kept)
            if float(np.abs(left).max()) <= inner:
                self.counts["renewed_limits"] += 1
                inner = SETTINGS.inner * self.residual
                if self.residual <= SETTINGS.again * mark:
                    renewal, best, since = None, np.inf, 0
                    continue
                kept = renewal.next(kept, s.w)
                left = self._residual(s, kept)
            s = self.state = self._descended(s, kept, left)

    def _at(self, v: FloatArray) -> _State:
        """Forces at ``v``, with the limits of its own normal forces."""
        problem = self.problem
        over = problem.N @ v - self.bound
        p = problem.stiffness * np.maximum(over, 0.0)
        w = np.maximum(self.given + self.gain @ p, 0.0)
        slip = problem.B @ v
        sigma = law.force_vectors(slip, self.beta, problem.points.directions)
        self.counts["friction_evaluations"] += 1
        return _State(v, over, p, w, slip, sigma, problem.H @ v - self.g + problem.N.T @ p)

    def _residual(self, s: _State, w: FloatArray) -> FloatArray:
        return s.elastic + self.problem.B.T @ (self.on_rows(w) * s.sigma)

    def _is_small(self, s: _State, tolerance: float) -> bool:
        """Whether the residual is within the tolerance, or its round-off."""
        pressing = np.abs(self.problem.N.T @ s.p).max(initial=0.0)
        scale = max(float(np.abs(self.g).max()), float(pressing))
        if self.residual <= tolerance * scale:
            return True
        if self.residual > 1e-6 * scale:
            return False
        problem, size = self.problem, np.abs(s.v)
        B, N = np.abs(problem.B), np.abs(problem.N)
        slopes = self.on_rows(self.beta) * (B @ size)
        rubbing = self.on_rows(s.w) * (np.abs(s.sigma) + np.minimum(slopes, 1.0 + slopes))
        pressed = s.over > 0.0
        moved = problem.stiffness * pressed * (N @ size + np.abs(np.where(pressed, self.bound, 0)))
        added = np.abs(problem.H) @ size + B.T @ rubbing + N.T @ moved + np.abs(self.g)
        return bool(self.residual <= SETTINGS.round_off * float(added.max()))

    def _coupled(self, s: _State) -> _State | None:
        """State after a Newton step that has the change of the limits; None if it stalls."""
        J, tangent = self._tangent(s, s.w, coupled=True)
        self.counts["factorizations"] += 1
        try:
            d = linalg.solve(J, -self.left, overwrite_a=True, check_finite=False)
        except linalg.LinAlgError:
            return None
        before, length = float(np.linalg.norm(self.left)), 1.0
        for _ in range(SETTINGS.halvings):
            tried = self._at(s.v + length * d)
            after = float(np.linalg.norm(self._residual(tried, tried.w)))
            if after <= SETTINGS.grows * before:
                self._predict(s, tried, tangent, tried.w)
                self.counts["newton_iterations"] += 1
                return tried
            length *= SETTINGS.shorter
        return None

    def _descended(self, s: _State, w: FloatArray, left: FloatArray) -> _State:
        """State after a step that decreases the convex objective for the limits ``w``."""
        A, tangent = self._tangent(s, w)
        self.counts["factorizations"] += 1
        self.counts["newton_iterations"] += 1
        d = linalg.solve(A, -left, assume_a="pos", check_finite=False)
        slope, value, length = float(left @ d), self._objective(s, w), 1.0
        tried = self._at(s.v + d)
        for _ in range(4 * SETTINGS.halvings):
            along = float(self._residual(tried, w) @ d)
            if self._objective(tried, w) <= value + 1e-4 * length * slope or abs(along) <= 1e-8 * (
                -slope
            ):
                break
            length *= SETTINGS.shorter
            tried = self._at(s.v + length * d)
        self._predict(s, tried, tangent, w)
        return tried

    def _objective(self, s: _State, w: FloatArray) -> float:
        """Value of what is minimised for the limits ``w``, W."""
        problem = self.problem
        size = slip_norms(s.slip, problem.points.directions)
        beta = np.where(self.beta > 0.0, self.beta, 1.0)
        stored = 0.5 * float(s.p @ np.maximum(s.over, 0.0))
        value = float(s.v @ (0.5 * (problem.H @ s.v) - self.g)) + stored
        return value + float(w @ law.potential(size, beta))

    def _tangent(
        self, s: _State, w: FloatArray, coupled: bool = False
    ) -> tuple[FloatArray, tuple[FloatArray, FloatArray]]:
        """Tangent for the limits ``w``, with their change by the normal forces if ``coupled``.

        A point's part across its slip is force over slip; along it, it lies between that and the
        slope of the law as the predicted force lies between zero and the law's. Of each slip row
        the part of its own slip, and that of the slip of the other row of its point, are returned
        too, each (rows,), N s/m.
        """
        problem = self.problem
        size = slip_norms(s.slip, problem.points.directions)
        force, slope = law.force(size, self.beta), law.force_slope(size, self.beta)
        moves = size > 0.0
        across = w * np.where(moves, force / np.where(moves, size, 1.0), slope)
        square = across * size**2
        acting = square > 0.0
        share = np.where(acting, (w * slope - across) / np.where(acting, square, 1.0), 0.0)
        predicted = self.on_rows(w) * s.sigma
        if self.predicted is not None:  # by other limits, maybe: then J would not be definite
            predicted = self._cut(self.predicted, w)
        share, other = share[problem.rows.point], problem.rows.other
        own = across[problem.rows.point] + share * s.slip * predicted
        beside = 0.5 * share * (s.slip * predicted[other] + s.slip[other] * predicted)
        beside *= problem.paired
        gain, left, right = self.change if coupled else self.no_change, problem.left, problem.right
        count = rows_of_tangent(problem.rows, gain, own, beside, s.sigma, w, s.over, left, right)
        return problem.H + left[:count].T @ right[:count], (own, beside)

    def _predict(
        self,
        s: _State,
        after: _State,
        tangent: tuple[FloatArray, FloatArray],
        limits: FloatArray,
    ) -> None:
        """Friction after a step by its tangent, limited to what friction can be."""
        own, beside = tangent
        moved = after.slip - s.slip
        force = (
            self.on_rows(limits) * s.sigma + own * moved + beside * moved[self.problem.rows.other]
        )
        self.predicted = self._cut(force, limits)

    def _cut(self, force: FloatArray, limits: FloatArray) -> FloatArray:
        """Friction forces, (rows,), N, scaled down to limits, (m,), N."""
        size = slip_norms(force, self.problem.points.directions)
        share = np.minimum(1.0, limits / np.where(size > 0.0, size, 1.0))
        return self.on_rows(np.where(size > 0.0, share, 1.0)) * force
