"""Meshes of scikit-fem get names, bodies and checks; they merge and refine without losing any."""

from dataclasses import replace

import numpy as np
import pytest
import skfem
from mesh_files import (
    FLAT_AND_SOLID,
    KINDS,
    PLAIN,
    SECOND,
    boundary_sizes,
    region_sizes,
    sizes,
    strip,
)
from mixed_meshes import mixed_box, mixed_plate, shaken

from skfem_joint.ground.errors import InputError
from skfem_joint.mesh import NamedMesh, build_bar, merged, named, refined
from skfem_joint.mesh.cells import corner_count


def renamed(mesh: NamedMesh, prefix: str, **options) -> NamedMesh:
    """The same mesh with a word before its names."""
    groups = [
        {prefix + name: group for name, group in groups.items()}
        for groups in (mesh.regions, mesh.boundaries, mesh.points)
    ]
    plain = replace(mesh.mesh, _boundaries=groups[1] or None, _subdomains=groups[0])
    return named(plain, points=groups[2], order=mesh.order, **options)


@pytest.mark.parametrize(("kind", "order"), PLAIN)
def test_meshes_of_scikit_fem_keep_their_numbers_and_names(kind, order):
    plain = type(strip(kind).mesh).init_refdom().refined(2)
    rng = np.random.default_rng(1)
    plain = replace(plain, t=plain.t[:, rng.permutation(plain.nelements)])
    plain = plain.with_subdomains({"half": lambda x: x[0] < 0.5, "all": lambda x: x[0] > -1.0})
    plain = plain.with_boundaries({"end": lambda x: x[0] < 1e-9, "far": np.array([3])})
    mesh = named(plain, order=order, points={"corner": 0})
    np.testing.assert_array_equal(mesh.mesh.p, plain.p)
    np.testing.assert_array_equal(mesh.mesh.t, plain.t)
    assert (mesh.kind, mesh.order, mesh.dim) == (kind, order, plain.dim())
    np.testing.assert_array_equal(mesh.regions["all"], np.arange(plain.nelements))
    np.testing.assert_array_equal(mesh.regions["half"], plain.subdomains["half"])
    if kind == "line":
        assert mesh.points == {"corner": 0, "end": 0, "far": 3}
        assert mesh.boundaries == {}
        assert set(mesh.mesh.boundaries) == {"corner", "end", "far"}
    else:
        assert mesh.points == {"corner": 0}
        for name, facets in plain.boundaries.items():
            np.testing.assert_array_equal(mesh.boundaries[name], facets)
    np.testing.assert_array_equal(mesh.coordinates[:, : mesh.dim], plain.p.T)
    assert not mesh.body.any()
    again = named(mesh.mesh, points=mesh.points, order=order)
    assert again.points == mesh.points
    assert again.boundaries.keys() == mesh.boundaries.keys()


@pytest.mark.parametrize(("kind", "order"), [kind for kind in PLAIN if kind[1] == 2])
def test_second_order_meshes_of_scikit_fem_are_made_straight(kind, order):
    straight = strip(kind).mesh
    second = SECOND[kind].from_mesh(straight)
    mesh = named(second.with_subdomains({"all": np.arange(straight.nelements)}))
    assert (mesh.order, mesh.notes, type(mesh.mesh)) == (order, (), type(straight))
    np.testing.assert_array_equal(mesh.mesh.p, straight.p)
    np.testing.assert_array_equal(mesh.mesh.t, straight.t)
    assert named(second, order=1).order == 1


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"_subdomains": {"a": np.array([0, 99])}}, "region 'a' must hold .* 0 to 31, found 0"),
        ({"_subdomains": {"a": np.array([-1])}}, "region 'a' must hold whole numbers"),
        ({"_subdomains": {"a": np.array([], dtype=int)}}, "region 'a' is empty"),
        ({"_subdomains": {"a": np.ones(32, dtype=bool)}}, "region 'a' must hold whole numbers"),
        ({"_boundaries": {"a": np.array([1000])}}, "boundary 'a' must hold whole numbers"),
        (
            {"_boundaries": {"a": np.array([1])}, "_subdomains": {"a": np.array([1])}},
            "'a' is both a region and a boundary",
        ),
        ({"_subdomains": {"tip": np.array([1])}}, "'tip' is both a region and a point"),
        ({"_subdomains": {'a"b': np.array([1])}}, "name 'a\"b': names may not"),
        ({"doflocs": np.zeros((2, 50))}, "belongs to no element|in size"),
    ],
)
def test_groups_that_a_mesh_cannot_have_are_refused(change, reason):
    mesh = strip(boundaries={}).mesh
    with pytest.raises(InputError, match=reason):
        named(replace(mesh, **change), points={"tip": 0})


