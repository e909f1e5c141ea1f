"""Quasi-static response to slowly changing forces with friction, without inertia.

From the state before, each increment d of the displacement solves

    minimise  1/2 d K d - (f + N^T force - K u) d + sum w |B d|    with    N d <= gap - N u,

the step problem with the stiffness for its matrix and the increment for its unknown
(:mod:`skfem_joint.minimise.problem`). The rows N are those of contact that opens, whose forces at
the end of the increment set the limits w; without them limits are constant. The law is Coulomb's,
under which points that stick do so exactly. Only where `QuasiStatic.follow` is told when levels are
reached, and limits are constant, it is the system's own, with beta over the time of an increment.
Reversals and histories of loads need no special treatment. Within an increment the direction of
slip is constant: increments must be short enough to resolve how it turns.

Dense systems, which come from reduction, have more contact points than unknowns, so that not all
points can stick: there Coulomb's law is approached by ever steeper laws. With contact that opens,
which is elastic there, the law is one so steep that sticking points creep by a share of the largest
slip of any increment before.

Springs in series with friction stretch before sliders slip. Their forces are part of the state, as
friction over its limit, and follow from one level to the next.

Bodies that friction and contact alone hold have a singular stiffness. Weak springs at the contact
are added to it, or a little of the mass where these do not hold all motions or the motions are not
known. `QuasiStatic.next` repeats a level until the added mass carries nothing, and refuses one that
nothing holds. `QuasiStatic.follow`, which goes through many levels at once, for modes, scales
forces that would make everything slip back to just below what friction holds. That limit is found
from the rigid motion d that a load sets off: by the upper bound theorem of limit analysis
sum w |B d| / f d is never below the limit, and Dinkelbach's iteration (Manag. Sci. 13, 1967)
decreases it to the limit. The motion in which everything slips strains nothing: where the rigid
motions are known the limit is their least ratio, which repeated least squares find without a solve.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from copy import copy
from dataclasses import replace
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Self, cast

import numpy as np
from scipy import linalg, sparse
from scipy.sparse.linalg import aslinearoperator

from skfem_joint.ground.arrays import FloatArray, Matrix, as_dense
from skfem_joint.ground.errors import ConvergenceError, InputError, JointError
from skfem_joint.ground.progress import Tally
from skfem_joint.linalg import shifts
from skfem_joint.linalg.compressed import as_compressed
from skfem_joint.linalg.factors import factorised
from skfem_joint.linalg.schur import SchurComplement, condensing_pays
from skfem_joint.minimise.problem import ContactPoints, Minimum, Pressed, StepProblem
from skfem_joint.slow.floating import STILL, Still, held, pushes
from skfem_joint.slow.levels import Level, NoLevelError, Walk
from skfem_joint.stepping.arrangement import Arranged, arranged, step_problem
from skfem_joint.system.contacts import Contact
from skfem_joint.system.modes import ROUND_OFF
from skfem_joint.system.rigid import floats, rigid_of
from skfem_joint.system.system import System
from skfem_joint.system.unknowns import ChangeOfUnknowns, selection

if TYPE_CHECKING:
    from skfem_joint.minimise.condensed_newton import CondensedNewton
    from skfem_joint.minimise.linearisation import Linearisation, LinearisedProblem

#: Why there is no level, where a limit of friction is not known.
NOT_HELD = "friction and contact do not hold the loads: the structure slides or lifts off"

#: A level that does not converge is reached in parts, halved at most this often.
HALVINGS = 8
# A level of `follow` with constant limits that does not converge at once is reached in parts,
# halved at most this often.
_HALVINGS = 6
#: Where forces are not held by contact that opens, the way to them is halved so many times to find
#: how far they are.
HELD = 5
# Share of the load that the added mass may carry before everything counts as slipping.
_CARRIED = 1e-3
# Slips below this share of the one that the law was made for ask for a steeper law.
_SMALLER = 0.1
#: Most iterations for the friction limit.
LIMIT_ITERATIONS = 20
#: Most repetitions of least squares for the friction limit.
LEAST_SQUARES = 200
# Most rigid motions.
_MOST_RIGID = 12


def in_parts(
    next_level: Callable[[Level, FloatArray], Level],
    last: Level,
    before: FloatArray,
    after: FloatArray,
    depth: int = 0,
) -> Iterator[tuple[FloatArray, Level]]:
    """Levels on the way from loads ``before``, with the level ``last``, to loads ``after``.

    It is the one of ``after`` alone if that is found, and otherwise those of ever smaller parts.

    Parameters
    ----------
    next_level : callable
        Of the level before and the loads: `QuasiStatic.next` for loads as forces.
    last : Level
    before, after : ndarray
        Loads, N, which change in proportion.
    depth : int
        How often the way was halved.

    Yields
    ------
    loads : ndarray
    level : Level

    Raises
    ------
    NoLevelError
        If a level does not exist, or is not found after `HALVINGS`.
    """
    try:
        level = next_level(last, after)
    except NoLevelError as error:
        if error.beyond or depth >= HALVINGS:
            raise
    else:
        yield after, level
        return
    for end in (0.5 * (before + after), after):
        for loads, level in in_parts(next_level, last, before, end, depth + 1):
            yield loads, level
            before, last = loads, level


class QuasiStatic:
    """Quasi-static response of one system: one matrix for all levels and histories of load.

    Parameters
    ----------
    system : System
        Its law counts only in `follow` with times and constant limits, its masses only where
        friction and contact alone hold a body.
    tolerance : float
        Largest force residual relative to the largest force.
    tally : Tally, optional
        Counts the levels that are solved.
    frictionless : bool
        Whether a system without friction is taken too, which is linear.
    in_contact : bool
        Whether levels of a structure that floats are found in the unknowns of the contact, which is
        faster; for `walk`, `next` and `limit`.

    Raises
    ------
    InputError
        If no point carries friction, or slip rows of a large sparse system depend on each other.
    """

    def __init__(
        self,
        system: System,
        tolerance: float = 1e-8,
        tally: Tally | None = None,
        frictionless: bool = False,
        in_contact: bool = False,
    ) -> None:
        self.to = arranged(system)
        inner = self.to.system
        self.contact, self.opens = inner.contact.normal, inner.contact.opens
        if not (inner.contact.count or frictionless or self.opens):
            raise InputError("quasi-static slip: needs friction, no contact point carries any")
        self.tolerance, self.tally = tolerance, tally or Tally()
        self.dense = self.to.kind == "dense" or inner.is_dense
        self.K, self.M = (
            as_dense(A) if self.dense else as_compressed(A) for A in (inner.K, inner.M)
        )
        self.shift = shifts.LEAST * inner.mean_square_frequency if floats(inner) else 0.0
        if self.shift and self.to.kind == "dense":
            rows = np.vstack([as_dense(A) for A in (inner.contact.B, self.contact.N)])
            self.rigid, self.M = held(self.K, self.M, rows, self.shift)
        still = self._still()
        rests = still is not None and still.held.size > 0
        self.still = still if rests and in_contact and self._condenses() else None
        #: Multiple of the mass that is added, 1/s2; none where springs are.
        self.mass_shift = self.shift
        if still is not None and (self.still is not None or not rests):
            self.M, self.mass_shift = still.springs(self.K, self.shift), 0.0
        # Of the unknowns that are stepped through: stiffness, what is added to it, slip rows.
        self.stiffness, self.added, self.B = self.K, self.shift * self.M, inner.contact.B
        self.A, self.beta = as_compressed(self.K + self.added), inner.contact.beta
        self.acting: Any = slice(None)  # slip rows of the problem
        self.problem: StepProblem = self._problem()
        self.whole: CondensedNewton | None = None  # the problem, where it is condensed
        self.condensed: SchurComplement | None = None  # where the contact is stepped alone
        self.holds: Any = np.zeros(inner.n, dtype=bool)  # where springs hold what nothing moves
        self.alone: _Alone | None = None
        if self.to.kind == "contact":
            from skfem_joint.minimise.condensed_newton import CondensedNewton  # loads the compiler

            if isinstance(self.problem, CondensedNewton) and not self.opens:
                self.whole = self.problem
                if self.still is None:
                    self._step_contact_alone(self.whole)
        self._to_rest()

    def _still(self) -> Still | None:
        """Motions in which nothing slips and nothing is strained, and what holds them.

        None where they are not known, where slips are no unknowns, and of contact that opens: its
        levels are repeated until the shift carries nothing, or refused.
        """
        inner = self.to.system
        rigid = rigid_of(inner) if self.shift else None
        if rigid is None or self.dense or self.opens or self.to.kind == "linear":
            return None
        return Still.of(rigid, ContactPoints.of(inner).limited, self.M)

    def _condenses(self) -> bool:
        """Whether the problem is condensed to the contact."""
        if self.to.kind != "contact" or isinstance(self.K, np.ndarray):
            return False
        return condensing_pays(self.K, ContactPoints.of(self.to.system).limited)

    def _problem(self) -> StepProblem:
        """Problem of the increments."""
        points = ContactPoints.of(self.to.system)
        if self.still is None:
            return step_problem(self.A, points, self.to.kind)
        from skfem_joint.minimise.condensed_newton import CondensedNewton  # loads the compiler

        return CondensedNewton(self.A, points, self.still.held.tolist())

    def _in_contact(self) -> _Alone:
        """The same response in the kept unknowns."""
        if self.alone is None:
            self.alone = _Alone(self)
        self.alone.path.tally, self.alone.path.tolerance = self.tally, self.tolerance
        return self.alone

    def of_kept(self) -> QuasiStatic:
        """Response in the unknowns that the whole problem keeps, with the same factors."""
        whole, inner, path = cast("CondensedNewton", self.whole), self.to.system, copy(self)
        kept, S = whole.schur.kept, whole.schur.complement
        place = selection(kept, inner.n)
        change = ChangeOfUnknowns(sparse.csr_array(place.T), place, kept[:0])
        path.M, path.added = (A[kept][:, kept] for A in (self.M, self.added))
        added = as_dense(path.added) if isinstance(S, np.ndarray) else path.added
        path.K = path.stiffness = S - added
        path.A, path.B = S, sparse.csr_array(self.B)[:, kept]
        contact = inner.contact.in_unknowns(change.forward, path.B)
        system = System(M=path.M, C=None, K=path.K, contact=contact)
        path.to = Arranged(system, self.to.kind, (*self.to.maps, change))
        path.problem, path.whole, path.still = whole.of_kept(), None, None
        path.holds = np.isin(kept, cast("Still", self.still).held)
        vars(path).pop("_slips", None)
        vars(path)["rigid"] = cast("Still", self.still).sliding[kept]
        path._to_rest()
        path._counts = self._counts
        return path

    def _to_rest(self) -> None:
        """Forget all levels, and the work for them."""
        rows = self.to.system.contact.B.shape[0]
        self.last = np.zeros(self.A.shape[0])
        self.friction = np.zeros(rows)  # of the last level, N
        self.frictions = np.zeros((0, rows))
        self.alone = None
        self.solves = 0
        self.scaled_back = 0  # levels whose forces were scaled back
        self._counts = {"factorizations": 1}
        self.largest_slip = 0.0
        if self.opens:
            from skfem_joint.minimise.touching import Touching  # loads the compiler

            self.touching = Touching(self.contact.force > 0.0)

    def afresh(self, to: Arranged, tolerance: float | None = None) -> Self:
        """Copy at rest that reuses the factorisations; ``to`` maps to the caller's unknowns."""
        path = copy(self)
        path.to, path.tally = to, Tally()
        path.tolerance = self.tolerance if tolerance is None else tolerance
        path._to_rest()
        return path

    def with_limits(self, contact: Contact) -> Self:
        """Copy at rest with the friction limits, and their gain, of another contact of its points.

        Limits are zero where they were zero. Factors of the stiffness are used again.
        """
        limits = {"given": contact.given, "gain": contact.gain}
        return self.limited(replace(self.to, system=self.to.system.with_contact(**limits)))

    def limited(self, to: Arranged) -> Self:
        """Copy at rest for a system that differs in friction limits, springs and damping alone.

        Limits are zero where they were zero. Factors of the stiffness are used again.
        """
        path = self.afresh(to)
        points = ContactPoints.of(path.to.system)
        if self.whole is None:
            path.problem = step_problem(self.A, points, self.to.kind)
            return path
        path.whole = self.whole.with_limits(points)
        path.problem = path.whole if self.condensed is None else path.whole.contact
        return path

    @property
    def factorizations(self) -> int:
        """Matrices factorised so far."""
        opens = self.opens
        return int(self._counts["factorizations"] if opens else self.problem.factorizations)

    @property
    def counts(self) -> Mapping[str, int]:
        """Work done so far, by names of :class:`skfem_joint.stepping.recording.Counters`."""
        return self._counts | {"factorizations": self.factorizations}

    @property
    def _creeps(self) -> bool:
        """Whether sticking points creep: with contact that opens, and fewer unknowns than slips."""
        return self.opens and self.to.kind == "dense"

    @property
    def creep(self) -> float:
        """Slip of a sticking point in an increment up to now, m; none where points can stick."""
        # As a sticking point of a dense system with contact that opens slips in an increment.
        return 1e-6 * self.largest_slip

    def linearisation(self) -> Linearisation:
        """How increments change with what they are of, under Coulomb's law."""
        problem = cast("LinearisedProblem", self.whole or self.problem)
        return problem.linearisation(np.full(self.to.system.contact.w.size, np.inf))

    def _step_contact_alone(self, whole: CondensedNewton) -> None:
        """Iterate on contact unknowns only, unless a rigid motion without slip exists.

        Neither is it done where bodies can move rigidly and the contact is sparse: the projection
        that is added to it is dense.
        """
        kept, contact = whole.schur.kept, whole.contact
        rigid = self.rigid[kept]
        if rigid.size:
            still = STILL * np.abs(self.rigid).max()
            more = rigid.shape[1] > rigid.shape[0]  # than contact unknowns
            slips = not more and np.linalg.svd(rigid, compute_uv=False).min() > still
            if not contact.dense or not slips:
                return
        self.condensed, self.problem, self.A = whole.schur, contact, contact.H
        acting = self.to.system.contact.w > 0.0
        self.beta, self.acting = (
            self.beta[acting],
            np.repeat(acting, self.to.system.contact.directions),
        )
        self.B = self.B[:, kept]
        self._spare_rigid(rigid)

    def _spare_rigid(self, rigid: FloatArray) -> None:
        """Take what is added to K from each level's forces for rigid motions alone, (n, r)."""
        image = self.A @ rigid
        among = np.linalg.solve(rigid.T @ image, image.T)
        self.added = aslinearoperator(image) @ aslinearoperator(among)
        self.stiffness = aslinearoperator(self.A) - self.added

    def _without_friction(self) -> Callable[[FloatArray], FloatArray]:
        """Solver of A u = f."""
        if self.whole is not None and self.condensed is None:
            return self.whole.schur.solver()
        return cast("Callable[[FloatArray], FloatArray]", factorised(self.A))

    @cached_property
    def rigid(self) -> FloatArray:
        """Rigid motions, (n, r), in the unknowns of ``to.system``.

        Where they are not known inverse iteration finds them in a few steps, because so little is
        added to K.
        """
        n, known = self.to.system.n, rigid_of(self.to.system)
        if not self.shift:
            return np.zeros((n, 0))
        if known is not None:
            return known
        solve = self._without_friction()
        X = np.random.default_rng(0).normal(size=(n, min(_MOST_RIGID, n)))
        for _ in range(3):
            X = np.linalg.qr(solve(self.M @ X))[0]
        squares, shares = linalg.eigh(X.T @ (self.K @ X), X.T @ (self.M @ X))
        return np.asarray(X @ shares[:, squares < ROUND_OFF * self.shift])

    def stuck(self, F: sparse.csc_array) -> Callable[[FloatArray], FloatArray] | None:
        """Solver for the unknowns that the columns of F pick, if their factor exists already."""
        if self.whole is None or self.to.maps or self.still is not None:
            return None
        schur = self.whole.schur
        if not np.array_equal(F.indices, schur.interior):
            return None
        return cast("Callable[[FloatArray], FloatArray]", schur.solve_interior)

    def stuck_still(self, F: sparse.csc_array) -> tuple[Any, FloatArray] | None:
        """Where the unknowns that F picks float: their solver with these held, and their motions.

        The solver is of right sides that hold the motions in balance. None if there is no factor.
        """
        if self.whole is None or self.to.maps or self.still is None:
            return None
        schur, held = self.whole.schur, self.still.held
        if not np.array_equal(F.indices, np.union1d(schur.interior, held)):
            return None
        among = np.isin(F.indices, schur.interior)

        def solve(right: FloatArray) -> FloatArray:
            x = np.zeros_like(right)
            x[among] = schur.solve_interior(right[among])
            return x

        return solve, self.still.motions[F.indices]

    @property
    def schur(self) -> SchurComplement | None:
        """Schur complement of the stiffness in the system's own unknowns, if it exists already.

        Where bodies can move rigidly it has a small multiple of the mass.
        """
        return None if self.to.maps or self.whole is None else self.whole.schur

    @property
    def unshifted(self) -> SchurComplement | None:
        """The Schur complement of the stiffness alone, if it exists already."""
        return None if self.shift else self.schur

    def follow(
        self,
        forces: FloatArray,
        times: FloatArray | None = None,
        limit_share: float = 0.98,
    ) -> FloatArray:
        """Displacements (levels, n), m, from rest under forces (levels, n), N, one after another.

        With contact that opens, forces that friction and contact do not hold, because they lift a
        body off or slide it away, are followed as far as they are held, by Coulomb's law.

        Parameters
        ----------
        forces : ndarray, shape (levels, n)
        times : ndarray, shape (levels,), optional
            When each level is reached, s, from 0: the system's own law acts, which creeps.
            Coulomb's, which time does not matter to, if not given, and with contact that opens.
        limit_share : float
            Where friction alone holds, forces that would make everything slip are scaled to this
            share of what friction can hold; ``inf`` leaves them as they are.

        Raises
        ------
        ConvergenceError
            If a level does not converge, or what friction can hold is not found.
        """
        right = self.to.force(forces.T)
        if self.opens:
            return self.to.outer(self._as_far_as_held(right.T))
        lasting = None if times is None else np.diff(times, prepend=0.0)
        return self.to.outer(
            self._followed(right, lasting, limit_share, self.rest(), 0.0 * right[:, 0])
        )

    def _followed(
        self,
        right: FloatArray,
        lasting: FloatArray | None,
        limit_share: float,
        start: Level,
        f: FloatArray,
    ) -> FloatArray:
        """Displacements (levels, n), m, under forces (n, levels), N, with constant limits.

        They go on from a level under the forces ``f``, (n,), N, and last some time each, s.
        """
        inside, u = self.condensed, start.u
        if inside is not None:
            right, interior = inside.restrict(right)
            u, f = u[inside.kept], inside.restrict(f)[0]
        self.friction, count = start.friction, right.shape[1]
        self.frictions = np.zeros((count, self.friction.size))
        path = np.empty((count, u.size))
        rate = np.full(self.beta.size, np.inf)
        for level, force in enumerate(right.T):
            before, f = f, np.ascontiguousarray(force)
            if lasting is not None:
                rate = self.beta / lasting[level]
            u = path[level] = self._state(u, before, f, limit_share, rate)
            self.frictions[level] = self.friction
            self.tally.add()
        return path if inside is None else np.asarray(inside.extend(path.T, interior).T)

    def walk(self, last: Level, force: FloatArray, multiples: FloatArray) -> list[Walk]:
        """Ways from level to level under multiples of a force (n,), N, by Coulomb's law.

        Parameters
        ----------
        last : Level
            Level to go on from, under the first of the ``multiples``.
        force : ndarray, shape (n,)
            In the unknowns of ``to.system``.
        multiples : ndarray, shape (ways + 1,)

        Returns
        -------
        list of Walk
            Of each way its level, after those of its parts, where it is not reached at once.

        Raises
        ------
        ConvergenceError
            If a level does not exist, or is not found.
        """
        if self.still is not None:
            return self._in_contact().walk(last, force, multiples)
        if not self.opens and not self.shift:  # all at once
            right = np.outer(force, multiples[1:])
            states = self._followed(right, None, np.inf, last, multiples[0] * force)
            slips = np.asarray((self.to.system.contact.B @ states.T).T)
            levels = map(Level, states, self.frictions, slips)
            return [[one] for one in zip(multiples[1:].tolist(), levels, strict=True)]
        ways, along = list[Walk](), 1.0 / float(force @ force)
        for a, b in pairwise(multiples.tolist()):
            parts = in_parts(self.next, last, a * force, b * force)
            ways.append([(float(load @ force) * along, level) for load, level in parts])
            last = ways[-1][-1][1]
            self.tally.add()
        return ways

    def rest(self) -> Level:
        """Level without loads, from which a run starts."""
        inner = self.to.system
        rows = np.zeros(inner.contact.B.shape[0])
        normal = (inner.contact.w, self.contact.force) if self.opens else ()
        return Level(np.zeros(inner.n), rows, rows, *normal)

    def next(self, last: Level, force: FloatArray) -> Level:
        """Level under ``force``, (n,), N, after the level ``last``.

        NoLevelError if it does not exist, or was not found.
        """
        if self.still is not None:
            return self._in_contact().next(last, force)
        change = self._change(last, force)
        try_first = self._creeping if self._creeps else self._increment
        found, level, carried = try_first(last, force, self._guess(last, change))
        before = np.inf
        for _ in range(40):  # until the added mass carries nothing
            stays, constant = carried > 0.5 * before, not self.opens
            # With constant limits one more increment costs little.
            if carried <= (1e-12 if constant and not stays else 1e-9):
                break
            if stays and constant:
                if (limit := self._known_limit(force)) <= 1.0:  # friction does not take it over
                    raise self._beyond(limit)
                break
            before = carried
            found, level, carried = self._increment(last, force, found.v, carried)
        else:
            raise self._beyond(self._known_limit(force))
        return level._replace(moved=found.v, work=float(change @ found.v))

    def _change(self, last: Level, force: FloatArray) -> FloatArray:
        """Change of the forces from a level to ``force``, (n,), N: what does not balance yet."""
        if self.opens:
            normal = self.contact.force - cast("FloatArray", last.normal)
            force = force + self.contact.N.T @ normal
        return np.asarray(force - self.K @ last.u - self._slips @ last.friction)

    @cached_property
    def _slips(self) -> Matrix:
        """Transposed slip rows, which scipy would make anew for each level, (n, rows)."""
        return as_compressed(self.to.system.contact.B.T)

    def _added_force(self, d: FloatArray) -> FloatArray:
        """Force of the added mass under a displacement, (n,), N."""
        return self.shift * (self.M @ d) if self.shift else np.zeros_like(d)

    def _guess(self, last: Level, change: FloatArray) -> FloatArray | None:
        """Guess of the increment under a change of the forces (n,), N, from that before.

        It grows with the change, and is none where the load turns round: what slips one way is no
        guess of what will slip the other way. Points of a bar of 100 do not come to rest from it.
        """
        if last.moved is None or self.to.kind == "chain":  # elimination starts from rest
            return None
        work = float(change @ last.moved)
        # It is guessed twice as long as the one before at most.
        longer = min(work / last.work, 2.0) if work > 0.0 < last.work else 0.0
        return np.asarray(longer * last.moved)

    def _increment(
        self, last: Level, force: FloatArray, start: FloatArray | None, carried: float = 0.0
    ) -> tuple[Minimum, Level, float]:
        """Minimum of an increment from a level, and the level after it under ``force``, (n,), N.

        Also returns the share of the largest force that the added mass carries. Where it has
        ``carried`` one on the way to ``start``, what it carries there is given back: so repeated,
        this is the proximal point method for the increment without added mass.
        """
        system, contact, pressed = self.to.system, self.contact, None
        right, rate = force - self.K @ last.u, np.full(system.contact.w.size, np.inf)
        if self.opens:
            right = force + contact.N.T @ contact.force - self.K @ last.u
            bound, soft = contact.gaps(last.u), ~contact.rigid
            bound[soft] -= contact.force[soft] / contact.stiffness[soft]
            pressed = Pressed(bound, system.contact.given, touching=self.touching)
            if self._creeps:
                rate = np.where(system.contact.sprung, np.inf, 1.0 / self.creep)
        offset = system.contact.spring_offset(np.zeros(system.n), last.friction)
        problem: StepProblem = self.whole or self.problem
        tolerance, given_back = self.tolerance, np.zeros(system.n)
        if carried and start is not None:
            # The share that the added mass carried is found to a hundredth.
            tolerance, given_back = min(tolerance, 1e-2 * carried), start
        right = right + self._added_force(given_back)
        found = problem.minimise(right, start, tolerance, rate, offset, pressed)
        self._count(found.counts)
        carrying = self._added_force(found.v - given_back)[~self.holds]
        added = float(np.abs(carrying).max(initial=0.0))
        other = found.p if self.opens else right
        largest = float(max(np.abs(force).max(), np.abs(other).max(initial=0.0)))
        before, carried = carried, added / largest if largest > 0.0 else 0.0
        if not found.converged:
            # Where the structure is not held what is left is round-off of motions of kilometres.
            nearly = found.residual <= 1e-3 * np.abs(right).max()
            if nearly and (carried > _CARRIED or carried > 0.5 * before > 0.0):
                raise self._beyond(self._known_limit(force))
            unknown = self.to.outer_number(max(found.where, 0))
            raise NoLevelError(
                f"a force residual of {found.residual:.3g} N is left at unknown {unknown}", unknown
            )
        u, slip = last.u + found.v, np.asarray(system.contact.B @ (last.u + found.v))
        limits = found.w if self.opens else system.contact.w
        level = Level(u, system.contact.on_rows(limits) * found.sigma, slip)
        if self.opens:
            self.touching.follow(found.p)
            level = level._replace(limits=found.w, normal=found.p)
        return found, level, carried

    def _creeping(
        self, last: Level, force: FloatArray, start: FloatArray | None
    ) -> tuple[Minimum, Level, float]:
        """As `_increment`, with a law steep enough for points that stick to hardly creep."""
        system, change = self.to.system, self._change(last, force)
        contact = self.contact

        def slip(d: FloatArray) -> float:
            return float(
                system.contact.slip_norm(np.asarray(system.contact.B @ d)).max(initial=0.0)
            )

        unknown = not self.largest_slip
        if unknown:  # that without friction is no less
            held = self.A + as_dense(contact.springs)
            self.largest_slip = slip(np.linalg.solve(held, change)) or 1.0
        for _ in range(10):  # steeper laws at most
            found, level, carried = self._increment(last, force, start)
            size = slip(found.v)
            # The law is steep enough where friction does so little of the work of the loads.
            idle = found.w.sum() * size <= 1e-8 * abs(float(change @ found.v))
            if not unknown or idle or size >= _SMALLER * self.largest_slip:
                break
            self.largest_slip *= _SMALLER
            start = found.v
        self.largest_slip = max(self.largest_slip, size)
        return found, level, carried

    def _count(self, work: Mapping[str, int]) -> None:
        """Add the work of an increment."""
        for name, number in work.items():
            self._counts[name] = self._counts.get(name, 0) + number
        most = "largest_iterations"
        self._counts[most] = max(self._counts.get(most, 0), work.get("newton_iterations", 0))

    def _as_far_as_held(self, forces: FloatArray) -> FloatArray:
        """Displacements (levels, n), m, under forces (levels, n), N, as far as these are held."""
        last, before = self.rest(), np.zeros(self.to.system.n)
        states = np.empty(forces.shape)
        for k, force in enumerate(forces):
            last, before = self._reached(last, before, force)
            states[k] = last.u
            self.tally.add()
        return states

    def _reached(
        self, last: Level, before: FloatArray, force: FloatArray
    ) -> tuple[Level, FloatArray]:
        """Level on the way to ``force`` from that under ``before``, and the forces of it, N.

        Where the whole way is not held, a bisection finds how much of it is.
        """
        held, lost, tried = 0.0, 1.0, 1.0
        start, change = before, force - before
        for _ in range(1 + HELD):
            aim = start + tried * change
            try:
                for _, level in in_parts(self.next, last, before, aim):
                    self.solves += 1
                    last = level
            except NoLevelError as error:
                if not error.beyond:
                    raise ConvergenceError(
                        "reduced model: its path under slowly changing loads was not found: "
                        f"{error}"
                    ) from error
                lost = tried
            else:
                held, before = tried, aim
                if held == 1.0:
                    return last, before
            tried = 0.5 * (held + lost)
        self.scaled_back += 1
        return last, before

    def _known_limit(self, force: FloatArray) -> float:
        """Multiple of forces (N) that supports and friction can just hold; 0 if it is not known."""
        if self.opens or not self.to.system.contact.count:
            return 0.0
        try:
            return self.afresh(Arranged(self.to.system, self.to.kind)).limit(force)
        except ConvergenceError:
            return 0.0

    def _beyond(self, limit: float) -> NoLevelError:
        """Error for a level that does not exist, by the multiple of its loads that is held."""
        if self.opens:
            return NoLevelError(NOT_HELD, beyond=True)
        if limit <= 0.0:
            return NoLevelError(
                "neither a support nor friction holds the structure against the loads", beyond=True
            )
        return NoLevelError(
            f"the loads are {1.0 / limit:.6g} times what supports and friction hold: the "
            "structure slides",
            beyond=True,
        )

    def limit(self, force: FloatArray) -> float:
        """Multiple of the forces (N) that friction can just hold; ``inf`` where supports hold.

        ConvergenceError if the search for it does not end.
        """
        if not self.shift:
            return np.inf
        f = self.to.force(force)
        if self.still is not None:
            return self._in_contact().limit(f)
        if self.condensed is not None:
            f = self.condensed.restrict(f)[0]
        return self._limit(f, np.full(self.beta.size, np.inf))

    def _state(
        self,
        u: FloatArray,
        before: FloatArray,
        f: FloatArray,
        limit_share: float,
        rate: FloatArray,
        halvings: int = 0,
    ) -> FloatArray:
        """Displacement under ``f`` from ``u`` under the forces ``before``, in parts if need be.

        ``rate`` is the law's steepness for increments of displacement, 1/m, of each point.
        """
        increment = self._minimise(f - self.stiffness @ u, rate, self.friction)
        if np.isfinite(limit_share) and self._carried(increment, f) > _CARRIED:
            self.scaled_back += 1
            right = min(1.0, limit_share * self._limit(f, rate)) * f - self.stiffness @ u
            increment = self._minimise(right, rate, self.friction)
            halvings = _HALVINGS  # scaled back, the load has no path to follow in parts
        if not increment.converged and halvings < _HALVINGS:
            middle = 0.5 * (before + f)
            rest = (limit_share, 2.0 * rate, halvings + 1)
            return self._state(self._state(u, before, middle, *rest), middle, f, *rest)
        if not increment.converged:
            where = (
                increment.where if self.condensed is None else self.condensed.kept[increment.where]
            )
            raise ConvergenceError(
                "the slip under a slowly changing load was not found: a force residual of "
                f"{increment.residual:.3g} N is left at unknown {where}"
            )
        self.last = increment.v
        limits = self.to.system.contact.on_rows(self.to.system.contact.w)
        self.friction = np.zeros_like(limits)
        self.friction[self.acting] = limits[self.acting] * increment.sigma
        return u + increment.v

    def _minimise(
        self, right: FloatArray, rate: FloatArray, friction: FloatArray | None = None
    ) -> Minimum:
        """Increment, from the multiple of the last one that is best under Coulomb's law.

        ``friction`` is that before it, (rows,), N; none if not given.
        """
        self.solves += 1
        problem, inner, work = self.problem, self.to.system, float(right @ self.last)
        before = np.zeros_like(self.friction) if friction is None else friction
        offset = inner.contact.spring_offset(np.zeros(inner.n), before)
        offset = None if offset is None else offset[self.acting]
        law = rate, offset
        if self.to.kind == "chain" and np.isinf(rate).all():  # elimination starts from rest
            return problem.minimise(right, None, self.tolerance, *law)
        stored = float(self.last @ (self.A @ self.last))
        at_rest = problem.points.potential(0.0 * self.last, *law)
        lost = problem.points.potential(self.last, *law) - at_rest
        start = self.last * (np.sign(work) * max(abs(work) - lost, 0.0) / stored if stored else 0.0)
        if problem.objective(start, right, *law) < at_rest:
            return problem.minimise(right, start, self.tolerance, *law)
        return problem.minimise(right, None, self.tolerance, *law)

    def _carried(self, increment: Minimum, f: FloatArray) -> float:
        """Share of the load that the added mass carries."""
        force = float(np.linalg.norm(f))
        if not self.shift or not force > 0.0:  # friction holds what was held
            return 0.0
        return float(np.linalg.norm(self.added @ increment.v)) / force

    def _least_of_rigid(self, f: FloatArray) -> tuple[float, bool]:
        """Smallest sum w |B d| / f d found among rigid motions d, and whether it is the least.

        Repeated least squares with weights w / |B d|; each lowers the sum. It is ``inf`` where the
        forces set off no rigid motion. It is not the least where there may be more motions.
        """
        rigid = self.rigid if self.condensed is None else self.rigid[self.condensed.kept]
        work, system = f @ rigid, self.to.system
        if not pushes(f, rigid).any():
            return np.inf, rigid.shape[1] < _MOST_RIGID
        slips, weight, least = np.asarray(self.B @ rigid), system.contact.w, np.inf
        for _ in range(LEAST_SQUARES):
            square = slips.T @ (system.contact.on_rows(weight)[:, np.newaxis] * slips)
            d = linalg.lstsq(square, work)[0]
            if not work @ d > 0.0:
                break
            slip = system.contact.slip_norm(slips @ d) / float(work @ d)
            before, least = least, min(least, float(system.contact.w @ slip))
            if least >= before * (1.0 - 1e-9):
                return least, rigid.shape[1] < _MOST_RIGID
            weight = system.contact.w / np.maximum(slip, STILL * slip.max())
        return least, False

    def _limit(self, f: FloatArray, rate: FloatArray) -> float:
        """Multiple of the forces at which everything slips; ConvergenceError as `limit`."""
        (limit, least), inner = self._least_of_rigid(f), self.to.system
        if least:
            return limit
        multiple = 1.01 * limit if np.isfinite(limit) else 1.0
        without_friction = self._without_friction()
        for _ in range(LIMIT_ITERATIONS):
            increment = self._minimise(multiple * f, rate)
            if self._carried(increment, multiple * f) <= _CARRIED:
                if np.isfinite(limit):
                    return limit
                if multiple > 1e6:
                    return np.inf
                multiple *= 10.0
                continue
            slip = without_friction(self.added @ increment.v)  # the rigid part of it
            lower = float(inner.contact.w @ inner.contact.slip_norm(self.B @ slip) / (f @ slip))
            if lower >= limit * (1.0 - 1e-6):
                return limit
            limit, multiple = lower, 1.01 * lower
        raise ConvergenceError(
            f"what friction can hold was not found in {LIMIT_ITERATIONS} iterations: the "
            f"limit is at most {limit:.6g} of the forces, and may be lower"
        )


