"""What merged contact points of condensed models cost and save, beside the error of the mesh.

    python examples/benchmarks/condensed_points.py                  all structures
    python examples/benchmarks/condensed_points.py lap preload plate
    python examples/benchmarks/condensed_points.py lap --quick      without the mesh's error

Structures whose elements of first order are computed with quadratic displacements: the laps of
``elements.py`` in tetrahedra, under an even pressure and under a bolt, and from the side in
triangles; and the plate of ``plate_bolts`` in triangles. Contact points of their condensed models
are merged into a half, a third and a quarter. Rows have what that changes in the friction energy
and in the largest displacement of a slow cycle, under some loads, and 1.5 times what halved
elements change, which is stated as the error of the mesh. The step is that of a run in time under
the highest load.
"""

import argparse
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory

sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

from benchmarks import elements, head, row

# isort: split

import skfem_joint as sj
from skfem_joint.accuracy.halved_mesh import BEYOND
from skfem_joint.scene.shipped import shipped_scene

#: Structures: scene and kind of elements, and loads, N.
STRUCTURES = {
    "lap": ("lap", "tetrahedra", (2.0, 4.0, 8.0, 12.0)),
    "preload": ("preload", "tetrahedra", (2.0, 4.0, 8.0, 12.0)),
    "side": ("lap", "triangles", (2.0, 4.0, 8.0, 12.0)),
    "plate": ("plate_bolts", "triangles", (7e3,)),
}
PARTS = (1, 2, 3, 4)
#: Steps of a run in time, in a period of 200.
STEPS = 100


def maker_of(name):
    """Function of a mesh that gives the structure, the mesh, loaded place and direction."""
    scene, kind, _ = STRUCTURES[name]
    if scene == "plate_bolts":
        plate = sj.load_scene(shipped_scene(scene))
        mesh = plate.named_mesh.other_order
        return lambda mesh: plate.changed(mesh=mesh).structure(), mesh, "free_end", (1.0, 0.0)
    with TemporaryDirectory() as folder:
        mesh = elements.mesh_of(scene, kind, 5.0, folder)
    across = (0.0,) * (mesh.dim - 1) + (1.0,)
    damped = {"stiffness_damping": 1e-5}
    return (
        lambda mesh: elements.structure_of(scene, mesh, **damped),
        mesh,
        "upper_right",
        across,
    )


def slow_cycle(system, on):
    """Friction energy of the second slow cycle, and the largest displacement."""
    run = sj.quasi_static(system, cycles=2, steps_per_cycle=24)
    return float(run.cycles.friction[-1].sum()), run.peak_of(on)


def step_ms(system):
    """Processor time of a step of a run in time, ms, beyond that of a single one."""
    plan = {"step": 1.0 / system.loads[0].amplitude.highest_frequency / 200.0}
    seconds = []
    for count in (1 + STEPS, 1, 1 + STEPS):  # the first one may compile
        start = time.process_time()
        sj.integrate(system, n_steps=count, **plan)
        seconds.append(time.process_time() - start)
    return 1e3 * (seconds[2] - seconds[1]) / STEPS


def percent(values, others, factor=100.0):
    return " | ".join(f"{factor * (a / b - 1.0):+.2g}" for a, b in zip(values, others, strict=True))


def compare(name, quick):
    """Print the rows of a structure."""
    made, mesh, on, direction = maker_of(name)
    structure, forces = made(mesh), STRUCTURES[name][2]
    finer = None if quick else made(sj.refined(mesh))

    def loaded(structure, force, frequency=1.0):
        load = sj.Load(on, sj.Harmonic(force, frequency), direction)
        return structure.system([load], [])

    first = float(sj.natural_modes(loaded(structure, 1.0), 1, joints="stuck").frequencies[0])
    count = loaded(structure, 1.0).contact.count
    exact = {}
    for part in PARTS:
        points = "all" if part == 1 else count // part
        moving = sj.condense(loaded(structure, forces[-1], first), contact_points=points)
        times = f"{moving.contact.count} | {step_ms(moving):.2g}"
        for force in forces:
            small = sj.condense(loaded(structure, force), 0, contact_points=points)
            found = slow_cycle(small, on)
            if part == 1:
                exact[force] = found
            changes = percent(found, exact[force]) if part > 1 else f"{1e3 * found[0]:.3g} mJ |"
            row(name, f"{force:g}", times, changes)
    for force in () if finer is None else forces:
        system = loaded(finer, force)
        changes = percent(slow_cycle(system, on), exact[force], 100.0 * BEYOND)
        row(name, f"{force:g}", f"{system.contact.count} on halved elements | ", changes)


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("structures", nargs="*", metavar="STRUCTURE", help=", ".join(STRUCTURES))
    parser.add_argument("--quick", action="store_true", help="without the error of the mesh")
    options = parser.parse_args()
    if wrong := [name for name in options.structures if name not in STRUCTURES]:
        parser.error(f"structure {wrong[0]!r}: must be one of {', '.join(STRUCTURES)}")
    head(
        *("structure", "load, N", "contact points", "CPU of a step, ms"),
        *("friction energy, %", "displacement, %"),
    )
    for name in options.structures or STRUCTURES:
        compare(name, options.quick)


if __name__ == "__main__":
    main()
