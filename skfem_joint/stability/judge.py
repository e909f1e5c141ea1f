"""Judge of a case: its answer is right, or it was refused, or it is wrong in silence."""

from __future__ import annotations

import os
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from contextlib import contextmanager
from dataclasses import dataclass, replace
from math import inf
from multiprocessing import get_context

import numpy as np

from skfem_joint.errors import JointError
from skfem_joint.explicit import stable_step
from skfem_joint.stability.bar_cases import BarCase
from skfem_joint.stability.checks import (
    ASYMMETRY,
    ENERGY,
    law_checks,
    motion_checks,
    passivity_checks,
    round_off_of_energy,
    steadiness,
)
from skfem_joint.stability.problem import Case
from skfem_joint.stability.references import modelled, reference, run

RIGHT, REFUSED, WRONG = "right", "refused", "wrong in silence"
#: Words of a message that says what to do.
REMEDIES = ("use ", "try ", "must be", "give ", "add ", "hold ")


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
        Largest difference of the observed displacements over their largest value, and its bound.
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
        helps = any(word in message.lower() for word in REMEDIES)
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
            order = sorted(range(len(cases)), key=lambda k: -cases[k].work)
            futures = {pool.submit(judge, cases[k]): k for k in order}
            try:
                for future in as_completed(futures):
                    note(futures[future], future.result())
            except KeyboardInterrupt:
                pool.shutdown(wait=False, cancel_futures=True)
                raise
    return [verdicts[index] for index in range(len(cases))]


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
    system = modelled(case)
    if isinstance(case, BarCase) and case.step_factor is not None:
        steps = 1.0 / case.frequency / (case.step_factor * stable_step(system))
        # Rounded so that the step stays on its side of the stable one.
        case = replace(case, steps=int(np.ceil(steps) if case.step_factor < 1.0 else steps))
    found = run(case, system, fields=True)
    against, expected, error_bound = reference(case, found, system)
    scale = float(np.abs(expected).max())
    difference = float(np.abs(found.point_u - expected).max())
    error = difference / scale if scale > 0.0 else (inf if difference > 0.0 else 0.0)
    energy_bound = max(ENERGY, round_off_of_energy(case, found))
    steady, asymmetry = steadiness(case, found)
    failures = [
        text
        for holds, text in (
            (error <= error_bound, f"displacement off by {error:.2g}, allowed {error_bound:.2g}"),
            (
                found.energy_residual <= energy_bound,
                f"energy audit open by {found.energy_residual:.2g}, allowed {energy_bound:.2g}",
            ),
            (
                asymmetry is None or asymmetry <= ASYMMETRY,
                f"symmetric load, loop asymmetric by {asymmetry or 0.0:.2g}",
            ),
            *law_checks(found),
            *passivity_checks(found, energy_bound),
            *motion_checks(case, found, energy_bound),
        )
        if not holds
    ]
    counters = found.counters
    return Verdict(
        case=case,
        outcome=WRONG if failures else RIGHT,
        reason="; ".join(failures),
        against=against,
        error=error,
        error_bound=error_bound,
        energy=found.energy_residual,
        energy_bound=energy_bound,
        steady=steady,
        asymmetry=asymmetry,
        iterations=counters.newton_iterations / counters.steps,
        largest_iterations=counters.largest_iterations,
        nested=counters.nested_solves,
        descents=counters.descents,
        halved=counters.halved_steps,
    )
