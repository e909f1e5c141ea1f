"""Two plates held together by two bolts: friction on their relative slip, in the plane.

Plane stress in both bodies, rho u'' = div sigma(u), each with sigma(u) = C (eps(u) + eps(u)').
Where the upper plate is pressed on the lower one with the pressure p(x) under the bolts' heads,
friction acts on the relative slip s = u_upper - u_lower, a vector:

    t = -mu p sgn(|s'|) s' / |s'|  on the upper plate, -t on the lower one.

The pressure of a bolt is even on the ring to which the cone under its head spreads; its total is
the bolt's force on any mesh. The meshes of the plates need not match.

Units: SI. Checks: forces on both plates in balance, and the friction limit 2 mu F of two bolts.
"""

# %% Two plates that overlap on 100 mm, meshed apart from each other
import skfem_joint as sj

lower = sj.build_plate([("lower_arm", 0.1, 10), ("lower_lap", 0.1, 20)], 0.04, 8, prefix="lower_")
upper = sj.build_plate(
    [("upper_lap", 0.1, 16), ("upper_arm", 0.1, 10)], 0.04, 6, prefix="upper_", origin=(0.1, 0.0)
)
bolts = [sj.Bolt((x, 0.02), force=10e3, head_radius=0.008, hole_radius=0.004) for x in (0.13, 0.17)]
structure = sj.Structure(
    sj.merged([lower, upper]),
    sj.Material(E=200e9, density=8000.0, poisson=0.3),
    thickness=0.005,
    fixed=["lower_left"],
    joints=[sj.Joint("upper_lap", sj.Bolts(tuple(bolts), reach=0.005), 0.3, against="lower_lap")],
    stiffness_damping=1e-6,
)
pull = sj.Load("upper_right", sj.Harmonic(4.5e3, 500.0), direction=(1.0, 0.0))
system = structure.system([pull], points=["upper_right"])

# %% Two periods under three quarters of the friction limit
run = sj.integrate(system, cycles=2, steps_per_cycle=100)

if __name__ == "__main__":
    print(f"{system.n} unknowns, {system.contact_points} contact points")
    print(f"friction limit: {system.w.sum():.0f} N")
    print(f"peak of the pulled end: {1e6 * run.peak_of('upper_right'):.2f} um")
    print(f"friction energy in the second period: {1e3 * run.cycles.friction[-1]:.3f} mJ")
