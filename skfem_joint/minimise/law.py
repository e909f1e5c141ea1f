"""The law of friction: Coulomb regularised by the arctangent, and set-valued Coulomb as its limit.

With the slip velocity v (m/s) and the steepness beta (s/m; the scaling constant of Eq. (2)) the
normalised friction force of a contact point is

    sigma(v) = 2/pi arctan(beta v),        beta finite,
    sigma(v) in Sgn(v),                    beta = inf (set-valued Coulomb),

so that ``w * sigma`` is the force in N of a point with friction limit ``w``. The law is the
gradient of an even convex potential psi, which makes every implicit step a strictly convex
minimisation. A slip *vector* follows the law radially: the force has the direction of the slip and
depends on its norm; its potential is psi of the norm.

Friction forces, slopes and potentials are computed in this module alone. They derive from the
scalar functions of its first section, in terms of the normalised speed z = beta |v|: force, slope,
potential, inverse, and the number `WIDTH`. The rest of the module serves the solvers:

- at a point: `sigma`, `slope`, `psi`, `sticks`, and `resolvent`, the solution of
  k v + sigma(v) = x, with which a point is relaxed while its neighbours stay;
- the same with a spring in series (`sprung_force`, `sprung_slope`, `sprung_psi`,
  `sprung_resolvent`), see below;
- the tangent of the force of a slip vector, `slip_tangent`, and of a point, `add_tangent`;
- along many points of a compiled loop: `forces`, and the graph of the law in a parameter s
  (Minty's): `graph` gives v(s) and sigma(s) with derivatives, `graph_parameters` is its inverse;
- of arrays that broadcast, in Python: `force`, `force_slope`, `potential`, `force_vectors`.

A spring in series with friction takes a part of the slip that is proportional to the force,

    v = z + soft sigma,    sigma = sigma(z),

z being the rate of the slider itself and ``soft`` >= 0 a compliance: in a step that moves the point
by c v, the limit over the spring's stiffness and c. The force is again a law of v, odd and rising
to 1, whose potential is the Moreau envelope of psi,

    min over z:   psi(z) + (v - z)^2 / (2 soft),

so that steps stay convex. Where the spring was under a force before, v counts from the velocity at
which it would be without one. As a law of the graph's parameter, velocities are those of the slider
plus ``soft sigma``, and the resolvent is that of the slider for other numbers.

To replace the arctangent by another law, rewrite the first section. The law must be odd, without
memory, increasing to 1, and concave for z >= 0. `resolvent` needs that: it starts from the solution
for a smaller law, z / (z + `WIDTH`), and relies on the sign of the curvature; so does the tangent
of `primal_dual_newton`, which lies between secant and slope. The following places use properties of
the arctangent, and have to be revised too:

- `graph` and `graph_parameters`: their comparison law z / (z + 1) must rise to 1 in a width of the
  same order;
- `System.slipping`: a point creeps by period / beta in a period, the slip at half of its friction
  limit, where z = 1; `skfem_joint.stepping.recording.Recorder`,
  `skfem_joint.reduction.active_length.gross_slip`, the points of reduced models for a range
  (`skfem_joint.reduction.ranges.points`) and the warnings of `skfem_joint.study.summary` use the
  same creep, a note of `skfem_joint.vibration.backbone` the velocity 1 / beta;
- `skfem_joint.reduction.models.reduced_on` and `static_path`: beta is limited to the inverse of
  the slip velocity that modes resolve, for the law is steep where z < 1;
- `skfem_joint.accuracy.rungs`: the error of a less steep law is proportional to 1 / beta.

To add a law beside the arctangent takes more, since a contact point carries no kind of law, only
its beta, and the value ``inf`` stands for Coulomb's law. A kind, or a further parameter, has to
pass through all that carries beta: the scene's `JointTable.law`; `Joint`, `contact`,
`point_friction` and `point_contact` (`skfem_joint.joint`), and joints of given matrices
(`skfem_joint.structure.matrices`); `SlipRows` (`skfem_joint.system.slips`); `Contact`
(`skfem_joint.system.contacts`) with `steepest`, `no_steeper` and `with_beta`, and `System` with its
projection and its file; the merging of points (`skfem_joint.reduction.friction_points`), the points
of reduced models in results (`skfem_joint.results.contact_history`) and missing modes
(`skfem_joint.reduction.missing_modes`); `ContactPoints` (`skfem_joint.minimise.problem`);
quasi-static levels (`skfem_joint.slow.quasi_static`), friction along a motion
(`skfem_joint.runs.friction_along`) and warped time (`skfem_joint.stepping.warp`); and the named
tuples of the compiled loops, `Chain` and `DenseRows`, with the arguments of `contact_loops`. The
scalar functions then choose by it. Runs without inertia, damping curves and
`skfem_joint.harmonic` take Coulomb's law in place of any finite beta.
"""

