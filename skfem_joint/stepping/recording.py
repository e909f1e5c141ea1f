"""What a run keeps: stored rows, accumulated works, peaks and counters."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from skfem_joint.ground.arrays import FloatArray, check_like
from skfem_joint.ground.errors import InputError, first_of
from skfem_joint.ground.plain_values import Tabular, spread
from skfem_joint.ground.values import COUNT, check, check_some
from skfem_joint.linalg.compressed import compressed_rows
from skfem_joint.linalg.vectors import raise_to, raise_to_norms
from skfem_joint.minimise.problem import row_order
from skfem_joint.stepping import energy
from skfem_joint.stepping.loops import Loops
from skfem_joint.stepping.schemes import State
from skfem_joint.system.system import System

# What a recorder holds beside rows: sums and numbers.
_SUMS = (
    *("input_work", "dissipated", "friction_work", "peak", "run_peak", "slip_peak", "slider_peak"),
    *("impact_work", "normal_force_peak", "normal_force_least"),
    *("strain_peak", "work_before", "cycle_work"),
)
_NUMBERS = ("rows", "field_rows", "halved_steps")
#: Slip of a slider, over that of its point, that the round-off of its spring's force may be.
STILL = 1e-9


@dataclass(frozen=True)
class Save:
    """What to store of a run.

    Peaks, works and slips are accumulated over every step, whatever is stored.

    Attributes
    ----------
    every : int
        The named points are stored at the start and after every so many steps.
    fields : bool
        Whether displacement, velocity and friction of all unknowns are stored too.
    points : bool
        Whether displacement and velocity of the named points are stored.
    slips : bool
        Whether slips of the joints are stored too, where points are.
    fields_every : int, optional
        The fields are stored at the start and after every so many steps; ``every`` if not given.
    """

    every: int = 1
    fields: bool = False
    points: bool = True
    slips: bool = False
    fields_every: int | None = None

    def __post_init__(self) -> None:
        check("every", self.every, COUNT)
        check_some(COUNT, fields_every=self.fields_every)

    @property
    def strides(self) -> tuple[int, int]:
        """Strides of points and fields."""
        return self.every, self.fields_every or self.every


@dataclass(frozen=True)
class Counters:
    """Work that a run took, in numbers.

    Attributes
    ----------
    steps : int
        Steps asked for; the parts of halved ones are not counted.
    newton_iterations : int
        Newton iterations with a tangent of their own (passes of elimination under Coulomb friction
        on chains).
    largest_iterations : int
        Most of them in one step.
    nested_solves, descents : int
        Steps on a chain that needed the second and the third tier.
    line_searches : int
        Evaluations of friction beyond the full Newton step, in dense systems.
    friction_evaluations : int
        Evaluations of the law at all contact points.
    linear_solves : int
        Solves with the factor of a sparse step matrix.
    factorizations : int
        Step matrices prepared, one for each step size, and tangents factorised.
    halved_steps : int
        Steps that were done in parts because they did not converge whole.
    renewed_limits : int
        Times that friction limits of contact that opens were renewed in the safeguarded iteration.
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
    renewed_limits: int = 0


@dataclass(frozen=True, repr=False)
class Cycles:
    """Works and peaks of each complete cycle of a run, over every step of it.

    Columns are ordered as ``system.loads``, ``system.points`` and ``system.contact.joints``. There
    are no rows where the run had no cycles.

    Attributes
    ----------
    input : ndarray, shape (cycles, loads)
        Work of each load, J.
    viscous, scheme, friction : ndarray, shape (cycles,)
        Energy dissipated by the damping matrix, by the integration scheme itself and by friction
        in all joints, J.
    impact : ndarray, shape (cycles,)
        Energy lost by impacts where contact closes, J.
    strain : ndarray, shape (cycles,)
        Largest strain energy, J, with that of springs in series and of contact that opens, which is
        zero at rest.
    peak : ndarray, shape (cycles, points)
        Largest displacement of each named point, m.
    by_joint : ndarray, shape (cycles, joints)
        Energy dissipated by friction in each joint, J.
    by_point : ndarray, shape (m,)
        Energy dissipated by friction at each contact point in the last cycle, J; empty without
        cycles.
    """

    input: FloatArray
    viscous: FloatArray
    scheme: FloatArray
    friction: FloatArray
    impact: FloatArray
    strain: FloatArray
    peak: FloatArray
    by_joint: FloatArray
    by_point: FloatArray

    def __repr__(self) -> str:
        if not self.friction.size:
            return "Cycles: none"
        return (
            f"Cycles: {self.friction.size}; in the last one input {self.input[-1].sum():.6g} J, "
            f"dissipated by friction {self.friction[-1]:.6g} J, by damping {self.viscous[-1]:.6g} "
            f"J, by the scheme {self.scheme[-1]:.6g} J"
        )


