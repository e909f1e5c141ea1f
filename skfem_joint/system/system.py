"""`System`, the type of all models: full, condensed, reduced, and with merged friction points.

A system is the set of equations

    M a + C v + K u + B^T (w * sigma(B v)) = sum_k load_k amplitude_k(t)        (Eq. (1))

with displacements u, velocities v, accelerations a and friction sigma at slip rows B. Every map
between models takes a system and returns a system.
"""

from __future__ import annotations

import functools
import operator
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse
from scipy.sparse.linalg import LinearOperator, aslinearoperator

from skfem_joint.ground.arrays import (
    BoolArray,
    FloatArray,
    IntArray,
    Matrix,
    as_dense,
    as_real,
    dense_rows,
    make_real,
    wrong_shapes,
)
from skfem_joint.ground.errors import InputError, first_of, refuse
from skfem_joint.ground.loads import Amplitude, as_amplitude
from skfem_joint.ground.plain_values import fingerprint
from skfem_joint.ground.values import NOT_NEGATIVE, check_kind, check_some
from skfem_joint.linalg.factors import factorised, with_pivots
from skfem_joint.linalg.shifts import mean_square_frequency
from skfem_joint.system.contacts import Contact
from skfem_joint.system.modes import (
    RayleighFit,
    hardly_straining,
    notes_of_shift,
    notes_of_weak_springs,
    ratio_problems,
    rayleigh_fit,
)
from skfem_joint.system.served import Served
from skfem_joint.system.slips import SLIPPING_SHARE, WHOLE_SHARE, SlipRows
from skfem_joint.system.unknowns import (
    ChangeOfUnknowns,
    congruent,
    dof_numbers,
    expanded,
    selection,
)

_NO_CONTACT = Contact.none(0)  #: where no contact is given
#: What is said of a smaller model that was changed after it was made.
CHANGED = (
    "the matrices, the loads or the friction limits of this model are not those of the full system "
    "that it was made from; change them there, and reduce or condense it again"
)


@dataclass(frozen=True)
class AppliedLoad:
    """A spatial load vector times a scalar amplitude of time.

    Attributes
    ----------
    vector : ndarray, shape (n,)
        Dimensionless; for a point load 1 at the loaded unknown.
    amplitude : Amplitude
        Force (N) as a function of time (s): one of :mod:`skfem_joint.ground.loads`, or a plain
        function.
    on : str
        Name of the loaded place.
    mass : float
        Of an accelerated base the mass, kg, that minus its acceleration gives the amplitude; 0 for
        other loads.
    carried : ndarray, shape (points,), optional
        Of an accelerated base the displacement of each named point as all moves with it by 1 m.
    """

    vector: FloatArray
    amplitude: Amplitude
    on: str = ""
    mass: float = 0.0
    carried: FloatArray | None = None

    def __post_init__(self) -> None:
        vector = np.asarray(as_real(self.vector, f"load on {self.on!r}"))
        object.__setattr__(self, "vector", vector)
        object.__setattr__(self, "amplitude", as_amplitude(self.amplitude))


