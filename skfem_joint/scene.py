"""A scene: all that a run needs, read from a TOML file and checked as a whole before it runs.

The file is validated by the models below (SI units, unknown keys are errors, NaN and infinity are
refused everywhere) and against its mesh. Every mistake found becomes one line, ::

    scene.toml: load[0].frequency: found -5, must be > 0

and all of them are raised together as one `InputError`.

The files that a scene names may lie anywhere that a relative or absolute path leads to, as
``../meshes/bar.msh`` does: they are read as data, and nothing is ever run or written there.
"""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from itertools import combinations
from pathlib import Path
from typing import Annotated, Any, Literal, Self, TypeAlias, TypeVar

import numpy as np
from pydantic import (
    AfterValidator,
    BaseModel,
    ConfigDict,
    Discriminator,
    Field,
    PrivateAttr,
    Tag,
    TypeAdapter,
    ValidationError,
    ValidationInfo,
    model_validator,
)

from skfem_joint import contact, loads, structure
from skfem_joint.errors import InputError
from skfem_joint.files import read_whole
from skfem_joint.meshing import BarMesh, load_mesh
from skfem_joint.resolution import PER_PERIOD
from skfem_joint.scene_messages import (
    NUMBER,
    TABLE,
    WORD,
    closest,
    found_text,
    key_path,
    listed,
    mistake,
    sentences,
)

_FEWEST_STEPS_PER_PERIOD = PER_PERIOD
_LARGEST_SCENE = 2**20  # bytes
_SMALLEST, _LARGEST = 1e-20, 1e20  # numbers in SI units, but 0
# The parser of TOML takes time with the square of the parts of a key.
_MOST_PARTS = 50
_LONG_KEY = re.compile(rf"""(?<![\w"'-])(?:[\w"'-]++[ \t]*+\.[ \t]*+){{{_MOST_PARTS}}}""")
_MOST = 10**9  # steps, modes, frames: beyond it a number is a slip of the keyboard


def _bar(info: ValidationInfo) -> BarMesh | None:
    """Give the mesh to check names against; None when a scene is made without one."""
    bar: BarMesh | None = (info.context or {}).get("bar")
    return bar


def _check_name(name: str, bar: BarMesh, wanted: Literal["point", "region"]) -> None:
    groups: dict[str, Mapping[str, Any]] = {"point": bar.points, "region": bar.regions}
    other = "region" if wanted == "point" else "point"
    if name in groups[wanted]:
        return
    exist = f"{wanted}s of the mesh: {listed(groups[wanted])}"
    if name in groups[other]:
        raise mistake(f"found '{name}', which is a {other}; a {wanted} is needed; {exist}")
    raise mistake(
        f"found '{name}', no such {wanted} in the mesh; {exist}{closest(name, groups[wanted])}"
    )


def _is_point(name: str, info: ValidationInfo) -> str:
    bar = _bar(info)
    if bar is not None:
        _check_name(name, bar, "point")
    return name


def _is_region(name: str, info: ValidationInfo) -> str:
    bar = _bar(info)
    if bar is not None:
        _check_name(name, bar, "region")
        if len(bar.regions[name]) == 0:
            raise mistake(f"found '{name}', a region without elements; it must hold at least one")
    return name


def _is_place(name: str, info: ValidationInfo) -> str:
    bar = _bar(info)
    if bar is not None and name not in bar.points and name not in bar.regions:
        raise mistake(
            f"found '{name}', no such point or region in the mesh; points of the mesh: "
            f"{listed(bar.points)}; regions: {listed(bar.regions)}"
            f"{closest(name, [*bar.points, *bar.regions])}"
        )
    return name


def _is_file_name(name: str) -> str:
    if not name or "\0" in name:
        raise mistake(f"found {name!r}, must be the name of a file")
    return name


T = TypeVar("T")


def _has_no_repeats(values: tuple[T, ...]) -> tuple[T, ...]:
    repeated = [value for i, value in enumerate(values) if value in values[:i]]
    if repeated:
        raise mistake(f"found '{repeated[0]}' more than once, must not repeat")
    return values


