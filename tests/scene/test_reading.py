"""Scenes read with their meshes: files, names, and structures of every dimension."""

import math
import re
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scene_texts import GOOD, Change, problems_of_file, scene_of, with_changes

from skfem_joint.ground.errors import InputError
from skfem_joint.mesh import build_bar, build_plate, merged, refined, write_mesh
from skfem_joint.scene import load_scene, scene_from

EXAMPLES = Path(__file__).parents[2] / "examples"

Write = Callable[..., Path]
BAR = build_bar(
    [("joint", 0.1, 10), ("linear", 0.3, 6), ("second", 0.1, 5), ("third", 0.1, 5)],
    {"fixed": 0.0, "junction": 0.1, "middle": 0.4, "free_end": 0.6},
)
LOWER = build_plate([("linear", 0.2, 4), ("joint", 0.1, 4)], 0.05, 2, points={"corner": (0.0, 0.0)})
STRIPS = [("upper_joint", 0.1, 4), ("upper_linear", 0.2, 4)]
UPPER = build_plate(
    STRIPS, 0.05, 2, origin=(0.2, 0.0), prefix="upper_", points={"tip": (0.5, 0.025)}
)

PLATES = with_changes(
    GOOD,
    ('"bar.msh"', '["lower.msh", "upper.msh"]'),
    ("density = 8000", "density = 8000\npoisson = 0.3"),
    ("width = 0.05\n", ""),
    ('["fixed"]', '["left"]'),
    ('on = "joint"', 'on = "upper_joint"\nagainst = "joint"'),
    ('on = "free_end"', 'on = "upper_right"\ndirection = [1, 0]'),
    ("[reduction]\nmodes = 5\n[output]\nevery = 1\n", ""),
)


@pytest.fixture
def scene_file(tmp_path):
    """Write a scene with some of its text replaced, beside the meshes of bar and plates."""
    write_mesh(BAR, tmp_path / "bar.msh")
    write_mesh(LOWER, tmp_path / "lower.msh")
    write_mesh(UPPER, tmp_path / "upper.msh")
    (tmp_path / "force.csv").write_text("t,f\n0,0\n1e-3,5e3\n3e-3,0\n")

    def write(*changes, text=GOOD):
        path = tmp_path / "scene.toml"
        path.write_text(with_changes(text, *changes), encoding="utf-8")
        return path

    return write


def test_regions_supports_and_points_reach_the_structure(scene_file):
    scene = load_scene(
        scene_file(
            ('fixed = ["left"]', 'fixed_x = ["left"]\nfixed_y = ["bottom"]'),
            ("thickness = 0.01", 'thickness = 0.01\nplane = "strain"'),
            ("[support]", "[section.regions.joint]\nthickness = 0.02\n[support]"),
            ("[section]", "[material.regions.joint]\npoisson = 0.2\nE = 70e9\n[section]"),
            ("cycles = 3", 'cycles = 3\n[output]\npoints = ["tip", "upper_right"]'),
            text=PLATES,
        )
    )
    structure = scene.structure()
    inside = scene.named_mesh.regions["joint"]
    own = {"E": (70e9, 200e9), "poisson": (0.2, 0.3), "thickness": (0.02, 0.01)}
    for name, (here, elsewhere) in own.items():
        values = structure.body.properties[name]
        assert np.all(values[inside] == here)
        assert np.all(np.delete(values, inside) == elsewhere)
    assert structure.plane == "strain"
    corner = scene.named_mesh.points["corner"]
    assert structure.held[corner].tolist() == [True, True]
    assert scene.output_points == ("tip", "upper_right")
    assert {"tip.x", "upper_right.y"} <= set(scene.system().points)


# What is changed, and words that one of the problems must have.
WRONG: list[tuple[str, Change, list[str]]] = [
    (GOOD, ('fixed = ["fixed"]', 'fixed = ["fixd"]'), ["support.fixed", "did you mean 'fixed'"]),
    (GOOD, ('on = "free_end"', 'on = "free_end"\ndirection = [1, 0]'), ["direction"]),
    (GOOD, ("every = 1", 'points = ["fixed"]'), ["'fixed'", "does not move"]),
    (GOOD, ("[section]", '[section]\nplane = "strain"'), ["section.plane", "a bar has none"]),
    (PLATES, ('fixed = ["left"]', 'fixed_x = ["left"]'), ["unsupported"]),
    (
        *(PLATES, ("cycles = 3", 'cycles = 3\n[reduction]\nreference = "paper"')),
        ["joint[0].axis: missing", "reference = 'static'"],
    ),
]


