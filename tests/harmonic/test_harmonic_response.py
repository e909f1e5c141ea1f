"""Responses by harmonic balance: folds, stability, and time steps beside them."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

import skfem_joint as sj
from skfem_joint.ground.errors import InputError
from skfem_joint.ground.plain_values import fingerprint
from skfem_joint.ground.progress import Tally, silent
from skfem_joint.ground.rows import Rows
from skfem_joint.harmonic.balance import Balance
from skfem_joint.harmonic.newton import by_parameter, solved
from skfem_joint.harmonic.points import point_of
from skfem_joint.harmonic.search import Search
from skfem_joint.harmonic.series import FourierSeries
from skfem_joint.harmonic.stability import multipliers
from skfem_joint.output.damping import response_figure
from skfem_joint.scene.shipped import shipped_scene
from skfem_joint.study.scene_response import RESPONSE_ROWS, scene_response

JOINT = sj.Joint("joint", pressure=3e6, friction=0.4)
#: Oscillator of unit mass and stiffness that meets a spring at a gap of 1.
SPRING, DAMPING, FORCE = 3.0, 0.02, 0.1
PULL = sj.Harmonic(30.0, 100.0)  # of the chain


def oscillator():
    spring = sj.point_contact(None, [1.0], friction=0.0, gap=1.0, normal_stiffness=SPRING)
    loads = {"mass": (0, sj.Harmonic(FORCE, 0.1))}
    return sj.System.from_matrices([[1.0]], [[1.0]], [[2.0 * DAMPING]], contact=spring, loads=loads)


def path(f, state, periods, **ways):
    """Motion over some periods of a force of ``f`` Hz, from a state."""
    omega = 2.0 * np.pi * f

    def rate(t, y):
        force = FORCE * np.sin(omega * t) - 2.0 * DAMPING * y[1] - y[0]
        return y[1], force - SPRING * max(y[0] - 1.0, 0.0)

    return solve_ivp(rate, (0.0, periods / f), state, rtol=1e-9, atol=1e-11, **ways).y


def followed(f, state, periods=100):
    """Half of peak to peak in the last of some periods."""
    times = np.linspace(periods - 1.0, periods, 400) / f
    return 0.5 * np.ptp(path(f, state, periods, t_eval=times)[0])


@pytest.fixture(scope="module")
def curve():
    frequencies = np.linspace(0.95, 1.25, 11) / (2.0 * np.pi)
    (found,) = sj.harmonic_response(oscillator(), frequencies, confirm=False)
    return found


def test_a_branch_passes_both_turning_points(curve):
    """It turns back at the higher frequency first, and is unstable up to the lower one."""
    high, low = curve.turns
    assert high > 1.08 * low
    f, stable = curve.column("frequency"), curve.column("stable").astype(bool)
    assert np.all(stable[: int(np.argmax(np.diff(f) < 0.0))])
    unstable = f[~stable]
    assert unstable.size > 5
    assert np.all(np.diff(unstable) < 0.0)
    assert unstable.max() < high + 1e-4
    assert unstable.min() > low - 1e-4


def test_turning_points_do_not_depend_on_how_many_frequencies_are_asked_for(curve):
    """Close frequencies have short steps, for which each kink of sampled contact is a turn."""
    frequencies = np.linspace(1.03, 1.19, 17) / (2.0 * np.pi)
    (fine,) = sj.harmonic_response(oscillator(), frequencies, confirm=False)
    assert fine.turns == pytest.approx(curve.turns, rel=1e-3)


def test_both_stable_branches_attract_and_the_middle_one_does_not(curve):
    """Between the turning points time steps end on one of the outer ones."""
    high, low = curve.turns
    f, reach = curve.column("frequency"), curve.column("amplitude")[:, 0]
    stable, number = curve.column("stable").astype(bool), np.arange(f.size)
    first = int(np.argmin(stable))
    k = int((np.abs(f - 0.5 * (low + high)) + stable).argmin())
    middle = curve.points[k]
    assert not middle.stable
    found = []
    for kick in (-0.3, 0.3):
        u, v = (float(x[0]) for x in middle.state)
        found.append(followed(f[k], (u * (1.0 + kick), v * (1.0 + kick))))
    upper, lower = (
        float(np.interp(f[k], f[part], reach[part]))
        for part in (stable & (number < first), stable & (number > first))
    )
    assert lower < reach[k] < upper
    np.testing.assert_allclose(sorted(found), [lower, upper], rtol=0.02)


def test_the_peak_lies_on_the_free_vibration(curve):
    """Lightly damped: the period of free vibration with this amplitude, by its two half waves."""
    k = int(curve.column("amplitude")[:, 0].argmax())
    reach, offset = curve.points[k].amplitude[0], curve.points[k].offset[0]
    lowest = reach - offset  # on the side without the spring
    stiff, speed = np.sqrt(1.0 + SPRING), np.sqrt(lowest**2 - 1.0)
    beyond = 1.0 / (1.0 + SPRING)  # of the gap, from where the spring's forces are in balance
    pressed = 2.0 / stiff * np.arctan2(-speed / stiff, beyond)
    period = 2.0 * np.pi - 2.0 * np.arccos(1.0 / lowest) - pressed
    assert curve.points[k].frequency == pytest.approx(1.0 / period, rel=5e-3)


def balance_of(system, highest=5):
    return Balance.of(system, FourierSeries(highest, 2048, odd=False), 1.0, 1000.0)


def test_multipliers_of_a_linear_system_are_closed():
    rng = np.random.default_rng(3)
    frequency, ratio, omega = np.array([0.9, 2.3, 4.1]), np.array([0.01, 0.04, 0.02]), 1.3
    shapes = np.linalg.qr(rng.standard_normal((3, 3)))[0]
    C, K = (shapes * x @ shapes.T for x in (2.0 * ratio * frequency, frequency**2))
    balance = balance_of(sj.System(np.eye(3), C, K))
    found = np.abs(multipliers(balance, np.zeros((balance.series.size, 3)), omega))
    exact = np.exp(-2.0 * np.pi * ratio * frequency / omega)
    np.testing.assert_allclose(found, np.sort(np.repeat(exact, 2))[::-1], rtol=1e-9)


def test_multipliers_are_those_of_the_map_of_a_period(curve):
    """By differences of time steps over a period, on each of the branches."""
    system = oscillator()
    f, stable = curve.column("frequency"), curve.column("stable").astype(bool)
    upper = int(np.argmin(stable)) - 3
    middle = int((np.abs(f - 0.1667) + stable).argmin())
    for k in (upper, middle):
        point = curve.points[k]
        state, step = np.array([float(x[0]) for x in point.state]), 1e-5
        for _ in range(2):  # the second time from where the period ends as it began
            ends = [
                path(point.frequency, state + sign * change, 1)[:, -1]
                for change in step * np.eye(2)
                for sign in (1.0, -1.0)
            ]
            J = np.column_stack([ends[0] - ends[1], ends[2] - ends[3]]) / (2.0 * step)
            exact = np.linalg.eigvals(J)
            left = path(point.frequency, state, 1)[:, -1] - state
            state = state - np.linalg.solve(J - np.eye(2), left)
        sampled = FourierSeries(31, len(point.course) - 1, odd=False)
        q = sampled.projection.T @ point.course[:-1]
        found = multipliers(balance_of(system, 31), q, 2.0 * np.pi * point.frequency)
        np.testing.assert_allclose(np.abs(found[0]), np.abs(exact).max(), rtol=3e-3)


def chain(loads=None):
    """Two masses, a slider on a spring between the second one and the base."""
    K, loads = 1e6 * np.array([[2.0, -1.0], [-1.0, 1.0]]), loads or {"end": (1, PULL)}
    slider = sj.point_friction([0.0, 1.0], 20.0, stiffness=3e5)
    given = {"contact": slider, "loads": loads, "points": {"end": 1}, "stiffness_damping": 1e-5}
    return sj.System.from_matrices(np.eye(2), K, **given)


def beating():
    """The chain with a second load of nearly the same frequency."""
    (load,) = chain().loads
    return replace(chain(), loads=(load, replace(load, amplitude=sj.Harmonic(1.0, 100.01))))


def test_a_slider_responds_as_in_time_steps():
    system, frequencies = chain(), np.linspace(95.0, 125.0, 7)
    levels = (0.3, 1.0, 3.0)
    ways = {"steps_per_cycle": 1600, "refined": False, "estimated": False}
    marched = sj.response(system, frequencies, levels, **ways)
    for curve, other in zip(
        sj.harmonic_response(system, frequencies, levels), marched, strict=True
    ):
        f = curve.column("frequency")
        rows = [int(np.abs(f - frequency).argmin()) for frequency in frequencies]
        for name, near in (("amplitude", 2e-3), ("friction_energy", 1e-2)):
            ours, theirs = curve.column(name)[rows], other.column(name)
            np.testing.assert_allclose(ours, theirs, rtol=near, atol=1e-3 * theirs.max())
        strain, other_strain = curve.losses.strain[rows], other.losses.strain
        np.testing.assert_allclose(strain, other_strain, rtol=5e-3)
        assert not curve.why
        assert all(max(apart) < 1e-3 for apart in curve.confirmed.values())
        assert curve.column("stable").all()


def test_stated_errors_are_those_beside_many_more_harmonics():
    search = Search.of(chain(), np.linspace(95.0, 125.0, 4), 3000.0, Tally(silent, 0))
    places, _ = search.branches(1.0)
    for place in places:
        found = search.settled(place, 1.0, 0.0)
        series = found.forced.balance.series
        finer = found.forced.refined(FourierSeries(8 * series.highest, 4096, series.odd))
        q = finer.balance.series.of(found.place.q, series)
        x = solved(finer, np.append(q, place.omega), by_parameter(q.size + 1)).x
        true = point_of(finer.balance, x[:-1].reshape(q.shape), x[-1], finer.force)
        for stated, name in zip(found.errors, ("amplitude", "friction_energy"), strict=True):
            apart = np.abs(getattr(found.point, name) / getattr(true, name) - 1.0).max()
            assert 0.5 * apart <= stated + 1e-5
            assert stated <= 3.0 * apart + 1e-5


def test_points_that_few_harmonics_do_not_settle_state_no_less_than_they_lack():
    frequencies = np.linspace(0.95, 1.25, 4) / (2.0 * np.pi)
    few, more = (
        sj.harmonic_response(oscillator(), frequencies, confirm=False, harmonics=most)[0]
        for most in (9, 159)
    )
    assert few.series.highest == 9
    kept = [k for k, p in enumerate(few.points) if np.isclose(p.frequency, frequencies).any()]
    for k in kept:
        point = few.points[k]
        same = [p for p in more.points if abs(p.frequency / point.frequency - 1.0) < 1e-9]
        apart = min(abs(p.amplitude[0] / point.amplitude[0] - 1.0) for p in same)
        assert apart <= few.errors["amplitude"][k] + 1e-9
    assert few.errors["amplitude"][kept].max() > 1e-5


def test_energies_of_a_period_are_in_balance():
    (curve,) = sj.harmonic_response(chain(), np.linspace(95.0, 125.0, 4), (1.0,), confirm=False)
    for point in curve.points:
        assert point.input_energy == pytest.approx(float(point.losses.lost), rel=3e-5)  # sampled


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"frequencies": np.array([100.0])}, "must be two at least"),
        ({"frequencies": np.array([100.0, 90.0])}, r"frequencies\[1\]: found 90, must be > 100"),
        ({"levels": [-1.0]}, "levels"),
        ({"levels": [1e-200, 1.0, 1e30]}, r"levels: found 1e-200, 1e\+30, must be from"),
        ({"sticking": 0.5}, "sticking: found 0.5, must be >= 1"),
        ({"sticking": np.inf}, "sticking: found inf, must be >= 1 and finite"),
        ({"harmonics": 5}, "harmonics: found 5, must be >= 9, a whole number"),
        (
            {"system": beating()},
            "loads: found 100, 100.01 Hz, the highest of which is harmonic 10001",
        ),
        ({"system": replace(chain(), loads=())}, "no load acts"),
        ({"system": replace(chain(), P=None, points=())}, "nothing is observed"),
    ],
)
def test_what_has_no_response_is_refused(changes, message):
    given = {"system": chain(), "frequencies": np.array([90.0, 100.0]), "levels": [1.0]} | changes
    with pytest.raises(InputError, match=message):
        sj.harmonic_response(**given)


@pytest.fixture(scope="module")
def of_scene():
    scene = sj.load_scene(shipped_scene("structure_harmonic")).changed(
        models={"run": ["reduced"]}, accuracy={"estimate": False},
        response={"frequencies": {"from": 2100.0, "to": 2600.0, "points": 4}, "levels": [0.03],
                  "method": "harmonic"},
    )  # fmt: skip
    return scene_response(scene)


def test_a_scene_has_the_response_of_python(of_scene):
    system = of_scene.scene.system()
    model = sj.reduce(system, frequency=float(of_scene.frequencies[2]), level=0.03)
    (other,) = sj.harmonic_response(model, of_scene.frequencies, [0.03])
    (curve,) = of_scene.models[0].curves
    for name in ("frequency", "amplitude", "friction_energy"):
        np.testing.assert_allclose(curve.column(name), other.column(name), rtol=1e-6)


def test_unstable_points_are_dashed(of_scene):
    (model,) = of_scene.models
    (curve,) = model.curves
    points = [replace(p, stable=k not in (1, 2)) for k, p in enumerate(curve.points)]
    part = replace(model, curves=[replace(curve, points=tuple(points))])
    panel = response_figure(replace(of_scene, models=[part])).axes[0]
    whole, dashed = (np.isfinite(line.get_ydata()) for line in panel.lines[-2:])
    np.testing.assert_array_equal(np.flatnonzero(~whole), [1, 2])
    np.testing.assert_array_equal(np.flatnonzero(dashed), [0, 1, 2, 3])


@pytest.mark.parametrize(
    "loads",
    [
        {"last": ([0.0, -1.0], PULL)},
        {"last": (1, sj.Harmonic(30.0, 100.0, 1.0)), "first": (0, sj.Harmonic(50.0, 100.0, 2.5))},
        {"last": (1, sj.Harmonic(30.0, 200.0)), "first": (0, sj.Harmonic(20.0, 300.0, 0.4))},
    ],
    ids=["a load with the other sign", "loads with two phases", "no first harmonic"],
)
def test_phases_and_slips_are_those_of_a_response(loads):
    """Slips are half of peak to peak in both, wherever a point comes to slip to and fro."""
    system, frequencies = chain(loads), np.array([30.0, 40.0])
    (curve,) = sj.harmonic_response(system, frequencies, confirm=False)
    ways = {"steps_per_cycle": 1000, "refined": False, "estimated": False}
    (other,) = sj.response(system, frequencies, **ways)
    for name, near in (("phase", {"atol": 5e-3}), ("slip", {"rtol": 1e-2})):
        ours, theirs = (
            [getattr(p, name)[-1] for p in found.points if np.isin(p.frequency, frequencies)]
            for found in (curve, other)
        )
        assert len(ours) == frequencies.size
        np.testing.assert_allclose(ours, theirs, **near)


def two_masses(stiffness=np.inf):
    """Two masses on springs, of which the first rubs and the second is driven."""
    K = 1e4 * np.array([[2.0, -1.0], [-1.0, 1.2]])
    slider = sj.point_friction([1.0, 0.0], 2.0, stiffness=stiffness)
    loads = {"last": (1, sj.Harmonic(5.0, 10.0))}
    return sj.System.from_matrices(np.eye(2), K, 0.5 * np.eye(2), contact=slider, loads=loads)


@pytest.mark.parametrize("stiffness", [np.inf, 5e3])
@pytest.mark.parametrize("last", [15.0, 17.0])
def test_each_frequency_asked_for_has_a_point_and_the_last_ends_the_curve(stiffness, last):
    """Below its resonance amplitudes fall so steeply that steps pass a frequency."""
    asked = np.array([12.0, 13.0, last])
    (curve,) = sj.harmonic_response(two_masses(stiffness), asked, confirm=False)
    f = curve.column("frequency")
    assert all(np.isclose(f, frequency, rtol=1e-9).sum() == 1 for frequency in asked)
    assert f[-1] == pytest.approx(last, rel=1e-9)
    assert np.all(np.diff(f) > 0.0)
    assert not curve.turns


def test_the_stated_errors_are_the_distance_to_rigid_sticking():
    """Time steps with springs up to 1e9 N/m give 4.917402e-4 m at 17 Hz."""
    frequencies = np.array([12.0, 15.9, 17.0])
    (curve,) = sj.harmonic_response(two_masses(), frequencies, confirm=False)
    exact = curve.points[-1].amplitude[0] / 4.917402e-4 - 1.0
    stated = curve.errors["amplitude"].max() + curve.sticking[0]
    assert 0.7 * exact < stated < 1.5 * exact
    told = any("springs of sticking leave an error of the amp" in note for note in curve.notes)
    assert told == (stated > 0.01)


#: Slider along x, pressed along y, where it opens.
SLIDER = sj.point_contact(
    [1.0, 0.0], [0.0, 1.0], friction=0.4, force=5.0, normal_stiffness=2e4, stiffness=8e3
)


def test_a_motion_that_doubles_its_period_is_not_called_stable():
    """Time steps of this bouncing slider leave it by 28 % of its amplitude within 160 periods."""
    K = np.array([[1e4, 2e3], [2e3, 2e4]])
    system = sj.System.from_matrices(
        np.eye(2), K, 4.0 * np.eye(2), contact=SLIDER, points={"x": 0, "y": 1},
        loads={"a": (0, sj.Harmonic(12.0, 1.0)), "b": (1, sj.Harmonic(8.4, 1.0, 0.5))},
    )  # fmt: skip
    (curve,) = sj.harmonic_response(system, np.array([17.5, 18.0]), confirm=False)
    assert not any(point.stable for point in curve.points)
    assert sum("stability of" in note for note in curve.notes) == 1


@pytest.mark.parametrize("beta", [3.0, np.inf])
def test_the_arctangent_law_is_noted(beta):
    system = chain().with_beta(beta)
    (curve,) = sj.harmonic_response(system, np.array([95.0, 96.0]), confirm=False)
    assert any("beta = 3 s/m" in note for note in curve.notes) == np.isfinite(beta)


def block(push=6.0):
    """A block that only friction holds, lifted a little as it is pushed."""
    return sj.System.from_matrices(
        np.eye(2), np.zeros((2, 2)), np.diag([0.0, 20.0]), contact=SLIDER, points={"x": 0},
        loads={"push": (0, sj.Harmonic(push, 1.0)), "lift": (1, sj.Harmonic(2.0, 1.0, 0.7))},
    )  # fmt: skip


def test_a_block_walks_where_it_is_lifted_as_it_is_pushed():
    """Time steps of a block that only friction holds go the same way in each period."""
    system = block(push=1.5)  # which sticks and slips in each period
    (curve,) = sj.harmonic_response(system, np.array([1.6, 1.61]), confirm=False)
    point, steps = curve.points[0], 1000
    loads = tuple(replace(x, amplitude=replace(x.amplitude, frequency=1.6)) for x in system.loads)
    driven = replace(system, loads=loads)
    run = sj.integrate(driven, cycles=6, steps_per_cycle=steps, initial=point.state)
    seen = run.point("x")[-1 - steps :]
    way = float(seen[-1] - seen[0])
    reach = 0.5 * np.ptp(seen - way * np.arange(steps + 1) / steps)
    assert curve.walks == pytest.approx(abs(way), rel=1e-2)
    assert point.amplitude[0] == pytest.approx(reach, rel=2e-3)
    assert point.friction_energy == pytest.approx(float(run.cycles.friction[-1]), rel=2e-3)
    assert any("walk by up to" in note for note in curve.notes)
    assert point.stable is None


def test_the_way_of_a_walk_does_not_depend_on_the_unknowns():
    """It is that of the structure, in m, in a model of any basis."""
    ways = [
        sj.harmonic_response(system, np.array([1.6, 1.61]), confirm=False)[0].walks
        for system in (block(), block().project(1e3 * np.eye(2)))
    ]
    assert ways[1] == pytest.approx(ways[0], rel=1e-6)


def between_stops(**friction):
    """A free mass with damping between two stops that differ."""
    one, N = np.ones(2), np.array([[1.0], [-1.0]])
    normal = sj.NormalPart(N, 0.1 * one, 0.0 * one, np.array([3.0, 1.0]), one)
    rows = np.ones((len(friction), 1))
    gain, limits = np.zeros((len(friction), 2)), list(friction.values())
    springs = np.ones(len(friction))
    contact = sj.Contact(rows, limits, np.inf, stiffness=springs, normal=normal, gain=gain)
    load = sj.AppliedLoad(np.ones(1), sj.Harmonic(1.0, 1.0), "mass")
    return sj.System(np.eye(1), 0.3 * np.eye(1), 0.0 * np.eye(1), contact, (load,), np.eye(1), "m")


def test_nothing_walks_through_a_stop():
    """Marching finds the same vibration; the share of the springs that hold its mean is noted."""
    system, frequencies = between_stops(), np.array([0.2, 0.21])
    (curve,) = sj.harmonic_response(system, frequencies, confirm=False)
    (marched,) = sj.response(system, frequencies[:1], steps_per_cycle=800, estimated=False)
    assert curve.walks == 0.0
    assert curve.points[0].amplitude[0] == pytest.approx(marched.points[0].amplitude[0], rel=5e-3)
    assert any("keeps bodies in place" in note for note in curve.notes)


def test_the_force_of_soft_springs_does_not_depend_on_the_unknowns():
    """It is a force in N on the structure, over a friction limit here."""
    system, frequencies = between_stops(limit=0.01), np.array([0.2, 0.21])
    (curve,) = sj.harmonic_response(system, frequencies, confirm=False)
    (other,) = sj.harmonic_response(system.project(10.0 * np.eye(1)), frequencies, confirm=False)
    assert curve.held == pytest.approx(other.held, rel=1e-3)
    assert curve.held > 0.1


def test_friction_points_that_no_mode_moves_do_not_count():
    """A plate pulled along its axis of symmetry: modes move points there along it alone."""
    plate = sj.Structure(
        sj.build_plate([("joint", 0.08, 6), ("arm", 0.22, 6)], 0.03, 2), joints=[JOINT],
        material=sj.Material(70e9, 2700.0, 0.33), thickness=0.006, fixed=["left"],
        damping_ratio=0.005,
    )  # fmt: skip
    pull = sj.Load("right", sj.Harmonic(300.0, 300.0), direction=(1.0, 0.0))
    model = sj.reduce(plate.system([pull]), 4, frequency=300.0)
    slips = model.contact.by_point(np.abs(model.contact.B).sum(axis=1))
    assert slips.min() < 1e-12 * slips.max()
    frequencies = np.array([2000.0, 2100.0])
    (curve,) = sj.harmonic_response(model, frequencies, confirm=False)
    (marched,) = sj.response(model, frequencies, estimated=False, refined=False)
    balanced, stepped = (c.column("amplitude")[[0, -1], 0] for c in (curve, marched))
    np.testing.assert_allclose(balanced, stepped, rtol=1e-3)


@pytest.mark.parametrize(("limit", "told"), [(1.45, False), (1.5124, True)])
def test_friction_along_two_directions_that_does_not_become_periodic_is_noted(limit, told):
    """Stiff springs give the motion; with the higher limit the slider hardly slips."""
    stiff, waves = 1e5, [(0.7969, 1.0, 1.826), (0.4511, 2.0, 5.712), (1.3849, 1.0, 5.969)]
    loads = tuple(
        sj.AppliedLoad(stiff * size * np.eye(2)[k], sj.Harmonic(1.0, f, phase), "base")
        for (size, f, phase), k in zip(waves, (0, 0, 1), strict=True)
    )
    contact = sj.Contact(np.eye(2), [limit], np.inf, directions=np.array([2]), stiffness=np.ones(1))
    system = sj.System(
        np.eye(2), np.eye(2), stiff * np.eye(2), contact, loads, np.eye(2), ("x", "y")
    )
    (curve,) = sj.harmonic_response(system, np.array([1.0, 1.01]), confirm=False)
    assert any("is not periodic after 100" in note for note in curve.notes) == told


def test_curves_that_are_kept_are_taken_up_to_the_last_bit(tmp_path):
    """A higher level goes on from those below it, of which none is computed again."""
    frequencies, file = np.linspace(95.0, 125.0, 4), tmp_path / "rows.jsonl"
    kept = Rows(tmp_path / "whole.jsonl", RESPONSE_ROWS)
    whole = sj.harmonic_response(chain(), frequencies, (0.3, 1.0), rows=kept)
    for levels, taken in (((0.3,), 0), ((0.3, 1.0), 1), ((1.0, 0.3), 2), ((1.0,), 0)):
        rows = Rows(file, RESPONSE_ROWS)
        found = sj.harmonic_response(chain(), frequencies, levels, rows=rows)
        assert (rows.taken, rows.taken + rows.computed) == (taken, len(levels))
        if len(levels) == 2:
            by_level = {curve.level: curve for curve in found}
            for curve in whole:
                assert fingerprint(by_level[curve.level]) == fingerprint(curve)
                assert by_level[curve.level].notes == curve.notes
