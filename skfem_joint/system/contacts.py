"""`Contact`: the contact points of a system, with friction and, where faces open, normal forces.

The rows of B take the slips of the contact points from the unknowns, those of N the approaches of
the faces at pressure points (:mod:`skfem_joint.system.normal`). With normal forces p, the friction
limits are

    w = max(0, given + gain p),

in which ``given`` belongs to joints whose normal force is constant. Constant contact is one whose N
has no rows. A friction point may have a spring in series, see :mod:`skfem_joint.minimise.law`.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from skfem_joint.ground.arrays import (
    BoolArray,
    FloatArray,
    IntArray,
    Matrix,
    as_dense,
    make_real,
    slip_norms,
    wrong_shapes,
)
from skfem_joint.ground.errors import refuse
from skfem_joint.ground.values import BETA, check
from skfem_joint.system.normal import NormalPart

_NO_NORMAL = NormalPart.none(0)  #: where no normal part is given


@dataclass(frozen=True)
class Contact:
    """Contact points on the n unknowns of a system.

    ``given`` may be a list, ``beta`` a number for all points.

    Attributes
    ----------
    B : ndarray or sparse array, shape (rows, n)
        Slip operator: slip velocity of each contact point from the velocities, one row for each
        direction of slip; the rows of a point follow each other.
    given : ndarray, shape (m,)
        Friction limit of each contact point, N, without that of normal forces that change.
    beta : ndarray, shape (m,)
        Steepness of the law of friction of each point, s/m; ``inf`` is Coulomb.
    directions : ndarray of int, shape (m,)
        Directions in which each contact point can slip, 1 or 2; all 1 if not given. The friction
        force of a point with two is opposite to its slip vector and depends on the norm of it.
    stiffness : ndarray, shape (m,)
        Of the spring in series with the friction of each contact point, N/m; ``inf``, which is
        none, at all points if not given.
    normal : NormalPart
        Pressure points of contact that opens and closes; without any if not given.
    gain : sparse array, shape (m, q)
        Friction limit of each contact point by the normal force of each pressure point.
    J : ndarray or sparse array, shape (joints, m)
        Share of each named joint in the friction of each contact point.
    joints : tuple of str
        Names of the rows of ``J``; without both, all contact points are one joint.
    shares : sparse array, shape (m, m_all), or None
        Share of each contact point of the structure in each contact point of a reduced model, which
        are weighted means of these; rows add up to 1. None where both are the same points.

    Raises
    ------
    InputError
        For shapes that do not fit, negative limits and gains, and a beta or a stiffness that is not
        positive.
    """

    B: Matrix
    given: FloatArray
    beta: FloatArray
    directions: Any = None
    stiffness: Any = None
    normal: NormalPart = _NO_NORMAL
    gain: Matrix = None
    J: Matrix = None
    joints: tuple[str, ...] = ()
    shares: Matrix = None

    def __post_init__(self) -> None:
        make_real(self, ("B", "given", "beta", "stiffness", "gain", "J", "shares"))
        given, beta = (np.asarray(x, dtype=float) for x in (self.given, self.beta))
        m, n = given.size, self.B.shape[-1]
        rigid = self.stiffness is None or bool(np.isinf(self.stiffness).all())
        normal = NormalPart.none(n) if self.normal is _NO_NORMAL else self.normal
        opens = normal.gap.size > 0 and self.gain is not None
        completed = {
            "given": given,
            "beta": np.full(m, float(beta)) if beta.ndim == 0 else beta,
            "stiffness": np.full(m, np.inf) if rigid else self.stiffness,
            "directions": np.ones(m, np.int64) if self.directions is None else self.directions,
            "normal": normal,
            "gain": self.gain if opens else sparse.csr_array((m, normal.gap.size)),
            "J": sparse.csr_array(np.ones((min(m, 1), m))) if self.J is None else self.J,
            "joints": ("contact",) * min(m, 1) if self.J is None else self.joints,
        }
        for name, value in completed.items():
            object.__setattr__(self, name, value)
        refuse(self._problems(m, n))

    def _problems(self, m: int, n: int) -> Iterable[str]:
        """What is wrong with shapes and values for m points and n unknowns."""
        if self.directions.shape != (m,) or not np.isin(self.directions, (1, 2)).all():
            yield f"directions: must be 1 or 2 for each of the {m} contact points"
            return
        shapes = {"B": (int(self.directions.sum()), n), "given": (m,), "beta": (m,)}
        shapes |= {"stiffness": (m,), "gain": (m, self.normal.gap.size)}
        shapes["J"] = (len(self.joints), m)
        if self.shares is not None:
            shapes["shares"] = (m, self.shares.shape[1])
        yield from wrong_shapes({name: (getattr(self, name), shapes[name]) for name in shapes})
        gain = self.gain.data if sparse.issparse(self.gain) else self.gain
        for values, what in ((self.given, "given: friction limits"), (gain, "gain:")):
            if np.any(~np.isfinite(values)) or np.any(values < 0.0):
                yield f"{what} must be finite and not negative"
        if np.any(~(self.beta > 0.0)):
            yield "beta: must be positive (inf for Coulomb)"
        if np.any(~(self.stiffness > 0.0)):
            yield "stiffness: must be positive (inf for no spring)"
        yield from self.normal.problems(n)

    @staticmethod
    def none(n: int) -> Contact:
        """Without contact points, for ``n`` unknowns."""
        return Contact(sparse.csr_array((0, n)), np.zeros(0), np.zeros(0))

    # Friction limits

    @cached_property
    def w(self) -> FloatArray:
        """Friction limits of the contact points at rest, (m,), N."""
        return self.limits(self.normal.force)

    def limits(self, p: FloatArray) -> FloatArray:
        """Friction limits, (m, ...), N, under normal forces (q, ...), N."""
        limits = (self.gain @ p).T + self.given
        return np.asarray(np.maximum(limits, 0.0).T)

    @property
    def opens(self) -> bool:
        """Whether there are pressure points."""
        return bool(self.normal.gap.size > 0)

    @cached_property
    def follows(self) -> BoolArray:
        """Whether each friction limit, (m,), follows normal forces."""
        return np.asarray(np.diff(sparse.csr_array(self.gain).indptr) > 0)

    @cached_property
    def rubs(self) -> BoolArray:
        """Whether each contact point can carry friction, (m,), now or when it is pressed."""
        return np.asarray((self.given > 0.0) | self.follows)

    @property
    def count(self) -> int:
        """Number of contact points that can carry friction."""
        return int(np.count_nonzero(self.rubs))

    # Joints

    @property
    def joint_points(self) -> list[IntArray]:
        """Numbers of the contact points with friction of each joint; none where it has no such.

        Joints may share points. Sums over a joint weigh its points by its share in them, ``J``, as
        `limits_by_joint` does, so that a point that joints share is counted once in all.
        """
        parts = (as_dense(self.J) > 0.0) & self.rubs
        return [np.flatnonzero(part) for part in parts]

    @property
    def limits_by_joint(self) -> FloatArray:
        """Part of each joint in the friction limit of each contact point, (joints, m), N."""
        return np.asarray(as_dense(self.J) * self.w)

    def least_share(self, points: BoolArray) -> float:
        """Least share of a joint's friction limit that some contact points, (m,), have; at most 1.

        Joints without a limit do not count.
        """
        limits = self.limits_by_joint
        limits = limits[limits.any(axis=1)]
        own = np.where(points, limits, 0.0).sum(axis=1)
        return float((own / limits.sum(axis=1)).min(initial=1.0))

    @property
    def point_weights(self) -> FloatArray:
        """Weights of contact points in means over their joints, (m,): friction limits at rest, N.

        Points of a joint that is pressed nowhere at rest have the weight 1.
        """
        J = sparse.csr_array(self.J)
        weightless = (J @ self.w == 0.0) @ (J > 0.0)
        return np.where((weightless > 0) & self.rubs, 1.0, self.w)

    def slid(self, friction_work: FloatArray) -> FloatArray:
        """Slip of each point in a cycle, (..., m), m: a quarter of the way that friction works on.

        Slip that remains from before the cycle does not count. Where limits follow normal forces
        the way is taken under those at rest. ``friction_work``, (..., m), J, is that of the cycle.
        """
        w = self.point_weights
        way = np.divide(friction_work, w, out=np.zeros_like(friction_work), where=w > 0.0)
        return np.asarray(0.25 * way)

    # Rows of B

    @property
    def first_row(self) -> NDArray[np.int64]:
        """First row of ``B`` of each contact point, and the number of rows at the end, (m + 1,)."""
        return np.concatenate([[0], np.cumsum(self.directions)])

    def on_rows(self, values: NDArray[Any]) -> NDArray[Any]:
        """Repeat a value of each contact point for each of its rows of ``B``."""
        return np.repeat(values, self.directions)

    def by_point(self, values: FloatArray) -> FloatArray:
        """Sum values of the rows of ``B``, (..., rows), over the rows of each point, (..., m)."""
        if values.shape[-1] == self.w.size:
            return values
        return np.asarray(np.add.reduceat(values, self.first_row[:-1], axis=-1))

    def slip_norm(self, slip: FloatArray) -> FloatArray:
        """Norm of the slip vector of each contact point, shape (..., m), from (..., rows)."""
        return slip_norms(slip, self.directions)

    # Springs in series with friction

    @cached_property
    def sprung(self) -> BoolArray:
        """Whether each contact point, (m,), has friction with a spring in series."""
        return np.asarray(np.isfinite(self.stiffness) & self.rubs)

    @cached_property
    def has_springs(self) -> bool:
        """Whether any point with friction has a spring in series."""
        return bool(self.sprung.any())

    @property
    def spring_constants(self) -> FloatArray:
        """Of the springs in series with friction, (m,), N/m; zero at points that have none."""
        return np.where(self.sprung, self.stiffness, 0.0)

    @cached_property
    def spring_matrix(self) -> Matrix:
        """Stiffness of all springs in series with friction, (n, n), N/m: sliders that stick."""
        return self.with_springs(self.spring_constants)

    def with_springs(self, stiffness: FloatArray) -> Matrix:
        """Stiffness, (n, n), N/m, of springs of a ``stiffness`` (m,) in series with friction."""
        k = self.on_rows(stiffness)
        if isinstance(self.B, np.ndarray):
            return np.asarray((self.B.T * k) @ self.B)
        B = sparse.csr_array(self.B)
        return sparse.csr_array(B.T @ sparse.diags_array(k) @ B)

    @cached_property
    def spring_flexibility(self) -> FloatArray:
        """Slip that each row's spring takes under a unit force, (rows,), m/N; 0 for none."""
        return self.on_rows(np.where(self.sprung, 1.0 / self.stiffness, 0.0))

    @cached_property
    def spring_stretch(self) -> FloatArray:
        """Slip that each row's spring takes under the friction limit, (rows,), m; 0 for none."""
        return self.on_rows(np.where(self.sprung, self.w / self.stiffness, 0.0))

    def spring_energy(self, sigma: FloatArray, limits: FloatArray | None = None) -> float:
        """Energy, J, stored in the springs in series with friction.

        ``sigma``, (rows,), is the friction over its limit, which in a spring in series is its
        force, and ``limits``, (m,), N, are these limits, those at rest if not given.
        """
        force = self.on_rows(self.w if limits is None else limits) * sigma
        return float(0.5 * force @ (force / self.on_rows(self.stiffness)))

    def spring_offset(
        self, known: FloatArray, force: FloatArray, moved: float = 1.0
    ) -> FloatArray | None:
        """Rate of slip in a step with which each spring would be without force at its end.

        Parameters
        ----------
        known : ndarray, shape (n,)
            Part of the step's change of displacement that is known, m.
        force : ndarray, shape (rows,)
            Friction before the step, N.
        moved : float
            Slip in the step for each unit of the unknown's, s; 1 where that is an increment.

        Returns
        -------
        ndarray, shape (rows,), or None
            m/s, or m; zero at points without springs. None where no point has one.
        """
        if not self.has_springs:
            return None
        slip = np.asarray(self.B @ known) + self.spring_flexibility * force
        return np.where(self.on_rows(self.sprung), -slip / moved, 0.0)

    def slider_slip(self, slip: FloatArray, sigma: FloatArray) -> FloatArray:
        """Slip of the sliders, m: that of the slip rows, (..., rows), less that of the springs.

        ``sigma``, (..., rows), is the friction over its limit.
        """
        left = slip - self.spring_stretch * sigma
        # Friction has the round-off of a solver, over its limit.
        return np.where(np.abs(left) > 1e-14 * self.spring_stretch, left, 0.0)

    def slider_peak(self, slip_peak: FloatArray) -> FloatArray:
        """Largest slip of each slider, (m,), m, from that of its point: what its spring leaves.

        Friction limits are those at rest; `Run.slider_peak` holds where they change, too.
        """
        return np.asarray(np.maximum(slip_peak - self.w / self.stiffness, 0.0))

    # Laws

    @property
    def steepest(self) -> float:
        """Largest steepness, s/m, of points without springs; ``inf`` where there are none."""
        if not self.has_springs:
            return float(self.beta.max(initial=0.0))
        rigid = (self.w > 0.0) & ~self.sprung
        return float(self.beta[rigid].max()) if rigid.any() else np.inf

    def no_steeper(self, beta: ArrayLike) -> Contact:
        """Contact whose points have at most the steepness ``beta`` (s/m), but for those on springs.

        Models with fewer unknowns than points cannot hold them; sliders on springs need not be
        held.
        """
        lower = np.minimum(self.beta, beta)
        return replace(self, beta=np.where(self.sprung, self.beta, lower))

    def with_beta(self, beta: float) -> Contact:
        """Contact whose points all have the steepness ``beta`` (s/m)."""
        check("beta", beta, BETA)
        return replace(self, beta=np.full(self.w.shape, float(beta)))

    def with_factors(self, factors: FloatArray) -> Contact:
        """Contact whose joints have other friction limits: theirs times ``factors``, (joints,).

        A factor acts on its joint's share of each point. Where contact opens it acts on what
        normal forces give, too.
        """
        if not factors.size:
            return self
        J = sparse.csr_array(self.J)
        of_points = 1.0 + (factors - 1.0) @ J
        known = np.where(of_points > 0.0, of_points, 1.0)
        shares = sparse.diags_array(factors) @ J @ sparse.diags_array(1.0 / known)
        gain = sparse.csr_array(sparse.diags_array(of_points) @ sparse.csr_array(self.gain))
        return replace(self, given=self.given * of_points, J=sparse.csr_array(shares), gain=gain)

    def pressed(self, factor: float) -> Contact:
        """Contact under another preload: forces, gaps and limits at rest times a factor."""
        normal = self.normal
        pressed = replace(normal, gap=factor * normal.gap, force=factor * normal.force)
        return replace(self, given=factor * self.given, normal=pressed)

    # Other unknowns

    def constant(self) -> Contact:
        """Contact with the friction limits at rest, whose normal forces do nothing."""
        normal = NormalPart.none(self.B.shape[1])
        return replace(self, given=self.w, normal=normal, gain=None)

    def in_unknowns(self, T: Matrix, B: Matrix = None) -> Contact:
        """Same contact in the unknowns q of u = T q; ``B`` is the slip operator there, if known."""
        return replace(self, B=self.B @ T if B is None else B, normal=self.normal.in_unknowns(T))
