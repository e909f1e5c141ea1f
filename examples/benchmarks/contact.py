"""Contact that opens and closes beside closed forms, published values and other programs.

    python examples/benchmarks/contact.py block     elastic block on a rigid plane with friction
    python examples/benchmarks/contact.py wall      a bar that hits a wall
    python examples/benchmarks/contact.py alike     two alike cylinders: Hertz, Cattaneo, Mindlin
    python examples/benchmarks/contact.py loops     two bolted solid plates; some minutes
    python examples/benchmarks/contact.py reduced   the same plates in reduced models; ten minutes
    python examples/benchmarks/contact.py           the first three; --quick takes coarse meshes

The block is half of that of the GRECO benchmark (Raous, Chabrand and Lebon, 1988; SSNV128 of
code_aster): 40 x 40 mm in plane strain, friction 1, 150 MPa on its side and 50 MPa on its top.
"""

import sys
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

from benchmarks import EXAMPLES, head, row

# isort: split

import numpy as np
import skfem
from scipy import sparse

import skfem_joint as sj
from skfem_joint.joint.pressure_space import pressure_space
from skfem_joint.mesh import merged, named
from skfem_joint.reduction.elastic_contact import elastic

#: Side of the block, m, and its material.
SIDE, BLOCK = 0.04, sj.Material(E=1.3e11, density=7800.0, poisson=0.2)
#: Pressures on its side and top at the times 0, 1, 2, ..., Pa.
PRESSURES = np.array([[0.0, 150e6, 30e6, 150e6, 30e6], [0.0, 50e6, 50e6, 50e6, 50e6]])
#: Places on its base, m, and how far they move as published, within 5 %, and by code_aster, um.
PLACES = np.array([0.0, 1.25, 5.0, 7.5, 11.25, 20.0]) * 1e-3
PUBLISHED = {
    "published (1988)": (28.6, 27.2, 22.8, 19.8, 15.0, ""),
    "code_aster, penalty": (28.65, 27.27, 22.92, 19.93, 15.61, ""),
}


def block(n, order=1, friction=1.0, **joint):
    """Structure of the block with n x n squares, 1 m thick."""
    line = np.linspace(0.0, SIDE, n + 1)
    mesh = skfem.MeshQuad.init_tensor(line, line).with_boundaries(
        {
            "base": lambda x: x[1] == 0.0,
            "right": lambda x: x[0] == SIDE,
            "left": lambda x: x[0] == 0.0,
            "top": lambda x: x[1] == SIDE,
        }
    )
    return sj.Structure(
        named(mesh, order=order),
        BLOCK,
        thickness=1.0,
        plane="strain",
        incompatible=False,  # plain elements, with which the published tables were measured
        fixed_x=["right"],
        joints=[sj.Joint("base", 0.0, friction, contact="unilateral", **joint)],
    )


def pushed(structure, steps, table=PRESSURES):
    """Base x (k,), displacements (levels, k, 2), friction work (levels,) at times 0, 1, ...; run.

    Each unit of time has as many ``steps``.
    """
    times = np.arange(table.shape[1], dtype=float)
    loads = [
        sj.Load(name, sj.Table(times, values), quantity="pressure")
        for name, values in zip(("left", "top"), table, strict=True)
    ]
    run = sj.quasi_static(
        structure.system(loads),
        step=1.0 / steps,
        n_steps=steps * (table.shape[1] - 1),
        save=sj.Save(fields=True),
    )
    base = np.flatnonzero(structure.nodes[:, 1] == 0.0)
    base = base[np.argsort(structure.nodes[base, 0])]
    u = structure.expand(run.u[::steps])[:, base]
    return structure.nodes[base, 0], u, run.friction_work_rows[::steps].sum(axis=1), run


def print_block(quick):
    """Displacement of the base under the first load, and friction work of the cycle."""
    print("Displacement of the base along x, µm, at\n")
    head("mesh", *(f"x = {1e3 * x:g} mm" for x in PLACES), "friction work of the cycle, J/m")
    for name, values in PUBLISHED.items():
        row(name, *values, "")
    for n, order in ((8, 1), (8, 2)) if quick else ((32, 1), (64, 1), (8, 2), (16, 2), (32, 2)):
        x, u, work, _ = pushed(block(n, order), 5 if quick else 20)
        cells = (f"{1e6 * value:.3f}" for value in np.interp(PLACES, x, u[1, :, 0]))
        row(f"{n} x {n}, order {order}", *cells, ", ".join(f"{value:.3f}" for value in work[1:]))


