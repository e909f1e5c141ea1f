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

Contact that opens adds a term of the approaches N v of pressure points, with a stiffness k,

    sum k / 2 max(N v - bound, 0)^2,

since they cannot all rest on their bounds either. Its slopes are the normal forces p, and friction
limits follow them, w = max(0, given + gain p). `Dense` has constant limits, `Following` such as
follow in each evaluation, and `Kept` such as are kept. All three run through `_minimise_from`;
the functions above it that are not implemented are where they differ.

The tangent of `Following` has the change of the friction F of each slip row by its limit,

    H + B' D B + sum_c k_c (N_c + sum_f gain_fc B_f' dF_f/dw_f) N_c,    dF/dw = sigma (1 - soft d),

over the pressure points c that are pressed, which is not symmetric; d is the slope of the law with
its spring, so that friction of a slider that sticks does not change. There is no objective for a
line search: steps are shortened where the residual grows much. Where that iteration stalls, limits
are kept until the convex problem for them is solved, and then renewed by Anderson's acceleration.
What does not balance with the limits of its own normal forces is not returned as converged.
"""

# numba infers the types of compiled functions:
# mypy: allow-untyped-defs, allow-untyped-calls, allow-untyped-decorators, no-check-untyped-defs

from __future__ import annotations

from collections import Counter
from math import copysign, inf, sqrt
from typing import Any, NamedTuple, cast

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from skfem_joint.arrays import FloatArray, as_dense, check_like, slip_norms
from skfem_joint.compiling import compiled, compiled_for, compiled_inside, inlined
from skfem_joint.errors import InputError
from skfem_joint.linalg.factors import factorised
from skfem_joint.linalg.kernels import (
    Full,
    add_product,
    add_row_products,
    add_symmetric_product,
    aligned,
    cholesky,
    combine_rows,
    largest_of,
    lu,
    solve_factorised,
    solve_lu,
    sum_of_magnitudes,
    sum_of_products,
    sum_of_triple_products,
)
from skfem_joint.minimise.compiled_step import Places, StepOutcome, minimise_step, row_order, slips
from skfem_joint.minimise.law import forces, potential, slope_of, sprung_force, sprung_slope
from skfem_joint.minimise.limits import Renewal
from skfem_joint.minimise.line_search import friction_slope, line_search
from skfem_joint.minimise.problem import ContactPoints, Minimum, Pressed, PressurePoints


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
    turn : float
        Change of the derivative of a point's friction by its limit, over 1, up to which the earlier
        one stays.
    grows : float
        Limits that follow normal forces: a step is taken if the residual grows by no more than this
        factor. Residuals of few unknowns grow on the way: where each had to fall, steps of 67
        unknowns took 16.4 iterations in place of 12.9.
    shorter, shortened : float and int
        Factor by which other steps are shortened, and most times that they are.
    patience : int
        Iterations in which the residual must halve; otherwise limits are kept for a while.
    inner : float
        The problem of kept limits is solved to this share of the residual that these leave.
    again : float
        Limits follow normal forces again when those kept have brought the residual to this share of
        what it was.
    renewals : int
        Most times that kept limits are renewed.
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
    turn: float = 0.02
    grows: float = 4.0
    shorter: float = 0.4
    shortened: int = 8
    patience: int = 8
    inner: float = 0.1
    again: float = 0.1
    renewals: int = 100
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


class PressureRows(NamedTuple):
    """Pressure points of a dense problem, their forces now, and what belongs to their tangent.

    Attributes
    ----------
    N : ndarray, shape (n, q)
        Transposed operator of approaches.
    stiffness, bound : ndarray, shape (q,)
        Stiffness, in N over the unit of v, and approach at which each point begins to carry.
    start, column, gain : ndarray
        Compressed rows of the friction limit of each friction point by the forces p.
    point_start, point, point_gain : ndarray
        The same by columns: the friction points that each pressure point gives a limit.
    given : ndarray, shape (m,)
        Friction limits without forces, N.
    flexible : ndarray, shape (m,)
        Slip that the springs in series take under a unit of force; empty if no point has one.
    steep : ndarray, shape (m,)
        Steepness of each point where it has friction.
    over, p, d_over : ndarray, shape (q,)
        How far points are beyond their bounds, their forces, N, and the change along a direction.
    change, held_change : ndarray, shape (rows,)
        Derivative of friction by its limit, now and as it is added up in U.
    pressed : ndarray, shape (q,)
        1 where the stiffness of a point is added up in U, else 0.
    held : ndarray, shape (n, q)
        Stiffness of each point, N s/m, with what it gives to friction: U is held N'.
    U : ndarray, shape (n, n)
        Tangent of the normal forces, and of friction by them.
    order : ndarray of int, shape (n,)
        Unknowns in the order of the factor.
    pushed, tried, left, old_w, old_sigma, slip, rows : ndarray
        Arrays to work in: by unknown, slip row and, the last one, pressure point.
    X, Y : ndarray, shape (n, q)
        Arrays to work in.
    listed : ndarray of int, shape (q,)
        Pressure points whose tangents changed.
    watch : ndarray, shape (3,)
        Least residual up to now, N, iterations since it halved last, and of limits that follow the
        largest normal force on an unknown, of others the residual that is enough, N.
    """

    N: Any
    stiffness: Any
    bound: Any
    start: Any
    column: Any
    gain: Any
    point_start: Any
    point: Any
    point_gain: Any
    given: Any
    flexible: Any
    steep: Any
    over: Any
    p: Any
    d_over: Any
    change: Any
    held_change: Any
    pressed: Any
    held: Any
    U: Any
    order: Any
    pushed: Any
    tried: Any
    left: Any
    old_w: Any
    old_sigma: Any
    slip: Any
    rows: Any
    X: Any
    Y: Any
    listed: Any
    watch: Any


class Following(NamedTuple):
    """Problem of a step whose friction limits follow the forces of its pressure points."""

    H: Any
    contact: DenseRows
    normal: PressureRows


class Kept(NamedTuple):
    """The same with friction limits that are kept: a convex problem."""

    H: Any
    contact: DenseRows
    normal: PressureRows


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


def pressure_rows(points: ContactPoints, places: Places) -> PressureRows:
    """Pressure points of contact points whose friction has some places in the loops."""
    normal, order = cast("PressurePoints", points.normal), np.argsort(places.point)
    N = np.ascontiguousarray(as_dense(normal.N).T)
    (n, q), rows, m = N.shape, points.B.shape[0], order.size
    by_point = sparse.csr_array(normal.gain)[order]
    by_pressure = sparse.csr_array(by_point.T)
    compressed = [
        np.array(x, dtype=kind)
        for G in (by_point, by_pressure)
        for x, kind in zip((G.indptr, G.indices, G.data), (np.int64, np.int64, float), strict=True)
    ]
    flexible = np.zeros(0) if points.flexible is None else points.flexible[order]
    own = aligned(q, m, m, *3 * [q], *2 * [rows], q, n * n, *3 * [n], *3 * [rows], q)
    bound, given, steep, *forces, U, pushed, tried, left, old_w, old_sigma, slip, rows = own
    held, X, Y = np.zeros((3, n, q))
    arrays: list[Any] = [N, np.array(normal.stiffness, dtype=float), bound, *compressed, given]
    arrays += [flexible, steep, *forces, held, U.reshape((n, n)), np.zeros(n, np.int64), pushed]
    arrays += [tried, left, old_w, old_sigma, slip, rows, X, Y, np.zeros(q, np.int64), np.zeros(3)]
    return PressureRows._make(arrays)


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
def _factorised(problem, slip, sigma, anew, space):
    """Factor in A of H plus the tangent of friction and normal forces; False if there is none.

    Unless all is made anew, tangents of points that changed little since they were added stay.
    """
    contact, rows = problem.contact, slip.size
    _weigh(contact, slip, sigma, space)
    count, doubled = 0, 0
    if not anew:
        count, doubled = _changed(rows - contact.beta.size, space)
    if anew or count + doubled > SETTINGS.most * rows:
        _add_all(contact, space)
    elif count > 0:
        _add_changed(contact, count, doubled, space)
    return factor(problem, space, sigma, anew)


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


@compiled_inside
def _round_off(problem, q, slip, sigma, space):
    """Round-off of the residual: of H q, and of the slip velocities times the law's slope."""
    H, contact = problem.H, problem.contact
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
        largest = max(largest, total + magnitude_of_pressures(problem, q, j))
    return SETTINGS.round_off * largest


