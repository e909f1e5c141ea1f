"""Mistakes in a scene as sentences of the pattern ``key: found VALUE, must be ...``.

pydantic reports each mistake as a location, a type and a context. This module turns such a report
into a sentence. The JSON schema of the tables tells which keys a table has and what they mean.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from enum import StrEnum
from functools import cache
from typing import Any

from pydantic import BaseModel
from pydantic_core import ErrorDetails, PydanticCustomError

from skfem_joint.ground.errors import InputError, closest, listed
from skfem_joint.ground.key_paths import Location, key_parts, key_path

#: Part of the JSON schema that pydantic makes of the tables.
Schema = Mapping[str, Any]


class Form(StrEnum):
    """Form of a value of a key that takes several forms.

    pydantic puts the form into the location of a mistake, from which it is removed.
    """

    WORD = "form: word"
    NUMBER = "form: number"
    TABLE = "form: table"
    LIST = "form: list"
    BOLTS = "form: bolts"
    FIELD = "form: field"


def mistake(text: str, key: str = "") -> PydanticCustomError:
    """Error to be raised in a validator.

    Parameters
    ----------
    text : str
        What is wrong; each of its lines becomes a problem of its own.
    key : str, optional
        Key below the table or value whose validator raises.
    """
    return PydanticCustomError("scene", "{text}", {"text": text, "key": key})


@contextmanager
def of_key(key: str = "", before: str = "") -> Iterator[None]:
    """Raise the problems of an InputError as a `mistake`, without what stands before each."""
    try:
        yield
    except InputError as error:
        lines = [problem.removeprefix(before) for problem in error.problems]
        raise mistake("\n".join(lines), key) from error


def value_text(value: object) -> str:
    """Value in a message, at most 60 characters long."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, Mapping):
        return "a table"
    if isinstance(value, list | tuple):
        return "a list" if value else "an empty list"
    text = repr(value) if isinstance(value, str | float | int) else str(value)
    return text if len(text) <= 60 else text[:57] + "..."


def alternatives(part: Schema) -> list[Schema]:
    """Schemas of the forms that a value may have; none if it has one form."""
    return [form for name in ("anyOf", "oneOf", "allOf") for form in part.get(name, ())]


def tables_in(part: Schema, defs: Schema) -> Iterator[Schema]:
    """Schemas of the tables that a value, or an entry of a list, may be.

    ``defs`` are the schemas by name to which ``part`` refers.
    """
    if "$ref" in part:
        yield defs[part["$ref"].rpartition("/")[2]]
    elif "properties" in part or "additionalProperties" in part:
        yield part
    for form in [*alternatives(part), *([part["items"]] if "items" in part else [])]:
        yield from tables_in(form, defs)


def meaning(path: str, root: type[BaseModel]) -> str:
    """Meaning and unit of a key of a scene, "" for an unknown key."""
    _, field = _follow(key_parts(path) or (), root)
    return _meaning(field)


def _meaning(field: Schema | None) -> str:
    """First clause of a key's description: meaning and unit."""
    return str((field or {}).get("description", "")).split(";")[0]


@cache
def _schema(root: type[BaseModel]) -> Schema:
    return root.model_json_schema()


def _kinds(table: Schema) -> list[str]:
    """Values that a table allows for its key ``kind``; none for a table without this key."""
    kind = table.get("properties", {}).get("kind", {})
    return kind.get("enum") or [kind["const"]] if kind else []


def _follow(location: Location, root: type[BaseModel]) -> tuple[list[Schema], Schema | None]:
    """Schemas of the tables that may stand at a location, and that of its last key."""
    tables, field = [_schema(root)], None
    defs = tables[0].get("$defs", {})
    for part in location:
        if isinstance(part, int) or part in {*Form}:
            continue
        if of_kind := [table for table in tables if part in _kinds(table)]:
            tables = of_kind
            continue
        candidates = [
            table.get("properties", {}).get(part, table.get("additionalProperties"))
            for table in tables
        ]
        fields = [candidate for candidate in candidates if candidate]
        field = fields[0] if fields else None
        tables = [table for candidate in fields for table in tables_in(candidate, defs)]
    return tables, field


def sentences(error: ErrorDetails, root: type[BaseModel]) -> list[str]:
    """Sentences about a mistake that pydantic reports in a scene.

    Parameters
    ----------
    error : ErrorDetails
        One of ``ValidationError.errors()``.
    root : type of BaseModel
        Model of the whole scene.
    """
    location, kind, context = error["loc"], error["type"], error.get("ctx", {})
    of_load = location[:1] == ("load",)  # its location has the kind of load as third part
    path = tuple(
        part
        for i, part in enumerate(location)
        if part not in {*Form, "[key]"} and not (of_load and i == 2)
    )
    where = key_path(path)
    tables, field = _follow(location, root)
    kinds = [value for table in tables for value in _kinds(table)]
    match kind:
        case "scene":
            where = ".".join(filter(None, [where, context["key"]]))
            return [f"{where}: {line}" for line in context["text"].split("\n")]
        case "extra_forbidden":
            parents, _ = _follow(location[:-1], root)
            keys = list(dict.fromkeys(key for table in parents for key in table["properties"]))
            hint = closest(str(location[-1]), keys)
            return [f"{where}: unknown key{hint}; allowed: {', '.join(keys)}"]
        case "missing":
            needed = f": {field['description']}" if field and "description" in field else ""
            return [f"{where}: missing, must be given{needed}"]
        case "union_tag_not_found":
            return [f"{where}.kind: missing, must be one of {listed(kinds)}"]
        case "union_tag_invalid":
            given, hint = value_text(error["input"]["kind"]), closest(context["tag"], kinds)
            must_be = f"must be one of {context['expected_tags']}{hint}"
            return [f"{where}.kind: found {given}, {must_be}"]
        case "too_short" if len(error["input"]) >= context["min_length"]:
            return []  # pydantic does not count the entries that are wrong in themselves
    must_be = _must_be(error, location, field)
    if kind == "tuple_type" and path in (("joint",), ("load",), ("bolt",)):
        must_be += f" of tables, each under [[{where}]]"
    return [f"{where}: found {value_text(error['input'])}, {must_be}"]


def _must_be(error: ErrorDetails, location: Location, field: Schema | None) -> str:
    """What a value must be, by the type of the mistake that pydantic reports."""
    of_numbers = {
        "greater_than": "must be > {gt:g}",
        "greater_than_equal": "must be >= {ge:g}",
        "less_than": "must be < {lt:g}",
        "less_than_equal": "must be <= {le:g}",
        "float_type": "must be a number",
        "float_parsing": "must be a number",
    }
    others = {
        "finite_number": "must be finite",
        "int_type": "must be a whole number",
        "int_parsing": "must be a whole number",
        "string_type": "must be a text in quotes",
        "string_too_short": "must not be empty",
        "bool_type": "must be true or false",
        "bool_parsing": "must be true or false",
        "literal_error": "must be {expected}",
        "tuple_type": "must be a list",
        "dict_type": "must be a table",
        "model_type": "must be a table",
        "model_attributes_type": "must be a table",
        "too_short": "must have {min_length} or more entries",
    }
    kind = error["type"]
    allowed = field.get("allowed") if field else None
    if allowed and location[-1] in {*Form} and kind in ("literal_error", "float_type", "int_type"):
        return f"must be {allowed}"
    pattern = (of_numbers | others).get(kind)
    must_be = pattern.format_map(error.get("ctx", {})) if pattern else error["msg"]
    if kind in of_numbers and not allowed and (meant := _meaning(field)):
        must_be += f" ({meant})"
    return must_be
