"""Primal-dual Newton method, for dense problems whose slips depend on each other.

A reduced model has more contact points than unknowns, so that they cannot all stick. Newton's
method runs on the velocity itself, with an exact line search on the strictly convex objective

    1/2 v H v - g v + sum w psi(|B v|).

It is globally convergent for a finite beta, and never failed on reduced models.

Far from v = 0 the arctangent is almost flat, and Newton's method with its slope overshoots. The
secant stiffness sigma(v) / v is never too small, but converges slowly. The tangent used here lies
between them:

    sigma(v) / v + t (sigma'(v) - sigma(v) / v),    t = predicted force / (w sigma(v)),

where the last iteration predicted the friction force of each point by its own tangent, limited to
|force| <= w. Near the solution the prediction is right, t = 1, and this is Newton's tangent; a
prediction of the opposite sign stiffens it. This is the primal-dual Newton method (Chan, Golub and
Mulet, SIAM J. Sci. Comput. 20, 1999). It has the same solution and order of convergence.

Measured on two bolted solids with 44 unknowns, iterations with a new factor and evaluations of
friction for each time step: 11 and 48 with the slope alone, 7.2 and 10 with this tangent, and 9.0
and 12, a tenth faster, if a factor is used again while it reduces the residual tenfold, as here.

Most of the time goes into the tangent B' D B, n^2 rows multiplications. It is added up once in a
step, and after that only for points whose own tangent changed by 2 % or more, which are about half
of them; sums run over tiles of four rows and two columns. Of models for a range of a plate (31
unknowns, 93 points), a bracket (48, 144) and a solid (90, 270), processor time of a step on a busy
machine, us, before and after: 291 and 197 to 237, 634 and 324, 6,381 and 2,541. New factors in a
step stay 9.1, 8.0 and 16. What did not help, tried on steps of the plate and the bracket alone:

- tangents held up to a change of 20 %: more than twice as many factors;
- a factor used again while it reduces the residual to 0.3 or 0.6: 9 to 21 % fewer new factors,
  for a sixth to twice as many evaluations more; no time is saved;
- full steps accepted further beyond the minimum of the line: a sixth of the evaluations less, as
  many factors;
- a law that starts less steep and is made steeper by 10 to 100 in each iteration: between 3 % fewer
  factors and 38 % more;
- Newton's method on Minty's parameter: three times as many iterations and more, some without end;
- a start from the last velocity in place of the extrapolated one: half an iteration more.

Set-valued Coulomb friction, for quasi-static increments, is the limit of ever steeper laws.
"""

# numba infers the types of compiled functions:
# mypy: allow-untyped-defs, allow-untyped-calls, allow-untyped-decorators, no-check-untyped-defs

from __future__ import annotations

from math import copysign, inf, sqrt
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from skfem_joint.arrays import FloatArray, as_dense, check_like, slip_norms
from skfem_joint.compiling import compiled, compiled_for, compiled_inside
from skfem_joint.linalg.factors import factorised
from skfem_joint.linalg.kernels import (
    Full,
    add_row_products,
    add_symmetric_product,
    aligned,
    cholesky,
    combine_rows,
    largest_of,
    solve_factorised,
    sum_of_magnitudes,
    sum_of_products,
    sum_of_triple_products,
)
from skfem_joint.minimise.compiled_step import Places, StepOutcome, minimise_step, row_order, slips
from skfem_joint.minimise.law import forces, potential, slope_of, sprung_force, sprung_slope
from skfem_joint.minimise.line_search import friction_slope, line_search
from skfem_joint.minimise.problem import ContactPoints, Minimum, Pressed


class PrimalDualSettings(NamedTuple):
    """Numbers of the primal-dual Newton method.

    Attributes
    ----------
    iterations : int
        Most iterations.
    reuse : float
        A factor is used again where the last iteration reduced the residual to less than this
        share.
    change : float
        Relative change of a point's tangent up to which the earlier one stays.
    most : float
        Share of the slip rows above which all tangents are added up anew.
    round_off : float
        Accepted residual in units of the forces that are added up.
    nothing : float
        Forces, N, that count as none.
    steeper : tuple of float
        Coulomb friction: beta times the largest slip of the laws in turn.
    stiffest : float
        Largest stiffness of the last law over the least stiffness of the structure, which round-off
        would hide if the law were steeper.
    """

    iterations: int = 200
    reuse: float = 0.1
    change: float = 0.02
    most: float = 0.6
    round_off: float = 16 * float(np.finfo(np.float64).eps)
    nothing: float = 1e-300
    steeper: tuple[float, ...] = (1e2, 1e4, 1e6)
    stiffest: float = 1e12


