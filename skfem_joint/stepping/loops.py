"""Hysteresis loops of loads and joints in a quasi-static run.

The loop of a load is its force over the displacement that it works on. The loop of a joint is the
friction force that it transmits over its slip, both along the direction in which it slips most:

    Q = e . sum_p q_p,    s = e . sum_p w_p s_p / sum_p w_p,

with the friction forces q_p (N), slips s_p (m) and friction limits w_p (N) of its points. The unit
vector e points along the mean slip where that is largest, or along the largest force if nothing
slips. Components are those of the slip rows: the two of a plate in plan are x and y, those of a
face are the same at all points where it is flat. If a joint has points with two directions of slip,
points that supports leave only one of them count in its energy but not in its force and slip.

A reduced model knows the force of a joint if its basis has the sliding of the joint, as those made
for quasi-static runs have (:mod:`skfem_joint.reduction.joint_slides`).

Springs in series with friction are in the slip, and what they store is not in the energy.

The area of a joint's loop is its friction energy if all its points slip alike. Else the energy is
the sum over points of force times slip, which is exact, and the area is not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from skfem_joint.ground.arrays import FloatArray, as_dense
from skfem_joint.ground.plain_values import Tabular, spread
from skfem_joint.system.system import System

#: Ways below this share of the largest are round-off.
ROUND_OFF = 1e-9


@dataclass(frozen=True, repr=False)
class Loops(Tabular):
    """Force over displacement of each load, and over slip of each joint, at every level of a run.

    Columns are ordered as ``system.loads`` and ``system.contact.joints``.

    Attributes
    ----------
    times : ndarray, shape (levels,)
        Time of the loads, s, the start included.
    load_force : ndarray, shape (levels, loads)
        Force of each load, N.
    load_displacement : ndarray, shape (levels, loads)
        Displacement that each load works on, m.
    force : ndarray, shape (levels, joints)
        Friction force that each joint transmits along its direction, N.
    slip : ndarray, shape (levels, joints)
        Mean slip of its points along that direction, weighted by their friction limits, m.
    work : ndarray, shape (levels, joints)
        Energy that friction has dissipated in each joint, J: over all points, the mean force of a
        step times the change of slip.
    direction : ndarray, shape (joints, 2)
        Unit vector along each joint's largest mean slip, by components of slip rows.
    covered : ndarray, shape (joints,)
        Share of each joint's friction limit whose points are in its force and slip.
    cycle_steps : int, optional
        Levels in a cycle; None where the loads do not repeat.
    """

    times: FloatArray
    load_force: FloatArray
    load_displacement: FloatArray
    force: FloatArray
    slip: FloatArray
    work: FloatArray
    direction: FloatArray
    covered: FloatArray
    cycle_steps: int | None = None

    @property
    def table(self) -> dict[str, FloatArray]:
        """Columns with a row for each level; loads and joints by their numbers."""
        return {
            "time_s": self.times,
            **spread("load_{}_force_N", self.load_force),
            **spread("load_{}_displacement_m", self.load_displacement),
            **spread("joint_{}_force_N", self.force),
            **spread("joint_{}_mean_slip_m", self.slip),
            **spread("joint_{}_friction_energy_J", self.work),
        }

    def __repr__(self) -> str:
        loads, joints = self.load_force.shape[1], self.force.shape[1]
        return f"Loops of {loads} loads and {joints} joints at {self.times.size} levels"

    @property
    def last(self) -> slice:
        """Levels of the last complete cycle with its start, or of the whole run without one."""
        steps, done = self.cycle_steps, self.times.size - 1
        if steps is None or done < steps:
            return slice(None)
        end = done // steps * steps
        return slice(end - steps, end + 1)

    @property
    def opening(self) -> float | None:
        """How far the last cycle is from being closed; None without a complete cycle.

        Largest difference between its end and its start, over peak to peak, of the loads'
        displacements and of the joints' slips that are no round-off.
        """
        if self.cycle_steps is None or self.times.size <= self.cycle_steps:
            return None
        ways = np.hstack([self.load_displacement, self.slip])[self.last]
        whole = np.ptp(ways, axis=0)
        moving = whole > ROUND_OFF * whole.max(initial=0.0)
        return float((np.abs(ways[-1] - ways[0])[moving] / whole[moving]).max(initial=0.0))

    @property
    def secant_stiffness(self) -> FloatArray:
        """Force over slip of each joint, N/m, (joints,); not a number where nothing slips.

        Both from peak to peak, in the last cycle, or in the whole run without cycles.
        """
        return _secant(self.force[self.last], self.slip[self.last])

    @property
    def load_secant_stiffness(self) -> FloatArray:
        """The same of each load over the displacement that it works on, N/m, (loads,)."""
        return _secant(self.load_force[self.last], self.load_displacement[self.last])

    @property
    def area(self) -> FloatArray:
        """Work of each joint's force on its mean slip in the same levels, J, (joints,)."""
        force, slip = self.force[self.last], self.slip[self.last]
        return np.asarray(np.trapezoid(force, slip, axis=0))

    @property
    def energy(self) -> FloatArray:
        """Friction energy of each joint in the same levels, J, (joints,)."""
        work = self.work[self.last]
        return np.asarray(work[-1] - work[0])


