"""Scenes of plates: what is read, what is refused and in which words."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scenes import problems_of, with_changes

from skfem_joint import loads
from skfem_joint.bolts import Bolt, Bolts
from skfem_joint.meshing import build_bar, write_mesh
from skfem_joint.plate_contact import AxialPressure
from skfem_joint.plate_file import write_plate
from skfem_joint.plate_mesh import build_plate
from skfem_joint.scene import PlateScene, Scene, load_scene

EXAMPLES = Path(__file__).parent.parent / "examples"

GOOD = """\
title = "two plates"
[mesh]
file = ["lower.msh", "upper.msh"]
[material]
E = 200e9
density = 8000
poisson = 0.3
[section]
thickness = 0.01
[support]
fixed = ["left"]
[[joint]]
region = "upper_joint"
against = "joint"
pressure = 50e6
friction = 0.7
[[load]]
on = "upper_right"
kind = "harmonic"
amplitude = 87.5e3
frequency = 500.0
[time]
cycles = 3
[models]
run = ["full", "reduced"]
[reduction]
modes = 5
[output]
every = 1
"""


@pytest.fixture
def scene_file(tmp_path: Path) -> Callable[..., Path]:
    """Write GOOD with some of its text replaced, beside two plates that overlap, and a bar."""
    lower = build_plate(
        [("linear", 0.2, 4), ("joint", 0.1, 4)], 0.05, 2, points={"corner": (0.0, 0.0)}
    )
    upper = build_plate(
        [("upper_joint", 0.1, 4), ("upper_linear", 0.2, 4)],
        0.05,
        2,
        origin=(0.2, 0.0),
        prefix="upper_",
        points={"tip": (0.5, 0.025)},
    )
    write_plate(lower, tmp_path / "lower.msh")
    write_plate(upper, tmp_path / "upper.msh")
    bar = build_bar([("joint", 0.1, 5), ("free", 0.1, 5)], {"fixed": 0.0, "end": 0.2})
    write_mesh(bar, tmp_path / "bar.msh")

    def write(*changes: tuple[str, str]) -> Path:
        path = tmp_path / "scene.toml"
        path.write_text(with_changes(GOOD, changes), encoding="utf-8")
        return path

    return write


def read(path: Path) -> PlateScene:
    scene = load_scene(path)
    assert isinstance(scene, PlateScene)
    return scene


REGION = 'region = "upper_joint"\nagainst = "joint"'
PRESSURE = "pressure = 50e6"
BOUNDARIES = (
    "'bottom', 'left', 'right', 'top', 'upper_bottom', 'upper_left', 'upper_right', 'upper_top'"
)
REGIONS = "'joint', 'linear', 'upper_joint', 'upper_linear'"
FREE = (
    "free points and boundaries of the mesh: 'bottom', 'right', 'tip', 'top', 'upper_bottom', "
    "'upper_left', 'upper_right', 'upper_top'"
)

# What is changed, and everything that must be said.
BAD: list[tuple[tuple[str, str], str]] = [
    (
        ("thickness = 0.01", "thickness = 0.01\nwidth = 0.05"),
        "section.width: a plate needs thickness alone; width is for struts",
    ),
    (
        ("[support]", "[section.regions.joint]\nwidth = 1\n[support]"),
        "section.regions.joint.width: a plate needs thickness alone; width is for struts",
    ),
    (
        ("poisson = 0.3", 'poisson = 0.3\nmass_matrix = "lumped"'),
        "material.mass_matrix: the mass of plates is always consistent; mass_matrix is for struts",
    ),
    (("poisson = 0.3\n", ""), "material.poisson: missing, must be given: Poisson's ratio"),
    (("poisson = 0.3", "poisson = 0.5"), "material.poisson: found 0.5, must be < 0.5"),
    (
        ("thickness = 0.01", 'thickness = 0.01\nplane = "flat"'),
        "section.plane: found 'flat', must be 'stress' or 'strain'",
    ),
    (
        ('fixed = ["left"]', "fixed = []"),
        "support.fixed: found no name; a plate without support is a free body that drifts away, "
        "name at least one point, boundary or region",
    ),
    (
        ('fixed = ["left"]', 'fixed_x = ["lefft"]'),
        "support.fixed_x[0]: found 'lefft', no such point, boundary or region in the mesh; points "
        f"of the mesh: 'corner', 'tip'; boundaries: {BOUNDARIES}; regions: {REGIONS}; "
        "did you mean 'left'?",
    ),
    (
        (REGION, 'region = "right"'),
        f"joint[0].region: found 'right', which is a boundary; a region is needed; regions of the "
        f"mesh: {REGIONS}",
    ),
    (
        (REGION, 'boundary = "joint"'),
        "joint[0].boundary: found 'joint', which is a region; a boundary is needed; boundaries of "
        f"the mesh: {BOUNDARIES}",
    ),
    (
        (REGION, 'region = "upper_joint"\nagainst = "right"'),
        "joint[0].against: found 'right', which is a boundary; a region is needed, as "
        f"'upper_joint' is one; regions of the mesh: {REGIONS}",
    ),
    (
        (REGION, 'boundary = "upper_left"\nagainst = "joint"'),
        "joint[0].against: found 'joint', which is a region; a boundary is needed, as "
        f"'upper_left' is one; boundaries of the mesh: {BOUNDARIES}",
    ),
    (
        (REGION, 'region = "upper_joint"\nagainst = "upper_linear"'),
        "joint[0].against: found 'upper_linear', which belongs to the same body as 'upper_joint'; "
        "a joint presses two bodies on each other, meshed apart from each other",
    ),
    (
        (REGION, 'region = "upper_joint"\nagainst = "tip"'),
        "joint[0].against: found 'tip', which is a point; a boundary or region is needed; "
        f"boundaries of the mesh: {BOUNDARIES}; regions: {REGIONS}",
    ),
    (
        (REGION, 'region = "upper_joint"\nboundary = "bottom"'),
        "joint[0].region: found region and boundary, must be either region (friction over an area) "
        "or boundary (friction along an edge)",
    ),
    (
        (REGION, ""),
        "joint[0].region: found neither region nor boundary, must be either region (friction over "
        "an area) or boundary (friction along an edge)",
    ),
    (
        (PRESSURE, f'{PRESSURE}\nnormal_force = "equal"'),
        "joint[0].normal_force: the normal forces of plates are always consistent; normal_force is "
        "for struts",
    ),
    (
        (PRESSURE, f"{PRESSURE}\naxis = [0, 0.0]"),
        "joint[0].axis: found [0, 0], which points nowhere; give two numbers, not both 0",
    ),
    (
        (PRESSURE, f"{PRESSURE}\naxis = [1, 0, 0]"),
        "joint[0].axis: found a list of 3, must be two numbers, [x, y]",
    ),
    (
        (PRESSURE, "pressure = { positions = [0.2, 0.29], values = [1, 2] }"),
        "joint[0].pressure.positions: found 0.2 to 0.29 m, must cover the joint, which reaches "
        "from 0.2 to 0.3 m along the axis",
    ),
    (
        (PRESSURE, "pressure = { positions = [0.0, 0.04], values = [1, 2], axis = [0, 1] }"),
        "joint[0].pressure.positions: found 0 to 0.04 m, must cover the joint, which reaches from "
        "0 to 0.05 m along the axis",
    ),
    (
        (PRESSURE, "pressure = { positions = [0.2, 0.2], values = [1, 2] }"),
        "joint[0].pressure.positions[1]: found 0.2, must be > 0.2, the position before",
    ),
    (
        (PRESSURE, "pressure = { positions = [0, 1], values = [1, 1], reech = 0.01 }"),
        "joint[0].pressure.reech: unknown key; did you mean 'reach'?; allowed: positions, values, "
        "axis, bolts, reach",
    ),
    (
        (PRESSURE, "pressure = { bolts = [] }"),
        "joint[0].pressure.bolts: found an empty list, must have 1 or more entries",
    ),
    (
        (PRESSURE, "pressure = { bolts = [{ at = [0.25, 0], force = 1 }] }"),
        "joint[0].pressure.bolts[0].head_radius: missing, must be given: radius of the head, m",
    ),
    (
        (PRESSURE, "pressure = { bolts = [{ at = [0.25], force = 1, head_radius = 1 }] }"),
        "joint[0].pressure.bolts[0].at: found a list of 1, must be two numbers, [x, y]",
    ),
    (
        (
            PRESSURE,
            "pressure = { bolts = [{ at = [0, 0], force = 1, head_radius = 0.01, hole_radius = "
            "0.01 }] }",
        ),
        "joint[0].pressure.bolts[0].hole_radius: found 0.01, must be < head_radius, 0.01",
    ),
    (
        (
            PRESSURE,
            "pressure = { bolts = [{ at = [0, 0], force = 1, head_radius = 1, spreading_angle = "
            "90 }] }",
        ),
        "joint[0].pressure.bolts[0].spreading_angle: found 90, must be < 90",
    ),
    (
        (PRESSURE, "pressure = { bolts = [{ at = [0, 0], force = -1, head_radius = 1 }] }"),
        "joint[0].pressure.bolts[0].force: found -1, must be >= 0",
    ),
    (
        (
            f"{REGION}\n{PRESSURE}",
            'boundary = "bottom"\n'
            "pressure = { bolts = [{ at = [0, 0], force = 1, head_radius = 1 }] }",
        ),
        "joint[0].pressure: found bolts, which press an area; an edge needs a number, or positions "
        "and values",
    ),
    (
        (PRESSURE, 'pressure = "high"'),
        "joint[0].pressure: found 'high', must be a pressure in Pa, a table { positions = [m], "
        "values = [Pa], axis = [x, y] } or a table { bolts = [...], reach = m }",
    ),
    (
        ("friction = 0.7", 'friction = 0.7\nlaw = "coulomb"\nbeta = 1e5'),
        "joint[0].beta: found 100000 beside law = 'coulomb', which has no beta; leave it out or "
        "choose law = 'arctan'",
    ),
    (
        ("[[load]]", '[[joint]]\nregion = "joint"\npressure = 1\nfriction = 1\n[[joint]]\n'
         'region = "joint"\npressure = 1\nfriction = 1\n[[load]]'),
        "joint[2].region: found 'joint', which shares 8 elements with joint[1] ('joint'); joints "
        "must not overlap",
    ),
    (
        ('on = "upper_right"', 'on = "upper_right"\ndirection = [0, 0]'),
        "load[0].direction: found [0, 0], which points nowhere; give two numbers, not both 0",
    ),
    (
        ('on = "upper_right"', 'on = "upper_right"\ndirection = 1'),
        "load[0].direction: found 1, must be a list",
    ),
    (
        ('on = "upper_right"', 'on = "left"'),
        "load[0].on: found 'left', which is fixed, so the support takes the whole load; "
        + FREE,
    ),
    (
        ("every = 1", 'points = ["corner"]'),
        f"output.points[0]: found 'corner', which is fixed and never moves; {FREE}",
    ),
    (
        ("every = 1", 'points = ["joint"]'),
        "output.points[0]: found 'joint', which is a region; a point or boundary is needed; points "
        f"of the mesh: 'corner', 'tip'; boundaries: {BOUNDARIES}",
    ),
    (
        ("every = 1", 'shape = "line"'),
        "output.shape: found 'line', must be 'swept' or 'flat'",
    ),
    (
        ("modes = 5", 'reference = "paper"'),
        "joint[0].axis: missing, must be given with reduction.reference = 'paper': the direction "
        "[x, y] along which the reference modes are laid; or use reference = 'self'",
    ),
    (
        ("modes = 5", "active_length = { joint = 0.1 }"),
        "reduction.active_length.joint: found 'joint', which is no joint; joints: 'upper_joint'",
    ),
    (
        ("[section]", "[material.regions]\njoint.E = 2e9\njoint.poison = 0.2\n[section]"),
        "material.regions.joint.poison: unknown key; did you mean 'poisson'?; allowed: E, density, "
        "poisson",
    ),
    (
        ('["lower.msh", "upper.msh"]', "[]"),
        "mesh.file: found an empty list, must have 1 or more entries",
    ),
    (('["lower.msh", "upper.msh"]', "5"), "mesh.file: found 5, must be a text in quotes"),
]  # fmt: skip


@pytest.mark.parametrize(
    ("change", "sentence"), BAD, ids=[f"{i}-{s.split(':')[0]}" for i, (_, s) in enumerate(BAD)]
)
def test_mistake_is_told_in_a_whole_sentence(
    scene_file: Callable[..., Path], change: tuple[str, str], sentence: str
) -> None:
    assert problems_of(scene_file(change)) == [sentence]


def test_files_that_share_names_are_refused(
    scene_file: Callable[..., Path], tmp_path: Path
) -> None:
    path = scene_file(('["lower.msh", "upper.msh"]', '["lower.msh", "lower.msh"]'))
    assert all(problem.startswith("mesh.file: name '") for problem in problems_of(path)[:7])


def test_a_bar_beside_a_plate_is_refused(scene_file: Callable[..., Path]) -> None:
    (problem,) = problems_of(scene_file(('["lower.msh", "upper.msh"]', '["lower.msh", "bar.msh"]')))
    assert problem.startswith("mesh.file: ")
    assert "bar.msh: lines only" in problem


STRUT = """\
[mesh]
file = "bar.msh"
[material]
E = 200e9
density = 8000
[section]
width = 0.05
thickness = 0.01
[support]
fixed = ["fixed"]
[[joint]]
region = "joint"
pressure = 50e6
friction = 0.7
[[load]]
on = "end"
kind = "harmonic"
amplitude = 1.0
frequency = 500.0
[time]
cycles = 1
"""


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        (
            ("width = 0.05", 'width = 0.05\nplane = "stress"'),
            "section.plane: plane stress and strain are for plates; a strut needs width and "
            "thickness",
        ),
        (
            ('fixed = ["fixed"]', 'fixed = ["fixed"]\nfixed_x = ["end"]'),
            "support.fixed_x: a strut moves along itself alone; name the points that are held "
            "under fixed",
        ),
        (
            ('region = "joint"', 'region = "joint"\nagainst = "free"'),
            "joint[0].against: two bodies in a joint are for plates; a strut is pressed on a rigid "
            "base",
        ),
        (
            ('region = "joint"', 'region = "joint"\nboundary = "end"'),
            "joint[0].boundary: edges of plates are boundaries; a strut is pressed along a region",
        ),
        (
            ('region = "joint"', 'region = "joint"\naxis = [1, 0]'),
            "joint[0].axis: a strut has one direction; axis is for plates",
        ),
        (
            (PRESSURE, "pressure = { positions = [0, 1], values = [1, 1], axis = [1, 0] }"),
            "joint[0].pressure.axis: positions along a strut need no axis; axis is for plates",
        ),
        (
            ('on = "end"', 'on = "end"\ndirection = [1, 0]'),
            "load[0].direction: direction is for plates; a force on a strut acts along it",
        ),
    ],
)
def test_keys_of_plates_on_a_strut_are_told_apart(
    scene_file: Callable[..., Path], tmp_path: Path, change: tuple[str, str], sentence: str
) -> None:
    scene_file()
    path = tmp_path / "strut.toml"
    path.write_text(STRUT)
    assert isinstance(load_scene(path), Scene)
    assert STRUT.count(change[0]) == 1
    path.write_text(STRUT.replace(*change))
    assert problems_of(path) == [sentence]


def test_the_good_scene_and_its_defaults(scene_file: Callable[..., Path]) -> None:
    scene = read(scene_file())
    assert scene.section.plane == "stress"
    assert scene.support.named == (("left", "xy"),)
    joint = scene.joint[0]
    assert (joint.kind, joint.name, joint.against, joint.axis) == (
        "region",
        "upper_joint",
        "joint",
        None,
    )
    assert (joint.law, joint.beta) == ("arctan", 1e5)
    assert scene.load[0].direction == (1.0, 0.0)
    assert scene.load[0].to_load() == loads.Harmonic(87.5e3, 500.0)
    assert scene.reduction.reference == "self"
    assert scene.output.shape == "swept"
    assert scene.output_points == ("tip",)
    assert int(scene.plate.body.max()) == 1
    assert (scene.cycle_steps, scene.n_steps, scene.time_step) == (200, 600, 1e-5)


def test_what_a_scene_may_give_another_way(scene_file: Callable[..., Path]) -> None:
    scene = read(
        scene_file(
            ('fixed = ["left"]', 'fixed_x = ["left"]\nfixed_y = ["bottom", "tip"]'),
            (REGION, 'boundary = "upper_bottom"'),
            (PRESSURE, "pressure = { positions = [0, 1], values = [1, 2], axis = [3, 4] }"),
            ("friction = 0.7", 'friction = 0.7\nlaw = "coulomb"\naxis = [-2, 0]'),
            ('on = "upper_right"', 'on = "upper_right"\ndirection = [0, -3]'),
            ("thickness = 0.01", 'thickness = 0.01\nplane = "strain"'),
            ("[support]", "[section.regions.joint]\nthickness = 0.02\n[support]"),
            ("[section]", "[material.regions.joint]\npoisson = 0.2\n[section]"),
            ("every = 1", 'points = ["tip", "upper_right"]'),
            ("modes = 5", 'reference = "paper"'),
        )
    )
    assert scene.support.named == (("left", "x"), ("bottom", "y"), ("tip", "y"))
    joint = scene.joint[0].to_joint()
    assert (joint.kind, joint.name, joint.beta) == ("boundary", "upper_bottom", math.inf)
    assert joint.pressure == AxialPressure((0.0, 1.0), (1.0, 2.0), (0.6, 0.8))
    assert scene.joint[0].axis == (-1.0, 0.0)
    assert scene.load[0].direction == (0.0, -1.0)
    assert scene.overrides == {"joint": {"poisson": 0.2, "thickness": 0.02}}
    assert scene.output_points == ("tip", "upper_right")


def test_bolts_arrive_as_given(scene_file: Callable[..., Path]) -> None:
    table = (
        "pressure = { reach = 0.01, bolts = [{ at = [0.25, 0.025], force = 20e3, "
        "head_radius = 0.008, hole_radius = 0.004, spreading_angle = 25 }] }"
    )
    joint = read(scene_file((PRESSURE, table))).joint[0].to_joint()
    assert joint.pressure == Bolts((Bolt((0.25, 0.025), 20e3, 0.008, 0.004, 25.0),), 0.01)


def test_a_point_held_one_way_may_be_loaded_and_observed(scene_file: Callable[..., Path]) -> None:
    scene = read(
        scene_file(
            ('fixed = ["left"]', 'fixed_x = ["left"]\nfixed_y = ["bottom"]'),
            ('on = "upper_right"', 'on = "left"'),
        )
    )
    # The corner is held in x by the edge and in y by the bottom.
    assert scene.output_points == ("tip",)


@pytest.mark.parametrize(
    ("kind", "keys", "expected"),
    [
        (
            "multi_harmonic",
            "components = [{amplitude = 2, frequency = 3}]",
            loads.MultiHarmonic((loads.Harmonic(2, 3),)),
        ),
        ("half_sine", "peak = 2\nrise_time = 0.3", loads.HalfSine(2, 0.3)),
        ("rectangle", "peak = 2\nduration = 0.3", loads.Rectangle(2, 0.3)),
    ],
)
def test_each_kind_of_load_has_a_direction(
    scene_file: Callable[..., Path], kind: str, keys: str, expected: loads.Load
) -> None:
    harmonic = 'kind = "harmonic"\namplitude = 87.5e3\nfrequency = 500.0\n'
    scene = read(
        scene_file(
            (harmonic, f'kind = "{kind}"\n{keys}\ndirection = [0, 2]\n'),
            ("cycles = 3", "duration = 1.0\nstep = 1e-3"),
        )
    )
    assert scene.load[0].to_load() == expected
    assert scene.load[0].direction == (0.0, 1.0)


def test_all_mistakes_are_reported_at_once(scene_file: Callable[..., Path]) -> None:
    path = scene_file(
        ("E = 200e9", "E = -1"),
        ('fixed = ["left"]', 'fixed = ["lft"]'),
        (REGION, 'region = "right"'),
        ('on = "upper_right"', 'on = "upper_right"\ndirection = [1]'),
        ("every = 1", 'points = ["nowhere"]'),
        ("thickness = 0.01", "thickness = 0.01\nwidth = 0.05"),
    )
    keys = {problem.split(": ")[0] for problem in problems_of(path)}
    assert keys == {
        "material.E",
        "section.width",
        "support.fixed[0]",
        "joint[0].region",
        "load[0].direction",
        "output.points[0]",
    }


def test_a_scene_of_plates_is_told_by_its_section_where_the_mesh_is_missing(
    scene_file: Callable[..., Path],
) -> None:
    (problem,) = problems_of(scene_file(('"upper.msh"', '"nothing.msh"')))
    assert problem.startswith("mesh.file: ")
    assert "nothing.msh" in problem


def test_direction_is_a_unit_vector_whatever_its_size(scene_file: Callable[..., Path]) -> None:
    for size in (1e-15, 1.0, 1e15):
        change = (
            'on = "upper_right"',
            f'on = "upper_right"\ndirection = [{-3 * size}, {4 * size}]',
        )
        direction = read(scene_file(change)).load[0].direction
        assert np.array(direction) == pytest.approx([-0.6, 0.8], rel=1e-14)


@pytest.mark.parametrize("name", sorted(path.stem for path in EXAMPLES.glob("*plate*.toml")))
def test_examples_are_valid(name: str) -> None:
    scene = read(EXAMPLES / f"{name}.toml")
    assert scene.joint
    assert scene.models.run == ("full", "reduced")
