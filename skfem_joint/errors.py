"""Errors of the package: each speaks to the user and carries the command's exit status."""

from __future__ import annotations

from typing import Any


class JointError(Exception):
    """Base of all errors raised on purpose by this package.

    Attributes
    ----------
    exit_status : int
        Status with which the command line ends when the error reaches it.
    results : Any
        Results of what was done before, if there are any.
    """

    exit_status = 1
    results: Any = None


class InputError(JointError):
    """Something the user supplied is wrong: the message says what, where, and what is allowed.

    Parameters
    ----------
    problems : str or list of str
        One sentence per mistake; all mistakes found are reported at once.
    """

    exit_status = 2

    def __init__(self, problems: str | list[str]) -> None:
        self.problems = [problems] if isinstance(problems, str) else list(problems)
        super().__init__("\n".join(self.problems))


class ConvergenceError(JointError):
    """An iteration did not converge; nothing was returned as if it had.

    Parameters
    ----------
    message : str
        Where it happened, how far it got, and what to try.
    unknown : int, optional
        Unknown with the largest residual.
    """

    exit_status = 3

    def __init__(self, message: str, unknown: int | None = None) -> None:
        self.unknown = unknown
        super().__init__(message)
