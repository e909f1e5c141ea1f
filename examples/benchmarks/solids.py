"""Cost of a step of two bolted solid plates, full, condensed and reduced; their damping curve.

    python examples/benchmarks/solids.py            about 30,000 unknowns, 600 contact points
    python examples/benchmarks/solids.py --large    100,000 in full: the memory that it takes
    python examples/benchmarks/solids.py --quick    2,000

The scene is ``examples/solid_lap_joint.toml`` on bricks of second order: a lap joint of two plates
under two bolts, pulled by half of its friction limit; 40 mm wide, without holes, pressed by rings.
It runs from rest, three periods of 200 steps, with exact Coulomb friction in the full and in the
condensed model. BLAS threads are pinned. Errors, in percent, are against the full model, as
measured and as stated without it. Off-line time is all time before the first step, but for the
factors of the static path, which are left from the description of the scene.
"""

import sys
import time
import tomllib
from pathlib import Path

sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

from benchmarks import EXAMPLES, head, row

# isort: split

from resource import RUSAGE_SELF, getrusage

from skfem_joint import backbone, build_box, merged, run_scene
from skfem_joint.scene import scene_from

WIDTH, LEVELS = 0.04, 20
#: Elements along the overlap and along the rest of each plate, across, and through its thickness;
#: periods, and steps of each.
SIZES = {
    "": ((42, 2, 10, 1), 3, 200),
    "--large": ((36, 8, 10, 4), 1, 20),
    "--quick": ((12, 2, 3, 1), 2, 40),
}


def plates(elements, cycles, steps, reach=0.01, order=2, contact="constant", amplitude=6e3):
    lap, rest, across, deep = elements
    strips = ("upper_rest", 0.1, rest), ("upper_lap", 0.1, lap)
    others = ("lower_lap", 0.1, lap), ("lower_rest", 0.1, rest)
    size, count = (WIDTH, 0.01), (across, deep)
    upper = {"upper_end": "left", "upper_contact": ("front", "upper_lap")}
    lower = {"lower_end": "right", "lower_contact": ("back", "lower_lap")}
    above = build_box(strips, size, count, origin=(0.0, 0.0, 0.01), order=order, boundaries=upper)
    below = build_box(others, size, count, origin=(0.1, 0.0, 0.0), order=order, boundaries=lower)
    bolt = {"force": 20e3, "head_radius": 0.0075, "hole_radius": 0.0045}
    bolts = [{"at": [x, 0.5 * WIDTH, 0.01], **bolt} for x in (0.125, 0.175)]
    scene = tomllib.loads((EXAMPLES / "solid_lap_joint.toml").read_text(encoding="utf-8"))
    scene["joint"][0]["contact"] = contact
    scene["load"][0]["amplitude"] = amplitude
    scene["joint"][0]["pressure"] = {"reach": reach, "bolts": bolts}
    scene["time"] = {"steps_per_cycle": steps, "cycles": cycles}
    scene["models"] = {"run": ["full", "condensed", "reduced"]}
    scene["reduction"] = {"modes": 44, "friction_points": 30}
    scene["output"] = {"plots": False, "vtk": False}
    del scene["bolt"]
    return scene_from(scene, merged([above, below]))


def percent(error):
    return "" if error is None else f"{100.0 * abs(error):.3f}"


def report(scene, made):
    """Print a scene that took ``made`` (s) to build: table, damping curves and memory taken."""
    system = scene.system()
    print(
        f"{system.n} unknowns, {system.contact.count} contact points, made in {made:.1f} s with "
        f"the modes that the damping ratio needs\n"
    )
    head(
        *("model", "unknowns", "off-line, s", "ms a step", "times faster", "history, %"),
        *("friction, %", "stated history, %", "friction, %", "estimate, s"),
    )
    study = run_scene(scene)
    steps = {
        name: model.run.wall_s / model.run.counters.steps for name, model in study.models.items()
    }
    for name, model in study.models.items():
        cells = [name, model.run.system.n, f"{model.offline_s:.1f}"]
        cells += [f"{1e3 * steps[name]:.3f}", f"{steps['full'] / steps[name]:.1f}"]
        kinds = "displacement_rms", "friction_energy_per_cycle"
        cells += [percent(getattr(model.errors, kind, None)) for kind in kinds]
        estimate = model.estimate
        # Estimated without the full model, although it was run beside this one.
        known = {} if estimate is None else estimate.unmeasured or estimate.on_its_mesh
        stated = [known.get(kind) for kind in ("displacement_rms", "friction_energy")]
        cells += [*map(percent, stated), f"{model.estimate_s:.1f}"]
        row(*cells)
    print()
    for name in [name for name in ("full", "condensed") if len(study.models) > 1]:
        begin = time.perf_counter()
        (curve,) = backbone(study.models[name].run.system, levels=LEVELS)
        print(
            f"- damping curve, {name}: {LEVELS} levels in {time.perf_counter() - begin:.1f} s, "
            f"from {curve.frequency[0]:.2f} Hz, {100.0 * curve.damping_ratio[0]:.3f} % to "
            f"{curve.frequency[-1]:.2f} Hz, {100.0 * curve.damping_ratio[-1]:.3f} %"
        )
    print(f"- memory taken: {getrusage(RUSAGE_SELF).ru_maxrss / 2**20:.3g} GiB")
    print(*(f"- {said}" for said in study.notes), sep="\n")


def main(arguments):
    size = next(iter(arguments), "")
    begin = time.perf_counter()
    scene = plates(*SIZES[size])
    scene.system()
    made = time.perf_counter() - begin
    alone = {"models": {"run": ("full",)}, "accuracy": {"estimate": False}}
    report(scene.changed(**alone) if size == "--large" else scene, made)


if __name__ == "__main__":
    main(sys.argv[1:])
