"""Levels of a structure that floats, found in the unknowns of the contact alone."""

import logging
import tracemalloc

import numpy as np
import pytest
from scipy import sparse
from scipy.linalg import eigh

import skfem_joint as sj
from skfem_joint.reduction.stuck import Stuck
from skfem_joint.slow.levels import NoLevelError
from skfem_joint.slow.quasi_static import QuasiStatic
from skfem_joint.steady.steady import unstrained
from skfem_joint.stepping.arrangement import arranged
from skfem_joint.structure.parameters import value_of, with_values
from skfem_joint.system.modes import is_singular
from skfem_joint.system.rigid import floats, rigid_of
from skfem_joint.vibration import backbone


def plates(contact="constant", **support):
    """Two plates on each other, pressed where they lap; without a support they float."""
    upper = sj.build_box(
        [("a", 0.06, 4), ("b", 0.04, 4)], (0.02, 0.004), (2, 1), origin=(0.0, 0.0, 0.004),
        boundaries={"end": "left", "upper": ("front", "b")},
    )  # fmt: skip
    lower = sj.build_box(
        [("c", 0.04, 4), ("d", 0.06, 4)], (0.02, 0.004), (2, 1), origin=(0.06, 0.0, 0.0),
        boundaries={"far": "right", "lower": ("back", "c")},
    )  # fmt: skip
    joint = sj.Joint("upper", 2e6, 0.4, against="lower", contact=contact)
    steel = sj.Material(E=200e9, density=7800.0, poisson=0.3)
    return sj.Structure(sj.merged([upper, lower]), steel, joints=[joint], free=True, **support)


@pytest.fixture(scope="module")
def system():
    return plates().system()


def first_bending(system):
    """Inertia of the first mode that strains the stuck structure, and the level of first slip."""
    stuck = Stuck(arranged(system).system)
    return system.M @ stuck.modes(8)[1][:, 6]


def test_rigid_motions_are_those_of_supports_and_closed_contact(system):
    """Six of the whole, and three in which the upper plate slides on the lower one."""
    rigid = rigid_of(system)
    assert rigid.shape[1] == 9
    assert floats(system)
    assert is_singular(system.K)
    np.testing.assert_allclose(rigid.T @ (system.M @ rigid), np.eye(9), atol=1e-10)
    stiff = np.abs(system.K @ rigid).max() / (system.K.diagonal().max() * np.abs(rigid).max())
    assert stiff < 1e-13
    values = eigh(system.K.toarray(), system.M.toarray(), eigvals_only=True)
    assert np.count_nonzero(values < 1e-9 * values[-1]) == 9
    np.testing.assert_allclose(unstrained(system), rigid)


@pytest.mark.parametrize("held", [[], [0, 1, 2], np.arange(0, 300, 7)])
def test_given_matrices_know_their_rigid_motions_without_another_factor(system, caplog, held):
    """They are those of zero frequency; the factor of the check of signs finds them."""
    given = sj.System.from_matrices(system.M, system.K, fixed=held)
    values, modes = eigh(given.K.toarray(), given.M.toarray())
    motions = modes[:, values < 1e-9 * values[-1]]
    assert motions.shape[1] == {0: 9, 3: 6, 43: 0}[np.size(held)]
    with caplog.at_level(logging.DEBUG):
        rigid = rigid_of(given)
    assert not caplog.records  # of factors
    assert rigid.shape == motions.shape
    np.testing.assert_allclose(rigid @ (rigid.T @ (given.M @ motions)), motions, atol=1e-7)


def test_a_motion_that_several_rigid_ones_share_counts_once():
    """Only one node of the plate is free, along one direction, which turning it moves as well."""
    names = {"top": ("top", "j"), "l": "left", "r": "right", "bottom": "bottom"}
    plate = sj.build_plate([("a", 0.02, 2), ("j", 0.02, 2)], 0.005, 1, boundaries=names)
    steel = sj.Material(E=200e9, density=7800.0, poisson=0.3)
    held = sj.Structure(
        plate, steel, thickness=0.01, joints=[sj.Joint("top", 1e6, 0.3)],
        fixed=["bottom", "l"], fixed_y=["a", "j"], stiffness_damping=1e-6,
    )  # fmt: skip
    system = held.system([sj.Load("r", sj.Harmonic(200.0, 500.0), (1.0, 0.0))])
    assert rigid_of(system).shape == (system.n, 0)
    assert not floats(system)
    run = sj.integrate(system, cycles=1, steps_per_cycle=40, until="steady")
    assert run.peak.max() == pytest.approx(5.76e-8, rel=1e-2)


