"""Pressure, bolts and interpolation of plates against closed forms."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from plates import ELEMENTS, distorted, plate_structure, pressed
from scipy.integrate import quad
from skfem import MeshQuad, MeshTri

from skfem_joint.bolts import Bolt, Bolts, disc_moments, ring_integrals
from skfem_joint.errors import InputError
from skfem_joint.plate_contact import (
    AxialPressure,
    edge_tangents,
    local_coordinates,
    locate,
    locate_on_edges,
    pressure_integrals,
)
from skfem_joint.plate_mesh import build_plate

LENGTH, WIDTH = 0.1, 0.05
AXIAL = AxialPressure((0.013, 0.04, 0.041, 0.09), (0.0, 6e6, 1e6, 2e6))
TWO_BOLTS = Bolts(
    (Bolt((0.03, 0.026), 20e3, 0.008, 0.004), Bolt((0.07, 0.02), 5e3, 0.006)), reach=0.01
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


@pytest.mark.parametrize("n", [1, 2, 7])
def test_disc_inside_triangles_has_its_area_and_no_moment_about_its_centre(n: int) -> None:
    centre, radius = np.array([0.11, -0.07]), 0.3
    total = disc_moments(square(1.0, n, seed=n), centre, radius).sum(axis=0)
    np.testing.assert_allclose(total, [np.pi * radius**2, 0.0, 0.0], rtol=1e-13, atol=1e-15)


def test_disc_cut_by_an_edge_is_a_circular_segment() -> None:
    half = np.array([[[0.2, -9.0], [0.2, 9.0], [-9.0, 0.0]]])
    for triangle in (half, half[:, ::-1]):  # the sense of rotation does not matter
        angle = np.arccos(0.2)
        area = np.pi - (angle - 0.2 * np.sin(angle))
        moment = -2.0 / 3.0 * np.sin(angle) ** 3
        np.testing.assert_allclose(
            disc_moments(triangle, np.zeros(2), 1.0), [[area, moment, 0.0]], rtol=1e-13, atol=1e-15
        )


def test_disc_that_holds_a_triangle_gives_the_triangle() -> None:
    triangle = np.array([[[0.1, 0.2], [0.5, 0.1], [0.3, 0.6]]])
    centroid = triangle.mean(axis=1)
    np.testing.assert_allclose(
        disc_moments(triangle, np.zeros(2), 1.0), 0.09 * np.array([[1.0, *centroid[0]]]), rtol=1e-13
    )


@pytest.mark.parametrize("n", [2, 5, 23])
def test_a_ring_gives_every_mesh_its_area_and_its_centre(n: int) -> None:
    triangles = square(1.0, n, seed=n)
    centre = np.array([0.05, 0.08])
    # The ring is narrower than any element.
    ring = ring_integrals(triangles, centre, 0.30, 0.301)
    area = np.pi * (0.301**2 - 0.30**2)
    assert ring.min() >= 0.0
    assert ring.sum() == pytest.approx(area, rel=1e-10)
    np.testing.assert_allclose(np.einsum("nk,nkc->c", ring, triangles) / area, centre, rtol=1e-9)


def test_pressure_with_kinks_is_integrated_exactly_over_triangles_and_segments() -> None:
    pressure = AxialPressure((-0.33, 0.0, 0.1, 0.21), (1.0, 5.0, 0.0, 2.0), (3.0, 0.0))

    def profile(x: float) -> float:
        return float(pressure(np.array([x, 0.0])))

    kinks = (-0.33, 0.0, 0.1, 0.21)
    exact = quad(profile, -0.5, 0.5, points=kinks)[0]
    moment = quad(lambda x: x * profile(x), -0.5, 0.5, points=kinks)[0]
    for n in (1, 6):
        triangles = square(1.0, n, seed=3)
        integrals = pressure_integrals(triangles, pressure)
        assert integrals.sum() == pytest.approx(exact, rel=1e-12)
        # Hat functions reproduce x: the forces have the pressure's centre.
        assert np.sum(integrals * triangles[..., 0]) == pytest.approx(moment, rel=1e-12)
    x = np.array([-0.5, -0.1, 0.02, 0.5])
    segments = np.stack([np.stack([x, 0 * x], 1)[:-1], np.stack([x, 0 * x], 1)[1:]], axis=1)
    integrals = pressure_integrals(segments, pressure)
    assert integrals.sum() == pytest.approx(exact, rel=1e-12)
    assert np.sum(integrals * segments[..., 0]) == pytest.approx(moment, rel=1e-12)


@pytest.mark.parametrize("turn", [0.0, 37.0])
def test_axial_pressure_turns_with_its_axis(turn: float) -> None:
    c, s = np.cos(np.radians(turn)), np.sin(np.radians(turn))
    triangles = square(1.0, 4, seed=2)
    along = AxialPressure((-0.2, 0.3), (1.0, 4.0))
    across = AxialPressure((-0.2, 0.3), (1.0, 4.0), (2 * c, 2 * s))
    np.testing.assert_allclose(
        pressure_integrals(triangles @ np.array([[c, s], [-s, c]]), across),
        pressure_integrals(triangles, along),
        rtol=1e-12,
    )


@pytest.mark.parametrize(("kind", "order"), ELEMENTS)
@pytest.mark.parametrize(
    ("pressure", "total"),
    [
        (8e6, 8e6 * LENGTH * WIDTH),
        (AXIAL, WIDTH * (0.027 * 3e6 + 0.001 * 3.5e6 + 0.049 * 1.5e6 + 0.01 * 2e6)),
        (TWO_BOLTS, 25e3),
    ],
    ids=["constant", "axial", "bolts"],
)
def test_total_normal_force_is_exact_on_every_mesh(
    kind: Any, order: int, pressure: Any, total: float
) -> None:
    for n in (2, 5):
        plate = build_plate(
            [("joint", LENGTH, 2 * n), ("rest", 0.04, 2)], WIDTH, n, kind=kind, order=order
        )
        structure = plate_structure(distorted(plate), [pressed(pressure=pressure)], [])
        (patch,) = structure.patches
        assert patch.clamping_force == pytest.approx(total, rel=1e-12)
        assert patch.normal_force.min() > 0.0
        assert patch.held_force == 0.0
        held = plate_structure(distorted(plate), [pressed(pressure=pressure)]).patches[0]
        assert held.clamping_force == pytest.approx(total, rel=1e-12)
        if pressure == 8e6:
            np.testing.assert_allclose(patch.area.sum(), LENGTH * WIDTH, rtol=1e-12)
            np.testing.assert_allclose(patch.normal_force, 8e6 * patch.area, rtol=1e-12)
            assert 0.0 < held.held_force == pytest.approx(8e6 * held.held_area, rel=1e-12)


def test_nodal_forces_of_bolts_have_the_moment_of_the_bolts() -> None:
    plate = distorted(build_plate([("joint", LENGTH, 7)], WIDTH, 4, order=2))
    structure = plate_structure(plate, [pressed(pressure=TWO_BOLTS)])
    (patch,) = structure.patches
    exact = sum(bolt.force * np.array(bolt.at) for bolt in TWO_BOLTS.bolts)
    np.testing.assert_allclose(patch.normal_force @ structure.nodes[patch.nodes], exact, rtol=1e-10)
    np.testing.assert_allclose(patch.bolt_shares, 1.0, rtol=1e-10)


def test_a_bolt_beside_the_edge_gives_its_whole_force_to_what_it_presses() -> None:
    plate = build_plate([("joint", LENGTH, 7)], WIDTH, 4)
    # Half of a ring: just what is still allowed.
    inside = Bolts((Bolt((LENGTH - 1e-9, 0.025), 1e3, 0.01, 0.005),))
    patch = plate_structure(plate, [pressed(pressure=inside)]).patches[0]
    assert patch.clamping_force == pytest.approx(1e3, rel=1e-12)
    assert patch.bolt_shares[0] == pytest.approx(0.5, abs=1e-6)
    outside = Bolts((Bolt((LENGTH + 0.001, 0.02), 1e3, 0.01), Bolt((1, 1), 1, 0.01)))
    with pytest.raises(InputError) as caught:
        plate_structure(plate, [pressed(pressure=outside)])
    text = str(caught.value)
    assert "bolt at (0.101, 0.02)" in text
    assert "43.6 % lies on the contact" in text
    assert "bolt at (1, 1)" in text
    assert " 0 % lies on the contact" in text


@pytest.mark.parametrize("kind", ["region", "boundary"])
def test_only_nodes_that_the_pressure_reaches_are_in_contact(kind: Any) -> None:
    # The pressure ends at a line of nodes, to round-off.
    plate = build_plate([("joint", LENGTH, 30)], WIDTH, 2, kind="triangle", order=2)
    for cell in (7, 11, 19):
        end = cell * LENGTH / 30 * (1 - 1e-15)
        table = AxialPressure((end, end + 0.01), (0.0, 1e6))
        name = "joint" if kind == "region" else "bottom"
        joint = pressed(name, kind=kind, pressure=table)
        structure = plate_structure(plate, [joint], [("left", "xy")])
        x = structure.nodes[structure.patches[0].nodes, 0]
        assert x.min() > end - 1e-9


def test_the_cone_under_the_head_widens_with_depth() -> None:
    bolt = Bolt((0.0, 0.0), 1.0, 0.008, spreading_angle=45.0)
    assert Bolts((bolt,), reach=0.01).outer_radius(bolt) == pytest.approx(0.018, rel=1e-15)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"at": (np.nan, 0.0)}, "bolt.at"),
        ({"force": -1.0}, "force: found -1.0, must be >= 0"),
        ({"head_radius": 0.001}, "head_radius: found 0.001, must be > hole_radius, 0.002"),
        ({"hole_radius": -0.002}, "hole_radius"),
        (
            {"spreading_angle": 90.0},
            r"spreading_angle: found 90.0, must be in \[0, 90\), in degrees",
        ),
    ],
)
def test_bolts_that_make_no_sense_are_refused(change: dict[str, Any], message: str) -> None:
    values = {"at": (0.0, 0.0), "force": 1.0, "head_radius": 0.004, "hole_radius": 0.002} | change
    with pytest.raises(InputError, match=message):
        Bolt(**values)


def test_groups_of_bolts_and_axes_that_make_no_sense_are_refused() -> None:
    with pytest.raises(InputError, match="found none"):
        Bolts(())
    with pytest.raises(InputError, match="reach"):
        Bolts((Bolt((0, 0), 1.0, 1.0),), reach=-1.0)
    with pytest.raises(InputError, match="axis"):
        AxialPressure((0.0, 1.0), (1.0, 1.0), (0.0, 0.0))
    with pytest.raises(InputError, match="increasing"):
        AxialPressure((1.0, 0.0), (1.0, 1.0))


def quads(seed: int) -> Any:
    mesh = MeshQuad.init_tensor(np.linspace(0, 1, 6), np.linspace(0, 2, 7))
    p = mesh.p.copy()
    inner = mesh.interior_nodes()
    p[:, inner] += np.random.default_rng(seed).uniform(-0.04, 0.04, (2, inner.size))
    return MeshQuad(p, mesh.t)


@pytest.mark.parametrize("mesh", [quads(1), MeshTri().refined(3)], ids=["quads", "triangles"])
def test_points_are_found_where_scikit_fem_maps_them(mesh: Any) -> None:
    elements = np.arange(mesh.t.shape[1])
    local = np.random.default_rng(2).uniform(0.05, 0.45, (2, elements.size))
    x = mesh.mapping().F(local[:, :, None], elements)[:, :, 0].T
    found = locate(mesh, elements, x)
    np.testing.assert_array_equal(found.element, elements)
    np.testing.assert_allclose(found.local, local.T, atol=1e-12)
    np.testing.assert_allclose(found.distance, 0.0, atol=1e-15)
    # Every vertex lies in an element, whatever the round-off.
    at_vertices = locate(mesh, elements, mesh.p.T * (1 + 1e-16))
    assert at_vertices.element.min() >= 0
    np.testing.assert_allclose(at_vertices.distance, 0.0, atol=1e-14)


def test_points_outside_know_their_distance() -> None:
    mesh = quads(1)
    some = np.arange(mesh.t.shape[1])
    points = np.array([[1.003, 1.0], [3.0, 1.0], [0.5, -0.001]])
    found = locate(mesh, some, points)
    np.testing.assert_array_equal(found.element >= 0, [True, False, True])
    np.testing.assert_allclose(found.distance, [0.003, 2.0, 0.001], rtol=1e-3)
    edge = locate_on_edges(mesh, mesh.facets_satisfying(lambda x: x[0] > 1 - 1e-9), points[:2])
    np.testing.assert_allclose(edge.distance, [0.003, 2.0], rtol=1e-9)
    # A quadrilateral has no reference coordinates for a point beyond its horizon.
    far = np.array([[[0.0, 0.0], [1.0, 0.0], [0.6, 0.5], [0.4, 0.5]]])
    assert np.isnan(local_coordinates(far, np.array([[0.5, 40.0]]))).all()


def arc(angles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    nodes = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    first = np.arange(len(angles) - 1)
    return nodes, np.stack([first, first + 1], axis=1)


def test_tangents_of_an_arc_are_those_of_the_circle_inside_it() -> None:
    angles = np.linspace(0.3, 2.0, 9)
    nodes, edges = arc(angles)
    tangents = edge_tangents(nodes, edges, 30.0, "joint 'arc'")
    exact = np.stack([np.sin(angles), -np.cos(angles)], axis=1)  # along +x
    np.testing.assert_allclose(tangents[1:-1], exact[1:-1], atol=1e-14)
    np.testing.assert_allclose(np.linalg.norm(tangents, axis=1), 1.0, rtol=1e-14)
    np.testing.assert_allclose(edge_tangents(nodes, edges[:, ::-1], 30.0, ""), tangents)


def test_a_boundary_that_turns_sharply_has_no_tangent() -> None:
    nodes, edges = arc(np.array([0.0, np.pi / 2, 2.0]))
    with pytest.raises(InputError, match=r"turns by 57.3 degrees at .*at most 30"):
        edge_tangents(nodes, edges, 30.0, "joint 'arc'")
    star = np.array([[0, 1], [0, 2], [0, 3]])
    with pytest.raises(InputError, match="more than two of its edges meet"):
        edge_tangents(np.eye(4)[:, :2], star, 30.0, "joint 'star'")
