"""`System`, the type of all models: full, condensed, reduced, and with merged friction points.

A system is the set of equations

    M a + C v + K u + B^T (w * sigma(B v)) = sum_k load_k amplitude_k(t)        (Eq. (1))

with displacements u, velocities v, accelerations a and friction sigma at slip rows B. Every map
between models takes a system and returns a system.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse

from skfem_joint.arrays import (
    BoolArray,
    FloatArray,
    IntArray,
    Matrix,
    as_dense,
    as_real,
    slip_norms,
)
from skfem_joint.errors import InputError, first_of, refuse
from skfem_joint.linalg.factors import pivots
from skfem_joint.linalg.shifts import mean_square_frequency
from skfem_joint.loads import Amplitude, as_amplitude
from skfem_joint.modes import RayleighFit, ratio_problems, rayleigh, rayleigh_fit
from skfem_joint.opening import OpeningContact, constant_contact_alone
from skfem_joint.served import Served
from skfem_joint.slips import SLIPPING_SHARE, WHOLE_SHARE, SlipRows
from skfem_joint.unknowns import (
    ChangeOfUnknowns,
    congruent,
    dof_numbers,
    expanded,
    selection,
)
from skfem_joint.values import BETA, NOT_NEGATIVE, check, check_some


@dataclass(frozen=True)
class AppliedLoad:
    """A spatial load vector times a scalar amplitude of time.

    Attributes
    ----------
    vector : ndarray, shape (n,)
        Dimensionless; for a point load 1 at the loaded unknown.
    amplitude : Amplitude
        Force (N) as a function of time (s): one of :mod:`skfem_joint.loads`, or a plain function.
    on : str
        Name of the loaded place.
    """

    vector: FloatArray
    amplitude: Amplitude
    on: str = ""

    def __post_init__(self) -> None:
        vector = np.asarray(as_real(self.vector, f"load on {self.on!r}"))
        object.__setattr__(self, "vector", vector)
        object.__setattr__(self, "amplitude", as_amplitude(self.amplitude))


@dataclass(frozen=True)
class System:
    """Second-order system with friction rows.

    ``C`` may be given as None (no damping), ``w`` as a list, ``beta`` as a number for all points.

    Attributes
    ----------
    M, C, K : ndarray or sparse array, shape (n, n)
        Mass (kg), damping (N s/m) and stiffness (N/m); symmetric, M positive definite.
    B : ndarray or sparse array, shape (rows, n)
        Slip operator: slip velocity of each contact point from the velocities, one row for each
        direction of slip; the rows of a point follow each other.
    w : ndarray, shape (m,)
        Friction limit of each contact point, N.
    beta : ndarray, shape (m,)
        Steepness of the law of friction of each point, s/m; ``inf`` is Coulomb.
    loads : tuple of AppliedLoad
    P : ndarray or sparse array, shape (p, n)
        Displacement of the named points from the unknowns.
    points : tuple of str
        Names of the rows of ``P``.
    directions : ndarray of int, shape (m,)
        Directions in which each contact point can slip, 1 or 2; all 1 if not given. The friction
        force of a point with two is opposite to its slip vector and depends on the norm of it.
    T : ndarray or sparse array, shape (N, n), or None
        Displacement of all degrees of freedom, supported ones included, from the unknowns; None
        where both are the same. See :meth:`expand`.
    J : ndarray or sparse array, shape (joints, m)
        Share of each named joint in the friction of each contact point.
    joints : tuple of str
        Names of the rows of ``J``; without both, all contact points are one joint.
    shares : sparse array, shape (m, m_all), or None
        Share of each contact point of the structure in each contact point of a reduced model, which
        are weighted means of these; rows add up to 1. None where both are the same points.
    notes : tuple of str
        Sentences for users about how the system was made.
    made_for : str
        Loads that a reduced model is restricted to, in words; empty for a system that may be loaded
        in any way.
    origin : Origin, optional
        What a reduced or condensed model was made of, by which `skfem_joint.estimate` finds its
        errors; not saved to files.
    serves : Served, optional
        Range of loads and limits that a reduced model serves, if it was made for one.
    stiffness : ndarray, shape (m,)
        Of the spring in series with the friction of each contact point, N/m; ``inf``, which is
        none, at all points if not given.
    opening : OpeningContact, optional
        Contact that opens and closes; friction limits then follow the normal forces, and ``w`` has
        those at rest: ``opening.limits_at_rest``, and what joints of constant normal force add.
        Normal forces are constant if not given.

    Raises
    ------
    InputError
        For shapes that do not fit, matrices that are complex, not symmetric or not finite, entries
        on their diagonals that are negative (or zero, of M), negative limits or ones below those of
        the normal forces at rest, and a beta or a stiffness that is not positive.
    """

    M: Matrix
    C: Matrix
    K: Matrix
    B: Matrix
    w: FloatArray
    beta: FloatArray
    loads: tuple[AppliedLoad, ...] = ()
    P: Matrix = field(default=None)
    points: tuple[str, ...] = ()
    directions: Any = field(default=None)
    T: Matrix = field(default=None)
    J: Matrix = field(default=None)
    joints: tuple[str, ...] = ()
    shares: Matrix = field(default=None)
    notes: tuple[str, ...] = ()
    made_for: str = ""
    origin: Any = field(default=None, repr=False, compare=False)
    serves: Served | None = None
    stiffness: Any = field(default=None)
    opening: OpeningContact | None = None

    def __post_init__(self) -> None:
        for name in ("M", "C", "K", "B", "w", "beta", "stiffness", "P", "T", "J", "shares"):
            if (value := getattr(self, name)) is not None:
                object.__setattr__(self, name, as_real(value, name))
        n, w = self.M.shape[0], np.asarray(self.w, dtype=float)
        m = w.size
        beta = np.asarray(self.beta, dtype=float)
        rigid = self.stiffness is None or bool(np.isinf(self.stiffness).all())
        completed = {
            "w": w,
            "beta": np.full(m, float(beta)) if beta.ndim == 0 else beta,
            "stiffness": np.full(m, np.inf) if rigid else self.stiffness,
            "C": 0.0 * self.K if self.C is None else self.C,
            "P": sparse.csr_array((0, n)) if self.P is None else self.P,
            "directions": np.ones(m, np.int64) if self.directions is None else self.directions,
            "J": sparse.csr_array(np.ones((min(m, 1), m))) if self.J is None else self.J,
            "joints": ("contact",) * min(m, 1) if self.J is None else self.joints,
        }
        for name, value in completed.items():
            object.__setattr__(self, name, value)
        if self.directions.shape != (m,) or not np.isin(self.directions, (1, 2)).all():
            raise InputError(f"directions: must be 1 or 2 for each of the {m} contact points")
        square = dict.fromkeys(("M", "C", "K"), (n, n))
        shapes = square | {"B": (int(self.directions.sum()), n), "P": (len(self.points), n)}
        shapes |= {"w": (m,), "beta": (m,), "stiffness": (m,), "J": (len(self.joints), m)}
        compared = [(name, getattr(self, name).shape, shape) for name, shape in shapes.items()]
        compared += [(f"load on {load.on!r}", load.vector.shape, (n,)) for load in self.loads]
        if self.T is not None:
            compared.append(("T", self.T.shape, (self.T.shape[0], n)))
        if self.shares is not None:
            compared.append(("shares", self.shares.shape, (m, self.shares.shape[1])))
        problems = [
            f"{name}: found shape {shape}, must be {right}"
            for name, shape, right in compared
            if shape != right
        ]
        if not problems:
            problems = [p for name in square for p in _unsymmetric(name, getattr(self, name))]
            problems += _negative(self.M, self.C, self.K) if not problems else []
        if np.any(~np.isfinite(self.w)) or np.any(self.w < 0.0):
            problems.append("w: friction limits must be finite and not negative")
        if np.any(~(self.beta > 0.0)):
            problems.append("beta: must be positive (inf for Coulomb)")
        if np.any(~(self.stiffness > 0.0)):
            problems.append("stiffness: must be positive (inf for no spring)")
        if self.opening is not None:
            problems += self.opening.problems(m, n) or self._wrong_limits(self.opening)
        refuse(problems)

    def _wrong_limits(self, opening: OpeningContact) -> list[str]:
        """What is wrong with friction limits beside contact that opens."""
        at_rest = opening.limits_at_rest
        lacking = at_rest - self.w
        if not np.any(lacking > 1e-9 * at_rest):
            return []
        k = int(lacking.argmax())
        return [
            f"w: found {self.w[k]:.6g} N at contact point {k}, must be at least "
            f"{at_rest[k]:.6g} N, which the normal forces at rest of contact that opens give it "
            "(gain force): w has the limits at rest; give opening.limits_at_rest, with what joints "
            "of constant normal force add"
        ]

    def __repr__(self) -> str:
        """A few lines: what it is, its joints, loads and points."""
        kind, n_all = (
            "System",
            "" if self.T is None else f" for {self.T.shape[0]} degrees of freedom",
        )
        if self.made_for or self.serves:
            kind = "Reduced model"
        elif self.T is not None:
            kind = "Full model" if sparse.issparse(self.T) else "Condensed or projected model"
        joints = []
        for name, share in zip(self.joints, as_dense(self.J), strict=True):
            count, limit = np.count_nonzero(share), float(share @ self.w)
            own = float(share @ self.spring_constants)
            springs = f", springs of {own:.6g} N/m" if own > 0.0 else ""
            joints.append(f"{name} ({count} contact points, limit {limit:.6g} N{springs})")
        loads = [load.on or "without a name" for load in self.loads]
        lines = [
            f"{kind}: {self.n} unknowns{n_all}",
            f"  joints: {first_of(joints)}",
            f"  loads: {first_of(loads)}",
            f"  points: {first_of(self.points)}",
        ]
        if self.opening is not None:
            lines.insert(2, f"  contact that opens: {self.opening.gap.size} pressure points")
        made_for = self.made_for or (str(self.serves) if self.serves else "")
        return "\n".join(lines + [f"  made for: {made_for}"] * bool(made_for))

    def check_any_load(self, what: str) -> None:
        """Refuse a reduced model that was made for its own loads, for an analysis of other loads.

        Its modes, friction points and law suit the slip under its own loads. Under others its error
        is unknown and may be large. ``what`` names the analysis in the message.

        Raises
        ------
        InputError
            If the system is such a model; it states the loads, and what to give instead.
        """
        if self.made_for:
            raise InputError(
                f"{what}: found a reduced model made for {self.made_for}, must be a system that "
                "serves other frequencies and levels too; give the full system, or "
                "sj.condense(system), which keeps all of the contact; the commands backbone and "
                "response make reduced models of their own from a scene"
            )

    def check_constant_contact(self, what: str, cure: str) -> None:
        """Refuse contact that opens, for what takes normal forces and friction limits as constant.

        ``what`` names the analysis in the message, ``cure`` says what to do in its place.

        Raises
        ------
        InputError
            If a joint of the system opens.
        """
        if self.opening is not None:
            raise InputError(constant_contact_alone(what, cure))

    def closed(self) -> System:
        """Same system with contact that stays closed wherever it is pressed at rest.

        Rigid points do not move apart then, and elastic ones stay on their springs. Friction limits
        are those at rest; what is apart at rest stays free. It is the system itself if no contact
        opens. Its motions are ``system.opening.closed_motions()``.

        Raises
        ------
        InputError
            If contact is rigid and the unknowns do not have the approaches of the faces among them,
            as those of a full and of a condensed system have.
        """
        if self.opening is None:
            return self
        if not sparse.issparse(self.opening.N) and self.opening.rigid.any():
            raise InputError(
                "closed: found a projected system of rigid contact, must be a full or condensed "
                "one, whose unknowns have the approaches of the faces among them, or of elastic "
                "contact, as sj.reduce makes it"
            )
        T, K = self.opening.closed_motions(), self.K
        if not self.opening.rigid.all():
            springs = self.opening.springs
            K = K + (as_dense(springs) if self.is_dense else springs)
        T = as_dense(T) if self.is_dense else sparse.csr_array(T)
        return replace(self, K=K, opening=None)._with(T, self.B @ sparse.csr_array(T))

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

    def with_factors(self, factors: FloatArray) -> System:
        """System whose joints have other friction limits: theirs times ``factors``, (joints,).

        A factor acts on its joint's share of each point. Where contact opens it acts on what
        normal forces give, too.
        """
        if not factors.size:
            return self
        J = sparse.csr_array(self.J)
        of_points = 1.0 + (factors - 1.0) @ J
        known = np.where(of_points > 0.0, of_points, 1.0)
        shares = sparse.diags_array(factors) @ J @ sparse.diags_array(1.0 / known)
        opening = self.opening
        if opening is not None:
            gain = sparse.csr_array(sparse.diags_array(of_points) @ opening.gain)
            opening = replace(opening, gain=gain)
        w = self.w * of_points
        return replace(self, w=w, J=sparse.csr_array(shares), opening=opening)

    @property
    def n(self) -> int:
        """Number of unknowns."""
        return int(self.M.shape[0])

    @property
    def rubs(self) -> NDArray[np.bool_]:
        """Whether each contact point can carry friction, (m,), now or when it is pressed."""
        if self.opening is None:
            return np.asarray(self.w > 0.0)
        pressed = np.diff(sparse.csr_array(self.opening.gain).indptr) > 0
        return np.asarray((self.w > 0.0) | pressed)

    @property
    def point_weights(self) -> FloatArray:
        """Weights of contact points in means over their joints, (m,): friction limits at rest, N.

        Points of a joint that is pressed nowhere at rest have the weight 1.
        """
        J = sparse.csr_array(self.J)
        weightless = (J @ self.w == 0.0) @ (J > 0.0)
        return np.where((weightless > 0) & self.rubs, 1.0, self.w)

    @property
    def contact_points(self) -> int:
        """Number of contact points that can carry friction."""
        return int(np.count_nonzero(self.rubs))

    @cached_property
    def has_springs(self) -> bool:
        """Whether any point with friction has a spring in series."""
        return bool(self.sprung.any())

    @property
    def sprung(self) -> BoolArray:
        """Whether each contact point, (m,), has friction with a spring in series."""
        rubs = self.w > 0.0
        if self.opening is not None:
            rubs |= self.opening.rubs
        return np.asarray(np.isfinite(self.stiffness) & rubs)

    @cached_property
    def spring_matrix(self) -> Matrix:
        """Stiffness of all springs in series with friction, (n, n), N/m: sliders that stick."""
        k = self.on_rows(self.spring_constants)
        if isinstance(self.B, np.ndarray):
            return np.asarray((self.B.T * k) @ self.B)
        B = sparse.csr_array(self.B)
        springs = sparse.csr_array(B.T @ sparse.diags_array(k) @ B)
        return springs.toarray() if self.is_dense else springs

    @property
    def spring_constants(self) -> FloatArray:
        """Of the springs in series with friction, (m,), N/m; zero at points that have none."""
        return np.where(self.sprung, self.stiffness, 0.0)

    @property
    def stuck_stiffness(self) -> Matrix:
        """K with the springs of all sliders that stick, (n, n), N/m; K itself without springs."""
        return self.K + self.spring_matrix if self.has_springs else self.K

    @property
    def stuck_problem(self) -> tuple[Matrix, Matrix, IntArray, list[Amplitude]]:
        """Stiffness, mass, unknowns that stuck joints hold, and loads: what `rayleigh` takes."""
        rigid = self.on_rows(np.where(self.sprung, 0.0, self.w))
        stuck = sparse.csr_array(self.B)[np.flatnonzero(rigid)].indices
        return self.stuck_stiffness, self.M, stuck, [load.amplitude for load in self.loads]

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

    @property
    def mean_square_frequency(self) -> float:
        """Trace of the stiffness over trace of the mass, 1/s2: a scale for small shifts of K."""
        return mean_square_frequency(self.K, self.M)

    @property
    def is_dense(self) -> bool:
        """Whether the matrices are stored dense, as those of a reduced system are."""
        return isinstance(self.M, np.ndarray)

    def project(self, V: FloatArray) -> System:
        """Galerkin projection on the columns of ``V``, u = V q, Eqs. (4)-(9).

        Parameters
        ----------
        V : ndarray, shape (n, j)
            Basis.

        Returns
        -------
        System
            Dense, of size j, with the same contact points and named points.

        Raises
        ------
        InputError
            If the basis has another number of rows, or entries that are not finite.
        """
        if V.ndim != 2 or V.shape[0] != self.n or not np.all(np.isfinite(V)):
            raise InputError(
                f"basis: found shape {V.shape}, must be ({self.n}, j) with finite entries"
            )
        return self._with(V, self.B @ V)

    def widened(self, small: System, V: FloatArray, W: FloatArray) -> System:
        """Projection on [V W] that reuses the projection ``small`` on V.

        ``V`` has shape (n, j) and ``W`` shape (n, k).
        """

        def bordered(A: Matrix, projected: FloatArray) -> FloatArray:
            AW = A @ W
            return np.block([[projected, V.T @ AW], [AW.T @ V, 0.5 * (W.T @ AW + AW.T @ W)]])

        def side_by_side(left: Matrix, right: Matrix) -> Matrix:
            return np.hstack([as_dense(left), as_dense(right)])

        vectors = (
            np.append(a.vector, W.T @ b.vector)
            for a, b in zip(small.loads, self.loads, strict=True)
        )
        return replace(
            small,
            M=bordered(self.M, small.M),
            C=bordered(self.C, small.C),
            K=bordered(self.K, small.K),
            B=side_by_side(small.B, self.B @ W),
            loads=tuple(replace(a, vector=b) for a, b in zip(small.loads, vectors, strict=True)),
            P=side_by_side(small.P, self.P @ W),
            T=side_by_side(small.T, W if self.T is None else self.T @ W),
            opening=None if self.opening is None else self.opening.in_unknowns(np.hstack([V, W])),
        )

    def in_unknowns(self, new: ChangeOfUnknowns) -> System:
        """Same system in other unknowns, among which are the slips.

        ``new`` is from :func:`skfem_joint.unknowns.change_of_unknowns`; its outer unknowns are
        those of this system. Each slip row then picks a single unknown.
        """
        return self._with(new.forward, selection(new.slips, new.forward.shape[1]))

    def with_slips_as_unknowns(self) -> tuple[System, ChangeOfUnknowns]:
        """Same system whose unknowns are the slips and the displacements that they leave free.

        Each slip row then picks an unknown of its own. Also returns the change of unknowns.

        Raises
        ------
        InputError
            If slip rows depend on each other.
        """
        none = sparse.csr_array((0, self.n))
        given = self.B, self.w, self.beta, self.directions, none
        rows = SlipRows(*given, stiffness=self.stiffness)
        new = rows.change_of_unknowns(np.zeros(0, dtype=np.intp))
        return self.in_unknowns(new), new

    def _with(self, T: Matrix, B: Matrix) -> System:
        """System in the unknowns q, u = T q, with the slip operator ``B`` in these."""
        return replace(
            self,
            M=congruent(self.M, T),
            C=congruent(self.C, T),
            K=congruent(self.K, T),
            B=B,
            loads=tuple(replace(load, vector=T.T @ load.vector) for load in self.loads),
            P=self.P @ T,
            T=T if self.T is None else self.T @ T,
            origin=None,
            opening=None if self.opening is None else self.opening.in_unknowns(T),
        )

    @staticmethod
    def from_matrices(
        M: Matrix,
        K: Matrix,
        C: Matrix = None,
        *,
        fixed: ArrayLike = (),
        contact: SlipRows | None = None,
        loads: Mapping[str, tuple[ArrayLike, Callable[..., Any]]] | None = None,
        points: Mapping[str, ArrayLike] | None = None,
        stiffness_damping: float = 0.0,
        mass_damping: float = 0.0,
        damping_ratio: float | None = None,
    ) -> System:
        """System from given matrices, assembled by scikit-fem or by any other program.

        Parameters
        ----------
        M, K, C : ndarray or sparse array, shape (N, N)
            Mass (kg), positive definite; stiffness (N/m), positive semidefinite; and damping
            (N s/m), positive semidefinite too, so that it never creates energy. If not given, C is
            ``stiffness_damping * K + mass_damping * M`` (s, 1/s), or follows from the
            ``damping_ratio``, see `with_damping_ratio`.
        fixed : array_like of int
            Degrees of freedom that are supported, such as ``basis.get_dofs("wall")``.
        contact : SlipRows, optional
            From `contact` or `point_friction`, or a sum of them. Each of their names is a joint.
        loads : mapping, optional
            By name: a vector of shape (N,) or the number of a degree of freedom, and the amplitude
            (N), a shape of :mod:`skfem_joint.loads` or a plain function of time (s).
        points : mapping, optional
            Displacements to observe, by name: a row of shape (N,) or the number of a degree of
            freedom. Loads are observed in any case, under their names.

        Returns
        -------
        System
            Sparse; ``system.expand(u)`` gives all N degrees of freedom.

        Raises
        ------
        InputError
            For shapes that do not fit, matrices that are complex, not symmetric (such as
            gyroscopic damping) or indefinite, numbers that are no degrees of freedom, and slip rows
            that depend on each other.
        """
        _check_damping(C, stiffness_damping, mass_damping, damping_ratio)
        square = _square({"M": M, "K": K} | ({} if C is None else {"C": C}))
        n = square["M"].shape[0]
        fixed = dof_numbers(fixed, n)
        joined = _joined(SlipRows.none(n) if contact is None else contact, n)
        _check_enough_mass(square["M"], n - fixed.size - joined.closed.shape[0])
        joined = joined.without(fixed)
        M, K = sparse.csr_array(square["M"]), sparse.csr_array(square["K"])
        applied = tuple(
            AppliedLoad(vector_of(vector, n, f"load {on!r}"), as_amplitude(amplitude), on)
            for on, (vector, amplitude) in (loads or {}).items()
        )
        joints, J = joined.joints
        rows = {load.on: load.vector for load in applied}
        rows |= {k: vector_of(row, n, f"point {k!r}") for k, row in (points or {}).items()}
        outer = System(
            M=M,
            C=sparse.csr_array(square.get("C", stiffness_damping * K + mass_damping * M)),
            K=K,
            B=joined.B,
            w=joined.w,
            beta=joined.beta,
            loads=applied,
            P=sparse.csr_array(np.reshape(list(rows.values()), (len(rows), n))),
            points=tuple(rows),
            directions=joined.directions,
            J=J,
            joints=joints,
            stiffness=joined.springs,
            notes=joined.notes,
        )
        new = joined.change_of_unknowns(fixed)
        slips = replace(new, slips=new.slips[: joined.B.shape[0]])
        system = replace(outer.in_unknowns(slips), opening=joined.opening_in(new))
        _check_definite(system, C is not None)
        return system if damping_ratio is None else system.with_damping_ratio(damping_ratio)

    def with_damping_ratio(
        self, ratio: float, fitted: Callable[..., RayleighFit] = rayleigh_fit
    ) -> System:
        """System with Rayleigh damping C = a M + b K of this ratio of the critical damping.

        Damping has the ratio at two frequencies: the first natural frequency with all joints stuck,
        on their springs where friction has some (or loose, if nothing vibrates otherwise), and the
        highest frequency of the harmonic loads. The third natural frequency replaces the latter if
        no load is harmonic, or if the two are within a tenth of each other. Between the two
        frequencies damping is lower, beyond them higher; ``notes`` state by how much. The system
        must be sparse, with slip rows that pick unknowns. Contact that opens counts as closed where
        it is pressed at rest.

        Parameters
        ----------
        ratio : float
        fitted : callable, optional
            What finds the frequencies in place of `skfem_joint.modes.rayleigh_fit`: a
            `skfem_joint.modes.KnownFit`, which keeps them for a system with the same.

        Raises
        ------
        InputError
            If nothing vibrates.
        """
        mass, stiffness, note = rayleigh(*self.closed().stuck_problem, ratio, fitted)
        return replace(self, C=mass * self.M + stiffness * self.K, notes=(*self.notes, note))

    def expand(self, u: FloatArray) -> FloatArray:
        """Displacement of all degrees of freedom, (..., N), from the unknowns, (..., n)."""
        return u if self.T is None else expanded(self.T, u)

    def slider_slip(self, slip: FloatArray, sigma: FloatArray) -> FloatArray:
        """Slip of the sliders, m: that of the slip rows, (..., rows), less that of the springs.

        ``sigma``, (..., rows), is the friction over its limit.
        """
        return slip - self.spring_stretch * sigma if self.has_springs else slip

    def slider_peak(self, slip_peak: FloatArray) -> FloatArray:
        """Largest slip of each slider, (m,), m, from that of its point: what its spring leaves.

        Friction limits are those at rest; `Run.slider_peak` holds where they change, too.
        """
        if not self.has_springs:
            return slip_peak
        taken = np.where(self.sprung, self.w / self.stiffness, 0.0)
        return np.asarray(np.maximum(slip_peak - taken, 0.0))

    def slipping(self, slip: FloatArray, period: float = 0.0) -> BoolArray:
        """Whether each contact point slips in a cycle rather than sticks or creeps, (..., m).

        A point slips if its slip exceeds `SLIPPING_SHARE` of the largest one of all joints, and its
        elastic slip, which is that of a point that sticks: what its law lets it creep in a period
        at half of its friction limit, and `SLIPPING_SHARE` of the slip that its limit gives it
        while all other unknowns are held, which is far above round-off.

        Parameters
        ----------
        slip : ndarray, shape (..., m)
            Largest slip of each slider in the cycle, m: a quarter of the way that it slides. What
            springs in series take is no part of it, see `slider_peak`.
        period : float
            Duration of the cycle, s; 0 where points do not creep, as on a quasi-static path.
        """
        diagonal = np.asarray(self.K.diagonal(), dtype=float)
        compliance = np.divide(1.0, diagonal, out=np.zeros_like(diagonal), where=diagonal > 0.0)
        squares = self.B * self.B if isinstance(self.B, np.ndarray) else self.B.power(2)
        held = self.w * self.by_point(np.asarray(squares @ compliance))
        elastic = np.maximum(period / self.beta, SLIPPING_SHARE * held)
        largest = slip.max(axis=-1, initial=0.0, keepdims=True)
        return np.asarray(self.rubs & (slip > np.maximum(SLIPPING_SHARE * largest, elastic)))

    def slipping_share(self, slip: FloatArray, period: float = 0.0) -> FloatArray:
        """Share of the friction limits whose points slip, (...), see `slipping`; 0 without any."""
        whole = float(self.w.sum())
        part = self.slipping(slip, period) @ self.w
        return np.asarray(part / whole if whole else 0.0 * part)

    def slips_as_a_whole(self, slip: FloatArray, period: float = 0.0) -> bool:
        """Whether points with 99 % of the friction limit of a joint slip, see `slipping`."""
        return self.least_share(~self.slipping(slip, period)) <= 1.0 - WHOLE_SHARE

    def slid(self, friction_work: FloatArray) -> FloatArray:
        """Slip of each point in a cycle, (m,), m: a quarter of the way that its friction works on.

        Slip that remains from before the cycle does not count. Where limits follow normal forces
        the way is taken under those at rest. ``friction_work``, (m,), J, is that of the cycle.
        """
        w = self.point_weights
        way = np.divide(friction_work, w, out=np.zeros_like(w), where=w > 0.0)
        return np.asarray(0.25 * way)

    def no_steeper(self, beta: ArrayLike) -> System:
        """System whose points have at most the steepness ``beta`` (s/m), but for those on springs.

        Models with fewer unknowns than points cannot hold them; sliders on springs need not be
        held.
        """
        lower = np.minimum(self.beta, beta)
        return replace(self, beta=np.where(self.sprung, self.beta, lower))

    @property
    def steepest(self) -> float:
        """Largest steepness, s/m, of points without springs; ``inf`` where there are none."""
        if not self.has_springs:
            return float(self.beta.max(initial=0.0))
        rigid = (self.w > 0.0) & ~self.sprung
        return float(self.beta[rigid].max()) if rigid.any() else np.inf

    def with_beta(self, beta: float) -> System:
        """System whose contact points all have the steepness ``beta`` (s/m)."""
        check("beta", beta, BETA)
        return replace(self, beta=np.full(self.w.shape, float(beta)))

    def frequency_of(self, u: FloatArray) -> float:
        """Frequency of free vibration in the shape ``u`` by Rayleigh's quotient, rad/s."""
        stiffness, mass = float(u @ (self.K @ u)), float(u @ (self.M @ u))
        if self.has_springs:  # whose sliders stick
            slip = self.B @ u
            stiffness += float(slip @ (self.on_rows(self.spring_constants) * slip))
        return float(np.sqrt(max(stiffness / mass, 0.0))) if mass > 0.0 else 0.0

    def stored_energy(
        self,
        u: FloatArray,
        v: FloatArray,
        sigma: FloatArray | None = None,
        limits: FloatArray | None = None,
    ) -> float:
        """Kinetic plus strain energy, J; with ``sigma`` (rows,), that of springs included.

        That of contact that opens is zero at rest.
        ``sigma`` is the friction over its limit, which in a spring in series is its force, and
        ``limits``, (m,), N, are these limits, those at rest if not given.
        """
        energy = float(0.5 * (v @ (self.M @ v)) + 0.5 * (u @ (self.K @ u)))
        if self.opening is not None:
            energy += self.opening.potential(u)
        return energy if sigma is None else energy + self.spring_energy(sigma, limits)

    def spring_energy(self, sigma: FloatArray, limits: FloatArray | None = None) -> float:
        """Energy, J, stored in the springs in series with friction, see `stored_energy`."""
        if not self.has_springs:
            return 0.0
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

    @property
    def spring_flexibility(self) -> FloatArray:
        """Slip that each row's spring takes under a unit force, (rows,), m/N; 0 for none."""
        return self.on_rows(np.where(self.sprung, 1.0 / self.stiffness, 0.0))

    @cached_property
    def spring_stretch(self) -> FloatArray:
        """Slip that each row's spring takes under the friction limit, (rows,), m; 0 for none."""
        return self.on_rows(np.where(self.sprung, self.w / self.stiffness, 0.0))

    def load_amplitudes(self, times: FloatArray) -> FloatArray:
        """Amplitudes of all loads, shape (loads, times), N."""
        rows = [load.amplitude(times) for load in self.loads]
        return np.reshape(np.asarray(rows, dtype=float), (len(rows), times.size))

    def load_vectors(self) -> FloatArray:
        """Spatial load vectors, shape (n, loads)."""
        rows = np.reshape([load.vector for load in self.loads], (len(self.loads), self.n))
        return np.ascontiguousarray(rows.T)


