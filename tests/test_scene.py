"""Scenes: what is read, what is refused and in which words."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scenes import problems_of, with_changes

from skfem_joint import loads
from skfem_joint.errors import InputError
from skfem_joint.meshing import build_bar, write_mesh
from skfem_joint.scene import Scene, load_scene

EXAMPLES = Path(__file__).parent.parent / "examples"

GOOD = """\
title = "two joints and a plain bar"
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
on = "free_end"
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
    """Write GOOD with some of its text replaced, beside its mesh and a table of forces."""
    bar = build_bar(
        [("joint", 0.1, 10), ("linear", 0.3, 6), ("second", 0.1, 5), ("third", 0.1, 5)],
        {"fixed": 0.0, "junction": 0.1, "middle": 0.4, "free_end": 0.6},
    )
    # A region that lies across others, as overlapping groups of a mesh do.
    bar.regions["all"] = np.arange(26)
    write_mesh(bar, tmp_path / "bar.msh")
    (tmp_path / "force.csv").write_text("t,f\n0,0\n1e-3,5e3\n3e-3,0\n")
    (tmp_path / "back.csv").write_text("0,0\n1,5e3\n0.5,0\n")

    def write(*changes: tuple[str, str]) -> Path:
        path = tmp_path / "scene.toml"
        path.write_text(with_changes(GOOD, changes), encoding="utf-8")
        return path

    return write


HARMONIC = 'kind = "harmonic"\namplitude = 87.5e3\nfrequency = 500.0\n'


def load_text(kind: str, keys: str) -> tuple[str, str]:
    """Exchange the good scene's load."""
    return HARMONIC, f'kind = "{kind}"\n{keys}\n'


