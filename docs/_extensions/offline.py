"""Check of the built pages: nothing is loaded from a network where a page is read."""

import re
from pathlib import Path

from sphinx.application import Sphinx
from sphinx.util import logging

_log = logging.getLogger(__name__)
#: What a browser loads by itself, unlike the link of a text.
_LOADED = re.compile(
    r"""<(?:script|link|img|source|iframe|video|object)\b[^>]*?\b(?:src|href|data|srcset)\s*=\s*"""
    r"""["']?(?:https?:)?//[^"'\s>]+|url\(\s*["']?(?:https?:)?//[^)]+|@import\s+["'][^"']*//[^"']+"""
)


def check(app: Sphinx, error: Exception | None) -> None:
    """Warn of each address that a page or a style sheet loads; with ``-W`` the build fails."""
    if error is not None or app.builder.name != "html":
        return
    folder = Path(app.outdir)
    for file in sorted([*folder.rglob("*.html"), *folder.rglob("*.css")]):
        if "mathjax" in file.parts:
            continue
        for found in dict.fromkeys(_LOADED.findall(file.read_text(encoding="utf-8"))):
            _log.warning("%s loads from the network: %s", file.relative_to(folder), found)


def setup(app: Sphinx) -> dict[str, bool]:
    """Check when the build has ended."""
    app.connect("build-finished", check)
    return {"parallel_read_safe": True}