def _from(smallest: float) -> AfterValidator:
    def is_in_range(value: float) -> float:
        if value != 0.0 and not smallest <= abs(value) <= _LARGEST:
            raise mistake(
                f"found {value:g}, must be {smallest:g} to {_LARGEST:g} in size, or 0 where that "
                "is allowed: beyond it products of such numbers overflow"
            )
        return value

    return AfterValidator(is_in_range)


Number = Annotated[float, _from(_SMALLEST**3)]
Positive = Annotated[float, Field(gt=0), _from(_SMALLEST)]
NotNegative = Annotated[float, Field(ge=0), _from(_SMALLEST)]
PointName = Annotated[str, AfterValidator(_is_point)]
RegionName = Annotated[str, AfterValidator(_is_region)]
PlaceName = Annotated[str, AfterValidator(_is_place)]
FileName = Annotated[str, AfterValidator(_is_file_name)]
# TOML lists arrive as lists: not strict about that, still strict about their members.
_A_LIST = Field(strict=False)
PointNames = Annotated[tuple[PointName, ...], _A_LIST, AfterValidator(_has_no_repeats)]


def _form(value: object) -> str:
    if isinstance(value, str):
        return WORD
    return TABLE if isinstance(value, Mapping | BaseModel) else NUMBER


Auto = Annotated[Literal["auto"], Tag(WORD)]


class SceneTable(BaseModel):
    """Base of all tables of a scene: immutable, no unknown keys, no conversions, finite numbers."""

    model_config = ConfigDict(extra="forbid", frozen=True, strict=True, allow_inf_nan=False)


class Mesh(SceneTable):
    """``[mesh]``: the file, relative to the scene, and the length of its unit in metres."""

    file: FileName = Field(description="name of the mesh file")
    scale: Positive = 1.0


class _Override(SceneTable):
    @model_validator(mode="after")
    def _sets_something(self) -> Self:
        if not self.model_fields_set:
            raise mistake(f"found an empty table, must set {' or '.join(type(self).model_fields)}")
        return self


class MaterialOverride(_Override):
    """``[material.regions.NAME]``: what differs in a region."""

    E: Positive | None = Field(default=None, description="Young's modulus, Pa")
    density: Positive | None = Field(default=None, description="kg/m³")


class Material(SceneTable):
    """``[material]`` of the bar."""

    E: Positive = Field(description="Young's modulus, Pa")
    density: Positive = Field(description="density, kg/m³")
    poisson: float | None = Field(default=None, gt=-1, lt=0.5, description="not used by struts")
    mass_matrix: Literal["consistent", "lumped"] = "consistent"
    regions: dict[RegionName, MaterialOverride] = {}


class CrossSectionOverride(_Override):
    """``[section.regions.NAME]``: what differs in a region."""

    width: Positive | None = Field(default=None, description="m")
    thickness: Positive | None = Field(default=None, description="m")


class CrossSection(SceneTable):
    """``[section]`` of the bar."""

    width: Positive = Field(description="width, m")
    thickness: Positive = Field(description="thickness, m")
    regions: dict[RegionName, CrossSectionOverride] = {}


class Support(SceneTable):
    """``[support]``: the points that are held."""

    fixed: PointNames = Field(description="list of points that are held")

    @model_validator(mode="after")
    def _holds_the_bar(self) -> Self:
        if not self.fixed:
            raise mistake(
                "found no point; a bar without support is a free body that drifts away, "
                "name at least one point",
                "fixed",
            )
        return self


class PressureByPosition(SceneTable):
    """Normal pressure along the bar, linear between positions.

    Attributes
    ----------
    positions : tuple of float
        Arc length from the start of the bar, m, increasing; they cover the joint.
    values : tuple of float
        Pa, >= 0, one a position.
    """

    positions: Annotated[tuple[Number, ...], _A_LIST] = Field(
        min_length=2, description="positions along the bar, m"
    )
    values: Annotated[tuple[NotNegative, ...], _A_LIST] = Field(
        min_length=2, description="pressures at the positions, Pa"
    )

    @model_validator(mode="after")
    def _is_a_function_of_position(self) -> Self:
        steps = zip(self.positions, self.positions[1:], strict=False)
        for i, (left, right) in enumerate(steps, start=1):
            if right <= left:
                raise mistake(
                    f"found {right:g}, must be > {left:g}, the position before", f"positions[{i}]"
                )
        if len(self.values) != len(self.positions):
            raise mistake(
                f"found {len(self.values)} values, must be one for each of the "
                f"{len(self.positions)} positions",
                "values",
            )
        return self


