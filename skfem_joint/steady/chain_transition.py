"""State transition of a chain: elimination with many right sides at a time, compiled."""

# numba infers the types of compiled functions:
# mypy: allow-untyped-defs, allow-untyped-calls, allow-untyped-decorators, no-check-untyped-defs

from __future__ import annotations

from math import inf

from skfem_joint.ground.compiling import compiled, compiled_inside


@compiled_inside
def _add(out, a, x):
    for j in range(out.size):
        out[j] += a * x[j]


@compiled
def carry_through(M, K, H, h, tangents, p, r, work, pivot):
    """Carry derivatives of the advanced state through steps, in place.

    Parameters
    ----------
    M, K, H : Bands
        Mass, stiffness and step matrix.
    h : float
        Step, s.
    tangents : ndarray, shape (steps, n)
        Tangent of friction at each unknown, N s/m; inf where it sticks.
    p, r : ndarray, shape (n, columns)
        Derivatives of both parts of the advanced state.
    work : ndarray, shape (n, columns)
        Worked in.
    pivot : ndarray, shape (n,)
        Worked in.
    """
    n, mass = len(p), 2.0 / h
    for step in range(len(tangents)):
        for i in range(n):
            out = work[i]
            out[:] = 0.0
            if tangents[step, i] == inf:
                pivot[i] = inf
                continue
            _add(out, -K.diagonal[i], p[i])
            _add(out, mass * M.diagonal[i], r[i])
            pivot[i] = H.diagonal[i] + tangents[step, i]
            if i + 1 < n:
                _add(out, -K.off[i], p[i + 1])
                _add(out, mass * M.off[i], r[i + 1])
            if i > 0:
                _add(out, -K.off[i - 1], p[i - 1])
                _add(out, mass * M.off[i - 1], r[i - 1])
                if pivot[i - 1] < inf:
                    factor = H.off[i - 1] / pivot[i - 1]
                    _add(out, -factor, work[i - 1])
                    pivot[i] -= factor * H.off[i - 1]
        for i in range(n - 1, -1, -1):
            out = work[i]
            if pivot[i] < inf:
                if i + 1 < n:
                    _add(out, -H.off[i], work[i + 1])
                inverse = 1.0 / pivot[i]
                for j in range(out.size):
                    out[j] *= inverse
            for j in range(out.size):
                p[i, j] += h * out[j]
                r[i, j] = 2.0 * out[j] - r[i, j]
