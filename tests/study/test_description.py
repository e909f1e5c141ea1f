"""What a structure is said to be: closed forms, and what is implausible."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from joint_scenes import BARS, MU, THICKNESS, WIDTH, bar_scene, harmonic, joint, plate_scene
from scipy import sparse
from scipy.integrate import trapezoid

import skfem_joint as sj
from skfem_joint.output.damping import backbone_lines, write_backbone
from skfem_joint.reduction.stuck import Stuck
from skfem_joint.results.gross_slip import sticking_share
from skfem_joint.results.normal_force import normal_change_of_mode
from skfem_joint.slow.quasi_static import QuasiStatic
from skfem_joint.study.description import alike, description_of
from skfem_joint.study.scene_backbone import scene_backbone

EXAMPLES = sorted((Path(__file__).parents[2] / "examples").glob("*.toml"))
STEEL = {"E": 200e9, "density": 8000.0}
STRIPS, POINTS = BARS["structure"]
IN_MILLIMETRES = sj.build_bar(
    [(name, 1e3 * x, n) for name, x, n in STRIPS], {name: 1e3 * x for name, x in POINTS.items()}
)


def block_scene(load: dict[str, Any], **changes: Any) -> sj.Scene:
    """Block of 0.1 m on its base, of triangles of second order, loaded on its top."""
    sides = {"base": "bottom", "top": "top"}
    block = sj.build_plate([("all", 0.1, 4)], 0.1, 4, kind="triangle", order=2, boundaries=sides)
    values: dict[str, Any] = {
        "material": STEEL | {"poisson": 0.0},
        "joint": [{"on": "base", "pressure": 1e6, "friction": MU, "law": "coulomb"}],
        "load": [harmonic("top", 1e3, 1.0) | load],
        "support": {},
        "time": {"cycles": 1, "steps_per_cycle": 40},
    }
    return plate_scene("full", mesh=block, **values | changes)


def said(scene: sj.Scene) -> list[str]:
    return [*scene.system().notes, *description_of(scene).doubts]


def test_a_bar_has_the_figures_of_its_closed_forms():
    """Stuck, 0.5 m are left of it; the force at its end is amplified by 1 / cos(k 0.5 m)."""
    values = description_of(bar_scene()).values
    c, area, force, limit = 5000.0, WIDTH * THICKNESS, 87.5e3, MU * 50e6 * WIDTH * 0.1
    assert values["mass_kg"] == pytest.approx(8000.0 * area * 0.6, rel=1e-12)
    for name, length in (("stuck", 0.5), ("loose", 0.6)):
        expected = [(2 * k + 1) * c / (4 * length) for k in range(3)]
        assert values[f"frequencies_{name}_Hz"] == pytest.approx(expected, rel=1e-3)
    assert values["elements_per_wavelength"] == pytest.approx(c / 500.0 / 5e-3, rel=1e-9)
    # Slip over F / tau, of mean strain F / 2 EA, and the bar beyond the joint.
    slipping = force / (limit / 0.1)
    moved = force / (200e9 * area) * (0.5 * slipping + 0.5)
    assert values["static_displacement_m"]["free_end"] == pytest.approx(moved, rel=0.01)
    assert values["static_strain"] == pytest.approx(force / (200e9 * area), rel=1e-9)
    dynamic = force / np.cos(2 * np.pi * 500.0 * 0.5 / c)
    assert values["load_over_limit"] == pytest.approx(dynamic / limit, rel=5e-3)


def test_stuck_modes_are_compared_with_loose_ones_by_their_shapes():
    """Sines of bars of 0.5 m and 0.6 m that end at the same place, of unit mass."""
    found = description_of(bar_scene())
    x = np.linspace(0.0, 0.6, 20_001)
    waves = np.pi * (np.arange(12) + 0.5)
    loose = np.sqrt(2.0 / 0.6) * np.sin(np.outer(waves / 0.6, x))
    stuck = np.sqrt(2.0 / 0.5) * np.sin(np.outer(waves[:3] / 0.5, np.maximum(x - 0.1, 0.0)))
    shares = trapezoid(stuck[:, np.newaxis] * loose, x) ** 2
    assert found.values["stuck_modes_like_loose"] == (shares.argmax(axis=1) + 1).tolist()
    assert found.values["stuck_modes_like_loose_share"] == pytest.approx(
        shares.max(axis=1), rel=1e-2
    )
    assert f"stuck are loose mode 1 ({100.0 * shares[0].max():.0f} % alike)" in found.facts[3]


def test_a_mode_that_the_joints_make_new_is_like_none_of_the_loose_ones():
    """One of two equal masses held by friction: the loose modes share it evenly, or leave it."""
    M = sparse.eye_array(3, format="csr")
    loose = np.array([[1.0, 1.0, 0.0], [1.0, -1.0, 0.0]]).T / np.sqrt(2.0)
    number, share = alike(M, np.eye(3)[:, [0, 2]], loose)
    assert share == pytest.approx([0.5, 0.0])
    assert number.size == 2
    assert alike(M, np.eye(3), np.zeros((3, 0)))[0].size == 0


def test_moments_count_and_friction_alone_may_hold_a_body():
    """A narrow strip of length L under a force F at a distance a from its middle turns.

    About a point c beyond the middle: F = 2 t c and F a = t (L²/4 - c²), t the limit by length.
    """
    length, width, limit = 0.1, 0.005, 100.0
    arm = sj.build_plate([("joint", length, 60), ("rest", length, 20)], width, 2)
    pressed = {"on": "joint", "pressure": limit / (MU * length * width), "friction": MU}
    scene = plate_scene(
        "full",
        mesh=arm,
        joint=[pressed],
        support={},
        load=[harmonic("right", 0.1 * limit, 1.0) | {"direction": [0.0, 1.0]}],
        time={"cycles": 1, "steps_per_cycle": 40},
    )
    found, path = description_of(scene), QuasiStatic(scene.system())
    a, half = 1.5 * length, 0.5 * length
    turns_at = 2.0 * limit / length * (np.hypot(a, half) - a)
    force = scene.system().load_vectors()[:, 0]
    assert path.limit(force) == pytest.approx(turns_at, rel=0.02)
    assert found.values["load_over_limit"] > 0.1 * limit / turns_at
    assert "Friction alone holds the body with the regions 'joint', 'rest'" in "\n".join(
        found.facts
    )
    assert sj.run_scene(scene).models["full"].run.energy_residual < 1e-9


@pytest.mark.parametrize("shares", [(1.0, 1.0), (0.2, 1.0), (1.0, 0.2)])
def test_of_a_body_held_by_two_joints_the_stated_level_is_that_of_the_first_that_slips(shares):
    """On the path to it 99 % of that joint's limit slip, and just below of no joint."""
    strips = [("one", 0.04, 8), ("middle", 0.08, 16), ("two", 0.04, 8)]
    feet = sj.build_plate(strips, 0.03, 6)
    scene = plate_scene(
        "full",
        mesh=feet,
        joint=[
            {"on": name, "pressure": 5e6 * share, "friction": MU, "law": "coulomb"}
            for name, share in zip(("one", "two"), shares, strict=True)
        ],
        support={},
        load=[harmonic("right", 500.0, 1.0) | {"direction": [0.4, 1.0]}],
        time={"cycles": 1, "steps_per_cycle": 40},
    )
    system, level = scene.system(), 1.0 / description_of(scene).values["load_over_limit"]
    force = 500.0 * system.load_vectors()[:, 0]
    assert level < 0.95 * QuasiStatic(system).limit(force)  # the whole body slides later

    def slipping(multiple: float) -> float:
        path = QuasiStatic(system)
        ramp = np.linspace(0.1, 1.0, 10) * multiple
        u = path.follow(np.outer(ramp, force), limit_share=np.inf)[-1]
        slip = system.contact.slip_norm(system.contact.B @ u)
        return 1.0 - sticking_share(path, slip)

    assert slipping(1.01 * level) >= 0.99
    assert slipping(0.97 * level) < 0.99


