"""How far arctan laws are from Coulomb's: stated beside runs of the full model under both laws.

    python examples/benchmarks/laws.py            bars
    python examples/benchmarks/laws.py --quick    two of them
    python examples/benchmarks/laws.py plates     plates too, five minutes

Relative to Coulomb's law: the friction energy of the last cycle, or of a pulse, in percent.
"""

import sys
from pathlib import Path

sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

from benchmarks import EXAMPLES, head, row

# isort: split

import numpy as np

from skfem_joint import load_scene, run_scene
from skfem_joint.accuracy.estimate import verification_run
from skfem_joint.results.history import difference, results
from skfem_joint.study.models import plan_of

HARMONIC, IMPULSE = "structure_harmonic", "structure_impulse"
#: What is shown: a shipped scene, its beta (s/m), and other values of its load and time.
BARS = (
    ("bar of the paper, 500 Hz", HARMONIC, 1e5, {}, {}),
    ("the same", HARMONIC, 1e3, {}, {}),
    ("the same, 5 Hz", HARMONIC, 1e5, {"frequency": 5.0}, {"cycles": 3}),
    ("the same, 0.1 Hz", HARMONIC, 1e5, {"frequency": 0.1}, {"cycles": 3}),
    ("bar of the paper, pulse", IMPULSE, 1e5, {}, {}),
    ("the same", IMPULSE, 1e3, {}, {}),
)
PLATES = (
    ("plate with two bolts, 500 Hz", "plate_bolts", 1e5, {}, {}),
    ("the same, 100 Hz", "plate_bolts", 1e5, {"frequency": 100.0}, {}),
    ("the same, less load", "plate_bolts", 1e5, {"frequency": 100.0, "amplitude": 4e3}, {}),
    ("two plates", "two_plates", 1e5, {}, {}),
)


def true(scene):
    """Difference of the friction energy of two full runs."""
    system, plan = scene.system(), plan_of(scene)
    both = (verification_run(each, plan) for each in (system.with_beta(np.inf), system))
    return difference(*map(results, both))["friction_energy"]


def stated(scene, model):
    """Difference that one model states, and its total error."""
    study = run_scene(scene.changed(models={"run": [model]}))
    errors = study.finished().models[model].estimate
    return [errors.of(source, "friction_energy") for source in ("coulomb", "total")]


def main(arguments):
    head("scene", "beta, s/m", "true", "full model states", "reduced model states", "its total")
    chosen = BARS[3:5] if "--quick" in arguments else BARS
    for title, name, beta, load, time in (*chosen, *(PLATES if "plates" in arguments else ())):
        scene = load_scene(EXAMPLES / f"{name}.toml").changed(joint={"beta": beta})
        scene = scene.changed(load=load, time=time, output={"plots": False, "vtk": False})
        values = [true(scene), stated(scene, "full")[0], *stated(scene, "reduced")]
        row(title, f"{beta:g}", *(f"{100 * value:.3g} %" for value in values))


if __name__ == "__main__":
    main(sys.argv[1:])
