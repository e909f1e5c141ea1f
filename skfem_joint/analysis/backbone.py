"""Frequency and damping of a mode against its amplitude, by quasi-static modal analysis.

A structure is loaded slowly by the inertia of a mode with the contact stuck, M phi alpha, where
phi^T M phi = 1 (H. Festjens, G. Chevallier and J.-L. Dion, J. Sound Vib. 332, 2013; R. M. Lacayo
and M. S. Allen, Mech. Syst. Signal Process. 118, 2019). With the modal amplitude q = phi^T M u of
what that moves

    omega = sqrt(alpha / q),        zeta = D / (2 pi alpha q) + phi^T C phi / (2 omega),

where D is the work of friction in a cycle, with exact Coulomb friction. Where slip keeps its
direction Masing's rule holds, unloading is the loading path doubled, and D = 4 sum w |slip|: no
quadrature over levels. Three levels are gone round to check that, and what they differ by is put
right between them. Where slip turns far, each level is gone round.

A law of finite steepness lets joints creep that Coulomb's law holds, and damps small vibration much
more. At three levels a cycle is gone through again with the system's own law, in the time that it
takes at the curve's frequency; in small steps, which is some percent below the exact work. That
tells the damping by the own law beside Coulomb's, and a sentence says where they differ.

It takes the mode's shape not to change and other modes not to answer: where a higher frequency lies
near an odd multiple of the mode's, friction excites it and the true damping is larger. A ring-down,
the free vibration of the mode, has all that: it is measured to compare with the curve.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from scipy import sparse
from scipy.signal import butter, find_peaks, sosfiltfilt

from skfem_joint.analysis.rows import Rows
from skfem_joint.arrays import FloatArray, IntArray, as_dense
from skfem_joint.errors import ConvergenceError, InputError
from skfem_joint.minimise.law import force as friction_force
from skfem_joint.modes import eigenmodes
from skfem_joint.progress import Progress, Tally, silent
from skfem_joint.reduction.active_length import THRESHOLD
from skfem_joint.reduction.interface_modes import motions_without_slip
from skfem_joint.stepping.arrangement import Arranged, arranged
from skfem_joint.stepping.integrate import integrate
from skfem_joint.stepping.quasi_static import SETTINGS as QUASI_STATIC
from skfem_joint.stepping.quasi_static import QuasiStatic
from skfem_joint.stepping.recording import Save
from skfem_joint.stepping.schemes import Scheme
from skfem_joint.system import System
from skfem_joint.unknowns import congruent
from skfem_joint.values import COUNT, POSITIVE, at_least, check, check_each

#: Level of the lowest point of a curve over that of the highest one.
LOWEST = 0.05
#: Increments of each half of a loop, and levels that are gone round to check.
INCREMENTS, CHECKED = 4, 3
#: Increments of each half of a cycle under the system's own law, and what its damping exceeds
#: Coulomb's by, as a share of it, from which on that is told.
OWN_INCREMENTS, DIFFERS = 16, 0.1
#: Cycles at the end of a ring-down that are left out.
ENDS = 2
#: Slip that is added up along a path over that at its end, from which on its direction turns far.
TURNED = 1.05
#: Largest force residual of a level, relative; slip below this share of the largest is none.
TOLERANCE, NONE = 1e-6, 1e-9
#: Distance of a frequency from an odd multiple, relative, that is near; and multiples looked at.
NEAR, MULTIPLES = 0.07, (3, 5, 7)
#: Fewest points that must slip for friction to be resolved.
FEWEST = 5
#: A joint slips as a whole where so much of its friction limit does. That is tried just above the
#: level at which the forces on the stuck joint add up to its limit, and in so many steps upwards.
WHOLE, WITHIN, RAISED, TRIALS = 0.99, 0.01, 1.3, 20


@dataclass(frozen=True)
class Backbone:
    """Frequency and damping of one mode; the arrays have an entry for each level, rising."""

    mode: int  #: number, from 1
    shape: FloatArray  #: (n,) mode with the contact stuck, of unit mass
    stuck_frequency: float  #: Hz
    slips_at: float  #: level alpha at which the first joint slips as a whole, m/s²
    level: FloatArray  #: alpha, acceleration of the mode that loads the structure, m/s² kg^1/2
    amplitude: FloatArray  #: q, modal, m kg^1/2
    frequency: FloatArray  #: Hz
    friction_damping: FloatArray  #: damping ratio by friction, Coulomb's
    #: The same by the system's own law, which differs where its steepness is finite; nan: unknown.
    own_law_damping: FloatArray
    viscous_damping: FloatArray  #: damping ratio by C
    displacement: FloatArray  #: (levels, points) of the named points, m
    states: FloatArray  #: (levels, n), m
    loops: FloatArray  #: (increments, n) of the loops gone round, m
    slip: FloatArray  #: (levels, m) of each contact point, m
    share: FloatArray  #: of the friction limits that slips
    state: tuple[str, ...]  #: "stick", "partial", or "gross": a joint slips as a whole
    masing_error: float | None  #: of D by Masing's rule, put right; None: each level is gone round
    warnings: tuple[str, ...]

    @property
    def damping_ratio(self) -> FloatArray:
        """Damping ratio of friction, Coulomb's, and viscous forces."""
        return self.friction_damping + self.viscous_damping


