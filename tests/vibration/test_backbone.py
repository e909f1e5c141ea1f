"""Damping and frequency against amplitude: exact curves, loops, free vibration; SI units."""

from dataclasses import replace

import numpy as np
import pytest
from bodies import DENSITY, EA, MU, THICKNESS, WIDTH, pressed, structure
from clamped_plates import bolted, loads
from scipy import sparse
from stepping_systems import arm

import skfem_joint as sj
from skfem_joint.slow.quasi_static import QuasiStatic
from skfem_joint.structure.parameters import with_values
from skfem_joint.vibration.backbone import Backbone, Factors, backbone

LINE = DENSITY * WIDTH * THICKNESS
JOINT, FREE, TAU = 0.2, 0.5, 1.75e6  # m, m, N/m
LIMIT = TAU * JOINT
MOMENTUM = (2.0 / np.pi) * np.sqrt(2.0 * LINE * FREE)  # force at the joint by modal level
PULSE = 2e-4  # s, of its rise


def bar(
    elements: int = 100, power: float = 0.0, damping: float = 0.0, held: bool = True
) -> sj.System:
    """Bar with a free length beyond a joint whose friction rises as a power from its loaded end."""
    x = np.linspace(0.0, JOINT, 401)
    pressure = TAU / MU / WIDTH * (power + 1.0) * (1.0 - x / JOINT) ** power
    joint = sj.Joint("joint", sj.PressureTable(tuple(x), tuple(pressure)), MU)
    supports = ["fixed"] if held else []
    return arm(None, joint, (elements, 100), stiffness_damping=damping, fixed=supports)


def plate(bolted: bool = False) -> sj.System:
    """Plate in plan whose first mode bends: its slips turn."""
    bolts = tuple(sj.Bolt((x, 0.025), 20e3, 0.009, 0.0055) for x in (0.05, 0.15))
    joint = pressed(pressure=sj.Bolts(bolts, reach=0.01) if bolted else 8e6)
    mesh = sj.build_plate([("joint", JOINT, 20), ("free", 0.3, 30)], 0.05, 5)
    return structure(mesh, [joint]).system()


def struck(force: float, damping: float = 0.0) -> sj.System:
    """Bar struck at its end; its frequencies are 2.5, 7.5, 12.5 kHz."""
    return arm(sj.HalfSine(force, PULSE), stiffness_damping=damping)


def exact(found: Backbone, power: float) -> tuple[np.ndarray, np.ndarray]:
    """Frequency over the stuck one, and damping ratio, of a quarter wave beyond the joint.

    What slips takes u = k F^n, n = (power + 2) / (power + 1), where it is loaded, F being what the
    inertia of the mode adds up to: then D = 4 (n - 1) / (n + 1) F u, which goes with F^(n + 1).
    """
    n = (power + 2.0) / (power + 1.0)
    force = found.level * MOMENTUM
    depth = JOINT * (force / LIMIT) ** (1.0 / (power + 1.0))
    slip = force * depth / EA * (power + 1.0) / (power + 2.0)
    stiff = found.level / (2.0 * np.pi * found.stuck_frequency) ** 2
    q = stiff + slip * force / found.level
    work = 4.0 * (n - 1.0) / (n + 1.0) * force * slip
    return np.sqrt(stiff / q), work / (2.0 * np.pi * found.level * q)


@pytest.mark.parametrize("power", [0.0, 1.0])
def test_curves_of_a_bar_converge_to_the_exact_ones(power):
    errors = []
    for elements in (100, 400):
        (found,) = backbone(bar(elements, power), levels=8, up_to=0.7)
        frequency, damping = exact(found, power)
        assert MOMENTUM * found.slips_at == pytest.approx(LIMIT, rel=0.02)
        seen = found.level > 0.1 * found.slips_at
        ratio = found.frequency / found.stuck_frequency / frequency
        errors.append(np.abs([ratio - 1.0, found.friction_damping / damping - 1.0])[:, seen].max(1))
        assert found.masing_error < 1e-12
    assert errors[1][0] < errors[0][0] < 1e-4
    assert errors[1][1] < 0.6 * errors[0][1] < 6e-3


