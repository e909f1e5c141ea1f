"""Derivatives of a backbone by parameters of the structure.

Each level of a curve is differentiated implicitly (:mod:`skfem_joint.stepping.level_rates`), and so
are the mode and its inertia (:mod:`skfem_joint.analysis.mode_rates`). Frequency, damping and
amplitude follow by the chain rule from

    omega = sqrt(alpha / q),    zeta = D / (2 pi alpha q) + phi^T C phi / (2 omega),

with alpha less what a shift carries, if there is one (`Cycles.carried`), and the work D of a cycle,
by Masing's rule and its correction or along the cycle that was followed. The derivatives are at
fixed levels alpha. A measured curve is known over the amplitude: a level changes with the parameter
there, so that with the derivatives by the levels themselves

    d(omega) at a fixed amplitude x  =  d(omega) - d(omega)/d(ln alpha) dx / (dx/d(ln alpha)).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from typing import Any, cast

import numpy as np

from skfem_joint.analysis.cycles import Cycles
from skfem_joint.analysis.masing_cycles import SETTINGS as MASING
from skfem_joint.analysis.masing_cycles import between
from skfem_joint.analysis.opening_cycles import OpeningPath, lowest
from skfem_joint.arrays import FloatArray, IntArray, as_dense
from skfem_joint.errors import InputError
from skfem_joint.opening import OpeningContact
from skfem_joint.sensitivity import SystemSensitivity
from skfem_joint.stepping.level_rates import LevelRates, Rates
from skfem_joint.stepping.levels import Level
from skfem_joint.stepping.quasi_static import QuasiStatic
from skfem_joint.system import System
from skfem_joint.unknowns import congruent


@dataclass(frozen=True)
class BackboneSensitivity:
    """Derivatives of a `Backbone`, a column for each parameter, at fixed levels.

    A last column is that by the logarithm of all levels at once.

    Attributes
    ----------
    parameters : tuple of str
        Names of k parameters.
    amplitude, frequency, friction_damping, viscous_damping : ndarray, shape (levels, k + 1)
        Of the values of the curve of the same name.
    displacement : ndarray, shape (levels, points, k + 1)
        Of those of the named points, m.
    stuck_frequency : ndarray, shape (k + 1,)
        Hz.
    turning : ndarray of int, shape (levels,)
        Points that may be turning between sticking and slipping, at each level or in its cycle:
        where there are some the derivatives may be those to one side.
    """

    parameters: tuple[str, ...]
    amplitude: FloatArray
    frequency: FloatArray
    friction_damping: FloatArray
    viscous_damping: FloatArray
    displacement: FloatArray
    stuck_frequency: FloatArray
    turning: IntArray

    @property
    def damping_ratio(self) -> FloatArray:
        """Of the damping ratio by friction and viscous forces, (levels, k + 1)."""
        return self.friction_damping + self.viscous_damping

    def at_amplitude(self, values: FloatArray, amplitude: FloatArray) -> FloatArray:
        """Derivatives at a fixed amplitude, (levels, k), from those at fixed levels.

        Parameters
        ----------
        values : ndarray, shape (levels, k + 1)
            Such as ``frequency``.
        amplitude : ndarray, shape (levels, k + 1)
            Of the amplitude that is fixed: ``amplitude``, or ``displacement[:, point]``.
        """
        along = values[:, -1:] / amplitude[:, -1:]
        return np.asarray(values[:, :-1] - along * amplitude[:, :-1])


def in_unknowns(parameter: SystemSensitivity, T: Any) -> SystemSensitivity:
    """Same derivative in the unknowns q of u = T q."""
    K, C = (None if A is None else congruent(A, T) for A in (parameter.K, parameter.C))
    return replace(parameter, K=K, C=C)


def of_closed_system(
    parameters: Sequence[SystemSensitivity], system: System
) -> list[SystemSensitivity]:
    """Derivatives of `System.closed` of a system whose contact opens, in its unknowns."""
    contact = cast("OpeningContact", system.opening)
    T, closed = contact.closed_motions(), list[SystemSensitivity]()
    for parameter in parameters:
        part, K = parameter.opening, parameter.K
        if part is not None and part.stiffness is not None:
            springs = contact.with_springs(np.where(contact.force > 0.0, part.stiffness, 0.0))
            K = springs if K is None else K + springs
        closed.append(in_unknowns(replace(parameter, K=K, opening=None), T))
    return closed


def check_parameters(parameters: Sequence[SystemSensitivity], system: System) -> None:
    """InputError for derivatives whose shapes do not fit a system, or of a reduced system."""
    if parameters and isinstance(system.B, np.ndarray):
        raise InputError(
            "backbone: parameters: found a reduced system, must be a full or condensed one, among "
            "whose unknowns slips are"
        )
    n, m = system.n, system.w.size
    shapes = {"K": (n, n), "C": (n, n), "w": (m,), "stiffness": (m,)}
    if system.opening is not None:
        q = system.opening.gap.size
        shapes |= {"gap": (q,), "force": (q,), "opening.stiffness": (q,), "gain": (m, q)}
    for parameter in parameters:
        parts: dict[str, Any] = {f.name: getattr(parameter, f.name) for f in fields(parameter)}
        if parameter.opening is not None:
            own = {f.name: getattr(parameter.opening, f.name) for f in fields(parameter.opening)}
            own["opening.stiffness"] = own.pop("stiffness")
            parts |= own
        for name, shape in shapes.items():
            value = parts.get(name)
            if value is not None and value.shape != shape:
                raise InputError(
                    f"parameter {parameter.name}: {name}: found shape {value.shape}, must be "
                    f"{shape}, that of the system"
                )


def shift_rates(
    system: System, shift: float, parameters: Sequence[SystemSensitivity]
) -> FloatArray:
    """Derivatives of a shift that is a share of the mean square frequency, (k,)."""
    diagonal = system.K.diagonal()
    share = shift * np.sign(diagonal) / np.abs(diagonal).sum()
    return np.array([0.0 if p.K is None else share @ p.K.diagonal() for p in parameters])


class CycleRates:
    """Derivatives of what cycles of a force at rising levels give.

    Attributes
    ----------
    amplitude : ndarray, shape (levels, k + 1)
        Of the amplitude q of the mode, m kg^1/2, without the part by the change of the mode.
    displacement : ndarray, shape (levels, points, k + 1)
        Of the named points, m, with their signs.
    work : ndarray, shape (levels, k + 1)
        Of the work of friction in a cycle, J.
    turning : list of int
        Points that may turn, at each level.
    """

    def __init__(
        self,
        path: QuasiStatic | OpeningPath,
        force: FloatArray,
        found: Cycles,
        parameters: Sequence[SystemSensitivity],
        force_rates: FloatArray,
    ) -> None:
        solver = path.solver if isinstance(path, OpeningPath) else path
        self.system, self.turning = path.to.system, list[int]()
        points = as_dense(self.system.P).reshape(-1, force.size)
        looked_at = np.vstack([force, points]).T
        touch = path.touched() if isinstance(path, OpeningPath) else None
        if found.shift:
            rates = shift_rates(self.system, found.shift, parameters)
            parameters = [
                p if p.K is None else replace(p, K=p.K + rate * self.system.M)
                for p, rate in zip(parameters, rates.tolist(), strict=True)
            ]
        self.rates = LevelRates(solver, force, parameters, force_rates, looked_at, touch)
        if isinstance(path, OpeningPath):
            values, self.work = self._opening(path, found)
        else:
            values, self.work = self._masing(found)
        self.amplitude, self.displacement = values[:, 0], values[:, 1:]

    def _masing(self, found: Cycles) -> tuple[FloatArray, FloatArray]:
        """Of constant limits, see `skfem_joint.analysis.masing_cycles`."""
        system, work = self.system, list[FloatArray]()
        rest = Level(*np.zeros((1, system.n)), *np.zeros((2, system.B.shape[0])))
        walk, before = list[tuple[float, Level]](), rest
        for alpha, u, sigma in zip(found.level.tolist(), found.states, found.friction, strict=True):
            before = self._level(before, u, sigma)
            walk.append((alpha, before))
        rates = self.rates.follow(self.rates.rest(), rest, walk)
        ends = [(level, of_level) for (_, level), of_level in zip(walk, rates, strict=True)]
        work = [4.0 * self._work(*self.rates.slider(*end))[1] for end in ends]
        self.turning = self.rates.turning
        values = np.array([of_level.values for of_level in rates])
        of_work, followed = np.array(work), found.followed
        if not followed.size:
            return values, of_work
        halves = np.split(np.arange(len(found.loops)), followed.size)
        by_rule, ratios, of_ratios = np.zeros(followed.size), [], []
        for j, (k, half) in enumerate(zip(followed.tolist(), halves, strict=True)):
            slips = self.rates.slider(*ends[k])[0]
            by_rule[j] = 4.0 * self._work(slips, np.zeros((slips.size, 0)))[0]
            done, of_done = self._half_cycle(found, k, half, *ends[k])
            ratios.append(2.0 * done / by_rule[j])
            of_ratios.append((2.0 * of_done - ratios[-1] * of_work[k]) / by_rule[j])
        whole = found.work / between(found.level, followed, np.array(ratios))
        of_ratio = between(found.level, followed, np.array(of_ratios))
        ratio = between(found.level, followed, np.array(ratios))[:, np.newaxis]
        return values, of_work * ratio + whole[:, np.newaxis] * of_ratio

    def _half_cycle(
        self, found: Cycles, k: int, half: IntArray, before: Level, last: Rates
    ) -> tuple[float, FloatArray]:
        """Work of friction in the half cycle from a level, J, and its derivatives, (k + 1,)."""
        turns = np.linspace(1.0, -1.0, MASING.increments + 1)[1:]
        u, friction, at = before.u, found.friction[k], before
        walk = list[tuple[float, Level]]()
        for turn, j in zip(turns.tolist(), half.tolist(), strict=True):
            u = u + found.loops[j]
            if found.turned is not None:
                friction = friction + found.turned[j]
            at = self._level(at, u, friction)
            walk.append((turn * float(found.level[k]), at))
        rates = self.rates.follow(last, before, walk)
        self.turning[k] = max(self.turning[k], *self.rates.turning)
        work, of_work = 0.0, np.zeros(last.values.shape[1])
        a, of_a = self.rates.slider(before, last)
        for (_, level), of_level in zip(walk, rates, strict=True):
            b, of_b = self.rates.slider(level, of_level)
            done, of_done = self._work(b - a, of_b - of_a)
            work, of_work, a, of_a = work + done, of_work + of_done, b, of_b
        return work, of_work

    def _level(self, before: Level, u: FloatArray, sigma: FloatArray) -> Level:
        """Level with the friction of its slip; ``sigma`` (rows,) is that of points on springs."""
        system = self.system
        slip = np.asarray(system.B @ u)
        step, rows = slip - before.slip, system.on_rows(system.w)
        size = system.on_rows(system.slip_norm(step))
        along = np.divide(step, size, out=np.zeros_like(step), where=size > 0.0)
        sprung = system.on_rows(system.sprung)
        return Level(u, rows * np.where(sprung, sigma, along), slip)

    def _work(self, slips: FloatArray, of_slips: FloatArray) -> tuple[float, FloatArray]:
        """Sum of w |slip| over the points with constant limits, J, and its derivatives, (k,)."""
        system, given = self.system, self.rates.given
        size = system.slip_norm(slips)
        rows = system.on_rows(size)
        along = np.divide(slips, rows, out=np.zeros_like(rows), where=rows > 0.0)
        of_size = system.by_point((along[:, np.newaxis] * of_slips).T)
        own = given.T[: of_size.shape[0]]
        return float(system.w @ size), np.asarray(own @ size + of_size @ system.w)

    def _opening(self, path: OpeningPath, found: Cycles) -> tuple[FloatArray, FloatArray]:
        """Of contact that opens, see `skfem_joint.analysis.opening_cycles`."""
        before, last = path.solver.rest(), self.rates.rest()
        values, work = list[FloatArray](), list[FloatArray]()
        for walks in path.walked[: found.level.size]:
            for walk in walks:
                rates = self.rates.follow(last, before, walk)
                chain = [(before, last), *zip((level for _, level in walk), rates, strict=True)]
                before, last = chain[-1]
            low = rates[lowest(walks[-1])]
            values.append(0.5 * (last.values - low.values))
            work.append(self._work_around(chain))
            self.turning.append(max(self.rates.turning))
        return np.array(values), np.array(work)

    def _work_around(self, chain: list[tuple[Level, Rates]]) -> FloatArray:
        """Derivatives of the work of a cycle, (k + 1,): of mean limits times slips."""
        system, total = self.system, np.zeros(chain[0][1].values.shape[1])
        for (a, da), (b, db) in pairwise(chain):
            step = self.rates.slips(b) - self.rates.slips(a)
            size = system.slip_norm(step)
            rows = system.on_rows(size)
            along = np.divide(step, rows, out=np.zeros_like(rows), where=rows > 0.0)
            of_size = system.by_point((along[:, np.newaxis] * (db.slip - da.slip)).T)
            mean = 0.5 * (np.asarray(a.limits) + np.asarray(b.limits))
            total += of_size @ mean + 0.5 * (da.limits + db.limits).T @ size
        return total


def backbone_sensitivity(
    system: System,
    found: Cycles,
    cycles: CycleRates,
    parameters: Sequence[SystemSensitivity],
    mode: tuple[FloatArray, FloatArray, FloatArray],
) -> BackboneSensitivity:
    """Derivatives of a curve from those of its cycles and of its mode.

    Parameters
    ----------
    system : System
        In whose unknowns all else is.
    found : Cycles
        Cycles of the curve.
    cycles : CycleRates
        Their derivatives.
    parameters : sequence of SystemSensitivity
    mode : tuple of ndarray
        Shape, (n,), its derivatives, (n, k), and those of its frequency, (k,), Hz.
    """
    shape, of_shape, of_stuck = mode
    of_shape = np.column_stack([of_shape, np.zeros(system.n)])
    force, C = np.asarray(system.M @ shape), system.C
    q = found.states @ force
    level = found.carried(q)
    of_q = cycles.amplitude + found.states @ (system.M @ of_shape)
    of_level = -found.shift * of_q
    of_level[:, -1] += found.level  # by the logarithm
    of_level[:, :-1] -= np.outer(q, shift_rates(system, found.shift, parameters))
    of_level /= level[:, np.newaxis]
    relative = of_q / q[:, np.newaxis]
    omega = np.sqrt(level / q)[:, np.newaxis]
    of_omega = 0.5 * omega * (of_level - relative)
    energy = (2.0 * np.pi * level * q)[:, np.newaxis]
    friction = cycles.work / energy
    friction -= (found.work[:, np.newaxis] / energy) * (of_level + relative)
    of_c = 2.0 * (C @ shape) @ of_shape
    of_c[:-1] += [0.0 if p.C is None else shape @ (p.C @ shape) for p in parameters]
    viscous = of_c / (2.0 * omega) - float(shape @ (C @ shape)) * of_omega / (2.0 * omega**2)
    signs = np.sign(np.asarray((system.P @ found.states.T).T))
    return BackboneSensitivity(
        parameters=tuple(parameter.name for parameter in parameters),
        amplitude=of_q,
        frequency=of_omega / (2.0 * np.pi),
        friction_damping=friction,
        viscous_damping=viscous,
        displacement=signs[:, :, np.newaxis] * cycles.displacement,
        stuck_frequency=np.append(of_stuck, 0.0),
        turning=np.array(cycles.turning, dtype=np.intp),
    )
