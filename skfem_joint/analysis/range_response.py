"""Steady vibration by a model for a range: its points, and where a joint slips as a whole in it.

How much slips is judged by the steady vibration itself: the load that makes a joint slip as a whole
within some cycles from rest is another one.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from skfem_joint.reduction.ranges.points import check_within, point_of
from skfem_joint.served import Point
from skfem_joint.system import System


def steady_in_range(system: System, frequency: float, level: float) -> System:
    """Model for a range at one frequency (Hz) and level, whose share of slip is not known.

    InputError if the frequency is outside the range.
    """
    factors = np.ones(len(system.contact.joints))
    check_within(system, frequency, factors)
    return point_of(system, Point(frequency, level, {}), factors)


def larger_at(system: System, frequency: float, level: float) -> System:
    """The larger model that a model for a range carries, at one frequency (Hz) and level."""
    point = steady_in_range(system, frequency, level)
    serves = point.serves
    larger: System = point if serves is None else serves.larger
    return replace(larger, serves=None)
