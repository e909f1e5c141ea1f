"""Ring-downs of springs in series with friction beside contact that opens: release and damping."""

from dataclasses import replace

import numpy as np
import pytest
from benchmarks.slider import MU, PRESSED, SPRING, loop_energy
from joint_scenes import bar_scene, joint
from opening_blocks import block, loads
from scipy import sparse

import skfem_joint as sj
from skfem_joint.study.scene_backbone import scene_backbone

LIGHT = {"up": 1e3, "across": 1e3}


def sprung(stiffness: float) -> sj.System:
    """Block whose base opens, with a tangential stiffness, Pa/m."""
    given = {} if np.isinf(stiffness) else {"tangential_stiffness": stiffness}
    # Plain elements, whose base opens at the levels of the tests.
    return replace(block(**given), incompatible=False).system(loads(**LIGHT))


def left_at_release(system: sj.System, curve: sj.Backbone) -> tuple[np.ndarray, np.ndarray]:
    """Forces that nothing balances at the release, over the largest load, and normal forces, N."""
    u, v, sigma, limits = curve.release
    assert not v.any()
    load = curve.level[-1] * (system.M @ curve.shape)
    contact = system.contact
    open_forces = load - system.K @ u - contact.B.T @ (contact.on_rows(limits) * sigma)
    N = sparse.csr_array(contact.normal.N).toarray()
    change = np.linalg.lstsq(N.T, open_forces, rcond=None)[0]
    left = np.abs(open_forces - N.T @ change).max() / np.abs(load).max()
    return left, contact.normal.force + change


@pytest.mark.parametrize(("model", "stiffness"), [(lambda s: s, 2e13), (sj.condense, 1e15)])
def test_a_release_is_in_equilibrium_with_the_load_of_the_highest_level(model, stiffness):
    system = model(sprung(stiffness))
    (curve,) = sj.backbone(system, levels=2, up_to=0.05)
    contact = system.contact.normal
    left, normal = left_at_release(system, curve)
    assert left < 1e-9
    assert np.all(normal > -1e-6 * contact.force.max())
    assert np.all(normal * contact.gaps(curve.highest) < 1e-9)
    assert curve.limits[-1] == pytest.approx(system.contact.limits(normal), rel=1e-6)
    assert np.abs(curve.limits[-1] / system.contact.w - 1.0).max() > 0.5  # which they were at rest
    rung = sj.ring_down(system, curve, 8, 50)
    held = system.contact.spring_energy(curve.friction[-1], curve.limits[-1])
    assert held > 0.0
    u = curve.highest
    whole = 0.5 * u @ (system.K @ u) + contact.potential(u) + held
    assert rung.energy[0] == pytest.approx(whole, rel=1e-9)


@pytest.mark.parametrize(
    "model",
    [lambda s: s, pytest.param(sj.condense, marks=pytest.mark.slow)],
    ids=["full", "condensed"],
)
def test_stiffer_springs_tend_to_the_ring_down_of_rigid_surfaces(model):
    found = []
    for stiffness in (1e16, np.inf):
        system = model(sprung(stiffness))
        (curve,) = sj.backbone(system, levels=2, up_to=0.05)
        assert curve.opened[-1] > 0.0
        rung = sj.ring_down(system, curve, 12, 100)
        assert rung.damping_ratio[0] > 1.1 * rung.damping_ratio[-1]
        assert np.all(np.diff(rung.energy) < 0.0)
        lost = rung.energy[0] - rung.energy[-1]
        assert 0.0 < rung.friction_work[-1].sum() + rung.impact_work < lost
        assert rung.frequency[-1] == pytest.approx(curve.stuck_frequency, rel=5e-4)
        assert rung.damping_ratio[-1] == pytest.approx(curve.viscous_damping[0], rel=2e-3)
        found.append(rung)
    near, rigid = found
    assert near.energy[0] == pytest.approx(rigid.energy[0], rel=0.01)
    assert near.frequency == pytest.approx(rigid.frequency, rel=1e-3)
    assert near.damping_ratio == pytest.approx(rigid.damping_ratio, rel=0.02)