def test_orders_and_points_that_cannot_be_are_refused():
    with pytest.raises(InputError, match="allowed are 1 and 2, for lines 1"):
        named(skfem.MeshLine(), order=2)
    with pytest.raises(InputError, match="point 'p' must hold whole numbers from 0 to 3"):
        named(skfem.MeshTri(), points={"p": 4})


def with_p(mesh: skfem.Mesh, changes: dict[int, tuple[float, ...]]) -> skfem.Mesh:
    p = mesh.p.copy()
    for vertex, place in changes.items():
        p[:, vertex] = place
    return replace(mesh, doflocs=p)


@pytest.mark.parametrize(
    ("mesh", "reason"),
    [
        (skfem.MeshTri1DG.from_mesh(skfem.MeshTri1()),
         "MeshTri1DG with 2 coordinates is not a mesh of line, tri"),
        (skfem.MeshLine1(np.array([[0.0, 1.0, 2.0]]), np.array([[0], [1]])),
         "vertex 2 belongs to no element; take"),
        (skfem.MeshLine1(np.array([[0.0, np.nan]]), np.array([[0], [1]])),
         r"node 2 at \(nan, 0, 0\) m: coordinates must be finite"),
        (skfem.MeshTri1(np.array([[0.0, 1.0, 0.5], [0.0, 0.0, 1e-12]]), np.array([[0], [1], [2]])),
         r"triangle has no area.* at \(0, 0, 0\) m to \(1, 0, 0\) m to \(0\.5, 1e-12"),
        (with_p(skfem.MeshTet1.init_refdom(), {3: (0.3, 0.3, 1e-12)}), "tetrahedron has no volume"),
        (with_p(skfem.MeshQuad1(), {2: (0.2, 0.2)}), "quadrilateral crosses itself or is not conv"),
        (with_p(skfem.MeshQuad1(), {2: (0.0, 1.0), 3: (1.0, 1.0)}), "crosses itself or is not"),
        (with_p(skfem.MeshQuad1(), {2: (0.5, 0.5)}), "no area, as a whole or at a corner"),
        (with_p(skfem.MeshHex1(), {7: (0.3, 0.3, 0.3)}), "hexahedron crosses itself or is not"),
        (with_p(skfem.MeshHex1(), {7: (1.0, 1.0, 0.0)}), "two corners in one place"),
        (skfem.MeshLine1(np.array([[0.0, 1.0, 1.0 + 1e-12]]), np.array([[0, 1], [1, 2]])),
         "line has two corners in one place"),
        (skfem.MeshLine1(np.array([[0.0, 1.0, 0.5]]), np.array([[0, 1], [1, 2]])),
         r"centres at \(0\.5, 0, 0\) m and \(0\.75, 0, 0\) m, lie on the same .*\(1, 0, 0\) m"),
        (skfem.MeshLine1(np.array([[0.0, 1.0, 2.0, 3.0]]), np.array([[0, 1, 1], [1, 2, 3]])),
         "the mesh branches, folds back or overlaps itself"),
        (skfem.MeshTri1(np.array([[0.0, 1, 1, 0.7], [0, 0, 1, 0.2]]),
                        np.array([[0, 0], [1, 1], [2, 3]])),
         r"same side of what joins them, \(0, 0, 0\) m to \(1, 0, 0\) m: .* must not share nodes"),
        (skfem.MeshTet1(np.array([[0.0, 1, 0, 0, 0.2], [0, 0, 1, 0, 0.2], [0, 0, 0, 1, 2.0]]),
                        np.array([[0, 0], [1, 1], [2, 2], [3, 4]])),
         r"same side of what joins them, \(0, 0, 0\) m to \(1, 0, 0\) m to \(0, 1, 0\) m"),
    ],
)  # fmt: skip
def test_meshes_and_elements_that_are_none_are_refused_with_their_place(mesh, reason):
    with pytest.raises(InputError, match=reason):
        named(mesh)


@pytest.mark.parametrize("kind", ["line", "triangle", "hexahedron"])
def test_names_that_are_numbers_ask_for_text(kind):
    plain = type(strip(kind).mesh)()
    for mesh, what in (
        (plain.with_subdomains({1: np.array([0])}), "region 1"),
        (plain.with_boundaries({1: np.array([0]), "left": np.array([0])}), "boundary 1"),
    ):
        with pytest.raises(InputError, match=rf"{what}: names must be text, found int; .*'1': "):
            named(mesh)
    with pytest.raises(InputError, match="point 7: names must be text"):
        named(plain, points={7: 0})


