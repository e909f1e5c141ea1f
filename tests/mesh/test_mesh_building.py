"""Bars, plates and boxes have the sizes, numbers and names that they were asked for."""

import numpy as np
import pytest
import skfem
from mesh_files import FLAT_AND_SOLID, KINDS, SIZES, boundary_sizes, region_sizes, sizes, strip
from skfem.helpers import dot

import skfem_joint as sj

PER_CELL = {"triangle": 2, "tetrahedron": 6, "prism": 2}
SIDES = {"left": 0.05, "right": 0.05, "bottom": 0.6, "top": 0.6}
PLACES = {"left": -0.1, "right": 0.7, "bottom": 0.2, "top": -0.15, "front": -0.3, "back": 0.32}
FACES = {name: 0.02 * size for name, size in SIDES.items()} | {"front": 0.03, "back": 0.03}


@pytest.mark.parametrize(("kind", "order"), KINDS)
def test_built_mesh_has_its_sizes_names_and_places(kind, order):
    mesh = strip(kind, order)
    cells = 8 * (1, 4, 8)[mesh.dim - 1]
    assert (mesh.kind, mesh.order, mesh.path, mesh.notes) == (kind, order, "", ())
    assert mesh.n_elements == cells * PER_CELL.get(kind, 1)
    assert mesh.size == pytest.approx(0.6)
    assert np.all(sizes(mesh) > 0.0)
    whole = SIZES[mesh.dim]
    expected = {"linear": whole * 5 / 6, "joint": whole / 6}
    assert region_sizes(mesh) == pytest.approx(expected, rel=1e-13)
    expected = ({}, SIDES, FACES)[mesh.dim - 1]
    assert boundary_sizes(mesh) == pytest.approx(expected, rel=1e-13)
    for name, size in expected.items():  # outward flux of the position, by scikit-fem
        basis = skfem.FacetBasis(mesh.mesh, mesh.mesh.elem(), facets=name)
        flux = skfem.Functional(lambda w: dot(w.n, w.x)).assemble(basis)
        assert flux == pytest.approx(PLACES[name] * size, rel=1e-12)
    places = {name: mesh.coordinates[at].tolist() for name, at in mesh.points.items()}
    tip, foot = [0.7, -0.15, 0.32], [0.1, -0.2, 0.3]
    for unused in range(mesh.dim, 3):
        tip[unused], foot[unused] = (-0.2, -0.2) if unused == 1 else (0.0, 0.0)
    assert places == {"tip": pytest.approx(tip), "foot": pytest.approx(foot)}
    assert not mesh.body.any()


@pytest.mark.parametrize(("kind", "order"), FLAT_AND_SOLID)
def test_boundaries_may_be_chosen_and_limited_to_a_strip(kind, order):
    chosen = {"end": "left", "contact": ("bottom", "joint"), "tip end": ("right", "joint")}
    mesh = strip(kind, order, boundaries=chosen)
    depth = {2: 1.0, 3: 0.02}[mesh.dim]
    expected = {"end": 0.05 * depth, "contact": 0.1 * depth, "tip end": 0.05 * depth}
    assert boundary_sizes(mesh) == pytest.approx(expected)
    x, y = mesh.mesh.p[:2, mesh.mesh.facets[:, mesh.boundaries["contact"]]]
    assert (x.min(), x.max()) == pytest.approx((0.6, 0.7))
    np.testing.assert_array_equal(y, -0.2)
    assert all(name.startswith("upper_") for name in strip(kind, prefix="upper_").boundaries)


def test_bars_and_plates_are_numbered_along_themselves():
    """Nodes of bars ascend; those of plates and boxes run up column by column."""
    bar = sj.build_bar([("a", 0.1, 4), ("b", 0.5, 3), ("a", 0.2, 2)], {"p": 0.05, "end": 0.8})
    assert np.all(np.diff(bar.mesh.p[0]) > 0.0)
    np.testing.assert_array_equal(bar.mesh.t, [np.arange(9), np.arange(1, 10)])
    np.testing.assert_array_equal(bar.regions["a"], [0, 1, 2, 3, 7, 8])
    assert bar.points == {"p": 2, "end": 9}
    for mesh in (strip("triangle"), strip("hexahedron")):
        np.testing.assert_array_equal(
            np.lexsort(mesh.mesh.p[::-1].round(9)), np.arange(mesh.mesh.p.shape[1])
        )
        assert np.all(np.diff(mesh.mesh.p[0, mesh.mesh.t].min(axis=0)) > -1e-12)
    mesh = sj.build_plate([("joint", 1.0, 2)], 1.0, 2, kind="triangle").mesh
    np.testing.assert_array_equal(mesh.t[:, :4].T, [[0, 3, 4], [0, 4, 1], [1, 4, 2], [4, 5, 2]])


def test_build_bar_names_every_mistake_at_once():
    with pytest.raises(sj.InputError) as caught:
        sj.build_bar([("joint", -1.0, 10), ("", 1.0, 0), ("far", float("inf"), 3)], {"joint": 0.0})
    text = str(caught.value)
    assert len(caught.value.problems) == 5
    for mistake in ("'joint' is -1.0", "name ''", "0 elements", "'far' is inf", "both a region"):
        assert mistake in text
    with pytest.raises(
        sj.InputError, match=r"'p' at \(0\.06\) m .* nearest node is at \(0\.05\) m"
    ):
        sj.build_bar([("joint", 0.1, 2)], {"p": 0.06})
    with pytest.raises(sj.InputError, match=r"'p' at \(nan\) m"):
        sj.build_bar([("joint", 0.1, 2)], {"p": float("nan")})
    with pytest.raises(sj.InputError, match="at least one strip"):
        sj.build_bar([], {})


def test_build_plate_and_box_name_every_mistake_at_once():
    with pytest.raises(sj.InputError) as caught:
        sj.build_plate(
            [("joint", -1.0, 10), ("", 1.0, 0)],
            *(float("nan"), True),
            origin=(0.0, float("inf")),
            kind="hexagon",
            order=3,
            boundaries={"joint": "left", "b": "above", "c": ("top", "bolt")},
        )
    text = str(caught.value)
    assert len(caught.value.problems) == 11
    for mistake in (
        *("'joint' is -1.0", "name ''", "has 0 elements", "width is nan", "width has True"),
        *("both a region and a boundary", "origin is", "'hexagon': allowed are triangle, quad"),
        *("order of the elements is 3", "'b' is 'above'", "'c' is 'bolt': allowed are joint"),
    ):
        assert mistake in text
    with pytest.raises(sj.InputError, match=r"'p' at \(0\.3, 0\) m .* node is at \(0\.2, 0\) m"):
        sj.build_plate([("joint", 0.4, 2)], 0.1, 1, points={"p": (0.3, 0)})
    with pytest.raises(sj.InputError, match="strip 'b' does not reach side 'left'"):
        sj.build_plate([("a", 1.0, 1), ("b", 1.0, 1)], 1.0, 1, boundaries={"end": ("left", "b")})
    with pytest.raises(sj.InputError, match=r"'p' at \(0, 0\): give 3 coordinates"):
        sj.build_box([("a", 1.0, 1)], (1.0, 1.0), (1, 1), points={"p": (0, 0)})
    with pytest.raises(sj.InputError, match=r"depth is 0\.0(.|\n)*'triangle': allowed are tetra"):
        sj.build_box([("a", 1.0, 1)], (1.0, 0.0), (1, 1), kind="triangle")
    with pytest.raises(sj.InputError, match="has two corners in one place"):
        sj.build_plate([("a", 1.0, 1)], 1e-11, 1)
