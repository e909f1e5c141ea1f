"""Random small systems with friction and contact, for the package and for `moreau`; SI units."""

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from moreau import Equations
from scipy import sparse

import skfem_joint as sj
from skfem_joint.system.slips import NormalRows, SlipRows

INF = np.inf
NORMAL = "gap", "force", "stiffness"


@dataclass(frozen=True)
class RandomContact:
    """Matrices on N degrees of freedom, some of them held, with contact, loads and a plan.

    Attributes
    ----------
    kind : str
        What it stands for.
    M, C, K : ndarray, shape (N, N)
    B : list of ndarray, shape (1 or 2, N)
        Slip of each friction point.
    D : ndarray, shape (q, N)
        Approach of each normal point; no rows for constant normal forces.
    values : dict
        ``given``, ``beta``, ``spring`` of the friction points; ``gap``, ``force``, ``stiffness`` of
        the normal points; ``gain``, shape (m, q).
    held : ndarray of int
    loads : dict
        By name, vector (N,) and amplitude.
    step, n_steps, rho
    dense : bool
        Whether matrices are dense, as those of reduced models.
    """

    kind: str
    M: Any
    C: Any
    K: Any
    B: list[Any]
    D: Any
    values: dict[str, Any]
    held: Any
    loads: dict[str, Any]
    step: float
    n_steps: int
    rho: float
    dense: bool

    @property
    def free(self) -> Any:
        return np.setdiff1d(np.arange(len(self.M)), self.held)

    @property
    def observed(self) -> Any:
        """Displacements of the named points from the free degrees of freedom."""
        rows = np.eye(len(self.M))[self.free]
        if self.held.size:
            rows = np.vstack([*(f for f, _ in self.loads.values()), rows])
        return rows[:, self.free]

    @property
    def normal(self) -> sj.NormalPart:
        """Contact that opens, on all degrees of freedom."""
        x = self.values
        values = x["gap"], x["force"], x["stiffness"], np.ones(len(self.D))
        return sj.NormalPart(sparse.csr_array(self.D), *values)

    @property
    def at_rest(self) -> Any:
        return self.values["given"] + self.values["gain"] @ self.values["force"]

    def system(self) -> sj.System:
        """The system: by `System.from_matrices` where degrees of freedom are held."""
        system = self._sparse()
        if not self.dense:
            return system
        T = np.linalg.qr(np.random.default_rng(0).normal(size=(system.n, system.n)))[0]
        return replace(system.project(T), T=None)

    def _sparse(self) -> sj.System:
        x, n = self.values, len(self.M)
        directions = np.array([len(rows) for rows in self.B], dtype=np.int64)
        rows = sparse.csr_array(np.vstack([*self.B, np.zeros((0, n))]))
        if not self.held.size:
            loads = [sj.AppliedLoad(f, a, name) for name, (f, a) in self.loads.items()]
            contact = sj.Contact(
                rows, x["given"], x["beta"], directions, x["spring"], self.normal,
                sparse.csr_array(x["gain"]),
            )  # fmt: skip
            return sj.System(
                *(sparse.csr_array(A) for A in (self.M, self.C, self.K)), contact, tuple(loads),
                sparse.eye_array(n, format="csr"), tuple(map(str, range(n))),
            )  # fmt: skip
        normal = None
        if len(self.D):
            pivots = np.array([np.abs(row).argmax() for row in self.D])
            nodes = replace(self.normal, N=sparse.eye_array(len(pivots), format="csr"))
            gain = sparse.csr_array(x["gain"])
            normal = NormalRows(sparse.csr_array(self.D), pivots, nodes, gain)
        slips = SlipRows(
            rows, self.at_rest, x["beta"], directions, sparse.csr_array((0, n)),
            stiffness=x["spring"], normal=normal,
        )  # fmt: skip
        return sj.System.from_matrices(
            *(sparse.csr_array(A) for A in (self.M, self.K, self.C)), fixed=self.held,
            contact=slips, loads=self.loads, points={f"x{i}": int(i) for i in self.free},
        )  # fmt: skip

    def equations(self) -> Equations:
        """The same for `moreau.march`, on the free degrees of freedom."""
        free, x = self.free, self.values
        vectors = np.array([f[free] for f, _ in self.loads.values()])
        amplitudes = [a for _, a in self.loads.values()]

        def load(t: Any) -> Any:
            return np.array([a(t) for a in amplitudes]).T @ vectors

        M, C, K = (A[np.ix_(free, free)] for A in (self.M, self.C, self.K))
        # What is held altogether neither slips nor approaches: its normal force stays.
        B = [rows[:, free][rows[:, free].any(axis=1)] for rows in self.B]
        slips = np.array([len(rows) > 0 for rows in B], dtype=bool)
        moves = self.D[:, free].any(axis=1)
        given = x["given"] + x["gain"][:, ~moves] @ x["force"][~moves]
        return Equations(
            M, C, K, load, self.D[moves][:, free], *(x[k][moves] for k in NORMAL),
            np.vstack([*B, np.zeros((0, free.size))]),
            np.array([len(rows) for rows in B if len(rows)], dtype=np.int64), given[slips],
            x["gain"][np.ix_(slips, moves)], x["beta"][slips], x["spring"][slips],
        )  # fmt: skip


