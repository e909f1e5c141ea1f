"""What the names of a mesh stand for, in sentences: how many elements or sides, and their size."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from itertools import islice

from skfem_joint.body.body import Body
from skfem_joint.ground.errors import MOST_LISTED
from skfem_joint.mesh.cells import spot

#: Units of a length, an area and a volume.
_UNITS = ("", " m", " m2", " m3")


def named_parts(body: Body) -> list[str]:
    """Sentences with the names of regions, boundaries and points."""
    mesh = body.mesh
    parts: tuple[tuple[str, Collection[str], Iterator[str]], ...] = (
        ("Regions", mesh.regions, _regions(body)),
        ("Boundaries", mesh.boundaries, _boundaries(body)),
        ("Points", mesh.points, _points(body)),
    )
    sentences = []
    for kind, names, texts in parts:
        shown, more = "; ".join(islice(texts, MOST_LISTED)), len(names) - MOST_LISTED
        if shown:
            sentences.append(f"{kind}: {shown}{f'; and {more} more' if more > 0 else ''}.")
    return sentences


def _regions(body: Body) -> Iterator[str]:
    sizes, unit = body.basis.dx.sum(axis=1), _UNITS[body.dim]
    for name, elements in body.mesh.regions.items():
        yield f"{name} ({_counted(len(elements), 'element')}, {sizes[elements].sum():.5g}{unit})"


def _boundaries(body: Body) -> Iterator[str]:
    for name, facets in body.mesh.boundaries.items():
        if body.dim == 1:
            yield f"{name} ({_counted(len(facets), 'point')})"
            continue
        size = body.facet_basis(facets).dx.sum()
        yield f"{name} ({_counted(len(facets), 'side')}, {size:.5g}{_UNITS[body.dim - 1]})"


def _points(body: Body) -> Iterator[str]:
    for name, vertex in body.mesh.points.items():
        yield f"{name} at {spot(body.mesh.coordinates[vertex])}"


def _counted(count: int, what: str) -> str:
    return f"{count} {what}{'' if count == 1 else 's'}"
