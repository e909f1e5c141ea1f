"""The whole of a scene: its tables, what must fit between them, and what is built from them."""

from __future__ import annotations

import logging
import math
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated, Any, Self

from pydantic import (
    PrivateAttr,
    ValidationInfo,
    ValidatorFunctionWrapHandler,
    field_validator,
)
from pydantic_core import PydanticKnownError

from skfem_joint import structure as parts
from skfem_joint.errors import InputError, listed
from skfem_joint.loads import common_period
from skfem_joint.mesh import NamedMesh
from skfem_joint.scene import joint_tables, tables
from skfem_joint.scene.matrices import MatricesTable
from skfem_joint.scene.messages import key_path, mistake
from skfem_joint.scene.sweep_table import SweepTable
from skfem_joint.scene.values import A_LIST, MOST, SceneTable, key
from skfem_joint.stepping.resolution import PER_PERIOD
from skfem_joint.system import System

_log = logging.getLogger(__name__)

#: Tables that the structure is built from, and those that its system needs beside them.
OF_STRUCTURE = frozenset(
    {"matrices", "mesh", "material", "section", "support", "joint", "bolt", "damping"}
)
OF_SYSTEM = OF_STRUCTURE | {"load", "output"}


class Scene(SceneTable):
    """A whole scene, of any dimension. `load_scene` reads one from a file, with its mesh.

    Made directly from values that are not allowed it raises a ``pydantic.ValidationError``.
    """

    title: str = key("what the results are headed with", "")
    matrices: MatricesTable | None = key(
        "matrices of the structure, in place of mesh, material, section and support",
        None,
    )
    mesh: tables.MeshTable | None = key(
        "the mesh file; needed but beside matrices", None, validate_default=True
    )
    material: tables.MaterialTable | None = key(
        "what the bodies are made of; needed but beside matrices", None, validate_default=True
    )
    section: tables.SectionTable = key("width and thickness", tables.SectionTable())
    support: tables.SupportTable = key("what is held", tables.SupportTable())
    joint: Annotated[tuple[joint_tables.JointTable, ...], A_LIST] = key("joints with friction", ())
    bolt: Annotated[tuple[joint_tables.BoltTable, ...], A_LIST] = key(
        "bolts whose clamp force presses joints", ()
    )
    damping: tables.DampingTable = key("linear damping", tables.DampingTable())
    load: Annotated[tuple[tables.AnyLoad, ...], A_LIST] = key(
        "forces as functions of time", min_length=1
    )
    time: tables.TimeTable = key("length of the run and of its steps")
    models: tables.ModelsTable = key("what is run", tables.ModelsTable())
    reduction: tables.ReductionTable = key("how the reduced model is made", tables.ReductionTable())
    accuracy: tables.AccuracyTable = key("errors asked for and estimated", tables.AccuracyTable())
    output: tables.OutputTable = key("what is written", tables.OutputTable())
    response: tables.ResponseTable | None = key("frequencies and levels of steady vibration", None)
    backbone: tables.BackboneTable = key(
        "modes whose damping is looked for", tables.BackboneTable()
    )
    sweep: SweepTable | None = key("values that `load_sweep` makes scenes of", None)

    _path: Path | None = PrivateAttr(None)
    _named_mesh: NamedMesh | None = PrivateAttr(None)
    _structure: parts.AnyStructure | None = PrivateAttr(None)
    _system: System | None = PrivateAttr(None)

    @field_validator("mesh", "material", "section", "support", "bolt", mode="wrap")
    @classmethod
    def _is_mesh_or_matrices(
        cls, given: Any, make: ValidatorFunctionWrapHandler, info: ValidationInfo
    ) -> Any:
        """Tables of a mesh are not beside those of matrices, and the needed ones not without."""
        given_matrices = info.data.get("matrices", "wrong")  # in themselves: told already
        if given is None:
            if given_matrices is None:
                raise PydanticKnownError("missing")
            return None
        if given_matrices not in (None, "wrong"):
            raise mistake("found beside [matrices], which are all of the structure; leave it out")
        return make(given)

    @property
    def path(self) -> Path:
        """The file the scene came from."""
        if self._path is None:
            raise InputError("scene: has no file, read it with load_scene(path)")
        return self._path

    @property
    def named_mesh(self) -> NamedMesh:
        """The mesh of the scene."""
        if self._named_mesh is None:
            raise InputError(
                "scene: has no mesh; read it with load_scene or give it to scene_from, or leave "
                "out what needs one beside [matrices]"
            )
        return self._named_mesh

    def structure(self) -> parts.AnyStructure:
        """Structure that the scene describes, built once.

        It and `system` raise `InputError` where the scene does not fit its mesh.
        """
        if self._structure is None:
            with self._naming():
                self._structure = self._made()
        return self._structure

    def _made(self) -> parts.AnyStructure:
        common: dict[str, Any] = {
            "joints": [joint.to_joint() for joint in self.joint],
            "stiffness_damping": self.damping.stiffness,
            "mass_damping": self.damping.mass,
            "damping_ratio": self.damping.ratio,
        }
        if self.matrices is not None:
            return self.matrices.model((self._path or Path()).parent, common)
        material, regions = self.material, dict[str, dict[str, float]]()
        if material is None:
            raise InputError("material: missing, must be given with a mesh")
        for table in (material, self.section):
            for region, override in table.regions.items():
                regions.setdefault(region, {}).update(override.model_dump(exclude_none=True))
        return parts.Structure(
            self.named_mesh,
            parts.Material(material.E, material.density, material.poisson),
            **self.section.model_dump(exclude={"regions"}),
            **self.support.model_dump(),
            **common,
            bolts=[parts.Clamp(**bolt.model_dump()) for bolt in self.bolt],
            mass=material.mass_matrix,
            regions=regions,
        )

    def loads(self) -> tuple[parts.Load, ...]:
        """Loads of the structure."""
        return tuple(
            parts.Load(one.on, one.to_amplitude(), one.direction, one.base, one.quantity)
            for one in self.load
        )

    def system(self) -> System:
        """System of the full model, assembled once."""
        if self._system is None:
            structure = self.structure()
            with self._naming():
                self._system = structure.system(self.loads(), self.output.points or None)
            size = structure.n_dofs, self._system.n, self._system.contact_points
            _log.info(
                "%s: %d degrees of freedom, %d unknowns, %d contact points.", self._path, *size
            )
        return self._system

    @contextmanager
    def _naming(self) -> Iterator[None]:
        """Name the scene's file in what is found wrong with it."""
        try:
            yield
        except InputError as error:
            where = self._path or "scene"
            raise InputError([f"{where}: {problem}" for problem in error.problems]) from error

    @property
    def output_points(self) -> tuple[str, ...]:
        """Names whose motion is reported: those asked for, else all points that can move."""
        return self.output.points or tuple(self.structure().free_points)

    @property
    def cycle_period(self) -> float | None:
        """Common period of the harmonic loads, s; None if they have none."""
        return common_period(one.to_amplitude() for one in self.load)

    @property
    def time_step(self) -> float:
        """Length of a step, s."""
        if self.time.step is not None:
            return self.time.step
        if self.cycle_period is None:
            raise InputError("time.cycles: the loads have no common period")
        return self.cycle_period / self.time.steps_per_cycle

    @property
    def n_steps(self) -> int:
        """Number of steps, of one period where vibration is to be steady.

        The last one ends at the end of the run or just beyond it.
        """
        if self.time.duration is not None and self.time.step is not None:
            return math.ceil(min(self.time.duration / self.time.step, 1e18) * (1 - 1e-9))
        return (self.time.cycles or 1) * self.time.steps_per_cycle

    @property
    def periodic(self) -> bool:
        """Whether the run is counted in cycles."""
        return self.time.duration is None

    @property
    def cycle_steps(self) -> int | None:
        """Steps of one cycle; None for a scene by duration."""
        return self.time.steps_per_cycle if self.periodic else None

    def model_copy(self, *, update: Mapping[str, Any] | None = None, deep: bool = False) -> Self:
        """Copy of the same path and mesh; what was built from a replaced table is built anew."""
        copy = super().model_copy(update=update, deep=deep)
        if OF_STRUCTURE & set(update or ()):
            copy._structure = None
        if OF_SYSTEM & set(update or ()):
            copy._system = None
        return copy

    def light(self, **keys_of: Any) -> Self:
        """Copy without what was assembled, with other values of keys as `changed` takes them."""
        copy = self.changed(**keys_of)
        copy._structure = copy._system = None
        return copy

    def finer(self, factor: int) -> Self:
        """Copy with so many times the steps, which stores the same times."""
        time: dict[str, Any] = {"steps_per_cycle": factor * self.time.steps_per_cycle}
        if self.time.step is not None:
            time = {"step": self.time.step / factor}
        copy = self.changed(time=time, output={"every": factor * self.output.every})
        copy._system = self._system
        return copy

    def changed(
        self,
        *,
        mesh: NamedMesh | None = None,
        joint: Mapping[str, Any] | None = None,
        **keys_of: Mapping[str, Any],
    ) -> Self:
        """Copy with another mesh, or with other values of keys, which are taken as they are.

        ``joint`` holds keys that change in every joint, the others are by table, such as
        ``time={"steps_per_cycle": 400}``.
        """
        update: dict[str, Any] = {
            name: getattr(self, name).model_copy(update=keys) for name, keys in keys_of.items()
        }
        if joint is not None:
            update["joint"] = tuple(one.model_copy(update=joint) for one in self.joint)
        if mesh is not None:
            update["mesh"] = self.mesh
        copy = self.model_copy(update=update)
        copy._named_mesh = mesh or self._named_mesh
        return copy


