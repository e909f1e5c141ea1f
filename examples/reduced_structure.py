"""The structure of Fig. 18(b), reduced by the modes of another joint.

A bar of 0.6 m is pressed on a rigid base over its first 0.1 m and pulled at its free end at 500 Hz.
Strong and weak form as in ``lap_joint.py``, with friction in the joint only:

    rho A u'' - (E A (u_x + eps u'_x))_x + [x < 0.1 m] mu P w sigma(u') = 0.

The reduced basis holds five proper orthogonal modes of the paper's *reference* joint (another
length, pressure, force and frequency), stretched to this joint's active length and carried rigidly
over the linear region, the static response of the linear region to the load, and its first two
fixed-interface modes: u = V q, and Galerkin's projection of Eqs. (4)-(9). Friction is evaluated at
the twelve points of a Gauss rule instead of a hundred nodes.

Units: SI. Source: Journal of Sound and Vibration (2010), sections 5 to 7.3.
"""

# %% Full model
from pathlib import Path

from skfem_joint.history import compare
from skfem_joint.hyper_reduction import with_friction_points
from skfem_joint.integrate import integrate
from skfem_joint.loads import Harmonic
from skfem_joint.meshing import load_mesh
from skfem_joint.reduction import active_zones, estimate_active_length, structure_basis
from skfem_joint.reference import paper_reference
from skfem_joint.structure import Joint, assemble, build_structure

force, frequency, steps, cycles = 87.5e3, 500.0, 200, 6
structure = build_structure(
    load_mesh(Path(__file__).parents[1] / "meshes" / "structure.msh"),
    E=200e9,
    density=8000.0,
    width=0.05,
    thickness=0.01,
    fixed=["fixed"],
    joints=[Joint("joint", pressure=50e6, friction=0.7, beta=1e5, normal_force="equal")],
    stiffness_damping=1e-5,
)
system = assemble(structure, [("free_end", Harmonic(force, frequency))])
timing = {
    "step": 1.0 / frequency / steps,
    "n_steps": cycles * steps,
    "cycle_steps": steps,
}
full = integrate(system, **timing)

# %% Active length by Eqs. (17)-(20), from the linear analysis of the structure
(zone,) = active_zones(structure, system)
guess = estimate_active_length(structure, system, zone, [force], frequency)

# %% Reduced model: the same system type, the same integrator
V = structure_basis(
    structure, system, paper_reference(), [zone], [guess.length], modes=5, interface_modes=2
)
contact = structure.free[system.B.indices]
active = (structure.position[zone.nodes[0]] - structure.position[contact]) < guess.length
reduced_system = with_friction_points(
    system.project(V), structure.position[contact], [active.nonzero()[0]], 12
)
reduced = integrate(reduced_system, **timing)
errors = compare(full, reduced)

if __name__ == "__main__":
    print(f"active length: {1e3 * guess.length:.2f} mm after {len(guess.factors)} iterations")
    print(f"unknowns: {system.n} full, {reduced_system.n} reduced")
    print(f"peak displacement: {100 * errors.peak_displacement:+.2f} %")
    print(f"friction energy per cycle: {100 * errors.friction_energy_per_cycle:+.2f} %")
    print(f"run time: {1e3 * full.wall_s:.1f} ms full, {1e3 * reduced.wall_s:.1f} ms reduced")
