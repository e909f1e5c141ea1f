"""Cost of a step, and the same problem solved by ready-made integrators.

Importing this package pins BLAS to one thread, so that it comes before numpy, and makes the module
of the meshes known.
"""

import os
import sys
import time
from argparse import ArgumentParser
from pathlib import Path

os.environ |= dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
EXAMPLES = Path(__file__).resolve().parents[1]
sys.path.append(str(EXAMPLES.parent / "meshes"))
#: Status of a package that an extra of the project installs.
NOT_INSTALLED = "not installed: pip install 'skfem-joint[bench]'"


def head(*cells):
    """Print the head of a table in Markdown."""
    row(*cells)
    row(*len(cells) * ["---"])


def row(*cells):
    """Print a row of a table in Markdown."""
    print(f"| {' | '.join(map(str, cells))} |", flush=True)


def run_parts(doc, parts, arguments, unnamed=()):
    """Run parts of a benchmark, functions of whether it is to be quick.

    Where none is named, those of ``unnamed`` or else all.
    """
    parser = ArgumentParser(description=doc.partition("\n")[0])
    parser.add_argument("parts", nargs="*", metavar="PART", help=", ".join(parts))
    parser.add_argument("--quick", action="store_true", help="smaller and fewer cases")
    options = parser.parse_args(arguments)
    if unknown := [name for name in options.parts if name not in parts]:
        parser.error(f"no part is called {unknown[0]}; there are: {', '.join(parts)}")
    for name in options.parts or unnamed or parts:
        parts[name](options.quick)
        print()


def cpu_seconds(work, *arguments, **options):
    """Result of a function, and the processor time that it took, s."""
    begin = time.process_time()
    return work(*arguments, **options), time.process_time() - begin
