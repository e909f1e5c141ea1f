"""Contact that opens at points of one's own matrices, given by rows or by pairs of nodes."""

from typing import Any

import numpy as np
import pytest
from benchmarks.slider import HOLDS, MASS, MU, PRESSED, SPRING, X, followed, loop_energy, slider
from opening_blocks import block, loads

import skfem_joint as sj
from skfem_joint.structure.matrices import MatrixModel

ONE = np.ones(1)


def wedge(stiffness: float) -> sj.System:
    """An elastic slider whose normal force grows with its own displacement, X sin(2 pi t)."""
    foot = sj.point_contact(
        ONE, ONE, friction=MU, force=PRESSED, normal_stiffness=stiffness, stiffness=SPRING
    )
    load = {"along": (0, sj.Harmonic(HOLDS * X, 1.0))}
    matrices = MASS * np.eye(1), HOLDS * np.eye(1), 1e-3 * MASS * np.eye(1)
    return sj.System.from_matrices(*matrices, contact=foot, loads=load)


@pytest.mark.parametrize("solve", [sj.quasi_static, sj.integrate])
def test_a_normal_force_that_grows_with_the_slip_has_the_loop_of_its_closed_form(solve):
    """The contact is stiff against approach, so that the load has to move it by more."""
    varies, errors = 150.0, []
    for steps in (50, 100, 200):
        run = solve(wedge(varies / X), cycles=2, steps_per_cycle=steps)
        errors.append(abs(run.cycles.friction[-1] / loop_energy(varies) - 1.0))
        assert run.energy_residual < 1e-8  # of 5 kJ in what prescribes the slip
    assert errors[2] < 2e-3
    assert 8.0 * errors[2] < errors[0]


@pytest.mark.parametrize("model", [lambda s: s, sj.condense, lambda s: sj.reduce(s, modes=1)])
def test_a_slider_that_lifts_off_as_it_moves_back_loses_its_force(model):
    varies, steps = 350.0, 400
    run = sj.quasi_static(model(wedge(varies / X)), cycles=2, steps_per_cycle=steps)
    _, energy = followed(varies, 0.0, 2, steps)
    assert run.opened.all()
    assert run.cycles.friction[-1] == pytest.approx(energy, rel=5e-3)


def test_rows_give_the_system_that_is_made_by_hand():
    known = slider(350.0, 1.0)
    foot = sj.point_contact([1.0, 0.0], [0.0, 1.0], friction=MU, force=PRESSED, stiffness=SPRING)
    applied = {load.on: (load.vector, load.amplitude) for load in known.loads}
    system = sj.System.from_matrices(known.M, known.K, known.C, contact=foot, loads=applied)
    runs = [sj.quasi_static(s, cycles=2, steps_per_cycle=50) for s in (known, system)]
    assert np.array_equal(runs[0].point_u, runs[1].point_u)
    assert np.array_equal(runs[0].friction_work, runs[1].friction_work)


#: Two masses along x, the second one also across, y, where it is pressed on a rigid base.
K_CHAIN = np.array([[8e4, -4e4, 0.0], [-4e4, 4e4, 0.0], [0.0, 0.0, 2e5]])
M_CHAIN, C_CHAIN = np.diag([1.0, 1.0, 0.5]), 3e-4 * K_CHAIN + np.diag([0.0, 0.0, 60.0])
HOLD, ACROSS, SLIDER, PULL, LIFT = 300.0, 2e5, 2e5, 150.0, 800.0


def chain() -> sj.System:
    """Two masses with an elastic dry friction element that is lifted off twice a period."""
    foot = sj.point_contact(
        [0.0, 1.0, 0.0],
        [0.0, 0.0, 1.0],
        friction=0.3,
        force=HOLD,
        normal_stiffness=ACROSS,
        stiffness=SLIDER,
        name="foot",
    )
    pull, lift = (0, sj.Harmonic(PULL, 15.0)), (2, sj.Harmonic(LIFT, 30.0))
    return sj.System.from_matrices(
        M_CHAIN,
        K_CHAIN,
        C_CHAIN,
        contact=foot,
        loads={"pull": pull, "lift": lift},
        points={"end": 1},
    )


