"""Runs until "steady": a driver goes through periods, or halves of them, as a search asks for it.

`steady_run` is the run of the period at which vibration has become steady. `Shooting` is the map
that :func:`skfem_joint.steady.steady.periodic_state` finds the fixed point of.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from functools import cached_property, partial
from typing import NamedTuple

import numpy as np
from scipy.linalg import lstsq, lu_factor, lu_solve

from skfem_joint.ground.arrays import FloatArray
from skfem_joint.ground.errors import GrossSlipError, InputError
from skfem_joint.ground.loads import common_period
from skfem_joint.runs.resolution import check_resolution
from skfem_joint.runs.run_notes import checked
from skfem_joint.steady.advanced import Springs, advanced, state_of
from skfem_joint.steady.correction import Correction
from skfem_joint.steady.marching import MAY_DEPEND, Marching, opening_norm
from skfem_joint.steady.steady import (
    EnergyNorm,
    Passage,
    Place,
    Search,
    note_of,
    periodic_state,
    turns_over,
)
from skfem_joint.steady.transition import Transition, moving_unknowns, transition
from skfem_joint.stepping.driver import CHUNK_S, Driver
from skfem_joint.stepping.plan import Plan
from skfem_joint.stepping.recording import Ending, Recorder, Run, Save, Steady
from skfem_joint.stepping.schemes import State
from skfem_joint.stepping.stepper import ConstantForces
from skfem_joint.system.system import System

#: Most unknowns, of those that move, for which the derivative is a dense matrix: of a chain, and of
#: other systems, whose matrices take as long for fewer.
MOST_OF_CHAIN, MOST = 1200, 300
#: What is said while a joint slips as a whole.
GROSS = "a joint slips as a whole"
#: Factor of `Plan.gross_periods` where the search has Newton's method, or contact opens.
PATIENT = 5


class Start(NamedTuple):
    """What a passage starts from.

    Attributes
    ----------
    state : State
    beside : ndarray
        Numbers beside it, see `ConstantForces.beside`.
    """

    state: State
    beside: FloatArray

    def copied(self) -> Start:
        """Start that later steps, which may work in place, do not change."""
        return Start(State(*(np.array(part) for part in self.state)), self.beside.copy())


class _Derivative:
    """Derivative of the map of a period, see `steady.Derivative`.

    Unknowns that stick all the time keep their state: over half a period with a change of sign they
    take the mean of both ends of the passage, or less where steps are held back. (With the mean
    there too, held steps never came near the state that they start from: a condensed solid stayed
    at a change of 1e-2 for ever.)
    """

    def __init__(self, transition: Transition, sign: float) -> None:
        self.transition, self.sign = transition, sign
        self.held = np.nan
        self.solve: Callable[[FloatArray], FloatArray]

    def step(self, change: FloatArray, held: float) -> FloatArray:
        """Step (2 n,) for a change by the map."""
        if held != self.held:
            matrix = -self.sign * self.transition.matrix
            matrix[np.diag_indices_from(matrix)] += 1.0 + held
            if self.sign < 0.0 or held > 0.0:
                factor = lu_factor(matrix, overwrite_a=True, check_finite=False)
                self.solve = partial(lu_solve, factor, check_finite=False)
            else:
                self.solve = partial(_least, matrix)
            self.held = held
        part = self.solve(self.transition.restricted(change))
        return self.transition.extended(change / (2.0 + held), part)


class Shooting:
    """The map of a period, or of half of one with a change of sign, see `steady.PeriodMap`.

    With the trapezoidal rule its states are advanced ones, else all that a step starts from.

    Attributes
    ----------
    changes : list of float
        Change over each passage so far, relative.
    gross : int
        Passages in turn, up to the last one, in which a joint slipped as a whole.
    begun : ndarray
        Row of numbers that the last passage started from.
    """

    def __init__(
        self, driver: Driver, show: Callable[[], None], correction: Correction | None = None
    ) -> None:
        self.driver, self.show, self.correction = driver, show, correction
        loads, plan = driver.system.load_amplitudes, driver.plan
        turns = turns_over(loads(driver.h * np.arange(driver.n_steps + 1.0)))
        self.parts, self.sign = (2, -1.0) if turns else (1, 1.0)
        self.trapezoidal = plan.scheme.coefficients(driver.h).trapezoidal
        self.springs = Springs.of(driver.system, driver.h)
        self.opens, self.contact = driver.system.contact.opens, driver.system.contact.normal
        if self.opens:  # on one side alone
            self.parts, self.sign = 1, 1.0
            # In few unknowns contact is elastic, else with a state of its own.
            few = isinstance(self.contact.N, np.ndarray)
            self.trapezoidal = self.trapezoidal and few
        equal = not driver.loads.jumps and not any(driver.loads.cuts.values())
        chain = driver.to.kind == "chain" and not self.springs.rows.size
        self.most = MOST_OF_CHAIN if chain else MOST
        few = self.springs.rows.size <= MOST
        small = (few and driver.system.n <= self.most) or (
            few and driver.to.kind == "contact" and driver.system.n <= MOST_OF_CHAIN
        )
        self.patience: int | None = None
        if self.trapezoidal and equal and small:
            # Steps of a chain are so cheap that a derivative costs as much as many of them: it is
            # mixed first.
            self.patience = 40 if driver.to.kind == "chain" else 0
        self.passed = self.gross = 0
        self.begun = np.zeros(0)

    def coordinates(self, state: State) -> FloatArray:
        """State as a row of numbers."""
        if not self.trapezoidal:
            return np.concatenate([*state, self.driver.stepper.forces.beside])
        friction = self._limits * self.driver.stepper.by_row(state.sigma)
        springs = self.springs.advanced(state.v, friction)
        return np.concatenate([advanced(state, self.driver.h), springs])

    @property
    def _limits(self) -> FloatArray:
        """Friction limits of all slip rows now, N, over which the state has its friction."""
        contact, now = self.driver.system.contact, self.driver.stepper.forces.limits
        return np.asarray(contact.on_rows(contact.w if now is None else now))

    @cached_property
    def norm(self) -> EnergyNorm:
        """Of the states: of the energy, with that of springs under advanced forces."""
        system = self.driver.system
        if self.opens:
            return opening_norm(system)
        springs = 1.0 / self.springs.stiffness if self.trapezoidal else np.zeros(0)
        return EnergyNorm(system.K, system.M, springs)

    def energy(self) -> float:
        """Of the state now, J: of the norm where contact opens, which has more than springs."""
        state = self.driver.stepper.state()
        if self.opens:
            return 0.5 * self.norm.squared(np.concatenate([state.u, state.v]))
        return self.driver.system.stored_energy(state.u, state.v, state.sigma)

    def start(self, x: FloatArray) -> Start:
        """What a passage starts from, of a row of numbers."""
        if self.trapezoidal:  # of elastic contact forces follow from the displacement
            state, forces = self.state(x), self.driver.stepper.forces
            if isinstance(forces, ConstantForces) or not self.springs.rows.size:
                return Start(state, forces.beside)
            # Steps start from forces of springs themselves where their limits change, and may be 0.
            friction, advance = forces.friction.mean.copy(), x[2 * self.driver.system.n :]
            friction[self.springs.rows] = self.springs.friction(advance, state.v)
            return Start(state, forces.beside_under(friction))
        sizes = [part.size for part in self.driver.stepper.now]
        return Start(self.state(x), np.array(x[sum(sizes) :]))

    def state(self, x: FloatArray) -> State:
        """State of a row of numbers."""
        stepper = self.driver.stepper
        now = stepper.now
        if self.trapezoidal:
            two_n = 2 * self.driver.system.n
            state = state_of(x[:two_n], now.sigma, self.driver.h)
            if not self.springs.rows.size:
                return state
            sigma, rows = stepper.by_row(now.sigma).copy(), self.springs.rows
            force, limits = self.springs.friction(x[two_n:], state.v), self._limits[rows]
            sigma[rows] = np.divide(force, limits, out=0.0 * force, where=limits > 0.0)
            return state._replace(sigma=stepper.placed(sigma))
        ends = np.cumsum([part.size for part in now])
        return State(*map(np.array, np.split(x, ends)[: len(now)]))

    def __call__(self, x: FloatArray) -> Passage:
        """Go through it from a state."""
        newton = self.patience is not None and self.passed >= self.patience
        save = Save(points=False, fields=newton)
        energy = self.through(self.start(x), save, self.parts)
        self.passed += 1
        self.begun = x.copy()
        recorder = self.driver.recorder
        work = float(np.abs(recorder.input_work).sum())
        self._look_for_gross_slip()
        end = self.sign * self.coordinates(self.driver.stepper.now)
        return Passage(end, energy, work, float(recorder.friction_work.sum()))

    def _look_for_gross_slip(self) -> None:
        """Count the passages in turn in which a joint slips as a whole.

        GrossSlipError where there have been as many as the plan allows.
        """
        plan, recorder = self.driver.plan, self.driver.recorder
        system = self.driver.system
        slip = self.parts * system.contact.slid(recorder.friction_work)
        self.gross = self.gross + 1 if system.slips_as_a_whole(slip, plan.duration) else 0
        most = plan.gross_periods
        if most is None:
            return
        patient = 1 if self.patience is None and not self.opens else PATIENT
        if self.gross >= self.parts * most * patient:
            raise GrossSlipError(
                f"{GROSS} for {most * patient} periods in turn, and the vibration is not steady "
                "yet; lower the level, or follow a single frequency: integrate with "
                "until = 'steady' goes on searching, with cycles it gives the transient",
                most * patient,
            )

    def through(self, start: Start, save: Save, parts: int, by_cycle: bool = False) -> float:
        """Go through a period, or one of two ``parts`` of it, from ``start``.

        ``by_cycle`` is whether it is recorded as a cycle. Returns the largest energy at its
        quarters, J.
        """
        driver, energy = self.driver, 0.0
        steps = driver.n_steps // parts
        driver.done = 0
        driver.stepper.go_on(*start)
        driver.begin(Recorder(driver.system, save, driver.n_steps, driver.h, by_cycle=by_cycle))
        for end in sorted({max(1, k * steps // 4) for k in (1, 2, 3, 4)}):
            while driver.done < end:
                driver.advance(end, CHUNK_S)
                self.show()
            energy = max(energy, self.energy())
        return energy

    @property
    def end(self) -> Start:
        """State at the end of the last passage, its sign changed if the map does that."""
        stepper = self.driver.stepper
        return Start(State(*(self.sign * part for part in stepper.now)), stepper.forces.beside)

    def derivative(self) -> _Derivative | None:
        """Derivative where it went through last; None if a step was halved, or too much moves."""
        driver, recorder = self.driver, self.driver.recorder
        if recorder.halved_steps or not recorder.field_rows:
            return None
        v, omega = recorder.stored.v[1 : recorder.field_rows], 2.0 * np.pi / driver.plan.duration
        if moving_unknowns(driver.system, v).size > self.most:
            return None
        stored, starts = recorder.stored, slice(0, recorder.field_rows - 1)
        u = stored.u[1 : recorder.field_rows] if self.opens else None
        limits = recorder.limits[starts] if self.opens else driver.system.contact.w
        friction = np.repeat(limits, driver.system.contact.directions, axis=-1)
        friction = friction * stored.sigma[starts]
        e = self.springs.advanced(stored.v[starts], friction)
        # The first ones are given: limits may be zero there, and the forces no shares of them.
        e[0] = self.begun[2 * driver.system.n :]
        J = transition(driver.system, driver.to.kind, driver.h, v, omega, u, e)
        return _Derivative(J, self.sign)

    def corrected(self, change: FloatArray) -> FloatArray | None:
        """Change as a smaller model corrects it, over half a period; None without one."""
        if self.correction is None or self.parts == 1 or not self.trapezoidal:
            return None
        return change + self.correction.added(change, self.driver.to)


def _least(matrix: FloatArray, change: FloatArray) -> FloatArray:
    """Least solution of equations whose matrix may be singular."""
    return np.asarray(lstsq(matrix, change, cond=1e-11, lapack_driver="gelsy")[0])


def steady_run(
    given: System,
    plan: Plan,
    start: tuple[FloatArray, ...],
    tolerance: float,
    progress: Callable[..., None] | None = None,
    correction: Correction | None = None,
    ending: Ending | None = None,
) -> Run:
    """Run of the period at which vibration has become steady.

    Parameters
    ----------
    given : System
    plan : Plan
        Of a period, until "steady".
    start, tolerance, ending
        As for `skfem_joint.stepping.driver.Driver`; any state will do to start from.
    progress : callable, optional
        Called with (periods done, 0, a note).
    correction : Correction, optional
        A smaller model's.

    Raises
    ------
    ConvergenceError
        If a step does not converge, no steady vibration is found, or steps add most of its energy.
    InputError
        If nothing can become steady, or steps are too long for a load.
    """
    check_steady(given, plan)
    check_resolution(given, plan)
    driver, begin = Driver(given, plan, start, tolerance, ending), time.perf_counter()
    system, stepper, changes = driver.system, driver.stepper, list[float]()

    def show() -> None:
        if progress is not None:
            gone = len(changes) / shooting.parts + driver.done / driver.n_steps
            whole = f"; {GROSS}" if shooting.gross else ""
            progress(int(gone), 0, note_of(gone, changes) + whole)

    shooting, first = Shooting(driver, show, correction), stepper.now.u.copy()
    place, begun = Place.of(system), shooting.coordinates(stepper.now)
    arguments = begun, shooting, place, changes
    opens = system.contact.opens
    moved = _found(Marching(*arguments).run() if opens else periodic_state(*arguments), shooting)
    end, periods = shooting.end, -(-len(changes) // shooting.parts)
    if shooting.parts == 2:  # half a period, its sign changed: back where it began from there
        shift, moved = -0.5 * moved, np.zeros_like(moved)
    else:
        shift = place.part(first - end.state.u)
    again = end._replace(state=end.state._replace(u=end.state.u + shift))
    # One more passage suffices where it stores every row.
    save = replace(plan.save, points=True) if plan.save.every == 1 else Save()
    by_cycle = plan.cycle_steps is not None
    shooting.through(again.copied(), save, 1, by_cycle)
    drift = system.P @ moved
    ahead = np.linspace(0.0, 1.0, driver.n_steps + 1)[:, np.newaxis] * drift
    vibration = driver.recorder.stored.point_u - ahead
    high, low = vibration.max(axis=0), vibration.min(axis=0)
    if plan.save != save:
        shooting.through(again.copied(), plan.save, 1, by_cycle)
        periods += 1
    if by_cycle:
        driver.recorder.end_cycle()
    driver.elapsed = time.perf_counter() - begin
    state = again.state
    limits = (
        again.beside[-system.contact.w.size :] if shooting.opens and system.contact.w.size else None
    )
    sigma = stepper.by_row(state.sigma)
    run = driver.finish(system.stored_energy(*state[:2], sigma, limits))
    counters = replace(run.counters, steps=(periods + 1) * driver.n_steps)
    vibrates = Steady(
        periods=periods,
        change=changes[-1],
        amplitude=0.5 * (high - low),
        offset=0.5 * (high + low),
        drift=drift,
        unstrained=place.motions.shape[1],
        notes=() if not system.contact.opens else (MAY_DEPEND,),
    )
    return checked(replace(run, steady=vibrates, counters=counters))


def _found(search: Search, shooting: Shooting) -> FloatArray:
    """Result of a search, for which a period is gone through from each state that it asks for."""
    x = next(search)
    while True:
        passage = shooting(x)
        try:
            x = search.send(passage)
        except StopIteration as end:
            return np.asarray(end.value)


def check_steady(system: System, plan: Plan) -> None:
    """Refuse what has no steady vibration, or none that is a period long; InputError."""
    period = common_period(load.amplitude for load in system.loads)
    if period is None or abs(plan.duration / period - 1.0) > 1e-9:
        raise InputError(
            "until: 'steady' needs loads that repeat, and a run of one of their common periods: "
            "give steps_per_cycle"
        )
    _check_repeats(system, plan)
    damped = abs(system.C).max() > 0.0 or not plan.scheme.coefficients(1.0)[-1]
    if not (damped or system.contact.count):
        raise InputError(
            "until: nothing is 'steady' with neither friction nor damping; give damping, such as "
            "[damping] ratio = 0.002 in a scene"
        )


def _check_repeats(system: System, plan: Plan) -> None:
    """Refuse loads that differ from what they are a period (the plan's duration) later.

    They are compared within each step, and at and between the times where they kink or jump. A
    pulse without kinks that acts only later is known by its peak.
    """
    within = plan.step * (np.arange(plan.n_steps) + 0.5)
    for load in system.loads:
        corners = np.array(load.amplitude.corners)
        times = np.concatenate([within, corners, 0.5 * (corners[1:] + corners[:-1])])
        first, later = load.amplitude(times), load.amplitude(times + plan.duration)
        largest, peak = np.abs(first).max(), load.amplitude.peak_value or 0.0
        acts_later = not load.amplitude.harmonics and largest < 0.5 * peak
        if acts_later or np.abs(later - first).max() > 1e-6 * largest:
            raise InputError(
                f"until: 'steady' needs loads that repeat: that on {load.on!r} does not after "
                f"{plan.duration:.6g} s, the common period of the harmonic ones; leave it out, or "
                "give cycles in place of until = 'steady'"
            )
