"""The way along a branch, of polynomials whose crossings are known."""

from dataclasses import dataclass

import numpy as np

from skfem_joint.harmonic.newton import BranchPoint, branch, by_parameter, solved

BEGIN, END = -2.0, 7.0


@dataclass
class Curve:
    """The parameter is a polynomial of the only coefficient."""

    polynomial: np.poly1d
    unit: float
    unique: bool = False

    def __call__(self, x, tangents):
        slope = -self.polynomial.deriv()(x[0])
        return np.array([x[1] - self.polynomial(x[0])]), np.array([[slope, 1.0]])

    def rows(self, x):
        return np.ones(1)

    def metric(self, x):
        return np.full(2, self.unit**-2)


def test_a_parameter_is_met_as_often_as_the_branch_crosses_it():
    """Two folds, of which no step spans both; there are parameters beyond them on both sides."""
    rng = np.random.default_rng(1)
    for _ in range(50):
        folds = np.cumsum(rng.uniform((0.0, 1.0), 2.0))
        shape = np.poly1d(folds, r=True).integ()
        shape /= shape(END) / END
        targets = np.append(np.linspace(*shape(folds), 9)[1:-1], [END, -1e3])
        curve = Curve(shape, rng.uniform(0.1, 0.3))
        x = np.array([BEGIN, shape(BEGIN)])
        start = BranchPoint.of(solved(curve, x, by_parameter(2)), (1, 1))
        met = np.zeros(targets.size)
        for place in branch(curve, start, targets):
            met += place.asked & (np.abs(targets - place.rest[-1]) < 1e-9)
        assert met.tolist() == [3.0] * 7 + [1.0, 0.0]
