"""What only the mesh can tell is refused with its key; what looks like a slip is said."""

import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import skfem
from bodies import (
    DENSITY,
    LAP,
    SIDE,
    STEEL,
    E,
    block,
    lap,
    mapped,
    pressed,
    side,
    structure,
    two_bars,
)

import skfem_joint as sj
from skfem_joint.mesh import NamedMesh, named
from skfem_joint.structure import doubts

LOAD = sj.Harmonic(1.0, 1.0)


def problems(*arguments: Any, **changes: Any) -> list[str]:
    with pytest.raises(sj.InputError) as caught:
        structure(*arguments, **changes)
    assert caught.value.exit_status == 2
    return caught.value.problems


def test_every_mistake_is_reported_at_once_by_its_key():
    body = block("tri")
    found = "\n".join(
        problems(
            body,
            [
                pressed("bolt", beta=0.0),
                pressed(friction=-0.1, pressure=-1.0),
                pressed(),
                pressed("rest", against="joint"),
                pressed("corner"),
                pressed("base", against="rest"),
                pressed("top", normal_force="even"),
            ],
            ["wall"],
            fixed_z=["left"],
            material=sj.Material(0.0, np.nan, 0.5),
            thickness=-1.0,
            plane="shell",
            mass="none",
            stiffness_damping=-1.0,
            mass_damping=np.inf,
            regions={"top": {}, "joint": {"colour": 1.0, "E": 0.0}, "nowhere": {}},
        )
    )
    for fragment in (
        "joint 'bolt'.on: found 'bolt', no such name", "beta: found 0.0",
        "friction: found -0.1", "pressure: found -1.0", "overlaps joint 'joint'",
        "belong to the same body",
        "found 'corner', which is a point", "'rest', which is a region; a boundary is needed",
        "normal_force: found 'even'", "support.fixed: found 'wall', no such", "no z direction",
        "material.E: found 0.0", "material.density: found nan", "material.poisson: found 0.5",
        "section.thickness: found -1.0", "plane: found 'shell'", "mass: found 'none'",
        "damping.stiffness", "damping.mass", "regions.top: found 'top', which is a boundary",
        "property: found 'colour'", "regions.joint.E: found 0.0", "regions.nowhere",
    ):  # fmt: skip
        assert fragment in found


def stacked(gap: float = 0.0, n: int = 4, order: int = 1) -> NamedMesh:
    """Solid plates over each other on 0.04 m x 0.03 m, n elements along the upper one's face."""
    boxes = []
    for y, (far, near), strips, sides in (
        (0.0, ("left", "top"), [("low_free", 0.06, 4), ("low", 0.04, 4)], "low"),
        (0.006 + gap, ("right", "bottom"), [("up", 0.04, n), ("up_free", 0.06, 4)], "up"),
    ):
        outer = "bottom" if near == "top" else "top"
        groups = {f"{far}_end": far, f"{sides}_lap": (near, sides), f"{sides}_out": (outer, sides)}
        box = {"origin": (0.06 * (y > 0.0), y, 0.0), "boundaries": groups, "order": order}
        boxes.append(sj.build_box(strips, (0.006, 0.03), (2, 2), **box))
    return sj.merged(boxes)


def grouped(body: NamedMesh, **names: tuple[str, str]) -> NamedMesh:
    """The same mesh with unions of two of its regions or boundaries, by name."""
    mesh = body.mesh
    for name, parts in names.items():
        if parts[0] in body.regions:
            mesh = mesh.with_subdomains({name: np.concatenate([body.regions[n] for n in parts])})
        else:
            both = np.concatenate([body.boundaries[n] for n in parts])
            mesh = mesh.with_boundaries({name: both})
    return replace(body, mesh=mesh)


def under_joints(body: NamedMesh, **boundaries: Any) -> NamedMesh:
    return replace(body, mesh=body.mesh.with_boundaries(boundaries, boundaries_only=False))


