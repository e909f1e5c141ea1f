"""The compiled loop over steps, and the stepper that calls it, of chains and dense systems.

The loop has the predictor, the step problem, bookkeeping and stored rows.

The law of friction is evaluated in `minimise_step`: for chains by `front_elimination` and its
`minty_newton` (`law.graph`), for dense systems by `dense_loop` and `dense_pressures`
(`law.forces`). What differs where contact opens is in `loop_contact`. Other systems have no part in
this loop: `driver.PythonStepper` steps them with `contact_newton` or `condensed_newton`, whose
`contact_loops` take forces, tangents and relaxation of single points from `law`.
`stepping.arrangement.step_problem` chooses the method.

It is compiled for each kind of system with all that it calls. Of 6.1 s for chains and 7.6 s for
dense systems, on a busy machine, 3.4 and 5.0 s are for the step problem alone. So a loop that kinds
share, or one in Python for few steps, would save some 2.6 s of a first run, once.
"""

# numba infers the types of compiled functions:
# mypy: allow-untyped-defs, allow-untyped-calls, allow-untyped-decorators, no-check-untyped-defs

from __future__ import annotations

from typing import TYPE_CHECKING, Any, cast

import numpy as np

from skfem_joint.ground.arrays import FloatArray, as_dense
from skfem_joint.ground.compiling import compiled, compiled_inside
from skfem_joint.ground.errors import InputError
from skfem_joint.linalg.compressed import compressed_rows
from skfem_joint.linalg.kernels import Full, aligned, bands
from skfem_joint.linalg.vectors import (
    dot,
    point_norms,
    product,
    raise_to,
    raise_to_norms,
    weighted,
)
from skfem_joint.minimise.problem import ContactPoints, minimise_step, slips
from skfem_joint.stepping import energy, loop_contact
from skfem_joint.stepping.arrangement import step_problem
from skfem_joint.stepping.schemes import Coefficients, State
from skfem_joint.stepping.stepper import ConstantForces, FailedStep, Stepper
from skfem_joint.system.system import System

if TYPE_CHECKING:
    from skfem_joint.minimise.primal_dual_newton import PrimalDualNewton
    from skfem_joint.minimise.problem import CompiledStepProblem

#: Stride of rows that are never stored.
NEVER = 2**62

_add_dissipation = compiled_inside(energy.add_dissipation)
_add_input_work = compiled_inside(energy.add_input_work)
_add_friction_work = compiled_inside(energy.add_friction_work)
_joint_slips = compiled_inside(energy.joint_slips)