class _Line(NamedTuple):
    """Line through the slips of all rows, for the search along it."""

    contact: Any
    space: Any


@compiled_inside
def _friction_slope_along(contact, space, length):
    """Derivative of sum w psi along a direction, W; slips and forces stay in the workspace."""
    slip, d_slip, trial = space.slip, space.d_slip, space.trial
    for i in range(slip.size):
        trial[i] = slip[i] + length * d_slip[i]
    _evaluate(contact, trial, space.size, space.ratio, space.force)
    return sum_of_triple_products(contact.w, space.force, d_slip)


@compiled_for(friction_slope, _Line)
def _slope_along(line, length):
    return _friction_slope_along(line.contact, line.space, length)


# What differs with and without normal forces


def press(problem, q):
    """Forces of pressure points at velocities q, and the friction limits that follow them."""
    raise NotImplementedError


def add_pressures(problem, r):
    """Add the normal forces to the residual ``r``; returns the largest on an unknown, N."""
    raise NotImplementedError


def magnitude_of_pressures(problem, q, j):
    """Sum of the magnitudes that are added up in the normal forces on an unknown, N."""
    raise NotImplementedError


def recall(problem, r):
    """Take the residual found at the end of a step; returns as `add_pressures`, -1 if unknown."""
    raise NotImplementedError