SETTINGS = PrimalDualSettings()


class DenseRows(NamedTuple):
    """Slip rows of a dense problem: first rows of all points, then second rows of those with two.

    Points with two rows come first. Loops run along the points and become vector instructions.

    Attributes
    ----------
    B : ndarray, shape (n, rows)
        Transposed slip operator.
    w : ndarray, shape (rows,)
        Friction limit of each row's point, N.
    beta : ndarray, shape (m,)
        Steepness of each point, s/m, finite unless it has a spring; 0 where there is no friction.
    soft : ndarray, shape (m,)
        Compliance of the springs in series, m/s, 0 for none; empty if no point has one.
    """

    B: Any
    w: Any
    beta: Any
    soft: Any


class Dense(NamedTuple):
    """Problem of a step: the matrix H, N s/m, and the slip rows."""

    H: Any
    contact: DenseRows


class DenseWorkspace(NamedTuple):
    """Values that steps keep for later steps, results of the last step, and arrays to work in.

    Attributes
    ----------
    old_velocity : ndarray, shape (n,)
        Before the last step, m/s.
    old_force : ndarray, shape (rows,)
        Normalised friction before the last step.
    predicted : ndarray, shape (rows,)
        Friction predicted by the last iteration, or extrapolated from the last two steps, N.
    velocity, force, slip : ndarray, shape (n,), (rows,) and (rows,)
        Result of the last minimisation: velocity, normalised friction, slip velocity.
    size, ratio : ndarray, shape (m,)
        Norms of slip vectors, and force over norm; empty if each point has a single row.
    offset : ndarray, shape (rows,)
        Slips from which those of points with springs count, m/s.
    held, held_cross : ndarray, shape (rows,) and (m,)
        Tangents of the points' friction that are added up in S, N s/m.
    changed : ndarray of int, shape (m,)
        Points whose tangents changed.
    r, d_slip, trial, weight, scaled, cross, A, S, X, Y : ndarray
        Arrays to work in.
    """

    old_velocity: Any
    old_force: Any
    predicted: Any
    velocity: Any
    force: Any
    slip: Any
    r: Any
    d_slip: Any
    trial: Any
    weight: Any
    scaled: Any
    held: Any
    cross: Any
    held_cross: Any
    size: Any
    ratio: Any
    offset: Any
    A: Any
    S: Any
    X: Any
    Y: Any
    changed: Any


def rows_of(points: ContactPoints) -> tuple[DenseRows, Places]:
    """Slip rows of contact points, with a steepness of 1 s/m for those of Coulomb's law."""
    w, (row, point) = points.w, row_order(points.directions)
    may_be_steep = np.isfinite(points.beta) | points.has_spring
    beta = np.where(w > 0.0, np.where(may_be_steep, points.beta, 1.0), 0.0)
    soft = np.zeros(0) if points.flexible is None else points.soft[point]
    values = as_dense(points.B)[row].T, points.on_rows(w)[row], beta[point], soft
    memory = aligned(*(value.size for value in values))
    rows = DenseRows(memory[0].reshape(values[0].shape), *memory[1:])
    for array, value in zip(rows, values, strict=True):
        array[...] = value
    return rows, Places(np.argsort(row), np.argsort(point))


def dense_workspace(n: int, rows: int, m: int) -> DenseWorkspace:
    """Make the workspace for n unknowns, some slip rows and m points."""
    point, pairs = m if rows > m else 0, rows - m
    sizes = [n, *2 * [rows], n, *2 * [rows], n, *5 * [rows], *2 * [pairs], *2 * [point], rows]
    shapes = (n, n), (n, n), (n, rows), (n, rows)
    vectors = aligned(*sizes, *(i * j for i, j in shapes))
    matrices = [a.reshape(shape) for a, shape in zip(vectors[-4:], shapes, strict=True)]
    arrays: list[Any] = [*vectors[:-4], *matrices, np.zeros(m, np.int64)]
    return DenseWorkspace(*arrays)


