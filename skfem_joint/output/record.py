"""Which files in a folder this program wrote: a mark in ``summary.json``, and digests of files.

A summary carries under ``written_by`` the program, its version and a digest of the summary itself,
and under ``files`` the SHA-256 digest of every file that was written with it. Only files that still
have their digests are ever removed or replaced.

While files are being written, their digests stand in a hidden list, line by line. Each line is on
the disk before its file takes its place, so that what a run wrote before it was killed is known to
the next one too.
"""

from __future__ import annotations

import hashlib
import json
import os
import stat
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any, TextIO

from skfem_joint import __version__
from skfem_joint.errors import InputError, JointError
from skfem_joint.files import recording
from skfem_joint.output.tables import write_json

SUMMARY = "summary.json"
#: Digests of the files of a run that has not written all of them.
LIST = ".skfem-joint-files"
_PROGRAM = "skfem_joint"

#: Digests by the name of a file; a file that is being written again has several.
Digests = dict[str, set[str]]


def digest_of(path: Path) -> str:
    """SHA-256 digest of a file, hexadecimal; OSError if it cannot be read."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _marked(content: Mapping[str, Any], files: Mapping[str, str]) -> dict[str, Any]:
    """Summary with the mark of this program."""
    mark = {"program": _PROGRAM, "version": __version__}
    whole = {**content, "files": dict(files), "written_by": mark}
    return whole | {"written_by": {**mark, "digest": _own_digest(whole)}}


def _own_digest(summary: Mapping[str, Any]) -> str:
    """Digest of what a summary says, all but the digest itself, however its text is laid out."""
    mark = {key: value for key, value in summary["written_by"].items() if key != "digest"}
    plain = json.loads(json.dumps({**summary, "written_by": mark}))
    return hashlib.sha256(json.dumps(plain, sort_keys=True).encode()).hexdigest()


def _is_plain(folder: Path, name: str, kind: Callable[[int], bool] = stat.S_ISREG) -> bool:
    """Whether a name below a folder is a file of its own, reached through folders, not links."""
    path = folder
    try:
        for part in PurePosixPath(name).parts:
            if path != folder and not stat.S_ISDIR(path.lstat().st_mode):
                return False
            path = path / part
        return kind(path.lstat().st_mode)
    except NotADirectoryError:
        return False


def _is_inside(name: Any) -> bool:
    """Whether a name is a path below the folder, in the form that this program writes."""
    if not isinstance(name, str) or any(character in name for character in "\\:\0"):
        return False
    parts = PurePosixPath(name).parts
    return bool(parts) and name == "/".join(parts) and ".." not in parts and parts[0] != "/"


def _listed(folder: Path) -> Digests:
    """Digests of what commands wrote into a folder, as the summary and the list there have them.

    InputError if this program did not write them.
    """
    digests: Digests = {}
    for name, digest in [*_in_summary(folder / SUMMARY), *_in_list(folder / LIST)]:
        digests.setdefault(name, set()).add(digest)
    return digests


def _in_summary(path: Path) -> Sequence[tuple[str, str]]:
    if not os.path.lexists(path):
        return ()
    try:
        if not _is_plain(path.parent, path.name):
            raise ValueError("not a file")
        content = json.loads(path.read_bytes())
        mark, files = content["written_by"], content["files"]
        if mark["program"] != _PROGRAM:
            raise ValueError("another program's")
        ours = _own_digest(content) == mark["digest"] and all(map(_is_inside, files))
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise InputError(
            f"{path}: is not the summary of a run of this program, or of an older version of it; "
            "nothing was removed; move it away, or choose another folder"
        ) from error
    if not ours:
        raise InputError(
            f"{path}: was changed since skfem-joint wrote it; nothing was removed; move it away, "
            "or choose another folder"
        )
    return [(name, str(digest)) for name, digest in files.items()]


def _in_list(path: Path) -> Sequence[tuple[str, str]]:
    if not os.path.lexists(path):
        return ()
    try:
        if not _is_plain(path.parent, path.name):
            raise ValueError("not a file")
        text = path.read_text(encoding="utf-8")
        # A line that was torn is the last; its file has not taken its place.
        first, *lines = text.split("\n")[:-1] or [""]
        ours = json.loads(first)["program"] == _PROGRAM if first else _first_line().startswith(text)
        rows = [json.loads(line) for line in lines]
        if not ours or not all(len(row) == 2 and _is_inside(row[0]) for row in rows):
            raise ValueError("not ours")
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise InputError(
            f"{path}: is not a list of files that skfem-joint wrote; nothing was removed; "
            "move it away, or choose another folder"
        ) from error
    return [(name, str(digest)) for name, digest in rows]


def _first_line() -> str:
    return json.dumps({"program": _PROGRAM, "version": __version__}) + "\n"


def clear(folder: Path, may_not_be_there: Callable[[str], bool] = lambda _: False) -> None:
    """Remove what earlier commands wrote into a folder, and nothing else.

    Parameters
    ----------
    folder : Path
        A folder that is there.
    may_not_be_there : callable
        Whether a file of that name, relative to the folder, would be in the way of what is to be
        written. Only files in the folder and in its subfolders are asked about.

    Raises
    ------
    InputError
        If another program wrote the summary, or it or a file that it lists was changed; if files
        of other origin are in the way; if a file cannot be read or removed. Nothing is removed but
        in the last case.
    """
    digests = _listed(folder)
    try:
        there = [name for name in digests if os.path.lexists(folder / name)]
        ours = {name for name in there if _is_ours(folder, name, digests)}
        changed = sorted({*there} - ours)
        foreign = sorted({*filter(may_not_be_there, _names(folder))} - {*there, SUMMARY, LIST})
    except OSError as error:
        raise InputError(f"{error.filename}: cannot be read: {error.strerror}") from error
    if changed:
        raise InputError(
            f"{folder}: {_some(changed)} changed since skfem-joint wrote it there; nothing was "
            "removed; move it away, or choose another folder"
        )
    if foreign:
        raise InputError(
            f"{folder}: has {_some(foreign)}, which no run that a {SUMMARY} there knows of wrote "
            "and this one might overwrite; move them away, or choose another folder"
        )
    try:
        # The summary and the list last: after an interruption they still list the rest.
        for name in (*ours, SUMMARY, LIST):
            (folder / name).unlink(missing_ok=True)
    except OSError as error:
        raise InputError(f"{error.filename}: cannot be removed: {error.strerror}") from error
    for below in {parent for name in ours for parent in PurePosixPath(name).parents[:-1]}:
        with suppress(OSError):  # something else is in it
            (folder / below).rmdir()


def _is_ours(folder: Path, name: str, digests: Digests) -> bool:
    """Whether a file that is there is as this program wrote it."""
    return _is_plain(folder, name) and digest_of(folder / name) in digests.get(name, ())


def _names(folder: Path) -> Iterator[str]:
    """Names of all but folders in a folder, and in those below it that are not hidden."""
    for path in folder.iterdir():
        if path.is_symlink() or not path.is_dir():
            yield path.name
        elif not path.name.startswith("."):
            with suppress(PermissionError):
                yield from (f"{path.name}/{inner.name}" for inner in path.iterdir())


def _some(names: Sequence[str]) -> str:
    """The first of some names."""
    return ", ".join(names[:5]) + (f" and {len(names) - 5} more" if names[5:] else "")


@dataclass
class _Record:
    """Digests of the files that are being written into a folder."""

    folder: Path
    lines: TextIO
    files: dict[str, str] = field(default_factory=dict)

    def take(self, temporary: Path, path: Path) -> None:
        """Note a whole file that is about to take its place; refuse if that is not free."""
        if not path.absolute().is_relative_to(self.folder.absolute()):
            return
        name = path.absolute().relative_to(self.folder.absolute()).as_posix()
        known = {key: {value} for key, value in self.files.items()}
        free = not os.path.lexists(path) or _is_ours(self.folder, name, known)
        parent = PurePosixPath(name).parent.as_posix()
        # The folder itself may be a link, for the user named it.
        inside = parent == "." or _is_plain(self.folder, parent, stat.S_ISDIR)
        if not free or not inside:
            raise InputError(
                f"{path}: is there, and this run did not write it: it is left as it is; move it "
                "away, or choose another folder"
            )
        self.files[name] = digest_of(temporary)
        self.lines.write(json.dumps([name, self.files[name]]) + "\n")
        self.lines.flush()
        os.fsync(self.lines.fileno())

    def is_right(self) -> bool:
        """Whether every file is there as it was noted."""
        known = {name: {digest} for name, digest in self.files.items()}
        return all(_is_ours(self.folder, name, known) for name in known)

    def finish(self, content: Mapping[str, Any]) -> None:
        """Write the summary with all digests, which makes the list needless."""
        write_json(self.folder / SUMMARY, _marked(content, self.files))
        (self.folder / LIST).unlink(missing_ok=True)


@contextmanager
def writing(folder: Path, content: Mapping[str, Any]) -> Iterator[Path]:
    """Write results in place of old ones; yields the path of the ``summary.json`` of ``content``.

    Every file that `replacing` writes below the folder while the block runs is listed there with
    its digest. The summary is written first, without them, and again when all is written or an
    error ends the block.

    Raises
    ------
    InputError
        As `clear`; if a file of other origin lies where one is to be written.
    ValueError
        If ``content`` holds numbers that are not finite; nothing is removed then.
    """
    json.dumps(content, allow_nan=False)  # nothing is removed for what cannot be written
    clear(folder)
    summary, hidden = folder / SUMMARY, folder / LIST
    try:
        descriptor = os.open(hidden, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o644)
    except OSError as error:
        raise InputError(f"{hidden}: cannot be written: {error.strerror}") from error
    with closing(os.fdopen(descriptor, "w", encoding="utf-8")) as lines:
        lines.write(_first_line())
        record = _Record(folder, lines)
        write_json(summary, _marked(content, {}))
        try:
            with recording(record.take):
                yield summary
        except BaseException:
            with suppress(JointError, OSError):  # the list has the digests too
                if record.is_right():
                    record.finish(content)
            raise
    record.finish(content)
