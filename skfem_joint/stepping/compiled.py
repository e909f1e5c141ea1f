"""Compiled functions: their cache, and the friction laws.

The loops over points hold no branches, so that the compiler turns them into vector instructions.
That asks for an arctangent of its own: the argument is folded to |t| <= tan(pi/8), where
arctan(t)/t is a polynomial of degree 12 in t^2 (interpolation at the Chebyshev nodes, computed with
60 digits). Its relative error is below 4e-16.
"""

# numba infers the types of compiled functions:
# mypy: allow-untyped-defs, allow-untyped-calls, allow-untyped-decorators, no-check-untyped-defs

from __future__ import annotations

import warnings
from hashlib import sha256
from inspect import signature
from math import atan, copysign, inf, pi, sqrt, tan
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit
from numba.core.event import TimingListener, register
from numba.extending import overload

from skfem_joint.friction import ARCTAN, COULOMB

# The cache

_SOURCES = sha256(
    b"".join(path.read_bytes() for path in sorted(Path(__file__).parent.glob("*.py")))
).hexdigest()
_told: list[str] = []


def _tell(reason: object) -> None:
    """Say once that compiled code cannot be kept."""
    if not _told:
        _told.append(str(reason))
        warnings.warn(
            f"compiled code cannot be kept ({reason}): every new process compiles it again, which "
            "takes up to half a minute; set NUMBA_CACHE_DIR to a folder that can be written to",
            RuntimeWarning,
            stacklevel=3,
        )


#: Adds up the time that this process spends in compilation; loading from the cache is not counted.
COMPILING = TimingListener()
register("numba:compile", COMPILING)


class _Cache:
    """numba's cache of one function, renewed where a file is damaged, done without on a full disk.

    numba takes compiled code for current as long as the function's own file is unchanged; here all
    files of this folder count, because a function holds those that it calls.
    """

    def __init__(self, own: Any) -> None:
        self._own = own
        files = own._cache_file
        files._source_stamp = (files._source_stamp, _SOURCES)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._own, name)

    def load_overload(self, signature: Any, context: Any) -> Any:
        try:
            return self._own.load_overload(signature, context)
        except Exception:  # noqa: BLE001 - whatever a damaged file makes of it: compile anew
            try:
                self._own.flush()
            except OSError:
                self._own.disable()
            return None

    def save_overload(self, signature: Any, compiled_code: Any) -> None:
        try:
            self._own.save_overload(signature, compiled_code)
        except OSError as error:
            self._own.disable()
            _tell(error)


#: No references to arrays are counted, which in loops of microseconds takes a quarter of the time:
#: no function makes an array, and whoever calls them from Python holds those that it gives.
_OPTIONS: Any = {"error_model": "numpy", "_nrt": False}


def _decorator(**options: Any) -> Any:
    """Decorator of functions to compile, with a cache where a folder for it can be written to."""
    options |= _OPTIONS | {"no_cfunc_wrapper": True}

    def decorate(function: Any) -> Any:
        try:
            dispatcher = njit(cache=True, **options)(function)
        except RuntimeError as error:
            _tell(error)
            return njit(**options)(function)
        if hasattr(dispatcher, "_cache"):  # not so where numba is told not to compile
            dispatcher._cache = _Cache(dispatcher._cache)
        return dispatcher

    return decorate


compiled = _decorator()
#: For sums over many points: their order is left to the compiler, for vector instructions.
sums_in_any_order = _decorator(fastmath={"reassoc", "contract"})


def compiled_for(function: Any, kind: Any) -> Any:
    """Decorator: what ``function`` is where its first argument is a named tuple of a kind."""

    def decorate(own: Any) -> Any:
        def chosen(*arguments: Any) -> Any:
            return own if getattr(arguments[0], "instance_class", None) is kind else None

        # The compiler asks for the names of the arguments.
        chosen.__signature__ = signature(own)  # type: ignore[attr-defined]
        overload(function, jit_options=_OPTIONS)(chosen)
        return own

    return decorate


@compiled
def largest_of(x):
    """Largest magnitude; four at a time, because maxima of numbers wait for each other."""
    n = x.size - x.size % 4
    a, b, c, d = 0.0, 0.0, 0.0, 0.0
    for i in range(0, n, 4):
        a = abs(x[i]) if abs(x[i]) > a else a
        b = abs(x[i + 1]) if abs(x[i + 1]) > b else b
        c = abs(x[i + 2]) if abs(x[i + 2]) > c else c
        d = abs(x[i + 3]) if abs(x[i + 3]) > d else d
    for i in range(n, x.size):
        a = abs(x[i]) if abs(x[i]) > a else a
    return max(a, b, c, d)


@sums_in_any_order
def weighted(weights, places, x):
    """Weighted sum of some entries."""
    total = 0.0
    for i in range(weights.size):
        total += weights[i] * x[places[i]]
    return total


# The friction laws

_TAN_1 = float(np.tan(np.pi / 8.0))
_TAN_3 = float(np.tan(3.0 * np.pi / 8.0))
_TWO_OVER_PI = 2.0 / pi
#: Largest normalised force at which a regularised point is taken to stick.
STEEPEST = 0.999
#: Coefficients of arctan(t) / t - 1 in t^2, from the highest power down.
_HIGHEST = 0.015113765096600925
_LOWER = (
    -0.03338782450121195, 0.04499500728984032, -0.05217312574061591, 0.05876834004614161,
    -0.06666205259976526, 0.07692281099937744, -0.09090908059031191, 0.11111111085322109,
    -0.1428571428532971, 0.19999999999997015, -0.33333333333333326,
)  # fmt: skip


