"""Pressures of faces: what contact forces give nodes, and that they do not swing."""

from __future__ import annotations

import numpy as np
import pytest
from benchmarks.washer import largest_rise, washer
from bodies import PLANE, SOLID, block
from test_preload import at, clamped, stacked

import skfem_joint as sj
from skfem_joint.joint.pressure_space import pressure_space


def overhanging(shape: str, order: int) -> sj.NamedMesh:
    """The upper of two blocks is shifted sideways by a part of an element: it hangs over."""
    upper, lower = block(shape, order, 2), block(shape, order, 3)
    origin = [0.0] * upper.mesh.dim()
    return sj.merged([at(upper, "u_", 0.4, *origin[2:], 1.0), at(lower, "l_", *origin)])


@pytest.mark.parametrize("make", [stacked, overhanging])
@pytest.mark.parametrize(("shape", "order"), [*PLANE, *SOLID])
def test_means_of_forces_over_corners_lose_nothing(make, shape, order):
    structure = clamped(make(shape, order))
    space, dim = pressure_space(structure.body, structure.joints[0]), structure.dim
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
    acting = (space.N.T @ force).reshape(structure.nodes.shape)
    assert acting.sum(axis=0) == pytest.approx(0.0, abs=1e-12 * force.sum())
    moments = structure.nodes.T @ acting
    assert moments - moments.T == pytest.approx(0.0, abs=1e-12 * force.sum())
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
    pressed = structure.preload.joints[0]
    assert pressed.force.sum() == pytest.approx(1e4, rel=1e-12)
    assert not np.any((pressed.force > 0.0) & (np.abs(pressed.gap) > 1e-14))
    assert largest_rise(structure, pressed.force) < 0.03
