"""Code blocks of a page in Markdown, and how they are run: as a reader would, from top to bottom.

`blocks_of` reads the blocks of a page, `run_page` runs them in an empty folder. What a block is
follows from its language:

- ``python``: run in one namespace for the whole page; the value of a last expression is printed;
- ``bash``, ``console``, ``sh`` or none: commands, a line each (``\\`` continues one, ``#`` begins a
  comment). ``skfem-joint`` runs in this process, ``python FILE`` and ``python -m ...`` in one of
  its own, ``cd DIR`` holds for the rest of the page; other commands are an error;
- ``text`` after one of these: its output. Lines follow each other as there; ``...`` stands for any
  text, as a line for any lines. Numbers agree within 5 %, those of a line with per cent within a
  half (errors depend on the mesh that a version of Gmsh makes). Of lines that tell a time, a number
  of iterations, memory or a residual, and of what Python calls, only the words count;
- ``toml`` and any block with a file name: written to that file. The name is the ``:caption:`` of a
  ``{code-block}``, or a comment of its own in the first line, ``# make_bracket.py``. TOML without a
  name must be correct, and is not used.

A comment before a block, not shown on the page, says what else holds:

- ``<!-- test: append FILE -->``: the block is added to a file;
- ``<!-- test: fails 2 -->``: the last command of the block ends with this exit status;
- ``<!-- test: skip REASON -->``: the block is not run;
- ``<!-- test: needs MODULE -->``: the block is not run where Python does not have the module;
- ``<!-- test: edit FILE: OLD -> NEW -->``: what the text tells the reader to change;
- ``<!-- test: picture FILE -->`` before ``![...](pictures/NAME.png)``: a file that the blocks above
  have written; ``docs/pictures.py`` copies it to the picture of the page.
"""

import ast
import contextlib
import importlib.util
import io
import math
import os
import re
import shlex
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from skfem_joint.cli import main

SHELL = {"", "bash", "console", "sh"}
#: A fenced block, a comment, a picture, or another line that is not empty.
PART = re.compile(
    r"^(?P<indent> *)(?P<fence>```+) *(?P<info>.*)\n(?P<body>(?:.*\n)*?) *(?P=fence)`* *$"
    r"|^ *<!-- (?P<comment>.*?) --> *$"
    r"|^!\[.*\]\((?P<picture>[^)]+)\)"
    r"|^.*\S.*$",
    re.MULTILINE,
)
FILE_NAME = re.compile(r"^# (?P<name>[\w.-]+\.(?:py|toml|csv|json))$")
NUMBER = re.compile(r"(?<![\w.])[-+]?\d+(?:,\d{3})*(?:\.\d+)?(?:[eE][-+]?\d+)?(?![\w])")
VARIABLE = re.compile(r"\btimes?\b(?! step)|compilation|iterations|residual|MiB|GiB| s\.?$|_s\b")


@dataclass(frozen=True)
class Block:
    """A code block, or a note between blocks (``language`` "edit" or "picture").

    ``line`` is the number of its first line on the page; ``before`` are the comments before it.
    """

    language: str
    text: str
    line: int
    file: str | None = None
    before: tuple[str, ...] = ()

    def note(self, kind: str) -> str | None:
        """What follows ``test: KIND`` in a comment before the block; None if there is none."""
        for comment in self.before:
            if comment.startswith(f"test: {kind}"):
                return comment.removeprefix(f"test: {kind}").strip()
        return None


def blocks_of(page: Path) -> list[Block]:
    """Blocks of a page in their order."""
    text = page.read_text(encoding="utf-8")
    blocks: list[Block] = []
    comments: list[str] = []
    for part in PART.finditer(text):
        number = text.count("\n", 0, part.start()) + 1
        if comment := part["comment"]:
            if comment.startswith("test: edit"):
                blocks.append(Block("edit", comment.removeprefix("test: edit").strip(), number))
            else:
                comments.append(comment)
            continue
        if part["fence"]:
            blocks += _fenced(part, number, tuple(comments))
        elif part["picture"]:
            made = Block("picture", part["picture"], number, before=tuple(comments))
            blocks += [made] if made.note("picture") else []
        else:
            assert not part[0].lstrip().startswith("```"), f"line {number}: a block is not closed"
        comments = []
    return blocks


