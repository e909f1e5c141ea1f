"""What a user would otherwise pick: SciPy's and SUNDIALS' stiff integrators on the same system.

Each gets its best form: interleaved unknowns, an analytic Jacobian, compiled right-hand sides and
Jacobians (:mod:`skfem_joint.error_time.first_order`), absolute tolerances in proportion to the
motion.

IDA
    Residual form: banded with the consistent mass, the natural one.
CVODE, LSODA, BDF, Radau
    Rates only. With the consistent mass their Jacobian is full (LAPACK); with the lumped mass it is
    banded (CVODE, LSODA) or sparse (BDF, Radau). Both are run: the lumped mass changes the model a
    little, and its runs are measured against the same reference as all others, with the
    time-step error against the lumped model's own.
"""

from __future__ import annotations

import importlib.util
import time
import warnings
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import integrate as scipy_integrate
from scipy import sparse

from skfem_joint.error_time.first_order import LOWER, UPPER, FirstOrder, lumped
from skfem_joint.error_time.measure import Job, Outcome, What
from skfem_joint.error_time.reference import OWN, SAMPLES, Grid, Reference, sampled_results
from skfem_joint.scene import Scene

FloatArray = NDArray[np.float64]

#: Absolute tolerances relative to the largest displacement and velocity, over the relative one.
ABSOLUTE = 1e-2
#: Steps that no integrator may need between two samples.
MOST_STEPS = 10**8
READY_MADE = "ready-made"


@dataclass(frozen=True)
class Form:
    """An integrator and the form it is given.

    Attributes
    ----------
    name : str
        ``IDA``, ``CVODE``, ``LSODA``, ``BDF`` or ``Radau``.
    mass : {"consistent", "lumped"}
    jacobian : {"banded", "sparse", "full"}
    tolerances : tuple of float
        Relative ones, in the order tried.
    unfinished : int
        After so many runs beyond the bound the others are not tried.
    """

    name: str
    mass: str
    jacobian: str
    tolerances: tuple[float, ...]
    unfinished: int = 1

    @property
    def needs_sundials(self) -> bool:
        """Whether it comes with scikit-sundae."""
        return self.name in ("IDA", "CVODE")


FORMS = (
    Form("IDA", "consistent", "banded", (1e-2, 1e-3, 1e-4, 1e-5, 1e-6), 2),
    Form("LSODA", "lumped", "banded", (1e-2, 1e-3, 1e-4, 1e-5, 1e-6), 2),
    Form("CVODE", "lumped", "banded", (1e-4, 1e-5, 1e-6, 1e-3)),
    Form("BDF", "lumped", "sparse", (1e-3, 1e-4, 1e-5)),
    Form("Radau", "lumped", "sparse", (1e-3, 1e-4)),
    Form("LSODA", "consistent", "full", (1e-3, 1e-4)),
    Form("CVODE", "consistent", "full", (1e-4, 1e-3)),
    Form("BDF", "consistent", "full", (1e-3,)),
    Form("Radau", "consistent", "full", (1e-3,)),
)
QUICK_FORMS = tuple(
    Form(form.name, form.mass, form.jacobian, (1e-4,)) for form in FORMS if form.jacobian != "full"
)


class OutOfTimeError(Exception):
    """The bound on a run's time was reached."""


class _Clock:
    """Raises inside a right-hand side once the bound is over."""

    def __init__(self, bound: float) -> None:
        self.begin = time.perf_counter()
        self.end = self.begin + bound
        self.calls = 0

    def tick(self) -> None:
        self.calls += 1
        if time.perf_counter() > self.end:
            raise OutOfTimeError

    def elapsed(self) -> float:
        return time.perf_counter() - self.begin


@dataclass(frozen=True)
class Solution:
    """Samples of y, shape (times, 2 n), and the work they took."""

    y: FloatArray
    wall_s: float
    steps: int | None
    jacobians: int
    evaluations: int


def solve(
    form: Form,
    model: FirstOrder,
    times: FloatArray,
    tolerance: float,
    absolute: FloatArray,
    bound: float,
) -> Solution | str:
    """Integrate from rest and sample the solution.

    Parameters
    ----------
    model : FirstOrder
        With the mass that the form asks for.
    absolute : ndarray, shape (2 n,)
        Absolute tolerances, m and m/s.
    bound : float
        Longest run, s.

    Returns
    -------
    Solution or str
        Why it did not finish.
    """
    clock = _Clock(bound)
    act = {"IDA": _ida, "CVODE": _cvode, "LSODA": _lsoda}.get(form.name, _scipy)
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # a failure is reported by its status
            found = act(form, model, times, tolerance, absolute, clock)
    except OutOfTimeError:
        return f"did not finish in {bound:g} s"
    if isinstance(found, str):
        return f"failed: {found}"
    y, steps, jacobians = found
    return Solution(np.asarray(y), clock.elapsed(), steps, jacobians, clock.calls)


