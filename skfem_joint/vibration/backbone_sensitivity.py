"""Derivatives of a backbone by parameters of the structure.

They are computed from the path that a curve was followed along, which `backbone` keeps where it is
asked to. Each level is differentiated implicitly (:mod:`skfem_joint.slow.level_rates`), and so
are the mode and its inertia (:mod:`skfem_joint.vibration.mode_rates`). Frequency, damping and
amplitude follow by the chain rule from

    omega = sqrt(alpha / q),    zeta = D / (2 pi alpha q) + phi^T C phi / (2 omega),

with the work D of a cycle, by Masing's rule and its correction or along the cycle that was
followed. The derivatives are at fixed levels alpha. A measured curve is known over the amplitude: a
level changes with the parameter there, so that with the derivatives by the levels themselves

    d(omega) at a fixed amplitude x  =  d(omega) - d(omega)/d(ln alpha) dx / (dx/d(ln alpha)).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from skfem_joint.ground.arrays import FloatArray, IntArray, as_dense, wrong_shapes
from skfem_joint.ground.errors import InputError, refuse
from skfem_joint.slow.level_rates import LevelRates, Rates
from skfem_joint.slow.levels import Level, Walk
from skfem_joint.stepping.arrangement import Arranged
from skfem_joint.system.sensitivity import SystemSensitivity, of_closed_system
from skfem_joint.system.system import System
from skfem_joint.vibration.backbone import Backbone
from skfem_joint.vibration.cycles import CyclePath, RisingCycles, between, lowest
from skfem_joint.vibration.mode_rates import mode_rates


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


def check_parameters(parameters: Sequence[SystemSensitivity], system: System) -> None:
    """InputError for derivatives whose shapes do not fit a system, or of a reduced system."""
    if isinstance(system.contact.B, np.ndarray):
        raise InputError(
            "derivatives of a backbone: found that of a reduced system, must be that of a full or "
            "condensed one, among whose unknowns slips are"
        )
    n, m, q = system.n, system.contact.w.size, system.contact.normal.gap.size
    shapes = {"K": (n, n), "C": (n, n), "w": (m,), "stiffness": (m,), "gain": (m, q)}
    shapes |= dict.fromkeys(("gap", "force", "normal_stiffness"), (q,))
    for parameter in parameters:
        given = {name: (getattr(parameter, name), shape) for name, shape in shapes.items()}
        wrong = wrong_shapes({name: one for name, one in given.items() if one[0] is not None})
        refuse(f"parameter {parameter.name}: {problem}, that of the system" for problem in wrong)


class CycleRates:
    """Derivatives of what cycles of a force at rising levels give.

    Parameters
    ----------
    path : CyclePath
    force : ndarray, shape (n,)
        N.
    found : RisingCycles
        Its cycles.
    parameters : sequence of SystemSensitivity
        In the unknowns of the path.
    force_rates : ndarray, shape (n, k)
        Derivatives of the force, N.

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
        path: CyclePath,
        force: FloatArray,
        found: RisingCycles,
        parameters: Sequence[SystemSensitivity],
        force_rates: FloatArray,
    ) -> None:
        self.system, self.turning = path.to.system, list[int]()
        self.rest = path.levels.rest()
        points = as_dense(self.system.P).reshape(-1, force.size)
        looked_at = np.vstack([force, points]).T
        touch = None
        if path.opens:
            walked = [one for ways in found.ways for walk in ways for _, one in walk]
            carried = ([one.limits for one in walked], [one.normal for one in walked])
            touch = tuple(np.any(np.array(values) > 0.0, axis=0) for values in carried)
        self.rates = LevelRates(path.levels, force, parameters, force_rates, looked_at, touch)
        of_found = self._around if path.opens else self._by_masings_rule
        values, self.work = of_found(found)
        self.amplitude, self.displacement = values[:, 0], values[:, 1:]

    def _by_masings_rule(self, found: RisingCycles) -> tuple[FloatArray, FloatArray]:
        """Of values and work, of constant limits."""
        chain = self._chain((self.rest, self.rates.rest()), [x for w in found.ways for x in w[0]])
        ends = np.cumsum([len(ways[0]) for ways in found.ways])
        self.turning = [self.rates.turning[end - 1] for end in ends]
        chains = [[chain[0], chain[end]] for end in ends]
        values = np.array([last.values for _, (_, last) in chains])
        work, of_work = (4.0 * np.array(x) for x in zip(*map(self._work, chains), strict=True))
        followed = np.flatnonzero([len(ways) > 1 for ways in found.ways])
        if not followed.size:
            return values, of_work
        ratios, of_ratios = np.zeros(followed.size), np.zeros((followed.size, values.shape[2]))
        for j, k in enumerate(followed.tolist()):
            half = self._chain(chains[k][1], found.ways[k][1])
            self.turning[k] = max(self.turning[k], *self.rates.turning)
            done, of_done = self._work(half)
            ratios[j] = 2.0 * done / work[k]
            of_ratios[j] = (2.0 * of_done - ratios[j] * of_work[k]) / work[k]
        ratio, of_ratio = (between(found.level, followed, x) for x in (ratios, of_ratios))
        whole = found.work / ratio
        return values, of_work * ratio[:, np.newaxis] + whole[:, np.newaxis] * of_ratio

    def _around(self, found: RisingCycles) -> tuple[FloatArray, FloatArray]:
        """Of values and work, of contact that opens."""
        start = self.rest, self.rates.rest()
        values, work = list[FloatArray](), list[FloatArray]()
        for ways in found.ways:
            for walk in ways:
                chain = self._chain(start, walk)
                start = chain[-1]
            low = chain[1 + lowest(ways[-1])][1]
            values.append(0.5 * (start[1].values - low.values))
            work.append(self._work(chain)[1])
            self.turning.append(max(self.rates.turning))
        return np.array(values), np.array(work)

    def _chain(self, start: tuple[Level, Rates], walk: Walk) -> list[tuple[Level, Rates]]:
        """Levels of a walk with their derivatives, after those that it starts from."""
        rates = self.rates.follow(start[1], start[0], walk)
        return [start, *zip((level for _, level in walk), rates, strict=True)]

    def _work(self, chain: list[tuple[Level, Rates]]) -> tuple[float, FloatArray]:
        """Work of the mean friction limits on the slips of levels that follow each other, J.

        Also returns its derivatives, (k + 1,).
        """
        system = self.system
        levels, rates = zip(*chain, strict=True)
        slips, of_slips = (np.diff(x, axis=0) for x in self.rates.sliders(levels, rates))
        limits = [system.contact.w if one.limits is None else one.limits for one in levels]
        w, of_w = (
            0.5 * (x[1:] + x[:-1]) for x in map(np.array, (limits, [r.limits for r in rates]))
        )
        size = system.contact.slip_norm(slips)
        rows = np.repeat(size, system.contact.directions, axis=1)
        along = np.divide(slips, rows, out=np.zeros_like(rows), where=rows > 0.0)
        of_size = system.contact.by_point(np.swapaxes(along[:, :, np.newaxis] * of_slips, 1, 2))
        of_work = np.einsum("lkm,lm->k", of_size, w) + np.einsum("lm,lmk->k", size, of_w)
        return float((w * size).sum()), of_work


