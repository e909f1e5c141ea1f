"""Errors by rungs between results that are known: sums, series and bounds; no model is run."""

import numpy as np
import pytest

from skfem_joint.accuracy.ladder import HALVED, STEP, WHOLE, Rung, Series, errors_of
from skfem_joint.accuracy.rungs import MODES_ADDED
from skfem_joint.results.history import QUANTITIES, Results


def off(error: float) -> Results:
    """Results that are all too large by a relative error."""
    size = 1.0 + error
    return Results(("a",), np.full((2, 1), size), size, size, size, np.array([size]))


def rungs(*levels: tuple[str, float, Series]) -> list[Rung]:
    """Rungs from one error to the next; the first entry is where they start."""
    results = [off(error) for _, error, _ in levels]
    pairs = zip(results, results[1:], levels[1:], strict=False)
    return [Rung.of(source, *both, series) for *both, (source, _, series) in pairs]


START = ("", 5e-3, WHOLE)


def test_sources_are_what_their_rungs_change_and_the_total_is_the_whole_way():
    way = rungs(START, ("law", 3e-3, WHOLE), ("basis", 2e-3, WHOLE), ("basis", 0.0, WHOLE))
    found = errors_of(off(5e-3), way)
    for name in QUANTITIES:
        assert found["law"][name] == pytest.approx(2e-3, rel=1e-9)
        assert found["basis"][name] == pytest.approx(3e-3, rel=1e-9)
        assert found["total"][name] == pytest.approx(5e-3, rel=1e-9)


def test_a_total_of_parts_that_cancel_is_no_less_than_the_largest():
    way = rungs(START, ("law", 9e-3, WHOLE), ("basis", 5e-3, WHOLE))
    total = errors_of(off(5e-3), way)["total"]
    for name in QUANTITIES:
        assert total[name] == pytest.approx(4e-3, rel=1e-2)


def test_each_source_leaves_the_rest_of_its_own_series():
    way = rungs(START, ("law", 4.1e-3, Series(0.1, 0.1, 0.1)), (STEP, 1.1e-3, HALVED))
    found = errors_of(off(5e-3), way)
    for name in QUANTITIES:  # a ninth of the change by the law, a third of that by the step
        assert found["law"][name] == pytest.approx(1e-3, rel=5e-3)
        assert found[STEP][name] == pytest.approx(4e-3, rel=5e-3)
        assert found["total"][name] == pytest.approx(5e-3, rel=5e-3)


def test_a_change_on_another_model_counts_as_one_on_the_ladder():
    beside = Rung.of(STEP, off(0.3), off(0.298), HALVED)
    found = errors_of(off(5e-3), [beside])
    assert found[STEP]["loop_energy"] == pytest.approx(2e-3 * 4 / 3, rel=0.3)
    assert found[STEP] == found["total"]


@pytest.mark.parametrize(
    ("series", "ratios"), [(MODES_ADDED, (0.1, 0.4, 0.75)), (HALVED, (0.25, 0.35, 0.5))]
)
def test_the_rest_of_a_geometric_series_is_exact(series: Series, ratios):
    one = np.full(len(QUANTITIES), 2.0)
    for ratio in ratios:
        rest = series.rest([one, ratio * one])
        np.testing.assert_allclose(one + ratio * one + rest, one / (1.0 - ratio), rtol=1e-12)
    assert not series.rest([one, 0.0 * one]).any()
    assert np.isnan(series.rest([one, np.nan * one])).all()  # what is not known


def by_halved_steps(*errors: float) -> dict[str, float | None]:
    """Stated errors of results from those with half of their step, a quarter and so on."""
    way = rungs(("", errors[0], WHOLE), *((STEP, error, HALVED) for error in errors[1:]))
    return errors_of(off(errors[0]), way)["total"]


@pytest.mark.parametrize("order", [1.0, 1.5, 2.0])
def test_errors_that_fall_with_an_order_between_one_and_two_are_stated_exactly(order):
    stated = by_halved_steps(*(1e-4 * 0.5 ** (k * order) for k in range(3)))
    for name in QUANTITIES:
        assert stated[name] == pytest.approx(1e-4, rel=1e-3)


def test_half_a_step_alone_is_taken_to_be_of_second_order():
    for error in by_halved_steps(1e-4, 0.25e-4).values():
        assert error == pytest.approx(1e-4, rel=1e-3)


def test_a_rest_of_no_common_sign_is_added_by_squares():
    # Changes of 1 and -2: a distance of 1, and a rest of 2 by the largest ratio of a half.
    turning, rising = by_halved_steps(2e-4, 3e-4, 1e-4), by_halved_steps(0.0, 1e-4, 3e-4)
    for name in QUANTITIES:
        assert turning[name] == pytest.approx(np.hypot(1e-4, 2e-4), rel=1e-3)
        assert rising[name] == pytest.approx(3e-4 + 2e-4, rel=1e-3)
