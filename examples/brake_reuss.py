"""The Brake-Reuss beam: two half beams of steel, lapped and clamped by three bolts of 12 kN.

The bolts' shanks are cut in the plane of the joint and pulled together; where the faces then touch
is found by a static contact solve. With this contact closed, but without friction, the tutorial of
Abaqus4Joints (N. Balaji, 2025) has 141.1, 152.4, 570.3 and 643.5 Hz with 40,657 nodes of first
order, and 143.7, 151.3, 575.1 and 642.8 Hz with springs in the contact. This mesh of 7,114 nodes of
second order has 145.3, 159.2, 584.5 and 651.4 Hz, one of 15,354 nodes (`brake_reuss(across=4)` of
meshes/make_meshes.py) 145.2, 159.0, 584.2 and 651.2 Hz: all but the second are within 1.7 % of the
published ones, and the second is 4.4 % higher.

The second is sideways bending. The faces slide freely on each other in it, and the shanks hold the
half beams like dowels: the tutorial has 151.3 Hz without any contact too. What is different are its
elements, with one point of integration each, and its nuts, which hold the shanks in the mean only.
Its mesh without contact has 149.5 Hz when it is assembled anew with such elements, 155.2 Hz with
elements that bend (incompatible modes), and 157.7 Hz with nuts joined to the shanks as well. These
shanks have 16 sides and 95 % of the circle's second moment of area; such ones have 157.4 Hz here.

With the contact stuck the first mode has 170.6 Hz. Loaded by half of what makes the joint slip as a
whole it has 158.9 Hz and a damping ratio of 3.3 %.
"""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import skfem_joint as sj

PUBLISHED = (141.1, 143.7), (151.3, 152.4), (570.3, 575.1), (642.8, 643.5)  # Hz

structure = sj.Structure(
    sj.load_meshes([Path(__file__).parents[1] / "meshes" / "brake_reuss.msh"]),
    sj.Material(E=200e9, density=7800.0, poisson=0.29),
    joints=[sj.Joint("upper_face", "preload", 0.6, against="lower_face", beta=np.inf)],
    bolts=[sj.Clamp(12e3, shank=(f"upper_cut_{i}", f"lower_cut_{i}")) for i in (1, 2, 3)],
    free=True,
)
(pressed,) = structure.preload.joints
system = structure.system(points=["upper_end"])
frequency = sj.natural_modes(system, 10).straining.frequencies

corners = structure.patches[0].cells
triangles = np.vstack([corners[:, [0, 1, 2]], corners[:, [0, 2, 3]]])
pressure = np.divide(pressed.force, pressed.area, out=0 * pressed.area, where=pressed.area > 0.0)
figure = Figure(figsize=(9.0, 2.6), layout="constrained")
panel = figure.subplots()
x, y, _ = 1e3 * structure.nodes.T
drawn = panel.tripcolor(x, y, 1e-6 * pressure, triangles=triangles, shading="gouraud")
figure.colorbar(drawn, label="pressure, MPa")
panel.set(xlabel="x, mm", ylabel="y, mm", aspect="equal", xlim=(-62.0, 62.0))

if __name__ == "__main__":
    figure.savefig("brake_reuss.png", dpi=150)
    print(f"pressed by {pressed.force.sum():.1f} N")
    for computed, published in zip(frequency, PUBLISHED, strict=False):
        print(f"{computed:.1f} Hz; published {published[0]} to {published[1]} Hz")
    (curve,) = sj.backbone(system, modes=[7], levels=8, up_to=0.5)  # after six rigid ones
    print(f"damping ratio {curve.damping_ratio} at {curve.frequency} Hz")
