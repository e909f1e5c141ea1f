"""Frequencies of two solid plates with tied contact, from a CalculiX deck that both programs read.

    python examples/benchmarks/decks.py

The plates of `solid_lap_joint` are written as a deck of CalculiX, with materials, supports, a
contact pair and a step, in elements C3D10, C3D20, C3D20R and C3D8I. This package reads it as it is;
CalculiX gets a copy in which the pair of surfaces is tied (``*TIE``), which is a joint that sticks
all over its faces. The same plates as two instances, which CalculiX does not know, must have the
same frequencies in this package. The program ``ccx`` must be installed (on Debian:
``apt-get install calculix-ccx``).
"""

import re
import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

ROOT = Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT / "examples"), str(ROOT / "meshes")]

import numpy as np
from make_meshes import solid_lap_joint

import skfem_joint as sj
from benchmarks import head, row
from benchmarks.bricks import CORNERS
from benchmarks.calculix import MISSING, SIDES
from benchmarks.contact import tetrahedra
from skfem_joint.mesh import load_meshes

STEEL = sj.Material(E=200e9, density=8000.0, poisson=0.3)
KINDS = ("C3D10", "C3D20", "C3D20R", "C3D8I")
MODES = 6
#: Corners of the sides of a hexahedron and at the ends of edges, in CalculiX's order.
FACES = ((0, 1, 2, 3), (4, 7, 6, 5), (0, 4, 5, 1), (1, 5, 6, 2), (2, 6, 7, 3), (3, 7, 4, 0))
EDGES = {
    4: ((0, 1), (1, 2), (0, 2), (0, 3), (1, 3), (2, 3)),
    8: (
        *((0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4)),
        *((0, 4), (1, 5), (2, 6), (3, 7)),
    ),
}
#: Names that are surfaces in the deck; the others are sets of nodes.
SURFACES = ("upper_contact", "lower_contact", "head_1", "head_2", "nut_1", "nut_2")
PAIR = ["*CONTACT PAIR, INTERACTION=DRY, TYPE=SURFACE TO SURFACE", "upper_contact, lower_contact"]
TIE = ["*TIE, NAME=GLUED, POSITION TOLERANCE=1e-6", "upper_contact, lower_contact"]


def listed(numbers):
    """Lines of at most sixteen numbers from 1 on."""
    words = [str(number + 1) for number in np.asarray(numbers).tolist()]
    return [", ".join(words[at : at + 16]) for at in range(0, len(words), 16)]


def model(mesh, kind):
    """Nodes with those between corners, elements, and both ends of each edge in their order."""
    t = mesh.mesh.t[list(CORNERS)] if len(mesh.mesh.t) == 8 else mesh.mesh.t
    elements, xyz, ends = t.T, mesh.coordinates, np.empty((0, 2), int)
    if kind != "C3D8I":
        pairs = np.sort([elements[:, pair] for pair in EDGES[len(t)]], axis=2)
        ends, place = np.unique(pairs.reshape(-1, 2), axis=0, return_inverse=True)
        xyz = np.vstack([xyz, xyz[ends].mean(axis=1)])
        elements = np.hstack([elements, len(mesh.coordinates) + place.reshape(pairs.shape[:2]).T])
    return xyz, elements, ends


def groups(mesh, elements, ends, chosen, nodes):
    """Sets and surfaces of some elements, numbered among themselves, as lines."""
    lines, sides = [], SIDES if len(mesh.mesh.t) == 4 else FACES
    for name, facets in mesh.boundaries.items():
        corners = np.unique(mesh.mesh.facets[:, facets])
        if not np.isin(corners, nodes).all():
            continue
        if name in SURFACES:
            lines.append(f"*SURFACE, NAME={name}, TYPE=ELEMENT")
            for element, facet in zip(mesh.mesh.f2t[0, facets], facets, strict=True):
                own = elements[element].tolist()
                on = {own.index(k) for k in mesh.mesh.facets[:, facet]}
                (side,) = (k for k, each in enumerate(sides, 1) if set(each) == on)
                lines.append(f"{np.searchsorted(chosen, element) + 1}, S{side}")
        else:
            between = len(mesh.coordinates) + np.flatnonzero(np.isin(ends, corners).all(axis=1))
            on = np.searchsorted(nodes, np.concatenate([corners, between]))
            lines += [f"*NSET, NSET={name}", *listed(on)]
    return lines


def bodies(mesh, kind, apart):
    """Nodes, elements, sets and surfaces as lines: of all, or of each body."""
    xyz, elements, ends = model(mesh, kind)
    every = np.arange(len(elements))
    for own in [every[mesh.body == k] for k in (0, 1)] if apart else [every]:
        nodes = np.unique(elements[own])
        lines = ["*NODE"]
        lines += [
            f"{k}, {', '.join(f'{x:.12g}' for x in place)}" for k, place in enumerate(xyz[nodes], 1)
        ]
        lines.append(f"*ELEMENT, TYPE={kind}, ELSET={'PLATES' if not apart else 'PLATE'}")
        for k, row_of in enumerate(np.searchsorted(nodes, elements[own]) + 1, 1):
            words = [str(number) for number in (k, *row_of.tolist())]
            lines += [", ".join(words[:16]) + ("," if len(words) > 16 else "")]
            lines += [", ".join(words[16:])] if len(words) > 16 else []
        yield [*lines, *groups(mesh, elements, ends, own, nodes)]


def rest():
    """Materials, supports, contact and a step, which the package passes over."""
    lines = ["*MATERIAL, NAME=STEEL", "*ELASTIC", f"{STEEL.E:g}, {STEEL.poisson}", "*DENSITY"]
    lines += [f"{STEEL.density:g}", "*SOLID SECTION, ELSET=PLATES, MATERIAL=STEEL"]
    lines += ["*BOUNDARY", "upper_end, 1, 3", "lower_end, 2, 3"]
    lines += ["*SURFACE INTERACTION, NAME=DRY", "*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=LINEAR"]
    lines += ["1e15", "*FRICTION", "0.3, 1e15", *PAIR]
    return [*lines, "*STEP", "*FREQUENCY", f"{MODES}", "*END STEP"]


def flat(mesh, kind):
    """Deck that both programs read."""
    (lines,) = bodies(mesh, kind, apart=False)
    return [*lines, *rest()]


def in_instances(mesh, kind):
    """Deck of two instances, of which the second is put in its place."""
    lines, placed = [], ["*ASSEMBLY, NAME=BOTH"]
    for k, own in enumerate(bodies(mesh, kind, apart=True), 1):
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
    copy = [*lines[:at], *TIE, *lines[at + len(PAIR) :], ""]
    (folder / "tied.inp").write_text("\n".join(copy), encoding="utf-8")
    subprocess.run(["ccx", "tied"], cwd=folder, capture_output=True, check=True)
    found = (folder / "tied.dat").read_text().partition("E I G E N V A L U E")[2]
    values = re.findall(r"^\s+\d+\s+\S+\s+\S+\s+(\S+)\s+\S+\s*$", found, re.MULTILINE)
    return np.array(values[:MODES], dtype=float)


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
