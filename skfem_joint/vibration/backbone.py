"""Natural frequency and damping ratio of a mode over its amplitude: its backbone curve.

The method is quasi-static modal analysis (H. Festjens, G. Chevallier and J.-L. Dion, Int. J. Mech.
Sci. 75, 2013; R. M. Lacayo and M. S. Allen, Mech. Syst. Signal Process. 118, 2019). With phi a mode
of the structure whose contact sticks, phi^T M phi = 1, the structure is loaded slowly by the mode's
inertia, M phi alpha, at rising levels alpha. The displacement u of each level gives the modal
amplitude q = phi^T M u, and

    omega = sqrt(alpha / q),        zeta = D / (2 pi alpha q) + phi^T C phi / (2 omega),

where D is the work of friction in a cycle of that amplitude, with exact Coulomb friction.

Cycles are those of :mod:`skfem_joint.vibration.cycles`. Where limits are constant and slip keeps
its direction D follows from loading alone. With contact that opens a cycle is followed at each
level, and q is half of peak to peak.

The method takes for granted that the mode keeps its shape and that other modes do not respond.
Where a higher frequency lies near an odd multiple of the mode's own, friction excites it and the
true damping is larger; where another lies near its own, both vibrate together: notes say so. A
ring-down (:mod:`skfem_joint.vibration.ring_down`), which is
free of these assumptions, can be compared with the curve.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from skfem_joint.accuracy.range_modes import alone, check_modes, distances
from skfem_joint.ground.arrays import BoolArray, FloatArray, IntArray
from skfem_joint.ground.errors import ConvergenceError, InputError
from skfem_joint.ground.plain_values import Tabular, spread
from skfem_joint.ground.progress import Progress, Tally, silent
from skfem_joint.ground.values import (
    COUNT,
    POSITIVE,
    check,
    check_kind,
    check_numbers,
    check_some,
    rising,
)
from skfem_joint.reduction.stuck import Stuck, StuckMode, check_stuck_modes, traits_of
from skfem_joint.results.gross_slip import (
    gross_slip_level,
    is_gross,
    sticking_share,
)
from skfem_joint.results.loss import Losses, stacked
from skfem_joint.slow.quasi_static import QuasiStatic
from skfem_joint.stepping.arrangement import Arranged, arranged
from skfem_joint.system.system import System
from skfem_joint.vibration.amplitudes import Amplitudes, LevelSearch
from skfem_joint.vibration.cycles import CyclePath, ModePath, RisingCycles, items_of_work

#: Largest force residual of a level, relative to its force.
TOLERANCE = 1e-6
#: Levels of the curve along which amplitudes are looked for, most rounds of the search, and
#: relative distance from an amplitude that ends it.
SEARCHED, ROUNDS, REACHED = 12, 20, 1e-4
#: Displacement of a point, over the largest, below which a mode does not move it.
STILL = 1e-6
#: Slipping points below which the damping is rough, so that a note says so.
FEWEST = 5
#: Multiples of the mode's frequency near which friction excites higher modes, those near which
#: contact that opens excites them too, and the relative distance that is near.
MULTIPLES, EVEN_MULTIPLES, NEAR = (3, 5, 7), (2, 4, 6), 0.07
#: Modes beyond the highest one asked for whose frequencies are compared with the multiples.
HIGHER_MODES = 10
#: Relative distance of frequencies within which modes may vibrate together and within which they
#: are the same, and share of the amplitude, or of the damping, from which a note says so: with two
#: masses at one joint damping erred by five times the share of the amplitude.
CLOSE, SAME, SHARED, COUPLED = 0.2, 1e-3, 0.02, 0.1
#: Arrays of a curve that do not have a row for each level.
_NOT_BY_LEVEL = {"shape", "loops", "higher"}


@dataclass(frozen=True)
class Backbone(Tabular):
    """Frequency and damping of one mode over its amplitude, at rising levels.

    Attributes
    ----------
    mode : int
        Number of the mode, from 1.
    shape : ndarray, shape (n,)
        Mode with the contact stuck, of unit modal mass, kg^(-1/2).
    stuck_frequency : float
        Its frequency, Hz.
    slips_at : float
        Level at which the first joint slips as a whole, m/s² kg^1/2, with contact that opens as if
        it stayed closed. Where friction alone holds the structure: at most that at which the forces
        on a stuck joint add up to its limit.
    level : ndarray, shape (levels,)
        Acceleration alpha of the mode whose inertia loads the structure, m/s² kg^1/2.
    amplitude : ndarray, shape (levels,)
        Modal amplitude q, m kg^1/2; half of peak to peak.
    frequency : ndarray, shape (levels,)
        Hz.
    friction_damping : ndarray, shape (levels,)
        Damping ratio by friction, under Coulomb's law.
    viscous_damping : ndarray, shape (levels,)
        Damping ratio by C.
    displacement : ndarray, shape (levels, points)
        Of the named points, m; half of peak to peak.
    states : ndarray, shape (levels, n)
        Displacement u, m; with contact that opens half of that from one turning point of the cycle
        to the other, see ``middle``.
    loops : ndarray, shape (increments, n)
        Increments of displacement along the half cycles that were followed, m; none with contact
        that opens.
    slip : ndarray, shape (levels, m)
        Of each contact point, m; that of springs in series with friction included.
    share : ndarray, shape (levels,)
        Share of the friction limits whose points slip, see `System.slipping`.
    state : tuple of str
        At each level "stick", "partial", or "gross", where a joint slips as a whole.
    losses : Losses
        Energies that a cycle of each level loses, and its loss factor, by the strain energy of the
        structure itself: ``friction_damping`` and ``viscous_damping`` are over half of alpha q,
        which is larger by the work of friction on the way to the level. What impacts take is not
        known.
    friction_work : ndarray, shape (levels, m)
        Energy lost by friction in a cycle at each contact point, J.
    masing_error : float or None
        Largest relative error of the work by Masing's rule, before its correction; None where a
        cycle was followed at each level.
    notes : tuple of str
        What to beware of: of levels beyond slip as a whole, of curves without slip, of impacts, of
        a law that is not Coulomb's.
    estimated : dict of str to float
        Estimated largest relative errors of ``frequency`` and ``damping_ratio``: of a reduced model
        for a range, or of the increments and of what is left open of the cycles with contact that
        opens; at given amplitudes that of the increments of half cycles; empty for others.
    work_error : ndarray, shape (levels,), optional
        At given amplitudes: relative error of the work of friction at each by these increments.
    friction : ndarray, shape (levels, rows of B), optional
        Friction over its limit, where it has springs in series; with contact that opens that of the
        turning point at the level, ``middle + states``.
    middle : ndarray, shape (levels, n), optional
        With contact that opens: displacement in the middle of both turning points of the cycle, m.
        ``middle + states`` and ``middle - states`` are those at the level and at its opposite.
    offset : ndarray, shape (levels,), optional
        The same as a modal displacement, m kg^1/2.
    opened : ndarray, shape (levels,), optional
        Share of the pressure points pressed at rest that opened in the cycle.
    limits : ndarray, shape (levels, m), optional
        With contact that opens: the friction limits of ``friction``, N.
    differs : ndarray of bool, shape (levels,), optional
        Levels at which a ring-down differs by more than both stated errors, from
        `skfem_joint.vibration.ring_down.RingDown.beside`; None if there is none beside the curve.
    traits : dict of str to float
        Of the system, see `skfem_joint.reduction.stuck.traits_of`; empty if they are not known.
    higher : ndarray, shape (modes,)
        Frequencies of the next higher modes, Hz, with the contact stuck; see ``excites``.
    path : ModePath, optional
        What the curve was followed along, if it is kept.
    """

    mode: int
    shape: FloatArray
    stuck_frequency: float
    slips_at: float
    level: FloatArray
    amplitude: FloatArray
    frequency: FloatArray
    friction_damping: FloatArray
    viscous_damping: FloatArray
    displacement: FloatArray
    states: FloatArray
    loops: FloatArray
    slip: FloatArray
    share: FloatArray
    state: tuple[str, ...]
    losses: Losses
    friction_work: FloatArray
    masing_error: float | None
    notes: tuple[str, ...]
    estimated: Mapping[str, float] = field(default_factory=dict)
    friction: FloatArray | None = None
    middle: FloatArray | None = None
    offset: FloatArray | None = None
    opened: FloatArray | None = None
    limits: FloatArray | None = None
    differs: BoolArray | None = None
    work_error: FloatArray | None = None
    traits: Mapping[str, float] = field(default_factory=dict)
    higher: FloatArray = field(default_factory=lambda: np.zeros(0))
    path: ModePath | None = field(default=None, repr=False, compare=False)

    @property
    def excites(self) -> tuple[str, ...]:
        """Higher modes near multiples of its frequencies, such as "mode 2 at 3 to 3.1 times".

        Friction excites them, which has odd multiples; contact that opens has even ones too. What
        that takes is in no level: the true damping by friction may be twice as large or more.
        """
        multiples = MULTIPLES + (() if self.opened is None else EVEN_MULTIPLES)
        low, high = self.frequency.min(), self.frequency.max()
        return tuple(
            f"mode {k} at {' to '.join(dict.fromkeys((f'{f / high:.3g}', f'{f / low:.3g}')))} times"
            for k, f in enumerate(self.higher.tolist(), self.mode + 1)
            if any(m * low * (1.0 - NEAR) < f < m * high * (1.0 + NEAR) for m in multiples)
        )

    @property
    def doubts(self) -> tuple[str, ...]:
        """Why not to rely on each level; empty where there is no reason.

        "whole slip", where a joint slips as a whole and the mode's shape no longer holds, and
        "ring-down differs", see ``differs``.
        """
        differs = np.zeros(len(self.state), bool) if self.differs is None else self.differs
        return tuple(
            ", ".join(["whole slip"] * (state == "gross") + ["ring-down differs"] * bool(apart))
            for state, apart in zip(self.state, differs, strict=True)
        )

    @property
    def table(self) -> dict[str, Any]:
        """Columns with a row for each level, as ``backbone.csv``, points by their numbers."""
        opening = {"modal_offset": self.offset, "opened_share": self.opened}
        return {
            "level": self.level / self.slips_at,
            "modal_amplitude": self.amplitude,
            "frequency_Hz": self.frequency,
            "damping_ratio": self.damping_ratio,
            **spread("displacement_{}_m", self.displacement),
            "slipping_share": self.share,
            "friction_damping_ratio": self.friction_damping,
            "viscous_damping_ratio": self.viscous_damping,
            "state": self.state,
            "doubt": self.doubts,
            **{name: values for name, values in opening.items() if values is not None},
            **self.losses.table,
        }

    def at_levels(self, rows: IntArray) -> Backbone:
        """Curve at some of its levels, by their numbers, without what it was followed along."""

        def some(name: str) -> Any:
            value = getattr(self, name)
            by_level = isinstance(value, np.ndarray) and name not in _NOT_BY_LEVEL
            return value[rows] if by_level else value

        arrays = {f.name: some(f.name) for f in fields(self)}
        state = tuple(self.state[k] for k in rows.tolist())
        losses = stacked([self.losses.at(k) for k in rows.tolist()])
        return replace(self, **arrays | {"state": state, "losses": losses, "path": None})

    @property
    def damping_ratio(self) -> FloatArray:
        """Damping ratio of friction, under Coulomb's law, and viscous forces."""
        return self.friction_damping + self.viscous_damping

    @property
    def highest(self) -> FloatArray:
        """Displacement at the highest level, (n,), m, from which a ring-down begins."""
        end = self.states[-1]
        return end if self.middle is None else np.asarray(end + self.middle[-1])

    @property
    def release(self) -> tuple[FloatArray, ...]:
        """State at rest at the highest level, as `integrate` takes it as ``initial``."""
        kept = [x[-1] for x in (self.friction, self.limits) if x is not None]
        return self.highest, np.zeros(self.highest.size), *kept


