"""Steps with contact that opens and closes.

The normal force of a rigid pressure point acts as an impulse of each step, and what is required of
the point is required of its velocity. Let g be its gap at the start of a step, and s v1 + (known
part) the change of its approach over the step, N (u1 - u0), which is linear in the velocity v1 at
its end. Then

    N v1 <= max(0, (max(g, 0) - known part) / s),       m >= 0,      complementary,

with the mean force m over the step. A point that is closed stays closed at rest; one that closes in
the step ends at the other face, or is stopped where it would not stop before it. Where m > 0 the
approach does not decrease in the step, so that the work of the normal forces on the structure,
-m N (u1 - u0), is never positive: contact cannot create energy, for any step and any rho_infinity.
What is lost where faces meet is summed up as the work of impacts. The constraint in displacements
at the end of a step, with the force there, creates energy (Laursen and Chawla, Int. J. Numer. Meth.
Eng. 40, 1997); so does a force at the end that must not be negative, in place of the mean.

The scheme's force at the end of a step, lambda, and the mean force are related by the recursion of
its auxiliary acceleration, (alpha): lambda may alternate where m is smooth. Forces in results are
m. Friction limits at the end of a step come from m extrapolated there by half a step, so that they
are of second order.

Points with a stiffness carry an elastic force at the end of each step, as the structure does.
Springs in series with friction keep their force from step to step, which sigma times the limit is.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from skfem_joint.arrays import FloatArray, as_dense, check_like
from skfem_joint.linalg.compressed import as_compressed
from skfem_joint.minimise.opening_dense import OpeningDense
from skfem_joint.minimise.opening_newton import OpeningMinimum, OpeningNewton
from skfem_joint.minimise.opening_springs import OpeningOnSprings
from skfem_joint.minimise.problem import ContactPoints
from skfem_joint.minimise.touching import Touching
from skfem_joint.opening import OpeningContact
from skfem_joint.stepping.schemes import Coefficients, State
from skfem_joint.stepping.steppers import FailedStep, PythonStepper, Saved

#: Gaps below this share of the largest displacement or gap are closed.
CLOSED = 64 * float(np.finfo(np.float64).eps)
#: Limit of a point that cannot carry friction in a minimisation.
NEVER_RUBS = -1e300


class NormalState(NamedTuple):
    """Normal forces between two steps, N, each of shape (q,).

    Attributes
    ----------
    end : ndarray
        Force in the equation of motion now, which may alternate from step to step.
    filtered : ndarray
        What the scheme's auxiliary acceleration has of it.
    mean : ndarray
        Mean force over the last step; of points with a stiffness the force now.
    """

    end: FloatArray
    filtered: FloatArray
    mean: FloatArray


class OpeningStepper(PythonStepper):
    """Steps of a system with contact that opens, see the module.

    Attributes
    ----------
    normal : NormalState
    limits : ndarray, shape (m,)
        Friction limits now, N.
    """

    COUNTS = (*PythonStepper.COUNTS, "renewed_limits")

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        contact = cast("OpeningContact", self.system.opening)
        self.contact = contact
        self.rigid = contact.rigid
        self.normal = NormalState(*np.repeat(contact.force[None], 3, axis=0))
        self.limits = np.array(self.system.w)
        self.constant = self.system.w - contact.limits_at_rest
        self._at_rest: OpeningNewton | OpeningDense | OpeningOnSprings | None = None
        self.touching = Touching(contact.force > 0.0)

    def new_problem(self, c: Coefficients) -> Any:
        """See `Stepper`."""
        s = self.system
        H, springs = c.c_M * s.M + s.C + c.c_K * s.K, c.c_K * s.spring_constants
        return self._problem(H, self.contact.stiffness * c.c_K, self.of_step(c), springs)

    def _problem(
        self, H: Any, stiffness: FloatArray, points: ContactPoints, springs: FloatArray
    ) -> OpeningNewton | OpeningDense | OpeningOnSprings:
        """Problem of a matrix, with the stiffness of pressure points and of springs, (m,)."""
        contact = self.contact
        if isinstance(contact.N, np.ndarray):
            return OpeningDense(H, points, contact.N, contact.gain, stiffness)
        H = as_dense(H) if isinstance(H, np.ndarray) else as_compressed(H)
        given = H, points, contact.N, contact.gain, stiffness
        if not self.system.has_springs:
            return OpeningNewton(*given)
        return OpeningOnSprings(*given, self.system.on_rows(springs))

    @property
    def limits_now(self) -> FloatArray:
        """See `Stepper`."""
        return self.limits

    def set_limits(self, limits: FloatArray) -> None:
        """See `Stepper`."""
        self.limits = np.array(limits)

    def restart(self, amplitudes: FloatArray) -> bool:
        """Make acceleration and normal forces consistent with the loads now."""
        s, contact, (u, v) = self.system, self.contact, self.now[:2]
        if not self.rigid.any():  # else forces are not known before the first step
            self.limits = np.maximum(self.constant + contact.gain @ contact.elastic_forces(u), 0.0)
        slip = s.B @ v
        moving = s.slip_norm(slip) > 0.0
        right = self.recorder.vectors @ amplitudes - s.C @ v - s.K @ u
        right += contact.N.T @ (contact.force - contact.elastic_forces(u))
        sigma = np.zeros(slip.size)
        given = self.constant.copy()
        free = moving | np.isfinite(s.beta) | s.sprung
        if free.any():
            from skfem_joint.minimise.law import force_vectors

            rubbing = s.on_rows(np.where(free & (self.limits > 0.0), 1.0, 0.0))
            sigma = np.asarray(force_vectors(slip, s.beta, s.directions)) * rubbing
            sigma = np.where(s.on_rows(s.sprung), self.now.sigma, sigma)  # springs do not jump
            right = right - s.B.T @ (s.on_rows(self.limits) * sigma)
            given[free] = NEVER_RUBS
        closed = self.rigid & (self._gaps(u) <= 0.0) & (contact.N @ v >= 0.0)
        if self._at_rest is None:
            soft = np.where(self.rigid, np.inf, 1e-300)
            # Sliders without friction follow: their springs, of whatever stiffness, are forceless.
            springs = np.where(s.sprung, float(s.M.diagonal().mean()), 0.0)
            self._at_rest = self._problem(s.M, soft, self.points, springs)
        bound = np.where(closed, 0.0, np.inf)
        minimum = self._at_rest.minimise(right, bound, given, 1.0, None, self.tolerance)
        if not minimum.converged:
            self.failure = FailedStep(minimum.residual, minimum.where)
            return False
        # Sliding points have the friction of their law, not that of an acceleration besides.
        minimum = replace(minimum, sigma=np.where(s.on_rows(free), 0.0, minimum.sigma))
        p = np.where(self.rigid, minimum.p, contact.elastic_forces(u))
        self.normal = NormalState(p, p.copy(), p.copy())
        self.limits = np.where(free, self.limits, minimum.w)
        self.started(minimum.v, sigma + minimum.sigma)
        return True

    def _gaps(self, u: FloatArray) -> FloatArray:
        """Gap of each pressure point, m; what is round-off counts as closed."""
        gap = self.contact.gaps(u)
        scale = max(float(self.contact.gap.max(initial=0.0)), float(np.abs(u).max(initial=0.0)))
        gap[np.abs(gap) <= CLOSED * scale] = 0.0
        return gap

    @property
    def beside(self) -> FloatArray:
        """Normal forces and friction limits, N, in a row."""
        return np.concatenate([*self.normal, self.limits])

    def go_on(self, now: State, beside: FloatArray) -> None:
        """See `Stepper`; mean forces and limits that a mixture makes negative are none."""
        end, filtered, mean, limits = np.split(beside, np.arange(1, 4) * self.rigid.size)
        self.normal = NormalState(end.copy(), filtered.copy(), np.maximum(mean, 0.0))
        self.limits = np.maximum(limits, 0.0)
        self.now, self.v_before = now, now.v

    def store_start(self) -> None:
        """Store the normal forces of the start."""
        self.recorder.store_normal(0, self.normal.mean)

    def prepare(self, h: float) -> None:
        """Prepare what steps of ``h`` need; after :meth:`restart`."""
        self.problem(self.coefficients(h))

    def advance(self, h: float, amplitudes: FloatArray, first_step: int, store: bool) -> int:
        """Do the steps."""
        c, recorder, done = self.coefficients(h), self.recorder, 0
        for ends in pairwise(amplitudes.T):
            before, normal, limits = self.now, self.normal, self.limits
            minimum = self._step(c, ends[1])
            if minimum is None:
                break
            self.v_before = before.v
            recorder.add_step(h, ends, before, self.now, c.trapezoidal, (limits, self.limits))
            self._add_normal_work(before, normal)
            done += 1
            self.frequency = 0.0
            if store:
                recorder.store(first_step + done, self.now, self.limits)
                recorder.store_normal(first_step + done, self.normal.mean)
        return done

    def _step(self, c: Coefficients, amplitudes: FloatArray) -> OpeningMinimum | None:
        """Do one step; None, and nothing changed, if it does not converge."""
        s, contact = self.system, self.contact
        problem = cast("OpeningNewton | OpeningDense | OpeningOnSprings", self.problem(c))
        u, v, a, d, _ = self.now
        predictor = u + c.u_v * v + c.u_a * a
        right = self.recorder.vectors @ amplitudes - s.K @ predictor
        right += s.M @ (c.c_M * v + c.y_a * a + c.y_d * d)
        # Mean force over the step: m = (share of the force at its end) + (rest).
        share, rest = self._mean_of_step(c)
        lowest = np.where(self.rigid, -rest / share, 0.0)
        right += contact.N.T @ (contact.force - lowest)
        bound = self._bounds(c, predictor, u)
        extrapolated = np.where(self.rigid, 1.5 * share, 1.0)
        given = self.constant - contact.gain @ np.where(self.rigid, 0.5 * self.normal.mean, 0.0)
        held = {"held": self._held(predictor - u)} if s.has_springs else {}
        minimum = problem.minimise(
            right, bound, given, extrapolated, 2.0 * v - self.v_before, self.tolerance,
            touching=self.touching, **held,
        )  # fmt: skip
        self._count(minimum.counts)
        if not minimum.converged:
            self.failure = FailedStep(minimum.residual, minimum.where)
            return None
        self.touching.follow(minimum.p)
        end = lowest + minimum.p
        filtered = (end - c.d_a0 * self.normal.filtered - c.d_d0 * self.normal.end) / c.d_a
        mean = np.where(self.rigid, share * minimum.p, end)
        self.normal = NormalState(end, filtered, mean)
        self.limits = minimum.w
        v_new = minimum.v
        a_new = c.a_v * (v_new - v) + c.a_a * a
        d_new = c.d_a * a_new + c.d_a0 * a + c.d_d0 * d
        self.now = State(predictor + c.c_K * v_new, v_new, a_new, d_new, minimum.sigma)
        return minimum

    def _held(self, known: FloatArray) -> FloatArray:
        """Forces of springs, (rows,), N, after a known displacement (n,), if no slider slips."""
        s = self.system
        springs = s.on_rows(s.spring_constants)
        before = np.where(springs > 0.0, s.on_rows(self.limits) * self.now.sigma, 0.0)
        return np.asarray(before + springs * (s.B @ known))

    def _mean_of_step(self, c: Coefficients) -> tuple[float, FloatArray]:
        """Share of the end's force in the mean force over a step, and what earlier forces give."""
        normal, width = self.normal, c.a_v * c.h
        earlier = -(c.d_a0 * normal.filtered + c.d_d0 * normal.end) / c.d_a
        return 1.0 / (c.d_a * width), (earlier - c.a_a * normal.filtered) / width

    def _bounds(self, c: Coefficients, predictor: FloatArray, u: FloatArray) -> FloatArray:
        """Largest velocity of approach of each pressure point at the end of a step, m/s.

        Of points with a stiffness the velocity at which they begin to carry force.
        """
        contact = self.contact
        known = np.asarray(contact.N @ (predictor - u))
        bound = np.maximum(0.0, (np.maximum(self._gaps(u), 0.0) - known) / c.c_K)
        soft = ~self.rigid
        if soft.any():
            apart = contact.gap - contact.force / contact.stiffness - contact.N @ predictor
            bound[soft] = apart[soft] / c.c_K
        return np.asarray(bound)

    def _add_normal_work(self, before: State, normal: NormalState) -> None:
        """Add the work that impacts take; a rest that belongs to the scheme goes to its own row."""
        moved = np.asarray(self.contact.N @ (self.now.u - before.u))
        rigid = self.rigid
        lost = float(self.normal.mean[rigid] @ moved[rigid])
        trapezoidal = float((0.5 * (normal.end + self.normal.end)) @ moved)
        stored = self.contact.potential(self.now.u) - self.contact.potential(before.u)
        stored += float(self.contact.force @ moved)  # of elastic points alone
        self.recorder.impact_work += lost
        self.recorder.dissipated[1] += trapezoidal - lost - stored
        # Approaches of closed points are zero but for the round-off of the displacements.
        round_off = 1e-9 * float(np.abs(self.now.u - before.u).max())
        if lost < -round_off * float(self.normal.mean[rigid].sum()):
            raise ArithmeticError(
                f"contact that opens: its normal forces did a work of {-lost:.3g} J in a step"
            )

    def saved(self) -> dict[str, NDArray[Any]]:
        """All that steps depend on; problems keep nothing from step to step."""
        return self._own()

    def _own(self) -> dict[str, NDArray[Any]]:
        own = {"normal": np.array(self.normal), "limits": np.array(self.limits)}
        return super()._own() | own | self.touching.saved()

    def check(self, saved: Saved) -> None:
        """See `Stepper`."""
        steps = saved.get("steps")
        if steps is None:
            raise ValueError("stepper/steps is missing")
        check_like(dict(saved), self._own() | {"steps": steps}, "stepper")

    def restore(self, saved: Saved) -> None:
        """Take up a saved state."""
        self.now = State._make([*map(np.array, saved["state"]), np.array(saved["sigma"])])
        self.frequency = float(saved["frequency"])
        for row in saved["steps"].tolist():
            self.problem(Coefficients._make([*row[:-1], bool(row[-1])]))
        self.counts = dict(zip(self.counts, saved["counts"].tolist(), strict=True))
        self.v_before = np.array(saved["before"])
        self.normal = NormalState(*map(np.array, saved["normal"]))
        self.limits = np.array(saved["limits"])
        self.touching.restore(saved)