# numba infers the types of compiled functions:
# mypy: allow-untyped-defs, allow-untyped-calls, allow-untyped-decorators, no-check-untyped-defs

from __future__ import annotations

from math import atan, copysign, hypot, inf, log1p, pi, sqrt, tan
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from skfem_joint.ground.arrays import FloatArray, slip_norms
from skfem_joint.ground.compiling import compiled, compiled_inside

#: Kinds of points: regularised law (finite beta), set-valued Coulomb friction, no friction.
REGULAR, COULOMB, FREE = 0, 1, 2

# The regularised law as a function of the normalised speed z = beta |v| >= 0

_TWO_OVER_PI = 2.0 / pi
_TAN_1 = tan(pi / 8.0)
_TAN_3 = tan(3.0 * pi / 8.0)


@compiled_inside
def arctangent(z):
    """arctan(z) for z >= 0 with a relative error below 4e-16.

    It has no branches, so that loops over points become vector instructions: the argument is folded
    to |t| <= tan(pi/8), where arctan(t)/t is a polynomial of degree 12 in t^2.
    """
    steep = z > _TAN_3
    middle = z > _TAN_1
    numerator = -1.0 if steep else (z - 1.0 if middle else z)
    denominator = z if steep else (z + 1.0 if middle else 1.0)
    offset = 0.5 * pi if steep else (0.25 * pi if middle else 0.0)
    t = numerator / denominator
    q = t * t
    # Coefficients of arctan(t) / t - 1 in powers of q, from the 12th down. They interpolate at the
    # Chebyshev nodes of |t| <= tan(pi/8), and were computed with 60 digits.
    p = 0.015113765096600925
    p = p * q - 0.03338782450121195
    p = p * q + 0.04499500728984032
    p = p * q - 0.05217312574061591
    p = p * q + 0.05876834004614161
    p = p * q - 0.06666205259976526
    p = p * q + 0.07692281099937744
    p = p * q - 0.09090908059031191
    p = p * q + 0.11111111085322109
    p = p * q - 0.1428571428532971
    p = p * q + 0.19999999999997015
    p = p * q - 0.33333333333333326
    return offset + (t + t * (q * p))


@compiled_inside
def force_of(z):
    """Normalised force sigma, from 0 to 1."""
    return _TWO_OVER_PI * arctangent(z)


@compiled_inside
def force_alone(z):
    """`force_of` by the library's arctangent: faster for a point alone, outside of loops."""
    return _TWO_OVER_PI * atan(z)


@compiled_inside
def slope_of(z):
    """Derivative of the normalised force, d sigma / dz."""
    return _TWO_OVER_PI / (1.0 + z * z)


@compiled_inside
def potential_of(z):
    """Normalised potential beta psi: integral of the force from 0 to z."""
    return z * force_alone(z) - 0.5 * _TWO_OVER_PI * log1p(z * z)


@compiled_inside
def speed_of(force):
    """Inverse of `force_of`, for forces below 1."""
    return tan(0.5 * pi * force)


#: The law exceeds z / (z + WIDTH) everywhere, with the same slope at rest. The resolvent's bracket
#: comes from it.
WIDTH = 0.5 * pi
# The parameter of the graph compares the law with z / (z + 1), whose resolvent has a closed form.
# That law need not be close; it must rise to 1 in a width of the same order.

# At a point


@compiled
def sigma(v, beta):
    """Normalised force, from -1 to 1; 0 for Coulomb friction at rest, where any such value acts."""
    if beta == inf:
        return copysign(1.0, v) if abs(v) > 0.0 else v
    return copysign(force_alone(abs(beta * v)), v)


@compiled_inside
def slope(v, beta):
    """Derivative d sigma / dv, s/m; for Coulomb friction 0 in slip and ``inf`` at rest."""
    if beta == inf:
        return inf if v == 0.0 else 0.0
    return beta * slope_of(beta * v)