def backbone(
    system: System,
    modes: Sequence[int] = (1,),
    levels: int | ArrayLike | Amplitudes = 20,
    up_to: float = 0.7,
    slips_at: float | None = None,
    progress: Progress = silent,
    keep_path: bool = False,
    factors: Any = None,
) -> list[Backbone]:
    """Natural frequency and damping ratio of some modes over their amplitude.

    Parameters
    ----------
    system : System
        Full, condensed, or reduced by ``reduce(system, curve=...)`` or for a range. Its friction
        acts as Coulomb's, which a note says where its own law is another one; its loads do not act.
        With contact that opens a cycle is followed at each level, and a curve ends where the
        structure lifts off, which a note says.
    modes : sequence of int
        Numbers of the modes with the contact stuck, from 1; a reduced model has as many as its
        basis has fixed-interface modes.
    levels : int, array_like or Amplitudes
        Levels of each mode, evenly spaced on a logarithmic axis over a factor of twenty; or the
        levels themselves, rising, m/s² kg^1/2, without regard to ``up_to``; or the amplitudes of a
        point that the levels shall have, such as ``Amplitudes("tip", force=[10.0, 50.0])``, to
        1e-4.
    up_to : float
        The highest level, as a share of that at which the first joint slips as a whole; that up to
        which given amplitudes are looked for.
    slips_at : float, optional
        Level at which the first joint slips as a whole, m/s² kg^1/2, such as that of the full
        model's `Backbone`; computed if not given. A model that was made of a curve has that of the
        curve.
    progress : callable, optional
        Called with (levels done, levels in all as far as they are known), increments of cycles
        included; with contact that opens, with cycles.
    keep_path : bool
        Whether `Backbone.path` is kept, which `backbone_sensitivity` computes derivatives from. It
        has factors of the stiffness, and with contact that opens all levels that were computed. It
        goes with levels, not with amplitudes.
    factors : Factors, optional
        Of the stiffness, from earlier curves and for later ones of a system that differs in limits,
        springs and damping alone.

    Returns
    -------
    list of Backbone
        In the order of ``modes``.

    Raises
    ------
    InputError
        If there is no friction, no such mode, it is a motion as a rigid body, a joint slips as a
        whole at the first level, friction alone holds the structure and cannot at the last, an
        amplitude is not reached, or the system is a reduced model made for something else, or a
        level is above its highest.
    ConvergenceError
        If a level does not converge, an amplitude is not found, or with contact that opens the
        first level has no state.
    """
    check_kind("system", system, System)
    if slips_at is None:
        slips_at = getattr(system.origin, "slips_at", None)
        if slips_at is not None and np.isnan(slips_at):  # of a curve at given levels
            if isinstance(levels, Amplitudes) or np.ndim(levels) == 0:
                raise InputError(
                    "backbone: slips_at: not known, since the reduced model was made of a curve at "
                    "given levels; give levels, up to the highest of that curve, or the full "
                    "model's slips_at"
                )
            slips_at = None
    amplitudes, point = None, 0
    if isinstance(levels, Amplitudes):
        amplitudes, point = levels, levels.number(system.points)
        if keep_path:
            raise InputError("backbone: keep_path: needs levels, found amplitudes; leave it out")
        asked = _Levels.of(SEARCHED, up_to, slips_at)
    else:
        asked = _Levels.of(levels, up_to, slips_at)
    system.check_any_load("backbone", float(asked.shares[-1]) * (asked.slips_at or 0.0))
    if not system.contact.count:
        why = "frequency and damping do not depend on amplitude"
        if system.contact.opens:
            why = "levels are shares of the load at which a joint slips as a whole"
        raise InputError(f"backbone: needs friction, no contact point carries any: {why}")
    check_numbers("backbone: modes", modes)
    numbers, tally = np.asarray(modes, dtype=int), Tally(progress)
    to = arranged(system.closed())
    path = CyclePath(system, to, (factors or Factors()).path_of(to, tally), keep_path)
    tally.total = len(modes) * items_of_work(asked.shares.size, path.opens)
    stuck = Stuck(to.system, path.stays)
    frequencies, shapes = stuck.modes(int(numbers.max()) + HIGHER_MODES)
    check_stuck_modes("backbone", numbers.tolist(), frequencies)
    serves = system.serves
    if serves is not None:  # its modes end with its range, and it states its errors
        of_mode = {k: float(frequencies[k - 1]) for k in numbers.tolist()}
        check_modes(serves, of_mode, of_mode, 0.0 if asked.absolute else up_to)
    curves = []
    for k in numbers.tolist():
        mode = StuckMode(k, frequencies, shapes, stuck)
        if serves is not None and asked.absolute:  # a range ends at a share
            whole = _check_levels(path.stays, mode, _Levels.of(1, 0.5, slips_at))
            check_modes(serves, (), {}, float(asked.shares[-1]) / whole)
        curve = _curve(path, mode, asked)
        if amplitudes:
            curve = _at_amplitudes(path, mode, curve, amplitudes, point)
        curves.append(curve if keep_path else replace(curve, path=None))
    if serves is None:
        return curves
    for k, curve in enumerate(curves):
        known = None if asked.absolute else curve.slips_at
        (other,) = backbone(alone(system), (curve.mode,), levels, up_to, known)
        curves[k] = replace(curve, estimated=distances(serves, curve, other))
    return curves


