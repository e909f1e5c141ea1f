"""The contact problem and its stepper: minimisers, symmetries, balances, condensation."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from bodies import WIDTH, pressed, structure
from scipy import sparse
from stepping_systems import reference_plate

import skfem_joint as sj
from skfem_joint import friction
from skfem_joint.linalg import schur
from skfem_joint.stepping import contact_problem, steppers
from skfem_joint.stepping.contact_problem import ContactProblem
from skfem_joint.stepping.recording import Run

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
def test_the_solution_balances_all_forces_on_the_graph_of_the_law(beta, dense, seed):
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
def test_the_solution_depends_on_neither_start_nor_what_was_solved_before(beta):
    made, g, _ = problem(beta, dense=False)
    zero = np.zeros_like(g)
    fresh = made.solve(g, zero, 1e-12).v
    far = 1e3 * np.random.default_rng(1).normal(size=g.size)
    np.testing.assert_allclose(made.solve(g, far, 1e-12).v, fresh, atol=1e-8 * np.abs(fresh).max())
    for other in np.random.default_rng(2).normal(size=(5, g.size)):
        made.solve(300.0 * other, zero, 1e-12)
    again = made.solve(g, zero, 1e-12).v
    np.testing.assert_allclose(again, fresh, atol=1e-9 * np.abs(fresh).max())


@pytest.mark.parametrize("beta", LAWS)
@pytest.mark.parametrize("dense", [True, False])
@pytest.mark.parametrize("size", [0.0, 1e-200])
def test_without_force_all_comes_to_rest_wherever_it_starts(beta, dense, size):
    made, g, _ = problem(beta, dense)
    far = 1e3 * np.random.default_rng(1).normal(size=g.size)
    found = made.solve(size * g, far, 1e-11)
    assert found.converged
    assert np.abs(found.v).max() <= size * np.abs(g).max()


@pytest.mark.parametrize("beta", [1e5, np.inf])
@pytest.mark.parametrize("dense", [True, False])
@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_what_is_not_finite_is_never_accepted(beta, dense, bad):
    """The bodies do not touch: in the others all is as it should be."""
    A: Any = np.diag([1.0, 2.0, 3.0, 4.0])
    points = np.array([0, 2]), np.array([1, -1]), np.full(2, 5.0), np.full(2, beta)
    made = ContactProblem(A if dense else sparse.csr_array(A), *points)
    for unknown in range(4):
        wrong = np.ones(4)
        wrong[unknown] = bad
        assert not made.solve(wrong, np.zeros(4), 1e-11).converged
        assert not made.solve(np.ones(4), np.where(wrong == 1.0, 0.0, np.nan), 1e-11).converged


@pytest.mark.parametrize("dense", [True, False])
def test_sweeps_that_leave_all_points_at_rest_are_not_the_end(dense):
    """Found by search: all points are held, one of them with more than its friction."""
    A = np.array([[1.0, 0.40783138], [0.40783138, 1.0]])
    w, g = np.array([1.95682578, 0.82512249]), np.array([-3.72516003, -1.19008965])
    points = np.array([0, 1]), np.array([-1, -1]), w, np.full(2, np.inf)
    made = ContactProblem(A if dense else sparse.csr_array(A), *points)
    found = made.solve(g, np.array([15.26763545, -46.54703781]), 1e-11)
    assert found.converged
    assert np.any(found.v != 0.0)
    np.testing.assert_allclose(A @ found.v + w * found.sigma, g, atol=1e-10)


def test_points_that_turn_do_not_block_the_others():
    """Light points on heavy unknowns: of the first 3,000 draws 8 once took more than 99 steps."""
    random = np.random.default_rng(0)
    for _ in range(700):
        m = int(random.integers(1, 4))
        A = np.diag(np.repeat([10.0 ** random.uniform(-7, -3), 1.0], [2 * m, 2]))
        P = random.normal(size=(2, 2 * m)) * 10.0 ** random.uniform(-2, 0)
        A[: 2 * m, : 2 * m] += P.T @ P
        A[2 * m :, : 2 * m], A[: 2 * m, 2 * m :] = P, P.T
        w, g = 10.0 ** random.uniform(-1, 1, m), 10.0 * random.normal(size=2 * m + 2)
        first = np.arange(0, 2 * m, 2)
        made = ContactProblem(A, first, first + 1, w, np.full(m, np.inf))
        found = made.solve(g, np.zeros(g.size), 1e-11)
        assert found.converged
        assert found.counts["newton_iterations"] < 40


@pytest.mark.parametrize("directions", [1, 2])
@pytest.mark.parametrize("sweeps", [0, contact_problem.SWEEPS])
def test_velocities_below_the_smallest_normal_number_keep_the_law(directions, sweeps, monkeypatch):
    """Motion dies out by 1000 a point: far from the load its inverse overflows."""
    monkeypatch.setattr(contact_problem, "SWEEPS", sweeps)
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
    if not sweeps:  # which stop before
        assert np.any((found.v != 0.0) & (np.abs(found.v) < np.finfo(float).tiny))


def run(system: sj.System, steps: int = 50, **changes: Any) -> Run:
    values = {"step": 1e-3 / steps, "n_steps": steps, "save": sj.Save(fields=True)} | changes
    return sj.integrate(system, **values)


@pytest.mark.parametrize("beta", [1e5, np.inf])
def test_a_solid_on_its_base_is_stepped_as_a_plate_is(beta):
    sides = {"left": "left", "right": "right", "base": "front"}
    mesh = sj.build_box([("joint", 0.25, 6)], (WIDTH, 0.01), (2, 1), boundaries=sides)
    made = structure(mesh, [pressed("base", beta=beta)], stiffness_damping=1e-5)
    system = made.system([sj.Load("right", sj.Harmonic(60e3, 1000.0), (1.0, 0.2, 0.0))])
    assert np.all(system.directions == 2)
    found = run(system, 100)
    assert found.energy_residual < 1e-11
    assert found.friction_work.sum() > 0.1 * found.input_work.sum()
    slip, force = system.slip_norm((system.B @ found.v.T).T), system.slip_norm(found.sigma)
    np.testing.assert_allclose(force[slip > 0], friction.force(slip[slip > 0], beta), rtol=1e-7)


@pytest.mark.parametrize("elements", [4, 44])
@pytest.mark.parametrize("beta", LAWS)
def test_condensing_changes_nothing(beta, elements, monkeypatch):
    """To few unknowns, which are made dense, and to many, which stay sparse."""
    mesh = sj.build_plate([("linear", 0.2, 16), ("joint", 0.05, elements)], WIDTH, 6)
    made = structure(mesh, [pressed(beta=beta)], fixed=("right",))
    system = made.system([sj.Load("left", sj.Harmonic(12e3, 1000.0), (1.0, 0.1))])
    condensed = run(system)
    monkeypatch.setattr(steppers, "condensing_pays", lambda A, kept: False)
    on_all = run(system)
    assert condensed.friction_work.sum() > 0.0
    np.testing.assert_allclose(condensed.u, on_all.u, atol=1e-9 * np.abs(on_all.u).max())
    np.testing.assert_allclose(
        condensed.friction_work, on_all.friction_work, rtol=1e-6, atol=1e-9 * on_all.input_work[0]
    )


def test_few_factorizations_serve_many_iterations(monkeypatch):
    monkeypatch.setattr(schur, "SETTINGS", replace(schur.SETTINGS, most_dense=0))
    system = reference_plate(1e5, elements=(30, 6))
    counters = run(system, steps=200).counters
    assert counters.newton_iterations < 5 * counters.steps
    assert counters.factorizations < counters.newton_iterations / 5
    # A factor costs as much as thirty solves, where its band is not narrow.
    assert 30 * counters.factorizations + counters.linear_solves < 35 * counters.steps


def test_points_that_slip_in_one_direction_and_in_two_stand_side_by_side():
    """A roller along the lower edge takes one direction of its nodes: their force is along x."""
    mesh = sj.build_plate([("joint", 0.25, 10)], WIDTH, 2)
    made = structure(mesh, [pressed(beta=np.inf)], fixed_y=("bottom",))
    system = made.system([sj.Load("right", sj.Harmonic(60e3, 1000.0), (1.0, 0.0))])
    assert set(system.directions) == {1, 2}
    found = run(system)
    assert found.energy_residual < 1e-10
    assert found.slip_peak.shape == system.w.shape
    assert found.sigma.shape[1] == system.directions.sum()
    # The order of the points is the system's own: nothing else changes when they change places.
    order = np.random.default_rng(0).permutation(system.w.size)
    rows = np.concatenate([np.arange(*system.first_row[p : p + 2]) for p in order])
    shuffled = replace(
        system, B=sparse.csr_array(system.B[rows]), w=system.w[order], beta=system.beta[order],
        directions=system.directions[order],
    )  # fmt: skip
    other = run(shuffled)
    np.testing.assert_allclose(other.u, found.u, atol=1e-9 * np.abs(found.u).max())
    atol = 1e-9 * found.friction_work.max()
    np.testing.assert_allclose(other.friction_work, found.friction_work[order], atol=atol)


@pytest.mark.parametrize("beta", [1e5, np.inf])
def test_a_loaded_body_beside_one_in_contact_at_rest(beta):
    """Condensed, the contact has no force at all while the step has."""
    sticks = sj.build_plate([("joint", 0.1, 4)], WIDTH, 2, prefix="held_")
    moves = sj.build_plate([("free", 0.3, 12)], WIDTH, 3, origin=(0.5, 0.0))
    made = structure(sj.merged([sticks, moves]), [pressed(beta=beta)], fixed=("held_left", "left"))
    found = run(made.system([sj.Load("right", sj.Harmonic(1e4, 1000.0), (1.0, 0.0))]))
    assert found.friction_work.sum() == 0.0
    assert found.energy_residual < 1e-10
    assert np.abs(found.v).max() > 0.0
