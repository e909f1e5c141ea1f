r"""
What do friction and load do to the energy lost?
================================================

Twenty-five lap joints, of five friction coefficients under five loads, are run by two processes.
One closed form describes them all: the lost energy grows with the third power of the load and
falls with the friction coefficient.

Under loads so slow that inertia hardly counts, the bar of :doc:`lap_joint` slips over the length
:math:`F / \tau` from its free end, :math:`\tau = \mu P w`, and loses in each period the area of
its hysteresis loop,

.. math::

   W = \frac{2 F^3}{3 E A\,\tau} \qquad \text{while it sticks somewhere, } F < \tau L .

The scenes are the product of the values in the scene's table ``[sweep]``. Each is checked before
any is run, and a row comes for each as it finishes. Any executor of ``concurrent.futures`` runs
them. With a journal beside the scenes and executor, an interrupted sweep is taken up again.

The same by commands, with the scene as a text file to change::

    skfem-joint example lap_joint_sweep
    skfem-joint sweep lap_joint_sweep/lap_joint_sweep.toml --out lap_joint_sweep/out
"""

# %%
# The scenes, and what the closed form says of each.
from functools import partial
from pathlib import Path

import numpy as np

import skfem_joint as sj
from skfem_joint.output import plots
from skfem_joint.scene.shipped import shipped_scene
from skfem_joint.study.sweep import processes

FRICTION, FORCE = "joint[0].friction", "load[0].amplitude"
swept = sj.load_sweep(shipped_scene("lap_joint_sweep"))
tau = np.array([row[FRICTION] for row in swept.values]) * 8e6 * 0.05  # N/m
closed = 2.0 * np.array([row[FORCE] for row in swept.values]) ** 3 / (3.0 * 1e8 * tau)  # J

# %%
# Spawned processes read this file again, so that only the first one runs the sweep.
if __name__ == "__main__":
    rows = sorted(sj.sweep(swept.scenes, partial(processes, 2)), key=lambda row: row.number)
    loss = np.array([row.results["full.friction_energy_per_cycle_J"] for row in rows])
    away = loss / closed - 1.0
    print(f"{len(rows)} scenes, {sum(bool(row.failure) for row in rows)} of which failed")
    print(f"friction energy per cycle: {1e3 * loss.min():.3g} to {1e3 * loss.max():.3g} mJ")
    print(f"from the closed form: {100 * away.min():+.2f} % to {100 * away.max():+.2f} %")

    across = "friction coefficient", [row[FRICTION] for row in swept.values]
    up = "load, N", [row[FORCE] for row in swept.values]
    results = {"computed": loss, "pseudo-static closed form": closed}
    figure = plots.sweep_maps_figure(across, up, results, "friction energy per cycle", "J")
    plots.save_figure(Path("sweep.png"), figure)