class _Levels(NamedTuple):
    """Levels of a curve.

    Attributes
    ----------
    shares : ndarray, shape (levels,)
        Over ``slips_at``.
    slips_at : float or None
        Level at which the first joint slips as a whole, if it is known.
    absolute : bool
        Whether they were given as levels, which are shares of 1.
    """

    shares: FloatArray
    slips_at: float | None
    absolute: bool

    @classmethod
    def of(cls, levels: int | ArrayLike, up_to: float, slips_at: float | None) -> _Levels:
        """By the arguments of `backbone`.

        InputError for a number below 1, other values that are not positive, and levels that do not
        rise from above zero.
        """
        check("backbone: up_to", up_to, POSITIVE)
        check_some(POSITIVE, **{"backbone: slips_at": slips_at})
        if np.ndim(levels) == 0:
            check("backbone: levels", levels, COUNT)
            count = int(np.asarray(levels))
            lowest = 0.05 if count > 1 else 1.0  # over the highest
            return cls(up_to * np.geomspace(lowest, 1.0, count), slips_at, False)
        return cls(rising("backbone: levels", levels), 1.0, True)

    def text(self, share: float) -> str:
        """A level in words: as such, or as a share of that at which the first joint slips whole."""
        return f"{share:.4g} m/s² kg^1/2" if self.absolute else f"{share:.3g} of gross slip"


