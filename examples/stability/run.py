"""Stiff and extreme cases of bars and of plates: each is right, or refused with a reason.

    python examples/stability/run.py --out DIR            all cases, a few minutes
    python examples/stability/run.py --out DIR --quick    a few of each kind

Writes a page, a table of all cases and a picture; the exit status is 1 if a case is wrong.
"""

import argparse
import sys
import time
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[1]))

from skfem_joint.ground.errors import JointError
from skfem_joint.ground.progress import progress_bar
from skfem_joint.output.folder import kept
from skfem_joint.output.record import writing
from stability import judge, report
from stability.cases import matrix, quick_matrix


def main(arguments=None):
    """Judge the matrix; returns 1 if a case is wrong in silence."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="folder for the page")
    parser.add_argument("--quick", action="store_true", help="a few cases of each kind only")
    parser.add_argument("--overwrite", action="store_true", help="replace files of other origin")
    options = parser.parse_args(arguments)
    try:
        # A folder that cannot be written to is refused before anything is computed.
        with kept(options.out, overwrite=options.overwrite):
            begin = time.perf_counter()
            with progress_bar() as progress:
                verdicts = judge.judge_all(quick_matrix() if options.quick else matrix(), progress)
            return tell(options.out, verdicts, time.perf_counter() - begin)
    except JointError as error:
        print(f"error: {error}", file=sys.stderr)
        return error.exit_status


def tell(folder, verdicts, seconds):
    """Write and print the outcomes; returns 1 if a case is wrong in silence."""
    with writing(folder, {"title": "Stability", "seconds": seconds}) as written:
        files = [*report.write(folder, verdicts, seconds), written]
    wrong = [verdict for verdict in verdicts if verdict.outcome == judge.WRONG]
    print(report.summary(verdicts))
    for verdict in wrong:
        print(f"{judge.WRONG}: {verdict.case.axis}, {verdict.case.value}: {verdict.reason}")
    print(f"\n{report.bottom_line(verdicts, seconds)}")
    print(f"Written to {folder}: {', '.join(file.name for file in files)}")
    return int(bool(wrong))


if __name__ == "__main__":
    sys.exit(main())
