"""Tables of a scene with plates that differ from those of struts."""

from __future__ import annotations

import math
from typing import Annotated, ClassVar, Literal, Self

from pydantic import Discriminator, Field, Tag, ValidationInfo, model_validator

from skfem_joint import plate
from skfem_joint.bolts import Bolt, Bolts
from skfem_joint.plate_contact import AxialPressure
from skfem_joint.scene_messages import BOLTS, NUMBER, TABLE, mistake
from skfem_joint.scene_tables import (
    CommonOutput,
    CommonReduction,
    Override,
    PressureByPosition,
    refuse_beta_of_coulomb,
)
from skfem_joint.scene_values import (
    A_LIST,
    MOST,
    Auto,
    BoundaryName,
    ContactName,
    Direction,
    NotNegative,
    ObservedNames,
    Pair,
    PlaceNames,
    Positive,
    RegionName,
    SceneTable,
    form,
)


class PlateMaterialOverride(Override):
    """``[material.regions.NAME]``: what differs in a region."""

    E: Positive | None = Field(default=None, description="Young's modulus, Pa")
    density: Positive | None = Field(default=None, description="kg/m³")
    poisson: float | None = Field(default=None, gt=-1, lt=0.5, description="Poisson's ratio")


class PlateMaterial(SceneTable):
    """``[material]`` of plates."""

    foreign: ClassVar[dict[str, str]] = {
        "mass_matrix": "the mass of plates is always consistent; mass_matrix is for struts"
    }

    E: Positive = Field(description="Young's modulus, Pa")
    density: Positive = Field(description="density, kg/m³")
    poisson: float = Field(gt=-1, lt=0.5, description="Poisson's ratio")
    regions: dict[RegionName, PlateMaterialOverride] = Field(default_factory=dict)


_WIDTH = {"width": "a plate needs thickness alone; width is for struts"}


class PlateSectionOverride(Override):
    """``[section.regions.NAME]``: what differs in a region."""

    foreign: ClassVar[dict[str, str]] = _WIDTH

    thickness: Positive | None = Field(default=None, description="m")


class PlateSection(SceneTable):
    """``[section]`` of plates."""

    foreign: ClassVar[dict[str, str]] = _WIDTH

    thickness: Positive = Field(description="thickness, m")
    plane: Literal["stress", "strain"] = "stress"
    regions: dict[RegionName, PlateSectionOverride] = Field(default_factory=dict)


class PlateSupport(SceneTable):
    """``[support]``: points, boundaries and regions that are held in both directions or in one."""

    fixed: PlaceNames = ()
    fixed_x: PlaceNames = ()
    fixed_y: PlaceNames = ()

    @model_validator(mode="after")
    def _holds_the_plate(self) -> Self:
        if not self.named:
            raise mistake(
                "found no name; a plate without support is a free body that drifts away, "
                "name at least one point, boundary or region",
                "fixed",
            )
        return self

    @property
    def named(self) -> tuple[tuple[str, str], ...]:
        """What is held, and in which directions: ``xy``, ``x`` or ``y``."""
        held = {"xy": self.fixed, "x": self.fixed_x, "y": self.fixed_y}
        return tuple((name, way) for way, names in held.items() for name in names)


class PlatePressureByPosition(PressureByPosition):
    """Normal pressure that varies along an axis, linear between positions.

    Attributes
    ----------
    positions : tuple of float
        Coordinate along the axis, from the origin of the mesh, m, increasing.
    axis : tuple of float
        Direction of the axis, a unit vector.
    """

    foreign: ClassVar[dict[str, str]] = {}

    axis: Direction = (1.0, 0.0)

    def to_pressure(self) -> AxialPressure:
        """Give the pressure as a function of position."""
        return AxialPressure(self.positions, self.values, self.axis)


class BoltTable(SceneTable):
    """One of ``pressure.bolts``: a bolt that presses the joint around its hole."""

    at: Pair = Field(description="position [x, y], m")
    force: NotNegative = Field(description="clamp force, N")
    head_radius: Positive = Field(description="radius of the head, m")
    hole_radius: NotNegative = Field(default=0.0, description="m")
    spreading_angle: float = Field(
        default=30.0, ge=0, lt=90, description="of the pressure cone from the axis, degrees"
    )

    @model_validator(mode="after")
    def _has_a_ring(self) -> Self:
        if self.hole_radius >= self.head_radius:
            raise mistake(
                f"found {self.hole_radius:g}, must be < head_radius, {self.head_radius:g}",
                "hole_radius",
            )
        return self