@compiled_inside
def _slip_of_points(contact, space, q, slip):
    """Slip of all rows at velocities q, from the offsets of those with springs."""
    combine_rows(contact.B, q, slip)
    if contact.soft.size > 0:
        for i in range(slip.size):
            slip[i] -= space.offset[i]


@compiled_inside
def _forces(contact, slip, sigma):
    """Normalised forces of points with some slips, (m,)."""
    beta, soft = contact.beta, contact.soft
    forces(beta, slip, sigma)
    for p in range(soft.size):
        if soft[p] > 0.0:
            sigma[p] = copysign(sprung_force(abs(slip[p]), beta[p], soft[p]), slip[p])


@compiled_inside
def _slopes(contact, slip, out):
    """Slopes, s/m, of the points' laws at some slips, (m,)."""
    beta, soft = contact.beta, contact.soft
    for p in range(slip.size):
        out[p] = beta[p] * slope_of(beta[p] * slip[p])
    for p in range(soft.size):
        if soft[p] > 0.0:
            out[p] = sprung_slope(abs(slip[p]), beta[p], soft[p])


@compiled_inside
def _evaluate(contact, slip, size, ratio, sigma):
    """Normalised friction of all rows."""
    beta, soft = contact.beta, contact.soft
    m = beta.size
    pairs = slip.size - m
    if pairs == 0:
        _forces(contact, slip, sigma)
        return
    # Slices, because an index that does not start at 0 is checked for counting from the end.
    first, second, single, norm = slip[:pairs], slip[m:], slip[pairs:m], size[pairs:]
    for p in range(pairs):
        size[p] = sqrt(first[p] * first[p] + second[p] * second[p])
    for p in range(norm.size):
        norm[p] = abs(single[p])
    _forces(contact, size, ratio)
    force = sigma[m:]
    for p in range(m):
        at_rest = size[p] == 0.0
        over = 1.0 if at_rest else size[p]
        ratio[p] = (beta[p] * slope_of(0.0) if at_rest else ratio[p]) / over
        sigma[p] = ratio[p] * slip[p]
    for p in range(soft.size):
        if soft[p] > 0.0 and size[p] == 0.0:
            ratio[p], sigma[p] = sprung_slope(0.0, beta[p], soft[p]), 0.0
    for p in range(pairs):
        force[p] = ratio[p] * second[p]


@compiled_inside
def _force_at_rest(contact, space):
    """Largest force of springs on an unknown at rest, N: a scale where no load acts."""
    for i in range(space.trial.size):
        space.trial[i] = -space.offset[i]
    _evaluate(contact, space.trial, space.size, space.ratio, space.force)
    largest = 0.0
    for j in range(space.r.size):
        largest = max(largest, abs(sum_of_triple_products(contact.w, space.force, contact.B[j])))
    return largest


@compiled_inside
def _weigh(contact, slip, sigma, space):
    """Tangent of each point's friction, N s/m: entries of a symmetric matrix of its rows.

    Across a slip vector the tangent is force over norm. Along it, it is between that and the law's
    slope, in the ratio in which the predicted force is between zero and the law's.
    """
    w, slopes = contact.w, space.scaled
    weight, cross = space.weight, space.cross
    size, ratio, predicted = space.size, space.ratio, space.predicted
    m = contact.beta.size
    pairs = slip.size - m
    _slopes(contact, slip if pairs == 0 else size, slopes)
    first, second, force_1, force_2 = slip[:pairs], slip[m:], predicted[:pairs], predicted[m:]
    weight_2 = weight[m:]
    for p in range(pairs):
        across = w[p] * ratio[p]
        square = across * size[p] * size[p]
        more = w[p] * slopes[p] - across
        moves = square > 0.0
        share = (more if moves else 0.0) / (square if moves else 1.0)
        weight[p] = across + share * (first[p] * force_1[p])
        weight_2[p] = across + share * (second[p] * force_2[p])
        cross[p] = 0.5 * share * (first[p] * force_2[p] + second[p] * force_1[p])
    for p in range(pairs, m):
        slope, force = w[p] * slopes[p], w[p] * sigma[p]
        moves = abs(force) > 0.0
        across = force / slip[p] if moves else slope
        share = predicted[p] / force if moves else 1.0
        weight[p] = across + (slope - across) * share


