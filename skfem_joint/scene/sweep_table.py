"""The table ``[sweep]`` of a scene: keys of the scene and the values that they take in turn."""

from __future__ import annotations

import math
from itertools import product
from typing import Annotated, Any, Literal, Self, get_args

import numpy as np
from pydantic import AfterValidator, ConfigDict, Field, Tag, model_validator

from skfem_joint.ground.key_paths import key_parts, key_path
from skfem_joint.scene.messages import Form, mistake
from skfem_joint.scene.values import Number, SceneTable, TomlList, by_form, has_no_repeats, key

#: Largest number of scenes in a sweep.
MOST_SCENES = 10**5
# Entries of a model's summary that the table of results may have.
_Motion = Literal["peak_displacement_m", "peak_displacement_whole_run_m", "active_length_m"]
_Energy = Literal["friction_energy_per_cycle_J", "loop_energy_per_cycle_J", "friction_energy_J"]
_Loss = Literal["loss_factor", "equivalent_viscous_ratio", "quality_factor"]
_Cost = Literal["estimated_error", "error", "dofs", "wall_s", "offline_s"]


class RangeTable(SceneTable):
    """``{ from, to, points, scale }``: values at equal distances, or in equal ratios."""

    first: Number = key("first value", alias="from")
    last: Number = key("last value", alias="to")
    points: int = key("number of values", ge=2, le=MOST_SCENES)
    scale: Literal["linear", "log"] = key("equal distances, or equal ratios", "linear")

    @model_validator(mode="after")
    def _has_ratio(self) -> Self:
        if self.scale == "log" and self.first * self.last <= 0:
            raise mistake(
                f"found {self.first:g} to {self.last:g} in equal ratios, must both be > 0 or < 0"
            )
        return self

    def values(self) -> tuple[float, ...]:
        """Values of the range, rounded to 12 digits; integers if all are whole numbers."""
        between = np.geomspace if self.scale == "log" else np.linspace
        values = [float(f"{x:.12g}") for x in between(self.first, self.last, self.points)]
        return tuple(map(int, values) if all(x.is_integer() for x in values) else values)


class SweepTable(SceneTable):
    """``[sweep]``: values that keys of the scene, such as ``"joint[0].friction"``, take in turn."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[
        str,
        Annotated[
            Annotated[TomlList[Any], Field(min_length=1), Tag(Form.LIST)]
            | Annotated[RangeTable, Tag(Form.TABLE)],
            by_form(Form.TABLE, otherwise=Form.LIST),
            Field(description="values that a key of the scene takes in turn"),
        ],
    ]
    combine: Literal["product", "list"] = key(
        "product: every value of a key with every value of the others; list: the first values of "
        "all keys, then the second ones, and so on",
        "product",
    )
    results: Annotated[
        TomlList[Literal[_Motion, _Energy, _Loss, _Cost]], AfterValidator(has_no_repeats)
    ] = key(
        "columns of the table of results, from each model's summary",
        ("peak_displacement_m", *get_args(_Energy), "estimated_error", "wall_s"),
        min_length=1,
    )

    @model_validator(mode="after")
    def _has_values_that_combine(self) -> Self:
        values = self.values()
        if not values:
            raise mistake('must have a key with values, such as "joint[0].friction" = [0.3, 0.7]')
        for name, of_key in values.items():
            where = key_path((name,))
            if key_parts(name) is None:
                raise mistake(
                    f"unknown key; allowed: {', '.join(type(self).model_fields)} or, in quotes, "
                    'the key of a value in a table, such as "joint[0].friction"',
                    where,
                )
            if self.combine == "product" and len({repr(value) for value in of_key}) < len(of_key):
                raise mistake("found a value more than once, must not repeat", where)
        counts = [len(of_key) for of_key in values.values()]
        if self.combine == "list" and len(set(counts)) > 1:
            raise mistake(
                f"found {', '.join(map(str, counts))} values beside combine = 'list', must be the "
                "same number for each key"
            )
        if self.combine == "product" and math.prod(counts) > MOST_SCENES:
            raise mistake(f"found {math.prod(counts)} scenes, must be at most {MOST_SCENES}")
        return self

    def values(self) -> dict[str, tuple[Any, ...]]:
        """Values of each key."""
        return {
            name: values.values() if isinstance(values, RangeTable) else values
            for name, values in (self.__pydantic_extra__ or {}).items()
        }

    def combinations(self) -> list[dict[str, Any]]:
        """Value of each key in each scene; in a product the last key changes first."""
        names, values = zip(*self.values().items(), strict=True)
        rows = product(*values) if self.combine == "product" else zip(*values, strict=True)
        return [dict(zip(names, row, strict=True)) for row in rows]
