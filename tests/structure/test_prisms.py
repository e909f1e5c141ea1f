"""Prisms among hexahedra, and triangles among quadrilaterals, against theorems and CalculiX."""

import shutil
from typing import Any

import numpy as np
import pytest
import skfem
from benchmarks.inp import by_calculix, deck
from bodies import DENSITY, NU, STEEL, E, section
from mesh_files import saved
from mixed_meshes import mixed_box, mixed_plate, shaken
from scipy.sparse.linalg import spsolve
from skfem.helpers import ddot, sym_grad, trace

import skfem_joint as sj
from skfem_joint.body.body import Body
from skfem_joint.body.nodes import values_in
from skfem_joint.mesh import build_box, load_meshes, merged, named
from skfem_joint.mesh.cells import CELLS
from skfem_joint.mesh.collapsed import is_collapsed
from skfem_joint.mesh.named import from_parts
from skfem_joint.output.series import blocks_of
from skfem_joint.structure import mesh_error

BOTH = [(what, order) for what in ("solid", "plate") for order in (1, 2)]
MESHES = {"solid": mixed_box, "plate": mixed_plate}


def body_of(what: str, order: int, n: int = 1, *, inside: bool = False, **changes: Any) -> Body:
    """Body on a mesh with vertices that are moved to all sides, or with them in place."""
    mesh = MESHES[what](n, order)
    mesh = shaken(mesh, inside=inside) if changes.pop("moved", True) else mesh
    return Body(mesh, **{"material": STEEL, **section(mesh), **changes})


def test_a_prism_is_scikit_fems_own():
    """Mass and stiffness of first order are those of `MeshWedge1`, exactly integrated."""
    body = Body(build_box([("a", 0.6, 6)], (0.05, 0.02), (3, 2), kind="prism"), STEEL)
    M, K = wedge_matrices(body, *EXACT)
    assert abs(body.matrices()[0] - M).max() < 1e-14 * abs(M).max()
    assert abs(body.matrices()[1] - K).max() < 1e-14 * abs(K).max()


LOW, HIGH = 0.5 - 0.5 / np.sqrt(3.0), 0.5 + 0.5 / np.sqrt(3.0)
_IN_TRIANGLE = [(1 / 6, 1 / 6), (2 / 3, 1 / 6), (1 / 6, 2 / 3)]
#: Points and weights of an exact rule for linear prisms.
EXACT = np.array([(*x, z) for z in (LOW, HIGH) for x in _IN_TRIANGLE]).T, np.full(6, 1 / 12)


def wedge_matrices(body: Body, points: np.ndarray, weights: np.ndarray) -> tuple[Any, Any]:
    """Mass and stiffness of prisms, assembled on scikit-fem's own mesh and element."""
    (part,) = body.mesh.parts
    mesh = skfem.MeshWedge1(body.mesh.mesh.p, part.corners)
    basis = skfem.Basis(
        mesh, skfem.ElementVector(skfem.ElementWedge1()), quadrature=(points, weights)
    )
    first, second = (values[0] for values in body.lame())

    def energy(u: Any, v: Any, _: Any) -> Any:
        strains = sym_grad(u), sym_grad(v)
        return 2 * second * ddot(*strains) + first * trace(strains[0]) * trace(strains[1])

    mass = skfem.BilinearForm(lambda u, v, _: DENSITY * sum(u[k] * v[k] for k in range(3)))
    return mass.assemble(basis), skfem.BilinearForm(energy).assemble(basis)


def calculix(mesh: Any, folder: Any) -> np.ndarray:
    """Frequencies of CalculiX, Hz, of a body that is held at its left end."""
    lines = [
        *deck(mesh, ()), "*MATERIAL, NAME=STEEL", "*ELASTIC", f"{E}, {NU}",
        "*DENSITY", f"{DENSITY}", "*SOLID SECTION, ELSET=EALL, MATERIAL=STEEL",
        "*BOUNDARY", "left, 1, 3", "*STEP", "*FREQUENCY", "6", "*END STEP",
    ]  # fmt: skip
    return by_calculix(lines, folder)[1][:6]


