"""What all steppers share: their interface, the first step after a jump, factorization."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse
from scipy.sparse.linalg import splu

from skfem_joint.errors import InputError
from skfem_joint.schemes import Coefficients, Scheme, backward_euler
from skfem_joint.system import System

FloatArray = NDArray[np.float64]


@dataclass
class Failure:
    """Why the last step did not converge."""

    residual: float = 0.0
    unknown: int = 0


class Stepper(Protocol):
    """What the driver needs of a stepper."""

    failure: Failure

    def advance(self, h: float, amplitudes: FloatArray, first_step: int, store: bool) -> int:
        """Do ``amplitudes.shape[1] - 1`` steps of ``h``; return how many converged.

        ``first_step`` is the index of the first one in the run; ``store`` tells whether rows may
        be stored (not inside a step that is done in parts).
        """

    def restart(self, amplitudes: FloatArray) -> None:
        """Make the acceleration consistent with the loads now (start, or after a jump)."""

    def state(self) -> tuple[FloatArray, FloatArray]:
        """Displacement and velocity now."""

    def normalised_friction(self) -> FloatArray:
        """Friction force over its limit now, one value a slip row, shape (rows,)."""

    def saved(self) -> dict[str, FloatArray]:
        """State between two calls of :meth:`advance`, for a checkpoint."""

    def restore(self, saved: Mapping[str, FloatArray]) -> None:
        """Take up what :meth:`saved` gave, whatever was done before."""


#: Angle, rad, that a jump's vibration may turn in a step for the scheme to follow it by itself.
FOLLOWED = 0.3


@dataclass
class Start:
    """What all steppers share: how the first step after a jump of the acceleration is done.

    Schemes that dissipate overshoot there, the more the longer the step is beside the periods that
    the jump sets off: they carry on the acceleration of the start. One implicit Euler step does
    not use it, and one step of first order leaves the run of second order (Rannacher, Numer.
    Math. 43, 1984). The trapezoidal rule needs no such help, and would lose its energy.
    """

    scheme: Scheme
    frequency: float = 0.0

    def after_jump(self, system: System, acceleration: FloatArray) -> None:
        """Note the frequency (rad/s) of the vibration that an acceleration from rest sets off."""
        stiffness = float(acceleration @ (system.K @ acceleration))
        mass = float(acceleration @ (system.M @ acceleration))
        self.frequency = float(np.sqrt(max(stiffness / mass, 0.0))) if mass > 0.0 else 0.0

    def coefficients(self, h: float) -> Coefficients:
        """Coefficients of the next step of ``h`` seconds."""
        c = self.scheme.coefficients(h)
        return backward_euler(h) if self.frequency * h > FOLLOWED and not c.trapezoidal else c

    def done(self, steps: int) -> None:
        """Go on with the scheme once a step has been done."""
        if steps > 0:
            self.frequency = 0.0


def prediction(
    system: System, c: Coefficients, force: FloatArray, state: Sequence[FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Displacement (m) at the end of a step but for its velocity, and the step's right side (N).

    ``force`` is that of the loads at the end, N; ``state`` is u, v, a, d at the start.
    """
    u, v, a, d = state
    predictor = u + c.u_v * v + c.u_a * a
    right = force - system.K @ predictor
    right += system.M @ (c.c_M * v + c.y_a * a + c.y_d * d)
    return predictor, right


def end_of_step(
    c: Coefficients, predictor: FloatArray, velocity: FloatArray, state: Sequence[FloatArray]
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """State u, v, a, d at the end of a step from the velocity there and the state at its start."""
    _, v, a, d = state
    a_end = c.a_v * (velocity - v) + c.a_a * a
    d_end = c.d_a * a_end + c.d_a0 * a + c.d_d0 * d
    return predictor + c.c_K * velocity, velocity, a_end, d_end


def factorised(A: Any) -> Any:
    """Solver of A x = b for a symmetric positive definite A, factorised once."""
    if isinstance(A, np.ndarray):
        try:
            factor = linalg.cho_factor(A)
        except linalg.LinAlgError as error:
            raise InputError(
                "the mass or step matrix is not positive definite: modes that depend on each "
                "other? Use skfem_joint.pod.orthonormal, which drops them"
            ) from error
        return lambda right: linalg.cho_solve(factor, right)
    # Symmetric positive definite: order A + A^T, take the pivots from the diagonal.
    return splu(
        sparse.csc_array(A),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    ).solve


def coefficients_of(row: list[float]) -> Coefficients:
    """Coefficients from the row of numbers that a checkpoint holds."""
    return Coefficients._make([*row[:-1], bool(row[-1])])