@pytest.mark.parametrize(("text", "change", "words"), WRONG)
def test_what_only_the_mesh_can_tell_is_refused_under_the_scenes_name(
    scene_file, text, change, words
):
    problems = problems_of_file(scene_file(change, text=text))
    assert len(problems) == (2 if "unsupported" in words else 1)  # each of two plates is
    assert all(word in problem for word in words for problem in problems), problems


def test_mistakes_of_tables_mesh_and_structure_are_reported_together(scene_file):
    path = scene_file(
        ('fixed = ["left"]', 'fixed = ["lft"]'),
        ('against = "joint"', 'against = "nowhere"'),
        ("cycles = 3", "cycles = 0"),
        text=PLATES,
    )
    problems = problems_of_file(path)
    assert len(problems) == 3
    for word in ("'lft'", "'nowhere'", "time.cycles: found 0, must be >= 1"):
        assert sum(word in problem for problem in problems) == 1
    # Nothing is said of the structure where a table it is made from is wrong.
    (problem,) = problems_of_file(scene_file(("E = 200e9", "E = 0"), ('["fixed"]', '["fixd"]')))
    assert problem == "material.E: found 0, must be > 0 (Young's modulus, Pa)"
    # And nothing of the system where its loads are.
    path = scene_file(("frequency = 500.0", "frequency = 0"), ('["fixed"]', '["f"]'))
    keys = [problem.split(": ")[0] for problem in problems_of_file(path)]
    assert keys == ["load[0].frequency", "support.fixed"]


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        (b"title = 'a'\n[mesh\n", "line 2"),
        (b"a = 1\na = 2\n", "line 2"),
        (b"title = '''\n\n", "line 3"),
        (b"title = 'a'\n\n# \xff\n", "line 3: not UTF-8"),
        (b"a = " + b"[" * 100_000, "not valid TOML"),
        (b"a = " + b"1" * 10_000, "not valid TOML"),
        (b'[mesh]\nfile = "C:\\Users\\me\\lap.msh"\n', "line 2: .* forward slashes"),
        (b'[mesh]\nfile = "meshes\\lap.msh"\n', "line 2: .* forward slashes"),
        (b'title = "\\U00110000"\n', "line 1: .* forward slashes"),
        (b"a = 1\nfriction = 0,7\n", "line 2: .* a decimal point, not a comma"),
        (b"\n\nx" + b".x" * 20_000 + b" = 1", "line 3: not valid TOML: a key of more than"),
    ],
)
def test_file_that_is_not_toml_is_refused_with_its_line(tmp_path, content, expected):
    path = tmp_path / "scene.toml"
    path.write_bytes(content)
    (problem,) = problems_of_file(path)
    assert re.search(expected, problem)
    assert ("forward slashes" in problem) == (b"\\" in content)
    assert re.match(r"line \d+: ", problem)


@pytest.mark.parametrize("name", ["C:\\temp\\new.msh", "meshes\\new.msh", "a\\b"])
def test_escapes_in_a_path_are_no_missing_file(scene_file, name):
    """\\t, \\n and \\b are valid in double quotes; in single quotes a path is as it is written."""
    path = scene_file(('file = "', f'file = "{name}" #'))
    said = [p for p in problems_of_file(path) if p.startswith("mesh.file: ")]
    assert len(said) == 1
    assert "must be the name of a file; a backslash in double quotes" in said[0]
    path = scene_file(('file = "', f"file = '{name}' #"))
    said = [p for p in problems_of_file(path) if p.startswith("mesh.file: ")]
    assert name in said[0]
    assert "no such mesh file" in said[0]


def test_missing_file_folder_large_and_empty_file_are_refused(tmp_path):
    assert "cannot be read" in problems_of_file(tmp_path / "none.toml")[0]
    assert "cannot be read" in problems_of_file(tmp_path)[0]
    (tmp_path / "large.toml").write_bytes(b"#" * (2**20 + 1))
    assert "at most 1048576" in problems_of_file(tmp_path / "large.toml")[0]
    (tmp_path / "empty.toml").write_text("")
    missing = {problem.split(": ")[0] for problem in problems_of_file(tmp_path / "empty.toml")}
    assert missing == {"mesh", "material", "load", "time"}


