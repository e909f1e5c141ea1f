"""Preload by clamping bolts: equilibrium, closed forms, Hertz, and what is refused."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import skfem
from bodies import NU, PLANE, SOLID, STEEL, THICKNESS, E, block, mapped, section
from clamped_plates import bolted

import skfem_joint as sj
from skfem_joint.linalg.schur import SchurComplement
from skfem_joint.mesh import NamedMesh, merged, named

FORCE = 1e5
JOINT = sj.Joint("u_base", "preload", 0.3, against="l_top")
BOLT = sj.Clamp(FORCE, "u_top", "l_base")


def at(body: NamedMesh, prefix: str, *shift: float) -> NamedMesh:
    """The same body elsewhere, its names with a prefix."""
    mesh = mapped(body, lambda p: p + np.array(shift)[:, np.newaxis]).mesh
    regions, borders = ({prefix + name: some for name, some in groups.items()}
                        for groups in (body.regions, body.boundaries))  # fmt: skip
    return named(replace(mesh, _subdomains=regions, _boundaries=borders), order=body.order)


def stacked(shape: str, order: int, upper: int = 2, lower: int = 2) -> NamedMesh:
    """Two unit blocks on each other."""
    first, second = block(shape, order, upper), block(shape, order, lower)
    origin = [0.0] * first.mesh.dim()
    return merged([at(first, "u_", *origin[1:], 1.0), at(second, "l_", *origin)])


def clamped(
    mesh: NamedMesh, joints: Any = (JOINT,), bolts: Any = (BOLT,), **how: Any
) -> sj.Structure:
    values = {"material": STEEL, "free": True, "order": mesh.order, **section(mesh), **how}
    return sj.Structure(mesh, joints=joints, bolts=bolts, **values)


def pressure(structure: sj.Structure) -> tuple[Any, Any, Any]:
    """Nodes of the first joint that may touch, their pressure and gap."""
    found = structure.preload.joints[0]
    nodes = np.flatnonzero(found.area)
    return nodes, found.force[nodes] / found.area[nodes], found.gap[nodes]


@pytest.mark.parametrize(("shape", "order"), [*PLANE, *SOLID])
def test_blocks_pressed_evenly_have_the_even_pressure(shape, order):
    """In the weak sense: of second order too, whose nodal forces are zero at some nodes."""
    structure = clamped(stacked(shape, order))
    area = THICKNESS if structure.dim == 2 else 1.0
    _, p, gap = pressure(structure)
    assert p == pytest.approx(FORCE / area, rel=1e-10)
    assert structure.patches[0].clamping_force == pytest.approx(FORCE, rel=1e-10)
    assert np.abs(gap).max() < 1e-15
    # The stress in every element is that of the press.
    stress = structure.stress(structure.preload.displacement)[:, structure.dim - 1]
    assert stress == pytest.approx(-FORCE / area, rel=1e-11)


@pytest.mark.parametrize(("shape", "order"), [("tri", 2), ("quad", 1), ("tet", 1), ("hex", 2)])
def test_forces_and_moments_balance_on_faces_that_do_not_match(shape, order):
    structure = clamped(stacked(shape, order, 3, 2))
    found = structure.preload
    assert found.joints[0].force.sum() == pytest.approx(FORCE, rel=1e-10)
    inner = structure.matrices()[1] @ found.displacement.ravel()
    force, x = inner.reshape(found.force.shape) - found.force, structure.nodes
    bodies = structure.body.body_of_node
    upper = bodies == bodies[x[:, -1].argmax()]
    assert force[upper].sum(axis=0)[-1] == pytest.approx(FORCE, rel=1e-10)
    assert force.sum(axis=0) == pytest.approx(0.0, abs=1e-12 * FORCE)
    moments = np.einsum("ni,nj->ij", x, force)
    assert moments - moments.T == pytest.approx(0.0, abs=1e-12 * FORCE)
    _, p, _ = pressure(structure)  # by quadrature over the other face's kinks
    area = THICKNESS if structure.dim == 2 else 1.0
    assert p == pytest.approx(FORCE / area, rel=0.03)


def pushed_at(offset: float, n: int) -> sj.Structure:
    """Stiff block on a thin soft layer on a fixed base, pressed at a distance from its middle."""
    half, thin = 0.5, 0.005
    upper, lower = block("quad", 1, n, (1.0, 0.5)), block("quad", 1, n, (1.0, thin))
    upper, lower = at(upper, "u_", 0.0, thin), at(lower, "l_", 0.0, 0.0)
    pushed = {}
    for name, body in (("u_top", upper), ("l_base", lower)):
        mesh, facets = body.mesh, body.boundaries[name]
        middle = mesh.p[0, mesh.facets[:, facets]].mean(axis=0)
        near = np.abs(middle - half - offset) < 0.1
        pushed[name] = body.mesh.with_boundaries({f"{name}_part": facets[near]})
    mesh = merged([named(pushed["u_top"]), named(pushed["l_base"])])
    return clamped(
        mesh, bolts=[sj.Clamp(FORCE, "u_top_part", "l_base_part")], fixed=["l_base"],
        material=sj.Material(1e15, 8e3, 0.0), free=True,
        regions={name: {"E": 1e8} for name in ("l_joint", "l_rest")},
    )  # fmt: skip


def test_a_block_pressed_beside_its_kern_lifts_as_no_tension_foundations_do():
    """Navier's triangle: contact on 3 (L/2 - e), peak 2 F / that, zero beyond (L = 1 m)."""
    structure = pushed_at(0.3, 20)
    nodes, p, gap = pressure(structure)
    x, length = structure.nodes[nodes, 0], 3 * (0.5 - 0.3)
    peak = 2 * FORCE / (length * THICKNESS)
    inside = np.maximum(0.0, 1.0 - (1.0 - x) / length) * peak
    assert p == pytest.approx(inside, abs=1e-3 * peak)
    assert np.all(p[x > 1.0 - length + 0.03] > 0.0)
    assert np.all(gap[x < 1.0 - length - 0.03] > 0.0)
    assert np.all(p * gap <= 1e-9 * peak * gap.max())
    # Only what touches is a contact point, with its limit.
    patch = structure.patches[0]
    assert set(patch.nodes) == set(nodes[p > 0.0])


