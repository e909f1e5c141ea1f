"""Cases of plates, as plain data, and what each of them is made of."""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import inf, pi
from typing import Any

import numpy as np

from skfem_joint.plate import PlateJoint, PlateStructure, assemble_plate, build_plate_structure
from skfem_joint.plate_mesh import PlateMesh, build_plate, merged
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
from skfem_joint.system import System

BETAS = (1e3, 1e5, 1e7, 1e9, inf)
STEPS = (10, 30, 100)
#: Steps per period that only the scheme of full accuracy is tried with.
MANY = 300
RADII = (0.0, 0.5, 1.0)
#: Directions of the load and, by name, their vectors.
DIRECTIONS = {"along": (1.0, 0.0), "across": (0.0, 1.0), "oblique": (1.0, 0.3)}
#: Bodies: one on a rigid base, by area or by an edge; two on each other, the same.
ONE, TWO = ("base", "edge"), ("lap", "lap of other nodes", "side by side")


@dataclass(frozen=True)
class PlateCase(Case):
    """Plates with a joint; the default is an easy case.

    Attributes
    ----------
    bodies : str
        "base" (a plate pressed on a rigid base), "edge" (by its lower edge), "lap" (two plates on
        half their length), "lap of other nodes" (that do not match) or "side by side" (the edge of
        one on that of the other).
    elements : (int, int)
        Along and across, of each plate.
    aspect : float
        Length over height of an element; the plates' height follows.
    kind, order : str, int
        Kind of the elements, and order of the displacement.
    poisson : float
    plane : str
    stiffness, density : float
        Factors of Young's modulus and density.
    stiffness_ratio, density_ratio : float
        Those of the lower plate over the upper one's.
    part : float
        Share of a plate on a base that is pressed; 1 leaves hardly an unknown out of the contact.
    second_friction : float, optional
        Coefficient of friction of the half at the support, if it is a joint of its own.
    held : bool
        Whether a support holds the left end; if not, friction alone does.
    direction : str
        Of the load, a key of :data:`DIRECTIONS`.
    turned : float
        Angle of the whole, degrees.
    """

    steps: int = 50
    periods: int = 1
    direction: str = "oblique"
    bodies: str = "base"
    elements: tuple[int, int] = (8, 2)
    aspect: float = 1.0
    kind: Any = "quadrilateral"
    order: int = 1
    poisson: float = 0.3
    plane: str = "stress"
    stiffness: float = 1.0
    density: float = 1.0
    stiffness_ratio: float = 1.0
    density_ratio: float = 1.0
    part: float = 1.0
    second_friction: float | None = None
    held: bool = True
    turned: float = 0.0

    @property
    def scheme(self) -> str:
        """Name of the scheme or model, as in the picture."""
        return f"plates, {super().scheme}"

    @property
    def natural(self) -> float:
        """Period of the slowest vibration along the body, held at one end, s."""
        return super().natural * float(np.sqrt(self.density / self.stiffness))

    @property
    def work(self) -> float:
        """About how long the case takes, in any unit."""
        return super().work * (1000.0 + 10.0 * float(np.prod(self.elements)) * self.order**2)


def structure_of(case: PlateCase) -> PlateStructure:
    """Structure of a case, in its units."""
    metre, kilogram, second = (1.0 / unit for unit in in_units(case))
    pascal = kilogram / metre / second**2
    plate = _mesh(case, metre)
    modulus, density = E * case.stiffness * pascal, DENSITY * case.density * kilogram / metre**3
    lower = {"E": modulus * case.stiffness_ratio, "density": density * case.density_ratio}
    return build_plate_structure(
        plate,
        E=modulus,
        poisson=case.poisson,
        density=density,
        thickness=0.04 * case.length * metre,
        plane=case.plane,
        supports=[("left", "xy")] if case.held else [],
        joints=_joints(case, pascal, second / metre),
        stiffness_damping=case.damping * second,
        regions={name: lower for name in plate.regions if name.startswith("lower")},
    )


def _joints(case: PlateCase, pascal: float, beta: float) -> list[PlateJoint]:
    by_edge = case.bodies in ("edge", "side by side")
    name, against = ("face", "lower_face") if by_edge else ("joint", "lower_joint")
    joint = PlateJoint(
        name,
        "boundary" if by_edge else "region",
        against if case.bodies in TWO else None,
        case.pressure * pascal,
        case.friction,
        case.beta * beta,
    )
    if case.second_friction is None:
        return [joint]
    return [joint, replace(joint, name="second_joint", friction=case.second_friction)]


