"""Output streams of a command: there where they were closed, and plain whatever names hold."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any, TextIO
from unicodedata import category

# Categories of Unicode: control and format characters, line and paragraph separators.
_OBEYED = ("Cc", "Cf", "Zl", "Zp")


def printable(text: str) -> str:
    r"""Text in which characters that a terminal would obey are written as escapes, such as \x1b.

    These are control characters but for line ends and tabs, and marks that change the direction of
    writing or break lines.
    """
    if text.isprintable():
        return text
    return "".join(
        c.encode("unicode_escape").decode() if c not in "\n\t" and category(c) in _OBEYED else c
        for c in text
    )


class Plain:
    """Stream that writes `printable` text; ``stream`` is the one that it writes to."""

    def __init__(self, stream: TextIO) -> None:
        self.stream = stream

    def write(self, text: str) -> int:
        """Write a text; returns its length."""
        self.stream.write(printable(text))
        return len(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.stream, name)


def unfiltered(stream: Any) -> TextIO:
    """The stream behind a `Plain` one, for what draws on a terminal; others as they are."""
    behind: TextIO = stream.stream if isinstance(stream, Plain) else stream
    return behind


@contextmanager
def plain_streams() -> Iterator[None]:
    """Make the output streams plain while the block runs.

    What a terminal cannot show is written as escapes too. Streams that were closed when the process
    began lead nowhere.
    """
    _open_closed()
    before = sys.stdout, sys.stderr
    for stream in before:
        with suppress(AttributeError):  # a stream that is not a terminal's may have no encoding
            stream.reconfigure(errors="backslashreplace")  # type: ignore[union-attr]
    plain: Any = [Plain(stream) for stream in before]
    sys.stdout, sys.stderr = plain
    try:
        yield
    finally:
        sys.stdout, sys.stderr = before


def _open_closed() -> None:
    """Open streams that are closed to nowhere, lest files that are opened take their numbers."""
    for number, name in enumerate(("stdin", "stdout", "stderr")):
        if getattr(sys, name) is None:
            try:
                os.fstat(number)
            except OSError:
                nowhere = os.open(os.devnull, os.O_RDWR)
                if nowhere != number:
                    os.dup2(nowhere, number)
                    os.close(nowhere)
                os.set_inheritable(number, True)
            how = "r" if number == 0 else "w"
            setattr(sys, name, open(os.devnull, how, encoding="utf-8"))  # noqa: SIM115
