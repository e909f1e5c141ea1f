"""Bars of the paper for the tests, in SI units unless a test says otherwise."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from skfem_joint.loads import Harmonic, Load
from skfem_joint.meshing import BarMesh, build_bar
from skfem_joint.structure import Joint, Structure, assemble, build_structure
from skfem_joint.system import System

E = 200e9
DENSITY = 8000.0
SPEED = 5000.0
WIDTH, THICKNESS = 0.05, 0.01
EA = E * WIDTH * THICKNESS
MU = 0.7


def bar_structure(bar: BarMesh, joints: Sequence[Joint] = (), **changes: Any) -> Structure:
    """Structure of the paper's material and section, held at ``fixed``."""
    values: dict[str, Any] = {
        "E": E, "density": DENSITY, "width": WIDTH, "thickness": THICKNESS,
        "fixed": ["fixed"], "stiffness_damping": 1e-5,
    }  # fmt: skip
    return build_structure(bar, joints=joints, **{**values, **changes})


@dataclass(frozen=True)
class LapJoint:
    """Lap joint in contact along its whole length; the default is the paper's reference system."""

    length: float = 0.25
    elements: int = 100
    pressure: float = 8e6
    friction: float = MU
    beta: float = 1e5
    normal_force: str = "equal"
    force: float = 63e3
    frequency: float = 1000.0
    load: Load | None = None
    options: Mapping[str, Any] | None = None

    @property
    def tau(self) -> float:
        """Friction limit per length, N/m."""
        return self.friction * self.pressure * WIDTH

    @property
    def structure(self) -> Structure:
        bar = build_bar(
            [("joint", self.length, self.elements)], {"fixed": 0.0, "free_end": self.length}
        )
        joint = Joint("joint", self.pressure, self.friction, self.beta, self.normal_force)
        return bar_structure(bar, [joint], **(self.options or {}))

    @property
    def system(self) -> System:
        load = self.load or Harmonic(self.force, self.frequency)
        return assemble(self.structure, [("free_end", load)])


CASE_I = LapJoint(length=0.5, pressure=50e6, force=437.5e3, frequency=2000.0)


def oscillator(
    load: Load, frequency: float = 1.0, damping_ratio: float = 0.05, mass: float = 1.0
) -> System:
    """Single mass on a spring without friction, observed as ``mass``."""
    from skfem_joint.system import AppliedLoad

    omega = 2.0 * np.pi * frequency
    one = np.ones((1, 1))
    return System(
        M=mass * one,
        C=2.0 * damping_ratio * omega * mass * one,
        K=omega**2 * mass * one,
        B=np.zeros((0, 1)),
        w=np.zeros(0),
        beta=np.zeros(0),
        loads=(AppliedLoad(np.ones(1), load, "mass"),),
        P=one,
        points=("mass",),
    )


def order_of(errors: Sequence[float], steps: Sequence[float]) -> float:
    """Slope of log error against log step."""
    return float(np.polyfit(np.log(steps), np.log(errors), 1)[0])


def tridiagonal(diagonal: NDArray[Any], off: NDArray[Any]) -> NDArray[Any]:
    """Dense symmetric tridiagonal matrix."""
    return np.diag(diagonal) + np.diag(off, 1) + np.diag(off, -1)