# What is changed, the key that must be named, words that must be said.
BAD: list[tuple[tuple[str, str], str, list[str]]] = [
    (("E = 200e9", "E = 0"), "material.E", ["found 0", "must be > 0"]),
    (("E = 200e9", "E = -2e9"), "material.E", ["found -2000000000.0", "must be > 0"]),
    (("E = 200e9", "E = nan"), "material.E", ["found nan", "must be finite"]),
    (("E = 200e9", "E = inf"), "material.E", ["found inf", "must be finite"]),
    (("E = 200e9", 'E = "200e9"'), "material.E", ["found '200e9'", "must be a number"]),
    (("E = 200e9", "E = true"), "material.E", ["found true", "must be a number"]),
    (("E = 200e9", "E = 2024-01-01"), "material.E", ["2024-01-01", "must be a number"]),
    (("E = 200e9", "e = 200e9\nE = 200e9"), "material.e", ["unknown key", "'E'", "density"]),
    (("E = 200e9\n", ""), "material.E", ["missing", "Young's modulus, Pa"]),
    (("density = 8000", "density = -1"), "material.density", ["must be > 0"]),
    (("density = 8000", "density = 8000\npoisson = 0.5"), "material.poisson", ["must be < 0.5"]),
    (
        ("density = 8000", 'density = 8000\nmass_matrix = "diagonal"'),
        "material.mass_matrix",
        ["found 'diagonal'", "'consistent' or 'lumped'"],
    ),
    (
        ("[section]", "[material.regions.linaer]\nE = 1e9\n[section]"),
        "material.regions.linaer",
        ["no such region", "did you mean 'linear'", "'joint', 'linear', 'second', 'third'"],
    ),
    (
        ("[section]", "[material.regions.linear]\nE = -1.0\n[section]"),
        "material.regions.linear.E",
        ["must be > 0"],
    ),
    (
        ("[section]", "[material.regions.linear]\ndensty = 1.0\n[section]"),
        "material.regions.linear.densty",
        ["unknown key", "'density'"],
    ),
    (
        ("[section]", "[material.regions.linear]\n[section]"),
        "material.regions.linear",
        ["empty", "E or density"],
    ),
    (
        ("[support]", "[section.regions]\nall = {width = 0.1}\njoint = {width = 0.2}\n[support]"),
        "section.regions.joint",
        ["width", "'all'", "share elements"],
    ),
    (("width = 0.05", "width = 0.0"), "section.width", ["must be > 0"]),
    (("thickness = 0.01", "thickness = inf"), "section.thickness", ["must be finite"]),
    (('file = "bar.msh"', 'file = "none.msh"'), "mesh.file", ["none.msh", "no such"]),
    (('file = "bar.msh"', 'file = "force.csv"'), "mesh.file", ["force.csv"]),
    (('file = "bar.msh"', f'file = "{"x" * 5000}"'), "mesh.file", ["cannot be read"]),
    (('file = "bar.msh"', 'file = "a\\u0000b"'), "mesh.file", ["must be the name of a file"]),
    (('file = "bar.msh"', 'file = "bar.msh"\nscale = 0'), "mesh.scale", ["must be > 0"]),
    (('[mesh]\nfile = "bar.msh"\n', ""), "mesh", ["missing"]),
    (('[mesh]\nfile = "bar.msh"', 'mesh = "bar.msh"'), "mesh", ["must be a table"]),
    (('fixed = ["fixed"]', "fixed = []"), "support.fixed", ["free body"]),
    (("[support]\n", "[supports]\n"), "supports", ["unknown key", "did you mean 'support'"]),
    (('fixed = ["fixed"]', 'fixed = "fixed"'), "support.fixed", ["must be a list"]),
    (
        ('fixed = ["fixed"]', 'fixed = ["joint"]'),
        "support.fixed[0]",
        ["a region; a point is needed", "'fixed', 'free_end', 'junction', 'middle'"],
    ),
    (('fixed = ["fixed"]', 'fixed = ["fixed", "fixed"]'), "support.fixed", ["more than once"]),
    (
        ('region = "joint"', 'region = "junction"'),
        "joint[0].region",
        ["a point; a region is needed", "'joint', 'linear'"],
    ),
    (('region = "joint"\n', ""), "joint[0].region", ["missing"]),
    (("[[joint]]", "[joint]"), "joint", ["must be a list of tables", "[[joint]]"]),
    (("pressure = 50e6", "pressure = -50e6"), "joint[0].pressure", ["must be >= 0"]),
    (("pressure = 50e6", 'pressure = "high"'), "joint[0].pressure", ["'high'", "positions"]),
    (
        ("pressure = 50e6", "pressure = {positions = [0, 0.1], values = [1e6, -1e6]}"),
        "joint[0].pressure.values[1]",
        ["must be >= 0"],
    ),
    (
        ("pressure = 50e6", "pressure = {positions = [0.0, 0.1, 0.1], values = [1, 2, 3]}"),
        "joint[0].pressure.positions[2]",
        ["found 0.1", "must be > 0.1"],
    ),
    (
        ("pressure = 50e6", "pressure = {positions = [0.0, 0.1], values = [1, 2, 3]}"),
        "joint[0].pressure.values",
        ["found 3 values", "2 positions"],
    ),
    (
        ("pressure = 50e6", "pressure = {positions = [0.0, 0.09], values = [1, 2]}"),
        "joint[0].pressure.positions",
        ["must cover the joint", "0 to 0.1"],
    ),
    (
        ("pressure = 50e6", "pressure = {positions = [0.0], values = [1, 2]}"),
        "joint[0].pressure.positions",
        ["2 or more"],
    ),
    (
        ("pressure = 50e6", "pressure = {position = [0.0, 1], values = [1, 2]}"),
        "joint[0].pressure.position",
        ["unknown key", "did you mean 'positions'"],
    ),
    (("friction = 0.7", "friction = -0.1"), "joint[0].friction", ["must be >= 0"]),
    (("friction = 0.7", 'friction = 0.7\nlaw = "tanh"'), "joint[0].law", ["arctan", "coulomb"]),
    (("friction = 0.7", "friction = 0.7\nbeta = 0"), "joint[0].beta", ["must be > 0"]),
    (
        ("friction = 0.7", 'friction = 0.7\nlaw = "coulomb"\nbeta = 1e5'),
        "joint[0].beta",
        ["found 100000", "'coulomb'"],
    ),
    (
        ("friction = 0.7", 'friction = 0.7\nnormal_force = "even"'),
        "joint[0].normal_force",
        ["'consistent' or 'equal'"],
    ),
    (
        ("[[load]]", '[[joint]]\nregion = "all"\npressure = 1\nfriction = 1\n[[load]]'),
        "joint[1].region",
        ["shares 10 elements", "joint[0]"],
    ),
    (
        (
            "[[load]]",
            '[[joint]]\nregion = "linear"\npressure = 1\nfriction = 1\nbeta = 9\n[[load]]',
        ),
        "joint[1].beta",
        ["found 9.0", "must be 100000.0 as in joint[0]"],
    ),
    (("[[load]]", "[damping]\nstiffness = -1e-5\n[[load]]"), "damping.stiffness", ["must be >= 0"]),
    (("[[load]]", "[damping]\nmass = nan\n[[load]]"), "damping.mass", ["must be finite"]),
    (("[[load]]", "[load]"), "load", ["must be a list of tables", "[[load]]"]),
    (
        ('on = "free_end"', 'on = "fre_end"'),
        "load[0].on",
        [
            "no such point or region",
            "'fixed', 'free_end', 'junction', 'middle'",
            "'all', 'joint', 'linear', 'second', 'third'",
            "did you mean 'free_end'",
        ],
    ),
    (('on = "free_end"', 'on = "linaer"'), "load[0].on", ["did you mean 'linear'"]),
    (('on = "free_end"', 'on = "fixed"'), "load[0].on", ["support", "'free_end'"]),
    (("frequency = 500.0", "frequency = -5"), "load[0].frequency", ["found -5, must be > 0"]),
    (("frequency = 500.0", "frequncy = 500"), "load[0].frequncy", ["did you mean 'frequency'"]),
    (("amplitude = 87.5e3", "amplitude = nan"), "load[0].amplitude", ["must be finite"]),
    (("amplitude = 87.5e3\n", ""), "load[0].amplitude", ["missing", "N"]),
    (('kind = "harmonic"', 'kind = "harmonics"'), "load[0].kind", ["'harmonic'", "'versine'"]),
    (('kind = "harmonic"\n', ""), "load[0].kind", ["missing", "'harmonic'", "'ramp_and_hold'"]),
    (load_text("multi_harmonic", "components = []"), "load[0].components", ["1 or more"]),
    (
        load_text("multi_harmonic", "components = [{amplitude = 1, frequency = 0}]"),
        "load[0].components[0].frequency",
        ["must be > 0"],
    ),
    (
        load_text("multi_harmonic", "components = [{amplitude = 1, frequency = 1, on = 2}]"),
        "load[0].components[0].on",
        ["unknown key", "amplitude, frequency, phase"],
    ),
    (load_text("triangle", "peak = 1\nrise_time = 0"), "load[0].rise_time", ["must be > 0"]),
    (
        load_text("versine", "peak = 1\nrise_time = 1\nstart = -1"),
        "load[0].start",
        ["must be >= 0"],
    ),
    (
        load_text("half_sine", "peak = 1\nrise_time = 1\nfrequency = 4"),
        "load[0].frequency",
        ["unknown key", "on, kind, peak, rise_time, start"],
    ),
    (load_text("rectangle", "peak = 1\nduration = -1"), "load[0].duration", ["must be > 0"]),
    (load_text("table", 'file = "none.csv"'), "load[0].file", ["none.csv", "cannot be read"]),
    (load_text("table", 'file = "back.csv"'), "load[0].file", ["back.csv", "line 3", "> 1"]),
    (load_text("triangle", "peak = 1\nrise_time = 1"), "time.cycles", ["no common period"]),
    (
        load_text(
            "multi_harmonic",
            "components = [{amplitude = 1, frequency = 1}, {amplitude = 1, frequency = 1.414213}]",
        ),
        "time.cycles",
        ["no common period", "duration and step"],
    ),
    (("cycles = 3", "cycles = 0"), "time.cycles", ["must be >= 1"]),
    (("cycles = 3", "cycles = 2.5"), "time.cycles", ["must be a whole number"]),
    (("cycles = 3", "cycles = 3\nsteps_per_cycle = 3"), "time.steps_per_cycle", [">= 8"]),
    (
        ("cycles = 3", f"cycles = 3\nsteps_per_cycle = 1{400 * '0'}"),
        "time.steps_per_cycle",
        ["<= 1e+09"],
    ),
    (("cycles = 3", "cycles = 3\nrho_infinity = 1.5"), "time.rho_infinity", ["<= 1"]),
    (("cycles = 3", "cycles = 3\nduration = 1"), "time", ["cycles, duration", "either"]),
    (("cycles = 3", "steps_per_cycle = 100"), "time.cycles", ["missing"]),
    (("cycles = 3", ""), "time.cycles", ["missing", "either"]),
    (("cycles = 3", "duration = 1"), "time.step", ["missing beside duration"]),
    (("cycles = 3", "duration = 1\nstep = 0"), "time.step", ["must be > 0"]),
    (("cycles = 3", "duration = -1\nstep = 1"), "time.duration", ["must be > 0"]),
    (("cycles = 3", "duration = 1e-3\nstep = 2e-3"), "time.step", ["<= duration"]),
    (("cycles = 3", "duration = 1e-1\nstep = 6e-4"), "time.step", ["<= 0.00025", "load[0]"]),
    (("cycles = 3", "duration = 1\nstep = 1e-19"), "time", ["at most 1e+09 steps"]),
    (("[time]\ncycles = 3\n", ""), "time", ["missing"]),
    (('run = ["full", "reduced"]', "run = []"), "models.run", ["1 or more"]),
    (('run = ["full", "reduced"]', 'run = ["ful"]'), "models.run[0]", ["'full' or 'reduced'"]),
    (('run = ["full", "reduced"]', 'run = ["full", "full"]'), "models.run", ["more than once"]),
    (
        ('[[joint]]\nregion = "joint"\npressure = 50e6\nfriction = 0.7\n', ""),
        "models.run",
        ["linear scene", "nothing to reduce"],
    ),
    (("modes = 5", "modes = 0"), "reduction.modes", ["must be >= 1"]),
    (
        ("modes = 5", 'active_length = "all"'),
        "reduction.active_length",
        ["'auto', 'estimate'", "length in m"],
    ),
    (
        ("modes = 5", "active_length = [1]"),
        "reduction.active_length",
        ["'auto', 'estimate'", "length in m"],
    ),
    (("modes = 5", "active_length = 0"), "reduction.active_length", ["must be > 0"]),
    (("modes = 5", "active_length = 0.11"), "reduction.active_length", ["<= 0.1", "'joint'"]),
    (
        ("modes = 5", "active_length = {linear = 0.1}"),
        "reduction.active_length.linear",
        ["which is no joint; joints: 'joint'"],
    ),
    (
        ("modes = 5", "active_length = {joint = 0.2}"),
        "reduction.active_length.joint",
        ["<= 0.1"],
    ),
    (("modes = 5", 'reference = "book"'), "reduction.reference", ["'paper' or 'self'"]),
    (("modes = 5", "interface_modes = -1"), "reduction.interface_modes", ["must be >= 0"]),
    (("modes = 5", "interface_modes = 1.5"), "reduction.interface_modes", ["'auto' or a whole"]),
    (("modes = 5", 'beta = "high"'), "reduction.beta", ["'auto' or a steepness"]),
    (("modes = 5", "friction_points = 0"), "reduction.friction_points", ["must be >= 1"]),
    (
        ("modes = 5", 'friction_points = "few"'),
        "reduction.friction_points",
        ["found 'few'", "'auto', 'all' or a whole number"],
    ),
    (("modes = 5", "friction_points = 1.5"), "reduction.friction_points", ["a whole number"]),
    (
        ("modes = 5", 'snapshots = "velocity"'),
        "reduction.snapshots",
        ["found 'velocity'", "'both', 'displacement' or 'rates'"],
    ),
    (("modes = 5", 'inner_product = "energy"'), "reduction.inner_product", ["'mass'"]),
    (("every = 1", "every = 0"), "output.every", ["must be >= 1"]),
    (("every = 1", "vtk = 1"), "output.vtk", ["found 1", "true or false"]),
    (("every = 1", 'shape = "tube"'), "output.shape", ["'swept' or 'line'"]),
    (("every = 1", 'points = ["mid"]'), "output.points[0]", ["did you mean 'middle'"]),
    (("every = 1", 'points = ["fixed"]'), "output.points[0]", ["never moves", "'junction'"]),
    (("every = 1", 'points = ["joint"]'), "output.points[0]", ["a region; a point is needed"]),
    (("every = 1", '"strange key" = 0'), 'output."strange key"', ["unknown key", "vtk, plots"]),
    (('title = "two joints and a plain bar"', "title = 5"), "title", ["must be a text"]),
]


