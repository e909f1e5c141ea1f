"""The one loop over steps, compiled: predictor, problem of a step, works, peaks and stored rows."""

# numba infers the types of compiled functions:
# mypy: allow-untyped-defs, allow-untyped-calls, allow-untyped-decorators, no-check-untyped-defs

from __future__ import annotations

from math import hypot
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from skfem_joint.arrays import FloatArray
from skfem_joint.friction import AT_LIMIT
from skfem_joint.stepping.compiled import compiled, compiled_for, sums_in_any_order
from skfem_joint.stepping.recording import Compressed

#: Numbers in a line of the cache.
LINE = 8


class Bands(NamedTuple):
    """Diagonal and off-diagonal of a symmetric tridiagonal matrix."""

    diagonal: FloatArray
    off: FloatArray


class Full(NamedTuple):
    """A dense matrix."""

    entries: FloatArray


class Places(NamedTuple):
    """Where a system's slip rows and contact points are among those of a compiled problem.

    A problem has the first rows of all points before the second rows of those that have one, which
    come first among the points.
    """

    row: NDArray[np.intp]
    point: NDArray[np.intp]


class Room(NamedTuple):
    """Arrays that the loop over steps works in: by unknown, slip row, and at last by point."""

    right: FloatArray
    image: FloatArray
    y: FloatArray
    change: FloatArray
    drift: FloatArray
    slip_change: FloatArray
    slip_now: FloatArray
    rubbed: FloatArray
    farthest: FloatArray