class Factors:
    """Factors of the stiffness that curves of other limits, springs and damping use again."""

    def __init__(self) -> None:
        self._path: QuasiStatic | None = None

    def path_of(self, to: Arranged, tally: Tally) -> QuasiStatic:
        """Quasi-static path of a system at rest, with the factors kept where they are its own."""
        path, self._path = self._path, None
        if path is not None and path.whole is not None and _differ_in_law(path.to, to):
            path = path.limited(Arranged(to.system, to.kind))
            path.tally = tally
        else:
            del path  # two factors at once may be too large
            path = QuasiStatic(to.system, TOLERANCE, tally, in_contact=True)
        self._path = path
        return path


def _differ_in_law(one: Arranged, other: Arranged) -> bool:
    """Whether two systems differ in limits, springs and damping alone."""
    law, new_law = one.system.contact, other.system.contact
    limited = np.array_equal(law.w > 0.0, new_law.w > 0.0)
    alike = one.kind == other.kind and limited and np.array_equal(law.beta, new_law.beta)
    return alike and one.system.has_matrices_of(other.system, "K", "M", "B")


def _curve(
    path: CyclePath, mode: StuckMode, asked: _Levels, checked: IntArray | None = None
) -> Backbone:
    """Backbone of a mode at the levels that are asked for; ``checked`` as `CyclePath.follow`.

    Whether joints slip as a whole is asked of the path of contact that stays closed.
    """
    slips_at = _check_levels(path.stays, mode, asked)
    to, shape = path.to, path.of_closed(mode.shape)
    system = to.system
    force = np.asarray(system.M @ shape)
    found = path.follow(force, asked.shares * slips_at, float(shape @ (system.C @ shape)), checked)
    level, states = found.level, found.states
    springs = system.contact.has_springs
    q = states @ force
    omega = np.sqrt(level / q)
    viscous_damping = float(shape @ (system.C @ shape)) / (2.0 * omega)
    frequency = omega / (2.0 * np.pi)
    stays = path.stays.to.system
    # In the cycle, which may slip where the rise sticks. Limits at rest may be zero where they
    # follow normal forces, whose cycles are followed at each level.
    slid = found.sliding if path.opens else stays.contact.slid(found.by_point)
    slipping = stays.slipping(slid)
    state = _stick_or_slip(path.stays, mode, asked, found, slipping)
    notes = [
        *found.notes,
        *_notes_of_levels(asked, state, slipping),
        *_notes_of_law(system, found),
        *_notes_of_close(system, mode, path.of_closed(mode.shapes), frequency, states),
    ]
    middle = found.middle
    curve = Backbone(
        mode=mode.number,
        shape=to.outer(shape),
        stuck_frequency=mode.frequency,
        slips_at=np.nan if asked.absolute else slips_at,
        level=level,
        amplitude=q,
        frequency=frequency,
        friction_damping=found.work / (2.0 * np.pi * level * q),
        viscous_damping=viscous_damping,
        displacement=np.abs((system.P @ states.T).T),
        states=to.outer(states),
        loops=to.outer(found.loops),
        slip=found.slip,
        share=stays.slipping_share(slid),
        state=state,
        losses=Losses(
            friction=found.work,
            viscous=2.0 * np.pi * level * q * viscous_damping,
            strain=found.strain,
            by_joint=np.asarray((system.contact.J @ found.by_point.T).T),
        ),
        friction_work=found.by_point,
        masing_error=found.masing_error,
        notes=(),
        estimated=found.errors,
        friction=found.friction if springs else None,
        limits=found.limits if springs else None,
        middle=None if middle is None else to.outer(middle),
        offset=None if middle is None else middle @ force,
        opened=found.opened,
        work_error=found.work_error,
        traits=traits_of(path.system, to.outer(shape)),
        higher=mode.frequencies[mode.number :],
        path=ModePath(mode, shape, path, found),
    )
    notes += _notes_of_excited(curve.excites, path.opens)
    return replace(curve, notes=tuple(f"Mode {mode.number}: {note}" for note in notes))


