"""Pressures of faces: what contact forces give nodes, and that they do not swing."""

from __future__ import annotations

import numpy as np
import pytest
from benchmarks.washer import largest_rise, washer
from bodies import NU, PLANE, SOLID, THICKNESS, E, block
from test_preload import BOLT, FORCE, JOINT, at, clamped, cylinder, stacked

from skfem_joint.joint.clamps import Clamp
from skfem_joint.joint.pressure_space import PressureSpace, pressure_space
from skfem_joint.mesh import merged, named
from skfem_joint.structure.structure import Structure

SECOND = [kind for kind in [*PLANE, *SOLID] if kind[1] == 2]


def space_of(structure: Structure) -> PressureSpace:
    found = pressure_space(structure.body, structure.joints[0])
    assert found is not None
    return found


def overhanging(shape: str, order: int) -> Structure:
    """The upper of two blocks is shifted sideways by a part of an element: it hangs over."""
    upper, lower = block(shape, order, 2), block(shape, order, 3)
    origin = [0.0] * upper.mesh.dim()
    mesh = merged([at(upper, "u_", 0.4, *origin[2:], 1.0), at(lower, "l_", *origin)])
    return clamped(mesh, bolts=[BOLT], joints=[JOINT])


def clamped_blocks(shape: str, order: int) -> Structure:
    return clamped(stacked(shape, order))


@pytest.mark.parametrize("make", [clamped_blocks, overhanging])
@pytest.mark.parametrize(("shape", "order"), [*PLANE, *SOLID])
def test_means_of_forces_over_corners_lose_nothing(make, shape, order):
    structure = make(shape, order)
    space, dim = space_of(structure), structure.dim
    G = space.means(np.zeros(space.area.size))
    assert G.min() >= 0.0
    assert G.sum(axis=0) == pytest.approx(1.0, rel=1e-14)
    # An even pressure is even at nodes; rigid motion apart closes every gap by as much.
    assert G @ space.area == pytest.approx(space.area, rel=1e-14)
    assert space.hats.sum(axis=1) == pytest.approx(1.0, rel=1e-14)
    lift = np.zeros((structure.nodes.shape[0], dim))
    lift[structure.body.body_of_node == structure.body.body_of_node[space.nodes[0]], -1] = 1.0
    assert space.N @ lift.ravel() == pytest.approx(-1.0, rel=1e-12)
    assert np.abs(space.N @ np.ones(lift.size)).max() < 1e-12
    force = np.random.default_rng(1).uniform(0.0, 1.0, space.nodes.size)
    force[::3] = 0.0
    nodal = space.means(force) @ force
    assert nodal.min() >= 0.0
    assert nodal.sum() == pytest.approx(force.sum(), rel=1e-14)
    if order == 1:
        assert G.toarray() == pytest.approx(np.eye(force.size), rel=1e-14)
        assert nodal == pytest.approx(force, rel=1e-14)


@pytest.mark.parametrize("shape", ["hex", "tet"])
@pytest.mark.parametrize("outer", [[4.5, 6, 8, 12, 16], [4.5, 5.5, 8, 10, 13, 16]])
def test_pressure_under_a_washer_falls_along_every_radius(shape, outer):
    """By 3 % of the peak at most it may rise; on meshes that match and on others."""
    structure = washer(shape, [4.5, 6, 8, 12], outer)
    assert structure.preload is not None
    pressed = structure.preload.joints[0]
    assert pressed is not None
    assert pressed.force.sum() == pytest.approx(1e4, rel=1e-12)
    assert not np.any((pressed.force > 0.0) & (np.abs(pressed.gap) > 1e-14))
    assert largest_rise(structure, pressed.force) < 0.03


def test_hertz_pressure_of_second_order_converges():
    """Errors in the mean square halve with the elements: the ellipse ends with a vertical slope."""
    force, errors = 2e7 * THICKNESS, []
    half = np.sqrt(8 * 2e7 * (1 - NU**2) / (np.pi * E))
    peak = 2 * 2e7 / (np.pi * half)
    for n in (8, 16, 32):
        found = cylinder(n)
        mesh = named(found.mesh, order=2)
        structure = clamped(mesh, bolts=[Clamp(force, "u_top", "l_base")], plane="strain")
        assert structure.preload is not None
        pressed = structure.preload.joints[0]
        assert pressed is not None
        nodes = np.flatnonzero(pressed.area)
        p, area = pressed.force[nodes] / pressed.area[nodes], pressed.area[nodes]
        x = structure.nodes[nodes, 0]
        exact = peak * np.sqrt(np.maximum(0.0, 1.0 - (x / half) ** 2))
        errors.append(np.sqrt(area @ (p - exact) ** 2 / (area @ exact**2)))
        assert pressed.force.sum() == pytest.approx(force, rel=1e-12)
    assert errors[0] > 1.9 * errors[1] > 3.6 * errors[2]
    assert p.max() == pytest.approx(peak, rel=0.01)


@pytest.mark.parametrize(("shape", "order"), SECOND)
def test_contact_forces_balance_on_faces_that_hang_over(shape, order):
    structure = overhanging(shape, order)
    space = space_of(structure)
    force = np.random.default_rng(2).uniform(0.0, FORCE, space.nodes.size)
    acting = (space.N.T @ force).reshape(structure.nodes.shape)
    assert acting.sum(axis=0) == pytest.approx(0.0, abs=1e-12 * force.sum())
    moments = np.einsum("ni,nj->ij", structure.nodes, acting)
    assert moments - moments.T == pytest.approx(0.0, abs=1e-12 * force.sum())
