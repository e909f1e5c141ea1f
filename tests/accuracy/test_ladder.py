"""Errors by rungs between results that are known: sums, series and bounds; no model is run."""

import numpy as np
import pytest

from skfem_joint.accuracy.ladder import HALVED, STEP, WHOLE, Rung, Series, errors_of
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


def test_a_total_of_parts_that_cancel_is_no_less_than_most_of_the_largest_energy():
    way = rungs(START, ("law", 9e-3, WHOLE), ("basis", 5e-3, WHOLE))
    total = errors_of(off(5e-3), way)["total"]
    assert total["displacement_rms"] == pytest.approx(0.0, abs=1e-12)
    for name in QUANTITIES[1:]:
        assert total[name] == pytest.approx(0.7 * 4e-3, rel=1e-2)


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
