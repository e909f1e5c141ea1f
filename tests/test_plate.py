"""Assembly of plates and of their contact against theorems of plane elasticity."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from bars import DENSITY, MU, THICKNESS, E, LapJoint, bar_structure, order_of
from plates import (
    ELEMENTS,
    distorted,
    lap_plates,
    mapped,
    plate_structure,
    pressed,
    side_plates,
    turned,
)
from scipy import sparse

from skfem_joint.bolts import Bolt, Bolts
from skfem_joint.errors import InputError
from skfem_joint.loads import Harmonic
from skfem_joint.meshing import build_bar
from skfem_joint.plate import (
    PlateJoint,
    PlateStructure,
    assemble_plate,
    full_matrices,
)
from skfem_joint.plate_contact import AxialPressure
from skfem_joint.plate_mesh import PlateMesh, build_plate, make_plate, merged
from skfem_joint.structure import Joint, assemble
from skfem_joint.system import System

NU = 0.3
LOAD = Harmonic(1.0, 1.0)
LAP = PlateJoint("upper_joint", "region", "lower_joint", 8e6, MU)
SIDE = PlateJoint("contact", "boundary", "face", 8e6, MU)
LAP_SUPPORTS = [("lower_left", "xy")]


def rectangle(kind: Any, order: int, n: int = 4) -> PlateMesh:
    return build_plate([("joint", 0.1, n), ("rest", 0.06, n)], 0.05, n, kind=kind, order=order)


def any_plate(kind: Any = "quadrilateral", order: int = 1) -> PlateMesh:
    """A plate of no particular shape."""
    return mapped(
        distorted(rectangle(kind, order)),
        lambda p: np.array([p[0] + 0.2 * p[1], p[1] + 2.0 * p[0] * p[1]]),
    )


def bare(plate: PlateMesh, **changes: Any) -> PlateStructure:
    """A plate that nothing holds, for its matrices before supports."""
    return replace(plate_structure(plate, [pressed()], [], **changes), joints=())


def area_of(plate: PlateMesh) -> float:
    x, y = plate.mesh.p[:, plate.mesh.t]
    return float(0.5 * np.sum(x * np.roll(y, -1, axis=0) - np.roll(x, -1, axis=0) * y))


def elasticity(plane: str) -> np.ndarray:
    """Stress from (e_xx, e_yy, g_xy), Pa; textbook forms in E and nu."""
    if plane == "stress":
        return E / (1 - NU**2) * np.array([[1, NU, 0], [NU, 1, 0], [0, 0, (1 - NU) / 2]])
    factor = E / ((1 + NU) * (1 - 2 * NU))
    return factor * np.array([[1 - NU, NU, 0], [NU, 1 - NU, 0], [0, 0, (1 - 2 * NU) / 2]])


@pytest.mark.parametrize(("kind", "order"), ELEMENTS)
def test_nodes_are_those_of_the_basis_and_sub_cells_cover_their_elements(
    kind: Any, order: int
) -> None:
    structure = bare(any_plate(kind, order))
    np.testing.assert_allclose(structure.nodes, structure.basis.doflocs.T, atol=1e-16)
    x, y = structure.nodes[structure.cells].T
    areas = 0.5 * np.abs(np.sum(x * np.roll(y, -1, axis=0) - np.roll(x, -1, axis=0) * y, axis=0))
    mesh = structure.plate.mesh
    x, y = mesh.p[:, mesh.t]
    whole = 0.5 * np.sum(x * np.roll(y, -1, axis=0) - np.roll(x, -1, axis=0) * y, axis=0)
    np.testing.assert_allclose(np.bincount(structure.cell_element, areas), whole, rtol=1e-12)
    for cell, element in zip(structure.cells, structure.cell_element, strict=True):
        assert set(cell) <= set(structure.element_nodes[:, element])


@pytest.mark.parametrize("plane", ["stress", "strain"])
@pytest.mark.parametrize(("kind", "order"), ELEMENTS)
def test_patch_test_constant_strain_is_reproduced(kind: Any, order: int, plane: str) -> None:
    structure = bare(any_plate(kind, order), plane=plane)
    _, K = full_matrices(structure)
    gradient = np.array([[1e-3, 4e-4], [-7e-4, 5e-4]])
    u = (structure.nodes @ gradient.T).ravel()
    strain = np.array([gradient[0, 0], gradient[1, 1], gradient[0, 1] + gradient[1, 0]])
    energy = 0.5 * strain @ elasticity(plane) @ strain * area_of(structure.plate) * THICKNESS
    assert 0.5 * u @ (K @ u) == pytest.approx(energy, rel=1e-12)
    # No force on inner nodes: solving for them gives the linear field back.
    border = np.zeros((structure.n_nodes, 2), dtype=bool)
    mesh = structure.plate.mesh
    border[np.unique(structure.basis.get_dofs(mesh.boundary_facets()).flatten())] = True
    inner = np.flatnonzero(~border.ravel())
    outer = np.flatnonzero(border.ravel())
    solved = sparse.linalg.spsolve(K[inner][:, inner].tocsc(), -K[inner][:, outer] @ u[outer])
    np.testing.assert_allclose(solved, u[inner], rtol=0, atol=1e-11 * np.abs(u).max())


@pytest.mark.parametrize(("kind", "order"), ELEMENTS)
def test_rigid_motions_strain_nothing_and_have_the_mass_of_the_plate(kind: Any, order: int) -> None:
    structure = bare(any_plate(kind, order))
    M, K = full_matrices(structure)
    x, y = structure.nodes.T
    zero = np.zeros_like(x)
    motions = np.stack([[zero + 1, zero], [zero, zero + 1], [-y, x]]).transpose(0, 2, 1)
    flat = motions.reshape(3, -1)
    np.testing.assert_allclose(K @ flat.T, 0.0, atol=1e-9 * abs(K).max())
    inertia = flat @ (M @ flat.T)
    surface = DENSITY * THICKNESS
    # Polygon moments of the plate's outline, element by element.
    px, py = structure.plate.mesh.p[:, structure.plate.mesh.t]
    qx, qy = np.roll(px, -1, axis=0), np.roll(py, -1, axis=0)
    cross = px * qy - qx * py
    first_x = np.sum((px + qx) * cross) / 6
    first_y = np.sum((py + qy) * cross) / 6
    polar = np.sum((px**2 + px * qx + qx**2 + py**2 + py * qy + qy**2) * cross) / 12
    area = np.sum(cross) / 2
    exact = surface * np.array(
        [[area, 0, -first_y], [0, area, first_x], [-first_y, first_x, polar]]
    )
    np.testing.assert_allclose(inertia, exact, rtol=1e-11, atol=1e-13 * surface * area)


def muskhelishvili(x: np.ndarray, plane: str) -> np.ndarray:
    """Displacement (..., 2) of a plate without forces inside, for phi = e^z and psi = sin z."""
    kappa = (3 - NU) / (1 + NU) if plane == "stress" else 3 - 4 * NU
    z = x[..., 0] + 1j * x[..., 1]
    u = kappa * np.exp(z) - z * np.conj(np.exp(z)) - np.conj(np.sin(z))
    return np.stack([u.real, u.imag], axis=-1)


@pytest.mark.parametrize("plane", ["stress", "strain"])
@pytest.mark.parametrize(("kind", "order"), ELEMENTS)
def test_displacement_converges_at_the_order_of_the_element(
    kind: Any, order: int, plane: str
) -> None:
    errors = []
    counts = (3, 6, 12) if order == 1 else (2, 4, 8)
    for n in counts:
        plate = build_plate([("joint", 1.0, n)], 1.0, n, kind=kind, order=order)
        plate = mapped(plate, lambda p: np.array([p[0] + 0.2 * p[0] * p[1], p[1] - 0.1 * p[0]]))
        structure = bare(plate, plane=plane)
        _, K = full_matrices(structure)
        u = muskhelishvili(structure.nodes, plane)
        border = np.zeros((structure.n_nodes, 2), dtype=bool)
        border[structure.basis.get_dofs(plate.mesh.boundary_facets()).flatten()] = True
        inner, outer = np.flatnonzero(~border), np.flatnonzero(border)
        solution = u.ravel().copy()
        solution[inner] = sparse.linalg.spsolve(
            K[inner][:, inner].tocsc(), -K[inner][:, outer] @ solution[outer]
        )
        basis = structure.basis
        exact = muskhelishvili(np.moveaxis(np.asarray(basis.global_coordinates()), 0, -1), plane)
        squared = sum(
            np.sum((np.asarray(basis.interpolate(solution[c::2])) - exact[..., c]) ** 2 * basis.dx)
            for c in (0, 1)
        )
        errors.append(np.sqrt(squared))
    last = order_of(errors[1:], [1 / n for n in counts[1:]])
    assert last == pytest.approx(order + 1, abs=0.2)


def test_plane_strain_is_plane_stress_of_other_constants() -> None:
    plate = any_plate("triangle", 2)
    _, strain = full_matrices(bare(plate, plane="strain"))
    constants = {"E": E / (1 - NU**2), "poisson": NU / (1 - NU)}
    # nu / (1 - nu) reaches 1 where plane strain reaches 0.5.
    _, stress = full_matrices(bare(plate, **constants))
    assert abs(strain - stress).max() < 1e-12 * abs(strain).max()


def test_regions_have_their_own_properties() -> None:
    plate = rectangle("quadrilateral", 1)
    parts = {"rest": {"E": E / 2, "thickness": 2 * THICKNESS, "density": 100.0, "poisson": 0.0}}
    structure = bare(plate, poisson=0.0, regions=parts)
    M, K = full_matrices(structure)
    ones = np.tile([1.0, 0.0], structure.n_nodes)
    mass = 0.05 * THICKNESS * (0.1 * DENSITY + 0.06 * 2 * 100.0)
    assert ones @ (M @ ones) == pytest.approx(mass, rel=1e-12)
    stretch = (structure.nodes * [1.0, 0.0]).ravel()
    assert stretch @ (K @ stretch) == pytest.approx(E * THICKNESS * 0.05 * 0.16, rel=1e-12)


def check_form(structure: PlateStructure, system: System) -> None:
    for A in (system.M, system.C, system.K):
        assert isinstance(A, sparse.csr_array)
        assert abs(A - A.T).max() == 0.0
        assert np.all(A.data != 0.0)
    assert np.all(structure.T.data != 0.0)
    np.testing.assert_array_equal(system.B.data, 1.0)
    np.testing.assert_array_equal(np.diff(system.B.indptr), 1)
    assert np.unique(system.B.indices).size == system.B.shape[0]
    # Rows of B are the slips of the patches.
    u = np.random.default_rng(4).standard_normal(system.n)
    slips = system.B @ u
    first = system.first_row
    displacement = structure.expand(u)
    for patch in structure.patches:
        relative = patch.relative(displacement)
        for d in range(patch.directions.shape[1]):
            some = np.any(patch.directions[:, d] != 0.0, axis=1)
            np.testing.assert_array_equal(system.directions[patch.points[some]] > d, True)
            expected = np.sum(relative * patch.directions[:, d], axis=1)[some]
            np.testing.assert_allclose(
                slips[first[patch.points[some]] + d], expected, rtol=1e-11, atol=1e-12
            )


@pytest.mark.parametrize(("kind", "order"), ELEMENTS)
def test_every_slip_is_one_unknown_and_matrices_are_symmetric(kind: Any, order: int) -> None:
    structure = plate_structure(
        any_plate(kind, order),
        [pressed(), PlateJoint("rest", "region", None, 1e6, 0.2)],
        [("left", "xy"), ("top", "x")],
        stiffness_damping=1e-5,
        mass_damping=2.0,
    )
    system = assemble_plate(structure)
    check_form(structure, system)
    assert np.linalg.eigvalsh(system.K.toarray())[0] > 0.0
    assert np.linalg.eigvalsh(system.M.toarray())[0] > 0.0
    assert abs(system.C - 1e-5 * system.K - 2.0 * system.M).max() < 1e-12 * abs(system.C).max()
    # Supports: rows of T are empty, a node held along x slips along y only.
    assert structure.T[np.flatnonzero(structure.held)].nnz == 0
    top = np.setdiff1d(structure.nodes_of("top"), structure.nodes_of("left"))
    which = np.isin(structure.patches[0].nodes, top)
    np.testing.assert_array_equal(system.directions[structure.patches[0].points[which]], 1)
    np.testing.assert_array_equal(
        structure.patches[0].directions[which], [[[0.0, 1.0], [0.0, 0.0]]] * which.sum()
    )


def test_two_joints_side_by_side_add_at_the_nodes_they_share() -> None:
    plate = rectangle("triangle", 1)
    both = replace(plate, regions=plate.regions | {"whole": np.arange(plate.mesh.t.shape[1])})
    one = assemble_plate(plate_structure(both, [pressed("whole")]))
    two = assemble_plate(plate_structure(both, [pressed("joint"), pressed("rest")]))
    np.testing.assert_allclose(two.B.T @ two.on_rows(two.w), one.B.T @ one.on_rows(one.w))
    with pytest.raises(InputError, match=r"'rest' shares a node, at \(0.1, .*of another law, beta"):
        plate_structure(both, [pressed("joint"), pressed("rest", beta=np.inf)])


def edge(**changes: Any) -> PlateJoint:
    return pressed("bottom", kind="boundary", **changes)


@pytest.mark.parametrize(("kind", "order"), ELEMENTS)
def test_on_an_edge_friction_is_along_it_and_the_normal_is_held(kind: Any, order: int) -> None:
    plate = turned(rectangle(kind, order), 25.0)
    structure = plate_structure(plate, [edge()], [("top", "xy")])
    (patch,) = structure.patches
    system = assemble_plate(structure)
    check_form(structure, system)
    tangent = np.array([np.cos(np.radians(25)), np.sin(np.radians(25))])
    np.testing.assert_allclose(patch.directions[:, 0], [tangent] * patch.nodes.size, atol=1e-13)
    np.testing.assert_array_equal(system.directions, 1)
    u = structure.expand(np.random.default_rng(3).standard_normal(system.n))
    np.testing.assert_allclose(u[patch.nodes] @ [-tangent[1], tangent[0]], 0.0, atol=1e-13)
    # Force by tributary length: half shares at the ends, none at a support.
    assert patch.clamping_force == pytest.approx(8e6 * 0.16 * THICKNESS, rel=1e-12)
    np.testing.assert_allclose(patch.normal_force, 8e6 * patch.area, rtol=1e-12)
    order_along = np.argsort(structure.nodes[patch.nodes] @ tangent)
    share = patch.normal_force[order_along]
    np.testing.assert_allclose(share[[0, -1]], share[[1, -2]] / 2, rtol=1e-10)


def test_pressure_along_an_edge_counts_thickness_and_kinks() -> None:
    plate = distorted(rectangle("quadrilateral", 2))
    table = AxialPressure((0.013, 0.05, 0.16), (0.0, 4e6, 1e6))
    structure = plate_structure(
        plate, [edge(pressure=table)], [("left", "xy")], regions={"rest": {"thickness": 0.02}}
    )
    rate = 3e6 / 0.11
    exact = 0.01 * (0.037 * 2e6 + 0.05 * (4e6 - rate * 0.025)) + 0.02 * 0.06 * (1e6 + rate * 0.03)
    assert structure.patches[0].clamping_force == pytest.approx(exact, rel=1e-12)


def test_supports_on_an_edge_that_slips() -> None:
    plate = rectangle("quadrilateral", 1)
    # Held across the edge changes nothing; held along it, a node does not move at all.
    free = plate_structure(plate, [edge()], [("top", "xy")])
    across = plate_structure(plate, [edge()], [("top", "xy"), ("bottom", "y")])
    assert (free.T != across.T).nnz == 0
    along = plate_structure(plate, [edge()], [("left", "x")])
    corner = along.nodes_of("left")[np.argmin(along.nodes[along.nodes_of("left"), 1])]
    np.testing.assert_array_equal(along.patches[0].held_nodes, [corner])
    assert along.T[[2 * corner, 2 * corner + 1]].nnz == 0
    assert along.patches[0].held_force == pytest.approx(8e6 * 0.0125 * THICKNESS, rel=1e-12)
    system = assemble_plate(along)
    check_form(along, system)
    assert system.w.size == 8


def test_a_body_rests_on_the_base_by_its_edge_and_friction() -> None:
    plate = rectangle("quadrilateral", 1)
    plate_structure(plate, [edge()], [])
    with pytest.raises(InputError, match=r"the body with the regions 'joint', 'rest' is left unsu"):
        plate_structure(plate, [edge(friction=0.0)], [])
    with pytest.raises(InputError, match="can move or turn freely"):
        plate_structure(plate, [], [("left", "x")])
    # A point held, and another beside it across the line between them.
    named = replace(plate, points={"a": 0, "b": plate.mesh.p.shape[1] - 1})
    plate_structure(named, [], [("a", "xy"), ("b", "y")])
    with pytest.raises(InputError, match="left unsupported"):
        plate_structure(named, [], [("a", "xy")])


def balanced(structure: PlateStructure, system: System) -> None:
    """Friction forces, as the system applies them, are in balance over both bodies."""
    forces = np.random.default_rng(7).standard_normal(system.B.shape[0])
    first = system.first_row
    applied = np.zeros((structure.n_nodes, 2))
    for patch in structure.patches:
        force = np.zeros((patch.nodes.size, 2))
        for d in range(patch.directions.shape[1]):
            force += forces[first[patch.points] + d, None] * patch.directions[:, d]
        applied[patch.nodes] += force
        applied -= patch.other.T @ force
    # Those forces on all nodes are the friction forces B^T f of the unknowns.
    np.testing.assert_allclose(
        structure.T.T @ applied.ravel(), system.B.T @ forces, rtol=0, atol=1e-11
    )
    size = np.abs(applied).sum()
    np.testing.assert_allclose(applied.sum(axis=0), 0.0, atol=1e-14 * size)
    moment = structure.nodes[:, 0] * applied[:, 1] - structure.nodes[:, 1] * applied[:, 0]
    assert abs(moment.sum()) < 1e-13 * size
    for body in (0, 1):
        assert np.abs(applied[structure.body == body].sum(axis=0)).max() > 1e-3


@pytest.mark.parametrize("elements", [(4, 4), (5, 3), (3, 7)])
@pytest.mark.parametrize(("kind", "order"), ELEMENTS)
def test_action_equals_reaction_between_two_plates(
    kind: Any, order: int, elements: tuple[int, int]
) -> None:
    across = (2, 2) if elements == (4, 4) else (3, 2)
    plate = lap_plates(elements, order, kind, across)
    joint = replace(LAP, pressure=Bolts((Bolt((0.25, 0.025), 20e3, 0.02, 0.005),), 0.01))
    for some in (LAP, joint):
        structure = plate_structure(plate, [some], LAP_SUPPORTS)
        system = assemble_plate(structure)
        check_form(structure, system)
        balanced(structure, system)
        (patch,) = structure.patches
        # Interpolation reproduces linear fields, and picks the nodes where they match.
        np.testing.assert_allclose(patch.other.sum(axis=1), 1.0, rtol=1e-14)
        np.testing.assert_allclose(
            patch.other @ structure.nodes, structure.nodes[patch.nodes], atol=1e-14
        )
        if elements == (4, 4):
            np.testing.assert_array_equal(patch.other.data, 1.0)
            assert patch.other.nnz == patch.nodes.size


@pytest.mark.parametrize("elements", [(4, 4), (5, 3)])
@pytest.mark.parametrize("order", [1, 2])
@pytest.mark.parametrize("angle", [0.0, 40.0])
def test_action_equals_reaction_between_two_edges(
    order: int, elements: tuple[int, int], angle: float
) -> None:
    plate = turned(side_plates(elements, order), angle)
    structure = plate_structure(plate, [SIDE], [("lower_left", "xy"), ("upper_right", "y")])
    system = assemble_plate(structure)
    check_form(structure, system)
    balanced(structure, system)
    # The faces stay closed: nothing moves apart along the normal.
    (patch,) = structure.patches
    relative = patch.relative(structure.expand(np.random.default_rng(1).standard_normal(system.n)))
    normal = [-np.sin(np.radians(angle)), np.cos(np.radians(angle))]
    np.testing.assert_allclose(relative @ normal, 0.0, atol=1e-12)
    assert patch.clamping_force == pytest.approx(8e6 * 0.1 * THICKNESS, rel=1e-12)


@pytest.mark.parametrize("pair", ["lap", "side"])
def test_on_a_body_a_million_times_stiffer_a_plate_is_on_a_rigid_base(pair: str) -> None:
    if pair == "lap":
        plate, joint, supports = lap_plates((5, 3)), LAP, LAP_SUPPORTS
    else:
        plate, joint = side_plates((5, 3)), SIDE
        supports = [("lower_left", "xy"), ("base", "xy")]
    stiff = {name: {"E": 1e6 * E} for name in ("lower_rest", "lower_joint")}
    both = plate_structure(plate, [joint], supports, regions=stiff)
    base = plate_structure(
        plate,
        [replace(joint, against=None)],
        [*supports, ("lower_rest", "xy"), ("lower_joint", "xy")],
    )
    two, one = assemble_plate(both), assemble_plate(base)
    np.testing.assert_allclose(two.w, one.w, rtol=1e-14)
    own = np.flatnonzero(both.body[np.repeat(np.arange(both.n_nodes), np.diff(both.first_unknown))])
    under = np.setdiff1d(np.arange(two.n), own)
    K = two.K.toarray()
    condensed = K[np.ix_(own, own)] - K[np.ix_(own, under)] @ np.linalg.solve(
        K[np.ix_(under, under)], K[np.ix_(under, own)]
    )
    assert np.abs(condensed - one.K).max() < 1e-4 * abs(one.K).max()
    np.testing.assert_allclose(two.B.toarray()[:, own], one.B.toarray())


def test_a_pile_of_three_plates_slips_at_both_faces() -> None:
    plates = [
        build_plate(
            [(f"joint{i}", 0.1, n), (f"rest{i}", 0.05, 2)], 0.05, 2, prefix=f"{i}_",
            origin=(0.0, 0.0),
        )
        for i, n in enumerate((2, 5, 3))
    ]  # fmt: skip
    plate = merged(plates)
    joints = [
        PlateJoint("joint2", "region", "joint1", 1e6, 0.5),
        PlateJoint("joint1", "region", "joint0", 1e6, 0.5),
    ]
    structure = plate_structure(plate, joints, [("0_left", "xy")])
    system = assemble_plate(structure)
    check_form(structure, system)
    # Without slip, what the lowest does linearly, all do where they are pressed.
    u = np.zeros(system.n)
    lowest = structure.body == 0
    field = structure.nodes @ np.array([[1e-3, 2e-4], [3e-4, -1e-3]])
    for i in np.flatnonzero(lowest):
        some = slice(structure.first_unknown[i], structure.first_unknown[i + 1])
        u[some] = field[i, : some.stop - some.start]
    field[structure.held] = 0.0
    expanded = structure.expand(u)
    np.testing.assert_allclose(expanded[lowest], field[lowest])
    for patch in structure.patches:
        np.testing.assert_allclose(patch.relative(expanded), 0.0, atol=1e-18)
    circle = [*joints, PlateJoint("joint0", "region", "joint2", 1e6, 0.5)]
    with pytest.raises(InputError, match="pressed on each other in a circle"):
        plate_structure(plate, circle, [("0_right", "xy")])


def test_a_turned_plate_has_turned_matrices() -> None:
    angle = 33.0
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    loads = [("right", (1.0, 0.5), LOAD)]
    turned_loads = [("right", (c - 0.5 * s, s + 0.5 * c), LOAD)]
    plate = lap_plates((5, 3), 2)
    both = []
    for mesh, direction in ((plate, loads), (turned(plate, angle), turned_loads)):
        structure = plate_structure(mesh, [LAP], LAP_SUPPORTS)
        load = [("upper_right", direction[0][1], LOAD)]
        both.append(assemble_plate(structure, load, ["lower_corner", "upper_right"]))
    straight, other = both
    R = sparse.kron(sparse.eye_array(straight.n // 2), np.array([[c, -s], [s, c]]))
    for name in ("M", "K"):
        A = getattr(straight, name)
        difference = R @ A @ R.T - getattr(other, name)
        assert abs(difference).max() < 1e-12 * abs(A).max()
    np.testing.assert_allclose(other.w, straight.w, rtol=1e-12)
    np.testing.assert_allclose(other.loads[0].vector, R @ straight.loads[0].vector, atol=1e-14)
    assert other.points == straight.points


def strip(elements: int) -> PlateMesh:
    return build_plate([("joint", 0.1, elements), ("rest", 0.15, elements)], 0.05, 1)


def test_a_strip_without_contraction_is_the_strut() -> None:
    n = 6
    structure = plate_structure(
        strip(n),
        [pressed()],
        [("left", "xy"), ("joint", "y"), ("rest", "y")],
        poisson=0.0,
        stiffness_damping=1e-5,
    )
    system = assemble_plate(structure, [("right", (1.0, 0.0), LOAD)], ["right"])
    bar = build_bar([("joint", 0.1, n), ("rest", 0.15, n)], {"fixed": 0.0, "free_end": 0.25})
    strut = assemble(
        bar_structure(bar, [Joint("joint", 8e6, MU, normal_force="consistent")]),
        [("free_end", LOAD)],
    )
    # Both nodes of a cross-section move alike; nodes are numbered column by column.
    together = np.repeat(np.eye(2 * n), 2, axis=0)
    for name in ("M", "C", "K"):
        dense = getattr(strut, name).toarray()
        np.testing.assert_allclose(
            together.T @ getattr(system, name) @ together, dense, atol=1e-12 * np.abs(dense).max()
        )
    np.testing.assert_array_equal(system.directions, 1)
    np.testing.assert_allclose(system.w.reshape(-1, 2).sum(axis=1), strut.w, rtol=1e-12)
    tip = np.eye(2 * n)[-1]
    assert system.points == ("right", "right.x", "right.y")
    np.testing.assert_allclose(system.P @ together, [tip, tip, 0 * tip], atol=1e-15)


@pytest.mark.parametrize(("kind", "order"), ELEMENTS)
def test_tension_without_contraction_is_that_of_a_bar(kind: Any, order: int) -> None:
    plate = distorted(rectangle(kind, order))
    plate = replace(plate, points={"corner": int(np.argmax(plate.mesh.p.sum(axis=0)))})
    structure = plate_structure(plate, [], poisson=0.0)
    system = assemble_plate(structure, [("right", (2.0, 0.0), LOAD)], ["corner", "right"])
    assert system.points == ("right", "corner.x", "corner.y", "right.x", "right.y")
    u = np.linalg.solve(system.K.toarray(), 1e4 * system.loads[0].vector)
    tip = 1e4 * 0.16 / (E * 0.05 * THICKNESS)
    np.testing.assert_allclose(system.P @ u, [tip, tip, 0, tip, 0], rtol=1e-9, atol=1e-9 * tip)
    # The row of a load is what it works on.
    np.testing.assert_allclose(system.P[[0]].toarray()[0], system.loads[0].vector)


def test_loads_on_regions_and_points_and_names_of_rows() -> None:
    plate = replace(rectangle("triangle", 2), points={"corner": 3})
    structure = plate_structure(plate, [pressed()], [])
    loads = [
        ("rest", (0.0, -3.0), LOAD),
        ("corner", (3.0, 4.0), LOAD),
        ("rest", (1.0, 0.0), LOAD),
    ]
    system = assemble_plate(structure, loads)
    assert system.points == ("rest", "corner", "rest.2", "corner.x", "corner.y")
    assert [load.on for load in system.loads] == ["rest", "corner", "rest.2"]
    ones = np.tile(np.eye(2), (1, structure.n_nodes))  # both translations
    for load, direction in zip(system.loads, ([0, -1], [0.6, 0.8], [1, 0]), strict=True):
        np.testing.assert_allclose(ones @ load.vector, direction, atol=1e-14)
    # The force on a region acts at its middle.
    x = structure.nodes @ np.array([[0, 1], [0, 0]])
    assert x.ravel() @ system.loads[0].vector == pytest.approx(-0.13, rel=1e-12)


def test_displacements_are_expanded_to_all_nodes() -> None:
    structure = plate_structure(rectangle("quadrilateral", 2))
    u = np.random.default_rng(0).standard_normal((5, structure.T.shape[1]))
    field = structure.expand(u)
    assert field.shape == (5, structure.n_nodes, 2)
    np.testing.assert_array_equal(field[3], structure.expand(u[3]))
    np.testing.assert_array_equal(field[:, structure.nodes_of("left")], 0.0)
    np.testing.assert_array_equal(np.sort(field[0][field[0] != 0.0]), np.sort(u[0]))


def named(plate: PlateMesh) -> PlateMesh:
    return replace(plate, points={"corner": 0}, regions=plate.regions | {"left": np.array([0])})


def test_every_mistake_is_reported_at_once() -> None:
    plate = replace(rectangle("triangle", 1), points={"corner": 0})
    empty = {"hollow": np.zeros(0, dtype=np.int64)}
    plate = replace(plate, regions=plate.regions | empty)
    with pytest.raises(InputError) as caught:
        plate_structure(
            plate,
            [
                pressed("bottom"), pressed("joint", kind="boundary"), pressed("bolt", beta=0.0),
                pressed(friction=-0.1, pressure=-1.0), pressed(), pressed("hollow"),
                pressed("rest", against="joint"), pressed("top", kind="edge"),
            ],
            [("wall", "xy"), ("left", "z")],
            E=0.0, poisson=0.5, density=np.nan, thickness=-1.0, plane="shell",
            stiffness_damping=-1.0, mass_damping=np.inf,
            regions={"top": {}, "joint": {"colour": 1.0}},
        )  # fmt: skip
    for line in (
        "joint 'bottom': found 'bottom', which is a boundary; a region is needed; the mesh has: "
        "hollow, joint, rest",
        "joint 'joint': found 'joint', which is a region; a boundary is needed; the mesh has: "
        "bottom, left, right, top",
        "joint 'bolt': no region named 'bolt' in the mesh; it has: regions hollow, joint, rest; "
        "boundaries bottom, left, right, top; points corner",
        "joint 'bolt': beta: found 0.0, must be > 0",
        "joint 'joint': friction: found -0.1, must be >= 0",
        "joint 'joint': pressure: found -1.0, must be >= 0",
        "joint 'joint' overlaps joint 'joint'",
        "joint 'hollow': the region 'hollow' is empty",
        "joint 'rest': 'rest' and 'joint' belong to the same body; a joint needs two bodies that "
        "do not share nodes",
        "joint 'top': kind: found 'edge', must be region or boundary",
        "support: no region, boundary or point named 'wall' in the mesh; it has: regions hollow, "
        "joint, rest; boundaries bottom, left, right, top; points corner",
        "support 'left': found 'z', must be one of xy, x, y",
        "E: found 0.0, must be > 0",
        "poisson: found 0.5, must be between -1 and 0.5",
        "density: found nan, must be > 0",
        "thickness: found -1.0, must be > 0",
        "plane: found 'shell', must be one of stress, strain",
        "damping.stiffness: found -1.0, must be >= 0",
        "damping.mass: found inf, must be >= 0",
        "regions.top: found 'top', which is a boundary; a region is needed; the mesh has: hollow, "
        "joint, rest",
        "regions.joint: unknown property 'colour', must be one of E, poisson, density, thickness",
    ):
        assert line in caught.value.problems
    with pytest.raises(InputError, match="'left' is the name of a region and of a boundary"):
        plate_structure(named(plate))


def test_joints_that_do_not_overlap_are_refused_with_place_and_distance() -> None:
    lower = build_plate([("lower", 0.2, 4)], 0.05, 2, prefix="lower_")
    upper = build_plate([("upper", 0.2, 4)], 0.05, 2, prefix="upper_", origin=(0.1, 0.0))
    plate = merged([lower, upper])
    joint = PlateJoint("upper", "region", "lower", 1e6, 0.5)
    message = (
        r"'upper': 6 of its 15 pressed nodes do not overlap with 'lower'; the farthest, at \(0.3, "
        r"0.*\), is about 0.1 m from it"
    )
    with pytest.raises(InputError, match=message):
        plate_structure(plate, [joint], LAP_SUPPORTS)
    # Bolts that press only where both are: the rest of the region is no contact.
    bolts = replace(joint, pressure=Bolts((Bolt((0.12, 0.025), 1e3, 0.01),)))
    (patch,) = plate_structure(plate, [bolts], LAP_SUPPORTS).patches
    assert patch.clamping_force == pytest.approx(1e3)
    # Edges side by side, but not on each other.
    apart = side_plates()
    vertices = np.unique(apart.mesh.t[:, apart.body == 1])
    shifted = apart.mesh.p.copy()
    shifted[1, vertices] += 0.02
    with pytest.raises(InputError, match=r"5 of its 5 pressed nodes do not overlap with 'face'"):
        plate_structure(mapped(apart, lambda _: shifted), [SIDE], [("base", "xy")])


def test_what_is_pressed_on_another_body_must_not_be_supported() -> None:
    with pytest.raises(InputError, match=r"3 of its nodes are supported, the first at \(0.2, 0\)"):
        plate_structure(lap_plates(), [LAP], [*LAP_SUPPORTS, ("upper_left", "y")])
    # The other body may be: its nodes do not move, the slip is the whole displacement.
    held = plate_structure(lap_plates(), [LAP], [*LAP_SUPPORTS, ("lower_joint", "xy")])
    check_form(held, assemble_plate(held))


def test_two_bodies_need_friction_or_supports() -> None:
    plate = lap_plates()
    with pytest.raises(InputError, match="'upper_joint', 'upper_rest' is left unsupported"):
        plate_structure(plate, [replace(LAP, friction=0.0)], LAP_SUPPORTS)
    with pytest.raises(InputError) as caught:
        plate_structure(plate, [LAP], [])
    assert len(caught.value.problems) == 2
    unnamed = make_plate(plate.mesh.p, plate.mesh.t)
    with pytest.raises(InputError, match=r"the body around \(0.175, 0.025\) is left unsupported"):
        plate_structure(unnamed, [], [])


def test_joints_on_borders_that_cannot_slip_are_refused() -> None:
    plate = rectangle("quadrilateral", 1)
    whole = replace(plate, boundaries=plate.boundaries | {
        "outline": plate.mesh.boundary_facets().astype(np.int64),
        "inner": np.flatnonzero(plate.mesh.f2t[1] >= 0)[:2],
    })  # fmt: skip
    with pytest.raises(InputError, match=r"'outline': it turns by 90 degrees at"):
        plate_structure(whole, [pressed("outline", kind="boundary")], [])
    with pytest.raises(InputError, match="'inner' runs inside a body"):
        plate_structure(whole, [pressed("inner", kind="boundary")])
    with pytest.raises(InputError, match="bolts press regions"):
        plate_structure(whole, [edge(pressure=Bolts((Bolt((0.0, 0.0), 1.0, 1.0),)))])
    with pytest.raises(InputError, match="no free node: all its nodes are supported"):
        plate_structure(whole, [pressed()], [("joint", "xy")])
    neighbours = [pressed("bottom", kind="boundary"), pressed("right", kind="boundary")]
    with pytest.raises(InputError, match=r"'right' shares a node, at \(0.16, 0\)"):
        plate_structure(whole, neighbours)


def test_loads_and_points_must_exist_and_be_free() -> None:
    plate = replace(rectangle("quadrilateral", 1), points={"corner": 0})
    structure = plate_structure(plate)
    with pytest.raises(InputError) as caught:
        assemble_plate(
            structure, [("nose", (1, 0), LOAD), ("right", (0, 0), LOAD)], ["tail", "right"]
        )
    text = str(caught.value)
    assert "load: no region, boundary or point named 'nose'" in text
    assert "load on 'right': direction: found (0, 0), must be two finite numbers" in text
    assert "points: no region, boundary or point named 'tail'" in text
    with pytest.raises(InputError, match="load on 'left': a support holds it"):
        assemble_plate(structure, [("left", (1, 0), LOAD)])
    with pytest.raises(InputError, match="points: 'corner' is supported and does not move"):
        assemble_plate(structure, points=["corner"])
    assert assemble_plate(structure).points == ()


def test_friction_is_that_of_the_strut_for_the_reference_joint() -> None:
    plate = build_plate([("joint", 0.25, 20)], 0.05, 4)
    system = assemble_plate(plate_structure(plate, [pressed()]))
    strut = LapJoint(elements=20, normal_force="consistent").system
    assert system.w.sum() == pytest.approx(strut.w.sum(), rel=1e-12)