def _at_amplitudes(
    path: CyclePath, mode: StuckMode, curve: Backbone, amplitudes: Amplitudes, point: int
) -> Backbone:
    """Curve of a mode at given amplitudes of a point, from one that goes up to its highest level.

    InputError if an amplitude is above that of the highest level, or not found.
    """

    def values(curve: Backbone) -> FloatArray:
        return amplitudes.along(curve.displacement[:, point], curve.frequency, curve.losses.lost)

    largest = float(np.abs(path.system.expand(curve.states[-1])).max())
    if curve.displacement[-1, point] <= STILL * largest:
        raise InputError(
            f"backbone: amplitudes: mode {mode.number} does not move {amplitudes.point!r}, which "
            f"has a direction of its own; {_that_move(path, mode, point)}choose another point or "
            "mode, or name another direction by a load, which does not act here"
        )
    level, known, asked = curve.level, values(curve), amplitudes.values
    most = float(known.max())
    if asked[-1] > most:
        raise InputError(
            f"backbone: amplitudes: found a {amplitudes.text(float(asked[-1]))}, but at its "
            f"highest level the curve of mode {mode.number} has a {amplitudes.text(most)}; ask for "
            "less, or set up_to higher"
        )
    by_way = level[: 0 if path.opens else None]  # see `amplitudes`
    search = LevelSearch(asked, level, known)
    for _ in range(ROUNDS):
        all_levels = np.union1d(search.tried, by_way)
        rows = np.searchsorted(all_levels, search.tried)
        path.tally.total += items_of_work(all_levels.size, path.opens)
        shares = _Levels(all_levels / curve.slips_at, curve.slips_at, False)
        found = _curve(path, mode, shares, rows)
        if found.level.size < all_levels.size:  # the structure lifts off
            raise InputError(f"backbone: amplitudes: {' '.join(found.notes)}")
        found = found.at_levels(rows)
        reached = values(found)
        apart = reached / asked - 1.0
        if np.abs(apart).max() <= REACHED:
            return found
        search.correct(reached)
    worst = int(np.abs(apart).argmax())
    raise ConvergenceError(
        f"backbone: amplitudes: a {amplitudes.text(float(asked[worst]))} of mode {mode.number} is "
        f"not found to {REACHED:g}; after {ROUNDS} rounds it is off by {apart[worst]:.2g}: the "
        "quantity jumps or does not rise with the level there; ask for the levels themselves"
    )


