"""A structure as a function of some of its values: its curves at measured amplitudes.

For each measured curve the backbone of its mode is computed with the derivatives by the values that
are free (:mod:`skfem_joint.vibration.backbone_sensitivity`). Its levels are those at which the
point has the measured amplitudes, or evenly spread ones where there are many. What is left between
both is bridged by cubic splines in the logarithm of the amplitude, with the slopes that the
derivatives by the level give.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicHermiteSpline, PchipInterpolator

from skfem_joint.fitting.measured import MeasuredCurve
from skfem_joint.ground.arrays import BoolArray, FloatArray
from skfem_joint.ground.errors import ConvergenceError, InputError
from skfem_joint.reduction.stuck import Stuck
from skfem_joint.structure.load import Load
from skfem_joint.structure.parameters import value_of, with_values
from skfem_joint.structure.sensitivities import sensitivities
from skfem_joint.structure.structure import Structure
from skfem_joint.system.sensitivity import SystemSensitivity
from skfem_joint.system.system import System
from skfem_joint.vibration.backbone import Backbone, Factors, backbone
from skfem_joint.vibration.backbone_sensitivity import BackboneSensitivity, backbone_sensitivity

#: Most levels of a curve.
MOST = 20
#: Relative distance of the amplitudes of the levels from those that are wanted. Curves have kinks
#: where the first points slip: at 0.02 a kink between a level and its sample moved values by two
#: of their standard deviations, and the search took longer. Smaller distances take no more
#: curves.
NEAR = 1e-3
#: Relative distance from a single wanted amplitude of the two levels beside it, and largest one
#: of an amplitude beyond the last level.
APART = 0.02
#: Most curves that are computed to get there.
TRIALS = 6


@dataclass(frozen=True)
class PredictedCurve:
    """Frequency and damping of a mode at given amplitudes of a point, with derivatives.

    Attributes
    ----------
    displacement : ndarray, shape (k,)
        Amplitude of the point, m; half of peak to peak.
    frequency, damping : ndarray, shape (k,)
        Hz, and damping ratio of friction and viscous forces.
    frequency_rates, damping_rates : ndarray, shape (k, parameters)
        Their derivatives by the free values.
    inside : ndarray of bool, shape (k,)
        Whether the amplitude is among those of the levels; beyond them values are those at the
        nearest one.
    turning : int
        Most points of a level that may be turning between sticking and slipping.
    """

    displacement: FloatArray
    frequency: FloatArray
    damping: FloatArray
    frequency_rates: FloatArray
    damping_rates: FloatArray
    inside: BoolArray
    turning: int


class FitModel:
    """Curves of a structure over some of its values.

    Parameters
    ----------
    structure : Structure
    keys : sequence of str
        Values that are free, see `skfem_joint.structure.parameters.with_values`.
    loads : sequence of Load
        Of the structure; a damping ratio may depend on their frequencies.
    points : sequence of str, optional
        Names of points, boundaries and regions that may be measured, as `Structure.system` takes
        them.

    Attributes
    ----------
    computed : int
        Backbones that were computed.
    points : tuple of str
        Names of the points whose amplitude may be measured.

    Raises
    ------
    InputError
        For keys that the structure does not have, or that cannot be varied.
    """

    def __init__(
        self,
        structure: Structure,
        keys: Sequence[str],
        loads: Sequence[Load] = (),
        points: Sequence[str] | None = None,
    ) -> None:
        self.structure, self.keys = structure, tuple(keys)
        self._of_system = tuple(loads), points
        self.computed, self._factors = 0, Factors()
        self._found: dict[tuple[object, ...], list[_Found]] = {}  # the newest first
        self.start = np.array([value_of(structure, key) for key in self.keys])
        system = self.system(structure)
        sensitivities(structure, self.keys, system)  # refuses what cannot be
        self.points = system.points

    def system(self, structure: Structure) -> System:
        """System of the structure, or of one with other values."""
        return structure.system(*self._of_system)

    def let_go(self) -> None:
        """Give back the memory of the factors that are kept from one curve to the next."""
        self._factors = Factors()

    def at(self, values: Sequence[float]) -> Structure:
        """Structure with the free values at the given ones."""
        return with_values(self.structure, dict(zip(self.keys, values, strict=True)))

    def predict(
        self,
        values: Sequence[float],
        measured: Sequence[MeasuredCurve],
        asked: Sequence[FloatArray],
    ) -> list[PredictedCurve]:
        """Curves of the structure beside measured ones.

        Parameters
        ----------
        values : sequence of float
            Of the free keys.
        measured : sequence of MeasuredCurve
        asked : sequence of ndarray, shape (k,) each
            Displacement of the point of each, m.

        Raises
        ------
        InputError
            If an amplitude asks for more than the joint holds.
        ConvergenceError
            If a level does not converge.
        """
        structure = self.at(values)
        system = self.system(structure)
        parameters = sensitivities(structure, self.keys, system)
        at = np.array(values, dtype=float)
        found = dict[int, PredictedCurve]()
        kinds = [(curve.mode, tuple(curve.weights(system.points))) for curve in measured]
        for mode, weights in dict.fromkeys(kinds):
            own = [k for k, kind in enumerate(kinds) if kind == (mode, weights)]
            along = np.array(weights)
            nodes = np.unique(np.concatenate([asked[k] for k in own]))
            if nodes.size == 1:
                nodes = nodes * np.array([1.0 - APART, 1.0 + APART])
            if nodes.size > MOST:
                nodes = np.geomspace(nodes[0], nodes[-1], MOST)
            curve = self._curve(system, at, mode, along, nodes, parameters)
            found |= {k: curve.at(asked[k]) for k in own}
        return [found[k] for k in range(len(measured))]

    def _curve(
        self,
        system: System,
        values: FloatArray,
        mode: int,
        weights: FloatArray,
        nodes: FloatArray,
        parameters: Sequence[SystemSensitivity],
    ) -> _Found:
        """Backbone at amplitudes near ``nodes`` of a point, (levels,), m, and its derivatives.

        The levels begin as the derivatives of the curve that was found before say.
        """

        def found_at(levels: FloatArray) -> _Found:
            (curve,) = backbone(system, (mode,), levels, keep_path=True, factors=self._factors)
            rates = backbone_sensitivity(curve, parameters)
            moved = np.asarray(system.P @ curve.states.T).T
            along = moved @ weights
            # Derivatives of a backbone are those of the magnitudes of the named points.
            signs = np.sign(moved) * weights / along[:, np.newaxis]
            of_logarithm = np.einsum("lp,lpk->lk", signs, rates.displacement)
            curve, logarithm = replace(curve, path=None), np.log(np.abs(along))
            return _Found(values, curve, rates, nodes, logarithm, of_logarithm)

        place = (mode, *weights.tolist(), *nodes.tolist())
        known = self._found.setdefault(place, [])
        for before in known:
            if np.array_equal(before.values, values):
                return before
        levels = (
            self._of_stuck(system, mode, weights) * nodes
            if not known
            else _rising(known[0].levels(values))
        )
        found, least, refused = None, np.inf, np.inf
        for trial in range(TRIALS):
            try:
                last = found_at(levels)
            except (InputError, ConvergenceError):
                # Levels of a stuck structure may be more than friction holds, where those of the
                # same amplitudes with slip are not.
                refused = levels[-1]
                # Without a curve the search goes on at a half of the levels, then at less.
                held = 0.25 ** (trial + 1) * refused if found is None else found.curve.level[-1]
                levels = _up_to(levels, np.sqrt(held * refused))
                continue
            self.computed += 1
            if (size := float(np.abs(last.apart).max())) < least:
                found, least = last, size
            if size <= NEAR:
                break
            levels = _rising(last.levels(values))
            if levels[-1] >= refused:
                levels = _up_to(levels, np.sqrt(last.curve.level[-1] * refused))
        if found is None:  # say why
            return found_at(levels)
        known[:] = [found, *known[:1]]  # a step that is not taken leads back to the one before
        return found

    def _of_stuck(self, system: System, mode: int, weights: FloatArray) -> float:
        """Level over the amplitude of a point with the contact stuck."""
        closed = system.closed()
        frequencies, shapes = Stuck(closed).modes(mode)
        if mode > frequencies.size:
            raise InputError(f"fit: found mode {mode}, there are {frequencies.size} stuck ones")
        moved = abs(float(weights @ np.asarray(closed.P @ shapes[:, mode - 1])))
        if moved <= 1e-9 * np.abs(shapes[:, mode - 1]).max():
            raise InputError(
                f"fit: mode {mode} does not move the measured point; choose another point, "
                "direction or mode"
            )
        return float((2.0 * np.pi * frequencies[mode - 1]) ** 2) / moved


@dataclass(frozen=True)
class _Found:
    """A curve that was found, from which the levels of the next one follow.

    Attributes
    ----------
    values : ndarray, shape (k,)
        Of the free keys.
    curve : Backbone
    rates : BackboneSensitivity
        Its derivatives.
    nodes : ndarray, shape (levels,)
        Wanted amplitudes of the point, m; of more levels where the curve ends before.
    logarithm : ndarray, shape (levels,)
        Of the amplitudes of the point.
    of_logarithm : ndarray, shape (levels, k + 1)
        Derivatives of that.
    """

    values: FloatArray
    curve: Backbone
    rates: BackboneSensitivity
    nodes: FloatArray
    logarithm: FloatArray
    of_logarithm: FloatArray

    @property
    def apart(self) -> FloatArray:
        """Logarithm of wanted amplitudes over those of the levels, (levels,)."""
        return np.asarray(np.log(self.nodes[: self.logarithm.size]) - self.logarithm)

    def levels(self, values: FloatArray) -> FloatArray:
        """Levels of the wanted amplitudes with other values, (levels,), to first order."""
        old, positive = self.values, (self.values > 0.0) & (values > 0.0)
        ratio = np.divide(values, old, out=np.ones_like(old), where=positive)
        change = np.where(positive, old * np.log(ratio), values - old)
        # Most that a level changes from one to the next.
        largest = np.log(3.0)
        apart = self.apart - self.of_logarithm[:, :-1] @ change
        change = np.clip(apart / self.of_logarithm[:, -1], -largest, largest)
        return np.asarray(self.curve.level * np.exp(change))

    def at(self, displacement: FloatArray) -> PredictedCurve:
        """The curve at given amplitudes of the point, (k,), m."""
        curve, rates, X, of_x = self.curve, self.rates, self.logarithm, self.of_logarithm
        rises = np.append(True, X[1:] > np.maximum.accumulate(X)[:-1])  # but for errors of levels
        if np.count_nonzero(rises) < 2:
            raise ConvergenceError("fit: the amplitude of the point does not rise with the level")
        wanted = np.log(displacement)
        at = np.clip(wanted, X[0] - APART, X[-1] + APART)
        within = np.clip(wanted, X[0], X[-1])
        X, of_x, zeta = X[rises], of_x[rises], curve.damping_ratio[rises]
        of_zeta = rates.damping_ratio[rises] / zeta[:, np.newaxis]
        columns, pairs = [], [(curve.frequency[rises], rates.frequency[rises])]
        for values, of_values in (*pairs, (np.log(zeta), of_zeta)):
            spline = CubicHermiteSpline(X, values, of_values[:, -1] / of_x[:, -1])
            held = rates.at_amplitude(of_values, of_x)
            columns += [spline(at), PchipInterpolator(X, held, axis=0)(within)]
        frequency, frequency_rates, logarithm, of_logarithm = columns
        damping = np.exp(logarithm)
        return PredictedCurve(
            displacement=displacement,
            frequency=frequency,
            damping=damping,
            frequency_rates=frequency_rates,
            damping_rates=damping[:, np.newaxis] * of_logarithm,
            inside=at == wanted,
            turning=int(rates.turning.max()),
        )


def _rising(levels: FloatArray) -> FloatArray:
    """Levels that rise, at least by round-off."""
    return np.asarray(np.maximum.accumulate(levels) * (1.0 + 1e-9 * np.arange(levels.size)))


def _up_to(levels: FloatArray, highest: float) -> FloatArray:
    """Levels between the same lowest one, if that is less, and another highest one."""
    lowest = min(levels[0], 0.5 * highest)
    if levels.size == 1 or levels[0] == levels[-1]:
        return np.full(1, highest)
    share = np.log(levels / levels[0]) / np.log(levels[-1] / levels[0])
    return np.asarray(lowest * (highest / lowest) ** share)
