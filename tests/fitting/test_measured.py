"""Measured curves: units and quantities, heads and arguments, refusals, decays of known law."""

import re

import numpy as np
import pytest
from test_damping_curve import LAWS, decaying

import skfem_joint as sj

ROWS = {"frequency": [400.0, 398.0, 395.0], "damping": [0.002, 0.003, 0.006]}
DATA = {"amplitude (mm)": [1.0, 2.0, 3.0], **ROWS}
SHARES = {"relative_frequency_deviation": 1e-4, "relative_damping_deviation": 0.05}
GOOD = "amplitude (mm), frequency (Hz), damping (%)\n1,400,0.2\n2,398,0.3\n4,395,0.6\n"


def written(tmp_path, text, name="lap.csv"):
    path = tmp_path / name
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def refused(source, *words, **given):
    """Sentences of a refusal, each of which has its words."""
    with pytest.raises(sj.InputError) as caught:
        sj.measured_curve(source, **given)
    problems = caught.value.problems
    assert len(problems) == len(words), problems
    for problem, word in zip(problems, words, strict=True):
        assert word in problem
    return problems


def test_a_file_says_all_that_a_fit_needs(tmp_path):
    text = """# Beam with a bolted lap, 12 Nm
# Operator A. N. Other
# Point: tip
# direction: 0, 3, 4
# unit: m/s2   # of the sensor
# mode: 2
# offset: frequency
# peak_to_peak: true
# lowest: 0.5
# highest: 10
amplitude (m/s²), frequency (Hz), damping (%), damping_deviation (%)
1.3, 401.6, 0.26, 0.01
0.4, 402.1, 0.21, 0.02
4.2, 399.8, ,   # too short
12, 395, 0.8, 0.03
,,,
"""
    curve = sj.measured_curve(written(tmp_path, text))
    assert isinstance(curve, sj.MeasuredCurve)
    assert (curve.name, curve.point, curve.mode, curve.quantity, curve.offset) == (
        "lap.csv", "tip", 2, "acceleration", ("frequency",),
    )  # fmt: skip
    assert curve.direction == pytest.approx([0.0, 0.6, 0.8], rel=1e-15)
    assert curve.amplitude == pytest.approx([0.2, 0.65, 2.1, 6.0], rel=1e-15)
    assert curve.frequency.tolist() == [402.1, 401.6, 399.8, 395.0]
    nan = np.nan
    assert curve.damping == pytest.approx([0.0021, 0.0026, nan, 0.008], rel=1e-15, nan_ok=True)
    assert curve.damping_deviation == pytest.approx([2e-4, 1e-4, nan, 3e-4], nan_ok=True)
    assert curve.frequency_deviation == pytest.approx(1e-4 * curve.frequency)
    assert curve.fitted.tolist() == [False, True, True, False]  # in the data's own unit
    omega = 2.0 * np.pi * curve.frequency
    assert curve.displacement == pytest.approx(curve.amplitude / omega**2, rel=1e-14)
    (assumed,) = curve.notes
    assert "deviations of the frequency of 4 samples are not given; 0.01 % of each" in assumed


@pytest.mark.parametrize(
    ("unit", "quantity", "factor"),
    [
        ("m", "displacement", 1.0), ("cm", "displacement", 1e-2), ("mm", "displacement", 1e-3),
        ("um", "displacement", 1e-6), ("µm", "displacement", 1e-6), ("μm", "displacement", 1e-6),
        ("nm", "displacement", 1e-9), ("m/s", "velocity", 1.0), ("mm/s", "velocity", 1e-3),
        ("um/s", "velocity", 1e-6), ("m/s2", "acceleration", 1.0), ("m/s^2", "acceleration", 1.0),
        ("m/s²", "acceleration", 1.0), ("m / s**2", "acceleration", 1.0),
        ("mm/s2", "acceleration", 1e-3), ("g", "acceleration", 9.80665),
    ],
)  # fmt: skip
@pytest.mark.parametrize(
    "name", ["amplitude (UNIT)", "Amplitude [UNIT]", "AMPLITUDE (UNIT)", "unit"]
)
def test_units_and_quantities_become_displacements(unit, quantity, factor, name):
    raw, by_unit = np.array([1.0, 2.0, 5.0]), {"unit": unit} if name == "unit" else {}
    name = "amplitude" if by_unit else name.replace("UNIT", unit.replace(" ", ""))
    curve = sj.measured_curve({name: raw, **ROWS}, **by_unit, **SHARES, offset=())
    order = ["displacement", "velocity", "acceleration"].index(quantity)
    assert curve.quantity == quantity
    assert curve.amplitude == pytest.approx(factor * raw, rel=1e-15)
    omega = 2.0 * np.pi * np.array(ROWS["frequency"])
    assert curve.displacement == pytest.approx(factor * raw / omega**order, rel=1e-14)
    assert curve.notes == ()


