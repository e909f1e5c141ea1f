"""The key ``reduction.range``: what may stand in it, and what its values mean for joints."""

import pytest
from scene_texts import problems_of, scene_of

from skfem_joint.ground.errors import InputError

RANGE = "range = { %sslip = [0.1, 0.9], frequency = [100.0, 900.0] }"


def with_range(more: str = "") -> tuple[str, str]:
    return ("modes = 5", RANGE % (f"{more}, " if more else ""))


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ('"joint[1].friction" = [0.2, 0.8]', ['range."joint[1].friction"', "no joint[1]"]),
        ('"joint[0].beta" = [1e4, 1e5]', ['"joint[0].beta": is no key that changes all limits']),
        ('"bolt[0].force" = [1e3, 2e3]', ["may open a joint", "give the friction of the joint"]),
        ("friction = [0.2, 0.8]", ["range.friction: is no key", "joint[N].friction"]),
        ('"joint[0].friction" = [0.8, 0.2]', ["found [0.8, 0.2]", "lowest and then the highest"]),
        ('"joint[0].friction" = [0.8]', ["found a list of 1, must be two numbers"]),
        ('"joint[0].friction" = 0.8', ["found 0.8, must be a list"]),
        ('"joint[0].friction" = [0.0, 0.8]', ["must be > 0"]),
        ('"joint[0].pressure.bolts[0].force" = [1.0, 2.0]', ["no bolts[0] in its pressure"]),
    ],
)
def test_mistakes_name_key_and_value(more, words):
    (problem,) = problems_of(with_range(more))
    for word in words:
        assert word in problem


@pytest.mark.parametrize(
    ("reduction", "words"),
    [
        ("range = { slip = [0.1, 1.0], frequency = [1.0, 2.0] }", "must be below 1"),
        ("range = { slip = [0.1, 0.5] }", "range.frequency: missing, must be given"),
        (
            "range = { slip = [0.1, 0.5], frequency = [1.0, 2.0] }\nreference = 'self'",
            "range: found beside reference",
        ),
    ],
)
def test_a_range_is_whole_and_chooses_by_itself(reduction, words):
    (problem,) = problems_of(("modes = 5", reduction))
    assert words in problem


def test_a_range_of_frequencies_needs_loads_that_have_one():
    pulse = [
        ("amplitude = 87.5e3\nfrequency = 500.0", "peak = 87.5e3\nrise_time = 1e-3"),
        ('"harmonic"', '"half_sine"'),
        ("cycles = 3", "duration = 1e-2\nstep = 1e-5"),
    ]
    (problem,) = problems_of(with_range(), *pulse)
    assert "load[0] of kind = 'half_sine'" in problem


def test_values_of_a_joint_become_factors_about_their_middle():
    keys = '"joint[0].friction" = [0.2, 0.8], "joint[0].pressure" = [25e6, 100e6]'
    scene = scene_of(with_range(keys), ("pressure = 50e6", "pressure = 100e6"))
    table = scene.reduction.range
    (low, high) = table.limits(scene.joint)["joint"]
    assert (low, high) == pytest.approx((0.25, 4.0))  # both together multiply
    assert table.factors(scene.joint)["joint"] == pytest.approx(0.7 / 0.4 * 2.0)
    (middle,) = scene.changed(table.middle()).joint
    assert (middle.friction, middle.pressure) == pytest.approx((0.4, 50e6))
    assert table.factors((middle,))["joint"] == pytest.approx(1.0)


BOLTS = """pressure = { bolts = [
    { at = [0.05, 0.0], force = 20e3, head_radius = 0.01 },
    { at = [0.09, 0.0], force = 30e3, head_radius = 0.01 } ] }"""
FORCE = '"joint[0].pressure.bolts[%d].force" = [%g, %g]'


def test_the_force_of_bolts_is_a_factor_if_all_bolts_of_a_joint_have_it():
    bolts = ("pressure = 50e6", BOLTS)
    (problem,) = problems_of(with_range(FORCE % (0, 10e3, 40e3)), bolts)
    assert "the force of one bolt of several changes a part" in problem
    of_two = f"{FORCE % (0, 10e3, 40e3)}, {FORCE % (1, 10e3, 20e3)}"
    assert len(problems_of(with_range(of_two), bolts)) == 2
    scene = scene_of(with_range(f"{FORCE % (0, 10e3, 40e3)}, {FORCE % (1, 15e3, 60e3)}"), bolts)
    table = scene.reduction.range
    assert table.limits(scene.joint)["joint"] == pytest.approx((0.5, 2.0))
    assert table.factors(scene.joint)["joint"] == pytest.approx(1.0)
    (harder,) = scene.changed({"joint[0].pressure.bolts[1].force": 40e3}).joint
    with pytest.raises(InputError, match="by other factors than each other"):
        table.factors((harder,))
