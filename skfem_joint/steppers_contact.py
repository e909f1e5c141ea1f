"""Implicit steps of large sparse systems with contact points: plates, and bars pressed on bars.

Only the contact is nonlinear. Where it is small, everything else is condensed once for each step
size (exactly: a Schur complement of the step matrix), and the iteration runs on the contact alone;
where contact is nearly everywhere it runs on all unknowns, with the factorization kept.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from skfem_joint import friction
from skfem_joint.contact_solver import ContactProblem, Solution, contact_unknowns
from skfem_joint.errors import InputError
from skfem_joint.recording import Recorder
from skfem_joint.schemes import Coefficients, Scheme
from skfem_joint.steppers_shared import (
    Failure,
    Start,
    coefficients_of,
    end_of_step,
    factorised,
    prediction,
)
from skfem_joint.system import System

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]

#: Largest contact, in unknowns, that is condensed, and the most that its square may be for each
#: unknown of the system: beyond it dense products cost more than sparse ones.
CONDENSED, CONDENSED_SQUARE = 1200, 50
#: Right sides solved at once while condensing.
BLOCK = 64


@dataclass(frozen=True)
class _Points:
    """Contact points that carry friction, by unknown."""

    first: IntArray
    second: IntArray
    w: FloatArray
    beta: FloatArray

    def unknowns(self) -> IntArray:
        """All unknowns in contact, sorted."""
        return np.unique(np.concatenate([self.first, self.second[self.second >= 0]]))

    def problem(self, A: Any) -> ContactProblem:
        """Contact problem of a matrix at these points."""
        return ContactProblem(A, self.first, self.second, self.w, self.beta)

    def numbered(self, unknowns: IntArray) -> _Points:
        """Same points where the given unknowns are all that there are."""
        second = np.where(self.second >= 0, np.searchsorted(unknowns, self.second), -1)
        return _Points(np.searchsorted(unknowns, self.first), second, self.w, self.beta)


class _Condensed:
    """Step matrix condensed to its contact unknowns."""

    def __init__(self, H: Any, points: _Points) -> None:
        n = H.shape[0]
        self.n = n
        self.contact = points.unknowns()
        self.rest = np.setdiff1d(np.arange(n), self.contact)
        self.H_rc = sparse.csr_array(H[self.rest][:, self.contact])
        self.H_cr = sparse.csr_array(self.H_rc.T)
        self.factor = factorised(sparse.csc_array(H[self.rest][:, self.rest]))
        S = H[self.contact][:, self.contact].toarray()
        columns = sparse.csc_array(self.H_rc)
        for k in range(0, self.contact.size, BLOCK):
            S[:, k : k + BLOCK] -= self.H_cr @ self.factor(columns[:, k : k + BLOCK].toarray())
        S = np.ascontiguousarray(0.5 * (S + S.T))
        self.problem = points.numbered(self.contact).problem(S)

    def forget(self) -> None:
        self.problem.forget()

    def solve(self, g: FloatArray, start: FloatArray, tolerance: float) -> Solution:
        g_rest = g[self.rest]
        right = g[self.contact] - self.H_cr @ self.factor(g_rest)
        found = self.problem.solve(
            right, start[self.contact], tolerance, force=float(np.abs(g).max())
        )
        v, sigma = np.zeros(self.n), np.zeros(self.n)
        v[self.contact], sigma[self.contact] = found.v, found.sigma
        v[self.rest] = self.factor(g_rest - self.H_rc @ found.v)
        return Solution(
            v,
            sigma,
            found.converged and bool(np.all(np.isfinite(v))),
            found.iterations,
            found.evaluations,
            found.linear_solves + 2,
            found.factorizations,
            found.residual,
            int(self.contact[found.where]),
        )


@dataclass
class ContactStepper:
    """Steps of a sparse system whose slip rows each pick an unknown of their own."""

    system: System
    scheme: Scheme
    u: FloatArray
    v: FloatArray
    tolerance: float
    recorder: Recorder
    failure: Failure = field(default_factory=Failure)

    def __post_init__(self) -> None:
        s = self.system
        self.unknown = np.asarray(sparse.csr_array(s.B).indices, dtype=np.int64)
        first, second = contact_unknowns(s)
        acting = s.w > 0.0
        self.points = _Points(first[acting], second[acting], s.w[acting], s.beta[acting])
        self.w_rows = s.on_rows(s.w)
        self.a = np.zeros_like(self.u)
        self.d = np.zeros_like(self.u)
        self.v_before = self.v.copy()
        self.sigma = self._law()
        self.start = Start(self.scheme)
        self.vectors = s.load_vectors()
        self.matrices: dict[Coefficients, ContactProblem | _Condensed] = {}

    def _slip(self, v: FloatArray) -> FloatArray:
        return np.asarray(v[self.unknown])

    def _law(self) -> FloatArray:
        """Normalised friction at the velocity now, by slip row; 0 for Coulomb points at rest."""
        s = self.system
        sigma = friction.force_vectors(self._slip(self.v), s.beta, s.directions)
        return np.where(self.w_rows > 0.0, sigma, 0.0)

    def _friction(self, sigma: FloatArray) -> FloatArray:
        force = np.zeros(self.system.n)
        force[self.unknown] = self.w_rows * sigma
        return force

    def restart(self, amplitudes: FloatArray) -> None:
        """Consistent acceleration: points at rest stick under Coulomb as long as they can."""
        s, p = self.system, self.points
        right = self.vectors @ amplitudes - s.C @ self.v - s.K @ self.u
        sigma = self._law()
        right -= self._friction(sigma)
        speed = s.slip_norm(self._slip(self.v))[s.w > 0.0]
        at_rest = np.isinf(p.beta) & (speed == 0.0)
        if not np.any(right):
            self.d = np.zeros_like(right)
        elif np.any(at_rest):
            # The acceleration of points at rest obeys the law that their velocity will.
            held = _Points(p.first[at_rest], p.second[at_rest], p.w[at_rest], p.beta[at_rest])
            problem = held.problem(sparse.csr_array(s.M))
            found = problem.solve(right, np.zeros_like(right), self.tolerance)
            if not found.converged:
                raise InputError(
                    f"no consistent initial acceleration found near unknown {found.where}; "
                    "start the load from zero, e.g. with a ramp"
                )
            self.d = found.v
            sigma += found.sigma[self.unknown]
        else:
            self.d = factorised(s.M)(right)
        self.a = self.d.copy()
        self.sigma = sigma
        self.v_before = self.v.copy()
        self.start.after_jump(s, self.d)

    def _prepare(self, c: Coefficients) -> None:
        s = self.system
        H = sparse.csr_array(c.c_M * s.M + s.C + c.c_K * s.K)
        H.sort_indices()
        contact = self.points.unknowns().size
        small = contact <= CONDENSED and contact**2 <= CONDENSED_SQUARE * s.n
        self.matrices[c] = _Condensed(H, self.points) if small else self.points.problem(H)

    def advance(self, h: float, amplitudes: FloatArray, first_step: int, store: bool) -> int:
        """Do the steps."""
        s, c, recorder = self.system, self.start.coefficients(h), self.recorder
        if c not in self.matrices:
            self._prepare(c)
            recorder.factorizations += isinstance(self.matrices[c], _Condensed)
        step_matrix = self.matrices[c]
        step_matrix.forget()  # so that a run taken up again goes on in the same way
        counters = recorder.counters
        n_steps = int(amplitudes.shape[1]) - 1
        for k in range(n_steps):
            before = u, v, _, d = self.u, self.v, self.a, self.d
            predictor, g = prediction(s, c, self.vectors @ amplitudes[:, k + 1], before)
            found = step_matrix.solve(g, self._extrapolated(), self.tolerance)
            counters[0] += found.iterations
            counters[3] += found.evaluations
            counters[4] = max(counters[4], found.iterations)
            counters[6] += found.linear_solves
            recorder.factorizations += found.factorizations
            if not found.converged:
                self.failure = Failure(found.residual, found.where)
                self.start.done(k)
                return k
            sigma = found.sigma[self.unknown]
            at_start = (u, v, d, self.sigma)
            self.v_before = v
            self.u, self.v, self.a, self.d = end_of_step(c, predictor, found.v, before)
            self.sigma = sigma
            recorder.add_step(
                h,
                (amplitudes[:, k], amplitudes[:, k + 1]),
                at_start,
                (self.u, self.v, self.d, sigma),
                self.vectors,
                trapezoidal=c.trapezoidal,
            )
            if store:
                recorder.store(first_step + k + 1, self.u, self.v, sigma)
        self.start.done(n_steps)
        return n_steps

    def _extrapolated(self) -> FloatArray:
        """Velocity to start from: on the line through the last two, at rest where it was."""
        v = 2.0 * self.v - self.v_before
        at_rest = self.system.slip_norm(self._slip(self.v)) == 0.0
        v[self.unknown[self.system.on_rows(at_rest)]] = 0.0
        return np.asarray(v)

    def state(self) -> tuple[FloatArray, FloatArray]:
        """Displacement and velocity."""
        return self.u, self.v

    def normalised_friction(self) -> FloatArray:
        """Friction force over its limit, one value a slip row."""
        return self.sigma

    def saved(self) -> dict[str, FloatArray]:
        """State, friction, and the step sizes that were prepared."""
        return {
            "state": np.array([self.u, self.v, self.a, self.d, self.v_before]),
            "sigma": self.sigma,
            "steps": np.array(list(self.matrices), dtype=float),
            "start": np.array(self.start.frequency),
        }

    def restore(self, saved: Mapping[str, FloatArray]) -> None:
        """Take up a saved state."""
        self.u, self.v, self.a, self.d, self.v_before = saved["state"]
        self.sigma = saved["sigma"]
        self.start.frequency = float(saved["start"])
        for row in saved["steps"].tolist():
            c = coefficients_of(row)
            if c not in self.matrices:
                self._prepare(c)
