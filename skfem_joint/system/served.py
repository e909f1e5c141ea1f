"""What a reduced model serves that was made for a range, and the point of it that is computed.

Numbers alone: `skfem_joint.reduction.ranges` makes such models and takes points of them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from skfem_joint.ground.arrays import FloatArray
from skfem_joint.ground.errors import InputError, refuse
from skfem_joint.ground.values import POSITIVE, check

#: Lowest and highest value.
Interval = tuple[float, float]
#: Quantities whose errors are those of energies.
ENERGIES = "friction_energy", "loop_energy", "damping_ratio"


@dataclass(frozen=True)
class Range:
    """Loads and friction limits that one reduced model serves.

    Attributes
    ----------
    slip : tuple of float
        Lowest and highest share of the load that makes the first joint slip as a whole, at the
        frequency and the limits of the point; above 0 and below 1.
    frequency : tuple of float
        Lowest and highest frequency of the loads' common period, Hz.
    limits : dict of str to tuple of float
        Lowest and highest factor on the friction limits of a joint, by its name. Factors of
        friction and of pressure are alike. Limits of other joints stay as they are.
    """

    slip: Interval
    frequency: Interval
    limits: Mapping[str, Interval] = field(default_factory=dict)

    @staticmethod
    def of(given: Mapping[str, Any] | Range) -> Range:
        """Range from a mapping with the keys ``slip``, ``frequency`` and, if any, ``limits``.

        InputError for other keys, pairs that are none, and values out of range.
        """
        if isinstance(given, Range):
            return given
        if not isinstance(given, Mapping):
            raise InputError(
                f"range: found {given!r}, must be a mapping such as {{'slip': (0.1, 0.9), "
                "'frequency': (100.0, 900.0)}, or an sj.Range"
            )
        refuse(
            f"range: found {name!r}, must be 'slip', 'frequency' or 'limits'"
            for name in given
            if name not in ("slip", "frequency", "limits")
        )
        refuse(f"range: {key} is missing" for key in ("slip", "frequency") if key not in given)
        limits = given.get("limits", {})
        if not isinstance(limits, Mapping):
            raise InputError(
                f"range.limits: found {limits!r}, must be a pair of factors for each joint by name"
            )
        return Range(
            slip=_pair("slip", given["slip"], most=1.0),
            frequency=_pair("frequency", given["frequency"]),
            limits={str(name): _pair(f"limits.{name}", pair) for name, pair in limits.items()},
        )

    def of_joints(self, joints: Sequence[str]) -> list[Interval]:
        """Interval of the factor on the limits of each joint."""
        return [self.limits.get(name, (1.0, 1.0)) for name in joints]

    def __str__(self) -> str:
        """One line for users."""
        parts = [
            f"slip {_words(self.slip)} of what makes the first joint slip as a whole",
            f"{_words(self.frequency)} Hz",
            *(f"limits of {name} times {_words(pair)}" for name, pair in self.limits.items()),
        ]
        return ", ".join(parts)


@dataclass(frozen=True)
class Point:
    """A point of a range.

    Attributes
    ----------
    frequency : float
        Frequency of the loads' common period, Hz.
    level : float
        Factor on the loads of the system that the model was made of.
    limits : dict of str to float
        Factor on the friction limits of joints, by their names; 1 of others.
    slip : float, optional
        Share of the level at which the first joint slips as a whole; None where the point was
        taken by its level, and its run shows how much slips.
    preload : float
        Factor on all that presses the joints at rest.
    """

    frequency: float
    level: float = 1.0
    limits: Mapping[str, float] = field(default_factory=dict)
    slip: float | None = None
    preload: float = 1.0

    def factors(self, joints: Sequence[str]) -> FloatArray:
        """Factor on the limits of each joint, (joints,)."""
        return np.array([float(self.limits.get(name, 1.0)) for name in joints])

    def mean_factor(self, joints: Sequence[str]) -> float:
        """Geometric mean of these; 1 without joints."""
        return float(np.exp(np.log(self.factors(joints)).mean())) if joints else 1.0


@dataclass(frozen=True)
class Served:
    """What a reduced model for a range carries beside its matrices.

    Attributes
    ----------
    range : Range
    larger : System
        Model with more modes and friction points; a run of it shows the error of a run.
    factors, shared : dict of str to float
        By quantity, "history" and "energy": what the difference to the larger model is multiplied
        with, and the error that the larger one has too, as of elastic in place of rigid contact.
        They were found where the model was made, where the full system was at hand.
    accuracy : float
        Error of displacement histories that was asked for; three times that of energies.
    reached : float
        Largest error of displacement histories, or a third of that of energies if that is more, at
        the points at which the number of modes was judged.
    law : float
        Steepness of the reduced law, s/m, with the limits of the system; see
        `skfem_joint.reduction.ranges.points`.
    known : ndarray, shape (points, 2 + joints)
        Where the load that makes the first joint slip as a whole is known: frequency (Hz), factor
        on the limits of each joint of the system, and factor on the loads.
    point : Point, optional
        Where the model is; None for the model of the whole range.
    """

    range: Range
    larger: Any
    factors: Mapping[str, float]
    shared: Mapping[str, float]
    accuracy: float
    reached: float
    law: float
    known: FloatArray
    point: Point | None = None

    @staticmethod
    def by(system: Any) -> Served:
        """What a model for a range carries; InputError for any other system."""
        serves: Served | None = system.serves
        if serves is None:  # else each caller would have to say so
            raise InputError("range: found a model that serves no range")
        return serves

    def error(self, quantity: str, apart: float, times: float = 1.0) -> float:
        """Stated error of a quantity by its relative distance, ``apart``, from the larger model's.

        ``times`` is how many times as large, relative to an energy, is what the larger model has.
        """
        if quantity in ENERGIES:
            return self.factors["energy"] * apart + times * self.shared["energy"]
        return self.factors["history"] * apart + self.shared["history"]

    @property
    def shortfall(self) -> str | None:
        """Sentence about an accuracy that the model does not have; None if it has it."""
        if self.reached <= self.accuracy:
            return None
        return (
            f"The reduced model for the range was made for an accuracy of {self.accuracy:.2%} and "
            f"errs by {self.reached:.2%} at the worst of the points at which it was judged; give "
            "more modes than it took, or a smaller range"
        )

    def __str__(self) -> str:
        """One line for users."""
        return str(self.range)


def _pair(key: str, pair: Any, most: float | None = None) -> Interval:
    try:
        low, high = pair
    except (TypeError, ValueError) as error:
        raise InputError(
            f"range.{key}: found {pair!r}, must be two numbers, the lowest and the highest"
        ) from error
    check(f"range.{key}", low, POSITIVE)
    check(f"range.{key}", high, POSITIVE)
    if high < low or (most is not None and high >= most):
        below = "" if most is None else f" below {most:g}"
        raise InputError(
            f"range.{key}: found ({low:g}, {high:g}), must be the lowest and the highest value"
            f"{below}"
        )
    return float(low), float(high)


def _words(pair: Interval) -> str:
    return f"{pair[0]:.6g} to {pair[1]:.6g}"
