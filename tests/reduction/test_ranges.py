"""Models for a range: exact rescaling, saved and loaded, errors beside full runs, refusals."""

import numpy as np
import pytest
from benchmarks.ranges import bar
from opening_blocks import opening_system

import skfem_joint as sj
from skfem_joint.reduction.friction_points import merged_points
from skfem_joint.reduction.ranges.points import sticking
from skfem_joint.reduction.ranges.stuck import StuckVibration
from skfem_joint.reduction.ranges.training import spread

ASKED = {"slip": (0.2, 0.9), "frequency": (100.0, 900.0), "limits": {"inner": (0.5, 2.0)}}


@pytest.fixture(scope="module")
def system():
    """A bar with two joints; the outer one always slips first with these factors."""
    return bar(3)


@pytest.fixture(scope="module")
def small(system):
    return sj.reduce(system, 14, range=ASKED)


def run(model):
    return sj.integrate(model, cycles=3, steps_per_cycle=100)


@pytest.mark.parametrize(
    ("frequency", "slip", "factor"), [(140.0, 0.85, 0.6), (480.0, 0.3, 1.9), (820.0, 0.6, 1.0)]
)
def test_points_are_as_close_to_the_full_model_as_asked_and_their_errors_are_stated(
    system, small, frequency, slip, factor
):
    point = sj.at(small, frequency=frequency, slip=slip, limits={"inner": factor})
    at = point.serves.point
    full = run(sj.at(system, frequency=frequency, level=at.level, limits=at.limits))
    ours = run(point)
    errors, stated = sj.compare(full, ours), sj.estimate(ours).parts["total"]
    friction = abs(errors.friction_energy_per_cycle)
    assert errors.displacement_rms < 0.01
    assert friction < 0.03
    assert stated["displacement_rms"] > 0.5 * errors.displacement_rms
    assert stated["friction_energy"] > 0.5 * friction


def test_a_factor_common_to_loads_and_all_limits_rescales_the_solution(small):
    limits, twice = {"inner": 1.0, "outer": 1.0}, {"inner": 2.0, "outer": 2.0}
    one = sj.at(small, frequency=300.0, slip=0.5, limits=limits)
    level = one.serves.point.level
    other = sj.at(small, frequency=300.0, level=2.0 * level, limits=twice)
    again = sj.at(small, frequency=300.0, slip=0.5, limits=twice)
    assert again.serves.point.level == pytest.approx(2.0 * level, rel=1e-9)
    first, second = run(one), run(other)
    assert np.abs(second.point_u - 2.0 * first.point_u).max() < 1e-9 * np.abs(second.point_u).max()
    assert second.cycles.friction == pytest.approx(4.0 * first.cycles.friction, rel=1e-9)


def test_a_saved_model_serves_and_states_errors_to_the_same_bits(small, tmp_path):
    loaded = sj.load(sj.save(small, tmp_path / "small.npz"))
    where = {"frequency": 650.0, "slip": 0.4, "limits": {"inner": 1.5}}
    ours, theirs = (run(sj.at(model, **where)) for model in (small, loaded))
    np.testing.assert_array_equal(ours.point_u, theirs.point_u)
    assert sj.estimate(ours).parts == sj.estimate(theirs).parts
    assert repr(loaded) == repr(small)
    point = sj.load(sj.save(sj.at(small, **where), tmp_path / "point.npz"))
    assert point.serves.point == sj.at(small, **where).serves.point


