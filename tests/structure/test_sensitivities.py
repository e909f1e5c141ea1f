"""Derivatives of systems by keys of their structures, against central differences."""

from __future__ import annotations

import pickle
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np
import pytest
from bodies import structure
from clamped_plates import BOLTS, STIFF, bar, bolted, loads
from opening_blocks import block
from scipy import sparse

import skfem_joint as sj
from skfem_joint.joint.preload import preload_rates
from skfem_joint.structure.parameters import value_of, with_values


def parts(found: Any) -> Iterator[tuple[str, Any]]:
    """Matrices and vectors of a system, or of its derivatives, by name."""
    names = ["K", "C", "w", "stiffness", "gap", "force", "gain", "normal_stiffness"]
    if isinstance(found, sj.SystemSensitivity):
        yield from ((name, getattr(found, name)) for name in names)
        return
    contact, normal = found.contact, found.contact.normal
    values = [found.K, found.C, contact.w, contact.stiffness]
    values += [normal.gap, normal.force, contact.gain, normal.stiffness]
    for number, (name, value) in enumerate(zip(names, values, strict=True)):
        yield name, value if number < 4 or contact.opens else None


def dense(values: Any) -> Any:
    return values.toarray() if sparse.issparse(values) else np.asarray(values)


def agrees(
    given: sj.Structure, on: list[sj.Load], key: str, step: float = 1e-4, share: float = 1e-6
) -> sj.SystemSensitivity:
    """Derivatives by a key, which central differences of the system must give too."""
    system = given.system(on)
    (found,) = sj.sensitivities(given, [key], system)
    value = value_of(given, key)
    size = value or 1.0
    ends = value + step * size, value - step * size if value else 0.0
    ahead, behind = (dict(parts(with_values(given, {key: end}).system(on))) for end in ends)
    assert found.name == key
    for (name, rate), (_, now) in zip(parts(found), parts(system), strict=True):
        if now is None:
            assert rate is None
            continue
        now, after, before = (dense(values) for values in (now, ahead[name], behind[name]))
        finite = np.isfinite(now)
        known = np.where(finite, after, 0.0) - np.where(finite, before, 0.0)
        known /= ends[0] - ends[1]
        noise = 1e-8 * np.abs(now[finite]).max(initial=0.0) / size
        off = np.abs(known if rate is None else dense(rate) - known).max(initial=0.0)
        assert off <= share * np.abs(known).max(initial=0.0) + noise, (name, off)
    return found


def assert_same(system: sj.System, other: sj.System, share: float) -> None:
    """Fail unless all values of both are equal but for a share of the largest."""
    for (name, one), (_, two) in zip(parts(system), parts(other), strict=True):
        assert (one is None) == (two is None)
        if two is not None:
            known = dense(two)
            size = np.abs(known[np.isfinite(known)]).max(initial=0.0)
            np.testing.assert_allclose(dense(one), known, rtol=0.0, atol=share * size, err_msg=name)


@pytest.mark.parametrize("frequency", [300.0, None])
@pytest.mark.parametrize(
    "key",
    ["damping.ratio", "material.E", "material.regions.upper_arm.E",
     "joint[0].tangential_stiffness", "joint[0].friction"],
)  # fmt: skip
def test_damping_by_its_ratio_follows_the_frequencies(key, frequency):
    given = bar(STIFF, damping_ratio=0.01, stiffness_damping=0.0, mass_damping=0.0)
    found = agrees(given, loads("upper_end", 1, frequency), key)
    assert (found.C is None) == (key == "joint[0].friction")


KEYS_OF_PLATES = ["bolt[0].force", "bolt[1].force", "joint[0].friction", "material.E",
                  "damping.ratio", "material.regions.ub.E",
                  "joint[0].tangential_stiffness"]  # fmt: skip
PLATES = [(False, key) for key in KEYS_OF_PLATES]
PLATES += [(True, key) for key in ("bolt[0].force", "material.regions.ub.E")]


@pytest.mark.parametrize("contact", ["constant", "unilateral"])
@pytest.mark.parametrize(("solid", "key"), PLATES)
def test_derivatives_of_bolted_plates_are_those_of_their_system(key, contact, solid):
    joint = {"contact": contact, **STIFF}
    given = bolted(solid, joint=joint, damping_ratio=0.01, regions={"ub": {"E": 100e9}})
    touches = given.preload.joints[0].contact_force > 0.0
    assert touches.any()
    assert not touches.all()
    found = agrees(given, loads("right", given.dim), key)
    if key.startswith("bolt"):
        assert found.w is not None
        if contact == "unilateral":
            assert found.force.any()
            assert found.gap.any()
            assert not found.gap[touches].any()