def _check_damping(C: Matrix, stiffness: float, mass: float, ratio: float | None) -> None:
    """Refuse wrong factors of the damping, and a ratio beside factors or a matrix ``C``."""
    check_some(NOT_NEGATIVE, stiffness_damping=stiffness, mass_damping=mass)
    if ratio is not None:
        others = {"C": C is not None, "stiffness": stiffness, "mass": mass}
        refuse(ratio_problems(ratio, others))


def vector_of(value: ArrayLike, n: int, what: str, first: int = 0) -> FloatArray:
    """Vector of shape (n,), given as such, or a unit vector by the number of its unknown.

    Numbers count from ``first``.
    """
    array = np.asarray(value)
    real = as_real(array, what)
    # A list with a single whole number is a vector if there is a single unknown.
    if array.size == 1 and np.issubdtype(array.dtype, np.integer) and (n > 1 or array.ndim == 0):
        return np.bincount(dof_numbers(array, n, what, first), minlength=n).astype(float)
    if real.shape != (n,) or not np.isfinite(real).all():
        raise InputError(
            f"{what}: found shape {array.shape}, must be ({n},), finite, or one number of an "
            "unknown"
        )
    return np.array(real)


def _square(given: Mapping[str, Any]) -> dict[str, Matrix]:
    """Real matrices by name, all of the shape of the first, which must be square."""
    real = {name: as_real(A, name) for name, A in given.items()}
    first = next(iter(real.values())).shape
    n = first[0] if len(first) == 2 else "N"
    refuse(
        f"{name}: found shape {A.shape}, must be ({n}, {n})"
        for name, A in real.items()
        if A.shape != (n, n)
    )
    return real


