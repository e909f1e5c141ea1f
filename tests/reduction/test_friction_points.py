"""Fewer friction points: points that slip alike are merged."""

from typing import Any

import numpy as np
import pytest
from reduced_joints import case, full

import skfem_joint as sj
from skfem_joint.reduction.basis import Basis
from skfem_joint.reduction.friction_points import merged_points
from skfem_joint.reduction.models import notes_of


def of_run(name: str, modes: int, **how: Any) -> tuple[sj.System, sj.System]:
    """A plate and the reduced model of its own run."""
    system = case(name)[1]
    return system, sj.reduce(system, modes, run=full(name), **how)


def example() -> tuple[sj.System, Basis]:
    system, small = of_run("lap", 8)
    return system, small.origin.basis


def merged(system: sj.System, basis: Basis, count: int) -> tuple[sj.System, np.ndarray]:
    """Merged points, and the one that stands for each old point."""
    few = merged_points(system, basis.history.velocities, basis.history.active, count)
    contact = few.contact
    owner = np.full(system.contact.w.size, -1)
    owner[contact.shares.indices] = np.repeat(
        np.arange(contact.w.size), np.diff(contact.shares.indptr)
    )
    np.testing.assert_allclose(contact.shares.sum(axis=1), np.ones(contact.w.size), rtol=1e-12)
    return few, owner


@pytest.mark.parametrize("count", [1, 7, 40])
def test_merged_points_carry_the_same_total_and_are_means(count):
    system, basis = example()
    reduced = system.project(basis.V)
    few, owner = merged(reduced, basis, count)
    contact, limits = few.contact, system.contact.w
    assert 0.8 * count <= contact.w.size <= count
    assert np.all(contact.w > 0.0)
    assert contact.w.sum() == pytest.approx(limits[basis.history.active].sum(), rel=1e-12)
    assert np.array_equal(np.flatnonzero(owner >= 0), basis.history.active)
    rows = reduced.contact.B.reshape(-1, 2, reduced.n)
    for k in range(contact.w.size):
        mine = owner == k
        assert contact.w[k] == pytest.approx(limits[mine].sum(), rel=1e-12)
        mean = np.average(rows[mine], axis=0, weights=limits[mine])
        np.testing.assert_allclose(contact.B[2 * k : 2 * k + 2], mean, atol=1e-12)


def test_points_of_other_laws_or_joints_are_not_merged():
    system, basis = example()
    odd = np.arange(system.contact.w.size) % 2
    reduced = system.project(basis.V).with_contact(beta=np.where(odd, 1e5, 1e3))
    few, owner = merged(reduced, basis, 12)
    assert np.array_equal(
        few.contact.beta[owner[basis.history.active]], reduced.contact.beta[basis.history.active]
    )
    assert set(few.contact.beta) == {1e3, 1e5}
    two = system.project(basis.V).with_contact(J=np.stack([odd, 1.0 - odd]), joints=("odd", "even"))
    J = merged_points(two, basis.history.velocities, basis.history.active, 12).contact.J
    np.testing.assert_allclose(J, np.round(J), atol=1e-12)
    np.testing.assert_allclose(J.sum(axis=0), 1.0, rtol=1e-12)


def test_a_reduced_system_has_the_points_and_the_beta_that_its_modes_resolve():
    system, reduced = of_run("lap", 8)
    velocity = reduced.origin.basis.history.slip_velocity
    assert reduced.n == 8
    assert 20 <= reduced.contact.w.size <= 24  # three a mode
    assert reduced.contact.shares.shape == (reduced.contact.w.size, system.contact.w.size)
    np.testing.assert_allclose(reduced.contact.beta, 1.0 / (1e-4 * velocity), rtol=1e-12)
    (note,) = notes_of(reduced)
    assert "reduced model uses beta" in note
    _, chosen = of_run("lap", 8, friction_points="all", beta=77.0)
    assert np.all(chosen.contact.beta == 77.0)
    assert chosen.contact.w.size == system.contact.w.size
    assert notes_of(chosen) == ()


def test_fewer_points_than_asked_for_are_reported():
    system, small = of_run("strip", 5, friction_points=10_000, beta=1e4)
    assert "instead of 10000" in notes_of(small)[0]
    assert np.array_equal(np.sort(small.contact.w), np.sort(system.contact.w))  # each by itself


def test_a_system_without_friction_is_refused():
    system = case("lap")[1]
    with pytest.raises(sj.InputError, match="needs friction in a joint"):
        sj.reduce(system.with_contact(given=0.0 * system.contact.w), run=full("lap"))
