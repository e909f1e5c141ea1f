"""Slow cycles of two bolted solid plates beside CalculiX, on two meshes.

    python examples/benchmarks/calculix.py 0.6 --workers 2   60 % of slip; half an hour or more
    python examples/benchmarks/calculix.py coarse bending    one mesh or load; some hours for all
    python examples/benchmarks/calculix.py --quick           one cycle of six levels a part, not 20;
                                                             some minutes; if none are given, axial,
                                                             60 % of slip and the coarse mesh
    python examples/benchmarks/calculix.py --folder DIR      where CalculiX reads and writes; runs
                                                             that came to their end are kept there

CalculiX, whose program ``ccx`` must be installed (on Debian: ``apt-get install calculix-ccx``),
gets the tetrahedra of second order, supports, forces of the bolts and of the load that this package
uses, node by node. Its contact is elastic in both directions (surface to surface), friction acts
after clamping. Its energy of a cycle is the area of force over displacement, as the load takes it.
The difference is that of contact that opens from CalculiX.
"""

import re
import shutil
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from itertools import product
from pathlib import Path
from tempfile import TemporaryDirectory

sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

from benchmarks import head, inp, row

# isort: split

import numpy as np
from make_meshes import solid_lap_joint

from benchmarks.contact import FULL, WAYS, bolted, loop
from skfem_joint.joint.clamps import clamp_forces

MISSING = "not made: CalculiX is not installed; its program is called ccx (Debian: calculix-ccx)"
#: Stiffness of the contact across and along its faces, N/mm3, and friction while bolts clamp.
STIFFNESS, SMOOTH = 1e6, 1e-6
#: Springs along x and y at the corners of the loose plate, which hold it while bolts clamp, N/mm
#: together along each.
SOFT = 100.0
#: Arguments of `solid_lap_joint` by mesh.
MESHES = {
    "coarse": {},
    "fine": {"across": 5, "inner": (0.0045, 0.0055, 0.00675), "outer": (0.011, 0.015)},
}
SHARES = (0.3, 0.6, 0.9)
#: Longest run of CalculiX, s.
LIMIT = 4 * 3600.0


def numbered(values):
    """Lines of numbers, each with its own number from 1 in front."""
    return [f"{k}, {', '.join(f'{x:.9g}' for x in each)}" for k, each in enumerate(values, 1)]


def surface(structure, name):
    """Sides of tetrahedra on a boundary, as lines."""
    mesh = structure.mesh
    found = inp.sides(mesh, name, inp.model(mesh, 1)[1])
    return [f"*SURFACE, NAME={name}, TYPE=ELEMENT", *(f"{e + 1}, S{side}" for e, side, _ in found)]


def forces(values):
    """Nodal forces (N, 3), N, as lines."""
    nodes, axes = np.nonzero(values)
    given = zip(nodes, axes, values[nodes, axes], strict=True)
    return ["*CLOAD", *(f"{node + 1}, {axis + 1}, {force:.10g}" for node, axis, force in given)]


def deck(structure, way, force, steps):
    """Input of CalculiX: bolts clamp, then the load goes to F, -F and F; mm, N and MPa."""
    body, material = structure.body, structure.material
    t = body.of_element + 1
    loose = body.body_of_node[body.nodes_of("lower_end")[0]]
    lower = np.flatnonzero(body.body_of_node == loose)
    spread = structure.nodes[lower] - structure.nodes[lower].mean(axis=0)
    corners = lower[[np.argmax(spread @ corner) for corner in product((1.0, -1.0), repeat=3)]]
    (joint,) = structure.joints
    lines = ["*NODE, NSET=ALL", *numbered(1e3 * structure.nodes)]
    lines += ["*ELEMENT, TYPE=C3D10, ELSET=PLATES", *numbered(t.T)]
    first = t.shape[1] + 1
    for axis in (1, 2):
        lines.append(f"*ELEMENT, TYPE=SPRING1, ELSET=SOFT{axis}")
        lines += [f"{first + k}, {node + 1}" for k, node in enumerate(corners)]
        lines += [f"*SPRING, ELSET=SOFT{axis}", f"{axis}", f"{SOFT / len(corners):g}"]
        first += len(corners)
    lines += ["*MATERIAL, NAME=STEEL", "*ELASTIC", f"{1e-6 * material.E}, {material.poisson}"]
    lines += ["*SOLID SECTION, ELSET=PLATES, MATERIAL=STEEL"]
    lines += surface(structure, joint.on) + surface(structure, joint.against)
    lines += ["*SURFACE INTERACTION, NAME=FACES"]
    lines += ["*SURFACE BEHAVIOR, PRESSURE-OVERCLOSURE=LINEAR", f"{STIFFNESS:g}"]
    lines += ["*FRICTION", f"{SMOOTH:g}, {STIFFNESS:g}"]
    lines += ["*CONTACT PAIR, INTERACTION=FACES, TYPE=SURFACE TO SURFACE"]
    lines += [f"{joint.on}, {joint.against}"]
    held = structure.held.reshape(-1, 3)
    lines += ["*BOUNDARY", *(f"{node + 1}, {axis + 1}" for node, axis in np.argwhere(held))]
    loaded = np.flatnonzero(body.even_shares("lower_end"))
    lines += ["*NSET, NSET=LOADED", *(f"{node + 1}" for node in loaded)]
    clamped = sum(clamp_forces(body, bolt, "bolt") for bolt in structure.bolts)
    shares = np.outer(body.even_shares("lower_end"), way)
    shown = ["*NODE PRINT, NSET=LOADED", "U", "*END STEP"]
    lines += ["*STEP, INC=1000", "*STATIC", "0.25, 1., 1e-5, 0.25", *forces(clamped), *shown]
    change = ["*CHANGE FRICTION, INTERACTION=FACES", "*FRICTION"]
    change += [f"{joint.friction:g}, {STIFFNESS:g}"]
    for level in (force, -force, force):
        lines += ["*STEP, INC=1000", *change, "*STATIC", f"{1 / steps}, 1., 1e-6, {1 / steps}"]
        lines += [*forces(level * shares), *shown]
        change = []
    return "\n".join(lines) + "\n"


