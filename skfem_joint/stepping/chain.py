"""Steps of a chain of unknowns: a tridiagonal system with at most one slip row an unknown.

Struts make such systems, and so does everything else whose unknowns `arrangement` can put in a row.
"""

# numba infers the types of compiled functions:
# mypy: allow-untyped-defs, allow-untyped-calls, allow-untyped-decorators

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from skfem_joint.arrays import BoolArray, FloatArray
from skfem_joint.friction import ARCTAN, COULOMB, FREE
from skfem_joint.stepping.chain_solver import passes_of, solve_step
from skfem_joint.stepping.compiled import compiled_for, parameters
from skfem_joint.stepping.march import Bands, Found, Places, make_room, slips, solve
from skfem_joint.linalg.compressed import compressed_rows
from skfem_joint.stepping.schemes import Coefficients
from skfem_joint.stepping.steppers import CompiledStepper, Failure, Motion

#: Scale of the law's parameter: kappa = KAPPA / max |H^-1 w|, the largest velocity that friction
#: can change in a step. Measured: 1 to 5 do; from 10 on steps fail to converge, and scales taken
#: from the diagonal of H fail on fine meshes because they grow with the mesh.
KAPPA = 3.0
#: Chains shorter than this are not coarsened.
SHORTEST = 48
#: Iterations of a slow step, and for how many steps after one the start is another: Coulomb's
#: solution on chains up to a length, nested on longer ones.
SLOW = 8
PERSISTENCE = 30
LONGEST = 2000


class Chain(NamedTuple):
    """Problem of a step on a chain and its coarser chains, concatenated, the finest first."""

    start: Any  #: (levels + 1,) level k has ``start[k]:start[k + 1]`` of the others
    H0: Any  #: diagonal of H, N s/m
    H1: Any  #: off-diagonal, padded by a zero on each level
    w: Any  #: friction limits, N
    kind: Any  #: of each point, see skfem_joint.friction
    mixed: int  #: 0 if all points are of the arctan kind, 1 if some are, 2 if none is
    inverse_beta: Any  #: 1 / beta, m/s
    kappa: float  #: scale of the law's parameter, s/m
    hold: Any  #: (n,) largest force at which a point sticks, N: w under Coulomb, -1 elsewhere
    pivot: Any  #: (n,) inverse pivots between points that stick, as far as needed, m/(N s)
    stretch: Any  #: (n,) end of the stretch of slipping points that each pivot is for


class Memory(NamedTuple):
    """What the steps of a chain remember, and the room that they work in."""

    parameter: Any  #: (n,) of the law's graph at the last step
    old_parameter: Any  #: (n,) and at the one before
    scale: Any  #: (1,) kappa of the chain that they are for, s/m
    wary: Any  #: (1,) steps left in which not to start from the steps before
    middle: Any  #: (1,) where eliminations met last
    velocity: Any  #: (n,) what the last step found: the first row of ``work``
    force: Any  #: (n,) and its second row
    parameters: Any  #: room for all levels
    new_parameter: Any  #: (n,) the finest of them
    rights: Any  #: room for all levels
    work: Any  #: (6, n) room
    trial: Any  #: (3, n) room


