"""Kinds of values that scene tables are made of: numbers, and names that the mesh must have."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal, TypeAlias, TypeVar

from pydantic import (
    AfterValidator,
    BaseModel,
    BeforeValidator,
    ConfigDict,
    Field,
    Tag,
    ValidationInfo,
)

from skfem_joint.meshing import BarMesh
from skfem_joint.plate_mesh import PlateMesh
from skfem_joint.scene_messages import NUMBER, TABLE, WORD, closest, listed, mistake

AnyMesh: TypeAlias = BarMesh | PlateMesh

_SMALLEST, _LARGEST = 1e-20, 1e20  # numbers in SI units, but 0
MOST = 10**9  # steps, modes, frames: beyond it a number is a slip of the keyboard


def mesh_of(info: ValidationInfo) -> AnyMesh | None:
    """Give the mesh to check names against; None when a scene is made without one."""
    mesh: AnyMesh | None = (info.context or {}).get("mesh")
    return mesh


def groups(mesh: AnyMesh) -> dict[str, Mapping[str, Any]]:
    """Names of a mesh by what they are: ``point``, ``boundary`` (plates), ``region``."""
    if isinstance(mesh, BarMesh):
        return {"point": mesh.points, "region": mesh.regions}
    return {"point": mesh.points, "boundary": mesh.boundaries, "region": mesh.regions}


_PLURAL = {"point": "points", "boundary": "boundaries", "region": "regions"}


def _is(*wanted: str) -> AfterValidator:
    """Name of something of one of these kinds in the mesh."""

    def check(name: str, info: ValidationInfo) -> str:
        mesh = mesh_of(info)
        if mesh is None:
            return name
        names = groups(mesh)
        kinds = [kind for kind in names if kind in wanted]
        named = [known for kind in kinds for known in names[kind]]
        if name in named:
            if kinds == ["region"] and len(names["region"][name]) == 0:
                raise mistake(
                    f"found '{name}', a region without elements; it must hold at least one"
                )
            return name
        allowed = " or ".join(", ".join(kinds).rsplit(", ", 1))
        first, *rest = kinds
        exist = f"{_PLURAL[first]} of the mesh: {listed(names[first])}" + "".join(
            f"; {_PLURAL[kind]}: {listed(names[kind])}" for kind in rest
        )
        for kind in names:
            if name in names[kind]:
                raise mistake(f"found '{name}', which is a {kind}; a {allowed} is needed; {exist}")
        raise mistake(
            f"found '{name}', no such {allowed} in the mesh; {exist}{closest(name, named)}"
        )

    return AfterValidator(check)


def _is_file_name(name: str) -> str:
    if not name or "\0" in name:
        raise mistake(f"found {name!r}, must be the name of a file")
    return name


T = TypeVar("T")


def has_no_repeats(values: tuple[T, ...]) -> tuple[T, ...]:
    """Refuse a value that stands in a list twice."""
    repeated = [value for i, value in enumerate(values) if value in values[:i]]
    if repeated:
        raise mistake(f"found '{repeated[0]}' more than once, must not repeat")
    return values


def _from(smallest: float) -> AfterValidator:
    def is_in_range(value: float) -> float:
        if value != 0.0 and not smallest <= abs(value) <= _LARGEST:
            raise mistake(
                f"found {value:g}, must be {smallest:g} to {_LARGEST:g} in size, or 0 where that "
                "is allowed: beyond it products of such numbers overflow"
            )
        return value

    return AfterValidator(is_in_range)


Number = Annotated[float, _from(_SMALLEST**3)]
Positive = Annotated[float, Field(gt=0), _from(_SMALLEST)]
NotNegative = Annotated[float, Field(ge=0), _from(_SMALLEST)]
PointName = Annotated[str, _is("point")]
RegionName = Annotated[str, _is("region")]
BoundaryName = Annotated[str, _is("boundary")]
PlaceName = Annotated[str, _is("point", "region", "boundary")]
#: What is pressed: an area or an edge.
ContactName = Annotated[str, _is("region", "boundary")]
#: What is observed.
ObservedName = Annotated[str, _is("point", "boundary")]
FileName = Annotated[str, AfterValidator(_is_file_name)]
# TOML lists arrive as lists: not strict about that, still strict about their members.
A_LIST = Field(strict=False)
PointNames = Annotated[tuple[PointName, ...], A_LIST, AfterValidator(has_no_repeats)]
PlaceNames = Annotated[tuple[PlaceName, ...], A_LIST, AfterValidator(has_no_repeats)]
ObservedNames = Annotated[tuple[ObservedName, ...], A_LIST, AfterValidator(has_no_repeats)]


def _two_numbers(value: object) -> object:
    if isinstance(value, list | tuple) and len(value) != 2:
        raise mistake(f"found a list of {len(value)}, must be two numbers, [x, y]")
    return value


def _unit(direction: tuple[float, float]) -> tuple[float, float]:
    x, y = direction
    largest = max(abs(x), abs(y))
    if largest == 0.0:
        raise mistake("found [0, 0], which points nowhere; give two numbers, not both 0")
    x, y = x / largest, y / largest
    length = (x * x + y * y) ** 0.5
    return x / length, y / length


#: Two numbers, x and y.
Pair = Annotated[tuple[Number, Number], A_LIST, BeforeValidator(_two_numbers)]
#: Two numbers that are not both 0, made a unit vector.
Direction = Annotated[Pair, AfterValidator(_unit)]


def form(value: object) -> str:
    """Form of a value that may be a word, a number or a table."""
    if isinstance(value, str):
        return WORD
    return TABLE if isinstance(value, Mapping | BaseModel) else NUMBER


def number_or_word(value: object) -> str:
    """Form of a value that may be a word or a number."""
    return WORD if form(value) == WORD else NUMBER


Auto = Annotated[Literal["auto"], Tag(WORD)]


class SceneTable(BaseModel):
    """Base of all tables of a scene: immutable, no unknown keys, no conversions, finite numbers.

    Attributes
    ----------
    foreign : dict of str to str
        Keys of the same table in a scene of the other kind (struts, plates), and why not here.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)

    foreign: ClassVar[dict[str, str]] = {}