@compiled_inside
def _changed(pairs, space):
    """List points whose tangent changed; returns their number and that of points with two rows."""
    weight, cross, held, held_cross = space.weight, space.cross, space.held, space.held_cross
    changed, m, count = space.changed, space.changed.size, 0
    for p in range(pairs):
        q = m + p
        least = min(weight[p] + weight[q], held[p] + held[q])
        change = max(abs(weight[p] - held[p]), abs(weight[q] - held[q]))
        changed[count] = p
        count += max(change, abs(cross[p] - held_cross[p])) > SETTINGS.change * least
    doubled = count
    for p in range(pairs, m):
        changed[count] = p
        count += abs(weight[p] - held[p]) > SETTINGS.change * min(weight[p], held[p])
    return count, doubled


@compiled_inside
def _add_all(contact, space):
    """Tangent of all points' friction in S."""
    B, S, X = contact.B, space.S, space.X
    weight, cross = space.weight, space.cross
    m = contact.beta.size
    pairs = weight.size - m
    for j in range(len(B)):
        first, second, out, out_second = B[j, :m], B[j, m:], X[j, :m], X[j, m:]
        for p in range(pairs):
            out[p] = weight[p] * first[p] + cross[p] * second[p]
        for p in range(pairs):
            out_second[p] = weight[m + p] * second[p] + cross[p] * first[p]
        for p in range(pairs, m):
            out[p] = weight[p] * first[p]
        for k in range(j, len(B)):
            S[j, k] = 0.0
    for i in range(weight.size):
        space.held[i] = weight[i]
    for p in range(pairs):
        space.held_cross[p] = cross[p]
    add_symmetric_product(X, B, weight.size, S)


@compiled_inside
def _add_changed(contact, count, doubled, space):
    """Add the change of the tangents of some points to S."""
    B, X, Y, changed = contact.B, space.X, space.Y, space.changed
    weight, cross, held, held_cross = space.weight, space.cross, space.held, space.held_cross
    m = contact.beta.size
    for i in range(count):  # from here `weight` and `cross` of these points are changes
        p = changed[i]
        weight[p], held[p] = weight[p] - held[p], weight[p]
        if i < doubled:
            q = m + p
            weight[q], held[q] = weight[q] - held[q], weight[q]
            cross[p], held_cross[p] = cross[p] - held_cross[p], cross[p]
    for j in range(len(B)):
        row, x, y = B[j], X[j], Y[j]
        for i in range(doubled):
            p = changed[i]
            first, second = row[p], row[m + p]
            y[2 * i], y[2 * i + 1] = first, second
            x[2 * i] = weight[p] * first + cross[p] * second
            x[2 * i + 1] = weight[m + p] * second + cross[p] * first
        for i in range(doubled, count):
            p = changed[i]
            y[doubled + i] = row[p]
            x[doubled + i] = weight[p] * row[p]
    add_symmetric_product(X, Y, count + doubled, space.S)


@compiled_inside
def _factorised(H, contact, slip, sigma, anew, space):
    """Factor in A of H plus the tangent of the friction; False if there is none.

    Unless all is made anew, tangents of points that changed little since they were added stay.
    """
    A, S, rows = space.A, space.S, slip.size
    _weigh(contact, slip, sigma, space)
    count, doubled = 0, 0
    if not anew:
        count, doubled = _changed(rows - contact.beta.size, space)
    if anew or count + doubled > SETTINGS.most * rows:
        _add_all(contact, space)
    elif count > 0:
        _add_changed(contact, count, doubled, space)
    for j in range(len(A)):
        for k in range(j, len(A)):
            A[j, k] = H[j, k] + S[j, k]
    return cholesky(A)


