"""Backbones of models for a range: they have the modes without slip, and err as they state."""

import numpy as np
import pytest
from tipped_bars import tipped_bar

import skfem_joint as sj

RANGE = {"slip": (0.05, 0.95), "frequency": (500.0, 3000.0)}


@pytest.fixture(scope="module", params=["force", pytest.param("base", marks=pytest.mark.slow)])
def both(request) -> tuple[sj.System, sj.System]:
    """Bar and its model for a range."""
    if request.param == "force":
        system = tipped_bar(sj.Load("end", sj.Harmonic(1e3, 1000.0)), 320e3, 50)
    else:
        system = tipped_bar(sj.Load(base="x", amplitude=sj.Harmonic(1.0, 1000.0)))
    return system, sj.reduce(system, range=RANGE)


def test_a_model_for_a_range_has_the_modes_without_slip_and_so_has_its_larger_one(both):
    """Proper modes of many paths nearly hold them, but move in the joint by 1e-7 of it."""
    truth, ours, larger = (
        sj.natural_modes(model, 2, joints="stuck").frequencies
        for model in (both[0], both[1], both[1].serves.larger)
    )
    assert truth[0] < RANGE["frequency"][1]
    np.testing.assert_allclose(ours, truth, rtol=1e-9)
    np.testing.assert_allclose(larger, truth, rtol=1e-9)


def test_the_curve_of_a_model_for_a_range_is_as_accurate_as_asked_and_states_so(both):
    """Where errors are far below the accuracy, the model and its larger one share some of them."""
    system, small = both
    (ours,) = sj.backbone(small, levels=4)
    (truth,) = sj.backbone(system, levels=ours.level)
    for name, most in ("frequency", 0.001), ("damping_ratio", 0.03):
        values, exact = getattr(ours, name), getattr(truth, name)
        error = np.abs(values - exact).max() / exact.max()
        assert error < ours.estimated[name] + 0.03 * most
        assert ours.estimated[name] < most


def test_the_level_of_gross_slip_of_a_model_for_a_range_is_that_of_the_system(both):
    """To what each is found to, 2 %, and to the thousandth of slip that counts as sticking."""
    (truth,), (ours,) = (sj.backbone(model, levels=1) for model in both)
    assert ours.slips_at == pytest.approx(truth.slips_at, rel=0.04)


def test_levels_may_be_given_up_to_the_slip_of_the_range(both):
    (shares,) = sj.backbone(both[1], levels=3)
    (levels,) = sj.backbone(both[1], levels=shares.level)
    np.testing.assert_allclose(levels.damping_ratio, shares.damping_ratio, rtol=1e-9)
    assert levels.estimated == pytest.approx(shares.estimated, rel=1e-6)
    with pytest.raises(sj.InputError, match=r"up_to 0\.97.* lower it or the levels"):
        sj.backbone(both[1], levels=[0.5 * shares.slips_at, 0.97 * shares.slips_at])
