"""Contact that opens on matrices of scikit-fem: the same system as that of a structure."""

import numpy as np
import pytest
import skfem
from opening_blocks import SIZE, STEEL, block, loads
from skfem.models.elasticity import lame_parameters, linear_elasticity

import skfem_joint as sj
from skfem_joint.errors import InputError
from skfem_joint.loads import Harmonic


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
    assert own.opening.force.sum() == pytest.approx(200e3)
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
    assert systems[0].opening.N.shape == systems[1].opening.N.shape
    a, b = (sj.natural_modes(s, 3, joints="stuck").frequencies for s in systems)
    assert a == pytest.approx(b, rel=1e-9)


def test_gap_and_stiffness_arrive():
    system = own_system(contact="unilateral", gap=1e-5, normal_stiffness=1e13)
    assert np.all(system.opening.gap == 1e-5)
    assert system.opening.stiffness == pytest.approx(1e13 * system.opening.area)
    assert np.all(system.w == 0.0)
    assert system.contact_points == 3


def test_sums_of_contacts_keep_their_pressure_points():
    mesh = block().mesh
    basis = skfem.Basis(mesh.mesh, skfem.ElementVector(skfem.ElementQuad1()))
    opens = sj.contact(basis, "base", friction=0.5, pressure=1e6, contact="unilateral")
    closed = sj.contact(basis, "top", friction=0.5, pressure=1e6)
    for both in (opens + closed, closed + opens):
        assert both.normal.contact.gap.size == 4
        assert both.normal.contact.gain.shape == (8, 4)
        points = both.normal.contact.gain @ np.full(4, 1.0)
        assert np.array_equal(points > 0.0, np.array(both.joint_of_point) == "base")


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
