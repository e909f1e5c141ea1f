"""Numbers that users give to public functions: refused by name where they are none or too large."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import skfem

import skfem_joint as sj
from skfem_joint.ground import values
from skfem_joint.mesh import named, write_mesh
from skfem_joint.scene import scene_from

NAN, INF = math.nan, math.inf
#: What is never a number that can be computed with.
NONE = ("1", True, 1j, [1.0], (), np.array([1.0, 2.0]), object, 10**400, -(10**400))
WRONG: dict[str, tuple[Any, ...]] = {
    "positive": (*NONE, 0, 0.0, -1.0, NAN, INF, -INF, np.float64(-1.0)),
    "not_negative": (*NONE, -1, -1e-300, NAN, INF),
    "finite": (*NONE, NAN, INF),
    "beta": (*NONE, 0.0, -1.0, NAN),
    "count": (*NONE, 0, -3, 10.5, 10.0, NAN, INF, np.float64(3.0)),
    "whole": (*NONE, -3, 1.5, NAN),
    # A count, or values that rise.
    "level": ("1", True, 1j, (), object, 10**400, -(10**400), 0, -3, 10.5, 10.0, NAN, INF),
}


MESH = sj.build_bar([("joint", 0.1, 4), ("free", 0.3, 6)], {"wall": 0.0, "tip": 0.4})


def bar(**changes: Any) -> sj.Structure:
    pressed = sj.Joint("joint", **{"pressure": 8e6, "friction": 0.7} | changes.pop("joint", {}))
    made: dict[str, Any] = {"width": 0.05, "thickness": 0.01, "mass_damping": 50.0}
    material = sj.Material(**{"E": 2e11, "density": 8e3} | changes.pop("material", {}))
    return sj.Structure(MESH, material, joints=[pressed], fixed=["wall"], **made | changes)


SYSTEM = bar().system([sj.Load("tip", sj.Harmonic(1e4, 500.0))])
CYCLES: dict[str, Any] = {"cycles": 1, "steps_per_cycle": 20}
STEPS: dict[str, Any] = {"step": 1e-4, "n_steps": 2}
(CURVE,) = sj.backbone(SYSTEM, levels=2)


def run(**changes: Any) -> sj.System:
    return sj.integrate(SYSTEM, **changes)


RUN = run(**CYCLES)


def point(**changes: Any) -> Any:
    return sj.point_friction(**{"row": [1.0, 0.0], "limit": 1.0} | changes)


def bolt(**changes: Any) -> Any:
    return sj.Bolt(**{"at": (0.1, 0.0), "force": 1.0, "head_radius": 0.01} | changes)


def matrices(**changes: Any) -> Any:
    return sj.System.from_matrices(np.eye(2), np.eye(2), **changes)


def box(**changes: Any) -> Any:
    return sj.build_plate(**{"strips": [("a", 0.1, 2)], "width": 0.1, "elements": 2} | changes)


#: Argument, kind of number that it is, and a call with it.
ARGUMENTS: list[tuple[str, str, Any]] = [
    ("step", "positive", lambda x: run(step=x, n_steps=2)),
    ("n_steps", "count", lambda x: run(step=1e-4, n_steps=x)),
    ("duration", "positive", lambda x: run(step=1e-4, duration=x)),
    ("cycles", "count", lambda x: run(cycles=x, steps_per_cycle=20)),
    ("steps_per_cycle", "count", lambda x: run(cycles=1, steps_per_cycle=x)),
    ("cycle_steps", "count", lambda x: run(**STEPS, cycle_steps=x)),
    ("tolerance", "not_negative", lambda x: run(**STEPS, tolerance=x)),
    ("every", "count", lambda x: sj.Save(every=x)),
    ("fields_every", "count", lambda x: sj.Save(fields_every=x)),
    ("rho_infinity", "not_negative", sj.generalized_alpha),
    ("modes", "count", lambda x: sj.reduce(SYSTEM, modes=x)),
    ("interface_modes", "whole", lambda x: sj.reduce(SYSTEM, interface_modes=x)),
    ("duration", "positive", lambda x: sj.reduce(SYSTEM, duration=x)),
    ("friction_points", "count", lambda x: sj.reduce(SYSTEM, friction_points=x)),
    ("beta", "beta", lambda x: sj.reduce(SYSTEM, beta=x)),
    ("interface_modes", "whole", lambda x: sj.condense(SYSTEM, x)),
    ("frequencies[0]", "positive", lambda x: sj.response(SYSTEM, [x])),
    ("levels[0]", "positive", lambda x: sj.response(SYSTEM, [500.0], [x])),
    ("steps_per_cycle", "count", lambda x: sj.response(SYSTEM, [500.0], steps_per_cycle=x)),
    ("modes[0]", "count", lambda x: sj.backbone(SYSTEM, [x])),
    ("levels", "level", lambda x: sj.backbone(SYSTEM, levels=x)),
    ("up_to", "positive", lambda x: sj.backbone(SYSTEM, up_to=x)),
    ("slips_at", "positive", lambda x: sj.backbone(SYSTEM, slips_at=x)),
    ("cycles", "count", lambda x: sj.ring_down(SYSTEM, CURVE, x)),
    ("steps_per_cycle", "count", lambda x: sj.ring_down(SYSTEM, CURVE, 8, x)),
    ("limit", "not_negative", lambda x: point(limit=x)),
    ("beta", "beta", lambda x: point(beta=x)),
    ("rise_time", "positive", lambda x: sj.Triangle(1.0, x)),
    ("start", "not_negative", lambda x: sj.Triangle(1.0, 1.0, x)),
    ("duration", "positive", lambda x: sj.Rectangle(1.0, x)),
    ("material.E", "positive", lambda x: bar(material={"E": x})),
    ("material.density", "positive", lambda x: bar(material={"density": x})),
    ("section.width", "positive", lambda x: bar(width=x)),
    ("section.thickness", "positive", lambda x: bar(thickness=x)),
    ("damping.stiffness", "not_negative", lambda x: bar(stiffness_damping=x)),
    ("damping.mass", "not_negative", lambda x: bar(mass_damping=x)),
    ("pressure", "not_negative", lambda x: bar(joint={"pressure": x})),
    ("friction", "not_negative", lambda x: bar(joint={"friction": x})),
    ("beta", "beta", lambda x: bar(joint={"beta": x})),
    ("regions.free.E", "positive", lambda x: bar(regions={"free": {"E": x}})),
    ("force", "not_negative", lambda x: bolt(force=x)),
    ("head_radius", "positive", lambda x: bolt(head_radius=x)),
    ("hole_radius", "not_negative", lambda x: bolt(hole_radius=x)),
    ("spreading_angle", "not_negative", lambda x: bolt(spreading_angle=x)),
    ("bolts.reach", "not_negative", lambda x: sj.Bolts((bolt(),), x)),
    ("pressure.values[1]", "not_negative", lambda x: sj.PressureTable((0.0, 1.0), (1.0, x))),
    ("pressure.positions[1]", "finite", lambda x: sj.PressureTable((0.0, x), (1.0, 1.0))),
    ("stiffness_damping", "not_negative", lambda x: matrices(stiffness_damping=x)),
    ("mass_damping", "not_negative", lambda x: matrices(mass_damping=x)),
    ("damping.ratio", "positive", lambda x: matrices(damping_ratio=x)),
    ("beta", "beta", SYSTEM.with_beta),
    ("length of strip 'a'", "positive", lambda x: sj.build_bar([("a", x, 2)])),
    ("strip 'a' has", "count", lambda x: sj.build_bar([("a", 1.0, x)])),
    ("length of width", "positive", lambda x: box(width=x)),
    ("width has", "count", lambda x: box(elements=x)),
    ("origin", "finite", lambda x: box(origin=(0.0, x))),
    ("scale", "positive", lambda x: sj.load_meshes("any.msh", scale=x)),
]


@pytest.mark.parametrize(("name", "kind", "call"), ARGUMENTS)
def test_what_is_no_such_number_is_refused_by_name(name, kind, call):
    for value in WRONG[kind]:
        with pytest.raises(sj.InputError) as caught:
            call(value)
        assert all(name in problem for problem in caught.value.problems), caught.value
        assert len(caught.value.problems) == 1


@pytest.mark.parametrize("value", [1e3, 0.1, 0.0011])
def test_a_tolerance_that_lets_everything_pass_is_refused(value):
    with pytest.raises(sj.InputError, match=r"tolerance: found .* must be from 0 to 0\.001"):
        run(**STEPS, tolerance=value)


def test_numbers_of_numpy_do_as_well_as_others():
    plain = run(**CYCLES)
    for count in (np.int64, np.int32, np.uint8):
        again = run(cycles=count(1), steps_per_cycle=count(20), tolerance=np.float64(1e-11))
        np.testing.assert_array_equal(again.point_u, plain.point_u)
    assert np.float32(2.0) in values.POSITIVE
    assert np.array(2.0) in values.POSITIVE
    assert sj.reduce(SYSTEM, modes=np.int64(2), beta=np.float32(1e4)).n <= 6
    assert replace(SYSTEM, notes=()).with_beta(INF).contact.beta[0] == INF


def test_tables_and_lists_hold_real_numbers():
    for wrong in (["a", "b"], [1j, 2j], [True, False]):
        with pytest.raises(sj.InputError, match=r"times: found .* must be real"):
            sj.Table(wrong, [1.0, 2.0])
    for wrong in (3.0, "abc", [], None):
        with pytest.raises(sj.InputError, match="levels: found"):
            sj.response(SYSTEM, [500.0], wrong)


@pytest.mark.parametrize(
    ("argument", "call"),
    [
        ("reference", lambda _: sj.compare(3, 4)),
        ("other", lambda one: sj.compare(one, 4)),
        ("run", lambda _: sj.losses(SYSTEM)),
        ("run", lambda _: sj.estimate(SYSTEM)),
        ("finer", lambda one: sj.estimate(one, finer=3)),
        ("run", lambda _: sj.reduce(SYSTEM, run=3)),
        ("system", lambda _: sj.ring_down(3, None, 8)),
        ("ring_down: curve", lambda _: sj.ring_down(SYSTEM, [], 8)),
        ("reduce: curve", lambda _: sj.reduce(SYSTEM, curve=[])),
        ("random_response: curves", lambda _: sj.random_response(SYSTEM, 3, [[1.0, 1.0]])),
        ("system", lambda _: sj.harmonic_response(3, [1.0, 2.0])),
        ("system", lambda _: sj.frequency_response(3, None, "end")),
        ("curve", lambda _: sj.frequency_response(SYSTEM, [], "end")),
        ("path", lambda _: sj.load_scene(3)),
        ("path", lambda _: sj.load_sweep(3)),
        ("scene", lambda _: sj.run_scene("scene.toml")),
        ("regions.free", lambda _: bar(regions={"free": sj.Material(1e9, 1e3)})),
        ("meshes", lambda _: sj.merged(3)),
        ("meshes", lambda _: sj.merged([3])),
        ("mesh", lambda _: sj.refined(3)),
        ("mesh", lambda _: write_mesh(3, "bar.msh")),
        ("path", lambda _: write_mesh(MESH, 3)),
        ("points", lambda _: named(skfem.MeshTri(), points=3)),
        ("paths", lambda _: sj.load_meshes(3)),
        ("paths", lambda _: sj.load_meshes([3])),
        ("regions", lambda _: sj.build_bar(3)),
        ("strips", lambda _: sj.build_bar([3])),
        ("strips", lambda _: sj.build_bar([("a", 1.0)])),
        ("points", lambda _: sj.build_bar([("a", 1.0, 2)], 3)),
        ("name 1", lambda _: sj.build_bar([("a", 1.0, 2)], {1: 0.0})),
        ("origin", lambda _: box(origin=3)),
        ("origin", lambda _: box(origin=(0.0,) * 4)),
        ("prefix", lambda _: box(prefix=3)),
        ("boundaries", lambda _: box(boundaries=["left"])),
        ("boundary 'end'", lambda _: box(boundaries={"end": 3})),
        ("size", lambda _: sj.build_box([("a", 1.0, 1)], 1.0, (1, 1))),
        ("elements", lambda _: sj.build_box([("a", 1.0, 1)], (1.0, 1.0), (1,))),
        ("tables", lambda _: scene_from(3, MESH)),
        ("mesh", lambda _: scene_from({}, 3)),
    ],
)
def test_what_is_of_another_kind_is_refused_by_name(argument, call):
    with pytest.raises(sj.InputError, match=f"^{argument}: found .*, must be "):
        call(RUN)
