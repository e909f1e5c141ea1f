"""What is read off runs: stress, active regions, distances; of full, condensed, reduced models."""

from dataclasses import replace

import numpy as np
import pytest

import skfem_joint as sj

FORCE = 1e3
SAVE = sj.Save(fields=True)


def slowly(system):
    """Run so slow and damped that the end of it is at rest under the load."""
    return sj.integrate(system, duration=0.04, step=2e-5, save=sj.Save(fields=True, every=100))


def tension(dim):
    """A bar of 0.1 m and 20 by 10 mm, held at one end and pulled at the other."""
    strips, damping = [("near", 0.05, 4), ("far", 0.05, 4)], {"stiffness_damping": 2e-5}
    if dim == 1:
        mesh, material = sj.build_bar(strips, {"wall": 0.0, "end": 0.1}), sj.Material(200e9, 8000.0)
        size, held, on = {"width": 0.02, "thickness": 0.01}, {"fixed": ["wall"]}, "end"
    elif dim == 2:
        mesh, material = sj.build_plate(strips, 0.02, 2), sj.Material(200e9, 8000.0, 0.3)
        size, held, on = {"thickness": 0.01}, {"fixed_x": ["left"], "fixed_y": ["bottom"]}, "right"
    else:
        mesh, material = sj.build_box(strips, (0.02, 0.01), (2, 1)), sj.Material(200e9, 8000.0, 0.3)
        size, on = {}, "right"
        held = {"fixed_x": ["left"], "fixed_y": ["bottom"], "fixed_z": ["front"]}
    structure = sj.Structure(mesh, material, **size, **held, **damping, mass_damping=500.0)
    direction = None if dim == 1 else tuple(np.eye(dim)[0])
    load = sj.Load(on, sj.RampAndHold(FORCE, 5e-3), direction)
    return structure, structure.system([load])


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_the_peak_stress_of_a_bar_in_tension_is_force_over_area(dim):
    structure, system = tension(dim)
    run = slowly(system)
    found = sj.stress_history(structure, run, "far")
    assert found.stress.shape == (run.field_times.size, found.elements.size, 6)
    assert set(found.elements) == set(structure.mesh.regions["far"])
    assert found.von_mises[-1] == pytest.approx(FORCE / 2e-4, rel=1e-3)
    assert found.peak == found.von_mises.max() >= found.von_mises[-1].max()
    at = np.searchsorted(found.times, found.peak_time), found.elements == found.peak_element
    assert found.von_mises[at] == [found.peak]
    everywhere = sj.stress_history(structure, run)
    assert everywhere.peak >= found.peak
    with pytest.raises(sj.InputError, match="must be one of 'far', 'near'"):
        sj.stress_history(structure, run, "nowhere")
    with pytest.raises(sj.InputError, match="stored no fields"):
        sj.stress_history(structure, sj.integrate(system, step=1e-5, n_steps=2))


def jointed(limit=0.9):
    """A bar pressed on a base over its first 0.1 m, pulled by a share of what friction holds."""
    strips = [("joint", 0.1, 50), ("arm", 0.1, 5)]
    mesh = sj.build_bar(strips, {"loaded_end": 0.1, "end": 0.2})
    structure = sj.Structure(
        mesh, sj.Material(200e9, 8000.0), width=0.05, thickness=0.01, stiffness_damping=1e-6,
        joints=[sj.Joint("joint", 8e6, 0.7, beta=np.inf)],
    )  # fmt: skip
    load = sj.Load("end", sj.Harmonic(limit * 8e6 * 0.7 * 0.1 * 0.05, 50.0))
    return structure, structure.system([load], points=["loaded_end"])


def test_the_active_region_of_slow_slip_is_the_load_over_the_friction_by_length():
    """F / tau of the joint slips where inertia does not count: 0.4 of it."""
    structure, system = jointed(0.4)
    run = sj.integrate(system, cycles=1, steps_per_cycle=400, save=SAVE)
    found = sj.active_region(structure, run)
    assert found.length["joint"] == pytest.approx(0.04, rel=0.05)
    assert found.area_fraction["joint"] == pytest.approx(0.4, rel=0.06)
    assert found.area_fraction["joint"] == pytest.approx(found.point_fraction["joint"], abs=0.02)
    assert np.array_equal(found.slip_peak, run.slip_peak)
    small = sj.integrate(sj.condense(system), cycles=1, steps_per_cycle=400)
    same = sj.active_region(structure, small)
    np.testing.assert_allclose(same.slip_peak, run.slip_peak, atol=1e-3 * run.slip_peak.max())
    assert same.length["joint"] == pytest.approx(found.length["joint"], rel=0.02)
    reduced = sj.reduce(system, modes=12)
    less = sj.integrate(reduced, cycles=1, steps_per_cycle=400, save=SAVE)
    near = sj.active_region(structure, less)
    assert near.slip_peak.max() == pytest.approx(run.slip_peak.max(), rel=0.05)
    with pytest.raises(sj.InputError, match="stored no fields"):
        sj.active_region(structure, sj.integrate(reduced, cycles=1, steps_per_cycle=400))


def test_a_run_of_another_structure_is_refused():
    structure, _ = jointed()
    other, system = tension(1)
    run = sj.integrate(system, duration=1e-4, step=1e-5, save=SAVE)
    for read in (sj.active_region, sj.stress_history):
        with pytest.raises(sj.InputError, match="structure"):
            read(structure, run)
    fixed = replace(other, fixed=["end"])
    for read in (sj.active_region, sj.stress_history):
        with pytest.raises(sj.InputError, match="do not obey its supports"):
            read(fixed, run)