def _that_move(path: CyclePath, mode: StuckMode, point: int) -> str:
    """Which of the modes that are known move a point, in words; empty if none does."""
    system = path.closed.system
    moved = np.abs(np.asarray(system.P @ mode.shapes)[point])
    largest = np.abs(system.expand(mode.shapes.T)).max(axis=1)
    moving = ", ".join(map(str, np.flatnonzero(moved > STILL * largest) + 1))
    return f"of the first {moved.size} modes {moving} move it; " if moving else ""


def _check_levels(path: QuasiStatic, mode: StuckMode, asked: _Levels) -> float:
    """Level at which the first joint slips as a whole; computed if not given.

    InputError if the mode loads no joint, or friction cannot hold the highest of the levels.
    """
    slips_at, number, omega = asked.slips_at, mode.number, 2.0 * np.pi * mode.frequency
    limit = path.limit(mode.force)
    if slips_at is None:
        slips_at = gross_slip_level(path, mode.force, mode.shape / omega**2, limit, False)
        if np.isinf(slips_at):
            raise InputError("backbone: the mode loads no joint, so that friction does not damp it")
    if asked.shares[-1] * slips_at >= limit:
        raise InputError(
            f"backbone: found levels up to {asked.text(asked.shares[-1])}, but friction alone "
            f"holds the structure, and mode {number} makes all of it slip at "
            f"{asked.text(limit / slips_at)}; ask for less"
        )
    return slips_at


