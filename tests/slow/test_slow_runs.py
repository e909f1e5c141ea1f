"""Quasi-static runs: closed forms, Masing's rule, energies and loops of joints; SI units."""

import time
from dataclasses import replace

import numpy as np
import pytest
from bodies import LAP, WIDTH, lap, structure, two_bars
from clamped_plates import bolted, loads
from stepping_systems import LapJoint, arm

import skfem_joint as sj
from skfem_joint.runs.integrate import integrate_plan
from skfem_joint.runs.slow_run import REPORTED_S
from skfem_joint.slow.quasi_static import QuasiStatic
from skfem_joint.stepping.plan import Plan

TAU, LENGTH, FORCE = 0.7 * 8e6 * WIDTH, 0.25, 35e3  # N/m, m, N
EA = 200e9 * WIDTH * 0.01
#: Displacement of the bar's end and energy of its loop, docs/theory/friction.md.
PEAK, LOOP = FORCE**2 / (2.0 * EA * TAU), 2.0 * FORCE**3 / (3.0 * EA * TAU)
FREE_LIMIT = 350e3  # what friction holds of the free bar, N


def lap_joint(elements=100, force=FORCE, **changes):
    values = {"normal_force": "consistent", "beta": np.inf, "frequency": 20.0} | changes
    return LapJoint(LENGTH, elements, force=force, **values).system


def free_bar(force, elements=20):
    """Bar that friction alone holds, with a free length beyond its joint."""
    joint = sj.Joint("joint", 1.75e6 / 0.7 / WIDTH, 0.7, normal_force="consistent")
    return arm(force, joint, (elements, 10), fixed=(), free=True, stiffness_damping=1e-5)


def smaller(system, model, duration=None):
    """The system itself, or its condensed or reduced model for a quasi-static run."""
    if model == "reduced":
        return sj.reduce(system, duration=duration, quasi_static=True)
    return sj.condense(system) if model == "condensed" else system


def foot(load, beta=np.inf, stiffness=np.inf):
    """A mass on a spring of 40 kN/m and a foot that holds 60 N."""
    law = {"beta": beta, "stiffness": stiffness}
    contact = sj.point_friction([1.0], limit=60.0, **law, name="foot")
    loads = {"mass": (0, load)}
    return sj.System.from_matrices(np.eye(1), np.array([[4e4]]), contact=contact, loads=loads)


def test_bar_has_the_closed_form_with_second_order():
    errors = []
    for levels in (40, 80, 160):
        run = sj.quasi_static(lap_joint(800), cycles=2, steps_per_cycle=levels)
        assert run.peak_of("free_end") == pytest.approx(PEAK, rel=1e-9)
        assert run.energy_residual < 1e-12
        errors.append(abs(run.cycles.friction[-1] / LOOP - 1.0))
    orders = np.log2(np.divide(errors[:-1], errors[1:]))
    assert errors[-1] < 3e-4
    assert orders == pytest.approx(2.0, abs=0.1)


def sprung(system, per_newton=1e3):
    """Springs in series with friction that stretch by a part of a meter under its limits."""
    return system.with_contact(
        stiffness=np.where(system.contact.w > 0.0, per_newton * system.contact.w, np.inf)
    )


def returned(slip, spring, limit):
    """Force of a Jenkins element along slips from rest: the radial return."""
    forces, q = [], 0.0
    for change in np.diff(slip, prepend=0.0):
        q = min(max(q + spring * change, -limit), limit)
        forces.append(q)
    return np.array(forces)


