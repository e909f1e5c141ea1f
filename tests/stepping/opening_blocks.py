"""Small structures with contact that opens and closes, in SI units."""

from typing import Any

import numpy as np
from scipy import sparse

import skfem_joint as sj

STEEL = sj.Material(E=200e9, density=8000.0, poisson=0.3)
SIZE = 0.04


def block(pressure: float = 50e6, order: int = 1, elements: int = 3, **joint: Any) -> sj.Structure:
    """Block of 40 mm on a rigid base that opens, guided on its right side."""
    mesh = sj.build_plate(
        [("block", SIZE, elements)], SIZE, elements, order=order, boundaries={
            "base": "bottom", "top": "top", "left": "left", "right": "right"
        },
    )  # fmt: skip
    values = {"friction": 0.5, "contact": "unilateral", "pressure": pressure} | joint
    return sj.Structure(
        mesh,
        STEEL,
        thickness=0.1,
        fixed_x=["right"],
        joints=[sj.Joint("base", **values)],
        stiffness_damping=2e-7,
        mass="lumped" if order == 1 else "consistent",
    )


def loads(up: float = 185e3, across: float = 200e3, frequency: float = 2000.0) -> list[sj.Load]:
    """A force that lifts the block's top and presses it in turn, and one on its left side."""
    return [
        sj.Load("top", sj.Harmonic(up, frequency), (0.0, 1.0)),
        sj.Load("left", sj.Harmonic(across, frequency), (1.0, 0.0)),
    ]


def opening_system(**values: Any) -> sj.System:
    """System of the block under both loads: a part of its base opens in each period."""
    return block(**values).system(loads())


def oscillator(frequency: float, damping: float, contact: float, pressed: float = 0.0) -> sj.System:
    """Mass of 1 kg on a spring, 1 Hz, with a one-sided spring of so many times its stiffness.

    The force has an amplitude of 1 N. ``damping`` is the ratio without the contact, ``pressed`` the
    force with which the one-sided spring is pressed at rest, N.
    """
    omega = 2.0 * np.pi
    one = sparse.csr_array(np.eye(1))
    opening = sj.NormalPart(
        one, np.zeros(1), np.array([pressed]), np.array([contact * omega**2]), np.ones(1)
    )  # fmt: skip
    wall = sj.Contact(sparse.csr_array((0, 1)), np.zeros(0), np.zeros(0), normal=opening)
    load = sj.AppliedLoad(np.ones(1), sj.Harmonic(1.0, frequency), "mass")
    C, K = 2.0 * damping * omega * one, omega**2 * one
    return sj.System(one, C, K, wall, loads=(load,), P=one, points=("mass",))
