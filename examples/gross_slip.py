r"""
What becomes of a mode whose joint slips as a whole?
====================================================

A backbone keeps the shape of its mode, and ends where the joint slips as a whole. Harmonic balance
computes the vibration itself, and goes on: damping has a maximum and falls again, because friction
is limited while the energy of the vibration grows on.

The structure is a bar whose first 0.1 m is pressed on a rigid base, with a heavy tip and 0.2 % of
viscous damping. Its nonlinear mode is the periodic vibration that a force in proportion to the
momentum keeps up,

.. math::

   M \ddot u + C \dot u + K u + B^{\mathsf T} q = 2 \zeta \omega M \dot u ,

with the friction forces :math:`q` (see :doc:`/theory/harmonic-balance`). It has the frequency
:math:`\omega / 2 \pi` and the damping ratio :math:`\zeta`. A free vibration decays faster where
the joint softens: with the energy :math:`U` at the turning points and the loss :math:`D` of a cycle
its damping ratio is :math:`D / (2 \pi\, \mathrm d U / \mathrm d \ln a)` at the amplitude :math:`a`.

By command: ``skfem-joint nonlinear-modes SCENE.toml --out DIR``.
"""

# %%
# The mode of the bar: slowly, by harmonic balance, and as it rings down.
import sys

import matplotlib.pyplot as plt
import numpy as np

import skfem_joint as sj

points, levels = (40, 6) if "--short" in sys.argv else (100, 14)  # of contact, of the mode
strips = [("joint", 0.1, points), ("plain", 0.48, points), ("tip", 0.02, 4)]
mesh = sj.build_bar(strips, {"fixed": 0.0, "free_end": 0.6})
bar = sj.Structure(
    mesh, sj.Material(E=200e9, density=8000.0), width=0.05, thickness=0.01, fixed=["fixed"],
    joints=[sj.Joint("joint", 50e6, 0.7)], regions={"tip": {"density": 320e3}}, damping_ratio=0.002,
)  # fmt: skip
system = bar.system([sj.Load("free_end", sj.Harmonic(1.0, 1000.0))])
(curve,) = sj.backbone(system, up_to=0.9)
model = sj.reduce(system, curve=curve)
(mode,) = sj.nonlinear_modes(model, amplitudes=np.geomspace(1e-4, 2e-3, levels))
down = sj.ring_down(model, mode, cycles=40)
peak = mode.damping_ratio.argmax()
print(f"{mode.stuck_frequency:.1f} Hz where all sticks, {mode.frequency[-1]:.1f} Hz at 2 mm")
print(f"damping is {mode.damping_ratio[peak]:.4f} at {1e3 * mode.displacement[peak, 0]:.2f} mm")
for name, error in mode.estimated.items():
    print(f"its {name.replace('_', ' ')} errs by an estimated {100 * error:.2g} % at most")
print(*mode.notes, sep="\n")

# %%
# The backbone ends where the joint begins to slip as a whole. The ring-down lies on the decrement
# that the mode says it has.
figure, (left, right) = plt.subplots(1, 2, figsize=(9.0, 4.0), layout="constrained")
reach, slow = 1e3 * mode.displacement[:, 0], 1e3 * curve.displacement[:, 0]
free = np.interp(down.amplitude, mode.displaced, reach)  # of the free end, mm
left.semilogx(slow, curve.frequency, "k--", label="backbone")
left.semilogx(reach, mode.frequency, "o-", ms=4, label="nonlinear mode")
left.semilogx(free, down.frequency, "k.", label="ring-down")
right.semilogx(slow, 100 * curve.damping_ratio, "k--", label="backbone")
right.semilogx(reach, 100 * mode.damping_ratio, "o-", ms=4, label="nonlinear mode")
right.semilogx(reach, 100 * mode.decrement, "C0:", label="its decrement")
right.semilogx(free, 100 * down.damping_ratio, "k.", label="ring-down")
left.set(xlabel="amplitude of the free end, mm", ylabel="frequency, Hz")
right.set(xlabel="amplitude of the free end, mm", ylabel="damping ratio, %")
for panel in (left, right):
    panel.legend(fontsize="small")
    panel.grid(alpha=0.3)
figure.savefig("gross_slip.png", dpi=120)
