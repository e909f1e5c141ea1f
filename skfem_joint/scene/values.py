"""Kinds of values that the tables of a scene are made of: numbers in range, names, lists, forms."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Literal, TypeVar

from pydantic import AfterValidator, BaseModel, ConfigDict, Discriminator, Field, Tag

from skfem_joint.scene.messages import BOLTS, LIST, NUMBER, TABLE, WORD, found_text, mistake

_SMALLEST, _LARGEST = 1e-20, 1e20  # numbers in SI units, but 0
#: Steps, modes, frames: beyond it a number is a slip of the keyboard.
MOST = 10**9
#: Names in one list of a scene.
MOST_LISTED = 1000


class SceneTable(BaseModel):
    """Base of all tables of a scene: immutable, no unknown keys, no conversions, finite numbers."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


def _from(smallest: float) -> AfterValidator:
    def is_in_range(value: float) -> float:
        if value != 0.0 and not smallest <= abs(value) <= _LARGEST:
            raise mistake(
                f"found {value:g}, must be {smallest:g} to {_LARGEST:g} in size, or 0 where that "
                "is allowed: beyond it products of such numbers overflow"
            )
        return value

    return AfterValidator(is_in_range)


def _is_file_name(name: str) -> str:
    if not name or "\0" in name:
        raise mistake(f"found {name!r}, must be the name of a file")
    return name


T = TypeVar("T")


def has_no_repeats(values: tuple[T, ...]) -> tuple[T, ...]:
    """Refuse a value that stands in a list twice."""
    seen: set[T] = set()
    for value in values:
        if value in seen:
            raise mistake(f"found {found_text(value)} more than once, must not repeat")
        seen.add(value)
    return values


def _are_few(names: tuple[str, ...]) -> tuple[str, ...]:
    if len(names) > MOST_LISTED:
        raise mistake(
            f"found {len(names)} names, must be at most {MOST_LISTED}; name regions or boundaries "
            "in place of single points"
        )
    return names


def _has_coordinates(values: tuple[float, ...]) -> tuple[float, ...]:
    if not 2 <= len(values) <= 3:
        raise mistake(
            f"found a list of {len(values)}, must be two numbers, [x, y], or three, [x, y, z]"
        )
    return values


def _points_somewhere(values: tuple[float, ...]) -> tuple[float, ...]:
    if not any(values):
        raise mistake("found zeros alone, which point nowhere; one number must not be 0")
    return values


Number = Annotated[float, _from(_SMALLEST**3)]
Positive = Annotated[float, Field(gt=0), _from(_SMALLEST)]
NotNegative = Annotated[float, Field(ge=0), _from(_SMALLEST)]
Count = Annotated[int, Field(ge=1, le=MOST)]
PoissonRatio = Annotated[float, Field(gt=-1, lt=0.5)]
FileName = Annotated[str, AfterValidator(_is_file_name)]
# TOML lists arrive as lists: not strict about that, still strict about their members.
A_LIST = Field(strict=False)
Names = Annotated[tuple[str, ...], A_LIST, AfterValidator(_are_few), AfterValidator(has_no_repeats)]
#: Two or three numbers.
Coordinates = Annotated[tuple[Number, ...], A_LIST, AfterValidator(_has_coordinates)]
#: Two or three numbers that are not all 0; the length does not count.
Direction = Annotated[Coordinates, AfterValidator(_points_somewhere)]
Auto = Annotated[Literal["auto"], Tag(WORD)]


def one_of(*forms: str, otherwise: str = NUMBER) -> Discriminator:
    """Tell the forms that a key may have from each other."""

    def choose(value: object) -> str:
        found = NUMBER
        if isinstance(value, str):
            found = WORD
        elif isinstance(value, list | tuple):
            found = LIST
        elif isinstance(value, Mapping | BaseModel):
            found = BOLTS if BOLTS in forms and "bolts" in dict(value) else TABLE
        return found if found in forms else otherwise

    return Discriminator(choose)


def key(meaning: str, default: Any = ..., *, allowed: str = "", **limits: Any) -> Any:
    """Field of a table: meaning and unit, default unless it must be given, limits.

    ``allowed`` says for messages what a key of several forms may be.
    """
    extra: Any = {"allowed": allowed} if allowed else None
    return Field(default, description=meaning, json_schema_extra=extra, **limits)
