"""Borders of contact and slip within the cells: constants stay, contours lie where they should."""

import numpy as np
import pytest

from skfem_joint.results.borders import of_cells, smoothed, spread, touching


@pytest.fixture(scope="module")
def grid():
    """Nodes of squares of a width of 1, and the sums over each square's corners."""
    n = 12
    x, y = (axis.ravel() for axis in np.meshgrid(np.arange(n + 1.0), np.arange(n + 1.0)))
    corner = (np.arange(n) + (n + 1) * np.arange(n)[:, np.newaxis]).ravel()
    corners = corner[:, np.newaxis] + [0, 1, n + 2, n + 1]
    return x, y, of_cells(corners.ravel(), 4 * np.arange(n * n + 1), x.size)


@pytest.mark.parametrize("place", [4.1, 4.5, 4.9])
def test_the_border_of_an_even_pressure_is_within_half_a_cell_of_where_it_ends(grid, place):
    """Nodes have the mean pressure of their own area, which ends half way to their neighbours."""
    x, _, cells = grid
    pressure = 3e6 * np.clip(place - x + 0.5, 0.0, 1.0)
    share = touching(cells, pressure)[:13]
    border = np.interp(-0.5, -share, x[:13])
    assert border == pytest.approx(place, abs=0.5)
    assert share.min() == 0.0
    assert share.max() == 1.0


def test_a_pressure_that_falls_to_zero_touches_wherever_it_is_more_than_zero(grid):
    x, _, cells = grid
    pressure = 1e6 * np.maximum(6.0 - x, 0.0)
    share = touching(cells, pressure)
    assert np.all(share[pressure > 0.0] >= 0.5)
    assert np.all(share[pressure == 0.0] == 0.0)
    assert np.array_equal(touching(cells, 7.0 * pressure), share)


def test_constants_stay_and_unknown_nodes_take_the_values_beside_them(grid):
    x, _, cells = grid
    known = x < 6.5
    ones = np.where(known, 1.0, np.nan)
    assert np.array_equal(spread(cells, ones, known)[x < 7.5], np.ones(np.sum(x < 7.5)))
    assert np.array_equal(smoothed(cells, ones, known)[known], np.ones(known.sum()))
    values = np.where(known, x, np.nan)
    assert np.array_equal(spread(cells, values, known)[known], x[known])


def test_smoothing_moves_a_straight_border_by_no_more_than_half_a_cell(grid):
    x, _, cells = grid
    half = smoothed(cells, (x < 5.5).astype(float), np.ones(x.size, dtype=bool))[:13]
    assert np.interp(-0.5, -half, x[:13]) == pytest.approx(5.5, abs=0.5)
    assert np.all((half >= 0.0) & (half <= 1.0))
