"""Reads a scene, or the scenes of a sweep, and raises all mistakes together, a line each."""

from __future__ import annotations

import os
import re
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter, ValidationError

from skfem_joint.ground.errors import InputError
from skfem_joint.ground.files import read_text
from skfem_joint.ground.progress import Progress, silent
from skfem_joint.ground.values import check_kind
from skfem_joint.mesh import NamedMesh, load_meshes
from skfem_joint.scene.changes import with_changes
from skfem_joint.scene.messages import sentences, value_text
from skfem_joint.scene.scene import (
    TABLES_OF_STRUCTURE,
    TABLES_OF_SYSTEM,
    Scene,
    problems_between_tables,
)
from skfem_joint.scene.sweep_table import SweepTable
from skfem_joint.scene.tables import MeshTable
from skfem_joint.scene.values import BACKSLASHES
from skfem_joint.structure.load import load_problems


def load_scene(
    path: str | Path,
    progress: Progress = silent,
    ready: Callable[[Scene], object] | None = None,
) -> Scene:
    """Read a scene (TOML) and its mesh, and check them against each other.

    File names in the scene are relative to its folder and may lead anywhere. The files are read as
    data; nothing in them is executed, and nothing is written.

    Parameters
    ----------
    path : str or Path
        File of the scene.
    progress : callable, optional
        Called with (what is done, how much, of how much, a note) while bolts are tightened.
    ready : callable, optional
        Called with the scene when its tables are right, before its structure is built: whatever it
        raises costs no preload.

    Returns
    -------
    Scene

    Raises
    ------
    InputError
        The file cannot be read or is not TOML, or anything in it is wrong; every mistake is one of
        its ``problems`` and starts with the file and the key. With bolts that clamp, mistakes in
        names of supports and joints follow when the tables are right: they are tightened for them.
    """
    check_kind("path", path, str | os.PathLike)
    path = Path(path)
    tables = _read_toml(path)
    mesh, problems = _read_mesh(tables, path.parent)
    return scene_from(tables, mesh, path, problems, progress, ready)


def _read_toml(path: Path) -> dict[str, Any]:
    """Tables of a scene file of at most a mebibyte."""
    text = read_text(path, 2**20)
    most = 50  # parts of a key; the parser's time grows with their square
    long_key = re.compile(rf"""(?<![\w"'-])(?:[\w"'-]++[ \t]*+\.[ \t]*+){{{most}}}""")
    if match := long_key.search(text):
        line = text.count("\n", 0, match.start()) + 1
        raise InputError(f"{path}: line {line}: not valid TOML: a key of more than {most} parts")
    try:
        return tomllib.loads(text)
    except (ValueError, RecursionError) as error:
        at = re.search(r"line (\d+)", str(error))
        line = int(at[1]) if at else text.count("\n") + 1
        cure = ""
        if re.search("hex value|Unescaped|scalar", str(error)):  # what tomllib says of escapes
            cure = f"; {BACKSLASHES}"
        elif re.search(r"=\s*[+-]?\d+,\d", "".join(text.splitlines()[line - 1 : line])):
            cure = "; numbers have a decimal point, not a comma"
        raise InputError(f"{path}: line {line}: not valid TOML: {error}{cure}") from error


def _read_mesh(tables: Mapping[str, Any], folder: Path) -> tuple[NamedMesh | None, list[str]]:
    """Mesh of a scene, or none and the problems of its files.

    Problems of the table ``[mesh]`` itself are left to the validation of the whole scene.
    """
    try:
        table = MeshTable.model_validate(
            {key: tables["mesh"][key] for key in ("file", "scale") if key in tables["mesh"]}
        )
    except (KeyError, TypeError, ValidationError):
        return None, []
    try:
        return load_meshes(table.paths(folder), scale=table.scale), []
    except InputError as error:
        return None, [f"mesh.file: {problem}" for problem in error.problems]
    except OSError as error:  # a name too long, or a folder that may not be searched
        return None, [f"mesh.file: {value_text(table.file)} cannot be read: {error.strerror}"]


def scene_from(
    tables: Mapping[str, Any],
    mesh: NamedMesh | None,
    path: str | Path = "scene",
    problems: Sequence[str] = (),
    progress: Progress = silent,
    ready: Callable[[Scene], object] | None = None,
) -> Scene:
    """Scene from its tables and its mesh, as `load_scene` makes it from files.

    Parameters
    ----------
    tables : mapping
        As in a scene file; ``mesh.file`` is not read and may be left out.
    mesh : NamedMesh or None
        Without a mesh nothing is checked against it.
    path : str or Path
        Name of the scene in messages; files that loads name are relative to its folder.
    problems : sequence of str
        Problems known before, which are raised with those of the tables.
    progress, ready
        As for `load_scene`.

    Raises
    ------
    InputError
        As `load_scene`.
    """
    check_kind("tables", tables, Mapping)
    check_kind("mesh", mesh, NamedMesh | None)
    path = Path(path)
    if mesh is not None and "mesh" not in tables:
        tables = {**tables, "mesh": {"file": mesh.path or "mesh"}}
    scene, valid, mistakes = _validated(tables, path)
    scene._path, scene._named_mesh = path, mesh
    lines = [*problems, *mistakes, *problems_between_tables(scene, valid)]
    if mesh is not None and valid >= TABLES_OF_SYSTEM and scene.matrices is None:
        lines += load_problems(mesh, scene.loads(), scene.output.points)
        lines += scene.stress_problems(mesh)
    lines = [f"{path}: {line}" for line in lines]
    if ready is not None and not lines:
        ready(scene)
    costly = "bolt" in valid and bool(scene.bolt) and bool(lines)  # mistakes come before a preload
    given = mesh is not None or scene.matrices is not None
    if valid >= TABLES_OF_STRUCTURE and given and not costly:
        try:
            scene.structure(progress)
            if valid >= TABLES_OF_SYSTEM:
                scene.system()
        except InputError as error:  # does not fit its mesh or matrices
            lines += error.problems
    if lines:
        raise InputError(list(dict.fromkeys(lines)))
    return scene


