"""Tables of a scene, the same for every dimension, except those of joints and of sweeps.

A table checks the form and range of its values, and what must fit together within it. The structure
checks what depends on the mesh: names, overlaps, and keys that a dimension needs.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from inspect import signature
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Literal, Self, TypeAlias

import numpy as np
from pydantic import (
    AfterValidator,
    BeforeValidator,
    Field,
    PrivateAttr,
    Tag,
    ValidationInfo,
    model_validator,
)

from skfem_joint.ground import loads
from skfem_joint.ground.arrays import FloatArray
from skfem_joint.ground.power_density import PowerDensity
from skfem_joint.ground.text_tables import read_table
from skfem_joint.runs.resolution import PER_PERIOD
from skfem_joint.scene.messages import Form, mistake, of_key
from skfem_joint.scene.range_table import ServedRangeTable
from skfem_joint.scene.values import (
    LARGEST_COUNT,
    Count,
    CountOrZero,
    Direction,
    FileName,
    FileNames,
    Names,
    NotNegative,
    Number,
    NumberOrAuto,
    PoissonRatio,
    Positive,
    SceneTable,
    TomlList,
    beside_scene,
    by_form,
    has_no_repeats,
    key,
)


def _rises(values: list[float]) -> list[float]:
    """Refuse values that do not rise."""
    if any(b <= a for a, b in pairwise(values)):
        raise mistake(f"found {values}, must rise")
    return values


#: Values that rise.
Rising: TypeAlias = Annotated[TomlList[Positive], Field(min_length=1), AfterValidator(_rises)]


def _is_no_truth_value(value: object) -> object:
    """Refuse true and false, which are 1 and 0 in Python."""
    if isinstance(value, bool):
        raise mistake(f"found {str(value).lower()}, must be 'auto', 1 or 2")
    return value


class MeshTable(SceneTable):
    """``[mesh]``: the files of the mesh."""

    file: FileNames = key(
        "name of the mesh file, relative to the scene, or a list of files of several bodies; Gmsh "
        ".msh of format 2.2 or 4.1, ASCII or binary, .inp of Abaqus or CalculiX, .med of Salome, "
        "or bulk data of Nastran (.bdf, .nas, .dat)"
    )
    scale: Positive = key("length of the mesh's unit, m", 1.0)
    order: Annotated[Literal["auto", 1, 2], BeforeValidator(_is_no_truth_value)] = key(
        'order of the displacement; "auto" computes meshes with triangles, tetrahedra or prisms of '
        "first order, which bend too stiffly, with quadratic displacements on the same mesh",
        "auto",
    )
    incompatible: bool = key(
        "whether quadrilaterals and hexahedra of first order have incompatible modes, without "
        "which they bend too stiffly; other elements have none",
        True,
    )

    def paths(self, folder: Path) -> list[Path]:
        """Mesh files of a scene that lies in ``folder``."""
        names = (self.file,) if isinstance(self.file, str) else self.file
        return [folder / name for name in names]


class _Override(SceneTable):
    """Properties of a region that differ from those elsewhere; at least one must be given."""

    @model_validator(mode="after")
    def _is_not_empty(self) -> Self:
        if not self.model_fields_set:
            raise mistake(f"found an empty table, must set {' or '.join(type(self).model_fields)}")
        return self


class MaterialOverride(_Override):
    """``[material.regions.NAME]``: properties of a region that differ from those elsewhere."""

    E: Positive | None = key("Young's modulus, Pa", None)
    density: Positive | None = key("density, kg/m³", None)
    poisson: PoissonRatio | None = key("Poisson's ratio", None)


class MaterialTable(SceneTable):
    """``[material]``: linear elastic, isotropic."""

    E: Positive = key("Young's modulus, Pa")
    density: Positive = key("density, kg/m³")
    poisson: PoissonRatio | None = key("Poisson's ratio; not needed for bars", None)
    mass_matrix: Literal["consistent", "lumped"] = key(
        "consistent mass matrix, or a diagonal one with the masses of the nodes", "consistent"
    )
    regions: dict[str, MaterialOverride] = key("properties that differ, by name of the region", {})


class SectionOverride(_Override):
    """``[section.regions.NAME]``: properties of a region that differ from those elsewhere."""

    width: Positive | None = key("width of a bar, m", None)
    thickness: Positive | None = key("thickness, m", None)


class SectionTable(SceneTable):
    """``[section]``: dimensions of the bodies that the mesh does not have."""

    width: Positive | None = key("width of a bar and of its contact, m", None)
    thickness: Positive | None = key("thickness of a bar, or of a plate, m", None)
    plane: Literal["stress", "strain"] = key("plane stress or plane strain of a plate", "stress")
    regions: dict[str, SectionOverride] = key("properties that differ, by name of the region", {})


class SupportTable(SceneTable):
    """``[support]``: points, boundaries and regions that are held."""

    fixed: Names = key("names of the points, boundaries and regions held in every direction", ())
    fixed_x: Names = key("names of those held along x", ())
    fixed_y: Names = key("names of those held along y", ())
    fixed_z: Names = key("names of those held along z", ())
    free: bool = key("whether bodies may float, without a support that holds them", False)


class DampingTable(SceneTable):
    """``[damping]``: C = stiffness * K + mass * M, by its factors or by a damping ratio."""

    stiffness: NotNegative = key("factor of the stiffness matrix, s", 0.0)
    mass: NotNegative = key("factor of the mass matrix, 1/s", 0.0)
    ratio: float | None = key(
        "damping ratio; a share of the critical damping, in place of both factors",
        None,
        gt=0,
        lt=1,
    )

    @model_validator(mode="after")
    def _is_given_one_way(self) -> Self:
        if self.ratio is not None and (given := sorted(self.model_fields_set - {"ratio"})):
            raise mistake(
                f"found {self.ratio:g} beside {' and '.join(given)}, must be given alone", "ratio"
            )
        return self


class _Load(SceneTable):
    """Keys of every ``[[load]]``: where and how it acts. Each kind adds its shape in time."""

    kind: str
    on: str | None = key("name of the point, boundary or region that the load acts on", None)
    direction: Direction | None = key(
        "direction of the force, [x, y] or [x, y, z], of any length; not needed on bars and for a "
        "pressure",
        None,
    )
    quantity: Literal["force", "traction", "pressure"] = key(
        "what is given over time: the total force in N, or, on a boundary, a traction along "
        "direction or a pressure against the outward normal, both in N/m² instead of N",
        "force",
    )
    base: Literal["x", "y", "z"] | None = key(
        "axis along which all supports are accelerated, in place of on; amplitudes are then "
        "accelerations in m/s² instead of forces in N",
        None,
    )

    @model_validator(mode="after")
    def _acts_on_part_or_base(self) -> Self:
        if (self.on is None) == (self.base is None):
            given = "missing" if self.on is None else f"found '{self.on}' beside base"
            raise mistake(
                f"{given}, must be given: name of the point, boundary or region that a force acts "
                "on, or instead of it base = 'x', 'y' or 'z', along which supports are accelerated",
                "on",
            )
        if self.base is not None and self.direction is not None:
            raise mistake(
                "found beside base, which is a direction itself; leave it out", "direction"
            )
        return self

    def to_amplitude(self) -> loads.Amplitude:
        """Force (N) as a function of time; the keys are named as the parameters of its shape."""
        shapes: dict[str, Callable[..., loads.Amplitude]] = {
            "harmonic": loads.Harmonic,
            "triangle": loads.Triangle,
            "half_sine": loads.HalfSine,
            "versine": loads.Versine,
            "ramp_and_hold": loads.RampAndHold,
            "rectangle": loads.Rectangle,
            "swept_sine": loads.SweptSine,
        }
        shape = shapes[self.kind]
        return shape(**{name: getattr(self, name) for name in signature(shape).parameters})


class ComponentTable(SceneTable):
    """``components = [{ ... }, ...]``: harmonics, amplitude * sin(2 pi frequency t + phase)."""

    amplitude: Number = key("amplitude of the force, N")
    frequency: Positive = key("frequency, Hz")
    phase: Number = key("phase at time zero, rad", 0.0)


class HarmonicLoad(ComponentTable, _Load):
    """``kind = "harmonic"``: a force amplitude * sin(2 pi frequency t + phase)."""

    kind: Literal["harmonic"] = key("shape of the force in time")


class MultiHarmonicLoad(_Load):
    """``kind = "multi_harmonic"``: a sum of harmonics."""

    kind: Literal["multi_harmonic"] = key("shape of the force in time")
    components: TomlList[ComponentTable] = key(
        "list of tables { amplitude, frequency, phase }, whose harmonics are added", min_length=1
    )

    def to_amplitude(self) -> loads.MultiHarmonic:
        """Force (N) as a function of time."""
        parts = [loads.Harmonic(**component.model_dump()) for component in self.components]
        return loads.MultiHarmonic(parts)


class SweptSineLoad(_Load):
    """``kind = "swept_sine"``: a sine whose frequency rises or falls at a rate, then zero."""

    kind: Literal["swept_sine"] = key("shape of the force in time")
    amplitude: Number = key("amplitude of the force, N")
    first_frequency: Positive = key("frequency at time zero, Hz")
    last_frequency: Positive = key("frequency at which it ends, Hz")
    rate: Positive = key("rate of the frequency, octaves/min")

    @model_validator(mode="after")
    def _sweeps(self) -> Self:
        if self.first_frequency == self.last_frequency:
            raise mistake(
                f"found {self.last_frequency:g}, must differ from first_frequency",
                "last_frequency",
            )
        return self


class PulseLoad(_Load):
    """``kind = "triangle", "half_sine", "versine", "ramp_and_hold"``: a rise to a peak.

    A ramp stays at its peak; the others fall as they rose.
    """

    kind: Literal["triangle", "half_sine", "versine", "ramp_and_hold"] = key(
        "shape of the force in time"
    )
    peak: Number = key("largest force, N; against direction if negative")
    rise_time: Positive = key(
        "time from start to peak, s; half the length of a triangle, half sine or versine"
    )
    start: NotNegative = key("time at which the force begins, s", 0.0)


class RectangleLoad(_Load):
    """``kind = "rectangle"``: a force that is constant for a while."""

    kind: Literal["rectangle"] = key("shape of the force in time")
    peak: Number = key("force, N; against direction if negative")
    duration: Positive = key("time that the force lasts, s")
    start: NotNegative = key("time at which the force begins, s", 0.0)


class TableLoad(_Load):
    """``kind = "table"``: forces at given times, linear between them, zero before and after."""

    kind: Literal["table"] = key("shape of the force in time")
    file: FileName = key(
        "name of a CSV file, relative to the scene: time in s, force in N, or in the units of its "
        "header, as in time (ms), force (kN)"
    )
    _table: loads.Table = PrivateAttr()

    @model_validator(mode="after")
    def _read(self, info: ValidationInfo) -> Self:
        quantity = self.quantity if self.base is None else "acceleration"
        with of_key("file"):
            self._table = read_table(beside_scene(self.file, info), quantity)
        return self

    def to_amplitude(self) -> loads.Table:
        """Force (N) as a function of time."""
        return self._table


AnyLoad: TypeAlias = Annotated[
    HarmonicLoad | MultiHarmonicLoad | SweptSineLoad | PulseLoad | RectangleLoad | TableLoad,
    Field(discriminator="kind"),
]


class TimeTable(SceneTable):
    """``[time]``: cycles or until, and steps_per_cycle; or duration and step."""

    cycles: Count | None = key("number of cycles; a cycle is the common period of the loads", None)
    until: Literal["steady"] | None = key(
        "'steady' computes a cycle of the steady vibration, in place of cycles", None
    )
    steps_per_cycle: int = key("steps in a cycle", 200, ge=PER_PERIOD, le=LARGEST_COUNT)
    duration: Positive | None = key("length of the run, s", None)
    step: Positive | None = key("length of a step, s", None)
    rho_infinity: float = key(
        "spectral radius of the scheme at high frequency; 1 adds no damping",
        1.0,
        ge=0,
        le=1,
    )
    quasi_static: bool = key(
        "whether the loads change so slowly that inertia and damping are left out; friction is "
        "then Coulomb's, whatever beta is",
        False,
    )

    @model_validator(mode="after")
    def _has_no_vibration(self) -> Self:
        if self.quasi_static and "rho_infinity" in self.model_fields_set:
            raise mistake(
                f"found {self.rho_infinity:g} beside quasi_static = true, which has no scheme in "
                "time; leave it out",
                "rho_infinity",
            )
        if self.quasi_static and self.until is not None:
            raise mistake(
                f"found '{self.until}' beside quasi_static = true, which has no vibration; give "
                "cycles in its place",
                "until",
            )
        return self

    @model_validator(mode="after")
    def _is_given_one_way(self) -> Self:
        by_cycles = self.model_fields_set & {"cycles", "until", "steps_per_cycle"}
        by_duration = self.model_fields_set & {"duration", "step"}
        choice = "must be either cycles or until (and steps_per_cycle), or duration and step"
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
        elif self.until is not None and self.cycles is not None:
            raise mistake("found beside until = 'steady'; leave out either of them", "cycles")
        elif self.until is None and self.cycles is None:
            raise mistake(f"missing; {choice}", "cycles")
        return self


def _largest_first(names: tuple[str, ...]) -> tuple[str, ...]:
    """Names of models, the largest first, since the others are compared with it."""
    return tuple(sorted(has_no_repeats(names), key=("full", "condensed", "reduced").index))


class ModelsTable(SceneTable):
    """``[models]``: the models that are integrated."""

    run: Annotated[
        TomlList[Literal["full", "condensed", "reduced"]], AfterValidator(_largest_first)
    ] = key("list of models; the largest is run first", ("full",), min_length=1)
    contact_points: Annotated[
        Annotated[Literal["all"], Tag(Form.WORD)] | Annotated[Count, Tag(Form.NUMBER)],
        by_form(Form.WORD),
    ] = key(
        "most contact points of the condensed model; fewer than there are merge points that move "
        "alike, and the estimated error by points says what that causes",
        "all",
        allowed="'all' or a whole number >= 1",
    )
    parts: Count | None = key(
        "number of parts that the structure is factorised in, one after another, where a factor of "
        "the whole takes too much memory; the condensed model alone is made of them",
        None,
    )


class ReductionTable(SceneTable):
    """``[reduction]``: how the reduced model is made."""

    reference: Literal["static", "self", "paper"] = key(
        "source of the joint modes of a run: the static slip path, the full run of the scene, or "
        "the scaled modes of the paper's joint",
        "static",
    )
    modes: NumberOrAuto[Count] = key(
        "number of joint modes; 'auto' is 12, of a backbone 24, 5 with reference = 'paper', and "
        "with range as many as its accuracy takes",
        "auto",
        allowed="'auto' or a whole number >= 1",
    )
    interface_modes: NumberOrAuto[CountOrZero] = key(
        "number of fixed-interface modes beside them; 'auto' chooses by their share in the "
        "response, and takes none with reference = 'self'",
        "auto",
        allowed="'auto' or a whole number >= 0",
    )
    beta: NumberOrAuto[Positive] = key(
        "steepness of the arctan law, s/m; 'auto' chooses by the error of the modes",
        "auto",
        allowed="'auto' or a steepness in s/m > 0",
    )
    friction_points: Annotated[
        Annotated[Literal["auto", "all"], Tag(Form.WORD)] | Annotated[Count, Tag(Form.NUMBER)],
        by_form(Form.WORD),
    ] = key(
        "number of points with friction; 'auto' merges contact points as far as the error of this "
        "stays small, 'all' merges none",
        "auto",
        allowed="'auto', 'all' or a whole number >= 1",
    )
    snapshots: Literal["both", "displacement", "rates"] = key(
        "what the joint modes span: displacement and velocity, displacement alone (as in the "
        "paper), or velocity and acceleration",
        "both",
    )
    inner_product: Literal["auto", "euclidean", "mass", "energy"] = key(
        "inner product in which modes are orthogonal; 'auto' is 'energy' for snapshots of the "
        "scene's own run and 'euclidean' for those of the paper",
        "auto",
    )
    active_length: Annotated[
        Annotated[Literal["auto", "estimate"], Tag(Form.WORD)]
        | Annotated[Positive, Tag(Form.NUMBER)]
        | Annotated[dict[str, Positive], Tag(Form.TABLE)],
        by_form(Form.WORD, Form.TABLE),
    ] = key(
        "length to which the paper's modes are scaled, m; 'auto' takes it from a quick run, "
        "'estimate' from Eqs. (17)-(20) of the paper",
        "auto",
        allowed="'auto', 'estimate', a length in m, or a table { joint = length }",
    )
    range: ServedRangeTable | None = key(
        'table { slip, frequency, "joint[0].friction" }: loads and friction limits that one '
        "reduced model serves, which is made once and used by run, sweep, response and backbone",
        None,
    )

    @model_validator(mode="after")
    def _range_stands_alone(self) -> Self:
        others = sorted(self.model_fields_set - {"range", "modes"})
        if self.range is not None and others:
            raise mistake(
                f"found beside {' and '.join(others)}; a model for a range takes its friction "
                "points, law and all but the number of joint modes from the range. Leave out "
                "either of them",
                "range",
            )
        return self


class AccuracyTable(SceneTable):
    """``[accuracy]``: largest errors allowed, and whether errors are estimated."""

    displacement: Positive | None = key("largest relative error of histories and peaks", None)
    energy: Positive | None = key("largest relative error of friction and loop energy", None)
    estimate: bool = key("whether errors are estimated, by verification runs", True)

    @model_validator(mode="after")
    def _is_estimated(self) -> Self:
        if self.is_given and not self.estimate:
            raise mistake("found false beside a largest error; leave it out", "estimate")
        return self

    @property
    def is_given(self) -> bool:
        """Whether a largest error is given."""
        return self.displacement is not None or self.energy is not None


class RandomTable(SceneTable):
    """``[random]``: a load by its power spectral density."""

    psd: FileNames = key(
        "name of a CSV file, relative to the scene: frequency in Hz, density of one side in "
        "N²/Hz (Pa²/Hz of a traction or pressure), or (m/s²)²/Hz of a base; or a list with one "
        "for each load, which then act without correlation"
    )
    unit: Literal["SI", "g2/Hz"] = key(
        "unit of the density; 'g2/Hz' with g = 9.80665 m/s² is for a base that is accelerated", "SI"
    )
    load: str | None = key(
        "place of the load that has the density, whose course over time then does not count: its "
        "on, or mass_x, mass_y or mass_z of a base; not needed where there is one load, or a "
        "density for each",
        None,
    )
    duration: Positive = key(
        "time for which the largest values are expected, at least five cycles of each mode, s",
        3600.0,
    )
    _densities: list[PowerDensity] = PrivateAttr()

    @model_validator(mode="after")
    def _read(self, info: ValidationInfo) -> Self:
        names = (self.psd,) if isinstance(self.psd, str) else self.psd
        with of_key("psd"):
            self._densities = [PowerDensity.of(beside_scene(x, info), self.unit) for x in names]
        return self

    @property
    def densities(self) -> list[PowerDensity]:
        """Density of the file, or of each of a list."""
        return self._densities

    @property
    def given(self) -> PowerDensity | list[PowerDensity]:
        """The same as `random_response` takes them: one by itself."""
        return self._densities[0] if isinstance(self.psd, str) else self._densities


class OutputTable(SceneTable):
    """``[output]``: what is written and how often."""

    vtk: bool = key("fields for ParaView, by run", False)
    plots: bool = key("pictures as PNG", False)
    uff: bool = key(
        "universal file of geometry, modes (by backbone at each of its levels) and, by response, "
        "frequency responses, for programs of modal test; by run, response and backbone",
        False,
    )
    every: Count = key("interval of the stored steps 0, every, 2 every, ...", 1)
    points: Names = key(
        "names of the points, boundaries and regions whose mean displacement is observed; all "
        "points that can move if not given",
        (),
    )
    stress: Names = key(
        "names of the regions whose stress is told: at rest, and mean and range of the last cycle; "
        "by run",
        (),
    )
    frames: Count = key(
        "number of stored times in the series for ParaView; with stress at least 64 a cycle", 200
    )
    history: bool = key("motion of the observed points, as history.npz", True)


#: Commands that take account of keys which not all commands do. Keys of how the run is written, as
#: vtk, are not here: every scene has a run, so that they say nothing of what others shall do.
SERVED_BY: Mapping[str, tuple[str, ...]] = {
    "output.uff": ("run", "backbone", "response"),
    "output.stress": ("run", "sweep"),
    "models.parts": ("run", "backbone", "response", "random", "sweep"),
}


class FrequenciesTable(SceneTable):
    """``frequencies = { from, to, points }``: frequencies at equal distances."""

    from_: Positive = key("lowest frequency, Hz", alias="from")
    to: Positive = key("highest frequency, Hz")
    points: Count = key("number of frequencies; more are added around peaks", 21)

    @model_validator(mode="after")
    def _rises(self) -> Self:
        if self.to < self.from_ or (self.to == self.from_ and self.points > 1):
            raise mistake(f"found {self.to:g}, must be above from, {self.from_:g}", "to")
        return self


class ResponseTable(SceneTable):
    """``[response]``: steady vibration over frequency, for the command ``response``."""

    frequencies: FrequenciesTable = key(
        "table { from, to, points }: fundamental frequencies of the loads, Hz"
    )
    levels: TomlList[Positive] = key("factors of the loads' amplitudes", (1.0,), min_length=1)
    method: Literal["time", "harmonic"] = key(
        "steady vibration by time steps, or by harmonic balance, which follows curves through "
        "turning points, with Coulomb's law; of reduced models",
        "time",
    )
    functions: Annotated[
        TomlList[Literal["receptance", "mobility", "accelerance", "transmissibility"]],
        AfterValidator(has_no_repeats),
    ] = key(
        "frequency responses of each named point to write: displacement, velocity or acceleration "
        "over the first load's force, or absolute motion over that of the moving base",
        (),
    )
    sweep_rates: Annotated[TomlList[Positive], AfterValidator(has_no_repeats)] = key(
        "rates of swept sines, octaves/min; through the frequencies up and down, their largest "
        "amplitudes in each cycle stand beside the curves; for harmonic loads of one frequency, in "
        "phase",
        (),
    )


class AmplitudesTable(SceneTable):
    """``at = { point, force }``: amplitudes of one quantity of a named point, half of peak to peak.

    One of the quantities is given, as a list that rises.
    """

    point: str = key(
        "named point, as results show it: a load's, or a point of the mesh in a direction, as "
        "'tip.x'. A load, which does not act here, names other places and directions"
    )
    displacement: Rising | None = key("displacements, m", None)
    velocity: Rising | None = key("velocities, m/s", None)
    acceleration: Rising | None = key("accelerations, m/s²", None)
    acceleration_g: Rising | None = key("accelerations over 9.80665 m/s²", None)
    force: Rising | None = key(
        "amplitudes of a harmonic force at the point, N; the mode vibrates at its resonance", None
    )

    @model_validator(mode="after")
    def _one_quantity(self) -> Self:
        names = [name for name in type(self).model_fields if name != "point"]
        found = [name for name in names if getattr(self, name)]
        if len(found) != 1:
            said = " and ".join(found) or "none"
            raise mistake(f"found {said}, must be exactly one of {', '.join(names)}")
        return self


#: Numbers of modes.
Modes: TypeAlias = Annotated[TomlList[Count], AfterValidator(has_no_repeats)]
_WHICH_MODES = "numbers of the modes of the structure with sticking contact, from 1 on"


class BackboneTable(SceneTable):
    """``[backbone]``: frequency and damping against amplitude, for the command ``backbone``."""

    modes: Modes = key(_WHICH_MODES, (1,), min_length=1)
    levels: Count = key("number of points of each curve", 20)
    up_to: Positive = key(
        "the highest load level, as a share of that at which the first joint slips as a whole", 0.7
    )
    at: AmplitudesTable | None = key(
        "table { point, force } or with another quantity: amplitudes at which frequency, loss "
        "factor and the parts of joints and bolts are computed beside the curve",
        None,
    )
    ring_down: CountOrZero = key(
        "cycles of free vibration that the curves are compared with; some four at its ends are not "
        "measured",
        0,
    )
    released: Literal["mode", "loads"] = key(
        "start of the free vibration: 'mode' at rest in the displacement of the highest level, "
        "'loads' in the state at the end of the loads, which must be pulses",
        "mode",
    )

    @model_validator(mode="after")
    def _rings_down(self) -> Self:
        if self.released == "loads" and not self.ring_down:
            raise mistake("found 'loads', but ring_down asks for no cycles", "released")
        return self


class AmplitudeRangeTable(FrequenciesTable):
    """``amplitudes = { from, to, points }``: amplitudes at equal ratios."""

    from_: Positive = key("lowest amplitude, m", alias="from")
    to: Positive = key("highest amplitude, m")
    points: Count = key("number of amplitudes", 12)


class NonlinearModesTable(SceneTable):
    """``[nonlinear_modes]``: modes into gross slip, for the command ``nonlinear-modes``."""

    modes: Modes = key(_WHICH_MODES, (1,), min_length=1)
    amplitudes: Annotated[
        Annotated[Rising, Tag(Form.LIST)] | Annotated[AmplitudeRangeTable, Tag(Form.TABLE)],
        by_form(Form.TABLE, otherwise=Form.LIST),
    ] = key(
        "amplitudes of the first harmonic of the point, m, as a list that rises, or a table "
        "{ from, to, points }"
    )
    at: str | None = key(
        "named point whose amplitudes they are, as results show it; the one that the mode moves "
        "most if not given",
        None,
    )
    model: Literal["full", "condensed", "reduced"] = key(
        "model whose modes they are; full and condensed ones must be small", "reduced"
    )
    confirm: bool = key("whether time steps judge three amplitudes of each mode", True)

    @property
    def levels(self) -> FloatArray:
        """The amplitudes, (levels,), m."""
        table = self.amplitudes
        if isinstance(table, AmplitudeRangeTable):
            return np.geomspace(table.from_, table.to, table.points)
        return np.array(table)
