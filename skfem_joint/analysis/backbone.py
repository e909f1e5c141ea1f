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

It takes the mode's shape not to change and other modes not to answer: where a higher frequency lies
near an odd multiple of the mode's, friction excites it and the true damping is larger.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from scipy import sparse
from scipy.signal import butter, find_peaks, sosfiltfilt

from skfem_joint.arrays import FloatArray, IntArray
from skfem_joint.errors import ConvergenceError, InputError
from skfem_joint.modes import natural_modes
from skfem_joint.reduction.zones import measured_lengths, picked
from skfem_joint.stepping.arrangement import Arranged, arranged
from skfem_joint.stepping.integrate import integrate
from skfem_joint.stepping.quasi_static import QuasiStatic
from skfem_joint.stepping.schemes import Scheme, generalized_alpha
from skfem_joint.structure import doubts
from skfem_joint.system import System

if TYPE_CHECKING:
    from skfem_joint.scene import Scene

#: Level of the lowest point of a curve over that of the highest one.
LOWEST = 0.05
#: Increments of each half of a loop, and levels that are gone round to check.
INCREMENTS, CHECKED = 4, 3
#: Slip that is added up along a path over that at its end, from which on its direction turns far.
TURNED = 1.05
#: Largest force residual of a level, relative; slip below this share of the largest is none.
TOLERANCE, NONE = 1e-6, 1e-9
#: Distance of a frequency from an odd multiple, relative, that is near; and multiples looked at.
NEAR, MULTIPLES = 0.07, (3, 5, 7)
#: Fewest points that must slip for friction to be resolved.
FEWEST = 5
#: Cycles at the end of a ring-down that are left out.
ENDS = 2
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
    friction_damping: FloatArray  #: damping ratio by friction
    viscous_damping: FloatArray  #: damping ratio by C
    displacement: FloatArray  #: (levels, points) of the named points, m
    displaced: FloatArray  #: (n,) at the highest level, m
    slip: FloatArray  #: (levels, m) of each contact point, m
    share: FloatArray  #: of the friction limits that slips
    state: tuple[str, ...]  #: "stick", "partial", or "gross": a joint slips as a whole
    masing_error: float | None  #: of D by Masing's rule, put right; None: each level is gone round
    warnings: tuple[str, ...]

    @property
    def damping_ratio(self) -> FloatArray:
        """Damping ratio of friction and viscous forces."""
        return self.friction_damping + self.viscous_damping


def stuck_modes(system: System, count: int) -> tuple[FloatArray, FloatArray]:
    """Lowest frequencies (Hz) and modes (n, k), of unit mass, with all contact points held.

    Raises
    ------
    InputError
        If everything is in contact, so that nothing is left to vibrate.
    """
    rows = np.flatnonzero(system.on_rows(system.w) > 0.0)
    free = np.setdiff1d(np.arange(system.n), picked(system)[rows])
    if free.size == 0:
        raise InputError(
            "backbone: every unknown is in contact, so that no mode is left when it sticks; "
            "leave a part of the structure out of the joints, or look at response"
        )
    K, M = (sparse.csr_array(A)[free][:, free] for A in (system.K, system.M))
    frequency, shapes = natural_modes(K, M, min(count, free.size))
    modes = np.zeros((system.n, frequency.size))
    modes[free] = shapes
    return frequency, modes


def backbone(
    system: System,
    modes: Sequence[int] = (1,),
    levels: int = 20,
    up_to: float = 0.7,
    joints: Mapping[str, IntArray] | None = None,
) -> list[Backbone]:
    """Frequency and damping against amplitude of some modes.

    Parameters
    ----------
    system : System
        Sparse; its friction acts as Coulomb's, its loads do not.
    modes : sequence of int
        Numbers of the modes with the contact stuck, from 1.
    levels : int
        Levels of each mode, evenly spaced on a logarithmic axis over a factor of twenty.
    up_to : float
        The highest, as a share of the level at which the first joint slips as a whole.
    joints : mapping, optional
        Contact points of each joint by its name; all are one joint if not given.

    Raises
    ------
    InputError
        If there is no friction, no such mode, or it is a motion as a rigid body.
    ConvergenceError
        If a level is not found, as where everything slips at the first one.
    """
    if levels < 1 or not 0.0 < up_to < np.inf:
        raise InputError(f"backbone: found {levels} levels up to {up_to}, both must be positive")
    to = arranged(system)
    numbers = np.asarray(modes, dtype=int)
    if numbers.size == 0 or numbers.min() < 1:
        raise InputError(f"backbone: found modes {list(modes)}, must be numbers from 1")
    path = QuasiStatic(to.system, TOLERANCE)
    frequency, shapes = stuck_modes(to.system, int(numbers.max()) + 10)
    if numbers.max() > frequency.size:
        raise InputError(
            f"backbone: found mode {numbers.max()}, there are {frequency.size} with the contact "
            "stuck"
        )
    if joints is None:
        joints = {"joint": np.arange(system.w.size)}
    groups = [points[system.w[points] > 0.0] for points in joints.values()]
    groups = [points for points in groups if points.size]
    shares = np.geomspace(LOWEST, 1.0, levels) * up_to if levels > 1 else np.array([up_to])
    return [
        _curve(to, path, k, frequency, shapes[:, k - 1], shares, groups) for k in numbers.tolist()
    ]


