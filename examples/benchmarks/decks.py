"""Frequencies of two solid plates with tied contact, from a CalculiX deck that both programs read.

    python examples/benchmarks/decks.py

The plates of `solid_lap_joint` are written as a deck of CalculiX, with materials, supports, a
contact pair and a step, in elements C3D10, C3D20, C3D20R and C3D8I. This package reads it as it is;
CalculiX gets a copy in which the pair of surfaces is tied (``*TIE``), which is a joint that sticks
all over its faces. The same plates as two instances, which CalculiX does not know, must have the
same frequencies in this package. The program ``ccx`` must be installed (on Debian:
``apt-get install calculix-ccx``).
"""

import shutil
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

from benchmarks import head, inp, row

# isort: split

import numpy as np
from make_meshes import solid_lap_joint

import skfem_joint as sj
from benchmarks.calculix import MISSING
from benchmarks.contact import tetrahedra
from skfem_joint.mesh import load_meshes

STEEL = sj.Material(E=200e9, density=8000.0, poisson=0.3)
KINDS = ("C3D10", "C3D20", "C3D20R", "C3D8I")
MODES = 6
#: Names that are surfaces in the deck; the others are sets of nodes.
SURFACES = ("upper_contact", "lower_contact", "head_1", "head_2", "nut_1", "nut_2")
PAIR = ["*CONTACT PAIR, INTERACTION=DRY, TYPE=SURFACE TO SURFACE", "upper_contact, lower_contact"]
TIE = ["*TIE, NAME=GLUED, POSITION TOLERANCE=1e-6", "upper_contact, lower_contact"]


def bodies(mesh, kind, *numbers):
    """Decks of some bodies, or of all in one."""
    shape = "tetrahedron" if kind == "C3D10" else "hexahedron"
    order = 1 if kind == "C3D8I" else 2
    given = {"types": {shape: (kind, kind)}, "order": order}
    return [inp.deck(mesh, SURFACES, body=number, **given) for number in numbers or (None,)]


def rest():
    """Materials, supports, contact and a step, which the package passes over."""
    lines = ["*MATERIAL, NAME=STEEL", "*ELASTIC", f"{STEEL.E:g}, {STEEL.poisson}", "*DENSITY"]
    lines += [f"{STEEL.density:g}", "*SOLID SECTION, ELSET=EALL, MATERIAL=STEEL"]
    lines += ["*BOUNDARY", "upper_end, 1, 3", "lower_end, 2, 3"]
    lines += ["*SURFACE INTERACTION, NAME=DRY", "*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=LINEAR"]
    lines += ["1e15", "*FRICTION", "0.3, 1e15", *PAIR]
    return [*lines, "*STEP", "*FREQUENCY", f"{MODES}", "*END STEP"]


def flat(mesh, kind):
    """Deck that both programs read."""
    (lines,) = bodies(mesh, kind)
    return [*lines, *rest()]


def in_instances(mesh, kind):
    """Deck of two instances, of which the second is put in its place."""
    lines, placed = [], ["*ASSEMBLY, NAME=BOTH"]
    for k, own in enumerate(bodies(mesh, kind, 0, 1), 1):
        lines += [f"*PART, NAME=PLATE-{k}", *own, "*END PART"]
        placed += [f"*INSTANCE, NAME=PLATE-{k}-1, PART=PLATE-{k}", "*END INSTANCE"]
    return [*lines, *placed, "*END ASSEMBLY", *rest()]


def by_this_package(lines, folder):
    """Unknowns, and frequencies with the joint stuck all over its faces, Hz."""
    path = folder / "plates.inp"
    path.write_text("\n".join([*lines, ""]), encoding="utf-8")
    joint = sj.Joint("upper_contact", against="lower_contact", pressure=1e6, friction=0.3)
    structure = sj.Structure(load_meshes(path), STEEL, fixed=["upper_end"], joints=[joint],
                             fixed_y=["lower_end"], fixed_z=["lower_end"])  # fmt: skip
    system = structure.system([])
    return system.n, sj.natural_modes(system, MODES, joints="stuck").frequencies


def by_calculix(lines, folder):
    """Frequencies of a copy in which the surfaces are tied, Hz."""
    at = lines.index(PAIR[0])
    tied = [*lines[:at], *TIE, *lines[at + len(PAIR) :]]
    return inp.by_calculix(tied, folder)[1][:MODES]


def main():
    if shutil.which("ccx") is None:
        sys.exit(MISSING)
    bricks = solid_lap_joint()
    print("Frequencies of two plates with tied contact, this package over CalculiX\n")
    head(
        *("CalculiX's element", "unknowns", "first frequency, Hz"),
        *(f"frequency {k + 1}" for k in range(MODES)),
        "two instances",
    )
    with TemporaryDirectory() as temporary:
        folder = Path(temporary)
        for kind in KINDS:
            mesh = tetrahedra(bricks) if kind == "C3D10" else bricks
            n, ours = by_this_package(flat(mesh, kind), folder)
            _, apart = by_this_package(in_instances(mesh, kind), folder)
            theirs = by_calculix(flat(mesh, kind), folder)
            row(
                *(kind, n, f"{ours[0]:.3f}"),
                *(f"{x:+.1e}" for x in ours / theirs - 1.0),
                f"{np.abs(apart / ours - 1.0).max():.0e}",
            )


if __name__ == "__main__":
    main()
