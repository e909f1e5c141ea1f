"""Which stepper a system gets, whatever way it is written, and that all keep the same books."""

from dataclasses import replace
from math import inf
from typing import Any

import numpy as np
import pytest
import skfem
from bodies import LAP, lap, structure
from scipy import sparse
from scipy.integrate import trapezoid
from stepping_systems import (
    LapJoint,
    reference_plate,
    relative_slips,
    run_of,
    struts,
)

import skfem_joint as sj
from skfem_joint.stepping.arrangement import arranged


def test_each_system_gets_its_stepper():
    system = LapJoint(elements=10).system
    assert arranged(system).kind == "chain"
    assert arranged(system.with_contact(given=0 * system.contact.w)).kind == "linear"
    assert arranged(system.project(np.eye(10)[:, :3])).kind == "dense"
    assert arranged(reference_plate(elements=(4, 2))).kind == "contact"
    assert arranged(structure(lap(), [LAP], ["lower_left"]).system()).kind == "contact"
    # One unknown for each slip row, but more bands than a chain has.
    band = sparse.csr_array(system.M + 1e-3 * sparse.eye_array(10, k=2) @ system.M)
    band = sparse.csr_array(0.5 * (band + band.T))
    assert arranged(replace(system, M=band)).kind == "contact"
    # Slip rows that depend on each other cannot all be unknowns.
    twice = sparse.csr_array(sparse.vstack([system.contact.B, system.contact.B[:2]]))
    limits = np.append(system.contact.w, [1.0, 1.0])
    more = replace(system, contact=sj.Contact(twice, limits, 1e5))
    assert arranged(more).kind == "dense"


@pytest.mark.parametrize("rows", [600, 10])
def test_slips_that_depend_on_each_other_in_a_large_system_are_refused(rows):
    """Whether there are more of them than unknowns, or not."""
    system = LapJoint(elements=600).system
    twice = sparse.csr_array(sparse.vstack([system.contact.B[:rows], system.contact.B[:1]]))
    limits = np.append(system.contact.w[:rows], 1.0)
    more = replace(system, contact=sj.Contact(twice, limits, 1e5))
    with pytest.raises(sj.InputError, match="depend on each other"):
        sj.integrate(more, step=1e-5, n_steps=1)


@pytest.mark.parametrize("beta", [1e5, inf])
def test_a_line_mesh_refined_by_scikit_fem_is_a_chain_as_good_as_one_in_a_row(beta):
    """``MeshLine().refined(k)`` numbers the new vertices of each refinement after the old ones."""
    # Divided by 4: a mesh of length 1/4 m whose vertices are numbers that binary fractions hit.
    plain = skfem.MeshLine().refined(6).scaled(0.25)
    assert np.any(np.diff(plain.p[0]) < 0.0)
    mesh = plain.with_subdomains({"joint": lambda x: x[0] > 0.0}).with_boundaries(
        {"fixed": lambda x: x[0] == 0.0, "free_end": lambda x: x[0] == 0.25}
    )
    bar = sj.build_bar([("joint", 0.25, 64)], {"fixed": 0.0, "free_end": 0.25})
    joint = LapJoint(beta=beta)
    structures = [struts(one, [joint.joint]) for one in (mesh, bar)]
    systems = [one.system([sj.Load("free_end", joint.amplitude)]) for one in structures]
    shuffled, row = (run_of(system) for system in systems)
    assert arranged(systems[0]).kind == arranged(systems[1]).kind == "chain"
    assert shuffled.counters == row.counters
    assert shuffled.counters.linear_solves == 0
    np.testing.assert_allclose(shuffled.point_u, row.point_u, rtol=0.0, atol=1e-12 * row.peak[0])
    # An initial state is given on the system's own unknowns, too.
    start = np.random.default_rng(1).normal(size=(2, 64)) * [[1e-6], [1e-2]]
    place = np.argsort(np.argsort(structures[0].nodes[~structures[0].held.ravel(), 0]))
    one, other = run_of(systems[0], initial=start[:, place]), run_of(systems[1], initial=start)
    np.testing.assert_allclose(one.point_u, other.point_u, rtol=0.0, atol=1e-11 * other.peak[0])
    # Fields come in the mesh's own numbering, points of contact in that of the system.
    u = [one.expand(run.u)[..., 0] for one, run in zip(structures, (shuffled, row), strict=True)]
    order = np.argsort(structures[0].nodes[:, 0])
    np.testing.assert_allclose(u[0][:, order], u[1], rtol=0.0, atol=1e-12 * row.peak[0])
    point = np.argsort(structures[0].nodes[structures[0].patches[0].nodes, 0])
    other = np.argsort(structures[1].nodes[structures[1].patches[0].nodes, 0])
    for name in ("friction_work", "slip_peak"):
        a, b = getattr(shuffled, name)[point], getattr(row, name)[other]
        np.testing.assert_allclose(a, b, rtol=1e-9, atol=1e-12 * b.max())


