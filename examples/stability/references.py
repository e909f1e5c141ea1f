"""Models and runs of cases, their references, and the errors that are allowed."""

from dataclasses import replace
from math import inf, pi

import numpy as np
from benchmarks.explicit import runge_kutta
from paper.pseudo_static import loop, peak_displacement
from scipy.linalg import expm

from skfem_joint.reduction.basis import Options
from skfem_joint.reduction.friction_points import merged_points
from skfem_joint.reduction.pod import orthonormal, proper_decomposition, snapshot_matrix
from skfem_joint.reduction.scaled.gauss import gauss_points
from skfem_joint.reduction.sources import own_basis
from skfem_joint.runs.integrate import integrate
from skfem_joint.stepping.recording import Save
from skfem_joint.stepping.schemes import generalized_alpha
from stability.cases import UNITS, E
from stability.makers import structure_of, system_of

#: Error allowed for steps of finite size, see :func:`allowed_error`.
COARSE, MOST = 2.0, 0.2
#: Error allowed between the same problem in different units or in all its modes: the steps'
#: tolerance of 1e-11, gathered over the steps.
SAME = 1e-6


def modelled(case):
    """System of a case, reduced if the case has a reduced model."""
    system = system_of(case)
    if case.model == "full":
        return system
    training = run(replace(case, model="full", steps=max(case.steps, 50)), system, fields=True)
    if case.is_plate and case.modes is not None:
        basis = own_basis(system, training, Options(modes=case.modes))
        reduced, most = system.project(basis.V), 4 * case.modes
        if case.model == "reduced":
            return reduced
        return merged_points(reduced, basis.history.velocities, basis.history.active, most)
    V = proper_decomposition(snapshot_matrix(training.u, training.v, "both")).modes[:, : case.modes]
    V = V * np.logspace(-0.5 * case.mode_scales, 0.5 * case.mode_scales, V.shape[1])
    if case.dependent:
        V = np.hstack([V, V @ np.ones((V.shape[1], 2))])
    if case.dependent == "dropped":
        V = orthonormal(V, system.M)
    if case.model == "reduced":
        return system.project(V)
    (patch,) = (structure := structure_of(case)).patches
    line = patch.points, structure.nodes[patch.nodes, 0]
    return gauss_points(system.project(V), [line], 6)