def _mesh(case: PlateCase, metre: float) -> PlateMesh:
    """Rectangle, or two that overlap on half of their length; the right end is loaded."""
    length, (along, across) = case.length * metre, case.elements
    width = length / along / case.aspect * across
    half, rest = along // 2, along - along // 2
    kind: Any = {"kind": case.kind, "order": case.order}
    if case.bodies in ONE:
        strips = [("joint", length, along)]
        if case.second_friction is not None:
            strips = [("second_joint", 0.5 * length, half), ("joint", 0.5 * length, rest)]
        elif case.part < 1.0:
            pressed = max(1, round(case.part * along))
            size = length / along
            strips = [
                ("joint", pressed * size, pressed),
                ("free", length - pressed * size, along - pressed),
            ]
        sides: Any = {"left": "left", "right": "right", "face": "bottom"}
        plate = build_plate(strips, width, across, boundaries=sides, **kind)
    else:
        edge = case.bodies == "side by side"
        lower = build_plate(
            [("lower_rest", 0.5 * length, rest), ("lower_joint", 0.5 * length, half)],
            width,
            across,
            boundaries={"left": "left", "lower_face": ("top", "lower_joint")},
            **kind,
        )
        other = case.bodies != "lap"
        upper = build_plate(
            [("joint", 0.5 * length, half + other), ("rest", 0.5 * length, rest)],
            width,
            across + other,
            origin=(0.5 * length, width if edge else 0.0),
            boundaries={"right": "right", "face": ("bottom", "joint")},
            **kind,
        )
        plate = merged([lower, upper])
    if case.turned == 0.0:
        return plate
    p = _turn(case) @ plate.mesh.p
    return replace(plate, mesh=replace(plate.mesh, doflocs=p))


def _turn(case: PlateCase) -> Any:
    c, s = np.cos(np.radians(case.turned)), np.sin(np.radians(case.turned))
    return np.array([[c, -s], [s, c]])


def system_of(case: PlateCase) -> System:
    """System of a case, in its units; the displacements of the right end are its points.

    They are along the load, then along and across the plate before it is turned.
    """
    structure = structure_of(case)
    direction = _turn(case) @ np.array(DIRECTIONS[case.direction])
    system = assemble_plate(structure, [("right", direction, load_of(case, 1.0))], ["right"])
    w = limits(case, system.w)
    load = replace(system.loads[0], amplitude=load_of(case, force_of(case, w)))
    P = system.P.toarray()
    P[1:] = _turn(case).T @ P[1:]
    return replace(system, w=w, loads=(load,), P=P)


def plates() -> tuple[PlateCase, ...]:
    """All cases: schemes over beta and steps per period, the axes singly, the corners."""
    return (*_scheme_map(), *_single_axes(), *_bodies(), *_models(), *_corners())


#: Gentle, usual and stiff laws; usual and stiffest.
FEW, PAIR = (1e3, 1e5, 1e9, inf), (1e5, inf)


def _scheme_map() -> list[PlateCase]:
    base = PlateCase()
    return [
        *vary("plate scheme", base, rho=RADII, beta=BETAS, steps=STEPS),
        *vary("plate scheme", base, rho=RADII[-1:], beta=BETAS, steps=(MANY,)),
    ]


