"""Universal files are read back by pyuff as what was computed."""

from dataclasses import replace

import numpy as np
import pytest
import pyuff
from bodies import STEEL

import skfem_joint as sj

FORCE = 100.0


@pytest.fixture(scope="module")
def made():
    """A plate on a base, its modes and its response to a force on its end."""
    mesh = sj.build_plate([("joint", 0.1, 10), ("arm", 0.1, 5)], 0.02, 2)
    structure = sj.Structure(
        mesh, STEEL, thickness=0.01, fixed=["left"], joints=[sj.Joint("joint", 5e6, 0.3)],
        damping_ratio=0.01,
    )  # fmt: skip
    system = structure.system([sj.Load("right", sj.Harmonic(FORCE, 500.0), (1.0, 0.0))])
    curves = sj.response(sj.reduce(system, frequency=4000.0), np.linspace(1000.0, 8000.0, 5))
    return structure, system, sj.natural_modes(system, 3, joints="stuck"), curves


@pytest.fixture(scope="module")
def sets(made, tmp_path_factory):
    structure, system, modes, curves = made
    path = tmp_path_factory.mktemp("uff") / "model.uff"
    assert sj.write_uff(path, structure, system, modes=modes, curves=curves) == path
    return pyuff.UFF(str(path)).read_sets()


def of(sets, kind):
    return [each for each in sets if each["type"] == kind]


def sets_of(folder, kind, structure, system, **results):
    """Data sets of a kind in a file of what is given."""
    path = sj.write_uff(folder / "a.uff", structure, system, **results)
    return of(pyuff.UFF(str(path)).read_sets(), kind)


def test_nodes_stand_where_they_are_and_elements_have_the_area_of_the_plate(made, sets):
    (nodes,), (elements,) = of(sets, 2411), of(sets, 2412)
    at = np.column_stack([nodes[name] for name in "xyz"])
    assert np.array_equal(at, made[0].positions)
    (quads,) = (each for kind, each in elements.items() if kind == 44)
    corners = np.array([each["nodes_nums"] for each in quads]) - 1
    diagonals = at[corners[:, 2]] - at[corners[:, 0]], at[corners[:, 3]] - at[corners[:, 1]]
    assert 0.5 * np.cross(*diagonals)[:, 2].sum() == pytest.approx(0.2 * 0.02, rel=1e-12)


def test_modes_have_their_frequency_and_unit_modal_mass(made, sets):
    structure, system, modes, _ = made
    shapes = of(sets, 55)
    assert len(shapes) == 3
    for k, shape in enumerate(shapes):
        assert shape["freq"] == pytest.approx(modes.frequencies[k], rel=1e-5)
        written = np.column_stack([shape["r1"], shape["r2"]])
        true = structure.unpacked(system.expand(modes.modes[:, k]))
        assert written == pytest.approx(true, abs=1e-5 * np.abs(true).max())  # of six digits
        assert not np.any(shape["r3"])
        free = structure.T.T @ written.ravel()
        assert free @ system.M @ free == pytest.approx(1.0, rel=1e-4)


def test_responses_are_the_first_harmonic_over_the_force(made, sets):
    (curve,) = made[3]
    (response,) = of(sets, 58)
    found = np.isfinite(curve.column("amplitude")[:, 0])
    assert response["x"] == pytest.approx(curve.column("frequency")[found], rel=1e-5)
    size = np.abs(curve.column("harmonics")[found, 0, 0]) / FORCE
    assert np.abs(response["data"]) == pytest.approx(size, rel=1e-9)
    assert np.angle(response["data"]) == pytest.approx(curve.column("phase")[found, 0], abs=1e-10)
    at = made[0].positions[response["rsp_node"] - 1]
    assert at[0] == pytest.approx(0.2)
    assert (response["rsp_dir"], response["ref_dir"]) == (1, 1)
    assert response["ordinate_axis_units_lab"].strip() == "m"


def test_modes_at_levels_have_their_shape_frequency_and_damping(made, tmp_path):
    structure, system, *_ = made
    (curve,) = sj.backbone(system, levels=4)
    shapes = sets_of(tmp_path, 55, structure, system, backbones=[curve])
    assert [shape["load_case"] for shape in shapes] == [1, 2, 3, 4]
    for k, shape in enumerate(shapes):
        assert shape["mode_n"] == 1
        assert shape["freq"] == pytest.approx(curve.frequency[k], rel=1e-5)
        assert shape["modal_damp_vis"] == pytest.approx(curve.damping_ratio[k], rel=1e-5)
        assert shape["modal_damp_his"] == pytest.approx(curve.losses.loss_factor[k], rel=1e-5)
        written = np.column_stack([shape["r1"], shape["r2"]]).ravel()
        free, state = structure.T.T @ written, curve.states[k]
        assert free @ system.M @ free == pytest.approx(1.0, rel=1e-4)
        along = free * (state @ system.M @ free)
        assert state == pytest.approx(along, abs=1e-5 * np.abs(state).max())
    (other,) = sj.backbone(sj.condense(system), levels=4)
    with pytest.raises(sj.InputError, match=r"backbones: have .* must be of the system"):
        sj.write_uff(tmp_path / "b.uff", structure, system, backbones=[other])