def stepped(cycles: int, steps: int) -> tuple[np.ndarray, float]:
    """The chain in small central steps: its displacements, and the friction energy of the end.

    In each step the spring is stretched by the slip and its force cut to the limit of the time.
    """
    h, u, v, q, energy = 1.0 / (15.0 * steps), np.zeros(3), np.zeros(3), 0.0, 0.0
    history = np.zeros((cycles * steps + 1, 3))
    inverse = np.linalg.inv(M_CHAIN + 0.5 * h * C_CHAIN)
    slows = M_CHAIN - 0.5 * h * C_CHAIN
    for j in range(cycles * steps):
        turn = 2.0 * np.pi * 15.0 * h * j
        p = max(HOLD + ACROSS * u[2], 0.0)
        force = np.array([PULL * np.sin(turn), -q, LIFT * np.sin(2.0 * turn) - (p - HOLD)])
        v = inverse @ (slows @ v + h * (force - K_CHAIN @ u))
        u = u + h * v
        limit = 0.3 * max(HOLD + ACROSS * u[2], 0.0)
        tried = q + SLIDER * h * v[1]
        q = min(max(tried, -limit), limit)
        if j >= (cycles - 1) * steps:
            energy += q * (tried - q) / SLIDER
        history[j + 1] = u
    return history, energy


@pytest.mark.parametrize("model", [lambda s: s, sj.condense])
def test_a_chain_with_an_elastic_slider_that_is_lifted_off_moves_as_in_small_steps(model):
    cycles, steps, fine = 2, 800, 25
    run = sj.integrate(model(chain()), cycles=cycles, steps_per_cycle=steps)
    known, energy = stepped(cycles, steps * fine)
    assert run.opened.all()
    assert run.friction_energy["foot"] > 1.5 * run.cycles.friction[0]
    end, lift = run.point("end"), run.point("lift")
    assert np.abs(end - known[::fine, 1]).max() < 2e-3 * np.abs(end).max()
    assert np.abs(lift - known[::fine, 2]).max() < 2e-3 * np.abs(lift).max()
    assert run.cycles.friction[-1] == pytest.approx(energy, rel=3e-3)
    assert run.energy_residual < 1e-9


def test_a_saved_model_whose_point_slips_as_it_approaches_runs_to_the_same_bits(tmp_path):
    system = wedge(3.5e5)
    same = sj.load(sj.save(system, tmp_path / "wedge.npz"))
    runs = [sj.integrate(s, cycles=1, steps_per_cycle=50) for s in (system, same)]
    assert np.array_equal(runs[0].point_u, runs[1].point_u)
    assert np.array_equal(runs[0].friction_work, runs[1].friction_work)


def stops(masses: int = 1, stiffness: float = 3.0) -> sj.System:
    """A chain of masses on springs of 1 N/m; the last one between two stops, 0.1 m away."""
    n, row = masses, np.eye(masses)[-1]
    both = [
        sj.point_contact(None, side * row, friction=0.0, gap=0.1, normal_stiffness=stiffness)
        for side in (1.0, -1.0)
    ]
    K = 2.0 * np.eye(n) - np.eye(n, k=1) - np.eye(n, k=-1)
    K[-1, -1] = 1.0
    load = {"end": (row, sj.Harmonic(1.0, 0.1))}
    return sj.System.from_matrices(np.eye(n), K, 0.05 * K, contact=both[0] + both[1], loads=load)


def test_a_mass_between_two_elastic_stops_is_held_by_each_in_turn():
    run = sj.quasi_static(stops(), cycles=1, steps_per_cycle=40)
    force = run.amplitudes[:, 0]
    known = np.where(np.abs(force) < 0.1, force, np.sign(force) * (np.abs(force) + 0.3) / 4.0)
    assert run.point("end") == pytest.approx(known, abs=1e-8)
    assert run.energy_residual < 1e-9


