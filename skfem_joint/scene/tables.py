"""Tables of a scene, alike for every dimension.

They hold what a scene says by itself: forms, ranges, and what must fit together within a table.
What only the mesh can tell (names, overlaps, what a dimension needs) is the structure's to check.
"""

from __future__ import annotations

from collections.abc import Callable
from inspect import signature
from pathlib import Path
from typing import Annotated, Literal, Self, TypeAlias

from pydantic import AfterValidator, Field, PrivateAttr, Tag, ValidationInfo, model_validator

from skfem_joint import loads
from skfem_joint.errors import InputError
from skfem_joint.load_tables import read_table
from skfem_joint.scene.messages import LIST, NUMBER, TABLE, WORD, mistake
from skfem_joint.scene.values import (
    A_LIST,
    MOST,
    Auto,
    Count,
    Direction,
    FileName,
    Names,
    NotNegative,
    Number,
    PoissonRatio,
    Positive,
    SceneTable,
    has_no_repeats,
    key,
    one_of,
)
from skfem_joint.stepping.resolution import PER_PERIOD


class MeshTable(SceneTable):
    """``[mesh]``: where the mesh is."""

    file: Annotated[
        Annotated[FileName, Tag(WORD)]
        | Annotated[tuple[FileName, ...], Field(strict=False, min_length=1), Tag(LIST)],
        one_of(LIST, otherwise=WORD),
    ] = key(
        "name of the mesh file, relative to the scene, or a list of files of several bodies; Gmsh "
        ".msh of format 2.2 or 4.1, ASCII or binary, or for bars Abaqus .inp"
    )
    scale: Positive = key("length of the mesh's unit, m", 1.0)

    def paths(self, folder: Path) -> list[Path]:
        """Files of a scene that lies in ``folder``."""
        names = (self.file,) if isinstance(self.file, str) else self.file
        return [folder / name for name in names]


class _Override(SceneTable):
    """What differs in a region; sets something."""

    @model_validator(mode="after")
    def _sets_something(self) -> Self:
        if not self.model_fields_set:
            raise mistake(f"found an empty table, must set {' or '.join(type(self).model_fields)}")
        return self


class MaterialOverride(_Override):
    """``[material.regions.NAME]``: what differs in a region."""

    E: Positive | None = key("Young's modulus, Pa", None)
    density: Positive | None = key("density, kg/m³", None)
    poisson: PoissonRatio | None = key("Poisson's ratio", None)


class MaterialTable(SceneTable):
    """``[material]``: linear elastic, isotropic."""

    E: Positive = key("Young's modulus, Pa")
    density: Positive = key("density, kg/m³")
    poisson: PoissonRatio | None = key("Poisson's ratio; bars do without", None)
    mass_matrix: Literal["consistent", "lumped"] = key("mass of shapes, or of nodes", "consistent")
    regions: dict[str, MaterialOverride] = key("what differs in regions, by their names", {})


class SectionOverride(_Override):
    """``[section.regions.NAME]``: what differs in a region."""

    width: Positive | None = key("width of a bar, m", None)
    thickness: Positive | None = key("thickness, m", None)


class SectionTable(SceneTable):
    """``[section]``: what the mesh does not show of the bodies."""

    width: Positive | None = key("width of a bar and of its contact, m", None)
    thickness: Positive | None = key("thickness of a bar, or of a plate, m", None)
    plane: Literal["stress", "strain"] = key("state of a plate across its plane", "stress")
    regions: dict[str, SectionOverride] = key("what differs in regions, by their names", {})


class SupportTable(SceneTable):
    """``[support]``: points, boundaries and regions that are held."""

    fixed: Names = key("names of what is held in every direction", ())
    fixed_x: Names = key("names of what is held along x", ())
    fixed_y: Names = key("names of what is held along y", ())
    fixed_z: Names = key("names of what is held along z", ())


class DampingTable(SceneTable):
    """``[damping]``: C = stiffness * K + mass * M, by its factors or by the ratio it gives."""

    stiffness: NotNegative = key("factor of the stiffness matrix, s", 0.0)
    mass: NotNegative = key("factor of the mass matrix, 1/s", 0.0)
    ratio: float | None = key("share of the critical damping", None, gt=0, lt=1)

    @model_validator(mode="after")
    def _is_given_one_way(self) -> Self:
        if self.ratio is not None and (given := sorted(self.model_fields_set - {"ratio"})):
            raise mistake(
                f"found {self.ratio:g} beside {' and '.join(given)}, must be given alone", "ratio"
            )
        return self


_SHAPES: dict[str, Callable[..., loads.Amplitude]] = {
    "harmonic": loads.Harmonic,
    "triangle": loads.Triangle,
    "half_sine": loads.HalfSine,
    "versine": loads.Versine,
    "ramp_and_hold": loads.RampAndHold,
    "rectangle": loads.Rectangle,
}


