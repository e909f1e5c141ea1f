"""Friction and load of a lap joint swept by two processes: one law for the loss of 25 scenes.

The bar of ``lap_joint.py`` under loads so slow that inertia hardly counts. It slips over the length
F / tau from its free end, tau = mu P w, and loses in each period the area of its hysteresis loop,

    W = 2 F^3 / (3 E A tau),

which holds while it still sticks somewhere, F < tau L. The scenes come from the product of the
values in ``lap_joint_sweep.toml``; each is checked before any is run, and a row comes for each as
it finishes. Any executor of ``concurrent.futures`` runs them, that of a ``dask`` cluster too. With
a journal beside the scenes and executor, an interrupted sweep goes on where it was.

Units: SI. Checks: the closed form above; the picture is written to ``sweep.png``.
"""

# %% Scenes, and what the closed form says of each
from functools import partial
from pathlib import Path

import numpy as np
from paper.pseudo_static import loop_energy

import skfem_joint as sj
from skfem_joint.analysis.sweep import processes
from skfem_joint.output import plots

FRICTION, FORCE = "joint[0].friction", "load[0].amplitude"
swept = sj.load_sweep(Path(__file__).parent / "lap_joint_sweep.toml")
closed = [loop_energy(row[FORCE], EA=1e8, tau=row[FRICTION] * 8e6 * 0.05) for row in swept.values]

# %% Processes that are spawned read this file again, so that only the first one runs the sweep
if __name__ == "__main__":
    rows = sorted(sj.sweep(swept.scenes, partial(processes, 2)), key=lambda row: row.number)
    loss = np.array([row.results["full.friction_energy_per_cycle_J"] for row in rows])
    away = loss / closed - 1.0
    across = "friction coefficient", [row[FRICTION] for row in swept.values]
    up = "load, N", [row[FORCE] for row in swept.values]
    results = {"computed": loss, "pseudo-static closed form": closed}
    figure = plots.sweep_maps_figure(across, up, results, "friction energy per cycle", "J")
    plots.save_figure(Path("sweep.png"), figure)
    print(f"{len(rows)} scenes, {sum(bool(row.failure) for row in rows)} of which failed")
    print(f"friction energy per cycle: {1e3 * loss.min():.3g} to {1e3 * loss.max():.3g} mJ")
    print(f"from the closed form: {100 * away.min():+.2f} % to {100 * away.max():+.2f} %")
