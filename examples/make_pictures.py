"""Make the pictures of the gallery anew from the results of the examples.

    python examples/make_pictures.py                     all but those of LONG, some ten minutes
    python examples/make_pictures.py NAME ... --out DIR  some of them, elsewhere

Those of LONG come from benchmarks and are made where they are named.
"""

# %% What is drawn

import argparse
import runpy
import subprocess
import sys
from contextlib import chdir
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

from skfem_joint import active_region, load_scene, run_scene
from skfem_joint.files import replacing
from skfem_joint.output import folder, pictures, plots, series
from skfem_joint.output.fields import frames_of

HERE = Path(__file__).resolve().parent
#: Bytes above which a picture is brought to 256 colours.
LARGEST = 200_000
#: Pictures that running a scene writes: the scene, and the picture's name there.
SCENES = {
    "plate_bolts": ("plate_bolts", "joint"),
    "lap_joint_loop": ("lap_joint_reference", "hysteresis_free_end"),
    "scaled_modes": ("lap_joint_case_I", "proper_orthogonal_modes"),
    "histories": ("structure_harmonic", "histories"),
    "impulse": ("structure_impulse", "histories"),
    "plate_slip": ("plate_reference", "active_region_joint"),
    "two_plates_held": ("two_plates", "joint"),
    "solid_lap_joint": ("solid_lap_joint", "joint"),
}
#: Pictures that take long: a script with its arguments, and the picture's name.
READY_MADE = ("benchmarks/ready_made.py", str(HERE / "lap_joint_reference.toml"))
LONG = {
    "error_time": (READY_MADE, "error-time"),
    "total_time": (READY_MADE, "total-time"),
    "stability": (("stability/run.py",), "stability"),
    "paper": (("paper/reproduce.py", "fig19"), "pictures/fig19"),
}


def bolted(example):
    structure, patch = example["structure"], example["structure"].patches[0]
    region, points = active_region(structure, example["run"]), patch.points
    slips = region.slips[points]
    return plots.active_region_figure(structure.body, patch, region.slip_peak[points], slips)


def tips(example):
    runs = {f"friction limit {limit:g} N": run for limit, run in example["runs"].items()}
    return plots.histories_figure(runs, ["tip"])


def loops(example):
    runs = {name: example[name] for name in ("full", "reduced")}
    return plots.hysteresis_figure(runs, "free_end", 0, example["timing"]["steps_per_cycle"])


#: Pictures of the literate examples of the same name, made from the names that they define.
FIGURES = dict.fromkeys(("brake_reuss", "damping", "sweep"), lambda example: example["figure"])
FIGURES |= {
    "lap_joint": lambda example: plots.proper_values_figure(
        example["proper"], "the lap joint's three periods"
    ),
    "reduced_structure": loops,
    "own_basis": tips,
    "paper_by_hand": loops,
    "bolted_plates": bolted,
}


# %% How
@cache
def study(scene):
    """Results of a scene, without estimated errors."""
    return run_scene(load_scene(HERE / f"{scene}.toml").changed(accuracy={"estimate": False}))


def shown(scene):
    """Fields of a scene's models."""
    return frames_of(study(scene).structure, study(scene).runs)


def drawn(name, out):
    """Draw a picture; returns its file below ``out``."""
    picture = out / f"{name}.png"
    if name in LONG:
        (script, *arguments), file = LONG[name]
        command = sys.executable, HERE / script, *arguments, "--out", out / name
        subprocess.run(command, check=True)
        return out / name / f"{file}.png"
    if name in SCENES:
        scene, file = SCENES[name]
        if file == "joint":
            pictures.still(picture, shown(scene))
        else:
            folder.curves(study(scene))[f"{file}.png"](picture)
    elif name == "two_plates":
        runpy.run_path(str(HERE / "two_plates.py"))["main"](out)
    elif name == "paraview":
        frames, index = shown("plate_bolts"), out / "fields.pvd"
        series.write_series(index, frames)
        series.write_load(out / "fields_load.csv", frames)
        server = "xvfb-run", "-a", "-s", "-noreset", "pvpython"
        command = *server, HERE / "paraview_joint.py", index, picture, "--time", "4.5e-3"
        subprocess.run(command, check=True)
    else:
        run_name = "__main__" if name == "sweep" else "example"
        with chdir(out):  # it writes its picture where it is called
            example = runpy.run_path(str(HERE / f"{name}.py"), run_name=run_name)
        plots.save_figure(picture, FIGURES[name](example))
    return picture


SHORT = (*SCENES, *FIGURES, "two_plates", "paraview")


def main(arguments):
    from PIL import Image

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("names", nargs="*", metavar="NAME", help=", ".join([*SHORT, *LONG]))
    parser.add_argument("--out", type=Path, default=HERE / "pictures")
    given = parser.parse_args(arguments)
    if unknown := set(given.names) - {*SHORT, *LONG}:
        parser.error(f"no picture is called {', '.join(sorted(unknown))}")
    given.out.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory() as temporary:
        for name in given.names or SHORT:
            with Image.open(drawn(name, Path(temporary))) as picture:
                small = picture.convert("RGB")
                small.save(source := Path(temporary) / "small.png", optimize=True)
            if source.stat().st_size > LARGEST:
                few = {"method": Image.Quantize.MAXCOVERAGE, "dither": Image.Dither.NONE}
                small.quantize(256, **few).save(source, optimize=True)
            target = given.out / f"{name}.png"
            with replacing(target) as file:
                file.write_bytes(source.read_bytes())
            print(f"{target}: {target.stat().st_size / 1e3:.0f} kB", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
