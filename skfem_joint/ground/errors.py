"""Errors of the package, with messages for users and the exit status of the command."""

from __future__ import annotations

import difflib
from collections.abc import Iterable, Sequence
from typing import Any

#: Most names that a message lists, or among which it searches for a similar name.
MOST_LISTED = 200


class JointError(Exception):
    """Base of all errors that this package raises.

    Attributes
    ----------
    exit_status : int
        Status with which the command line ends when the error reaches it.
    """

    exit_status = 1


class InputError(JointError):
    """Wrong input of a user: the message states what is wrong, where, and what is allowed.

    Attributes
    ----------
    problems : list of str
        A sentence for each mistake, so that all mistakes are reported together.
    exit_status : int
        2, with which the command line ends.
    """

    exit_status = 2

    def __init__(self, problems: str | list[str]) -> None:
        self.problems = [problems] if isinstance(problems, str) else list(problems)
        super().__init__("\n".join(self.problems))


def refuse(problems: Iterable[str]) -> None:
    """Raise InputError with all problems, if there are any."""
    if sentences := [*problems]:
        raise InputError(sentences)


class ConvergenceError(JointError):
    """An iteration did not converge, and no result is returned.

    The message states where, how far the iteration came, and what to try.

    Attributes
    ----------
    message : str
        As it is printed; ``str(error)`` in an error that was caught.
    unknown : int, optional
        Number of the unknown with the largest residual, if it is known.
    run : Run, optional
        What was reached before, of a quasi-static run whose loads exceed what friction holds.
    exit_status : int
        3, with which the command line ends.
    """

    exit_status = 3

    def __init__(self, message: str, unknown: int | None = None, run: Any = None) -> None:
        self.unknown, self.run = unknown, run
        super().__init__(message)


class GrossSlipError(ConvergenceError):
    """A joint slips as a whole, and there is no result for that.

    Attributes
    ----------
    periods : int
        Periods after which a search for steady vibration was given up; 0 where none was.
    """

    def __init__(self, message: str, periods: int = 0) -> None:
        self.periods = periods
        super().__init__(message)


def listed(names: Any) -> str:
    """Sorted names in quotes; of very many only the first ones."""
    shown, more = sorted(names)[:MOST_LISTED], len(names) - MOST_LISTED
    text = ", ".join(f"'{name}'" for name in shown) or "none"
    return text + (f" and {more} more" if more > 0 else "")


def first_of(texts: Sequence[str], most: int = 4) -> str:
    """First texts of a list, and how many more there are."""
    more = [f"{len(texts) - most} more"] if len(texts) > most else []
    return ", ".join([*texts[:most], *more]) or "none"


def closest(word: str, words: Any) -> str:
    """Question whether a similar word was meant; empty if no word is similar."""
    lower = {other.lower(): other for other in words}
    if len(lower) > MOST_LISTED:  # the search would take long
        return ""
    match = difflib.get_close_matches(word.lower(), lower, n=1)
    return f"; did you mean '{lower[match[0]]}'?" if match else ""
