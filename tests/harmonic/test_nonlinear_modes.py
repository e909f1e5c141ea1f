"""Nonlinear modes: published and closed forms, limits, and the balance of energy."""

from dataclasses import replace

import numpy as np
import pytest
from benchmarks.nonlinear_modes import (
    DAMPING,
    FREQUENCY,
    TIP,
    beam_of,
    block_of,
    finer,
    friction_beam,
)
from scipy.integrate import quad, trapezoid
from scipy.optimize import brentq

import skfem_joint as sj
from skfem_joint.ground.errors import InputError
from skfem_joint.ground.progress import Tally, silent
from skfem_joint.harmonic.balance import Balance, stuck_modes
from skfem_joint.harmonic.levels import Levels, climbed
from skfem_joint.harmonic.marched import march
from skfem_joint.harmonic.mode_equations import ModeEquations
from skfem_joint.harmonic.modes import FLOOR
from skfem_joint.harmonic.newton import BranchPoint, branch, by_parameter, solved
from skfem_joint.harmonic.series import FourierSeries


@pytest.fixture(scope="module")
def beam():
    (mode,) = sj.nonlinear_modes(friction_beam(), amplitudes=TIP, at="tip")
    return mode


def test_virtual_friction_damped_beam_has_its_published_curve(beam):
    assert beam.stuck_frequency == pytest.approx(80.36779981, rel=1e-9)
    assert beam.frequency == pytest.approx(FREQUENCY, rel=2e-4)
    assert 100.0 * beam.damping_ratio == pytest.approx(DAMPING, rel=5e-3)
    assert beam.state == ("stick",) + ("gross",) * 8


def test_time_steps_stay_on_the_motion_of_a_mode(beam):
    assert np.abs(beam.marched.frequency).max() < 2e-4
    assert np.abs(beam.marched.damping_ratio).max() < 3e-3
    assert not beam.notes


def test_what_a_cycle_loses_is_the_work_of_the_force_that_keeps_it_up(beam):
    """Its work is 2 zeta omega^2 pi times the sum of k^2 |u_k|^2 by the mass."""
    M = friction_beam().M
    order = beam.series.coefficient_orders[:, np.newaxis]
    squares = np.einsum("lhn,nm,lhm->l", order * beam.harmonics, M, order * beam.harmonics)
    omega = 2.0 * np.pi * beam.frequency
    work = 2.0 * np.pi * beam.damping_ratio * omega**2 * squares
    assert beam.losses.lost == pytest.approx(work, rel=1.5e-4)  # some levels have 256 samples
    assert beam.friction_work.sum(axis=1) == pytest.approx(beam.losses.friction)


def jenkins(k=1.0, spring=3.0, limit=0.7, damping=0.02):
    """Mass of 1 kg on a spring and a Jenkins element."""
    slider = sj.point_friction([1.0], limit, stiffness=spring)
    return sj.System.from_matrices([[1.0]], [[k]], [[damping]], contact=slider)


def test_loss_of_a_jenkins_oscillator_has_its_closed_form():
    """Of the amplitude of its slip: 4 limit (a - limit / spring), whatever its harmonics do."""
    (mode,) = sj.nonlinear_modes(jenkins(), amplitudes=[0.1, 0.3, 1.0, 5.0], confirm=False)
    reach = mode.slip[:, 0]
    lost = np.maximum(4.0 * 0.7 * (reach - 0.7 / 3.0), 0.0)
    assert mode.losses.friction == pytest.approx(lost, rel=2e-3, abs=1e-12)
    assert mode.frequency[0] == pytest.approx(2.0 / (2.0 * np.pi), rel=1e-9)  # stuck: k + spring