@pytest.mark.parametrize("stretch", [3e-4, 0.0])
def test_a_point_on_a_spring_goes_round_an_exact_parallelogram(stretch):
    """All corners are levels, which are 4 N apart: 3, 10, 4, -10, -4 and 10 times 0.1 mm."""
    limit = 60.0
    spring = limit / stretch if stretch else np.inf
    course = sj.Table([0.0, 25.0, 75.0, 125.0], [0.0, 100.0, -100.0, 100.0])
    run = sj.quasi_static(foot(course, stiffness=spring), duration=125.0, step=1.0)
    u, q = run.loops.slip[:, 0], run.loops.force[:, 0]
    peak = (100.0 - limit) / 4e4
    turns = [25, 75, 125]
    assert u[turns] == pytest.approx([peak, -peak, peak], rel=1e-12)
    assert run.peak_of("mass") == pytest.approx(peak, rel=1e-12)
    assert q[turns] == pytest.approx([limit, -limit, limit])
    if stretch:
        assert u[[18, 61, 111]] == pytest.approx([3e-4, 4e-4, -4e-4], rel=1e-12)
        assert q == pytest.approx(returned(u, spring, limit), rel=1e-12, abs=1e-12 * limit)
    else:
        moves = np.diff(u) != 0.0
        assert q[1:][moves] == pytest.approx(limit * np.sign(np.diff(u)[moves]), rel=1e-12)
    assert run.loops.load_force[:, 0] == pytest.approx(4e4 * u + q, abs=1e-11)
    # Friction takes the slip of the slider, and the spring stores the rest.
    loss = 4.0 * limit * (peak - stretch)
    work = run.loops.work[:, 0]
    assert work[25] == pytest.approx(limit * (peak - stretch), rel=1e-12)
    assert work[125] - work[25] == pytest.approx(loss, rel=1e-12)
    assert np.trapezoid(q[25:], u[25:]) == pytest.approx(loss, rel=1e-12)
    assert work[:16] == pytest.approx(0.0, abs=1e-15 * loss)
    stored = 0.5 * 4e4 * peak**2 + 0.5 * limit * stretch
    assert run.stored_energy == pytest.approx((0.0, stored), rel=1e-12)
    assert run.final_sigma == pytest.approx([1.0])
    assert run.energy_residual < 1e-13
    assert run.viscous_work == run.scheme_work == 0.0


def test_secants_of_a_loop_go_through_its_tips():
    run = sj.quasi_static(foot(sj.Harmonic(100.0, 1.0)), cycles=3, steps_per_cycle=200)
    peak = (100.0 - 60.0) / 4e4
    # 2 * limit * (peak to peak), less what the steps miss at both corners.
    assert run.loops.area[0] == pytest.approx(run.cycles.friction[-1], rel=1e-12)
    assert run.cycles.friction[-1] == pytest.approx(4.0 * 60.0 * peak, rel=1e-2)
    assert run.loops.secant_stiffness[0] == pytest.approx(60.0 / peak, rel=1e-12)
    assert run.loops.load_secant_stiffness[0] == pytest.approx(100.0 / peak, rel=1e-12)


@pytest.mark.parametrize(
    ("model", "per_newton"),
    [("full", None), ("full", 5e4), ("condensed", 5e4), ("reduced", 5e4)],
)
def test_unloading_is_the_loading_doubled(model, per_newton):
    """Masing's rule, exact on any mesh where levels of both paths are the same."""
    course = sj.Table([0.0, 1.0, 3.0, 5.0], [0.0, FORCE, -FORCE, FORCE])
    system, plan = lap_joint(30, load=course), {"duration": 5.0, "step": 0.02}
    system = sprung(system, per_newton) if per_newton else system
    exact = sj.quasi_static(system, **plan, save=sj.Save(fields=True))
    run, near, round_off = exact, 1e-9, 1e-9
    if model != "full":
        small = smaller(system, model, 5.0)
        run, near, round_off = sj.quasi_static(small, **plan), 0.03, 1e-7
    assert run.energy_residual < 1e-9
    assert np.all(np.diff(run.loops.work[:, 0]) >= -1e-9 * run.loops.work[-1, 0])
    assert run.peak == pytest.approx(exact.peak, rel=near)
    assert run.loops.work[-1] == pytest.approx(exact.loops.work[-1], rel=near)
    for path in (run.point("free_end"), run.loops.slip[:, 0], run.loops.force[:, 0]):
        rising, falling, back = path[:51], path[50:151], path[150:251]
        largest = np.abs(path).max()
        assert path[50] - falling[::2] == pytest.approx(2.0 * rising, abs=round_off * largest)
        assert back == pytest.approx(-falling, abs=round_off * largest)
    if model == "full" and per_newton:  # each point is a Jenkins element of its own
        slips, limits = run.u @ system.contact.B.T, system.contact.w
        for k in (0, 14, 29):
            own = returned(slips[:, k], system.contact.stiffness[k], limits[k])
            assert limits[k] * run.sigma[:, k] == pytest.approx(own, abs=1e-8 * limits[k])


