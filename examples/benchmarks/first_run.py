"""The first run of a scene after an install, when nothing is compiled, and the second one.

    python examples/benchmarks/first_run.py                    three scenes, three rounds
    python examples/benchmarks/first_run.py NAME ...           these scenes of examples/
    python examples/benchmarks/first_run.py --quick            one scene, one round

Each run is `skfem-joint run` in a process of its own. The first one has an empty folder for
compiled code, the second one that of the first. Times are of the processor, of all threads and in
s, if they are not called wall; of several rounds the least. "Results" is when the first line of
them is printed.
"""

import os
import sys
from pathlib import Path

sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

from benchmarks import EXAMPLES, head, row

# isort: split

import argparse
import json
import resource
import subprocess
import time
from tempfile import TemporaryDirectory

SCENES = ("structure_harmonic", "plate_bolts", "solid_lap_joint")
#: Runs a scene, and writes what the process knows of its compilations and its output.
RUN = """
import json, sys, time
import numba
from numba.core.event import Listener, register

class Compilations(Listener):
    def __init__(self):
        self.names, self.depth, self.seconds = [], 0, 0.0

    def on_start(self, event):
        if self.depth == 0:
            self.begin = time.process_time()
        self.depth += 1
        self.names.append(event.data["dispatcher"].py_func.__qualname__)

    def on_end(self, event):
        self.depth -= 1
        if self.depth == 0:
            self.seconds += time.process_time() - self.begin

class Watched:
    def __init__(self, stream):
        self.stream, self.begin = stream, None

    def write(self, text):
        self.begin = self.begin or time.process_time()
        return self.stream.write(text)

    def __getattr__(self, name):
        return getattr(self.stream, name)

scene, out, told = sys.argv[1:]
made = Compilations()
register("numba:compile", made)
imported = time.process_time()
sys.stdout = shown = Watched(sys.stdout)
from skfem_joint import cli
status = cli.main(["run", scene, "--out", out])
with open(told, "w") as file:
    json.dump({
        "compilation": made.seconds, "compilations": len(made.names),
        "functions": len(set(made.names)), "results": shown.begin, "import": imported,
    }, file)
sys.exit(status)
"""


def run(scene, cache):
    """Times (s) and counts of one run of a scene."""
    with TemporaryDirectory() as folder:
        told, out = Path(folder, "told.json"), Path(folder, "out")
        places = os.pathsep.join([str(EXAMPLES.parent), os.environ.get("PYTHONPATH", "")])
        environment = os.environ | {"PYTHONPATH": places, "NUMBA_CACHE_DIR": cache}
        before, begin = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
        path = str(EXAMPLES / f"{scene}.toml")
        subprocess.run(  # -P: not the package of the current folder
            [sys.executable, "-P", "-c", RUN, path, out, told],
            env=environment, check=True, capture_output=True,
        )  # fmt: skip
        wall, after = time.perf_counter() - begin, resource.getrusage(resource.RUSAGE_CHILDREN)
        cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        return json.loads(told.read_text()) | {"cpu": cpu, "wall": wall}


def both(scene):
    """A first run and the second one."""
    with TemporaryDirectory() as cache:
        return run(scene, cache), run(scene, cache)


def main(arguments):
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("scenes", nargs="*", metavar="NAME", default=SCENES)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--quick", action="store_true")
    options = parser.parse_args(arguments)
    scenes, rounds = (SCENES[:1], 1) if options.quick else (options.scenes, options.rounds)
    head(
        "scene", "first run", "wall", "compilation", "compilations", "functions",
        "import of numba", "results", "second run", "wall", "results",
    )  # fmt: skip
    for scene in scenes:
        first, second = (
            {key: min(one[key] for one in each) for key in each[0]}
            for each in zip(*(both(scene) for _ in range(rounds)), strict=True)
        )
        times = [f"{first[key]:.1f}" for key in ("cpu", "wall", "compilation")]
        counts = first["compilations"], first["functions"], f"{first['import']:.2f}"
        later = [f"{second[key]:.1f}" for key in ("cpu", "wall", "results")]
        row(scene, *times, *counts, f"{first['results']:.1f}", *later)


if __name__ == "__main__":
    main(sys.argv[1:])
