"""Explicit integration as in the paper: state-space form, classical Runge-Kutta, for comparison.

Friction regularised by a steep arctangent makes the equations stiff: the stable step is set by the
law's slope over the nodal mass and not by the mesh. The step is checked before the run.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse
from scipy.sparse.linalg import eigsh

from skfem_joint import friction
from skfem_joint.errors import ConvergenceError, InputError
from skfem_joint.recording import Recorder, Run, Save
from skfem_joint.steppers_shared import factorised
from skfem_joint.system import System

FloatArray = NDArray[np.float64]

#: Velocity beyond which a run counts as unstable, m/s.
UNBOUNDED = 1e100
#: Unknowns up to which all eigenvalues are computed.
DENSE_LIMIT = 500


def _dense(A: Any) -> FloatArray:
    return np.asarray(A if isinstance(A, np.ndarray) else A.toarray())


def state_matrix(system: System, slope: FloatArray | None = None) -> FloatArray:
    """First-order matrix A of Eq. (13), shape (2 n, 2 n), 1/s.

    Parameters
    ----------
    slope : ndarray, shape (m,), optional
        Slope of the normalised friction force at each contact point, s/m, added to the damping
        (linearisation of Eq. (14)); none if not given.
    """
    M, C, K = _dense(system.M), _dense(system.C), _dense(system.K)
    if slope is not None:
        B = _dense(system.B)
        C = C + B.T @ (system.on_rows(system.w * slope)[:, np.newaxis] * B)
    n = system.n
    return np.block([[np.zeros((n, n)), np.eye(n)], [-linalg.solve(M, K), -linalg.solve(M, C)]])


def stable_step(system: System) -> float:
    """Largest stable step of the classical Runge-Kutta method, s.

    Every eigenvalue of the system, linearised about stick where the friction slope is largest and
    about free slip where it vanishes, must stay in the method's stability region. Large sparse
    systems use bounds from their extreme eigenvalues instead.

    Raises
    ------
    InputError
        For set-valued Coulomb friction, whose slope is infinite.
    """
    slope = friction.slope(np.zeros(system.w.size), system.beta)
    if np.any(np.isinf(slope[system.w > 0.0])):
        raise InputError(
            "explicit integration: set-valued Coulomb friction has no stable step; use the "
            "implicit integrator, or a finite beta"
        )
    if system.n > DENSE_LIMIT:
        return _stable_step_from_bounds(system, slope)
    candidates = [
        np.linalg.eigvals(state_matrix(system, part)).astype(complex)
        for part in (slope, np.zeros_like(slope))
    ]
    return min(_largest_step(values) for values in candidates)


def _growth(z: NDArray[np.complex128]) -> FloatArray:
    """Modulus of the stability function 1 + z + z^2/2 + z^3/6 + z^4/24."""
    return np.asarray(np.abs(1.0 + z * (1.0 + z / 2.0 * (1.0 + z / 3.0 * (1.0 + z / 4.0)))))


def _largest_step(eigenvalues: NDArray[np.complex128]) -> float:
    values = eigenvalues[np.abs(eigenvalues) > 0.0]
    if values.size == 0:
        return float("inf")
    # Rounding may put undamped eigenvalues a hair to the right of the imaginary axis.
    values = np.minimum(values.real, 0.0) + 1j * values.imag
    low, high = 0.0, 4.0 / float(np.abs(values).max())
    for _ in range(60):
        middle = 0.5 * (low + high)
        if np.all(_growth(middle * values) <= 1.0 + 1e-12):
            low = middle
        else:
            high = middle
    return low


def _stable_step_from_bounds(system: System, slope: FloatArray) -> float:
    M = sparse.csc_array(system.M)
    rows = sparse.csr_array(system.B)
    C = sparse.csc_array(
        system.C + rows.T @ sparse.diags_array(system.on_rows(system.w * slope)) @ rows
    )
    options = {"k": 1, "which": "LM", "return_eigenvectors": False, "v0": np.ones(system.n)}
    rate = float(eigsh(C, M=M, **options)[0])
    frequency = float(np.sqrt(eigsh(sparse.csc_array(system.K), M=M, **options)[0]))
    # The region holds the disc segment |z| <= 2.6 of the left half plane.
    return 2.6 / max(rate, frequency)


def runge_kutta(
    system: System,
    *,
    step: float,
    n_steps: int,
    save: Save | None = None,
    cycle_steps: int | None = None,
    check: bool = True,
    progress: Callable[[int, int], None] | None = None,
) -> Run:
    """Integrate by the classical Runge-Kutta method from rest, Eqs. (10)-(16).

    Parameters
    ----------
    step : float
        Time step, s.
    check : bool
        Refuse a step beyond the stable one. Turn off only to find the edge by experiment.

    Raises
    ------
    InputError
        If the step is beyond the stable one; the message says which step would do.
    ConvergenceError
        If the solution grows without bound.
    """
    if not (step > 0.0 and np.isfinite(step)) or n_steps < 1:
        raise InputError("explicit integration: step and n_steps must be > 0")
    if check:
        limit = stable_step(system)
        if step > limit:
            raise InputError(
                f"explicit integration: a step of {step:.4g} s is unstable; the largest stable "
                f"step is {limit:.4g} s, {int(np.ceil(step * n_steps / limit))} steps for this "
                "run. Use that, a smaller beta, or the implicit integrator."
            )
    recorder = Recorder(system, save or Save(), n_steps, step)
    vectors = system.load_vectors()
    solve = factorised(system.M)
    w, beta, directions = system.on_rows(system.w), system.beta, system.directions
    evaluations = 0

    def acceleration(u: FloatArray, v: FloatArray, load: FloatArray) -> FloatArray:
        nonlocal evaluations
        right = vectors @ load - system.K @ u - system.C @ v
        if system.contact_points:
            evaluations += 1
            right -= system.B.T @ (w * friction.force_vectors(system.B @ v, beta, directions))
        return np.asarray(solve(right))

    u, v = np.zeros(system.n), np.zeros(system.n)
    chunk = 10_000
    begin = time.perf_counter()
    sigma = friction.force_vectors(system.B @ v, beta, directions)
    recorder.store(0, u, v, sigma)
    a = acceleration(u, v, system.load_amplitudes(np.array([0.0]))[:, 0])
    for first in range(0, n_steps, chunk):
        count = min(chunk, n_steps - first)
        loads = system.load_amplitudes(
            step * (first + 0.5 * np.arange(2 * count + 1, dtype=np.float64))
        )
        for k in range(count):
            f0, f1, f2 = loads[:, 2 * k], loads[:, 2 * k + 1], loads[:, 2 * k + 2]
            old = (u, v, a, sigma)
            v1, a1 = v, a
            v2 = v + 0.5 * step * a1
            a2 = acceleration(u + 0.5 * step * v1, v2, f1)
            v3 = v + 0.5 * step * a2
            a3 = acceleration(u + 0.5 * step * v2, v3, f1)
            v4 = v + step * a3
            a4 = acceleration(u + step * v3, v4, f2)
            u = u + step / 6.0 * (v1 + 2.0 * v2 + 2.0 * v3 + v4)
            v = v + step / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
            if not np.abs(v).max() < UNBOUNDED:
                raise ConvergenceError(
                    f"explicit step {first + k} at t = {step * (first + k):.6g} s: the solution "
                    f"grows without bound, the step of {step:.4g} s is unstable"
                )
            a = acceleration(u, v, f2)
            sigma = friction.force_vectors(system.B @ v, beta, directions)
            recorder.add_step(step, (f0, f2), old, (u, v, a, sigma), vectors)
            recorder.store(first + k + 1, u, v, sigma)
            if cycle_steps is not None and (first + k + 1) % cycle_steps == 0:
                recorder.end_cycle()
        if progress is not None:
            progress(first + count, n_steps)
    return recorder.finish(
        0.0,
        u,
        v,
        time.perf_counter() - begin,
        0.0,
        n_steps,
        False,
        friction_evaluations=evaluations,
    )
