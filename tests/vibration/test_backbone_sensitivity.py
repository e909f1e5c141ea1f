"""Derivatives of damping curves: central differences, closed forms, scaling laws; SI units."""

from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from typing import Any, NamedTuple

import numpy as np
import pytest
from bodies import DENSITY, EA, LAP, MU, THICKNESS, WIDTH, lap, pressed, structure
from clamped_plates import STIFF, bar, bolted, lapped
from scipy import sparse
from stepping_systems import arm

import skfem_joint as sj
from skfem_joint.reduction.stuck import Stuck, StuckMode
from skfem_joint.structure.parameters import value_of, with_values
from skfem_joint.vibration import backbone as curves
from skfem_joint.vibration.mode_rates import mode_rates

CURVES = "amplitude", "frequency", "friction_damping", "viscous_damping", "displacement"
#: Relative step of central differences, and tolerance of levels, whose noise is over the step.
STEP, EXACT = 1e-4, 1e-10
#: Noise of such differences, over the value: that of the levels at both ends over the step.
NOISE = 2.0 * EXACT / STEP


@pytest.fixture(autouse=True, scope="module")
def _exact_levels() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(curves, "TOLERANCE", EXACT)
        yield


class Case(NamedTuple):
    """A structure, its loads, and the keys by which its curves are differentiated."""

    given: Callable[[], sj.Structure]
    loads: list[sj.Load]
    keys: tuple[str, ...]
    levels: int = 8
    modes: tuple[int, ...] = (1,)


def along(on: str, *direction: float) -> list[sj.Load]:
    return [sj.Load(on, sj.Harmonic(1.0, 300.0), direction)]


def plates(solid: bool, contact: str, **joint: float) -> Callable[[], sj.Structure]:
    return lambda: bolted(solid, joint={"contact": contact, **joint}, damping_ratio=0.01)


def in_plan(**joint: float) -> Callable[[], sj.Structure]:
    """Two plates in plan, whose first mode bends, so that slips turn."""
    joints = [replace(LAP, **joint)]
    return lambda: structure(lap(), joints, ["lower_left"], stiffness_damping=1e-6)


def pressed_evenly() -> sj.Structure:
    """Plates that a pressure holds together, so that nothing slips at low levels."""
    joint = {"contact": "unilateral", "pressure": 20e6, **ELASTIC}
    return bolted(joint=joint, bolts=[], damping_ratio=0.01)


FRICTION, SPRING, PUSH = "joint[0].friction", "joint[0].tangential_stiffness", "bolt[0].force"
PRESSURE, E, RATIO = "joint[0].pressure", "material.E", "damping.ratio"
OF_BAR = FRICTION, PRESSURE, E, "damping.stiffness", "damping.mass", "material.regions.upper_arm.E"
ELASTIC = STIFF | {"normal_stiffness": 5e12}
BOLTED = FRICTION, PUSH, E, RATIO
ALONG, ACROSS = along("upper_end", 1.0), along("right", 0.0, 1.0)
SOLID = along("right", 0.0, 1.0, 0.0)
CASES = {
    "bar": Case(bar, ALONG, OF_BAR),
    "bar on springs": Case(lambda: bar(STIFF), ALONG, (*OF_BAR, SPRING)),
    "second mode": Case(lambda: bar(STIFF), ALONG, (FRICTION, E, SPRING), modes=(2,)),
    "in plan": Case(in_plan(), along("upper_right", 0.0, 1.0), (FRICTION, PRESSURE, E)),
    "in plan on springs": Case(
        in_plan(tangential_stiffness=3e12), along("upper_right", 0.0, 1.0), (FRICTION, E, SPRING)
    ),
    "plates": Case(plates(False, "constant"), ACROSS, BOLTED),
    "open": Case(plates(False, "unilateral"), ACROSS, BOLTED, 4),
    "open on springs": Case(
        plates(False, "unilateral", **ELASTIC),
        ACROSS, (*BOLTED, SPRING, "joint[0].normal_stiffness"), 4,
    ),
    "open, sticking at first": Case(pressed_evenly, ACROSS, (E, FRICTION), 6),
    "open solid on springs": Case(
        plates(True, "unilateral", **ELASTIC), SOLID, (SPRING, "joint[0].normal_stiffness"), 3
    ),
}  # fmt: skip