class Joint(SceneTable):
    """``[[joint]]``: a region pressed against a rigid surface."""

    region: RegionName = Field(description="name of a region of the mesh")
    pressure: Annotated[
        Annotated[NotNegative, Tag(NUMBER)] | Annotated[PressureByPosition, Tag(TABLE)],
        Discriminator(lambda value: TABLE if _form(value) == TABLE else NUMBER),
    ] = Field(description="a pressure in Pa or a table { positions = [m], values = [Pa] }")
    friction: NotNegative = Field(description="friction coefficient")
    law: Literal["arctan", "coulomb"] = "arctan"
    beta: Positive = Field(default=1e5, description="steepness of the arctan law, s/m")
    normal_force: Literal["consistent", "equal"] = "consistent"

    @model_validator(mode="after")
    def _fits_together(self, info: ValidationInfo) -> Self:
        if self.law == "coulomb" and "beta" in self.model_fields_set:
            raise mistake(
                f"found {self.beta:g} beside law = 'coulomb', which has no beta; "
                "leave it out or choose law = 'arctan'",
                "beta",
            )
        bar = _bar(info)
        if bar is not None and isinstance(self.pressure, PressureByPosition):
            start, end = _ends(bar, self.region)
            first, last = self.pressure.positions[0], self.pressure.positions[-1]
            tolerance = 1e-9 * bar.length
            if first > start + tolerance or last < end - tolerance:
                raise mistake(
                    f"found {first:g} to {last:g} m, must cover the joint, "
                    f"which reaches from {start:g} to {end:g} m",
                    "pressure.positions",
                )
        return self

    def to_joint(self) -> structure.Joint:
        """Give the joint as `structure.build_structure` takes it; Coulomb has an infinite beta."""
        pressure = self.pressure
        return structure.Joint(
            region=self.region,
            pressure=contact.PressureTable(pressure.positions, pressure.values)
            if isinstance(pressure, PressureByPosition)
            else pressure,
            friction=self.friction,
            beta=math.inf if self.law == "coulomb" else self.beta,
            normal_force=self.normal_force,
        )


class Damping(SceneTable):
    """``[damping]``: C = stiffness * K + mass * M."""

    stiffness: NotNegative = Field(default=0.0, description="s")
    mass: NotNegative = Field(default=0.0, description="1/s")


class _LoadOn(SceneTable):
    on: PlaceName = Field(description="name of the point or region the load acts on")


class _HarmonicKeys(SceneTable):
    amplitude: Number = Field(description="amplitude, N")
    frequency: Positive = Field(description="frequency, Hz")
    phase: Number = Field(default=0.0, description="rad")

    def to_load(self) -> loads.Harmonic:
        """Give the amplitude as a function of time."""
        return loads.Harmonic(self.amplitude, self.frequency, self.phase)


class HarmonicLoad(_HarmonicKeys, _LoadOn):
    """``kind = "harmonic"``."""

    kind: Literal["harmonic"]


class Component(_HarmonicKeys):
    """One harmonic of ``kind = "multi_harmonic"``."""


class MultiHarmonicLoad(_LoadOn):
    """``kind = "multi_harmonic"``: a sum of harmonics."""

    kind: Literal["multi_harmonic"]
    components: Annotated[tuple[Component, ...], _A_LIST] = Field(
        min_length=1, description="list of tables { amplitude, frequency, phase }"
    )

    def to_load(self) -> loads.MultiHarmonic:
        """Give the amplitude as a function of time."""
        return loads.MultiHarmonic(tuple(component.to_load() for component in self.components))


_PULSES: Mapping[str, type[loads.Triangle | loads.HalfSine | loads.Versine | loads.RampAndHold]] = {
    "triangle": loads.Triangle,
    "half_sine": loads.HalfSine,
    "versine": loads.Versine,
    "ramp_and_hold": loads.RampAndHold,
}


