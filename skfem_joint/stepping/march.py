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
from skfem_joint.stepping.compiled import compiled, compiled_for, weighted
from skfem_joint.linalg.compressed import CompressedRows

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


@compiled
def _joint_slips(joints, slip, sigma, m, largest, slipping):
    """Largest slip of each joint, and the share of its friction that is at its limit."""
    start, column, _, share = joints
    two = slip.size - m
    for k in range(start.size - 1):
        largest[k], slipping[k] = 0.0, 0.0
        for e in range(start[k], start[k + 1]):
            p = column[e]
            moved, force = abs(slip[p]), abs(sigma[p])
            if p < two:
                moved, force = hypot(moved, slip[m + p]), hypot(force, sigma[m + p])
            largest[k] = max(largest[k], moved)
            slipping[k] += share[e] if force >= AT_LIMIT else 0.0


@compiled
def march(
    n_steps, first_step, strides, c, matrices, problem, memory, w, places, tolerance,
    loads, amplitude, observed, joints, state, room, sums, stored, counts,
):  # fmt: skip
    """Advance ``n_steps`` equal steps in place and accumulate works, peaks and stored rows.

    ``strides`` are those of stored points and fields; ``matrices`` mass, damping and stiffness;
    ``problem`` and ``memory`` what `solve` takes; ``w`` (rows,) the friction limit of each slip row
    of the problem, N; ``loads``, ``observed`` and ``joints`` load vectors, named points
    (`CompressedRows`) and the joints' parts in the problem's points, in work and in friction;
    ``amplitude`` (loads, n_steps + 1) is in N; ``counts`` are those of a `CompiledStepper`.

    Returns steps, stored rows and fields, and the last residual (N) and its unknown. With fewer
    than ``n_steps`` steps one did not converge, and the state is that before it.
    """
    M, C, K = matrices
    u, v, a, d, sigma = state
    row_place, point_place = places
    load_start, load_column, load_value = loads
    seen_start, seen_column, seen_value = observed
    input_work, dissipated, friction_work, peak, slip_peak = sums
    joint_start, joint_column, joint_value, _ = joints
    stored_u, stored_v, stored_sigma, worked, stored_point_u, stored_point_v = stored[:6]
    by_joint, joint_slip, joint_slipping = stored[6:]
    right, image, y, change, drift, slip_change, slip_now, rubbed, farthest = room
    v_new, sigma_new = memory.velocity, memory.force
    n, m = u.size, rubbed.size
    for j in range(point_place.size):
        rubbed[point_place[j]] = friction_work[j]
        farthest[point_place[j]] = slip_peak[j]
    steps, rows, field_rows, residual, unknown = 0, 0, 0, 0.0, 0
    for step in range(1, n_steps + 1):
        for i in range(n):
            u[i] += c.u_v * v[i] + c.u_a * a[i]  # predictor; completed by c_K v below
            y[i] = c.c_M * v[i] + c.y_a * a[i] + c.y_d * d[i]
        product(M, y, right)
        product(K, u, image)
        for i in range(n):
            right[i] -= image[i]
        for k in range(load_start.size - 1):
            for e in range(load_start[k], load_start[k + 1]):
                right[load_column[e]] += amplitude[k, step] * load_value[e]
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
        # u holds the predictor: the step's change of displacement is what it adds to u.
        mean = right  # few arrays stay near, many do not
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
        dissipated[0] += viscous
        dissipated[1] += numerical
        for k in range(load_start.size - 1):
            f = 0.5 * (amplitude[k, step - 1] + amplitude[k, step])
            for e in range(load_start[k], load_start[k + 1]):
                input_work[k] += f * load_value[e] * change[load_column[e]]
        moved, slip = slips(problem, change, slip_change), slips(problem, u, slip_now)
        for p in range(m):
            rubbed[p] += 0.5 * w[p] * (sigma[p] + sigma_new[p]) * moved[p]
            farthest[p] = abs(slip[p]) if abs(slip[p]) > farthest[p] else farthest[p]
            sigma[p] = sigma_new[p]
        for q in range(m, w.size):
            rubbed[q - m] += 0.5 * w[q] * (sigma[q] + sigma_new[q]) * moved[q]
            farthest[q - m] = max(farthest[q - m], hypot(slip[q - m], slip[q]))
            sigma[q] = sigma_new[q]
        store = stored_point_u.shape[0] > 0 and (first_step + step) % strides[0] == 0
        for k in range(seen_start.size - 1):
            x, rate = 0.0, 0.0
            for e in range(seen_start[k], seen_start[k + 1]):
                x += seen_value[e] * u[seen_column[e]]
                rate += seen_value[e] * v[seen_column[e]]
            peak[k] = max(peak[k], abs(x))
            if store:
                stored_point_u[rows, k] = x
                stored_point_v[rows, k] = rate
        for k in range(joint_start.size - 1 if store else 0):
            part = slice(joint_start[k], joint_start[k + 1])
            by_joint[rows, k] = weighted(joint_value[part], joint_column[part], rubbed)
        if store and joint_slip.shape[0] > 0:
            _joint_slips(joints, slip[: w.size], sigma, m, joint_slip[rows], joint_slipping[rows])
        rows += store
        if stored_u.shape[0] > 0 and (first_step + step) % strides[1] == 0:
            for i in range(n):
                stored_u[field_rows, i] = u[i]
                stored_v[field_rows, i] = v[i]
            for j in range(row_place.size):
                stored_sigma[field_rows, j] = sigma[row_place[j]]
            for j in range(point_place.size):
                worked[field_rows, j] = rubbed[point_place[j]]
            field_rows += 1
    for j in range(point_place.size):
        friction_work[j] = rubbed[point_place[j]]
        slip_peak[j] = farthest[point_place[j]]
    # Not a named tuple: numba makes one by calling Python, where a pending Ctrl-C would be raised,
    # and numba does not look for that before it uses what it got.
    return steps, rows, field_rows, residual, unknown


def subtract_column(A, i, step, r):
    """Subtract ``step`` times column i of a symmetric A, an array or compressed rows, from r."""
    raise NotImplementedError


@compiled_for(subtract_column, CompressedRows)
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


def times(A: Any, x: FloatArray) -> FloatArray:
    """Product A x; of an array only columns of unknowns that move are looked at."""
    if not isinstance(A, np.ndarray):
        return np.asarray(A @ x)
    y = np.zeros_like(x)
    subtract_product(Full(A), -x, y)
    return y