LINE, QUAD, HEX = (block(shape) for shape in ("line", "quad", "hex"))
POINTS = named(QUAD.mesh, points={"a": 0, "b": QUAD.mesh.p.shape[1] - 1})
WHOLE = replace(QUAD, mesh=QUAD.mesh.with_subdomains({"all": np.arange(QUAD.n_elements)}))
OWN = {"joint": {"E": 1.0}, "all": {"E": 2.0, "density": 1.0}}
BORDERS = under_joints(
    QUAD, outline=QUAD.mesh.boundary_facets(), inner=np.flatnonzero(QUAD.mesh.f2t[1] >= 0)[:2]
)
NAMELESS = replace(QUAD, points={}, mesh=replace(QUAD.mesh, _boundaries=None, _subdomains=None))
PLATES = sj.merged(
    [
        sj.build_plate([("lower", 0.2, 4)], 0.05, 2, prefix="lower_"),
        sj.build_plate([("upper", 0.2, 4)], 0.05, 2, prefix="upper_", origin=(0.1, 0.0)),
    ]
)
LAPPED = sj.Joint("upper", 1e6, 0.5, "lower")
BARS = [sj.build_bar([(n, 0.2, 4)], {f"{n} end": 0.2}, origin=(x, 0, 0))
        for n, x in (("bar", 0.0), ("far", 0.3))]  # fmt: skip
EDGES = side()
UPPER = np.isin(np.arange(EDGES.mesh.nvertices), EDGES.mesh.t[:, EDGES.body == 1])
LIFTED = mapped(EDGES, lambda p: p + 0.02 * np.outer([0.0, 1.0], UPPER))
UNDER_ONE = sj.Bolts((sj.Bolt((0.12, 0.025), 1e3, 0.01),))


def over(*ends: float, axis: Any = None, on: str = "joint") -> dict[str, Any]:
    return {"joints": [pressed(on, pressure=sj.PressureTable(ends, (1e6, 1e6), axis))]}


@pytest.mark.parametrize(
    ("body", "changes", "message"),
    [
        # what each dimension needs
        (LINE, {"width": None}, "section.width: missing, a bar needs it"),
        (LINE, {"thickness": None}, "section.thickness: missing"),
        (LINE, {"order": 2}, "mesh.order: found 2 for a bar"),
        (QUAD, {"thickness": None}, "section.thickness: missing, a plate needs it"),
        (QUAD, {"width": 1.0}, "a plate has none"),
        (HEX, {"thickness": 1.0}, "a solid has none"),
        (QUAD, {"material": sj.Material(1.0, 1.0)}, "material.poisson: missing"),
        (HEX, {"material": sj.Material(1.0, 1.0)}, "material.poisson: missing"),
        (block("tri", 2), {"mass": "lumped"}, "beside elements of second order"),
        (WHOLE, {"regions": OWN}, "found E, which region 'joint' also sets"),
        # names
        (HEX, {"joints": [pressed("joint")]}, "a boundary is needed"),
        (LINE, {"joints": [pressed("right")]}, "is a point; a region is needed"),
        (QUAD, {"joints": [pressed("jonit")]}, "did you mean 'joint'"),
        (QUAD, {"fixed": [3]}, "support.fixed: found 3, must be a name, which is text: '3'"),
        (QUAD, {"joints": [pressed(1)]}, "joint 1.on: found 1, must be a name"),
        (QUAD, {"joints": [pressed("base", against=2)]}, "joint 'base'.against: found 2, must be"),
        (NAMELESS, {"fixed": ["wall"]}, "found 'wall', but nothing .* name Physical Groups"),
        # tables of pressure
        (LINE, over(0.0, 0.3), "positions: found 0 to 0.3 m, must cover the joint"),
        (QUAD, over(0.0, 0.3, axis=(0.0, 1.0)), "found 0 to 0.3 m, must cover the joint"),
        (HEX, over(0.0, 0.3, axis=(1.0, 0.0, 0.0), on="base"), "0.3 m, must cover the joint"),
        (QUAD, over(0.0, 1.0, axis=(1.0, 0.0, 0.0)), "pressure.axis"),
        # what nothing holds
        (LINE, {"fixed": (), "joints": [pressed(friction=0.0)]}, "is left unsupported"),
        (HEX, {"fixed": (), "joints": [pressed("base", friction=0.0)]}, "is left unsupported"),
        (QUAD, {"fixed": ()}, "'joint', 'rest' is left unsupported: it can move or turn freely"),
        (POINTS, {"fixed": ["a"]}, "is left unsupported"),
        (lap(), {"fixed": ["lower_left"], "joints": [replace(LAP, friction=0.0)]},
         "'upper_joint', 'upper_rest' is left unsupported"),
        (lap(), {"fixed": [], "joints": [LAP]}, r"(?s)is left unsupported.*is left unsupported"),
        # faces that are not on each other
        (PLATES, {"fixed": ["lower_left"], "joints": [LAPPED]},
         r"'upper': 6 of its 15 pressed nodes do not overlap with 'lower'; the farthest, at "
         r"\(0.3, 0.*\) m, is about 0.1 m from it"),
        (LIFTED, {"fixed": ["base"], "joints": [SIDE]}, "5 of its 5 pressed nodes do not overlap"),
        (sj.merged(BARS), {"fixed": ["bar end"], "joints": [sj.Joint("far", 1e6, 0.5, "bar")]},
         "do not overlap with 'bar'"),
        # faces that cannot slip
        (BORDERS, {"joints": [pressed("outline")]}, "'outline': it turns by 90 degrees at"),
        (BORDERS, {"joints": [pressed("inner")]}, "runs inside a body"),
        (QUAD, {"joints": [pressed("base", pressure=UNDER_ONE)]}, "bolts press areas"),
        (QUAD, {"joints": [pressed()], "fixed": ["joint"]}, "no free node: all its nodes are supp"),
        (QUAD, {"joints": [pressed("base"), pressed("right")], "fixed": ["top"]},
         r"'right' shares a node, at \(1, 0\)"),
        (lap((4, 3)), {"joints": [LAP], "fixed": ["lower_left"], "fixed_y": ["upper_left"]},
         r"3 of its nodes are supported, .* at \(0.2, 0\)"),
        (grouped(stacked(), both=("low_lap", "up_lap")),
         {"joints": [pressed("up_lap", against="low_lap", pressure="preload")],
          "fixed": ["left_end"], "bolts": [sj.Clamp(6e3, "both", "low_lap")]},
         r"bolt\[0\].head: 'both' holds both faces of an interface"),
    ],
)  # fmt: skip
def test_what_only_the_mesh_can_tell_is_refused(body, changes, message):
    assert re.search(message, "\n".join(problems(body, **changes)))