@pytest.mark.parametrize(
    ("change", "key", "words"), BAD, ids=[f"{i}-{key}" for i, (_, key, _) in enumerate(BAD)]
)
def test_mistake_is_named_by_key_with_what_is_allowed(
    scene_file: Callable[..., Path], change: tuple[str, str], key: str, words: list[str]
) -> None:
    problems = problems_of(scene_file(change))
    named = [problem for problem in problems if problem.startswith(f"{key}: ")]
    assert len(named) == 1, problems
    assert all(word in named[0] for word in words), named[0]
    # A renamed table or key is missing under its right name as well; nothing else may be reported.
    others = [problem for problem in problems if problem not in named]
    assert all(": missing, must be given" in problem for problem in others)
    assert len(others) <= 1


def test_the_good_scene_is_right_so_that_each_change_is_the_mistake(
    scene_file: Callable[..., Path],
) -> None:
    scene = load_scene(scene_file())
    assert scene.load[0].to_load() == loads.Harmonic(87.5e3, 500.0)


def test_all_mistakes_are_reported_at_once_each_once(scene_file: Callable[..., Path]) -> None:
    path = scene_file(
        ('file = "bar.msh"', 'file = "bar.msh"\nunit = "m"'),
        ("E = 200e9", "E = -1"),
        ('fixed = ["fixed"]', 'fixed = ["fixd"]'),
        ("pressure = 50e6", "pressure = nan"),
        ("[[load]]", '[[joint]]\nregion = "nowhere"\npressure = 1\nfriction = 1\n[[load]]'),
        ("frequency = 500.0", "frequency = -5"),
        ("[time]", '[[load]]\non = "lost"\nkind = "pulse"\n[time]'),
        ("cycles = 3", "cycles = 3\nstep = 1"),
        ("modes = 5", "modes = 5\nactive_length = {joint = -1, linear = 1}"),
        ("every = 1", 'every = 1\npoints = ["joint"]\n[extra]\n'),
    )
    keys = [problem.split(": ")[0] for problem in problems_of(path)]
    assert sorted(keys) == sorted(
        [
            "mesh.unit",
            "material.E",
            "support.fixed[0]",
            "joint[0].pressure",
            "joint[1].region",
            "load[0].frequency",
            "load[1].kind",
            "time",
            "reduction.active_length.joint",
            "output.points[0]",
            "extra",
        ]
    )


