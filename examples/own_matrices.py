r"""
Can a model of another program be given joints?
===============================================

Yes: a scene takes matrices in files in place of a mesh. Here another program has exported the
stiffness and the mass of a chain of eight masses; a text file adds a friction contact at its end,
a load, and the length of the run.

The table ``[matrices]`` names the files and the pairs of degrees of freedom that a contact joins,
here one of the chain and a rigid base. The scene then makes

.. math::

   M\ddot u + C\dot u + K u + B^T\bigl(w\,\sigma(B\dot u)\bigr) = f(t), \qquad w = \mu\,p\,A,

with the friction coefficient, the pressure and the area of each pair. A file of a matrix is one of
``scipy.sparse`` (``.npz``), MatrixMarket (``.mtx``) or MATLAB (``.mat``).

A command runs such a scene too::

    skfem-joint run chain.toml --out out
"""

# %%
# The scene. A row of the contact's file has the x, y and z degrees of freedom of a node, those of
# the node that it is pressed on (none: a rigid base), the normal, and the area in m².
from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt
import numpy as np
from scipy import sparse

import skfem_joint as sj

SCENE = """
damping = { stiffness = 3e-4 }   # C = stiffness * K, s
time = { cycles = 12, steps_per_cycle = 200 }

[matrices]
K = "K.npz"
M = "M.npz"
contact = { foot = "foot.csv" }
points = { end = 7 }

[[joint]]
on = "foot"
pressure = 2e6                   # Pa, on 1e-3 m2
friction = 0.3

[[load]]
on = "end"
kind = "harmonic"
amplitude = 1000.0               # N
frequency = 20.0                 # Hz
"""
k, m = 5e6, 2.0  # N/m, kg; the first mass hangs on a wall by a spring, the last one is free
stiffness = k * sparse.diags_array(
    [-np.ones(7), np.r_[np.full(7, 2.0), 1.0], -np.ones(7)], offsets=[-1, 0, 1]
)

# %%
# The files, and two runs: without friction and with a limit of 0.3 x 2 MPa x 1e-3 m² = 600 N.
with TemporaryDirectory() as name:
    folder = Path(name)
    sparse.save_npz(folder / "K.npz", stiffness.tocsr())
    sparse.save_npz(folder / "M.npz", sparse.csr_array(m * sparse.eye_array(8)))
    (folder / "foot.csv").write_text("7,,,,,,0,0,1,1e-3\n")
    (folder / "chain.toml").write_text(SCENE)
    scene = sj.load_scene(folder / "chain.toml")
    studies = {mu: sj.run_scene(scene.changed(joint={"friction": mu})) for mu in (0.0, 0.3)}

# %%
# The loops of the end in the last cycle. Without friction viscous damping is left.
figure, panel = plt.subplots(figsize=(6.5, 4.0), layout="constrained")
for mu, study in studies.items():
    run = study.runs["full"]
    print(f"friction {mu}: the end moves by {1e3 * run.cycles.peak[-1, 0]:.3f} mm,", end=" ")
    print(f"friction takes {run.cycles.friction[-1]:.3f} J in the last cycle")
    panel.plot(1e3 * run.point("end")[-201:], run.amplitudes[-201:, 0], label=f"friction {mu}")
panel.set(xlabel="displacement of the end, mm", ylabel="force, N")
panel.legend()
panel.grid(alpha=0.3)
figure.savefig("own_matrices.png", dpi=120)