def test_a_scene_from_memory_is_that_of_the_file(scene_file):
    path = scene_file()
    path.write_bytes(b"\xef\xbb\xbf" + path.read_bytes())  # as some editors mark UTF-8
    from_file = load_scene(path)
    tables = tomllib.loads(GOOD)
    del tables["mesh"]
    in_memory = scene_from(tables, BAR)
    assert in_memory.named_mesh is BAR
    one, other = in_memory.system(), from_file.system()
    for a, b in ((one.M, other.M), (one.C, other.C), (one.K, other.K)):
        assert abs(a - b).max() == 0.0
    assert abs(one.contact.B - other.contact.B).max() == 0.0
    with pytest.raises(InputError, match=r"^scene: support.fixed: found 'a'"):
        scene_from(tables | {"support": {"fixed": ["a"]}}, BAR)


def test_what_is_built_follows_what_is_changed():
    scene = scene_of(mesh=BAR)
    structure, system = scene.structure(), scene.system()
    same = scene.changed(time={"cycles": 5}, models={"run": ("full",)})
    assert same.structure() is structure
    assert same.system() is system
    watched = scene.changed(output={"points": ("middle",)})
    assert watched.structure() is structure
    assert watched.system().points != system.points
    exact = scene.changed(joint={"law": "coulomb"})
    assert np.all(np.isinf(exact.system().contact.beta))
    finer = scene.changed(mesh=refined(BAR))
    assert (finer.system().n, scene.system().n) == (2 * system.n, system.n)
    assert finer.changed(time={"cycles": 1}).named_mesh is finer.named_mesh
    copied = scene.model_copy(update={"damping": scene.damping.model_copy(update={"mass": 3.0})})
    assert abs(copied.system().C - 3.0 * system.M).max() == pytest.approx(0.0, abs=1e-12)
    assert (copied.path, copied.named_mesh) == (scene.path, BAR)
    assert scene.system() is system


def test_a_change_reaches_every_key_of_a_scene():
    scene = scene_of(mesh=BAR)
    assert scene.changed(load={"amplitude": 60}).load[0].amplitude == 60.0
    assert scene.changed(load={"amplitude": 60e3}).system().loads[0].amplitude.amplitude == 60e3
    at_keys = scene.changed({"joint[0].friction": 0.8, "load[0].amplitude": 7.0}, title="other")
    changed = at_keys.joint[0].friction, at_keys.load[0].amplitude, at_keys.title
    assert changed == (0.8, 7.0, "other")
    assert at_keys.changed({"title": "third"}).title == "third"
    assert at_keys.changed(title=None).title == ""
    assert scene.changed(joint={"friction": np.float64(0.1)}).joint[0].friction == 0.1
    assert scene.changed(reduction={"modes": np.int64(5)}).reduction.modes == 5
    new = [{"kind": "rectangle", "on": scene.load[0].on, "peak": 5.0, "duration": 0.1}]
    assert scene.changed(load=new, time={"duration": 1.0, "step": 0.01}).load[0].peak == 5.0
    assert scene.changed() == scene


@pytest.mark.parametrize(
    ("first", "then"),
    [
        ({"time": {"duration": 1.0, "step": 1e-5}}, {"time": {"cycles": 2}}),
        ({"time": {"cycles": 2}}, {"time": {"until": "steady"}}),
        ({"time": {"until": "steady"}}, {"time": {"duration": 1.0, "step": 1e-5}}),
        ({"damping": {"stiffness": 1e-5, "mass": 2.0}}, {"damping": {"ratio": 0.01}}),
        ({"damping": {"ratio": 0.01}}, {"damping": {"mass": 2.0}}),
        ({"joint": {"beta": 1e4}}, {"joint": {"law": "coulomb"}}),
        ({"joint": {"law": "coulomb"}}, {"joint": {"beta": 1e4}}),
    ],
)
def test_a_change_leaves_out_what_it_excludes(first, then):
    (name,) = then
    table = getattr(scene_of(mesh=BAR).changed(**first).changed(**then), name)
    table = table[0] if isinstance(table, tuple) else table
    assert table.model_fields_set >= then[name].keys()
    assert not table.model_fields_set & first[name].keys()


