"""Frequency responses of linear vibration against closed forms, and of the moving base."""

from dataclasses import replace

import numpy as np
import pytest
from bodies import DENSITY, STEEL, THICKNESS, WIDTH, E
from stepping_systems import oscillator

import skfem_joint as sj

ZETA = 0.05
FREQUENCIES = np.array([0.5, 0.97, 1.0, 1.6])


def responded(system: sj.System, frequencies: np.ndarray, level: float = 1.0) -> sj.Curve:
    (curve,) = sj.response(system, frequencies, [level], refined=False, estimated=False)
    return curve


@pytest.mark.parametrize("level", [1.0, 3.0])
def test_a_linear_oscillator_has_its_receptance_mobility_and_accelerance(level):
    system = oscillator(sj.Harmonic(2.0, 1.0, 0.7), damping_ratio=ZETA)
    curve = responded(system, FREQUENCIES, level)
    omega = 2.0 * np.pi * FREQUENCIES
    exact = 1.0 / ((2.0 * np.pi) ** 2 - omega**2 + 2j * ZETA * 2.0 * np.pi * omega)
    for kind, power in (("receptance", 0), ("mobility", 1), ("accelerance", 2)):
        found = sj.frequency_response(system, curve, "mass", kind)
        np.testing.assert_allclose(found[:, 0], (1j * omega) ** power * exact, rtol=1e-5)
        assert np.abs(found[:, 1:]).max() < 1e-6 * np.abs(found[:, 0]).max()


def base(axis: str, mesh: sj.NamedMesh, **section: float) -> sj.System:
    made = sj.Structure(mesh, STEEL, fixed=["left"], damping_ratio=1e-5, **section)
    return made.system([sj.Load(base=axis, amplitude=sj.Harmonic(5.0, 1.0))], ["end"])


def test_a_bar_on_a_moving_base_has_the_transmissibility_of_the_wave_equation():
    length, share = 0.4, np.array([0.01, 0.5, 1.4])
    first = np.sqrt(E / DENSITY) / (4.0 * length)
    bar = sj.build_bar([("all", length, 100)], {"left": 0.0, "end": length})
    system = base("x", bar, width=WIDTH, thickness=THICKNESS)
    curve = responded(system, share * first)
    found = sj.frequency_response(system, curve, "end", "transmissibility")[:, 0]
    np.testing.assert_allclose(found, 1.0 / np.cos(0.5 * np.pi * share), rtol=2e-3)
    assert system.loads[0].mass == pytest.approx(DENSITY * WIDTH * THICKNESS * length)


def test_a_point_moves_with_its_base_along_it_and_not_across():
    plate = sj.build_plate([("all", 0.2, 8)], 0.05, 2, boundaries={"left": "left", "end": "right"})
    system = base("x", plate, thickness=THICKNESS)
    assert system.points == ("mass_x", "end.x", "end.y")
    np.testing.assert_allclose(system.loads[0].carried, [1.0, 1.0, 0.0], atol=1e-12)
    curve = responded(system, np.array([20.0]))
    along, across = (
        sj.frequency_response(system, curve, f"end.{axis}", "transmissibility")[0, 0]
        for axis in "xy"
    )
    assert along == pytest.approx(1.0, rel=1e-3)
    assert abs(across) < 1e-6


def test_what_there_is_not_is_refused():
    system = oscillator(sj.Harmonic(2.0, 1.0), damping_ratio=ZETA)
    curve = responded(system, FREQUENCIES[:1])
    with pytest.raises(sj.InputError, match="found 'compliance', must be one of receptance"):
        sj.frequency_response(system, curve, "mass", "compliance")
    with pytest.raises(sj.InputError, match="found point 'tip', must be one of mass"):
        sj.frequency_response(system, curve, "tip")
    with pytest.raises(sj.InputError, match="needs a base that moves"):
        sj.frequency_response(system, curve, "mass", "transmissibility")


def test_a_load_without_a_first_harmonic_has_nothing_to_divide_by():
    system = oscillator(sj.Harmonic(2.0, 2.0), damping_ratio=ZETA)
    other = system.loads[0]
    both = replace(system, loads=(other, replace(other, amplitude=sj.Harmonic(1.0, 1.0))))
    curve = responded(both, FREQUENCIES[:1])
    with pytest.raises(sj.InputError, match="has no first harmonic"):
        sj.frequency_response(both, curve, "mass")
