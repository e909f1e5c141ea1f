"""Newton's method for contact whose slips and approaches are unknowns.

Where normal forces are constant it is the truncated nonsmooth Newton method. The matrix is large
and sparse, or dense after condensation to the contact. The method (Graeser and Kornhuber, J.
Comput. Math. 27, 2009; Graeser and Sander, IMA J. Numer. Anal. 39, 2019) repeats two parts until
the forces balance:

1. contact points are relaxed in turn, each with its law solved exactly;
2. a Newton step on all points but those that stick by Coulomb friction, with an exact line search.
   If the search stops short, points whose slip would reverse are set to rest and the step is
   recomputed for the others, if that lowers the objective further: a single such point would block
   all others.

Each part lowers the objective, so that the iteration converges from any start for any beta.
Newton's systems are solved by conjugate gradients. The preconditioner is the factor of an earlier
tangent where the law acts as it did then, and the diagonal where it does not; that factor serves
for several iterations.

Measured for each time step, on a plate in contact over 40 % of its surface (half of the friction
limit, 200 steps a period, beta = 1e5, 3,960 unknowns; ``examples/benchmarks/plates.py``):

========== ====================================== ============ ====== =======
sweeps     factor                                 Newton steps solves factors
========== ====================================== ============ ====== =======
none       new for each Newton step                        6.8    9.2     7.2
four       new for each Newton step                        2.9    4.9     2.9
four       kept up to 6 solves and few changes             3.7   12.7     0.5
four       kept up to 10 solves                            4.2     33     0.1
========== ====================================== ============ ====== =======

The third row is used (`PATIENCE`): a factor costs as much as ten
solves where the matrix is a narrow band, and as thirty elsewhere.

Contact that opens has unknowns of its own, the approaches of its pressure points, which are relaxed
with all others. Those that press do not move in a Newton step, like points that stick. Friction
limits w follow the normal forces p then. That is no part of the minimisation (friction is not
associated): the solution is a fixed point of w -> p -> w. So sweeps take the limits of the forces
at hand, and Newton's tangent has the change of the limits by that of the forces, which makes it
unsymmetric: a dense LU factor, and no search. Points that would reverse, or pass their bounds, stop
there; the next sweeps repair what that disturbs. Where the residual does not fall,

- after two iterations, steps are made anew for the others when points stop;
- after eight, limits are kept until the convex problem for them is solved, by the
  method above, and then renewed, by Anderson's acceleration. That is a contraction as long as
  friction is not far above 1, and the acceleration replaces it where it is none.

Of 320 random problems whose stiffness varies over four decades, with friction 0.3, 1, 2 and 4, this
leaves 0, 0, 1 and 2 unsolved. Nothing is returned as converged whose forces do not balance with the
limits of its own normal forces.
"""

# mypy: allow-untyped-calls

from __future__ import annotations

from collections.abc import Callable
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse

from skfem_joint.ground.arrays import BoolArray, FloatArray, check_like
from skfem_joint.linalg.compressed import compressed_rows
from skfem_joint.linalg.factors import BlockFactors
from skfem_joint.linalg.kernels import Full, subtract_product, times
from skfem_joint.minimise.contact_loops import (
    CompiledContact,
    Limits,
    PointLine,
    Points,
    Pressing,
    add_blocks,
    coupled_tangent,
    friction_round_off,
    renew_limits,
    search_along,
    stop_on_the_way,
    subtract_bias,
    subtract_forces,
    sweep_over,
    tangent_blocks,
)
from skfem_joint.minimise.law import potential as law_potential
from skfem_joint.minimise.limits import Renewal
from skfem_joint.minimise.linearisation import Linearisation
from skfem_joint.minimise.problem import ROUND_OFF, ContactPoints, Minimum, Pressed, StepProblem

