"""The matrix of stiff and extreme cases, as plain data, and what each of them is made of."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import product
from math import inf, pi

import numpy as np
from numpy.typing import NDArray

from skfem_joint.contact import PressureTable
from skfem_joint.loads import HalfSine, Harmonic, Load, RampAndHold, Rectangle, Triangle, Versine
from skfem_joint.meshing import BarMesh, build_bar
from skfem_joint.structure import Joint, Structure, assemble, build_structure
from skfem_joint.system import System

FloatArray = NDArray[np.float64]

#: Speed of waves in the bar of every case that does not change its material, m/s.
SPEED = 5000.0
BETAS = (*(10.0**k for k in range(2, 13)), inf)
STEPS = (10, 30, 100, 300, 1000, 10_000)
#: Steps per period that the explicit method needs up to beta = 1e3.
MANY = 60_000
RADII = (0.0, 0.5, 0.8, 1.0)
#: Units other than kg, m, s: their length in m, mass in kg and time in s.
MILLIMETRES_AND_TONNES = (1e-3, 1e3, 1.0)
UNITS = {
    "mm, t, s": MILLIMETRES_AND_TONNES,
    "um, kg, us": (1e-6, 1.0, 1e-6),
    "km, g, h": (1e3, 1e-3, 3600.0),
}


@dataclass(frozen=True)
class Case:
    """A bar with a joint, its load, and how it is integrated; the default is an easy case.

    Attributes
    ----------
    axis, value : str
        What the case tries, and how far it goes there.
    elements : int
    length : float
        m; width and thickness follow in proportion.
    grading : float
        Longest over shortest element.
    stiffness_jump, density_jump : float
        Young's modulus and density of the half at the support over those of the other half.
    damping : float
        Stiffness damping, s.
    pressure, friction : float
        Pa and dimensionless; the friction limit of the joint follows.
    pressed : str
        Where the pressure acts: "all", "one node" (the middle one), "halves" (a jump of a million
        to one in the middle) or "alternating" (a million to one from node to node).
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
    step_factor : float, optional
        Step of the explicit method over the stable one, instead of ``steps``.
    model : str
        "full", "reduced" or "hyper-reduced".
    modes : int, optional
        Proper orthogonal modes; as many as unknowns if not given.
    mode_scales : float
        Decades that the modes' scales are spread over.
    dependent : str
        "" or how dependent modes are added: "raw" (as they are) or "dropped" (made orthonormal).
    units : str
        "" for SI, or a key of :data:`UNITS`.
    must_refuse : bool
        Whether an answer of any kind would be wrong.
    """

    axis: str = "easy"
    value: str = ""
    elements: int = 40
    length: float = 0.25
    grading: float = 1.0
    stiffness_jump: float = 1.0
    density_jump: float = 1.0
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
    step_factor: float | None = None
    model: str = "full"
    modes: int | None = None
    mode_scales: float = 0.0
    dependent: str = ""
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


def structure_of(case: Case) -> Structure:
    """Structure of a case, in its units."""
    metre, kilogram, second = (1.0 / unit for unit in UNITS.get(case.units, (1.0, 1.0, 1.0)))
    pascal = kilogram / metre / second**2
    bar = _mesh(case, metre)
    length = case.length * metre
    high = case.pressure * pascal
    pressure: float | PressureTable = high
    if case.pressed == "halves":
        middle, low = 0.5 * length, 1e-6 * high
        pressure = PressureTable(
            (0.0, middle, middle * (1.0 + 1e-9), length), (low, low, high, high)
        )
    E, density = 200e9 * pascal, 8000.0 * kilogram / metre**3
    return build_structure(
        bar,
        E=E,
        density=density,
        width=0.2 * length,
        thickness=0.04 * length,
        fixed=["fixed"],
        joints=[Joint("joint", pressure, case.friction, case.beta * second / metre)],
        stiffness_damping=case.damping * second,
        regions={"half": {"E": E * case.stiffness_jump, "density": density * case.density_jump}}
        if "half" in bar.regions
        else {},
    )


def _mesh(case: Case, metre: float) -> BarMesh:
    """Mesh whose element lengths grow geometrically towards the support."""
    length = case.length * metre
    points = {"fixed": 0.0, "free_end": length}
    if case.grading == 1.0 and case.stiffness_jump == case.density_jump == 1.0:
        return build_bar([("joint", length, case.elements)], points)
    sizes = np.geomspace(case.grading, 1.0, case.elements)
    sizes *= length / sizes.sum()
    bar = build_bar(
        [("joint", float(size), 1) for size in sizes], {**points, "free_end": float(sizes.sum())}
    )
    half = np.arange(case.elements // 2)
    return replace(bar, regions={**bar.regions, "half": half})


def system_of(case: Case) -> System:
    """System of a case, in its units."""
    structure = structure_of(case)
    system = assemble(structure, points=["free_end"])
    w = system.w.copy()
    if case.pressed == "one node":
        w[np.arange(w.size) != w.size // 2] = 0.0
    elif case.pressed == "alternating":
        w[1::2] *= 1e-6
    length, mass, time = UNITS.get(case.units, (1.0, 1.0, 1.0))
    newton = time**2 / (length * mass)
    force = case.share * float(w.sum()) if case.force is None else case.force * newton
    load = load_of(case, force, time)
    applied = assemble(structure, [("free_end", load)], ["free_end"])
    return replace(applied, w=w)


def load_of(case: Case, force: float, time: float = 1.0) -> Load:
    """Load of a case; ``time`` is the unit of time in s."""
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


def _vary(axis: str, base: Case, **values: tuple[object, ...]) -> list[Case]:
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
    return str(value)


#: Gentle, usual and stiffest laws.
FEW = (1e2, 1e5, 1e12, inf)
PULSES = ("triangle", "half sine", "versine", "rectangle", "ramp")


def matrix() -> tuple[Case, ...]:
    """All cases: every scheme over beta and steps per period, the axes singly, the corners."""
    return (*_scheme_maps(), *_single_axes(), *_models(), *_corners())


def quick_matrix() -> tuple[Case, ...]:
    """A few cases of each axis, for a look and for tests."""
    few: dict[str, list[Case]] = {}
    for case in matrix():
        if case.steps * case.periods <= 1000 and case.elements <= 1000:
            few.setdefault(case.axis, []).append(case)
    return tuple(case for cases in few.values() for case in cases[:: max(1, (len(cases) - 1) // 3)])


def _scheme_maps() -> list[Case]:
    base = Case(elements=20, periods=2)
    cases = _vary("scheme", base, rho=RADII, beta=BETAS, steps=STEPS)
    explicit = replace(base, solver="explicit", periods=1)
    cases += _vary("explicit", explicit, beta=BETAS[:-1], steps=STEPS)
    cases += _vary("explicit", explicit, beta=BETAS[:2], steps=(MANY,))
    cases += _vary("explicit", replace(explicit, must_refuse=True), beta=(inf,), steps=STEPS)
    for model in ("reduced", "hyper-reduced"):
        reduced = replace(base, model=model, modes=5)
        cases += _vary(model, reduced, beta=BETAS[:-1], steps=STEPS[:5])
        cases += _vary(model, replace(reduced, must_refuse=True), beta=(inf,), steps=STEPS[:5])
    return cases


def _single_axes() -> list[Case]:
    base = Case()
    ends = (0.0, 1.0)
    half_pi = 0.5 * pi
    switched = replace(base, elements=20)
    return [
        *_vary(
            "frequency", base, frequency=(0.1, 1.0, 10.0, 1e2, 1e4, 5e4), beta=(1e5, inf), rho=ends
        ),
        *_vary(
            "slow",
            replace(base, elements=100, frequency=0.1, periods=2, steps=400),
            share=(0.1, 0.5, 0.9, 1.0),
            beta=(1e12, inf),
            rho=ends,
        ),
        *_vary("load", base, share=(0.01, 0.1, 0.5, 0.99, 0.999, 1.0, 1.2), beta=FEW),
        *_vary(
            "elements",
            replace(base, periods=1),
            elements=(1, 2, 3, 10, 100, 800, 5000, 20_000),
            beta=FEW,
        ),
        *_vary("grading", base, grading=(10.0, 1e2, 1e3, 1e4), beta=FEW),
        *_vary("damping", base, damping=(0.0, 1e-7, 1e-4, 1e-3), beta=FEW),
        *_vary("pressure", base, pressed=("one node", "halves", "alternating"), beta=FEW),
        *_vary("no friction", replace(base, force=1e3), friction=(0.0,), rho=RADII),
        *_vary("no friction", replace(base, force=1e3), pressure=(0.0,), rho=RADII),
        *_vary("stiffness jump", base, stiffness_jump=(1e-6, 1e6), beta=FEW),
        *_vary("density jump", base, density_jump=(1e-6, 1e6), beta=FEW),
        *_vary(
            "pulse",
            replace(base, periods=2),
            load=PULSES,
            duration=(0.01, 0.3, 0.9, 3.0, 10.0, 50.0),
            beta=(1e5, inf),
        ),
        *_vary("no load", base, force=(0.0,), beta=FEW, rho=ends),
        *_vary("switched on", switched, phase=(half_pi,), steps=(30, 100, 1000), rho=RADII),
        *_vary("switched on", switched, phase=(half_pi,), frequency=(0.1, 5e4), rho=RADII),
        *_vary(
            "switched on",
            switched,
            load=("rectangle",),
            duration=(1000.0,),
            steps=(30, 100, 1000),
            rho=RADII,
        ),
        *_vary("force", base, force=(1e-12, 1e12), beta=FEW),
        *_vary("force", base, pressure=(1e-10, 1e14), beta=FEW),
        *_sizes(base),
        *_vary("units", base, units=tuple(UNITS), beta=(1e5, inf), rho=ends),
        *_vary("units", replace(base, elements=400), units=tuple(UNITS), beta=(1e5, inf)),
        *_vary(
            "resonance",
            replace(base, damping=0.0, frequency=5000.0, periods=10, friction=0.0, force=1e3),
            steps=(100, 1000),
            elements=(1, 40),
        ),
        *_vary(
            "resonance",
            replace(base, damping=0.0, frequency=5000.0, periods=10, steps=200),
            share=(0.5, 1.2),
            beta=FEW,
        ),
        *_vary(
            "drift",
            replace(base, elements=4, steps=10, periods=100_000, beta=inf),
            share=(0.9, 1.2),
        ),
        *_vary("steps", base, steps=(1, 2, 4, 8), beta=(1e5, inf), rho=ends),
    ]


def _sizes(base: Case) -> list[Case]:
    """Bars from micrometres to kilometres; the frequency keeps its share of the resonance."""
    return [
        case
        for length in (1e-6, 1e-3, 1e3)
        for case in _vary(
            "size",
            replace(base, frequency=1000.0 * 0.25 / length, damping=1e-5 * length / 0.25),
            length=(length,),
            beta=FEW,
        )
    ]


def _models() -> list[Case]:
    base = Case(elements=20, periods=2)
    small = Case(elements=5, periods=1, solver="explicit", frequency=5000.0)
    counts = (1, 2, 3, 5, 10, None)
    stable, unstable = (0.5, 0.99), (1.01, 2.0)
    cases = _vary("explicit step", small, step_factor=stable, beta=(1e2, 3e2), damping=(0.0, 1e-5))
    cases += _vary(
        "explicit step",
        replace(small, must_refuse=True),
        step_factor=unstable,
        beta=(1e2, 3e2, 1e5),
        damping=(0.0, 1e-5),
    )
    for model in ("reduced", "hyper-reduced"):
        cases += _vary("modes", base, model=(model,), modes=counts, beta=(1e2, 1e5, 1e12))
    reduced = replace(base, model="reduced", modes=5)
    cases += _vary("mode scales", reduced, mode_scales=(3.0, 6.0, 12.0), beta=(1e2, 1e5, 1e12))
    cases += _vary("dependent modes", reduced, dependent=("raw", "dropped"), beta=(1e2, 1e5, 1e12))
    return cases


def _corners() -> list[Case]:
    base = Case()
    return [
        *_vary(
            "corner",
            replace(base, elements=20),
            beta=(1e2, 1e12, inf),
            frequency=(0.1, 5e4),
            share=(0.01, 0.999, 1.2),
            rho=(0.0, 1.0),
            damping=(0.0, 1e-3),
        ),
        *_vary(
            "corner",
            replace(base, grading=1e4, pressed="alternating"),
            beta=(1e2, 1e12, inf),
            stiffness_jump=(1e-6, 1e6),
            steps=(10, 1000),
            rho=(0.0, 1.0),
        ),
        *_vary(
            "corner",
            replace(base, elements=2000, periods=1),
            grading=(1e4,),
            beta=(1e12, inf),
            steps=(10, 100),
            rho=(0.0, 1.0),
        ),
        *_vary(
            "corner",
            replace(base, length=1e-6, frequency=2.5e8, damping=0.0),
            force=(1e-12, 1e12),
            beta=FEW,
        ),
    ]