@pytest.mark.parametrize(
    ("elements", "model"), [(20, "full"), (200, "full"), (20, "springs"), (20, "condensed")]
)
def test_no_level_is_a_little_beyond_slip(elements, model):
    """Whatever the mesh and the springs: levels rise by 0.1 % of what friction holds."""
    ramp = sj.Table([0.0, 1.0], [0.99 * FREE_LIMIT, 1.01 * FREE_LIMIT])
    system = free_bar(ramp, elements)
    system = smaller(system if model == "full" else sprung(system), model)
    with pytest.raises(sj.ConvergenceError, match="the structure slides") as caught:
        sj.quasi_static(system, duration=1.0, step=0.05)
    force = caught.value.run.loops.load_force[-1, 0]
    assert force <= FREE_LIMIT * (1.0 + 1e-9) < force + 0.0011 * FREE_LIMIT
    assert caught.value.run.energy_residual < 1e-8
    assert caught.value.run.peak.max() < 1e-2


def test_beta_counts_as_infinite_and_a_note_says_so():
    loads = sj.Triangle(100.0, 1.0)
    runs = [sj.quasi_static(foot(loads, beta), duration=2.0, step=0.1) for beta in (np.inf, 1e3)]
    assert np.array_equal(runs[0].point_u, runs[1].point_u)
    assert np.array_equal(runs[0].loops.force, runs[1].loops.force)
    assert runs[0].system.notes == ()
    assert "beta = 1e+03 s/m counts as infinite" in runs[1].system.notes[0]


def test_frequency_and_damping_do_not_matter():
    systems = (
        lap_joint(20, frequency=frequency, options={"stiffness_damping": damping})
        for frequency, damping in ((1.0, 0.0), (1e4, 1e-3))
    )
    slow, fast = (sj.quasi_static(s, cycles=1, steps_per_cycle=40) for s in systems)
    assert fast.point_u == pytest.approx(slow.point_u, abs=1e-12 * PEAK)
    assert fast.times[-1] == pytest.approx(1e-4)


@pytest.mark.parametrize("model", ["full", "condensed", "reduced"])
def test_a_load_beyond_slip_keeps_the_levels_before_it(model):
    system = smaller(free_bar(sj.Harmonic(1.2 * FREE_LIMIT, 1.0)), model)
    slides = 1.2 * np.sin(2 * np.pi * np.arange(65) / 64) >= 1.0
    with pytest.raises(sj.ConvergenceError, match="the structure slides") as caught:
        sj.quasi_static(system, cycles=1, steps_per_cycle=64)
    run, last = caught.value.run, int(slides.argmax()) - 1
    share = 1.2 * np.sin(2 * np.pi * (last + 1) / 64)
    assert f"{share:.5g}"[:5] in str(caught.value)
    assert run.interrupted
    assert run.counters.steps == last
    assert run.times.size == run.loops.times.size == last + 1
    assert run.times[-1] == pytest.approx(last / 64)
    assert run.energy_residual < 1e-8
    assert caught.value.exit_status == 3
    # Friction holds the last load: its forces add up to it.
    load = 1.2 * FREE_LIMIT * np.sin(2 * np.pi * last / 64)
    assert run.loops.force[-1, 0] == pytest.approx(load, rel=1e-6)


@pytest.mark.parametrize("solid", [False, True])
def test_levels_of_a_body_that_friction_holds_balance_without_added_mass(solid):
    """K is singular, and a little mass is added to it; no force of that is left at a level."""
    given = bolted(solid).system(loads("right", 3 if solid else 2))
    levels = QuasiStatic(given, 1e-11)
    system, level = levels.to.system, levels.rest()
    assert levels.shift > 0.0
    force = levels.to.force(100.0 * given.loads[0].vector)
    for share in (0.5, 1.0, -0.2):
        level = levels.next(level, share * force)
        left = share * force - system.K @ level.u - system.contact.B.T @ level.friction
        assert np.abs(left).max() < 1e-10 * np.abs(force).max()


def test_loads_at_the_start_are_reached_first_and_jumps_are_followed():
    cosine = sj.quasi_static(foot(sj.Harmonic(100.0, 1.0, np.pi / 2)), cycles=1, steps_per_cycle=40)
    assert cosine.point("mass")[0] == pytest.approx(40.0 / 4e4)
    assert cosine.energy_residual < 1e-12
    jump = sj.quasi_static(foot(sj.Rectangle(100.0, 1.0, 0.25)), duration=2.0, step=0.2)
    assert jump.point("mass")[-1] == pytest.approx(40.0 / 4e4)  # friction holds what is left
    assert jump.loops.force[-1, 0] == pytest.approx(-40.0)
    assert jump.energy_residual < 1e-12


