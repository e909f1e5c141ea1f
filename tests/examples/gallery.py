"""Scripts of the gallery, and how a test runs one."""

import runpy
import sys
from pathlib import Path
from typing import Any

EXAMPLES = Path(__file__).parents[2] / "examples"
#: Names of the scripts; ParaView runs the one that is not among them.
SCRIPTS = tuple(sorted({path.stem for path in EXAMPLES.glob("*.py")} - {"paraview_joint"}))


def run_script(name: str, *, short: bool = True) -> dict[str, Any]:
    """Run a script as the command line does; returns the names that it defines."""
    from matplotlib import pyplot

    path, before = str(EXAMPLES / f"{name}.py"), sys.argv
    sys.argv = [path, *["--short"] * short]
    try:
        return runpy.run_path(path, run_name="__main__")
    finally:
        sys.argv = before
        pyplot.close("all")
