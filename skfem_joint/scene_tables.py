"""Tables of a scene: those of struts, and those that struts and plates share."""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path
from typing import Annotated, ClassVar, Literal, Self

from pydantic import AfterValidator, Discriminator, Field, Tag, ValidationInfo, model_validator

from skfem_joint import contact, structure
from skfem_joint.meshing import BarMesh
from skfem_joint.resolution import PER_PERIOD
from skfem_joint.scene_messages import LIST, NUMBER, TABLE, WORD, mistake
from skfem_joint.scene_values import (
    A_LIST,
    MOST,
    Auto,
    FileName,
    NotNegative,
    Number,
    PointNames,
    Positive,
    RegionName,
    SceneTable,
    form,
    has_no_repeats,
    mesh_of,
    number_or_word,
)

#: Fewest steps in a period of a load.
FEWEST_STEPS_PER_PERIOD = PER_PERIOD


class Mesh(SceneTable):
    """``[mesh]``: the file, relative to the scene, and the length of its unit in metres.

    Several files are several bodies; their names must differ.
    """

    file: Annotated[
        Annotated[FileName, Tag(WORD)]
        | Annotated[tuple[FileName, ...], Field(strict=False, min_length=1), Tag(LIST)],
        Discriminator(lambda value: LIST if isinstance(value, list | tuple) else WORD),
    ] = Field(description="name of the mesh file")
    scale: Positive = 1.0

    def paths(self, folder: Path) -> list[Path]:
        """Files of a scene that lies in ``folder``."""
        names = (self.file,) if isinstance(self.file, str) else self.file
        return [folder / name for name in names]


class Override(SceneTable):
    """What differs in a region; sets something."""

    @model_validator(mode="after")
    def _sets_something(self) -> Self:
        if not self.model_fields_set:
            raise mistake(f"found an empty table, must set {' or '.join(type(self).model_fields)}")
        return self


class MaterialOverride(Override):
    """``[material.regions.NAME]``: what differs in a region."""

    E: Positive | None = Field(default=None, description="Young's modulus, Pa")
    density: Positive | None = Field(default=None, description="kg/m³")


class Material(SceneTable):
    """``[material]`` of the bar."""

    E: Positive = Field(description="Young's modulus, Pa")
    density: Positive = Field(description="density, kg/m³")
    poisson: float | None = Field(default=None, gt=-1, lt=0.5, description="not used by struts")
    mass_matrix: Literal["consistent", "lumped"] = "consistent"
    regions: dict[RegionName, MaterialOverride] = Field(default_factory=dict)


class CrossSectionOverride(Override):
    """``[section.regions.NAME]``: what differs in a region."""

    width: Positive | None = Field(default=None, description="m")
    thickness: Positive | None = Field(default=None, description="m")


class CrossSection(SceneTable):
    """``[section]`` of the bar."""

    foreign: ClassVar[dict[str, str]] = {
        "plane": "plane stress and strain are for plates; a strut needs width and thickness",
    }

    width: Positive = Field(description="width, m")
    thickness: Positive = Field(description="thickness, m")
    regions: dict[RegionName, CrossSectionOverride] = Field(default_factory=dict)


class Support(SceneTable):
    """``[support]``: the points that are held."""

    foreign: ClassVar[dict[str, str]] = {
        key: "a strut moves along itself alone; name the points that are held under fixed"
        for key in ("fixed_x", "fixed_y")
    }

    fixed: PointNames = Field(description="list of points that are held")

    @model_validator(mode="after")
    def _holds_the_bar(self) -> Self:
        if not self.fixed:
            raise mistake(
                "found no point; a bar without support is a free body that drifts away, "
                "name at least one point",
                "fixed",
            )
        return self