@pytest.mark.parametrize(
    ("body", "changes", "force"),
    [
        (LINE, {"joints": [pressed()], "fixed": ()}, None),  # friction holds
        (HEX, {"joints": [pressed("base")], "fixed": ()}, None),
        # A point held leaves turning; another one beside it, held across, does not.
        (POINTS, {"fixed": ["a"], "fixed_y": ["b"]}, None),
        # Bolts that press only where both are: the rest of the region is no contact.
        (PLATES, {"joints": [replace(LAPPED, pressure=UNDER_ONE)], "fixed": ["lower_left"]}, 1e3),
        # The body on which another one is pressed may be held: the slip is the whole displacement.
        (lap(), {"joints": [LAP], "fixed": ["lower_left", "lower_joint"]}, 8e6 * 0.1 * 0.05),
    ],
)  # fmt: skip
def test_what_looks_like_it_is_not_refused(body, changes, force):
    some = structure(body, **changes)
    assert force is None or some.patches[0].clamping_force == pytest.approx(force)


@pytest.mark.parametrize(
    ("body", "joint", "fixed"),
    [
        (stacked(), ("low_lap", "up_lap"), "left_end"),
        (stacked(n=3), ("low_lap", "up_lap"), "left_end"),
        (stacked(gap=5e-4), ("low_lap", "up_lap"), "left_end"),
        (side((4, 3)), ("contact", "face"), "lower_left"),
        (lap(), ("lower_joint", "upper_joint"), "lower_left"),
    ],
    ids=["matching", "other mesh", "apart", "edges", "regions"],
)
def test_a_group_that_holds_both_faces_of_an_interface_is_refused(body, joint, fixed):
    """It would press both bodies on a rigid base, with twice the force of the pair."""
    body = grouped(body, both=joint)
    for given in (pressed("both"), pressed(joint[0], against="both")):
        found = "\n".join(problems(body, [given], [fixed]))
        assert re.search(
            r"'both' holds both (faces|parts) of an interface, of the body with", found
        )
        assert len(set(re.findall("the body with the regions '[a-z_]+', '[a-z_]+'", found))) == 2
        assert "belong to the same body" not in found
    basis = skfem.Basis(body.mesh, skfem.ElementVector(body.mesh.elem()))
    with pytest.raises(sj.InputError, match="holds both"):
        sj.contact(basis, "both", pressure=5e6, friction=0.3)
    (patch,) = structure(body, [pressed(joint[0], against=joint[1])], [fixed]).patches
    area = patch.area.sum() + patch.held_area
    assert patch.clamping_force == pytest.approx(8e6 * area)


