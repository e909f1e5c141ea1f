"""Steps of chains: work does not grow with the chain, and slow steps start from a better place."""

from dataclasses import replace

import numpy as np
import pytest
from stepping_systems import CASE_I, LapJoint

from skfem_joint.minimise import front_elimination
from skfem_joint.runs.integrate import integrate


@pytest.mark.parametrize("beta", [1e5, 1e7, 1e9])
def test_coarse_steps_of_steep_laws_start_from_coulombs_solution(beta):
    # Without it such steps take 22 iterations and most of them nested ones.
    run = integrate(LapJoint(beta=beta).system, step=4e-5, n_steps=75)
    assert run.counters.newton_iterations <= 12 * run.counters.steps
    assert run.counters.nested_solves <= 5
    assert run.energy_residual < 1e-10


@pytest.mark.parametrize(("beta", "most"), [(1e5, 60), (np.inf, 2)])
def test_work_does_not_grow_with_the_chain(beta, most):
    run = integrate(LapJoint(elements=20_000, beta=beta).system, step=1e-5, n_steps=12)
    assert run.counters.newton_iterations <= most * run.counters.steps
    assert (run.counters.nested_solves > 0) == (beta < np.inf)
    assert run.energy_residual < 1e-9


# Without rules for flips between stick and slip, Newton's iteration cycles in the steps 50 to 65 of
# Coulomb's reference: some of them then take descents, and some are halved.
@pytest.mark.parametrize(
    ("joint", "steps"),
    [
        *((LapJoint(), 45), (CASE_I, 45), (replace(CASE_I, beta=np.inf), 45)),
        *((LapJoint(beta=np.inf, normal_force=kind), 65) for kind in ("equal", "consistent")),
    ],
)
def test_long_chains_need_neither_descents_nor_halved_steps(joint, steps):
    system = replace(joint, elements=10_000).system
    run = integrate(system, step=0.01 / joint.frequency, n_steps=steps)
    assert run.counters.descents == run.counters.halved_steps == 0
    assert run.counters.newton_iterations <= 60 * run.counters.steps
    assert np.isfinite(joint.beta) or run.counters.largest_iterations <= 100
    assert run.energy_residual < 1e-9


@pytest.mark.parametrize("beta", [1e5, np.inf])
def test_a_run_makes_the_chain_of_its_step_and_no_other(beta, monkeypatch):
    """That of the mass is not stepped, and functions are compiled by a chain of one point."""
    made, build = [], front_elimination.build_chain
    monkeypatch.setattr(
        front_elimination,
        "build_chain",
        lambda H, *others: (made.append(H.diagonal.size), build(H, *others))[1],
    )
    system = LapJoint(elements=50, beta=beta).system
    integrate(system, step=1e-5, n_steps=12)
    assert [n for n in made if n > 1] == [system.n]