#: Of the bar that hits a wall: Young's modulus, Pa, density, kg/m3, section, m2, length, m, speed.
BAR = {"E": 200e9, "density": 8000.0, "area": 1e-4, "length": 1.0, "speed": 1.0}
#: Time that a wave takes through it, s, and the force at the wall, N.
PASSAGE = BAR["length"] / np.sqrt(BAR["E"] / BAR["density"])
WALL_FORCE = BAR["speed"] * BAR["area"] * np.sqrt(BAR["E"] * BAR["density"])


def bar(elements, lumped):
    """System of a bar whose last unknown touches a rigid wall."""
    h, n = BAR["length"] / elements, elements + 1
    cell = np.eye(2) / 2.0 if lumped else np.array([[2.0, 1.0], [1.0, 2.0]]) / 6.0
    K, M = np.zeros((n, n)), np.zeros((n, n))
    for i in range(elements):
        K[i : i + 2, i : i + 2] += BAR["E"] * BAR["area"] / h * np.array([[1, -1], [-1, 1]])
        M[i : i + 2, i : i + 2] += BAR["density"] * BAR["area"] * h * cell
    M, K = sparse.csr_array(M), sparse.csr_array(K)
    N = sparse.csr_array(([1.0], ([0], [elements])), shape=(1, n))
    wall = sj.NormalPart(N, np.zeros(1), np.zeros(1), np.array([np.inf]), np.array([BAR["area"]]))
    contact = sj.Contact(sparse.csr_array((0, n)), [], [], normal=wall)
    return sj.System(M, None, K, contact, P=N, points=("end",))


def hit(elements, rho, lumped, steps=400):
    """Run of the bar flying against the wall with ``steps`` a passage; energies over the first."""
    system = bar(elements, lumped)
    run = sj.integrate(
        system,
        step=PASSAGE / steps,
        n_steps=int(3.5 * steps),
        initial=(np.zeros(system.n), np.full(system.n, BAR["speed"])),
        scheme=sj.generalized_alpha(rho),
        save=sj.Save(fields=True),
    )
    energy = np.array([system.stored_energy(u, v) for u, v in zip(run.u, run.v, strict=True)])
    return run, energy / energy[0]


def print_wall(quick):
    """Energy, duration of contact, and force of a bar that hits a wall."""
    print(f"A bar that hits a wall, {100 if quick else 400} steps a passage L/c\n")
    head(
        *("elements", "mass", "ρ∞", "energy at the end, %", "largest, %", "contact, L/c"),
        "force after 0.2 L/c, largest error, %",
    )
    for elements in (20,) if quick else (50, 100, 200):
        for lumped in (True, False):
            for rho in (1.0, 0.8):
                run, energy = hit(elements, rho, lumped, 100 if quick else 400)
                force, t = run.normal_force[:, 0] / WALL_FORCE, run.field_times / PASSAGE
                error = np.abs(force[(t > 0.2) & (t < 1.8)] - 1.0).max()
                cells = (f"{100 * energy[-1]:.2f}", f"{100 * energy.max():.2f}")
                last = t[np.flatnonzero(force)[-1]]
                mass = "lumped" if lumped else "consistent"
                row(elements, mass, rho, *cells, f"{last:.3f}", f"{100 * error:.2f}")


#: Two alike cylinders: half width of the contact, m, radius of each, m, friction, share of slip.
HALF_WIDTH, RADIUS, RUBBING, PULL = 1e-3, 2.0, 0.5, 0.6
STEEL = sj.Material(E=200e9, density=8000.0, poisson=0.3)


