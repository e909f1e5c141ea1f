"""Reference of a scene's keys, made from the models that check them."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

from skfem_joint.errors import InputError, closest
from skfem_joint.scene.messages import FORMS, Schema, tables_in
from skfem_joint.scene.scene import Scene
from skfem_joint.scene.values import MOST

if TYPE_CHECKING:
    from rich.console import Console

_UNIT = re.compile(r", (Pa|kg/m³|m|s|Hz|N|rad|degrees|s/m|1/s)(?=[;:,]|$)")
_LIMITS = {"exclusiveMinimum": ">", "minimum": ">=", "exclusiveMaximum": "<", "maximum": "<="}
_TYPES = {
    "number": "number",
    "integer": "whole number",
    "string": "text",
    "object": "table",
    "boolean": "true or false",
    "None": "value",
}
_PAGE = """# Keys of a scene

What `skfem-joint keys` prints, made from the models that check a scene. `skfem-joint keys load`
shows one table. SI units throughout; a key without a default that is not required may be left out.

"""


class Key(NamedTuple):
    """A key as the reference shows it; ``default`` is "required" where there is none."""

    key: str
    unit: str
    default: str
    allowed: str
    meaning: str


@dataclass(frozen=True)
class KeyTable:
    """Keys of one table: where it stands, as it is written, and what it is."""

    path: str
    title: str
    meaning: str
    keys: tuple[Key, ...]


def reference(table: str = "") -> list[KeyTable]:
    """Tables of a scene, or one of them, such as "joint.pressure", and what stands below it.

    Raises
    ------
    InputError
        If there is no such table.
    """
    schema = Scene.model_json_schema()
    schema["description"] = "``SCENE.toml``: tables, and a title"
    every = [*_tables("", "", "", [schema], schema["$defs"])]
    found = [one for one in every if f"{one.path}.".startswith(f"{table}." if table else "")]
    if not found:
        paths = dict.fromkeys(one.path for one in every if one.path)
        raise InputError(
            f"keys: found {table!r}{closest(table, paths)}; the tables are {', '.join(paths)}"
        )
    return found


def _tables(
    path: str, title: str, meaning: str, forms: list[Schema], defs: Schema
) -> Iterator[KeyTable]:
    """A table of one or several forms: what all of them have, each by itself, and those below."""
    if len(forms) > 1 and (shared := _shared(forms)):
        meaning += "; all kinds have these keys, and those below"
        yield KeyTable(path, title, meaning, tuple(_key(*item) for item in shared.items()))
    else:
        shared = {}
    for form in forms:
        own = {name: part for name, part in form["properties"].items() if name not in shared}
        if any_name := form.get("additionalProperties"):
            own['"TABLE.KEY"'] = any_name
        needed = form.get("required", ())
        rows = tuple(_key(name, part, name in needed) for name, part in own.items())
        head, _, rest = " ".join(form["description"].split()).partition("``: ")
        yield KeyTable(path, head.removeprefix("``"), rest, rows)
        for name, part in own.items():
            below = f"{path}.{name}" if path else name
            inner = tables_in(part.get("additionalProperties", part), defs)
            if some := [one for one in inner if "properties" in one]:
                what = part.get("description", "")
                yield from _tables(below, f"[[{below}]]", what, some, defs)


def _shared(forms: list[Schema]) -> dict[str, Schema]:
    """Keys that are the same in all forms of a table."""
    first, *others = (form["properties"] for form in forms)
    return {k: part for k, part in first.items() if all(one.get(k) == part for one in others)}


def _key(name: str, part: Schema, needed: bool = False) -> Key:
    meaning = part.get("description", "")
    unit = _UNIT.search(meaning)
    default = "required" if needed else _value(part.get("default"))
    shown = _UNIT.sub("", meaning, count=1)
    return Key(name, unit[1] if unit else "", default, _allowed(part), shown)


def _value(value: Any) -> str:
    """Default as it is written in a scene; nothing where it is to be left out."""
    if value is None or isinstance(value, Mapping):
        return ""
    return f"{value:g}" if isinstance(value, float) else json.dumps(value).replace('"', "'")


def _allowed(part: Schema) -> str:
    """What a value may be, in words and signs."""
    if "allowed" in part:
        return str(part["allowed"])
    if forms := next((part[name] for name in FORMS if name in part), None):
        texts = (_allowed(one) for one in forms if one.get("type") != "null")
        return " or ".join(dict.fromkeys(texts))
    if words := part.get("enum") or ("const" in part and [part["const"]]):
        return ", ".join(map(_value, words))
    if "items" in part:
        return f"list of {_allowed(part['items'])}"
    kind = "object" if "$ref" in part else str(part.get("type"))
    limits = (f"{_LIMITS[name]} {part[name]:g}" for name in _LIMITS if part.get(name, MOST) != MOST)
    return f"{_TYPES[kind]} {' and '.join(limits)}".strip()


def markdown(tables: Sequence[KeyTable]) -> str:
    """Reference as a page of Markdown."""
    lines = []
    for table in tables:
        lines += [f"## `{table.title}`", "", _sentence(table.meaning), ""]
        lines += [f"| {' | '.join(Key._fields)} |", "|---" * len(Key._fields) + "|"]
        lines += [f"| `{row.key}` | {' | '.join(row[1:])} |" for row in table.keys]
        lines.append("")
    return _PAGE * (not tables[0].path) + "\n".join(lines)


def show(tables: Iterable[KeyTable], console: Console) -> None:
    """Show the reference on a terminal."""
    from rich.table import Table
    from rich.text import Text

    for table in tables:
        console.print(Text(table.title, style="bold"), Text(_sentence(table.meaning)), sep="\n")
        grid = Table(box=None, padding=(0, 2, 0, 0))
        for name in Key._fields:
            grid.add_column(name, no_wrap=name in ("key", "unit"))
        for row in table.keys:
            grid.add_row(*map(Text, row))
        console.print(grid, "")


def _sentence(text: str) -> str:
    return f"{text[:1].upper()}{text[1:].removesuffix('.')}.".replace("``", "`")
