"""The iteration of the primal-dual Newton method, and what it does where limits are constant.

The method is that of :mod:`skfem_joint.minimise.primal_dual_newton`. `Dense` problems have constant
friction limits, or pressure points (:mod:`skfem_joint.minimise.dense_pressures`) and limits that
follow their forces, or that are kept for a while. Functions in which these differ take ``normal``
or ``follows`` as arguments: compilation leaves out what is for others.
"""

# numba infers the types of compiled functions:
# mypy: allow-untyped-defs, allow-untyped-calls, allow-untyped-decorators, no-check-untyped-defs

from __future__ import annotations

from math import copysign, inf, sqrt
from typing import Any, NamedTuple

import numpy as np

from skfem_joint.ground.arrays import as_dense
from skfem_joint.ground.compiling import compiled, compiled_for, compiled_inside, inlined
from skfem_joint.linalg.kernels import (
    add_product,
    add_row_products,
    aligned,
    cholesky,
    combine_rows,
    largest_entry,
    largest_of,
    lu,
    solve_factorised,
    solve_lu,
    sum_of_magnitudes,
    sum_of_products,
    sum_of_triple_products,
)
from skfem_joint.minimise.dense_pressures import (
    PressureRows,
    add_pressures,
    follow,
    magnitude_of_pressures,
    press,
    press_beyond,
    renew_tangent_of_pressures,
    slope_of_pressures,
    stalls,
    watch_anew,
)
from skfem_joint.minimise.law import forces, slope_of, sprung_force, sprung_slope, tangent_inside
from skfem_joint.minimise.line_search import friction_slope, line_search
from skfem_joint.minimise.problem import (
    ROUND_OFF,
    ContactPoints,
    Places,
    StepOutcome,
    minimise_step,
    row_order,
    slips,
)

# Most iterations.
_ITERATIONS = 200
# Relative change of a point's tangent up to which the earlier one stays.
_CHANGE = 0.02


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
    """Problem of a step.

    What is not there is None, which compiled code is made without.

    Attributes
    ----------
    H : ndarray, shape (n, n)
        Matrix, N s/m.
    contact : DenseRows
    normal : PressureRows or None
        Where elastic contact opens.
    follows : bool or None
        True where friction limits follow the forces of the pressure points in each evaluation; None
        where they are constant, or kept, so that the problem is convex.
    """

    H: Any
    contact: DenseRows
    normal: PressureRows | None = None
    follows: Any = None


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
def evaluate(contact, slip, size, ratio, sigma):
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
    evaluate(contact, space.trial, space.size, space.ratio, space.force)
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
        weight[p], cross[p], weight_2[p] = tangent_inside(
            share, across, first[p], second[p], force_1[p], force_2[p]
        )
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
        count += max(change, abs(cross[p] - held_cross[p])) > _CHANGE * least
    doubled = count
    for p in range(pairs, m):
        changed[count] = p
        count += abs(weight[p] - held[p]) > _CHANGE * min(weight[p], held[p])
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
    add_product(X, B, weight.size, S, True)


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
    add_product(X, Y, count + doubled, space.S, True)


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
    # If more rows have changed, to add up all anew is cheaper.
    if anew or count + doubled > 0.6 * rows:
        _add_all(contact, space)
    elif count > 0:
        _add_changed(contact, count, doubled, space)
    return _factor(problem, problem.normal, problem.follows, space, sigma, anew)


@compiled_inside
def _limit_forces(contact, predicted):
    """Scale the forces (rows,), N, of each point down to its friction limit."""
    w = contact.w
    m = contact.beta.size
    pairs = w.size - m
    first, second = predicted[:pairs], predicted[m:]
    for p in range(pairs):
        size = sqrt(first[p] * first[p] + second[p] * second[p])
        share = w[p] / max(size, w[p], 1e-300)
        first[p] *= share
        second[p] *= share
    for p in range(pairs, m):
        predicted[p] = min(max(predicted[p], -w[p]), w[p])


@compiled_inside
def _predict_friction(contact, sigma, d_slip, space):
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
        largest = max(largest, total + magnitude_of_pressures(problem.normal, q, j))
    return ROUND_OFF * largest


class _Line(NamedTuple):
    """Line through the slips of all rows, for the search along it."""

    contact: Any
    normal: Any
    space: Any


