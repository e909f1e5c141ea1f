"""Files that are written whole or not at all, and folders with a single writer at a time."""

from __future__ import annotations

import errno
import os
import re
import secrets
import stat
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from importlib import import_module
from pathlib import Path
from typing import Any

from skfem_joint.ground.errors import InputError

# An unfinished file is called ".unfinished-TOKEN", with the ending of the file.
_UNFINISHED = re.compile(r"\.unfinished-[0-9a-f]{16}(?![0-9a-f]).*")
_LOCK = ".skfem-joint-running"
# Called with a finished file and the path to which it will be moved.
_recorder: ContextVar[Callable[[Path, Path], None]] = ContextVar(
    "recorder", default=lambda temporary, path: None
)

#: Largest file that is read as input, bytes: a bar of a few million elements.
LARGEST = 2**29
#: Largest table of text, bytes: some hundred thousand rows, which are read in seconds.
LARGEST_TABLE = 2**25
#: Characters of a name of a mesh group in the names of files.
LONGEST_NAME = 50
#: Note about a text file that may be cut inside its last number.
UNFINISHED_LINE = (
    "the last line does not end, so that the file may be cut; add a line end if it is whole"
)


def safe_name(name: str) -> str:
    """Name of a mesh group as part of a file name, which file systems end at 255 bytes."""
    return re.sub(r"[^\w.-]", "_", name)[:LONGEST_NAME]


def safe_names(names: Iterable[str]) -> list[str]:
    """Names of mesh groups as parts of file names, with numbers where they would be the same."""
    taken: dict[str, str] = {}  # by what file systems without capitals see
    for name in names:
        plain = safe = safe_name(name)
        number = 1
        while safe.casefold() in taken:
            number += 1
            safe = f"{plain}_{number}"
        taken[safe.casefold()] = safe
    return list(taken.values())


def read_whole(path: Path, most: int = LARGEST) -> bytes:
    """Content of a regular file of at most ``most`` bytes; InputError for any other.

    A scene may name files outside its folder, such as a mesh beside it: they are read and parsed
    as data, never run or written. Devices and pipes, which may never end, are not read.
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
    except (OSError, ValueError) as error:  # ValueError: the name is impossible
        reason = error.strerror if isinstance(error, OSError) else str(error)
        raise InputError(f"{path}: cannot be read: {reason}") from error


def read_text(path: Path, most: int = LARGEST) -> str:
    """UTF-8 text of a regular file; InputError with the line that is not UTF-8."""
    try:
        return read_whole(path, most).decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = error.object[: error.start].count(b"\n") + 1
        raise InputError(f"{path}: line {line}: not UTF-8 text; save it as UTF-8") from error


def _remove_unfinished(folder: Path) -> None:
    """Remove unfinished files of dead processes from a locked folder and its direct subfolders."""
    for path in [*folder.glob(".unfinished-*"), *folder.glob("*/.unfinished-*")]:
        below = path.parent
        others = below != folder and (below.is_symlink() or (below / _LOCK).exists())
        if _UNFINISHED.fullmatch(path.name) and not others:
            with suppress(OSError):
                path.unlink()


@contextmanager
def recording(take: Callable[[Path, Path], None]) -> Iterator[None]:
    """Call ``take`` with each file that `replacing` writes in the block, before it is moved.

    Its arguments are the finished file and the path to which it will be moved. If it raises, what
    is at that path stays.
    """
    before = _recorder.set(take)
    try:
        yield
    finally:
        _recorder.reset(before)


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Empty file beside ``path`` that replaces it when the block ends without an error.

    The content is on the disk before the file is renamed, and the new name afterwards: a loss of
    power leaves the old file or the new file. InputError if it cannot be written.
    """
    temporary = path.with_name(f".unfinished-{secrets.token_hex(8)}{path.suffix}")
    try:
        temporary.write_bytes(b"")
        yield temporary
        _flush(temporary, os.O_RDWR)
        _recorder.get()(temporary, path)
        os.replace(temporary, path)
        if sys.platform != "win32":  # which opens no folders
            _flush(path.parent, os.O_RDONLY)
    except OSError as error:
        raise InputError(f"{path}: cannot be written: {error.strerror or error}") from error
    finally:
        with suppress(OSError):
            temporary.unlink()


def _flush(path: Path, how: int) -> None:
    """Write a file, or the names in a folder, to the disk."""
    descriptor = os.open(path, how)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _take(descriptor: int) -> None:
    """Lock an open file for this process alone, until it is closed or the process ends."""
    if sys.platform == "win32":
        import msvcrt

        msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
    else:
        import fcntl

        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)


@contextmanager
def holding(folder: Path) -> Iterator[None]:
    """Keep other runs out of a folder while the block runs; InputError if that is impossible.

    The folder is made if it does not exist, and unfinished files of dead processes are removed. The
    lock is a hidden file that the system frees when the process ends in any way. File systems
    without locks do not keep other runs out.
    """
    path = folder / _LOCK
    try:
        folder.mkdir(parents=True, exist_ok=True)
        descriptor = _locked(path)
    except OSError as error:
        raise InputError(
            f"{folder}: cannot be written to ({error.strerror or error}); choose another folder"
        ) from error
    try:
        _remove_unfinished(folder)
        yield
    finally:
        with suppress(OSError):
            path.unlink()
        os.close(descriptor)


def _locked(path: Path) -> int:
    """Descriptor of a file that this process has locked."""
    while True:
        # A link is not followed: what it leads to would be emptied.
        how = os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0)
        descriptor = os.open(path, how, 0o644)
        try:
            _take(descriptor)
        except OSError as error:
            if error.errno in (errno.EAGAIN, errno.EACCES, errno.EDEADLK):
                owner = os.read(descriptor, 100).decode(errors="replace").strip()
                os.close(descriptor)
                raise InputError(
                    f"{path.parent}: another run{f' (process {owner})' if owner else ''} is "
                    "writing to this folder; wait until it has ended, or choose another folder"
                ) from error
        # Who held it before may have removed the file after it was opened here.
        with suppress(FileNotFoundError):
            if os.path.samestat(os.fstat(descriptor), path.stat()):
                os.ftruncate(descriptor, 0)
                os.write(descriptor, f"{os.getpid()}\n".encode())
                return descriptor
        os.close(descriptor)


def needed(library: str, extra: str) -> Any:
    """An optional library; InputError names the extra of the package that brings it."""
    try:
        return import_module(library)
    except ImportError as error:
        raise InputError(
            f"{library} is missing: pip install 'skfem-joint[{extra}]', or do without what needs "
            "it: output.plots needs matplotlib and pyvista, output.vtk needs pyvista, output.uff "
            "needs pyuff, report needs jinja2, to_pandas needs pandas"
        ) from error
