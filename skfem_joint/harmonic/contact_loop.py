"""The compiled loop over contact points and samples: friction by return mapping, and its tangent.

The spring k of a point is stretched by t / k. From one sample to the next the slip changes by
dx, and the law of :mod:`skfem_joint.minimise.law` gives the friction t of the slip dx + t / k that
the spring and the slider share. The loop goes over a period more than once, from springs without
force at rest, until friction repeats itself, and the last time counts. Forces are those beyond a
spring that never slips, which has a place in the linear stiffness: a point that sticks all the time
has none, and no tangent.
"""

# numba infers the types of compiled functions:
# mypy: allow-untyped-defs, allow-untyped-calls, allow-untyped-decorators

from __future__ import annotations

from math import hypot, sqrt
from typing import Any, NamedTuple

from skfem_joint.ground.arrays import FloatArray
from skfem_joint.ground.compiling import compiled, compiled_inside
from skfem_joint.minimise.law import tangent_inside

#: Change of friction from one pass to the next, relative, that ends the loop where a slip has two
#: directions or goes on, and most passes then, over those of others.
REPEATS, MOST = 1e-12, 50


class FrictionPoints(NamedTuple):
    """Contact points with friction, each of which has its own columns.

    Columns are what the friction of a point depends on: its slips, then the approaches at the
    pressure points that give to its limit. Blocks of derivatives are stored row by row of a point,
    and in each row column by column.

    Attributes
    ----------
    first_row : ndarray of int, shape (m + 1,)
        First slip row of each point.
    first_gain : ndarray of int, shape (m + 1,)
        First pressure point of each, among those of ``pressure`` and ``gain``.
    first_block : ndarray of int, shape (m + 1,)
    stiffness : ndarray, shape (m,)
        Of the springs, N/m.
    linear : ndarray, shape (m,)
        That part of it which linear contact has: all, or none where nothing presses at rest.
    pressure : ndarray of int, shape (gains,)
        Numbers of the pressure points.
    gain : ndarray, shape (gains,)
        What each gives to the limit, over its force.
    """

    first_row: Any
    first_gain: Any
    first_block: Any
    stiffness: FloatArray
    linear: FloatArray
    pressure: Any
    gain: FloatArray


@compiled_inside
def _onto_limit(now, rows, columns, nh, tangent):
    """Derivative of friction that is returned to its limit, from that before, in place."""
    first, mixed, second = tangent
    for c in range(columns):
        one, other = now[0, c], now[1, c]
        for j in range(nh):
            along, across = one[j], other[j] if rows == 2 else 0.0
            one[j] = first * along + mixed * across
            other[j] = mixed * along + second * across


