r"""
How far does slip reach into an area?
=====================================

The reference joint of the paper is taken as a plate of 250 mm x 50 mm that is pressed on a rigid
base over its whole area, and pulled at one end by 90 % of what friction holds. Slip starts at the
loaded end and does not reach the wall.

The plate, of thickness :math:`h`, is in plane stress. Friction acts over the area, against the
velocity in the plane, here along the axis of the joint:

.. math::

   \rho h\,\ddot u - h\,\nabla\cdot\sigma(u + \varepsilon\dot u)
   + \mu\,p\,\frac{2}{\pi}\arctan(\beta\,|\dot u|)\,\frac{\dot u}{|\dot u|} = 0 .

A point counts as slipping if its largest slip is more than a law of finite steepness creeps by.

The same by commands, with the scene as a text file to change::

    skfem-joint example plate_reference
    skfem-joint run plate_reference/plate_reference.toml --out plate_reference/out
"""

from pathlib import Path

import skfem_joint as sj
from skfem_joint.output import plots
from skfem_joint.scene.shipped import shipped_scene

scene = sj.load_scene(shipped_scene("plate_reference"))
study = sj.run_scene(scene.changed(accuracy={"estimate": False}))

# %%
# What the full model says of the region that slips, what both say of the energy, and the measured
# errors of the reduced one.
full = study.models["full"]
print(f"slip reaches {1e3 * full.active_length['joint']:.1f} mm of 250 mm from the loaded end,")
print(f"{100 * full.active_area_fraction['joint']:.1f} % of the area slips")
for name, run in study.runs.items():
    print(f"{name}: {run.system.n} unknowns,", end=" ")
    print(f"friction takes {run.cycles.friction[-1]:.3f} J in the last cycle")
errors = study.models["reduced"].errors
print(f"error of all displacements {100 * errors.displacement_rms:.2f} %,", end=" ")
print(f"of the friction energy {100 * errors.friction_energy_per_cycle:+.2f} %")

# %%
# The largest slip of each point in the full model, with the region that slips outlined.
region = sj.active_region(study.structure, full.run)
patch = study.structure.patches[0]
slip, slips = region.slip_peak[patch.points], region.slips[patch.points]
figure = plots.active_region_figure(study.structure.body, patch, slip, slips)
plots.save_figure(Path("plate_reference.png"), figure)
