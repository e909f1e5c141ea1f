"""Implicit integration of the paper's joints: published numbers, closed forms and invariants."""

from __future__ import annotations

import tracemalloc
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from bars import (
    CASE_I,
    EA,
    LapJoint,
    bar_structure,
    order_of,
    oscillator,
)

from skfem_joint import pseudo_static
from skfem_joint.errors import InputError
from skfem_joint.integrate import integrate
from skfem_joint.loads import Harmonic, Rectangle, Triangle
from skfem_joint.meshing import build_bar, load_mesh
from skfem_joint.recording import Save
from skfem_joint.schemes import Scheme, average_acceleration, generalized_alpha, hht
from skfem_joint.structure import Joint, assemble
from skfem_joint.system import System

MESHES = Path(__file__).parents[1] / "meshes"
REFERENCE = LapJoint()
SCHEMES = [generalized_alpha(rho) for rho in (0.0, 0.5, 0.8, 1.0)]
SCHEMES += [hht(0.1), hht(1.0 / 3.0), average_acceleration()]


# Published numbers


def test_case_i_has_the_peak_and_loop_of_table_3() -> None:
    run = integrate(CASE_I.system, step=1 / 2000 / 200, n_steps=8 * 200, cycle_steps=200)
    assert run.cycles.peak[-1, 0] == pytest.approx(7.14e-4, rel=3e-3)
    assert run.cycles.input[-1, 0] == pytest.approx(681.0, rel=3e-3)


def test_structure_of_figure_18_has_the_friction_energy_of_section_7_3() -> None:
    bar = load_mesh(MESHES / "structure.msh")
    structure = bar_structure(bar, [Joint("joint", 50e6, 0.7, 1e7, "equal")])
    system = assemble(structure, [("free_end", Harmonic(87.5e3, 500.0))])
    run = integrate(system, step=1 / 500 / 200, n_steps=12 * 200, cycle_steps=200)
    assert run.cycles.friction[-1] == pytest.approx(3.09, rel=0.01)


@pytest.mark.parametrize("kind", ["equal", "consistent"])
def test_slow_coulomb_joint_has_the_pseudo_static_loop(kind: str) -> None:
    joint = LapJoint(beta=np.inf, frequency=1.0, normal_force=kind)
    run = integrate(joint.system, step=1 / 400, n_steps=2 * 400, cycle_steps=400)
    loop = pseudo_static.loop_energy(joint.force, EA, joint.tau)
    assert run.cycles.input[-1, 0] == pytest.approx(loop, rel=5e-3)
    assert run.cycles.friction[-1] == pytest.approx(loop, rel=5e-3)
    peak = pseudo_static.peak_displacement(joint.force, EA, joint.tau)
    # One element in a hundred is what the paper's equal forces are off.
    assert run.cycles.peak[-1, 0] == pytest.approx(peak, rel=1.2e-2 if kind == "equal" else 1e-3)


# The law's steepness


def test_arctan_tends_to_coulomb_as_beta_grows() -> None:
    coulomb = integrate(replace_beta(np.inf), step=1e-5, n_steps=300)
    betas = 10.0 ** np.arange(3, 12)
    errors = [
        np.abs(run.point("free_end") - coulomb.point("free_end")).max() / coulomb.peak[0]
        for run in (integrate(replace_beta(b), step=1e-5, n_steps=300) for b in betas)
    ]
    assert np.all(np.diff(errors) < 0.0)
    # The distance of the laws themselves falls with the root of 1 / beta (see test_friction).
    assert order_of(errors, 1.0 / betas) > 0.5
    assert errors[-1] < 1e-6


def replace_beta(beta: float) -> System:
    return replace(REFERENCE, beta=beta).system


@pytest.mark.parametrize("beta", [1e4, 1e5, 1e6, 1e7, 1e8, 1e9, np.inf])
def test_newton_work_does_not_depend_on_beta(beta: float) -> None:
    run = integrate(replace_beta(beta), step=1e-5, n_steps=300)
    assert run.counters.newton_iterations <= 12 * run.counters.steps
    assert run.counters.steps == 300
    assert run.counters.halved_steps == 0
    assert run.counters.descents == 0


