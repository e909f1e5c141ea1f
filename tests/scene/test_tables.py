"""Scenes by themselves, without a mesh: what is read, what is refused, and under which key."""

import math

import pytest
from scene_texts import problems_of, scene_of

import skfem_joint as sj
from skfem_joint.ground import loads

HARMONIC = 'kind = "harmonic"\namplitude = 87.5e3\nfrequency = 500.0\n'
JOINT = '[[joint]]\non = "joint"\npressure = 50e6\nfriction = 0.7\n'
PRESSURE = "pressure = 50e6"
SINE = "{amplitude = 1, frequency = %r}"


def load(kind: str, keys: str) -> str:
    return f'kind = "{kind}"\n{keys}\n'


def by_position(keys: str) -> str:
    return f"pressure = {{ positions = [0.0, 0.1], {keys} }}"


REDUCED = 'cycles = 3\n[models]\nrun = ["full", "reduced"]\n[reduction]\nmodes = 5\n'
SLOWLY = REDUCED.replace("3", "3\nquasi_static = true", 1)

ON = "joint[0].pressure"
BOLT = f"{ON}.bolts[0]"


def bolt(keys: str) -> str:
    return f"pressure = {{ bolts = [{{ force = 1, {keys} }}] }}"


# By the line that is exchanged: what for, the key that must be named, words that must be said.
BAD: dict[str, list[tuple[str, ...]]] = {
    "E = 200e9": [
        ("E = 1e21", "material.E", "1e+21", "1e+20"),
        ('E = "200e9"', "material.E", "found '200e9'", "a number"),
        ("E = 2024-01-01", "material.E", "2024-01-01", "a number"),
        ("e = 200e9\nE = 200e9", "material.e", "unknown key", "'E'", "density"),
        ("", "material.E", "missing", "Young's modulus, Pa"),
    ],
    "density = 8000": [
        ("density = 8e3\npoisson = 0.5", "material.poisson", "< 0.5"),
        ('density = 8e3\nmass_matrix = "diagonal"', "material.mass_matrix", "or 'lumped'"),
    ],
    "[section]": [
        ("[material.regions.a]\n[section]", "material.regions.a", "empty", "E or density"),
        ("[material.regions.a]\ndensty = 1\n[section]", "material.regions.a.densty", "'density'"),
        ('[section.regions."a b"]\nplane = ""\n[section]', 'section.regions."a b".plane', "width"),
    ],
    "width = 0.05": [('plane = "flat"', "section.plane", "'stress' or 'strain'")],
    'file = "bar.msh"': [
        ('file = "a\\u0000b"', "mesh.file", "the name of a file"),
        ('file = "bar.msh"\norder = true', "mesh.order", "found true, must be 'auto', 1 or 2"),
    ],
    '[mesh]\nfile = "bar.msh"': [('mesh = "bar.msh"', "mesh", "a table"), ("", "mesh", "missing")],
    "[support]\n": [("[supports]\n", "supports", "unknown key", "did you mean 'support'")],
    'fixed = ["fixed"]': [
        ('fixed = "fixed"', "support.fixed", "a list"),
        ('fixed = ["fixed", "fixed"]', "support.fixed", "more than once"),
    ],
    "[[joint]]": [("[joint]", "joint", "a list of tables", "[[joint]]")],
    JOINT: [("", "models.run", "linear scene", "nothing to reduce")],
    "pressure = 50e6": [
        ('pressure = "high"', "joint[0].pressure", "'high'", "positions", "bolts"),
        (by_position("values = [1, 2, 3]"), "joint[0].pressure", "3 values", "2 positions"),
        (by_position("values = [1, 1], reech = 1"), "joint[0].pressure.reech", "'reach'"),
        (by_position("values = [1, 1], axis = [1]"), "joint[0].pressure.axis", "a list of 1"),
        (
            "pressure = { positions = [0, 1, 1], values = [1, 2, 3] }",
            "joint[0].pressure",
            "must be > 1, the one before",
        ),
        ("pressure = { bolts = [] }", "joint[0].pressure.bolts", "1 or more"),
        (bolt("at = [0.25, 0]"), f"{BOLT}.head_radius", "missing"),
        (bolt("at = [0.25], head_radius = 1"), f"{BOLT}.at", "a list of 1"),
        (
            bolt("at = [0, 0], head_radius = 0.01, hole_radius = 0.01"),
            "joint[0].pressure",
            *("bolt at (0.0, 0.0)", "head_radius: found 0.01", "> hole_radius, 0.01"),
        ),
        (bolt("head_radius = 1, spreading_angle = 90"), f"{BOLT}.spreading_angle", "< 90"),
    ],
    "friction = 0.7": [
        ('friction = 0.7\nlaw = "coulomb"\nbeta = 1e5', "joint[0].beta", "100000", "'coulomb'"),
        ('friction = 0.7\nlaw = "arctan"', "joint[0].beta", "missing", "leave law out"),
        ('friction = 0.7\nnormal_force = "even"', "joint[0].normal_force", "or 'equal'"),
        ("friction = 0.7\naxis = [0, 0.0]", "joint[0].axis", "no direction"),
        ("friction = 0.7\naxis = [1, 0, 0, 0]", "joint[0].axis", "a list of 4"),
    ],
    "[[load]]": [
        ("[load]", "load", "a list of tables", "[[load]]"),
        ("[damping]\nratio = 1.0\n[[load]]", "damping.ratio", "< 1"),
        ("[damping]\nratio = 0.1\nmass = 1.0\n[[load]]", "damping.ratio", "mass", "alone"),
    ],
    'on = "free_end"': [
        ('on = "free_end"\ndirection = 1', "load[0].direction", "a list"),
        ("", "load[0].on", "missing", "base = 'x'"),
        ('on = "free_end"\nbase = "x"', "load[0].on", "'free_end' beside base"),
        ('base = "x"\ndirection = [1, 0]', "load[0].direction", "beside base"),
        ('base = "w"', "load[0].base", "'x', 'y' or 'z'"),
    ],
    'kind = "harmonic"': [
        ('kind = "harmonics"', "load[0].kind", "did you mean 'harmonic'", "'versine'"),
        ("", "load[0].kind", "missing", "'harmonic'", "'ramp_and_hold'"),
    ],
    HARMONIC: [
        (
            load("multi_harmonic", "components = [{amplitude = 1, frequency = 1, on = 2}]"),
            "load[0].components[0].on",
            *("unknown key", "amplitude, frequency, phase"),
        ),
        (load("triangle", "peak = 1"), "load[0].rise_time", "missing", "half the length"),
        (load("table", 'file = "none.csv"'), "load[0].file", "none.csv", "cannot be read"),
        (load("table", 'file = "back.csv"'), "load[0].file", "back.csv", "line 3", "> 1"),
        (load("triangle", "peak = 1\nrise_time = 1"), "time.cycles", "no common period"),
        (
            load("multi_harmonic", f"components = [{SINE % 1}, {SINE % math.sqrt(2)}]"),
            "time.cycles",
            *("no common period", "duration and step"),
        ),
    ],
    "cycles = 3": [
        ("cycles = 2.5", "time.cycles", "a whole number"),
        ("cycles = 3\nsteps_per_cycle = 3", "time.steps_per_cycle", ">= 8"),
        (f"cycles = 3\nsteps_per_cycle = 1{400 * '0'}", "time.steps_per_cycle", "<= 1e+09"),
        ("cycles = 3\nrho_infinity = 1.5", "time.rho_infinity", "<= 1"),
        ("cycles = 3\nduration = 1", "time", "cycles, duration", "either"),
        ("steps_per_cycle = 100", "time.cycles", "missing"),
        ("duration = 1", "time.step", "missing beside duration"),
        ("duration = 1e-3\nstep = 2e-3", "time.step", "<= duration"),
        ("duration = 1e-1\nstep = 6e-4", "time.step", "<= 0.00025", "load[0]"),
        ("duration = 1\nstep = 1e-19", "time", "at most 1e+09 steps"),
        ("cycles = 3\nquasi_static = true\nrho_infinity = 0.9", "time.rho_infinity", "found 0.9"),
        ('until = "steady"\nquasi_static = true', "time.until", "'steady' beside quasi_static"),
    ],
    REDUCED: [
        (SLOWLY + 'reference = "paper"\n', "reduction.reference", "'paper' beside time"),
        (
            SLOWLY.replace("modes = 5", "range = {slip = [0.1, 0.5], frequency = [10, 20]}"),
            *("reduction.range", "found beside time.quasi_static"),
        ),
    ],
    'run = ["full", "reduced"]': [('run = ["ful"]', "models.run[0]", "'condensed' or 'reduced'")],
    "modes = 5": [
        ("modes = 0", "reduction.modes", ">= 1"),
        ('modes = "many"', "reduction.modes", "'auto' or a whole number >= 1"),
        ('active_length = "all"', "reduction.active_length", "'auto', 'estimate'"),
        ("active_length = [1]", "reduction.active_length", "length in m"),
        ("active_length = {linear = 0.1}", "reduction.active_length.linear", "joints: 'joint'"),
        ("active_length = {joint = -0.2}", "reduction.active_length.joint", "> 0"),
        ('reference = "book"', "reduction.reference", "'self' or 'paper'"),
        ('beta = "high"', "reduction.beta", "'auto' or a steepness"),
        ('friction_points = "few"', "reduction.friction_points", "'auto', 'all' or a whole"),
        ('snapshots = "velocity"', "reduction.snapshots", "'displacement' or 'rates'"),
        ('inner_product = "power"', "reduction.inner_product", "'mass'", "'energy'"),
    ],
    "every = 1": [
        ("vtk = 1", "output.vtk", "found 1", "true or false"),
        ('"strange key" = 0', 'output."strange key"', "unknown key", "vtk, plots"),
    ],
}


