"""Steppers and their compiled kernels: choice, tiers, halving, failure, and what they load."""

from __future__ import annotations

import subprocess
import sys
import textwrap
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from bars import CASE_I, LapJoint, tridiagonal
from scipy import sparse

from skfem_joint import friction, kernels_dense, kernels_fronts
from skfem_joint import kernels_tridiagonal as kernels
from skfem_joint.chain import build_chain
from skfem_joint.errors import ConvergenceError, InputError
from skfem_joint.integrate import HALVINGS, integrate
from skfem_joint.loads import Rectangle
from skfem_joint.recording import Recorder, Save
from skfem_joint.schemes import average_acceleration
from skfem_joint.steppers import (
    ChainStepper,
    DenseStepper,
    LinearStepper,
    Stepper,
    choose,
)
from skfem_joint.steppers_contact import ContactStepper
from skfem_joint.system import System


def stepper_of(system: System) -> Stepper:
    zero = np.zeros(system.n)
    recorder = Recorder(system, Save(), 1, 1e-5)
    return choose(system, average_acceleration(), zero, zero, 1e-11, recorder)


# Choice


def test_each_structure_gets_its_stepper() -> None:
    system = LapJoint(elements=10).system
    assert isinstance(stepper_of(system), ChainStepper)
    assert isinstance(stepper_of(replace(system, w=0 * system.w)), LinearStepper)
    assert isinstance(stepper_of(system.project(np.eye(10)[:, :3])), DenseStepper)
    # A slip row that joins two unknowns, or a matrix with more bands, is no chain.
    pair = sparse.csr_array(np.eye(10) - np.eye(10, k=1))
    assert isinstance(stepper_of(replace(system, B=pair)), DenseStepper)
    # One unknown for each slip row, but more bands: the contact stepper.
    band = sparse.csr_array(system.M + 1e-3 * sparse.eye_array(10, k=2) @ system.M)
    band = sparse.csr_array(0.5 * (band + band.T))
    assert isinstance(stepper_of(replace(system, M=band)), ContactStepper)


def test_observed_points_that_are_means_are_observed_right() -> None:
    system = LapJoint(elements=10).system
    mean = sparse.csr_array(np.full((1, 10), 0.1))
    run = integrate(
        replace(system, P=mean, points=("mean",)), step=1e-5, n_steps=50, save=Save(fields=True)
    )
    np.testing.assert_allclose(run.point("mean"), run.u.mean(axis=1), rtol=1e-12)


def test_coulomb_in_a_reduced_system_is_refused_with_advice() -> None:
    system = LapJoint(elements=10, beta=np.inf).system.project(np.eye(10)[:, :3])
    with pytest.raises(InputError, match="with_beta"):
        stepper_of(system)
    assert isinstance(stepper_of(system.with_beta(1e3)), DenseStepper)


def test_a_large_system_that_is_no_chain_is_refused() -> None:
    system = LapJoint(elements=600).system
    pair = sparse.csr_array(sparse.eye_array(600) - sparse.eye_array(600, k=1))
    with pytest.raises(InputError, match="reduce it first"):
        stepper_of(replace(system, B=pair))


def test_points_without_pressure_need_no_law_in_a_reduced_system() -> None:
    # A joint without friction may be Coulomb: it is never evaluated.
    system = LapJoint(elements=10, beta=1e3).system
    half = np.arange(10) < 5
    mixed = replace(
        system, w=np.where(half, 0.0, system.w), beta=np.where(half, np.inf, system.beta)
    )
    full = integrate(mixed, step=1e-5, n_steps=50)
    reduced = integrate(mixed.project(np.eye(10)), step=1e-5, n_steps=50)
    np.testing.assert_allclose(reduced.point_u, full.point_u, atol=1e-9 * full.peak[0])


# The step's problem


