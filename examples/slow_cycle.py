r"""
What loop has a joint that is loaded slowly?
============================================

A bar is pressed on its base along its first 0.2 m and pulled back and forth so slowly that inertia
and damping do not matter. Each level of the load is then one convex minimisation,
:math:`\min_d \frac12 d^T K d - (f - K u)^T d + \sum w |B d|`, and the loop of the joint is its
friction force over its slip,

.. math::

   Q = \sum_p q_p , \qquad s = \sum_p w_p\,s_p \Big/ \sum_p w_p .

The loops of three amplitudes are drawn. Their energies are compared with that of the bar,
:math:`2 F^3 / (3 E A \tau)`, with the friction force :math:`\tau` per length. At the largest
amplitude half of the joint slips. The area of the curves drawn is **not** that energy: the points
at the joint's edge slip more than its mean. The energy is the sum over all points of force times
slip, which balances the work of the load to round-off.
"""

# %%
# A bar of 0.2 m of joint, which holds 350 kN, and 0.3 m beyond it.
import matplotlib.pyplot as plt

import skfem_joint as sj

E, width, thickness, pressure, friction = 200e9, 0.05, 0.01, 50e6, 0.7
structure = sj.Structure(
    sj.build_bar([("joint", 0.2, 200), ("free", 0.3, 60)], {"fixed": 0.0, "end": 0.5}),
    sj.Material(E=E, density=8000.0),
    width=width,
    thickness=thickness,
    fixed=["fixed"],
    joints=[sj.Joint("joint", pressure, friction, normal_force="consistent")],
)
limit = friction * pressure * width * 0.2

# %%
# Two cycles at each amplitude; the second one is closed.
figure, panel = plt.subplots(figsize=(6.5, 4.2), layout="constrained")
runs, exact = {}, {}
for share in (0.5, 0.35, 0.2):
    force = share * limit
    system = structure.system([sj.Load("end", sj.Harmonic(force, 1.0))])
    run = runs[share] = sj.quasi_static(system, cycles=2, steps_per_cycle=200)
    exact[share] = 2 * force**3 / (3 * E * width * thickness * friction * pressure * width)
    loops, lost = run.loops, run.cycles.friction[-1]
    error = sj.estimate(run).of("total", "friction_energy")
    print(
        f"{1e-3 * force:.0f} kN: {lost:.4f} J a cycle, closed form {exact[share]:.4f} J,", end=" "
    )
    print(f"estimated error {100 * error:.2g} %, stiffness {loops.secant_stiffness[0]:.3g} N/m")
    panel.plot(
        1e6 * loops.slip[loops.last, 0],
        1e-3 * loops.force[loops.last, 0],
        label=f"{1e-3 * force:.0f} kN: {lost:.3g} J a cycle",
    )

# %%
# The curves are steep after each reversal, where nearly all of the joint sticks, and bend as slip
# reaches further into it.
panel.set(xlabel="mean slip of the joint, µm", ylabel="friction force of the joint, kN")
panel.legend(loc="upper left", fontsize="small")
panel.grid(alpha=0.3)
figure.savefig("slow_cycle.png", dpi=120)
