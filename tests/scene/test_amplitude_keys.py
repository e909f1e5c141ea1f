"""Forces in time: periods, corners, peaks, impulses in closed form, functions, tables of files."""

import math

import numpy as np
import pytest
from scipy.integrate import quad

import skfem_joint as sj
from skfem_joint.ground.loads import Amplitude, Function, as_amplitude, common_period
from skfem_joint.ground.text_tables import read_table

PEAK, RISE, START = -87.5e3, 4e-5, 1.3e-4
IMPULSES: list[Amplitude] = [
    sj.Triangle(PEAK, RISE, START),
    sj.HalfSine(PEAK, RISE, START),
    sj.Versine(PEAK, RISE, START),
    sj.RampAndHold(PEAK, RISE, START),
    sj.Rectangle(PEAK, 2 * RISE, START),
]
ALL_LOADS: list[Amplitude] = [
    sj.Harmonic(63e3, 1000.0, 0.4),
    sj.MultiHarmonic((sj.Harmonic(3.0, 50.0), sj.Harmonic(2.0, 75.0, 1.0))),
    *IMPULSES,
    sj.Table([0.0, 1e-4, 3e-4], [0.0, 5.0, -2.0]),
]


every_load = pytest.mark.parametrize("load", ALL_LOADS, ids=lambda load: type(load).__name__)


@every_load
def test_no_force_exceeds_the_peak_value_and_some_force_reaches_it(load):
    t = np.linspace(0, 4e-4, 24).reshape(4, 6)
    assert np.array_equal(load(t), [[float(load(x)) for x in row] for row in t])
    force = np.abs(load(np.linspace(0, 0.08, 200_001)))
    assert force.max() <= load.peak_value * (1 + 1e-12)
    assert force.max() == pytest.approx(load.peak_value, rel=1e-4)


@every_load
def test_no_force_acts_outside_the_span(load):
    first, last = load.span
    t = np.linspace(-1e-4, 6e-4, 7001)
    outside = (t < first) | (t > last)
    assert not load(t[outside]).any()
    if load in IMPULSES:
        assert first == START
        assert load(np.nextafter(min(last, 1.0), 0.0) - 1e-9) != 0.0


@pytest.mark.parametrize(
    ("frequencies", "period"),
    [
        ([500.0, 1500.0], 1 / 500),
        ([6.0, 10.0, 15.0], 1.0),
        ([0.1, 0.3], 10.0),
        ([100 / 3, 50.0], 3 / 50),
        ([1000.0, 1000.1], 10.0),
        ([1.0, math.pi, 10.0], None),
        ([1.0, 1e9], None),
    ],
)
def test_common_period_is_the_least_common_multiple(frequencies, period):
    load = sj.MultiHarmonic(tuple(sj.Harmonic(1.0, f, 0.3 * f) for f in frequencies))
    if period is None:
        assert load.period is None
        return
    assert load.period == pytest.approx(period, rel=1e-12)
    t = np.linspace(0, period, 37)
    assert load(t + period) == pytest.approx(load(t), abs=1e-7)
    # No whole fraction of it is a period, so it is the shortest.
    for divisor in (2, 3, 5, 7):
        whole_turns = np.array(frequencies) * period / divisor
        assert np.abs(whole_turns - np.round(whole_turns)).max() > 1e-6


@pytest.mark.parametrize(
    ("components", "peak"),
    [
        # Crests of sin x and -sin 3x coincide at a quarter period.
        (((3.0, 10.0, 0.0), (2.0, 30.0, math.pi)), 5.0),
        # sin x + sin 2x: its slope vanishes at cos x = (sqrt(33) - 1) / 8.
        (((1.0, 10.0, 0.0), (1.0, 20.0, 0.0)), 1.7601725930461447),
        # sin x + sin 3x / 3: a flat top of 2 sqrt(2) / 3 at x = pi / 4, lower crest between.
        (((1.0, 10.0, 0.0), (1 / 3, 30.0, 0.0)), 2 * math.sqrt(2) / 3),
        # Opposite harmonics cancel.
        (((1.0, 10.0, 0.0), (1.0, 10.0, math.pi)), 0.0),
        # Not commensurate: the sum of amplitudes.
        (((1.0, 10.0, 0.0), (-2.0, 10 * math.sqrt(2), 0.0)), 3.0),
    ],
)
def test_peak_of_superposed_harmonics(components, peak):
    load = sj.MultiHarmonic(tuple(sj.Harmonic(*component) for component in components))
    assert load.peak_value == pytest.approx(peak, rel=1e-9, abs=1e-12)
    assert load.highest_frequency == max(frequency for _, frequency, _ in components)


