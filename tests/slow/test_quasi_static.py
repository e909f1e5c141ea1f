"""Quasi-static slip: Masing's rule, friction limits, slip vectors; SI units."""

from functools import cache

import numpy as np
import pytest
from bodies import LAP, WIDTH, lap, pressed, structure
from scipy import sparse
from stepping_systems import arm

import skfem_joint as sj
from skfem_joint.linalg import schur
from skfem_joint.minimise import contact_newton
from skfem_joint.slow import quasi_static
from skfem_joint.slow.levels import NoLevelError
from skfem_joint.slow.quasi_static import QuasiStatic
from skfem_joint.stepping import arrangement

TAU, JOINT = 1.75e6, 0.2  # N/m, m


@cache
def bar(elements: int = 100, held: bool = True) -> sj.System:
    """Bar with a free length beyond a joint of constant friction per length."""
    joint = sj.Joint("joint", TAU / 0.7 / WIDTH, 0.7, normal_force="consistent")
    supports = {} if held else {"fixed": (), "free": True}
    return arm(sj.Harmonic(1.0, 1.0), joint, (elements, 100), stiffness_damping=1e-5, **supports)


def test_unloading_is_the_loading_doubled_and_loops_close():
    system = bar()
    shape = system.loads[0].vector
    up, down = np.linspace(0.0, 1.0, 41)[1:], np.linspace(1.0, -1.0, 81)[1:]
    history = 0.7 * TAU * JOINT * np.concatenate([up, down, -down])
    end = QuasiStatic(system).follow(history[:, np.newaxis] * shape) @ shape
    first, back = end[:40], end[39] - end[40:120]
    assert np.abs(back[1::2] - 2.0 * first).max() < 1e-9 * first[-1]
    assert end[199] == pytest.approx(end[39], rel=1e-12)


@pytest.mark.parametrize("multiple", [0.5, 3.0, 1e3])
def test_a_body_that_friction_holds_slips_at_its_limit(multiple):
    system = bar(held=False)
    path = QuasiStatic(system)
    force, limit = multiple * system.loads[0].vector, float(system.contact.w.sum())
    assert path.limit(force) == pytest.approx(limit / multiple, rel=1e-9)
    # Loads beyond what friction holds are scaled back: the body stays where it is.
    held, beyond = path.follow(np.array([0.98, 1.5])[:, np.newaxis] * limit / multiple * force)
    assert np.abs(beyond - held).max() < 1e-6 * np.abs(held).max()


def test_a_level_held_back_that_does_not_converge_is_an_error(monkeypatch):
    monkeypatch.setattr(contact_newton, "ITERATIONS", 3)
    system = sj.condense(bar(20, held=False))
    beyond = 3.0 * float(system.contact.w.sum()) * system.loads[0].vector
    with pytest.raises(sj.ConvergenceError, match="was not found: a force residual"):
        QuasiStatic(system).follow(beyond[np.newaxis])


def test_a_friction_limit_that_is_not_found_is_an_error(monkeypatch):
    monkeypatch.setattr(quasi_static, "LIMIT_ITERATIONS", 1)
    monkeypatch.setattr(quasi_static, "LEAST_SQUARES", 0)  # else at once
    system = bar(held=False)
    with pytest.raises(sj.ConvergenceError, match="what friction can hold was not found"):
        QuasiStatic(system).limit(2.0 * float(system.contact.w.sum()) * system.loads[0].vector)


def test_an_elastic_support_has_no_friction_limit():
    assert QuasiStatic(bar()).limit(bar().loads[0].vector) == np.inf


