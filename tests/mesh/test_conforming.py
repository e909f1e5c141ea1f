"""Nodes that hang on sides of other elements are refused with their place; other meshes pass."""

import re

import numpy as np
import pytest
import skfem

from skfem_joint.ground.errors import InputError
from skfem_joint.mesh import named
from skfem_joint.mesh.splitting import split

PLAIN = {
    "triangle": skfem.MeshTri.init_tensor(*[np.linspace(0.0, 1.0, 4)] * 2),
    "quadrilateral": skfem.MeshQuad.init_tensor(*[np.linspace(0.0, 1.0, 4)] * 2),
    "tetrahedron": skfem.MeshTet.init_tensor(*[np.linspace(0.0, 1.0, 3)] * 3),
    "hexahedron": skfem.MeshHex.init_tensor(*[np.linspace(0.0, 1.0, 4)] * 3),
}


def hanging(kind: str, rng: np.random.Generator) -> tuple[skfem.Mesh, np.ndarray]:
    """Mesh of which some elements alone are split, turned and stretched, and its hanging nodes.

    Nodes hang that were made on edges or faces of elements that stayed whole.
    """
    plain = PLAIN[kind]
    whole = rng.random(plain.nelements) < rng.uniform(0.1, 0.9)
    whole[rng.permutation(whole.size)[:2]] = True, False
    p, of_element, _, parts, _ = split(plain)
    pieces = parts[:, :, ~whole].transpose(1, 0, 2).reshape(len(plain.t), -1)
    t = np.hstack([plain.t[:, whole], pieces])
    hangs = np.intersect1d(of_element[:, whole], parts[:, :, ~whole])
    hangs = np.setdiff1d(hangs, plain.t[:, whole])
    turn = np.linalg.qr(rng.normal(size=(len(p),) * 2))[0]
    p = turn @ (rng.uniform(0.2, 5.0, (len(p), 1)) * p) + rng.normal(size=(len(p), 1))
    used = np.unique(t)
    number = np.full(p.shape[1], -1)
    number[used] = np.arange(used.size)
    return type(plain)(p[:, used], number[t]), number[hangs]


def refusal(mesh: skfem.Mesh, **options: object) -> re.Match[str]:
    """Node, place and number of the hanging nodes that a refusal names."""
    with pytest.raises(InputError) as caught:
        named(mesh, **options)
    found = re.search(r"node (\d+) at \((.*?)\) m hangs on a side of element (\d+) of region "
                      r"'(\w+)', from .* \((\d+) such nodes\)", str(caught.value))  # fmt: skip
    assert found, str(caught.value)
    return found


@pytest.mark.parametrize("kind", PLAIN)
@pytest.mark.parametrize("digits", [16, 6])
def test_hanging_nodes_are_refused_with_their_place(kind, digits):
    """Also where a file rounds coordinates: edges of 0.07 to 2.5, 6 digits after the point."""
    rng, met = np.random.default_rng(47), 0
    for _ in range(25):
        mesh, hangs = hanging(kind, rng)
        met += hangs.size > 0
        if not hangs.size:
            continue
        even = np.arange(mesh.nelements) % 2 == 0
        p = np.round(mesh.p, digits)
        mesh = type(mesh)(p, mesh.t).with_subdomains(
            {"even": np.flatnonzero(even), "odd": np.flatnonzero(~even)}
        )
        for order in (1, 2):
            found = refusal(mesh, order=order)
            node, element = int(found[1]), int(found[3])
            assert node in hangs
            place = [float(x) for x in found[2].split(",")][: len(p)]
            assert place == pytest.approx(p[:, node], rel=1e-8, abs=1e-8)
            assert node not in mesh.t[:, element]
            assert found[4] == ("even", "odd")[element % 2]
            assert int(found[5]) == hangs.size
    assert met > 15


def test_a_node_inside_a_triangular_face_is_refused():
    """A tetrahedron on another one that three share in place of it, around the face's middle."""
    corners = [(0.0, 0.0, 0.0), (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.2, 0.2, 1.0)]
    p = np.array([*corners, (0.2, 0.2, -1.0), (0.4, 0.25, 0.0)]).T
    t = np.array([[0, 1, 2, 3], [0, 1, 4, 5], [1, 2, 4, 5], [2, 0, 4, 5]]).T
    mesh = skfem.MeshTet(p, t).with_subdomains({"upper": [0], "lower": [1, 2, 3]})
    found = refusal(mesh)
    assert (found[1], found[2], found[3], found[4]) == ("5", "0.4, 0.25, 0", "0", "upper")


@pytest.mark.parametrize("kind", ["triangle", "tetrahedron"])
def test_meshes_refined_in_places_without_hanging_nodes_pass(kind):
    rng = np.random.default_rng(3)
    for _ in range(10):
        mesh = PLAIN[kind]
        for _ in range(3):
            mesh = mesh.refined(rng.permutation(mesh.nelements)[: mesh.nelements // 4])
        turn = np.linalg.qr(rng.normal(size=(len(mesh.p),) * 2))[0]
        assert named(type(mesh)(turn @ mesh.p, mesh.t)).body.max() == 0


@pytest.mark.parametrize("kind", PLAIN)
@pytest.mark.parametrize("shift", [0.0, 0.13])
@pytest.mark.parametrize("times", [0, 1])
def test_bodies_whose_faces_touch_are_in_contact(kind, shift, times):
    """Their meshes match or not: no node hangs, for they share none."""
    plain = PLAIN[kind]
    across = np.eye(len(plain.p))[:, [0]]
    lower = plain.refined(times)
    p = np.hstack([lower.p, plain.p + np.roll(across, -1) + shift * across])
    both = named(type(plain)(p, np.hstack([lower.t, plain.t + lower.nvertices])))
    np.testing.assert_array_equal(both.body, np.repeat([0, 1], [lower.nelements, plain.nelements]))
