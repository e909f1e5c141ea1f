r"""
Where do bolts press two solids on each other?
==============================================

Around the holes only. The bolts of :doc:`solid_lap_joint` are tightened before anything vibrates:
the rings under head and nut are pulled together by 20 kN each, and a static contact solve without
friction finds the pressure, where the plates lift off, and by how much.

With the clamp forces :math:`f_b`, the gap :math:`g(u)` between the faces and the pressure
:math:`p`:

.. math::

   \min_u\ \tfrac12\,u^T K u - f_b^T u \quad\text{with } g(u) \ge 0, \qquad
   p \ge 0, \quad p\,g(u) = 0 .

Only what touches carries friction afterwards, with the limit :math:`\mu\,p` per area. The commands
``skfem-joint check SCENE.toml`` and ``run`` print the same numbers.
"""

import matplotlib.pyplot as plt
import numpy as np

import skfem_joint as sj
from skfem_joint.scene.shipped import shipped_scene

structure = sj.load_scene(shipped_scene("solid_lap_joint")).structure()
(pressed,) = structure.preload.joints

# %%
# What the structure says about its preload, and the balance of forces: the pressure adds up to the
# force of both bolts.
for sentence in structure.at_rest():
    print(sentence)
print(f"pressure adds up to {1e-3 * pressed.force.sum():.3f} kN")

# %%
# Pressure and gap over the face of contact, which is 100 mm x 50 mm.
corners = structure.patches[0].cells
triangles = np.vstack([corners[:, [0, 1, 2]], corners[:, [0, 2, 3]]])
pressure = np.divide(pressed.force, pressed.area, out=0 * pressed.area, where=pressed.area > 0.0)
x, y, _ = 1e3 * structure.nodes.T
figure, panels = plt.subplots(2, figsize=(6.5, 6.0), sharex=True, layout="compressed")
shown = ("pressure, MPa", 1e-6 * pressure), ("gap, µm", 1e6 * pressed.gap)
for panel, (label, values) in zip(panels, shown, strict=True):
    drawn = panel.tripcolor(x, y, values, triangles=triangles, shading="gouraud")
    figure.colorbar(drawn, label=label)
    panel.set(ylabel="y, mm", aspect="equal", xlim=(98.0, 202.0), ylim=(-2.0, 52.0))
panels[1].set_xlabel("x, mm")
figure.savefig("preload.png", dpi=120)
