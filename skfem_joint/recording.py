"""What a run keeps: stored rows, accumulated works, peaks and counters.

Works of a step use the trapezoidal means of the forces at its ends times the change of
displacement. With the equation of motion holding at both ends this closes the energy balance to
round-off for any one-step scheme:

    change of stored energy = input - viscous - friction - scheme,
    scheme = (du - h vm) M am + vm M (h am - dv),

with vm and am the mean velocity and acceleration: what the scheme's own kinematics dissipates,
zero for the trapezoidal rule.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from skfem_joint.errors import InputError
from skfem_joint.system import System

FloatArray = NDArray[np.float64]

# What a recorder holds, by kind: rows of fields, rows of named points, sums and numbers.
_FIELDS = ("u", "v", "sigma", "work")
_POINTS = ("point_u", "point_v")
_SUMS = ("input_work", "dissipated", "friction_work", "peak", "run_peak", "slip_peak", "counters")
_NUMBERS = ("rows", "field_rows", "factorizations", "halved_steps")


@dataclass(frozen=True)
class Save:
    """What to store of a run.

    Attributes
    ----------
    every : int
        Store the named points at every ``every``-th step (and the start).
    fields : bool
        Displacement, velocity and friction of all unknowns, for snapshots and pictures.
    points : bool
        Displacement and velocity of the named points.
    fields_every : int, optional
        Stride of the fields; ``every`` if not given.
    """

    every: int = 1
    fields: bool = False
    points: bool = True
    fields_every: int | None = None

    def __post_init__(self) -> None:
        for name in ("every", "fields_every"):
            value = getattr(self, name)
            if value is not None and value < 1:
                raise InputError(f"{name}: found {value}, must be >= 1")

    @property
    def strides(self) -> tuple[int, int]:
        """Strides of points and fields."""
        return self.every, self.fields_every or self.every


@dataclass(frozen=True)
class Counters:
    """Work that a run took.

    Attributes
    ----------
    steps : int
        Steps asked for (without the parts of halved ones).
    newton_iterations, largest_iterations : int
        Linear solves of Newton's iteration in all, and the most in one step.
    nested_solves, descents : int
        Steps that needed the second and third tier of the tridiagonal solver.
    line_searches : int
        Evaluations beyond the full Newton step in the dense solver.
    friction_evaluations : int
        Evaluations of the friction law on all contact points.
    linear_solves : int
        Solves with the factor of a large sparse step matrix.
    factorizations : int
        Step matrices prepared (one for each step size).
    halved_steps : int
        Steps that were done in parts because they did not converge whole.
    """

    steps: int = 0
    newton_iterations: int = 0
    largest_iterations: int = 0
    nested_solves: int = 0
    descents: int = 0
    line_searches: int = 0
    friction_evaluations: int = 0
    linear_solves: int = 0
    factorizations: int = 0
    halved_steps: int = 0


@dataclass(frozen=True)
class Cycles:
    """Works of each complete cycle, J; ``input`` has shape (cycles, loads), others (cycles,).

    ``peak`` is the largest displacement of each named point in the cycle, m, (cycles, points).
    """

    input: FloatArray
    viscous: FloatArray
    scheme: FloatArray
    friction: FloatArray
    peak: FloatArray


@dataclass(frozen=True)
class Run:
    """Result of a time integration.

    Attributes
    ----------
    system : System
    times : ndarray, shape (rows,)
        Times of the stored rows, s.
    point_u, point_v : ndarray, shape (rows, points)
        Displacement (m) and velocity (m/s) of the named points.
    amplitudes : ndarray, shape (rows, loads)
        Load amplitudes, N.
    field_times : ndarray, shape (frames,)
        Times of the stored fields, s; empty if none were asked for.
    u, v : ndarray, shape (frames, n)
        Unknowns and their rates.
    sigma : ndarray, shape (frames, rows of B)
        Normalised friction force of the contact points.
    friction_work_rows : ndarray, shape (frames, m)
        Dissipation of each contact point up to the frame, J.
    input_work : ndarray, shape (loads,)
        Work of each load over the run, J.
    viscous_work, scheme_work : float
        Dissipation of C and of the scheme itself, J.
    friction_work : ndarray, shape (m,)
        Dissipation of each contact point, J.
    stored_energy : tuple of float
        Kinetic plus strain energy at start and end, J.
    cycles : Cycles
    peak : ndarray, shape (points,)
        Largest displacement over the run, m.
    slip_peak : ndarray, shape (m,)
        Largest slip displacement (norm) of each contact point over the run, m.
    final : tuple of ndarray
        Displacement and velocity at the end.
    counters : Counters
    wall_s : float
        Time of the integration, s.
    preparation_s : float
        Time to prepare the first step, s: factorization and, at the first use, compilation.
    interrupted : bool
        Whether the run was stopped early on purpose; it holds what was done until then.
    """

    system: System
    times: FloatArray
    point_u: FloatArray
    point_v: FloatArray
    amplitudes: FloatArray
    field_times: FloatArray
    u: FloatArray
    v: FloatArray
    sigma: FloatArray
    friction_work_rows: FloatArray
    input_work: FloatArray
    viscous_work: float
    scheme_work: float
    friction_work: FloatArray
    stored_energy: tuple[float, float]
    cycles: Cycles
    peak: FloatArray
    slip_peak: FloatArray
    final: tuple[FloatArray, FloatArray]
    counters: Counters
    wall_s: float
    preparation_s: float = 0.0
    interrupted: bool = False

    @property
    def energy_residual(self) -> float:
        """Energy left over in the balance, relative to the energy that was in play."""
        start, end = self.stored_energy
        friction = float(self.friction_work.sum())
        dissipated = self.viscous_work + friction + self.scheme_work
        balance = float(self.input_work.sum()) - dissipated - (end - start)
        in_play = max(float(np.abs(self.input_work).sum()), abs(start), abs(end), abs(dissipated))
        return abs(balance) / in_play if in_play > 0.0 else 0.0

    def point(self, name: str) -> FloatArray:
        """Displacement history of a named point, shape (rows,), m."""
        return np.asarray(self.point_u[:, self.system.points.index(name)])


class Sums(NamedTuple):
    """What steps add up in place.

    Attributes
    ----------
    input_work : ndarray, shape (loads,)
        Work of each load, J.
    dissipated : ndarray, shape (2,)
        Viscous and scheme dissipation, J.
    friction_work : ndarray, shape (m,)
        Friction dissipation of each contact point, J.
    peak, slip_peak : ndarray
        Largest displacement of the named points and of the contact points, m.
    counters : ndarray of int64
        Iterations, nested solves, descents, evaluations of the law on all points, largest
        iterations of a step, steps left in which not to start from the steps before, solves with
        a kept factor.
    """

    input_work: Any
    dissipated: Any
    friction_work: Any
    peak: Any
    slip_peak: Any
    counters: Any


class Rows(NamedTuple):
    """Where rows are stored: fields, and displacement and velocity of the named points.

    ``work`` is the friction work of each contact point up to the row, J.
    """

    u: Any
    v: Any
    sigma: Any
    work: Any
    point_u: Any
    point_v: Any


@dataclass
class Recorder:
    """Arrays that steppers fill in place while a run goes on."""

    system: System
    save: Save
    n_steps: int
    h: float
    rows: int = 0
    field_rows: int = 0
    dissipated: FloatArray = field(default_factory=lambda: np.zeros(2))
    counters: NDArray[np.int64] = field(default_factory=lambda: np.zeros(7, dtype=np.int64))
    factorizations: int = 0
    halved_steps: int = 0
    boundaries: list[tuple[FloatArray, FloatArray, float, FloatArray]] = field(default_factory=list)

    def __post_init__(self) -> None:
        n, m, p = self.system.n, self.system.w.size, len(self.system.points)
        every, fields_every = self.save.strides
        fields = self.n_steps // fields_every + 1 if self.save.fields else 0
        points = self.n_steps // every + 1 if self.save.points else 0
        self.u, self.v = np.zeros((fields, n)), np.zeros((fields, n))
        self.sigma = np.zeros((fields, self.system.B.shape[0]))
        self.work = np.zeros((fields, m))
        self.point_u, self.point_v = np.zeros((points, p)), np.zeros((points, p))
        self.input_work = np.zeros(len(self.system.loads))
        self.friction_work = np.zeros(m)
        self.peak = np.zeros(p)
        self.run_peak = np.zeros(p)
        self.slip_peak = np.zeros(m)

    def sums(self) -> Sums:
        """What the compiled steps add up."""
        return Sums(
            self.input_work,
            self.dissipated,
            self.friction_work,
            self.peak,
            self.slip_peak,
            self.counters,
        )

    def free_rows(self) -> Rows:
        """Views of the stored rows from the next free one on."""
        k, f = self.rows, self.field_rows
        fields = self.u[f:], self.v[f:], self.sigma[f:], self.work[f:]
        return Rows(*fields, self.point_u[k:], self.point_v[k:])

    def store(self, step: int, u: FloatArray, v: FloatArray, sigma: FloatArray) -> None:
        """Store what is due after ``step`` steps."""
        every, fields_every = self.save.strides
        if self.save.points and step % every == 0:
            k = self.rows
            self.point_u[k], self.point_v[k] = self.system.P @ u, self.system.P @ v
            self.rows += 1
        if self.save.fields and step % fields_every == 0:
            k = self.field_rows
            self.u[k], self.v[k], self.sigma[k] = u, v, sigma
            self.work[k] = self.friction_work
            self.field_rows += 1

    def observe(self, u: FloatArray) -> None:
        """Update the peaks."""
        np.maximum(self.peak, np.abs(self.system.P @ u), out=self.peak)
        if self.slip_peak.size:
            slip = self.system.slip_norm(self.system.B @ u)
            np.maximum(self.slip_peak, slip, out=self.slip_peak)

    def add_step(
        self,
        h: float,
        amplitudes: tuple[FloatArray, FloatArray],
        old: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
        new: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
        vectors: FloatArray,
        trapezoidal: bool = False,
    ) -> None:
        """Add the works of one step; ``old`` and ``new`` are (u, v, acceleration, sigma).

        A ``trapezoidal`` scheme dissipates nothing by itself.
        """
        system = self.system
        du = new[0] - old[0]
        v_mean, a_mean = 0.5 * (old[1] + new[1]), 0.5 * (old[2] + new[2])
        self.input_work += 0.5 * (amplitudes[0] + amplitudes[1]) * (vectors.T @ du)
        self.dissipated[0] += v_mean @ (system.C @ du)
        if not trapezoidal:
            drift = h * a_mean - (new[1] - old[1])
            self.dissipated[1] += (du - h * v_mean) @ (system.M @ a_mean)
            self.dissipated[1] += v_mean @ (system.M @ drift)
        if self.friction_work.size:
            work = 0.5 * (old[3] + new[3]) * (system.B @ du)
            self.friction_work += system.w * system.by_point(work)
        self.observe(new[0])

    def saved(self) -> dict[str, NDArray[Any]]:
        """All that was filled in so far, for a checkpoint."""
        marks = self.boundaries
        arrays = {name: getattr(self, name)[: self.field_rows] for name in _FIELDS}
        arrays |= {name: getattr(self, name)[: self.rows] for name in _POINTS}
        arrays |= {name: getattr(self, name) for name in _SUMS}
        arrays |= {name: np.array(getattr(self, name)) for name in _NUMBERS}
        arrays |= {f"cycle_{k}": np.array([mark[k] for mark in marks]) for k in range(4)}
        return arrays

    def restore(self, saved: Mapping[str, NDArray[Any]]) -> None:
        """Take up what :meth:`saved` gave."""
        for name in (*_FIELDS, *_POINTS):
            getattr(self, name)[: len(saved[name])] = saved[name]
        for name in _SUMS:
            getattr(self, name)[...] = saved[name]
        for name in _NUMBERS:
            setattr(self, name, int(saved[name]))
        marks = zip(*(saved[f"cycle_{k}"] for k in range(4)), strict=True)
        self.boundaries = [(a, b, float(c), d) for a, b, c, d in marks]

    def end_cycle(self) -> None:
        """Note the accumulated works and this cycle's peaks at the end of a cycle."""
        self.boundaries.append(
            (
                self.input_work.copy(),
                self.dissipated.copy(),
                float(self.friction_work.sum()),
                self.peak.copy(),
            )
        )
        np.maximum(self.run_peak, self.peak, out=self.run_peak)
        self.peak[:] = 0.0

    def finish(
        self,
        start_energy: float,
        u: FloatArray,
        v: FloatArray,
        wall_s: float,
        preparation_s: float,
        steps: int,
        interrupted: bool,
        **counters: int,
    ) -> Run:
        """Close the run."""
        k, f = self.rows, self.field_rows
        every, fields_every = self.save.strides
        times = self.h * every * np.arange(k, dtype=np.float64)
        loads = len(self.system.loads)
        marks: list[Any] = [
            (np.zeros(loads), np.zeros(2), 0.0, np.zeros(self.peak.size)),
            *self.boundaries,
        ]
        dissipated = np.diff(np.array([mark[1] for mark in marks]), axis=0)
        cycles = Cycles(
            input=np.diff(np.array([mark[0] for mark in marks]), axis=0),
            viscous=dissipated[:, 0],
            scheme=dissipated[:, 1],
            friction=np.diff([mark[2] for mark in marks]),
            peak=np.array([mark[3] for mark in marks[1:]]).reshape(-1, self.peak.size),
        )
        return Run(
            system=self.system,
            times=times,
            point_u=self.point_u[:k],
            point_v=self.point_v[:k],
            amplitudes=self.system.load_amplitudes(times).T,
            field_times=self.h * fields_every * np.arange(f, dtype=np.float64),
            u=self.u[:f],
            v=self.v[:f],
            sigma=self.sigma[:f],
            friction_work_rows=self.work[:f],
            input_work=self.input_work,
            viscous_work=float(self.dissipated[0]),
            scheme_work=float(self.dissipated[1]),
            friction_work=self.friction_work,
            stored_energy=(start_energy, self.system.stored_energy(u, v)),
            cycles=cycles,
            peak=np.maximum(self.run_peak, self.peak),
            slip_peak=self.slip_peak,
            final=(u.copy(), v.copy()),
            counters=Counters(
                steps=steps,
                factorizations=self.factorizations,
                halved_steps=self.halved_steps,
                **counters,
            ),
            wall_s=wall_s,
            preparation_s=preparation_s,
            interrupted=interrupted,
        )
