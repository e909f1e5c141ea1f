"""The structure of Fig. 18(b), full and reduced by proper orthogonal decomposition.

A bar of 0.6 m is pressed on a rigid base over its first 0.1 m and pulled at its free end at 500 Hz.
Strong and weak form as in ``lap_joint.py``, with friction in the joint only:

    rho A u'' - (E A (u_x + eps u'_x))_x + [x < 0.1 m] mu P w sigma(u') = 0.

The reduced basis holds proper orthogonal modes of the structure's static slip path, u = V q, for
which the full model is not run, the static response to the load and fixed-interface modes.
Galerkin's projection of Eqs. (4)-(9) makes a system of the same type from them. Contact points that
slip alike are merged, so that friction is evaluated at a few dozen points instead of a hundred.

Units: SI. Source: Journal of Sound and Vibration (2010), sections 5 to 7.3.
"""

# %% Full model
from pathlib import Path

import skfem_joint as sj

timing = {"cycles": 6, "steps_per_cycle": 200}
structure = sj.Structure(
    sj.load_meshes([Path(__file__).parents[1] / "meshes" / "structure.msh"]),
    sj.Material(E=200e9, density=8000.0),
    width=0.05,
    thickness=0.01,
    fixed=["fixed"],
    joints=[sj.Joint("joint", pressure=50e6, friction=0.7, normal_force="equal")],
    stiffness_damping=1e-5,
)
system = structure.system([sj.Load("free_end", sj.Harmonic(87.5e3, 500.0))])
full = sj.integrate(system, **timing)

# %% Reduced model: the same system type, the same integrator
small = sj.reduce(system, modes=10)
reduced = sj.integrate(small, **timing)
errors = sj.compare(full, reduced)

# %% Displacement of all nodes from the reduced unknowns
last = structure.unpacked(small.expand(reduced.final[0]))

if __name__ == "__main__":
    print(f"unknowns: {system.n} full, {small.n} reduced")
    print(f"friction points: {system.contact_points} full, {small.contact_points} reduced")
    print(f"peak displacement: {100 * errors.peak_displacement:+.2f} %")
    print(f"friction energy per cycle: {100 * errors.friction_energy_per_cycle:+.2f} %")
    print(f"run time: {1e3 * full.wall_s:.1f} ms full, {1e3 * reduced.wall_s:.1f} ms reduced")
