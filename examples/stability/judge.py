"""Judge of a case: its answer is right, or it was refused, or it is wrong in silence."""

import os
import time
import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass, replace
from math import inf
from multiprocessing import get_context

import numpy as np
from benchmarks.explicit import stable_step

from skfem_joint.errors import JointError
from stability import checks
from stability.problem import Case
from stability.references import modelled, reference, run

RIGHT, REFUSED, WRONG = "right", "refused", "wrong in silence"
#: Words of a message that says what to do.
REMEDIES = ("use ", "try ", "must be", "give ", "add ", "hold ")
#: Variables that keep linear algebra to one thread.
THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


@dataclass(frozen=True)
class Verdict:
    """What became of a case."""

    case: Case
    outcome: str  # RIGHT, REFUSED or WRONG
    reason: str = ""  # the checks that failed, or the message of the refusal
    against: str = ""  # what the displacement was compared with
    error: float | None = None  # largest difference of the points over their largest value,
    error_bound: float | None = None  # and its bound
    energy: float | None = None  # left over in the audit, over the energy in play,
    energy_bound: float | None = None  # and its bound
    steady: str = ""  # a harmonic run's steady state: "reached" or "not reached"
    asymmetry: float | None = None  # of the steady loop, see `checks.steadiness`
    iterations: float = 0.0  # of Newton's method a step,
    largest_iterations: int = 0  # and most in one
    nested: int = 0  # steps that needed the second tier of the solver,
    descents: int = 0  # the third,
    halved: int = 0  # or parts
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
        helps = any(word in message.lower() for word in REMEDIES)
        outcome = REFUSED if helps else WRONG
        verdict = Verdict(case, outcome, message if helps else f"no remedy named: {message}")
    except (ArithmeticError, ValueError, IndexError, RuntimeError, Warning) as error:
        verdict = Verdict(case, WRONG, f"{type(error).__name__}: {error}")
    if case.must_refuse and verdict.outcome == RIGHT:
        verdict = replace(verdict, outcome=WRONG, reason="should have been refused")
    return replace(verdict, seconds=time.perf_counter() - begin)


def judge_all(
    cases: Sequence[Case], progress: Callable[[str, int, int], None] | None = None
) -> list[Verdict]:
    """Judge cases in two processes; verdicts in the order of the cases.

    ``progress`` is called with (label, cases done, cases in all).
    """
    os.environ.update(dict.fromkeys(THREADS, "1"))
    verdicts: dict[int, Verdict] = {}
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        # The longest first, so that no worker is left alone with one at the end.
        order = sorted(range(len(cases)), key=lambda k: -cases[k].work)
        futures = {pool.submit(judge, cases[k]): k for k in order}
        try:
            for future in as_completed(futures):
                verdicts[futures[future]] = future.result()
                if progress is not None:
                    progress("stiff and extreme cases", len(verdicts), len(cases))
        except KeyboardInterrupt:
            pool.shutdown(wait=False, cancel_futures=True)
            raise
    return [verdicts[index] for index in range(len(cases))]


def _judge(case: Case) -> Verdict:
    system = modelled(case)
    if case.step_factor is not None:
        steps = 1.0 / case.frequency / (case.step_factor * stable_step(system))
        # Rounded so that the step stays on its side of the stable one.
        case = replace(case, steps=int(np.ceil(steps) if case.step_factor < 1.0 else steps))
    found = run(case, system, fields=True)
    against, expected, error_bound = reference(case, found, system)
    scale = float(np.abs(expected).max())
    difference = float(np.abs(found.point_u - expected).max())
    error = difference / scale if scale > 0.0 else (inf if difference > 0.0 else 0.0)
    energy, energy_bound = found.energy_residual, checks.energy_bound(case, found)
    steady, asymmetry = checks.steadiness(case, found)
    all_checks = [
        (error <= error_bound, f"displacement off by {error:.2g}, allowed {error_bound:.2g}"),
        (energy <= energy_bound, f"energy audit open by {energy:.2g}, allowed {energy_bound:.2g}"),
        (
            asymmetry is None or asymmetry <= checks.ASYMMETRY,
            f"symmetric load, loop asymmetric by {asymmetry or 0.0:.2g}",
        ),
        *checks.law_checks(found),
        *checks.passivity_checks(found, energy_bound),
        *checks.motion_checks(case, found, energy_bound),
    ]
    failures = [text for holds, text in all_checks if not holds]
    counters = found.counters
    return Verdict(
        case=case,
        outcome=WRONG if failures else RIGHT,
        reason="; ".join(failures),
        against=against,
        error=error,
        error_bound=error_bound,
        energy=energy,
        energy_bound=energy_bound,
        steady=steady,
        asymmetry=asymmetry,
        iterations=counters.newton_iterations / counters.steps,
        largest_iterations=counters.largest_iterations,
        nested=counters.nested_solves,
        descents=counters.descents,
        halved=counters.halved_steps,
    )