@compiled_inside
def psi(v, beta):
    """Potential, m/s, whose derivative is `sigma`; zero at rest, |v| for Coulomb friction."""
    return abs(v) if beta == inf else potential_of(abs(beta * v)) / beta


@compiled_inside
def sticks(force, limit):
    """Whether a Coulomb point at rest stays at rest: friction up to the limit balances the force.

    All methods use this rule: for single points, for slip fronts on chains, and for restarts.
    """
    return abs(force) <= limit


@compiled
def resolvent(x, k, beta):
    """Solve k v + sigma(v) = x; returns v and sigma."""
    if beta == inf:
        if sticks(x, 1.0):
            return 0.0, x
        v = (abs(x) - 1.0) / k
        return (v, 1.0) if x > 0.0 else (-v, -1.0)
    size = abs(x)
    k = k / beta
    # Upper end of a bracket of z, the root for the law z / (z + WIDTH), which is smaller. From
    # there Newton's iteration may step below the root of the concave residual once, and rises to it
    # from then on.
    b = size - 1.0 - k * WIDTH
    root = sqrt(b * b + 4.0 * k * WIDTH * size)
    z = (b + root) / (2.0 * k) if b > 0.0 else 2.0 * WIDTH * size / (root - b)
    for _ in range(60):
        step = (k * z + force_alone(z) - size) / (k + slope_of(z))
        z_next = max(z - step, 0.0)
        if abs(z_next - z) <= 4e-16 * z:
            break
        z = z_next
    force = force_alone(z)
    return (z / beta, force) if x > 0.0 else (-z / beta, -force)


# Tangent of the friction of a slip vector


def slip_tangent(more: Any, across: Any, x: Any, y: Any, p: Any, q: Any) -> Any:
    """Entries 11, 12 and 22 of d(force)/d(slip) of a slip vector, of numbers or arrays.

    The force depends on the norm of the slip and has its direction e = (x, y). So its derivative is
    the slope of the law along e, and force over norm across it:

        across I + more (e f^T + f e^T) / 2,

    with f = (p, q) = e, and what the slope is ``more`` than across. With the predicted force over
    that of the law for f it is the tangent of :mod:`skfem_joint.minimise.primal_dual_newton`, which
    is secure far from the solution. Where e and f have other lengths than 1, ``more`` is over both.
    """
    first, mixed = across + more * x * p, more * x * q + 0.5 * more * (y * p - x * q)
    return first, mixed, across + more * y * q


#: `slip_tangent` for compiled loops.
tangent_inside = compiled_inside(slip_tangent)


@compiled_inside
def add_tangent(w, x, y, pair, beta, soft, stiffest, out):
    """Add the tangent of a force ``w sigma`` at a slip (x, y) to ``out``, entries (11, 12, 22).

    ``pair`` is whether the point slips in two directions; else y is 0, and 11 alone counts. Nothing
    is added for a Coulomb point at rest without a spring. Across the slip of a Coulomb point the
    tangent is at most ``stiffest``: round-off of a much stiffer one would make matrices singular.
    """
    speed = hypot(x, y)
    if beta == inf and soft == 0.0 and speed == 0.0:
        return
    along = w * sprung_slope(speed, beta, soft)
    if speed == 0.0 or not pair:
        out[0] += along
        out[2] += along
        return
    beside = w * sprung_across(speed, beta, soft)
    if beta == inf:
        beside = min(beside, stiffest)
    x /= speed
    y /= speed
    first, mixed, second = tangent_inside(along - beside, beside, x, y, x, y)
    out[0] += first
    out[1] += mixed
    out[2] += second


# At a point with a spring in series


@compiled
def slider(v, beta, soft):
    """Rate of the slider and its normalised force, at a slip v that it shares with its spring."""
    if soft == 0.0:
        return v, sigma(v, beta)
    return resolvent(v / soft, 1.0 / soft, beta)


@compiled_inside
def sprung_force(v, beta, soft):
    """Normalised force; `sigma` where ``soft`` is zero."""
    return slider(v, beta, soft)[1]


@compiled_inside
def sprung_slope(v, beta, soft):
    """Derivative of `sprung_force` in v, s/m; `slope` where ``soft`` is zero."""
    if soft == 0.0:
        return slope(v, beta)
    z = slider(v, beta, soft)[0]
    if beta == inf:
        return 1.0 / soft if z == 0.0 else 0.0
    own = slope(z, beta)
    return own / (1.0 + soft * own)


