"""Protocol of step problems that are minimised inside the compiled loop over time steps.

`skfem_joint.stepping.time_loop` calls two generic functions of this module, `minimise_step` and
`slips`. numba replaces each call by the implementation for the named tuple that holds the problem
(see `skfem_joint.ground.compiling.compiled_for`):

- `front_elimination.Chain`, for tridiagonal matrices: `front_elimination` decides between stick and
  slip under Coulomb's law; else its `minty_newton` evaluates the law by `law.graph`;
- `dense_loop.Dense`, for dense matrices: evaluates the law by `law.forces`, and with springs in
  series by `law.sprung_force` and its kin;
- `dense_pressures.Following`, for dense matrices with elastic contact that opens: the same law.

Other systems are not stepped in that loop but by `steppers.PythonStepper`, one minimisation at a
time: by `contact_newton` or `condensed_newton`, whose `contact_loops` evaluate the law by
`law.sprung_force`, `law.sprung_resolvent` and `law.add_tangent`, which serve points without springs
too.
"""

# mypy: allow-untyped-defs

from __future__ import annotations

from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from skfem_joint.ground.arrays import FloatArray, IntArray
from skfem_joint.minimise.problem import ContactPoints, StepProblem


class Places(NamedTuple):
    """Places of a system's slip rows and contact points among those of a compiled problem.

    Attributes
    ----------
    row : ndarray of int, shape (rows,)
    point : ndarray of int, shape (m,)
    """

    row: IntArray
    point: IntArray


def row_order(directions: NDArray[np.int64]) -> tuple[IntArray, IntArray]:
    """Order of slip rows and points in which loops along points need no branches.

    The first rows of all points come before the second rows. Points with two rows come first.
    ``directions``, (m,), is 1 or 2 for each point. Returns the row at each place, (rows,), and the
    point at each place, (m,).
    """
    first = np.cumsum(directions) - directions
    pair = directions == 2
    points = np.concatenate([np.flatnonzero(pair), np.flatnonzero(~pair)])
    return np.concatenate([first[points], first[pair] + 1]), points


class StepOutcome(NamedTuple):
    """Work and residual of a compiled minimisation.

    Attributes
    ----------
    converged : bool
    newton_iterations, nested_solves, descents, line_searches, friction_evaluations : int
        Work done, see :class:`skfem_joint.stepping.recording.Counters`.
    residual : float
        Largest force residual, N.
    unknown : int
        Unknown at which it is.
    """

    converged: bool
    newton_iterations: int
    nested_solves: int
    descents: int
    line_searches: int
    friction_evaluations: int
    residual: float
    unknown: int


def minimise_step(problem, workspace, right, v, tolerance):
    """Minimise from the velocity ``v`` of the step before; returns an `StepOutcome`.

    ``workspace.offset`` has the slips from which those of rows with springs count. The velocity and
    the friction are left in ``workspace.velocity`` and ``workspace.force``. What
    the workspace keeps of earlier steps, such as velocities to extrapolate from, changes only if
    the minimisation converged. Guesses that speed up the next step and do not bear on its result
    beyond the tolerance may change in any case: where fronts of slip met, or the friction that is
    predicted, which is forgotten after a failure.
    """
    raise NotImplementedError


def slips(problem, x, out):
    """Slip of all rows from displacements ``x``: written to ``out``, or ``x`` itself."""
    raise NotImplementedError


class CompiledStepProblem(StepProblem, Protocol):
    """Step problem whose minimisation runs inside the compiled loop over steps.

    Attributes
    ----------
    kernel : named tuple
        First argument of `minimise_step` and `slips`.
    workspace : named tuple
        Second argument of `minimise_step`, shared by all matrices of a run.
    limits : ndarray, shape (rows of the kernel,)
        Friction limit of each slip row of the kernel, N.
    places : Places
        Of the system's rows and points among those of the kernel.
    steps_per_second : int
        Number of steps that take less than a second on any computer.
    """

    kernel: Any
    workspace: Any
    limits: FloatArray
    places: Places
    steps_per_second: int

    def restart(self, v: FloatArray, sigma: FloatArray) -> None:
        """Forget earlier steps: go on from a velocity and friction in the kernel's order."""

    def resume(self, v: FloatArray, sigma: FloatArray) -> None:
        """Prepare for steps from a velocity and friction after steps with another matrix."""

    def rescue(self, g: FloatArray, v: FloatArray, tolerance: float) -> dict[str, int]:
        """Minimise for a right side for which `minimise_step` has just failed, by other means.

        Returns the work, and `minimise_step` then starts from the minimum; nothing where there is
        no other way, or it fails too.
        """

    def with_matrix(self, H: Any, points: ContactPoints | None = None) -> CompiledStepProblem:
        """See `StepProblem`; ``points`` are the same contact points with other laws."""
