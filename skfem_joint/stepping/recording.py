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
from dataclasses import dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from skfem_joint.arrays import FloatArray
from skfem_joint.errors import InputError
from skfem_joint.friction import AT_LIMIT
from skfem_joint.stepping.schemes import State
from skfem_joint.system import System

# What a recorder holds beside rows: sums and numbers.
_SUMS = ("input_work", "dissipated", "friction_work", "peak", "run_peak", "slip_peak")
_NUMBERS = ("rows", "field_rows", "halved_steps")


@dataclass(frozen=True)
class Save:
    """What to store of a run."""

    every: int = 1  #: stride in steps of the named points, from the start on
    fields: bool = False  #: displacement, velocity and friction of all unknowns too
    points: bool = True  #: displacement and velocity of the named points
    slips: bool = False  #: slip of the joints too, where points are stored
    fields_every: int | None = None  #: stride of the fields; ``every`` if not given

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
    """Work that a run took."""

    steps: int = 0  #: asked for (without the parts of halved ones)
    newton_iterations: int = 0  #: Newton's, each with a tangent of its own, in all
    largest_iterations: int = 0  #: most of them in one step
    nested_solves: int = 0  #: steps that needed the second tier on a chain
    descents: int = 0  #: steps that needed the third
    line_searches: int = 0  #: evaluations beyond the full Newton step in the dense solver
    friction_evaluations: int = 0  #: evaluations of the law on all contact points
    linear_solves: int = 0  #: solves with the factor of a large sparse step matrix
    factorizations: int = 0  #: step matrices prepared (one for each step size)
    halved_steps: int = 0  #: steps that were done in parts because they did not converge whole


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
    by_joint: FloatArray  #: dissipation of friction in each joint, (cycles, joints), J


@dataclass(frozen=True)
class Steady:
    """How steady vibration was found."""

    periods: int  #: that were gone through
    change: float  #: of the state over the last one, relative, in the norm of energy


@dataclass(frozen=True)
class Run:
    """Result of a time integration.

    Rows are stored as asked for by `Save`; works and peaks are those of every step. After an
    interruption it holds the steps that were finished.
    """

    system: System  #: the one given, in whose unknowns and contact points all is told
    times: FloatArray  #: (rows,) of the stored rows, s
    point_u: FloatArray  #: (rows, points) displacement of the named points, m
    point_v: FloatArray  #: (rows, points) their velocity, m/s
    joint_work: FloatArray  #: (rows, joints) dissipation in each joint up to the row, J
    #: (rows, joints) largest slip of its points that carry friction, m; empty if not asked for.
    joint_slip: FloatArray
    joint_slipping: FloatArray  #: (rows, joints) share of its friction that is at its limit; alike
    amplitudes: FloatArray  #: (rows, loads) load amplitudes, N
    field_times: FloatArray  #: (frames,) of the stored fields, s; empty if none were asked for
    u: FloatArray  #: (frames, n) unknowns
    v: FloatArray  #: (frames, n) their rates
    sigma: FloatArray  #: (frames, rows of B) friction force over its limit
    friction_work_rows: FloatArray  #: (frames, m) dissipation of each point up to the frame, J
    input_work: FloatArray  #: (loads,) work of each load over the run, J
    viscous_work: float  #: dissipation of C, J
    scheme_work: float  #: dissipation of the scheme itself, J
    friction_work: FloatArray  #: (m,) dissipation of each contact point, J
    stored_energy: tuple[float, float]  #: kinetic plus strain at start and end, J
    cycles: Cycles
    peak: FloatArray  #: (points,) largest displacement over the run, m
    slip_peak: FloatArray  #: (m,) largest slip displacement (norm) of each contact point, m
    final: tuple[FloatArray, FloatArray]  #: displacement and velocity at the end
    counters: Counters
    wall_s: float  #: time of the integration, s
    preparation_s: float = 0.0  #: time before the first step: factorization, compilation, s
    interrupted: bool = False  #: whether it was stopped early; it holds what was done until then
    steady: Steady | None = None  #: of a run that is one period of steady vibration

    def thinned(self, every: int) -> Run:
        """With every so many of its stored fields."""
        names = ("field_times", "u", "v", "sigma", "friction_work_rows")
        return replace(self, **{name: getattr(self, name)[::every] for name in names})

    @property
    def energy_residual(self) -> float:
        """Energy left over in the balance, relative to the energy that was in play."""
        start, end = self.stored_energy
        friction = float(self.friction_work.sum())
        dissipated = self.viscous_work + friction + self.scheme_work
        balance = float(self.input_work.sum()) - dissipated - (end - start)
        in_play = max(float(np.abs(self.input_work).sum()), abs(start), abs(end), abs(dissipated))
        return abs(balance) / in_play if in_play > 0.0 else 0.0

    def finished(self) -> Run:
        """Pass on a whole run; one that was interrupted is a KeyboardInterrupt again."""
        if self.interrupted:
            raise KeyboardInterrupt
        return self

    def point(self, name: str) -> FloatArray:
        """Displacement history of a named point, shape (rows,), m."""
        return np.asarray(self.point_u[:, self._number(name)])

    def peak_of(self, name: str) -> float:
        """Largest displacement of a named point over every step of the run, m."""
        return float(self.peak[self._number(name)])

    @property
    def friction_energy(self) -> dict[str, float]:
        """Energy that friction has dissipated in each joint over the run, J."""
        energies = (self.system.J @ self.friction_work).tolist()
        return dict(zip(self.system.joints, energies, strict=True))

    def _number(self, name: str) -> int:
        points = self.system.points
        if name not in points:
            raise InputError(f"point: found {name!r}, must be one of {', '.join(points) or 'none'}")
        return points.index(name)


