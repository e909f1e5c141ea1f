"""Fit of a structure's values to measured curves of frequency and damping over amplitude.

The free values p minimise the sum of squared residuals

    r = (model(p) + offset - measured) / standard deviation

of all fitted samples, by a trust-region method within bounds (`scipy.optimize.least_squares`) with
exact derivatives. Positive values are fitted by their logarithms. With J the derivatives of r at
the best values the covariance is (J^T J)^-1. Directions in which that reaches beyond the bounds are
not determined by the data: they are named, and their uncertainty is that of the bounds. A value is
named alone only if the sum of squares itself, followed to its bounds, says so.

A search ends in the minimum nearest to its start. Where that leaves a doubt (it misses the data, or
leaves a value at a bound, or derivatives promise more) it begins anew: from the best of some values
spread over the bounds (a Latin hypercube), and while data are missed from the minima of the nested
models, each with one of the keys as in the scene. The least minimum counts, so that none that
misses the data is worse than that of such a nested model.

Where the sum of squares is larger than deviations explain, the model misses the data. Covariances
are then multiplied by that sum over the degrees of freedom, and a note says so.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import chi2, norm, qmc

from skfem_joint.fitting.fit_model import FitModel, PredictedCurve
from skfem_joint.fitting.measured import MeasuredCurve, measured_curve
from skfem_joint.fitting.measured_table import QUANTITIES
from skfem_joint.ground.arrays import BoolArray, FloatArray
from skfem_joint.ground.errors import ConvergenceError, InputError, closest, first_of, refuse
from skfem_joint.ground.progress import Progress, silent
from skfem_joint.ground.values import at_least, check
from skfem_joint.scene import Scene, load_scene
from skfem_joint.structure.load import Load
from skfem_joint.structure.parameters import parameter, single_values
from skfem_joint.structure.structure import Structure

#: Lowest and highest value of a key that is free.
Bounds = tuple[float, float]


#: Relative change of the sum of squares, and of the values, at which it ends.
TOLERANCE = 1e-6
#: Most evaluations of the model.
EVALUATIONS = 60
#: Share of the width of the bounds by which a start on a bound is moved inside.
INSIDE = 1e-3
#: Confidence level of intervals and bands.
LEVEL = 0.95
#: Values of a Latin hypercube of which the best is a start: so many, and more for each key.
SPREAD = (4, 2)
#: Decrease of the sum of squares that derivatives may promise at a minimum, over the mean square
#: of the residuals, but at least over 1.
LEFT = 0.1


#: Amplitudes of a curve that is finer than the measured one.
FINE = 40
#: Width of a profile over that of the interval.
PROFILE = 1.3


class FitProblem:
    """Residuals of a structure beside measured curves, as a function of a vector.

    Samplers and programs of uncertainty quantification need no more than `residuals` or
    `log_likelihood`, which give the derivatives too.

    Parameters
    ----------
    scene : Scene, Structure, str or Path
    data : path, MeasuredCurve, or a sequence of these
        Measured curves, see :func:`skfem_joint.measured_curve`.
    free : mapping of str to tuple of float
        Lowest and highest value of each key that is free, such as ``"joint[0].friction"`` or
        ``"bolt[*].force"``. The fit starts from the value of the scene.
    loads : sequence of Load, optional
        Of a `Structure`; those of a scene are its own.

    Attributes
    ----------
    names : tuple of str
        Entries of the vector: the keys, then offsets such as "offset of ring_down: frequency".
    lowest, highest, start : ndarray, shape (k,)
        Bounds of the vector, infinite for offsets, and where a fit starts.
    low, high : ndarray, shape (k,)
        Bounds of the variables of the fit, see `inner`.
    curves : tuple of MeasuredCurve
    evaluations : int
        Evaluations of the model in the last search.

    Raises
    ------
    InputError
        For keys that cannot be varied or that lead to the same number, bounds that do not rise or
        do not contain the value, and data that fit no point.
    """

    def __init__(
        self,
        scene: Scene | Structure | str | Path,
        data: Any,
        free: Mapping[str, Bounds],
        loads: Sequence[Load] = (),
    ) -> None:
        self.scene = load_scene(scene) if isinstance(scene, str | Path) else scene
        if isinstance(self.scene, Scene):
            structure, loads = self.scene.structure().meshed("fit"), self.scene.loads()
            points = self.scene.output.points or None
        else:
            structure, points = self.scene, None
        if not free:
            raise InputError("fit: free: no key is free; give at least one with its bounds")
        every = data if isinstance(data, list | tuple) else [data]
        self.curves = tuple(
            one if isinstance(one, MeasuredCurve) else measured_curve(one) for one in every
        )
        if not any(curve.fitted.any() for curve in self.curves):
            raise InputError("fit: no sample of the data is fitted; widen lowest and highest")
        # A point with a direction needs all its components, beside the one along a load.
        mesh = structure.mesh
        places = {*mesh.points, *mesh.boundaries, *mesh.regions}
        more = [c.point for c in self.curves if c.direction is not None and c.point in places]
        if more:
            points = (*(structure.free_points if points is None else points), *more)
        self.model = FitModel(structure, tuple(free), loads, points)
        for curve in self.curves:
            curve.weights(self.model.points)
        self._bounds(free)
        self.evaluations = 0
        self._last: tuple[bytes, tuple[FloatArray, FloatArray]] | None = None

    def _bounds(self, free: Mapping[str, Bounds]) -> None:
        """Bounds and start of the vector; InputError as the class says."""
        wrong, keys, first = list[str](), self.model.keys, dict[Any, str]()
        for (key, pair), value in zip(free.items(), self.model.start.tolist(), strict=True):
            low, high = (float(x) for x in pair)
            if not (0.0 <= low < high < np.inf):
                wrong.append(f"fit: {key}: found bounds {low:g} to {high:g}, must rise from >= 0")
            elif not low <= value <= high:
                wrong.append(
                    f"fit: {key}: is {value:g} in the scene, must be within the bounds {low:g} to "
                    f"{high:g}: change the value, or the bounds"
                )
            places = parameter(self.model.structure, key).places
            if others := dict.fromkeys(first[place] for place in places if place in first):
                wrong.append(
                    f"fit: {key}: found beside {', '.join(others)}, which varies the same number; "
                    "leave one out"
                )
            first |= dict.fromkeys(places, key)
        named = Counter(curve.name for curve in self.curves if curve.offset)
        wrong += [
            f"fit: two sets of data with an offset have the name {name!r}; give each its own name"
            for name, count in sorted(named.items())
            if count > 1
        ]
        refuse(wrong)
        offsets = [(k, name) for k, curve in enumerate(self.curves) for name in curve.offset]
        self._offsets = {which: place for place, which in enumerate(offsets, len(keys))}
        self.names = (*keys, *(f"offset of {self.curves[k].name}: {name}" for k, name in offsets))
        bounds = [*(free[key] for key in keys), *[(-np.inf, np.inf)] * len(offsets)]
        self.lowest, self.highest = np.array(bounds, dtype=float).T
        self.start = np.append(self.model.start, np.zeros(len(offsets)))
        self._logarithmic = self.lowest > 0.0
        self.low, self.high = self.inner(self.lowest), self.inner(self.highest)

    def place(self, name: str) -> int:
        """Number of the entry of the vector with a name; InputError if there is none."""
        if name not in self.names:
            raise InputError(
                f"fit: found {name!r}{closest(name, self.names)}; there are {first_of(self.names)}"
            )
        return self.names.index(name)

    def residuals(self, vector: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Residuals of all fitted samples over their deviations, (r,), and derivatives, (r, k).

        Raises
        ------
        InputError, ConvergenceError
            If the structure has no curve at the measured amplitudes.
        """
        vector = np.asarray(vector, dtype=float)
        if self._last is not None and self._last[0] == vector.tobytes():
            return self._last[1]
        asked = [curve.displacement[curve.fitted] for curve in self.curves]
        rows, columns = list[FloatArray](), list[FloatArray]()
        for k, predicted in enumerate(self.predict(vector, asked)):
            curve = self.curves[k]
            if not predicted.inside.all():
                raise InputError(
                    f"fit: {curve.name}: the structure does not reach the largest amplitude"
                )
            for quantity in QUANTITIES:
                values, rates = self.beside(k, quantity, predicted, vector)
                measured = getattr(curve, quantity)[curve.fitted]
                deviation = getattr(curve, f"{quantity}_deviation")[curve.fitted]
                known = ~np.isnan(measured)
                rows.append(((values - measured) / deviation)[known])
                columns.append((rates / deviation[:, np.newaxis])[known])
        both = np.concatenate(rows), np.vstack(columns)
        self._last = vector.tobytes(), both
        return both

    def predict(self, vector: FloatArray, asked: Sequence[FloatArray]) -> list[PredictedCurve]:
        """Curves beside the measured ones at displacements of their points, (k,) each, m.

        Offsets are not included. InputError and ConvergenceError as `FitModel.predict`.
        """
        values = vector[: len(self.model.keys)].tolist()
        return self.model.predict(values, self.curves, asked)

    def beside(
        self, k: int | None, quantity: str, predicted: PredictedCurve, vector: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Frequency or damping beside measured curve ``k`` with its offset, and derivatives.

        Without a number there is no offset. Shapes are (samples,) and (samples, entries of the
        vector).
        """
        values, of_keys = (getattr(predicted, quantity + end) for end in ("", "_rates"))
        rates = np.hstack([of_keys, np.zeros((values.size, len(self._offsets)))])
        if k is not None and (place := self._offsets.get((k, quantity))) is not None:
            values = values + vector[place]
            rates[:, place] = 1.0
        return values, rates

    def log_likelihood(self, vector: FloatArray) -> tuple[float, FloatArray]:
        """Logarithm of the likelihood but for a constant, and its derivatives, (k,).

        Errors of the samples count as normal and independent.
        """
        r, J = self.residuals(vector)
        return -0.5 * float(r @ r), -(J.T @ r)

    def inner(self, vector: FloatArray) -> FloatArray:
        """The variables of the fit: logarithms, and offsets as they are."""
        return np.log(vector, out=np.array(vector, dtype=float), where=self._logarithmic)

    def outer(self, variables: FloatArray) -> FloatArray:
        """The vector, from the variables of the fit."""
        return np.exp(variables, out=np.array(variables, dtype=float), where=self._logarithmic)

    def entry(self, k: int, variable: float) -> float:
        """Entry k of the vector, from its variable."""
        return float(np.exp(variable) if self._logarithmic[k] else variable)

    def rates(self, vector: FloatArray) -> FloatArray:
        """Derivative of each entry of the vector by its variable, (k,)."""
        return np.where(self._logarithmic, vector, 1.0)

    def sizes(self) -> FloatArray:
        """Largest measured value beside each offset, and 1 of other entries, (k,)."""
        largest = [np.nanmax(getattr(self.curves[k], name)) for k, name in self._offsets]
        return np.append(np.ones(len(self.model.keys)), largest)

    def minimise(
        self, begin: FloatArray, held: int | None = None, progress: Progress = silent
    ) -> FloatArray:
        """Vector of least squares from a vector, whose entry ``held`` stays as it is.

        Evaluations are counted. ConvergenceError if the search does not end.
        """
        moves = np.arange(begin.size) != (-1 if held is None else held)
        if not moves.any():
            return begin
        low, high = self.low[moves], self.high[moves]
        inside = INSIDE * np.where(np.isfinite(high - low), high - low, 1.0)
        first = np.clip(self.inner(begin)[moves], low + inside, high - inside)
        size = 0

        def whole(x: FloatArray) -> FloatArray:
            variables = self.inner(begin)
            variables[moves] = x
            return self.outer(variables)

        def residuals(x: FloatArray) -> FloatArray:
            self.evaluations += 1
            progress("fit", self.evaluations, 0, f"evaluation {self.evaluations}")
            try:
                return self.residuals(whole(x))[0]
            except (InputError, ConvergenceError):
                if not size:
                    raise
                return np.full(size, np.nan)  # the method tries a smaller step

        def derivatives(x: FloatArray) -> FloatArray:
            vector = whole(x)
            return np.asarray((self.residuals(vector)[1] * self.rates(vector))[:, moves])

        size = residuals(first).size
        found = least_squares(
            residuals, first, derivatives, (low, high), x_scale="jac",
            ftol=TOLERANCE, xtol=TOLERANCE, gtol=None, max_nfev=EVALUATIONS,
        )  # fmt: skip
        if found.status <= 0:
            raise ConvergenceError(
                f"fit: the best values were not found in {EVALUATIONS} evaluations; start "
                "nearer, or narrow the bounds"
            )
        return whole(found.x)

    def squares(self, vector: FloatArray) -> float:
        """Sum of squares of the residuals; ``inf`` where the structure has no curve."""
        try:
            r = self.residuals(vector)[0]
        except (InputError, ConvergenceError):
            return np.inf
        return float(r @ r)

    def on_bound(self, vector: FloatArray) -> BoolArray:
        """Whether each entry lies on one of its bounds, (k,)."""
        x, width = self.inner(vector), self.high - self.low
        near = np.where(np.isfinite(width), 2.0 * INSIDE * width, -1.0)
        return np.asarray(np.minimum(x - self.low, self.high - x) <= near)

    def decrease(self, vector: FloatArray) -> float:
        """How much less the sum of squares should get from here, by its derivatives.

        Entries on a bound beyond which it would get less stay there.
        """
        r, J = self.residuals(vector)
        J, x = J * self.rates(vector), self.inner(vector)
        below = x - self.low < self.high - x
        outward = np.where(below, J.T @ r > 0.0, J.T @ r < 0.0)
        J = J[:, ~(self.on_bound(vector) & outward)]
        promised = J @ np.linalg.lstsq(J, r, rcond=1e-8)[0]
        return float(promised @ promised)

    def misses(self, vector: FloatArray) -> bool:
        """Whether the sum of squares is larger than deviations explain."""
        r = self.residuals(vector)[0]
        return _widened(float(r @ r), r.size - vector.size)[0] > 1.0

    def doubtful(self, vector: FloatArray) -> bool:
        """Whether a minimum may not be the least."""
        stalls = self.decrease(vector) > LEFT
        return bool(stalls or self.misses(vector) or self.on_bound(vector).any())

    def spread(self) -> FloatArray:
        """Vectors of a Latin hypercube within the bounds, without offsets, (starts, k)."""
        keys = len(self.model.keys)
        count = SPREAD[0] + SPREAD[1] * keys
        low, high = self.low[:keys], self.high[:keys]
        shares = qmc.LatinHypercube(keys, rng=np.random.default_rng(0)).random(count)
        inner = np.tile(self.inner(self.start), (count, 1))
        inner[:, :keys] = low + shares * (high - low)
        return np.array([self.outer(x) for x in inner])

    def best(self, progress: Progress = silent) -> tuple[FloatArray, int]:
        """The vector of the least minimum, and searches that were made for it.

        ConvergenceError if no search ends.
        """
        searches, keys, self.evaluations = 0, len(self.model.keys), 0
        ends, errors = list[FloatArray](), list[ConvergenceError]()

        def minimum(begin: FloatArray, held: int | None = None) -> FloatArray | None:
            try:
                return self.minimise(begin, held, progress)
            except ConvergenceError as error:
                errors.append(error)
                return None

        def starts() -> Iterator[FloatArray]:
            yield self.start
            if ends and not self.doubtful(ends[0]):
                return
            several = self.spread()
            squares = np.array([self.squares(vector) for vector in several])
            self.evaluations += squares.size
            if np.isfinite(squares).any():
                yield several[squares.argmin()]
            for held in range(keys) if keys > 1 else ():  # nested models, each without one key
                if ends and not self.misses(min(ends, key=self.squares)):
                    return
                if (nested := minimum(self.start, held)) is not None:
                    yield nested

        for begin in starts():
            searches += 1
            if (vector := minimum(begin)) is not None:
                ends.append(vector)
        if not ends:
            raise errors[0]
        return min(ends, key=self.squares), searches


@dataclass(frozen=True)
class Profile:
    """Profile likelihood of a value: the least sum of squares with the value held.

    Unlike an interval from the covariance, one from the profile does not take the model as linear.

    Attributes
    ----------
    name : str
        Key or offset.
    values : ndarray, shape (k,)
        Rising; the best one among them.
    excess : ndarray, shape (k,)
        Least sum of squares of all others beyond that of the best fit, over ``widened`` squared.
    interval : tuple of float
        Where the excess is that of the level; a bound or the end of the values if it stays below.
    """

    name: str
    values: FloatArray
    excess: FloatArray
    interval: tuple[float, float]


@dataclass(frozen=True)
class Fit:
    """Values of a structure that fit measured curves best, with their uncertainty.

    Attributes
    ----------
    problem : FitProblem
    vector : ndarray, shape (k,)
        Best values, then offsets, in the order of ``problem.names``.
    covariance : ndarray, shape (k, k)
        Of the vector; of directions that the data do not determine that of the bounds.
    sum_of_squares : float
        Of the residuals over their deviations.
    degrees : int
        Samples less what was fitted.
    widened : float
        Factor on the deviations because the model misses the data; 1 if it does not.
    undetermined : tuple of str
        Sentences about what the data do not determine.
    predicted : tuple of PredictedCurve
        At all measured amplitudes, offsets not included.
    evaluations, computed : int
        Evaluations of the model, and backbones that were computed for them.
    searches : int
        Starts from which a minimum was searched.
    seconds : float
        Duration, s.
    notes : tuple of str
        What to beware of.
    """

    problem: FitProblem = field(repr=False)
    vector: FloatArray
    covariance: FloatArray
    sum_of_squares: float
    degrees: int
    widened: float
    undetermined: tuple[str, ...]
    predicted: tuple[PredictedCurve, ...]
    evaluations: int
    computed: int
    searches: int
    seconds: float
    notes: tuple[str, ...]

    @property
    def values(self) -> dict[str, float]:
        """Best value of each free key."""
        return dict(zip(self.problem.model.keys, self.vector.tolist(), strict=False))

    @property
    def offsets(self) -> dict[str, float]:
        """What is added to the model, by the name of the offset; Hz, or a damping ratio."""
        pairs = zip(self.problem.names, self.vector.tolist(), strict=True)
        return dict([*pairs][len(self.problem.model.keys) :])

    @property
    def deviations(self) -> dict[str, float]:
        """Standard deviation of each value and offset."""
        each = np.sqrt(np.diag(self.covariance))
        return dict(zip(self.problem.names, each.tolist(), strict=True))

    @property
    def scene(self) -> Scene:
        """The scene with the best values; InputError if a structure was fitted."""
        if not isinstance(self.problem.scene, Scene):
            raise InputError("fit: a structure was fitted; it is problem.model.at(values)")
        model = self.problem.model
        return self.problem.scene.changed(single_values(model.structure, self.values))

    def interval(self, name: str, level: float = LEVEL) -> tuple[float, float]:
        """Confidence interval of a value or an offset, within its bounds."""
        problem, k = self.problem, self.problem.place(name)
        low, high = float(problem.lowest[k]), float(problem.highest[k])
        own = np.sqrt(self._inner_covariance[k, k]) * norm.ppf(0.5 + 0.5 * level)
        if own >= 0.499 * (problem.high[k] - problem.low[k]):  # not determined
            return low, high
        best = problem.inner(self.vector)[k]
        return max(low, problem.entry(k, best - own)), min(high, problem.entry(k, best + own))

    @cached_property
    def _inner_covariance(self) -> FloatArray:
        """Covariance of the variables of the fit."""
        rates = self.problem.rates(self.vector)
        return np.asarray(self.covariance / np.outer(rates, rates))

    def profile(
        self,
        name: str,
        points: int = 9,
        level: float = LEVEL,
        progress: Progress = silent,
    ) -> Profile:
        """Profile likelihood of a value or an offset over somewhat more than its interval.

        Each point of it is a fit of all others, from where the covariance expects them.

        Parameters
        ----------
        name : str
        points : int
            Values, at least 3; the best one is added if it is not among them.
        level : float
            Confidence level of the interval.
        progress : callable, optional
            Called with ("profile of NAME", values done, values).

        Raises
        ------
        InputError
            For an unknown name, and if the structure has no curve with a value.
        ConvergenceError
            If a fit does not end.
        """
        problem, k = self.problem, self.problem.place(name)
        check("profile: points", points, at_least(3))
        best = problem.inner(self.vector)
        own = self._inner_covariance[:, k] / self._inner_covariance[k, k]
        limit = float(norm.ppf(0.5 + 0.5 * level))
        wide = PROFILE * limit * np.sqrt(self._inner_covariance[k, k])
        ends = best[k] + wide * np.array([-1.0, 1.0])
        low, high = np.clip(ends, problem.low[k], problem.high[k]).tolist()
        at = np.unique(np.append(np.linspace(low, high, points), best[k]))
        excess = np.zeros(at.size)
        for j, x in enumerate(at.tolist()):
            progress(f"profile of {name}", j, at.size)
            if x != best[k]:
                begin = best + own * (x - best[k])
                begin[k] = x
                vector = np.clip(problem.outer(begin), problem.lowest, problem.highest)
                r = problem.residuals(problem.minimise(vector, held=k))[0]
                excess[j] = (float(r @ r) - self.sum_of_squares) / self.widened**2
        # The root of the excess is linear in the value where the model is.
        place, root = int(np.searchsorted(at, best[k])), np.sqrt(np.maximum(excess, 0.0))
        below = np.interp(-limit, -root[: place + 1], at[: place + 1])
        above = np.interp(limit, root[place:], at[place:])
        values = [problem.entry(k, x) for x in (*at.tolist(), below, above)]
        return Profile(name, np.array(values[:-2]), excess, (values[-2], values[-1]))

    def band(
        self, predicted: PredictedCurve, level: float = LEVEL, number: int | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Half widths of the band of a curve by the uncertainty of the values, (k,) each.

        Of the frequency, Hz, and of the damping ratio, to first order. ``number`` is that of a
        measured curve whose offsets count too.
        """
        beside = (self.problem.beside(number, q, predicted, self.vector) for q in QUANTITIES)
        rates = np.array([of_values for _, of_values in beside])
        variance = np.einsum("qki,ij,qkj->qk", rates, self.covariance, rates)
        frequency, damping = norm.ppf(0.5 + 0.5 * level) * np.sqrt(np.maximum(variance, 0.0))
        return frequency, damping

    def curves(self) -> list[MeasuredCurve]:
        """Curves of the structure beside each measured one, finer than it, as far as it reaches.

        They have the form of measured ones, with offsets added. Deviations are the half widths of
        their bands by the uncertainty of values and offsets.

        InputError and ConvergenceError as `FitModel.predict`.
        """
        problem, fine = self.problem, []
        places = [_finer(curve) for curve in problem.curves]
        found = problem.predict(self.vector, [displacement for _, displacement in places])
        for k, (predicted, (amplitude, _)) in enumerate(zip(found, places, strict=True)):
            columns: dict[str, Any] = {"amplitude": amplitude, "fitted": predicted.inside}
            for name, band in zip(QUANTITIES, self.band(predicted, number=k), strict=True):
                columns[name] = problem.beside(k, name, predicted, self.vector)[0]
                columns[f"{name}_deviation"] = band
            columns = {name: values[predicted.inside] for name, values in columns.items()}
            fine.append(replace(problem.curves[k], **columns))
        return fine

    def draws(self, count: int, seed: int = 0) -> list[dict[str, float]]:
        """Values of the free keys drawn from their distribution to first order.

        For bands of any other result: ``scene.changed(values)`` for each of them, then a quantile
        of the results. Values beyond bounds are moved to them.
        """
        keys, problem = self.problem.model.keys, self.problem
        random = np.random.default_rng(seed)
        best = problem.inner(self.vector)
        some = random.multivariate_normal(best, self._inner_covariance, count, method="eigh")
        vectors = (np.clip(problem.outer(x), problem.lowest, problem.highest) for x in some)
        return [dict(zip(keys, x.tolist(), strict=False)) for x in vectors]


def _finer(curve: MeasuredCurve) -> tuple[FloatArray, FloatArray]:
    """Amplitudes in equal ratios over the range of a curve, and their displacements (m)."""
    known, place = np.unique(np.log(curve.amplitude), return_inverse=True)
    mean = np.bincount(place, np.log(curve.displacement)) / np.bincount(place)
    wanted = np.linspace(known[0], known[-1], FINE if known.size > 1 else 1)
    return np.exp(wanted), np.exp(np.interp(wanted, known, mean))


def fit(
    scene: Scene | Structure | str | Path,
    data: Any,
    free: Mapping[str, Bounds],
    loads: Sequence[Load] = (),
    progress: Progress = silent,
) -> Fit:
    """Values of a scene or structure that fit measured curves of frequency and damping best.

    Parameters
    ----------
    scene, data, free, loads
        As `FitProblem` takes them.
    progress : callable, optional
        Called with ("fit", evaluations, 0, note).

    Returns
    -------
    Fit

    Raises
    ------
    InputError
        As `FitProblem`, and if the structure has no curve at the measured amplitudes with the
        values of the scene.
    ConvergenceError
        If the best values are not found.
    """
    return solved(FitProblem(scene, data, free, loads), progress)


def solved(problem: FitProblem, progress: Progress = silent) -> Fit:
    """Best values of a problem and their uncertainty, as `fit` returns them.

    InputError and ConvergenceError as `fit`.
    """
    began = time.perf_counter()
    vector, searches = problem.best(progress)
    r, J = problem.residuals(vector)
    squares, degrees = float(r @ r), r.size - vector.size
    widened, notes = _widened(squares, degrees)
    left = problem.decrease(vector)
    if stalls := left > LEFT * widened**2:
        notes.append(
            f"The search ended where its derivatives promise a sum of squares less by {left:.3g}: "
            "the curves have a kink there, or these are not the best values. Start it from others."
        )
    inner, undetermined = _covariance(problem, vector, J / widened, widened, stalls)
    rates = problem.rates(vector)
    predicted = problem.predict(vector, [curve.displacement for curve in problem.curves])
    problem.model.let_go()
    notes += [note for curve in problem.curves for note in curve.notes]
    notes += [
        f"{problem.names[k]} ends at its bound, {vector[k]:.6g}: the data ask for a value beyond "
        "it."
        for k in np.flatnonzero(problem.on_bound(vector)).tolist()
    ]
    return Fit(
        problem=problem,
        vector=vector,
        covariance=inner * np.outer(rates, rates),
        sum_of_squares=squares,
        degrees=degrees,
        widened=widened,
        undetermined=tuple(undetermined),
        predicted=tuple(predicted),
        evaluations=problem.evaluations,
        computed=problem.model.computed,
        searches=searches,
        seconds=time.perf_counter() - began,
        notes=tuple(notes),
    )


def _widened(squares: float, degrees: int) -> tuple[float, list[str]]:
    """Factor on deviations where the model misses the data, and a note about it."""
    if degrees <= 0:
        return 1.0, [f"There are {-degrees} values more than samples can determine."] * (
            degrees < 0
        )
    # A sum of squares that is larger with this probability says that the model misses the data.
    if squares <= chi2.isf(0.01, degrees):
        return 1.0, []
    factor = float(np.sqrt(squares / degrees))
    return factor, [
        f"The model misses the data by {factor:.3g} times their standard deviations in the mean "
        "square: either these are too small, or the model lacks something. Deviations and "
        "intervals are widened by that factor."
    ]


def _covariance(
    problem: FitProblem, vector: FloatArray, J: FloatArray, widened: float, stalls: bool
) -> tuple[FloatArray, list[str]]:
    """Covariance of the variables of the fit, and sentences about undetermined directions.

    ``J``, (r, k), are the derivatives of residuals over their (widened) deviations. Where the
    search ``stalls``, sentences are about directions without any effect alone; there are none where
    a value lies on its bound though another does not fit as well.
    """
    sentences, inner = list[str](), problem.inner(vector)
    width = 0.5 * (problem.high - problem.low)
    scale = np.where(np.isfinite(width), width, problem.sizes())
    _, size, right = np.linalg.svd(J * problem.rates(vector) * scale, full_matrices=True)
    # Principal directions: a length of 1 reaches from the middle of the bounds to their ends.
    axes, size = right.T * scale[:, np.newaxis], np.append(size, np.zeros(len(right) - size.size))
    factor = float(norm.ppf(0.5 + 0.5 * LEVEL))
    spread = 1.0 / np.maximum(size, factor)  # their standard deviations, at most that of bounds
    bound = problem.on_bound(vector)
    # At a kink derivatives change, but those that vanish to round-off vanish on both sides.
    least = min(factor, 1e-6 * size[0]) if stalls else factor
    for j in np.flatnonzero(size <= least).tolist():
        k, *others = _members(axes[:, j])
        if others:
            if not bound[[k, *others]].any():
                sentences.append(_undetermined(problem, axes[:, j], k, others))
            continue
        low, high = (
            _as_well(problem, vector, k, end, widened) for end in (problem.low, problem.high)
        )
        to_low, to_high = low == problem.low[k], high == problem.high[k]
        values = "any value within its bounds fits"
        if not (to_low and to_high):
            spread[j] = max(high - inner[k], inner[k] - low) / (width[k] * factor)
            ends = problem.entry(k, low), problem.entry(k, high)
            values = "any value from {:.3g} to {:.3g} fits".format(*ends)
        if to_low or to_high:
            sentences.append(f"The data do not determine {problem.names[k]}: {values} as well.")
    return (axes * spread**2) @ axes.T, sentences


def _as_well(
    problem: FitProblem, vector: FloatArray, k: int, ends: FloatArray, widened: float
) -> float:
    """How far the variable k reaches to one of the ``ends`` while the data are fitted as well.

    That is while the sum of squares rises by less than the level of an interval allows.
    """
    best = problem.inner(vector)
    most = problem.squares(vector) + widened**2 * chi2.ppf(LEVEL, 1)

    def fits(x: float) -> bool:
        changed = best.copy()
        changed[k] = x
        return bool(problem.squares(problem.outer(changed)) <= most)

    near, far = float(best[k]), float(ends[k])
    if fits(far):
        return far
    # Halvings of the range up to a bound, to find how far a value fits as well.
    for _ in range(4):
        middle = 0.5 * (near + far)
        near, far = (middle, far) if fits(middle) else (near, middle)
    return near


def _members(direction: FloatArray) -> list[int]:
    """Entries of the vector that belong to a direction of the variables, (k,), largest first."""
    size = np.round(np.abs(direction) / np.abs(direction).max(), 3)  # equal shares in given order
    order = np.argsort(-size, kind="stable")
    # Share of the largest component from which on a value belongs to an undetermined direction.
    return [k for k in order.tolist() if size[k] >= 0.1]


def _undetermined(problem: FitProblem, direction: FloatArray, first: int, others: list[int]) -> str:
    """Sentence about a direction, (k,), of some values that the data do not determine."""
    names = [problem.names[k] for k in (first, *others)]
    powers = ", ".join(
        f"{problem.names[k]} by its power {direction[k] / direction[first]:.2f}" for k in others
    )
    return (
        f"The data do not determine {' and '.join(names)} each by itself: they fit as well if "
        f"{names[0]} changes by a factor and {powers}."
    )
