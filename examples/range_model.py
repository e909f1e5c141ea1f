r"""
One model for a sweep: how far may loads and friction change?
=============================================================

A reduced model that is made for one load knows how the joint slips under that load. Under another
load, frequency or friction limit other points slip, and its error is unknown. A model for a range
is made once, from static slip paths all over the range, and states the error of each of its points.

The structure is a bar that lies on its base over a sixth of its length, with Coulomb friction of
the limit :math:`\tau` for each length. The range is one of three numbers: the share of the load
that makes the joint slip as a whole, the frequency, and a factor on :math:`\tau`. A factor common
to the load and to :math:`\tau` only rescales the motion :math:`u`,

.. math::

   M \ddot u + C \dot u + K u + \tau\,B^T \operatorname{sign}(B \dot u) = f
   \quad\Rightarrow\quad
   M c\ddot u + C c\dot u + K c u + c\tau\,B^T \operatorname{sign}(B c\dot u) = c f ,

so that a point is inside if it is so but for such a factor.
"""

import sys

import matplotlib.pyplot as plt
import numpy as np

import skfem_joint as sj

count = 3 if "--short" in sys.argv else 12
mesh = sj.build_bar([("joint", 0.1, 50), ("free", 0.5, 50)], {"held": 0.0, "end": 0.6})
steel, joint = sj.Material(E=200e9, density=8000.0), sj.Joint("joint", pressure=50e6, friction=0.7)
section = {"width": 0.05, "thickness": 0.01, "damping_ratio": 0.01}
bar = sj.Structure(mesh, steel, fixed=["held"], joints=[joint], **section)
full = bar.system([sj.Load("end", sj.Harmonic(1.0, 500.0))])
small = sj.reduce(
    full, range={"slip": (0.1, 0.9), "frequency": (200.0, 900.0), "limits": {"joint": (0.5, 2.0)}}
)
print(small)

# %%
# Points drawn at random, each with its estimated error and its distance from the full model.
draw = np.random.default_rng(1)
errors = []
steps = {"cycles": 3, "steps_per_cycle": 100}
for _ in range(count):
    limits = {"joint": float(np.exp(draw.uniform(np.log(0.5), np.log(2.0))))}
    frequency, slip = draw.uniform(200.0, 900.0), draw.uniform(0.15, 0.85)
    point = sj.at(small, frequency=frequency, slip=slip, limits=limits)
    run = sj.integrate(point, **steps)
    stated = sj.estimate(run).parts["basis"]["friction_energy"]
    level = point.serves.point.level
    exact = sj.integrate(sj.at(full, frequency=frequency, level=level, limits=limits), **steps)
    true = abs(sj.compare(exact, run).friction_energy_per_cycle)
    errors.append((true, stated))
    print(
        f"{frequency:.0f} Hz, slip {slip:.2f}, limits times {limits['joint']:.2f}: friction takes "
        f"{run.cycles.friction[-1]:.3g} J, off by {100 * true:.2f} %, "
        f"estimated {100 * stated:.2f} %"
    )

# %%
# Outside of its range the model says so.
try:
    sj.at(small, frequency=1200.0, slip=0.5)
except sj.InputError as error:
    print(error)

# %%
# Estimated errors of the friction energy over the true ones.
figure, axes = plt.subplots(figsize=(7.0, 4.5))
axes.loglog(*(100.0 * np.array(errors).T), "o")
axes.axline((0.1, 0.1), (1.0, 1.0), color="0.6")
axes.set(xlabel="error of the friction energy, %", ylabel="estimated, %")
figure.savefig("range_model.png")