class PressureByPosition(SceneTable):
    """Normal pressure along the bar, linear between positions.

    Attributes
    ----------
    positions : tuple of float
        Arc length from the start of the bar, m, increasing; they cover the joint.
    values : tuple of float
        Pa, >= 0, one a position.
    """

    foreign: ClassVar[dict[str, str]] = {
        "axis": "positions along a strut need no axis; axis is for plates",
        "bolts": "bolts are for plates; give a number, or positions and values",
        "reach": "bolts are for plates; give a number, or positions and values",
    }

    positions: Annotated[tuple[Number, ...], A_LIST] = Field(
        min_length=2, description="positions along the bar, m"
    )
    values: Annotated[tuple[NotNegative, ...], A_LIST] = Field(
        min_length=2, description="pressures at the positions, Pa"
    )

    @model_validator(mode="after")
    def _is_a_function_of_position(self) -> Self:
        for i, (left, right) in enumerate(pairwise(self.positions), start=1):
            if right <= left:
                raise mistake(
                    f"found {right:g}, must be > {left:g}, the position before", f"positions[{i}]"
                )
        if len(self.values) != len(self.positions):
            raise mistake(
                f"found {len(self.values)} values, must be one for each of the "
                f"{len(self.positions)} positions",
                "values",
            )
        return self


def refuse_beta_of_coulomb(law: str, beta: float, given: set[str]) -> None:
    """Refuse a steepness beside the law that has none."""
    if law == "coulomb" and "beta" in given:
        raise mistake(
            f"found {beta:g} beside law = 'coulomb', which has no beta; "
            "leave it out or choose law = 'arctan'",
            "beta",
        )


class Joint(SceneTable):
    """``[[joint]]``: a region pressed against a rigid surface."""

    foreign: ClassVar[dict[str, str]] = {
        "boundary": "edges of plates are boundaries; a strut is pressed along a region",
        "against": "two bodies in a joint are for plates; a strut is pressed on a rigid base",
        "axis": "a strut has one direction; axis is for plates",
    }

    region: RegionName = Field(description="name of a region of the mesh")
    pressure: Annotated[
        Annotated[NotNegative, Tag(NUMBER)] | Annotated[PressureByPosition, Tag(TABLE)],
        Discriminator(lambda value: TABLE if form(value) == TABLE else NUMBER),
    ] = Field(description="a pressure in Pa or a table { positions = [m], values = [Pa] }")
    friction: NotNegative = Field(description="friction coefficient")
    law: Literal["arctan", "coulomb"] = "arctan"
    beta: Positive = Field(default=1e5, description="steepness of the arctan law, s/m")
    normal_force: Literal["consistent", "equal"] = "consistent"

    @model_validator(mode="after")
    def _fits_together(self, info: ValidationInfo) -> Self:
        refuse_beta_of_coulomb(self.law, self.beta, self.model_fields_set)
        bar = mesh_of(info)
        if isinstance(bar, BarMesh) and isinstance(self.pressure, PressureByPosition):
            s = bar.mesh.p[0, bar.region_nodes(self.region)]
            start, end = float(s.min()), float(s.max())
            first, last = self.pressure.positions[0], self.pressure.positions[-1]
            tolerance = 1e-9 * bar.length
            if first > start + tolerance or last < end - tolerance:
                raise mistake(
                    f"found {first:g} to {last:g} m, must cover the joint, "
                    f"which reaches from {start:g} to {end:g} m",
                    "pressure.positions",
                )
        return self

    def to_joint(self) -> structure.Joint:
        """Give the joint as `structure.build_structure` takes it; Coulomb has an infinite beta."""
        pressure = self.pressure
        return structure.Joint(
            region=self.region,
            pressure=contact.PressureTable(pressure.positions, pressure.values)
            if isinstance(pressure, PressureByPosition)
            else pressure,
            friction=self.friction,
            beta=math.inf if self.law == "coulomb" else self.beta,
            normal_force=self.normal_force,
        )


class Damping(SceneTable):
    """``[damping]``: C = stiffness * K + mass * M."""

    stiffness: NotNegative = Field(default=0.0, description="s")
    mass: NotNegative = Field(default=0.0, description="1/s")


