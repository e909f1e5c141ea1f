"""Two bolted beams of up to a million unknowns, by substructures: preload, modes and a curve.

    python examples/benchmarks/substructures.py                 100,000, beside the whole structure
    python examples/benchmarks/substructures.py 250000 1000000  without it
    python examples/benchmarks/substructures.py --workers 2     by two processes
    python examples/benchmarks/substructures.py --dask 2        by two workers of Dask
    python examples/benchmarks/substructures.py --quick         8,000, beside the whole structure

Beams of 360 mm x 25 mm x 12.5 mm lap over 40 mm and are pressed by two bolts; one is held at its
end. Gmsh makes the mesh of even tetrahedra, whose displacements are of second order, so that the
joint becomes finer with the rest. The way is that of any user: `Structure` with its preload, the
condensed model with the lowest modes, the first ten with the joint stuck, and the curve of the
first at eight levels. BLAS threads are pinned. Memory is the peak of the process up to there, and
of its largest child.
"""

import sys
import time
from argparse import ArgumentParser
from contextlib import contextmanager, nullcontext
from pathlib import Path
from tempfile import TemporaryDirectory

sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

from benchmarks import NOT_INSTALLED, head, row

# isort: split

from resource import RUSAGE_CHILDREN, RUSAGE_SELF, getrusage

import numpy as np

import skfem_joint as sj
from skfem_joint.study.sweep import processes

try:
    import gmsh
except ImportError:
    sys.exit(NOT_INSTALLED)

LENGTH, WIDTH, DEPTH, LAP = 0.36, 0.025, 0.0125, 0.04  # m
BOLTS, HEAD = (-0.01, 0.01), 0.006  # m from the middle of the lap, and radius under heads
MODES, LEVELS = 10, 8
#: Unknowns of a part.
PART = 170_000


def bolted_beams(size):
    """Mesh of elements of about a size, m."""
    gmsh.initialize()
    gmsh.option.setNumber("General.Terminal", 0)
    occ, solids = gmsh.model.occ, {}
    for name, start, low, back in (
        ("upper", -0.5 * LAP, 0.0, DEPTH),
        ("lower", 0.5 * LAP - LENGTH, -DEPTH, -DEPTH),
    ):
        box = occ.addBox(start, -0.5 * WIDTH, low, LENGTH, WIDTH, DEPTH)
        marks = [occ.addDisk(x, 0.0, back, HEAD, HEAD) for x in BOLTS]
        marks.append(occ.addRectangle(-0.5 * LAP, -0.5 * WIDTH, 0.0, LAP, WIDTH))
        parts, _ = occ.fragment([(3, box)], [(2, mark) for mark in marks])
        solids[name] = [number for dim, number in parts if dim == 3]
    occ.synchronize()
    for name, numbers in solids.items():
        gmsh.model.addPhysicalGroup(3, numbers, name=name)
        for _, surface in gmsh.model.getBoundary([(3, k) for k in numbers], oriented=False):
            if label := _label(name, occ.getCenterOfMass(2, surface), occ.getMass(2, surface)):
                gmsh.model.addPhysicalGroup(2, [surface], name=label)
    for limit in ("Mesh.MeshSizeMin", "Mesh.MeshSizeMax"):
        gmsh.option.setNumber(limit, size)
    gmsh.model.mesh.generate(3)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "beams.msh"
        gmsh.write(str(path))
        gmsh.finalize()
        return sj.load_meshes(path)


def _label(name, middle, area):
    """Name of a surface of a beam by its middle, or None."""
    x, _, z = middle
    turn = 1.0 if name == "upper" else -1.0
    if np.isclose(turn * x, LENGTH - 0.5 * LAP):
        return f"{name}_end"
    if np.isclose(z, 0.0) and np.isclose(area, LAP * WIDTH):
        return f"{name}_face"
    for number, at in enumerate(BOLTS, 1):
        if np.isclose(z, turn * DEPTH) and np.isclose(x, at) and area < 4.0 * HEAD**2:
            return f"{name}_bolt_{number}"
    return None


def structure(mesh, parts):
    """The beams, held at one end, with their bolts tightened."""
    return sj.Structure(
        mesh,
        sj.Material(E=200e9, density=7800.0, poisson=0.29),
        joints=[sj.Joint("lower_face", "preload", 0.3, against="upper_face")],
        bolts=[sj.Clamp(8e3, head=f"upper_bolt_{i}", nut=f"lower_bolt_{i}") for i in (1, 2)],
        fixed=["lower_end"],
        order=2,
        parts=parts,
    )