def test_contact_that_opens_leaves_twelve_rigid_motions_and_nine_where_it_is_closed():
    system = plates("unilateral").system()
    assert rigid_of(system).shape[1] == 12
    closed = system.closed()
    rigid = rigid_of(closed)
    assert rigid.shape[1] == 9
    stiff = np.abs(closed.K @ rigid).max() / (closed.K.diagonal().max() * np.abs(rigid).max())
    assert stiff < 1e-12


@pytest.mark.parametrize(("support", "count"), [
    ({"fixed": ["end"]}, 3), ({"fixed": ["end", "far"]}, 0), ({"fixed_x": ["end"]}, 6),
])  # fmt: skip
def test_supports_leave_as_many_rigid_motions_as_pivots_tell(support, count):
    """A face held along its normal leaves three of the whole, and the plates slide."""
    system = plates(**support).system()
    assert rigid_of(system).shape[1] == count
    assert is_singular(system.K) == floats(system) == (count > 0)


def test_levels_are_those_with_a_shift_of_all_unknowns(system):
    force = first_bending(system)
    alone, shifted = (QuasiStatic(system, 1e-10, in_contact=x) for x in (True, False))
    assert alone.still is not None
    assert shifted.still is None
    multiples = np.array([0.0, 5.0, 10.0, 20.0])
    multiples *= 0.02 / np.abs(system.contact.B @ force).sum()
    both = [p.walk(p.rest(), force, multiples * system.contact.w.sum()) for p in (alone, shifted)]
    slipped = 0.0
    for (one,), (other,) in zip(*both, strict=True):
        np.testing.assert_allclose(one[1].slip, other[1].slip, atol=1e-8 * np.abs(one[1].u).max())
        u = alone.still.placed(other[1].u)  # round-off of forces moves it over the shift
        np.testing.assert_allclose(one[1].u, u, atol=1e-8 * np.abs(u).max())
        slipped = max(slipped, np.abs(one[1].slip).max() / np.abs(one[1].u).max())
    assert slipped > 1e-4


def test_a_force_that_moves_the_whole_has_no_level(system):
    path = QuasiStatic(system, in_contact=True)
    push = np.asarray(system.M @ rigid_of(system)[:, :6].sum(axis=1))
    assert path.limit(push) == 0.0
    with pytest.raises(NoLevelError, match="neither a support nor friction"):
        path.next(path.rest(), push)


def test_stuck_modes_beside_rigid_motions_take_the_factor_of_the_path(system, caplog):
    path = QuasiStatic(system, in_contact=True)
    stuck = Stuck(system, path)
    with caplog.at_level(logging.DEBUG, "skfem_joint.linalg.factors"):
        frequency, shapes = stuck.modes(10)
    assert not caplog.records
    values = eigh(stuck.K.toarray(), stuck.M.toarray(), eigvals_only=True)[:10]
    np.testing.assert_allclose(frequency[6:] ** 2 * 4.0 * np.pi**2, values[6:], rtol=1e-8)
    np.testing.assert_array_equal(frequency[:6], 0.0)
    np.testing.assert_allclose(shapes.T @ (system.M @ shapes), np.eye(10), atol=1e-8)


@pytest.mark.parametrize("key", ["joint[0].friction", "material.E"])
def test_derivatives_of_a_floating_curve_are_its_differences(key, monkeypatch):
    monkeypatch.setattr(backbone, "TOLERANCE", 1e-10)
    structure = plates()
    (first,) = sj.backbone(structure.system(), modes=[7], levels=3)

    def curve(value=None):
        given = structure if value is None else with_values(structure, {key: value})
        return sj.backbone(given.system(), modes=[7], levels=first.level, keep_path=True)[0]

    value = value_of(structure, key)
    exact = sj.backbone_sensitivity(curve(), sj.sensitivities(structure, [key], structure.system()))
    above, below = (curve(value * (1.0 + step)) for step in (1e-4, -1e-4))
    for name in ("frequency", "friction_damping"):
        rate = (getattr(above, name) - getattr(below, name)) / (2e-4 * value)
        own = getattr(exact, name)[:, 0]
        scale = np.abs(getattr(first, name) / value)
        np.testing.assert_allclose(own, rate, rtol=1e-4, atol=1e-5 * scale.max())