def stuck_modes(system: System, count: int) -> tuple[FloatArray, FloatArray]:
    """Lowest frequencies (Hz) and modes (n, k), of unit mass, with all contact points held.

    InputError if everything is in contact, so that nothing is left to vibrate.
    """
    F = motions_without_slip(system, carrying=True)
    if F.shape[1] == 0:
        raise InputError(
            "backbone: every unknown is in contact, so that no mode is left when it sticks; "
            "leave a part of the structure out of the joints, keep interface_modes in a reduced "
            "model, or look at response"
        )
    K, M = (sparse.csr_array(congruent(A, F)) for A in (system.K, system.M))
    frequency, shapes = eigenmodes(K, M, min(count, F.shape[1]))
    return frequency, F @ shapes


def backbone(
    system: System,
    modes: Sequence[int] = (1,),
    levels: int = 20,
    up_to: float = 0.7,
    slips_at: float | None = None,
    progress: Progress = silent,
    rows: Rows | None = None,
) -> list[Backbone]:
    """Frequency and damping against amplitude of some modes.

    Parameters
    ----------
    system : System
        Full or condensed; its friction acts as Coulomb's, its loads do not. What a law of finite
        steepness damps instead stands in ``own_law_damping``.
    modes : sequence of int
        Numbers of the modes with the contact stuck, from 1; a reduced model has as many as its
        basis has fixed-interface modes.
    levels : int
        Levels of each mode, evenly spaced on a logarithmic axis over a factor of twenty.
    up_to : float
        The highest, as a share of the level at which the first joint slips as a whole.
    slips_at : float, optional
        That level, m/s² kg^1/2, as in the `Backbone` of the full model; found if not given.
    progress : callable, optional
        Called with (levels done, levels in all as far as they are known), loops' included.
    rows : Rows, optional
        Where levels are kept as they are found, and taken up again.

    Raises
    ------
    InputError
        If there is no friction, no such mode, it is a motion as a rigid body, a joint slips as a
        whole at the first level, friction alone holds the structure and cannot at the last, or the
        system is a reduced model made for its own loads.
    ConvergenceError
        If a level is not found.
    """
    system.check_any_load("backbone")
    check_each("backbone: modes", modes, COUNT)
    check("backbone: levels", levels, COUNT)
    check("backbone: up_to", up_to, POSITIVE)
    if slips_at is not None:
        check("backbone: slips_at", slips_at, POSITIVE)
    to = arranged(system)
    numbers = np.asarray(modes, dtype=int)
    known = len(modes) * (levels + INCREMENTS * min(CHECKED, levels))
    path = _Path(to.system, Tally(progress, known), rows or Rows())
    frequency, shapes = stuck_modes(to.system, int(numbers.max()) + 10)
    if numbers.max() > frequency.size:
        raise InputError(
            f"backbone: found mode {numbers.max()}, there are {frequency.size} with the contact "
            "stuck"
        )
    shares = np.geomspace(LOWEST, 1.0, levels) * up_to if levels > 1 else np.array([up_to])
    return [
        _curve(to, path, k, frequency, shapes[:, k - 1], shares, slips_at) for k in numbers.tolist()
    ]


