"""Reduced plates: their own modes, scaled modes, merged friction points."""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.linalg import eigh, subspace_angles

from skfem_joint import friction
from skfem_joint.errors import InputError
from skfem_joint.hyper_reduction import partition, with_merged_points
from skfem_joint.integrate import integrate
from skfem_joint.loads import Harmonic
from skfem_joint.plate import PlateJoint, PlateStructure, assemble_plate, build_plate_structure
from skfem_joint.plate_mesh import build_plate, merged
from skfem_joint.plate_reduction import (
    PlateBasis,
    active_area_fraction,
    own_basis,
    scaled_basis,
    slips,
    with_friction_points,
)
from skfem_joint.recording import Run, Save
from skfem_joint.reference import paper_reference
from skfem_joint.system import System

AXIS = {"joint": np.array([1.0, 0.0])}
STEPS = 100
FIELDS = Save(fields=True)


def structure_of(plate: Any, joint: PlateJoint, poisson: float, held: str) -> PlateStructure:
    return build_plate_structure(
        plate,
        E=200e9,
        poisson=poisson,
        density=8000.0,
        thickness=0.01,
        supports=[(held, "xy")],
        joints=[joint],
        stiffness_damping=1e-5,
    )


@cache
def case(name: str, poisson: float = 0.3) -> tuple[PlateStructure, System, float]:
    """Structure, system and step: 3 cycles are run."""
    on, load, frequency = "right", (1.0, 0.0), 500.0
    joint = PlateJoint("joint", "region", None, 50e6, 0.7)
    if name == "lap":  # the paper's reference system
        plate = build_plate([("joint", 0.25, 40)], 0.05, 4)
        joint, force, frequency = replace(joint, pressure=8e6), 63e3, 1000.0
    elif name == "strip":
        plate, force = build_plate([("joint", 0.1, 16), ("arm", 0.5, 16)], 0.05, 2), 87.5e3
    elif name == "edge":
        border = {"left": "left", "right": "right", "joint": ("bottom", "foot")}
        plate = build_plate([("foot", 0.1, 16), ("arm", 0.3, 16)], 0.05, 2, boundaries=border)
        joint, force = PlateJoint("joint", "boundary", None, 100e6, 0.5), 20e3
    else:
        under = build_plate([("under", 0.1, 12), ("arm", 0.3, 12)], 0.05, 2, prefix="lower_")
        over = build_plate(
            [("arm_over", 0.3, 12), ("joint", 0.1, 12)],
            0.05,
            2,
            prefix="upper_",
            origin=(-0.3, 0.0),
        )
        plate, force, on, load = merged([under, over]), 60e3, "upper_left", (-1.0, 0.0)
        joint = replace(joint, against="under")
    structure = structure_of(plate, joint, poisson, "lower_right" if name == "two" else "left")
    return (
        structure,
        assemble_plate(structure, [(on, load, Harmonic(force, frequency))], []),
        1.0 / frequency / STEPS,
    )


def cycles(system: System, step: float) -> Run:
    return integrate(system, step=step, n_steps=3 * STEPS, cycle_steps=STEPS, save=FIELDS)


@cache
def full(name: str, poisson: float = 0.3) -> Run:
    _, system, step = case(name, poisson)
    return cycles(system, step)


@cache
def probe(name: str) -> Run:
    _, system, step = case(name)
    return cycles(system.with_beta(np.inf), step)


def errors(run: Run, reference: Run) -> tuple[float, float]:
    """Largest difference of the history over its peak, relative difference of friction energy."""
    history = np.abs(run.point_u[:, 0] - reference.point_u[:, 0]).max() / reference.peak[0]
    return history, float(run.cycles.friction[-1] / reference.cycles.friction[-1] - 1.0)


def reduced(system: System, basis: PlateBasis, step: float, count: int | None) -> Run:
    few = system.project(basis.V) if count is None else with_friction_points(system, basis, count)
    return cycles(few.with_beta(1e4 / basis.slip_velocity), step)


# Modes of the plate's own run


