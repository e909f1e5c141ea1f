"""A whole scene: its tables, the checks between them, and the system that they describe."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator, Mapping, Set
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Self

from pydantic import (
    PrivateAttr,
    ValidationError,
    ValidationInfo,
    ValidatorFunctionWrapHandler,
    field_validator,
)
from pydantic_core import PydanticKnownError

from skfem_joint.body.body import Material
from skfem_joint.body.checks import wrong_name
from skfem_joint.ground.errors import InputError, listed, refuse
from skfem_joint.ground.key_paths import key_parts, key_path
from skfem_joint.ground.loads import common_period
from skfem_joint.ground.progress import Progress, silent
from skfem_joint.joint.clamps import Clamp
from skfem_joint.linalg.parts import Parts
from skfem_joint.mesh import NamedMesh
from skfem_joint.runs.resolution import PER_PERIOD
from skfem_joint.scene import joint_tables, tables
from skfem_joint.scene.changes import with_changes
from skfem_joint.scene.matrices import MatricesTable
from skfem_joint.scene.messages import mistake, sentences
from skfem_joint.scene.sweep_table import SweepTable
from skfem_joint.scene.values import LARGEST_COUNT, SceneTable, TomlList, key
from skfem_joint.structure.load import Load
from skfem_joint.structure.model import AnyStructure
from skfem_joint.structure.structure import Structure
from skfem_joint.system.system import System

_log = logging.getLogger(__name__)

#: Tables that the structure is built from, and those that its system is built from.
TABLES_OF_STRUCTURE = frozenset(
    {"matrices", "mesh", "material", "section", "support", "joint", "bolt", "damping"}
)
TABLES_OF_SYSTEM = TABLES_OF_STRUCTURE | {"load", "output"}
#: What a table of a command must say at least.
_SAID = {
    "response": "frequencies = { from, to, points } and levels",
    "nonlinear_modes": "amplitudes = { from, to, points }",
    "random": "psd = 'file.csv'",
}


class Scene(SceneTable):
    """A whole scene, of any dimension, as `load_scene` reads it from a file with its mesh.

    Its attributes are its tables. ``skfem-joint keys`` lists their keys with units, defaults and
    meanings, which the docstrings of the tables' classes have too. A scene that is made directly
    from wrong values raises a ``pydantic.ValidationError``.
    """

    title: str = key("heading of the results", "")
    matrices: MatricesTable | None = key(
        "matrices of the structure, in place of mesh, material, section, support and bolt", None
    )
    mesh: tables.MeshTable | None = key(
        "the mesh file; required unless there is [matrices]", None, validate_default=True
    )
    material: tables.MaterialTable | None = key(
        "material of the bodies; required unless there is [matrices]", None, validate_default=True
    )
    section: tables.SectionTable = key("width and thickness", tables.SectionTable())
    support: tables.SupportTable = key("parts that are held", tables.SupportTable())
    joint: TomlList[joint_tables.JointTable] = key("joints with friction", ())
    bolt: TomlList[joint_tables.BoltTable] = key("bolts whose clamp force presses joints", ())
    damping: tables.DampingTable = key("linear damping", tables.DampingTable())
    load: TomlList[tables.AnyLoad] = key("forces as functions of time", min_length=1)
    time: tables.TimeTable = key("length of the run and of its steps")
    models: tables.ModelsTable = key("models that are integrated", tables.ModelsTable())
    reduction: tables.ReductionTable = key("how the reduced model is made", tables.ReductionTable())
    accuracy: tables.AccuracyTable = key("largest errors allowed", tables.AccuracyTable())
    output: tables.OutputTable = key("files of results", tables.OutputTable())
    response: tables.ResponseTable | None = key("frequencies and levels of steady vibration", None)
    backbone: tables.BackboneTable = key(
        "modes whose frequency and damping are computed against amplitude", tables.BackboneTable()
    )
    nonlinear_modes: tables.NonlinearModesTable | None = key(
        "modes whose frequency and damping are computed into gross slip", None
    )
    random: tables.RandomTable | None = key("load by its power spectral density", None)
    sweep: SweepTable | None = key("keys of the scene and the values they take in turn", None)

    _path: Path | None = PrivateAttr(None)
    _named_mesh: NamedMesh | None = PrivateAttr(None)
    _structure: AnyStructure | None = PrivateAttr(None)
    _system: System | None = PrivateAttr(None)

    @field_validator("mesh", "material", "section", "support", "bolt", mode="wrap")
    @classmethod
    def _is_mesh_or_matrices(
        cls, given: Any, make: ValidatorFunctionWrapHandler, info: ValidationInfo
    ) -> Any:
        """Refuse tables of a mesh beside [matrices]; mesh and material are required without."""
        wrong = "matrices" not in info.data  # [matrices] itself is wrong, and reported already
        matrices = info.data.get("matrices")
        if given is None:
            if not wrong and matrices is None:
                raise PydanticKnownError("missing")
            return None
        if matrices is not None:
            raise mistake(
                "found beside [matrices], which describes the whole structure; leave it out"
            )
        return make(given)

    @property
    def path(self) -> Path:
        """File that the scene was read from; `InputError` if there is none."""
        if self._path is None:
            raise InputError("scene: has no file, read it with load_scene(path)")
        return self._path

    @property
    def has_file(self) -> bool:
        """Whether the scene was read from a file, which is still there."""
        return self._path is not None and self._path.is_file()

    @property
    def named_mesh(self) -> NamedMesh:
        """Mesh of the scene; `InputError` if there is none."""
        if self._named_mesh is None:
            raise InputError(
                "scene: has no mesh; read it with load_scene or give it to scene_from, or leave "
                "out keys that need a mesh beside [matrices]"
            )
        return self._named_mesh

    def structure(self, progress: Progress = silent) -> AnyStructure:
        """Structure that the scene describes, built once; `InputError` if it cannot be built.

        ``progress`` is told of a preload, as by `Structure`.
        """
        if self._structure is None:
            with self._naming_file():
                self._structure = self._built_structure(partial(progress, "preload"))
        return self._structure

    @property
    def _is_slow(self) -> bool:
        """Whether the run leaves inertia out; not if its table is wrong, and so is not there."""
        return bool(getattr(getattr(self, "time", None), "quasi_static", False))

    @property
    def parts(self) -> Parts | None:
        """Parts that the structure is factorised in; none if their table is wrong."""
        count = getattr(getattr(self, "models", None), "parts", None)
        return None if count is None else Parts(count)

    def _built_structure(self, progress: Progress) -> AnyStructure:
        common: dict[str, Any] = {
            "joints": [joint.to_joint() for joint in self.joint],
            "stiffness_damping": self.damping.stiffness,
            "mass_damping": self.damping.mass,
            "damping_ratio": self.damping.ratio,
        }
        if self._is_slow:  # which neither velocity nor damping acts in
            still = [replace(joint, beta=math.inf) for joint in common["joints"]]
            common = {"joints": still, "stiffness_damping": 0.0, "mass_damping": 0.0}
            common["damping_ratio"] = None
        if self.matrices is not None:
            undamped = {"C": None} if self._is_slow else {}
            matrices = self.matrices.model_copy(update=undamped)
            return matrices.model((self._path or Path()).parent, common)
        material, regions = self.material, dict[str, dict[str, float]]()
        if material is None:
            raise InputError("material: missing, must be given with a mesh")
        for table in (material, self.section):
            for region, override in table.regions.items():
                regions.setdefault(region, {}).update(override.model_dump(exclude_none=True))
        made = Structure(
            self.named_mesh,
            Material(material.E, material.density, material.poisson),
            **self.section.model_dump(exclude={"regions"}),
            **self.support.model_dump(),
            **common,
            bolts=[Clamp(**bolt.model_dump()) for bolt in self.bolt],
            mass=material.mass_matrix,
            order="auto" if self.mesh is None else self.mesh.order,
            regions=regions,
            incompatible=self.mesh is None or self.mesh.incompatible,
            parts=self.parts,
            progress=progress,
        )
        made.tighten(progress)
        return made

    @property
    def left_out(self) -> tuple[str, ...]:
        """Sentences about what a quasi-static run leaves out of the scene; none of other runs."""
        if not self.time.quasi_static:
            return ()
        creeping = [joint for joint in self.joint if math.isfinite(joint.to_joint().beta)]
        notes = [
            f"Joint '{joint.on}': beta = {joint.to_joint().beta:.3g} s/m counts as infinite, since "
            "time.quasi_static leaves inertia out: friction does not depend on velocity then, and "
            "the law is Coulomb's."
            for joint in creeping
        ]
        given = self.matrices is not None and self.matrices.C is not None
        if given or any((self.damping.stiffness, self.damping.mass, self.damping.ratio)):
            notes.append("The damping of the scene is left out, as time.quasi_static asks for.")
        return tuple(notes)

    @property
    def opens(self) -> bool:
        """Whether contact of a joint opens and closes."""
        return any(joint.contact == "unilateral" for joint in self.joint)

    def passed_over(self, command: str) -> list[str]:
        """Sentence about keys that are given and that a command takes no account of, if any are."""
        given = [
            where
            for where, commands in tables.SERVED_BY.items()
            if command not in commands and self._is_given(*where.split("."))
        ]
        what = ", ".join(given)
        return [f"The command {command} takes no account of {what}."] if given else []

    def _is_given(self, table: str, name: str) -> bool:
        values = getattr(self, table)
        return bool(getattr(values, name) != type(values).model_fields[name].default)

    def check_vibrates(self, command: str) -> None:
        """Refuse a quasi-static scene, with an `InputError`, for a command about vibration."""
        if self.time.quasi_static:
            raise InputError(
                f"{self._path or 'scene'}: time.quasi_static: found true, but {command} computes "
                "vibration, which needs inertia; leave it out for this command"
            )

    def asked(self, table: str) -> Any:
        """Table of a command, ``[response]``, ``[nonlinear_modes]`` or ``[random]``.

        InputError if there is none.
        """
        if (found := getattr(self, table)) is None:
            raise InputError(f"{self.path}: {table}: missing; say {_SAID[table]} in a [{table}]")
        return found

    def loads(self) -> tuple[Load, ...]:
        """Loads of the structure."""
        return tuple(
            Load(load.on, load.to_amplitude(), load.direction, load.base, load.quantity)
            for load in self.load
        )

    def system(self) -> System:
        """System of the full model, assembled once; `InputError` as for `structure`."""
        if self._system is None:
            structure = self.structure()
            with self._naming_file():
                if self.matrices is None:
                    refuse(self.stress_problems(self.named_mesh))
                given = self.loads(), self.output.points or None
                self._system = structure.system(*given, quasi_static=self._is_slow)
            _log.info(
                "%s: %d degrees of freedom, %d unknowns, %d contact points.",
                *(self._path, structure.n_dofs, self._system.n, self._system.contact.count),
            )
        return self._system

    def stress_problems(self, mesh: NamedMesh) -> list[str]:
        """Sentences about names in ``output.stress`` that are no regions of a mesh."""
        problems = (wrong_name(mesh, at, ("region",), "output.stress") for at in self.output.stress)
        return [problem for each in problems for problem in each]

    @contextmanager
    def _naming_file(self) -> Iterator[None]:
        """Put the scene's file before each problem of an InputError."""
        try:
            yield
        except InputError as error:
            where = self._path or "scene"
            raise InputError([f"{where}: {problem}" for problem in error.problems]) from error

    @property
    def output_points(self) -> tuple[str, ...]:
        """Names of the observed points: those given, or all points that can move."""
        return self.output.points or tuple(self.structure().free_points)

    @property
    def cycle_period(self) -> float | None:
        """Common period of the harmonic loads, s; None if they have none."""
        return common_period(load.to_amplitude() for load in self.load)

    @property
    def time_step(self) -> float:
        """Length of a step, s; `InputError` if it needs a common period and there is none."""
        if self.time.step is not None:
            return self.time.step
        if self.cycle_period is None:
            raise InputError("time.cycles: the loads have no common period")
        return self.cycle_period / self.time.steps_per_cycle

    @property
    def n_steps(self) -> int:
        """Number of steps, with ``until = "steady"`` of one cycle.

        The last step ends at the end of the run or just beyond it.
        """
        if self.time.duration is not None and self.time.step is not None:
            return math.ceil(min(self.time.duration / self.time.step, 1e18) * (1 - 1e-9))
        return (self.time.cycles or 1) * self.time.steps_per_cycle

    @property
    def periodic(self) -> bool:
        """Whether the length of the run is given in cycles."""
        return self.time.duration is None

    @property
    def cycle_steps(self) -> int | None:
        """Steps of a cycle; None for a scene with a duration."""
        return self.time.steps_per_cycle if self.periodic else None

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """Copy with the same path and mesh; keeps the structure and system unless they change."""
        copy = super().model_copy(update=update, deep=deep)
        names = set(update or ())
        if copy._is_slow != self._is_slow:  # which says what law and damping act
            names.add("damping")
        if copy.parts != self.parts:
            names.add("mesh")
        if TABLES_OF_STRUCTURE & names:
            copy._structure = None
        if TABLES_OF_SYSTEM & names:
            copy._system = None
        return copy

    def unassembled(self, **keys_of: Any) -> Self:
        """Copy without structure and system, with other values of keys as for `changed`."""
        copy = self.changed(**keys_of)
        copy._structure = copy._system = None
        return copy

    def finer(self, factor: int) -> Self:
        """Copy with ``factor`` times the steps, of which the same times are stored."""
        time: dict[str, Any] = {"steps_per_cycle": factor * self.time.steps_per_cycle}
        if self.time.step is not None:
            time = {"step": self.time.step / factor}
        copy = self.changed(time=time, output={"every": factor * self.output.every})
        copy._system = self._system
        return copy

    def changed(
        self,
        values: Mapping[str, Any] | None = None,
        /,
        *,
        mesh: NamedMesh | None = None,
        **keys_of: Any,
    ) -> Self:
        """Copy with another mesh or with other values of keys, which are checked as in a file.

        Values are checked by themselves, within their tables, and between tables; what depends on
        the mesh is checked when the structure is built.

        Parameters
        ----------
        values : mapping, optional
            Values by the keys that a sweep takes, ``{"joint[0].friction": 0.8}``.
        mesh : NamedMesh, optional
            Mesh in place of the present one.
        **keys_of : mapping
            Keys with values by table, such as ``time={"steps_per_cycle": 400}``. Those of
            ``joint``, ``bolt`` and ``load`` are set in each of these tables; a list takes the place
            of all of them. ``title`` takes a text. A value of None leaves its key out. ``cycles``,
            ``until`` and ``duration`` take each other's place, a damping ``ratio`` that of its
            factors, ``law="coulomb"`` that of ``beta``, and ``beta`` that of ``law``.

        Raises
        ------
        InputError
            For unknown tables and keys, and for values that are not allowed.
        """
        if mesh is not None and not isinstance(mesh, NamedMesh):
            raise InputError("changed: mesh: must be a NamedMesh, as load_meshes(file) gives")
        given: Any = {} if values is None else values
        if not isinstance(given, Mapping) or not all(isinstance(key, str) for key in given):
            raise InputError("changed: must be a mapping of keys to values, and tables by name")
        values = dict(given)
        names = {str((key_parts(key) or (key,))[0]) for key in values} | keys_of.keys()
        if "mesh" in names:
            raise InputError("changed: mesh: is changed by mesh = a NamedMesh, not by its keys")
        unknown = names - type(self).model_fields.keys()
        tables: dict[str, Any] = dict.fromkeys(unknown)
        if not unknown:  # which are refused below
            present = self.model_dump(include=names, exclude_unset=True, by_alias=True)
            tables = with_changes(present, values, keys_of)
        update: dict[str, Any] = {}
        if names:
            replacing = set() if unknown else names
            others = {name: getattr(self, name) for name in self.model_fields_set - replacing}
            context = {"folder": (self._path or Path()).parent}
            try:
                checked = type(self).model_validate({**others, **tables}, context=context)
            except ValidationError as error:
                lines = [line for each in error.errors() for line in sentences(each, Scene)]
                raise InputError([f"changed: {line}" for line in lines]) from error
            update = {name: getattr(checked, name) for name in names}
        if mesh is not None:
            update["mesh"] = self.mesh
        copy = self.model_copy(update=update)
        copy._named_mesh = mesh or self._named_mesh
        if names:
            problems = problems_between_tables(copy, {*type(self).model_fields})
            refuse(f"changed: {problem}" for problem in problems)
        return copy