def test_mistakes_between_tables_are_reported_beside_mistakes_in_others(
    scene_file: Callable[..., Path],
) -> None:
    path = scene_file(
        ("E = 200e9", "E = -1"),
        load_text("triangle", "peak = 1\nrise_time = 1e-3"),
        ("modes = 5", "active_length = 1.0"),
        ("every = 1", 'points = ["fixed"]'),
    )
    keys = {problem.split(": ")[0] for problem in problems_of(path)}
    assert keys == {"material.E", "time.cycles", "reduction.active_length", "output.points[0]"}


def test_message_reads_as_file_key_found_allowed(
    scene_file: Callable[..., Path], monkeypatch: pytest.MonkeyPatch
) -> None:
    path = scene_file(("frequency = 500.0", "frequency = -5"))
    monkeypatch.chdir(path.parent)
    with pytest.raises(InputError) as caught:
        load_scene("scene.toml")
    assert str(caught.value) == "scene.toml: load[0].frequency: found -5, must be > 0"


def test_steps_must_resolve_every_harmonic_of_the_common_period(
    scene_file: Callable[..., Path],
) -> None:
    components = "components = [{amplitude = 1, frequency = 10}, {amplitude = 1, frequency = 610}]"
    problems = problems_of(scene_file(load_text("multi_harmonic", components)))
    # Eight steps in each of the 61 periods of the faster one.
    assert problems == [
        "time.steps_per_cycle: found 200, must be >= 488: "
        "a step must not be longer than an eighth of the period of load[0]"
    ]
    enough = ("cycles = 3", "cycles = 3\nsteps_per_cycle = 488")
    assert load_scene(scene_file(load_text("multi_harmonic", components), enough)).n_steps == 1464


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"title = 'a'\n[mesh\n", "line 2"),
        (b"a = 1\na = 2\n", "line 2"),
        (b"title = '''\n\n", "line 3"),
        (b"title = 'a'\n\n# \xff\n", "line 3: not UTF-8"),
        (b"a = " + b"[" * 100_000, "not valid TOML"),
        (b"a = " + b"1" * 10_000, "not valid TOML"),
    ],
)
def test_file_that_is_not_toml_is_refused_with_its_line(
    tmp_path: Path, content: bytes, expected: str
) -> None:
    path = tmp_path / "scene.toml"
    path.write_bytes(content)
    problems = problems_of(path)
    assert len(problems) == 1
    assert expected in problems[0]
    assert re.match(r"line \d+: ", problems[0])