@pytest.mark.parametrize(
    ("load", "area"),
    [
        (sj.Triangle(PEAK, RISE, START), PEAK * RISE),
        (sj.HalfSine(PEAK, RISE, START), 4 / math.pi * PEAK * RISE),
        (sj.Versine(PEAK, RISE, START), PEAK * RISE),
        (sj.Rectangle(PEAK, 2 * RISE, START), PEAK * 2 * RISE),
        (sj.RampAndHold(PEAK, RISE, START), PEAK * (1e-3 - START - RISE / 2)),
        (sj.Table([0.0, 1e-4, 3e-4], [0.0, 5.0, -2.0]), 5.0 * 0.5e-4 + 1.5 * 2e-4),
    ],
    ids=lambda value: type(value).__name__,
)
def test_impulse_has_the_area_of_its_closed_form(load, area):
    end = 1e-3
    points = sorted({*load.corners, START, START + RISE, START + 2 * RISE})
    computed, _ = quad(load, 0.0, end, points=points, epsabs=1e-12, epsrel=1e-12)
    assert computed == pytest.approx(area, rel=1e-10)


@pytest.mark.parametrize("load", IMPULSES)
def test_impulse_peaks_after_the_rise_time_and_excites_up_to_a_known_frequency(load):
    assert load(START + RISE) == pytest.approx(PEAK)
    assert (load(1.0) == PEAK) == isinstance(load, sj.RampAndHold)
    assert load.period is None
    # Section 7.4: a rise time of 4e-5 s excites up to 1 / (2 * 4e-5) Hz.
    expected = 6250.0 if isinstance(load, sj.Rectangle) else 12_500.0
    assert load.highest_frequency == pytest.approx(expected)


@every_load
def test_value_and_slope_jump_at_the_corners_and_nowhere_else(load):
    h = 1e-9
    scale = load.peak_value
    others = np.linspace(1.07e-6, 3.9e-4, 101)
    others = others[[min(abs(x - c) for c in (*load.corners, 1.0)) > 2 * h for x in others]]

    def jump(t):
        before, at, after = load(t - h), load(t), load(t + h)
        return float(abs(after - 2 * at + before)) / scale + float(
            abs(after - before) / scale > 0.1
        )

    assert all(jump(t) > 1e-6 for t in load.corners)
    assert all(jump(float(t)) < 1e-7 for t in others)


def test_table_is_linear_between_its_points_and_zero_outside():
    load = sj.Table([1.0, 2.0, 4.0, 5.0], [0.0, 10.0, -10.0, -20.0])
    assert load([0.9, 1.5, 2.0, 3.0, 4.5, 5.0, 5.1]) == pytest.approx([0, 5, 10, 0, -15, -20, 0])
    # The slope is the same on both sides of t = 4: no corner there.
    assert load.corners == (1.0, 2.0, 5.0)
    assert load.highest_frequency == 0.5
    assert load.peak_value == 20.0


@pytest.mark.parametrize(
    ("load", "jumps"),
    [
        (sj.Rectangle(2.0, 0.5, 1.0), (1.0, 1.5)),
        (sj.Rectangle(2.0, 0.5), (0.0, 0.5)),
        (sj.Rectangle(0.0, 0.5), ()),
        (sj.Table([0.0, 1.0], [0.0, 80e3]), (1.0,)),  # ends above zero
        (sj.Table([0.0, 1.0], [5.0, 0.0]), (0.0,)),
        (sj.Table([2.0, 3.0, 4.0], [-1.0, 0.0, 1.0]), (2.0, 4.0)),
        (sj.Triangle(1.0, 1e-5, 10.0), ()),
        (sj.RampAndHold(1.0, 0.5), ()),
        (sj.Harmonic(1.0, 5.0, 1.0), ()),
    ],
)
def test_jumps_are_the_corners_at_which_the_force_jumps(load, jumps):
    assert load.jumps == jumps
    assert set(jumps) <= set(load.corners)
    for t in jumps:
        near = load([np.nextafter(t, -1.0), t, np.nextafter(t, 100.0)])
        assert np.ptp(near) >= 0.5 * float(load.peak_value or 0.0)


@pytest.mark.parametrize(
    "function",
    [
        lambda t: 3.0 * np.sin(t),
        lambda t: 3.0 * math.sin(t),
        lambda t: 3.0 if t < 1.0 else 0.0,
        lambda t: 5,
        lambda t: np.array([t**2]),
    ],
)
def test_a_plain_function_of_time_is_a_force(function):
    load = as_amplitude(function)
    t = np.linspace(0.0, 2.0, 6).reshape(2, 3)
    assert load(t) == pytest.approx(
        np.array([[float(np.squeeze(function(x))) for x in row] for row in t])
    )
    assert float(load(0.5)) == pytest.approx(float(np.squeeze(function(0.5))))
    assert load(t[:, :0]).shape == (2, 0)
    assert (load.period, load.corners, load.jumps) == (None, (), ())
    assert (load.peak_value, load.highest_frequency) == (None, None)
    assert common_period([load, sj.Harmonic(1.0, 4.0)]) == 0.25