class PulseLoad(_LoadOn):
    """The kinds of load that rise to a peak."""

    kind: Literal["triangle", "half_sine", "versine", "ramp_and_hold"]
    peak: Number = Field(description="peak force, N")
    rise_time: Positive = Field(description="time from start to peak, s")
    start: NotNegative = Field(default=0.0, description="s")

    def to_load(self) -> loads.Triangle | loads.HalfSine | loads.Versine | loads.RampAndHold:
        """Give the amplitude as a function of time."""
        return _PULSES[self.kind](self.peak, self.rise_time, self.start)


class RectangleLoad(_LoadOn):
    """``kind = "rectangle"``."""

    kind: Literal["rectangle"]
    peak: Number = Field(description="peak force, N")
    duration: Positive = Field(description="s")
    start: NotNegative = Field(default=0.0, description="s")

    def to_load(self) -> loads.Rectangle:
        """Give the amplitude as a function of time."""
        return loads.Rectangle(self.peak, self.duration, self.start)


class TableLoad(_LoadOn):
    """``kind = "table"``: a CSV file, relative to the scene, with time (s) and force (N)."""

    kind: Literal["table"]
    file: FileName = Field(description="name of a CSV file with time in s and force in N")
    _table: loads.Table = PrivateAttr()

    @model_validator(mode="after")
    def _read(self, info: ValidationInfo) -> Self:
        folder: Path = (info.context or {}).get("folder", Path())
        try:
            self._table = loads.read_table(folder / self.file)
        except InputError as error:
            raise mistake("\n".join(error.problems), "file") from error
        return self

    def to_load(self) -> loads.Table:
        """Give the amplitude as a function of time."""
        return self._table


AnyLoad: TypeAlias = Annotated[
    HarmonicLoad | MultiHarmonicLoad | PulseLoad | RectangleLoad | TableLoad,
    Field(discriminator="kind"),
]


class Time(SceneTable):
    """``[time]``: cycles and steps_per_cycle, or duration and step."""

    cycles: int | None = Field(
        default=None, ge=1, le=_MOST, description="number of periods of the load"
    )
    steps_per_cycle: int = Field(default=200, ge=_FEWEST_STEPS_PER_PERIOD, le=_MOST)
    duration: Positive | None = Field(default=None, description="s")
    step: Positive | None = Field(default=None, description="s")
    rho_infinity: float = Field(default=1.0, ge=0, le=1)

    @model_validator(mode="after")
    def _is_given_one_way(self) -> Self:
        by_cycles = self.model_fields_set & {"cycles", "steps_per_cycle"}
        by_duration = self.model_fields_set & {"duration", "step"}
        choice = "must be either cycles (and steps_per_cycle), or duration and step"
        if by_cycles and by_duration:
            raise mistake(f"found {', '.join(sorted(by_cycles | by_duration))}; {choice}")
        if by_duration:
            if self.duration is None or self.step is None:
                missing = "duration" if self.duration is None else "step"
                raise mistake(f"missing beside {next(iter(by_duration))}; {choice}", missing)
            if self.step > self.duration:
                raise mistake(
                    f"found {self.step:g}, must be <= duration, {self.duration:g}", "step"
                )
        elif self.cycles is None:
            raise mistake(f"missing; {choice}", "cycles")
        return self


class Models(SceneTable):
    """``[models]``: which models are integrated."""

    run: Annotated[
        tuple[Literal["full", "reduced"], ...], _A_LIST, AfterValidator(_has_no_repeats)
    ] = Field(default=("full",), min_length=1)


