r"""
Which of two bolts slips, and does a model of 13 unknowns see the same?
=======================================================================

A plate that is held at a wall and clamped on a rigid base by two bolts is pulled at its free end
by half of what the bolts can hold. The bolt beside the load slips over its whole ring, the one at
the wall slips at its rim only, and the reduced model shows the same.

The plate, of thickness :math:`h`, is in plane stress. Coulomb friction acts where the bolts press
it on the base, with the pressure :math:`p` of the cone that spreads below each head:

.. math::

   \rho h\,\ddot u - h\,\nabla\cdot\sigma(u + \varepsilon\dot u)
   + \mu\,p(x)\,\frac{\dot u}{|\dot u|} = 0,
   \qquad |\text{friction}| \le \mu\,p \ \text{ where } \dot u = 0 .

The reduced model is :math:`u = V q`: proper orthogonal modes of the plate's static slip path, for
which the full model is not run, beside the static response and fixed-interface modes. Contact
points that slip alike are merged.

The same by commands, with the scene as a text file to change::

    skfem-joint example plate_bolts
    skfem-joint run plate_bolts/plate_bolts.toml --out plate_bolts/out
"""

import sys

import skfem_joint as sj
from skfem_joint.output import fields
from skfem_joint.output.drawing import pictures
from skfem_joint.scene.shipped import shipped_scene

# Three cycles; the site runs two of them, with ``--short``.
cycles = 2 if "--short" in sys.argv else 3
scene = sj.load_scene(shipped_scene("plate_bolts"))
scene = scene.changed(time={"cycles": cycles}, accuracy={"estimate": False})
study = sj.run_scene(scene)

# %%
# Both models were run, so that the errors of the reduced one are measured and need no estimate.
# They are relative to the full model.
for name, model in study.models.items():
    system, run = model.run.system, model.run
    print(f"{name}: {system.n} unknowns, {system.contact.count} friction points")
    print(f"    the free end moves by {1e6 * run.peak_of('free_end'):.2f} µm")
    print(f"    friction takes {1e3 * run.cycles.friction[-1]:.2f} mJ in the last cycle")
errors = study.models["reduced"].errors
print(f"error of the displacement {100 * errors.displacement_rms:.2f} %")
print(f"error of the friction energy {100 * errors.friction_energy_per_cycle:+.1f} %")

# %%
# The points below the heads that slip, for each of the bolts at 50 mm and 150 mm from the wall:
region = sj.active_region(study.structure, study.runs["full"])
patch = study.structure.patches[0]
x = study.structure.nodes[patch.nodes, 0]
for bolt in scene.joint[0].pressure.bolts:
    slips = region.slips[patch.points[abs(x - bolt.at[0]) < 0.05]]
    print(f"bolt at {1e3 * bolt.at[0]:.0f} mm: {100 * slips.mean():.0f} % of the points slip")

# %%
# Both models at the moment of most slip, with the displacement enlarged. This is the picture that
# the command writes too.
pictures.still("plate_bolts.png", fields.frames_of(study.structure, study.runs))