class Rows(NamedTuple):
    """Where rows are stored: fields, and motion of the named points and what the joints do.

    They are named as in `Run`.
    """

    u: FloatArray
    v: FloatArray
    sigma: FloatArray
    friction_work_rows: FloatArray
    point_u: FloatArray
    point_v: FloatArray
    joint_work: FloatArray
    joint_slip: FloatArray
    joint_slipping: FloatArray


@dataclass
class Recorder:
    """Arrays that steppers fill in place while a run of ``n_steps`` steps of ``h`` goes on."""

    system: System
    save: Save
    n_steps: int
    h: float
    rows: int = 0
    field_rows: int = 0
    halved_steps: int = 0
    dissipated: FloatArray = field(default_factory=lambda: np.zeros(2))

    def __post_init__(self) -> None:
        s, (every, fields_every) = self.system, self.save.strides
        fields = self.n_steps // fields_every + 1 if self.save.fields else 0
        points = self.n_steps // every + 1 if self.save.points else 0
        slips = points if self.save.slips else 0
        m, p, joints = s.w.size, len(s.points), len(s.joints)
        shapes = [(fields, size) for size in (s.n, s.n, s.B.shape[0], m)]
        shapes += [(points, size) for size in (p, p, joints)] + 2 * [(slips, joints)]
        self.stored = Rows(*map(np.zeros, shapes))
        self._limits = sparse.csr_array(s.J).toarray() * s.w  # in each joint
        self.input_work = np.zeros(len(s.loads))
        self.friction_work, self.slip_peak = np.zeros((2, m))
        self.peak, self.run_peak = np.zeros((2, p))
        self.vectors = s.load_vectors()
        # Works up to the start and to the end of each cycle, and the peaks in the cycle.
        self.boundaries = [np.zeros(len(s.loads) + 3 + joints + p)]

    def sums(self) -> tuple[FloatArray, ...]:
        """What the compiled steps add up, see `Run`; dissipated are viscous and scheme, J."""
        return self.input_work, self.dissipated, self.friction_work, self.peak, self.slip_peak

    def free_rows(self) -> Rows:
        """Views of the stored rows from the next free one on."""
        return Rows(*(rows[end:] for rows, end in zip(self.stored, self._ends(), strict=True)))

    def _ends(self) -> list[int]:
        """How many rows of each kind are filled."""
        return 4 * [self.field_rows] + 5 * [self.rows]

    def _filled(self) -> dict[str, Any]:
        """Rows that are stored so far, by their names in `Run`."""
        stored = self.stored._asdict().items()
        return {name: rows[:end] for (name, rows), end in zip(stored, self._ends(), strict=True)}

    def store(self, step: int, state: State) -> None:
        """Store what is due after ``step`` steps."""
        every, fields_every = self.save.strides
        system, stored = self.system, self.stored
        if self.save.points and step % every == 0:
            k = self.rows
            stored.point_u[k], stored.point_v[k] = system.P @ state.u, system.P @ state.v
            stored.joint_work[k] = system.J @ self.friction_work
            if self.save.slips:
                slip = system.slip_norm(system.B @ state.u)
                reached = system.slip_norm(state.sigma) >= AT_LIMIT
                for j, limit in enumerate(self._limits):
                    if limit.any():
                        stored.joint_slip[k, j] = slip[limit > 0.0].max()
                        stored.joint_slipping[k, j] = limit[reached].sum() / limit.sum()
            self.rows += 1
        if self.save.fields and step % fields_every == 0:
            k = self.field_rows
            stored.u[k], stored.v[k], stored.sigma[k] = state.u, state.v, state.sigma
            stored.friction_work_rows[k] = self.friction_work
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
        old: State,
        new: State,
        trapezoidal: bool = False,
    ) -> None:
        """Add the works of a step of ``h`` done in Python; `march` does it for its own.

        ``amplitudes`` are those of the loads at both ends, N. A ``trapezoidal`` scheme dissipates
        nothing by itself.
        """
        system = self.system
        du = new.u - old.u
        v_mean, a_mean = 0.5 * (old.v + new.v), 0.5 * (old.d + new.d)
        self.input_work += 0.5 * (amplitudes[0] + amplitudes[1]) * (self.vectors.T @ du)
        self.dissipated[0] += v_mean @ (system.C @ du)
        if not trapezoidal:
            drift = h * a_mean - (new.v - old.v)
            self.dissipated[1] += (du - h * v_mean) @ (system.M @ a_mean)
            self.dissipated[1] += v_mean @ (system.M @ drift)
        if self.friction_work.size:
            work = 0.5 * (old.sigma + new.sigma) * (system.B @ du)
            self.friction_work += system.w * system.by_point(work)
        self.observe(new.u)

    def saved(self) -> dict[str, NDArray[Any]]:
        """All that was filled in so far, for a checkpoint."""
        return self._filled() | {"boundaries": np.array(self.boundaries)} | self.mark()

    def mark(self) -> dict[str, NDArray[Any]]:
        """Copies of all but stored rows and finished cycles, which are only ever added to."""
        arrays = {name: np.array(getattr(self, name)) for name in (*_SUMS, *_NUMBERS)}
        return arrays | {"cycles": np.array(len(self.boundaries))}

    def restore(self, saved: Mapping[str, NDArray[Any]]) -> None:
        """Take up what :meth:`saved` or, in the same run, :meth:`mark` gave."""
        for name, rows in self.stored._asdict().items():
            if name in saved:
                rows[: len(saved[name])] = saved[name]
        for name in _SUMS:
            getattr(self, name)[...] = saved[name]
        for name in _NUMBERS:
            setattr(self, name, int(saved[name]))
        if "boundaries" in saved:
            self.boundaries = list(saved["boundaries"])
        del self.boundaries[int(saved["cycles"]) :]

    def end_cycle(self) -> None:
        """Note the accumulated works and this cycle's peaks at the end of a cycle."""
        by_joint, total = self.system.J @ self.friction_work, [self.friction_work.sum()]
        works = self.input_work, self.dissipated, total, by_joint, self.peak
        self.boundaries.append(np.concatenate(works))
        np.maximum(self.run_peak, self.peak, out=self.run_peak)
        self.peak[:] = 0.0

    def _cycles(self) -> Cycles:
        marks, k = np.array(self.boundaries), self.input_work.size
        works = marks[1:] - marks[:-1]
        end = k + 3 + len(self.system.joints)
        sums = works[:, :k], works[:, k], works[:, k + 1], works[:, k + 2]
        return Cycles(*sums, marks[1:, end:], works[:, k + 3 : end])

    def finish(
        self,
        start_energy: float,
        u: FloatArray,
        v: FloatArray,
        *,
        steps: int,
        counts: Mapping[str, int],
        **told: Any,
    ) -> Run:
        """Close the run; ``counts`` are those of the stepper, ``told`` what else a `Run` tells."""
        every, fields_every = self.save.strides
        times = self.h * every * np.arange(self.rows, dtype=np.float64)
        return Run(
            system=self.system,
            times=times,
            amplitudes=self.system.load_amplitudes(times).T,
            field_times=self.h * fields_every * np.arange(self.field_rows, dtype=np.float64),
            **self._filled(),
            input_work=self.input_work,
            viscous_work=float(self.dissipated[0]),
            scheme_work=float(self.dissipated[1]),
            friction_work=self.friction_work,
            stored_energy=(start_energy, self.system.stored_energy(u, v)),
            cycles=self._cycles(),
            peak=np.maximum(self.run_peak, self.peak),
            slip_peak=self.slip_peak,
            final=(u.copy(), v.copy()),
            counters=Counters(steps=steps, halved_steps=self.halved_steps, **counts),
            **told,
        )