class _Load(SceneTable):
    kind: str
    on: str | None = key("name of the point, boundary or region that the load acts on", None)
    direction: Direction | None = key(
        "direction of the force, [x, y] or [x, y, z], of any length; needed but on bars and for a "
        "pressure",
        None,
    )
    quantity: Literal["force", "traction", "pressure"] = key(
        "what is given over time: the whole force in N, or, on a boundary, a traction along "
        "direction or a pressure against the outward normal, both in N/m² instead of N",
        "force",
    )
    base: Literal["x", "y", "z"] | None = key(
        "axis along which all supports are accelerated; what is a force in N on a part of the "
        "structure is then an acceleration in m/s²",
        None,
    )

    @model_validator(mode="after")
    def _acts_on_one(self) -> Self:
        if (self.on is None) == (self.base is None):
            found = "missing" if self.on is None else f"found '{self.on}' beside base"
            raise mistake(
                f"{found}, must be given: name of the point, boundary or region that a force acts "
                "on, or instead of it base = 'x', 'y' or 'z', along which supports are accelerated",
                "on",
            )
        if self.base is not None and self.direction is not None:
            raise mistake(
                "found beside base, which is a direction itself; leave it out", "direction"
            )
        return self

    def to_amplitude(self) -> loads.Amplitude:
        """Force (N) as a function of time: a shape whose parameters are keys here."""
        shape = _SHAPES[self.kind]
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
    components: Annotated[tuple[ComponentTable, ...], A_LIST] = key(
        "list of tables { amplitude, frequency, phase } that are added", min_length=1
    )

    def to_amplitude(self) -> loads.MultiHarmonic:
        """Force (N) as a function of time."""
        return loads.MultiHarmonic([loads.Harmonic(**one.model_dump()) for one in self.components])


class PulseLoad(_Load):
    """``kind = "triangle", "half_sine", "versine", "ramp_and_hold"``: a rise to a peak.

    There the last stays; the others fall as they rose.
    """

    kind: Literal["triangle", "half_sine", "versine", "ramp_and_hold"] = key(
        "shape of the force in time"
    )
    peak: Number = key("largest force, N; a negative one pushes")
    rise_time: Positive = key(
        "time from start to peak, s; half the length of a triangle, half sine or versine"
    )
    start: NotNegative = key("time at which the force sets in, s", 0.0)


class RectangleLoad(_Load):
    """``kind = "rectangle"``: a force that is constant for a while."""

    kind: Literal["rectangle"] = key("shape of the force in time")
    peak: Number = key("force, N; a negative one pushes")
    duration: Positive = key("time that the force lasts, s")
    start: NotNegative = key("time at which the force sets in, s", 0.0)


class TableLoad(_Load):
    """``kind = "table"``: forces at points of time, linear between them, zero before and after."""

    kind: Literal["table"] = key("shape of the force in time")
    file: FileName = key("name of a CSV file, relative to the scene: time in s, force in N")
    _table: loads.Table = PrivateAttr()

    @model_validator(mode="after")
    def _read(self, info: ValidationInfo) -> Self:
        folder: Path = (info.context or {}).get("folder", Path())
        try:
            self._table = read_table(folder / self.file)
        except InputError as error:
            raise mistake("\n".join(error.problems), "file") from error
        return self

    def to_amplitude(self) -> loads.Table:
        """Force (N) as a function of time."""
        return self._table


AnyLoad: TypeAlias = Annotated[
    HarmonicLoad | MultiHarmonicLoad | PulseLoad | RectangleLoad | TableLoad,
    Field(discriminator="kind"),
]


class TimeTable(SceneTable):
    """``[time]``: cycles or until, and steps_per_cycle; or duration and step."""

    cycles: Count | None = key("number of common periods of the loads", None)
    until: Literal["steady"] | None = key(
        "'steady' finds the period at which vibration is steady, however many cycles that takes",
        None,
    )
    steps_per_cycle: int = key("steps in a common period", 200, ge=PER_PERIOD, le=MOST)
    duration: Positive | None = key("length of the run, s", None)
    step: Positive | None = key("length of a step, s", None)
    rho_infinity: float = key(
        "spectral radius of the scheme at high frequency; 1 damps nothing", 1.0, ge=0, le=1
    )

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
            raise mistake("found beside until = 'steady', which counts them itself", "cycles")
        elif self.until is None and self.cycles is None:
            raise mistake(f"missing; {choice}", "cycles")
        return self


def in_order(names: tuple[str, ...]) -> tuple[str, ...]:
    """Names of models, the largest first: others compare with it."""
    return tuple(sorted(has_no_repeats(names), key=("full", "condensed", "reduced").index))


class ModelsTable(SceneTable):
    """``[models]``: which models are integrated."""

    run: Annotated[
        tuple[Literal["full", "condensed", "reduced"], ...], A_LIST, AfterValidator(in_order)
    ] = key("list of models; the largest is run first", ("full",), min_length=1)


