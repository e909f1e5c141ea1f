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
from skfem_joint.reduction.condensed import condensed_basis, condensed_system
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
from skfem_joint.reduction.ranges.training import SETTINGS as TRAINING
from skfem_joint.reduction.ranges.training import Pool, spread
from skfem_joint.stepping.recording import Run
from skfem_joint.system.served import Point, Range, Served
from skfem_joint.system.system import System

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
    checks : int
        Points at which numbers of modes are judged, and of these those at which the larger model
        is judged by the residual of its run in the full equation.
    judged : int
    cycles, steps : int
        Cycles of the runs at these points, and steps of each.
    missing : int
        Missing modes that are added to the best model.
    interface : int
        Fixed-interface modes of the condensed model that those with contact that opens are judged
        by.
    best : int
        Fewest joint modes of the best model, which others are compared with where numbers of modes
        are judged; it has at least as many as the larger model.
    margin : float
        Share of the accuracy that differences to the best model may take, but all of it with the
        largest of the usual numbers of modes: each mode more costs time in every step.
    energies : float
        Error of energies that is allowed, over that of displacement histories.
    least, most : float
        Least and most factor on the difference of a run to that of the larger model.
    """

    modes: tuple[int, ...] = (20, 28, 40)
    many: int = 84
    larger: float = 1.5
    checks: int = 4
    judged: int = 1
    cycles: int = 3
    steps: int = 100
    missing: int = 16
    interface: int = 24
    best: int = 64
    margin: float = 0.5
    energies: float = 3.0
    least: float = 2.0
    most: float = 5.0


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
        tried = SETTINGS.modes if isinstance(modes, str) else (modes,)
        fitted = self._fitted(checked, tried)
        if isinstance(modes, str) and fitted.worst > self.accuracy:
            self._follow_further(rough)
            fitted = self._fitted(checked, (SETTINGS.many,))
        larger = replace(fitted.larger.with_contact(shares=None), T=None, serves=None)
        serves = replace(self._serves(larger), **self._stated(fitted, checked))
        serves = replace(serves, reached=max(fitted.worst, 1e-12))
        if serves.shortfall is not None:
            _log.warning("%s.", serves.shortfall)
        return replace(fitted.small, serves=serves)

    def _trained(self) -> tuple[System, list[Point]]:
        """Rough model of the first paths, and the points to check, after all paths are followed."""
        first, count = TRAINING.first, TRAINING.first + TRAINING.more
        places = spread(self.system.contact.joints, self.range, count + SETTINGS.checks)
        levels, factor = [], 1.0
        for place in places[:first]:
            levels.append(factor * self.pool.nominal(place))
            peak = self.pool.follow(replace(place, slip=1.0, level=levels[-1])).slip_peak
            sticks = self.system.contact.least_share(peak <= THRESHOLD * peak.max())
            if sticks > TRAINING.still:
                factor *= TRAINING.raised
            elif sticks < 0.1 * TRAINING.still:
                factor /= float(np.sqrt(TRAINING.raised))
        self._know(places[:first], levels)
        rough = self._with(self.pool.proper(), TRAINING.rough)
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
        """Follow paths where two models of the pool differ most, of points not used before."""
        used = TRAINING.first + TRAINING.more + SETTINGS.checks
        count = used + TRAINING.rounds * TRAINING.candidates
        places = spread(self.system.contact.joints, self.range, count)
        for start in range(used, count, TRAINING.candidates):
            proper, judged = self.pool.proper(), []
            pair = [self._with(proper, modes) for modes in (SETTINGS.modes[-1], SETTINGS.many)]
            for place in places[start : start + TRAINING.candidates]:
                point = self._inside(place, _level(rough, place))
                judged.append((self._error(*(self._run(model, point) for model in pair)), point))
            judged.sort(key=lambda item: item[0], reverse=True)
            for _, point in judged[: TRAINING.followed]:
                self.pool.follow(point)

    @cached_property
    def _exact(self) -> System | None:
        """Condensed model of contact that opens, which is rigid where the full model's is.

        Where limits are constant the residual in the full equation shows what a model misses, and
        none is made: it would be slow where contact is large.
        """
        if not self.system.contact.opens:
            return None
        basis = condensed_basis(self.system, SETTINGS.interface, self.range.frequency[1])
        return condensed_system(self.system, basis.V)

    def _fitted(self, checked: list[Point], numbers: Sequence[int]) -> _Fitted:
        """Model with the first number of modes that suffices at the checked points."""
        proper = self.pool.proper()
        most = int(np.count_nonzero(proper.singular_values > 1e-7 * proper.singular_values[0]))
        tried = list(dict.fromkeys(min(count, most) for count in numbers))
        top = 0
        for count in tried:
            wider = round(SETTINGS.larger * count)
            if wider > top:
                top = min(most, max(SETTINGS.best, wider))
                best = self._with(proper, top)
                truths = [self._run(self._exact or best, point) for point in checked]
            small = self._with(proper, count)
            runs = [self._run(small, point) for point in checked]
            worst = max(self._error(*pair) for pair in zip(truths, runs, strict=True))
            share = SETTINGS.margin if count < tried[-1] else 1.0
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
        return from_rest(there, SETTINGS.cycles, SETTINGS.steps, fields_every)

    def _stated(self, fitted: _Fitted, checked: list[Point]) -> dict[str, Any]:
        """By what a point states its errors: `Served.factors` and `Served.shared`.

        With constant limits the best model is run again, at one or some points, with the modes that
        its run misses. With contact that opens all truths are of the condensed model.
        """
        residual = Residual(self.system, self.pool.path.unshifted)
        errors, shown, shared = [], [], []
        for number, point in enumerate(checked):
            truth, run = fitted.truths[number], fitted.runs[number]
            if number < SETTINGS.judged and self._exact is None:
                truth = self._better(residual, fitted.V, fitted.best, point)
            larger = self._run(fitted.larger, point)
            errors.append(_apart(truth, run))
            shown.append(_apart(larger, run))
            shared.append(_apart(truth, larger) if self._exact else (0.0, 0.0))
        left = np.max(shared, axis=0)
        ratios = np.maximum(errors - left, 0.0) / np.maximum(shown, 1e-12)
        found = np.clip(ratios.max(axis=0), SETTINGS.least, SETTINGS.most)
        names = "history", "energy"
        values = {"factors": found.tolist(), "shared": left.tolist()}
        return {of: dict(zip(names, pair, strict=True)) for of, pair in values.items()}

    def _error(self, reference: Run, other: Run) -> float:
        """Distance of two runs, of which energies may err more."""
        history, energy = _apart(reference, other)
        return max(history, energy / SETTINGS.energies)

    def _better(self, residual: Residual, V: FloatArray, best: System, point: Point) -> Run:
        """Run of the best model with the modes that its run misses, with all friction points."""
        every = stride(SETTINGS.steps * SETTINGS.cycles, SETTINGS.steps)
        run = self._run(best, point, every)
        there = placed(self.system, point)
        missing = residual.under(there).missing_modes(V, run, SETTINGS.missing, V[:, :0])
        contact = run.system.contact
        model = there.widened(there.project(V), V, missing)
        model = shared_points(model, contact.shares, contact.w).no_steeper(contact.steepest)
        return from_rest(model, SETTINGS.cycles, SETTINGS.steps)


def _slipping(place: Point, level: float) -> Point:
    """A place at its share of the level at which the first joint slips as a whole."""
    return replace(place, level=(1.0 if place.slip is None else place.slip) * level)


def _level(rough: System, place: Point) -> float:
    """Level at which the first joint slips as a whole, of a rough model, or a guess."""
    level, guess = searched_level(rough, place)
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
    if not theirs > 0.0:
        return history, 0.0
    return history, abs(ours - theirs) / max(theirs, least_energy(reference))
