"""The elastic block of the GRECO benchmark, with contact that opens and friction."""

import numpy as np
import pytest
from benchmarks.contact import PLACES, PRESSURES, PUBLISHED, block, pushed
from contact_block import OwnBlock

#: Of 32 x 32 bilinear elements by Lagrange multipliers: displacement at 0, 5, 10 and 20 mm, um.
KNOWN = [
    [28.594, 22.850, 16.838, 6.449],
    [28.474, 21.605, 16.500, 6.449],
    [28.634, 22.887, 16.880, 6.522],
    [28.516, 21.658, 16.549, 6.522],
]


@pytest.fixture(scope="module")
def cycle():
    """Side 150, 30, 150, 30 MPa in 20 steps each, 32 x 32 bilinear elements."""
    return pushed(block(32), 20)


def test_cycle_of_the_block_is_that_of_lagrange_multipliers_and_as_published(cycle):
    x, u, work, run = cycle
    for k, known in enumerate(KNOWN, start=1):
        found = 1e6 * np.interp(np.array([0.0, 5.0, 10.0, 20.0]) * 1e-3, x, u[k, :, 0])
        np.testing.assert_allclose(found, known, rtol=1e-4)
    np.testing.assert_allclose(work[1:], [4.401, 4.863, 5.165, 5.555], rtol=2e-4)
    found = 1e6 * np.interp(PLACES, x, u[1, :, 0])
    np.testing.assert_allclose(found[:5], PUBLISHED["published (1988)"][:5], rtol=0.05)
    assert run.energy_residual < 1e-8
    assert abs(run.impact_work) < 1e-3 * run.friction_work.sum()


def test_edge_of_the_block_lifts_off_and_closes_again(cycle):
    _, u, _, run = cycle
    gap = u[:, :, 1]
    assert np.flatnonzero(gap[1] > 0.0).tolist() == [0, 1, 2]
    assert 1e6 * gap[1].max() == pytest.approx(0.604, abs=0.001)
    assert gap.min() > -1e-18
    assert np.all(gap[2] == 0.0)
    # three nodes are open, 21 slip, and the one held by symmetry is among the nine that stick
    limits, forces = run.normal_force[20], run.sigma[20]
    slipping = (limits[:-1] > 0.0) & (np.abs(np.abs(forces[: limits.size - 1]) - 1.0) < 1e-9)
    assert slipping.sum() == 21


LIFTED = np.array([[0.0, 150e6, -30e6, 150e6, 0.0], [0.0, 50e6, 100e6, 20e6, 50e6]])
CASES = [(PRESSURES, 16, friction, 5) for friction in (0.2, 0.5, 1.0)]
CASES += [(LIFTED, 12, friction, 3) for friction in (0.5, 1.0)]
SLOW = [(LIFTED, 12, 0.5, 7), (LIFTED, 12, 1.0, 7), (PRESSURES, 64, 1.0, 20)]


@pytest.mark.parametrize(
    ("table", "n", "friction", "steps"),
    [*CASES, *(pytest.param(*case, marks=pytest.mark.slow) for case in SLOW)],
)
def test_block_is_that_of_an_own_solver(table, n, friction, steps):
    """Also where it lifts off and slides back."""
    _, u, work, _ = pushed(block(n, friction=friction), steps, table)
    other, other_work = OwnBlock(n, friction).follow(steps, table)
    share = 3e-9 if n > 16 else 1e-9
    np.testing.assert_allclose(u, other, atol=share * np.abs(other).max())
    np.testing.assert_allclose(work, other_work, rtol=1e-7)


@pytest.mark.slow
def test_elements_of_second_order_converge_to_the_same():
    # With pressures at the corners alone the displacement converges with the element size, and
    # corners and middles of sides differ: corners of all three meshes are compared.
    places = np.array([0.0, 5.0, 10.0, 20.0]) * 1e-3
    table, found = PRESSURES[:, :2], []
    for n in (8, 16, 32):
        x, u, _, _ = pushed(block(n, order=2), 20, table)
        found.append(np.interp(places, x, u[-1, :, 0]))
    fine = OwnBlock(64, 1.0).follow(20, table)[0][-1, :, 0]
    fine = np.interp(places, np.linspace(0.0, 0.04, 65), fine)
    errors = [np.abs(u / fine - 1.0) for u in found]
    assert errors[0].max() < 0.05
    assert errors[1].max() < 0.6 * errors[0].max()
    assert errors[2].max() < 0.6 * errors[1].max()
    np.testing.assert_allclose(2.0 * found[2] - found[1], fine, rtol=3e-3)
