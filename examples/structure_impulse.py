r"""
How fast does a joint damp what a blow leaves?
==============================================

The jointed bar of :doc:`structure_harmonic` is hit at its free end by a triangular pulse of 80 µs,
short enough to excite its first three modes. Damping in proportion to the stiffness takes the
high frequencies of the blow at once; the joint takes about a tenth of its work, within
milliseconds.

For the axial displacement, with friction over the joint of length :math:`l` only:

.. math::

   \rho A\,\ddot u - E A\,\frac{\partial^2}{\partial x^2}(u + \varepsilon\dot u)
   + [x < l]\;\mu\,p\,w\,\frac{2}{\pi}\arctan(\beta\dot u) = 0,
   \qquad E A\,\frac{\partial}{\partial x}(u + \varepsilon\dot u)\Big|_{x=L} = F(t).

The energy that is left at any time is the work of the pulse less what friction and viscous damping
have taken. The full and the reduced model run side by side.

The same by commands, with the scene as a text file to change::

    skfem-joint example structure_impulse
    skfem-joint run structure_impulse/structure_impulse.toml --out structure_impulse/out
"""

import matplotlib.pyplot as plt
import numpy as np

import skfem_joint as sj
from skfem_joint.scene.shipped import shipped_scene

study = sj.run_scene(sj.load_scene(shipped_scene("structure_impulse")))

# %%
# Where the work of the blow has gone after 6 ms, with the estimated error of the friction energy.
for name, model in study.models.items():
    run, error = model.run, model.estimate.parts["total"]["friction_energy"]
    work, friction = run.input_work.sum(), sum(run.friction_energy.values())
    print(f"{name}, {run.system.n} unknowns: the blow does {work:.3f} J of work, of which")
    print(f"    friction takes {friction:.3f} J (estimated error {100 * error:.2f} %),", end=" ")
    print(f"viscous damping {run.viscous_work:.3f} J")
errors = study.models["reduced"].errors
print(f"measured error of the free end {100 * errors.by_point['free_end'][0]:.2f} %,", end=" ")
print(f"of the friction energy {100 * errors.friction_energy:+.2f} %")

# %%
# Displacement of the free end, and the energy that friction has taken up to each time. It rises by
# a step whenever the wave passes the joint.
figure, panels = plt.subplots(2, figsize=(8.0, 5.5), sharex=True, layout="constrained")
lines = (("#7fb2e5", "-", 4.0), ("black", "--", 1.2))
for (name, run), (colour, line, width) in zip(study.runs.items(), lines, strict=True):
    look = {"color": colour, "linestyle": line, "linewidth": width, "label": name}
    panels[0].plot(1e3 * run.times, 1e6 * run.point("free_end"), **look)
    panels[1].plot(1e3 * run.times, np.sum(run.joint_work, axis=1), **look)
panels[0].set(ylabel="free end, µm")
panels[1].set(xlabel="time, ms", ylabel="friction energy, J", xlim=(0.0, 6.0))
for panel in panels:
    panel.legend(loc="right")
    panel.grid(alpha=0.3)
figure.savefig("structure_impulse.png", dpi=120)
