"""Fits of structures to measured curves: synthetic data give back what made them; SI units."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from clamped_plates import bar, bolted, lapped
from clamped_plates import loads as plate_loads

import skfem_joint as sj
from skfem_joint.fitting import fit as fit_module
from skfem_joint.structure.parameters import value_of, with_values

FRICTION, SPRING, RATIO = "joint[0].friction", "joint[0].tangential_stiffness", "damping.ratio"
PRESSURE, E = "joint[0].pressure", "material.E"
TRUTH = {FRICTION: 0.3, SPRING: 6e11, RATIO: 1e-3}
LOADS = [sj.Load("end", sj.Harmonic(1.0, 500.0))]
AMPLITUDE = np.geomspace(1e-5, 3.5e-5, 8)
#: Standard deviations of samples: of the frequency, Hz, and of the damping over its value.
DEVIATION, SHARE = 4.0, 0.02


def held_bar(**values: float) -> sj.Structure:
    """Bar of which a part is pressed on a rigid base, with springs in series with friction."""
    mesh = sj.build_bar([("joint", 0.2, 16), ("free", 0.3, 5)], {"start": 0.0, "end": 0.5})
    contact = sj.Joint("joint", 8e6, 0.3, tangential_stiffness=6e11)
    given = sj.Structure(
        mesh, sj.Material(200e9, 7850.0, 0.3), width=0.05, thickness=0.01, joints=[contact],
        damping_ratio=1e-3,
    )  # fmt: skip
    return with_values(given, TRUTH | values)


GIVEN = held_bar()
START = with_values(GIVEN, {FRICTION: 0.4, SPRING: 4e11, RATIO: 1.5e-3})
SPRUNG = with_values(START, {SPRING: TRUTH[SPRING]})
FREE = {FRICTION: (0.1, 0.9), SPRING: (1e11, 4e12), RATIO: (1e-4, 1e-2)}


def samples(
    frequency: Any, damping: Any, amplitude: Any = AMPLITUDE, **how: Any
) -> sj.MeasuredCurve:
    columns = {
        "amplitude (m)": amplitude, "frequency": frequency, "damping": damping,
        "frequency_deviation": np.full(amplitude.size, DEVIATION),
        "damping_deviation": SHARE * np.asarray(damping),
    }  # fmt: skip
    return sj.measured_curve(columns, **{"point": "end"} | how)


def curve_of(
    given: sj.Structure, amplitude: Any = AMPLITUDE, loads: Any = LOADS, **how: Any
) -> sj.MeasuredCurve:
    """What a structure would have measured."""
    like = samples(np.full(amplitude.size, 3e3), np.full(amplitude.size, 0.01), amplitude, **how)
    problem = sj.FitProblem(given, like, {FRICTION: (0.0, 9.0)}, loads)
    (found,) = problem.predict(problem.start, [like.displacement])
    return samples(found.frequency, found.damping, amplitude, **how)


DATA = curve_of(GIVEN)


def fitted(data: Any = DATA, free: Mapping[str, Any] = FREE, start: Any = START) -> sj.Fit:
    return sj.fit(start, data, free, LOADS)


@pytest.fixture(scope="module")
def exact() -> sj.Fit:
    return fitted()


def test_exact_data_give_back_the_values(exact):
    assert exact.values == pytest.approx(TRUTH, rel=1e-4)
    # Friction alone holds the bar, so that round-off changes a damping by up to 2e-5 of it.
    (curve,) = exact.predicted
    np.testing.assert_allclose(curve.damping, DATA.damping, rtol=5e-5)
    np.testing.assert_allclose(curve.frequency, DATA.frequency, atol=5e-5 * np.ptp(DATA.frequency))
    assert exact.degrees == 2 * AMPLITUDE.size - 3
    assert exact.evaluations <= 10
    assert exact.computed <= 15
    assert exact.widened == 1.0
    assert not exact.undetermined
    assert not exact.notes
    assert not exact.offsets


def test_nothing_is_left_of_exact_data_of_a_held_bar():
    given, start = (replace(one, fixed=["start"]) for one in (GIVEN, START))
    found = fitted(curve_of(given), start=start)
    assert found.values == pytest.approx(TRUTH, rel=1e-9)
    assert found.sum_of_squares < 1e-18


def test_intervals_bands_and_draws_belong_together(exact):
    for name, value in exact.values.items():
        low, high = exact.interval(name)
        assert low < TRUTH[name] < high
        share = exact.deviations[name] / value
        assert np.log(high / low) == pytest.approx(2.0 * 1.96 * share, rel=1e-3)
        wide = exact.interval(name, 0.999999)
        assert wide[0] >= FREE[name][0]
        assert wide[1] <= FREE[name][1]
    drawn = exact.draws(4000)
    logs = np.log([[one[name] for name in TRUTH] for one in drawn])
    shares = [exact.deviations[name] / value for name, value in exact.values.items()]
    np.testing.assert_allclose(logs.std(axis=0), shares, rtol=0.05)
    assert exact.draws(3, 1) == exact.draws(3, 1) != exact.draws(3, 2)
    (curve,) = exact.predicted
    of_frequency, of_damping = exact.band(curve)
    vectors = np.exp(logs) - np.array([*exact.values.values()])
    for half, rates in ((of_frequency, curve.frequency_rates), (of_damping, curve.damping_rates)):
        spread = (vectors @ rates.T).std(axis=0)
        np.testing.assert_allclose(half, 1.96 * spread, rtol=0.1)


def test_friction_and_pressure_are_told_to_be_undetermined_together():
    free = {FRICTION: (0.1, 0.9), PRESSURE: (2e6, 3e7), RATIO: (1e-4, 1e-2)}
    found = fitted(free=free, start=SPRUNG)
    (sentence,) = found.undetermined
    assert FRICTION in sentence
    assert PRESSURE in sentence
    assert "by its power -1.00" in sentence
    assert RATIO not in sentence
    assert found.values[FRICTION] * found.values[PRESSURE] == pytest.approx(0.3 * 8e6, rel=1e-4)
    assert found.values[RATIO] == pytest.approx(1e-3, rel=1e-4)
    # The uncertainty of each is that of the bounds, that of their product is not.
    low, high = found.interval(FRICTION)
    assert high / low > 3.0
    product = np.array([1.0 / found.values[FRICTION], 1.0 / found.values[PRESSURE], 0.0])
    assert np.sqrt(product @ found.covariance @ product) < 0.02
    assert found.deviations[RATIO] < 0.2e-3


class NotSearched(sj.FitProblem):
    """A problem whose search ends where it begins, as at a kink."""

    def best(self, progress=None):
        return self.start, 1


def test_a_product_is_named_as_undetermined_where_the_search_stalls():
    free = {FRICTION: (0.1, 0.9), PRESSURE: (2e6, 3e7), RATIO: (1e-4, 1e-2)}
    found = fit_module.solved(NotSearched(SPRUNG, curve_of(GIVEN), free, LOADS))
    assert any("derivatives promise" in note for note in found.notes)
    (sentence,) = found.undetermined
    assert FRICTION in sentence
    assert "by its power -1.00" in sentence


def test_what_the_data_do_not_depend_on_is_named():
    low = np.geomspace(1e-7, 1e-6, 6)  # all sticks
    found = fitted(curve_of(GIVEN, low), {FRICTION: (0.1, 0.9), RATIO: (1e-4, 1e-2)})
    assert found.undetermined == (
        f"The data do not determine {FRICTION}: any value within its bounds fits as well.",
    )
    assert found.interval(FRICTION) == (0.1, 0.9)


def test_a_local_minimum_that_misses_the_data_is_left_for_a_better_one():
    """The nearest one misses the damping at the highest amplitude by 31 deviations."""
    truth = {FRICTION: 0.636, SPRING: 5.97e11, RATIO: 5.92e-4}
    data = curve_of(held_bar(**truth), np.geomspace(3e-6, 3.5e-5, 8))
    start = with_values(GIVEN, {FRICTION: 0.781, SPRING: 1.19e11, RATIO: 5.2e-4})
    problem = sj.FitProblem(start, data, FREE, LOADS)
    nearest = problem.minimise(problem.start)
    assert problem.misses(nearest)
    found = fitted(data, start=start)
    assert found.values == pytest.approx(truth, rel=1e-3)
    assert found.searches > 1
    assert found.sum_of_squares < 1e-3 < problem.squares(nearest)
    for held in range(len(FREE)):  # no nested model is better
        nested = problem.minimise(problem.start, held=held)
        assert nested[held] == pytest.approx(problem.start[held], rel=1e-12)
        assert found.sum_of_squares <= problem.squares(nested)
    alone = sj.FitProblem(start, data, {RATIO: FREE[RATIO]}, LOADS)
    alone.minimise(alone.start, held=0)
    assert alone.evaluations == 0


def test_a_value_that_fits_up_to_its_bound_only_is_told_so():
    """Beyond some stiffness springs do not show, below it they do, which no derivative tells."""
    rigid = held_bar(**{SPRING: 1e16})
    free = {SPRING: (1e11, 1e17), RATIO: FREE[RATIO]}
    found = fitted(curve_of(rigid), free, rigid)
    (sentence,) = found.undetermined
    assert SPRING in sentence
    assert "any value from" in sentence
    assert "to 1e+17 fits as well" in sentence
    lowest = float(sentence.split("any value from ")[1].split(" to ")[0])
    problem, most = found.problem, found.sum_of_squares + 3.85
    assert problem.squares(np.array([1.01 * lowest, found.vector[1]])) <= most
    assert problem.squares(np.array([0.3 * lowest, found.vector[1]])) > most


LAPPED = {"contact": "unilateral", "normal_stiffness": 2e12, "tangential_stiffness": 3e11}
BENT = [sj.Load("end", sj.Harmonic(150.0, 400.0), (0.0, 1.0, 0.0))]


def test_contact_that_opens_and_does_not_slip_says_nothing_of_friction():
    """From far away, with a direction as the page describes it."""
    given = lapped(**LAPPED)
    (curve,) = sj.backbone(given.system(BENT), levels=5, up_to=0.15)
    data = samples(
        curve.frequency, curve.damping_ratio, curve.displacement[:, 0], point="end", direction="y"
    )
    found = sj.fit(with_values(given, {FRICTION: 0.9}), data, {FRICTION: (0.3, 1.0)}, BENT)
    (sentence,) = found.undetermined
    assert sentence.startswith(f"The data do not determine {FRICTION}: any value within its bounds")
    assert found.interval(FRICTION) == (0.3, 1.0)


def test_the_offset_of_a_second_set_of_data_is_found():
    moved = samples(DATA.frequency - 7.0, DATA.damping, name="other", offset=["frequency"])
    found = fitted([DATA, moved])
    assert found.offsets == pytest.approx({"offset of other: frequency": -7.0}, rel=1e-4)
    assert found.values == pytest.approx(TRUTH, rel=1e-4)
    assert found.deviations["offset of other: frequency"] > 0.3 * DEVIATION / AMPLITUDE.size**0.5
    assert found.interval("offset of other: frequency")[0] < -7.0


def test_values_on_a_bound_are_noted():
    found = fitted(free={FRICTION: (0.35, 0.9), RATIO: FREE[RATIO]}, start=SPRUNG)
    assert any(
        note.startswith(f"{FRICTION} ends at its bound, 0.35") and "beyond it" in note
        for note in found.notes
    )
    assert not any(RATIO in note for note in found.notes)


def test_a_model_that_misses_the_data_has_wider_deviations_and_says_so():
    wave = 6.0 * (-1.0) ** np.arange(AMPLITUDE.size)
    free = {key: FREE[key] for key in (FRICTION, RATIO)}
    found = fitted(samples(DATA.frequency + wave * DEVIATION, DATA.damping), free, SPRUNG)
    assert found.widened == pytest.approx(np.sqrt(found.sum_of_squares / found.degrees))
    assert found.widened > 3.0
    assert any(f"{found.widened:.3g} times" in note and "widened" in note for note in found.notes)
    _, J = found.problem.residuals(found.vector)
    narrow = np.sqrt(np.diag(np.linalg.inv(J.T @ J)))
    np.testing.assert_allclose([*found.deviations.values()], found.widened * narrow, rtol=1e-6)


def test_samples_that_are_not_fitted_do_not_count_and_are_predicted():
    wrong = DATA.frequency.copy()
    wrong[-2:] += 500.0
    found = fitted(samples(wrong, DATA.damping, highest=0.5 * AMPLITUDE[-3:-1].sum()))
    assert found.values == pytest.approx(TRUTH, rel=1e-4)
    assert found.degrees == 2 * (AMPLITUDE.size - 2) - 3
    (curve,) = found.predicted
    np.testing.assert_allclose(curve.frequency, DATA.frequency, rtol=1e-6)
    np.testing.assert_allclose(curve.displacement, AMPLITUDE)


def test_missing_values_do_not_count():
    frequency, damping = DATA.frequency.copy(), DATA.damping.copy()
    frequency[1], damping[[3, 5]] = np.nan, np.nan
    columns = {"amplitude (m)": AMPLITUDE, "frequency": frequency, "damping": damping}
    found = fitted(sj.measured_curve(columns, point="end"))
    assert found.degrees == 2 * AMPLITUDE.size - 3 - 3
    assert found.values == pytest.approx(TRUTH, rel=1e-4)
    assert any("standard deviations of the frequency" in note for note in found.notes)


def test_samples_of_one_amplitude_and_many_amplitudes():
    repeated = np.repeat(AMPLITUDE[4], 3)
    single = curve_of(GIVEN, repeated)
    found = fitted(single, {FRICTION: (0.1, 0.9)}, with_values(GIVEN, {FRICTION: 0.35}))
    assert found.values[FRICTION] == pytest.approx(0.3, rel=1e-4)
    two = fitted(single, {FRICTION: (0.1, 0.9), RATIO: (1e-4, 1e-2)})
    assert two.degrees == 4
    three = fitted(single)
    assert three.degrees == 3
    assert len(three.undetermined) == 1
    many = curve_of(GIVEN, np.geomspace(AMPLITUDE[0], AMPLITUDE[-1], 40))
    assert fitted(many).values == pytest.approx(TRUTH, rel=1e-2)


def test_curves_of_two_modes():
    given = bar({"tangential_stiffness": 3e12, "beta": np.inf})
    where = [sj.Load("upper_end", sj.Harmonic(1.0, 300.0))]
    free = {FRICTION: (0.2, 2.0), "material.regions.upper_arm.E": (3e10, 2e11)}
    truth = {key: value_of(given, key) for key in free}
    curves = sj.backbone(given.system(where), (1, 2), 6)
    data = [
        curve_of(given, curve.displacement[2:6, 0], where, point="upper_end", mode=curve.mode)
        for curve in curves
    ]
    assert data[1].frequency.min() > 1.5 * data[0].frequency.max()
    start = with_values(given, {key: 1.2 * value for key, value in truth.items()})
    found = sj.fit(start, data, free, where)
    assert found.values == pytest.approx(truth, rel=1e-4)
    assert found.degrees == 2 * 8 - 2
    assert len(found.predicted) == 2


def test_fewer_samples_than_values_are_noted():
    frequency, damping = (
        np.where(np.arange(AMPLITUDE.size) == 3, values, np.nan)
        for values in (DATA.frequency, DATA.damping)
    )
    found = fitted(replace(DATA, frequency=frequency, damping=damping))
    assert found.degrees == -1
    assert any("1 values more than samples" in note for note in found.notes)
    assert len(found.undetermined) == 1


def test_the_gradient_of_the_log_likelihood():
    """By central differences, exact but for errors of levels and interpolation between them."""
    held = replace(START, fixed=["start"])  # levels that friction alone holds are less exact
    data = samples(DATA.frequency, DATA.damping, offset=["damping"])
    problem = sj.FitProblem(held, data, FREE, LOADS)
    assert problem.names == (*FREE, "offset of data: damping")
    vector = np.append(problem.start[:3], 1e-4)
    _, gradient = problem.log_likelihood(vector)
    for k, size in enumerate([*problem.start[:3], 1e-3]):
        change = np.zeros(4)
        change[k] = 1e-2 * size
        high, low = (problem.log_likelihood(end)[0] for end in (vector + change, vector - change))
        assert gradient[k] == pytest.approx((high - low) / (2e-2 * size), rel=5e-4)


def test_a_value_that_may_be_zero_is_fitted_as_it_is():
    found = fitted(free=FREE | {RATIO: (0.0, 1e-2)})
    assert found.values == pytest.approx(TRUTH, rel=1e-4)
    low, high = found.interval(RATIO)
    assert high - found.values[RATIO] == pytest.approx(found.values[RATIO] - low, rel=1e-9)


def test_the_scale_of_a_gap_is_found():
    """Of a bow between bolted plates, whose preload it changes."""
    scale, on = "joint[0].gap_scale", plate_loads("right", 2)
    bow = {"gap": lambda x: 3e-6 * (x[:, 0] / 0.075 - 1.0) ** 2}
    given = bolted(joint=bow, damping_ratio=2e-3)
    data = curve_of(given, np.geomspace(1e-4, 2.5e-4, 5), on, point="right", direction="y")
    start = with_values(given, {scale: 0.5})
    found = sj.fit(start, data, {scale: (0.1, 3.0)}, on)
    assert found.values[scale] == pytest.approx(1.0, rel=1e-3)


# %% What is refused


@pytest.mark.parametrize(
    ("how", "words"),
    [
        ({"free": {}}, "no key is free"),
        ({"free": {"joint[0].frictoin": (0.1, 0.9)}}, r"did you mean 'joint\[0\].friction'"),
        ({"free": {PRESSURE + "s": (1.0, 2.0)}}, "no number that can be varied"),
        ({"free": {FRICTION: (0.9, 0.1)}}, r"found bounds 0.9 to 0.1, must rise from >= 0"),
        ({"free": {FRICTION: (-0.1, 0.9)}}, "must rise from >= 0"),
        ({"free": {FRICTION: (0.1, np.inf)}}, "must rise from >= 0"),
        ({"free": {FRICTION: (0.5, 0.9)}}, "is 0.4 in the scene, must be within the bounds"),
        ({"free": {FRICTION: (0.5, 0.9), RATIO: (3.0, 2.0)}}, "(?s)friction.*damping.ratio"),
        ({"data": replace(DATA, point="tip")}, "found 'tip', must be one of end"),
        ({"data": replace(DATA, fitted=np.zeros(8, bool))}, "no sample of the data is fitted"),
        ({"data": replace(DATA, mode=500)}, r"found mode 500, there are \d+"),
        (
            {"data": samples(np.full(8, 3e3), np.full(8, 0.02), np.geomspace(1e-5, 1.0, 8))},
            "the structure does not reach the largest amplitude",
        ),
        ({"data": [replace(DATA, offset=("frequency",))] * 2}, "give each its own name"),
        ({"data": "nowhere.csv"}, "nowhere.csv"),
        ({"start": "nowhere.toml"}, "nowhere.toml"),
    ],
)
def test_what_cannot_be_fitted_is_refused(how, words):
    with pytest.raises(sj.InputError, match=words):
        fitted(**how)


def test_a_point_that_a_mode_does_not_move_is_refused():
    mesh = sj.build_plate([("joint", 0.1, 4), ("free", 0.1, 4)], 0.02, 2)
    given = sj.Structure(mesh, sj.Material(200e9, 8000.0, 0.3), thickness=0.01,
                         joints=[sj.Joint("joint", 8e6, 0.3)])  # fmt: skip
    loads = [sj.Load("right", sj.Harmonic(1.0, 100.0), (1.0, 0.0))]
    like = samples(np.full(3, 1e3), np.full(3, 1e-2), np.geomspace(1e-6, 1e-5, 3), point="right")
    with pytest.raises(sj.InputError, match="mode 1 does not move the measured point"):
        sj.fit(given, like, {FRICTION: (0.1, 0.9)}, loads)


def test_amplitudes_near_gross_slip_are_reached():
    """With the contact stuck they would ask for more than friction holds."""
    (curve,) = sj.backbone(GIVEN.system(LOADS), levels=3, up_to=0.97)
    near = np.geomspace(0.5, 1.0, 5) * curve.displacement[-1, 0]
    assert fitted(curve_of(GIVEN, near)).values == pytest.approx(TRUTH, rel=1e-3)


def test_a_search_that_does_not_end_is_said(monkeypatch):
    monkeypatch.setattr(fit_module, "EVALUATIONS", 2)
    with pytest.raises(sj.ConvergenceError, match="not found in 2 evaluations"):
        fitted()


@pytest.mark.parametrize(
    ("asked", "words"),
    [
        (lambda found: found.scene, r"problem.model.at\(values\)"),
        (lambda found: found.interval(FRICTION + "s"), "did you mean"),
        (lambda found: found.profile(FRICTION + "s"), "did you mean"),
    ],
)
def test_what_a_fit_does_not_have_is_refused(exact, asked, words):
    with pytest.raises(sj.InputError, match=words):
        asked(exact)


def test_the_profile_of_a_value_is_the_parabola_of_its_covariance_near_exact_data(exact):
    profile, best = exact.profile(FRICTION, points=5), exact.values[FRICTION]
    assert best in profile.values
    assert profile.excess[profile.values == best] == [0.0]
    own = np.log(exact.interval(FRICTION)[1] / best) / 1.959964
    parabola = (np.log(profile.values / best) / own) ** 2
    np.testing.assert_allclose(profile.excess, parabola, rtol=0.05, atol=0.01)
    np.testing.assert_allclose(profile.interval, exact.interval(FRICTION), rtol=0.1 * own)
