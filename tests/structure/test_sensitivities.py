"""Derivatives of systems by keys of their structures, against central differences."""

from __future__ import annotations

import pickle
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from bodies import STEEL, structure
from clamped_plates import BOLTS, STIFF, bar, bolted, loads
from opening_blocks import block
from scipy import sparse

import skfem_joint as sj
import skfem_joint.system.modes
from skfem_joint.body import assembly
from skfem_joint.ground.errors import InputError
from skfem_joint.joint import active_set
from skfem_joint.mesh import build_bar
from skfem_joint.structure import structure as structure_module
from skfem_joint.structure.parameters import value_of, with_values
from skfem_joint.structure.sensitivities import sensitivities
from skfem_joint.system.sensitivity import SystemSensitivity


def parts(found: Any) -> Iterator[tuple[str, Any]]:
    """Matrices and vectors of a system, or of its derivatives, by name."""
    contact, normal = found, found
    if isinstance(found, sj.System):
        contact, normal = found.contact, found.contact.normal if found.contact.opens else None
    elif isinstance(found, SystemSensitivity):
        normal = found.opening
    for owner, names in ((found, "KC"), (contact, ("w", "stiffness"))):
        for name in names:
            yield name, getattr(owner, name)
    for name in ("gap", "force", "gain", "stiffness"):
        owner = found.contact if name == "gain" and isinstance(found, sj.System) else normal
        yield f"opening.{name}", None if normal is None else getattr(owner, name)


def dense(values: Any) -> Any:
    return values.toarray() if sparse.issparse(values) else np.asarray(values)


def agrees(
    given: sj.Structure, on: list[sj.Load], key: str, step: float = 1e-4, share: float = 1e-6
) -> SystemSensitivity:
    """Derivatives by a key, which central differences of the system must give too."""
    system = given.system(on)
    (found,) = sensitivities(given, [key], system)
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


KEYS_OF_BAR = ["joint[0].friction", "joint[*].friction", "joint[0].pressure", "material.E",
               "material.regions.upper_arm.E", "damping.stiffness", "damping.mass",
               "joint[0].tangential_stiffness"]  # fmt: skip


@pytest.mark.parametrize("normal_force", ["equal", "consistent"])
@pytest.mark.parametrize("key", KEYS_OF_BAR)
def test_derivatives_of_a_bar_are_those_of_its_system(key, normal_force):
    agrees(bar({"normal_force": normal_force, **STIFF}), loads("upper_end", 1), key)


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


@pytest.mark.parametrize("solid", [False, True])
@pytest.mark.parametrize("contact", ["constant", "unilateral"])
@pytest.mark.parametrize(
    "key",
    ["bolt[0].force", "bolt[1].force", "joint[0].friction", "material.E", "damping.ratio",
     "material.regions.ub.E", "joint[0].tangential_stiffness"],
)  # fmt: skip
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
            assert found.opening.force.any()
            assert found.opening.gap.any()
            assert not found.opening.gap[touches].any()


@pytest.mark.parametrize("key", ["bolt[0].force", "material.E", "material.regions.u1.E"])
@pytest.mark.parametrize("order", [1, 2])
def test_derivatives_of_the_preload_with_a_gap_at_first(key, order):
    """The pressure depends on how stiff the plates are, as they are bent until they touch."""
    joint = {"contact": "unilateral", "gap": 2e-7}
    given = bolted(order=order, joint=joint, regions={"u1": {"E": 150e9}})
    found = agrees(given, loads("right", 2), key)
    assert np.abs(found.w).max() > 1e-3 * given.unloaded.contact.w.max() / value_of(given, key)


@pytest.mark.parametrize(
    "key", ["joint[0].normal_stiffness", "joint[0].tangential_stiffness", "material.E"]
)
def test_damping_by_a_ratio_follows_elastic_contact_that_opens(key):
    joint = {"contact": "unilateral", "normal_stiffness": 5e12, **STIFF}
    found = agrees(bolted(joint=joint, damping_ratio=0.01), loads("right", 2), key)
    assert found.C is not None


