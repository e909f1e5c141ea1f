"""Cost of a step, and the same problem solved by ready-made integrators."""

from pathlib import Path

EXAMPLES = Path(__file__).resolve().parents[1]
#: Status of a package that an extra of the project installs.
NOT_INSTALLED = "not installed: pip install 'skfem-joint[bench]'"


def head(*cells):
    """Print the head of a table in Markdown."""
    row(*cells)
    row(*len(cells) * ["---"])


def row(*cells):
    """Print a row of a table in Markdown."""
    print(f"| {' | '.join(map(str, cells))} |", flush=True)
