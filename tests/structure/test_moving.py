"""Structures in motion: closed forms, the rigid base, meshes that do not match."""

from dataclasses import replace

import numpy as np
import pytest
from bodies import EA, LAP, SIDE, STEEL, THICKNESS, WIDTH, lap, side, structure, two_bars

import skfem_joint as sj


def cycle(system: sj.System, cycles: int = 1, steps: int = 100) -> sj.Run:
    """The first periods from rest, in which the joint slips there, back and there again."""
    return sj.integrate(system, cycles=cycles, steps_per_cycle=steps, save=sj.Save(fields=True))


def damped_bars(above: int, below: int, arm: int = 20) -> sj.Structure:
    return two_bars(above, below, beta=np.inf, arm=arm, stiffness_damping=1e-5)


FORCE, TAU = 87.5e3, 0.7 * 50e6 * WIDTH


def test_a_slow_load_gives_the_closed_form_of_two_slipping_ends():
    # Slip runs F / (2 tau) in from both ends, between them each bar carries F / 2; the lower bar is
    # held at its end, so that the upper one's end moves by both ends' stretch.
    some = damped_bars(160, 160, arm=5)
    run = cycle(some.system([sj.Load("upper_end", sj.Harmonic(-FORCE, 5.0))]), 2, 200)
    at_loaded_end = FORCE * 0.1 / (2 * EA) + FORCE**2 / (8 * EA * TAU)
    expected = 2 * (at_loaded_end + FORCE * 0.5 / EA)
    assert run.cycles.peak[-1][0] == pytest.approx(expected, rel=1e-4)
    assert run.cycles.friction[-1] == pytest.approx(FORCE**3 / (3 * EA * TAU), rel=1e-2)
    (patch,) = some.patches
    x = some.nodes[patch.nodes, 0]
    stuck = x[run.slip_peak[patch.points] < 1e-3 * run.slip_peak.max()]
    reach = [stuck.min() - 0.5, 0.7 - stuck.max()]  # to an element of 1.25 mm
    assert reach == pytest.approx([FORCE / (2 * TAU)] * 2, abs=1.3e-3)


@pytest.mark.parametrize("pair", ["lap", "side", "bars"])
@pytest.mark.parametrize("beta", [1e5, np.inf])
def test_on_a_body_a_million_times_stiffer_it_moves_as_on_a_rigid_base(pair, beta):
    """The body is as heavy as it is stiff, so that it does not ring either."""
    if pair == "bars":
        body, joint, fixed = damped_bars(20, 13).mesh, damped_bars(20, 13).joints[0], ["lower_end"]
        load = [sj.Load("upper_end", sj.Harmonic(-FORCE, 500.0))]
    else:
        body, joint = (lap((8, 6)), LAP) if pair == "lap" else (side((8, 6)), SIDE)
        fixed = ["lower_left"]
        # Half of what the friction holds: 8 MPa on 0.1 m x 0.05 m in plan, x 0.01 m from the side.
        force = 0.35 * 8e6 * 0.1 * (WIDTH if pair == "lap" else THICKNESS)
        load = [sj.Load("upper_right", sj.Harmonic(force, 1000.0), (1.0, 0.1))]
    joint = replace(joint, beta=beta)
    under = [name for name in body.regions if name.startswith("lower")]
    stiff = {region: {"E": 1e6 * STEEL.E, "density": 1e6 * STEEL.density} for region in under}
    on_body = structure(body, [joint], fixed, regions=stiff, stiffness_damping=1e-5)
    on_base = structure(
        body, [replace(joint, against=None)], [*fixed, *under], stiffness_damping=1e-5
    )
    base, moved = (cycle(s.system(load, [])) for s in (on_base, on_body))
    errors = sj.compare(base, moved)
    assert base.friction_work.sum() > 0.01 * base.input_work.sum()
    assert errors.displacement_max < 1e-4
    assert abs(errors.friction_energy) < 1e-4


def test_meshes_that_do_not_match_converge_to_those_that_do():
    """At first order in the friction energy: between nodes of the other bar a node must slip."""
    load = [sj.Load("upper_end", sj.Harmonic(-FORCE, 500.0))]
    exact = cycle(damped_bars(160, 160, arm=40).system(load), 2)
    errors = []
    for n in (20, 40, 80):
        run = cycle(damped_bars(n, (4 * n) // 5, arm=40).system(load), 2)
        energy = run.friction_work.sum() / exact.friction_work.sum() - 1.0
        errors.append((abs(run.peak[0] / exact.peak[0] - 1.0), abs(energy)))
    displacement, energies = np.array(errors).T
    assert displacement[-1] < 5e-5
    assert energies[-1] < 0.03
    assert energies[-1] < 0.25 * energies[0]