def with_rates(
    system: sj.System, parameters: list[sj.SystemSensitivity], *how: Any, **more: Any
) -> tuple[sj.Backbone, sj.BackboneSensitivity]:
    """A curve and its derivatives."""
    (found,) = sj.backbone(system, *how, keep_path=True, **more)
    return found, sj.backbone_sensitivity(found, parameters)


@cache
def differentiated(name: str) -> tuple[sj.Structure, sj.Backbone, sj.BackboneSensitivity]:
    """Structure of a case, its curve, and the derivatives."""
    case = CASES[name]
    given = case.given()
    system = given.system(case.loads)
    parameters = sj.sensitivities(given, case.keys, system)
    return given, *with_rates(system, parameters, case.modes, case.levels, 0.6)


def sets(curve: sj.Backbone) -> np.ndarray:
    """What slips at each level, is at its limit, and how much opens."""
    parts = [curve.slip > 1e-9 * curve.slip.max()]
    if curve.friction is not None:
        parts.append(np.abs(curve.friction) > 1.0 - 1e-6)
    if curve.opened is not None:
        parts.append(curve.opened[:, np.newaxis])
    return np.hstack(parts)


def beside(name: str, key: str | None, moves: Any = 0.0) -> list[sj.Backbone]:
    """Curves with a value a little above and below its own, and levels that move by the step."""
    case, (given, found, _) = CASES[name], differentiated(name)
    ends = []
    for step in (STEP, -STEP):
        values = {} if key is None else {key: value_of(given, key) * (1.0 + step)}
        system = with_values(given, values).system(case.loads)
        ends += sj.backbone(system, case.modes, found.level * np.exp(step * moves))
    return ends


BY_LEVEL = ["bar on springs", "in plan", "plates", "open"]


@pytest.mark.parametrize(
    ("name", "key"),
    [(name, key) for name, case in CASES.items() for key in case.keys]
    + [(name, None) for name in BY_LEVEL],
)
def test_derivatives_are_central_differences(name, key):
    """By a value at fixed levels; by the logarithm of the levels in the last column."""
    given, found, rates = differentiated(name)
    value, column = (
        (1.0, -1) if key is None else (value_of(given, key), CASES[name].keys.index(key))
    )
    ends = beside(name, key, moves=float(key is None))
    same = (sets(ends[0]) == sets(ends[1])).all(axis=1)
    assert same.mean() > 0.7
    for kind in CURVES:
        rate = getattr(rates, kind)[same][..., column]
        known = (getattr(ends[0], kind) - getattr(ends[1], kind))[same] / (2.0 * STEP * value)
        noise = NOISE * getattr(found, kind).max() / value
        atol = 5e-6 * np.abs(known).max() + noise
        np.testing.assert_allclose(rate, known, rtol=0.0, atol=atol, err_msg=kind)
    assert rates.parameters[: len(CASES[name].keys)] == CASES[name].keys
    assert not rates.stuck_frequency[-1]


TANGENTIAL, NORMAL = {"tangential_stiffness": 3e11}, {"normal_stiffness": 2e12}
OPENS = {"contact": "unilateral"}
LAPPED = {
    "constant, tangential springs": TANGENTIAL,
    "opens": OPENS,
    "opens, springs both ways": OPENS | TANGENTIAL | NORMAL,
}


