"""Cost of a step, and the same problem solved by ready-made integrators.

Importing this package pins BLAS to one thread, so that it comes before numpy, and makes the module
of the meshes known.
"""

import os
import sys
import time
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


def cpu_seconds(work, *arguments, **options):
    """Result of a function, and the processor time that it took, s."""
    begin = time.process_time()
    return work(*arguments, **options), time.process_time() - begin
