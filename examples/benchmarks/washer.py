"""Pressure under a washer: whether it falls along every radius, and sums up to the bolt's force.

    python examples/benchmarks/washer.py [--quick]

A washer with a hole of 9 mm, 2.5 mm thick, lies on a plate of 8 mm and is pressed around the hole
up to a radius of 8 mm. Both are made of bricks or tetrahedra of second order. Friction limits of
constant contact, and the pressures that results show, are means over the hats of the corners of
elements; where contact opens, friction limits follow the forces of single nodes.
"""

import sys
from pathlib import Path

sys.path[:0] = [str(Path(__file__).resolve().parents[1])]

from benchmarks import head, row

# isort: split

import numpy as np
import skfem

import skfem_joint as sj
from skfem_joint.mesh import merged, named

STEEL = sj.Material(E=200e9, density=8000.0, poisson=0.3)
#: Force of the bolt, N, and radius up to which it presses, m.
FORCE, PRESSED_TO = 1e4, 8e-3


def disc(shape, radii, around, low, high, prefix):
    """Disc with a hole, between two heights; ``touches`` lies at z = 0, ``ring`` opposite."""
    layers = 1 + int(high - low > 4e-3)
    mesh = skfem.MeshHex.init_tensor(
        radii, np.linspace(0.0, 2.0 * np.pi, around + 1), np.linspace(low, high, layers + 1)
    )
    mesh = mesh.to_meshtet() if shape == "tet" else mesh
    r, angle, z = mesh.p
    p = np.array([r * np.cos(angle), r * np.sin(angle), z])
    _, first, number = np.unique(np.round(p, 9), axis=1, return_index=True, return_inverse=True)
    mesh = type(mesh)(p[:, first], number.reshape(-1)[mesh.t])
    far = low if abs(low) > abs(high) else high
    return named(mesh.with_boundaries({
        f"{prefix}touches": lambda x: np.abs(x[2]) < 1e-9,
        f"{prefix}ring": lambda x: (np.abs(x[2] - far) < 1e-9)
        & (np.hypot(x[0], x[1]) < PRESSED_TO),
    }), order=2)  # fmt: skip


def washer(shape, inner, outer, around=12):
    """Structure of a washer on a plate, with elements between radii, mm, of both."""
    mesh = merged([
        disc(shape, 1e-3 * np.array(inner), around, 0.0, 2.5e-3, "w_"),
        disc(shape, 1e-3 * np.array(outer), around, -8e-3, 0.0, "p_"),
    ])  # fmt: skip
    joint = sj.Joint("w_touches", "preload", 0.3, against="p_touches")
    bolts = [sj.Clamp(FORCE, "w_ring", "p_ring")]
    return sj.Structure(mesh, material=STEEL, free=True, joints=[joint], bolts=bolts)


def largest_rise(structure, force):
    """Largest rise of the pressure of nodal forces (N,), outwards on any radius, over its peak."""
    (pressed,) = structure.preload.joints
    nodes = np.flatnonzero(pressed.area)
    p = force[nodes] / pressed.area[nodes]
    x, y = structure.nodes[nodes, :2].T
    r, angle, rise = np.hypot(x, y), np.arctan2(y, x), 0.0
    for ray in np.unique(np.round(angle, 6)):
        along = np.flatnonzero(np.abs(angle - ray) < 1e-5)
        outwards = p[along[np.argsort(r[along])]]
        rise = max(rise, float((outwards - np.minimum.accumulate(outwards)).max()))
    return rise / float(p.max())


def main(arguments):
    alike, other = [4.5, 6, 8, 12, 16], [4.5, 5.5, 8, 10, 13, 16]
    fine = [4.5, 5.25, 6, 7, 8, 10, 12], [4.5, 5.25, 6, 7, 8, 10, 12, 16]
    cases = [([4.5, 6, 8, 12], alike, 12, "match"), ([4.5, 6, 8, 12], other, 12, "do not match")]
    if "--quick" not in arguments:
        cases.append((*fine, 24, "match, twice as fine"))
    print(f"Pressure under a washer of a bolt of {FORCE / 1e3:g} kN\n")
    head(
        *("elements of second order", "meshes", "contact points", "sum of forces over that - 1"),
        *("largest rise along a radius, % of the peak", "the same of single nodes, %"),
    )
    for shape, name in (("hex", "bricks"), ("tet", "tetrahedra")):
        for inner, outer, around, meshes in cases:
            structure = washer(shape, inner, outer, around)
            (pressed,) = structure.preload.joints
            own = np.zeros(pressed.force.size)
            own[np.flatnonzero(pressed.area)] = pressed.contact_force
            rises = (f"{100 * largest_rise(structure, f):.1f}" for f in (pressed.force, own))
            apart = f"{pressed.force.sum() / FORCE - 1.0:.0e}"
            row(name, meshes, np.count_nonzero(pressed.area), apart, *rises)


if __name__ == "__main__":
    main(sys.argv[1:])