@pytest.mark.parametrize("fixed", [("lower_left",), ()])
def test_the_contact_alone_is_stepped_as_the_whole_is(fixed, monkeypatch):
    """Of plates that friction holds; where nothing holds them both, the contact is not alone."""
    made = structure(lap(), [LAP], fixed, free=not fixed, stiffness_damping=0.0)
    pulled = {"upper_right": (1.0, 0.2)} | ({} if fixed else {"lower_left": (-1.0, -0.2)})
    loads = [sj.Load(end, sj.Harmonic(1.0, 1.0), along) for end, along in pulled.items()]
    system = made.system(loads, [])
    pull = system.load_vectors().sum(axis=1) * float(system.contact.w.sum())
    if not fixed:  # without what would turn the plates together
        pull = system.K @ QuasiStatic(system).follow(pull[np.newaxis], limit_share=np.inf)[0]
    forces = np.array([0.3, 0.6, 0.2, -0.5])[:, np.newaxis] * pull
    alone = QuasiStatic(system, 1e-10)
    assert (alone.condensed is not None) == bool(fixed)
    monkeypatch.setattr(schur, "MEMORY_SHARE", 0.0)
    together = QuasiStatic(system, 1e-10)
    assert together.whole is None
    u, v = (np.asarray((system.contact.B @ path.follow(forces).T).T) for path in (alone, together))
    assert np.abs(u).max() > 1e-8
    np.testing.assert_allclose(u, v, rtol=0, atol=1e-6 * np.abs(v).max())
    assert alone.limit(pull) == pytest.approx(together.limit(pull), rel=1e-6)
    again = alone.afresh(alone.to)
    assert again.solves == 0
    w = np.asarray((system.contact.B @ again.follow(forces).T).T)  # whatever was followed before
    np.testing.assert_allclose(w, v, rtol=0, atol=1e-6 * np.abs(v).max())


@pytest.mark.parametrize("fixed", [("right",), ()])
def test_many_in_contact_are_stepped_as_the_whole_is(fixed, monkeypatch):
    """Of a plate pressed on a part of it, which stays sparse; friction alone may hold it."""
    mesh = sj.build_plate([("joint", 0.1, 44), ("free", 0.1, 10)], 0.05, 6)
    made = structure(mesh, [pressed(pressure=5e6, friction=0.5)], fixed)
    system = made.system([sj.Load("left", sj.Harmonic(1.0, 1.0), (-1.0, 0.2))], [])
    forces = np.array([0.3, 0.6, 0.2, -0.5])[:, np.newaxis] * 12e3 * system.loads[0].vector
    alone = QuasiStatic(system, 1e-10)
    assert alone.whole is not None
    assert (alone.condensed is not None) == bool(fixed)
    monkeypatch.setattr(arrangement, "condensing_pays", lambda A, kept: False)
    together = QuasiStatic(system, 1e-10)
    assert together.whole is None
    u, v = (path.follow(forces) for path in (alone, together))
    assert np.abs(system.contact.B @ v.T).max() > 1e-8
    np.testing.assert_allclose(u, v, rtol=0, atol=1e-6 * np.abs(v).max())


def test_slip_vectors_of_a_plate_do_no_less_work_than_the_load_left():
    mesh = sj.build_plate([("joint", 0.1, 10), ("free", 0.1, 10)], 0.05, 4)
    made = structure(mesh, [pressed(pressure=5e6, friction=0.5)])
    system = made.system([sj.Load("right", sj.Harmonic(1.0, 1.0), (1.0, 0.3))], [])
    f = 6e3 * system.loads[0].vector
    path = QuasiStatic(system)
    u = path.follow(np.linspace(0.1, 1.0, 10)[:, np.newaxis] * f)
    slips = np.asarray((system.contact.B @ u.T).T)
    # Friction is admissible, and opposes the last increment wherever that slips.
    force = f - system.K @ u[-1]
    rows = sparse.csr_array(system.contact.B)
    friction = (rows @ force).reshape(-1, 2)
    assert (np.hypot(*friction.T) <= system.contact.w * (1.0 + 1e-6)).all()
    last = (slips[-1] - slips[-2]).reshape(-1, 2)
    slipping = np.hypot(*last.T) > 1e-6 * np.abs(last).max()
    assert 5 < slipping.sum() < slipping.size
    product = (friction * last).sum(axis=1)[slipping]
    assert product == pytest.approx((system.contact.w * np.hypot(*last.T))[slipping], rel=1e-6)
    # A level takes one solve; factors are kept from one to the next where they serve.
    assert path.solves == 10
    assert path.factorizations <= 40


