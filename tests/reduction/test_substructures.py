"""Condensed models and preloads by parts: those of the whole structure but for round-off."""

import os
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from bodies import structure
from clamped_plates import bolted, lapped
from scipy import sparse
from test_condensed import system_of

import skfem_joint as sj
from skfem_joint.reduction import substructures
from skfem_joint.slow.quasi_static import QuasiStatic

PARTS = sj.Parts(3)


def long_lap(**changes: Any) -> sj.Structure:
    """Two slender boxes that lap over a third of their length, one held at its end."""
    lower, upper = [("arm", 0.12, 12), ("lap", 0.06, 6)], [("lap", 0.06, 5), ("arm", 0.12, 10)]
    one = {"fixed": "left", "face": ("top", "lower lap")}
    two = {"end": "right", "contact": ("bottom", "upper lap")}
    boxes = [
        sj.build_box(
            [(f"{name} {part}", *size) for part, *size in strips],
            (0.01, 0.02),
            (2, 3),
            origin=(x, y, 0.0),
            boundaries=sides,
        )
        for name, strips, x, y, sides in (
            ("lower", lower, 0.0, 0.0, one),
            ("upper", upper, 0.12, 0.01, two),
        )
    ]
    joints = [sj.Joint("contact", 4e6, 0.3, against="face")]
    values = {"fixed": ["fixed"], "stiffness_damping": 1e-6} | changes
    return structure(sj.merged(boxes), joints, **values)


def loaded(**changes: Any) -> sj.System:
    load = sj.Load("end", sj.Harmonic(400.0, 150.0), (0.3, 1.0, 0.2))
    return long_lap(**changes).system([load], points=["end"])


SYSTEMS = {
    "held": loaded,
    "floating": lambda: loaded(fixed=[], free=True),
    "slips are no unknowns": lambda: system_of("matrices"),
    "plates": lambda: system_of("plates"),
}


def same(one: Any, other: Any, share: float = 1e-8) -> None:
    np.testing.assert_allclose(one, other, rtol=0.0, atol=share * np.abs(other).max())


@pytest.mark.parametrize("kind", SYSTEMS)
def test_the_model_is_that_of_the_whole(kind):
    """Modes may differ in sign: what they do is compared, at rest, in vibration and under loads."""
    system = SYSTEMS[kind]()
    whole, small = (sj.condense(system, 9, parts=parts) for parts in (None, PARTS))
    assert small.n == whole.n
    # Round-off in the whole grows where the shift alone holds the static response to the loads.
    share = 1e-5 if kind == "floating" else 1e-8
    k = small.contact.B.shape[0]
    for name in "MCK":
        one, other = (getattr(model, name) for model in (small, whole))
        np.testing.assert_array_equal(one, one.T)
        if kind != "floating":  # whose constraint modes may have any rigid motion
            same(one[:k, :k], other[:k, :k])
    for joints in ("loose", "stuck"):
        one, other = (sj.natural_modes(m, 16, joints=joints).frequencies for m in (small, whole))
        vibrates = other > 1.0  # Hz
        same(one[vibrates], other[vibrates], share)
        assert np.all(one[~vibrates] < 1.0)
    s = 1j * 2.0 * np.pi * 180.0  # response to the loads at a frequency
    responses = [
        m.P @ np.linalg.solve(s**2 * m.M + s * m.C + m.K, m.load_vectors().astype(complex))
        for m in (small, whole)
    ]
    same(*responses, share)
    rows = [m.contact.B @ np.linalg.solve(s**2 * m.M + m.K, m.P.T) for m in (small, whole)]
    same(*rows, share)


def test_displacements_are_recovered_everywhere():
    system = loaded()
    whole, small = (sj.condense(system, 9, parts=parts) for parts in (None, PARTS))
    states = [
        m.expand(np.linalg.solve(m.K - (2.0 * np.pi * 180.0) ** 2 * m.M, m.load_vectors()).T)
        for m in (small, whole)
    ]
    same(*states)
    same(small.expand(np.eye(small.n)[3]), whole.expand(np.eye(whole.n)[3]))
    wide = small.project(np.eye(small.n)[:, :5])
    same(wide.T @ np.eye(5), whole.T[:, :5])
    wider = small.widened(wide, np.eye(small.n)[:, :5], np.eye(small.n)[:, 5:7])
    same(wider.T @ np.eye(7), whole.T[:, :7])


def test_curve_and_slow_cycle_are_those_of_the_whole():
    """Coulomb friction at rest is exact in any condensed model: a curve is that of the full one."""
    system = loaded()
    whole, small = (sj.condense(system, 12, parts=parts) for parts in (None, PARTS))
    (full,), (curve,) = (sj.backbone(m, (1,), 4) for m in (system, small))
    np.testing.assert_allclose(curve.stuck_frequency, full.stuck_frequency, rtol=1e-8)
    np.testing.assert_allclose(curve.frequency, full.frequency, rtol=1e-8)
    np.testing.assert_allclose(curve.friction_damping, full.friction_damping, rtol=1e-6)
    forces = np.array([0.5, 1.0, -0.3])
    paths = [
        m.P @ QuasiStatic(m, 1e-12).follow(forces[:, None] * m.load_vectors()[:, 0] * 300.0).T
        for m in (small, whole)
    ]
    same(*paths)