def cubes(*corners: tuple[float, ...], kind: str = "hexahedron") -> skfem.Mesh:
    """Unit cubes or squares at the corners, joined where their vertices meet."""
    unit = skfem.MeshHex1() if len(corners[0]) == 3 else skfem.MeshQuad1()
    if kind == "tetrahedron":
        unit = unit.to_meshtet()
    elif kind == "triangle":
        unit = unit.to_meshtri()
    p = np.hstack([unit.p + np.array([corner]).T for corner in corners])
    t = np.hstack([unit.t + i * unit.p.shape[1] for i in range(len(corners))])
    p, number = np.unique(p, axis=1, return_inverse=True)
    return type(unit)(p, number.ravel()[t])


def test_bodies_that_touch_in_a_point_or_an_edge_are_refused():
    for kind in ("quadrilateral", "triangle"):
        with pytest.raises(InputError, match=r"touch in the point \(1, 1, 0\) m, a hinge"):
            named(cubes((0, 0), (1, 1), kind=kind))
        around = [(0, -1), (1, -1), (2, -1), (2, 0), (2, 1)]
        assert named(cubes((0, 0), (1, 1), *around, kind=kind)).body.max() == 0
    for kind in ("hexahedron", "tetrahedron"):
        with pytest.raises(InputError, match=r"touch in the point \(1, 1, 1\) m, a hinge"):
            named(cubes((0, 0, 0), (1, 1, 1), kind=kind))
        with pytest.raises(InputError, match=r"touch in the point \(1, 1, [01]\) m, a hinge"):
            named(cubes((0, 0, 0), (1, 1, 0), kind=kind))


@pytest.mark.parametrize(("kind", "order"), FLAT_AND_SOLID)
def test_a_crack_by_mistake_is_refused_and_a_gap_is_not(kind, order):
    """Two by two cells, through the thickness, whose right part has its middle nodes twice."""
    dim = strip(kind).dim
    mesh = cubes(*((i, j, 0)[:dim] for i in (0, 1) for j in (0, 1)), kind=kind)
    split_nodes = np.flatnonzero((mesh.p[:2] == [[2.0], [1.0]]).all(axis=0))
    upper = mesh.p[1, mesh.t].mean(axis=0) > 1.0
    t = mesh.t.copy()
    for i, node in enumerate(split_nodes):
        t[(t == node) & upper] = mesh.p.shape[1] + i
    for gap, cracked in ((0.0, True), (1e-10, True), (1e-3, False)):
        moved = mesh.p[:, split_nodes]
        moved[1] += gap
        opened = type(mesh)(np.hstack([mesh.p, moved]), t)
        if not cracked:
            assert named(opened, order=order).body.max() == 0
            continue
        with pytest.raises(InputError, match=r"[24] nodes of one body lie .* first at \(2, 1, "):
            named(opened, order=order)


@pytest.mark.parametrize(("kind", "order"), KINDS)
def test_bodies_are_numbered_by_their_first_elements(kind, order):
    parts = [renamed(strip(kind, order), f"{i} ") for i in range(3)]
    mesh = merged(parts).mesh
    shuffled = np.random.default_rng(3).permutation(mesh.nelements)
    mixed = named(replace(mesh, t=mesh.t[:, shuffled], _subdomains=None, _boundaries=None))
    whose = shuffled // parts[0].n_elements
    _, first = np.unique(whose, return_index=True)
    np.testing.assert_array_equal(mixed.body, np.argsort(np.argsort(first))[whose])


@pytest.mark.parametrize(("kind", "order"), KINDS)
def test_merged_bodies_stay_apart_even_in_one_place(kind, order):
    upper, lower = renamed(strip(kind, order), "upper "), renamed(strip(kind, order), "lower ")
    both = merged([upper, lower])
    np.testing.assert_array_equal(both.body, np.repeat([0, 1], upper.n_elements))
    vertices = [np.unique(both.mesh.t[:, both.body == body]) for body in (0, 1)]
    assert np.intersect1d(*vertices).size == 0
    assert boundary_sizes(both) == pytest.approx(boundary_sizes(upper) | boundary_sizes(lower))
    assert region_sizes(both) == pytest.approx(region_sizes(upper) | region_sizes(lower))
    assert set(both.body[both.regions["lower joint"]]) == {1}
    assert set(both.points) == {"upper tip", "upper foot", "lower tip", "lower foot"}
    np.testing.assert_array_equal(
        both.coordinates[both.points["lower tip"]], lower.coordinates[lower.points["lower tip"]]
    )