@pytest.mark.parametrize(
    ("where", "words"),
    [
        ({"frequency": 950.0, "slip": 0.5}, "950 Hz, outside the range"),
        ({"frequency": 500.0, "slip": 0.95}, "outside the range of the reduced model, 0.2 to 0.9"),
        ({"frequency": 500.0, "slip": 1.1}, "a joint slips as a whole"),
        ({"frequency": 500.0, "slip": 0.5, "limits": {"inner": 2.5}}, "even with a common factor"),
        ({"frequency": 500.0, "slip": 0.5, "limits": {"outer": 1.3, "inner": 0.6}}, "a common"),
        ({"frequency": 500.0, "slip": 0.5, "limits": {"middle": 1.0}}, "'middle'"),
        ({"frequency": 500.0, "slip": 0.5, "limits": {"inner": -1.0}}, "limits.inner"),
        ({"frequency": 500.0, "slip": 0.5, "level": 1.0}, "slip or level"),
        ({"frequency": 500.0}, "slip or level"),
    ],
)
def test_a_point_outside_the_range_is_refused(small, where, words):
    with pytest.raises(sj.InputError, match=words):
        sj.at(small, **where)


@pytest.fixture(scope="module")
def sharing():
    """Two joints beside each other, which share the nodes between them: 3,000 N each."""
    mesh = sj.build_plate(
        [("a", 0.05, 5), ("b", 0.05, 5), ("arm", 0.1, 5)], 0.04, 4,
        boundaries={"end": "right", "held": "left"},
    )  # fmt: skip
    structure = sj.Structure(
        mesh,
        sj.Material(E=200e9, density=8000, poisson=0.3),
        thickness=0.005,
        fixed=["held"],
        damping_ratio=0.01,
        joints=[sj.Joint("a", 5e6, 0.3), sj.Joint("b", 5e6, 0.3)],
    )
    return structure.system([sj.Load("end", sj.Harmonic(3e3, 500.0), direction=(1, 0))])


def test_the_design_point_of_joints_that_share_nodes_is_the_full_system(sharing):
    """Held nodes carry 300 of 6,000 N; a point was multiplied once for each of its joints."""
    there = sj.at(sharing, frequency=500.0, level=1.0)
    assert sharing.contact.w.sum() == pytest.approx(5700.0, rel=1e-12)
    np.testing.assert_allclose(there.contact.w, sharing.contact.w, rtol=1e-14)
    np.testing.assert_allclose(there.contact.J.toarray(), sharing.contact.J.toarray(), rtol=1e-14)
    ours, theirs = (sj.integrate(s, cycles=2, steps_per_cycle=100) for s in (there, sharing))
    assert ours.friction_energy == pytest.approx(theirs.friction_energy, rel=1e-9)


def test_a_factor_on_a_joint_acts_on_its_share_of_points(sharing):
    before = sharing.contact.limits_by_joint
    there = sj.at(sharing, frequency=500.0, level=1.0, limits={"b": 1.7})
    after = there.contact.limits_by_joint
    np.testing.assert_allclose(after[0], before[0], rtol=1e-12)
    np.testing.assert_allclose(after[1], 1.7 * before[1], rtol=1e-12)
    np.testing.assert_allclose(there.contact.w, after.sum(axis=0), rtol=1e-12)
    assert np.intersect1d(*sharing.contact.joint_points).size == 5
    rng = np.random.default_rng(0)
    reduced = sharing.project(rng.normal(size=(sharing.n, 6)))
    merged = merged_points(reduced, rng.normal(size=(20, 6)), np.flatnonzero(sharing.contact.w), 9)
    own = merged.contact.with_factors(np.array([1.0, 1.7])).limits_by_joint.sum(axis=1)
    assert own == pytest.approx(before.sum(axis=1) * [1.0, 1.7], rel=1e-12)


def test_a_factor_acts_on_what_normal_forces_give():
    system = opening_system(friction=0.5)
    same = opening_system(friction=0.2).contact.w
    there = sj.at(system, frequency=500.0, level=1.0, limits={"base": 0.4})
    np.testing.assert_allclose(there.contact.w, same, rtol=1e-12)
    np.testing.assert_allclose(there.contact.gain @ there.contact.normal.force, same, rtol=1e-12)


@pytest.mark.parametrize("times", [1.15, 1e3])
def test_errors_of_a_run_in_which_a_joint_slips_as_a_whole_are_refused(small, times):
    level = sj.at(small, frequency=500.0, slip=0.5).serves.point.level
    slipping = run(sj.at(small, frequency=500.0, level=2.0 * times * level))
    with pytest.raises(sj.ConvergenceError, match="a joint slips as a whole"):
        sj.estimate(slipping)


