"""Steps of small dense systems, as Galerkin reduction makes them.

A reduced model has more contact points than unknowns, so that they cannot all stick: Newton's
iteration runs on the velocity itself, with an exact search along each direction of the strictly
convex objective 1/2 q H q - g q + sum w psi(B q). The search uses the objective's derivative
alone, so that it is not limited by the round-off of the objective. It never failed on reduced
models and is globally convergent for a finite beta.

The law's slope says little of a point whose velocity an iterate has thrown out of its steep part.
Its tangent lies between force over velocity and that slope, as the force that the last iteration
predicted lies between none and the law's: the primal-dual Newton method (Chan, Golub and Mulet,
SIAM J. Sci. Comput. 20, 1999), which has the same fixed point and order. Two bolted solids with 44
unknowns took 11 iterations a step with the slope alone and 48 evaluations of friction, and take 7.2
and 10; 9.0 and 12, a tenth faster, where a factor serves again while it does. Iterations that make
a new factor are counted.
"""

# numba infers the types of compiled functions:
# mypy: allow-untyped-defs, allow-untyped-calls, allow-untyped-decorators, no-check-untyped-defs

from __future__ import annotations

from math import inf, pi, sqrt
from typing import Any, NamedTuple

import numpy as np

from skfem_joint.arrays import FloatArray, as_dense
from skfem_joint.errors import InputError
from skfem_joint.stepping.compiled import (
    cholesky,
    compiled,
    compiled_for,
    forces,
    largest_of,
    solve_factorised,
    sums_in_any_order,
)
from skfem_joint.stepping.march import Found, Full, Places, aligned, make_room, slips, solve
from skfem_joint.stepping.schemes import Coefficients
from skfem_joint.stepping.steppers import CompiledStepper

ITERATIONS = 200
SEARCH = 60
#: Share of the residual that an iteration may leave for its factor to serve once more.
KEPT = 0.1
_TWO_OVER_PI = 2.0 / pi
#: Force, N, that is none.
_NOTHING = 1e-300
ROUND_OFF = 16 * np.finfo(np.float64).eps


class Contact(NamedTuple):
    """Contact points of a dense system, those with two slip directions first.

    The loops run along the points, so that they become vector instructions: first come the first
    rows of all points, then the second rows of those that have one.
    """

    B: Any  #: (n, rows) transposed slip operator
    w: Any  #: (rows,) friction limit of each row's point, N
    beta: Any  #: (m,) finite scaling constant of each point, s/m


class Dense(NamedTuple):
    """Problem of a step: its matrix H, N s/m, and the contact."""

    H: Any
    contact: Contact


class Memory(NamedTuple):
    """What the steps remember, what the last one found, and room to work in.

    ``old_velocity`` and ``old_force`` are those before the last step, ``predicted``, N, is the
    friction of each row as the last iteration predicted it, or the last two steps do. ``size`` and
    ``ratio``, shape (m,), are the norm of the slip vectors and force over norm. They are only kept
    where some points have two rows.
    """

    old_velocity: Any
    old_force: Any
    predicted: Any
    velocity: Any
    force: Any
    slip: Any
    r: Any
    A: Any
    d_slip: Any
    trial: Any
    weight: Any
    scaled: Any
    cross: Any
    size: Any
    ratio: Any


def contact_of(B: Any, first_row: Any, w: Any, beta: Any) -> tuple[Contact, Places]:
    """Contact points from the rows of a system, see :class:`skfem_joint.system.System`."""
    pair = np.diff(first_row) == 2
    point = np.concatenate([np.flatnonzero(pair), np.flatnonzero(~pair)])
    row = np.concatenate([first_row[point], first_row[np.flatnonzero(pair)] + 1])
    values = B[row].T, np.concatenate([w[point], w[pair]]), beta[point]
    room = aligned(*(value.size for value in values))
    contact = Contact(room[0].reshape(values[0].shape), *room[1:])
    for array, value in zip(contact, values, strict=True):
        array[...] = value
    return contact, Places(np.argsort(row), np.argsort(point))