@pytest.mark.parametrize("beta", [1e3, inf])
def test_equal_and_opposite_loads_on_equal_bars_slip_twice_as_far(beta):
    """By symmetry each bar is one on a rigid base under the law of twice its velocity.

    With more than 500 unknowns, where no dense steps are left to fall back on.
    """
    n = 270
    pair = relative_slips(n, beta)
    (load,) = pair.loads
    both = np.zeros(2 * n)
    both[n - 1], both[2 * n - 1] = 1.0, -1.0
    pair = replace(pair, loads=(replace(load, vector=both),))
    assert arranged(pair).kind == "contact"
    run, single = run_of(pair), run_of(LapJoint(elements=n, beta=2 * beta).system)
    np.testing.assert_allclose(run.u[:, :n], single.u, atol=1e-9 * single.peak[0])
    np.testing.assert_allclose(run.u[:, :n], -run.u[:, n:], atol=1e-10 * single.peak[0])
    np.testing.assert_allclose(run.point("one"), single.point_u[:, 0], atol=1e-9 * single.peak[0])
    np.testing.assert_allclose(run.sigma, single.sigma, atol=1e-7)
    works = 2 * single.friction_work
    np.testing.assert_allclose(run.friction_work, works, rtol=1e-7, atol=1e-12 * works.sum())
    assert works.sum() > 0.0
    assert run.energy_residual < 1e-10


def test_a_load_on_a_region_works_on_its_mean_displacement():
    bar = sj.build_bar([("joint", 0.2, 16), ("rest", 0.1, 8)], {"fixed": 0.0, "free_end": 0.3})
    made = struts(bar, [LapJoint().joint])
    system = made.system([sj.Load("rest", sj.Harmonic(40e3, 1000.0))], ["free_end"])
    assert np.diff(sparse.csr_array(system.P).indptr)[0] > 1
    assert arranged(system).kind == "chain"
    run = run_of(system, 200)
    assert run.counters.linear_solves == 0
    force, mean = run.amplitudes[:, 0], run.point("rest")
    work = np.sum(0.5 * (force[1:] + force[:-1]) * np.diff(mean))
    assert work == pytest.approx(run.input_work[0], rel=1e-10)
    u = made.expand(run.u)[..., 0]
    s, inside = made.nodes[:, 0], made.nodes[:, 0] >= 0.2 - 1e-9
    exact = trapezoid(u[:, inside], s[inside], axis=1) / 0.1
    np.testing.assert_allclose(mean, exact, atol=1e-12 * run.peak.max())


def _stops(N: Any, gap: Any) -> sj.System:
    """Masses of 1 kg on springs of 1 N/m beside rigid stops, pushed to these."""
    N = np.array(N, dtype=float)
    q, n = N.shape
    one = sparse.eye_array(n, format="csr")
    stops = sj.NormalPart(
        sparse.csr_array(N), np.array(gap), np.zeros(q), np.full(q, inf), np.ones(q)
    )
    push = sj.AppliedLoad(np.ones(n), sj.Harmonic(1.0, 0.1), "all")
    contact = sj.Contact(sparse.csr_array((0, n)), [], [], normal=stops)
    return sj.System(one, None, one, contact, (push,), P=one, points=tuple("abcd"[:n]))


@pytest.mark.parametrize(
    ("N", "said"),
    [
        ([[1.0], [-1.0]], "approach by the same displacement, or by none"),
        ([[0.0, 0.0]], "approach by the same displacement, or by none"),
        ([[0.5, 0.5], [0.0, 0.0]], "approach by the same displacement, or by none"),
        ([[1.0, 2.0], [2.0, 4.0]], "depend on each other, or no unknown moves one"),
    ],
)
def test_stops_that_no_unknown_moves_by_itself_are_refused(N, said):
    with pytest.raises(sj.InputError, match=said):
        sj.integrate(_stops(N, [0.1, 0.2][: len(N)]), step=0.1, n_steps=1)


def test_stops_of_independent_means_are_not_refused():
    run = sj.integrate(_stops([[0.5, 0.5], [0.5, -0.5]], [0.1, 0.2]), step=0.01, n_steps=600)
    assert run.peak == pytest.approx([0.1, 0.1], abs=2e-3)  # half of a step