def test_missing_file_folder_and_empty_file_are_refused(tmp_path: Path) -> None:
    assert "cannot be read" in problems_of(tmp_path / "none.toml")[0]
    assert "cannot be read" in problems_of(tmp_path)[0]
    (tmp_path / "empty.toml").write_text("")
    missing = {problem.split(": ")[0] for problem in problems_of(tmp_path / "empty.toml")}
    assert missing == {"mesh", "material", "section", "support", "load", "time"}


def test_defaults_are_those_documented(scene_file: Callable[..., Path]) -> None:
    scene = load_scene(
        scene_file(('[models]\nrun = ["full", "reduced"]\n', ""), ("[output]\nevery = 1\n", ""))
    )
    assert (scene.material.mass_matrix, scene.mesh.scale, scene.time.steps_per_cycle) == (
        "consistent",
        1.0,
        200,
    )
    joint = scene.joint[0]
    assert (joint.law, joint.beta, joint.normal_force) == ("arctan", 1e5, "consistent")
    assert (scene.damping.stiffness, scene.damping.mass, scene.time.rho_infinity) == (0, 0, 1)
    assert scene.models.run == ("full",)
    assert scene.reduction.model_dump() == {
        "modes": 5,
        "active_length": "auto",
        "reference": "paper",
        "interface_modes": "auto",
        "beta": "auto",
        "friction_points": "auto",
        "snapshots": "both",
        "inner_product": "euclidean",
    }
    assert scene.output.model_dump() == {
        "vtk": False,
        "plots": False,
        "every": 1,
        "points": (),
        "frames": 200,
        "shape": "swept",
        "history": True,
    }
    assert set(scene.output_points) == {"junction", "middle", "free_end"}