class Reduction(SceneTable):
    """``[reduction]``: how the reduced model is made.

    Attributes
    ----------
    active_length : "auto", "estimate", float or mapping of float
        Measured in a quick probe run, estimated by Eqs. (17)-(20), one length for every joint, or
        lengths by joint region (a joint not named there is probed), m.
    friction_points : "auto", "all" or int
        Points at which the friction of a joint's end is evaluated: four for each mode, every
        contact node as in the paper, or so many.
    snapshots : "both" or "displacement"
        Whether the modes span displacement and velocity, or displacement alone as in the paper.
    """

    modes: int = Field(default=5, ge=1, le=_MOST)
    active_length: Annotated[
        Annotated[Literal["auto", "estimate"], Tag(WORD)]
        | Annotated[Positive, Tag(NUMBER)]
        | Annotated[dict[RegionName, Positive], Tag(TABLE)],
        Discriminator(_form),
    ] = Field(
        default="auto",
        description="'auto', 'estimate', a length in m, or a table { region = length }",
    )
    reference: Literal["paper", "self"] = "paper"
    interface_modes: Annotated[
        Auto | Annotated[int, Field(ge=0, le=_MOST), Tag(NUMBER)],
        Discriminator(lambda value: WORD if _form(value) == WORD else NUMBER),
    ] = Field(default="auto", description="'auto' or a whole number >= 0")
    beta: Annotated[
        Auto | Annotated[Positive, Tag(NUMBER)],
        Discriminator(lambda value: WORD if _form(value) == WORD else NUMBER),
    ] = Field(default="auto", description="'auto' or a steepness in s/m > 0")
    friction_points: Annotated[
        Annotated[Literal["auto", "all"], Tag(WORD)]
        | Annotated[int, Field(ge=1, le=_MOST), Tag(NUMBER)],
        Discriminator(lambda value: WORD if _form(value) == WORD else NUMBER),
    ] = Field(default="auto", description="'auto', 'all' or a whole number >= 1")
    snapshots: Literal["both", "displacement"] = "both"
    inner_product: Literal["euclidean", "mass"] = "euclidean"


class Output(SceneTable):
    """``[output]``: what is written and how often."""

    vtk: bool = False
    plots: bool = False
    every: int = Field(
        default=1, ge=1, le=_MOST, description="stored are steps 0, every, 2 every, ..."
    )
    points: PointNames = ()
    frames: int = Field(default=200, ge=1, le=_MOST, description="pictures in the ParaView series")
    shape: Literal["swept", "line"] = "swept"
    history: bool = True


class Scene(SceneTable):
    """A whole scene. `load_scene` reads one from a file and gives it its mesh.

    Raises
    ------
    pydantic.ValidationError
        When made directly from values that are not allowed; `load_scene` raises `InputError`.
    """

    title: str = ""
    mesh: Mesh
    material: Material
    section: CrossSection
    support: Support
    joint: Annotated[tuple[Joint, ...], _A_LIST] = ()
    damping: Damping = Damping()
    load: Annotated[tuple[AnyLoad, ...], _A_LIST] = Field(min_length=1)
    time: Time
    models: Models = Models()
    reduction: Reduction = Reduction()
    output: Output = Output()

    _bar: BarMesh | None = PrivateAttr(None)
    _path: Path | None = PrivateAttr(None)

    @property
    def bar(self) -> BarMesh:
        """The mesh the scene was checked against."""
        if self._bar is None:
            raise InputError("scene: has no mesh yet, read it with load_scene(path)")
        return self._bar

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
        return _time_step(self.time, self.cycle_period)

    @property
    def n_steps(self) -> int:
        """Number of steps; the last one ends at the end of the run or just beyond it."""
        return _n_steps(self.time)

    @property
    def output_points(self) -> tuple[str, ...]:
        """Points whose motion is reported: those asked for, else all that are not held."""
        if self.output.points:
            return self.output.points
        held = {self.bar.points[name] for name in self.support.fixed}
        return tuple(name for name, node in self.bar.points.items() if node not in held)


def _ends(bar: BarMesh, region: str) -> tuple[float, float]:
    """First and last arc length of a region, m."""
    s = bar.mesh.p[0, bar.region_nodes(region)]
    return float(s.min()), float(s.max())


def _time_step(time: Time, period: float | None) -> float:
    if time.step is not None:
        return time.step
    if period is None:
        raise InputError("time.cycles: the loads have no common period")
    return period / time.steps_per_cycle


def _n_steps(time: Time) -> int:
    if time.duration is not None and time.step is not None:
        return math.ceil(min(time.duration / time.step, 1e18) * (1 - 1e-9))
    return (time.cycles or 0) * time.steps_per_cycle


