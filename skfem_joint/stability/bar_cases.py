"""Cases of bars, as plain data, and what each of them is made of."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf, pi

import numpy as np

from skfem_joint.contact import PressureTable
from skfem_joint.meshing import BarMesh, build_bar
from skfem_joint.stability.problem import (
    DENSITY,
    UNITS,
    Case,
    E,
    force_of,
    in_units,
    limits,
    load_of,
    vary,
)
from skfem_joint.structure import Joint, Structure, assemble, build_structure
from skfem_joint.system import System

BETAS = (*(10.0**k for k in range(2, 13)), inf)
STEPS = (10, 30, 100, 300, 1000, 10_000)
#: Steps per period that the explicit method needs up to beta = 1e3.
MANY = 60_000
RADII = (0.0, 0.5, 0.8, 1.0)


@dataclass(frozen=True)
class BarCase(Case):
    """A bar with a joint; the default is an easy case.

    Attributes
    ----------
    elements : int
    grading : float
        Longest over shortest element.
    stiffness_jump, density_jump : float
        Young's modulus and density of the half at the support over those of the other half.
    step_factor : float, optional
        Step of the explicit method over the stable one, instead of ``steps``.
    mode_scales : float
        Decades that the modes' scales are spread over.
    dependent : str
        "" or how dependent modes are added: "raw" (as they are) or "dropped" (made orthonormal).
    """

    elements: int = 40
    grading: float = 1.0
    stiffness_jump: float = 1.0
    density_jump: float = 1.0
    step_factor: float | None = None
    mode_scales: float = 0.0
    dependent: str = ""

    @property
    def work(self) -> float:
        """About how long the case takes, in any unit."""
        return super().work * (self.elements + 20.0)


def structure_of(case: BarCase) -> Structure:
    """Structure of a case, in its units."""
    metre, kilogram, second = (1.0 / unit for unit in in_units(case))
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
    modulus, density = E * pascal, DENSITY * kilogram / metre**3
    half = {"E": modulus * case.stiffness_jump, "density": density * case.density_jump}
    return build_structure(
        bar,
        E=modulus,
        density=density,
        width=0.2 * length,
        thickness=0.04 * length,
        fixed=["fixed"],
        joints=[Joint("joint", pressure, case.friction, case.beta * second / metre)],
        stiffness_damping=case.damping * second,
        regions={"half": half} if "half" in bar.regions else {},
    )


def _mesh(case: BarCase, metre: float) -> BarMesh:
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


def system_of(case: BarCase) -> System:
    """System of a case, in its units."""
    structure = structure_of(case)
    w = limits(case, assemble(structure, points=["free_end"]).w)
    load = load_of(case, force_of(case, w))
    return replace(assemble(structure, [("free_end", load)], ["free_end"]), w=w)


#: Gentle, usual and stiffest laws.
FEW = (1e2, 1e5, 1e12, inf)
PULSES = ("triangle", "half sine", "versine", "rectangle", "ramp")


def bars() -> tuple[BarCase, ...]:
    """All cases: every scheme over beta and steps per period, the axes singly, the corners."""
    return (*_scheme_maps(), *_single_axes(), *_models(), *_corners())


def _scheme_maps() -> list[BarCase]:
    base = BarCase(elements=20, periods=2)
    cases = vary("scheme", base, rho=RADII, beta=BETAS, steps=STEPS)
    explicit = replace(base, solver="explicit", periods=1)
    cases += vary("explicit", explicit, beta=BETAS[:-1], steps=STEPS)
    cases += vary("explicit", explicit, beta=BETAS[:2], steps=(MANY,))
    cases += vary("explicit", replace(explicit, must_refuse=True), beta=(inf,), steps=STEPS)
    for model in ("reduced", "hyper-reduced"):
        reduced = replace(base, model=model, modes=5)
        cases += vary(model, reduced, beta=BETAS[:-1], steps=STEPS[:5])
        cases += vary(model, replace(reduced, must_refuse=True), beta=(inf,), steps=STEPS[:5])
    return cases


def _single_axes() -> list[BarCase]:
    base = BarCase()
    ends = (0.0, 1.0)
    half_pi = 0.5 * pi
    switched = replace(base, elements=20)
    return [
        *vary(
            "frequency", base, frequency=(0.1, 1.0, 10.0, 1e2, 1e4, 5e4), beta=(1e5, inf), rho=ends
        ),
        *vary(
            "slow",
            replace(base, elements=100, frequency=0.1, periods=2, steps=400),
            share=(0.1, 0.5, 0.9, 1.0),
            beta=(1e12, inf),
            rho=ends,
        ),
        *vary("load", base, share=(0.01, 0.1, 0.5, 0.99, 0.999, 1.0, 1.2), beta=FEW),
        *vary(
            "elements",
            replace(base, periods=1),
            elements=(1, 2, 3, 10, 100, 800, 5000, 20_000),
            beta=FEW,
        ),
        *vary("grading", base, grading=(10.0, 1e2, 1e3, 1e4), beta=FEW),
        *vary("damping", base, damping=(0.0, 1e-7, 1e-4, 1e-3), beta=FEW),
        *vary("pressure", base, pressed=("one node", "halves", "alternating"), beta=FEW),
        *vary("no friction", replace(base, force=1e3), friction=(0.0,), rho=RADII),
        *vary("no friction", replace(base, force=1e3), pressure=(0.0,), rho=RADII),
        *vary("stiffness jump", base, stiffness_jump=(1e-6, 1e6), beta=FEW),
        *vary("density jump", base, density_jump=(1e-6, 1e6), beta=FEW),
        *vary(
            "pulse",
            replace(base, periods=2),
            load=PULSES,
            duration=(0.01, 0.3, 0.9, 3.0, 10.0, 50.0),
            beta=(1e5, inf),
        ),
        *vary("no load", base, force=(0.0,), beta=FEW, rho=ends),
        *vary("switched on", switched, phase=(half_pi,), steps=(30, 100, 1000), rho=RADII),
        *vary("switched on", switched, phase=(half_pi,), frequency=(0.1, 5e4), rho=RADII),
        *vary(
            "switched on",
            switched,
            phase=(half_pi,),
            share=(0.1, 0.3, 0.5),
            steps=(56, 200, 1000),
            beta=FEW,
        ),
        *vary(
            "switched on",
            switched,
            load=("rectangle",),
            duration=(1000.0,),
            steps=(30, 100, 1000),
            rho=RADII,
        ),
        *vary("force", base, force=(1e-12, 1e12), beta=FEW),
        *vary("force", base, pressure=(1e-10, 1e14), beta=FEW),
        *_sizes(base),
        *vary("units", base, units=tuple(UNITS), beta=(1e5, inf), rho=ends),
        *vary("units", replace(base, elements=400), units=tuple(UNITS), beta=(1e5, inf)),
        *vary(
            "resonance",
            replace(base, damping=0.0, frequency=5000.0, periods=10, friction=0.0, force=1e3),
            steps=(100, 1000),
            elements=(1, 40),
        ),
        *vary(
            "resonance",
            replace(base, damping=0.0, frequency=5000.0, periods=10, steps=200),
            share=(0.5, 1.2),
            beta=FEW,
        ),
        *vary(
            "drift",
            replace(base, elements=4, steps=10, periods=100_000, beta=inf),
            share=(0.9, 1.2),
        ),
        *vary("steps", base, steps=(1, 2, 4, 8), beta=(1e5, inf), rho=ends),
    ]


def _sizes(base: BarCase) -> list[BarCase]:
    """Bars from micrometres to kilometres; the frequency keeps its share of the resonance."""
    return [
        case
        for length in (1e-6, 1e-3, 1e3)
        for case in vary(
            "size",
            replace(base, frequency=1000.0 * 0.25 / length, damping=1e-5 * length / 0.25),
            length=(length,),
            beta=FEW,
        )
    ]


def _models() -> list[BarCase]:
    base = BarCase(elements=20, periods=2)
    small = BarCase(elements=5, periods=1, solver="explicit", frequency=5000.0)
    counts = (1, 2, 3, 5, 10, None)
    stable, unstable = (0.5, 0.99), (1.01, 2.0)
    cases = vary("explicit step", small, step_factor=stable, beta=(1e2, 3e2), damping=(0.0, 1e-5))
    cases += vary(
        "explicit step",
        replace(small, must_refuse=True),
        step_factor=unstable,
        beta=(1e2, 3e2, 1e5),
        damping=(0.0, 1e-5),
    )
    for model in ("reduced", "hyper-reduced"):
        cases += vary("modes", base, model=(model,), modes=counts, beta=(1e2, 1e5, 1e12))
    reduced = replace(base, model="reduced", modes=5)
    cases += vary("mode scales", reduced, mode_scales=(3.0, 6.0, 12.0), beta=(1e2, 1e5, 1e12))
    cases += vary("dependent modes", reduced, dependent=("raw", "dropped"), beta=(1e2, 1e5, 1e12))
    return cases


def _corners() -> list[BarCase]:
    base = BarCase()
    return [
        *vary(
            "corner",
            replace(base, elements=20),
            beta=(1e2, 1e12, inf),
            frequency=(0.1, 5e4),
            share=(0.01, 0.999, 1.2),
            rho=(0.0, 1.0),
            damping=(0.0, 1e-3),
        ),
        *vary(
            "corner",
            replace(base, grading=1e4, pressed="alternating"),
            beta=(1e2, 1e12, inf),
            stiffness_jump=(1e-6, 1e6),
            steps=(10, 1000),
            rho=(0.0, 1.0),
        ),
        *vary(
            "corner",
            replace(base, elements=2000, periods=1),
            grading=(1e4,),
            beta=(1e12, inf),
            steps=(10, 100),
            rho=(0.0, 1.0),
        ),
        *vary(
            "corner",
            replace(base, length=1e-6, frequency=2.5e8, damping=0.0),
            force=(1e-12, 1e12),
            beta=FEW,
        ),
    ]
