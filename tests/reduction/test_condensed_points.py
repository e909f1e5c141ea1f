"""Merged contact points of condensed models: forces stay, errors are stated; SI units."""

from dataclasses import replace

import numpy as np
import pytest
import skfem
from scipy import sparse

import skfem_joint as sj
from skfem_joint.reduction.condensed_points import with_points
from skfem_joint.results.contact_history import GREY, contact_history, slip_state
from skfem_joint.results.history import difference, results

STEEL = sj.Material(E=200e9, density=7800.0, poisson=0.3)
TIMES = {"cycles": 2, "steps_per_cycle": 50}
SLOW = {"cycles": 2, "steps_per_cycle": 24}


def plate(size: tuple[int, int] = (10, 4), **options) -> sj.Structure:
    """Plate in plan of triangles, pressed on its base by two joints of other friction."""
    mesh = skfem.MeshTri.init_tensor(
        np.linspace(0.0, 0.2, 2 * size[0] + 1), np.linspace(0.0, 0.04, size[1] + 1)
    )
    mesh = mesh.with_subdomains(
        {
            "wide": lambda x: x[0] < 0.05,
            "narrow": lambda x: (x[0] > 0.05) & (x[0] < 0.1),
        }
    ).with_boundaries({"right": lambda x: x[0] > 0.2 - 1e-9})
    joints = [sj.Joint("wide", 4e6, 0.5), sj.Joint("narrow", 8e6, 0.3)]
    return sj.Structure(
        mesh, STEEL, thickness=0.01, joints=joints, stiffness_damping=1e-6, **options
    )


def loaded(structure: sj.Structure, force: float = 6e3) -> sj.System:
    load = sj.Load("right", sj.Harmonic(force, 500.0), (1.0, 0.2))
    return structure.system([load])


@pytest.fixture(scope="module")
def system() -> sj.System:
    return loaded(plate())


def even(contact: sj.Contact, direction: int) -> np.ndarray:
    """Friction forces on the unknowns where all points slip in a direction."""
    signs = np.zeros(contact.B.shape[0])
    signs[contact.first_row[:-1] + direction] = contact.w
    return np.asarray(contact.B.T @ signs)


