"""Runs that are killed at random moments and resumed, and runs that share a folder.

    python examples/stability/killed.py --out DIR [--kills 100] [--pairs 20] [--rows 30] [--seed 0]

Six kinds of scenes are run by the command line. Killed with SIGKILL at any moment, a third of them
while they write their results, and resumed, they must leave every file as an uninterrupted run
does, bit for bit but for times. Of two runs of the first kind into one folder that start at about
the same moment one is refused in a sentence, or they follow each other.
The exit status is 1 if anything differs.
"""

import json
import re
import sys
import time
from pathlib import Path
from shutil import rmtree
from typing import Any, NamedTuple

sys.path.insert(0, str(Path(__file__).parents[1]))

import numpy as np
from benchmarks import EXAMPLES, head, row

from skfem_joint.output.record import LIST
from stability.launch import PATIENCE, command_line, complete, launch

#: Source scene, times, models and reduction of each kind.
KINDS = {
    "bar": ("structure_harmonic", "cycles = 60", '"full"', ""),
    "impulse": ("structure_impulse", "duration = 6e-3\nstep = 1e-6", '"full"', ""),
    "plate": ("plate_reference", "cycles = 1\nsteps_per_cycle = 40", '"full"', ""),
    "two plates": ("two_plates", "cycles = 1\nsteps_per_cycle = 40", '"full"', ""),
    "reduced": ("structure_harmonic", "cycles = 40", '"full", "reduced"', 'friction_points="all"'),
    "hyper-reduced": ("structure_harmonic", "cycles = 200", '"reduced"', "friction_points = 20"),
}


def scene_text(kind):
    """Text of the scene file of a kind; files of its mesh have absolute paths."""
    name, times, models, reduction = KINDS[kind]
    text = (EXAMPLES / f"{name}.toml").read_text(encoding="utf-8")
    text = text.replace("../meshes", (EXAMPLES.parent / "meshes").as_posix())
    own = ("[time]", "[models]", "[reduction]", "[output]")
    kept = [table for table in re.split(r"(?m)^(?=\[)", text) if not table.startswith(own)]
    own = f"[time]\n{times}\n[models]\nrun = [{models}]\n[reduction]\nmodes = 5\n{reduction}\n"
    return "".join(kept) + own + "[output]\nvtk = true\nplots = false\nframes = 60\n"


def content(folder):
    """Content of the files of a folder by their names, without the times that runs took."""
    files = {}
    for path in folder.rglob("*"):
        name = path.relative_to(folder).as_posix()
        if path.suffix == ".json":
            files[name] = _timeless(json.loads(path.read_text(encoding="utf-8")))
        elif path.suffix == ".npz":
            with np.load(path, allow_pickle=False) as arrays:
                files[name] = {key: arrays[key].tobytes() for key in arrays}
        elif path.is_file() and path.name != LIST:  # which has times
            files[name] = path.read_bytes()
    return files


def _timeless(value):
    if not isinstance(value, dict):
        return value
    times = "wall_s", "offline_s", "estimate_s", "compilation_s"
    return {key: _timeless(part) for key, part in value.items() if not key.endswith(times)}


def differing(folder, whole):
    """Names of files that differ from those of an uninterrupted run, in words; empty if none."""
    files = content(folder)
    names = sorted(name for name in {*files, *whole} if files.get(name) != whole.get(name))
    return f"differ {', '.join(names[:5])}" if names else ""


class Whole(NamedTuple):
    """An uninterrupted run: its scene, its files, and the times (s) that it ran and wrote."""

    scene: Path
    files: dict[str, Any]
    seconds: float
    writing: float


def uninterrupted(kind, folder):
    """Run a kind once to compile its code, and once to measure it."""
    folder.mkdir(parents=True, exist_ok=True)
    scene, out = folder / f"{kind.replace(' ', '_')}.toml", folder / "whole"
    scene.write_text(scene_text(kind), encoding="utf-8")
    for _ in range(2):
        rmtree(out, ignore_errors=True)
        seconds, wrong = complete(scene, out)
        if wrong:
            raise RuntimeError(f"{kind}: {wrong}")
    times = [path.stat().st_mtime for path in out.rglob("*") if path.is_file()]
    return Whole(scene, content(out), seconds, max(times) - min(times))


