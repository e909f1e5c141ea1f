"""Contact that opens on matrices of scikit-fem: the same system as that of a structure."""

from dataclasses import replace

import numpy as np
import pytest
import skfem
from opening_blocks import SIZE, STEEL, block, loads
from scipy import sparse
from skfem.models.elasticity import lame_parameters, linear_elasticity

import skfem_joint as sj
from skfem_joint.ground.errors import InputError
from skfem_joint.ground.loads import Harmonic
from skfem_joint.structure.model import doubts


def own_system(order=1, fixed=True, **opening):
    """The block assembled on a basis of scikit-fem, held and loaded as the structure."""
    mesh = block(order=order).mesh
    element = {1: skfem.ElementQuad1, 2: skfem.ElementQuad2}[order]()
    basis = skfem.Basis(mesh.mesh, skfem.ElementVector(element), intorder=2 * order + 1)
    E, nu = STEEL.E, STEEL.poisson  # plane stress
    lame, mu = lame_parameters(E * (1 + 2 * nu) / (1 + nu) ** 2, nu / (1 + nu))
    K = 0.1 * linear_elasticity(lame, mu).assemble(basis)

    @skfem.BilinearForm
    def mass(u, v, _):
        return 0.1 * STEEL.density * sum(u[k] * v[k] for k in range(2))

    M = mass.assemble(basis)
    facets = mesh.mesh.boundaries
    right = basis.get_dofs(facets["right"]).all(["u^1"])
    contact = sj.contact(
        basis, "base", friction=0.5, thickness=0.1, fixed=right, **opening
    )  # fmt: skip
    top, left = (skfem.FacetBasis(mesh.mesh, basis.elem, facets=facets[x]) for x in ("top", "left"))

    @skfem.LinearForm
    def up(v, _):
        return v[1] / SIZE

    @skfem.LinearForm
    def across(v, _):
        return v[0] / SIZE

    forces = {
        "top": (up.assemble(top), Harmonic(230e3, 2000.0)),
        "left": (across.assemble(left), Harmonic(200e3, 2000.0)),
    }
    return sj.System.from_matrices(
        M, K, fixed=right, contact=contact, loads=forces, stiffness_damping=2e-7
    )


@pytest.mark.parametrize("order", [1, 2])
def test_own_matrices_run_as_the_structure_does(order):
    values = {"pressure": 50e6, "contact": "unilateral"}
    own = own_system(order, **values)
    structure = sj.Structure(
        block(order=order).mesh, STEEL, thickness=0.1, fixed_x=["right"],
        joints=[sj.Joint("base", friction=0.5, **values)], stiffness_damping=2e-7,
    ).system(loads(up=230e3))  # fmt: skip
    assert own.n == structure.n
    assert own.contact.normal.force.sum() == pytest.approx(200e3)
    for joints in ("loose", "stuck"):
        a, b = (sj.natural_modes(s, 3, joints=joints).frequencies for s in (own, structure))
        assert a == pytest.approx(b, rel=1e-6)
    a, b = (sj.integrate(s, cycles=1, steps_per_cycle=60) for s in (own, structure))
    assert a.opened.any()
    assert a.point_u == pytest.approx(b.point_u, abs=1e-6 * np.abs(b.point_u).max())
    assert a.energy_residual < 1e-11


def test_supports_may_be_named_at_the_system_alone():
    mesh = block().mesh
    basis = skfem.Basis(mesh.mesh, skfem.ElementVector(skfem.ElementQuad1()))
    right = basis.get_dofs(mesh.mesh.boundaries["right"]).all(["u^1"])
    K = linear_elasticity(*lame_parameters(2e11, 0.3)).assemble(basis)
    M = skfem.BilinearForm(lambda u, v, _: 8e3 * (u[0] * v[0] + u[1] * v[1])).assemble(basis)
    systems = [
        sj.System.from_matrices(
            M, K, fixed=right, contact=sj.contact(
                basis, "base", friction=0.5, pressure=1e6, contact="unilateral", fixed=fixed
            ),
        )
        for fixed in ((), right)
    ]  # fmt: skip
    assert systems[0].n == systems[1].n
    assert systems[0].contact.normal.N.shape == systems[1].contact.normal.N.shape
    a, b = (sj.natural_modes(s, 3, joints="stuck").frequencies for s in systems)
    assert a == pytest.approx(b, rel=1e-9)


