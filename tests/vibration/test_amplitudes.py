"""Curves at given amplitudes of a point."""

import numpy as np
import pytest
from bodies import pressed, structure
from clamped_plates import lapped
from stepping_systems import arm

import skfem_joint as sj
from skfem_joint.vibration.amplitudes import GRAVITY, level_of


def plate(*direction: float) -> sj.System:
    """Plate in plan whose first mode bends, so that its slips turn; loaded across or as given."""
    mesh = sj.build_plate([("joint", 0.2, 10), ("free", 0.3, 10)], 0.05, 4)
    load = sj.Load("right", sj.Harmonic(1.0, 100.0), direction or (0.0, 1.0))
    return structure(mesh, [pressed()], stiffness_damping=1e-6).system([load])


@pytest.mark.parametrize(
    "make", [lambda: (arm(damping_ratio=1e-3), "end"), lambda: (plate(), "right")]
)
@pytest.mark.parametrize(
    ("quantity", "power", "unit"),
    [("displacement", 0, 1.0), ("velocity", 1, 1.0), ("acceleration", 2, 1.0),
     ("acceleration_g", 2, GRAVITY)],
)  # fmt: skip
def test_a_curve_has_the_amplitudes_that_are_asked_for(make, quantity, power, unit):
    system, point = make()
    (whole,) = sj.backbone(system, levels=8, up_to=0.6)
    values = whole.displacement[:, 0] * (2.0 * np.pi * whole.frequency) ** power / unit
    asked = values[[0, 3, 6]] * np.array([0.2, 1.1, 0.9])
    (found,) = sj.backbone(system, levels=sj.Amplitudes(point, **{quantity: asked}))
    omega = 2.0 * np.pi * found.frequency
    np.testing.assert_allclose(found.displacement[:, 0] * omega**power / unit, asked, rtol=1e-4)
    assert np.all(np.diff(found.level) > 0.0)
    assert found.slips_at == pytest.approx(whole.slips_at)
    np.testing.assert_allclose(found.friction_work.sum(axis=1), found.losses.friction)


def test_a_force_at_resonance_does_the_work_that_a_cycle_loses():
    system = arm(damping_ratio=1e-3)
    (found,) = sj.backbone(system, levels=sj.Amplitudes("end", force=[20.0, 200.0]))
    work = np.pi * np.array([20.0, 200.0]) * found.displacement[:, 0]
    np.testing.assert_allclose(found.losses.lost, work, rtol=1e-4)


def test_a_force_moves_a_single_mass_at_its_resonance_as_marching_does():
    """Of a single unknown in vibration at 90 degrees after its force, but for higher harmonics."""
    joint = [sj.point_friction([1.0], limit, stiffness=3e5) for limit in (1.0, 2.0, 8.0)]
    matrices = {"M": [[2.0]], "K": [[5e5]], "C": [[4.0]], "contact": sum(joint[1:], joint[0])}
    free = sj.System.from_matrices(**matrices, points={"mass": [1.0]})
    (curve,) = sj.backbone(free, levels=sj.Amplitudes("mass", force=2.0))
    load = {"mass": ([1.0], sj.Harmonic(2.0, 1.0))}
    driven = sj.System.from_matrices(**matrices, loads=load)
    (response,) = sj.response(driven, curve.frequency, refined=False, estimated=False)
    (point,) = response.points
    assert point.amplitude[0] == pytest.approx(curve.displacement[0, 0], rel=0.02)
    assert np.abs(np.degrees(point.phase[0])) == pytest.approx(90.0, abs=4.0)
    assert response.losses.loss_factor[0] == pytest.approx(curve.losses.loss_factor[0], rel=0.02)


def test_contact_that_opens_has_the_amplitude_too():
    one = lapped(contact="unilateral")
    system = one.system([sj.Load("end", sj.Harmonic(1.0, 100.0), (0.0, 1.0, 0.0))], ["end"])
    (whole,) = sj.backbone(system, levels=3, up_to=0.5)
    asked = 0.8 * whole.displacement[-1, 0]
    (found,) = sj.backbone(system, levels=sj.Amplitudes("end", displacement=asked), up_to=0.5)
    assert found.displacement[0, 0] == pytest.approx(asked, rel=1e-4)
    assert found.opened is not None


def test_what_is_not_reached_or_does_not_move_is_refused():
    system = plate()
    with pytest.raises(
        sj.InputError, match="found a displacement of 1 m at right, but at its high"
    ):
        sj.backbone(system, levels=sj.Amplitudes("right", displacement=1.0))
    with pytest.raises(sj.InputError, match="point: found 'left', must be one of right"):
        sj.backbone(system, levels=sj.Amplitudes("left", displacement=1.0))
    with pytest.raises(sj.InputError, match=r"mode 1 does not move 'right'.* modes 3, .* move it"):
        sj.backbone(plate(1.0, 0.0), levels=sj.Amplitudes("right", displacement=1e-9))
    with pytest.raises(sj.InputError, match="found none, must be exactly one of displacement"):
        sj.Amplitudes("right")
    with pytest.raises(sj.InputError, match=r"force\[1\]: found 1, must be > 2"):
        sj.Amplitudes("right", force=[2.0, 1.0])
    with pytest.raises(sj.InputError, match="keep_path: needs levels"):
        sj.backbone(system, levels=sj.Amplitudes("right", force=1.0), keep_path=True)


def test_levels_follow_a_power_law_exactly_within_and_below_those_known():
    level = np.array([1.0, 2.0, 4.0])
    np.testing.assert_allclose(
        level_of(np.array([3e-3, 3.0, 24.0]), level, 3.0 * level**2), [0.0316227766, 1.0, 8.0**0.5]
    )
