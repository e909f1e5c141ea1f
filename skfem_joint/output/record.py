"""Which files in a folder this program wrote: a hidden list with their names, sizes and times.

Each line of the list is on the disk before its file takes its place, so that what a run wrote
before it was killed is known to the next one too. Only files that still have the size and the time
that stand there are ever removed. Files of other origin that lie in the folder when a command
begins stand in the list as well, as not ours: the command may replace them, as it was allowed to.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from importlib.metadata import version
from itertools import islice
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple, TextIO

from skfem_joint import __version__
from skfem_joint.ground.errors import InputError
from skfem_joint.ground.files import recording, replacing
from skfem_joint.output.tables import write_json

SUMMARY = "summary.json"
LIST = ".skfem-joint-files"
#: Libraries whose versions a summary tells.
_LIBRARIES = ("numpy", "scipy", "scikit-fem", "numba", "meshio")
_HEADER = json.dumps({"program": "skfem_joint", "file": "list of written files"})
#: Folders below that of the results.
_FOLDERS = {"fields", "pictures", "curves"}
#: Endings of results; names without one are those of such folders.
_ENDINGS = {
    *("", ".npz", ".csv", ".json", ".md", ".parquet", ".toml"),
    *(".png", ".gif", ".pvd", ".vtu", ".vtm", ".html", ".uff"),
}
# Checkpoints and rows, from which an interrupted command is resumed, models for ranges, which other
# commands use, and hidden files.
_PASSED = re.compile(
    r"checkpoint_.*\.npz|(sweep|response|error-time)_rows\.jsonl|"
    r"range_[0-9a-f]{16}\.npz|\..*"
)
_CURE = "move it away, choose another folder, or give --overwrite"


class _Listed(NamedTuple):
    """A file of a list: its name below the folder, and whether this program wrote it."""

    name: str
    size: int
    time_ns: int
    ours: bool

    @classmethod
    def of(cls, path: Path, name: str, ours: bool) -> _Listed:
        status = path.lstat()
        return cls(name, status.st_size, status.st_mtime_ns, ours)

    def write(self, lines: TextIO) -> None:
        lines.write(json.dumps(self) + "\n")


def _listed(folder: Path) -> set[_Listed] | None:
    """Lines of the list in a folder; None if there is none.

    InputError if this program did not write it.
    """
    path = folder / LIST
    if not os.path.lexists(path):
        return None
    try:
        if path.is_symlink():
            raise ValueError("a link")
        # A line that was torn is the last; its file has not taken its place.
        first, *lines = path.read_text(encoding="utf-8").split("\n")[:-1]
        if first != _HEADER:
            raise ValueError("not ours")
        return {_Listed(str(name), *rest) for name, *rest in map(json.loads, lines)}
    except (OSError, ValueError, TypeError, RecursionError) as error:
        raise InputError(
            f"{path}: is not a list of files that skfem-joint wrote; nothing was removed; "
            "move it away, or choose another folder"
        ) from error


def _write_list(folder: Path, lines: Iterable[_Listed]) -> None:
    with replacing(folder / LIST) as temporary, temporary.open("w", encoding="utf-8") as file:
        file.write(_HEADER + "\n")
        for line in lines:
            line.write(file)


def clear(folder: Path, overwrite: bool = False) -> list[str]:
    """Remove what earlier commands wrote into a folder, and nothing else.

    Parameters
    ----------
    folder : Path
        A folder that is there.
    overwrite : bool
        Whether files of other origin, and those that were changed, may lie in the folder. They
        stay, unless results of the same names replace them.

    Returns
    -------
    list of str
        Names of files of other origin, relative to the folder.

    Raises
    ------
    InputError
        Without ``overwrite``, if a file was changed, if no command wrote into the folder and it is
        not empty, or if a file of other origin has the ending of a result; if a file cannot be read
        or removed. Nothing is removed but in the last case.
    """
    lines = _listed(folder)
    ours, others = _found(folder, lines or set())
    left = [line.name for line in others]
    if left and not overwrite:
        _refuse(folder, left, lines)
    _remove(folder, ours)
    if others:
        _write_list(folder, others)
    else:  # the list last: after an interruption it still has the rest
        _remove(folder, [LIST])
    return left


def _found(folder: Path, lines: set[_Listed]) -> tuple[list[str], list[_Listed]]:
    """Names of files in a folder that are as they were written, and lines of all others."""
    try:
        there = [_Listed.of(folder / name, name, True) for name in sorted(_names(folder))]
    except OSError as error:
        raise InputError(f"{error.filename}: cannot be read: {error.strerror}") from error
    others = [line._replace(ours=False) for line in there if line not in lines]
    return [line.name for line in there if line in lines], others


def _remove(folder: Path, names: Sequence[str]) -> None:
    """Remove files of a folder, and the folders below it that they leave empty."""
    try:
        for name in names:
            (folder / name).unlink(missing_ok=True)
    except OSError as error:
        raise InputError(f"{error.filename}: cannot be removed: {error.strerror}") from error
    for below in {parent for name in names for parent in PurePosixPath(name).parents[:-1]}:
        with suppress(OSError):  # something else is in it
            (folder / below).rmdir()


def _refuse(folder: Path, names: Sequence[str], lines: set[_Listed] | None) -> None:
    """InputError for files of other origin in a folder with a list, unless they are harmless."""
    written = {line.name for line in lines or () if line.ours}
    changed = [name for name in names if name in written]
    files = [name for name in names if not name.endswith("/")]
    near = [name for name in files if PurePosixPath(name).suffix.lower() in _ENDINGS]
    for wrong, why in (
        (names if lines is None else (), "is not empty, and skfem-joint did not write"),
        (changed, "has files that were changed since skfem-joint wrote them:"),
        (near, "has files that skfem-joint did not write and its results might replace:"),
    ):
        if wrong:
            some = ", ".join(wrong[:5]) + (f" and {len(wrong) - 5} more" if wrong[5:] else "")
            raise InputError(f"{folder}: {why} {some}; nothing was removed; {_CURE}")


def _names(folder: Path) -> Iterator[str]:
    """Names of files in a folder and in those below it that are named as those of results.

    Of others that are not empty their names with a slash. Left out is what other commands go on
    from, and folders with lists of their own.
    """
    for path in folder.iterdir():
        if path.is_symlink() or not path.is_dir():
            if not _PASSED.fullmatch(path.name):
                yield path.name
        elif path.name in _FOLDERS:
            yield from (f"{path.name}/{inner.name}" for inner in path.iterdir())
        elif not (path.name.startswith(".") or os.path.lexists(path / LIST)):
            with suppress(PermissionError):
                yield from (f"{path.name}/" for _ in islice(path.iterdir(), 1))


@contextmanager
def writing(folder: Path, content: Mapping[str, Any]) -> Iterator[Path]:
    """Write results in place of old ones; yields the path of the ``summary.json`` of ``content``.

    Every file that `replacing` writes below the folder while the block runs is listed. The summary
    is written when the block ends, by an error too, with the names of the files.

    Raises
    ------
    InputError
        If a file of other origin lies where one is to be written, and did not when `clear` was
        called; if a file cannot be read or removed.
    ValueError
        If ``content`` holds numbers that are not finite; nothing is removed then.
    """
    json.dumps(content, allow_nan=False)  # nothing is removed for what cannot be written
    known = _listed(folder) or set()
    ours, others = _found(folder, known)
    _remove(folder, ours)
    known = known.intersection(others)
    _write_list(folder, known)

    with _listing(folder, known) as written:
        try:
            yield folder / SUMMARY
        finally:
            libraries = ", ".join(f"{name} {version(name)}" for name in _LIBRARIES)
            mark = {"program": "skfem_joint", "version": __version__, "libraries": libraries}
            files = {"files": list(dict.fromkeys(written)), "written_by": mark}
            write_json(folder / SUMMARY, {**content, **files})


@contextmanager
def adding(folder: Path) -> Iterator[None]:
    """Write more files beside the results of a folder, which stay; InputError as for `writing`.

    The next command takes them for results, as those that are there.
    """
    with _listing(folder, _listed(folder) or set()):
        yield


@contextmanager
def _listing(folder: Path, known: set[_Listed]) -> Iterator[list[str]]:
    """List each file that the block writes below a folder; yields their names as they are written.

    ``known`` are the lines of the list so far.
    """
    written: list[str] = []

    def take(temporary: Path, path: Path) -> None:
        """List a whole file that is about to take its place; refuse if that is not free."""
        if not path.absolute().is_relative_to(folder.absolute()):
            return
        place = path.absolute().relative_to(folder.absolute())
        name = place.as_posix()
        free = not os.path.lexists(path) or any(
            _Listed.of(path, name, mine) in known for mine in (True, False)
        )
        if not free or any((folder / above).is_symlink() for above in place.parents[:-1]):
            raise InputError(
                f"{path}: is there, and this run did not write it: it is left as it is; move it "
                "away, or choose another folder"
            )
        known.add(line := _Listed.of(temporary, name, True))
        written.append(name)
        line.write(lines)
        lines.flush()
        os.fsync(lines.fileno())

    with (folder / LIST).open("a", encoding="utf-8") as lines, recording(take):
        yield written