class _Path(QuasiStatic):
    """Quasi-static response whose levels are rows: each depends on its start alone, to the bit."""

    def __init__(self, system: System, tally: Tally, rows: Rows) -> None:
        super().__init__(system, TOLERANCE, tally)
        self.rows, self.of = rows, rows.mark("level", system, TOLERANCE)

    def follow(
        self,
        forces: FloatArray,
        times: FloatArray | None = None,
        held: float = QUASI_STATIC.held,
        start: tuple[FloatArray, FloatArray] | None = None,
    ) -> FloatArray:
        """As `QuasiStatic.follow`; level by level, each a row, where times do not matter."""
        if times is not None:
            self.forget()
            states = super().follow(forces, times, held, start)
            self.forget()
            return states
        levels = []
        u, before = np.zeros((2, forces.shape[1])) if start is None else start
        for force in forces:
            u = self._level(force, held, u, before)
            levels.append(u)
            before = force
        return np.array(levels)

    def _level(
        self, force: FloatArray, held: float, u: FloatArray, before: FloatArray
    ) -> FloatArray:
        """Displacement under a force from ``u`` under the force ``before``."""
        mark, done = self.rows.mark(self.of, force, held, u, before, self.last), self.tally.done

        def computed() -> tuple[FloatArray, FloatArray]:
            self.forget(self.last)
            state = super(_Path, self).follow(force[np.newaxis], held=held, start=(u, before))[0]
            return state, self.last

        state, self.last = self.rows.row(mark, computed)
        if self.tally.done == done:  # it was taken up
            self.tally.add()
        return state

    def limit(self, force: FloatArray) -> float:
        """As `QuasiStatic.limit`; nothing is remembered of it, nor of what was before."""
        self.forget()
        limit = super().limit
        found = self.rows.row(self.rows.mark(self.of, "limit", force), lambda: limit(force))
        self.forget()
        return found


def _curve(
    to: Arranged,
    path: _Path,
    number: int,
    frequencies: FloatArray,
    shape: FloatArray,
    shares: FloatArray,
    slips_at: float | None,
) -> Backbone:
    system, stuck = to.system, float(frequencies[number - 1])
    if (2.0 * np.pi * stuck) ** 2 < 1e-9 * system.mean_square_frequency:
        raise InputError(
            f"backbone: mode {number} moves the structure as a rigid body; support it, or choose "
            "a higher mode"
        )
    force = system.M @ shape
    limit = path.limit(force)
    if slips_at is None:
        static, before = shape / (2.0 * np.pi * stuck) ** 2, path.rows.done
        slips_at = min(limit, first_slip(path, force, static, np.isinf(limit)))
        if np.isinf(slips_at):
            raise InputError("backbone: the mode loads no joint, so that friction does not damp it")
        path.rows.asked += path.rows.done - before  # nobody knew how many it takes
    level = shares * slips_at
    if level[-1] >= limit:
        raise InputError(
            f"backbone: found up_to = {shares[-1]:g}, but friction alone holds the structure, and "
            f"mode {number} makes all of it slip at {limit / slips_at:.3g}; ask for less"
        )
    states = path.follow(np.outer(level, force), held=np.inf)
    rows = (system.B @ states.T).T
    slip = system.slip_norm(rows)
    travelled = np.cumsum(system.slip_norm(np.diff(rows, axis=0, prepend=0.0)), axis=0)
    work = 4.0 * slip @ system.w
    masing = bool(np.all(travelled @ system.w <= TURNED * (slip @ system.w)))
    count = CHECKED if masing else level.size
    around = np.unique(np.linspace(0, level.size - 1, count).round().astype(int))
    around = around[work[around] > 0.0]
    more = INCREMENTS * (around.size - min(CHECKED, level.size))
    path.tally.asked += more
    path.rows.asked += more
    parts = [_loop(path, level[k] * force, states[k]) for k in around]
    loops = np.reshape(parts, (-1, system.n))
    rubbed = system.slip_norm((system.B @ loops.T).T) @ system.w
    ratio = 2.0 * rubbed.reshape(-1, INCREMENTS).sum(axis=1) / work[around]
    if around.size:  # between them
        work *= np.interp(np.log(level), np.log(level[around]), ratio)
    q = states @ force
    omega = np.sqrt(level / q)
    slipping = slip > _none(path) * slip.max()
    joints = system.joint_points
    stuck_share = [[_sticking(path, one, points) for points in joints] for one in slip]
    gross = np.min(stuck_share, axis=1) <= 1.0 - WHOLE
    if gross[0]:
        raise InputError(
            f"backbone: mode {number}: a joint slips as a whole at the first level already, "
            f"{shares[0]:.3g} of that at which the first one does; set up_to below 1"
        )
    friction_damping = work / (2.0 * np.pi * level * q)
    own_law_damping, told = _by_own_law(path, number, level, force, states, friction_damping)
    state = np.where(gross, "gross", np.where(slipping.any(axis=1), "partial", "stick"))
    return Backbone(
        mode=number,
        shape=to.outer(shape),
        stuck_frequency=stuck,
        slips_at=slips_at,
        level=level,
        amplitude=q,
        frequency=omega / (2.0 * np.pi),
        friction_damping=friction_damping,
        own_law_damping=own_law_damping,
        viscous_damping=float(shape @ (system.C @ shape)) / (2.0 * omega),
        displacement=np.abs((system.P @ states.T).T),
        states=to.outer(states),
        loops=to.outer(loops),
        slip=slip,
        share=slipping @ system.w / system.w.sum(),
        state=tuple(state.tolist()),
        masing_error=float(np.abs(ratio - 1.0).max(initial=0.0)) if masing else None,
        warnings=(*_doubts(number, frequencies, omega / (2.0 * np.pi), slipping), *told),
    )