@pytest.mark.parametrize("joint", LAPPED)
def test_derivatives_from_a_thousandth_of_slip_on(joint):
    """At each level by itself: where nothing slips, and where very little does, too."""
    given, loads = lapped(**LAPPED[joint]), along("end", 0.0, 1.0, 0.0)
    system = given.system(loads)
    (whole,) = sj.backbone(system, levels=1, up_to=0.1)
    level = np.append(np.geomspace(1e-3, 0.3, 8), np.linspace(0.35, 0.7, 6)) * whole.slips_at
    parameters = sj.sensitivities(given, [FRICTION], system)
    found, rates = with_rates(system, parameters, levels=level)
    ends = []
    for step in (STEP, -STEP):
        changed = with_values(given, {FRICTION: 0.5 * (1.0 + step)}).system(loads)
        ends += sj.backbone(changed, levels=found.level)
    assert (found.friction_damping < 1e-9).sum() > 4
    assert (found.friction_damping > 1e-7).sum() > 3
    noise = {"frequency": 2e-6 * found.frequency, "friction_damping": 1e-9}
    for kind, own in noise.items():
        rate = 0.5 * getattr(rates, kind)[:, 0]
        above, below = (
            (getattr(end, kind) - getattr(found, kind)) / step
            for end, step in zip(ends, (STEP, -STEP), strict=True)
        )
        # At a kink the derivative is that to one side.
        known, apart = 0.5 * (above + below), np.abs(above - below)
        np.testing.assert_array_less(np.abs(rate - known), 1e-5 * np.abs(known) + own + 0.6 * apart)
        smooth = apart < 1e-2 * np.abs(known) + own
        assert smooth.mean() > 0.8, kind


@pytest.mark.parametrize("name", ["bar", "open"])
def test_derivatives_do_not_change_the_curve(name):
    case, (given, found, _) = CASES[name], differentiated(name)
    (plain,) = sj.backbone(given.system(case.loads), case.modes, case.levels, 0.6)
    assert plain.path is None
    for kind in CURVES:
        np.testing.assert_allclose(getattr(plain, kind), getattr(found, kind), rtol=1e-12)


@pytest.mark.parametrize(("name", "key"), [("bar on springs", FRICTION), ("plates", E)])
def test_derivatives_at_a_fixed_amplitude(name, key):
    """Levels that keep the amplitude to first order have differences of that derivative."""
    given, _, rates = differentiated(name)
    column, value = CASES[name].keys.index(key), value_of(given, key)
    point = rates.displacement[:, 0]
    ends = beside(name, key, moves=-value * point[:, column] / point[:, -1])
    np.testing.assert_allclose(ends[0].displacement[:, 0], ends[1].displacement[:, 0], rtol=1e-7)
    for kind in ("frequency", "damping_ratio"):
        known = (getattr(ends[0], kind) - getattr(ends[1], kind)) / (2.0 * STEP * value)
        held = rates.at_amplitude(getattr(rates, kind), point)[:, column]
        np.testing.assert_allclose(held, known, rtol=0.0, atol=5e-6 * np.abs(known).max())


@pytest.mark.parametrize("name", ["bar", "in plan"])
def test_limits_and_levels_times_a_factor_leave_frequency_and_damping(name):
    """With constant normal force, exactly: the derivative by friction is minus that by levels."""
    case, (given, found, rates) = CASES[name], differentiated(name)
    column = case.keys.index(FRICTION)
    for kind in ("frequency", "friction_damping", "viscous_damping"):
        both = getattr(rates, kind)
        by_logarithm = value_of(given, FRICTION) * both[:, column]
        atol = 1e-9 * np.abs(both[:, -1]).max()
        np.testing.assert_allclose(by_logarithm, -both[:, -1], rtol=0.0, atol=atol)
    amplitude = value_of(given, FRICTION) * rates.amplitude[:, column] + rates.amplitude[:, -1]
    np.testing.assert_allclose(amplitude, found.amplitude, rtol=1e-9)


# %% A bar of a free length beyond a joint of constant friction: a quarter wave