def _check_overrides(key: str, regions: Mapping[str, _Override], bar: BarMesh) -> Iterator[str]:
    for (name, one), (other_name, other) in combinations(regions.items(), 2):
        both = one.model_fields_set & other.model_fields_set
        if both and np.intersect1d(bar.regions[name], bar.regions[other_name]).size:
            yield (
                f"{key_path((key, 'regions', other_name))}: found {' and '.join(sorted(both))}, "
                f"which region '{name}' also sets; the two regions share elements, so only one may"
            )


def _check_joints(joints: tuple[Joint, ...], bar: BarMesh) -> Iterator[str]:
    for (i, one), (j, other) in combinations(enumerate(joints), 2):
        elements = np.intersect1d(bar.regions[one.region], bar.regions[other.region])
        nodes = np.intersect1d(bar.region_nodes(one.region), bar.region_nodes(other.region))
        if elements.size:
            yield (
                f"joint[{j}].region: found '{other.region}', which shares {elements.size} elements "
                f"with joint[{i}] ('{one.region}'); joints must not overlap"
            )
        elif nodes.size and one.to_joint().beta != other.to_joint().beta:
            key = "beta" if one.law == other.law else "law"
            yield (
                f"joint[{j}].{key}: found {found_text(getattr(other, key))}, must be "
                f"{found_text(getattr(one, key))} as in joint[{i}], with which it shares a node"
            )


def _check_points(tables: Mapping[str, Any], bar: BarMesh) -> Iterator[str]:
    held = {bar.points[name] for name in tables["support"].fixed}
    free = listed(name for name, node in bar.points.items() if node not in held)
    for i, item in enumerate(tables.get("load", ())):
        if bar.points.get(item.on) in held:
            yield (
                f"load[{i}].on: found '{item.on}', which is fixed, so the support takes the whole "
                f"load; free points of the mesh: {free}"
            )
    output = tables.get("output")
    for i, name in enumerate(output.points if output else ()):
        if bar.points[name] in held:
            yield (
                f"output.points[{i}]: found '{name}', which is fixed and never moves; "
                f"free points of the mesh: {free}"
            )


def _check_time(time: Time, items: tuple[Any, ...]) -> Iterator[str]:
    amplitudes = [item.to_load() for item in items]
    period = loads.common_period(amplitudes)
    if time.cycles is not None and period is None:
        yield (
            f"time.cycles: found {time.cycles}, but the loads have no common period; "
            "give duration and step instead"
        )
        return
    step = _time_step(time, period)
    n_steps = _n_steps(time)
    if not (0 < step < math.inf and n_steps <= _MOST):
        yield f"time: found {n_steps:.3g} steps of {step:.3g} s, must be at most {_MOST:.0e} steps"
        return
    key = "time.steps_per_cycle" if time.step is None else "time.step"
    found = f"found {time.steps_per_cycle if time.step is None else format(time.step, 'g')}"
    for i, load in enumerate(amplitudes):
        fastest = load.highest_frequency
        if fastest is None or isinstance(load, loads.Table | loads.RampAndHold):
            continue
        if isinstance(load, loads.Harmonic | loads.MultiHarmonic):
            longest, what = 1 / (_FEWEST_STEPS_PER_PERIOD * fastest), "an eighth of the period"
        else:
            longest, what = 1 / (2 * fastest), "the rise time or duration"
        if step > longest * (1 + 1e-9):
            allowed = (
                f"must be <= {longest:.4g}"
                if time.step is not None
                else f"must be >= {math.ceil(step * time.steps_per_cycle / longest * (1 - 1e-9))}"
            )
            yield f"{key}: {found}, {allowed}: a step must not be longer than {what} of load[{i}]"