@compiled_for(friction_slope, _Line)
def _slope_along(line, length):
    """Derivative of the potentials of contact along a direction, W.

    Slips and forces stay in the workspace.
    """
    contact, normal, space = line
    slip, d_slip, trial = space.slip, space.d_slip, space.trial
    for i in range(slip.size):
        trial[i] = slip[i] + length * d_slip[i]
    evaluate(contact, trial, space.size, space.ratio, space.force)
    slope = sum_of_triple_products(contact.w, space.force, d_slip)
    return slope + slope_of_pressures(normal, length)


@inlined
def _advance_convex(contact, normal, space, linear, quadratic):
    """`_advance` where limits are constant or kept: by the exact line search."""
    slope_0 = linear + sum_of_triple_products(contact.w, space.force, space.d_slip)
    if normal is not None:
        combine_rows(normal.N, space.r, normal.d_over)
        slope_0 += sum_of_products(normal.p, normal.d_over)
    _predict_friction(contact, space.force, space.d_slip, space)
    _limit_forces(contact, space.predicted)
    line = _Line(contact, normal, space)
    length, trials, known = line_search(line, slope_0, linear, quadratic)
    if known:
        for i in range(space.slip.size):
            space.slip[i] = space.trial[i]
        if normal is not None:
            for c in range(normal.over.size):
                normal.over[c] += length * normal.d_over[c]
            press_beyond(normal)
    return length, trials, known


@inlined
def _advance_following(problem, space, right, largest):
    """`_advance` where limits follow normal forces: the residual may not grow much."""
    contact, normal = problem.contact, problem.normal
    q, direction, tried, left = space.velocity, space.r, normal.tried, normal.left
    slip, trial, d_slip = space.slip, normal.slip, space.d_slip
    w, sigma, predicted, over = contact.w, space.force, space.predicted, normal.over
    _predict_friction(contact, sigma, d_slip, space)
    combine_rows(normal.N, direction, normal.d_over)
    for i in range(w.size):
        normal.old_w[i], normal.old_sigma[i] = w[i], sigma[i]
    for c in range(over.size):
        normal.rows[c] = over[c]
    length, trials = 1.0, 0
    while trials < 8:
        trials += 1
        for i in range(q.size):
            tried[i] = q[i] + length * direction[i]
        for i in range(slip.size):
            trial[i] = slip[i] + length * d_slip[i]
        for c in range(over.size):
            over[c] = normal.rows[c] + length * normal.d_over[c]
        press_beyond(normal)
        follow(contact, normal)
        evaluate(contact, trial, space.size, space.ratio, sigma)
        normal.watch[2] = _add_forces(problem, space, right, tried, left)
        # Residuals of few unknowns grow on the way: where each had to fall, steps of 67 unknowns
        # took 16.4 iterations in place of 12.9.
        if largest_entry(left)[0] <= 4.0 * largest:
            break
        length *= 0.4
    else:
        return 0.0, trials, False
    for i in range(w.size):
        slip[i] = trial[i]
        before = normal.old_w[i] * normal.old_sigma[i]
        predicted[i] = w[i] * normal.old_sigma[i] + length * (predicted[i] - before)
    _limit_forces(contact, predicted)
    return length, trials, True


@inlined
def _advance(problem, follows, space, right, largest, linear, quadratic):
    """Step length along ``space.r``, where slips move by ``space.d_slip``; see `line_search`."""
    if follows is None:
        return _advance_convex(problem.contact, problem.normal, space, linear, quadratic)
    return _advance_following(problem, space, right, largest)


@inlined
def _recall(normal, follows, r):
    """Take the residual found at the end of a step; returns as `add_pressures`, -1 if unknown."""
    if follows is None:
        return -1.0
    for j in range(r.size):
        r[j] = normal.left[j]
    return normal.watch[2]


@inlined
def _begin(contact, normal, space):
    """Prepare for iterations, after the residual of the start: pressure forgets predictions."""
    if normal is not None:
        for i in range(space.predicted.size):
            space.predicted[i] = contact.w[i] * space.force[i]


