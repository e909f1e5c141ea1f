"""Primal-dual Newton method, for dense problems whose slips depend on each other.

A reduced model has more contact points than unknowns, so that they cannot all stick. Newton's
method runs on the velocity itself, with an exact line search on the strictly convex objective

    1/2 v H v - g v + sum w psi(|B v|).

It is globally convergent for a finite beta, and never failed on reduced models.

Far from v = 0 the arctangent is almost flat, and Newton's method with its slope overshoots. The
secant stiffness sigma(v) / v is never too small, but converges slowly. The tangent used here lies
between them:

    sigma(v) / v + t (sigma'(v) - sigma(v) / v),    t = predicted force / (w sigma(v)),

where the last iteration predicted the friction force of each point by its own tangent, limited to
|force| <= w. Near the solution the prediction is right, t = 1, and this is Newton's tangent; a
prediction of the opposite sign stiffens it. This is the primal-dual Newton method (Chan, Golub and
Mulet, SIAM J. Sci. Comput. 20, 1999). It has the same solution and order of convergence.

Measured on two bolted solids with 44 unknowns, iterations with a new factor and evaluations of
friction for each time step: 11 and 48 with the slope alone, 7.2 and 10 with this tangent, and 9.0
and 12, a tenth faster, if a factor is used again while it reduces the residual tenfold, as here.

Most of the time goes into the tangent B' D B, n^2 rows multiplications. It is added up once in a
step, and after that only for points whose own tangent changed by 2 % or more, which are about half
of them; sums run over tiles of four rows and two columns. Of models for a range of a plate (31
unknowns, 93 points), a bracket (48, 144) and a solid (90, 270), processor time of a step on a busy
machine, us, before and after: 291 and 197 to 237, 634 and 324, 6,381 and 2,541. New factors in a
step stay 9.1, 8.0 and 16. What did not help, tried on steps of the plate and the bracket alone:

- tangents held up to a change of 20 %: more than twice as many factors;
- a factor used again while it reduces the residual to 0.3 or 0.6: 9 to 21 % fewer new factors,
  for a sixth to twice as many evaluations more; no time is saved;
- full steps accepted further beyond the minimum of the line: a sixth of the evaluations less, as
  many factors;
- a law that starts less steep and is made steeper by 10 to 100 in each iteration: between 3 % fewer
  factors and 38 % more;
- Newton's method on Minty's parameter: three times as many iterations and more, some without end;
- a start from the last velocity in place of the extrapolated one: half an iteration more.

Set-valued Coulomb friction, for quasi-static increments, is the limit of ever steeper laws.

Contact that opens adds a term of the approaches N v of pressure points, with a stiffness k,

    sum k / 2 max(N v - bound, 0)^2,

since they cannot all rest on their bounds either. Its slopes are the normal forces p, and friction
limits follow them, w = max(0, given + gain p). Problems with constant limits, with limits that
follow in each evaluation, and with limits that are kept run through one loop, that of `dense_loop`.

Where limits follow the tangent has the change of the friction F of each slip row by its limit,

    H + B' D B + sum_c k_c (N_c + sum_f gain_fc B_f' dF_f/dw_f) N_c,    dF/dw = sigma (1 - soft d),

over the pressure points c that are pressed, which is not symmetric; d is the slope of the law with
its spring, so that friction of a slider that sticks does not change. There is no objective for a
line search: steps are shortened where the residual grows much. Where that iteration stalls, limits
are kept until the convex problem for them is solved, and then renewed by Anderson's acceleration.
What does not balance with the limits of its own normal forces is not returned as converged.
"""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np
from scipy import sparse

from skfem_joint.ground.arrays import FloatArray, as_dense, slip_norms
from skfem_joint.ground.errors import InputError
from skfem_joint.linalg.factors import factorised
from skfem_joint.linalg.kernels import Full
from skfem_joint.minimise.dense_loop import (
    Dense,
    DenseWorkspace,
    dense_workspace,
    minimise_dense,
    rows_of,
)
from skfem_joint.minimise.dense_pressures import PATIENCE, keep_limits, pressure_rows
from skfem_joint.minimise.limits import Renewal
from skfem_joint.minimise.linearisation import RowLinearisation
from skfem_joint.minimise.problem import (
    CompiledStepProblem,
    ContactPoints,
    Minimum,
    Pressed,
    StepOutcome,
)


