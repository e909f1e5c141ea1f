"""Stress at rest by clamp forces, and mean and range of a cycle on it."""

import numpy as np
import pytest
from bodies import STEEL
from clamped_plates import BOLTS, DEEP, JOINT, plates

import skfem_joint as sj
from skfem_joint.results.stress import preload_stress, von_mises

FORCE, PULL = 1000.0, 400.0
WITHOUT_POISSON = sj.Material(200e9, 8000.0, 0.0)


def pressed():
    """A block whose whole top one bolt presses on a rigid base, pulled along it."""
    sides = {"under": "bottom", "over": "top", "end": "right", "back": "left"}
    mesh = sj.build_plate([("block", 0.04, 8)], 0.01, 4, boundaries=sides)
    return sj.Structure(
        mesh, WITHOUT_POISSON, thickness=0.01, joints=[sj.Joint("under", "preload", 0.3)],
        bolts=[sj.Clamp(FORCE, head="over")], fixed_x=["back"], damping_ratio=0.02,
    )  # fmt: skip


def test_a_bolt_that_presses_a_whole_block_strains_it_by_force_over_area():
    rest = preload_stress(pressed())
    assert rest[:, 1] == pytest.approx(np.full(len(rest), -FORCE / (0.04 * 0.01)), rel=1e-9)
    assert np.abs(np.delete(rest, 1, axis=1)).max() < 1e-6 * FORCE / (0.04 * 0.01)


def test_given_pressures_are_no_stress_of_the_bodies():
    mesh = sj.build_plate([("joint", 0.04, 8), ("arm", 0.02, 2)], 0.01, 2)
    structure = sj.Structure(
        mesh, STEEL, thickness=0.01, joints=[sj.Joint("joint", 5e6, 0.3)], fixed=["left"]
    )
    assert not preload_stress(structure).any()


def test_stress_by_bolts_is_that_of_elements_of_a_quarter_of_the_size_within_3_percent():
    """Von Mises stress at the fourteen places where it is largest, under the bolts' heads too."""

    def made(mesh):
        return sj.Structure(
            mesh, STEEL, thickness=DEEP, fixed=["left"], joints=[JOINT], bolts=BOLTS
        )

    coarse = made(plates(False, order=2))
    fine = made(sj.refined(sj.refined(coarse.mesh)))
    inside, stress = fine.mesh.mesh.p[:, fine.mesh.mesh.t].mean(axis=1), preload_stress(fine)
    corners = coarse.mesh.mesh.p[:, coarse.mesh.mesh.t]
    low, high = corners.min(axis=1), corners.max(axis=1)
    beside = (inside[..., np.newaxis] > low[:, np.newaxis]).all(axis=0)
    beside &= (inside[..., np.newaxis] < high[:, np.newaxis]).all(axis=0)
    assert np.array_equal(beside.sum(axis=0), np.full(low.shape[1], 16))
    true = von_mises(beside.T @ stress / 16.0)
    most = np.argsort(-true)[:14]
    assert von_mises(preload_stress(coarse))[most] == pytest.approx(true[most], rel=0.03)


def test_mean_and_range_of_a_cycle_are_those_of_load_and_preload():
    """A slow pull on the end: what the frictionless part carries is force over area."""
    structure = pressed()
    system = structure.system([sj.Load("end", sj.Harmonic(PULL, 50.0), (1.0, 0.0))])
    run = sj.integrate(system, cycles=3, steps_per_cycle=64, save=sj.Save(fields=True))
    found = sj.stress_history(structure, run)
    assert np.array_equal(found.total[5], found.preload + found.stress[5])
    cycle = found.cycle(1.0 / 50.0)
    across, along = -FORCE / 4e-4, PULL / 1e-4
    last = np.flatnonzero(structure.mesh.mesh.p[0, structure.mesh.mesh.t].mean(axis=0) > 0.035)
    top = np.flatnonzero(structure.mesh.mesh.p[1, structure.mesh.mesh.t].mean(axis=0) > 0.0075)
    (corner,) = np.intersect1d(last, top)  # beside the load, away from what rubs
    assert cycle.range[corner, 0] == pytest.approx(2.0 * along, rel=0.05)
    assert cycle.amplitude[corner] == pytest.approx(along, rel=0.05)
    assert cycle.mean[:, 1] == pytest.approx(np.full(len(cycle.mean), across), rel=0.1)
    assert abs(cycle.mean[corner, 0]) < 0.02 * along
    assert np.all(cycle.amplitude <= cycle.amplitude[cycle.worst])
    with pytest.raises(sj.InputError, match=r"at most the 0\.06 s that are stored"):
        found.cycle(0.07)
    with pytest.raises(sj.InputError, match="at least 9 times"):
        found.cycle(1e-3)
