"""Keys of tables as one text, ``joint[0].friction``: the same in scenes, sweeps and derivatives."""

from __future__ import annotations

import json
import re

#: Parts of a path: a key, a position in a list, or `EVERY`.
Location = tuple[int | str, ...]

#: In place of a position: all entries of a list, ``[*]``.
EVERY = -1


def key_path(location: Location) -> str:
    """Path of a key as TOML writes it, with positions in lists in brackets."""
    text = ""
    for part in location:
        if isinstance(part, int):
            text += "[*]" if part == EVERY else f"[{part}]"
        else:
            bare = re.fullmatch(r"[A-Za-z0-9_-]+", part)
            text += ("." if text else "") + (part if bare else json.dumps(part, ensure_ascii=False))
    return text


def key_parts(path: str, *, every: bool = False) -> Location | None:
    """Parts of a path that `key_path` wrote and that leads into a table; None for other texts.

    With ``every`` a list may have ``[*]`` in place of a position, which becomes `EVERY`.
    """
    name, place = r'[A-Za-z0-9_-]+|"[^"]+"', r"[0-9]+|\*" if every else "[0-9]+"
    if not re.fullmatch(rf"(?:{name})(?:\.(?:{name})|\[(?:{place})\])+", path):
        return None
    parts = re.findall(rf"({name})|\[({place})\]", path)
    return tuple(
        key.strip('"') if key else EVERY if position == "*" else int(position)
        for key, position in parts
    )