class ReductionTable(SceneTable):
    """``[reduction]``: how the reduced model is made."""

    reference: Literal["static", "self", "paper"] = key(
        "origin of joint modes: the static slip path, the scene's own run, or the paper's joint, "
        "scaled",
        "static",
    )
    modes: Annotated[Auto | Annotated[Count, Tag(NUMBER)], one_of(WORD)] = key(
        "number of joint modes; 'auto' is 12, of the paper's 5",
        "auto",
        allowed="'auto' or a whole number >= 1",
    )
    interface_modes: Annotated[
        Auto | Annotated[int, Field(ge=0, le=MOST), Tag(NUMBER)], one_of(WORD)
    ] = key(
        "number of fixed-interface modes beside them; 'auto' goes by their share in the response",
        "auto",
        allowed="'auto' or a whole number >= 0",
    )
    beta: Annotated[Auto | Annotated[Positive, Tag(NUMBER)], one_of(WORD)] = key(
        "steepness of the arctan law, s/m; 'auto' goes by the error of the modes",
        "auto",
        allowed="'auto' or a steepness in s/m > 0",
    )
    friction_points: Annotated[
        Annotated[Literal["auto", "all"], Tag(WORD)] | Annotated[Count, Tag(NUMBER)], one_of(WORD)
    ] = key(
        "number of points with friction; 'auto' is as many as it takes, 'all' every contact point",
        "auto",
        allowed="'auto', 'all' or a whole number >= 1",
    )
    snapshots: Literal["both", "displacement", "rates"] = key(
        "what modes span: displacement and velocity, the first (paper), or velocity and "
        "acceleration",
        "both",
    )
    inner_product: Literal["auto", "euclidean", "mass", "energy"] = key(
        "weight of snapshots of the scene's run (energy) or the paper's (euclidean)", "auto"
    )
    active_length: Annotated[
        Annotated[Literal["auto", "estimate"], Tag(WORD)]
        | Annotated[Positive, Tag(NUMBER)]
        | Annotated[dict[str, Positive], Tag(TABLE)],
        one_of(WORD, TABLE),
    ] = key(
        "length that the paper's modes are scaled to, m; 'auto' by a quick run, 'estimate' by "
        "Eqs. (17)-(20)",
        "auto",
        allowed="'auto', 'estimate', a length in m, or a table { joint = length }",
    )


class AccuracyTable(SceneTable):
    """``[accuracy]``: errors that are asked for, and whether errors are estimated."""

    displacement: Positive | None = key("largest relative error of histories and peaks", None)
    energy: Positive | None = key("largest relative error of friction and loop energy", None)
    estimate: bool = key("whether results are run again to estimate their errors", True)

    @model_validator(mode="after")
    def _is_estimated(self) -> Self:
        if self.asked and not self.estimate:
            raise mistake("found false beside an accuracy asked for; leave it out", "estimate")
        return self

    @property
    def asked(self) -> bool:
        """Whether an accuracy is asked for."""
        return self.displacement is not None or self.energy is not None


class OutputTable(SceneTable):
    """``[output]``: what is written and how often."""

    vtk: bool = key("fields for ParaView", False)
    plots: bool = key("pictures as PNG", False)
    every: Count = key("stored are steps 0, every, 2 every, ...", 1)
    points: Names = key("names of what is observed; all free points if none is named", ())
    frames: Count = key("moments in the series for ParaView", 200)
    history: bool = key("motion of what is observed, as history.npz", True)


class FrequenciesTable(SceneTable):
    """``frequencies = { from, to, points }``: frequencies at equal distances."""

    from_: Positive = key("lowest frequency, Hz", alias="from")
    to: Positive = key("highest frequency, Hz")
    points: Count = key("number of frequencies, before those around peaks", 21)

    @model_validator(mode="after")
    def _rises(self) -> Self:
        if self.to < self.from_ or (self.to == self.from_ and self.points > 1):
            raise mistake(f"found {self.to:g}, must be above from, {self.from_:g}", "to")
        return self


class ResponseTable(SceneTable):
    """``[response]``: steady vibration over frequency, for the command ``response``."""

    frequencies: FrequenciesTable = key(
        "table { from, to, points }: first harmonics of the loads, Hz"
    )
    levels: Annotated[tuple[Positive, ...], A_LIST] = key(
        "factors of the loads' amplitudes", (1.0,), min_length=1
    )


class BackboneTable(SceneTable):
    """``[backbone]``: frequency and damping against amplitude, for the command ``backbone``."""

    modes: Annotated[tuple[Count, ...], A_LIST, AfterValidator(has_no_repeats)] = key(
        "numbers of modes with the contact stuck", (1,), min_length=1
    )
    levels: Count = key("points of each curve", 20)
    up_to: Positive = key(
        "the highest level, as a share of that at which the first joint slips as a whole", 0.7
    )
    ring_down: int = key("cycles of free vibration to compare with", 0, ge=0, le=MOST)
    released: Literal["mode", "loads"] = key(
        "what it begins with: the highest level's displacement at rest, or where pulses end", "mode"
    )

    @model_validator(mode="after")
    def _rings_down(self) -> Self:
        if self.released == "loads" and not self.ring_down:
            raise mistake("found 'loads', but ring_down asks for no cycles", "released")
        return self