Found = tuple[FloatArray, int | None, int] | str


def _ida(
    form: Form,
    model: FirstOrder,
    times: FloatArray,
    tolerance: float,
    absolute: FloatArray,
    clock: _Clock,
) -> Found:
    from sksundae.ida import IDA

    residual, jacobian, tick = model.residual_function(), model.residual_jacobian(), clock.tick

    def equations(t: float, y: Any, rate: Any, out: Any) -> None:
        tick()
        residual(t, y, rate, out)

    def matrix(t: float, y: Any, rate: Any, out: Any, c: float, J: Any) -> None:
        jacobian(y, c, J)

    start, rate = np.zeros(model.size), np.zeros(model.size)
    model.rate_function()(0.0, start, rate)
    solver = IDA(
        equations,
        jacfn=matrix,
        linsolver="band",
        lband=LOWER,
        uband=UPPER,
        rtol=tolerance,
        atol=absolute,
        max_num_steps=MOST_STEPS,
    )
    found = solver.solve(times, start, rate)
    return (found.y, None, int(found.njev)) if found.success else str(found.message)


def _cvode(
    form: Form,
    model: FirstOrder,
    times: FloatArray,
    tolerance: float,
    absolute: FloatArray,
    clock: _Clock,
) -> Found:
    from sksundae.cvode import CVODE

    rates, tick = model.rate_function(), clock.tick
    banded = form.jacobian == "banded"
    jacobian = model.rate_jacobian(packed=False) if banded else model.full_rate_jacobian

    def equations(t: float, y: Any, out: Any) -> None:
        tick()
        rates(t, y, out)

    def matrix(t: float, y: Any, rate: Any, J: Any) -> None:
        jacobian(y, J)

    linear: dict[str, Any] = (
        {"linsolver": "band", "lband": LOWER, "uband": UPPER}
        if banded
        else {"linsolver": "lapackdense"}
    )
    solver = CVODE(
        equations,
        jacfn=matrix,
        rtol=tolerance,
        atol=absolute,
        max_num_steps=MOST_STEPS,
        **linear,
    )
    found = solver.solve(times, np.zeros(model.size))
    return (found.y, None, int(found.njev)) if found.success else str(found.message)


def _rate_callback(model: FirstOrder, clock: _Clock) -> Callable[[float, FloatArray], FloatArray]:
    rates, tick = model.rate_function(), clock.tick

    def equations(t: float, y: FloatArray) -> FloatArray:
        tick()
        out = np.empty_like(y)
        rates(t, y, out)
        return out

    return equations


def _lsoda(
    form: Form,
    model: FirstOrder,
    times: FloatArray,
    tolerance: float,
    absolute: FloatArray,
    clock: _Clock,
) -> Found:
    banded = form.jacobian == "banded"
    shape = (LOWER + UPPER + 1 if banded else model.size, model.size)
    jacobian = model.rate_jacobian(packed=True) if banded else model.full_rate_jacobian

    def matrix(t: float, y: FloatArray) -> FloatArray:
        out = np.zeros(shape)
        jacobian(y, out)
        return out

    y, work = scipy_integrate.odeint(
        _rate_callback(model, clock),
        np.zeros(model.size),
        times,
        Dfun=matrix,
        tfirst=True,
        rtol=tolerance,
        atol=absolute,
        mxstep=MOST_STEPS,
        full_output=True,
        **({"ml": LOWER, "mu": UPPER} if banded else {}),
    )
    if "successful" not in work["message"]:
        return str(work["message"])
    return y, int(work["nst"][-1]), int(work["nje"][-1])


def _scipy(
    form: Form,
    model: FirstOrder,
    times: FloatArray,
    tolerance: float,
    absolute: FloatArray,
    clock: _Clock,
) -> Found:
    if form.jacobian == "sparse":
        fill = model.rate_jacobian(packed=True)
        row, column = _band_entries(model.size)
        start = np.searchsorted(column, np.arange(model.size + 1))
        band = UPPER + row - column
        storage = np.zeros((LOWER + UPPER + 1, model.size))

        def matrix(t: float, y: FloatArray) -> Any:
            fill(y, storage)
            return sparse.csc_array((storage[band, column], row, start), shape=(model.size,) * 2)
    else:

        def matrix(t: float, y: FloatArray) -> Any:
            out = np.empty((model.size, model.size))
            model.full_rate_jacobian(y, out)
            return out

    found = scipy_integrate.solve_ivp(
        _rate_callback(model, clock),
        (times[0], times[-1]),
        np.zeros(model.size),
        method=form.name,
        t_eval=times,
        rtol=tolerance,
        atol=absolute,
        jac=matrix,
    )
    return (found.y.T, None, int(found.nlu)) if found.success else str(found.message)


