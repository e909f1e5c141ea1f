"""The directive ``command``: usage and options of a command, from the parser of the command line.

``{command} run`` shows those of ``skfem-joint run``; without a name those of ``skfem-joint``.
"""

import argparse
from collections.abc import Iterator
from functools import partial
from textwrap import dedent

from docutils import nodes
from docutils.parsers.rst import Directive
from sphinx.application import Sphinx

from skfem_joint.cli import parser


def parsers() -> dict[str, argparse.ArgumentParser]:
    """Parser of each command by its name; that of the program itself by an empty name."""
    whole = parser()
    (commands,) = (a for a in whole._actions if isinstance(a, argparse._SubParsersAction))
    return {"": whole, **commands.choices}


def usage(parser: argparse.ArgumentParser) -> str:
    """How the command is written, whatever the width and the colours of the terminal."""
    parser.formatter_class = partial(argparse.HelpFormatter, width=88)
    parser.color = False  # of Python 3.14
    return dedent(parser.format_usage().replace("usage:", " " * 6)).strip()


def arguments(parser: argparse.ArgumentParser, common: bool) -> Iterator[tuple[str, str]]:
    """What each argument of a parser is written like, and what it does.

    Those that all commands have are among them only if ``common``.
    """
    form = argparse.HelpFormatter(parser.prog)
    for action in parser._actions:
        everywhere = action.dest in ("help", "verbose", "quiet")
        if isinstance(action, argparse._SubParsersAction) or (everywhere and not common):
            continue
        text = form._expand_help(action)
        value = form._format_args(action, action.dest.upper())
        if not action.option_strings:
            yield form._format_args(action, str(action.metavar)), text
            continue
        written = ", ".join(f"{option} {value}".rstrip() for option in action.option_strings)
        yield written, f"{text} (required)" if action.required else text


class Command(Directive):
    """Usage and options of a command."""

    optional_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Make the usage as a block and the arguments as a list."""
        name = self.arguments[0] if self.arguments else ""
        known = parsers()
        if name not in known:
            raise self.error(f"skfem-joint has no command {name!r}")
        shown = nodes.definition_list(classes=["options"])
        for written, text in arguments(known[name], common=not name):
            term = nodes.term("", "", nodes.literal(written, written))
            meaning = nodes.definition("", nodes.paragraph(text, text))
            shown += nodes.definition_list_item("", term, meaning)
        written = usage(known[name])
        return [nodes.literal_block(written, written, language="text"), shown]


def setup(app: Sphinx) -> dict[str, bool]:
    """Register the directive."""
    app.add_directive("command", Command)
    return {"parallel_read_safe": True}
