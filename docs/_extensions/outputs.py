"""Printed output on the pages: sentences wrap, tables keep their columns and scroll."""

import re

from docutils import nodes

_RULE = re.compile(r"^-{20,}$", re.MULTILINE)


def mark(app, document):
    """Give each block of printed sentences the class ``wraps``, which the style sheet wraps."""
    for block in document.findall(nodes.literal_block):
        if block.get("language") == "text" and not _RULE.search(block.astext()):
            block["classes"].append("wraps")


def setup(app):
    """Mark the blocks of each page when it has been read."""
    app.connect("doctree-read", mark)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
