"""The table ``[sweep]`` of a scene: keys, and the values that they go through."""

from __future__ import annotations

import math
from itertools import product
from typing import Annotated, Any, Literal, Self, get_args

import numpy as np
from pydantic import AfterValidator, ConfigDict, Field, Tag, model_validator

from skfem_joint.scene.messages import LIST, TABLE, key_parts, key_path, mistake
from skfem_joint.scene.values import A_LIST, Number, SceneTable, has_no_repeats, key, one_of

#: Most scenes of a sweep.
MOST_SCENES = 10**5
# What can be chosen of a model's summary.
_MOTION = Literal["peak_displacement_m", "peak_displacement_whole_run_m", "active_length_m"]
_ENERGY = Literal["friction_energy_per_cycle_J", "loop_energy_per_cycle_J", "friction_energy_J"]
_OTHERS = Literal["estimated_error", "error", "dofs", "wall_s", "offline_s"]
_DEFAULT = ("peak_displacement_m", *get_args(_ENERGY), "estimated_error", "wall_s")


class RangeTable(SceneTable):
    """``{ from, to, points, scale }``: values at equal distances, or in equal ratios."""

    first: Number = key("first value", alias="from")
    last: Number = key("last value", alias="to")
    points: int = key("number of values", ge=2, le=MOST_SCENES)
    scale: Literal["linear", "log"] = key("equal distances, or equal ratios", "linear")

    @model_validator(mode="after")
    def _has_a_ratio(self) -> Self:
        if self.scale == "log" and self.first * self.last <= 0:
            raise mistake(
                f"found {self.first:g} to {self.last:g} in equal ratios, must both be > 0 or < 0"
            )
        return self

    def values(self) -> tuple[float, ...]:
        """Values, to 12 digits; whole numbers where all are."""
        between = np.geomspace if self.scale == "log" else np.linspace
        found = [float(f"{x:.12g}") for x in between(self.first, self.last, self.points)]
        return tuple(map(int, found) if all(x.is_integer() for x in found) else found)


class SweepTable(SceneTable):
    """``[sweep]``: values that keys of the scene, such as ``"joint[0].friction"``, go through."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[
        str,
        Annotated[
            Annotated[tuple[Any, ...], Field(strict=False, min_length=1), Tag(LIST)]
            | Annotated[RangeTable, Tag(TABLE)],
            one_of(TABLE, otherwise=LIST),
            Field(description="values that a key of the scene goes through"),
        ],
    ]
    combine: Literal["product", "list"] = key(
        "every value with every other, or the first of each key, the second of each, ...", "product"
    )
    results: Annotated[
        tuple[Literal[_MOTION, _ENERGY, _OTHERS], ...],
        A_LIST,
        AfterValidator(has_no_repeats),
    ] = key("what the table has of each model's summary", _DEFAULT, min_length=1)

    @model_validator(mode="after")
    def _goes_through_keys(self) -> Self:
        values = self.values()
        if not values:
            raise mistake('must have a key with values, such as "joint[0].friction" = [0.3, 0.7]')
        for name, some in values.items():
            where = key_path((name,))
            if key_parts(name) is None:
                raise mistake(
                    f"unknown key; allowed: {', '.join(type(self).model_fields)} or, in quotes, "
                    'the key of a value in a table, such as "joint[0].friction"',
                    where,
                )
            if self.combine == "product" and len({repr(value) for value in some}) < len(some):
                raise mistake("found a value more than once, must not repeat", where)
        counts = [len(some) for some in values.values()]
        if self.combine == "list" and len(set(counts)) > 1:
            found = ", ".join(map(str, counts))
            raise mistake(f"found {found} values beside combine = 'list', must be as many each")
        if self.combine == "product" and math.prod(counts) > MOST_SCENES:
            raise mistake(f"found {math.prod(counts)} scenes, must be at most {MOST_SCENES}")
        return self

    def values(self) -> dict[str, tuple[Any, ...]]:
        """Values of each key."""
        given = (self.__pydantic_extra__ or {}).items()
        return {name: one.values() if isinstance(one, RangeTable) else one for name, one in given}

    def combinations(self) -> list[dict[str, Any]]:
        """What each scene has of the keys; in a product the last key changes first."""
        names, values = zip(*self.values().items(), strict=True)
        rows = product(*values) if self.combine == "product" else zip(*values, strict=True)
        return [dict(zip(names, row, strict=True)) for row in rows]
