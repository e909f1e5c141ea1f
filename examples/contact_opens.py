r"""
What does a joint lose whose faces come apart?
==============================================

A block is pressed on a base by 400 kN. One load lifts its left side by up to 15 % of that, another
one pushes it along the base at the same time, both so slowly that inertia does not matter. The gap
:math:`g = g_0 - N u` at each pressure point and its normal force :math:`p` obey

.. math::

   p \ge 0, \qquad g \ge 0, \qquad p\,g = 0, \qquad |q| \le \mu\,p ,

so the friction force :math:`q` is limited by the normal force of the moment. It is small where the
block is lifted, and large where it is pressed down. A joint whose normal forces keep their values
at rest, :math:`|q| \le \mu\,p_0`, cannot know of either. The loops of both kinds of contact are
drawn, and the pressure on the base at the two peaks of the load.
"""

# %%
# The block, 80 mm x 30 mm and 0.1 m thick, with two loads on its left side at once.
import matplotlib.pyplot as plt
import numpy as np

import skfem_joint as sj

length, height, thickness, pressure = 0.08, 0.03, 0.1, 50e6
pressed = pressure * length * thickness
sides = {"base": "bottom", "left": "left", "right": "right"}
mesh = sj.build_plate([("block", length, 32)], height, 12, boundaries=sides)
loads = [
    sj.Load("left", sj.Harmonic(0.15 * pressed, 1.0), direction=[0.0, 1.0]),
    sj.Load("left", sj.Harmonic(0.4 * pressed, 1.0), direction=[1.0, 0.0]),
]

# %%
# Two slow cycles with each kind of contact. The loops are those of the friction force of the whole
# joint over its mean slip; their energies come with their estimated errors.
figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4.2), layout="constrained")
for contact, style in (("constant", "--"), ("unilateral", "-")):
    joint = sj.Joint("base", pressure, friction=0.5, contact=contact)
    steel = sj.Material(E=200e9, density=8000.0, poisson=0.3)
    block = sj.Structure(mesh, steel, thickness=thickness, fixed_x=["right"], joints=[joint])
    save = sj.Save(fields=True)
    run = sj.quasi_static(block.system(loads), cycles=2, steps_per_cycle=80, save=save)
    lost, error = run.cycles.friction[-1], sj.estimate(run).of("total", "friction_energy")
    print(f"{contact}: {lost:.4f} J a cycle, estimated error {100 * error:.2g} %")
    slip, force = run.loops.slip[run.loops.last, 0], run.loops.force[run.loops.last, 0]
    left.plot(1e6 * slip, 1e-3 * force, style, label=f"{contact} contact: {lost:.3g} J a cycle")

# %%
# The last of the two runs has contact that opens. Its pressures on the base differ at the two peaks
# of the load: the faces come apart at the edge that is lifted most.
face = block.patches[0].opening
for step, name in ((100, "lifted most"), (140, "pressed most")):
    pressures = run.normal_force[step] / face.area
    print(f"{name}: {100 * np.mean(pressures == 0.0):.3g} % of the pressure points are apart")
    place = 1e3 * block.nodes[face.nodes, 0]
    right.plot(place, 1e-6 * pressures, ".-", label=f"{name}, at {run.field_times[step]:.2f} s")
right.axhline(1e-6 * pressure, color="0.5", linestyle="--", label="at rest; constant contact")

# %%
# With contact that opens the block has moved in the first cycle to where it was pushed while its
# left side was lifted: it does not slip back as far while that side is pressed down. Its loop there
# is narrower than that of constant contact, and not alike in both directions.
left.set(xlabel="mean slip of the joint, µm", ylabel="friction force of the joint, kN")
right.set(xlabel="place on the base, mm", ylabel="pressure, MPa")
for panel in (left, right):
    panel.legend(fontsize="small")
    panel.grid(alpha=0.3)
figure.savefig("contact_opens.png", dpi=120)
