"""The measured beam: its scene describes a floating beam with a sensor, its curves are whole."""

import tomllib

import numpy as np
import pytest
from benchmarks import bowed_beam
from gallery import EXAMPLES

from skfem_joint.mesh import load_meshes

FOLDER = EXAMPLES / "measured"


def curve(name):
    """Columns of a file, after its comments and names."""
    return np.loadtxt(FOLDER / f"{name}.csv", delimiter=",", comments=("#", "amplitude"))


def test_the_beam_floats_with_its_sensor_three_inches_from_its_end():
    scene = tomllib.loads((FOLDER / "thin_beam.toml").read_text(encoding="utf-8"))
    assert scene["support"] == {"free": True}
    assert len(scene["bolt"]) == 3
    named = load_meshes([FOLDER / scene["mesh"]["file"]])
    at = named.mesh.p[:, named.points["sensor"]]
    assert at == pytest.approx([0.36 - 0.0762, 0.0, 0.00635], abs=1e-6)
    assert np.ptp(named.mesh.p, axis=1)[:2] == pytest.approx([0.72, 0.0254], rel=1e-9)


def test_measured_curves_are_of_one_mode_and_damping_rises_with_amplitude():
    for name, levels in (("ring_down", 12), ("controlled", 8)):
        amplitude, frequency, damping = curve(name)[np.argsort(curve(name)[:, 0])].T
        assert amplitude.size == levels
        assert np.all(np.diff(damping) > 0.0)
        assert np.all((damping > 1e-3) & (damping < 1e-2))
        assert np.all(np.abs(frequency / 80.4 - 1.0) < 0.005)


def test_a_bow_opens_the_lap_at_its_ends_or_in_its_middle():
    x = np.array([[-0.06, 0.0, 0.0], [0.0, 0.01, 0.0], [0.03, 0.0, 0.0], [0.0601, 0.0, 0.0]])
    assert bowed_beam.shape(x, 1.0) == pytest.approx([1.0, 0.0, 0.25, 1.0])
    assert bowed_beam.shape(x, -1.0) == pytest.approx([0.0, 1.0, 0.75, 0.0])