def _loop(path: QuasiStatic, force: FloatArray, state: FloatArray) -> FloatArray:
    """Increments (INCREMENTS, n), m, from a state to its mirror image: half of a cycle."""
    turn = np.linspace(1.0, -1.0, INCREMENTS + 1)[1:]
    states = path.follow(np.outer(turn, force), held=np.inf, start=(state, force))
    return np.diff(np.vstack([state, states]), axis=0)


def _own_law(
    path: _Path, level: FloatArray, force: FloatArray, states: FloatArray, omega: FloatArray
) -> tuple[IntArray, FloatArray] | None:
    """Some of the levels, and the damping ratio of friction there by the system's own law.

    None where that is Coulomb's. From the state at the level's peak a cycle is gone through, of
    which the second half counts, as the first one forgets where it began.
    """
    system, n = path.to.system, OWN_INCREMENTS
    beta = system.beta[:, np.newaxis]
    if np.isinf(beta[system.w > 0.0]).all():
        return None
    at = np.unique(np.linspace(0, level.size - 1, CHECKED).round().astype(int))
    path.tally.asked += 2 * n * at.size
    path.rows.asked += at.size
    turn = np.pi * np.arange(1, 2 * n + 1) / n

    def damping(k: int) -> float:
        """Damping ratio at one level."""
        top, start = level[k] * force, (states[k], level[k] * force)
        course = path.follow(np.outer(np.cos(turn), top), turn / omega[k], np.inf, start)
        half = course[n - 1 :]
        slip = system.slip_norm((system.B @ np.diff(half, axis=0).T).T).T
        limits = friction_force(slip * (n * omega[k] / np.pi), beta) * system.w[:, np.newaxis]
        q = 0.5 * float(np.ptp(half @ force))
        return float(2.0 * np.vdot(limits, slip) / (2.0 * np.pi * level[k] * q))

    marks = [path.rows.mark(path.of, "own law", level[k], force, states[k], omega[k]) for k in at]
    return at, np.array(
        [path.rows.row(mark, partial(damping, k)) for mark, k in zip(marks, at, strict=True)]
    )


def _by_own_law(
    path: _Path,
    number: int,
    level: FloatArray,
    force: FloatArray,
    states: FloatArray,
    coulomb: FloatArray,
) -> tuple[FloatArray, list[str]]:
    """Damping ratio of friction by the system's own law at all levels, and what to say of it.

    Between the levels that are gone round the difference from Coulomb's is interpolated, which
    changes slowly: with beta = 100 s/m from 0.76 to 0.45 % over a curve from 0.17 to 3 %.
    """
    q = states @ force
    try:
        found = _own_law(path, level, force, states, np.sqrt(level / q))
    except ConvergenceError as error:
        said = f"Mode {number}: how much the joints' own law damps is not known: {error}."
        return np.full_like(coulomb, np.nan), [said]
    if found is None:
        return coulomb, []
    at, own = found
    more = np.interp(np.log(level), np.log(level[at]), own - coulomb[at])
    return coulomb + more, _law_differs(number, path.to.system, q[at], coulomb[at], own)