def problems_between_tables(scene: Scene, valid: Set[str]) -> Iterator[str]:
    """Problems between tables of a scene, as far as its ``valid`` tables tell."""
    if valid >= {"time", "load"}:
        yield from _time_problems(scene)
    if valid >= TABLES_OF_SYSTEM and scene.matrices is not None:
        yield from _matrix_problems(scene, scene.matrices)
    if valid >= {"models", "joint", "reduction", "time", "load"}:
        yield from _model_problems(scene)
    if valid >= {"models", "accuracy", "output"} and scene.parts is not None:
        yield from _parts_problems(scene)


def _time_problems(scene: Scene) -> Iterator[str]:
    """Problems of the length of the run and of its steps with the periods of the loads."""
    time = scene.time
    if scene.periodic and scene.cycle_period is None:
        yield (
            f"time.{'until' if time.until else 'cycles'}: found {time.until or time.cycles}, but "
            "the loads have no common period; give duration and step instead"
        )
        return
    step, count = scene.time_step, scene.n_steps
    if not (0 < step < math.inf and count <= LARGEST_COUNT):
        yield (
            f"time: found {count:.3g} steps of {step:.3g} s, must be at most "
            f"{LARGEST_COUNT:.0e} steps"
        )
        return
    if scene.accuracy.is_given:  # the step is then shortened
        return
    for i, load in enumerate(scene.load):
        fastest = max((part.frequency for part in load.to_amplitude().harmonics), default=0.0)
        if PER_PERIOD * fastest * step > 1 + 1e-9:
            longest = 1 / (PER_PERIOD * fastest)
            why = f"a step must not be longer than 1/{PER_PERIOD} of the period of load[{i}]"
            fewest = math.ceil(step * time.steps_per_cycle / longest * (1 - 1e-9))
            yield (
                f"time.steps_per_cycle: found {time.steps_per_cycle}, must be >= {fewest}: {why}"
                if time.step is None
                else f"time.step: found {time.step:g}, must be <= {longest:.4g}: {why}"
            )


