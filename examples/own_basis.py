"""A joint on scikit-fem's own basis: an Euler-Bernoulli beam with one dry friction element.

A cantilever of length L carries a friction element of limit F_f at its tip, which resists the
transverse velocity there. Strong form in the deflection w(x, t):

    rho A w'' + E I (w + eps w')_xxxx = 0,   w(0) = w_x(0) = 0,
    E I w_xx(L) = 0,   -E I (w + eps w')_xxx(L) = F sin(2 pi f t) - F_f sgn(w'(L)).

Weak form: (rho A w'', v) + (E I (w + eps w')_xx, v_xx) = (F sin(2 pi f t) - F_f sgn(w'(L))) v(L).
Cubic Hermite elements. A beam's element has no tangent that a contact could slip along, so that
the slip row is given: the deflection at the tip.

Units: SI. Closed forms: static deflection F L^3 / (3 E I); a friction element whose limit exceeds
the force holds the tip.
"""

# %% Matrices, as any user of scikit-fem assembles them
import numpy as np
from skfem import Basis, BilinearForm, ElementLineHermite, MeshLine, asm

import skfem_joint as sj

length, EI, mass, force, frequency = 1.0, 21.0, 0.78, 1.0, 0.2  # m, N m2, kg/m, N, Hz
mesh = MeshLine(np.linspace(0.0, length, 9)).with_boundaries({"wall": lambda x: x[0] == 0.0})
basis = Basis(mesh, ElementLineHermite())
K = asm(BilinearForm(lambda w, v, _: EI * w.hess[0, 0] * v.hess[0, 0]), basis)
M = asm(BilinearForm(lambda w, v, _: mass * w * v), basis)
tip = basis.nodal_dofs[0, -1]


# %% The joint in three lines
def driven(limit: float) -> sj.System:
    """Beam under a sine at its tip, beside a friction element of a limit (N)."""
    joint = sj.point_friction(np.bincount([tip], minlength=basis.N), limit)
    load = {"tip": (tip, lambda t: force * np.sin(2.0 * np.pi * frequency * t))}
    wall = basis.get_dofs("wall")
    return sj.System.from_matrices(M, K, 1e-2 * K, fixed=wall, contact=joint, loads=load)


# %% Two periods of slow load: without friction, with half of the force, and with more than it
runs = {limit: sj.integrate(driven(limit), duration=10.0, step=0.02) for limit in (0.0, 0.5, 1.1)}
static = force * length**3 / (3.0 * EI)

if __name__ == "__main__":
    for limit, run in runs.items():
        peak = 1e3 * run.peak_of("tip")
        print(f"limit {limit} N: tip moves {peak:.2f} mm, static without {1e3 * static:.2f} mm")
