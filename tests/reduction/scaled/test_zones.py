"""Active zones: where force enters joints, and how far in it reaches."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from bodies import structure
from reduced_joints import TAU, bar, case, fig_18

import skfem_joint as sj
from skfem_joint.reduction.scaled.zones import active_zones, zone_lengths

PULL = sj.Harmonic(1e5, 500.0)


def ends(structure: sj.Structure, system: sj.System) -> list[tuple[str, float, float]]:
    """Name of each zone, and where along its axis its loaded end and its other end are."""
    found = []
    for zone in active_zones(structure, system):
        along = structure.nodes[zone.nodes] @ zone.axis
        assert np.all(np.diff(zone.distance) >= 0.0)
        np.testing.assert_allclose(np.abs(along - along[0]), zone.distance, atol=1e-15)
        found.append((zone.name, round(float(along[0]), 9), round(float(along[-1]), 9)))
    return found


def bar_of(
    regions: str, on: str, fixed: tuple[str, ...] = ("start",)
) -> tuple[sj.Structure, sj.System]:
    """Bar of regions, of which those with long names are joints, loaded on one or at a point."""
    lengths = {"left": 0.1, "right": 0.1, "joint": 0.1, "a": 0.2, "b": 0.2}
    parts = [(name, lengths[name], round(100 * lengths[name])) for name in regions.split()]
    joints = sorted({name for name in regions.split() if len(name) > 1})
    return bar(parts, joints, [(on, PULL)], fixed=fixed)


def two_bars() -> tuple[sj.Structure, sj.System]:
    lower = sj.build_bar([("under", 0.1, 10), ("rest", 0.2, 10)], {"held": 0.3})
    upper = sj.build_bar(
        [("arm", 0.2, 10), ("joint", 0.1, 15)], {"end": 0.0}, origin=(-0.2, 0.0, 0.0)
    )
    made = structure(
        sj.merged([lower, upper]), [sj.Joint("joint", 50e6, 0.7, against="under")], ["held"]
    )
    return made, made.system([sj.Load("end", PULL)])


def solid() -> tuple[sj.Structure, sj.System]:
    """Box on its foot, whose arm is pulled along; its axis is named."""
    sides = {"left": "left", "right": "right", "joint": ("bottom", "foot")}
    strips = [("foot", 0.1, 5), ("arm", 0.2, 4)]
    box = sj.build_box(strips, (0.05, 0.02), (2, 2), boundaries=sides)
    made = structure(box, [sj.Joint("joint", 8e6, 0.7, axis=(2.0, 0.0, 0.0))])
    return made, made.system([sj.Load("right", PULL, (1.0, 0.0, 0.0))])


ONE_END, BOTH_ENDS = [("joint", 0.1, 0.0)], [("joint", 0.0, 0.1), ("joint", 0.1, 0.0)]
#: Structure and system, friction limit (N/m) of the first joint, and what `ends` finds.
ZONES = {
    "two joints": (
        lambda: bar_of("left a b right", "after a", ("start", "end")),
        TAU,
        [("left", 0.1, 0.0), ("right", 0.5, 0.6)],
    ),
    "inside": (lambda: bar_of("a joint b", "end"), TAU, [("joint", 0.2, 0.3), ("joint", 0.3, 0.2)]),
    # The last part ends the bar where nothing pulls: force enters at its first end alone.
    "two parts": (
        lambda: bar_of("joint a joint", "after a"),
        TAU,
        [("joint", 0.1, 0.0), ("joint", 0.3, 0.4)],
    ),
    "fig 18": (fig_18, TAU, ONE_END),
    "two bars": (two_bars, TAU, BOTH_ENDS),
    "two plates": (lambda: case("two")[:2], TAU, BOTH_ENDS),
    "lap": (lambda: case("lap")[:2], 0.7 * 8e6 * 0.05, [("joint", 0.25, 0.0)]),
    "edge": (lambda: case("edge")[:2], 0.5 * 100e6 * 0.01, ONE_END),
    "solid": (solid, 0.7 * 8e6 * 0.02, ONE_END),
}


@pytest.mark.parametrize("name", ZONES)
def test_joints_have_a_zone_at_each_end_where_force_enters(name):
    make, tau, expected = ZONES[name]
    structure, system = make()
    assert ends(structure, system) == expected
    zone = active_zones(structure, system)[0]
    assert zone.tau == pytest.approx(tau, rel=1e-12)
    assert zone.is_line == (name not in ("two plates", "lap", "solid"))


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
        active_zones(s, s.system([sj.Load("end", PULL)])) for s in (other, structure)
    )
    np.testing.assert_allclose(zone.distance, expected.distance, atol=1e-15)
    assert np.array_equal(shuffled[zone.nodes], expected.nodes)
    assert zone.tau == pytest.approx(expected.tau, rel=1e-12)


def changed(name: str, **joint: Any) -> tuple[sj.Structure, sj.System]:
    made, system = fig_18() if name == "fig 18" else case(name)[:2]
    return replace(made, joints=[replace(one, **joint) for one in made.joints]), system


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: bar_of("joint b", "joint"), "'joint': a load acts inside it"),
        (lambda: bar_of("left right", "end"), "'left' touches another joint"),
        (lambda: changed("strip", axis=None), "'joint': no axis is named"),
        (lambda: changed("fig 18", friction=0.0), "no friction acts in it"),
        (lambda: fig_18(force=0.0), "no force enters any joint"),
    ],
)
def test_scaled_modes_that_cannot_follow_are_refused(make, words):
    with pytest.raises(sj.InputError, match=words):
        active_zones(*make())


@pytest.mark.parametrize("length", [0.0, -0.01, 0.1001, np.nan])
def test_active_length_outside_the_joint_is_refused(length):
    structure, system = fig_18()
    zones = active_zones(structure, system)
    for asked in (length, {"joint": length}):
        with pytest.raises(sj.InputError, match="active length of joint 'joint'"):
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
