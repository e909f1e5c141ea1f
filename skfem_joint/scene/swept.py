"""Scenes of a sweep: one for each combination of the values in a scene file's ``[sweep]``."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from skfem_joint.errors import InputError
from skfem_joint.scene.messages import found_text, key_parts, key_path, sentences
from skfem_joint.scene.reading import read_mesh, read_toml, scene_from
from skfem_joint.scene.scene import Scene
from skfem_joint.scene.sweep_table import Sweep


@dataclass(frozen=True)
class Swept:
    """Scenes of a sweep, what each has of the swept keys, and the table that says so."""

    table: Sweep
    values: tuple[dict[str, Any], ...]
    scenes: tuple[Scene, ...]

    def named(self, number: int) -> str:
        """What tells a scene from the others."""
        return _named(self.values[number])


def load_sweep(path: str | Path) -> Swept:
    """Read a scene file with a ``[sweep]`` and make its scenes, each checked as by `load_scene`.

    A key that the sweep gives need not stand in the file's own tables.

    Raises
    ------
    InputError
        As `load_scene`. What is wrong with some of the scenes is told once, with the first of them.
    """
    path = Path(path)
    tables = read_toml(path)
    try:
        sweep = Sweep.model_validate(tables.pop("sweep", {}))
    except ValidationError as error:
        errors = error.errors()
        for one in errors:
            one["loc"] = ("sweep", *one["loc"])
        lines = [f"{path}: {line}" for one in errors for line in sentences(one, Scene)]
        raise InputError(lines) from error
    problems: dict[str, list[str]] = {}
    scenes, meshes = [], {}
    values = sweep.combinations()
    for row in values:
        try:
            changed: dict[str, Any] = tables
            for name, value in row.items():
                changed = _changed(changed, name, value, f"{path}: sweep.{key_path((name,))}")
            mesh_table = repr(changed.get("mesh"))
            if mesh_table not in meshes:
                meshes[mesh_table] = read_mesh(changed, path.parent)
            mesh, wrong = meshes[mesh_table]
            scene = scene_from(changed, mesh, path, wrong)
            scenes.append(scene.light())
        except InputError as error:
            for problem in error.problems:
                problems.setdefault(problem, []).append(_named(row))
    if problems:
        raise InputError([_told(*problem) for problem in problems.items()])
    return Swept(sweep, tuple(values), tuple(scenes))


def _changed(table: Any, key: str, value: Any, where: str, depth: int = 0) -> Any:
    """Copy of nested tables and lists with another value at a key."""
    parts = key_parts(key) or ()
    if depth == len(parts):
        return value
    part = parts[depth]
    if isinstance(part, str) and isinstance(table, Mapping):
        return {**table, part: _changed(table.get(part, {}), key, value, where, depth + 1)}
    if isinstance(part, int) and isinstance(table, list) and part < len(table):
        inner = _changed(table[part], key, value, where, depth + 1)
        return [*table[:part], inner, *table[part + 1 :]]
    raise InputError(f"{where}: the scene has no {key_path(parts[: depth + 1])}")


def _named(row: Mapping[str, Any]) -> str:
    return ", ".join(f"{name} = {found_text(value)}" for name, value in row.items())


def _told(problem: str, scenes: Sequence[str]) -> str:
    others = f" and in {len(scenes) - 1} more of its scenes" if scenes[1:] else ""
    return f"{problem}; in the sweep's scene of {scenes[0]}{others}"