JOINT, FREE, TAU = 0.2, 0.5, 1.75e6  # m, m, N/m


def quarter_wave(elements: int) -> sj.System:
    joint = sj.Joint("joint", TAU / MU / WIDTH, MU)
    return arm(None, joint, (elements, 100))


def by_friction(system: sj.System) -> sj.SystemSensitivity:
    """Derivative by the logarithm of friction."""
    return sj.SystemSensitivity("friction", w=system.contact.w)


def test_a_front_exactly_at_a_node_is_said_to_turn():
    """There the derivative is that to one side."""
    system = quarter_wave(40)
    (mode,) = sj.backbone(system, levels=1)
    # The loaded node has half of the limit of the others.
    points = np.array([8.7, 9.7, 10.49, 10.5, 10.51, 11.7, 12.7, 13.7, 14.7, 15.7])
    level = points * system.contact.w.max() / np.abs(system.M @ mode.shape).sum()
    found, rates = with_rates(system, [by_friction(system)], levels=level)
    near = slice(1, 4)  # no half cycles are followed from there
    assert sets(found)[near].sum(axis=1).tolist() == [10, 10, 10]
    assert rates.turning[near].tolist() == [0, 0, 1]
    below, at, above = rates.amplitude[2:5, 0] / found.amplitude[2:5]
    assert min(abs(at - below), abs(at - above)) < 0.1 * abs(above - below)


# %% Modes of the same frequency


def square_beam() -> sj.Structure:
    """Clamped by a face that friction holds: it bends both ways alike."""
    sides = {"held": "left", "end": "right"}
    mesh = sj.build_box([("near", 0.1, 2), ("far", 0.1, 2)], (0.02, 0.02), (2, 2), boundaries=sides)
    return sj.Structure(mesh, sj.Material(200e9, 8000.0, 0.3), joints=[pressed("held")])


def test_modes_of_one_frequency_have_derivatives_unless_they_are_mixed():
    given = square_beam()
    system = given.system()
    parameters = sj.sensitivities(given, [E, FRICTION], system)
    found, rates = with_rates(system, parameters, levels=3)
    ratio = rates.stuck_frequency[0] * value_of(given, E) / found.stuck_frequency
    assert ratio == pytest.approx(0.5, rel=1e-7)
    diagonal = np.zeros(system.n)
    rows = np.flatnonzero(np.abs(found.shape) > 0.5 * np.abs(found.shape).max())
    diagonal[rows[::2]] = 1e6
    mixing = sj.SystemSensitivity("springs", K=sparse.csr_array(sparse.diags_array(diagonal)))
    with pytest.raises(sj.InputError, match=r"modes 1 and 2 have the same frequency"):
        sj.backbone_sensitivity(found, [mixing])


def test_rates_of_modes_of_one_frequency():
    """Two equal oscillators and a third one, beside a point in friction."""
    K = np.diag([1.0, 1.0, 4.0, 1.0])
    one, zero = sparse.eye_array(4, format="csr"), sparse.csr_array((4, 4))
    B = sparse.csr_array([[0.0, 0.0, 0.0, 1.0]])
    system = sj.System(one, zero, sparse.csr_array(K), sj.Contact(B, np.ones(1), np.inf))
    frequencies, shapes = np.array([1.0, 1.0, 2.0]) / (2.0 * np.pi), np.eye(4)[:, :3]

    def rates(entries: dict[tuple[int, int], float]) -> tuple[np.ndarray, np.ndarray]:
        change = np.zeros((4, 4))
        for (i, j), value in entries.items():
            change[i, j] = change[j, i] = value
        parameter = sj.SystemSensitivity("p", K=sparse.csr_array(change))
        return mode_rates(StuckMode(1, frequencies, shapes, Stuck(system)), [parameter])

    of_frequency, of_shape = rates({(0, 0): 1.0, (1, 1): 3.0, (0, 2): 0.6})
    np.testing.assert_allclose(of_frequency, [0.5 / (2.0 * np.pi)])
    np.testing.assert_allclose(of_shape[:, 0], [0.0, 0.0, -0.2, 0.0], atol=1e-14)


