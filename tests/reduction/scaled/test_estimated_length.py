"""Active lengths estimated by Eqs. (17)-(20), section 6.1."""

import numpy as np
import pytest
from bodies import EA
from reduced_joints import TAU, case, case_i, fig_18

import skfem_joint as sj
from skfem_joint.reduction.scaled.estimated_length import (
    DAMPING_RATIO,
    ActiveLengthEstimate,
    estimate_active_length,
)
from skfem_joint.reduction.scaled.zones import active_zones, zone_lengths


def test_damping_ratio_dissipates_what_the_pseudo_static_loop_does():
    # A loop of a harmonic force and displacement with phase phi has the area pi F u sin(phi);
    # equal to the joint's loop with tan(phi) = 2 zeta, whatever force, section and friction.
    force, tau = 1.7e4, 3e5
    loop, peak = 2 * force**3 / (3 * EA * tau), force**2 / (2 * EA * tau)
    zeta = DAMPING_RATIO
    assert np.sin(np.arctan(2.0 * zeta)) == pytest.approx(loop / (np.pi * force * peak), rel=1e-14)


def estimated(structure: sj.Structure, system: sj.System) -> ActiveLengthEstimate:
    (zone,) = active_zones(structure, system)
    return estimate_active_length(system, zone)


def test_isolated_joint_reproduces_the_factors_of_figure_6():
    found = estimated(*case_i())
    assert round(found.factors[0], 3) == 1.162
    assert round(found.factor, 2) == 1.30
    assert found.converged
    assert found.length == pytest.approx(0.325, rel=1e-3)


def test_isolated_joint_near_resonance_does_not_settle():
    structure, system = case_i(4000.0)  # 0.25 m of active bar alone resonate at 5 kHz
    _, notes = zone_lengths(system, active_zones(structure, system), "estimate", system.contact.w)
    assert "did not settle and is doubtful" in notes[0]


def test_structure_of_fig_18_starts_from_the_factor_of_the_paper():
    found = estimated(*fig_18())
    assert round(found.factors[0], 3) == 1.045  # printed: 1.05
    assert found.converged
    assert found.length == pytest.approx(1.045 * 87.5e3 / TAU, rel=5e-4)


def test_structure_at_resonance_is_reported_by_its_frequency_ratio():
    # c / (4 * 0.6 m) = 2083 Hz with the whole joint active.
    below, above = (estimated(*fig_18(frequency)) for frequency in (1500.0, 2100.0))
    assert below.converged
    assert below.frequency_ratio < 0.75
    assert above.frequency_ratio == pytest.approx(2100.0 / (5000.0 / 2.4), rel=2e-3)
    assert above.length > 0.1  # to be capped


def test_static_length_is_the_force_over_tau_wherever_the_loads_act():
    structure, _ = fig_18()
    for on in ("end", "linear", "after joint"):
        system = structure.system([sj.Load(on, sj.Harmonic(60e3, 1.0))])
        assert estimated(structure, system).length == pytest.approx(60e3 / TAU, rel=1e-4)
    both = sj.MultiHarmonic((sj.Harmonic(12e3, 1.0), sj.Harmonic(-8e3, 2.0)))
    loads = [sj.Load("end", both), sj.Load("after joint", sj.Harmonic(-30e3, 1.0))]
    found = estimated(structure, structure.system(loads))
    assert found.length == pytest.approx(50e3 / TAU, rel=1e-4)


def test_what_has_no_estimate_is_refused():
    structure, _ = fig_18()
    pulse = structure.system([sj.Load("end", sj.HalfSine(1e4, 1e-3))])
    for s, system in ((structure, pulse), case("strip")[:2]):
        zones = active_zones(s, system)
        assert estimate_active_length(system, zones[0]) is None
        with pytest.raises(sj.InputError, match="'estimate' needs a bar under harmonic loads"):
            zone_lengths(system, zones, "estimate", system.contact.w)
