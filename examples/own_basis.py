r"""
Can friction be added to matrices of one's own?
===============================================

Yes, in three lines: an Euler-Bernoulli beam, assembled by scikit-fem on its own basis, gets a dry
friction element at its tip. A friction limit above the force holds the tip; half of the force
halves its motion.

Strong form in the deflection :math:`w(x, t)` of a cantilever of length :math:`L`, with the limit
:math:`F_f` of the friction element:

.. math::

   \rho A\,\ddot w + E I\,(w + \varepsilon\dot w)_{xxxx} = 0, \qquad
   w(0) = w_x(0) = 0, \qquad E I\,w_{xx}(L) = 0, \\
   -E I\,(w + \varepsilon\dot w)_{xxx}(L) = F\sin 2\pi f t - F_f\,\operatorname{sgn}\dot w(L) .

Weak form:

.. math::

   (\rho A\,\ddot w, v) + (E I\,(w + \varepsilon\dot w)_{xx}, v_{xx})
   = \bigl(F\sin 2\pi f t - F_f\,\operatorname{sgn}\dot w(L)\bigr)\,v(L) .

The elements are cubic Hermite elements. They have no tangent that a contact could slip along, so
the slip row is given: the deflection at the tip. Units are SI.
"""

# %%
# Matrices, as any user of scikit-fem assembles them.
import matplotlib.pyplot as plt
import numpy as np
from skfem import Basis, BilinearForm, ElementLineHermite, MeshLine, asm

import skfem_joint as sj

length, EI, mass, force, frequency = 1.0, 21.0, 0.78, 1.0, 0.2  # m, N m2, kg/m, N, Hz
mesh = MeshLine(np.linspace(0.0, length, 9)).with_boundaries({"wall": lambda x: x[0] == 0.0})
basis = Basis(mesh, ElementLineHermite())
K = asm(BilinearForm(lambda w, v, _: EI * w.hess[0, 0] * v.hess[0, 0]), basis)
M = asm(BilinearForm(lambda w, v, _: mass * w * v), basis)
tip = basis.nodal_dofs[0, -1]


# %%
# The joint, the load and the system.
def driven(limit: float) -> sj.System:
    """Beam under a sine at its tip, beside a friction element of a limit (N)."""
    joint = sj.point_friction(np.bincount([tip], minlength=basis.N), limit)
    load = {"tip": (tip, lambda t: force * np.sin(2.0 * np.pi * frequency * t))}
    wall = basis.get_dofs("wall")
    return sj.System.from_matrices(M, K, 1e-2 * K, fixed=wall, contact=joint, loads=load)


# %%
# Two periods of slow load: without friction, with half of the force, and with more than the force.
# The closed form of the static deflection is :math:`F L^3 / (3 E I)`.
runs = {limit: sj.integrate(driven(limit), duration=10.0, step=0.02) for limit in (0.0, 0.5, 1.1)}
static = force * length**3 / (3.0 * EI)
figure, panel = plt.subplots(figsize=(7.0, 3.6), layout="constrained")
for limit, run in runs.items():
    peak = 1e3 * run.peak_of("tip")
    print(f"limit {limit} N: tip moves {peak:.2f} mm, static without {1e3 * static:.2f} mm")
    panel.plot(run.times, 1e3 * run.point("tip"), label=f"friction limit {limit} N")
panel.set(xlabel="time, s", ylabel="deflection of the tip, mm", xlim=(0.0, 10.0))
panel.legend(loc="upper right")
panel.grid(alpha=0.3)
figure.savefig("own_basis.png", dpi=120)
