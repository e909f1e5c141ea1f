"""The tables of a scene about joints: their pressure, friction, and the bolts that clamp them."""

from __future__ import annotations

import math
from typing import Annotated, Literal, Self

from pydantic import Field, Tag, model_validator

from skfem_joint import structure
from skfem_joint.errors import InputError
from skfem_joint.scene.messages import BOLTS, NUMBER, TABLE, WORD, mistake
from skfem_joint.scene.values import (
    A_LIST,
    Coordinates,
    Direction,
    NotNegative,
    Number,
    Positive,
    SceneTable,
    key,
    one_of,
)


class _Pressure(SceneTable):
    """A pressure that the structure takes."""

    @model_validator(mode="after")
    def _is_one(self) -> Self:
        try:
            self.to_pressure()
        except InputError as error:
            lines = (problem.removeprefix("pressure: ") for problem in error.problems)
            raise mistake("\n".join(lines)) from error
        return self

    def to_pressure(self) -> structure.PressureTable | structure.Bolts:
        """Pressure as `skfem_joint.structure` takes it."""
        raise NotImplementedError


class PressureByPositionTable(_Pressure):
    """``pressure = { positions, values, axis }``: linear between positions along an axis."""

    positions: Annotated[tuple[Number, ...], A_LIST] = key(
        "positions along the axis, m; they increase and cover the joint"
    )
    values: Annotated[tuple[NotNegative, ...], A_LIST] = key("pressures at the positions, Pa")
    axis: Direction | None = key(
        "direction of the axis, [x, y] or [x, y, z]; x, or along bars, if not given", None
    )

    def to_pressure(self) -> structure.PressureTable:
        """Pressure as `skfem_joint.structure` takes it."""
        return structure.PressureTable(self.positions, self.values, self.axis)


class PressureBoltTable(SceneTable):
    """``bolts = [{ at, force, ... }, ...]``: bolts that press the joint around their holes."""

    at: Coordinates = key("position of its axis, [x, y] or [x, y, z], m")
    force: NotNegative = key("clamping force, N")
    head_radius: Positive = key("radius of the head or washer, m")
    hole_radius: NotNegative = key("radius of the hole, m", 0.0)
    spreading_angle: float = key(
        "angle of the cone of pressure under the head from the axis, degrees", 30.0, ge=0, lt=90
    )


class BoltPressureTable(_Pressure):
    """``pressure = { bolts = [...], reach = ... }``: the pressure under bolts."""

    bolts: Annotated[tuple[PressureBoltTable, ...], A_LIST] = key(
        "list of tables { at, force, head_radius }", min_length=1
    )
    reach: NotNegative = key("depth from heads to contact, over which the cones spread, m", 0.0)

    def to_pressure(self) -> structure.Bolts:
        """Pressure as `skfem_joint.structure` takes it."""
        bolts = tuple(structure.Bolt(**bolt.model_dump()) for bolt in self.bolts)
        return structure.Bolts(bolts, self.reach)


class JointTable(SceneTable):
    """``[[joint]]``: a part of a body pressed on a rigid base, or on another body."""

    on: str = key("name of the region or boundary that is pressed")
    against: str | None = key("name of what it is pressed on, a rigid base if not given", None)
    pressure: Annotated[
        Annotated[NotNegative, Tag(NUMBER)]
        | Annotated[Literal["preload"], Tag(WORD)]
        | Annotated[PressureByPositionTable, Tag(TABLE)]
        | Annotated[BoltPressureTable, Tag(BOLTS)],
        one_of(WORD, TABLE, BOLTS),
    ] = key(
        "normal pressure, Pa, or a table of it, or 'preload': as [[bolt]] presses it",
        allowed="a pressure in Pa, 'preload', a table { positions = [m], values = [Pa], axis = "
        "[x, y] } or a table { bolts = [...], reach = m }",
    )
    friction: NotNegative = key("friction coefficient")
    law: Literal["arctan", "coulomb"] = key(
        "friction as a smooth function of the slip velocity, or exact", "arctan"
    )
    beta: Positive = key("steepness of the arctan law, s/m", 1e5)
    normal_force: Literal["consistent", "equal"] = key(
        "normal forces of the nodes: integrals of the pressure, or all alike", "consistent"
    )
    axis: Direction | None = key(
        "direction in which the paper's modes are laid, [x, y] or [x, y, z]; bars have one", None
    )

    @model_validator(mode="after")
    def _has_beta_only_with_arctan(self) -> Self:
        if self.law == "coulomb" and "beta" in self.model_fields_set:
            raise mistake(
                f"found {self.beta:g} beside law = 'coulomb', which has no beta; "
                "leave it out or choose law = 'arctan'",
                "beta",
            )
        return self

    def to_joint(self) -> structure.Joint:
        """Joint as `skfem_joint.structure` takes it; Coulomb friction has an infinite beta."""
        own, pressure = self.model_dump(exclude={"law"}), self.pressure
        if isinstance(pressure, _Pressure):
            own["pressure"] = pressure.to_pressure()
        if self.law == "coulomb":
            own["beta"] = math.inf
        return structure.Joint(**own)


class BoltTable(SceneTable):
    """``[[bolt]]``: a bolt that presses joints with ``pressure = "preload"``."""

    force: Positive = key("clamp force, N")
    head: str | None = key("name of the boundary under its head, which it presses", None)
    nut: str | None = key(
        "name of the boundary under its nut; screwed into the rigid base, if not given", None
    )
    shank: Annotated[tuple[str, ...], Field(strict=False, min_length=2, max_length=2)] | None = key(
        "names of both faces of a cut through its shank, which it pulls together, in place of head "
        "and nut",
        None,
    )