@pytest.mark.parametrize(
    ("values", "problem"),
    [
        ({"joint": {"frction": 0.3}}, "joint[0].frction: unknown key; did you mean 'friction'?"),
        ({"time": {"cycle": 3}}, "time.cycle: unknown key; did you mean 'cycles'?; allowed: cy"),
        ({"loads": {"amplitude": 1.0}}, "loads: unknown key; did you mean 'load'?; allowed: ti"),
        ({"loda[0].amplitude": 1.0}, "loda: unknown key; did you mean 'load'?; allowed: title"),
        ({"joint[7].friction": 0.3}, "joint[7].friction: the scene has no joint[7]"),
        ({"joint[0].friction": -1.0}, "joint[0].friction: found -1.0, must be >= 0"),
        ({"joint": {"friction": "0.3"}}, "joint[0].friction: found '0.3', must be a number"),
        ({"joint": [{"friction": 0.3}]}, "joint[0].on: missing, must be given"),
        ({"load": 5}, "load: found 5, must be a list of tables, each under [[load]]"),
        ({"time": {"cycles": 2, "duration": 1.0}}, "time: found cycles, duration"),
        ({"models": {"run": ["reduced"]}, "joint": []}, "models.run: found 'reduced' in a scene"),
        ({"mesh.file": "other.msh"}, "mesh: is changed by mesh = a NamedMesh"),
    ],
)
def test_a_change_is_checked_as_a_file_is(values, problem):
    with pytest.raises(InputError, match=f"^changed: {re.escape(problem)}"):
        scene_of(mesh=BAR).changed(values)
    if all(name.isidentifier() for name in values):
        with pytest.raises(InputError, match=f"^changed: {re.escape(problem)}"):
            scene_of(mesh=BAR).changed(**values)


@pytest.mark.parametrize("wrong", [{"values": 5}, {"values": {3: 1.0}}, {"mesh": 5}])
def test_a_change_is_a_mapping_or_a_mesh(wrong):
    values = wrong.pop("values", None)
    with pytest.raises(InputError, match=r"^changed: .*must be a"):
        scene_of(mesh=BAR).changed(values, **wrong)


@pytest.mark.parametrize(
    ("name", "share", "step", "n_steps", "length"),
    [
        ("lap_joint_reference", 0.9, 5e-6, 600, 0.25),
        ("lap_joint_case_I", 0.5, 2.5e-6, 1600, 0.5),
        ("structure_harmonic", 0.5, 1e-5, 2400, 0.6),
        ("structure_impulse", 0.5, 2e-6, 3000, 0.6),
    ],
)
def test_examples_are_the_systems_of_the_paper(name, share, step, n_steps, length):
    scene = load_scene(EXAMPLES / f"{name}.toml")
    assert (scene.time_step, scene.n_steps) == (pytest.approx(step), n_steps)
    assert scene.named_mesh.size == pytest.approx(length)
    limit = scene.system().contact.w.sum()  # of friction; the load is a share of it
    assert scene.loads()[0].amplitude.peak_value == pytest.approx(share * limit)
    # Bar speed 5000 m/s gives the resonances the paper prints.
    assert math.sqrt(scene.material.E / scene.material.density) == pytest.approx(5000)
    (joint,) = scene.joint
    assert (joint.beta, joint.normal_force, scene.damping.stiffness) == (1e5, "equal", 1e-5)
    if name == "lap_joint_case_I":
        assert (scene.reduction.reference, scene.reduction.modes) == ("paper", 5)


def test_mistakes_of_tables_and_loads_cost_no_preload(tmp_path):
    """So does what a command refuses; each is known from the tables and the mesh alone."""
    sides = {"face": "bottom", "head": "top", "right": "right"}
    upper = build_plate([("u", 0.1, 4)], 0.01, 2, origin=(0.0, 0.01), boundaries=sides)
    sides = {"lower_face": "top", "nut": "bottom", "lower_left": "left"}
    lower = build_plate([("l", 0.1, 4)], 0.01, 2, boundaries=sides)
    write_mesh(merged([upper, lower]), tmp_path / "bolted.msh")
    text = with_changes(
        PLATES,
        ('["lower.msh", "upper.msh"]', '"bolted.msh"'),
        ('["left"]', '["lower_left"]'),
        ('on = "upper_joint"\nagainst = "joint"', 'on = "face"\nagainst = "lower_face"'),
        ("pressure = 50e6", 'pressure = "preload"'),
        ('on = "upper_right"', 'on = "right"'),
        ("[[load]]", '[[bolt]]\nhead = "head"\nnut = "nut"\nforce = 1e4\n[[load]]'),
    )
    told: list[Any] = []

    def loaded(*changes, **options):
        path = tmp_path / "scene.toml"
        path.write_text(with_changes(text, *changes))
        return load_scene(path, progress=lambda *news: told.append(news), **options)

    for change, says in (
        (('on = "right"', 'on = "rihgt"'), "load on 'rihgt'"),
        (("cycles = 3", "cycles = 0"), r"time\.cycles"),
    ):
        with pytest.raises(InputError, match=says):
            loaded(change)

    def refuse(scene):
        raise InputError(f"this command takes no {scene.bolt[0].head}")

    with pytest.raises(InputError, match="takes no head"):
        loaded(ready=refuse)
    assert told == []
    loaded()
    assert {label for label, *_ in told} == {"preload"}
