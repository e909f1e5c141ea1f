"""Errors of the package: each speaks to the user and carries the command's exit status."""

from __future__ import annotations

import difflib
from collections.abc import Iterable
from typing import Any

#: Names that a sentence lists or compares another one with.
MOST_LISTED = 200


class JointError(Exception):
    """Base of all errors raised on purpose by this package."""

    exit_status = 1  #: status with which the command line ends when the error reaches it


class InputError(JointError):
    """Something the user supplied is wrong: the message says what, where, and what is allowed.

    ``problems`` is one sentence per mistake, a str or a list: all that are found are reported.
    """

    exit_status = 2

    def __init__(self, problems: str | list[str]) -> None:
        self.problems = [problems] if isinstance(problems, str) else list(problems)
        super().__init__("\n".join(self.problems))


def refuse(problems: Iterable[str]) -> None:
    """Raise InputError with all problems, if there are any."""
    if found := [*problems]:
        raise InputError(found)


class ConvergenceError(JointError):
    """An iteration did not converge; nothing was returned as if it had.

    The message says where, how far it got, and what to try; ``unknown`` is the number of the
    unknown with the largest residual, if there is one.
    """

    exit_status = 3

    def __init__(self, message: str, unknown: int | None = None) -> None:
        self.unknown = unknown
        super().__init__(message)


def listed(names: Any) -> str:
    """Names in quotes, in order; the first of very many."""
    shown, more = sorted(names)[:MOST_LISTED], len(names) - MOST_LISTED
    text = ", ".join(f"'{name}'" for name in shown) or "none"
    return text + (f" and {more} more" if more > 0 else "")


def closest(word: str, words: Any) -> str:
    """Ask whether another word was meant, if one is close enough."""
    lower = {other.lower(): other for other in words}
    if len(lower) > MOST_LISTED:  # takes time with their number
        return ""
    match = difflib.get_close_matches(word.lower(), lower, n=1)
    return f"; did you mean '{lower[match[0]]}'?" if match else ""