def _fenced(part: re.Match[str], first: int, comments: tuple[str, ...]) -> list[Block]:
    """The block of a fence; none if it is a directive that shows no code."""
    body = [line[len(part["indent"]) :] for line in part["body"].splitlines()]
    directive = re.match(r"\{(?P<name>[\w-]+)\}\s*(?P<argument>.*)", part["info"])
    file, skipped = None, 0
    if directive:
        if directive["name"] not in ("code-block", "code"):
            return []
        while skipped < len(body) and (option := re.match(r":(\w+):\s*(.*)", body[skipped])):
            file = option[2] if option[1] == "caption" else file
            skipped += 1
        skipped += skipped < len(body) and not body[skipped]
    elif body and (named := FILE_NAME.match(body[0])):
        file = named["name"]
    language = (directive["argument"] if directive else part["info"]).strip()
    text = "\n".join(body[skipped:]) + "\n"
    return [Block(language, text, first + 1 + skipped, file, comments)]


def run_page(page: Path, folder: Path, exempt: tuple[str, ...] = ()) -> dict[str, Path]:
    """Run the blocks of a page in a folder; returns its pictures, files by their targets.

    Blocks with a comment in ``exempt`` before them are left out.
    """
    reader = Reader(folder)
    with _within(folder):
        for block in blocks_of(page):
            if any(comment in exempt for comment in block.before) or _left_out(block):
                reader.output = None
                continue
            try:
                reader.read(block)
            except BaseException as error:
                error.add_note(f"{page}, line {block.line}")
                raise
    return reader.pictures


def _left_out(block: Block) -> bool:
    """Whether a block is not to be run, or not here."""
    module = block.note("needs")
    return bool(block.note("skip") or (module and importlib.util.find_spec(module) is None))


@dataclass
class Reader:
    """Someone who does what a page says.

    ``output`` is what the last block printed; None if that block printed nothing that is known.
    """

    folder: Path
    names: dict = field(default_factory=lambda: {"__name__": "__main__"})
    output: str | None = None
    pictures: dict[str, Path] = field(default_factory=dict)

    def read(self, block: Block) -> None:
        """Do what a block says."""
        if block.language == "text":
            if self.output is not None:
                compare(block.text, self.output)
            return
        if block.language == "edit":
            return self._edit(block.text)
        if block.language == "picture":
            file = Path.cwd() / block.note("picture")
            assert file.is_file(), f"{file} is not written by the blocks before"
            self.pictures[block.text] = file
            return
        self.output = None
        if file := block.note("append"):
            with Path(file).open("a", encoding="utf-8") as stream:
                stream.write("\n" + block.text)
        elif block.file:
            Path(block.file).write_text(block.text, encoding="utf-8")
        elif block.language == "toml":
            tomllib.loads(block.text)
        elif block.language == "python":
            self.output = self._python(block)
        elif block.language in SHELL:
            self.output = self._commands(block)

    @staticmethod
    def _edit(text: str) -> None:
        file, change = text.split(": ", 1)
        old, new = change.split(" -> ")
        content = Path(file).read_text(encoding="utf-8")
        assert content.count(old) == 1, f"{file} has {old!r} {content.count(old)} times"
        Path(file).write_text(content.replace(old, new), encoding="utf-8")

    def _python(self, block: Block) -> str:
        """Run a block; the value of an expression at its end is printed as at a prompt."""
        tree = ast.parse("\n" * (block.line - 1) + block.text)
        last = [tree.body.pop()] if tree.body and isinstance(tree.body[-1], ast.Expr) else []
        with contextlib.redirect_stdout(io.StringIO()) as output:
            exec(compile(tree, "page", "exec"), self.names)
            exec(compile(ast.Interactive(last), "page", "single"), self.names)
        return output.getvalue()

    def _commands(self, block: Block) -> str:
        """Run the commands of a block; all but the last must succeed."""
        texts, commands = [], list(_commands(block.text))
        for number, command in enumerate(commands, 1):
            status, text = _run(command)
            wanted = int(block.note("fails") or 0) if number == len(commands) else 0
            assert status == wanted, f"{shlex.join(command)}: exit status {status}\n{text}"
            texts.append(text)
        return "".join(texts)