def test_viscous_damping_is_added_and_stuck_joints_have_it_alone():
    (found,) = backbone(bar(damping=1e-6), levels=3, up_to=1e-4)
    assert found.state == ("stick",) * 3
    assert found.frequency == pytest.approx(found.stuck_frequency, rel=1e-9)
    assert found.damping_ratio == pytest.approx(np.pi * found.frequency * 1e-6, rel=1e-9)


def test_a_joint_beyond_its_limit_slips_as_a_whole():
    (found,) = backbone(bar(), levels=4, up_to=1.3)
    assert found.state[-1] == "gross"
    assert found.share[-1] == pytest.approx(1.0)
    assert found.state[0] == "partial"
    assert found.doubts == ("", "", "", "whole slip")
    assert any("from the level 1.3 of gross slip on a joint slips" in w for w in found.notes)
    (below,) = backbone(bar(), levels=4, up_to=0.9)
    assert not any(below.doubts)
    assert not any("slips as a whole" in text for text in below.notes)
    # Displacement of the end and modal amplitude belong together.
    modal = np.abs(found.amplitude[:1] * found.shape[-1])
    assert found.displacement[0] == pytest.approx(modal, rel=0.05)


def test_a_curve_says_where_a_ring_down_differs_from_it():
    """Higher modes of a uniform bar take part: its damping is larger; with little friction not."""
    (found,) = backbone(bar(), levels=8, up_to=0.5)
    rung = sj.ring_down(bar(), found, 20)
    marked = rung.beside(found)
    k = int(marked.differs.argmax())
    assert found.doubts == ("",) * 8
    assert marked.doubts[k] == "ring-down differs"
    (said,) = set(marked.notes) - set(found.notes) - {w for w in marked.notes if "Hz" in w}
    near = int(np.abs(rung.amplitude - found.amplitude[k]).argmin())
    assert rung.damping_ratio[near] > 1.2 * found.damping_ratio[k]
    assert "damping ratio" in said
    (stuck,) = backbone(bar(damping=1e-6), levels=4, up_to=1e-3)  # viscous damping alone
    same = sj.ring_down(bar(damping=1e-6), stuck, 20).beside(stuck)
    assert not same.differs.any()
    assert same.notes == stuck.notes


def slider(limit: float = 1.0) -> sj.System:
    """Two masses of 1 kg on springs of 1 N/m, one of which drags a slider of ``limit`` N."""
    K = sparse.csr_array([[2.0, -1.0], [-1.0, 1.0]])
    contact = sj.point_friction([1.0, 0.0], limit)
    return sj.System.from_matrices(sparse.eye_array(2), K, contact=contact)


def test_a_joint_of_one_slider_says_that_the_default_range_saw_no_slip():
    (found,) = backbone(slider(), levels=4)
    assert not found.share.any()
    assert any("nothing slips up to the highest level, 0.7 of gross slip" in w and "up_to above"
               in w for w in found.notes)  # fmt: skip
    (beyond,) = backbone(slider(), levels=4, up_to=1.5)
    assert beyond.state == ("stick", "stick", "stick", "gross")
    assert beyond.friction_damping[-1] > 0.0
    assert not any("nothing slips" in text for text in beyond.notes)


def test_levels_below_the_round_off_of_friction_have_the_linear_mode():
    """Their state was zero, and the frequency infinite."""
    slider = sj.point_friction([1.0], limit=1e6, stiffness=1.0, name="foot")
    system = sj.System.from_matrices(
        np.array([[2.0]]), np.array([[2e5]]), contact=slider, loads={"mass": (0, lambda t: 0.0 * t)}
    )
    (curve,) = sj.backbone(system, levels=[1e-12, 1e-6, 1.0, 20.0])
    assert curve.frequency == pytest.approx(np.sqrt(200001.0 / 2.0) / (2.0 * np.pi), rel=1e-9)


def test_levels_that_are_given_are_named_as_such():
    """Not as shares of a level of 1 m/s² kg^1/2."""
    (found,) = backbone(slider(), levels=[0.1, 0.2])
    assert any("highest level, 0.2 m/s² kg^1/2" in text for text in found.notes)


def test_what_friction_alone_holds_has_the_curve_of_what_is_fixed_where_it_sticks():
    (fixed,) = backbone(bar(), levels=5, up_to=0.5)
    (held,) = backbone(bar(held=False), levels=5, up_to=0.5, slips_at=fixed.slips_at)
    assert held.frequency == pytest.approx(fixed.frequency, rel=1e-7)
    assert held.friction_damping == pytest.approx(fixed.friction_damping, rel=1e-5)


