"""Quasi-static slip: friction limits, slip vectors, what holds a body; SI units."""

from functools import cache

import numpy as np
import pytest
from bodies import LAP, WIDTH, lap, pressed, structure
from scipy import sparse
from stepping_systems import arm

import skfem_joint as sj
from skfem_joint.slow import quasi_static
from skfem_joint.slow.levels import NoLevelError
from skfem_joint.slow.quasi_static import QuasiStatic

TAU, JOINT = 1.75e6, 0.2  # N/m, m


@cache
def bar(elements: int = 100, held: bool = True) -> sj.System:
    """Bar with a free length beyond a joint of constant friction per length."""
    joint = sj.Joint("joint", TAU / 0.7 / WIDTH, 0.7, normal_force="consistent")
    supports = {} if held else {"fixed": (), "free": True}
    return arm(sj.Harmonic(1.0, 1.0), joint, (elements, 100), stiffness_damping=1e-5, **supports)


def assert_levels(system: sj.System, path: QuasiStatic, forces: np.ndarray) -> np.ndarray:
    """Slips at levels that balance: friction is admissible, and opposes each slip at its limit."""
    u, w = path.follow(forces), system.contact.w
    left = forces.T - system.K @ u.T - system.contact.B.T @ path.frictions.T
    assert np.abs(left).max() < 1e-5 * np.abs(forces).max()  # 1e-9 but for rigid motions
    slips = np.asarray((system.contact.B @ u.T).T)
    changes = np.diff(slips, axis=0, prepend=0.0).reshape(len(u), -1, 2)
    friction, way = path.frictions.reshape(changes.shape), np.linalg.norm(changes, axis=2)
    assert (np.linalg.norm(friction, axis=2) <= w * (1.0 + 1e-6)).all()
    moves = way > 1e-6 * way.max(axis=1, keepdims=True)
    assert 0 < moves.sum() < moves.size
    power = (friction * changes).sum(axis=2)
    np.testing.assert_allclose(power[moves], (w * way)[moves], rtol=1e-6)
    return slips


def plates(fixed: tuple[str, ...]) -> sj.System:
    """Two plates over each other, which friction holds together, pulled at an angle."""
    made = structure(lap(), [LAP], fixed, free=not fixed, stiffness_damping=0.0)
    pulled = {"upper_right": (1.0, 0.2)} | ({} if fixed else {"lower_left": (-1.0, -0.2)})
    loads = [sj.Load(end, sj.Harmonic(1.0, 1.0), along) for end, along in pulled.items()]
    return made.system(loads, [])


def plate(
    fixed: tuple[str, ...], elements: int, pull: tuple[float, float] = (1.0, 0.3)
) -> sj.System:
    """Plate pressed on a part of it."""
    mesh = sj.build_plate([("joint", 0.1, elements), ("free", 0.1, 10)], 0.05, 6)
    made = structure(mesh, [pressed(pressure=5e6, friction=0.5)], fixed)
    return made.system([sj.Load("right", sj.Harmonic(1.0, 1.0), pull)], [])


@pytest.mark.parametrize("multiple", [0.5, 3.0, 1e3])
def test_a_body_that_friction_holds_slips_at_its_limit(multiple):
    system = bar(held=False)
    path = QuasiStatic(system)
    force, limit = multiple * system.loads[0].vector, float(system.contact.w.sum())
    assert path.limit(force) == pytest.approx(limit / multiple, rel=1e-9)
    # Loads beyond what friction holds are scaled back: the body stays where it is.
    held, beyond = path.follow(np.array([0.98, 1.5])[:, np.newaxis] * limit / multiple * force)
    assert np.abs(beyond - held).max() < 1e-6 * np.abs(held).max()


@pytest.mark.filterwarnings("ignore:invalid value")
def test_a_level_that_does_not_converge_is_an_error():
    system = sj.condense(bar(20, held=False))
    wrong = np.nan * system.loads[0].vector
    with pytest.raises(sj.ConvergenceError, match="was not found: a force residual of nan N"):
        QuasiStatic(system).follow(wrong[np.newaxis])


def test_a_friction_limit_is_found_by_iteration_too_and_an_error_where_it_is_not(monkeypatch):
    """Where least squares of rigid motions do not lead to it."""
    system = bar(held=False)
    force = 2.0 * float(system.contact.w.sum()) * system.loads[0].vector
    monkeypatch.setattr(quasi_static, "LEAST_SQUARES", 0)
    assert QuasiStatic(system).limit(force) == pytest.approx(0.5, rel=1e-5)
    monkeypatch.setattr(quasi_static, "LIMIT_ITERATIONS", 1)
    with pytest.raises(sj.ConvergenceError, match="what friction can hold was not found"):
        QuasiStatic(system).limit(force)


def balanced(system: sj.System) -> np.ndarray:
    """Loads that sum up to the limit of friction, without what would move bodies rigidly."""
    pull = float(system.contact.w.sum()) * system.load_vectors().sum(axis=1)
    return system.K @ QuasiStatic(system).follow(pull[np.newaxis], limit_share=np.inf)[0]


def test_forces_that_a_support_or_each_other_hold_have_no_friction_limit():
    assert QuasiStatic(bar()).limit(bar().loads[0].vector) == np.inf
    free = bar(20, held=False)
    assert QuasiStatic(free).limit(free.K @ np.linspace(0.0, 1e-3, free.n)) == np.inf


@pytest.mark.parametrize(
    ("system", "alone"),
    [
        (plates(("lower_left",)), True),
        (plates(()), False),
        (plate(("left",), 10), False),
        (plate(("left",), 44), True),
        (plate((), 44), False),
    ],
    ids=["plates", "free plates", "plate", "many points", "many points of a free plate"],
)
def test_levels_are_those_of_coulombs_friction(system, alone):
    """The contact is stepped alone, unless nothing else holds a body and its matrix is sparse."""
    size = 12e3 if system.contact.w.size < 200 else 9e3
    pull = balanced(system) if len(system.loads) > 1 else size * system.loads[0].vector
    forces = np.array([0.3, 0.6, 0.2, -0.5])[:, np.newaxis] * pull
    path = QuasiStatic(system, 1e-10)
    assert (path.condensed is not None) == alone
    slips = assert_levels(system, path, forces)
    again = path.afresh(path.to)
    assert again.solves == 0
    found = assert_levels(system, again, forces)  # whatever was followed before
    np.testing.assert_allclose(found, slips, rtol=0, atol=1e-6 * np.abs(slips).max())


def test_a_level_takes_one_solve_and_factors_are_kept_where_they_serve():
    system = plate(("left",), 10)
    path = QuasiStatic(system)
    path.follow(6e3 * np.linspace(0.1, 1.0, 10)[:, np.newaxis] * system.loads[0].vector)
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


@pytest.mark.parametrize(
    "system",
    [plate((), 8), plate((), 8, (0.3, 1.0)), plates(("lower_left",))],
    ids=["pulled", "turned", "plates"],
)
def test_there_are_levels_up_to_the_limit_of_rigid_motions(system):
    """Of a plate that slides and turns when it is pulled at an edge, and of one on another."""
    force, path = 1e3 * system.loads[0].vector, QuasiStatic(system, 1e-10)
    limit = path.limit(force)
    assert path.solves == 0
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
