"""Structures that several benchmarks have."""

from dataclasses import replace

import skfem_joint as sj
from benchmarks import EXAMPLES

STEEL = sj.Material(E=200e9, density=8000.0, poisson=0.3)


def bent_lap(force, frequency):
    """System of `solid_lap_joint` with contact that opens, bent by a force (N) at its lower end."""
    structure = sj.load_scene(EXAMPLES / "solid_lap_joint.toml").structure()
    joints = [replace(joint, contact="unilateral") for joint in structure.joints]
    structure = replace(structure, joints=joints, fixed_y=[], fixed_z=[])
    load = sj.Load("lower_end", sj.Harmonic(force, frequency), (0.0, 0.0, 1.0))
    return structure.system([load])


def tip_bar(joint, linear, tip):
    """The paper's bar under Coulomb's law with a tip of 320 t/m3 and a damping ratio of 0.2 %.

    By the numbers of elements of its joint, of what follows, and of the tip.
    """
    strips = [("joint", 0.1, joint), ("linear", 0.48, linear), ("tip", 0.02, tip)]
    scene = sj.load_scene(EXAMPLES / "structure_harmonic.toml").changed(
        mesh=sj.build_bar(strips, {"fixed": 0.0, "junction": 0.1, "free_end": 0.6}),
        material={"regions": {"tip": {"density": 320e3}}},
        joint={"law": "coulomb"},
        damping={"ratio": 0.002},
    )
    return scene.system()
