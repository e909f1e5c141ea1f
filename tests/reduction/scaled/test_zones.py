"""Active zones: where force enters joints, and how far in it reaches."""

from dataclasses import replace

import numpy as np
import pytest
from bodies import structure
from reduced_joints import bar, case, fig_18

from skfem_joint.ground.errors import InputError
from skfem_joint.ground.loads import Harmonic
from skfem_joint.joint.joints import Joint
from skfem_joint.mesh import build_bar, build_box, merged
from skfem_joint.reduction.scaled.zones import active_zones, zone_lengths
from skfem_joint.structure.load import Load
from skfem_joint.structure.structure import Structure
from skfem_joint.system.system import System

PULL = Harmonic(1e5, 500.0)


def ends(structure: Structure, system: System) -> list[tuple[str, float, float]]:
    """Name of each zone, and where along its axis its loaded end and its other end are."""
    found = []
    for zone in active_zones(structure, system):
        along = structure.nodes[zone.nodes] @ zone.axis
        assert np.all(np.diff(zone.distance) >= 0.0)
        np.testing.assert_allclose(np.abs(along - along[0]), zone.distance, atol=1e-15)
        found.append((zone.name, round(float(along[0]), 9), round(float(along[-1]), 9)))
    return found


PARTS = {"left": 0.1, "right": 0.1, "joint": 0.1, "a": 0.2, "b": 0.2}


@pytest.mark.parametrize(
    ("regions", "on", "fixed", "expected"),
    [
        ("left a b right", "after a", ["start", "end"], [("left", 0.1, 0.0), ("right", 0.5, 0.6)]),
        ("a joint b", "end", ["start"], [("joint", 0.2, 0.3), ("joint", 0.3, 0.2)]),
        # The last part ends the bar where nothing pulls: force enters at its first end alone.
        ("joint a joint", "after a", ["start"], [("joint", 0.1, 0.0), ("joint", 0.3, 0.4)]),
    ],
)
def test_joints_of_bars_have_a_zone_at_each_end_where_force_enters(regions, on, fixed, expected):
    parts = [(name, PARTS[name], round(100 * PARTS[name])) for name in regions.split()]
    joints = sorted({name for name in regions.split() if len(name) > 1})
    assert ends(*bar(parts, joints, [(on, PULL)], fixed=fixed)) == expected


def two_bars() -> tuple[Structure, System]:
    lower = build_bar([("under", 0.1, 10), ("rest", 0.2, 10)], {"held": 0.3})
    upper = build_bar([("arm", 0.2, 10), ("joint", 0.1, 15)], {"end": 0.0}, origin=(-0.2, 0.0, 0.0))
    made = structure(merged([lower, upper]), [Joint("joint", 50e6, 0.7, against="under")], ["held"])
    return made, made.system([Load("end", PULL)])


def test_numbering_of_the_mesh_does_not_matter():
    structure = fig_18()[0]
    shuffled = np.random.default_rng(0).permutation(structure.n_nodes)
    place = np.argsort(shuffled)
    old = structure.mesh
    mesh = replace(
        old,
        mesh=replace(old.mesh, doflocs=old.mesh.p[:, shuffled], t=place[old.mesh.t]),
        points={name: int(place[node]) for name, node in old.points.items()},
        coordinates=old.coordinates[shuffled],
    )
    other = replace(structure, mesh=mesh)
    (zone,), (expected,) = (
        active_zones(s, s.system([Load("end", PULL)])) for s in (other, structure)
    )
    np.testing.assert_allclose(zone.distance, expected.distance, atol=1e-15)
    assert np.array_equal(shuffled[zone.nodes], expected.nodes)
    assert zone.tau == pytest.approx(expected.tau, rel=1e-12)


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("lap", [(0.25, 0.0)]),
        ("strip", [(0.1, 0.0)]),
        ("edge", [(0.1, 0.0)]),
        ("two", [(0.0, 0.1), (0.1, 0.0)]),
        ("bars", [(0.0, 0.1), (0.1, 0.0)]),
        ("fig 18", [(0.1, 0.0)]),
    ],
)
def test_zones_of_plates_and_of_two_bodies(name, expected):
    make = {"bars": two_bars, "fig 18": fig_18}.get(name, lambda: case(name)[:2])
    structure, system = make()
    assert ends(structure, system) == [("joint", *zone) for zone in expected]
    zone = active_zones(structure, system)[0]
    limit = 0.7 * structure.patches[0].clamping_force if name != "edge" else 0.5 * 100e6 * 1e-3
    assert zone.tau * zone.length == pytest.approx(limit, rel=1e-12)
    assert zone.is_line == (name in ("edge", "bars", "fig 18"))


