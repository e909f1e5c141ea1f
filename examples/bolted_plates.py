r"""
What do bolts hold where two plates are meshed apart?
=====================================================

Two plates overlap on 100 mm and are held together by two bolts. Their meshes do not match, and
the slip is a vector in the plane. What the bolts hold is twice the friction coefficient times the
force of a bolt, on any mesh.

Both bodies are in plane stress. Where the upper plate is pressed on the lower one with the
pressure :math:`p(x)` under the bolts' heads, friction acts on the relative slip
:math:`s = u_\text{upper} - u_\text{lower}`:

.. math::

   \rho\,\ddot u = \nabla\cdot\sigma(u + \varepsilon\dot u), \qquad
   t_\text{upper} = -\mu\,p\,\frac{\dot s}{|\dot s|}, \qquad t_\text{lower} = -t_\text{upper} .

The pressure of a bolt is even on the ring to which the cone under its head spreads; its total is
the bolt's force. Forces and moments on the two plates are in balance to round-off. Units are SI.
"""

# %%
# Two plates with elements of different sizes, and two bolts of 10 kN.
from pathlib import Path

import skfem_joint as sj
from skfem_joint.output import plots

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
print(f"{system.n} unknowns, {system.contact.count} contact points")
print(f"friction limit: {system.contact.w.sum():.0f} N")

# %%
# Two periods under three quarters of the friction limit.
run = sj.integrate(system, cycles=2, steps_per_cycle=100)
print(f"peak of the pulled end: {1e6 * run.peak_of('upper_right'):.2f} µm")
print(f"friction energy in the second period: {1e3 * run.cycles.friction[-1]:.3f} mJ")
print(f"energy balance open by {run.energy_residual:.1e} of the energy in play")

# %%
# The largest slip of the points under the bolts, with those that slip outlined.
region, patch = sj.active_region(structure, run), structure.patches[0]
slip, slips = region.slip_peak[patch.points], region.slips[patch.points]
figure = plots.active_region_figure(structure.body, patch, slip, slips)
plots.save_figure(Path("bolted_plates.png"), figure)
