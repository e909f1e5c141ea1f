"""Free vibration: modes that ring together, energies, what a pulse leaves behind; SI units."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import skfem_joint as sj
from skfem_joint.analysis.backbone import scene_backbone

ROOT = Path(__file__).resolve().parents[2]
PULSE = 2e-4  # s, of its rise


def bar(peak: float, damping: float = 0.0, law: float = np.inf) -> sj.System:
    """Bar with a joint of 350 kN, struck at its end; its frequencies are 2.5, 7.5, 12.5 kHz."""
    mesh = sj.build_bar([("joint", 0.2, 40), ("free", 0.5, 40)], {"fixed": 0.0, "end": 0.7})
    structure = sj.Structure(
        mesh,
        sj.Material(200e9, 8000.0),
        width=0.05,
        thickness=0.01,
        fixed=["fixed"],
        joints=[sj.Joint("joint", 50e6, 0.7, beta=law)],
        stiffness_damping=damping,
    )
    return structure.system([sj.Load("end", sj.HalfSine(peak, PULSE))])


def test_modes_that_ring_together_are_told_apart():
    system = bar(1.0, 1e-6)  # a newton: the joint sticks
    struck = sj.integrate(system, duration=2.0 * PULSE, step=1e-6).final
    for curve in sj.backbone(system, (1, 2), levels=1):
        found = sj.ring_down(system, curve, 20, start=struck)
        assert found.frequency == pytest.approx(curve.stuck_frequency, rel=2e-4)
        ratio = np.pi * curve.stuck_frequency * 1e-6
        assert found.damping_ratio == pytest.approx(ratio, rel=0.01)


def test_a_pulse_rings_down_along_the_curve_and_loses_its_energy_in_the_joint():
    system = bar(60e3)
    struck = sj.integrate(system, duration=2.0 * PULSE, step=1e-6).final
    (curve,) = sj.backbone(system)
    halves = np.repeat(np.eye(2), 20, axis=1)
    parted = replace(system, J=halves, joints=("inner", "outer"))
    found = sj.ring_down(parted, curve, 30, start=struck)
    work = found.friction_work.sum(axis=1)
    assert found.energy[0] - found.energy == pytest.approx(work, abs=1e-9 * found.energy[0])
    assert np.all(np.diff(found.friction_work, axis=0) >= -1e-12 * work[-1])
    assert found.friction_work[-1, 1] > found.friction_work[-1, 0]  # it is pulled from there
    frequency = np.interp(found.amplitude, curve.amplitude, curve.frequency)
    seen = found.amplitude > curve.amplitude[0]
    assert seen.sum() > 5
    assert found.frequency[seen] == pytest.approx(frequency[seen], rel=0.02)


def test_a_scene_s_pulse_rings_down_alike_in_both_models():
    scene = sj.load_scene(ROOT / "examples" / "structure_impulse.toml")
    asked = {"levels": 12, "ring_down": 12, "released": "loads"}
    found = scene_backbone(scene.changed(backbone=asked, models={"run": ["full", "reduced"]}))
    (full,), (reduced,) = (model.ring_downs for model in found.models)
    high = full.amplitude > found.models[0].curves[0].amplitude[0]
    assert high.sum() >= 3
    for name, near in {"amplitude": 0.05, "frequency": 5e-3, "damping_ratio": 0.02}.items():
        assert getattr(reduced, name)[high] == pytest.approx(getattr(full, name)[high], rel=near)


def test_too_few_cycles_are_refused():
    system = bar(1.0)
    (curve,) = sj.backbone(system, levels=1)
    with pytest.raises(sj.InputError, match="at least"):
        sj.ring_down(system, curve, 1)