def displacements(text, weights):
    """Times and weighted displacements, from what CalculiX printed, mm."""
    times, found = [], []
    for part in re.split(r"displacements \(vx,vy,vz\) for set LOADED and time +", text)[1:]:
        first, *lines = part.strip().splitlines()
        values = np.array([line.split() for line in lines if line.strip()], dtype=float)
        times.append(float(first))
        found.append(np.sum(weights[values[:, 0].astype(int) - 1] * values[:, 1:]))
    return np.array(times), np.array(found)


def areas(t, u, force):
    """Energy of the loop, J, from all levels after the first F, and from every second of them.

    ``t`` are times, ``u`` displacements, mm; F, -F and F, N, lie at the times 2, 3 and 4.
    """
    turn = t > 2.0 - 1e-9
    t, u = t[turn], 1e-3 * u[turn]
    level = force * np.interp(t, [2.0, 3.0, 4.0], [1.0, -1.0, 1.0])
    back = int(np.argmin(np.abs(t - 3.0)))
    few = [*range(0, back, 2), *range(back, t.size - 1, 2), t.size - 1]
    return tuple(float(np.trapezoid(level[k], u[k])) for k in (slice(None), few))


def by_calculix(text, weights, force, folder):
    """Energies of the loop of an input by `areas`, J; ValueError if it does not reach its end."""
    given, found = folder / "plates.inp", folder / "plates.dat"

    def path():
        said = found.read_text(encoding="utf-8") if found.exists() else ""
        return displacements(said, weights)

    folder.mkdir(parents=True, exist_ok=True)
    known = given.exists() and given.read_text(encoding="utf-8") == text
    if not (known and is_whole(path()[0])):
        found.unlink(missing_ok=True)
        given.write_text(text, encoding="utf-8")
        with suppress(subprocess.TimeoutExpired):  # its displacements say how far it came
            subprocess.run(
                ["ccx", "plates"], cwd=folder, capture_output=True, timeout=LIMIT, check=False
            )
    t, u = path()
    if not is_whole(t):
        raise ValueError(f"ended after {t[-1] if t.size else 0.0:.3g} of 4 parts of the path")
    return areas(t, u, force)


def is_whole(t):
    """Whether times (k,) reach the end of the path."""
    return t.size > 0 and t[-1] > 4.0 - 1e-6


def after(arguments, option, default):
    """Argument that follows an option."""
    return arguments[arguments.index(option) + 1] if option in arguments else default


def main(arguments):
    if shutil.which("ccx") is None:
        sys.exit(MISSING)
    quick, workers = "--quick" in arguments, int(after(arguments, "--workers", 1))
    kinds = [name for name in FULL if name in arguments] or list(FULL)
    shares = [share for share in SHARES if str(share) in arguments] or ([0.6] if quick else SHARES)
    meshes = [name for name in MESHES if name in arguments] or list(MESHES)
    cases = list(product(kinds, shares, meshes))[: 1 if quick else None]
    steps, bricks = 6 if quick else 20, {k: solid_lap_joint(**v) for k, v in MESHES.items()}
    print("Energy of a slow cycle of two bolted solid plates, mJ, by this package and CalculiX\n")
    head(
        *("load", "share of slip", "mesh", "unknowns", "contact nodes", "constant normal forces"),
        *("contact that opens", "CalculiX", "from every second level", "difference, %"),
    )
    with TemporaryDirectory() as temporary, ThreadPoolExecutor(workers) as pool:
        folder = Path(after(arguments, "--folder", temporary))
        others, sizes = {}, {}
        for case in sorted(cases, key=lambda case: -bricks[case[2]].n_elements):  # longest first
            kind, share, name = case
            structure, force = bolted(kind, "unilateral", bricks[name]), share * FULL[kind]
            sizes[case] = np.count_nonzero(~structure.held), structure.patches[0].points.size
            text = deck(structure, WAYS[kind], force, steps)
            weights = np.outer(structure.body.even_shares("lower_end"), WAYS[kind])
            place = folder / "-".join(map(str, case))
            # the package itself stays in this thread
            others[case] = pool.submit(by_calculix, text, weights, force, place)
        for case in cases:
            kind, share, name = case
            closed, energy = (
                loop(kind, share, contact, steps, bricks[name])[1]
                for contact in ("constant", "unilateral")
            )
            cells = *case, *sizes[case], f"{1e3 * closed:.3f}", f"{1e3 * energy:.3f}"
            try:
                whole, few = others[case].result()
            except ValueError as error:
                row(*cells, error, "", "")
                continue
            apart = f"{100.0 * (energy / whole - 1.0):+.1f}"
            row(*cells, f"{1e3 * whole:.3f}", f"{1e3 * few:.3f}", apart)


if __name__ == "__main__":
    main(sys.argv[1:])