def run(case, system, *, fields=False, finer=1):
    """Run a case; ``finer`` divides its step, the stored times stay the same.

    Fields are stored at 2,000 steps at most.
    """
    n_steps = finer * case.steps * case.periods
    save = Save(every=finer, fields=fields, fields_every=max(1, -(-n_steps // 2000)))
    step = case.step / finer / UNITS[case.units][2]
    if case.solver == "explicit":
        result = runge_kutta(system, step=step, n_steps=n_steps, save=save)
    else:
        # Cycle by cycle is enough; a drift of 1e5 cycles is watched by the thousand.
        cycle = finer * case.steps * max(1, case.periods // 100)
        how = {"cycle_steps": cycle, "scheme": generalized_alpha(case.rho), "save": save}
        result = integrate(system, step=step, n_steps=n_steps, **how)
    if result.interrupted:
        raise KeyboardInterrupt
    return result


def reference(case, result, system):
    """Reference of a case: its name, the displacements (rows, points), and the allowed error."""

    def other(another):
        return run(another, modelled(another)).point_u

    u, bound = result.point_u, allowed_error(case)
    if case.units:
        return "same in SI", other(replace(case, units="")) / UNITS[case.units][0], SAME
    if case.turned:
        return "same unturned", other(replace(case, turned=0.0)), SAME
    if case.axis == "plate as bar":
        # Stiffness, limits and load all are in proportion to the width, which does not matter.
        along = other(replace(case, bodies="bar", elements=case.elements[:1], axis="bar"))
        return "the bar", np.hstack([along, along, np.zeros_like(along)]), SAME
    if case.axis == "drift":
        # A steady Coulomb joint repeats itself: every period is that of its hundredth.
        early = u[100 * case.steps : 101 * case.steps]
        later = np.resize(early, (u.shape[0] - 100 * case.steps, u.shape[1]))
        return "its 100th period", np.concatenate([u[: 100 * case.steps], later]), SAME
    if system.contact.count == 0 and case.load == "harmonic":
        return "closed form", linear_response(case, system, result.times), bound
    if case.axis == "slow":
        # Each branch of the loop ends somewhere inside an element.
        coarse = 1.0 / (case.share * case.elements[0])
        return "closed form", pseudo_static_response(case, result)[:, np.newaxis], bound + coarse
    if case.model == "reduced" and case.modes is None:
        return "full model", other(replace(case, model="full")), SAME
    if case.solver == "explicit":
        implicit = run(replace(case, solver="implicit"), system, finer=4)
        return "implicit, quarter step", implicit.point_u, bound
    return "quarter step", run(case, system, finer=4).point_u, bound


def allowed_error(case):
    """Error of the displacement that the size of the steps explains, over its largest value.

    Two parts, and never more than MOST, beyond which the answer is wrong however coarse the step:

    - COARSE / n for n steps in the shortest time that the answer depends on: the load's period, the
      rise time of an impulse, and, when the load sets in suddenly, the free vibration of period
      4 L / c that follows, L being the length that the load sets slipping. Stick and slip have
      kinks, where second-order schemes are of first order; the worst seen is 1.3 / n.
    - The phase that schemes lose. A period comes out too long by p (2 pi / n)^2 of itself, with
      p = 1/12 + 3/8 ((1 - rho) / (1 + rho))^2, which adds up to 2 pi N p (2 pi / n)^2 after N
      periods. The free vibration adds the same with its own n and N, in proportion to its share of
      the motion, until it has died down.
    """
    period, natural = case.steps, case.natural / case.step
    sudden = case.load != "harmonic" or case.phase != 0.0
    if sudden and case.force is None:
        natural *= min(1.0, case.share)
    rise = case.duration if sudden and case.load != "rectangle" else None
    shortest = min(period, natural if sudden else inf, rise or inf)
    shift = 1.0 / 12.0 + 0.375 * ((1.0 - case.rho) / (1.0 + case.rho)) ** 2
    omega = 2.0 * pi / (natural * case.step)
    dying = 1.0 / (pi * case.damping * omega) if case.damping > 0.0 else inf
    vibrations = min(case.steps * case.periods / natural, dying)
    share = 1.0 if sudden else min(1.0, natural / period)
    lost = (2.0 * pi) ** 3 * shift * (case.periods / period**2 + share * vibrations / natural**2)
    return min(MOST, COARSE / shortest + lost)


def linear_response(case, system, times):
    """Points of a system without friction under a harmonic load from rest, to round-off.

    With the load's sine and cosine as two more states the equations are homogeneous: the
    exponential of their matrix takes them from one of the equidistant times to the next.
    """
    n, h = system.n, times[1]
    M, C, K = (A.toarray() for A in (system.M, system.C, system.K))
    force = system.load_vectors() * system.loads[0].amplitude.peak_value
    A = np.zeros((2 * n + 2, 2 * n + 2))  # of u, h v, sine and cosine, over a step
    A[:n, n:-2] = np.eye(n)
    A[n:-2, :-1] = np.linalg.solve(M, np.hstack([-h * h * K, -h * C, h * h * force]))
    A[-2:, -2:] = 2.0 * pi * case.frequency * h * np.array([[0.0, 1.0], [-1.0, 0.0]])
    states, step = [np.eye(len(A))[-1]], expm(A)
    for _ in times[1:]:
        states.append(step @ states[-1])
    return np.array(states)[:, :n] @ system.P.T


def pseudo_static_response(case, result):
    """Loaded end of a bar with a Coulomb joint, pulled so slowly that inertia does not matter."""
    EA = E * (0.2 * case.length) * (0.04 * case.length)
    tau = case.friction * case.pressure * (0.2 * case.length)
    phase = 2.0 * pi * case.frequency * result.times
    u, force = loop(result.system.loads[0].amplitude.peak_value or 0.0, EA, tau, phase)
    return np.where(phase < 0.5 * pi, peak_displacement(1.0, EA, tau) * force**2, u)