def test_parallel_bars_are_measured_along_the_first():
    """The second is drawn the other way: its place decides, not how it was numbered."""
    axis, across = np.array([0.6, 0.8, 0.0]), np.array([-0.8, 0.6, 0.0])
    first = build_bar([("a", 0.5, 5), ("b", 0.2, 2)], {"wall": 0.0, "end": 0.7})
    other = build_bar([("c", 0.2, 4), ("d", 0.3, 3)], {"tip": 0.0, "foot": 0.5})
    first = replace(first, coordinates=first.mesh.p.T * axis)
    other = replace(other, coordinates=0.01 * across + (1.0 - other.mesh.p.T) * axis)
    both = merged([first, other])
    np.testing.assert_array_equal(both.body, np.repeat([0, 1], 7))
    np.testing.assert_allclose(both.mesh.p[0, :8], first.mesh.p[0], rtol=1e-14)
    np.testing.assert_allclose(both.mesh.p[0, 8:], 1.0 - other.mesh.p[0, ::-1], rtol=1e-14)
    np.testing.assert_allclose(both.mesh.p[0], both.coordinates @ axis, rtol=1e-14)
    for body in (0, 1):
        ends = both.mesh.p[0, both.mesh.t[:, both.body == body]]
        assert np.all(np.diff(ends, axis=0) > 0.0)
        assert np.all(np.diff(ends[0]) > 0.0)
    assert {name: both.mesh.p[0, at] for name, at in both.points.items()} == pytest.approx(
        {"wall": 0.0, "end": 0.7, "tip": 1.0, "foot": 0.5}, abs=1e-15
    )
    assert region_sizes(both) == pytest.approx({"a": 0.5, "b": 0.2, "c": 0.2, "d": 0.3})
    third = build_bar([("e", 0.2, 4)], {"far": 0.2}, origin=(2.0, 0.0, 0.0))
    three = merged([both, replace(third, coordinates=2.0 * axis + third.mesh.p.T * axis)])
    assert three.mesh.p[0, three.points["far"]] == pytest.approx(2.2)
    with pytest.raises(InputError, match=r"bars must be parallel: .* along \(0\.6, 0\.8, 0\)"):
        merged([first, third])


MIXED = {"quadrilateral and triangle": mixed_plate, "hexahedron and prism": mixed_box}


@pytest.mark.parametrize(
    ("kind", "order"), [*KINDS, *((mix, order) for mix in MIXED for order in (1, 2))]
)
def test_refined_mesh_has_every_element_split_and_the_same_names(kind, order):
    if kind in MIXED:
        mesh = shaken(MIXED[kind](order=order), inside=True)
    else:
        mesh = merged([strip(kind, order), renamed(strip(kind, order), "lower ")])
    if mesh.dim > 1 and kind not in MIXED:
        inner = np.flatnonzero(mesh.mesh.f2t[1] >= 0)[::5]
        plain = mesh.mesh.with_boundaries({"cut": inner})
        mesh = named(plain, points=mesh.points, order=order)
    fine, parts = refined(mesh), 2**mesh.dim
    assert fine.order == order
    np.testing.assert_array_equal(fine.body, np.repeat(mesh.body, parts))
    np.testing.assert_allclose(
        sizes(fine).reshape(-1, parts).sum(axis=1), np.abs(sizes(mesh)), rtol=1e-12
    )
    assert np.all(sizes(fine) > 0.0)
    # Parts fit: what is inside has a part of another element on its other side.
    ends = (each.mesh.facets[:, each.mesh.boundary_facets()] for each in (fine, mesh))
    after, before = (np.count_nonzero(corner_count(facets) >= mesh.dim) for facets in ends)
    assert after == before * parts // 2
    for name, at in mesh.points.items():
        np.testing.assert_array_equal(fine.coordinates[fine.points[name]], mesh.coordinates[at])
    for name, elements in mesh.regions.items():
        np.testing.assert_array_equal(np.unique(fine.regions[name] // parts), elements)
    assert boundary_sizes(fine) == pytest.approx(boundary_sizes(mesh), rel=1e-12)
    for name, facets in mesh.boundaries.items():
        assert fine.boundaries[name].size == facets.size * parts // 2
        # Parts have the place of what they are of.
        corners = (x.mesh.p[:, x.mesh.facets[:, x.boundaries[name]]] for x in (fine, mesh))
        np.testing.assert_allclose(*(x.mean(axis=(1, 2)) for x in corners), atol=1e-12)
    named(fine.mesh, points=fine.points, order=order)  # it passes all checks
    if mesh.dim > 1:
        np.testing.assert_array_equal(fine.mesh.p[:, : mesh.mesh.p.shape[1]], mesh.mesh.p)