@pytest.mark.parametrize(
    ("change", "key", "words"),
    [((old, new), key, words) for old, rows in BAD.items() for new, key, *words in rows],
)
def test_mistake_is_named_by_key_with_what_is_allowed(tmp_path, change, key, words):
    (tmp_path / "back.csv").write_text("0,0\n1,5e3\n0.5,0\n")
    problems = problems_of(change, folder=tmp_path)
    named = [problem for problem in problems if problem.startswith(f"{key}: ")]
    assert len(named) == 1, problems
    assert all(word in named[0] for word in words), named[0]
    # A renamed table or key is missing under its right name as well; nothing else may be reported.
    others = [problem for problem in problems if problem not in named]
    assert all(": missing, must be given" in problem for problem in others)
    assert len(others) <= 1


def test_mistakes_between_tables_are_reported_beside_mistakes_in_others():
    problems = problems_of(
        ("E = 200e9", "E = -1"),
        (HARMONIC, load("triangle", "peak = 1\nrise_time = 1e-3")),
        ("modes = 5", "active_length = { other = 1.0 }"),
    )
    keys = {problem.split(": ")[0] for problem in problems}
    assert keys == {"material.E", "time.cycles", "reduction.active_length.other"}


def test_steps_must_resolve_every_harmonic_of_the_common_period():
    components = f"components = [{SINE % 10}, {SINE % 610}]"
    sum_of_two = (HARMONIC, load("multi_harmonic", components))
    (problem,) = problems_of(sum_of_two)
    # Eight steps in each of the 61 periods of the faster one.
    assert problem.startswith("time.steps_per_cycle: found 200, must be >= 488: ")
    enough = ("cycles = 3", "cycles = 3\nsteps_per_cycle = 488")
    assert scene_of(sum_of_two, enough).n_steps == 1464


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("50e6", 50e6),
        ("3", 3.0),
        (
            "{positions = [-1, 0.05, 0.1], values = [0, 5e6, 1]}",
            sj.PressureTable((-1.0, 0.05, 0.1), (0.0, 5e6, 1.0)),
        ),
        (
            "{positions = [0, 1], values = [1, 2], axis = [3, 4]}",
            sj.PressureTable((0.0, 1.0), (1.0, 2.0), (3.0, 4.0)),
        ),
        (
            "{ reach = 0.01, bolts = [{ at = [0.25, 0.025], force = 20e3, head_radius = 0.008, "
            "hole_radius = 0.004, spreading_angle = 25 }] }",
            sj.Bolts((sj.Bolt((0.25, 0.025), 20e3, 0.008, 0.004, 25.0),), 0.01),
        ),
    ],
)
def test_a_joint_arrives_as_given(text, expected):
    laws = ("friction = 0.7", 'friction = 0.7\nagainst = "b"\naxis = [-2, 0]')
    joint = scene_of((PRESSURE, f"pressure = {text}"), laws).joint[0].to_joint()
    assert (joint.on, joint.pressure, joint.beta) == ("joint", expected, math.inf)
    assert (joint.against, joint.axis) == ("b", (-2.0, 0.0))