class CompiledStepper(Stepper):
    """Steps of a chain or of a dense system: `time_loop` does many at a time, in place.

    Raises
    ------
    InputError
        For set-valued Coulomb friction in a dense system.
    """

    COUNTS = (
        *("newton_iterations", "nested_solves", "descents", "line_searches"),
        *("friction_evaluations", "largest_iterations", "renewed_limits"),
    )
    most_at_once = 20_000

    def __init__(self, kind: str, system: System, *others: Any) -> None:
        super().__init__(kind, system, *others)
        s = self.system
        if kind == "dense" and np.any(np.isinf(s.contact.beta[s.contact.rubs & ~s.contact.sprung])):
            raise InputError(
                "set-valued Coulomb friction (beta = inf) without springs needs one unknown for "
                "each contact point, which a reduced or dense system has not; use System.with_beta "
                "with a finite beta"
            )
        form = bands if kind == "chain" else lambda A: Full(as_dense(A))
        M, C, K = (form(A) for A in (s.M, s.C, s.K))
        loads, observed = compressed_rows(self.recorder.vectors.T), compressed_rows(s.P)
        # The problem of the mass, from which those of all steps are made.
        own = cast("CompiledStepProblem", step_problem(M, self.points, kind))
        self.own = own
        rows, m = own.limits.size, s.n if kind == "chain" else s.contact.w.size
        self.now = self.now._replace(sigma=self.placed(self.now.sigma))
        sizes = *6 * [s.n], *2 * [rows], *4 * [m], len(s.loads), len(s.points)
        self.workspace = tuple(aligned(*sizes))
        self.first_call = own.steps_per_second
        start, point, value, share, sliding, creep = self.recorder.joints
        joints = start, own.places.point[point], value, share, sliding, creep
        places = own.places.row, own.places.point
        stretch = np.zeros(0)
        if s.contact.has_springs:
            changing = s.contact.opens
            taken = s.contact.spring_flexibility if changing else s.contact.spring_stretch
            stretch = self.placed(taken)
        weight: FloatArray = own.limits
        self.opening: Any = None  # elastic contact that opens
        if not isinstance(self.forces, ConstantForces):
            weight, self.opening = np.ones(rows), self.forces.in_loop(own.places, share.size)
        self.loop_system = M, C, K, loads, observed, joints, *places, stretch, weight

    def new_problem(self, c: Coefficients) -> CompiledStepProblem:
        """See `Stepper`."""
        M, C, K = self.loop_system[:3]
        H = type(M)(*(c.c_M * m + d + c.c_K * k for m, d, k in zip(M, C, K, strict=True)))
        s = self.system
        changes = s.contact.has_springs or s.contact.opens
        return self.own.with_matrix(H, ContactPoints.of(s, c.c_K, c.h) if changes else None)

    def started(self, acceleration: FloatArray, sigma: FloatArray) -> None:
        """Go on with friction in the order of the problem."""
        by_place = self.placed(sigma)
        super().started(acceleration, by_place)
        self.own.restart(self.now.v, by_place)

    def placed(self, sigma: FloatArray) -> FloatArray:
        """See `Stepper`."""
        by_place = np.zeros(self.own.limits.size)
        by_place[self.own.places.row] = sigma
        return by_place

    def state(self) -> State:
        """State now, with friction by slip row of the system."""
        return self.now._replace(sigma=self.by_row(self.now.sigma))

    def by_row(self, sigma: FloatArray) -> FloatArray:
        """See `Stepper`."""
        return np.asarray(sigma[self.own.places.row])

    def go_on(self, now: State, beside: FloatArray) -> None:
        """See `Stepper`; where contact opens earlier steps are forgotten."""
        super().go_on(now, beside)
        if beside.size:
            self.own.restart(now.v, now.sigma)

    def prepare(self, h: float) -> None:
        """See `Stepper`; the loop is compiled by doing no step."""
        super().prepare(h)
        self.advance(h, np.zeros((len(self.system.loads), 1)), 0, False)

    def advance(self, h: float, amplitudes: FloatArray, first_step: int, store: bool) -> int:
        """Do the steps in the compiled loop, and those that it leaves as far as Python can."""
        done, of_steps = 0, np.ascontiguousarray(amplitudes.T)
        while True:
            done += self._loop(h, of_steps[done:], first_step + done, store)
            if done == len(of_steps) - 1 or not self._rescued(h):
                return done

    def _rescued(self, h: float) -> bool:
        """Whether the step problem that the loop left is solved: the loop then starts from that."""
        problem = cast("CompiledStepProblem", self.problem(self.coefficients(h)))
        counts = problem.rescue(self.workspace[0], self.now.v, self.tolerance)
        for name in self.counts.keys() & counts.keys():
            self.counts[name] += counts[name]
        return bool(counts)

    def _loop(self, h: float, amplitudes: FloatArray, first_step: int, store: bool) -> int:
        """Do steps in the compiled loop; ``amplitudes`` are by step."""
        c, r = self.coefficients(h), self.recorder
        problem = cast("CompiledStepProblem", self.problem(c))
        problem.resume(self.now.v, self.now.sigma)
        opening = self.opening
        if not isinstance(self.forces, ConstantForces):
            opening = self.forces.enter_loop(opening, cast("PrimalDualNewton", problem), r)
        counted = np.array([self.counts[name] for name in self.COUNTS])
        steps, rows, field_rows, residual, unknown = time_loop(
            len(amplitudes) - 1,
            first_step,
            r.save.strides if store else (NEVER, NEVER),
            c,
            self.loop_system,
            problem.kernel,
            problem.workspace,
            opening,
            self.tolerance,
            amplitudes,
            tuple(self.now),
            self.workspace,
            r.sums(),
            tuple(r.free_rows()),
            counted,
        )
        r.rows += rows
        r.field_rows += field_rows
        if not isinstance(self.forces, ConstantForces):
            self.forces.leave_loop(opening, self.own.places, r)
        self.counts |= dict(zip(self.COUNTS, counted.tolist(), strict=True))
        self.failure = FailedStep(residual, unknown)
        if steps > 0:
            self.frequency = 0.0
        return int(steps)