def problem(n: int, beta: float, seed: int, stiffness: float = 50.0) -> tuple[Any, ...]:
    """Random step problem: H a stiff chain, g a mixture of forces above and below the limits."""
    rng = np.random.default_rng(seed)
    springs = rng.uniform(0.5, 2.0, n + 1) * stiffness
    H0 = rng.uniform(0.5, 2.0, n) + springs[:-1] + springs[1:]
    H1 = -springs[1:-1]
    w = rng.uniform(0.5, 1.5, n) * (rng.random(n) < 0.8)
    g = 3.0 * rng.normal(size=n)
    return H0, H1, w, np.full(n, beta), g


def solve(method: str, H0: Any, H1: Any, w: Any, beta: Any, g: Any) -> tuple[bool, Any, Any]:
    """Solution by one tier alone: converged, v and sigma."""
    n = g.size
    chain = build_chain(H0, H1, w, beta)
    padded, s = np.zeros(chain.H0.size), np.zeros(chain.H0.size)
    padded[:n] = g
    work, trial = np.zeros((6, n)), np.zeros((3, n))
    if method == "newton":
        converged = kernels._newton(chain, 0, padded, s, work, 200, 1e-12)[1]
    elif method == "descend":
        converged = kernels._descend(chain, padded, s, work, trial, 1e-12)[1]
    else:
        converged = kernels._nested(chain, padded, s, work, 1e-12)[1]
    return bool(converged), work[0].copy(), work[1].copy()


