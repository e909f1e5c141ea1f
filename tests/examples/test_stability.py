"""The check on stiff and extreme cases: what it lets pass, what it does not, what it writes."""

from dataclasses import replace
from functools import cache
from math import inf

import numpy as np
import pytest
from stability import report
from stability.cases import BAR, ONE, PLATE, TWO, UNITS, matrix, quick_matrix
from stability.judge import REFUSED, RIGHT, WRONG, Verdict, judge, of_error, of_run
from stability.references import modelled, run
from stability.run import tell

from skfem_joint.ground.errors import ConvergenceError, InputError

EASY = replace(BAR, elements=(20,), periods=2)
SMALL = replace(PLATE, steps=20)


def values(cases, name):
    return {getattr(case, name) for case in cases}


def test_the_matrix_has_the_cases_of_the_page_each_once():
    # Three laws of two models with five modes stand on the axis of the model and on that of modes.
    assert len(matrix()) == 1387
    assert len({replace(case, axis="", value="") for case in matrix()}) == len(matrix()) - 6
    assert values(matrix(), "bodies") == {"bar", *ONE, *TWO}
    kinds = {(case.kind, case.order) for case in matrix() if case.is_plate}
    assert kinds == {(kind, n) for kind in ("triangle", "quadrilateral") for n in (1, 2)}


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


@pytest.mark.parametrize(
    ("error", "outcome"),
    [
        (InputError("found 1e-5 s, must be at most 2e-6 s"), REFUSED),
        (ConvergenceError("it did not converge"), WRONG),
        (ZeroDivisionError(), WRONG),
    ],
)
def test_an_error_that_does_not_say_what_to_do_is_wrong(error, outcome):
    assert of_error(EASY, error).outcome == outcome


# Runs that are broken on purpose


@cache
def run_of(case):
    system = modelled(case)
    return system, run(case, system, fields=True)


def broken(found, **damage):
    """Run with some of its arrays changed."""
    return replace(found, **{name: change(getattr(found, name)) for name, change in damage.items()})


def creeping(found):
    """What sticks creeps."""
    system, v = found.system, found.v.copy()
    unknowns = abs(system.contact.B).argmax(axis=1)[system.contact.on_rows(system.contact.w) > 0.0]
    for of_step in v:
        of_step[unknowns[of_step[unknowns] == 0.0]] = 1e-12
    return replace(found, v=v)


#: By what happens: what does it, and a word that the judge must say.
BROKEN = {
    "velocity grows": (lambda run: broken(run, v=lambda v: 1.01 * v), "equation of motion"),
    "it drifts": (
        lambda run: broken(run, u=lambda u: u + 1e-9 * np.arange(len(u))[:, np.newaxis]),
        "equation of motion",
    ),
    "friction pushes": (lambda run: broken(run, sigma=np.negative), "not against the slip"),
    "limit is passed": (lambda run: broken(run, sigma=lambda x: 1.001 * x), "friction force"),
    "less friction": (lambda run: broken(run, sigma=lambda x: 0.999 * x), ""),
    "energy is made": (
        lambda run: broken(run, friction_work=lambda x: -x - 1e-3),
        "friction gives",
    ),
    "its end is off": (lambda run: broken(run, point_u=lambda u: 1.5 * u), "displacement off"),
    "nothing": (lambda run: run, None),
}
BARS = [replace(EASY, beta=beta, rho=rho) for beta in (1e5, inf) for rho in (1.0, 0.5)]
PLATES = [replace(SMALL, steps=12, beta=beta, rho=rho) for beta in (1e5, inf) for rho in (1.0, 0.5)]


@pytest.mark.parametrize("case", [*BARS, *PLATES])
@pytest.mark.parametrize("what", BROKEN)
def test_a_broken_run_is_wrong_in_silence(what, case):
    damage, reason = BROKEN[what]
    system, found = run_of(case)
    verdict = of_run(case, system, damage(found))
    assert verdict.outcome == (RIGHT if reason is None else WRONG), verdict.reason
    assert (reason or "") in verdict.reason


@pytest.mark.parametrize("case", [replace(EASY, beta=inf), *(
    replace(SMALL, beta=inf, bodies=bodies, share=0.5) for bodies in (*ONE, *TWO)
)])  # fmt: skip
def test_creep_of_stuck_points_is_wrong_in_silence(case):
    system, found = run_of(case)
    assert of_run(case, system, found).outcome == RIGHT
    assert "creep" in of_run(case, system, creeping(found)).reason


# The report


def test_what_is_wrong_is_counted_and_named_and_sets_the_exit_status(tmp_path, capsys):
    verdicts = [
        Verdict(EASY, RIGHT, error=1e-3, error_bound=0.02, energy=1e-12),
        Verdict(replace(EASY, axis="explicit"), REFUSED, "a step of 1e-5 s; use 2e-6 s"),
        Verdict(replace(EASY, axis="load", value="share | 1"), WRONG, "off", error=0.5),
        Verdict(replace(SMALL, axis="plate scheme"), RIGHT, error=1e-3, error_bound=0.02),
    ]
    assert tell(tmp_path, verdicts, 1.0) == 1
    assert "wrong in silence: load, share | 1: off" in capsys.readouterr().out
    page = (tmp_path / report.PAGE).read_text(encoding="utf-8")
    assert "4 cases: 2 right, 1 refused, 1 wrong in silence" in page
    assert "3 cases are bars, 1 plates." in page
    assert "share / 1" in page
    rows = (tmp_path / report.CASES).read_text(encoding="utf-8").splitlines()
    assert len(rows) == 1 + len(verdicts)
    assert rows[2].endswith(",a step of 1e-5 s; use 2e-6 s")
    assert (tmp_path / report.PICTURE).read_bytes().startswith(b"\x89PNG")