def begin(problem, space):
    """Prepare for iterations, after the residual of the start."""
    raise NotImplementedError


def factor(problem, space, sigma, anew):
    """Factor in A of H, the tangent S of friction and that of normal forces; False if none."""
    raise NotImplementedError


def solve(problem, space, r):
    """Solve in place by the factor."""
    raise NotImplementedError


def advance(problem, space, right, largest, linear, quadratic):
    """Step length along ``space.r``, where slips move by ``space.d_slip``; see `line_search`."""
    raise NotImplementedError


def stalls(problem, largest):
    """Whether the iteration does not lead on, after an iteration with a residual, N."""
    raise NotImplementedError


@compiled_for(press, Dense, inlined=True)
def _press_nothing(problem, q):
    pass


@compiled_for(add_pressures, Dense, inlined=True)
def _add_no_pressures(problem, r):
    return 0.0


@compiled_for(magnitude_of_pressures, Dense, inlined=True)
def _no_magnitude_of_pressures(problem, q, j):
    return 0.0


@compiled_for(recall, Dense, Kept, inlined=True)
def _recall_nothing(problem, r):
    return -1.0


@compiled_for(begin, Dense, inlined=True)
def _begin_with_prediction(problem, space):
    pass


@compiled_for(factor, Dense, inlined=True)
def _factor_of_dense(problem, space, sigma, anew):
    H, A, S = problem.H, space.A, space.S
    for j in range(len(A)):
        for k in range(j, len(A)):
            A[j, k] = H[j, k] + S[j, k]
    return cholesky(A)


@compiled_for(solve, Dense, inlined=True)
def _solve_dense(problem, space, r):
    solve_factorised(space.A, r)


@compiled_for(advance, Dense, inlined=True)
def _advance_dense(problem, space, right, largest, linear, quadratic):
    contact = problem.contact
    slope_0 = linear + sum_of_triple_products(contact.w, space.force, space.d_slip)
    _predict(contact, space.force, space.d_slip, space)
    _limit(contact, space.predicted)
    length, trials, known = line_search(_Line(contact, space), slope_0, linear, quadratic)
    if known:
        for i in range(space.slip.size):
            space.slip[i] = space.trial[i]
    return length, trials, known


@compiled_for(stalls, Dense, inlined=True)
def _never_stalls(problem, largest):
    return False


# With normal forces


@compiled_inside
def _press(normal):
    """Forces of the pressure points from how far they are beyond their bounds."""
    over, p, stiffness = normal.over, normal.p, normal.stiffness
    for c in range(p.size):
        p[c] = stiffness[c] * max(over[c], 0.0)