def _time_problems(scene: Scene) -> Iterator[str]:
    time = scene.time
    if scene.periodic and scene.cycle_period is None:
        yield (
            f"time.{'until' if time.until else 'cycles'}: found {time.until or time.cycles}, but "
            "the loads have no common period; give duration and step instead"
        )
        return
    step, count = scene.time_step, scene.n_steps
    if not (0 < step < math.inf and count <= MOST):
        yield f"time: found {count:.3g} steps of {step:.3g} s, must be at most {MOST:.0e} steps"
        return
    for i, load in enumerate(scene.load):
        if scene.accuracy.asked:  # which shortens the step
            break
        fastest = max((one.frequency for one in load.to_amplitude().harmonics), default=0.0)
        if PER_PERIOD * fastest * step > 1 + 1e-9:
            longest = 1 / (PER_PERIOD * fastest)
            why = f"a step must not be longer than 1/{PER_PERIOD} of the period of load[{i}]"
            fewest = math.ceil(step * time.steps_per_cycle / longest * (1 - 1e-9))
            yield (
                f"time.steps_per_cycle: found {time.steps_per_cycle}, must be >= {fewest}: {why}"
                if time.step is None
                else f"time.step: found {time.step:g}, must be <= {longest:.4g}: {why}"
            )


def _matrix_problems(scene: Scene, given: MatricesTable) -> Iterator[str]:
    """Mistakes in what other tables ask of a scene with matrices."""
    if given.C is not None and scene.damping.model_fields_set:
        yield "damping: found beside matrices.C, must be one of the two"
    if "reduced" in scene.models.run and scene.reduction.reference == "paper":
        yield (
            "reduction.reference: found 'paper' beside [matrices], which have no line that its "
            "modes could be laid along; use reference = 'static'"
        )
    if scene.output.vtk:
        yield (
            "output.vtk: found true beside [matrices], which do not tell where nodes are; leave it "
            "out"
        )


