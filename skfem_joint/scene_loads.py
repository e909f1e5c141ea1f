"""Loads of a scene: ``[[load]]`` by kind, on struts and on plates."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, ClassVar, Literal, Self, TypeAlias

from pydantic import Field, PrivateAttr, ValidationInfo, model_validator

from skfem_joint import loads
from skfem_joint.errors import InputError
from skfem_joint.scene_messages import mistake
from skfem_joint.scene_values import (
    A_LIST,
    Direction,
    FileName,
    NotNegative,
    Number,
    PlaceName,
    Positive,
    SceneTable,
)


class _LoadOn(SceneTable):
    foreign: ClassVar[dict[str, str]] = {
        "direction": "direction is for plates; a force on a strut acts along it"
    }

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
    components: Annotated[tuple[Component, ...], A_LIST] = Field(
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


class _OnPlate(SceneTable):
    """Load on a plate: it acts in a direction, a unit vector."""

    on: PlaceName = Field(description="name of the point, boundary or region the load acts on")
    direction: Direction = (1.0, 0.0)


class PlateHarmonicLoad(_OnPlate, HarmonicLoad):
    """``kind = "harmonic"`` on a plate."""


class PlateMultiHarmonicLoad(_OnPlate, MultiHarmonicLoad):
    """``kind = "multi_harmonic"`` on a plate."""


class PlatePulseLoad(_OnPlate, PulseLoad):
    """The kinds of load that rise to a peak, on a plate."""


class PlateRectangleLoad(_OnPlate, RectangleLoad):
    """``kind = "rectangle"`` on a plate."""


class PlateTableLoad(_OnPlate, TableLoad):
    """``kind = "table"`` on a plate."""


AnyLoad: TypeAlias = Annotated[
    HarmonicLoad | MultiHarmonicLoad | PulseLoad | RectangleLoad | TableLoad,
    Field(discriminator="kind"),
]
AnyPlateLoad: TypeAlias = Annotated[
    PlateHarmonicLoad
    | PlateMultiHarmonicLoad
    | PlatePulseLoad
    | PlateRectangleLoad
    | PlateTableLoad,
    Field(discriminator="kind"),
]