def _amplitude(rng: Any, size: float, duration: float) -> Any:
    """Load of about this size, N."""
    kind = rng.integers(6)
    if kind < 2:
        return sj.Harmonic(size, rng.uniform(1.0, 4.0) / duration, rng.choice([0.0, 1.0]))
    if kind == 2:
        f = rng.uniform(1.0, 2.0) / duration
        return sj.MultiHarmonic([sj.Harmonic(size, f), sj.Harmonic(0.6 * size, 3.0 * f, 1.0)])
    if kind == 3:
        return sj.RampAndHold(size, 0.15 * duration)
    pulse = (sj.HalfSine, sj.Triangle, sj.Versine)[rng.integers(3)]
    return pulse(2.0 * size, rng.uniform(0.05, 0.15) * duration, rng.choice([0.0, 0.2]) * duration)


def _springs(rng: Any, nodes: int, dim: int, grounded: float) -> Any:
    """Stiffness of springs between neighbours, some others, and to the ground, N/m."""
    K = np.zeros((nodes * dim, nodes * dim))
    pairs = [(i, i + 1) for i in range(nodes - 1)]
    pairs += [(i, j) for i in range(nodes) for j in range(i + 2, nodes) if rng.random() < 0.2]
    pairs += [(i, None) for i in range(nodes) if rng.random() < grounded]
    for i, j in pairs:
        stiff = (2.0 * np.pi * rng.uniform(0.5, 4.0)) ** 2
        block = np.diag(stiff * rng.uniform(0.3, 1.0, dim))
        if rng.random() < 0.5:
            along = rng.normal(size=dim)
            block += stiff * np.outer(along, along) / (along @ along)
        ends = np.zeros((dim, nodes * dim))
        ends[:, dim * i : dim * (i + 1)] = np.eye(dim)
        if j is not None:
            ends[:, dim * j : dim * (j + 1)] = -np.eye(dim)
        K += ends.T @ block @ ends
    return K