class Hertz(NamedTuple):
    """Closed form of the contact of two alike cylinders (Hertz; Cattaneo; Mindlin).

    Attributes
    ----------
    force : float
        Normal force, N/m.
    peak : float
        Largest pressure, Pa.
    """

    force: float
    peak: float

    @staticmethod
    def of(half_width):
        """Contact with a half width, m; the sum of curvatures is twice that of each cylinder."""
        both = STEEL.E / (1.0 - STEEL.poisson**2) / 2.0
        force = np.pi * both * half_width**2 * (2.0 / RADIUS) / 4.0
        return Hertz(force, 2.0 * force / np.pi / half_width)

    def pressure(self, x):
        """Pressure, Pa, at x, m."""
        a = 2.0 * self.force / np.pi / self.peak
        return self.peak * np.sqrt(np.maximum(1.0 - (x / a) ** 2, 0.0))

    def traction(self, x, share):
        """Traction, Pa, under a tangential force of a ``share`` of friction times the normal."""
        a = 2.0 * self.force / np.pi / self.peak
        c = a * np.sqrt(1.0 - share)
        inner = c / a * np.sqrt(np.maximum(1.0 - (x / c) ** 2, 0.0))
        return RUBBING * (self.pressure(x) - self.peak * inner)


def _lines(n, shift):
    """Places along x and y of a body's nodes, m: ``n`` elements over the half width."""
    h, size = HALF_WIDTH / n, 40.0 * HALF_WIDTH
    even = 1.5 * HALF_WIDTH
    outer = np.geomspace(even, size, int(4.0 * np.log(size / even)) + 3)
    x = np.concatenate([-outer[:0:-1], np.arange(-1.5 * n, 1.5 * n + 0.5) * h, outer[1:]])
    x[np.abs(x) < even - 0.5 * h] += shift * h
    steps = np.geomspace(h, 0.15 * size, int(3.0 * np.log(0.15 * size / h)) + 1)
    y = np.concatenate([[0.0], np.cumsum(steps)])
    return x, y * size / y[-1]


def cylinders(n, order, shift=0.0):
    """Two alike cylinders, the upper one held at its top, with ``n`` elements over the half width.

    Meshes match, or are shifted against each other by a share of an element.
    """
    bodies = []
    for side, moved in ((1.0, 0.0), (-1.0, shift)):
        x, y = _lines(n, moved)
        mesh = skfem.MeshQuad.init_tensor(x, y)
        p = mesh.p.copy()
        p[1] = side * (p[1] + (1.0 - p[1] / y[-1]) * p[0] ** 2 / (2.0 * RADIUS))
        name = "upper" if side > 0.0 else "lower"
        depth, edge = y[-1], x[-1]
        t = mesh.t if side > 0.0 else mesh.t[::-1]
        mesh = skfem.MeshQuad(p, t)
        near = p[1, mesh.facets] * side
        across = np.abs(p[0, mesh.facets])
        face = np.all(near <= across**2 / (2.0 * RADIUS) * (1.0 + 1e-9) + 1e-15, axis=0)
        face &= np.all(across <= (1.45 if side > 0.0 else 1.9) * HALF_WIDTH, axis=0)
        ends = np.all(np.abs(near - depth) < 1e-12, axis=0)
        right = np.all(np.abs(p[0, mesh.facets] - edge) < 1e-12, axis=0)
        left = np.all(np.abs(p[0, mesh.facets] + edge) < 1e-12, axis=0)
        parts = {"face": face, "end": ends, "right": right, "left": left}
        boundaries = {f"{name}_{key}": np.flatnonzero(at) for key, at in parts.items()}
        bodies.append(named(mesh.with_boundaries(boundaries), order=order))
    joint = sj.Joint("upper_face", 0.0, RUBBING, against="lower_face", contact="unilateral")
    return sj.Structure(
        merged(bodies),
        STEEL,
        thickness=1.0,
        plane="strain",
        incompatible=False,  # plain elements, with which the published tables were measured
        fixed=["upper_end"],
        joints=[joint],
    )


class Pressed(NamedTuple):
    """What two cylinders did.

    Attributes
    ----------
    x : ndarray, shape (q,)
        Places of the pressure points, m, from left to right.
    area : ndarray, shape (q,)
        Area that each stands for, m2 per metre of thickness.
    p, q : ndarray, shape (levels, q)
        Pressure and traction of friction there, Pa, at every level.
    slip : ndarray, shape (levels, q)
        Of the lower body against the upper one, m.
    run : Run
    """

    x: np.ndarray
    area: np.ndarray
    p: np.ndarray
    q: np.ndarray
    slip: np.ndarray
    run: sj.Run