@pytest.mark.parametrize("snapshots", ["both", "displacement"])
@pytest.mark.parametrize("inner_product", ["energy", "mass", "euclidean"])
def test_own_modes_are_the_best_of_their_number(inner_product: str, snapshots: str) -> None:
    _, system, _ = case("lap")
    run = full("lap")
    options = {"snapshots": snapshots, "inner_product": inner_product}
    basis = own_basis(system, run, 8, **options)
    np.testing.assert_allclose(basis.V.T @ (system.M @ basis.V), np.eye(8), atol=1e-10)
    np.testing.assert_allclose(basis.velocities, run.v @ (system.M @ basis.V), rtol=1e-12)
    modes, values = basis.proper.modes, basis.proper.singular_values
    assert np.all(np.diff(values) <= 0.0)
    if inner_product == "energy":
        return
    G = system.M.toarray() if inner_product == "mass" else np.eye(system.n)
    some = modes[:, :30]
    np.testing.assert_allclose(some.T @ G @ some, np.eye(30), atol=1e-9)
    parts = [run.u[::2]] if snapshots == "displacement" else [run.u[::2], run.v[::2]]
    X = np.vstack([x / np.sqrt(np.sum(x @ G * x)) for x in parts])
    values = values / np.sqrt(np.sum(values**2)) * np.sqrt(len(parts))
    left = X - X @ G @ modes[:, :8] @ modes[:, :8].T  # what eight modes leave out
    assert np.sum(left @ G * left) == pytest.approx(np.sum(values[8:] ** 2), rel=1e-6)


@pytest.mark.parametrize("poisson", [0.0, 0.3])
def test_own_modes_reproduce_the_reference_plate(poisson: float) -> None:
    _, system, step = case("lap", poisson)
    basis = own_basis(system, full("lap", poisson), 12)
    every = reduced(system, basis, step, None)
    history, energy = errors(every, full("lap", poisson))
    assert history < 0.01
    assert abs(energy) < 0.02
    history, energy = errors(reduced(system, basis, step, 36), every)
    assert history < 0.003
    assert abs(energy) < 0.005


@pytest.mark.parametrize(("name", "modes"), [("strip", 12), ("two", 10), ("edge", 12)])
def test_few_points_meet_the_tolerances_of_other_joints(name: str, modes: int) -> None:
    _, system, step = case(name)
    basis = own_basis(system, full(name), modes)
    history, energy = errors(reduced(system, basis, step, 3 * modes), full(name))
    assert history < 0.01
    assert abs(energy) < 0.02


def test_fixed_interface_modes_do_not_slip() -> None:
    _, system, _ = case("strip")
    plain = own_basis(system, full("strip"), 6)
    more = own_basis(system, full("strip"), 6, interface_modes=2)
    assert more.V.shape[1] == 8
    assert np.sin(subspace_angles(more.V, plain.V)).max() < 1e-6  # holds the others
    assert np.linalg.matrix_rank(system.B @ more.V, tol=1e-9 * np.abs(more.V).max()) == 6


def test_modes_need_a_run_that_moves_and_holds_enough_snapshots() -> None:
    _, system, step = case("strip")
    still = integrate(replace(system, loads=()), step=step, n_steps=10, save=FIELDS)
    with pytest.raises(InputError, match="nothing moves"):
        own_basis(system, still, 4)
    with pytest.raises(InputError, match=r"reduction\.modes: found 0, must be from 1"):
        own_basis(system, full("strip"), 0)
    with pytest.raises(InputError, match=r"reduction\.modes: found 999"):
        own_basis(system, full("strip"), 999)
    with pytest.raises(InputError, match="'force', must be one of energy, mass, euclidean"):
        own_basis(system, full("strip"), 4, inner_product="force")


# Merged friction points


def example() -> tuple[System, PlateBasis]:
    _, system, _ = case("lap")
    return system, own_basis(system, full("lap"), 8)


@pytest.mark.parametrize("count", [1, 7, 40])
def test_merged_points_carry_the_same_total_and_are_means(count: int) -> None:
    system, basis = example()
    reduced = system.project(basis.V)
    few, owner = with_merged_points(reduced, basis.velocities, basis.active, count)
    assert 0.8 * count <= few.w.size <= count
    assert np.all(few.w > 0.0)
    assert few.w.sum() == pytest.approx(system.w[basis.active].sum(), rel=1e-12)
    assert np.array_equal(np.flatnonzero(owner >= 0), basis.active)
    rows = reduced.B.reshape(-1, 2, reduced.n)
    for k in range(few.w.size):
        mine = owner == k
        assert few.w[k] == pytest.approx(system.w[mine].sum(), rel=1e-12)
        mean = np.average(rows[mine], axis=0, weights=system.w[mine])
        np.testing.assert_allclose(few.B[2 * k : 2 * k + 2], mean, atol=1e-12)