@compiled
def friction(
    points,
    slip,
    limits,
    slopes,
    walked,
    basis,
    projection,
    odd,
    tangents,
    force,
    blocks,
    moves,
    now,
):
    """Friction beyond the springs at all samples, and blocks of its derivatives.

    Parameters
    ----------
    points : FrictionPoints
    slip : ndarray, shape (rows, samples)
    limits : ndarray, shape (m, samples)
    slopes : ndarray, shape (q, samples)
        Slope of each normal force over its approach, N/m.
    walked : ndarray, shape (rows,)
        Way that each slip goes on in a period beside, m.
    basis : ndarray, shape (samples + 1, nh)
        Of `FourierSeries`; the last row is that of the sample before the first one. It may have one
        more column, the share of the period that is over, by which ways go on, then zeros: loops
        over a multiple of eight columns are faster.
    projection : ndarray, shape (samples, nh)
        Of `FourierSeries`.
    odd : bool
        Whether the samples are half a period, and the motion has the other sign in the next half.
    tangents : bool
        Whether blocks are wanted.
    force : ndarray, shape (rows, samples)
        Result, N.
    blocks : ndarray, shape (blocks, nh of projection, nh of basis)
        Result: derivative of each coefficient of the force by each one of the column.
    moves : ndarray of bool, shape (m,)
        Result: whether each point slips; the others have no force and no blocks.
    now : ndarray, shape (2, columns, nh)
        Worked in: derivative of the friction now; as many columns as any point has.

    Returns
    -------
    float
        Largest relative change in the last pass of friction that does not repeat itself yet.
    """
    (count, kept), nh, left = projection.shape, basis.shape[1], 0.0
    # After the first period friction along one direction repeats itself. A vector of friction, and
    # slip that goes on, take more until they do.
    passes, sign = (4, -1.0) if odd else (2, 1.0)
    for i in range(limits.shape[0]):
        row, k, linear = points.first_row[i], points.stiffness[i], points.linear[i]
        pair = points.first_row[i + 1] - row == 2
        rows = 2 if pair else 1
        first_gain = points.first_gain[i]
        columns = rows + points.first_gain[i + 1] - first_gain
        first_block = points.first_block[i]
        moves[i] = linear == 0.0
        x = y = t = s = 0.0  # slips and friction along both directions
        if tangents:
            for r in range(rows):
                for c in range(columns):
                    for j in range(nh):
                        now[r, c, j] = 0.0
        repeats = not pair and walked[row] == 0.0
        turn, last, t_before, s_before = 0, False, 0.0, 0.0
        while not last:
            if turn > 0:
                if not moves[i]:
                    break
                x *= sign
                y *= sign
                t *= sign
                s *= sign
                x -= walked[row]
                y -= walked[row + 1] if pair else 0.0
                if tangents and sign != 1.0:
                    for r in range(rows):
                        for c in range(columns):
                            for j in range(nh):
                                now[r, c, j] *= sign
            change, size = hypot(t - t_before, s - s_before), hypot(t, s)
            settled = repeats or change <= REPEATS * size
            last = turn >= passes - 1 and (settled or turn >= MOST * passes - 1)
            if last and not settled and size > 0.0:
                left = max(left, change / size)
            turn, t_before, s_before = turn + 1, t, s
            if last and tangents:
                for b in range(first_block, first_block + rows * columns):
                    for a in range(kept):
                        for j in range(nh):
                            blocks[b, a, j] = 0.0
            for n in range(count):
                w, over = limits[i, n], n / count
                x_next = slip[row, n] + over * walked[row]
                t += k * (x_next - x)
                x = x_next
                if pair:
                    y_next = slip[row + 1, n] + over * walked[row + 1]
                    s += k * (y_next - y)
                    y = y_next
                square = t * t + s * s
                slides = w <= 0.0 or square > w * w  # Coulomb's law, without a root where it sticks
                if tangents:
                    # basis at the sample before: zero at rest, before the first one
                    before = n - 1 if n > 0 else count
                    factor = k if n > 0 else (0.0 if turn == 1 else k * sign)
                    for j in range(nh):
                        change = k * basis[n, j] - factor * basis[before, j]
                        now[0, 0, j] += change
                        if pair:
                            now[1, 1, j] += change
                if slides:
                    moves[i] = True
                    inverse = 1.0 / sqrt(square) if square > 0.0 else 0.0
                    across, e, f = w * inverse, t * inverse, s * inverse
                    if tangents:
                        _onto_limit(
                            now, rows, columns, nh, tangent_inside(-across, across, e, f, e, f)
                        )
                        for c in range(rows, columns):
                            g = first_gain + c - rows
                            more = points.gain[g] * slopes[points.pressure[g], n]
                            if more != 0.0:
                                for j in range(nh):
                                    now[0, c, j] += e * more * basis[n, j]
                                    if pair:
                                        now[1, c, j] += f * more * basis[n, j]
                    t, s = w * e, w * f
                if last:
                    force[row, n] = t - linear * slip[row, n]
                    if pair:
                        force[row + 1, n] = s - linear * slip[row + 1, n]
                    if tangents and not (slides and columns == 1):  # zero there
                        b = first_block
                        for r in range(rows):
                            for c in range(columns):
                                one = now[r, c]
                                for a in range(kept):
                                    p, sums = projection[n, a], blocks[b, a]
                                    for j in range(nh):
                                        sums[j] += p * one[j]
                                b += 1
        if not moves[i]:
            for r in range(row, row + rows):
                for n in range(count):
                    force[r, n] = 0.0
        elif tangents:
            for r in range(rows):
                for a in range(kept):
                    blocks[first_block + r * columns + r, a, a] -= linear
    return left


@compiled
def weighted(blocks, a, first, right, rows, sums):
    """Sums of blocks of coefficient ``a`` times the rows that they are derivatives by.

    Parameters
    ----------
    blocks : ndarray, shape (blocks, nh, wide)
    a : int
    first : ndarray of int, shape (sums + 1,)
        First block of each sum.
    right : ndarray of int, shape (blocks,)
        Row of each block.
    rows : ndarray, shape (rows, n)
    sums : ndarray, shape (sums, wide, n)
        Result.
    """
    for r in range(sums.shape[0]):
        end = first[r + 1]
        for j in range(sums.shape[1]):
            for i in range(sums.shape[2]):
                sums[r, j, i] = 0.0
        for b in range(first[r], end, 2):  # two at a time, for fewer loads and stores of sums
            one, other = rows[right[b]], rows[right[min(b + 1, end - 1)]]
            for j in range(sums.shape[1]):
                p, line = blocks[b, a, j], sums[r, j]
                q = blocks[b + 1, a, j] if b + 1 < end else 0.0
                for i in range(line.size):
                    line[i] += p * one[i] + q * other[i]