@dataclass(frozen=True)
class Steady:
    """Steady vibration of the named points, and the search for it.

    Amplitude and offset are taken from every step of the period, whatever rows are stored. For a
    body that drifts an even motion by ``drift`` in the period is subtracted first.

    Attributes
    ----------
    periods : int
        Periods that were gone through.
    change : float
        Change of the state over the last one, relative, in the norm of energy.
    amplitude : ndarray, shape (points,)
        Half of peak to peak, m.
    offset : ndarray, shape (points,)
        Mean of the highest and the lowest displacement, m. It is not unique: where joints come to
        rest depends on how the vibration began, and so does the place of bodies that friction
        alone holds (``unstrained`` above zero). Under loads that change their sign every half
        period the search returns the vibration without an offset, under other loads one that
        begins with the rigid displacement at the start of the run.
    drift : ndarray, shape (points,)
        Rigid displacement in a period, m, of bodies that friction alone holds.
    unstrained : int
        Number of rigid motions that friction alone holds, or nothing.
    notes : tuple of str
        What to beware of: with contact that opens it need not be the only steady vibration.
    """

    periods: int
    change: float
    amplitude: FloatArray
    offset: FloatArray
    drift: FloatArray
    unstrained: int
    notes: tuple[str, ...] = ()


class Final(NamedTuple):
    """Displacement and velocity at the end of a run, in the unknowns of its system."""

    displacement: FloatArray
    velocity: FloatArray


class Ending(NamedTuple):
    """State of a stepper at the end of a run, in the unknowns in which it steps.

    Attributes
    ----------
    state : tuple of (str, ndarray)
        Arrays by name, as the stepper saves them.
    force : ndarray, shape (n,)
        Of the loads at the end, N.
    """

    state: tuple[tuple[str, NDArray[Any]], ...]
    force: FloatArray


