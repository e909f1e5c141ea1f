"""Thin Brake-Reuss beam whose faces are bowed: frequency and damping over the bow.

    python examples/benchmarks/bowed_beam.py             eleven bows, some six minutes
    python examples/benchmarks/bowed_beam.py --quick     three bows on a coarse mesh

The gap between the faces, of both together, is a parabola over the lap of 120 mm. A positive bow
has the faces touch in the middle, with that gap at both ends, before the bolts are tightened; a
negative one has them touch at the ends, with the gap in the middle. All else is that of
``examples/measured/thin_beam.toml``, with friction and viscous damping as they were fitted to the
ring-down below 10 m/s2 with flat faces; only the mesh is coarser. Two bows are computed on the mesh
of that file too, and two with contact that opens.
"""

import sys
import time
from dataclasses import replace
from pathlib import Path

sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

from benchmarks import EXAMPLES, head, row

# isort: split

import matplotlib.pyplot as plt
import numpy as np
from make_meshes import INCH, brake_reuss

import skfem_joint as sj
from skfem_joint.structure.parameters import with_values

#: As `examples/measured_beam.py` fits them with flat faces.
FRICTION, DAMPING = 0.689, 5.38e-6  # 1, s
#: Gaps at the ends of the lap, or in its middle (negative), m.
BOWS = np.array([-20, -10, -5, 0, 5, 10, 20, 50, 100, 200, 400]) * 1e-6
#: Of them those that the mesh of the measured beam computes too.
FINER = np.array([0.0, 20e-6])
#: Of them those that are computed with contact that opens too.
OPENING = np.array([-20e-6, 0.0])
#: Half the length of the lap, m.
HALF = 0.06
#: Frequency of the smallest measured amplitude, Hz, and amplitudes that are compared, m/s2.
MEASURED, AMPLITUDES = 80.57, (1.0, 5.0, 10.0, 20.0)
#: About the amplitudes that are reached, m/s2.
REACHED = np.array([0.7, 1.4, 3.5, 7.0, 12.0, 24.0])


def shape(x, side):
    """Gap of a bow of 1 m at places (k, 3): open at the ends of the lap, or in its middle."""
    along = np.minimum((x[:, 0] / HALF) ** 2, 1.0)
    return along if side > 0.0 else 1.0 - along


def beam(flat, mesh, contact="constant"):
    """Structures of the beam with bows of 1 m, scaled to nothing, by the sign of the bow."""
    made = {}
    for side in (1.0, -1.0):
        bowed = {"gap": lambda x, side=side: shape(x, side), "gap_scale": 0.0, "contact": contact}
        joint = replace(flat.joints[0], friction=FRICTION, **bowed)
        made[side] = replace(flat, mesh=mesh, joints=[joint], stiffness_damping=DAMPING)
    return made


def coarser(quick):
    """Mesh with fewer circles of nodes around the bolts, on which contact ends, and one layer."""
    rings = () if quick else (0.0098, 0.0106, 0.0112, 0.0118)
    sizes = {"thickness": 0.5 * INCH, "sensor": 3 * INCH}
    return brake_reuss(2 if quick else 3, (4, 2), rings=rings, **sizes)