@pytest.mark.parametrize("key", ["joint[0].friction", "joint[0].pressure"])
def test_a_pressed_block_that_opens(key):
    found = agrees(block(), loads("top", 2), key)
    assert found.w.all()
    assert (found.opening.gain is None) == (key == "joint[0].pressure")
    assert (found.opening.force is None) == (key == "joint[0].friction")


@pytest.mark.parametrize("contact", ["constant", "unilateral"])
def test_friction_of_zero_has_its_derivative(contact):
    given = bolted(joint={"contact": contact, "friction": 0.0}, free=True)
    found = agrees(given, loads("right", 2), "joint[0].friction")
    rough = bolted(joint={"contact": contact, "friction": 1.0}).system(loads("right", 2))
    np.testing.assert_allclose(found.w, rough.contact.w, rtol=1e-12)


@pytest.mark.parametrize("contact", ["constant", "unilateral"])
@pytest.mark.parametrize(("solid", "order"), [(False, 1), (False, 2), (True, 1)])
def test_limits_are_homogeneous_in_the_forces_of_all_bolts(contact, solid, order):
    given = bolted(solid, order, {"contact": contact})
    system = given.system(loads("right", given.dim))
    keys = ["bolt[0].force", "bolt[1].force"]
    found = sensitivities(given, keys, system)
    total = sum(value_of(given, key) * one.w for key, one in zip(keys, found, strict=True))
    np.testing.assert_allclose(total, system.contact.w, atol=1e-9 * system.contact.w.max())
    if contact == "unilateral":
        for name in ("force", "gap"):
            rates = [getattr(one.opening, name) for one in found]
            total = sum(bolt.force * rate for bolt, rate in zip(BOLTS, rates, strict=True))
            known = getattr(system.contact.normal, name)
            np.testing.assert_allclose(total, known, atol=1e-9 * known.max())


def test_derivatives_of_the_preload_use_its_own_factor(monkeypatch):
    """A large structure does not keep the factor; its derivatives are the same with a new one."""
    made: list[int] = []
    real = active_set.factorised
    monkeypatch.setattr(active_set, "factorised", lambda A: (made.append(1), real(A))[1])
    keys, found = ["bolt[0].force", "material.regions.ub.E"], []
    for kept in (None, 0):
        if kept is not None:
            monkeypatch.setattr(active_set, "KEPT", kept)
        given = bolted(joint={"contact": "unilateral"}, regions={"ub": {"E": 100e9}})
        system = given.system(loads("right", 2))
        assert (given.preload.contact is None) == (kept == 0)
        found.append(sensitivities(given, keys, system))
        assert len(made) == (kept == 0)
    for one, other in zip(*found, strict=True):
        for (_, a), (_, b) in zip(parts(one), parts(other), strict=True):
            if b is not None:
                assert abs(a - b).max() < 1e-9 * abs(b).max()


def test_a_structure_with_a_known_preload_can_be_sent_to_another_process():
    given = bolted(regions={"ub": {"E": 100e9}})
    on, key = loads("right", 2), "material.regions.ub.E"
    (known,) = sensitivities(given, [key], given.system(on))
    sent = pickle.loads(pickle.dumps(given))  # noqa: S301 - its own
    (found,) = sensitivities(sent, [key], sent.system(on))
    np.testing.assert_allclose(found.w, known.w, atol=1e-9 * np.abs(known.w).max())


def test_one_value_of_all_bolts_changes_with_each_of_them():
    given = bolted(joint={"contact": "unilateral"}, bolts=[replace(b, force=8e3) for b in BOLTS])
    keys = ["bolt[0].force", "bolt[1].force", "bolt[*].force"]
    found = sensitivities(given, keys, given.system(loads("right", 2)))
    for name, values in parts(found[2]):
        if values is not None:
            first, second = (dict(parts(one))[name] for one in found[:2])
            scale = np.abs(values).max()
            np.testing.assert_allclose(values, first + second, atol=1e-9 * scale)
    agrees(given, loads("right", 2), "bolt[*].force")