def test_higher_modes_near_odd_multiples_are_reported():
    (found,) = backbone(bar(), levels=2)
    ratios = found.higher[0] / found.frequency
    text = f"mode 2 at {ratios[0]:.3g} to {ratios[1]:.3g} times"
    assert text in found.excites[0]
    assert any(text in sentence for sentence in found.notes)
    assert found.at_levels(np.array([0])).excites[0] == f"mode 2 at {ratios[0]:.3g} times"


def floating() -> sj.System:
    """Two masses of 1 kg on a spring, which rub on each other: the first mode moves both alike."""
    K, rub = [[1.0, -1.0], [-1.0, 1.0]], sj.point_friction([1.0, -1.0], 1.0, stiffness=1.0)
    return sj.System.from_matrices(np.eye(2), K, contact=rub)


def all_in_contact() -> sj.System:
    """The part of the bar that is in contact, by itself."""
    system, contact = bar(), np.arange(100)
    part = [sparse.csr_array(A)[contact][:, contact] for A in (system.M, system.C, system.K)]
    slips = sparse.eye_array(100, format="csr")
    return sj.System(*part, sj.Contact(slips, system.contact.w, np.inf))


@pytest.mark.parametrize(
    ("system", "how", "says"),
    [
        (bar(), {"levels": 2, "up_to": 25.0}, "slips as a whole at the first level"),
        (bar(held=False), {"up_to": 1.3}, "friction alone holds"),
        (bar(40).project(np.eye(140)[:, :40]), {}, "keep interface_modes"),
        (bar(), {"modes": (500,)}, "there are"),
        (floating(), {}, "mode 1 moves the structure as a rigid body; support it"),
        (bar(), {"modes": [1, 2, 1]}, r"modes: found \[1, 2, 1\], each must be there once"),
        (bar().with_contact(given=np.zeros(100)), {}, "needs friction"),
        (all_in_contact(), {}, "every unknown is in contact"),
        (slider(), {"levels": [1e3]}, r"first level already, 1000 m/s² kg\^1/2; give lower"),
        (bar(), {"levels": []}, "levels: found .*must be a list of numbers, each > 0"),
        (bar(), {"levels": [0.0, 1.0]}, r"levels\[0\]: found 0.0, must be > 0"),
        (bar(), {"levels": [1.0, 1.0]}, r"levels\[1\]: found 1, must be > 1"),
    ],
)
def test_modes_that_are_not_there_are_refused(system, how, says):
    with pytest.raises(sj.InputError, match=says):
        backbone(system, **how)


def test_modes_that_ring_together_are_separated():
    system = struck(1.0, 1e-6)  # a newton: the joint sticks
    hit = sj.integrate(system, duration=2.0 * PULSE, step=1e-6).final
    for curve in backbone(system, (1, 2), levels=1):
        found = sj.ring_down(system, curve, 20, start=hit)
        assert found.frequency == pytest.approx(curve.stuck_frequency, rel=2e-4)
        ratio = np.pi * curve.stuck_frequency * 1e-6
        assert found.damping_ratio == pytest.approx(ratio, rel=0.01)


def test_a_pulse_rings_down_along_the_curve_and_loses_its_energy_in_the_joint():
    system = struck(60e3)
    hit = sj.integrate(system, duration=2.0 * PULSE, step=1e-6).final
    (curve,) = backbone(system)
    halves = np.repeat(np.eye(2), 20, axis=1)
    parted = system.with_contact(J=halves, joints=("inner", "outer"))
    found = sj.ring_down(parted, curve, 30, scheme=sj.generalized_alpha(1.0), start=hit)
    work = found.friction_work.sum(axis=1)
    assert found.energy[0] - found.energy == pytest.approx(work, abs=1e-9 * found.energy[0])
    assert np.all(np.diff(found.friction_work, axis=0) >= -1e-12 * work[-1])
    assert found.friction_work[-1, 1] > found.friction_work[-1, 0]  # it is pulled from there
    frequency = np.interp(found.amplitude, curve.amplitude, curve.frequency)
    seen = found.amplitude > curve.amplitude[0]
    assert seen.sum() > 5
    assert found.frequency[seen] == pytest.approx(frequency[seen], rel=0.02)