@pytest.mark.skipif(shutil.which("ccx") is None, reason="CalculiX is not installed")
def test_a_deck_of_c3d15_and_c3d20_has_the_frequencies_of_calculix(tmp_path):
    """Within 0.2 %; its elements have 15 and 20 nodes where those here have 21 and 27."""
    mesh = mixed_box(2, order=2)
    path = saved(tmp_path, "\n".join([*deck(mesh), ""]), "mesh.inp")
    structure = sj.Structure(load_meshes(path), STEEL, fixed=["left"])
    ours = sj.natural_modes(structure.system([]), 6).frequencies
    np.testing.assert_allclose(ours, calculix(mesh, tmp_path), rtol=2e-3)


def test_the_mixed_cantilever_converges_to_the_closed_form_of_a_beam():
    """Euler and Bernoulli's beam with Timoshenko's shear, nu = 0; the stiffness of linear prisms,
    which lock, errs by the square of the size of the elements.
    """
    length, width, height = 0.6, 0.05, 0.02
    inertia, area = width * height**3 / 12.0, width * height
    exact = length**3 / (3.0 * E * inertia) + length / (5.0 / 6.0 * 0.5 * E * area)
    material = sj.Material(E, DENSITY, 0.0)
    errors: dict[int, list[float]] = {1: [], 2: []}
    for order, counts in ((1, (1, 2, 3)), (2, (1, 2))):
        for n in counts:
            mesh = mixed_box(n, order)
            structure = sj.Structure(mesh, material, fixed=["left"], order=order)
            system = structure.system([])
            force = structure.T.T @ np.outer(structure.body.even_shares("right"), [0, 0, 1]).ravel()
            tip = force @ spsolve(system.K.tocsc(), force)
            errors[order].append(exact / tip - 1.0)
    assert errors[1][1] > 0.5
    assert np.log(errors[1][1] / errors[1][2]) / np.log(1.5) == pytest.approx(2.0, abs=0.2)
    assert np.abs(errors[2]).max() < 0.01
    assert abs(errors[2][1]) < 0.001


def test_only_whole_elements_have_incompatible_modes():
    """The difference that they make is that of the hexahedra alone."""
    mesh = mixed_box()
    parts = [Body(mesh, STEEL, incompatible=x).matrices()[1] for x in (False, True)]
    taken = parts[0] - parts[1]
    prisms = np.flatnonzero(is_collapsed(CELLS["hexahedron"], mesh.mesh.t))
    hexahedra = np.setdiff1d(np.arange(mesh.n_elements), prisms)
    beside = np.unique(mesh.mesh.t[:, hexahedra])
    rest = np.setdiff1d(np.arange(mesh.mesh.nvertices), beside)
    assert rest.size
    rows = (3 * rest[:, None] + np.arange(3)).ravel()
    assert abs(taken[rows]).max() < 1e-14 * abs(parts[0]).max()
    assert abs(taken).max() > 1e-3 * abs(parts[0]).max()
    prism = build_box([("a", 0.1, 1)], (0.1, 0.1), (1, 1), kind="prism")
    assert not Body(prism, STEEL).has_incompatible_modes


def test_stiffness_of_regions_of_either_kind_adds_up():
    """Derivatives by the moduli of a region of prisms and of the rest give the whole."""
    mesh = mixed_box()
    (hexahedra, prisms) = (part.elements for part in mesh.parts)
    regions = {"prisms": prisms, "bricks": hexahedra}
    body = Body(
        named(mesh.mesh.with_subdomains(regions)), STEEL, regions={"prisms": {"E": E / 3.0}}
    )
    parts = E * body.stiffness_by_modulus() + E / 3.0 * body.stiffness_by_modulus("prisms")
    K = body.matrices()[1]
    assert abs(K - parts).max() < 1e-13 * abs(K).max()


