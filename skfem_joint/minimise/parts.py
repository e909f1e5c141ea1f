"""Parts of a dense contact problem: some of its points with their unknowns, minimised alone."""

# mypy: allow-untyped-calls

from __future__ import annotations

from typing import Any

import numpy as np
from scipy import sparse

from skfem_joint.ground.arrays import BoolArray, FloatArray
from skfem_joint.minimise.contact_newton import ContactNewton
from skfem_joint.minimise.limits import Hinges
from skfem_joint.minimise.problem import ContactPoints, Minimum, Pressed, PressurePoints
from skfem_joint.system.unknowns import selection


class PartOfContact:
    """Some unknowns of a problem, and the points whose unknowns they are.

    Parameters
    ----------
    points : ContactPoints
        Of the whole problem.
    kept : ndarray of bool, shape (n,)
        Its unknowns that are in the part; of each point all are, or none.

    Attributes
    ----------
    unknowns, others : ndarray of int
        Unknowns in the part, and all others.
    frictions, rows, pressures : ndarray of int
        Friction points, their slip rows, and pressure points in the part.
    points : ContactPoints
        The points in the part's unknowns.
    """

    def __init__(self, points: ContactPoints, kept: BoolArray) -> None:
        k, rows = np.flatnonzero(kept), points.unknowns
        self.unknowns, self.others = k, np.flatnonzero(~kept)
        self.frictions = f = np.flatnonzero(kept[rows[points.first_row[:-1]]])
        self.rows = np.flatnonzero(kept[rows])
        self.pressures, normal = np.zeros(0, dtype=np.intp), None
        if points.normal is not None:
            places = sparse.csr_array(points.normal.N).indices
            self.pressures = c = np.flatnonzero(kept[places])
            normal = PressurePoints(
                selection(np.searchsorted(k, places[c]), k.size),
                sparse.csr_array(sparse.csr_array(points.normal.gain)[f][:, c]),
                points.normal.stiffness[c],
            )
        self.points = ContactPoints(
            selection(np.searchsorted(k, rows[self.rows]), k.size),
            points.directions[f],
            points.w[f],
            points.beta[f],
            None if points.flexible is None else points.flexible[f],
            normal,
        )

    def minimise_of(
        self,
        problem: ContactNewton,
        right: FloatArray,
        start: FloatArray | None,
        tolerance: float,
        beta: FloatArray | None,
        force: float,
        offset: FloatArray | None,
        pressed: Pressed | None,
    ) -> Minimum:
        """`ContactNewton.minimise_beside` of a problem of the part.

        ``right`` is that of the part, the other arguments are those of all points.
        """
        f = self.frictions
        return problem.minimise_beside(
            right,
            None if start is None else start[self.unknowns],
            tolerance,
            None if beta is None else beta[f],
            force,
            None if offset is None else offset[self.rows],
            None if pressed is None else self._pressed(pressed),
        )

    def _pressed(self, pressed: Pressed) -> Pressed:
        """What the part's points are given where contact opens."""
        c, f = self.pressures, self.frictions
        hinges, gain = pressed.hinges, np.asarray(pressed.gain, dtype=float)
        if hinges is not None:
            *of_points, bias = hinges
            arrays: list[Any] = [*(x[f] for x in of_points), bias[self.rows]]
            hinges = Hinges(*arrays)
        gain = gain[c] if gain.ndim else gain
        return Pressed(pressed.bound[c], pressed.given[f], gain, hinges)
