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

The scheme's force at the end of a step and the mean force are related by the recursion of its
auxiliary acceleration, (alpha): the force at the end may alternate where m is smooth. Forces in
results are m.

Friction follows forces that are smooth in time, and impacts. Of the forces x = G m now and x0 in
the step before it has the limit at the end of a step

    w1 = given + x/2 + max(0, x - x0/2) - max(0, x - 2 x0)/2,

which extrapolates m by half a step where forces are smooth, so that friction is of second order,
and is x itself where x0 is nothing. What exceeds the double of the force before is an impact. The
mean friction over the step is an impulse, as that of the normal force,

    f = mean of the smooth friction, w sigma, at both ends + max(0, x - 2 x0) sigma1,

in which sigma1 belongs to the velocity after it (Moreau). At the end of the step the first part has
w1 without the impact, and at its start no more than four times as much, so that where contact opens
friction ends as well. So a point that slips through an impact loses the momentum along that Coulomb
says, for any step. As for normal forces, the force at the end of the step follows from the mean,
and may alternate: none of the friction of an impact acts once more after it.

All this is continuous in x, and f does not see forces m that alternate from step to step. With
(given + x) mean(sigma) or (given + x) sigma1 for f, sliding points shake from step to step: a block
with 40 steps a period, which settles to 1e-6 as it is, kept changing by 1 to 3 %, its friction
energy by 5 %. With the limit at the end for all of f, friction in impacts was 1.5 times that of
Coulomb.

A spring in series with friction takes up no impulse: its slider has the limit w1 at the end of each
step. Springs keep their force from step to step, which sigma times the limit is.

Points with a stiffness carry an elastic force at the end of each step, as the structure does, and
friction has its limit from that force: they have no impacts.

A stepper calls `NormalForces.before` for the right side and the bounds of a step, `after` with what
was found, and `works` for its energies. The symbols above are, in the code:

    g, N        `part.gaps(u)`, `part.N`                G    `gain`
    s           `c.c_K`                                 m    `normal.mean`
    known part  N (`predictor` - u), in `_bounds`       x    `_pressing()`; x0 is its value `before`
    w1          `limits`                                f    `friction.mean`
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from skfem_joint.ground.arrays import FloatArray
from skfem_joint.linalg.compressed import as_compressed
from skfem_joint.minimise.limits import Hinges
from skfem_joint.minimise.problem import (
    ContactPoints,
    Minimum,
    Places,
    Pressed,
    PressurePoints,
    StepProblem,
)
from skfem_joint.minimise.touching import Touching
from skfem_joint.stepping.loop_contact import Opening
from skfem_joint.stepping.recording import Recorder
from skfem_joint.stepping.schemes import Coefficients, State
from skfem_joint.system.system import System

if TYPE_CHECKING:
    from skfem_joint.minimise.primal_dual_newton import PrimalDualNewton

Saved = Mapping[str, NDArray[Any]]

#: Gaps below this share of the largest displacement or gap are closed.
CLOSED = 64 * float(np.finfo(np.float64).eps)
#: Most times that limits of points in motion follow the normal forces at a start.
RENEWALS = 50
#: Change of these limits, over the largest, that ends it.
RENEWED = 1e-9
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


class FrictionState(NamedTuple):
    """Friction between two steps, N, each of shape (rows,).

    Attributes
    ----------
    end, filtered : ndarray
        Force in the equation of motion now, which may alternate from step to step, and what the
        auxiliary acceleration has of it.
    smooth, smooth_filtered : ndarray
        The same of sigma times the limit.
    mean : ndarray
        Mean force over the last step; where it is no impulse the force now.
    """

    end: FloatArray
    filtered: FloatArray
    smooth: FloatArray
    smooth_filtered: FloatArray
    mean: FloatArray

    @classmethod
    def at(cls, force: FloatArray) -> FrictionState:
        """State of a constant force (rows,), N."""
        return cls(*np.repeat(force[None], 5, axis=0))


