"""Slip directions and slip unknowns: every dimension, edges, faces, supports and second bodies."""

from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import pytest
from bodies import (
    ELEMENTS,
    LAP,
    PLANE,
    SIDE,
    SOLID,
    THICKNESS,
    block,
    distorted,
    lap,
    mapped,
    pressed,
    side,
    structure,
    turned,
    two_bars,
)
from scipy import sparse
from test_preload import stacked

import skfem_joint as sj
from skfem_joint.joint.manifold import slip_directions


def check_form(some: sj.Structure, system: sj.System) -> None:
    """Matrices are symmetric, each slip is one unknown, and it is the slip."""
    for A in (system.M, system.C, system.K):
        assert isinstance(A, sparse.csr_array)
        assert abs(A - A.T).max() <= 1e-16 * abs(A).max()
    np.testing.assert_array_equal(system.contact.B.data, 1.0)
    np.testing.assert_array_equal(np.diff(system.contact.B.indptr), 1)
    assert np.unique(system.contact.B.indices).size == system.contact.B.shape[0]
    # Unknowns and displacements determine each other.
    u = np.random.default_rng(4).standard_normal(system.n)
    back = some.change_of_unknowns.inverse @ system.expand(u)
    np.testing.assert_allclose(back, u, rtol=1e-10, atol=1e-12)
    slips, first = system.contact.B @ u, system.contact.first_row
    displacement = some.expand(u)
    np.testing.assert_array_equal(displacement[some.held], 0.0)
    for patch in some.patches:
        relative = patch.relative(displacement)
        if patch.normal is not None:
            across = np.einsum("kc,kc->k", relative, patch.normal)
            np.testing.assert_allclose(across, 0.0, atol=1e-12)
        for d in range(patch.directions.shape[1]):
            has = np.any(patch.directions[:, d] != 0.0, axis=1)
            np.testing.assert_array_equal(system.contact.directions[patch.points[has]] > d, True)
            expected = np.sum(relative * patch.directions[:, d], axis=1)[has]
            np.testing.assert_allclose(
                slips[first[patch.points[has]] + d], expected, rtol=1e-10, atol=1e-12
            )


@pytest.mark.parametrize(("shape", "order"), ELEMENTS)
def test_on_its_base_a_body_slips_in_its_own_directions(shape, order):
    if shape in ("tet", "hex"):
        joints = [pressed("base")]
    else:
        joints = [pressed(), pressed("rest", pressure=1e6)]
    some = structure(distorted(block(shape, order, 4 - order)), joints, stiffness_damping=1e-5)
    system = some.system()
    check_form(some, system)
    expected = {"line": 1, "tri": 2, "quad": 2, "tet": 2, "hex": 2}[shape]
    np.testing.assert_array_equal(system.contact.directions, expected)
    assert np.linalg.eigvalsh(system.K.toarray())[0] > 0.0
    assert np.linalg.eigvalsh(system.M.toarray())[0] > 0.0


@pytest.mark.parametrize("angle", [0.0, 25.0])
@pytest.mark.parametrize(("shape", "order"), PLANE + SOLID)
def test_pressed_by_its_border_a_body_slips_along_it_and_stays_on_it(shape, order, angle):
    some = structure(turned(block(shape, order, 4 - order), angle), [pressed("base")], ["top"])
    system = some.system()
    check_form(some, system)
    (patch,) = some.patches
    turn = np.radians(angle)
    normal = [np.sin(turn), -np.cos(turn)] if some.dim == 2 else [0.0, 0.0, -1.0]
    np.testing.assert_allclose(patch.normal, [normal] * patch.nodes.size, atol=1e-13)
    if some.dim == 2:
        tangent = [np.cos(turn), np.sin(turn)]
        np.testing.assert_allclose(patch.directions[:, 0], [tangent] * patch.nodes.size, atol=1e-13)
    # Force by tributary area.
    area = THICKNESS if some.dim == 2 else 1.0
    assert patch.clamping_force == pytest.approx(8e6 * area, rel=1e-12)
    np.testing.assert_allclose(patch.normal_force, 8e6 * patch.area, rtol=1e-12)