def _curve(
    to: Arranged,
    path: QuasiStatic,
    number: int,
    frequencies: FloatArray,
    shape: FloatArray,
    shares: FloatArray,
    groups: Sequence[IntArray],
) -> Backbone:
    system, stuck = to.system, float(frequencies[number - 1])
    if (2.0 * np.pi * stuck) ** 2 < 1e-9 * system.mean_square_frequency:
        raise InputError(
            f"backbone: mode {number} moves the structure as a rigid body; support it, or choose "
            "a higher mode"
        )
    force = system.M @ shape
    slips_at = _slips_at(system, path, force, shape / (2.0 * np.pi * stuck) ** 2, groups)
    level = shares * slips_at
    states = path.follow(np.outer(level, force), held=np.inf)
    rows = (system.B @ states.T).T
    slip = system.slip_norm(rows)
    travelled = np.cumsum(system.slip_norm(np.diff(rows, axis=0, prepend=0.0)), axis=0)
    work = 4.0 * slip @ system.w
    masing = bool(np.all(travelled @ system.w <= TURNED * (slip @ system.w)))
    count = CHECKED if masing else level.size
    around = np.unique(np.linspace(0, level.size - 1, count).round().astype(int))
    around = around[work[around] > 0.0]
    loops = np.array([_loop(system, path, level[k] * force, states[k]) for k in around])
    ratio = loops / work[around]
    if around.size:  # between them
        work *= np.interp(np.log(level), np.log(level[around]), ratio)
    q = states @ force
    omega = np.sqrt(level / q)
    slipping = slip > NONE * slip.max()
    stuck_share = [[_sticking(system, one, group) for group in groups] for one in slip]
    gross = np.min(stuck_share, axis=1) <= 1.0 - WHOLE
    state = np.where(gross, "gross", np.where(slipping.any(axis=1), "partial", "stick"))
    return Backbone(
        mode=number,
        shape=to.outer(shape),
        stuck_frequency=stuck,
        slips_at=slips_at,
        level=level,
        amplitude=q,
        frequency=omega / (2.0 * np.pi),
        friction_damping=work / (2.0 * np.pi * level * q),
        viscous_damping=float(shape @ (system.C @ shape)) / (2.0 * omega),
        displacement=np.abs((system.P @ states.T).T),
        displaced=to.outer(states[-1]),
        slip=slip,
        share=slipping @ system.w / system.w.sum(),
        state=tuple(state.tolist()),
        masing_error=float(np.abs(ratio - 1.0).max(initial=0.0)) if masing else None,
        warnings=tuple(_doubts(number, frequencies, omega / (2.0 * np.pi), slipping)),
    )


def _loop(system: System, path: QuasiStatic, force: FloatArray, state: FloatArray) -> float:
    """Work of friction (J) in a cycle from a state to its mirror image and back: twice one way."""
    turn = np.linspace(1.0, -1.0, INCREMENTS + 1)[1:]
    states = path.follow(np.outer(turn, force), held=np.inf, start=(state, force))
    slips = np.diff((system.B @ np.vstack([state, states]).T).T, axis=0)
    return 2.0 * float((system.slip_norm(slips) @ system.w).sum())


def _slips_at(
    system: System,
    path: QuasiStatic,
    force: FloatArray,
    static: FloatArray,
    groups: Sequence[IntArray],
) -> float:
    """Level at which the first joint slips as a whole.

    Where joints alone carry the load it is that at which the forces on a joint that sticks add up
    to its limit, or what they hold together; else the load is raised until one slips.
    """
    forces = system.slip_norm(system.B @ (force - system.K @ static))
    loaded = [group for group in groups if forces[group].sum() > 0.0]
    if not loaded:
        raise InputError("backbone: the mode loads no joint, so that friction does not damp it")
    nominal = min(float(system.w[group].sum() / forces[group].sum()) for group in loaded)
    limit = path.limit(force)
    if np.isfinite(limit):
        return min(limit, nominal)

    level, sticks = nominal * (1.0 + WITHIN), 1.0
    u = before = 0.0 * force
    for _ in range(TRIALS):
        u = path.follow(level * force[np.newaxis], held=np.inf, start=(u, before))[0]
        slip = system.slip_norm(system.B @ u)
        last, sticks = sticks, min(_sticking(system, slip, group) for group in loaded)
        if sticks <= 1.0 - WHOLE:
            over = (1.0 - WHOLE - sticks) / (last - sticks)
            return float(level * RAISED**-over) if last < 1.0 else nominal
        before = level * force
        level *= RAISED
    return nominal


