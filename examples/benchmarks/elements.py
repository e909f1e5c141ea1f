"""How far results on meshes of first order, as a user makes them, are from converged ones.

    python examples/benchmarks/elements.py                  all scenes and kinds of elements
    python examples/benchmarks/elements.py lap --kind hexahedra triangles
    python examples/benchmarks/elements.py lap --out FOLDER   also a picture of error over time

Gmsh meshes a cantilever of 300 x 30 x 10 mm, and two plates of 180 x 10 x 5 mm that lap over
60 mm, with elements of first order of about the thickness ("1 layer") and of half of it ("2
layers"). The scenes are the cantilever, and the lap under an even pressure, under the preload of a
bolt (solids in one layer), and, in the plane alone, that with contact that opens. In the plane the
same parts are seen from the side, under plane stress. Each row has the largest error of six natural
frequencies with stuck joints and that of the friction energy of a slow cycle, of the plain elements
(``order = 1``, ``incompatible = false``) and of those by default, beside elements of second order
on a finer mesh. "stated" is the largest error of a frequency by ``structure.mesh_error``, which
elements of first order have.
"""

import argparse
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

from benchmarks import cpu_seconds, head, row

# isort: split

import itertools

import numpy as np
from scipy.sparse.linalg import spsolve

import skfem_joint as sj

KINDS = ("tetrahedra", "hexahedra", "triangles", "quadrilaterals")
SCENES = ("cantilever", "lap", "preload", "opens")
STEEL = sj.Material(E=200e9, density=7800.0, poisson=0.3)
#: Width and thickness of the cantilever and of the plates, mm, and the force at their ends, N.
SIZES = {"cantilever": (30.0, 10.0, 1.0)} | dict.fromkeys(SCENES[1:], (10.0, 5.0, 12.0))
LAPPED = (120.0, 140.0, 160.0, 180.0)
PLAIN = {"order": 1, "incompatible": False}


def mesh_of(scene, kind, size, folder, order=1, divided=1):
    """Mesh by Gmsh, elements of about ``size`` (mm), ``divided`` times as many along the lap."""
    import gmsh

    solid, bricks = kind in KINDS[:2], kind in ("hexahedra", "quadrilaterals")
    plates = {"": ([0.0, 300.0], 0.0, 10.0)}
    if scene != "cantilever":
        plates = {"lower_": ([0.0, *LAPPED], 0.0, 5.0), "upper_": ([*LAPPED, 300.0], 5.0, 5.0)}
    files = []
    for prefix, where in plates.items():
        gmsh.initialize()
        gmsh.option.setNumber("General.Terminal", 0)
        _plate(gmsh, SIZES[scene][0], prefix, *where, solid, bricks, size, divided)
        for limit in ("Max", "Min"):
            gmsh.option.setNumber(f"Mesh.MeshSize{limit}", size)
        gmsh.model.mesh.generate(3 if solid else 2)
        gmsh.model.mesh.setOrder(order)
        files.append(Path(folder) / f"{prefix}{scene}_{kind}_{size:g}_{order}.msh")
        gmsh.write(str(files[-1]))
        gmsh.finalize()
    return sj.load_meshes(files, scale=1e-3)


def _plate(gmsh, wide, prefix, places, low, deep, solid, bricks, size, divided):
    """Add a plate with strips that end at ``places`` and that names tell apart."""
    cad, dim = gmsh.model.occ, 3 if solid else 2
    strips = []
    for start, end in itertools.pairwise(places):
        if solid:
            strips.append((3, cad.addBox(start, 0.0, low, end - start, wide, deep)))
        else:
            strips.append((2, cad.addRectangle(start, low, 0.0, end - start, deep)))
    if len(strips) > 1:
        cad.fragment(strips[:1], strips[1:])
    cad.synchronize()

    def inside(x0, x1, z0, z1, of):
        e = 1e-3
        box = (x0 - e, -e, z0 - e, x1 + e, wide + e, z1 + e)
        if not solid:
            box = (x0 - e, z0 - e, -e, x1 + e, z1 + e, e)
        return [tag for _, tag in gmsh.model.getEntitiesInBoundingBox(*box, dim=of)]

    def name(tags, what, of):
        gmsh.model.addPhysicalGroup(of, tags, name=f"{prefix}{what}")

    top = low + deep
    name(inside(places[0], places[-1], low, top, dim), "plate", dim)
    name(inside(places[0], places[0], low, top, dim - 1), "left", dim - 1)
    name(inside(places[-1], places[-1], low, top, dim - 1), "right", dim - 1)
    if prefix:
        face, back = (top, low) if prefix == "lower_" else (low, top)
        ends = LAPPED[0], LAPPED[-1]
        name(inside(*ends, face, face, dim - 1), "contact", dim - 1)
        name(inside(*LAPPED[1:3], back, back, dim - 1), "clamped", dim - 1)
    if bricks:
        for _, curve in gmsh.model.getEntities(1):
            x0, y0, z0, x1, y1, z1 = gmsh.model.getBoundingBox(1, curve)
            extent = np.array([x1 - x0, y1 - y0, z1 - z0])
            fine = divided if extent.argmax() == 0 and x0 > 119.0 and x1 < 181.0 else 1
            count = max(1, round(extent.max() / size)) * fine
            gmsh.model.mesh.setTransfiniteCurve(curve, count + 1)
        for _, surface in gmsh.model.getEntities(2):
            gmsh.model.mesh.setTransfiniteSurface(surface)
            gmsh.model.mesh.setRecombine(2, surface)
        for _, volume in gmsh.model.getEntities(3):
            gmsh.model.mesh.setTransfiniteVolume(volume)


