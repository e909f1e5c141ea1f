"""The exact line search of both Newton methods on velocities.

Along a direction d the objective has the derivative

    linear + length * quadratic + d/dlength sum w psi(|B (v + length d)|),

which rises with the length. Its root is bracketed and computed by regula falsi with a margin. Only
the derivative is used, so that the round-off of the objective itself sets no limit.
"""

# mypy: allow-untyped-defs, allow-untyped-calls, allow-untyped-decorators

from __future__ import annotations

from math import inf

from skfem_joint.ground.compiling import compiled_inside

#: Largest number of lengths tried; each cuts the bracket by at least the margin.
TRIALS = 60
#: Share of its first value to which the derivative must fall at a length short of the minimum.
SHORT = 0.5
#: The same beyond the minimum.
BEYOND = 0.05


def friction_slope(line, length):
    """Derivative of sum w psi along a line at a length, W; each method has its own kind of line."""
    raise NotImplementedError


@compiled_inside
def line_search(line, slope_0, linear, quadratic):
    """Length along a direction at which the objective is nearly least, and the evaluations.

    ``slope_0`` is the derivative at length 0. The full step is accepted if it is short of the
    minimum. Third comes whether the last evaluation was at the length that is returned.
    """
    if not slope_0 < 0.0:
        return 1.0, 0, False  # no descent left but round-off: the full step
    low, slope_low, high, slope_high, length = 0.0, slope_0, inf, inf, 1.0
    for evaluations in range(1, TRIALS + 1):
        slope = linear + length * quadratic + friction_slope(line, length)
        if slope <= 0.0:
            accepted = length == 1.0 or slope >= SHORT * slope_0
        else:
            accepted = slope <= -BEYOND * slope_0
        if accepted:
            return length, evaluations, True
        if slope > 0.0:
            high, slope_high = length, slope
        else:
            low, slope_low = length, slope
        # The derivative at `low` is negative and that at `high` positive.
        length = low - slope_low * (high - low) / (slope_high - slope_low)
        margin = 0.05 * (high - low)  # no length is tried so close to the ends of the bracket
        length = min(max(length, low + margin), high - margin)
    return low, TRIALS, False
