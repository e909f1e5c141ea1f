"""Contact of a bar pressed on a rigid base: nodal normal forces from pressure.

Two lumpings of the pressure p over the contact nodes (free nodes of the joint's elements):

``equal``
    The paper's: the joint's total normal force divided equally among its free nodes, the free
    end included. First order in the element size.
``consistent``
    Integral of p w phi: each node carries what its shape function carries. Second order, so that
    ten elements do what the equal forces need a hundred for.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skfem_joint.errors import InputError
from skfem_joint.forms import line_load

FloatArray = NDArray[np.float64]

#: How a pressure is turned into nodal normal forces.
NORMAL_FORCES = ("consistent", "equal")


@dataclass(frozen=True)
class PressureTable:
    """Pressure that varies linearly between positions along the bar.

    Attributes
    ----------
    positions : tuple of float
        Increasing positions along the bar, m.
    values : tuple of float
        Pressures there, Pa.
    """

    positions: tuple[float, ...]
    values: tuple[float, ...]

    def __post_init__(self) -> None:
        positions, values = np.asarray(self.positions), np.asarray(self.values)
        if positions.size != values.size or positions.size < 2:
            raise InputError(
                f"pressure: found {positions.size} positions and {values.size} values, "
                "must be as many of each and at least two"
            )
        if np.any(np.diff(positions) <= 0.0) or not np.all(np.isfinite(positions)):
            raise InputError("pressure.positions: must be finite and increasing")
        if np.any(values < 0.0) or not np.all(np.isfinite(values)):
            raise InputError("pressure.values: must be finite and not negative")

    def __call__(self, x: FloatArray) -> FloatArray:
        """Pressure at the positions ``x`` (m), Pa; constant beyond the ends."""
        return np.interp(x, self.positions, self.values)


def nodal_normal_forces(
    basis: Any,
    elements: NDArray[np.intp],
    free_nodes: NDArray[np.intp],
    pressure: float | PressureTable,
    width: FloatArray,
    kind: str,
) -> FloatArray:
    """Normal force on each contact node of a joint.

    Parameters
    ----------
    basis : skfem.Basis
        Basis of linear line elements whose coordinate is the position along the bar, m.
    elements : ndarray of int
        Elements of the joint.
    free_nodes : ndarray of int, shape (m,)
        Contact nodes that are not supported.
    pressure : float or PressureTable
        Clamping pressure, Pa.
    width : ndarray, shape (all elements,)
        Width of the bar, m.
    kind : {"consistent", "equal"}

    Returns
    -------
    ndarray, shape (m,)
        Normal forces, N.
    """
    from skfem import ElementLineP0

    region = basis.with_elements(elements)
    x = region.global_coordinates()[0]
    p = pressure(x) if isinstance(pressure, PressureTable) else np.full_like(x, pressure)
    width_field = basis.with_element(ElementLineP0()).with_elements(elements).interpolate(width)
    per_node = np.asarray(line_load().assemble(region, force_per_length=p * width_field))
    if kind == "consistent":
        return per_node[free_nodes]
    if kind == "equal":
        if free_nodes.size == 0:
            return np.zeros(0)
        return np.full(free_nodes.size, per_node.sum() / free_nodes.size)
    raise InputError(f"normal_force: found {kind!r}, must be one of {', '.join(NORMAL_FORCES)}")