@compiled_inside
def sprung_across(speed, beta, soft):
    """Force over the norm of a slip vector, s/m; at rest the slope."""
    return slider(speed, beta, soft)[1] / speed if speed > 0.0 else sprung_slope(0.0, beta, soft)


@compiled_inside
def sprung_psi(v, beta, soft):
    """Potential of `sprung_force`, m/s; `psi` where ``soft`` is zero."""
    z, force = slider(v, beta, soft)
    return psi(z, beta) + 0.5 * soft * force * force


@compiled
def sprung_resolvent(x, k, beta, soft):
    """Solve k v + force(v) = x for `sprung_force`; returns v and the force."""
    if soft == 0.0:
        return resolvent(x, k, beta)
    more = 1.0 + k * soft
    z, force = resolvent(x / more, k / more, beta)
    return z + soft * force, force


# Along many points


@compiled
def forces(beta, slip, result):
    """Normalised forces of regularised points (beta finite); without branches."""
    for i in range(slip.size):
        z = beta[i] * slip[i]
        result[i] = copysign(force_of(abs(z)), z)


@compiled
def graph(kind, mixed, kappa, inverse_beta, s, v, force, dv, dforce):
    """Points of the law's graph with the parameters ``s``, and their derivatives in s.

    For Coulomb friction v and sigma solve kappa v + sigma = s (Minty's parametrisation). For the
    regularised law v solves this with the comparison law z / (z + 1), z = beta v, which has a
    closed form, and sigma is the law's force at that v: the point lies on the law's graph to
    round-off, for a square root and an arctangent. Both v(s) and sigma(s) have bounded slopes
    however large beta is, so that a Newton iteration on s does not degrade. Points without friction
    have v = s / kappa.

    Parameters
    ----------
    kind : ndarray of int, shape (n,)
        REGULAR, COULOMB or FREE.
    mixed : int
        0 if all points are REGULAR, 1 if some are, 2 if none is.
    kappa : float
        Scale, s/m, positive.
    inverse_beta : ndarray, shape (n,)
        1 / beta, m/s; any positive number where the kind is not REGULAR.
    s, v, force, dv, dforce : ndarray, shape (n,)
        Parameters, and the results: velocities (m/s), normalised forces, and their derivatives.
    """
    if mixed < 2:
        for i in range(s.size):
            k = kappa * inverse_beta[i]
            m = abs(s[i])
            b = m - 1.0 - k
            root = sqrt(b * b + 4.0 * k * m)
            beyond = b > 0.0  # choose the form of the root without cancellation
            z = (b + root if beyond else 2.0 * m) / (2.0 * k if beyond else root - b)
            dz = (z + 1.0) / root
            v[i] = copysign(z * inverse_beta[i], s[i])
            force[i] = copysign(force_of(z), s[i])
            dv[i] = dz * inverse_beta[i]
            dforce[i] = dz * slope_of(z)
    if mixed > 0:
        inverse = 1.0 / kappa
        for i in range(s.size):
            if kind[i] != REGULAR:
                coulomb = kind[i] == COULOMB
                inside = min(max(s[i], -1.0), 1.0) if coulomb else 0.0
                at_rest = coulomb and sticks(s[i], 1.0)
                v[i] = (s[i] - inside) * inverse
                force[i] = inside
                dv[i] = 0.0 if at_rest else inverse
                dforce[i] = 1.0 if at_rest else 0.0


@compiled_inside
def add_springs(soft, offset, v, force, dv, dforce):
    """Add what springs in series take of the slip to the sliders' rates of `graph`, in place.

    ``soft`` and ``offset``, (n,), are their compliances (m/s) and the slips from which slips count.
    """
    for i in range(v.size):
        v[i] += soft[i] * force[i] + offset[i]
        dv[i] += soft[i] * dforce[i]


@compiled
def graph_parameters(kind, kappa, inverse_beta, v, force, s):
    """Parameters of points of the graph, from velocity and force: the inverse of `graph`.

    A regularised point at rest under a force, as Coulomb's solution has it, gets the parameter of
    that force, which may not exceed 0.999.
    """
    for i in range(v.size):
        if kind[i] == REGULAR:
            z = abs(v[i]) / inverse_beta[i] if v[i] != 0.0 else speed_of(min(abs(force[i]), 0.999))
            s[i] = copysign(kappa * inverse_beta[i] * z + z / (z + 1.0), force[i])
        else:
            s[i] = kappa * v[i] + force[i]