def test_modes_of_the_parts_are_a_start_that_few_solutions_end(monkeypatch):
    """The method of Craig and Bampton gives the first modes to some per mille at once."""
    system = loaded()
    solutions = []
    of_whole = substructures._iterated

    def counting(solve, M, X, count):
        def one(right):
            solutions.append(right.shape[1])
            return solve(right)

        found = of_whole(one, M, X, count)
        K = X.T @ (system.K @ X)
        start = np.sqrt(np.diag(K)[:4]) / (2.0 * np.pi)
        np.testing.assert_allclose(start, found[0][:4], rtol=3e-3)
        return found

    monkeypatch.setattr(substructures, "_iterated", counting)
    sj.condense(system, 10, parts=PARTS)
    assert 1 < len(solutions) <= 6


@pytest.mark.parametrize("modes", ["auto", 0])
def test_modes_are_as_many_as_the_frequency_needs(modes):
    system = loaded()
    whole, small = (
        sj.condense(system, modes, frequency=2000.0, parts=parts) for parts in (None, PARTS)
    )
    assert small.n == whole.n


def test_contact_that_opens_stays_with_its_points():
    system = bolted(solid=True, joint={"contact": "unilateral"}).system(
        [sj.Load("right", sj.Harmonic(2e3, 100.0), (0.0, 1.0, 0.0))], points=["right"]
    )
    models = [sj.condense(system, 8, parts=parts) for parts in (None, PARTS)]
    runs = [sj.integrate(model, cycles=1, steps_per_cycle=100) for model in models]
    same(runs[1].point_u, runs[0].point_u, 1e-6)
    closed = [model.closed() for model in models]
    assert not isinstance(closed[1].T, np.ndarray)  # all columns of a large one would be too many
    same(*(m.expand(np.linalg.solve(m.K + 1e7 * m.M, m.load_vectors()).T) for m in closed), 1e-6)


@pytest.mark.parametrize("given", ["held", "floating"])
@pytest.mark.parametrize("make", [lapped, lambda **more: bolted(solid=True, **more)])
def test_preload_by_parts_is_that_of_the_whole(make, given):
    """Floating bodies included, whose stiffness alone has no factor."""
    whole = make()
    if given == "floating":
        whole = replace(whole, fixed=[], free=True)
    one, other = (replace(whole, parts=parts).preload for parts in (PARTS, None))
    assert one is not None
    assert other is not None
    assert one.active_sets == other.active_sets
    same(one.joints[0].force, other.joints[0].force)
    np.testing.assert_allclose(one.joints[0].gap, other.joints[0].gap, rtol=1e-6, atol=1e-15)
    same(one.displacement, other.displacement, 1e-6)


def test_what_a_model_by_parts_cannot_do_is_said(tmp_path):
    small = sj.condense(loaded(), 4, parts=PARTS)
    with pytest.raises(sj.InputError, match="by parts"):
        sj.save(small, tmp_path / "small.npz")
    sj.save(replace(small, T=None), tmp_path / "small.npz")
    run = sj.integrate(small, cycles=1, steps_per_cycle=20)
    with pytest.raises(sj.InputError, match="by parts"):
        sj.estimate(run)


def test_parts_are_no_number():
    wrong: Any = 3
    for refused in (lambda: long_lap(parts=wrong), lambda: sj.condense(loaded(), 4, parts=wrong)):
        with pytest.raises(sj.InputError, match=r"parts: found 3, must be an sj.Parts"):
            refused()


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_workers_of_dask_give_the_same_numbers():
    distributed = pytest.importorskip("distributed")
    system = loaded()
    cluster = distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None
    )
    with cluster, distributed.Client(cluster) as client:
        assert len(set(client.run(os.getpid).values())) == 2
        by_dask = sj.Parts(3, client.get_executor())
        there = sj.condense(system, 10, parts=by_dask)
        pressed = replace(lapped(), parts=by_dask).preload
    here = sj.condense(system, 10, parts=PARTS)
    (one,), (other,) = (sj.backbone(m, (1,), 4) for m in (there, here))
    np.testing.assert_allclose(one.frequency, other.frequency, rtol=1e-12)
    np.testing.assert_allclose(one.friction_damping, other.friction_damping, rtol=1e-12)
    for name in "MCK":
        same(getattr(there, name), getattr(here, name), 1e-12)
    same(pressed.joints[0].force, replace(lapped(), parts=PARTS).preload.joints[0].force, 1e-12)
    assert sparse.issparse(there.contact.B)
