"""Front elimination, for chains: H is tridiagonal, and each unknown has at most one slip row.

Under set-valued Coulomb friction the velocity of a point that sticks is zero, so that the parts of
the chain on its two sides do not act on each other. Elimination can therefore decide between stick
and slip as it proceeds along the chain. It runs from both ends to a meeting point at rest.
On the way in, a point slips if it would with its inner neighbour at its previous velocity; on the
way back each point obeys its law. Such a pass moves a slip front over any number of nodes, Newton's
method by about one node. The first pass starts from rest: from the velocities of the last step,
passes may alternate between two wrong states.

If a law is regularised, a point has a spring in series, or the passes fail,
:mod:`skfem_joint.minimise.minty_newton` solves the problem. It starts from parameters extrapolated
over the last two steps. For some steps after a slow step it starts from Coulomb's solution (on
short chains without springs) or from coarser chains (on long chains).
"""

# numba infers the types of compiled functions:
# mypy: allow-untyped-defs, allow-untyped-calls, allow-untyped-decorators, no-check-untyped-defs

from __future__ import annotations

from functools import cached_property
from math import copysign
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import lapack

from skfem_joint.ground.arrays import FloatArray
from skfem_joint.ground.compiling import compiled, compiled_for, compiled_inside
from skfem_joint.linalg.kernels import Bands, as_sparse, bands, largest_of
from skfem_joint.minimise import law
from skfem_joint.minimise.law import COULOMB, FREE, REGULAR, graph_parameters, sticks
from skfem_joint.minimise.linearisation import Linearisation
from skfem_joint.minimise.minty_newton import ROUND_OFF, newton_on_graph
from skfem_joint.minimise.problem import (
    CompiledStepProblem,
    ContactPoints,
    Minimum,
    Places,
    Pressed,
    StepOutcome,
    minimise_step,
    slips,
)
from skfem_joint.system.unknowns import selection


class Chain(NamedTuple):
    """Problem of a step on a chain and its coarser chains, concatenated, the finest first.

    Attributes
    ----------
    start : ndarray of int, shape (levels + 1,)
        Level k has the entries ``start[k]:start[k + 1]`` of the arrays by node.
    H0, H1 : ndarray
        Diagonal of H, N s/m, and off-diagonal, padded by a zero on each level.
    w : ndarray
        Friction limits, N.
    kind : ndarray of int
        Of each point: REGULAR, COULOMB or FREE.
    mixed : int
        0 if all points are REGULAR, 1 if some are, 2 if none is.
    inverse_beta : ndarray
        1 / beta, m/s.
    kappa : float
        Scale of the graph's parameter, s/m.
    hold : ndarray, shape (n,)
        Largest force at which a point sticks, N: w under Coulomb friction, -1 elsewhere.
    pivot : ndarray, shape (n,)
        Inverse pivots between points that stick, as far as they were needed, m/(N s).
    stretch : ndarray of int, shape (n,)
        End of the stretch of slipping points for which each pivot holds.
    soft, offset : ndarray
        Compliance of springs in series, m/s, and the slips from which those of points with springs
        count, m/s, which are those of the workspace; empty if there are none.
    """

    start: Any
    H0: Any
    H1: Any
    w: Any
    kind: Any
    mixed: int
    inverse_beta: Any
    kappa: float
    hold: Any
    pivot: Any
    stretch: Any
    soft: Any
    offset: Any


