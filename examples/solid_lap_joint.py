r"""
Where do two bolted solids slip on each other?
==============================================

Two solid plates are lapped, clamped by two bolts, and pulled, which also bends them because the
pull is out of line. They touch around the bolts only, and slip there from the rim of the contact
inwards.

First a static contact solve finds where the plates press on each other under the bolts' forces,
and where they lift off: with the gap :math:`g(u)` and the pressure :math:`p`,

.. math::

   g(u) \ge 0, \qquad p \ge 0, \qquad p\,g(u) = 0 .

Coulomb friction then acts on the relative slip :math:`s`, a vector in the plane of contact, with
this pressure, which vibration is taken not to change:

.. math::

   t = -\mu\,p\,\frac{\dot s}{|\dot s|}, \qquad |t| \le \mu\,p \ \text{ where } \dot s = 0 .

The same by commands, with the scene as a text file to change::

    skfem-joint example solid_lap_joint
    skfem-joint run solid_lap_joint/solid_lap_joint.toml --out solid_lap_joint/out
"""

import sys

import skfem_joint as sj
from skfem_joint.output import fields
from skfem_joint.output.drawing import pictures
from skfem_joint.scene.shipped import shipped_scene

# Three cycles; the site runs one of them, with ``--short``.
cycles = 1 if "--short" in sys.argv else 3
scene = sj.load_scene(shipped_scene("solid_lap_joint"))
scene = scene.changed(time={"cycles": cycles}, accuracy={"estimate": False})
study = sj.run_scene(scene)

# %%
# What the bolts press, from the static solve.
(pressed,) = study.structure.preload.joints
touching = 100.0 * pressed.area[pressed.force > 0.0].sum() / pressed.area.sum()
print(f"the bolts press the plates by {1e-3 * pressed.force.sum():.1f} kN")
print(f"{touching:.0f} % of the overlap touches, the gap is up to {1e6 * pressed.gap.max():.2f} µm")

# %%
# What both models give, and the errors of the reduced one relative to the full one.
for name, run in study.runs.items():
    print(f"{name}: {run.system.n} unknowns, {run.system.contact.count} friction points")
    print(f"    the pulled end moves by {1e6 * run.peak_of('lower_end'):.2f} µm")
    print(f"    friction takes {1e3 * run.cycles.friction[-1]:.3f} mJ in the last cycle")
errors = study.models["reduced"].errors
print(f"error of the displacement {100 * errors.displacement_rms:.2f} %,", end=" ")
print(f"of the friction energy {100 * errors.friction_energy_per_cycle:+.1f} %")

# %%
# The plates at the moment of most slip, with the displacement enlarged, and below them the face of
# contact alone, which the plates hide. This is the picture that the command writes too.
pictures.still("solid_lap_joint.png", fields.frames_of(study.structure, study.runs))
