"""Swept sines: Duhamel's integral, the shift of a linear peak, and the steady limit."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import skfem_joint as sj
from skfem_joint.output.damping import write_response
from skfem_joint.study.scene_response import response_table, scene_response

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
OMEGA, RATIO = np.sqrt(5e4), 0.02
SIGMA = RATIO * OMEGA


def oscillator(force: float) -> sj.System:
    """Mass of 1 kg on a spring, and beside it a slider with a spring in series; force on it."""
    contact = sj.Contact(np.ones((1, 1)), np.ones(1), np.array([np.inf]), stiffness=[1e4])
    return sj.System(
        M=np.eye(1),
        C=np.array([[2.0 * SIGMA]]),
        K=np.array([[4e4]]),
        contact=contact,
        loads=(sj.AppliedLoad(np.ones(1), sj.Harmonic(force, 10.0), "mass"),),
        P=np.eye(1),
        points=("mass",),
    )


def test_a_scene_has_swept_sines_beside_its_response(tmp_path):
    scene = sj.load_scene(EXAMPLES / "structure_harmonic.toml").changed(
        mesh=sj.build_bar([("joint", 0.1, 8), ("l", 0.5, 10)], {"fixed": 0.0, "free_end": 0.6}),
        load={"amplitude": 1e3},
        models={"run": ["full"]},
        accuracy={"estimate": False},
        time={"steps_per_cycle": 80},
        output={"points": ["free_end"]},
        response={
            "frequencies": {"from": 2200.0, "to": 2800.0, "points": 5},
            "sweep_rates": [60.0],
        },
    )
    found = scene_response(scene)
    write_response(tmp_path, found)
    rows = np.genfromtxt(tmp_path / "swept.csv", delimiter=",", names=True, dtype=None)
    up = rows[rows["octaves_per_minute"] > 0.0]
    sweep, other = found.models[0].sweeps
    assert (sweep.rate, other.rate) == (60.0, -60.0)
    np.testing.assert_allclose(up["amplitude_free_end_m"], sweep.amplitude[:, 0], rtol=1e-8)
    content = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))
    (level,) = content["models"]["full"]["levels"]
    assert [each["octaves_per_minute"] for each in level["sweeps"]] == [60.0, -60.0]
    assert level["sweeps"][0]["peak_amplitude_m"] == sweep.peak[1]
    assert "swept at +60 octaves a minute: largest" in content["told"][1]
    assert "from rest, at 60 octaves a minute." in content["premises"]["assumptions"][-1]
    with pytest.raises(sj.InputError, match=r"sweep_rates: found 60.* more than once"):
        scene.changed(response={"sweep_rates": [60.0, 60.0]})
    one = {"frequencies": {"from": 2200.0, "to": 2200.0, "points": 1}}
    with pytest.raises(sj.InputError, match="last_frequency: found 2200, must differ"):
        response_table(scene.changed(response=one))


def rate_of(growth: float) -> float:
    """Octaves per minute at which the angular frequency grows by so much, rad/s², at resonance."""
    return float(60.0 / np.log(2.0) * growth / OMEGA)


@pytest.mark.parametrize("ends", [(25.0, 50.0), (50.0, 25.0)])
def test_a_fast_sweep_has_the_largest_values_of_duhamels_integral(ends):
    sweep = sj.SweptSine(1e-6, *ends, rate_of(2.0 * SIGMA**2))
    found = sj.swept_response(oscillator(1e-6), ends, sweep.rate)
    t = np.linspace(0.0, sweep.span[1], 400001)
    pole = -SIGMA + 1j * np.sqrt(OMEGA**2 - SIGMA**2)
    forced = sweep(t) * np.exp(-pole * t)
    sums = np.append(0.0, np.cumsum(0.5 * (forced[1:] + forced[:-1]))) * t[1]
    exact = (np.exp(pole * t) * sums).imag / pole.imag
    largest = np.abs(exact).argmax()
    frequency, amplitude = found.peak
    assert amplitude == pytest.approx(abs(exact[largest]), rel=0.02)
    growth = np.log(2.0) / 60.0 * sweep.rate * np.sign(ends[1] - ends[0])
    assert frequency == pytest.approx(ends[0] * np.exp(growth * t[largest]), rel=0.015)


def test_the_peak_of_a_linear_mode_comes_later_by_two_growths_over_its_decay():
    peaks = []
    growth = 0.04 * SIGMA**2
    for ends in ((28.0, 45.0), (45.0, 28.0)):
        found = sj.swept_response(oscillator(1e-6), ends, rate_of(growth), steps_per_cycle=60)
        apart, values = found.frequency - found.peak[0], found.amplitude[:, 0]
        near = np.abs(apart) < 0.3 * SIGMA / (2.0 * np.pi)
        fitted = np.polynomial.Polynomial.fit(apart[near], values[near], 4)
        fine = np.linspace(*fitted.domain, 10001)
        peaks.append(found.peak[0] + fine[fitted(fine).argmax()])
    shift = 2.0 * growth / SIGMA / (2.0 * np.pi)
    assert 0.5 * (peaks[0] - peaks[1]) == pytest.approx(shift, rel=0.03)


def test_a_slow_sweep_has_the_steady_amplitudes_and_a_fast_one_lower_later_ones():
    """Where the slider slips, whose damping of some 10 % is that of half of the force."""
    system = oscillator(0.5)
    (steady,) = sj.response(system, np.linspace(30.0, 40.0, 21), estimated=False)
    slow = sj.swept_response(system, (25.0, 45.0), 1.0, steps_per_cycle=100)
    assert slow.peak[1] == pytest.approx(steady.peak[1], rel=5e-3)
    inside = slice(1, -1)
    f, values = steady.column("frequency")[inside], steady.column("amplitude")[inside, 0]
    at = np.interp(f, slow.frequency, slow.amplitude[:, 0])
    np.testing.assert_allclose(at, values, rtol=0.03)
    up, down = (
        sj.swept_response(system, ends, 60.0, steps_per_cycle=100)
        for ends in ((25.0, 45.0), (45.0, 25.0))
    )
    assert (up.rate, down.rate) == (60.0, -60.0)
    assert down.peak[0] < steady.peak[0] < up.peak[0]
    assert max(up.peak[1], down.peak[1]) < 0.99 * steady.peak[1]


ENDS = (25.0, 45.0)


@pytest.mark.parametrize(
    ("loads", "arguments", "words"),
    [
        ((), (ENDS, -1.0), "rate"),
        ((), ((25.0, 25.0), 1.0), "last_frequency: found 25, must differ"),
        ((), (ENDS, 1.0, 0.0), "level: found 0"),
        ((), ((25.0, 35.0, 45.0), 1.0), "must be two"),
        ((), ((25.0, 26.0), 1e4), "the sweep is over within a cycle"),
        (None, (ENDS, 1.0), "nothing is observed"),
        ([sj.Versine(1.0, 0.1)], (ENDS, 1.0), "load on 'mass': found Versine, must be Harmonic"),
        ([sj.Harmonic(1.0, 10.0), sj.Harmonic(1.0, 9.0, 1.0)], (ENDS, 1.0), "of the same phase"),
        (
            [sj.Harmonic(1.0, 10.0), sj.Harmonic(1.0, 20.0)], (ENDS, 1.0),
            "loads of 10, 20 Hz, must be of one frequency",
        ),
    ],
)  # fmt: skip
def test_wrong_arguments_are_refused(loads, arguments, words):
    system = oscillator(1.0)
    if loads is None:
        system = replace(system, points=(), P=np.zeros((0, 1)))
    elif loads:
        own = tuple(replace(system.loads[0], amplitude=amplitude) for amplitude in loads)
        system = replace(system, loads=own)
    with pytest.raises(sj.InputError, match=words):
        sj.swept_response(system, *arguments)
