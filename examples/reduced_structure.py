r"""
How is a structure reduced?
===========================

A bar of 0.6 m is pressed on a rigid base over its first 0.1 m and pulled at its free end at
500 Hz. One call, ``sj.reduce(system, modes=10)``, makes a model of 13 unknowns of its 200, for
which the full model is not run. The paper's structure of Fig. 18(b) serves as the example.

For the axial displacement :math:`u(x, t)`, with friction in the joint only:

.. math::

   \rho A\,\ddot u - \frac{\partial}{\partial x}\bigl(E A\,(u_x + \varepsilon\dot u_x)\bigr)
   + [x < 0.1\,\text{m}]\;\mu\,P\,w\,\sigma(\dot u) = 0 .

The reduced basis :math:`u = V q` holds proper orthogonal modes of the structure's static slip
path, the static response to the load, and fixed-interface modes. Galerkin's projection, Eqs. (4)
to (9), makes a system of the same type:

.. math::

   V^T M V\,\ddot q + V^T C V\,\dot q + V^T K V\,q
   + V^T B^T\bigl(w\,\sigma(B V\dot q)\bigr) = V^T f(t) .

Contact points that slip alike are merged, so that friction is evaluated at a few dozen points
instead of a hundred. Units are SI. Source: Journal of Sound and Vibration (2010), sections 5 to
7.3.
"""

# %%
# The full model.
import matplotlib.pyplot as plt

import skfem_joint as sj

structure = sj.Structure(
    sj.build_bar([("joint", 0.1, 100), ("arm", 0.5, 100)], {"fixed": 0.0, "free_end": 0.6}),
    sj.Material(E=200e9, density=8000.0),
    width=0.05,
    thickness=0.01,
    fixed=["fixed"],
    joints=[sj.Joint("joint", pressure=50e6, friction=0.7, beta=1e5, normal_force="equal")],
    stiffness_damping=1e-5,
)
system = structure.system([sj.Load("free_end", sj.Harmonic(87.5e3, 500.0))])
full = sj.integrate(system, cycles=6, steps_per_cycle=200)

# %%
# The reduced model is a system too, and the same function integrates it.
small = sj.reduce(system, modes=10)
reduced = sj.integrate(small, cycles=6, steps_per_cycle=200)
print(f"unknowns: {system.n} full, {small.n} reduced")
print(f"friction points: {system.contact.count} full, {small.contact.count} reduced")

# %%
# Its errors relative to the full model.
errors = sj.compare(full, reduced)
print(f"peak displacement: {100 * errors.peak_displacement:+.2f} %")
print(f"friction energy per cycle: {100 * errors.friction_energy_per_cycle:+.2f} %")

# %%
# The reduced unknowns give the displacement of all nodes; here at the end of both runs. The loops
# of the last cycle lie on each other.
last = structure.unpacked(small.expand(reduced.final[0]))
figure, (left, right) = plt.subplots(1, 2, figsize=(9.0, 3.8), layout="constrained")
x = 1e3 * structure.nodes[:, 0]
left.plot(x, 1e6 * structure.unpacked(system.expand(full.final[0])), "#7fb2e5", lw=4.0)
left.plot(x, 1e6 * last, "k--")
left.set(xlabel="position, mm", ylabel="displacement after six cycles, µm")
for run, look in ((full, {"c": "#7fb2e5", "lw": 4.0}), (reduced, {"c": "k", "ls": "--"})):
    right.plot(1e6 * run.point("free_end")[-201:], 1e-3 * run.amplitudes[-201:, 0], **look)
right.set(xlabel="displacement of the free end, µm", ylabel="force, kN")
right.legend([f"full, {system.n} unknowns", f"reduced, {small.n} unknowns"], fontsize="small")
for panel in (left, right):
    panel.grid(alpha=0.3)
figure.savefig("reduced_structure.png", dpi=120)
