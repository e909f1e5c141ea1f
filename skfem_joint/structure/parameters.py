"""Numbers of a structure by their keys, those that scenes and sweeps have.

A key leads to one number, ``"joint[0].friction"``, or with ``[*]`` to one value that all entries
of a list share, ``"bolt[*].force"``; entries that do not have such a number do not count, as
joints pressed by bolts for ``"joint[*].pressure"``. `value_of` reads it, `with_values` makes a
structure with others, `skfem_joint.structure.sensitivities` derives by it.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any

from skfem_joint.ground.errors import MOST_LISTED, InputError, closest, refuse
from skfem_joint.ground.key_paths import EVERY, Location, key_parts, key_path
from skfem_joint.joint.pressure import Bolts
from skfem_joint.structure.structure import Structure

#: Damping by the key of a scene.
DAMPING = {
    "ratio": "damping_ratio",
    "stiffness": "stiffness_damping",
    "mass": "mass_damping",
}
#: Stiffness of surfaces, which may be infinite.
SPRINGS = ("tangential_stiffness", "normal_stiffness")


@dataclass(frozen=True)
class Parameter:
    """A number of a structure, or several that have one value.

    Attributes
    ----------
    name : str
        Key, such as "bolt[*].force".
    places : tuple
        Parts of the key of each number.
    """

    name: str
    places: tuple[Location, ...]


def parameter(structure: Structure, key: str) -> Parameter:
    """The numbers that a key leads to.

    Parameters
    ----------
    structure : Structure
    key : str

    Raises
    ------
    InputError
        For keys that do not lead to a number that can be varied; the message says which do.
    """
    found = dict(_numbers(structure))
    parts = key_parts(str(key), every=True)
    places = tuple(place for place in found if parts is not None and _fits(place, parts))
    if not places:
        raise InputError(f"{key}: {_why_not(structure, key, parts)}")
    return Parameter(key, places)


def value_of(structure: Structure, key: str) -> float:
    """Value of a key.

    Parameters
    ----------
    structure : Structure
    key : str
        As in a sweep, "joint[0].friction", or with "[*]" for all entries of a list.

    Returns
    -------
    float
        In the unit of the key.

    Raises
    ------
    InputError
        For keys that cannot be varied, see `with_values`, and where entries under "[*]" differ.
    """
    found = dict(_numbers(structure))
    values = {key_path(place): found[place] for place in parameter(structure, key).places}
    first = next(iter(values.values()))
    if any(value != first for value in values.values()):
        each = ", ".join(f"{path} = {value:g}" for path, value in values.items())
        raise InputError(f"{key}: found different values, {each}; must be the same in all of them")
    return first


def with_values(structure: Structure, values: Mapping[str, float]) -> Structure:
    """Structure with other values of keys.

    What they do not change is taken over: the matrices where no modulus changes, and the preload
    where no modulus and no clamp force does.

    Parameters
    ----------
    structure : Structure
    values : mapping
        Values by key: friction, pressure, tangential_stiffness, normal_stiffness and gap_scale of
        ``joint[i]``, and ``joint[i].pressure.bolts[k].force`` of bolts that are a pressure;
        ``bolt[k].force``; ``material.E`` and ``material.regions.NAME.E``; ``damping.ratio``,
        ``damping.stiffness`` and ``damping.mass``.

    Raises
    ------
    InputError
        For other keys, and for values that the structure refuses.
    """
    new: dict[str, Any] = {}
    joints, bolts, regions = [*structure.joints], [*structure.bolts], dict(structure.regions)
    for place, value in _placed(structure, values).items():
        match place:
            case ("joint", int(i), str(name)):
                changed: dict[str, Any] = {name: value}
                joints[i] = replace(joints[i], **changed)
            case ("joint", int(i), "pressure", "bolts", int(k), "force"):
                pressure: Any = joints[i].pressure
                own = [*pressure.bolts]
                own[k] = replace(own[k], force=value)
                joints[i] = replace(joints[i], pressure=replace(pressure, bolts=tuple(own)))
            case ("bolt", int(i), "force"):
                bolts[i] = replace(bolts[i], force=value)
            case ("material", "E"):
                new["material"] = replace(structure.material, E=value)
            case ("material", "regions", str(region), "E"):
                regions[region] = {**regions[region], "E": value}
            case ("damping", str(name)):
                new[DAMPING[name]] = value
    return replace(structure, joints=joints, bolts=bolts, regions=regions, like=structure, **new)


def single_values(structure: Structure, values: Mapping[str, float]) -> dict[str, float]:
    """Values by keys that lead to one number each, as scenes take them.

    Parameters
    ----------
    structure : Structure
    values : mapping
        Values by key; one with "[*]" becomes one of each entry.

    Raises
    ------
    InputError
        For keys that cannot be varied.
    """
    return {key_path(place): value for place, value in _placed(structure, values).items()}


def _placed(structure: Structure, values: Mapping[str, float]) -> dict[Location, float]:
    """Values by the places to which their keys lead."""
    return {
        place: float(value)
        for key, value in values.items()
        for place in parameter(structure, key).places
    }


def check_derivable(structure: Structure, wanted: Sequence[Parameter]) -> None:
    """Refuse parameters by which nothing can be derived at their present value.

    Raises
    ------
    InputError
        For a pressure or force of zero, at which contact begins, and an infinite stiffness.
    """
    found = dict(_numbers(structure))
    refuse(
        f"{key_path(place)}: {problem}"
        for one in wanted
        for place in one.places
        if (problem := _not_derivable(place, found[place]))
    )


def _not_derivable(place: Location, value: float) -> str:
    """Why nothing can be derived by a number; empty if it can."""
    last = place[-1]
    if last in SPRINGS and value == float("inf"):
        return "found none, which is rigid; give it a finite value to start from"
    if place[0] == "joint" and last in ("pressure", "force") and value == 0.0:
        return "found 0, at which contact begins; give it a positive value to start from"
    return ""


def _numbers(structure: Structure) -> Iterator[tuple[Location, float]]:
    """Numbers that can be varied, by their places."""
    for i, joint in enumerate(structure.joints):
        yield ("joint", i, "friction"), float(joint.friction)
        if isinstance(joint.pressure, int | float):
            yield ("joint", i, "pressure"), float(joint.pressure)
        elif isinstance(joint.pressure, Bolts):
            for k, bolt in enumerate(joint.pressure.bolts):
                yield ("joint", i, "pressure", "bolts", k, "force"), float(bolt.force)
        yield ("joint", i, "tangential_stiffness"), float(joint.tangential_stiffness)
        if joint.opens:
            yield ("joint", i, "normal_stiffness"), float(joint.normal_stiffness)
        if joint.has_gap:
            yield ("joint", i, "gap_scale"), float(joint.gap_scale)
    for i, clamp in enumerate(structure.bolts):
        yield ("bolt", i, "force"), float(clamp.force)
    yield ("material", "E"), float(structure.material.E)
    for region, values in structure.regions.items():
        if "E" in values:
            yield ("material", "regions", region, "E"), float(values["E"])
    for name, attribute in DAMPING.items():
        value = getattr(structure, attribute)
        if value is not None and (name == "ratio" or structure.damping_ratio is None):
            yield ("damping", name), float(value)


def _fits(place: Location, parts: Location) -> bool:
    """Whether the parts of a key, in which `EVERY` stands for all positions, lead to a place."""
    return len(place) == len(parts) and all(
        a == b or (b == EVERY and isinstance(a, int)) for a, b in zip(place, parts, strict=True)
    )


def _why_not(structure: Structure, key: str, parts: Location | None) -> str:
    """Why a key does not lead to a number that can be varied, and which keys do."""
    match parts:
        case ("joint", int(i), "pressure") if 0 <= i < len(structure.joints):
            pressure = structure.joints[i].pressure
            if pressure == "preload":
                return "found 'preload', must be a number; vary bolt[*].force in its place"
            if isinstance(pressure, Bolts):
                return f"found bolts, must be a number; vary {key}.bolts[*].force in its place"
            return "found a table, must be a number; a table of pressures cannot be varied"
        case ("joint", int(i), "normal_stiffness") if 0 <= i < len(structure.joints):
            return "needs a joint with contact = 'unilateral'"
        case ("joint", int(i), "gap_scale") if 0 <= i < len(structure.joints):
            return "needs a joint with a gap"
        case ("damping", "ratio"):
            return "found none; give it a value to start from"
        case ("damping", "stiffness" | "mass"):
            return "found damping.ratio, which makes the damping by itself; vary the ratio"
    keys = [key_path(place) for place in _by_list(structure)]
    shown = ", ".join(islice(keys, MOST_LISTED))
    return f"it is no number that can be varied{closest(str(key), keys)}; these are: {shown}"


def _by_list(structure: Structure) -> Iterator[Location]:
    """Places of all numbers that can be varied, and those with ``[*]`` for lists of several."""
    places = [place for place, _ in _numbers(structure)]
    yield from places
    several = [
        tuple(EVERY if isinstance(part, int) else part for part in place) for place in places
    ]
    yield from dict.fromkeys(place for place in several if several.count(place) > 1)
