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

from skfem_joint import cli, kernels_tridiagonal, steppers, steppers_contact
from skfem_joint.contact_solver import ContactProblem, Solution
from skfem_joint.errors import ConvergenceError
from skfem_joint.history import hysteresis_loop
from skfem_joint.integrate import integrate
from skfem_joint.recording import Recorder, Rows, Save
from skfem_joint.schemes import generalized_alpha
from skfem_joint.stability import judge as judging
from skfem_joint.stability import references, report
from skfem_joint.stability.bar_cases import BarCase, bars, system_of
from skfem_joint.stability.cases import quick_matrix
from skfem_joint.stability.judge import REFUSED, RIGHT, WRONG, Verdict, judge, judge_all
from skfem_joint.stability.plate_cases import ONE, TWO, PlateCase, plates
from skfem_joint.stability.problem import Case

EASY = BarCase(elements=20, periods=2)
PLATE = PlateCase(steps=20)


def test_matrix_has_enough_bars_of_every_axis_and_each_once() -> None:
    cases = bars()
    assert len(cases) >= 500
    assert len(set(cases)) >= 0.95 * len(cases)
    assert {case.beta for case in cases} >= {1e2, 1e5, 1e12, inf}
    assert {case.frequency for case in cases} >= {0.1, 5e4}
    assert {case.share for case in cases} >= {0.01, 0.999, 1.0, 1.2}
    assert {case.elements for case in cases} >= {1, 20_000}
    assert {case.grading for case in cases} >= {1.0, 1e4}
    assert {case.rho for case in cases} == {0.0, 0.5, 0.8, 1.0}


def test_matrix_has_enough_plates_of_every_axis_and_each_once() -> None:
    cases = plates()
    assert len(cases) >= 300
    assert len(set(cases)) >= 0.95 * len(cases)
    assert {case.beta for case in cases} >= {1e3, 1e5, 1e9, inf}
    assert {case.rho for case in cases} == {0.0, 0.5, 1.0}
    assert {case.share for case in cases} >= {1e-6, 1.0, 2.0}
    assert {case.pressure for case in cases} >= {1.0, 1e12}
    assert {case.bodies for case in cases} == {*ONE, *TWO}
    assert {(case.kind, case.order) for case in cases} == {
        (kind, order) for kind in ("triangle", "quadrilateral") for order in (1, 2)
    }
    assert {case.aspect for case in cases} >= {0.01, 100.0}
    assert {case.stiffness_ratio for case in cases} >= {1e-6, 1e6}
    assert {(case.plane, case.poisson) for case in cases} >= {("strain", 0.499), ("stress", 0.0)}
    assert {case.model for case in cases} == {"full", "reduced", "hyper-reduced"}


def test_a_quick_matrix_leaves_no_axis_out() -> None:
    axes = {case.axis for case in (*bars(), *plates())}
    assert {case.axis for case in quick_matrix()} == axes - {"drift"}


def test_plates_are_condensed_to_their_contact_or_solved_whole() -> None:
    def matrix_of(case: PlateCase) -> str:
        system = references.modelled(case)
        recorder = Recorder(system, Save(), 1, case.step)
        stepper = steppers.choose(
            system, generalized_alpha(), np.zeros(system.n), np.zeros(system.n), 1e-11, recorder
        )
        stepper.advance(case.step, np.zeros((1, 1)), 0, False)
        assert isinstance(stepper, steppers_contact.ContactStepper)
        return type(next(iter(stepper.matrices.values()))).__name__

    cases = [case for case in plates() if case.axis == "plate elements" and case.beta == inf]
    assert {matrix_of(case) for case in cases} == {"_Condensed", "ContactProblem"}


@pytest.mark.parametrize("beta", [1e2, 1e5, 1e12, inf])
def test_easy_cases_are_right(beta: float) -> None:
    verdict = judge(replace(EASY, beta=beta))
    assert verdict.outcome == RIGHT, verdict.reason
    assert verdict.error is not None
    assert 0.0 < verdict.error < 0.01
    assert verdict.energy is not None
    assert verdict.energy < 1e-10


@pytest.mark.parametrize("beta", [1e3, 1e5, 1e9, inf])
@pytest.mark.parametrize("rho", [1.0, 0.5])
def test_easy_plates_are_right(beta: float, rho: float) -> None:
    verdict = judge(replace(PLATE, beta=beta, rho=rho))
    assert verdict.outcome == RIGHT, verdict.reason
    assert verdict.error is not None
    assert 0.0 < verdict.error < 0.05
    assert verdict.energy is not None
    assert verdict.energy < 1e-10


