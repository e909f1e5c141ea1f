"""Files that are either whole or not there."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from skfem_joint.errors import InputError


def safe_name(name: str) -> str:
    """Name of a mesh group as part of a file name."""
    return re.sub(r"[^\w.-]", "_", name)


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Empty file beside ``path`` that takes its place when the block ends without an error.

    Raises
    ------
    InputError
        If it cannot be written.
    """
    temporary = path.with_name(f".{os.getpid()}-{path.name}")
    try:
        temporary.write_bytes(b"")
        yield temporary
        os.replace(temporary, path)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from error
    finally:
        with suppress(OSError):
            temporary.unlink()