@pytest.mark.parametrize(
    "columns",
    [
        {"frequency (kHz)": 0.4, "damping (%)": 0.2},
        {"Frequency (rad/s)": 800.0 * np.pi, "Damping (1)": 0.002},
        {"frequency []": 400.0, "damping": 0.002},
    ],
)
def test_units_of_frequency_and_damping(columns):
    arrays = {name: np.full(3, value) for name, value in columns.items()}
    curve = sj.measured_curve({"amplitude (m/s2)": [1.0, 2.0, 3.0]} | arrays)
    assert curve.frequency == pytest.approx(np.full(3, 400.0), rel=1e-14)
    assert curve.damping == pytest.approx(np.full(3, 0.002), rel=1e-14)
    for note, name in zip(curve.notes, ("frequency", "damping"), strict=True):
        assert f"deviations of the {name}" in note


def test_arguments_win_over_the_head(tmp_path):
    head = "# point: tip\n# mode: 3\n# offset: damping\n# highest: 1.5\n# peak_to_peak: true\n"
    path = written(tmp_path, head + "# relative_damping_deviation: 2 %\n" + GOOD)
    curve = sj.measured_curve(path)
    assert (curve.point, curve.mode, curve.offset) == ("tip", 3, ("damping",))
    assert curve.fitted.tolist() == [True, False, False]
    assert curve.damping_deviation == pytest.approx(0.02 * curve.damping)
    given = {"point": "end.y", "mode": 1, "offset": "none", "highest": 3.0, "lowest": "1.5"}
    given |= {"peak_to_peak": False, "relative_damping_deviation": 0.1, "name": "first"}
    other = sj.measured_curve(str(path), **given, direction=None)
    assert (other.point, other.mode, other.offset, other.name) == ("end.y", 1, (), "first")
    assert other.fitted.tolist() == [False, True, False]
    assert other.amplitude.tolist() == (2.0 * curve.amplitude).tolist()
    assert other.damping_deviation == pytest.approx(0.1 * curve.damping)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("# amplitudes are RMS\namplitude (mm), damping (%)", "line 1 says 'amplitudes are RMS'"),
        ("# p-p values of a shaker\namplitude (mm), damping (%)", "taken as half of peak to peak"),
        ("# with 2 bolts\namplitude (mm), damping", "up to 0.7, a ratio, .* is it in percent"),
        ("# with 2 bolts\namplitude (mm), damping (1)", None),
        ("# with 2 bolts\namplitude (mm), damping (%)", None),
        ("# half of peak to peak\namplitude (mm), damping (%)", None),
    ],
)
def test_what_is_probably_meant_otherwise_is_said(tmp_path, text, words):
    file = written(tmp_path, f"{text}\n1,0.5\n2,0.6\n3,0.7\n")
    notes = [note for note in sj.measured_curve(file).notes if "standard deviations" not in note]
    assert len(notes) == (words is not None)
    assert words is None or re.search(words, notes[0])