class BoltPressure(SceneTable):
    """``pressure = { bolts = [...], reach = ... }``: the pressure under bolts.

    Attributes
    ----------
    reach : float
        Depth from the heads to the contact, over which the pressure cone spreads, m.
    """

    bolts: Annotated[tuple[BoltTable, ...], A_LIST] = Field(
        min_length=1, description="list of tables { at, force, head_radius }"
    )
    reach: NotNegative = 0.0

    def to_pressure(self) -> Bolts:
        """Give the bolts."""
        return Bolts(tuple(Bolt(**bolt.model_dump()) for bolt in self.bolts), self.reach)


def _pressure_form(value: object) -> str:
    if form(value) != TABLE:
        return NUMBER
    has_bolts = isinstance(value, BoltPressure) or (isinstance(value, dict) and "bolts" in value)
    return BOLTS if has_bolts else TABLE


class PlateJoint(SceneTable):
    """``[[joint]]``: an area or an edge pressed on a rigid base, or on another body.

    Attributes
    ----------
    axis : tuple of float or None
        Direction along which the reference modes of ``reduction.reference = "paper"`` are laid.
    """

    foreign: ClassVar[dict[str, str]] = {
        "normal_force": "the normal forces of plates are always consistent; normal_force is for "
        "struts"
    }

    region: RegionName | None = Field(default=None, description="name of a region of the mesh")
    boundary: BoundaryName | None = Field(default=None, description="name of a boundary")
    against: ContactName | None = Field(default=None, description="region or boundary")
    pressure: Annotated[
        Annotated[NotNegative, Tag(NUMBER)]
        | Annotated[PlatePressureByPosition, Tag(TABLE)]
        | Annotated[BoltPressure, Tag(BOLTS)],
        Discriminator(_pressure_form),
    ] = Field(
        description="a pressure in Pa, a table { positions = [m], values = [Pa], axis = [x, y] } "
        "or a table { bolts = [...], reach = m }"
    )
    friction: NotNegative = Field(description="friction coefficient")
    law: Literal["arctan", "coulomb"] = "arctan"
    beta: Positive = Field(default=1e5, description="steepness of the arctan law, s/m")
    axis: Direction | None = None

    @model_validator(mode="after")
    def _fits_together(self, info: ValidationInfo) -> Self:
        given = [key for key in ("region", "boundary") if getattr(self, key) is not None]
        if len(given) != 1:
            raise mistake(
                f"found {' and '.join(given) or 'neither region nor boundary'}, must be either "
                "region (friction over an area) or boundary (friction along an edge)",
                given[0] if given else "region",
            )
        if self.boundary is not None and isinstance(self.pressure, BoltPressure):
            raise mistake(
                "found bolts, which press an area; an edge needs a number, or positions and values",
                "pressure",
            )
        refuse_beta_of_coulomb(self.law, self.beta, self.model_fields_set)
        return self

    def to_joint(self) -> plate.PlateJoint:
        """Give the joint as `plate.build_plate_structure` takes it."""
        return plate.PlateJoint(
            name=self.name,
            kind=self.kind,
            against=self.against,
            pressure=self.pressure
            if isinstance(self.pressure, float)
            else self.pressure.to_pressure(),
            friction=self.friction,
            beta=math.inf if self.law == "coulomb" else self.beta,
        )

    @property
    def kind(self) -> Literal["region", "boundary"]:
        """Whether an area or an edge is pressed."""
        return "region" if self.region is not None else "boundary"

    @property
    def name(self) -> str:
        """Name of what is pressed."""
        return self.region or self.boundary or ""


class PlateReduction(CommonReduction):
    """``[reduction]`` of plates: modes of their own run unless the paper's are asked for.

    Attributes
    ----------
    modes : int
        Twelve of a plate do what five of a strut do.
    active_length : "auto", float or mapping of float
        For the paper's modes: measured in a run with Coulomb friction, one length for every joint,
        or lengths by joint, m.
    """

    modes: int = Field(default=12, ge=1, le=MOST)
    reference: Literal["paper", "self"] = "self"
    inner_product: Literal["energy", "mass", "euclidean"] = "energy"
    active_length: Annotated[
        Auto
        | Annotated[Positive, Tag(NUMBER)]
        | Annotated[dict[ContactName, Positive], Tag(TABLE)],
        Discriminator(form),
    ] = Field(
        default="auto",
        description="'auto', a length in m, or a table { joint = length }",
    )


class PlateOutput(CommonOutput):
    """``[output]`` of plates; points or boundaries are observed."""

    points: ObservedNames = ()
    shape: Literal["swept", "flat"] = "swept"