def under_rings(forces: tuple[float, float] = (4e3, 3e3)) -> sj.Structure:
    """Bar on a base, pressed under the heads of two bolts, with a second joint beside the first."""
    mesh = build_bar([("joint", 0.2, 20), ("rest", 0.1, 10), ("free", 0.1, 5)], {"end": 0.4})
    bolts = [sj.Bolt((x, 0.0), force, 0.02, 0.004)
             for x, force in zip((0.06, 0.14), forces, strict=True)]  # fmt: skip
    pressure = sj.Bolts(tuple(bolts), 0.01)
    joints = [sj.Joint("joint", pressure, 0.4), sj.Joint("rest", 1e6, 0.2)]
    return structure(mesh, joints, ())


@pytest.mark.parametrize(
    "key", ["joint[0].pressure.bolts[0].force", "joint[0].pressure.bolts[1].force"]
)
def test_forces_of_bolts_around_their_holes(key):
    agrees(under_rings(), loads("end", 1), key)


def test_joints_that_share_points_add_up():
    """Linear in each value: exact to round-off, and by the value that all share to their sum."""
    given = under_rings((4e3, 4e3))
    mesh = build_bar([("a", 0.1, 4), ("b", 0.1, 4)], {"end": 0.2})
    shared = structure(mesh, [sj.Joint(on, 2e6, 0.3) for on in "ab"], ())
    for one, every, each in (
        (given, "joint[0].pressure.bolts[*].force",
         [f"joint[0].pressure.bolts[{k}].force" for k in range(2)]),
        (shared, "joint[*].friction", ["joint[0].friction", "joint[1].friction"]),
        (shared, "joint[*].pressure", ["joint[0].pressure", "joint[1].pressure"]),
    ):  # fmt: skip
        system = one.system(loads("end", 1))
        whole, *single = sensitivities(one, [every, *each], system)
        np.testing.assert_allclose(whole.w, sum(part.w for part in single), rtol=1e-12)
        if one is shared:
            np.testing.assert_allclose(value_of(one, every) * whole.w, system.contact.w, rtol=1e-12)


@pytest.mark.parametrize("key", ["joint[0].friction", "joint[0].pressure", "material.E",
                                 "damping.stiffness"])  # fmt: skip
def test_what_is_linear_is_exact_to_round_off(key):
    agrees(bar(), loads("upper_end", 1), key, step=0.5, share=1e-12)


@pytest.mark.parametrize(
    ("values", "parts_made"),
    [
        ({"joint[0].friction": 0.5}, set()),
        ({"joint[*].tangential_stiffness": 1e12, "damping.ratio": 0.03}, set()),
        ({"bolt[*].force": 8e3}, {"preload"}),
        ({"material.E": 150e9}, {"preload", "stiffness"}),
        ({"material.regions.ub.E": 150e9}, {"preload", "stiffness"}),
    ],
)
def test_structures_with_other_values_are_those_made_anew(monkeypatch, values, parts_made):
    """What the values do not change is not computed again."""
    joint = {"contact": "unilateral", **STIFF}
    given = bolted(joint=joint, damping_ratio=0.01, regions={"ub": {"E": 100e9}})
    on = loads("right", 2)
    given.system(on)
    made: set[str] = set()

    def noted(module: Any, name: str) -> None:
        real = getattr(module, name)
        monkeypatch.setattr(module, name, lambda *a, **k: (made.add(name), real(*a, **k))[1])

    noted(assembly, "stiffness")
    noted(structure_module, "preload")
    changed = with_values(given, values)
    system = changed.system(on)
    assert made == parts_made
    monkeypatch.undo()
    for key, value in values.items():
        assert value_of(changed, key) == value
    anew = replace(changed).system(on)
    # The search for what touches begins with another set, and ends with the same.
    assert_same(system, anew, 1e-9 if "preload" in parts_made else 0.0)
    assert changed == replace(changed)


