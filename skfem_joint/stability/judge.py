"""Judge of a case: its answer is right, or it was refused, or it is wrong in silence."""

from __future__ import annotations

import os
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass, replace
from math import inf, pi
from multiprocessing import get_context

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import eigh

from skfem_joint import pseudo_static
from skfem_joint.errors import JointError
from skfem_joint.explicit import runge_kutta, stable_step
from skfem_joint.history import steady_state
from skfem_joint.hyper_reduction import with_friction_points
from skfem_joint.integrate import integrate
from skfem_joint.pod import orthonormal, proper_modes
from skfem_joint.recording import Run, Save
from skfem_joint.reduction import snapshot_matrix
from skfem_joint.schemes import generalized_alpha
from skfem_joint.stability.cases import SPEED, UNITS, Case, structure_of, system_of
from skfem_joint.system import System

FloatArray = NDArray[np.float64]

#: Energy left over in the audit, over the energy in play.
ENERGY = 1e-8
#: Error allowed for steps of finite size, see :func:`allowed_error`.
COARSE = 2.0
MOST = 0.2
#: Error allowed between the same problem in different units or in all its modes: the steps'
#: tolerance of 1e-11, gathered over the steps.
SAME = 1e-6
#: Share of the peak by which a loop may miss its own point reflection in steady state, whose
#: detection lets 2e-3 of change pass.
ASYMMETRY = 2e-2
EPS = float(np.finfo(float).eps)
#: Round-off of slip velocities that are sums, over the largest of the run.
SLIP_ROUND_OFF = 64.0 * EPS
#: Fields are stored at this many steps at most.
FRAMES = 2000
#: Friction points of hyper-reduced cases.
POINTS = 6

RIGHT, REFUSED, WRONG = "right", "refused", "wrong in silence"


@dataclass(frozen=True)
class Verdict:
    """What became of a case.

    Attributes
    ----------
    case : Case
    outcome : str
        RIGHT, REFUSED or WRONG.
    reason : str
        The checks that failed, or the message of the refusal.
    against : str
        What the displacement was compared with.
    error, error_bound : float or None
        Largest difference of the free end's displacement over its largest value, and its bound.
    energy, energy_bound : float or None
        Energy left over in the audit, over the energy in play, and its bound.
    steady : str
        Whether a harmonic run reached a steady state: "reached" or "not reached".
    asymmetry : float or None
        Distance of the steady loop from its own point reflection, over its peak.
    iterations, largest_iterations : float, int
        Newton iterations a step, and most in one.
    nested, descents, halved : int
        Steps that needed the second and third tier of the solver, or parts.
    seconds : float
    """

    case: Case
    outcome: str
    reason: str = ""
    against: str = ""
    error: float | None = None
    error_bound: float | None = None
    energy: float | None = None
    energy_bound: float | None = None
    steady: str = ""
    asymmetry: float | None = None
    iterations: float = 0.0
    largest_iterations: int = 0
    nested: int = 0
    descents: int = 0
    halved: int = 0
    seconds: float = 0.0


def judge(case: Case) -> Verdict:
    """Run a case and judge it.

    An exception that is not one of the package's own, and a warning of numpy, count as wrong:
    the user would be told nothing that helps.
    """
    begin = time.perf_counter()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            verdict = _judge(case)
    except JointError as error:
        message = " ".join(str(error).split())
        helps = any(
            word in message.lower() for word in ("use ", "try ", "must be", "give ", "add ")
        )
        outcome = REFUSED if helps else WRONG
        verdict = Verdict(case, outcome, message if helps else f"no remedy named: {message}")
    except (ArithmeticError, ValueError, IndexError, RuntimeError, Warning) as error:
        verdict = Verdict(case, WRONG, f"{type(error).__name__}: {error}")
    if case.must_refuse and verdict.outcome == RIGHT:
        verdict = replace(verdict, outcome=WRONG, reason="should have been refused")
    return replace(verdict, seconds=time.perf_counter() - begin)


