"""Frequencies and backbone of the thin Brake-Reuss beam, beside those measured.

    python examples/measured/thin_beam.py                           the scene as it is
    python examples/measured/thin_beam.py joint[0].friction=0.03    with keys changed

The mesh is made by ``meshes/make_meshes.py``. Where curves were measured is in the CSV files.
"""

import os
import sys
import time
from pathlib import Path

os.environ |= dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
HERE = Path(__file__).resolve().parent
sys.path[:0] = [str(HERE.parent)]

import numpy as np
from benchmarks import head, row

import skfem_joint as sj

#: Peaks of the spectrum after a blow across the lap, Hz; see the CSV files.
PEAKS = 80.57, 297.7, 845.9, 1526.8, 1765.0


def measured(name):
    """Amplitude (m/s2), frequency (Hz) and damping ratio of a CSV file, shape (3, n)."""
    return np.loadtxt(HERE / f"{name}.csv", delimiter=",", comments=("#", "amplitude")).T


def backbone(scene):
    """Acceleration at the sensor (m/s2) and the curve of the first bending."""
    system = scene.system()
    options = scene.backbone.model_dump(include={"modes", "levels", "up_to"})
    (curve,) = sj.backbone(system, **options)
    along = system.points.index("sensor.z")
    return np.abs(curve.displacement[:, along]) * (2.0 * np.pi * curve.frequency) ** 2, curve


def main(arguments):
    """Both tables."""
    given = dict(each.split("=") for each in arguments)
    changes = {key: int(value) if value.isdigit() else float(value) for key, value in given.items()}
    scene = sj.load_scene(HERE / "thin_beam.toml").changed(changes)
    system = scene.system()
    at = system.points.index("sensor.z")
    found = {}
    for joints in ("loose", "stuck"):
        straining = sj.natural_modes(system, 20, joints=joints).straining
        moved = np.abs(system.P @ straining.modes)[at]
        # Sideways bending and twist leave the sensor, on the axis, where it is.
        bends = moved > 1e-3 * moved.max()
        found[joints] = straining.frequencies[bends], 1.0 / moved[bends] ** 2
    head("bending across the lap", "loose, Hz", "stuck, Hz", "modal mass, kg", "measured, Hz")
    for number, (loose, stuck, mass) in enumerate(
        zip(found["loose"][0], *found["stuck"], strict=False), 1
    ):
        peaks = [f"{peak}" for peak in PEAKS if abs(np.log(peak / stuck)) < 0.12]
        row(number, f"{loose:.2f}", f"{stuck:.2f}", f"{mass:.3g}", ", ".join(peaks))
    print()
    begin = time.perf_counter()
    amplitude, curve = backbone(scene)
    seconds = time.perf_counter() - begin
    print(
        f"stuck {curve.stuck_frequency:.2f} Hz, slips whole at "
        f"{curve.slips_at * amplitude[0] / curve.level[0]:.0f} m/s2"
    )
    head("m/s2", "Hz", "fall, %", "damping, %", "that of friction, %", "slips, %")
    for values in zip(
        amplitude,
        curve.frequency,
        100.0 - 100.0 * curve.frequency / curve.stuck_frequency,
        100.0 * curve.damping_ratio,
        100.0 * curve.friction_damping,
        100.0 * curve.share,
        strict=True,
    ):
        row(*(f"{value:.4g}" for value in values))
    for name in ("ring_down", "controlled"):
        print()
        head(f"{name}, m/s2", "Hz", "damping, %", "model, Hz", "model, %")
        for a, f, d in measured(name).T:
            if amplitude[0] <= a <= amplitude[-1]:
                model = [np.interp(a, amplitude, y) for y in (curve.frequency, curve.damping_ratio)]
                row(
                    f"{a:g}",
                    f"{f:.2f}",
                    f"{100 * d:.3f}",
                    f"{model[0]:.2f}",
                    f"{100 * model[1]:.3f}",
                )
    print(f"\n{system.n} unknowns, {curve.level.size} levels in {seconds:.0f} s.")


if __name__ == "__main__":
    main(sys.argv[1:])