class ChainWorkspace(NamedTuple):
    """Values that steps of a chain keep for later steps, and arrays to work in.

    Attributes
    ----------
    parameter, old_parameter : ndarray, shape (n,)
        Parameters of the graph at the last step and at the step before.
    scale : ndarray, shape (1,)
        The kappa of these parameters, s/m.
    special_starts : ndarray of int, shape (1,)
        Number of steps to come that begin from the special start, because a step was slow.
    middle : ndarray of int, shape (1,)
        Node at which eliminations met last.
    velocity, force : ndarray, shape (n,)
        Result of the last minimisation: the first two rows of ``work``.
    new_parameter : ndarray, shape (n,)
        Its parameters: the finest level of ``parameters``.
    parameters, rights, offsets : ndarray, shape (nodes of all levels,)
    offset : ndarray, shape (n,)
        Slips from which those of points with springs count, m/s: the finest level of ``offsets``.
    work, trial : ndarray, shape (6, n) and (3, n)
    """

    parameter: Any
    old_parameter: Any
    scale: Any
    special_starts: Any
    middle: Any
    velocity: Any
    force: Any
    parameters: Any
    new_parameter: Any
    rights: Any
    work: Any
    trial: Any
    offsets: Any
    offset: Any


def chain_workspace(n: int) -> ChainWorkspace:
    """Make the workspace for a chain of ``n`` unknowns."""
    work, levels = np.zeros((6, n)), np.zeros((3, _levels_of(n)[-1]))
    return ChainWorkspace(
        parameter=np.zeros(n),
        old_parameter=np.zeros(n),
        scale=np.zeros(1),
        special_starts=np.zeros(1, dtype=np.int64),
        middle=np.full(1, n // 2, dtype=np.int64),
        velocity=work[0],
        force=work[1],
        parameters=levels[0],
        new_parameter=levels[0, :n],
        rights=levels[1],
        work=work,
        trial=np.zeros((3, n)),
        offsets=levels[2],
        offset=levels[2, :n],
    )


# The hierarchy


def _levels_of(n: int) -> NDArray[np.int64]:
    """Begin of each level of a chain of ``n`` unknowns, and the end of the last level."""
    starts = [0, n]
    while n >= 48:  # shorter chains are not coarsened
        n = (n + 1) // 2
        starts.append(starts[-1] + n)
    return np.array(starts)


def build_chain(H: Bands, w: FloatArray, beta: FloatArray, soft: FloatArray | None = None) -> Chain:
    """Chain with its Galerkin hierarchy, halved down to a few dozen unknowns.

    Coarse node j is the fine node 2 j (or 2 j + 1, so that the last node stays); fine nodes between
    two coarse ones get the mean of them.

    Parameters
    ----------
    H : Bands
        Step matrix, N s/m.
    w, beta : ndarray, shape (n,)
        Friction limits (N; 0 where no friction acts) and steepness (s/m).
    soft : ndarray, shape (n,), optional
        Compliance of springs in series, m/s; no springs if not given.
    """
    H0, H1 = H
    # Over the largest velocity that friction can change in a step, max |H^-1 w|. Measured: 1 to 5
    # work; from 10 on steps fail to converge, and scales from the diagonal of H fail on fine meshes
    # because they grow with the mesh.
    kappa = 3.0 / np.abs(_solve(H0, H1, w)).max()
    start, levels = _levels_of(H0.size), [(H0, np.append(H1, 0.0), w)]
    for n in np.diff(start)[:-1]:
        H0, H1, w = _halved(H0, H1, w, (n - 1) % 2)
        levels.append((H0, np.append(H1, 0.0), w))
    H0, H1, w = (np.concatenate([level[i] for level in levels]) for i in range(3))
    n = start[1]
    none = np.zeros(0)
    chain = Chain(
        start, H0, H1, w, none, 0, none, float(kappa), none, np.zeros(n), np.full(n, -1),
        none if soft is None else _by_level(soft, start), none,
    )  # fmt: skip
    return with_law(chain, beta)


def _by_level(values: FloatArray, start: NDArray[np.int64]) -> FloatArray:
    """Values of the nodes on all levels, from those on the finest."""
    levels = [values]
    for size in np.diff(start)[:-1]:
        levels.append(levels[-1][(size - 1) % 2 :: 2])
    return np.concatenate(levels)


def with_law(chain: Chain, beta: FloatArray) -> Chain:
    """Same chain with other values of beta, (n,), s/m."""
    n, beta, w = beta.size, _by_level(beta, chain.start), chain.w
    kind = np.where(w > 0.0, np.where(np.isinf(beta), COULOMB, REGULAR), FREE).astype(np.int8)
    regular = kind == REGULAR
    return chain._replace(
        kind=kind,
        mixed=0 if np.all(regular) else 1 if np.any(regular) else 2,
        inverse_beta=1.0 / np.where(regular, beta, 1.0),
        hold=w[:n] if np.all(kind == COULOMB) else np.where(kind[:n] == COULOMB, w[:n], -1.0),
    )


def _halved(
    H0: FloatArray, H1: FloatArray, w: FloatArray, first: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Galerkin projection of a chain on every second node: P^T H P and P^T w.

    P has 1 at a coarse node and 1/2 at its neighbours. The products are written out because sparse
    products would take longer than a few steps.
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


# Fronts


@compiled_inside
def _meeting_point(v, middle):
    """Middle of the longest run of points at rest; ``middle`` if none is."""
    longest = 0
    begin = 0
    for i in range(v.size + 1):
        if i == v.size or v[i] != 0.0:
            if i - begin > longest:
                longest = i - begin
                middle = (begin + i) // 2
            begin = i + 1
    return middle


@compiled_inside
def _inwards(H0, H1, w, hold, pivot, stretch, g, v, slip, middle):
    """Eliminate from both ends to the meeting point, deciding stick and slip on the way.

    A point slips if it would with its inner neighbour at the velocity that ``v`` has for it. The
    sign of the slip is left in ``slip``, and in ``v`` the velocity with the inner neighbour at
    rest. Runs of points in the same state have loops of their own, so that a point need not wait
    for the decision on the previous point.
    """
    # Indices are unsigned and wrap around: numba tests signed indices for counting from the end.
    forward, end = np.uint64(1), np.uint64(middle)
    t = g[end]
    diagonal = H0[end]
    for side in range(2):
        way = forward if side == 0 else -forward
        inner = np.uint64(0) if side == 0 else -forward  # H1[j + inner] is inside of point j
        j = np.uint64(0) if side == 0 else np.uint64(v.size - 1)
        first = j  # where the stretch of slipping points begins
        x = 0.0
        outer = 0.0
        while j != end:
            needed = g[j] - outer * x - H1[j + inner] * v[j + way]
            if sticks(needed, hold[j]):
                x = slip[j] = v[j] = 0.0
                j += way
                while j != end and sticks(g[j] - H1[j + inner] * v[j + way], hold[j]):
                    slip[j] = v[j] = 0.0
                    j += way
                first = j
                continue
            sign = copysign(1.0, needed)
            while True:
                if stretch[j] != np.int64(first):
                    stretch[j] = first
                    taken = 0.0 if j == first else outer * outer * pivot[j - way]
                    pivot[j] = 1.0 / (H0[j] - taken)
                x = (g[j] - sign * w[j]) * pivot[j] - (outer * pivot[j]) * x
                v[j] = x
                slip[j] = sign
                outer = H1[j + inner]
                j += way
                if j == end or not sign * (g[j] - outer * x - H1[j + inner] * v[j + way]) > hold[j]:
                    break
        if first != end:
            t -= outer * x
            diagonal -= outer * outer * pivot[end - way]
    v[end] = 0.0 if sticks(t, hold[end]) else (t - copysign(w[end], t)) / diagonal


@compiled_inside
def _outwards(H0, H1, w, hold, pivot, g, v, slip, middle):
    """Go back to the ends: each point obeys its law at the inner neighbour's new velocity."""
    forward, start = np.uint64(1), np.uint64(middle)
    for side in range(2):
        way = forward if side == 1 else -forward
        inner = np.uint64(0) if side == 0 else -forward
        end = -forward if side == 0 else np.uint64(v.size)
        i = start + way
        x = v[start]
        while i != end:
            while i != end:
                slipping = v[i] - (H1[i + inner] * pivot[i]) * x
                if not slipping * slip[i] > 0.0:
                    break
                x = v[i] = slipping
                i += way
            if x == 0.0:
                # Between points at rest; the outermost point is left to the lines below.
                while i != end and i + way != end:
                    if slip[i] != 0.0 or slip[i + way] != 0.0 or not sticks(g[i], hold[i]):
                        break
                    i += way
            if i == end:
                break
            t = g[i] - H1[i + inner] * x
            diagonal = H0[i]
            if i + way != end and slip[i + way] != 0.0:
                outer = H1[i + inner + way]
                t -= outer * v[i + way]
                diagonal -= outer * outer * pivot[i + way]
            x = v[i] = 0.0 if sticks(t, hold[i]) else (t - copysign(w[i], t)) / diagonal
            i += way


@compiled_inside
def _friction_and_residual(H0, H1, w, g, v, friction, r):
    """Friction that holds the points at rest and opposes the others, and the residual."""
    last = v.size - 1
    r[0] = H0[0] * v[0] - g[0]
    if last > 0:
        r[0] += H1[0] * v[1]
        r[last] = H0[last] * v[last] - g[last] + H1[last - 1] * v[last - 1]
    for i in range(1, last):
        r[i] = H0[i] * v[i] - g[i] + H1[i - 1] * v[i - 1] + H1[i] * v[i + 1]
    for i in range(v.size):
        friction[i] = min(max(-r[i], -w[i]), w[i]) if v[i] == 0.0 else copysign(w[i], v[i])
        r[i] += friction[i]


@compiled_inside
def _beyond(x, bound):
    """Number of entries that are larger than a bound, or not numbers."""
    count = 0
    for i in range(x.size):
        count += not abs(x[i]) <= bound
    return count


@compiled
def eliminate_fronts(chain, workspace, g, hold, tolerance):
    """Passes of elimination that decide between stick and slip, the first from rest.

    ``g`` is the right side, (n,), and ``hold`` the largest force at which each point sticks, N.
    Returns the number of passes, and whether the last pass solves the problem. Results are in
    ``velocity``, ``force`` and ``new_parameter`` of the workspace.
    """
    H0, H1, w, pivot, stretch = chain.H0, chain.H1, chain.w, chain.pivot, chain.stretch
    v, sigma, s = workspace.velocity, workspace.force, workspace.new_parameter
    slip, r, middle = workspace.work[2], workspace.work[4], workspace.middle[0]
    bound = tolerance * largest_of(g)
    for i in range(v.size):
        v[i] = 0.0
    passes = 0
    converged = False
    while passes < 8 and not converged:  # more passes seldom help
        passes += 1
        if v[middle] != 0.0:  # slip spreads fast towards the meeting point alone
            middle = _meeting_point(v, middle)
        _inwards(H0, H1, w, hold, pivot, stretch, g, v, slip, middle)
        _outwards(H0, H1, w, hold, pivot, g, v, slip, middle)
        _friction_and_residual(H0, H1, w, g, v, sigma, r)
        converged = _beyond(r, bound) == 0
        if not converged:
            for i in range(v.size):
                slip[i] = H0[i] * v[i]
            converged = _beyond(r, ROUND_OFF * largest_of(slip)) == 0
    if converged:
        for i in range(v.size):
            sigma[i] = sigma[i] / w[i] if hold[i] > 0.0 else 0.0
            s[i] = chain.kappa * v[i] + sigma[i]
    workspace.middle[0] = middle
    return passes, converged


@compiled_for(minimise_step, Chain)
def _minimise_chain(problem, workspace, right, v, tolerance):
    """Passes of elimination for Coulomb friction or after slow steps; then Newton on the graph."""
    chain, n = problem, right.size
    s, s_new = workspace.parameter, workspace.new_parameter
    v_new, sigma_new, remaining = workspace.velocity, workspace.force, workspace.special_starts[0]
    count, tier, converged, near, residual, unknown = 0, 0, False, False, 0.0, 0
    sprung = chain.soft.size > 0
    if chain.mixed == 2 and not sprung:
        count, converged = eliminate_fronts(chain, workspace, right, chain.hold, tolerance)
    elif remaining > 0 and n <= 2000 and not sprung:  # longer chains start from coarser ones
        count, near = eliminate_fronts(chain, workspace, right, chain.w, tolerance)
        if near:
            graph_parameters(chain.kind, chain.kappa, chain.inverse_beta, v_new, sigma_new, s_new)
    if not converged:
        for i in range(n):
            workspace.rights[i] = right[i]
            if not near:
                s_new[i] = 2.0 * s[i] - workspace.old_parameter[i]
        more, tier, converged, residual, unknown = newton_on_graph(
            chain, workspace.rights, workspace.parameters, workspace.work,
            workspace.trial, tolerance, remaining > 0 and not near,
        )  # fmt: skip
        count += more
    if converged:
        # A step of more than 8 iterations is slow: the special start serves the next 30 steps.
        if remaining == 0 and (tier == 1 or count > 8):
            workspace.special_starts[0] = 30
        elif remaining > 0:
            workspace.special_starts[0] -= 1
        for i in range(n):
            workspace.old_parameter[i] = s[i]
            s[i] = s_new[i]
    return StepOutcome(converged, count, tier == 1, tier == 2, 0, count + 1, residual, unknown)


@compiled_for(slips, Chain)
def _slips_of_chain(problem, x, out):
    """The unknowns themselves; those that are no slips count as points without friction."""
    return x


# The method


class FrontElimination(CompiledStepProblem):
    """Front elimination on a chain, see the module, `StepProblem` and `CompiledStepProblem`.

    Parameters
    ----------
    H : csr_array, shape (n, n), or Bands
        Symmetric positive definite and tridiagonal.
    points : ContactPoints
        Each row of ``B`` picks an unknown of its own.
    workspace : ChainWorkspace, optional
        Shared with problems of other matrices; made if not given.
    """

    factorizations = 1
    remembered = ("parameter", "old_parameter", "scale", "special_starts", "middle")

    def __init__(
        self, H: Any, points: ContactPoints, workspace: ChainWorkspace | None = None
    ) -> None:
        self.H, self.points = H, points
        matrix = H if isinstance(H, Bands) else bands(H)
        n, contact = matrix.diagonal.size, points.unknowns
        self.workspace = chain_workspace(n) if workspace is None else workspace
        self.places = Places(contact, contact)
        self._matrix, self.limits = matrix, np.zeros(n)
        self.limits[contact] = points.w
        self._law: tuple[FloatArray, Chain] | None = None  # of the last call with another law
        self.steps_per_second = max(1, 200_000 // n)

    @cached_property
    def kernel(self) -> Chain:
        """See `CompiledStepProblem`; that of the mass, which no step takes, is not made."""
        points, soft = self.points, None
        if points.flexible is not None:
            soft = np.zeros(self.limits.size)
            soft[points.unknowns] = points.soft
        chain = build_chain(self._matrix, self.limits, self._by_unknown(points.beta), soft)
        return chain if soft is None else chain._replace(offset=self.workspace.offsets)

    def _by_unknown(self, beta: FloatArray) -> FloatArray:
        by_unknown = np.full(self._matrix.diagonal.size, np.inf)
        by_unknown[self.points.unknowns] = beta
        return by_unknown

    def linearisation(self, beta: FloatArray | None = None) -> Linearisation:
        """See `LinearisedProblem`."""
        return Linearisation(as_sparse(self.H), self.points.with_beta(beta))

    def with_matrix(self, H: Any, points: ContactPoints | None = None) -> FrontElimination:
        """See `CompiledStepProblem`."""
        return FrontElimination(H, self.points if points is None else points, self.workspace)

    def restart(self, v: FloatArray, sigma: FloatArray) -> None:
        """See `CompiledStepProblem`: the parameter is taken from the law's graph."""
        self.workspace.scale[:] = 0.0

    def resume(self, v: FloatArray, sigma: FloatArray) -> None:
        """See `CompiledStepProblem`: the parameter's scale changes with the matrix."""
        if self.workspace.scale[0] != self.kernel.kappa:
            self._set_parameter(self.kernel, v, sigma)

    def _set_parameter(self, chain: Chain, v: FloatArray, sigma: FloatArray) -> None:
        """Let the next minimisation start from a point of the law's graph."""
        space, n = self.workspace, v.size
        kind, inverse_beta = chain.kind[:n], chain.inverse_beta[:n]
        if chain.soft.size:
            rates = np.zeros(n)
            law.slider_rates(kind, inverse_beta, chain.soft[:n], np.array(v), sigma, rates)
            v = rates
        graph_parameters(kind, chain.kappa, inverse_beta, v, sigma, space.parameter)
        space.old_parameter[:] = space.parameter
        space.scale[:] = chain.kappa

    def compile(self) -> None:
        """See `StepProblem`; by a chain of a single point, whose law takes the same functions."""
        points = self.points
        some = [int(np.argmin(points.beta))]  # Coulomb's law if all points have it
        flexible = None if points.flexible is None else points.flexible[some]
        one = ContactPoints(
            selection(np.zeros(1, dtype=np.intp), 1),
            points.directions[some],
            np.ones(1),
            points.beta[some],
            flexible,
        )
        FrontElimination(Bands(np.ones(1), np.zeros(0)), one).minimise(np.zeros(1))

    def minimise(
        self,
        g: FloatArray,
        start: FloatArray | None = None,
        tolerance: float = 1e-11,
        beta: FloatArray | None = None,
        offset: FloatArray | None = None,
        pressed: Pressed | None = None,
    ) -> Minimum:
        """See `StepProblem`."""
        chain, space = self.kernel, self.workspace
        if beta is not None and not np.array_equal(beta, self.points.beta):
            if self._law is None or not np.array_equal(beta, self._law[0]):
                self._law = beta.copy(), with_law(chain, self._by_unknown(beta))
            chain = self._law[1]
        contact, sprung = self.points.unknowns, self.points.flexible is not None
        if sprung:
            space.offset[contact] = 0.0 if offset is None else offset
        if chain.mixed < 2 or sprung:  # Newton's method needs a start, which elimination does not
            v = np.zeros_like(g) if start is None else start
            on_law, own = np.zeros_like(v), self.points.beta if beta is None else beta
            slip = v[contact] - space.offset[contact] if sprung else v[contact]
            on_law[contact] = law.force(slip, own, self.points.soft)
            self._set_parameter(chain, v, on_law)
        # Not by the loop's way as a whole: to compile that once more would take 2 s.
        count, tier, converged, residual, unknown = 0, 0, False, 0.0, 0
        g = np.ascontiguousarray(g)
        if chain.mixed == 2 and not sprung:
            count, converged = eliminate_fronts(chain, space, g, chain.hold, tolerance)
        if not converged:
            space.rights[: g.size] = g
            space.new_parameter[:] = space.parameter if chain.mixed < 2 or sprung else 0.0
            more, tier, converged, residual, unknown = newton_on_graph(
                chain, space.rights, space.parameters, space.work, space.trial, tolerance, False
            )
            count += more
        outcome = StepOutcome(
            converged, count, tier == 1, tier == 2, 0, count + 1, residual, unknown
        )
        return Minimum.of(outcome, space.velocity, space.force[contact], self.points)

    def check(self, saved: dict[str, NDArray[Any]]) -> None:
        """See `StepProblem`: the compiled loops meet at a point of the chain."""
        super().check(saved)
        n = self.limits.size
        if not 0 <= saved["middle"][0] < n or saved["special_starts"][0] < 0:
            raise ValueError(f"step problem/middle is {saved['middle'][0]} of {n} unknowns")
