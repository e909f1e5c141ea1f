"""The check on stiff and extreme cases: what it lets pass, what it does not, what it writes."""

from dataclasses import replace
from math import inf

import numpy as np
import pytest
from stability import judge as judging
from stability import references, report, run
from stability.cases import BAR, ONE, PLATE, TWO, UNITS, matrix, quick_matrix
from stability.judge import REFUSED, RIGHT, WRONG, Verdict, judge

from skfem_joint.ground.errors import ConvergenceError
from skfem_joint.minimise import front_elimination
from skfem_joint.minimise.contact_newton import ContactNewton
from skfem_joint.output.record import LIST
from skfem_joint.stepping import steppers

EASY = replace(BAR, elements=(20,), periods=2)
SMALL = replace(PLATE, steps=20)


def values(cases, name):
    return {getattr(case, name) for case in cases}


def test_matrix_has_enough_cases_of_every_axis_and_each_once():
    bars = [case for case in matrix() if not case.is_plate]
    plates = [case for case in matrix() if case.is_plate]
    assert len(bars) > 1000
    assert len(plates) > 300
    # Three laws of two models with five modes stand on the axis of the model and on that of modes.
    assert len({replace(case, axis="", value="") for case in matrix()}) == len(matrix()) - 6
    for cases, name, wanted in (
        (bars, "beta", {1e2, 1e5, 1e12, inf}),
        (bars, "frequency", {0.1, 5e4}),
        (bars, "share", {0.01, 0.999, 1.0, 1.2}),
        (bars, "elements", {(1,), (20_000,)}),
        (bars, "grading", {1.0, 1e4}),
        (bars, "rho", {0.0, 0.5, 0.8, 1.0}),
        (plates, "beta", {1e3, 1e5, 1e9, inf}),
        (plates, "share", {1e-6, 1.0, 2.0}),
        (plates, "pressure", {1.0, 1e12}),
        (plates, "bodies", {*ONE, *TWO}),
        (plates, "aspect", {0.01, 100.0}),
        (plates, "stiffness_ratio", {1e-6, 1e6}),
        (plates, "model", {"full", "reduced", "hyper-reduced"}),
        (plates, "poisson", {0.0, 0.499}),
    ):
        assert values(cases, name) >= wanted
    kinds = {(kind, order) for kind in ("triangle", "quadrilateral") for order in (1, 2)}
    assert {(case.kind, case.order) for case in plates} == kinds


def test_a_quick_matrix_leaves_no_axis_out():
    assert values(quick_matrix(), "axis") == values(matrix(), "axis") - {"drift"}


@pytest.mark.parametrize(
    ("case", "error"),
    [
        *((replace(EASY, beta=beta), 0.01) for beta in (1e2, 1e5, 1e12, inf)),
        *((replace(SMALL, beta=beta, rho=0.5), 0.05) for beta in (1e3, 1e9)),
        *((replace(SMALL, beta=beta), 0.05) for beta in (1e5, inf)),
    ],
)
def test_easy_cases_are_right(case, error):
    verdict = judge(case)
    assert verdict.outcome == RIGHT, verdict.reason
    assert 0.0 < (verdict.error or 0.0) < error
    assert verdict.energy < 1e-10


@pytest.mark.parametrize(
    ("case", "against"),
    [
        (replace(EASY, friction=0.0, force=1e3, rho=0.5), "closed form"),
        (replace(EASY, friction=0.0, force=1e3, frequency=5e3, damping=0.0), "closed form"),
        (replace(EASY, axis="slow", beta=inf, frequency=0.1, steps=400), "closed form"),
        (replace(SMALL, friction=0.0, force=1e3, steps=100), "closed form"),
        *((replace(case, beta=inf, units=[*UNITS][-1]), "same in SI") for case in (EASY, SMALL)),
        (replace(SMALL, beta=inf, turned=37.0), "same unturned"),
        (replace(SMALL, axis="plate as bar", poisson=0.0, direction="along"), "the bar"),
    ],
)
def test_known_answers_are_met(case, against):
    """Closed forms as far as the step goes; the same problem in another guise to round-off."""
    verdict = judge(case)
    assert verdict.outcome == RIGHT, verdict.reason
    assert verdict.against == against
    assert (verdict.error or 0.0) < (0.05 if against == "closed form" else 1e-9)