def test_the_error_of_the_mesh_finds_that_prisms_lock():
    """Middles of edges lower the frequencies to those of second order on the same mesh."""
    mesh = mixed_box(2)
    error = sj.Structure(mesh, STEEL, fixed=["left"], order=1, incompatible=False).mesh_error
    better = sj.Structure(mesh, STEEL, fixed=["left"], order=2)
    exact = sj.natural_modes(better.system([]), 1).frequencies[0]
    assert error.is_known
    assert error.better[0] == pytest.approx(exact, rel=0.05)


def test_parts_of_a_body_of_two_materials_are_assembled_apart(monkeypatch):
    """The error by the mesh does not depend on how many elements are assembled at once."""
    mesh = mixed_box()
    given: dict[str, Any] = {"fixed": ["left"], "order": 1, "regions": {"lap": {"E": E / 10.0}}}
    whole = sj.Structure(mesh, STEEL, **given).mesh_error
    monkeypatch.setattr(mesh_error, "_AT_ONCE", 7)
    apart = sj.Structure(mesh, STEEL, **given).mesh_error
    np.testing.assert_allclose(apart.better, whole.better, rtol=1e-9)


@pytest.mark.parametrize(("what", "order"), BOTH)
def test_pictures_show_all_kinds(what, order):
    pyvista = pytest.importorskip("pyvista")
    mesh = shaken(MESHES[what](order=order), inside=True)
    structure = sj.Structure(mesh, STEEL, fixed=["left"], order=order, **section(mesh))
    (block,) = blocks_of(structure)
    kinds = {pyvista.CellType(kind).name for kind in block.grid.celltypes}
    assert kinds == {"HEXAHEDRON", "WEDGE"}
    volumes = block.grid.compute_cell_sizes()["Volume"]
    assert volumes.min() > 0.0
    whole = 0.6 * 0.05 * 0.02 if what == "solid" else 0.6 * 0.06 * structure.thickness
    assert volumes.sum() == pytest.approx(whole, rel=1e-3)  # VTK cuts bent sides into triangles
    if order == 1:
        count = np.unique(block.grid.celltypes, return_counts=True)[1].tolist()
        assert count == [part.elements.size for part in mesh.parts]


def lap(lower: sj.NamedMesh, order: int, bolts: Any = (), **joint: Any) -> sj.Structure:
    """Lap of a mixed body on another one, pressed at the end of each."""
    upper = build_box(
        [("over", 0.2, 3), ("far", 0.4, 4)], (0.05, 0.02), (2, 2), origin=(0.4, 0.0, 0.02),
        boundaries={"under": ("front", "over"), "head": ("back", "over"), "end": "right"},
    )  # fmt: skip
    given = {"on": "under", "against": "face", "pressure": 1e6, "friction": 0.3, **joint}
    joints = [sj.Joint(**given)]
    how: Any = {"fixed": ["left"], "order": order, "joints": joints, "bolts": bolts}
    return sj.Structure(merged([upper, lower]), STEEL, **how)


@pytest.mark.parametrize("order", [1, 2])
def test_a_joint_on_faces_of_both_kinds_has_its_forces_and_follows_linear_motion(order):
    """Clamp force, area, and slip of a linear displacement of both bodies: none to round-off."""
    structure = lap(mixed_box(), order)
    words = f"2 bodies, 86 elements of order {order}, 42 hexahedra and 44 prisms."
    assert structure.overview() == words
    (patch,) = structure.patches
    assert patch.clamping_force == pytest.approx(1e4, rel=1e-12)
    assert patch.area.sum() + patch.held_area == pytest.approx(0.01, rel=1e-12)
    u = structure.body.nodes @ np.random.default_rng(5).normal(size=(3, 3)).T
    assert np.abs(patch.relative(u)).max() < 1e-12