def relations(scene: Scene, right: Mapping[str, Any]) -> Iterator[str]:
    """Mistakes between the tables of a scene, of those that are right in themselves."""
    if {"time", "load"} <= set(right):
        yield from _time_problems(scene)
    if right.keys() >= OF_SYSTEM and scene.matrices is not None:
        yield from _matrix_problems(scene, scene.matrices)
    if not {"models", "joint", "reduction"} <= set(right):
        return
    for small in sorted({"condensed", "reduced"} & {*scene.models.run}) if not scene.joint else ():
        yield (
            f"models.run: found '{small}' in a scene without [[joint]]; a linear scene has nothing "
            "to reduce by its joints, run 'full' alone"
        )
    if "reduced" not in scene.models.run:
        return
    names, asked = {joint.on for joint in scene.joint}, scene.reduction.active_length
    for name in sorted(asked.keys() - names) if isinstance(asked, dict) else ():
        where = key_path(("reduction", "active_length", name))
        yield f"{where}: found '{name}', which is no joint; joints: {listed(names)}"
    mesh = scene._named_mesh
    if scene.reduction.reference == "paper" and mesh is not None and mesh.dim > 1:
        for i, joint in enumerate(scene.joint):
            if joint.axis is None:
                yield (
                    f"joint[{i}].axis: missing, must be given with reduction.reference = 'paper': "
                    "the direction along which modes are laid; or use reference = 'static'"
                )