def _law_differs(
    number: int, system: System, q: FloatArray, coulomb: FloatArray, own: FloatArray
) -> list[str]:
    """Sentence about the damping by the system's own law where it is not Coulomb's."""
    # Less than the curve's is no matter of the law: loops of slips that turn are rough with few
    # increments (7 to 10 % too much for a bolted plate at the highest level).
    if np.all(own - coulomb <= DIFFERS * own):
        return []
    beta = system.beta[(system.w > 0.0) & np.isfinite(system.beta)]
    shown = [
        f"{100 * b:.3g} % where the curve says {100 * a:.3g} % (modal amplitude {x:.3g})"
        for x, a, b in zip(q, coulomb, own, strict=True)
    ]
    return [
        f"Mode {number}: the curve is of Coulomb's law. The joints' own, with beta = "
        f"{beta.min():.3g} s/m, lets them creep, and friction damps by {', '.join(shown)}; see "
        "own_law_damping. A ring-down and steady response have the joints' own law; a steeper beta "
        "or law = 'coulomb' brings them to the curve."
    ]


def first_slip(path: QuasiStatic, force: FloatArray, static: FloatArray, raised: bool) -> float:
    """Multiple of ``force`` at which the first joint slips as a whole; ``inf``: none is loaded.

    ``static`` is what it does with all joints stuck, in the unknowns of the path's system. Where
    joints alone carry the load it is that at which the forces on a joint that sticks add up to its
    limit; else the load is ``raised`` until one slips. A dense system, whose basis may not slip so
    far, takes the first of these with the smallest forces that hold it.
    """
    system, dense = path.to.system, path.to.kind == "dense"
    held = force - system.K @ static
    rows = np.linalg.lstsq(as_dense(system.B).T, held)[0] if dense else system.B @ held
    forces = system.slip_norm(np.asarray(rows, dtype=float))
    loaded = [points for points in system.joint_points if forces[points].sum() > 0.0]
    if not loaded:
        return np.inf
    nominal = min(float(system.w[p].sum() / forces[p].sum()) for p in loaded)
    if not raised:
        return nominal

    level, sticks = nominal * (1.0 + WITHIN), 1.0
    u = before = 0.0 * force
    for _ in range(TRIALS):
        path.tally.asked += 1
        u = path.follow(level * force[np.newaxis], held=np.inf, start=(u, before))[0]
        slip = system.slip_norm(system.B @ u)
        last, sticks = sticks, min(_sticking(path, slip, points) for points in loaded)
        if sticks <= 1.0 - WHOLE:
            over = (1.0 - WHOLE - sticks) / (last - sticks)
            return float(level * RAISED**-over) if last < 1.0 else nominal
        before = level * force
        level *= RAISED
    return nominal


def _none(path: QuasiStatic) -> float:
    """Share of the largest slip that is none: points of dense systems cannot all stick."""
    return THRESHOLD if path.to.kind == "dense" else NONE


def _sticking(path: QuasiStatic, slip: FloatArray, points: IntArray) -> float:
    """Share of a joint's friction limit that does not slip."""
    limits = path.to.system.w[points]
    return float(limits[slip[points] <= _none(path) * slip.max()].sum() / limits.sum())


def _doubts(
    number: int, frequencies: FloatArray, frequency: FloatArray, slipping: FloatArray
) -> list[str]:
    """Sentences about what the method takes for granted and this mode does not give."""
    found = []
    few = slipping.sum(axis=1)
    few = few[few > 0]
    if few.size and few[0] < FEWEST:
        found.append(
            f"Mode {number}: at the lowest level at which a point slips only {few[0]} do; below "
            f"{FEWEST} the damping is rough. Use smaller elements in the joint to resolve it."
        )
    low, high = frequency.min(), frequencies[number - 1]
    near = [
        f"mode {k} at {other / high:.3g} times"
        for k, other in enumerate(frequencies[number:], number + 1)
        if any(m * low * (1.0 - NEAR) < other < m * high * (1.0 + NEAR) for m in MULTIPLES)
    ]
    if near:
        found.append(
            f"Mode {number}: higher frequencies lie near odd multiples of its own "
            f"({', '.join(near)}), so that friction excites them: the true damping may be up to "
            "twice as large. See its ring-down, or response."
        )
    return found