# Newton alone may stall from a cold start on a long chain: that is what the other two are for.
@pytest.mark.parametrize(
    ("method", "n"),
    [("newton", 2), ("newton", 60), *((m, n) for m in ("nested", "descend") for n in (2, 60, 130))],
)
@pytest.mark.parametrize("beta", [1e2, 1e5, 1e9, np.inf])
def test_every_tier_finds_the_minimiser_of_the_step(method: str, beta: float, n: int) -> None:
    for seed in range(5):
        H0, H1, w, betas, g = problem(n, beta, seed)
        converged, v, sigma = solve(method, H0, H1, w, betas, g)
        assert converged
        residual = tridiagonal(H0, H1) @ v + w * sigma - g
        assert np.abs(residual).max() <= 1e-11 * max(1.0, np.abs(g).max())
        pressed = w > 0.0
        assert np.all(np.abs(sigma) <= 1.0)
        if np.isinf(beta):
            slips = pressed & (v != 0.0)
            np.testing.assert_array_equal(sigma[slips], np.sign(v[slips]))
        else:
            expected = friction.force(v[pressed], beta)
            np.testing.assert_allclose(sigma[pressed], expected, rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("stiffness", [50.0, 1e3, 1e5])
def test_flips_of_coulomb_points_end(stiffness: float) -> None:
    # Flipping all points at once cycles in about one in twelve; one at a time must come to an end.
    for n in (40, 60, 130):
        for seed in range(100):
            H0, H1, w, beta, g = problem(n, np.inf, seed, stiffness)
            converged, v, sigma = solve("newton", H0, H1, w, beta, g)
            assert converged, (n, seed)
            slips = (w > 0.0) & (v != 0.0)
            np.testing.assert_array_equal(sigma[slips], np.sign(v[slips]))


@pytest.mark.parametrize("beta", [1e2, 1e5, 1e9, np.inf])
def test_the_tiers_agree(beta: float) -> None:
    for seed in range(5):
        data = problem(60, beta, seed)
        _, newton, _ = solve("newton", *data)
        for method in ("nested", "descend"):
            _, v, _ = solve(method, *data)
            np.testing.assert_allclose(v, newton, rtol=0.0, atol=1e-10 * np.abs(newton).max())


def test_solution_has_the_least_objective() -> None:
    rng = np.random.default_rng(1)
    for beta in (1e3, np.inf):
        H0, H1, w, betas, g = problem(20, beta, 3)
        _, v, _ = solve("descend", H0, H1, w, betas, g)
        H = tridiagonal(H0, H1)

        def objective(x: Any, H: Any = H, g: Any = g, w: Any = w, beta: float = beta) -> float:
            return float(0.5 * x @ H @ x - g @ x + w @ friction.potential(x, beta))

        lowest = objective(v)
        assert lowest == pytest.approx(
            kernels._objective(build_chain(H0, H1, w, betas), g, v), rel=1e-12
        )
        for size in (1e-6, 1e-3, 1.0):
            for _ in range(20):
                assert objective(v + size * rng.normal(size=20)) > lowest


@pytest.mark.parametrize("n", [47, 48, 97, 100, 1001])
def test_coarse_problems_are_galerkin_projections_of_the_fine_one(n: int) -> None:
    H0, H1, w, beta, _ = problem(n, 1e5, 0)
    chain = build_chain(H0, H1, w, beta)
    start = chain.start
    assert start[1] == n
    assert start[-1] - start[-2] < 48
    total = w.sum()
    for a, b in pairwise(start):
        H = tridiagonal(chain.H0[a:b], chain.H1[a : b - 1])
        assert np.linalg.eigvalsh(H)[0] > 0.0
        # Interpolation preserves constants but at an end that is dropped.
        assert 0.9 * total <= chain.w[a:b].sum() <= total * (1 + 1e-12)
    assert chain.kappa > 0.0


def test_large_chains_converge_by_nested_solves() -> None:
    system = LapJoint(elements=20_000, beta=1e5).system
    run = integrate(system, step=1e-5, n_steps=12)
    assert run.counters.newton_iterations <= 60 * run.counters.steps
    assert run.counters.nested_solves > 0
    assert run.energy_residual < 1e-10


def passes(H0: Any, H1: Any, w: Any, g: Any, middle: int) -> tuple[int, bool, Any, Any, Any]:
    """Solution by passes alone: number, converged, v, sigma and s."""
    n = g.size
    chain = build_chain(H0, H1, w, np.full(n, np.inf))
    s, v, sigma, slip, r = np.zeros((5, n))
    count, converged, _ = kernels_fronts.passes_of(
        chain.H0[:n], chain.H1[:n], chain.w[:n], chain.hold, chain.pivot, chain.stretch,
        chain.kappa, g, s, v, sigma, slip, r, middle, 1e-12,
    )  # fmt: skip
    return int(count), bool(converged), v, sigma, s - chain.kappa * v


def pulled(n: int, ends: str, seed: int) -> tuple[Any, ...]:
    """Step problem of a chain pulled at its ends beyond what its first points hold."""
    H0, H1, w, _, g = problem(n, np.inf, seed, stiffness=1e3)
    w = np.maximum(w, 0.5)
    g = 0.1 * g * w
    if "left" in ends:
        g[0] -= 0.3 * w.sum()
    if "right" in ends:
        g[-1] += 0.3 * w.sum()
    return H0, H1, w, g


@pytest.mark.parametrize("ends", ["left", "right", "left and right"])
@pytest.mark.parametrize("n", [1, 2, 3, 40, 131, 1000])
def test_a_few_passes_find_slip_that_spreads_from_the_ends(n: int, ends: str) -> None:
    for seed in range(20):
        H0, H1, w, g = pulled(n, ends, seed)
        count, converged, v, sigma, inside = passes(H0, H1, w, g, n // 2)
        assert converged
        assert count <= 6
        residual = tridiagonal(H0, H1) @ v + w * sigma - g
        assert np.abs(residual).max() <= 1e-11 * np.abs(g).max()
        assert np.all(np.abs(sigma) <= 1.0)
        np.testing.assert_array_equal(sigma[v != 0.0], np.sign(v[v != 0.0]))
        np.testing.assert_allclose(inside, sigma, rtol=0.0, atol=1e-12 * (1 + np.abs(v).max()))
        if n > 3:
            assert 0 < np.count_nonzero(v) < n


def test_passes_agree_wherever_they_meet() -> None:
    # They need not converge on every problem, but what they call converged is the only solution.
    found = 0
    for seed in range(40):
        H0, H1, w, _, g = problem(60, np.inf, seed)
        _, expected, _ = solve("newton", H0, H1, w, np.full(60, np.inf), g)
        for middle in (0, 20, 59):
            _, converged, v, sigma, _ = passes(H0, H1, w, g, middle)
            found += converged
            if converged:
                atol = 1e-10 * np.abs(expected).max()
                np.testing.assert_allclose(v, expected, rtol=0.0, atol=atol)
                residual = tridiagonal(H0, H1) @ v + w * sigma - g
                assert np.abs(residual).max() <= 1e-11 * np.abs(g).max()
    assert found >= 20


@pytest.mark.parametrize(("per_period", "most"), [(25, 2.5), (50, 2.0), (100, 1.5), (1000, 1.5)])
def test_steps_under_coulomb_friction_take_a_pass_or_two(per_period: int, most: float) -> None:
    run = integrate(LapJoint(beta=np.inf).system, step=1e-3 / per_period, n_steps=3 * per_period)
    assert run.counters.newton_iterations <= most * run.counters.steps
    assert run.counters.nested_solves == run.counters.descents == 0


def test_a_regularised_start_has_the_velocity_of_slip_and_the_force_of_stick() -> None:
    v = np.array([2.0, -1e-3, 0.0, 0.0, 0.0])
    sigma = np.array([1.0, -1.0, 0.5, -0.9, 0.0])
    kind = np.array([friction.ARCTAN] * 5, dtype=np.int8)
    s = np.zeros(5)
    kernels._regularise(kind, v, sigma, 3.0, np.full(5, 1e-5), s)
    found = np.array([friction.graph_point(x, 3.0, 1e5)[:2] for x in s])
    np.testing.assert_allclose(found[:2, 0], v[:2], rtol=1e-10)
    np.testing.assert_allclose(found[2:, 1], sigma[2:], rtol=1e-10, atol=1e-15)


@pytest.mark.parametrize("beta", [1e5, 1e7, 1e9])
def test_coarse_steps_of_steep_laws_start_from_coulombs_solution(beta: float) -> None:
    # Without it such steps take 22 iterations and most of them nested ones.
    run = integrate(LapJoint(beta=beta).system, step=4e-5, n_steps=75)
    assert run.counters.newton_iterations <= 12 * run.counters.steps
    assert run.counters.nested_solves <= 5
    assert run.energy_residual < 1e-10


def test_passes_do_not_grow_with_the_chain() -> None:
    run = integrate(LapJoint(elements=20_000, beta=np.inf).system, step=1e-5, n_steps=12)
    assert run.counters.newton_iterations <= 2 * run.counters.steps
    assert run.counters.nested_solves == 0
    assert run.energy_residual < 1e-9


@pytest.mark.parametrize("beta", [1e5, np.inf])
@pytest.mark.parametrize("joint", [LapJoint(), CASE_I], ids=["reference", "case_I"])
def test_long_chains_need_neither_descents_nor_halved_steps(joint: LapJoint, beta: float) -> None:
    system = replace(joint, elements=10_000, beta=beta).system
    run = integrate(system, step=0.01 / joint.frequency, n_steps=45)
    counters = run.counters
    assert counters.steps == 45
    assert counters.descents == counters.halved_steps == 0
    assert counters.newton_iterations <= 60 * counters.steps
    assert run.energy_residual < 1e-9


@pytest.mark.parametrize("normal_force", ["equal", "consistent"])
def test_coulomb_points_at_the_edge_of_slip_do_not_flip_for_ever(normal_force: str) -> None:
    # Without rules for flips between stick and slip, Newton's iteration cycles in steps 50 to 65:
    # some of them then take descents, and some are halved.
    joint = LapJoint(elements=10_000, beta=np.inf, normal_force=normal_force)
    run = integrate(joint.system, step=1e-5, n_steps=65)
    assert run.counters.descents == run.counters.halved_steps == 0
    assert run.counters.largest_iterations <= 100
    assert run.energy_residual < 1e-9


@pytest.mark.parametrize("beta", [1e5, np.inf])
@pytest.mark.parametrize("steps_per_period", [10, 30, 3000])
def test_coarse_and_very_fine_steps_converge(beta: float, steps_per_period: int) -> None:
    system = LapJoint(elements=800, beta=beta).system
    n_steps = min(2 * steps_per_period, 300)
    run = integrate(system, step=1e-3 / steps_per_period, n_steps=n_steps)
    assert run.counters.steps == n_steps
    assert run.energy_residual < 1e-9


def test_a_joint_of_one_element_is_a_friction_oscillator() -> None:
    # One unknown: below the limit nothing moves, above it the balance closes.
    for beta in (1e5, np.inf):
        run = integrate(LapJoint(elements=1, beta=beta).system, step=1e-5, n_steps=100)
        assert run.energy_residual < 1e-10
    limit = 0.7 * 8e6 * 0.05 * 0.25
    stuck = LapJoint(elements=1, beta=np.inf, force=0.99 * limit).system
    assert integrate(stuck, step=1e-5, n_steps=100).peak[0] == 0.0


# Steps that do not converge


def refusing(kernel: Any, refuses: Any) -> Any:
    """March that reports no convergence for steps that ``refuses`` (first step, step size)."""

    def march(n_steps: int, first: int, every: int, fields_every: int, c: Any, *rest: Any) -> Any:
        if n_steps > 0 and refuses(first, c[0]):
            return 0, 0, 0, 12.5, 3
        return kernel(n_steps, first, every, fields_every, c, *rest)

    return march


def test_steps_that_do_not_converge_are_halved(monkeypatch: pytest.MonkeyPatch) -> None:
    system = LapJoint(elements=20).system
    fine = integrate(system, step=0.5e-5, n_steps=80, save=Save(every=2), cycle_steps=40)
    march = refusing(kernels.march, lambda first, h: h > 0.6e-5)
    monkeypatch.setattr(kernels, "march", march)
    halved = integrate(system, step=1e-5, n_steps=40, cycle_steps=20)
    assert halved.counters.halved_steps == 40
    assert halved.counters.steps == 40
    assert halved.times.size == 41
    np.testing.assert_allclose(halved.point_u, fine.point_u, atol=1e-10 * fine.peak[0])
    np.testing.assert_allclose(halved.input_work, fine.input_work, rtol=1e-9)
    np.testing.assert_allclose(halved.cycles.friction, fine.cycles.friction, rtol=1e-9)
    assert halved.energy_residual < 1e-10


def test_a_step_that_never_converges_is_an_error_that_says_where(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    sizes: list[float] = []

    def refuses(first: int, h: float) -> bool:
        if first + 1 > 7:
            sizes.append(h)
        return first >= 7

    monkeypatch.setattr(kernels, "march", refusing(kernels.march, refuses))
    system = LapJoint(elements=20).system
    with pytest.raises(ConvergenceError) as caught:
        # One cycle a step, so that the eighth step begins a chunk of its own.
        integrate(system, step=1e-5, n_steps=40, cycle_steps=1)
    message = str(caught.value)
    assert "step 7 " in message
    assert "7e-05 s" in message
    assert "12.5 N" in message
    assert "unknown 3" in message
    assert "Try more steps per cycle" in message
    assert caught.value.exit_status == 3
    assert min(sizes) == pytest.approx(1e-5 / 2**HALVINGS, rel=1e-6)


class Broken:
    """Load that is not a number from a time on."""

    corners = ()
    peak_value = 1e3
    highest_frequency = period = None

    def __init__(self, since: float) -> None:
        self.since = since

    def __call__(self, t: Any) -> Any:
        return np.where(np.asarray(t) < self.since, 1e3, np.nan)


@pytest.mark.parametrize("kind", ["chain", "coulomb", "dense", "linear"])
def test_a_solution_that_is_not_a_number_is_never_returned(kind: str) -> None:
    joint = LapJoint(
        elements=20,
        beta=np.inf if kind == "coulomb" else 1e5,
        friction=0.0 if kind == "linear" else 0.7,
        load=Broken(1.55e-4),  # type: ignore[arg-type]
    )
    system = joint.system
    if kind == "dense":
        system = system.project(np.eye(20))
    with pytest.raises(ConvergenceError, match=r"step 15 at t = 0\.00015"):
        integrate(system, step=1e-5, n_steps=40)


def test_a_tolerance_below_round_off_still_ends() -> None:
    # Convergence is judged against the round-off of the residual, so zero asks for no more.
    system = LapJoint(elements=50).system
    loose = integrate(system, step=1e-5, n_steps=100)
    tight = integrate(system, step=1e-5, n_steps=100, tolerance=0.0)
    np.testing.assert_allclose(tight.point_u, loose.point_u, atol=1e-9 * loose.peak[0])


# Start under load


def test_coulomb_points_at_rest_start_to_slip_only_as_far_as_the_load_reaches() -> None:
    # A load that is there at the start: the accelerations obey the law that velocities will.
    joint = LapJoint(elements=50, beta=np.inf, load=Rectangle(63e3, 1.0))
    run = integrate(joint.system, step=1e-6, n_steps=10, save=Save(fields=True))
    sigma = run.sigma[0]
    assert sigma[-1] == 1.0
    assert np.all(np.abs(sigma) <= 1.0)
    assert np.abs(sigma[0]) < 1e-6
    assert run.energy_residual < 1e-10
    quiet = replace(joint, load=Rectangle(0.5 * 0.7 * 8e6 * 0.05 * 0.25 / 50, 1.0))
    still = integrate(quiet.system, step=1e-6, n_steps=10, save=Save(fields=True))
    assert np.all(still.u == 0.0)
    assert still.sigma[-1, -1] == pytest.approx(0.5, rel=1e-12)


# What is loaded


def loaded_by(code: str) -> set[str]:
    """Top-level modules in memory after running the code in a fresh interpreter."""
    tail = "\nimport sys\nprint(*sorted({name.split('.')[0] for name in sys.modules}))"
    result = subprocess.run(
        [sys.executable, "-c", textwrap.dedent(code) + tail],
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    return set(result.stdout.splitlines()[-1].split())


HEAVY = {"meshio", "pyvista", "vtk", "vtkmodules", "matplotlib", "numba"}


def test_import_of_the_package_loads_nothing_heavy() -> None:
    assert not HEAVY & loaded_by("import skfem_joint")


def test_a_run_without_friction_loads_no_compiler_and_evaluates_no_friction() -> None:
    modules = loaded_by(
        """
        from skfem_joint.integrate import integrate
        from skfem_joint.loads import Harmonic
        from skfem_joint.meshing import build_bar
        from skfem_joint.structure import Joint, assemble, build_structure

        bar = build_bar([("joint", 0.25, 10)], {"fixed": 0.0, "free_end": 0.25})
        structure = build_structure(
            bar, E=200e9, density=8000.0, width=0.05, thickness=0.01, fixed=["fixed"],
            joints=[Joint("joint", 8e6, 0.0)],
        )
        run = integrate(
            assemble(structure, [("free_end", Harmonic(1e3, 1e3))]), step=1e-5, n_steps=20
        )
        assert run.counters.friction_evaluations == 0
        """
    )
    assert "skfem" in modules
    assert not {"numba", "pyvista", "vtk", "vtkmodules", "matplotlib"} & modules


@pytest.mark.parametrize("row", [0, 5, 9])
def test_one_entry_that_is_not_a_number_is_seen_wherever_it_is(row: int) -> None:
    # Everything else is at rest and in balance, so this entry alone must tell.
    H0, H1, w, beta, _ = problem(10, 1e5, 0)
    g = np.zeros(10)
    g[row] = np.nan
    for method in ("newton", "nested", "descend"):
        assert not solve(method, H0, H1, w, beta, g)[0]
    q, slip, sigma = np.zeros(10), np.zeros(10), np.zeros(10)
    contact = kernels_dense.contact_of(np.eye(10), np.arange(11), w, beta)
    room = kernels_dense.make_room(10, 10, 10)
    converged = kernels_dense.solve_step(
        tridiagonal(H0, H1), contact, g, q, slip, sigma, 1e-12, room
    )[2]
    assert not converged


@pytest.mark.parametrize("part", [0, 1])
def test_a_start_that_is_not_a_number_is_refused(part: int) -> None:
    system = LapJoint(elements=10).system
    start = np.zeros((2, 10))
    start[part, 3] = np.nan
    with pytest.raises(InputError, match="initial"):
        integrate(system, step=1e-5, n_steps=10, initial=(start[0], start[1]))
