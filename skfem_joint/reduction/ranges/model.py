"""The reduced model of a range."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from skfem_joint.arrays import FloatArray
from skfem_joint.errors import InputError, first_of, refuse
from skfem_joint.loads import common_period
from skfem_joint.reduction.friction_points import NO_FRICTION
from skfem_joint.reduction.missing_modes import Residual, stride
from skfem_joint.reduction.pod import ProperModes
from skfem_joint.reduction.ranges.points import found_level, gross_slip_level, point_of
from skfem_joint.reduction.ranges.training import SETTINGS as TRAINING
from skfem_joint.reduction.ranges.training import Place, Pool, scaled, spread
from skfem_joint.served import Point, Range, Served
from skfem_joint.stepping.integrate import integrate
from skfem_joint.stepping.recording import Run, Save
from skfem_joint.system import System
from skfem_joint.values import COUNT, POSITIVE, check


@dataclass(frozen=True)
class RangeSettings:
    """Numbers of models for a range.

    Attributes
    ----------
    modes : tuple of int
        Numbers of joint modes that are tried.
    larger : float
        Modes of the larger model over those of the model.
    points_per_mode : int
        Merged friction points for each vector of a basis.
    checks : int
        Points at which numbers of modes are judged, and of these those at which the larger model
        is judged by the residual of its run in the full equation.
    judged : int
    cycles, steps : int
        Cycles of the runs at these points, and steps of each.
    missing : int
        Missing modes that are added to the larger model.
    share : float
        Share of the checked points at which the accuracy must be met.
    energies : float
        Error of energies that is allowed, over that of displacement histories.
    least : float
        Least factor on the difference of a run to that of the larger model.
    """

    modes: tuple[int, ...] = (12, 16, 20, 26, 32, 40, 50)
    larger: float = 1.6
    points_per_mode: int = 3
    checks: int = 8
    judged: int = 3
    cycles: int = 3
    steps: int = 100
    missing: int = 16
    share: float = 0.9
    energies: float = 3.0
    least: float = 1.2


SETTINGS = RangeSettings()