def judge_all(
    cases: Sequence[Case],
    workers: int = 2,
    progress: Callable[[str, int, int], None] | None = None,
) -> list[Verdict]:
    """Judge cases in ``workers`` processes (0: in this one); verdicts in the order of the cases.

    Parameters
    ----------
    progress : callable, optional
        Called with (label, cases done, cases in all).
    """
    verdicts: dict[int, Verdict] = {}

    def note(index: int, verdict: Verdict) -> None:
        verdicts[index] = verdict
        if progress is not None:
            progress("stiff and extreme cases", len(verdicts), len(cases))

    if workers == 0:
        for index, case in enumerate(cases):
            note(index, judge(case))
    else:
        with (
            _single_threaded(),
            ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool,
        ):
            # The longest first, so that no worker is left alone with one at the end.
            order = sorted(range(len(cases)), key=lambda k: -_work(cases[k]))
            futures = {pool.submit(judge, cases[k]): k for k in order}
            try:
                for future in as_completed(futures):
                    note(futures[future], future.result())
            except KeyboardInterrupt:
                pool.shutdown(wait=False, cancel_futures=True)
                raise
    return [verdicts[index] for index in range(len(cases))]


def _work(case: Case) -> float:
    return case.steps * case.periods * (case.elements + 20.0)