def make_memory(n: int, rows: int, m: int) -> Memory:
    """Make the arrays for n unknowns, some slip rows and m points."""
    point = m if rows > m else 0
    sizes = (n, rows, rows, n, rows, rows, n, n * n, rows, rows, rows, rows, rows - m, point, point)
    memory = Memory(*aligned(*sizes))
    return memory._replace(A=memory.A.reshape(n, n))


@sums_in_any_order
def _dot(a, b):
    t = 0.0
    for i in range(a.size):
        t += a[i] * b[i]
    return t


@sums_in_any_order
def _work(w, sigma, d_slip):
    """Work of the friction forces on the slip ``d_slip``."""
    t = 0.0
    for i in range(w.size):
        t += w[i] * sigma[i] * d_slip[i]
    return t


@compiled
def _slip(B, q, slip):
    """Slip of all rows."""
    for i in range(slip.size):
        slip[i] = B[0, i] * q[0]
    for j in range(1, q.size):
        t = q[j]
        row = B[j]
        for i in range(slip.size):
            slip[i] += t * row[i]


@compiled
def _evaluate(beta, slip, size, ratio, sigma):
    """Normalised friction of all rows."""
    m = beta.size
    pairs = slip.size - m
    if pairs == 0:
        forces(beta, slip, sigma)
        return
    for p in range(pairs):
        size[p] = sqrt(slip[p] * slip[p] + slip[m + p] * slip[m + p])
    for p in range(pairs, m):
        size[p] = abs(slip[p])
    forces(beta, size, ratio)
    for p in range(m):
        ratio[p] = ratio[p] / size[p] if size[p] > 0.0 else _TWO_OVER_PI * beta[p]
        sigma[p] = ratio[p] * slip[p]
    for p in range(pairs):
        sigma[m + p] = ratio[p] * slip[m + p]


@compiled
def _tangent(H, contact, slip, sigma, room):
    """Lower triangle of H and the tangent of the friction, in A.

    That of a slip vector is force over norm across it. Along it, it is the law's slope as
    far as the predicted force is the law's.
    """
    B, w, beta = contact.B, contact.w, contact.beta
    weight, cross, scaled = room.weight, room.cross, room.scaled
    size, ratio, predicted = room.size, room.ratio, room.predicted
    m = beta.size
    pairs = slip.size - m
    for p in range(pairs):
        q = m + p
        z = beta[p] * size[p]
        across = w[p] * ratio[p]
        square = across * size[p] * size[p]
        more = w[p] * (_TWO_OVER_PI * beta[p] / (1.0 + z * z)) - across
        share = more / square if square > 0.0 else 0.0
        weight[p] = across + share * (slip[p] * predicted[p])
        weight[q] = across + share * (slip[q] * predicted[q])
        cross[p] = 0.5 * share * (slip[p] * predicted[q] + slip[q] * predicted[p])
    for p in range(pairs, m):
        z = beta[p] * slip[p]
        slope, force = w[p] * (_TWO_OVER_PI * beta[p] / (1.0 + z * z)), w[p] * sigma[p]
        moves = abs(force) > 0.0
        across = force / slip[p] if moves else slope
        share = predicted[p] / force if moves else 1.0
        weight[p] = across + (slope - across) * share
    for j in range(room.r.size):
        row, other = B[j], B[j, m:]
        for p in range(pairs):
            scaled[p] = weight[p] * row[p] + cross[p] * other[p]
        for p in range(pairs):
            scaled[m + p] = weight[m + p] * other[p] + cross[p] * row[p]
        for p in range(pairs, m):
            scaled[p] = weight[p] * row[p]
        for k in range(j + 1):
            room.A[j, k] = H[j, k] + _dot(scaled, B[k])


@compiled
def _limit(contact, predicted):
    """Scale forces (rows,), N, down to what friction can be."""
    w = contact.w
    m = contact.beta.size
    pairs = w.size - m
    first, second = predicted[:pairs], predicted[m:]
    for p in range(pairs):
        size = sqrt(first[p] * first[p] + second[p] * second[p])
        share = w[p] / max(size, w[p], _NOTHING)
        first[p] *= share
        second[p] *= share
    for p in range(pairs, m):
        predicted[p] = min(max(predicted[p], -w[p]), w[p])


