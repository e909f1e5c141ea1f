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
:math:`J` of the residuals, is :math:`(J^T J)^{-1}`. A sampler, which does not take the model as
linear, draws from the same likelihood: it is given nothing but a function of a vector that returns
its value and its gradient, as any program of uncertainty quantification would be.

By a command: ``skfem-joint fit SCENE.toml --data measured.csv --free "joint[0].friction=0.1..2"
--out DIR``.
"""

# %%
# The scene, with a first guess of its values, and an experiment with others.
import sys

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.patches import Ellipse

import skfem_joint as sj
from skfem_joint.scene.shipped import shipped_scene

scene = sj.load_scene(shipped_scene("structure_harmonic"))
scene = scene.changed(
    {"joint[0].tangential_stiffness": 3e11}, joint={"law": "coulomb"}, damping={"ratio": 0.001}
)
free = {
    "joint[0].friction": (0.1, 2.0),
    "joint[0].tangential_stiffness": (3e10, 3e12),
    "damping.ratio": (2e-4, 2e-2),
}
truth = {
    "joint[0].friction": 0.9, "joint[0].tangential_stiffness": 6e11, "damping.ratio": 0.002
}  # fmt: skip
(curve,) = sj.backbone(scene.changed(truth).system(), levels=12, up_to=0.6)
random = np.random.default_rng(5)
of_frequency = np.full(12, 0.02 * np.ptp(curve.frequency))
of_damping = 0.02 * curve.damping_ratio
table = {
    "amplitude": curve.displacement[:, 0],
    "frequency": curve.frequency + of_frequency * random.normal(size=12),
    "damping": curve.damping_ratio + of_damping * random.normal(size=12),
    "frequency_deviation": of_frequency,
    "damping_deviation": of_damping,
}
measured = sj.measured_curve(table, name="experiment", unit="m", point=scene.system().points[0])

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
both = sj.fit(scene, measured, free | {"joint[0].pressure": (2e7, 1e8)})
print(both.undetermined[0])

# %%
# The same by a sampler: Langevin's algorithm with a Metropolis test (G. O. Roberts and R. L.
# Tweedie, Bernoulli 2, 1996). It moves in the variables of the fit, logarithms of the values, along
# the gradient of the likelihood and at random, by the shape of the covariance.
problem = fit.problem
rates = problem.rates(fit.vector)
shape = np.linalg.cholesky(fit.covariance / np.outer(rates, rates))


def likelihood(x):
    """Logarithm of the likelihood of the variables x, and its gradient."""
    vector = problem.outer(x)
    value, gradient = problem.log_likelihood(vector)
    return value, gradient * problem.rates(vector)


def drift(x, gradient, step):
    """Mean of the next trial from x."""
    return x + 0.5 * step**2 * shape @ (shape.T @ gradient)


step, samples = 0.9, []
x = problem.inner(fit.vector)
value, gradient = likelihood(x)
for _ in range(40 if "--short" in sys.argv else 400):
    trial = drift(x, gradient, step) + step * shape @ random.normal(size=x.size)
    new, new_gradient = likelihood(trial)
    back, forth = (
        np.linalg.solve(shape, a - drift(b, g, step))
        for a, b, g in ((x, trial, new_gradient), (trial, x, gradient))
    )
    ratio = new - value - 0.5 * (back @ back - forth @ forth) / step**2
    if np.log(random.uniform()) < ratio:
        x, value, gradient = trial, new, new_gradient
    samples.append(problem.outer(x))
samples = np.array(samples)
print("standard deviations:", ", ".join(f"{fit.deviations[key]:.3g}" for key in free))
print("of the samples:     ", ", ".join(f"{x:.3g}" for x in samples.std(axis=0)))

# %%
# A band of any other result: values are drawn from the covariance, and the scene is run with each
# of them. Here it is the largest displacement of the free end under the scene's own load.
peaks = []
for values in fit.draws(8 if "--short" in sys.argv else 40):
    run = sj.integrate(scene.changed(values).system(), cycles=4, steps_per_cycle=100)
    peaks.append(1e3 * run.peak_of("free_end"))
low, high = np.quantile(peaks, [0.025, 0.975])
print(f"largest displacement: 95 % from {low:.4f} to {high:.4f} mm")

# %%
# The fitted curve in its band, and the samples beside the ellipse that holds 95 % of a normal
# distribution with the covariance of the fit.
(fitted,) = fit.predicted
widths = fit.band(fitted)
figure, panels = plt.subplots(1, 3, figsize=(12.0, 3.8), layout="constrained")
amplitude = 1e3 * fitted.displacement
for panel, quantity, width, factor in zip(
    panels, ("frequency", "damping"), widths, (1.0, 100.0), strict=False
):
    best = factor * getattr(fitted, quantity)
    panel.fill_between(
        amplitude, best - factor * width, best + factor * width, alpha=0.3, label="95 % band"
    )
    panel.semilogx(amplitude, best, label="fit")
    error = factor * getattr(measured, f"{quantity}_deviation")
    panel.errorbar(amplitude, factor * getattr(measured, quantity), error, fmt="k.", label="data")
    panel.set_xlabel("amplitude of the free end, mm")
    panel.legend(fontsize="small")
    panel.grid(alpha=0.3)
panels[0].set_ylabel("frequency, Hz")
panels[1].set_ylabel("damping ratio, %")
size, axes = np.linalg.eigh(fit.covariance[:2, :2] / np.outer([1.0, 1e11], [1.0, 1e11]))
turn = np.degrees(np.arctan2(axes[1, 1], axes[0, 1]))
lengths = 2.0 * np.sqrt(5.991 * size[::-1])  # chi square of two degrees
panels[2].plot(samples[:, 0], samples[:, 1] / 1e11, ".", ms=3, alpha=0.5, label="samples")
centre = fit.vector[0], fit.vector[1] / 1e11
panels[2].add_patch(Ellipse(centre, *lengths, angle=turn, fill=False, label="95 % of the fit"))
panels[2].plot(0.9, 6.0, "r+", ms=12, label="truth")
panels[2].set(xlabel="friction", ylabel="tangential stiffness, 1e11 Pa/m")
panels[2].legend(fontsize="small")
panels[2].grid(alpha=0.3)
figure.savefig("fit_joint.png", dpi=120)
