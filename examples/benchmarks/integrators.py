"""What a user would otherwise pick: SciPy's and SUNDIALS' stiff integrators on the same system.

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
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from scipy import integrate, sparse

from benchmarks.first_order import LOWER, UPPER, FirstOrder, band_entries
from skfem_joint.arrays import FloatArray

#: Steps that no integrator may need between two samples.
MOST_STEPS = 10**8


@dataclass(frozen=True)
class Form:
    """An integrator (IDA, CVODE, LSODA, BDF or Radau) and its relative tolerances as tried."""

    name: str
    tolerances: tuple[float, ...]
    unfinished: int = 1  # after so many runs beyond the bound the others are not tried

    @property
    def is_lumped(self) -> bool:
        """Whether it needs a lumped mass."""
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


@dataclass
class _Clock:
    """Raises inside a right-hand side once the bound (s) is over."""

    bound: float
    begin: float = field(default_factory=time.perf_counter)
    calls: int = 0

    def tick(self) -> None:
        self.calls += 1
        if time.perf_counter() > self.begin + self.bound:
            raise OutOfTimeError


@dataclass(frozen=True)
class Solution:
    """Samples of y, shape (times, 2 n), and the work they took."""

    y: FloatArray
    wall_s: float
    work: dict[str, int]


@dataclass(frozen=True)
class Task:
    """What an integrator is to do."""

    form: Form
    model: FirstOrder  # with the mass that the form asks for
    times: FloatArray  # of the samples
    tolerance: float
    absolute: FloatArray  # tolerances of y, m and m/s
    bound: float  # longest run, s
    start: FloatArray  # y at the first time
    order: int = 5  # highest of SUNDIALS's


def solve(task: Task) -> Solution | str:
    """Integrate and sample the solution; why it did not finish if it did not."""
    clock = _Clock(task.bound)
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
    return Solution(np.asarray(y), wall, {**work, "friction evaluations": clock.calls})


def _options(task: Task) -> dict[str, Any]:
    band = {"linsolver": "band", "lband": LOWER, "uband": UPPER}
    most = {"max_num_steps": MOST_STEPS, "max_order": task.order}
    return {"rtol": task.tolerance, "atol": task.absolute, **most, **band}


def _checked(found: Any) -> Any:
    """Samples of an integrator that came to the end."""
    if not found.success:
        raise ArithmeticError(found.message)
    return found.y


def _ida(task: Task, clock: _Clock) -> tuple[Any, dict[str, int]]:
    from sksundae.ida import IDA

    model = task.model
    residual, jacobian = model.residual(), model.residual_jacobian()

    def equations(t: float, y: Any, rate: Any, out: Any) -> None:
        clock.tick()
        residual(t, y, rate, out)

    def matrix(t: float, y: Any, rate: Any, out: Any, c: float, J: Any) -> None:
        jacobian(y, c, J)

    solver = IDA(equations, jacfn=matrix, **_options(task))
    found = solver.solve(task.times, task.start, model.initial_rate(task.start))
    return _checked(found), {"Jacobians": int(found.njev)}


def _cvode(task: Task, clock: _Clock) -> tuple[Any, dict[str, int]]:
    from sksundae.cvode import CVODE

    rates, jacobian = task.model.rates(), task.model.rate_jacobian(square=True)

    def equations(t: float, y: Any, out: Any) -> None:
        clock.tick()
        rates(t, y, out)

    def matrix(t: float, y: Any, rate: Any, J: Any) -> None:
        jacobian(y, J)

    solver = CVODE(equations, jacfn=matrix, **_options(task))
    found = solver.solve(task.times, task.start)
    return _checked(found), {"Jacobians": int(found.njev)}


def _scipy(task: Task, clock: _Clock) -> tuple[Any, dict[str, int]]:
    model, rates, jacobian = task.model, task.model.rates(), task.model.rate_jacobian(square=False)
    tolerances = {"rtol": task.tolerance, "atol": task.absolute}
    row, column = band_entries(model.size)
    start = np.searchsorted(column, np.arange(model.size + 1))

    def equations(t: float, y: FloatArray) -> FloatArray:
        clock.tick()
        out = np.empty_like(y)
        rates(t, y, out)
        return out

    def bands(t: float, y: FloatArray) -> FloatArray:
        out = np.zeros((LOWER + UPPER + 1, y.size))
        jacobian(y, out)
        return out

    def matrix(t: float, y: FloatArray) -> Any:
        entries = bands(t, y)[UPPER + row - column, column]
        return sparse.csc_array((entries, row, start), shape=(model.size,) * 2)

    if task.form.name == "LSODA":
        form: Any = {"Dfun": bands, "ml": LOWER, "mu": UPPER, "tfirst": True}
        form |= {"mxstep": MOST_STEPS, "full_output": True}
        y, work = integrate.odeint(equations, task.start, task.times, **tolerances, **form)
        if "successful" not in work["message"]:
            raise ArithmeticError(work["message"])
        return y, {"steps": int(work["nst"][-1]), "Jacobians": int(work["nje"][-1])}
    span, times, name = (task.times[0], task.times[-1]), task.times, task.form.name
    found = integrate.solve_ivp(
        equations, span, task.start, method=name, t_eval=times, jac=matrix, **tolerances
    )
    return _checked(found).T, {"Jacobians": int(found.nlu)}