class _Alone:
    """Levels of a structure that floats, found in the unknowns that its problem keeps.

    These are those of the contact, and some that hold motions in which nothing slips. What is added
    to the stiffness acts on them alone, so that to repeat a level takes no solution with the factor
    of the others; all displacements of some levels follow from one with as many right sides.
    """

    def __init__(self, outer: QuasiStatic) -> None:
        self.path, self.still = outer.of_kept(), cast("Still", outer.still)
        self.schur = cast("CondensedNewton", outer.whole).schur
        self._force: tuple[FloatArray, FloatArray, FloatArray] | None = None

    def restricted(self, force: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Forces on the kept unknowns, N, and what `extend` needs; kept for the last force."""
        if self._force is None or not np.array_equal(self._force[0], force):
            self._force = force.copy(), *self.schur.restrict(force)
        return self._force[1:]

    def level(self, last: Level) -> Level:
        """A level in the kept unknowns."""
        kept = self.schur.kept
        moved = None if last.moved is None else last.moved[kept]
        return last._replace(u=last.u[kept], moved=moved)

    def limit(self, f: FloatArray) -> float:
        """Multiple of the forces that friction can just hold."""
        if self.still.pushed(f):
            return 0.0
        if not self.still.sliding.size:
            return np.inf
        return self.path._limit(self.restricted(f)[0], np.full(self.path.beta.size, np.inf))

    def next(self, last: Level, force: FloatArray) -> Level:
        """See `QuasiStatic.next`."""
        if self.still.pushed(force):
            raise self.path._beyond(0.0)
        f, interior = self.restricted(force)
        level = self.path.next(self.level(last), f)
        u = self.still.placed(self.schur.extend(level.u, interior))
        return level._replace(u=u, moved=u - last.u)

    def walk(self, last: Level, force: FloatArray, multiples: FloatArray) -> list[Walk]:
        """See `QuasiStatic.walk`."""
        if self.still.pushed(force):
            raise self.path._beyond(0.0)
        f, interior = self.restricted(force)
        ways = self.path.walk(self.level(last), f, multiples)
        found = [one for way in ways for one in way]
        kept = np.column_stack([level.u for _, level in found])
        beside = np.outer(interior, [share for share, _ in found])
        states = self.still.placed(self.schur.extend(kept, beside)).T
        moved = np.diff(states, axis=0, prepend=last.u[np.newaxis])
        whole = iter(
            [
                (share, level._replace(u=u, moved=d))
                for (share, level), u, d in zip(found, states, moved, strict=True)
            ]
        )
        return [[next(whole) for _ in way] for way in ways]


def factors_at_rest(system: System) -> QuasiStatic | None:
    """Quasi-static response of a system, for all passes that need its factors.

    None where they are not needed, because no load or no friction acts, or cannot be had: whoever
    then asks for a quasi-static response gets the reason as an error.
    """
    if not system.contact.count or not any(np.any(load.vector) for load in system.loads):
        return None
    try:
        return QuasiStatic(system)
    except (JointError, RuntimeError, np.linalg.LinAlgError):
        return None