def test_sticking_points_under_coulomb_do_not_move_at_all() -> None:
    joint = replace(REFERENCE, beta=np.inf)
    run = integrate(joint.system, step=1e-5, n_steps=300, save=Save(fields=True))
    sticks = np.abs(run.sigma) < 1.0
    assert 0.5 < sticks.mean() < 1.0
    assert np.all(run.v[sticks] == 0.0)
    assert np.all(np.abs(run.sigma) <= 1.0)
    slips = run.v != 0.0
    np.testing.assert_array_equal(run.sigma[slips], np.sign(run.v[slips]))


@pytest.mark.parametrize("beta", [1e3, 1e5])
def test_stored_states_fulfil_the_law_and_the_equation_of_motion(beta: float) -> None:
    system = replace_beta(beta)
    run = integrate(system, step=1e-5, n_steps=100, save=Save(fields=True))
    np.testing.assert_allclose(
        run.sigma, 2 / np.pi * np.arctan(beta * (system.B @ run.v.T).T), rtol=1e-12, atol=1e-300
    )
    # The trapezoidal rule at two neighbours sums their forces to a change of momentum.
    forces = (
        system.load_vectors() @ system.load_amplitudes(run.field_times)
        - system.C @ run.v.T
        - system.K @ run.u.T
        - system.B.T @ (system.w[:, None] * run.sigma.T)
    )
    impulse = 0.5e-5 * (forces[:, 1:] + forces[:, :-1])
    momentum = np.diff(system.M @ run.v.T, axis=1)
    np.testing.assert_allclose(momentum, impulse, atol=1e-9 * np.abs(impulse).max())


