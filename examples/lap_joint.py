r"""
How many modes does a lap joint have?
=====================================

A bar of 250 mm, pressed on a rigid base over its whole length and pulled at 1000 Hz, slips in so
similar shapes at all times that one proper orthogonal mode holds 87 % of its motion and five hold
all but 0.1 %. This is Table 1 of the paper.

Strong form, in the axial displacement :math:`u(x, t)`:

.. math::

   \rho A\,\ddot u - \frac{\partial}{\partial x}\bigl(E A\,(u_x + \varepsilon\dot u_x)\bigr)
   + \mu\,P\,w\,\sigma(\dot u) = 0, \quad 0 < x < L, \qquad u(0, t) = 0,
   \qquad E A\,(u_x + \varepsilon\dot u_x)(L, t) = F\sin 2\pi f t,

with :math:`\sigma(v) = \frac{2}{\pi}\arctan\beta v`, Eq. (2). Weak form: find :math:`u` with
:math:`u(0) = 0` such that for all :math:`v` with :math:`v(0) = 0`

.. math::

   (\rho A\,\ddot u, v) + (E A\,(u_x + \varepsilon\dot u_x), v_x)
   + (\mu\,P\,w\,\sigma(\dot u), v) = F\sin(2\pi f t)\;v(L) .

Linear elements are used, and the integral of friction is lumped at the nodes. The proper
orthogonal modes are the left singular vectors of the snapshots
:math:`[u(t_1) \dots u(t_k)]`, and the proper values their squared singular values in percent of
the sum. Units are SI. Source: Proper orthogonal decomposition of the dynamics in bolted joints,
Journal of Sound and Vibration (2010), sections 2.1, 3 and 4.
"""

# %%
# Mesh, structure and system: 100 elements, a pressure of 8 MPa, and a force of 90 % of what
# friction holds.
import matplotlib.pyplot as plt
import numpy as np

import skfem_joint as sj

force, frequency = 63e3, 1000.0  # N, Hz
structure = sj.Structure(
    sj.build_bar([("joint", 0.25, 100)], {"fixed": 0.0, "free_end": 0.25}),
    sj.Material(E=200e9, density=8000.0),
    width=0.05,
    thickness=0.01,
    fixed=["fixed"],
    joints=[sj.Joint("joint", pressure=8e6, friction=0.7, beta=1e5, normal_force="equal")],
    stiffness_damping=1e-5,
)
system = structure.system([sj.Load("free_end", sj.Harmonic(force, frequency))])

# %%
# Three periods from rest, of which every state is kept as a snapshot, and the proper orthogonal
# decomposition. Table 1 has the proper values 86.55, 10.24, 1.70, 0.73 and 0.29 %.
run = sj.integrate(system, cycles=3, steps_per_cycle=200, save=sj.Save(fields=True))
proper = sj.proper_modes(run, snapshots="displacement", inner_product="euclidean")
print("proper values, %:", np.round(proper.proper_values[:5], 2))

# %%
# Inertia takes the joint beyond the closed form of a slow load with Coulomb friction,
# :math:`F^2 / (2 E A \tau)` with :math:`\tau = \mu P w`.
peak_static = force**2 / (2.0 * 200e9 * 5e-4 * 0.7 * 8e6 * 0.05)
peak = float(run.cycles.peak[-1, 0])
print(f"peak at the free end: {1e6 * peak:.2f} µm, of a slow load {1e6 * peak_static:.2f} µm")
print(f"friction energy in the last period: {run.cycles.friction[-1]:.3f} J")
print(f"energy balance open by {run.energy_residual:.1e} of the energy in play")

# %%
# The proper values, and the first four modes.
figure, (left, right) = plt.subplots(1, 2, figsize=(9.0, 3.6), layout="constrained")
left.bar(np.arange(1, 9), proper.proper_values[:8], color="#2f6db3")
left.set(xlabel="mode", ylabel="proper value, %", yscale="log")
modes = structure.unpacked(system.expand(proper.modes[:, :4].T))[..., 0]
right.plot(1e3 * structure.nodes[:, 0], modes.T, label=[f"mode {k}" for k in range(1, 5)])
right.set(xlabel="position, mm", ylabel="mode, norm 1")
right.legend(fontsize="small")
right.grid(alpha=0.3)
figure.savefig("lap_joint.png", dpi=120)
