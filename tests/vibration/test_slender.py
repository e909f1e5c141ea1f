"""Slender bodies, whose first frequency squared is 1e-10 of the mean square, are no rigid ones."""

import numpy as np
import pytest
from bodies import STEEL

import skfem_joint as sj

LENGTH, HEIGHT = 1.0, 3e-3


def beam(**how):
    """A strip of 3 mm by 1 m from the side, pressed on a base over its first 0.3 m."""
    strips = [("joint", 0.3, 60), ("arm", 0.7, 140)]
    sides = {"under": ("bottom", "joint"), "left": "left", "right": "right"}
    mesh = sj.build_plate(strips, HEIGHT, 1, order=2, boundaries=sides)
    return sj.Structure(mesh, STEEL, thickness=0.02, **how)


def test_the_first_mode_of_a_slender_beam_has_a_curve():
    structure = beam(fixed=["left"], joints=[sj.Joint("under", 1e4, 0.3)], damping_ratio=1e-3)
    system = structure.system([sj.Load("right", sj.Harmonic(1.0, 5.0), (0.0, 1.0))])
    natural = sj.natural_modes(system, 1, joints="stuck").frequencies[0]
    assert (2.0 * np.pi * natural) ** 2 < 1e-9 * system.mean_square_frequency
    (curve,) = sj.backbone(system, levels=3)
    assert curve.stuck_frequency == pytest.approx(natural, rel=1e-5)
    assert curve.frequency[0] == pytest.approx(natural, rel=1e-2)
    assert np.all(np.diff(curve.frequency) < 0.0)


def test_bending_of_slender_matrices_that_float_is_no_rigid_motion():
    """Two strips that float, held together by two sliders far below their limit at equal forces.

    The quasi-static answer of the matrices is that of the structure they come from, whose rigid
    motions are known from its mesh.
    """
    structure = beam(free=True)
    free = structure.system()
    x, y = structure.positions[:, 0], structure.positions[:, 1]
    ends = [int(np.argmin(np.hypot(x - at, y))) for at in (0.0, 0.5 * LENGTH, LENGTH)]
    rows = np.zeros((3, free.n))
    for row, node in zip(rows, ends, strict=True):
        row[:] = structure.T[2 * node + 1].toarray().ravel()
    # Bent by forces 1, -2, 1 at both ends and the middle, which are in balance.
    bend = rows[0] - 2.0 * rows[1] + rows[2]
    link = sj.point_friction(rows[0] - rows[2], 1.0)
    given = sj.System.from_matrices(
        free.M, free.K, contact=link, loads={"bend": (bend, sj.Harmonic(1e-3, 1.0))},
        points={"sag": bend},
    )  # fmt: skip
    run = sj.quasi_static(given, cycles=1, steps_per_cycle=8)
    inertia = 0.02 * HEIGHT**3 / 12.0
    # Middle of a beam on two supports under a force 2 F at the middle: F L^3 / (24 E I).
    sag = 2.0 * 1e-3 * LENGTH**3 / (24.0 * STEEL.E * inertia)
    assert run.peak[list(given.points).index("sag")] == pytest.approx(sag, rel=0.01)


def test_the_mode_of_a_long_bar_on_soft_springs_is_its_own_beside_round_off():
    """Elements are 1e9 times as stiff as they, so that round-off moves the frequency by 2e-5."""
    mesh = sj.build_bar([("joint", 0.1, 50), ("free", 0.5, 350)], {"end": 0.6})
    joint = sj.Joint("joint", 8e6, 0.7, tangential_stiffness=100.0 / (0.05 * 0.1))
    section = {"width": 0.05, "thickness": 0.01}
    system = sj.Structure(mesh, STEEL, joints=[joint], free=True, **section).system()
    (curve,) = sj.backbone(system, levels=3)
    mass = STEEL.density * 0.6 * 0.05 * 0.01
    assert curve.stuck_frequency == pytest.approx(np.sqrt(100.0 / mass) / (2.0 * np.pi), rel=1e-3)
    found = sj.ring_down(system, curve, 8, 50).frequency[0]
    assert found == pytest.approx(curve.stuck_frequency, rel=2e-3)  # of steps, (2 pi / 50)² / 12