@compiled_inside
def _approach(normal, q):
    """How far pressure points are beyond their bounds at velocities q, and their forces."""
    combine_rows(normal.N, q, normal.over)
    for c in range(normal.over.size):
        normal.over[c] -= normal.bound[c]
    _press(normal)


@compiled_inside
def _follow(contact, normal):
    """Friction limits that follow the normal forces."""
    for f in range(normal.given.size):
        limit = normal.given[f]
        for e in range(normal.start[f], normal.start[f + 1]):
            limit += normal.gain[e] * normal.p[normal.column[e]]
        _set_limit(contact, normal, f, max(limit, 0.0))


@compiled_inside
def _set_limit(contact, normal, f, limit):
    """Give a point a friction limit, N."""
    m = contact.beta.size
    contact.w[f] = limit
    if m + f < contact.w.size:
        contact.w[m + f] = limit
    if contact.soft.size > 0:
        contact.soft[f] = limit * normal.flexible[f]
        contact.beta[f] = normal.steep[f] if limit > 0.0 or normal.steep[f] < inf else 0.0


@compiled_for(press, Following, inlined=True)
def _press_and_follow(problem, q):
    _approach(problem.normal, q)
    _follow(problem.contact, problem.normal)


@compiled_for(press, Kept, inlined=True)
def _press_alone(problem, q):
    _approach(problem.normal, q)


@compiled_for(add_pressures, Following, Kept, inlined=True)
def _add_pressures(problem, r):
    normal, pushed = problem.normal, problem.normal.pushed
    for j in range(r.size):
        pushed[j] = 0.0
    add_row_products(normal.N, normal.p, pushed)
    for j in range(r.size):
        r[j] += pushed[j]
    return largest_of(pushed)


@compiled_for(magnitude_of_pressures, Following, Kept, inlined=True)
def _magnitude_of_pressures(problem, q, j):
    normal = problem.normal
    rows, bound = normal.rows, normal.bound
    if j == 0:
        for c in range(rows.size):
            rows[c] = abs(bound[c]) if normal.over[c] > 0.0 else 0.0
        for k in range(q.size):
            row, t = normal.N[k], abs(q[k])
            for c in range(rows.size):
                rows[c] += t * abs(row[c])
        for c in range(rows.size):
            rows[c] = normal.stiffness[c] * rows[c] if normal.over[c] > 0.0 else 0.0
    return sum_of_magnitudes(normal.N[j], rows)


@compiled_for(begin, Following, Kept, inlined=True)
def _begin_with_friction(problem, space):
    for i in range(space.predicted.size):
        space.predicted[i] = problem.contact.w[i] * space.force[i]


@compiled_inside
def _stalls(normal, largest):
    """Whether the residual has not halved for some iterations."""
    watch = normal.watch
    if largest <= 0.5 * watch[0]:
        watch[0], watch[1] = largest, 0.0
    watch[1] += 1.0
    return watch[1] > SETTINGS.patience or largest == inf


@compiled_inside
def _changes(contact, sigma, slopes, change):
    """Derivatives of friction by its limit, (rows,).

    A spring whose slider does not move has the same force under any limit; else the slider's slip
    changes too.
    """
    m = contact.beta.size
    for f in range(m):
        follows = 1.0 if contact.w[f] > 0.0 else 0.0
        if contact.soft.size > 0:
            follows *= 1.0 - contact.soft[f] * slopes[f]
        change[f] = follows * sigma[f]
        if m + f < change.size:
            change[m + f] = follows * sigma[m + f]


@compiled_inside
def _list_pressures(normal, m, anew):
    """List pressure points whose tangent changed; returns their number.

    All if it is made ``anew``, else those that closed, opened, or press points whose friction
    changes by its limit in another way.
    """
    change, held, count = normal.change, normal.held_change, 0
    for c in range(normal.p.size):
        pressed = 1.0 if normal.over[c] > 0.0 else 0.0
        listed = pressed != normal.pressed[c]
        if pressed > 0.0 and not listed:
            for e in range(normal.point_start[c], normal.point_start[c + 1]):
                f = normal.point[e]
                listed |= abs(change[f] - held[f]) > SETTINGS.turn
                if m + f < change.size:
                    listed |= abs(change[m + f] - held[m + f]) > SETTINGS.turn
        normal.pressed[c] = pressed
        normal.listed[count] = c
        count += listed
    for i in range(change.size):
        if anew or abs(change[i] - held[i]) > SETTINGS.turn:
            held[i] = change[i]
    return count


