"""Active zones of structures, and bases made of scaled modes and the linear regions' response."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from bars import CASE_I, EA, Harmonic, LapJoint, bar_structure
from scipy import linalg

from skfem_joint.errors import InputError
from skfem_joint.loads import Load
from skfem_joint.meshing import build_bar
from skfem_joint.paper.cases import CASES, study
from skfem_joint.reduction import (
    ReferenceModes,
    active_zones,
    estimate_active_length,
    interface_modes_needed,
    reference_modes,
    snapshot_matrix,
    structure_basis,
)
from skfem_joint.reference import paper_reference
from skfem_joint.structure import Joint, Structure, assemble
from skfem_joint.system import System

TAU = 0.7 * 50e6 * 0.05  # N/m


@pytest.fixture(scope="module")
def reference() -> ReferenceModes:
    return paper_reference()


def model(
    regions: Sequence[tuple[str, float, int]],
    joints: Sequence[str],
    loads: Sequence[tuple[str, Load]],
    fixed: Sequence[str] = ("start",),
) -> tuple[Structure, System]:
    """Bar with points ``start``, ``end`` and one at the end of each region, ``after <region>``."""
    ends = np.cumsum([length for _, length, _ in regions])
    points = {"start": 0.0, "end": float(ends[-1])}
    points |= {
        f"after {name}": float(x) for (name, _, _), x in zip(regions[:-1], ends[:-1], strict=True)
    }
    structure = bar_structure(
        build_bar(regions, points), [Joint(name, 50e6, 0.7) for name in joints], fixed=list(fixed)
    )
    return structure, assemble(structure, loads)


def fig_18(frequency: float = 500.0) -> tuple[Structure, System]:
    return model(
        [("joint", 0.1, 100), ("linear", 0.5, 100)],
        ["joint"],
        [("end", Harmonic(87.5e3, frequency))],
    )


def linear_unknowns(structure: Structure) -> np.ndarray:
    in_joints = [structure.bar.region_nodes(joint.region) for joint in structure.joints]
    return np.flatnonzero(~np.isin(structure.free, np.concatenate(in_joints)))


def test_lap_joint_has_one_zone_at_its_loaded_end() -> None:
    joint = LapJoint()
    (zone,) = active_zones(joint.structure, joint.system)
    assert zone.nodes.tolist() == list(range(100, -1, -1))
    assert zone.distance == pytest.approx(0.25 - joint.structure.position[::-1], abs=1e-15)
    assert zone.length == pytest.approx(0.25, rel=1e-14)
    assert zone.tau == pytest.approx(joint.tau, rel=1e-13)


def test_structure_of_fig_18_has_one_zone_at_the_junction() -> None:
    (zone,) = active_zones(*fig_18())
    assert zone.name == "joint"
    assert zone.nodes[0] == 100
    assert zone.length == pytest.approx(0.1, rel=1e-14)
    assert zone.tau == pytest.approx(TAU, rel=1e-13)


def test_joints_at_both_ends_of_a_bar_loaded_in_its_middle_have_a_zone_each() -> None:
    structure, system = model(
        [("left", 0.1, 10), ("a", 0.2, 20), ("b", 0.2, 20), ("right", 0.1, 10)],
        ["left", "right"],
        [("after a", Harmonic(1e5, 500.0))],
        fixed=["start", "end"],
    )
    zones = active_zones(structure, system)
    assert [(zone.name, int(zone.nodes[0]), int(zone.nodes[-1])) for zone in zones] == [
        ("left", 10, 0),
        ("right", 50, 60),
    ]


def test_inner_joint_has_a_zone_at_each_end() -> None:
    structure, system = model(
        [("a", 0.2, 20), ("joint", 0.1, 10), ("b", 0.2, 20)],
        ["joint"],
        [("end", Harmonic(1e5, 500.0))],
    )
    zones = active_zones(structure, system)
    assert [(zone.name, zone.nodes[0], zone.nodes[-1]) for zone in zones] == [
        ("joint", 20, 30),
        ("joint", 30, 20),
    ]


def test_one_joint_in_two_parts_has_a_zone_at_each_mouth() -> None:
    structure, system = model(
        [("joint", 0.1, 10), ("a", 0.2, 20), ("joint", 0.1, 10)],
        ["joint"],
        [("after a", Harmonic(1e5, 500.0))],
    )
    # The last part ends the bar where nothing pulls: force enters at its first end alone.
    assert [int(zone.nodes[0]) for zone in active_zones(structure, system)] == [10, 30]


def test_load_inside_a_joint_is_refused() -> None:
    regions = [("joint", 0.1, 10), ("linear", 0.2, 10)]
    structure, system = model(regions, ["joint"], [("joint", Harmonic(1e5, 500.0))])
    with pytest.raises(InputError, match="'joint': a load acts inside it"):
        active_zones(structure, system)


def test_touching_joints_are_refused() -> None:
    structure, system = model(
        [("one", 0.1, 10), ("two", 0.1, 10)], ["one", "two"], [("end", Harmonic(1e5, 500.0))]
    )
    with pytest.raises(InputError, match="'one' touches another joint"):
        active_zones(structure, system)


def test_basis_is_mass_orthonormal_and_zero_in_the_grey_length(reference: ReferenceModes) -> None:
    structure, system = fig_18()
    V = structure_basis(structure, system, reference, active_zones(structure, system), [0.0525])
    assert V.shape == (system.n, 5 + 1 + 2)
    assert np.allclose(V.T @ (system.M @ V), np.eye(8), rtol=0.0, atol=1e-11)
    grey = structure.position[structure.free] <= 0.1 - 0.0525
    assert np.count_nonzero(grey) == 47
    assert not np.any(V[grey])


def test_linear_region_follows_a_single_mouth_rigidly(reference: ReferenceModes) -> None:
    structure, system = fig_18()
    unloaded = replace(system, loads=())
    zones = active_zones(structure, system)
    V = structure_basis(structure, unloaded, reference, zones, [0.05], interface_modes=0)
    assert V.shape == (system.n, 5)
    mouth = 99  # unknown of node 100
    assert np.allclose(V[mouth + 1 :], V[mouth], rtol=0.0, atol=1e-11 * np.abs(V).max())


def test_linear_region_between_two_mouths_follows_linearly(reference: ReferenceModes) -> None:
    structure, system = model(
        [("left", 0.1, 20), ("middle", 0.3, 30), ("right", 0.1, 20)],
        ["left", "right"],
        [("middle", Harmonic(1e5, 500.0))],
        fixed=["start", "end"],
    )
    zones = active_zones(structure, system)
    unloaded = replace(system, loads=())
    V = structure_basis(structure, unloaded, reference, zones, [0.05, 0.05], interface_modes=0)
    assert V.shape == (system.n, 10)
    middle = V[19:50]
    share = np.linspace(0.0, 1.0, 31)[:, np.newaxis]
    straight = (1.0 - share) * middle[0] + share * middle[-1]
    assert np.allclose(middle, straight, rtol=0.0, atol=1e-10 * np.abs(V).max())


@pytest.mark.parametrize("on", ["end", "linear"])
def test_static_response_with_a_stuck_joint_is_exact(on: str, reference: ReferenceModes) -> None:
    structure, _ = fig_18()
    system = assemble(structure, [(on, Harmonic(87.5e3, 500.0))])
    zones = active_zones(structure, system)
    V = structure_basis(structure, system, reference, zones, [0.05], interface_modes=0)
    linear = linear_unknowns(structure)
    stuck = np.setdiff1d(np.arange(system.n), linear)
    free = V @ linalg.null_space(V[stuck])  # what the basis can do without slip
    reduced = system.project(free)
    f = reduced.load_vectors()[:, 0]
    tip = (free @ np.linalg.solve(reduced.K, f))[-1]
    # A force at the end stretches the whole region; spread evenly, half as much on average.
    assert tip == pytest.approx({"end": 1.0, "linear": 0.5}[on] * 0.5 / EA, rel=1e-10)


def test_reduced_frequencies_bound_those_of_the_full_structure(reference: ReferenceModes) -> None:
    structure, system = fig_18()
    zones = active_zones(structure, system)
    full = linalg.eigh(
        system.K.toarray(), system.M.toarray(), eigvals_only=True, subset_by_index=[0, 1]
    )
    errors = []
    for count in (1, 2, 4):
        V = structure_basis(structure, system, reference, zones, [0.1], interface_modes=count)
        reduced = linalg.eigvalsh(system.project(V).K)[:2]
        assert np.all(reduced >= full * (1.0 - 1e-9))
        errors.append(np.sqrt(reduced / full) - 1.0)
    assert np.all(np.diff(errors, axis=0) <= 1e-12)
    assert np.all(errors[-1] < 5e-3)


@pytest.mark.parametrize("length", [0.0, -0.01, 0.1001, np.nan])
def test_active_length_outside_the_joint_is_refused(
    length: float, reference: ReferenceModes
) -> None:
    structure, system = fig_18()
    with pytest.raises(InputError, match="active length of joint 'joint'"):
        structure_basis(structure, system, reference, active_zones(structure, system), [length])


@pytest.mark.parametrize("modes", [0, 101])
def test_modes_that_the_reference_does_not_have_are_refused(
    modes: int, reference: ReferenceModes
) -> None:
    structure, system = fig_18()
    zones = active_zones(structure, system)
    with pytest.raises(InputError, match="must be from 1 to 100"):
        structure_basis(structure, system, reference, zones, [0.05], modes=modes)


def test_interface_modes_are_those_below_twice_the_highest_frequency() -> None:
    structure, system = fig_18()
    # Clamped at the junction, 0.5 m of bar: 2.5, 7.5, 12.5, 17.5 kHz.
    counts = [interface_modes_needed(structure, system, f) for f in (500.0, 4e3, 6.3e3, 8.8e3)]
    assert counts == [2, 2, 3, 4]
    assert interface_modes_needed(structure, system, None) == 4
    assert interface_modes_needed(CASE_I.structure, CASE_I.system, 2e3) == 0


def test_isolated_joint_reproduces_the_factors_of_figure_6() -> None:
    structure, system = CASE_I.structure, CASE_I.system
    (zone,) = active_zones(structure, system)
    found = estimate_active_length(structure, system, zone, [CASE_I.force], 2000.0)
    assert round(found.factors[0], 3) == 1.162
    assert round(found.factor, 2) == 1.30
    assert found.converged
    assert found.length == pytest.approx(0.325, rel=1e-3)


def test_isolated_joint_near_resonance_does_not_settle() -> None:
    structure, system = CASE_I.structure, CASE_I.system
    (zone,) = active_zones(structure, system)
    for frequency in (3000.0, 4000.0):  # 0.25 m of active bar alone resonate at 5 kHz
        found = estimate_active_length(structure, system, zone, [CASE_I.force], frequency)
        assert not found.converged


def test_structure_of_fig_18_starts_from_the_factor_of_the_paper() -> None:
    structure, system = fig_18()
    (zone,) = active_zones(structure, system)
    found = estimate_active_length(structure, system, zone, [87.5e3], 500.0)
    assert round(found.factors[0], 3) == 1.045  # printed: 1.05
    assert found.converged
    assert found.length == pytest.approx(1.045 * 87.5e3 / TAU, rel=5e-4)


def test_structure_at_resonance_is_reported_by_its_frequency_ratio() -> None:
    structure, system = fig_18()
    (zone,) = active_zones(structure, system)
    # c / (4 * 0.6 m) = 2083 Hz with the whole joint active.
    below, above = (
        estimate_active_length(structure, system, zone, [87.5e3], f) for f in (1500.0, 2100.0)
    )
    assert below.converged
    assert below.frequency_ratio < 0.75
    assert above.frequency_ratio == pytest.approx(2100.0 / (5000.0 / 2.4), rel=2e-3)
    assert above.length > zone.length  # to be capped by who uses it


def test_static_length_is_the_force_over_tau_wherever_the_load_acts() -> None:
    structure, _ = fig_18()
    for on, slow in (("end", 1.0), ("linear", 1.0), ("after joint", 1.0)):
        system = assemble(structure, [(on, Harmonic(60e3, slow))])
        (zone,) = active_zones(structure, system)
        found = estimate_active_length(structure, system, zone, [60e3], slow)
        assert found.length == pytest.approx(60e3 / TAU, rel=1e-4)


def test_amplitudes_of_several_loads_are_superposed() -> None:
    structure, _ = fig_18()
    loads = [("end", Harmonic(20e3, 1.0)), ("after joint", Harmonic(-30e3, 1.0))]
    system = assemble(structure, loads)
    (zone,) = active_zones(structure, system)
    found = estimate_active_length(structure, system, zone, [20e3, -30e3], 1.0)
    assert found.length == pytest.approx(50e3 / TAU, rel=1e-4)


def test_snapshots_of_both_kinds_weigh_alike() -> None:
    u, v = np.random.default_rng(1).normal(size=(2, 30, 4))
    both = snapshot_matrix(1e-4 * u, 7.0 * v, "both")
    assert both.shape == (60, 4)
    assert np.linalg.norm(both[:30]) == pytest.approx(1.0, rel=1e-14)
    assert np.linalg.norm(both[30:]) == pytest.approx(1.0, rel=1e-14)
    assert np.array_equal(snapshot_matrix(u, v, "displacement"), u)
    with pytest.raises(InputError, match="snapshots: found 'velocity'"):
        snapshot_matrix(u, v, "velocity")


def test_snapshots_of_rates_have_no_units_and_weigh_instants_by_roots() -> None:
    v = np.random.default_rng(1).normal(size=(30, 4)) * np.geomspace(1.0, 1e-3, 30)[:, np.newaxis]
    rates = snapshot_matrix(v, v, "rates")
    assert rates.shape == (59, 4)
    np.testing.assert_allclose(snapshot_matrix(v, 7.0 * v, "rates"), rates, rtol=1e-12)
    size = np.linalg.norm(v, axis=1)
    expected = np.sqrt(size / size.max())
    np.testing.assert_allclose(np.linalg.norm(rates[:30], axis=1), expected, rtol=1e-12)


def test_five_modes_of_rates_dissipate_nearly_what_the_reference_system_does() -> None:
    """Within 2 %, where five modes of displacement and velocity leave twice as much."""

    def friction_error(snapshots: str) -> float:
        options = {"snapshots": snapshots, "friction_points": "all"}
        time = {"cycles": 3, "steps_per_cycle": 200}
        both = study(CASES["reference"], run=("full", "reduced"), reduction=options, time=time)
        errors = both.models["reduced"].errors
        assert errors is not None
        assert errors.friction_energy_per_cycle is not None
        return abs(errors.friction_energy_per_cycle)

    assert friction_error("rates") < 0.02
    assert friction_error("both") > 0.03


def test_modes_keep_their_shape_on_the_unit_active_length(reference: ReferenceModes) -> None:
    at_nodes = reference.at(reference.xi, 5)
    active = reference.xi > 0.0
    assert np.allclose(at_nodes[active], reference.modes[active, :5], rtol=0.0, atol=1e-13)
    assert not np.any(at_nodes[~active])
    assert reference.xi[-1] == pytest.approx(1.0, abs=1e-15)


def test_modes_do_not_depend_on_the_order_of_the_nodes() -> None:
    generator = np.random.default_rng(2)
    distance = np.linspace(0.0, 1.0, 20)
    u = generator.normal(size=(50, 1)) * np.exp(-5.0 * distance)
    u += 0.1 * generator.normal(size=(50, 1)) * np.exp(-9.0 * distance)
    peak = np.abs(u).max(axis=0)
    shuffled = generator.permutation(20)
    one = reference_modes(distance, u, u, peak, snapshots="displacement")
    other = reference_modes(
        distance[shuffled], u[:, shuffled], u, peak[shuffled], snapshots="displacement"
    )
    assert one.xi == pytest.approx(other.xi, abs=1e-14)
    assert np.allclose(np.abs(one.modes[:, :2]), np.abs(other.modes[:, :2]), atol=1e-12)
