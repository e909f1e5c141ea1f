"""Two bars pressed on each other: closed forms, limits, symmetries and balances."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from bars import DENSITY, EA, MU, THICKNESS, WIDTH, E, bar_structure
from scipy import sparse

from skfem_joint.errors import InputError
from skfem_joint.integrate import integrate
from skfem_joint.loads import Harmonic
from skfem_joint.meshing import BarMesh, build_bar
from skfem_joint.plate import PlateJoint, assemble_plate, build_plate_structure
from skfem_joint.plate_mesh import build_plate, merged
from skfem_joint.recording import Run, Save
from skfem_joint.structure import Joint, assemble
from skfem_joint.system import System
from skfem_joint.two_bars import TwoBars, assemble_two_bars

PRESSURE = 50e6
TAU = MU * PRESSURE * WIDTH
FORCE = 87.5e3


def placed(bar: BarMesh, x: float, turned: bool = False) -> BarMesh:
    """The same bar with its first end at x, running along -x if turned."""
    sense = -1.0 if turned else 1.0
    return replace(bar, coordinates=sense * bar.coordinates + np.array([x, 0.0, 0.0]))


def bars(
    above: int = 20,
    below: int | None = None,
    *,
    beta: float = np.inf,
    fixed: Sequence[str] = (),
    turned: bool = False,
    arm: int = 20,
    stiffer: float = 1.0,
) -> TwoBars:
    """Fig. 18(a), its middle at 0: two bars of 0.7 m over each other on 0.2 m."""
    parts = [("upper_arm", 0.5, arm), ("upper_joint", 0.2, above)]
    upper = placed(build_bar(parts, {"upper_end": 0.0, "upper_in": 0.5}), -0.6)
    parts = [("lower_joint", 0.2, below or above), ("lower_arm", 0.5, arm)]
    points = {"lower_in": 0.2, "lower_end": 0.7}
    if turned:
        parts, points = parts[::-1], {"lower_in": 0.5, "lower_end": 0.0}
    lower = placed(build_bar(parts, points), 0.6 if turned else -0.1, turned)
    joint = Joint("upper_joint", PRESSURE, MU, beta)
    return TwoBars(
        bar_structure(upper, [joint], fixed=[]),
        bar_structure(lower, fixed=fixed, E=stiffer * E, density=stiffer * DENSITY),
        {"upper_joint": "lower_joint"},
    )


def pulled(two: TwoBars, force: float = FORCE, frequency: float = 500.0) -> System:
    """Pulled at both ends."""
    sense = 1.0 if two.lower.bar.points["lower_end"] else -1.0
    loads = [
        ("upper_end", Harmonic(-force, frequency)),
        ("lower_end", Harmonic(sense * force, frequency)),
    ]
    return assemble_two_bars(two, loads)


def run(system: System, frequency: float = 500.0, steps: int = 100, cycles: int = 2) -> Run:
    return integrate(
        system, step=1.0 / frequency / steps, n_steps=cycles * steps, cycle_steps=steps,
        save=Save(fields=True),
    )  # fmt: skip


def test_a_slow_load_gives_the_closed_form_of_two_slipping_ends() -> None:
    # Slip runs F / (2 tau) in from both ends, between them each bar carries F / 2.
    found = run(pulled(bars(160, arm=5), frequency=5.0), frequency=5.0, steps=200)
    at_end = FORCE * 0.1 / (2 * EA) + FORCE**2 / (8 * EA * TAU)
    assert found.cycles.peak[-1][1] == pytest.approx(at_end, rel=1e-3)
    assert found.cycles.peak[-1][0] == pytest.approx(at_end + FORCE * 0.5 / EA, rel=1e-3)
    assert found.cycles.friction[-1] == pytest.approx(FORCE**3 / (3 * EA * TAU), rel=1e-2)
    x = bars(160, arm=5).upper.position[-161:]
    active = x[found.slip_peak < 1e-3 * found.slip_peak.max()]
    assert active.min() - 0.5 == pytest.approx(FORCE / (2 * TAU), abs=2e-3)
    assert 0.7 - active.max() == pytest.approx(FORCE / (2 * TAU), abs=2e-3)


def in_series(beta: float, elements: int, arm: int) -> System:
    """Half of the symmetric joint: a bar with friction and one without, one after the other.

    Of half the slip z and the mean m of both bars, z is a bar of double width pressed on a rigid
    base, free at the middle, and m one held there; the arm's end moves by z + m.
    """

    def part(name: str, **changes: Any) -> Any:
        bar = build_bar([(name, 0.1, elements)], {"in": 0.0, "middle": 0.1})
        return bar_structure(bar, width=2 * WIDTH, **{"fixed": [], **changes})

    slips = assemble(part("z", joints=[Joint("z", PRESSURE, MU, 2.0 * beta)]))
    mean = assemble(part("m", fixed=["middle"]))
    whole = build_bar([("arm", 0.5, arm)], {"end": 0.0})
    arm_system = assemble(bar_structure(whole, fixed=[]), [("end", Harmonic(-FORCE, 500.0))])
    n, nz, nm = arm_system.n - 1, slips.n, mean.n
    size = n + nz + nm
    join = sparse.csr_array((np.ones(2), ([0, 0], [n, n + nz])), shape=(1, size))
    rest = sparse.eye_array(nz + nm, size, k=n)
    G = sparse.vstack([sparse.eye_array(n, size), join, rest])

    def total(name: str) -> sparse.csr_array:
        parts = [getattr(s, name) for s in (arm_system, slips, mean)]
        return sparse.csr_array(G.T @ sparse.block_diag(parts) @ G)

    load = arm_system.loads[0]
    end = np.eye(size)[:1]
    return System(
        M=total("M"), C=total("C"), K=total("K"),
        B=sparse.eye_array(nz, size, k=n, format="csr"), w=slips.w, beta=slips.beta,
        loads=(replace(load, vector=end[0]),), P=sparse.csr_array(end), points=("upper_end",),
    )  # fmt: skip


@pytest.mark.parametrize("beta", [1e5, np.inf])
def test_a_symmetric_joint_is_a_bar_with_friction_and_one_without_in_series(beta: float) -> None:
    whole, half = run(pulled(bars(20, beta=beta))), run(in_series(beta, 10, 20))
    np.testing.assert_allclose(
        half.point("upper_end"), whole.point("upper_end"), atol=1e-9 * half.peak[0]
    )
    assert 2.0 * half.friction_work.sum() == pytest.approx(whole.friction_work.sum(), rel=1e-7)


@pytest.mark.parametrize("turned", [False, True])
def test_antisymmetric_motion_stays_antisymmetric(turned: bool) -> None:
    two = bars(20, turned=turned)
    upper, lower = two.expand(run(pulled(two), cycles=3).u)
    opposite = lower if turned else -lower[:, ::-1]
    np.testing.assert_allclose(upper, opposite, atol=1e-9 * np.abs(upper).max())


def test_the_sense_in_which_a_bar_runs_changes_nothing() -> None:
    there, back = bars(20, 16), bars(20, 16, turned=True)
    upper, lower = there.expand(run(pulled(there)).u)
    other_upper, other_lower = back.expand(run(pulled(back)).u)
    np.testing.assert_allclose(other_upper, upper, atol=1e-9 * np.abs(upper).max())
    np.testing.assert_allclose(other_lower, -lower[:, ::-1], atol=1e-9 * np.abs(upper).max())


@pytest.mark.parametrize("below", [20, 13, 33])
def test_action_equals_reaction(below: int) -> None:
    """Friction does no work in a rigid motion, and what one bar gets the other bar gives."""
    two = bars(20, below)
    system = pulled(two)
    np.testing.assert_allclose(two.other.sum(axis=1), 1.0, rtol=1e-14)
    found = run(system)
    friction = system.w * found.sigma[-1]
    on_upper, on_lower = -friction, two.other.T @ friction
    assert np.abs(on_upper).sum() > 1e3
    assert on_upper.sum() + on_lower.sum() == pytest.approx(0.0, abs=1e-12 * 350e3)
    rates = np.random.default_rng(1).normal(size=system.n)
    upper, lower = two.expand(rates)
    work = upper[two.nodes] @ on_upper + lower @ on_lower
    assert work == pytest.approx(-friction @ (system.B @ rates), rel=1e-12)
    # Momentum of two free bars under opposite forces stays nothing.
    rigid = np.concatenate([np.zeros(two.upper.free.size), np.ones(two.lower.free.size)])
    rigid[: two.upper.bar.region_nodes("upper_arm").size - 1] = 1.0
    for displacement in two.expand(rigid):
        np.testing.assert_allclose(displacement, 1.0, rtol=1e-14)
    momentum = rigid @ (system.M @ found.v.T)
    total = DENSITY * WIDTH * THICKNESS * 1.4 * np.abs(found.v).max()
    np.testing.assert_allclose(momentum, 0.0, atol=1e-9 * total)


def test_loads_work_on_the_displacements_that_are_observed() -> None:
    """Wherever they act: beside the joint, at a node that slips, along the region that does."""
    two = bars(20, 13)
    one = Harmonic(1.0, 1.0)
    ends = ["upper_in", "lower_end", "upper_end"]
    system = assemble_two_bars(two, [(name, one) for name in (*ends, "upper_joint")], ends)
    rates = np.random.default_rng(1).normal(size=system.n)
    upper, lower = two.expand(rates)
    at = [upper[two.upper.bar.points["upper_in"]], lower[-1], upper[0]]
    np.testing.assert_allclose(system.P @ rates, at, rtol=1e-12)
    on_joint = upper[-21:]
    mean = (on_joint.sum() - 0.5 * (on_joint[0] + on_joint[-1])) / 20
    np.testing.assert_allclose(rates @ system.load_vectors(), [*at, mean], rtol=1e-12)
    assert [load.on for load in system.loads] == [*ends, "upper_joint"]


@pytest.mark.parametrize("beta", [1e5, np.inf])
@pytest.mark.parametrize("below", [20, 13])
def test_the_energy_audit_closes(beta: float, below: int) -> None:
    found = run(pulled(bars(20, below, beta=beta)))
    assert found.energy_residual < 1e-11
    assert np.all(found.friction_work >= 0.0)
    assert found.friction_work.sum() > 1.0


@pytest.mark.parametrize("beta", [1e5, np.inf])
@pytest.mark.parametrize("below", [20, 13])
def test_on_a_bar_a_million_times_stiffer_it_is_on_a_rigid_base(beta: float, below: int) -> None:
    """As heavy as it is stiff, so that the lower bar does not ring either."""
    two = bars(20, below, beta=beta, fixed=["lower_in"], stiffer=1e6)
    load = [("upper_end", Harmonic(-FORCE, 500.0))]
    on_bar = run(assemble_two_bars(two, load, ["upper_end", "upper_in"]))
    on_base = run(assemble(two.upper, load, ["upper_end", "upper_in"]))
    np.testing.assert_allclose(on_bar.point_u, on_base.point_u, atol=1e-4 * on_base.peak[0])
    assert on_bar.friction_work.sum() == pytest.approx(on_base.friction_work.sum(), rel=1e-4)


def test_plates_of_one_element_across_without_contraction_are_the_bars() -> None:
    two = bars(20, 16, fixed=["lower_end"])
    along = [("upper_arm", 0.5, 20), ("upper_joint", 0.2, 20)]
    upper = build_plate(along, WIDTH, 1, origin=(-0.6, 0.0), prefix="upper_")
    along = [("lower_joint", 0.2, 16), ("lower_arm", 0.5, 20)]
    lower = build_plate(along, WIDTH, 1, origin=(-0.1, 0.0), prefix="lower_")
    joint = PlateJoint("upper_joint", "region", "lower_joint", PRESSURE, MU, np.inf)
    structure = build_plate_structure(
        merged([upper, lower]), E=E, poisson=0.0, density=DENSITY, thickness=THICKNESS,
        supports=[("lower_right", "xy")], joints=[joint], stiffness_damping=1e-5,
    )  # fmt: skip
    load = Harmonic(FORCE, 500.0)
    plates = run(assemble_plate(structure, [("upper_left", (-1.0, 0.0), load)], []))
    both = run(assemble_two_bars(two, [("upper_end", Harmonic(-FORCE, 500.0))]))
    np.testing.assert_allclose(
        -plates.point("upper_left"), both.point("upper_end"), atol=1e-9 * both.peak.max()
    )
    assert plates.friction_work.sum() == pytest.approx(both.friction_work.sum(), rel=1e-7)


def test_meshes_that_do_not_match_converge_to_those_that_do() -> None:
    """At first order in the friction energy: between nodes of the other bar a node must slip."""
    exact = run(pulled(bars(160, 160, arm=40)))
    errors = []
    for n in (20, 40, 80):
        found = run(pulled(bars(n, (4 * n) // 5, arm=40)))
        errors.append(
            (
                abs(found.peak[0] / exact.peak[0] - 1.0),
                abs(found.friction_work.sum() / exact.friction_work.sum() - 1.0),
            )
        )
    displacement, energy = np.array(errors).T
    assert displacement[-1] < 2e-4
    assert energy[-1] < 0.03
    assert energy[-1] < 0.25 * energy[0]


def test_a_joint_on_a_rigid_base_may_stand_beside_one_between_the_bars() -> None:
    points = {"upper_end": 0.0}
    parts = [("base", 0.1, 5), ("gap", 0.1, 5), ("pressed", 0.1, 5)]
    upper = build_bar(parts, points)
    joints = [Joint("pressed", PRESSURE, MU, np.inf), Joint("base", 1e6, MU, 1e4)]
    lower = placed(build_bar([("under", 0.1, 4)], {"lower_end": 0.1}), 0.2)
    two = TwoBars(
        bar_structure(upper, joints, fixed=[]),
        bar_structure(lower, [Joint("under", 2e6, MU, np.inf)], fixed=["lower_end"]),
        {"pressed": "under"},
    )
    system = assemble_two_bars(two, [("upper_end", Harmonic(50e3, 500.0))])
    # Friction limits of all three add up; a supported node keeps none of the lower bar's.
    assert system.w[system.beta == 1e4].sum() == pytest.approx(MU * 1e6 * WIDTH * 0.1)
    assert system.w.sum() == pytest.approx(
        MU * WIDTH * (PRESSURE * 0.1 + 1e6 * 0.1 + 2e6 * (0.1 - 0.0125))
    )
    assert run(system).energy_residual < 1e-11


def test_bad_input_says_what_is_wrong() -> None:
    two = bars()

    def refuses(match: str, changed: TwoBars, **names: Any) -> None:
        values = {"loads": [("upper_end", Harmonic(1.0, 1.0))]} | names
        with pytest.raises(InputError, match=match):
            assemble_two_bars(changed, **values)

    def moved(x: float) -> TwoBars:
        return replace(two, lower=replace(two.lower, bar=placed(two.lower.bar, x)))

    refuses("do not overlap with 'lower_joint'; the farthest is 0.1 m", moved(0.1))
    refuses("do not overlap", replace(two, against={"upper_joint": "lower_arm"}))
    refuses("found no joint", replace(two, against={}))
    refuses("is no joint of the upper bar", replace(two, against={"upper_arm": "lower_joint"}))
    refuses("no region named 'nowhere'", replace(two, against={"upper_joint": "nowhere"}))
    refuses("no point or region named 'nowhere'", two, loads=[("nowhere", Harmonic(1.0, 1.0))])
    refuses("no point or region named 'nowhere'", two, points=["nowhere"])
    refuses("stands in both bars", replace(two, lower=two.upper))
    held = replace(two.upper, fixed=("upper_in",))
    refuses("must be free to follow it", replace(two, upper=held))
    across = two.lower.bar.coordinates @ np.array([[0, 1, 0], [1, 0, 0], [0, 0, 1.0]])
    bar = replace(two.lower.bar, coordinates=across)
    refuses("angle of 90 degrees", replace(two, lower=replace(two.lower, bar=bar)))
    parts = [("upper_arm", 0.5, 20), ("base", 0.1, 10), ("upper_joint", 0.1, 10)]
    joints = [Joint("base", 1e6, MU), Joint("upper_joint", 1e6, MU)]
    bar = placed(build_bar(parts, {"upper_end": 0.0}), -0.6)
    refuses("on a rigid base; leave", replace(two, upper=bar_structure(bar, joints, fixed=[])))