@pytest.mark.parametrize(
    ("amplitude", "slid"),
    [
        (sj.Harmonic(5.0, 1.0, np.pi / 2), 5.0 * (4.5 / 400 - 0.5 / 300)),
        (sj.Rectangle(5.0, 0.5, 0.2), 2.0 * (4.5 / 400 - 0.5 / 300) - 0.5 / 400 - 0.5 / 300),
    ],
)
def test_friction_takes_its_limit_times_the_slip_of_a_jump_of_the_load(amplitude, slid):
    slider = sj.point_friction([1.0], 0.5, stiffness=300.0)
    loads = {"pull": ([1.0], amplitude)}
    one, K = np.eye(1), np.array([[400.0]])
    system = sj.System.from_matrices(one, K, contact=slider, loads=loads)
    run = sj.quasi_static(system, step=1.0 / 400, n_steps=400)
    assert run.friction_work.sum() == pytest.approx(0.5 * slid, rel=1e-3)


def test_peaks_between_levels_are_not_missed():
    run = sj.quasi_static(foot(sj.Triangle(100.0, 0.5, 0.03)), duration=1.2, step=0.2)
    assert run.peak_of("mass") == pytest.approx(40.0 / 4e4, rel=1e-12)


def test_a_linear_system_is_solved_too():
    system = foot(sj.Harmonic(100.0, 1.0)).with_contact(given=np.zeros(1))
    run = sj.quasi_static(system, cycles=1, steps_per_cycle=40)
    assert run.point("mass") == pytest.approx(run.amplitudes[:, 0] / 4e4, abs=1e-15)


@pytest.mark.parametrize("model", ["full", "condensed", "mode"])
def test_what_sticks_in_a_whole_cycle_is_linear_and_its_energies_balance(model):
    """All that its input sums up to is round-off. A mode in which it sticks sees no slip at all."""
    contact, loads = sj.point_friction([1.0, 0.0], 60.0), {"end": (1, sj.Harmonic(1.0, 1.0))}
    K = np.array([[3e4, -3e4], [-3e4, 3.1e4]])
    system = sj.System.from_matrices(np.eye(2), K, contact=contact, loads=loads)
    if model == "mode":
        system = system.project(np.array([[0.0], [1.0]]))
    run = sj.quasi_static(smaller(system, model), cycles=1, steps_per_cycle=16)
    assert run.peak[0] == pytest.approx(1.0 / 3.1e4, rel=1e-9)
    assert run.energy_residual < 1e-9
    assert not any("energy balance" in note for note in run.notes)
    assert run.friction_work.sum() == 0.0


def test_the_area_of_a_loop_that_takes_no_energy_is_not_noted():
    """A point that rests on its spring slips by the round-off of that."""
    K = 2.0 * (100.0 * np.pi) ** 2
    contact = sj.point_friction([1.0], limit=1e6, stiffness=K, name="foot")
    load = {"mass": (0, sj.Harmonic(10.0, 50.0))}
    system = sj.System.from_matrices([[2.0]], [[K]], contact=contact, loads=load)
    run = sj.quasi_static(system, cycles=1, steps_per_cycle=40)
    assert 0.0 < run.friction_energy["foot"] < 1e-15
    assert run.notes == ()


def test_without_any_hold_there_is_no_level():
    system = free_bar(sj.Harmonic(1.0, 1.0)).with_contact(given=np.zeros(21))
    with pytest.raises(sj.ConvergenceError, match="neither a support nor friction") as caught:
        sj.quasi_static(system, cycles=1, steps_per_cycle=40)
    assert caught.value.run.counters.steps == 0


