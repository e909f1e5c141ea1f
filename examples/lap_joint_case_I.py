r"""
Do the modes of one joint serve another?
========================================

A joint of twice the length and six times the pressure is reduced to five modes of the paper's
reference joint (:doc:`lap_joint_reference`), which are scaled to the length that slips. This is
Case I of the paper's Tables 2 and 3.

The modes :math:`\phi_i(\xi)` of the reference joint are defined over its active length
:math:`l_a`, from the loaded end inwards, and applied to the new joint over its own,

.. math::

   u(x, t) = \sum_{i=1}^{5} \phi_i\!\left(\frac{x - (L - l_a)}{l_a}\right) q_i(t)
   \quad\text{for } x > L - l_a, \qquad u = 0 \text{ elsewhere},

because the part of the joint that slips has a similar shape under any load. The active length is
found by a short run (``active_length = "auto"``), or by the paper's estimate.

The same by commands, with the scene as a text file to change::

    skfem-joint example lap_joint_case_I
    skfem-joint run lap_joint_case_I/lap_joint_case_I.toml --out lap_joint_case_I/out
"""

import matplotlib.pyplot as plt
import numpy as np

import skfem_joint as sj
from skfem_joint.scene.shipped import shipped_scene

scene = sj.load_scene(shipped_scene("lap_joint_case_I"))
study = sj.run_scene(scene)
full, reduced = study.models["full"], study.models["reduced"]

# %%
# The five modes of another joint give the displacement and the lost energy within a few percent.
for name, model in study.models.items():
    run, length = model.run, 1e3 * model.active_length["joint"]
    print(f"{name}: {run.system.n} unknowns, {length:.0f} mm of 500 mm slip, ", end="")
    print(f"peak {1e6 * run.cycles.peak[-1, 0]:.1f} µm, friction {run.cycles.friction[-1]:.1f} J")
print(f"error of the peak {100 * reduced.errors.peak_displacement:+.2f} %,", end=" ")
print(f"of the friction energy {100 * reduced.errors.friction_energy_per_cycle:+.2f} %")

# %%
# The five modes over the joint, and the loops of the last cycle.
figure, (left, right) = plt.subplots(1, 2, figsize=(9.0, 3.8), layout="constrained")
modes = study.structure.unpacked(reduced.run.system.expand(np.eye(reduced.run.system.n)))
for number, mode in enumerate(modes[..., 0], start=1):
    left.plot(1e3 * study.structure.nodes[:, 0], mode / abs(mode).max(), label=f"mode {number}")
steps = scene.time.steps_per_cycle + 1
for run, line in zip(study.runs.values(), ("-", "--"), strict=True):
    right.plot(1e6 * run.point("free_end")[-steps:], 1e-3 * run.amplitudes[-steps:, 0], line)
left.set(xlabel="position, mm", ylabel="mode, largest value 1")
left.legend(fontsize="small")
right.set(xlabel="displacement of the free end, µm", ylabel="force, kN")
right.legend([*study.runs])
for panel in (left, right):
    panel.grid(alpha=0.3)
figure.savefig("lap_joint_case_I.png", dpi=120)
