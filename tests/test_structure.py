"""Assembly of the bar and of its contact against closed forms of the strut."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from bars import DENSITY, EA, MU, SPEED, THICKNESS, WIDTH, E, LapJoint, bar_structure, order_of
from scipy.integrate import quad
from scipy.linalg import eigh

from skfem_joint.contact import PressureTable
from skfem_joint.errors import InputError
from skfem_joint.integrate import integrate
from skfem_joint.loads import Harmonic
from skfem_joint.meshing import BarMesh, build_bar, load_mesh, write_mesh
from skfem_joint.structure import Joint, assemble
from skfem_joint.system import System

LENGTH = 0.25


def plain_bar(elements: int, length: float = LENGTH) -> BarMesh:
    return build_bar([("joint", length, elements)], {"fixed": 0.0, "free_end": length})


def frequencies(system: System, count: int) -> np.ndarray:
    squares = eigh(system.K.toarray(), system.M.toarray(), eigvals_only=True)
    return np.sqrt(squares[:count]) / (2 * np.pi)


@pytest.mark.parametrize("lumped", [False, True])
def test_bar_frequencies_converge_at_second_order_to_the_closed_form(lumped: bool) -> None:
    exact = SPEED / (4 * LENGTH) * (2 * np.arange(1, 5) - 1)
    counts = (20, 40, 80, 160)
    errors = np.array(
        [
            frequencies(assemble(bar_structure(plain_bar(n), lumped_mass=lumped)), 4) / exact - 1.0
            for n in counts
        ]
    )
    # A consistent mass bounds the frequencies from above (Rayleigh), a lumped one here from below.
    assert np.all(errors < 0.0 if lumped else errors > 0.0)
    for mode in range(4):
        order = order_of(np.abs(errors[:, mode]), [1.0 / n for n in counts])
        assert order == pytest.approx(2.0, abs=0.02)
    assert np.abs(errors[-1]).max() < 5e-4


def static(system: System, force: float) -> np.ndarray:
    return np.linalg.solve(system.K.toarray(), force * system.loads[0].vector)


@pytest.mark.parametrize("elements", [1, 2, 7, 100])
def test_static_tip_is_exact_at_any_number_of_elements(elements: int) -> None:
    system = assemble(bar_structure(plain_bar(elements)), [("free_end", Harmonic(1.0, 1.0))])
    u = static(system, 1e4)
    tip = float((system.P @ u)[system.points.index("free_end")])
    assert tip == pytest.approx(1e4 * LENGTH / EA, rel=1e-12)


def test_each_region_has_its_own_material_and_section() -> None:
    bar = build_bar(
        [("steel", 0.1, 3), ("alloy", 0.4, 5)], {"fixed": 0.0, "middle": 0.1, "free_end": 0.5}
    )
    alloy = {"E": 70e9, "density": 2700.0, "width": 0.03, "thickness": 0.02}
    structure = bar_structure(bar, regions={"alloy": alloy})
    system = assemble(structure, [("free_end", Harmonic(1.0, 1.0))])
    u = dict(zip(system.points, system.P @ static(system, 1e4), strict=True))
    assert u["middle"] == pytest.approx(1e4 * 0.1 / EA, rel=1e-12)
    stretch = 1e4 * 0.4 / (70e9 * 0.03 * 0.02)
    assert u["free_end"] - u["middle"] == pytest.approx(stretch, rel=1e-12)
    # A rigid translation of a free bar has the bar's mass for twice its kinetic energy.
    free = assemble(replace(structure, fixed=()))
    ones = np.ones(free.n)
    mass = DENSITY * WIDTH * THICKNESS * 0.1 + 2700.0 * 0.03 * 0.02 * 0.4
    assert ones @ (free.M @ ones) == pytest.approx(mass, rel=1e-12)
    np.testing.assert_allclose(free.K @ ones, 0.0, atol=1e-6)


def test_lumped_mass_is_diagonal_and_keeps_the_total() -> None:
    bar = build_bar([("a", 0.1, 3), ("b", 0.4, 5)], {"fixed": 0.0})
    structure = bar_structure(bar, regions={"b": {"density": 2700.0}}, fixed=[])
    consistent = assemble(structure).M
    lumped = assemble(replace(structure, lumped_mass=True)).M
    assert lumped.sum() == pytest.approx(consistent.sum(), rel=1e-13)
    np.testing.assert_array_equal(lumped.toarray(), np.diag(lumped.diagonal()))


def test_matrices_are_symmetric_tridiagonal_and_positive_definite() -> None:
    system = LapJoint(elements=30).system
    for A in (system.M, system.C, system.K):
        dense = A.toarray()
        np.testing.assert_array_equal(dense, dense.T)
        np.testing.assert_array_equal(dense, np.tril(np.triu(dense, -1), 1))
        assert np.linalg.eigvalsh(dense)[0] > 0.0


def test_proportional_damping() -> None:
    structure = bar_structure(plain_bar(10), stiffness_damping=2e-5, mass_damping=3.0)
    system = assemble(structure)
    expected = (2e-5 * system.K + 3.0 * system.M).toarray()
    np.testing.assert_allclose(system.C.toarray(), expected, rtol=1e-14, atol=0.0)


def test_an_inclined_mesh_gives_the_same_system(tmp_path: Path) -> None:
    bar = plain_bar(20)
    along = np.outer(bar.mesh.p[0], [0.6, 0.64, 0.48])
    inclined = replace(bar, coordinates=along + np.array([1.0, -2.0, 0.5]))
    write_mesh(inclined, tmp_path / "inclined.msh")
    joint = Joint("joint", 8e6, MU)
    straight = assemble(bar_structure(bar, [joint]))
    turned = assemble(bar_structure(load_mesh(tmp_path / "inclined.msh"), [joint]))
    for name in ("M", "K"):
        dense = getattr(straight, name).toarray()
        np.testing.assert_allclose(
            getattr(turned, name).toarray(), dense, rtol=1e-11, atol=1e-11 * dense.max()
        )
    np.testing.assert_allclose(turned.w, straight.w, rtol=1e-11)


def test_supports_at_both_ends_and_inside_are_eliminated() -> None:
    bar = build_bar([("joint", 1.0, 4)], {"fixed": 0.0, "middle": 0.5, "other_end": 1.0})
    structure = bar_structure(bar, fixed=["fixed", "other_end"])
    np.testing.assert_array_equal(structure.free, [1, 2, 3])
    system = assemble(structure, [("middle", Harmonic(1.0, 1.0))])
    # Two bars of half the length hold the middle, each of stiffness 2 EA.
    assert (system.P @ static(system, 1.0))[0] == pytest.approx(1.0 / (4.0 * EA), rel=1e-12)
    np.testing.assert_array_equal(
        structure.expand(np.array([[1.0, 2.0, 3.0]])), [[0.0, 1.0, 2.0, 3.0, 0.0]]
    )


def test_a_force_spread_along_a_region_is_a_line_load() -> None:
    # Tip under a force F spread along a whole bar: F L / (2 EA), exact at the nodes.
    system = assemble(bar_structure(plain_bar(7)), [("joint", Harmonic(1.0, 1.0))])
    tip = float((system.P @ static(system, 1e4))[0])
    assert tip == pytest.approx(1e4 * LENGTH / (2 * EA), rel=1e-12)
    free = assemble(bar_structure(plain_bar(7), fixed=[]), [("joint", Harmonic(1.0, 1.0))])
    assert free.loads[0].vector.sum() == pytest.approx(1.0, rel=1e-14)


@pytest.mark.parametrize("kind", ["equal", "consistent"])
def test_a_joint_between_two_supports_is_refused_until_it_is_refined(kind: str) -> None:
    joint = Joint("joint", 8e6, MU, normal_force=kind)

    def system(elements: int) -> System:
        bar = build_bar([("joint", 0.1, elements), ("rest", 0.1, 2)], {"fixed": 0.0, "other": 0.1})
        return assemble(bar_structure(bar, [joint], fixed=["fixed", "other"]))

    with pytest.raises(InputError, match="'joint' has no free node: all its nodes are fixed"):
        system(1)
    # Its one free node takes the whole pressure, or that of the half elements beside it.
    share = {"equal": 1.0, "consistent": 0.5}[kind]
    np.testing.assert_allclose(system(2).w, [share * MU * 8e6 * WIDTH * 0.1], rtol=1e-12)


def limits(elements: int, pressure: Any, kind: str, fixed: list[str] | None = None) -> np.ndarray:
    joint = Joint("joint", pressure, MU, normal_force=kind)
    names = ["fixed"] if fixed is None else fixed
    return assemble(bar_structure(plain_bar(elements), [joint], fixed=names)).w


@pytest.mark.parametrize("elements", [1, 10, 100])
def test_equal_forces_share_the_whole_pressure_among_the_free_nodes(elements: int) -> None:
    w = limits(elements, 8e6, "equal")
    assert w.shape == (elements,)
    np.testing.assert_allclose(w, MU * 8e6 * WIDTH * LENGTH / elements, rtol=1e-12)


@pytest.mark.parametrize("elements", [1, 10, 100])
def test_consistent_forces_give_each_node_its_tributary_length(elements: int) -> None:
    w = limits(elements, 8e6, "consistent")
    share = MU * 8e6 * WIDTH * LENGTH / elements
    np.testing.assert_allclose(w, [*[share] * (elements - 1), share / 2], rtol=1e-12)
    # What is missing in the sum is the supported node's half share.
    assert w.sum() == pytest.approx(MU * 8e6 * WIDTH * LENGTH - share / 2, rel=1e-12)


@pytest.mark.parametrize("kind", ["equal", "consistent"])
def test_without_supports_both_kinds_carry_the_whole_pressure(kind: str) -> None:
    w = limits(10, 8e6, kind, fixed=[])
    assert w.sum() == pytest.approx(MU * 8e6 * WIDTH * LENGTH, rel=1e-12)


def test_pressure_table_is_integrated_along_the_joint() -> None:
    table = PressureTable((0.0, 0.1, 0.25), (0.0, 6e6, 2e6))
    total = MU * WIDTH * (0.1 * 6e6 / 2 + 0.15 * (6e6 + 2e6) / 2)
    w = limits(10, table, "equal")
    assert w.sum() == pytest.approx(total, rel=1e-12)
    w = limits(10, table, "consistent", fixed=[])
    assert w.sum() == pytest.approx(total, rel=1e-12)

    def share(node: int) -> float:
        h = LENGTH / 10
        ends = (max(0.0, (node - 1) * h), node * h, min(LENGTH, (node + 1) * h))
        return (
            MU
            * WIDTH
            * sum(
                quad(lambda x: float(table(np.array(x))) * (1 - abs(x / h - node)), a, b)[0]
                for a, b in pairwise(ends)
            )
        )

    np.testing.assert_allclose(w, [share(node) for node in range(11)], rtol=1e-9)


def test_friction_per_length() -> None:
    structure = LapJoint(elements=4).structure
    tau = structure.friction_per_length(structure.joints[0])
    np.testing.assert_allclose(tau, np.full(4, MU * 8e6 * WIDTH), rtol=1e-14)


def test_consistent_forces_need_ten_elements_where_equal_ones_need_a_hundred() -> None:
    def peak(elements: int, kind: str) -> float:
        system = LapJoint(elements=elements, normal_force=kind).system
        return float(integrate(system, step=1e-5, n_steps=400, cycle_steps=100).cycles.peak[-1, 0])

    fine = peak(200, "consistent")
    assert peak(10, "consistent") == pytest.approx(fine, rel=2e-3)
    assert peak(10, "equal") < 0.9 * fine
    # The paper's mesh: its hundred elements are about 1.2 % off.
    assert peak(100, "equal") == pytest.approx(fine, rel=1.5e-2)
    assert peak(100, "equal") != pytest.approx(fine, rel=5e-3)


def two_joints(second: Joint) -> System:
    bar = build_bar(
        [("left", 0.1, 4), ("gap", 0.1, 4), ("right", 0.1, 4)], {"fixed": 0.0, "free_end": 0.3}
    )
    return assemble(bar_structure(bar, [Joint("left", 1e6, MU), second]))


def test_joints_with_laws_of_their_own_do_not_touch_what_lies_between() -> None:
    system = two_joints(Joint("right", 2e6, 0.5, beta=np.inf))
    np.testing.assert_array_equal(system.B.indices, [0, 1, 2, 3, 7, 8, 9, 10, 11])
    np.testing.assert_array_equal(np.isinf(system.beta), [False] * 4 + [True] * 5)
    h = 0.1 / 4
    right = np.array([0.5, 1.0, 1.0, 1.0, 0.5]) * 0.5 * 2e6 * WIDTH * h
    np.testing.assert_allclose(system.w[4:], right, rtol=1e-12)
    np.testing.assert_allclose(
        system.w[:4], np.array([1.0, 1.0, 1.0, 0.5]) * MU * 1e6 * WIDTH * h, rtol=1e-12
    )


def test_adjacent_joints_add_at_the_node_they_share_and_need_one_law() -> None:
    bar = build_bar([("left", 0.1, 4), ("right", 0.1, 4)], {"fixed": 0.0})
    whole = assemble(bar_structure(plain_bar(8, 0.2), [Joint("joint", 1e6, MU)]))
    parts = [Joint("left", 1e6, MU), Joint("right", 1e6, MU)]
    np.testing.assert_allclose(assemble(bar_structure(bar, parts)).w, whole.w, rtol=1e-12)
    with pytest.raises(InputError, match="shares a node"):
        assemble(bar_structure(bar, [parts[0], replace(parts[1], beta=np.inf)]))


def test_every_mistake_is_reported_at_once() -> None:
    with pytest.raises(InputError) as caught:
        bar_structure(
            plain_bar(4),
            [Joint("joint", -1.0, MU), Joint("joint", 1.0, -0.1, beta=0.0), Joint("bolt", 1.0, MU)],
            E=0.0, density=np.nan, fixed=["wall"], stiffness_damping=-1.0,
            regions={"nowhere": {}, "joint": {"colour": 1.0, "width": np.inf}},
        )  # fmt: skip
    text = str(caught.value)
    for fragment in (
        "E: found 0.0", "density: found nan", "width: found inf", "'wall'", "'bolt'", "'nowhere'",
        "'colour'", "pressure -1.0", "friction -0.1", "beta 0.0", "overlaps", "damping.stiffness",
    ):  # fmt: skip
        assert fragment in text


def test_loads_and_points_must_exist_and_be_free() -> None:
    structure = bar_structure(plain_bar(4))
    load = Harmonic(1.0, 1.0)
    with pytest.raises(InputError, match=r"named 'tip'.*free_end"):
        assemble(structure, [("tip", load)])
    with pytest.raises(InputError, match="is supported"):
        assemble(structure, [("fixed", load)])
    with pytest.raises(InputError, match="supported and does not move"):
        assemble(structure, points=["fixed"])


@pytest.mark.parametrize(
    ("positions", "values"),
    [
        ((0.0,), (1.0,)),
        ((0.0, 1.0), (1.0,)),
        ((1.0, 0.0), (1.0, 1.0)),
        ((0.0, np.nan), (1.0, 1.0)),
        ((0.0, 1.0), (1.0, -1.0)),
        ((0.0, 1.0), (1.0, np.inf)),
    ],
)
def test_pressure_tables_that_make_no_sense_are_refused(positions: Any, values: Any) -> None:
    with pytest.raises(InputError, match="pressure"):
        PressureTable(positions, values)


def test_unknown_kind_of_normal_force_is_refused() -> None:
    with pytest.raises(InputError, match="'lumped', must be one of consistent, equal"):
        limits(4, 1e6, "lumped")


def test_system_refuses_what_does_not_fit() -> None:
    system = LapJoint(elements=4).system
    with pytest.raises(InputError, match=r"K: found shape \(4, 3\)"):
        replace(system, K=system.K[:, :3])
    with pytest.raises(InputError, match="w: friction limits"):
        replace(system, w=-system.w)
    with pytest.raises(InputError, match="beta: must be positive"):
        system.with_beta(np.nan)
    with pytest.raises(InputError, match="basis: found shape"):
        system.project(np.ones((3, 2)))


def test_material_constants_of_the_paper() -> None:
    assert np.sqrt(E / DENSITY) == pytest.approx(SPEED, rel=1e-15)