@pytest.mark.parametrize("line", ["# peak_to_peak", "# peak-to-peak = yes please", "# Mode = two"])
def test_a_remark_that_is_a_key_is_no_remark(tmp_path, line):
    file = written(tmp_path, f"{line}\namplitude (mm), damping (%)\n1,0.5\n2,0.6\n3,0.7\n")
    with pytest.raises(sj.InputError, match=r"line 1: (peak_to_peak|mode): found"):
        sj.measured_curve(file)


def test_deviations_of_columns_stand_where_they_are_and_shares_elsewhere():
    own = [2e-4, np.nan, 3e-4]
    data = {"amplitude (m)": [1.0, 2.0, 3.0], **ROWS, "damping_deviation": own}
    curve = sj.measured_curve(data)
    assert curve.damping_deviation == pytest.approx([2e-4, 0.05 * 0.003, 3e-4])
    assert "of the damping of 1 samples are not given; 5 % of each" in curve.notes[1]
    replaced = sj.measured_curve(data, relative_damping_deviation=0.1)
    assert replaced.damping_deviation == pytest.approx(0.1 * replaced.damping)


def test_what_was_not_measured_is_nan_and_lies_between_neighbours():
    """Halfway of the logarithm of the amplitude is the mean of the frequencies there."""
    frequency = [400.0, np.nan, 390.0, 394.0]
    data = {"amplitude (m/s)": [1.0, 2.0, 4.0, 4.0], "frequency": frequency, "damping": 4 * [0.01]}
    curve = sj.measured_curve(data, **SHARES)
    assert np.isnan(curve.frequency_deviation).tolist() == [False, True, False, False]
    used = np.array([400.0, 396.0, 390.0, 394.0])
    assert curve.displacement == pytest.approx(curve.amplitude / (2.0 * np.pi * used), rel=1e-14)
    (lacking,) = curve.notes
    assert "1 samples have no frequency" in lacking
    alone = sj.measured_curve({"amplitude (mm)": [1.0, 2.0, 3.0], "damping": ROWS["damping"]})
    assert np.isnan(alone.frequency).all()
    assert alone.displacement == pytest.approx([1e-3, 2e-3, 3e-3])