def _sticking(system: System, slip: FloatArray, group: IntArray) -> float:
    """Share of a joint's friction limit that does not slip."""
    sticks = slip[group] <= NONE * slip.max()
    return float(system.w[group][sticks].sum() / system.w[group].sum())


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
    friction_work: FloatArray  #: (joints,) of each joint over all of it, J
    energy: float  #: that it began with, J


def ring_down(
    system: System,
    curve: Backbone,
    cycles: int,
    steps_per_cycle: int = 200,
    scheme: Scheme | None = None,
    joints: Mapping[str, IntArray] | None = None,
) -> RingDown:
    """Free vibration released at rest from the highest level of a mode's curve.

    The system's own law acts. What higher modes add to the modal amplitude, above twice the mode's
    frequency, is filtered out, forwards and backwards so that peaks stay where they are.

    Raises
    ------
    InputError
        If too few cycles are asked for.
    ConvergenceError
        If a step does not converge, or no cycle is left to measure.
    """
    if cycles < 2 * ENDS:
        raise InputError(f"backbone.ring_down: found {cycles} cycles, must be at least {2 * ENDS}")
    modal = sparse.csr_array((system.M @ curve.shape)[np.newaxis])
    alone = replace(system, loads=(), P=modal, points=("modal",))
    step = 1.0 / curve.stuck_frequency / steps_per_cycle
    start = curve.displaced, np.zeros(system.n)
    run = integrate(
        alone, step=step, n_steps=cycles * steps_per_cycle, scheme=scheme, initial=start
    ).finished()
    low = butter(4, 2.0 * curve.stuck_frequency, fs=1.0 / step, output="sos")
    q = sosfiltfilt(low, run.point("modal"))
    tops, bottoms = (find_peaks(sign * q, distance=steps_per_cycle // 2)[0] for sign in (1.0, -1.0))
    bottoms = bottoms[np.searchsorted(bottoms, tops[0]) if tops.size else 0 :]
    count = min(tops.size - 1, bottoms.size) - ENDS  # which the filter does not see whole
    if count < 1:
        raise ConvergenceError("backbone.ring_down: no cycle is left to measure; ask for more")
    top, at = _extremes(q, tops)
    decrement = np.log(top[:-1] / top[1:])[:count]
    whole = np.hypot(2.0 * np.pi, decrement)  # angle of a cycle, had it no damping
    joints = {"joint": np.arange(system.w.size)} if joints is None else joints
    return RingDown(
        time=at[:count] * step,
        amplitude=0.5 * (0.5 * (top[:-1] + top[1:])[:count] - _extremes(q, bottoms)[0][:count]),
        frequency=whole / (2.0 * np.pi * np.diff(at)[:count] * step),
        damping_ratio=decrement / whole,
        friction_work=np.array([run.friction_work[points].sum() for points in joints.values()]),
        energy=run.stored_energy[0],
    )


def _extremes(q: FloatArray, rows: IntArray) -> tuple[FloatArray, FloatArray]:
    """Values and places (rows) of extremes, by parabolas through three samples."""
    a, b, c = q[rows - 1], q[rows], q[rows + 1]
    shift = 0.5 * (a - c) / (a - 2.0 * b + c)
    return b - 0.25 * (a - c) * shift, rows + shift


@dataclass
class SceneBackbone:
    """Curves of the modes that a scene asks for, and what they ring down like where it asks."""

    scene: Scene
    curves: list[Backbone]
    ring_downs: list[RingDown | None]
    warnings: list[str]

    def active_lengths(self, slip: FloatArray) -> dict[str, float]:
        """Active length (m) of each joint whose axis is known, from slips (m,), m."""
        return measured_lengths(self.scene.structure(), slip)


def scene_backbone(scene: Scene) -> SceneBackbone:
    """Frequency and damping against amplitude as a scene's table ``[backbone]`` asks for.

    Raises
    ------
    InputError, ConvergenceError
        As :func:`backbone` and :func:`ring_down`.
    """
    asked, system, structure = scene.backbone, scene.system(), scene.structure()
    joints = {patch.joint.name: patch.points for patch in structure.patches}
    curves = backbone(system, asked.modes, asked.levels, asked.up_to, joints)
    downs: list[RingDown | None] = [None] * len(curves)
    if asked.ring_down:
        scheme = generalized_alpha(scene.time.rho_infinity)
        steps = scene.time.steps_per_cycle
        downs = [ring_down(system, c, asked.ring_down, steps, scheme, joints) for c in curves]
    warnings = [*doubts(structure, system), *(w for c in curves for w in c.warnings)]
    warnings += [
        f"Mode {c.mode}: a joint slips as a whole at the lowest level already; ask for less"
        for c in curves
        if c.state[0] == "gross"
    ]
    return SceneBackbone(scene, curves, downs, warnings)
