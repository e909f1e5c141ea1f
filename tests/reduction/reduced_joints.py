"""Joints for the tests of reduced models: the paper's bars, and plates of the same section."""

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from bodies import MU, STEEL, WIDTH, structure

import skfem_joint as sj
from skfem_joint.reduction.scaled.reference import lap_joint

SPEED = 5000.0
TAU = MU * 50e6 * WIDTH  # N/m
STEPS = 100  # a period


def bar(
    regions: Sequence[tuple[str, float, int]],
    joints: Sequence[str],
    loads: Sequence[tuple[str, sj.Amplitude]],
    fixed: Sequence[str] = ("start",),
    **options: Any,
) -> tuple[sj.Structure, sj.System]:
    """Bar with points ``start``, ``end`` and one at the end of each region, ``after <region>``."""
    ends = np.cumsum([length for _, length, _ in regions])
    points = {"start": 0.0, "end": float(ends[-1])}
    points |= {
        f"after {name}": float(x) for (name, _, _), x in zip(regions[:-1], ends[:-1], strict=True)
    }
    pressed = [sj.Joint(name, 50e6, MU, **({"beta": 1e5} | options)) for name in joints]
    made = structure(sj.build_bar(regions, points), pressed, fixed, stiffness_damping=1e-5)
    return made, made.system([sj.Load(on, amplitude) for on, amplitude in loads])


def fig_18(
    frequency: float = 500.0, force: float = 87.5e3, on: str = "end"
) -> tuple[sj.Structure, sj.System]:
    """Structure of Fig. 18: 0.1 m of joint and 0.5 m of free bar."""
    regions = [("joint", 0.1, 100), ("linear", 0.5, 100)]
    return bar(regions, ["joint"], [(on, sj.Harmonic(force, frequency))], normal_force="equal")


def case_i(frequency: float = 2000.0) -> tuple[sj.Structure, sj.System]:
    """Case I of Table 2: a longer lap joint, clamped harder."""
    made = lap_joint(0.5, 50e6)
    return made, made.system([sj.Load("free_end", sj.Harmonic(437.5e3, frequency))])


@cache
def case(name: str, poisson: float = 0.3) -> tuple[sj.Structure, sj.System, float]:
    """Structure, system and time step of a plate, of which three periods are run."""
    on, direction, frequency, held = "right", (1.0, 0.0), 500.0, "left"
    pressed: dict[str, Any] = {"pressure": 50e6, "friction": MU, "beta": 1e5, "axis": (1.0, 0.0)}
    if name == "lap":  # the paper's reference system
        mesh = sj.build_plate([("joint", 0.25, 40)], 0.05, 4)
        pressed["pressure"], force, frequency = 8e6, 63e3, 1000.0
    elif name == "strip":
        mesh, force = sj.build_plate([("joint", 0.1, 16), ("arm", 0.5, 16)], 0.05, 2), 87.5e3
    elif name == "edge":
        border = {"left": "left", "right": "right", "joint": ("bottom", "foot")}
        mesh = sj.build_plate([("foot", 0.1, 16), ("arm", 0.3, 16)], 0.05, 2, boundaries=border)
        pressed["pressure"], pressed["friction"], force = 100e6, 0.5, 20e3
    else:
        under = sj.build_plate([("under", 0.1, 12), ("arm", 0.3, 12)], 0.05, 2, prefix="lower_")
        parts = [("arm_over", 0.3, 12), ("joint", 0.1, 12)]
        over = sj.build_plate(parts, 0.05, 2, prefix="upper_", origin=(-0.3, 0.0))
        mesh, force, on, direction = sj.merged([under, over]), 60e3, "upper_left", (-1.0, 0.0)
        pressed["against"], held = "under", "lower_right"
    how = {"material": replace(STEEL, poisson=poisson), "stiffness_damping": 1e-5}
    how["incompatible"] = False  # the bounds of the tests were measured with plain elements
    made = structure(mesh, [sj.Joint("joint", **pressed)], [held], **how)
    system = made.system([sj.Load(on, sj.Harmonic(force, frequency), direction)], [])
    return made, system, 1.0 / frequency / STEPS


def three_periods(system: sj.System, step: float) -> sj.Run:
    """Run with fields."""
    save = sj.Save(fields=True)
    return sj.integrate(system, step=step, n_steps=3 * STEPS, cycle_steps=STEPS, save=save)


@cache
def full(name: str, poisson: float = 0.3) -> sj.Run:
    """Full run of a plate."""
    _, system, step = case(name, poisson)
    return three_periods(system, step)


def errors(run: sj.Run, reference: sj.Run) -> tuple[float, float]:
    """Largest difference of the history over its peak, relative difference of friction energy."""
    history = np.abs(run.point_u[:, 0] - reference.point_u[:, 0]).max() / reference.peak[0]
    return float(history), float(run.cycles.friction[-1] / reference.cycles.friction[-1] - 1.0)