@compiled_inside
def _differences(normal, contact, count, coupled):
    """Changes of the held tangents of listed pressure points, and their approaches, in X and Y."""
    B, N, X, Y, listed = contact.B, normal.N, normal.X, normal.Y, normal.listed
    change, mixed = normal.change, normal.old_w
    m = contact.beta.size
    pairs = change.size - m
    for j in range(len(N)):
        held, row, own, x, y = normal.held[j], N[j], B[j], X[j], Y[j]
        if coupled:
            for f in range(m):
                mixed[f] = change[f] * own[f]
            for f in range(pairs):
                mixed[f] += change[m + f] * own[m + f]
        for i in range(count):
            c = listed[i]
            t = row[c]
            if coupled:
                for e in range(normal.point_start[c], normal.point_start[c + 1]):
                    t += normal.point_gain[e] * mixed[normal.point[e]]
            t *= normal.stiffness[c] * normal.pressed[c]
            x[i], y[i], held[c] = t - held[c], row[c], t


@compiled_inside
def _hold_pressures(problem, space, sigma, anew, coupled):
    """Bring the tangent U of the normal forces up to date; returns how many points changed."""
    contact, normal = problem.contact, problem.normal
    if coupled:
        _changes(contact, sigma, space.scaled, normal.change)
    else:
        for i in range(sigma.size):
            normal.change[i] = 0.0
    if anew:
        for j in range(len(normal.U)):
            for k in range(len(normal.U)):
                normal.U[j, k] = 0.0
            for c in range(normal.p.size):
                normal.held[j, c] = 0.0
        for c in range(normal.p.size):
            normal.pressed[c] = 0.0
    count = _list_pressures(normal, contact.beta.size, anew)
    _differences(normal, contact, count, coupled)
    return count


@compiled_for(factor, Following, inlined=True)
def _factor_following(problem, space, sigma, anew):
    normal, H, A, S = problem.normal, problem.H, space.A, space.S
    count = _hold_pressures(problem, space, sigma, anew, True)
    add_product(normal.X, normal.Y, count, normal.U)
    for j in range(len(A)):
        for k in range(len(A)):
            A[j, k] = H[j, k] + S[min(j, k), max(j, k)] + normal.U[j, k]
    return lu(A, normal.order)


@compiled_for(factor, Kept, inlined=True)
def _factor_kept(problem, space, sigma, anew):
    normal, H, A, S = problem.normal, problem.H, space.A, space.S
    count = _hold_pressures(problem, space, sigma, anew, False)
    add_symmetric_product(normal.X, normal.Y, count, normal.U)
    for j in range(len(A)):
        for k in range(j, len(A)):
            A[j, k] = H[j, k] + S[j, k] + normal.U[j, k]
    return cholesky(A)


@compiled_for(solve, Following, inlined=True)
def _solve_following(problem, space, r):
    solve_lu(space.A, problem.normal.order, r, problem.normal.pushed)


@compiled_for(solve, Kept, inlined=True)
def _solve_kept(problem, space, r):
    solve_factorised(space.A, r)


