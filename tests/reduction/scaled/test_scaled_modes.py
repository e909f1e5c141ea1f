"""The paper's reference modes, and bases that carry them into structures of any dimension."""

from functools import cache
from typing import Any

import numpy as np
import pytest
from bodies import EA
from reduced_joints import SPEED, STEPS, bar, case, case_i, errors, fig_18, full, three_periods
from scipy import linalg

import skfem_joint as sj
from skfem_joint.reduction.basis import Options
from skfem_joint.reduction.models import reduced_on
from skfem_joint.reduction.scaled.basis import ScaledBasis, paper_basis, scaled_basis
from skfem_joint.reduction.scaled.reference import (
    ReferenceModes,
    lap_joint,
    modes_of_lap_joint,
    paper_reference,
    run_lap_joint,
)
from skfem_joint.reduction.scaled.zones import active_zones, probed, zone_lengths
from skfem_joint.runs.integrate import integrate_plan
from skfem_joint.stepping.plan import Plan

# The reference system


def assurance(one: ReferenceModes, other: ReferenceModes, count: int) -> np.ndarray:
    """Modal assurance criterion of modes on the unit active length."""
    xi = np.linspace(0.0, 1.0, 400)
    a, b = one.at(xi, count), other.at(xi, count)
    alike = np.einsum("ij,ij->j", a, b) ** 2
    return np.asarray(alike / np.einsum("ij,ij->j", a, a) / np.einsum("ij,ij->j", b, b))


def test_modes_of_another_load_and_frequency_resemble_the_reference_s():
    # 28 kN at 100 Hz: half the active length, hardly any inertia (sections 4 and 5).
    reference = paper_reference(snapshots="displacement")
    structure = lap_joint()
    run = run_lap_joint(structure, 28e3, 100.0)
    other = modes_of_lap_joint(structure, run, snapshots="displacement")
    assert other.active_length < 0.5 * reference.active_length
    alike = assurance(reference, other, 5)
    assert np.all(alike[:3] > [0.99, 0.97, 0.90])
    assert np.all(alike[3:] > 0.75)
    # On the bar itself, without scaling to the active length, the first already differs more.
    unscaled = (reference.proper.modes[:, 0] @ other.proper.modes[:, 0]) ** 2
    assert unscaled < alike[0]


def test_modes_keep_their_shape_on_the_unit_active_length():
    reference = paper_reference()
    at_nodes, active = reference.at(reference.xi, 5), reference.xi > 0.0
    assert np.allclose(at_nodes[active], reference.modes[active, :5], rtol=0.0, atol=1e-13)
    assert not np.any(at_nodes[~active])
    for modes in (0, 101):
        with pytest.raises(sj.InputError, match="must be from 1 to 100"):
            reference.at(reference.xi, modes)


def scaled(
    structure: sj.Structure, system: sj.System, length: object = "auto", **options: Any
) -> ScaledBasis:
    """Basis of scaled modes; the probe takes two periods of 500 Hz."""
    zones = active_zones(structure, system)
    probe = probed(system, zones, Plan(1e-5, 400))
    lengths, _ = zone_lengths(system, zones, length, probe.slip_peak)
    found = structure, system, paper_reference(), zones, lengths, probe
    return scaled_basis(*found, Options(reference="paper", **options))


def test_linear_region_between_two_loaded_ends_follows_linearly():
    regions = [("left", 0.1, 20), ("middle", 0.3, 30), ("right", 0.1, 20)]
    loads = [("middle", sj.Harmonic(1e5, 500.0))]
    structure, system = bar(regions, ["left", "right"], loads, fixed=["start", "end"])
    basis = scaled(structure, system, 0.05, interface_modes=0)
    V = structure.expand(basis.V[:, :10].T)[..., 0].T

    share = np.linspace(0.0, 1.0, 31)[:, np.newaxis]
    straight = (1.0 - share) * V[20] + share * V[50]
    assert np.allclose(V[20:51], straight, rtol=0.0, atol=1e-10 * np.abs(V).max())


@pytest.mark.parametrize("on", ["end", "linear"])
def test_static_response_with_a_stuck_joint_is_exact(on):
    structure, system = fig_18(on=on)
    V = scaled(structure, system, 0.05, interface_modes=0).V
    free = V @ linalg.null_space(system.contact.B @ V)  # what the basis can do without slip
    reduced = system.project(free)
    force = reduced.load_vectors()[:, 0]
    tip = structure.expand((free @ np.linalg.solve(reduced.K, force))[np.newaxis])[0, -1, 0]
    # A force at the end stretches the whole region; spread evenly, half as much on average.
    assert tip == pytest.approx({"end": 1.0, "linear": 0.5}[on] * 0.5 / EA, rel=1e-10)


def test_reduced_frequencies_bound_those_of_the_full_structure():
    structure, system = fig_18()
    exact = linalg.eigh(
        system.K.toarray(), system.M.toarray(), eigvals_only=True, subset_by_index=[0, 1]
    )
    excess = []
    for count in (1, 2, 4):
        V = scaled(structure, system, 0.1, interface_modes=count).V
        found = linalg.eigvalsh(system.project(V).K)[:2]
        assert np.all(found >= exact * (1.0 - 1e-9))
        excess.append(np.sqrt(found / exact) - 1.0)
    assert np.all(np.diff(excess, axis=0) <= 1e-12)
    assert np.all(excess[-1] < 5e-3)