class PrimalDualNewton(CompiledStepProblem):
    """The primal-dual Newton method, see the module, `StepProblem` and `CompiledStepProblem`.

    Parameters
    ----------
    H : ndarray, shape (n, n), or Full
        Symmetric positive definite.
    points : ContactPoints
        Any slip rows.
    workspace : DenseWorkspace, optional
        Shared with problems of other matrices; made if not given.
    """

    factorizations = 1
    remembered = ("old_velocity", "old_force", "predicted")

    def __init__(
        self, H: Any, points: ContactPoints, workspace: DenseWorkspace | None = None
    ) -> None:
        self.H: FloatArray = H.entries if isinstance(H, Full) else as_dense(H)
        self.points = points
        self.contact, self.places = rows_of(points)
        self.limits = self.contact.w
        n, rows = len(self.H), self.limits.size
        space = dense_workspace(n, rows, points.w.size) if workspace is None else workspace
        self.workspace = space
        self.kernel: Any = Dense(self.H, self.contact)
        if points.normal is not None:
            if np.isinf(points.normal.stiffness).any():
                raise InputError(
                    "contact that opens: found a rigid pressure point in a reduced or dense model, "
                    "whose unknowns are no slips and approaches, must have a finite stiffness at "
                    "each of them; sj.reduce gives it one"
                )
            self._follows = np.diff(sparse.csr_array(points.normal.gain).indptr) > 0
            self._sprung = points.has_spring
            self.normal = pressure_rows(points, self.places)
            q = self.normal.bound.size
            self._presses = np.repeat(np.arange(q), np.diff(self.normal.point_start))
            self._gains = self.normal.gain.copy(), self.normal.point_gain.copy()
            self.kernel = Dense(self.H, self.contact, self.normal, True)
            self.kept = Dense(self.H, self.contact, self.normal)
        self.steps_per_second = max(1, 10_000_000 // (max(rows, 1) * n**2))
        self._own = self.contact.beta.copy()
        self._stuck: tuple[Any, float] | None = None

    def linearisation(self, beta: FloatArray | None = None) -> RowLinearisation:
        """See `LinearisedProblem`."""
        return RowLinearisation(self.H, self.points.with_beta(beta))

    def with_matrix(self, H: Any, points: ContactPoints | None = None) -> PrimalDualNewton:
        """See `CompiledStepProblem`."""
        return PrimalDualNewton(H, self.points if points is None else points, self.workspace)

    def restart(self, v: FloatArray, sigma: FloatArray) -> None:
        """See `CompiledStepProblem`: nothing is extrapolated."""
        space = self.workspace
        space.old_velocity[:], space.old_force[:] = v, sigma
        space.predicted[:] = self.limits * sigma

    def compile(self) -> None:
        """See `StepProblem`; values kept for later steps do not change."""
        none = np.zeros(len(self.H))
        PrimalDualNewton(self.H, self.points)._minimise(none, none, 1.0)

    def minimise(
        self,
        g: FloatArray,
        start: FloatArray | None = None,
        tolerance: float = 1e-11,
        beta: FloatArray | None = None,
        offset: FloatArray | None = None,
        pressed: Pressed | None = None,
    ) -> Minimum:
        """See `StepProblem`; Coulomb friction is approached by ever steeper laws.

        The steepness of each law follows from the largest slip under the law before. Points with
        springs have their own law: their forces are smooth enough.
        """
        if pressed is not None:
            law = self.points.beta if beta is None else np.asarray(beta, dtype=float)
            return self._with_pressures(g, start, tolerance, law, offset, pressed)
        law = np.where(self.points.w > 0.0, self.points.beta if beta is None else beta, 0.0)
        coulomb = np.isinf(law) & ~self.points.has_spring
        # Else from the solution with springs at all points in place of friction.
        v = np.asarray(self._stiff()[0](g)) if start is None else start
        self.workspace.offset[self.places.row] = 0.0 if offset is None else offset
        if not coulomb.any():
            return self._with_law(law, g, v, tolerance)
        minimum = Minimum(v, np.zeros(self.limits.size), False)
        # Beta times the largest slip, of the laws in turn.
        for steepness in (1e2, 1e4, 1e6):
            slip = slip_norms(self.points.B @ v, self.points.directions).max()
            most = self._stiff()[1]
            steep = min(steepness / slip, most) if slip > 0.0 else most
            minimum = self._with_law(np.where(coulomb, steep, law), g, v, tolerance)
            v = minimum.v
            if not minimum.converged:
                break
        return minimum

    def _with_law(
        self, law: FloatArray, g: FloatArray, start: FloatArray, tolerance: float
    ) -> Minimum:
        """Minimise for finite values of beta of the points, (m,)."""
        self.contact.beta[self.places.point] = law
        outcome = self._minimise(g, start, tolerance)
        self.contact.beta[:] = self._own
        space = self.workspace
        return Minimum.of(outcome, space.velocity, space.force[self.places.row], self.points)

    def _minimise(
        self, g: FloatArray, start: FloatArray, tolerance: float, kernel: Any = None
    ) -> StepOutcome:
        v = np.array(start)
        self.workspace.old_velocity[:] = v  # the start is not extrapolated
        outcome: StepOutcome = minimise_dense(
            self.kernel if kernel is None else kernel,
            self.workspace,
            np.ascontiguousarray(g),
            v,
            tolerance,
        )
        return outcome

    def _with_pressures(
        self,
        g: FloatArray,
        start: FloatArray | None,
        tolerance: float,
        law: FloatArray,
        offset: FloatArray | None,
        pressed: Pressed,
    ) -> Minimum:
        """Minimise with contact that opens."""
        normal, places, space = self.normal, self.places, self.workspace
        self.press(law, offset, pressed)
        work: Counter[str] = Counter()
        outcome = self._follow(g, np.zeros(g.size) if start is None else start, tolerance, work)
        if not outcome.converged and np.isfinite(outcome.residual):
            outcome = self._renew(g, tolerance, outcome.residual, work)
        return Minimum(
            space.velocity.copy(),
            space.force[places.row],
            bool(outcome.converged),
            dict(work),
            float(outcome.residual),
            int(outcome.unknown),
            normal.p.copy(),
            self.contact.w[places.point],
        )

    def press(self, law: FloatArray, offset: FloatArray | None, pressed: Pressed) -> None:
        """Set the laws, offsets, bounds and limits of minimisations where contact opens."""
        normal, places = self.normal, self.places
        rubs = (pressed.given > 0.0) | self._follows
        if np.isinf(law[rubs & ~self._sprung]).any():
            raise InputError(
                "contact that opens: set-valued Coulomb friction (beta = inf) needs one unknown "
                "for each slip, which a reduced model has not; use System.no_steeper"
            )
        law = np.where(rubs, law, 0.0)
        self.workspace.offset[places.row] = 0.0 if offset is None else offset
        normal.bound[:] = pressed.bound
        normal.given[places.point], normal.steep[places.point] = pressed.given, law
        self.contact.beta[places.point] = law
        factors = np.full(normal.bound.size, pressed.gain)
        normal.gain[:] = self._gains[0] * factors[normal.column]
        normal.point_gain[:] = self._gains[1] * factors[self._presses]
        if self.contact.soft.size:  # a force of springs to compare with
            keep_limits(self.contact, normal, self.points.w[np.argsort(places.point)])

    def rescue(self, g: FloatArray, v: FloatArray, tolerance: float) -> dict[str, int]:
        """See `CompiledStepProblem`: where contact opens, by limits that are kept for a while."""
        space, work = self.workspace, Counter[str]()
        kept = {name: getattr(space, name).copy() for name in self.remembered}
        if self.points.normal is None:
            return {}
        outcome = self._follow(g, space.velocity.copy(), tolerance, work, 0)
        if np.isfinite(outcome.residual):
            outcome = self._renew(g, tolerance, outcome.residual, work)
        self.restore(kept)
        if not outcome.converged:
            return {}
        space.old_velocity[:] = 2.0 * v - space.velocity
        return dict(work)

    def _follow(
        self,
        g: FloatArray,
        start: FloatArray,
        tolerance: float,
        work: Counter[str],
        patience: int | None = None,
    ) -> StepOutcome:
        """Iterate with limits that follow the normal forces, see `_stalls`.

        A ``patience`` of 0 finds out what the start is worth.
        """
        if patience is not None:
            self.normal.watch[:] = 0.0, PATIENCE - patience, 0.0
        return self._counted(self.kernel, g, start, tolerance, work)

    def _renew(
        self, g: FloatArray, tolerance: float, mark: float, work: Counter[str]
    ) -> StepOutcome:
        """Solve for limits that are kept, and renew these, until they are those of their forces."""
        contact, normal, space = self.contact, self.normal, self.workspace
        m = normal.given.size
        renewal, v, residual = Renewal(), space.velocity.copy(), mark
        outcome = self._follow(g, v, tolerance, work, 0)
        limits = contact.w[:m].copy()
        for _ in range(100):  # renewals of kept limits at most
            if outcome.converged or not np.isfinite(outcome.residual):
                break
            keep_limits(contact, normal, limits)
            normal.watch[2] = 0.1 * residual  # to which the problem of kept limits is solved
            self._counted(self.kept, g, v, tolerance, work)
            work["renewed_limits"] += 1
            v = space.velocity.copy()
            outcome = self._follow(g, v, tolerance, work, 0)
            residual, image = outcome.residual, contact.w[:m].copy()
            if not outcome.converged and residual <= 0.1 * mark:
                outcome, mark = self._follow(g, v, tolerance, work), residual
            limits = renewal.next(limits, image)
        return outcome

    def _counted(
        self, kernel: Any, g: FloatArray, start: FloatArray, tolerance: float, work: Counter[str]
    ) -> StepOutcome:
        """Minimise and count."""
        outcome = self._minimise(g, start, tolerance, kernel)
        for name in ("newton_iterations", "friction_evaluations"):
            work[name] += int(getattr(outcome, name))
        work["factorizations"] += int(outcome.newton_iterations)
        return outcome

    def _stiff(self) -> tuple[Any, float]:
        """Solver with springs at all points in place of friction, and the steepest law."""
        if self._stuck is None:
            B = as_dense(self.points.B)
            springs = (B.T * self.points.on_rows(self.points.w)) @ B
            # No slip is seen where all sticks in the states that a model is made of.
            unit = np.trace(self.H) / (np.trace(springs) or 1.0)
            stuck = self.H + unit * springs
            least = np.linalg.eigvalsh(stuck)[0]
            # Round-off would hide the structure's least stiffness if the law were steeper.
            steepest = 1e12 * unit * least / np.trace(self.H)
            self._stuck = factorised(stuck), float(steepest)
        return self._stuck