def test_what_a_scene_may_leave_out_or_give_another_way(scene_file: Callable[..., Path]) -> None:
    linear = load_scene(
        scene_file(
            ('[[joint]]\nregion = "joint"\npressure = 50e6\nfriction = 0.7\n', ""),
            ('run = ["full", "reduced"]', 'run = ["full"]'),
        )
    )
    assert linear.joint == ()
    table = "pressure = {positions = [-1, 0.05, 0.1], values = [0, 5e6, 1]}"
    scene = load_scene(
        scene_file(
            ("[section]", "[material.regions.linear]\nE = 70e9\n[section]"),
            ("[support]", "[section.regions]\nlinear = {width = 0.1, thickness = 1}\n[support]"),
            ("pressure = 50e6", table),
            ("friction = 0.7", 'friction = 0.7\nlaw = "coulomb"'),
            ("modes = 5", "active_length = {joint = 0.1}\ninterface_modes = 0\nbeta = 1e3"),
        )
    )
    assert scene.overrides == {"linear": {"E": 70e9, "width": 0.1, "thickness": 1.0}}
    joint = scene.joint[0].to_joint()
    assert joint.beta == math.inf
    assert joint.pressure(np.array([0.05, 0.075])) == pytest.approx([5e6, 2.5e6 + 0.5])
    assert scene.reduction.active_length == {"joint": 0.1}
    assert (scene.reduction.interface_modes, scene.reduction.beta) == (0, 1e3)