def _single_axes() -> list[PlateCase]:
    base = PlateCase()
    whole = replace(base, elements=(16, 4))
    oscillator = replace(base, friction=0.0, force=1e3)
    return [
        *vary("plate load", base, share=(1e-6, 0.5, 1.0, 2.0), beta=FEW),
        *vary("plate load", base, direction=("along", "across"), share=(0.9, 2.0), beta=PAIR),
        *vary("plate pressure", base, pressure=(1.0, 1e12), beta=PAIR),
        *vary("plate pressure", base, pressure=(1.0, 1e12), force=(1e3,), beta=PAIR),
        *vary("plate pressure", base, pressed=("one node", "alternating"), beta=PAIR),
        *vary("plate frequency", base, frequency=(0.1, 1e2, 1e4, 1e6), beta=PAIR, rho=(0.0, 1.0)),
        *vary("plate steps", base, steps=(2, 4), beta=PAIR, must_refuse=(True,)),
        *vary("plate steps", base, steps=(10, 500), periods=(2,), beta=PAIR),
        *vary("plate damping", base, damping=(0.0, 1e-3), beta=FEW),
        *vary("plate Poisson", base, poisson=(0.0, 0.49), beta=PAIR),
        *vary("plate Poisson", replace(base, plane="strain"), poisson=(0.3, 0.499), beta=PAIR),
        *vary("plate Poisson", replace(base, must_refuse=True), poisson=(0.5,), plane=("strain",)),
        *vary(
            "plate elements",
            base,
            kind=("triangle", "quadrilateral"),
            order=(1, 2),
            beta=PAIR,
        ),
        *vary("plate elements", whole, part=(0.5, 1.0), beta=FEW),
        *vary(
            "plate aspect",
            base,
            aspect=(0.01, 100.0),
            kind=("triangle", "quadrilateral"),
            beta=PAIR,
        ),
        *vary("plate aspect", base, aspect=(0.01, 100.0), order=(2,), beta=PAIR),
        *vary("plate material", base, stiffness=(1e-6, 1e6), beta=PAIR),
        *vary("plate material", base, density=(1e-6, 1e6), beta=PAIR),
        *vary("plate no friction", oscillator, rho=RADII),
        *vary("plate no friction", oscillator, damping=(0.0,), direction=("along", "across")),
        *vary("plate one joint", base, second_friction=(0.0,), beta=FEW),
        *vary("plate one joint", base, second_friction=(0.0,), share=(2.0,), beta=PAIR),
        *vary(
            "plate switched on", base, phase=(0.5 * pi,), steps=(50, 200), beta=PAIR, rho=(0.0, 1.0)
        ),
        *vary(
            "plate switched on",
            base,
            phase=(0.5 * pi,),
            share=(0.1, 0.3, 0.5),
            steps=(100,),
            beta=PAIR,
        ),
        *vary(
            "plate switched on",
            replace(base, duration=1000.0, steps=200),
            load=("rectangle",),
            damping=(0.0, 1e-5),
            beta=PAIR,
        ),
        *vary("plate pulse", base, load=("triangle", "rectangle"), duration=(0.3, 10.0), beta=PAIR),
        *vary("plate turned", base, turned=(37.0, 90.0), beta=FEW),
        *vary("plate units", base, units=tuple(UNITS), beta=PAIR),
        *vary(
            "plate as bar",
            replace(base, poisson=0.0, direction="along", rho=1.0),
            beta=FEW,
            share=(0.9, 1.2),
        ),
    ]


def _bodies() -> list[PlateCase]:
    base = PlateCase(elements=(8, 2))
    loose = replace(base, held=False)
    return [
        *vary("plate bodies", base, bodies=("edge", *TWO), beta=FEW),
        *vary("plate bodies", base, bodies=TWO, direction=("across",), beta=PAIR),
        *vary("plate bodies", base, bodies=TWO, share=(2.0,), rho=(0.5,), beta=PAIR),
        *vary("plate bodies", replace(base, order=2), bodies=TWO, beta=(inf,)),
        *vary("soft and stiff", base, bodies=TWO, stiffness_ratio=(1e-6, 1e6), beta=PAIR),
        *vary("light and heavy", base, bodies=("lap",), density_ratio=(1e-6, 1e6), beta=PAIR),
        *vary("held by friction", loose, share=(1e-6, 0.9, 2.0), beta=FEW),
        *vary("held by friction", loose, direction=("across",), share=(0.5, 2.0), beta=PAIR),
        *vary(
            "held by friction",
            replace(loose, steps=200),
            phase=(0.5 * pi,),
            share=(0.5, 2.0),
            beta=PAIR,
        ),
        *vary(
            "held by friction", replace(loose, friction=0.0, force=1e3, must_refuse=True), beta=PAIR
        ),
        *vary("held by friction", replace(loose, must_refuse=True), bodies=TWO),
    ]


def _models() -> list[PlateCase]:
    base = PlateCase(periods=2)
    cases = []
    for model in ("reduced", "hyper-reduced"):
        reduced = replace(base, model=model, modes=6)
        cases += vary("plate modes", reduced, model=(model,), beta=(1e3, 1e5, 1e9, 1e12))
        cases += vary(
            "plate modes", replace(reduced, bodies="lap"), model=(model,), beta=(1e3, 1e9)
        )
        cases += vary(
            "plate modes", replace(reduced, must_refuse=True), model=(model,), beta=(inf,)
        )
    cases += vary("plate modes", base, model=("reduced",), modes=(1, 2, None), beta=(1e5, 1e9))
    return cases


def _corners() -> list[PlateCase]:
    base = PlateCase()
    return [
        *vary(
            "plate corner",
            replace(base, damping=0.0, poisson=0.49),
            aspect=(0.01, 100.0),
            share=(0.999, 2.0),
            rho=(0.0, 1.0),
            beta=(1e9, inf),
        ),
        *vary(
            "plate corner",
            replace(base, bodies="lap of other nodes", damping=0.0, stiffness_ratio=1e-6),
            frequency=(0.1, 1e5),
            pressed=("all", "alternating"),
            beta=(1e9, inf),
        ),
        *vary(
            "plate corner",
            replace(base, held=False, elements=(16, 4), damping=0.0, steps=100),
            pressed=("alternating",),
            frequency=(0.1, 1e5),
            beta=(1e9, inf),
        ),
    ]
