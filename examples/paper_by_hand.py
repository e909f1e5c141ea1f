"""The paper's way by hand: a full run, its proper orthogonal modes, projection, a reduced run.

A bar is pressed on a rigid base over its first 0.1 m and pulled at its free end at 500 Hz, as in
``reduced_structure.py``. Snapshots are the displacements of the full run, modes are orthonormal in
the Euclidean inner product, and ten of them make the reduced model u = V q by Eqs. (4)-(9).

Units: SI. Source: Journal of Sound and Vibration (2010), sections 3 and 5.
"""

from pathlib import Path

import skfem_joint as sj

structure = sj.Structure(
    Path(__file__).parents[1] / "meshes" / "structure.msh",
    sj.Material(E=200e9, density=8000.0),
    width=0.05,
    thickness=0.01,
    fixed=["fixed"],
    joints=[sj.Joint("joint", pressure=50e6, friction=0.7, normal_force="equal")],
    stiffness_damping=1e-5,
)
timing = {"cycles": 6, "steps_per_cycle": 200, "save": sj.Save(fields=True, fields_every=10)}
system = structure.system([sj.Load("free_end", sj.Harmonic(87.5e3, 500.0))])
full = sj.integrate(system, **timing)
proper = sj.proper_modes(full, snapshots="displacement", inner_product="euclidean")
small = system.project(proper.modes[:, :10])
reduced = sj.integrate(small, **timing)
errors = sj.compare(full, reduced)

if __name__ == "__main__":
    print(
        f"peak {100 * errors.peak_displacement:+.2f} %, all {100 * errors.displacement_rms:.2f} %"
    )
    print(f"friction energy per cycle {100 * errors.friction_energy_per_cycle:+.2f} %")
    sj.write_vtk("out/paper_by_hand.pvd", structure, {"full": full, "reduced": reduced})
