"""Random vibration: linear limits in closed form, balances of power, and marching of a slider."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from bodies import structure
from scipy.integrate import quad
from scipy.special import gamma
from tipped_bars import tipped_bar

import skfem_joint as sj
from skfem_joint.vibration.joined_modes import Plays, joined_modes
from skfem_joint.vibration.modal_amplitudes import ModeCurve, modal_amplitudes

OMEGA, RATIO = 2.0 * np.pi * 100.0, 0.02
FLAT = sj.PowerDensity([1.0, 5000.0], [0.3, 0.3])
COLOURED = sj.PowerDensity([20.0, 80.0, 150.0, 400.0], [0.01, 1.0, 0.2, 3.0])


def mode(friction: float = 0.0, viscous: float = RATIO, stuck: float = OMEGA) -> ModeCurve:
    """Mode whose damping by friction grows with the amplitude, and whose frequency falls."""
    amplitude = np.geomspace(1e-3, 1.0, 40)
    omega = stuck / np.sqrt(1.0 + 5.0 * friction * amplitude)
    ratios = friction * amplitude[:, np.newaxis]
    return ModeCurve(1, stuck, 2.0 * viscous * stuck, amplitude, omega, ratios)


def slider(spring: float = 1e4, limit: float = 1.0, viscous: float = 0.01) -> sj.System:
    """Mass of 1 kg on a spring, and beside it a slider with a spring in series; force on it."""
    k, contact = 4e4, sj.point_friction([1.0], limit, stiffness=spring)
    C, loads = 2.0 * viscous * np.sqrt(k + spring), {"mass": (0, sj.Harmonic(1.0, 10.0))}
    return sj.System.from_matrices([[1.0]], [[k]], [[C]], contact=contact, loads=loads)


def noise(G: float, band: tuple[float, float], step: float, count: int, seed: int) -> sj.Table:
    """Sample of a flat density by harmonics with random phases, over so many steps."""
    times = 2.0 * step * np.arange(count // 2)
    frequency = np.fft.rfftfreq(times.size, 2.0 * step)
    inside = (frequency > band[0]) & (frequency < band[1])
    phase = np.exp(2j * np.pi * np.random.default_rng(seed).random(frequency.size))
    harmonics = np.sqrt(0.5 * G * frequency[1]) * phase * inside
    return sj.Table(times, np.fft.irfft(harmonics, times.size) * times.size)


def rms_of(u: np.ndarray) -> tuple[float, float]:
    """Root mean square, and its relative standard deviation by sixteen blocks."""
    mean_square = np.array([part @ part / part.size for part in np.array_split(u, 16)])
    error = 0.5 * mean_square.std(ddof=1) / 4.0 / mean_square.mean()
    return float(np.sqrt(mean_square.mean())), float(error)


def slider_curve(system: sj.System) -> sj.Backbone:
    (curve,) = sj.backbone(system, levels=60, up_to=20.0)
    return curve


def squared(frequency: float, omega: float, ratio: float) -> float:
    turn = 2.0 * np.pi * frequency
    return 1.0 / ((omega**2 - turn**2) ** 2 + (2.0 * ratio * omega * turn) ** 2)


@pytest.mark.parametrize("density", [FLAT, COLOURED])
def test_the_variance_of_a_linear_mode_is_the_integral_of_its_density(density):
    breaks = [*density.frequencies, *(100.0 * (1.0 + RATIO * np.array([-9, -1, 0, 1, 9])))]
    edges = np.sort(breaks)
    exact = sum(
        quad(lambda f: float(density(f)) * squared(f, OMEGA, RATIO), *pair, epsrel=1e-11)[0]
        for pair in pairwise(edges)
    )
    found = modal_amplitudes(mode(), density)
    assert found.rms**2 == pytest.approx(exact, rel=1e-6)
    assert found.frequency == pytest.approx(100.0, rel=1e-9)
    assert found.damping_ratio == pytest.approx(RATIO, rel=1e-9)


def test_amplitudes_of_a_linear_mode_have_rayleighs_density():
    found = modal_amplitudes(mode(), FLAT)
    a, s = found.amplitude, found.rms
    np.testing.assert_allclose(found.density, a / s**2 * np.exp(-0.5 * (a / s) ** 2), atol=1e-5 / s)


@pytest.mark.parametrize("viscous", [0.0, 0.005])
def test_friction_and_viscous_damping_take_what_white_noise_gives(viscous):
    """A mass of 1 kg takes G / 4 of a white force, whatever its stiffness and damping are."""
    white = sj.PowerDensity([1e-3, 1e6], [0.3, 0.3])
    found = modal_amplitudes(mode(2.0, viscous), white)
    taken = found.mean(found.power(found.damping))
    assert taken == pytest.approx(0.3 / 4.0, rel=1e-3)
    assert found.weights().sum() == pytest.approx(1.0, rel=1e-3)


def test_damping_that_grows_makes_large_amplitudes_rarer():
    """Power in friction that grows as a^3: the density falls as exp(-a^3), with E[a^2] by Gamma."""
    white = sj.PowerDensity([1e-3, 1e6], [0.3, 0.3])
    curve = replace(mode(2.0, 0.0), omega=np.full(40, OMEGA))
    found = modal_amplitudes(curve, white)
    # Psi(a) = (b a)^3 with b^3 = 16 omega^3 / (3 G), as zeta = 2 a.

    b3 = 16.0 * OMEGA**3 / (3.0 * 0.3)
    square = gamma(4.0 / 3.0) / gamma(2.0 / 3.0) / b3 ** (2.0 / 3.0)
    assert found.rms**2 == pytest.approx(0.5 * square, rel=1e-3)


def test_the_peak_of_a_linear_mode_is_davenports():
    found = modal_amplitudes(mode(), FLAT)
    root = np.sqrt(2.0 * np.log(100.0 * 3600.0))
    davenport = root + np.euler_gamma / root
    assert found.peak(3600.0) / found.rms == pytest.approx(davenport, rel=2e-3)


def test_plays_lose_the_work_of_the_curve_and_more_beside_another_mode():
    level = np.geomspace(0.1, 10.0, 30)
    work = level**3
    plays = Plays.of(level, work)
    t = np.linspace(0.0, 2.0, 4001)
    wave = 4.0 * np.cos(2.0 * np.pi * t)
    slipped = plays.follow(np.array([wave, wave + 0.5 * np.cos(2.0 * np.pi * 13.0 * t)]))
    second = slice(2000, None)
    loss = -np.trapezoid(wave[second] * np.gradient(slipped[:, second], axis=1), axis=1)
    assert abs(loss[0]) == pytest.approx(4.0**3, rel=0.02)


def test_modes_that_slip_apart_do_not_meet():
    curves = [mode(0.5, 0.002), replace(mode(0.5, 0.002, 3.7 * OMEGA), mode=2)]
    forces = [FLAT.scaled(1e4), FLAT.scaled(3e5)]
    alone = [modal_amplitudes(c, f).rms for c, f in zip(curves, forces, strict=True)]
    apart = joined_modes(curves, forces, np.eye(2)[np.newaxis])
    np.testing.assert_allclose([found.rms for found in apart], alone, rtol=1e-12)
    both = joined_modes(curves, forces, np.ones((1, 2, 2)))
    assert all(found.rms < rms for found, rms in zip(both, alone, strict=True))
    assert both[0].rms < 0.8 * alone[0]


def test_a_slider_that_sticks_is_the_linear_oscillator():
    system = slider()
    curve = slider_curve(system)
    omega, G = np.sqrt(5e4), 1e-12
    result = sj.random_response(system, [curve], [[1e-2, G], [1e5, G]])
    assert result.displacement_rms[0] ** 2 == pytest.approx(G / (8 * 0.01 * omega**3), rel=1e-4)
    four = sj.random_response(system, [curve], [[1e-2, 4.0 * G], [1e5, 4.0 * G]])
    assert four.displacement_rms == pytest.approx(2.0 * result.displacement_rms, rel=1e-9)
    assert four.viscous_work == pytest.approx(4.0 * result.viscous_work, rel=1e-9)
    assert result.joint_work == pytest.approx(0.0, abs=1e-9 * result.viscous_work)
    assert result.viscous_work == pytest.approx(3600.0 * G / 4.0, rel=1e-3)


def test_variances_of_loads_without_correlation_add_up():
    """White noise of two forces on a mass: G / (8 zeta omega^3) of each, by its share."""
    system, G, factor = slider(), 1e-12, 3.0
    first = system.loads[0]
    loads = first, replace(first, vector=factor * first.vector, on="beside")
    both = replace(system, loads=loads)
    psds = [[[1e-2, G], [1e5, G]], sj.PowerDensity([1e-2, 2e5], [2.0 * G, 2.0 * G])]
    result = sj.random_response(both, [slider_curve(system)], psds)
    exact = (1.0 + 2.0 * factor**2) * G / (8 * 0.01 * np.sqrt(5e4) ** 3)
    assert result.displacement_rms[0] ** 2 == pytest.approx(exact, rel=1e-4)
    assert result.load == "mass and beside"
    apart = [
        sj.random_response(both, [slider_curve(system)], psd, load=load.on)
        for psd, load in zip(psds, loads, strict=True)
    ]
    squares = [one.acceleration_rms[0] ** 2 for one in apart]
    assert result.acceleration_rms[0] ** 2 == pytest.approx(sum(squares), rel=1e-9)
    assert result.viscous_work == pytest.approx(sum(one.viscous_work for one in apart), rel=1e-9)
    with pytest.raises(sj.InputError, match="found 1 densities, must be one for each of"):
        sj.random_response(both, [slider_curve(system)], psds[:1])
    with pytest.raises(sj.InputError, match="and load 'mass', must be one for each"):
        sj.random_response(both, [slider_curve(system)], psds, load="mass")
    with pytest.raises(sj.InputError, match="for several of them give a list"):
        sj.random_response(both, [slider_curve(system)], psds[0])


def test_works_add_up_to_what_the_load_gives():
    system = slider()
    result = sj.random_response(system, [slider_curve(system)], [[1e-2, 0.05], [1e5, 0.05]])
    assert result.joint_work[0] + result.viscous_work == pytest.approx(3600.0 * 0.05 / 4, rel=5e-3)
    assert result.point_work.sum() == pytest.approx(result.joint_work.sum(), rel=1e-9)


@pytest.mark.parametrize(
    ("G", "count"), [(3e-3, 2**16), pytest.param(3e-2, 2**18, marks=pytest.mark.slow)]
)
def test_a_slider_vibrates_as_in_marching(G, count):
    """Noise of sampled harmonics with random phases, over 1,000 periods or 4,000."""
    system, step = slider(), 5e-4
    force = noise(G, (5.0, 100.0), step, count, 2)
    loaded = replace(system, loads=(replace(system.loads[0], amplitude=force),))
    run = sj.integrate(loaded, step=step, n_steps=count - 8)
    psd = [[5.0, G], [100.0, G]]
    result = sj.random_response(system, [slider_curve(system)], psd, duration=run.times[-1])
    u = run.point("mass")
    rms, error = rms_of(u)
    assert result.displacement_rms[0] == pytest.approx(rms, rel=0.05 + error)
    work = 3600.0 * run.friction_work.sum() / run.times[-1]
    assert result.joint_work[0] == pytest.approx(work, rel=0.1 + 2.0 * error)
    assert result.displacement_peak[0] == pytest.approx(np.abs(u).max(), rel=0.15)


def refused(match: str, **changed: object) -> None:
    system = slider()
    arguments = {"curves": [slider_curve(system)], "psd": [[1.0, 1e-6], [90.0, 1e-6]]} | changed
    with pytest.raises(sj.InputError, match=match):
        sj.random_response(arguments.pop("system", system), **arguments)


def test_wrong_arguments_are_refused_by_name(tmp_path):
    refused(r"psd: values\[1\]: found -1.0, must be > 0", psd=[[1.0, 1.0], [2.0, -1.0]])
    refused(r"psd: frequencies\[1\]: found 1, must be > 2", psd=[[2.0, 1.0], [1.0, 1.0]])
    free = slider(viscous=0.0)
    refused("nothing damps a mode at amplitudes", system=free, curves=[slider_curve(free)])
    refused("psd: found shape", psd=[1.0, 2.0])
    refused("unit: found 'g2/Hz' for the load on 'mass'", unit="g2/Hz")
    refused("unit: found 'g'", unit="g")
    refused("load: found 'tip'", load="tip")
    refused("curves: found none", curves=[])
    refused("each must be there once", curves=2 * [slider_curve(slider())])
    refused("unit: found ", unit=["SI", "SI"])
    refused("duration: found 0", duration=0.0)
    refused(r"duration: found 0\.13 s, must be at least 0\.1[3-5]", duration=0.13)
    refused("% of the mean square of mode 1 is above", psd=[[1.0, 1e4], [90.0, 1e4]])
    file = tmp_path / "psd.csv"
    file.write_text("Hz,N2/Hz\n1,1e-6\n0.5,1e-6\n", encoding="utf-8")
    refused("line 3: found frequency 0.5, must be > 1", psd=file)
    file.write_text("Hz,(m/s2)2/Hz\n1,1e-6\n90,1e-6\n", encoding="utf-8")
    refused(r"states \(m/s2\)2/Hz, must be N2/Hz of the load on 'mass'", psd=file)


def test_a_density_is_straight_on_logarithmic_axes_and_read_from_files(tmp_path):
    file = tmp_path / "psd.csv"
    file.write_text("Hz,N2/Hz\n10,1\n1000,100\n", encoding="utf-8")
    density = sj.PowerDensity.of(file)
    np.testing.assert_allclose(density(np.array([5.0, 100.0, 2000.0])), [0.0, 10.0, 0.0])
    file.write_text("Frequency (kHz),PSD [g²/Hz]\n0.01,1\n1,100\n", encoding="utf-8")
    same = sj.PowerDensity.of(file, "g2/Hz")
    np.testing.assert_allclose(same.frequencies, density.frequencies)
    np.testing.assert_allclose(same.values, density.values)
    refused("the header states g2/Hz, but the unit is 'SI'", psd=file)
    file.write_text("f,density ((m/s²)²/Hz)\n10,1\n1000,100\n", encoding="utf-8")
    with pytest.raises(sj.InputError, match=r"states \(m/s2\)2/Hz, but the unit is"):
        sj.PowerDensity.of(file, "g2/Hz")
    frequency, weight = density.quadrature([(90.0, 110.0, 0.5)])
    assert weight @ density(frequency) == pytest.approx(0.1 * (1000.0**2 - 10.0**2) / 2, rel=1e-12)


def bar(tip: float = 8000.0) -> sj.System:
    """Bar on a base that moves; ``tip`` is the density of its last elements."""
    return tipped_bar(sj.Load(base="x", amplitude=sj.Harmonic(1.0, 100.0)), tip)


def test_the_density_of_a_force_is_none_of_a_base(tmp_path):
    system = bar()
    (curve,) = sj.backbone(system, levels=5, up_to=2.0)
    (tmp_path / "psd.csv").write_text("Hz,N2/Hz\n10,1\n20,1\n", encoding="utf-8")
    with pytest.raises(sj.InputError, match=r"states N2/Hz, must be \(m/s2\)2/Hz"):
        sj.random_response(system, [curve], tmp_path / "psd.csv")


def test_modes_inside_the_density_without_a_curve_are_named():
    system = bar()
    (curve,) = sj.backbone(system, levels=20, up_to=2.0)
    result = sj.random_response(system, [curve], [[100.0, 1.0], [8000.0, 1.0]])
    assert result.notes[: len(curve.notes)] == curve.notes != ()
    assert "modes 2 (750" in result.notes[-1]


def test_modes_without_a_curve_leave_accelerations_too_low_as_the_note_says():
    """Above their frequencies masses alone resist: accelerations were up to 4.5 times too high."""
    system, psd = bar(), [[100.0, 1e-9], [30e3, 1e-9]]
    every = sj.backbone(system, modes=[1, 2, 3, 4, 5, 6], levels=5)
    few, more = (sj.random_response(system, curves, psd) for curves in (every[:1], every))
    assert np.all(few.acceleration_rms < more.acceleration_rms)


def test_condensed_and_reduced_models_respond_as_the_full_one():
    system, G = bar(), 1e-2
    curves = sj.backbone(system, levels=20, up_to=3.0)
    small = {1e-6: sj.condense(system, frequency=3000.0), 2e-3: sj.reduce(system, curve=curves[0])}
    psd = [[300.0, G], [3000.0, G]]
    full = sj.random_response(system, curves, psd, unit="g2/Hz")
    for error, model in small.items():
        own = sj.backbone(model, levels=20, up_to=3.0)
        found = sj.random_response(model, own, psd, unit="g2/Hz")
        assert found.acceleration_rms[1] == pytest.approx(full.acceleration_rms[1], rel=error)
        assert found.joint_work == pytest.approx(full.joint_work, rel=error)


@pytest.mark.parametrize("G", [1e4, pytest.param(1e5, marks=pytest.mark.slow)])
def test_a_reduced_model_vibrates_under_two_loads_as_in_marching(G):
    """Noise of the base and of a force on the end, over some 800 periods of the mode.

    With a tip mass: without it mode 2 is at three times mode 1, which friction then excites.
    """
    system, band = bar(320e3), (300.0, 3000.0)
    loads = system.loads[0], sj.AppliedLoad(system.P.toarray()[1], sj.Harmonic(1.0, 100.0), "end")
    both = replace(system, loads=loads)
    curves = sj.backbone(both, levels=20, up_to=3.0)
    small = sj.reduce(both, curve=curves[0])
    step, count = 1.0 / 40.0 / curves[0].stuck_frequency, 2**15
    densities = 0.1 * G, G
    base, force = (noise(g, band, step, count, seed) for seed, g in enumerate(densities))
    amplitudes = replace(small.loads[0].amplitude, of=base), force
    acting = [replace(a, amplitude=x) for a, x in zip(small.loads, amplitudes, strict=True)]
    marched = replace(small, loads=tuple(acting), made_for="")
    run = sj.integrate(marched, step=step, n_steps=count - 8, scheme=sj.generalized_alpha(0.9))
    own = sj.backbone(small, levels=20, up_to=3.0)
    psds = [[[band[0], g], [band[1], g]] for g in densities]
    found = sj.random_response(small, own, psds)
    rms, error = rms_of(run.point("end"))
    assert found.displacement_rms[1] == pytest.approx(rms, rel=0.05 + error)
    work = 3600.0 * run.friction_work.sum() / run.times[-1]
    assert found.joint_work[0] == pytest.approx(work, rel=0.1 + 2.0 * error)


def clamped(load: sj.Load, joint: str, ratio: float, **points: float) -> sj.System:
    """Bar of 0.7 m that is held at its end and pressed over a part."""
    mesh = sj.build_bar([("arm", 0.5, 10), ("joint", 0.2, 8)], {"tip": 0.0, "end": 0.7, **points})
    pressed = [sj.Joint(joint, 1e6, 0.5)]
    made = structure(mesh, pressed, ["end"], damping_ratio=ratio)
    return made.system([load], points=["tip", *points])


@pytest.mark.parametrize(("given", "low", "high"), [((1,), 0.3, 1.5), ((2,), 1.8, 3.6)])
def test_a_bar_that_sticks_has_the_density_of_the_linear_structure(given, low, high):
    """Below the frequencies of the density, inside and above them; mode 2 is at 3 times mode 1."""
    system = bar()
    curves = sj.backbone(system, modes=given, levels=20)
    low, high = (curves[0].stuck_frequency / (2 * given[0] - 1) * x for x in (low, high))
    result = sj.random_response(system, curves, [[low, 1e-9], [high, 1e-9]])
    free = np.setdiff1d(np.arange(system.n), system.contact.B.tocsr().indices)
    K, C, M = (A.toarray()[np.ix_(free, free)] for A in (system.K, system.C, system.M))
    force = (system.loads[0].amplitude.factor * system.loads[0].vector)[free]
    end = system.P.toarray()[1, free]
    rows = slice(None, None, 37)
    for f, density in zip(result.frequencies[rows], result.displacement_psd[1, rows], strict=True):
        turn = 2.0 * np.pi * f
        u = np.linalg.solve(K - turn**2 * M + 1j * turn * C, force)
        assert density == pytest.approx(1e-9 * abs(end @ u) ** 2, rel=5e-3)


def test_far_below_the_first_mode_all_points_move_with_the_base():
    """Next to the clamp too, where the mass of a consistent element is shared with held nodes."""
    base = sj.Load(base="x", amplitude=sj.Harmonic(1.0, 1e3))
    system = clamped(base, "arm", 5e-3, near=0.65)
    curves = sj.backbone(system, [1], levels=5)
    highest = curves[0].stuck_frequency / 200.0
    found = sj.random_response(system, curves, [[1.0, 1e-6], [highest, 1e-6]])
    own = np.sqrt(1e-6 * (highest - 1.0))
    assert found.acceleration_rms == pytest.approx(np.full(3, own), rel=1e-4)
    assert found.notes == curves[0].notes


def test_a_force_on_a_part_whose_name_begins_as_a_base_s_is_a_force():
    found = []
    for name in ("near", "mass_near"):
        system = clamped(sj.Load(name, sj.Harmonic(1.0, 1e3)), "joint", 5e-3, **{name: 0.3})
        curves = sj.backbone(system, [1], levels=6)
        psd = [[100.0, 1e-3], [2.0 * curves[0].stuck_frequency, 1e-3]]
        found.append(sj.random_response(system, curves, psd).acceleration_rms)
        with pytest.raises(sj.InputError, match="accelerations are of a load with base"):
            sj.random_response(system, curves, psd, unit="g2/Hz")
    assert np.array_equal(*found)


@pytest.mark.parametrize("level", np.geomspace(1e-4, 1.0, 5))
def test_amplitudes_are_found_where_damping_rises_from_almost_none(level):
    """Between sticking and micro-slip, where the search once went back and forth."""
    system = clamped(sj.Load("tip", sj.Harmonic(1.0, 1e3)), "joint", 5e-4)
    curves = sj.backbone(system, [1], levels=20)
    f = curves[0].stuck_frequency
    found = sj.random_response(system, curves, [[0.5 * f, level], [2.0 * f, level]])
    assert found.modes[0].rms > 0.0