def test_gap_and_stiffness_arrive():
    system = own_system(contact="unilateral", gap=1e-5, normal_stiffness=1e13)
    assert np.all(system.contact.normal.gap == 1e-5)
    assert system.contact.normal.stiffness == pytest.approx(1e13 * system.contact.normal.area)
    assert np.all(system.contact.w == 0.0)
    assert system.contact.count == 3


def test_sums_of_contacts_keep_their_pressure_points():
    mesh = block().mesh
    basis = skfem.Basis(mesh.mesh, skfem.ElementVector(skfem.ElementQuad1()))
    opens = sj.contact(basis, "base", friction=0.5, pressure=1e6, contact="unilateral")
    closed = sj.contact(basis, "top", friction=0.5, pressure=1e6)
    for both in (opens + closed, closed + opens):
        assert both.normal.part.gap.size == 4
        assert both.normal.gain.shape == (8, 4)
        points = both.normal.gain @ np.full(4, 1.0)
        assert np.array_equal(points > 0.0, np.array(both.names) == "base")


@pytest.mark.parametrize(
    ("values", "problem"),
    [
        ({}, "pressure: missing"),
        ({"pressure": 1e6, "gap": 1e-5}, "need contact = 'unilateral'"),
        ({"contact": "sticky", "pressure": 1e6}, "contact: found 'sticky'"),
        ({"contact": "unilateral", "pressure": 1e6, "gap": 1e-5}, "a pressure beside gap"),
        ({"contact": "unilateral", "clearance": 1e-5}, "unexpected argument 'clearance'"),
    ],
)
def test_wrong_values_are_refused(values, problem):
    mesh = block().mesh
    basis = skfem.Basis(mesh.mesh, skfem.ElementVector(skfem.ElementQuad1()))
    with pytest.raises(InputError, match=problem):
        sj.contact(basis, "base", friction=0.5, **values)


def held_block(element, named: bool, penalty: float = 0.0):
    """Block pressed on a rigid base and held on one side, or there on springs of a penalty."""
    solid = element in (skfem.ElementHex1, skfem.ElementHex2)
    grid = np.linspace(0.0, SIZE, 4)
    mesh = skfem.MeshHex.init_tensor(grid, grid[:3], grid) if solid else None
    mesh = mesh or skfem.MeshQuad.init_tensor(grid, grid)
    across, up = (0, mesh.dim() - 1)
    mesh = mesh.with_boundaries(
        {"base": lambda x: x[up] == 0, "top": lambda x: x[up] == SIZE, "left": lambda x: x[0] == 0,
         "right": lambda x: x[0] == SIZE}
    )  # fmt: skip
    basis = skfem.Basis(mesh, skfem.ElementVector(element()), intorder=4)
    K = linear_elasticity(*lame_parameters(200e9, 0.3)).assemble(basis)
    M = skfem.BilinearForm(lambda u, v, _: 8e3 * sum(u[k] * v[k] for k in range(up + 1)))
    M, held = M.assemble(basis), basis.get_dofs("right").all()
    loads = {}
    for name, k in (("top", up), ("left", across)):
        facets = skfem.FacetBasis(mesh, basis.elem, facets=name, intorder=4)
        vector = skfem.LinearForm(lambda v, _, k=k: v[k]).assemble(facets)
        loads[name] = vector / facets.dx.sum(), Harmonic(30e6 * facets.dx.sum(), 2000.0)
    springs = np.zeros(K.shape[0])
    springs[held] = penalty * K.diagonal().max()
    fixed = [] if penalty else held
    contact = sj.contact(
        basis, "base", friction=0.5, pressure=20e6, contact="unilateral",
        fixed=fixed if named else (),
    )  # fmt: skip
    system = sj.System.from_matrices(
        M, K + sparse.diags_array(springs), fixed=fixed, contact=contact, loads=loads,
        C=2e-7 * K,
    )  # fmt: skip
    if not penalty or element in FIRST:
        return system
    # Means over hats of nodes that are held take in their neighbours: their force is constant.
    opening, free = system.contact.normal, np.flatnonzero(~np.isin(contact.normal.pivots, held))
    values = {name: getattr(opening, name)[free] for name in ("gap", "force", "stiffness", "area")}
    opening = replace(opening, N=opening.N[free], **values)
    given = system.contact.w - system.contact.gain[:, free] @ opening.force
    given = np.maximum(given, 0.0)
    return system.with_contact(given=given, normal=opening, gain=system.contact.gain[:, free])


