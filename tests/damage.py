"""Damaged copies of files, for the tests of what reads them."""

from __future__ import annotations

import random
from collections.abc import Callable, Iterator, Sequence

Change = Callable[[bytearray, random.Random], None]


def lines_and_place(copy: bytearray, rng: random.Random) -> tuple[list[bytes], int]:
    """Lines of a text, and the number of one that is not empty."""
    lines = bytes(copy).split(b"\n")
    return lines, rng.choice([i for i, line in enumerate(lines) if line.strip()])


def byte(copy: bytearray, rng: random.Random) -> None:
    copy[rng.randrange(len(copy))] = rng.randrange(256)


def bit(copy: bytearray, rng: random.Random) -> None:
    copy[rng.randrange(len(copy))] ^= 1 << rng.randrange(8)


def digit(copy: bytearray, rng: random.Random) -> None:
    places = [i for i, c in enumerate(copy) if chr(c).isdigit()]
    copy[rng.choice(places)] = ord(rng.choice("0123456789.-e"))


def line(copy: bytearray, rng: random.Random) -> None:
    lines = bytes(copy).split(b"\n")
    i, j = rng.randrange(len(lines)), rng.randrange(len(lines))
    lines[i : i + 1] = rng.choice([[], [lines[i]] * 2, [lines[j]], [lines[j], lines[i]]])
    copy[:] = b"\n".join(lines)


def cut(copy: bytearray, rng: random.Random) -> None:
    del copy[rng.randrange(len(copy)) :]


def hole(copy: bytearray, rng: random.Random) -> None:
    start = rng.randrange(len(copy))
    del copy[start : start + rng.randrange(1, 60)]


def insert(copy: bytearray, rng: random.Random) -> None:
    start = rng.randrange(len(copy))
    copy[start:start] = bytes(rng.randrange(256) for _ in range(rng.randrange(1, 8)))


def mutations(data: bytes, own: Sequence[Change], rng: random.Random) -> Iterator[bytes]:
    """Endless damaged copies: bytes and lines changed, cut, doubled, exchanged, or ``own`` ways."""
    changes = [byte, bit, digit, digit, *own, line, hole, insert, cut]
    while True:
        copy = bytearray(data)
        for _ in range(rng.choice([1, 1, 1, 2, 4])):
            if any(chr(c).isdigit() for c in copy) and copy.strip():
                rng.choice(changes)(copy, rng)
        yield bytes(copy)
