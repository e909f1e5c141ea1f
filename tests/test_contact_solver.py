"""The contact solver and its stepper: minimisers, symmetries, balances, and other steppers."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from bars import LapJoint
from plates import ELEMENTS, lap_plates, plate_structure, pressed, turned
from scipy import sparse

from skfem_joint import friction, steppers, steppers_contact
from skfem_joint.checkpoint import Checkpoint
from skfem_joint.contact_solver import ContactProblem
from skfem_joint.integrate import integrate
from skfem_joint.loads import Harmonic, Rectangle
from skfem_joint.plate import PlateStructure, assemble_plate
from skfem_joint.plate_mesh import build_plate, merged
from skfem_joint.recording import Run, Save
from skfem_joint.schemes import generalized_alpha
from skfem_joint.system import System

LAWS = [1e3, 1e5, 1e9, np.inf]


def problem(
    beta: float, dense: bool, seed: int = 0, condition: float = 1e4
) -> tuple[ContactProblem, np.ndarray, Any]:
    """Random problem of points with one, two and no directions of slip, some without friction."""
    random = np.random.default_rng(seed)
    n = 40
    Q = np.linalg.qr(random.normal(size=(n, n)))[0]
    A = (Q * np.geomspace(1.0, condition, n)) @ Q.T
    A = 0.5 * (A + A.T)
    order = random.permutation(n)
    first, second = np.sort(order[:20]), np.full(20, -1)
    second[:12] = order[20:32]
    w = random.uniform(0.0, 30.0, 20)
    w[::7] = 0.0
    made = ContactProblem(A if dense else sparse.csr_array(A), first, second, w, np.full(20, beta))
    g = random.normal(size=n) * 30.0
    return made, g, (A, first, second, w)


@pytest.mark.parametrize("beta", LAWS)
@pytest.mark.parametrize("dense", [True, False])
@pytest.mark.parametrize("seed", range(5))
def test_the_solution_balances_all_forces_on_the_graph_of_the_law(
    beta: float, dense: bool, seed: int
) -> None:
    made, g, (A, first, second, w) = problem(beta, dense, seed)
    found = made.solve(g, np.zeros_like(g), 1e-11)
    assert found.converged
    force = np.zeros_like(g)
    for p, (i, j) in enumerate(zip(first, second, strict=True)):
        rows = [i] if j < 0 else [i, j]
        speed, size = np.linalg.norm(found.v[rows]), np.linalg.norm(found.sigma[rows])
        if w[p] == 0.0:
            assert size == 0.0
            continue
        force[rows] = w[p] * found.sigma[rows]
        if np.isinf(beta):
            assert size <= 1.0 + 1e-12
            assert speed == 0.0 or size == pytest.approx(1.0, rel=1e-12)
        else:
            assert size == pytest.approx(float(friction.force(speed, beta)), rel=1e-9)
        if speed > 0.0:
            np.testing.assert_allclose(
                found.sigma[rows] * speed, found.v[rows] * size, atol=1e-12 * speed
            )
    assert np.abs(A @ found.v + force - g).max() <= 1.1e-11 * np.abs(g).max()


@pytest.mark.parametrize("beta", LAWS)
def test_the_solution_does_not_depend_on_the_start(beta: float) -> None:
    made, g, _ = problem(beta, dense=False)
    far = 1e3 * np.random.default_rng(1).normal(size=g.size)
    a = made.solve(g, np.zeros_like(g), 1e-11).v
    b = made.solve(g, far, 1e-11).v
    np.testing.assert_allclose(a, b, atol=1e-8 * np.abs(a).max())


@pytest.mark.parametrize("beta", [1e5, np.inf])
def test_what_is_kept_of_other_right_sides_does_not_change_the_solution(beta: float) -> None:
    made, g, _ = problem(beta, dense=False)
    fresh = made.solve(g, np.zeros_like(g), 1e-12).v
    for other in np.random.default_rng(2).normal(size=(5, g.size)):
        made.solve(300.0 * other, np.zeros_like(g), 1e-12)
    again = made.solve(g, np.zeros_like(g), 1e-12).v
    np.testing.assert_allclose(again, fresh, atol=1e-9 * np.abs(fresh).max())


def reference_plate(
    beta: float, angle: float = 0.0, elements: tuple[int, int] = (20, 4), **changes: Any
) -> tuple[PlateStructure, System]:
    """The paper's reference system as a plate, pulled along it and a little across."""
    kind, order = changes.pop("element", ("quadrilateral", 1))
    plate = build_plate([("joint", 0.25, elements[0])], 0.05, elements[1], kind=kind, order=order)
    structure = plate_structure(
        turned(plate, angle), [pressed(beta=beta)], stiffness_damping=1e-5, **changes
    )
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    direction = (c * 1.0 - s * 0.2, s * 1.0 + c * 0.2)
    return structure, assemble_plate(structure, [("right", direction, Harmonic(60e3, 1000.0))], [])