#: Most iterations where friction limits are given.
ITERATIONS = 100
#: Sweeps of relaxation in each iteration; measured in the module's docstring.
SWEEPS = 4
#: A new factor is made if a Newton step takes more solves than this.
PATIENCE = 6
# Forces, N, that count as none: products of smaller ones underflow.
_NOTHING = 1e-140
# Iterations in which the residual must halve, else limits are kept, see the module.
_STUCK = 8
# The convex problem is solved to this share of the residual that its limits leave.
_INNER = 0.1


class _Forces:
    """Forces of contact at some velocities, and the residual that they leave.

    Attributes
    ----------
    contact : CompiledContact
    friction : ndarray, shape (m, 2)
        Normalised.
    held : ndarray of bool, shape (n,)
        Unknowns that do not move now.
    p, slopes : ndarray, shape (q,) and (m,)
        Normal forces, N, and derivatives of the limits by them.
    left, r : ndarray, shape (n,)
        Residual without and with contact.
    residual, where
        Largest entry of ``r``, N, and its unknown.
    """

    def __init__(self, contact: CompiledContact, n: int) -> None:
        m = contact.points.w.size
        self.contact, self.friction = contact, np.zeros((m, 2))
        self.held = np.zeros(n, dtype=np.bool_)
        self.p, self.slopes = np.zeros(contact.pressing.place.size), np.zeros(m)

    def renew(self, v: FloatArray, r: FloatArray) -> None:
        """Normal forces, and the limits that follow; ``r`` is g - H v."""
        renew_limits(self.contact, v, r, self.p, self.slopes)

    def balance(self, v: FloatArray, r: FloatArray) -> None:
        """Set the residuals from that without contact, ``r``, under the present limits."""
        self.left = r
        if self.contact.limits.bias.size:
            self.left = r.copy()
            subtract_bias(self.contact, self.left)
        self.subtract(v, self.left.copy())

    def subtract(self, v: FloatArray, left: FloatArray) -> None:
        """Subtract the forces from ``left``, in place."""
        self.r = left
        residual, where = subtract_forces(self.contact, v, left, self.p, self.friction, self.held)
        self.residual, self.where = float(residual), int(where)


class _KeptLimits:
    """How the search goes on where friction limits follow normal forces, see the module.

    Attributes
    ----------
    limits : ndarray, shape (m,), or None
        That are kept; None where they follow.
    best, since : float and int
        Least residual, N, and iterations since it was halved.
    v, residual : ndarray and float
        Where the residual was least before limits were kept, and that residual.
    inner : float
        Residual, N, to which the convex problem is solved.
    renewed : int
        Times that limits were renewed.
    """

    def __init__(self) -> None:
        self.limits: FloatArray | None = None
        self.best, self.since, self.residual, self.inner, self.renewed = np.inf, 0, np.inf, 0.0, 0
        self.v, self.renewal = np.zeros(0), Renewal()


def _solved(J: FloatArray, right: FloatArray) -> FloatArray:
    """Solution x of J x = right, NaN where J is singular; overwrites ``J``, a C array.

    LAPACK itself: estimates of the condition, as in `scipy.linalg.solve`, take as long.
    """
    factor, pivots, info = linalg.lapack.dgetrf(J.T, overwrite_a=True)
    if info != 0:
        return np.full(right.size, np.nan)
    return np.asarray(linalg.lapack.dgetrs(factor, pivots, right, trans=1)[0])


