"""Contact that opens at points of one's own matrices, given by rows or by pairs of nodes."""

from typing import Any

import numpy as np
import pytest
from benchmarks.slider import HOLDS, MASS, MU, PRESSED, SPRING, X, followed, loop_energy
from opening_blocks import block, loads

import skfem_joint as sj

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


def as_pairs(structure: sj.Structure, **joint: Any) -> sj.MatrixModel:
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
    return sj.MatrixModel(
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


def model(pairs: Any = PAIR, fixed: Any = (), **joint: Any) -> sj.MatrixModel:
    values = {"pressure": 5.0, "friction": 0.5, "contact": "unilateral"} | joint
    joints, unit = [sj.Joint("foot", **values)], np.eye(3)
    return sj.MatrixModel(
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
    scaled = model(np.vstack([PAIR, other]), gap_scale=2.0).unloaded.contact.normal
    assert scaled.gap.tolist() == [0.0, 0.6]
    even = model(pressure=0.0, gap=0.1).unloaded.contact
    assert even.normal.gap.tolist() == [0.1]
    assert even.w.tolist() == [0.0]
    assert even.limits(np.ones(1)).tolist() == [0.5]


def changed(column: int, value: float) -> np.ndarray:
    pairs = PAIR.copy()
    pairs[0, column] = value
    return pairs


def point(**given: Any) -> sj.System:
    values = {"slip": [1.0, 0.0], "approach": [0.0, 1.0], "friction": 0.3} | given
    return sj.System.from_matrices(np.eye(2), np.eye(2), contact=sj.point_contact(**values))


SHARED = "give all that open a finite normal_stiffness"


@pytest.mark.parametrize(
    ("make", "given", "said"),
    [
        (model, {"pairs": changed(10, -1.0)},
         "contact.foot: pair 1, found .*gap must be a finite number"),
        (model, {"pairs": changed(10, 0.1), "contact": "constant"}, "needs contact = 'unilateral'"),
        (model, {"gap": 0.1}, "joint 'foot': found a pressure beside gap = 0.1 m"),
        (model, {"gap": lambda x: x[:, 0], "pressure": 0.0},
         "joint 'foot': gap: found a field beside matrices.*column 11"),
        (model, {"fixed": [1]}, "no pair with an area has a degree of freedom along its normal"),
        (model, {"pairs": PAIR[:, [*range(11), 10]]},
         "must have 10 columns.*one more where pairs have ga"),
        (model, {"pairs": np.vstack([PAIR, PAIR])},
         "slips depend on each other|slip rows depend"),
        (point, {"approach": [0.0, 0.0]}, "approach: found a row of shape"),
        (point, {"approach": [[0.0, 1.0]]}, "approach: found a row of shape"),
        (point, {"approach": [np.nan, 1.0]}, "approach: found a row of shape"),
        (point, {"slip": [0.0, 0.0]}, "found rows of shape"),
        (point, {"friction": -0.1}, "friction: found -0.1, must be >= 0"),
        (point, {"slip": None}, "friction: found 0.3 without a slip"),
        (point, {"force": -1.0}, "force: found -1.0, must be >= 0"),
        (point, {"gap": np.inf}, "gap: found inf, must be >= 0"),
        (point, {"force": 1.0, "gap": 1e-3}, "found force = 1 N beside gap = 0.001 m"),
        (point, {"normal_stiffness": 0.0}, "normal_stiffness: found 0.0, must be > 0"),
        (point, {"stiffness": 0.0}, "stiffness: found 0.0, must be > 0"),
        (point, {"name": ""}, "found name ''"),
        (point, {"approach": [1.0, 0.0], "stiffness": 1.0}, SHARED),
        (sj.point_friction, {"row": np.zeros(4), "limit": 1.0}, "point_friction: found rows of"),
        (sj.point_friction, {"row": np.ones((3, 4)), "limit": 1.0}, "point_friction: found rows"),
        (sj.point_friction, {"row": ONE, "limit": 1.0, "name": 3}, "point_friction: found name 3"),
        (stops, {"stiffness": np.inf}, SHARED),
    ],
)  # fmt: skip
def test_contact_at_points_that_cannot_be_is_refused(make, given, said):
    with pytest.raises(sj.InputError, match=said):
        make(**given)