def press(structure, normal, pulled, steps):
    """Press the lower cylinder upwards and pull it sideways; tables of N/m at the times 0, 1, ...

    Two shear forces on its sides take the moment of the pull about the contact.
    """
    times = np.arange(len(normal), dtype=float)
    normal, pulled = np.asarray(normal), np.asarray(pulled)
    size = np.abs(structure.nodes[:, 1]).max() / (2.0 * structure.nodes[:, 0].max())
    forces = (
        ("lower_end", normal, (0.0, 1.0)),
        ("lower_end", pulled, (1.0, 0.0)),
        ("lower_right", pulled * size, (0.0, -1.0)),
        ("lower_left", pulled * size, (0.0, 1.0)),
    )
    loads = [sj.Load(on, sj.Table(times, force), direction=way) for on, force, way in forces]
    system = structure.system(loads)
    run = sj.quasi_static(
        system, step=1.0 / steps, n_steps=steps * (len(normal) - 1), save=sj.Save(fields=True)
    )
    (joint,), (patch,) = structure.joints, structure.patches
    space = pressure_space(structure.body, joint)
    nodes, area = space.nodes, system.contact.normal.area
    order = np.argsort(structure.nodes[nodes, 0])
    point = np.full(len(structure.nodes), -1)
    point[patch.nodes] = patch.points
    # slips are those of the upper body; forces are means over corners, as friction limits are
    limits = (system.contact.gain @ run.normal_force.T).T
    of_points = run.normal_force, (-run.sigma * limits)[:, point[nodes]]
    means = space.means(np.zeros(area.size))
    p, q = ((means @ force.T).T / area for force in of_points)
    slip = -np.asarray((system.contact.B @ run.u.T).T)[:, point[nodes]]
    by_x = (values[:, order] for values in (p, q, slip))
    return Pressed(structure.nodes[nodes[order], 0], area[order], *by_x, run)


def half_width(x, p):
    """Half width, m, and peak, Pa, of the half ellipse that fits pressures (q,) best.

    The outer tenth is left out, where the pressure falls from its slope at the end to zero.
    """
    inside = p > 0.3 * p.max()
    slope, top = np.polyfit(x[inside] ** 2, p[inside] ** 2, 1)
    return float(np.sqrt(-top / slope)), float(np.sqrt(top))


def stick_width(x, slip, n):
    """Half width of the part that sticks, m: where the slip from both edges ends; the mean.

    Near its end slip grows with the distance to the power of 3/2, which is fitted to it over four
    of the ``n`` elements of the half width: within each element of second order it swings between
    corners and the nodes between them.
    """
    size, widths = np.abs(slip), []
    for side in (1.0, -1.0):
        at = side * x
        slips = (at > 0.0) & (at < 0.95 * HALF_WIDTH) & (size > 1e-3 * size.max())
        nearest = slips & (at < at[slips].min() + 3.9 * HALF_WIDTH / n)
        slope, at_zero = np.polyfit(at[nearest], size[nearest] ** (2.0 / 3.0), 1)
        widths.append(-at_zero / slope)
    return float(np.mean(widths))


