"""Isolated joint: Figs. 2 to 7 and 10, Tables 1 and 2 of the paper beside what it printed."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pytest

from skfem_joint.active_length import estimate
from skfem_joint.paper.active import fig6, fig10, table2
from skfem_joint.paper.items import Item, Row, published
from skfem_joint.paper.iteration import iteration_limits
from skfem_joint.paper.mesh_and_law import fig2, fig3, fig4
from skfem_joint.paper.modes import table1
from skfem_joint.paper.workspace import Workspace

MAKERS = {f.__name__: f for f in (fig2, fig3, fig4, table1, fig6, table2, fig10)}


@cache
def item(key: str) -> Item:
    return MAKERS[key](Workspace(quick=True))


def rows(key: str, start: str) -> list[Row]:
    found = [row for row in item(key).rows if row.quantity.startswith(start)]
    assert found, f"{key} has no row {start!r}"
    return found


def full(key: str, start: str) -> float:
    (row,) = rows(key, start)
    assert isinstance(row.full, float)
    return row.full


def notes(key: str) -> str:
    return " ".join(item(key).notes)


def test_mesh_of_100_elements_is_within_a_percent_of_a_fine_one() -> None:
    assert abs(full("fig2", "change at 100 elements against 400")) < 1.0


def test_lumping_explains_the_mesh_sensitivity() -> None:
    curve = item("fig2").curves["fig2a"]
    at = curve["elements"] >= 10
    assert np.abs(curve["change_consistent_percent"][at]).max() < 0.1
    # Half an element's friction too much beside the load: (1 - tau h / 2F)^2.
    ratio = curve["change_equal_percent"] / curve["change_by_lumping_percent"]
    assert ratio == pytest.approx(np.ones(at.size), abs=0.1)
    assert "Lumping explains most" in notes("fig2")


def test_printed_loop_area_belongs_to_63_percent_of_the_limit() -> None:
    printed = published()["fig2"]["loop_energy"]
    assert full("fig2", "loop area at 63 kN (90 % of the limit), pseudo") == pytest.approx(5.9535)
    lesser = "loop area at 44.1 kN (63 % of the limit)"
    assert full("fig2", lesser + ", pseudo") == pytest.approx(printed, rel=5e-4)
    assert full("fig2", lesser + ", run") == pytest.approx(printed, rel=2e-3)
    assert rows("fig2", "loop area at 63 kN, 1000")[0].verdict.startswith("cannot be right")
    assert "is not that of the reference load" in notes("fig2")


def test_slow_loop_is_the_pseudo_static_one() -> None:
    curve = item("fig2").curves["fig2b_63.0kN"]
    u, exact = curve["displacement_5Hz_m"], curve["displacement_pseudo_static_m"]
    # Equal forces on 100 elements cost a percent, see above.
    assert np.abs(u - exact).max() < 0.02 * np.abs(exact).max()


def test_arctan_reaches_ninety_percent_at_a_velocity_that_falls_with_beta() -> None:
    speeds = [row.full for row in rows("fig3", "velocity at which 90 %")]
    assert speeds == pytest.approx([6.314 / beta for beta in (1e4, 1e5, 1e6, 1e7)], rel=1e-3)
    assert np.all(np.abs(item("fig3").curves["fig3"]["force_over_limit_beta_inf"]) <= 1.0)


def test_beta_matters_at_5_hz_and_not_at_1000_hz() -> None:
    assert full("fig4", "5 Hz, β 1e7 → 1e5: change of the peak") == pytest.approx(3.0, abs=0.1)
    assert full("fig4", "5 Hz, β 1e7 → 1e5: largest") > 5.0
    assert full("fig4", "1000 Hz, β 1e7 → 1e5: largest") < 1.0
    assert "does not print the load of Fig. 4" in notes("fig4")


def test_proper_values_are_printed_ones() -> None:
    values = [row.full for row in rows("table1", "proper value")]
    assert values == pytest.approx(published()["table1"]["proper_values"], abs=0.0051)
    assert {row.verdict for row in rows("table1", "proper value")} == {"agrees"}
    assert {row.verdict for row in rows("table1", "cumulative sum")} == {"agrees"}


def test_amplitude_of_the_first_mode_follows_the_printed_rule_the_others_less() -> None:
    ratios = [row.full for row in rows("table1", "amplitude of mode")]
    rule = np.sqrt(28.0 / 63.0)
    assert ratios[0] == pytest.approx(rule, rel=0.01)
    assert ratios == pytest.approx([rule] * 5, rel=0.2)
    assert rows("table1", "amplitude of mode 4")[0].verdict.startswith("differs")


def test_modes_of_two_loads_resemble_each_other_without_creep() -> None:
    creeping, exact = rows("table1", "likeness of the modes")
    assert exact.verdict == "agrees"
    assert creeping.verdict.startswith("differs in the higher modes")


def test_iteration_gives_the_printed_factors() -> None:
    printed = published()["fig6"]
    assert full("fig6", "A_a, first value") == pytest.approx(printed["first"], abs=5e-4)
    assert full("fig6", "A_a, converged") == pytest.approx(printed["converged"], abs=1e-3)
    assert full("fig6", "A_a after 15") == pytest.approx(printed["converged"], abs=1e-3)
    assert full("fig6", "natural frequency") == pytest.approx(4303.0, abs=0.5)
    reduced = rows("fig6", "A_a, converged")[0].reduced
    assert reduced == pytest.approx(printed["converged"], abs=1e-3)
    assert "it is metres" in notes("fig6")
    assert "345 mm" in notes("fig6")


def test_iteration_fails_where_the_theory_says() -> None:
    def last(share: float) -> tuple[bool, float]:
        found = estimate(1.0, share, lambda length: 1.0 / length, 5000)
        return found.converged, found.factor

    jump, edge = iteration_limits()
    assert (jump, edge) == pytest.approx((0.425, 0.469), abs=5e-4)
    assert last(0.995 * jump)[1] < 1.6 < 2.1 < last(1.005 * jump)[1]
    assert last(0.995 * edge)[0]
    assert not last(1.005 * edge)[0]


def test_static_resonances_are_printed_ones() -> None:
    for case, frequency in (("I", 5000.0), ("II", 10_000.0), ("III", 8333.0)):
        assert full("table2", f"Case {case}: first resonance") == pytest.approx(frequency, abs=0.5)


def test_errors_of_the_estimate_at_half_the_resonance() -> None:
    # Case I within one element; II and III err more, by the viscous damping.
    assert {row.verdict for row in rows("table2", "Case I: active")} <= {
        "agrees within one element (1.6 %)",
        "agrees within one element (1.7 %)",
        "better than published",
    }
    assert "no single meaning" in notes("table2")
    assert "weak evidence" in notes("table2")
    assert "the paper does not say which share" in notes("table2")


def test_smaller_threshold_lengthens_the_active_part() -> None:
    for letter in "abc":
        curve = item("table2").curves[f"fig7{letter}"]
        change = curve["full_1e-4_percent"] - curve["full_1e-3_percent"]
        assert np.all(change > 0.5)
        assert np.all(change < 4.0)


def test_estimate_is_close_far_below_resonance() -> None:
    for letter in "abc":
        curve = item("table2").curves[f"fig7{letter}"]
        low = slice(0, 2)
        assert curve["estimate_percent"][low] == pytest.approx(
            curve["full_1e-3_percent"][low], rel=0.05
        )


def test_scaling_rule_for_impulses_holds_within_the_printed_error() -> None:
    assert (
        abs(full("fig10", "error of the rule at 4500 Hz")) < published()["fig10"]["error_percent"]
    )
    assert full("fig10", "active length at 50 %") < full("fig10", "active length at 70 %")
    assert "cannot test the rule" in notes("fig10")
    assert "No match with the paper's numbers is claimed" in notes("fig10")


def test_pictures_are_written_only_when_wanted(tmp_path: Path) -> None:
    drawn = fig3(Workspace(tmp_path, quick=True))
    assert [(tmp_path / path).is_file() for path in drawn.pictures] == [True]
    assert item("fig3").pictures == []