def _joined(contact: SlipRows, n: int) -> SlipRows:
    """Slip rows with real entries; InputError if they do not act on ``n`` unknowns."""
    rows = {name: as_real(getattr(contact, name), f"contact: {name}") for name in ("B", "closed")}
    refuse(
        f"contact: {name}: found shape {A.shape}, must be {(A.shape[0], n)}"
        for name, A in rows.items()
        if A.shape != (A.shape[0], n)
    )
    return replace(contact, **rows)


def _check_enough_mass(M: Matrix, unknowns: int) -> None:
    """Refuse a sparse mass with fewer entries than unknowns, before memory is taken for these."""
    if sparse.issparse(M) and M.nnz < unknowns:
        raise InputError(
            f"M: is not positive definite: found {M.nnz} entries, for {unknowns} unknowns that "
            "each need some mass"
        )


def _unsymmetric(name: str, A: Matrix) -> list[str]:
    """What is wrong with a matrix A that must be symmetric.

    For two random vectors x and y, x^T A y and y^T A x must agree to 1e-10 of the norm of A.
    """
    values = A if isinstance(A, np.ndarray) else sparse.csr_array(A).data
    if not np.all(np.isfinite(values)):
        return [f"{name}: must be finite"]
    x, y = np.random.default_rng(0).normal(size=(2, A.shape[0]))
    difference = abs(float(x @ (A @ y) - y @ (A @ x)))
    if difference <= 1e-10 * float(np.linalg.norm(values)):
        return []
    gyroscopic = ""
    if name == "C":
        gyroscopic = ", which leaves out gyroscopic forces (what this package cannot compute yet)"
    return [
        f"{name}: is not symmetric; friction and reduction need symmetric matrices: assemble "
        f"it symmetrically, or give 0.5 * ({name} + {name}.T) if that is what is meant{gyroscopic}"
    ]