def _band_entries(size: int) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Rows and columns of the entries between the bands, by columns."""
    offset = np.arange(-UPPER, LOWER + 1)
    row = (np.arange(size)[:, np.newaxis] + offset).ravel()
    column = np.repeat(np.arange(size), offset.size)
    inside = (row >= 0) & (row < size)
    return row[inside], column[inside]


def absolute_tolerances(reference: Reference, tolerance: float) -> FloatArray:
    """Absolute tolerances of y in proportion to the reference's motion."""
    absolute = np.empty(2 * reference.system.n)
    absolute[::2] = ABSOLUTE * tolerance * reference.displacement
    absolute[1::2] = ABSOLUTE * tolerance * reference.velocity
    return absolute


@dataclass
class _Tries:
    """How often a form was beyond the bound."""

    unfinished: int = 0


def _attempt(
    form: Form,
    model: FirstOrder,
    reference: Reference,
    tolerance: float,
    bound: float,
    tries: _Tries,
) -> Outcome:
    if tries.unfinished >= form.unfinished:
        return Outcome(None, None, status="not tried: others of this solver were beyond the bound")
    absolute = absolute_tolerances(reference, tolerance)
    found = solve(form, model, reference.grid.samples(), tolerance, absolute, bound)
    if isinstance(found, str):
        tries.unfinished += 1
        return Outcome(None, None, status=found)
    system = model.system
    return Outcome(
        sampled_results(system, reference.grid, found.y[:, ::2], found.y[:, 1::2]),
        found.wall_s,
        found.steps,
        found.jacobians,
        found.evaluations,
    )


def _piece(form: Form, model: FirstOrder, reference: Reference, tolerance: float) -> object:
    times = reference.grid.samples()[: SAMPLES + 1]
    return solve(form, model, times, tolerance, absolute_tolerances(reference, tolerance), 0.5)


def _compile(model: FirstOrder) -> float:
    """Seconds that the first calls of the compiled loops take."""
    begin = time.perf_counter()
    y, out = np.zeros(model.size), np.zeros(model.size)
    square = np.zeros((model.size, model.size))
    model.residual_function()(0.0, y, y, out)
    model.rate_function()(0.0, y, out)
    model.residual_jacobian()(y, 1.0, square)
    model.rate_jacobian(packed=False)(y, square)
    return time.perf_counter() - begin


def _missing() -> Outcome:
    return Outcome(None, None, status="not installed: pip install 'skfem-joint[bench]'")


def ready_made_jobs(
    scene: Scene, reference: Reference, bound: float, forms: tuple[Form, ...] = FORMS
) -> Iterator[Job]:
    """Every integrator in every form at its tolerances; none under set-valued Coulomb friction."""
    system, grid = reference.system, reference.grid
    if np.any(np.isinf(system.beta[system.w > 0.0])):
        return
    models = {"consistent": FirstOrder(system), "lumped": FirstOrder(lumped(system))}
    own = {
        "consistent": reference.results.point_u,
        "lumped": _histories(models["lumped"], grid, scene.time.rho_infinity),
    }
    offline = _compile(models["consistent"])
    installed = importlib.util.find_spec("sksundae") is not None
    for form in forms:
        tries = _Tries()
        model = models[form.mass]
        for tolerance in form.tolerances:
            what = What(
                f"{READY_MADE} {form.name}",
                f"full, {form.mass} mass",
                f"{form.name}, {form.jacobian} Jacobian",
                int(scene.bar.mesh.t.shape[1]),
                None,
                system.contact_points,
                float(system.beta[system.w > 0.0].max()),
                tolerance=tolerance,
            )
            arguments = (form, model, reference, tolerance)
            run: Callable[[], Outcome] = partial(_attempt, *arguments, bound, tries)
            if form.needs_sundials and not installed:
                run = _missing
            yield Job(
                what,
                run,
                offline,
                own[form.mass],
                sampled=True,
                piece=partial(_piece, *arguments),
            )


def _histories(model: FirstOrder, grid: Grid, rho: float) -> FloatArray:
    return grid.integrate(model.system, OWN, rho).point_u
