"""Small systems for the tests of stepping, made by the public interface; SI units."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from math import inf
from typing import Any

import numpy as np
from bodies import MU, STEEL, THICKNESS, WIDTH, pressed, structure
from scipy import sparse

import skfem_joint as sj

FIELDS = sj.Save(fields=True)


def struts(mesh: Any, joints: Sequence[sj.Joint] = (), **changes: Any) -> sj.Structure:
    """Bars of the paper's material and section, held at ``fixed``."""
    values = {"width": WIDTH, "thickness": THICKNESS, "fixed": ("fixed",), "joints": joints,
              "stiffness_damping": 1e-5}  # fmt: skip
    return sj.Structure(mesh, STEEL, **{**values, **changes})


@dataclass(frozen=True)
class LapJoint:
    """Lap joint in contact along its whole length; the default is the paper's reference system."""

    length: float = 0.25
    elements: int = 100
    pressure: float = 8e6
    friction: float = MU
    beta: float = 1e5
    normal_force: Any = "equal"
    force: float = 63e3
    frequency: float = 1000.0
    load: Any = None
    options: Mapping[str, Any] | None = None

    @property
    def tau(self) -> float:
        """Friction limit per length, N/m."""
        return self.friction * self.pressure * WIDTH

    @property
    def amplitude(self) -> Any:
        return self.load or sj.Harmonic(self.force, self.frequency)

    @property
    def joint(self) -> sj.Joint:
        return sj.Joint("joint", self.pressure, self.friction, beta=self.beta,
                     normal_force=self.normal_force)  # fmt: skip

    @property
    def system(self) -> sj.System:
        ends = {"fixed": 0.0, "free_end": self.length}
        bar = sj.build_bar([("joint", self.length, self.elements)], ends)
        made = struts(bar, [self.joint], **(self.options or {}))
        return made.system([sj.Load("free_end", self.amplitude)])


CASE_I = LapJoint(length=0.5, pressure=50e6, force=437.5e3, frequency=2000.0)


def oscillator(
    load: sj.Amplitude, frequency: float = 1.0, damping_ratio: float = 0.05
) -> sj.System:
    """Single mass on a spring without friction, observed as ``mass``."""
    omega, one = 2.0 * np.pi * frequency, np.ones((1, 1))
    return sj.System(
        M=one,
        C=2.0 * damping_ratio * omega * one,
        K=omega**2 * one,
        contact=sj.Contact(np.zeros((0, 1)), np.zeros(0), np.zeros(0)),
        loads=(sj.AppliedLoad(np.ones(1), load, "mass"),),
        P=one,
        points=("mass",),
    )


def arm(
    load: Any = None, joint: sj.Joint | None = None, elements: tuple[int, int] = (40, 40),
    **changes: Any,
) -> sj.System:  # fmt: skip
    """Bar of 0.7 m in contact on its first 0.2 m, loaded at its far ``end``: 2.5 kHz if stuck."""
    regions = [("joint", 0.2, elements[0]), ("free", 0.5, elements[1])]
    mesh = sj.build_bar(regions, {"fixed": 0.0, "end": 0.7})
    joint = joint or sj.Joint("joint", 50e6, MU, beta=inf)
    made = struts(mesh, [joint], **{"stiffness_damping": 0.0, **changes})
    return made.system([sj.Load("end", load)] if load else [], ["end"])


def reference_plate(
    beta: float = 1e5, elements: tuple[int, int] = (20, 4), load: Any = None
) -> sj.System:
    """The paper's reference system as a plate, pulled along it and a little across."""
    mesh = sj.build_plate([("joint", 0.25, elements[0])], WIDTH, elements[1])
    made = structure(mesh, [pressed(beta=beta)], stiffness_damping=1e-5)
    return made.system([sj.Load("right", load or sj.Harmonic(60e3, 1000.0), (1.0, 0.2))])