def _secant(force: FloatArray, way: FloatArray) -> FloatArray:
    """Peak to peak of forces over peak to peak of ways, by column; not a number without a way."""
    whole = np.ptp(way, axis=0)
    known = whole > ROUND_OFF * whole.max(initial=0.0)
    return np.where(known, np.ptp(force, axis=0) / np.where(known, whole, 1.0), np.nan)


class LoopRecorder:
    """Loops as a run goes on.

    Parameters
    ----------
    system : System
        In whose unknowns and slip rows levels are given.
    """

    def __init__(self, system: System) -> None:
        self.system = system
        shares = as_dense(system.contact.J)
        mixed, weights = (shares > 0.0) & system.contact.rubs, system.contact.point_weights
        two = (mixed & (system.contact.directions == 2)).any(axis=1)
        # Of joints with points of two directions, those with one have no component.
        counted = shares * np.where(two[:, np.newaxis], system.contact.directions == 2, True)
        weight = counted * weights
        limits, whole = weight.sum(axis=1), (shares * weights).sum(axis=1)
        self.covered = np.where(whole > 0.0, limits / np.where(whole > 0.0, whole, 1.0), 1.0)
        mean = weight / np.where(limits > 0.0, limits, 1.0)[:, np.newaxis]
        row = system.contact.first_row[:-1]
        second = np.flatnonzero(system.contact.directions == 2)
        rows = system.contact.B.shape[0]

        def components(values: FloatArray) -> sparse.csr_array:
            """First components of all joints, then second ones, from slip rows."""
            made = np.zeros((2, len(values), rows))
            made[0][:, row] = values
            made[1][:, row[second] + 1] = values[:, second]
            return sparse.csr_array(made.reshape(2 * len(values), rows))

        self._force, self._slip = components(counted), components(mean)
        self._vectors = system.load_vectors()
        self.rows: list[tuple[FloatArray, ...]] = []

    def add(
        self,
        amplitudes: FloatArray,
        u: FloatArray,
        friction: FloatArray,
        slip: FloatArray,
        work: FloatArray,
    ) -> None:
        """Add a level: amplitudes (loads,), N, and its state; ``work`` (m,), J, of each point."""
        self.rows.append(
            (
                amplitudes.copy(),
                u @ self._vectors,
                self._force @ friction,
                self._slip @ slip,
                np.asarray(self.system.contact.J @ work),
            )
        )

    def finish(self, step: float, cycle_steps: int | None) -> Loops:
        """Loops of the levels so far, a ``step`` (s) apart."""
        loads, moved, forces, slips, work = (
            np.array(column) for column in zip(*self.rows, strict=True)
        )
        force, slip = (x.reshape(len(x), 2, x.shape[1] // 2) for x in (forces, slips))
        direction = _directions(force, slip)
        return Loops(
            times=step * np.arange(len(self.rows), dtype=np.float64),
            load_force=loads,
            load_displacement=moved,
            force=np.einsum("tcj,jc->tj", force, direction),
            slip=np.einsum("tcj,jc->tj", slip, direction),
            work=work,
            direction=direction,
            covered=self.covered,
            cycle_steps=cycle_steps,
        )


def _directions(force: FloatArray, slip: FloatArray) -> FloatArray:
    """Unit vectors (joints, 2) along the largest slips, or forces, of (levels, 2, joints)."""
    found = np.zeros((slip.shape[2], 2))
    found[:, 0] = 1.0
    for j in range(len(found)):
        for x in (slip[:, :, j], force[:, :, j]):
            size = np.linalg.norm(x, axis=1)
            if size.max() > 0.0:
                unit = x[size.argmax()] / size.max()
                # Loops of different models have the same sense: the largest component is positive.
                found[j] = unit * np.sign(unit[np.abs(unit).argmax()])
                break
    return found
