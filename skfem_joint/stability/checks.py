"""What must hold of a run whatever its answer: balance of energy, law of friction, motion."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from skfem_joint.friction import force
from skfem_joint.history import steady_state
from skfem_joint.recording import Run
from skfem_joint.schemes import generalized_alpha
from skfem_joint.stability.problem import Case

FloatArray = NDArray[np.float64]

#: Energy left over in the audit, over the energy in play.
ENERGY = 1e-8
#: Share of the peak by which a loop may miss its own point reflection in steady state, whose
#: detection lets 2e-3 of change pass.
ASYMMETRY = 2e-2
EPS = float(np.finfo(float).eps)
#: Round-off of slip velocities that are sums, over the largest of the run.
SLIP_ROUND_OFF = 64.0 * EPS
#: Round-off of a friction vector.
ROUND_OFF = 8.0 * EPS


def round_off_of_energy(case: Case, run: Run) -> float:
    """Share of the energy in play that round-off alone may leave over in the audit.

    The elastic force of a step is a difference of forces |K| |u| that grow with the number of
    elements while their sum does not: each entry carries a round-off of a few eps |K| |u|, and the
    step's own tolerance is no smaller than that (:data:`kernels_tridiagonal.ROUND_OFF`, 8 eps).
    Along a path of four peaks a period this does the work 8 eps * 4 periods * |u|^T |K| |u|. For a
    bar of n equal elements |u|^T |K| |u| is 4 n^2 times EA u^2 / L, so that the bound passes 1e-8
    from about ten thousand elements on.

    In a reduced model the slip of a point is a sum over the modes, and its round-off, magnified by
    the slope beta of the law, is as small as the forces of a step can get in balance; the dense
    steps accept it up to 1e-6 of the forces.
    """
    system = run.system
    start, end = run.stored_energy
    in_play = max(
        float(np.abs(run.input_work).sum()),
        abs(start),
        abs(end),
        abs(run.viscous_work + float(run.friction_work.sum()) + run.scheme_work),
    )
    if in_play == 0.0 or run.u.shape[0] == 0:
        return 0.0
    peak = np.abs(run.u).max(axis=0)
    forces = float(peak @ (abs(system.K) @ peak))
    share = 8.0 * EPS * 4.0 * case.periods * forces / in_play
    if system.is_dense and system.contact_points:
        fastest = float(np.abs(system.B @ run.v.T).max())
        share += min(1e-6, SLIP_ROUND_OFF * float(system.beta.max()) * fastest)
    return float(share)


def law_checks(run: Run) -> list[tuple[bool, str]]:
    """The friction force never passes its limit and lies on its law; stuck points do not creep.

    At each point it is a vector against the slip vector.
    """
    system = run.system
    acts = system.w > 0.0
    if not np.any(acts):
        return []
    slip = _vectors(run, np.asarray((system.B @ run.v.T).T))[:, acts]
    sigma = _vectors(run, run.sigma)[:, acts]
    beta = np.broadcast_to(system.beta[acts], sigma.shape[:2])
    speed, size = (np.hypot(x[..., 0], x[..., 1]) for x in (slip, sigma))
    # Where modes share a point its slip is a sum with round-off, which a steep law magnifies: the
    # force must lie on the law within the round-off of the largest slip.
    noise = SLIP_ROUND_OFF * float(speed.max(initial=0.0)) if system.is_dense else 0.0
    moves = speed > 0.0
    one = np.where(moves, speed, 1.0)
    against = np.abs(sigma - (size / one)[..., np.newaxis] * slip).max(axis=-1)
    with_slip = against <= ROUND_OFF + 2.0 * noise / one
    coulomb = np.isinf(beta)
    low, high = force(np.maximum(speed - noise, 0.0), beta), force(speed + noise, beta)
    on_law = (low - 1e-12 <= size) & (size <= high + 1e-12)
    return [
        (bool(np.all(size <= 1.0 + ROUND_OFF)), "friction force beyond its limit"),
        (not np.any(moves & coulomb & (size < 1.0 - ROUND_OFF)), "sticking points creep"),
        (bool(np.all(with_slip[moves])), "friction pushes, or not against the slip"),
        (bool(np.all(on_law[~coulomb])), "friction force off its law"),
    ]


def _vectors(run: Run, rows: FloatArray) -> FloatArray:
    """Rows (frames, rows) of the slip operator as vectors (frames, m, 2) of its points."""
    first, two = run.system.first_row[:-1], run.system.directions == 2
    vectors = np.zeros((rows.shape[0], first.size, 2))
    vectors[..., 0] = rows[:, first]
    vectors[:, two, 1] = rows[:, first[two] + 1]
    return vectors


def passivity_checks(run: Run, bound: float) -> list[tuple[bool, str]]:
    """Friction takes energy at every point, and what is stored was put in."""
    start, end = run.stored_energy
    given = float(run.input_work.sum())
    in_play = max(float(np.abs(run.input_work).sum()), abs(start), abs(end))
    numerical = max(0.0, -run.scheme_work)
    least = float(run.friction_work.min(initial=0.0))
    return [
        (least >= -bound * in_play, f"friction gives {-least:.2g} J at a point"),
        (
            end - start <= given + numerical + bound * in_play,
            f"{end - start - given:.2g} J more stored than put in",
        ),
    ]


def motion_checks(case: Case, run: Run, bound: float) -> list[tuple[bool, str]]:
    """The stored states obey the equation of motion, assembled anew.

    With the trapezoidal rule the change of momentum in a step is the mean force times the step.
    Other schemes carry accelerations that are not stored: they follow from the velocities, and
    must balance the forces at the end of each step.
    """
    whole = run.field_times.size == run.counters.steps + 1 and run.counters.halved_steps == 0
    from_rest = case.load == "harmonic" and (case.rho == 1.0 or case.phase == 0.0)
    if case.solver != "implicit" or not (from_rest and whole):
        return []
    system, u, v = run.system, run.u.T, run.v.T
    loads = system.load_vectors() @ system.load_amplitudes(run.field_times)
    friction = system.B.T @ (system.on_rows(system.w)[:, np.newaxis] * run.sigma.T)
    forces = loads - system.C @ v - system.K @ u - friction
    h = float(run.field_times[1])
    momentum = system.M @ np.diff(v, axis=1)
    if case.rho == 1.0:
        left_over = momentum - 0.5 * h * (forces[:, 1:] + forces[:, :-1])
    else:
        left_over = h * (_inertia(case, momentum, forces[:, 0], h) - forces[:, 1:])
    # Each sum carries the round-off of its terms; the solver's tolerance is a share of them.
    terms = (
        h * float((abs(system.K) @ np.abs(u)).max())
        + h * float((abs(system.C) @ np.abs(v)).max())
        + h * float(np.abs(friction).max(initial=0.0))
        + h * float(np.abs(loads).max())
        + 2.0 * float((abs(system.M) @ np.abs(v)).max())
    )
    share = float(np.abs(left_over).max()) / terms if terms > 0.0 else 0.0
    return [(share <= max(bound, ENERGY), f"equation of motion off by {share:.2g}")]


def _inertia(case: Case, momentum: FloatArray, first: FloatArray, h: float) -> FloatArray:
    """Mass times the acceleration at the end of each step, from the changes of momentum."""
    c = generalized_alpha(case.rho).coefficients(h)
    a = d = first
    found = np.empty_like(momentum)
    for k in range(momentum.shape[1]):
        a_end = c.a_v * momentum[:, k] + c.a_a * a
        found[:, k] = d = c.d_a * a_end + c.d_a0 * a + c.d_d0 * d
        a = a_end
    return found


def steadiness(case: Case, run: Run) -> tuple[str, float | None]:
    """Whether the last two cycles agree, and then how far the loop is from symmetric.

    Half a period later the displacement from the loop's middle is the opposite. The middle
    itself may be anywhere: a joint keeps what the first cycles left in its stuck part.
    """
    state = steady_state(run) if case.load == "harmonic" else None
    if state is None:
        return "", None
    if not state.reached:
        return "not reached", None
    u = run.point_u[-case.steps :, 0]
    if case.steps % 2 or not np.any(u):
        return "reached", None
    middle = 0.5 * (u.max() + u.min())
    sums = u[: case.steps // 2] + u[case.steps // 2 :] - 2.0 * middle
    return "reached", float(np.abs(sums).max() / max(u.max() - middle, np.abs(u).max()))