def dense_system(singles: int = 0, pairs: int = 6, **changes: Any) -> sj.System:
    """Dense system with random points that slip in two directions and in one."""
    generator, n = np.random.default_rng(7), 4
    A = generator.standard_normal((n, n))
    directions = generator.permutation(np.repeat([2, 1], [pairs, singles])).astype(np.int64)
    values: dict[str, Any] = {
        "M": np.eye(n),
        "C": 0.02 * (A @ A.T + n * np.eye(n)),
        "K": 4.0 * (A @ A.T + n * np.eye(n)),
        "contact": sj.Contact(
            generator.standard_normal((int(directions.sum()), n)),
            generator.uniform(0.05, 0.3, pairs + singles),
            np.full(pairs + singles, 1e3),
            directions,
        ),
        "loads": tuple(
            sj.AppliedLoad(generator.standard_normal(n), sj.Harmonic(4.0, f, f), f"{f}")
            for f in (0.3, 1)
        ),
        "P": np.eye(n),
        "points": tuple("abcdefgh"[:n]),
    }
    return sj.System(**{**values, **changes})


def relative_slips(n: int = 30, beta: float = 1e3, load: Any = None) -> sj.System:
    """Two equal bars side by side that slip against each other: rows of B with two entries."""
    bar = LapJoint(elements=n, beta=1.0).system
    both = [sparse.csr_array(sparse.block_diag([A, A])) for A in (bar.M, bar.C, bar.K)]
    rows = sparse.csr_array(sparse.hstack([sparse.eye_array(n), -sparse.eye_array(n)]))
    vector = np.zeros(2 * n)
    vector[n - 1] = 1.0
    pull = sj.AppliedLoad(vector, load or sj.Harmonic(63e3, 1000.0), "end")
    P = sparse.csr_array(np.eye(2 * n)[[n - 1, 2 * n - 1]])
    M, C, K = both
    return sj.System(
        M,
        C,
        K,
        sj.Contact(rows, bar.contact.w, np.full(n, beta)),
        loads=(pull,),
        P=P,
        points=("one", "other"),
    )


def not_a_chain(system: sj.System) -> sj.System:
    """The chain with its ends coupled, too weakly to matter: it is stepped as contact is."""
    K = system.K.tolil()
    K[0, -1] = K[-1, 0] = 1e-14 * system.K.diagonal().max()
    return replace(system, K=sparse.csr_array(K))


def run_of(system: sj.System, n_steps: int = 100, **changes: Any) -> sj.Run:
    """Steps of 10 µs, with fields."""
    return sj.integrate(system, **{"step": 1e-5, "n_steps": n_steps, "save": FIELDS, **changes})


def order_of(errors: Sequence[float], steps: Sequence[float]) -> float:
    """Slope of log error against log step."""
    return float(np.polyfit(np.log(steps), np.log(errors), 1)[0])


def differing(one: Any, other: Any, where: str = "") -> list[str]:
    """Attributes of two results that are not equal to the bit, but for times and notes."""
    if is_dataclass(one):
        own = ("wall_s", "preparation_s", "compilation_s", "system", "notes")
        names = [f.name for f in fields(one) if f.name not in own]
        pairs = [(getattr(one, n), getattr(other, n), f"{where}.{n}") for n in names]
        return [name for a, b, place in pairs for name in differing(a, b, place)]
    if isinstance(one, tuple):
        pairs = [(a, b, f"{where}[{i}]") for i, (a, b) in enumerate(zip(one, other, strict=True))]
        return [name for a, b, place in pairs for name in differing(a, b, place)]
    if isinstance(one, np.ndarray):
        return [] if one.shape == other.shape and one.tobytes() == other.tobytes() else [where]
    return [] if one == other else [where]


def of_stepper(kind: str, load: Any = None) -> sj.System:
    """System for one of the steppers, or for one of the ways into it."""
    joint = LapJoint(elements=30, load=load)
    basis = np.linalg.qr(np.vander(np.linspace(1 / 30, 1.0, 30), 6)[:, :5])[0]  # zero at the wall
    make: dict[str, Callable[[], sj.System]] = {
        "chain": lambda: joint.system,
        "Coulomb": lambda: replace(joint, beta=inf).system,
        "dense": lambda: joint.system.project(basis),
        "linear": lambda: replace(joint, friction=0.0).system,
        "contact": lambda: reference_plate(1e5, (10, 2), load),
        "contact Coulomb": lambda: reference_plate(inf, (10, 2), load),
        "relative": lambda: relative_slips(load=load),
    }
    return make[kind]()


STEPPERS = ["chain", "Coulomb", "dense", "linear", "contact", "contact Coulomb", "relative"]