@inlined
def _factor(problem, normal, follows, space, sigma, anew):
    """Factor in A of H, the tangent S of friction and that of normal forces; False if none.

    It is symmetric unless limits follow.
    """
    H, A, S, n = problem.H, space.A, space.S, len(space.A)
    renew_tangent_of_pressures(problem.contact, normal, follows, space, sigma, anew)
    if follows is not None:
        for j in range(n):
            for k in range(n):
                A[j, k] = H[j, k] + S[min(j, k), max(j, k)] + normal.U[j, k]
        return lu(A, normal.order)
    for j in range(n):
        for k in range(j, n):
            A[j, k] = H[j, k] + S[j, k]
        if normal is not None:
            for k in range(j, n):
                A[j, k] += normal.U[j, k]
    return cholesky(A)


@inlined
def _solve(normal, follows, space, r):
    """Solve in place by the factor."""
    if follows is None:
        solve_factorised(space.A, r)
    else:
        solve_lu(space.A, normal.order, r, normal.pushed)


# The iteration


@inlined
def _add_forces(problem, space, right, q, r):
    """Residual of the forces at q in ``r``; returns the largest normal force on an unknown."""
    for i in range(q.size):
        r[i] = sum_of_products(problem.H[i], q) - right[i]
    for i in range(space.force.size):
        space.trial[i] = problem.contact.w[i] * space.force[i]
    add_row_products(problem.contact.B, space.trial, r)
    return add_pressures(problem.normal, r)


@compiled_for(minimise_step, Dense)
def _minimise_dense(problem, workspace, right, v, tolerance):
    """Minimise the step's objective, from the velocity extrapolated over the last two steps.

    The minimiser is left in ``velocity`` of the workspace, its slips in ``slip`` and its forces in
    ``force``, with an entry for each slip row.
    """
    space, normal, follows = workspace, problem.normal, problem.follows
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
    for iteration in range(_ITERATIONS + 1):
        evaluations += not known
        last = largest
        if not known:
            press(contact, normal, follows, q)
            _slip_of_points(contact, space, q, slip)
            evaluate(contact, slip, space.size, space.ratio, sigma)
        pressures = _recall(normal, follows, r) if known else -1.0
        if pressures < 0.0:
            pressures = _add_forces(problem, space, right, q, r)
        largest, unknown = largest_entry(r)
        least = max(scale, pressures)
        converged = largest < inf and (
            largest <= tolerance * least
            or (largest <= 1e-6 * least and largest <= _round_off(problem, q, slip, sigma, space))
        )
        if converged or not largest < inf or iteration == _ITERATIONS:
            break
        if iteration == 0:
            _begin(contact, normal, space)
        if stalls(normal, follows, largest):
            break
        if iteration == 0 or not largest < 0.1 * last:  # else reuse the last factor
            tangents += 1
            if not (
                _factorised(problem, slip, sigma, iteration == 0, space)
                or _factorised(problem, slip, sigma, True, space)
            ):
                break
        _solve(normal, follows, space, r)
        linear, quadratic, direction = 0.0, 0.0, r
        for i in range(n):
            direction[i] = -r[i]
        for i in range(n):
            t = sum_of_products(H[i], direction)
            linear += t * q[i] - right[i] * direction[i]
            quadratic += t * direction[i]
        combine_rows(contact.B, direction, d_slip)
        length, trials, known = _advance(problem, follows, space, right, largest, linear, quadratic)
        evaluations += trials
        for i in range(n):
            q[i] += length * direction[i]
        if length == 0.0 and stalls(normal, follows, inf):
            break
    if converged:
        for i in range(n):
            before[i] = v[i]
        for i in range(sigma.size):
            space.predicted[i] = contact.w[i] * (2.0 * sigma[i] - space.old_force[i])
            space.old_force[i] = sigma[i]
        _limit_forces(contact, space.predicted)
    else:
        for i in range(sigma.size):
            space.predicted[i] = 0.0
    watch_anew(normal, follows)
    searches = evaluations - iteration - 1
    return StepOutcome(converged, tangents, 0, 0, searches, evaluations, largest, unknown)


@compiled_for(slips, Dense)
def _slips_of_dense(problem, x, out):
    combine_rows(problem.contact.B, x, out)
    return out


@compiled
def minimise_dense(problem, workspace, right, v, tolerance):
    """`minimise_step`, for Python."""
    return minimise_step(problem, workspace, right, v, tolerance)
