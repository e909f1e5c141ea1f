"""Scenes by themselves, without a mesh: what is read, what is refused, and under which key."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
from pydantic import BaseModel
from scene_texts import Change, problems_of, scene_of

from skfem_joint import loads
from skfem_joint.errors import InputError
from skfem_joint.scene import Scene
from skfem_joint.structure import Bolt, Bolts, PressureTable

HARMONIC = 'kind = "harmonic"\namplitude = 87.5e3\nfrequency = 500.0\n'
JOINT = '[[joint]]\non = "joint"\npressure = 50e6\nfriction = 0.7\n'
PRESSURE = "pressure = 50e6"


def load_text(kind: str, keys: str) -> Change:
    """Exchange the good scene's load."""
    return HARMONIC, f'kind = "{kind}"\n{keys}\n'


def bolt(keys: str) -> Change:
    return PRESSURE, f"pressure = {{ bolts = [{{ {keys} }}] }}"


# What is changed, the key that must be named, words that must be said.
BAD: list[tuple[Change, str, list[str]]] = [
    (("E = 200e9", "E = 0"), "material.E", ["found 0", "> 0"]),
    (("E = 200e9", "E = nan"), "material.E", ["found nan", "finite"]),
    (("E = 200e9", "E = 1e21"), "material.E", ["1e+21", "1e+20"]),
    (("E = 200e9", 'E = "200e9"'), "material.E", ["found '200e9'", "a number"]),
    (("E = 200e9", "E = true"), "material.E", ["found true", "a number"]),
    (("E = 200e9", "E = 2024-01-01"), "material.E", ["2024-01-01", "a number"]),
    (("E = 200e9", "e = 200e9\nE = 200e9"), "material.e", ["unknown key", "'E'", "density"]),
    (("E = 200e9\n", ""), "material.E", ["missing", "Young's modulus, Pa"]),
    (("density = 8000", "density = 8e3\npoisson = 0.5"), "material.poisson", ["< 0.5"]),
    (
        ("density = 8000", 'density = 8000\nmass_matrix = "diagonal"'),
        "material.mass_matrix",
        ["found 'diagonal'", "'consistent' or 'lumped'"],
    ),
    (
        ("[section]", "[material.regions.linear]\nE = -1.0\n[section]"),
        "material.regions.linear.E",
        ["> 0"],
    ),
    (
        ("[section]", "[material.regions.linear]\ndensty = 1.0\n[section]"),
        "material.regions.linear.densty",
        ["unknown key", "did you mean 'density'"],
    ),
    (
        ("[section]", "[material.regions.linear]\n[section]"),
        "material.regions.linear",
        ["empty", "E or density or poisson"],
    ),
    (
        ("[support]", '[section.regions."the joint"]\nplane = "strain"\n[support]'),
        'section.regions."the joint".plane',
        ["unknown key", "width, thickness"],
    ),
    (("thickness = 0.01", "thickness = inf"), "section.thickness", ["finite"]),
    (("width = 0.05", 'plane = "flat"'), "section.plane", ["'stress' or 'strain'"]),
    (('file = "bar.msh"', 'file = "a\\u0000b"'), "mesh.file", ["the name of a file"]),
    (('file = "bar.msh"', "file = []"), "mesh.file", ["1 or more"]),
    (('file = "bar.msh"', "file = 5"), "mesh.file", ["found 5", "a text in quotes"]),
    (('file = "bar.msh"', 'file = "bar.msh"\nscale = 0'), "mesh.scale", ["> 0"]),
    (('[mesh]\nfile = "bar.msh"\n', ""), "mesh", ["missing"]),
    (('[mesh]\nfile = "bar.msh"', 'mesh = "bar.msh"'), "mesh", ["a table"]),
    (("[support]\n", "[supports]\n"), "supports", ["unknown key", "did you mean 'support'"]),
    (('fixed = ["fixed"]', 'fixed = "fixed"'), "support.fixed", ["a list"]),
    (('fixed = ["fixed"]', "fixed_z = [1]"), "support.fixed_z[0]", ["a text in quotes"]),
    (('fixed = ["fixed"]', 'fixed = ["fixed", "fixed"]'), "support.fixed", ["more than once"]),
    (('on = "joint"\n', ""), "joint[0].on", ["missing", "region or boundary"]),
    (('on = "joint"', 'on = "joint"\nagainst = 5'), "joint[0].against", ["a text in quotes"]),
    (("[[joint]]", "[joint]"), "joint", ["a list of tables", "[[joint]]"]),
    ((PRESSURE, "pressure = -50e6"), "joint[0].pressure", [">= 0"]),
    ((PRESSURE, 'pressure = "high"'), "joint[0].pressure", ["'high'", "positions", "bolts"]),
    (
        (PRESSURE, "pressure = {positions = [0, 0.1], values = [1e6, -1e6]}"),
        "joint[0].pressure.values[1]",
        [">= 0"],
    ),
    (
        (PRESSURE, "pressure = {positions = [0.0, 0.1, 0.1], values = [1, 2, 3]}"),
        "joint[0].pressure.positions[2]",
        ["found 0.1", "> 0.1"],
    ),
    (
        (PRESSURE, "pressure = {positions = [0.0, 0.1], values = [1, 2, 3]}"),
        "joint[0].pressure.values",
        ["found 3 values", "2 positions"],
    ),
    (
        (PRESSURE, "pressure = {positions = [0, 1], values = [1, 1], reech = 0.01}"),
        "joint[0].pressure.reech",
        ["did you mean 'reach'"],
    ),
    (
        (PRESSURE, "pressure = {positions = [0, 1], values = [1, 1], axis = [1]}"),
        "joint[0].pressure.axis",
        ["a list of 1", "[x, y]"],
    ),
    ((PRESSURE, "pressure = { bolts = [] }"), "joint[0].pressure.bolts", ["1 or more"]),
    (bolt("at = [0.25, 0], force = 1"), "joint[0].pressure.bolts[0].head_radius", ["missing"]),
    (
        bolt("at = [0.25], force = 1, head_radius = 1"),
        "joint[0].pressure.bolts[0].at",
        ["a list of 1"],
    ),
    (
        bolt("at = [0, 0], force = 1, head_radius = 0.01, hole_radius = 0.01"),
        "joint[0].pressure.bolts[0].hole_radius",
        ["found 0.01", "< head_radius, 0.01"],
    ),
    (
        bolt("at = [0, 0], force = 1, head_radius = 1, spreading_angle = 90"),
        "joint[0].pressure.bolts[0].spreading_angle",
        ["found 90", "< 90"],
    ),
    (("friction = 0.7", "friction = -0.1"), "joint[0].friction", [">= 0"]),
    (("friction = 0.7", 'friction = 0.7\nlaw = "tanh"'), "joint[0].law", ["arctan", "coulomb"]),
    (("friction = 0.7", "friction = 0.7\nbeta = 0"), "joint[0].beta", ["> 0"]),
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
    (("friction = 0.7", "friction = 0.7\naxis = [0, 0.0]"), "joint[0].axis", ["nowhere"]),
    (("friction = 0.7", "friction = 0.7\naxis = [1, 0, 0, 0]"), "joint[0].axis", ["a list of 4"]),
    (("[[load]]", "[damping]\nstiffness = -1e-5\n[[load]]"), "damping.stiffness", [">= 0"]),
    (("[[load]]", "[load]"), "load", ["a list of tables", "[[load]]"]),
    (('on = "free_end"', 'on = "free_end"\ndirection = [0, 0]'), "load[0].direction", ["nowhere"]),
    (('on = "free_end"', 'on = "free_end"\ndirection = 1'), "load[0].direction", ["a list"]),
    (("frequency = 500.0", "frequency = -5"), "load[0].frequency", ["found -5, must be > 0"]),
    (("frequency = 500.0", "frequncy = 500"), "load[0].frequncy", ["did you mean 'frequency'"]),
    (("amplitude = 87.5e3", "amplitude = nan"), "load[0].amplitude", ["finite"]),
    (("amplitude = 87.5e3\n", ""), "load[0].amplitude", ["missing", "N"]),
    (('kind = "harmonic"', 'kind = "harmonics"'), "load[0].kind", ["'harmonic'", "'versine'"]),
    (('kind = "harmonic"\n', ""), "load[0].kind", ["missing", "'harmonic'", "'ramp_and_hold'"]),
    (load_text("multi_harmonic", "components = []"), "load[0].components", ["1 or more"]),
    (
        load_text("multi_harmonic", "components = [{amplitude = 1, frequency = 1, on = 2}]"),
        "load[0].components[0].on",
        ["unknown key", "amplitude, frequency, phase"],
    ),
    (load_text("triangle", "peak = 1\nrise_time = 0"), "load[0].rise_time", ["> 0"]),
    (load_text("triangle", "peak = 1"), "load[0].rise_time", ["missing", "half the length"]),
    (load_text("versine", "peak = 1\nrise_time = 1\nstart = -1"), "load[0].start", [">= 0"]),
    (
        load_text("half_sine", "peak = 1\nrise_time = 1\nfrequency = 4"),
        "load[0].frequency",
        ["unknown key", "kind, peak, rise_time, start"],
    ),
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
    (("cycles = 3", "cycles = 0"), "time.cycles", [">= 1"]),
    (("cycles = 3", "cycles = 2.5"), "time.cycles", ["a whole number"]),
    (("cycles = 3", "cycles = 3\nsteps_per_cycle = 3"), "time.steps_per_cycle", [">= 8"]),
    (
        ("cycles = 3", f"cycles = 3\nsteps_per_cycle = 1{400 * '0'}"),
        "time.steps_per_cycle",
        ["<= 1e+09"],
    ),
    (("cycles = 3", "cycles = 3\nrho_infinity = 1.5"), "time.rho_infinity", ["<= 1"]),
    (("cycles = 3", "cycles = 3\nduration = 1"), "time", ["cycles, duration", "either"]),
    (("cycles = 3", "steps_per_cycle = 100"), "time.cycles", ["missing"]),
    (("cycles = 3", "duration = 1"), "time.step", ["missing beside duration"]),
    (("cycles = 3", "duration = 1\nstep = 0"), "time.step", ["> 0"]),
    (("cycles = 3", "duration = 1e-3\nstep = 2e-3"), "time.step", ["<= duration"]),
    (("cycles = 3", "duration = 1e-1\nstep = 6e-4"), "time.step", ["<= 0.00025", "load[0]"]),
    (("cycles = 3", "duration = 1\nstep = 1e-19"), "time", ["at most 1e+09 steps"]),
    (("[time]\ncycles = 3\n", ""), "time", ["missing"]),
    (('run = ["full", "reduced"]', "run = []"), "models.run", ["1 or more"]),
    (('run = ["full", "reduced"]', 'run = ["ful"]'), "models.run[0]", ["'full' or 'reduced'"]),
    (('run = ["full", "reduced"]', 'run = ["full", "full"]'), "models.run", ["more than once"]),
    ((JOINT, ""), "models.run", ["linear scene", "nothing to reduce"]),
    (("modes = 5", "modes = 0"), "reduction.modes", [">= 1"]),
    (("modes = 5", 'modes = "many"'), "reduction.modes", ["'auto' or a whole number >= 1"]),
    (("modes = 5", 'active_length = "all"'), "reduction.active_length", ["'auto', 'estimate'"]),
    (("modes = 5", "active_length = [1]"), "reduction.active_length", ["length in m"]),
    (
        ("modes = 5", "active_length = {linear = 0.1}"),
        "reduction.active_length.linear",
        ["which is no joint; joints: 'joint'"],
    ),
    (
        ("modes = 5", "active_length = {joint = -0.2}"),
        "reduction.active_length.joint",
        ["> 0"],
    ),
    (("modes = 5", 'reference = "book"'), "reduction.reference", ["'self' or 'paper'"]),
    (("modes = 5", "interface_modes = -1"), "reduction.interface_modes", [">= 0"]),
    (("modes = 5", 'beta = "high"'), "reduction.beta", ["'auto' or a steepness"]),
    (("modes = 5", "friction_points = 0"), "reduction.friction_points", [">= 1"]),
    (
        ("modes = 5", 'friction_points = "few"'),
        "reduction.friction_points",
        ["found 'few'", "'auto', 'all' or a whole number"],
    ),
    (
        ("modes = 5", 'snapshots = "velocity"'),
        "reduction.snapshots",
        ["found 'velocity'", "'both', 'displacement' or 'rates'"],
    ),
    (("modes = 5", 'inner_product = "power"'), "reduction.inner_product", ["'mass'", "'energy'"]),
    (("every = 1", "every = 0"), "output.every", [">= 1"]),
    (("every = 1", "vtk = 1"), "output.vtk", ["found 1", "true or false"]),
    (("every = 1", 'shape = "tube"'), "output.shape", ["'swept' or 'flat'"]),
    (("every = 1", 'points = ["a", "a"]'), "output.points", ["more than once"]),
    (("every = 1", '"strange key" = 0'), 'output."strange key"', ["unknown key", "vtk, plots"]),
    (('title = "two joints and a plain bar"', "title = 5"), "title", ["a text"]),
]