def test_a_ring_down_loses_what_the_cycles_of_a_mode_take_from_its_energy_at_turning_points():
    """Free vibration on a Jenkins element: from a to b it loses 4 w ((a + b) / 2 - w / spring)."""
    system, w, spring = jenkins(spring=0.08, limit=0.02, damping=0.0), 0.02, 0.08
    levels = np.geomspace(0.4, 3.0, 40)
    (mode,) = sj.nonlinear_modes(system, amplitudes=levels, confirm=False)
    a, found = mode.displaced, mode.decrement
    middle = np.linspace(0.5, 2.5, 9)
    # the energy at turning points is a^2 / 2 + w^2 / (2 spring) with the stiffness of 1 N/m
    drop = 4.0 * w * (middle - w / spring) / middle
    expected = np.log((middle + 0.5 * drop) / (middle - 0.5 * drop)) / (2.0 * np.pi)
    np.testing.assert_allclose(np.interp(middle, a, found), expected, rtol=3e-3)
    (few,) = sj.nonlinear_modes(system, amplitudes=levels[::13], confirm=False)
    apart = np.abs(few.decrement / found[::13] - 1.0)
    assert (apart < few.decrement_error).all()
    assert 3e-3 < few.decrement_error.max() < 10.0 * apart.max()
    assert mode.decrement_error.max() < 0.1 * few.decrement_error.max()
    down = sj.ring_down(system, mode, 12, 400)  # begins on the motion of the highest level
    own = np.interp(down.amplitude, a, found)
    np.testing.assert_allclose(down.damping_ratio, own, rtol=0.01)


def test_time_steps_that_do_not_converge_are_told_and_cost_no_level():
    balance = Balance.of(jenkins(), FourierSeries(15, 512, True), 2.0, 1.0)
    equations = ModeEquations(balance, 1, np.ones(1), np.ones(1), 1.0)
    levels, why = climbed(equations, np.array([0.1, 0.5]), Tally(silent))
    assert not why
    broken = levels.u.copy()
    broken[1] = np.nan
    marched = march(replace(levels, u=broken), np.arange(2))
    assert abs(marched.frequency[0]) < 1e-4
    assert np.isnan(marched.frequency[1])
    (note,) = marched.notes
    assert "level number 2, do not converge" in note


def test_one_harmonic_has_the_describing_function():
    """Iwan's averages of the Jenkins element for a slip a cos, by quadrature."""
    spring, limit, a = 3.0, 0.7, 1.3
    balance = Balance.of(jenkins(), FourierSeries(1, 4096, True), 2.0, 1.0)
    residual = balance.residual(np.array([[a], [0.0]]), 1.0)
    turn = np.arccos(1.0 - 2.0 * limit / spring / a)

    def force(t):  # falls from the limit at t = 0
        return limit - spring * a * (1.0 - np.cos(t)) if t < turn else -limit

    cosine = 2.0 / np.pi * quad(lambda t: force(t) * np.cos(t), 0.0, np.pi, points=[turn])[0]
    sine = 2.0 / np.pi * quad(lambda t: force(t) * np.sin(t), 0.0, np.pi, points=[turn])[0]
    expected = [(1.0 - 1.0) * a + cosine, -0.02 * a + sine]
    assert residual.values[:, 0] == pytest.approx(expected, rel=1e-5)


def test_a_motion_has_a_whole_period_where_it_has_odd_harmonics_alone(beam):
    """Its second half is the first one with the other sign."""
    half, other = np.split(beam.motion(-1, 20), 2)
    np.testing.assert_allclose(half, -other, atol=1e-9 * np.abs(half).max())


def test_linear_modes_are_exact():
    """Contact that never slips leaves the modes of the stuck structure."""
    system = friction_beam()
    held = replace(system.contact, given=np.array([1e9]))
    modes = sj.nonlinear_modes(replace(system, contact=held), modes=(1, 2), amplitudes=[1e-6, 1e-3])
    for mode in modes:
        assert mode.frequency == pytest.approx(mode.stuck_frequency, rel=1e-10)
        assert mode.damping_ratio == pytest.approx(0.01, rel=1e-9)
        assert mode.friction_work == pytest.approx(0.0, abs=1e-12)


def test_sliders_that_share_a_slip_are_their_sum():
    """Two halves of a Jenkins element are the whole one."""
    whole = jenkins()
    halves = sj.Contact(np.ones((2, 1)), [0.35] * 2, np.inf, stiffness=np.array([1.5, 1.5]))
    modes = [
        sj.nonlinear_modes(system, amplitudes=[0.3, 1.0], confirm=False)[0]
        for system in (whole, replace(whole, contact=halves))
    ]
    assert modes[1].frequency == pytest.approx(modes[0].frequency, rel=1e-9)
    assert modes[1].damping_ratio == pytest.approx(modes[0].damping_ratio, rel=1e-6)