@compiled_for(advance, Following, inlined=True)
def _advance_following(problem, space, right, largest, linear, quadratic):
    contact, normal = problem.contact, problem.normal
    q, direction, tried, left = space.velocity, space.r, normal.tried, normal.left
    slip, trial, d_slip = space.slip, problem.normal.slip, space.d_slip
    w, sigma, predicted, over = contact.w, space.force, space.predicted, normal.over
    _predict(contact, sigma, d_slip, space)
    combine_rows(normal.N, direction, normal.d_over)
    for i in range(w.size):
        normal.old_w[i], normal.old_sigma[i] = w[i], sigma[i]
    for c in range(over.size):
        normal.rows[c] = over[c]
    length, trials = 1.0, 0
    while trials < SETTINGS.shortened:
        trials += 1
        for i in range(q.size):
            tried[i] = q[i] + length * direction[i]
        for i in range(slip.size):
            trial[i] = slip[i] + length * d_slip[i]
        for c in range(over.size):
            over[c] = normal.rows[c] + length * normal.d_over[c]
        _press(normal)
        _follow(contact, normal)
        _evaluate(contact, trial, space.size, space.ratio, sigma)
        normal.watch[2] = _add_forces(problem, space, right, tried, left)
        if _largest(left)[0] <= SETTINGS.grows * largest:
            break
        length *= SETTINGS.shorter
    else:
        return 0.0, trials, False
    for i in range(w.size):
        slip[i] = trial[i]
        before = normal.old_w[i] * normal.old_sigma[i]
        predicted[i] = w[i] * normal.old_sigma[i] + length * (predicted[i] - before)
    _limit(contact, predicted)
    return length, trials, True


@compiled_for(recall, Following, inlined=True)
def _recall(problem, r):
    for j in range(r.size):
        r[j] = problem.normal.left[j]
    return problem.normal.watch[2]


class _PressedLine(NamedTuple):
    """The same beside pressure points."""

    contact: Any
    space: Any
    normal: Any


@compiled_for(friction_slope, _PressedLine)
def _slope_beside_pressures(line, length):
    contact, space, normal = line
    slope = _friction_slope_along(contact, space, length)
    over, d_over, rows = normal.over, normal.d_over, normal.rows
    for c in range(over.size):
        rows[c] = normal.stiffness[c] * max(over[c] + length * d_over[c], 0.0)
    return slope + sum_of_products(rows, d_over)


@compiled_for(advance, Kept, inlined=True)
def _advance_kept(problem, space, right, largest, linear, quadratic):
    contact, normal = problem.contact, problem.normal
    combine_rows(normal.N, space.r, normal.d_over)
    slope_0 = linear + sum_of_triple_products(contact.w, space.force, space.d_slip)
    slope_0 += sum_of_products(normal.p, normal.d_over)
    _predict(contact, space.force, space.d_slip, space)
    _limit(contact, space.predicted)
    line = _PressedLine(contact, space, normal)
    length, trials, known = line_search(line, slope_0, linear, quadratic)
    if known:
        for i in range(space.slip.size):
            space.slip[i] = space.trial[i]
        for c in range(normal.over.size):
            normal.over[c] += length * normal.d_over[c]
        _press(normal)
    return length, trials, known


@compiled_for(stalls, Following, inlined=True)
def _following_stalls(problem, largest):
    return _stalls(problem.normal, largest)


@compiled_for(stalls, Kept, inlined=True)
def _enough_or_at_rest(problem, largest):
    return largest <= problem.normal.watch[2] or largest == inf


# The iteration


@inlined
def _add_forces(problem, space, right, q, r):
    """Residual of the forces at q in ``r``; returns the largest normal force on an unknown."""
    for i in range(q.size):
        r[i] = sum_of_products(problem.H[i], q) - right[i]
    for i in range(space.force.size):
        space.trial[i] = problem.contact.w[i] * space.force[i]
    add_row_products(problem.contact.B, space.trial, r)
    return add_pressures(problem, r)


@inlined
def _largest(r):
    """Largest magnitude, where it is, and once not a number it stays so."""
    largest, unknown = 0.0, 0
    for i in range(r.size):
        if not abs(r[i]) <= largest and largest == largest:
            largest, unknown = abs(r[i]), i
    return largest, unknown