def test_a_ring_down_does_not_depend_on_its_step_and_states_where_it_does():
    """The trapezoidal rule keeps stiff motions of the joint ringing from step to step."""
    system = plate(bolted=True)
    system = replace(system, C=2e-6 * system.K)
    (full,) = backbone(system, levels=8, up_to=0.77)
    small = sj.reduce(system, curve=full)
    (curve,) = backbone(small, levels=full.level)
    settled = sj.ring_down(small, curve, 10, 400)
    default = sj.ring_down(small, curve, 10, 50)
    assert default.damping_ratio == pytest.approx(settled.damping_ratio, rel=5e-3)
    ringing = sj.ring_down(small, curve, 10, 50, sj.generalized_alpha(1.0))
    for found in (default, ringing):
        apart = found.damping_ratio - settled.damping_ratio
        true = np.abs(apart).max() / settled.damping_ratio.max()
        assert 0.5 * true < found.step_error["damping_ratio"] < 2.0 * true
    assert ringing.step_error["damping_ratio"] > 0.1


def test_a_joint_slips_as_a_whole_from_the_level_on_at_which_the_first_one_is_said_to():
    """Interpolated over a factor of 1.3 the level of this bending plate was 14 % high."""
    system = plate()
    (shares,) = backbone(system, levels=1)
    (curve,) = backbone(system, levels=shares.slips_at * np.array([0.5, 0.97, 1.03]))
    assert curve.state == ("partial", "partial", "gross")


def test_a_model_of_a_curve_at_given_levels_serves_these_and_asks_for_gross_slip_elsewhere():
    system = bar()
    (shares,) = backbone(system, levels=4, up_to=0.5)
    (curve,) = backbone(system, levels=shares.level)
    small = sj.reduce(system, curve=curve)
    (own,) = backbone(small, levels=curve.level)
    assert own.frequency == pytest.approx(curve.frequency, rel=1e-3)
    for levels in (4, sj.Amplitudes("end", force=[10.0])):
        with pytest.raises(sj.InputError, match=r"slips_at: not known.*give levels, up to the"):
            backbone(small, levels=levels)
    (other,) = backbone(small, levels=4, up_to=0.5, slips_at=shares.slips_at)
    np.testing.assert_allclose(other.level, curve.level, rtol=1e-12)


def test_too_few_cycles_are_refused():
    (curve,) = backbone(slider(), levels=1)
    with pytest.raises(sj.InputError, match="cycles: found 1, must be >= 4"):
        sj.ring_down(slider(), curve, 1)


def creeping(beta: float) -> sj.System:
    """Bar with a mass at its end, so that friction excites no higher mode; 0.2 m in contact."""
    system = arm(joint=sj.Joint("joint", 50e6, MU, beta=beta))
    mass = system.M.copy()
    mass[-1, -1] += 3.0
    return replace(system, M=mass)


def test_a_curve_is_that_of_coulombs_law_and_says_so_where_the_joints_have_another():
    """With beta = 100 s/m its damping is from 0.2 to 3 %, that of the ring-down from 1 to 3 %."""
    (coulomb,), (curve,) = (backbone(creeping(beta), levels=8) for beta in (np.inf, 100.0))
    for name in ("amplitude", "frequency", "damping_ratio"):
        assert getattr(curve, name) == pytest.approx(getattr(coulomb, name), rel=1e-9)
    assert not [text for text in coulomb.notes if "Coulomb's law" in text]
    (said,) = [text for text in curve.notes if "the curve is of Coulomb's law" in text]
    assert "beta = 100 s/m" in said
    assert "slower than about 0.01 m/s" in said
    marked = sj.ring_down(creeping(100.0), curve, 60).beside(curve)
    assert marked.differs[0]
    assert "takes for granted Coulomb's law" in marked.notes[-1]