def _check_reduction(
    reduction: Reduction, joints: tuple[Joint, ...], bar: BarMesh
) -> Iterator[str]:
    element_lengths = np.diff(bar.mesh.p[0])
    lengths = {
        joint.region: float(element_lengths[bar.regions[joint.region]].sum()) for joint in joints
    }
    key: tuple[str, ...] = ("reduction", "active_length")
    asked = reduction.active_length
    if isinstance(asked, str):
        return
    if isinstance(asked, float):
        wanted = [(key, region, asked) for region in lengths]
    else:
        wanted = [((*key, region), region, length) for region, length in asked.items()]
    for where, region, length in wanted:
        if region not in lengths:
            yield (
                f"{key_path(where)}: found '{region}', which is no joint; joints: {listed(lengths)}"
            )
        elif length > lengths[region] * (1 + 1e-9):
            yield (
                f"{key_path(where)}: found {length:g}, must be <= {lengths[region]:g}, "
                f"the length of joint '{region}'"
            )


def _relations(tables: Mapping[str, Any], bar: BarMesh | None) -> Iterator[str]:
    """Mistakes between tables, for those tables that are right in themselves."""
    for key in ("material", "section"):
        if bar is not None and key in tables:
            yield from _check_overrides(key, tables[key].regions, bar)
    if bar is not None and "joint" in tables:
        yield from _check_joints(tables["joint"], bar)
    if bar is not None and "support" in tables:
        yield from _check_points(tables, bar)
    if "time" in tables and "load" in tables:
        yield from _check_time(tables["time"], tables["load"])
    if "models" in tables and "joint" in tables:
        models, joints = tables["models"], tables["joint"]
        if "reduced" in models.run and not joints:
            yield (
                "models.run: found 'reduced' in a scene without [[joint]]; a linear scene has "
                "nothing to reduce by joint modes, run 'full' alone"
            )
        elif bar is not None and joints and "reduction" in tables:
            yield from _check_reduction(tables["reduction"], joints, bar)


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


def _read_mesh(raw: Mapping[str, Any], folder: Path) -> tuple[BarMesh | None, list[str]]:
    """Load the scene's mesh, or say what is wrong with the file."""
    try:
        mesh = Mesh.model_validate(
            {key: raw["mesh"][key] for key in ("file", "scale") if key in raw["mesh"]}
        )
    except (KeyError, TypeError, ValidationError):
        return None, []  # told by the validation of the whole scene
    try:
        return load_mesh(folder / mesh.file, scale=mesh.scale), []
    except InputError as error:
        return None, [f"mesh.file: {problem}" for problem in error.problems]
    except OSError as error:  # a name too long, or a folder that may not be searched
        return None, [f"mesh.file: {found_text(mesh.file)} cannot be read: {error.strerror}"]


def load_scene(path: str | Path) -> Scene:
    """Read a scene and its mesh and check them against each other.

    Parameters
    ----------
    path : str or Path
        A TOML file; the files it names are relative to it.

    Returns
    -------
    Scene
        With `bar` and `path` set.

    Raises
    ------
    InputError
        The file cannot be read or is not TOML, or anything in it is wrong; every mistake is one of
        its ``problems`` and starts with the file and the key.
    """
    path = Path(path)
    raw = _read_toml(path)
    bar, problems = _read_mesh(raw, path.parent)
    return scene_from(raw, bar, path, problems)


def scene_from(
    raw: Mapping[str, Any],
    bar: BarMesh | None,
    path: str | Path = "scene",
    problems: Sequence[str] = (),
) -> Scene:
    """Scene from its tables and its mesh, as `load_scene` makes it from files.

    Parameters
    ----------
    raw : mapping
        The tables, as in a scene file; ``mesh.file`` is not read.
    bar : BarMesh or None
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
    context = {"bar": bar, "folder": path.parent}
    try:
        scene = Scene.model_validate(raw, context=context)
        tables = {name: getattr(scene, name) for name in Scene.model_fields}
    except ValidationError as error:
        scene = None
        found += [line for details in error.errors() for line in sentences(details, Scene)]
        wrong = {details["loc"][0] for details in error.errors()}
        tables = {}
        for name, field in Scene.model_fields.items():
            if name not in wrong:
                adapter = TypeAdapter(field.rebuild_annotation())
                given = raw.get(name, field.default)
                tables[name] = adapter.validate_python(given, context=context)
    found += _relations(tables, bar)
    if scene is None or found:
        raise InputError([f"{path}: {problem}" for problem in dict.fromkeys(found)])
    scene._bar, scene._path = bar, path
    return scene
