"""Supports that are accelerated together: the motion relative to them, in every dimension."""

import numpy as np
import pytest
from bodies import DENSITY, ELEMENTS, THICKNESS, WIDTH, E, block, pressed, structure
from scipy import sparse

import skfem_joint as sj
from skfem_joint.ground import loads

ACCELERATION = 3.0


@pytest.mark.parametrize("along", ["first", "last"])
@pytest.mark.parametrize(("shape", "order"), [e for e in ELEMENTS if e[0] == "line" or e[1] == 2])
def test_a_body_under_constant_acceleration_hangs_like_under_its_weight(shape, order, along):
    """Without Poisson effect a column of length L strains by rho a (L - x) / E."""
    body = block(shape, order, size=(2.0, 1.0, 0.5))
    axis, fixed = (0, "left") if along == "first" or body.dim == 1 else (body.dim - 1, "base")
    some = structure(body, fixed=[fixed], material=sj.Material(E, DENSITY, 0.0))
    system = some.system([sj.Load(base="xyz"[axis], amplitude=lambda t: ACCELERATION + 0.0 * t)])
    force = system.loads[0].vector * system.loads[0].amplitude(0.0)
    u = some.expand(sparse.linalg.spsolve(system.K.tocsc(), force))
    x = some.nodes[:, axis]
    exact = np.zeros_like(u)
    exact[:, axis] = -DENSITY * ACCELERATION / E * (x.max() * x - 0.5 * x**2)
    np.testing.assert_allclose(u, exact, atol=1e-9 * np.abs(exact).max())
    volume = np.prod(np.ptp(some.nodes, axis=0)) * some.body.across[0]
    assert -system.loads[0].amplitude(0.0) == pytest.approx(DENSITY * ACCELERATION * volume)
    assert "mass_" in system.points[0]


def test_a_single_mass_answers_a_harmonic_acceleration_in_closed_form():
    """The mass that the support shares with its neighbour pushes too: rho A L / 2 in all."""
    whole, length, shake = DENSITY * WIDTH * THICKNESS, 1.0, 2.0 * np.pi * 300.0
    some = structure(
        sj.build_bar([("bar", length, 1)], {"fixed": 0.0, "end": length}), (), ["fixed"]
    )
    system = some.system([sj.Load(base="x", amplitude=loads.Harmonic(ACCELERATION, 300.0))])
    omega = np.sqrt(3.0 * E / DENSITY) / length
    run = sj.integrate(system, step=2e-7, n_steps=8000, save=sj.Save(every=20))
    exact = np.sin(shake * run.times) - shake / omega * np.sin(omega * run.times)
    exact *= -(whole / 2.0) / (whole / 3.0) * ACCELERATION / (omega**2 - shake**2)
    np.testing.assert_allclose(run.point("end"), exact, atol=1e-5 * np.abs(exact).max())


TIMES = np.array([0.0, 3e-4, 1e-3])
SHAPES = [
    sj.Harmonic(2e4, 800.0, 0.3),
    sj.MultiHarmonic((sj.Harmonic(2e4, 800.0), sj.Harmonic(2e4, 1600.0))),
    sj.Triangle(2e4, 4e-4),
    sj.Table(TIMES, np.array([0.0, 2e4, -2e4])),
]


def shaken(amplitude: loads.Amplitude) -> tuple[sj.Structure, sj.System]:
    """Bar that is pressed on a base and held by it, and its motion relative to the base."""
    body = sj.build_bar([("joint", 0.2, 4), ("free", 0.2, 2)], {"fixed": 0.0, "end": 0.4})
    some = structure(body, [pressed(beta=1e3)], ["fixed"], stiffness_damping=1e-5)
    return some, some.system([sj.Load(base="x", amplitude=amplitude)])


@pytest.mark.parametrize("amplitude", SHAPES)
def test_a_load_by_a_moving_base_has_the_corners_and_frequencies_of_its_motion(amplitude):
    load = shaken(amplitude)[1].loads[0].amplitude
    for name in ("corners", "jumps", "period", "highest_frequency"):
        assert getattr(load, name) == getattr(amplitude, name)


def test_a_moving_base_is_a_heavy_body_that_is_pushed():
    """Bar, base and friction between them as masses of their own in absolute motion."""
    amplitude = SHAPES[-1]
    some, relative = shaken(amplitude)
    M, K = some.matrices()
    heavy = 1e6 * M.sum()
    base = np.eye(M.shape[0])[int(np.flatnonzero(some.held.ravel())[0])]
    rows = (np.asarray(row) - base for row in (relative.contact.B @ relative.T.T).toarray())
    slip = [
        sj.point_friction(row, w, beta=1e3) for row, w in zip(rows, relative.contact.w, strict=True)
    ]
    absolute = sj.System.from_matrices(
        sparse.csr_array(M + heavy * sparse.csr_array(np.outer(base, base))),
        K,
        contact=sum(slip[1:], slip[0]),
        loads={"base": (base, loads.Scaled(amplitude, heavy))},
        points={"end": some.mesh.points["end"]},
        stiffness_damping=1e-5,
    )
    one, two = (sj.integrate(system, step=1e-6, n_steps=1000) for system in (relative, absolute))
    moved = two.point("end") - two.point("base")
    assert one.slip_peak.max() > 1e-7
    np.testing.assert_allclose(moved, one.point("end"), atol=2e-5 * np.abs(moved).max())