@pytest.mark.parametrize(("factor", "outcome"), [(0.99, RIGHT), (1.01, REFUSED), (2.0, REFUSED)])
def test_the_explicit_method_is_right_up_to_its_stable_step(factor, outcome):
    case = replace(BAR, elements=(2,), beta=30.0, periods=1, solver="explicit", frequency=5e3)
    verdict = judge(replace(case, step_factor=factor, must_refuse=factor > 1.0))
    assert verdict.outcome == outcome, verdict.reason


def test_an_answer_where_only_a_refusal_is_right_is_wrong():
    assert judge(replace(EASY, must_refuse=True)).outcome == WRONG


def test_an_error_that_does_not_say_what_to_do_is_wrong(monkeypatch):
    def refuse(*_, **__):
        raise ConvergenceError("it did not converge")

    monkeypatch.setattr(references, "integrate", refuse)
    assert judge(EASY).outcome == WRONG


# Steps that are broken on purpose, of bars: the state is damaged after each


def stuck(free):
    return np.abs(free.sigma[:1]) < 1.0


#: By what happens: what does it, and a word that the judge must say.
BROKEN = {
    "velocity grows": (lambda state, free: np.multiply(state.v, 1.01, state.v), ""),
    "displacement drifts": (lambda state, free: np.add(state.u, 1e-9, state.u), ""),
    "friction pushes": (lambda state, free: free.sigma[:1].__imul__(-1.0), "against the slip"),
    "limit is passed": (lambda state, free: free.sigma[:1].__imul__(1.001), "friction force"),
    "stuck points creep": (lambda _, free: free.v[:1].__setitem__(stuck(free), 1e-12), "creep"),
    "nothing": (lambda state, free: None, None),
}


@pytest.mark.parametrize("beta", [1e5, inf])
@pytest.mark.parametrize("what", [*BROKEN])
def test_a_broken_step_is_wrong_in_silence(monkeypatch, what, beta):
    """Done step by step; where nothing is damaged that is right."""
    real, (damage, reason) = steppers.CompiledStepper.advance, BROKEN[what]
    if what == "stuck points creep" and beta < inf:
        reason = ""  # under the arctan law all points creep: it is off its law

    def advance(self, h, amplitudes, first, store):
        for k in range(amplitudes.shape[1] - 1):
            free = self.recorder.free_rows()
            if real(self, h, amplitudes[:, k : k + 2], first + k, store) == 0:
                return k
            damage(self.now, free)
        return int(amplitudes.shape[1]) - 1

    monkeypatch.setattr(steppers.CompiledStepper, "advance", advance)
    verdict = judge(replace(EASY, beta=beta))
    assert verdict.outcome == (RIGHT if reason is None else WRONG)
    assert (reason or "") in verdict.reason


@pytest.mark.parametrize("rho", [1.0, 0.5, 0.0])
def test_half_the_friction_is_seen_by_the_equation_of_motion(monkeypatch, rho):
    """The law, the audit of each step and a quarter of the step all agree with one another."""
    build, make = front_elimination.build_chain, ContactNewton.__init__

    def halved(self, H, points):
        make(self, H, replace(points, w=0.5 * points.w))

    def halved_chain(H, w, beta):
        return build(H, 0.5 * w, beta)

    monkeypatch.setattr(front_elimination, "build_chain", halved_chain)
    monkeypatch.setattr(ContactNewton, "__init__", halved)
    for case in (EASY, SMALL)[: 2 if rho > 0.0 else 1]:
        verdict = judge(replace(case, beta=inf, rho=rho))
        assert verdict.outcome == WRONG
        assert "equation of motion" in verdict.reason


# The same for plates: the solution of every step is damaged


def _leaves_the_line_of_the_slip(problem, found):
    """The same size of force at each point, a thousandth of a radian off."""
    i = problem.points.first_row[:-1][problem.points.directions == 2]
    j = i + 1
    c, s = np.cos(1e-3), np.sin(1e-3)
    sigma = found.sigma.copy()
    sigma[i] = c * sigma[i] - s * found.sigma[j]
    sigma[j] = s * found.sigma[i] + c * found.sigma[j]
    return replace(found, sigma=sigma)