@pytest.mark.parametrize(
    ("change", "key", "words"), BAD, ids=[f"{i}-{key}" for i, (_, key, _) in enumerate(BAD)]
)
def test_mistake_is_named_by_key_with_what_is_allowed(
    tmp_path: Path, change: Change, key: str, words: list[str]
) -> None:
    (tmp_path / "back.csv").write_text("0,0\n1,5e3\n0.5,0\n")
    problems = problems_of(change, folder=tmp_path)
    named = [problem for problem in problems if problem.startswith(f"{key}: ")]
    assert len(named) == 1, problems
    assert all(word in named[0] for word in words), named[0]
    # A renamed table or key is missing under its right name as well; nothing else may be reported.
    others = [problem for problem in problems if problem not in named]
    assert all(": missing, must be given" in problem for problem in others)
    assert len(others) <= 1


def test_message_reads_as_file_key_found_allowed() -> None:
    with pytest.raises(InputError) as caught:
        scene_of(("frequency = 500.0", "frequency = -5"))
    assert str(caught.value) == "scene.toml: load[0].frequency: found -5, must be > 0"


def test_all_mistakes_are_reported_at_once_each_once() -> None:
    problems = problems_of(
        ('file = "bar.msh"', 'file = "bar.msh"\nunit = "m"'),
        ("E = 200e9", "E = -1"),
        ('fixed = ["fixed"]', "fixed = [1]"),
        (PRESSURE, "pressure = nan"),
        ("[[load]]", '[[joint]]\non = "nowhere"\npressure = 1\nfriction = 1\nlaw = ""\n[[load]]'),
        ("frequency = 500.0", "frequency = -5"),
        ("[time]", '[[load]]\non = "lost"\nkind = "pulse"\n[time]'),
        ("cycles = 3", "cycles = 3\nstep = 1"),
        ("modes = 5", "modes = 5\nactive_length = {joint = -1, linear = 1}"),
        ("every = 1", 'every = 1\npoints = "joint"\n[extra]\n'),
    )
    assert sorted(problem.split(": ")[0] for problem in problems) == sorted(
        [
            "mesh.unit",
            "material.E",
            "support.fixed[0]",
            "joint[0].pressure",
            "joint[1].law",
            "load[0].frequency",
            "load[1].kind",
            "time",
            "reduction.active_length.joint",
            "output.points",
            "extra",
        ]
    )


