"""Height and place of a peak between samples: the vertex of a parabola through three of them."""

from __future__ import annotations

import numpy as np

from skfem_joint.ground.arrays import FloatArray


def parabola_vertex(x: FloatArray, y: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Position and value of the vertex of the parabola through three points.

    With the divided differences s1, s2 of the two intervals the curvature is
    ``(s2 - s1) / (x2 - x0)`` and the slope at the middle point ``s1 + curvature (x1 - x0)``.

    Parameters
    ----------
    x, y : ndarray, shape (3, ...)
        The points, x rising along the first axis; parabolas in further axes are independent.

    Returns
    -------
    position, value : ndarray, shape (...)
        Of the middle point where the three points lie on a line.
    """
    first, second = np.diff(y, axis=0) / np.diff(x, axis=0)
    curvature = np.asarray((second - first) / (x[2] - x[0]))
    slope = first + curvature * (x[1] - x[0])
    shift = np.zeros_like(curvature)
    np.divide(-0.5 * slope, curvature, out=shift, where=curvature != 0.0)
    return x[1] + shift, y[1] + 0.5 * slope * shift