@pytest.mark.parametrize("stiffness", [np.inf, 2e12])
@pytest.mark.parametrize("model", ["full", "condensed", "reduced"])
def test_works_of_plates_balance_and_their_loops_close(model, stiffness):
    """Two plates, one of them held by friction alone, pulled at an angle."""
    joint = replace(LAP, tangential_stiffness=stiffness)
    # Plain elements, of which the reduced model's balance is not among those open by 1e-7.
    how = {"stiffness_damping": 0.0, "incompatible": False}
    made = structure(lap(), [joint], ("lower_left",), **how)
    pull = sj.Harmonic(0.4 * 28e3, 1.0)  # of what friction holds
    system = made.system([sj.Load("upper_right", pull, (1.0, 0.2))], [])
    full = run = sj.quasi_static(system, cycles=2, steps_per_cycle=40)
    if model != "full":
        run = sj.quasi_static(smaller(system, model), cycles=2, steps_per_cycle=40)
    assert run.energy_residual < 1e-8
    assert run.friction_work.min() > -1e-9 * run.friction_work.sum()
    stored = run.system.contact.spring_energy(run.final_sigma)
    assert 0.0 < stored < run.stored_energy[1] if stiffness < np.inf else stored == 0.0
    # What goes in comes out in the joints, as far as the last cycle is closed.
    gap, work = run.loops.opening, run.cycles.input[-1].sum()
    assert gap < 1e-3
    assert work == pytest.approx(run.cycles.by_joint[-1].sum(), rel=2.0 * gap)
    assert run.loops.energy == pytest.approx(run.cycles.by_joint[-1], rel=1e-9)
    near = {"full": 0.0, "condensed": 1e-6, "reduced": 0.05}[model]
    assert run.peak == pytest.approx(full.peak, rel=near + 1e-12)
    assert run.cycles.friction[-1] == pytest.approx(full.cycles.friction[-1], rel=near + 1e-12)
    assert run.loops.secant_stiffness == pytest.approx(
        full.loops.secant_stiffness, rel=3 * near + 1e-12
    )


def test_the_loop_of_a_joint_is_that_of_its_slip_vectors():
    """A face on a rigid base that slides as a whole, held by springs, along a skew direction."""
    points = 4
    B = np.kron(np.eye(points), np.eye(2))
    spring, along = 1e6, np.array([0.6, 0.8])
    w = np.array([10.0, 20.0, 30.0, 40.0])
    K = np.kron(1e9 * (points * np.eye(points) - np.ones((points, points))), np.eye(2))
    K += np.kron(np.ones((points, points)), spring / points**2 * np.eye(2))
    load = sj.AppliedLoad(np.tile(along, points) / points, sj.Harmonic(300.0, 1.0), "face")
    system = sj.System(
        np.eye(2 * points),
        None,
        K,
        sj.Contact(B, w, np.inf, directions=np.full(points, 2)),
        loads=(load,),
    )
    run = sj.quasi_static(system, cycles=2, steps_per_cycle=200)
    loops = run.loops
    assert np.abs(loops.direction[0] @ along) == pytest.approx(1.0)
    sliding = np.abs(np.diff(loops.slip[:, 0])) > 1e-7
    assert sliding.sum() > 50
    assert np.abs(loops.force[1:, 0][sliding]) == pytest.approx(w.sum(), rel=1e-3)
    assert loops.area[0] == pytest.approx(loops.energy[0], rel=1e-3)
    assert loops.energy[0] == pytest.approx(4 * w.sum() * 200.0 / spring, rel=2e-2)


def test_an_interrupt_keeps_finished_levels():
    system, done = lap_joint(20), []

    def progress(steps, _):
        done.append(steps)
        time.sleep(1.5 * REPORTED_S)
        if steps > 3:
            raise KeyboardInterrupt

    run = sj.quasi_static(system, cycles=2, steps_per_cycle=40, progress=progress)
    whole = sj.quasi_static(system, cycles=2, steps_per_cycle=40)
    assert run.interrupted
    steps = run.counters.steps
    assert steps == done[-1] - 1 == run.loops.times.size - 1
    assert np.array_equal(run.point_u, whole.point_u[: steps + 1])
    assert run.energy_residual < 1e-12


def test_runs_store_what_is_asked_for():
    save = sj.Save(every=3, fields=True, slips=True, fields_every=10)
    run = sj.quasi_static(lap_joint(20), cycles=1, steps_per_cycle=40, save=save)
    assert run.times == pytest.approx(np.arange(14) * 3 / 800)
    assert run.u.shape == run.v.shape == (5, 20)
    assert np.abs(run.sigma).max() == 1.0
    sticks = run.sigma[1:] ** 2 < 1.0
    assert not run.v[1:][sticks].any()  # at rest exactly
    assert run.joint_slip[:, 0].max() == pytest.approx(run.slip_peak.max(), rel=1e-2)
    assert not run.final[1].any()


