r"""
How close is a model of 15 unknowns to one of 200?
==================================================

A bar with a joint over its first 100 mm is pulled at 500 Hz. It is integrated with all 200
unknowns and with 15 of a reduced model, for which the full model is not run. The displacements of
both differ by less than 0.3 %, the energies that friction takes by as much.

The bar is the paper's jointed structure, Fig. 18(b). For its axial displacement, with friction in
the joint only:

.. math::

   \rho A\,\ddot u - E A\,\frac{\partial^2}{\partial x^2}(u + \varepsilon\dot u)
   + [x < l]\;\mu\,p\,w\,\frac{2}{\pi}\arctan(\beta\dot u) = 0 .

With finite elements and with :math:`u = V q`, the two models are

.. math::

   M\ddot u + C\dot u + K u + B^T\bigl(w\,\sigma(B\dot u)\bigr) &= f(t), \\
   V^T M V\,\ddot q + V^T C V\,\dot q + V^T K V\,q
   + V^T B^T\bigl(w\,\sigma(B V\dot q)\bigr) &= V^T f(t) .

The columns of :math:`V` are proper orthogonal modes of the static slip path, the static response
to the load, and fixed-interface modes.

The same by commands, with the scene as a text file to change::

    skfem-joint example structure_harmonic
    skfem-joint run structure_harmonic/structure_harmonic.toml --out structure_harmonic/out
"""

import matplotlib.pyplot as plt

import skfem_joint as sj
from skfem_joint.scene.shipped import shipped_scene

scene = sj.load_scene(shipped_scene("structure_harmonic"))
study = sj.run_scene(scene)
full, reduced = study.runs["full"], study.runs["reduced"]

# %%
# Peaks and energies, each with its estimated error. The estimate of the reduced model is made
# without the full one; as both were run here, the measured error stands beside it, and the larger
# one counts in the total, with the error by the mesh, which both have alike.
for name, model in study.models.items():
    run, error = model.run, model.estimate.parts["total"]
    peak, friction = 1e6 * run.peak_of("free_end"), run.cycles.friction[-1]
    print(f"{name}: {run.system.n} unknowns, {run.system.contact.count} friction points")
    print(f"    peak {peak:.2f} µm, error {100 * error['peak_displacement']:.3f} %,", end=" ")
    print(f"friction {friction:.4f} J a cycle, error {100 * error['friction_energy']:.3f} %")
errors = study.models["reduced"].errors
print(f"measured: all displacements {100 * errors.displacement_rms:.3f} %,", end=" ")
print(f"friction {100 * errors.friction_energy_per_cycle:+.3f} %")

# %%
# Displacements of the free end and of the end of the joint over twelve cycles, and how far the
# models are apart.
figure, panels = plt.subplots(3, figsize=(8.0, 6.5), sharex=True, layout="constrained")
for panel, point in zip(panels, ("free_end", "junction"), strict=False):
    panel.plot(1e3 * full.times, 1e6 * full.point(point), "#7fb2e5", lw=3.0, label="200 unknowns")
    panel.plot(1e3 * full.times, 1e6 * reduced.point(point), "k--", lw=1.0, label="15 unknowns")
    panel.set(ylabel=f"{point}, µm")
    panels[2].plot(1e3 * full.times, 1e6 * (reduced.point(point) - full.point(point)), label=point)
panels[2].set(xlabel="time, ms", ylabel="difference, µm", xlim=(0.0, 1e3 * full.times[-1]))
for panel in panels:
    panel.legend(loc="upper right", ncols=2, fontsize="small")
    panel.grid(alpha=0.3)
figure.savefig("structure_harmonic.png", dpi=120)