@pytest.mark.parametrize("contact", ["constant", "unilateral"])
@pytest.mark.parametrize("parts", [None, sj.Parts(2)])
@pytest.mark.parametrize("order", [1, 2])
def test_faces_that_close_all_over_on_a_rigid_base_carry_the_bolt(order, parts, contact):
    """There nothing in contact moves, whose displacements are no measure of anything."""
    strips, names = [("lap", 0.04, 8), ("arm", 0.1, 20)], {"under": ("bottom", "lap")}
    names |= {"over": ("top", "lap"), "end": "right"}
    pressed = sj.Structure(
        sj.build_plate(strips, 0.01, 2, order=order, boundaries=names), STEEL, thickness=0.01,
        joints=[sj.Joint("under", "preload", 0.3, contact=contact)],
        bolts=[sj.Clamp(1000.0, head="over")], fixed=["end"], parts=parts,
    )  # fmt: skip
    (patch,) = pressed.patches
    assert patch.clamping_force == pytest.approx(1000.0, rel=1e-2)
    assert pressed.preload.joints[0].force.sum() == pytest.approx(patch.clamping_force, rel=1e-9)


def test_sets_of_touching_nodes_are_found_on_the_contact_alone(monkeypatch):
    """The other unknowns are solved for at the start and with the last sets, two times a solution.

    With each set they would take three solutions or more.
    """
    solved: list[str] = []

    def counted(name: str, solve: Any) -> Any:
        return lambda *given: (solved.append(name), solve(*given))[1]

    for name in ("restrict", "extend"):
        monkeypatch.setattr(SchurComplement, name, counted(name, getattr(SchurComplement, name)))
    preload = pushed_at(0.3, 20).preload
    assert preload is not None
    assert preload.active_sets >= 4
    # One more says how far the others move with contact held.
    assert 3 <= len(solved) <= 1 + 4 * preload.active_sets


def cylinder(n: int) -> NamedMesh:
    """Body with a bottom of 1 m radius on a flat one, finer towards the middle."""
    size, s, t = 0.2, np.linspace(-1, 1, 2 * n + 1), np.linspace(0, 1, n + 1)
    x, y = size * (0.25 * s + 0.75 * s**3), size * (0.25 * t + 0.75 * t**2)
    upper = skfem.MeshQuad.init_tensor(x, y).with_boundaries(
        {"u_base": lambda x: x[1] == 0.0, "u_top": lambda x: x[1] == size}
    )
    bent = upper.p.copy()
    bent[1] += bent[0] ** 2 / 2 * (1.0 - bent[1] / size)
    lower = skfem.MeshQuad.init_tensor(x, -y[::-1]).with_boundaries(
        {"l_top": lambda x: x[1] == 0.0, "l_base": lambda x: x[1] == -size}
    )
    return merged([named(replace(upper, doflocs=bent)), named(lower)])