def structure_of(scene, mesh, **options):
    """Jointed structure of a scene on a mesh."""
    if mesh.dim == 2:
        options["thickness"] = 1e-3 * SIZES[scene][0]
    if scene == "cantilever":
        return sj.Structure(mesh, STEEL, fixed=["left"], **options)
    on = {"on": "upper_contact", "against": "lower_contact", "friction": 0.3}
    joint = sj.Joint(**on, pressure=1e6)
    if scene != "lap":
        contact = "unilateral" if scene == "opens" else "constant"
        joint = sj.Joint(**on, pressure="preload", contact=contact)
        options["bolts"] = [sj.Clamp(600.0, head="upper_clamped", nut="lower_clamped")]
    return sj.Structure(mesh, STEEL, fixed=["lower_left"], joints=[joint], **options)


def results(scene, mesh, **options):
    """Unknowns, first frequencies, tip and friction energy of a slow cycle; structure."""
    structure = structure_of(scene, mesh, **options)
    end = "right" if scene == "cantilever" else "upper_right"
    across = (0.0,) * (mesh.dim - 1) + (1.0,)
    system = structure.system([sj.Load(end, sj.Harmonic(SIZES[scene][2], 1.0), across)], [])
    frequencies = sj.natural_modes(system, 6, joints="stuck").frequencies
    if scene == "cantilever":
        tip, lost = float(system.P[0] @ spsolve(system.K.tocsc(), system.loads[0].vector)), None
    else:
        run = sj.quasi_static(system, cycles=2, steps_per_cycle=24)
        tip, lost = run.peak_of(end), float(run.cycles.friction[-1].sum())
    return system.n, frequencies, tip, lost, structure


def percent(value, other):
    return "" if value is None else f"{100.0 * (value / other - 1.0):+.3g}"


def compare(scene, kind, folder):
    """Print the rows of a scene with a kind of elements; time and error (%) of both choices."""
    deep = SIZES[scene][1]
    fine = "hexahedra" if kind in KINDS[:2] else "quadrilaterals"
    size, divided = (5.0, 2) if fine == "hexahedra" else (deep / 8, 2)
    best = results(scene, mesh_of(scene, fine, size, folder, 2, divided), order=2)
    _, exact, tip, lost, _ = best
    found = []
    for layers in (1,) if scene == "preload" and kind in KINDS[:2] else (1, 2):
        mesh = mesh_of(scene, kind, deep / layers, folder)
        for name, options in {"plain": PLAIN, "default": {}}.items():
            found_here, taken = cpu_seconds(results, scene, mesh, **options)
            n, frequencies, moved, energy, structure = found_here
            error = 100.0 * np.abs(frequencies / exact - 1.0).max()
            stated = structure.mesh_error
            row(
                *(scene, kind, layers, name, n, f"{taken:.2f}", percent(moved, tip)),
                *(f"{error:.2g}", f"{100.0 * stated.largest:.2g}" if stated else ""),
                percent(energy, lost),
            )
            found.append((kind, name, taken, error))
    return found


def draw(found, file):
    """Picture of the error of frequencies over the time, four kinds of elements."""
    from matplotlib import pyplot as plt

    figure, panel = plt.subplots(figsize=(6.4, 4.2), layout="constrained")
    for number, kind in enumerate(KINDS):
        for name in ("plain", "default"):
            of = [each[2:] for each in found if each[:2] == (kind, name)]
            look = {"marker": "osD^"[number], "color": f"C{number}"}
            look |= {"markerfacecolor": "white", "linestyle": ":"} if name == "plain" else {}
            label = f"{kind}, {'plain' if name == 'plain' else 'by default'}"
            panel.loglog(*zip(*of, strict=True), label=label, **look)
    panel.axhline(2.0, color="0.7", linewidth=0.8)
    panel.set(
        xlabel="processor time of matrices, modes and a slow cycle, s",
        ylabel="largest error of six frequencies, %",
    )
    panel.legend(fontsize="small", ncols=2, loc="upper center", bbox_to_anchor=(0.5, -0.16))
    figure.savefig(file, dpi=150)


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("scenes", nargs="*", metavar="SCENE", help=", ".join(SCENES))
    parser.add_argument("--kind", nargs="+", default=KINDS, choices=KINDS)
    parser.add_argument("--out", type=Path, help="folder for a picture of the last scene")
    options = parser.parse_args()
    scenes = options.scenes or SCENES
    if wrong := [scene for scene in scenes if scene not in SCENES]:
        parser.error(f"scene {wrong[0]!r}: must be one of {', '.join(SCENES)}")
    head(
        *("scene", "elements", "layers", "choice", "unknowns", "CPU s", "tip, %"),
        *("largest error of six frequencies, %", "stated, %", "friction energy, %"),
    )
    found = []
    with TemporaryDirectory() as folder:
        for scene in scenes:
            kinds = [kind for kind in options.kind if scene != "opens" or kind in KINDS[2:]]
            found = [each for kind in kinds for each in compare(scene, kind, folder)]
    if options.out:
        options.out.mkdir(parents=True, exist_ok=True)
        draw(found, options.out / "elements.png")


if __name__ == "__main__":
    main()
