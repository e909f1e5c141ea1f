r"""
Between which frequencies does a jointed structure vibrate?
===========================================================

A joint with friction is stiffer than one that slides freely and softer than one that sticks. Both
limits are linear, so that natural modes exist: here those of the bar of
:doc:`structure_harmonic`, whose joint holds its first 100 mm.

.. math::

   K\phi = (2\pi f)^2 M\phi \qquad \text{in all motions (loose), or in those with } B\phi = 0
   \text{ (stuck)}.

With :math:`c = \sqrt{E / \rho}`, a uniform bar of length :math:`L` that is held at one end has
:math:`f_k = (2k - 1)\,c / 4L`. Loose, the whole bar of 0.6 m vibrates, stuck the 0.5 m beside the
joint. The frequency with friction lies between the two and depends on the amplitude, see
:doc:`damping`.
"""

import matplotlib.pyplot as plt
import numpy as np

import skfem_joint as sj
from skfem_joint.scene.shipped import shipped_scene

scene = sj.load_scene(shipped_scene("structure_harmonic"))
system, structure = scene.system(), scene.structure()

# %%
# Three modes of each limit, beside the closed form.
limits = {joints: sj.natural_modes(system, 3, joints=joints) for joints in ("loose", "stuck")}
c = np.sqrt(200e9 / 8000.0)  # m/s
for (joints, found), length in zip(limits.items(), (0.6, 0.5), strict=True):
    closed = np.array([1, 3, 5]) * c / (4.0 * length)
    for computed, exact in zip(found.frequencies, closed, strict=True):
        print(f"{joints}: {computed:.1f} Hz, closed form {exact:.1f} Hz")

# %%
# Their shapes along the bar. Stuck, nothing moves in the joint.
figure, panels = plt.subplots(1, 2, figsize=(9.0, 3.6), sharey=True, layout="constrained")
for panel, (joints, found) in zip(panels, limits.items(), strict=True):
    shapes = structure.unpacked(system.expand(found.modes.T))[..., 0]
    for frequency, shape in zip(found.frequencies, shapes, strict=True):
        panel.plot(1e3 * structure.nodes[:, 0], shape / shape[-1], label=f"{frequency:.0f} Hz")
    panel.axvspan(0.0, 100.0, color="#f08a24", alpha=0.2, label="joint")
    panel.set(title=joints, xlabel="position, mm", xlim=(0.0, 600.0))
    panel.legend(fontsize="small", loc="lower left")
    panel.grid(alpha=0.3)
panels[0].set_ylabel("mode, free end 1")
figure.savefig("stuck_and_loose.png", dpi=120)
