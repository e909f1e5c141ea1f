"""Output streams of a command that exist even if closed, and print no control characters."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import Any, TextIO
from unicodedata import category


def printable(text: str) -> str:
    r"""Text with escapes, such as \x1b, in place of characters that would control a terminal.

    These are control characters other than line ends and tabs, and marks that change the direction
    of writing or break lines.
    """
    if text.isprintable():
        return text
    # Unicode's control and format characters, line and paragraph separators.
    controls = ("Cc", "Cf", "Zl", "Zp")
    return "".join(
        c.encode("unicode_escape").decode() if c not in "\n\t" and category(c) in controls else c
        for c in text
    )


class Plain:
    """Wrapper of a ``stream`` that makes all text `printable`."""

    def __init__(self, stream: TextIO) -> None:
        self.stream = stream

    def write(self, text: str) -> int:
        """Write a text; returns its length."""
        self.stream.write(printable(text))
        return len(text)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.stream, name)


def unfiltered(stream: Any) -> TextIO:
    """Stream inside a `Plain` wrapper, for drawing on a terminal; other streams unchanged."""
    behind: TextIO = stream.stream if isinstance(stream, Plain) else stream
    return behind


@contextmanager
def plain_streams() -> Iterator[None]:
    """Make the output streams plain while the block runs.

    Characters that the terminal cannot show are escaped too. Streams that were closed when the
    process began discard their text.
    """
    _open_closed()
    before = sys.stdout, sys.stderr
    for stream in before:
        with suppress(AttributeError):  # not every stream has an encoding
            stream.reconfigure(errors="backslashreplace")  # type: ignore[union-attr]
    plain: Any = [Plain(stream) for stream in before]
    sys.stdout, sys.stderr = plain
    try:
        yield
    finally:
        sys.stdout, sys.stderr = before


def _open_closed() -> None:
    """Open closed streams on the null device, so that files do not take their numbers."""
    # In this order each takes the lowest number that is free, its own.
    for name, how in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, how, encoding="utf-8"))  # noqa: SIM115