@dataclass(frozen=True)
class System:
    """Second-order system with friction rows.

    ``C`` may be given as None: no damping.

    Attributes
    ----------
    M, C, K : ndarray or sparse array, shape (n, n)
        Mass (kg), damping (N s/m) and stiffness (N/m); symmetric, M positive definite.
    contact : Contact
        Contact points; without any if not given.
    loads : tuple of AppliedLoad
    P : ndarray or sparse array, shape (p, n)
        Displacement of the named points from the unknowns.
    points : tuple of str
        Names of the rows of ``P``.
    T : ndarray, sparse array or LinearOperator, shape (N, n), or None
        Displacement of all degrees of freedom, supported ones included, from the unknowns; None
        where both are the same. An operator of a model condensed by parts. See :meth:`expand`.
    notes : tuple of str
        Sentences for users about how the system was made.
    made_for : str
        Loads, or the analysis, that a reduced model is restricted to, in words; empty for a system
        that may be loaded in any way.
    origin : Origin, optional
        What a reduced or condensed model was made of, by which `skfem_joint.estimate` finds its
        errors; not saved to files.
    serves : Served, optional
        Range of loads and limits that a reduced model serves, if it was made for one.
    loose : sparse array, shape (n, r), optional
        Motions of which all that strain nothing are combinations: rigid ones, of a structure. They
        are asked for by `skfem_joint.system.rigid.rigid_of`; pivots of the stiffness tell whether
        there are any if they are not known.

    Raises
    ------
    InputError
        For shapes that do not fit, matrices that are complex, not symmetric or not finite, and
        entries on their diagonals that are negative (or zero, of M).
    """

    M: Matrix
    C: Matrix
    K: Matrix
    contact: Contact = _NO_CONTACT
    loads: tuple[AppliedLoad, ...] = ()
    P: Matrix = field(default=None)
    points: tuple[str, ...] = ()
    T: Matrix = field(default=None)
    notes: tuple[str, ...] = ()
    made_for: str = ""
    origin: Any = field(default=None, repr=False, compare=False)
    serves: Served | None = None
    loose: Matrix = field(default=None, repr=False, compare=False)

    def __post_init__(self) -> None:
        make_real(self, ("M", "C", "K", "P", "T"))
        n, contact = self.M.shape[0], self.contact
        if not isinstance(contact, Contact):
            raise InputError(
                f"contact: found {type(contact).__name__}, must be an sj.Contact, such as "
                "sj.Contact(B, w, beta)"
            )
        completed = {
            "C": 0.0 * self.K if self.C is None else self.C,
            "P": sparse.csr_array((0, n)) if self.P is None else self.P,
            "contact": Contact.none(n) if contact is _NO_CONTACT else contact,
        }
        for name, value in completed.items():
            object.__setattr__(self, name, value)
        square = dict.fromkeys(("M", "C", "K"), (n, n))
        shapes = square | {"P": (len(self.points), n)}
        if self.T is not None:
            shapes["T"] = (self.T.shape[0], n)
        arrays = {name: (getattr(self, name), shapes[name]) for name in shapes}
        arrays["contact: B"] = self.contact.B, (self.contact.B.shape[0], n)
        arrays |= {f"load on {load.on!r}": (load.vector, (n,)) for load in self.loads}
        problems = wrong_shapes(arrays)
        if not problems:
            problems = [p for name in square for p in _unsymmetric(name, getattr(self, name))]
            problems += _negative(self.M, self.C, self.K) if not problems else []
        refuse(problems)

    def __repr__(self) -> str:
        """A few lines: what it is, its joints, loads and points."""
        kind = "System"
        n_all = "" if self.T is None else f" for {self.T.shape[0]} degrees of freedom"
        if self.made_for or self.serves:
            kind = "Reduced model"
        elif self.T is not None:
            kind = "Full model" if sparse.issparse(self.T) else "Condensed or projected model"
        joints, contact = [], self.contact
        for name, share in zip(contact.joints, as_dense(contact.J), strict=True):
            count, limit = np.count_nonzero(share), float(share @ contact.w)
            own = float(share @ contact.spring_constants)
            springs = f", springs of {own:.6g} N/m" if own > 0.0 else ""
            joints.append(f"{name} ({count} contact points, limit {limit:.6g} N{springs})")
        loads = [load.on or "without a name" for load in self.loads]
        lines = [
            f"{kind}: {self.n} unknowns{n_all}",
            f"  joints: {first_of(joints)}",
            f"  loads: {first_of(loads)}",
            f"  points: {first_of(self.points)}",
        ]
        if contact.opens:
            lines.insert(2, f"  contact that opens: {contact.normal.gap.size} pressure points")
        made_for = self.made_for or (str(self.serves) if self.serves else "")
        return "\n".join(lines + [f"  made for: {made_for}"] * bool(made_for))

    def check_any_load(self, what: str, level: float = 0.0) -> None:
        """Refuse a reduced model that was made for its own loads, for an analysis of other loads.

        Its modes, friction points and law suit the slip under its own loads. Under others its error
        is unknown and may be large. So it is above the highest level that it was made for, and
        where its matrices, limits or loads were changed. ``what`` names the analysis in the
        message, ``level`` is its highest.

        Raises
        ------
        InputError
            If the system is such a model; it states the loads, and what to give instead.
        """
        if self.made_for and self.origin is None:
            raise InputError(
                f"{what}: found a reduced model that does not know what it was made of, as one of "
                f"a file (made for {self.made_for}); make it again by sj.reduce, or one for a "
                "range, which files keep whole"
            )
        if self.made_for and what not in self.origin.analyses:
            raise InputError(
                f"{what}: found a reduced model made for {self.made_for}, must be a system that "
                "serves other frequencies and levels too; give the full system, one by "
                "sj.condense(system), which keeps all of the contact, or a model that sj.reduce "
                "makes for a response (frequency=, level=), a mode (curve=) or a range (range=)"
            )
        if self.made_for and not self.origin.made(self, loaded=what == "response"):
            raise InputError(f"{what}: {CHANGED}")
        if self.made_for and level > self.origin.highest * (1.0 + 1e-9):
            raise InputError(
                f"{what}: found level {level:.6g}, must be at most {self.origin.highest:.6g}, the "
                f"highest of the reduced model, which was made for {self.made_for}; give lower "
                "levels, or make one for higher ones"
            )

    def has_matrices_of(self, other: System, *names: str) -> bool:
        """Whether some matrices, "B" too, or the contact but for names, are those of another."""
        unnamed: dict[str, Any] = {"J": None, "joints": (), "shares": None}

        def named(system: System, name: str) -> Any:
            if name == "contact":
                return replace(system.contact, **unnamed)
            return getattr(system.contact if name == "B" else system, name)

        pairs = ((named(self, name), named(other, name)) for name in names)
        return all(a is b or fingerprint(a) == fingerprint(b) for a, b in pairs)

    def closed(self) -> System:
        """Same system with contact that stays closed wherever it is pressed at rest.

        Rigid points do not move apart then, and elastic ones stay on their springs. Friction limits
        are those at rest; what is apart at rest stays free. It is the system itself if no contact
        opens. Its motions are ``system.contact.normal.closed_motions()``.

        Raises
        ------
        InputError
            If contact is rigid and the unknowns do not have the approaches of the faces among them,
            as those of a full and of a condensed system have.
        """
        normal = self.contact.normal
        if not self.contact.opens:
            return self
        if not sparse.issparse(normal.N) and normal.rigid.any():
            raise InputError(
                "closed: found a projected system of rigid contact, must be a full or condensed "
                "one, whose unknowns have the approaches of the faces among them, or of elastic "
                "contact, as sj.reduce makes it"
            )
        T, K = normal.closed_motions(), self.K
        if not normal.rigid.all():
            K = K + (as_dense(normal.springs) if self.is_dense else normal.springs)
        T = as_dense(T) if self.is_dense else sparse.csr_array(T)
        system = replace(self, K=K, contact=self.contact.constant())
        closed = system._with(T, self.contact.B @ sparse.csr_array(T))
        if self.loose is None or self.is_dense:
            return closed
        # Motions that keep contact closed are combinations of the columns of T, others are not, and
        # strain what stands for them.
        parts = (T.T @ self.loose).toarray()
        parts = factorised(sparse.csr_array(T.T @ T))(parts) if parts.size else parts
        return replace(closed, loose=sparse.csr_array(parts))

    def with_contact(self, **changes: Any) -> System:
        """System whose contact has other values, such as ``given`` limits or ``beta``."""
        return replace(self, contact=replace(self.contact, **changes))

    def with_beta(self, beta: float) -> System:
        """System whose contact points all have the steepness ``beta`` (s/m)."""
        return replace(self, contact=self.contact.with_beta(beta))

    def no_steeper(self, beta: ArrayLike) -> System:
        """System whose points have at most a steepness, see `Contact.no_steeper`."""
        return replace(self, contact=self.contact.no_steeper(beta))

    @property
    def n(self) -> int:
        """Number of unknowns."""
        return int(self.M.shape[0])

    @property
    def stuck_stiffness(self) -> Matrix:
        """K with the springs of all sliders that stick, (n, n), N/m; K itself without springs."""
        springs = self.contact.spring_matrix
        if not self.contact.has_springs:
            return self.K
        return self.K + (as_dense(springs) if self.is_dense else springs)

    @property
    def stuck_problem(self) -> tuple[Matrix, Matrix, IntArray, list[Amplitude]]:
        """Stiffness, mass, unknowns that stuck joints hold, and loads, for `rayleigh_fit`."""
        contact = self.contact
        rigid = contact.on_rows(np.where(contact.sprung, 0.0, contact.w))
        stuck = sparse.csr_array(contact.B)[np.flatnonzero(rigid)].indices
        return self.stuck_stiffness, self.M, stuck, [load.amplitude for load in self.loads]

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
        return self._with(V)

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
            contact=replace(
                small.contact,
                B=side_by_side(small.contact.B, self.contact.B @ W),
                normal=self.contact.normal.in_unknowns(np.hstack([V, W])),
            ),
            loads=tuple(replace(a, vector=b) for a, b in zip(small.loads, vectors, strict=True)),
            P=side_by_side(small.P, self.P @ W),
            T=_all_from(self.T, np.hstack([V, W]))
            if isinstance(self.T, LinearOperator)
            else side_by_side(small.T, _all_from(self.T, W)),
        )

    def in_unknowns(self, new: ChangeOfUnknowns) -> System:
        """Same system in other unknowns, among which are the slips.

        ``new`` is from :func:`skfem_joint.system.unknowns.change_of_unknowns`; its outer unknowns
        are those of this system. Each slip row then picks a single unknown.
        """
        system = self._with(new.forward, selection(new.slips, new.forward.shape[1]))
        loose = None if self.loose is None else sparse.csr_array(new.inverse @ self.loose)
        return replace(system, loose=loose)

    def with_slips_as_unknowns(self) -> tuple[System, ChangeOfUnknowns]:
        """Same system whose unknowns are the slips and the displacements that they leave free.

        Each slip row then picks an unknown of its own. Also returns the change of unknowns.

        Raises
        ------
        InputError
            If slip rows depend on each other.
        """
        none = sparse.csr_array((0, self.n))
        c = self.contact
        rows = SlipRows(c.B, c.w, c.beta, c.directions, none, stiffness=c.stiffness)
        new = rows.change_of_unknowns(np.zeros(0, dtype=np.intp))
        return self.in_unknowns(new), new

    def _with(self, T: Matrix, B: Matrix = None) -> System:
        """System in the unknowns q, u = T q; ``B`` is the slip operator in these, if known."""
        return replace(
            self,
            M=congruent(self.M, T),
            C=congruent(self.C, T),
            K=congruent(self.K, T),
            contact=self.contact.in_unknowns(T, B),
            loads=tuple(replace(load, vector=T.T @ load.vector) for load in self.loads),
            P=self.P @ T,
            T=_all_from(self.T, T),
            origin=None,
            loose=None,
        )

    @staticmethod
    def from_matrices(
        M: Matrix,
        K: Matrix,
        C: Matrix = None,
        *,
        fixed: ArrayLike = (),
        contact: SlipRows | Sequence[SlipRows] | None = None,
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
        contact : SlipRows or sequence of SlipRows, optional
            From `contact`, `point_friction`, `point_contact` or `iwan`, a sum or a list of them.
            Each of their names is a joint.
        loads : mapping, optional
            By name: a vector of shape (N,) or the number of a degree of freedom, and the amplitude
            (N), a shape of :mod:`skfem_joint.ground.loads` or a plain function of time (s).
        points : mapping, optional
            Displacements to observe, by name: a row of shape (N,) or the number of a degree of
            freedom. Loads are observed in any case, under their names, along their vectors.

        Returns
        -------
        System
            Sparse; ``system.expand(u)`` gives all N degrees of freedom.

        Raises
        ------
        InputError
            For shapes that do not fit, matrices that are complex, not symmetric (such as
            gyroscopic damping) or indefinite, numbers that are no degrees of freedom, a point that
            has the name of a load and another row, slip rows that depend on each other, and more
            than one kind of damping.
        """
        forces: Mapping[str, Any] = {} if loads is None else loads
        points = {} if points is None else points
        check_kind("loads", forces, Mapping)
        check_kind("points", points, Mapping)
        refuse(
            f"load {on!r}: found {type(pair).__name__}, must be two in a tuple: a vector of shape "
            "(N,) or the number of a degree of freedom, and the amplitude over time"
            for on, pair in forces.items()
            if not (isinstance(pair, tuple | list) and len(pair) == 2)
        )
        _check_damping(C, stiffness_damping, mass_damping, damping_ratio)
        square = _square({"M": M, "K": K} | ({} if C is None else {"C": C}))
        n = square["M"].shape[0]
        fixed = dof_numbers(fixed, n)
        joined = _joined(contact, n)
        _check_enough_mass(square["M"], n - fixed.size - joined.closed.shape[0])
        joined = joined.without(fixed)
        M, K = sparse.csr_array(square["M"]), sparse.csr_array(square["K"])
        applied = tuple(
            AppliedLoad(vector_of(vector, n, f"load {on!r}"), as_amplitude(amplitude), on)
            for on, (vector, amplitude) in forces.items()
        )
        rows = {load.on: load.vector for load in applied}
        observed = {k: vector_of(row, n, f"point {k!r}") for k, row in points.items()}
        refuse(
            f"points: {name!r} is a load, whose displacement is along its vector; rename the point"
            for name, row in observed.items()
            if not np.array_equal(row, rows.get(name, row))
        )
        rows |= observed
        outer = System(
            M=M,
            C=sparse.csr_array(square.get("C", stiffness_damping * K + mass_damping * M)),
            K=K,
            loads=applied,
            P=sparse.csr_array(np.reshape(list(rows.values()), (len(rows), n))),
            points=tuple(rows),
            notes=joined.notes,
        )
        new = _unknowns(joined, fixed)
        system = replace(outer._with(new.forward), contact=joined.contact_in(new))
        refuse(
            f"load {load.on!r}: what holds the structure takes all of it; load a free part"
            for load in system.loads
            if not np.any(load.vector)
        )
        system = _definite(system, C is not None)
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
            What finds the frequencies in place of `skfem_joint.system.modes.rayleigh_fit`: a
            `skfem_joint.system.modes.KnownFit`, which keeps them for a system with the same.

        Raises
        ------
        InputError
            For a ratio out of range, and if nothing vibrates.
        """
        refuse(ratio_problems(ratio, {}))
        fit = fitted(*self.closed().stuck_problem)
        mass, stiffness = fit.factors(ratio)
        notes = *self.notes, fit.note(ratio)
        return replace(self, C=mass * self.M + stiffness * self.K, notes=notes)

    def expand(self, u: FloatArray) -> FloatArray:
        """Displacement of all degrees of freedom, (..., N), from the unknowns, (..., n).

        Raises
        ------
        InputError
            For arrays of another shape.
        """
        u = np.asarray(u)
        refuse(wrong_shapes({"expand: u": (u, (*u.shape[:-1], self.n))}))
        return u if self.T is None else expanded(self.T, u)

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
            springs in series take is no part of it, see `Contact.slider_peak`.
        period : float
            Duration of the cycle, s; 0 where points do not creep, as on a quasi-static path.
        """
        diagonal = np.asarray(self.K.diagonal(), dtype=float)
        compliance = np.divide(1.0, diagonal, out=np.zeros_like(diagonal), where=diagonal > 0.0)
        contact, B = self.contact, self.contact.B
        squares = B * B if isinstance(B, np.ndarray) else B.power(2)
        held = contact.w * contact.by_point(np.asarray(squares @ compliance))
        elastic = np.maximum(period / contact.beta, SLIPPING_SHARE * held)
        largest = slip.max(axis=-1, initial=0.0, keepdims=True)
        return np.asarray(contact.rubs & (slip > np.maximum(SLIPPING_SHARE * largest, elastic)))

    def slipping_share(self, slip: FloatArray, period: float = 0.0) -> FloatArray:
        """Share of the friction limits whose points slip, (...), see `slipping`; 0 without any."""
        whole = float(self.contact.w.sum())
        part = self.slipping(slip, period) @ self.contact.w
        return np.asarray(part / whole if whole else 0.0 * part)

    def slips_as_a_whole(self, slip: FloatArray, period: float = 0.0) -> bool:
        """Whether points with 99 % of the friction limit of a joint slip, see `slipping`."""
        return self.contact.least_share(~self.slipping(slip, period)) <= 1.0 - WHOLE_SHARE

    def frequency_of(self, u: FloatArray) -> float:
        """Frequency of free vibration in the shape ``u`` by Rayleigh's quotient, rad/s."""
        stiffness, mass = float(u @ (self.K @ u)), float(u @ (self.M @ u))
        contact = self.contact
        slip = contact.B @ u  # whose sliders stick
        stiffness += float(slip @ (contact.on_rows(contact.spring_constants) * slip))
        return float(np.sqrt(max(stiffness / mass, 0.0))) if mass > 0.0 else 0.0

    def stored_energy(
        self,
        u: FloatArray,
        v: FloatArray,
        sigma: FloatArray | None = None,
        limits: FloatArray | None = None,
    ) -> float:
        """Kinetic plus strain energy, J; with ``sigma`` (rows,), that of springs included.

        That of contact that opens is zero at rest. ``sigma`` is the friction over its limit, which
        in a spring in series is its force, and ``limits``, (m,), N, are these limits, those at rest
        if not given.
        """
        return float(0.5 * (v @ (self.M @ v))) + self.strain_energy(u, sigma, limits)

    def strain_energy(
        self, u: FloatArray, sigma: FloatArray | None = None, limits: FloatArray | None = None
    ) -> float:
        """Strain energy, J; arguments as of `stored_energy`."""
        energy = float(0.5 * (u @ (self.K @ u))) + self.contact.normal.potential(u)
        if sigma is None or not self.contact.has_springs:
            return energy
        return energy + self.contact.spring_energy(sigma, limits)

    def load_amplitudes(self, times: FloatArray) -> FloatArray:
        """Amplitudes of all loads, shape (loads, times), N."""
        rows = [load.amplitude(times) for load in self.loads]
        return np.reshape(np.asarray(rows, dtype=float), (len(rows), times.size))

    def load_vectors(self) -> FloatArray:
        """Spatial load vectors, shape (n, loads)."""
        rows = np.reshape([load.vector for load in self.loads], (len(self.loads), self.n))
        return np.ascontiguousarray(rows.T)


def _all_from(T: Matrix, V: Matrix) -> Matrix:
    """All degrees of freedom from unknowns q of u = V q; an operator is not multiplied out."""
    if T is None:
        return V
    return T @ (aslinearoperator(V) if isinstance(T, LinearOperator) else V)


def _check_damping(C: Matrix, stiffness: float, mass: float, ratio: float | None) -> None:
    """Refuse wrong factors of the damping, and a ratio beside factors or a matrix ``C``."""
    check_some(NOT_NEGATIVE, stiffness_damping=stiffness, mass_damping=mass)
    if C is not None and (stiffness or mass):
        raise InputError(
            "damping: found stiffness_damping or mass_damping beside C, which is the whole "
            "damping matrix; leave them out, or add their part to C"
        )
    if ratio is not None:
        others = {"C": C is not None, "stiffness": stiffness, "mass": mass}
        refuse(ratio_problems(ratio, others))


def vector_of(value: ArrayLike, n: int, what: str, first: int = 0) -> FloatArray:
    """Vector of shape (n,), given as such, or a unit vector by the number of its unknown.

    Numbers count from ``first``.
    """
    array = np.asarray(dense_rows(value))
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
    refuse(wrong_shapes({name: (A, (n, n)) for name, A in real.items()}))
    return real


def _joined(given: SlipRows | Sequence[SlipRows] | None, n: int) -> SlipRows:
    """Slip rows with real entries; InputError if they do not act on ``n`` unknowns."""
    parts: list[Any] = [*given] if isinstance(given, list | tuple) else [given]
    parts = [SlipRows.none(n)] if parts in ([], [None]) else parts
    refuse(
        f"contact: found {type(part).__name__}, must be what contact, point_friction, "
        "point_contact or iwan returns, or a list of these"
        for part in parts
        if not isinstance(part, SlipRows)
    )
    contact: SlipRows = functools.reduce(operator.add, parts)
    rows = {name: as_real(getattr(contact, name), f"contact: {name}") for name in ("B", "closed")}
    refuse(wrong_shapes({f"contact: {name}": (A, (A.shape[0], n)) for name, A in rows.items()}))
    return replace(contact, **rows)


def _unknowns(contact: SlipRows, fixed: IntArray) -> ChangeOfUnknowns:
    """Unknowns among which are the slips, and the approaches of contact that opens.

    Approaches of elastic contact may depend on slips or on each other, and are no unknowns then.
    """
    try:
        return contact.change_of_unknowns(fixed)
    except InputError as error:
        if contact.normal is None:
            raise
        new = contact.change_of_unknowns(fixed, approaches=False)
        if contact.normal.part.rigid.any():
            raise InputError(
                "contact that opens: a point approaches by the displacement of another one, or by "
                "a slip: points that touch at one place share their force in a way that rigid "
                "contact leaves open, and one that touches could not slip; give all that open a "
                "finite normal_stiffness, or leave out those that follow from others"
            ) from error
        return new


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


_Solver = Callable[[FloatArray], FloatArray]
#: What is wrong with matrices that are not definite, or semidefinite.
_WRONG = {
    "M": "is not positive definite: does every unknown have mass?",
    "K": "is indefinite: is a sign wrong, a prestress large, or has its file too few digits?",
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


def _definite(system: System, damped: bool) -> System:
    """The system, with the motions that strain nothing as far as the check finds them.

    A mass that is not positive definite, and a stiffness or damping that is indefinite, are
    refused. Stiffness and damping may be singular or zero: friction or contact alone may hold a
    body. The damping is checked only if it is ``damped`` by a matrix of its own.
    """
    stiffness = _semidefinite(system.K)
    wrong = {
        "M": _solver(system.M) is None,
        "K": stiffness is None,
        "C": damped and _semidefinite(system.C) is None,
    }
    refuse(f"{name}: {_WRONG[name]}" for name, is_wrong in wrong.items() if is_wrong)
    found = None if stiffness is None else hardly_straining(*stiffness)
    if found is None:
        return system
    loose, few = found
    K, M, contact = system.K, system.M, system.contact
    rubs = sparse.csr_array(contact.B)[np.flatnonzero(contact.on_rows(contact.w))]
    more = [*notes_of_weak_springs(K, M, loose[:, :few]), *notes_of_shift(K, M, loose, rubs)]
    notes = *system.notes, *more
    return replace(system, loose=sparse.csr_array(loose), notes=notes)


def _semidefinite(A: Matrix) -> tuple[Matrix, _Solver, FloatArray] | None:
    """A positive semidefinite matrix with ones on its diagonal, its solver, and unknowns' sizes.

    None where it is indefinite by more than round-off. It is divided by the roots of its diagonal
    on both sides, so that the units of the unknowns do not matter, and 1e-9 of the unit matrix is
    added before it is factorised. Diagonal entries below 1e-12 of the largest are round-off.
    """
    A = sparse.csr_array(A, copy=True)  # zeros are taken out in place
    A.eliminate_zeros()
    if not A.nnz:
        return A, lambda right: right, np.ones(A.shape[0])
    diagonal = A.diagonal()
    least = 1e-12 * float(np.abs(diagonal).max())
    if least == 0.0 or diagonal.min() < -least:
        return None
    size = 1.0 / np.sqrt(np.maximum(diagonal, 0.0) + least)
    divided = sparse.diags_array(size) @ A @ sparse.diags_array(size)
    solve = _solver(divided + 1e-9 * sparse.eye_array(A.shape[0]))
    return None if solve is None else (divided, solve, size)


def _solver(A: Matrix) -> _Solver | None:
    """Solver of a symmetric matrix that is positive definite by all its pivots; None of another."""
    try:
        pivots, solve = with_pivots(A)
    except RuntimeError:  # the factorisation stops at a pivot that is exactly zero
        return None
    return solve if np.all(pivots > 0.0) else None