@pytest.mark.parametrize("separator", [",", ";", "\t"])
@pytest.mark.parametrize("end", ["\n", "\r\n", "\r"])
@pytest.mark.parametrize("mark", ["", "\ufeff"])
def test_a_curve_is_read_as_it_was_written(tmp_path, separator, end, mark):
    """Every bit of the numbers, whatever editor and country the file is from."""
    rng = np.random.default_rng(3)
    amplitude, damping = np.sort(rng.uniform(0.1, 9.0, 20)), rng.uniform(0.001, 0.02, 20)
    frequency, deviation = rng.uniform(380.0, 400.0, 20), rng.uniform(0.1, 0.2, 20)
    columns = np.stack([amplitude, frequency, damping, deviation], axis=1)
    lines = [separator.join(map(repr, row)) for row in columns.tolist()]
    rng.shuffle(lines)
    names = separator.join(["amplitude", "frequency", "damping", "frequency_deviation"])
    text = mark + end.join(["# unit: m", names, *lines, ""])
    curve = sj.measured_curve(written(tmp_path, text))
    assert np.array_equal(curve.amplitude, amplitude)
    assert np.array_equal(curve.frequency, frequency)
    assert np.array_equal(curve.damping, damping)
    assert np.array_equal(curve.frequency_deviation, deviation)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("4,395", "4,39x5", ["lap.csv: line 4: frequency: found '39x5', must be a number"]),
        ("4,395", ",395", ["line 4: amplitude: found '', must be a number"]),
        ("4,395", "nan,395", ["line 4: amplitude: found nan, must be > 0, from 1e-20 to"]),
        ("4,395", "4,1e-30", ["found 1e-30, must be > 0, from 1e-20 to 1e+20, or empty where it"]),
        ("0.6", "600", ["line 4: damping: found 600, must be >= 0 and below 100, a %, or empty"]),
        ("0.6", "0", ["line 4: damping: found 0, whose standard deviation cannot be a share"]),
        ("1,400,0.2", "-1,0,2", ["line 2: amplitude: found -1", "line 2: frequency: found 0"]),
        ("4,395,0.6", "4,,", ["line 4: found neither a frequency nor a damping"]),
        ("4,395,0.6", "4,395", ["line 4: found 2 columns, must be 3"]),
        ("4,395,0.6", "", ["lap.csv: found 2 rows of values, must be at least 3"]),
        ("amplitude (mm), frequency (Hz), damping (%)\n", "",
         ["line 1: found '1,400,0.2', must be the names of the columns, as in 'amplitude (mm)"]),
        ("(mm)", "", ["found no unit of the amplitude, must be one unit, in the name of"]),
        ("(mm)", "(inch)", ["column 'amplitude (inch)': found unit 'inch', must be one of m, cm"]),
        (" (mm)", "_mm", ["line 1: column 'amplitude_mm': must be one of amplitude, frequency"]),
        ("(Hz)", "(V)", ["found unit 'V', must be one of Hz, kHz, rad/s"]),
        ("frequency (Hz)", "amplitude", ["line 1: found column 'amplitude' again, must be once"]),
        ("damping (%)", "damping_deviation", ["found column 'damping_deviation' and no 'damping'"]),
        ("amplitude (mm), ", "time, ", ["found columns time, frequency, damping; must be ampl"]),
        ("amplitude", "# Operator: A. N. Other\namplitude",
         ["line 1: operator: unknown key; allowed: name, point"]),
        ("amplitude", "# point: a\n# point: b\namplitude", ["line 2: found 'point' again"]),
        ("amplitude", "# unit: m\namplitude", ["found m and mm of the amplitude, must be"]),
        ("amplitude", "# direction: up\n# mode: 0\n# mode2\n# point:\namplitude",
         ["line 4: point: found '', must not be empty",
          "line 1: direction: found 'up', must be x, y, z, or up to three",
          "line 2: mode: found '0', must be >= 1"]),
        ("amplitude", "# direction: 0, 0, 0\namplitude", ["finite numbers not all 0"]),
        ("amplitude", "# peak_to_peak: both\namplitude", ["found 'both', must be true or false"]),
        ("amplitude", "# offset: phase\namplitude", ["offset[0]: found 'phase', must be 'freq"]),
        ("amplitude", "# lowest: a\namplitude", ["lowest: found 'a', must be a number"]),
        ("amplitude", "# lowest: 5\n# highest: 1\namplitude", ["from 5 to 1, must rise"]),
        ("amplitude", "# lowest: 5\namplitude", ["no amplitude in the range that is fitted"]),
        ("amplitude", "# frequency: 400\namplitude", ["found key 'frequency', which is about"]),
        ("amplitude", "# relative_damping_deviation: 5\namplitude",
         ["found '5', must be <= 1 (share of the values, or percent, as in 5 %)"]),
    ],
)  # fmt: skip
def test_what_is_wrong_is_refused_with_its_place(tmp_path, old, new, words):
    refused(written(tmp_path, GOOD.replace(old, new, 1)), *words)


@pytest.mark.parametrize(
    ("content", "word"),
    [
        (b"", "found no columns, must begin with their names, as in 'amplitude (mm)"),
        (b"# nothing\n\n", "found no columns"),
        (b"PK\x03\x04\x00\x00" * 9, "holds no text"),
        (b"amplitude\n\xb2\n", "line 2: not UTF-8 text; save it as UTF-8"),
        (b"amplitude (m);damping\n", "found 0 rows of values, must be at least 3"),
        (b"amplitude (m), a;b\n", "line 1: found ',' and ';' between columns, must be one of"),
        (b"amplitude (m);damping\n0,1;0,5\n", "found '0,1', must be a number; decimals have a"),
        (
            b"amplitude (mm), damping, damping_deviation (%)\n" + 3 * b"1,0.1,1\n",
            "column 'damping_deviation': found unit '%', must be that of damping, '1'",
        ),
        (
            b"# relative_damping_deviation: 0.1\namplitude (mm), damping, damping_deviation\n",
            "both column 'damping_deviation' and key 'relative_damping_deviation', must be one",
        ),
    ],
)
def test_files_that_are_no_tables_are_refused(tmp_path, content, word):
    with pytest.raises(sj.InputError, match=re.escape(word)) as caught:
        sj.measured_curve(written(tmp_path, content))
    assert "lap.csv" in str(caught.value)


