"""Pressure, bolts and interpolation against closed forms."""

from dataclasses import replace

import numpy as np
import pytest
from bodies import MU, WIDTH, block, distorted, pressed, structure
from mixed_meshes import mixed_box
from scipy.integrate import quad
from skfem import MeshTri

import skfem_joint as sj
from skfem_joint.body.nodes import Nodes, interpolation, local_coordinates
from skfem_joint.joint.pressure import pressure_integrals

LENGTH = 0.1
AXIAL = sj.PressureTable((0.0, 0.013, 0.04, 0.041, 0.09, 0.2), (0.0, 0.0, 6e6, 1e6, 2e6, 2e6))
TWO_BOLTS = sj.Bolts(
    (sj.Bolt((0.03, 0.026), 20e3, 0.008, 0.004), sj.Bolt((0.07, 0.02), 5e3, 0.006)), reach=0.01
)


def square(size: float, n: int, seed: int | None = None) -> np.ndarray:
    """Triangles (t, 3, 2) that cover a square around the origin."""
    line = np.linspace(-size / 2, size / 2, n + 1)
    mesh = MeshTri.init_tensor(line, line)
    p = mesh.p.copy()
    if seed is not None:
        inner = mesh.interior_nodes()
        shift = np.random.default_rng(seed).uniform(-0.2, 0.2, (2, inner.size))
        p[:, inner] += shift * size / n
    return np.moveaxis(p[:, mesh.t], 0, -1).swapaxes(0, 1)


def test_pressure_with_kinks_is_integrated_exactly_in_every_dimension():
    kinks = (-0.33, 0.0, 0.1, 0.21)
    pressure = sj.PressureTable(kinks, (1.0, 5.0, 0.0, 2.0), (3.0, 0.0))

    def profile(x):
        return float(pressure(np.array([x, 0.0])))

    exact = quad(profile, -0.5, 0.5, points=kinks)[0]
    moment = quad(lambda x: x * profile(x), -0.5, 0.5, points=kinks)[0]
    x = np.array([-0.5, -0.1, 0.02, 0.5])
    line = np.stack([x[:-1], x[1:]], axis=1)[..., None]
    tilted = square(1.0, 3, seed=3) @ np.array([[1.0, 0.0, 0.0], [0.0, 0.6, 0.8]])
    for corners, axis in (
        (line, (1.0,)),
        (line * [1.0, 0.0], (1.0, 0.0)),
        (square(1.0, 1), (1.0, 0.0)),
        (square(1.0, 6, seed=3), (1.0, 0.0)),
        (tilted, (1.0, 0.0, 0.0)),
    ):
        table = sj.PressureTable(kinks, (1.0, 5.0, 0.0, 2.0), axis)
        integrals = pressure_integrals(corners, table)
        assert integrals.sum() == pytest.approx(exact, rel=1e-12)
        # Hat functions reproduce x: the forces have the pressure's centre.
        assert np.sum(integrals * corners[..., 0]) == pytest.approx(moment, rel=1e-12)


@pytest.mark.parametrize("elements", [1, 10, 100])
@pytest.mark.parametrize("kind", ["equal", "consistent"])
def test_equal_forces_share_all_and_consistent_ones_by_length(elements, kind):
    body = sj.build_bar([("joint", 0.25, elements)], {"fixed": 0.0, "free_end": 0.25})
    w = structure(body, [pressed(normal_force=kind)], ["fixed"]).system().contact.w
    share = MU * 8e6 * WIDTH * 0.25 / elements
    last = share if kind == "equal" else share / 2
    np.testing.assert_allclose(w, [*[share] * (elements - 1), last], rtol=1e-12)