@pytest.mark.parametrize("key", ["bolt[0].force", "material.E", "material.regions.u1.E"])
@pytest.mark.parametrize("order", [1, 2])
def test_derivatives_of_the_preload_with_a_gap_at_first(key, order):
    """The pressure depends on how stiff the plates are, as they are bent until they touch."""
    joint = {"contact": "unilateral", "gap": 2e-7}
    given = bolted(order=order, joint=joint, regions={"u1": {"E": 150e9}})
    found = agrees(given, loads("right", 2), key)
    assert np.abs(found.w).max() > 1e-3 * given.unloaded.contact.w.max() / value_of(given, key)


@pytest.mark.parametrize("key", ["joint[0].friction", "joint[0].pressure"])
def test_a_pressed_block_that_opens(key):
    found = agrees(block(), loads("top", 2), key)
    assert found.w.all()
    assert (found.gain is None) == (key == "joint[0].pressure")
    assert (found.force is None) == (key == "joint[0].friction")


def test_derivatives_of_a_preload_need_no_factor_that_was_kept():
    """Sent to another process a structure has no factor, a large one not even its problem."""
    given = bolted(joint={"contact": "unilateral"}, regions={"ub": {"E": 100e9}})
    sent = pickle.loads(pickle.dumps(given))  # noqa: S301 - its own
    rng = np.random.default_rng(1)
    rates = (
        rng.normal(size=(given.n_dofs, 2)),
        1e-9 * rng.normal(size=(given.spaces[0].area.size, 2)),
    )
    preloads = given.preload, sent.preload, replace(given.preload, contact=None)
    known, *others = (preload_rates(given.body, held, *rates)[0] for held in preloads)
    for found in others:
        for one, two in zip(found, known, strict=True):
            np.testing.assert_allclose(one, two, atol=1e-9 * np.abs(two).max())


def under_rings() -> sj.Structure:
    """Bar on a base, pressed under the heads of two bolts, with a second joint beside the first."""
    mesh = sj.build_bar([("joint", 0.2, 20), ("rest", 0.1, 10), ("free", 0.1, 5)], {"end": 0.4})
    bolts = tuple(sj.Bolt((x, 0.0), 4e3, 0.02, 0.004) for x in (0.06, 0.14))
    joints = [sj.Joint("joint", sj.Bolts(bolts, 0.01), 0.4), sj.Joint("rest", 1e6, 0.2)]
    return structure(mesh, joints, ())


def side_by_side() -> sj.Structure:
    """Bar on a base by two joints that share a point."""
    mesh = sj.build_bar([("a", 0.1, 4), ("b", 0.1, 4)], {"end": 0.2})
    return structure(mesh, [sj.Joint(on, 2e6, 0.3, **STIFF) for on in "ab"], ())


@pytest.mark.parametrize(
    ("values", "kept"),
    [
        ({"joint[0].friction": 0.5}, {"body", "preload"}),
        ({"joint[*].tangential_stiffness": 1e12, "damping.ratio": 0.03}, {"body", "preload"}),
        ({"bolt[0].force": 8e3}, {"body"}),
        ({"material.E": 150e9}, set()),
        ({"material.regions.ub.E": 150e9}, set()),
    ],
)
def test_structures_with_other_values_are_those_made_anew(values, kept):
    """What the values do not change is taken over, and nothing that is old."""
    joint = {"contact": "unilateral", **STIFF}
    given = bolted(joint=joint, damping_ratio=0.01, regions={"ub": {"E": 100e9}})
    on = loads("right", 2)
    system, before = given.system(on), {key: value_of(given, key) for key in values}
    changed = with_values(given, values)
    assert {
        name for name in ("body", "preload") if getattr(changed, name) is getattr(given, name)
    } == kept
    assert {key: value_of(changed, key) for key in values} == values
    anew = replace(changed)
    assert changed == anew
    # The search for what touches begins with another set, and ends with the same.
    assert_same(changed.system(on), anew.system(on), 0.0 if "preload" in kept else 1e-9)
    back = with_values(with_values(changed, {"joint[0].friction": 0.6}), {"joint[0].friction": 0.3})
    assert_same(with_values(back, before).system(on), system, 1e-9)


@pytest.mark.parametrize(
    ("values", "frequency"),
    [
        ({"joint[0].friction": 0.5, "damping.ratio": 0.02}, 300.0),
        ({"joint[0].tangential_stiffness": 1e12}, 300.0),
        ({}, 200.0),
        ({"material.E": 1e11}, 300.0),
    ],
)
def test_frequencies_of_the_damping_are_found_anew_where_they_change(values, frequency):
    given, on = bolted(joint=STIFF, damping_ratio=0.01), loads("right", 2, frequency)
    fit = given.fitted(*given.system(loads("right", 2)).closed().stuck_problem)
    changed = with_values(given, values)
    system = changed.system(on)
    same = "joint[0].friction" in values
    assert (given.fitted(*system.closed().stuck_problem) is fit) == same
    assert abs(system.C - replace(changed).system(on).C).max() == 0.0


