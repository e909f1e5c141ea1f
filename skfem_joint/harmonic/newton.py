"""Newton's iteration on scaled residuals, and continuation along a parameter."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
from scipy import linalg

from skfem_joint.ground.arrays import FloatArray
from skfem_joint.ground.errors import ConvergenceError

#: Norm of a residual of unknowns of size 1 that ends the iteration: 0.02 % of a damping ratio of
#: 0.25 %. States of points change one by one where it is smaller, which takes as long again.
TOLERANCE = 1e-6
#: Norm that will do where the iteration ends: points that just begin to slip between two samples
#: may leave so much.
ENOUGH = 1e-5
#: Most iterations, and halvings of a step.
ITERATIONS, HALVINGS = 40, 8


class Solution(NamedTuple):
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


#: Residual, with its derivatives by the unknowns and the parameter, all scaled to size 1; the last
#: argument is whether the derivatives are wanted, which else are empty.
Equations = Callable[[FloatArray, float, bool], tuple[FloatArray, FloatArray, FloatArray]]


def solved(equations: Equations, y: FloatArray, parameter: float) -> Solution:
    """Solution near ``y``, by Newton's iteration with steps that are halved until residuals fall.

    Raises
    ------
    ConvergenceError
        If it is not found.
    """
    share = 1.0
    for iteration in range(ITERATIONS):
        residual, derivative, by_parameter = equations(y, parameter, True)
        size = float(np.linalg.norm(residual))
        if not np.isfinite(size):
            break
        factor = linalg.lu_factor(derivative, overwrite_a=True, check_finite=False)
        if size <= TOLERANCE or (size <= ENOUGH and iteration == ITERATIONS - 1):
            return Solution(y, -linalg.lu_solve(factor, by_parameter), iteration)
        step, share = -linalg.lu_solve(factor, residual), min(1.0, 2.0 * share)
        for _ in range(HALVINGS):
            tried = float(np.linalg.norm(equations(y + share * step, parameter, False)[0]))
            if tried < (1.0 - 0.1 * share) * size:
                break
            share *= 0.5
        y = y + share * step
    raise ConvergenceError(f"Newton's iteration ends at a residual of {size:.2g}")


def followed(
    equations: Equations,
    point: Solution,
    start: float,
    end: float,
    least: float,
    near: Callable[[FloatArray, FloatArray], bool] = lambda *_: True,
) -> Iterator[tuple[float, Solution]]:
    """Solutions on the way of the parameter from ``start``, where ``point`` is, to ``end``.

    The way is one step if that is found, else steps that are halved, down to ``least``, and doubled
    again, each of which goes out along the tangent. ``near`` tells whether a solution goes on from
    the one before.

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
            if not near(found.y, point.y):
                raise ConvergenceError("the iteration goes over to another mode")
        except ConvergenceError:
            step *= 0.5
            if abs(step) < least:
                raise
        else:
            point, at = found, to
            step *= 2.0
            yield at, point