def test_a_longitudinal_mode_changes_the_normal_force_by_its_inertia():
    """Of a block of nu = 0 on its base, q omega² Gamma over all; beside the corners, as above."""
    scene = block_scene({"direction": [0.0, 1.0]})
    structure, system = scene.structure(), scene.system()
    frequencies, shapes = Stuck(system).modes(6)
    up = system.load_vectors()[:, 0] @ shapes
    k = int(np.abs(up).argmax())
    f, q = frequencies[k], 1e-7
    assert f == pytest.approx(5000.0 / 0.4, rel=0.01)
    gamma = 2.0 / np.pi * np.sqrt(2.0 * 8000.0 * 0.1 * THICKNESS * 0.1)
    share = (2.0 * np.pi * f) ** 2 * q * gamma / (1e6 * 0.1 * THICKNESS)
    acts = structure.reactions(scene.loads())
    found = normal_change_of_mode(structure, acts, shapes[:, k], f, q)
    assert found.share == pytest.approx(share, rel=0.2)
    larger = normal_change_of_mode(structure, acts, shapes[:, k], f, 3.0 * q)
    assert larger.share == pytest.approx(3.0 * found.share, rel=1e-12)


def test_a_damping_curve_says_how_its_highest_level_changes_the_normal_force(tmp_path):
    scene = block_scene({"direction": [1.0, 0.0]}, backbone={"levels": 3})
    found = scene_backbone(scene)
    change, (curve,) = found.normal[1], found.models[0].curves
    expected = normal_change_of_mode(
        scene.structure(), scene.structure().reactions(scene.loads()), curve.shape,
        curve.stuck_frequency, curve.amplitude[-1],
    )  # fmt: skip
    assert change == expected
    assert change.share > 0.1  # a block as tall as wide rocks before it slides
    assert any("Mode 1: at the highest level vibration" in one for one in found.notes)
    write_backbone(tmp_path, found)
    (mode,) = json.loads((tmp_path / "summary.json").read_text())["models"]["full"]["modes"]
    assert mode["normal_force_change"] == change.share
    assert change.text in "\n".join(backbone_lines(found))
    assert scene_backbone(bar_scene(backbone={"levels": 3})).normal == {}


