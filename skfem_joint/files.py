"""Files that are either whole or not there."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from skfem_joint.errors import InputError

#: Start of the name of a file that is not whole yet; only a process that is killed leaves one.
_UNFINISHED = ".unfinished-"


def safe_name(name: str) -> str:
    """Name of a mesh group as part of a file name."""
    return re.sub(r"[^\w.-]", "_", name)


def remove_unfinished(folder: Path) -> None:
    """Remove what processes that were killed left of files they had begun."""
    for path in folder.rglob(f"{_UNFINISHED}*"):
        with suppress(OSError):
            path.unlink()


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Empty file beside ``path`` that takes its place when the block ends without an error.

    Raises
    ------
    InputError
        If it cannot be written.
    """
    temporary = path.with_name(f"{_UNFINISHED}{os.getpid()}-{path.name}")
    try:
        temporary.write_bytes(b"")
        yield temporary
        os.replace(temporary, path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from error
    finally:
        with suppress(OSError):
            temporary.unlink()