def test_mistakes_between_tables_are_reported_beside_mistakes_in_others() -> None:
    problems = problems_of(
        ("E = 200e9", "E = -1"),
        load_text("triangle", "peak = 1\nrise_time = 1e-3"),
        ("modes = 5", "active_length = { other = 1.0 }"),
    )
    keys = {problem.split(": ")[0] for problem in problems}
    assert keys == {"material.E", "time.cycles", "reduction.active_length.other"}


def test_steps_must_resolve_every_harmonic_of_the_common_period() -> None:
    components = "components = [{amplitude = 1, frequency = 10}, {amplitude = 1, frequency = 610}]"
    (problem,) = problems_of(load_text("multi_harmonic", components))
    # Eight steps in each of the 61 periods of the faster one.
    assert problem.startswith("time.steps_per_cycle: found 200, must be >= 488: ")
    enough = ("cycles = 3", "cycles = 3\nsteps_per_cycle = 488")
    assert scene_of(load_text("multi_harmonic", components), enough).n_steps == 1464


def test_defaults_are_those_documented() -> None:
    scene = scene_of(
        ('[models]\nrun = ["full", "reduced"]\n[reduction]\nmodes = 5\n', ""),
        ("[output]\nevery = 1\n", ""),
        ('[support]\nfixed = ["fixed"]\n', ""),
        ("[section]\nwidth = 0.05\nthickness = 0.01\n", ""),
    )
    assert (scene.material.mass_matrix, scene.mesh.scale) == ("consistent", 1.0)
    assert scene.section.model_dump() == {
        "width": None,
        "thickness": None,
        "plane": "stress",
        "regions": {},
    }
    assert set(scene.support.model_dump().values()) == {()}
    joint = scene.joint[0]
    assert (joint.law, joint.beta, joint.normal_force) == ("arctan", 1e5, "consistent")
    assert (joint.against, joint.axis, scene.load[0].direction) == (None, None, None)
    assert (scene.damping.stiffness, scene.damping.mass, scene.time.rho_infinity) == (0, 0, 1)
    assert scene.time.steps_per_cycle == 200
    assert scene.models.run == ("full",)
    assert scene.reduction.model_dump() == {
        "modes": "auto",
        "active_length": "auto",
        "reference": "static",
        "interface_modes": "auto",
        "beta": "auto",
        "friction_points": "auto",
        "snapshots": "both",
        "inner_product": "auto",
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


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("50e6", 50e6),
        ("3", 3.0),
        (
            "{positions = [-1, 0.05, 0.1], values = [0, 5e6, 1]}",
            PressureTable((-1.0, 0.05, 0.1), (0.0, 5e6, 1.0)),
        ),
        (
            "{positions = [0, 1], values = [1, 2], axis = [3, 4]}",
            PressureTable((0.0, 1.0), (1.0, 2.0), (3.0, 4.0)),
        ),
        (
            "{ reach = 0.01, bolts = [{ at = [0.25, 0.025], force = 20e3, head_radius = 0.008, "
            "hole_radius = 0.004, spreading_angle = 25 }] }",
            Bolts((Bolt((0.25, 0.025), 20e3, 0.008, 0.004, 25.0),), 0.01),
        ),
    ],
)
def test_pressure_arrives_as_given(text: str, expected: object) -> None:
    joint = scene_of((PRESSURE, f"pressure = {text}")).joint[0].to_joint()
    assert joint.pressure == expected
    assert (joint.on, joint.beta) == ("joint", 1e5)


