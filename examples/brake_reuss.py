r"""
What does a bolted beam of solids vibrate at, and how much does it damp?
========================================================================

The Brake-Reuss beam: two half beams of steel, lapped and clamped by three bolts of 12 kN, which
are meshed. A static contact solve finds where the half beams touch; then the natural frequencies
of the loose beam stand beside published ones, and quasi-static modal analysis gives the damping
of the first mode against its amplitude.

The bolts' shanks are cut in the plane of the joint and pulled together. With the pressure of the
contact solve, friction holds each point up to :math:`\mu\,p` per area. A mode :math:`\phi` is
loaded by its own inertia :math:`\alpha M\phi` at rising levels :math:`\alpha`; the secant gives its
frequency, and the area of the loop its damping ratio,

.. math::

   (2\pi f)^2 = \frac{\alpha}{q(\alpha)}, \qquad
   \zeta = \frac{W(\alpha)}{2\pi\,\alpha\,q(\alpha)} .

With this contact closed, but without friction, the tutorial of Abaqus4Joints (N. Balaji, 2025) has
141.1, 152.4, 570.3 and 643.5 Hz with 40,657 nodes of first order, and 143.7, 151.3, 575.1 and
642.8 Hz with springs in the contact. This mesh has 7,114 nodes of second order; one of 15,354
nodes (``brake_reuss(across=4)`` of ``meshes/make_meshes.py``) gives 145.2, 159.0, 584.2 and
651.2 Hz.
"""

# %%
# The structure and its preload. The mesh is in the folder ``meshes`` of the repository. The faces
# stay closed and keep their normal forces, unless it is started with ``--contact unilateral``.
import sys
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import skfem_joint as sj

contact = "unilateral" if "unilateral" in sys.argv else "constant"
structure = sj.Structure(
    Path(sys.argv[0]).resolve().parents[1] / "meshes" / "brake_reuss.msh",
    sj.Material(E=200e9, density=7800.0, poisson=0.29),
    joints=[sj.Joint("upper_face", "preload", 0.6, against="lower_face", contact=contact)],
    bolts=[sj.Clamp(12e3, shank=(f"upper_cut_{i}", f"lower_cut_{i}")) for i in (1, 2, 3)],
    free=True,
)
(pressed,) = structure.preload.joints
system = structure.system(points=["upper_end"])
print(f"{system.n} unknowns, pressed by {pressed.force.sum():.1f} N")

# %%
# Frequencies with the contact closed and frictionless, beside the published ones: 1 to 3 % above
# them, the second 4.5 to 5.2 %. That is sideways bending, in which the shanks hold the half beams
# like dowels, and which depends on the elements: the tutorial's mesh has 157.7 Hz with elements
# that bend (incompatible modes) and nuts joined to the shanks, as they are here.
PUBLISHED = (141.1, 143.7), (151.3, 152.4), (570.3, 575.1), (642.8, 643.5)  # Hz
frequency = sj.natural_modes(system, 10).straining.frequencies
for computed, published in zip(frequency, PUBLISHED, strict=False):
    print(f"{computed:.1f} Hz; published {published[0]} to {published[1]} Hz")

# %%
# Frequency and damping of the first mode (after six rigid ones), up to half of the level at which
# the joint slips as a whole.
(curve,) = sj.backbone(system, modes=[7], levels=8, up_to=0.5)
print(f"stuck {curve.stuck_frequency:.1f} Hz; at the highest level {curve.frequency[-1]:.1f} Hz,")
print(f"damping ratio {100 * curve.damping_ratio[-1]:.2f} %")

# %%
# The pressure between the half beams, and the damping ratio over the amplitude of the beam's end.
corners = structure.patches[0].cells
triangles = np.vstack([corners[:, [0, 1, 2]], corners[:, [0, 2, 3]]])
pressure = np.divide(pressed.force, pressed.area, out=0 * pressed.area, where=pressed.area > 0.0)
figure, (face, damping) = plt.subplots(2, figsize=(8.0, 5.0), layout="constrained")
x, y, _ = 1e3 * structure.nodes.T
drawn = face.tripcolor(x, y, 1e-6 * pressure, triangles=triangles, shading="gouraud")
figure.colorbar(drawn, label="pressure, MPa")
face.set(xlabel="x, mm", ylabel="y, mm", aspect="equal", xlim=(-62.0, 62.0))
reach = 1e3 * abs(curve.displacement).max(axis=1)
damping.plot(reach, 100 * curve.damping_ratio, "o-")
damping.set(xlabel="amplitude of the beam's end, mm", ylabel="damping ratio, %")
damping.grid(alpha=0.3)
figure.savefig("brake_reuss.png", dpi=120)