@pytest.mark.parametrize(
    "case",
    [
        replace(EASY, friction=0.0, force=1e3, rho=0.5),
        replace(EASY, friction=0.0, force=1e3, frequency=5000.0, damping=0.0),
        replace(EASY, axis="slow", beta=inf, frequency=0.1, steps=400),
        replace(PLATE, friction=0.0, force=1e3, steps=100),
    ],
)
def test_closed_forms_are_met(case: Case) -> None:
    verdict = judge(case)
    assert verdict.against == "closed form"
    assert verdict.outcome == RIGHT, verdict.reason


def test_the_closed_form_of_the_resonant_oscillator_grows_without_damping() -> None:
    case = BarCase(elements=1, friction=0.0, damping=0.0, force=1.0)
    system = system_of(case)
    omega = float(np.sqrt(system.K.toarray() / system.M.toarray())[0, 0])
    case = replace(case, frequency=omega / 2.0 / np.pi)
    times = np.linspace(0.0, 20.0 / case.frequency, 5)
    u = references.linear_response(case, system_of(case), times)[:, 0]
    expected = (np.sin(omega * times) - omega * times * np.cos(omega * times)) / 2.0
    np.testing.assert_allclose(u, expected / system.K.toarray()[0, 0], rtol=1e-6, atol=1e-24)


@pytest.mark.parametrize("units", ["mm, t, s", "um, kg, us", "km, g, h"])
@pytest.mark.parametrize("case", [EASY, PLATE])
def test_units_do_not_matter(units: str, case: Case) -> None:
    verdict = judge(replace(case, units=units, beta=inf))
    assert verdict.outcome == RIGHT, verdict.reason
    assert verdict.error is not None
    assert verdict.error < 1e-9


@pytest.mark.parametrize(("factor", "outcome"), [(0.99, RIGHT), (1.01, REFUSED), (2.0, REFUSED)])
def test_the_explicit_method_is_right_up_to_its_stable_step(factor: float, outcome: str) -> None:
    case = BarCase(elements=2, beta=30.0, periods=1, solver="explicit", frequency=5000.0)
    verdict = judge(replace(case, step_factor=factor, must_refuse=factor > 1.0))
    assert verdict.outcome == outcome, verdict.reason


@pytest.mark.parametrize(
    ("case", "against"),
    [
        (replace(PLATE, turned=37.0), "same unturned"),
        (replace(PLATE, axis="plate as bar", poisson=0.0, direction="along"), "the bar"),
    ],
)
@pytest.mark.parametrize("beta", [1e5, inf])
def test_turned_plates_and_plates_without_contraction_are_known(
    case: PlateCase, against: str, beta: float
) -> None:
    verdict = judge(replace(case, beta=beta))
    assert verdict.outcome == RIGHT, verdict.reason
    assert verdict.against == against
    assert verdict.error is not None
    assert verdict.error < 1e-9


def test_an_answer_where_only_a_refusal_is_right_is_wrong() -> None:
    assert judge(replace(EASY, must_refuse=True)).outcome == WRONG


def test_an_error_that_does_not_say_what_to_do_is_wrong(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any, **__: Any) -> None:
        raise ConvergenceError("it did not converge")

    monkeypatch.setattr(references, "integrate", refuse)
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


@pytest.mark.parametrize("rho", [1.0, 0.5, 0.0])
def test_half_the_friction_is_seen_by_the_equation_of_motion(
    monkeypatch: pytest.MonkeyPatch, rho: float
) -> None:
    real = steppers.build_chain
    monkeypatch.setattr(
        steppers, "build_chain", lambda H0, H1, w, beta: real(H0, H1, 0.5 * w, beta)
    )
    verdict = judge(replace(EASY, beta=inf, rho=rho))
    assert verdict.outcome == WRONG
    assert "equation of motion" in verdict.reason


# The same for plates: the solution of every step is damaged


def _pushes(problem: ContactProblem, found: Solution) -> Solution:
    return replace(found, sigma=-found.sigma)


def _passes_the_limit(problem: ContactProblem, found: Solution) -> Solution:
    return replace(found, sigma=1.001 * found.sigma)


