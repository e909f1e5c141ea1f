"""The reduced model of a range."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np

from skfem_joint.ground.arrays import FloatArray
from skfem_joint.ground.errors import InputError
from skfem_joint.ground.values import COUNT, POSITIVE, check
from skfem_joint.reduction.active_length import THRESHOLD
from skfem_joint.reduction.condensed import reference_model
from skfem_joint.reduction.elastic_contact import elastic
from skfem_joint.reduction.friction_points import NO_FRICTION, shared_points
from skfem_joint.reduction.missing_modes import Residual, stride
from skfem_joint.reduction.pod import ProperModes
from skfem_joint.reduction.ranges.points import (
    check_joints,
    from_rest,
    least_energy,
    period_of,
    placed,
    point_of,
    searched_level,
)
from skfem_joint.reduction.ranges.training import Pool, spread
from skfem_joint.stepping.recording import Run
from skfem_joint.system.served import Point, Range, Served
from skfem_joint.system.system import System

_log = logging.getLogger(__name__)


# Numbers of joint modes that are tried.
_MODES = (20, 28, 40)
# Number where these do not reach the accuracy; paths are followed at further points before.
_MANY = 84
# Points whose levels come from the stuck vibration, and further ones, whose levels come from the
# model of the first. The first ones are followed until all slips. With 6 and 8 in place of 3 and 5,
# 40 modes of a bracket's pool served low shares of slip worse: 7 of 12 points within 1 and 3 %, in
# place of 11.
_FIRST = 3
_MORE = 5
# Points at which numbers of modes are judged.
_CHECKS = 4
# Cycles of the runs at these points, and steps of each.
_CYCLES = 3
_STEPS = 100


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
        See `skfem_joint.system.served.Range`.
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
    period_of(system)  # refuses loads without one
    if system.contact.count == 0:
        raise InputError(NO_FRICTION)
    check_joints(system, range_.limits, "range.limits")
    pool = Pool.of(elastic(system), range_)
    return _Maker(system, range_, accuracy, pool).model(modes)


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
    """What is made on the way to a model, see `reduced_for_range`.

    Attributes
    ----------
    system : System
    range : Range
    accuracy : float
    pool : Pool
        Static slip paths, with contact that opens elastic.
    known : ndarray, shape (points, 2 + joints)
        See `Served.known`.
    """

    system: System
    range: Range
    accuracy: float
    pool: Pool
    known: FloatArray = field(init=False)

    def model(self, modes: str | int) -> System:
        """Model of the range."""
        rough, checked = self._trained()
        tried = _MODES if isinstance(modes, str) else (modes,)
        fitted = self._fitted(checked, tried)
        if isinstance(modes, str) and fitted.worst > self.accuracy:
            self._follow_further(rough)
            fitted = self._fitted(checked, (_MANY,))
        larger = replace(fitted.larger.with_contact(shares=None), T=None, serves=None)
        serves = replace(self._serves(larger), **self._stated(fitted, checked))
        serves = replace(serves, reached=max(fitted.worst, 1e-12))
        if serves.shortfall is not None:
            _log.warning("%s.", serves.shortfall)
        return replace(fitted.small, serves=serves)

    def _trained(self) -> tuple[System, list[Point]]:
        """Rough model of the first paths, and the points to check, after all paths are followed."""
        first, count = _FIRST, _FIRST + _MORE
        places = spread(self.system.contact.joints, self.range, count + _CHECKS)
        levels, factor = [], 1.0
        for place in places[:first]:
            levels.append(factor * self.pool.stuck.level(placed(self.pool.system, place)))
            peak = self.pool.follow(replace(place, slip=1.0, level=levels[-1])).slip_peak
            sticks = self.system.contact.least_share(peak <= THRESHOLD * peak.max())
            # The next level is higher while more than a tenth of each joint's limit sticks.
            if sticks > 0.1:
                factor *= 1.5
            elif sticks < 0.01:
                factor /= float(np.sqrt(1.5))
        self._know(places[:first], levels)
        rough = self._with(self.pool.proper(), 14)
        levels += [_level(rough, place) for place in places[first:]]
        self._know(places, levels)
        for place, level in zip(places[first:count], levels[first:count], strict=True):
            self.pool.follow(_slipping(place, level))
        pairs = zip(places[count:], levels[count:], strict=True)
        return rough, [self._inside(*pair) for pair in pairs]

    def _know(self, places: Sequence[Point], levels: Sequence[float]) -> None:
        """Keep where the levels of gross slip are known."""
        joints, pairs = self.system.contact.joints, zip(places, levels, strict=True)
        self.known = np.array([[p.frequency, *p.factors(joints), level] for p, level in pairs])

    def _inside(self, place: Point, level: float) -> Point:
        """A place with its share of slip in the range, and its level by that of gross slip."""
        slip = float(np.clip(place.slip or 1.0, *self.range.slip))
        return _slipping(replace(place, slip=slip), level)

    def _follow_further(self, rough: System) -> None:
        """Follow paths where two models of the pool differ most, of points not used before.

        There are two rounds of twelve points, and six paths in each. On a bolted solid 56 modes of
        8 paths served 39 of 46 points within 1 and 3 %, 84 modes of 20 paths 42.
        """
        used, candidates = _FIRST + _MORE + _CHECKS, 12
        count = used + 2 * candidates
        places = spread(self.system.contact.joints, self.range, count)
        for start in range(used, count, candidates):
            proper, judged = self.pool.proper(), []
            pair = [self._with(proper, modes) for modes in (_MODES[-1], _MANY)]
            for place in places[start : start + candidates]:
                point = self._inside(place, _level(rough, place))
                judged.append((self._error(*(self._run(model, point) for model in pair)), point))
            judged.sort(key=lambda item: item[0], reverse=True)
            for _, point in judged[:6]:
                self.pool.follow(point)

    @cached_property
    def _exact(self) -> System | None:
        """Condensed model of contact that opens, which is rigid where the full model's is.

        Where limits are constant the residual in the full equation shows what a model misses, and
        none is made: it would be slow where contact is large.
        """
        if not self.system.contact.opens:
            return None
        return reference_model(self.system)

    def _fitted(self, checked: list[Point], numbers: Sequence[int]) -> _Fitted:
        """Model with the first number of modes that suffices at the checked points."""
        proper = self.pool.proper()
        most = int(np.count_nonzero(proper.singular_values > 1e-7 * proper.singular_values[0]))
        tried = list(dict.fromkeys(min(count, most) for count in numbers))
        top = 0
        for count in tried:
            wider = round(1.5 * count)
            if wider > top:
                # The best model, which others are compared with where numbers of modes are judged.
                top = min(most, max(64, wider))
                best = self._with(proper, top)
                truths = [self._run(self._exact or best, point) for point in checked]
            small = self._with(proper, count)
            runs = [self._run(small, point) for point in checked]
            worst = max(self._error(*pair) for pair in zip(truths, runs, strict=True))
            # Differences to the best model may take half of the accuracy, but all of it with the
            # largest of the usual numbers of modes: each mode more costs time in every step.
            share = 0.5 if count < tried[-1] else 1.0
            if worst <= share * self.accuracy:
                break
        larger = self._with(proper, min(top, wider))
        return _Fitted(small, larger, best, self.pool.basis(proper, top), truths, runs, worst)

    def _with(self, proper: ProperModes, modes: int) -> System:
        """Model of a number of modes, which is its own larger model."""
        small = self.pool.merged(self.pool.basis(proper, modes))
        return replace(small, serves=self._serves(small))

    def _serves(self, larger: System) -> Served:
        """What a model carries, but for what errors are stated by."""
        asked, law = self.accuracy, self.pool.law()
        return Served(self.range, larger, {}, {}, asked, asked, law, self.known)

    def _run(self, model: System, point: Point, fields_every: int = 0) -> Run:
        """Run at a point of a model for the range, or of the exact one."""
        there = placed(model, point) if model is self._exact else point_of(model, point)
        return from_rest(there, _CYCLES, _STEPS, fields_every)

    def _stated(self, fitted: _Fitted, checked: list[Point]) -> dict[str, Any]:
        """By what a point states its errors: `Served.factors` and `Served.shared`.

        With constant limits the best model is run again, at one or some points, with the modes that
        its run misses. With contact that opens all truths are of the condensed model.
        """
        residual = Residual(self.system, self.pool.path.unshifted)
        errors, shown, shared = [], [], []
        for number, point in enumerate(checked):
            truth, run = fitted.truths[number], fitted.runs[number]
            # At one point the larger model is judged by the residual of its run in the full
            # equation.
            if number == 0 and self._exact is None:
                truth = self._better(residual, fitted.V, fitted.best, point)
            larger = self._run(fitted.larger, point)
            errors.append(_apart(truth, run))
            shown.append(_apart(larger, run))
            shared.append(_apart(truth, larger) if self._exact else (0.0, 0.0))
        left = np.max(shared, axis=0)
        ratios = np.maximum(errors - left, 0.0) / np.maximum(shown, 1e-12)
        # Factors on the difference of a run to that of the larger model.
        found = np.clip(ratios.max(axis=0), 2.0, 5.0)
        names = "history", "energy"
        values = {"factors": found.tolist(), "shared": left.tolist()}
        return {of: dict(zip(names, pair, strict=True)) for of, pair in values.items()}

    def _error(self, reference: Run, other: Run) -> float:
        """Distance of two runs, of which energies may err more."""
        history, energy = _apart(reference, other)
        return max(history, energy / 3.0)  # of energies three times the error is allowed

    def _better(self, residual: Residual, V: FloatArray, best: System, point: Point) -> Run:
        """Run of the best model with the modes that its run misses, with all friction points."""
        every = stride(_STEPS * _CYCLES, _STEPS)
        run = self._run(best, point, every)
        there = placed(self.system, point)
        missing = residual.under(there).missing_modes(V, run, 16, V[:, :0])
        contact = run.system.contact
        model = there.widened(there.project(V), V, missing)
        model = shared_points(model, contact.shares, contact.w).no_steeper(contact.steepest)
        return from_rest(model, _CYCLES, _STEPS)


def _slipping(place: Point, level: float) -> Point:
    """A place at its share of the level at which the first joint slips as a whole."""
    return replace(place, level=(1.0 if place.slip is None else place.slip) * level)


def _level(rough: System, place: Point) -> float:
    """Level at which the first joint slips as a whole, of a rough model, or a guess."""
    level, guess = searched_level(rough, place)
    return 1.5 * guess if level is None else level


def _apart(reference: Run, other: Run) -> tuple[float, float]:
    """Relative distance of two runs: of displacement histories, and of friction energy a cycle.

    Histories are those of the named point that moves most.
    """
    motions = other.point_u - reference.point_u, reference.point_u
    apart, size = (float(np.linalg.norm(x, axis=0).max(initial=0.0)) for x in motions)
    history = apart / size if size > 0.0 else 0.0
    ours, theirs = float(other.cycles.friction[-1]), float(reference.cycles.friction[-1])
    if not theirs > 0.0:
        return history, 0.0
    return history, abs(ours - theirs) / max(theirs, least_energy(reference))
