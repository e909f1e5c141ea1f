r"""
How much energy does a lap joint lose in a cycle?
=================================================

A bar is pressed on a rigid base over its whole length and pulled at its free end, at 90 % of what
friction holds. The area of its hysteresis loop, force over displacement, is the energy that it
loses in a cycle. The joint is the reference system of the paper, section 2.1.

For the axial displacement :math:`u(x, t)`, with the pressure :math:`p`, the width :math:`w`, the
friction coefficient :math:`\mu` and the steepness :math:`\beta` of the friction law:

.. math::

   \rho A\,\ddot u - E A\,\frac{\partial^2}{\partial x^2}(u + \varepsilon\dot u)
   + \mu\,p\,w\,\frac{2}{\pi}\arctan(\beta\dot u) = 0,
   \qquad u(0, t) = 0 .

Under a slow load with Coulomb friction the joint slips over :math:`F / \tau` from its free end,
:math:`\tau = \mu p w`, and loses :math:`2F^3 / (3EA\tau)` in a cycle.

The same by commands, with the scene as a text file to change::

    skfem-joint example lap_joint_reference
    skfem-joint run lap_joint_reference/lap_joint_reference.toml --out lap_joint_reference/out
"""

import matplotlib.pyplot as plt

import skfem_joint as sj
from skfem_joint.scene.shipped import shipped_scene

scene = sj.load_scene(shipped_scene("lap_joint_reference"))
study = sj.run_scene(scene)
model = study.models["full"]
run = model.run

# %%
# The lost energy with its estimated error, beside that of a slow load. The difference is real:
# at 1000 Hz inertia adds to the force in the joint.
lost = run.cycles.friction[-1]
error = model.estimate.parts["total"]["friction_energy"]
EA, tau, force = 200e9 * 0.05 * 0.01, 0.7 * 8e6 * 0.05, 63e3  # N, N/m, N
slow = 2.0 * force**3 / (3.0 * EA * tau)
print(f"friction takes {lost:.4f} J in the last cycle, estimated error {100 * error:.2f} %")
print(f"a slow load would lose {slow:.4f} J")
print(f"slip reaches {1e3 * model.active_length['joint']:.1f} mm into the joint of 250 mm")

# %%
# The loop of the last cycle. Its area is the work of the load, which friction and viscous damping
# take.
steps = scene.time.steps_per_cycle
displacement, load = run.point("free_end")[-steps - 1 :], run.amplitudes[-steps - 1 :, 0]
figure, panel = plt.subplots(figsize=(6.0, 4.0), layout="constrained")
panel.fill(1e6 * displacement, 1e-3 * load, color="#f08a24", alpha=0.25)
panel.plot(1e6 * displacement, 1e-3 * load, color="#1f3d7a")
panel.set(xlabel="displacement of the free end, µm", ylabel="force, kN")
panel.set_title(f"area: {run.cycles.input[-1, 0]:.3f} J, of which friction {lost:.3f} J")
panel.grid(alpha=0.3)
figure.savefig("lap_joint_reference.png", dpi=120)
