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
nodes = np.flatnonzero(pressed.area)
x, y = 1e3 * structure.nodes[nodes, :2].T
pressure = pressed.force[nodes] / pressed.area[nodes]
figure, panels = plt.subplots(2, figsize=(6.5, 6.0), sharex=True, layout="constrained")
shown = {
    "pressure, MPa": (1e-6 * pressure, "inferno"),
    "gap, µm": (1e6 * pressed.gap[nodes], "viridis"),
}
for panel, (label, (values, colours)) in zip(panels, shown.items(), strict=True):
    drawn = panel.scatter(x, y, c=values, s=14, cmap=colours)
    figure.colorbar(drawn, label=label)
    panel.set(ylabel="y, mm", aspect="equal")
panels[1].set_xlabel("x, mm")
figure.savefig("preload.png", dpi=120)
