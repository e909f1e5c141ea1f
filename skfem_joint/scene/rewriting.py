"""Text of a scene with other values of keys and in another folder, otherwise as it was written.

Comments, order and layout stay; only the values that change are written anew.
"""

from __future__ import annotations

import os
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from skfem_joint.ground.errors import InputError
from skfem_joint.ground.key_paths import Location, key_parts

#: Keys of a sweep whose values are names of files.
_FILES_OF_SWEEP = re.compile(r"mesh\.file|load\[\d+\]\.file|joint\[\d+\]\.gap(\.file)?")


def rewritten(text: str, values: Mapping[str, float], folder: Path, target: Path) -> str:
    """Text of a scene with other values, whose file names are relative to another folder.

    Parameters
    ----------
    text : str
        Of a scene that is read without a mistake.
    values : mapping
        Numbers by their keys, ``{"joint[0].friction": 0.8}``.
    folder : Path
        Folder of the scene.
    target : Path
        Folder in which the new text will be.

    Raises
    ------
    InputError
        If the scene has no table to a key.
    """
    import tomlkit

    document = tomlkit.parse(text)
    for key, value in values.items():
        _set(document, key_parts(key) or (key,), float(value), key)
    for owner, place in _file_keys(document):
        owner[place] = _moved(owner[place], folder.resolve(), target.resolve())
    return tomlkit.dumps(document)


def _set(document: Any, parts: Location, value: float, key: str) -> None:
    """Set a value, in tables that are made where there are none."""
    table = document
    try:
        for part in parts[:-1]:
            if isinstance(part, str) and part not in table:
                table[part] = {}
            table = table[part]
        table[parts[-1]] = value
    except (KeyError, IndexError, TypeError) as error:
        raise InputError(f"{key}: the scene has no such table") from error


def _file_keys(document: Any) -> Iterator[tuple[Any, str | int]]:
    """Tables and lists of a scene, and their keys and positions that name files."""
    if "file" in document.get("mesh", {}):
        yield document["mesh"], "file"
    for load in document.get("load", ()):
        if "file" in load:
            yield load, "file"
    for joint in document.get("joint", ()):
        if "gap" in joint:
            yield from _files_of_gap(joint)
    if "psd" in document.get("random", {}):
        yield document["random"], "psd"
    sweep = document.get("sweep", {})
    for key in list(sweep):
        if _FILES_OF_SWEEP.fullmatch(key):
            yield sweep, key


def _files_of_gap(joint: Any) -> Iterator[tuple[Any, str | int]]:
    """As `_file_keys`, of a joint with a gap: a number, a file, a table with one, or a list."""
    gap = joint["gap"]
    if isinstance(gap, list):
        for i, part in enumerate(gap):
            yield (part, "file") if isinstance(part, dict) else (gap, i)
    else:
        yield (gap, "file") if isinstance(gap, dict) else (joint, "gap")


def _moved(names: Any, folder: Path, target: Path) -> Any:
    """Name of a file, or a list of such, relative to another folder; other values as they are."""
    if isinstance(names, list):
        return [_moved(name, folder, target) for name in names]
    if not isinstance(names, str):
        return names
    path = folder / names
    if Path(names).is_absolute():
        return str(names)
    try:
        return Path(os.path.relpath(path, target)).as_posix()
    except ValueError:  # on another drive
        return path.as_posix()