def run(system: System, steps: int = 50, **changes: Any) -> Run:
    values = {"step": 1e-3 / steps, "n_steps": steps, "save": Save(fields=True)} | changes
    return integrate(system, **values)


@pytest.mark.parametrize("beta", LAWS)
def test_a_turned_plate_gives_the_turned_answer(beta: float) -> None:
    structure, system = reference_plate(beta)
    u = structure.expand(run(system).u)
    angle = 37.0
    structure, system = reference_plate(beta, angle)
    c, s = np.cos(np.radians(angle)), np.sin(np.radians(angle))
    turned_u = structure.expand(run(system).u) @ np.array([[c, -s], [s, c]])
    np.testing.assert_allclose(turned_u, u, rtol=0.0, atol=1e-10 * np.abs(u).max())


@pytest.mark.parametrize("element", ELEMENTS)
@pytest.mark.parametrize("beta", [1e5, np.inf])
@pytest.mark.parametrize("rho", [1.0, 0.5])
def test_the_energy_audit_closes(element: tuple[str, int], beta: float, rho: float) -> None:
    _, system = reference_plate(beta, elements=(10, 2), element=element)
    found = run(system, scheme=generalized_alpha(rho))
    assert found.energy_residual < 1e-11
    assert np.all(found.friction_work >= 0.0)
    assert found.friction_work.sum() > 0.1 * found.input_work.sum()
    np.testing.assert_allclose(found.friction_work_rows[-1], found.friction_work)


@pytest.fixture
def whole(monkeypatch: pytest.MonkeyPatch) -> None:
    """Condense nothing."""
    monkeypatch.setattr(steppers_contact, "CONDENSED", 0)


@pytest.mark.parametrize("beta", LAWS)
def test_condensing_changes_nothing(beta: float, monkeypatch: pytest.MonkeyPatch) -> None:
    plate = build_plate([("linear", 0.2, 16), ("joint", 0.05, 4)], 0.05, 4)
    structure = plate_structure(plate, [pressed(beta=beta)], [("right", "xy")])
    system = assemble_plate(structure, [("left", (1.0, 0.1), Harmonic(12e3, 1000.0))], [])
    condensed = run(system)
    monkeypatch.setattr(steppers_contact, "CONDENSED", 0)
    on_all = run(system)
    assert condensed.friction_work.sum() > 0.0
    np.testing.assert_allclose(condensed.u, on_all.u, atol=1e-9 * np.abs(on_all.u).max())
    np.testing.assert_allclose(
        condensed.friction_work, on_all.friction_work, rtol=1e-6, atol=1e-9 * on_all.input_work[0]
    )


