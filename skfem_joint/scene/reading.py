"""Reading a scene, or those of a sweep: each mistake is one line, and all are raised together."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from skfem_joint.errors import InputError
from skfem_joint.files import read_text
from skfem_joint.mesh import NamedMesh, load_meshes
from skfem_joint.scene.messages import found_text, key_parts, key_path, sentences
from skfem_joint.scene.scene import OF_STRUCTURE, OF_SYSTEM, Scene, relations
from skfem_joint.scene.sweep_table import SweepTable
from skfem_joint.scene.tables import MeshTable

_LARGEST_SCENE = 2**20  # bytes
_MOST_MISTAKES = 200  # of tables that are told one by one
# The parser of TOML takes time with the square of the parts of a key.
_MOST_PARTS = 50
_LONG_KEY = re.compile(rf"""(?<![\w"'-])(?:[\w"'-]++[ \t]*+\.[ \t]*+){{{_MOST_PARTS}}}""")


def read_toml(path: Path) -> dict[str, Any]:
    """Tables of a scene file."""
    text = read_text(path, _LARGEST_SCENE)
    if found := _LONG_KEY.search(text):
        line = text.count("\n", 0, found.start()) + 1
        raise InputError(
            f"{path}: line {line}: not valid TOML: a key of more than {_MOST_PARTS} parts"
        )
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        at = re.search(r"line (\d+)", str(error))
        line = int(at[1]) if at else text.count("\n") + 1
        raise InputError(f"{path}: line {line}: not valid TOML: {error}") from error


def read_mesh(tables: Mapping[str, Any], folder: Path) -> tuple[NamedMesh | None, list[str]]:
    """Load the scene's mesh, or say what is wrong with the file."""
    try:
        table = MeshTable.model_validate(
            {key: tables["mesh"][key] for key in ("file", "scale") if key in tables["mesh"]}
        )
    except (KeyError, TypeError, ValidationError):
        return None, []  # told by the validation of the whole scene
    try:
        return load_meshes(table.paths(folder), scale=table.scale), []
    except InputError as error:
        return None, [f"mesh.file: {problem}" for problem in error.problems]
    except OSError as error:  # a name too long, or a folder that may not be searched
        return None, [f"mesh.file: {found_text(table.file)} cannot be read: {error.strerror}"]


def load_scene(path: str | Path) -> Scene:
    """Read a scene (TOML) and its mesh, and check them against each other.

    The files that it names are relative to it and may lie anywhere: they are read as data, nothing
    is ever run or written there.

    Raises
    ------
    InputError
        The file cannot be read or is not TOML, or anything in it is wrong; every mistake is one of
        its ``problems`` and starts with the file and the key.
    """
    path = Path(path)
    tables = read_toml(path)
    mesh, problems = read_mesh(tables, path.parent)
    return scene_from(tables, mesh, path, problems)


def scene_from(
    tables: Mapping[str, Any],
    mesh: NamedMesh | None,
    path: str | Path = "scene",
    problems: Sequence[str] = (),
) -> Scene:
    """Scene from its tables and its mesh, as `load_scene` makes it from files.

    Parameters
    ----------
    tables : mapping
        As in a scene file; ``mesh.file`` is not read and may be left out.
    mesh : NamedMesh or None
        None if there is none: then nothing is checked against it.
    path : str or Path
        Name of the scene in messages; files that loads name are relative to it.
    problems : sequence of str
        Mistakes found so far, raised with those that are found.
    """
    path = Path(path)
    if mesh is not None and "mesh" not in tables:
        tables = {**tables, "mesh": {"file": mesh.path or "mesh"}}
    found = list(problems)
    context = {"folder": path.parent}
    try:
        scene = Scene.model_validate(tables, context=context)
        right = {name: getattr(scene, name) for name in Scene.model_fields}
    except ValidationError as error:
        mistakes = error.errors()
        found += [line for one in mistakes[:_MOST_MISTAKES] for line in sentences(one, Scene)]
        if len(mistakes) > _MOST_MISTAKES:
            found.append(f"and {len(mistakes) - _MOST_MISTAKES} more mistakes")
        wrong = {one["loc"][0] for one in mistakes}
        right = {}
        for name, field in Scene.model_fields.items():
            if name not in wrong:
                adapter = TypeAdapter(field.rebuild_annotation())
                given = tables.get(name, field.default)
                right[name] = adapter.validate_python(given, context=context)
        scene = Scene.model_construct(**right)
    scene._path, scene._named_mesh = path, mesh
    found += relations(scene, right)
    lines = [f"{path}: {problem}" for problem in found]
    known = right.keys() >= OF_STRUCTURE and (mesh is not None or scene.matrices is not None)
    if known:
        lines += _misfits(scene, with_loads=right.keys() >= OF_SYSTEM)
    if lines:
        raise InputError(list(dict.fromkeys(lines)))
    return scene


def _misfits(scene: Scene, with_loads: bool) -> list[str]:
    """What in a scene does not fit its mesh or matrices: its structure or system is built."""
    try:
        scene.structure()
        if with_loads:
            scene.system()
    except InputError as error:
        return error.problems
    return []


@dataclass(frozen=True)
class Swept:
    """Scenes of a sweep, what each has of the swept keys, and the table that says so."""

    table: SweepTable
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
        sweep = SweepTable.model_validate(tables.pop("sweep", {}))
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
