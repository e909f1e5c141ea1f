r"""
How does a sampler drive a fit?
===============================

A fit states its uncertainty by a covariance, which takes the model as linear near the best values.
A sampler does not: it draws from the likelihood itself. It needs no more than a function of a
vector that returns its value and its gradient, as any program of uncertainty quantification does:
:py:meth:`skfem_joint.FitProblem.log_likelihood`.

Here it is Langevin's algorithm with a Metropolis test (G. O. Roberts and R. L. Tweedie, Bernoulli
2, 1996). It moves in the variables of the fit, logarithms of the values, along the gradient of the
likelihood :math:`L` and at random, by the Cholesky factor :math:`S` of the covariance,

.. math::

   x' = x + \tfrac12 h^2 S S^T \nabla L(x) + h S \xi .

Scene and data are those of :doc:`fit_joint`, with a curve without noise.
"""

# %%
# The fit: its best values and its covariance.
import sys

import matplotlib.pyplot as plt
import numpy as np

import skfem_joint as sj
from skfem_joint.scene.shipped import shipped_scene

free = {"joint[0].friction": (0.1, 2.0), "joint[0].tangential_stiffness": (3e10, 3e12)}
scene = sj.load_scene(shipped_scene("structure_harmonic"))
scene = scene.changed(joint={"law": "coulomb", "tangential_stiffness": 6e11})
(curve,) = sj.backbone(scene.system(), levels=8, up_to=0.6)
table = {"frequency": curve.frequency, "damping": curve.damping_ratio}
table["amplitude"] = curve.displacement[:, 0]
data = sj.measured_curve(table, unit="m", point="free_end", relative_frequency_deviation=1e-3)
fit = sj.fit(scene, data, free)
problem, rates = fit.problem, fit.problem.rates(fit.vector)
S = np.linalg.cholesky(fit.covariance / np.outer(rates, rates))


# %%
# The sampler.
def likelihood(x):
    """Logarithm of the likelihood of the variables x, and its gradient."""
    value, gradient = problem.log_likelihood(problem.outer(x))
    return value, gradient * problem.rates(problem.outer(x))


def away(a, b, gradient):
    """Half the square distance of a from the mean of the trials from b, in steps."""
    return 0.5 * np.sum((np.linalg.solve(S, a - b) / h - 0.5 * h * S.T @ gradient) ** 2)


h, random, samples = 0.9, np.random.default_rng(1), []
x, (value, gradient) = problem.inner(fit.vector), likelihood(problem.inner(fit.vector))
for _ in range(30 if "--short" in sys.argv else 400):
    trial = x + 0.5 * h**2 * S @ (S.T @ gradient) + h * S @ random.normal(size=x.size)
    new, slope = likelihood(trial)
    if np.log(random.uniform()) < new - value - away(x, trial, slope) + away(trial, x, gradient):
        x, value, gradient = trial, new, slope
    samples.append(problem.outer(x))
for key, sampled in zip(free, np.std(samples, axis=0), strict=True):
    print(f"{key}: standard deviation {fit.deviations[key]:.3g}, of the samples {sampled:.3g}")

# %%
# The samples beside the ellipse that holds 95 % of a normal distribution with the covariance of
# the fit.
around = np.linspace(0.0, 2.0 * np.pi, 100)
ellipse = problem.inner(fit.vector)[:, None] + 2.448 * S @ [np.cos(around), np.sin(around)]
figure, panel = plt.subplots(figsize=(5.5, 4.0), layout="constrained")
panel.plot(*np.array(samples).T * [[1.0], [1e-11]], ".", ms=3, alpha=0.5)
panel.plot(*np.exp(ellipse) * [[1.0], [1e-11]])
panel.set(title="samples, 95 % of the fit", xlabel="friction", ylabel="stiffness, 1e11 Pa/m")
figure.savefig("fit_sampler.png", dpi=120)