FIRST = skfem.ElementQuad1, skfem.ElementHex1


@pytest.mark.parametrize("named", [False, True])
@pytest.mark.parametrize("element", [*FIRST, skfem.ElementQuad2, skfem.ElementHex2])
def test_nodes_of_contact_that_supports_hold_are_those_on_stiff_springs(element, named):
    system, springs = held_block(element, named), held_block(element, named, 1e6)
    a, b = (sj.integrate(s, cycles=1, steps_per_cycle=60) for s in (system, springs))
    assert a.opened.any()
    assert a.friction_work.sum() > 0.0
    np.testing.assert_allclose(a.point_u, b.point_u, atol=2e-4 * np.abs(b.point_u).max())


def test_a_node_held_across_its_contact_keeps_its_normal_force_and_rubs():
    """Of a plate and of matrices: what supports hold against approaching has a constant limit."""
    structure = block()
    structure = sj.Structure(
        structure.mesh, STEEL, thickness=0.1, fixed_y=["right"], joints=structure.joints
    )
    mesh = structure.mesh.mesh
    basis = skfem.Basis(mesh, skfem.ElementVector(skfem.ElementQuad1()))
    right = basis.get_dofs(mesh.boundaries["right"]).all(["u^2"])
    K = linear_elasticity(*lame_parameters(2e11, 0.3)).assemble(basis)
    M = skfem.BilinearForm(lambda u, v, _: 8e3 * (u[0] * v[0] + u[1] * v[1])).assemble(basis)
    joint = {"pressure": 50e6, "contact": "unilateral", "thickness": 0.1, "friction": 0.5}
    contact = sj.contact(basis, "base", **joint)
    for system in (structure.system(), sj.System.from_matrices(M, K, fixed=right, contact=contact)):
        opening = system.contact.normal
        assert system.contact.w.size == 4
        assert opening.gap.size == 3
        assert system.contact.w.sum() == pytest.approx(0.5 * 50e6 * 0.1 * SIZE)
        assert np.sort(system.contact.given) == pytest.approx(
            [0.0, 0.0, 0.0, 0.5 * 50e6 * 0.1 * SIZE / 6]
        )


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
    structure = block()
    structure = sj.Structure(
        structure.mesh, STEEL, thickness=0.1, fixed_y=["base"], fixed_x=["right"],
        joints=structure.joints,
    )  # fmt: skip
    assert not structure.system().contact.opens


@pytest.mark.parametrize("name", ["M", "C", "K"])
def test_negative_matrices_are_refused(name):
    system = block().system(loads())
    with pytest.raises(InputError, match=rf"^{name}: .*; found -.* for unknown \d+$"):
        replace(system, **{name: -getattr(system, name)})


def test_what_is_said_of_bolts_on_a_face_is_the_same_whether_it_opens():
    sides = {"base": "front", "held": "left"}
    mesh = sj.build_box([("box", 0.04, 4)], (0.02, 0.01), (2, 1), boundaries=sides)
    material = sj.Material(E=200e9, density=8000.0, poisson=0.3)
    bolts = sj.Bolts((sj.Bolt((0.03, 0.01, 0.0), 1e4, 0.011),))
    said = []
    for contact in ("constant", "unilateral"):
        joint = sj.Joint("base", bolts, 0.5, contact=contact)
        structure = sj.Structure(mesh, material, fixed=["held"], joints=[joint])
        said.append([x for x in doubts(structure, structure.system()) if "bolt at" in x])
    assert said[0] == said[1]
    assert len(said[0]) == 2
