"""The line search: short of the minimum along a line or just past it, in few evaluations."""

from typing import Any, NamedTuple

import numpy as np
import pytest

from skfem_joint.ground.compiling import compiled, compiled_for
from skfem_joint.minimise import law
from skfem_joint.minimise.line_search import BEYOND, SHORT, TRIALS, friction_slope, line_search


class Line(NamedTuple):
    v: Any
    d: Any
    beta: float


@compiled_for(friction_slope, Line)
def along(line, length):
    total = 0.0
    for i in range(line.v.size):
        total += law.sigma(line.v[i] + length * line.d[i], line.beta) * line.d[i]
    return total


@compiled
def search(line, linear, quadratic):
    slope_0 = linear + friction_slope(line, 0.0)
    return slope_0, line_search(line, slope_0, linear, quadratic)


@pytest.mark.parametrize("beta", [1e2, 1e5, 1e9, np.inf])
def test_the_length_is_nearly_that_of_the_minimum(beta):
    rng = np.random.default_rng(0)
    trials = []
    for _ in range(300):
        v, d = rng.normal(size=(2, 30)) * 10.0 ** rng.uniform(-3, 1)
        linear, quadratic = -float(np.abs(d).sum()) * rng.uniform(1.0, 3.0), rng.uniform(0.1, 10.0)
        line = Line(v, d, beta)
        at_start, (length, count, _) = search(line, linear, quadratic)
        slope = linear + length * quadratic + float(law.force(v + length * d, beta) @ d)
        assert length > 0.0
        assert count <= TRIALS
        if np.isfinite(beta) and beta < 1e9:
            full = length == 1.0 and slope <= 0.0
            assert full or SHORT * at_start <= slope <= -BEYOND * at_start
        trials.append(count)
    assert np.mean(trials) < 12


def test_without_descent_the_full_step_is_taken():
    line = Line(np.ones(2), np.ones(2), 1e5)
    assert search(line, 0.0, 1.0)[1][:2] == (1.0, 0)