class NormalForces:
    """Normal forces from step to step, and friction that follows them, see the module.

    It is what `skfem_joint.stepping.stepper.ConstantForces` is where contact does not open.

    Attributes
    ----------
    part : NormalPart
        Pressure points of the system.
    normal : NormalState
    friction : FrictionState
    limits : ndarray, shape (m,)
        Friction limits now, N, w1 in the module.
    """

    def __init__(self, system: System) -> None:
        self.system, self.part = system, system.contact.normal
        contact = self.part
        self.rigid = contact.rigid
        self.normal = NormalState(*np.repeat(contact.force[None], 3, axis=0))
        self.limits = np.array(system.contact.w)
        self.gain = sparse.csr_array(system.contact.gain)
        # Points that rigid contact presses, whose friction is an impulse unless they have springs.
        follows = (self.gain != 0.0) @ self.rigid
        self.sprung = follows & system.contact.sprung
        self.impulsive = follows & ~system.contact.sprung
        self.impulsive_rows = system.contact.on_rows(self.impulsive)
        self.has_impulses = bool(self.rigid.any())
        self.friction = FrictionState.at(np.zeros(system.contact.B.shape[0]))
        self.touching = Touching(contact.force > 0.0)
        # Transposes, which scipy would make anew in each step.
        rows = contact.N, system.contact.B
        self._faces, self._slips = (as_compressed(A.T) for A in rows)
        # Of the step that is done: mean forces before it, and what its end and works need.
        self._last = self.normal, self.friction
        self._known = self._lowest = np.zeros(0)
        self._hinges_now: Hinges | None = None
        self._of_mass: StepProblem | None = None

    def restart(
        self, now: State, loads: FloatArray, tolerance: float, made: Callable[..., StepProblem]
    ) -> Minimum:
        """Acceleration and friction over its limit that are consistent with the ``loads``, (n,), N.

        ``made`` makes the problem of a matrix and contact points.
        """
        s, contact, (u, v) = self.system, self.part, now[:2]
        on_rows = s.contact.on_rows
        if not self.has_impulses:  # else forces are not known before the first step
            self.limits = s.contact.limits(contact.elastic_forces(u))
        slip = s.contact.B @ v
        moving = s.contact.slip_norm(slip) > 0.0
        right = loads - s.C @ v - s.K @ u
        right += contact.N.T @ (contact.force - contact.elastic_forces(u))
        sigma, given = np.zeros(slip.size), s.contact.given.copy()
        free = moving | np.isfinite(s.contact.beta) | s.contact.sprung
        if free.any():
            from skfem_joint.minimise.law import force_vectors

            law = s.contact.beta, s.contact.directions
            sigma = np.asarray(force_vectors(slip, *law)) * on_rows(free)
            sigma = np.where(on_rows(s.contact.sprung), now.sigma, sigma)  # do not jump
            given[free] = NEVER_RUBS
        closed = self.rigid & (self._gaps(u) <= 0.0) & (contact.N @ v >= 0.0)
        pressed = Pressed(np.where(closed, 0.0, np.inf), given)
        problem, limits = self._still(made), self.limits
        for _ in range(RENEWALS):
            own = right - s.contact.B.T @ (on_rows(limits) * sigma)
            minimum = problem.minimise(own, None, tolerance, pressed=pressed)
            if not minimum.converged:
                return minimum
            p = np.where(self.rigid, minimum.p, contact.elastic_forces(u))
            before, follow = limits, s.contact.given + self.gain @ p
            limits = np.where(free, np.where(s.contact.sprung, before, follow), minimum.w)
            change = np.where(free, np.abs(limits - before), 0.0)
            if change.max(initial=0.0) <= RENEWED * limits.max(initial=0.0):
                break
        else:
            return replace(minimum, converged=False, residual=float(change.max()))
        self.normal, self.limits = NormalState(p, p.copy(), p.copy()), limits
        # Sliding points have the friction of their law, not that of an acceleration besides.
        sigma = np.where(on_rows(free), sigma, minimum.sigma) * on_rows(limits > 0.0)
        self.friction = FrictionState.at(on_rows(limits) * sigma)
        return replace(minimum, sigma=sigma)

    def _still(self, made: Callable[..., StepProblem]) -> StepProblem:
        """Problem of an acceleration; elastic pressure points have known forces in it."""
        if self._of_mass is None:
            points = ContactPoints.of(self.system)
            normal = cast("PressurePoints", points.normal)
            normal = replace(normal, stiffness=np.where(self.rigid, np.inf, 1e-300))
            points = replace(points, normal=normal)
            if self.system.contact.has_springs:
                # Sliders without friction follow: springs of any stiffness are forceless then.
                unit = 1.0 / float(self.system.M.diagonal().mean())
                points = replace(points, flexible=np.where(self.system.contact.sprung, unit, 0.0))
            self._of_mass = made(self.system.M, points)
        return self._of_mass

    def _gaps(self, u: FloatArray) -> FloatArray:
        """Gap of each pressure point, m; what is round-off counts as closed."""
        gap = self.part.gaps(u)
        scale = max(float(self.part.gap.max(initial=0.0)), float(np.abs(u).max(initial=0.0)))
        gap[np.abs(gap) <= CLOSED * scale] = 0.0
        return gap

    def before(
        self, c: Coefficients, u: FloatArray, predictor: FloatArray
    ) -> tuple[FloatArray, Pressed]:
        """What a step from displacements ``u`` has of contact.

        Returns
        -------
        right : ndarray, shape (n,)
            Forces on its right side, N.
        pressed : Pressed
            See `StepProblem.minimise`.
        """
        contact, share = self.part, _share(c)
        # Mean force over the step: m = (share of the force at its end) + (rest).
        rest = _rest(c, self.normal.end, self.normal.filtered)
        self._lowest = np.where(self.rigid, -rest / share, 0.0)
        right = self._faces @ (contact.force - self._lowest)
        self._known = -_rest(c, self.friction.end, self.friction.filtered) / share
        bound, given = self._bounds(c, predictor, u), self.system.contact.given
        if not self.has_impulses:
            return right, Pressed(bound, given, 1.0, None, self.touching)
        right -= self._slips @ np.where(self.impulsive_rows, self._known, 0.0)
        self._hinges_now = self._hinges(c, self._pressing())
        factors = np.where(self.rigid, share, 1.0)
        return right, Pressed(bound, given, factors, self._hinges_now, self.touching)

    def after(self, c: Coefficients, minimum: Minimum) -> None:
        """Take over the forces of a step that was found."""
        self._last, before = (self.normal, self.friction), self._pressing()
        self.touching.follow(minimum.p)
        end = self._lowest + minimum.p
        filtered = _filtered(c, end, *self.normal[:2])
        self.normal = NormalState(end, filtered, np.where(self.rigid, _share(c) * minimum.p, end))
        self._take_over_friction(c, minimum, before)

    def works(self, recorder: Recorder, before: State, now: State) -> dict[str, Any]:
        """Add what the scheme and impacts take in the last step; returns its friction and limits.

        They are arguments of `Recorder.add_step`.
        """
        normal, friction = self._last
        if self.has_impulses:
            self._add_scheme_work(recorder, before, now, friction)
        self._add_normal_work(recorder, before, now, normal)
        mean = self.friction.mean
        forces = np.where(self.impulsive_rows, mean, friction.mean), mean
        return {"forces": forces, "limits": self.limits}

    def store(self, recorder: Recorder, row: int) -> None:
        """Store the normal forces."""
        recorder.store_normal(row, self.normal.mean)

    @property
    def beside(self) -> FloatArray:
        """Normal forces, friction and friction limits in a row."""
        return np.concatenate([*self.friction, *self.normal, self.limits])

    def beside_under(self, friction: FloatArray) -> FloatArray:
        """The same with another friction, (rows,), N, that has been constant."""
        return np.concatenate([*FrictionState.at(friction), *self.normal, self.limits])

    def go_on(self, beside: FloatArray) -> None:
        """Go on from such numbers; mean forces and limits that are negative in a mixture are 0."""
        sizes = [part.size for part in (*self.friction, *self.normal)]
        *parts, limits = (part.copy() for part in np.split(beside, np.cumsum(sizes)))
        self.friction = FrictionState(*parts[:5])
        end, filtered, mean = parts[5:]
        self.normal = NormalState(end, filtered, np.maximum(mean, 0.0))
        self.limits = np.maximum(limits, 0.0)

    def _pressing(self) -> FloatArray:
        """What the forces of rigid points, over the last step, give to limits, (m,), N."""
        if not self.has_impulses:
            return np.zeros(self.limits.size)
        return np.asarray(self.gain @ np.where(self.rigid, self.normal.mean, 0.0))

    def _hinges(self, c: Coefficients, before: FloatArray) -> Hinges:
        """How friction follows normal forces in a step after those ``before``, see the module.

        The force at the end is the mean f, without what earlier forces give to it, over its share.
        """
        limits = self.system.contact.on_rows(self.limits)
        share, friction = _share(c), self.friction
        rest = _rest(c, friction.smooth, friction.smooth_filtered)
        bias = np.divide(rest, share * limits, out=np.zeros_like(rest), where=limits > 0.0)
        follows, none = self.impulsive | self.sprung, np.full(before.size, np.inf)
        return Hinges(
            first=np.where(follows, 0.5, 1.0),
            lower=np.where(follows, 0.5 * before, none),
            upper=np.where(follows, 2.0 * before, none),
            beyond=np.where(self.impulsive, 1.0 / share - 1.5, -0.5),
            cap=np.where(self.impulsive, self.limits, none),
            bias=np.where(self.impulsive_rows, bias, 0.0),
        )

    def _take_over_friction(self, c: Coefficients, minimum: Minimum, before: FloatArray) -> None:
        """Take over friction and its limits after a step; ``before`` as in `_hinges`."""
        hinges, known = self._hinges_now, self._known
        on_rows, last, share = self.system.contact.on_rows, self.friction, _share(c)
        impact = np.where(self.impulsive, np.maximum(self._pressing() - 2.0 * before, 0.0), 0.0)
        self.limits = minimum.w - (1.0 / share - 1.0) * impact
        smooth = on_rows(self.limits) * minimum.sigma
        end = on_rows(minimum.w) * minimum.sigma
        if hinges is not None:
            end = end + on_rows(np.minimum(4.0 * minimum.w, hinges.cap)) * hinges.bias
        mean = np.where(self.impulsive_rows, share * end, end)
        end = np.where(self.impulsive_rows, end + known, end)
        filtered = _filtered(c, end, last.end, last.filtered)
        of_smooth = _filtered(c, smooth, last.smooth, last.smooth_filtered)
        anew = on_rows(impact > 0.0)
        self.friction = FrictionState(
            end, filtered, smooth, np.where(anew, smooth, of_smooth), mean
        )

    def _bounds(self, c: Coefficients, predictor: FloatArray, u: FloatArray) -> FloatArray:
        """Largest velocity of approach of each pressure point at the end of a step, m/s.

        Of points with a stiffness the velocity at which they begin to carry force.
        """
        contact = self.part
        apart = contact.gap - contact.force / contact.stiffness - contact.N @ predictor
        bound = apart / c.c_K
        if self.has_impulses:
            known = np.asarray(contact.N @ (predictor - u))
            rigid = np.maximum(0.0, (np.maximum(self._gaps(u), 0.0) - known) / c.c_K)
            bound = np.where(self.rigid, rigid, bound)
        return np.asarray(bound)

    def _add_scheme_work(
        self, recorder: Recorder, before: State, now: State, friction: FrictionState
    ) -> None:
        """Add what the scheme takes of the work of friction that is an impulse."""
        beside = 0.5 * (friction.end + self.friction.end) - self.friction.mean
        moved = self.system.contact.B @ (now.u - before.u)
        recorder.dissipated[1] += float((beside * moved)[self.impulsive_rows].sum())

    def _add_normal_work(
        self, recorder: Recorder, before: State, now: State, normal: NormalState
    ) -> None:
        """Add the work that impacts take; a rest that belongs to the scheme goes to its own row."""
        moved = np.asarray(self.part.N @ (now.u - before.u))
        rigid = self.rigid
        lost = float(self.normal.mean[rigid] @ moved[rigid])
        recorder.impact_work += lost
        recorder.dissipated[1] += self.part.work_left(normal.end, self.normal.end, moved) - lost
        # Approaches of closed points are zero but for the round-off of the displacements.
        round_off = 1e-9 * float(np.abs(now.u - before.u).max())
        if lost < -round_off * float(self.normal.mean[rigid].sum()):
            raise ArithmeticError(
                f"contact that opens: its normal forces did a work of {-lost:.3g} J in a step"
            )

    def in_loop(self, places: Places, joint_points: int) -> Opening:
        """Forces of elastic contact for the compiled loop over steps of a dense system.

        ``places`` are those of the step problem, ``joint_points`` the points with friction of all
        joints. What belongs to a step problem and to a run is not there yet, see `enter_loop`.
        """
        contact, (q, m) = self.part, (self.part.gap.size, self.limits.size)
        rows, slides = places.row.size, m if self.system.contact.has_springs else 0
        none = np.zeros(0)
        return Opening(
            rest=np.asarray(self._faces @ contact.force),
            apart=contact.gap - contact.force / contact.stiffness,
            stiffness=np.array(contact.stiffness),
            at_rest=float((0.5 * contact.force**2 / contact.stiffness).sum()),
            p=np.zeros(q), force=np.zeros(rows), limits=np.zeros(m),
            new_force=np.zeros(rows),
            approach=np.zeros(q), share=np.zeros(joint_points),
            slider_peak=np.zeros(slides),
            peak=none, least=none,
        )  # fmt: skip

    def enter_loop(self, loop: Opening, problem: PrimalDualNewton, recorder: Recorder) -> Opening:
        """The same with the forces now, for steps of a problem."""
        row, point = problem.places
        loop.p[:] = self.normal.mean
        loop.force[row], loop.limits[point] = self.friction.mean, self.limits
        if loop.slider_peak.size:
            loop.slider_peak[point] = recorder.slider_peak
        none = np.full(self.normal.mean.size, np.inf)
        problem.press(problem.points.beta, None, Pressed(none, self.system.contact.given))
        return loop._replace(peak=recorder.normal_force_peak, least=recorder.normal_force_least)

    def leave_loop(self, loop: Opening, places: Places, recorder: Recorder) -> None:
        """Take over the forces at the end of steps in the loop; earlier ones do not matter."""
        self.normal = NormalState(*np.repeat(loop.p[None], 3, axis=0))
        self.friction = FrictionState.at(loop.force[places.row])
        self.limits = loop.limits[places.point]
        if loop.slider_peak.size:
            recorder.slider_peak[:] = loop.slider_peak[places.point]

    def saved(self) -> dict[str, NDArray[Any]]:
        """All that steps depend on, for a checkpoint."""
        own = {"normal": np.array(self.normal), "friction": np.array(self.friction)}
        return own | {"limits": np.array(self.limits)} | self.touching.saved()

    def restore(self, saved: Saved) -> None:
        """Take up what :meth:`saved` gave."""
        self.normal = NormalState(*map(np.array, saved["normal"]))
        self.friction = FrictionState(*map(np.array, saved["friction"]))
        self.limits = np.array(saved["limits"])
        self.touching.restore(saved)


def _share(c: Coefficients) -> float:
    """Share of the force at the end of a step in the mean force over it."""
    return 1.0 / (c.d_a * c.a_v * c.h)


def _rest(c: Coefficients, end: FloatArray, filtered: FloatArray) -> FloatArray:
    """What earlier forces give to the mean force over a step; arguments are those before it."""
    earlier = -(c.d_a0 * filtered + c.d_d0 * end) / c.d_a
    return (earlier - c.a_a * filtered) / (c.a_v * c.h)


def _filtered(
    c: Coefficients, now: FloatArray, end: FloatArray, filtered: FloatArray
) -> FloatArray:
    """What the auxiliary acceleration has of a force ``now``, from what it was before."""
    return (now - c.d_a0 * filtered - c.d_d0 * end) / c.d_a
