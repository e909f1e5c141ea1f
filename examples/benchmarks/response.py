"""Responses of two bolted solid plates: what the whole command takes, and the errors it states.

    python examples/benchmarks/response.py [MODEL ...] [--workers 2] [--quick]

Models are reduced and condensed, both if none is named. The scene is ``solid_lap_joint.toml`` with
its model, 30 frequencies from 250 to 450 Hz and more at peaks, and three levels, as
``skfem-joint response`` computes it in a process of its own, start and pictures included. With
``--quick`` it is the bar of ``structure_harmonic.toml`` with 8 frequencies and one level.
"""

import argparse
import json
import os
import re
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

from benchmarks import EXAMPLES, head, row

# isort: split


#: Scene and its table ``[response]``; the quick one second.
CASES = (
    ("solid_lap_joint", "{ from = 250.0, to = 450.0, points = 30 }", "[0.3, 0.6, 1.0]"),
    ("structure_harmonic", "{ from = 2200.0, to = 2600.0, points = 8 }", "[0.03]"),
)
#: Errors that a summary states, and their titles.
ERRORS = {
    "displacement_rms": "history",
    "peak_displacement": "peak",
    "friction_energy": "friction energy",
}


def scene_of(name, frequencies, levels, model):
    """Text of a shipped scene with one model and a table ``[response]``."""
    text = (EXAMPLES / f"{name}.toml").read_text(encoding="utf-8")
    text = text.replace('"../meshes/', f'"{EXAMPLES.parent.as_posix()}/meshes/')
    text = re.sub(r"(?m)^run = .*$", f'run = ["{model}"]', text)
    return f"{text}\n[response]\nfrequencies = {frequencies}\nlevels = {levels}\n"


def command(text, folder, workers):
    """Run the command for a scene's text; its summary, seconds, and processor seconds."""
    file, out = folder / "scene.toml", folder / "out"
    file.write_text(text, encoding="utf-8")
    begin, before = time.perf_counter(), os.times()
    words = [sys.executable, "-m", "skfem_joint", "response", str(file), "--out", str(out), "-q"]
    words += ["--workers", str(workers)]
    subprocess.run(words, check=True, stdout=subprocess.DEVNULL)
    wall, after = time.perf_counter() - begin, os.times()
    used = after.children_user + after.children_system
    used -= before.children_user + before.children_system
    return json.loads((out / "summary.json").read_text(encoding="utf-8")), wall, used


def main(arguments):
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="a bar, few frequencies")
    parser.add_argument("--workers", type=int, default=1, help="processes")
    parser.add_argument("models", nargs="*", metavar="MODEL", help="reduced, condensed")
    options = parser.parse_args(arguments)
    costs, levels = [], []
    for model in options.models or ("reduced", "condensed"):
        with TemporaryDirectory() as folder:
            summary, wall, used = command(
                scene_of(*CASES[options.quick], model), Path(folder), options.workers
            )
        of_model = summary["models"][model]
        found = sum(level["frequencies"] for level in of_model["levels"])
        costs.append((model, found, of_model["offline_s"], of_model["wall_s"], wall, used))
        levels += [(model, level) for level in of_model["levels"]]
    head(
        "model",
        "frequencies of all levels",
        "made in, s",
        "curves, s",
        "command, s",
        "of processor, s",
    )
    for model, found, *seconds in costs:
        row(model, found, *(f"{x:.3g}" for x in seconds))
    print()
    head(
        "model",
        "level",
        "peak, mm",
        "at, Hz",
        "largest error of the step",
        *(f"{e} at peak" for e in ERRORS.values()),
    )
    for model, level in levels:
        errors = (level["estimated_error"].get(name) for name in ERRORS)
        row(
            model,
            f"{level['level']:g}",
            f"{1e3 * level['peak_amplitude_m']:.4g}",
            f"{level['peak_frequency_Hz']:.4g}",
            f"{100 * level['largest_step_error']:.2g} %",
            *("-" if error is None else f"{100 * error:.2g} %" for error in errors),
        )


if __name__ == "__main__":
    main(sys.argv[1:])