class ContactNewton(StepProblem):
    """Newton's method for contact, see the module and `StepProblem`.

    Parameters
    ----------
    H : csr_array or ndarray, shape (n, n)
        Symmetric positive definite; dense where contact opens.
    points : ContactPoints
        Each row of ``B`` picks an unknown of its own; points with springs may share them. Each row
        of ``N`` picks one that is no slip.

    Attributes
    ----------
    first, second : ndarray of int, shape (groups + q,)
        Unknowns of each point with friction, or group of points that share them, and of the
        pressure points; ``second`` is -1 where there is a single direction.
    contact : CompiledContact
        The points with friction, sorted by groups, and the pressure points.
    kept : tuple of ndarray, or None
        Tangents, and the unknowns that stuck, of the factor that is kept; further solutions depend
        on them.
    """

    factorizations: int = 0

    def __init__(self, H: Any, points: ContactPoints) -> None:
        n = H.shape[0]
        self.H, self.points, self.dense = H, points, isinstance(H, np.ndarray)
        self.opens = points.normal is not None
        self.rows = Full(H) if self.dense else compressed_rows(H)
        self.kept: tuple[FloatArray, BoolArray] | None = None
        self.factor: Callable[[FloatArray], FloatArray] | None = None
        unknowns = np.append(points.unknowns, -1).astype(np.int64)
        first = unknowns[points.first_row[:-1]]
        second = np.where(points.directions == 2, unknowns[points.first_row[:-1] + 1], -1)
        order = np.argsort(first, kind="stable")
        self._order = order = order[self.opens | (points.w[order] > 0.0)]
        of_groups, start = np.unique(first[order], return_index=True)
        pairs = second[order][start]
        flexible = np.zeros(points.w.size) if points.flexible is None else points.flexible
        w, flexible = (np.array(x, dtype=float)[order] for x in (points.w, flexible))
        start, none = np.append(start, order.size).astype(np.int64), np.zeros(order.size)
        law = w, self.ordered_beta(points.beta), flexible, none, none
        laws, pressing = Points(of_groups, pairs, start, *law), self._pressing()
        self.contact = CompiledContact(laws, pressing, self._limits())
        self.first = np.concatenate([of_groups, pressing.place])
        self.second = np.concatenate([pairs, np.full(pressing.place.size, -1)])
        # Rows of these points, and which points have a second one.
        self._rows = points.first_row[:-1][order]
        self._pairs = np.flatnonzero(second[order] >= 0)
        self.both = self.second >= 0
        self.pairs = i, j = self.first[self.both], self.second[self.both]
        self.diagonal = diagonal = H.diagonal()
        self.added = np.zeros(n)
        self.stiff = diagonal[self.first]
        mean, half = 0.5 * (diagonal[i] + diagonal[j]), 0.5 * (diagonal[i] - diagonal[j])
        self.stiff[self.both] = mean + np.hypot(half, np.asarray(H[i, j]).ravel())
        rigid = flexible[start[:-1]] == 0.0
        self.limited = np.zeros(n, dtype=bool)  # unknowns that friction without springs acts on
        self.limited[of_groups[rigid]] = self.limited[pairs[rigid & (pairs >= 0)]] = True
        self.factors = BlockFactors(H, self.first, self.second)

    def ordered_beta(self, beta: FloatArray) -> FloatArray:
        """Steepness of the points with friction, in the order of ``first``, from that of all."""
        return np.array(beta, dtype=float)[self._order]

    def _pressing(self) -> Pressing:
        """Pressure points, without bounds, which each call has."""
        normal = self.points.normal
        if normal is None:
            return Pressing(np.zeros(0, dtype=np.int64), *np.zeros((2, 0)))
        place = sparse.csr_array(normal.N).indices.astype(np.int64)
        return Pressing(place, np.zeros(place.size), np.array(normal.stiffness, dtype=float))

    def _limits(self) -> Limits:
        """Gain of the normal forces, with nothing given, which each call is."""
        G = sparse.csr_array((0, 0))
        if (normal := self.points.normal) is not None:
            G = sparse.csr_array(sparse.csr_array(normal.gain)[self._order])
        gain = compressed_rows(G)
        arrays: list[Any] = [*7 * [np.zeros(0)], *gain]
        return Limits(*arrays)

    def linearisation(self, beta: FloatArray | None = None) -> Linearisation:
        """See `LinearisedProblem`."""
        return Linearisation(self.H, self.points.with_beta(beta))

    def compile(self) -> None:
        """See `StepProblem`."""
        x, y = np.zeros((2, self.H.shape[0]))
        friction, held = np.zeros((self.contact.points.w.size, 2)), np.zeros(x.size, dtype=np.bool_)
        none, block = self.first[:0], np.zeros((0, 3))
        p, blocks = np.zeros(self.contact.pressing.place.size), np.zeros((self.first.size, 3))
        subtract_product(self.rows, x, y)
        sweep_over(self.rows, self.contact, self.stiff, x, y, 0, False, False)
        subtract_forces(self.contact, x, y, p, friction, held)
        tangent_blocks(self.contact, self.stiff, x, blocks)
        search_along(PointLine(self.contact, x, y), 0.0, 1.0)
        friction_round_off(self.contact.points, x)
        add_blocks(none, none, block, x, y)
        law_potential(x[:0], x[:0])

    def minimise(
        self,
        g: FloatArray,
        start: FloatArray | None = None,
        tolerance: float = 1e-11,
        beta: FloatArray | None = None,
        offset: FloatArray | None = None,
        pressed: Pressed | None = None,
        force: float = 0.0,
    ) -> Minimum:
        """See `StepProblem`; the tolerance also refers to a ``force`` (N) on condensed unknowns."""
        contact = self.contact_of(beta, offset, pressed)
        if start is None:
            start = self._start(g, contact, force)
        return self._minimise(g, start, tolerance, contact, force)

    def contact_of(
        self,
        beta: FloatArray | None,
        offset: FloatArray | None,
        pressed: Pressed | None = None,
    ) -> CompiledContact:
        """Contact with the ``beta``, (m,), ``offset``, (rows,), and bounds of a call."""
        contact = self.contact
        points = contact.points
        if beta is not None:
            points = points._replace(beta=self.ordered_beta(beta))
        if offset is not None and np.any(points.flexible):
            y = np.zeros(points.w.size)
            y[self._pairs] = offset[self._rows[self._pairs] + 1]
            points = points._replace(x=np.array(offset[self._rows]), y=y)
        if pressed is None:
            return contact._replace(points=points)
        order, gain = self._order, contact.limits
        factors = np.broadcast_to(np.asarray(pressed.gain, dtype=float), pressed.bound.shape)
        none, given = np.full(order.size, np.inf), np.array(pressed.given[order], dtype=float)
        hinges, bias = [np.ones(order.size), *4 * [none]], np.zeros(0)
        if pressed.hinges is not None:
            *of_points, of_rows = pressed.hinges
            hinges = [np.array(x[order], dtype=float) for x in of_points]
            bias = np.zeros(self.diagonal.size)
            bias[self.points.unknowns] = of_rows
        value = gain.value * factors[gain.column]
        arrays: list[Any] = [given, *hinges, bias, gain.start, gain.column, value]
        limits = Limits(*arrays)
        bound = np.array(pressed.bound, dtype=float)
        points = points._replace(w=np.maximum(given, 0.0))
        return CompiledContact(points, contact.pressing._replace(bound=bound), limits)

    def _start(self, g: FloatArray, contact: CompiledContact, force: float) -> FloatArray:
        """Rough minimiser for a softer law; rest if that is better, or under Coulomb friction."""
        rest, points = np.zeros_like(g), contact.points
        if self.opens or np.isinf(points.beta).any():
            return rest
        # From there a plate with 20,000 unknowns under a load's peak takes 7 iterations, not 14.
        soft = contact._replace(points=points._replace(beta=1e-2 * points.beta))
        v = self._minimise(g, rest, 0.1, soft, force).v  # to this tolerance
        least = self._objective(rest, g, contact) if np.any(points.flexible) else 0.0
        return v if self._objective(v, g, contact) < least else rest

    def _minimise(
        self,
        g: FloatArray,
        start: FloatArray,
        tolerance: float,
        contact: CompiledContact,
        force: float,
    ) -> Minimum:
        scale, acts = self._scale(g, contact, force)
        v = start.copy() if acts else np.zeros_like(start)
        forces, kept = _Forces(contact, v.size), _KeptLimits()
        factorizations, evaluations, solves = self.factorizations, 0, 0
        converged = False
        r = g - times(self.H, v)
        # Limits that follow normal forces take more iterations.
        for iteration in range(200 if self.opens else ITERATIONS):
            follow, backward = self.opens and kept.limits is None, bool(iteration % 2)
            sweep_over(self.rows, contact, self.stiff, r, v, SWEEPS, backward, follow)
            r = self._balanced(v, g, forces)
            evaluations += SWEEPS + 1
            residual = forces.residual
            if not np.isfinite(residual):
                break
            converged = residual <= max(tolerance * scale, _NOTHING) or (
                residual <= 1e-6 * scale and residual <= self._round_off(v, g, contact)
            )
            if converged:
                break
            if self.opens:
                r = self._with_limits(kept, v, r, g, forces, tolerance * scale)
            if self.opens and kept.limits is None:
                r, more = self._coupled_step(v, r, forces, kept)
                solves += more
                continue
            r, more, trials = self._convex_step(v, r, g, forces)
            solves, evaluations = solves + more, evaluations + trials
        counts = {
            "newton_iterations": iteration,
            "friction_evaluations": evaluations,
            "linear_solves": solves,
            "factorizations": self.factorizations - factorizations,
        }
        if self.opens:
            counts["renewed_limits"] = kept.renewed
        return self._minimum(v, forces, bool(converged), counts)

    def _balanced(self, v: FloatArray, g: FloatArray, forces: _Forces) -> FloatArray:
        """Residual without contact, and ``forces`` at ``v``."""
        r = g - times(self.H, v)
        if self.opens:
            forces.renew(v, r)
        forces.balance(v, r)
        return r

    def _scale(self, g: FloatArray, contact: CompiledContact, force: float) -> tuple[float, bool]:
        """Force, N, to which a tolerance refers, and whether any acts, as springs and bounds do."""
        scale = max(float(np.abs(g).max()), force)
        sprung = bool(np.any(contact.points.x) or np.any(contact.points.y))
        acts = scale > _NOTHING or sprung or self.opens
        return max(scale, self._spring_force(contact)) if sprung else scale, acts

    def _minimum(
        self, v: FloatArray, forces: _Forces, converged: bool, counts: dict[str, int]
    ) -> Minimum:
        """Result of a minimisation that ended in ``v`` with some forces."""
        by_row, w = np.zeros(self.points.B.shape[0]), self.points.w
        by_row[self._rows] = forces.friction[:, 0]
        by_row[self._rows[self._pairs] + 1] = forces.friction[self._pairs, 1]
        if self.opens:
            w = np.zeros_like(w)
            w[self._order] = forces.contact.points.w
        return Minimum(v, by_row, converged, counts, forces.residual, forces.where, forces.p, w)

    def _objective(self, v: FloatArray, g: FloatArray, contact: CompiledContact) -> float:
        return float(v @ (0.5 * times(self.H, v) - g)) + self.potential(v, contact)

    def potential(self, v: FloatArray, contact: CompiledContact) -> float:
        """Of friction and elastic pressure points, W: sum w psi(|v_p|) + sum phi(v_c)."""
        points, (place, bound, stiffness) = contact.points, contact.pressing
        first, second = v[points.first], np.where(points.second < 0, 0.0, v[points.second])
        value = 0.0
        if place.size:
            over = np.maximum(v[place] - bound, 0.0)
            value = 0.5 * float(np.where(np.isinf(stiffness), 0.0, stiffness) @ over**2)
        if not np.any(points.flexible):
            return value + float(points.w @ law_potential(np.hypot(first, second), points.beta))
        count, soft = np.diff(points.start), points.w * points.flexible
        slip = np.hypot(np.repeat(first, count) - points.x, np.repeat(second, count) - points.y)
        return value + float(points.w @ law_potential(slip, points.beta, soft))

    def _spring_force(self, contact: CompiledContact) -> float:
        """Largest force of springs on an unknown at rest, N: a scale where no load acts."""
        forces = _Forces(contact, self.diagonal.size)
        if self.opens:  # their limits are not known: as if the sliders stuck
            points = contact.points
            stretch = np.hypot(points.x, points.y)
            flexible = np.where(points.flexible > 0.0, points.flexible, np.inf)
            return float((stretch / flexible).max())
        v, r = np.zeros((2, self.diagonal.size))
        forces.balance(v, r)
        return forces.residual

    # Where limits are given: the truncated Newton method

    def _convex_step(
        self, v: FloatArray, r: FloatArray, g: FloatArray, forces: _Forces
    ) -> tuple[FloatArray, int, int]:
        """Step in place; returns the residual without contact, and solves and evaluations.

        ``r`` is the same before the step, ``g`` the right side.
        """
        contact = forces.contact
        if forces.left is not r:  # friction beside its law is a known force
            g = g + (forces.left - r)
        d, along, length, solves, evaluations = self._newton_step(
            v, forces.left, forces.r, forces.held, contact
        )
        if length < 1.0 and (reverses := self._reverses(v, d)).any():
            stopped, more, trials = self._stopped(v, reverses, g, contact)
            solves, evaluations = solves + more, evaluations + trials + 2
            before = self._objective(v + length * d, g, contact)
            if self._objective(v + stopped, g, contact) < before:
                length, d, along = 1.0, stopped, times(self.H, stopped)
        v += length * d
        return r - length * along, solves, evaluations

    def _newton_step(
        self,
        v: FloatArray,
        left: FloatArray,
        r: FloatArray,
        held: BoolArray,
        contact: CompiledContact,
    ) -> tuple[FloatArray, FloatArray, float, int, int]:
        """Newton's direction d from ``v``, H d, and its length; solves and evaluations.

        ``left`` is g - H v, ``r`` the same less contact forces; unknowns in ``held`` rest.
        """
        tangents = np.zeros((self.first.size, 3))
        tangent_blocks(contact, self.stiff, v, tangents)
        r[held] = 0.0
        d, solves = self._newton_direction(r, tangents, held)
        if self.opens:
            place, bound, stiffness = contact.pressing
            ahead = np.where(np.isinf(stiffness), bound - v[place], np.inf)
            d[place] = np.minimum(d[place], ahead)
        along = times(self.H, d)
        line = PointLine(contact, v, d)
        length, evaluations = search_along(line, -float(d @ left), float(d @ along))
        return d, along, length, solves, evaluations

    def _reverses(self, v: FloatArray, d: FloatArray) -> BoolArray:
        """Unknowns of points whose slip would reverse along ``d``."""
        i, j = self.pairs
        turning = v * (v + d)
        turning[i] = turning[j] = turning[i] + turning[j]
        return np.asarray(self.limited & (turning < 0.0))

    def _stopped(
        self, v: FloatArray, reverses: BoolArray, g: FloatArray, contact: CompiledContact
    ) -> tuple[FloatArray, int, int]:
        """Step that sets slips which would reverse to rest, and is Newton's for the others.

        Also returns solves and evaluations.
        """
        stop = np.where(reverses, -v, 0.0)
        left, forces = g - times(self.H, v + stop), _Forces(contact, v.size)
        if self.opens:
            w = contact.points.w.copy()
            forces.renew(v + stop, left)
            contact.points.w[:] = w
        forces.subtract(v + stop, left.copy())
        held = forces.held | reverses
        d, _, length, solves, trials = self._newton_step(v + stop, left, forces.r, held, contact)
        return stop + length * d, solves, trials

    # Where limits follow normal forces

    def _with_limits(
        self,
        kept: _KeptLimits,
        v: FloatArray,
        r: FloatArray,
        g: FloatArray,
        forces: _Forces,
        enough: float,
    ) -> FloatArray:
        """Decide whether limits follow or are kept; forces are those under the limits then.

        ``enough``, N, is the residual at which all ends. Returns g - H v, which changes where the
        search goes on from an earlier point.
        """
        w, residual = forces.contact.points.w, forces.residual
        if kept.limits is None:
            if residual <= 0.5 * kept.best:
                kept.best, kept.since = residual, 0
            else:
                kept.since += 1
            if residual <= kept.residual:
                kept.v, kept.residual = v.copy(), residual
            if kept.since < _STUCK:
                return r
            v[:] = kept.v
            r = self._balanced(v, g, forces)
            kept.renewal, kept.limits = Renewal(), w.copy()
            kept.inner = _INNER * kept.residual
            return r
        own = w.copy()
        w[:] = kept.limits
        forces.balance(v, r)
        if forces.residual > max(kept.inner, 0.1 * enough):
            return r
        kept.renewed += 1
        kept.inner = _INNER * residual
        # Limits follow the normal forces again when those kept have brought the residual down so
        # far.
        if residual <= 1e-2 * kept.residual:
            kept.limits, kept.best, kept.since = None, residual, 0
            kept.v, kept.residual, w[:] = v.copy(), residual, own
        else:
            kept.limits = w[:] = kept.renewal.next(kept.limits, own)
        forces.balance(v, r)
        return r

    def _coupled_step(
        self, v: FloatArray, r: FloatArray, forces: _Forces, kept: _KeptLimits
    ) -> tuple[FloatArray, int]:
        """Newton step, in place, whose tangent has the change of the limits by normal forces.

        Points that would reverse or pass their bounds stop there. After stalls the step is made
        anew for the others. Returns g - H v, and solves.
        """
        contact, held = forces.contact, forces.held
        free = np.flatnonzero(~held)
        place, blocks = np.full(v.size, -1), np.zeros((self.first.size, 3))
        place[free] = np.arange(free.size)
        tangent_blocks(contact, self.stiff, v, blocks)
        J = np.empty((free.size, free.size))
        d, stopped = np.zeros_like(v), np.zeros(v.size, dtype=np.bool_)
        # Where the residual has not halved in two iterations the step is made anew twice at most.
        most, solves = 1 + 2 * (kept.since > 2), 0
        while solves < most:
            coupled_tangent(
                self.H, contact, blocks, v, forces.friction, forces.p, forces.slopes, free, place, J
            )
            right, known = forces.r[free], np.flatnonzero(stopped[free])
            if known.size:
                J[known] = 0.0
                J[known, known], right[known] = 1.0, d[free[known]]
            d[free] = _solved(J, right)
            self.factorizations += 1
            solves += 1
            if not stop_on_the_way(contact, v, d, stopped):
                break
        if not np.isfinite(d).all():
            kept.since = _STUCK  # the tangent is singular
            return r, solves
        v += d
        return r - times(self.H, d), solves

    @cached_property
    def sizes(self) -> Any:
        """Magnitudes of the entries of H, as large as H: few steps need them."""
        return abs(self.H)

    def _round_off(self, v: FloatArray, g: FloatArray, contact: CompiledContact) -> float:
        size = float(times(self.sizes, np.abs(v)).max()) + float(np.abs(g).max())
        size += float(friction_round_off(contact.points, v))
        return ROUND_OFF * size * (4.0 if self.opens else 1.0)

    def _newton_direction(
        self, r: FloatArray, tangents: FloatArray, sticking: BoolArray
    ) -> tuple[FloatArray, int]:
        """Solve (H + tangent) d = r on the unknowns that do not stick; also returns the solves.

        The kept factor is that of an earlier tangent: conjugate gradients correct for what has
        changed, until that takes longer than a new factor.
        """
        if not np.any(r):  # only sticking points are out of balance: relaxation will release them
            return np.zeros_like(r), 0
        # For up to so many moving unknowns of a dense system a new factor costs less than
        # iterations.
        if self.dense and (free := np.flatnonzero(~sticking)).size <= 512:
            self.factorizations += 1
            d = np.zeros_like(r)
            d[free] = self.factors.factorised(tangents, sticking)(r)[free]
            return d, 1
        solves = 0
        if self.factor is not None:
            d, solves, solved = self._conjugate_gradients(
                self.factor, r, tangents, sticking, PATIENCE
            )
            if solved:
                return d, solves
        solve = self.keep(tangents, sticking)
        d, more, _ = self._conjugate_gradients(solve, r, tangents, sticking, 60)  # at most
        return d, solves + more

    def keep(self, tangents: FloatArray, sticking: BoolArray) -> Callable[[FloatArray], FloatArray]:
        """Factorise H + tangent on the unknowns that do not stick, and keep that factor."""
        self.factorizations += 1
        self.kept = tangents.copy(), sticking.copy()
        self.factor = self.factors.factorised(tangents, sticking)
        self.added = np.where(sticking, np.inf, self._diagonal(tangents))
        return self.factor

    def forget(self) -> None:
        """Keep no factor, so that solutions do not depend on earlier ones."""
        self.kept = self.factor = None

    def _diagonal(self, tangents: FloatArray) -> FloatArray:
        """Diagonal of the points' blocks, by unknown."""
        diagonal = np.zeros(self.diagonal.size)
        diagonal[self.first], diagonal[self.pairs[1]] = tangents[:, 0], tangents[self.both, 2]
        return diagonal

    def _conjugate_gradients(
        self,
        solve: Callable[[FloatArray], FloatArray],
        r: FloatArray,
        tangents: FloatArray,
        sticking: BoolArray,
        most: int,
    ) -> tuple[FloatArray, int, bool]:
        """Direction, solves with the kept factor ``solve``, and whether they were enough."""
        now = self.diagonal + self._diagonal(tangents)
        then = self.diagonal + self.added
        # The factor where the tangent is as it was then, the diagonal where it is not.
        share = np.minimum(1.0, then / now)
        rest = (1.0 - np.minimum(share, now / then)) / now
        share[np.isinf(then)] = 0.0
        changed = np.where(sticking, np.isfinite(then), rest * now > 0.5)
        # If the diagonal of so many unknowns has halved or doubled the kept factor is not tried: of
        # 178 trials with more, 3 took no more than four solves.
        if np.count_nonzero(changed) >= 32:
            return r, 0, False
        share[sticking] = rest[sticking] = 0.0

        d, p, before = np.zeros_like(r), np.zeros_like(r), np.inf
        # Newton's systems are solved until their residual is this share of the right side.
        left, enough = r.copy(), 0.05 * np.linalg.norm(r)
        for solves in range(1, most + 1):
            z = share * solve(share * left) + rest * left
            product = float(left @ z)
            p = z + product / before * p
            before = product
            image = times(self.H, p)
            add_blocks(self.first, self.second, tangents, p, image)
            image[sticking] = 0.0
            step = product / float(p @ image)
            d += step * p
            left -= step * image
            if np.linalg.norm(left) <= enough:
                return d, solves, True
        return d, most, False

    def saved(self) -> dict[str, NDArray[Any]]:
        """See `StepProblem`."""
        names = "tangents", "sticking"
        return {} if self.kept is None else dict(zip(names, self.kept, strict=True))

    def check(self, saved: dict[str, NDArray[Any]]) -> None:
        """See `StepProblem`."""
        if not saved:
            return
        n, m = self.diagonal.size, self.first.size
        planned = {"tangents": np.zeros((m, 3)), "sticking": np.zeros(n, dtype=np.bool_)}
        check_like(saved, planned, "step problem")

    def restore(self, saved: dict[str, NDArray[Any]]) -> None:
        """See `StepProblem`; factorises again."""
        if saved:
            self.keep(saved["tangents"], saved["sticking"])