@compiled
def _predict(contact, sigma, d_slip, room):
    """Friction after Newton's step, as its tangent tells, but no more than there can be."""
    w, weight, cross, predicted = contact.w, room.weight, room.cross, room.predicted
    m = contact.beta.size
    pairs = w.size - m
    for i in range(w.size):
        predicted[i] = w[i] * sigma[i] + weight[i] * d_slip[i]
    first, second, d_first, d_second = predicted[:pairs], predicted[m:], d_slip[:pairs], d_slip[m:]
    for p in range(pairs):
        first[p] += cross[p] * d_second[p]
        second[p] += cross[p] * d_first[p]
    _limit(contact, predicted)


@compiled
def _round_off(H, contact, q, slip, sigma, room):
    """Round-off of the residual: of H q, and of the slip velocities times the law's slope."""
    B, w, beta = contact.B, contact.w, contact.beta
    n = q.size
    m = beta.size
    pairs = slip.size - m
    friction = room.scaled
    for i in range(slip.size):
        friction[i] = 0.0
    for k in range(n):
        row, t = B[k], abs(q[k])
        for i in range(slip.size):
            friction[i] += abs(row[i]) * t
    for i in range(slip.size):
        if pairs > 0:
            slope = room.ratio[i if i < m else i - m]  # the larger of the two
        else:
            z = beta[i] * slip[i]
            slope = _TWO_OVER_PI * beta[i] / (1.0 + z * z)
        friction[i] = w[i] * (abs(sigma[i]) + slope * friction[i])
    largest = 0.0
    for j in range(n):
        row, total = B[j], 0.0
        for k in range(n):
            total += abs(H[j, k] * q[k])
        for i in range(slip.size):
            total += abs(row[i]) * friction[i]
        largest = max(largest, total)
    return ROUND_OFF * largest


@compiled
def _search(contact, slope_0, linear, quadratic, memory):
    """Length along a direction at which the objective is least, nearly, and not far beyond.

    ``slope_0`` is its slope here; without friction it is ``linear`` + length * ``quadratic``.
    Comes with the evaluations of friction, and whether slip and friction are left for that length.
    """
    slip, sigma, trial, d_slip = memory.slip, memory.force, memory.trial, memory.d_slip
    low, slope_low, high, slope_high, length = 0.0, slope_0, 0.0, 0.0, 1.0
    if not slope_0 < 0.0:
        return length, 0, False  # no descent left but round-off: the full step
    for evaluations in range(1, SEARCH + 1):
        for i in range(slip.size):
            trial[i] = slip[i] + length * d_slip[i]
        _evaluate(contact.beta, trial, memory.size, memory.ratio, sigma)
        slope = linear + length * quadratic + _work(contact.w, sigma, d_slip)
        # Accept a step short of the minimum along the line, or one just past it.
        short = slope <= 0.0 and (length == 1.0 or slope >= 0.5 * slope_0)
        if short or (length == 1.0 and 0.0 < slope <= -0.05 * slope_0):
            for i in range(slip.size):
                slip[i] = trial[i]
            return length, evaluations, True
        if slope > 0.0:
            high, slope_high = length, slope
        else:
            low, slope_low = length, slope
        length = low - slope_low * (high - low) / (slope_high - slope_low)
        length = min(max(length, low + 0.05 * (high - low)), high - 0.05 * (high - low))
    return length, SEARCH, False


