"""Rows of finished work, kept in a file as they finish, from which a command goes on.

A long command has many parts: a frequency of a response, a run of a comparison, a scene of a sweep.
Each finished part is a row of a file, on the disk before the next part begins. A command that was
interrupted or killed computes only the missing parts when it is started again.

A row is named by its *mark*, a digest of the package's code and of all that the part is computed
from: a row of another scene, other code or another initial state has another mark and is not used.
Each line carries a digest of itself, so that a damaged line is not used either. Floats keep every
bit. A part is read back from its row before it is used, so that later parts begin with the same
bits in the same memory layout, whether it was computed now or earlier.
"""

from __future__ import annotations

import base64
import io
import json
import os
import time
from collections.abc import Callable, Iterable
from functools import cache
from hashlib import sha256
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from skfem_joint import __version__
from skfem_joint.ground.errors import InputError
from skfem_joint.ground.files import replacing
from skfem_joint.ground.plain_values import PlainForm, fingerprint

T = TypeVar("T")

#: First line of each file of rows, by which files of others are recognised.
HEADER = b'{"program": "skfem_joint", "file": "rows of finished work", "form": 1}\n'


@cache
def code_version() -> str:
    """Version of the package with a digest of its source, by which kept work is recognised.

    Definitions may change while the version stays.
    """
    sources = sorted(Path(__file__).parents[1].rglob("*.py"))
    digest = sha256(b"".join(path.read_bytes() for path in sources)).hexdigest()
    return f"{__version__} ({digest[:16]})"


class Rows:
    """Finished parts of a command.

    Parameters
    ----------
    path : Path, optional
        File of the rows, made by the first row; nothing is kept if not given. The caller keeps
        other processes from writing to its folder, see `skfem_joint.ground.files.holding`.
    kinds : iterable of type
        Dataclasses that rows may hold, beside arrays, numbers, texts, lists, tuples and mappings.

    Attributes
    ----------
    taken, computed : int
        Rows read from the file so far, and computed so far.
    earlier_s : float
        Time that the rows taken up took to compute, s.
    damaged : int
        Lines of the file that are not used because they are damaged.
    known : int
        Rows in the file at the start.

    Raises
    ------
    InputError
        If the file exists and is no file of rows.
    """

    def __init__(self, path: Path | None = None, kinds: Iterable[type] = ()) -> None:
        self.path: Path | None = path
        self._form = PlainForm(kinds)
        self.taken = self.computed = self.damaged = 0
        self.earlier_s = 0.0
        self._places: dict[str, tuple[int, int]] = {}  # of lines in the file: start and size
        if path is not None and path.exists():
            self._read(path)
        self.known = len(self._places)

    def _read(self, path: Path) -> None:
        """Read the places of the lines; a last line that was cut is removed from the file."""
        place = len(HEADER)
        with path.open("rb") as file:
            if not path.is_file() or file.read(place) != HEADER:
                raise InputError(
                    f"{path}: line 1: is not that of a file of rows of this program; move the file "
                    "away, or choose another folder"
                )
            for line in file:
                if not line.endswith(b"\n"):
                    break
                if row := _intact(line):
                    self._places[row["row"]] = place, len(line)
                else:
                    self.damaged += 1
                place += len(line)
        if place < path.stat().st_size:
            os.truncate(path, place)

    def mark(self, *parts: Any) -> str:
        """Name of a row: a digest of what its content is computed from; empty without a file.

        InputError as `fingerprint`, for plain functions of time.
        """
        return "" if self.path is None else fingerprint(code_version(), self._form.names, *parts)

    def __contains__(self, mark: str) -> bool:
        """Whether the file has a row of this name."""
        return mark in self._places

    def take(self, mark: str) -> Any:
        """Content of a row of the file."""
        if self.path is None:
            raise KeyError(mark)
        start, size = self._places[mark]
        with self.path.open("rb") as file:
            file.seek(start)
            row = json.loads(file.read(size))
        self.taken += 1
        self.earlier_s += row["seconds"]
        return self._form.decoded(row["content"], _array)

    def keep(self, mark: str, content: T, seconds: float = 0.0) -> T:
        """Add a row to the file and flush it to the disk; returns its content as read from there.

        ``seconds`` is the time that it took to compute. OSError if it cannot be written.
        """
        if self.path is None:
            self.computed += 1
            return content
        form = self._form.encoded(content, _text)
        row = {"row": mark, "seconds": seconds, "content": form}
        line = json.dumps({"sha256": _digest(row), **row}).encode() + b"\n"
        if not self.path.exists():
            with replacing(self.path) as temporary:
                temporary.write_bytes(HEADER)
        with self.path.open("ab") as file:
            place = file.tell()
            file.write(line)
            file.flush()
            os.fsync(file.fileno())
        self._places[mark] = place, len(line)
        self.computed += 1
        kept: T = self._form.decoded(form, _array)
        return kept

    def row(self, mark: str, compute: Callable[[], T]) -> T:
        """Content of a row: taken from the file, or else computed and kept there."""
        if mark in self:
            taken: T = self.take(mark)
            return taken
        begin = time.perf_counter()
        content = compute()
        return self.keep(mark, content, time.perf_counter() - begin)

    def remove(self) -> None:
        """Remove the file; for when the results of the command are written."""
        if self.path is not None:
            self.path.unlink(missing_ok=True)

    def notes(self) -> list[str]:
        """Sentences about the rows that the file had at the start."""
        notes = []
        if self.taken:
            notes.append(f"{self.taken} finished parts were taken up from {self.path}.")
        if self.damaged:
            notes.append(f"{self.path}: {self.damaged} lines were damaged, and were not used.")
        return notes


def _digest(row: dict[str, Any]) -> str:
    """Digest of a row without its own."""
    return sha256(json.dumps(row).encode()).hexdigest()


def _intact(line: bytes) -> dict[str, Any] | None:
    """Row of a line; None if the line is damaged."""
    try:
        row: dict[str, Any] = json.loads(line)
        return row if row.pop("sha256") == _digest(row) else None
    except (ValueError, LookupError, TypeError, AttributeError):
        return None


def _text(_: str, array: NDArray[Any]) -> str:
    """Base64 of an array in its ``.npy`` form."""
    file = io.BytesIO()
    np.save(file, array, allow_pickle=False)
    return base64.b64encode(file.getvalue()).decode()


def _array(text: str) -> Any:
    """Array of such a text, or its number."""
    return np.load(io.BytesIO(base64.b64decode(text)), allow_pickle=False)[()]