@compiled_inside
def _limit(contact, predicted):
    """Scale the forces (rows,), N, of each point down to its friction limit."""
    w = contact.w
    m = contact.beta.size
    pairs = w.size - m
    first, second = predicted[:pairs], predicted[m:]
    for p in range(pairs):
        size = sqrt(first[p] * first[p] + second[p] * second[p])
        share = w[p] / max(size, w[p], SETTINGS.nothing)
        first[p] *= share
        second[p] *= share
    for p in range(pairs, m):
        predicted[p] = min(max(predicted[p], -w[p]), w[p])


@compiled_inside
def _predict(contact, sigma, d_slip, space):
    """Friction after a full Newton step by its tangent, limited to what friction can be."""
    w, weight, cross, predicted = contact.w, space.held, space.held_cross, space.predicted
    m = contact.beta.size
    pairs = w.size - m
    for i in range(w.size):
        predicted[i] = w[i] * sigma[i] + weight[i] * d_slip[i]
    first, second, d_first, d_second = predicted[:pairs], predicted[m:], d_slip[:pairs], d_slip[m:]
    for p in range(pairs):
        first[p] += cross[p] * d_second[p]
        second[p] += cross[p] * d_first[p]
    _limit(contact, predicted)


@compiled_inside
def _round_off(H, contact, q, slip, sigma, space):
    """Round-off of the residual: of H q, and of the slip velocities times the law's slope."""
    B, w = contact.B, contact.w
    n = q.size
    m = contact.beta.size
    pairs = slip.size - m
    friction, slopes = space.scaled, space.weight
    for i in range(slip.size):
        friction[i] = 0.0
    for k in range(n):
        row, t = B[k], abs(q[k])
        for i in range(slip.size):
            friction[i] += abs(row[i]) * t
    if contact.soft.size > 0:
        for i in range(slip.size):
            friction[i] += abs(space.offset[i])
    if pairs == 0:
        _slopes(contact, slip, slopes)
    for i in range(slip.size):
        # Of two directions the larger one.
        slope = slopes[i] if pairs == 0 else space.ratio[i if i < m else i - m]
        friction[i] = w[i] * (abs(sigma[i]) + slope * friction[i])
    largest = 0.0
    for j in range(n):
        total = sum_of_magnitudes(H[j], q) + sum_of_magnitudes(B[j], friction)
        largest = max(largest, total)
    return SETTINGS.round_off * largest


class _Line(NamedTuple):
    """Line through the slips of all rows, for the search along it."""

    contact: Any
    space: Any


@compiled_for(friction_slope, _Line)
def _slope_along(line, length):
    """Derivative of sum w psi along a direction, W; slips and forces stay in the workspace."""
    contact, space = line
    slip, d_slip, trial = space.slip, space.d_slip, space.trial
    for i in range(slip.size):
        trial[i] = slip[i] + length * d_slip[i]
    _evaluate(contact, trial, space.size, space.ratio, space.force)
    return sum_of_triple_products(contact.w, space.force, d_slip)


