"""Steppers: each advances one system by equal implicit steps and picks what its structure allows.

Four exist: for linear systems (no friction is loaded or evaluated), for tridiagonal ones, for dense
ones, and in :mod:`skfem_joint.steppers_contact` for other sparse ones.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from skfem_joint import friction
from skfem_joint.chain import Chain, bands, build_chain, load_rows
from skfem_joint.errors import InputError
from skfem_joint.recording import Recorder
from skfem_joint.schemes import Coefficients, Scheme
from skfem_joint.steppers_contact import ContactStepper
from skfem_joint.steppers_shared import (
    Failure,
    Start,
    Stepper,
    coefficients_of,
    end_of_step,
    factorised,
    prediction,
)
from skfem_joint.system import System

FloatArray = NDArray[np.float64]

#: Stride of rows that are never stored.
NEVER = 2**62


def _strides(recorder: Recorder, store: bool) -> tuple[int, int]:
    return recorder.save.strides if store else (NEVER, NEVER)


def choose(
    system: System,
    scheme: Scheme,
    u: FloatArray,
    v: FloatArray,
    tolerance: float,
    recorder: Recorder,
) -> Stepper:
    """Stepper for the system's structure.

    Raises
    ------
    InputError
        If no stepper fits: a dense system with set-valued Coulomb friction, or a large sparse
        system whose slip rows do not each pick an unknown of their own.
    """
    arguments = (system, scheme, u, v, tolerance, recorder)
    if system.contact_points == 0:
        return LinearStepper(*arguments)
    if not system.is_dense and _is_chain(system):
        return ChainStepper(*arguments)
    if not system.is_dense and picks_unknowns(system.B, distinct=True):
        return ContactStepper(*arguments)
    if system.is_dense or system.n <= 500:
        return DenseStepper(*arguments)
    raise InputError(
        f"a sparse system of {system.n} unknowns must have one unknown of its own in each slip "
        "row; take slips as unknowns, or reduce it first"
    )


def _is_chain(system: System) -> bool:
    for A in (system.M, system.C, system.K):
        rows = _csr(A)
        row = np.repeat(np.arange(rows.shape[0]), np.diff(rows.indptr))
        beyond = np.abs(row - rows.indices) > 1
        if beyond.any() and rows.data[beyond].any():
            return False
    return picks_unknowns(system.P) and picks_unknowns(system.B, distinct=True)


def picks_unknowns(A: Any, distinct: bool = False) -> bool:
    """Whether each row holds a single 1, in columns of its own if ``distinct``."""
    rows = _csr(A)
    single = bool((np.diff(rows.indptr) == 1).all() and (rows.data == 1.0).all())
    if not distinct or not single or rows.indices.size == 0:
        return single
    return bool(np.bincount(rows.indices).max() == 1)


def _csr(A: Any) -> Any:
    """Compressed rows; making them anew of what has them already takes longer than most steps."""
    return A if isinstance(A, sparse.csr_array) else sparse.csr_array(A)


@dataclass
class LinearStepper:
    """Steps of a system without friction: one factorization, one solve a step."""

    system: System
    scheme: Scheme
    u: FloatArray
    v: FloatArray
    tolerance: float
    recorder: Recorder
    failure: Failure = field(default_factory=Failure)

    def __post_init__(self) -> None:
        self.a = np.zeros_like(self.u)
        self.d = np.zeros_like(self.u)
        self.start = Start(self.scheme)
        self.vectors = self.system.load_vectors()
        self.factors: dict[Coefficients, Any] = {}

    def restart(self, amplitudes: FloatArray) -> None:
        """Acceleration from the equation of motion."""
        s = self.system
        right = self.vectors @ amplitudes - s.C @ self.v - s.K @ self.u
        self.d = factorised(s.M)(right)
        self.a = self.d.copy()
        self.start.after_jump(s, self.d)

    def _factorise(self, c: Coefficients) -> None:
        s = self.system
        self.factors[c] = factorised(c.c_M * s.M + s.C + c.c_K * s.K)

    def advance(self, h: float, amplitudes: FloatArray, first_step: int, store: bool) -> int:
        """Do the steps."""
        s, c, recorder = self.system, self.start.coefficients(h), self.recorder
        if c not in self.factors:
            self._factorise(c)
            recorder.factorizations += 1
        solve = self.factors[c]
        sigma = np.zeros(s.B.shape[0])
        n_steps = int(amplitudes.shape[1]) - 1
        for k in range(n_steps):
            before = u, v, _, d = self.u, self.v, self.a, self.d
            predictor, right = prediction(s, c, self.vectors @ amplitudes[:, k + 1], before)
            v_new = solve(right)
            if not np.all(np.isfinite(v_new)):
                self.failure = Failure(float("nan"), int(np.flatnonzero(~np.isfinite(v_new))[0]))
                return k
            self.u, self.v, self.a, self.d = end_of_step(c, predictor, v_new, before)
            recorder.add_step(
                h,
                (amplitudes[:, k], amplitudes[:, k + 1]),
                (u, v, d, sigma),
                (self.u, self.v, self.d, sigma),
                self.vectors,
            )
            if store:
                recorder.store(first_step + k + 1, self.u, self.v, sigma)
        self.start.done(n_steps)
        return n_steps

    def state(self) -> tuple[FloatArray, FloatArray]:
        """Displacement and velocity."""
        return self.u, self.v

    def normalised_friction(self) -> FloatArray:
        """No friction acts."""
        return np.zeros(self.system.B.shape[0])

    def saved(self) -> dict[str, FloatArray]:
        """State, and the step sizes that were factorised."""
        return {
            "state": np.array([self.u, self.v, self.a, self.d]),
            "steps": np.array(list(self.factors), dtype=float),
            "start": np.array(self.start.frequency),
        }

    def restore(self, saved: Mapping[str, FloatArray]) -> None:
        """Take up a saved state."""
        self.u, self.v, self.a, self.d = saved["state"]
        self.start.frequency = float(saved["start"])
        for row in saved["steps"].tolist():
            self._factorise(coefficients_of(row))


@dataclass
class _CompiledStepper:
    """What the compiled steppers share: ``rows`` holds their state, displacement first."""

    system: System
    scheme: Scheme
    u: FloatArray
    v: FloatArray
    tolerance: float
    recorder: Recorder
    failure: Failure = field(default_factory=Failure)
    rows: FloatArray = field(init=False)
    start: Start = field(init=False)

    def _note(self, done: int, rows: int, fields: int, residual: float, unknown: int) -> int:
        """Note what a compiled loop returned; give the steps that it did."""
        self.recorder.rows += rows
        self.recorder.field_rows += fields
        self.failure = Failure(residual, unknown)
        self.start.done(done)
        return int(done)

    def state(self) -> tuple[FloatArray, FloatArray]:
        """Displacement and velocity."""
        return self.rows[0], self.rows[1]

    def saved(self) -> dict[str, FloatArray]:
        """State rows."""
        return {"state": self.rows, "start": np.array(self.start.frequency)}

    def restore(self, saved: Mapping[str, FloatArray]) -> None:
        """Take up saved state rows."""
        self.rows[...] = saved["state"]
        self.start.frequency = float(saved["start"])


@dataclass
class ChainStepper(_CompiledStepper):
    """Steps of a tridiagonal system whose slip rows each pick one unknown."""

    def __post_init__(self) -> None:
        s = self.system
        n = s.n
        self.start = Start(self.scheme)
        self.contact = np.asarray(_csr(s.B).indices, dtype=np.int64)
        self.w = np.zeros(n)
        self.w[self.contact] = s.w
        self.beta = np.full(n, np.inf)
        self.beta[self.contact] = s.beta
        self.bands = (*bands(s.M), *bands(s.C), *bands(s.K))
        self.loads = load_rows([load.vector for load in s.loads])
        self.point_node = np.asarray(_csr(s.P).indices, dtype=np.int64)
        self.rows = np.zeros((7, n))
        self.rows[0], self.rows[1] = self.u, self.v
        self.chains: dict[Coefficients, Chain] = {}
        self.current: Coefficients | None = None

    def restart(self, amplitudes: FloatArray) -> None:
        """Consistent acceleration: points at rest stick under Coulomb as long as they can."""
        from skfem_joint import kernels_tridiagonal as kernels

        u, v = self.rows[0], self.rows[1]
        s = self.system
        right = s.load_vectors() @ amplitudes - s.C @ v - s.K @ u
        free_to_stick = (self.w > 0.0) & np.isinf(self.beta) & (v == 0.0)
        moving = (self.w > 0.0) & ~free_to_stick
        sigma = np.where(moving, friction.force(v, self.beta), 0.0)
        right -= self.w * sigma
        if not np.any(right):
            acceleration = np.zeros_like(right)
        elif np.any(free_to_stick):
            # The acceleration of points at rest obeys the law that their velocity will.
            M0, M1 = self.bands[:2]
            w = np.where(free_to_stick, self.w, 0.0)
            chain = build_chain(M0, M1, w, np.full(w.size, np.inf))
            g, parameter = np.zeros(chain.H0.size), np.zeros(chain.H0.size)
            g[: w.size] = right
            work, trial = np.zeros((6, w.size)), np.zeros((3, w.size))
            _, _, converged, _, row = kernels.solve_step(
                chain, g, parameter, work, trial, self.tolerance, False
            )
            if not converged:
                raise InputError(
                    f"no consistent initial acceleration found near unknown {row}; "
                    "start the load from zero, e.g. with a ramp"
                )
            acceleration = work[0].copy()
            sigma += work[1]
        else:
            acceleration = factorised(s.M)(right)
        self.rows[2] = self.rows[3] = acceleration
        self.rows[6] = sigma
        self.current = None
        self.start.after_jump(s, acceleration)

    def _build(self, c: Coefficients) -> None:
        M0, M1, C0, C1, K0, K1 = self.bands
        self.chains[c] = build_chain(
            c.c_M * M0 + C0 + c.c_K * K0, c.c_M * M1 + C1 + c.c_K * K1, self.w, self.beta
        )

    def advance(self, h: float, amplitudes: FloatArray, first_step: int, store: bool) -> int:
        """Do the steps in the compiled loop."""
        from skfem_joint import kernels_tridiagonal as kernels

        c = self.start.coefficients(h)
        if c not in self.chains:
            self._build(c)
            self.recorder.factorizations += 1
        chain = self.chains[c]
        if self.current != c:
            # The parameter's scale changes with the step: start again from the law's point.
            v, sigma = self.rows[1], self.rows[6]
            self.rows[4] = self.rows[5] = friction.parameter(v, sigma, chain.kappa, self.beta)
            self.current = c
        r = self.recorder
        result = kernels.march(
            amplitudes.shape[1] - 1,
            first_step,
            *_strides(r, store),
            tuple(c),
            self.bands,
            chain,
            self.tolerance,
            self.loads,
            amplitudes,
            self.point_node,
            self.contact,
            self.rows,
            r.sums(),
            r.free_rows(),
        )
        return self._note(*result)

    def normalised_friction(self) -> FloatArray:
        """Friction force over its limit at the contact points."""
        return np.asarray(self.rows[6][self.contact])

    def saved(self) -> dict[str, FloatArray]:
        """State rows, the step sizes with a chain, and the one that the parameter is scaled to."""
        current = [] if self.current is None else [self.current]
        return super().saved() | {
            "steps": np.array(list(self.chains), dtype=float),
            "current": np.array(current, dtype=float),
        }

    def restore(self, saved: Mapping[str, FloatArray]) -> None:
        """Take up a saved state."""
        super().restore(saved)
        for row in saved["steps"].tolist():
            self._build(coefficients_of(row))
        self.current = next((coefficients_of(row) for row in saved["current"].tolist()), None)


def _dense(A: Any) -> FloatArray:
    return np.ascontiguousarray(A if isinstance(A, np.ndarray) else A.toarray(), dtype=float)


@dataclass
class DenseStepper(_CompiledStepper):
    """Steps of a small dense system."""

    def __post_init__(self) -> None:
        s = self.system
        if np.any(np.isinf(s.beta[s.w > 0.0])):
            raise InputError(
                "set-valued Coulomb friction (beta = inf) needs one unknown for each contact "
                "point, which a reduced or dense system has not; use System.with_beta with a "
                "finite beta"
            )
        self.beta = np.where(s.w > 0.0, s.beta, 1.0)
        self.matrices = (_dense(s.M), _dense(s.C), _dense(s.K))
        self.B, self.P = _dense(s.B), _dense(s.P)
        self.vectors = np.ascontiguousarray(s.load_vectors())
        self.start = Start(self.scheme)
        self.rows = np.zeros((5, s.n))
        self.rows[0], self.rows[1] = self.u, self.v

    def restart(self, amplitudes: FloatArray) -> None:
        """Acceleration from the equation of motion."""
        u, v = self.rows[0], self.rows[1]
        s = self.system
        right = self.vectors @ amplitudes - s.C @ v - s.K @ u
        right -= self.B.T @ (s.on_rows(s.w) * self.normalised_friction())
        self.rows[2] = self.rows[3] = factorised(self.matrices[0])(right)
        self.rows[4] = v
        self.start.after_jump(s, self.rows[3])

    def advance(self, h: float, amplitudes: FloatArray, first_step: int, store: bool) -> int:
        """Do the steps in the compiled loop."""
        from skfem_joint import kernels_dense as kernels

        c = self.start.coefficients(h)
        M, C, K = self.matrices
        s, r = self.system, self.recorder
        if r.factorizations == 0:
            r.factorizations = 1
        result = kernels.march(
            amplitudes.shape[1] - 1,
            first_step,
            *_strides(r, store),
            tuple(c),
            M,
            C,
            K,
            c.c_M * M + C + c.c_K * K,
            kernels.contact_of(self.B, s.first_row, s.w, self.beta),
            self.tolerance,
            self.vectors,
            amplitudes,
            self.P,
            self.rows,
            r.sums(),
            r.free_rows(),
        )
        return self._note(*result)

    def normalised_friction(self) -> FloatArray:
        """Friction force over its limit at the contact points."""
        s = self.system
        return friction.force_vectors(self.B @ self.rows[1], s.beta, s.directions)