@pytest.mark.parametrize(("shape", "order"), PLANE + SOLID)
def test_supports_take_slip_directions(shape, order):
    body = block(shape, order, 4 - order)
    on = "base"
    free = structure(body, [pressed(on)], ["top"])
    last = "xyz"[free.dim - 1]
    # Held across the border changes nothing; held along it, a direction is gone.
    across = structure(body, [pressed(on)], ["top"], **{f"fixed_{last}": [on]})
    check_form(across, across.system())
    assert abs(free.T @ free.T.T - across.T @ across.T.T).max() < 1e-14
    along = structure(body, [pressed(on)], ["top"], fixed_x=["left"])
    system = along.system()
    check_form(along, system)
    (patch,) = along.patches
    left = np.isin(along.body.nodes_of(on), along.body.nodes_of("left"))
    if along.dim == 2:
        np.testing.assert_array_equal(np.sort(patch.held_nodes), along.body.nodes_of(on)[left])
        rows = (2 * patch.held_nodes[:, None] + np.arange(2)).ravel()
        assert along.T[rows].nnz == 0
    else:
        held = np.isin(patch.nodes, along.body.nodes_of("left"))
        np.testing.assert_array_equal(system.contact.directions[patch.points[held]], 1)
        np.testing.assert_array_equal(system.contact.directions[patch.points[~held]], 2)


def test_an_inclined_support_leaves_what_is_perpendicular_to_it_and_the_normal():
    normal = np.array([[0.6, 0.0, 0.8], [0.6, 0.0, 0.8]])
    held = np.array([[True, False, False], [False, True, False]])
    found = slip_directions(normal, held)
    np.testing.assert_allclose(np.abs(found[0]), [[0, 1, 0], [0, 0, 0]], atol=1e-12)
    np.testing.assert_allclose(np.abs(found[1]), [[0.8, 0, 0.6], [0, 0, 0]], atol=1e-12)


def ring(n: int) -> Any:
    """Half of a ring of quadrilaterals, pressed by its inner border."""
    body = sj.build_plate(
        [("joint", np.pi, n)], 0.5, 2, boundaries={"inner": "bottom", "outer": "top"}
    )

    def bent(p: np.ndarray) -> np.ndarray:
        r, a = 1.0 + p[1], np.pi - p[0]
        return np.array([r * np.cos(a), r * np.sin(a)])

    return mapped(body, bent)


def test_normals_of_a_ring_are_those_of_the_circle():
    some = structure(ring(20), [pressed("inner")], ["outer"])
    (patch,) = some.patches
    inside = np.abs(some.nodes[patch.nodes, 1]) > 1e-9
    np.testing.assert_allclose(patch.normal[inside], -some.nodes[patch.nodes][inside], atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(patch.normal, axis=1), 1.0, rtol=1e-14)
    # Tangents go on from node to node, all the way round.
    order = np.argsort(np.arctan2(some.nodes[patch.nodes, 1], some.nodes[patch.nodes, 0]))
    tangents = patch.directions[order, 0]
    assert np.einsum("kc,kc->k", tangents[1:], tangents[:-1]).min() > 0.9
    check_form(some, some.system())
    with pytest.raises(sj.InputError, match=r"turns by .* degrees at .*at most 30"):
        structure(ring(5), [pressed("inner")], ["outer"]).system()


@pytest.mark.parametrize("shape", ["tet", "hex"])
def test_normals_of_a_solid_sphere_patch_are_alike_for_both_shapes(shape):
    def bent(p):
        rise = 0.1 * ((p[0] - 0.5) ** 2 + (p[1] - 0.5) ** 2) * (1 - p[2])
        return np.vstack([p[:2], p[2] + rise])

    some = structure(mapped(block(shape, 1, 4), bent), [pressed("base")], ["top"])
    (patch,) = some.patches
    x = some.nodes[patch.nodes] - 0.5
    exact = np.stack([0.2 * x[:, 0], 0.2 * x[:, 1], -np.ones(len(x))], axis=1)
    exact /= np.linalg.norm(exact, axis=1)[:, None]
    inner = np.all(np.abs(x[:, :2]) < 0.4, axis=1)
    np.testing.assert_allclose(patch.normal[inner], exact[inner], atol=1e-12)


def test_joints_side_by_side_add_at_the_nodes_they_share_and_need_one_law():
    for shape in ("line", "tri"):
        body = block(shape, 1)
        elements = np.arange(body.mesh.t.shape[1])
        body = replace(body, mesh=body.mesh.with_subdomains({"whole": elements}))
        one = structure(body, [pressed("whole")]).system()
        two = structure(body, [pressed("joint"), pressed("rest")]).system()
        np.testing.assert_allclose(
            two.contact.B.T @ two.contact.on_rows(two.contact.w),
            one.contact.B.T @ one.contact.on_rows(one.contact.w),
        )
        with pytest.raises(sj.InputError, match=r"'rest' shares a node, .*of another law, beta"):
            structure(body, [pressed("joint"), pressed("rest", beta=1e5)])