def _commands(text: str) -> Iterator[list[str]]:
    """Commands of a block as lists of words."""
    for line in re.sub(r"\\\n\s*", "", text).split("\n"):
        if words := shlex.split(line.strip().removeprefix("$ "), comments=True):
            yield [words[0].removeprefix(".venv/bin/"), *words[1:]]


def _run(command: list[str]) -> tuple[int, str]:
    """Exit status and output of a command; of one that fails, its errors too."""
    program, *arguments = command
    if program == "cd":
        os.chdir(arguments[0])
        return 0, ""
    if program == "skfem-joint" and "error-time" not in arguments:  # which starts a process
        with (
            contextlib.redirect_stdout(io.StringIO()) as output,
            contextlib.redirect_stderr(io.StringIO()) as errors,
        ):
            try:
                status = main(arguments)
            except SystemExit as ended:
                status = int(ended.code or 0)
        return status, output.getvalue() + (errors.getvalue() if status else "")
    if program == "skfem-joint":
        command = [sys.executable, "-m", "skfem_joint", *arguments]
    elif program in ("python", "python3") and "pip" not in arguments:
        command = [sys.executable, *arguments]
    else:
        raise AssertionError(f"{shlex.join(command)}: not a command that is run here")
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    return done.returncode, done.stdout + (done.stderr if done.returncode else "")


def compare(expected: str, actual: str) -> None:
    """AssertionError unless an output is as a page shows it."""
    there = [line.rstrip() for line in actual.strip().split("\n")]
    at, anywhere = 0, False
    for line in expected.strip().split("\n"):
        if line.strip() == "...":
            anywhere = True
            continue
        rest = range(at, len(there)) if anywhere else range(at, min(at + 1, len(there)))
        found = next((i for i in rest if alike(line.rstrip(), there[i])), None)
        assert found is not None, f"the page shows\n  {line}\nbut the output is\n" + "\n".join(
            there[at : at + 40]
        )
        at, anywhere = found + 1, False
    assert anywhere or at == len(there), f"the page does not show: {there[at]}"


def alike(shown: str, line: str) -> bool:
    """Whether a line of an output is what the page shows of it."""
    shown, line = re.sub("-{3,}", "---", shown), re.sub("-{3,}", "---", line)
    pieces = [_piece(text) for text in shown.split("...")]
    match = re.fullmatch(".*".join(pieces), " ".join(line.split()))
    if not match:
        return False
    if VARIABLE.search(shown):
        return True
    numbers = [number for text in shown.split("...") for number in NUMBER.findall(text)]
    pairs = zip(numbers, match.groups(), strict=True)
    tolerance = 0.5 if "%" in shown else 0.05
    return all(
        math.isclose(
            *(float(text.replace(",", "")) for text in pair), rel_tol=tolerance, abs_tol=1e-12
        )
        for pair in pairs
    )


def _piece(text: str) -> str:
    """Pattern of a piece of a line: its words, any numbers in the places of its numbers."""
    words = NUMBER.split(" ".join(text.split()) if text.strip() else "")
    pattern = f"({NUMBER.pattern})".join(re.escape(word) for word in words)
    # spaces at the cuts of "..." do not count
    return (r"\s*" if text[:1] == " " else "") + pattern + (r"\s*" if text[-1:] == " " else "")


@contextlib.contextmanager
def _within(folder: Path) -> Iterator[None]:
    """Work in a folder, from which Python also imports, without a display."""
    path, environment = list(sys.path), dict(os.environ)
    sys.path.insert(0, str(folder))
    os.environ["MPLBACKEND"] = "Agg"
    try:
        with contextlib.chdir(folder):
            yield
    finally:
        sys.path[:] = path
        os.environ.clear()
        os.environ.update(environment)
