"""Condensed models: exact in the joint and at rest, converging in time; SI units."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from bodies import MU, structure
from scipy import sparse

import skfem_joint as sj
from skfem_joint.slow.quasi_static import QuasiStatic

FORCE = 4e3
TIMES: dict[str, Any] = {"step": 5e-6, "n_steps": 200, "cycle_steps": 200}
#: All fixed-interface modes that there are.
ALL = 10**6


def made_of(kind: str, beta: float) -> sj.Structure:
    """Two plates that overlap, a part of the contact without pressure; or a block on its base."""
    if kind != "plates":
        mesh = sj.build_box([("block", 0.1, 4)], (0.03, 0.02), (2, 2))
        joints = [sj.Joint("front", 4e6, MU, beta=beta)]
        return structure(mesh, joints, stiffness_damping=1e-6)
    lower = sj.build_plate([("far", 0.1, 4), ("loose", 0.05, 2), ("joint", 0.05, 3)], 0.05, 2)
    upper = sj.build_plate(
        [("upper", 0.1, 5), ("rest", 0.1, 4)], 0.05, 2, origin=(0.1, 0.0), prefix="upper_"
    )
    parts = {"loose": 0.0, "joint": 4e6}
    joints = [sj.Joint(on, p, MU, against="upper", beta=beta) for on, p in parts.items()]
    return structure(sj.merged([lower, upper]), joints, stiffness_damping=1e-6)


def system_of(kind: str, beta: float = np.inf, amplitude: float = FORCE) -> sj.System:
    made, on = made_of(kind, beta), "upper_right" if kind == "plates" else "right"
    direction = (1.0, 0.3, 0.0)[: made.dim]
    system = made.system([sj.Load(on, sj.Harmonic(amplitude, 1000.0), direction)])
    if kind != "matrices":
        return system
    # Slips as differences of unknowns, as matrices of one's own have them.
    slips = sparse.csr_array(system.contact.B).indices
    beside = np.setdiff1d(np.arange(system.n), slips)[: slips.size]
    differ = sparse.csr_array((-np.ones(slips.size), (slips, beside)), shape=2 * (system.n,))
    T = sparse.csr_array(sparse.eye_array(system.n) + differ)
    return replace(system._with(T, system.contact.B @ T), T=None)


@pytest.mark.parametrize("kind", ["plates", "solid", "matrices"])
def test_a_projection_is_widened_by_what_is_new_alone(kind):
    system = system_of(kind)
    V, W = np.split(np.random.default_rng(3).normal(size=(system.n, 12)), [8], axis=1)
    wide, whole = system.widened(system.project(V), V, W), system.project(np.hstack([V, W]))
    matrices = [(getattr(wide, name), getattr(whole, name)) for name in "MCKPT"]
    for one, other in [*matrices, (wide.contact.B, whole.contact.B)]:
        np.testing.assert_allclose(one, other, atol=1e-12 * np.abs(other).max())
    np.testing.assert_allclose(wide.load_vectors(), whole.load_vectors(), rtol=1e-12)


@pytest.mark.parametrize("beta", [1e4, np.inf], ids=["arctan", "coulomb"])
@pytest.mark.parametrize("kind", ["plates", "solid", "matrices"])
def test_with_all_fixed_interface_modes_it_is_the_full_model(kind, beta):
    system = system_of(kind, beta)
    small = sj.condense(system, ALL)
    how = TIMES | {"save": sj.Save(fields=True), "tolerance": 1e-12}
    full, run = (sj.integrate(one, **how) for one in (system, small))
    assert small.n == system.n
    assert sj.compare(full, run).displacement_max < 1e-9
    u, v = system.expand(full.u), system.expand(full.v)
    assert np.abs(small.expand(run.u) - u).max() < 1e-9 * np.abs(u).max()
    assert np.abs(small.expand(run.v) - v).max() < 1e-8 * np.abs(v).max()
    assert full.friction_work.sum() > 0.0
    acts = system.contact.w > 0.0
    assert small.contact.count == np.count_nonzero(acts)
    works = full.friction_work[acts]
    assert run.friction_work == pytest.approx(works, abs=1e-9 * works.sum())
    slip = small.contact.slip_norm((small.contact.B @ run.v.T).T)[1:]
    assert np.any(slip == 0.0) == np.isinf(beta)  # points that stick have no velocity at all
    assert run.energy_residual < 1e-9


@pytest.mark.parametrize("kind", ["solid", "matrices"])
def test_static_slip_is_exact_without_a_single_mode(kind):
    system = system_of(kind)
    small = sj.condense(system, 0)
    # the response to the load beside the slips
    assert small.n == int(small.contact.directions.sum()) + 1
    levels = FORCE * np.array([0.5, 1.0, 0.2, -1.0])[:, np.newaxis]
    full, found = (
        QuasiStatic(s, 1e-12).follow(levels * s.loads[0].vector) for s in (system, small)
    )
    slips = np.abs(full @ system.contact.B.T)
    assert slips.max() > 0.0
    whole = system.expand(full)
    assert np.abs(small.expand(found) - whole).max() < 1e-9 * np.abs(whole).max()


def test_error_falls_with_each_fixed_interface_mode_and_auto_has_a_thousandth():
    system = system_of("plates", 1e5)
    full = sj.integrate(system, **TIMES)
    errors = []
    for modes in (0, 2, 8, 32):
        run = sj.integrate(sj.condense(system, modes), **TIMES)
        errors.append(sj.compare(full, run).displacement_max)
    assert np.all(np.diff(errors) < 0.0)
    assert errors[-1] < 1e-4 * errors[0]
    run = sj.integrate(sj.condense(system), **TIMES)
    assert sj.compare(full, run).displacement_max < 1e-3
    assert run.friction_energy["joint"] == pytest.approx(full.friction_energy["joint"], rel=1e-3)


def test_estimate_tells_what_missing_modes_cost():
    system = system_of("plates", 1e5)
    full, run = (sj.integrate(one, **TIMES) for one in (system, sj.condense(system, 0)))
    found, true = sj.estimate(run), sj.compare(full, run)
    stated = found.of("basis", "displacement_rms")
    assert 0.5 * true.displacement_rms < stated < 2.0 * true.displacement_rms
    for source in ("law", "points"):  # those of the full model
        assert found.of(source, "displacement_rms") == 0.0


def test_what_cannot_be_condensed_is_refused():
    system = system_of("plates")
    with pytest.raises(sj.InputError, match="'condensed' needs friction"):
        sj.condense(system.with_contact(given=np.zeros_like(system.contact.w)))
    unknown = replace(system.loads[0], amplitude=np.sin)
    with pytest.raises(sj.InputError, match="interface_modes"):
        sj.condense(replace(system, loads=(unknown,)))
