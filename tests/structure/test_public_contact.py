"""Friction on matrices of one's own: any basis, rows of one's own, and what is refused."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import skfem
from bodies import ELEMENTS, LAP, SIDE, block, lap, pressed, side, structure
from own_matrices import basis_of, matrices
from scipy import sparse

import skfem_joint as sj
from skfem_joint.system.unknowns import change_of_unknowns


def same_up_to_order(one: sj.System, two: sj.System) -> None:
    """Natural frequencies, open and closed, limits, directions, laws and pressure points agree."""
    how = {"k": 6, "sigma": 0.0, "return_eigenvectors": False}
    for pair in ((one, two), (one.closed(), two.closed())):
        values = [
            np.sort(sparse.linalg.eigsh(s.K + 1e3 * s.M, M=s.M, v0=np.ones(s.n), **how))
            for s in pair
        ]
        np.testing.assert_allclose(values[0], values[1], rtol=1e-7)
    np.testing.assert_allclose(np.sort(one.contact.w), np.sort(two.contact.w), rtol=1e-12)
    for name in ("gap", "force", "stiffness", "area"):
        points = (np.sort(getattr(s.contact.normal, name)) for s in (one, two))
        np.testing.assert_allclose(*points, rtol=1e-12)
    np.testing.assert_array_equal(np.sort(one.contact.directions), np.sort(two.contact.directions))
    assert np.isinf([one.contact.beta, two.contact.beta]).all()  # the default law is Coulomb's


BLOCKS = [(block(*kind, 2, (0.2, 0.1, 0.1)), pressed("base"), "right") for kind in ELEMENTS[1:]]
CELLS = [(body, pressed(), "right") for body, *_ in BLOCKS if body.dim == 2]
LIFTING = [pressed("base", contact="unilateral", normal_stiffness=k) for k in (np.inf, 1e13)]
OPENING = [(body, joint, "right") for body, *_ in BLOCKS for joint in LIFTING]
PAIRS = [(lap(), LAP, "lower_left"), (side(), SIDE, "lower_left")]


@pytest.mark.parametrize(("body", "joint", "fixed"), [*BLOCKS, *CELLS, *PAIRS, *OPENING])
def test_contact_on_a_basis_is_that_of_the_structure(body, joint, fixed):
    plane = "strain" if body.dim == 2 else "stress"
    mine = structure(body, [joint], [fixed], plane=plane, incompatible=False).system()
    basis, depth = basis_of(body), 0.01 if body.dim == 2 else 1.0
    rows = sj.contact(
        basis, joint.on, pressure=8e6, friction=0.7, against=joint.against, thickness=depth,
        contact=joint.contact, normal_stiffness=joint.normal_stiffness,
    )  # fmt: skip
    theirs = {"fixed": basis.get_dofs(fixed), "contact": rows}
    same_up_to_order(mine, sj.System.from_matrices(*matrices(basis, depth), **theirs))


def chain(n: int = 12) -> tuple[sparse.csr_array, sparse.csr_array]:
    off = -np.ones(n - 1)
    K = sparse.diags_array([2 * np.ones(n), off, off], offsets=[0, 1, -1])
    return sparse.csr_array(sparse.eye_array(n)), sparse.csr_array(K)


def test_rows_of_ones_own_become_unknowns_and_displacements_come_back():
    M, K = chain()
    rows = [np.eye(12)[3] - np.eye(12)[7], np.eye(12)[5] + 0.5 * np.eye(12)[6]]
    joint = sj.point_friction(rows[0], 10.0) + sj.point_friction(rows[1], 5.0, beta=1e4)
    system = sj.System.from_matrices(
        M, K, fixed=[0], contact=joint,
        loads={"tip": (11, lambda t: 3.0 * np.sin(t))}, points={"mean": np.full(12, 1 / 12)},
    )  # fmt: skip
    u = np.random.default_rng(0).normal(size=system.n)
    full = system.expand(u)
    assert full[0] == 0.0
    np.testing.assert_allclose(system.contact.B @ u, np.array(rows) @ full, rtol=1e-12)
    np.testing.assert_array_equal(system.contact.B.data, 1.0)
    np.testing.assert_allclose(u @ (system.K @ u), full @ (K @ full), rtol=1e-12)
    np.testing.assert_allclose(system.P @ u, [full[11], full.mean()], rtol=1e-12)
    assert system.points == ("tip", "mean")
    np.testing.assert_allclose(system.load_amplitudes(np.array([0.5])), [[3.0 * np.sin(0.5)]])
    # The same rows, taken first as they are.
    plain = sj.System(
        M=M, C=None, K=K, contact=sj.Contact(sparse.csr_array(np.array(rows)), [10.0, 5.0], 1e4)
    )
    inner, arrangement = plain.with_slips_as_unknowns()
    q = np.random.default_rng(1).normal(size=inner.n)
    np.testing.assert_allclose(
        plain.contact.B @ (arrangement.forward @ q), inner.contact.B @ q, rtol=1e-12
    )
    np.testing.assert_allclose(arrangement.inverse @ (arrangement.forward @ q), q, rtol=1e-12)


def test_slip_rows_may_have_indices_of_any_width():
    rows = sparse.csr_array(np.array([[0.0, 2.0, -1.0, 0.0], [1.0, 0.0, 0.5, 0.0]]))
    rows.indices, rows.indptr = (at.astype(np.int64) for at in (rows.indices, rows.indptr))
    new = change_of_unknowns(4, np.array([3]), sparse.csr_array((0, 4)), rows)
    expected = np.column_stack([np.eye(3), np.zeros(3)])
    np.testing.assert_allclose((new.inverse @ new.forward).toarray(), np.eye(3), atol=1e-15)
    np.testing.assert_allclose((new.forward @ new.inverse).toarray()[:3], expected, atol=1e-15)
    np.testing.assert_allclose((rows @ new.forward).toarray(), np.eye(3)[new.slips], atol=1e-15)


def test_a_point_with_two_directions_keeps_the_norm_of_its_slip_beside_supports():
    M, K = chain(6)
    rows = np.zeros((2, 6))
    rows[:, 2:4] = np.array([[0.6, 0.8], [-0.8, 0.6]])
    free = sj.System.from_matrices(M, K, contact=sj.point_friction(rows, 1.0))
    held = sj.System.from_matrices(M, K, fixed=[2], contact=sj.point_friction(rows, 1.0))
    gone = sj.System.from_matrices(M, K, fixed=[2, 3], contact=sj.point_friction(rows, 1.0))
    assert [list(s.contact.directions) for s in (free, held, gone)] == [[2], [1], []]
    u = np.random.default_rng(0).normal(size=held.n)
    np.testing.assert_allclose(
        held.contact.slip_norm(held.contact.B @ u), abs(held.expand(u)[3]), rtol=1e-12
    )


def test_notes_of_a_contact_outlive_a_support_that_touches_it():
    M, K = chain(6)
    touched = sj.point_friction(np.eye(6)[1] - np.eye(6)[0], 1.0, name="lap")
    lost = sj.point_friction(np.eye(6)[0], 1.0, name="foot")
    contact = replace(touched, notes=("Faces are apart.",)) + lost
    system = sj.System.from_matrices(M, K, fixed=[0], contact=contact)
    held = "Joint 'foot' carries no friction: supports hold all of it."
    assert {"Faces are apart.", held} <= {*system.notes}


M_4, K_4 = chain(4)
CROOKED = K_4 - 0.1 * sparse.eye_array(4, k=1)
SAME = sj.point_friction(np.eye(4)[1], 1.0)
FORCE = sj.Harmonic(1.0, 1.0)


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"K": CROOKED}, "K: is not symmetric"),
        ({"K": -K_4}, r"K: is indefinite.*; found -2 for unknown \d+$"),
        ({"M": sparse.diags_array([1.0, 1.0, 0.0, 1.0])}, "M: is not positive definite"),
        ({"K": K_4[:3, :3]}, r"K: found shape \(3, 3\), must be \(4, 4\)"),
        ({"K": K_4 * np.nan}, "K: must be finite"),
        ({"C": CROOKED}, "C: is not symmetric.*gyroscopic"),
        ({"fixed": [7]}, "fixed: found"),
        ({"fixed": np.array([False, True, False, True])}, "mask"),
        ({"loads": {"a": (np.ones(3), FORCE)}}, r"load 'a': found shape \(3,\), must be \(4,\)"),
        ({"loads": {"a": (9, FORCE)}}, "load 'a': found 9, must be .* from 0 to 3"),
        ({"loads": {"a": 3}}, "load 'a': found int, must be two in a tuple: a vector of shape"),
        ({"loads": {"a": (3, FORCE, 1)}}, "load 'a': found tuple, must be two"),
        ({"damping_ratio": "a"}, "damping.ratio: found 'a', must be above 0 and below 1"),
        ({"points": {"a": np.full(4, np.nan)}}, "point 'a': .* finite"),
        ({"loads": {"a": (1, FORCE)}, "points": {"a": -np.eye(4)[1]}}, "points: 'a' is a load"),
        ({"contact": sj.SlipRows.none(3)}, "contact: B: found shape"),
        ({"C": K_4, "stiffness_damping": 1e-3}, "beside C"),
        ({"C": K_4, "mass_damping": 1e-3}, "beside C"),
        ({"fixed": [1], "loads": {"a": (1, FORCE)}}, "load 'a': what holds the structure takes"),
        ({"contact": SAME + SAME}, "depend on each other"),
        ({"contact": [SAME, SAME]}, "depend on each other"),
        ({"contact": [SAME, "lap"]}, "contact: found str, must be what contact, .* or a list"),
    ],
)
def test_matrices_that_would_be_wrong_in_silence_are_refused(changes, match):
    values: dict[str, Any] = {"M": M_4, "K": K_4} | changes
    with pytest.raises(sj.InputError, match=match):
        sj.System.from_matrices(values.pop("M"), values.pop("K"), **values)


def test_a_system_takes_what_is_plain_and_refuses_what_does_not_fit():
    contact = sj.Contact(sparse.eye_array(4, format="csr")[:2], [1.0, 2.0], 1e5)
    plain = sj.System(M=M_4, C=None, K=K_4, contact=contact)
    assert abs(plain.C).max() == 0.0
    np.testing.assert_array_equal(plain.contact.beta, [1e5, 1e5])
    for make, match in (
        (lambda: replace(plain, K=K_4[:, :3]), r"K: found shape \(4, 3\)"),
        (lambda: plain.with_contact(given=-plain.contact.w), "given: friction limits"),
        (lambda: plain.with_beta(np.nan), "beta: found nan, must be > 0"),
        (lambda: plain.with_damping_ratio("a"), "damping.ratio: found 'a', must be above 0"),
        (lambda: plain.with_damping_ratio(1.5), "damping.ratio: found 1.5, must be above 0"),
        (lambda: plain.expand(3), r"expand: u: found shape \(\), must be \(4,\)"),
        (
            lambda: plain.expand(np.ones((2, 3))),
            r"expand: u: found shape \(2, 3\), must be \(2, 4\)",
        ),
        (lambda: plain.project(np.ones((3, 2))), "basis: found shape"),
        (lambda: replace(plain, T=np.ones((5, 3))), "T: found shape"),
        (lambda: sj.System(M_4, None, K_4, contact.B), r"found csr_array, must be an sj\.Contact"),
    ):
        with pytest.raises(sj.InputError, match=match):
            make()


TABLE = sj.PressureTable((0, 1), (1, 1), (1, 0, 0))
BOLTS = sj.Bolts((sj.Bolt((0.0, 2.0), 1.0, 0.1),))


@pytest.mark.parametrize(
    ("changes", "match"),
    [
        ({"on": "joint", "against": "rest"}, "belong to the same body"),
        ({"pressure": TABLE}, "pressure.axis"),
        ({"on": "base", "pressure": BOLTS}, "bolts press areas"),
        ({"thickness": 0.0}, "contact: thickness: found 0.0"),
        ({"width": np.nan}, "contact: width: found nan"),
        ({"fixed": [1000]}, "fixed: found 1000, must be"),
        ({"name": " "}, "contact: found name ' '"),
        ({"pressure": None}, "pressure: missing"),
        ({"contact": "sticky"}, "contact: found 'sticky'"),
        ({"contact": "unilateral", "clearance": 1e-5}, "unexpected argument 'clearance'"),
    ],
)
def test_contact_is_refused_for_what_a_joint_of_a_structure_is_refused_for(changes, match):
    values: dict[str, Any] = {"on": "joint", "pressure": 1e6, "friction": 0.5} | changes
    values = {key: value for key, value in values.items() if value is not None}
    with pytest.raises(sj.InputError, match=match):
        sj.contact(basis_of(block("quad")), values.pop("on"), **values)


def test_a_basis_that_is_none_of_displacements_is_refused():
    beam = skfem.Basis(skfem.MeshLine().with_subdomains({"all": [0]}), skfem.ElementLineHermite())
    with pytest.raises(sj.InputError, match="point_friction"):
        sj.contact(beam, "all", pressure=1e6, friction=0.5)


@pytest.mark.parametrize("form", [list, tuple, np.array, lambda x: np.array(x, dtype=np.int32)])
def test_fixed_may_be_numbers_in_any_form(form):
    system = sj.System.from_matrices(M_4, K_4, fixed=form([3, 1]))
    assert system.expand(np.ones(2)).tolist() == [1, 0, 1, 0]


def test_the_only_unknown_of_a_system_is_named_by_its_number():
    system = sj.System.from_matrices(
        np.eye(1), np.eye(1), loads={"push": (0, np.sin)}, points={"m": 0, "twice": [2.0]}
    )
    assert system.P.toarray().ravel().tolist() == [1.0, 1.0, 2.0]
    assert system.loads[0].vector.tolist() == [1.0]
    with pytest.raises(sj.InputError, match=r"point 'm': found 1, must be .* from 0 to 0"):
        sj.System.from_matrices(np.eye(1), np.eye(1), points={"m": 1})


def test_contacts_of_a_sum_keep_their_names_and_energies_apart():
    """Points of one name are one joint, wherever they stand in the sum."""
    M, K = chain(4)
    rows = np.eye(4)
    limits = {0: 1.0, 1: 2.0, 3: 4.0}
    names = {0: "left", 1: "right", 3: "left"}
    parts = [sj.point_friction(rows[k], limits[k], 1e4, name=names[k]) for k in names]
    loads = {"tip": (rows[2], sj.Harmonic(50.0, 40.0))}
    system = sj.System.from_matrices(M, K, contact=parts[0] + parts[1] + parts[2], loads=loads)
    listed = sj.System.from_matrices(M, K, contact=parts, loads=loads)
    np.testing.assert_array_equal((listed.contact.B - system.contact.B).toarray(), 0.0)
    assert listed.contact.w.tolist() == [1.0, 2.0, 4.0]
    assert system.contact.joints == ("left", "right")
    run = sj.integrate(system, cycles=1, steps_per_cycle=50)
    work = run.friction_work
    assert np.all(work > 0.0)
    energies = {"left": work[0] + work[2], "right": work[1]}
    assert run.friction_energy == pytest.approx(energies, rel=1e-12)


def test_contacts_are_named_as_the_part_of_the_mesh_unless_named_otherwise():
    basis = basis_of(block("quad", 1, 2, (0.2, 0.1)))
    how = {"pressure": 8e6, "friction": 0.7}
    both = sj.contact(basis, "base", **how) + sj.contact(basis, "top", name="lid", **how)
    M, K = matrices(basis)
    system = sj.System.from_matrices(M, K, fixed=basis.get_dofs("right"), contact=both)
    assert system.contact.joints == ("base", "lid")


def test_a_mass_without_stiffness_slides_until_friction_has_taken_its_energy():
    """From a velocity v it comes to rest after m v^2 / (2 w)."""
    mass, limit, speed, step = 2.0, 5.0, 3.0, 1e-3
    system = sj.System.from_matrices([[mass]], [[0.0]], contact=sj.point_friction([1.0], limit))
    assert sj.natural_modes(system, 1).frequencies == [0.0]
    run = sj.integrate(system, step=step, n_steps=2000, initial=(np.zeros(1), np.array([speed])))
    assert run.friction_work.sum() == pytest.approx(0.5 * mass * speed**2, rel=1e-12)
    exact = mass * speed**2 / (2.0 * limit)
    assert run.final[0][0] == pytest.approx(exact, abs=limit / mass * step**2)
    assert run.final[1][0] == 0.0


def test_a_light_stiff_body_that_floats_is_not_taken_for_an_indefinite_one():
    """Round-off of its stiffness is far above a shift by the frequencies of a heavy soft one."""
    k = np.random.default_rng(1).uniform(0.1, 1.0, 29)
    light = np.diag(np.append(k, 0.0) + np.append(0.0, k)) - np.diag(k, 1) - np.diag(k, -1)
    K = sparse.block_diag([1e9 * light, [[1.0]]])
    M = sparse.diags_array([*np.full(30, 1e-6), 1e6])
    contact = sj.point_friction(np.eye(31)[3], 1.0)
    assert sj.System.from_matrices(M, K, contact=contact).n == 31


def test_a_system_of_matrices_with_stored_zeros_keeps_its_own_whole():
    """Checks took zeros out of arrays that they shared, and left matrices with wrong indices."""
    K = sparse.csr_array(np.array([[2.0, -1.0, 3.0], [-1.0, 2.0, 3.0], [3.0, 3.0, 19.0]]))
    K.data[K.data == 3.0] = 0.0
    system = sj.System.from_matrices(sparse.csr_array(np.eye(3)), K, K.copy())
    for A in (K, system.K, system.C):
        assert A.indices.size == A.data.size == A.indptr[-1]
        assert A.tocoo().row.max() == 2