@dataclass(frozen=True, repr=False)
class Run(Tabular):
    """Result of a time integration.

    Rows and frames are stored as asked for by `Save`; works and peaks are those of every step.
    After an interruption it holds the steps that were finished. Columns are ordered as
    ``system.points``, ``system.loads`` and ``system.contact.joints``; the n unknowns and m contact
    points are those of ``system``, the rows of ``system.contact.B`` those of the contact points in
    turn, one or two of each.

    Attributes
    ----------
    system : System
        The system that was integrated.
    times : ndarray, shape (rows,)
        Time of the stored rows, s.
    point_u, point_v : ndarray, shape (rows, points)
        Displacement (m) and velocity (m/s) of the named points.
    joint_work : ndarray, shape (rows, joints)
        Energy that friction has dissipated in each joint up to the row, J.
    joint_slip, joint_slipping : ndarray, shape (rows, joints)
        Largest slip (m) of the points of each joint that carry friction, and share of its friction
        limit whose points slip: their friction has reached its limit, and they have slid since the
        start as `System.slipping` has it; no rows unless `Save.slips` was set.
    amplitudes : ndarray, shape (rows, loads)
        Amplitude of each load, N.
    field_times : ndarray, shape (frames,)
        Time of the stored fields, s; no frames unless `Save.fields` was set.
    u, v : ndarray, shape (frames, n)
        Unknowns (m; the unit of a reduced system's follows from its basis) and their rates (1/s of
        that). ``system.expand(u)`` gives all displacements.
    sigma : ndarray, shape (frames, rows of B)
        Friction force over its limit, from -1 to 1. Of points that stick in a reduced model only
        those sums are sure that do work in its few motions.
    friction_work_rows : ndarray, shape (frames, m)
        Energy that friction has dissipated at each contact point up to the frame, J.
    input_work : ndarray, shape (loads,)
        Work of each load over the run, J.
    viscous_work, scheme_work : float
        Energy dissipated over the run by the damping matrix and by the scheme itself, J.
    friction_work : ndarray, shape (m,)
        Energy dissipated over the run by friction at each contact point, J: without what its
        spring, if it has one, stores.
    stored_energy : tuple of float
        Kinetic plus strain energy at the start and at the end, J, with that of the springs in
        series with friction.
    cycles : Cycles
        Works and peaks cycle by cycle.
    peak : ndarray, shape (points,)
        Largest displacement of each named point over the run, m.
    slip_peak : ndarray, shape (m,)
        Largest slip of each contact point over the run, m: of two directions the norm.
    slider_peak : ndarray, shape (m,)
        The same of its slider: what a spring in series leaves.
    final : Final
        Unknowns and their rates at the end. A further run goes on from the run itself,
        ``initial=run``: forces of friction, springs and contact are part of the state too.
    final_sigma : ndarray, shape (rows of B,)
        Friction over its limit at the end.
    final_limits : ndarray, shape (m,)
        Friction limits at the end, N.
    counters : Counters
        Work that it took.
    wall_s, preparation_s, compilation_s : float
        Time of the steps, time before the first one without compilation, and time of compilation,
        which happens once on a machine, s.
    interrupted : bool
        Whether it was stopped early: by Ctrl-C, or of a quasi-static run where no level follows.
    steady : Steady or None
        Steady vibration, of a run that is a period of it.
    plan : Plan, optional
        Steps, scheme and end, as it was asked for.
    start : tuple of ndarray, shapes (n,) and (n,), optional
        Displacement (m) and velocity (m/s) at the start, and, if given, friction and its limits;
        None for a run from rest.
    impact_work : float
        Energy lost by impacts where contact closes, J; zero without contact that opens.
    normal_force : ndarray, shape (frames, q)
        Normal force of each pressure point of contact that opens, N, with the stored fields.
    limits : ndarray, shape (frames, m)
        Friction limits with the stored fields, N.
    normal_force_peak, normal_force_least : ndarray, shape (q,)
        Largest and smallest normal forces over every step, N.
    loops : Loops or None
        Force over displacement of each load and over slip of each joint, of a quasi-static run.
        Its velocities are changes over the last step, its final velocity is zero, and no work is
        kinetic or viscous.
    ending : Ending, optional
        All that the next step would have started from; None of a quasi-static run.
    notes : tuple of str
        What to beware of, in whole sentences.
    """

    system: System
    times: FloatArray
    point_u: FloatArray
    point_v: FloatArray
    joint_work: FloatArray
    joint_slip: FloatArray
    joint_slipping: FloatArray
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
    slider_peak: FloatArray
    final: Final
    final_sigma: FloatArray
    final_limits: FloatArray
    counters: Counters
    wall_s: float
    preparation_s: float = 0.0
    compilation_s: float = 0.0
    interrupted: bool = False
    steady: Steady | None = None
    plan: Any = None
    start: tuple[FloatArray, ...] | None = None
    impact_work: float = 0.0
    normal_force: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    limits: FloatArray = field(default_factory=lambda: np.zeros((0, 0)))
    normal_force_peak: FloatArray = field(default_factory=lambda: np.zeros(0))
    normal_force_least: FloatArray = field(default_factory=lambda: np.zeros(0))
    loops: Loops | None = None
    ending: Ending | None = field(default=None, repr=False, compare=False)
    notes: tuple[str, ...] = ()

    @property
    def table(self) -> dict[str, Any]:
        """Columns with a row for each stored time: loads, named points, friction energy."""
        points, joints = self.system.points, self.system.contact.joints
        return {
            "time_s": self.times,
            **spread("load_{}", self.amplitudes),
            **spread("displacement_{}_m", self.point_u, points),
            **spread("velocity_{}_m_per_s", self.point_v, points),
            **spread("friction_energy_{}_J", self.joint_work, joints),
        }

    @property
    def end(self) -> tuple[FloatArray, ...]:
        """State at the end, from which a run goes on as after a jump of its loads.

        Displacement, velocity and friction over its limit, and with contact that opens the limits,
        see `integrate`.
        """
        limits = () if not self.system.contact.opens else (self.final_limits,)
        return *self.final, self.final_sigma, *limits

    def __repr__(self) -> str:
        """A few lines: what was run, stored, reached and dissipated."""
        system, until = self.system, f", to {self.times[-1]:.6g} s" if self.times.size else ""
        peaks = dict(zip(system.points, self.peak.tolist(), strict=True))
        state = ", interrupted" if self.interrupted else ""
        if self.steady is not None:
            state += f", steady after {self.steady.periods} periods"
        return "\n".join(
            [
                f"Run of {self.counters.steps} steps{until}{state}",
                f"  system: {system.n} unknowns, {system.contact.count} contact points",
                f"  stored: {self.times.size} rows of points, {self.field_times.size} of fields",
                f"  peaks: {_first_of(peaks, 'm')}",
                f"  friction energy: {_first_of(self.friction_energy, 'J')}; "
                f"energy balance open by {self.energy_residual:.1e}",
                f"  {self.cycles!r}",
                f"  time: {self.wall_s:.3g} s, preparation {self.preparation_s:.3g} s, compilation "
                f"{self.compilation_s:.3g} s",
                *(f"  note: {note}" for note in self.notes),
            ]
        )

    @property
    def energy_residual(self) -> float:
        """Error of the energy balance relative to the largest energy in it."""
        start, end = self.stored_energy
        balance = float(self.input_work.sum()) - self._dissipated - (end - start)
        return abs(balance) / self.in_play if self.in_play > 0.0 else 0.0

    @property
    def _dissipated(self) -> float:
        """Energy lost over the run, J."""
        works = self.viscous_work, float(self.friction_work.sum()), self.scheme_work
        return sum(works) + self.impact_work

    @property
    def in_play(self) -> float:
        """Largest energy in the balance, J."""
        energies = *self.stored_energy, self._dissipated
        in_play = max(float(np.abs(self.input_work).sum()), *map(abs, energies))
        if self.loops is not None:
            # A whole cycle in which all points stick or lift takes nothing: what it stored then.
            works = self.loops.load_force * self.loops.load_displacement
            in_play = max(in_play, 0.5 * float(np.abs(works).sum(axis=1).max()))
        return in_play

    @property
    def opened(self) -> NDArray[np.bool_]:
        """Whether each pressure point that is pressed at rest came apart in some step, (q,)."""
        return np.asarray(
            (self.system.contact.normal.force > 0.0) & (self.normal_force_least <= 0.0)
        )

    def finished(self) -> Run:
        """The run itself; raises KeyboardInterrupt if it was interrupted."""
        if self.interrupted:
            raise KeyboardInterrupt
        return self

    def point(self, name: str) -> FloatArray:
        """Displacement history of a named point, shape (rows,), m."""
        return np.asarray(self.point_u[:, self._number(name)])

    def peak_of(self, name: str) -> float:
        """Largest displacement of a named point over every step of the run, m."""
        return float(self.peak[self._number(name)])

    def amplitude_of(self, name: str) -> float:
        """Half of peak to peak of a named point in steady vibration, m; see `vibration`."""
        return float(self.vibration.amplitude[self._number(name)])

    def offset_of(self, name: str) -> float:
        """Mean of both peaks of a named point in steady vibration, m; see `vibration`."""
        return float(self.vibration.offset[self._number(name)])

    @property
    def vibration(self) -> Steady:
        """Steady vibration; InputError if the run is not one until "steady"."""
        if self.steady is None:
            raise InputError("run: is not one of steady vibration; integrate with until='steady'")
        return self.steady

    @property
    def friction_energy(self) -> dict[str, float]:
        """Energy that friction has dissipated over the run in each joint, by its name, J."""
        energies = (self.system.contact.J @ self.friction_work).tolist()
        return dict(zip(self.system.contact.joints, energies, strict=True))

    def _number(self, name: str) -> int:
        points = self.system.points
        if name not in points:
            raise InputError(f"point: found {name!r}, must be one of {', '.join(points) or 'none'}")
        return points.index(name)


