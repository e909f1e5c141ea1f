r"""
What is the loop of one joint among several?
============================================

A bar is pressed on its base at two places and pulled at its free end. Each joint has a hysteresis
loop of its own: its friction force over the displacement of its edge on the side of the load. The
joint beside the load slips along its whole length, the other one only in part.

A run keeps the friction :math:`\sigma` of every contact point over its limit :math:`w`. The force
of a joint is the sum over its points, and the energy that it takes the integral of the friction
power over the cycle,

.. math::

   F_j(t) = \sum_{i \in j} w_i\,\sigma_i(t), \qquad
   W_j = \oint \sum_{i \in j} w_i\,\sigma_i\,v_i\,\mathrm d t ,

with the slip velocities :math:`v = B\dot u`. The system names its joints and the points of each.
The area of the loop drawn here is **not** that energy: the points of a joint slip by different
amounts, all of them by less than its edge moves. The second joint's curve has an area of
3.81 J, its friction takes 3.28 J. The energy is the sum of the areas of the loops of all points,
each friction force over the slip of its own point.
"""

# %%
# Two joints of 50 mm on one bar; the second one holds 35 kN, the load is 50 kN.
import matplotlib.pyplot as plt
import numpy as np

import skfem_joint as sj

parts = [("arm", 0.1, 20), ("first", 0.05, 25), ("middle", 0.1, 20), ("second", 0.05, 25)]
ends = {"wall": 0.0, "first_edge": 0.15, "second_edge": 0.3}
pressed = {"pressure": 20e6, "friction": 0.7}  # by Coulomb's law
structure = sj.Structure(
    sj.build_bar(parts, ends),
    sj.Material(E=200e9, density=8000.0),
    width=0.05,
    thickness=0.01,
    fixed=["wall"],
    joints=[sj.Joint(name, **pressed) for name in ("first", "second")],
    stiffness_damping=1e-6,
)
load = sj.Load("second_edge", sj.Harmonic(50e3, 200.0))
system = structure.system([load], points=["first_edge", "second_edge"])

# %%
# Three cycles, every state kept. Each joint's force comes from its points, its energy from the
# run itself; the loops of its points together have the same area.
run = sj.integrate(system, cycles=3, steps_per_cycle=200, save=sj.Save(fields=True))
figure, panel = plt.subplots(figsize=(6.5, 4.2), layout="constrained")
contact = system.contact
for number, (name, limits) in enumerate(zip(contact.joints, contact.limits_by_joint, strict=True)):
    force = run.sigma[-201:] @ limits  # along a bar, a row of B is a point
    edge = run.point(f"{name}_edge")[-201:]
    lost = run.cycles.by_joint[-1, number]
    slip = run.u[-201:] @ contact.B.T
    loops = np.trapezoid(run.sigma[-201:] * limits, slip, axis=0).sum()  # as large as `lost`
    print(f"{name}: holds {1e-3 * limits.sum():.1f} kN,", end=" ")
    print(f"carries {1e-3 * abs(force).max():.1f} kN, takes {1e3 * lost:.1f} mJ a cycle,", end=" ")
    print(
        f"loops of its points {1e3 * loops:.1f} mJ, curve {1e3 * np.trapezoid(force, edge):.1f} mJ"
    )
    panel.plot(1e6 * edge, 1e-3 * force, label=f"{name} joint, takes {1e3 * lost:.0f} mJ a cycle")

# %%
# The flat parts of a curve are where the whole joint slips. The energies in the legend are those of
# the run, not the areas of the curves.
panel.set(xlabel="displacement of the joint's edge, µm", ylabel="friction force of the joint, kN")
panel.legend(loc="upper left", fontsize="small")
panel.grid(alpha=0.3)
figure.savefig("joint_loop.png", dpi=120)
