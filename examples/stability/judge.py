"""Judge cases: an answer is right, refused, or wrong in silence."""

import warnings
from dataclasses import dataclass, replace
from math import inf

import numpy as np
from benchmarks.explicit import stable_step

from skfem_joint.ground.errors import JointError
from skfem_joint.study.sweep import processes
from stability import checks
from stability.cases import Case
from stability.references import modelled, reference, run

RIGHT, REFUSED, WRONG = "right", "refused", "wrong in silence"


@dataclass(frozen=True)
class Verdict:
    """Outcome of a case."""

    case: Case
    outcome: str  # RIGHT, REFUSED or WRONG
    reason: str = ""  # the checks that failed, or the message of the refusal
    against: str = ""  # what the displacement was compared with
    error: float | None = None  # largest difference of the points over their largest value,
    error_bound: float | None = None  # and its bound
    energy: float | None = None  # left over in the audit, over the energy in play
    steady: str = ""  # a harmonic run's steady state: "reached" or "not reached"
    iterations: float = 0.0  # of Newton's method a step,
    largest_iterations: int = 0  # and the most in a step
    fallbacks: int = 0  # steps that needed the second tier of the solver, or the third,
    halved: int = 0  # or parts


def judge(case):
    """Run a case and judge it.

    An exception that is not one of the package's own counts as wrong, and so does a warning of
    numpy: neither says what to do. So does an error of the package that names no remedy.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            system = modelled(case)
            case = with_steps(case, system)
            verdict = of_run(case, system, run(case, system, fields=True))
    except (JointError, ArithmeticError, ValueError, IndexError, RuntimeError, Warning) as error:
        return of_error(case, error)
    if case.must_refuse and verdict.outcome == RIGHT:
        return replace(verdict, outcome=WRONG, reason="should have been refused")
    return verdict


def of_error(case, error):
    """Verdict on a case that ended with an error."""
    if not isinstance(error, JointError):
        return Verdict(case, WRONG, f"{type(error).__name__}: {error}")
    message = " ".join(str(error).split())
    remedies = ("use ", "try ", "must be", "give ", "add ", "hold ")
    if any(word in message.lower() for word in remedies):
        return Verdict(case, REFUSED, message)
    return Verdict(case, WRONG, f"no remedy named: {message}")


def judge_all(cases, progress):
    """Judge cases in two processes; verdicts in the order of the cases.

    ``progress`` is called with (label, cases done, cases in all).
    """
    verdicts = {}
    # The longest cases go first, so that the workers finish at about the same time.
    order = sorted(range(len(cases)), key=lambda k: -cases[k].work)
    with processes(2) as pool:
        judged = pool.map(judge, [cases[k] for k in order])
        for k, verdict in zip(order, judged, strict=True):
            verdicts[k] = verdict
            progress("stiff and extreme cases", len(verdicts), len(cases))
    return [verdicts[index] for index in range(len(cases))]


def with_steps(case, system):
    """Case with the steps of its share of the stable step, rounded to its side of that."""
    if case.step_factor is None:
        return case
    steps = 1.0 / case.frequency / (case.step_factor * stable_step(system))
    return replace(case, steps=int(np.ceil(steps) if case.step_factor < 1.0 else steps))


def of_run(case, system, result):
    """Verdict on a run of a case's system."""
    against, expected, error_bound = reference(case, result, system)
    scale, off = np.abs(expected).max(), np.abs(result.point_u - expected).max()
    error = off / scale if scale > 0.0 else (inf if off > 0.0 else 0.0)
    energy, bound = result.energy_residual, checks.energy_bound(case, result)
    steady, asymmetry = checks.steadiness(case, result)
    all_checks = [
        (error <= error_bound, f"displacement off by {error:.2g}, allowed {error_bound:.2g}"),
        (energy <= bound, f"energy audit open by {energy:.2g}, allowed {bound:.2g}"),
        (asymmetry <= checks.ASYMMETRY, f"symmetric load, loop asymmetric by {asymmetry:.2g}"),
        *checks.law_checks(result),
        *checks.passivity_checks(result, bound),
        *checks.motion_checks(case, result, bound),
    ]
    failures = [text for holds, text in all_checks if not holds]
    counters = result.counters
    return Verdict(
        *(case, WRONG if failures else RIGHT, "; ".join(failures), against),
        *(float(error), error_bound, energy, steady),
        iterations=counters.newton_iterations / counters.steps,
        largest_iterations=counters.largest_iterations,
        fallbacks=counters.nested_solves + counters.descents,
        halved=counters.halved_steps,
    )