def test_a_condensed_chain_keeps_stops_without_friction():
    whole = stops(masses=6)
    small = sj.condense(whole, interface_modes=5)
    runs = [sj.integrate(s, cycles=1, steps_per_cycle=100) for s in (whole, small)]
    assert runs[0].normal_force_peak.min() > 0.0
    assert runs[1].point_u == pytest.approx(runs[0].point_u, abs=1e-9)


def test_condensed_sliders_share_a_slip():
    """Elastic sliders side by side, as those of Iwan's models."""
    row = np.eye(4)[3]
    some = [sj.point_friction(row, limit, stiffness=20.0) for limit in (0.1, 0.3)]
    K = 20.0 * (2.0 * np.eye(4) - np.eye(4, k=1) - np.eye(4, k=-1))
    load = {"end": (0, sj.Harmonic(1.0, 0.3))}
    whole = sj.System.from_matrices(np.eye(4), K, 0.01 * K, contact=some[0] + some[1], loads=load)
    small = sj.condense(whole, interface_modes=3)
    runs = [sj.integrate(s, cycles=2, steps_per_cycle=100) for s in (whole, small)]
    assert runs[0].friction_work.min() > 0.0
    assert runs[1].friction_work == pytest.approx(runs[0].friction_work, rel=1e-8)


def as_pairs(structure: sj.Structure, **joint: Any) -> MatrixModel:
    """Matrices of a plane structure with the nodes of its joint on the base as pairs."""
    M, K = structure.matrices()
    (patch,) = structure.patches
    face = patch.opening
    rows = np.full((face.nodes.size, 10), np.nan)
    rows[:, :2] = 2 * face.nodes[:, None] + np.arange(2)
    rows[:, 6:9], rows[:, 9] = 7.0 * np.array([0.0, -1.0, 0.0]), face.area  # of any length
    values = {"pressure": patch.joint.pressure, "friction": 0.5, "contact": "unilateral"} | joint
    points = {}
    for load in loads():
        shares = structure.body.even_shares(str(load.on))
        points[str(load.on)] = np.outer(shares, load.unit(2)).ravel()
    return MatrixModel(
        M,
        K,
        contacts={"base": rows},
        points=points,
        fixed=np.flatnonzero(structure.held),
        joints=[sj.Joint("base", **values)],
        stiffness_damping=2e-7,
    )


@pytest.mark.parametrize(
    "joint",
    [{}, {"normal_stiffness": 1e14, "tangential_stiffness": 1e14}],
    ids=["rigid", "elastic"],
)
def test_a_block_given_by_its_matrices_opens_as_its_mesh(joint):
    mesh = block(**joint)
    given = as_pairs(mesh, **joint)
    forces = [sj.Load(str(load.on), load.amplitude) for load in loads()]
    systems = mesh.system(loads(), points=[]), given.system(forces, points=[])
    runs = [sj.integrate(s, cycles=1, steps_per_cycle=60) for s in systems]
    assert runs[0].opened.any()
    assert runs[1].point_u == pytest.approx(runs[0].point_u, rel=0, abs=1e-9 * runs[0].peak.max())
    assert runs[1].friction_energy == pytest.approx(runs[0].friction_energy, rel=1e-9)
    assert runs[1].normal_force_peak.max() == pytest.approx(runs[0].normal_force_peak.max())


PAIR = np.array([[0.0, 1.0, np.nan, np.nan, np.nan, np.nan, 0.0, 1.0, 0.0, 2.0, 0.0]])


def model(pairs: Any = PAIR, fixed: Any = (), **joint: Any) -> MatrixModel:
    values = {"pressure": 5.0, "friction": 0.5, "contact": "unilateral"} | joint
    joints, unit = [sj.Joint("foot", **values)], np.eye(3)
    return MatrixModel(
        unit, unit, contacts={"foot": np.array(pairs)}, fixed=np.array(fixed, int), joints=joints
    )