def aligned(*sizes: int) -> list[FloatArray]:
    """Arrays of zeros that begin where a line of the cache does: most others cost a fifth more."""
    room = np.zeros(sum(sizes) + LINE * (2 * len(sizes) + 1))
    arrays, at = [], -(room.ctypes.data // room.itemsize) % LINE
    for size in sizes:
        arrays.append(room[at : at + size])
        at += LINE * (size // LINE + 2)
    return arrays


def make_room(n: int, rows: int, m: int) -> Room:
    """Make the arrays for ``n`` unknowns, some slip rows and ``m`` points."""
    return Room(*aligned(n, n, n, n, n, rows, rows, m, m))


class Found(NamedTuple):
    """What came of a step's problem: work done, and the largest residual (N) and its unknown.

    The names of the counts are those of :class:`skfem_joint.stepping.recording.Counters`.
    """

    converged: bool
    newton_iterations: int
    nested_solves: int
    descents: int
    line_searches: int
    friction_evaluations: int
    residual: float
    unknown: int


def product(A, x, y):
    """Compute y = A x, for `Bands` and `Full`."""
    raise NotImplementedError


def solve(problem, memory, right, v, tolerance):
    """Solve a step's problem for the velocity at its end; returns `Found`.

    Each kind of problem has its own. It leaves velocity and friction in ``memory.velocity`` and
    ``memory.force``, and changes what else it remembers only if it converged.
    """
    raise NotImplementedError


def slips(problem, x, room):
    """Slip of all rows of a problem from displacements ``x``: in ``room``, or ``x`` itself."""
    raise NotImplementedError


@compiled_for(product, Bands)
def _product_of_bands(A, x, y):
    diagonal, off = A
    for i in range(x.size):
        y[i] = diagonal[i] * x[i]
    for i in range(off.size):
        y[i] += off[i] * x[i + 1]
    for i in range(off.size):
        y[i + 1] += off[i] * x[i]


@compiled_for(product, Full)
def _product_of_full(A, x, y):
    for i in range(x.size):
        t = 0.0
        for j in range(x.size):
            t += A.entries[i, j] * x[j]
        y[i] = t


def subtract_column(A, i, step, r):
    """Subtract ``step`` times column i of a symmetric A, an array or compressed rows, from r."""
    raise NotImplementedError


@compiled_for(subtract_column, Compressed)
def _subtract_of_compressed(A, i, step, r):
    for e in range(A.start[i], A.start[i + 1]):
        r[A.column[e]] -= A.value[e] * step


@compiled_for(subtract_column, Full)
def _subtract_of_full(A, i, step, r):
    row = A.entries[i]
    for k in range(r.size):
        r[k] -= row[k] * step


@compiled
def subtract_product(A, v, r):
    """Subtract A v from r, to which points at rest add nothing."""
    for i in range(v.size):
        if v[i] != 0.0:
            subtract_column(A, i, v[i], r)


@sums_in_any_order
def row_times(A, k, x):
    """Row ``k`` of compressed rows times a vector."""
    total = 0.0
    for e in range(A.start[k], A.start[k + 1]):
        total += A.value[e] * x[A.column[e]]
    return total


@compiled
def _end_of_step(c, matrices, v_new, state, room):
    """Go from a step's start to its end, ``state.u`` being the predictor, for the velocity there.

    Leaves the change of displacement in ``room.change``; returns what damping and the scheme
    dissipate, J.
    """
    M, C, _ = matrices
    u, v, a, d, _ = state
    change, drift, y, image = room.change, room.drift, room.y, room.image
    mean = room.right  # few arrays stay near, many do not
    n = u.size
    for i in range(n):
        change[i] = c.u_v * v[i] + c.u_a * a[i] + c.c_K * v_new[i]
        mean[i] = 0.5 * (v[i] + v_new[i])
    for i in range(n):
        u[i] += c.c_K * v_new[i]
    if not c.trapezoidal:
        for i in range(n):
            drift[i] = v[i] - v_new[i]
            y[i] = 0.5 * d[i]
    for i in range(n):
        a_new = c.a_v * (v_new[i] - v[i]) + c.a_a * a[i]
        d[i] = c.d_a * a_new + c.d_a0 * a[i] + c.d_d0 * d[i]
        a[i] = a_new
        v[i] = v_new[i]
    product(C, mean, image)
    viscous, numerical = 0.0, 0.0
    for i in range(n):
        viscous += image[i] * change[i]
    if not c.trapezoidal:
        for i in range(n):
            y[i] += 0.5 * d[i]
            drift[i] += c.h * y[i]
        product(M, y, image)
        for i in range(n):
            numerical += (change[i] - c.h * mean[i]) * image[i]
        product(M, drift, image)
        for i in range(n):
            numerical += mean[i] * image[i]
    return viscous, numerical


@compiled
def _rub(w, moved, slip, sigma_new, sigma, room):
    """Add to the friction's work and the largest slip of each point what a step did."""
    rubbed, farthest = room.rubbed, room.farthest
    m = rubbed.size
    for p in range(m):
        rubbed[p] += 0.5 * w[p] * (sigma[p] + sigma_new[p]) * moved[p]
        farthest[p] = abs(slip[p]) if abs(slip[p]) > farthest[p] else farthest[p]
        sigma[p] = sigma_new[p]
    for q in range(m, w.size):
        rubbed[q - m] += 0.5 * w[q] * (sigma[q] + sigma_new[q]) * moved[q]
        farthest[q - m] = max(farthest[q - m], hypot(slip[q - m], slip[q]))
        sigma[q] = sigma_new[q]


@compiled
def _store_joints(joints, shares, slip, sigma, rubbed, stored, row):
    """Store works of the joints, their largest slips, and shares of friction at its limit."""
    m = rubbed.size
    two = sigma.size - m
    for k in range(joints.start.size - 1):
        stored.joint_work[row, k] = row_times(joints, k, rubbed)
        if stored.joint_slip.shape[0] == 0:
            continue
        largest, slipping = 0.0, 0.0
        for e in range(joints.start[k], joints.start[k + 1]):
            p = joints.column[e]
            moved, force = abs(slip[p]), abs(sigma[p])
            if p < two:
                moved, force = hypot(moved, slip[m + p]), hypot(force, sigma[m + p])
            largest = max(largest, moved)
            slipping += shares[e] if force >= AT_LIMIT else 0.0
        stored.joint_slip[row, k], stored.joint_slipping[row, k] = largest, slipping


@compiled
def march(
    n_steps, first_step, strides, c, matrices, problem, memory, w, places, tolerance,
    loads, amplitude, observed, joints, shares, state, room, sums, stored, counts,
):  # fmt: skip
    """Advance ``n_steps`` equal steps in place and accumulate works, peaks and stored rows.

    ``strides`` are those of stored points and fields; ``matrices`` mass, damping and stiffness;
    ``problem`` and ``memory`` what `solve` takes; ``w`` (rows,) the friction limit of each slip row
    of the problem, N; ``loads``, ``observed`` and ``joints`` load vectors, named points and the
    joints' parts in the works of the problem's points, ``shares`` their parts in the friction;
    ``amplitude`` (loads, n_steps + 1) is in N; ``counts`` are those of a `CompiledStepper`.

    Returns steps, stored rows and fields, and the last residual (N) and its unknown. With fewer
    than ``n_steps`` steps one did not converge, and the state is that before it.
    """
    M, _, K = matrices
    u, v, a, d, sigma = state
    input_work, dissipated, friction_work, peak, slip_peak = sums
    right, image, y, change = room.right, room.image, room.y, room.change
    n, point, number_of_loads = u.size, places.point, loads.start.size - 1
    for j in range(point.size):
        room.rubbed[point[j]] = friction_work[j]
        room.farthest[point[j]] = slip_peak[j]
    steps, rows, field_rows, residual, unknown = 0, 0, 0, 0.0, 0
    for step in range(1, n_steps + 1):
        for i in range(n):
            u[i] += c.u_v * v[i] + c.u_a * a[i]  # predictor; completed by c_K v below
            y[i] = c.c_M * v[i] + c.y_a * a[i] + c.y_d * d[i]
        product(M, y, right)
        product(K, u, image)
        for i in range(n):
            right[i] -= image[i]
        for k in range(number_of_loads):
            subtract_column(loads, k, -amplitude[k, step], right)
        found = solve(problem, memory, right, v, tolerance)
        counts[0] += found.newton_iterations
        counts[1] += found.nested_solves
        counts[2] += found.descents
        counts[3] += found.line_searches
        counts[4] += found.friction_evaluations
        counts[5] = max(counts[5], found.newton_iterations)
        residual, unknown = found.residual, found.unknown
        if not found.converged:
            for i in range(n):
                u[i] -= c.u_v * v[i] + c.u_a * a[i]
            break
        steps = step
        viscous, numerical = _end_of_step(c, matrices, memory.velocity, state, room)
        dissipated[0] += viscous
        dissipated[1] += numerical
        for k in range(number_of_loads):
            mean = 0.5 * (amplitude[k, step - 1] + amplitude[k, step])
            input_work[k] += mean * row_times(loads, k, change)
        moved, slip = slips(problem, change, room.slip_change), slips(problem, u, room.slip_now)
        _rub(w, moved, slip, memory.force, sigma, room)
        store = stored.point_u.shape[0] > 0 and (first_step + step) % strides[0] == 0
        for k in range(observed.start.size - 1):
            x = row_times(observed, k, u)
            peak[k] = max(peak[k], abs(x))
            if store:
                stored.point_u[rows, k] = x
                stored.point_v[rows, k] = row_times(observed, k, v)
        if store:
            _store_joints(joints, shares, slip, sigma, room.rubbed, stored, rows)
        rows += store
        if stored.u.shape[0] > 0 and (first_step + step) % strides[1] == 0:
            for i in range(n):
                stored.u[field_rows, i] = u[i]
                stored.v[field_rows, i] = v[i]
            for j in range(places.row.size):
                stored.sigma[field_rows, j] = sigma[places.row[j]]
            for j in range(point.size):
                stored.friction_work_rows[field_rows, j] = room.rubbed[point[j]]
            field_rows += 1
    for j in range(point.size):
        friction_work[j] = room.rubbed[point[j]]
        slip_peak[j] = room.farthest[point[j]]
    # Not a named tuple: numba makes one by calling Python, where a pending Ctrl-C would be raised,
    # and numba does not look for that before it uses what it got.
    return steps, rows, field_rows, residual, unknown


def times(A: Any, x: FloatArray) -> FloatArray:
    """Product A x; of an array only columns of unknowns that move are looked at."""
    if not isinstance(A, np.ndarray):
        return np.asarray(A @ x)
    y = np.zeros_like(x)
    subtract_product(Full(A), -x, y)
    return y