#: What is wrong with matrices that are not definite, or semidefinite.
_WRONG = {
    "M": "is not positive definite: does every unknown have mass?",
    "K": "is indefinite: is a sign wrong, or a prestress large?",
    "C": "is negative somewhere, so that it would create energy: v^T C v must not be below 0 for "
    "any velocity v; is a sign wrong? Negative damping, such as that of flow, cannot be computed",
}


def _negative(M: Matrix, C: Matrix, K: Matrix) -> list[str]:
    """What is wrong with signs on the diagonals of mass, damping and stiffness.

    Entries that are round-off of the largest count as zero.
    """
    problems = []
    for name, A in (("M", M), ("K", K), ("C", C)):
        diagonal = np.asarray(A.diagonal())
        k = int(diagonal.argmin()) if diagonal.size else 0
        if np.any(diagonal < -1e-9 * np.abs(diagonal).max(initial=0.0)):
            problems.append(f"{name}: {_WRONG[name]}; found {diagonal[k]:.6g} for unknown {k}")
    return problems


def _check_definite(system: System, damped: bool) -> None:
    """Refuse a mass that is not positive definite, and a stiffness or damping that is indefinite.

    Stiffness and damping may be singular or zero: friction or contact alone may hold a body. The
    damping is checked only if it is ``damped`` by a matrix of its own.
    """
    wrong = {
        "M": not _is_definite(system.M),
        "K": not _is_semidefinite(system.K),
        "C": damped and not _is_semidefinite(system.C),
    }
    refuse(f"{name}: {_WRONG[name]}" for name, is_wrong in wrong.items() if is_wrong)


def _is_semidefinite(A: Matrix) -> bool:
    """Whether a symmetric matrix is positive semidefinite, but for round-off.

    It is divided by the roots of its diagonal on both sides, so that the units of the unknowns do
    not matter, and 1e-9 of the unit matrix is added before it is factorised. Diagonal entries below
    1e-12 of the largest are round-off.
    """
    A = sparse.csr_array(A, copy=True)  # zeros are taken out in place
    A.eliminate_zeros()
    if not A.nnz:
        return True
    diagonal = A.diagonal()
    least = 1e-12 * float(np.abs(diagonal).max())
    if least == 0.0 or diagonal.min() < -least:
        return False
    divided = sparse.diags_array(1.0 / np.sqrt(np.maximum(diagonal, 0.0) + least))
    return _is_definite(divided @ A @ divided + 1e-9 * sparse.eye_array(A.shape[0]))


def _is_definite(A: Matrix) -> bool:
    """Whether a symmetric matrix is positive definite: all pivots of its factors are positive."""
    try:
        return bool(np.all(pivots(A) > 0.0))
    except RuntimeError:  # the factorisation stops at a pivot that is exactly zero
        return False
