"""Other values at keys of a scene's tables, for sweeps and for `Scene.changed`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from skfem_joint.ground.errors import InputError
from skfem_joint.ground.key_paths import Location, key_parts, key_path

# Keys that a given key takes the place of, by table.
_IN_PLACE_OF: dict[str, dict[str, tuple[str, ...]]] = {
    "time": {
        "cycles": ("until", "duration", "step"),
        "until": ("cycles", "duration", "step"),
        "duration": ("cycles", "until", "steps_per_cycle"),
    },
    "damping": {"ratio": ("stiffness", "mass"), "stiffness": ("ratio",), "mass": ("ratio",)},
}


def replaced(table: Any, parts: Location, value: Any, where: str, depth: int = 0) -> Any:
    """Copy of nested tables and lists with another value at a key; None leaves the key out.

    InputError, which names ``where``, if a table or position on the way to the key is missing.
    """
    if depth == len(parts):
        return value
    part = parts[depth]
    if isinstance(part, str) and isinstance(table, Mapping):
        inner = replaced(table.get(part, {}), parts, value, where, depth + 1)
        if inner is None:
            return {name: other for name, other in table.items() if name != part}
        return {**table, part: inner}
    if isinstance(part, int) and isinstance(table, list | tuple) and part < len(table):
        inner = replaced(table[part], parts, value, where, depth + 1)
        return [*table[:part], inner, *table[part + 1 :]]
    raise InputError(f"{where}: the scene has no {key_path(parts[: depth + 1])}")


def with_changes(
    tables: Mapping[str, Any],
    values: Mapping[str, Any],
    keys_of: Mapping[str, Any],
    where: str = "changed: ",
) -> dict[str, Any]:
    """Tables of a scene with other values, which are not checked here.

    ``values`` and ``keys_of`` are as for `Scene.changed`. InputError for keys of missing tables,
    which begins with ``where``.
    """
    changes: dict[Location, Any] = {}
    by_path = {key: key_parts(key) for key in values}
    whole = {key: values[key] for key, parts in by_path.items() if parts is None}
    for name, keys in (whole | {**keys_of}).items():
        if isinstance(keys, Mapping) and keys:
            present = tables.get(name)
            several = isinstance(present, list | tuple)
            places = [(name, i) for i in range(len(present or ()))] if several else [(name,)]
            changes |= {(*place, key): value for place in places for key, value in keys.items()}
        elif name not in tables or not isinstance(keys, Mapping):
            changes[name,] = keys
    changes |= {parts: values[key] for key, parts in by_path.items() if parts is not None}
    for (*place, last), value in list(changes.items()):
        for other in _excluded(place, last, value):
            changes.setdefault((*place, other), None)
    changed = dict(tables)
    for parts, value in changes.items():
        # Numbers and arrays of numpy become those of Python.
        given = value.tolist() if hasattr(value, "tolist") else value
        changed = replaced(changed, parts, given, f"{where}{key_path(parts)}")
    return changed


def _excluded(place: list[int | str], key: int | str, value: Any) -> tuple[str, ...]:
    """Keys of a table that a given value of one of its keys takes the place of."""
    if value is None or [type(part) for part in place] not in ([str], [str, int]):
        return ()
    if (place[0], key, value) == ("joint", "law", "coulomb"):
        return ("beta",)
    if (place[0], key) == ("joint", "beta"):
        return ("law",)
    return _IN_PLACE_OF.get(str(place[0]), {}).get(str(key), ())