@contextmanager
def _single_threaded() -> Iterator[None]:
    """Workers that are started inside use one thread each in linear algebra."""
    names = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
    before = {name: os.environ.get(name) for name in names}
    os.environ.update(dict.fromkeys(names, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def _judge(case: Case) -> Verdict:
    system = _modelled(case)
    if case.step_factor is not None:
        steps = 1.0 / case.frequency / (case.step_factor * stable_step(system))
        # Rounded so that the step stays on its side of the stable one.
        case = replace(case, steps=int(np.ceil(steps) if case.step_factor < 1.0 else steps))
    run = _run(case, system, fields=True)
    against, reference, error_bound = _reference(case, run, system)
    scale = float(np.abs(reference).max())
    difference = float(np.abs(run.point_u[:, 0] - reference).max())
    error = difference / scale if scale > 0.0 else (inf if difference > 0.0 else 0.0)
    energy_bound = max(ENERGY, round_off_of_energy(case, run))
    steady, asymmetry = _steadiness(case, run)
    failures = [
        text
        for holds, text in (
            (error <= error_bound, f"displacement off by {error:.2g}, allowed {error_bound:.2g}"),
            (
                run.energy_residual <= energy_bound,
                f"energy audit open by {run.energy_residual:.2g}, allowed {energy_bound:.2g}",
            ),
            (
                asymmetry is None or asymmetry <= ASYMMETRY,
                f"symmetric load, loop asymmetric by {asymmetry or 0.0:.2g}",
            ),
            *_law_checks(run),
            *_passivity_checks(run, energy_bound),
            *_motion_checks(case, run, energy_bound),
        )
        if not holds
    ]
    counters = run.counters
    return Verdict(
        case=case,
        outcome=WRONG if failures else RIGHT,
        reason="; ".join(failures),
        against=against,
        error=error,
        error_bound=error_bound,
        energy=run.energy_residual,
        energy_bound=energy_bound,
        steady=steady,
        asymmetry=asymmetry,
        iterations=counters.newton_iterations / counters.steps,
        largest_iterations=counters.largest_iterations,
        nested=counters.nested_solves,
        descents=counters.descents,
        halved=counters.halved_steps,
    )


def _modelled(case: Case) -> System:
    """System of a case, reduced if the case says so."""
    system = system_of(case)
    if case.model == "full":
        return system
    history = _run(replace(case, model="full", steps=max(case.steps, 50)), system, fields=True)
    V = proper_modes(snapshot_matrix(history.u, history.v, "both")).modes[:, : case.modes]
    V = V * np.logspace(-0.5 * case.mode_scales, 0.5 * case.mode_scales, V.shape[1])
    if case.dependent:
        V = np.hstack([V, V @ np.ones((V.shape[1], 2))])
    if case.dependent == "dropped":
        V = orthonormal(V, system.M)
    reduced = system.project(V)
    if case.model == "reduced":
        return reduced
    position = structure_of(case).position[structure_of(case).free]
    return with_friction_points(reduced, position, [np.arange(position.size)], POINTS)


def _run(case: Case, system: System, *, fields: bool = False, finer: int = 1) -> Run:
    """Run a case; ``finer`` divides its step, the stored times stay the same."""
    n_steps = finer * case.steps * case.periods
    save = Save(every=finer, fields=fields, fields_every=max(1, -(-n_steps // FRAMES)))
    step = case.step / finer / UNITS.get(case.units, (1.0, 1.0, 1.0))[2]
    if case.solver == "explicit":
        run = runge_kutta(system, step=step, n_steps=n_steps, save=save)
    else:
        run = integrate(
            system,
            step=step,
            n_steps=n_steps,
            save=save,
            scheme=generalized_alpha(case.rho),
            # Cycle by cycle is enough; a drift of 1e5 cycles is watched by the thousand.
            cycle_steps=finer * case.steps * max(1, case.periods // 100),
        )
    if run.interrupted:
        raise KeyboardInterrupt
    return run


def _reference(case: Case, run: Run, system: System) -> tuple[str, FloatArray, float]:
    """What the free end should do, and how far from it a right answer may be."""
    u = run.point_u[:, 0]
    if case.units:
        plain = replace(case, units="")
        metre = UNITS[case.units][0]
        return "same in SI", _run(plain, _modelled(plain)).point_u[:, 0] / metre, SAME
    if case.axis == "drift":
        # A steady Coulomb joint repeats itself: every period is that of its hundredth.
        early = u[100 * case.steps : 101 * case.steps]
        return (
            "its 100th period",
            np.concatenate([u[: 100 * case.steps], np.resize(early, u.size - 100 * case.steps)]),
            SAME,
        )
    bound = allowed_error(case)
    if system.contact_points == 0 and case.load == "harmonic":
        return "closed form", linear_response(case, system, run.times), bound
    if case.axis == "slow":
        # Each branch of the loop ends somewhere inside an element.
        coarse = 1.0 / (case.share * case.elements)
        return "closed form", pseudo_static_response(case, run), bound + coarse
    if case.model == "reduced" and case.modes is None:
        full = replace(case, model="full")
        return "full model", _run(full, _modelled(full)).point_u[:, 0], SAME
    if case.solver == "explicit":
        other = replace(case, solver="implicit")
        return "implicit, quarter step", _run(other, system, finer=4).point_u[:, 0], bound
    return "quarter step", _run(case, system, finer=4).point_u[:, 0], bound


def allowed_error(case: Case) -> float:
    """Error of the displacement that the size of the steps explains, over its largest value.

    Two parts, and never more than MOST, beyond which the answer is wrong however coarse the step:

    - COARSE / n for n steps in the shortest time that the answer depends on: the load's period, the
      rise time of an impulse, and, when the load sets in suddenly, the free vibration of period
      4 L / c that follows. Stick and slip have kinks, where second-order schemes are of first
      order; the worst seen is 1.3 / n.
    - The phase that schemes lose. A period comes out too long by p (2 pi / n)^2 of itself, with
      p = 1/12 + 3/8 ((1 - rho) / (1 + rho))^2 (from the eigenvalues of the step, exact for
      1 / n to 0), which adds up to 2 pi N p (2 pi / n)^2 after N periods. The free vibration adds
      the same with its own n and N, in proportion to its share of the motion, until it has
      died down.
    """
    period = float(case.steps)
    natural = 4.0 * case.length / SPEED / case.step
    sudden = case.load != "harmonic" or case.phase != 0.0
    times = [period]
    if sudden:
        times.append(natural)
        if case.load != "rectangle" and case.duration:
            times.append(case.duration)
    shift = 1.0 / 12.0 + 0.375 * ((1.0 - case.rho) / (1.0 + case.rho)) ** 2
    omega = 2.0 * pi / (natural * case.step)
    vibrations = min(
        case.steps * case.periods / natural,
        1.0 / (pi * case.damping * omega) if case.damping > 0.0 else inf,
    )
    share = 1.0 if sudden else min(1.0, natural / period)
    lost = (2.0 * pi) ** 3 * shift * (case.periods / period**2 + share * vibrations / natural**2)
    return min(MOST, COARSE / min(times) + lost)


def linear_response(case: Case, system: System, times: FloatArray) -> FloatArray:
    """Free end of a bar without friction under a harmonic load from rest, by its exact modes.

    Each mode answers F sin(omega t) with the forced vibration and the free vibration that starts
    it from rest; at resonance without damping that is t cos(omega t) growth.
    """
    values, modes = eigh(system.K.toarray(), system.M.toarray())
    force = modes.T @ system.load_vectors()[:, 0] * system.loads[0].amplitude.peak_value
    observed = (system.P @ modes)[0]
    forcing = 2.0 * pi * case.frequency
    total = np.zeros(times.size)
    for value, f, share in zip(values, force, observed, strict=True):
        natural = np.sqrt(value)
        decay = 0.5 * case.damping * value
        # Stiff modes are over-damped: complex frequencies cover all cases alike.
        root = np.sqrt(complex(decay**2 - value))
        detuning = abs(forcing / natural - 1.0)
        if case.damping == 0.0 and detuning < 1e-9:
            phase = natural * times
            total += share * f / (2.0 * value) * (np.sin(phase) - phase * np.cos(phase))
            continue
        forced = f / complex(value - forcing**2, 2.0 * decay * forcing)
        steady = (forced * np.exp(1j * forcing * times)).imag
        start, rate = forced.imag, (forced * 1j * forcing).imag
        fast, slow = -decay + root, -decay - root
        a = (-rate + slow * start) / (fast - slow)
        b = -start - a
        free = (a * np.exp(fast * times) + b * np.exp(slow * times)).real
        total += share * (steady + free)
    return total


def pseudo_static_response(case: Case, run: Run) -> FloatArray:
    """Free end of a Coulomb joint pulled so slowly that inertia does not matter."""
    structure = structure_of(case)
    EA = float(structure.E[0] * structure.width[0] * structure.thickness[0])
    tau = float(structure.friction_per_length(structure.joints[0])[0])
    phase = 2.0 * pi * case.frequency * run.times
    peak = run.system.loads[0].amplitude.peak_value
    u, force = pseudo_static.loop(peak, EA, tau, phase)
    virgin = phase < 0.5 * pi
    return np.where(virgin, pseudo_static.peak_displacement(1.0, EA, tau) * force**2, u)


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


def _law_checks(run: Run) -> list[tuple[bool, str]]:
    """The friction force never passes its limit and lies on its law; stuck points do not creep."""
    system = run.system
    beta = np.broadcast_to(system.beta, run.sigma.shape)
    acts = np.broadcast_to(system.w > 0.0, run.sigma.shape)
    if not np.any(acts):
        return []
    slip = (system.B @ run.v.T).T
    coulomb = np.isinf(beta) & acts
    stuck = coulomb & (np.abs(run.sigma) < 1.0)
    sliding = coulomb & (slip != 0.0)
    regular = ~np.isinf(beta) & acts
    # Where modes share a point its slip is a sum with round-off, which a steep law magnifies: the
    # force must lie on the law within the round-off of the largest slip.
    noise = SLIP_ROUND_OFF * float(np.abs(slip).max(initial=0.0))
    finite = np.where(regular, beta, 1.0)
    low, high = (2.0 / pi * np.arctan(finite * (slip + sign * noise)) for sign in (-1.0, 1.0))
    on_law = (low - 1e-12 <= run.sigma) & (run.sigma <= high + 1e-12)
    return [
        (bool(np.all(np.abs(run.sigma) <= 1.0)), "friction force beyond its limit"),
        (bool(np.all(slip[stuck] == 0.0)), "sticking points creep"),
        (bool(np.all(run.sigma[sliding] == np.sign(slip[sliding]))), "friction pushes"),
        (bool(np.all(on_law[regular])), "friction force off its law"),
    ]


def _passivity_checks(run: Run, bound: float) -> list[tuple[bool, str]]:
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


def _motion_checks(case: Case, run: Run, bound: float) -> list[tuple[bool, str]]:
    """The stored states obey the equation of motion, assembled anew.

    With the trapezoidal rule the change of momentum in a step is the mean force times the step;
    other schemes do not store the acceleration that would tell.
    """
    whole = run.field_times.size == run.counters.steps + 1 and run.counters.halved_steps == 0
    if case.rho != 1.0 or case.solver != "implicit" or case.load != "harmonic" or not whole:
        return []
    system, u, v = run.system, run.u.T, run.v.T
    loads = system.load_vectors() @ system.load_amplitudes(run.field_times)
    friction = system.B.T @ (system.w[:, np.newaxis] * run.sigma.T)
    forces = loads - system.C @ v - system.K @ u - friction
    h = float(run.field_times[1])
    momentum = system.M @ np.diff(v, axis=1)
    left_over = np.abs(momentum - 0.5 * h * (forces[:, 1:] + forces[:, :-1])).max()
    # Each sum carries the round-off of its terms; the solver's tolerance is a share of them.
    terms = (
        h * float((abs(system.K) @ np.abs(u)).max())
        + h * float((abs(system.C) @ np.abs(v)).max())
        + h * float(np.abs(friction).max(initial=0.0))
        + h * float(np.abs(loads).max())
        + 2.0 * float((abs(system.M) @ np.abs(v)).max())
    )
    share = float(left_over) / terms if terms > 0.0 else 0.0
    return [(share <= max(bound, ENERGY), f"equation of motion off by {share:.2g}")]


def _steadiness(case: Case, run: Run) -> tuple[str, float | None]:
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
