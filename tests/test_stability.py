"""The check on stiff and extreme cases: what it lets pass, what it does not, what it writes."""

from __future__ import annotations

import csv
from collections.abc import Callable
from dataclasses import replace
from math import inf
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from skfem_joint import cli, kernels_tridiagonal
from skfem_joint.errors import ConvergenceError
from skfem_joint.history import hysteresis_loop
from skfem_joint.integrate import integrate
from skfem_joint.recording import Rows
from skfem_joint.stability import judge as judging
from skfem_joint.stability import report
from skfem_joint.stability.cases import Case, matrix, quick_matrix, system_of
from skfem_joint.stability.judge import REFUSED, RIGHT, WRONG, Verdict, judge, judge_all

EASY = Case(elements=20, periods=2)


def test_matrix_has_enough_cases_of_every_axis_and_each_once() -> None:
    cases = matrix()
    assert len(cases) >= 500
    assert len(set(cases)) >= 0.95 * len(cases)
    assert {case.beta for case in cases} >= {1e2, 1e5, 1e12, inf}
    assert {case.frequency for case in cases} >= {0.1, 5e4}
    assert {case.share for case in cases} >= {0.01, 0.999, 1.0, 1.2}
    assert {case.elements for case in cases} >= {1, 20_000}
    assert {case.grading for case in cases} >= {1.0, 1e4}
    assert {case.rho for case in cases} == {0.0, 0.5, 0.8, 1.0}
    assert {case.axis for case in quick_matrix()} >= {case.axis for case in cases} - {"drift"}


@pytest.mark.parametrize("beta", [1e2, 1e5, 1e12, inf])
def test_easy_cases_are_right(beta: float) -> None:
    verdict = judge(replace(EASY, beta=beta))
    assert verdict.outcome == RIGHT, verdict.reason
    assert verdict.error is not None
    assert 0.0 < verdict.error < 0.01
    assert verdict.energy is not None
    assert verdict.energy < 1e-10


@pytest.mark.parametrize(
    "case",
    [
        replace(EASY, friction=0.0, force=1e3, rho=0.5),
        replace(EASY, friction=0.0, force=1e3, frequency=5000.0, damping=0.0),
        replace(EASY, axis="slow", beta=inf, frequency=0.1, steps=400),
    ],
)
def test_closed_forms_are_met(case: Case) -> None:
    verdict = judge(case)
    assert verdict.against == "closed form"
    assert verdict.outcome == RIGHT, verdict.reason


def test_the_closed_form_of_the_resonant_oscillator_grows_without_damping() -> None:
    case = Case(elements=1, friction=0.0, damping=0.0, force=1.0)
    system = system_of(case)
    omega = float(np.sqrt(system.K.toarray() / system.M.toarray())[0, 0])
    case = replace(case, frequency=omega / 2.0 / np.pi)
    times = np.linspace(0.0, 20.0 / case.frequency, 5)
    u = judging.linear_response(case, system_of(case), times)
    expected = (np.sin(omega * times) - omega * times * np.cos(omega * times)) / 2.0
    np.testing.assert_allclose(u, expected / system.K.toarray()[0, 0], rtol=1e-6, atol=1e-24)


@pytest.mark.parametrize("units", ["mm, t, s", "um, kg, us", "km, g, h"])
def test_units_do_not_matter(units: str) -> None:
    verdict = judge(replace(EASY, units=units, beta=inf))
    assert verdict.outcome == RIGHT, verdict.reason
    assert verdict.error is not None
    assert verdict.error < 1e-9


@pytest.mark.parametrize(("factor", "outcome"), [(0.99, RIGHT), (1.01, REFUSED), (2.0, REFUSED)])
def test_the_explicit_method_is_right_up_to_its_stable_step(factor: float, outcome: str) -> None:
    case = Case(elements=2, beta=30.0, periods=1, solver="explicit", frequency=5000.0)
    verdict = judge(replace(case, step_factor=factor, must_refuse=factor > 1.0))
    assert verdict.outcome == outcome, verdict.reason


def test_an_answer_where_only_a_refusal_is_right_is_wrong() -> None:
    assert judge(replace(EASY, must_refuse=True)).outcome == WRONG


def test_an_error_that_does_not_say_what_to_do_is_wrong(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any, **__: Any) -> None:
        raise ConvergenceError("it did not converge")

    monkeypatch.setattr(judging, "integrate", refuse)
    assert judge(EASY).outcome == WRONG


# A step that is broken on purpose


def _stepwise(damage: Callable[[Any, Any], None]) -> Callable[..., Any]:
    """The compiled march, step by step, with the state damaged after each."""
    real = kernels_tridiagonal.march

    def march(n_steps: int, first: int, *arguments: Any) -> tuple[int, int, int, float, int]:
        every, fields_every, coefficients, bands, chain, tolerance, loads = arguments[:7]
        amplitude, points, contact, state, sums, stored = arguments[7:]
        rows, fields, residual, row = 0, 0, 0.0, 0
        for k in range(n_steps):
            free = Rows(
                *(x[fields:] for x in stored[:3]), *(x[rows:] for x in stored[3:])
            )  # fmt: skip
            now = np.ascontiguousarray(amplitude[:, k : k + 2])
            done, more_rows, more_fields, residual, row = real(
                1, first + k, every, fields_every, coefficients, bands, chain, tolerance, loads,
                now, points, contact, state, sums, free,
            )  # fmt: skip
            rows, fields = rows + more_rows, fields + more_fields
            if done == 0:
                return k, rows, fields, residual, row
            damage(state, free)
        return n_steps, rows, fields, residual, row

    return march


