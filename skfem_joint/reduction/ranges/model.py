"""The reduced model of a range."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from skfem_joint.arrays import FloatArray
from skfem_joint.errors import InputError, first_of, refuse
from skfem_joint.loads import common_period
from skfem_joint.reduction.active_length import THRESHOLD
from skfem_joint.reduction.friction_points import NO_FRICTION, shared_points
from skfem_joint.reduction.missing_modes import Residual, stride
from skfem_joint.reduction.pod import ProperModes
from skfem_joint.reduction.ranges.points import (
    placed,
    point_of,
    searched_level,
)
from skfem_joint.reduction.ranges.training import SETTINGS as TRAINING
from skfem_joint.reduction.ranges.training import Pool, Training, scaled, spread
from skfem_joint.served import Point, Range, Served
from skfem_joint.stepping.integrate import integrate
from skfem_joint.stepping.recording import Run, Save
from skfem_joint.system import System
from skfem_joint.values import COUNT, POSITIVE, check

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class RangeSettings:
    """Numbers of models for a range.

    Attributes
    ----------
    modes : tuple of int
        Numbers of joint modes that are tried.
    many : int
        Number where these do not reach the accuracy; paths are followed at further points before.
    larger : float
        Modes of the larger model over those of the model.
    points_per_mode : int
        Merged friction points for each vector of a basis.
    checks : int
        Points at which numbers of modes are judged, and of these those at which the larger model
        is judged by the residual of its run in the full equation.
    judged : int
    cycles, steps : int
        Cycles of the runs at these points, and steps of each.
    missing : int
        Missing modes that are added to the larger model.
    best : int
        Fewest joint modes of the best model, which others are compared with where numbers of modes
        are judged; it has at least as many as the larger model.
    margin : float
        Share of the accuracy that differences to the best model may take, but all of it with the
        largest of the usual numbers of modes: each mode more costs time in every step.
    energies : float
        Error of energies that is allowed, over that of displacement histories.
    least, most, quantile : float
        Least and most factor on the difference of a run to that of the larger model, and the
        quantile of the factors at the checked points that is taken.
    """

    modes: tuple[int, ...] = (20, 28, 40)
    many: int = 84
    larger: float = 1.5
    points_per_mode: int = 3
    checks: int = 4
    judged: int = 1
    cycles: int = 3
    steps: int = 100
    missing: int = 16
    best: int = 64
    margin: float = 0.5
    energies: float = 3.0
    least: float = 2.0
    most: float = 5.0
    quantile: float = 1.0


SETTINGS = RangeSettings()


def reduced_for_range(
    system: System,
    given: Mapping[str, Any] | Range,
    *,
    accuracy: float = 0.01,
    modes: str | int = "auto",
) -> System:
    """Reduced model of a system for a range of slip, frequency and friction limits.

    Parameters
    ----------
    system : System
        With harmonic loads that have a common period.
    given : Range or mapping
        See `skfem_joint.served.Range`.
    accuracy : float
        Largest error of displacement histories that the number of modes is chosen for; three times
        that of energies.
    modes : "auto" or int
        Joint modes.

    Returns
    -------
    System
        With ``serves``; `skfem_joint.reduction.ranges.points.at` takes points of it.

    Raises
    ------
    InputError
        If the range or a number is wrong, a load is not harmonic, or no point carries friction.
    ConvergenceError
        If a path or run does not converge, or no load makes a joint slip as a whole.
    """
    range_ = Range.of(given)
    check("accuracy", accuracy, POSITIVE)
    check("modes", modes, COUNT, "auto")
    period = common_period(load.amplitude for load in system.loads)
    if period is None or not all(load.amplitude.harmonics for load in system.loads):
        raise InputError(
            "range: the loads must be harmonic, with a common period, whose frequency and level "
            "the range is of"
        )
    if system.contact.count == 0:
        raise InputError(NO_FRICTION)
    refuse(
        f"range.limits: found joint {name!r}, must be one of {first_of(system.contact.joints)}"
        for name in range_.limits
        if name not in system.contact.joints
    )
    return _Maker(system, range_, accuracy, period).model(modes)


#: A point of the range at which models are run, and its level.
_Checked = tuple[Training, float]


@dataclass(frozen=True)
class _Fitted:
    """A model with as many modes as suffice, and those that it was compared with.

    Attributes
    ----------
    small, larger, best : System
        The model, its larger one, and the best one of the pool, each without stated errors.
    V : ndarray, shape (n, j)
        Basis of the best one.
    truths, runs : list of Run
        At the checked points, of the best model and of the model.
    worst : float
        Largest distance of these.
    """

    small: System
    larger: System
    best: System
    V: FloatArray
    truths: list[Run]
    runs: list[Run]
    worst: float


@dataclass
class _Maker:
    """What is made on the way to a model, see `reduced_for_range`."""

    system: System
    range: Range
    accuracy: float
    period: float

    def model(self, modes: str | int) -> System:
        """Model of the range."""
        pool, known, rough, checked = self._trained()
        tried = SETTINGS.modes if isinstance(modes, str) else (modes,)
        fitted = self._fitted(pool, known, checked, tried)
        if isinstance(modes, str) and fitted.worst > self.accuracy:
            self._follow_further(pool, known, rough)
            fitted = self._fitted(pool, known, checked, (SETTINGS.many,))
        factors = self._factors(pool, fitted, checked)
        larger = replace(fitted.larger.with_contact(shares=None), T=None, serves=None)
        serves = self._serves(pool, larger, known)
        serves = replace(serves, factors=factors, reached=max(fitted.worst, 1e-12))
        if serves.shortfall is not None:
            _log.warning("%s.", serves.shortfall)
        return replace(fitted.small, serves=serves)

    def _trained(self) -> tuple[Pool, FloatArray, System, list[_Checked]]:
        """Pool of paths, known levels of gross slip, a rough model, and the points to check."""
        pool = Pool.of(self.system, self.range)
        count = TRAINING.first + TRAINING.more
        places = spread(self.system, self.range, count + SETTINGS.checks)
        levels, factor = [], 1.0
        for place in places[: TRAINING.first]:
            levels.append(factor * pool.nominal(place))
            peak = pool.follow(replace(place, slip=1.0), levels[-1]).slip_peak
            sticks = self.system.contact.least_share(peak <= THRESHOLD * peak.max())
            if sticks > TRAINING.still:
                factor *= TRAINING.raised
            elif sticks < 0.1 * TRAINING.still:
                factor /= float(np.sqrt(TRAINING.raised))
        known = scaled(places[: TRAINING.first], levels)
        rough = self._with(pool, pool.proper(), TRAINING.rough, known)
        levels += [_level(rough, place) for place in places[TRAINING.first :]]
        known = scaled(places, levels)
        for k in range(TRAINING.first, count):
            pool.follow(places[k], places[k].slip * levels[k])
        pairs = zip(places[count:], levels[count:], strict=True)
        return pool, known, rough, [self._inside(*pair) for pair in pairs]

    def _inside(self, place: Training, level: float) -> _Checked:
        """A place with its share of slip in the range, and the level there."""
        low, high = self.range.slip
        slip = min(max(place.slip, low), high)
        return replace(place, slip=slip), slip * level

    def _follow_further(self, pool: Pool, known: FloatArray, rough: System) -> None:
        """Follow paths where two models of the pool differ most, of points not used before."""
        used = TRAINING.first + TRAINING.more + SETTINGS.checks
        places = spread(self.system, self.range, used + TRAINING.rounds * TRAINING.candidates)
        for start in range(used, len(places), TRAINING.candidates):
            proper, judged = pool.proper(), []
            pair = [self._with(pool, proper, m, known) for m in (SETTINGS.modes[-1], SETTINGS.many)]
            for place in places[start : start + TRAINING.candidates]:
                point = self._inside(place, _level(rough, place))
                runs = [self._run(model, *point) for model in pair]
                judged.append((self._error(*runs), *point))
            judged.sort(key=lambda item: item[0], reverse=True)
            for _, place, level in judged[: TRAINING.followed]:
                pool.follow(place, level)

    def _fitted(
        self, pool: Pool, known: FloatArray, checked: list[_Checked], numbers: Sequence[int]
    ) -> _Fitted:
        """Model with the first number of modes that suffices at the checked points."""
        proper = pool.proper()
        most = int(np.count_nonzero(proper.singular_values > 1e-7 * proper.singular_values[0]))
        tried = list(dict.fromkeys(min(count, most) for count in numbers))
        top = 0
        for count in tried:
            wider = round(SETTINGS.larger * count)
            if wider > top:
                top = min(most, max(SETTINGS.best, wider))
                best = self._with(pool, proper, top, known)
                truths = [self._run(best, *point) for point in checked]
            small = self._with(pool, proper, count, known)
            runs = [self._run(small, *point) for point in checked]
            worst = max(self._error(*pair) for pair in zip(truths, runs, strict=True))
            share = SETTINGS.margin if count < tried[-1] else 1.0
            if worst <= share * self.accuracy:
                break
        larger = self._with(pool, proper, min(top, wider), known)
        return _Fitted(small, larger, best, pool.basis(proper, top), truths, runs, worst)

    def _with(self, pool: Pool, proper: ProperModes, modes: int, known: FloatArray) -> System:
        """Model of a number of modes, which is its own larger model."""
        V = pool.basis(proper, modes)
        small = pool.merged(V, SETTINGS.points_per_mode * V.shape[1])
        return replace(small, serves=self._serves(pool, small, known))

    def _serves(self, pool: Pool, larger: System, known: FloatArray) -> Served:
        """What a model carries, without factors."""
        law, accuracy = pool.law(), self.accuracy
        return Served(self.range, larger, {}, accuracy, accuracy, law, self.period, known)

    def _run(self, model: System, place: Training, level: float, fields: bool = False) -> Run:
        point = point_of(model, Point(place.frequency, level, {}, place.slip), place.factors)
        steps, cycles = SETTINGS.steps, SETTINGS.cycles
        every = stride(steps * cycles, steps)
        save = Save(fields=True, fields_every=every) if fields else None
        return integrate(point, cycles=cycles, steps_per_cycle=steps, save=save)

    def _factors(self, pool: Pool, fitted: _Fitted, checked: list[_Checked]) -> dict[str, float]:
        """Factors on the difference of a run to that of the larger model.

        At one or some points the best model is run again with the modes that its run misses.
        """
        residual = Residual(self.system, pool.path.unshifted)
        ratios = []
        for number, (place, level) in enumerate(checked):
            truth, run = fitted.truths[number], fitted.runs[number]
            if number < SETTINGS.judged:
                truth = self._better(residual, fitted.V, fitted.best, place, level)
            error = np.array(_apart(truth, run))
            shown = np.array(_apart(self._run(fitted.larger, place, level), run))
            ratios.append(error / np.maximum(shown, 1e-12))
        found = np.quantile(np.array(ratios), SETTINGS.quantile, axis=0)
        found = np.clip(found, SETTINGS.least, SETTINGS.most)
        return {"history": float(found[0]), "energy": float(found[1])}

    def _error(self, reference: Run, other: Run) -> float:
        """Distance of two runs, of which energies may err more."""
        history, energy = _apart(reference, other)
        return max(history, energy / SETTINGS.energies)

    def _better(
        self, residual: Residual, V: FloatArray, best: System, place: Training, level: float
    ) -> Run:
        """Run of the best model with the modes that its run misses, with all friction points."""
        run = self._run(best, place, level, fields=True)
        there = placed(self.system, place.frequency, level, place.factors)
        missing = residual.under(there).missing_modes(V, run, SETTINGS.missing, V[:, :0])
        point = run.system
        model = there.widened(there.project(V), V, missing)
        if point.contact.shares is not None:
            model = shared_points(model, point.contact.shares, point.contact.w)
        model = model.no_steeper(point.contact.steepest)
        return integrate(model, cycles=SETTINGS.cycles, steps_per_cycle=SETTINGS.steps)


def _level(rough: System, place: Training) -> float:
    """Level at which the first joint slips as a whole, of a rough model, or a guess."""
    level, guess = searched_level(rough, place.frequency, place.factors)
    return TRAINING.missed * guess if level is None else level


def _apart(reference: Run, other: Run) -> tuple[float, float]:
    """Relative distance of two runs: of displacement histories, and of friction energy a cycle.

    Histories are those of the named point that moves most.
    """
    size = np.linalg.norm(reference.point_u, axis=0)
    history = 0.0
    if size.max(initial=0.0) > 0.0:
        history = float(
            np.linalg.norm(other.point_u - reference.point_u, axis=0).max() / size.max()
        )
    ours, theirs = float(other.cycles.friction[-1]), float(reference.cycles.friction[-1])
    return history, abs(ours - theirs) / theirs if theirs > 0.0 else 0.0