def _matrix_problems(scene: Scene, matrices: MatricesTable) -> Iterator[str]:
    """Problems of other tables with [matrices]."""
    if matrices.C is not None and scene.damping.model_fields_set:
        yield "damping: found beside matrices.C; leave out either of them"
    for name in ("vtk", "uff", "stress"):
        if found := getattr(scene.output, name):
            shown = listed(found) if name == "stress" else "true"
            yield (
                f"output.{name}: found {shown} beside [matrices], which have no positions of "
                "nodes; leave it out"
            )


def _parts_problems(scene: Scene) -> Iterator[str]:
    """Problems of a structure in parts with what needs a factor of the whole."""
    if scene.models.run != ("condensed",):
        yield (
            f"models.run: found {list(scene.models.run)} beside models.parts, must be "
            "['condensed']: other models need a factor of the whole structure"
        )
    if scene.models.contact_points != "all":
        yield (
            "models.contact_points: found beside models.parts; points are merged by modes of "
            "the whole structure; leave out either of them"
        )
    if scene.output.uff:
        yield "output.uff: found true beside models.parts; it has modes of the whole; leave it out"
    if scene.accuracy.is_given:
        yield (
            "accuracy: found largest errors beside models.parts, but errors are found by the "
            "full model; leave them out"
        )