def print_alike(quick):
    """Half width, peak and friction of two alike cylinders, pressed and pulled."""
    known = Hertz.of(HALF_WIDTH)
    pull = PULL * RUBBING * known.force
    print(f"Two alike cylinders pressed by Hertz' force, then pulled by {PULL:g} of friction\n")
    head(
        *("elements over a", "order", "meshes", "half width / a", "peak pressure / p0"),
        *("friction energy of pressing / stored", f"stick width / a ({np.sqrt(1 - PULL):.4f})"),
        "traction, error in the mean square / (µ p0), %",
    )
    for n, order in ((8, 1),) if quick else ((8, 1), (16, 1), (32, 1), (16, 2), (32, 2)):
        for shift in (0.0, 0.37):
            found = press(
                cylinders(n, order, shift), [0, known.force, known.force], [0, 0, pull], 10
            )
            a, peak = half_width(found.x, found.p[10])
            stick = stick_width(found.x, found.slip[-1] - found.slip[10], n)
            error = np.sqrt(np.mean((found.q[-1] - known.traction(found.x, PULL)) ** 2))
            lost = found.run.friction_work_rows[10].sum() / found.run.stored_energy[1]
            cells = f"{a / HALF_WIDTH:.4f}", f"{peak / known.peak:.4f}", f"{lost:.1e}"
            cells += f"{stick / HALF_WIDTH:.4f}", f"{100 * error / RUBBING / known.peak:.2f}"
            row(n, order, "matching" if shift == 0.0 else "shifted", *cells)
    print(f"\nPressed and pulled at once; friction {RUBBING}\n")
    head("pull / force", "steps", "friction energy / stored energy")
    for share in (0.25,) if quick else (0.1, 0.25, 0.4):
        for steps in (10, 40):
            structure = cylinders(8 if quick else 16, 1)
            run = press(structure, [0, known.force], [0, share * known.force], steps).run
            row(share, steps, f"{run.friction_work_rows[-1].sum() / run.stored_energy[1]:.1e}")


#: Loop energies of two bolted solid plates, mJ, at shares of slip: of contact that opens and of
#: constant normal forces, with pressures at all nodes, and of CalculiX 2.20, surface to surface.
LOOPS = {
    "axial": {0.3: (1.721, 1.761, 1.685), 0.6: (9.031, 8.386, 10.66), 0.9: (58.02, 52.43, 61.34)},
    "bending": {0.3: (4.715, 3.984, 5.615), 0.6: (41.08, 31.26, 45.12), 0.9: (169.1, 147.2, 186.0)},
}
#: Loads at full slip, N.
FULL = {"axial": 12e3, "bending": 704.9}


def tetrahedra(mesh):
    """Mesh of tetrahedra of second order with the nodes of bricks, six in each, and its names.

    Each brick is split from its node with the lowest number, and so is each of its faces, so that
    neighbours fit.
    """
    bricks = mesh.mesh
    edges = {tuple(edge) for edge in np.sort(bricks.edges, axis=0).T.tolist()}
    found = []
    for nodes, faces in zip(bricks.t.T, bricks.t2f.T, strict=True):
        first = nodes.min()
        for face in bricks.facets[:, faces].T.tolist():
            if first in face:
                continue
            lowest = min(face)
            sides = [k for k in face if (min(lowest, k), max(lowest, k)) in edges]
            (across,) = set(face) - {lowest, *sides}
            found += [[first, lowest, side, across] for side in sides]
    t = np.array(found).T
    a, b, c = (bricks.p[:, t[k]] - bricks.p[:, t[0]] for k in (1, 2, 3))
    turned = np.einsum("ik,ik->k", np.cross(a, b, axis=0), c) < 0.0
    t[2:, turned] = t[2:, turned][::-1]
    split = skfem.MeshTet(bricks.p, t)
    triangles = {tuple(face): k for k, face in enumerate(np.sort(split.facets, axis=0).T.tolist())}
    names = {}
    for name, facets in mesh.boundaries.items():
        halves = (
            triangles.get(tuple(sorted(set(face) - {left_out})))
            for face in bricks.facets[:, facets].T.tolist()
            for left_out in face
        )
        names[name] = np.array(sorted(k for k in halves if k is not None))
    return named(split.with_boundaries(names), order=2)


def bolted(kind, contact, bricks=None):
    """Structure of `solid_lap_joint` in tetrahedra; in bending its lower end is free.

    ``bricks`` are a mesh of the same plates in place of the scene's.
    """
    scene = sj.load_scene(EXAMPLES / "solid_lap_joint.toml")
    structure = scene.structure()
    joints = [replace(joint, contact=contact) for joint in structure.joints]
    mesh = tetrahedra(bricks or structure.mesh)
    held = {} if kind == "axial" else {"fixed_y": [], "fixed_z": []}
    return replace(structure, mesh=mesh, joints=joints, damping_ratio=None, **held)


#: Directions of the loads.
WAYS = {"axial": (1.0, 0.0, 0.0), "bending": (0.0, 0.0, 1.0)}


