"""Printed output on the pages: sentences wrap, tables keep their columns and scroll."""

import re

from docutils import nodes

# A line of a printed table: a rule, or words apart by three spaces or more.
_COLUMNS = re.compile(r"^-{20,}$|\S {3,}\S.*$", re.MULTILINE)


def mark(app, document):
    """Give each block of printed sentences the class ``wraps``, which the style sheet wraps."""
    for block in document.findall(nodes.literal_block):
        if block.get("language") == "text" and len(_COLUMNS.findall(block.astext())) < 3:
            block["classes"].append("wraps")


def setup(app):
    """Mark the blocks of each page when it has been read."""
    app.connect("doctree-read", mark)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
