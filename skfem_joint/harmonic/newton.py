"""Newton's iteration on scaled residuals, and continuation along a parameter."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from scipy import linalg

from skfem_joint.ground.arrays import FloatArray
from skfem_joint.ground.errors import ConvergenceError

#: Norm of a residual of unknowns of size 1 that ends the iteration.
TOLERANCE = 1e-9
#: Most iterations, and halvings of a step.
ITERATIONS, HALVINGS = 30, 8
#: Step in the parameter, halved, below which a continuation ends.
LEAST = 1e-3


class Point(NamedTuple):
    """Solution of a problem at a parameter.

    Attributes
    ----------
    y : ndarray
        Scaled unknowns.
    tangent : ndarray
        Their derivative by the parameter.
    iterations : int
    """

    y: FloatArray
    tangent: FloatArray
    iterations: int


#: Residual, and its derivatives by the unknowns and the parameter, of scaled unknowns and parameter.
Equations = Callable[[FloatArray, float], tuple[FloatArray, FloatArray, FloatArray]]


def solved(equations: Equations, y: FloatArray, parameter: float) -> Point:
    """Solution near ``y``, by Newton's iteration with steps that are halved until residuals fall.

    Raises
    ------
    ConvergenceError
        If it is not found.
    """
    residual, derivative, by_parameter = equations(y, parameter)
    size = float(np.linalg.norm(residual))
    for iteration in range(ITERATIONS):
        if not np.isfinite(size):
            break
        factor = linalg.lu_factor(derivative, overwrite_a=True, check_finite=False)
        if size <= TOLERANCE:
            return Point(y, -linalg.lu_solve(factor, by_parameter), iteration)
        step, share = -linalg.lu_solve(factor, residual), 1.0
        for _ in range(HALVINGS):
            tried = y + share * step
            residual, derivative, by_parameter = equations(tried, parameter)
            new = float(np.linalg.norm(residual))
            if new < (1.0 - 0.1 * share) * size:
                break
            share *= 0.5
        y, size = tried, new
    raise ConvergenceError(f"Newton's iteration ends at a residual of {size:.2g}")


def followed(
    equations: Equations, point: Point, start: float, end: float
) -> Iterator[tuple[float, Point]]:
    """Solutions on the way of the parameter from ``start``, where ``point`` is, to ``end``.

    The way is one step if that is found, else steps that are halved, and doubled again, each of
    which goes out along the tangent.

    Raises
    ------
    ConvergenceError
        If steps become too small.
    """
    step, at = end - start, start
    while at != end:
        step = min(step, end - at, key=abs)
        to = end if abs(end - at - step) < 1e-12 * abs(end - start) else at + step
        try:
            found = solved(equations, point.y + (to - at) * point.tangent, to)
        except ConvergenceError:
            step *= 0.5
            if abs(step) < LEAST:
                raise
        else:
            point, at = found, to
            step *= 2.0
            yield at, point
