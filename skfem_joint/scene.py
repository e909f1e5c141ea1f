"""A scene: all that a run needs, read from a TOML file and checked as a whole before it runs.

The file is validated by the models of `skfem_joint.scene_tables` and `skfem_joint.scene_plates` (SI
units, unknown keys are errors, NaN and infinity are refused everywhere) and against its mesh, which
decides whether the scene is one of struts or of plates. Every mistake found becomes one line, ::

    scene.toml: load[0].frequency: found -5, must be > 0

and all of them are raised together as one `InputError`.

The files that a scene names may lie anywhere that a relative or absolute path leads to, as
``../meshes/bar.msh`` does: they are read as data, and nothing is ever run or written there.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, TypeAlias, overload

from pydantic import Field, PrivateAttr, TypeAdapter, ValidationError

from skfem_joint import loads
from skfem_joint.errors import InputError
from skfem_joint.files import read_whole
from skfem_joint.meshing import BarMesh
from skfem_joint.plate_mesh import PlateMesh, load_meshes
from skfem_joint.scene_checks import held_names, n_steps, relations, time_step
from skfem_joint.scene_loads import AnyLoad, AnyPlateLoad
from skfem_joint.scene_messages import found_text, sentences
from skfem_joint.scene_plates import (
    PlateJoint,
    PlateMaterial,
    PlateOutput,
    PlateReduction,
    PlateSection,
    PlateSupport,
)
from skfem_joint.scene_tables import (
    CommonOutput,
    CommonReduction,
    CrossSection,
    Damping,
    Joint,
    Material,
    Mesh,
    Models,
    Output,
    Reduction,
    Support,
    Time,
)
from skfem_joint.scene_values import A_LIST, AnyMesh, SceneTable

__all__ = ["AnyScene", "CommonScene", "PlateScene", "Scene", "load_scene", "scene_from"]

_LARGEST_SCENE = 2**20  # bytes
# The parser of TOML takes time with the square of the parts of a key.
_MOST_PARTS = 50
_LONG_KEY = re.compile(rf"""(?<![\w"'-])(?:[\w"'-]++[ \t]*+\.[ \t]*+){{{_MOST_PARTS}}}""")


class CommonScene(SceneTable):
    """What scenes of struts and of plates have in common."""

    title: str = ""
    mesh: Mesh
    material: Any
    section: Any
    support: Any
    joint: tuple[Any, ...] = ()
    damping: Damping = Damping()
    load: tuple[Any, ...]
    time: Time
    models: Models = Models()
    reduction: CommonReduction = CommonReduction()
    output: CommonOutput = CommonOutput()

    _path: Path | None = PrivateAttr(None)

    @property
    def path(self) -> Path:
        """The file the scene came from."""
        if self._path is None:
            raise InputError("scene: has no file, read it with load_scene(path)")
        return self._path

    @property
    def overrides(self) -> dict[str, dict[str, float]]:
        """Material and section values that differ, by region and key."""
        merged: dict[str, dict[str, float]] = {}
        for table in (self.material, self.section):
            for region, override in table.regions.items():
                merged.setdefault(region, {}).update(override.model_dump(exclude_none=True))
        return merged

    @property
    def cycle_period(self) -> float | None:
        """Common period of the harmonic loads, s; None if they have none."""
        return loads.common_period(item.to_load() for item in self.load)

    @property
    def time_step(self) -> float:
        """Length of a step, s."""
        return time_step(self.time, self.cycle_period)

    @property
    def n_steps(self) -> int:
        """Number of steps; the last one ends at the end of the run or just beyond it."""
        return n_steps(self.time)

    @property
    def cycle_steps(self) -> int | None:
        """Steps of one cycle; None for a scene by duration."""
        return self.time.steps_per_cycle if self.time.cycles is not None else None


class Scene(CommonScene):
    """A whole scene of struts. `load_scene` reads one from a file and gives it its mesh.

    Raises
    ------
    pydantic.ValidationError
        When made directly from values that are not allowed; `load_scene` raises `InputError`.
    """

    material: Material
    section: CrossSection
    support: Support
    joint: Annotated[tuple[Joint, ...], A_LIST] = ()
    load: Annotated[tuple[AnyLoad, ...], A_LIST] = Field(min_length=1)
    reduction: Reduction = Reduction()
    output: Output = Output()

    _bar: BarMesh | None = PrivateAttr(None)

    @property
    def bar(self) -> BarMesh:
        """The mesh the scene was checked against."""
        if self._bar is None:
            raise InputError("scene: has no mesh yet, read it with load_scene(path)")
        return self._bar

    @property
    def output_points(self) -> tuple[str, ...]:
        """Points whose motion is reported: those asked for, else all that are not held."""
        if self.output.points:
            return self.output.points
        held = {self.bar.points[name] for name in self.support.fixed}
        return tuple(name for name, node in self.bar.points.items() if node not in held)


class PlateScene(CommonScene):
    """A whole scene of plates. `load_scene` reads one from a file and gives it its mesh.

    Raises
    ------
    pydantic.ValidationError
        When made directly from values that are not allowed; `load_scene` raises `InputError`.
    """

    material: PlateMaterial
    section: PlateSection
    support: PlateSupport
    joint: Annotated[tuple[PlateJoint, ...], A_LIST] = ()
    load: Annotated[tuple[AnyPlateLoad, ...], A_LIST] = Field(min_length=1)
    reduction: PlateReduction = PlateReduction()
    output: PlateOutput = PlateOutput()

    _plate: PlateMesh | None = PrivateAttr(None)

    @property
    def plate(self) -> PlateMesh:
        """The mesh the scene was checked against."""
        if self._plate is None:
            raise InputError("scene: has no mesh yet, read it with load_scene(path)")
        return self._plate

    @property
    def output_points(self) -> tuple[str, ...]:
        """Points and boundaries whose motion is reported: those asked for, else all free points.

        The motion of what is loaded is reported in any case.
        """
        if self.output.points:
            return self.output.points
        held = held_names(self.support, self.plate)
        return tuple(name for name in self.plate.points if name not in held)


AnyScene: TypeAlias = Scene | PlateScene


def _read_toml(path: Path) -> dict[str, Any]:
    try:
        text = read_whole(path, _LARGEST_SCENE).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = error.object[: error.start].count(b"\n") + 1
        raise InputError(f"{path}: line {line}: not UTF-8 text") from error
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


def _read_mesh(raw: Mapping[str, Any], folder: Path) -> tuple[AnyMesh | None, list[str]]:
    """Load the scene's mesh, or say what is wrong with the file."""
    try:
        mesh = Mesh.model_validate(
            {key: raw["mesh"][key] for key in ("file", "scale") if key in raw["mesh"]}
        )
    except (KeyError, TypeError, ValidationError):
        return None, []  # told by the validation of the whole scene
    try:
        return load_meshes(mesh.paths(folder), scale=mesh.scale), []
    except InputError as error:
        return None, [f"mesh.file: {problem}" for problem in error.problems]
    except OSError as error:  # a name too long, or a folder that may not be searched
        return None, [f"mesh.file: {found_text(mesh.file)} cannot be read: {error.strerror}"]


def load_scene(path: str | Path) -> AnyScene:
    """Read a scene and its mesh and check them against each other.

    Parameters
    ----------
    path : str or Path
        A TOML file; the files it names are relative to it.

    Returns
    -------
    Scene or PlateScene
        With `bar` or `plate`, and `path` set.

    Raises
    ------
    InputError
        The file cannot be read or is not TOML, or anything in it is wrong; every mistake is one of
        its ``problems`` and starts with the file and the key.
    """
    path = Path(path)
    raw = _read_toml(path)
    mesh, problems = _read_mesh(raw, path.parent)
    return scene_from(raw, mesh, path, problems)


@overload
def scene_from(
    raw: Mapping[str, Any],
    mesh: BarMesh,
    path: str | Path = "scene",
    problems: Sequence[str] = (),
) -> Scene: ...
@overload
def scene_from(
    raw: Mapping[str, Any],
    mesh: PlateMesh,
    path: str | Path = "scene",
    problems: Sequence[str] = (),
) -> PlateScene: ...
@overload
def scene_from(
    raw: Mapping[str, Any],
    mesh: AnyMesh | None,
    path: str | Path = "scene",
    problems: Sequence[str] = (),
) -> AnyScene: ...
def scene_from(
    raw: Mapping[str, Any],
    mesh: AnyMesh | None,
    path: str | Path = "scene",
    problems: Sequence[str] = (),
) -> AnyScene:
    """Scene from its tables and its mesh, as `load_scene` makes it from files.

    Parameters
    ----------
    raw : mapping
        The tables, as in a scene file; ``mesh.file`` is not read.
    mesh : BarMesh, PlateMesh or None
        The mesh; None if it could not be read, which is then among the problems.
    path : str or Path
        Name of the scene in messages; files that loads name are relative to it.
    problems : sequence of str
        Mistakes found so far.

    Raises
    ------
    InputError
        If anything is wrong, as in `load_scene`.
    """
    path = Path(path)
    found = list(problems)
    kind = _kind(raw, mesh)
    context = {"mesh": mesh, "folder": path.parent}
    scene: AnyScene | None = None
    try:
        scene = kind.model_validate(raw, context=context)
        tables = {name: getattr(scene, name) for name in kind.model_fields}
    except ValidationError as error:
        found += [line for details in error.errors() for line in sentences(details, kind)]
        wrong = {details["loc"][0] for details in error.errors()}
        tables = {}
        for name, field in kind.model_fields.items():
            if name not in wrong:
                adapter = TypeAdapter(field.rebuild_annotation())
                given = raw.get(name, field.default)
                tables[name] = adapter.validate_python(given, context=context)
    found += relations(tables, mesh)
    if scene is None or found:
        raise InputError([f"{path}: {problem}" for problem in dict.fromkeys(found)])
    if isinstance(scene, Scene) and not isinstance(mesh, PlateMesh):
        scene._bar = mesh
    elif isinstance(scene, PlateScene) and isinstance(mesh, PlateMesh):
        scene._plate = mesh
    scene._path = path
    return scene


def _kind(raw: Mapping[str, Any], mesh: AnyMesh | None) -> type[Scene] | type[PlateScene]:
    """Kind of scene: by its mesh, or by keys that only plates have where it could not be read."""
    if mesh is not None:
        return PlateScene if isinstance(mesh, PlateMesh) else Scene
    section = raw.get("section")
    only_plates = isinstance(section, Mapping) and "thickness" in section and "width" not in section
    return PlateScene if only_plates else Scene