@pytest.mark.parametrize("beta", [1e5, 1e9, np.inf])
@pytest.mark.parametrize("normal_force", ["equal", "consistent"])
def test_on_a_chain_it_agrees_with_the_chains_own_stepper(
    beta: float, normal_force: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    system = LapJoint(elements=40, beta=beta, normal_force=normal_force).system
    chain = run(system, n_steps=100)
    monkeypatch.setattr(steppers, "_is_chain", lambda _: False)
    contact = run(system, n_steps=100)
    assert contact.counters.nested_solves == 0
    np.testing.assert_allclose(contact.u, chain.u, atol=1e-8 * np.abs(chain.u).max())
    np.testing.assert_allclose(contact.friction_work.sum(), chain.friction_work.sum(), rtol=1e-7)


def test_coulomb_points_that_stick_are_at_rest_and_hold_what_they_can() -> None:
    _, system = reference_plate(np.inf)
    found = run(system)
    slip = system.slip_norm((system.B @ found.v.T).T)
    force = system.slip_norm(found.sigma)
    assert np.all(force <= 1.0 + 1e-9)
    assert np.any(slip[10] == 0.0)
    assert np.any(slip[10] > 0.0)
    np.testing.assert_allclose(force[slip > 0.0], 1.0, rtol=1e-9)


def test_arctan_tends_to_coulomb_as_beta_grows() -> None:
    exact = run(reference_plate(np.inf)[1]).friction_work.sum()
    errors = [
        abs(run(reference_plate(beta)[1]).friction_work.sum() / exact - 1.0) for beta in (1e4, 1e6)
    ]
    assert errors[1] < 0.05 * errors[0]


@pytest.mark.parametrize("beta", [1e5, np.inf])
def test_a_load_that_starts_with_a_jump_meets_points_at_rest(beta: float) -> None:
    _, system = reference_plate(beta, elements=(10, 2))
    load = replace(system.loads[0], amplitude=Rectangle(40e3, 1e-4))
    found = integrate(replace(system, loads=(load,)), step=2e-6, n_steps=100)
    assert found.energy_residual < 1e-9
    assert found.friction_work.sum() > 0.0


def test_forces_on_two_plates_are_in_balance() -> None:
    structure = plate_structure(
        lap_plates(elements=(4, 5)),
        [pressed("upper_joint", against="lower_joint")],
        [("lower_left", "xy")],
    )
    system = assemble_plate(structure, [("upper_right", (1.0, 0.0), Harmonic(20e3, 500.0))], [])
    found = run(system, step=2e-5)
    forces = structure.T.T  # virtual work of nodal forces: zero in a rigid motion of all bodies
    patch = structure.patches[0]
    sigma = found.sigma[-1].reshape(-1, 2) * system.w[:, np.newaxis]
    on_upper = np.zeros((structure.n_nodes, 2))
    on_upper[patch.nodes] = -sigma
    on_lower = patch.other.T @ sigma
    assert np.abs(sigma).max() > 0.0
    total = on_upper + on_lower
    np.testing.assert_allclose(total.sum(axis=0), 0.0, atol=1e-9 * np.abs(sigma).sum())
    x, y = structure.nodes.T
    moment = (x * total[:, 1] - y * total[:, 0]).sum()
    assert abs(moment) < 1e-9 * np.abs(sigma).sum()
    generalised = forces @ total.ravel()
    np.testing.assert_allclose(
        generalised, -(system.B.T @ sigma.ravel()), atol=1e-9 * np.abs(sigma).max()
    )


def test_a_run_taken_up_again_is_the_same_to_the_bit(tmp_path: Any) -> None:
    _, system = reference_plate(1e5, elements=(10, 2))
    whole = run(system, steps=60, cycle_steps=20)

    class StopError(Exception):
        pass

    def stop(done: int, total: int) -> None:
        if done >= 40:
            raise StopError

    file = tmp_path / "state.npz"
    with pytest.raises(StopError):
        run(system, steps=60, cycle_steps=20, checkpoint=Checkpoint(file, "", 20), progress=stop)
    again = run(system, steps=60, cycle_steps=20, checkpoint=Checkpoint(file, "", 20, resume=True))
    np.testing.assert_array_equal(again.u, whole.u)
    np.testing.assert_array_equal(again.friction_work, whole.friction_work)


@pytest.mark.usefixtures("whole")
def test_few_factorizations_serve_many_steps() -> None:
    _, system = reference_plate(1e5, elements=(30, 6))
    counters = run(system, steps=200).counters
    assert counters.factorizations < 0.5 * counters.steps
    assert counters.newton_iterations < 8 * counters.steps
    assert counters.linear_solves < 40 * counters.steps


def test_a_plate_without_friction_takes_one_factorization_and_no_law() -> None:
    plate = build_plate([("joint", 0.25, 10)], 0.05, 2)
    structure = plate_structure(plate, [pressed(friction=0.0)])
    system = assemble_plate(structure, [("right", (1.0, 0.0), Harmonic(1e3, 100.0))], [])
    counters = run(system, step=1e-4).counters
    assert counters.friction_evaluations == 0
    assert counters.factorizations == 1


def test_points_that_slip_in_one_direction_and_in_two_stand_side_by_side() -> None:
    """A roller along the lower edge takes one direction of its nodes: their force is along x."""
    plate = build_plate([("joint", 0.25, 10)], 0.05, 2)
    structure = plate_structure(plate, [pressed(beta=np.inf)], [("left", "xy"), ("bottom", "y")])
    system = assemble_plate(structure, [("right", (1.0, 0.0), Harmonic(60e3, 1000.0))], [])
    assert set(system.directions) == {1, 2}
    found = run(system)
    assert found.energy_residual < 1e-10
    assert found.slip_peak.shape == system.w.shape
    assert found.sigma.shape[1] == system.directions.sum()


@pytest.mark.parametrize("beta", LAWS)
@pytest.mark.parametrize("dense", [True, False])
@pytest.mark.parametrize("size", [0.0, 1e-200])
def test_without_force_all_comes_to_rest_wherever_it_starts(
    beta: float, dense: bool, size: float
) -> None:
    made, g, _ = problem(beta, dense)
    far = 1e3 * np.random.default_rng(1).normal(size=g.size)
    found = made.solve(size * g, far, 1e-11)
    assert found.converged
    assert np.abs(found.v).max() <= size * np.abs(g).max()


@pytest.mark.parametrize("beta", [1e5, np.inf])
@pytest.mark.parametrize("dense", [True, False])
@pytest.mark.parametrize("unknown", range(4))
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_what_is_not_finite_is_never_accepted(
    beta: float, dense: bool, unknown: int, bad: float
) -> None:
    """The bodies do not touch: in the others all is as it should be."""
    A: Any = np.diag([1.0, 2.0, 3.0, 4.0])
    points = np.array([0, 2]), np.array([1, -1]), np.full(2, 5.0), np.full(2, beta)
    made = ContactProblem(A if dense else sparse.csr_array(A), *points)
    wrong = np.ones(4)
    wrong[unknown] = bad
    assert not made.solve(wrong, np.zeros(4), 1e-11).converged
    assert not made.solve(np.ones(4), np.where(wrong == 1.0, 0.0, np.nan), 1e-11).converged


@pytest.mark.parametrize("dense", [True, False])
def test_sweeps_that_leave_all_points_at_rest_are_not_the_end(dense: bool) -> None:
    """Found by search: all points are held, one of them with more than its friction."""
    A = np.array([[1.0, 0.40783138], [0.40783138, 1.0]])
    w, g = np.array([1.95682578, 0.82512249]), np.array([-3.72516003, -1.19008965])
    points = np.array([0, 1]), np.array([-1, -1]), w, np.full(2, np.inf)
    made = ContactProblem(A if dense else sparse.csr_array(A), *points)
    found = made.solve(g, np.array([15.26763545, -46.54703781]), 1e-11)
    assert found.converged
    assert np.any(found.v != 0.0)
    np.testing.assert_allclose(A @ found.v + w * found.sigma, g, atol=1e-10)


@pytest.mark.parametrize("directions", [1, 2])
def test_velocities_below_the_smallest_normal_number_keep_the_law(directions: int) -> None:
    """Motion dies out by 1000 a point: far from the load its inverse overflows."""
    n = 240
    diagonals = [np.full(n - 1, -1.0), np.full(n, 1e3), np.full(n - 1, -1.0)]
    A = sparse.csr_array(sparse.diags_array(diagonals, offsets=[-1, 0, 1]))
    first = np.arange(0, n, directions)
    second = first + 1 if directions == 2 else np.full(n, -1)
    made = ContactProblem(A, first, second, np.full(first.size, 1e-3), np.full(first.size, 1e5))
    g = np.zeros(n)
    g[-1] = 10.0
    found = made.solve(g, np.zeros(n), 1e-11)
    assert found.converged
    assert np.any((found.v != 0.0) & (np.abs(found.v) < np.finfo(float).tiny))


@pytest.mark.parametrize("beta", [1e5, np.inf])
def test_a_loaded_body_beside_one_in_contact_at_rest(beta: float) -> None:
    """Condensed, the contact has no force at all while the step has."""
    sticks = build_plate([("joint", 0.1, 4)], 0.05, 2, prefix="held_")
    moves = build_plate([("free", 0.3, 12)], 0.05, 3, origin=(0.5, 0.0))
    structure = plate_structure(
        merged([sticks, moves]), [pressed(beta=beta)], [("held_left", "xy"), ("left", "xy")]
    )
    system = assemble_plate(structure, [("right", (1.0, 0.0), Harmonic(1e4, 1000.0))], [])
    found = run(system)
    assert found.friction_work.sum() == 0.0
    assert found.energy_residual < 1e-10
    assert np.abs(found.v).max() > 0.0


def test_contact_on_every_unknown_is_condensed_to_itself() -> None:
    _, system = reference_plate(1e5, elements=(5, 2))
    assert system.B.shape[0] == system.n
    assert run(system).energy_residual < 1e-10