def test_a_curve_on_which_nothing_slips_is_not_said_to_slip():
    points = {"fixed": 0.0, "junction": 0.1, "free_end": 0.6}
    slider = sj.build_bar([("joint", 0.1, 1), ("linear", 0.5, 5)], points)
    held = bar_scene("full", backbone={"levels": 3, "up_to": 0.9}).changed(mesh=slider)
    said = "\n".join(backbone_lines(scene_backbone(held)))
    assert " %, no slip." in said


def test_a_scene_says_the_error_by_the_mesh_that_its_structure_has():
    scene = plate_scene(
        "full", mesh=sj.build_plate([("joint", 0.05, 5), ("rest", 0.2, 8)], 0.01, 1)
    )
    structure, found = scene.structure(), description_of(scene)
    for error in (structure.mesh_error, structure.loose_mesh_error):
        assert found.values["mesh"][error.joints]["frequencies_Hz"] == error.frequencies.tolist()
    largest = 100.0 * max(structure.mesh_error.largest, structure.loose_mesh_error.largest)
    assert found.values["mesh"]["frequency_error_percent"] == largest > 3.0
    (fact,) = [fact for fact in found.facts if fact.startswith("The mesh makes")]
    assert f"up to {largest:.2g} % too high" in fact
    assert any("The mesh is too stiff" in note for note in scene.system().notes)


def test_no_better_frequencies_are_named_where_elements_bend_better_than_those_compared():
    """Incompatible modes bend better than functions of second order in long elements, that lock."""
    mesh = sj.build_plate([("joint", 0.1, 2), ("rest", 1.0, 3)], 0.002, 1, order=1)
    found = description_of(plate_scene("full", mesh=mesh))
    (fact,) = [fact for fact in found.facts if "the mesh makes" in fact]
    assert fact == "How much too high the mesh makes the first frequencies is not known."
    assert found.values["mesh"]["frequency_error_percent"] is None


@pytest.mark.parametrize(
    "path",
    [
        pytest.param(path, id=path.stem, marks=pytest.mark.slow if "solid" in path.stem else ())
        for path in EXAMPLES
    ],
)
def test_sound_scenes_raise_no_doubt(path):
    """But where lapped solids are bent, and where few points rub."""
    scene = sj.load_scene(path)
    told = ("Damping of ratio", "The pressure on", "The base is")  # no doubts
    raised = [text for text in said(scene) if not text.startswith(told)]
    known = []
    if path.stem.startswith("solid_lap_joint"):
        known += ["change the normal force by", "contact points share the work of friction"]
    assert len(raised) == len(known)
    assert all(part in text for part, text in zip(known, raised, strict=True))