class Time(SceneTable):
    """``[time]``: cycles and steps_per_cycle, or duration and step."""

    cycles: int | None = Field(
        default=None, ge=1, le=MOST, description="number of periods of the load"
    )
    steps_per_cycle: int = Field(default=200, ge=FEWEST_STEPS_PER_PERIOD, le=MOST)
    duration: Positive | None = Field(default=None, description="s")
    step: Positive | None = Field(default=None, description="s")
    rho_infinity: float = Field(default=1.0, ge=0, le=1)

    @model_validator(mode="after")
    def _is_given_one_way(self) -> Self:
        by_cycles = self.model_fields_set & {"cycles", "steps_per_cycle"}
        by_duration = self.model_fields_set & {"duration", "step"}
        choice = "must be either cycles (and steps_per_cycle), or duration and step"
        if by_cycles and by_duration:
            raise mistake(f"found {', '.join(sorted(by_cycles | by_duration))}; {choice}")
        if by_duration:
            if self.duration is None or self.step is None:
                missing = "duration" if self.duration is None else "step"
                raise mistake(f"missing beside {next(iter(by_duration))}; {choice}", missing)
            if self.step > self.duration:
                raise mistake(
                    f"found {self.step:g}, must be <= duration, {self.duration:g}", "step"
                )
        elif self.cycles is None:
            raise mistake(f"missing; {choice}", "cycles")
        return self


class Models(SceneTable):
    """``[models]``: which models are integrated."""

    run: Annotated[
        tuple[Literal["full", "reduced"], ...], A_LIST, AfterValidator(has_no_repeats)
    ] = Field(default=("full",), min_length=1)


class CommonReduction(SceneTable):
    """What struts and plates have in common of ``[reduction]``: how the reduced model is made.

    Attributes
    ----------
    friction_points : "auto", "all" or int
        Points at which the friction of a joint's end is evaluated: four for each mode, every
        contact node as in the paper, or so many.
    snapshots : "both", "displacement" or "rates"
        Whether the modes span displacement and velocity, displacement alone as in the paper, or
        velocity and acceleration.
    """

    modes: int = Field(default=5, ge=1, le=MOST)
    interface_modes: Annotated[
        Auto | Annotated[int, Field(ge=0, le=MOST), Tag(NUMBER)],
        Discriminator(number_or_word),
    ] = Field(default="auto", description="'auto' or a whole number >= 0")
    beta: Annotated[
        Auto | Annotated[Positive, Tag(NUMBER)],
        Discriminator(number_or_word),
    ] = Field(default="auto", description="'auto' or a steepness in s/m > 0")
    friction_points: Annotated[
        Annotated[Literal["auto", "all"], Tag(WORD)]
        | Annotated[int, Field(ge=1, le=MOST), Tag(NUMBER)],
        Discriminator(number_or_word),
    ] = Field(default="auto", description="'auto', 'all' or a whole number >= 1")
    snapshots: Literal["both", "displacement", "rates"] = "both"


class Reduction(CommonReduction):
    """``[reduction]`` of struts.

    Attributes
    ----------
    active_length : "auto", "estimate", float or mapping of float
        Measured in a quick probe run, estimated by Eqs. (17)-(20), one length for every joint, or
        lengths by joint region (a joint not named there is probed), m.
    """

    active_length: Annotated[
        Annotated[Literal["auto", "estimate"], Tag(WORD)]
        | Annotated[Positive, Tag(NUMBER)]
        | Annotated[dict[RegionName, Positive], Tag(TABLE)],
        Discriminator(form),
    ] = Field(
        default="auto",
        description="'auto', 'estimate', a length in m, or a table { region = length }",
    )
    reference: Literal["paper", "self"] = "paper"
    inner_product: Literal["euclidean", "mass"] = "euclidean"


class CommonOutput(SceneTable):
    """What struts and plates have in common of ``[output]``."""

    vtk: bool = False
    plots: bool = False
    every: int = Field(
        default=1, ge=1, le=MOST, description="stored are steps 0, every, 2 every, ..."
    )
    points: tuple[str, ...] = ()
    frames: int = Field(default=200, ge=1, le=MOST, description="pictures in the ParaView series")
    history: bool = True


class Output(CommonOutput):
    """``[output]``: what is written and how often."""

    points: PointNames = ()
    shape: Literal["swept", "line"] = "swept"