@compiled
def time_loop(
    n_steps, first_step, strides, c, system, problem, workspace, opening, tolerance, amplitude,
    state, loop, sums, stored, counts,
):  # fmt: skip
    """Advance ``n_steps`` equal steps in place; add up works and peaks, and store rows.

    Parameters
    ----------
    n_steps, first_step : int
        Number of steps, and number in the run of the first one.
    strides : tuple of int
        Of stored points and fields, in steps.
    c : Coefficients
        Of the scheme and step.
    system : tuple
        M, C and K (Bands or Full); load vectors and named points (CompressedRows); the joints, as
        in `Recorder`, with the points of the step problem; the places of the system's slip rows and
        contact points among those of the step problem; the slip that the spring in series of each
        row of the step problem takes under the friction limit, m, or, where limits follow normal
        forces, under a unit force: 0 for none, empty if there are no springs; and what friction
        is over in the loop: the friction limit of each row, N, or, where limits follow, one.
    problem, workspace : named tuple
        Arguments of `minimise_step`.
    opening : Opening or None
        Where elastic contact opens: limits follow its forces.
    tolerance : float
    amplitude : ndarray, shape (n_steps + 1, loads)
        Load amplitudes at the steps' ends, N.
    state, loop, sums, stored : tuple of ndarray
        `State`, arrays to work in, `Recorder.sums` and `Recorder.free_rows`.
    counts : ndarray of int
        By the names of `CompiledStepper.COUNTS`.

    Returns
    -------
    tuple
        Steps, stored rows and fields, and the last residual (N) and its unknown. With fewer than
        ``n_steps`` steps one did not converge, and the state is that before it. (Not a named tuple:
        numba makes one by calling Python, where a pending Ctrl-C is raised, and does not check for
        that before it uses the result.)
    """
    M, C, K, loads, observed, joints, row_place, point_place, stretch, weight = system
    u, v, a, d, sigma = state
    load_start, load_column, load_value = loads
    input_work, dissipated, friction_work, peak, slip_peaks, strain_peak = sums
    joint_start, joint_point, joint_value, joint_share, joint_sliding, joint_creep = joints
    stored_u, stored_v, stored_sigma, worked, stored_p, stored_limits = stored[:6]
    stored_point_u, stored_point_v, by_joint, joint_slip, joint_slipping = stored[6:]
    right, image, y, change, v_mean, v_change, slip_change, slip_now = loop[:8]
    work, slip_size, force_size, slip_peak, moved, seen = loop[8:]
    v_new, sigma_new = workspace.velocity, workspace.force
    n = u.size
    for j in range(point_place.size):
        work[point_place[j]] = friction_work[j]
        slip_peak[point_place[j]] = slip_peaks[j]
    steps, rows, field_rows, residual, unknown = 0, 0, 0, 0.0, 0
    sprung, force, new_force = stretch.size > 0, sigma, sigma_new
    if opening is not None:
        force, new_force = opening.force, opening.new_force
    for step in range(1, n_steps + 1):
        if sprung:
            for i in range(n):
                change[i] = c.u_v * v[i] + c.u_a * a[i]
            known = slips(problem, change, slip_change)
            for q in range(stretch.size):
                free = -(known[q] + stretch[q] * force[q]) / c.c_K
                workspace.offset[q] = free if stretch[q] > 0.0 else 0.0
        for i in range(n):
            u[i] += c.u_v * v[i] + c.u_a * a[i]  # predictor; completed by c_K v below
            y[i] = c.c_M * v[i] + c.y_a * a[i] + c.y_d * d[i]
        product(M, y, right)
        product(K, u, image)
        for i in range(n):
            right[i] -= image[i]
        for k in range(load_start.size - 1):
            for e in range(load_start[k], load_start[k + 1]):
                right[load_column[e]] += amplitude[step, k] * load_value[e]
        if opening is not None:
            loop_contact.approach(opening, problem.normal, c.c_K, u, right)
        outcome = minimise_step(problem, workspace, right, v, tolerance)
        counts[0] += outcome.newton_iterations
        counts[1] += outcome.nested_solves
        counts[2] += outcome.descents
        counts[3] += outcome.line_searches
        counts[4] += outcome.friction_evaluations
        counts[5] = max(counts[5], outcome.newton_iterations)
        residual, unknown = outcome.residual, outcome.unknown
        if not outcome.converged:
            for i in range(n):
                u[i] -= c.u_v * v[i] + c.u_a * a[i]
            break
        steps += 1
        for i in range(n):
            change[i] = c.u_v * v[i] + c.u_a * a[i] + c.c_K * v_new[i]
            v_mean[i] = 0.5 * (v[i] + v_new[i])
        for i in range(n):
            u[i] += c.c_K * v_new[i]
        a_mean = y
        if not c.trapezoidal:
            for i in range(n):
                v_change[i] = v_new[i] - v[i]
                a_mean[i] = 0.5 * d[i]
        for i in range(n):
            a_new = c.a_v * (v_new[i] - v[i]) + c.a_a * a[i]
            d[i] = c.d_a * a_new + c.d_a0 * a[i] + c.d_d0 * d[i]
            a[i] = a_new
            v[i] = v_new[i]
        if not c.trapezoidal:
            for i in range(n):
                a_mean[i] += 0.5 * d[i]
        _add_dissipation(
            M, C, c.h, c.trapezoidal, change, v_mean, a_mean, v_change, image, right, dissipated
        )
        _add_input_work(loads, amplitude[step - 1], amplitude[step], change, moved, input_work)
        slip_moved, slip = slips(problem, change, slip_change), slips(problem, u, slip_now)
        if opening is not None:
            loop_contact.at_end(opening, problem.contact.w, sigma_new)
        if sprung:  # sliders slip by what their springs leave
            for q in range(stretch.size):
                slip_moved[q] -= stretch[q] * (new_force[q] - force[q])
        _add_friction_work(weight, force, new_force, slip_moved, work)
        raise_to_norms(slip_peak, slip)
        if opening is not None:
            loop_contact.add_normal_work(opening, problem.normal, change, dissipated)
            loop_contact.raise_slider_peaks(opening, stretch, slip, slip_change)
        if strain_peak.size > 0:
            product(K, u, image)
            strain = 0.5 * dot(u, image)
            if opening is not None:
                strain += loop_contact.potential(opening, problem.normal.p, u)
            for q in range(stretch.size):
                pulled = weight[q] * new_force[q]
                strain += 0.5 * stretch[q] * pulled * new_force[q]
            strain_peak[0] = max(strain_peak[0], strain)
        if opening is not None:
            loop_contact.follow(opening, problem.normal.p, problem.contact.w)
        for q in range(sigma.size):
            sigma[q] = sigma_new[q]
        product(observed, u, seen)
        raise_to(peak, seen)
        if stored_point_u.shape[0] > 0 and (first_step + step) % strides[0] == 0:
            for k in range(seen.size):
                stored_point_u[rows, k] = seen[k]
            product(observed, v, stored_point_v[rows])
            for k in range(joint_start.size - 1):
                own = slice(joint_start[k], joint_start[k + 1])
                by_joint[rows, k] = weighted(joint_value[own], joint_point[own], work)
            if joint_slip.shape[0] > 0:
                point_norms(slip, slip_size)
                point_norms(sigma, force_size)
                share = joint_share
                if opening is not None:
                    share = opening.share
                    loop_contact.share_now(opening, joint_start, joint_point, joint_value)
                _joint_slips(
                    joint_start, joint_point, share, joint_sliding, joint_creep,
                    (first_step + step) * c.h, work, slip_size, force_size, joint_slip[rows],
                    joint_slipping[rows],
                )  # fmt: skip
            rows += 1
        if stored_u.shape[0] > 0 and (first_step + step) % strides[1] == 0:
            for i in range(n):
                stored_u[field_rows, i] = u[i]
                stored_v[field_rows, i] = v[i]
            for j in range(row_place.size):
                stored_sigma[field_rows, j] = sigma[row_place[j]]
            for j in range(point_place.size):
                worked[field_rows, j] = work[point_place[j]]
            if opening is not None:
                loop_contact.store_forces(
                    opening, point_place, stored_p[field_rows], stored_limits[field_rows]
                )
            field_rows += 1
    for j in range(point_place.size):
        friction_work[j] = work[point_place[j]]
        slip_peaks[j] = slip_peak[point_place[j]]
    return steps, rows, field_rows, residual, unknown