def random_contact(seed: int) -> RandomContact:
    """One of the random systems."""
    rng = np.random.default_rng(seed)
    opens, chain = rng.random() < 0.7, rng.random() < 0.25
    across = 1 if chain else int(rng.integers(1, 3))
    dim = across + (1 if opens or (not chain and rng.random() < 0.3) else 0)
    nodes = int(rng.integers(1, 8 // dim + 1)) if dim > 1 else int(rng.integers(2, 7))
    n, duration = nodes * dim, rng.uniform(1.0, 2.0)
    flight = opens and rng.random() < 0.5
    mass = np.repeat(rng.uniform(0.5, 2.0, nodes), dim)
    M = np.diag(mass)
    if rng.random() < 0.3 and not chain:
        A = rng.normal(size=(n, n))
        M = M + 0.1 * A @ A.T / n
    K = _springs(rng, nodes, dim, 0.0 if flight and rng.random() < 0.5 else 0.6)
    C = rng.choice([0.0, 0.002]) * K + rng.choice([0.0, 0.2]) * M
    law = rng.choice(["coulomb", "arctan", "mixed"])
    # Reduced models have elastic contact and laws with a finite slope.
    dense = law == "arctan" and rng.random() < 0.5
    held = np.zeros(0, dtype=np.intp)
    if n > 2 and not dense and rng.random() < 0.25:
        held = np.sort(rng.choice(n, size=int(rng.integers(1, 1 + n // 3)), replace=False))
    # contact points
    points = int(rng.integers(1, min(4, nodes) + 1))
    places, unit = rng.permutation(nodes)[:points], np.eye(n)
    B, D, point_of = [], [], []
    sprung, x = [], {name: [] for name in ("gap", "force", "stiffness")}
    for place in places:
        own = unit[dim * place : dim * place + across]
        if nodes > 1 and rng.random() < 0.2 and not flight:
            other = (place + 1) % nodes
            if other not in places:
                own = own - unit[dim * other : dim * other + across]
        spring = rng.random() < 0.4 and not (dense and opens)
        # Points that share a node: on springs, or by a law with a finite slope (given matrices).
        shares = spring or (law == "arctan" and not opens and not held.size)
        copies = 1 + int(shares and rng.random() < 0.3)
        B += copies * [own]
        sprung += copies * [spring]
        point_of += copies * [len(D)]
        if not opens:
            continue
        pressed = not flight or rng.random() < 0.3
        # In dense systems a node may have a second stop: behind the first, or on its other side.
        for second in range(1 + int(dense and rng.random() < 0.5)):
            D.append(unit[dim * place + across] * (rng.choice([-1.0, 1.0]) if second else 1.0))
            touches = pressed or rng.random() < 0.2
            x["gap"].append(rng.uniform(2e-3, 3e-2) if second or not touches else 0.0)
            x["force"].append(rng.uniform(0.5, 3.0) if pressed and not second else 0.0)
            soft = dense or rng.random() < 0.4
            x["stiffness"].append((2.0 * np.pi * rng.uniform(4.0, 20.0)) ** 2 if soft else INF)
    m, q = len(B), len(D)
    gain, given = np.zeros((m, q)), np.zeros(m)
    for j in range(m):
        if opens and rng.random() < 0.8:
            gain[j, point_of[j]] = rng.uniform(0.1, 0.6)
            if q > 1 and rng.random() < 0.15:
                gain[j, rng.integers(q)] = 0.2
        if not gain[j].any() or rng.random() < 0.15:
            given[j] = rng.uniform(0.1, 1.0)
    beta = 10.0 ** rng.uniform(0.7, 3.0, m)
    beta[(law == "coulomb") | ((law == "mixed") & (rng.random(m) < 0.5))] = INF
    stiff = (2.0 * np.pi * rng.uniform(3.0, 15.0, m)) ** 2
    x = {name: np.array(value, dtype=float) for name, value in x.items()}
    x |= {"gain": gain, "given": given, "beta": beta, "spring": np.where(sprung, stiff, INF)}
    size = float((given + gain @ x["force"]).mean()) or 1.0
    loads = {}
    for name in ("one", "other")[: rng.integers(1, 3)]:
        vector = rng.normal(size=n)
        if opens and rng.random() < 0.7:
            vector[across::dim] = np.abs(vector[across::dim]) * rng.uniform(1.0, 3.0)
        loads[name] = vector, _amplitude(rng, size * rng.uniform(0.7, 3.0), duration)
    steps = int(rng.integers(120, 301))
    return RandomContact(
        "flight" if flight else "opens" if opens else "chain" if chain else "constant",
        M, C, K, B, np.reshape(D, (q, n)), x, held, loads, duration / steps, steps,
        float(rng.choice([1.0, 0.8, 0.5, 0.0])),
        dense,
    )  # fmt: skip