def _velocity_grows(state: Any, free: Any) -> None:
    state[1] *= 1.01


def _displacement_drifts(state: Any, free: Any) -> None:
    state[0] += 1e-9


def _friction_pushes(state: Any, free: Any) -> None:
    if free.sigma.shape[0] > 0:
        free.sigma[0] *= -1.0


def _friction_passes_its_limit(state: Any, free: Any) -> None:
    if free.sigma.shape[0] > 0:
        free.sigma[0] *= 1.001


def _stuck_points_creep(state: Any, free: Any) -> None:
    if free.v.shape[0] > 0:
        free.v[0][np.abs(free.sigma[0]) < 1.0] = 1e-12


@pytest.mark.parametrize("beta", [1e5, inf])
@pytest.mark.parametrize(
    "damage",
    [_velocity_grows, _displacement_drifts, _friction_pushes, _friction_passes_its_limit],
)
def test_a_broken_step_is_wrong_in_silence(
    monkeypatch: pytest.MonkeyPatch, damage: Callable[[Any, Any], None], beta: float
) -> None:
    monkeypatch.setattr(kernels_tridiagonal, "march", _stepwise(damage))
    (verdict,) = judge_all([replace(EASY, beta=beta)], workers=0)
    assert verdict.outcome == WRONG
    assert verdict.reason


def test_creep_of_stuck_points_is_wrong_in_silence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kernels_tridiagonal, "march", _stepwise(_stuck_points_creep))
    verdict = judge(replace(EASY, beta=inf))
    assert verdict.outcome == WRONG
    assert "creep" in verdict.reason


def test_a_step_that_is_not_broken_is_right_done_the_same_way(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(kernels_tridiagonal, "march", _stepwise(lambda state, free: None))
    assert judge(replace(EASY, beta=inf)).outcome == RIGHT


def test_half_the_friction_is_seen_by_the_equation_of_motion(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from skfem_joint import steppers

    real = steppers.build_chain
    monkeypatch.setattr(
        steppers, "build_chain", lambda H0, H1, w, beta: real(H0, H1, 0.5 * w, beta)
    )
    verdict = judge(replace(EASY, beta=inf))
    assert verdict.outcome == WRONG
    assert "equation of motion" in verdict.reason


# The report


def test_the_steady_loop_is_symmetric_about_its_middle() -> None:
    case = replace(EASY, beta=inf, periods=6)
    verdict = judge(case)
    assert verdict.steady == "reached"
    assert verdict.asymmetry is not None
    assert verdict.asymmetry < 1e-3
    run = integrate(system_of(case), step=case.step, n_steps=600, cycle_steps=100)
    u, force = hysteresis_loop(run, "free_end", rows_per_cycle=100)
    area = 0.5 * np.sum((u[1:] - u[:-1]) * (force[1:] + force[:-1]))
    assert area == pytest.approx(run.cycles.input[-1, 0], rel=1e-9)


def _verdicts() -> list[Verdict]:
    return [
        Verdict(EASY, RIGHT, error=1e-3, error_bound=0.02, energy=1e-12, energy_bound=1e-8),
        Verdict(replace(EASY, axis="explicit"), REFUSED, "a step of 1e-5 s; use 2e-6 s"),
        Verdict(replace(EASY, axis="load", value="share | 1"), WRONG, "off", error=0.5),
    ]


def test_the_page_counts_and_names_what_is_wrong(tmp_path: Path) -> None:
    files = report.write(tmp_path, _verdicts(), 12.0)
    assert all(file.stat().st_size > 0 for file in files)
    page = files[0].read_text(encoding="utf-8")
    assert "3 cases: 1 right, 1 refused, 1 wrong in silence, in 12 s." in page
    assert "## Wrong in silence" in page
    assert "share \\| 1" in page
    with files[1].open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [row["outcome"] for row in rows] == [RIGHT, REFUSED, WRONG]


def test_the_command_says_what_is_wrong(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(judging, "judge_all", lambda cases, progress: _verdicts())
    assert cli.main(["stability", "--quick", "--out", str(tmp_path)]) == 1
    assert "wrong in silence: load, share | 1: off" in capsys.readouterr().out


def test_a_quick_run_finds_nothing_wrong_in_silence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["stability", "--quick", "--out", str(tmp_path)]) == 0
    assert " 0 wrong in silence" in capsys.readouterr().out
    assert {file.name for file in tmp_path.iterdir()} == {
        report.PAGE,
        report.TABLE,
        report.PICTURE,
    }