def test_merging_only_lowers_the_friction_potential() -> None:
    system, basis = example()
    every = system.project(basis.V)
    few, _ = with_merged_points(every, basis.velocities, np.arange(system.w.size), 20)
    for q in basis.velocities[1:301:30]:
        potential = [s.w @ friction.potential(s.slip_norm(s.B @ q), s.beta) for s in (few, every)]
        assert 0.9 * potential[1] < potential[0] <= potential[1]


def test_as_many_points_as_slip_leave_the_model_as_it_is() -> None:
    _, system, step = case("strip")
    basis = own_basis(system, full("strip"), 5)
    every = np.arange(system.w.size)
    reduced = system.project(basis.V)
    same, owner = with_merged_points(reduced, basis.velocities, every, every.size)
    assert np.array_equal(np.sort(owner), every)
    one, other = cycles(reduced, step), cycles(same, step)
    np.testing.assert_allclose(other.point_u, one.point_u, atol=1e-9 * one.peak[0])
    np.testing.assert_allclose(other.friction_work[owner], one.friction_work, rtol=1e-6)


def test_points_of_other_laws_are_not_merged() -> None:
    system, basis = example()
    beta = np.where(np.arange(system.w.size) % 2 == 0, 1e3, 1e5)
    reduced = replace(system.project(basis.V), beta=beta)
    few, owner = with_merged_points(reduced, basis.velocities, basis.active, 12)
    assert np.array_equal(few.beta[owner[basis.active]], beta[basis.active])
    assert set(few.beta) == {1e3, 1e5}


def test_turned_slip_directions_give_turned_points() -> None:
    system, basis = example()
    reduced = system.project(basis.V)
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    other = replace(reduced, B=(turn @ reduced.B.reshape(-1, 2, 8)).reshape(-1, 8))
    few, owner = with_merged_points(reduced, basis.velocities, basis.active, 9)
    turned, turned_owner = with_merged_points(other, basis.velocities, basis.active, 9)
    assert np.array_equal(owner, turned_owner)
    np.testing.assert_allclose(turned.B.reshape(-1, 2, 8), turn @ few.B.reshape(-1, 2, 8))


def test_no_point_to_keep_leaves_none() -> None:
    system, basis = example()
    none, owner = with_merged_points(system.project(basis.V), basis.velocities, basis.active[:0], 5)
    assert none.w.size == 0
    assert none.B.shape == (0, 8)
    assert np.all(owner == -1)


def test_no_points_are_refused() -> None:
    system, basis = example()
    with pytest.raises(InputError, match="found 0, must be >= 1"):
        with_friction_points(system, basis, 0)


def test_partition_finds_what_is_apart() -> None:
    generator = np.random.default_rng(0)
    truth = generator.integers(0, 5, 200)
    centres = 10.0 * np.eye(5)
    x = centres[truth] + 0.1 * generator.standard_normal((200, 5))
    label = partition(x, generator.uniform(0.1, 1.0, 200), 5)
    assert np.unique(np.stack([truth, label]), axis=1).shape[1] == 5
    assert partition(x[:3], np.ones(3), 3).tolist() in ([0, 1, 2], *map(list, PERMUTATIONS))
    assert np.array_equal(partition(np.zeros((4, 2)), np.ones(4), 3), np.zeros(4))


PERMUTATIONS = [(0, 2, 1), (1, 0, 2), (1, 2, 0), (2, 0, 1), (2, 1, 0)]


# Scaled modes


def scaled(name: str, modes: int, **options: Any) -> PlateBasis:
    structure, system, _ = case(name)
    reference = paper_reference()
    return scaled_basis(structure, system, reference, AXIS, probe(name), modes=modes, **options)


@pytest.mark.parametrize(
    ("name", "modes", "history", "energy"),
    [("lap", 9, 0.01, 0.03), ("strip", 7, 0.005, 0.06), ("two", 5, 0.005, 0.02)],
)
def test_scaled_modes_follow_the_full_model(
    name: str, modes: int, history: float, energy: float
) -> None:
    _, system, step = case(name)
    basis = scaled(name, modes)
    j = basis.V.shape[1]
    np.testing.assert_allclose(basis.V.T @ (system.M @ basis.V), np.eye(j), atol=1e-10)
    found = errors(reduced(system, basis, step, 4 * modes), full(name))
    assert found[0] < history
    assert abs(found[1]) < energy


