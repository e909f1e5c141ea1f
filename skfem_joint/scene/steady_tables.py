"""The tables of a scene that ask for steady vibration: ``[response]`` and ``[backbone]``."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import AfterValidator, model_validator

from skfem_joint.scene.messages import mistake
from skfem_joint.scene.values import (
    A_LIST,
    MOST,
    Count,
    Positive,
    SceneTable,
    has_no_repeats,
    key,
)


class Frequencies(SceneTable):
    """``frequencies = { from, to, points }``: frequencies at equal distances."""

    from_: Positive = key("lowest frequency, Hz", alias="from")
    to: Positive = key("highest frequency, Hz")
    points: Count = key("number of frequencies, before those around peaks", 21)

    @model_validator(mode="after")
    def _rises(self) -> Self:
        if self.to < self.from_ or (self.to == self.from_ and self.points > 1):
            raise mistake(f"found {self.to:g}, must be above from, {self.from_:g}", "to")
        return self


class Response(SceneTable):
    """``[response]``: steady vibration over frequency, for the command ``response``."""

    frequencies: Frequencies = key("table { from, to, points }: first harmonics of the loads, Hz")
    levels: Annotated[tuple[Positive, ...], A_LIST] = key(
        "factors of the loads' amplitudes", (1.0,), min_length=1
    )


class Backbone(SceneTable):
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