@pytest.mark.parametrize(("held", "mode"), [({}, 1), ({"fixed": [], "free": True}, 4)])
def test_a_shift_that_holds_loose_bodies_is_not_seen(held, mode):
    """The stiffness of plates that friction alone holds together is singular: masses are added."""
    system = bolted(order=2, **held).system(loads("right", 2))
    (curve,) = backbone(system, [mode], levels=4, up_to=1e-3)  # nothing slips
    true = sj.natural_modes(system, mode, joints="stuck").frequencies[-1]
    shift = QuasiStatic(system).shift / (2.0 * np.pi * true) ** 2
    assert 0.5 * shift > 5e-9
    assert curve.stuck_frequency == pytest.approx(true, rel=1e-9)
    np.testing.assert_allclose(curve.frequency, true, rtol=1e-9)


@pytest.mark.parametrize("held", [{}, {"fixed": [], "free": True}])
def test_curves_of_other_limits_and_damping_use_factors_again(held):
    kept, modes, levels, factors = Factors(), [4 if held else 1], [30.0, 120.0, 500.0], []
    for friction, damping in ((0.3, 0.01), (0.4, 0.02)):
        given = bolted(joint={"friction": friction}, damping_ratio=damping, **held)
        system = given.system(loads("right", 2))
        (again,) = backbone(system, modes, levels, keep_path=True, factors=kept)
        factors.append(again.path.cycles.levels.whole.schur)
    assert factors[0] is factors[1]
    (alone,) = backbone(system, modes, levels)
    for name in ("frequency", "damping_ratio", "amplitude"):
        np.testing.assert_array_equal(getattr(again, name), getattr(alone, name))
    stiffer = with_values(given, {"material.E": 190e9}).system(loads("right", 2))
    (again,), (alone,) = (
        backbone(stiffer, modes, levels, factors=others) for others in (kept, None)
    )
    np.testing.assert_array_equal(again.frequency, alone.frequency)


def masses(apart: float, damper: float = 0.0) -> sj.System:
    """Two masses at some 10 Hz, whose frequencies are ``apart``, at a joint that slips in parts."""
    own = (20.0 * np.pi) ** 2
    K = np.diag([own, own * (1.0 + apart), 50.0]) + 800.0 * np.array(
        [[1.0, 0.0, -1.0], [0.0, 1.0, -1.0], [-1.0, -1.0, 2.0]]
    )
    springs = [sj.point_friction([0, 0, 1], k / 210, stiffness=400.0) for k in range(1, 21)]
    C = np.diag([damper, 0.0, 0.0])
    return sj.System.from_matrices(np.diag([1.0, 1.0, 0.002]), K, C, contact=springs)


@pytest.mark.parametrize(("apart", "together"), [(0.03, True), (1.0, False)])
def test_a_close_mode_is_noted_where_damping_errs_by_it(apart, together):
    system = replace(masses(apart), P=np.eye(3), points=("a", "b", "joint"))
    curve = backbone(system, [2], levels=3)[0]
    amplitude = curve.displacement[-1:, 1]
    (true,) = sj.nonlinear_modes(system, [2], amplitudes=amplitude, at="b", confirm=False)
    error = curve.damping_ratio[-1] / true.damping_ratio[0] - 1.0
    assert (error > 0.1) == together
    assert any("mode 1, at" in note for note in curve.notes) == together
    assert not any("couples it" in note for note in curve.notes)


@pytest.mark.parametrize(("damper", "coupled"), [(6.0, True), (0.3, False)])
def test_damping_that_couples_modes_is_noted_with_the_ratio_of_the_eigenvalue(damper, coupled):
    system = masses(0.03, damper)
    curve = backbone(system, [2], levels=1, up_to=0.01)[0]
    M, C, K = (A.toarray() for A in (system.M, system.C, system.stuck_stiffness))
    zero, one = np.zeros((3, 3)), np.eye(3)
    found = np.linalg.eigvals(np.block([[zero, one], [-np.linalg.solve(M, x) for x in (K, C)]]))
    (true,) = (-s.real / abs(s) for s in found if abs(s.imag / (2 * np.pi) - 11.06) < 0.1)
    alone = curve.viscous_damping[0]
    assert (abs(true / alone - 1.0) > 0.1) == coupled
    notes = [note for note in curve.notes if "couples it" in note]
    assert len(notes) == coupled
    assert all(f"is {true:.3g}, not {alone:.3g}" in note for note in notes)