def test_forces_of_joints_that_slip_as_a_whole_are_those_of_all_points(system):
    some = with_points(system, system.contact.count // 3)
    assert some.contact.count < system.contact.count / 2
    for direction in (0, 1):  # on every unknown, and so with all resultants and moments
        forces = even(system.contact, direction)
        np.testing.assert_allclose(
            even(some.contact, direction), forces, atol=1e-12 * np.abs(forces).max()
        )


def test_joints_keep_their_limits_and_points_of_two_are_not_merged(system):
    some = with_points(system, 20)
    np.testing.assert_allclose(
        some.contact.limits_by_joint.sum(axis=1),
        system.contact.limits_by_joint.sum(axis=1),
        rtol=1e-12,
    )
    own = sparse.csr_array(system.contact.J > 0.0).astype(float)
    members = sparse.csr_array(some.contact.shares > 0.0).astype(float)
    for row in members:  # the joints of the parts of a point are alike
        kinds = own[:, row.indices].toarray()
        assert np.all(kinds == kinds[:, :1])


def test_slips_of_rigid_motion_are_those_of_the_middle_of_the_parts(system):
    structure = plate()
    some = with_points(system, 30).contact
    x = structure.nodes
    node = np.zeros(system.contact.w.size, dtype=int)
    for patch in structure.patches:
        node[patch.points] = patch.nodes
    middle = some.shares @ x[node]
    turned = np.stack([-x[:, 1], x[:, 0]], axis=1).ravel()
    u = sparse.linalg.lsqr(structure.T, turned, atol=1e-15, btol=1e-15)[0]
    slip = (some.B @ u).reshape(-1, 2)
    np.testing.assert_allclose(slip, np.stack([-middle[:, 1], middle[:, 0]], axis=1), atol=1e-9)


def test_as_many_points_as_there_are_is_the_model_with_all(system):
    count = system.contact.count
    every, same = (sj.condense(system, 4, contact_points=x) for x in ("all", count))
    np.testing.assert_array_equal(every.K, same.K)
    assert with_points(system, count) is system


def test_statics_of_merged_points_are_exact_in_a_condensed_model(system):
    some = with_points(system, 25)
    small = sj.condense(system, 0, contact_points=25)
    slow = {"cycles": 1, "steps_per_cycle": 12, "save": sj.Save(fields=True)}
    full, run = (sj.quasi_static(one, **slow) for one in (some, small))
    u = system.expand(full.u)
    np.testing.assert_allclose(small.expand(run.u), u, atol=1e-7 * np.abs(u).max())
    energies = [one.friction_energy for one in (full, run)]
    assert energies[1] == pytest.approx(energies[0], rel=1e-6)


def test_a_note_says_how_many_points_are_merged(system):
    small = sj.condense(system, 2, contact_points=40)
    said = f"{system.contact.count} contact points are merged into {small.contact.count}"
    assert said in small.notes[-1]
    assert sj.condense(system, 2).notes == system.notes


def test_estimate_states_what_merged_points_cost(system):
    every, some = (
        sj.integrate(sj.condense(system, 4, contact_points=x), **TIMES) for x in ("all", 12)
    )
    true = difference(results(every), results(some))["friction_energy"]
    stated = sj.estimate(some)
    assert true > 1e-3
    assert stated.of("points", "friction_energy") == pytest.approx(true, rel=0.1)
    assert stated.of("total", "friction_energy") > stated.of("points", "friction_energy")


def test_friction_energy_of_half_of_the_points_is_that_of_all(system):
    load = 0.5 * system.loads[0].vector  # where a part of the joints slips
    system = replace(system, loads=(replace(system.loads[0], vector=load),))
    some, every = (
        sj.quasi_static(sj.condense(system, 0, contact_points=x), **SLOW).cycles.friction[-1].sum()
        for x in (system.contact.count // 2, "all")
    )
    assert some == pytest.approx(every, rel=5e-3)  # as by the mesh itself


def test_fields_on_all_points_have_the_forces_work_and_state_of_merged_ones():
    structure = plate((4, 3))
    small = sj.condense(loaded(structure), 4, contact_points=30)
    run = sj.integrate(small, **TIMES, save=sj.Save(fields=True))
    history = contact_history(structure, run)
    contact, merged = history.system.contact, small.contact
    work = np.asarray(contact.J @ history.work[-1])
    for name, own in zip(contact.joints, work, strict=True):
        assert own == pytest.approx(run.friction_energy[name], rel=1e-9)
    # Friction of all points is that of the model on every coordinate.
    V = small.origin.basis.V
    forces = (history.friction * contact.on_rows(contact.w)) @ (contact.B @ V)
    own = (run.sigma * merged.on_rows(merged.w)) @ merged.B
    np.testing.assert_allclose(forces, own, atol=1e-9 * np.abs(own).max())
    rate = merged.slip_norm((merged.B @ run.v.T).T)
    state = slip_state(rate, merged.beta, GREY)
    members = (merged.shares > 0.0).astype(float)
    np.testing.assert_array_equal(history.state, state @ members)
    assert 0 < np.count_nonzero(state) < state.size


def test_points_of_contact_that_opens_are_not_merged():
    mesh = sj.build_box([("block", 0.1, 4)], (0.03, 0.02), (2, 2))
    joint = sj.Joint("front", 4e6, 0.4, contact="unilateral")
    system = sj.Structure(mesh, STEEL, joints=[joint]).system(
        [sj.Load("right", sj.Harmonic(100.0, 500.0), (1.0, 0.0, 0.0))]
    )
    assert sj.condense(system, 2).contact.count == system.contact.count
    with pytest.raises(sj.InputError, match=r"contact_points: found 5, .* where contact opens"):
        sj.condense(system, 2, contact_points=5)