def _model_problems(scene: Scene) -> Iterator[str]:
    """Problems of condensed and reduced models with the joints."""
    for name in sorted({"condensed", "reduced"} & {*scene.models.run}) if not scene.joint else ():
        yield (
            f"models.run: found '{name}' in a scene without [[joint]]; a linear scene has nothing "
            "to reduce by its joints, run 'full' alone"
        )
    if scene.reduction.range is not None:
        if scene.time.quasi_static:
            yield (
                "reduction.range: found beside time.quasi_static = true; a range has frequencies "
                "of vibration; leave out either of them"
            )
        yield from scene.reduction.range.problems(scene.joint)
        for i, load in enumerate(scene.load):
            if not load.to_amplitude().harmonics:
                yield (
                    f"reduction.range: found beside load[{i}] of kind = '{load.kind}', must be of "
                    "kind 'harmonic' or 'multi_harmonic': a range has frequencies of loads"
                )
    joints, lengths = {joint.on for joint in scene.joint}, scene.reduction.active_length
    for name in sorted(lengths.keys() - joints) if isinstance(lengths, dict) else ():
        where = key_path(("reduction", "active_length", name))
        yield f"{where}: found '{name}', which is no joint; joints: {listed(joints)}"
    if "reduced" not in scene.models.run:
        return
    for found, beside, why in (
        (scene.time.quasi_static, "time.quasi_static = true", "are scaled by a run in time"),
        (scene.matrices is not None, "[matrices]", "need an axis to be scaled along"),
    ):
        if found and scene.reduction.reference == "paper":
            yield (
                f"reduction.reference: found 'paper' beside {beside}; the paper's modes {why}; use "
                "reference = 'static'"
            )
    mesh = scene._named_mesh
    if scene.reduction.reference == "paper" and mesh is not None and mesh.dim > 1:
        for i, joint in enumerate(scene.joint):
            if joint.axis is None:
                yield (
                    f"joint[{i}].axis: missing, must be given with reduction.reference = 'paper': "
                    "the direction along which its modes are scaled; or use reference = 'static'"
                )