def test_damping_is_that_of_a_slider_under_a_normal_force_in_phase():
    """Unit mass on a strong spring, so that a cycle is nearly a sine of its amplitude."""
    K, presses = 1e8, 1.5e5  # N/m
    pressed = {"friction": MU, "force": PRESSED, "stiffness": SPRING}
    contact = sj.point_contact([1.0, 0.0], [0.0, 1.0], **pressed)
    stiffness = sparse.csr_array([[K + presses, -presses], [-presses, presses]])
    system = sj.System.from_matrices(sparse.eye_array(2), stiffness, contact=contact)
    (curve,) = sj.backbone(system, levels=2, slips_at=1e5, up_to=1.0)
    rung = sj.ring_down(system, curve, 12, 200)

    def damping(amplitude: float) -> float:
        loop = loop_energy(presses * amplitude, amplitude)
        return loop / (2.0 * np.pi * (K + presses) * amplitude**2)

    exact = [damping(amplitude) for amplitude in rung.amplitude.tolist()]
    assert rung.damping_ratio[1:] == pytest.approx(exact[1:], rel=0.02)  # the filter has settled
    assert curve.friction_damping[-1] == pytest.approx(damping(curve.amplitude[-1]), rel=0.03)
    # The limit at the turning point is that of its normal force, which the spring carries whole.
    x = float(curve.highest[0])
    assert curve.limits[-1] == pytest.approx([MU * (PRESSED + presses * x)])
    assert curve.friction[-1] == pytest.approx([np.sign(x)])
    assert system.contact.constant().has_springs


def test_pulses_of_scenes_release_springs_under_their_forces():
    """Both models are released by the end of their own pulse, springs and all."""
    scene = bar_scene(
        joint=[joint(tangential_stiffness=1e12)],
        bar="coarse",
        load=[{"on": "free_end", "kind": "half_sine", "peak": 87.5e3, "rise_time": 1e-4}],
        time={"duration": 1e-3, "step": 1e-6},
        backbone={"levels": 4, "ring_down": 12, "released": "loads"},
        models={"run": ["full", "condensed", "reduced"]},
        reduction={"reference": "static"},
    )
    full, condensed, reduced = (model.ring_downs[0] for model in scene_backbone(scene).models)
    pulse = sj.integrate(scene.system(), step=1e-6, n_steps=200)
    assert scene.system().contact.spring_energy(pulse.final_sigma) > 0.05 * pulse.stored_energy[1]
    assert full.energy[0] == pytest.approx(pulse.stored_energy[1], rel=2e-3)
    assert condensed.energy[0] == pytest.approx(full.energy[0], rel=1e-4)
    assert reduced.energy[0] == pytest.approx(full.energy[0], rel=2e-3)
    for small in (condensed, reduced):
        assert small.amplitude == pytest.approx(full.amplitude, rel=1e-3)
        assert small.damping_ratio == pytest.approx(full.damping_ratio, rel=1e-3)


def test_a_mode_that_is_weak_beside_others_is_said_to_be():
    """A chain whose foot sticks: released in its first mode with a fiftieth of the second."""
    n = 6
    K = sparse.csr_array(1e6 * (np.diag([2.0] * 5 + [1.0]) - np.eye(n, k=1) - np.eye(n, k=-1)))
    M, foot = sparse.eye_array(n, format="csr"), sparse.csr_array(np.eye(n)[:1])
    system = sj.System(M, 2e-5 * K, K, sj.Contact(foot, np.array([100.0]), np.inf))
    second, first = sj.backbone(system, (2, 1), levels=4, up_to=0.5)
    for share, weak in ((0.02, 1), (1.0, 0)):
        size = share * np.linalg.norm(first.highest) / np.linalg.norm(second.highest)
        start = first.highest + size * second.highest, np.zeros(n)
        found = sj.ring_down(system, second, 20, start=start)
        assert len(found.notes) == weak
    assert not sj.ring_down(system, second, 20).notes
