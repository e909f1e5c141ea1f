"""The key ``reduction.range`` of a scene: loads and friction limits that one reduced model serves.

Keys of joints are given as values of the scene, as those of a sweep are. A reduced model takes
factors on the limits of whole joints in their place: the product of value over geometric mean of
the interval, over all keys of a joint. Only keys that change all limits of a joint alike have such
a factor.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated, Any, Self

from pydantic import AfterValidator, ConfigDict, Field, model_validator

from skfem_joint.errors import InputError
from skfem_joint.key_paths import Location, key_parts, key_path
from skfem_joint.scene.joint_tables import BoltPressureTable, JointTable
from skfem_joint.scene.messages import mistake
from skfem_joint.scene.values import Positive, SceneTable, TomlList, key
from skfem_joint.served import Interval

#: Factors of bolts that differ by no more than this, relative, are one factor.
_ALIKE = 1e-9


def _rises(pair: tuple[float, ...]) -> tuple[float, ...]:
    if len(pair) != 2:
        raise mistake(f"found a list of {len(pair)}, must be two numbers, the lowest and highest")
    if pair[1] < pair[0]:
        raise mistake(
            f"found [{pair[0]:g}, {pair[1]:g}], must be the lowest and then the highest value"
        )
    return pair


def _is_share(pair: tuple[float, ...]) -> tuple[float, ...]:
    if pair[1] >= 1.0:
        raise mistake(
            f"found [{pair[0]:g}, {pair[1]:g}], must be below 1, at which the first joint slips as "
            "a whole"
        )
    return pair


Pair = Annotated[TomlList[Positive], AfterValidator(_rises)]


class ServedRangeTable(SceneTable):
    """``range = { slip, frequency, "joint[0].friction" }``: what one reduced model serves."""

    model_config = ConfigDict(extra="allow")
    __pydantic_extra__: dict[
        str,
        Annotated[
            Pair,
            Field(
                description="lowest and highest value of joint[N].friction, of a joint[N].pressure "
                "in Pa, or of the force of all bolts of a joint, joint[N].pressure.bolts[K].force"
            ),
        ],
    ]
    slip: Annotated[Pair, AfterValidator(_is_share)] = key(
        "lowest and highest share of the load that makes the first joint slip as a whole at that "
        "frequency, with inertia and damping; below 1"
    )
    frequency: Pair = key("lowest and highest frequency of the loads' common period, Hz")

    @model_validator(mode="after")
    def _has_keys_of_limits(self) -> Self:
        for name in self.values():
            parts = key_parts(name) or ()
            if _joint_of(parts) is None:
                why = (
                    "; clamping bolts may open a joint as they press it, so that its limits have "
                    "no common factor: give the friction of the joint"
                    if parts[:1] == ("bolt",)
                    else ""
                )
                raise mistake(
                    "is no key that changes all limits of a joint by a factor; allowed: slip, "
                    "frequency, and in quotes joint[N].friction, joint[N].pressure and "
                    f"joint[N].pressure.bolts[K].force{why}",
                    key_path((name,)),
                )
        return self

    def values(self) -> dict[str, Interval]:
        """Lowest and highest values of joints, by their keys."""
        extra: Mapping[str, Any] = self.__pydantic_extra__ or {}
        return {name: (pair[0], pair[1]) for name, pair in extra.items()}

    def problems(self, joints: Sequence[JointTable]) -> Iterator[str]:
        """What is wrong with the keys for these joints of a scene."""
        for name, (low, high) in self.values().items():
            where = f"reduction.{key_path(('range', name))}"
            number = _joint_of(key_parts(name) or ())
            if number is None or number >= len(joints):
                yield f"{where}: the scene has no joint[{number}]"
                continue
            try:
                value = _value(joints[number], key_parts(name) or ())
            except InputError as error:
                yield f"{where}: {error}"
                continue
            if not value > 0.0:
                yield f"{where}: found {value:g} in the scene, must be > 0 to be changed by factors"
            for other in _other_bolts(joints[number], name, number):
                pair = self.values().get(other)
                if pair is None or abs(pair[1] / pair[0] / (high / low) - 1.0) > _ALIKE:
                    yield (
                        f"{where}: found without {key_path(('range', other))} of the same ratio; "
                        "the force of one bolt of several changes a part of the joint's limits. "
                        "Give all bolts of the joint, or its friction"
                    )

    def limits(self, joints: Sequence[JointTable]) -> dict[str, Interval]:
        """Lowest and highest factor on the limits of each joint, by its name."""
        pairs: dict[str, dict[str, Interval]] = {}
        for name, (low, high) in self.values().items():
            middle = math.sqrt(low * high)
            kind = _kind(name)  # bolts of a joint have one factor in common
            pairs.setdefault(_named(joints, name).on, {})[kind] = low / middle, high / middle
        return {
            joint: (math.prod(p[0] for p in of.values()), math.prod(p[1] for p in of.values()))
            for joint, of in pairs.items()
        }

    def factors(self, joints: Sequence[JointTable]) -> dict[str, float]:
        """Factor on the limits of each joint that the values of these joints mean, by its name.

        Raises
        ------
        InputError
            If bolts of a joint have other factors than each other.
        """
        found: dict[str, dict[str, float]] = {}
        for name, (low, high) in self.values().items():
            joint, kind = _named(joints, name), _kind(name)
            factor = _value(joint, key_parts(name) or ()) / math.sqrt(low * high)
            earlier = found.setdefault(joint.on, {}).setdefault(kind, factor)
            if abs(earlier - factor) > _ALIKE * factor:
                raise InputError(
                    f"{name}: bolts of the joint {joint.on!r} differ from the range by other "
                    "factors than each other"
                )
        return {joint: math.prod(of.values()) for joint, of in found.items()}

    def at_the_middle(self, joints: Sequence[JointTable]) -> tuple[JointTable, ...]:
        """Joints with the geometric mean of the interval at each key: all factors are 1 there."""
        middle = [*joints]
        for name, (low, high) in self.values().items():
            parts = key_parts(name) or ()
            number = int(parts[1])
            middle[number] = _with_value(middle[number], parts, math.sqrt(low * high))
        return tuple(middle)


def _joint_of(parts: Location) -> int | None:
    """Number of the joint whose limits a key changes by a factor; None for other keys."""
    match parts:
        case ("joint", int() as number, "friction" | "pressure"):
            return number
        case ("joint", int() as number, "pressure", "bolts", int(), "force"):
            return number
    return None


def _named(joints: Sequence[JointTable], name: str) -> JointTable:
    return joints[int((key_parts(name) or ())[1])]


def _kind(name: str) -> str:
    """Friction or pressure: what of a joint a key changes."""
    return str((key_parts(name) or ())[2])


def _value(joint: JointTable, parts: Location) -> float:
    """Value of a joint at a key; InputError in words that follow the key if it has none."""
    if parts[2] == "friction":
        return joint.friction
    pressure = joint.pressure
    if len(parts) == 3:
        if isinstance(pressure, float | int):
            return pressure
        raise InputError(
            "the scene's pressure of this joint is not a number in Pa; give the joint's friction, "
            "or the force of all its bolts"
        )
    number = int(parts[4])
    if not isinstance(pressure, BoltPressureTable) or number >= len(pressure.bolts):
        raise InputError(f"the joint has no bolts[{number}] in its pressure")
    return pressure.bolts[number].force


def _other_bolts(joint: JointTable, name: str, number: int) -> Iterator[str]:
    """Keys of the other bolts in the pressure of a joint, for the key of one of them."""
    if len(key_parts(name) or ()) < 6 or not isinstance(joint.pressure, BoltPressureTable):
        return
    for k in range(len(joint.pressure.bolts)):
        other = f"joint[{number}].pressure.bolts[{k}].force"
        if other != name:
            yield other


def _with_value(joint: JointTable, parts: Location, value: float) -> JointTable:
    pressure = joint.pressure
    if parts[2] == "friction":
        return joint.model_copy(update={"friction": value})
    if isinstance(pressure, BoltPressureTable):
        bolts, number = [*pressure.bolts], int(parts[4])
        bolts[number] = bolts[number].model_copy(update={"force": value})
        return joint.model_copy(
            update={"pressure": pressure.model_copy(update={"bolts": tuple(bolts)})}
        )
    return joint.model_copy(update={"pressure": value})