def of_bar(normal_force: str) -> sj.Structure:
    return bar({"normal_force": normal_force, **STIFF})


KEYS_OF_BAR = ["joint[0].friction", "joint[*].friction", "joint[0].pressure", "material.E",
               "material.regions.upper_arm.E", "damping.stiffness", "damping.mass",
               "joint[0].tangential_stiffness"]  # fmt: skip
LINEAR = [(partial(of_bar, kind), "upper_end", key) for kind in ("equal", "consistent")
          for key in KEYS_OF_BAR]  # fmt: skip
LINEAR += [(under_rings, "end", f"joint[0].pressure.bolts[{k}].force") for k in "1*"]
LINEAR += [(side_by_side, "end", key) for key in ("joint[1].friction", "joint[*].friction",
           "joint[*].pressure", "joint[*].tangential_stiffness")]  # fmt: skip


@pytest.mark.parametrize(("make", "on", "key"), LINEAR)
def test_derivatives_by_what_a_system_is_linear_in_are_exact(make, on, key):
    """Also those of several bolts and joints, which add up where they share points."""
    agrees(make(), loads(on, 1), key, step=0.5, share=1e-12)


OPENS: dict[str, Any] = {"contact": "unilateral"}
ELASTIC = {"joint": {**OPENS, "normal_stiffness": 5e12, **STIFF}, "damping_ratio": 0.01}


@pytest.mark.parametrize(
    ("values", "key", "changes"),
    [
        ({"joint": {"friction": 0.0}, "free": True}, "joint[0].friction", "w"),
        ({"joint": {"friction": 0.0, **OPENS}, "free": True}, "joint[0].friction", "w"),
        ({"joint": OPENS, "bolts": [replace(x, force=8e3) for x in BOLTS]}, "bolt[*].force", "w"),
        (ELASTIC, "joint[0].normal_stiffness", "C"),
        (ELASTIC, "joint[0].tangential_stiffness", "C"),
        (ELASTIC, "material.E", "C"),
    ],
)
def test_derivatives_where_friction_is_zero_clamps_are_alike_or_damping_follows(
    values, key, changes
):
    assert getattr(agrees(bolted(**values), loads("right", 2), key), changes) is not None


def table() -> sj.Structure:
    mesh = sj.build_bar([("joint", 0.3, 3)], {"end": 0.3})
    pressure = sj.PressureTable((0.0, 0.3), (1e6, 2e6))
    return structure(mesh, [sj.Joint("joint", pressure, 0.3)], (), damping_ratio=0.1)


def opens() -> sj.Structure:
    return block(0.0, normal_stiffness=np.inf)


@pytest.mark.parametrize(
    ("make", "key", "words"),
    [
        (bolted, "joint[0].frictoin", r"did you mean 'joint\[0\].friction'.*these are: joint"),
        (bolted, "joint[5].friction", r"joint\[5\].friction: it is no number that can be varied"),
        (bolted, "friction", "no number that can be varied"),
        (bolted, "joint[0].beta", "no number that can be varied"),
        (bolted, "joint[0].pressure", r"found 'preload'.*vary bolt\[\*\].force"),
        (bolted, "joint[0].tangential_stiffness", "give it a finite value to start from"),
        (bolted, "joint[0].normal_stiffness", "needs a joint with contact = 'unilateral'"),
        (bolted, "damping.ratio", "found none; give it a value"),
        (bolted, "bolt[*].force", r"bolt\[0\].force = 9000, .* = 7000; must be the same"),
        (bolted, "material.regions.ub.E", "no number that can be varied"),
        (table, "joint[0].pressure", "table of pressures cannot be varied"),
        (table, "damping.mass", "vary the ratio"),
        (opens, "joint[0].pressure", "give it a positive value"),
        (opens, "joint[0].normal_stiffness", "give it a finite value"),
    ],
)
def test_what_cannot_be_varied_is_refused(make, key, words):
    given = make()
    with pytest.raises(sj.InputError, match=words):
        sj.sensitivities(given, [key], given.system())


def test_values_and_systems_that_do_not_go_together_are_refused():
    given = table()
    with pytest.raises(sj.InputError, match=r"friction: .*-1"):
        with_values(given, {"joint[0].friction": -1.0})
    reduced = given.system().project(np.eye(given.unloaded.n)[:, :2])
    others = (
        with_values(given, {key: 0.5}).system() for key in ("material.E", "joint[0].friction")
    )
    for other in (reduced, *others):
        with pytest.raises(sj.InputError, match=r"must be the structure's own"):
            sj.sensitivities(given, ["joint[0].friction"], other)
    sj.sensitivities(given, ["joint[0].friction"], with_values(given, {}).system())