def test_a_curve_factorises_the_stiffness_once_and_its_interior_once(system, caplog):
    """SuperLU needs both for a complement, PARDISO one of them; nothing else is factorised."""
    with caplog.at_level(logging.DEBUG, "skfem_joint.linalg.factors"):
        sj.backbone(system, modes=[7], levels=3)
    assert 1 <= len(caplog.records) <= 2


def test_a_reduced_model_of_a_structure_that_floats_has_its_curve(system):
    (curve,) = sj.backbone(system, modes=[7], levels=16)
    (small,) = sj.backbone(sj.reduce(system, curve=curve), modes=[7], levels=curve.level)
    np.testing.assert_allclose(small.frequency, curve.frequency, rtol=1e-3)
    most = curve.friction_damping.max()
    np.testing.assert_allclose(small.friction_damping, curve.friction_damping, atol=0.02 * most)


def beam(elements, spring=0.0, bending=1e4):
    """Stiffness and mass of a beam of 1 m and 1 kg, of EI ``bending``, on springs at its ends."""
    h = 1.0 / elements
    k = bending / h**3 * np.array(
        [[12, 6 * h, -12, 6 * h], [6 * h, 4 * h**2, -6 * h, 2 * h**2],
         [-12, -6 * h, 12, -6 * h], [6 * h, 2 * h**2, -6 * h, 4 * h**2]]
    )  # fmt: skip
    m = h / 420 * np.array(
        [[156, 22 * h, 54, -13 * h], [22 * h, 4 * h**2, 13 * h, -3 * h**2],
         [54, 13 * h, 156, -22 * h], [-13 * h, -3 * h**2, -22 * h, 4 * h**2]]
    )  # fmt: skip
    at = 2 * np.arange(elements)[:, np.newaxis] + np.arange(4)
    index = np.repeat(at, 4, axis=1).ravel(), np.tile(at, 4).ravel()
    K, M = (sparse.csr_array((np.tile(A.ravel(), elements), index)) for A in (k, m))
    ends = np.zeros(K.shape[0])
    ends[[0, -2]] = spring
    return sparse.csr_array(K + sparse.diags_array(ends)), M


@pytest.mark.parametrize(("elements", "spring"), [(100, 10.0), (400, 10.0), (400, 100.0)])
def test_weak_springs_of_a_fine_beam_hold_it(elements, spring):
    """Bounce and pitch have squares of 2 g / m and 6 g / m; the static deflection is f / (2 g)."""
    K, M = beam(elements, spring)
    row, force = np.zeros((2, K.shape[0]))
    row[[elements + 1, elements + 5]] = 1.0, -1.0
    force[[0, -2]] = 0.5
    system = sj.System.from_matrices(
        M, K, contact=sj.point_friction(row, 1.0, stiffness=1e4),
        loads={"ends": (force, sj.Harmonic(1.0, 0.05))}, stiffness_damping=1e-6,
    )  # fmt: skip
    assert rigid_of(system).shape[1] == 0
    expected = np.sqrt(np.array([2.0, 6.0]) * spring) / (2.0 * np.pi)
    for found in (
        sj.natural_modes(system, 3, joints="stuck").frequencies,
        Stuck(system).modes(3)[0],
    ):
        np.testing.assert_allclose(found[:2], expected, rtol=1e-3)
    run = sj.quasi_static(system, cycles=1, steps_per_cycle=40)
    assert run.peak[0] == pytest.approx(0.5 / spring, rel=1e-3)


@pytest.mark.parametrize("digits", [8, 10, 12])
def test_a_note_says_that_a_beam_of_few_digits_may_float(digits):
    """What entries of few digits lack acts as springs to the ground."""
    K, M = beam(10, bending=9876.54321 / 1.23457**3)
    K.data = np.array([float(f"{x:.{digits - 1}e}") for x in K.data])
    (note,) = sj.System.from_matrices(M, K).notes
    assert "nearly floats: 2 " in note
    assert "too few digits" in note


