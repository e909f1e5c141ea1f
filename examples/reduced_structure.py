r"""
How is a structure reduced?
===========================

A bar of 0.6 m is pressed on a rigid base over its first 0.1 m and pulled at its free end at
500 Hz. One call, ``sj.reduce(system, modes=10)``, makes a model of 13 unknowns of its 200, for
which the full model is not run. The paper's way, step by step, needs the full run that it should
replace. The paper's structure of Fig. 18(b) serves as the example.

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
instead of a hundred. In the paper's way :math:`V` are the first left singular vectors of snapshots
of the full run, :math:`[u(t_1) \dots u(t_k)] = \Phi\,\Sigma\,\Psi^T`; its scaled modes
(:doc:`lap_joint_case_I`) do without that run too. Units are SI. Source: Journal of Sound and
Vibration (2010), sections 3 and 5 to 7.3.
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
timing = {"cycles": 6, "steps_per_cycle": 200, "save": sj.Save(fields=True, fields_every=10)}
system = structure.system([sj.Load("free_end", sj.Harmonic(87.5e3, 500.0))])
full = sj.integrate(system, **timing)

# %%
# The paper's way: proper modes of the run, and the projection on ten of them.
proper = sj.proper_modes(full, snapshots="displacement", inner_product="euclidean")
by_hand = sj.integrate(system.project(proper.modes[:, :10]), **timing)
print(f"ten modes leave {100 - proper.proper_values[:10].sum():.1e} % of the snapshots")

# %%
# In one call, without that run. The reduced model is a system too, and the same function
# integrates it.
small = sj.reduce(system, modes=10)
reduced = sj.integrate(small, **timing)
print(f"friction points: {system.contact.count} full, {small.contact.count} reduced")

# %%
# Errors of both relative to the full model.
for name, run in (("by hand", by_hand), ("one call", reduced)):
    errors = sj.compare(full, run)
    print(f"{name}: peak {100 * errors.peak_displacement:+.2f} %", end=", ")
    print(f"friction energy per cycle {100 * errors.friction_energy_per_cycle:+.2f} %")

# %%
# The unknowns of a model give the displacement of all nodes. The figure has four of the modes, and
# the loops of the last cycle. One more line writes runs as a series that ParaView opens:
# ``sj.write_vtk("out/fields.pvd", structure, {"full": full, "reduced": reduced})``.
last = structure.unpacked(small.expand(reduced.final[0]))
print(f"its free end is left at {1e6 * last[-1, 0]:.2f} µm")
modes = structure.unpacked(system.expand(proper.modes[:, :4].T))[..., 0]
figure, (left, right) = plt.subplots(1, 2, figsize=(9.0, 3.8), layout="constrained")
left.plot(1e3 * structure.nodes[:, 0], modes.T, label=[f"mode {k}" for k in range(1, 5)])
left.set(xlabel="position, mm", ylabel="mode, norm 1")
for run, look in ((full, "c"), (by_hand, "r--"), (reduced, "k:")):
    right.plot(1e6 * run.point("free_end")[-201:], 1e-3 * run.amplitudes[-201:, 0], look)
right.legend(["full, 200 unknowns", "ten of its own modes", "one call, 13 unknowns"])
right.set(xlabel="displacement of the free end, µm", ylabel="force, kN")
left.legend(fontsize="small")
figure.savefig("reduced_structure.png", dpi=120)
