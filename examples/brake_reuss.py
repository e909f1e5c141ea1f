"""The Brake-Reuss beam: two half beams of steel, lapped and clamped by three bolts of 12 kN.

The bolts' shanks are cut in the plane of the joint and pulled together; where the faces then touch
is found by a static contact solve. With this contact closed, but without friction, the tutorial of
Abaqus4Joints (N. Balaji, 2025) has 141.1, 152.4, 570.3 and 643.5 Hz with 40,657 nodes of first
order, and 143.7, 151.3, 575.1 and 642.8 Hz with springs in the contact. This mesh of 7,114 nodes of
second order gives frequencies within 1.5 % of theirs. That of sideways bending, the second, hangs
on the bolts' shanks, whose sections are octagons here: with 16 sides (`brake_reuss(across=4)` of
meshes/make_meshes.py) they give 157.3 Hz.
"""

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import skfem_joint as sj
from skfem_joint.modes import straining_modes

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
frequency, _ = straining_modes(system.K, system.M, np.zeros(0, dtype=int), count=10)

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
    for found, published in zip(frequency, PUBLISHED, strict=False):
        print(f"{found:.1f} Hz; published {published[0]} to {published[1]} Hz")
    (curve,) = sj.backbone(system, modes=[7], levels=8, up_to=0.5)  # after six rigid ones
    print(f"damping ratio {curve.damping_ratio} at {curve.frequency} Hz")