def _stick_or_slip(
    path: QuasiStatic,
    mode: StuckMode,
    asked: _Levels,
    found: RisingCycles,
    slipping: BoolArray,
) -> tuple[str, ...]:
    """Whether the contact sticks, slips in part, or a joint slips as a whole, at each level.

    InputError if a joint slips as a whole at the first level.
    """
    slips = zip(found.slip, found.sliding, strict=True)
    gross = [is_gross(sticking_share(path, *both)) for both in slips]
    if gross[0]:
        raise InputError(
            f"backbone: mode {mode.number}: a joint slips as a whole at the first level already, "
            f"{asked.text(asked.shares[0])}; "
            + ("give lower levels" if asked.absolute else "set up_to below 1")
        )
    state = np.where(gross, "gross", np.where(slipping.any(axis=1), "partial", "stick"))
    return tuple(state.tolist())


def _notes_of_levels(asked: _Levels, state: Sequence[str], slipping: BoolArray) -> Iterator[str]:
    """Notes of levels at which a joint slips as a whole, of few points or of none that slip."""
    if "gross" in state:
        yield (
            f"from the level {asked.text(asked.shares[state.index('gross')])} on a "
            "joint slips as a whole. The method keeps the inertia of the mode with stuck joints "
            "there, whose shape free vibration leaves: frequency and damping at these levels may "
            "be wrong by factors. Compare a ring-down, or response."
        )
    if set(state) == {"stick"}:
        how = (
            "higher levels"
            if asked.absolute
            else "an up_to above it; above 1 a joint slips as a whole"
        )
        yield (
            f"nothing slips up to the highest level, {asked.text(asked.shares[-1])}, so that "
            "friction damps the mode hardly or not at all. A joint of a single slider, or of few, "
            f"slips as a whole or not at all: ask for {how}."
        )
    count = slipping.sum(axis=1)
    count = count[count > 0]
    if count.size and count[0] < FEWEST:
        yield (
            f"few points slip at the lowest level with slip, {count[0]}; below {FEWEST} the "
            "damping is rough. Use smaller elements in the joint to resolve it."
        )