def chain():
    """Twelve masses on springs, the last one heavy, eight of them on rigid friction."""
    n = 12
    M, K = np.eye(n), 2.0 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    M[-1, -1], K[-1, -1] = 40.0, 1.0
    contact = sj.Contact(np.eye(n)[:8], np.full(8, 0.3), np.inf)
    return sj.System(M, 0.002 * K, K, contact, P=np.eye(n)[-1:], points=("end",))


def test_springs_of_sticking_soften_the_stuck_mode_by_one_over_their_factor():
    system = chain()
    stuck = 2.0 * np.pi * sj.natural_modes(system, 1, joints="stuck").frequencies[0]
    series, softer = FourierSeries(1, 16, True), []
    for factor in (200.0, 2000.0, 20000.0):
        balance = Balance.of(system, series, stuck, factor)
        softer.append(1.0 - (balance.frequencies[0] / stuck) ** 2)
    assert np.array(softer) == pytest.approx([5e-3, 5e-4, 5e-5], rel=0.1)


def pair():
    """Two masses on springs, the first on rigid friction: stuck, the second is an oscillator."""
    K = 1e4 * np.array([[2.0, -1.0], [-1.0, 1.2]])
    contact = sj.Contact(np.eye(2)[:1], [2.0], np.inf)
    return sj.System(np.eye(2), 0.5 * np.eye(2), K, contact, P=np.eye(2)[1:], points=("q",))


def test_a_first_level_just_below_slip_is_found():
    """The friction limit is 2 N, the force of the spring between the masses 1 and 1.9 N."""
    (mode,) = sj.nonlinear_modes(pair(), amplitudes=[1e-4, 1.9e-4], confirm=False)
    assert mode.state == ("stick", "stick")
    assert 2.0 * np.pi * mode.frequency == pytest.approx(np.sqrt(1.2e4), rel=1e-6)


def test_an_error_is_not_known_where_more_harmonics_find_no_level():
    """A light mass that sticks again as it turns, whose levels in gross slip get lost.

    Where the error is known it covers the distance from springs of 1e8 N/m, 1e4 times the others.
    """
    light = replace(pair(), M=np.diag([0.1, 5.0]), C=np.diag([0.05, 2.5]))
    stiff = replace(light, contact=replace(light.contact, stiffness=np.array([1e8])))
    rigid, sprung = (
        sj.nonlinear_modes(system, amplitudes=amplitudes, confirm=False)[0]
        for system, amplitudes in ((light, [1e-4, 5e-4, 1e-2]), (stiff, [1e-4, 1e-2]))
    )
    error = rigid.error("frequency")
    assert np.isfinite(error[0])
    assert not np.isfinite(error).all()
    apart = np.abs(rigid.frequency[::2] / sprung.frequency - 1.0)
    stated = error[::2] + sprung.error("frequency") + 5e-4  # of the springs
    assert (apart <= stated)[np.isfinite(stated)].all()
    assert any("more than" in note and "is not known" in note for note in rigid.notes)
    assert not any("rigid sticking" in note for note in sprung.notes)


def test_contact_that_opens_has_the_period_of_two_half_oscillators():
    """A mass on a spring k that also pushes an elastic stop at rest: half a period with each."""
    stop = 3.0
    contact = sj.point_contact(None, [1.0], friction=0.0, normal_stiffness=stop)
    system = sj.System.from_matrices([[1.0]], [[1.0]], contact=contact)
    (mode,) = sj.nonlinear_modes(system, amplitudes=[1.0], confirm=False)
    period = np.pi * (1.0 + 1.0 / np.sqrt(1.0 + stop))
    assert mode.frequency[0] == pytest.approx(1.0 / period, rel=1e-4)


