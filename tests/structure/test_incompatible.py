"""Incompatible modes of quadrilaterals and hexahedra of first order against theorems and beams."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from bodies import ELEMENTS, NU, STEEL, E, block, section, structure
from scipy.sparse.linalg import spsolve
from test_solids import slanted

import skfem_joint as sj
from skfem_joint.body import incompatible
from skfem_joint.body.body import Body
from skfem_joint.scene.reading import scene_from

SHAPES = [("quad", "stress"), ("quad", "strain"), ("hex", "stress")]
LONG, WIDE, HIGH = 0.3, 0.03, 0.01


def distorted_body(shape: str, n: int = 2, plane: str = "stress", **changes: Any) -> Body:
    mesh = slanted(block(shape, 1, n, (0.4, 0.3, 0.2)))
    return Body(mesh, **{"material": STEEL, **section(mesh), "plane": plane, **changes})


@pytest.mark.parametrize("shape", ["quad", "hex"])
def test_matrices_do_not_depend_on_how_many_elements_are_in_memory(shape, monkeypatch):
    at_once = distorted_body(shape).matrices()[1]
    monkeypatch.setattr(incompatible, "_PIECE", 3)
    in_pieces = distorted_body(shape).matrices()[1]
    assert abs(at_once - in_pieces).max() < 1e-14 * abs(at_once).max()
    assert abs(in_pieces - in_pieces.T).max() == 0.0


@pytest.mark.parametrize(("shape", "order"), ELEMENTS)
def test_only_stiffness_and_only_quadrilaterals_and_hexahedra_of_first_order_change(shape, order):
    mesh = slanted(block(shape, order, 1, (0.4, 0.3, 0.2)))
    with_modes = structure(mesh, fixed=(), free=True)
    plain = structure(mesh, fixed=(), free=True, incompatible=False, like=with_modes)
    (M, K), (same, other) = with_modes.matrices(), plain.matrices()
    assert abs(M - same).max() == 0.0
    differs = (shape, order) in (("quad", 1), ("hex", 1))
    assert (abs(K - other).max() > 0.0) == differs == with_modes.body.has_incompatible_modes
    assert not plain.body.has_incompatible_modes


@pytest.mark.parametrize(("shape", "plane"), SHAPES)
def test_stiffness_is_that_of_corners_and_modes_that_no_force_acts_on(shape, plane):
    """Of one brick, integrated here with the modes as unknowns; the mass is that of the corners."""
    one = {"quad": sj.build_plate, "hex": sj.build_box}[shape]
    size = (0.3, 1) if shape == "quad" else ((0.3, 0.2), (1, 1))
    mesh = one([("all", 0.4, 1)], *size)
    body = Body(mesh, STEEL, plane, **section(mesh))
    M, K = (A.toarray() for A in body.matrices())
    sides, (first, second), dim = np.ptp(body.nodes, axis=0), body.lame(), body.dim
    at, weight = np.polynomial.legendre.leggauss(4)
    signs = np.where(body.nodes > body.nodes.mean(axis=0), 1.0, -1.0)
    whole_M, whole_K = np.zeros((2, len(M) + dim**2, len(M) + dim**2))
    for place in np.ndindex(*(at.size,) * dim):
        xi = at[list(place)]
        dx = np.prod(weight[list(place)]) * np.prod(sides) / 2.0**dim * body.across[0]
        factors = 0.5 * (1.0 + signs * xi)
        values = [*np.prod(factors, axis=1), *(1.0 - xi**2)]
        slopes = [
            [0.5 * s[k] * np.prod(np.delete(f, k)) for k in range(dim)]
            for s, f in zip(signs, factors, strict=True)
        ]  # fmt: skip
        gradients = np.vstack([slopes, np.diag(-2.0 * xi)]) * 2.0 / sides
        products = np.einsum("ai,bj->aibj", gradients, gradients)
        traces = np.einsum("ak,bk,ij->aibj", gradients, gradients, np.eye(dim))
        both = first[0] * products + second[0] * (products.transpose(0, 3, 2, 1) + traces)
        whole_K += dx * both.reshape(whole_K.shape)
        whole_M += dx * STEEL.density * np.kron(np.outer(values, values), np.eye(dim))
    corners, modes = slice(len(M)), slice(len(M), None)
    follow = -np.linalg.solve(whole_K[modes, modes], whole_K[modes, corners])
    of_corners = whole_K[corners, corners] + whole_K[corners, modes] @ follow
    for found, expected in ((K, of_corners), (M, whole_M[corners, corners])):
        assert np.abs(found - expected).max() < 1e-13 * np.abs(expected).max()


@pytest.mark.parametrize("plane", ["stress", "strain"])
def test_a_single_row_of_rectangles_bends_as_the_beam_does(plane):
    """Under an even moment exactly, with the bending across of Poisson's ratio.

    The bending is u = k x y, v = -k x^2 / 2 - nu k y^2 / 2, with nu / (1 - nu) in plane strain.
    """
    body = Body(
        sj.build_plate([("all", LONG, 6)], HIGH, 1, origin=(0.0, -HIGH / 2)),
        STEEL, plane, thickness=WIDE,
    )  # fmt: skip
    across, modulus = (NU, E) if plane == "stress" else (NU / (1.0 - NU), E / (1.0 - NU**2))
    x, y = body.nodes.T
    exact = np.stack([x * y, -0.5 * x**2 - 0.5 * across * y**2], axis=1)
    moment = modulus * WIDE * HIGH**3 / 12.0
    force = np.zeros_like(exact)
    for at, sign in ((0.0, -1.0), (LONG, 1.0)):
        end = np.flatnonzero(x == at)
        force[end, 0] = sign * moment / HIGH * np.sign(y[end])
    found = (body.matrices()[1] @ exact.ravel()).reshape(exact.shape)
    np.testing.assert_allclose(found, force, rtol=0, atol=1e-9 * np.abs(force).max())


def tip(mesh: sj.NamedMesh, **changes: Any) -> float:
    """Displacement of a cantilever's end under a force across it."""
    some = structure(mesh, **{"thickness": WIDE} if mesh.dim == 2 else {}, **changes)
    shares = some.T.T @ np.outer(some.body.even_shares("right"), np.eye(some.dim)[-1]).ravel()
    return float(shares @ spsolve(some.unloaded.K.tocsc(), shares))


