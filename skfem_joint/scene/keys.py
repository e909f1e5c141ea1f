"""Reference of a scene's keys, made from the models that check a scene.

``skfem-joint keys`` shows it, and ``docs/reference/keys.md`` holds it.
"""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

from skfem_joint.ground.errors import InputError, closest
from skfem_joint.scene.messages import Schema, alternatives, tables_in
from skfem_joint.scene.scene import Scene
from skfem_joint.scene.values import LARGEST_COUNT

if TYPE_CHECKING:
    from rich.console import Console


class Key(NamedTuple):
    """Row of the reference.

    Attributes
    ----------
    key : str
        Name.
    unit : str
        SI unit, "" for a pure number or for what is no number.
    default : str
        As it is written in a scene; "required" for a key that must be given, "" for a key that may
        be left out and then has no value.
    allowed : str
        Allowed values in words.
    meaning : str
        What the key means.
    """

    key: str
    unit: str
    default: str
    allowed: str
    meaning: str


@dataclass(frozen=True)
class KeyTable:
    """Keys of a table of the scene, or of one form of such a table.

    Attributes
    ----------
    path : str
        Path of the table, such as "joint.pressure"; "" for the scene itself.
    title : str
        Table as it is written in a scene.
    meaning : str
        What it describes.
    keys : tuple of Key
        Its keys.
    """

    path: str
    title: str
    meaning: str
    keys: tuple[Key, ...]


def reference(table: str = "") -> list[KeyTable]:
    """Tables of a scene, or a table such as "joint.pressure" and those inside it.

    Raises
    ------
    InputError
        If there is no such table.
    """
    schema = Scene.model_json_schema()
    schema["description"] = "``SCENE.toml``: tables, and a title"
    tables = [*_tables("", "", "", [schema], schema["$defs"])]
    chosen = [each for each in tables if f"{each.path}.".startswith(f"{table}." if table else "")]
    if not chosen:
        paths = dict.fromkeys(each.path for each in tables if each.path)
        raise InputError(
            f"keys: found {table!r}{closest(table, paths)}; the tables are {', '.join(paths)}"
        )
    return chosen


def _tables(
    path: str, title: str, meaning: str, forms: list[Schema], defs: Schema
) -> Iterator[KeyTable]:
    """Reference of a table, and of the tables inside it.

    A table of several forms comes first with the keys that all forms share, then form by form with
    the keys of each.
    """
    shared: dict[str, Schema] = {}
    if len(forms) > 1 and (shared := _shared(forms)):
        meaning += "; all kinds have these keys, and those below"
        yield KeyTable(path, title, meaning, tuple(_key(*item) for item in shared.items()))
    for form in forms:
        own = {name: part for name, part in form["properties"].items() if name not in shared}
        if any_name := form.get("additionalProperties"):
            own['"TABLE.KEY"'] = any_name
        needed = form.get("required", ())
        rows = tuple(_key(name, part, name in needed) for name, part in own.items())
        own_words, _, _ = form["description"].partition("\nAttributes\n")
        head, _, rest = " ".join(own_words.split()).partition("``: ")
        yield KeyTable(path, head.removeprefix("``"), rest, rows)
        for name, part in own.items():
            with_keys: list[Schema] = []
            for each in tables_in(part.get("additionalProperties", part), defs):
                if "properties" in each and each not in with_keys:  # also as entry of a list
                    with_keys.append(each)
            if with_keys:
                below = f"{path}.{name}" if path else name
                what = part.get("description", "")
                yield from _tables(below, f"[[{below}]]", what, with_keys, defs)


def _shared(forms: list[Schema]) -> dict[str, Schema]:
    """Keys that are the same in all forms of a table."""
    first, *others = (form["properties"] for form in forms)
    return {k: part for k, part in first.items() if all(other.get(k) == part for other in others)}


