"""Checks of numbers that users give: their type and their range.

They are for calls from Python; pydantic checks the tables of a scene. (It takes a tenth of a second
to import, and refuses the whole numbers of numpy.)
"""

from __future__ import annotations

import math
import sys
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from numbers import Integral, Real
from types import UnionType
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skfem_joint.ground.errors import InputError, refuse


@dataclass(frozen=True)
class Kind:
    """Kind of numbers that a value may be.

    Attributes
    ----------
    words : str
        Description for messages, after "must be".
    holds : callable
        Whether a number is in range; false for nan.
    whole : bool
        Whether only whole numbers are allowed.
    """

    words: str
    holds: Callable[[float], bool]
    whole: bool = False

    def __contains__(self, value: object) -> bool:
        if isinstance(value, np.ndarray) and value.ndim == 0:
            value = value.item()
        if isinstance(value, bool) or not isinstance(value, Integral if self.whole else Real):
            return False
        try:
            return bool(self.holds(float(value)))
        except OverflowError:  # a whole number beyond all floats
            return False


#: Kinds of numbers; all but a beta and a stiffness must be finite.
FINITE = Kind("a finite number", math.isfinite)
POSITIVE = Kind("> 0 and finite", lambda x: 0.0 < x < math.inf)
NOT_NEGATIVE = Kind(">= 0 and finite", lambda x: 0.0 <= x < math.inf)
BETA = Kind("> 0 (inf is Coulomb's law)", lambda x: x > 0.0)
STIFFNESS = Kind("> 0 (inf is rigid)", lambda x: x > 0.0)
POISSON = Kind("between -1 and 0.5", lambda x: -1.0 < x < 0.5)
#: Whole numbers.
COUNT = Kind(">= 1, a whole number", lambda x: x >= 1.0, whole=True)
WHOLE = Kind(">= 0, a whole number", lambda x: x >= 0.0, whole=True)


def between(low: float, high: float, why: str = "") -> Kind:
    """Kind of numbers from ``low`` to ``high``."""
    return Kind(f"from {low:g} to {high:g}{why}", lambda x: low <= x <= high)


def at_least(count: int, why: str = "") -> Kind:
    """Kind of whole numbers from ``count`` on."""
    return Kind(f">= {count}, a whole number{why}", lambda x: x >= count, whole=True)


def problems(where: str, value: Any, kind: Kind, *words: str) -> Iterator[str]:
    """Sentence about a value that is neither of the kind nor one of the words, if it is wrong."""
    if isinstance(value, str) and value in words:
        return
    if value not in kind:
        others = "".join(f"{word!r}, or " for word in words)
        yield f"{where}: found {_shown(value)}, must be {others}{kind.words}"


def _shown(value: Any) -> str:
    """Text of a value for a message, of at most sixty characters."""
    if isinstance(value, int) and value.bit_length() > sys.float_info.max_exp:
        return "a whole number beyond all floats"
    shown = f"{value}" if isinstance(value, Real) else repr(value)
    return shown if len(shown) <= 60 else f"{shown[:57]}..."


def check(where: str, value: Any, kind: Kind, *words: str) -> None:
    """Raise InputError with the sentence of :func:`problems`, if there is one."""
    refuse(problems(where, value, kind, *words))


def check_some(kind: Kind, **values: Any) -> None:
    """Raise InputError with a sentence for each wrong value; None passes."""
    refuse(
        problem
        for where, value in values.items()
        if value is not None
        for problem in problems(where, value, kind)
    )


def check_each(where: str, values: Any, kind: Kind) -> None:
    """Raise InputError for the first value that is not of a kind, or if there are no values.

    ``values`` may be any sequence or array of one dimension.
    """
    try:
        entries = list(values)
    except TypeError:
        entries = []
    if not entries or isinstance(values, str):
        raise InputError(f"{where}: found {values!r}, must be a list of numbers, each {kind.words}")
    for number, value in enumerate(entries):
        check(f"{where}[{number}]", value, kind)


def rising(where: str, values: Any, kind: Kind = POSITIVE) -> NDArray[np.float64]:
    """Array of numbers that rise, each of a kind; InputError for others, as `check_each`."""
    check_each(where, values, kind)
    found = np.asarray(values, dtype=float)
    refuse(_falls(where, found)[:1])
    return found


def _falls(where: str, x: NDArray[np.float64]) -> list[str]:
    """Sentences about entries that are no larger than the one before."""
    return [
        f"{where}[{k + 1}]: found {x[k + 1]:g}, must be > {x[k]:g}, the one before"
        for k in np.flatnonzero(~(np.diff(x) > 0.0))
    ]


def several(where: str, given: Any, kind: type | UnionType = object) -> tuple[Any, ...]:
    """Tuple of what is given as a list, each of a kind.

    InputError for one of it, such as a name, in its place, and for others than of the kind.
    """
    if isinstance(given, str) or not isinstance(given, Iterable):
        one = repr(given) if isinstance(given, str) else f"one {type(given).__name__}"
        raise InputError(f"{where}: found {one}, must be a list, also of a single one")
    found = tuple(given)
    for each in found:
        check_kind(where, each, kind)
    return found


def check_kind(where: str, value: Any, kind: type | UnionType) -> None:
    """Raise InputError unless a value is of a kind."""
    if not isinstance(value, kind):
        raise InputError(
            f"{where}: found {type(value).__name__}, must be a {getattr(kind, '__name__', kind)}"
        )


def check_numbers(where: str, values: Any) -> None:
    """Raise InputError unless values are whole numbers from 1, each there once."""
    check_each(where, values, COUNT)
    if len(set(values)) < len(values):
        raise InputError(f"{where}: found {[*map(int, values)]}, each must be there once")


def check_columns(
    where: str, first: str, second: str, x: Any, y: Any, least: float = -np.inf
) -> None:
    """Raise InputError unless two arrays are columns of finite numbers, of which the first rises.

    Parameters
    ----------
    where, first, second : str
        What messages call the table and its columns.
    x, y : ndarray
        The columns.
    least : float
        Numbers must be above this one.
    """
    if x.ndim != 1 or x.shape != y.shape or x.size < 2:
        count = [column.size if column.ndim == 1 else column.shape for column in (x, y)]
        raise InputError(
            f"{where}{first}: found {count[0]} {first} and {count[1]} {second}, must be two "
            "columns of one length, at least 2"
        )
    kind = FINITE if least < 0.0 else POSITIVE
    wrong = [
        problem
        for name, column in ((first, x), (second, y))
        for k in np.flatnonzero(~(np.isfinite(column) & (column > least)))
        for problem in problems(f"{where}{name}[{k}]", float(column[k]), kind)
    ]
    wrong += _falls(f"{where}{first}", x)
    more = [f"{where}and {len(wrong) - 10} more mistakes like these"] if len(wrong) > 10 else []
    refuse(wrong[:10] + more)