def strip(elements: int, layers: int, *, wide: int = 0, order: int = 1) -> sj.NamedMesh:
    """Quadrilaterals, or hexahedra where there are some along the width."""
    strips = [("all", LONG, elements)]
    if not wide:
        return sj.build_plate(strips, HIGH, layers, order=order)
    return sj.build_box(strips, (WIDE, HIGH), (wide, layers), order=order)


#: Converged tips, m/N, by 27-node hexahedra 60 x 6 x 2 and 9-node quadrilaterals 120 x 4.
SOLID_TIP, PLANE_TIP = 1.78749e-5, 1.80038e-5


def error(mesh: sj.NamedMesh, **changes: Any) -> float:
    """Relative error of the tip in per cent."""
    return 100.0 * (tip(mesh, **changes) / (SOLID_TIP if mesh.dim == 3 else PLANE_TIP) - 1.0)


@pytest.mark.slow
def test_converged_tips():
    assert tip(strip(60, 2, wide=6, order=2)) == pytest.approx(SOLID_TIP, rel=1e-5)
    assert tip(strip(120, 4, order=2)) == pytest.approx(PLANE_TIP, rel=1e-5)


@pytest.mark.parametrize(
    ("elements", "layers", "wide", "plain", "with_modes"),
    [
        (30, 1, 3, -35.0, -0.06),
        (60, 2, 6, -12.0, -0.11),
        (15, 2, 3, -61.5, -1.02),
        (30, 1, 0, -32.6, 0.02),
    ],
)
def test_a_cantilever_does_not_lock(elements, layers, wide, plain, with_modes):
    mesh = strip(elements, layers, wide=wide)
    assert error(mesh) == pytest.approx(with_modes, abs=0.02)
    assert error(mesh, incompatible=False) == pytest.approx(plain, abs=0.1)


@pytest.mark.parametrize("given", [{}, {"incompatible": False}, {"incompatible": True}])
def test_a_scene_chooses_the_elements(given):
    mesh = strip(4, 1)
    tables = {
        "mesh": {"file": "strip.msh"} | given,
        "material": {"E": E, "density": 8000.0, "poisson": NU},
        "section": {"thickness": WIDE},
        "support": {"fixed": ["left"]},
        "load": [{"kind": "harmonic", "on": "right", "direction": [0.0, 1.0],
                  "amplitude": 1.0, "frequency": 10.0}],
        "time": {"cycles": 1},
    }  # fmt: skip
    made = scene_from(tables, mesh).structure()
    assert isinstance(made, sj.Structure)
    expected = structure(mesh, thickness=WIDE, **given)
    assert abs(made.matrices()[1] - expected.matrices()[1]).max() == 0.0
    assert made.body.has_incompatible_modes == given.get("incompatible", True)