@compiled_for(solve, Dense)
def minimum(problem, memory, right, v, tolerance):
    """Minimise the step's objective, from the velocity extrapolated over the last two steps.

    The solution is left in ``memory.velocity``, its slip velocities in ``memory.slip`` and forces
    in ``memory.force``, each with one entry for each row of the contact.
    """
    H, contact = problem
    q, before, slip, sigma = memory.velocity, memory.old_velocity, memory.slip, memory.force
    r, A, d_slip = memory.r, memory.A, memory.d_slip
    n, scale = q.size, largest_of(right)
    for i in range(n):
        q[i] = 2.0 * v[i] - before[i]
    evaluations, iteration, tangents, largest, converged = 0, 0, 0, 0.0, False
    known = False  # whether slip and sigma belong to q
    for iteration in range(ITERATIONS + 1):
        for i in range(n):
            t = -right[i]
            for j in range(n):
                t += H[i, j] * q[j]
            r[i] = t
        if not known:
            _slip(contact.B, q, slip)
            _evaluate(contact.beta, slip, memory.size, memory.ratio, sigma)
            evaluations += 1
        last, largest = largest, 0.0
        for i in range(n):
            r[i] += _work(contact.w, sigma, contact.B[i])
            if not abs(r[i]) <= largest and largest == largest:  # what is not a number stays
                largest = abs(r[i])
        converged = largest <= tolerance * scale or (
            largest <= 1e-6 * scale and largest <= _round_off(H, contact, q, slip, sigma, memory)
        )
        if converged or not largest < inf or iteration == ITERATIONS:
            break
        if iteration == 0 or not largest < KEPT * last:  # else the last factor still does
            tangents += 1
            _tangent(H, contact, slip, sigma, memory)
            if not cholesky(A):
                break
        solve_factorised(A, r)
        linear, quadratic, direction = 0.0, 0.0, r
        for i in range(n):
            direction[i] = -r[i]
        for i in range(n):
            t = 0.0
            for j in range(n):
                t += H[i, j] * direction[j]
            linear += t * q[i] - right[i] * direction[i]
            quadratic += t * direction[i]
        _slip(contact.B, direction, d_slip)
        slope_0 = linear + _work(contact.w, sigma, d_slip)
        _predict(contact, sigma, d_slip, memory)
        length, trials, known = _search(contact, slope_0, linear, quadratic, memory)
        evaluations += trials
        for i in range(n):
            q[i] += length * direction[i]
    if converged:
        for i in range(n):
            before[i] = v[i]
        for i in range(sigma.size):
            memory.predicted[i] = contact.w[i] * (2.0 * sigma[i] - memory.old_force[i])
            memory.old_force[i] = sigma[i]
        _limit(contact, memory.predicted)
    else:
        for i in range(sigma.size):
            memory.predicted[i] = 0.0
    searches = evaluations - iteration - 1
    return Found(converged, tangents, 0, 0, searches, evaluations, largest, 0)


@compiled
def found_alone(problem, memory, right, v, tolerance):
    """`minimum`, called from Python."""
    return solve(problem, memory, right, v, tolerance)


@compiled_for(slips, Dense)
def _slips_of_dense(problem, x, room):
    _slip(problem.contact.B, x, room)
    return room


class DenseStepper(CompiledStepper):
    """Steps of a small dense system.

    Raises
    ------
    InputError
        For set-valued Coulomb friction.
    """

    REMEMBERED = ("old_velocity", "old_force", "predicted")

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments)
        s = self.system
        if np.any(np.isinf(s.beta[s.w > 0.0])):
            raise InputError(
                "set-valued Coulomb friction (beta = inf) needs one unknown for each contact "
                "point, which a reduced or dense system has not; use System.with_beta with a "
                "finite beta"
            )
        self.dynamics = (Full(as_dense(s.M)), Full(as_dense(s.C)), Full(as_dense(s.K)))
        beta = np.where(s.w > 0.0, s.beta, 1.0)
        self.contact, self.places = contact_of(as_dense(s.B), s.first_row, s.w, beta)
        self.limits = self.contact.w
        rows = self.limits.size
        self.memory, self.room = make_memory(s.n, rows, s.w.size), make_room(s.n, rows, s.w.size)
        self.first_call = max(1, 10_000_000 // (rows * s.n**2))

    def make(self, c: Coefficients) -> Dense:
        """Step matrix."""
        (M,), (C,), (K,) = self.dynamics
        self.counts["factorizations"] += 1
        return Dense(c.c_M * M + C + c.c_K * K, self.contact)

    def started(self, acceleration: FloatArray, sigma: FloatArray) -> None:
        """Go on from the velocity now."""
        super().started(acceleration, sigma)
        self.memory.old_velocity[:] = self.now.v
        self.memory.old_force[:] = self.now.sigma
        self.memory.predicted[:] = self.limits * self.now.sigma
