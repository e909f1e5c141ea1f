r"""
Does a joint fitted at low amplitude predict the damping at a high one?
=======================================================================

The thin Brake-Reuss beam, 720 mm of steel with three bolts in a lap, was measured twice in its
first bending: as it rang down after a blow, and under a shaker that held the amplitude (W. Chen et
al., Mechanical Systems and Signal Processing 166, 2022, 108401; data of
https://github.com/mattiacenedese/BRBtesting, whose numbers are in ``examples/measured/``).

Friction and the viscous damping are fitted to the ring-down below 10 m/s², and everything above is
predicted. What a fit leaves open is settled by the same samples: the mesh is fine enough for them,
rigid faces fit them better than springs, and standard deviations are what the fit itself leaves.

The two sets differ by some 15 % of the damping where they meet, and the model is 7 % stiffer than
the beam. So each set has an offset in frequency and the second one in damping too, by its lowest
sample alone. What is compared is the damping, and the shift of the frequency from a set's lowest
amplitude. The fit minimises, with the offsets :math:`o` of a set and its standard deviations
:math:`s`,

.. math::

   \sum \left(\frac{f(p) + o_f - f_\text{measured}}{s_f}\right)^2
   + \left(\frac{\zeta(p) + o_\zeta - \zeta_\text{measured}}{s_\zeta}\right)^2 .

By a command: ``skfem-joint fit thin_beam.toml --data ring_down.csv --data controlled.csv
--free "joint[0].friction=0.03..1.5" --free "damping.stiffness=1e-6..1e-5" --out DIR``.
"""

# %%
# The beam at its lowest amplitudes: bending frequencies with the joint stuck and without friction,
# beside the peaks of the spectrum after a blow.
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import skfem_joint as sj

folder = Path(__file__).resolve().parent / "measured"
scene, short = sj.load_scene(folder / "thin_beam.toml"), "--short" in sys.argv
if short:
    scene = scene.changed({"joint[0].friction": 0.689, "damping.stiffness": 5.4e-6})
system = scene.system()
at = system.points.index("sensor.z")
peaks = 80.57, 297.7, 845.9, 1526.8, 1765.0
bending = {}
for joints in ("loose", "stuck"):
    straining = sj.natural_modes(system, 20, joints=joints).straining
    moved = np.abs(system.P @ straining.modes)[at]
    bending[joints] = straining.frequencies[moved > 1e-3 * moved.max()]
for joints, frequencies in bending.items():
    print(f"{joints}: {', '.join(f'{f:.1f}' for f in frequencies[:6])} Hz")
print(f"measured: {', '.join(map(str, peaks))} Hz")

# %%
# The fit to what was measured below 10 m/s², as the files say. Their standard deviations are what
# it leaves: repeated from 0.01 % of the frequency and 5 % of the damping they settle at these.
# ``--short`` fits the damping alone, to the ring-down.
free = {"joint[0].friction": (0.03, 1.5), "damping.stiffness": (1e-6, 1e-5)}
if short:
    del free["joint[0].friction"]
names = ("ring_down", "controlled")[: 1 if short else 2]
data = [sj.measured_curve(folder / f"{name}.csv") for name in names]
fit = sj.fit(scene, data, free)
below, model = data[0], fit.predicted[0]
shifted = model.frequency + fit.offsets["offset of ring_down.csv: frequency"]
left = shifted / below.frequency - 1.0, model.damping / below.damping - 1.0
rms = [100.0 * np.sqrt(np.mean(part[below.fitted] ** 2)) for part in left]
print(f"left of the frequency {rms[0]:.3f} %, of the damping {rms[1]:.1f} %")
for key, value in fit.values.items():
    print(f"{key}: {value:.4g}, standard deviation {fit.deviations[key]:.2g}")
print(f"{system.n} unknowns, {fit.computed} curves, {fit.seconds:.0f} s")

# %%
# Prediction and measurement.
figure, panels = plt.subplots(1, 2, figsize=(9.5, 4.0), layout="constrained")
for k, (one, model, mark) in enumerate(zip(data, fit.predicted, "os"[: len(data)], strict=True)):
    offset = fit.offsets.get(f"offset of {one.name}: damping", 0.0)
    damping = model.damping + offset
    shift = model.frequency - model.frequency[0]
    apart = shift - (one.frequency - one.frequency[0])
    print(f"\n{one.name}: m/s2, damping % (model), shift Hz (model); * fitted")
    for row in zip(
        one.amplitude, one.damping, damping, one.frequency - one.frequency[0], shift, one.fitted,
        strict=True,
    ):  # fmt: skip
        star = "*" if row[5] else " "
        print(
            f"{row[0]:7.3f}{star} {100 * row[1]:.3f} ({100 * row[2]:.3f}, "
            f"{100 * (row[2] / row[1] - 1):+5.1f} %)  {row[3]:+.3f} ({row[4]:+.3f})"
        )
    above = ~one.fitted & (one.amplitude < 41.0)
    errors = np.abs(damping / one.damping - 1.0), np.abs(apart / one.frequency)
    largest = [100.0 * error[above].max() for error in errors]
    print(f"largest errors, 10 to 41 m/s2: damping {largest[0]:.0f} %, shift {largest[1]:.2f} %")
    for panel, measured, values in (
        (panels[0], one.frequency - one.frequency[0], shift),
        (panels[1], 100.0 * one.damping, 100.0 * damping),
    ):
        colour = f"C{k}"
        panel.semilogx(one.amplitude, values, color=colour, label=f"{one.name}, model")
        panel.plot(one.amplitude, measured, mark, color=colour, mfc="none", label=one.name)
        panel.plot(one.amplitude[one.fitted], measured[one.fitted], mark, color=colour)
panels[0].set_ylabel("shift of the frequency, Hz")
panels[1].set_ylabel("damping ratio, %")
for panel in panels:
    panel.set_xlabel("amplitude at the sensor, m/s²")
    panel.axvline(10.0, color="0.6", lw=1)
    panel.grid(alpha=0.3)
panels[1].legend(fontsize="small", title="filled: fitted", title_fontsize="small")
figure.savefig("measured_beam.png", dpi=120)
