"""Rows that judge a reduced model: by the paper's own error, and by this project's aims."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from skfem_joint.history import Errors
from skfem_joint.paper.cases import Case, study
from skfem_joint.paper.items import Row, against, percent, published
from skfem_joint.study import Study

#: Modes tried when it is asked how many an aim takes.
MOST_MODES = 15


def points_row(
    quantity: str, printed: float, ours: float, within: float, otherwise: str = "differs"
) -> Row:
    """Row of a printed percentage; the difference is in percentage points."""
    return replace(
        against(quantity, printed, ours, within=within, otherwise=otherwise, form=".3g"),
        difference=f"{ours - printed:+.2f} points",
    )


def below(quantity: str, printed: str, limit: str, value: float, otherwise: str) -> Row:
    """Row of a reduced model's error (percent) of which the paper prints an upper limit.

    Parameters
    ----------
    printed : str
        The paper's words.
    limit : str
        The limit that they mean, as printed: ``< 2``.
    otherwise : str
        Why, if the error is not below it.
    """
    met = abs(value) < float(limit.removeprefix("<"))
    verdict = "agrees" if met else f"differs: {otherwise}"
    return Row(quantity, printed, None, f"{value:.2f} %", "", verdict)


def reduced_row(
    quantity: str,
    printed: float,
    printed_error: float,
    ours: float,
    full: float,
    why: str = "",
    around: float = 0.0,
) -> Row:
    """Row of a reduced model's result: judged by its distance from its own full model.

    Parameters
    ----------
    printed, printed_error : float
        The paper's result, and its distance from the paper's full model in percent.
    ours, full : float
        Our reduced model's result and our full model's.
    why : str
        Reason, if ours is farther from its full model.
    around : float
        Whole number of percent that the text allows itself beside the printed error.
    """
    error = percent(ours, full)
    within = 0.05  # percent: the last digit that the paper prints
    if abs(error) < printed_error - within:
        verdict = "better than published"
    elif abs(error) <= printed_error + within:
        verdict = "agrees"
    elif abs(error) < around + 0.5:
        verdict = f"agrees within the paper's own tolerance (around {around:g} %)"
    else:
        verdict = f"differs: {error:+.2g} % from our full model, published {printed_error:g} %"
        verdict += f"; {why}" if why else ""
    return Row(quantity, printed, full, ours, f"{percent(ours, printed):+.2g} %", verdict)


def errors_of(found: Study) -> Errors:
    """Errors of a study's reduced model against its full one."""
    errors = found.models["reduced"].errors
    if errors is None:
        raise ValueError("the study has no full model to compare with")
    return errors


def _energy(errors: Errors) -> float:
    per_cycle = errors.friction_energy_per_cycle
    return errors.friction_energy if per_cycle is None else per_cycle


def aims_met(errors: Errors) -> tuple[bool, bool]:
    """Whether the peak displacement and the friction energy are as close as we ask."""
    aim = published()["aim"]
    return (
        100.0 * abs(errors.peak_displacement) <= aim["displacement_percent"],
        100.0 * abs(_energy(errors)) <= aim["friction_energy_percent"],
    )


def aim_rows(name: str, errors: Errors) -> list[Row]:
    """Rows of this project's aims for the default reduction with five modes."""
    aim = published()["aim"]
    peak, energy = aims_met(errors)
    words = {True: "meets the aim", False: "misses the aim"}
    return [
        Row(
            f"{name}, aim: error of the peak, five modes",
            f"aim: <= {aim['displacement_percent']:g} %",
            None,
            f"{100.0 * errors.peak_displacement:+.2f} %",
            f"at any time {100.0 * errors.displacement_max:.2f} %",
            words[peak],
        ),
        Row(
            f"{name}, aim: error of the friction energy, five modes",
            f"aim: <= {aim['friction_energy_percent']:g} %",
            None,
            f"{100.0 * _energy(errors):+.2f} %",
            "",
            words[energy],
        ),
    ]


def modes_for_aims(case: Case, **options: Any) -> int | None:
    """Fewest modes of the default reduction that meet both aims; None beyond `MOST_MODES`."""
    for modes in range(1, MOST_MODES + 1):
        found = study(case, run=("full", "reduced"), reduction={"modes": modes}, **options)
        if all(aims_met(errors_of(found))):
            return modes
    return None
