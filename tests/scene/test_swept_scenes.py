"""Scenes of a sweep: which there are, and that each is checked as a scene of its own."""

from typing import Any, get_args

import pytest
from scene_texts import written

import skfem_joint as sj
from skfem_joint.scene.sweep_table import SweepTable
from skfem_joint.study.summary import model_summary


@pytest.fixture
def read(tmp_path):
    """Read the good scene with a sweep and other changes."""

    def read(sweep, *changes):
        return sj.load_sweep(written(tmp_path, *changes, more=f"[sweep]\n{sweep}\n"))

    return read


def test_a_product_has_every_value_with_every_other(read):
    swept = read('"joint[0].friction" = [0.3, 0.7]\n"time.cycles" = {from = 1, to = 3, points = 3}')
    values = [(scene.joint[0].friction, scene.time.cycles) for scene in swept.scenes]
    assert values == [(0.3, 1), (0.3, 2), (0.3, 3), (0.7, 1), (0.7, 2), (0.7, 3)]
    assert [tuple(row.values()) for row in swept.values] == values
    assert all(scene.sweep is None for scene in swept.scenes)


def test_a_list_goes_through_all_keys_at_once_even_where_the_scene_leaves_them_out(read):
    by_list = 'combine = "list"\n"load[0].amplitude" = {from = 1, to = 100, points = 3,'
    by_list += ' scale = "log"}\n"damping.mass" = [1, 2, 2]\n"joint[0].law" = ["arctan", '
    by_list += '"coulomb", "coulomb"]'
    swept = read(
        by_list, ("amplitude = 87.5e3\n", ""), ("friction = 0.7", "friction = 0.7\nbeta = 1e5")
    )
    loads: list[Any] = [scene.load[0] for scene in swept.scenes]
    assert [load.amplitude for load in loads] == [1, 10, 100]
    assert [scene.damping.mass for scene in swept.scenes] == [1, 2, 2]
    assert [scene.joint[0].law for scene in swept.scenes] == ["arctan", "coulomb", "coulomb"]


def test_meshes_can_be_swept_and_are_read_once_each(read):
    swept = read('"mesh.scale" = [1.0, 0.5]\n"joint[0].friction" = [0.3, 0.7]')
    meshes = [scene.named_mesh for scene in swept.scenes]
    assert meshes[0] is meshes[1]
    assert meshes[2].mesh.p.max() == pytest.approx(0.5 * meshes[0].mesh.p.max())


@pytest.mark.parametrize(
    ("sweep", "words"),
    [
        ("", ["sweep: must have a key"]),
        ("friction = [0.3]", ["sweep.friction: unknown key", "combine", '"joint[0].friction"']),
        ('"joint[0].friction" = 0.3', ['sweep."joint[0].friction": found 0.3', "a list"]),
        ('"joint[0].friction" = []', ["an empty list"]),
        ('"joint[0].friction" = [1, 1]', ["more than once"]),
        ('"joint[1].friction" = [1, 2]', ["no joint[1]", "and in 1 more"]),
        ('"joint[0].friction.x" = [1]', ["no joint[0].friction.x"]),
        ('"joint[0].frition" = [1]', ["joint[0].frition: unknown key", "'friction'"]),
        ('"joint[0].friction" = [1, -2]', ["joint[0].friction: found -2", "= -2"]),
        ('"joint[0].on" = ["jont"]', ["'jont'", "'joint'"]),
        ('"load[0].frequency" = {from = 1, to = 2}', [".points: missing, must be given"]),
        ('"load[0].frequency" = {from = 1, too = 2, points = 2}', ["too: unknown", "'to'"]),
        ('"load[0].amplitude" = {from = -1, to = 2, points = 2, scale = "log"}', ["ratios"]),
        ('combine = "list"\n"time.cycles" = [1]\n"joint[0].friction" = [1, 2]', ["found 1, 2"]),
        (
            '"time.cycles" = {from = 1, to = 9, points = 400}\n"damping.mass" = {from = 1, to = 2, '
            "points = 400}",
            ["160000 scenes"],
        ),
        ('results = ["peak"]\n"time.cycles" = [1]', ["sweep.results[0]", "'wall_s'"]),
    ],
)
def test_mistakes_name_key_and_value(read, sweep, words):
    with pytest.raises(sj.InputError) as caught:
        read(sweep)
    for word in words:
        assert word in str(caught.value)


def test_each_result_that_can_be_chosen_is_in_the_summary(read):
    scene = read('"time.cycles" = [1]').scenes[0]
    study = sj.run_scene(scene)
    annotation = SweepTable.model_fields["results"].annotation
    names = set(get_args(get_args(annotation)[0]))
    assert len(names) > 10
    assert names <= set(model_summary(study, study.models["reduced"])) | {"active_area_fraction"}
