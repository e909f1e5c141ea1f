"""Abaqus files: a check before meshio reads them.

meshio takes the element sets of blocks by the number of the block, keeps the last of several blocks
of nodes, sets and parts, passes over what it does not know, and ends a block at a comment. What it
would read wrongly is refused here.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field

#: Parameters that are read right, by keyword; others change what a block means.
_READ = {
    "NODE": {"NSET"},
    "ELEMENT": {"TYPE", "ELSET"},
    "NSET": {"NSET", "GENERATE", "UNSORTED", "INTERNAL", "INSTANCE"},
    "ELSET": {"ELSET", "GENERATE", "UNSORTED", "INTERNAL", "INSTANCE"},
    "PART": {"NAME"},
    "INSTANCE": {"NAME", "PART"},
}
#: Keywords that make or move nodes and elements and are not read.
_MAKING = ("INCLUDE", "SYSTEM", "NGEN", "NFILL", "NCOPY", "NMAP", "ELGEN", "ELCOPY")
_OWN_FILES = "save each part, at its place, in a file of its own, and name all files"
#: What to do about a second block or set.
_ONCE = {
    "NODE": "write all nodes in one block",
    "PART": _OWN_FILES,
    "INSTANCE": _OWN_FILES,
    "NSET": "list all its nodes in one *NSET",
    "ELSET": "list all its elements in one *ELSET, and leave ELSET out of every *ELEMENT",
}
#: Number of nodes of the elements that are read.
_BARS = {"T2D2": 2, "T3D2": 2, "B21": 2, "B31": 2, "T2D3": 3, "T3D3": 3, "B22": 3, "B32": 3}


def check_inp(text: str) -> str:
    """Check an Abaqus file, and leave its comments out.

    Raises
    ------
    ValueError
        Says what meshio would read wrongly, with line, keyword and cure.
    """
    scan, kept = _Scan(), []
    for number, line in enumerate(text.splitlines(), 1):
        content = line.strip()
        if content and not content.startswith("**"):
            scan.line = number
            kept.append(scan.keyword(content[1:]) if content[0] == "*" else scan.data(content))
    scan.not_empty()
    return "\n".join([*kept, ""])


@dataclass
class _Scan:
    """What stands in the lines of a file up to one of them.

    Attributes
    ----------
    line : int
        Number of the line.
    key, values : str, dict
        Last keyword, and its parameters.
    rows : int
        Lines of data since then.
    first : dict
        First line of each block of which there may be one, by keyword and name of the set.
    numbers : dict
        Numbers of all nodes and elements, by keyword.
    """

    line: int = 0
    key: str = ""
    values: dict[str, str] = field(default_factory=dict)
    rows: int = 0
    first: dict[tuple[str, str], int] = field(default_factory=dict)
    numbers: dict[str, set[int]] = field(default_factory=lambda: {"NODE": set(), "ELEMENT": set()})

    def refuse(self, reason: str) -> None:
        """Raise ValueError for this line."""
        raise ValueError(f"line {self.line}: *{self.key}: {reason}")

    def not_empty(self) -> None:
        """Refuse a block that ends without data."""
        if self.rows == 0 and self.key in ("ELEMENT", "NSET", "ELSET"):
            self.refuse("the block before has no members: take it out")

    def keyword(self, content: str) -> str:
        """Check a line with a keyword, and write it as meshio reads it."""
        self.not_empty()
        words = [word.strip() for word in content.split(",")]
        self.key, self.rows = words[0].upper(), 0
        if self.key in _MAKING:
            self.refuse("is not read: save the file with all nodes and elements written out")
        if self.key not in _READ:
            return f"*{self.key}"
        pairs = (word.partition("=") for word in words[1:])
        self.values = {key.strip().upper(): value.strip(' "') for key, _, value in pairs}
        for name in self.values:
            if not name:
                self.refuse("goes on in the next line: write it in one line")
            if name not in _READ[self.key]:
                self.refuse(f"{name} is not read: save the file without it")
        if self.key in ("NODE", "PART", "INSTANCE"):
            self.once(self.key)
        for kind in ("NSET", "ELSET"):
            if kind in self.values:
                self.once(kind, self.values[kind])
        if self.key == "ELEMENT":
            kind = self.values["TYPE"] = self.values.get("TYPE", "").upper()
            if kind.removesuffix("H") not in _BARS:
                self.refuse(
                    f"type {kind or 'missing'}: from .inp files only bars are read, of types "
                    f"{', '.join(_BARS)}; save a .msh"
                )
            if ("*ELSET", "") in self.first:
                self.refuse("stands after an *ELSET: write all elements before the first")
            unnamed = self.first.get(("unnamed", ""))
            if "ELSET" not in self.values:
                self.first.setdefault(("unnamed", ""), self.line)
            elif unnamed:
                self.refuse(f"has an ELSET, which the block at line {unnamed} lacks: give it one")
        elif self.key == "ELSET":
            self.first.setdefault(("*ELSET", ""), self.line)
        words = [f"{name}={value}" if value else name for name, value in self.values.items()]
        return ", ".join([f"*{self.key}", *words])

    def once(self, kind: str, name: str = "") -> None:
        """Refuse a second block or set; case does not distinguish names."""
        first = self.first.setdefault((kind, name.upper()), self.line)
        if first != self.line:
            what = f"set {name!r} stands" if name else "stands"
            self.refuse(f"{what} in line {first} already: {_ONCE[kind]}")

    def data(self, content: str) -> str:
        """Check a line of data, and give it back."""
        self.rows += 1
        if self.key == "INSTANCE":
            self.refuse(f"its part is moved, which is not read: {_OWN_FILES}")
        if self.key not in ("NODE", "ELEMENT", "NSET", "ELSET"):
            return content
        words = [word.strip() for word in content.rstrip(", ").split(",")]
        words = words[:1] if self.key == "NODE" else words
        if not all(re.fullmatch(r"[0-9]+", word) for word in words):
            self.refuse(f"found {content[:40]!r}, must be numbers: list the members of sets")
        numbers = [int(word) for word in words]
        if self.key == "NODE":
            self.numbers["NODE"].add(numbers[0])
        elif self.key == "ELEMENT":
            if len(numbers) != 1 + _BARS[self.values["TYPE"].removesuffix("H")]:
                self.refuse(
                    f"found {len(numbers)} numbers, must be those of an element and its nodes"
                )
            if numbers[0] in self.numbers["ELEMENT"]:
                self.refuse(f"element {numbers[0]} stands twice: number all elements anew")
            self.numbers["ELEMENT"].add(numbers[0])
            self.known("NODE", numbers[1:])
        else:
            members: Sequence[int] = numbers
            if "GENERATE" in self.values:
                if len(numbers) != 3 or self.rows > 1 or not numbers[2]:
                    self.refuse("GENERATE needs one line of first, last and increment: 5, 12, 1")
                members = range(numbers[0], numbers[1] + 1, numbers[2])
                if len(members) > 10**7:
                    self.refuse(f"found {len(members)} members, must be at most 10000000")
            # Elements that a range names and that are not there are left out, as by Abaqus.
            if self.key == "NSET":
                self.known("NODE", members)
            elif members is numbers:
                self.known("ELEMENT", members)
        return content

    def known(self, kind: str, numbers: Sequence[int]) -> None:
        """Refuse numbers that no node or element above has."""
        unknown = next((n for n in numbers if n not in self.numbers[kind]), None)
        if unknown is not None:
            self.refuse(f"{kind.lower()} {unknown} does not stand above: write *{kind} first")