def _validated(tables: Mapping[str, Any], path: Path) -> tuple[Scene, set[str], list[str]]:
    """Scene of the valid tables, their names, and the problems of the others."""
    context = {"folder": path.parent}
    try:
        scene = Scene.model_validate(tables, context=context)
        return scene, {*Scene.model_fields}, []
    except ValidationError as error:
        errors = error.errors()
    most = 200  # mistakes that are worded
    lines = [line for each in errors[:most] for line in sentences(each, Scene)]
    if len(errors) > most:
        lines.append(f"and {len(errors) - most} more mistakes")
    wrong = {each["loc"][0] for each in errors}
    valid = {
        name: TypeAdapter(field.rebuild_annotation()).validate_python(
            tables.get(name, field.default), context=context
        )
        for name, field in Scene.model_fields.items()
        if name not in wrong
    }
    return Scene.model_construct(**valid), {*valid}, lines


@dataclass(frozen=True)
class Swept:
    """Scenes of a sweep.

    Attributes
    ----------
    table : SweepTable
        The table ``[sweep]`` that they are made by.
    values : tuple of dict
        Values of the swept keys in each scene.
    scenes : tuple of Scene
        Scenes in the same order, without what can be assembled again.
    """

    table: SweepTable
    values: tuple[dict[str, Any], ...]
    scenes: tuple[Scene, ...]

    def label(self, number: int) -> str:
        """Swept keys of a scene with their values, for messages."""
        return _label(self.values[number])


def load_sweep(path: str | Path, progress: Progress = silent) -> Swept:
    """Read a scene file with a ``[sweep]`` and make its scenes, each checked as by `load_scene`.

    A key that the sweep gives need not stand in the file's own tables.

    Parameters
    ----------
    path : str or Path
        File of the scene.
    progress : callable, optional
        As `load_scene`.

    Returns
    -------
    Swept
        Its ``scenes`` are what `sweep` runs.

    Raises
    ------
    InputError
        As `load_scene`. A problem of several scenes is reported once, with the first of them.
    """
    check_kind("path", path, str | os.PathLike)
    path = Path(path)
    tables = _read_toml(path)
    try:
        sweep = SweepTable.model_validate(tables.pop("sweep", {}))
    except ValidationError as error:
        errors = error.errors()
        for each in errors:
            each["loc"] = ("sweep", *each["loc"])
        lines = [f"{path}: {line}" for each in errors for line in sentences(each, Scene)]
        raise InputError(lines) from error
    labels: dict[str, list[str]] = {}  # of the scenes that have a problem, by problem
    scenes, meshes = [], {}
    values = sweep.combinations()
    for row in values:
        try:
            changed = with_changes(tables, row, {}, f"{path}: sweep: ")
            mesh_table = repr(changed.get("mesh"))
            if mesh_table not in meshes:
                meshes[mesh_table] = _read_mesh(changed, path.parent)
            mesh, mesh_problems = meshes[mesh_table]
            made = scene_from(changed, mesh, path, mesh_problems, progress)
            scenes.append(made.unassembled())
        except InputError as error:
            for problem in error.problems:
                labels.setdefault(problem, []).append(_label(row))
    if labels:
        raise InputError([_of_scenes(*problem) for problem in labels.items()])
    return Swept(sweep, tuple(values), tuple(scenes))


def load_with_sweep(
    path: str | Path, progress: Progress = silent
) -> tuple[Scene, Swept | None, list[str]]:
    """Read a scene file and the scenes of its sweep, if it has one.

    A key that the sweep gives need not stand in the file's own tables. The file is then no valid
    scene by itself, and the first scene of the sweep takes its place.

    Returns
    -------
    scene : Scene
        Scene of the file, or the first scene of the sweep.
    swept : Swept or None
        Scenes of the sweep; None without ``[sweep]``.
    notes : list of str
        A sentence that says so if the first scene of the sweep is returned.

    Raises
    ------
    InputError
        As `load_sweep` if there is a ``[sweep]``, otherwise as `load_scene`.
    """
    swept = load_sweep(path, progress) if "sweep" in _read_toml(Path(path)) else None
    try:
        return load_scene(path, progress), swept, []
    except InputError as error:
        if swept is None:
            raise
        note = (
            f"The scene described is the sweep's first, {swept.label(0)}. Without the values of "
            f"the sweep the file is no valid scene, and only the command sweep takes it: {error}"
        )
        return swept.scenes[0], swept, [note]


def _label(row: Mapping[str, Any]) -> str:
    return ", ".join(f"{name} = {value_text(value)}" for name, value in row.items())


def _of_scenes(problem: str, labels: Sequence[str]) -> str:
    """Problem with the label of the first scene that has it, and the number of the others."""
    others = f" and in {len(labels) - 1} more of its scenes" if labels[1:] else ""
    return f"{problem}; in the sweep's scene of {labels[0]}{others}"
