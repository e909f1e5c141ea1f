"""The elastic block of the GRECO benchmark by a solver of the tests' own.

Half of a block, 40 x 40 mm, in plane strain: E 1.3e11 Pa, Poisson's ratio 0.2, its base on a rigid
plane with friction, held at x = 40 mm by symmetry. A pressure on its side x = 0 pushes it, one on
its top presses it (Raous, Chabrand, Lebon, 1988; code_aster SSNV128).
"""

import numpy as np
import skfem
from benchmarks.contact import BLOCK, SIDE, block
from scipy import sparse
from skfem.helpers import ddot, eye, sym_grad, trace


class OwnBlock:
    """Bilinear block condensed to its base, solved by sets of open, sticking and slipping nodes.

    It has no code of the package but the mesh. The sets are renewed until they repeat, so that all
    conditions hold with the last ones; if they swing, it fails.
    """

    def __init__(self, n, friction):
        self.friction, m = friction, block(n).mesh.mesh
        basis = skfem.Basis(m, skfem.ElementVector(skfem.ElementQuad1()))
        E, ratio = BLOCK.E, BLOCK.poisson
        shear, lame = E / 2 / (1 + ratio), E * ratio / (1 + ratio) / (1 - 2 * ratio)

        @skfem.BilinearForm
        def strain_energy(u, v, w):
            e, d = sym_grad(u), sym_grad(v)
            return 2 * shear * ddot(e, d) + lame * ddot(eye(trace(e), 2), d)

        @skfem.LinearForm
        def pressed(v, w):
            return -(v[0] * w.n[0] + v[1] * w.n[1])

        K = sparse.csc_matrix(strain_energy.assemble(basis))
        sides = [basis.boundary(name) for name in ("left", "top")]
        F = np.stack([pressed.assemble(side) for side in sides], axis=1)
        base = np.flatnonzero(m.p[1] == 0.0)
        base = base[np.argsort(m.p[0, base])]
        free = np.ones(K.shape[0], dtype=bool)
        free[basis.nodal_dofs[0, m.p[0] == SIDE]] = False
        kept = np.concatenate([basis.nodal_dofs[0, base[:-1]], basis.nodal_dofs[1, base]])
        free[kept] = False
        inner = np.flatnonzero(free)
        solve = sparse.linalg.splu(K[np.ix_(inner, inner)]).solve
        coupling = K[np.ix_(inner, kept)].toarray()
        self.K = K[np.ix_(kept, kept)].toarray() - coupling.T @ solve(coupling)
        self.F = F[kept] - coupling.T @ solve(F[inner])
        self.n = base.size  # of which the last one cannot slide

    def follow(self, steps, table):
        """Displacements (levels, n, 2) and friction work (levels,) at times 0, 1, ..."""
        n = self.n
        u, work, force = np.zeros(2 * n - 1), 0.0, np.zeros(n - 1)
        sets = np.ones(n, dtype=bool), np.zeros(n - 1)  # closed; direction of slip, 0 sticks
        levels, works = [u], [work]
        for k in range(1, table.shape[1]):
            for share in np.arange(1, steps + 1) / steps:
                f = self.F @ (table[:, k - 1] + share * (table[:, k] - table[:, k - 1]))
                new, friction, sets = self._level(f, u, sets)
                slid = new[: n - 1] - u[: n - 1]
                work -= float(0.5 * (force + friction) @ slid)
                u, force = new, friction
            levels.append(u)
            works.append(work)
        both = [np.stack([np.append(u[: n - 1], 0.0), u[n - 1 :]], axis=1) for u in levels]
        return np.array(both), np.array(works)

    def _level(self, f, before, sets):
        """Displacement and forces of friction on the base of the next level."""
        closed, slips = sets
        n = self.n
        for iteration in range(1000):
            u, r = self._solved(f, before, closed, slips)
            p, friction, slid = r[n - 1 :], r[: n - 1], u[: n - 1] - before[: n - 1]
            size = 1e-12 * np.abs(f).max()
            still_closed = np.where(closed, p >= -size, u[n - 1 :] < -1e-18)
            limit = self.friction * np.maximum(p[:-1], 0.0)
            begins = np.where(np.abs(friction) > limit + size, -np.sign(friction), 0.0)
            ends = slid * slips < -1e-18
            new = np.where(slips == 0.0, begins, np.where(ends, 0.0, slips))
            # a node that closes slips on as it moved while it was open
            new = np.where(closed[:-1], new, np.sign(slid))
            new = np.where(still_closed[:-1], new, 0.0)
            if np.array_equal(still_closed, closed) and np.array_equal(new, slips):
                return u, friction, sets
            if iteration > 20:  # the first change alone, which ends where all together swing
                changed = np.flatnonzero(np.append(still_closed != closed, new != slips))[1:]
                still_closed[changed[changed < n]] = closed[changed[changed < n]]
                new[changed[changed >= n] - n] = slips[changed[changed >= n] - n]
            closed, slips = sets = still_closed, new
        raise AssertionError("the sets of open and slipping nodes do not settle")

    def _solved(self, f, before, closed, slips):
        """Displacement, and the forces of the base on it, for given sets."""
        n = self.n
        moves = np.concatenate([~closed[:-1] | (slips != 0.0), ~closed])
        # forces of friction are -slips friction p with p = (K u - f) of the normal row
        A, b = self.K.copy(), f.copy()
        for i in np.flatnonzero(closed[:-1] & (slips != 0.0)):
            A[i] += slips[i] * self.friction * self.K[n - 1 + i]
            b[i] += slips[i] * self.friction * f[n - 1 + i]
        u = np.concatenate([before[: n - 1], np.zeros(n)])
        u[moves] = 0.0
        b -= A @ u
        u[moves] = np.linalg.solve(A[np.ix_(moves, moves)], b[moves])
        return u, self.K @ u - f