def _creeps(problem, found):
    unknowns = problem.points.unknowns[problem.points.on_rows(problem.points.w) > 0.0]
    v = found.v.copy()
    v[unknowns[v[unknowns] == 0.0]] = 1e-12
    return replace(found, v=v)


def judged_with(monkeypatch, damage, case):
    real = ContactNewton.minimise_beside

    def minimise(self, *args, **rest):
        return damage(self, real(self, *args, **rest))

    monkeypatch.setattr(ContactNewton, "minimise_beside", minimise)
    return judge(case)


@pytest.mark.parametrize(("rho", "beta"), [(1.0, 1e5), (1.0, inf), (0.5, 1e5), (0.5, inf)])
@pytest.mark.parametrize("elements", [(8, 2), (16, 4)], ids=["condensed", "whole"])
@pytest.mark.parametrize(
    ("damage", "reason"),
    [
        (lambda problem, found: replace(found, sigma=-found.sigma), "not against the slip"),
        (lambda problem, found: replace(found, sigma=1.001 * found.sigma), "friction force"),
        (_leaves_the_line_of_the_slip, "not against the slip"),
        (lambda problem, found: replace(found, sigma=0.999 * found.sigma), ""),
        (lambda problem, found: replace(found, v=1.01 * found.v), "equation of motion"),
    ],
)
def test_a_broken_step_of_a_plate_is_wrong_in_silence(
    monkeypatch, damage, reason, elements, rho, beta
):
    case = replace(SMALL, steps=12, elements=elements, rho=rho, beta=beta)
    verdict = judged_with(monkeypatch, damage, case)
    assert verdict.outcome == WRONG
    assert reason in verdict.reason


@pytest.mark.parametrize("bodies", [*ONE, *TWO])
def test_creep_of_stuck_points_of_plates_is_wrong_in_silence(monkeypatch, bodies):
    case = replace(SMALL, beta=inf, bodies=bodies, share=0.5)
    assert judge(case).outcome == RIGHT
    assert "creep" in judged_with(monkeypatch, _creeps, case).reason


# The report


def test_what_is_wrong_is_counted_and_named_and_sets_the_exit_status(tmp_path, monkeypatch, capsys):
    verdicts = [
        Verdict(EASY, RIGHT, error=1e-3, error_bound=0.02, energy=1e-12),
        Verdict(replace(EASY, axis="explicit"), REFUSED, "a step of 1e-5 s; use 2e-6 s"),
        Verdict(replace(EASY, axis="load", value="share | 1"), WRONG, "off", error=0.5),
        Verdict(replace(SMALL, axis="plate scheme"), RIGHT, error=1e-3, error_bound=0.02),
    ]
    monkeypatch.setattr(judging, "judge_all", lambda cases, progress=None: verdicts)
    assert run.main(["--quick", "--out", str(tmp_path)]) == 1
    assert "wrong in silence: load, share | 1: off" in capsys.readouterr().out
    page = (tmp_path / report.PAGE).read_text(encoding="utf-8")
    assert "4 cases: 2 right, 1 refused, 1 wrong in silence" in page
    assert "3 cases are bars, 1 plates." in page
    assert "share / 1" in page
    rows = (tmp_path / report.CASES).read_text(encoding="utf-8").splitlines()
    assert len(rows) == 1 + len(verdicts)
    assert rows[2].endswith(",a step of 1e-5 s; use 2e-6 s")
    assert (tmp_path / report.PICTURE).read_bytes().startswith(b"\x89PNG")


@pytest.mark.slow
def test_a_quick_run_finds_nothing_wrong_in_silence(tmp_path, capsys):
    assert run.main(["--quick", "--out", str(tmp_path)]) == 0
    assert " 0 wrong in silence" in capsys.readouterr().out
    names = {report.PAGE, report.CASES, report.PICTURE}
    assert {file.name for file in tmp_path.iterdir()} == {*names, "summary.json", LIST}
    (tmp_path / LIST).unlink()
    assert run.main(["--quick", "--out", str(tmp_path)]) == 2
    assert "give --overwrite" in capsys.readouterr().err