@inlined
def _minimise_from(problem, space, right, v, tolerance):
    """Minimise the step's objective, from the velocity extrapolated over the last two steps.

    The minimiser is left in ``space.velocity``, its slips in ``space.slip`` and its forces in
    ``space.force``, with an entry for each slip row.
    """
    H, contact = problem.H, problem.contact
    q, before, slip, sigma = space.velocity, space.old_velocity, space.slip, space.force
    r, d_slip = space.r, space.d_slip
    n, scale = q.size, largest_of(right)
    if contact.soft.size > 0:
        scale = max(scale, _force_at_rest(contact, space))
    for i in range(n):
        q[i] = 2.0 * v[i] - before[i]
    evaluations, iteration, tangents, unknown, converged = 0, 0, 0, 0, False
    largest = 0.0
    known = False  # whether slip and sigma belong to q
    for iteration in range(SETTINGS.iterations + 1):
        evaluations += not known
        last = largest
        if not known:
            press(problem, q)
            _slip_of_points(contact, space, q, slip)
            _evaluate(contact, slip, space.size, space.ratio, sigma)
        pressures = recall(problem, r) if known else -1.0
        if pressures < 0.0:
            pressures = _add_forces(problem, space, right, q, r)
        largest, unknown = _largest(r)
        least = max(scale, pressures)
        converged = largest < inf and (
            largest <= tolerance * least
            or (largest <= 1e-6 * least and largest <= _round_off(problem, q, slip, sigma, space))
        )
        if converged or not largest < inf or iteration == SETTINGS.iterations:
            break
        if iteration == 0:
            begin(problem, space)
        if stalls(problem, largest):
            break
        if iteration == 0 or not largest < SETTINGS.reuse * last:  # else reuse the last factor
            tangents += 1
            if not (
                _factorised(problem, slip, sigma, iteration == 0, space)
                or _factorised(problem, slip, sigma, True, space)
            ):
                break
        solve(problem, space, r)
        linear, quadratic, direction = 0.0, 0.0, r
        for i in range(n):
            direction[i] = -r[i]
        for i in range(n):
            t = sum_of_products(H[i], direction)
            linear += t * q[i] - right[i] * direction[i]
            quadratic += t * direction[i]
        combine_rows(contact.B, direction, d_slip)
        length, trials, known = advance(problem, space, right, largest, linear, quadratic)
        evaluations += trials
        for i in range(n):
            q[i] += length * direction[i]
        if length == 0.0 and stalls(problem, inf):
            break
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


@compiled_for(minimise_step, Dense)
def _minimise_dense(problem, workspace, right, v, tolerance):
    return _minimise_from(problem, workspace, right, v, tolerance)


@compiled_for(slips, Dense)
def _slips_of_dense(problem, x, out):
    combine_rows(problem.contact.B, x, out)
    return out


@compiled_for(minimise_step, Following)
def _minimise_following(problem, workspace, right, v, tolerance):
    return _minimise_from(problem, workspace, right, v, tolerance)


@compiled_for(minimise_step, Kept)
def _minimise_kept(problem, workspace, right, v, tolerance):
    return _minimise_from(problem, workspace, right, v, tolerance)


@compiled
def _minimise(problem, workspace, right, v, tolerance):
    return minimise_step(problem, workspace, right, v, tolerance)