def loop(kind, share, contact, steps=20, bricks=None):
    """Run 0, F, -F, F with ``steps`` increments from 0 to F, and the energy of the loop, J."""
    force = share * FULL[kind]
    times = steps * np.array([0.0, 1.0, 3.0, 5.0])
    load = sj.Load(
        "lower_end", sj.Table(times, force * np.array([0.0, 1.0, -1.0, 1.0])), WAYS[kind]
    )
    system = sj.condense(bolted(kind, contact, bricks).system([load]), interface_modes=0)
    run = sj.quasi_static(system, step=1.0, n_steps=5 * steps)
    work = run.loops.work.sum(axis=1)
    return run, float(work[-1] - work[steps])


def print_loops(quick):
    """Energy of the slow cycle of two bolted plates of solids."""
    print("Energy of a slow cycle of two bolted solid plates, mJ\n")
    head(
        *("load", "share of slip", "contact", "loop", "pressures at all nodes", "CalculiX"),
        *("iterations a level", "most", "s a level"),
    )
    for kind in FULL:
        for share, known in LOOPS[kind].items():
            for contact, reference in zip(("unilateral", "constant"), known, strict=False):
                run, energy = loop(kind, share, contact, 3 if quick else 20)
                counters = run.counters
                cells = f"{counters.newton_iterations / counters.steps:.1f}"
                seconds = f"{run.wall_s / counters.steps:.3f}"
                outside = known[2] if contact == "unilateral" else ""
                shown = f"{1e3 * energy:.3f}", reference, outside, cells
                row(kind, share, contact, *shown, counters.largest_iterations, seconds)
            if quick:
                return


def print_reduced(quick):
    """Reduced models of two bolted solid plates in bending beside the condensed one, same steps."""
    held, way = {"fixed_y": [], "fixed_z": []}, (0.0, 0.0, 1.0)
    structure = sj.load_scene(EXAMPLES / "solid_lap_joint.toml").structure()
    joints = [replace(joint, contact="unilateral") for joint in structure.joints]
    load = sj.Load("lower_end", sj.Harmonic(0.6 * FULL["bending"], 40.0), way)
    system = replace(structure, joints=joints, **held).system([load])
    times = {"cycles": 1, "steps_per_cycle": 20} if quick else {"cycles": 2, "steps_per_cycle": 100}
    print(
        "Two bolted solid plates in bending, 60 % of slip: errors beside the condensed model by the"
    )
    print("same steps; stated are those of the basis\n")
    head(
        *("model", "unknowns", "history, %", "friction energy of the last cycle, %"),
        *("stated: history, %", "friction energy, %", "ms a step"),
    )
    whole = sj.integrate(sj.condense(system), **times)
    row("condensed", whole.system.n, *4 * [""], f"{1e3 * whole.wall_s / whole.counters.steps:.0f}")
    models = {"condensed, elastic contact": lambda: sj.condense(elastic(system))}
    for modes in (20, 60):
        models[f"reduced, {modes} modes"] = lambda modes=modes: sj.reduce(system, modes=modes)
    for name, make in models.items():
        run = sj.integrate(make(), **times)
        apart = sj.compare(whole, run)
        errors = apart.displacement_rms, apart.friction_energy_per_cycle
        shown = [f"{100 * errors[0]:.2f}", f"{100 * errors[1]:+.1f}", "", ""]
        if name.startswith("reduced"):
            stated = sj.estimate(run)
            shown[2] = f"{100 * stated.of('basis', 'displacement_rms'):.2f}"
            shown[3] = f"{100 * stated.of('basis', 'friction_energy'):.1f}"
        row(name, run.system.n, *shown, f"{1e3 * run.wall_s / run.counters.steps:.0f}")


TABLES = {
    "reduced": print_reduced,
    "block": print_block,
    "wall": print_wall,
    "alike": print_alike,
    "loops": print_loops,
}


def main(arguments):
    asked = [name for name in arguments if name in TABLES] or ["block", "wall", "alike"]
    for name in asked:
        TABLES[name]("--quick" in arguments)
        print()


if __name__ == "__main__":
    main(sys.argv[1:])