def test_levels_of_which_none_has_a_vibration_have_no_response(small):
    level = 20.0 * sj.at(small, frequency=500.0, slip=0.5).serves.point.level
    with pytest.raises(sj.ConvergenceError, match=r"level .*slips as a whole"):
        sj.response(small, [500.0], [level], refined=False, estimated=False)


def test_a_point_by_its_level_is_that_by_its_slip(small):
    """Under a ten-thousandth of that level all points stick but for what the law creeps."""
    one = sj.at(small, frequency=500.0, slip=0.5)
    level = one.serves.point.level
    same = sj.at(small, frequency=500.0, level=level)
    np.testing.assert_array_equal(run(same).point_u, run(one).point_u)
    assert same.serves.point.slip is None
    assert sticking(run(sj.at(small, frequency=500.0, level=1e-4 * level))) == 1.0


def test_points_are_taken_from_a_model_of_the_range_and_run(small, system):
    point = sj.at(small, frequency=500.0, slip=0.5)
    for model, words in ((point, "model of the whole range"), (system, "without a range")):
        with pytest.raises(sj.InputError, match=words):
            sj.at(model, frequency=500.0, slip=0.5)
    with pytest.raises(sj.InputError, match=r"sj\.at\(model, frequency"):
        run(small)


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        ({"slip": (0.1, 0.9)}, "frequency is missing"),
        (ASKED | {"slip": (0.1, 1.2)}, r"range\.slip"),
        (ASKED | {"frequency": (900.0, 100.0)}, r"range\.frequency"),
        (ASKED | {"frequency": 900.0}, "two numbers"),
        (ASKED | {"limits": {"middle": (0.5, 2.0)}}, "'middle'"),
        (ASKED | {"level": (1.0, 2.0)}, "'level'"),
        ("all", "mapping"),
        (ASKED, "leave them out"),
    ],
)
def test_a_range_that_makes_no_sense_is_refused(system, asked, words):
    """Friction points, which are found for the whole range, cannot be given beside one."""
    points = 10 if words == "leave them out" else "auto"
    with pytest.raises(sj.InputError, match=words):
        sj.reduce(system, range=asked, friction_points=points)


def test_an_accuracy_that_is_not_met_is_said(system, small, caplog):
    assert small.serves.shortfall is None
    poor = sj.reduce(system, 2, range=ASKED)
    assert poor.serves.reached > 0.01
    assert "made for an accuracy of 1.00%" in poor.serves.shortfall
    assert poor.serves.shortfall in caplog.text


def test_slow_vibration_without_slip_passes_the_load_to_the_joint_next_to_it(system):
    """At rest the arm carries the load to the outer joint alone: its limit is the level."""
    stuck = StuckVibration.of(system, 900.0)
    limit = 4e6 * 0.5 * 0.05 * 0.1
    slow = sj.at(system, frequency=1e-3, level=1.0)
    assert stuck.level(slow) == pytest.approx(limit / 1e4, rel=1e-3)


def test_a_range_has_all_stuck_modes_up_to_three_times_its_highest_frequency():
    system = bar(12)
    frequencies = sj.natural_modes(system, 30, joints="stuck").frequencies
    for highest in (900.0, frequencies[25] / 3.0):
        count = np.count_nonzero(frequencies <= 3.0 * highest)
        assert StuckVibration.of(system, highest).modes.shape[1] == max(count, 1)


def test_training_points_are_in_the_range_and_go_a_little_beyond_its_slip(system):
    asked = sj.Range.of(ASKED)
    places = spread(system.contact.joints, asked, 16)
    assert len({place.frequency for place in places}) == 16
    for place in places:
        assert 100.0 <= place.frequency <= 900.0
        assert 0.2 <= place.slip <= 0.9 * 1.1
        inner, outer = place.factors(system.contact.joints)
        assert 0.5 <= inner <= 2.0
        assert outer == 1.0