@compiled_for(minimise_step, Dense)
def _minimise_dense(problem, workspace, right, v, tolerance):
    """Minimise the step's objective, from the velocity extrapolated over the last two steps.

    The minimiser is left in ``space.velocity``, its slips in ``space.slip`` and its forces in
    ``space.force``, with an entry for each slip row.
    """
    space = workspace
    H, contact = problem
    q, before, slip, sigma = space.velocity, space.old_velocity, space.slip, space.force
    r, A, d_slip = space.r, space.A, space.d_slip
    n, scale = q.size, largest_of(right)
    if contact.soft.size > 0:
        scale = max(scale, _force_at_rest(contact, space))
    for i in range(n):
        q[i] = 2.0 * v[i] - before[i]
    evaluations, iteration, tangents, unknown, largest, converged = 0, 0, 0, 0, 0.0, False
    known = False  # whether slip and sigma belong to q
    for iteration in range(SETTINGS.iterations + 1):
        for i in range(n):
            r[i] = sum_of_products(H[i], q) - right[i]
        if not known:
            _slip_of_points(contact, space, q, slip)
            _evaluate(contact, slip, space.size, space.ratio, sigma)
            evaluations += 1
        last, largest = largest, 0.0
        for i in range(sigma.size):
            space.trial[i] = contact.w[i] * sigma[i]
        add_row_products(contact.B, space.trial, r)
        for i in range(n):
            if not abs(r[i]) <= largest and largest == largest:  # once not a number, it stays so
                largest, unknown = abs(r[i]), i
        converged = largest < inf and (
            largest <= tolerance * scale
            or (
                largest <= 1e-6 * scale and largest <= _round_off(H, contact, q, slip, sigma, space)
            )
        )
        if converged or not largest < inf or iteration == SETTINGS.iterations:
            break
        if iteration == 0 or not largest < SETTINGS.reuse * last:  # else reuse the last factor
            tangents += 1
            if not (
                _factorised(H, contact, slip, sigma, iteration == 0, space)
                or _factorised(H, contact, slip, sigma, True, space)
            ):
                break
        solve_factorised(A, r)
        linear, quadratic, direction = 0.0, 0.0, r
        for i in range(n):
            direction[i] = -r[i]
        for i in range(n):
            t = sum_of_products(H[i], direction)
            linear += t * q[i] - right[i] * direction[i]
            quadratic += t * direction[i]
        combine_rows(contact.B, direction, d_slip)
        slope_0 = linear + sum_of_triple_products(contact.w, sigma, d_slip)
        _predict(contact, sigma, d_slip, space)
        length, trials, known = line_search(_Line(contact, space), slope_0, linear, quadratic)
        if known:
            for i in range(slip.size):
                slip[i] = space.trial[i]
        evaluations += trials
        for i in range(n):
            q[i] += length * direction[i]
    if converged:
        for i in range(n):
            before[i] = v[i]
        for i in range(sigma.size):
            space.predicted[i] = contact.w[i] * (2.0 * sigma[i] - space.old_force[i])
            space.old_force[i] = sigma[i]
        _limit(contact, space.predicted)
    else:
        for i in range(sigma.size):
            space.predicted[i] = 0.0
    searches = evaluations - iteration - 1
    return StepOutcome(converged, tangents, 0, 0, searches, evaluations, largest, unknown)


@compiled_for(slips, Dense)
def _slips_of_dense(problem, x, out):
    combine_rows(problem.contact.B, x, out)
    return out


@compiled
def _minimise(problem, workspace, right, v, tolerance):
    return minimise_step(problem, workspace, right, v, tolerance)


# The method