def test_a_group_of_two_bodies_on_one_base_is_none_of_both_faces():
    """Blocks beside each other, which touch, share their base; so do two feet of one group."""
    left, right = (
        sj.build_box([(name, 0.1, 3)], (0.03, 0.03), (2, 2), origin=(x, 0.0, 0.0),
                     boundaries={f"{name}_foot": "bottom", f"{name}_top": "top"})
        for name, x in (("a", 0.0), ("b", 0.1))
    )  # fmt: skip
    body = grouped(sj.merged([left, right]), feet=("a_foot", "b_foot"))
    (patch,) = structure(body, [pressed("feet", pressure=1e6)], []).patches
    assert patch.clamping_force == pytest.approx(1e6 * 0.2 * 0.03)


HELD = structure(
    under_joints(block("quad", n=2), middle=lambda x: x[0] == 0.5),
    fixed=["left"], fixed_y=["joint", "rest"],
)  # fmt: skip
PRESSURE = {"quantity": "pressure"}


@pytest.mark.parametrize(
    ("load", "message"),
    [
        (sj.Load("nose", LOAD, (1, 0)),
         "load on 'nose': found 'nose', no such name in the mesh; a region or boundary or point"),
        (sj.Load(4, LOAD, (1, 0)), "load on 4: found 4, must be a name"),
        (sj.Load("right", LOAD, (0, 0)), r"direction: found \[0, 0\], must be 2 finite numbers"),
        (sj.Load("top", LOAD), r"direction: missing, .* as 2 numbers, e\.g\. \[1\.0, 0\.0\]"),
        (sj.Load("top", LOAD, (1, 0, 0)), r"found \[1, 0, 0\]"),
        (sj.Load("left", LOAD, (1, 0)), "load on 'left': a support holds it"),
        (sj.Load("joint", LOAD, **PRESSURE), "'joint', which is a region; a boundary is"),
        (sj.Load("top", LOAD, (1, 0), **PRESSURE), r"\[1, 0\] beside quantity"),
        (sj.Load("middle", LOAD, **PRESSURE), "it runs inside a body"),
        (sj.Load("left", LOAD, **PRESSURE), "a support holds it along its normal"),
        (sj.Load("top", LOAD, quantity="traction"), "direction: missing"),
        (sj.Load("top", LOAD, quantity="stress"), "'stress', must be one of force, traction"),
        (sj.Load(None, LOAD, base="x", **PRESSURE), "'pressure' beside base"),
        (sj.Load(amplitude=LOAD), "must be one of the two"),
        (sj.Load("corner", LOAD, (1.0, 0.0), base="x"), "must be one of the two"),
        (sj.Load(base="z", amplitude=LOAD), "must be one of x, y"),
        (sj.Load(base="x", amplitude=LOAD, direction=(1.0, 0.0)), "beside base"),
        (sj.Load(base="y", amplitude=LOAD), "a force there does nothing"),
    ],
)  # fmt: skip
def test_loads_that_cannot_act_are_refused_with_points_that_do_not_move(load, message):
    with pytest.raises(sj.InputError, match=message):
        HELD.system([load])
    with pytest.raises(sj.InputError, match="points: found 'tail'"):
        HELD.system(points=["tail"])
    with pytest.raises(sj.InputError, match="points: 'left' is supported and does not move"):
        HELD.system(points=["left"])


