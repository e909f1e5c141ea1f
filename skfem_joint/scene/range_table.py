"""The key ``reduction.range`` of a scene: loads and friction limits that one reduced model serves.

Keys of joints are given as values of the scene, as those of a sweep are. A reduced model takes
factors on the limits of whole joints in their place: the product of value over geometric mean of
the interval, over all keys of a joint. Only keys that change all limits of a joint alike have such
a factor.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated, Any, NamedTuple, Self

from pydantic import AfterValidator, ConfigDict, Field, model_validator

from skfem_joint.ground.errors import InputError
from skfem_joint.ground.key_paths import key_parts, key_path
from skfem_joint.scene.joint_tables import BoltPressureTable, JointTable
from skfem_joint.scene.messages import mistake
from skfem_joint.scene.values import Positive, SceneTable, TomlList, key
from skfem_joint.system.served import Interval

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


class _Key(NamedTuple):
    """What a key changes: friction or pressure of a joint, or the force of one of its bolts."""

    joint: int
    kind: str
    bolt: int | None = None

    @classmethod
    def of(cls, name: str) -> _Key | None:
        """Key by its name; None for one that does not change all limits of a joint by a factor."""
        match key_parts(name):
            case ("joint", int() as number, "friction" | "pressure" as kind):
                return cls(number, kind)
            case ("joint", int() as number, "pressure", "bolts", int() as bolt, "force"):
                return cls(number, "pressure", bolt)
        return None

    def value(self, joint: JointTable) -> float:
        """Value of its joint; InputError in words that follow the key if that has none."""
        pressure = joint.pressure
        if self.kind == "friction":
            return joint.friction
        if self.bolt is None and isinstance(pressure, float | int):
            return pressure
        bolts = pressure.bolts if isinstance(pressure, BoltPressureTable) else ()
        if self.bolt is not None and self.bolt < len(bolts):
            return bolts[self.bolt].force
        what = "number in Pa as" if self.bolt is None else f"bolts[{self.bolt}] in"
        raise InputError(
            f"the joint has no {what} its pressure; give its friction, its pressure where that is "
            "a number, or the force of all its bolts"
        )


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
            if _Key.of(name) is None:
                why = (
                    "; clamping bolts may open a joint as they press it, so that its limits have "
                    "no common factor: give the friction of the joint"
                    if name.startswith("bolt[")
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

    def _keys(self) -> Iterator[tuple[str, _Key]]:
        """Names and keys of the values."""
        for name in self.values():
            changed = _Key.of(name)
            if changed is not None:  # others were refused
                yield name, changed

    def problems(self, joints: Sequence[JointTable]) -> Iterator[str]:
        """What is wrong with the keys for these joints of a scene."""
        for name, changed in self._keys():
            problem = self._problem(name, changed, joints)
            if problem:
                yield f"reduction.{key_path(('range', name))}: {problem}"

    def _problem(self, name: str, changed: _Key, joints: Sequence[JointTable]) -> str:
        """What is wrong with a key; empty if nothing is."""
        if changed.joint >= len(joints):
            return f"the scene has no joint[{changed.joint}]"
        joint = joints[changed.joint]
        if joint.contact == "unilateral" and changed.kind != "friction":
            return (
                "found beside contact = 'unilateral', whose points open at other loads as they are "
                "pressed otherwise: pressure is no factor on friction limits. All pressures at "
                "once only rescale the loads: give the amplitudes over that factor, or the "
                "friction of the joint"
            )
        try:
            value = changed.value(joint)
        except InputError as error:
            return str(error)
        if not value > 0.0:
            return f"found {value:g} in the scene, must be > 0 to be changed by factors"
        low, high = self.values()[name]
        bolts = joint.pressure.bolts if isinstance(joint.pressure, BoltPressureTable) else ()
        for k in range(len(bolts) if changed.bolt is not None else 0):
            other = f"joint[{changed.joint}].pressure.bolts[{k}].force"
            pair = self.values().get(other)
            if pair is None or abs(pair[1] / pair[0] / (high / low) - 1.0) > _ALIKE:
                return (
                    f"found without {key_path(('range', other))} of the same ratio; the force of "
                    "one bolt of several changes a part of the joint's limits. Give all bolts of "
                    "the joint, or its friction"
                )
        return ""

    def middle(self) -> dict[str, float]:
        """Geometric mean of the interval of each key: all factors are 1 there."""
        return {name: math.sqrt(low * high) for name, (low, high) in self.values().items()}

    def limits(self, joints: Sequence[JointTable]) -> dict[str, Interval]:
        """Lowest and highest factor on the limits of each joint, by its name."""
        ends = ({name: pair[k] for name, pair in self.values().items()} for k in (0, 1))
        low, high = (self._factors(joints, values) for values in ends)
        return {name: (low[name], high[name]) for name in low}

    def factors(self, joints: Sequence[JointTable]) -> dict[str, float]:
        """Factor on the limits of each joint that the values of these joints mean, by its name.

        Raises
        ------
        InputError
            If bolts of a joint have other factors than each other.
        """
        return self._factors(joints, {name: k.value(joints[k.joint]) for name, k in self._keys()})

    def _factors(
        self, joints: Sequence[JointTable], values: Mapping[str, float]
    ) -> dict[str, float]:
        """Factor on the limits of each joint with some values of the keys, by its name."""
        found: dict[str, dict[str, float]] = {}
        middle = self.middle()
        for name, changed in self._keys():
            on, factor = joints[changed.joint].on, values[name] / middle[name]
            # Bolts of a joint have one factor in common.
            earlier = found.setdefault(on, {}).setdefault(changed.kind, factor)
            if abs(earlier - factor) > _ALIKE * factor:
                raise InputError(
                    f"{name}: bolts of the joint {on!r} differ from the range by other factors "
                    "than each other"
                )
        return {joint: math.prod(of.values()) for joint, of in found.items()}