@dataclass(frozen=True)
class RingDown:
    """Free vibration of a mode: an entry for each cycle, at rising times."""

    time: FloatArray  #: of the peak that a cycle begins with, s
    amplitude: FloatArray  #: modal, mean over the cycle, m kg^1/2
    frequency: FloatArray  #: without damping, Hz
    damping_ratio: FloatArray  #: by the logarithmic decrement
    energy: FloatArray  #: (periods + 1,) of all modes, at whole periods of the stuck one, J
    friction_work: FloatArray  #: (periods + 1, joints) of each joint up to then, J


def ring_down(
    system: System,
    curve: Backbone,
    cycles: int,
    steps_per_cycle: int = 200,
    scheme: Scheme | None = None,
    start: tuple[FloatArray, FloatArray] | None = None,
    progress: Callable[..., None] | None = None,
) -> RingDown:
    """Free vibration of a mode, released at rest from the highest level of its curve or as it is.

    ``start`` is a displacement (m) and a velocity (m/s) to begin with, such as ``run.final`` of a
    run whose pulse has ended; the loads act no more. The system's own law acts. Of modes that ring
    together one is told by its modal displacement, phi^T M u; half of peak to peak has no part of
    what joints come to rest at. What is left above twice the mode's frequency is filtered out,
    forwards and backwards so that peaks stay where they are. ``progress`` is that of `integrate`.

    Raises
    ------
    InputError
        If too few cycles are asked for, or the system is a reduced model made for its own loads.
    ConvergenceError
        If a step does not converge, or no cycle is left to measure.
    """
    system.check_any_load("ring_down")
    check("ring_down: cycles", cycles, at_least(2 * ENDS))
    check("ring_down: steps_per_cycle", steps_per_cycle, at_least(2))
    modal = sparse.csr_array((system.M @ curve.shape)[np.newaxis])
    alone = replace(system, loads=(), P=modal, points=("modal",))
    step = 1.0 / curve.stuck_frequency / steps_per_cycle
    run = integrate(
        alone,
        step=step,
        n_steps=cycles * steps_per_cycle,
        scheme=scheme,
        save=Save(fields=True, fields_every=steps_per_cycle),
        initial=(curve.states[-1], np.zeros(system.n)) if start is None else start,
        progress=progress,
    ).finished()
    low = butter(4, 2.0 * curve.stuck_frequency, fs=1.0 / step, output="sos")
    q = sosfiltfilt(low, run.point("modal"))
    q *= np.sign(q[np.abs(q).argmax()])  # a mode has no sign of its own
    tops, bottoms = (find_peaks(sign * q, distance=steps_per_cycle // 2)[0] for sign in (1.0, -1.0))
    tops = tops[tops >= steps_per_cycle // 2]  # which the filter sees whole, as below
    bottoms = bottoms[np.searchsorted(bottoms, tops[0]) if tops.size else 0 :]
    count = min(tops.size - 1, bottoms.size) - ENDS
    if count < 1:
        raise ConvergenceError("ring_down: no cycle is left to measure; ask for more")
    (top, at), bottom = _extremes(q, tops), _extremes(q, bottoms)[0]
    half = 0.5 * (0.5 * (top[:-1] + top[1:])[: count + 1] - bottom[: count + 1])
    decrement = np.log(half[:-1] / half[1:])
    whole = np.hypot(2.0 * np.pi, decrement)  # angle of a cycle, had it no damping
    return RingDown(
        time=at[:count] * step,
        amplitude=np.sqrt(half[:-1] * half[1:]),
        frequency=whole / (np.pi * (at[2:] - at[:-2])[:count] * step),
        damping_ratio=decrement / whole,
        energy=np.array([system.stored_energy(u, v) for u, v in zip(run.u, run.v, strict=True)]),
        friction_work=run.joint_work[::steps_per_cycle],
    )


def _extremes(q: FloatArray, rows: IntArray) -> tuple[FloatArray, FloatArray]:
    """Values and places (rows) of extremes, by parabolas through three samples."""
    a, b, c = q[rows - 1], q[rows], q[rows + 1]
    shift = 0.5 * (a - c) / (a - 2.0 * b + c)
    return b - 0.25 * (a - c) * shift, rows + shift
