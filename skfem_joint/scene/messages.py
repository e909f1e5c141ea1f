"""Mistakes in a scene as sentences: key, what was found, what is allowed."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator, Mapping
from functools import cache
from typing import Any

from pydantic import BaseModel
from pydantic_core import ErrorDetails, PydanticCustomError

from skfem_joint.errors import closest, listed

#: Part of the JSON schema that pydantic makes of the tables, and where it lists forms of a value.
Schema = Mapping[str, Any]
FORMS = ("anyOf", "oneOf", "allOf")
# Tags of the forms a value may take; they turn up in pydantic's locations and are cut out there.
WORD, NUMBER, TABLE, LIST, BOLTS = TAGS = (
    "form: word",
    "form: number",
    "form: table",
    "form: list",
    "form: bolts",
)


def mistake(text: str, key: str = "") -> PydanticCustomError:
    """Error with a text of one's own, at a key below the place where it is raised."""
    return PydanticCustomError("scene", "{text}", {"text": text, "key": key})


def key_path(location: tuple[int | str, ...]) -> str:
    """Write a key path as TOML does, list positions in brackets."""
    text = ""
    for part in location:
        if isinstance(part, int):
            text += f"[{part}]"
        else:
            bare = re.fullmatch(r"[A-Za-z0-9_-]+", part)
            text += ("." if text else "") + (part if bare else json.dumps(part, ensure_ascii=False))
    return text


_NAME = r'[A-Za-z0-9_-]+|"[^"]+"'


def key_parts(text: str) -> tuple[int | str, ...] | None:
    """Parts of a key of a value in a table, as `key_path` writes it; None: it is no such key."""
    if not re.fullmatch(rf"(?:{_NAME})(?:\.(?:{_NAME})|\[[0-9]+\])+", text):
        return None
    parts = re.findall(rf"({_NAME})|\[([0-9]+)\]", text)
    return tuple(int(at) if at else name.strip('"') for name, at in parts)


def found_text(value: object) -> str:
    """What was found, short enough for a sentence."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, Mapping):
        return "a table"
    if isinstance(value, list | tuple):
        return "a list" if value else "an empty list"
    text = repr(value) if isinstance(value, str | float | int) else str(value)
    return text if len(text) <= 60 else text[:57] + "..."


def tables_in(part: Schema, defs: Schema) -> Iterator[Schema]:
    """Schemas of the tables that a value may be, or the entries of a list."""
    if "$ref" in part:
        yield defs[part["$ref"].rpartition("/")[2]]
    elif "properties" in part or "additionalProperties" in part:
        yield part
    forms = [form for name in FORMS for form in part.get(name, ())]
    for form in [*forms, part["items"]] if "items" in part else forms:
        yield from tables_in(form, defs)


def _kinds(table: Schema) -> list[str]:
    """Values allowed for the key ``kind``; none for a table without it."""
    kind = table.get("properties", {}).get("kind", {})
    return kind.get("enum") or [kind["const"]] if kind else []


_schema = cache(lambda root: root.model_json_schema())


def _follow(
    location: tuple[int | str, ...], root: type[BaseModel]
) -> tuple[list[Schema], Schema | None]:
    """Find the tables that may stand at one of pydantic's locations, and the key it ends with."""
    tables, field = [_schema(root)], None
    defs = tables[0]["$defs"]
    for part in location:
        if isinstance(part, int) or part in TAGS:
            continue
        if kinds := [table for table in tables if part in _kinds(table)]:
            tables = kinds
            continue
        every = (t.get("properties", {}).get(part, t.get("additionalProperties")) for t in tables)
        found = [one for one in every if one]
        field = found[0] if found else None
        tables = [table for one in found for table in tables_in(one, defs)]
    return tables, field


def meaning(key: str, root: type[BaseModel]) -> str:
    """Meaning and unit of a key, "" if there is none."""
    _, field = _follow(key_parts(key) or (), root)
    return _meant(field)


def _meant(field: Schema | None) -> str:
    return str((field or {}).get("description", "")).split(";")[0]


_MUST_BE = {
    "greater_than": "must be > {gt:g}",
    "greater_than_equal": "must be >= {ge:g}",
    "less_than": "must be < {lt:g}",
    "less_than_equal": "must be <= {le:g}",
    "finite_number": "must be finite",
    "float_type": "must be a number",
    "int_type": "must be a whole number",
    "string_type": "must be a text in quotes",
    "bool_type": "must be true or false",
    "literal_error": "must be {expected}",
    "union_tag_invalid": "must be one of {expected_tags}",
    "tuple_type": "must be a list",
    "dict_type": "must be a table",
    "model_type": "must be a table",
    "model_attributes_type": "must be a table",
    "too_short": "must have {min_length} or more entries",
}
# Mistakes that a key's meaning and unit help with.
_OF_NUMBERS = ("greater_than", "greater_than_equal", "less_than", "less_than_equal", "float_type")


def sentences(error: ErrorDetails, root: type[BaseModel]) -> list[str]:
    """One of pydantic's errors as key, what was found, what is allowed."""
    location, kind, context = error["loc"], error["type"], error.get("ctx", {})
    has_kind = location[:1] == ("load",) and len(location) > 2
    places = [
        part
        for i, part in enumerate(location)
        if part not in (*TAGS, "[key]") and not (has_kind and i == 2)
    ]
    tables, field = _follow(location, root)
    if kind == "scene":
        key = ".".join(filter(None, [key_path(tuple(places)), context["key"]]))
        return [f"{key}: {line}" for line in context["text"].split("\n")]
    if kind == "extra_forbidden":
        parents, _ = _follow(location[:-1], root)
        keys = list(dict.fromkeys(key for table in parents for key in table["properties"]))
        hint = closest(str(location[-1]), keys)
        return [f"{key_path(tuple(places))}: unknown key{hint}; allowed: {', '.join(keys)}"]
    if kind == "missing":
        needed = f": {field['description']}" if field and "description" in field else ""
        return [f"{key_path(tuple(places))}: missing, must be given{needed}"]
    if kind == "union_tag_not_found":
        kinds = [kind for table in tables for kind in _kinds(table)]
        return [f"{key_path((*places, 'kind'))}: missing, must be one of {listed(kinds)}"]

    if kind == "too_short" and len(error["input"]) >= context["min_length"]:
        return []  # pydantic does not count the entries that are wrong in themselves

    found, hint = found_text(error["input"]), ""
    if kind == "union_tag_invalid":
        places.append("kind")
        found = found_text(error["input"]["kind"])
        hint = closest(context["tag"], re.findall(r"'(\w+)'", context["expected_tags"]))
    must_be = _MUST_BE[kind].format_map(context) if kind in _MUST_BE else error["msg"]
    allowed = field.get("allowed") if field else None
    if allowed and location[-1] in TAGS and kind in ("literal_error", "float_type", "int_type"):
        must_be = f"must be {allowed}"
    if kind == "tuple_type" and places in (["joint"], ["load"], ["bolt"]):
        must_be += f" of tables, each under [[{places[0]}]]"
    elif kind in _OF_NUMBERS and not allowed and (meant := _meant(field)):
        must_be += f" ({meant})"
    return [f"{key_path(tuple(places))}: found {found}, {must_be}{hint}"]