@pytest.mark.parametrize(
    ("key", "text", "value"),
    [
        ("active_length", '"estimate"', "estimate"),
        ("active_length", "0.05", 0.05),
        ("friction_points", '"all"', "all"),
        ("friction_points", "12", 12),
        ("snapshots", '"displacement"', "displacement"),
    ],
)
def test_other_ways_to_reduce_arrive_as_given(
    scene_file: Callable[..., Path], key: str, text: str, value: object
) -> None:
    reduction = load_scene(scene_file(("modes = 5", f"{key} = {text}"))).reduction
    assert reduction.model_dump(exclude_unset=True) == {key: value}


@pytest.mark.parametrize("on", ["linear", "joint", "free_end"])
def test_a_load_may_act_on_a_region_or_on_a_point(scene_file: Callable[..., Path], on: str) -> None:
    scene = load_scene(scene_file(('on = "free_end"', f'on = "{on}"')))
    assert scene.load[0].on == on


@pytest.mark.parametrize(
    ("kind", "keys", "expected"),
    [
        ("harmonic", "amplitude = 2\nfrequency = 3\nphase = 1", loads.Harmonic(2, 3, 1)),
        (
            "multi_harmonic",
            "components = [{amplitude = 2, frequency = 3}, "
            "{amplitude = 1, frequency = 6, phase = -1}]",
            loads.MultiHarmonic((loads.Harmonic(2, 3), loads.Harmonic(1, 6, -1))),
        ),
        ("triangle", "peak = -2\nrise_time = 0.3", loads.Triangle(-2, 0.3)),
        ("half_sine", "peak = 2\nrise_time = 0.3\nstart = 1", loads.HalfSine(2, 0.3, 1)),
        ("versine", "peak = 2\nrise_time = 0.3\nstart = 1", loads.Versine(2, 0.3, 1)),
        ("ramp_and_hold", "peak = 2\nrise_time = 0.3\nstart = 1", loads.RampAndHold(2, 0.3, 1)),
        ("rectangle", "peak = 2\nduration = 0.3\nstart = 1", loads.Rectangle(2, 0.3, 1)),
    ],
)
def test_each_kind_of_load_arrives_with_its_numbers(
    scene_file: Callable[..., Path], kind: str, keys: str, expected: loads.Load
) -> None:
    by_step = ("cycles = 3", "duration = 1.0\nstep = 1e-3")
    scene = load_scene(scene_file(load_text(kind, keys), by_step))
    assert scene.load[0].to_load() == expected
    assert (scene.time_step, scene.n_steps) == (1e-3, 1000)
    assert scene.cycle_period == expected.period