def check_balance(some: sj.Structure, system: sj.System) -> None:
    """Fail unless forces of friction, as applied, are in balance, and both bodies have some."""
    forces = np.random.default_rng(7).standard_normal(system.contact.B.shape[0])
    first = system.contact.first_row
    applied = np.zeros((some.n_nodes, some.dim))
    for patch in some.patches:
        force = np.zeros((patch.nodes.size, some.dim))
        for d in range(patch.directions.shape[1]):
            has = np.any(patch.directions[:, d] != 0.0, axis=1)
            rows = first[patch.points[has]] + d
            force[has] += forces[rows, None] * patch.directions[has, d]
        applied[patch.nodes] += force
        applied -= patch.other.T @ force
    # Those forces on all nodes are the friction forces B^T f of the unknowns.
    np.testing.assert_allclose(
        some.T.T @ applied.ravel(), system.contact.B.T @ forces, rtol=0, atol=1e-10
    )
    size = np.abs(applied).sum()
    np.testing.assert_allclose(applied.sum(axis=0), 0.0, atol=1e-13 * size)
    moments = some.nodes.T @ applied
    np.testing.assert_allclose(moments, moments.T, atol=1e-12 * size)
    for body in (0, 1):
        assert np.abs(applied[some.body.body_of_node == body].sum(axis=0)).max() > 1e-3


def plates(kind: Any, order: int, elements: tuple[int, int], **joint: Any) -> sj.Structure:
    body = lap(elements, order, kind, (2, 2) if elements == (4, 4) else (3, 2))
    return structure(body, [replace(LAP, **joint)], ["lower_left"])


def edges(order: int, elements: tuple[int, int], angle: float) -> sj.Structure:
    body = turned(side(elements, order), angle)
    return structure(body, [SIDE], ["lower_left"], fixed_y=["upper_right"])


def solids(shape: str, order: int) -> sj.Structure:
    return structure(stacked(shape, order, 3, 2), [pressed("u_base", against="l_top")], ["l_base"])


BOLTS = sj.Bolts((sj.Bolt((0.25, 0.025), 20e3, 0.02, 0.005),), 0.01)
FLAT = ["triangle", "quadrilateral"]
CASES = [(plates, *case) for case in product(FLAT, [1, 2], [(4, 4), (5, 3), (3, 7)])]
CASES += [(edges, *case) for case in product([1, 2], [(4, 4), (5, 3)], [0.0, 40.0])]
CASES += [(solids, *case) for case in SOLID]
CASES += [(two_bars, 20, below) for below in (20, 13, 33)]


@pytest.mark.parametrize("case", CASES)
def test_action_equals_reaction_between_bodies_pressed_on_each_other(case):
    """Friction forces, as applied, are in balance over both bodies, and so are their moments."""
    make, *how = case
    some = make(*how)
    check_form(some, some.system())
    check_balance(some, some.system())
    (patch,) = some.patches
    # Interpolation reproduces linear fields, and picks the nodes where they match.
    np.testing.assert_allclose(patch.other.sum(axis=1), 1.0, rtol=1e-14)
    if make is plates:
        np.testing.assert_allclose(patch.other @ some.nodes, some.nodes[patch.nodes], atol=1e-14)
        bolted = plates(*how, pressure=BOLTS)
        check_balance(bolted, bolted.system())
    if make is plates and how[-1] == (4, 4):
        np.testing.assert_array_equal(patch.other.data, 1.0)
        assert patch.other.nnz == patch.nodes.size


def test_a_pile_of_three_plates_slips_at_both_faces():
    plates = [
        sj.build_plate([(f"joint{i}", 0.1, n), (f"rest{i}", 0.05, 2)], 0.05, 2, prefix=f"{i}_")
        for i, n in enumerate((2, 5, 3))
    ]
    body = sj.merged(plates)
    joints = [sj.Joint("joint2", 1e6, 0.5, "joint1"), sj.Joint("joint1", 1e6, 0.5, "joint0")]
    some = structure(body, joints, ["0_left"])
    system = some.system()
    check_form(some, system)
    # Without slip, what the lowest does linearly, all do where they are pressed.
    field = (some.nodes @ np.array([[1e-3, 2e-4], [3e-4, -1e-3]])).ravel()
    field[np.repeat(some.body.body_of_node > 0, 2) | some.held.ravel()] = 0.0
    q = some.change_of_unknowns.inverse @ field
    q[system.contact.B.indices] = 0.0
    expanded = some.expand(q)
    for patch in some.patches:
        np.testing.assert_allclose(patch.relative(expanded), 0.0, atol=1e-17)
    circle = [*joints, sj.Joint("joint0", 1e6, 0.5, "joint2")]
    with pytest.raises(sj.InputError, match="in a circle"):
        structure(body, circle, ["0_right"]).system()