def test_coulomb_friction_has_an_infinite_beta() -> None:
    change = ("friction = 0.7", 'friction = 0.7\nlaw = "coulomb"\nagainst = "b"\naxis = [-2, 0]')
    joint = scene_of(change).joint[0].to_joint()
    assert (joint.beta, joint.against, joint.axis) == (math.inf, "b", (-2.0, 0.0))


@pytest.mark.parametrize(
    ("key", "text", "value"),
    [
        ("active_length", '"estimate"', "estimate"),
        ("active_length", "0.05", 0.05),
        ("active_length", "{joint = 0.1}", {"joint": 0.1}),
        ("friction_points", '"all"', "all"),
        ("friction_points", "12", 12),
        ("snapshots", '"displacement"', "displacement"),
        ("interface_modes", "0", 0),
        ("beta", "1e3", 1e3),
        ("modes", '"auto"', "auto"),
    ],
)
def test_other_ways_to_reduce_arrive_as_given(key: str, text: str, value: object) -> None:
    reduction = scene_of(("modes = 5", f"{key} = {text}")).reduction
    assert reduction.model_dump(exclude_unset=True) == {key: value}


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
    kind: str, keys: str, expected: loads.Amplitude
) -> None:
    by_step = ("cycles = 3", "duration = 1.0\nstep = 1e-3")
    for text, direction in (("", None), ("\ndirection = [0, -3e15]", (0.0, -3e15))):
        scene = scene_of(load_text(kind, keys + text), by_step)
        (load,) = scene.loads()
        assert (load.on, load.amplitude, load.direction) == ("free_end", expected, direction)
        assert (scene.time_step, scene.n_steps, scene.cycle_steps) == (1e-3, 1000, None)
        assert scene.cycle_period == expected.period


