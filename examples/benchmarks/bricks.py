"""Hexahedra of first order beside those of CalculiX: a cantilever's deflection and frequencies.

    python examples/benchmarks/bricks.py

A cantilever of 300 x 30 x 10 mm is computed with plain elements beside CalculiX's C3D8, and with
incompatible modes, the default, beside its C3D8I: with bricks, and with cross-sections that lean
in turn forward and back, by 0.3 of the beam's height. CalculiX gets the same nodes, elements and
supports, and the load node by node. Its program ``ccx`` must be installed (on Debian:
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
from scipy.sparse.linalg import spsolve
from skfem import MeshHex

import skfem_joint as sj
from benchmarks.calculix import MISSING, forces
from skfem_joint.mesh import named

STEEL = sj.Material(E=200e9, density=7800.0, poisson=0.3)
SIZE = np.array([0.3, 0.03, 0.01])
MESHES = ((30, 3, 1), (60, 6, 2), (15, 3, 2))
#: CalculiX's element and our choice.
KINDS = {"C3D8": {"incompatible": False}, "C3D8I": {}}
MODES = 6


def mesh_of(counts, shift):
    """Cantilever along x; every second cross-section leans forward, the others back."""
    x, y, z = (np.linspace(0.0, size, n + 1) for size, n in zip(SIZE, counts, strict=True))
    mesh = MeshHex.init_tensor(x, y, z)
    p = mesh.p.copy()
    section = np.rint(p[0] / SIZE[0] * counts[0]).astype(int)
    inner = (section > 0) & (section < counts[0])
    p[0] += np.where(inner, shift * (p[2] - 0.5 * SIZE[2]) * (-1.0) ** section, 0.0)
    mesh = MeshHex(p, mesh.t).with_subdomains({"beam": np.arange(mesh.nelements)})
    ends = {"left": lambda x: x[0] < 1e-9, "right": lambda x: x[0] > SIZE[0] - 1e-9}
    return mesh.with_boundaries(ends)


def by_this_package(mesh, options):
    """Deflection of the right end under 1 N across, m, frequencies, Hz, and forces at nodes, N."""
    structure = sj.Structure(mesh, STEEL, fixed=["left"], **options)
    system = structure.system([sj.Load("right", sj.Harmonic(1.0, 1.0), (0.0, 0.0, 1.0))], [])
    vector = system.loads[0].vector
    given = np.zeros(structure.held.shape)
    given[~structure.held] = vector
    deflection = float(vector @ spsolve(system.K.tocsc(), vector))
    return deflection, sj.natural_modes(system, MODES).frequencies, given.reshape(-1, 3)


def by_calculix(mesh, kind, given, folder):
    """The same by CalculiX."""
    lines = inp.deck(named(mesh), (), types={"hexahedron": (kind,)})
    lines += ["*NSET, NSET=ALL, GENERATE", f"1, {mesh.nvertices}"]
    lines += ["*MATERIAL, NAME=STEEL", "*ELASTIC", f"{STEEL.E}, {STEEL.poisson}"]
    lines += ["*DENSITY", f"{STEEL.density}", "*SOLID SECTION, ELSET=EALL, MATERIAL=STEEL"]
    lines += ["*BOUNDARY", "left, 1, 3"]
    lines += ["*STEP", "*STATIC", *forces(given), "*NODE PRINT, NSET=ALL", "U", "*END STEP"]
    lines += ["*STEP", "*FREQUENCY", f"{MODES}", "*END STEP"]
    static, frequencies = inp.by_calculix(lines, folder)
    moved = np.loadtxt(static.strip().splitlines()[1:])[:, 1:]
    return float(np.sum(given * moved)), frequencies[:MODES]


def main():
    if shutil.which("ccx") is None:
        sys.exit(MISSING)
    print("Deflection and first frequencies of a cantilever, this package over CalculiX, %\n")
    head(
        *("elements", "shift", "CalculiX's element", "first frequency, Hz", "deflection"),
        *(f"frequency {k + 1}" for k in range(MODES)),
    )
    with TemporaryDirectory() as folder:
        for counts in MESHES:
            for shift in (0.0, 0.3):
                mesh = mesh_of(counts, shift)
                for kind, options in KINDS.items():
                    moved, ours, given = by_this_package(mesh, options)
                    other, theirs = by_calculix(mesh, kind, given, Path(folder))
                    apart = 100.0 * (np.array([moved, *ours]) / np.array([other, *theirs]) - 1.0)
                    row(
                        *("x".join(map(str, counts)), shift, kind, f"{ours[0]:.2f}"),
                        *(f"{value:+.2g}" if abs(value) > 1e-3 else "0" for value in apart),
                    )


if __name__ == "__main__":
    main()