def rows(structures, bows, scene, note=""):
    """Print a row for each bow; stuck frequency and damping (bows, amplitudes)."""
    found, levels = [], None
    for bow in bows:
        side = 1.0 if bow >= 0.0 else -1.0
        # The contact of the last bow is where the search for that of the next one begins.
        structures[side] = with_values(structures[side], {"joint[0].gap_scale": abs(float(bow))})
        structure = structures[side]
        (pressed,) = structure.preload.joints
        touches = pressed.force > 0.0
        share = pressed.area[touches].sum() / pressed.area.sum()
        reach = np.abs(structure.nodes[touches, 0]).max()
        system = structure.system(scene.loads(), ["sensor"])
        at = system.points.index("sensor.z")
        if levels is None:  # accelerations over that of the mode of unit mass
            mode = sj.natural_modes(system, 7, joints="stuck").modes[:, 6]
            levels = REACHED / abs((system.P @ mode)[at])
        (curve,) = sj.backbone(system, modes=[7], levels=levels)
        amplitude = np.abs(curve.displacement[:, at]) * (2.0 * np.pi * curve.frequency) ** 2
        shift, damping = (
            np.interp(AMPLITUDES, amplitude, values)
            for values in (curve.frequency - curve.stuck_frequency, 100.0 * curve.damping_ratio)
        )
        found.append((curve.stuck_frequency, *damping))
        row(
            *(f"{1e6 * bow:g}{note}", f"{100.0 * share:.1f}", f"{1e3 * reach:.1f}"),
            *(f"{1e6 * pressed.gap.max():.2f}", f"{curve.stuck_frequency:.2f}"),
            *(f"{s:+.3f} Hz, {d:.3f} %" for s, d in zip(shift, damping, strict=True)),
        )
    return np.array(found)


def main(arguments):
    """Table of frequency, damping and contact over the bow, and a picture of the first two."""
    begin, quick = time.perf_counter(), "--quick" in arguments
    scene = sj.load_scene(EXAMPLES / "measured" / "thin_beam.toml")
    flat = scene.structure()
    bows = BOWS[[1, 3, 5]] if quick else BOWS
    head(
        *("bow, µm", "touches, %", "to, mm", "largest gap, µm", "stuck, Hz"),
        *(f"{a:g} m/s²" for a in AMPLITUDES),
    )
    coarse = coarser(quick)
    structures = beam(flat, coarse)
    unknowns = [structures[1.0].n_dofs]
    found = rows(structures, bows, scene)
    if not quick:
        rows(beam(flat, coarse, "unilateral"), OPENING, scene, " (opens)")
        finer = beam(flat, flat.mesh)
        unknowns.append(finer[1.0].n_dofs)
        rows(finer, FINER, scene, " (finer mesh)")
    drawn(bows, found[:, 0], found[:, 1:])
    sizes = " and ".join(map(str, unknowns))
    print(f"\n- {sizes} degrees of freedom; {time.perf_counter() - begin:.0f} s.")


def drawn(bows, stuck, damping):
    """Draw stuck frequency and damping over the bow."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(9.0, 3.6), layout="constrained")
    place, top = 1e6 * bows, 90.0
    left.plot(place, np.where(stuck < top, stuck, np.nan), "o-", label="model")
    for bow, frequency in zip(place[stuck > top], stuck[stuck > top], strict=True):
        left.annotate(f"{frequency:.0f} Hz", (bow, top - 0.5), (bow, top - 2.0),
                      arrowprops={"arrowstyle": "->"}, ha="left")  # fmt: skip
    left.axhline(MEASURED, color="0.4", ls="--", label="measured")
    left.set_ylim(80.0, top)
    left.set_ylabel("frequency with the joint stuck, Hz")
    left.legend()
    for amplitude, values in zip(AMPLITUDES, damping.T, strict=True):
        right.plot(place, values, "o-", label=f"{amplitude:g} m/s²")
    right.set_yscale("log")
    shares = [0.15, 0.2, 0.3, 0.5, 1.0, 2.0, 3.0]
    right.set_yticks(shares, map(str, shares))
    right.minorticks_off()
    right.set_ylabel("damping ratio, %")
    right.legend(title="amplitude")
    for panel in (left, right):
        panel.set_xlabel("bow, µm (< 0: touching at the ends)")
        panel.set_xscale("symlog", linthresh=20.0)
        shown = [bow for bow in place if abs(bow) not in (5.0, 200.0)]
        panel.set_xticks(shown, [f"{bow:g}" for bow in shown])
        panel.grid(alpha=0.3)
    figure.savefig("bowed_beam.png", dpi=120)


if __name__ == "__main__":
    main(sys.argv[1:])
