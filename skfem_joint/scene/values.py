"""Types of the values in a scene's tables: numbers within limits, names, lists, several forms."""

from __future__ import annotations

from collections.abc import Mapping
from inspect import cleandoc
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Discriminator,
    Field,
    Tag,
    ValidationInfo,
)

from skfem_joint.scene.messages import Form, mistake, value_text

#: Largest whole number that a key takes (steps, modes, frames). A larger one is a typing error.
LARGEST_COUNT = 10**9

#: What is to be said where a backslash may stand for itself, as in a path of Windows.
BACKSLASHES = (
    "a backslash in double quotes begins an escape in TOML, such as \\t for a tab: write paths "
    "with forward slashes, 'C:/folder/a.msh', or in single quotes"
)

T = TypeVar("T")


class SceneTable(BaseModel):
    """Base of all tables of a scene: immutable, no unknown keys, no conversions, finite numbers."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)

    @classmethod
    def __pydantic_init_subclass__(cls, **options: Any) -> None:
        """Append the meanings of the keys to the docstring of a table, so that help has them."""
        super().__pydantic_init_subclass__(**options)
        meanings = (f"{name}\n    {field.description}" for name, field in cls.model_fields.items())
        lines = [cleandoc(cls.__doc__ or ""), "", "Attributes", "----------", *meanings]
        cls.__doc__ = "\n".join(lines)


def key(meaning: str, default: Any = ..., *, allowed: str = "", **limits: Any) -> Any:
    """Key of a table, as a pydantic field.

    Parameters
    ----------
    meaning : str
        What the key means, with its unit after a comma: messages and ``skfem-joint keys`` show it.
    default : optional
        Without a default the key must be given.
    allowed : str, optional
        Allowed values in words, for keys whose values have several forms.
    **limits
        Limits of pydantic's ``Field``, such as ``ge`` or ``min_length``.
    """
    extra: Any = {"allowed": allowed} if allowed else None
    return Field(default, description=meaning, json_schema_extra=extra, **limits)


def beside_scene(name: str, info: ValidationInfo) -> Path:
    """File whose name a table gives, relative to the folder of the scene."""
    folder: Path = (info.context or {}).get("folder", Path())
    return folder / name


def by_form(*forms: Form, otherwise: Form = Form.NUMBER) -> Discriminator:
    """Choose the type of a value by its form, so that messages are about that form alone.

    Parameters
    ----------
    *forms : Form
        Forms, beside ``otherwise``, that the key takes.
    otherwise : Form
        Form by which a value of any other form is checked, and refused.
    """

    def form_of(value: object) -> Form:
        form = Form.NUMBER
        if isinstance(value, str):
            form = Form.WORD
        elif isinstance(value, list | tuple):
            form = Form.LIST
        elif isinstance(value, Mapping | BaseModel):
            own = {Form.BOLTS: "bolts", Form.FIELD: "field"}
            named = (form for form in forms if form in own and own[form] in dict(value))
            form = next(named, Form.TABLE)
        return form if form in forms else otherwise

    return Discriminator(form_of)


def _from(smallest: float) -> AfterValidator:
    """Limit the size of a number, except 0, to what products of such numbers can take."""
    largest = 1e20

    def is_in_range(value: float) -> float:
        if value != 0.0 and not smallest <= abs(value) <= largest:
            raise mistake(
                f"found {value:g}, must be {smallest:g} to {largest:g} in size, or 0 where that "
                "is allowed: products of numbers beyond these limits overflow"
            )
        return value

    return AfterValidator(is_in_range)


def _is_file_name(name: str) -> str:
    if not name:
        raise mistake("found '', must be the name of a file")
    if any(letter < " " for letter in name):  # as "C:\temp" gives a tab
        raise mistake(f"found {name!r}, must be the name of a file; {BACKSLASHES}")
    return name


def has_no_repeats(values: tuple[T, ...]) -> tuple[T, ...]:
    """Return the values of a list, each of which must stand in it once."""
    seen: set[T] = set()
    for value in values:
        if value in seen:
            raise mistake(f"found {value_text(value)} more than once, must not repeat")
        seen.add(value)
    return values


def _are_few(names: tuple[str, ...]) -> tuple[str, ...]:
    if len(names) > 1000:  # 140,000 names took hours
        raise mistake(
            f"found {len(names)} names, must be at most 1000; name regions or boundaries in place "
            "of single points"
        )
    return names


def _has_coordinates(values: tuple[float, ...]) -> tuple[float, ...]:
    if not 2 <= len(values) <= 3:
        raise mistake(
            f"found a list of {len(values)}, must be two numbers, [x, y], or three, [x, y, z]"
        )
    return values


def _has_direction(values: tuple[float, ...]) -> tuple[float, ...]:
    if not any(values):
        raise mistake("found only zeros, which have no direction; a component must not be 0")
    return values


Number = Annotated[float, _from(1e-60)]
Positive = Annotated[float, Field(gt=0), _from(1e-20)]
NotNegative = Annotated[float, Field(ge=0), _from(1e-20)]
PoissonRatio = Annotated[float, Field(gt=-1, lt=0.5)]
Count = Annotated[int, Field(ge=1, le=LARGEST_COUNT)]
CountOrZero = Annotated[int, Field(ge=0, le=LARGEST_COUNT)]
FileName = Annotated[str, AfterValidator(_is_file_name)]
#: A list of TOML becomes a tuple. Its entries are not converted.
TomlList = Annotated[tuple[T, ...], Field(strict=False)]
#: A file, or several.
FileNames = Annotated[
    Annotated[FileName, Tag(Form.WORD)]
    | Annotated[TomlList[FileName], Field(min_length=1), Tag(Form.LIST)],
    by_form(Form.LIST, otherwise=Form.WORD),
]
#: A number, or the word that leaves it to the program.
NumberOrAuto = Annotated[
    Annotated[Literal["auto"], Tag(Form.WORD)] | Annotated[T, Tag(Form.NUMBER)],
    by_form(Form.WORD),
]
Names = Annotated[TomlList[str], AfterValidator(_are_few), AfterValidator(has_no_repeats)]
#: Two or three numbers.
Coordinates = Annotated[TomlList[Number], AfterValidator(_has_coordinates)]
#: Two or three numbers that are not all 0. Their length does not count.
Direction = Annotated[Coordinates, AfterValidator(_has_direction)]