def test_files_that_are_not_there_are_refused(tmp_path):
    refused(tmp_path, "cannot be read: not a file")
    refused(tmp_path / "none.csv", "cannot be read: No such file")


def test_many_wrong_lines_are_counted(tmp_path):
    bad = "amplitude (mm),damping\n" + "x,0.1\n" * 50
    problems = refused(written(tmp_path, bad), *(f"line {k}:" for k in range(2, 12)), "40 more")
    assert problems[0] == f"{tmp_path / 'lap.csv'}: line 2: amplitude: found 'x', must be a number"
    data = {"amplitude (mm)": -np.ones(50), "damping": np.full(50, 0.1)}
    refused(data, *(f"data: sample {k}: amplitude: found -1" for k in range(10)), "40 more")


@pytest.mark.parametrize(
    ("given", "word"),
    [
        ({"points": "tip"}, "points: unknown key; did you mean 'point'?"),
        ({"mode": True}, "measured_curve: mode: found 'True', must be a whole number"),
        ({"lowest": -1.0}, "lowest: found '-1.0', must be >= 0"),
        ({"direction": [1.0, np.nan]}, "direction: found '1.0, nan', must be x, y, z"),
        ({"frequency": 0.0}, "frequency: found '0.0', must be > 0"),
        ({"unit": 1.0}, "unit: found '1.0', must be one of m"),
        ({"offset": 1}, "offset[0]: found '1', must be 'frequency' or"),
    ],
)
def test_wrong_arguments_are_refused_by_name(given, word):
    refused(DATA, word, **given)


@pytest.mark.parametrize(
    ("data", "word"),
    [
        (DATA | {"damping": [0.1, 0.2]}, "data: damping: found shape (2,), must be (3,)"),
        (DATA | {"damping": [[0.1, 0.2]]}, "must be of one shape (k,)"),
        (DATA | {"damping": ["a", "b", "c"]}, "damping: found <U1 values, must be real numbers"),
        (DATA | {"damping": [0.1, 0.2, 3.0]}, "must be >= 0 and below 1, a ratio, or empty"),
        (3.0, "found a float as the source, must be the path of a file, a mapping"),
        (
            {"amplitude (g)": [1.0, 2.0, 3.0], "damping": ROWS["damping"]},
            "found amplitudes of acceleration and no frequency, by which they become displ",
        ),
        (DATA | {"run": [1, 2, 3]}, "data: column 'run': must be one of amplitude, frequency"),
    ],
)
def test_wrong_arrays_are_refused(data, word):
    refused(data, word)


NAMES = ["base.x", "base.y", "tip.x", "tip.y"]


@pytest.mark.parametrize(
    ("given", "names", "expected"),
    [
        ({}, ["end"], [1.0]),
        ({"point": "end", "direction": "x"}, ["start", "end"], [0.0, 1.0]),
        ({"point": "tip.y"}, NAMES, [0.0, 0.0, 0.0, 1.0]),
        ({"point": "tip", "direction": "y"}, NAMES, [0.0, 0.0, 0.0, 1.0]),
        ({"point": "tip", "direction": "[1, 1]"}, NAMES, [0.0, 0.0, 0.5**0.5, 0.5**0.5]),
        ({"point": "tip", "direction": (0.0, -2.0)}, NAMES, [0.0, 0.0, 0.0, -1.0]),
    ],
)
def test_points_and_directions_are_rows_of_a_system(given, names, expected):
    assert sj.measured_curve(DATA, **given).weights(names) == pytest.approx(expected, rel=1e-15)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({}, "data: point: not given, must be one of base.x, base.y, tip.x, tip.y"),
        ({"point": "tpi.x"}, "found 'tpi.x', must be one of .*; did you mean 'tip.x'"),
        ({"point": "tip"}, "found 'tip' without a direction; give direction, such as x, or one of"),
        ({"point": "tip", "direction": "z"}, "components as the system has there, tip.x, tip.y"),
        ({"point": "tip.x", "direction": "y"}, "components as the system has there, tip.x"),
    ],
)
def test_points_that_the_system_does_not_have_are_refused(given, words):
    with pytest.raises(sj.InputError, match=words):
        sj.measured_curve(DATA, **given).weights(NAMES)


