"""Cards of Abaqus and CalculiX files: a keyword with options, and the lines of data below it.

Comments are left out, included files are put in their place, and nothing is known of what a card
means. Errors are ValueErrors that begin with the line.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import NamedTuple, NoReturn

import numpy as np

from skfem_joint.ground.arrays import FloatArray, IntArray
from skfem_joint.ground.errors import InputError
from skfem_joint.ground.files import LARGEST, read_whole

#: Files that may include each other, one inside the other, and all of them.
_DEEPEST, _MOST_FILES = 10, 1000
_CARD = re.compile(rb"^[ \t]*\*(?!\*)", re.MULTILINE)
_COMMENT = re.compile(rb"^[ \t]*\*\*[^\n]*", re.MULTILINE)
_LINE_END = re.compile(rb",?[ \t]*\n\s*")
#: Characters of plain numbers; others are looked at line by line.
_NUMERIC = b"0123456789+-.eE, \t\n"
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eEdD][+-]?\d+)?")


class Numbers(NamedTuple):
    """Numbers of all lines of data.

    Attributes
    ----------
    values : ndarray, shape (n,)
        The numbers one after the other; fields that are left empty are nan.
    counts : ndarray of int, shape (lines,)
        How many stand in each line that is not empty.
    """

    values: FloatArray
    counts: IntArray


@dataclass(frozen=True)
class Card:
    """A card.

    Attributes
    ----------
    file : str
        File that holds it, if it was included; else "".
    line : int
        Line of the keyword.
    keyword : str
        In capitals, with single spaces.
    options : dict of str to str
        Values of the options by name, in capitals; "" for options without a value.
    body : bytes
        Lines of data, comments blanked.
    first : int
        Line of the first line of ``body``.
    """

    file: str
    line: int
    keyword: str
    options: dict[str, str]
    body: bytes
    first: int

    def refuse(self, reason: str, line: int | None = None) -> NoReturn:
        """Raise ValueError for this card, or for a line of its data."""
        place = f"included file {self.file}, " if self.file else ""
        raise ValueError(f"{place}line {line or self.line}: *{self.keyword}: {reason}")

    def name(self, option: str) -> str:
        """Value of an option that must be there and must be a name."""
        name = bare(self.options.get(option, ""))
        if not name:
            self.refuse(f"{option} is missing: write *{self.keyword}, {option}=NAME")
        return name

    def rows(self) -> Iterator[tuple[int, list[str]]]:
        """Line and fields of each line of data that is not empty."""
        for number, line in enumerate(self.body.split(b"\n"), self.first):
            text = decoded(line).strip()
            if text:
                yield number, fields(text.removesuffix(","))

    def line_of(self, row: int) -> int:
        """Line of a line of data, counted without the empty ones."""
        return next((line for k, (line, _) in enumerate(self.rows()) if k == row), self.line)

    @cached_property
    def is_numeric(self) -> bool:
        """Whether the data are numbers without names."""
        return not self.body.translate(None, _NUMERIC)

    @cached_property
    def numbers(self) -> Numbers:
        """All numbers; ValueError with the line for anything else."""
        return (self._plain_numbers() if self.is_numeric else None) or self._numbers_by_line()

    def _plain_numbers(self) -> Numbers | None:
        """The same where every field is filled; None where it is not."""
        body = self.body.strip()
        if body.endswith(b",") or any(end in body for end in (b",\n", b" \n", b"\t\n", b"\n\n")):
            body = _LINE_END.sub(b"\n", body + b"\n").strip()
        lines = np.frombuffer(body + b"\n", np.uint8)
        commas, ends = np.flatnonzero(lines == ord(",")), np.flatnonzero(lines == ord("\n"))
        counts = np.diff(np.searchsorted(commas, ends), prepend=0) + 1
        with warnings.catch_warnings():
            warnings.simplefilter("error", DeprecationWarning)  # of text that is no number
            try:
                values = np.fromstring(body.replace(b"\n", b",").decode("ascii"), sep=",")
            except (ValueError, DeprecationWarning):
                return None
        return Numbers(values, counts) if body and values.size == counts.sum() else None

    def _numbers_by_line(self) -> Numbers:
        values, counts = list[float](), list[int]()
        for line, words in self.rows():
            for word in words:
                if word and not _NUMBER.fullmatch(word):
                    self.refuse(f"found {word[:40]!r}, must be a number", line)
                values.append(float(word.upper().replace("D", "E")) if word else np.nan)
            counts.append(len(words))
        return Numbers(np.array(values), np.array(counts, dtype=np.intp))


def decoded(text: bytes) -> str:
    """Text in UTF-8, or else in Latin-1, in which no byte is wrong."""
    try:
        return text.decode("utf-8")
    except UnicodeDecodeError:
        return text.decode("latin-1")


def fields(text: str) -> list[str]:
    """Fields between commas, without blanks around them; quotes may hold commas."""
    parts = text.split('"')
    parts[1::2] = [part.replace(",", "\x00") for part in parts[1::2]]
    return [word.strip().replace("\x00", ",") for word in '"'.join(parts).split(",")]


def bare(name: str) -> str:
    """Name without quotes."""
    return name.strip().strip('"').strip()


def read_cards(path: Path) -> list[Card]:
    """Cards of a file, with those of the files that it includes in their places.

    Raises
    ------
    ValueError
        For text outside of cards, damaged keywords, and files that include each other.
    InputError
        For a file that cannot be read.
    """
    return _Reading(path.parent).cards(path)


@dataclass
class _Reading:
    """Reading of files that include each other, so far of ``count`` files with ``size`` bytes."""

    folder: Path
    count: int = 0
    size: int = 0

    def cards(self, path: Path, name: str = "", around: tuple[Path, ...] = ()) -> list[Card]:
        """Cards of one file and of those that it includes; ``around`` are those that include it."""
        data = read_whole(path).removeprefix(b"\xef\xbb\xbf").replace(b"\r\n", b"\n")
        self.count, self.size = self.count + 1, self.size + len(data)
        place = f"included file {name}, " if name else ""
        if self.size > LARGEST:
            raise ValueError(f"{place}line 1: with it {self.size} bytes, at most {LARGEST} allowed")
        if b"\x00" in data:
            line = data[: data.index(b"\x00")].count(b"\n") + 1
            raise ValueError(f"{place}line {line}: holds bytes that are no text; save it as text")
        data = data.replace(b"\r", b"\n")
        if b"**" in data:
            data = _COMMENT.sub(b"", data)
        starts = [match.start() for match in _CARD.finditer(data)]
        before = data[: starts[0] if starts else None]
        if before.strip():
            line = before[: len(before) - len(before.lstrip())].count(b"\n") + 1
            raise ValueError(
                f"{place}line {line}: found {decoded(before.strip())[:40]!r}, must be a card, "
                "which begins with *, such as *NODE"
            )
        found, line = list[Card](), 1 + before.count(b"\n")
        for start, end in zip(starts, [*starts[1:], len(data)], strict=True):
            card = _card(data[start:end], name, line)
            line += data.count(b"\n", start, end)
            found += self._included(card, (*around, path)) if card.keyword == "INCLUDE" else [card]
        return found

    def _included(self, card: Card, around: tuple[Path, ...]) -> list[Card]:
        """Cards of the file that a card includes, relative to the folder of the first file."""
        name = card.name("INPUT").replace("\\", "/")
        path = self.folder / name
        if path in around:
            card.refuse(f"{name} includes itself: take the card out")
        if len(around) > _DEEPEST or self.count > _MOST_FILES:
            card.refuse(f"more than {_DEEPEST} files inside each other, or {_MOST_FILES} in all")
        if len(card.options) > 1:
            card.refuse("only INPUT is read: write the file out without a password")
        try:
            return self.cards(path, name, around)
        except InputError as error:
            card.refuse(f"{error}; names of files are relative to the folder of the first one")


def _card(text: bytes, file: str, line: int) -> Card:
    """Card of a text that begins with its keyword.

    A keyword goes on in the next line where its line ends with a comma.
    """
    head, _, body = text.partition(b"\n")
    words, first = decoded(head).strip(), line + 1
    while words.endswith(",") and body:
        head, _, body = body.partition(b"\n")
        first += 1
        words = f"{words.removesuffix(',')}, {decoded(head).strip()}" if head.strip() else words
    keyword, *options = fields(words.removesuffix(",").lstrip("*"))
    card = Card(file, line, " ".join(keyword.upper().split()), {}, body, first)
    for option in options:
        name, _, value = option.partition("=")
        name = " ".join(name.upper().split())
        # One that stands twice counts with its value as a name, which no card has.
        card.options[option.upper() if name in card.options else name] = value.strip()
    if words.count('"') % 2:
        card.refuse("a quote is not closed")
    return card