@pytest.mark.parametrize("name", ["lap", "strip", "two", "edge"])
def test_nothing_slips_beyond_the_active_length(name: str) -> None:
    structure, system, _ = case(name)
    basis = scaled(name, 5)
    length = basis.active_length["joint"]
    patch = structure.patches[0]
    along = structure.nodes[patch.nodes, 0]
    distance = along.max() - along
    if name == "two":  # slips from both ends alike
        distance, length = np.minimum(distance, along - along.min()), 0.5 * length
    slip = system.slip_norm((system.B @ basis.V).T)[:, patch.points]
    assert np.abs(slip[:, distance >= length]).max() < 1e-12 * slip.max()
    assert np.array_equal(np.sort(basis.active), np.sort(patch.points[distance < length]))
    spacing = np.diff(np.unique(along.round(9))).max()
    peak = probe(name).slip_peak[patch.points]
    farthest = distance[peak > 1e-3 * peak.max()].max()
    assert farthest < length <= farthest + 1.001 * spacing


def test_axis_of_any_length_and_sense_is_the_same() -> None:
    structure, system, _ = case("strip")
    one = scaled("strip", 5).V
    axis = {"joint": np.array([-3.0, 0.0])}
    other = scaled_basis(structure, system, paper_reference(), axis, probe("strip")).V
    assert np.sin(subspace_angles(one, other)).max() < 1e-6


def test_turned_plate_has_the_same_reduced_model() -> None:
    structure, system, _ = case("strip")
    turn = np.array([[0.8, -0.6], [0.6, 0.8]])
    plate = replace(structure.plate, mesh=replace(structure.plate.mesh, doflocs=turn @
                    structure.plate.mesh.doflocs))  # fmt: skip
    turned = structure_of(plate, structure.joints[0], 0.3, "left")
    load = ("right", tuple(turn[:, 0]), system.loads[0].amplitude)
    other = assemble_plate(turned, [load], [])
    axis = {"joint": turn[:, 0]}
    basis = scaled_basis(turned, other, paper_reference(), axis, probe("strip"))
    values = [
        eigh(s.K, eigvals_only=True)
        for s in (system.project(scaled("strip", 5).V), other.project(basis.V))
    ]
    np.testing.assert_allclose(values[1], values[0], rtol=1e-6)
    assert basis.active_length["joint"] == pytest.approx(scaled("strip", 5).active_length["joint"])


def test_active_length_may_be_given() -> None:
    assert scaled("strip", 3, lengths={"joint": 0.04}).active_length == {"joint": 0.04}
    with pytest.raises(InputError, match=r"'joint': found 0\.2 m, must be above 0 and at most"):
        scaled("strip", 3, lengths={"joint": 0.2})


def test_joints_without_axis_or_slip_are_refused() -> None:
    structure, system, _ = case("strip")
    with pytest.raises(InputError, match="'joint': no axis is named"):
        scaled_basis(structure, system, paper_reference(), {}, probe("strip"))
    still = replace(probe("strip"), slip_peak=np.zeros(system.w.size))
    with pytest.raises(InputError, match="nothing slips"):
        scaled_basis(structure, system, paper_reference(), AXIS, still)


# Active area


def test_active_area_counts_the_area_of_slipping_points() -> None:
    structure, system, _ = case("lap")
    patch = structure.patches[0]
    x = structure.nodes[patch.nodes, 0]
    peak = np.zeros(system.w.size)
    assert active_area_fraction(structure, system, peak, 0.0) == {"joint": 0.0}
    peak[patch.points] = np.where(x > 0.125, 1e-4, 1e-8)
    # Nodes right of the middle: 19 whole columns and half a one, of 40.
    found = active_area_fraction(structure, system, peak, 0.0)["joint"]
    assert found == pytest.approx(19.5 / 40.0, rel=1e-12)
    peak[patch.points] = 1.0
    held = active_area_fraction(structure, system, peak, 0.0)["joint"]
    assert held == pytest.approx(39.5 / 40.0, rel=1e-12)


def test_creep_of_points_that_stick_is_no_slip() -> None:
    """Under the arctan law a point at half of its limit creeps by period / beta."""
    structure, system, _ = case("lap")
    period, beta = 1e-3, float(system.beta[0])
    creep = np.full(system.w.size, 0.9 * period / beta)
    assert not slips(structure, system, creep, period).any()
    assert slips(structure, system, creep, 0.0).all()
    assert slips(structure, system.with_beta(np.inf), creep, period).all()