@pytest.mark.parametrize(
    ("make", "names"),
    [
        (lambda: sj.Harmonic(math.nan, -5.0, math.inf), ["amplitude", "frequency", "phase"]),
        (lambda: sj.MultiHarmonic(()), ["components"]),
        (lambda: sj.SweptSine(1.0, 0.0, 2.0, -1.0), ["first_frequency", "rate"]),
        (lambda: sj.SweptSine(1.0, 2.0, 2.0, 1.0), ["last_frequency"]),
        (lambda: sj.Triangle(1.0, 0.0, -1.0), ["rise_time", "start"]),
        (lambda: sj.Versine(math.inf, 1.0), ["peak"]),
        (lambda: sj.Table([0.0, 0.0, 1.0], [0.0, 1.0, math.nan]), ["times[1]", "forces[2]"]),
        (lambda: sj.Table([0.0, 2.0, 1.0], [0.0, 1.0, 2.0]), ["times[2]"]),
        (lambda: sj.Table([0.0], [0.0]), ["times"]),
        (lambda: sj.Table([0.0, 1.0], [0.0]), ["times"]),
    ],
)
def test_arguments_out_of_range_are_refused_by_name(make, names):
    with pytest.raises(sj.InputError) as caught:
        make()
    refused = {problem.split(":")[0] for problem in caught.value.problems}
    assert set(names) == refused


@pytest.mark.parametrize(("first", "last"), [(10.0, 80.0), (80.0, 10.0)])
def test_the_frequency_of_a_swept_sine_changes_by_octaves_at_its_rate(first, last):
    """Three octaves at ninety a minute take two seconds; zeros lie where whole halves have passed.

    In each half of a second the number of periods is the integral of the frequency.
    """
    load = sj.SweptSine(2.0, first, last, 90.0)
    assert load.span == pytest.approx((0.0, 2.0))
    assert (load.peak_value, load.highest_frequency, load.period) == (2.0, 80.0, None)
    t = np.linspace(0.0, 2.0, 200_001)
    crossings = t[1:][np.diff(np.signbit(load(t))) != 0]
    growth = np.log(last / first) / 2.0
    for begin, end in ((0.0, 0.5), (0.5, 1.0), (1.5, 2.0)):
        count = np.count_nonzero((crossings > begin) & (crossings <= end)) / 2.0
        exact = first * (np.exp(growth * end) - np.exp(growth * begin)) / growth
        assert count == pytest.approx(exact, abs=1.0)
    assert load(2.0 + 1e-9) == load(-1e-9) == 0.0


def test_a_step_must_follow_the_fastest_period_of_a_swept_sine():
    system = sj.System(
        M=np.eye(1), C=None, K=np.eye(1) * 1e4,
        loads=(sj.AppliedLoad(np.ones(1), sj.SweptSine(1.0, 5.0, 50.0, 600.0), "mass"),),
    )  # fmt: skip
    sj.integrate(system, step=0.0024, duration=0.3)
    with pytest.raises(sj.InputError, match="1/8 of its fastest period"):
        sj.integrate(system, step=0.0026, duration=0.3)


def test_a_function_is_asked_for_all_times_at_once_and_its_mistakes_are_not_hidden():
    calls = []

    def force(t):
        calls.append(np.shape(t))
        t *= 2.0  # what it does with its times is its own affair
        return t

    times = np.arange(5.0)
    assert Function(force)(times).tolist() == [0.0, 2.0, 4.0, 6.0, 8.0]
    assert times.tolist() == [0.0, 1.0, 2.0, 3.0, 4.0]
    assert calls == [(5,)]
    with pytest.raises(ZeroDivisionError):
        as_amplitude(lambda t: 1 / 0)([0.0, 1.0])


@pytest.mark.parametrize("result", [None, "5", [1.0, 2.0, 3.0], 1j, math.nan, math.inf])
def test_a_function_that_gives_no_number_is_refused(result):
    def wrong(t):
        return result if np.ndim(t) or t > 0.5 else 0.0

    load = as_amplitude(wrong)
    assert load(0.0) == 0.0
    for t in (1.0, [0.0, 1.0]):
        with pytest.raises(sj.InputError, match=r"'wrong' gives no finite number at t = 1 s"):
            load(t)


