"""SciPy's and SUNDIALS' stiff integrators on the same system, as a user would otherwise choose.

Each gets its best form: interleaved unknowns, an analytic Jacobian, compiled right-hand sides
(:mod:`benchmarks.first_order`), absolute tolerances in proportion to the motion. IDA takes the
residual form, banded with the consistent mass. The others take rates alone: with the lumped mass
their Jacobian is banded (CVODE, LSODA) or sparse (BDF, Radau); with the consistent one it is full,
which took 2 to 12 times as long. The lumped mass changes the model a little: those runs are
measured against the same reference as all others, with the time-step error against the lumped
model's own.
"""

import time
import warnings
from typing import NamedTuple

import numpy as np
from scipy import integrate, sparse

from benchmarks.first_order import LOWER, UPPER, FirstOrder

#: Largest number of steps that an integrator may take between two samples.
MOST_STEPS = 10**8


class Form(NamedTuple):
    """An integrator (IDA, CVODE, LSODA, BDF or Radau) and its relative tolerances as tried."""

    name: str
    tolerances: tuple[float, ...]
    unfinished: int = 1  # after so many runs beyond the bound the others are not tried

    @property
    def is_lumped(self):
        return self.name != "IDA"


FORMS = (
    Form("IDA", (1e-2, 1e-3, 1e-4, 1e-5, 1e-6), 2),
    Form("LSODA", (1e-2, 1e-3, 1e-4, 1e-5, 1e-6), 2),
    Form("CVODE", (1e-4, 1e-5, 1e-6, 1e-3)),
    Form("BDF", (1e-3, 1e-4, 1e-5)),
    Form("Radau", (1e-3, 1e-4)),
)
QUICK_FORMS = tuple(Form(form.name, (1e-4,)) for form in FORMS)


class OutOfTimeError(Exception):
    """The bound on a run's time was reached."""


class Clock:
    """Counts calls of a right-hand side, and raises in it once the bound (s) is over."""

    def __init__(self, bound):
        self.bound, self.begin, self.calls = bound, time.perf_counter(), 0

    def tick(self):
        self.calls += 1
        if time.perf_counter() > self.begin + self.bound:
            raise OutOfTimeError


class Solution(NamedTuple):
    """Samples of y, shape (times, 2 n), and the work they took."""

    y: np.ndarray
    wall_s: float
    work: dict[str, int]


class Task(NamedTuple):
    """Task of an integrator."""

    form: Form
    model: FirstOrder  # with the mass that the form asks for
    times: np.ndarray  # of the samples
    tolerance: float
    absolute: np.ndarray  # tolerances of y, m and m/s
    bound: float  # longest run, s
    start: np.ndarray  # y at the first time
    order: int = 5  # highest of SUNDIALS's


def solve(task):
    """Integrate and sample the solution; returns the reason in words if it did not finish."""
    clock = Clock(task.bound)
    act = {"IDA": _ida, "CVODE": _cvode}.get(task.form.name, _scipy)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # a failure is reported by its status
            y, work = act(task, clock)
    except OutOfTimeError:
        return f"did not finish in {task.bound:g} s"
    except ArithmeticError as error:
        return f"failed: {error}"
    wall = time.perf_counter() - clock.begin
    return Solution(y, wall, {**work, "friction evaluations": clock.calls})


def _sundials(solver, task, equations, matrix, *start):
    """Samples of one of SUNDIALS's integrators and their work."""
    band = {"linsolver": "band", "lband": LOWER, "uband": UPPER, "max_order": task.order}
    limits = {"rtol": task.tolerance, "atol": task.absolute, "max_num_steps": MOST_STEPS}
    result = solver(equations, jacfn=matrix, **limits, **band).solve(task.times, task.start, *start)
    return _checked(result), {"Jacobians": int(result.njev)}


def _checked(result):
    """Samples of an integrator; ArithmeticError if it failed."""
    if not result.success:
        raise ArithmeticError(result.message)
    return result.y


def _ida(task, clock):
    from sksundae.ida import IDA

    residual, jacobian = task.model.residual(), task.model.residual_jacobian()

    def equations(t, y, rate, out):
        clock.tick()
        residual(t, y, rate, out)

    def matrix(t, y, rate, out, c, J):
        jacobian(y, c, J)

    return _sundials(IDA, task, equations, matrix, task.model.initial_rate(task.start))


def _cvode(task, clock):
    from sksundae.cvode import CVODE

    rates, jacobian = task.model.rates(), task.model.rate_jacobian(square=True)

    def equations(t, y, out):
        clock.tick()
        rates(t, y, out)

    def matrix(t, y, rate, J):
        jacobian(y, J)

    return _sundials(CVODE, task, equations, matrix)


def _scipy(task, clock):
    model, start, times = task.model, task.start, task.times
    rates, jacobian = model.rates(), model.rate_jacobian(square=False)
    tolerances = {"rtol": task.tolerance, "atol": task.absolute}
    offsets = UPPER - np.arange(LOWER + UPPER + 1)

    def equations(t, y):
        clock.tick()
        rates(t, y, out := np.empty_like(y))
        return out

    def bands(t, y):
        jacobian(y, out := np.zeros((offsets.size, y.size)))
        return out

    def matrix(t, y):
        return sparse.dia_array((bands(t, y), offsets), shape=(y.size, y.size)).tocsc()

    if task.form.name == "LSODA":
        form = {"Dfun": bands, "ml": LOWER, "mu": UPPER, "tfirst": True, "full_output": True}
        form |= {"mxstep": MOST_STEPS} | tolerances
        y, work = integrate.odeint(equations, start, times, **form)
        if "successful" not in work["message"]:
            raise ArithmeticError(work["message"])
        return y, {"steps": int(work["nst"][-1]), "Jacobians": int(work["nje"][-1])}
    form = {"method": task.form.name, "t_eval": times, "jac": matrix} | tolerances
    result = integrate.solve_ivp(equations, (times[0], times[-1]), start, **form)
    return _checked(result).T, {"Jacobians": int(result.nlu)}