SECOND = pytest.param(2, 1.9, 1e-2, marks=pytest.mark.slow)


@pytest.mark.parametrize(("order", "rate", "share"), [(1, 1.4, 5e-3), SECOND])
def test_a_cylinder_on_a_flat_tends_to_hertz(order, rate, share):
    """Peak 2 F / (pi a) and half-width a of a^2 = 8 F R (1 - nu^2) / (pi E), by length, R = 1 m.

    Errors in the mean square fall as fast as the root at the edge of the ellipse lets them.
    """
    force, errors = 2e7 * THICKNESS, []
    half = np.sqrt(8 * 2e7 * (1 - NU**2) / (np.pi * E))
    peak = 2 * 2e7 / (np.pi * half)
    for n in (8, 16, 32):
        bolts = [sj.Clamp(force, "u_top", "l_base")]
        structure = clamped(named(cylinder(n).mesh, order=order), bolts=bolts, plane="strain")
        nodes, p, _ = pressure(structure)
        x = structure.nodes[nodes, 0]
        assert structure.patches[0].clamping_force == pytest.approx(force, rel=1e-10)
        exact = peak * np.sqrt(np.maximum(0.0, 1.0 - (x / half) ** 2))
        area = structure.preload.joints[0].area[nodes] / THICKNESS
        errors.append(np.sqrt(area @ (p - exact) ** 2 / (area @ exact**2)))
    assert errors[0] > rate * errors[1] > rate**2 * errors[2]
    assert p.max() == pytest.approx(peak, rel=share)
    if order == 1:
        touching = structure.patches[0].area.sum() / THICKNESS
        assert touching == pytest.approx(2 * half, rel=0.08)


def three_feet() -> NamedMesh:
    """Two E-shaped bodies, foot on foot: middle feet are a cut shank, outer ones joints."""
    bodies = []
    for prefix, sign in (("u_", 1.0), ("l_", -1.0)):
        x, y = np.linspace(0.0, 5.0, 11), np.linspace(0.0, 2.0, 5)
        mesh = skfem.MeshQuad.init_tensor(x, y)
        middle = mesh.p[:, mesh.t].mean(axis=1)
        mesh = mesh.restrict(np.flatnonzero((middle[1] > 1) | (middle[0].astype(int) % 2 == 0)))
        p = mesh.p * [[1.0], [sign]]
        mesh = skfem.MeshQuad(p, mesh.t if sign > 0 else mesh.t[[0, 3, 2, 1]])
        feet = {
            prefix + name: lambda x, k=k: (x[1] == 0.0) & (x[0] > k) & (x[0] < k + 1)
            for k, name in ((0, "left"), (2, "cut"), (4, "right"))
        }
        bodies.append(named(mesh.with_boundaries(feet)))
    return merged(bodies)


def test_a_cut_shank_pulls_its_bodies_together_and_moves_as_one_afterwards():
    joints = [sj.Joint(f"u_{x}", "preload", 0.3, against=f"l_{x}") for x in ("left", "right")]
    structure = clamped(three_feet(), joints, [sj.Clamp(FORCE, shank=("u_cut", "l_cut"))])
    pressed = [patch.clamping_force for patch in structure.patches]
    assert pressed == pytest.approx([FORCE / 2, FORCE / 2], rel=1e-12)
    u = structure.expand(np.random.default_rng(1).normal(size=structure.T.shape[1]))
    ends = [np.sort(structure.body.nodes_of(name)) for name in ("u_cut", "l_cut")]
    order = [some[np.argsort(structure.nodes[some, 0])] for some in ends]
    assert u[order[0]] == pytest.approx(u[order[1]], abs=1e-12)


MESH = stacked("quad", 1)


