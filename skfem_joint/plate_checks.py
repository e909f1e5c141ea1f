"""What makes a proper plane mesh; each check raises ValueError with the place and the reason."""

from __future__ import annotations

from typing import Literal

import numpy as np
import skfem
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from skfem_joint.meshing import TOLERANCE

IntArray = NDArray[np.int64]
FloatArray = NDArray[np.float64]
Kind = Literal["triangle", "quadrilateral"]

#: Kind of the elements by their corners.
KINDS: dict[int, Kind] = {3: "triangle", 4: "quadrilateral"}
#: Least size of a plate, m: its stiffness, mass and energies must not overflow.
SHORTEST = 1e-20


def spot(position: FloatArray) -> str:
    """Position in a message."""
    return f"({', '.join(f'{value:.9g}' for value in position)}) m"


def corner_areas(p: FloatArray, t: IntArray) -> FloatArray:
    """Parallelogram area (m2) at each corner of each element, positive counter-clockwise."""
    forward = p[:, np.roll(t, -1, axis=0)] - p[:, t]
    backward = p[:, np.roll(t, 1, axis=0)] - p[:, t]
    return np.asarray(forward[0] * backward[1] - forward[1] * backward[0])


def check_shapes(p: FloatArray, t: IntArray) -> None:
    """Refuse elements that are not convex or have no area."""
    size = float(np.ptp(p, axis=1).max())
    if size < SHORTEST:
        raise ValueError(f"the plate is {size:.3g} m in size: it must be {SHORTEST:g} m or more")
    area = corner_areas(p, t)
    longest = ((p[:, np.roll(t, -1, axis=0)] - p[:, t]) ** 2).sum(axis=0).max(axis=0)
    flat = np.abs(area) <= TOLERANCE * longest
    left = (area > 0.0).sum(axis=0)
    kind = KINDS[len(t)]

    def place(wrong: NDArray[np.bool_]) -> str:
        corners = p[:, t[:, np.argmax(wrong)]].T
        more = f" ({wrong.sum()} such elements)" if wrong.sum() > 1 else ""
        return f"with corners at {', '.join(spot(corner)[:-2] for corner in corners)} m{more}"

    if flat.any():
        reason = "has no area" if len(t) == 3 else "has no area or three corners on one line"
        raise ValueError(f"a {kind} {reason}: {place(flat.any(axis=0))}. Mesh this place anew")
    if len(t) == 4:
        for wrong, reason in (
            (left == 2, "crosses itself"),
            ((left == 1) | (left == 3), "is not convex (its Jacobian changes sign)"),
        ):
            if wrong.any():
                raise ValueError(f"a {kind} {reason}: {place(wrong)}. Mesh this place anew")


def check_neighbours(p: FloatArray, t: IntArray) -> None:
    """Refuse counter-clockwise elements that lie on the same side of an edge."""
    start, stop = t.ravel(), np.roll(t, -1, axis=0).ravel()
    code = start * np.int64(p.shape[1]) + stop
    order = np.argsort(code, kind="stable")
    again = np.flatnonzero(np.diff(code[order]) == 0)
    if again.size:
        a, b = (spot(p[:, t[:, order[again[0] + i] % t.shape[1]]].mean(axis=1)) for i in range(2))
        edge = order[again[0]]
        raise ValueError(
            f"two elements, with centres at {a} and {b}, lie on the same side of their edge from "
            f"{spot(p[:, start[edge]])} to {spot(p[:, stop[edge]])}: the mesh overlaps itself or "
            "an element is inverted. Two plates over each other must not share nodes"
        )


def check_connections(mesh: skfem.Mesh, body: IntArray) -> None:
    """Refuse nodes of one body in one place, and elements that only touch in a point."""
    ends = mesh.facets[:, mesh.f2t[1] < 0]
    hinge = np.bincount(ends.ravel(), minlength=mesh.nvertices) > 2
    if hinge.any():
        raise ValueError(
            f"elements only touch in the point {spot(mesh.p[:, np.argmax(hinge)])}, a hinge: join "
            "them along an edge, or give them separate nodes"
        )
    body_of = np.empty(mesh.nvertices, np.int64)
    body_of[mesh.t] = body
    size = float(np.ptp(mesh.p, axis=1).max())
    apart = np.vstack([mesh.p, 2.0 * size * body_of]).T  # bodies may lie over each other
    double = cKDTree(apart).query(apart, k=2)[0][:, 1] <= TOLERANCE * size
    if double.any():
        raise ValueError(
            f"{double.sum()} nodes of one body lie in one place with another node that is not "
            f"joined to them, the first at {spot(mesh.p[:, np.argmax(double)])}: the plate would "
            "be cracked there. Merge them (Gmsh: Coherence Mesh), or open the gap if it is meant"
        )


def facet_numbers(mesh: skfem.Mesh, ends: IntArray, name: str) -> IntArray:
    """Sorted numbers of the facets between pairs of vertices."""
    count = np.int64(mesh.nvertices)
    known = mesh.facets[0].astype(np.int64) * count + mesh.facets[1]
    low, high = np.sort(ends.astype(np.int64), axis=0)
    order = np.argsort(known)
    at = order[np.searchsorted(known, low * count + high, sorter=order).clip(max=known.size - 1)]
    wrong = known[at] != low * count + high
    if wrong.any():
        a, b = mesh.p[:, ends[:, np.argmax(wrong)]].T
        raise ValueError(not_an_edge(name, a, b))
    return np.unique(at).astype(np.int64)


def not_an_edge(name: str, a: FloatArray, b: FloatArray) -> str:
    """What to say of a boundary with a line from ``a`` to ``b`` that no element has."""
    return (
        f"boundary {name!r}: its line from {spot(a)} to {spot(b)} is not an edge of any element. "
        "In Gmsh, embed the curve in the surface before meshing"
    )
