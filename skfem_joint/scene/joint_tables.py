"""Tables of a scene for joints: pressure, friction law, and the bolts that clamp them."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated, Any, Literal, Self, TypeAlias

from pydantic import (
    BeforeValidator,
    Field,
    PrivateAttr,
    Tag,
    ValidationInfo,
    field_validator,
    model_validator,
)

from skfem_joint.joint.joints import Joint
from skfem_joint.joint.pressure import Bolt, Bolts, PressureTable
from skfem_joint.joint.scans import NodeField, Scan, read_node_field, read_scan
from skfem_joint.scene.messages import Form, mistake, of_key
from skfem_joint.scene.values import (
    Coordinates,
    Direction,
    FileName,
    NotNegative,
    Number,
    Positive,
    SceneTable,
    TomlList,
    beside_scene,
    by_form,
    key,
)


class _PressureTable(SceneTable):
    """Base of the tables of a pressure, which the classes of `skfem_joint.structure` check."""

    @model_validator(mode="after")
    def _is_pressure(self) -> Self:
        with of_key(before="pressure: "):
            self.to_pressure()
        return self

    def to_pressure(self) -> PressureTable | Bolts:
        """Object of `skfem_joint.structure` with the values of this table."""
        raise NotImplementedError


class PressureByPositionTable(_PressureTable):
    """``pressure = { positions, values, axis }``: linear between positions along an axis."""

    positions: TomlList[Number] = key(
        "positions along the axis, m; they increase and cover the joint"
    )
    values: TomlList[NotNegative] = key("pressures at the positions, Pa")
    axis: Direction | None = key(
        "direction of the axis, [x, y] or [x, y, z]; if not given, along a bar or along x", None
    )

    def to_pressure(self) -> PressureTable:
        """Object of `skfem_joint.structure` with the values of this table."""
        return PressureTable(self.positions, self.values, self.axis)


class PressureBoltTable(SceneTable):
    """``bolts = [{ at, force, ... }, ...]``: bolts that press the joint around their holes."""

    at: Coordinates = key("position of the bolt's axis, [x, y] or [x, y, z], m")
    force: NotNegative = key("clamping force, N")
    head_radius: Positive = key("radius of the head or washer, m")
    hole_radius: NotNegative = key("radius of the hole, m", 0.0)
    spreading_angle: float = key(
        "angle between the axis and the cone of pressure under the head, degrees", 30.0, ge=0, lt=90
    )


class BoltPressureTable(_PressureTable):
    """``pressure = { bolts = [...], reach = ... }``: the pressure under bolts."""

    bolts: TomlList[PressureBoltTable] = key(
        "list of tables { at, force, head_radius }", min_length=1
    )
    reach: NotNegative = key("depth from the heads to the contact, m", 0.0)

    def to_pressure(self) -> Bolts:
        """Object of `skfem_joint.structure` with the values of this table."""
        bolts = tuple(Bolt(**bolt.model_dump()) for bolt in self.bolts)
        return Bolts(bolts, self.reach)


class _SurfaceTable(SceneTable):
    """Base of the tables of files in which surfaces are, which are read with the scene."""

    file: FileName
    _surface: Scan | NodeField = PrivateAttr()

    @model_validator(mode="after")
    def _read(self, info: ValidationInfo) -> Self:
        with of_key():
            self._surface = self._read_surface(beside_scene(self.file, info))
        return self

    def _read_surface(self, path: Path) -> Scan | NodeField:
        """Surface in a file."""
        raise NotImplementedError

    def to_surface(self) -> Scan | NodeField:
        """Surface of the file of this table."""
        return self._surface


class ScanTable(_SurfaceTable):
    """``gap = { file, origin, axes, margin }``: measured topography of a face or of the gap."""

    file: FileName = key(
        "name of a CSV file, relative to the scene, whose first line names its columns: x, y (not "
        "for plates from the side), and height, by which the face stands out towards the other, or "
        "gap; in m, or with a unit in brackets, as in height (um)"
    )
    origin: Coordinates | None = key(
        "where the scan's origin lies on the mesh, [x, y] or [x, y, z], m; at its origin if not "
        "given",
        None,
    )
    axes: TomlList[Direction] | None = key(
        "directions of the scan's axes on the mesh, [[x, y, z], [x, y, z]], or [[x, y]]; x, and y, "
        "if not given",
        None,
    )
    margin: NotNegative = key(
        "distance beyond the measured places up to which the values at the edge go on, m", 0.0
    )

    def _read_surface(self, path: Path) -> Scan:
        return read_scan(path, **self.model_dump(exclude={"file"}))


class NodeFieldTable(_SurfaceTable):
    """``gap = { file, field, on, kind, scale }``: a field of nodes of a mesh file."""

    file: FileName = key("name of a Gmsh file, relative to the scene")
    field: str = key("name of the field, a section $NodeData of the file, in m")
    on: str = key("physical group of the face whose nodes count")
    kind: Literal["gap", "height"] = key(
        "distance of the faces, or how far this face stands out towards the other", "gap"
    )
    scale: Positive = key("length of the unit of the file's nodes, m", 1.0)

    def _read_surface(self, path: Path) -> NodeField:
        return read_node_field(path, **self.model_dump(exclude={"file"}))


def _as_table(given: object) -> object:
    """Table of a scan whose file alone is given."""
    return {"file": given} if isinstance(given, str) else given


#: A surface of a list, or the only one.
AnySurface: TypeAlias = Annotated[
    Annotated[ScanTable, Tag(Form.TABLE)] | Annotated[NodeFieldTable, Tag(Form.FIELD)],
    by_form(Form.FIELD, otherwise=Form.TABLE),
    BeforeValidator(_as_table),
]


class JointTable(SceneTable):
    """``[[joint]]``: a part of a body pressed on a rigid base, or on another body."""

    on: str = key("name of the region or boundary that is pressed")
    against: str | None = key(
        "name of the region or boundary on which it is pressed; a rigid base if not given", None
    )
    contact: Literal["constant", "unilateral"] = key(
        "normal force that stays as it is at rest, in contact that stays closed; or one that "
        "follows the motion, in contact that opens and closes",
        "constant",
    )
    pressure: Annotated[
        Annotated[NotNegative, Tag(Form.NUMBER)]
        | Annotated[Literal["preload"], Tag(Form.WORD)]
        | Annotated[PressureByPositionTable, Tag(Form.TABLE)]
        | Annotated[BoltPressureTable, Tag(Form.BOLTS)],
        by_form(Form.WORD, Form.TABLE, Form.BOLTS),
    ] = key(
        "normal pressure, Pa, or a table of it, or 'preload' for the pressure of the [[bolt]]s; "
        "zero if not given, which contact = 'unilateral' allows",
        None,
        validate_default=True,
        allowed="a pressure in Pa, 'preload', a table { positions = [m], values = [Pa], axis = "
        "[x, y] } or a table { bolts = [...], reach = m }",
    )
    friction: NotNegative = key("friction coefficient")
    law: Literal["arctan", "coulomb"] = key(
        "friction law: Coulomb's, or the arctan of the slip velocity, which it is if beta is given",
        "coulomb",
    )
    beta: Positive | None = key("steepness of the arctan law, s/m", None)
    tangential_stiffness: Positive | None = key(
        "stiffness of the surfaces against slip, in series with friction, Pa/m; rigid if not given",
        None,
    )
    normal_force: Literal["consistent", "equal"] = key(
        "normal forces of the nodes: integrals of the pressure, or all equal", "consistent"
    )
    axis: Direction | None = key(
        "direction along which the paper's modes are scaled, [x, y] or [x, y, z]; not for bars",
        None,
    )
    gap: Annotated[
        Annotated[NotNegative, Tag(Form.NUMBER)]
        | Annotated[ScanTable, Tag(Form.TABLE)]
        | Annotated[NodeFieldTable, Tag(Form.FIELD)]
        | Annotated[TomlList[AnySurface], Tag(Form.LIST)],
        by_form(Form.TABLE, Form.FIELD, Form.LIST),
        BeforeValidator(_as_table),
    ] = key(
        "distance between the faces at rest, m, beside that of the mesh, or files of measured "
        "topography of a face, or of both; with contact = 'unilateral' or pressure = 'preload'",
        0.0,
        allowed="number >= 0, name of a file, a table { file, origin, axes, margin } or { file, "
        "field, on, kind, scale }, or a list of files and tables",
    )
    gap_scale: NotNegative = key("factor on the gap", 1.0)
    remove_plane: bool = key(
        "whether the plane that fits the gap best over the face is taken out of it; the faces then "
        "touch where they are nearest to each other",
        False,
    )
    normal_stiffness: Positive | None = key(
        "stiffness of the interface across the faces, Pa/m, with contact = 'unilateral'; rigid if "
        "not given",
        None,
    )

    @field_validator("pressure", mode="wrap")
    @classmethod
    def _is_given_or_opens(cls, value: object, check: Any, info: ValidationInfo) -> Any:
        if value is None:  # not given
            if info.data.get("contact") != "constant":
                return 0.0
            raise mistake(
                "missing: a joint is pressed by a pressure in Pa, a table of it, or 'preload'; "
                "only with contact = 'unilateral' it may be left out"
            )
        return check(value)

    @model_validator(mode="after")
    def _opens_alone(self) -> Self:
        if self.contact != "unilateral":
            if self.normal_stiffness:
                wrong = "needs contact = 'unilateral'; give it, or leave this out"
                raise mistake(wrong, "normal_stiffness")
            if self.gap and self.pressure != "preload":
                wrong = "needs contact = 'unilateral', or pressure = 'preload', by which bolts "
                raise mistake(f"{wrong}close it; give one of them, or leave this out", "gap")
        return self

    @model_validator(mode="after")
    def _has_beta_with_arctan_alone(self) -> Self:
        given = "law" in self.model_fields_set
        if self.beta is None and self.law == "arctan":
            raise mistake(
                "missing beside law = 'arctan', which needs its steepness in s/m; give beta, or "
                "leave law out for Coulomb's",
                "beta",
            )
        if self.beta is not None and self.law == "coulomb":
            if given:
                raise mistake(
                    f"found {self.beta:g} beside law = 'coulomb', which has no beta; "
                    "leave one of them out: beta alone means the arctan law",
                    "beta",
                )
            object.__setattr__(self, "law", "arctan")  # the default beside beta; still not given
        return self

    def to_joint(self) -> Joint:
        """Joint of `skfem_joint.structure`; what is not given of its law is infinite."""
        values = self.model_dump(exclude={"law"})
        if isinstance(self.pressure, _PressureTable):
            values["pressure"] = self.pressure.to_pressure()
        if isinstance(self.gap, _SurfaceTable):
            values["gap"] = self.gap.to_surface()
        elif isinstance(self.gap, tuple):
            values["gap"] = tuple(part.to_surface() for part in self.gap)
        for name in ("beta", "tangential_stiffness", "normal_stiffness"):
            if values[name] is None:
                values[name] = math.inf
        return Joint(**values)


class BoltTable(SceneTable):
    """``[[bolt]]``: a bolt that presses joints with ``pressure = "preload"``."""

    force: Positive = key("clamp force, N")
    head: str | None = key("name of the boundary under the bolt's head", None)
    nut: str | None = key(
        "name of the boundary under its nut; if not given, it is screwed into the rigid base", None
    )
    shank: Annotated[TomlList[str], Field(min_length=2, max_length=2)] | None = key(
        "names of both faces of a cut through the shank of a meshed bolt, in place of head and nut",
        None,
    )
