"""Contact that opens on matrices of scikit-fem: the same system as that of a structure."""

from dataclasses import replace

import numpy as np
import pytest
import skfem
from bodies import block as solid_block
from opening_blocks import SIZE, STEEL, block
from own_matrices import basis_of, even_force, matrices
from scipy import sparse

import skfem_joint as sj

DEPTH = 0.1


def test_sums_of_contacts_keep_their_pressure_points():
    basis = basis_of(block().mesh)
    opens = sj.contact(basis, "base", friction=0.5, pressure=1e6, contact="unilateral")
    closed = sj.contact(basis, "top", friction=0.5, pressure=1e6)
    for both in (opens + closed, closed + opens):
        assert both.normal.part.gap.size == 4
        assert both.normal.gain.shape == (8, 4)
        points = both.normal.gain @ np.full(4, 1.0)
        assert np.array_equal(points > 0.0, np.array(both.names) == "base")


def held_block(shape, order, named: bool, penalty: float = 0.0):
    """Block pressed on a rigid base and held on one side, or there on springs of a penalty."""
    elements = 3 if shape == "quad" else 3 - order
    basis = basis_of(solid_block(shape, order, elements, (SIZE,) * 3))
    M, K = matrices(basis)
    held, up = basis.get_dofs("right").all(), basis.mesh.dim() - 1
    force = sj.Harmonic(30e6 * SIZE**up, 2000.0)
    loads = {name: (even_force(basis, name, k), force) for name, k in (("top", up), ("left", 0))}
    springs = np.zeros(K.shape[0])
    springs[held] = penalty * K.diagonal().max()
    fixed = [] if penalty else held
    contact = sj.contact(
        basis, "base", friction=0.5, pressure=20e6, contact="unilateral",
        fixed=fixed if named else (),
    )  # fmt: skip
    system = sj.System.from_matrices(
        M, K + sparse.diags_array(springs), C=2e-7 * K, fixed=fixed, contact=contact, loads=loads
    )
    if not penalty or order == 1:
        return system
    # Means over hats of nodes that are held take in their neighbours: their force is constant.
    opening, free = system.contact.normal, np.flatnonzero(~np.isin(contact.normal.pivots, held))
    values = {name: getattr(opening, name)[free] for name in ("gap", "force", "stiffness", "area")}
    opening = replace(opening, N=opening.N[free], **values)
    given = system.contact.w - system.contact.gain[:, free] @ opening.force
    given = np.maximum(given, 0.0)
    return system.with_contact(given=given, normal=opening, gain=system.contact.gain[:, free])


@pytest.mark.parametrize(
    ("shape", "order", "named"),
    [("quad", 1, False), ("quad", 2, True), ("hex", 1, True), ("hex", 2, False)],
)
def test_nodes_of_contact_that_supports_hold_are_those_on_stiff_springs(shape, order, named):
    system, springs = (held_block(shape, order, named, penalty) for penalty in (0.0, 1e6))
    a, b = (sj.integrate(s, cycles=1, steps_per_cycle=60) for s in (system, springs))
    assert a.opened.any()
    assert a.friction_work.sum() > 0.0
    np.testing.assert_allclose(a.point_u, b.point_u, atol=2e-4 * np.abs(b.point_u).max())


def test_a_node_held_across_its_contact_keeps_its_normal_force_and_rubs():
    """Of a plate and of matrices: what supports hold against approaching has a constant limit."""
    structure = replace(block(), fixed_x=(), fixed_y=["right"])
    basis = basis_of(structure.mesh)
    right = basis.get_dofs("right").all(["u^2"])
    joint = {"pressure": 50e6, "contact": "unilateral", "thickness": DEPTH, "friction": 0.5}
    own = {"fixed": right, "contact": sj.contact(basis, "base", **joint)}
    for system in (structure.system(), sj.System.from_matrices(*matrices(basis), **own)):
        whole = 0.5 * 50e6 * DEPTH * SIZE
        assert system.contact.w.size == 4
        assert system.contact.normal.gap.size == 3
        assert system.contact.w.sum() == pytest.approx(whole)
        assert np.sort(system.contact.given) == pytest.approx([0.0, 0.0, 0.0, whole / 6])


def test_a_node_that_is_held_along_x_approaches_a_slanted_base_by_its_share():
    """As all others: moved down by one, the face approaches by the y component of its normal."""
    sides = {"base": lambda x: x[1] == 0.0, "right": lambda x: x[0] == 0.1}
    flat = skfem.MeshQuad.init_tensor(np.linspace(0.0, 0.1, 4), np.linspace(0.0, 0.04, 3))
    flat = flat.with_boundaries(sides)
    places = np.array([flat.p[0], flat.p[1] + 0.5 * flat.p[0]])
    slanted = skfem.MeshQuad(places, flat.t, _boundaries=flat.boundaries)
    joints = [sj.Joint("base", 1e6, 0.3, contact="unilateral")]
    body = sj.Structure(slanted, STEEL, thickness=0.1, fixed_x=["right"], joints=joints)
    down = body.change_of_unknowns.inverse @ np.tile([0.0, -1.0], body.n_nodes)
    approach = body.unloaded.contact.normal.N @ down
    assert approach == pytest.approx(np.full(4, 2.0 / np.sqrt(5.0)))


def test_contact_of_which_all_nodes_are_held_across_stays_as_it_is_at_rest():
    assert not replace(block(), fixed_y=["base"]).system().contact.opens


def test_what_is_said_of_bolts_on_a_face_is_the_same_whether_it_opens():
    sides = {"base": "front", "held": "left"}
    mesh = sj.build_box([("box", 0.04, 4)], (0.02, 0.01), (2, 1), boundaries=sides)
    material = sj.Material(E=200e9, density=8000.0, poisson=0.3)
    bolts = sj.Bolts((sj.Bolt((0.03, 0.01, 0.0), 1e4, 0.011),))
    said = []
    for contact in ("constant", "unilateral"):
        joint = sj.Joint("base", bolts, 0.5, contact=contact)
        structure = sj.Structure(mesh, material, fixed=["held"], joints=[joint])
        said.append([x for x in structure.system().notes if "bolt at" in x])
    assert said[0] == said[1]
    assert len(said[0]) == 2
