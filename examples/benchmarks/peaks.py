"""Peaks of responses over the backbone: bars whose higher modes take part, and do not.

python examples/benchmarks/peaks.py            a minute
python examples/benchmarks/peaks.py --quick    one level
"""

import sys
from pathlib import Path

sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

from benchmarks import EXAMPLES, head, row

# isort: split

from skfem_joint import build_bar, load_scene, natural_modes
from skfem_joint.study.backbone_peaks import backbone_peaks
from skfem_joint.study.scene_response import scene_response

#: Density of the last 20 mm (kg/m³), and frequencies of the response (Hz).
BARS = {"uniform bar": (8e3, 2300.0, 2550.0), "bar with a tip mass": (320e3, 1050.0, 1200.0)}
LEVELS = (0.003, 0.01, 0.03)


def scene_of(density, low, high, levels):
    """The paper's bar under Coulomb's law with a damping ratio of 0.2 %."""
    strips = [("joint", 0.1, 100), ("linear", 0.48, 90), ("tip", 0.02, 4)]
    return load_scene(EXAMPLES / "structure_harmonic.toml").changed(
        mesh=build_bar(strips, {"fixed": 0.0, "junction": 0.1, "free_end": 0.6}),
        material={"regions": {"tip": {"density": density}}},
        joint={"law": "coulomb"},
        damping={"ratio": 0.002},
        models={"run": ["full"]},
        backbone={"levels": 12, "up_to": 0.9},
        response={"frequencies": {"from": low, "to": high, "points": 13}, "levels": levels},
    )


def main(arguments):
    levels = LEVELS[1:2] if "--quick" in arguments else LEVELS
    head("bar", "modes as", "level", "peak, Hz", "backbone there, Hz", "apart", "errors of both")
    for title, values in BARS.items():
        scene = scene_of(*values, levels)
        modes = natural_modes(scene.system(), 3, joints="stuck").frequencies
        ratios = " : ".join(f"{x:.3g}" for x in modes / modes[0])
        for p in backbone_peaks(scene_response(scene)):
            numbers = f"{p.frequency:.2f}", f"{p.backbone_frequency:.2f}"
            shares = f"{100 * p.apart:+.2g} %", f"{100 * p.error:.2g} %"
            row(title, ratios, f"{p.level:g}", *numbers, *shares)


if __name__ == "__main__":
    main(sys.argv[1:])
