"""What cases of bars and of plates share: load, steps, law, and how variants of one are made."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product
from math import inf
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from skfem_joint.loads import HalfSine, Harmonic, Load, RampAndHold, Rectangle, Triangle, Versine

FloatArray = NDArray[np.float64]

#: Young's modulus (Pa) and density (kg/m3) of cases that do not change them.
E, DENSITY = 200e9, 8000.0
#: Speed of waves in a bar of that material, m/s.
SPEED = 5000.0
#: Units other than kg, m, s: their length in m, mass in kg and time in s.
UNITS = {
    "mm, t, s": (1e-3, 1e3, 1.0),
    "um, kg, us": (1e-6, 1.0, 1e-6),
    "km, g, h": (1e3, 1e-3, 3600.0),
}


@dataclass(frozen=True)
class Case:
    """A joint, its load, and how it is integrated.

    Attributes
    ----------
    axis, value : str
        What the case tries, and how far it goes there.
    length : float
        m; other sizes follow in proportion.
    damping : float
        Stiffness damping, s.
    pressure, friction : float
        Pa and dimensionless; the friction limit of the joint follows.
    pressed : str
        Where the pressure acts: "all", "one node" (the middle one), "halves" (a jump of a million
        to one in the middle; bars only) or "alternating" (a million to one from node to node).
    beta : float
        s/m; ``inf`` is Coulomb.
    load : str
        "harmonic", "triangle", "half sine", "versine", "rectangle" or "ramp".
    share : float
        Force over the friction limit.
    force : float, optional
        N; instead of a share of the limit.
    frequency : float
        Hz; the load's, and 1 / (2 rise time) of an impulse.
    phase : float
        rad, of a harmonic load.
    steps, periods : int
        Steps per period and periods; an impulse of ``duration`` is inside one of them.
    duration : float, optional
        Rise time of an impulse in steps.
    solver : str
        "implicit" or "explicit".
    rho : float
        Spectral radius of the implicit scheme at infinite frequency.
    model : str
        "full", "reduced" or "hyper-reduced".
    modes : int, optional
        Proper orthogonal modes; as many as there are if not given.
    units : str
        "" for SI, or a key of :data:`UNITS`.
    must_refuse : bool
        Whether an answer of any kind would be wrong.
    """

    axis: str = "easy"
    value: str = ""
    length: float = 0.25
    damping: float = 1e-5
    pressure: float = 8e6
    friction: float = 0.7
    pressed: str = "all"
    beta: float = 1e5
    load: str = "harmonic"
    share: float = 0.9
    force: float | None = None
    frequency: float = 1000.0
    phase: float = 0.0
    steps: int = 100
    periods: int = 3
    duration: float | None = None
    solver: str = "implicit"
    rho: float = 1.0
    model: str = "full"
    modes: int | None = None
    units: str = ""
    must_refuse: bool = False

    @property
    def step(self) -> float:
        """Time step, s."""
        return 1.0 / self.frequency / self.steps

    @property
    def scheme(self) -> str:
        """Name of the scheme or model, as in the picture."""
        if self.solver == "explicit":
            return "explicit Runge-Kutta"
        return f"rho = {self.rho:g}" if self.model == "full" else self.model

    @property
    def natural(self) -> float:
        """Period of the slowest vibration along the body, held at one end, s."""
        return 4.0 * self.length / SPEED

    @property
    def work(self) -> float:
        """About how long the case takes, in any unit."""
        return float(self.steps * self.periods)


C = TypeVar("C", bound=Case)


def in_units(case: Case) -> tuple[float, float, float]:
    """Length, mass and time units of a case, in SI."""
    return UNITS.get(case.units, (1.0, 1.0, 1.0))


def limits(case: Case, w: FloatArray) -> FloatArray:
    """Friction limits of the contact points, N, where the case spares some."""
    w = w.copy()
    if case.pressed == "one node":
        w[np.arange(w.size) != w.size // 2] = 0.0
    elif case.pressed == "alternating":
        w[1::2] *= 1e-6
    return w


def force_of(case: Case, w: FloatArray) -> float:
    """Peak of the load, N, beside the friction limits ``w``."""
    if case.force is None:
        return case.share * float(w.sum())
    length, mass, time = in_units(case)
    return case.force * time**2 / length / mass


def load_of(case: Case, force: float) -> Load:
    """Load of a case; ``force`` is its peak."""
    time = in_units(case)[2]
    if case.load == "harmonic":
        return Harmonic(force, case.frequency * time, case.phase)
    rise = case.step * case.duration if case.duration else 0.5 / case.frequency
    rise, start = rise / time, 2.3 * case.step / time
    if case.load == "rectangle":
        return Rectangle(force, 2.0 * rise, start)
    kinds: dict[str, Callable[[float, float, float], Load]] = {
        "triangle": Triangle,
        "half sine": HalfSine,
        "versine": Versine,
        "ramp": RampAndHold,
    }
    return kinds[case.load](force, rise, start)


def vary(axis: str, base: C, **values: tuple[object, ...]) -> list[C]:
    """Product of the values of some fields; the name of each case lists them."""
    found = []
    for combination in product(*values.values()):
        changes = dict(zip(values, combination, strict=True))
        name = ", ".join(f"{key} {_text(value)}" for key, value in changes.items())
        found.append(replace(base, axis=axis, value=name, **changes))  # type: ignore[arg-type]
    return found


def _text(value: object) -> str:
    if isinstance(value, float):
        return "Coulomb" if value == inf else f"{value:g}"
    if isinstance(value, tuple):
        return " x ".join(map(_text, value))
    return str(value)
