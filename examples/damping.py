r"""
How much damping, and at what frequency, at which amplitude?
============================================================

There are three ways to the damping curve of a jointed structure, and they are drawn over each
other here. Quasi-static modal analysis gives the frequency and the damping of a mode against its
amplitude (the backbone) in hundredths of a second. Released from its highest level, the structure
rings down through the same amplitudes. The response to a harmonic force has its peaks there too.

The structure is the bar of :doc:`structure_harmonic` with Coulomb friction and 0.2 % of viscous
damping. For the mode :math:`\phi` with the joint stuck, loaded quasi-statically by
:math:`\alpha M\phi`, the modal amplitude :math:`q` and the area :math:`W` of its loop give

.. math::

   (2\pi f)^2 = \frac{\alpha}{q(\alpha)}, \qquad
   \zeta = \frac{W(\alpha)}{2\pi\,\alpha\,q(\alpha)} .

The frequencies of a uniform bar are as 1 : 3 : 5, so that the odd harmonics of friction excite the
higher modes: the true damping, of ring-down and response, is up to twice that of the backbone, as
its warning says. A heavy tip moves the higher modes away.

By commands: ``skfem-joint backbone SCENE.toml --out DIR`` and ``skfem-joint response SCENE.toml
--out DIR``.
"""

# %%
# Frequency and damping of the first mode against its amplitude, and as it rings down.
import sys

import matplotlib.pyplot as plt
import numpy as np

import skfem_joint as sj
from skfem_joint.scene.shipped import shipped_scene

scene = sj.load_scene(shipped_scene("structure_harmonic"))
scene = scene.changed(joint={"law": "coulomb"}, damping={"ratio": 0.002})
system = scene.system()
(curve,) = sj.backbone(system, modes=[1], levels=30, up_to=0.5)
down = sj.ring_down(system, curve, cycles=60)
print(f"stuck frequency {curve.stuck_frequency:.1f} Hz")
print(curve.notes[-1])
print(f"ring-down lost {down.friction_work[-1].sum():.1f} of {down.energy[0]:.1f} J in the joint")

# %%
# Steady vibration at three levels of the load, in shares of 87.5 kN. The site computes
# every second frequency, with ``--short``; points are added around the peaks in any case.
points, levels = 13 if "--short" in sys.argv else 26, (0.003, 0.01, 0.03)
swept = sj.response(system, np.linspace(2300.0, 2550.0, points), levels)
for response in swept:
    peak, amplitude = response.peak
    print(f"level {response.level}: peak {1e3 * amplitude:.4f} mm at {peak:.1f} Hz")

# %%
# The peaks of the response lie on the ring-down; both lie beside the backbone, which does not know
# the higher modes.
end = abs(curve.displacement[-1, 0] / curve.amplitude[-1])  # of the free end, m, over modal
reach = curve.displacement[:, 0]
figure, (left, right) = plt.subplots(1, 2, figsize=(9.0, 4.0), layout="constrained")
for one in swept:
    amplitude, label = 1e3 * one.column("amplitude")[:, 0], f"response, {100 * one.level:g} %"
    left.semilogy(one.column("frequency"), amplitude, label=label)
left.semilogy(curve.frequency, 1e3 * reach, "k--", label="backbone")
left.semilogy(down.frequency, 1e3 * end * down.amplitude, "k.", label="ring-down")
right.plot(1e3 * reach, 100.0 * curve.damping_ratio, "k--", label="backbone")
right.plot(1e3 * end * down.amplitude, 100.0 * down.damping_ratio, "k.", label="ring-down")
left.set(xlabel="frequency, Hz", ylabel="amplitude of the free end, mm", xlim=(2300.0, 2550.0))
left.set_ylim(bottom=1e-3)
right.set(xlabel="amplitude of the free end, mm", ylabel="damping ratio, %")
for panel in (left, right):
    panel.legend(fontsize="small", loc="lower right")
    panel.grid(alpha=0.3)
figure.savefig("damping.png", dpi=120)