@compiled
def arctangent(z):
    """arctan(z) for z >= 0, without branches."""
    steep = z > _TAN_3
    middle = z > _TAN_1
    numerator = -1.0 if steep else (z - 1.0 if middle else z)
    denominator = z if steep else (z + 1.0 if middle else 1.0)
    offset = 0.5 * pi if steep else (0.25 * pi if middle else 0.0)
    t = numerator / denominator
    q = t * t
    p = _HIGHEST
    for c in _LOWER:
        p = p * q + c
    return offset + (t + t * (q * p))


@compiled
def forces(beta, slip, sigma):
    """Normalised friction force of regularised points."""
    for i in range(slip.size):
        z = beta[i] * slip[i]
        sigma[i] = copysign(_TWO_OVER_PI * arctangent(abs(z)), z)


@compiled
def graph(kind, mixed, kappa, inverse_beta, s, v, sigma, dv, dsigma):
    """Points of the laws' graphs that belong to the parameters ``s``, with derivatives in s.

    ``kind`` is ARCTAN, COULOMB or FREE; ``mixed`` 0 if all points are ARCTAN, 1 if some are, 2 if
    none is; ``kappa`` a positive scale, s/m; ``inverse_beta`` any positive number where the kind is
    not ARCTAN.

    For Coulomb v and sigma solve ``kappa v + sigma = s`` (Minty's parametrisation). For the
    arctangent v solves this for the rational law z / (z + 1), z = beta v, which has a closed form,
    and sigma is the arctangent's force at that v: the point lies on the law's graph to round-off,
    with one square root and one arctangent. Both v(s) and sigma(s) have bounded slopes however
    large beta is, which keeps a Newton iteration on s from degrading. Free points have
    v = s / kappa.
    """
    if mixed < 2:
        for i in range(s.size):
            k = kappa * inverse_beta[i]
            m = abs(s[i])
            b = m - 1.0 - k
            root = sqrt(b * b + 4.0 * k * m)
            beyond = b > 0.0  # of the two forms of the root, the one without cancellation
            z = (b + root if beyond else 2.0 * m) / (2.0 * k if beyond else root - b)
            w = 1.0 + z * z
            slope = (z + 1.0) / (root * w)
            v[i] = copysign(z * inverse_beta[i], s[i])
            sigma[i] = copysign(_TWO_OVER_PI * arctangent(z), s[i])
            dv[i] = slope * w * inverse_beta[i]
            dsigma[i] = _TWO_OVER_PI * slope
    if mixed > 0:
        inverse = 1.0 / kappa
        for i in range(s.size):
            if kind[i] != ARCTAN:
                coulomb = kind[i] == COULOMB
                inside = min(max(s[i], -1.0), 1.0) if coulomb else 0.0
                sticks = coulomb and abs(s[i]) <= 1.0
                v[i] = (s[i] - inside) * inverse
                sigma[i] = inside
                dv[i] = 0.0 if sticks else inverse
                dsigma[i] = 1.0 if sticks else 0.0


@compiled
def parameters(kind, kappa, inverse_beta, v, sigma, s):
    """Parameter of points of the graph, from velocity and force: the way back from `graph`.

    Where the arctan law is at rest under a force, as Coulomb's solution has it, it is that force's.
    """
    for i in range(v.size):
        if kind[i] == ARCTAN:
            force = min(abs(sigma[i]), STEEPEST)
            z = abs(v[i]) / inverse_beta[i] if v[i] != 0.0 else tan(0.5 * pi * force)
            s[i] = copysign(kappa * inverse_beta[i] * z + z / (z + 1.0), sigma[i])
        else:
            s[i] = kappa * v[i] + sigma[i]


@compiled
def resolvent(x, k, beta):
    """Solve k v + sigma(v) = x for one point; returns v and sigma."""
    if beta == inf:
        if abs(x) <= 1.0:
            return 0.0, x
        v = (abs(x) - 1.0) / k
        return (v, 1.0) if x > 0.0 else (-v, -1.0)
    magnitude = abs(x)
    k = k / beta
    # Upper end of the root's bracket: the arctangent is at least z / (z + pi / 2). From there
    # Newton may step below the root of the concave residual once and rises to it from then on.
    c = 0.5 * pi
    b = magnitude - 1.0 - k * c
    root = sqrt(b * b + 4.0 * k * c * magnitude)
    z = (b + root) / (2.0 * k) if b > 0.0 else 2.0 * c * magnitude / (root - b)
    for _ in range(60):
        step = (k * z + 2.0 / pi * atan(z) - magnitude) / (k + 2.0 / pi / (1.0 + z * z))
        z_next = max(z - step, 0.0)
        if abs(z_next - z) <= 4e-16 * z:
            break
        z = z_next
    sigma = 2.0 / pi * atan(z)
    return (z / beta, sigma) if x > 0.0 else (-z / beta, -sigma)


@compiled
def cholesky(A):
    """Overwrite the lower triangle of A by its factor; False where it is not positive definite.

    The diagonal takes the reciprocals of the factor's, so that the loops need not divide.
    """
    for i in range(len(A)):
        for j in range(i + 1):
            t = A[i, j]
            for k in range(j):
                t -= A[i, k] * A[j, k]
            if i == j:
                if not t > 0.0:
                    return False
                A[i, i] = 1.0 / sqrt(t)
            else:
                A[i, j] = t * A[j, j]
    return True


@compiled
def solve_factorised(A, x):
    """Solve A x = b in place (b in x) by the factor that `cholesky` left."""
    n = x.size
    for i in range(n):
        t = x[i]
        for k in range(i):
            t -= A[i, k] * x[k]
        x[i] = t * A[i, i]
    for i in range(n - 1, -1, -1):
        t = x[i]
        for k in range(i + 1, n):
            t -= A[k, i] * x[k]
        x[i] = t * A[i, i]