@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("kind", ["triangle", "quadrilateral"])
@pytest.mark.parametrize(
    ("pressure", "total"),
    [
        (8e6, 8e6 * LENGTH * WIDTH),
        (AXIAL, WIDTH * (0.027 * 3e6 + 0.001 * 3.5e6 + 0.049 * 1.5e6 + 0.01 * 2e6)),
        (TWO_BOLTS, 25e3),
    ],
    ids=["constant", "table", "bolts"],
)
def test_total_normal_force_is_exact_on_every_mesh(kind, order, pressure, total):
    for n in (2, 5):
        strips = [("joint", LENGTH, 2 * n), ("rest", 0.04, 2)]
        body = distorted(sj.build_plate(strips, WIDTH, n, kind=kind, order=order))
        for fixed, forces in (((), "consistent"), (("left",), "consistent"), (("left",), "equal")):
            joint = pressed(pressure=pressure, normal_force=forces)
            (patch,) = structure(body, [joint], fixed).patches
            assert patch.clamping_force == pytest.approx(total, rel=1e-12)
            assert patch.normal_force.min() > 0.0
            if forces == "equal":
                assert patch.held_force == 0.0
                continue
            if pressure == 8e6:
                np.testing.assert_allclose(patch.normal_force, 8e6 * patch.area, rtol=1e-12)


def test_bolts_press_bars_faces_and_plates_with_their_force_and_moment():
    bar = sj.build_bar([("joint", LENGTH, 7)], {"fixed": 0.0})
    on_bar = sj.Bolts(
        (sj.Bolt((0.03, 0.005), 20e3, 0.008, 0.004), sj.Bolt((0.07, 0.0), 5e3, 0.006)), 0.01
    )
    plate = distorted(sj.build_plate([("joint", LENGTH, 7)], WIDTH, 4, order=2))
    solids = [distorted(block(shape, 1, 4, (LENGTH, WIDTH, 0.02))) for shape in ("tet", "hex")]
    on_face = sj.Bolts(tuple(sj.Bolt((*b.at, 0.5), b.force, b.head_radius, b.hole_radius)
                          for b in TWO_BOLTS.bolts), 0.01)  # fmt: skip
    faces = [(solid, "base", on_face) for solid in solids]
    faces.append((mixed_box(2, size=(LENGTH, WIDTH, 0.02)), "front", on_face))
    for body, on, bolts in ((bar, "joint", on_bar), (plate, "joint", TWO_BOLTS), *faces):
        fixed = ("fixed",) if body is bar else ("left",)
        some = structure(body, [pressed(on, pressure=bolts)], fixed)
        (patch,) = some.patches
        d = min(some.dim, 2)
        exact = sum(bolt.force * np.array(bolt.at[:d]) for bolt in bolts.bolts)
        found = patch.normal_force @ some.nodes[patch.nodes][:, :d]
        np.testing.assert_allclose(found, exact, rtol=1e-9)
        np.testing.assert_allclose(patch.bolt_shares, 1.0, rtol=1e-10)
        assert patch.clamping_force == pytest.approx(25e3, rel=1e-12)


def test_a_bolt_beside_the_edge_gives_its_whole_force_to_what_it_presses():
    plate = sj.build_plate([("joint", LENGTH, 7)], WIDTH, 4)
    # Half of a ring: just what is still allowed.
    inside = sj.Bolts((sj.Bolt((LENGTH - 1e-9, 0.025), 1e3, 0.01, 0.005),))
    patch = structure(plate, [pressed(pressure=inside)]).patches[0]
    assert patch.clamping_force == pytest.approx(1e3, rel=1e-12)
    assert patch.bolt_shares[0] == pytest.approx(0.5, abs=1e-6)
    outside = sj.Bolts((sj.Bolt((LENGTH + 0.001, 0.02), 1e3, 0.01), sj.Bolt((1, 1), 1, 0.01)))
    with pytest.raises(sj.InputError) as caught:
        structure(plate, [pressed(pressure=outside)])
    text = str(caught.value)
    assert "bolt at (0.101, 0.02)" in text
    assert "43.6 % lies on the contact" in text
    assert " 0 % lies on the contact" in text


@pytest.mark.parametrize("on", ["joint", "bottom"])
def test_only_nodes_that_the_pressure_reaches_are_in_contact(on):
    # The pressure ends at a line of nodes, to round-off.
    plate = sj.build_plate([("joint", LENGTH, 30)], WIDTH, 2, kind="triangle", order=2)
    for cell in (7, 11, 19):
        end = cell * LENGTH / 30 * (1 - 1e-15)
        table = sj.PressureTable((0.0, end, end + 0.01, 0.2), (0.0, 0.0, 1e6, 1e6))
        some = structure(plate, [pressed(on, pressure=table)])
        assert some.nodes[some.patches[0].nodes, 0].min() > end - 1e-9