def test_a_mass_that_bounces_under_its_weight_flies_between_half_waves():
    """On an elastic stop alone: its weight holds its mean place, whatever its amplitude."""
    weight, stop = 10.0, 1e4
    contact = sj.point_contact(None, [1.0], friction=0.0, force=weight, normal_stiffness=stop)
    system = sj.System.from_matrices([[1.0]], [[0.0]], contact=contact)
    (mode,) = sj.nonlinear_modes(system, amplitudes=[3e-3, 1e-2], confirm=False)
    # nothing damps it, and round-off of nothing is no error
    assert not any("damping" in note for note in mode.notes)
    omega, rest = np.sqrt(stop), weight / stop

    def bounce(depth):
        """Period, and first harmonic, of a motion down to a depth below its rest."""
        leaves, meets = np.arccos(-rest / depth) / omega, omega * np.sqrt(depth**2 - rest**2)
        half = leaves + meets / weight
        t = np.linspace(0.0, half, 20001)
        flies = -rest - meets * (t - leaves) + 0.5 * weight * (t - leaves) ** 2
        u = np.where(t < leaves, depth * np.cos(omega * t), flies)
        return 2.0 * half, 2.0 / half * trapezoid(u * np.cos(np.pi * t / half), t)

    for level, amplitude in enumerate([3e-3, 1e-2]):
        depth = brentq(lambda x, a=amplitude: bounce(x)[1] - a, 2.0 * rest, 10.0 * amplitude)
        assert mode.frequency[level] == pytest.approx(1.0 / bounce(depth)[0], rel=5e-5)


def test_a_body_that_only_a_gap_holds_says_that_soft_springs_do():
    """Two masses on a spring, free as a whole; one of them meets a stop."""
    contact = sj.point_contact(None, [1.0, 0.0], friction=0.0, gap=1.0, normal_stiffness=1.0)
    K = np.array([[1.0, -1.0], [-1.0, 1.0]])
    system = sj.System.from_matrices(np.eye(2), K, 0.01 * K, contact=contact)
    (mode,) = sj.nonlinear_modes(system, (2,), amplitudes=[2.0], confirm=False)
    assert any("soft springs hold" in note for note in mode.notes)


def test_time_steps_agree_where_limits_follow_normal_forces():
    """A mass that slides along x on an elastic stop in y, which opens, coupled by its springs."""
    springs = {"normal_stiffness": 5.0, "stiffness": 4.0}
    contact = sj.point_contact([1.0, 0.0], [0.0, 1.0], friction=0.5, force=1.0, **springs)
    K, point = np.array([[2.0, 0.8], [0.8, 3.0]]), {"mass": 0}
    system = sj.System.from_matrices(np.eye(2), K, 0.01 * K, contact=contact, points=point)
    (mode,) = sj.nonlinear_modes(system, amplitudes=[0.05, 0.5, 2.0])
    assert mode.state == ("stick", "gross", "gross")
    assert mode.opened.tolist() == [0.0, 0.0, 1.0]
    assert np.abs(mode.marched.frequency).max() < 1e-3
    assert np.abs(mode.marched.damping_ratio).max() < 1e-2


def test_friction_of_a_slip_vector_does_not_depend_on_its_axes():
    """Turned slip rows of points with two directions leave the mode."""
    K = np.array([[2.0, 0.3], [0.3, 1.2]])
    turn = np.array([[0.6, 0.8], [-0.8, 0.6]])
    modes = []
    for B in (np.eye(2), turn):
        contact = sj.Contact(B, [0.7], np.inf, np.array([2]), stiffness=np.array([3.0]))
        system = sj.System(np.eye(2), 0.01 * K, K, contact, P=np.eye(2)[:1], points=("x",))
        modes += sj.nonlinear_modes(system, amplitudes=[0.5, 2.0], confirm=False)
    assert modes[1].frequency == pytest.approx(modes[0].frequency, rel=1e-6)
    assert modes[1].damping_ratio == pytest.approx(modes[0].damping_ratio, rel=1e-5)
    assert modes[0].friction_damping.min() > 0.01


def resonant():
    """Two masses, a slider on a spring at the first: as it slips, 3 : 1 of the modes is passed."""
    turn = np.array([[np.cos(0.5), -np.sin(0.5)], [np.sin(0.5), np.cos(0.5)]])
    frequency, ratio = np.array([1.0, 3.05]), 0.03
    K, C = (turn * x @ turn.T for x in (frequency**2, 2.0 * ratio * frequency))
    contact = sj.Contact(np.eye(2)[:1], [1.0], np.inf, stiffness=np.ones(1))
    return sj.System(np.eye(2), C, K, contact, P=np.eye(2)[:1], points=("first",))


