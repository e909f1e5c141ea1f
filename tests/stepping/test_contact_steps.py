"""Steps of sparse systems in contact: laws, symmetries, balances, condensation."""

from typing import Any

import numpy as np
import pytest
from bodies import WIDTH, pressed, structure
from opening_blocks import block, loads
from scipy import sparse
from stepping_systems import reference_plate

import skfem_joint as sj
from skfem_joint.minimise import condensed_newton
from skfem_joint.minimise.condensed_newton import CondensedNewton
from skfem_joint.minimise.contact_newton import ContactNewton
from skfem_joint.minimise.problem import ContactPoints
from skfem_joint.stepping.arrangement import step_problem

LAWS = [1e3, 1e5, 1e9, np.inf]


def run(system: sj.System, steps: int = 50, **changes: Any) -> sj.Run:
    values = {"step": 1e-3 / steps, "n_steps": steps, "save": sj.Save(fields=True)} | changes
    return sj.integrate(system, **values)


@pytest.mark.parametrize("elements", [4, 44])
@pytest.mark.parametrize("beta", LAWS)
def test_condensing_changes_nothing(beta, elements):
    """To few unknowns, which are made dense, and to many, which stay sparse."""
    mesh = sj.build_plate([("linear", 0.2, 16), ("joint", 0.05, elements)], WIDTH, 6)
    made = structure(mesh, [pressed(beta=beta)], fixed=("right",))
    system = made.system([sj.Load("left", sj.Harmonic(12e3, 1000.0), (1.0, 0.1))])
    H, points = sparse.csr_array(1e5 * system.M + 1e-5 * system.K), ContactPoints.of(system)
    condensed, on_all = (step_problem(H, points, "contact", how) for how in (True, False))
    assert isinstance(condensed, CondensedNewton)
    assert isinstance(on_all, ContactNewton)
    rng = np.random.default_rng(0)
    for share in (0.3, 1.0, -2.0):
        g = 12e3 * share * system.loads[0].vector + 300.0 * rng.normal(size=system.n)
        found, known = (problem.minimise(g, tolerance=1e-12) for problem in (condensed, on_all))
        assert found.converged
        assert np.any(system.contact.B @ known.v)
        np.testing.assert_allclose(found.v, known.v, rtol=0, atol=1e-9 * np.abs(known.v).max())
        np.testing.assert_allclose(found.sigma, known.sigma, atol=1e-6)


@pytest.mark.parametrize("opens", [False, True], ids=["constant", "opening"])
def test_points_that_rest_are_left_out_and_nothing_changes(opens, monkeypatch, request):
    """As in contacts of thousands of points, of which few move."""
    mesh = sj.build_plate([("linear", 0.2, 16), ("joint", 0.05, 24)], WIDTH, 6)
    made = structure(mesh, [pressed(beta=np.inf)], fixed=("right",))
    system = sj.condense(made.system([sj.Load("left", sj.Harmonic(20e3, 1000.0), (1.0, 0.1))]))
    if opens:
        lifted = loads(up=230e3)
        system = sj.condense(block(elements=24).system(lifted))
    whole = run(system)
    request.getfixturevalue("few_may_move")
    solved = []
    part = condensed_newton._Moving.advanced
    monkeypatch.setattr(
        condensed_newton._Moving,
        "advanced",
        lambda own, *given: solved.append(own.unknowns.size) or part(own, *given),
    )
    alone = run(system)
    assert np.mean(solved) < 0.6 * whole.system.n
    for name in ("u", "v", "sigma", "friction_work"):
        before, now = getattr(whole, name), getattr(alone, name)
        np.testing.assert_allclose(now, before, rtol=0, atol=1e-8 * np.abs(before).max())


def test_few_factorizations_serve_many_iterations():
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
    assert set(system.contact.directions) == {1, 2}
    found = run(system)
    assert found.energy_residual < 1e-10
    assert found.slip_peak.shape == system.contact.w.shape
    assert found.sigma.shape[1] == system.contact.directions.sum()
    # The order of the points is the system's own: nothing else changes when they change places.
    order = np.random.default_rng(0).permutation(system.contact.w.size)
    rows = np.concatenate([np.arange(*system.contact.first_row[p : p + 2]) for p in order])
    c, B = system.contact, sparse.csr_array(system.contact.B[rows])
    shuffled = system.with_contact(
        B=B, given=c.w[order], beta=c.beta[order], directions=c.directions[order]
    )
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
