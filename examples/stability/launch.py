"""Command lines of the scripts in this folder, and the program in processes of its own."""

import argparse
import os
import subprocess
import sys
import time
from pathlib import Path

#: Seconds after which a command is taken to hang.
PATIENCE = 300.0


def command_line(doc, **numbers):
    """Parser of ``--out`` and of whole numbers, which are given with their defaults."""
    parser = argparse.ArgumentParser(description=doc.splitlines()[0])
    parser.add_argument("--out", type=Path, required=True, help="folder for runs and what breaks")
    for name, default in numbers.items():
        parser.add_argument(f"--{name}", type=int, default=default)
    return parser


def launch(scene, out, *more):
    """Run a scene by the command line in a process of its own, BLAS on one thread."""
    started = [sys.executable, "-P", "-m", "skfem_joint"]  # -P: not from the current folder
    pipe, threads = subprocess.PIPE, ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
    return subprocess.Popen(
        [*started, "run", str(scene), "--out", str(out), *more],
        stdout=pipe,
        stderr=pipe,
        text=True,
        env=os.environ | dict.fromkeys(threads, "1"),
    )


def complete(scene, out, *more):
    """Run a scene to its end; returns its time (s), and what is wrong if its status is not 0."""
    begin = time.perf_counter()
    process = launch(scene, out, *more)
    _, said = process.communicate(timeout=PATIENCE)
    seconds, status = time.perf_counter() - begin, process.returncode
    return seconds, f"status {status}: {said}" if status else ""
