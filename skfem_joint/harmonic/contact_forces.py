"""Contact forces of a periodic motion by harmonics, and their derivatives.

Forces are those beyond linear contact, of points that are pressed at rest: springs in series with
friction whose sliders stick, and elastic pressure points that stay pressed.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy import sparse

from skfem_joint.ground.arrays import BoolArray, FloatArray, IntArray, as_dense
from skfem_joint.harmonic.contact_loop import FrictionPoints, friction, weighted
from skfem_joint.harmonic.series import FourierSeries
from skfem_joint.system.contacts import Contact


class Sampled(NamedTuple):
    """Contact in a period.

    Attributes
    ----------
    force : ndarray, shape (nh, n)
        Coefficients of the forces on the unknowns beyond linear contact, N.
    derivative : ndarray, shape (nh, n, nh, n), or None
        Of each coefficient by each one of the motion; where it walks, by its way in the last place
        of nh + 1.
    slip : ndarray, shape (rows, nh)
        Coefficients of the slip, m.
    moved, friction : ndarray, shape (rows, samples)
        Slip, m, and friction, N, at each sample.
    limits : ndarray, shape (m, samples)
    moves : ndarray of bool, shape (m,)
        Whether each point slips.
    opened : ndarray of bool, shape (q,)
        Whether each pressure point that is pressed at rest opens.
    restless : float
        Largest relative change of friction in the last period where it is not periodic yet.
    """

    force: FloatArray
    derivative: FloatArray | None
    slip: FloatArray
    moved: FloatArray
    friction: FloatArray
    limits: FloatArray
    moves: BoolArray
    opened: BoolArray
    restless: float


@dataclass(frozen=True)
class ContactForces:
    """Contact in the unknowns q of u = Phi q.

    Attributes
    ----------
    rows : ndarray, shape (rows + q, n)
        Slips of the points with friction, then approaches.
    points : FrictionPoints
    given : ndarray, shape (m,)
    directions : ndarray of int, shape (m,)
    gain : sparse array, shape (m, q)
    gap, rest, stiffness : ndarray, shape (q,)
        Of the pressure points, as `NormalPart` has them.
    """

    rows: FloatArray
    points: FrictionPoints
    given: FloatArray
    directions: IntArray
    gain: sparse.csr_array
    gap: FloatArray
    rest: FloatArray
    stiffness: FloatArray

    @classmethod
    def of(cls, contact: Contact, springs: FloatArray, Phi: FloatArray) -> ContactForces:
        """From a contact whose points (m,) have ``springs``, N/m."""
        rubs, normal = contact.rubs, contact.normal
        gain = sparse.csr_array(sparse.csr_array(contact.gain)[np.flatnonzero(rubs)])
        gain.eliminate_zeros()
        directions = np.asarray(contact.directions)[rubs]
        B = as_dense(contact.B)[contact.on_rows(rubs)] @ Phi
        blocks = directions * (directions + np.diff(gain.indptr))
        first_row, first_block = (np.concatenate([[0], np.cumsum(x)]) for x in (directions, blocks))
        points = FrictionPoints(
            first_row=first_row.astype(np.intp),
            first_gain=gain.indptr.astype(np.intp),
            first_block=first_block.astype(np.intp),
            stiffness=np.ascontiguousarray(springs[rubs]),
            linear=np.where(contact.w > 0.0, springs, 0.0)[rubs],
            pressure=gain.indices.astype(np.intp),
            gain=gain.data,
        )
        rows = np.ascontiguousarray(np.vstack([B, as_dense(normal.N @ Phi)]))
        at_rest = normal.gap, normal.force, normal.stiffness
        return cls(rows, points, contact.given[rubs], directions, gain, *at_rest)

    @cached_property
    def columns(self) -> tuple[IntArray, IntArray, IntArray]:
        """Row, column and point of each block of friction, as numbers of ``rows`` and points."""
        left, right, of = [], [], []
        slips = self.points.first_row[-1]
        for i, directions in enumerate(self.directions.tolist()):
            own = self.points.first_row[i] + np.arange(directions)
            gains = self.points.pressure[self.points.first_gain[i] : self.points.first_gain[i + 1]]
            columns = np.concatenate([own, slips + gains])
            left.append(np.repeat(own, columns.size))
            right.append(np.tile(columns, directions))
            of.append(np.full(directions * columns.size, i))
        none = [np.zeros(0, np.intp)]
        first, second, third = (np.concatenate([*none, *x]) for x in (left, right, of))
        return first, second, third

    def sampled(
        self, series: FourierSeries, q: FloatArray, tangents: bool, way: FloatArray | None = None
    ) -> Sampled:
        """Forces of a motion with coefficients ``q``, (nh, n).

        ``way``, (n,), is what it goes on in a period beside, where nothing comes closer.
        """
        coefficients = self.rows @ q.T
        values = coefficients @ series.basis.T
        slips = int(self.points.first_row[-1])
        slip, approach = values[:slips], values[slips:]
        k, pressed = self.stiffness[:, np.newaxis], self.rest > 0.0
        over = approach - self.gap[:, np.newaxis]
        normal = np.maximum(self.rest[:, np.newaxis] + k * over, 0.0)
        slopes = np.where(normal > 0.0, k, 0.0)
        linear = np.where(pressed, self.stiffness, 0.0)[:, np.newaxis]
        limits = np.asarray(self.gain @ normal) + self.given[:, np.newaxis]
        beyond = np.empty_like(values)
        beyond[slips:] = normal - self.rest[:, np.newaxis] - linear * approach
        # A point that stays pressed is linear to the last bit.
        beyond[slips:][(slopes == linear).all(axis=1)] = 0.0
        nh, wide, walked = series.size, series.size + (way is not None), np.zeros(slips)
        basis = np.zeros((len(series.basis) + 1, -(-wide // 8) * 8))
        basis[:, :nh] = np.vstack([series.basis, series.basis[-1:]])
        if way is not None:
            walked = self.rows[:slips] @ way
            basis[:, nh] = np.append(np.arange(len(basis) - 1.0), -1.0) / (len(basis) - 1.0)
        columns, last = basis.shape[1], int(self.points.first_block[-1])
        width = 2 + int(np.diff(self.points.first_gain).max(initial=0))
        moves = np.zeros(self.given.size, np.bool_)
        blocks = np.empty((last if tangents else 0, nh, columns))
        given = slip, limits, slopes, walked, basis, series.projection, series.odd, tangents
        results = beyond[:slips], blocks, moves, np.empty((2, width, columns))
        restless = friction(self.points, *given, *results)
        force = (beyond @ series.projection).T @ self.rows
        derivative = None
        if tangents:
            left, right, of = self.columns
            used = np.flatnonzero(moves[of])
            bent = np.flatnonzero((slopes != linear).any(axis=1))
            more = ((slopes - linear)[bent] @ series.products).reshape(-1, nh, nh)
            more = np.pad(more, ((0, 0), (0, 0), (0, wide - nh)))
            derivative = self._assembled(
                np.concatenate([left[used], slips + bent]),
                np.concatenate([right[used], slips + bent]),
                np.concatenate([blocks[used, :, :wide], more]),
            )
        opened = pressed & (normal == 0.0).any(axis=1)
        held = np.repeat(self.points.linear, self.directions)[:, np.newaxis]
        whole, of_slips = beyond[:slips] + held * slip, coefficients[:slips]
        return Sampled(force, derivative, of_slips, slip, whole, limits, moves, opened, restless)

    def _assembled(self, left: IntArray, right: IntArray, blocks: FloatArray) -> FloatArray:
        """Derivative in the unknowns, from blocks of one row by another, sorted by the first."""
        n, (_, nh, wide) = self.rows.shape[1], blocks.shape
        derivative = np.empty((nh, n, wide, n))
        first = np.flatnonzero(np.diff(left, prepend=-1))
        out, ends = np.ascontiguousarray(self.rows[left[first]].T), np.append(first, left.size)
        sums = np.empty((first.size, wide, n))
        for a in range(nh):  # one coefficient at a time keeps the products in the cache
            weighted(blocks, a, ends, right, self.rows, sums)
            np.matmul(out, sums.reshape(first.size, wide * n), out=derivative[a].reshape(n, -1))
        return derivative