def test_pairs_with_gaps_are_apart_at_rest_and_the_others_pressed():
    other = PAIR.copy()
    other[0, [0, 1, 10]] = [2.0, np.nan, 0.3]
    other[0, 6:9] = [1.0, 0.0, 0.0]
    normal = model(np.vstack([PAIR, other]), normal_stiffness=4.0).unloaded.contact.normal
    assert normal.force.tolist() == [10.0, 0.0]
    assert normal.gap.tolist() == [0.0, 0.3]
    assert normal.stiffness.tolist() == [8.0, 8.0]
    even = model(pressure=0.0, gap=0.1).unloaded.contact
    assert even.normal.gap.tolist() == [0.1]
    assert even.w.tolist() == [0.0]
    assert even.limits(np.ones(1)).tolist() == [0.5]


def changed(column: int, value: float) -> np.ndarray:
    pairs = PAIR.copy()
    pairs[0, column] = value
    return pairs


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"pairs": changed(10, -1.0)}, "contact.foot: pair 1, found .*gap must be a finite number"),
        ({"pairs": changed(10, 0.1), "contact": "constant"}, "a gap needs contact = 'unilateral'"),
        ({"gap": 0.1}, "joint 'foot': found a pressure beside gap = 0.1 m"),
        ({"fixed": [1]}, "no pair with an area has a degree of freedom along its normal"),
        (
            {"pairs": PAIR[:, [*range(11), 10]]},
            "must have 10 columns.*one more where pairs have ga",
        ),
        ({"pairs": np.vstack([PAIR, PAIR])}, "slips depend on each other|slip rows depend"),
    ],
)
def test_what_is_wrong_with_pairs_that_open_is_reported(given, said):
    with pytest.raises(sj.InputError, match=said):
        model(**given)


@pytest.mark.parametrize(
    ("given", "said"),
    [
        ({"approach": [0.0, 0.0]}, "approach: found a row of shape"),
        ({"approach": [[0.0, 1.0]]}, "approach: found a row of shape"),
        ({"approach": [np.nan, 1.0]}, "approach: found a row of shape"),
        ({"slip": [0.0, 0.0]}, "found rows of shape"),
        ({"friction": -0.1}, "friction: found -0.1, must be >= 0"),
        ({"slip": None}, "friction: found 0.3 without a slip"),
        ({"force": -1.0}, "force: found -1.0, must be >= 0"),
        ({"gap": np.inf}, "gap: found inf, must be >= 0"),
        ({"force": 1.0, "gap": 1e-3}, "found force = 1 N beside gap = 0.001 m"),
        ({"normal_stiffness": 0.0}, "normal_stiffness: found 0.0, must be > 0"),
        ({"stiffness": 0.0}, "stiffness: found 0.0, must be > 0"),
        ({"name": ""}, "found name ''"),
    ],
)
def test_what_a_point_contact_cannot_have_is_refused(given, said):
    values = {"slip": [1.0, 0.0], "approach": [0.0, 1.0], "friction": 0.3} | given
    with pytest.raises(sj.InputError, match=said):
        sj.point_contact(**values)


@pytest.mark.parametrize(
    "contact",
    [
        sj.point_contact([1.0, 0.0], [1.0, 0.0], friction=0.3, stiffness=1.0),
        sj.point_contact(None, [1.0, 0.0], friction=0.0, gap=0.1)
        + sj.point_contact(None, [-1.0, 0.0], friction=0.0, gap=0.1),
    ],
    ids=["slip", "other side"],
)
def test_rigid_points_that_share_a_displacement_are_refused_with_the_cure(contact):
    with pytest.raises(sj.InputError, match="give all that open a finite normal_stiffness"):
        sj.System.from_matrices(np.eye(2), np.eye(2), contact=contact)