# Energy


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("beta", [1e5, np.inf])
def test_energy_balance_closes_for_every_scheme(scheme: Scheme, beta: float) -> None:
    system = replace_beta(beta)
    run = integrate(system, step=1e-5, n_steps=300, scheme=scheme, cycle_steps=100)
    assert run.energy_residual < 1e-10
    cycles = run.cycles
    works = (run.input_work[0], run.viscous_work, run.scheme_work, run.friction_work.sum())
    sums = (cycles.input.sum(), cycles.viscous.sum(), cycles.scheme.sum(), cycles.friction.sum())
    np.testing.assert_allclose(works, sums, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("scheme", SCHEMES)
def test_energy_balance_closes_without_friction(scheme: Scheme) -> None:
    system = replace(REFERENCE, friction=0.0).system
    assert integrate(system, step=1e-5, n_steps=300, scheme=scheme).energy_residual < 1e-10


def test_energy_balance_closes_for_a_dense_system_and_from_a_moving_start() -> None:
    system = LapJoint(elements=12).system
    rng = np.random.default_rng(0)
    start = (1e-5 * rng.normal(size=12), rng.normal(size=12))
    for model, state in (
        (system, start),
        (system.project(np.eye(12)), start),
        (replace(system, w=0 * system.w), start),
    ):
        for scheme in SCHEMES:
            run = integrate(model, step=1e-5, n_steps=100, scheme=scheme, initial=state)
            assert run.energy_residual < 1e-10
            assert run.stored_energy[0] == pytest.approx(system.stored_energy(*start), rel=1e-12)


@pytest.mark.parametrize("rho", [0.5, 1.0])
@pytest.mark.parametrize("beta", [1e3, 1e5, 1e8, np.inf])
def test_friction_is_passive_and_no_energy_comes_from_nothing(beta: float, rho: float) -> None:
    system = replace_beta(beta)
    run = integrate(
        system, step=1e-5, n_steps=400, save=Save(fields=True), scheme=generalized_alpha(rho)
    )
    assert np.all(run.friction_work >= 0.0)
    assert run.viscous_work > 0.0
    stored = 0.5 * np.einsum("ti,it->t", run.v, system.M @ run.v.T)
    stored += 0.5 * np.einsum("ti,it->t", run.u, system.K @ run.u.T)
    force, tip = run.amplitudes[:, 0], run.point("free_end")
    given = np.concatenate([[0.0], np.cumsum(0.5 * (force[1:] + force[:-1]) * np.diff(tip))])
    assert given[-1] == pytest.approx(run.input_work[0], rel=1e-10)
    assert np.all(stored <= given + 1e-9 * given.max())


def test_average_acceleration_dissipates_nothing_itself() -> None:
    run = integrate(REFERENCE.system, step=1e-5, n_steps=300, scheme=average_acceleration())
    assert run.scheme_work == 0.0


def test_undamped_free_vibration_keeps_its_energy() -> None:
    system = LapJoint(friction=0.0, options={"stiffness_damping": 0.0}, force=0.0).system
    start = (np.linspace(0.0, 1e-4, system.n), np.zeros(system.n))
    run = integrate(system, step=1e-5, n_steps=500, initial=start)
    assert run.stored_energy[1] == pytest.approx(run.stored_energy[0], rel=1e-11)


# Symmetries


def test_pushing_is_pulling_with_the_sign_changed() -> None:
    pull, push = (
        integrate(replace(REFERENCE, force=sign * 63e3).system, step=1e-5, n_steps=300)
        for sign in (1.0, -1.0)
    )
    np.testing.assert_array_equal(push.point_u, -pull.point_u)
    np.testing.assert_array_equal(push.friction_work, pull.friction_work)


@pytest.mark.parametrize("beta", [1e5, np.inf])
def test_answer_does_not_depend_on_units(beta: float) -> None:
    si = integrate(replace_beta(beta), step=1e-5, n_steps=300)
    bar = build_bar([("joint", 250.0, 100)], {"fixed": 0.0, "free_end": 250.0})
    millimetre_tonne = bar_structure(
        bar, [Joint("joint", 8.0, 0.7, beta / 1e3, "equal")],
        E=2e5, density=8e-9, width=50.0, thickness=10.0,
    )  # fmt: skip
    system = assemble(millimetre_tonne, [("free_end", Harmonic(63e3, 1000.0))])
    run = integrate(system, step=1e-5, n_steps=300)
    np.testing.assert_allclose(
        run.point("free_end") / 1e3, si.point("free_end"), rtol=0.0, atol=1e-10 * si.peak[0]
    )
    assert run.input_work[0] / 1e3 == pytest.approx(si.input_work[0], rel=1e-10)


def test_scaling_force_and_friction_together_scales_a_coulomb_joint() -> None:
    single = integrate(replace_beta(np.inf), step=1e-5, n_steps=200)
    double = integrate(
        replace(REFERENCE, beta=np.inf, force=126e3, pressure=16e6).system, step=1e-5, n_steps=200
    )
    np.testing.assert_allclose(double.point_u, 2 * single.point_u, atol=1e-11 * single.peak[0])


@pytest.mark.parametrize("basis", ["unit", "orthogonal", "scaled", "gaussian"])
def test_a_full_rank_basis_is_the_full_model(basis: str) -> None:
    system = REFERENCE.system
    gaussian = np.random.default_rng(0).normal(size=(system.n, system.n))
    V = {
        "unit": np.eye(system.n),
        "orthogonal": np.linalg.qr(gaussian)[0],
        "scaled": np.linalg.qr(gaussian)[0] * np.geomspace(1e-3, 1e3, system.n),
        "gaussian": gaussian,
    }[basis]
    full = integrate(system, step=1e-5, n_steps=200, cycle_steps=100)
    reduced = integrate(system.project(V), step=1e-5, n_steps=200, cycle_steps=100)
    np.testing.assert_allclose(reduced.point_u, full.point_u, rtol=0.0, atol=1e-8 * full.peak[0])
    np.testing.assert_allclose(reduced.cycles.friction, full.cycles.friction, rtol=1e-7)
    np.testing.assert_allclose(reduced.friction_work, full.friction_work, rtol=1e-5, atol=1e-9)
    np.testing.assert_allclose(V @ reduced.final[0], full.final[0], atol=1e-8 * full.peak[0])


# Without friction


def test_zero_friction_is_the_linear_solution() -> None:
    frictionless = replace(REFERENCE, friction=0.0).system
    bar = build_bar([("joint", 0.25, 100)], {"fixed": 0.0, "free_end": 0.25})
    free = assemble(bar_structure(bar), [("free_end", Harmonic(63e3, 1000.0))])
    assert frictionless.contact_points == 0
    assert frictionless.w.size == 100
    a = integrate(frictionless, step=1e-5, n_steps=300)
    b = integrate(free, step=1e-5, n_steps=300)
    np.testing.assert_array_equal(a.point_u, b.point_u)
    assert a.counters.friction_evaluations == 0
    assert a.counters.newton_iterations == 0
    # The compiled steps with a friction that cannot be felt agree to round-off.
    faint = integrate(replace(REFERENCE, friction=1e-18).system, step=1e-5, n_steps=300)
    assert faint.counters.friction_evaluations > 0
    np.testing.assert_allclose(faint.point_u, a.point_u, rtol=0.0, atol=1e-11 * a.peak[0])


# Loads that jump


def oscillator_under_rectangle(times: np.ndarray, load: Rectangle) -> np.ndarray:
    """Exact displacement of the test oscillator (1 Hz, damping ratio 0.05) from rest."""
    omega, zeta = 2 * np.pi, 0.05
    damped = omega * np.sqrt(1 - zeta**2)

    def step_response(t: np.ndarray) -> np.ndarray:
        t = np.maximum(t, 0.0)
        swing = np.cos(damped * t) + zeta * omega / damped * np.sin(damped * t)
        return (1 - np.exp(-zeta * omega * t) * swing) / omega**2

    since = times - load.start
    return load.peak * (step_response(since) - step_response(since - load.duration))


@pytest.mark.parametrize("scheme", [generalized_alpha(0.5), generalized_alpha(1.0)])
@pytest.mark.parametrize(
    ("start", "duration"),
    [
        (0.0, 0.5),  # sets in at once
        (0.25, 0.5),  # at step ends, which are these numbers exactly
        (0.3, 0.6),  # at step ends up to round-off of 'number times step'
        (0.1, 0.2),
        (0.3123, 0.537),  # inside steps
        (0.30001, 0.6),  # inside a step, close to its end
        (0.3123, 1e-4),  # both inside one step
    ],
)
def test_loads_that_jump_keep_second_order(start: float, duration: float, scheme: Scheme) -> None:
    load = Rectangle(1.0, duration, start)
    counts = (200, 400, 800, 1600)
    errors = []
    for count in counts:
        run = integrate(oscillator(load), step=2.0 / count, n_steps=count, scheme=scheme)
        exact = oscillator_under_rectangle(run.times, load)
        errors.append(np.abs(run.point("mass") - exact).max())
        assert run.energy_residual < 1e-10
    assert order_of(errors, [2.0 / count for count in counts]) > 1.8


@pytest.mark.parametrize("beta", [10.0, np.inf])
@pytest.mark.parametrize("corner", [1e-4, 1.234e-4, 3e-4])
def test_a_jump_in_a_joint_keeps_the_energy_balance_and_the_law(beta: float, corner: float) -> None:
    joint = replace(REFERENCE, beta=beta, load=Rectangle(63e3, 2e-4, corner))
    run = integrate(joint.system, step=1e-5, n_steps=100, save=Save(fields=True))
    assert run.energy_residual < 1e-10
    assert np.all(run.friction_work >= 0.0)
    assert run.times.size == 101
    # Nothing moves before the load sets in.
    assert np.all(run.u[run.field_times <= corner * (1 - 1e-9)] == 0.0)
    assert np.any(run.u[run.field_times > corner + 1e-5] != 0.0)


def test_kinks_inside_steps_keep_second_order_and_the_stored_times() -> None:
    joint = replace(REFERENCE, load=Triangle(63e3, 1.234e-4))

    def tip(parts: int) -> np.ndarray:
        save = Save(every=parts)
        run = integrate(joint.system, step=1e-5 / parts, n_steps=60 * parts, save=save)
        np.testing.assert_allclose(run.times, 1e-5 * np.arange(61), rtol=1e-12)
        return run.point("free_end")

    exact = tip(32)
    errors = [float(np.abs(tip(parts) - exact).max()) for parts in (1, 2, 4)]
    assert order_of(errors, [1.0, 0.5, 0.25]) > 1.7


# Driver


def test_rows_are_stored_at_the_asked_strides() -> None:
    system = REFERENCE.system
    every = integrate(system, step=1e-5, n_steps=100, save=Save(fields=True))
    save = Save(every=5, fields=True, fields_every=20)
    some = integrate(system, step=1e-5, n_steps=100, save=save)
    np.testing.assert_allclose(some.times, every.times[::5], rtol=1e-14)
    np.testing.assert_array_equal(some.point_u, every.point_u[::5])
    np.testing.assert_array_equal(some.point_v, every.point_v[::5])
    np.testing.assert_array_equal(some.u, every.u[::20])
    np.testing.assert_array_equal(some.sigma, every.sigma[::20])
    np.testing.assert_array_equal(some.peak, every.peak)
    np.testing.assert_array_equal(every.u @ system.P.T.toarray(), every.point_u)
    np.testing.assert_array_equal(every.slip_peak, np.abs(every.u).max(axis=0))
    np.testing.assert_array_equal(every.final[0], every.u[-1])


def test_run_goes_on_from_where_another_ended() -> None:
    system = replace_beta(1e3)
    whole = integrate(system, step=1e-6, n_steps=2000)
    first = integrate(system, step=1e-6, n_steps=1000)
    shifted = replace(REFERENCE, beta=1e3, load=Harmonic(63e3, 1000.0, np.pi * 2)).system
    second = integrate(shifted, step=1e-6, n_steps=1000, initial=first.final)
    # The auxiliary acceleration starts anew, so the two agree to the order of the scheme.
    np.testing.assert_allclose(
        second.point("free_end"), whole.point("free_end")[1000:], atol=1e-5 * whole.peak[0]
    )


def test_progress_is_told_up_to_the_end() -> None:
    calls: list[tuple[int, int]] = []
    integrate(
        LapJoint(elements=5).system, step=1e-5, n_steps=70, cycle_steps=20,
        progress=lambda done, total: calls.append((done, total)),
    )  # fmt: skip
    assert calls == [(20, 70), (40, 70), (60, 70), (70, 70)]


def test_an_interrupted_run_holds_what_was_done() -> None:
    def stop(done: int, total: int) -> None:
        if done == 40:
            raise KeyboardInterrupt

    system = LapJoint(elements=5).system
    run = integrate(system, step=1e-5, n_steps=100, cycle_steps=20, progress=stop)
    assert run.interrupted
    whole = integrate(system, step=1e-5, n_steps=40, cycle_steps=20)
    assert not whole.interrupted
    assert run.counters.steps == 40
    np.testing.assert_array_equal(run.point_u, whole.point_u)
    np.testing.assert_array_equal(run.cycles.friction, whole.cycles.friction)
    assert run.energy_residual < 1e-10


@pytest.mark.parametrize("friction", [0.0, 0.7])
def test_memory_of_a_run_that_stores_nothing_does_not_grow_with_its_steps(
    friction: float,
) -> None:
    system = LapJoint(elements=20, friction=friction).system
    nothing = Save(points=False)
    # The driver hands out at most 20,000 steps at a time; from there on nothing may grow.
    factor = 1 if friction else 500
    counts = (20_000 // factor, 100_000 // factor)
    used = []
    for count in (counts[0], *counts):
        tracemalloc.start()
        run = integrate(system, step=1e-5, n_steps=count, save=nothing)
        used.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        assert run.times.size == run.point_u.size == run.u.size == run.amplitudes.size == 0
        assert run.peak[0] > 0.0
    assert used[2] < used[1] + 100_000


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"step": 0.0}, "step: found 0.0"),
        ({"step": np.nan}, "step: found nan"),
        ({"step": np.inf}, "step: found inf"),
        ({"n_steps": 0}, "n_steps: found 0"),
        ({"cycle_steps": 0}, "cycle_steps: found 0"),
        ({"initial": (np.zeros(3), np.zeros(5))}, "initial"),
    ],
)
def test_arguments_out_of_range_are_refused(arguments: dict[str, object], message: str) -> None:
    system = LapJoint(elements=5).system
    with pytest.raises(InputError, match=message):
        integrate(system, **{"step": 1e-5, "n_steps": 10, **arguments})  # type: ignore[arg-type]


@pytest.mark.parametrize("options", [{"every": 0}, {"fields_every": -1}])
def test_strides_out_of_range_are_refused(options: dict[str, int]) -> None:
    with pytest.raises(InputError, match="must be >= 1"):
        Save(**options)  # type: ignore[arg-type]
