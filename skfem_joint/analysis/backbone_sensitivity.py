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
from typing import Any, cast

import numpy as np

from skfem_joint.analysis.cycles import Cycles
from skfem_joint.analysis.masing_cycles import SETTINGS as MASING
from skfem_joint.analysis.masing_cycles import between
from skfem_joint.analysis.opening_cycles import OpeningPath, lowest
from skfem_joint.arrays import FloatArray, IntArray, as_dense
from skfem_joint.errors import InputError
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
    contact = system.contact.normal
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
    if parameters and isinstance(system.contact.B, np.ndarray):
        raise InputError(
            "backbone: parameters: found a reduced system, must be a full or condensed one, among "
            "whose unknowns slips are"
        )
    n, m = system.n, system.contact.w.size
    shapes = {"K": (n, n), "C": (n, n), "w": (m,), "stiffness": (m,)}
    if system.contact.opens:
        q = system.contact.normal.gap.size
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
    shift : ndarray, shape (k,)
        Of the shift of the stiffness, 1/s2, see `Cycles.shift`.
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
        self.shift = np.zeros(len(parameters))
        if found.shift:
            self.shift = shift_rates(self.system, found.shift, parameters)
            parameters = [
                p if p.K is None else replace(p, K=p.K + rate * self.system.M)
                for p, rate in zip(parameters, self.shift.tolist(), strict=True)
            ]
        self.rates = LevelRates(solver, force, parameters, force_rates, looked_at, touch)
        if isinstance(path, OpeningPath):
            values, self.work = self._opening(path, found)
        else:
            values, self.work = self._masing(found)
        self.amplitude, self.displacement = values[:, 0], values[:, 1:]

    def _masing(self, found: Cycles) -> tuple[FloatArray, FloatArray]:
        """Of constant limits, see `skfem_joint.analysis.masing_cycles`."""
        rest = Level(*np.zeros((1, self.system.n)), *np.zeros((2, self.system.contact.B.shape[0])))
        levels = self._levels(found.states, found.friction)
        rates = self.rates.follow(
            self.rates.rest(), rest, [*zip(found.level.tolist(), levels, strict=True)]
        )
        slips, of_slips = self.rates.sliders(levels, rates)
        work, of_work = (4.0 * x for x in self._work(slips, of_slips))
        self.turning = self.rates.turning
        values = np.array([of_level.values for of_level in rates])
        followed = found.followed
        if not followed.size:
            return values, of_work
        halves = np.split(np.arange(len(found.loops)), followed.size)
        ratios, of_ratios = [], []
        for k, half in zip(followed.tolist(), halves, strict=True):
            done, of_done = self._half_cycle(found, k, half, levels[k], rates[k])
            ratios.append(2.0 * done / work[k])
            of_ratios.append((2.0 * of_done - ratios[-1] * of_work[k]) / work[k])
        whole = found.work / between(found.level, followed, np.array(ratios))
        of_ratio = between(found.level, followed, np.array(of_ratios))
        ratio = between(found.level, followed, np.array(ratios))[:, np.newaxis]
        return values, of_work * ratio + whole[:, np.newaxis] * of_ratio

    def _half_cycle(
        self, found: Cycles, k: int, half: IntArray, before: Level, last: Rates
    ) -> tuple[float, FloatArray]:
        """Work of friction in the half cycle from a level, J, and its derivatives, (k + 1,)."""
        turns = np.linspace(1.0, -1.0, MASING.increments + 1)[1:]
        u = before.u + np.cumsum(found.loops[half], axis=0)
        friction = found.friction[k] + np.cumsum(cast("FloatArray", found.turned)[half], axis=0)
        levels, alpha = self._levels(u, friction), turns * float(found.level[k])
        rates = self.rates.follow(last, before, [*zip(alpha.tolist(), levels, strict=True)])
        self.turning[k] = max(self.turning[k], *self.rates.turning)
        slips, of_slips = self.rates.sliders([before, *levels], [last, *rates])
        work, of_work = self._work(np.diff(slips, axis=0), np.diff(of_slips, axis=0))
        return float(work.sum()), np.asarray(of_work.sum(axis=0))

    def _levels(self, u: FloatArray, sigma: FloatArray) -> list[Level]:
        """Levels (levels, n) with the friction ``sigma``, (levels, rows), over its limits."""
        system = self.system
        slip, friction = (
            np.asarray((system.contact.B @ u.T).T),
            system.contact.on_rows(system.contact.w) * sigma,
        )
        return [Level(*parts) for parts in zip(u, friction, slip, strict=True)]

    def _work(
        self, slips: FloatArray, of_slips: FloatArray, limits: FloatArray | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Sums of w |slip|, (levels,), J, and their derivatives by the slips, (levels, k).

        Slips are (levels, rows), their derivatives (levels, rows, k). Constant limits have a part
        by their own derivatives; others, (levels, m), are given.
        """
        system = self.system
        size = system.contact.slip_norm(slips)
        rows = size[:, self.rates.row_point]
        along = np.divide(slips, rows, out=np.zeros_like(rows), where=rows > 0.0)
        of_size = system.contact.by_point(np.swapaxes(along[:, :, np.newaxis] * of_slips, 1, 2))
        w = np.broadcast_to(system.contact.w, size.shape) if limits is None else limits
        of_work = np.einsum("lkm,lm->lk", of_size, w)
        if limits is None:
            of_work += size @ self.rates.given
        return np.einsum("lm,lm->l", w, size), of_work

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
        levels, rates = zip(*chain, strict=True)
        slips, of_slips = self.rates.sliders(levels, rates)
        limits, of_limits = (np.array([one.limits for one in part]) for part in (levels, rates))
        step = np.diff(slips, axis=0)
        mean, of_mean = (0.5 * (x[1:] + x[:-1]) for x in (limits, of_limits))
        _, of_work = self._work(step, np.diff(of_slips, axis=0), mean)
        by_limits = np.einsum("lm,lmk->k", self.system.contact.slip_norm(step), of_mean)
        return np.asarray(of_work.sum(axis=0) + by_limits)


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
    of_level[:, :-1] -= np.outer(q, cycles.shift)
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
