"""Files that are either whole or not there."""

from __future__ import annotations

import os
import re
import stat
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from skfem_joint.errors import InputError

#: Start of the name of a file that is not whole yet; only a process that is killed leaves one.
_UNFINISHED = ".unfinished-"

#: Largest file that is read as input, bytes: a bar of a few million elements.
LARGEST = 2**29


def safe_name(name: str) -> str:
    """Name of a mesh group as part of a file name."""
    return re.sub(r"[^\w.-]", "_", name)


def read_whole(path: Path, most: int = LARGEST) -> bytes:
    """Content of a file that may be read as input: a regular one of at most ``most`` bytes.

    A scene may name files outside its folder, such as a mesh beside it: they are read and parsed
    as data, never run or written. Devices and pipes, which may never end, are not read.

    Raises
    ------
    InputError
        If it is no such file.
    """
    try:
        status = path.stat()
        if not stat.S_ISREG(status.st_mode):
            raise InputError(f"{path}: cannot be read: not a file")
        if status.st_size > most:
            raise InputError(
                f"{path}: cannot be read: found {status.st_size} bytes, must be at most {most}"
            )
        return path.read_bytes()
    except (OSError, ValueError) as error:  # a name that cannot be one is a ValueError
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise InputError(f"{path}: cannot be read: {reason}") from error


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
