"""Backbone of the Brake-Reuss beam with contact that opens, beside published ends and times.

    python examples/benchmarks/brake_reuss.py             20 levels, some two minutes
    python examples/benchmarks/brake_reuss.py --quick     three levels
    python examples/benchmarks/brake_reuss.py --finer     a mesh twice as fine in the contact

The published curves (tmd-lab/tmdsimpy, ``examples/structures/results/brb_epmc_*.yaml``) are of an
extended periodic motion, with rough contact of asperities that yield, friction 0.03, and bolts of
12.0 to 12.7 kN.
"""

import sys
from pathlib import Path

sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

from benchmarks import EXAMPLES, cpu_seconds, head, row

# isort: split

import numpy as np
from make_meshes import brake_reuss

import skfem_joint as sj

MESH, FRICTION, FORCE = EXAMPLES.parent / "meshes" / "brake_reuss.msh", 0.03, 12e3  # N
#: Of flat faces and of measured topography: the ends of displacement (m), Hz, and damping (%).
PUBLISHED = {
    "published, flat faces": ((9.7e-8, 168.5, 0.087), (6.74e-5, 156.7, 3.06)),
    "published, measured topography": ((9.7e-8, 180.6, 0.088), (6.74e-5, 162.1, 3.94)),
}
#: Displacements at which curves are compared, m.
PLACES = (6e-6, 1e-5, 2e-5, 4e-5, 6.74e-5, 1e-4)


def beam(contact, mesh=MESH):
    """Structure of the beam with a kind of contact, see `meshes/make_meshes.py`."""
    joint = sj.Joint("upper_face", "preload", FRICTION, against="lower_face", contact=contact)
    return sj.Structure(
        mesh,
        sj.Material(E=200e9, density=7800.0, poisson=0.29),
        joints=[joint],
        bolts=[sj.Clamp(FORCE, shank=(f"upper_cut_{i}", f"lower_cut_{i}")) for i in (1, 2, 3)],
        free=True,
    )


def main(arguments):
    """Both curves as a table, and what they take."""
    levels = 3 if "--quick" in arguments else 20
    mesh = brake_reuss(4) if "--finer" in arguments else MESH
    head("contact", "stuck, Hz", *(f"{1e6 * x:.3g} um" for x in PLACES))
    seconds, notes = {}, []
    for contact in ("constant", "unilateral"):
        system = beam(contact, mesh).system(points=["upper_end"])
        (curve,), seconds[contact] = cpu_seconds(sj.backbone, system, modes=[7], levels=levels)
        reach = np.abs(curve.displacement).max(axis=1)
        values = [
            np.interp(PLACES, reach, value)
            for value in (curve.frequency, 100.0 * curve.damping_ratio)
        ]
        shown = [f"{f:.1f} Hz, {d:.2f} %" for f, d in zip(*values, strict=True)]
        row(f"`{contact}`", f"{curve.stuck_frequency:.1f}", *shown)
        said = [f"{system.n} unknowns, {levels} levels in {seconds[contact]:.0f} s"]
        if curve.estimated:
            errors = (
                f"{100.0 * error:.2g} % in {name.removesuffix('_ratio')}"
                for name, error in curve.estimated.items()
            )
            said.append(f"errors of the cycles {' and '.join(errors)}")
        if curve.opened is not None:
            said.append(f"up to {100.0 * curve.opened.max():.3g} % opens")
        notes.append(f"{contact}: {', '.join(said)}")
    for name, ((_, stuck, _), (_, f, damping)) in PUBLISHED.items():
        row(name, f"{stuck:.1f}", "", "", "", "", f"{f:.1f} Hz, {damping:.2f} %", "")
    print()
    for note in notes:
        print(f"- {note}.")
    print(f"- Ratio of the times {seconds['unilateral'] / seconds['constant']:.1f}.")


if __name__ == "__main__":
    main(sys.argv[1:])