@pytest.mark.parametrize(
    ("how", "sentence"),
    [
        ({"bolts": [sj.Clamp(FORCE, "u_tpo", "l_base")]}, r"bolt\[0\]\.head: found 'u_tpo'.*top'"),
        ({"bolts": [sj.Clamp(FORCE, "u_top", "u_base")]}, r"does not go through a joint.*'u_base'"),
        ({"bolts": [sj.Clamp(FORCE, "u_top")]}, "acts from .* on the rigid base"),
        ({"bolts": [sj.Clamp(FORCE)]}, "must have head"),
        ({"bolts": [sj.Clamp(FORCE, "u_top", shank=("u_top", "l_base"))]}, "or shank alone"),
        ({"bolts": [sj.Clamp(-1.0, "u_top", "l_base")]}, r"bolt\[0\]\.force: found -1"),
        ({"bolts": [sj.Clamp(FORCE, "u_left", "l_base")]}, "does not press at 'u_left'"),
        ({"bolts": [sj.Clamp(FORCE, shank=("u_top", "l_base"))]}, "does not pull the faces"),
        ({"bolts": []}, "found 'preload', but no bolt presses it"),
        ({"joints": [replace(JOINT, pressure=1e6)]}, "no joint with pressure = 'preload'"),
        ({"joints": [replace(JOINT, normal_force="equal")]}, "normal_force: found 'equal'"),
        ({"joints": [replace(JOINT, on="u_joint", against="l_joint")]}, "needs a boundary"),
        ({"joints": [replace(JOINT, on="u_left")]}, "no node of it lies over 'l_top'|opens every"),
        ({"joints": [replace(JOINT, pressure="bolts")], "bolts": []}, "must be in Pa"),
    ],
)  # fmt: skip
def test_what_presses_nothing_is_refused(how, sentence):
    with pytest.raises(sj.InputError, match=sentence):
        _ = clamped(MESH, **how).patches


@pytest.mark.parametrize("order", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_coordinates_that_a_file_rounds_change_nothing(order):
    """Bolted plates turned in space, 1.2 m from the origin, in mm with three decimals.

    The normals of a rounded face differ by some 1e-4: they held the upper plate along the face,
    and the preload was refused.
    """
    exact = bolted(solid=True, order=order)
    turn = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))[0]
    turn *= np.linalg.det(turn)
    turned = mapped(exact.mesh, lambda x: turn @ x + 1.2)
    rounded = mapped(turned, lambda x: np.round(1e3 * x, 3) * 1e-3)
    apart = turned.mesh.p - rounded.mesh.p
    assert np.abs(apart).max() > 2e-7
    frequencies = []
    for mesh in (turned, rounded):
        some = replace(exact, mesh=mesh)
        assert some.patches[0].clamping_force == pytest.approx(16e3, rel=1e-5)
        assert some.at_rest()[-1].startswith("Friction alone holds the body with the regions 'u1'")
        frequencies.append(sj.natural_modes(some.system(), 4).frequencies)
    np.testing.assert_allclose(*frequencies, rtol=1e-4, atol=1e-3)


def halves(mesh: NamedMesh) -> NamedMesh:
    """The same mesh with the pressed face as two, which share the node between them."""
    face = mesh.boundaries["u_base"]
    x = mesh.mesh.p[0, mesh.mesh.facets[:, face]].mean(axis=0)
    left = x < 0.5 * (x.min() + x.max())
    parts = {"u_base_1": face[left], "u_base_2": face[~left]}
    return named(mesh.mesh.with_boundaries(parts), order=mesh.order)


def test_what_is_known_to_be_wrong_is_refused_before_bolts_are_tightened():
    told: list[tuple[int, int, str]] = []
    unilateral = replace(JOINT, contact="unilateral")
    joints = [replace(unilateral, on=f"u_base_{k}") for k in (1, 2)]
    for wrong, says in (
        ({"joints": joints}, "unilateral' needs nodes of its own"),
        ({"joints": [unilateral], "fixed": ["u_top", "u_left"]}, "of its nodes are supported"),
    ):
        with pytest.raises(sj.InputError, match=says):
            clamped(halves(MESH), **wrong).tighten(lambda *news: told.append(news))
        assert told == []
    held = {"free": False, "fixed": ["l_base"], "joints": [unilateral]}
    made = clamped(halves(MESH), progress=lambda *news: told.append(news), **held)
    assert made.preload is not None
    # Each set of touching nodes was told of, and nothing changes in the last one.
    assert [count for count, _, _ in told] == [*range(1, made.preload.active_sets + 1)]
    assert told[-1][2].startswith("0 of ")