def test_shapes_pass_also_of_ones_own_and_everything_else_is_refused():
    class Step(Amplitude):
        def _force(self, t):
            return np.where(t < 1.0, 0.0, 2.0)

    for load in (*ALL_LOADS, Step()):
        assert as_amplitude(load) is load
    assert Step()([0.5, 1.5]).tolist() == [0.0, 2.0]
    assert (Step().period, Step().peak_value) == (None, None)
    for shape in (5.0, "sin", None, [1.0], sj.Harmonic):
        with pytest.raises(sj.InputError, match=r"load: found .*Harmonic\(amplitude, frequency\)"):
            as_amplitude(shape)


def test_table_is_read_with_header_comments_and_empty_lines(tmp_path):
    path = tmp_path / "force.csv"
    path.write_text("\ufeff# measured\ntime, force\n\n0, 0\n1e-4, 5.5 # peak\n3e-4,-2\n")
    load = read_table(path)
    assert load.times.tolist() == [0, 1e-4, 3e-4]
    assert load.forces.tolist() == [0, 5.5, -2]


def test_units_in_the_header_of_a_table_count(tmp_path):
    path = tmp_path / "force.csv"
    for head in (
        "time (ms),force (kN)", "Time [ms];Force [kN]", "ms,kN", "time,force\nms,kN",
        "# run (3)\n# time (ms), force (kN)", "time,force\n# ms,kN",
        "# time (ms), force (kN)\n# from the laboratory", "# ms, kN\n# time, force",
        "# t = 25 C, f = 3\n# ms, kN", "ms,kN\n# f: 3 Hz, t: -2 s",
    ):  # fmt: skip
        path.write_text(f"{head}\n" + "0,0\n2,5\n".replace(",", ";" if ";" in head else ","))
        load = read_table(path)
        np.testing.assert_allclose(load.times, [0.0, 2e-3])
        np.testing.assert_allclose(load.forces, [0.0, 5e3])
    path.write_text("time (s),pressure (MPa)\n0,0\n1,2\n", encoding="utf-8")
    assert read_table(path, "pressure").forces.tolist() == [0.0, 2e6]
    with pytest.raises(
        sj.InputError, match=r"column 'pressure \(MPa\)': must be one of time, t, f"
    ):
        read_table(path)


@pytest.mark.parametrize(
    ("content", "wrong"),
    [
        (b"force (N),time (s)\n0,0\n1,2\n", ["line 1: found column 'force', must be time or t"]),
        (b"# force (N), time (s)\n0,0\n1,2\n", ["line 1: found column 'force', must be time"]),
        (b"# t [ms]  F [kN]\n0,0\n1,2\n", ["line 1: found 't [ms]  F [kN]', a comment with"]),
        (b"# time (min), force (lbf)\n0,0\n1,2\n", ["line 1: column 'time (min)'", "(lbf)'"]),
        (b"# time in ms, force in kN\n0,0\n1,2\n", ["column 'time in ms'", "force in kN'"]),
        (
            b"# t 25 C, f = 3\n0,0\n1,2\n",
            ["if it is a remark, write 'name = value", "f = 3'"],
        ),
        (b"# t = 2 (ms), f = 3 (kN)\n0,0\n1,2\n", ["a comment with units in brackets"]),
        (b"# t/ms, F/kN\n0,0\n1,2\n", ["column 't/ms'", "F/kN'"]),
        (b"# Zeit ms, Kraft kN\n0,0\n1,2\n", ["column 'Zeit ms'", "Kraft kN'"]),
        (b"time (h),force (N)\n0,0\n1,2\n", ["line 1: column 'time (h)': found unit 'h'"]),
        (b"time,mass\n0,0\n1,2\n", ["line 1: column 'mass': must be one of time"]),
        (b"0,0\n1,2,3\n2,1\n", ["line 2"]),
        (b"0,0\n1;2\n3,4\n", ["line 2"]),
        (b"t,f\n0,0\nx,y\n", ["line 3"]),
        (b"0,force\n1,1\n2,2\n", ["line 1"]),
        (b"0,0\n1,a\n2,nan\n1.5,0\n1.5,0\n", ["line 2", "line 3", "line 5"]),
        (b"0,0\n# note\n0,1\n", ["line 3"]),
        (b"0,0\n", ["found 1"]),
        (b"", ["found 0"]),
        (b"0,0\n1,\xff\n", ["line 2"]),
        (b"a\n" * 1000, [*(f"line {k}" for k in range(1, 11)), "990 more"]),
    ],
)
def test_every_bad_line_of_a_table_is_named_but_a_long_list_is_cut(tmp_path, content, wrong):
    path = tmp_path / "force.csv"
    path.write_bytes(content)
    with pytest.raises(sj.InputError, match=r"force\.csv") as caught:
        read_table(path)
    assert len(caught.value.problems) == len(wrong)
    assert all(word in line for line, word in zip(caught.value.problems, wrong, strict=True))