@pytest.mark.parametrize("held", [True, False])
def test_a_dense_system_slips_as_the_sparse_one_does(held):
    system = bar(10, held)
    dense = system.project(np.eye(system.n))
    # Points that depend on each other: each is cut into three of a third of its limit.
    thirds = {
        "given": np.repeat(system.contact.w / 3.0, 3),
        "beta": np.repeat(system.contact.beta, 3),
    }
    thirds |= {
        "B": np.repeat(dense.contact.B, 3, axis=0),
        "directions": np.ones(3 * system.contact.w.size, int),
    }
    history = (
        np.array([0.3, 0.6, 0.9, 0.2, -0.5, -0.9, 0.9])[:, np.newaxis] * system.contact.w.sum()
    )
    forces = history * system.loads[0].vector
    exact = QuasiStatic(system).follow(forces)
    found = QuasiStatic(dense.with_contact(**thirds, J=None, stiffness=None)).follow(forces)
    assert found == pytest.approx(exact, abs=1e-4 * np.abs(exact).max())


def test_systems_without_friction_are_refused():
    with pytest.raises(sj.InputError, match="needs friction"):
        QuasiStatic(bar().with_contact(given=np.zeros(bar().contact.w.size)))


@pytest.mark.parametrize("pull", [(1.0, 0.0), (0.3, 1.0)])
def test_the_limit_of_rigid_motions_is_that_of_the_iteration(pull, monkeypatch):
    """Of a plate on its base, which slides and turns when it is pulled at an edge."""
    mesh = sj.build_plate([("joint", 0.1, 8), ("free", 0.1, 8)], 0.05, 4)
    made = structure(mesh, [pressed(pressure=5e6, friction=0.5)], ())
    system = made.system([sj.Load("right", sj.Harmonic(1.0, 1.0), pull)], [])
    force, path = 1e3 * system.loads[0].vector, QuasiStatic(system, 1e-10)
    limit = path.limit(force)
    assert path.solves == 0
    monkeypatch.setattr(quasi_static, "LEAST_SQUARES", 0)
    other = QuasiStatic(system, 1e-10)
    assert limit == pytest.approx(other.limit(force), rel=1e-5)
    assert other.solves > 0
    # A level exists below it, and none above.
    path.next(path.rest(), 0.99 * limit * force)
    with pytest.raises(NoLevelError, match="times what supports and friction hold"):
        path.next(path.rest(), 1.01 * limit * force)


@pytest.mark.parametrize("seed", range(6))
def test_more_rigid_motions_than_slips(seed):
    # Two masses on a spring in three directions; friction holds one of them in two.
    rng, one = np.random.default_rng(seed), sparse.eye_array(6, format="csr")
    link, mass = np.diag(rng.uniform(50.0, 200.0, 3)), np.repeat(rng.uniform(0.5, 2.0, 2), 3)
    K = sparse.csr_array(np.block([[link, -link], [-link, link]]))
    rubs = sj.Contact(one[3:5], np.ones(1), np.inf, directions=np.array([2]))
    system = sj.System(sparse.diags_array(mass).tocsr(), None, K, rubs)
    u = QuasiStatic(system).follow(np.array([[0.6, 0.3, 0.0, 0.0, 0.0, 0.0]]))[0]
    assert u[:2] == pytest.approx([0.6 / link[0, 0], 0.3 / link[1, 1]], rel=1e-6)
    assert u[3:5] == pytest.approx([0.0, 0.0], abs=1e-12)