@pytest.mark.parametrize(("unit", "factor"), [("um", 1e-6), ("mm/s", 1e-3), ("g", 9.80665)])
def test_a_decay_becomes_the_curve_of_its_law(tmp_path, unit, factor):
    """Few samples, which differ from the law as their standard deviations say.

    Frequency and damping of this law hardly change in a period, so that the amplitude of a
    derivative is that of the displacement times a power of the frequency.
    """
    damping, frequency, _ = LAWS["joint"]
    t, amplitude, phase = decaying("joint", 2.0)
    order = {"um": 0, "mm/s": 1, "g": 2}[unit]
    omega = 2.0 * np.pi * frequency(amplitude)
    size = amplitude * (omega / (2.0 * np.pi * 80.0)) ** order  # near 1 at first
    signal = size * np.cos(phase) + 0.01 * np.random.default_rng(4).normal(size=t.size)
    rows = np.char.mod("%.10g", np.stack([1e3 * t, signal], axis=1))
    lines = [f"time (ms); signal ({unit})", *map(";".join, rows.tolist()), ""]
    path = written(tmp_path, "# point: tip\n# frequency: 80\n# lowest: 0.2\n" + "\n".join(lines))
    curve = sj.measured_curve(path)
    assert 3 <= curve.amplitude.size < 25
    assert f"gives {curve.amplitude.size} samples of the curve" in curve.notes[0]
    assert curve.fitted.tolist() == (curve.amplitude >= 0.2 * factor).tolist()
    a = np.interp(curve.amplitude / factor, size[::-1], amplitude[::-1])
    true = factor * a / (2.0 * np.pi * 80.0) ** order
    assert curve.displacement == pytest.approx(true, rel=0.01)
    for found, deviation, law in (
        (curve.frequency, curve.frequency_deviation, frequency(a)),
        (curve.damping, curve.damping_deviation, damping(a)),
    ):
        # The law of the damping, at a given amplitude, within four standard deviations.
        assert np.all(np.abs(found - law) < 4.0 * deviation + 2e-3 * law)
    of_arrays = sj.measured_curve(
        sj.damping_curve(t, signal, 80.0, curve.quantity), unit=unit, lowest=0.2
    )
    assert of_arrays.displacement == pytest.approx(curve.displacement, rel=1e-6)
    assert of_arrays.damping == pytest.approx(curve.damping, rel=1e-4)
    wide = sj.measured_curve(path, relative_damping_deviation=0.1)
    assert wide.damping_deviation == pytest.approx(0.1 * curve.damping)


def test_what_is_wrong_with_a_decay_is_refused(tmp_path):
    t = np.arange(2000) / 2000.0
    decay = {"time": t, "signal (mm)": np.exp(-2.0 * t) * np.cos(500.0 * t)}
    found = sj.measured_curve(decay).damping
    assert found == pytest.approx(np.full(found.size, 0.004), rel=1e-3)
    refused(decay, "found peak_to_peak beside a signal over time", peak_to_peak=True)
    refused(decay | {"time": t**2}, "data: damping_curve: times must rise by even steps")
    refused(
        decay | {"signal (mm)": decay["signal (mm)"][::-1]}, "does not decay; give the part after"
    )
    refused({"time": t, "signal": decay["signal (mm)"]}, "found no unit of the signal, must be one")
    refused(decay | {"damping": t}, "or both, or time and signal, as in")
    text = "time,signal (mm)\n0,1\n0.1,\n0.2,nan\n"
    refused(written(tmp_path, text), "line 3: signal: found '', must be a number")