def _first_of(values: Mapping[str, float], unit: str) -> str:
    """First named values with their unit, and how many more there are."""
    return first_of([f"{name} {value:.6g} {unit}" for name, value in values.items()])


class StoredRows(NamedTuple):
    """Arrays of stored rows: six of fields, five of named points and joints; names as in `Run`.

    Those of friction limits are empty where these do not change.
    """

    u: FloatArray
    v: FloatArray
    sigma: FloatArray
    friction_work_rows: FloatArray
    normal_force: FloatArray
    limits: FloatArray
    point_u: FloatArray
    point_v: FloatArray
    joint_work: FloatArray
    joint_slip: FloatArray
    joint_slipping: FloatArray


@dataclass
class Recorder:
    """Arrays that steppers fill in place during a run of ``n_steps`` steps of ``h`` seconds.

    Attributes
    ----------
    rows, field_rows : int
        Rows of points and of fields that are stored so far.
    halved_steps : int
    dissipated : ndarray, shape (2,)
        Dissipation of damping and of the scheme so far, J.
    stored : StoredRows
    vectors : ndarray, shape (n, loads)
        Load vectors.
    order : tuple of ndarray or slice
        Order of slip rows and of points in the bookkeeping, see `row_order`.
    joints : tuple of ndarray
        ``start``, ``point``, ``value``, ``share``, ``sliding`` and ``creep`` of the points with
        friction of each joint: its parts in their works, and what `energy.joint_slips` takes.
    creeps : bool
        Whether points that stick creep under their law, as time goes on.
    by_cycle : bool
        Whether cycles end in the run, so that their strain energies and the works of their points
        are kept.
    """

    system: System
    save: Save
    n_steps: int
    h: float
    rows: int = 0
    field_rows: int = 0
    halved_steps: int = 0
    dissipated: FloatArray = field(default_factory=lambda: np.zeros(2))
    creeps: bool = True
    by_cycle: bool = False

    def __post_init__(self) -> None:
        s, (every, fields_every) = self.system, self.save.strides
        fields = self.n_steps // fields_every + 1 if self.save.fields else 0
        points = self.n_steps // every + 1 if self.save.points else 0
        slips = points if self.save.slips else 0
        m, p, joints = s.contact.w.size, len(s.points), len(s.contact.joints)
        q, changing = s.contact.normal.gap.size, m if s.contact.opens else 0
        sizes = s.n, s.n, s.contact.B.shape[0], m, q, changing
        shapes = [(fields, size) for size in sizes]
        shapes += [(points, size) for size in (p, p, joints)] + 2 * [(slips, joints)]
        try:
            self.stored = StoredRows(*map(np.zeros, shapes))
        except (MemoryError, ValueError) as error:  # ValueError: beyond all memory
            raise InputError(
                f"save: {points} rows of points and {fields} of fields do not fit into memory; "
                "store fewer of them, or give fewer steps"
            ) from error
        single = (s.contact.directions == 1).all()  # then the order is the system's own
        self.order = 2 * (slice(None),) if single else row_order(s.contact.directions)
        self._limits = s.contact.on_rows(s.contact.w)[self.order[0]]
        self._rubs = bool(s.contact.count)
        carrying = sparse.csr_array(s.contact.J * s.contact.rubs)
        carrying.eliminate_zeros()
        start, point, value = compressed_rows(carrying)
        weights = s.contact.point_weights
        share = value * weights[point] / np.repeat(s.contact.J @ weights, np.diff(start))
        # Points without a limit at rest are taken as if they had that of the others.
        weights = np.where(weights > 0.0, weights, weights.mean() if weights.any() else 1.0)[point]
        creep = self.creeps / s.contact.beta[point]
        self.joints = start, point, value, share, 0.25 / weights, creep
        self.input_work, self.impact_work = np.zeros(len(s.loads)), np.zeros(1)
        self.friction_work, self.slip_peak = np.zeros((2, m))
        self.peak, self.run_peak = np.zeros((2, p))
        # Where limits change a slider's slip does not follow from that of its point.
        self.slider_peak = np.zeros(changing if s.contact.has_springs else 0)
        self.normal_force_peak = np.zeros(q)
        self.normal_force_least = s.contact.normal.force.copy()
        self.vectors = s.load_vectors()
        # Largest strain energy in the cycle, friction works at its start and those in the last one.
        self.strain_peak = np.zeros(int(self.by_cycle))
        self.work_before, self.cycle_work = np.zeros((2, m * self.by_cycle))
        # Works up to the start and to the end of each cycle, and the peaks in the cycle.
        self.boundaries = [np.zeros(len(s.loads) + 4 + joints + p + self.strain_peak.size)]

    def sums(self) -> tuple[FloatArray, ...]:
        """Works and peaks so far, which the compiled loop adds to in place."""
        works = self.input_work, self.dissipated, self.friction_work
        return *works, self.peak, self.slip_peak, self.strain_peak

    def free_rows(self) -> StoredRows:
        """Views of the stored rows from the next free one on."""
        ends = zip(self.stored, self._ends(), strict=True)
        return StoredRows(*(rows[end:] for rows, end in ends))

    def _ends(self) -> list[int]:
        """How many rows of each kind are filled."""
        return 6 * [self.field_rows] + 5 * [self.rows]

    @property
    def limits(self) -> FloatArray:
        """Stored friction limits, (frames, m), N, where they change."""
        return self.stored.limits

    def _filled(self) -> dict[str, Any]:
        """Rows that are stored so far, by their names in `Run`."""
        stored = self.stored._asdict().items()
        return {name: rows[:end] for (name, rows), end in zip(stored, self._ends(), strict=True)}

    def store(self, step: int, state: State, limits: FloatArray | None = None) -> None:
        """Store what is due after ``step`` steps; ``limits`` (m,), N, are given if they change."""
        every, fields_every = self.save.strides
        system, stored = self.system, self.stored
        if self.save.points and step % every == 0:
            k = self.rows
            stored.point_u[k], stored.point_v[k] = system.P @ state.u, system.P @ state.v
            stored.joint_work[k] = system.contact.J @ self.friction_work
            if self.save.slips:
                start, point, _, share, sliding, creep = self.joints
                if limits is not None:
                    share = self._shares(limits)
                time, work = step * self.h, self.friction_work
                sizes = (
                    system.contact.slip_norm(system.contact.B @ state.u),
                    system.contact.slip_norm(state.sigma),
                )
                results = stored.joint_slip[k], stored.joint_slipping[k]
                energy.joint_slips(
                    start, point, share, sliding, creep, time, work, *sizes, *results
                )
            self.rows += 1
        if self.save.fields and step % fields_every == 0:
            k = self.field_rows
            stored.u[k], stored.v[k], stored.sigma[k] = state.u, state.v, state.sigma
            stored.friction_work_rows[k] = self.friction_work
            if limits is not None:
                self.limits[k] = limits
            self.field_rows += 1

    def _shares(self, limits: FloatArray) -> FloatArray:
        """Shares of the points with friction in the present limit of their joints; 0 without."""
        start, point, value = self.joints[:3]
        whole = np.repeat(self.system.contact.J @ limits, np.diff(start))
        own: FloatArray = value * limits[point]
        shares: FloatArray = np.divide(own, whole, out=np.zeros_like(own), where=whole > 0.0)
        return shares

    def store_normal(self, step: int, force: FloatArray) -> None:
        """Store normal forces, (q,), N, that are due after ``step`` steps; after :meth:`store`."""
        np.maximum(self.normal_force_peak, force, out=self.normal_force_peak)
        np.minimum(self.normal_force_least, force, out=self.normal_force_least)
        if self.save.fields and step % self.save.strides[1] == 0:
            self.stored.normal_force[self.field_rows - 1] = force

    def observe(self, state: State, limits: FloatArray | None = None) -> None:
        """Update the peaks; ``limits`` (m,), N, are given if they change."""
        system = self.system
        raise_to(self.peak, system.P @ state.u)
        if self.by_cycle:
            strain = system.strain_energy(state.u, state.sigma, limits)
            np.maximum(self.strain_peak, strain, out=self.strain_peak)
        if self.slip_peak.size:
            slip = np.asarray(system.contact.B @ state.u)
            self._raise(self.slip_peak, slip)
            if self.slider_peak.size and limits is not None:
                force = system.contact.on_rows(limits) * state.sigma
                self._raise(self.slider_peak, slip - system.contact.spring_flexibility * force)

    def _raise(self, peaks: FloatArray, slip: FloatArray) -> None:
        """Raise largest slips of the points, (m,), to those of the slip rows, (rows,), m."""
        rows, points = self.order
        peak = peaks[points]
        raise_to_norms(peak, slip[rows])
        peaks[points] = peak

    @property
    def _slid(self) -> FloatArray:
        """Largest slip of each slider so far, (m,), m; what is round-off of its spring's is none.

        Under a limit that does not change it follows from that of the point.
        """
        if not self.slider_peak.size:
            return self.system.contact.slider_peak(self.slip_peak)
        return np.where(self.slider_peak > STILL * self.slip_peak, self.slider_peak, 0.0)

    def add_step(
        self,
        h: float,
        amplitudes: tuple[FloatArray, FloatArray],
        old: State,
        new: State,
        trapezoidal: bool = False,
        forces: tuple[FloatArray, FloatArray] | None = None,
        limits: FloatArray | None = None,
    ) -> None:
        """Add the works and peaks of a step of ``h`` seconds that was done in Python.

        Parameters
        ----------
        amplitudes : tuple of ndarray, shape (loads,)
            Load amplitudes at both ends, N.
        old, new : State
            At both ends; ``sigma`` by slip row of the system.
        trapezoidal : bool
            Whether the scheme itself dissipates nothing.
        forces : tuple of ndarray, shape (rows,), optional
            Friction whose mean does the work of the step, N, where limits change.
        limits : ndarray, shape (m,), optional
            Friction limits at the end, N, where they change.
        """
        system = self.system
        change, v_change = new.u - old.u, new.v - old.v
        v_mean, a_mean = 0.5 * (old.v + new.v), 0.5 * (old.d + new.d)
        image, slack = np.empty((2, system.n))
        energy.add_dissipation(
            system.M, system.C, h, trapezoidal, change, v_mean, a_mean, v_change, image, slack,
            self.dissipated,
        )  # fmt: skip
        moved = np.empty(self.input_work.size)
        energy.add_input_work(self.vectors.T, *amplitudes, change, moved, self.input_work)
        if self._rubs:
            rows, points = self.order
            slip_change = system.contact.B @ change
            work = self.friction_work[points]
            size, before, after = self._limits, old.sigma, new.sigma
            soft = system.contact.spring_stretch
            if forces is not None:  # in place of shares of a constant limit
                before, after = forces
                size, soft = np.ones_like(size), system.contact.spring_flexibility
            if system.contact.has_springs:  # the slider slips by what its spring leaves
                slip_change -= soft * (after - before)
            slip_change = slip_change[rows]
            energy.add_friction_work(size, before[rows], after[rows], slip_change, work)
            self.friction_work[points] = work
        self.observe(new, limits)

    def saved(self) -> dict[str, NDArray[Any]]:
        """All that is filled in so far, for a checkpoint."""
        return self._filled() | {"boundaries": np.array(self.boundaries)} | self.mark()

    def mark(self) -> dict[str, NDArray[Any]]:
        """Copies of what later steps change: not of stored rows and finished cycles."""
        arrays = {name: np.array(getattr(self, name)) for name in (*_SUMS, *_NUMBERS)}
        return arrays | {"cycles": np.array(len(self.boundaries))}

    def check(self, saved: Mapping[str, NDArray[Any]], done: int, cycles: int) -> None:
        """See that arrays are those that :meth:`saved` gives after steps and complete cycles.

        Raises
        ------
        ValueError
            Naming what is not so.
        """
        strides = 6 * [self.save.strides[1]] + 5 * [self.save.strides[0]]
        stored = self.stored._asdict().items()
        planned = {
            name: rows[: done // every + 1]
            for (name, rows), every in zip(stored, strides, strict=True)
        }
        planned |= {"boundaries": np.tile(self.boundaries[0], (cycles + 1, 1))} | self.mark()
        check_like(saved, planned, "recorder")
        counts = {"rows": len(planned["point_u"]), "field_rows": len(planned["u"])}
        for name, count in (counts | {"cycles": cycles + 1}).items():
            if saved[name] != count:
                raise ValueError(f"recorder/{name} is {saved[name]}, must be {count}")

    def restore(self, saved: Mapping[str, NDArray[Any]]) -> None:
        """Take up what :meth:`saved` or, in the same run, :meth:`mark` returned."""
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
        by_joint, total = self.system.contact.J @ self.friction_work, [self.friction_work.sum()]
        works = self.input_work, self.dissipated, total, self.impact_work, by_joint
        self.boundaries.append(np.concatenate([*works, self.peak, self.strain_peak]))
        np.maximum(self.run_peak, self.peak, out=self.run_peak)
        self.cycle_work[:] = self.friction_work - self.work_before
        self.work_before[:] = self.friction_work
        self.peak[:] = self.strain_peak[:] = 0.0

    def _cycles(self) -> Cycles:
        marks, k = np.array(self.boundaries), self.input_work.size
        works = marks[1:] - marks[:-1]
        first, end = k + 4, k + 4 + len(self.system.contact.joints)
        peaks = marks[1:, end:]
        return Cycles(
            input=works[:, :k],
            viscous=works[:, k],
            scheme=works[:, k + 1],
            friction=works[:, k + 2],
            impact=works[:, k + 3],
            strain=peaks[:, self.peak.size :].ravel(),
            peak=peaks[:, : self.peak.size],
            by_joint=works[:, first:end],
            by_point=self.cycle_work if len(works) else np.zeros(0),
        )

    def finish(
        self,
        start_energy: float,
        u: FloatArray,
        v: FloatArray,
        sigma: FloatArray,
        limits: FloatArray | None = None,
        *,
        steps: int,
        counts: Mapping[str, int],
        **others: Any,
    ) -> Run:
        """Run of the steps so far; ``counts`` are of the stepper, ``others`` further fields.

        ``limits``, (m,), N, are the friction limits now, those at rest if not given.
        """
        every, fields_every = self.save.strides
        times = self.h * every * np.arange(self.rows, dtype=np.float64)
        w, filled = self.system.contact.w, self._filled()
        if not self.system.contact.opens:
            filled["limits"] = np.broadcast_to(w, (self.field_rows, w.size))
        return Run(
            system=self.system,
            times=times,
            amplitudes=self.system.load_amplitudes(times).T,
            field_times=self.h * fields_every * np.arange(self.field_rows, dtype=np.float64),
            **filled,
            input_work=self.input_work,
            viscous_work=float(self.dissipated[0]),
            scheme_work=float(self.dissipated[1]),
            impact_work=float(self.impact_work[0]),
            normal_force_peak=self.normal_force_peak,
            normal_force_least=self.normal_force_least,
            friction_work=self.friction_work,
            stored_energy=(start_energy, self.system.stored_energy(u, v, sigma, limits)),
            cycles=self._cycles(),
            peak=np.maximum(self.run_peak, self.peak),
            slip_peak=self.slip_peak,
            slider_peak=self._slid,
            final=Final(u.copy(), v.copy()),
            final_sigma=sigma.copy(),
            final_limits=np.array(w if limits is None else limits),
            counters=Counters(steps=steps, halved_steps=self.halved_steps, **counts),
            **others,
        )