def test_motions_of_one_amplitude_between_two_turns_are_all_confirmed_in_time():
    """The branch turns twice: three motions obey the equations, and time steps stay on each."""
    system = resonant()
    omegas, shapes = stuck_modes(system, 1)
    balance = Balance.of(system, FourierSeries(7, 512, True), float(omegas[0]), 1.0)
    seen = np.eye(2)[0] * np.sign(shapes[0, 0])
    equations = ModeEquations(balance, 1, shapes[:, 0], seen, 1.0 / abs(shapes[0, 0]), 0)
    size = equations.linear(0.3).size
    start = solved(equations, equations.linear(0.3), by_parameter(size))
    place = BranchPoint.of(start, (balance.series.size, 2))
    places = list(branch(equations, place, np.array([0.5, 3.0, 10.0])))
    asked = [p for p in places if p.asked and p.rest[-1] == pytest.approx(3.0)]
    assert np.sign([p.along[-1] for p in asked]).tolist() == [1.0, -1.0, 1.0]
    assert places[-1].rest[-1] == pytest.approx(10.0)
    for p in places:
        residual = balance.residual(p.q, *p.rest[:2], tangents=False).values
        assert np.abs(residual).max() < 1e-4 * np.linalg.norm(p.q) * p.omega**2
    omega, zeta, amplitude = np.array([p.rest for p in asked]).T
    assert np.ptp(omega) > 1e-2 * omega.mean()
    u = np.array([balance.outer(p.q) for p in asked])
    marched = march(Levels(equations, amplitude, u, omega, zeta, np.ones(3)), np.arange(3))
    assert np.abs(marched.frequency).max() < 1e-3
    assert np.abs(marched.damping_ratio).max() < 1e-2


def test_a_curve_passes_turns_in_its_amplitude_and_says_which_levels_it_meets_again():
    (mode,) = sj.nonlinear_modes(resonant(), amplitudes=[1.0, 3.0, 10.0], confirm=False)
    assert mode.displacement[:, 0] == pytest.approx([1.0, 3.0, 10.0], rel=1e-6)
    assert any("more than once, the numbers 2:" in note for note in mode.notes)


@pytest.mark.slow
def test_harmonics_near_higher_modes_end_no_curve():
    """A chain with frequencies nearly as 1 : 3 : 5: its highest amplitude was lost before."""
    uniform = replace(chain(), M=np.eye(12))
    (mode,) = sj.nonlinear_modes(uniform, amplitudes=[0.1, 0.5, 5.0], confirm=False)
    assert mode.state == ("stick", "stick", "partial")
    assert mode.displacement[:, 0] == pytest.approx([0.1, 0.5, 5.0], rel=1e-6)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"amplitudes": [2.0, 1.0]}, r"amplitudes\[1\]: found 1, must be > 2"),
        ({"amplitudes": [1e-3, 1e300]}, "from 1e-30 to 1e"),
        ({"amplitudes": [1e-6], "at": "top"}, "at: found 'top', must be one of tip"),
        ({"amplitudes": [1e-6], "modes": [9]}, "found mode 9, there are 4"),
    ],
)
def test_wrong_arguments_are_refused(changes, message):
    with pytest.raises(InputError, match=message):
        sj.nonlinear_modes(friction_beam(), **changes)


def test_a_mass_on_rigid_friction_alone_is_refused_with_what_to_give():
    with pytest.raises(InputError, match=r"^stuck modes: .* give the contact a stiffness"):
        sj.nonlinear_modes(jenkins(spring=np.inf), amplitudes=[1.0])


def test_large_systems_are_refused_with_what_to_give_instead():
    n = 400
    with pytest.raises(InputError, match=r"must be at most 1300.*reduced model"):
        sj.nonlinear_modes(sj.System(np.eye(n), None, np.eye(n)), amplitudes=[1.0])


@pytest.mark.parametrize(("draw", "seed"), [(beam_of, 2), (block_of, 6)])
def test_stated_errors_are_those_beside_eight_times_the_harmonics(draw, seed):
    """The largest in a curve, with constant contact and with contact that opens."""
    system, number, low, high = draw(np.random.default_rng(seed))
    amplitudes = np.geomspace(low, high, 8)
    (mode,) = sj.nonlinear_modes(system, [number], amplitudes=amplitudes, confirm=False)
    for name, true in zip(("frequency", "damping_ratio"), finer(system, mode), strict=True):
        apart = np.abs(getattr(mode, name) / true - 1.0).max()
        assert mode.error(name).max() == pytest.approx(apart, rel=0.1, abs=FLOOR[name])