def test_the_cone_under_the_head_widens_with_depth():
    bolt = sj.Bolt((0.0, 0.0), 1.0, 0.008, spreading_angle=45.0)
    assert sj.Bolts((bolt,), reach=0.01).outer_radius(bolt) == pytest.approx(0.018, rel=1e-15)


BOLT = sj.Bolt((0.0, 0.0), 1.0, 0.004, 0.002)
TABLE = sj.PressureTable((0.0, 1.0), (1.0, 1.0))


@pytest.mark.parametrize(
    ("given", "change", "message"),
    [
        (BOLT, {"at": (np.nan, 0.0)}, "bolt.at"),
        (BOLT, {"head_radius": 0.001}, "head_radius: found 0.001, must be > hole_radius, 0.002"),
        (BOLT, {"spreading_angle": 90.0}, r"spreading_angle: found 90.0, must be in \[0, 90\)"),
        (sj.Bolts((BOLT,)), {"bolts": ()}, "found none"),
        (TABLE, {"axis": (0.0, 0.0)}, "axis"),
        (TABLE, {"positions": (1.0, 0.0)}, r"positions\[1\]: found 0, must be > 1, the one before"),
        (TABLE, {"positions": (0.0,), "values": (1.0,)}, "at least 2"),
        (TABLE, {"values": (1.0,)}, "two columns of one length"),
    ],
)
def test_bolts_and_tables_that_make_no_sense_are_refused(given, change, message):
    with pytest.raises(sj.InputError, match=message):
        replace(given, **change)


@pytest.mark.parametrize("shape", ["line", "tri", "quad", "tet", "hex"])
def test_points_are_found_where_scikit_fem_maps_them(shape):
    grid = Nodes(distorted(block(shape, 1, 3), 0.3))
    mesh, d = grid.mesh.mesh, grid.dim
    on, elements = "joint", grid.mesh.regions["joint"]
    local = np.random.default_rng(2).uniform(0.05, 0.3, (d, elements.size))
    if d == 3:  # solids are pressed by faces: the face z = 0 is that of zeta = 0 or another one
        on = "base"
        elements = mesh.f2t[0, grid.mesh.boundaries["base"]]
        middle = mesh.p[:, mesh.facets[:, grid.mesh.boundaries["base"]]].mean(axis=1).T
        local = local_coordinates(grid, elements, middle).T
    x = mesh.mapping().F(local[:, :, None], elements)[:, :, 0].T
    np.testing.assert_allclose(local_coordinates(grid, elements, x), local.T, atol=1e-11)
    values, gap = interpolation(grid, on, x)
    np.testing.assert_array_equal(gap, 0.0)
    expected = np.zeros((len(x), grid.n_nodes))
    for i, nodes in enumerate(grid.of_element):
        expected[np.arange(len(x)), nodes[elements]] = grid.element.lbasis(local, i)[0]
    np.testing.assert_allclose(values.toarray(), expected, atol=1e-11)
    # Every vertex lies in an element, whatever the round-off.
    vertices = grid.nodes_of(on)
    values, gap = interpolation(grid, on, grid.nodes[vertices] * (1 + 1e-16))
    np.testing.assert_array_equal(gap, 0.0)
    np.testing.assert_array_equal(values.toarray(), np.eye(grid.n_nodes)[vertices])


@pytest.mark.parametrize(("shape", "on"), [("tri", "rest"), ("quad", "rest"), ("quad", "right"),
                                           ("tet", "right"), ("hex", "right")])  # fmt: skip
def test_points_outside_know_their_distance(shape, on):
    grid = Nodes(block(shape, 1, 4))
    beside = [0.4] * (grid.dim - 1)
    points = np.array([[1.003, *beside], [3.0, *beside], [1.1, *beside]])
    values, gap = interpolation(grid, on, points)
    assert gap[0] == 0.0  # in contact, by extrapolation
    np.testing.assert_allclose(values[[0]] @ grid.nodes, points[:1], rtol=1e-12)
    assert gap[1:] == pytest.approx([2.0, 0.1], rel=0.01)
    assert values[[1, 2]].nnz == 0
    if shape in ("quad", "hex"):
        # An element has no reference coordinates for a point beyond its horizon.
        far = np.full((1, grid.dim), 40.0)
        assert np.isnan(local_coordinates(grid, np.array([0]), far)).all()
