"""Slow cycles of two bolted solid plates beside CalculiX, on two meshes.

    python examples/benchmarks/calculix.py 0.6 --workers 2   60 % of slip; half an hour or more
    python examples/benchmarks/calculix.py coarse bending    one mesh or load; some hours for all
    python examples/benchmarks/calculix.py 0.6 --quick       one cycle of six levels a part, not 20;
                                                             some minutes

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
from argparse import ArgumentParser
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import replace
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


def forces(values):
    """Nodal forces (N, 3), N, as lines."""
    nodes, axes = np.nonzero(values)
    given = zip(nodes, axes, values[nodes, axes], strict=True)
    return ["*CLOAD", *(f"{node + 1}, {axis + 1}, {force:.10g}" for node, axis, force in given)]


def deck(structure, way, force, steps):
    """Input of CalculiX: bolts clamp, then the load goes to F, -F and F; mm, N and MPa."""
    body, material, mesh = structure.body, structure.material, structure.mesh
    loose = body.body_of_node[body.nodes_of("lower_end")[0]]
    lower = np.flatnonzero(body.body_of_node == loose)
    spread = structure.nodes[lower] - structure.nodes[lower].mean(axis=0)
    corners = lower[[np.argmax(spread @ corner) for corner in product((1.0, -1.0), repeat=3)]]
    (joint,) = structure.joints
    in_mm = replace(mesh, coordinates=1e3 * mesh.coordinates)
    lines, first = inp.deck(in_mm, (joint.on, joint.against)), mesh.n_elements + 1
    for axis in (1, 2):
        lines.append(f"*ELEMENT, TYPE=SPRING1, ELSET=SOFT{axis}")
        lines += [f"{first + k}, {node + 1}" for k, node in enumerate(corners)]
        lines += [f"*SPRING, ELSET=SOFT{axis}", f"{axis}", f"{SOFT / len(corners):g}"]
        first += len(corners)
    lines += ["*MATERIAL, NAME=STEEL", "*ELASTIC", f"{1e-6 * material.E}, {material.poisson}"]
    lines += ["*SOLID SECTION, ELSET=EALL, MATERIAL=STEEL"]
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


def by_calculix(text, weights, force):
    """Energies of the loop of an input by `areas`, J; ValueError if it does not reach its end."""
    with TemporaryDirectory() as temporary:
        given, found = Path(temporary, "plates.inp"), Path(temporary, "plates.dat")
        given.write_text(text, encoding="utf-8")
        with suppress(subprocess.TimeoutExpired):  # its displacements say how far it came
            subprocess.run(
                ["ccx", "plates"], cwd=temporary, capture_output=True, timeout=LIMIT, check=False
            )
        t, u = displacements(found.read_text(encoding="utf-8") if found.exists() else "", weights)
    if t.size == 0 or t[-1] < 4.0 - 1e-6:
        raise ValueError(f"ended after {t[-1] if t.size else 0.0:.3g} of 4 parts of the path")
    return areas(t, u, force)


def main(arguments):
    if shutil.which("ccx") is None:
        sys.exit(MISSING)
    parser = ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("only", nargs="*", help="kinds of load, shares of slip, and meshes")
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--quick", action="store_true", help="one of them, with fewer levels")
    options = parser.parse_args(arguments)
    quick, every = options.quick, (FULL, SHARES, MESHES)
    chosen = ([x for x in some if str(x) in options.only] or some for some in every)
    cases = list(product(*chosen))[: 1 if quick else None]
    steps, bricks = 6 if quick else 20, {k: solid_lap_joint(**v) for k, v in MESHES.items()}
    print("Energy of a slow cycle of two bolted solid plates, mJ, by this package and CalculiX\n")
    head(
        *("load", "share of slip", "mesh", "unknowns", "contact nodes", "constant normal forces"),
        *("contact that opens", "CalculiX", "from every second level", "difference, %"),
    )
    with ThreadPoolExecutor(options.workers) as pool:
        others, sizes = {}, {}
        for case in sorted(cases, key=lambda case: -bricks[case[2]].n_elements):  # longest first
            kind, share, name = case
            structure, force = bolted(kind, "unilateral", bricks[name]), share * FULL[kind]
            sizes[case] = np.count_nonzero(~structure.held), structure.patches[0].points.size
            text = deck(structure, WAYS[kind], force, steps)
            weights = np.outer(structure.body.even_shares("lower_end"), WAYS[kind])
            # the package itself stays in this thread
            others[case] = pool.submit(by_calculix, text, weights, force)
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
