"""Scripts of the gallery, and how a test runs one."""

import runpy
import sys
from contextlib import chdir
from pathlib import Path
from typing import Any

EXAMPLES = Path(__file__).parents[2] / "examples"
#: Names of the scripts; ParaView runs the one that is not among them.
SCRIPTS = tuple(sorted({path.stem for path in EXAMPLES.glob("*.py")} - {"paraview_joint"}))


def run_script(name: str, folder: Path) -> dict[str, Any]:
    """Run the short form of a script in a folder as the command line does; returns its names."""
    from matplotlib import pyplot

    path, before = str(EXAMPLES / f"{name}.py"), sys.argv
    sys.argv = [path, "--short"]
    try:
        with chdir(folder):
            return runpy.run_path(path, run_name="__main__")
    finally:
        sys.argv = before
        pyplot.close("all")
