r"""
Where do two plates slip on each other?
=======================================

Two plates of 700 mm overlap by 200 mm and are pressed on each other there; one far end is held and
the other is pulled. They slip from both edges of the overlap towards its middle.

Both plates are in plane stress. Friction acts on the relative slip
:math:`s = u_\text{upper} - u_\text{lower}`, with the same force on both and opposite directions:

.. math::

   \rho h\,\ddot u_\pm - h\,\nabla\cdot\sigma(u_\pm + \varepsilon\dot u_\pm)
   \pm \mu\,p\,\frac{2}{\pi}\arctan(\beta\,|\dot s|)\,\frac{\dot s}{|\dot s|} = 0 .

The same by commands, with the scene as a text file to change::

    skfem-joint example two_plates
    skfem-joint run two_plates/two_plates.toml --out two_plates/out

:doc:`two_plates` asks whether one half of such a joint is enough of a model.
"""

import numpy as np

import skfem_joint as sj
from skfem_joint.output import fields
from skfem_joint.output.drawing import pictures
from skfem_joint.scene.shipped import shipped_scene

scene = sj.load_scene(shipped_scene("two_plates"))
study = sj.run_scene(scene.changed(accuracy={"estimate": False}))

# %%
# Both models, and the errors of the reduced one relative to the full one.
for name, run in study.runs.items():
    print(f"{name}: {run.system.n} unknowns, {run.system.contact.count} friction points, ", end="")
    print(f"the pulled end moves by {1e6 * run.peak_of('lower_end'):.1f} µm")
errors = study.models["reduced"].errors
print(f"error of the displacement {100 * errors.displacement_rms:.2f} %,", end=" ")
print(f"of the friction energy {100 * errors.friction_energy:+.2f} %")

# %%
# How far slip reaches from the edges of the overlap, at x = 500 mm and x = 700 mm: the points on
# its centre line that slip.
region = sj.active_region(study.structure, study.runs["full"])
patch = study.structure.patches[0]
x, y = 1e3 * study.structure.nodes[patch.nodes].T
stuck = np.sort(x[(abs(y - 25.0) < 1.0) & ~region.slips[patch.points]])
print(f"stuck from x = {stuck[0]:.0f} mm to x = {stuck[-1]:.0f} mm")

# %%
# Both models at the moment of most slip, with the displacement enlarged. This is the picture that
# the command writes too.
pictures.still("two_plates_held.png", fields.frames_of(study.structure, study.runs))