def test_errors_are_estimated_by_half_the_step():
    for system in (lap_joint(40), sj.condense(lap_joint(40))):
        run = sj.quasi_static(system, cycles=2, steps_per_cycle=40)
        fine = sj.quasi_static(system, cycles=2, steps_per_cycle=1280)
        stated = sj.estimate(run).of("total", "friction_energy")
        true = abs(run.cycles.friction[-1] / fine.cycles.friction[-1] - 1.0)
        assert true == pytest.approx(stated, rel=0.2)
        assert "coulomb" not in sj.estimate(run).parts


def test_a_reduced_model_errs_by_no_more_than_it_states():
    system = lap_joint(60, beta=1e5, options={"stiffness_damping": 1e-5})
    small = sj.reduce(system, 6, quasi_static=True)
    full = sj.quasi_static(system, cycles=2, steps_per_cycle=320)
    run = sj.quasi_static(small, cycles=2, steps_per_cycle=40)
    errors = sj.estimate(run)
    for name, value, true in (
        ("friction_energy", run.cycles.friction[-1], full.cycles.friction[-1]),
        ("peak_displacement", run.cycles.peak[-1].max(), full.cycles.peak[-1].max()),
    ):
        stated = errors.of("total", name)
        assert 1e-6 < abs(value / true - 1.0) <= 1.02 * stated < 0.1


def test_a_model_for_vibration_notes_that_it_does_not_tell_the_force_of_a_joint_that_sticks():
    """Of the load's force a joint in the middle of two bars carries all, whatever sticks."""
    made = two_bars(12, 10)
    system = made.system([sj.Load("upper_end", sj.Harmonic(-20e3, 20.0))])
    for model, tells in (("condensed", True), (True, True), (False, False)):
        small = (
            sj.condense(system)
            if model == "condensed"
            else sj.reduce(system, 4, quasi_static=model)
        )
        run = sj.quasi_static(small, cycles=2, steps_per_cycle=40)
        off = np.abs(np.abs(run.loops.force[:, 0]) - np.abs(run.loops.load_force[:, 0])).max()
        assert (off < 1e-6 * 20e3) == tells
        noted = any("force of joint 'upper_joint'" in note for note in run.notes)
        assert noted != tells


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"cycles": 1}, "must come with steps_per_cycle"),
        ({"step": 0.1}, "needs step and n_steps"),
        ({"cycles": 1, "steps_per_cycle": 4}, "longer than 1/8 of its fastest period"),
        ({"cycles": 1, "steps_per_cycle": 40, "tolerance": 0.1}, "tolerance"),
    ],
)
def test_wrong_arguments_are_refused(options, words):
    with pytest.raises(sj.InputError, match=words):
        sj.quasi_static(lap_joint(5), **options)


def test_plans_without_inertia_start_from_rest_and_are_not_resumed(tmp_path):
    system, plan = lap_joint(5), Plan(1 / 800, 40, quasi_static=True)
    with pytest.raises(sj.InputError, match="starts from rest"):
        integrate_plan(system, plan, initial=(np.zeros(5), np.zeros(5)))
    with pytest.raises(sj.InputError, match="checkpoint: a quasi-static run has none"):
        integrate_plan(system, plan, checkpoint=sj.Checkpoint(tmp_path / "c.npz", 10))
    with pytest.raises(sj.InputError, match="has no vibration"):
        replace(plan, until="steady")


@pytest.mark.parametrize("springs", [False, True])
@pytest.mark.parametrize("model", ["full", "condensed"])
def test_a_body_that_friction_holds_goes_round_closed_loops(model, springs):
    system = free_bar(sj.Harmonic(0.9 * FREE_LIMIT, 1.0))
    system = smaller(sprung(system) if springs else system, model)
    run = sj.quasi_static(system, cycles=2, steps_per_cycle=64)
    near = 1e-5 if springs else 1e-6
    assert run.energy_residual < 0.01 * near
    assert run.cycles.input[-1].sum() == pytest.approx(run.cycles.friction[-1], rel=near)
    assert run.loops.opening < near