class PrimalDualNewton:
    """The primal-dual Newton method, see the module, `StepProblem` and `CompiledStepProblem`.

    Parameters
    ----------
    H : ndarray, shape (n, n), or Full
        Symmetric positive definite.
    points : ContactPoints
        Any slip rows.
    workspace : DenseWorkspace, optional
        Shared with problems of other matrices; made if not given.
    """

    remembered = ("old_velocity", "old_force", "predicted")

    def __init__(
        self, H: Any, points: ContactPoints, workspace: DenseWorkspace | None = None
    ) -> None:
        self.H: FloatArray = H.entries if isinstance(H, Full) else as_dense(H)
        self.points, self.factorizations = points, 1
        self.contact, self.places = rows_of(points)
        self.limits = self.contact.w
        n, rows = len(self.H), self.limits.size
        space = dense_workspace(n, rows, points.w.size) if workspace is None else workspace
        self.workspace = space
        self.kernel = Dense(self.H, self.contact)
        self.steps_per_second = max(1, 10_000_000 // (rows * n**2))
        self._own = self.contact.beta.copy()
        self._stuck: tuple[Any, float] | None = None

    def with_matrix(self, H: Any, points: ContactPoints | None = None) -> PrimalDualNewton:
        """See `CompiledStepProblem`."""
        return PrimalDualNewton(H, self.points if points is None else points, self.workspace)

    def restart(self, v: FloatArray, sigma: FloatArray) -> None:
        """See `CompiledStepProblem`: nothing is extrapolated."""
        space = self.workspace
        space.old_velocity[:], space.old_force[:] = v, sigma
        space.predicted[:] = self.limits * sigma

    def resume(self, v: FloatArray, sigma: FloatArray) -> None:
        """See `CompiledStepProblem`: nothing depends on the matrix."""

    def compile(self) -> None:
        """See `StepProblem`; values kept for later steps do not change."""
        none = np.zeros(len(self.H))
        PrimalDualNewton(self.H, self.points)._minimise(none, none, 1.0)

    def minimise(
        self,
        g: FloatArray,
        start: FloatArray | None = None,
        tolerance: float = 1e-11,
        beta: FloatArray | None = None,
        offset: FloatArray | None = None,
        pressed: Pressed | None = None,
    ) -> Minimum:
        """See `StepProblem`; Coulomb friction is approached by ever steeper laws.

        The steepness of each law follows from the largest slip under the law before. Points with
        springs have their own law: their forces are smooth enough.
        """
        law = np.where(self.points.w > 0.0, self.points.beta if beta is None else beta, 0.0)
        coulomb = np.isinf(law) & ~self.points.has_spring
        v = self._from_stuck(g) if start is None else start
        self.workspace.offset[self.places.row] = 0.0 if offset is None else offset
        if not coulomb.any():
            return self._with_law(law, g, v, tolerance)
        minimum = Minimum(v, np.zeros(self.limits.size), False)
        for steepness in SETTINGS.steeper:
            slip = slip_norms(self.points.B @ v, self.points.directions).max()
            most = self._stiff()[1]
            steep = min(steepness / slip, most) if slip > 0.0 else most
            minimum = self._with_law(np.where(coulomb, steep, law), g, v, tolerance)
            v = minimum.v
            if not minimum.converged:
                break
        return minimum

    def _with_law(
        self, law: FloatArray, g: FloatArray, start: FloatArray, tolerance: float
    ) -> Minimum:
        """Minimise for finite values of beta of the points, (m,)."""
        self.contact.beta[self.places.point] = law
        outcome = self._minimise(g, start, tolerance)
        self.contact.beta[:] = self._own
        counts = {
            name: int(getattr(outcome, name))
            for name in ("newton_iterations", "line_searches", "friction_evaluations")
        }
        return Minimum(
            self.workspace.velocity.copy(),
            self.workspace.force[self.places.row],
            bool(outcome.converged),
            counts,
            float(outcome.residual),
            int(outcome.unknown),
            w=self.points.w,
        )

    def _minimise(self, g: FloatArray, start: FloatArray, tolerance: float) -> StepOutcome:
        v = np.array(start)
        self.workspace.old_velocity[:] = v  # the start is not extrapolated
        outcome: StepOutcome = _minimise(
            self.kernel, self.workspace, np.ascontiguousarray(g), v, tolerance
        )
        return outcome

    def _stiff(self) -> tuple[Any, float]:
        """Solver with springs at all points in place of friction, and the steepest law."""
        if self._stuck is None:
            B = as_dense(self.points.B)
            springs = (B.T * self.points.on_rows(self.points.w)) @ B
            unit = np.trace(self.H) / np.trace(springs)
            stuck = self.H + unit * springs
            least = np.linalg.eigvalsh(stuck)[0]
            steepest = SETTINGS.stiffest * unit * least / np.trace(self.H)
            self._stuck = factorised(stuck), float(steepest)
        return self._stuck

    def _from_stuck(self, g: FloatArray) -> FloatArray:
        """Solution with springs at all points in place of friction, as a start."""
        return np.asarray(self._stiff()[0](g))

    def objective(
        self,
        v: FloatArray,
        g: FloatArray,
        beta: FloatArray | None = None,
        offset: FloatArray | None = None,
    ) -> float:
        """See `StepProblem`."""
        slip = self.points.B @ v - (0.0 if offset is None else offset)
        size = slip_norms(slip, self.points.directions)
        psi = potential(size, self.points.beta if beta is None else beta, self.points.soft)
        return float(v @ (0.5 * (self.H @ v) - g) + self.points.w @ psi)

    def saved(self) -> dict[str, NDArray[Any]]:
        """See `StepProblem`."""
        return {name: np.array(getattr(self.workspace, name)) for name in self.remembered}

    def check(self, saved: dict[str, NDArray[Any]]) -> None:
        """See `StepProblem`."""
        check_like(saved, self.saved(), "step problem")

    def restore(self, saved: dict[str, NDArray[Any]]) -> None:
        """See `StepProblem`."""
        for name in self.remembered:
            getattr(self.workspace, name)[:] = saved[name]