def backbone_sensitivity(
    curve: Backbone, parameters: Sequence[SystemSensitivity]
) -> BackboneSensitivity:
    """Derivatives of a curve by parameters of its structure.

    Parameters
    ----------
    curve : Backbone
        With its path: of `backbone` with ``keep_path``.
    parameters : sequence of SystemSensitivity
        From :func:`skfem_joint.sensitivities`.

    Returns
    -------
    BackboneSensitivity

    Raises
    ------
    InputError
        If the curve has no path, or is that of a reduced system, parameters have another shape than
        the system, or mix modes of the same frequency.
    ConvergenceError
        If the derivative of the mode's shape is not found.
    """
    path = curve.path
    if path is None:
        raise InputError("derivatives of a backbone: found no path; give backbone keep_path = True")
    way, found, shape = path.cycles, path.found, path.shape
    check_parameters(parameters, way.system)
    closed = _inside(of_closed_system(parameters, way.system), way.closed)
    of_stuck, of_shape = mode_rates(path.mode, closed)
    inside = closed if way.to is way.closed else _inside(parameters, way.to)
    of_shape, system = way.of_closed(of_shape), way.to.system
    cycles = CycleRates(way, system.M @ shape, found, inside, system.M @ of_shape)
    of_shape = np.column_stack([of_shape, np.zeros(system.n)])
    force, C, level = np.asarray(system.M @ shape), system.C, found.level
    q = found.states @ force
    of_q = cycles.amplitude + found.states @ (system.M @ of_shape)
    relative = of_q / q[:, np.newaxis]
    by_logarithm = np.eye(of_shape.shape[1])[-1]
    omega = np.sqrt(level / q)[:, np.newaxis]
    of_omega = 0.5 * omega * (by_logarithm - relative)
    energy = (2.0 * np.pi * level * q)[:, np.newaxis]
    friction = cycles.work / energy
    friction -= (found.work[:, np.newaxis] / energy) * (by_logarithm + relative)
    of_c = 2.0 * (C @ shape) @ of_shape
    of_c[:-1] += [0.0 if p.C is None else shape @ (p.C @ shape) for p in inside]
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


def _inside(parameters: Sequence[SystemSensitivity], to: Arranged) -> list[SystemSensitivity]:
    """Derivatives in the unknowns of a path."""
    return [one.in_unknowns(*(change.forward for change in to.maps)) for one in parameters]
