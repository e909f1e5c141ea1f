"""Meshes of hexahedra with prisms, and of quadrilaterals with triangles, for the tests of both."""

from typing import Any

import numpy as np

from skfem_joint.mesh import NamedMesh, build_box, build_plate
from skfem_joint.mesh.cells import CELLS, corner_count
from skfem_joint.mesh.collapsed import joined
from skfem_joint.mesh.named import from_parts

# Corners of scikit-fem's hexahedron that are the two prisms of one that is cut, by the axis of the
# prisms and the diagonal of the cut.
CUTS = {
    ("z", 0): ([7, 4, 1, 6, 2, 0], [7, 1, 5, 6, 0, 3]),
    ("z", 1): ([7, 4, 5, 6, 2, 3], [4, 1, 5, 2, 0, 3]),
    ("x", 0): ([7, 5, 3, 4, 1, 0], [7, 3, 6, 4, 0, 2]),
    ("x", 1): ([7, 5, 6, 4, 1, 2], [5, 3, 6, 1, 0, 2]),
}


def mixed(whole: NamedMesh, kind: str, cuts: list[tuple[Any, Any]], order: int = 1) -> NamedMesh:
    """Mesh in which some elements are cut into two of a kind.

    ``cuts`` are pairs of elements and of the corners of both parts.
    """
    t = whole.mesh.t.astype(int)
    cut = np.unique(np.concatenate([elements for elements, _ in cuts]))
    kept = np.setdiff1d(np.arange(whole.n_elements), cut)
    parts = [(CELLS[whole.kind], t[:, kept])]
    origin = [kept]
    for elements, halves in cuts:
        for corners in halves:
            parts.append((CELLS[kind], t[corners][:, elements]))
            origin.append(elements)
    cell, t = joined(parts)
    of = np.concatenate(origin)
    every = cell.facets(np.asarray(t), len(whole.coordinates))[0]
    every = every[:, corner_count(every) >= whole.dim]
    facets = {}
    for name, chosen in whole.boundaries.items():  # triangles in place of those that are cut
        corners = np.unique(whole.mesh.facets[:, chosen])
        facets[name] = every[:, np.isin(every, corners).all(axis=0)]
    regions = {n: np.flatnonzero(np.isin(of, chosen)) for n, chosen in whole.regions.items()}
    return from_parts(
        cell, whole.mesh.p, t, xyz=whole.coordinates, order=order, regions=regions, facets=facets,
        points=whole.points,
    )  # fmt: skip


def mixed_box(
    n: int = 1, order: int = 1, size: tuple[float, float, float] = (0.6, 0.05, 0.02)
) -> NamedMesh:
    """Box of 6 n x 3 n x 2 n cells, some cut along z by either diagonal, one row cut along x."""
    third = size[0] / 3
    strips = [("arm", 2 * third, 4 * n), ("lap", third, 2 * n)]
    box = build_box(
        strips, size[1:], (3 * n, 2 * n), points={"corner": (0.0, 0.0, 0.0)},
        boundaries={
            **{side: side for side in ("left", "right", "bottom", "top", "front", "back")},
            "face": ("back", "lap"),
        },
    )  # fmt: skip
    i, j, k = np.unravel_index(np.arange(box.n_elements), (6 * n, 3 * n, 2 * n))
    row = (j == 0) & (k == 0)
    columns = (j > 0) & ((i + 2 * j) % 3 < 2)
    chosen = [(row, ("x", 0)), (columns & ((i + j) % 2 == 0), ("z", 0)),
              (columns & ((i + j) % 2 == 1), ("z", 1))]  # fmt: skip
    cuts = [(np.flatnonzero(mask), CUTS[key]) for mask, key in chosen]
    return mixed(box, "prism", cuts, order)


def mixed_plate(n: int = 1, order: int = 1) -> NamedMesh:
    """Plate of 6 n x 3 n cells of 0.1 m x 0.02 m, some cut by either diagonal."""
    plate = build_plate(
        [("arm", 0.4, 4 * n), ("lap", 0.2, 2 * n)], 0.06, 3 * n, points={"corner": (0.0, 0.0)},
        boundaries={
            **{side: side for side in ("left", "right", "bottom", "top")},
            "face": ("top", "lap"),
        },
    )  # fmt: skip
    i, j = np.unravel_index(np.arange(plate.n_elements), (6 * n, 3 * n))
    halves = ([0, 1, 2], [0, 2, 3]), ([0, 1, 3], [1, 2, 3])
    cuts = [(np.flatnonzero((i + 2 * j) % 3 == k), halves[k]) for k in (0, 1)]
    return mixed(plate, "triangle", cuts, order)


def shaken(mesh: NamedMesh, share: float = 0.15, inside: bool = False) -> NamedMesh:
    """Mesh with vertices moved by a share of the size of its cells, some of them to all sides.

    With ``inside`` those on the border stay on it: they move along its sides, and not on its edges.
    """
    p, rng = mesh.mesh.p, np.random.default_rng(4)
    spacing = np.array([np.diff(np.unique(np.round(x, 9))).min() for x in p])
    shift = share * spacing[:, np.newaxis] * rng.uniform(-1.0, 1.0, p.shape)
    if inside:
        low, high = p.min(axis=1, keepdims=True), p.max(axis=1, keepdims=True)
        shift[(p < low + 1e-9) | (p > high - 1e-9)] = 0.0
        lap = np.unique(mesh.mesh.facets[:, mesh.boundaries["face"]])
        shift[0, lap] = 0.0  # the face keeps its ends
    moved = np.zeros((3, p.shape[1]))
    moved[: len(p)] = p + shift
    return from_parts(
        CELLS[mesh.family], moved[: len(p)], mesh.mesh.t, xyz=moved.T, order=mesh.order,
        regions=mesh.regions, points=mesh.points,
        facets={name: mesh.mesh.facets[:, chosen] for name, chosen in mesh.boundaries.items()},
    )  # fmt: skip