def kill(whole, out, resumed, rng, writing):
    """Start or resume a run and kill it at a random moment; returns whether it still ran."""
    process = launch(whole.scene, out, *resumed)
    try:
        if writing:
            end, begun = time.monotonic() + PATIENCE, out / LIST
            while process.poll() is None and time.monotonic() < end and not begun.exists():
                time.sleep(0.001)
            time.sleep(rng.uniform(0.0, whole.writing))
        else:
            time.sleep(rng.uniform(0.2, 1.0) * whole.seconds)
    finally:
        process.kill()
        _, said = process.communicate()
    if process.returncode > 0:
        raise RuntimeError(f"{whole.scene}: status {process.returncode}: {said}")
    return process.returncode < 0


def kills(whole, every, count, rng):
    """Kill runs; returns the numbers of kills and of kills while writing, and what is wrong."""
    out, resumed = whole.scene.parent / "out", (f"--checkpoint-every={every}", "--resume")
    killed = wrote = 0
    while killed < count:
        rmtree(out, ignore_errors=True)
        again = True
        while again and killed < count:
            writing = 3 * wrote < killed + 1
            if not kill(whole, out, resumed, rng, writing):
                break
            killed, wrote = killed + 1, wrote + writing
            again = rng.integers(2)
        _, wrong = complete(whole.scene, out, *resumed)
        if wrong := wrong or differing(out, whole.files):
            return killed, wrote, wrong
    return killed, wrote, ""


def pairs(whole, count, rng):
    """Start two runs into the same folder, or the second into a folder below it.

    Returns the number of refused runs, and what is wrong.
    """
    refused, out = 0, whole.scene.parent / "pairs"
    for number in range(count):
        rmtree(out, ignore_errors=True)
        below = out / "below" if number % 4 == 3 else out
        runs = [launch(whole.scene, out)]
        time.sleep(rng.uniform(0.0, 0.6 * whole.seconds))
        runs.append(launch(whole.scene, below))
        said = [run.communicate(timeout=PATIENCE)[1] for run in runs]
        status = sorted(run.returncode for run in runs)
        if status == [0, 2] and any("another run" in text for text in said) and below == out:
            refused += 1
        elif status != [0, 0]:
            return refused, f"pair {number}: status {status}: {' '.join(said)}"
        differ = ""
        if below != out:
            differ = differing(below, whole.files)
            rmtree(below)
        if differ := differ or differing(out, whole.files):
            return refused, f"pair {number}: {differ}"
    return refused, ""


def main(arguments=None):
    """Kill and pair runs; returns 1 if anything differs."""
    parser = command_line(__doc__, kills=100, pairs=20, seed=0)
    parser.add_argument("--kinds", nargs="*", choices=KINDS, default=list(KINDS))
    options = parser.parse_args(arguments)
    rng, wrong, wholes = np.random.default_rng(options.seed), [], []
    head("kind", "kills", "of these while it wrote", "after resuming")
    for number, kind in enumerate(options.kinds):
        count = len(range(number, options.kills, len(options.kinds)))
        wholes.append(uninterrupted(kind, options.out / f"kind{number}"))
        # Steps between checkpoints, several of which must be in a run.
        every = 4 if "plate" in kind else 500
        killed, wrote, what = kills(wholes[-1], every, count, rng)
        row(kind, killed, wrote, what or "the same to the bit")
        wrong.append(what)
    if options.pairs:
        refused, what = pairs(wholes[0], options.pairs, rng)
        print(f"\n{options.pairs} pairs of runs, {refused} refused: {what or 'every file right'}")
        wrong.append(what)
    return int(any(wrong))


if __name__ == "__main__":
    sys.exit(main())