@pytest.mark.parametrize("share", [0.05, 0.3])
def test_an_even_traction_changes_the_normal_force_by_its_share_of_the_pressure(share):
    """On top of a block of nu = 0 far below its natural frequency; said beyond a tenth."""
    pull = {"amplitude": share * 1e6, "direction": [0.0, 1.0], "quantity": "traction"}
    found = description_of(block_scene(pull))
    # Reactions of nodes at the corners, whose elements end there, are lumped otherwise.
    assert found.values["normal_force_change"] == pytest.approx(share, rel=0.2)
    assert any("doubtful" in one for one in found.doubts) == (share > 0.1)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"material": STEEL | {"E": 200e3}}, r"material\.E is 2e\+05 Pa"),
        ({"material": STEEL | {"E": 200.0}}, r"material\.E is 200 Pa"),
        ({"material": STEEL | {"density": 7.85e-9}}, r"material\.density is 7\.85e-09 kg/m3"),
        ({"material": STEEL | {"density": 7.85}}, r"material\.density is 7\.85 kg/m3"),
        ({"damping": {"stiffness": 0.02}}, r"Damping has \d+ of the critical one"),
        ({"joint": [joint(pressure=30.0)]}, "pressed by 30 Pa"),
        ({"joint": [joint(friction=30.0)]}, "is it in percent"),
        ({"section": {"width": 30.0, "thickness": 0.01}}, "0.6 m long, 30 m wide"),
        ({"bar": IN_MILLIMETRES}, "600 m long"),
        ({"load": [harmonic(amplitude=1.5e6)]}, r"strain the structure by 1\.\d* %"),
        ({"load": [harmonic(amplitude=2e7)]}, "more than a tenth of its 0.6 m"),
        ({"load": [harmonic(amplitude=2e5)]}, r"1\.\d* times what makes the first joint slip"),
        ({"load": [harmonic(frequency=200e3)]}, "elements in the length of the slowest wave"),
        ({"load": [harmonic(amplitude=0.0)]}, "load on 'free_end' is zero at all times"),
        ({"joint": []}, "There is no joint"),
    ],
)  # fmt: skip
def test_what_is_implausible_is_said_and_runs(changes, sentence):
    scene = bar_scene("full", **({"time": {"cycles": 1}} | changes))
    notes = said(scene)
    assert any(re.search(sentence, note) for note in notes)
    assert set(notes) <= set(sj.run_scene(scene).notes)


def test_what_depends_on_the_mesh_of_a_bent_lap_is_said_with_the_figures_of_this_case():
    """On each finer mesh a node at the border changes more, the mean of all less so."""
    shares, means, over, said = [], [], [], ""
    for n, layers in ((5, 2), (10, 3), (20, 6)):
        lower = sj.build_plate(
            [("held", 0.1, n), ("under", 0.1, n)], 0.01, layers, order=2,
            boundaries={"left": "left", "top": "top"},
        )  # fmt: skip
        upper = sj.build_plate(
            [("lap", 0.1, n)], 0.01, layers, order=2, origin=(0.1, 0.01), prefix="upper_",
            boundaries={"foot": "bottom", "right": "right"},
        )  # fmt: skip
        contact = {"on": "foot", "against": "top", "pressure": 8e6, "friction": 0.3}
        scene = plate_scene(
            "full", mesh=sj.merged([lower, upper]), support={"fixed": ["left"]},
            material=STEEL | {"poisson": 0.3}, joint=[contact | {"law": "coulomb"}],
            load=[harmonic("right", 40.0, 50.0) | {"direction": [0.0, 1.0]}],
            time={"cycles": 1, "steps_per_cycle": 40},
        )  # fmt: skip
        found = description_of(scene)
        shares.append(found.values["normal_force_change"])
        means.append(found.values["normal_force_change_mean"])
        over.append(found.values["load_over_limit"])
        said = " ".join([*found.facts, *found.doubts])
    assert shares == pytest.approx([0.11, 0.23, 0.79], abs=0.005)
    assert "11, 23, 79 and 163 % on four meshes" in said
    assert over == pytest.approx([0.005, 0.01, 0.02], abs=5e-4)
    assert "0.5, 1, 2 and 4 %" in said
    assert f"it is {100.0 * means[-1]:.2g} % on average" in said
    assert means[2] / means[1] < 0.5 * shares[2] / shares[1]


@pytest.mark.parametrize("height", [1e-3, 5e-4])
def test_slender_bodies_bend_at_rest_and_vibrate_as_beams(height):
    """F L^3 / (3 E I) and 1.8751^2 / (2 pi L^2) sqrt(E I / (rho A)); anticlastic bending aside."""
    E, density, length, width = 200e9, 7800.0, 0.3, 0.03
    body = sj.build_box(
        [("all", length, 30)], (width, height), (3, 1), boundaries={"wall": "left", "end": "right"}
    )
    steel = sj.Material(E, density, 0.0)
    made = sj.Structure(body, steel, fixed=["wall"])
    found = sj.describe(made, [sj.Load("end", sj.Harmonic(1.0, 1.0), (0.0, 0.0, 1.0))]).values
    tip = length**3 / (3.0 * E * width * height**3 / 12.0)
    first = 1.875104**2 / (2.0 * np.pi * length**2) * np.sqrt(E / density / 12.0) * height
    assert found["static_displacement_m"]["end"] == pytest.approx(tip, rel=5e-3)
    assert found["frequencies_loose_Hz"][0] == pytest.approx(first, rel=5e-3)
    assert found["rigid_motions_loose"] == 0