def make_memory(n: int) -> Memory:
    """Make the arrays for a chain of ``n`` unknowns."""
    work, levels = np.zeros((6, n)), np.zeros((2, levels_of(n)[-1]))
    return Memory(
        parameter=np.zeros(n),
        old_parameter=np.zeros(n),
        scale=np.zeros(1),
        wary=np.zeros(1, dtype=np.int64),
        middle=np.full(1, n // 2, dtype=np.int64),
        velocity=work[0],
        force=work[1],
        parameters=levels[0],
        new_parameter=levels[0, :n],
        rights=levels[1],
        work=work,
        trial=np.zeros((3, n)),
    )


def levels_of(n: int) -> NDArray[np.int64]:
    """Where the levels of a chain of ``n`` unknowns begin, and where the last one ends."""
    starts = [0, n]
    while n >= SHORTEST:
        n = (n + 1) // 2
        starts.append(starts[-1] + n)
    return np.array(starts)


def bands(A: Any) -> Bands:
    """Bands of a symmetric tridiagonal matrix."""
    diagonal, off = (np.ascontiguousarray(A.diagonal(k), dtype=float) for k in (0, 1))
    return Bands(diagonal, off)


def build_chain(H: Bands, w: FloatArray, beta: FloatArray) -> Chain:
    """Galerkin hierarchy by halving a chain down to a few dozen unknowns.

    Coarse node j sits on fine node 2 j (or 2 j + 1, so that the last node stays); the fine nodes
    between get the mean of their neighbours.

    ``H`` is the step matrix, N s/m; ``w`` and ``beta`` (n,) are friction limits (N; 0 where no
    friction acts) and scaling constants (s/m).
    """
    H0, H1 = H
    kappa = KAPPA / np.abs(_solve(H0, H1, w)).max()
    start, levels = levels_of(H0.size), [(H0, np.append(H1, 0.0), w, beta)]
    for n in np.diff(start)[:-1]:
        first = (n - 1) % 2  # so that the last node stays
        H0, H1, w = _halved(H0, H1, w, first)
        beta = beta[first::2]
        levels.append((H0, np.append(H1, 0.0), w, beta))
    H0, H1, w, beta = (np.concatenate([level[i] for level in levels]) for i in range(4))
    kind = np.where(w > 0.0, np.where(np.isinf(beta), COULOMB, ARCTAN), FREE).astype(np.int8)
    regular = kind == ARCTAN
    n = start[1]
    return Chain(
        start=start,
        H0=H0,
        H1=H1,
        w=w,
        kind=kind,
        mixed=0 if np.all(regular) else 1 if np.any(regular) else 2,
        inverse_beta=1.0 / np.where(regular, beta, 1.0),
        kappa=float(kappa),
        hold=w[:n] if np.all(kind == COULOMB) else np.where(kind[:n] == COULOMB, w[:n], -1.0),
        pivot=np.zeros(n),
        stretch=np.full(n, -1),
    )


def _halved(
    H0: FloatArray, H1: FloatArray, w: FloatArray, first: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Galerkin projection of a chain on every second node: P^T H P and P^T w.

    P has 1 at a coarse node and 1/2 at its neighbours. Written out, because a step size that is
    used once should not cost more than its steps.
    """
    diagonal = np.concatenate([[0.0], H0, [0.0]])
    off = np.concatenate([[0.0], H1, [0.0]])  # off[i] couples nodes i - 1 and i
    limit = np.concatenate([[0.0], w, [0.0]])
    node = np.arange(first, H0.size, 2)
    coarse_0 = H0[node] + 0.25 * (diagonal[node] + diagonal[node + 2]) + off[node] + off[node + 1]
    between = node[:-1] + 1
    coarse_1 = 0.25 * H0[between] + 0.5 * (H1[between - 1] + H1[between])
    return coarse_0, coarse_1, w[node] + 0.5 * (limit[node] + limit[node + 2])


def _solve(H0: FloatArray, H1: FloatArray, right: FloatArray) -> FloatArray:
    if H0.size == 1:
        return right / H0
    return np.asarray(lapack.dptsv(H0, H1, right)[2])


@compiled_for(solve, Chain)
def _solve_chain(problem, memory, right, v, tolerance):
    """Slip fronts where no law is regularised or the last steps were slow; three tiers."""
    chain, n = problem, right.size
    s, s_new, slip, r = memory.parameter, memory.new_parameter, memory.work[2], memory.work[4]
    v_new, sigma_new, wary = memory.velocity, memory.force, memory.wary[0]
    count, tier, converged, near, residual, unknown = 0, 0, False, False, 0.0, 0
    if chain.mixed == 2:
        count, converged, memory.middle[0] = passes_of(
            chain.H0, chain.H1, chain.w, chain.hold, chain.pivot, chain.stretch, chain.kappa, right,
            s_new, v_new, sigma_new, slip, r, memory.middle[0], tolerance,
        )  # fmt: skip
    elif wary > 0 and n <= LONGEST:
        count, near, memory.middle[0] = passes_of(
            chain.H0, chain.H1, chain.w, chain.w, chain.pivot, chain.stretch, chain.kappa, right,
            s_new, v_new, sigma_new, slip, r, memory.middle[0], tolerance,
        )  # fmt: skip
        if near:
            parameters(chain.kind, chain.kappa, chain.inverse_beta, v_new, sigma_new, s_new)
    if not converged:
        for i in range(n):
            memory.rights[i] = right[i]
            if not near:
                s_new[i] = 2.0 * s[i] - memory.old_parameter[i]
        more, tier, converged, residual, unknown = solve_step(
            chain, memory.rights, memory.parameters, memory.work, memory.trial, tolerance,
            wary > 0 and not near,
        )  # fmt: skip
        count += more
    if converged:
        if wary == 0 and (tier == 1 or count > SLOW):
            memory.wary[0] = PERSISTENCE
        elif wary > 0:
            memory.wary[0] -= 1
        for i in range(n):
            memory.old_parameter[i] = s[i]
            s[i] = s_new[i]
    return Found(converged, count, tier == 1, tier == 2, 0, count + 1, residual, unknown)


@compiled_for(slips, Chain)
def _slips_of_chain(problem, x, room):
    """The unknowns themselves, with slip where there is contact."""
    return x


class ChainStepper(CompiledStepper):
    """Steps of a tridiagonal system whose slip rows each pick one unknown."""

    REMEMBERED = ("parameter", "old_parameter", "scale", "wary", "middle")

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        s = self.system
        self.contact = compressed_rows(s.B).column
        self.places = Places(self.contact, self.contact)
        self.limits, self.beta = np.zeros(s.n), np.full(s.n, np.inf)
        self.limits[self.contact], self.beta[self.contact] = s.w, s.beta
        self.dynamics = (bands(s.M), bands(s.C), bands(s.K))
        self.memory, self.room = make_memory(s.n), make_room(s.n, 0, s.n)
        self.first_call = max(1, 200_000 // s.n)

    def started(self, acceleration: FloatArray, sigma: FloatArray) -> None:
        """Go on from the law's point, whatever the parameter was."""
        super().started(acceleration, sigma)
        self.memory.scale[:] = 0.0

    def sticking(self, right: FloatArray, at_rest: BoolArray) -> Motion | None:
        """Acceleration and friction of points at rest."""
        w = np.zeros(right.size)
        w[self.contact[at_rest]] = self.system.w[at_rest]
        chain = build_chain(self.dynamics[0], w, np.full(w.size, np.inf))
        room = make_memory(w.size)
        room.rights[: w.size] = right
        _, _, converged, residual, unknown = solve_step(
            chain, room.rights, room.parameters, room.work, room.trial, self.tolerance, False
        )
        self.failure = Failure(residual, unknown)
        return (room.velocity, room.force[self.contact]) if converged else None

    def prepare(self, h: float) -> None:
        """Compile the loop, and what a restart after a jump needs."""
        super().prepare(h)
        coulomb = (self.system.w > 0.0) & np.isinf(self.system.beta)
        if np.any(coulomb) and not solve_step.signatures:
            self.sticking(np.zeros(self.system.n), coulomb)

    def make(self, c: Coefficients) -> Chain:
        """Step matrix and its coarser ones."""
        (M0, M1), (C0, C1), (K0, K1) = self.dynamics
        self.counts["factorizations"] += 1
        H = Bands(c.c_M * M0 + C0 + c.c_K * K0, c.c_M * M1 + C1 + c.c_K * K1)
        chain = build_chain(H, self.limits, self.beta)
        self.limits = chain.w[: self.limits.size]  # few arrays stay near, many do not
        return chain

    def problem(self, c: Coefficients) -> Chain:
        """Problem of the next step, whose parameter the memory is scaled to."""
        chain: Chain = self.matrices(c)
        if self.memory.scale[0] != chain.kappa:
            # The parameter's scale changes with the step: start again from the law's point.
            s = self.memory.parameter
            v, sigma = self.now.v, self.now.sigma
            parameters(chain.kind, chain.kappa, chain.inverse_beta, v, sigma, s)
            self.memory.old_parameter[:] = s
            self.memory.scale[:] = chain.kappa
        return chain