def test_table_is_found_beside_the_scene_from_anywhere(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "force.csv").write_text("t,f\n0,0\n1e-3,5e3\n3e-3,0\n")
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    table = load_text("table", 'file = "force.csv"')
    scene = scene_of(table, ("cycles = 3", "duration = 1e-2\nstep = 1e-4"), folder=tmp_path)
    assert scene.loads()[0].amplitude([0.0, 5e-4, 2e-3]) == pytest.approx([0.0, 2.5e3, 2.5e3])


def test_cycles_count_the_common_period_of_the_loads_beside_an_impulse() -> None:
    more = (
        '[[load]]\non = "junction"\nkind = "harmonic"\namplitude = 1\nfrequency = 750\n'
        '[[load]]\non = "middle"\nkind = "versine"\npeak = 1\nrise_time = 1e-4\n[time]'
    )
    scene = scene_of(("[time]", more))
    assert scene.cycle_period == pytest.approx(1 / 250)
    assert scene.time_step == pytest.approx(1 / 250 / 200)
    assert (scene.n_steps, scene.cycle_steps) == (600, 200)


@pytest.mark.parametrize(
    ("duration", "step", "n_steps"),
    [("6e-3", "2e-6", 3000), ("0.3", "0.1", 3), ("1.0", "0.3", 4), ("0.1", "0.1", 1)],
)
def test_steps_cover_the_duration_without_one_too_many(
    duration: str, step: str, n_steps: int
) -> None:
    slow = ("frequency = 500.0", "frequency = 0.1")
    assert (
        scene_of(slow, ("cycles = 3", f"duration = {duration}\nstep = {step}")).n_steps == n_steps
    )