def _key(name: str, part: Schema, needed: bool = False) -> Key:
    """Row of a key, from its schema."""
    meaning = part.get("description", "")
    units = "Pa|Pa/m|kg/m³|m|m/s|m/s²|s|Hz|N|rad|degrees|s/m|1/s|octaves/min"
    with_unit = re.compile(rf", ({units})(?=[;:,]|$)")
    unit = with_unit.search(meaning)
    default = "required" if needed else _value(part.get("default"))
    meaning = with_unit.sub("", meaning, count=1)
    return Key(name, unit[1] if unit else "", default, _allowed(part), meaning)


def _value(value: Any) -> str:
    """Value as it is written in a scene; "" for none and for a table."""
    if value is None or isinstance(value, Mapping):
        return ""
    return f"{value:g}" if isinstance(value, float) else json.dumps(value).replace('"', "'")


def _allowed(part: Schema) -> str:
    """Allowed values of a key in words, from its schema."""
    if "allowed" in part:
        return str(part["allowed"])
    if forms := alternatives(part):
        texts = (_allowed(form) for form in forms if form.get("type") != "null")
        return " or ".join(dict.fromkeys(texts))
    if words := part.get("enum") or ("const" in part and [part["const"]]):
        return ", ".join(map(_value, words))
    if "items" in part:
        return f"list of {_allowed(part['items'])}"
    types = {
        "number": "number",
        "integer": "whole number",
        "string": "text",
        "object": "table",
        "boolean": "true or false",
        "None": "value",
    }
    limits = {"exclusiveMinimum": ">", "minimum": ">=", "exclusiveMaximum": "<", "maximum": "<="}
    stated = (
        f"{sign} {part[limit]:g}"
        for limit, sign in limits.items()
        if part.get(limit, LARGEST_COUNT) != LARGEST_COUNT
    )
    kind = "object" if "$ref" in part else str(part.get("type"))
    return f"{types[kind]} {' and '.join(stated)}".strip()


def markdown(tables: Sequence[KeyTable]) -> str:
    """Reference in Markdown; with a heading and its contents if it is that of the whole scene."""
    lines = []
    if not tables[0].path:
        lines += [
            "# Keys of a scene",
            "",
            "A scene is a TOML file. This page lists every key that it may have, with its unit,",
            "its default, the values that are allowed and its meaning. It is what",
            "`skfem-joint keys` prints, made from the models that check a scene;",
            "`skfem-joint keys load` prints one table. All units are SI units. A key that has no",
            "default and is not required may be left out. A table such as `[time]` stands once,",
            "one such as `[[joint]]` as often as needed.",
            "",
            *_contents(tables),
            "",
        ]
    for table in tables:
        lines += [f"{'###' if _is_part(table) else '##'} `{table.title}`", ""]
        lines += [_sentence(table.meaning), ""]
        lines += [f"| {' | '.join(Key._fields)} |", "|---" * len(Key._fields) + "|"]
        for row in table.keys:
            default = row.default and (
                row.default if row.default == "required" else f"`{row.default}`"
            )
            cells = f"`{row.key}`", row.unit, default, row.allowed, row.meaning
            lines.append(f"| {' | '.join(cells)} |")
        lines.append("")
    return "\n".join(lines)


def _contents(tables: Sequence[KeyTable]) -> list[str]:
    """Links to the tables, a line each, in which those inside it follow."""
    lines: list[str] = []
    for table in tables:
        # As web pages name a heading: letters, figures and hyphens.
        anchor = re.sub(r"[^\w -]", "", table.title.lower()).replace(" ", "-")
        link = f"[`{table.title}`](#{anchor})"
        if _is_part(table):
            lines[-1] += f", {link}"
        else:
            lines.append(f"- {link}")
    return lines


def _is_part(table: KeyTable) -> bool:
    """Whether it stands inside a table of the scene or is one of its forms."""
    return "." in table.path or (table.path != "" and not table.title.startswith("["))


def show(tables: Iterable[KeyTable], console: Console) -> None:
    """Print the reference on a terminal."""
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
