"""Checks of a run that need no reference: balance of energy, law of friction, motion."""

import numpy as np
from scipy.signal import lfilter

from skfem_joint.minimise.law import force
from skfem_joint.runs.last_cycle import steady_state
from skfem_joint.stepping.schemes import generalized_alpha

#: Allowed residual of the energy audit, over the energy in play.
ENERGY = 1e-8
#: Share of the peak by which a steady loop may differ from its own point reflection. The steady
#: state is detected with a tolerance of 2e-3.
ASYMMETRY = 2e-2
EPS = float(np.finfo(float).eps)
#: Round-off of slip velocities that are sums, over the largest one; and of a friction vector.
SLIP_ROUND_OFF, ROUND_OFF = 64.0 * EPS, 8.0 * EPS


def energy_bound(case, run):
    """Share of the energy in play that may be left over in the audit: ENERGY, or round-off.

    Elastic forces are differences of |K| |u|, each with a round-off of a few eps of that, which is
    also the step's own tolerance: along four peaks a period the work 8 eps * 4 periods *
    |u|^T |K| |u|, beyond ENERGY from about ten thousand elements on. In a reduced model the slip
    of a point is a sum over the modes; its round-off, magnified by the slope beta of the law, is
    what the forces of a step can balance to: up to 1e-6 of them.
    """
    system = run.system
    start, end = run.stored_energy
    spent = run.viscous_work + run.friction_work.sum() + run.scheme_work
    in_play = max(np.abs(run.input_work).sum(), abs(start), abs(end), abs(spent))
    if in_play == 0.0 or run.u.shape[0] == 0:
        return ENERGY
    peak = np.abs(run.u).max(axis=0)
    share = ROUND_OFF * 4.0 * case.periods * (peak @ (abs(system.K) @ peak)) / in_play
    if system.is_dense and system.contact.count:
        fastest = np.abs(system.contact.B @ run.v.T).max()
        share += min(1e-6, SLIP_ROUND_OFF * system.contact.beta.max() * fastest)
    return max(ENERGY, share)


def law_checks(run):
    """The friction force never passes its limit and lies on its law; stuck points do not creep.

    At each point it is a vector against the slip vector.
    """
    contact, acts = run.system.contact, run.system.contact.w > 0.0
    if not np.any(acts):
        return []
    slip = (contact.B @ run.v.T).T
    speed, size = contact.slip_norm(slip), contact.slip_norm(run.sigma)
    # Where modes share a point its slip is a sum with round-off, which a steep law magnifies: the
    # force must lie on the law within the round-off of the largest slip.
    noise = SLIP_ROUND_OFF * speed[:, acts].max(initial=0.0) if run.system.is_dense else 0.0
    moves = acts & (speed > 0.0)
    divisor = np.where(moves, speed, 1.0)
    aligned = np.repeat(size / divisor, contact.directions, axis=-1) * slip
    with_slip = contact.slip_norm(run.sigma - aligned) <= ROUND_OFF + 2.0 * noise / divisor
    low = force(np.maximum(speed - noise, 0.0), contact.beta)
    high = force(speed + noise, contact.beta)
    on_law = (low - 1e-12 <= size) & (size <= high + 1e-12)
    coulomb = acts & np.isinf(contact.beta)
    return [
        (np.all(size[:, acts] <= 1.0 + ROUND_OFF), "friction force beyond its limit"),
        (not np.any(moves & coulomb & (size < 1.0 - ROUND_OFF)), "sticking points creep"),
        (np.all(with_slip[moves]), "friction pushes, or not against the slip"),
        (np.all(on_law[:, acts & ~coulomb]), "friction force off its law"),
    ]


def passivity_checks(run, bound):
    """Friction takes energy at every point, and no more is stored than was put in."""
    start, end = run.stored_energy
    more = end - start - run.input_work.sum()
    margin = bound * max(np.abs(run.input_work).sum(), abs(start), abs(end))
    least = run.friction_work.min(initial=0.0)
    return [
        (least >= -margin, f"friction gives {-least:.2g} J at a point"),
        (more <= max(0.0, -run.scheme_work) + margin, f"{more:.2g} J more stored than put in"),
    ]


def motion_checks(case, run, bound):
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
    contact = system.contact
    friction = contact.B.T @ (contact.on_rows(contact.w)[:, np.newaxis] * run.sigma.T)
    forces = loads - system.C @ v - system.K @ u - friction
    h, momentum = run.field_times[1], system.M @ np.diff(v, axis=1)
    if case.rho == 1.0:
        left_over = momentum - 0.5 * h * (forces[:, 1:] + forces[:, :-1])
    else:
        left_over = h * (_inertia(case, momentum, forces[:, :1], h) - forces[:, 1:])
    # Each sum carries the round-off of its terms; the solver's tolerance is a share of them.
    sums = ((abs(A) @ np.abs(x)).max() for A, x in ((system.K, u), (system.C, v), (system.M, v)))
    stiff, damped, inertia = sums
    others = np.abs(friction).max(initial=0.0) + np.abs(loads).max()
    terms = h * (stiff + damped + others) + 2.0 * inertia
    share = np.abs(left_over).max() / terms if terms > 0.0 else 0.0
    return [(share <= bound, f"equation of motion off by {share:.2g}")]


def _inertia(case, momentum, first, h):
    """Mass times the acceleration at the end of each step, from the changes of momentum."""
    c = generalized_alpha(case.rho).coefficients(h)
    a, _ = lfilter([c.a_v], [1.0, -c.a_a], momentum, zi=c.a_a * first)
    return lfilter([c.d_a, c.d_a0], [1.0, -c.d_d0], a, zi=(c.d_a0 + c.d_d0) * first)[0]


def steadiness(case, run):
    """Steady state, 'reached' or 'not reached', and the asymmetry of the steady loop.

    Half a period later the displacement from the loop's middle is the opposite. The middle
    itself may be anywhere: a joint keeps what the first cycles left in its stuck part.
    """
    state = steady_state(run) if case.load == "harmonic" else None
    if state is None or not state.reached:
        return "not reached" if state else "", 0.0
    u = run.point_u[-case.steps :, 0]
    if case.steps % 2 or not np.any(u):
        return "reached", 0.0
    middle = 0.5 * (u.max() + u.min())
    sums = u[: case.steps // 2] + u[case.steps // 2 :] - 2.0 * middle
    return "reached", np.abs(sums).max() / max(u.max() - middle, np.abs(u).max())