@pytest.mark.parametrize(
    ("keys", "law", "beta"),
    [
        ("", "coulomb", math.inf),
        ('law = "coulomb"', "coulomb", math.inf),
        ("beta = 2e4", "arctan", 2e4),
        ('beta = 2e4\nlaw = "arctan"', "arctan", 2e4),
    ],
)
def test_the_law_is_coulombs_unless_beta_is_given(keys, law, beta):
    scene = scene_of(("friction = 0.7", f"friction = 0.7\n{keys}"))
    assert (scene.joint[0].law, scene.joint[0].to_joint().beta) == (law, beta)


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
        (
            "swept_sine",
            "amplitude = 2\nfirst_frequency = 9\nlast_frequency = 3\nrate = 2",
            loads.SweptSine(2, 9, 3, 2),
        ),
    ],
)
def test_each_kind_of_load_arrives_with_its_numbers(kind, keys, expected):
    by_step = ("cycles = 3", "duration = 1.0\nstep = 1e-3")
    for text, direction in (("", None), ("\ndirection = [0, -3e15]", (0.0, -3e15))):
        scene = scene_of((HARMONIC, load(kind, keys + text)), by_step)
        (arrived,) = scene.loads()
        assert (arrived.on, arrived.amplitude, arrived.direction) == (
            "free_end",
            expected,
            direction,
        )
        assert (scene.time_step, scene.n_steps, scene.cycle_steps) == (1e-3, 1000, None)
        assert scene.cycle_period == expected.period


