"""Two alike cylinders in contact do as Hertz, Cattaneo and Mindlin say; the benchmark runs."""

import numpy as np
import pytest
from benchmarks import contact
from benchmarks.contact import HALF_WIDTH, PULL, RUBBING, Hertz, cylinders, half_width, press

KNOWN = Hertz.of(HALF_WIDTH)


def pressed_then_pulled(n, order, shift):
    """Two cylinders pressed in ten steps, then pulled in ten."""
    pull = PULL * RUBBING * KNOWN.force
    structure = cylinders(n, order, shift)
    return press(structure, [0.0, KNOWN.force, KNOWN.force], [0.0, 0.0, pull], 10)


@pytest.fixture(
    scope="module",
    params=[
        (16, 1, 0.0),
        (16, 1, 0.37),
        pytest.param((32, 1, 0.0), marks=pytest.mark.slow),
        pytest.param((32, 1, 0.37), marks=pytest.mark.slow),
        pytest.param((32, 2, 0.0), marks=pytest.mark.slow),
        pytest.param((32, 2, 0.37), marks=pytest.mark.slow),
    ],
    ids=lambda case: f"{case[0]} of order {case[1]}, {'shifted' if case[2] else 'matching'}",
)
def pulled(request):
    return request.param[0], pressed_then_pulled(*request.param)


def test_pressed_cylinders_touch_as_hertz_says(pulled):
    n, found = pulled
    a, peak = half_width(found.x, found.p[10])
    assert a == pytest.approx(HALF_WIDTH, rel=0.005)
    assert peak == pytest.approx(KNOWN.peak, rel=0.01)
    assert found.p[10].max() == pytest.approx(KNOWN.peak, rel=0.01)
    touching = np.abs(found.x[found.p[10] > 0.0])
    assert abs(touching.max() / HALF_WIDTH - 1.0) <= 1.01 / n
    middle = np.abs(found.x) < 0.9 * HALF_WIDTH
    np.testing.assert_allclose(
        found.p[10][middle] / KNOWN.pressure(found.x[middle]), 1.0, atol=0.02
    )
    assert found.run.normal_force[10].sum() == pytest.approx(KNOWN.force, rel=1e-5)


def test_alike_cylinders_do_not_slip_when_they_are_pressed(pulled):
    _, found = pulled
    assert found.run.friction_work_rows[10].sum() < 1e-8 * found.run.stored_energy[1]
    # both are held far away in different ways, which is all that differs
    assert np.abs(found.q[10]).max() < 0.02 * KNOWN.peak


def test_pulled_cylinders_stick_and_slip_as_cattaneo_and_mindlin_say(pulled):
    n, found = pulled
    stick = contact.stick_width(found.x, found.slip[-1] - found.slip[10], n)
    half_an_element = 0.5 * HALF_WIDTH / n
    assert stick == pytest.approx(HALF_WIDTH * np.sqrt(1.0 - PULL), abs=half_an_element)
    error = found.q[-1] - KNOWN.traction(found.x, PULL)
    assert np.sqrt(np.mean(error**2)) < (0.02 if n > 16 else 0.03) * RUBBING * KNOWN.peak
    # the pressures are those without a pull
    np.testing.assert_allclose(found.p[-1], found.p[10], atol=2e-3 * KNOWN.peak)
    assert (found.q[-1] * found.area).sum() == pytest.approx(PULL * RUBBING * KNOWN.force, rel=1e-6)


def test_force_at_a_constant_angle_loses_the_less_energy_the_more_steps():
    # Nothing slips in the closed form. A point that closes within a step counts its slip from the
    # start of the step, so that a little is lost, which falls with the steps.
    lost = []
    for steps in (5, 20):
        found = press(cylinders(8, 1), [0.0, KNOWN.force], [0.0, 0.25 * KNOWN.force], steps)
        lost.append(found.run.friction_work_rows[-1].sum() / found.run.stored_energy[1])
        sticks = np.abs(found.q[-1]) <= RUBBING * found.p[-1] * (1.0 + 1e-9)
        assert np.all(sticks)
    assert lost[0] < 3e-4
    assert lost[1] < 0.2 * lost[0]