def test_table_is_found_beside_the_scene_from_anywhere(
    scene_file: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = scene_file(
        load_text("table", 'file = "force.csv"'), ("cycles = 3", "duration = 1e-2\nstep = 1e-4")
    )
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    load = load_scene(path).load[0].to_load()
    assert load([0.0, 5e-4, 2e-3]) == pytest.approx([0.0, 2.5e3, 2.5e3])


def test_cycles_count_the_common_period_of_the_loads_beside_an_impulse(
    scene_file: Callable[..., Path],
) -> None:
    more = (
        '[[load]]\non = "junction"\nkind = "harmonic"\namplitude = 1\nfrequency = 750\n'
        '[[load]]\non = "middle"\nkind = "versine"\npeak = 1\nrise_time = 1e-4\n[time]'
    )
    scene = load_scene(scene_file(("[time]", more)))
    assert scene.cycle_period == pytest.approx(1 / 250)
    assert scene.time_step == pytest.approx(1 / 250 / 200)
    assert scene.n_steps == 600


@pytest.mark.parametrize(
    ("duration", "step", "n_steps"),
    [("6e-3", "2e-6", 3000), ("0.3", "0.1", 3), ("1.0", "0.3", 4), ("0.1", "0.1", 1)],
)
def test_steps_cover_the_duration_without_one_too_many(
    scene_file: Callable[..., Path], duration: str, step: str, n_steps: int
) -> None:
    slow = ("frequency = 500.0", "frequency = 0.1")
    given = ("cycles = 3", f"duration = {duration}\nstep = {step}")
    assert load_scene(scene_file(slow, given)).n_steps == n_steps


def test_scene_is_immutable_and_has_its_bar_only_from_a_file(
    scene_file: Callable[..., Path],
) -> None:
    path = scene_file()
    scene = load_scene(path)
    assert scene.path == path
    assert scene.bar.length == pytest.approx(0.6)
    with pytest.raises(ValueError, match="frozen"):
        scene.title = "other"
    in_memory = Scene.model_validate(scene.model_dump(exclude_unset=True))
    assert in_memory.material == scene.material
    with pytest.raises(InputError, match="load_scene"):
        _ = in_memory.bar
    with pytest.raises(InputError, match="load_scene"):
        _ = in_memory.path


@pytest.mark.parametrize(
    ("name", "friction_limit_share", "period", "step", "n_steps", "length", "models"),
    [
        ("lap_joint_reference", 0.9, 1e-3, 5e-6, 600, 0.25, ("full",)),
        ("lap_joint_case_I", 0.5, 5e-4, 2.5e-6, 1600, 0.5, ("full", "reduced")),
        ("structure_harmonic", 0.5, 2e-3, 1e-5, 2400, 0.6, ("full", "reduced")),
        ("structure_impulse", 0.5, None, 2e-6, 3000, 0.6, ("full", "reduced")),
    ],
)
def test_examples_are_the_systems_of_the_paper(
    name: str,
    friction_limit_share: float,
    period: float | None,
    step: float,
    n_steps: int,
    length: float,
    models: tuple[str, ...],
) -> None:
    scene = load_scene(EXAMPLES / f"{name}.toml")
    assert scene.cycle_period == (None if period is None else pytest.approx(period))
    assert scene.time_step == pytest.approx(step)
    assert scene.n_steps == n_steps
    assert scene.models.run == models
    assert scene.bar.length == pytest.approx(length)
    (joint,) = scene.joint
    joint_length = np.diff(scene.bar.mesh.p[0])[scene.bar.regions[joint.region]].sum()
    limit = joint.friction * joint.pressure * scene.section.width * joint_length
    assert scene.load[0].to_load().peak_value == pytest.approx(friction_limit_share * limit)
    # Bar speed 5000 m/s gives the resonances the paper prints.
    assert math.sqrt(scene.material.E / scene.material.density) == pytest.approx(5000)
    assert (joint.beta, joint.normal_force, scene.damping.stiffness) == (1e5, "equal", 1e-5)


def test_every_example_scene_is_one_of_those_tested() -> None:
    struts = {path.stem for path in EXAMPLES.glob("*.toml") if "plate" not in path.stem}
    assert struts == {
        "lap_joint_reference",
        "lap_joint_case_I",
        "structure_harmonic",
        "structure_impulse",
    }