@pytest.mark.parametrize("held", [{}, {0: 1e4}, {0: 1e9, 1: 1e9}, {0: 1e9, -2: 1e9}])
@pytest.mark.parametrize("elements", [3, 30, 400])
def test_a_fine_beam_has_the_rigid_motions_that_its_supports_leave_and_no_note(elements, held):
    K, M = beam(elements)
    ends = np.zeros(K.shape[0])
    ends[list(held)] = list(held.values())
    system = sj.System.from_matrices(M, K + sparse.diags_array(ends))
    assert not system.notes
    assert rigid_of(system).shape[1] == max(2 - len(held), 0)
    assert sj.natural_modes(system, 3).rigid_motions == max(2 - len(held), 0)


@pytest.mark.parametrize(("elements", "spring"), [(400, 1.0), (800, 10.0)])
def test_a_note_says_which_springs_are_too_weak_to_count(elements, spring):
    K, M = beam(elements, spring)
    system = sj.System.from_matrices(M, K)
    assert rigid_of(system).shape[1] == 2
    (note,) = system.notes
    assert "are taken for rigid" in note


def test_a_note_says_that_the_shift_of_a_part_that_floats_shows_in_a_soft_one():
    """The beam of 1e-7 of the bending stiffness is clamped by springs of as much."""
    stiff, soft = beam(100), beam(100, bending=1e-3)
    ends = np.zeros(soft[0].shape[0])
    ends[:2] = 1e-3
    held = soft[0] + sparse.diags_array(ends)
    masses = sparse.block_diag([stiff[1], soft[1]])
    together = sj.System.from_matrices(masses, sparse.block_diag([stiff[0], held]))
    assert any("beside a soft one" in note for note in together.notes)
    alone = sj.System.from_matrices(soft[1], held)
    assert not any("beside a soft one" in note for note in alone.notes)


def test_a_stiff_part_that_friction_holds_leaves_a_soft_one_its_deflection():
    """A beam lies on two points of a clamped one and passes on its load, a half to each."""
    stiff, soft = beam(100, bending=1e4), beam(100, bending=1.0)
    K, M = (sparse.block_diag([a, b[2:, 2:]], "csr") for a, b in zip(stiff, soft, strict=True))
    rows, force = np.zeros((2, K.shape[0])), np.zeros(K.shape[0])
    rows[0, [0, 250]] = rows[1, [200, 400]] = 1.0, -1.0  # at a quarter and at the end
    force[100] = 1.0
    contact = sj.point_friction(rows[0], 1.0) + sj.point_friction(rows[1], 1.0)
    system = sj.System.from_matrices(
        M, K, contact=contact, loads={"middle": (force, sj.Harmonic(1e-3, 0.05))},
        stiffness_damping=1e-6,
    )  # fmt: skip
    assert not any("beside a soft one" in note for note in system.notes)
    a = 0.25
    both = 0.25 * (a**3 / 3.0 + 2.0 * a**2 * (3.0 - a) / 6.0 + 1.0 / 3.0)
    run = sj.quasi_static(system, cycles=1, steps_per_cycle=40)
    assert run.peak[0] == pytest.approx(1e-3 * (both + 1.0 / 48e4), rel=1e-4)


@pytest.mark.parametrize("turned", [False, True])
def test_memory_for_what_friction_alone_holds_grows_with_its_points(turned):
    """A square of the 2000 points would take 32 MB. A reduced model has some of its modes."""
    n = 2000
    force = np.eye(1, n)[0]
    ends = np.r_[1.0, np.full(n - 2, 2.0), 1.0]
    K = sparse.diags_array([ends, -np.ones(n - 1), -np.ones(n - 1)], offsets=[0, 1, -1])
    B, ones, closed = sparse.eye_array(n, format="csr"), np.ones(n), sparse.csr_array((0, n))
    contact = sj.SlipRows(B, ones, np.inf * ones, ones.astype(np.int64), closed)
    system = sj.System.from_matrices(
        B, K.tocsr(), contact=contact,
        loads={"end": (force, sj.Harmonic(2.5, 1.0))}, stiffness_damping=1e-6,
    )  # fmt: skip
    if turned:
        waves = np.cos(np.pi / n * np.outer(np.arange(n) + 0.5, np.arange(8)))
        system = system.project(waves / np.linalg.norm(waves, axis=0))
    QuasiStatic(system)  # loads the compiler
    tracemalloc.start()
    QuasiStatic(system)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 8e6