class Watch:
    """Seconds on the clock and of the processor since the last look, and memory up to now."""

    def __init__(self):
        self.last = self._now()

    @staticmethod
    def _now():
        return time.perf_counter(), time.process_time()

    def look(self):
        now = self._now()
        wall, own = (after - before for after, before in zip(now, self.last, strict=True))
        self.last = now
        return f"{wall:.0f} ({own:.0f})"

    @staticmethod
    def memory():
        return " + ".join(
            f"{getrusage(who).ru_maxrss / 2**20:.1f}"
            for who in (RUSAGE_SELF, RUSAGE_CHILDREN)
            if getrusage(who).ru_maxrss
        )


def way(mesh, parts, label, made):
    """Print the row of a mesh: the whole way; returns model, modes and curve."""
    watch, seconds = Watch(), [made]
    pressed = structure(mesh, parts)
    seconds.append(watch.look())
    system = pressed.system(points=["upper_end"])
    del pressed
    seconds.append(watch.look())
    small = sj.condense(system, 2 * MODES, parts=parts)
    seconds.append(watch.look())
    modes = sj.natural_modes(small, MODES, joints="stuck")
    seconds.append(watch.look())
    (curve,) = sj.backbone(small, (1,), LEVELS)
    seconds.append(watch.look())
    count = "whole" if parts is None else parts.count
    row(label, f"{system.n:,}", system.contact.count, count, *seconds, Watch.memory())
    for text in small.notes + curve.notes:
        print(f"  {text}", file=sys.stderr)
    return system, small, modes, curve


def compare(one, other):
    """Largest relative differences of the static stiffness, frequencies and the curve."""
    (system, small, modes, curve), (_, large, others, whole) = one, other
    k = large.contact.B.shape[0]
    stiffness = abs(small.K[:k, :k] - large.K[:k, :k]).max() / abs(large.K[:k, :k]).max()
    of_modes = abs(modes.frequencies / others.frequencies - 1.0).max()
    damping, of_whole = curve.friction_damping, whole.friction_damping
    print(
        f"\n- {system.n:,} unknowns beside the whole structure: stiffness of the contact "
        f"{stiffness:.1e}, frequencies of {MODES} modes {of_modes:.1e}, of the curve "
        f"{abs(curve.frequency / whole.frequency - 1.0).max():.1e}, its damping "
        f"{abs(damping - of_whole).max() / of_whole.max():.1e} of its largest."
    )


@contextmanager
def dask(workers):
    """Executor of a local cluster of Dask."""
    from distributed import Client, LocalCluster

    with (
        LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None) as cluster,
        Client(cluster) as client,
    ):
        yield client.get_executor()


def main(arguments):
    """Table of the sizes that are asked for."""
    parser = ArgumentParser()
    parser.add_argument("sizes", nargs="*", type=int)
    parser.add_argument("--whole", action="store_true", help="beside the whole structure too")
    parser.add_argument("--quick", action="store_true")
    parser.add_argument("--parts", type=int)
    parser.add_argument("--workers", type=int)
    parser.add_argument("--dask", type=int)
    asked = parser.parse_args(arguments)
    sizes = asked.sizes or [8_000 if asked.quick else 100_000]
    pool = nullcontext()
    if asked.workers:
        pool = processes(asked.workers)
    elif asked.dask:
        pool = dask(asked.dask)
    head(
        *("asked for", "unknowns", "contact points", "parts", "mesh, s", "preload, s"),
        *("system, s", "model, s", "modes, s", "curve, s", "peak memory, GB"),
    )
    found = []
    with pool as executor:
        for size in sizes:
            watch = Watch()
            # As a mesh of 2 mm has 644,000.
            mesh = bolted_beams(0.002 * (644e3 / size) ** (1 / 3))
            made = watch.look()
            count = asked.parts or max(3, round(size / PART))
            of_parts = way(mesh, sj.Parts(count, executor), size, made)
            if asked.whole or not asked.sizes:
                found.append((of_parts, way(mesh, None, size, made)))
    for both in found:
        compare(*both)
    print(
        "\nSeconds are those of the clock, and in parentheses those of this process; memory is the "
        "peak of this process, and of its largest child, up to the end of the row."
    )


if __name__ == "__main__":
    main(sys.argv[1:])