@compiled
def slider_rates(kind, inverse_beta, soft, v, force, z):
    """Rates of the sliders: v without springs, else as far as the forces tell them.

    A slider that slips by Coulomb's law is taken to have all of the slip.
    """
    for i in range(v.size):
        z[i] = v[i]
        if soft[i] > 0.0:
            size = abs(force[i])
            if kind[i] == REGULAR:
                z[i] = copysign(speed_of(min(size, 0.999)) * inverse_beta[i], force[i])
            elif size < 1.0:
                z[i] = 0.0


# Of arrays


@compiled
def _forces(v, beta, soft, result):
    for i in range(v.size):
        result[i] = sprung_force(v[i], beta[i], soft[i])


@compiled
def _slopes(v, beta, soft, result):
    for i in range(v.size):
        result[i] = sprung_slope(v[i], beta[i], soft[i])


@compiled
def _potentials(v, beta, soft, result):
    for i in range(v.size):
        result[i] = sprung_psi(v[i], beta[i], soft[i])


def _evaluated(loop: Any, *given: ArrayLike) -> FloatArray:
    """Values at slip velocities, values of beta and compliances that broadcast."""
    arrays = np.broadcast_arrays(*(np.asarray(x, dtype=float) for x in given))
    result = np.empty(arrays[0].shape)
    loop(*(x.copy().ravel() for x in arrays), result.ravel())
    return result


def force(v: ArrayLike, beta: ArrayLike, soft: ArrayLike = 0.0) -> FloatArray:
    """Normalised friction force sigma(v) in [-1, 1], Eq. (2).

    Parameters
    ----------
    v : array_like
        Slip velocity, m/s.
    beta : array_like
        Steepness beta, s/m; ``inf`` is Coulomb. It broadcasts against ``v``.
    soft : array_like
        Compliance of a spring in series, m/s, see the module; none by default.

    Returns
    -------
    ndarray
        For Coulomb points at rest, where any value in [-1, 1] may act, the value 0.
    """
    return _evaluated(_forces, v, beta, soft)


def force_slope(v: ArrayLike, beta: ArrayLike, soft: ArrayLike = 0.0) -> FloatArray:
    """Derivative d sigma / dv, s/m, of the shapes of `force`; see `slope`."""
    return _evaluated(_slopes, v, beta, soft)


def potential(v: ArrayLike, beta: ArrayLike, soft: ArrayLike = 0.0) -> FloatArray:
    """Potential psi(v), m/s, of the shapes of `force`; see `psi`."""
    return _evaluated(_potentials, v, beta, soft)


def along_and_across(
    size: FloatArray, beta: FloatArray, soft: FloatArray | float = 0.0
) -> tuple[FloatArray, FloatArray]:
    """Tangents over the limit, s/m, along and across slips of some ``size``, of shapes of `force`.

    Zero at rest under Coulomb friction without springs, where unknowns stick.
    """
    along, moves = force_slope(size, beta, soft), size > 0.0
    across = np.where(moves, force(size, beta, soft) / np.where(moves, size, 1.0), along)
    sticks = np.isinf(along)
    return np.where(sticks, 0.0, along), np.where(sticks, 0.0, across)


def force_vectors(slip: ArrayLike, beta: ArrayLike, directions: NDArray[np.int64]) -> FloatArray:
    """Normalised friction forces sigma(|y|) y / |y| of points with slip vectors y (isotropic).

    Parameters
    ----------
    slip : array_like, shape (..., rows)
        Slip velocity of each row, m/s; the rows of a point follow each other.
    beta : array_like
        Steepness beta of each point, s/m, which broadcasts against (..., m).
    directions : ndarray of int, shape (m,)
        Rows of each point, 1 or 2.

    Returns
    -------
    ndarray, shape (..., rows)
    """
    rows = np.asarray(slip, dtype=np.float64)
    if directions.size == rows.shape[-1]:
        return force(rows, beta)
    size = slip_norms(rows, directions)
    ratio = force(size, beta) / np.where(size > 0.0, size, 1.0)
    return np.asarray(np.repeat(ratio, directions, axis=-1) * rows)
