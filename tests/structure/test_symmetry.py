"""A part of a body cut by planes of symmetry moves as the whole does."""

from dataclasses import replace

import numpy as np
import pytest
from bodies import STEEL

import skfem_joint as sj


def plates(part: bool, order: int, along: int, contact: str) -> sj.Structure:
    """Two plates pressed on each other, pulled apart on both sides; a quarter of them or all."""
    times, bodies = 1 if part else 2, []
    for y, name, (inner, outer), n in (
        (0.0, "low", ("top", "bottom"), 4),
        (0.006, "up", ("bottom", "top"), along),
    ):
        sides = {"face": inner, "out": outer, "far": "right", "near": "left", "middle": "back"}
        groups = {f"{name}_{side}": on for side, on in sides.items()}
        strips, size = [(name, 0.04 * times, n * times)], (0.006, 0.02 * times)
        origin = (0.04 * (1 - times), y, 0.0)
        options = {"origin": origin, "boundaries": groups, "order": order}
        bodies.append(sj.build_box(strips, size, (1, 2 * times), **options))
    held = {"fixed_x": ["low_near", "up_near"], "fixed_z": ["low_middle", "up_middle"]}
    return sj.Structure(
        sj.merged(bodies),
        STEEL,
        fixed_y=["low_out"],
        joints=[sj.Joint("up_face", 5e6, 0.3, against="low_face", contact=contact)],
        stiffness_damping=1e-6,
        free=True,
        **(held if part else {}),
    )


@pytest.mark.parametrize(
    ("order", "along", "contact"),
    [(1, 4, "constant"), (2, 3, "constant"), (1, 3, "unilateral"), (2, 4, "unilateral")],
)
def test_a_quarter_of_two_plates_moves_as_the_whole(order, along, contact):
    """Also the nodes on both planes, which slip nowhere, and on meshes that do not match."""
    found = []
    for part in (True, False):
        share = 1.0 if part else 4.0
        loads = [
            sj.Load("up_far", sj.Harmonic(3e3 * share**0.5, 200.0), (1, 0, 0)),
            sj.Load("up_out", sj.Harmonic(500.0 * share, 200.0), (0, -1, 0)),
        ]
        if not part:
            loads.append(sj.Load("up_near", sj.Harmonic(6e3, 200.0), (-1, 0, 0)))
        run = sj.integrate(plates(part, order, along, contact).system(loads), cycles=1,
                           steps_per_cycle=40)  # fmt: skip
        found.append([*run.peak[:2], run.friction_energy["up_face"] / share])
    np.testing.assert_allclose(*found, rtol=1e-8)


def test_a_support_of_one_body_alone_in_a_joint_is_refused_with_the_cure():
    quarter = plates(True, 1, 4, "constant")
    alone = replace(quarter, fixed_x=(), fixed_z=("up_middle",))
    with pytest.raises(sj.InputError, match=r"5 of its nodes .* hold both bodies there alike"):
        alone.system()