def test_frequencies_of_the_damping_are_found_anew_where_they_change(monkeypatch):
    given = bolted(joint=STIFF, damping_ratio=0.01)
    found: list[int] = []
    real = skfem_joint.system.modes.rayleigh_fit
    monkeypatch.setattr(
        skfem_joint.system.modes, "rayleigh_fit", lambda *a: (found.append(1), real(*a))[1]
    )
    system = given.system(loads("right", 2))
    sensitivities(given, ["material.E", "joint[0].tangential_stiffness"], system)
    changed = with_values(given, {"joint[0].friction": 0.5, "damping.ratio": 0.02})
    twice = changed.system(loads("right", 2)).C - 2.0 * system.C
    assert abs(twice).max() < 1e-12 * abs(system.C).max()
    assert len(found) == 1
    for count, (values, frequency) in enumerate(
        [({"joint[0].tangential_stiffness": 1e12}, 300.0), ({}, 200.0), ({"material.E": 1e11}, 1.0)]
    ):
        changed = with_values(given, values)
        C = changed.system(loads("right", 2, frequency)).C
        anew = replace(changed).system(loads("right", 2, frequency)).C
        assert abs(C - anew).max() == 0.0
        assert len(found) == 3 + 2 * count


def test_a_structure_changed_twice_does_not_keep_what_is_old():
    given = bolted(regions={"ub": {"E": 100e9}})
    given.system()
    there = with_values(with_values(given, {"material.E": 1e11}), {"joint[0].friction": 0.6})
    back = with_values(there, {"material.E": STEEL.E, "joint[0].friction": 0.3})
    assert_same(back.system(), given.system(), 1e-9)


@pytest.mark.parametrize(
    ("key", "words"),
    [
        ("joint[0].frictoin", r"did you mean 'joint\[0\].friction'.*these are: joint\[0\].fric"),
        ("joint[5].friction", r"joint\[5\].friction: it is no number that can be varied"),
        ("friction", "no number that can be varied"),
        ("joint[0].beta", "no number that can be varied"),
        ("joint[0].pressure", r"found 'preload'.*vary bolt\[\*\].force"),
        ("joint[0].tangential_stiffness", "give it a finite value to start from"),
        ("joint[0].normal_stiffness", "needs a joint with contact = 'unilateral'"),
        ("damping.ratio", "found none; give it a value"),
        ("bolt[*].force", r"bolt\[0\].force = 9000, bolt\[1\].force = 7000; must be the same"),
        ("material.regions.ub.E", "no number that can be varied"),
    ],
)
def test_what_cannot_be_varied_is_refused(key, words):
    given = bolted()
    with pytest.raises(InputError, match=words):
        sensitivities(given, [key], given.system())


def test_values_from_which_nothing_can_be_derived_are_refused():
    table = sj.PressureTable((0.0, 0.3), (1e6, 2e6))
    mesh = build_bar([("joint", 0.3, 3)], {"end": 0.3})
    given = structure(mesh, [sj.Joint("joint", table, 0.3)], (), damping_ratio=0.1)
    for key, words in (
        ("joint[0].pressure", "table of pressures cannot be varied"),
        ("damping.mass", "vary the ratio"),
    ):
        with pytest.raises(InputError, match=words):
            sensitivities(given, [key], given.system())
    opens = block(0.0, normal_stiffness=np.inf)
    for key, words in (
        ("joint[0].pressure", "give it a positive value"),
        ("joint[0].normal_stiffness", "give it a finite value"),
    ):
        with pytest.raises(InputError, match=words):
            sensitivities(opens, [key], opens.system())
    with pytest.raises(InputError, match=r"friction: .*-1"):
        with_values(given, {"joint[0].friction": -1.0})
    reduced = given.system().project(np.eye(given.unloaded.n)[:, :2])
    with pytest.raises(InputError, match=r"must be the structure's own"):
        sensitivities(given, ["joint[0].friction"], reduced)