def test_scene_is_immutable_and_says_what_it_has_not() -> None:
    scene = scene_of()
    assert scene.path == Path("scene.toml")
    with pytest.raises(ValueError, match="frozen"):
        scene.title = "other"
    in_memory = Scene.model_validate(scene.model_dump(exclude_unset=True))
    assert in_memory.material == scene.material
    for ask in ("path", "named_mesh"):
        with pytest.raises(InputError, match="load_scene"):
            getattr(in_memory, ask)
    with pytest.raises(InputError, match="no mesh"):
        scene.structure()


def test_changed_takes_keys_by_table_and_leaves_the_scene_as_it_is() -> None:
    scene = scene_of()
    other = scene.changed(
        time={"steps_per_cycle": 400}, joint={"law": "coulomb"}, models={"run": ("reduced",)}
    )
    assert (other.n_steps, other.models.run, other.path) == (1200, ("reduced",), scene.path)
    assert other.joint[0].to_joint().beta == math.inf
    assert (scene.n_steps, scene.joint[0].law) == (600, "arctan")


def _tables(model: type[BaseModel]) -> dict[type[BaseModel], None]:
    """A table and all that stand below it."""

    def below(annotation: Any) -> list[type[BaseModel]]:
        if isinstance(annotation, type) and issubclass(annotation, BaseModel):
            return [annotation]
        return [one for part in getattr(annotation, "__args__", ()) for one in below(part)]

    found = {model: None}
    for field in model.model_fields.values():
        for one in below(field.annotation):
            found |= _tables(one)
    return found


def test_every_key_says_what_it_means() -> None:
    tables = list(_tables(Scene))
    assert len(tables) > 20
    for table in tables:
        for name, field in table.model_fields.items():
            assert field.description, f"{table.__name__}.{name}"
    assert all((table.__doc__ or "").strip() for table in tables)