def test_a_bar_is_drawn_by_lines(tmp_path):
    bar = sj.build_bar([("bar", 1.0, 4)], {"wall": 0.0})
    structure = sj.Structure(bar, STEEL, width=0.01, thickness=0.01, fixed=["wall"])
    path = sj.write_uff(tmp_path / "bar.unv", structure, structure.system())
    (lines,) = of(pyuff.UFF(str(path)).read_sets(), 82)
    assert list(lines["nodes"][:6]) == [1, 2, 0, 2, 3, 0]


def test_what_does_not_belong_together_is_refused(made, tmp_path):
    structure, system, modes, curves = made
    with pytest.raises(sj.InputError, match=r"must be '\.uff' or '\.unv'"):
        sj.write_uff(tmp_path / "a.txt", structure, system)
    small = sj.reduce(system, frequency=4000.0)
    with pytest.raises(sj.InputError, match="is not the full model"):
        sj.write_uff(tmp_path / "a.uff", structure, small)
    fewer = sj.natural_modes(small, 2)
    with pytest.raises(sj.InputError, match="must be of the system"):
        sj.write_uff(tmp_path / "a.uff", structure, system, modes=fewer)
    moved = structure.system([sj.Load(base="x", amplitude=sj.Harmonic(1.0, 500.0))])
    with pytest.raises(sj.InputError, match="one force on a part"):
        sj.write_uff(tmp_path / "a.uff", structure, moved, modes=modes, curves=curves)
    assert not [*tmp_path.iterdir()]


def test_directions_have_signs_and_oblique_ones_none(made, tmp_path):
    """A load against x is -1; one between two axes is no direction of the format, 0."""
    structure = made[0]
    for along, number in (((-1.0, 0.0), -1), ((1.0, 1.0), 0)):
        system = structure.system([sj.Load("right", sj.Harmonic(FORCE, 500.0), along)])
        curves = sj.response(sj.reduce(system, frequency=4000.0), np.array([1000.0, 2000.0]))
        (response,) = sets_of(tmp_path, 58, structure, system, curves=curves)
        assert (response["ref_dir"], response["rsp_dir"]) == (number, number)


@pytest.mark.parametrize("turned", [False, True])
def test_points_of_both_bodies_at_a_joint_are_at_their_own_nodes(turned, tmp_path):
    """Both bodies move with one unknown there, and have nodes at one place."""
    bodies = [
        sj.build_plate([(name, 0.1, 4)], 0.01, 1, origin=(0.0, y), boundaries=sides)
        for name, y, sides in (
            ("upper", 0.01, {"contact": "bottom"}),
            ("lower", 0.0, {"face": "top", "base": "bottom"}),
        )
    ]
    mesh = sj.merged(bodies[::-1] if turned else bodies)
    vertices = np.flatnonzero(np.abs(mesh.mesh.p.T - [0.05, 0.01]).sum(axis=1) < 1e-9).tolist()
    both = ["upper", "lower"][:: -1 if turned else 1]
    points = {f"{name} node": vertex for name, vertex in zip(both, vertices, strict=True)}
    joint = sj.Joint("contact", 1e6, 0.5, against="face")
    structure = sj.Structure(
        replace(mesh, points=points), STEEL, thickness=0.01, fixed=["base"], joints=[joint],
        damping_ratio=0.01,
    )  # fmt: skip
    system = structure.system([sj.Load("upper", sj.Harmonic(FORCE, 500.0), (1.0, 0.0))])
    model = sj.reduce(system, 4, frequency=4000.0)
    curves = sj.response(model, [1000.0, 2000.0], steps_per_cycle=64)
    responses = sets_of(tmp_path, 58, structure, system, curves=curves)
    found = [(each["rsp_node"], each["rsp_dir"]) for each in responses]
    nodes = [structure.body.nodes_of(name)[0] + 1 for name in points]
    assert found[1:] == [(node, direction) for node in nodes for direction in (1, 2)]


def test_prisms_are_wedges_of_six_nodes(tmp_path):
    mesh = sj.build_box([("box", 0.1, 2)], (0.02, 0.02), (1, 1), kind="prism")
    structure = sj.Structure(mesh, STEEL, fixed=["left"], order=1)
    (elements,) = sets_of(tmp_path, 2412, structure, structure.system())
    assert {kind for kind in elements if isinstance(kind, int)} == {112}
    assert {len(set(each["nodes_nums"])) for each in elements[112]} == {6}
