"""Compiled loop of problems of few unknowns with contact that opens."""

# numba infers the types of compiled functions:
# mypy: allow-untyped-defs, allow-untyped-calls, allow-untyped-decorators

from __future__ import annotations

from typing import Any, NamedTuple

from skfem_joint.compiling import compiled


class Gain(NamedTuple):
    """Friction limits by normal forces: a matrix of compressed rows."""

    start: Any
    column: Any
    value: Any


class Rows(NamedTuple):
    """Slip rows B of few unknowns and approaches N of pressure points with a stiffness.

    Each slip row has a point, and the other row of that, which is itself where there is none.
    """

    B: Any
    point: Any
    other: Any
    N: Any
    stiffness: Any


@compiled
def rows_of_tangent(model, gain, own, beside, sigma, w, over, left, right):
    """Enter rows L and R of L^T R, which friction and normal contact add to a stiffness.

    Of each slip row with friction, ``own`` (rows,) times its slip, ``beside`` (rows,) times the
    slip of the other row of its point, and where ``gain`` has entries the change of the point's
    limit in the direction ``sigma`` (rows,) of its friction; of each pressure point that is
    ``over`` its bound, its stiffness. Returns how many rows there are.
    """
    B, N, count = model.B, model.N, 0
    n = B.shape[1]
    for r in range(B.shape[0]):
        f = model.point[r]
        if w[f] <= 0.0:
            continue
        other = model.other[r]
        for k in range(n):
            left[count, k] = B[r, k]
            right[count, k] = own[r] * B[r, k] + beside[r] * B[other, k]
        for e in range(gain.start[f], gain.start[f + 1]):
            c = gain.column[e]
            if over[c] > 0.0:
                change = sigma[r] * gain.value[e] * model.stiffness[c]
                for k in range(n):
                    right[count, k] += change * N[c, k]
        count += 1
    for c in range(N.shape[0]):
        if over[c] > 0.0:
            for k in range(n):
                left[count, k] = N[c, k]
                right[count, k] = model.stiffness[c] * N[c, k]
            count += 1
    return count