@pytest.mark.parametrize("on", ["face", "under"])
@pytest.mark.parametrize("order", [1, 2])
def test_contact_that_opens_on_faces_of_both_kinds_carries_its_pressure(on, order):
    against = {"face": "under", "under": "face"}[on]
    structure = lap(mixed_box(), order, contact="unilateral", on=on, against=against)
    (patch,) = structure.patches
    assert patch.opening.force.sum() == pytest.approx(1e4, rel=1e-9)
    load = sj.Load("end", sj.Harmonic(1500.0, 50.0), direction=(1.0, 0.0, 0.0))
    run = sj.quasi_static(structure.system([load]), cycles=1, steps_per_cycle=8)
    assert sum(run.friction_work.ravel()) > 0.0


@pytest.mark.parametrize(
    "mesh",
    [skfem.MeshWedge1().with_boundaries({"end": [0]}), mixed_box().mesh],
    ids=["own", "both"],
)
def test_contact_on_a_basis_of_prisms_is_refused(mesh):
    basis = skfem.CellBasis(mesh, skfem.ElementVector(mesh.elem()), intorder=3)
    with pytest.raises(
        sj.InputError, match=r"prism elements, whose nodes .* give the mesh to sj.Str"
    ):
        sj.contact(basis, "end" if isinstance(mesh, skfem.MeshWedge1) else "face", pressure=1e6,
                   friction=0.3)  # fmt: skip


@pytest.mark.parametrize("order", [1, 2])
def test_a_bolt_through_prisms_and_hexahedra_presses_with_its_force(order):
    """Its head presses sides of both kinds; the joint carries the clamp force and no moment."""
    first = mixed_box(1)
    nut = first.mesh.facets[:, first.boundaries["front"]]
    nut = nut[:, (first.mesh.p[0, nut] > 0.4 - 1e-9).all(axis=0)]
    sides = {name: first.mesh.facets[:, chosen] for name, chosen in first.boundaries.items()}
    lower = from_parts(
        CELLS["hexahedron"], first.mesh.p, first.mesh.t, regions={"low": np.arange(58)}, points={},
        facets={"left": sides["left"], "face": sides["face"], "nut": nut},
    )  # fmt: skip
    joint = {"on": "face", "against": "under", "pressure": "preload", "contact": "unilateral"}
    structure = lap(lower, order, [sj.Clamp(1e4, head="head", nut="nut")], **joint)
    (patch,) = structure.patches
    force = patch.opening.force
    assert force.sum() == pytest.approx(1e4, rel=1e-6)
    y = structure.nodes[patch.opening.nodes][:, 1]
    assert force.size == y.size
    assert force @ y / force.sum() == pytest.approx(0.025, abs=1e-4)


@pytest.mark.parametrize(("what", "order"), BOTH)
def test_interpolation_in_collapsed_elements_is_linear_up_to_their_edges(what, order):
    """Also at points on the edge that is collapsed, where the map of the element is singular."""
    body = body_of(what, order, inside=True)
    rng = np.random.default_rng(6)
    part = next(part for part in body.mesh.parts if part.kind is not body.cell)
    shares = rng.dirichlet(np.ones(part.kind.corners), 30)
    pairs = [(2, 5), (0, 3), (1, 4)] if what == "solid" else [(2, 2), (0, 1), (1, 2)]
    for i, j in pairs:
        on = np.zeros(part.kind.corners)
        on[i] += 0.3
        on[j] += 0.7
        shares = np.vstack([shares, on])
    chosen = rng.integers(part.elements.size, size=len(shares))
    corners = body.mesh.mesh.p[:, part.corners[:, chosen]]
    points = np.einsum("dck,kc->kd", corners, shares)
    matrix, gap = values_in(body, part.elements[chosen], points, np.zeros(len(points)))
    assert not gap.any()
    np.testing.assert_allclose(matrix @ body.nodes, points, atol=1e-12)
