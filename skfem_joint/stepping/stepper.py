"""What a stepper is: it advances one system by equal implicit steps.

`Stepper` is what the driver needs, and what both kinds do alike. `time_loop.CompiledStepper` does
many steps in one call of the compiled loop, for chains and small dense systems.
`driver.PythonStepper` does them one by one in Python, for all others: systems without friction,
whose steps are one linear solution each, and large systems, whose step problems take much longer
than the lines of Python around them. What contact has from step to step beside the state is in
`Stepper.forces`: `ConstantForces`, or `NormalForces` where it opens.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from skfem_joint.ground.arrays import FloatArray, as_dense, check_like
from skfem_joint.linalg.compressed import as_compressed
from skfem_joint.linalg.factors import factorised
from skfem_joint.minimise.problem import ContactPoints, Minimum, StepProblem
from skfem_joint.stepping.arrangement import step_problem
from skfem_joint.stepping.recording import Recorder
from skfem_joint.stepping.schemes import FOLLOWED, Coefficients, Scheme, State, backward_euler
from skfem_joint.system.system import System

if TYPE_CHECKING:
    from skfem_joint.stepping.normal_forces import NormalForces

Saved = Mapping[str, NDArray[Any]]


@dataclass
class FailedStep:
    """Why the last step did not converge.

    Attributes
    ----------
    residual : float
        Its largest force residual, N.
    unknown : int
        Unknown at which it is.
    """

    residual: float = 0.0
    unknown: int = 0


class Stepper(ABC):
    """What the driver needs of a stepper, and what both kinds do alike.

    Parameters
    ----------
    kind : str
        Of the system's matrices, see :func:`skfem_joint.stepping.arrangement.step_problem`.
    system : System
    scheme : Scheme
    u, v : ndarray, shape (n,)
        Initial displacement (m) and velocity (m/s).
    tolerance : float
        Largest force residual of a step relative to its largest force.
    recorder : Recorder

    Attributes
    ----------
    now : State
        ``sigma`` may have an order of its own, see :meth:`state`.
    forces : ConstantForces or NormalForces
    counts : dict
        Work done so far, by names of :class:`skfem_joint.stepping.recording.Counters`.
    prepared : dict
        Step problem of each step size, by its coefficients.
    frequency : float
        Of the vibration, rad/s, that the last jump of the acceleration sets off; 0 after a step.
    first_call, most_at_once : int
        Steps that surely take less than a second, and the most that may be done in a single call.
    """

    COUNTS: ClassVar[tuple[str, ...]]
    first_call, most_at_once = 1, 1

    def __init__(
        self,
        kind: str,
        system: System,
        scheme: Scheme,
        u: FloatArray,
        v: FloatArray,
        tolerance: float,
        recorder: Recorder,
    ) -> None:
        self.kind, self.system, self.scheme = kind, system, scheme
        self.points = ContactPoints.of(system)
        self.tolerance, self.recorder = tolerance, recorder
        self.frequency = 0.0
        self.failure = FailedStep()
        self.counts = dict.fromkeys((*self.COUNTS, "factorizations"), 0)
        self.prepared: dict[Coefficients, StepProblem] = {}
        rest = *np.zeros((2, system.n)), np.zeros(system.contact.B.shape[0])
        self.now = State(np.array(u), np.array(v), *rest)
        self.forces: ConstantForces | NormalForces = ConstantForces()
        if system.contact.opens:
            from skfem_joint.stepping.normal_forces import NormalForces  # loads the compiler

            self.forces = NormalForces(system)

    @abstractmethod
    def advance(self, h: float, amplitudes: FloatArray, first_step: int, store: bool) -> int:
        """Do ``amplitudes.shape[1] - 1`` steps of ``h``; return how many converged.

        ``first_step`` is the index of the first one in the run; ``store`` is whether rows may be
        stored (not inside a step that is done in parts).
        """

    @abstractmethod
    def new_problem(self, c: Coefficients) -> StepProblem:
        """Problem of a step: its matrix is c_M M + C + c_K K, N s/m."""

    def problem(self, c: Coefficients) -> StepProblem:
        """Problem of a step, made once for each step size."""
        if c not in self.prepared:
            new = self.prepared[c] = self.new_problem(c)
            self.counts["factorizations"] += new.factorizations
        return self.prepared[c]

    def made(self, H: Any, points: ContactPoints) -> StepProblem:
        """Problem of a matrix in the unknowns of the steps."""
        dense = self.kind == "dense"
        return step_problem(as_dense(H) if dense else as_compressed(H), points, self.kind)

    def restart(self, amplitudes: FloatArray) -> bool:
        """Make the acceleration consistent with the loads now (at the start, or after a jump).

        Points at rest stick under Coulomb friction as long as they can: their acceleration and
        friction minimise the step problem of the mass with these points alone. False, and the
        failure noted, where none is found.
        """
        if not isinstance(self.forces, ConstantForces):
            loads = self.recorder.vectors @ amplitudes
            minimum = self.forces.restart(self.state(), loads, self.tolerance, self.made)
            if minimum.converged:
                self.started(minimum.v, minimum.sigma)
            self.failure = FailedStep(minimum.residual, minimum.where)
            return minimum.converged
        s, (u, v) = self.system, self.now[:2]
        slip, limits = s.contact.B @ v, s.contact.on_rows(s.contact.w)
        at_rest, sigma = self.points.at_rest(slip), np.zeros(slip.size)
        if s.contact.count:
            from skfem_joint.minimise.law import force_vectors

            sigma = force_vectors(slip, s.contact.beta, s.contact.directions) * (limits > 0.0)
            if s.contact.has_springs:  # their forces do not jump
                sigma = np.where(s.contact.on_rows(s.contact.sprung), self.state().sigma, sigma)
        right = (
            self.recorder.vectors @ amplitudes
            - s.C @ v
            - s.K @ u
            - s.contact.B.T @ (limits * sigma)
        )
        acceleration = np.zeros(s.n)
        if at_rest.any() and right.any():
            minimum = self._sticking(at_rest).minimise(right, None, self.tolerance)
            if not minimum.converged:
                self.failure = FailedStep(minimum.residual, minimum.where)
                return False
            acceleration = minimum.v
            sigma += minimum.sigma
        elif s.is_dense or right.any():
            acceleration = factorised(s.M)(right)
        self.started(acceleration, sigma)
        return True

    def _sticking(self, points: NDArray[np.bool_]) -> StepProblem:
        """Problem of an acceleration that obeys Coulomb friction at some points at rest."""
        mass, some = as_compressed(self.system.M), self.points.without_friction_but(points)
        return step_problem(mass, some, self.kind, condense=False)

    def started(self, acceleration: FloatArray, sigma: FloatArray) -> None:
        """Go on from an acceleration and friction, by slip row, consistent with the loads."""
        self.now = self.now._replace(a=acceleration.copy(), d=acceleration.copy(), sigma=sigma)
        self.frequency = self.system.frequency_of(acceleration)

    def prepare(self, h: float) -> None:
        """Factorise and compile what steps of ``h`` and restarts need; after :meth:`restart`."""
        self.problem(self.coefficients(h))
        s = self.system
        coulomb = (s.contact.w > 0.0) & np.isinf(s.contact.beta) & ~s.contact.sprung
        if coulomb.any():
            self._sticking(coulomb).compile()

    def coefficients(self, h: float) -> Coefficients:
        """Coefficients of the next step of ``h`` seconds.

        Schemes that dissipate overshoot after a jump of the acceleration, the more the longer the
        step is beside the periods that it sets off: they carry on the acceleration of the start.
        One implicit Euler step does not use it, and one step of first order leaves the run of
        second order (Rannacher, Numer. Math. 43, 1984). The trapezoidal rule needs no such help,
        and would lose its energy.
        """
        c = self.scheme.coefficients(h)
        return backward_euler(h) if self.frequency * h > FOLLOWED and not c.trapezoidal else c

    def state(self) -> State:
        """State now, with friction by slip row of the system."""
        return self.now

    def placed(self, sigma: FloatArray) -> FloatArray:
        """Friction of each slip row of the system, (rows,), in the order of ``now``."""
        return sigma

    def by_row(self, sigma: FloatArray) -> FloatArray:
        """Friction of each slip row of the system, (rows,), from that in the order of ``now``."""
        return sigma

    def go_on(self, now: State, beside: FloatArray) -> None:
        """Go on from a state and the numbers beside it."""
        self.now = now
        if beside.size:
            self.forces.go_on(beside)

    def saved(self) -> dict[str, NDArray[Any]]:
        """All that steps depend on, between two calls of :meth:`advance`, for a checkpoint."""
        problems = enumerate(self.prepared.values())
        parts = {f"{name}_{k}": x for k, p in problems for name, x in p.saved().items()}
        return self._own() | parts

    def ending(self) -> dict[str, NDArray[Any]]:
        """All that the next step depends on, for `restore` in another run, maybe of other steps."""
        own = self._own()
        return own | {"steps": own["steps"][:0], "counts": 0 * own["counts"]}

    def _own(self) -> dict[str, NDArray[Any]]:
        """What steps depend on beside their problems."""
        width = len(Coefficients._fields)
        return {
            "state": np.array(self.now[:4]),
            "sigma": np.array(self.now.sigma),
            "frequency": np.array(self.frequency),
            "steps": np.reshape(np.array(list(self.prepared), dtype=float), (-1, width)),
            "counts": np.array(list(self.counts.values())),
        } | self.forces.saved()

    def check(self, saved: Saved) -> None:
        """See that arrays are such as :meth:`saved` gives at some moment of this run.

        Raises
        ------
        ValueError
            Naming what is not so.
        """
        steps = saved.get("steps")
        width = len(Coefficients._fields)
        if steps is None or steps.dtype != np.float64 or steps.shape[1:] != (width,):
            raise ValueError(f"stepper/steps must be rows of {width} numbers")
        of_problems = [_of_problem(saved, k) for k in range(len(steps))]
        names = {f"{name}_{k}" for k, part in enumerate(of_problems) for name in part}
        own = {name: x for name, x in saved.items() if name not in names}
        check_like(own, self._own() | {"steps": steps}, "stepper")
        some = next(iter(self.prepared.values()))
        for part in of_problems:
            some.check(part)

    def restore(self, saved: Saved) -> None:
        """Take up what :meth:`saved` gave, whatever was done before."""
        self.now = State._make([*map(np.array, saved["state"]), np.array(saved["sigma"])])
        self.frequency = float(saved["frequency"])
        for k, row in enumerate(saved["steps"].tolist()):
            problem = self.problem(Coefficients._make([*row[:-1], bool(row[-1])]))
            problem.restore(_of_problem(saved, k))
        self.counts = dict(zip(self.counts, saved["counts"].tolist(), strict=True))
        self.forces.restore(saved)


def _of_problem(saved: Saved, k: int) -> dict[str, NDArray[Any]]:
    """What was saved of the step problem number ``k``."""
    end = f"_{k}"
    return {name.removesuffix(end): x for name, x in saved.items() if name.endswith(end)}


class ConstantForces:
    """What a step needs of contact with constant limits: all is in the state of a stepper.

    `skfem_joint.stepping.normal_forces.NormalForces` has the same methods, see there.

    Attributes
    ----------
    limits : ndarray, shape (m,), or None
        Friction limits now, N; None where they are those of the system.
    beside : ndarray
        Numbers that a step starts from beside the state.
    """

    limits: FloatArray | None = None
    beside = np.zeros(0)

    def before(self, c: Coefficients, u: FloatArray, predictor: FloatArray) -> tuple[float, None]:
        """Nothing on the right side of a step."""
        return 0.0, None

    def after(self, c: Coefficients, minimum: Minimum) -> None:
        """Nothing to take over."""

    def works(self, recorder: Recorder, before: State, now: State) -> dict[str, Any]:
        """No works beside those of the recorder."""
        return {}

    def store(self, recorder: Recorder, row: int) -> None:
        """Nothing to store."""

    def go_on(self, beside: FloatArray) -> None:
        """Nothing to go on from."""

    def saved(self) -> dict[str, NDArray[Any]]:
        """Nothing to save."""
        return {}

    def restore(self, saved: Saved) -> None:
        """Nothing to take up."""
