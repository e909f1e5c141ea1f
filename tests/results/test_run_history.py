"""What histories say: loops, stick and slip, steady state, distance between runs."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from bodies import structure as structure_of
from joint_scenes import bar_scene, harmonic, joint, lap_joint
from scipy import sparse
from scipy.integrate import trapezoid

import skfem_joint as sj
from skfem_joint.output.report import summary
from skfem_joint.results.history import compare, hysteresis_loop, relative, slip_state
from skfem_joint.runs.last_cycle import energies, peaks, steady_state
from skfem_joint.vibration.response import steady_point

STEPS = 200


def harmonic_run(system: sj.System | None = None, cycles: int = 3, **options: Any) -> sj.Run:
    return sj.integrate(
        system or lap_joint().system(),
        step=1e-3 / STEPS,
        n_steps=cycles * STEPS,
        cycle_steps=STEPS,
        save=sj.Save(**({"fields": True} | options)),
    )


@pytest.fixture(scope="module")
def run():
    return harmonic_run()


def scaled(run: sj.Run, u: float, **cycles: float) -> sj.Run:
    """Run with other displacements, and other values of its cycles."""
    values = {name: factor * getattr(run.cycles, name) for name, factor in cycles.items()}
    work = cycles["friction"] * run.friction_work
    made = replace(run.cycles, **values)
    return replace(run, point_u=u * run.point_u, friction_work=work, cycles=made)


def test_errors_are_relative_to_the_reference_and_signed(run):
    errors = compare(run, scaled(run, 1.1, peak=1.2, friction=0.5, input=1.3))
    assert errors.displacement_rms == pytest.approx(0.1)
    assert errors.displacement_max == pytest.approx(0.1)
    assert errors.peak_displacement == pytest.approx(0.2)
    assert errors.friction_energy == pytest.approx(-0.5)
    assert errors.friction_energy_per_cycle == pytest.approx(-0.5)
    assert errors.loop_energy_per_cycle == pytest.approx(0.3)
    assert (relative(0.0, 0.0), relative(1.0, 0.0)) == (0.0, None)
    rest = scaled(run, 0.0, peak=0.0, friction=0.0)
    for other, error in ((rest, 0.0), (run, None)):
        errors = compare(rest, other)
        assert errors.displacement_rms == errors.displacement_max == error
        assert errors.peak_displacement == errors.friction_energy == error
    one = sj.integrate(lap_joint().system(), step=1e-5, n_steps=50)  # without cycles
    errors = compare(one, one)
    assert errors.friction_energy_per_cycle is errors.loop_energy_per_cycle is None
    assert peaks(one) == pytest.approx(one.peak)


def test_runs_of_other_times_or_points_are_not_compared(run):
    renamed = replace(run, system=replace(run.system, points=("tip",)))
    for other in (harmonic_run(every=2), replace(run, times=2.0 * run.times), renamed):
        with pytest.raises(sj.InputError, match="same times and named points"):
            compare(run, other)


def test_a_point_that_hardly_moves_does_not_decide_the_error(run):
    # A point beyond the active length: its motion is round-off, and so is its error.
    def with_stuck_point(noise):
        still = noise * np.sin(np.arange(run.times.size))[:, np.newaxis]
        P = sparse.vstack([run.system.P, run.system.P])
        return replace(
            run,
            system=replace(run.system, P=P, points=("free_end", "stuck")),
            point_u=np.hstack([run.point_u, still]),
            cycles=replace(run.cycles, peak=np.hstack([run.cycles.peak, 0.0 * run.cycles.peak])),
        )

    errors = compare(with_stuck_point(1e-25), with_stuck_point(-2e-22))
    assert errors.displacement_rms < 1e-9
    assert errors.displacement_max < 1e-9


def test_components_of_a_point_are_compared_with_the_largest_of_them(run):
    def in_space(y):
        P = sparse.vstack([run.system.P] * 3)
        system = replace(run.system, P=P, points=("end.x", "end.y", "end.z"))
        u = run.point_u * [1.0, y, 0.0]
        return replace(run, system=system, point_u=u)

    errors = compare(in_space(1e-6), in_space(2e-6))
    assert errors.by_point["end.y"] == pytest.approx((1e-6, 1e-6))


def test_area_of_the_stored_loop_is_the_work_put_in_and_it_needs_one_stored_cycle(run):
    u, f = hysteresis_loop(run, "free_end", rows_per_cycle=STEPS)
    assert u.shape == f.shape == (STEPS + 1,)
    assert trapezoid(f, u) == pytest.approx(run.cycles.input[-1, 0], rel=1e-10)
    # In steady state it closes.
    assert u[-1] == pytest.approx(u[0], abs=1e-5 * np.abs(u).max())
    assert f[-1] == pytest.approx(f[0], abs=1e-9 * np.abs(f).max())
    u, f = hysteresis_loop(run, "free_end")
    assert np.array_equal(u, run.point("free_end"))
    assert f == pytest.approx(63e3 * np.sin(2e3 * np.pi * run.times), abs=1e-6)
    with pytest.raises(sj.InputError, match="less than one cycle"):
        hysteresis_loop(run, "free_end", rows_per_cycle=u.size)


def test_arctan_points_slip_from_a_share_of_their_own_speed_on(run):
    velocity = np.array([[1.0, -0.2, 0.009, 5e-4], [0.04, 0.011, -0.2, 5e-4]])
    assert slip_state(velocity, np.full(4, 1e5)).tolist() == [[1, 1, 0, 0], [0, 1, 1, 0]]
    still = np.array([[0.0, -1e-12]])
    assert slip_state(still, np.full(2, np.inf)).tolist() == [[0, 1]]
    # Points near the clamp stick and those near the load slip.
    ever = slip_state((run.system.contact.B @ run.v.T).T, run.system.contact.beta).any(axis=0)
    assert not ever[0]
    assert ever[-1]


def test_steady_state_is_reached_in_the_third_cycle_not_in_the_second():
    two, three = (steady_state(harmonic_run(cycles=n)) for n in (2, 3))
    assert three.reached > two.reached
    assert three.energy_change < two.energy_change
    assert three.peak_change < two.peak_change
    assert steady_state(harmonic_run(cycles=1)) is None  # one cycle says nothing of it
    still = lap_joint(load=[harmonic(amplitude=0.0, frequency=1000.0)]).system()
    state = steady_state(harmonic_run(still, cycles=2))
    assert state.reached
    assert state.energy_change == state.peak_change == 0.0


@pytest.mark.parametrize("beta", [np.inf, 1e6, 1e5])
def test_what_slips_is_one_length_in_all_results_that_of_a_bar_under_even_pressure(beta):
    """A slow load F slips over F / tau. Laws of finite steepness let points beyond it creep."""
    tau, length, elements = 1.75e6, 0.2, 100  # N/m, m
    joint = sj.Joint("joint", pressure=50e6, friction=0.7, beta=beta)
    mesh = sj.build_bar([("arm", 0.1, 10), ("joint", length, elements)], {"end": 0.0})
    structure = structure_of(mesh, [joint], (), stiffness_damping=1e-6)
    force = 0.3 * tau * length
    system = structure.system([sj.Load("end", sj.Harmonic(force, 100.0))], points=["end"])
    run = sj.integrate(system, cycles=2, steps_per_cycle=200, save=sj.Save(slips=True))
    (curve,) = sj.response(system, np.array([100.0]), refined=False, estimated=False)
    slow = sj.quasi_static(system, cycles=1, steps_per_cycle=100, save=sj.Save(slips=True))
    (mode,) = sj.backbone(system, levels=1, up_to=0.3)  # of the level at which all of it slips
    within = 2.0 / elements  # two elements
    region = sj.active_region(structure, run).point_fraction["joint"]
    shares = [x.joint_slipping.max() for x in (run, slow)] + [curve.points[0].share, mode.share[0]]
    assert [region, *shares] == pytest.approx([0.3] * 5, abs=within)


def test_a_point_that_came_to_rest_elsewhere_does_not_slip():
    """A slider of 1 N holds its spring of 1 N/m at 0.5 m under 0.1 N; the share was 1."""
    one = sparse.csr_array(np.eye(1))
    parts = sj.Harmonic(0.1, 1.0), sj.Harmonic(0.05, 2.0)  # of odd loads vibrations are centred
    load = sj.AppliedLoad(np.ones(1), sj.MultiHarmonic(parts))
    contact = sj.Contact(one, [1.0], np.inf)
    system = sj.System(one, 0.1 * one, one, contact, loads=(load,), P=one, points=("mass",))
    still = steady_point(system, 1.0, start=(np.array([0.5]), np.zeros(1)))
    assert still.slip == pytest.approx([0.0], abs=1e-9)
    assert still.friction_energy == 0.0
    assert still.share == 0.0
    slides = steady_point(system, 1.0, 100.0, start=(np.array([0.5]), np.zeros(1)))
    assert slides.share == 1.0


def test_a_point_that_slips_by_less_than_a_thousandth_of_another_does_not_count():
    """Two masses on springs of 1 N/m, each on a slider of 1 N: slow loads slip by F - 1 N."""
    force = 4.0
    for other, share in ((1.0 + 0.5e-3 * (force - 1.0), 0.5), (1.0 + 2e-3 * (force - 1.0), 1.0)):
        loads = tuple(
            sj.AppliedLoad(np.eye(2)[k], sj.Harmonic(f, 1.0)) for k, f in enumerate((force, other))
        )
        one = sparse.csr_array(np.eye(2))
        w = np.ones(2)
        system = sj.System(one, None, one, sj.Contact(one, w, np.full(2, np.inf)), loads=loads)
        run = sj.quasi_static(system, cycles=1, steps_per_cycle=400, save=sj.Save(slips=True))
        assert run.slip_peak == pytest.approx([force - 1.0, other - 1.0], rel=1e-6)
        assert run.joint_slipping.max() == pytest.approx(share)
        np.testing.assert_array_equal(system.slipping(run.slip_peak), [True, share == 1.0])


SPRUNG = joint(law="coulomb", tangential_stiffness=1e12)


@pytest.mark.parametrize("time", [{"until": "steady"}, {"cycles": 4}])
def test_energies_of_round_off_size_are_zero_and_get_no_advice(time):
    """Springs hold all sliders, and nothing is damped: some 1e-24 J of friction beside 2.8e-9 J."""
    values = {"joint": [SPRUNG], "damping": {}, "load": [harmonic(amplitude=1.0)]}
    time |= {"steps_per_cycle": 100}
    study = sj.run_scene(bar_scene("full", bar="coarse", time=time, **values))
    (model,) = summary(study)["models"].values()
    assert 0.0 < study.runs["full"].friction_energy["joint"] < 1e-14 * 2.8e-9
    assert model["friction_energy_J"] == {"joint": 0.0}
    assert model["joints"]["joint"]["friction_energy_J"] == 0.0
    assert model["viscous_work_J"] == model["scheme_work_J"] == 0.0
    assert study.models["full"].estimate.of("total", "friction_energy") is None
    if "until" in time:  # else what is stored in a cycle is none of its losses
        assert model["loop_energy_per_cycle_J"] == 0.0
        assert steady_state(study.runs["full"]) is None
    assert not any("energy of the full model errs" in note for note in study.notes)


def test_small_losses_are_no_round_off():
    """Under the arctan law all points creep, however little."""
    system = bar_scene("full", bar="coarse", load=[harmonic(amplitude=0.1)], damping={}).system()
    run = sj.integrate(system, cycles=4, steps_per_cycle=100)
    assert energies(run)[0] == pytest.approx(run.cycles.friction[-1], rel=1e-15)
    assert energies(run)[0] > 0.0
