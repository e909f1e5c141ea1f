r"""
What is the paper's way, step by step?
======================================

A full run gives snapshots, their proper orthogonal decomposition gives modes, ten of them make a
reduced model, and that is run in turn. Each step is one line.

The structure is that of :doc:`reduced_structure`: a bar that is pressed on a rigid base over its
first 0.1 m and pulled at its free end at 500 Hz. With the snapshots
:math:`S = [u(t_1) \dots u(t_k)]` of the full run, the modes are the left singular vectors,

.. math::

   S = \Phi\,\Sigma\,\Psi^T, \qquad V = [\phi_1 \dots \phi_{10}], \qquad u = V q,

orthonormal in the Euclidean inner product, and the reduced model is the projection, Eqs. (4) to
(9). Such a model needs the full run that it should replace; ``sj.reduce`` and the paper's scaled
modes (:doc:`lap_joint_case_I`) do without. Units are SI. Source: Journal of Sound and Vibration
(2010), sections 3 and 5.
"""

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

# %%
# Full run, modes, projection, reduced run, errors.
system = structure.system([sj.Load("free_end", sj.Harmonic(87.5e3, 500.0))])
full = sj.integrate(system, **timing)
proper = sj.proper_modes(full, snapshots="displacement", inner_product="euclidean")
small = system.project(proper.modes[:, :10])
reduced = sj.integrate(small, **timing)
errors = sj.compare(full, reduced)
print(f"peak {100 * errors.peak_displacement:+.2f} %", end=", ")
print(f"all displacements {100 * errors.displacement_rms:.2f} %")
print(f"friction energy per cycle {100 * errors.friction_energy_per_cycle:+.2f} %")
print(f"ten modes leave {100 - proper.proper_values[:10].sum():.1e} % of the snapshots")

# %%
# Four of the modes, and the loops of the last cycle. One more line writes both runs as a series
# that ParaView opens: ``sj.write_vtk("out/fields.pvd", structure, {"full": full, "reduced":
# reduced})``.
figure, (left, right) = plt.subplots(1, 2, figsize=(9.0, 3.8), layout="constrained")
modes = structure.unpacked(system.expand(proper.modes[:, :4].T))[..., 0]
left.plot(1e3 * structure.nodes[:, 0], modes.T, label=[f"mode {k}" for k in range(1, 5)])
left.set(xlabel="position, mm", ylabel="mode, norm 1")
for run, look in ((full, {"c": "#7fb2e5", "lw": 4.0}), (reduced, {"c": "k", "ls": "--"})):
    right.plot(1e6 * run.point("free_end")[-201:], 1e-3 * run.amplitudes[-201:, 0], **look)
right.set(xlabel="displacement of the free end, µm", ylabel="force, kN")
right.legend(["full, 200 unknowns", "ten of its own modes"], fontsize="small")
left.legend(fontsize="small")
for panel in (left, right):
    panel.grid(alpha=0.3)
figure.savefig("paper_by_hand.png", dpi=120)