def said(joint: sj.Joint, force: float = 1e3, elements: int = 40, **changes: Any) -> list[str]:
    strips = [("joint", 0.1, elements // 2), ("rest", 0.1, 5)]
    body = sj.build_plate(strips, 0.05, elements // 4, order=2)
    some = structure(body, [joint], ["right"], **changes)
    return some.system([sj.Load("left", sj.Harmonic(force, 1.0), (1.0, 0.0))], []).notes


def bolted(at: tuple[float, float]) -> sj.Joint:
    return pressed(pressure=sj.Bolts((sj.Bolt(at, 20e3, 0.009, 0.005),), 0.01))


def test_a_sound_structure_raises_no_doubt():
    assert said(pressed()) == ()
    assert said(bolted((0.05, 0.025))) == ()


@pytest.mark.parametrize(
    ("joint", "changes", "sentence"),
    [
        (pressed(), {"thickness": 1e-5}, "is the mesh in metres"),
        (pressed(), {"thickness": 10.0}, "is the mesh in metres"),
        (pressed(friction=0.0), {}, "Joint 'joint' carries no friction"),
        (bolted((0.003, 0.025)), {}, "of its ring on the joint"),
        (bolted((0.05, 0.025)), {"elements": 8}, "refine the mesh"),
    ],
)
def test_what_looks_wrong_is_said(joint, changes, sentence):
    (found,) = said(joint, **changes)
    assert re.search(sentence, found)


@pytest.mark.parametrize("phase", [0.5 * np.pi, 90.0, -45.0])
def test_a_phase_of_more_than_a_turn_is_questioned(phase):
    made = structure(QUAD, [pressed("joint")], ["left"])
    amplitude = sj.MultiHarmonic([LOAD, sj.Harmonic(1.0, 2.0, phase)])
    notes = made.system([sj.Load("right", amplitude, direction=(1.0, 0.0))]).notes
    assert any("is it in degrees" in note for note in notes) == (abs(phase) > 2.0 * np.pi)


@pytest.mark.parametrize("dim", [1, 2])
@pytest.mark.parametrize(("own", "other"), [(0.02, 0.02), (0.02, 0.01), (0.01, 0.02)])
def test_what_is_wider_than_what_it_is_pressed_on_is_said(dim, own, other):
    """Nothing touches there, and the clamp force is that of all of its own width."""
    if dim == 1:
        made, across = two_bars(), "width"
    else:
        made, across = structure(side(), [SIDE], ["lower_left"]), "thickness"
    parts = {"upper_joint": {across: own}, "lower_joint": {across: other}}
    made = replace(made, regions=parts)
    (joint,), (patch,) = made.joints, made.patches
    assert patch.clamping_force == pytest.approx(joint.pressure * own * (0.2 if dim == 1 else 0.1))
    said = [note for note in made.system().notes if f"is {own:.4g} m wide and pressed" in note]
    assert len(said) == (own > other)


@pytest.mark.parametrize("gap", [0.0, 1e-8, 2e-4])
def test_faces_apart_under_a_pressure_are_said_with_their_distance(gap):
    """Elements are 0.01 m long: further than a tenth of them faces do not meet at all."""
    body, sentence = stacked(gap), f"up to {gap:.3g} m apart on the mesh, {gap:.3g} m in the mean"
    joint = pressed("up_lap", against="low_lap", pressure=5e6)
    some = structure(body, [joint], ["left_end"])
    basis = skfem.Basis(body.mesh, skfem.ElementVector(skfem.ElementHex1()))
    contact = sj.contact(basis, "up_lap", against="low_lap", pressure=5e6, friction=0.3)
    M, K = some.matrices()
    fixed = np.flatnonzero(some.held)
    given = sj.System.from_matrices(M, K, fixed=fixed, contact=contact)
    for notes in (some.system().notes, given.notes):
        assert any(sentence in note for note in notes) == (gap > 1e-6)
    bolted = replace(joint, pressure="preload")
    closed = structure(body, [bolted], ["left_end"], bolts=[sj.Clamp(6e3, "up_out", "low_out")])
    assert not any("apart on the mesh" in note for note in closed.system().notes)


def test_a_structure_takes_the_file_of_its_mesh_and_no_other_thing(tmp_path):
    section = {"width": 0.05, "thickness": 0.01}
    file = Path(__file__).parents[2] / "meshes" / "lap_joint_250mm.msh"
    K = sj.Structure(sj.load_meshes(file), STEEL, **section, free=True).matrices()[1]
    for name in (file, str(file)):
        assert (sj.Structure(name, STEEL, **section, free=True).matrices()[1] != K).nnz == 0
    with pytest.raises(sj.InputError, match=r"nowhere\.msh: no such mesh file"):
        sj.Structure(tmp_path / "nowhere.msh", STEEL, **section)
    with pytest.raises(sj.InputError, match="mesh: found int, must be a mesh of scikit-fem"):
        sj.Structure(3, STEEL, **section)


def test_one_thing_in_place_of_a_list_is_refused_as_such():
    """A name is no list of letters."""
    given = structure(QUAD, [pressed("joint")], ["left"])
    pull = sj.Load("right", sj.Harmonic(1.0, 1.0), direction=(1.0, 0.0))
    for make, words in (
        (lambda: replace(given, fixed="left"), "fixed: found 'left', must be a list"),
        (lambda: replace(given, joints=pressed("joint")), "joints: found one Joint, must be a"),
        (lambda: given.system(pull), "loads: found one Load, must be a list"),
        (lambda: given.system([pull], points="right"), "points: found 'right', must be a list"),
    ):
        with pytest.raises(sj.InputError, match=words):
            make()


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda made: replace(made, material={"E": 1.0}), "material: found dict, must be a Mat"),
        (lambda made: replace(made, joints=[{"on": "joint"}]), "joints: found dict, must be a Jo"),
        (lambda made: made.system([("left", 1.0)]), "loads: found tuple, must be a Load"),
        (lambda made: sj.integrate(made, step=1.0, n_steps=1), "system: found Structure, must be"),
        *((take, "system: found Structure, must be a System")
          for take in (sj.reduce, sj.condense, sj.natural_modes, sj.backbone)),
        (lambda made: sj.response(made, [1.0]), "system: found Structure, must be a System"),
        (lambda _: sj.MultiHarmonic([1.0]), "components: found float, must be a Harmonic"),
        (lambda made: sj.System.from_matrices(*made.matrices(), loads=[("a", 1)]),
         "loads: found list, must be a Mapping"),
        (lambda made: sj.integrate(made.system(), step=1.0, n_steps=1, save=True),
         "save: found bool, must be a Save"),
    ],
)  # fmt: skip
def test_one_kind_of_thing_in_place_of_another_is_refused_by_its_name(make, words):
    with pytest.raises(sj.InputError, match=words):
        make(structure(QUAD, [pressed("joint")], ["left"]))


