"""Order of the displacement on a mesh: quadratic where linear elements lock, unless one says so."""

from dataclasses import replace

import numpy as np
import pytest
import skfem
from bodies import STEEL, block, structure

import skfem_joint as sj
from skfem_joint.mesh import named
from skfem_joint.mesh import order as orders

SIZE = (0.3, 0.03, 0.03)


@pytest.mark.parametrize("shape", ["tri", "tet", "mixed box", "mixed plate"])
def test_auto_is_the_second_order_of_the_same_mesh(shape):
    body = block(shape, 1, 2, SIZE)
    auto = structure(body, order="auto")
    asked, given = structure(body, order=2), structure(replace(body, order=2), order="auto")
    for other in (asked, given):
        for mine, theirs in zip(auto.matrices(), other.matrices(), strict=True):
            assert abs(mine - theirs).max() == 0.0
    (note,) = (note for note in auto.system().notes if "quadratic displacements" in note)
    assert "mesh.order = 1 keeps them linear" in note
    assert not [note for note in given.system().notes if "quadratic" in note]


@pytest.mark.parametrize(("shape", "order"), [("line", 1), ("quad", 1), ("quad", 2), ("hex", 1)])
def test_auto_leaves_other_elements_as_they_are(shape, order):
    body = block(shape, order, 2, SIZE)
    assert structure(body, order="auto").mesh is body


def test_second_order_may_be_computed_linearly_and_says_so():
    body = block("tet", 2, 2, SIZE)
    linear = structure(body, order=1)
    assert linear.n_nodes == body.mesh.p.shape[1]
    assert "The tetrahedra of second order are computed with linear displacements" in " ".join(
        linear.system().notes
    )


def test_a_lumped_mass_keeps_the_first_order():
    assert structure(block("tet", 1, 2, SIZE), order="auto", mass="lumped").mesh.order == 1
    with pytest.raises(sj.InputError, match="row sums are zero or negative"):
        structure(block("tet", 1, 2, SIZE), order=2, mass="lumped")


def test_a_factor_beyond_the_memory_keeps_the_first_order_and_says_so(monkeypatch):
    monkeypatch.setattr(orders, "physical_memory", lambda: 2.0**26)
    mesh = skfem.MeshTet.init_tensor(*(np.linspace(0, 1, n) for n in (25, 25, 5)))
    body = named(mesh.with_boundaries({"left": lambda x: x[0] < 1e-9}))
    some = sj.Structure(body, STEEL, fixed=["left"])
    assert some.mesh.order == 1
    assert "The tetrahedra stay of first order" in " ".join(some.unusual)
    assert sj.Structure(body, STEEL, fixed=["left"], parts=sj.Parts(2)).mesh.order == 2


@pytest.mark.parametrize("order", [0, 3, True, "2", 1.5])
def test_other_orders_are_refused(order):
    with pytest.raises(sj.InputError, match=r"mesh.order: found .*, must be 'auto', 1 or 2"):
        structure(block("tri"), order=order)


def test_structures_with_other_values_take_the_raised_body_over():
    body = block("tri", 1, 2, SIZE[:2])
    first = structure(body, order="auto")
    second = structure(body, order="auto", stiffness_damping=1e-6, like=first)
    assert second.body is first.body