def test_interface_modes_are_those_below_twice_the_highest_frequency():
    # Clamped at the junction, 0.5 m of bar: 2.5, 7.5, 12.5, 17.5 kHz.
    structure, _ = fig_18()
    for frequency, count in ((500.0, 2), (4e3, 2), (6.3e3, 3), (8.8e3, 4)):
        both = sj.MultiHarmonic((sj.Harmonic(8e4, 500.0), sj.Harmonic(1.0, frequency)))
        system = structure.system([sj.Load("end", both)])
        assert scaled(structure, system, 0.05).V.shape[1] == 5 + 1 + count
    unknown = structure.system([sj.Load("end", lambda t: 8e4 * np.sin(3e3 * t) ** 2)])
    assert scaled(structure, unknown, 0.05).V.shape[1] == 5 + 1 + 4
    assert scaled(*case_i(), 0.3).V.shape[1] == 5  # nothing is out of contact


def test_interface_modes_that_take_no_part_are_left_out():
    """Of a strip on its foot a pull excites what lengthens it, not what bends it."""
    structure, system, _ = case("strip")
    V = scaled(structure, system, 0.05, interface_modes=2).V
    nodes = structure.expand(V.T)
    x = structure.nodes
    axis = np.abs(x[:, 1] - 0.025) < 1e-9
    assert np.abs(nodes[:, axis, 1]).max() < 1e-9 * np.abs(nodes).max()
    # Longitudinal vibration of the arm alone, clamped: 0.5 m.
    frequency = np.sqrt(linalg.eigvalsh(system.project(V).K)) / (2.0 * np.pi)
    assert frequency[0] < SPEED / (4 * 0.5) < frequency[-1]


def test_probe_takes_the_steps_that_the_fastest_load_needs_at_most_the_run_s_own():
    structure, _ = fig_18()

    def steps(loads, cycle_steps, period):
        system = structure.system(loads)
        zones = active_zones(structure, system)
        plan = Plan(period / cycle_steps, 2 * cycle_steps, cycle_steps=cycle_steps)
        run = probed(system, zones, plan)
        return run.counters.steps // 2

    slow = sj.Load("end", sj.Harmonic(6e4, 200.0))
    assert steps([slow], 400, 5e-3) == 100
    assert steps([slow], 64, 5e-3) == 64
    fast = sj.Load("end", sj.Harmonic(2e4, 2600.0))  # 13 times as fast
    assert steps([slow, fast], 400, 5e-3) == 260
    assert steps([slow, fast], 120, 5e-3) == 120
    jump = sj.Load("end", sj.Harmonic(6e4, 20.0, np.pi / 2))  # sets off a vibration
    assert 100 < steps([jump], 4000, 0.05) < 4000


def test_five_modes_of_rates_dissipate_nearly_what_the_reference_system_does():
    """Within 2 %, where five modes of displacement and velocity leave twice as much."""
    structure = lap_joint()
    run = run_lap_joint(structure)

    def friction_error(snapshots):
        options = Options(reference="paper", snapshots=snapshots)
        plan = Plan(5e-6, 600, cycle_steps=200)
        basis = paper_basis(structure, run.system, options, plan)
        small = reduced_on(run.system, basis, friction_points="all")
        energy = integrate_plan(small, plan).cycles.friction[-1]
        return abs(energy / run.cycles.friction[-1] - 1.0)

    assert friction_error("rates") < 0.02
    assert friction_error("both") > 0.03


@cache
def scaled_case(name: str, modes: int, **options: Any) -> ScaledBasis:
    structure, system, step = case(name)
    settings = Options(reference="paper", modes=modes, **options)
    return paper_basis(structure, system, settings, Plan(step, 3 * STEPS, cycle_steps=STEPS))


@pytest.mark.parametrize(
    ("name", "modes", "history", "energy"),
    [("lap", 9, 0.01, 0.03), ("strip", 7, 0.005, 0.06), ("two", 5, 0.005, 0.02)],
)
def test_scaled_modes_follow_the_full_model(name, modes, history, energy):
    _, system, step = case(name)
    basis = scaled_case(name, modes)
    j = basis.V.shape[1]
    np.testing.assert_allclose(basis.V.T @ (system.M @ basis.V), np.eye(j), atol=1e-10)
    assert basis.lines is None
    small = reduced_on(system, basis, friction_points=4 * modes)
    found = errors(three_periods(small, step), full(name))
    assert found[0] < history
    assert abs(found[1]) < energy


@pytest.mark.parametrize("name", ["lap", "strip", "two", "edge"])
def test_nothing_slips_beyond_the_active_length(name):
    structure, system, _ = case(name)
    basis = scaled_case(name, 5)
    length = basis.active_length["joint"]
    patch = structure.patches[0]
    along = structure.nodes[patch.nodes, 0]
    distance = along.max() - along
    if name == "two":  # slips from both ends alike
        distance, length = np.minimum(distance, along - along.min()), 0.5 * length
    slip = system.contact.slip_norm((system.contact.B @ basis.V).T)[:, patch.points]
    assert np.abs(slip[:, distance >= length]).max() < 1e-12 * slip.max()
    assert np.array_equal(np.sort(basis.history.active), np.sort(patch.points[distance < length]))
    spacing = np.diff(np.unique(along.round(9))).max()
    peak = basis.history.slip_peak[patch.points]
    farthest = distance[peak > 1e-3 * peak.max()].max()
    assert farthest < length <= farthest + 1.001 * spacing


def test_slip_along_an_edge_is_a_line_of_gauss_points():
    _, system, step = case("edge")
    basis = scaled_case("edge", 5)
    assert basis.lines is not None
    every, few = (
        three_periods(reduced_on(system, basis, friction_points=k, beta=1e4), step)
        for k in ("all", 2)
    )
    assert few.system.contact.w.size == 2 < basis.history.active.size
    history, energy = errors(few, every)
    assert history < 0.01
    assert abs(energy) < 0.06