def test_solid_on_its_foot_has_a_zone_where_the_arm_begins():
    sides = {"left": "left", "right": "right", "joint": ("bottom", "foot")}
    strips = [("foot", 0.1, 5), ("arm", 0.2, 4)]
    box = build_box(strips, (0.05, 0.02), (2, 2), boundaries=sides)
    made = structure(box, [Joint("joint", 8e6, 0.7, axis=(2.0, 0.0, 0.0))])
    system = made.system([Load("right", PULL, (1.0, 0.0, 0.0))])
    assert ends(made, system) == [("joint", 0.1, 0.0)]


def test_scaled_modes_that_cannot_follow_are_refused():
    inside = bar([("joint", 0.1, 10), ("linear", 0.2, 10)], ["joint"], [("joint", PULL)])
    with pytest.raises(InputError, match="'joint': a load acts inside it"):
        active_zones(*inside)
    touching = bar([("one", 0.1, 10), ("two", 0.1, 10)], ["one", "two"], [("end", PULL)])
    with pytest.raises(InputError, match="'one' touches another joint"):
        active_zones(*touching)
    structure, system, _ = case("strip")
    joints = [replace(joint, axis=None) for joint in structure.joints]
    with pytest.raises(InputError, match="'joint': no axis is named"):
        active_zones(replace(structure, joints=joints), system)
    free = [replace(joint, friction=0.0) for joint in fig_18()[0].joints]
    with pytest.raises(InputError, match="no friction acts in it"):
        active_zones(replace(fig_18()[0], joints=free), fig_18()[1])
    with pytest.raises(InputError, match="no force enters any joint"):
        active_zones(*fig_18(force=0.0))


@pytest.mark.parametrize("length", [0.0, -0.01, 0.1001, np.nan])
def test_active_length_outside_the_joint_is_refused(length):
    structure, system = fig_18()
    zones = active_zones(structure, system)
    for asked in (length, {"joint": length}):
        with pytest.raises(InputError, match="active length of joint 'joint'"):
            zone_lengths(system, zones, asked, np.zeros(system.contact.w.size))


def test_lengths_from_both_ends_of_a_joint_are_kept_apart():
    regions = [("a", 0.2, 20), ("joint", 0.1, 10), ("b", 0.2, 20)]
    structure, system = bar(regions, ["joint"], [("end", PULL)])
    zones = active_zones(structure, system)
    slip = np.zeros(system.contact.w.size)
    for asked, expected in ((0.04, [0.04, 0.04]), (0.08, [0.05, 0.05])):
        found, notes = zone_lengths(system, zones, asked, slip)
        assert found == pytest.approx(expected, rel=1e-12)
    (note,) = notes  # once for both ends
    assert "comes out as 0.16 m, more than the joint has: capped at 0.1 m" in note
    probed, _ = zone_lengths(system, zones, "auto", np.ones(system.contact.w.size))
    assert sum(probed) == pytest.approx(0.1, rel=1e-12)
    stuck, _ = zone_lengths(system, zones, "auto", slip)
    assert stuck == pytest.approx([0.01, 0.01])  # one element
