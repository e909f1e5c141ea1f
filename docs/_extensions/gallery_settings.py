"""How the gallery is ordered, how its scripts are run, and where their pictures come from."""

import re
import shutil
from functools import cache
from pathlib import Path
from typing import Any

import pyvista
from matplotlib import pyplot
from sphinx_gallery.scrapers import figure_rst, matplotlib_scraper

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"


@cache
def _listed() -> list[str]:
    """Scripts in the order in which the gallery's first page has them."""
    header = (EXAMPLES / "GALLERY_HEADER.txt").read_text(encoding="utf-8")
    return re.findall(r"examples/(\w+)\.py", header)


def order(script: str) -> tuple[int, str]:
    """Key by which the pages of scripts are sorted; those that are not listed come last."""
    name, listed = Path(script).stem, _listed()
    return (listed.index(name) if name in listed else len(listed)), name


def short_form(configuration: dict[str, Any], script: dict[str, Any]) -> list[str]:
    """Arguments of a script, which also knows its file, as when Python runs it."""
    script["example_globals"]["__file__"] = script["src_file"]
    return ["--short"]


def pictures(block: Any, block_vars: dict[str, Any], gallery_conf: dict[str, Any]) -> str:
    """Pictures that a script has written, ``NAME.png`` and ``NAME-2.png``, or else its figures."""
    script = Path(block_vars["src_file"])
    written = [
        path for name in ("", "-?") for path in script.parent.glob(f"{script.stem}{name}.png")
    ]
    if not written:
        return matplotlib_scraper(block, block_vars, gallery_conf)
    pyplot.close("all")  # what was drawn is written
    pyvista.close_all()
    shown = []
    for path in sorted(written):
        shown.append(next(block_vars["image_path_iterator"]))
        shutil.move(path, shown[-1])
    return figure_rst(shown, gallery_conf["src_dir"])


def without_plotters(gallery_conf: dict[str, Any], script: str) -> None:
    """Forget the plotters of the scripts before this one, of which none is left to be shown."""
    pyvista.close_all()