def _leaves_the_line_of_the_slip(problem: ContactProblem, found: Solution) -> Solution:
    """The same size of force at each point, a thousandth of a radian off."""
    i, j = (x[problem.second >= 0] for x in problem.points)
    c, s = np.cos(1e-3), np.sin(1e-3)
    sigma = found.sigma.copy()
    sigma[i], sigma[j] = (
        c * sigma[i] - s * found.sigma[j],
        s * found.sigma[i] + c * found.sigma[j],
    )
    return replace(found, sigma=sigma)


def _leaves_the_law(problem: ContactProblem, found: Solution) -> Solution:
    return replace(found, sigma=0.999 * found.sigma)


def _creeps(problem: ContactProblem, found: Solution) -> Solution:
    acts = problem.w > 0.0
    unknowns = np.concatenate([x[acts & (x >= 0)] for x in problem.points])
    v = found.v.copy()
    v[unknowns[v[unknowns] == 0.0]] = 1e-12
    return replace(found, v=v)


def _grows(problem: ContactProblem, found: Solution) -> Solution:
    return replace(found, v=1.01 * found.v)


def _damaged(
    monkeypatch: pytest.MonkeyPatch, damage: Callable[[ContactProblem, Solution], Solution]
) -> None:
    real = ContactProblem.solve
    monkeypatch.setattr(
        ContactProblem, "solve", lambda self, *args, **rest: damage(self, real(self, *args, **rest))
    )


@pytest.mark.parametrize("beta", [1e5, inf])
@pytest.mark.parametrize("rho", [1.0, 0.5])
@pytest.mark.parametrize("elements", [(8, 2), (16, 4)], ids=["condensed", "whole"])
@pytest.mark.parametrize(
    ("damage", "reason"),
    [
        (_pushes, "not against the slip"),
        (_passes_the_limit, "friction force"),
        (_leaves_the_line_of_the_slip, "not against the slip"),
        (_leaves_the_law, ""),
        (_grows, "equation of motion"),
    ],
)
def test_a_broken_step_of_a_plate_is_wrong_in_silence(
    monkeypatch: pytest.MonkeyPatch,
    damage: Callable[[ContactProblem, Solution], Solution],
    reason: str,
    elements: tuple[int, int],
    rho: float,
    beta: float,
) -> None:
    _damaged(monkeypatch, damage)
    verdict = judge(replace(PLATE, steps=12, elements=elements, rho=rho, beta=beta))
    assert verdict.outcome == WRONG
    assert reason in verdict.reason


@pytest.mark.parametrize("bodies", [*ONE, *TWO])
def test_creep_of_stuck_points_of_plates_is_wrong_in_silence(
    monkeypatch: pytest.MonkeyPatch, bodies: str
) -> None:
    case = replace(PLATE, beta=inf, bodies=bodies, share=0.5)
    assert judge(case).outcome == RIGHT
    _damaged(monkeypatch, _creeps)
    verdict = judge(case)
    assert verdict.outcome == WRONG
    assert "creep" in verdict.reason


@pytest.mark.parametrize("rho", [1.0, 0.5])
def test_half_the_friction_of_a_plate_is_seen_by_the_equation_of_motion(
    monkeypatch: pytest.MonkeyPatch, rho: float
) -> None:
    """The law, the audit of each step and a quarter of the step all agree with one another."""
    real = steppers_contact.ContactProblem
    monkeypatch.setattr(
        steppers_contact,
        "ContactProblem",
        lambda A, first, second, w, beta: real(A, first, second, 0.5 * w, beta),
    )
    verdict = judge(replace(PLATE, beta=inf, rho=rho))
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
        Verdict(replace(PLATE, axis="plate scheme"), RIGHT, error=1e-3, error_bound=0.02),
    ]


def test_the_page_counts_and_names_what_is_wrong(tmp_path: Path) -> None:
    files = report.write(tmp_path, _verdicts(), 12.0)
    assert all(file.stat().st_size > 0 for file in files)
    page = files[0].read_text(encoding="utf-8")
    assert "4 cases: 2 right, 1 refused, 1 wrong in silence, in 12 s." in page
    assert "3 cases are bars, 1 plates." in page
    assert "## Wrong in silence" in page
    assert "share \\| 1" in page
    with files[1].open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    assert [row["outcome"] for row in rows] == [RIGHT, REFUSED, WRONG, RIGHT]


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
