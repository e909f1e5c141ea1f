"""Cases, and the matrix of stiff and extreme ones that ``cases.toml`` lists."""

import tomllib
from dataclasses import dataclass, replace
from functools import cache
from itertools import product
from math import inf, prod, sqrt
from pathlib import Path
from typing import Any

#: Young's modulus (Pa) and density (kg/m3) of cases that do not change them, speed of their waves.
E, DENSITY, SPEED = 200e9, 8000.0, 5000.0
#: Systems of units: their length in m, mass in kg and time in s.
UNITS = {
    "": (1.0, 1.0, 1.0),
    "mm, t, s": (1e-3, 1e3, 1.0),
    "um, kg, us": (1e-6, 1.0, 1e-6),
    "km, g, h": (1e3, 1e-3, 3600.0),
}
#: Directions of a load on plates.
DIRECTIONS = {"along": (1.0, 0.0), "across": (0.0, 1.0), "oblique": (1.0, 0.3)}
#: A plate on a rigid base, pressed on its area or its lower edge; and two plates on each other over
#: half of their length, with nodes that match or not, or side by side.
ONE, TWO = ("base", "edge"), ("lap", "lap of other nodes", "side by side")


@dataclass(frozen=True)
class Case:
    """Bodies with a joint, their load, and how they are integrated; the default is an easy bar.

    SI units, but the model is made in others if ``units`` says so. An impulse rises in
    ``duration`` steps, if given, or in half a period.
    """

    axis: str = "easy"  # what the case tries,
    value: str = ""  # and how far it goes there
    bodies: str = "bar"  # or one of ONE and TWO
    elements: tuple[int, ...] = (40,)  # along, and across plates, of each body
    kind: Any = "quadrilateral"  # of a plate's elements, or "triangle"
    order: int = 1  # of the displacement
    length: float = 0.25  # other sizes follow in proportion
    grading: float = 1.0  # longest over shortest element of a bar
    aspect: float = 1.0  # length over height of a plate's element
    stiffness: float = 1.0  # factor of Young's modulus
    density: float = 1.0  # factor of the density
    stiffness_ratio: float = 1.0  # half of a bar at the support, or lower plate, over the other
    density_ratio: float = 1.0  # the same
    poisson: float = 0.3
    plane: str = "stress"
    damping: float = 1e-5  # in proportion to the stiffness, s
    pressure: float = 8e6
    friction: float = 0.7
    pressed: str = "all"  # "one node" in the middle; a million to one: "halves", "alternating"
    part: float = 1.0  # share of a plate on a base that is pressed
    second_friction: float | None = None  # of the half at the support, if a joint of its own
    beta: float = 1e5  # inf: Coulomb
    held: bool = True  # at the left end; if not, by friction alone
    turned: float = 0.0  # angle of the whole, degrees
    load: str = "harmonic"  # "triangle", "half sine", "versine", "rectangle" or "ramp"
    direction: str = "along"  # of the load on plates
    share: float = 0.9  # force over the friction limit,
    force: float | None = None  # or the force itself
    frequency: float = 1000.0
    phase: float = 0.0
    steps: int = 100  # per period
    periods: int = 3
    duration: float | None = None
    solver: str = "implicit"  # or "explicit"
    rho: float = 1.0  # spectral radius of the implicit scheme at infinite frequency
    step_factor: float | None = None  # explicit step over the stable one, instead of steps
    model: str = "full"  # "reduced" or "hyper-reduced"
    modes: int | None = None  # None: as many as there are
    mode_scales: float = 0.0  # decades that the modes' scales are spread over
    dependent: str = ""  # how dependent modes are added: "raw", or "dropped" by orthonormalizing
    units: str = ""
    must_refuse: bool = False  # whether an answer of any kind would be wrong

    @property
    def step(self):
        return 1.0 / self.frequency / self.steps

    @property
    def is_plate(self):
        return self.bodies != "bar"

    @property
    def scheme(self):
        """Name of the scheme or model, as in the picture."""
        if self.solver == "explicit":
            return "explicit Runge-Kutta"
        name = f"rho = {self.rho:g}" if self.model == "full" else self.model
        return f"plates, {name}" if self.is_plate else name

    @property
    def natural(self):
        """Period of the slowest vibration along the body, held at one end, s."""
        return 4.0 * self.length / SPEED * sqrt(self.density / self.stiffness)

    @property
    def work(self):
        """Estimate of the time that the case takes, in no unit."""
        fixed, each = (1000.0, 10.0) if self.is_plate else (20.0, 1.0)
        return self.steps * self.periods * (fixed + each * prod(self.elements) * self.order**2)


TABLE = tomllib.loads((Path(__file__).parent / "cases.toml").read_text(encoding="utf-8"))
LISTS = TABLE["lists"]
BETAS, RADII, PLATE_RADII = (LISTS[name] for name in ("BETAS", "RADII", "PLATE_RADII"))
#: Easy cases, and how many of each axis are in a quick matrix.
BAR = Case()
PLATE = Case(bodies="base", elements=(8, 2), direction="oblique", steps=50, periods=1)
EASY = {"bar": (BAR, 3), "plate": (PLATE, 1)}


def _fields(row):
    """Fields of a row in their order, shared ones in the place of ``with``, lists for names."""
    for key, value in row.items():
        if key == "with":
            for name in [value] if isinstance(value, str) else value:
                yield from _fields(TABLE["with"][name])
        elif key == "elements" and not isinstance(value[0], list):
            yield key, tuple(value)
        else:
            yield key, LISTS[value] if isinstance(value, str) and value.isupper() else value


def _varied(base, row):
    """Cases of all combinations of the values of a row's lists, named by these values."""
    fields = dict(_fields(row))
    lists = {key: fields.pop(key) for key in [*fields] if isinstance(fields[key], list)}
    for values in product(*lists.values()):
        changes = {key: _value(value) for key, value in zip(lists, values, strict=True)}
        name = ", ".join(f"{key} {_text(value)}" for key, value in changes.items())
        yield replace(base, value=name, **fields, **changes)


def _value(value):
    value = None if value == "all modes" else value
    return tuple(value) if isinstance(value, list) else value


def _text(value):
    if isinstance(value, float):
        return "Coulomb" if value == inf else f"{value:g}"
    return " x ".join(map(_text, value)) if isinstance(value, tuple) else str(value)


@cache
def matrix():
    return [
        case for kind in EASY for row in TABLE["rows"][kind] for case in _varied(EASY[kind][0], row)
    ]


def quick_matrix():
    """A few cases of each axis, for a quick check and for tests."""
    few = {}
    for case in matrix():
        if case.steps * case.periods <= 1000 and case.elements[0] <= 1000:
            few.setdefault(case.axis, []).append(case)
    kept = [(EASY["plate" if cases[0].is_plate else "bar"][1], cases) for cases in few.values()]
    return [case for n, cases in kept for case in cases[:: max(1, (len(cases) - 1) // n)]]
