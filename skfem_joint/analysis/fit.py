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
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import chi2, norm, qmc

from skfem_joint.analysis.fit_model import FitModel, PredictedCurve
from skfem_joint.analysis.measured import MeasuredCurve, measured_curve
from skfem_joint.arrays import BoolArray, FloatArray, IntArray
from skfem_joint.errors import ConvergenceError, InputError, closest, first_of, refuse
from skfem_joint.progress import Progress, silent
from skfem_joint.scene import Scene, load_scene
from skfem_joint.structure.load import Load
from skfem_joint.structure.parameters import parameter, single_values
from skfem_joint.structure.structure import Structure
from skfem_joint.values import at_least, check

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
    curves : tuple of MeasuredCurve

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
        self._last: tuple[bytes, tuple[FloatArray, FloatArray]] | None = None

    def _bounds(self, free: Mapping[str, Bounds]) -> None:
        """Bounds and start of the vector; InputError as the class says."""
        wrong, keys = list[str](), self.model.keys
        for (key, pair), value in zip(free.items(), self.model.start.tolist(), strict=True):
            low, high = (float(x) for x in pair)
            if not (0.0 <= low < high < np.inf):
                wrong.append(f"fit: {key}: found bounds {low:g} to {high:g}, must rise from >= 0")
            elif not low <= value <= high:
                wrong.append(
                    f"fit: {key}: is {value:g} in the scene, must be within the bounds {low:g} to "
                    f"{high:g}: change the value, or the bounds"
                )
        wrong += self._repeated()
        named = [curve.name for curve in self.curves if curve.offset]
        wrong += [
            f"fit: two sets of data with an offset have the name {name!r}; give each its own name"
            for name in sorted({name for name in named if named.count(name) > 1})
        ]
        refuse(wrong)
        self._offsets = [
            (k, quantity) for k, curve in enumerate(self.curves) for quantity in curve.offset
        ]
        offsets = [f"offset of {self.curves[k].name}: {q}" for k, q in self._offsets]
        self.names = (*keys, *offsets)
        more = np.zeros(len(offsets))
        low_high = np.array([free[key] for key in keys], dtype=float)
        self.lowest = np.append(low_high[:, 0], more - np.inf)
        self.highest = np.append(low_high[:, 1], more + np.inf)
        self.start = np.append(self.model.start, more)

    def _repeated(self) -> list[str]:
        """Sentences about keys that lead to the same number, which has one value."""
        structure, first, wrong = self.model.structure, dict[Any, str](), list[str]()
        for key in self.model.keys:
            places = parameter(structure, key).places
            if others := dict.fromkeys(first[place] for place in places if place in first):
                wrong.append(
                    f"fit: {key}: found beside {', '.join(others)}, which varies the same number; "
                    "leave one out"
                )
            first |= dict.fromkeys(places, key)
        return wrong

    @cached_property
    def _logarithmic(self) -> Any:
        """Whether each entry of the vector is fitted by its logarithm, (k,)."""
        return self.lowest > 0.0

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
        count = len(self.model.keys)
        found = self.model.predict(vector[:count].tolist(), self.curves, every=False)
        rows, columns = list[FloatArray](), list[FloatArray]()
        for k, (curve, predicted) in enumerate(zip(self.curves, found, strict=True)):
            if not predicted.inside.all():
                raise InputError(
                    f"fit: {curve.name}: the structure does not reach the largest amplitude"
                )
            for quantity, values, rates in (
                ("frequency", predicted.frequency, predicted.frequency_rates),
                ("damping", predicted.damping, predicted.damping_rates),
            ):
                measured = getattr(curve, quantity)[curve.fitted]
                deviation = getattr(curve, f"{quantity}_deviation")[curve.fitted]
                known = ~np.isnan(measured)
                of_offset = np.zeros((known.size, len(self._offsets)))
                if (k, quantity) in self._offsets:
                    of_offset[:, self._offsets.index((k, quantity))] = 1.0
                all_rates = np.hstack([rates, of_offset])
                difference = values + of_offset @ vector[count:] - measured
                rows.append((difference / deviation)[known])
                columns.append((all_rates / deviation[:, np.newaxis])[known])
        both = np.concatenate(rows), np.vstack(columns)
        self._last = vector.tobytes(), both
        return both

    def log_likelihood(self, vector: FloatArray) -> tuple[float, FloatArray]:
        """Logarithm of the likelihood but for a constant, and its derivatives, (k,).

        Errors of the samples count as normal and independent.
        """
        r, J = self.residuals(vector)
        return -0.5 * float(r @ r), -(J.T @ r)

    def inner(self, vector: FloatArray) -> FloatArray:
        """The variables of the fit: logarithms, and offsets as they are."""
        safe = np.where(self._logarithmic, vector, 1.0)
        return np.where(self._logarithmic, np.log(safe), vector)

    def outer(self, variables: FloatArray) -> FloatArray:
        """The vector, from the variables of the fit."""
        logarithms = np.where(self._logarithmic, variables, 0.0)
        return np.where(self._logarithmic, np.exp(logarithms), variables)

    def rates(self, vector: FloatArray) -> FloatArray:
        """Derivative of each entry of the vector by its variable, (k,)."""
        return np.where(self._logarithmic, vector, 1.0)

    def sizes(self) -> FloatArray:
        """Largest measured value beside each offset, and 1 of other entries, (k,)."""
        largest = [np.nanmax(getattr(self.curves[k], quantity)) for k, quantity in self._offsets]
        return np.append(np.ones(len(self.model.keys)), largest)

    def minimise(
        self, begin: FloatArray, held: int | None = None, progress: Progress = silent
    ) -> tuple[FloatArray, int]:
        """Vector of least squares from a vector, and the evaluations that it took.

        The entry ``held`` stays as it is. ConvergenceError if the search does not end.
        """
        moves = np.arange(begin.size) != (-1 if held is None else held)
        if not moves.any():
            return begin, 0
        low, high = (self.inner(x)[moves] for x in (self.lowest, self.highest))
        width = np.where(np.isfinite(high - low), high - low, 1.0)
        inside = INSIDE * width
        first = np.clip(self.inner(begin)[moves], low + inside, high - inside)
        count = 0

        def whole(x: FloatArray) -> FloatArray:
            variables = self.inner(begin)
            variables[moves] = x
            return self.outer(variables)

        def residuals(x: FloatArray) -> FloatArray:
            nonlocal count
            count += 1
            progress("fit", count, 0, f"evaluation {count}")
            try:
                return self.residuals(whole(x))[0]
            except (InputError, ConvergenceError):
                if count == 1:
                    raise
                return np.full(self._size, np.nan)  # the method tries a smaller step

        def derivatives(x: FloatArray) -> FloatArray:
            vector = whole(x)
            return np.asarray((self.residuals(vector)[1] * self.rates(vector))[:, moves])

        self._size = residuals(first).size
        found = least_squares(
            residuals, first, derivatives, (low, high), x_scale="jac",
            ftol=TOLERANCE, xtol=TOLERANCE, gtol=None,
            max_nfev=EVALUATIONS,
        )  # fmt: skip
        if found.status <= 0:
            raise ConvergenceError(
                f"fit: the best values were not found in {EVALUATIONS} evaluations; start "
                "nearer, or narrow the bounds"
            )
        return whole(found.x), count

    def squares(self, vector: FloatArray) -> float:
        """Sum of squares of the residuals; ``inf`` where the structure has no curve."""
        try:
            r = self.residuals(vector)[0]
        except (InputError, ConvergenceError):
            return np.inf
        return float(r @ r)

    def on_bound(self, vector: FloatArray) -> BoolArray:
        """Whether each entry lies on one of its bounds, (k,)."""
        x, low, high = (self.inner(v) for v in (vector, self.lowest, self.highest))
        near = np.where(np.isfinite(high - low), 2.0 * INSIDE * (high - low), -1.0)
        return np.asarray(np.minimum(x - low, high - x) <= near)

    def decrease(self, vector: FloatArray) -> float:
        """How much less the sum of squares should get from here, by its derivatives.

        Entries on a bound beyond which it would get less stay there.
        """
        r, J = self.residuals(vector)
        J = J * self.rates(vector)
        below = self.inner(vector) - self.inner(self.lowest) < self.inner(self.highest) - (
            self.inner(vector)
        )
        outward = np.where(below, J.T @ r > 0.0, J.T @ r < 0.0)
        J = J[:, ~(self.on_bound(vector) & outward)]
        U, size, _ = np.linalg.svd(J, full_matrices=False)
        U = U[:, size > 1e-8 * size.max(initial=0.0)]
        return float(np.sum((U.T @ r) ** 2))

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
        low, high = (self.inner(x)[:keys] for x in (self.lowest, self.highest))
        shares = qmc.LatinHypercube(keys, rng=np.random.default_rng(0)).random(count)
        inner = np.tile(self.inner(self.start), (count, 1))
        inner[:, :keys] = low + shares * (high - low)
        return np.array([self.outer(x) for x in inner])

    def best(self, progress: Progress = silent) -> tuple[FloatArray, int, int]:
        """The vector of the least minimum, evaluations, and searches that were made for it.

        ConvergenceError if no search ends.
        """
        count, keys = 0, len(self.model.keys)
        ends, errors = list[FloatArray](), list[ConvergenceError]()

        def told(what: str, done: int, total: int, note: str = "") -> None:
            progress(what, count + done, total, f"evaluation {count + done}")

        def search(begin: FloatArray, held: int | None = None) -> FloatArray | None:
            nonlocal count
            try:
                vector, taken = self.minimise(begin, held, told)
            except ConvergenceError as error:
                errors.append(error)
                return None
            count += taken
            return vector

        def begins() -> Iterator[FloatArray]:
            """Starts, as long as there is a doubt."""
            nonlocal count
            yield self.start
            if ends and not self.doubtful(ends[-1]):
                return
            several = self.spread()
            squares = np.array([self.squares(vector) for vector in several])
            count += squares.size
            if np.isfinite(squares).any():
                yield several[squares.argmin()]
            for held in range(keys) if keys > 1 else ():  # nested models, each without one key
                if ends and not self.misses(min(ends, key=self.squares)):
                    return
                if (vector := search(self.start, held)) is not None:
                    yield vector

        searches = 0
        for begin in begins():
            searches += 1
            if (vector := search(begin)) is not None:
                ends.append(vector)
        if not ends:
            raise errors[0]
        return min(ends, key=self.squares), count, searches


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
        keys = self.problem.model.keys
        return dict(zip(keys, self.vector[: len(keys)].tolist(), strict=True))

    @property
    def offsets(self) -> dict[str, float]:
        """What is added to the model, by the name of the offset; Hz, or a damping ratio."""
        count = len(self.problem.model.keys)
        names = self.problem.names[count:]
        return dict(zip(names, self.vector[count:].tolist(), strict=True))

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
        k = self.problem.place(name)
        best = self.problem.inner(self.vector)[k]
        own = np.sqrt(self._inner_covariance[k, k]) * norm.ppf(0.5 + 0.5 * level)
        width = (
            self.problem.inner(self.problem.highest)[k] - self.problem.inner(self.problem.lowest)[k]
        )
        if own >= 0.499 * width:  # not determined
            return float(self.problem.lowest[k]), float(self.problem.highest[k])
        variables = self.problem.inner(self.vector)
        low, high = (self._with(variables, k, end) for end in (best - own, best + own))
        return max(low, float(self.problem.lowest[k])), min(high, float(self.problem.highest[k]))

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
        low, high = (problem.inner(x)[k] for x in (problem.lowest, problem.highest))
        own = self._inner_covariance[:, k] / self._inner_covariance[k, k]
        wide = PROFILE * norm.ppf(0.5 + 0.5 * level) * np.sqrt(self._inner_covariance[k, k])
        ends = np.maximum(best[k] - wide, low), np.minimum(best[k] + wide, high)
        at = np.unique(np.append(np.linspace(*ends, points), best[k]))
        excess = np.zeros(at.size)
        for j, x in enumerate(at.tolist()):
            progress(f"profile of {name}", j, at.size)
            if x != best[k]:
                begin = best + own * (x - best[k])
                begin[k] = x
                vector = np.clip(problem.outer(begin), problem.lowest, problem.highest)
                r = problem.residuals(problem.minimise(vector, held=k)[0])[0]
                excess[j] = (float(r @ r) - self.sum_of_squares) / self.widened**2
        # The root of the excess is linear in the value where the model is.
        place, root = int(np.searchsorted(at, best[k])), np.sqrt(np.maximum(excess, 0.0))
        limit = float(np.sqrt(chi2.ppf(level, 1)))
        below = np.interp(-limit, -root[: place + 1], at[: place + 1])
        above = np.interp(limit, root[place:], at[place:])
        values = [self._with(best, k, x) for x in (*at.tolist(), below, above)]
        return Profile(name, np.array(values[:-2]), excess, (values[-2], values[-1]))

    def _with(self, variables: FloatArray, k: int, value: float) -> float:
        """Entry k of the vector, from its variable."""
        changed = variables.copy()
        changed[k] = value
        return float(self.problem.outer(changed)[k])

    def band(
        self, predicted: PredictedCurve, level: float = LEVEL, number: int | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Half widths of the band of a curve by the uncertainty of the values, (k,) each.

        Of the frequency, Hz, and of the damping ratio, to first order. ``number`` is that of a
        measured curve whose offsets count too.
        """
        names, factor = self.problem.names, float(norm.ppf(0.5 + 0.5 * level))
        name, halves = "" if number is None else self.problem.curves[number].name, []
        for quantity in ("frequency", "damping"):
            rates = getattr(predicted, f"{quantity}_rates")
            offset = f"offset of {name}: {quantity}" if name else ""
            own = np.array([float(each == offset) for each in names[rates.shape[1] :]])
            every = np.hstack([rates, np.tile(own, (len(rates), 1))])
            variance = np.einsum("ki,ij,kj->k", every, self.covariance, every)
            halves.append(factor * np.sqrt(np.maximum(variance, 0.0)))
        return halves[0], halves[1]

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
        return [dict(zip(keys, x[: len(keys)].tolist(), strict=True)) for x in vectors]


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
    vector, evaluations, searches = problem.best(progress)
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
    count = len(problem.model.keys)
    predicted = problem.model.predict(vector[:count].tolist(), problem.curves)
    problem.model.let_go()
    notes += [note for curve in problem.curves for note in curve.notes]
    notes += _at_bounds(problem, vector)
    return Fit(
        problem=problem,
        vector=vector,
        covariance=inner * np.outer(rates, rates),
        sum_of_squares=squares,
        degrees=degrees,
        widened=widened,
        undetermined=tuple(undetermined),
        predicted=tuple(predicted),
        evaluations=evaluations,
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


@dataclass(frozen=True)
class _Axes:
    """Principal directions of the covariance of the variables, and those that are left open.

    Attributes
    ----------
    axes : ndarray, shape (k, k)
        A column for each; a length of 1 reaches from the middle of the bounds to their ends.
    size : ndarray, shape (k,)
        Inverse of their standard deviation.
    open : ndarray of int
        Those whose interval is wider than the bounds.
    """

    axes: FloatArray
    size: FloatArray
    open: IntArray

    @staticmethod
    def of(problem: FitProblem, vector: FloatArray, J: FloatArray) -> _Axes:
        """Of the derivatives ``J``, (r, k), of residuals over their (widened) deviations."""
        variables = J * problem.rates(vector)
        width = 0.5 * (problem.inner(problem.highest) - problem.inner(problem.lowest))
        scale = np.where(np.isfinite(width), width, problem.sizes())
        _, size, right = np.linalg.svd(variables * scale, full_matrices=True)
        size = np.append(size, np.zeros(right.shape[0] - size.size))
        beyond = np.flatnonzero(size <= norm.ppf(0.5 + 0.5 * LEVEL))
        return _Axes(right.T * scale[:, np.newaxis], size, beyond)


def _covariance(
    problem: FitProblem, vector: FloatArray, J: FloatArray, widened: float, stalls: bool
) -> tuple[FloatArray, list[str]]:
    """Covariance of the variables of the fit, and sentences about undetermined directions.

    There are none where the search ``stalls``, or where a value lies on its bound though another
    does not fit as well.
    """
    found, sentences = _Axes.of(problem, vector, J), list[str]()
    factor = float(norm.ppf(0.5 + 0.5 * LEVEL))
    spread = 1.0 / np.maximum(found.size, factor)
    bound = problem.on_bound(vector)
    for k in [] if stalls else found.open.tolist():
        names = _names(problem, found.axes[:, k])
        if len(names) > 1:
            if not bound[names].any():
                sentences.append(_undetermined(problem, found.axes[:, k], names))
            continue
        low, high = (_as_well(problem, vector, names[0], end, widened) for end in (0, 1))
        inner = problem.inner(vector)[names[0]]
        ends = [problem.inner(x)[names[0]] for x in (problem.lowest, problem.highest)]
        name = problem.names[names[0]]
        if [low, high] == ends:
            sentences.append(f"The data do not determine {name}: any value within its bounds fits "
                             "as well.")  # fmt: skip
            continue
        spread[k] = max(high - inner, inner - low) / (0.5 * (ends[1] - ends[0]) * factor)
        if low == ends[0] or high == ends[1]:
            reach = (float(problem.outer(np.full(vector.size, x))[names[0]]) for x in (low, high))
            sentences.append(
                "The data do not determine {}: any value from {:.3g} to {:.3g} fits as "
                "well.".format(name, *reach)
            )
    return (found.axes * spread**2) @ found.axes.T, sentences


def _as_well(problem: FitProblem, vector: FloatArray, k: int, side: int, widened: float) -> float:
    """How far the variable k reaches to its lower or upper bound while the data are fitted as well.

    That is while the sum of squares rises by less than the level of an interval allows.
    """
    best = problem.inner(vector)
    most = problem.squares(vector) + widened**2 * chi2.ppf(LEVEL, 1)

    def fits(x: float) -> bool:
        changed = best.copy()
        changed[k] = x
        return bool(problem.squares(problem.outer(changed)) <= most)

    near, far = float(best[k]), float(problem.inner((problem.lowest, problem.highest)[side])[k])
    if fits(far):
        return far
    # Halvings of the range up to a bound, to find how far a value fits as well.
    for _ in range(4):
        middle = 0.5 * (near + far)
        near, far = (middle, far) if fits(middle) else (near, middle)
    return near


def _names(problem: FitProblem, direction: FloatArray) -> IntArray:
    """Entries of the vector that belong to a direction of the variables, (k,), largest first."""
    size = np.round(np.abs(direction) / np.abs(direction).max(), 3)  # equal shares in given order
    # Share of the largest component from which on a value belongs to an undetermined direction.
    some = np.flatnonzero(size >= 0.1)
    return np.asarray(some[np.argsort(-size[some], kind="stable")])


def _undetermined(problem: FitProblem, direction: FloatArray, some: IntArray) -> str:
    """Sentence about a direction, (k,), of some values that the data do not determine."""
    names = [problem.names[k] for k in some]
    share = direction / direction[some[0]]
    powers = ", ".join(f"{problem.names[k]} by its power {share[k]:.2f}" for k in some[1:].tolist())
    return (
        f"The data do not determine {' and '.join(names)} each by itself: they fit as well if "
        f"{names[0]} changes by a factor and {powers}."
    )


def _at_bounds(problem: FitProblem, vector: FloatArray) -> list[str]:
    """Notes about best values that lie on a bound."""
    return [
        f"{problem.names[k]} ends at its bound, {vector[k]:.6g}: the data ask for a value beyond "
        "it."
        for k in np.flatnonzero(problem.on_bound(vector)).tolist()
    ]