@pytest.mark.parametrize("plane", ["stress", "strain"])
def test_elements_that_keep_their_volume_are_said_to_be_too_stiff(plane):
    """A cantilever of second order has Euler's frequency but where its volume cannot change."""
    length, height = 0.3, 0.02
    mesh = sj.build_plate([("bar", length, 15)], height, 1, kind="triangle", order=2)
    euler = 1.8751**2 / (2.0 * np.pi * length**2) * height * np.sqrt(E / DENSITY / 12.0)
    for ratio in (0.3, 0.499):
        modulus = E if plane == "stress" else E * (1.0 - ratio**2)
        material = sj.Material(modulus, DENSITY, ratio)
        made = sj.Structure(mesh, material, thickness=0.01, fixed=["left"], plane=plane)
        system = made.system()
        stiff = sj.natural_modes(system, 1).frequencies[0] / euler > 1.02
        assert any("material.poisson" in note for note in system.notes) == stiff
        assert stiff == (plane == "strain" and ratio > 0.4)


@pytest.mark.parametrize(("installed", "n", "said"), [
    (False, 20_001, True), (False, 20_000, False), (True, 20_001, False),
])  # fmt: skip
def test_large_models_name_the_extra_that_makes_their_factors_fast(installed, n, said, monkeypatch):
    monkeypatch.setattr(doubts, "pardiso", lambda: object() if installed else None)
    (sentence,) = [*doubts.without_pardiso(n)] or [""]
    assert ('pip install "skfem-joint[solids]"' in sentence) == said
