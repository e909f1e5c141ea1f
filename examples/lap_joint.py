"""The isolated lap joint of Fig. 1(b): micro-slip under a harmonic force, in a dozen lines.

Strong form, in the axial displacement u(x, t) of a bar pressed on a rigid base:

    rho A u'' - (E A (u_x + eps u'_x))_x + mu P w sigma(u') = 0,   0 < x < L,
    u(0, t) = 0,   E A (u_x + eps u'_x)(L, t) = F sin(2 pi f t),

with sigma(v) = 2/pi arctan(beta v), Eq. (2). Weak form: find u with u(0) = 0 such that

    (rho A u'', v) + (E A (u_x + eps u'_x), v_x) + (mu P w sigma(u'), v) = F sin(2 pi f t) v(L)

for all v with v(0) = 0. Linear elements; the friction integral is lumped at the nodes.

Units: SI. Source: Proper orthogonal decomposition of the dynamics in bolted joints, Journal of
Sound and Vibration (2010), sections 2.1, 3 and 4 (reference system, Table 1).
"""

# %% Mesh, structure and system
from pathlib import Path

import numpy as np
from paper import pseudo_static

import skfem_joint as sj

force, frequency = 63e3, 1000.0  # N, Hz
structure = sj.Structure(
    sj.load_meshes([Path(__file__).parents[1] / "meshes" / "lap_joint_250mm.msh"]),
    sj.Material(E=200e9, density=8000.0),
    width=0.05,
    thickness=0.01,
    fixed=["fixed"],
    joints=[sj.Joint("joint", pressure=8e6, friction=0.7, normal_force="equal")],
    stiffness_damping=1e-5,
)
system = structure.system([sj.Load("free_end", sj.Harmonic(force, frequency))])

# %% Three periods from rest, every state kept as a snapshot
run = sj.integrate(system, cycles=3, steps_per_cycle=200, save=sj.Save(fields=True))

# %% Proper orthogonal decomposition: the proper values of Table 1 (86.55, 10.24, 1.70, 0.73, 0.29)
proper = sj.proper_modes(run, snapshots="displacement", inner_product="euclidean")

# %% How far inertia takes the joint from the pseudo-static closed form
peak_static = pseudo_static.peak_displacement(force, EA=200e9 * 5e-4, tau=0.7 * 8e6 * 0.05)
peak = float(run.cycles.peak[-1, 0])

if __name__ == "__main__":
    print("proper values, %:", np.round(proper.proper_values[:5], 2))
    print(f"peak at the free end: {1e6 * peak:.2f} um, pseudo-static {1e6 * peak_static:.2f} um")
    print(f"friction energy in the last period: {run.cycles.friction[-1]:.3f} J")
    print(f"energy balance open by {run.energy_residual:.1e} of the energy in play")