# %% What is refused


@pytest.mark.parametrize(
    ("part", "words"),
    [
        ({"w": np.ones(3)}, r"parameter p: w: found shape \(3,\), must be"),
        ({"K": sparse.eye_array(3)}, r"K: found shape \(3, 3\)"),
        ({"stiffness": np.ones(2)}, r"stiffness: found shape \(2,\)"),
        ({"gap": np.ones(2)}, r"gap: found shape \(2,\)"),
        ({"force": np.ones(2)}, r"force: found shape \(2,\)"),
        ({"normal_stiffness": np.ones(2)}, r"normal_stiffness: found shape \(2,\)"),
    ],
)
def test_derivatives_of_another_system_are_refused(part, words):
    system = bolted(joint={"contact": "unilateral"}).system()
    (found,) = sj.backbone(system, levels=2, up_to=0.1, keep_path=True)
    with pytest.raises(sj.InputError, match=words):
        sj.backbone_sensitivity(found, [sj.SystemSensitivity("p", **part)])


def test_a_curve_without_its_path_has_no_derivatives():
    (found,) = sj.backbone(bolted().system(), levels=2)
    with pytest.raises(sj.InputError, match="found no path; give backbone keep_path = True"):
        sj.backbone_sensitivity(found, [])


def test_sliders_that_share_a_slip_add_up():
    """An Iwan joint at the foot of a bar: limits and levels times a factor change nothing."""
    n = 6
    M = sparse.diags_array(np.full(n, 2.0))
    stiffness = sparse.diags_array([np.full(n - 1, -1.0)] * 2, offsets=[-1, 1])
    K = 1e7 * (stiffness + sparse.diags_array([1.0, *[2.0] * (n - 2), 2.0]))
    joint = sj.iwan(np.eye(n)[0], F_S=1e3, K_T=2e7, chi=-0.5, beta=0.1, sliders=30)
    system = sj.System.from_matrices(M, K, 1e-6 * K, contact=joint, points={"end": n - 1})
    limits = sj.SystemSensitivity("limits", w=system.contact.w)
    _, rates = with_rates(system, [limits], levels=6, up_to=0.6)
    for values in (rates.frequency, rates.damping_ratio):
        assert np.abs(values).max() > 0.0
        np.testing.assert_allclose(values[:, 0], -values[:, 1], rtol=1e-6, atol=1e-9)


def test_derivatives_by_friction_converge_to_the_closed_form():
    """omega ~ (1 + eps)^(-1/2), zeta = 2 / (3 pi) eps / (1 + eps), eps ~ level / friction.

    With the front anywhere in an element they are off by the share of an element in what slips.
    """
    momentum = (2.0 / np.pi) * np.sqrt(2.0 * DENSITY * WIDTH * THICKNESS * FREE)
    errors = []
    for elements in (50, 200, 800):
        system = quarter_wave(elements)
        found, rates = with_rates(system, [by_friction(system)], levels=24)
        square = (2.0 * np.pi * found.stuck_frequency) ** 2
        eps = square * momentum**3 * found.level / (2.0 * EA * TAU)
        seen = found.level > 0.2 * found.slips_at
        of_frequency = rates.frequency[:, 0] / found.frequency / (0.5 * eps / (1.0 + eps))
        known = -2.0 / (3.0 * np.pi) * eps / (1.0 + eps) ** 2
        of_damping = rates.friction_damping[:, 0] / known
        errors.append(np.abs([of_frequency - 1.0, of_damping - 1.0])[:, seen].max(axis=1))
    assert (errors[0] < [0.1, 0.3]).all()
    assert (errors[1] < 0.5 * errors[0]).all()
    assert (errors[2] < 0.5 * errors[1]).all()
