r"""
What does a measured damping curve say about a joint?
=====================================================

Friction and stiffness of a joint are seldom known. Here they are fitted to frequency and damping of
the first mode over its amplitude, as an experiment would give them. The "experiment" is the bar of
:doc:`structure_harmonic` with other values and noise, so that the truth is known: 2 % of the
damping, and 2 % of the change of the frequency.

The fit minimises the squares of the residuals over their standard deviations,

.. math::

   r = \frac{\text{model}(p) - \text{measured}}{\text{standard deviation}} ,

with exact derivatives of the curve by the values :math:`p`. Its covariance, from the derivatives
:math:`J` of the residuals, is :math:`(J^T J)^{-1}`. :doc:`fit_sampler` compares it with a sampler.

By a command: ``skfem-joint fit SCENE.toml --data measured.csv --free "joint[0].friction=0.1..2"
--out DIR``.
"""

# %%
# The scene, with a first guess of its values, and an experiment with others.
import matplotlib.pyplot as plt
import numpy as np

import skfem_joint as sj
from skfem_joint.scene.shipped import shipped_scene

keys = "joint[0].friction", "joint[0].tangential_stiffness", "damping.ratio"
guess, truth = (dict(zip(keys, x, strict=True)) for x in ((0.7, 3e11, 1e-3), (0.9, 6e11, 2e-3)))
free = dict(zip(keys, ((0.1, 2.0), (3e10, 3e12), (2e-4, 2e-2)), strict=True))
scene = sj.load_scene(shipped_scene("structure_harmonic")).changed(guess, joint={"law": "coulomb"})
(curve,) = sj.backbone(scene.changed(truth).system(), levels=12, up_to=0.6)
noise = np.random.default_rng(5).normal(size=(2, 12))
deviations = np.full(12, 0.02 * np.ptp(curve.frequency)), 0.02 * curve.damping_ratio
names = "amplitude", "frequency", "damping", "frequency_deviation", "damping_deviation"
exact = curve.frequency, curve.damping_ratio
noisy = (x + s * n for x, s, n in zip(exact, deviations, noise, strict=True))
table = dict(zip(names, (curve.displacement[:, 0], *noisy, *deviations), strict=True))
measured = sj.measured_curve(table, name="experiment", unit="m", point="free_end")

# %%
# The fit: values with their standard deviations, and the curves that were computed for it.
fit = sj.fit(scene, measured, free)
for key, value in fit.values.items():
    low, high = fit.interval(key)
    print(f"{key}: {value:.4g}, 95 % from {low:.4g} to {high:.4g}; true {truth[key]:.4g}")
print(f"{fit.computed} curves, squares {fit.sum_of_squares:.3g} of {fit.degrees} degrees")

# %%
# With a constant normal force friction and pressure enter as their product alone. If both are free
# the fit says so.
print(sj.fit(scene, measured, free | {"joint[0].pressure": (2e7, 1e8)}).undetermined[0])

# %%
# A band of any other result: values are drawn from the covariance, and the scene is run with each
# of them. Here it is the largest displacement of the free end under the scene's own load.
some = [scene.changed(x).system() for x in fit.draws(20)]
peaks = [sj.integrate(x, cycles=4, steps_per_cycle=100).peak_of("free_end") for x in some]
low, high = 1e3 * np.quantile(peaks, [0.025, 0.975])
print(f"largest displacement: 95 % from {low:.4f} to {high:.4f} mm")

# %%
# The fitted curve in its band.
(fitted,), bands = fit.predicted, fit.band(fit.predicted[0])
figure, panels = plt.subplots(1, 2, figsize=(9.0, 3.8), layout="constrained")
labels = ("frequency", "frequency, Hz", 1.0), ("damping", "damping ratio, %", 100.0)
for panel, (name, label, factor), band, error in zip(
    panels, labels, bands, deviations, strict=True
):
    x, best = 1e3 * fitted.displacement, factor * getattr(fitted, name)
    panel.fill_between(x, best - factor * band, best + factor * band, alpha=0.3, label="95 % band")
    panel.semilogx(x, best, label="fit")
    panel.errorbar(x, factor * table[name], factor * error, fmt="k.", label="data")
    panel.set(xlabel="amplitude of the free end, mm", ylabel=label)
panels[0].legend(fontsize="small")
figure.savefig("fit_joint.png", dpi=120)