def test_modes_of_one_frequency_are_noted():
    springs = [sj.point_friction(row, 1.0, stiffness=40.0) for row in np.eye(2)]
    system = sj.System.from_matrices(np.eye(2), 40.0 * np.eye(2), contact=springs)
    notes = backbone(system, [1], levels=1)[0].notes
    assert any("mode 2 has the same frequency" in note for note in notes)


def test_a_reduced_model_serves_the_limits_and_loads_alone_that_it_was_made_with():
    system = arm(sj.Harmonic(1e5, 1000.0), elements=(10, 10), stiffness_damping=1e-6)
    of_mode = sj.reduce(system, 6, curve=backbone(system, levels=3)[0])
    weaker = of_mode.with_contact(given=0.3 * of_mode.contact.given)
    with pytest.raises(sj.InputError, match=r"backbone: .* friction limits .* are not those of"):
        backbone(weaker, levels=3)
    of_loads = sj.reduce(system, 6, frequency=1000.0)
    louder = replace(of_loads.loads[0], amplitude=sj.Harmonic(3e5, 1000.0))
    with pytest.raises(sj.InputError, match=r"response: .* loads .* are not those of"):
        sj.response(replace(of_loads, loads=(louder,)), [1000.0])
    for_run = sj.reduce(system, 6)
    for model, known in ((for_run, True), (replace(for_run, loads=(louder,)), False)):
        for follow in (sj.integrate, sj.quasi_static):
            run = follow(model, cycles=1, steps_per_cycle=64)
            assert any("The error of the run is not known" in note for note in run.notes) != known


def test_a_curve_or_run_of_another_structure_of_as_many_unknowns_is_refused():
    system = arm(sj.Harmonic(1e5, 1000.0), elements=(10, 10), stiffness_damping=1e-6)
    (curve,) = backbone(system, levels=3)
    run = sj.integrate(system, cycles=1, steps_per_cycle=64, save=sj.Save(fields=True))
    elsewhere = system.contact.B[:, ::-1]
    for other in (
        replace(system, K=1.1 * system.K), replace(system, M=1.1 * system.M),
        system.with_contact(B=elsewhere),
    ):  # fmt: skip
        for analysis in (
            lambda one: sj.ring_down(one, curve, 8),
            lambda one: sj.reduce(one, curve=curve),
            lambda one: sj.random_response(one, [curve], [[1.0, 1.0], [2e3, 1.0]]),
            lambda one: sj.reduce(one, run=run),
        ):
            with pytest.raises(sj.InputError, match="does not belong to the system"):
                analysis(other)


def test_a_curve_of_other_friction_limits_or_damping_is_not_taken_for_the_systems_own():
    """A ring-down says so; modes and random vibration, which are made of the curve, are refused."""
    system = arm(sj.Harmonic(1e5, 1000.0), elements=(10, 10), stiffness_damping=1e-6)
    (curve,) = backbone(system, levels=3)
    psd = [[1.0, 1.0], [2e3, 1.0]]
    weaker = system.with_contact(given=0.5 * system.contact.given)
    for other, name in (
        (weaker, "friction limits"), (replace(system, C=2.0 * system.C), "damping"),
    ):  # fmt: skip
        (note,) = sj.ring_down(other, curve, 8).notes
        assert f"one of other {name} than the system's" in note
        with pytest.raises(sj.InputError, match=f"which has other {name}; compute"):
            sj.random_response(other, [curve], psd)
    with pytest.raises(sj.InputError, match="which has other friction limits; compute"):
        sj.reduce(weaker, curve=curve)
    for same in (arm(elements=(10, 10), stiffness_damping=1e-6), system.with_beta(100.0)):
        assert not sj.ring_down(same, curve, 8).notes
    assert sj.reduce(replace(system, C=2.0 * system.C), curve=curve).n < system.n  # of its states


def test_levels_far_below_the_first_slip_have_no_damping_by_friction_on_springs():
    """The round-off of forces of springs was slip: a damping of 2 % at 1e-16 of gross slip."""
    joint = sj.Joint("joint", friction=0.5, pressure=1e7, tangential_stiffness=1e13)
    system = arm(joint=joint, elements=(20, 20))
    for up_to in (1e-6, 1e-12, 1e-16):
        (curve,) = sj.backbone(system, levels=3, up_to=up_to)
        assert not curve.friction_damping.any()
