"""One bookkeeping: all steppers add up the same works and peaks, which balance to round-off."""

from math import inf
from typing import Any

import numpy as np
import pytest
from stepping_systems import LapJoint, not_a_chain, run_of

import skfem_joint as sj

SCHEMES = [sj.generalized_alpha(1.0), sj.generalized_alpha(0.5)]


def assert_same(one: sj.Run, other: sj.Run, rtol: float = 1e-9) -> None:
    """Equal histories, works and peaks, in the whole and in each cycle."""
    scale, energy = other.peak.max(), np.abs(other.input_work).sum()
    np.testing.assert_allclose(one.point_u, other.point_u, rtol=0.0, atol=rtol * scale)
    np.testing.assert_allclose(one.u, other.u, rtol=0.0, atol=rtol * np.abs(other.u).max())
    works = [(r.viscous_work, r.scheme_work, r.friction_work.sum(), *r.input_work) for r in
             (one, other)]  # fmt: skip
    np.testing.assert_allclose(*works, rtol=0.0, atol=10 * rtol * energy)
    for name in ("input", "viscous", "scheme", "friction", "peak"):
        a, b = getattr(one.cycles, name), getattr(other.cycles, name)
        least = scale if name == "peak" else energy
        np.testing.assert_allclose(a, b, rtol=100 * rtol, atol=rtol * least)
    np.testing.assert_allclose(one.friction_work, other.friction_work, atol=10 * rtol * energy)
    np.testing.assert_allclose(one.slip_peak, other.slip_peak, rtol=10 * rtol, atol=rtol * scale)
    np.testing.assert_allclose(one.peak, other.peak, rtol=rtol)
    assert one.stored_energy == pytest.approx(other.stored_energy, rel=10 * rtol)
    assert max(one.energy_residual, other.energy_residual) < 1e-10


@pytest.mark.parametrize("scheme", SCHEMES)
def test_all_steppers_keep_the_same_books(scheme):
    """A linear system, with friction too faint to be felt where a stepper needs some."""
    system = LapJoint(elements=25).system
    none = system.with_contact(given=0.0 * system.contact.w)
    faint = system.with_contact(given=1e-18 * system.contact.w)
    start = (np.linspace(0.0, 1e-5, 25), np.linspace(0.1, -0.1, 25))
    options: dict[str, Any] = {"scheme": scheme, "cycle_steps": 40, "initial": start}
    expected = run_of(none, **options)
    assert expected.counters.friction_evaluations == 0
    for other in (faint, faint.project(np.eye(25)), not_a_chain(faint)):
        run = run_of(other, **options)
        assert_same(run, expected)
        if scheme.coefficients(1.0).trapezoidal:
            assert run.scheme_work == expected.scheme_work == 0.0
    if not scheme.coefficients(1.0).trapezoidal:
        assert expected.scheme_work > 0.0


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize(
    ("beta", "normal_force"),
    [(1e5, "equal"), (1e9, "equal"), (inf, "equal"), (1e5, "consistent"), (inf, "consistent")],
)
def test_contact_steps_of_a_chain_agree_with_the_chain_s_own(beta, normal_force, scheme):
    """The same chain, and with a coupling too weak to matter that makes it none."""
    system = LapJoint(elements=40, beta=beta, normal_force=normal_force).system
    chain, contact = (
        run_of(s, scheme=scheme, tolerance=1e-13, cycle_steps=40)
        for s in (system, not_a_chain(system))
    )
    assert chain.counters.linear_solves == 0 < contact.counters.linear_solves
    assert_same(contact, chain, rtol=1e-8)
