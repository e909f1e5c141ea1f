"""Explicit integration as in the paper: state-space form, classical Runge-Kutta, for comparison.

Friction regularised by a steep arctangent makes the equations stiff: the stable step is set by the
law's slope over the nodal mass and not by the mesh. The step is checked before the run.
"""

import math
import time

import numpy as np
from scipy import linalg, sparse
from scipy.sparse.linalg import eigsh

from skfem_joint.ground.errors import ConvergenceError, InputError
from skfem_joint.linalg.factors import factorised
from skfem_joint.minimise import law
from skfem_joint.stepping.recording import Recorder, Save
from skfem_joint.stepping.schemes import State

#: Unknowns up to which all eigenvalues are computed.
DENSE_LIMIT = 500


def stable_step(system):
    """Largest stable step of the classical Runge-Kutta method, s.

    Every eigenvalue of the system, linearised about stick where the friction slope is largest and
    about free slip where it vanishes, must stay in the method's stability region. Large sparse
    systems use bounds from their extreme eigenvalues instead. `InputError`: set-valued Coulomb
    friction, whose slope is infinite.
    """
    contact = system.contact
    slope = np.where(contact.w > 0.0, law.force_slope(0.0, contact.beta), 0.0)
    if np.any(np.isinf(slope)):
        raise InputError(
            "explicit integration: set-valued Coulomb friction has no stable step; use the "
            "implicit integrator, or a finite beta"
        )
    B = sparse.csr_array(contact.B)
    sticks = sparse.csc_array(B.T @ sparse.diags_array(contact.on_rows(contact.w * slope)) @ B)
    M, C, K = (sparse.csc_array(A) for A in (system.M, system.C, system.K))
    if system.n <= DENSE_LIMIT:
        M, K, n = M.toarray(), K.toarray(), system.n
        steps = []
        for damping in (C + sticks, C):  # of the first-order matrix of Eq. (13)
            rates = -linalg.solve(M, np.hstack([K, damping.toarray()]))
            matrix = np.vstack([np.eye(n, 2 * n, k=n), rates])
            steps.append(_largest_step(linalg.eigvals(matrix)))
        return min(steps)
    options = {"k": 1, "which": "LM", "return_eigenvectors": False, "v0": np.ones(system.n)}
    rate, square = (eigsh(A, M=M, **options)[0] for A in (C + sticks, K))
    # The region holds the disc segment |z| <= 2.6 of the left half plane.
    return float(2.6 / max(rate, math.sqrt(square)))


def _largest_step(eigenvalues):
    """Step up to which ``|1 + z + z^2/2 + z^3/6 + z^4/24| <= 1`` at every eigenvalue times it."""
    values = eigenvalues[np.abs(eigenvalues) > 0.0]
    if values.size == 0:
        return math.inf
    # Rounding may put undamped eigenvalues a hair to the right of the imaginary axis.
    values = np.minimum(values.real, 0.0) + 1j * values.imag
    low, high = 0.0, float(4.0 / np.abs(values).max())
    for _ in range(60):
        middle = 0.5 * (low + high)
        z = middle * values
        growth = np.abs(1.0 + z * (1.0 + z / 2.0 * (1.0 + z / 3.0 * (1.0 + z / 4.0))))
        low, high = (middle, high) if np.all(growth <= 1.0 + 1e-12) else (low, middle)
    return low


def runge_kutta(system, *, step, n_steps, save=None, cycle_steps=None, check=True):
    """Integrate by the classical Runge-Kutta method from rest, Eqs. (10)-(16), as `integrate` does.

    A step beyond the stable one is refused (`InputError`, which says which step would do) unless
    ``check`` is off, to find the edge by experiment. `ConvergenceError`: the solution grows without
    bound.
    """
    if not (step > 0.0 and math.isfinite(step)) or n_steps < 1:
        raise InputError("explicit integration: step and n_steps must be > 0")
    limit = stable_step(system) if check else math.inf
    if step > limit:
        raise InputError(
            f"explicit integration: a step of {step:.4g} s is unstable; the largest stable step is "
            f"{limit:.4g} s, {math.ceil(step * n_steps / limit)} steps for this run. Use that, a "
            "smaller beta, or the implicit integrator."
        )
    by_cycle = cycle_steps is not None
    recorder = Recorder(system, save or Save(), n_steps, step, by_cycle=by_cycle)
    solve, contact = factorised(system.M), system.contact
    w, rubs = contact.on_rows(contact.w), bool(contact.count)

    def friction(v):
        return law.force_vectors(contact.B @ v, contact.beta, contact.directions)

    def acceleration(u, v, amplitudes):
        right = recorder.vectors @ amplitudes - system.K @ u - system.C @ v
        return solve(right - contact.B.T @ (w * friction(v)) if rubs else right)

    begin = time.perf_counter()
    loads = system.load_amplitudes(0.5 * step * np.arange(2 * n_steps + 1))  # of half steps
    u, v = np.zeros((2, system.n))
    a = acceleration(u, v, loads[:, 0])
    now = State(u, v, a, a, friction(v))
    recorder.store(0, now)
    for k in range(n_steps):
        f0, f1, f2 = loads[:, 2 * k : 2 * k + 3].T
        u, v1, a1 = now[:3]
        v2 = v1 + 0.5 * step * a1
        a2 = acceleration(u + 0.5 * step * v1, v2, f1)
        v3 = v1 + 0.5 * step * a2
        a3 = acceleration(u + 0.5 * step * v2, v3, f1)
        v4 = v1 + step * a3
        a4 = acceleration(u + step * v3, v4, f2)
        u = u + step / 6.0 * (v1 + 2.0 * v2 + 2.0 * v3 + v4)
        v = v1 + step / 6.0 * (a1 + 2.0 * a2 + 2.0 * a3 + a4)
        if not np.abs(v).max() < 1e100:  # m/s; NaN does not pass either
            message = f"explicit step {k} at t = {step * k:.6g} s: the solution grows without bound"
            raise ConvergenceError(f"{message}, the step of {step:.4g} s is unstable")
        a = acceleration(u, v, f2)
        old, now = now, State(u, v, a, a, friction(v))
        recorder.add_step(step, (f0, f2), old, now)
        recorder.store(k + 1, now)
        if cycle_steps is not None and (k + 1) % cycle_steps == 0:
            recorder.end_cycle()
    wall_s, counts = time.perf_counter() - begin, {"friction_evaluations": rubs * (4 * n_steps + 1)}
    return recorder.finish(
        0.0, now.u, now.v, now.sigma, steps=n_steps, wall_s=wall_s, counts=counts
    )