@compiled
def _keep_limits(contact, normal, limits):
    """Give all points friction limits (m,), N."""
    for f in range(limits.size):
        _set_limit(contact, normal, f, limits[f])


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
        if points.normal is not None:
            if np.isinf(points.normal.stiffness).any():
                raise InputError(
                    "contact that opens: found a rigid pressure point in a reduced or dense model, "
                    "whose unknowns are no slips and approaches, must have a finite stiffness at "
                    "each of them; sj.reduce gives it one"
                )
            self._follows = np.diff(sparse.csr_array(points.normal.gain).indptr) > 0
            self._sprung = points.has_spring
            self.normal = pressure_rows(points, self.places)
            q = self.normal.bound.size
            self._presses = np.repeat(np.arange(q), np.diff(self.normal.point_start))
            self._gains = self.normal.gain.copy(), self.normal.point_gain.copy()
            self.following = Following(self.H, self.contact, self.normal)
            self.kept = Kept(self.H, self.contact, self.normal)
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
        if pressed is not None:
            law = self.points.beta if beta is None else np.asarray(beta, dtype=float)
            return self._with_pressures(g, start, tolerance, law, offset, pressed)
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

    def _minimise(
        self, g: FloatArray, start: FloatArray, tolerance: float, kernel: Any = None
    ) -> StepOutcome:
        v = np.array(start)
        self.workspace.old_velocity[:] = v  # the start is not extrapolated
        outcome: StepOutcome = _minimise(
            self.kernel if kernel is None else kernel,
            self.workspace,
            np.ascontiguousarray(g),
            v,
            tolerance,
        )
        return outcome

    def _with_pressures(
        self,
        g: FloatArray,
        start: FloatArray | None,
        tolerance: float,
        law: FloatArray,
        offset: FloatArray | None,
        pressed: Pressed,
    ) -> Minimum:
        """Minimise with contact that opens."""
        normal, places, space = self.normal, self.places, self.workspace
        rubs = (pressed.given > 0.0) | self._follows
        if np.isinf(law[rubs & ~self._sprung]).any():
            raise InputError(
                "contact that opens: set-valued Coulomb friction (beta = inf) needs one unknown "
                "for each slip, which a reduced model has not; use System.no_steeper"
            )
        law = np.where(rubs, law, 0.0)
        space.offset[places.row] = 0.0 if offset is None else offset
        normal.bound[:] = pressed.bound
        normal.given[places.point], normal.steep[places.point] = pressed.given, law
        self.contact.beta[places.point] = law
        factors = np.full(normal.bound.size, pressed.gain)
        normal.gain[:] = self._gains[0] * factors[normal.column]
        normal.point_gain[:] = self._gains[1] * factors[self._presses]
        if self.contact.soft.size:  # a force of springs to compare with
            _keep_limits(self.contact, normal, self.points.w[np.argsort(places.point)])
        work: Counter[str] = Counter()
        outcome = self._follow(g, np.zeros(g.size) if start is None else start, tolerance, work)
        if not outcome.converged and np.isfinite(outcome.residual):
            outcome = self._renew(g, tolerance, outcome.residual, work)
        return Minimum(
            space.velocity.copy(),
            space.force[places.row],
            bool(outcome.converged),
            dict(work),
            float(outcome.residual),
            int(outcome.unknown),
            normal.p.copy(),
            self.contact.w[places.point],
        )

    def _follow(
        self,
        g: FloatArray,
        start: FloatArray,
        tolerance: float,
        work: Counter[str],
        patience: int | None = None,
    ) -> StepOutcome:
        """Iterate with limits that follow the normal forces, see `_stalls`.

        A ``patience`` of 0 finds out what the start is worth.
        """
        left = SETTINGS.patience if patience is None else patience
        self.normal.watch[:] = np.inf if left else 0.0, SETTINGS.patience - left, 0.0
        return self._counted(self.following, g, start, tolerance, work)

    def _renew(
        self, g: FloatArray, tolerance: float, mark: float, work: Counter[str]
    ) -> StepOutcome:
        """Solve for limits that are kept, and renew these, until they are those of their forces."""
        contact, normal, space = self.contact, self.normal, self.workspace
        m = normal.given.size
        renewal, v, residual = Renewal(), space.velocity.copy(), mark
        outcome = self._follow(g, v, tolerance, work, 0)
        limits = contact.w[:m].copy()
        for _ in range(SETTINGS.renewals):
            if outcome.converged or not np.isfinite(outcome.residual):
                break
            _keep_limits(contact, normal, limits)
            normal.watch[2] = SETTINGS.inner * residual
            self._counted(self.kept, g, v, tolerance, work)
            work["renewed_limits"] += 1
            v = space.velocity.copy()
            outcome = self._follow(g, v, tolerance, work, 0)
            residual, image = outcome.residual, contact.w[:m].copy()
            if not outcome.converged and residual <= SETTINGS.again * mark:
                outcome, mark = self._follow(g, v, tolerance, work), residual
            limits = renewal.next(limits, image)
        return outcome

    def _counted(
        self, kernel: Any, g: FloatArray, start: FloatArray, tolerance: float, work: Counter[str]
    ) -> StepOutcome:
        """Minimise and count."""
        outcome = self._minimise(g, start, tolerance, kernel)
        for name in ("newton_iterations", "friction_evaluations"):
            work[name] += int(getattr(outcome, name))
        work["factorizations"] += int(outcome.newton_iterations)
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