def test_a_moving_base_and_a_damping_ratio_reach_the_system_and_are_said():
    mesh = sj.build_bar([("joint", 0.1, 4), ("linear", 0.5, 5)], {"fixed": 0.0, "free_end": 0.6})
    by_base = ('on = "free_end"', 'base = "x"')
    scene = scene_of(by_base, ("[time]", "[damping]\nratio = 0.002\n[time]"), mesh=mesh)
    (load,) = scene.system().loads
    assert load.on == "mass_x"
    mass = 0.6 * 0.05 * 0.01 * 8000
    assert load.amplitude.peak_value == pytest.approx(87.5e3 * mass)
    base, ratio = scene.system().notes[:2]
    assert "relative" in base
    assert "C = a M + b K" in ratio


def test_table_is_found_beside_the_scene_from_anywhere(tmp_path):
    (tmp_path / "force.csv").write_text("t,f\n0,0\n1e-3,5e3\n3e-3,0\n")
    table = (HARMONIC, load("table", 'file = "force.csv"'))
    scene = scene_of(table, ("cycles = 3", "duration = 1e-2\nstep = 1e-4"), folder=tmp_path)
    assert scene.loads()[0].amplitude([0.0, 5e-4, 2e-3]) == pytest.approx([0.0, 2.5e3, 2.5e3])


@pytest.mark.parametrize(
    ("duration", "step", "n_steps"),
    [("6e-3", "2e-6", 3000), ("0.3", "0.1", 3), ("1.0", "0.3", 4), ("0.1", "0.1", 1)],
)
def test_steps_cover_the_duration_without_one_too_many(duration, step, n_steps):
    slow = ("frequency = 500.0", "frequency = 0.1")
    scene = scene_of(slow, ("cycles = 3", f"duration = {duration}\nstep = {step}"))
    assert scene.n_steps == n_steps


def test_a_scene_says_what_it_has_not():
    scene = scene_of()
    in_memory = sj.Scene.model_validate(scene.model_dump(exclude_unset=True))
    for ask in ("path", "named_mesh"):
        with pytest.raises(sj.InputError, match="load_scene"):
            getattr(in_memory, ask)
    with pytest.raises(sj.InputError, match="no mesh"):
        scene.structure()