def _notes_of_law(system: System, found: RisingCycles) -> Iterator[str]:
    """Notes of what slow cycles under Coulomb's law leave out: the joints' own law, and impacts."""
    beta = system.contact.beta[system.contact.rubs & np.isfinite(system.contact.beta)]
    if beta.size:
        yield (
            "the curve is of Coulomb's law. The joints' own, with beta = "
            f"{beta.min():.3g} s/m, lets them creep where they would stick, which damps vibration "
            f"more whose slip is slower than about {1.0 / beta.min():.2g} m/s. A ring-down and "
            "response have it."
        )
    if found.opened is not None and found.opened.any():
        yield (
            f"contact opens from the level number {int(np.argmax(found.opened > 0.0)) + 1} on. The "
            "cycles are slow: what impacts take as faces meet again is not in the damping. A "
            "ring-down has it (impact_work)."
        )


def _notes_of_close(
    system: System,
    mode: StuckMode,
    shapes: FloatArray,
    frequency: FloatArray,
    states: FloatArray,
) -> Iterator[str]:
    """Notes of other modes, of all ``shapes`` (n, modes), that vibrate together with this one.

    A state's part along another mode grows by resonance, as a force of the frequency drives it.
    """
    k, other, square = mode.number - 1, mode.frequencies, frequency[:, np.newaxis] ** 2
    parts = np.abs(states @ (system.M @ shapes))
    beside = np.maximum(np.abs(other**2 - square), SAME * square)
    share = (parts * other**2 / beside / parts[:, [k]]).max(axis=0)
    apart = np.abs(other / other[k] - 1.0)
    for j in np.flatnonzero((apart < SAME) | (apart < CLOSE) & (share > SHARED)):
        what = (
            f"mode {j + 1}, at {other[j]:.5g} Hz, vibrates with it: slip would give it "
            f"{100.0 * share[j]:.2g} % of its amplitude, and damping errs by a multiple of that"
        )
        if apart[j] < SAME:
            what = (
                f"mode {j + 1} has the same frequency: any mix of both is a mode, with a curve of "
                "its own where joints do not slip alike in all"
            )
        if j != k:
            yield f"{what}. See its ring-down, or response."
    C, omega = shapes.T @ (system.C @ shapes), 2.0 * np.pi * other
    zero, one = np.zeros_like(C), np.eye(omega.size)
    values, vectors = np.linalg.eig(np.block([[zero, one], [-np.diag(omega**2), -C]]))
    vectors = vectors[: omega.size] / np.linalg.norm(vectors[: omega.size], axis=0)
    value = values[np.abs(vectors[k]).argmax()]
    alone, true = C[k, k] / (2.0 * omega[k]), -value.real / np.abs(value)
    if abs(true - alone) > COUPLED * max(alone, 1e-6):  # below which it is round-off
        yield (
            f"the damping matrix couples it with other modes: while all sticks its damping ratio "
            f"is {true:.3g}, not {alone:.3g}. See its ring-down, or response."
        )


def _notes_of_excited(near: tuple[str, ...], opens: bool) -> Iterator[str]:
    """Note of higher modes that friction or contact that ``opens`` excites."""
    if near:
        kind, what = ("", "contact excites") if opens else ("odd ", "friction excites")
        yield (
            f"higher frequencies come within {100.0 * NEAR:g} % of {kind}multiples of its own "
            f"({', '.join(near)}), so that {what} them: the true damping by friction may be "
            f"twice as large or more. {'' if opens else 'See its ring-down, or response.'}"
        ).rstrip()
